"""Asking a controller for a step without waiting for it longer than a cycle can."""

from __future__ import annotations

from concurrent.futures import Future, ThreadPoolExecutor, wait
from math import inf

from pinposture.arm import ArmState
from pinposture.control import Controller, Limits, Step
from pinposture.control.controller import Memory
from pinposture.target import Target


class Consultation:
    """Asks a controller, in a thread of its own if it may take longer than the one who asks has time.

    Args:
        controller: the controller.
        deadline: how long to wait for it [s]; infinite: it is asked directly.
    """

    def __init__(self, controller: Controller, deadline: float) -> None:
        self._controller, self._deadline = controller, deadline
        self._pool: ThreadPoolExecutor | None = None
        self._pending: Future[Step] | None = None

    def ask(
        self, state: ArmState, target: Target, limits: Limits, memory: Memory | None
    ) -> tuple[Step | None, Memory | None]:
        """The step of the controller, and what it remembers of one that came too late.

        Where it is still at work on a question from before, that one has to be answered first. What it then
        remembers, a way to the target for instance, serves the question of now.

        Returns:
            The step, None if there is none in time; and the memory that the next question should come with.
        """
        if self._deadline == inf:
            return self._controller.step(state, target, limits, memory), memory
        if self._pending is not None:
            late = self._waited()
            if late is None:
                return None, memory
            # The arm has braked since, and is at rest or nearly.
            memory = late.memory if memory is None else memory._replace(own=late.memory.own)
        if self._pool is None:
            self._pool = ThreadPoolExecutor(1, "pinposture-controller")
        self._pending = self._pool.submit(self._controller.step, state, target, limits, memory)
        return self._waited(), memory

    def _waited(self) -> Step | None:
        """The answer, if it is there before the deadline."""
        assert self._pending is not None
        if not wait([self._pending], self._deadline).done:
            return None
        pending, self._pending = self._pending, None
        return pending.result()
