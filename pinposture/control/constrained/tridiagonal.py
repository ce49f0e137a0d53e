"""Symmetric block tridiagonal systems, as chains of waypoints make them."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.linalg.lapack import dpbsv

Array = NDArray[np.float64]


def solve_tridiagonal(diagonal: Array, above: Array, right: Array) -> Array | None:
    """Solve a symmetric positive definite block tridiagonal system by band Cholesky, in O(N n^3).

    It is one call of LAPACK: many small ones, a few for each block, spend a hundred times as long waiting for
    the threads of BLAS where other processes use the cores.

    Args:
        diagonal: diagonal blocks, (N, n, n).
        above: blocks right of the diagonal ones, (N - 1, n, n).
        right: right-hand side, (N, n).

    Returns:
        The solution (N, n), or None if the matrix is not positive definite.
    """
    count, n = right.shape
    band = np.zeros((2 * n, count * n), order="F")  # element (row, column) is kept at (row - column, column)
    first = n * np.arange(count)[:, None]
    row, column = np.tril_indices(n)
    band[row - column, first + column] = diagonal[:, row, column]
    row, column = np.indices((n, n)).reshape(2, -1)
    band[n + column - row, first[:-1] + row] = above[:, row, column]
    _, solution, failed = dpbsv(band, right.ravel(), lower=1, overwrite_ab=1)
    return None if failed else np.reshape(solution, (count, n))
