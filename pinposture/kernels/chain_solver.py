"""Least squares along a chain in O(n), by one pass to the base and one back; also with box constraints."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from pinposture.kernels.arrays import (
    JOINT,
    ArmArrays,
    Array1,
    Array2,
    Bytes1,
    Flags1,
    Ints1,
    PointObjective,
)
from pinposture.kernels.compiled import compiled, subkernel
from pinposture.kernels.kinematics import difference, point_velocity

# The unknowns are the motions x of the joints. Point k moves by v_k, its body turns by w_k. The objective is
#
# sum over k of W_k |v_k - e_k|^2 + C_k |v_k - v_{k-1} - (e_k - e_{k-1})|^2 + sum over u of D_u (x_u - z_u)^2
#
# On a chain this is an optimal control problem with the joint index as time: the state is (v, w) at a point,
# and joint u adds (a x (p - o), a) x_u to it. The minimum over all farther joints is a quadratic function of
# the state, computed from the tip to the base (a Riccati recursion on the state before a module, the
# displacement since then and the rotation, because chords depend on the displacement). The motions then
# follow from the base to the tip. Velocities are taken at the points themselves: at a distant common origin
# they would suffer cancellation. Joints may be held at their x; the others are optimal given those.


class BoxSolverSettings(NamedTuple):
    """Settings of the active set method, and of the interior point method where it fails."""

    set_changes: int = 6
    """Largest number of corrections of the active set."""

    iterations: int = 40
    """Largest number of iterations of the interior point method."""

    gap: float = 1e-11
    """Complementarity gap, relative to the initial one, and mismatch at which that method ends."""

    share_to_boundary: float = 0.995
    """Share of the way to the boundary that one of its iterations takes."""

    rounding: float = 1e-12
    """Joint motion that counts as rounding error, in units of a joint."""


BOX_SOLVER = BoxSolverSettings()


ChainProblem = tuple[PointObjective, Array2, Array1, Array1]
"""Points and chords, their errors e, (m, 3), damping D, (n,), positive, and centre z, (n,)."""


@subkernel
def factor(objective: PointObjective, damping: Array1, held: Flags1, gains: Array2) -> None:
    """Run the pass from the tip to the base, without right-hand sides.

    Args:
        objective: points and chords.
        damping: D, (n,), positive.
        held: True for joints that are held, (n,).
        gains: filled with the gains for `solve_factored`, (n, 11).
    """
    b, ends, points, weights, chords = objective
    m = len(ends)
    for u in range(ends[m - 1], len(b)):  # joints beyond the last point only have damping
        gains[u, 10] = 1.0 / damping[u]
    P = np.zeros((9, 9))  # cost of (v before, displacement since, w)
    turned = np.empty((9, 3))
    for k in range(m - 1, -1, -1):
        first = ends[k - 1] if k else 0
        # P is a function of (v, w) after the module, in rows 0:3 and 6:9.
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
            b0 = b[u, 0]
            b1 = b[u, 1]
            b2 = b[u, 2]
            b3 = b[u, 3]
            b4 = b[u, 4]
            b5 = b[u, 5]
            g = gains[u]
            for i in range(3, 9):
                moved = P[i, 3] * b0 + P[i, 4] * b1 + P[i, 5] * b2
                g[i] = moved + P[i, 6] * b3 + P[i, 7] * b4 + P[i, 8] * b5
            if chords[k] > 0.0:
                for i in range(3):
                    moved = P[i, 3] * b0 + P[i, 4] * b1 + P[i, 5] * b2
                    g[i] = moved + P[i, 6] * b3 + P[i, 7] * b4 + P[i, 8] * b5
            else:  # without a chord, displacement and v before are equivalent
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
            _shift_to_previous(P, turned, points[k], points[k - 1])


@subkernel
def _shift_to_previous(P: Array2, turned: Array2, point: Array1, previous: Array1) -> None:
    """Convert the cost of (v, displacement, w) to (v, w) at the previous point: displacement = w x r."""
    r0 = point[0] - previous[0]
    r1 = point[1] - previous[1]
    r2 = point[2] - previous[2]
    for i in range(9):  # P (w x r) for the three units of w
        turned[i, 0] = P[i, 5] * r1 - P[i, 4] * r2
        turned[i, 1] = P[i, 3] * r2 - P[i, 5] * r0
        turned[i, 2] = P[i, 4] * r0 - P[i, 3] * r1
    for i in range(3):
        for j in range(3):
            P[i, 6 + j] += turned[i, j]
            P[6 + j, i] = P[i, 6 + j]
    for j in range(3):
        x = turned[3, j]
        y = turned[4, j]
        z = turned[5, j]
        across = (r1 * z - r2 * y, r2 * x - r0 * z, r0 * y - r1 * x)
        for i in range(j + 1):
            P[6 + i, 6 + j] += turned[6 + i, j] + turned[6 + j, i] + across[i]
            P[6 + j, 6 + i] = P[6 + i, 6 + j]


@subkernel
def solve_factored(problem: ChainProblem, held: Flags1, gains: Array2, x: Array1) -> None:
    """Solve for one right-hand side after `factor`: the pass back to the base, then that to the tip.

    Args:
        problem: the problem.
        held: True for joints that are held, (n,).
        gains: from `factor`; its column 9 is scratch.
        x: motions of the held joints; filled with those of the others, (n,).
    """
    (b, ends, points, weights, chords), errors, damping, centre = problem
    n = len(b)
    m = len(ends)
    for i in range(ends[m - 1], n):  # joints beyond the last point move no point
        if not held[i]:
            x[i] = centre[i]
    s0 = 0.0
    s1 = 0.0
    s2 = 0.0
    s3 = 0.0
    s4 = 0.0
    s5 = 0.0
    s6 = 0.0
    s7 = 0.0
    s8 = 0.0
    for k in range(m - 1, -1, -1):
        first = ends[k - 1] if k else 0
        w = weights[k]
        c = chords[k]
        s0 = s0 + w * errors[k, 0]
        s1 = s1 + w * errors[k, 1]
        s2 = s2 + w * errors[k, 2]
        if k:
            s3 = s0 + c * (errors[k, 0] - errors[k - 1, 0])
            s4 = s1 + c * (errors[k, 1] - errors[k - 1, 1])
            s5 = s2 + c * (errors[k, 2] - errors[k - 1, 2])
        else:
            s3 = s0 + c * errors[0, 0]
            s4 = s1 + c * errors[0, 1]
            s5 = s2 + c * errors[0, 2]
        for u in range(ends[k] - 1, first - 1, -1):
            g = gains[u]
            t = x[u]
            if not held[u]:
                t = g[10] * (
                    damping[u] * centre[u]
                    + (b[u, 0] * s3 + b[u, 1] * s4 + b[u, 2] * s5)
                    + (b[u, 3] * s6 + b[u, 4] * s7 + b[u, 5] * s8)
                )
                g[9] = t
            s0 = s0 - g[0] * t
            s1 = s1 - g[1] * t
            s2 = s2 - g[2] * t
            s3 = s3 - g[3] * t
            s4 = s4 - g[4] * t
            s5 = s5 - g[5] * t
            s6 = s6 - g[6] * t
            s7 = s7 - g[7] * t
            s8 = s8 - g[8] * t
        if k:
            r0, r1, r2 = difference(points, k, k - 1)
            s6 = s6 + r1 * s5 - r2 * s4
            s7 = s7 + r2 * s3 - r0 * s5
            s8 = s8 + r0 * s4 - r1 * s3
    v0 = 0.0
    v1 = 0.0
    v2 = 0.0
    w0 = 0.0
    w1 = 0.0
    w2 = 0.0
    for k in range(m):
        first = ends[k - 1] if k else 0
        d0 = 0.0
        d1 = 0.0
        d2 = 0.0
        if k:
            r0, r1, r2 = difference(points, k, k - 1)
            d0 = w1 * r2 - w2 * r1
            d1 = w2 * r0 - w0 * r2
            d2 = w0 * r1 - w1 * r0
        for u in range(first, ends[k]):
            if not held[u]:
                g = gains[u]
                x[u] = g[9] - g[10] * (
                    (g[0] * v0 + g[1] * v1 + g[2] * v2)
                    + (g[3] * d0 + g[4] * d1 + g[5] * d2)
                    + (g[6] * w0 + g[7] * w1 + g[8] * w2)
                )
            d0 = d0 + b[u, 0] * x[u]
            d1 = d1 + b[u, 1] * x[u]
            d2 = d2 + b[u, 2] * x[u]
            w0 = w0 + b[u, 3] * x[u]
            w1 = w1 + b[u, 4] * x[u]
            w2 = w2 + b[u, 5] * x[u]
        v0 = v0 + d0
        v1 = v1 + d1
        v2 = v2 + d2


@subkernel
def evaluate_gradient(problem: ChainProblem, x: Array1, slope: Array1, missed: Array2) -> float:
    """Return half the objective at x and fill `slope` with half its gradient; `missed` (m, 6) is scratch."""
    (b, ends, points, weights, chords), errors, damping, centre = problem
    n = len(b)
    m = len(ends)
    total = 0.0
    for u in range(n):
        off = x[u] - centre[u]
        slope[u] = damping[u] * off
        total += damping[u] * off * off
    v0 = 0.0
    v1 = 0.0
    v2 = 0.0
    w0 = 0.0
    w1 = 0.0
    w2 = 0.0
    for k in range(m):
        first = ends[k - 1] if k else 0
        d0 = 0.0
        d1 = 0.0
        d2 = 0.0
        e0 = 0.0
        e1 = 0.0
        e2 = 0.0
        if k:
            r0, r1, r2 = difference(points, k, k - 1)
            d0 = w1 * r2 - w2 * r1
            d1 = w2 * r0 - w0 * r2
            d2 = w0 * r1 - w1 * r0
            e0 = errors[k - 1, 0]
            e1 = errors[k - 1, 1]
            e2 = errors[k - 1, 2]
        for u in range(first, ends[k]):
            d0 = d0 + b[u, 0] * x[u]
            d1 = d1 + b[u, 1] * x[u]
            d2 = d2 + b[u, 2] * x[u]
            w0 = w0 + b[u, 3] * x[u]
            w1 = w1 + b[u, 4] * x[u]
            w2 = w2 + b[u, 5] * x[u]
        v0 = v0 + d0
        v1 = v1 + d1
        v2 = v2 + d2
        f0 = v0 - errors[k, 0]
        f1 = v1 - errors[k, 1]
        f2 = v2 - errors[k, 2]
        h0 = d0 - (errors[k, 0] - e0)
        h1 = d1 - (errors[k, 1] - e1)
        h2 = d2 - (errors[k, 2] - e2)
        w = weights[k]
        c = chords[k]
        total += w * (f0 * f0 + f1 * f1 + f2 * f2) + c * (h0 * h0 + h1 * h1 + h2 * h2)
        missed[k, 0] = w * f0
        missed[k, 1] = w * f1
        missed[k, 2] = w * f2
        missed[k, 3] = c * h0
        missed[k, 4] = c * h1
        missed[k, 5] = c * h2
    # Forces at the points, and their moments, summed from the tip.
    f0 = 0.0
    f1 = 0.0
    f2 = 0.0
    t0 = 0.0
    t1 = 0.0
    t2 = 0.0
    for k in range(m - 1, -1, -1):
        first = ends[k - 1] if k else 0
        f0 = f0 + missed[k, 0]
        f1 = f1 + missed[k, 1]
        f2 = f2 + missed[k, 2]
        g0 = f0 + missed[k, 3]
        g1 = f1 + missed[k, 4]
        g2 = f2 + missed[k, 5]
        for u in range(first, ends[k]):
            slope[u] += (
                b[u, 0] * g0 + b[u, 1] * g1 + b[u, 2] * g2 + b[u, 3] * t0 + b[u, 4] * t1 + b[u, 5] * t2
            )
        if k:  # moments about the previous point
            r0, r1, r2 = difference(points, k, k - 1)
            t0 = t0 + r1 * g2 - r2 * g1
            t1 = t1 + r2 * g0 - r0 * g2
            t2 = t2 + r0 * g1 - r1 * g0
    return 0.5 * total


@compiled
def find_screws(
    chain: ArmArrays,
    which: Ints1,
    units: Array1,
    axes: Array2,
    origins: Array2,
    ends: Ints1,
    points: Array2,
    filled: Array2,
) -> None:
    """Compute the linear and angular velocity of the first point that each joint carries.

    Args:
        chain: the chain.
        which: the joints, by index among its degrees of freedom, (n,); increasing.
        units: unit of motion of each of them, (n,).
        axes: axes of all joints of the chain, (k, 3).
        origins: their origins, (k, 3).
        ends: number of the joints that carry each point, (m,); increasing.
        points: the points, (m, 3).
        filled: filled with linear and angular velocity, (n, 6).
    """
    k = 0
    joints = chain.joints
    driven = chain.driven
    starts = chain.starts
    for i in range(len(which)):
        while k < len(ends) and ends[k] <= i:
            k += 1
        at = k if k < len(ends) else len(ends) - 1
        x = points[at, 0]
        y = points[at, 1]
        z = points[at, 2]
        unit = units[i]
        v0 = 0.0
        v1 = 0.0
        v2 = 0.0
        w0 = 0.0
        w1 = 0.0
        w2 = 0.0
        for place in range(starts[which[i]], starts[which[i] + 1]):
            u = driven[place]
            vx, vy, vz = point_velocity(joints, u, axes, origins, x, y, z)
            v0 = v0 + unit * vx
            v1 = v1 + unit * vy
            v2 = v2 + unit * vz
            if joints.kinds[u] == JOINT.revolute:
                turned = unit * joints.ratios[u]
                w0 = w0 + turned * axes[u, 0]
                w1 = w1 + turned * axes[u, 1]
                w2 = w2 + turned * axes[u, 2]
        filled[i, 0] = v0
        filled[i, 1] = v1
        filled[i, 2] = v2
        filled[i, 3] = w0
        filled[i, 4] = w1
        filled[i, 5] = w2


@compiled
def move_points(b: Array2, ends: Ints1, points: Array2, x: Array1, filled: Array2) -> None:
    """Compute the motions v of the points, (m, 3), for motions x of the joints."""
    v0 = 0.0
    v1 = 0.0
    v2 = 0.0
    w0 = 0.0
    w1 = 0.0
    w2 = 0.0
    for k in range(len(ends)):
        if k:
            r0, r1, r2 = difference(points, k, k - 1)
            v0 = v0 + w1 * r2 - w2 * r1
            v1 = v1 + w2 * r0 - w0 * r2
            v2 = v2 + w0 * r1 - w1 * r0
        for u in range(ends[k - 1] if k else 0, ends[k]):
            v0 = v0 + b[u, 0] * x[u]
            v1 = v1 + b[u, 1] * x[u]
            v2 = v2 + b[u, 2] * x[u]
            w0 = w0 + b[u, 3] * x[u]
            w1 = w1 + b[u, 4] * x[u]
            w2 = w2 + b[u, 5] * x[u]
        filled[k, 0] = v0
        filled[k, 1] = v1
        filled[k, 2] = v2


@subkernel
def pull_points(b: Array2, ends: Ints1, points: Array2, forces: Array2, filled: Array1) -> None:
    """Add the joint efforts, (n,), caused by forces at the points, (m, 3)."""
    f0 = 0.0
    f1 = 0.0
    f2 = 0.0
    t0 = 0.0
    t1 = 0.0
    t2 = 0.0
    for k in range(len(ends) - 1, -1, -1):
        f0 = f0 + forces[k, 0]
        f1 = f1 + forces[k, 1]
        f2 = f2 + forces[k, 2]
        for u in range(ends[k - 1] if k else 0, ends[k]):
            linear = b[u, 0] * f0 + b[u, 1] * f1 + b[u, 2] * f2
            filled[u] += linear + b[u, 3] * t0 + b[u, 4] * t1 + b[u, 5] * t2
        if k:  # moments about the point before
            r0, r1, r2 = difference(points, k, k - 1)
            t0 = t0 + r1 * f2 - r2 * f1
            t1 = t1 + r2 * f0 - r0 * f2
            t2 = t2 + r0 * f1 - r1 * f0


@subkernel
def move_bodies(b: Array2, ends: Ints1, points: Array2, x: Array1, twists: Array2) -> None:
    """Fill in the motion of the body after each joint, (n + 1, 6); the first one is the fixed base.

    Velocities are those of the first point that the body carries, or of the last point.
    """
    k = 0
    v0 = 0.0
    v1 = 0.0
    v2 = 0.0
    w0 = 0.0
    w1 = 0.0
    w2 = 0.0
    twists[0] = 0.0
    for u in range(len(b)):
        while k < len(ends) - 1 and ends[k] <= u:
            k += 1
            r0, r1, r2 = difference(points, k, k - 1)
            v0 = v0 + w1 * r2 - w2 * r1
            v1 = v1 + w2 * r0 - w0 * r2
            v2 = v2 + w0 * r1 - w1 * r0
        v0 = v0 + b[u, 0] * x[u]
        v1 = v1 + b[u, 1] * x[u]
        v2 = v2 + b[u, 2] * x[u]
        w0 = w0 + b[u, 3] * x[u]
        w1 = w1 + b[u, 4] * x[u]
        w2 = w2 + b[u, 5] * x[u]
        t = twists[u + 1]
        t[0] = v0
        t[1] = v1
        t[2] = v2
        t[3] = w0
        t[4] = w1
        t[5] = w2


@subkernel
def pull_bodies(b: Array2, ends: Ints1, points: Array2, wrenches: Array2, filled: Array1) -> None:
    """Add the joint efforts, (n,), caused by forces and moments on bodies; see `move_bodies`."""
    k = len(ends) - 1
    f0 = 0.0
    f1 = 0.0
    f2 = 0.0
    t0 = 0.0
    t1 = 0.0
    t2 = 0.0
    for u in range(len(b) - 1, -1, -1):
        while k > 0 and ends[k - 1] > u:  # moments about the point before
            r0, r1, r2 = difference(points, k, k - 1)
            t0 = t0 + r1 * f2 - r2 * f1
            t1 = t1 + r2 * f0 - r0 * f2
            t2 = t2 + r0 * f1 - r1 * f0
            k -= 1
        g = wrenches[u + 1]
        f0 = f0 + g[0]
        f1 = f1 + g[1]
        f2 = f2 + g[2]
        t0 = t0 + g[3]
        t1 = t1 + g[4]
        t2 = t2 + g[5]
        linear = b[u, 0] * f0 + b[u, 1] * f1 + b[u, 2] * f2
        filled[u] += linear + b[u, 3] * t0 + b[u, 4] * t1 + b[u, 5] * t2


@compiled
def measure_point_errors(
    points: Array2, targets: Array2, weights: Array1, chords: Array1, normal: Array1, errors: Array2
) -> float:
    """Compute errors of points; return the weighted sum of squares of these and of their chords' errors.

    Args:
        points: the points, (m, 3).
        targets: their targets, (m, 3).
        weights: W, (m,).
        chords: C, (m,).
        normal: direction in which errors are ignored, such as the normal of a plane, (3,); zero for none.
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
def stiffness(objective: PointObjective) -> float:
    """Return the cost of points and chords per unit of motion of a single joint, averaged over joints."""
    b, ends, points, weights, chords = objective
    m = len(ends)
    total = 0.0
    whole = 0.0
    first_moment = np.zeros(3)
    second = np.zeros((3, 3))
    of_chords = np.zeros((3, 3))
    r = np.zeros(3)
    for k in range(m - 1, -1, -1):
        whole += weights[k]
        for u in range(ends[k - 1] if k else 0, ends[k]):
            v = b[u, :3]
            a = b[u, 3:]
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
            inner = 0.0
            along = 0.0
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


# Without chords, held joints and loads on bodies, the cost before each joint is a function of (v, w) alone,
# whose 21 coefficients stay in registers. Factor and solution then take one pass to the base and one back.


@compiled
def minimise_points(
    b: Array2,
    ends: Ints1,
    points: Array2,
    errors: Array2,
    damping: float,
    centre: Array1,
    gains: Array2,
    x: Array1,
) -> None:
    """Minimise the sum over k of |v_k - e_k|^2 + damping * sum over u of (x_u - z_u)^2.

    Args:
        b: screws, (n, 6), from `find_screws`.
        ends: number of joints that carry each point, (m,); increasing.
        points: the points, (m, 3).
        errors: e, (m, 3).
        damping: the damping of each joint, positive.
        centre: z, (n,).
        gains: scratch, (n, 8).
        x: filled with the minimum, (n,).
    """
    m = len(ends)
    for u in range(ends[m - 1], len(b)):  # joints beyond the last point move no point
        x[u] = centre[u]
    # The cost is v P v + 2 v Q w + w R w - 2 s (v, w).
    p00 = 0.0
    p01 = 0.0
    p02 = 0.0
    p11 = 0.0
    p12 = 0.0
    p22 = 0.0
    q00 = 0.0
    q01 = 0.0
    q02 = 0.0
    q10 = 0.0
    q11 = 0.0
    q12 = 0.0
    q20 = 0.0
    q21 = 0.0
    q22 = 0.0
    r00 = 0.0
    r01 = 0.0
    r02 = 0.0
    r11 = 0.0
    r12 = 0.0
    r22 = 0.0
    s0 = 0.0
    s1 = 0.0
    s2 = 0.0
    s3 = 0.0
    s4 = 0.0
    s5 = 0.0
    for k in range(m - 1, -1, -1):
        p00 = p00 + 1.0
        p11 = p11 + 1.0
        p22 = p22 + 1.0
        s0 = s0 + errors[k, 0]
        s1 = s1 + errors[k, 1]
        s2 = s2 + errors[k, 2]
        for u in range(ends[k] - 1, (ends[k - 1] if k else 0) - 1, -1):
            v0 = b[u, 0]
            v1 = b[u, 1]
            v2 = b[u, 2]
            w0 = b[u, 3]
            w1 = b[u, 4]
            w2 = b[u, 5]
            g0 = (p00 * v0 + p01 * v1 + p02 * v2) + (q00 * w0 + q01 * w1 + q02 * w2)
            g1 = (p01 * v0 + p11 * v1 + p12 * v2) + (q10 * w0 + q11 * w1 + q12 * w2)
            g2 = (p02 * v0 + p12 * v1 + p22 * v2) + (q20 * w0 + q21 * w1 + q22 * w2)
            g3 = (q00 * v0 + q10 * v1 + q20 * v2) + (r00 * w0 + r01 * w1 + r02 * w2)
            g4 = (q01 * v0 + q11 * v1 + q21 * v2) + (r01 * w0 + r11 * w1 + r12 * w2)
            g5 = (q02 * v0 + q12 * v1 + q22 * v2) + (r02 * w0 + r12 * w1 + r22 * w2)
            inverse = 1.0 / (damping + (v0 * g0 + v1 * g1 + v2 * g2) + (w0 * g3 + w1 * g4 + w2 * g5))
            pull = (v0 * s0 + v1 * s1 + v2 * s2) + (w0 * s3 + w1 * s4 + w2 * s5)
            t = inverse * (damping * centre[u] + pull)
            g = gains[u]
            g[0] = g0
            g[1] = g1
            g[2] = g2
            g[3] = g3
            g[4] = g4
            g[5] = g5
            g[6] = inverse
            g[7] = t
            s0 = s0 - g0 * t
            s1 = s1 - g1 * t
            s2 = s2 - g2 * t
            s3 = s3 - g3 * t
            s4 = s4 - g4 * t
            s5 = s5 - g5 * t
            h0 = inverse * g0
            h1 = inverse * g1
            h2 = inverse * g2
            h3 = inverse * g3
            h4 = inverse * g4
            h5 = inverse * g5
            p00 = p00 - h0 * g0
            p01 = p01 - h0 * g1
            p02 = p02 - h0 * g2
            p11 = p11 - h1 * g1
            p12 = p12 - h1 * g2
            p22 = p22 - h2 * g2
            q00 = q00 - h0 * g3
            q01 = q01 - h0 * g4
            q02 = q02 - h0 * g5
            q10 = q10 - h1 * g3
            q11 = q11 - h1 * g4
            q12 = q12 - h1 * g5
            q20 = q20 - h2 * g3
            q21 = q21 - h2 * g4
            q22 = q22 - h2 * g5
            r00 = r00 - h3 * g3
            r01 = r01 - h3 * g4
            r02 = r02 - h3 * g5
            r11 = r11 - h4 * g4
            r12 = r12 - h4 * g5
            r22 = r22 - h5 * g5
        if k:  # at the previous point, v is smaller by w x r = C w: add P C to Q, C Q + Q C + C P C to R
            d0, d1, d2 = difference(points, k, k - 1)
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
            r00 += 2.0 * c00 + d1 * a20 - d2 * a10
            r01 += c01 + c10 + d1 * a21 - d2 * a11
            r02 += c02 + c20 + d1 * a22 - d2 * a12
            r11 += 2.0 * c11 + d2 * a01 - d0 * a21
            r12 += c12 + c21 + d2 * a02 - d0 * a22
            r22 += 2.0 * c22 + d0 * a12 - d1 * a02
            q00 = q00 + a00
            q01 = q01 + a01
            q02 = q02 + a02
            q10 = q10 + a10
            q11 = q11 + a11
            q12 = q12 + a12
            q20 = q20 + a20
            q21 = q21 + a21
            q22 = q22 + a22
            s3 = s3 + d1 * s2 - d2 * s1
            s4 = s4 + d2 * s0 - d0 * s2
            s5 = s5 + d0 * s1 - d1 * s0
    v0 = 0.0
    v1 = 0.0
    v2 = 0.0
    w0 = 0.0
    w1 = 0.0
    w2 = 0.0
    for k in range(m):
        if k:
            d0, d1, d2 = difference(points, k, k - 1)
            v0 = v0 + w1 * d2 - w2 * d1
            v1 = v1 + w2 * d0 - w0 * d2
            v2 = v2 + w0 * d1 - w1 * d0
        for u in range(ends[k - 1] if k else 0, ends[k]):
            g = gains[u]
            moved = (g[0] * v0 + g[1] * v1 + g[2] * v2) + (g[3] * w0 + g[4] * w1 + g[5] * w2)
            y = g[7] - g[6] * moved
            v0 = v0 + y * b[u, 0]
            v1 = v1 + y * b[u, 1]
            v2 = v2 + y * b[u, 2]
            w0 = w0 + y * b[u, 3]
            w1 = w1 + y * b[u, 4]
            w2 = w2 + y * b[u, 5]
            x[u] = y


# With box constraints, the set of joints at a bound is guessed and corrected: joints that would leave the box
# are held at its side and held joints pushed inwards are released, all at once, until nothing changes (a
# primal-dual active set method, which is Newton's method on the optimality conditions). Two to five
# corrections usually suffice. If they cycle, an interior point method (Mehrotra's predictor-corrector) gets
# close in about ten iterations, and the active set that it suggests is corrected in the same way.


@compiled
def minimise_in_box(
    objective: PointObjective,
    errors: Array2,
    damping: Array1,
    centre: Array1,
    lower: Array1,
    upper: Array1,
    at_bound: Bytes1,
    x: Array1,
) -> int:
    """Minimise the objective within a box.

    Args:
        objective: points and chords.
        errors: e, (m, 3).
        damping: D, (n,), positive.
        centre: z, (n,).
        lower: smallest x, (n,).
        upper: largest x, (n,).
        at_bound: initial active set, (n,): -1 at the lower bound, 1 at the upper, else 0; filled with the
            final one.
        x: filled with the minimum, (n,).

    Returns:
        Number of systems solved.
    """
    problem = objective, errors, damping, centre
    n = len(objective.screws)
    m = len(objective.ends)
    gains = np.empty((n, 11))
    slope = np.empty(n)
    missed = np.empty((m, 6))
    held = np.empty(n, dtype=np.bool_)
    interior = np.empty(n)
    solved = 0
    for attempt in range(2):
        for _ in range(BOX_SOLVER.set_changes):
            any_held = False
            for u in range(n):
                held[u] = at_bound[u] != 0 or _is_fixed(lower[u], upper[u])
                any_held = any_held or held[u]
                if held[u]:
                    x[u] = upper[u] if at_bound[u] > 0 else lower[u]
            factor(objective, damping, held, gains)
            solve_factored(problem, held, gains, x)
            solved += 1
            if any_held:
                evaluate_gradient(problem, x, slope, missed)
            converged = True
            for u in range(n):
                if _is_fixed(lower[u], upper[u]):
                    continue
                side = 0
                inverse = gains[u, 10]
                if held[u]:  # stays held unless it would move inwards by more than rounding error
                    if -slope[u] * inverse * at_bound[u] >= -BOX_SOLVER.rounding:
                        side = at_bound[u]
                elif x[u] < lower[u] - BOX_SOLVER.rounding:
                    side = -1
                elif x[u] > upper[u] + BOX_SOLVER.rounding:
                    side = 1
                converged = converged and side == at_bound[u]
                at_bound[u] = side
            if converged:
                _clip(x, lower, upper)
                return solved
        if attempt == 0:
            solved += _interior_point(problem, lower, upper, at_bound, x, gains)
            for u in range(n):
                interior[u] = x[u]
    # It cycled again: take the better result.
    _clip(x, lower, upper)
    _clip(interior, lower, upper)
    last = evaluate_gradient(problem, x, slope, missed)
    inner = evaluate_gradient(problem, interior, slope, missed)
    if not last <= inner:
        for u in range(n):
            x[u] = interior[u]
    return solved


@subkernel
def _is_fixed(lower: float, upper: float) -> bool:
    """Return whether two bounds leave no room to move."""
    return upper - lower <= BOX_SOLVER.rounding


@subkernel
def _clip(x: Array1, lower: Array1, upper: Array1) -> None:
    """Clip x to the box; NaN becomes 0."""
    for u in range(len(x)):
        if np.isnan(x[u]):
            x[u] = 0.0
        x[u] = min(max(x[u], lower[u]), upper[u])


@subkernel
def _interior_point(
    problem: ChainProblem, lower: Array1, upper: Array1, at_bound: Bytes1, x: Array1, gains: Array2
) -> int:
    """Fill x with a point near the minimum by an interior point method, and `at_bound` with an active set."""
    objective, errors, damping, centre = problem
    n = len(objective.screws)
    m = len(objective.ends)
    slope = np.empty(n)
    missed = np.empty((m, 6))
    held = np.zeros(n, dtype=np.bool_)
    # multipliers of the bounds
    low = np.zeros(n)
    high = np.zeros(n)
    stiff = np.empty(n)
    pulled = np.empty(n)
    trial = np.empty(n)
    moves = np.zeros(n)
    downs = np.zeros(n)
    ups = np.zeros(n)
    bounds = 0
    for u in range(n):
        held[u] = _is_fixed(lower[u], upper[u])
        below = np.isfinite(lower[u])
        above = np.isfinite(upper[u])
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
    evaluate_gradient(problem, x, slope, missed)
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
    iterations = 0
    mismatch = 1.0  # fraction of the initial mismatch of multipliers and gradient
    while iterations < BOX_SOLVER.iterations:
        gap = 0.0
        for u in range(n):
            if not held[u]:
                gap += _complementarity(low[u], x[u] - lower[u]) + _complementarity(high[u], upper[u] - x[u])
        gap /= max(bounds, 1)
        if gap <= BOX_SOLVER.gap * start and mismatch <= BOX_SOLVER.gap:
            break
        iterations += 1
        aim = 0.0
        gap_there = 0.0
        for corrector in range(2):
            for u in range(n):
                if held[u]:
                    trial[u] = x[u]
                    continue
                a = x[u] - lower[u]
                c = upper[u] - x[u]
                p = low[u] / a
                r = high[u] / c
                push = aim / a - aim / c
                if corrector:  # second-order terms neglected by the predictor
                    move = moves[u]
                    push += (low[u] + p * move) * move / a + (high[u] - r * move) * move / c
                stiff[u] = damping[u] + p + r
                pulled[u] = (damping[u] * centre[u] + (p + r) * x[u] + push) / stiff[u]
            if not corrector:
                factor(objective, stiff, held, gains)
            solve_factored((objective, errors, stiff, pulled), held, gains, trial)
            # The longest step that keeps x within the bounds and the multipliers positive.
            reach = 1.0
            for u in range(n):
                if held[u]:
                    continue
                a = x[u] - lower[u]
                c = upper[u] - x[u]
                move = trial[u] - x[u]
                p = low[u] / a
                r = high[u] / c
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
                moves[u] = move if not corrector else first
                downs[u] = down
                ups[u] = up
            if corrector:
                break
            gap_there = 0.0
            for u in range(n):
                if not held[u]:
                    move = reach * moves[u]
                    gap_there += _complementarity(low[u] + reach * downs[u], x[u] + move - lower[u])
                    gap_there += _complementarity(high[u] + reach * ups[u], upper[u] - x[u] - move)
            gap_there /= max(bounds, 1)
            aim = gap * (gap_there / gap) ** 3
        mismatch *= 1.0 - BOX_SOLVER.share_to_boundary * reach
        for u in range(n):
            if not held[u]:
                x[u] += BOX_SOLVER.share_to_boundary * reach * (trial[u] - x[u])
                low[u] += BOX_SOLVER.share_to_boundary * reach * downs[u]
                high[u] += BOX_SOLVER.share_to_boundary * reach * ups[u]
    for u in range(n):
        at_bound[u] = 0
        if not held[u] and gains[u, 10] * low[u] > 0.5 * (x[u] - lower[u]):
            at_bound[u] = -1
        elif not held[u] and gains[u, 10] * high[u] > 0.5 * (upper[u] - x[u]):
            at_bound[u] = 1
    return iterations


@subkernel
def solve_cholesky(matrix: Array2, x: Array1) -> bool:
    """Solve a small dense system in place, by Cholesky factorisation.

    Returns:
        False if the matrix is not positive definite; x is then not a number.
    """
    n = len(x)
    positive = True
    for i in range(n):
        for j in range(i + 1):
            value = matrix[i, j]
            for k in range(j):
                value -= matrix[i, k] * matrix[j, k]
            positive = positive and (i != j or value > 0.0)
            matrix[i, j] = np.sqrt(value) if i == j else value / matrix[j, j]
        for k in range(i):
            x[i] -= matrix[i, k] * x[k]
        x[i] /= matrix[i, i]
    for i in range(n - 1, -1, -1):
        for k in range(i + 1, n):
            x[i] -= matrix[k, i] * x[k]
        x[i] /= matrix[i, i]
    return positive


@subkernel
def _complementarity(multiplier: float, room: float) -> float:
    """Return the complementarity of one side; 0 without a bound."""
    return multiplier * room if np.isfinite(room) else 0.0
