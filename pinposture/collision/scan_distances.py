"""The distance of an arm from a scan."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import NamedTuple, Protocol, TypeAlias

import coal
import numpy as np
from numpy.typing import NDArray
from scipy.spatial import ConvexHull

from pinposture.collision.distances import ClosestPoints, Narrow, closest_points
from pinposture.collision.obstacles import Box, Capsule, Cylinder, Mesh, Obstacle, Solid, Sphere, solid

# Which points or triangles of a scan can be nearest to an arm: a tree of boxes.
#
# The tree is a complete one: each split halves a block of points or triangles along the axis in which it
# spreads most, so that all blocks of a level are equally large and can be worked with at once. Each block
# has a box along its own principal axes, which is thin where the scan is a wall, and a point of the scan in
# it.

Array = NDArray[np.float64]
Indices = NDArray[np.intp]

LEAF = {"points": 16, "triangles": 6}
"""The most points or triangles of a block that is not split."""
STRIDE = 3
"""Splits between one level that is looked at and the next."""
_SLACK = 1e-12
"""What boxes are wider for rounding, relative to their coordinates."""


class Axes(NamedTuple):
    """What holds, and what lies in, each of the bodies that a scan is near to.

    Attributes:
        outer: ends of the axes of capsules that contain the bodies, (b, 2, 3) [m].
        outer_radii: radii of these capsules, (b,) [m].
        inner: ends of the axes of capsules that lie in the bodies, (b, 2, 3) [m].
        inner_radii: radii of these capsules, (b,) [m]; may be 0.
    """

    outer: Array
    outer_radii: Array
    inner: Array
    inner_radii: Array


class Near(NamedTuple):
    """Pairs among which the nearest one is.

    Attributes:
        bodies: index of the body of each pair, (p,).
        members: index of the point or triangle of each pair, (p,).
        lower: a bound below the distance of each pair, (p,) [m].
    """

    bodies: Indices
    members: Indices
    lower: Array

    def where(self, chosen: NDArray[np.bool_]) -> Near:
        """Some of the pairs, by a mask (p,)."""
        return Near(self.bodies[chosen], self.members[chosen], self.lower[chosen])


class _Level(NamedTuple):
    """The boxes of one level.

    Attributes:
        centers: (k, 3) [m].
        axes: columns are the axes of the boxes, (k, 3, 3).
        halves: half the edges, (k, 3) [m].
        points: a point of the scan in each, (k, 3) [m].
        fanout: boxes of the next level in each, or members for the last level.
    """

    centers: Array
    axes: Array
    halves: Array
    points: Array
    fanout: int


class ScanTree:
    """The tree of a scan; may be shared between threads.

    Attributes:
        corners: the points as (n, 1, 3), or the corners of the triangles, (n, 3, 3) [m].
    """

    def __init__(self, corners: Array) -> None:
        """Build the tree.

        Args:
            corners: of each member, (n, c, 3) [m]; at least one member.
        """
        self.corners = corners
        count, of = corners.shape[0], LEAF["points" if corners.shape[1] == 1 else "triangles"]
        splits = max(0, int(np.ceil(np.log2(count / of))))
        size = -(-count // 2**splits)  # of the blocks that are not split
        # Blocks are equally large because some members are in the tree twice.
        order = np.resize(np.arange(count), size * 2**splits)
        middles = corners.mean(axis=1)
        first = splits % STRIDE + (STRIDE if splits > STRIDE else 0)
        looked_at = [
            level for level in range(splits + 1) if level >= first and (splits - level) % STRIDE == 0
        ]
        self._levels: list[_Level] = []
        for level in range(splits + 1):
            blocks = order.reshape(2**level, -1)
            if level in looked_at:
                fanout = blocks.shape[1] if level == splits else 2**STRIDE
                self._levels.append(_boxes(corners, middles, blocks, fanout))
            if level < splits:
                order = _halved(middles, blocks)
        self._members = order.reshape(2**splits, size)

    def near(self, axes: Axes) -> Near:
        """The pairs of a body and a point or triangle that can be the nearest of all, at least one."""
        starts, ends = axes.inner[:, 0], axes.inner[:, 1]
        middles = axes.outer.mean(axis=1)
        reaches = (axes.outer[:, 1] - axes.outer[:, 0]) / 2.0
        count = len(middles)
        bodies = np.repeat(np.arange(count), len(self._levels[0].centers))
        nodes = np.tile(np.arange(len(self._levels[0].centers)), count)
        least = np.inf
        for level in self._levels:
            turns = level.axes[nodes]
            offsets = np.einsum("pi,pij->pj", middles[bodies] - level.centers[nodes], turns)
            extents = np.abs(np.einsum("pi,pij->pj", reaches[bodies], turns))
            # The box around the line, along the axes of the block's box.
            gaps = np.maximum(np.abs(offsets) - extents - level.halves[nodes], 0.0)
            lower = np.sqrt(np.einsum("pi,pi->p", gaps, gaps)) - axes.outer_radii[bodies]
            points = level.points[nodes]
            there = closest_points(points, points, starts[bodies], ends[bodies])
            upper = np.linalg.norm(there.first - there.second, axis=1) - axes.inner_radii[bodies]
            least = min(least, float(upper.min()))
            kept = lower <= least + _SLACK * (1.0 + abs(least))
            bodies, nodes, lower = bodies[kept], nodes[kept], lower[kept]
            bodies, lower = np.repeat(bodies, level.fanout), np.repeat(lower, level.fanout)
            nodes = (nodes[:, None] * level.fanout + np.arange(level.fanout)).ravel()
        return Near(bodies, self._members.ravel()[nodes], lower)


def _halved(middles: Array, blocks: Indices) -> Indices:
    """The members in an order in which the halves of each block are two blocks."""
    coordinates = [middles[:, axis][blocks] for axis in range(3)]  # numpy is slow along short axes
    widest = np.argmax([np.ptp(each, axis=1) for each in coordinates], axis=0)
    along = np.choose(widest[:, None], coordinates)
    sides = np.argpartition(along, blocks.shape[1] // 2, axis=1)
    return np.take_along_axis(blocks, sides, axis=1).ravel()


def _boxes(corners: Array, middles: Array, blocks: Indices, fanout: int) -> _Level:
    """The boxes of blocks, along their principal axes."""
    inside = [corners[:, :, axis][blocks].reshape(len(blocks), -1) for axis in range(3)]
    means = np.stack([each.mean(axis=1) for each in inside], axis=1)
    offsets = [each - mean[:, None] for each, mean in zip(inside, means.T, strict=True)]
    spread = np.empty((len(blocks), 3, 3))
    for i, one in enumerate(offsets):
        for j, other in enumerate(offsets):
            spread[:, i, j] = np.einsum("kn,kn->k", one, other)
    axes = np.linalg.eigh(spread)[1]
    low, high = np.empty((len(blocks), 3)), np.empty((len(blocks), 3))
    for j in range(3):
        along = sum(axes[:, i, j, None] * each for i, each in enumerate(offsets))
        low[:, j], high[:, j] = np.min(along, axis=1), np.max(along, axis=1)
    size = np.max([np.abs(each).max(axis=1) for each in inside], axis=0)
    halves = (high - low) / 2.0 + _SLACK * size[:, None]
    centers = means + np.einsum("kij,kj->ki", axes, (low + high) / 2.0)
    squares = sum((middles[:, axis][blocks] - centers[:, axis, None]) ** 2 for axis in range(3))
    points = middles[blocks[np.arange(len(blocks)), np.argmin(squares, axis=1)]]
    return _Level(centers, axes, halves, points, fanout)


# Distances between straight lines of finite length and triangles, many at a time.

_FLAT = 1e-20
"""Square of the sine of the angle below which a triangle has no face: its edges say it all."""


def closest_to_triangles(a: Array, b: Array, corners: Array) -> ClosestPoints:
    """The nearest points of the lines from a to b and of triangles.

    A line may be a single point, and a triangle a line or a point.

    Args:
        a: ends of the lines, (n, 3) [m].
        b: their other ends, (n, 3) [m].
        corners: of the triangles, (n, 3, 3) [m].

    Returns:
        Points of the lines and of the triangles; the same point where a line goes through a triangle.
    """
    # Either an edge has the nearest point, or an end of the line stands above the face, or it is pierced.
    edges = closest_points(a[:, None], b[:, None], corners, corners[:, [1, 2, 0]])
    sides = corners[:, [1, 2, 0]] - corners
    normals = np.cross(sides[:, 0], -sides[:, 2])
    squares = _dot(normals, normals)
    lengths = _dot(sides, sides).max(axis=1)
    flat = squares <= _FLAT * lengths * lengths
    safe = np.where(flat, 1.0, squares)
    heights = [_dot(end - corners[:, 0], normals) / safe for end in (a, b)]  # in normals
    pierced = (heights[0] > 0.0) != (heights[1] > 0.0)
    apart = heights[0] - heights[1]
    share = np.where(pierced, heights[0] / np.where(apart == 0.0, 1.0, apart), 0.0)
    meeting = a + share[:, None] * (b - a)
    lines = np.stack([a, b, meeting], axis=1)
    feet = np.stack(
        [a - heights[0][:, None] * normals, b - heights[1][:, None] * normals, meeting], axis=1
    )  # (n, 3, 3)
    inward = np.cross(normals[:, None], sides)  # of each edge, in the plane
    above = np.all(_dot(feet[:, :, None] - corners[:, None], inward[:, None]) >= 0.0, axis=2)
    above &= ~flat[:, None]
    above[:, 2] &= pierced
    first, second = np.concatenate([edges.first, lines], axis=1), np.concatenate([edges.second, feet], axis=1)
    gaps = _dot(first - second, first - second)
    gaps[:, 3:][~above] = np.inf
    best, row = np.argmin(gaps, axis=1), np.arange(len(gaps))
    return ClosestPoints(first[row, best], second[row, best])


def _dot(x: Array, y: Array) -> Array:
    return np.asarray(np.einsum("...i,...i->...", x, y))


# The deepest point of each of many triangles in a convex solid.

FINE = 1e-5
"""How closely the deepest point is found [m]."""
_GRID = np.linspace(0.0, 1.0, 9)
_FACTOR = 4.0
"""By how much the grid gets finer in a round: what is left are two of its eight parts."""


def deepest_points(height: Callable[[Array], Array], corners: Array) -> tuple[Array, Array]:
    """The points of triangles at which a convex function is smallest.

    Args:
        height: the function, of points (n, 3) [m].
        corners: of the triangles, (t, 3, 3) [m].

    Returns:
        The points, (t, 3) [m], and what the function is there, (t,).
    """
    start, first, second = corners[:, 0], corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]

    def places(share: Array, other: Array) -> Array:
        """Points at a share (t, ...) of one side, and a share of what that leaves of the other."""
        extra = (1,) * (share.ndim - 1)
        a, u, v = (each.reshape(-1, *extra, 3) for each in (start, first, second))
        return np.asarray(a + share[..., None] * u + ((1.0 - share) * other)[..., None] * v)

    def across(share: Array) -> tuple[Array, Array]:
        """Where along the other side the function is smallest, (t, ...), and what it is there."""

        def at(other: Array) -> Array:
            points = places(np.broadcast_to(share[..., None], other.shape), other)
            return height(points.reshape(-1, 3)).reshape(other.shape)

        return _narrowed(at, share.shape, rounds)

    size = max(float(np.linalg.norm(side, axis=1).max()) for side in (first, second))
    rounds = max(1, int(np.ceil(np.log(max(size, FINE) / FINE) / np.log(_FACTOR))))
    # What is smallest along one side is a convex function of the place along the other.
    share, values = _narrowed(lambda share: across(share)[1], (len(corners),), rounds)
    return places(share, across(share)[0]), values


def _narrowed(function: Callable[[Array], Array], shape: tuple[int, ...], rounds: int) -> tuple[Array, Array]:
    """Where convex functions of a number in [0, 1] are smallest, many at once.

    Args:
        function: takes numbers (*shape, 9) and returns as many.
        shape: of the functions.
        rounds: how often to look closer.
    """
    low, high = np.zeros(shape), np.ones(shape)
    for _ in range(rounds):
        tried = low[..., None] + (high - low)[..., None] * _GRID
        values = function(tried)
        best = np.argmin(values, axis=-1)[..., None]
        # On both sides of the best of them the function rises: the smallest is between its neighbours.
        low = np.take_along_axis(tried, np.maximum(best - 1, 0), axis=-1)[..., 0]
        high = np.take_along_axis(tried, np.minimum(best + 1, len(_GRID) - 1), axis=-1)[..., 0]
    found = np.take_along_axis(tried, best, axis=-1)[..., 0]
    return found, np.take_along_axis(values, best, axis=-1)[..., 0]


# How far points are from a body, and how deep in it: exactly, many at a time, in the frame of its joint.

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


# The distance of bodies from a scan: a tree for what may be nearest, then exactly.
#
# How far a body is from a scan is how far the scan's nearest point is from the body's surface; where there
# are points in the body, minus how deep the deepest of them lies. For balls and capsules both have closed
# forms, for points and for triangles. For others coal tells how far they are from triangles, and a search
# how deep these go.

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
