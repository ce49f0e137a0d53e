"""How far points are from a body, and how deep in it: exactly, many at a time, in the frame of its joint."""

from __future__ import annotations

from typing import NamedTuple, Protocol, TypeAlias

import coal
import numpy as np
from numpy.typing import NDArray
from scipy.spatial import ConvexHull

from pinposture.scene.mesh import Mesh
from pinposture.scene.narrow import Narrow
from pinposture.scene.obstacles import Box, Capsule, Cylinder, Obstacle, Sphere
from pinposture.scene.solids import solid

Array = NDArray[np.float64]
Axis: TypeAlias = tuple[Array, Array, float]
"""Ends (3,) [m] and radius [m] of a capsule."""

_MEET = 1e-12
"""Distance from an axis, relative to the radius, below which there is no direction away from it."""


class NearestOn(NamedTuple):
    """The point of a body's surface that is nearest to a point.

    Attributes:
        distance: from the surface, negative inside of the body [m].
        foot: the point of the surface, (3,) [m].
    """

    distance: float
    foot: Array


class ConvexBody(Protocol):
    """A convex solid.

    Attributes:
        inner: a capsule that lies in it, or a ball.
    """

    inner: Axis

    def lower(self, points: Array) -> Array:
        """Bounds below the distances of points from the surface, (n,) [m].

        Exact inside of the body, and outside of all but hulls; a convex function of the point.
        """

    def nearest(self, point: Array) -> NearestOn:
        """The point of the surface nearest to a point, (3,) [m]."""


def convex_body(shape: Obstacle) -> ConvexBody:
    """Prepare the solid of a body of an arm."""
    if isinstance(shape, Sphere):
        return _Rounded(np.array(shape.center), np.array(shape.center), shape.radius)
    if isinstance(shape, Capsule):
        return _Rounded(np.array(shape.start), np.array(shape.end), shape.radius)
    if isinstance(shape, Cylinder):
        return _Turned(np.array(shape.start), np.array(shape.end), shape.radius)
    if isinstance(shape, Box):
        return _Block(np.array(shape.center), np.array(shape.rotation), np.array(shape.size) / 2.0)
    if isinstance(shape, Mesh):
        return _Hull(shape)
    raise TypeError(f"{type(shape).__name__} is no solid of a body")


class _Rounded:
    """A ball or a capsule."""

    def __init__(self, start: Array, end: Array, radius: float) -> None:
        self.inner = start, end, radius
        self._start, self._way, self._radius = start, end - start, radius
        self._square = max(float(self._way @ self._way), 1e-300)

    def lower(self, points: Array) -> Array:
        return np.asarray(np.linalg.norm(points - self._core(points), axis=1) - self._radius)

    def nearest(self, point: Array) -> NearestOn:
        core = self._core(point[None])[0]
        gap = point - core
        size = float(np.linalg.norm(gap))
        away = gap / size if size > _MEET * self._radius else _across(self._way)
        return NearestOn(size - self._radius, core + self._radius * away)

    def _core(self, points: Array) -> Array:
        along = np.clip((points - self._start) @ self._way / self._square, 0.0, 1.0)
        return np.asarray(self._start + along[:, None] * self._way)


class _Turned:
    """A cylinder."""

    def __init__(self, start: Array, end: Array, radius: float) -> None:
        self._center, self._radius = (start + end) / 2.0, radius
        self._half = float(np.linalg.norm(end - start)) / 2.0
        self._axis = (end - start) / (2.0 * self._half)
        depth = min(radius, self._half)
        reach = (self._half - depth) * self._axis
        self.inner = self._center - reach, self._center + reach, depth

    def lower(self, points: Array) -> Array:
        heights = (points - self._center) @ self._axis
        across = np.linalg.norm(points - self._center - heights[:, None] * self._axis, axis=1)
        return _beyond(np.stack([np.abs(heights) - self._half, across - self._radius], axis=1))

    def nearest(self, point: Array) -> NearestOn:
        height = float((point - self._center) @ self._axis)
        radial = point - self._center - height * self._axis
        across = float(np.linalg.norm(radial))
        out = radial / across if across > _MEET * self._radius else _across(self._axis)
        beyond = np.array([abs(height) - self._half, across - self._radius])
        if beyond.max() < 0.0 and beyond[0] > beyond[1]:
            height = float(np.copysign(self._half, height))
        elif beyond.max() < 0.0:
            across = self._radius
        foot = min(max(height, -self._half), self._half) * self._axis + min(across, self._radius) * out
        return NearestOn(float(_beyond(beyond[None])[0]), self._center + foot)


class _Block:
    """A box."""

    def __init__(self, center: Array, rotation: Array, half: Array) -> None:
        self.inner = center, center, float(half.min())
        self._center, self._turn, self._half = center, rotation, half

    def lower(self, points: Array) -> Array:
        return _beyond(np.abs((points - self._center) @ self._turn) - self._half)

    def nearest(self, point: Array) -> NearestOn:
        local = (point - self._center) @ self._turn
        beyond = np.abs(local) - self._half
        foot = np.clip(local, -self._half, self._half)
        if beyond.max() < 0.0:
            side = int(np.argmax(beyond))
            foot[side] = np.copysign(self._half[side], local[side])
        return NearestOn(float(_beyond(beyond[None])[0]), self._center + self._turn @ foot)


class _Hull:
    """A convex mesh."""

    def __init__(self, mesh: Mesh) -> None:
        prepared = solid(mesh)
        self._geometry, self._narrow = prepared.geometry, Narrow()
        self._place = coal.Transform3s(prepared.rotation, prepared.position)
        corners = np.array(mesh.vertices) @ prepared.rotation.T + prepared.position
        planes = ConvexHull(corners).equations
        self._normals, self._offsets = planes[:, :3], planes[:, 3]
        middle = corners.mean(axis=0)
        self.inner = middle, middle, max(-float(self.lower(middle[None])[0]), 0.0)

    def lower(self, points: Array) -> Array:
        return np.asarray((points @ self._normals.T + self._offsets).max(axis=1))

    def nearest(self, point: Array) -> NearestOn:
        heights = self._normals @ point + self._offsets
        face = int(np.argmax(heights))
        plane = NearestOn(float(heights[face]), point - heights[face] * self._normals[face])
        if plane.distance <= 0.0:
            return plane
        # The nearest point of the plane need not be on the face; if it is, coal finds the same.
        there = coal.Transform3s(np.eye(3), point)
        found = self._narrow.contact((self._geometry, self._place, coal.Sphere(0.0), there))
        return NearestOn(found.distance, found.point) if found.distance > plane.distance else plane


def _beyond(excess: Array) -> Array:
    """Distance from what is the product of intervals, by how far each coordinate is beyond its own."""
    outside = np.linalg.norm(np.maximum(excess, 0.0), axis=1)
    return np.asarray(outside + np.minimum(excess.max(axis=1), 0.0))


def _across(axis: Array) -> Array:
    """A unit vector across a line; any for a point."""
    direction = np.cross(axis, np.eye(3)[np.argmin(np.abs(axis))])
    size = float(np.linalg.norm(direction))
    return np.asarray(direction / size if size > 0.0 else np.array([0.0, 0.0, 1.0]))
