"""Numeric search for the next point of a curve that the end of a module with any joints can reach."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from pinposture.kernels.arrays import (
    Array1,
    Array2,
    CurveModule,
    Flags1,
    Ints1,
    LengthArrays,
    SplineArrays,
)
from pinposture.kernels.chain_solver import solve_cholesky
from pinposture.kernels.compiled import compiled, subkernel
from pinposture.kernels.kinematics import jacobians, placements
from pinposture.kernels.spline import parameter_at, span_at, value

# Unknowns are the joint positions and the arc length of the point. The end of the module must be on the
# curve: three equations. With two joints the solutions are isolated; with more, the motion from the preferred
# positions is minimised. Both cases use Gauss-Newton steps from several postures whose ends are near the
# curve.


class TargetPointSettings(NamedTuple):
    """Settings of the search for the next target point."""

    curve_samples: int = 48
    """Number of samples of the curve per reach of the module."""

    most_curve_samples: int = 400
    """Largest number of samples of the curve ahead."""

    starts: int = 8
    """Number of start postures with up to two degrees of freedom."""

    starts_of_many: int = 16
    """Number of start postures with more degrees of freedom."""

    enough: int = 4
    """Number of postures on the curve at which the search stops, with more than two degrees of freedom."""

    start_distance: float = 0.3
    """Smallest difference between start postures, in units of the joints."""

    cost_of_distance: float = 25.0
    """Weight of the squared distance of a start from the curve, in reaches, against squared joint motion."""

    steps: int = 40
    """Largest number of steps to the curve, and again of those along it towards the preferred posture."""

    polishing_steps: int = 8
    """Largest number of steps back to the curve after those along it."""

    largest_step: float = 0.5
    """Largest step, in units of the joints, and in reaches along the curve."""

    cost_along: float = 0.01
    """Cost of one reach along the curve, relative to that of one unit of a joint."""

    still: float = 1e-7
    """Change of the unknowns below which the search along the curve ends."""

    on_target: float = 1e-11
    """Distance from the curve that counts as zero, relative to the reach."""

    ahead: float = 1e-6
    """Smallest distance of the point ahead, relative to the reach."""

    facing: float = 0.5 * np.pi
    """Motion of a hinge from its preferred position up to which a posture faces the curve [rad]."""


TARGET_POINT = TargetPointSettings()


@subkernel
def curve_point(
    spline: SplineArrays,
    length: LengthArrays,
    base: Array2,
    s: float,
    work: Array2,
    point: Array1,
    tangent: Array1,
) -> None:
    """Fill in the point of a curve at arc length s and its unit tangent, in the base frame (3, 4)."""
    u = parameter_at(length, s)
    span = span_at(spline, u)
    x, y, z = value(spline, 0, span, u, work)
    x = x - base[0, 3]
    y = y - base[1, 3]
    z = z - base[2, 3]
    for i in range(3):
        point[i] = base[0, i] * x + base[1, i] * y + base[2, i] * z
    x, y, z = value(spline, 1, span, u, work)
    size = max(np.sqrt(x * x + y * y + z * z), 1e-300)
    for i in range(3):
        tangent[i] = (base[0, i] * x + base[1, i] * y + base[2, i] * z) / size


@subkernel
def least_solution(
    rows: Array2, wanted: Array1, costs: Array1, share: float, held: Flags1, matrix: Array2, x: Array1
) -> None:
    """Find the x (k + 1,) of least cost with rows (3, k + 1) x = wanted (3,); held entries stay fixed.

    `share` is the regularisation relative to the trace; matrix (3, 3) is scratch.
    """
    trace = 0.0
    right = wanted.copy()
    for i in range(3):
        for j in range(len(x)):
            if held[j]:
                right[i] -= rows[i, j] * x[j]
        for k in range(i + 1):
            inner = 0.0
            for j in range(len(x)):
                if not held[j]:
                    inner += rows[i, j] * rows[k, j] / costs[j]
            matrix[i, k] = inner
        trace += matrix[i, i]
    for i in range(3):
        matrix[i, i] += max(share, 1e-14) * trace + 1e-300
    solve_cholesky(matrix, right)
    for j in range(len(x)):
        if not held[j]:
            x[j] = (rows[0, j] * right[0] + rows[1, j] * right[1] + rows[2, j] * right[2]) / costs[j]


@subkernel
def nearest_starts(
    candidates: Array2, ends: Array2, points: Array2, count: int, reach: float, starts: Ints1, at: Ints1
) -> int:
    """Choose postures with ends near a curve and little joint motion, the best first.

    Args:
        candidates: postures in units of the joints, relative to the preferred one, (s, k).
        ends: their end positions, (s, 3).
        points: samples of the curve, of which the first `count` are used.
        count: number of samples.
        reach: reach of the module.
        starts: filled with the indices of the chosen postures.
        at: filled with the sample nearest to each.

    Returns:
        Number of chosen postures.
    """
    n = len(candidates)
    nearest = np.empty(len(candidates), np.int64)
    scores = np.empty(len(candidates))
    for i in range(n):
        least = np.inf
        best = 0
        for j in range(count):
            x = ends[i, 0] - points[j, 0]
            y = ends[i, 1] - points[j, 1]
            z = ends[i, 2] - points[j, 2]
            away = x * x + y * y + z * z
            if away < least:
                least = away
                best = j
        motion = 0.0
        for j in range(candidates.shape[1]):
            motion += candidates[i, j] ** 2
        nearest[i] = best
        scores[i] = TARGET_POINT.cost_of_distance * least / (reach * reach) + motion
    found = 0
    while found < len(starts):
        best = int(np.argmin(scores))
        if not np.isfinite(scores[best]):
            break
        starts[found] = best
        at[found] = nearest[best]
        found += 1
        for i in range(n):
            apart = 0.0
            for j in range(candidates.shape[1]):
                apart = max(apart, abs(candidates[i, j] - candidates[best, j]))
            if apart < TARGET_POINT.start_distance:
                scores[i] = np.inf
    return found


@compiled
def next_target_point(
    module: CurveModule,
    spline: SplineArrays,
    length: LengthArrays,
    base: Array2,
    start: float,
    lower: Array1,
    upper: Array1,
    preferred: Array1,
    samples: Array2,
    ends: Array2,
    found: Array1,
) -> float:
    """Find the next point of a curve that the end of a module can reach within its limits.

    With up to two degrees of freedom it is the first one at which every hinge is within 90 degrees of its
    preferred position; if there is none, or with more degrees of freedom, the one with the least motion.

    Args:
        module: joints of the module.
        spline: the curve.
        length: its arc length.
        base: axes of the base frame as columns, and its origin, in the frame of the curve, (3, 4).
        start: arc length of the base on the curve.
        lower: smallest positions, (k,).
        upper: largest ones, (k,).
        preferred: positions to stay near, (k,).
        samples: start postures, (s, k).
        ends: the ends of the module at these, (s, 3).
        found: filled with the positions, (k,).

    Returns:
        The arc length of the point; NaN if there is none, or -1 if the curve also ends within reach.
    """
    k = len(preferred)
    n = len(module.chain.joints.kinds)
    reach = module.reach[0]
    total = length.lengths[-1]
    work = np.empty((6, 3))
    points = np.empty((TARGET_POINT.most_curve_samples, 3))
    point = np.empty(3)
    tangent = np.empty(3)
    axes = np.empty((n, 3))
    origins = np.empty((n, 3))
    moved = np.empty((1, 3))
    turned = np.empty((1, 3, 3))
    jacobian = np.empty((1, 3, k))
    rows = np.empty((3, k + 1))
    matrix = np.empty((3, 3))
    step = reach / TARGET_POINT.curve_samples
    count = 0
    beyond = False
    s = start
    while count < TARGET_POINT.most_curve_samples and s < total and not beyond:
        s = min(start + (count + 1) * step, total)
        curve_point(spline, length, base, s, work, points[count], tangent)
        p = points[count]
        beyond = np.sqrt(p[0] * p[0] + p[1] * p[1] + p[2] * p[2]) > reach * (1.0 + 1e-9)
        count += 1
    last = s
    if count == 0:
        return -1.0
    low = np.empty(k + 1)
    high = np.empty(k + 1)
    for j in range(k):
        low[j] = (lower[j] - preferred[j]) / module.units[j]
        high[j] = (upper[j] - preferred[j]) / module.units[j]
    low[k] = (start + TARGET_POINT.ahead * reach) / reach
    high[k] = last / reach
    tries = TARGET_POINT.starts if k <= 2 else TARGET_POINT.starts_of_many
    candidates = np.empty(samples.shape)
    begins = np.empty(tries, np.int64)
    at = np.empty(tries, np.int64)
    for i in range(len(samples)):
        for j in range(k):
            candidates[i, j] = (samples[i, j] - preferred[j]) / module.units[j]
    chosen = nearest_starts(candidates, ends, points, count, reach, begins, at)
    z = np.empty(k + 1)
    x = np.empty(k + 1)
    q = np.empty(k)
    offset = np.zeros(k + 1)
    costs = np.ones(k + 1)
    held = np.zeros(k + 1, np.bool_)
    gap = np.empty(3)
    wanted = np.empty(3)
    kept = np.empty(k + 1)
    costs[k] = TARGET_POINT.cost_along
    best_cost = np.inf
    best_s = np.nan
    best_facing = False
    arrivals = 0
    for each in range(chosen):
        if k > 2 and arrivals == TARGET_POINT.enough:
            break
        z[:k] = candidates[begins[each]]
        z[k] = max(min(start + (at[each] + 1) * step, last) / reach, low[k])
        # First straight to the curve; with redundant joints then along it towards the preferred positions,
        # and to the curve again, if that works.
        pulled = False
        left = TARGET_POINT.steps
        reached = False
        arrived = False
        while left > 0:
            left -= 1
            for j in range(k):
                q[j] = preferred[j] + z[j] * module.units[j]
            placements(module.chain, q, axes, origins, moved, turned)
            jacobian[:] = 0.0
            jacobians(module.chain.joints, module.chain.ends, axes, origins, moved, jacobian)
            curve_point(spline, length, base, z[k] * reach, work, point, tangent)
            distance = 0.0
            for i in range(3):
                gap[i] = point[i] - moved[0, i]
                distance += gap[i] ** 2
                for j in range(k):
                    rows[i, j] = jacobian[0, i, j] * module.units[j]
                rows[i, k] = -tangent[i] * reach
            reached = distance <= (TARGET_POINT.on_target * reach) ** 2
            if reached and not pulled:
                if arrived or k <= 2:
                    break
                arrived = True
                pulled = True
                left = TARGET_POINT.steps
                kept[:] = z
            # Unknowns x: joint motions, or joint positions when pulled; and the motion of s.
            for j in range(k):
                offset[j] = z[j] if pulled else 0.0
            for i in range(3):
                wanted[i] = gap[i]
                for j in range(k):
                    wanted[i] += rows[i, j] * offset[j]
            softened = 1e-3 * min(1.0, distance / (0.1 * reach) ** 2)
            held[:] = False
            for _ in range(k + 1):
                least_solution(rows, wanted, costs, softened, held, matrix, x)
                worst = 1e-12
                which = -1
                edge = 0.0
                for j in range(k + 1):
                    to = z[j] + x[j] - offset[j]
                    over = max(low[j] - to, to - high[j])
                    if not held[j] and over > worst:
                        worst = over
                        which = j
                        edge = low[j] if to < low[j] else high[j]
                if which < 0:
                    break
                held[which] = True  # it goes to its limit, and the others compensate
                x[which] = edge - z[which] + offset[which]
            largest = 0.0
            for j in range(k + 1):
                largest = max(largest, abs(x[j] - offset[j]))
            scale = min(1.0, TARGET_POINT.largest_step / max(largest, 1e-300))
            for j in range(k + 1):
                z[j] = min(max(z[j] + scale * (x[j] - offset[j]), low[j]), high[j])
            if pulled and (largest <= TARGET_POINT.still or left == 0):
                pulled = False
                left = TARGET_POINT.polishing_steps
        if arrived and not reached:
            z[:] = kept
            reached = True
        if not reached or z[k] <= low[k]:
            continue
        arrivals += 1
        cost = 0.0
        facing = k <= 2
        for j in range(k):
            cost += z[j] ** 2
            facing = facing and (not module.turning[j] or abs(z[j]) <= TARGET_POINT.facing)
        better = z[k] * reach < best_s if facing and best_facing else cost < best_cost
        if (facing and not best_facing) or (facing == best_facing and better):
            best_cost = cost
            best_s = z[k] * reach
            best_facing = facing
            for j in range(k):
                found[j] = min(max(preferred[j] + z[j] * module.units[j], lower[j]), upper[j])
    if np.isnan(best_s) and not beyond:
        return -1.0
    return best_s
