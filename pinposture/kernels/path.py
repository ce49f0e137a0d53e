"""Paths through joint space: relaxation to the shortest motion of the control points, and following them."""

from __future__ import annotations

import numpy as np

from pinposture.kernels.arrays import Array1, Array2, Array3, ChainArrays, Flags1, Ints1, PointObjective
from pinposture.kernels.chain_solver import find_screws, minimise_in_box
from pinposture.kernels.compiled import compiled, subkernel
from pinposture.kernels.kinematics import placements
from pinposture.kernels.time_parameterization import step_box

STEP_ROUNDING = 1e-12  # rounding error of a step, in units of each joint
MAX_RELAXATION = 1.85  # largest over-relaxation of a waypoint; 1 moves it to its own minimum

WAYPOINT_DAMPING_DOWN, WAYPOINT_DAMPING_UP = 0.1, 30.0
"""Factors of a waypoint's damping after a move that lowered the energy, and after one that did not."""

MIN_WAYPOINT_DAMPING = 3e-6
"""Smallest damping, relative to the mean squared distance of the control points from the base."""

MAX_WAYPOINT_TRIALS = 6  # number of failed moves after which a waypoint waits for the next pass


@compiled
def joint_distance(one: Array1, other: Array1, endless: Flags1, columns: Ints1, units: Array1) -> float:
    """Return the largest difference of joint positions (nv,) in `columns`, in units of each (n,)."""
    largest = 0.0
    for i in range(len(columns)):
        u = columns[i]
        motion = abs(other[u] - one[u])
        if endless[u]:
            motion = abs(motion - 2.0 * np.pi * np.round(motion / (2.0 * np.pi)))
        largest = max(largest, motion / units[i])
    return largest


@compiled
def position_excess(positions: Array1, edges: Array2, columns: Ints1) -> float:
    """Return the largest excess of joints over their position limits, (2, nv); 0 if there is none."""
    largest = 0.0
    for i in range(len(columns)):
        u = columns[i]
        largest = max(largest, edges[0, u] - positions[u], positions[u] - edges[1, u])
    return largest


@compiled
def step_along(
    offsets: Array2,
    start: Array1,
    positions: Array1,
    endless: Flags1,
    columns: Ints1,
    units: Array1,
    place: float,
    limits: Array2,
    max_motion: float,
    dq: Array1,
) -> tuple[float, float, bool]:
    """Compute the step to the farthest place on a path that can be reached without leaving the path.

    Args:
        offsets: displacements of waypoints from the start, (N + 1, nv), joined by straight lines.
        start: joint positions at the start, (nv,).
        positions: current joint positions, (nv,).
        endless: which joints are periodic, (nv,).
        columns: the joints that move on the path, (n,).
        units: unit of motion of each of them, (n,).
        place: current or last place on the path, in waypoints.
        limits: smallest and largest step, (2, nv).
        max_motion: largest motion of a joint without limits, in units.
        dq: zeros, filled with the step, (nv,).

    Returns:
        The place that it leads to, which is the old one if the limits do not admit more; the largest joint
        motion left to the end of the path, in units; and whether the step is within the limits.
    """
    n, last = len(columns), len(offsets) - 1
    offset, begin = np.empty(n), np.empty(n)
    left = 0.0
    i = min(int(place), last - 1)
    share = place - i
    for k in range(n):
        u = columns[k]
        here = (1.0 - share) * offsets[i, u] + share * offsets[i + 1, u]
        gone = positions[u] - start[u]
        if endless[u]:
            gone += 2.0 * np.pi * np.round((here - gone) / (2.0 * np.pi))
        offset[k], begin[k] = gone, here - gone
        left = max(left, abs(offsets[last, u] - gone) / units[k])
    while place < last:
        i = min(int(place), last - 1)
        reach = 1.0
        for k in range(n):
            u = columns[k]
            bound = min(max(abs(limits[0, u]), abs(limits[1, u])), max_motion * units[k])
            motion = offsets[i + 1, u] - offset[k] - begin[k]
            if abs(begin[k]) > bound:
                reach = 0.0
            elif motion > 0.0:
                reach = min(reach, (bound - begin[k]) / motion)
            elif motion < 0.0:
                reach = min(reach, (bound + begin[k]) / -motion)
        place = i + 1.0 if reach >= 1.0 else place + reach * (i + 1.0 - place)
        for k in range(n):
            begin[k] += min(reach, 1.0) * (offsets[i + 1, columns[k]] - offset[k] - begin[k])
        if reach < 1.0:
            break
    inside = True
    for k in range(n):
        u, slack = columns[k], STEP_ROUNDING * units[k]
        dq[u] = begin[k]
        fits = limits[0, u] - slack <= begin[k] <= limits[1, u] + slack
        inside = inside and fits and abs(begin[k]) <= max_motion * units[k]
    return place, left, inside


@compiled
def look_ahead(
    chain: ChainArrays,
    positions: Array1,
    units: Array1,
    limits: Array2,
    edges: Array2,
    points: Array2,
    targets: Array2,
    has_target: Flags1,
    dq: Array1,
    reached: Array1,
    at_limit: Flags1,
) -> tuple[float, float]:
    """Clip a step to its limits, and compute the errors of the control points after it.

    Args:
        chain: the chain.
        positions: current joint positions, (nv,).
        units: unit of motion of each joint of the chain, (n,).
        limits: smallest and largest step, (2, nv).
        edges: position limits, (2, nv).
        points: current control points, (m, 3).
        targets: their targets, (m, 3).
        has_target: which of them have a target, (m,).
        dq: the step, (nv,); clipped.
        reached: filled with the joint positions after it, (nv,).
        at_limit: filled with which joints of the chain are at a position limit then, (nv,).

    Returns:
        Sum of the distances of the control points from their targets before the step and after it.
    """
    columns, n, m = chain.columns, len(chain.columns), len(chain.ends)
    for u in range(len(dq)):
        reached[u] = positions[u] + dq[u]
        at_limit[u] = False
    for k in range(len(columns)):
        u = columns[k]
        dq[u] = min(max(dq[u], limits[0, u]), limits[1, u])
        reached[u] = positions[u] + dq[u]
        slack = STEP_ROUNDING * units[k]
        at_limit[u] = min(abs(edges[0, u] - reached[u]), abs(edges[1, u] - reached[u])) <= slack
    joint_axes, joint_origins = np.empty((n, 3)), np.empty((n, 3))
    trial, rotations = np.empty((m, 3)), np.empty((m, 3, 3))
    placements(chain, reached, joint_axes, joint_origins, trial, rotations)
    return sum_point_errors(points, targets, has_target), sum_point_errors(trial, targets, has_target)


@compiled
def sum_point_errors(points: Array2, targets: Array2, has_target: Flags1) -> float:
    """Return the sum of the distances of points (m, 3) from their targets (m, 3), of those that have one."""
    total = 0.0
    for k in range(len(points)):
        if has_target[k]:
            x, y, z = points[k, 0] - targets[k, 0], points[k, 1] - targets[k, 1], points[k, 2] - targets[k, 2]
            total += np.sqrt(x * x + y * y + z * z)
    return total


@compiled
def advance(
    chain: ChainArrays,
    endless: Flags1,
    units: Array1,
    leaning: Array1,
    edges: Array2,
    bound: Array1,
    positions: Array1,
    points: Array2,
    offsets: Array2,
    start: Array1,
    place: float,
    expected: Array1,
    disturbed: float,
    arrived: float,
    rounding: float,
    max_motion: float,
    targets: Array2,
    has_target: Flags1,
    dq: Array1,
    reached: Array1,
    at_limit: Flags1,
) -> tuple[bool, float, float, float]:
    """Run `step_box`, `joint_distance`, `step_along` and `look_ahead` in one call, for the usual step.

    Arguments are those of these kernels. All joints of the chain move on the path. `disturbed` is the largest
    difference from the `expected` joint positions, (nv,), and `arrived` the joint motion left at which the
    path is complete, both in units.

    Returns:
        Whether this is the usual step; if so, the place that it leads to, and the sums of distances before
        and after it.
    """
    none, limits = np.empty(0), np.empty((2, len(positions)))
    if step_box(positions, edges, bound, none, none, rounding, chain.columns, leaning, limits) != 0:
        return False, place, 0.0, 0.0
    if joint_distance(expected, positions, endless, chain.columns, units) > disturbed:
        return False, place, 0.0, 0.0
    next_place, left, inside = step_along(
        offsets, start, positions, endless, chain.columns, units, place, limits, max_motion, dq
    )
    if not inside or (next_place >= len(offsets) - 1 and left <= arrived):
        return False, place, 0.0, 0.0
    before, after = look_ahead(
        chain, positions, units, limits, edges, points, targets, has_target, dq, reached, at_limit
    )
    return True, next_place, before, after


# The energy of a path (see `trajectory_optimization`) couples each waypoint with its two neighbours only.
# With those fixed, it is smallest where the control points come nearest to the middle between the
# neighbours', and the joints to the middle of theirs, by weight: least squares along the chain. Solving this
# for one waypoint after the other, each time going somewhat beyond (successive over-relaxation), the energy
# never rises, and one pass over all waypoints costs one pass along the arm for each.


@compiled
def relax_waypoints(
    chain: ChainArrays,
    which: Ints1,
    own_ends: Ints1,
    units: Array1,
    start: Array1,
    lower: Array1,
    upper: Array1,
    weight: float,
    rounds: int,
    min_decrease: float,
    x: Array2,
) -> float:
    """Relax the waypoints between two ends.

    Args:
        chain: the chain.
        which: joints that may move, by their index along the chain, (n,).
        own_ends: number of those that carry each control point, (m,).
        units: unit of motion of each of them, (n,).
        start: joint positions at the start, (nv,).
        lower: smallest displacement from it, in units, (n,).
        upper: largest displacement from it, (n,).
        weight: mu^2, of the motion of joints against that of control points [m^2].
        rounds: largest number of passes over all waypoints.
        min_decrease: relative decrease of the energy in one pass at which to end.
        x: displacements of waypoints from the start, (N + 1, n); all but the ends are moved.

    Returns:
        The energy [m^2].
    """
    n, m, last = len(which), len(chain.ends), len(x) - 1
    # Joint axes and origins of all waypoints, and of the trial waypoint, which is the last.
    lines = (np.empty((last + 2, len(chain.slides), 3)), np.empty((last + 2, len(chain.slides), 3)))
    points, errors, rotations = np.empty((last + 2, m, 3)), np.empty((m, 3)), np.empty((m, 3, 3))
    trial = points[last + 1]
    positions, b, dx = start.copy(), np.empty((n, 6)), np.empty(n)
    moved, centre, low, high = np.empty(n), np.empty(n), np.empty(n), np.empty(n)
    weights, chords, damping = np.ones(m), np.zeros(m), np.empty(n)
    sides = np.zeros(n, dtype=np.int8)
    for i in range(last + 1):
        _set_positions(start, chain.columns, which, units, x[i], positions)
        placements(chain, positions, lines[0][i], lines[1][i], points[i], rotations)
    size = weight
    for k in range(m):
        for j in range(3):
            size += (points[0, k, j] - lines[1][0, 0, j]) ** 2 / m
    least = MIN_WAYPOINT_DAMPING * size
    extra, energy = np.full(last + 1, least), 0.0
    for i in range(last):
        energy += _segment_energy(points[i], points[i + 1], x[i], x[i + 1], weight)
    relaxation = min(2.0 / (1.0 + np.sin(np.pi / last)), MAX_RELAXATION)  # optimal for a row of equal springs
    for number in range(rounds):
        fall = 0.0
        for place in range(1, last):
            i = last - place if number % 2 else place
            find_screws(which, chain.slides, units, lines[0][i], lines[1][i], own_ends, points[i], b)
            objective = PointObjective(b, own_ends, points[i], weights, chords)
            before = _segment_energy(points[i - 1], points[i], x[i - 1], x[i], weight)
            before += _segment_energy(points[i], points[i + 1], x[i], x[i + 1], weight)
            for k in range(m):
                for j in range(3):
                    errors[k, j] = 0.5 * (points[i - 1, k, j] + points[i + 1, k, j]) - points[i, k, j]
            for _ in range(MAX_WAYPOINT_TRIALS):
                for u in range(n):
                    damping[u] = weight + extra[i]
                    aside = 0.5 * (x[i - 1, u] + x[i + 1, u]) - x[i, u]
                    centre[u] = weight * aside / damping[u]
                    low[u], high[u] = lower[u] - x[i, u], upper[u] - x[i, u]
                    sides[u] = 0
                minimise_in_box(objective, errors, damping, centre, low, high, sides, dx)
                gain = 0.0
                for share in (relaxation, 1.0):
                    for u in range(n):
                        moved[u] = min(max(x[i, u] + share * dx[u], lower[u]), upper[u])
                    _set_positions(start, chain.columns, which, units, moved, positions)
                    placements(chain, positions, lines[0][last + 1], lines[1][last + 1], trial, rotations)
                    after = _segment_energy(points[i - 1], trial, x[i - 1], moved, weight)
                    after += _segment_energy(trial, points[i + 1], moved, x[i + 1], weight)
                    gain = before - after
                    if gain > 0.0:
                        break
                if gain > 0.0:
                    x[i], points[i] = moved, trial
                    lines[0][i], lines[1][i] = lines[0][last + 1], lines[1][last + 1]
                    fall += gain
                    extra[i] = max(extra[i] * WAYPOINT_DAMPING_DOWN, least)
                    break
                extra[i] *= WAYPOINT_DAMPING_UP
        energy -= fall
        if fall <= min_decrease * energy:
            break
    return energy


@compiled
def measure_path_lengths(
    chain: ChainArrays, which: Ints1, units: Array1, start: Array1, x: Array2, samples: int
) -> tuple[float, float]:
    """Return the length of the paths of all control points, and the distance between their ends.

    The path is sampled at equal distances between the waypoints `x` (N + 1, n), which are joined by straight
    lines. Other arguments are as for `relax_waypoints`.
    """
    n, m, last = len(which), len(chain.ends), len(x) - 1
    frames = (np.empty((len(chain.slides), 3)), np.empty((len(chain.slides), 3)), np.empty((m, 3, 3)))
    points, positions, here = np.empty((3, m, 3)), start.copy(), np.empty(n)
    path, direct = 0.0, 0.0
    for sample in range(samples + 1):
        place = last * sample / samples
        i = min(int(place), last - 1)
        share = place - i
        for u in range(n):
            here[u] = (1.0 - share) * x[i, u] + share * x[i + 1, u]
        _set_positions(start, chain.columns, which, units, here, positions)
        at = 1 + sample % 2 if sample else 0
        placements(chain, positions, frames[0], frames[1], points[at], frames[2])
        if sample:
            path += _sum_distances(points[at], points[3 - at if sample > 1 else 0])
        if sample == samples:
            direct = _sum_distances(points[at], points[0])
    return path, direct


@subkernel
def _set_positions(
    start: Array1, columns: Ints1, which: Ints1, units: Array1, x: Array1, positions: Array1
) -> None:
    """Write the joint positions after a displacement."""
    for u in range(len(which)):
        j = columns[which[u]]
        positions[j] = start[j] + x[u] * units[u]


@subkernel
def _segment_energy(one: Array2, other: Array2, x: Array1, y: Array1, weight: float) -> float:
    """Return the energy of the motion between two neighbours."""
    points, joints = 0.0, 0.0
    for k in range(len(one)):
        for j in range(3):
            points += (other[k, j] - one[k, j]) ** 2
    for u in range(len(x)):
        joints += (y[u] - x[u]) ** 2
    return points + weight * joints


@subkernel
def _sum_distances(one: Array2, other: Array2) -> float:
    """Return the sum of the distances between points."""
    total = 0.0
    for k in range(len(one)):
        x, y, z = one[k, 0] - other[k, 0], one[k, 1] - other[k, 1], one[k, 2] - other[k, 2]
        total += np.sqrt(x * x + y * y + z * z)
    return total


@compiled
def add_path_rows(
    rows: Array2,
    errors: Array1,
    pieces: Ints1,
    shares: Array1,
    active: Flags1,
    diagonal: Array3,
    above: Array3,
    gradient: Array2,
) -> None:
    """Add squares of rows to the normal equations of a path: |row (1 - s) x_i + row s x_{i+1} - error|^2.

    Args:
        rows: the rows, (k, n).
        errors: their errors, (k,).
        pieces: the piece i of the path that each belongs to, from 0, (k,).
        shares: its place s on the piece, in [0, 1), (k,).
        active: which rows count, (k,).
        diagonal: blocks of the N - 1 waypoints between the ends, (N - 1, n, n); added to.
        above: blocks that couple each with the next, (N - 2, n, n); added to.
        gradient: of half the sum of squares, (N - 1, n); added to.
    """
    count, n = len(diagonal), rows.shape[1]
    for k in range(len(rows)):
        if not active[k]:
            continue
        i, s = pieces[k], shares[k]
        for side in range(2):
            waypoint, share = (i - 1, 1.0 - s) if side == 0 else (i, s)
            if share == 0.0 or waypoint < 0 or waypoint >= count:
                continue
            block = diagonal[waypoint]
            for u in range(n):
                gradient[waypoint, u] -= share * errors[k] * rows[k, u]
                scaled = share * share * rows[k, u]
                if scaled != 0.0:
                    for v in range(n):
                        block[u, v] += scaled * rows[k, v]
        if s > 0.0 and i > 0 and i < count:
            for u in range(n):
                scaled = s * (1.0 - s) * rows[k, u]
                if scaled != 0.0:
                    for v in range(n):
                        above[i - 1, u, v] += scaled * rows[k, v]


@compiled
def solve_tridiagonal(diagonal: Array3, above: Array3, right: Array2, x: Array2) -> bool:
    """Solve a symmetric positive definite block tridiagonal system by block Cholesky, in O(N n^3).

    It uses no BLAS, whose threads wait for each other where other processes use the cores.

    Args:
        diagonal: diagonal blocks, (N, n, n); the lower triangles are overwritten.
        above: blocks right of the diagonal ones, (N - 1, n, n); overwritten.
        right: right-hand side, (N, n).
        x: filled with the solution, (N, n).

    Returns:
        False if the matrix is not positive definite.
    """
    count, n = right.shape
    for block in range(count):
        own, rest = diagonal[block], x[block]
        rest[:] = right[block]
        if block > 0:
            # With the factor L of the block before: W = L^-1 above, own -= W^T W, rest -= W^T y.
            factor, coupling = diagonal[block - 1], above[block - 1]
            for i in range(n):
                for k in range(i):
                    for j in range(n):
                        coupling[i, j] -= factor[i, k] * coupling[k, j]
                for j in range(n):
                    coupling[i, j] /= factor[i, i]
            for k in range(n):
                for i in range(n):
                    for j in range(i + 1):
                        own[i, j] -= coupling[k, i] * coupling[k, j]
                    rest[i] -= coupling[k, i] * x[block - 1, k]
        for j in range(n):
            if not own[j, j] > 0.0:
                return False
            own[j, j] = np.sqrt(own[j, j])
            for i in range(j + 1, n):
                own[i, j] /= own[j, j]
            for i in range(j + 1, n):
                for k in range(j + 1, i + 1):
                    own[i, k] -= own[i, j] * own[k, j]
        for i in range(n):
            for k in range(i):
                rest[i] -= own[i, k] * rest[k]
            rest[i] /= own[i, i]
    for block in range(count - 1, -1, -1):
        own, rest = diagonal[block], x[block]
        if block < count - 1:
            for i in range(n):
                for j in range(n):
                    rest[i] -= above[block, i, j] * x[block + 1, j]
        for i in range(n - 1, -1, -1):
            for k in range(i + 1, n):
                rest[i] -= own[k, i] * rest[k]
            rest[i] /= own[i, i]
    return True
