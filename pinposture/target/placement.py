"""Laying a curve at an arm, and what it means that modules have their places on it."""

from __future__ import annotations

from typing import NamedTuple
from weakref import WeakKeyDictionary

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from pinposture.arm import Arm
from pinposture.curve import Curve
from pinposture.errors import TargetError

Array = NDArray[np.float64]

ROUNDING = 1e-9
"""Slack for positions, relative to the arm length, and for joint limits [rad]."""


class Placement(NamedTuple):
    """Where the modules of an arm belong on a curve.

    Attributes:
        positions: joint positions, (nv,) [rad or m]; zero for modules without a place.
        parameters: arc length of each control point, (m,) [m]; the curve's end for those without a place.
        failure: why some module, and all after it, have no place; None if all have one.
    """

    positions: Array
    parameters: Array
    failure: TargetError | None


def lay(arm: Arm, curve: Curve, placement: str, roll: float) -> Curve:
    """Move a curve to an arm; see `resolve_targets`.

    A plane curve for a planar arm is also rolled into the arm's plane, by the smaller angle.
    """
    if placement == "as_is":
        return curve
    turn = np.eye(3)
    if placement == "align":
        axis = arm_axis(arm)
        aligned = _least_rotation(np.asarray(curve.tangent(0.0)), axis)
        if arm.dimension == 2 and curve.dimension == 2:
            aligned = _into_plane(arm, curve, aligned, axis) * aligned
        turn = (Rotation.from_rotvec(roll * axis) * aligned).as_matrix()
    return curve.moved(turn, arm.chain.base - turn @ curve.start)


def beginning(arm: Arm, curve: Curve) -> tuple[float, bool]:
    """Arc length at which the base of an arm comes nearest to a curve [m], and whether it is on it."""
    slack = ROUNDING * arm.length
    if np.linalg.norm(curve.start - arm.chain.base) <= slack:
        return 0.0, True
    nearest, distance = curve.nearest(arm.chain.base)
    return float(nearest), float(distance) <= slack


_AXES: WeakKeyDictionary[Arm, Array] = WeakKeyDictionary()


def arm_axis(arm: Arm) -> Array:
    """Direction in which the arm stretches from its base, unit vector (3,), world frame.

    Remembered as long as the arm lives, and no longer: it holds much memory.
    """
    if arm not in _AXES:
        _AXES[arm] = _stretch(arm)
    return _AXES[arm]


def _stretch(arm: Arm) -> Array:
    reach = arm.at(arm.straight()).points[-1] - arm.chain.base
    axis: Array = np.asarray(reach / max(float(np.linalg.norm(reach)), 1e-300))
    axis.flags.writeable = False
    return axis


def _least_rotation(a: Array, b: Array) -> Rotation:
    """The rotation by the smallest angle that turns unit vector a into unit vector b."""
    across = np.cross(a, b)
    sine, cosine = float(np.linalg.norm(across)), float(a @ b)
    if sine < 1e-12:  # parallel: nothing to do, or half a turn about any axis across
        any_across = np.cross(b, np.eye(3)[np.argmin(np.abs(b))])
        return Rotation.from_rotvec(any_across / np.linalg.norm(any_across) * (0.0 if cosine > 0 else np.pi))
    return Rotation.from_rotvec(across / sine * np.arctan2(sine, cosine))


def _into_plane(arm: Arm, curve: Curve, aligned: Rotation, axis: Array) -> Rotation:
    """Roll about the arm's axis that brings a plane curve into the plane of a planar arm."""
    points = aligned.apply(curve.resample(200) - curve.start)
    off_axis = points - np.outer(points @ axis, axis)
    widest = off_axis[np.argmax(np.linalg.norm(off_axis, axis=1))]
    if np.linalg.norm(widest) < 1e-9 * curve.length:  # a straight line lies in every plane
        return Rotation.identity()
    normal = np.cross(arm.plane[0], arm.plane[1])
    angle = np.arctan2(widest @ normal, widest @ np.cross(normal, axis))
    angle -= np.pi * np.round(angle / np.pi)
    return Rotation.from_rotvec(-angle * axis)
