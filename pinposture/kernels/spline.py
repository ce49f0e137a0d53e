"""Values and derivatives of B-splines in space."""

from __future__ import annotations

import numpy as np

from pinposture.kernels.arrays import Array1, Array2, Array3
from pinposture.kernels.compiled import compiled, subkernel


@compiled
def spline_coefficients(t: Array1, c: Array2, degree: int) -> Array3:
    """Coefficients of a B-spline and of all its derivatives, which are B-splines on the same knots.

    Args:
        t: knots, (n + degree + 1,).
        c: coefficients, (n, 3).
        degree: 1 to 5.

    Returns:
        Those of the derivative of order p in the first n - p rows of [p], (degree + 1, n, 3).
    """
    n = len(c)
    table = np.zeros((degree + 1, n, 3))
    for i in range(n):
        table[0, i, 0], table[0, i, 1], table[0, i, 2] = c[i, 0], c[i, 1], c[i, 2]
    for p in range(1, degree + 1):
        for i in range(n - p):
            width = t[i + degree + 1] - t[i + p]
            if width > 0.0:  # else it belongs to no span
                for axis in range(3):
                    rise = table[p - 1, i + 1, axis] - table[p - 1, i, axis]
                    table[p, i, axis] = (degree + 1 - p) / width * rise
    return table


@subkernel
def span_at(t: Array1, degree: int, u: float) -> int:
    """The knot span that holds u; at a knot the one that follows, at the end the last one."""
    low, high = degree, len(t) - degree - 1
    while high - low > 1:
        middle = (low + high) // 2
        if t[middle] <= u:
            low = middle
        else:
            high = middle
    while t[low + 1] <= t[low] and low > degree:
        low -= 1
    return low


@subkernel
def value(
    t: Array1, table: Array3, degree: int, order: int, span: int, u: float, work: Array2
) -> tuple[float, float, float]:
    """A derivative of the spline at u, by de Boor's recursion.

    Args:
        t: knots, (n + degree + 1,).
        table: of `spline_coefficients`.
        degree: of the spline itself.
        order: of the derivative, 0 to degree.
        span: which holds u.
        u: parameter.
        work: space for the recursion, (6, 3).

    Returns:
        x, y and z.
    """
    d = degree - order
    c = table[order]
    for i in range(d + 1):
        work[i, 0], work[i, 1], work[i, 2] = (
            c[span - degree + i, 0],
            c[span - degree + i, 1],
            c[span - degree + i, 2],
        )
    for r in range(1, d + 1):
        for i in range(d, r - 1, -1):
            left = t[span - d + i]
            a = (u - left) / (t[span + i - r + 1] - left)
            b = 1.0 - a
            work[i, 0] = b * work[i - 1, 0] + a * work[i, 0]
            work[i, 1] = b * work[i - 1, 1] + a * work[i, 1]
            work[i, 2] = b * work[i - 1, 2] + a * work[i, 2]
    return work[d, 0], work[d, 1], work[d, 2]


@compiled
def spline_values(t: Array1, table: Array3, degree: int, order: int, u: Array1) -> Array2:
    """A derivative of the spline, (n, 3), at parameters u (n,); zero if its order is above the degree."""
    out = np.zeros((len(u), 3))
    if order <= degree:
        work = np.empty((6, 3))
        for i in range(len(u)):
            out[i, 0], out[i, 1], out[i, 2] = value(
                t, table, degree, order, span_at(t, degree, u[i]), u[i], work
            )
    return out
