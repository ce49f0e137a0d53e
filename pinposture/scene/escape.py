"""Which way out, where the distance of two solids does not say.

Where the axes of two capsules meet, every direction across both is equally short; and a planar arm that
crosses something in its plane would be shorter out of the plane, where it cannot go.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

_SMALL = 1e-9


def escape_direction(first: Array, second: Array, plane: Array) -> Array:
    """The direction of the shortest translation that takes one line from another, across both if it can be.

    Args:
        first: ends of the line that is to move, (2, 3) [m].
        second: ends of the line that it meets, (2, 3) [m].
        plane: orthonormal directions in which it can move, (2, 3) or (3, 3).

    Returns:
        Unit vector in the span of `plane`, (3,); the same for the same arguments.
    """
    moving, still = first @ plane.T, second @ plane.T
    u, v = moving[1] - moving[0], still[1] - still[0]
    size = max(float(np.linalg.norm(u)), float(np.linalg.norm(v)), 1e-300)
    apart = moving.mean(axis=0) - still.mean(axis=0)
    if len(plane) == 2:
        across = [np.array([-line[1], line[0]]) for line in (u, v)]
        directions = [line / np.linalg.norm(line) for line in across if np.linalg.norm(line) > _SMALL * size]
        if not directions:  # both are points in the plane
            gap = float(np.linalg.norm(apart))
            return np.asarray((apart / gap if gap > 0.0 else np.array([1.0, 0.0])) @ plane)
        return np.asarray(_shortest(moving, still, directions) @ plane)
    normal = np.cross(u, v)
    if np.linalg.norm(normal) <= _SMALL * size * size:  # parallel: across the line, from middle to middle
        line = (u if np.linalg.norm(u) >= np.linalg.norm(v) else v) / size
        normal = apart - line * (line @ apart)
        if np.linalg.norm(normal) <= _SMALL * size:
            normal = np.cross(line, np.eye(3)[np.argmin(np.abs(line))])
            if np.linalg.norm(normal) == 0.0:  # two points in one place
                normal = np.array([0.0, 0.0, 1.0])
    return np.asarray((normal / np.linalg.norm(normal)) @ plane)


def _shortest(moving: Array, still: Array, directions: list[Array]) -> Array:
    """Of several directions and their opposites, the one along which the lines are soonest apart."""
    best, least = directions[0], np.inf
    for direction in directions:
        for sign in (1.0, -1.0):
            way = sign * direction
            needed = float((still @ way).max() - (moving @ way).min())
            if needed < least - 1e-12:
                best, least = way, needed
    return best
