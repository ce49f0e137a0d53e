"""An arm under way: one step after the other towards a target, written down."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from pinposture.arm import Arm, ArmState
from pinposture.control import Controller, Diagnostics, Limits, Step
from pinposture.control.controller import Memory, next_step
from pinposture.motion.record import Recorder
from pinposture.scene import Scene
from pinposture.target import Target

Array = NDArray[np.float64]
Callback = Callable[[int, ArmState, Step], object]

PATIENCE = 6.0
"""Joint travel without a new lowest posture error after which a run is stalled [rad]: 60 usual steps."""

PROGRESS = 1e-3
"""Relative fall of the posture error that counts as progress within it."""

ROUNDING = 1e-9
"""Share by which a sum of steps may be off."""

MENTIONED = 6
"""How many limits and distances that hold an arm are listed."""


class Drive:
    """An arm, the controller that moves it, and the record of what both do.

    Attributes:
        arm: the arm.
        controller: what moves it.
        limits: what a step may not exceed.
        state: where the arm is.
        memory: what the controller remembers; None before the first step.
        last: the last step it was asked for; None before the first.
        recorder: what was written down so far.
    """

    def __init__(
        self,
        arm: Arm,
        q0: Array,
        target: Target,
        controller: Controller,
        limits: Limits,
        scene: Scene | None = None,
    ) -> None:
        self.arm, self.controller, self.limits = arm, controller, limits
        self.state = arm.at(q0)
        self.memory: Memory | None = None
        self.last: Step | None = None
        self.recorder = Recorder(target, self.state, scene)

    def ask(self, target: Target) -> Step:
        """The step that the controller would take towards a target; it is not taken."""
        before = self.memory
        step = next_step(self.controller, self.state, target, self.limits, before)
        # Whatever the controller has found out stays; the arm has not moved so yet.
        self.memory = Memory(np.zeros(self.arm.nv)) if before is None else before
        self.memory, self.last = self.memory._replace(own=step.memory.own), step
        return step

    def move(self, step: Step, target: Target | None = None) -> None:
        """Take a step and write it down.

        Args:
            step: the step.
            target: where the control points should be after it, if that has changed.
        """
        self.state, self.memory = self.arm.at(self.arm.integrate(self.state.q, step.dq)), step.memory
        self.recorder.add(self.state, step, self.limits.travel(self.state), target)

    def until_there(
        self, target: Target, tolerance: float, max_steps: int, callback: Callback | None = None
    ) -> tuple[str, str]:
        """Step on until the arm is there, stuck, or out of steps.

        Args:
            target: where its control points should be.
            tolerance: mean distance of them from there that is close enough [m].
            max_steps: number of steps of the record after which to stop.
            callback: as for `track`.

        Returns:
            Status and reason; see `track`.
        """
        while True:
            status, reason = self._verdict(tolerance, max_steps)
            if status:
                break
            step = self.ask(target)
            if step.diagnostics.reason:
                # A controller that has points to control but no step to take is stuck.
                status, reason = "stalled" if step.active else "no_control_points", step.diagnostics.reason
                break
            self.move(step)
            number = self.recorder.steps
            if callback is not None and callback(number, self.state, step) is True:
                return "stopped", f"stopped by the callback after {number} steps"
        if status in ("stalled", "max_steps") and self.last is not None:
            reason += what_holds(self.arm, self.last)
        return status, reason

    def come_to_rest(self) -> None:
        """Brake until no joint moves; without limits of acceleration that takes no step."""
        while self.memory is not None and np.any(self.memory.braked(self.limits, self.state).dq):
            self.hold()

    def hold(self) -> None:
        """Take a step that brings the arm closer to rest, as much as limits allow."""
        before = Memory(np.zeros(self.arm.nv)) if self.memory is None else self.memory
        memory = before.braked(self.limits, self.state)
        rises = self.recorder.rises(self.arm.at(self.arm.integrate(self.state.q, memory.dq)))
        still = np.zeros(self.arm.nv, dtype=np.bool_)
        note = Diagnostics(0.0, 0.0, 0.0, 0, (), 1.0, still, "", escape=rises)
        self.move(Step(memory.dq, (), note, memory))

    def _too_fast(self) -> bool:
        """Whether the arm cannot stop in the next step."""
        brake = self.limits.for_arm(self.arm).brake
        return brake is not None and self.memory is not None and bool(np.any(np.abs(self.memory.dq) > brake))

    def _verdict(self, tolerance: float, max_steps: int) -> tuple[str, str]:
        """Whether the run is over, and why; empty while it goes on."""
        mean = self.recorder.mean_error
        if mean <= tolerance and not self._too_fast():
            return "converged", f"mean point error {mean:.3g} m is within the tolerance of {tolerance:.3g} m"
        if self.recorder.steps >= max_steps:
            return "max_steps", f"mean point error {mean:.3g} m, above the tolerance of {tolerance:.3g} m"
        idle = self.recorder.travel_without_progress(PROGRESS)
        if idle >= PATIENCE * (1.0 - ROUNDING):
            return (
                "stalled",
                f"mean point error {mean:.3g} m, no progress in the last {idle:.3g} rad of joint travel",
            )
        return "", ""


def what_holds(arm: Arm, step: Step) -> str:
    """What held a step back, in words: limits that bind, and distances at their bound."""
    held = [f"{arm.joint_names[j]} at its limit" for j in np.flatnonzero(step.diagnostics.clipped)]
    held += step.diagnostics.near
    if not held:
        return ""
    more = f" and {len(held) - MENTIONED} more" if len(held) > MENTIONED else ""
    return f"; held by {', '.join(held[:MENTIONED])}{more}"
