"""The arm as it is at the moment, and what it makes of what was last asked of it."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from pinposture.arm import Arm, ArmState
from pinposture.collision import Scene
from pinposture.control import Controller, Limits
from pinposture.editor.verdict import NEAR_LIMIT, Verdict
from pinposture.motion.tracker import Report
from pinposture.placement import Target
from pinposture.task import Keyframe

Array = NDArray[np.float64]

BINDS = 0.999
"""Share of its speed limit at which a joint is at it."""


class Problem(NamedTuple):
    """What is asked of the arm.

    Attributes:
        number: rises with everything that is asked.
        arm: the arm.
        keyframe: whose shape to take.
        controller: what moves the arm there.
        limits: within what; the cycle is the solver's own.
        scene: what to keep clear of; None if there is nothing.
        at_once: whether to be there at once, whatever the limits.
        asked: when it was asked, by `time.monotonic` [s].
        shaping: whether the shape was made by hand of the one before, so that what the arm does is near.
        passing: whether the hand is still at it, so that it is not worth a long search.
    """

    number: int
    arm: Arm
    keyframe: Keyframe
    controller: Controller
    limits: Limits
    scene: Scene | None
    at_once: bool
    asked: float
    shaping: bool = False
    passing: bool = False


class Live(NamedTuple):
    """The arm as it is at the moment.

    Attributes:
        number: of the problem that was last looked at.
        arm: the arm.
        verdict: what the arm can make of it.
        state: where the arm is.
        target: what it is on its way to; None if there was nothing yet that it could take.
        errors: distance of each control point from its target, zero where it has none, (m,) [m].
        tip_error: by how much the task of the tip is missed [m]; None without one.
        active: which control points are in the active control set, (m,).
        at_limit: which joints of the chain are at a limit of position or speed, (n,).
        status: as in `Report`.
        reason: why it does not move on, in words.
        lag: from asking to the first step towards it [s]; None if that is to come.
        steps: how many there were in all.
    """

    number: int
    arm: Arm
    verdict: Verdict
    state: ArmState
    target: Target | None
    errors: Array
    tip_error: float | None
    active: NDArray[np.bool_]
    at_limit: NDArray[np.bool_]
    status: str
    reason: str
    lag: float | None
    steps: int

    @property
    def mean_error(self) -> float:
        """Mean distance of the control points from their targets [m]; 0 without a target."""
        if self.target is None:
            return 0.0
        return float(self.errors[self.target.placed].mean())


def errors_of(state: ArmState, target: Target | None) -> Array:
    """Distance of each control point from its target, zero where it has none, (m,) [m]."""
    if target is None:
        return np.zeros(len(state.points))
    return np.asarray(np.linalg.norm(target.points - state.points, axis=1) * target.placed)


def active_of(report: Report, count: int) -> NDArray[np.bool_]:
    """Which of the control points are in the active control set, (m,)."""
    active = np.zeros(count, dtype=np.bool_)
    if report.step is not None:
        active[list(report.step.active)] = True
    return active


def at_limit(state: ArmState, dq: Array, bound: Array) -> NDArray[np.bool_]:
    """Which joints of the chain are at a limit.

    Args:
        state: where the arm is.
        dq: its last step, (nv,) [rad or m].
        bound: the longest that steps may be, (nv,) [rad or m].

    Returns:
        For each joint from base to tip, (n,).
    """
    arm = state.arm
    room = np.minimum(state.positions - arm.limits.lower, arm.limits.upper - state.positions)
    fast = np.abs(dq) >= BINDS * bound
    at = (room < NEAR_LIMIT * arm.joint_units) | fast
    return np.asarray(at[arm.columns])
