"""The surfaces of obstacles, as triangles."""

from __future__ import annotations

from typing import TypeAlias

import numpy as np
from numpy.typing import NDArray

from pinposture.scene import Box, Capsule, Cylinder, Mesh, Sphere
from pinposture.view import mesh as triangles
from pinposture.view.convex import box_corners, hull_faces

Array = NDArray[np.float64]
Solid: TypeAlias = "Sphere | Capsule | Cylinder | Box | Mesh"

SIDES = 48
"""Corners of the polygon that stands for a circle; an obstacle may be large, and corners would show."""


def surface(obstacle: Solid) -> triangles.Mesh:
    """The surface of an obstacle other than a half-space, which has no end, world frame [m]."""
    if isinstance(obstacle, Sphere):
        center = np.array(obstacle.center)
        return _revolved(center, np.array([0.0, 0.0, 1.0]), _arc(obstacle.radius, -1.0, 1.0))
    if isinstance(obstacle, (Capsule, Cylinder)):
        start, radius = np.array(obstacle.start), obstacle.radius
        length = float(np.linalg.norm(np.subtract(obstacle.end, start)))
        if isinstance(obstacle, Capsule):
            profile = np.vstack([_arc(radius, -1.0, 0.0), _arc(radius, 0.0, 1.0) + (0.0, length)])
        else:  # rims twice: an edge that two faces share would be shaded as if it were round
            profile = np.array([[0.0, 0.0], [radius, 0.0], [radius, 0.0], [radius, length]])
            profile = np.vstack([profile, [[radius, length], [0.0, length]]])
        return _revolved(start, np.subtract(obstacle.end, start) / length, profile)
    if isinstance(obstacle, Box):
        half = np.array(obstacle.size) / 2.0
        corners = box_corners(-half, half)
    else:
        corners = np.array(obstacle.vertices)
    placed = corners @ np.array(obstacle.rotation).T + obstacle.center
    return faceted(placed, hull_faces(placed))


def faceted(corners: Array, faces: NDArray[np.intp]) -> triangles.Mesh:
    """A surface none of whose triangles share corners, so that each is shaded as the flat face it is."""
    return triangles.Mesh(corners[faces].reshape(-1, 3), np.arange(3 * len(faces)).reshape(-1, 3))


def _arc(radius: float, first: float, last: float) -> Array:
    """Distance from the axis and height along it, from one latitude to another, quarter turns, (n, 2)."""
    count = 1 + round(SIDES / 4 * (last - first))
    latitude = np.pi / 2.0 * np.linspace(first, last, count)
    return radius * np.column_stack([np.cos(latitude), np.sin(latitude)])


def _revolved(origin: Array, axis: Array, profile: Array) -> triangles.Mesh:
    """The surface that a line sweeps when it turns about an axis.

    Args:
        origin: a point of the axis, (3,) [m].
        axis: unit vector along it, (3,).
        profile: distance from the axis and height above the origin, upwards, (n, 2) [m].
    """
    side = np.cross(np.eye(3)[np.abs(axis).argmin()], axis)
    side /= np.linalg.norm(side)
    around = 2.0 * np.pi * np.arange(SIDES) / SIDES
    spokes = np.outer(np.cos(around), side) + np.outer(np.sin(around), np.cross(axis, side))
    vertices = origin + profile[:, 0, None, None] * spokes + profile[:, 1, None, None] * axis
    ring, corner = np.meshgrid(np.arange(len(profile) - 1), np.arange(SIDES), indexing="ij")
    a, b = (ring * SIDES + corner).ravel(), (ring * SIDES + (corner + 1) % SIDES).ravel()
    faces = np.vstack([np.stack([a, b, b + SIDES], 1), np.stack([a, b + SIDES, a + SIDES], 1)])
    vertices = vertices.reshape(-1, 3)
    # Where the line meets the axis, or goes over one circle twice, there is nothing between its corners.
    p, q, r = vertices[faces].transpose(1, 0, 2)
    area = np.linalg.norm(np.cross(q - p, r - p), axis=1)
    return triangles.Mesh(vertices, faces[area > 1e-9 * area.max()])
