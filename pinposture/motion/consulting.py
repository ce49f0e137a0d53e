"""Asking a controller for a step without waiting for it longer than a cycle can."""

from __future__ import annotations

from concurrent.futures import Future, wait
from math import inf
from threading import Thread
from typing import Any

from pinposture.arm import ArmState
from pinposture.control import Controller, Limits, Step
from pinposture.control.controller import Memory, next_step
from pinposture.target import Target


class Consultation:
    """Asks a controller, in a thread of its own if it may take longer than the one who asks has time.

    Args:
        controller: the controller.
        deadline: how long to wait for it [s]; infinite: it is asked directly.
    """

    def __init__(self, controller: Controller, deadline: float) -> None:
        self._controller, self._deadline = controller, deadline
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
            return next_step(self._controller, state, target, limits, memory), memory
        if self._pending is not None:
            late = self._waited()
            if late is None:
                return None, memory
            # The arm has braked since, and is at rest or nearly.
            memory = late.memory if memory is None else memory._replace(own=late.memory.own)
        self._pending = self._begun(state, target, limits, memory)
        return self._waited(), memory

    def _begun(self, *question: Any) -> Future[Step]:
        """The answer to come, from a thread that does not keep a program from ending."""
        answer: Future[Step] = Future()

        def work() -> None:
            try:
                answer.set_result(next_step(self._controller, *question))
            except BaseException as error:  # whoever waits for the answer gets it
                answer.set_exception(error)

        Thread(target=work, name="pinposture-controller", daemon=True).start()
        return answer

    def _waited(self) -> Step | None:
        """The answer, if it is there before the deadline."""
        assert self._pending is not None
        if not wait([self._pending], self._deadline).done:
            return None
        pending, self._pending = self._pending, None
        return pending.result()
