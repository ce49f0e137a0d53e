"""The control loop: what is kept of an arm and its controller from one cycle to the next."""

from __future__ import annotations

import numpy as np

from pinposture.arm import ArmState
from pinposture.control import Limits, Step
from pinposture.control.controller import Memory
from pinposture.control.limits import JerkFilter
from pinposture.control.smooth_steps import SmoothSteps
from pinposture.motion.deadline import DirectStep, PlannedStep
from pinposture.placement import Target


class Loop:
    """An arm that a controller moves, cycle by cycle.

    `RecordedLoop` records the cycles, for `track`; `perform` moves its target on a schedule; `Tracker` starts
    each cycle where measurements put the arm. In a cycle, `compute` asks the controller; then the arm takes
    the step, or brakes.

    Attributes:
        arm: the arm.
        state: the state of the arm.
        ahead: the state from which the controller steps: with the motion that a limit of jerk still delays.
        steps: computes the steps of `steps.controller`, which may be replaced between cycles.
        limits: the limits of the step.
        filter: limits the jerk.
        memory: memory of the controller; None before the first step.

    Args:
        state: the state from which the arm starts.
        steps: as above.
        limits: likewise.
        jerk_filter: likewise.
    """

    def __init__(
        self,
        state: ArmState,
        steps: DirectStep | PlannedStep,
        limits: Limits,
        jerk_filter: JerkFilter | SmoothSteps,
    ) -> None:
        self.arm = state.arm
        self.steps = steps
        self.limits = limits
        self.filter = jerk_filter
        self.memory: Memory | None = None
        self.start_at(state)

    def start_at(self, state: ArmState) -> None:
        """Set the state of the arm at the start of a cycle."""
        self.state = state
        self.ahead = state.moved(self.filter.ahead) if self.filter.active else state

    def compute(self, target: Target) -> Step | None:
        """Return the step of the controller towards a target, without taking it; None if it is late.

        The memory keeps what is planned, but not the motion, as the arm may brake instead.
        """
        step, self.memory = self.steps.compute(self.ahead, target, self.limits, self.memory)
        if step is not None:
            self.memory = step.memory.with_motion_of(self.motion)
        return step

    def braked(self) -> Memory:
        """Return the memory after a step that decelerates all joints as much as the limits allow."""
        return self.motion.braked(self.limits, self.ahead)

    @property
    def motion(self) -> Memory:
        """The memory, or that of an arm at rest before the first step."""
        return Memory(np.zeros(self.arm.nv)) if self.memory is None else self.memory
