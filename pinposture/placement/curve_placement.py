"""Laying a curve at an arm, and what it means that modules have their places on it."""

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

ROUNDING = 1e-9
"""Slack for positions, relative to the arm length, and for joint limits [rad]."""


UNMOVED = 1e-9
"""How far a curve may be moved and still be where it was [m and rad]."""


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
        """How far its start was moved [m]."""
        return math.hypot(*self.translation)

    @property
    def angle(self) -> float:
        """How far it was turned [rad]."""
        return math.hypot(*self.rotation)

    def __str__(self) -> str:
        parts = (("moved", self.distance, "m"), ("turned", self.angle, "rad"))
        said = [f"{how} by {much:.4g} {unit}" for how, much, unit in parts if much > UNMOVED]
        return " and ".join(said) or "where it was drawn"

    def __bool__(self) -> bool:
        return max(self.distance, self.angle) > UNMOVED


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


def lay(arm: Arm, curve: Curve, placement: str | None, roll: float) -> Curve:
    """Move a curve to an arm; see `resolve_targets`.

    A plane curve for a planar arm is also rolled into the arm's plane, by the smaller angle.
    """
    return laid(arm, curve, placement, roll)[0]


def laid(arm: Arm, curve: Curve, placement: str | None, roll: float) -> tuple[Curve, Moved]:
    """The curve moved to an arm, and how; as `lay`."""
    if placement == "as_is":
        return curve, Moved((0.0, 0.0, 0.0), (0.0, 0.0, 0.0))
    turn = np.eye(3)
    if placement != "translate":
        axis = arm_axis(arm)
        turn = _least_rotation(curve.tangent(0.0), axis)
        if arm.dimension == 2 and curve.dimension == 2:
            turn = _into_plane(arm, curve, turn, axis) @ turn
        if roll != 0.0:
            turn = _rotation(axis, roll) @ turn
    way = (arm.chain.base - curve.start).tolist()
    moved = Moved((way[0], way[1], way[2]), _rotation_vector(turn))
    return curve.moved(turn, arm.chain.base - turn @ curve.start), moved


def _rotation_vector(turn: Array) -> tuple[float, float, float]:
    x, y, z = pin.log3(turn).tolist()
    return x, y, z


def beginning(arm: Arm, curve: Curve) -> tuple[float, bool]:
    """Arc length at which the base of an arm comes nearest to a curve [m], and whether it is on it.

    A base that slides without real limits (`Arm.roaming`) drives to the start of a curve that it is not on.
    """
    slack = ROUNDING * arm.length
    if math.dist(curve.start, arm.chain.base) <= slack:
        return 0.0, True
    nearest, distance = curve.nearest(arm.chain.base)
    if distance > slack and np.any(arm.roaming):
        return 0.0, False
    return float(nearest), float(distance) <= slack


SAMPLES_PER_LINK, ZOOMS = 4, 5
"""Into how many parts a link is cut to find its farthest place, and how often again around that place."""


def distance_from_curve(arm: Arm, q: Array, curve: Curve) -> float:
    """How far the whole arm is from a curve: the farthest of all places along its links from the curve [m].

    Links are straight between the centres of joints, control points and the tip (`ArmState.links`). A planar
    arm is seen in the plane of its base: links and a tip that lie beside it are not farther for that. What
    counts is the nearest place of the curve, so that one that goes on beyond the tip makes no difference.

    Args:
        arm: the arm.
        q: configuration, (nq,).
        curve: the curve, placed in the world.

    Returns:
        The distance, from samples that close in on the farthest place; it may miss a peak that is narrower
        than a quarter of a link.
    """
    ends = arm.chain.flattened(arm.at(q).compiled.links)
    starts, ways = ends[:-1], np.diff(ends, axis=0)
    longest = float(np.linalg.norm(ways, axis=1).max())
    parts = np.maximum(np.ceil(SAMPLES_PER_LINK * np.linalg.norm(ways, axis=1) / longest), 1.0).astype(int)
    link = np.repeat(np.arange(len(ways)), parts + 1)
    share = np.concatenate([np.linspace(0.0, 1.0, count + 1) for count in parts])
    farthest = 0.0
    for _ in range(ZOOMS):
        distances = curve.nearest(starts[link] + share[:, None] * ways[link]).distance
        best = int(np.argmax(distances))
        farthest = max(farthest, float(distances[best]))
        at, width = share[best], 1.0 / parts[link[best]]
        parts = parts * SAMPLES_PER_LINK
        share = np.clip(np.linspace(at - width, at + width, 2 * SAMPLES_PER_LINK + 1), 0.0, 1.0)
        link = np.full(len(share), link[best])
    return farthest


def arm_axis(arm: Arm) -> Array:
    """Direction in which the arm stretches from its base, unit vector (3,), world frame."""
    if arm_axis not in arm.cache:
        arm.cache[arm_axis] = _stretch(arm)
    axis: Array = arm.cache[arm_axis]
    return axis


def _stretch(arm: Arm) -> Array:
    reach = arm.chain.flattened(arm.at(arm.straight()).compiled.points[-1]) - arm.chain.base
    axis: Array = np.asarray(reach / max(float(np.linalg.norm(reach)), 1e-300))
    axis.flags.writeable = False
    return axis


def _rotation(axis: Array, angle: float) -> Array:
    """Rotation (3, 3) about a unit axis (3,) by an angle [rad]: the formula of Rodrigues."""
    (x, y, z), c, s = axis.tolist(), math.cos(angle), math.sin(angle)
    v = 1.0 - c
    return np.array(
        [
            [c + v * x * x, v * x * y - s * z, v * x * z + s * y],
            [v * x * y + s * z, c + v * y * y, v * y * z - s * x],
            [v * x * z - s * y, v * y * z + s * x, c + v * z * z],
        ]
    )


def _cross(a: Array, b: Array) -> Array:
    """Cross product of two vectors (3,); NumPy's takes five times as long for a single one."""
    (a0, a1, a2), (b0, b1, b2) = a.tolist(), b.tolist()
    return np.array([a1 * b2 - a2 * b1, a2 * b0 - a0 * b2, a0 * b1 - a1 * b0])


def _least_rotation(a: Array, b: Array) -> Array:
    """The rotation (3, 3) by the smallest angle that turns unit vector a into unit vector b."""
    across = _cross(a, b)
    sine, cosine = math.hypot(*across), float(a @ b)
    if sine < 1e-12:  # parallel: nothing to do, or half a turn about any axis across
        any_across = _cross(b, np.eye(3)[np.argmin(np.abs(b))])
        return _rotation(any_across / np.linalg.norm(any_across), 0.0 if cosine > 0 else math.pi)
    return _rotation(across / sine, math.atan2(sine, cosine))


def _into_plane(arm: Arm, curve: Curve, aligned: Array, axis: Array) -> Array:
    """Roll about the arm's axis that brings a plane curve into the plane of a planar arm, (3, 3)."""
    points = (curve.resample(200) - curve.start) @ aligned.T
    off_axis = points - (points @ axis)[:, None] * axis
    widest = off_axis[np.argmax(np.einsum("ij,ij->i", off_axis, off_axis))]
    if math.hypot(*widest) < 1e-9 * curve.length:  # a straight line lies in every plane
        return np.eye(3)
    normal = _cross(*arm.plane)
    angle = math.atan2(widest @ normal, widest @ _cross(normal, axis))
    return _rotation(axis, math.pi * round(angle / math.pi) - angle)
