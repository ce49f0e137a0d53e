"""Outliers of point clouds: points with few others around them, such as flying pixels beside edges."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

Array = NDArray[np.float64]

NEIGHBOURS = 8
"""Other points that a point must have around it: about its immediate neighbours on a surface, and more than
there are flying pixels together."""

SUSPECT_RATIO = 5.0
"""Distance to the eighth neighbour, over its median, above which a point looks like an outlier. Even samples
of surfaces, 5,000 to 200,000 points, stay below 2.3, and those of a wire below 3.9. Of 200,000 points that a
scanner sees from within a room, 3 % are farther apart."""

_SAMPLE = 10_000  # points of which the median is taken


def find_outliers(points: Array, distance: float) -> NDArray[np.bool_]:
    """Find the points that have fewer than eight others within a distance.

    Args:
        points: the points, (n, 3) [m]; copies of a point count once.
        distance: the distance [m].

    Returns:
        Whether each point is an outlier, (n,).
    """
    distinct, inverse = np.unique(points, axis=0, return_inverse=True)
    reach = _reach(distinct, cKDTree(distinct), distance)
    return np.asarray((reach > distance)[inverse.reshape(-1)])


def suspect_distance(points: Array) -> float:
    """Return a distance within which almost all points have eight others, to two digits [m].

    It is 0 for fewer than nine points.
    """
    distinct = np.unique(points, axis=0)
    if len(distinct) <= NEIGHBOURS:
        return 0.0
    chosen = distinct[:: max(1, len(distinct) // _SAMPLE)]
    distance = SUSPECT_RATIO * float(np.median(_reach(chosen, cKDTree(distinct), np.inf)))
    return float(f"{distance:.2g}")


def _reach(points: Array, tree: cKDTree, most: float) -> Array:
    """Return the distance of points of a tree to the eighth neighbour, (n,) [m]; infinite beyond `most`."""
    distances, _ = tree.query(points, k=[NEIGHBOURS + 1], distance_upper_bound=np.nextafter(most, np.inf))
    return np.asarray(distances[:, 0])
