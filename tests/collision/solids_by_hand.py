"""Distances of solids by means that share nothing with the package: projections on convex sets."""

from __future__ import annotations

import numpy as np

from pinposture.collision import Box, Capsule, Cylinder, HalfSpace, Sphere


def nearest_on_line(point, start, end):
    way = end - start
    return start + np.clip((point - start) @ way / (way @ way), 0.0, 1.0) * way


def project(point, shape):
    """The point of a convex solid nearest to a point."""
    if isinstance(shape, HalfSpace):
        height = (point - np.array(shape.point)) @ np.array(shape.normal)
        return point - max(height, 0.0) * np.array(shape.normal)
    if isinstance(shape, Box):
        turn = np.array(shape.rotation)
        center = np.array(shape.center)
        half = np.array(shape.size) / 2
        return center + turn @ np.clip(turn.T @ (point - center), -half, half)
    if isinstance(shape, Cylinder):
        start = np.array(shape.start)
        end = np.array(shape.end)
        length = np.linalg.norm(end - start)
        axis = (end - start) / length
        along = (point - start) @ axis
        across = point - start - along * axis
        across *= min(1.0, shape.radius / max(np.linalg.norm(across), 1e-300))
        return start + np.clip(along, 0.0, length) * axis + across
    if isinstance(shape, Capsule):
        core = nearest_on_line(point, np.array(shape.start), np.array(shape.end))
    else:
        assert isinstance(shape, Sphere)
        core = np.array(shape.center)
    gap = point - core
    return core + gap * min(1.0, shape.radius / max(np.linalg.norm(gap), 1e-300))


def separation(one, other, rounds=4000):
    """Distance of two convex solids: projections to and fro meet the nearest points; 0 where they overlap."""
    point = np.zeros(3)
    for _ in range(rounds):
        there = project(point, one)
        before = point
        point = project(there, other)
        if np.abs(point - before).max() < 1e-11:
            break
    return float(np.linalg.norm(there - point))
