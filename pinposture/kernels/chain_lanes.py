"""Least squares along several configurations of a chain at once, without chords: see `chain_solver`.

A pass along a chain is a row of short sums, each of which waits for the one before. Sixteen configurations
side by side, as the innermost index of every array, keep the processor busy meanwhile, and its vector
registers full. A quantity with k components is a row of k times `LANES` numbers.
"""

from __future__ import annotations

import numpy as np

from pinposture.kernels.arrays import Array1, Array2, Flags1, Ints1, Singles2
from pinposture.kernels.compiled import subkernel

LANES = 16
"""Number of configurations side by side: a vector register of the widest kind holds as many numbers."""

COST = 21
"""Number of different coefficients of a cost of linear and angular velocity, (6, 6)."""

GAINS = 7
"""Number of gains of a joint, from `factor_lanes`."""

Lanes = tuple[Ints1, Array2, Array2]
"""Number of joints that carry each point, (m,); screws of the joints, (n, 6 lanes), as in `chain_solver`; and
the way to each point from the one before, (m, 3 lanes)."""

SingleLanes = tuple[Ints1, Singles2, Singles2]
"""The same in single precision, for `solve_lanes`."""


@subkernel
def factor_lanes(
    chains: Lanes,
    weights: Array1,
    damping: Array1,
    free: Array2,
    loads: Array2,
    loaded: Flags1,
    gains: Singles2,
) -> None:
    """Run the pass from the tip to the base, without right-hand sides.

    Args:
        chains: the chains.
        weights: weight of all points, (lanes,).
        damping: damping of all joints, (lanes,), positive.
        free: 1 for joints that move, 0 for those that are held, (n, lanes).
        loads: additional cost of the motion of the body that each joint carries, (n, 21 lanes).
        loaded: which joints carry bodies with an additional cost, (n,).
        gains: filled with the gains for `solve_lanes`, (n, 7 lanes).
    """
    ends, screws, ways = chains
    m = len(ends)
    cost = np.zeros((1, COST * LANES))
    for u in range(ends[m - 1], len(screws)):  # joints beyond the last point only have damping
        for i in range(GAINS * LANES):
            gains[u, i] = 0.0
        for i in range(LANES):
            gains[u, 6 * LANES + i] = free[u, i] / damping[i]
    for k in range(m - 1, -1, -1):
        for i in range(LANES):
            cost[0, i] += weights[i]
            cost[0, 3 * LANES + i] += weights[i]
            cost[0, 5 * LANES + i] += weights[i]
        for u in range(ends[k] - 1, (ends[k - 1] if k else 0) - 1, -1):
            if loaded[u]:
                for i in range(COST * LANES):
                    cost[0, i] += loads[u, i]
            _eliminate(cost, screws, u, damping, free, gains)
        if k:
            _shift_cost(cost, ways, k)


@subkernel
def _eliminate(cost: Array2, b: Array2, u: int, damping: Array1, free: Array2, gains: Singles2) -> None:
    """Minimise the cost over the motion of a joint, and fill in its gains."""
    for i in range(LANES):
        p00 = cost[0, i]
        p01 = cost[0, LANES + i]
        p02 = cost[0, 2 * LANES + i]
        p11 = cost[0, 3 * LANES + i]
        p12 = cost[0, 4 * LANES + i]
        p22 = cost[0, 5 * LANES + i]
        q00 = cost[0, 6 * LANES + i]
        q01 = cost[0, 7 * LANES + i]
        q02 = cost[0, 8 * LANES + i]
        q10 = cost[0, 9 * LANES + i]
        q11 = cost[0, 10 * LANES + i]
        q12 = cost[0, 11 * LANES + i]
        q20 = cost[0, 12 * LANES + i]
        q21 = cost[0, 13 * LANES + i]
        q22 = cost[0, 14 * LANES + i]
        r00 = cost[0, 15 * LANES + i]
        r01 = cost[0, 16 * LANES + i]
        r02 = cost[0, 17 * LANES + i]
        r11 = cost[0, 18 * LANES + i]
        r12 = cost[0, 19 * LANES + i]
        r22 = cost[0, 20 * LANES + i]
        v0 = b[u, i]
        v1 = b[u, LANES + i]
        v2 = b[u, 2 * LANES + i]
        w0 = b[u, 3 * LANES + i]
        w1 = b[u, 4 * LANES + i]
        w2 = b[u, 5 * LANES + i]
        g0 = (p00 * v0 + p01 * v1 + p02 * v2) + (q00 * w0 + q01 * w1 + q02 * w2)
        g1 = (p01 * v0 + p11 * v1 + p12 * v2) + (q10 * w0 + q11 * w1 + q12 * w2)
        g2 = (p02 * v0 + p12 * v1 + p22 * v2) + (q20 * w0 + q21 * w1 + q22 * w2)
        g3 = (q00 * v0 + q10 * v1 + q20 * v2) + (r00 * w0 + r01 * w1 + r02 * w2)
        g4 = (q01 * v0 + q11 * v1 + q21 * v2) + (r01 * w0 + r11 * w1 + r12 * w2)
        g5 = (q02 * v0 + q12 * v1 + q22 * v2) + (r02 * w0 + r12 * w1 + r22 * w2)
        own = (v0 * g0 + v1 * g1 + v2 * g2) + (w0 * g3 + w1 * g4 + w2 * g5)
        inverse = free[u, i] / (damping[i] + own)
        gains[u, i] = g0
        gains[u, LANES + i] = g1
        gains[u, 2 * LANES + i] = g2
        gains[u, 3 * LANES + i] = g3
        gains[u, 4 * LANES + i] = g4
        gains[u, 5 * LANES + i] = g5
        gains[u, 6 * LANES + i] = inverse
        h0 = inverse * g0
        h1 = inverse * g1
        h2 = inverse * g2
        h3 = inverse * g3
        h4 = inverse * g4
        h5 = inverse * g5
        cost[0, i] = p00 - h0 * g0
        cost[0, LANES + i] = p01 - h0 * g1
        cost[0, 2 * LANES + i] = p02 - h0 * g2
        cost[0, 3 * LANES + i] = p11 - h1 * g1
        cost[0, 4 * LANES + i] = p12 - h1 * g2
        cost[0, 5 * LANES + i] = p22 - h2 * g2
        cost[0, 6 * LANES + i] = q00 - h0 * g3
        cost[0, 7 * LANES + i] = q01 - h0 * g4
        cost[0, 8 * LANES + i] = q02 - h0 * g5
        cost[0, 9 * LANES + i] = q10 - h1 * g3
        cost[0, 10 * LANES + i] = q11 - h1 * g4
        cost[0, 11 * LANES + i] = q12 - h1 * g5
        cost[0, 12 * LANES + i] = q20 - h2 * g3
        cost[0, 13 * LANES + i] = q21 - h2 * g4
        cost[0, 14 * LANES + i] = q22 - h2 * g5
        cost[0, 15 * LANES + i] = r00 - h3 * g3
        cost[0, 16 * LANES + i] = r01 - h3 * g4
        cost[0, 17 * LANES + i] = r02 - h3 * g5
        cost[0, 18 * LANES + i] = r11 - h4 * g4
        cost[0, 19 * LANES + i] = r12 - h4 * g5
        cost[0, 20 * LANES + i] = r22 - h5 * g5


@subkernel
def _shift_cost(cost: Array2, ways: Array2, k: int) -> None:
    """Convert the cost of the motion at a point to that at the previous one, where v is smaller by w x r."""
    for i in range(LANES):
        p00 = cost[0, i]
        p01 = cost[0, LANES + i]
        p02 = cost[0, 2 * LANES + i]
        p11 = cost[0, 3 * LANES + i]
        p12 = cost[0, 4 * LANES + i]
        p22 = cost[0, 5 * LANES + i]
        q00 = cost[0, 6 * LANES + i]
        q01 = cost[0, 7 * LANES + i]
        q02 = cost[0, 8 * LANES + i]
        q10 = cost[0, 9 * LANES + i]
        q11 = cost[0, 10 * LANES + i]
        q12 = cost[0, 11 * LANES + i]
        q20 = cost[0, 12 * LANES + i]
        q21 = cost[0, 13 * LANES + i]
        q22 = cost[0, 14 * LANES + i]
        d0 = ways[k, i]
        d1 = ways[k, LANES + i]
        d2 = ways[k, 2 * LANES + i]
        # With v smaller by C w, add P C to Q, and C Q + Q C + C P C to R.
        a00 = p02 * d1 - p01 * d2
        a01 = p00 * d2 - p02 * d0
        a02 = p01 * d0 - p00 * d1
        a10 = p12 * d1 - p11 * d2
        a11 = p01 * d2 - p12 * d0
        a12 = p11 * d0 - p01 * d1
        a20 = p22 * d1 - p12 * d2
        a21 = p02 * d2 - p22 * d0
        a22 = p12 * d0 - p02 * d1
        c00 = d1 * q20 - d2 * q10
        c01 = d1 * q21 - d2 * q11
        c02 = d1 * q22 - d2 * q12
        c10 = d2 * q00 - d0 * q20
        c11 = d2 * q01 - d0 * q21
        c12 = d2 * q02 - d0 * q22
        c20 = d0 * q10 - d1 * q00
        c21 = d0 * q11 - d1 * q01
        c22 = d0 * q12 - d1 * q02
        cost[0, 6 * LANES + i] = q00 + a00
        cost[0, 7 * LANES + i] = q01 + a01
        cost[0, 8 * LANES + i] = q02 + a02
        cost[0, 9 * LANES + i] = q10 + a10
        cost[0, 10 * LANES + i] = q11 + a11
        cost[0, 11 * LANES + i] = q12 + a12
        cost[0, 12 * LANES + i] = q20 + a20
        cost[0, 13 * LANES + i] = q21 + a21
        cost[0, 14 * LANES + i] = q22 + a22
        cost[0, 15 * LANES + i] += 2.0 * c00 + d1 * a20 - d2 * a10
        cost[0, 16 * LANES + i] += c01 + c10 + d1 * a21 - d2 * a11
        cost[0, 17 * LANES + i] += c02 + c20 + d1 * a22 - d2 * a12
        cost[0, 18 * LANES + i] += 2.0 * c11 + d2 * a01 - d0 * a21
        cost[0, 19 * LANES + i] += c12 + c21 + d2 * a02 - d0 * a22
        cost[0, 20 * LANES + i] += 2.0 * c22 + d0 * a12 - d1 * a02


@subkernel
def solve_lanes(chains: SingleLanes, gains: Singles2, right: Singles2, count: int, x: Singles2) -> None:
    """Solve for one right-hand side after `factor_lanes`.

    Args:
        chains: the chains.
        gains: from `factor_lanes`.
        right: efforts of the joints, then forces on the points, (n + 3 m, lanes).
        count: number of lanes to solve for, the first ones.
        x: filled with the motions of the joints, then of the points, (n + 3 m, lanes).
    """
    ends, b, ways = chains
    n = len(b)
    m = len(ends)
    state = np.zeros((1, 6 * LANES), np.float32)
    for u in range(ends[m - 1], n):
        for i in range(count):
            x[u, i] = gains[u, 6 * LANES + i] * right[u, i]
    for k in range(m - 1, -1, -1):
        for j in range(3):
            for i in range(count):
                state[0, j * LANES + i] += right[n + 3 * k + j, i]
        for u in range(ends[k] - 1, (ends[k - 1] if k else 0) - 1, -1):
            for i in range(count):
                s0 = state[0, i]
                s1 = state[0, LANES + i]
                s2 = state[0, 2 * LANES + i]
                s3 = state[0, 3 * LANES + i]
                s4 = state[0, 4 * LANES + i]
                s5 = state[0, 5 * LANES + i]
                linear = b[u, i] * s0 + b[u, LANES + i] * s1 + b[u, 2 * LANES + i] * s2
                angular = b[u, 3 * LANES + i] * s3 + b[u, 4 * LANES + i] * s4 + b[u, 5 * LANES + i] * s5
                t = gains[u, 6 * LANES + i] * (right[u, i] + linear + angular)
                x[u, i] = t
                state[0, i] = s0 - gains[u, i] * t
                state[0, LANES + i] = s1 - gains[u, LANES + i] * t
                state[0, 2 * LANES + i] = s2 - gains[u, 2 * LANES + i] * t
                state[0, 3 * LANES + i] = s3 - gains[u, 3 * LANES + i] * t
                state[0, 4 * LANES + i] = s4 - gains[u, 4 * LANES + i] * t
                state[0, 5 * LANES + i] = s5 - gains[u, 5 * LANES + i] * t
        if k:
            _shift_forces(state, ways, k)
    state[:] = np.float32(0.0)
    for k in range(m):
        if k:
            _shift_motion(state, ways, k)
        for u in range(ends[k - 1] if k else 0, ends[k]):
            for i in range(count):
                v0 = state[0, i]
                v1 = state[0, LANES + i]
                v2 = state[0, 2 * LANES + i]
                w0 = state[0, 3 * LANES + i]
                w1 = state[0, 4 * LANES + i]
                w2 = state[0, 5 * LANES + i]
                linear = gains[u, i] * v0 + gains[u, LANES + i] * v1 + gains[u, 2 * LANES + i] * v2
                angular = gains[u, 3 * LANES + i] * w0 + gains[u, 4 * LANES + i] * w1
                moved = linear + (angular + gains[u, 5 * LANES + i] * w2)
                y = x[u, i] - gains[u, 6 * LANES + i] * moved
                x[u, i] = y
                state[0, i] = v0 + y * b[u, i]
                state[0, LANES + i] = v1 + y * b[u, LANES + i]
                state[0, 2 * LANES + i] = v2 + y * b[u, 2 * LANES + i]
                state[0, 3 * LANES + i] = w0 + y * b[u, 3 * LANES + i]
                state[0, 4 * LANES + i] = w1 + y * b[u, 4 * LANES + i]
                state[0, 5 * LANES + i] = w2 + y * b[u, 5 * LANES + i]
        _store_motion(state, x, n + 3 * k)


@subkernel
def move_lanes(chains: Lanes, x: Array2) -> None:
    """Fill in the motions of the points, the last 3 m rows of x, for those of the joints, the first n."""
    ends, b, ways = chains
    n = len(b)
    state = np.zeros((1, 6 * LANES))
    for k in range(len(ends)):
        if k:
            _shift_motion(state, ways, k)
        for u in range(ends[k - 1] if k else 0, ends[k]):
            for i in range(LANES):
                y = x[u, i]
                state[0, i] += y * b[u, i]
                state[0, LANES + i] += y * b[u, LANES + i]
                state[0, 2 * LANES + i] += y * b[u, 2 * LANES + i]
                state[0, 3 * LANES + i] += y * b[u, 3 * LANES + i]
                state[0, 4 * LANES + i] += y * b[u, 4 * LANES + i]
                state[0, 5 * LANES + i] += y * b[u, 5 * LANES + i]
        _store_motion(state, x, n + 3 * k)


@subkernel
def pull_lanes(chains: Lanes, efforts: Array2) -> None:
    """Add to the efforts of the joints, the first n rows, what forces on the points cause, the other rows."""
    ends, b, ways = chains
    n = len(b)
    state = np.zeros((1, 6 * LANES))
    for k in range(len(ends) - 1, -1, -1):
        _add_force(state, efforts, n + 3 * k)
        for u in range(ends[k - 1] if k else 0, ends[k]):
            for i in range(LANES):
                linear = b[u, i] * state[0, i] + b[u, LANES + i] * state[0, LANES + i]
                linear = linear + b[u, 2 * LANES + i] * state[0, 2 * LANES + i]
                angular = b[u, 3 * LANES + i] * state[0, 3 * LANES + i]
                angular = angular + b[u, 4 * LANES + i] * state[0, 4 * LANES + i]
                efforts[u, i] += linear + (angular + b[u, 5 * LANES + i] * state[0, 5 * LANES + i])
        if k:
            _shift_forces(state, ways, k)


@subkernel
def _add_force(state: Array2, forces: Array2, row: int) -> None:
    """Add the force on a point, in three rows."""
    for j in range(3):
        for i in range(LANES):
            state[0, j * LANES + i] += forces[row + j, i]


@subkernel
def _store_motion(state: Array2 | Singles2, motions: Array2 | Singles2, row: int) -> None:
    """Fill in the motion of a point, in three rows."""
    for j in range(3):
        for i in range(LANES):
            motions[row + j, i] = state[0, j * LANES + i]


@subkernel
def _shift_forces(state: Array2 | Singles2, ways: Array2 | Singles2, k: int) -> None:
    """Convert moments about a point to those about the previous one."""
    for i in range(LANES):
        r0 = ways[k, i]
        r1 = ways[k, LANES + i]
        r2 = ways[k, 2 * LANES + i]
        f0 = state[0, i]
        f1 = state[0, LANES + i]
        f2 = state[0, 2 * LANES + i]
        state[0, 3 * LANES + i] += r1 * f2 - r2 * f1
        state[0, 4 * LANES + i] += r2 * f0 - r0 * f2
        state[0, 5 * LANES + i] += r0 * f1 - r1 * f0


@subkernel
def _shift_motion(state: Array2 | Singles2, ways: Array2 | Singles2, k: int) -> None:
    """Convert the velocity of the previous point to that of a point."""
    for i in range(LANES):
        r0 = ways[k, i]
        r1 = ways[k, LANES + i]
        r2 = ways[k, 2 * LANES + i]
        w0 = state[0, 3 * LANES + i]
        w1 = state[0, 4 * LANES + i]
        w2 = state[0, 5 * LANES + i]
        state[0, i] += w1 * r2 - w2 * r1
        state[0, LANES + i] += w2 * r0 - w0 * r2
        state[0, 2 * LANES + i] += w0 * r1 - w1 * r0
