"""Symmetric block tridiagonal systems, as chains of waypoints make them."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.linalg.lapack import dpotrf, dtrtrs

Array = NDArray[np.float64]


def solve_tridiagonal(diagonal: Array, above: Array, right: Array) -> Array | None:
    """Solve a symmetric positive definite block tridiagonal system by block Cholesky, in O(N n^3).

    Args:
        diagonal: diagonal blocks, (N, n, n).
        above: blocks right of the diagonal ones, (N - 1, n, n).
        right: right-hand side, (N, n).

    Returns:
        The solution (N, n), or None if the matrix is not positive definite.
    """
    count = len(diagonal)
    factors: list[Array] = []
    couplings: list[Array] = []
    solution = np.empty_like(right)
    for i in range(count):
        block, side = diagonal[i], right[i]
        if i:
            block = block - couplings[-1].T @ couplings[-1]
            side = side - couplings[-1].T @ solution[i - 1]
        factor, failed = dpotrf(block, lower=1, clean=0)
        if failed:
            return None
        factors.append(factor)
        solution[i] = dtrtrs(factor, side, lower=1)[0]
        if i < count - 1:
            couplings.append(dtrtrs(factor, above[i], lower=1)[0])
    for i in reversed(range(count)):
        side = solution[i] - couplings[i] @ solution[i + 1] if i < count - 1 else solution[i]
        solution[i] = dtrtrs(factors[i], side, lower=1, trans=1)[0]
    return solution
