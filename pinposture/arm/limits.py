"""How far and how fast the joints of an arm may move."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
import pinocchio as pin
from numpy.typing import NDArray

Array = NDArray[np.float64]

UNLIMITED = 1e9
"""A limit this large [rad, m, rad/s or m/s] is none: files write 1e16 or the largest float for it."""

UNREAL = 100.0
"""Room with which position limits are none [arm lengths, or rad]: files write +-1e6 where they mean that."""


class JointLimits(NamedTuple):
    """Limits of the joints, one entry per degree of freedom; infinite where there is none.

    Attributes:
        lower: smallest joint position, (nv,) [rad or m].
        upper: largest joint position, (nv,) [rad or m].
        velocity: largest joint speed, (nv,) [rad/s or m/s].
    """

    lower: Array
    upper: Array
    velocity: Array


def joint_limits(model: pin.Model) -> JointLimits:
    """Read the limits of a model; continuous joints have none, a speed limit of zero means none.

    So do limits of `UNLIMITED` or more.
    """
    lower, upper = np.full(model.nv, -np.inf), np.full(model.nv, np.inf)
    velocity = np.array(model.velocityLimit, dtype=np.float64)
    for joint in list(model.joints)[1:]:  # the first one is the world, which claims entries of its own
        if joint.nq == joint.nv == 1:
            lower[joint.idx_v] = model.lowerPositionLimit[joint.idx_q]
            upper[joint.idx_v] = model.upperPositionLimit[joint.idx_q]
    # A model built by hand has the largest floats for limits it was never given.
    lower[lower <= -UNLIMITED], upper[upper >= UNLIMITED] = -np.inf, np.inf
    velocity[(velocity <= 0.0) | (velocity >= UNLIMITED)] = np.inf
    for array in (lower, upper, velocity):
        array.flags.writeable = False
    return JointLimits(lower, upper, velocity)


def without_limits(lower: Array, upper: Array, slides: NDArray[np.bool_], length: float) -> NDArray[np.bool_]:
    """Which joints have no real limits of their positions: none, or limits so wide that they mean none.

    Args:
        lower: smallest positions, (n,) [rad or m].
        upper: largest positions, (n,) [rad or m].
        slides: True for a joint that slides, (n,).
        length: of the arm, with its slides at zero [m].

    Returns:
        True where there is more than 100 arm lengths to slide, or more than 100 rad to turn, (n,).
    """
    return np.asarray(upper - lower > UNREAL * np.where(slides, length, 1.0))


def carry_base(without: NDArray[np.bool_], revolute: NDArray[np.bool_]) -> NDArray[np.bool_]:
    """Which joints are slides without real limits on which the base stands, as of a mobile robot, (n,).

    They come before the first joint that turns; there are none where no joint does.

    Args:
        without: True for a joint without real limits, from base to tip, (n,).
        revolute: True for a joint that turns, (n,).
    """
    return np.asarray(without & ~np.logical_or.accumulate(revolute) & np.any(revolute))
