"""Posture control matrices of a chain, factored by passes along it, and their extreme singular values."""

from __future__ import annotations

import numpy as np

from pinposture.kernels.arrays import FULL, LOCAL, RELATIVE, Array1, Array2, Factors, Rows, Screws
from pinposture.kernels.compiled import compiled, subkernel
from pinposture.kernels.kinematics import joints_along, motions_along

# Posture control matrices of a chain as J = L Q: L block lower triangular, the rows of Q orthonormal.
#
# Nothing of size rows times joints is ever made. What the joints up to a station can still do about farther
# ones, once the rows so far have what they ask for, is a motion and turning (v, w) spanned by at most six
# orthonormal combinations of the joints. Those, and the joints of the next section, go through Householder
# reflections: first the rows of the station become triangular, then what is left is brought back to six
# columns. It is the array form of a Kalman filter with exact measurements. Nothing is squared, so the result
# is as accurate as a QR decomposition of the matrix.
#
# A station keeps its triangle R, (3, 3), and its gains K, (6, 3): what its share of the combinations does to
# (v, w). With them, products with L, its transpose and their inverses are passes along the stations.

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


# Extreme singular values of a posture control matrix J = L Q, from products with L and its inverse.

LARGEST_BASIS = 400
"""How many vectors are kept before the search begins anew, from the best found so far."""

BISECTIONS = 60
RESTARTS = 20


@compiled
def inverse_norm(points: Array2, rows: Rows, factors: Factors) -> float:
    """Frobenius norm of the pseudo-inverse of a FULL matrix.

    The smallest singular value is at least its inverse, and at most sqrt(rows) times that. It is the mean
    square of L^-1 times white noise, whose covariance goes along the stations as a sum of squares.

    Args:
        points: the points, (m, 3).
        rows: which motions the matrix consists of.
        factors: L, from `eliminated`.
    """
    stations, ranks, directions, _ = rows
    triangles, gains = factors
    total = 0.0
    C, T, M, N = np.zeros((6, 6)), np.empty((6, 6)), np.empty((6, 6)), np.empty((6, 3))
    for k in range(len(stations)):
        E, R, rank = directions[k], triangles[k], ranks[k]
        for i in range(6):  # N = K R^-1
            for j in range(rank - 1, -1, -1):
                rest = gains[k, i, j]
                for e in range(j + 1, rank):
                    rest -= N[i, e] * R[e, j]
                N[i, j] = rest / R[j, j]
        if k:
            to, since = points[stations[k]], points[stations[k - 1]]
            r0, r1, r2 = to[0] - since[0], to[1] - since[1], to[2] - since[2]
            for i in range(6):  # what the state before does to the rows, and to the state after
                for j in range(6):
                    M[i, j] = 1.0 if i == j else 0.0
            M[0, 4], M[0, 5], M[1, 3], M[1, 5], M[2, 3], M[2, 4] = r2, -r1, -r2, r0, r1, -r0
            for j in range(6):
                for a in range(rank):
                    T[a, j] = E[a, 0] * M[0, j] + E[a, 1] * M[1, j] + E[a, 2] * M[2, j]
            for i in range(6):
                for j in range(6):
                    for a in range(rank):
                        M[i, j] -= N[i, a] * T[a, j]
            total += _share(R, T, C, rank)
            for i in range(6):
                for j in range(6):
                    T[i, j] = 0.0
                    for e in range(6):
                        T[i, j] += M[i, e] * C[e, j]
            for i in range(6):
                for j in range(i + 1):
                    C[i, j] = 0.0
                    for e in range(6):
                        C[i, j] += T[i, e] * M[j, e]
        else:
            T[:rank] = 0.0
            total += _share(R, T, C, rank)
        for i in range(6):
            for j in range(i + 1):
                for a in range(rank):
                    C[i, j] += N[i, a] * N[j, a]
                C[j, i] = C[i, j]
    return float(np.sqrt(total))


@subkernel
def _share(R: Array2, T: Array2, C: Array2, rank: int) -> float:
    """Mean square of R^-1 (white noise - T times a state of covariance C)."""
    S = np.zeros((3, 3))
    for a in range(rank):
        S[a, a] = 1.0
        for j in range(6):
            product = 0.0
            for e in range(6):
                product += T[a, e] * C[e, j]
            for c in range(rank):
                S[a, c] += product * T[c, j]
    for c in range(rank):  # R^-1 S, then the diagonal of R^-1 S R^-T
        for a in range(rank):
            for e in range(a):
                S[a, c] -= R[a, e] * S[e, c]
            S[a, c] /= R[a, a]
    total = 0.0
    for a in range(rank):
        for c in range(a + 1):
            for e in range(c):
                S[a, c] -= S[a, e] * R[c, e]
            S[a, c] /= R[c, c]
        total += S[a, a]
    return total


@compiled
def extreme_value(
    points: Array2,
    rows: Rows,
    factors: Factors,
    smallest: bool,
    tolerance: float,
    vector: Array2,
) -> float:
    """The smallest or largest singular value and its left singular vector: Lanczos on J J^T or its inverse.

    Args:
        points: the points, (m, 3).
        rows: which motions the matrix consists of.
        factors: L, from `eliminated`.
        smallest: which of both.
        tolerance: residual at which the search ends, relative to the square of the singular value.
        vector: filled with the vector, one value for each row, (p, 3).
    """
    ranks, p = rows.ranks, len(rows.stations)
    count = int(np.sum(ranks))
    most = min(count, LARGEST_BASIS)
    V, y = np.empty((most + 1, count)), np.empty((p, 3))
    diagonal, beside, ritz = np.empty(most), np.empty(most), np.empty(most)
    start = np.empty(count)
    for i in range(count):  # anything that no singular vector is at right angles to
        start[i] = 1.0 + np.sin(12.9898 * (i + 1.0) * (i + 1.0))
    best = 0.0
    for _ in range(RESTARTS):
        V[0] = start / np.sqrt(np.sum(start * start))
        j, due = 0, 4
        while True:
            at = 0
            for k in range(p):
                for c in range(ranks[k]):
                    y[k, c] = V[j, at]
                    at += 1
            if smallest:
                down_stations(points, rows, factors, True, y)
                up_stations(points, rows, factors, True, y)
            else:
                up_stations(points, rows, factors, False, y)
                down_stations(points, rows, factors, False, y)
            new = V[j + 1]
            at = 0
            for k in range(p):
                for c in range(ranks[k]):
                    new[at] = y[k, c]
                    at += 1
            for again in range(2):
                shares = np.dot(V[: j + 1], new)
                new -= np.dot(shares, V[: j + 1])
                if again == 0:
                    diagonal[j] = shares[j]
            norm = np.sqrt(np.sum(new * new))
            beside[j] = norm
            j += 1
            if j in (due, most) or norm <= 1e-15 * best:
                due += max(4, j // 4)
                best = _top(diagonal, beside, j, ritz)
                residual = norm * abs(ritz[j - 1])
                if j == most or residual <= tolerance * best:
                    break
            new /= norm
        start[:] = 0.0
        for i in range(j):
            start += ritz[i] * V[i]
        if residual <= tolerance * best or most == count:
            break
    at = 0
    for k in range(p):
        for c in range(ranks[k]):
            vector[k, c] = start[at]
            at += 1
    return float(1.0 / np.sqrt(best)) if smallest else float(np.sqrt(best))


@subkernel
def _top(diagonal: Array1, beside: Array1, size: int, vector: Array1) -> float:
    """Largest eigenvalue of a tridiagonal matrix, by bisection, and its vector, by inverse iteration."""
    low, high = diagonal[0], diagonal[0]
    for i in range(size):
        reach = (beside[i - 1] if i else 0.0) + (beside[i] if i < size - 1 else 0.0)
        low, high = max(low, diagonal[i]), max(high, diagonal[i] + reach)
    high *= 1.0 + 1e-14
    for _ in range(BISECTIONS):
        middle, pivot, above = 0.5 * (low + high), 1.0, True
        for i in range(size):
            pivot = middle - diagonal[i] - (beside[i - 1] * beside[i - 1] / pivot if i else 0.0)
            if pivot <= 0.0:
                above = False
                break
        if above:
            high = middle
        else:
            low = middle
    shift = high * (1.0 + 1e-15)
    pivots = np.empty(size)
    for i in range(size):
        pivots[i] = shift - diagonal[i] - (beside[i - 1] * beside[i - 1] / pivots[i - 1] if i else 0.0)
        if pivots[i] <= 0.0:
            pivots[i] = 1e-16 * high
        vector[i] = 1.0
    for _ in range(3):
        for i in range(1, size):
            vector[i] += beside[i - 1] / pivots[i - 1] * vector[i - 1]
        for i in range(size - 1, -1, -1):
            vector[i] = (vector[i] + (beside[i] * vector[i + 1] if i < size - 1 else 0.0)) / pivots[i]
        norm = 0.0
        for i in range(size):
            norm += vector[i] * vector[i]
        norm = 1.0 / np.sqrt(norm)
        for i in range(size):
            vector[i] *= norm
    return float(high)
