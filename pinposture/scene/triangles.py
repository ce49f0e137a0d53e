"""Distances between straight lines of finite length and triangles, many at a time."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from pinposture.scene.segments import Closest, closest_points

Array = NDArray[np.float64]

_FLAT = 1e-20
"""Square of the sine of the angle below which a triangle has no face: its edges say it all."""


def closest_to_triangles(a: Array, b: Array, corners: Array) -> Closest:
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
    return Closest(first[row, best], second[row, best])


def _dot(x: Array, y: Array) -> Array:
    return np.asarray(np.einsum("...i,...i->...", x, y))
