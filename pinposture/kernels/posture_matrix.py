"""Posture control matrices of a chain, factored by passes along it, and their extreme singular values."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from pinposture.kernels.arrays import COUPLING, Array1, Array2, Factors, Flags1, Rows, Screws
from pinposture.kernels.compiled import compiled, subkernel
from pinposture.kernels.kinematics import difference, joints_along, motions_along

# A posture control matrix is decomposed as J = L Q: L block lower triangular, the rows of Q orthonormal.
#
# No array of size rows times joints is formed. The remaining motions of the joints up to a station, given the
# values of all rows so far, are a linear and angular velocity (v, w) spanned by at most six orthonormal
# combinations of the joints. Householder reflections are applied to those and the joints of the next section:
# first the rows of the station become triangular, then the rest is reduced to six columns. This is the array
# form of a Kalman filter with exact measurements. Nothing is squared, so the result is as accurate as a QR
# decomposition of the matrix.
#
# A station keeps its triangle R, (3, 3), and its gains K, (6, 3): the effect of its combinations on (v, w).
# With them, products with L, its transpose and their inverses are passes along the stations.

ZERO_PIVOT = 1e-60
"""Replaces zeros on the diagonal of L, so that it has an inverse; its square does not underflow."""


class LanczosSettings(NamedTuple):
    """Settings of the search for the extreme singular values."""

    largest_basis: int = 400
    """Number of vectors after which the search starts again from the best result."""

    restarts: int = 20
    """Largest number of these new starts."""

    bisections: int = 60
    """Number of bisections of an eigenvalue: more than a number has binary digits."""


LANCZOS = LanczosSettings()


Twist = tuple[float, float, float, float, float, float]
"""Linear and angular velocity."""


@compiled
def eliminated(screws: Screws, rows: Rows, factors: Factors) -> None:
    """Decompose a posture control matrix.

    Args:
        screws: the screws of the joints.
        rows: the rows of the matrix.
        factors: filled with L; zeros on the diagonal are replaced by `ZERO_PIVOT`.
    """
    b, ends, points = screws
    stations, ranks, directions, coupling = rows
    triangles, gains = factors
    widest = 0
    u = 0
    for station in stations:
        widest = max(widest, ends[station] - u)
        u = ends[station]
    A = np.empty((6, widest + 6))
    left = np.empty((6, 6))
    free = 0
    at = 0
    u = 0
    for k in range(len(stations)):
        E = directions[k]
        rank = ranks[k]
        station = stations[k]
        for c in range(free):
            twist = left[0, c], left[1, c], left[2, c], left[3, c], left[4, c], left[5, c]
            _write(A, c, E, twist, points[station], points[at])
        width = free
        last = station
        if k:
            at += 1
        for point in range(at, last + 1):
            while u < ends[point]:
                twist = b[u, 0], b[u, 1], b[u, 2], b[u, 3], b[u, 4], b[u, 5]
                _write(A, width, E, twist, points[last], points[point])
                width += 1
                u += 1
        at = last
        for j in range(min(rank, width)):
            _reflect(A, j, j, width)
        R = triangles[k]
        K = gains[k]
        for j in range(rank):
            for i in range(rank):
                R[i, j] = A[i, j] if j <= i and j < width else 0.0
            if R[j, j] == 0.0:
                R[j, j] = ZERO_PIVOT
            _read_column(A, j, E, K, j, j < width)
        if coupling == COUPLING.local:
            continue
        # The remaining columns do not change the rows of this station.
        kept = width - rank
        first = 3 if coupling == COUPLING.relative else rank
        if kept > 6 - first:
            for row in range(first, 6):
                _reflect(A, row, rank + row - first, width)
            kept = 6 - first
        free = max(kept, 0)
        for j in range(rank):
            for c in range(rank, rank + free):
                A[j, c] = 0.0
        for c in range(free):
            _read_column(A, rank + c, E, left, c, True)
            if coupling == COUPLING.relative:
                left[0, c] = 0.0
                left[1, c] = 0.0
                left[2, c] = 0.0


@subkernel
def _write(A: Array2, column: int, E: Array2, twist: Twist, to: Array1, since: Array1) -> None:
    """Write (v, w), moved to another point and projected onto the directions, to a column."""
    v0, v1, v2, w0, w1, w2 = twist
    r0 = to[0] - since[0]
    r1 = to[1] - since[1]
    r2 = to[2] - since[2]
    v0 = v0 + w1 * r2 - w2 * r1
    v1 = v1 + w2 * r0 - w0 * r2
    v2 = v2 + w0 * r1 - w1 * r0
    for i in range(3):
        A[i, column] = E[i, 0] * v0 + E[i, 1] * v1 + E[i, 2] * v2
    A[3, column] = w0
    A[4, column] = w1
    A[5, column] = w2


@subkernel
def _read_column(A: Array2, column: int, E: Array2, to: Array2, place: int, exists: bool) -> None:
    """Read (v, w) from a column; zero if there is no such column."""
    for i in range(3):
        to[i, place] = (
            E[0, i] * A[0, column] + E[1, i] * A[1, column] + E[2, i] * A[2, column] if exists else 0.0
        )
        to[3 + i, place] = A[3 + i, column] if exists else 0.0


@subkernel
def _reflect(A: Array2, row: int, pivot: int, width: int) -> None:
    """Apply a Householder reflection to the columns from the pivot on that zeros the row after it."""
    head = A[row, pivot]
    tail = 0.0
    for c in range(pivot + 1, width):
        tail += A[row, c] * A[row, c]
    if tail < ZERO_PIVOT:  # practically zero; its inverse may be infinite
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
def multiply_down(points: Array2, rows: Rows, factors: Factors, solve: bool, values: Array2) -> None:
    """Multiply `values`, (p, 3), by L, or by its inverse to solve: the pass from the base to the tip."""
    stations, ranks, directions, coupling = rows
    triangles, gains = factors
    v0 = 0.0
    v1 = 0.0
    v2 = 0.0
    w0 = 0.0
    w1 = 0.0
    w2 = 0.0
    for k in range(len(stations)):
        if coupling != COUPLING.full:
            v0 = 0.0
            v1 = 0.0
            v2 = 0.0
        if coupling == COUPLING.local:
            w0 = 0.0
            w1 = 0.0
            w2 = 0.0
        if k:
            r0, r1, r2 = difference(points, stations[k], stations[k - 1])
            v0 = v0 + w1 * r2 - w2 * r1
            v1 = v1 + w2 * r0 - w0 * r2
            v2 = v2 + w0 * r1 - w1 * r0
        E = directions[k]
        R = triangles[k]
        K = gains[k]
        y = values[k]
        p0 = v0
        p1 = v1
        p2 = v2
        p3 = w0
        p4 = w1
        p5 = w2
        for i in range(ranks[k] if solve else 0):
            rest = y[i] - (E[i, 0] * v0 + E[i, 1] * v1 + E[i, 2] * v2)
            for j in range(i):
                rest -= R[i, j] * y[j]
            y[i] = rest / R[i, i]
        for j in range(ranks[k]):
            g = y[j]
            p0 = p0 + K[0, j] * g
            p1 = p1 + K[1, j] * g
            p2 = p2 + K[2, j] * g
            p3 = p3 + K[3, j] * g
            p4 = p4 + K[4, j] * g
            p5 = p5 + K[5, j] * g
        for i in range(0 if solve else ranks[k]):
            y[i] = E[i, 0] * p0 + E[i, 1] * p1 + E[i, 2] * p2
        v0 = p0
        v1 = p1
        v2 = p2
        w0 = p3
        w1 = p4
        w2 = p5


@subkernel
def multiply_up(points: Array2, rows: Rows, factors: Factors, solve: bool, values: Array2) -> None:
    """Multiply `values`, (p, 3), by L transposed, or by its inverse: the pass from the tip to the base."""
    stations, ranks, directions, coupling = rows
    triangles, gains = factors
    f0 = 0.0
    f1 = 0.0
    f2 = 0.0
    t0 = 0.0
    t1 = 0.0
    t2 = 0.0
    before = np.empty(3)
    for k in range(len(stations) - 1, -1, -1):
        if coupling != COUPLING.full:
            f0 = 0.0
            f1 = 0.0
            f2 = 0.0
        if coupling == COUPLING.local:
            t0 = 0.0
            t1 = 0.0
            t2 = 0.0
        E = directions[k]
        R = triangles[k]
        K = gains[k]
        y = values[k]
        rank = ranks[k]
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
            f0 = f0 + E[j, 0] * y[j]
            f1 = f1 + E[j, 1] * y[j]
            f2 = f2 + E[j, 2] * y[j]
        if not solve:
            for i in range(rank):
                for j in range(i, rank):
                    before[i] += R[j, i] * y[j]
            for i in range(rank):
                y[i] = before[i]
        if k:
            r0, r1, r2 = difference(points, stations[k], stations[k - 1])
            t0 = t0 + r1 * f2 - r2 * f1
            t1 = t1 + r2 * f0 - r0 * f2
            t2 = t2 + r0 * f1 - r1 * f0


@compiled
def least_change(screws: Screws, rows: Rows, factors: Factors, values: Array2, x: Array1) -> None:
    """Apply the smallest change of the joint motions that gives each row its value.

    With J = L Q, that is x + J^T L^-T L^-1 (values - J x): as accurate as with Q itself, which is not stored.

    Args:
        screws: the screws of the joints.
        rows: the rows of the matrix.
        factors: L, from `eliminated`.
        values: one value for each row, (p, 3).
        x: motions of the joints, (n,); changed.
    """
    y = np.empty((len(rows.stations), 3))
    change = np.empty(len(x))
    motions_along(screws, rows, x, y)
    for k in range(len(y)):
        for j in range(rows.ranks[k]):
            y[k, j] = values[k, j] - y[k, j]
    multiply_down(screws.points, rows, factors, True, y)
    multiply_up(screws.points, rows, factors, True, y)
    joints_along(screws, rows, y, change)
    for u in range(len(x)):
        x[u] += change[u]


@compiled
def well_conditioned(screws: Screws, rows: Rows, least: float, kept: Flags1) -> None:
    """Choose stations, from the base on, so that full rows have no singular value below a bound.

    All are chosen if possible. Otherwise stations whose rows nearly depend on those of earlier stations are
    skipped, because one that used up all the slack would leave none for later ones. Several bounds on the
    slack used by a station are tried until nine in ten are chosen; the choice with the most stations wins.

    Args:
        screws: the screws of the joints.
        rows: the rows of all stations.
        least: the bound [m/rad].
        kept: filled with True for chosen stations, (p,).
    """
    tried = np.empty_like(kept)
    most = -1
    for spare in (0.0, 1.0, 3.0):
        count = _choose_stations(screws, rows, least, spare * least * least, tried)
        if count > most:
            most = count
            kept[:] = tried
        if most >= 0.9 * len(kept):
            return


@subkernel
def _choose_stations(screws: Screws, rows: Rows, least: float, spare: float, kept: Flags1) -> int:
    """Choose stations whose diagonal blocks have pivots above `spare`; return their number.

    No singular value of J is below the bound if J J^T minus the square of the bound has a Cholesky
    decomposition. J J^T is the covariance of the rows for random joint motions, so it is computed station by
    station as in a Kalman filter; the state is the covariance of (v, w).
    """
    b, ends, points = screws
    stations, ranks, directions, _ = rows
    P = np.zeros((6, 6))
    S = np.empty((3, 3))
    R = np.empty((3, 3))
    G = np.empty((3, 6))
    turn = np.zeros((3, 3))
    at = 0
    u = 0
    count = 0
    for k in range(len(stations)):
        E = directions[k]
        rank = ranks[k]
        station = stations[k]
        if k:
            r0, r1, r2 = difference(points, station, at - 1)
            turn[0, 1] = r2
            turn[0, 2] = -r1
            turn[1, 2] = r0
            turn[1, 0] = -r2
            turn[2, 0] = r1
            turn[2, 1] = -r0
            for i in range(3):
                for j in range(6):
                    P[i, j] += turn[i, 0] * P[3, j] + turn[i, 1] * P[4, j] + turn[i, 2] * P[5, j]
            for i in range(6):
                for j in range(3):
                    P[i, j] += turn[j, 0] * P[i, 3] + turn[j, 1] * P[i, 4] + turn[j, 2] * P[i, 5]
        for point in range(at, station + 1):
            r0, r1, r2 = difference(points, station, point)
            for column in range(u, ends[point]):
                s = b[column]
                v0 = s[0] + s[4] * r2 - s[5] * r1
                v1 = s[1] + s[5] * r0 - s[3] * r2
                v2 = s[2] + s[3] * r1 - s[4] * r0
                moved = (v0, v1, v2, s[3], s[4], s[5])
                for i in range(6):
                    for j in range(6):
                        P[i, j] += moved[i] * moved[j]
            u = ends[point]
        at = station + 1
        for i in range(rank):
            for j in range(6):
                G[i, j] = E[i, 0] * P[0, j] + E[i, 1] * P[1, j] + E[i, 2] * P[2, j]
            for j in range(rank):
                S[i, j] = G[i, 0] * E[j, 0] + G[i, 1] * E[j, 1] + G[i, 2] * E[j, 2]
        kept[k] = _factor(S, rank, least * least + spare, R) and _factor(S, rank, least * least, R)
        if kept[k]:
            count += 1
            for i in range(rank):
                for j in range(6):
                    for c in range(i):
                        G[i, j] -= R[i, c] * G[c, j]
                    G[i, j] /= R[i, i]
            for i in range(6):
                for j in range(6):
                    for c in range(rank):
                        P[i, j] -= G[c, i] * G[c, j]
    return count


@subkernel
def _factor(S: Array2, rank: int, shift: float, R: Array2) -> bool:
    """Write the Cholesky factor of S - shift to R; return whether there is one."""
    for i in range(rank):
        for j in range(i + 1):
            R[i, j] = S[i, j] - (shift if i == j else 0.0)
            for c in range(j):
                R[i, j] -= R[i, c] * R[j, c]
            if j < i:
                R[i, j] /= R[j, j]
        if R[i, i] <= 0.0:
            return False
        R[i, i] = np.sqrt(R[i, i])
    return rank > 0


@compiled
def extreme_value(points: Array2, rows: Rows, factors: Factors, smallest: bool, tolerance: float) -> float:
    """Compute the smallest or largest singular value, by Lanczos iterations on J J^T or its inverse.

    Args:
        points: the points, (m, 3).
        rows: the rows of the matrix.
        factors: L, from `eliminated`.
        smallest: True for the smallest, False for the largest.
        tolerance: residual at which the search ends, relative to the square of the singular value.
    """
    ranks = rows.ranks
    p = len(rows.stations)
    count = int(np.sum(ranks))
    largest_basis = min(count, LANCZOS.largest_basis)
    V = np.empty((largest_basis + 1, count))
    y = np.empty((p, 3))
    diagonal = np.empty(largest_basis)
    off = np.empty(largest_basis)
    ritz = np.empty(largest_basis)
    start = np.empty(count)
    for i in range(count):  # generic, so not orthogonal to a singular vector
        start[i] = 1.0 + np.sin(12.9898 * (i + 1.0) * (i + 1.0))
    best = 0.0
    for _ in range(LANCZOS.restarts):
        V[0] = start / np.sqrt(np.sum(start * start))
        j = 0
        due = 4
        while True:
            at = 0
            for k in range(p):
                for c in range(ranks[k]):
                    y[k, c] = V[j, at]
                    at += 1
            if smallest:
                multiply_down(points, rows, factors, True, y)
                multiply_up(points, rows, factors, True, y)
            else:
                multiply_up(points, rows, factors, False, y)
                multiply_down(points, rows, factors, False, y)
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
            off[j] = norm
            j += 1
            if j in (due, largest_basis) or norm <= 1e-15 * best:
                due += max(4, j // 4)
                best = _largest_eigenvalue(diagonal, off, j, ritz)
                residual = norm * abs(ritz[j - 1])
                if j == largest_basis or residual <= tolerance * best:
                    break
            new /= norm
        start[:] = 0.0
        for i in range(j):
            start += ritz[i] * V[i]
        if residual <= tolerance * best or largest_basis == count:
            break
    return float(1.0 / np.sqrt(best)) if smallest else float(np.sqrt(best))


@subkernel
def _largest_eigenvalue(diagonal: Array1, off: Array1, size: int, vector: Array1) -> float:
    """Find the largest eigenvalue of a tridiagonal matrix by bisection, its vector by inverse iteration."""
    low = diagonal[0]
    high = diagonal[0]
    for i in range(size):
        reach = (off[i - 1] if i else 0.0) + (off[i] if i < size - 1 else 0.0)
        low = max(low, diagonal[i])
        high = max(high, diagonal[i] + reach)
    high *= 1.0 + 1e-14
    for _ in range(LANCZOS.bisections):
        middle = 0.5 * (low + high)
        pivot = 1.0
        above = True
        for i in range(size):
            pivot = middle - diagonal[i] - (off[i - 1] * off[i - 1] / pivot if i else 0.0)
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
        pivots[i] = shift - diagonal[i] - (off[i - 1] * off[i - 1] / pivots[i - 1] if i else 0.0)
        if pivots[i] <= 0.0:
            pivots[i] = 1e-16 * high
        vector[i] = 1.0
    for _ in range(3):
        for i in range(1, size):
            vector[i] += off[i - 1] / pivots[i - 1] * vector[i - 1]
        for i in range(size - 1, -1, -1):
            vector[i] = (vector[i] + (off[i] * vector[i + 1] if i < size - 1 else 0.0)) / pivots[i]
        norm = 0.0
        for i in range(size):
            norm += vector[i] * vector[i]
        norm = 1.0 / np.sqrt(norm)
        for i in range(size):
            vector[i] *= norm
    return float(high)
