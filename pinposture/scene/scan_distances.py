"""The distance of bodies from a scan: a tree for what may be nearest, then exactly.

How far a body is from a scan is how far the scan's nearest point is from the body's surface; where there are
points in the body, minus how deep the deepest of them lies. For balls and capsules both have closed forms,
for points and for triangles. For others coal tells how far they are from triangles, and a search how deep
these go.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple, TypeAlias

import coal
import numpy as np
from numpy.typing import NDArray

from pinposture.scene.convex_bodies import ConvexBody, convex_body
from pinposture.scene.deepest import deepest_points
from pinposture.scene.narrow import Narrow
from pinposture.scene.obstacles import Obstacle
from pinposture.scene.scan_tree import Axes, Near, ScanTree
from pinposture.scene.segments import closest_points
from pinposture.scene.solids import Solid, solid
from pinposture.scene.triangles import closest_to_triangles

Array = NDArray[np.float64]

_Place: TypeAlias = tuple[Array, float]
"""A point of the scan, (3,) [m], frame of a body, and its distance from that body [m]."""

_BATCH = 64
"""Triangles that are searched together for the deepest point."""
_FIRST, _MOST = 512, 50_000
"""Pairs of a body and a point or triangle that are worked out together: the most promising, and later."""


class Found(NamedTuple):
    """The nearest point of a scan.

    Attributes:
        distance: of a body's surface from it, negative inside of the body [m].
        body: index of the body.
        on_body: the nearest point of that surface, (3,) [m].
        on_scan: the point of the scan, (3,) [m].
    """

    distance: float
    body: int
    on_body: Array
    on_scan: Array


class ScanDistances:
    """Distances of bodies from the points or triangles in a tree; may be shared between threads."""

    def __init__(self, shapes: Sequence[Obstacle], tree: ScanTree) -> None:
        """Prepare for bodies.

        Args:
            shapes: the bodies, at least one, each in the frame of its joint.
            tree: the scan.
        """
        self._tree, self._narrow = tree, Narrow()
        self._solids = [solid(shape) for shape in shapes]
        self._convex = [convex_body(shape) for shape in shapes]
        self._round = np.array([each.round for each in self._solids], dtype=np.bool_)
        self._outer = np.array([[each.start, each.end] for each in self._solids])
        self._inner = np.array([each.inner[:2] for each in self._convex])
        self._radii = np.array([each.radius for each in self._solids])
        self._depths = np.array([each.inner[2] for each in self._convex])

    def nearest(self, turns: Array, shifts: Array) -> Found:
        """The point of the scan that is nearest to a body or deepest in one.

        Args:
            turns: from the frame of each body to the world, (b, 3, 3).
            shifts: origin of that frame, (b, 3) [m], world frame.
        """
        back, shift = turns.swapaxes(1, 2), shifts[:, None]
        outer = self._outer @ back + shift
        near = self._tree.near(Axes(outer, self._radii, self._inner @ back + shift, self._depths))
        exact = self._round[near.bodies]
        body, place, below = self._least_of_round(near.where(exact), outer)
        rest = near.where(~exact)
        lowest = np.full(len(self._solids), np.inf)
        np.minimum.at(lowest, rest.bodies, rest.lower)
        for other in np.argsort(lowest):
            if lowest[other] >= below:
                break
            rows = np.flatnonzero((rest.bodies == other) & (rest.lower < below))
            corners = (self._tree.corners[rest.members[rows]] - shifts[other]) @ turns[other]
            found = self._least(int(other), corners, rest.lower[rows], below)
            if found is not None:
                body, below = int(other), found[1]
                place = turns[other] @ found[0] + shifts[other]
        nearest = self._convex[body].nearest((place - shifts[body]) @ turns[body])
        return Found(nearest.distance, body, turns[body] @ nearest.foot + shifts[body], place)

    def _least_of_round(self, near: Near, outer: Array) -> tuple[int, Array, float]:
        """The nearest pair with a ball or a capsule: index, point of the scan, (3,) [m], and distance [m].

        Args:
            near: the pairs; if there are none, the index is -1 and the distance infinite.
            outer: ends of the axes of all bodies, (b, 2, 3) [m], world frame.
        """
        body, place, below = -1, np.zeros(3), np.inf
        order, start, size = np.argsort(near.lower), 0, _FIRST
        while start < len(order) and near.lower[order[start]] < below:
            rows = order[start : start + size]
            start, size = start + size, min(4 * size, _MOST)
            bodies, corners = near.bodies[rows], self._tree.corners[near.members[rows]]
            starts, ends = outer[bodies, 0], outer[bodies, 1]
            if corners.shape[1] == 1:
                found = closest_points(starts, ends, corners[:, 0], corners[:, 0])
            else:
                found = closest_to_triangles(starts, ends, corners)
            distances = np.linalg.norm(found.first - found.second, axis=1) - self._radii[bodies]
            k = int(np.argmin(distances))
            if distances[k] < below:
                body, place, below = int(bodies[k]), found.second[k], float(distances[k])
        return body, place, below

    def _least(self, body: int, corners: Array, lower: Array, below: float) -> _Place | None:
        """The nearest or deepest point for a body that is not round, and its distance [m].

        Args:
            body: index of the body.
            corners: of points or triangles, (n, c, 3) [m], frame of the body.
            lower: bounds below their distances, (n,) [m].
            below: what the distance has to be less than [m]; if none is, the answer is None.
        """
        convex = self._convex[body]
        middles = corners.mean(axis=1)
        best, below = _least_of_points(convex, middles, lower, below)
        if corners.shape[1] == 1:
            return best
        # No point of a triangle is nearer than its middle by more than it is away from that.
        sizes = np.linalg.norm(corners - middles[:, None], axis=2).max(axis=1)
        lower = np.maximum(lower, convex.lower(middles) - sizes)
        inside = below <= 0.0
        for k in np.argsort(lower):
            if inside or lower[k] >= below:
                break
            distance, point = _nearest_of(self._solids[body], corners[k], self._narrow)
            inside = not distance > 0.0  # nor where coal cannot tell
            if 0.0 < distance < below:
                best, below = (point, distance), distance
        return _deepest(convex, corners, lower, best, below) if inside else best


def _least_of_points(
    convex: ConvexBody, points: Array, lower: Array, below: float
) -> tuple[_Place | None, float]:
    """The nearest or deepest of points, None if none is nearer than `below`; and how near it is then [m]."""
    best = None
    lower = np.maximum(lower, convex.lower(points))
    for k in np.argsort(lower):
        if lower[k] >= below:
            break
        distance = convex.nearest(points[k]).distance
        if distance < below:
            best, below = (points[k], distance), distance
    return best, below


def _nearest_of(body: Solid, corners: Array, narrow: Narrow) -> tuple[float, Array]:
    """Distance of a triangle from a body [m], not positive if they overlap; and its nearest point, (3,)."""
    points, faces = coal.StdVec_Vec3s(), coal.StdVec_Triangle()
    for corner in corners:
        points.append(corner)
    faces.append(coal.Triangle(0, 1, 2))
    faces.append(coal.Triangle(0, 2, 1))
    place = coal.Transform3s(body.rotation, body.position)
    contact = narrow.contact((body.geometry, place, coal.Convex(points, faces), coal.Transform3s()))
    return contact.distance, contact.point - contact.distance * contact.normal


def _deepest(
    convex: ConvexBody, corners: Array, lower: Array, best: _Place | None, below: float
) -> _Place | None:
    """The deepest point of triangles of which some overlap a body, if it is deeper than what is known."""
    order = np.argsort(lower)
    for k in range(0, len(order), _BATCH):
        batch = order[k : k + _BATCH]
        batch = batch[lower[batch] < below]
        if not len(batch):
            break
        points, values = deepest_points(convex.lower, corners[batch])
        if values.min() < below:
            found, below = _least_of_points(convex, points, values, below)
            best = found or best
    return best
