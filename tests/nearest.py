"""Distances between sets of points."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike
from scipy.spatial import KDTree


def distances_to_nearest(points: ArrayLike, others: ArrayLike) -> np.ndarray:
    """The distance of each point (k, 3) from the nearest of others (n, 3), (k,)."""
    return KDTree(others).query(points)[0]
