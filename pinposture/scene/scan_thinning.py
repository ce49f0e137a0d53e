"""A few of many points that lie as the many do: one in each of many cubes."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

_ENOUGH = 0.8
"""Share of the points that may be left below which smaller cubes are tried."""
_TRIES = 12
_CELLS = 2**20
"""The most cubes along an axis, so that three numbers of cubes fit into one."""


def representatives(points: Array, count: int) -> tuple[NDArray[np.intp], NDArray[np.intp]]:
    """Choose at most so many points that there is one in each cube that has any.

    Args:
        points: the points, more than `count` of them, (n, 3) [m].
        count: how many, at least 1.

    Returns:
        Indices of those that are kept, (c,), and for each of the points which of these is in its cube, (n,).
    """
    low, width = points.min(axis=0), float(np.ptp(points, axis=0).max())
    best = np.zeros(1, dtype=np.intp), np.zeros(len(points), dtype=np.intp)
    if width == 0.0 or count == 1:
        return best
    # On a surface the number of cubes goes with the square of their number along an edge.
    least, most, cells = 0.5, float(_CELLS), min(np.sqrt(count), _CELLS)
    for _ in range(_TRIES):
        found = _in_cubes(points, low, width, cells)
        if len(found[0]) > count:
            most = cells
        else:
            least = cells
            if len(found[0]) > len(best[0]):
                best = found
            if len(best[0]) >= _ENOUGH * count:
                break
        guess = cells * np.sqrt(0.9 * count / len(found[0]))
        cells = guess if least < guess < most else (least + most) / 2.0
    return best


def between_cubes(faces: NDArray[np.integer], cubes: NDArray[np.intp]) -> NDArray[np.intp]:
    """Triangles from cube to cube; those within one or two, and those that are there already, are left out.

    Args:
        faces: triangles as indices of points, (t, 3).
        cubes: which cube each point is in, (n,), as from `representatives`.
    """
    moved = cubes[faces]
    moved = moved[(moved != np.roll(moved, 1, axis=1)).all(axis=1)]
    _, first = np.unique(np.sort(moved, axis=1), axis=0, return_index=True)
    return np.asarray(moved[np.sort(first)])


def _in_cubes(
    points: Array, low: Array, width: float, cells: float
) -> tuple[NDArray[np.intp], NDArray[np.intp]]:
    """The first point in each cube of an edge `width / cells`, and for each point which of these it is."""
    at = np.minimum((points - low) * (cells / width), _CELLS).astype(np.int64)
    keys = (at[:, 0] << 42) | (at[:, 1] << 21) | at[:, 2]
    _, first, inverse = np.unique(keys, return_index=True, return_inverse=True)
    return first, inverse.reshape(-1)
