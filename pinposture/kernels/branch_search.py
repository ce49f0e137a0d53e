"""Searches for joint positions: module by module with backtracking, and by damped least squares."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from pinposture.kernels.arrays import (
    FULL_TURN,
    JOINT,
    Array1,
    Array2,
    Array3,
    Ints1,
    ModuleSearch,
    PointObjective,
    PostureProblem,
    SearchSettings,
)
from pinposture.kernels.chain_solver import (
    find_screws,
    measure_point_errors,
    minimise_in_box,
    solve_cholesky,
    stiffness,
)
from pinposture.kernels.compiled import compiled, subkernel
from pinposture.kernels.kinematics import (
    carried,
    find_sines,
    load_frame,
    place_chain,
    placements,
    point_velocity,
    store_frame,
)

# The base of a module is the frame that carries its first joint. In that frame, its joints solve the same
# problem as the whole chain, with only a few joints.
#
# The last two hinges of a module are solved in closed form. A hinge b moves the point c on a circle, and a
# hinge a before it preserves the height of a point along its axis and its distance from any point of the
# axis: both are linear in the cosine and the sine of b. Joints before those two are sampled, and each result
# is corrected by a few least-squares steps within the limits.


class BranchSearchSettings(NamedTuple):
    """Settings of the search module by module; `docs/design/branch_search.md` counts what it finds."""

    solutions: int = 24
    """Largest number of solutions that are kept of a module."""

    samples_of_three: int = 16
    """Largest number of samples of the first joint of a module of three joints."""

    least_difference: float = 1e-3
    """Smallest difference of two solutions [rad, or units of length]."""

    corrections: int = 15
    """Largest number of least-squares steps that correct a solution."""

    no_distance: float = 1e-12
    """Distance from the points at which a correction ends, relative to the arm length."""

    corrected: int = 3
    """Largest number of inexact solutions of a module that are corrected with the modules before it."""

    largest_window: int = 8
    """Largest number of modules that are corrected together."""


BRANCH_SEARCH = BranchSearchSettings()


Placed = tuple[Array3, Array2, Array2, Array2]
"""Orientations (m + 1, 3, 3) and origins (m + 1, 3) of the bases of all modules, and of the frame of the last
joint; axes (k, 3) and origins (k, 3) of the joints."""


@subkernel
def sort_indices(values: Array1, count: int, order: Ints1) -> None:
    """Fill `order` with the indices of the first `count` values, sorted by value."""
    for i in range(count):
        at = i
        while at > 0 and values[order[at - 1]] > values[i]:
            order[at] = order[at - 1]
            at -= 1
        order[at] = i


@subkernel
def wrap_into_limits(chain: ModuleSearch, u: int, q: float) -> float:
    """Return the position of a joint, modulo full turns, nearest to its preferred position.

    If none is within the limits, return the nearest limit.
    """
    low = chain.lower[u]
    high = chain.upper[u]
    if chain.sliding[u]:
        return min(max(q, low), high)
    q += FULL_TURN * np.round((chain.near[u] - q) / FULL_TURN)
    if q > high:
        q -= FULL_TURN * np.ceil((q - high) / FULL_TURN)
        if q < low:
            return low if low - q < q + FULL_TURN - high else high
    elif q < low:
        q += FULL_TURN * np.ceil((low - q) / FULL_TURN)
        if q > high:
            return high if q - high < low - q + FULL_TURN else low
    return q


@subkernel
def solve_last_joint(chain: ModuleSearch, u: int, x: Array1, goal: Array1) -> float:
    """Return the position of joint u that moves the point x nearest to a goal; both from its origin."""
    a = chain.joints.axes[u]
    x0 = x[0]
    x1 = x[1]
    x2 = x[2]
    g0 = goal[0]
    g1 = goal[1]
    g2 = goal[2]
    if chain.joints.kinds[u] == JOINT.prismatic:
        return a[0] * (g0 - x0) + a[1] * (g1 - x1) + a[2] * (g2 - x2)
    along = (a[0] * x0 + a[1] * x1 + a[2] * x2) * (a[0] * g0 + a[1] * g1 + a[2] * g2)
    sine = a[0] * (x1 * g2 - x2 * g1) + a[1] * (x2 * g0 - x0 * g2) + a[2] * (x0 * g1 - x1 * g0)
    return np.arctan2(sine, x0 * g0 + x1 * g1 + x2 * g2 - along)


@subkernel
def solve_last_two(
    chain: ModuleSearch, u: int, near: float, c: Array1, goal: Array1, alone: bool, out: Array2
) -> int:
    """Find candidate positions of hinges u and u + 1 that move the point c to a goal, into out (4, 2).

    The point is in the frame of the second, the goal in the frame that carries the first, from the origin of
    that joint. If `alone`, only the solution of both equations is returned if it is unique. The second hinge
    is set to `near` if it does not move the point. Returns the number of solutions.
    """
    a = chain.joints.axes[u]
    b = chain.joints.axes[u + 1]
    between = chain.joints.offsets[u + 1]
    along = b[0] * c[0] + b[1] * c[1] + b[2] * c[2]
    w0 = c[0] - along * b[0]
    w1 = c[1] - along * b[1]
    w2 = c[2] - along * b[2]
    s0 = b[1] * w2 - b[2] * w1
    s1 = b[2] * w0 - b[0] * w2
    s2 = b[0] * w1 - b[1] * w0
    g0 = between[0] + along * b[0]
    g1 = between[1] + along * b[1]
    g2 = between[2] + along * b[2]
    t0 = goal[0]
    t1 = goal[1]
    t2 = goal[2]
    radius = w0 * w0 + w1 * w1 + w2 * w2
    gg = g0 * g0 + g1 * g1 + g2 * g2
    # Cosine, sine, constant and scale: of the height along a, and of the squared distance from its origin.
    equations = (
        (
            a[0] * w0 + a[1] * w1 + a[2] * w2,
            a[0] * s0 + a[1] * s1 + a[2] * s2,
            a[0] * (t0 - g0) + a[1] * (t1 - g1) + a[2] * (t2 - g2),
            np.sqrt(radius),
        ),
        (
            2.0 * (g0 * w0 + g1 * w1 + g2 * w2),
            2.0 * (g0 * s0 + g1 * s1 + g2 * s2),
            t0 * t0 + t1 * t1 + t2 * t2 - gg - radius,
            np.sqrt(radius * (radius + gg)),
        ),
    )
    x = np.empty(3)
    count = 0
    (p0, p1, p2, p3), (r0, r1, r2, r3) = equations
    determinant = p0 * r1 - p1 * r0
    if alone and abs(determinant) > 1e-6 * p3 * r3:
        out[0, 1] = np.arctan2(
            np.copysign(1.0, determinant) * (p0 * r2 - r0 * p2),
            np.copysign(1.0, determinant) * (p2 * r1 - r2 * p1),
        )
        count = 1
    else:
        for cosine, sine, constant, scale in equations:
            size = np.hypot(cosine, sine)
            if size > 1e-9 * scale:
                middle = np.arctan2(sine, cosine)
                half = np.arccos(min(max(constant / size, -1.0), 1.0))
                out[count, 1] = middle - half
                out[count + 1, 1] = middle + half
                count += 2
        if count == 0:  # the last hinge does not move the point
            out[0, 1] = near
            count = 1
    for i in range(count):
        cosine = np.cos(out[i, 1])
        sine = np.sin(out[i, 1])
        x[0] = g0 + cosine * w0 + sine * s0
        x[1] = g1 + cosine * w1 + sine * s1
        x[2] = g2 + cosine * w2 + sine * s2
        out[i, 0] = solve_last_joint(chain, u, x, goal)
    return count


@subkernel
def measure_errors(
    chain: ModuleSearch, first: int, last: int, placed: Placed, points: Array2, q: Array1, e: Array2
) -> float:
    """Fill e (W, 3) with the errors of the ends of modules first to last at q; return their sum of squares.

    The bases of the modules after the first are filled in, and axes and origins of their joints.
    """
    turns, places, axes, origins = placed
    total = 0.0
    for k in range(first, last + 1):
        start = chain.starts[k]
        stop = chain.starts[k + 1]
        find_sines(chain.joints, start, stop, q, axes)
        frame = place_chain(chain.joints, start, stop, load_frame(turns[k], places[k]), axes, origins)
        store_frame(frame, turns[k + 1], places[k + 1])
        c = chain.levers[k]
        x, y, z = carried(frame, c[0], c[1], c[2])
        e[k - first, 0] = points[k, 0] - x
        e[k - first, 1] = points[k, 1] - y
        e[k - first, 2] = points[k, 2] - z
        for i in range(3):
            total += e[k - first, i] ** 2
    return total


@subkernel
def fill_jacobian(chain: ModuleSearch, first: int, last: int, placed: Placed, rows: Array2) -> None:
    """Fill rows (3 W, n) with the Jacobian of the ends of modules first to last by their joints.

    It is that at the positions for which `measure_errors` was last called.
    """
    turns, places, axes, origins = placed
    rows[:] = 0.0
    begin = chain.begins[first]
    for k in range(first, last + 1):
        c = chain.levers[k]
        x, y, z = carried(load_frame(turns[k + 1], places[k + 1]), c[0], c[1], c[2])
        row = 3 * (k - first)
        for u in range(chain.starts[first], chain.starts[k + 1]):
            vx, vy, vz = point_velocity(chain.joints, u, axes, origins, x, y, z)
            j = chain.joints.columns[u] - begin
            rows[row, j] += vx
            rows[row + 1, j] += vy
            rows[row + 2, j] += vz


@subkernel
def correct(
    chain: ModuleSearch, first: int, last: int, placed: Placed, points: Array2, size: float, q: Array1
) -> float:
    """Move the ends of modules first to last to their points, by Levenberg-Marquardt steps within limits.

    Changes q of these modules, fills in the bases after the first, and returns the largest distance left. The
    box solver along the chain finds as many solutions, but takes two to three times as long for the few
    joints of a window (`docs/design/branch_search.md`).
    """
    begin = chain.begins[first]
    r = 3 * (last - first + 1)
    n = chain.begins[last + 1] - begin
    e = np.empty((r // 3, 3))
    trial_e = np.empty((r // 3, 3))
    rows = np.empty((r, n))
    matrix = np.empty((r, r))
    x = np.empty(r)
    tried = q.copy()
    held = np.zeros(n, dtype=np.bool_)
    cost = measure_errors(chain, first, last, placed, points, q, e)
    damping = 1e-3
    for _ in range(BRANCH_SEARCH.corrections):
        if cost <= (BRANCH_SEARCH.no_distance * size) ** 2 or n == 0:
            break
        fill_jacobian(chain, first, last, placed, rows)
        trace = 0.0
        for j in range(n):
            u = begin + j
            slope = 0.0
            for i in range(r):
                slope += rows[i, j] * e[i // 3, i % 3]
            held[j] = (slope > 0.0 and q[u] >= chain.upper[u]) or (slope < 0.0 and q[u] <= chain.lower[u])
            for i in range(r):
                if held[j]:
                    rows[i, j] = 0.0
                trace += rows[i, j] ** 2
        if trace <= 0.0:
            break
        better = False
        found = cost
        for _ in range(6):
            least = max(damping * trace / r * min(1.0, cost / (0.01 * size * size)), 1e-14 * trace)
            for i in range(r):
                x[i] = e[i // 3, i % 3]
                for k in range(i + 1):
                    inner = least if i == k else 0.0
                    for j in range(n):
                        inner += rows[i, j] * rows[k, j]
                    matrix[i, k] = inner
            solve_cholesky(matrix, x)
            for j in range(n):
                u = begin + j
                step = 0.0
                for i in range(r):
                    step += rows[i, j] * x[i]
                if not chain.sliding[u]:
                    step = min(max(step, -0.5), 0.5)
                tried[u] = min(max(q[u] + step, chain.lower[u]), chain.upper[u])
            found = measure_errors(chain, first, last, placed, points, tried, trial_e)
            better = found < cost
            if better:
                damping = max(damping * 0.1, 1e-6)
                break
            damping = min(max(damping, 1e-3) * 10.0, 1e6)
        if not better:
            break
        for i in range(r // 3):
            e[i, 0] = trial_e[i, 0]
            e[i, 1] = trial_e[i, 1]
            e[i, 2] = trial_e[i, 2]
        for u in range(begin, begin + n):
            q[u] = tried[u]
        fallen = cost - found
        cost = found
        if fallen <= 1e-3 * cost and cost > (1e-6 * size) ** 2:  # converged to a nonzero distance
            break
    measure_errors(chain, first, last, placed, points, q, e)
    worst = 0.0
    for i in range(r // 3):
        worst = max(worst, e[i, 0] ** 2 + e[i, 1] ** 2 + e[i, 2] ** 2)
    return float(np.sqrt(worst))


@subkernel
def keep_solution(
    residual: float, q: Array1, first: int, stop: int, residuals: Array1, found: Array2, count: int
) -> int:
    """Keep a solution unless it is known, or worse than all if the list is full; return their number."""
    at = count
    for i in range(count):
        apart = 0.0
        for j in range(stop - first):
            apart = max(apart, abs(found[i, j] - q[first + j]))
        if apart <= BRANCH_SEARCH.least_difference:
            if residual >= residuals[i]:
                return count
            at = i
            break
    if at == len(residuals):
        at = 0
        for i in range(1, count):
            at = i if residuals[i] > residuals[at] else at
        if residual >= residuals[at]:
            return count
    residuals[at] = residual
    for j in range(stop - first):
        found[at, j] = q[first + j]
    return max(count, at + 1)


@subkernel
def solve_module(
    chain: ModuleSearch,
    k: int,
    placed: Placed,
    points: Array2,
    size: float,
    accepted: float,
    samples: Array2,
    q: Array1,
    residuals: Array1,
    found: Array2,
) -> int:
    """Find joint positions of module k that move its end to its point, or as near as possible.

    Fills `residuals` (c,) and `found` (c, n) with distances and c solutions at most; uses q of this module as
    scratch. Returns the number of solutions. Other arguments are as in `search_branches`.
    """
    first = chain.begins[k]
    stop = chain.begins[k + 1]
    joint = chain.starts[k]
    end = chain.starts[k + 1]
    n = stop - first
    c = chain.levers[k]
    goal = np.empty(3)
    pair = np.empty((4, 2))
    closed = 0  # number of joints solved in closed form, which coupled joints do not have
    if n > 0 and end - joint == n:
        kinds = chain.joints.kinds
        hinges = n > 1 and kinds[end - 2] != JOINT.prismatic and kinds[end - 1] != JOINT.prismatic
        closed = 2 if hinges else 1
    start = np.empty(n)
    e = np.empty((1, 3))
    turns, places, axes, origins = placed
    count = 0
    if n > closed:  # solution nearest to the preferred positions
        for u in range(first, stop):
            q[u] = chain.near[u]
        residual = correct(chain, k, k, placed, points, size, q)
        count = keep_solution(residual, q, first, stop, residuals, found, count)
    for number in range(
        1 if n <= closed else min(len(samples), BRANCH_SEARCH.samples_of_three) if n == 3 else len(samples)
    ):
        for u in range(first, stop - closed):
            start[u - first] = chain.near[u]
            if number:
                half = size if chain.sliding[u] else np.pi
                low = max(chain.lower[u], chain.near[u] - half)
                high = min(chain.upper[u], chain.near[u] + half)
                start[u - first] = low + samples[number, u] * (high - low)
            q[u] = start[u - first]
        if closed:  # the goal in the frame that carries the joints solved in closed form, from the first
            at = end - closed
            o = chain.joints.offsets[at]
            find_sines(chain.joints, joint, at, q, axes)
            frame = place_chain(chain.joints, joint, at, load_frame(turns[k], places[k]), axes, origins)
            x, y, z = carried(frame, o[0], o[1], o[2])
            x = points[k, 0] - x
            y = points[k, 1] - y
            z = points[k, 2] - z
            goal[0] = frame[0] * x + frame[3] * y + frame[6] * z
            goal[1] = frame[1] * x + frame[4] * y + frame[7] * z
            goal[2] = frame[2] * x + frame[5] * y + frame[8] * z
        pairs = 1
        if closed == 1:
            pair[0, 1] = solve_last_joint(chain, end - 1, c, goal)
        for attempt in range(2 if n <= closed else 0):  # the closed form has all exact solutions
            if closed == 2:
                pairs = solve_last_two(chain, end - 2, chain.near[stop - 1], c, goal, attempt == 0, pair)
            for i in range(pairs):
                for u in range(first, stop):
                    q[u] = wrap_into_limits(chain, u, pair[i, 2 - stop + u])
                residual = np.sqrt(measure_errors(chain, k, k, placed, points, q, e))
                if residual <= accepted:
                    count = keep_solution(residual, q, first, stop, residuals, found, count)
            if count:
                return count
        if closed == 2 and n > closed:
            pairs = solve_last_two(chain, end - 2, chain.near[stop - 1], c, goal, False, pair)
        for i in range(pairs):
            for u in range(first, stop - closed):
                q[u] = start[u - first]
            for u in range(stop - closed, stop):
                q[u] = wrap_into_limits(chain, u, pair[i, 2 - stop + u])
            residual = correct(chain, k, k, placed, points, size, q)
            if residual <= accepted:
                for u in range(first, stop):
                    q[u] = wrap_into_limits(chain, u, q[u])
            count = keep_solution(residual, q, first, stop, residuals, found, count)
    return count


@subkernel
def first_corrected(chain: ModuleSearch, k: int, window: int) -> int:
    """Return the first of the modules that are corrected together with module k.

    The window is extended if its modules then have as many joints as their points have coordinates.
    """
    low = max(k - window + 1, 0)
    for first in range(low, max(k - BRANCH_SEARCH.largest_window, -1), -1):
        if chain.begins[k + 1] - chain.begins[first] >= 3 * (k - first + 1):
            return first
    return low


@compiled
def search_branches(
    chain: ModuleSearch,
    points: Array2,
    size: float,
    accepted: float,
    window: int,
    visits: int,
    samples: Array2,
    q: Array1,
) -> int:
    """Find joint positions that put the end of every module at its point.

    Depth-first search: the solutions of a module nearest to `chain.near` are tried first. If none reaches its
    point, the best are corrected together with the previous modules, which have freedom left if they have
    more than three joints or their points are on a joint axis.

    Args:
        chain: the chain.
        points: goals of the ends of the modules, (m, 3).
        size: length of the arm.
        accepted: distance at which a point counts as reached.
        window: number of modules corrected together; with 1, q is valid only if all points are reached.
        visits: number of module visits at which the search gives up.
        samples: fractions of the range of each joint to try, (S, n); the first is replaced by `near`.
        q: filled with the positions of the joints of the chain; if not all points were reached, with those
            that reached most, and the nearest for the other modules.

    Returns:
        Number of points that were reached, from the base on.
    """
    m = len(points)
    widest = 0
    for k in range(m):
        widest = max(widest, chain.begins[k + 1] - chain.begins[first_corrected(chain, k, window)])
    axes = np.empty((len(chain.joints.kinds), 3))
    origins = np.empty((len(chain.joints.kinds), 3))
    placed = np.zeros((m + 1, 3, 3)), np.zeros((m + 1, 3)), axes, origins
    placed[0][0] = np.eye(3)
    most = BRANCH_SEARCH.solutions
    choices = np.empty((m, most, widest))
    order = np.zeros((m, most), np.int64)
    number = np.zeros(m, np.int64)
    next_choice = np.zeros(m, np.int64)
    base = np.zeros(m, np.int64)
    residuals = np.empty(most)
    found = np.empty((most, widest))
    ranked = np.zeros(most, np.int64)
    scores = np.empty(most)
    e = np.empty((m, 3))
    before = q.copy()
    deepest = -1
    best = q.copy()
    # a literal 0 would be compiled as another type
    k = base[0]
    descending = True
    while True:
        if descending:
            visits -= 1
            first = chain.begins[k]
            stop = chain.begins[k + 1]
            ends = solve_module(chain, k, placed, points, size, accepted, samples, q, residuals, found)
            sort_indices(residuals, ends, ranked)
            if k > deepest:
                deepest = k
                for u in range(stop):
                    best[u] = q[u] if u < first else found[ranked[0], u - first]
            count = 0
            base[k] = k
            for i in range(ends):
                if residuals[ranked[i]] <= accepted:
                    for u in range(first, stop):
                        choices[k, count, u - first] = found[ranked[i], u - first]
                    count += 1
            if count == 0 and window > 1 and k > 0:
                base[k] = first_corrected(chain, k, window)
                low = chain.begins[base[k]]
                for u in range(low, first):
                    before[u] = q[u]
                for i in range(min(BRANCH_SEARCH.corrected, ends)):
                    for u in range(low, stop):
                        q[u] = before[u] if u < first else found[ranked[i], u - first]
                    if correct(chain, base[k], k, placed, points, size, q) <= accepted:
                        for u in range(low, stop):
                            choices[k, count, u - low] = q[u]
                        count += 1
                for u in range(low, first):
                    q[u] = before[u]
                measure_errors(chain, base[k], k, placed, points, q, e)
            low = chain.begins[base[k]]
            for i in range(count):
                scores[i] = 0.0
                for u in range(low, stop):
                    scores[i] += (choices[k, i, u - low] - chain.near[u]) ** 2
            sort_indices(scores, count, order[k])
            number[k] = count
            next_choice[k] = 0
            if visits <= 0:
                break
        if next_choice[k] == number[k]:  # no solution left: backtrack to the previous module
            if k == 0:
                break
            k -= 1
            descending = False
            for i in range(k):  # undo the correction together with this module
                low = chain.begins[base[i]]
                for u in range(low, chain.begins[i + 1]):
                    q[u] = choices[i, order[i, next_choice[i] - 1], u - low]
            if k:
                measure_errors(chain, 0, k - 1, placed, points, q, e)
            continue
        low = chain.begins[base[k]]
        stop = chain.begins[k + 1]
        for u in range(low, stop):
            q[u] = choices[k, order[k, next_choice[k]], u - low]
        next_choice[k] += 1
        measure_errors(chain, base[k], k, placed, points, q, e)
        if k == m - 1:
            return m
        k += 1
        descending = True
    if window == 1:
        return deepest
    # The deepest result, then the nearest solution of each later module.
    for u in range(len(q)):
        q[u] = best[u]
    for i in range(m):
        if i > deepest:
            first = chain.begins[i]
            ends = solve_module(chain, i, placed, points, size, accepted, samples, q, residuals, found)
            sort_indices(residuals, ends, ranked)
            for u in range(first, chain.begins[i + 1]):
                q[u] = found[ranked[0], u - first]
        measure_errors(chain, i, i, placed, points, q, e)
    return deepest


@compiled
def minimise_posture_errors(
    problem: PostureProblem, settings: SearchSettings, positions: Array1
) -> tuple[float, float]:
    """Minimise the squared errors of points and chords by damped least squares.

    This is the loop of `descent.descend` for points alone, where a step in Python would take longer than its
    solution.

    Args:
        problem: the problem.
        settings: settings of the search.
        positions: initial joint positions, (nv,); filled with the final ones.

    Returns:
        The sum of squares and the mean error at the end.
    """
    chain, joints, units, position_limits, indices, ends, targets, weights, chords, normal = problem
    n = len(joints)
    p = len(indices)
    m = len(chain.ends)
    columns = chain.inputs
    axes = np.empty((len(chain.joints.kinds), 3))
    origins = np.empty((len(chain.joints.kinds), 3))
    every = np.empty((m, 3))
    rotations = np.empty((m, 3, 3))
    points = np.empty((p, 3))
    errors = np.empty((p, 3))
    screws = np.empty((n, 6))
    tried = positions.copy()
    x = np.empty(n)
    centre = np.zeros(n)
    damping = np.empty(n)
    lower = np.empty(n)
    upper = np.empty(n)
    at_bound = np.zeros(n, dtype=np.int8)
    factor = 1.0
    idle = 0
    squares = np.inf
    mean = np.inf
    for step in range(settings.steps + 1):
        placements(chain, tried, axes, origins, every, rotations)
        for k in range(p):
            points[k] = every[indices[k]]
        tried_squares = measure_point_errors(points, targets, weights, chords, normal, errors)
        if tried_squares < squares:
            idle = idle + 1 if tried_squares > (1.0 - settings.converged) * squares else 0
            factor = max(factor * settings.decrease, settings.least_factor) if step else factor
            squares = tried_squares
            mean = 0.0
            positions[:] = tried
            for k in range(p):
                mean += np.sqrt(errors[k, 0] ** 2 + errors[k, 1] ** 2 + errors[k, 2] ** 2) / p
            if mean <= settings.good:
                break
            find_screws(chain, joints, units, axes, origins, ends, points, screws)
            objective = PointObjective(screws, ends, points.copy(), weights, chords)
            left = errors.copy()
            stiff = max(stiffness(objective), settings.least_stiffness)
            for u in range(n):
                here = positions[columns[joints[u]]]
                lower[u] = min(max((position_limits[0, u] - here) / units[u], -settings.largest_step), 0.0)
                upper[u] = max(min((position_limits[1, u] - here) / units[u], settings.largest_step), 0.0)
        else:
            factor *= settings.increase
            idle += factor > settings.most_factor
        if idle >= settings.idle or step == settings.steps:
            break
        damping[:] = factor * settings.damping_share * squares + settings.least_damping * stiff
        at_bound[:] = 0
        minimise_in_box(objective, left, damping, centre, lower, upper, at_bound, x)
        for u in range(n):
            j = columns[joints[u]]
            tried[j] = positions[j] + x[u] * units[u]
    return squares, mean
