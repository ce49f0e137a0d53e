"""Least squares along a chain in O(m): one pass to the base, one back; within a box too."""

from __future__ import annotations

import numpy as np

from pinposture.kernels.arrays import Array1, Array2, Bytes1, Flags1, Ints1, PointObjective
from pinposture.kernels.compiled import compiled, subkernel

# Least squares along a chain, by sweeps: one pass from the tip to the base, and one back.
#
# The unknowns are the motions x of the joints. Point k moves by v_k, its body turns by w_k, and
#
# sum over k of W_k |v_k - e_k|^2 + C_k |v_k - v_{k-1} - (e_k - e_{k-1})|^2 + sum over u of D_u (x_u - z_u)^2
#
# is to be least. A chain makes this an optimal control problem with the joint for time: the state is (v, w)
# at a point, and joint u adds (a x (p - o), a) x_u to it. What all farther joints can do about a state is a
# quadratic function of it, found from the tip to the base (a Riccati recursion, with the state before a
# module, the displacement since then and the turning w side by side, because chords ask for the
# displacement). The motions then follow from the base to the tip. Both passes are linear in the number of
# joints. Velocities are taken at the points themselves, one after the other: at a common origin far away
# they would cancel.
#
# Joints may be held: they keep their x, and the others make the best of it.


@subkernel
def factored(
    springs: PointObjective,
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
    springs: PointObjective,
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
    springs: PointObjective,
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


# Points and chords along a chain: how joints move them, how far they are off, how much they resist.


@compiled
def find_screws(
    which: Ints1,
    slides: Flags1,
    units: Array1,
    axes: Array2,
    origins: Array2,
    ends: Ints1,
    points: Array2,
    filled: Array2,
) -> None:
    """How each joint moves the first point that it carries, and turns it.

    Args:
        which: the joints, by their numbers along the chain, (n,); increasing.
        slides: True for a joint of the chain that slides; others turn.
        units: the motion of each joint that counts as one, (n,).
        axes: axes of the joints of the chain.
        origins: their origins.
        ends: how many of the joints carry each point, (m,); increasing.
        points: the points, (m, 3).
        filled: filled with motion and turning, (n, 6).
    """
    k = 0
    for i in range(len(which)):
        while k < len(ends) and ends[k] <= i:
            k += 1
        u, unit = which[i], units[i]
        a0, a1, a2 = unit * axes[u, 0], unit * axes[u, 1], unit * axes[u, 2]
        if slides[u]:
            filled[i, 0], filled[i, 1], filled[i, 2] = a0, a1, a2
            filled[i, 3], filled[i, 4], filled[i, 5] = 0.0, 0.0, 0.0
        else:
            at = k if k < len(ends) else len(ends) - 1
            x = points[at, 0] - origins[u, 0]
            y = points[at, 1] - origins[u, 1]
            z = points[at, 2] - origins[u, 2]
            filled[i, 0] = a1 * z - a2 * y
            filled[i, 1] = a2 * x - a0 * z
            filled[i, 2] = a0 * y - a1 * x
            filled[i, 3], filled[i, 4], filled[i, 5] = a0, a1, a2


@compiled
def move_points(b: Array2, ends: Ints1, points: Array2, x: Array1, filled: Array2) -> None:
    """How motions x of the joints move the points: fills v, (m, 3)."""
    v0, v1, v2, w0, w1, w2 = 0.0, 0.0, 0.0, 0.0, 0.0, 0.0
    for k in range(len(ends)):
        if k:
            r0 = points[k, 0] - points[k - 1, 0]
            r1 = points[k, 1] - points[k - 1, 1]
            r2 = points[k, 2] - points[k - 1, 2]
            v0, v1, v2 = v0 + w1 * r2 - w2 * r1, v1 + w2 * r0 - w0 * r2, v2 + w0 * r1 - w1 * r0
        for u in range(ends[k - 1] if k else 0, ends[k]):
            v0, v1, v2 = v0 + b[u, 0] * x[u], v1 + b[u, 1] * x[u], v2 + b[u, 2] * x[u]
            w0, w1, w2 = w0 + b[u, 3] * x[u], w1 + b[u, 4] * x[u], w2 + b[u, 5] * x[u]
        filled[k, 0], filled[k, 1], filled[k, 2] = v0, v1, v2


@compiled
def measure_point_errors(
    points: Array2, targets: Array2, weights: Array1, chords: Array1, normal: Array1, errors: Array2
) -> float:
    """Errors of points, and the weighted sum of their squares and of those of their chords.

    Args:
        points: the points, (m, 3).
        targets: where they should be, (m, 3).
        weights: W, (m,).
        chords: C, (m,).
        normal: a direction in which nothing can move and errors do not count, (3,); zero if there is none.
        errors: filled with e, (m, 3).
    """
    total = 0.0
    for k in range(len(points)):
        across = 0.0
        for j in range(3):
            errors[k, j] = targets[k, j] - points[k, j]
            across += errors[k, j] * normal[j]
        for j in range(3):
            errors[k, j] -= across * normal[j]
            before = errors[k - 1, j] if k else 0.0
            total += weights[k] * errors[k, j] ** 2 + chords[k] * (errors[k, j] - before) ** 2
    return total


@compiled
def stiffness(springs: PointObjective) -> float:
    """Mean over the joints of what one unit of their motion, alone, adds to the sum by points and chords."""
    b, ends, points, weights, chords = springs
    m = len(ends)
    total, whole = 0.0, 0.0
    first_moment, second, of_chords = np.zeros(3), np.zeros((3, 3)), np.zeros((3, 3))
    r = np.zeros(3)
    for k in range(m - 1, -1, -1):
        whole += weights[k]
        for u in range(ends[k - 1] if k else 0, ends[k]):
            v, a = b[u, :3], b[u, 3:]
            squared = v[0] ** 2 + v[1] ** 2 + v[2] ** 2
            total += (whole + chords[k]) * squared
            total += 2.0 * (
                v[0] * (a[1] * first_moment[2] - a[2] * first_moment[1])
                + v[1] * (a[2] * first_moment[0] - a[0] * first_moment[2])
                + v[2] * (a[0] * first_moment[1] - a[1] * first_moment[0])
            )
            for i in range(3):
                for j in range(3):
                    total += a[i] * (second[i, j] + of_chords[i, j]) * a[j]
        if k:  # moments about the point before
            inner, along = 0.0, 0.0
            for i in range(3):
                r[i] = points[k, i] - points[k - 1, i]
                inner += r[i] * r[i]
                along += r[i] * first_moment[i]
            for i in range(3):
                for j in range(3):
                    outer = r[i] * r[j]
                    own = inner if i == j else 0.0
                    mixed = 2.0 * along if i == j else 0.0
                    mixed -= r[i] * first_moment[j] + first_moment[i] * r[j]
                    second[i, j] += mixed + whole * (own - outer)
                    of_chords[i, j] += chords[k] * (own - outer)
            for i in range(3):
                first_moment[i] += whole * r[i]
    return total / max(len(b), 1)


# Least squares along a chain within a box: the motions that limits leave, still by sweeps.
#
# First the joints at a bound are guessed and corrected: those that would leave the box are held at its side,
# those that are held and pushed inwards are let go, all at once, until nothing changes (a primal-dual active
# set method, which is Newton's on the optimality conditions). Mostly two to five rounds are enough. Where
# they go round in circles, an interior point method (Mehrotra's predictor and corrector) comes close in some
# ten iterations, however many joints are at their bounds, and the guess that it leads to is corrected as
# before.

ROUNDS, ITERATIONS = 6, 40
"""The most corrections of a guess, and the most iterations of the interior point method."""

GAP = 1e-11
"""Complementarity gap at which the interior point method ends, relative to the one at its beginning."""

TINY = 1e-12
"""Motion that is only rounding, in units of a joint."""

BACK = 0.995
"""Share of the way to the boundary that one iteration goes."""


@compiled
def minimise_in_box(
    springs: PointObjective,
    errors: Array2,
    damping: Array1,
    centre: Array1,
    lower: Array1,
    upper: Array1,
    sides: Bytes1,
    x: Array1,
) -> int:
    """Minimise the sum of `kernels.chain_solver` within a box.

    Args:
        springs: points and chords.
        errors: e, (m, 3).
        damping: D, (n,), positive.
        centre: z, (n,).
        lower: smallest x, (n,).
        upper: largest x, (n,).
        sides: a guess of which joints are at their lower (-1) or upper (1) bound; filled with those that
            are, (n,).
        x: filled with the minimum, (n,).

    Returns:
        How many systems were solved.
    """
    n, m = len(springs.screws), len(springs.ends)
    gains, slope, missed = np.empty((n, 11)), np.empty(n), np.empty((m, 6))
    held, close = np.empty(n, dtype=np.bool_), np.empty(n)
    solved = 0
    for attempt in range(2):
        for _ in range(ROUNDS):
            any_held = False
            for u in range(n):
                held[u] = sides[u] != 0 or _thin(lower[u], upper[u])
                any_held = any_held or held[u]
                if held[u]:
                    x[u] = upper[u] if sides[u] > 0 else lower[u]
            factored(springs, damping, held, gains)
            answered(springs, errors, damping, centre, held, gains, x)
            solved += 1
            if any_held:
                slope_of(springs, errors, damping, centre, x, slope, missed)
            settled = True
            for u in range(n):
                if _thin(lower[u], upper[u]):
                    continue
                side, inverse = 0, gains[u, 10]
                if held[u]:  # where it would go, let alone, counts if it is more than rounding
                    if -slope[u] * inverse * sides[u] >= -TINY:
                        side = sides[u]
                elif x[u] < lower[u] - TINY:
                    side = -1
                elif x[u] > upper[u] + TINY:
                    side = 1
                settled = settled and side == sides[u]
                sides[u] = side
            if settled:
                _cut(x, lower, upper)
                return solved
        if attempt == 0:
            solved += _inner(springs, errors, damping, centre, lower, upper, sides, x, gains)
            for u in range(n):
                close[u] = x[u]
    # Round in circles again: as close as the one or the other came.
    _cut(x, lower, upper)
    _cut(close, lower, upper)
    last = slope_of(springs, errors, damping, centre, x, slope, missed)
    inner = slope_of(springs, errors, damping, centre, close, slope, missed)
    if not last <= inner:
        for u in range(n):
            x[u] = close[u]
    return solved


@subkernel
def _thin(lower: float, upper: float) -> bool:
    """Whether there is no room between two bounds."""
    return upper - lower <= TINY


@subkernel
def _cut(x: Array1, lower: Array1, upper: Array1) -> None:
    """Bring x into the box; no motion, where it is no number."""
    for u in range(len(x)):
        if np.isnan(x[u]):
            x[u] = 0.0
        x[u] = min(max(x[u], lower[u]), upper[u])


@subkernel
def _inner(
    springs: PointObjective,
    errors: Array2,
    damping: Array1,
    centre: Array1,
    lower: Array1,
    upper: Array1,
    sides: Bytes1,
    x: Array1,
    gains: Array2,
) -> int:
    """An interior point method: fills x with a point near the minimum, and `sides` with a guess."""
    n, m = len(springs.screws), len(springs.ends)
    slope, missed, held = np.empty(n), np.empty((m, 6)), np.zeros(n, dtype=np.bool_)
    low, high = np.zeros(n), np.zeros(n)  # multipliers of the sides
    stiff, pulled, there = np.empty(n), np.empty(n), np.empty(n)
    moves, downs, ups = np.zeros(n), np.zeros(n), np.zeros(n)
    bounds = 0
    for u in range(n):
        held[u] = _thin(lower[u], upper[u])
        below, above = np.isfinite(lower[u]), np.isfinite(upper[u])
        if held[u]:
            x[u] = lower[u]
        elif below and above:
            x[u] = 0.5 * (lower[u] + upper[u])
        elif below:
            x[u] = max(lower[u] + 1.0, centre[u])
        elif above:
            x[u] = min(upper[u] - 1.0, centre[u])
        else:
            x[u] = centre[u]
        bounds += 0 if held[u] else int(below) + int(above)
    slope_of(springs, errors, damping, centre, x, slope, missed)
    start = 0.0
    for u in range(n):
        if not held[u]:
            room = min(x[u] - lower[u], upper[u] - x[u])
            start += abs(slope[u]) * min(room, 1.0)
    start = max(0.1 * start / n, 1e-300)
    for u in range(n):
        if not held[u]:
            low[u] = start / (x[u] - lower[u])
            high[u] = start / (upper[u] - x[u])
    iterations, left = 0, 1.0  # share of the mismatch of multipliers and slope
    while iterations < ITERATIONS:
        gap = 0.0
        for u in range(n):
            if not held[u]:
                gap += _product(low[u], x[u] - lower[u]) + _product(high[u], upper[u] - x[u])
        gap /= max(bounds, 1)
        if gap <= GAP * start and left <= GAP:
            break
        iterations += 1
        aim, gap_there = 0.0, 0.0
        for corrector in range(2):
            for u in range(n):
                if held[u]:
                    there[u] = x[u]
                    continue
                a, c = x[u] - lower[u], upper[u] - x[u]
                p, r = low[u] / a, high[u] / c
                push = aim / a - aim / c
                if corrector:  # what the predictor left out: products of changes
                    move = moves[u]
                    push += (low[u] + p * move) * move / a + (high[u] - r * move) * move / c
                stiff[u] = damping[u] + p + r
                pulled[u] = (damping[u] * centre[u] + (p + r) * x[u] + push) / stiff[u]
            if not corrector:
                factored(springs, stiff, held, gains)
            answered(springs, errors, stiff, pulled, held, gains, there)
            # How far there is room to go, for x and for the multipliers.
            reach = 1.0
            for u in range(n):
                if held[u]:
                    continue
                a, c, move = x[u] - lower[u], upper[u] - x[u], there[u] - x[u]
                p, r = low[u] / a, high[u] / c
                first = moves[u] if corrector else 0.0
                down = (aim + (low[u] + p * first) * first) / a - low[u] - p * move
                up = (aim - (high[u] - r * first) * first) / c - high[u] + r * move
                if -move * reach > a:
                    reach = -a / move
                if move * reach > c:
                    reach = c / move
                if -down * reach > low[u]:
                    reach = -low[u] / down
                if -up * reach > high[u]:
                    reach = -high[u] / up
                moves[u], downs[u], ups[u] = move if not corrector else first, down, up
            if corrector:
                break
            gap_there = 0.0
            for u in range(n):
                if not held[u]:
                    move = reach * moves[u]
                    gap_there += _product(low[u] + reach * downs[u], x[u] + move - lower[u])
                    gap_there += _product(high[u] + reach * ups[u], upper[u] - x[u] - move)
            gap_there /= max(bounds, 1)
            aim = gap * (gap_there / gap) ** 3
        left *= 1.0 - BACK * reach
        for u in range(n):
            if not held[u]:
                x[u] += BACK * reach * (there[u] - x[u])
                low[u] += BACK * reach * downs[u]
                high[u] += BACK * reach * ups[u]
    for u in range(n):
        sides[u] = 0
        if not held[u] and gains[u, 10] * low[u] > 0.5 * (x[u] - lower[u]):
            sides[u] = -1
        elif not held[u] and gains[u, 10] * high[u] > 0.5 * (upper[u] - x[u]):
            sides[u] = 1
    return iterations


@subkernel
def _product(multiplier: float, room: float) -> float:
    """Complementarity of one side; none where there is no bound."""
    return multiplier * room if np.isfinite(room) else 0.0
