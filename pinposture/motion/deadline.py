"""Steps of a controller within a deadline: in another thread, or planned in another process."""

from __future__ import annotations

from concurrent.futures import Future, wait
from dataclasses import fields
from functools import partial
from math import inf
from threading import Thread
from typing import Any, NamedTuple, cast

import numpy as np
from numpy.typing import NDArray

from pinposture.arm import Arm, ArmState
from pinposture.collision import CollisionModel, Scene
from pinposture.control import Controller, Geodesic, GeodesicMemory, Limits, PathProgress, Step
from pinposture.control.controller import Memory, next_step
from pinposture.control.planner.geodesic import PromptGeodesic, adopt_plan, plan_from
from pinposture.control.planner.goal import PlanNeeded
from pinposture.control.planner.plan import is_small_change
from pinposture.motion.processes import BackgroundProcess, Interrupted, Shared
from pinposture.placement import Target

Array = NDArray[np.float64]

NOT_DONE = "the controller is still computing"
"""Reason for which the arm holds while a step is late."""


class DirectStep:
    """Computes the steps of a controller, in another thread if there is a deadline.

    Args:
        controller: the controller; the attribute may be replaced between steps.
        deadline: how long to wait for a step [s]; infinite: it is computed in this thread.
    """

    def __init__(self, controller: Controller, deadline: float = inf) -> None:
        self.controller = controller
        self._deadline = deadline
        self._pending: Future[Step] | None = None

    def __getstate__(self) -> dict[str, Any]:
        return self.__dict__ | {"_pending": None}

    def compute(
        self, state: ArmState, target: Target, limits: Limits, memory: Memory | None
    ) -> tuple[Step | None, Memory | None]:
        """Return the step of the controller, if it is computed before the deadline.

        A late computation of an earlier cycle has to end first, without waiting for it again. Its memory, for
        instance a path to the target, is used for the next step.

        Returns:
            The step, or None after the deadline; and the memory to pass on in the next cycle.
        """
        if self._deadline == inf:
            return next_step(self.controller, state, target, limits, memory), memory
        if self._pending is not None:
            if not self._pending.done():
                return None, memory
            pending = self._pending
            self._pending = None
            late = pending.result()
            # The arm has braked since, and is at rest or almost.
            memory = late.memory if memory is None else late.memory.with_motion_of(memory)
        started = self._start(state, target, limits, memory)
        if not wait([started], self._deadline).done:
            self._pending = started
            return None, memory
        return started.result(), memory

    def _start(self, *arguments: Any) -> Future[Step]:
        """Start a computation in a daemon thread."""
        future: Future[Step] = Future()
        controller = self.controller

        def work() -> None:
            try:
                future.set_result(next_step(controller, *arguments))
            except BaseException as error:  # `compute` raises it
                future.set_exception(error)

        Thread(target=work, name="pinposture-controller", daemon=True).start()
        return future


class Request(NamedTuple):
    """Arguments of a plan in progress; see `plan_from`."""

    controller: Geodesic
    target: Target
    limits: Limits
    previous: Array


class PlannedStep:
    """Computes the steps of `Geodesic` in this thread, and plans its paths in another process.

    Args:
        arm: the arm.
        controller: the controller.
    """

    def __init__(self, arm: Arm, controller: Geodesic) -> None:
        self._arm = arm
        self._shared_arm = Shared(arm)
        self._request: Request | None = None
        self._outdated = False  # this plan
        self._interrupted = False  # the plan before
        self.controller = controller
        self._process = BackgroundProcess(partial(_prepare, self._shared_arm, self._shared))

    def __reduce__(self) -> tuple[Any, ...]:
        return PlannedStep, (self._arm, self._controller)  # with a process of its own

    @property
    def controller(self) -> Controller:
        """The controller; may be replaced between steps."""
        return self._controller

    @controller.setter
    def controller(self, controller: Controller) -> None:
        before = getattr(self, "_controller", None)
        self._controller = cast(Geodesic, controller)
        self._prompt = PromptGeodesic(
            **{item.name: getattr(controller, item.name) for item in fields(Geodesic)}
        )
        new = self._controller
        # Plans do not use the offset.
        if before is None or before.scene is not new.scene or before.tasks is not new.tasks:
            self._shared = Shared(self._controller)

    def compute(
        self, state: ArmState, target: Target, limits: Limits, memory: Memory | None
    ) -> tuple[Step | None, Memory | None]:
        """Return the step of the controller, unless a path has to be planned first.

        Returns:
            The step, or None while a path is planned; and the memory to pass on in the next cycle.
        """
        if self._request is not None:
            if not self._process.done():
                if self._is_outdated(target, self._request.target):
                    self._process.interrupt()
                return None, memory
            # One step to the target of the path; the next cycle bends the path or replans.
            planned = self._request
            self._request = None
            self._interrupted = self._outdated = False
            try:
                memory = self._take_plan(planned, memory)
                target = planned.target
            except Interrupted:
                self._interrupted = True
        try:
            return self._prompt.step(state, target, limits, memory), memory
        except PlanNeeded as needed:
            # The arm brakes; the path starts where it will be in the next cycle.
            motion = Memory(np.zeros(self._arm.nv)) if memory is None else memory
            previous = motion.braked(limits, state).dq
            self._request = Request(self._controller, target, limits, previous)
            q = self._arm.integrate(state.q, previous)
            shared = self._shared_arm, self._shared
            self._process.submit(_plan, shared, q, target, limits, previous, needed)
            return None, memory

    def _is_outdated(self, target: Target, planned: Target) -> bool:
        """Whether a plan is to be interrupted, since its path cannot be bent to the current target.

        The plan after it is not interrupted: an arm whose target keeps jumping would never move.
        """
        if not (self._outdated or self._interrupted or target is planned):
            one, other = (self._controller.objective(self._arm, aim) for aim in (planned, target))
            self._outdated = not is_small_change(one, other)
        return self._outdated

    def _take_plan(self, request: Request, memory: Memory | None) -> Memory | None:
        """Return the memory with the planned path.

        Raises:
            Interrupted: the plan was interrupted.
        """
        try:
            progress = self._process.result()
        except EOFError:
            return memory  # another process plans again
        motion = Memory(request.previous) if memory is None else memory
        late = None if np.array_equal(motion.dq, request.previous) else motion
        adopted = adopt_plan(request.controller, progress, self._arm, request.target, request.limits, late)
        return GeodesicMemory(motion.dq, motion.stopping, adopted)


def _plan(shared: tuple[Shared[Arm], Shared[Geodesic]], *arguments: Any) -> PathProgress:
    arm, controller = shared
    return plan_from(controller.value, arm.value, *arguments)


def _prepare(arm: Shared[Arm], controller: Shared[Geodesic]) -> None:
    """Make what plans need, in the process that plans."""
    build_models(arm.value, controller.value.scene)


def build_models(arm: Arm, scene: Scene | None) -> None:
    """Make the collision model of an arm and a scene, if any, with the trees of its scans."""
    if scene is not None:
        CollisionModel.prepare(arm, scene)
