"""Posture control matrices of a chain as J = L Q: L block lower triangular, the rows of Q orthonormal.

Nothing of size rows times joints is ever made. What the joints up to a station can still do about farther
ones, once the rows so far have what they ask for, is a motion and turning (v, w) spanned by at most six
orthonormal combinations of the joints. Those, and the joints of the next section, go through Householder
reflections: first the rows of the station become triangular, then what is left is brought back to six
columns. It is the array form of a Kalman filter with exact measurements. Nothing is squared, so the result is
as accurate as a QR decomposition of the matrix.

A station keeps its triangle R, (3, 3), and its gains K, (6, 3): what its share of the combinations does to
(v, w). With them, products with L, its transpose and their inverses are passes along the stations.
"""

from __future__ import annotations

import numpy as np

from pinposture.kernels.arrays import FULL, LOCAL, RELATIVE, Array1, Array2, Factors, Rows, Screws
from pinposture.kernels.compiled import compiled, subkernel
from pinposture.kernels.rows import joints_along, motions_along

NOTHING = 1e-60
"""Stands for a zero, so that there is an inverse of L; its square is still a number."""


@compiled
def eliminated(
    screws: Screws,
    rows: Rows,
    factors: Factors,
) -> None:
    """Decompose a posture control matrix.

    Args:
        screws: how joints move the points.
        rows: which motions the matrix consists of.
        factors: filled with L; NOTHING stands for zero on a diagonal.
    """
    b, ends, points = screws
    stations, ranks, directions, coupling = rows
    triangles, gains = factors
    widest, u = 0, 0
    for station in stations:
        widest, u = max(widest, ends[station] - u), ends[station]
    A, left = np.empty((6, widest + 6)), np.empty((6, 6))
    free, at, u = 0, 0, 0
    for k in range(len(stations)):
        E, rank, station = directions[k], ranks[k], stations[k]
        for c in range(free):
            w0, w1, w2 = left[3, c], left[4, c], left[5, c]
            _enter(A, c, E, left[0, c], left[1, c], left[2, c], w0, w1, w2, points[station], points[at])
        width, last = free, station
        if k:
            at += 1
        for point in range(at, last + 1):
            while u < ends[point]:
                s = b[u]
                _enter(A, width, E, s[0], s[1], s[2], s[3], s[4], s[5], points[last], points[point])
                width += 1
                u += 1
        at = last
        for j in range(min(rank, width)):
            _reflect(A, j, j, width)
        R, K = triangles[k], gains[k]
        for j in range(rank):
            for i in range(rank):
                R[i, j] = A[i, j] if j <= i and j < width else 0.0
            if R[j, j] == 0.0:
                R[j, j] = NOTHING
            _leave(A, j, E, K, j, j < width)
        if coupling == LOCAL:
            continue
        # The rows are settled: what is left of the columns cannot move along them.
        kept = width - rank
        first = 3 if coupling == RELATIVE else rank
        if kept > 6 - first:
            for row in range(first, 6):
                _reflect(A, row, rank + row - first, width)
            kept = 6 - first
        free = max(kept, 0)
        for j in range(rank):
            for c in range(rank, rank + free):
                A[j, c] = 0.0
        for c in range(free):
            _leave(A, rank + c, E, left, c, True)
            if coupling == RELATIVE:
                left[0, c], left[1, c], left[2, c] = 0.0, 0.0, 0.0


@subkernel
def _enter(
    A: Array2,
    column: int,
    E: Array2,
    v0: float,
    v1: float,
    v2: float,
    w0: float,
    w1: float,
    w2: float,
    to: Array1,
    since: Array1,
) -> None:
    """Take (v, w) to another point, and write it along the directions."""
    r0, r1, r2 = to[0] - since[0], to[1] - since[1], to[2] - since[2]
    v0, v1, v2 = v0 + w1 * r2 - w2 * r1, v1 + w2 * r0 - w0 * r2, v2 + w0 * r1 - w1 * r0
    for i in range(3):
        A[i, column] = E[i, 0] * v0 + E[i, 1] * v1 + E[i, 2] * v2
    A[3, column], A[4, column], A[5, column] = w0, w1, w2


@subkernel
def _leave(A: Array2, column: int, E: Array2, to: Array2, place: int, there: bool) -> None:
    """The way back from the directions to (v, w); zero if there is no such column."""
    for i in range(3):
        to[i, place] = (
            E[0, i] * A[0, column] + E[1, i] * A[1, column] + E[2, i] * A[2, column] if there else 0.0
        )
        to[3 + i, place] = A[3 + i, column] if there else 0.0


@subkernel
def _reflect(A: Array2, row: int, pivot: int, width: int) -> None:
    """Householder reflection of the columns from the pivot on, after which the row ends there."""
    head, tail = A[row, pivot], 0.0
    for c in range(pivot + 1, width):
        tail += A[row, c] * A[row, c]
    if tail == 0.0:
        return
    norm = np.sqrt(head * head + tail)
    A[row, pivot] = head + norm if head > 0.0 else head - norm
    scale = 2.0 / (A[row, pivot] * A[row, pivot] + tail)
    for i in range(6):
        if i == row or (i < row and i < pivot):
            continue
        along = 0.0
        for c in range(pivot, width):
            along += A[row, c] * A[i, c]
        along *= scale
        for c in range(pivot, width):
            A[i, c] -= along * A[row, c]
    A[row, pivot] = -norm if head > 0.0 else norm
    for c in range(pivot + 1, width):
        A[row, c] = 0.0


@subkernel
def down_stations(
    points: Array2,
    rows: Rows,
    factors: Factors,
    solve: bool,
    values: Array2,
) -> None:
    """Multiply by L, or solve with it: the pass from the base to the tip.

    Args:
        points: the points, (m, 3).
        rows: which motions the matrix consists of.
        factors: L, from `eliminated`.
        solve: True for the inverse of L.
        values: one value for each row, (p, 3); overwritten with the product.
    """
    stations, ranks, directions, coupling = rows
    triangles, gains = factors
    v0, v1, v2, w0, w1, w2 = 0.0, 0.0, 0.0, 0.0, 0.0, 0.0
    for k in range(len(stations)):
        if coupling != FULL:
            v0, v1, v2 = 0.0, 0.0, 0.0
        if coupling == LOCAL:
            w0, w1, w2 = 0.0, 0.0, 0.0
        if k:
            to, since = points[stations[k]], points[stations[k - 1]]
            r0, r1, r2 = to[0] - since[0], to[1] - since[1], to[2] - since[2]
            v0, v1, v2 = v0 + w1 * r2 - w2 * r1, v1 + w2 * r0 - w0 * r2, v2 + w0 * r1 - w1 * r0
        E, R, K, y = directions[k], triangles[k], gains[k], values[k]
        p0, p1, p2, p3, p4, p5 = v0, v1, v2, w0, w1, w2
        for i in range(ranks[k] if solve else 0):
            rest = y[i] - (E[i, 0] * v0 + E[i, 1] * v1 + E[i, 2] * v2)
            for j in range(i):
                rest -= R[i, j] * y[j]
            y[i] = rest / R[i, i]
        for j in range(ranks[k]):
            g = y[j]
            p0, p1, p2 = p0 + K[0, j] * g, p1 + K[1, j] * g, p2 + K[2, j] * g
            p3, p4, p5 = p3 + K[3, j] * g, p4 + K[4, j] * g, p5 + K[5, j] * g
        for i in range(0 if solve else ranks[k]):
            y[i] = E[i, 0] * p0 + E[i, 1] * p1 + E[i, 2] * p2
        v0, v1, v2, w0, w1, w2 = p0, p1, p2, p3, p4, p5


@subkernel
def up_stations(
    points: Array2,
    rows: Rows,
    factors: Factors,
    solve: bool,
    values: Array2,
) -> None:
    """Multiply by the transpose of L, or solve with it: the pass from the tip to the base.

    Args:
        points: the points, (m, 3).
        rows: which motions the matrix consists of.
        factors: L, from `eliminated`.
        solve: True for the inverse.
        values: one value for each row, (p, 3); overwritten with the product.
    """
    stations, ranks, directions, coupling = rows
    triangles, gains = factors
    f0, f1, f2, t0, t1, t2 = 0.0, 0.0, 0.0, 0.0, 0.0, 0.0
    before = np.empty(3)
    for k in range(len(stations) - 1, -1, -1):
        if coupling != FULL:
            f0, f1, f2 = 0.0, 0.0, 0.0
        if coupling == LOCAL:
            t0, t1, t2 = 0.0, 0.0, 0.0
        E, R, K, y, rank = directions[k], triangles[k], gains[k], values[k], ranks[k]
        for j in range(rank):
            before[j] = (
                K[0, j] * f0 + K[1, j] * f1 + K[2, j] * f2 + K[3, j] * t0 + K[4, j] * t1 + K[5, j] * t2
            )
        if solve:
            for i in range(rank - 1, -1, -1):
                rest = y[i] - before[i]
                for j in range(i + 1, rank):
                    rest -= R[j, i] * y[j]
                y[i] = rest / R[i, i]
        for j in range(rank):
            f0, f1, f2 = f0 + E[j, 0] * y[j], f1 + E[j, 1] * y[j], f2 + E[j, 2] * y[j]
        if not solve:
            for i in range(rank):
                for j in range(i, rank):
                    before[i] += R[j, i] * y[j]
            for i in range(rank):
                y[i] = before[i]
        if k:
            to, since = points[stations[k]], points[stations[k - 1]]
            r0, r1, r2 = to[0] - since[0], to[1] - since[1], to[2] - since[2]
            t0, t1, t2 = t0 + r1 * f2 - r2 * f1, t1 + r2 * f0 - r0 * f2, t2 + r0 * f1 - r1 * f0


@compiled
def least_change(
    screws: Screws,
    rows: Rows,
    factors: Factors,
    values: Array2,
    x: Array1,
) -> None:
    """Change the motions of the joints as little as possible so that each row has its value.

    With J = L Q, that is x + J^T L^-T L^-1 (values - J x): as accurate as with Q itself, which is not kept.

    Args:
        screws: how joints move the points.
        rows: which motions the matrix consists of.
        factors: L, from `eliminated`.
        values: one value for each row, (p, 3).
        x: motions of the joints, (n,); changed.
    """
    y, change = np.empty((len(rows.stations), 3)), np.empty(len(x))
    motions_along(screws, rows, x, y)
    for k in range(len(y)):
        for j in range(rows.ranks[k]):
            y[k, j] = values[k, j] - y[k, j]
    down_stations(screws.points, rows, factors, True, y)
    up_stations(screws.points, rows, factors, True, y)
    joints_along(screws, rows, y, change)
    for u in range(len(x)):
        x[u] += change[u]
