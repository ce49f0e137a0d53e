"""Solids as distances need them: for coal, and as bounds that numpy can work with many at a time."""

from __future__ import annotations

from typing import NamedTuple

import coal
import numpy as np
from numpy.typing import NDArray

from pinposture.scene.mesh import Mesh
from pinposture.scene.obstacles import Box, Capsule, Cylinder, HalfSpace, Obstacle, Sphere

Array = NDArray[np.float64]


class Solid(NamedTuple):
    """A solid in some frame.

    Attributes:
        geometry: the shape for coal.
        rotation: from the axes of that shape to the frame, (3, 3).
        position: its origin in the frame, (3,) [m].
        start: one end of the axis of a capsule that contains the solid, (3,) [m].
        end: the other end, (3,) [m]; the same for a sphere.
        radius: radius of that capsule [m]; infinite for a half-space, which none contains.
        round: True if the solid is that capsule, and not just inside of it.
        center: centre of a box with the axes of `rotation` that contains the solid, (3,) [m].
        half: half the edges of that box, (3,) [m].
        bound: which bound of it is best: "capsule", "box", or "plane" with the normal z and a point `center`.
    """

    geometry: coal.CollisionGeometry
    rotation: Array
    position: Array
    start: Array
    end: Array
    radius: float
    round: bool
    center: Array
    half: Array
    bound: str


def solid(shape: Obstacle) -> Solid:
    """Prepare a shape for distances."""
    if isinstance(shape, Sphere):
        center = np.array(shape.center)
        half = np.full(3, shape.radius)
        geometry = coal.Sphere(shape.radius)
        return Solid(geometry, np.eye(3), center, center, center, shape.radius, True, center, half, "capsule")
    if isinstance(shape, (Capsule, Cylinder)):
        start, end, radius = np.array(shape.start), np.array(shape.end), shape.radius
        length, center, turn = float(np.linalg.norm(end - start)), (start + end) / 2.0, _along(end - start)
        round_ = isinstance(shape, Capsule)
        geometry = (coal.Capsule if round_ else coal.Cylinder)(radius, length)
        half = np.array([radius, radius, length / 2.0 + round_ * radius])
        return Solid(geometry, turn, center, start, end, radius, round_, center, half, "capsule")
    if isinstance(shape, HalfSpace):
        normal, place = np.array(shape.normal), np.array(shape.point)
        geometry = coal.Halfspace(np.array([0.0, 0.0, 1.0]), 0.0)  # the points with z <= 0
        whole = np.full(3, np.inf)
        return Solid(geometry, _along(normal), place, place, place, np.inf, False, place, whole, "plane")
    turn, center = np.array(shape.rotation), np.array(shape.center)
    if isinstance(shape, Box):
        half = np.array(shape.size) / 2.0
        corners = np.array(np.meshgrid(*np.stack([-half, half], axis=1))).reshape(3, 8).T
        geometry, middle = coal.Box(*shape.size), center
    else:
        corners = np.array(shape.vertices)
        low, high = corners.min(axis=0), corners.max(axis=0)
        half, middle = (high - low) / 2.0, center + turn @ ((high + low) / 2.0)
        geometry = _convex(shape)
    start, end, radius = _capsule_around(corners @ turn.T + center)
    return Solid(geometry, turn, center, start, end, radius, False, middle, half, "box")


def _along(axis: Array) -> Array:
    """A rotation that turns z along an axis."""
    z = axis / np.linalg.norm(axis)
    x = np.cross(np.eye(3)[np.argmin(np.abs(z))], z)
    x /= np.linalg.norm(x)
    return np.stack([x, np.cross(z, x), z], axis=1)


def _convex(mesh: Mesh) -> coal.Convex:
    points, faces = coal.StdVec_Vec3s(), coal.StdVec_Triangle()
    for vertex in mesh.vertices:
        points.append(np.array(vertex))
    for face in mesh.faces():
        faces.append(coal.Triangle(*map(int, face)))
    return coal.Convex(points, faces)


def _capsule_around(points: Array) -> tuple[Array, Array, float]:
    """A capsule that contains points: along the direction in which they spread most."""
    middle = (points.min(axis=0) + points.max(axis=0)) / 2.0
    offsets = points - middle
    axis = np.linalg.svd(offsets, full_matrices=False)[2][0]
    along = offsets @ axis
    across = np.linalg.norm(offsets - np.outer(along, axis), axis=1)
    radius = float(across.max()) * (1.0 + 1e-9)
    # A point may lie beyond an end of the axis by as much as the ball there reaches at its distance across.
    reach = np.sqrt(radius**2 - across**2)
    first, last = float(np.min(along + reach)), float(np.max(along - reach))
    if first > last:  # a single ball holds them all
        first = last = (first + last) / 2.0
    return middle + first * axis, middle + last * axis, radius
