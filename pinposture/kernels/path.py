"""Paths through joint space: relaxed until the control points travel least, and followed step by step."""

from __future__ import annotations

import numpy as np

from pinposture.kernels.arrays import Array1, Array2, Array3, ChainArrays, Flags1, Ints1, PointObjective
from pinposture.kernels.chain_solver import find_screws, minimise_in_box
from pinposture.kernels.compiled import compiled, subkernel
from pinposture.kernels.kinematics import placements
from pinposture.kernels.time_parameterization import step_box

# A step along a way through joint space, and what comes of it.

ROUNDING = 1e-12
"""What is lost in the arithmetic of a step, in units of each joint."""


@compiled
def joint_distance(one: Array1, other: Array1, endless: Flags1, columns: Ints1, units: Array1) -> float:
    """The largest difference of joint positions (nv,), of those in `columns`, in units of each (n,)."""
    most = 0.0
    for i in range(len(columns)):
        u = columns[i]
        way = abs(other[u] - one[u])
        if endless[u]:
            way = abs(way - 2.0 * np.pi * np.round(way / (2.0 * np.pi)))
        most = max(most, way / units[i])
    return most


@compiled
def position_excess(positions: Array1, edges: Array2, columns: Ints1) -> float:
    """By how much joints are outside their position limits, (2, nv), at most; 0 if none is."""
    most = 0.0
    for i in range(len(columns)):
        u = columns[i]
        most = max(most, edges[0, u] - positions[u], positions[u] - edges[1, u])
    return most


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
    most: float,
    dq: Array1,
) -> tuple[float, float, bool]:
    """The step to the farthest place on a way that can be reached without leaving a gap.

    Args:
        offsets: displacements of waypoints from the start, (N + 1, nv), joined by straight lines.
        start: joint positions at the start, (nv,).
        positions: joint positions now, (nv,).
        endless: which joints come round to where they were, (nv,).
        columns: the joints that move on the way, (n,).
        units: the motion of each of them that counts as one, (n,).
        place: where the arm is on the way, or was last, as a number of waypoints.
        limits: smallest and largest step, (2, nv).
        most: the most that a joint may go where there is no limit, in units.
        dq: zeros, filled with the step, (nv,).

    Returns:
        The place that it leads to, which is the old one if the limits do not admit more; the largest joint
        motion left to the end of the way, in units; and whether the step is within the limits.
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
            bound = min(max(abs(limits[0, u]), abs(limits[1, u])), most * units[k])
            way = offsets[i + 1, u] - offset[k] - begin[k]
            if abs(begin[k]) > bound:
                reach = 0.0
            elif way > 0.0:
                reach = min(reach, (bound - begin[k]) / way)
            elif way < 0.0:
                reach = min(reach, (bound + begin[k]) / -way)
        place = i + 1.0 if reach >= 1.0 else place + reach * (i + 1.0 - place)
        for k in range(n):
            begin[k] += min(reach, 1.0) * (offsets[i + 1, columns[k]] - offset[k] - begin[k])
        if reach < 1.0:
            break
    inside = True
    for k in range(n):
        u, slack = columns[k], ROUNDING * units[k]
        dq[u] = begin[k]
        fits = limits[0, u] - slack <= begin[k] <= limits[1, u] + slack
        inside = inside and fits and abs(begin[k]) <= most * units[k]
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
    placed: Flags1,
    dq: Array1,
    reached: Array1,
    at_limit: Flags1,
) -> tuple[float, float]:
    """Cut a step at its limits, and look where it leads.

    Args:
        chain: the chain.
        positions: joint positions now, (nv,).
        units: the motion of each joint of the chain that counts as one, (n,).
        limits: smallest and largest step, (2, nv).
        edges: joint positions to stay between, (2, nv).
        points: control points now, (m, 3).
        targets: where they should be, (m, 3).
        placed: which of them have a target, (m,).
        dq: the step, (nv,); cut.
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
        slack = ROUNDING * units[k]
        at_limit[u] = min(abs(edges[0, u] - reached[u]), abs(edges[1, u] - reached[u])) <= slack
    joint_axes, joint_origins = np.empty((n, 3)), np.empty((n, 3))
    there, rotations = np.empty((m, 3)), np.empty((m, 3, 3))
    placements(chain, reached, joint_axes, joint_origins, there, rotations)
    return sum_point_errors(points, targets, placed), sum_point_errors(there, targets, placed)


@compiled
def sum_point_errors(points: Array2, targets: Array2, placed: Flags1) -> float:
    """Sum of the distances of points (m, 3) from their targets (m, 3), of those that have one (m,)."""
    total = 0.0
    for k in range(len(points)):
        if placed[k]:
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
    most: float,
    targets: Array2,
    placed: Flags1,
    dq: Array1,
    reached: Array1,
    at_limit: Flags1,
) -> tuple[bool, float, float, float]:
    """`step_box`, `joint_distance`, `step_along` and `look_ahead` in one call: the usual step.

    Args:
        chain: the chain; all of its joints move on the way.
        endless: as for `step_along`.
        units: the motion of each joint of the chain that counts as one, (n,).
        leaning: as for `step_box`.
        edges: see there.
        bound: see there.
        positions: joint positions now, (nv,).
        points: as for `look_ahead`.
        offsets: as for `step_along`.
        start: see there.
        place: see there.
        expected: joint positions that the arm should have, (nv,).
        disturbed: how far it may be from them, in units.
        arrived: joint motion left at which the way is behind the arm.
        rounding: as for `step_box`.
        most: as for `step_along`.
        targets: as for `look_ahead`.
        placed: see there.
        dq: zeros, filled with the step, (nv,).
        reached: as for `look_ahead`.
        at_limit: see there.

    Returns:
        Whether it is that simple; and if so, the place that the step leads to, and the sums of distances
        before and after it.
    """
    none, limits = np.empty(0), np.empty((2, len(positions)))
    if step_box(positions, edges, bound, none, none, rounding, chain.columns, leaning, limits) != 0:
        return False, place, 0.0, 0.0
    if joint_distance(expected, positions, endless, chain.columns, units) > disturbed:
        return False, place, 0.0, 0.0
    there, left, inside = step_along(
        offsets, start, positions, endless, chain.columns, units, place, limits, most, dq
    )
    if not inside or (there >= len(offsets) - 1 and left <= arrived):
        return False, place, 0.0, 0.0
    before, after = look_ahead(
        chain, positions, units, limits, edges, points, targets, placed, dq, reached, at_limit
    )
    return True, there, before, after


# The most direct way between two configurations, relaxed waypoint by waypoint.
#
# The energy that `trajectory_optimization` explains couples each waypoint with its two neighbours only.
# With those held, it is least where the control points come nearest to the middle between the neighbours',
# and the joints to the middle of theirs, by weight: least squares along the chain. Solving that for one
# waypoint after the other, each time going somewhat beyond (successive over-relaxation), the energy never
# rises, and one pass over all waypoints costs one sweep along the arm for each.

MOST_OVER = 1.85
"""How far a waypoint is moved at most, where its own minimum is at 1."""

EASIER, HARDER, LEAST, TRIES = 0.1, 30.0, 3e-6, 6
"""How the damping of a waypoint changes after a move that lowered the energy or failed to; the least,
relative to the mean squared distance of the control points from the base; and after how many failures it
waits for the next pass."""


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
    settled: float,
    x: Array2,
) -> float:
    """Relax the waypoints between two ends.

    Args:
        chain: the chain.
        which: joints that may move, by their numbers along the chain, (n,).
        own_ends: how many of those carry each control point, (m,).
        units: the motion of each of them that counts as one, (n,).
        start: joint positions at the start, (nv,).
        lower: smallest displacement from it, in units, (n,).
        upper: largest displacement from it, (n,).
        weight: mu^2, of the motion of joints against that of control points [m^2].
        rounds: the most passes over all waypoints.
        settled: relative fall of the energy in one pass at which to end.
        x: displacements of waypoints from the start, (N + 1, n); all but the ends are moved.

    Returns:
        The energy [m^2].
    """
    n, m, last = len(which), len(chain.ends), len(x) - 1
    # Joint axes and origins of all waypoints, and of the one that is tried, in the last place.
    lines = (np.empty((last + 2, len(chain.slides), 3)), np.empty((last + 2, len(chain.slides), 3)))
    points, errors, rotations = np.empty((last + 2, m, 3)), np.empty((m, 3)), np.empty((m, 3, 3))
    there = points[last + 1]
    positions, b, dx = start.copy(), np.empty((n, 6)), np.empty(n)
    moved, centre, low, high = np.empty(n), np.empty(n), np.empty(n), np.empty(n)
    weights, chords, damping = np.ones(m), np.zeros(m), np.empty(n)
    sides = np.zeros(n, dtype=np.int8)
    for i in range(last + 1):
        _displaced(start, chain.columns, which, units, x[i], positions)
        placements(chain, positions, lines[0][i], lines[1][i], points[i], rotations)
    size = weight
    for k in range(m):
        for j in range(3):
            size += (points[0, k, j] - lines[1][0, 0, j]) ** 2 / m
    least = LEAST * size
    extra, energy = np.full(last + 1, least), 0.0
    for i in range(last):
        energy += _motion(points[i], points[i + 1], x[i], x[i + 1], weight)
    over = min(2.0 / (1.0 + np.sin(np.pi / last)), MOST_OVER)  # the best for as many equal springs in a row
    for number in range(rounds):
        fall = 0.0
        for place in range(1, last):
            i = last - place if number % 2 else place
            find_screws(which, chain.slides, units, lines[0][i], lines[1][i], own_ends, points[i], b)
            springs = PointObjective(b, own_ends, points[i], weights, chords)
            before = _motion(points[i - 1], points[i], x[i - 1], x[i], weight)
            before += _motion(points[i], points[i + 1], x[i], x[i + 1], weight)
            for k in range(m):
                for j in range(3):
                    errors[k, j] = 0.5 * (points[i - 1, k, j] + points[i + 1, k, j]) - points[i, k, j]
            for _ in range(TRIES):
                for u in range(n):
                    damping[u] = weight + extra[i]
                    aside = 0.5 * (x[i - 1, u] + x[i + 1, u]) - x[i, u]
                    centre[u] = weight * aside / damping[u]
                    low[u], high[u] = lower[u] - x[i, u], upper[u] - x[i, u]
                    sides[u] = 0
                minimise_in_box(springs, errors, damping, centre, low, high, sides, dx)
                gain = 0.0
                for share in (over, 1.0):
                    for u in range(n):
                        moved[u] = min(max(x[i, u] + share * dx[u], lower[u]), upper[u])
                    _displaced(start, chain.columns, which, units, moved, positions)
                    placements(chain, positions, lines[0][last + 1], lines[1][last + 1], there, rotations)
                    after = _motion(points[i - 1], there, x[i - 1], moved, weight)
                    after += _motion(there, points[i + 1], moved, x[i + 1], weight)
                    gain = before - after
                    if gain > 0.0:
                        break
                if gain > 0.0:
                    x[i], points[i] = moved, there
                    lines[0][i], lines[1][i] = lines[0][last + 1], lines[1][last + 1]
                    fall += gain
                    extra[i] = max(extra[i] * EASIER, least)
                    break
                extra[i] *= HARDER
        energy -= fall
        if fall <= settled * energy:
            break
    return energy


@compiled
def measure_path_lengths(
    chain: ChainArrays,
    which: Ints1,
    units: Array1,
    start: Array1,
    x: Array2,
    looks: int,
) -> tuple[float, float]:
    """How far all control points travel on a way, and how far apart its ends are.

    Args:
        chain: as above.
        which: as above.
        units: as above.
        start: as above.
        x: displacements of waypoints, joined by straight lines, (N + 1, n).
        looks: at how many places, equally far apart, to look where the points are.
    """
    n, m, last = len(which), len(chain.ends), len(x) - 1
    frames = (np.empty((len(chain.slides), 3)), np.empty((len(chain.slides), 3)), np.empty((m, 3, 3)))
    points, positions, here = np.empty((3, m, 3)), start.copy(), np.empty(n)
    path, direct = 0.0, 0.0
    for look in range(looks + 1):
        place = last * look / looks
        i = min(int(place), last - 1)
        share = place - i
        for u in range(n):
            here[u] = (1.0 - share) * x[i, u] + share * x[i + 1, u]
        _displaced(start, chain.columns, which, units, here, positions)
        at = 1 + look % 2 if look else 0
        placements(chain, positions, frames[0], frames[1], points[at], frames[2])
        if look:
            path += _between(points[at], points[3 - at if look > 1 else 0])
        if look == looks:
            direct = _between(points[at], points[0])
    return path, direct


@subkernel
def _displaced(
    start: Array1, columns: Ints1, which: Ints1, units: Array1, x: Array1, positions: Array1
) -> None:
    """Joint positions after a displacement."""
    for u in range(len(which)):
        j = columns[which[u]]
        positions[j] = start[j] + x[u] * units[u]


@subkernel
def _motion(one: Array2, other: Array2, x: Array1, y: Array1, weight: float) -> float:
    """Energy of the motion between two neighbours."""
    points, joints = 0.0, 0.0
    for k in range(len(one)):
        for j in range(3):
            points += (other[k, j] - one[k, j]) ** 2
    for u in range(len(x)):
        joints += (y[u] - x[u]) ** 2
    return points + weight * joints


@subkernel
def _between(one: Array2, other: Array2) -> float:
    """Sum of the distances between points."""
    total = 0.0
    for k in range(len(one)):
        x, y, z = one[k, 0] - other[k, 0], one[k, 1] - other[k, 1], one[k, 2] - other[k, 2]
        total += np.sqrt(x * x + y * y + z * z)
    return total


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
