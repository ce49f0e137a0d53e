"""Least squares along a chain, by sweeps: one pass from the tip to the base, and one back.

The unknowns are the motions x of the joints. Point k moves by v_k, its body turns by w_k, and

    sum over k of  W_k |v_k - e_k|^2 + C_k |v_k - v_{k-1} - (e_k - e_{k-1})|^2
    + sum over u of  D_u (x_u - z_u)^2

is to be least. A chain makes this an optimal control problem with the joint for time: the state is (v, w) at
a point, and joint u adds (a x (p - o), a) x_u to it. What all farther joints can do about a state is a
quadratic function of it, found from the tip to the base (a Riccati recursion, with the state before a
module, the displacement since then and the turning w side by side, because chords ask for the displacement).
The motions then follow from the base to the tip. Both passes are linear in the number of joints. Velocities
are taken at the points themselves, one after the other: at a common origin far away they would cancel.

Joints may be held: they keep their x, and the others make the best of it.
"""

from __future__ import annotations

import numpy as np

from pinposture.kernels.arrays import Array1, Array2, Flags1, Springs
from pinposture.kernels.compiled import subkernel


@subkernel
def factored(
    springs: Springs,
    damping: Array1,
    held: Flags1,
    gains: Array2,
) -> None:
    """What farther joints can do about a state: the pass from the tip to the base, without right-hand sides.

    Args:
        springs: points and chords.
        damping: D, (n,), positive.
        held: which joints are held, (n,).
        gains: filled with what `answered` wants to know, (n, 11).
    """
    b, ends, points, weights, chords = springs
    m = len(ends)
    for u in range(ends[m - 1], len(b)):  # joints beyond the last point resist with their damping alone
        gains[u, 10] = 1.0 / damping[u]
    P = np.zeros((9, 9))  # of (v before, displacement since, w)
    turned = np.empty((9, 3))
    for k in range(m - 1, -1, -1):
        first = ends[k - 1] if k else 0
        # So far it is a function of (v, w) after the module, in rows 0:3 and 6:9.
        for i in range(3):
            P[i, i] += weights[k]
        for i in range(3):
            for j in range(3):
                P[i, 3 + j] = P[i, j]
                P[3 + i, j] = P[i, j]
                P[3 + i, 3 + j] = P[i, j]
                P[3 + i, 6 + j] = P[i, 6 + j]
                P[6 + j, 3 + i] = P[i, 6 + j]
            P[3 + i, 3 + i] += chords[k]
        for u in range(ends[k] - 1, first - 1, -1):
            b0, b1, b2, b3, b4, b5 = b[u, 0], b[u, 1], b[u, 2], b[u, 3], b[u, 4], b[u, 5]
            g = gains[u]
            for i in range(3, 9):
                moved = P[i, 3] * b0 + P[i, 4] * b1 + P[i, 5] * b2
                g[i] = moved + P[i, 6] * b3 + P[i, 7] * b4 + P[i, 8] * b5
            if chords[k] > 0.0:
                for i in range(3):
                    moved = P[i, 3] * b0 + P[i, 4] * b1 + P[i, 5] * b2
                    g[i] = moved + P[i, 6] * b3 + P[i, 7] * b4 + P[i, 8] * b5
            else:  # who asks for no chord cannot tell the displacement from v before
                for i in range(3):
                    g[i] = g[3 + i]
            inverse = 1.0 / (
                damping[u] + b0 * g[3] + b1 * g[4] + b2 * g[5] + b3 * g[6] + b4 * g[7] + b5 * g[8]
            )
            g[10] = inverse
            if held[u]:
                continue
            for i in range(3, 9):
                scaled = g[i] * inverse
                for j in range(i, 9):
                    P[i, j] -= scaled * g[j]
                    P[j, i] = P[i, j]
            if chords[k] > 0.0:
                for i in range(3):
                    scaled = g[i] * inverse
                    for j in range(i, 9):
                        P[i, j] -= scaled * g[j]
                        P[j, i] = P[i, j]
        if chords[k] == 0.0:
            for i in range(3):
                for j in range(9):
                    P[i, j] = P[3 + i, j]
                    P[j, i] = P[3 + i, j]
            for i in range(3):
                for j in range(3):
                    P[i, j] = P[3 + i, 3 + j]
        if k:
            _before(P, turned, points[k], points[k - 1])


@subkernel
def _before(P: Array2, turned: Array2, point: Array1, previous: Array1) -> None:
    """What (v, displacement, w) cost, as a function of (v, w) at the point before: displacement = w x r."""
    r0, r1, r2 = point[0] - previous[0], point[1] - previous[1], point[2] - previous[2]
    for i in range(9):  # P (w x r) for the three units of w
        turned[i, 0] = P[i, 5] * r1 - P[i, 4] * r2
        turned[i, 1] = P[i, 3] * r2 - P[i, 5] * r0
        turned[i, 2] = P[i, 4] * r0 - P[i, 3] * r1
    for i in range(3):
        for j in range(3):
            P[i, 6 + j] += turned[i, j]
            P[6 + j, i] = P[i, 6 + j]
    for j in range(3):
        x, y, z = turned[3, j], turned[4, j], turned[5, j]
        across = (r1 * z - r2 * y, r2 * x - r0 * z, r0 * y - r1 * x)
        for i in range(j + 1):
            P[6 + i, 6 + j] += turned[6 + i, j] + turned[6 + j, i] + across[i]
            P[6 + j, 6 + i] = P[6 + i, 6 + j]


@subkernel
def answered(
    springs: Springs,
    errors: Array2,
    damping: Array1,
    centre: Array1,
    held: Flags1,
    gains: Array2,
    x: Array1,
) -> None:
    """The motions for one right-hand side, after `factored` with all else the same.

    Args:
        springs: as above.
        errors: e, (m, 3).
        damping: as above.
        centre: z, (n,).
        held: as above.
        gains: as `factored` left it; its column 9 is scratch.
        x: motions of the joints that are held; filled with those of the others, (n,).
    """
    b, ends, points, weights, chords = springs
    n, m = len(b), len(ends)
    for i in range(ends[m - 1], n):  # joints beyond the last point move nothing that counts
        if not held[i]:
            x[i] = centre[i]
    s0, s1, s2, s3, s4, s5, s6, s7, s8 = 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0
    for k in range(m - 1, -1, -1):
        first = ends[k - 1] if k else 0
        w, c = weights[k], chords[k]
        s0, s1, s2 = s0 + w * errors[k, 0], s1 + w * errors[k, 1], s2 + w * errors[k, 2]
        if k:
            s3 = s0 + c * (errors[k, 0] - errors[k - 1, 0])
            s4 = s1 + c * (errors[k, 1] - errors[k - 1, 1])
            s5 = s2 + c * (errors[k, 2] - errors[k - 1, 2])
        else:
            s3, s4, s5 = s0 + c * errors[0, 0], s1 + c * errors[0, 1], s2 + c * errors[0, 2]
        for u in range(ends[k] - 1, first - 1, -1):
            g, t = gains[u], x[u]
            if not held[u]:
                t = g[10] * (
                    damping[u] * centre[u]
                    + (b[u, 0] * s3 + b[u, 1] * s4 + b[u, 2] * s5)
                    + (b[u, 3] * s6 + b[u, 4] * s7 + b[u, 5] * s8)
                )
                g[9] = t
            s0, s1, s2 = s0 - g[0] * t, s1 - g[1] * t, s2 - g[2] * t
            s3, s4, s5 = s3 - g[3] * t, s4 - g[4] * t, s5 - g[5] * t
            s6, s7, s8 = s6 - g[6] * t, s7 - g[7] * t, s8 - g[8] * t
        if k:
            r0 = points[k, 0] - points[k - 1, 0]
            r1 = points[k, 1] - points[k - 1, 1]
            r2 = points[k, 2] - points[k - 1, 2]
            s6, s7, s8 = s6 + r1 * s5 - r2 * s4, s7 + r2 * s3 - r0 * s5, s8 + r0 * s4 - r1 * s3
    v0, v1, v2, w0, w1, w2 = 0.0, 0.0, 0.0, 0.0, 0.0, 0.0
    for k in range(m):
        first = ends[k - 1] if k else 0
        d0, d1, d2 = 0.0, 0.0, 0.0
        if k:
            r0 = points[k, 0] - points[k - 1, 0]
            r1 = points[k, 1] - points[k - 1, 1]
            r2 = points[k, 2] - points[k - 1, 2]
            d0, d1, d2 = w1 * r2 - w2 * r1, w2 * r0 - w0 * r2, w0 * r1 - w1 * r0
        for u in range(first, ends[k]):
            if not held[u]:
                g = gains[u]
                x[u] = g[9] - g[10] * (
                    (g[0] * v0 + g[1] * v1 + g[2] * v2)
                    + (g[3] * d0 + g[4] * d1 + g[5] * d2)
                    + (g[6] * w0 + g[7] * w1 + g[8] * w2)
                )
            d0, d1, d2 = d0 + b[u, 0] * x[u], d1 + b[u, 1] * x[u], d2 + b[u, 2] * x[u]
            w0, w1, w2 = w0 + b[u, 3] * x[u], w1 + b[u, 4] * x[u], w2 + b[u, 5] * x[u]
        v0, v1, v2 = v0 + d0, v1 + d1, v2 + d2


@subkernel
def slope_of(
    springs: Springs,
    errors: Array2,
    damping: Array1,
    centre: Array1,
    x: Array1,
    slope: Array1,
    missed: Array2,
) -> float:
    """Half the sum at x, and half its gradient, which `slope` is filled with; `missed` is scratch, (m, 6)."""
    b, ends, points, weights, chords = springs
    n, m = len(b), len(ends)
    total = 0.0
    for u in range(n):
        off = x[u] - centre[u]
        slope[u] = damping[u] * off
        total += damping[u] * off * off
    v0, v1, v2, w0, w1, w2 = 0.0, 0.0, 0.0, 0.0, 0.0, 0.0
    for k in range(m):
        first = ends[k - 1] if k else 0
        d0, d1, d2 = 0.0, 0.0, 0.0
        e0, e1, e2 = 0.0, 0.0, 0.0
        if k:
            r0 = points[k, 0] - points[k - 1, 0]
            r1 = points[k, 1] - points[k - 1, 1]
            r2 = points[k, 2] - points[k - 1, 2]
            d0, d1, d2 = w1 * r2 - w2 * r1, w2 * r0 - w0 * r2, w0 * r1 - w1 * r0
            e0, e1, e2 = errors[k - 1, 0], errors[k - 1, 1], errors[k - 1, 2]
        for u in range(first, ends[k]):
            d0, d1, d2 = d0 + b[u, 0] * x[u], d1 + b[u, 1] * x[u], d2 + b[u, 2] * x[u]
            w0, w1, w2 = w0 + b[u, 3] * x[u], w1 + b[u, 4] * x[u], w2 + b[u, 5] * x[u]
        v0, v1, v2 = v0 + d0, v1 + d1, v2 + d2
        f0, f1, f2 = v0 - errors[k, 0], v1 - errors[k, 1], v2 - errors[k, 2]
        h0 = d0 - (errors[k, 0] - e0)
        h1 = d1 - (errors[k, 1] - e1)
        h2 = d2 - (errors[k, 2] - e2)
        w, c = weights[k], chords[k]
        total += w * (f0 * f0 + f1 * f1 + f2 * f2) + c * (h0 * h0 + h1 * h1 + h2 * h2)
        missed[k, 0], missed[k, 1], missed[k, 2] = w * f0, w * f1, w * f2
        missed[k, 3], missed[k, 4], missed[k, 5] = c * h0, c * h1, c * h2
    # Forces at the points, and their moments, summed up from the tip.
    f0, f1, f2, t0, t1, t2 = 0.0, 0.0, 0.0, 0.0, 0.0, 0.0
    for k in range(m - 1, -1, -1):
        first = ends[k - 1] if k else 0
        f0, f1, f2 = f0 + missed[k, 0], f1 + missed[k, 1], f2 + missed[k, 2]
        g0, g1, g2 = f0 + missed[k, 3], f1 + missed[k, 4], f2 + missed[k, 5]
        for u in range(first, ends[k]):
            slope[u] += (
                b[u, 0] * g0 + b[u, 1] * g1 + b[u, 2] * g2 + b[u, 3] * t0 + b[u, 4] * t1 + b[u, 5] * t2
            )
        if k:  # moments about the point before
            r0 = points[k, 0] - points[k - 1, 0]
            r1 = points[k, 1] - points[k - 1, 1]
            r2 = points[k, 2] - points[k - 1, 2]
            t0, t1, t2 = t0 + r1 * g2 - r2 * g1, t1 + r2 * g0 - r0 * g2, t2 + r0 * g1 - r1 * g0
    return 0.5 * total
