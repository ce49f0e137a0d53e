"""Distances from solids by their formulas, for the tests of what hands do to obstacles."""

from __future__ import annotations

import numpy as np
from nearest import distances_to_nearest
from scipy.spatial import ConvexHull

import pinposture as pp
from pinposture.collision import Obstacle


def signed_distance(obstacle: Obstacle, points: np.ndarray) -> np.ndarray:
    """Distance of points from an obstacle's surface, negative inside; of a mesh, from its planes."""
    obstacle = obstacle.geometry
    if isinstance(obstacle, pp.Sphere):
        return np.linalg.norm(points - obstacle.center, axis=1) - obstacle.radius
    if isinstance(obstacle, pp.HalfSpace):
        return (points - obstacle.point) @ np.array(obstacle.normal)
    if isinstance(obstacle, pp.Box):
        local = np.abs((points - obstacle.center) @ np.array(obstacle.rotation)) - np.array(obstacle.size) / 2
        return np.linalg.norm(np.maximum(local, 0), axis=1) + np.minimum(local.max(axis=1), 0)
    if isinstance(obstacle, pp.Mesh):
        planes = ConvexHull(np.array(obstacle.vertices)).equations
        local = (points - obstacle.center) @ np.array(obstacle.rotation)
        return (local @ planes[:, :3].T + planes[:, 3]).max(axis=1)
    if isinstance(obstacle, pp.Scan):
        there = obstacle.points @ np.array(obstacle.rotation).T + obstacle.center
        return distances_to_nearest(points, there)
    start = np.array(obstacle.start)
    way = np.subtract(obstacle.end, obstacle.start)
    length = np.linalg.norm(way)
    along = (points - start) @ way / length
    off = np.linalg.norm(points - start - np.outer(along, way / length), axis=1)
    if isinstance(obstacle, pp.Capsule):
        return np.hypot(off, along - np.clip(along, 0, length)) - obstacle.radius
    both = np.stack([off - obstacle.radius, np.abs(along - length / 2) - length / 2], axis=1)
    return np.linalg.norm(np.maximum(both, 0), axis=1) + np.minimum(both.max(axis=1), 0)
