"""The deepest point of each of many triangles in a convex solid."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

FINE = 1e-5
"""How closely the deepest point is found [m]."""
_GRID = np.linspace(0.0, 1.0, 9)
_FACTOR = 4.0
"""By how much the grid gets finer in a round: what is left are two of its eight parts."""


def deepest_points(height: Callable[[Array], Array], corners: Array) -> tuple[Array, Array]:
    """The points of triangles at which a convex function is smallest.

    Args:
        height: the function, of points (n, 3) [m].
        corners: of the triangles, (t, 3, 3) [m].

    Returns:
        The points, (t, 3) [m], and what the function is there, (t,).
    """
    start, first, second = corners[:, 0], corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]

    def places(share: Array, other: Array) -> Array:
        """Points at a share (t, ...) of one side, and a share of what that leaves of the other."""
        extra = (1,) * (share.ndim - 1)
        a, u, v = (each.reshape(-1, *extra, 3) for each in (start, first, second))
        return np.asarray(a + share[..., None] * u + ((1.0 - share) * other)[..., None] * v)

    def across(share: Array) -> tuple[Array, Array]:
        """Where along the other side the function is smallest, (t, ...), and what it is there."""

        def at(other: Array) -> Array:
            points = places(np.broadcast_to(share[..., None], other.shape), other)
            return height(points.reshape(-1, 3)).reshape(other.shape)

        return _narrowed(at, share.shape, rounds)

    size = max(float(np.linalg.norm(side, axis=1).max()) for side in (first, second))
    rounds = max(1, int(np.ceil(np.log(max(size, FINE) / FINE) / np.log(_FACTOR))))
    # What is smallest along one side is a convex function of the place along the other.
    share, values = _narrowed(lambda share: across(share)[1], (len(corners),), rounds)
    return places(share, across(share)[0]), values


def _narrowed(function: Callable[[Array], Array], shape: tuple[int, ...], rounds: int) -> tuple[Array, Array]:
    """Where convex functions of a number in [0, 1] are smallest, many at once.

    Args:
        function: takes numbers (*shape, 9) and returns as many.
        shape: of the functions.
        rounds: how often to look closer.
    """
    low, high = np.zeros(shape), np.ones(shape)
    for _ in range(rounds):
        tried = low[..., None] + (high - low)[..., None] * _GRID
        values = function(tried)
        best = np.argmin(values, axis=-1)[..., None]
        # On both sides of the best of them the function rises: the smallest is between its neighbours.
        low = np.take_along_axis(tried, np.maximum(best - 1, 0), axis=-1)[..., 0]
        high = np.take_along_axis(tried, np.minimum(best + 1, len(_GRID) - 1), axis=-1)[..., 0]
    found = np.take_along_axis(tried, best, axis=-1)[..., 0]
    return found, np.take_along_axis(values, best, axis=-1)[..., 0]
