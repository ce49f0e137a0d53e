"""Taking hold of obstacles: where they are, how they are turned, and what becomes of them when pulled."""

from __future__ import annotations

from copy import copy
from dataclasses import replace
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from pinposture._validation import Matrix, Vector
from pinposture._validation import point as checked_point
from pinposture.arm import Arm
from pinposture.collision import Box, Capsule, Cylinder, HalfSpace, Mesh, Obstacle, Sphere

Array = NDArray[np.float64]

GAP = 0.025
"""How far outside of an obstacle the handles are that change its size, relative to the arm."""

LEAST = 2e-3
"""How small an obstacle can be pulled, relative to the arm."""

ASIDE = 0.3
"""How far beside the middle of a half-space its handle is, relative to the arm."""

DIGITS = 6
"""Digits behind the point to which places and sizes that come from the mouse are rounded [m]."""


class Measures(NamedTuple):
    """What is large and what is small around an arm.

    Attributes:
        middle: where half-spaces, which have no end, are taken hold of: the point of theirs nearest to it,
            (3,) [m], world frame.
        length: of the arm [m].
    """

    middle: Array
    length: float

    @classmethod
    def of(cls, arm: Arm) -> Measures:
        """Those of an arm: the middle is half way along it where it is straight."""
        state = arm.at(arm.straight())
        return cls(0.5 * (arm.chain.base + state.points[-1]), arm.length)

    @property
    def gap(self) -> float:
        """How far outside of an obstacle handles are [m]."""
        return GAP * self.length

    @property
    def least(self) -> float:
        """How small obstacles can be pulled [m]."""
        return LEAST * self.length


class Pose(NamedTuple):
    """Where an obstacle is.

    Attributes:
        position: of its middle, (3,) [m], world frame.
        rotation: from its axes to the world's, (3, 3). The third is the axis of what has but one.
    """

    position: Array
    rotation: Array


class Grip(NamedTuple):
    """A handle that changes the size of an obstacle.

    Attributes:
        name: "x", "y", "z", "radius", "start", "end" or "height".
        place: where it is, (3,) [m], world frame.
    """

    name: str
    place: Array


def pose_of(obstacle: Obstacle, measures: Measures) -> Pose:
    """Where an obstacle is."""
    if isinstance(obstacle, Sphere):
        return Pose(np.array(obstacle.center), np.eye(3))
    if isinstance(obstacle, Box):
        return Pose(np.array(obstacle.center), np.array(obstacle.rotation))
    if isinstance(obstacle, Mesh):
        turn = np.array(obstacle.rotation)
        return Pose(obstacle.center + turn @ _center(obstacle), turn)
    if isinstance(obstacle, HalfSpace):
        normal = np.array(obstacle.normal)
        height = normal @ (measures.middle - obstacle.point)
        return Pose(measures.middle - height * normal, turn_to(normal))
    start, end = np.array(obstacle.start), np.array(obstacle.end)
    return Pose(0.5 * (start + end), turn_to(end - start))


def at_pose(obstacle: Obstacle, pose: Pose) -> Obstacle:
    """An obstacle elsewhere, otherwise turned.

    Raises:
        InvalidValue: a place beyond all bounds.
    """
    position, turn = pose
    if isinstance(obstacle, Sphere):
        return replace(obstacle, center=_rounded(position))
    if isinstance(obstacle, Box):
        return replace(obstacle, center=_rounded(position), rotation=_matrix(turn))
    if isinstance(obstacle, Mesh):
        return _placed(obstacle, position - turn @ _center(obstacle), turn)
    if isinstance(obstacle, HalfSpace):
        return replace(obstacle, point=_rounded(position), normal=_vector(turn[:, 2]))
    half = 0.5 * float(np.linalg.norm(np.subtract(obstacle.end, obstacle.start))) * turn[:, 2]
    return replace(obstacle, start=_rounded(position - half), end=_rounded(position + half))


def moved(obstacle: Obstacle, shift: ArrayLike) -> Obstacle:
    """An obstacle elsewhere, turned as it was.

    Args:
        obstacle: the obstacle.
        shift: how far, (3,) [m], world axes.

    Raises:
        InvalidValue: a place beyond all bounds.
    """
    by = np.asarray(shift, dtype=np.float64)
    if isinstance(obstacle, Mesh):
        return _placed(obstacle, obstacle.center + by, np.array(obstacle.rotation))
    if isinstance(obstacle, HalfSpace):
        return replace(obstacle, point=_rounded(obstacle.point + by))
    if isinstance(obstacle, (Capsule, Cylinder)):
        return replace(obstacle, start=_rounded(obstacle.start + by), end=_rounded(obstacle.end + by))
    return replace(obstacle, center=_rounded(obstacle.center + by))


def grips(obstacle: Obstacle, measures: Measures) -> tuple[Grip, ...]:
    """The handles that change the size of an obstacle, just outside of it.

    A box has them on three faces that meet; those across stay where they are. A ball has one. A cylinder and
    a capsule have one at each end, and one for the radius. A half-space has one above its surface, and a mesh
    has none.
    """
    pose, gap = pose_of(obstacle, measures), measures.gap
    if isinstance(obstacle, Box):
        half = 0.5 * np.array(obstacle.size)
        return tuple(
            Grip(name, pose.position - (half[k] + gap) * pose.rotation[:, k]) for k, name in enumerate("xyz")
        )
    if isinstance(obstacle, Sphere):
        return (Grip("radius", pose.position - (obstacle.radius + gap) * pose.rotation[:, 0]),)
    if isinstance(obstacle, HalfSpace):
        foot = pose.position - ASIDE * measures.length * pose.rotation[:, 0]
        return (Grip("height", foot + gap * pose.rotation[:, 2]),)
    if isinstance(obstacle, Mesh):
        return ()
    beyond = (gap + _cap(obstacle)) * pose.rotation[:, 2]
    return (
        Grip("start", obstacle.start - beyond),
        Grip("end", obstacle.end + beyond),
        Grip("radius", pose.position - (obstacle.radius + gap) * pose.rotation[:, 0]),
    )


def pulled(obstacle: Obstacle, grip: str, place: ArrayLike, measures: Measures) -> Obstacle:
    """An obstacle with one of its handles elsewhere, or as near to there as it can be.

    Args:
        obstacle: the obstacle.
        grip: name of the handle.
        place: where it is put, (3,) [m], world frame.
        measures: those of the arm.

    Raises:
        InvalidValue: a place beyond all bounds.
    """
    pose, gap, least = pose_of(obstacle, measures), measures.gap, measures.least
    off = np.asarray(place, dtype=np.float64) - pose.position
    if isinstance(obstacle, Box):
        axis = "xyz".index(grip)
        direction, half = pose.rotation[:, axis], 0.5 * obstacle.size[axis]
        edge = max(float(half - off @ direction) - gap, least)
        size = list(obstacle.size)
        size[axis] = round(edge, DIGITS)
        center = pose.position + (half - 0.5 * edge) * direction  # the face across stays where it is
        return replace(obstacle, center=_rounded(center), size=_vector(np.array(size)))
    if isinstance(obstacle, HalfSpace):
        height = float(off @ pose.rotation[:, 2]) - gap
        return replace(obstacle, point=_rounded(pose.position + height * pose.rotation[:, 2]))
    if isinstance(obstacle, Mesh):
        return obstacle
    if grip == "radius":
        radius = max(float(-off @ pose.rotation[:, 0]) - gap, least)
        return replace(obstacle, radius=round(radius, DIGITS))
    assert not isinstance(obstacle, Sphere)
    fixed = np.array(obstacle.end if grip == "start" else obstacle.start)
    way = np.asarray(place, dtype=np.float64) - fixed
    length = float(np.linalg.norm(way))
    sign = -1.0 if grip == "start" else 1.0
    direction = way / length if length > least else sign * pose.rotation[:, 2]
    end = fixed + max(length - gap - _cap(obstacle), least) * direction
    return replace(obstacle, start=_rounded(end)) if grip == "start" else replace(obstacle, end=_rounded(end))


def turn_to(axis: ArrayLike) -> Array:
    """The shortest turn that lays the third axis along another, (3, 3)."""
    x, y, z = np.asarray(axis, dtype=np.float64) / np.linalg.norm(np.asarray(axis, dtype=np.float64))
    if z < -1.0 + 1e-12:
        return np.diag([1.0, -1.0, -1.0])
    share = 1.0 / (1.0 + z)
    return np.array(
        [[1.0 - share * x * x, -share * x * y, x], [-share * x * y, 1.0 - share * y * y, y], [-x, -y, z]]
    )


def reach(obstacle: Obstacle) -> float:
    """How far from its middle an obstacle goes [m]; 0 for a half-space."""
    if isinstance(obstacle, Sphere):
        return obstacle.radius
    if isinstance(obstacle, Box):
        return 0.5 * float(np.linalg.norm(obstacle.size))
    if isinstance(obstacle, HalfSpace):
        return 0.0
    if isinstance(obstacle, Mesh):
        return float(np.linalg.norm(np.array(obstacle.vertices) - _center(obstacle), axis=1).max())
    half = 0.5 * float(np.linalg.norm(np.subtract(obstacle.end, obstacle.start)))
    return half + obstacle.radius if isinstance(obstacle, Capsule) else float(np.hypot(half, obstacle.radius))


def _cap(obstacle: Capsule | Cylinder) -> float:
    """How far it goes on beyond its ends [m]."""
    return obstacle.radius if isinstance(obstacle, Capsule) else 0.0


def _center(mesh: Mesh) -> Array:
    """The middle of a mesh, in its own frame (3,) [m]."""
    corners = np.array(mesh.vertices)
    return np.asarray(0.5 * (corners.min(axis=0) + corners.max(axis=0)))


def _placed(mesh: Mesh, center: Array, turn: Array) -> Mesh:
    """A mesh elsewhere, without its hull being worked out again."""
    other = copy(mesh)
    object.__setattr__(other, "center", checked_point("center", _rounded(center)))
    object.__setattr__(other, "rotation", _matrix(turn))
    return other


def _rounded(place: Array) -> Vector:
    return _vector(np.round(place, DIGITS))


def _vector(numbers: Array) -> Vector:
    x, y, z = (float(each) + 0.0 for each in numbers)  # 0 rather than -0
    return x, y, z


def _matrix(turn: Array) -> Matrix:
    x, y, z = (_vector(row) for row in np.where(np.abs(turn) < 1e-12, 0.0, turn))
    return x, y, z
