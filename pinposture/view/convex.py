"""Convex solids, given by their corners: cut by planes, seen from afar, and what they hide."""

from __future__ import annotations

from itertools import product

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import ConvexHull

Array = NDArray[np.float64]

FLAT = 1e-7
"""Thickness relative to the size below which a solid is none any more."""


def box_corners(low: Array, high: Array) -> Array:
    """The corners of a box along the axes of the world, (8, 3) [m]."""
    return np.array(list(product(*zip(low, high, strict=True))))


def cut(corners: Array, normal: Array, offset: float) -> Array:
    """The part of a solid on the lower side of a plane.

    Args:
        corners: any points that the solid is the convex hull of, (n, 3) [m].
        normal: unit vector across the plane, (3,).
        offset: the plane is where normal . x = offset [m].

    Returns:
        Corners of the part, (k, 3) [m]; those given if the plane takes nothing away, none if it takes all.
    """
    heights = corners @ normal - offset
    if not np.any(heights > 0.0):
        return corners
    hull = ConvexHull(corners)
    edges = np.sort(hull.simplices[:, [[0, 1], [1, 2], [2, 0]]].reshape(-1, 2), axis=1)
    a, b = np.unique(edges, axis=0).T
    crossing = (heights[a] > 0.0) != (heights[b] > 0.0)
    a, b = a[crossing], b[crossing]
    share = (heights[a] / (heights[a] - heights[b]))[:, None]
    below = hull.vertices[heights[hull.vertices] <= 0.0]
    left = np.vstack([corners[below], corners[a] + share * (corners[b] - corners[a])])
    return left if _has_volume(left) else np.zeros((0, 3))


def within(corners: Array, low: Array, high: Array) -> Array:
    """The part of a solid inside a box along the axes of the world, as corners (k, 3) [m]; see `cut`."""
    for axis in range(3):
        for sign, side in ((1.0, high), (-1.0, low)):
            if len(corners):
                corners = cut(corners, sign * np.eye(3)[axis], sign * float(side[axis]))
    return corners


def hull_faces(corners: Array) -> NDArray[np.intp]:
    """Triangles around a solid, as indices of its corners, counter-clockwise from outside, (t, 3)."""
    hull = ConvexHull(corners)
    faces = np.array(hull.simplices, dtype=np.intp)
    a, b, c = corners[faces].transpose(1, 0, 2)
    inward = np.einsum("ti,ti->t", np.cross(b - a, c - a), hull.equations[:, :3]) < 0.0
    faces[inward] = faces[inward][:, ::-1]
    return faces


def facets(corners: Array) -> list[tuple[Array, Array]]:
    """The flat faces of a solid: corners (k, 3), counter-clockwise from outside, and unit normal (3,)."""
    hull = ConvexHull(corners)
    planes, which = np.unique(hull.equations.round(9), axis=0, return_inverse=True)
    listed = []
    for k, normal in enumerate(planes[:, :3]):
        face = corners[np.unique(hull.simplices[which.ravel() == k])]
        out = face - face.mean(axis=0)
        first = out[0] / np.linalg.norm(out[0])
        angles = np.arctan2(out @ np.cross(normal, first), out @ first)
        listed.append((face[np.argsort(angles)], normal))
    return listed


def section(corners: Array, origin: Array, plane: Array) -> Array:
    """Where a solid meets a plane.

    Args:
        corners: of the solid, (n, 3) [m].
        origin: a point of the plane, (3,) [m].
        plane: orthonormal directions in it, (2, 3).

    Returns:
        Corners of the section in order, (k, 2) [m], along the directions of the plane from the origin of the
        world; none if it does not meet the plane, or only just.
    """
    normal = np.cross(*plane)
    offset = float(normal @ origin)
    size = float(np.ptp(corners, axis=0).max())
    low, high = (corners @ normal - offset).min(), (corners @ normal - offset).max()
    if not low < -FLAT * size < FLAT * size < high:
        return np.zeros((0, 2))
    lower = cut(corners, normal, offset)
    face = lower[np.abs(lower @ normal - offset) <= FLAT * size]
    return rim(face @ plane.T)


def rim(flat: Array) -> Array:
    """The corners of the convex hull of points in a plane (n, 2), in order; none if they lie on a line."""
    spread = np.linalg.svd(flat - flat.mean(axis=0), compute_uv=False) if len(flat) > 2 else np.zeros(2)
    if spread[-1] <= FLAT * spread[0]:
        return np.zeros((0, 2))
    return np.asarray(flat[ConvexHull(flat).vertices])


def hidden(points: Array, corners: Array, eye: Array) -> NDArray[np.bool_]:
    """Which points a solid hides from an eye far away, or holds within itself.

    Args:
        points: (n, 3) [m].
        corners: of the solid, (k, 3) [m].
        eye: unit vector towards the eye, (3,).
    """
    sides = ConvexHull(corners).equations
    # On the way from a point to the eye, each side of the solid is passed once, inwards or outwards.
    above, rising = points @ sides[:, :3].T + sides[:, 3], sides[:, :3] @ eye
    along = np.abs(rising) < 1e-12
    passed = -above / np.where(along, 1.0, rising)
    enter = np.where(rising < 0.0, passed, -np.inf)
    leave = np.where(rising > 0.0, passed, np.inf)
    enter[:, along], leave[:, along] = -np.inf, np.inf
    aside = np.any(above[:, along] > 0.0, axis=1)
    return np.asarray(~aside & (np.maximum(enter.max(axis=1), 0.0) < leave.min(axis=1)))


def _has_volume(corners: Array) -> bool:
    if len(corners) < 4:
        return False
    spread = np.linalg.svd(corners - corners.mean(axis=0), compute_uv=False)
    return bool(spread[-1] > FLAT * spread[0])
