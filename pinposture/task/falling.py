"""Where a joint falls to whose drive cannot hold it, while the other joints stay where they are.

The energy of the weight beyond a hinge is -R cos(a), with the angle a from where it would hang freely. R and
a follow from the torque that holds the joint, R sin(a), and from the change of that torque as the joint
turns, R cos(a). Of a slide the force is the same everywhere.
"""

from __future__ import annotations

from math import asin, atan2, copysign, cos, hypot
from typing import NamedTuple

import numpy as np
from scipy.optimize import brentq

from pinposture.arm import ArmState

LEAST_PULL = 0.1
"""Share of the largest torque by which weight can load a joint, below which weight does not tell where the
joint hangs or falls: friction, a cable or a touch does."""


class Fall(NamedTuple):
    """How a joint falls.

    Attributes:
        rest: where it comes to rest, at an end stop if one is in the way [rad or m].
        farthest: how far it swings on the way there if nothing damps it [rad or m].
    """

    rest: float
    farthest: float


def fall_of(state: ArmState, column: int, torque: float) -> Fall | None:
    """Return how a joint falls from rest.

    Args:
        state: the state of the arm.
        column: the degree of freedom of the joint, which no other joint follows.
        torque: the largest torque or force of its drive, which pulls back to where it was [N m or N].

    Returns:
        The fall; without a motion if the drive holds the joint. None if weight does not tell where to.

    Raises:
        WeightUnknown: masses that are not known.
    """
    arm = state.arm
    here = float(state.positions[column])
    pull = -float(state.gravity_torques[column])
    if torque > 0.0 and abs(pull) <= torque:
        return Fall(here, here)
    limits = (float(arm.limits.lower[column]), float(arm.limits.upper[column]))
    least = LEAST_PULL * float(arm.outstretched_torques[column])
    stiffness = 0.0 if arm.slides[column] else float(state.gravity_gradient[column, column])
    if max(stiffness, abs(pull)) <= least:
        return None
    if arm.slides[column]:
        stop = limits[1] if pull > 0.0 else limits[0]
        return Fall(stop, stop)
    size = hypot(pull, stiffness)
    angle = atan2(abs(pull), stiffness)
    hanging = asin(torque / size)
    turning = _turning_point(size, torque, angle, hanging)
    rest, farthest = np.clip(here + copysign(1.0, pull) * (angle - np.array([hanging, turning])), *limits)
    return Fall(float(rest), float(farthest))


def torque_left(state: ArmState, column: int) -> float:
    """Return the torque or force that the drive of a joint still gives which has fallen to where it is.

    It is what holds the joint there, if nothing touches the arm; 0 at an end stop, and where that is less
    than `LEAST_PULL`.

    Args:
        state: the state of the arm.
        column: the degree of freedom of the joint.

    Raises:
        WeightUnknown: masses that are not known.
    """
    arm = state.arm
    here = float(state.positions[column])
    near = 0.02 * float(arm.joint_units[column])  # of an end stop, which gives way a little
    held = abs(float(state.gravity_torques[column]))
    at_stop = min(here - arm.limits.lower[column], arm.limits.upper[column] - here) < near
    return 0.0 if at_stop or held < LEAST_PULL * arm.outstretched_torques[column] else held


def _turning_point(size: float, torque: float, angle: float, hanging: float) -> float:
    """Return how far a hinge swings to the other side of where it comes to rest [rad].

    Args:
        size: R [N m].
        torque: the torque that pulls it back [N m].
        angle: the angle from which it falls [rad].
        hanging: that at which it comes to rest [rad].
    """

    def gained(a: float) -> float:
        return size * (cos(a) - cos(angle)) - torque * (angle - a)

    if torque == 0.0:
        return -angle
    return brentq(gained, -angle, hanging) if gained(hanging) > 0.0 else hanging
