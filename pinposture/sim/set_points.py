"""Motions of every kind as what servos are sent: joint positions at equal distances in time."""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple, TypeAlias

import numpy as np
from numpy.typing import ArrayLike, NDArray

from pinposture.arm import Arm
from pinposture.errors import InvalidValue
from pinposture.motion import JointTrajectory, Motion, Trajectory
from pinposture.placement import Target

Array = NDArray[np.float64]

AnyMotion: TypeAlias = "Trajectory | Motion | JointTrajectory | ArrayLike"
"""A run, a motion in time, a joint trajectory, or configurations (N, nq)."""

EVEN = 1e-6
"""Share by which distances between rows may differ and still be equal."""


class SetPoints(NamedTuple):
    """Set-points of the servos of an arm.

    Attributes:
        positions: joint positions, (N, nv) [rad or m]; a continuous joint counts its turns.
        dt: time from one row to the next [s].
    """

    positions: Array
    dt: float

    def targets(self, arm: Arm) -> Callable[[float], Target]:
        """The posture of the motion at a time [s], for a controller that is to follow it; the last stays."""

        def at(time: float) -> Target:
            row = min(round(time / self.dt), len(self.positions) - 1)
            return Target.from_configuration(arm, arm.configuration(self.positions[row]))

        return at


def set_points(arm: Arm, motion: AnyMotion, dt: float | None = None) -> SetPoints:
    """Turn a motion into set-points.

    Args:
        arm: the arm that is to move.
        motion: the motion; joints of another arm are matched by name.
        dt: time from one row to the next [s]; needed for configurations and for a run whose limits have none.
            Other runs have no other than theirs; a joint trajectory is sampled anew, by cubic polynomials, as
            it is where its rows are not at equal distances.

    Raises:
        InvalidValue: the motion is not one of this arm, or its rows have no time.
    """
    timed = _timed(arm, motion, dt).matched(arm)
    gaps = np.diff(timed.time)
    if not len(gaps):
        raise InvalidValue("motion (rows)", len(timed.time), "at least two")
    if np.ptp(gaps) > EVEN * gaps.max():
        timed = timed.sampled(float(np.median(gaps)))
        gaps = np.diff(timed.time)
    return SetPoints(timed.positions, float(gaps.mean()))


def _timed(arm: Arm, motion: AnyMotion, dt: float | None) -> JointTrajectory:
    if isinstance(motion, Motion):
        return motion.run.joint_trajectory(dt, force=True)
    if isinstance(motion, Trajectory):
        return motion.joint_trajectory(dt, force=True)
    if isinstance(motion, JointTrajectory):
        return motion if dt is None else motion.sampled(dt)
    if dt is None:
        raise InvalidValue("dt", None, "the time from one configuration to the next [s]")
    return JointTrajectory.from_configurations(arm, motion, dt)
