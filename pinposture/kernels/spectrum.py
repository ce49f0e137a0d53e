"""Extreme singular values of a posture control matrix J = L Q, from products with L and its inverse."""

from __future__ import annotations

import numpy as np

from pinposture.kernels.arrays import Array1, Array2, Factors, Rows
from pinposture.kernels.compiled import compiled, subkernel
from pinposture.kernels.elimination import down_stations, up_stations

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
