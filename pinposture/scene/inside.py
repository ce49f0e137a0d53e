"""Which obstacles a point is inside of."""

from __future__ import annotations

import coal
import numpy as np
from numpy.typing import ArrayLike

from pinposture.scene.narrow import Narrow
from pinposture.scene.scene import Scene
from pinposture.scene.solids import solid

SMALL = 1e-6
"""Radius of the ball that stands for the point [m]."""


def obstacles_around(scene: Scene, point: ArrayLike, depth: float = 1e-4) -> tuple[str, ...]:
    """Name the obstacles that a point lies in, and not just on.

    Args:
        scene: the scene.
        point: the point, (3,) [m], world frame.
        depth: how far below the surface it has to be to count [m].
    """
    ball, narrow = coal.Sphere(SMALL), Narrow()
    at = coal.Transform3s(np.eye(3), np.array(point, dtype=np.float64))
    found = []
    for name, obstacle in scene.obstacles.items():
        shape = solid(obstacle)
        there = coal.Transform3s(shape.rotation, shape.position)
        if narrow.distance((ball, at, shape.geometry, there)) < -depth - SMALL:
            found.append(name)
    return tuple(found)
