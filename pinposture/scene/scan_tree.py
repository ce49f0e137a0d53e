"""Which points or triangles of a scan can be nearest to an arm: a tree of boxes.

The tree is a complete one: each split halves a block of points or triangles along the axis in which it
spreads most, so that all blocks of a level are equally large and can be worked with at once. Each block has a
box along its own principal axes, which is thin where the scan is a wall, and a point of the scan in it.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from pinposture.scene.segments import closest_points

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
