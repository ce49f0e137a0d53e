"""Move a curve to an arm, and measure how far the arm is from it."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
import pinocchio as pin
from numpy.typing import NDArray

from pinposture.arm import Arm
from pinposture.curve import Curve
from pinposture.errors import TargetError

Array = NDArray[np.float64]

ON_CURVE = 1e-9  # distance from a curve that counts as zero, relative to the arm length
MIN_MOVEMENT = 1e-9  # smallest translation [m] and rotation [rad] that count as having moved a curve

SAMPLES_PER_LINK, REFINEMENTS = 4, 5
"""Number of parts of a link in the search for its farthest point, and number of rounds of that search."""


class Moved(NamedTuple):
    """How a curve was moved to the arm from where it was drawn.

    Attributes:
        translation: of its start, (3,) [m], world frame.
        rotation: about its start, as a rotation vector, (3,) [rad], world frame.
    """

    translation: tuple[float, float, float]
    rotation: tuple[float, float, float]

    @property
    def distance(self) -> float:
        """Distance by which its start was moved [m]."""
        return math.hypot(*self.translation)

    @property
    def angle(self) -> float:
        """Angle by which it was turned [rad]."""
        return math.hypot(*self.rotation)

    def __str__(self) -> str:
        changes = (("moved", self.distance, "m"), ("turned", self.angle, "rad"))
        parts = [f"{verb} by {size:.4g} {unit}" for verb, size, unit in changes if size > MIN_MOVEMENT]
        return " and ".join(parts) or "where it was drawn"

    def __bool__(self) -> bool:
        return max(self.distance, self.angle) > MIN_MOVEMENT


class Placement(NamedTuple):
    """Positions of the modules of an arm on a curve.

    Attributes:
        positions: joint positions, (nv,) [rad or m]; zero for modules that could not be placed.
        parameters: arc length of each control point, (m,) [m]; the curve's end where it could not be placed.
        failure: why a module, and all after it, could not be placed; None if all are placed.
        placed_by: for each module the kinematics that placed it, by name; or "least squares"; (m,).
    """

    positions: Array
    parameters: Array
    failure: TargetError | None
    placed_by: tuple[str, ...] = ()


def place_curve(arm: Arm, curve: Curve, placement: str | None, roll: float) -> tuple[Curve, Moved]:
    """Move a curve to an arm as `resolve_targets` describes; return it and how it was moved.

    A plane curve for a planar arm is also rolled into the arm's plane, by the smaller angle.
    """
    if placement == "as_is":
        return curve, Moved((0.0, 0.0, 0.0), (0.0, 0.0, 0.0))
    turn = np.eye(3)
    if placement != "translate":
        axis = arm_axis(arm)
        turn = _least_rotation(curve.tangent(0.0), axis)
        if arm.dimension == 2 and curve.dimension == 2:
            turn = _roll_into_plane(arm, curve, turn, axis) @ turn
        if roll != 0.0:
            turn = _rotation(axis, roll) @ turn
    translation = tuple((arm.chain.base - curve.start).tolist())
    moved = Moved(translation, tuple(pin.log3(turn).tolist()))
    return curve.moved(turn, arm.chain.base - turn @ curve.start), moved


def beginning(arm: Arm, curve: Curve) -> tuple[float, bool]:
    """Return the arc length of the point of a curve nearest to the base [m], and whether the base is on it.

    A base that slides without limits (`Arm.roaming`) drives to the start of a curve that it is not on.
    """
    tolerance = ON_CURVE * arm.length
    if math.dist(curve.start, arm.chain.base) <= tolerance:
        return 0.0, True
    nearest, distance = curve.nearest(arm.chain.base)
    if distance > tolerance and np.any(arm.roaming):
        return 0.0, False
    return float(nearest), float(distance) <= tolerance


def distance_from_curve(arm: Arm, q: Array, curve: Curve) -> float:
    """Return the distance of the point of the arm farthest from a curve [m].

    Links are straight between joint centres, control points and the tip (`ArmState.links`). A planar arm is
    projected onto the plane of its base. Each point is measured to the nearest point of the curve, so a curve
    that goes on beyond the tip adds nothing.

    Args:
        arm: the arm.
        q: configuration, (nq,).
        curve: the curve, placed in the world.

    Returns:
        The distance, found by sampling ever more finely around the farthest point; a peak narrower than a
        quarter of a link may be missed.
    """
    ends = arm.chain.flattened(arm.at(q).compiled.links)
    starts, links = ends[:-1], np.diff(ends, axis=0)
    longest = float(np.linalg.norm(links, axis=1).max())
    parts = np.maximum(np.ceil(SAMPLES_PER_LINK * np.linalg.norm(links, axis=1) / longest), 1.0).astype(int)
    link = np.repeat(np.arange(len(links)), parts + 1)
    share = np.concatenate([np.linspace(0.0, 1.0, count + 1) for count in parts])
    farthest = 0.0
    for _ in range(REFINEMENTS):
        distances = curve.nearest(starts[link] + share[:, None] * links[link]).distance
        best = int(np.argmax(distances))
        farthest = max(farthest, float(distances[best]))
        center, width = share[best], 1.0 / parts[link[best]]
        parts = parts * SAMPLES_PER_LINK
        share = np.clip(np.linspace(center - width, center + width, 2 * SAMPLES_PER_LINK + 1), 0.0, 1.0)
        link = np.full(len(share), link[best])
    return farthest


def arm_axis(arm: Arm) -> Array:
    """Return the direction from the base to the tip of the straight arm, unit vector (3,), world frame."""
    if arm_axis not in arm.cache:
        reach = arm.chain.flattened(arm.at(arm.straight()).compiled.points[-1]) - arm.chain.base
        direction = np.asarray(reach / max(float(np.linalg.norm(reach)), 1e-300))
        direction.flags.writeable = False
        arm.cache[arm_axis] = direction
    axis: Array = arm.cache[arm_axis]
    return axis


def _rotation(axis: Array, angle: float) -> Array:
    """Return the rotation (3, 3) about a unit axis (3,) by an angle [rad]."""
    return np.asarray(pin.AngleAxis(angle, axis).toRotationMatrix())


def _least_rotation(a: Array, b: Array) -> Array:
    """Return the rotation (3, 3) by the smallest angle that turns unit vector a into unit vector b."""
    normal = np.cross(a, b)
    sine, cosine = math.hypot(*normal), float(a @ b)
    if sine < 1e-12:  # parallel: no turn, or half a turn about any normal
        any_normal = np.cross(b, np.eye(3)[np.argmin(np.abs(b))])
        return _rotation(any_normal / np.linalg.norm(any_normal), 0.0 if cosine > 0 else math.pi)
    return _rotation(normal / sine, math.atan2(sine, cosine))


def _roll_into_plane(arm: Arm, curve: Curve, aligned: Array, axis: Array) -> Array:
    """Return the rotation (3, 3) about the arm's axis that brings a plane curve into a planar arm's plane."""
    points = (curve.resample(200) - curve.start) @ aligned.T
    off_axis = points - (points @ axis)[:, None] * axis
    widest = off_axis[np.argmax(np.einsum("ij,ij->i", off_axis, off_axis))]
    if math.hypot(*widest) < 1e-9 * curve.length:  # a straight line lies in every plane
        return np.eye(3)
    normal = np.cross(*arm.plane)
    angle = math.atan2(widest @ normal, widest @ np.cross(normal, axis))
    return _rotation(axis, math.pi * round(angle / math.pi) - angle)
