"""Relaxation of joint-space paths to the shortest motion of the control points."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from pinposture.kernels.arrays import (
    Array1,
    Array2,
    Array3,
    Flags1,
    Ints1,
    PathContacts,
    PathProblem,
    PathRows,
    PointObjective,
    Singles1,
    Singles2,
    Singles3,
)
from pinposture.kernels.chain_lanes import (
    COST,
    GAINS,
    LANES,
    factor_lanes,
    move_lanes,
    pull_lanes,
    solve_lanes,
)
from pinposture.kernels.chain_solver import (
    find_screws,
    minimise_in_box,
    minimise_points,
    move_bodies,
    pull_bodies,
    pull_points,
    stiffness,
)
from pinposture.kernels.compiled import compiled, inlined, subkernel
from pinposture.kernels.kinematics import placements
from pinposture.kernels.path_following import spline_bends


class RelaxationSettings(NamedTuple):
    """Settings of both relaxations; `docs/design/relaxation.md` measures the paths that come out."""

    most_over_relaxation: float = 1.85
    """Largest over-relaxation of a waypoint; 1 moves it to its own minimum, 2 would not converge."""

    damping_down: float = 0.1
    """Factor of the damping of a waypoint after a move that lowered the energy."""

    damping_up: float = 30.0
    """Factor of that damping after a move that did not."""

    least_damping: float = 3e-6
    """Smallest damping, relative to the mean squared distance of the control points from the base."""

    trials: int = 6
    """Number of failed moves after which a waypoint waits for the next pass."""

    fewest_samples: int = 24
    """Smallest number of samples for the length of a path."""

    samples_per_piece: int = 4
    """Smallest number of samples of each of its pieces."""

    set_changes: int = 8
    """Number of corrections of the active set in a step of all waypoints. It takes 5 to 8; with three, steps
    are 0.5 times their length off in the median, and leave kinks."""

    conjugate_steps: int = 60
    """Largest number of conjugate gradient iterations for a step of all waypoints."""

    conjugate_residual: float = 0.1
    """Residual at which these end with the first active set, in the norm of the preconditioner, relative to
    the root of what the step gains. Relative to the residual of no step, they ended at once, with 0.1 of what
    they could gain, where that is large by rows of tasks, which the preconditioner does not know."""


RELAXATION = RelaxationSettings()

LANE_OF = (0, 8, 4, 9, 2, 10, 5, 11, 1, 12, 6, 13, 3, 14, 7, 15)
"""The lane of each segment of a path. Segments whose first waypoints are eliminated later come first, so that
each elimination concerns the second half of the lanes left."""


# The energy of a path (see `trajectory_optimization`) couples each waypoint only with its two neighbours.
# With those fixed, its minimum is a weighted least-squares problem along the chain: move the control points
# to the midpoints between the neighbours', and the joints to the midpoints of theirs. Solving this for one
# waypoint after another with some over-relaxation, the energy never rises, and a pass over all waypoints
# costs one pass along the arm for each.


@compiled
def find_direct_waypoints(
    problem: PathProblem,
    guess: Array2,
    stages: Array2,
    stiffness: float,
    min_decrease: float,
    kept: float,
) -> Array2:
    """Find the waypoints of the most direct path, with as many pieces as needed.

    Args:
        problem: the joints.
        guess: initial waypoints, (N + 1, n), ends included.
        stages: number of pieces as a multiple of N, minimum weight of joint motion relative to `stiffness`,
            maximum number of passes, path length ratio at which to stop (0: not measured), and whether to
            restart from the guess (1) or not (0), (s, 5).
        stiffness: mean diagonal entry of J^T J for a typical configuration [m^2].
        min_decrease: relative decrease of the energy in one pass at which a stage ends.
        kept: path length ratio up to which joint interpolation is used.

    Returns:
        Waypoints, (K + 1, n); two for joint interpolation.
    """
    chain, which, ends, units, start, lower, upper, weight = problem
    x = guess.copy()
    best = np.empty((2, guess.shape[1]))
    best[0] = guess[0]
    best[1] = guess[-1]
    shortest = _length_ratio(problem, _refined(best, RELAXATION.fewest_samples, lower, upper))
    if shortest <= kept:
        return best
    for number in range(len(stages)):
        multiple, share, passes, good, again = stages[number]
        pieces = int(multiple) * (len(guess) - 1)
        if again > 0.0:
            x = guess
        if pieces > len(x) - 1:
            x = _refined(x, pieces, lower, upper)
        heavier = max(weight, share * stiffness)
        relax_waypoints(
            PathProblem(chain, which, ends, units, start, lower, upper, heavier),
            int(passes),
            min_decrease,
            x,
        )
        if good > 0.0:
            finer = max(RELAXATION.fewest_samples // pieces, RELAXATION.samples_per_piece)
            ratio = _length_ratio(problem, _refined(x, finer * pieces, lower, upper))
            if ratio < shortest:
                best = x.copy()
                shortest = ratio
            if shortest <= good:
                break
    return best


@subkernel
def relax_waypoints(problem: PathProblem, rounds: int, min_decrease: float, x: Array2) -> float:
    """Relax the waypoints between two ends, one after another.

    `step_waypoints`, which obstacles and tasks need, finds as direct paths, but takes three times as long
    (`docs/design/relaxation.md`).

    Args:
        problem: the joints.
        rounds: maximum number of passes over all waypoints.
        min_decrease: relative decrease of the energy in one pass at which to stop.
        x: displacements of waypoints, (N + 1, n); all but the ends are moved.

    Returns:
        The energy [m^2].
    """
    chain, which, own_ends, units, start, lower, upper, weight = problem
    n = len(which)
    m = len(chain.ends)
    last = len(x) - 1
    # Joint axes and origins of all waypoints, and last those of the trial waypoint.
    lines = (
        np.empty((last + 2, len(chain.joints.kinds), 3)),
        np.empty((last + 2, len(chain.joints.kinds), 3)),
    )
    points = np.empty((last + 2, m, 3))
    errors = np.empty((m, 3))
    rotations = np.empty((m, 3, 3))
    trial = points[last + 1]
    b = np.empty((n, 6))
    gains = np.empty((n, 8))
    positions = start.copy()
    dx = np.empty(n)
    moved = np.empty(n)
    centre = np.empty(n)
    for i in range(last + 1):
        _set_positions(start, chain.inputs, which, units, x[i], positions)
        placements(chain, positions, lines[0][i], lines[1][i], points[i], rotations)
    size = weight
    for k in range(m):
        for j in range(3):
            size += (points[0, k, j] - lines[1][0, 0, j]) ** 2 / m
    least = RELAXATION.least_damping * size
    extra = np.full(last + 1, least)
    energy = 0.0
    for i in range(last):
        energy += _segment_energy(points[i], points[i + 1], x[i], x[i + 1], weight)
    optimal = 2.0 / (1.0 + np.sin(np.pi / last))  # for a row of equal springs
    relaxation = min(optimal, RELAXATION.most_over_relaxation)
    for number in range(rounds):
        fall = 0.0
        for place in range(1, last):
            i = last - place if number % 2 else place
            find_screws(chain, which, units, lines[0][i], lines[1][i], own_ends, points[i], b)
            before = _segment_energy(points[i - 1], points[i], x[i - 1], x[i], weight)
            before += _segment_energy(points[i], points[i + 1], x[i], x[i + 1], weight)
            for k in range(m):
                for j in range(3):
                    errors[k, j] = 0.5 * (points[i - 1, k, j] + points[i + 1, k, j]) - points[i, k, j]
            for _ in range(RELAXATION.trials):
                damping = weight + extra[i]
                for u in range(n):
                    centre[u] = weight / damping * (0.5 * (x[i - 1, u] + x[i + 1, u]) - x[i, u])
                minimise_points(b, own_ends, points[i], errors, damping, centre, gains, dx)
                inside = True
                for u in range(n):
                    inside = inside and lower[u] <= x[i, u] + dx[u] <= upper[u]
                if not inside:
                    objective = PointObjective(b, own_ends, points[i], np.ones(m), np.zeros(m))
                    low = lower - x[i]
                    high = upper - x[i]
                    at_bound = np.zeros(n, dtype=np.int8)
                    minimise_in_box(objective, errors, np.full(n, damping), centre, low, high, at_bound, dx)
                gain = 0.0
                for share in (relaxation if number else 1.0, 1.0):
                    for u in range(n):
                        moved[u] = min(max(x[i, u] + share * dx[u], lower[u]), upper[u])
                    _set_positions(start, chain.inputs, which, units, moved, positions)
                    placements(chain, positions, lines[0][last + 1], lines[1][last + 1], trial, rotations)
                    after = _segment_energy(points[i - 1], trial, x[i - 1], moved, weight)
                    after += _segment_energy(trial, points[i + 1], moved, x[i + 1], weight)
                    gain = before - after
                    if gain > 0.0:
                        break
                if gain > 0.0:
                    x[i] = moved
                    points[i] = trial
                    lines[0][i] = lines[0][last + 1]
                    lines[1][i] = lines[1][last + 1]
                    fall += gain
                    extra[i] = max(extra[i] * RELAXATION.damping_down, least)
                    break
                extra[i] *= RELAXATION.damping_up
        energy -= fall
        if fall <= min_decrease * energy:
            break
    return energy


@compiled
def refine_waypoints(x: Array2, finer: Array2) -> None:
    """Refine waypoints with a natural cubic spline for each joint.

    Args:
        x: waypoints, (N + 1, n).
        finer: filled with the refined waypoints, (k N + 1, n); every k-th is one of x.
    """
    last = len(x) - 1
    n = x.shape[1]
    factor = (len(finer) - 1) // last
    bends = spline_bends(x)
    for i in range(last):
        for part in range(factor):
            t = part / factor
            for u in range(n):
                bend = ((2.0 - t) * bends[i, u] + (1.0 + t) * bends[i + 1, u]) / 6.0
                line = (1.0 - t) * x[i, u] + t * x[i + 1, u]
                finer[factor * i + part, u] = line - t * (1.0 - t) * bend
    finer[factor * last] = x[last]


@compiled
def divide_path(path: Array2, longest: Array1) -> tuple[Array2, Ints1]:
    """Divide the pieces of a path of straight motions into equal parts.

    Args:
        path: waypoints, (N + 1, n).
        longest: largest change of each joint in a part, (n,).

    Returns:
        The waypoints with those between them, (s, n), and the index of each waypoint among these, (N + 1,).
    """
    last = len(path) - 1
    n = path.shape[1]
    ends = np.zeros(last + 1, dtype=np.int64)
    for i in range(last):
        parts = 1.0
        for u in range(n):
            parts = max(parts, np.ceil(abs(path[i + 1, u] - path[i, u]) / longest[u]))
        ends[i + 1] = ends[i] + int(parts)
    finer = np.empty((ends[last] + 1, n))
    for i in range(last):
        count = ends[i + 1] - ends[i]
        for part in range(count):
            share = part / count
            for u in range(n):
                finer[ends[i] + part, u] = path[i, u] + share * (path[i + 1, u] - path[i, u])
    finer[ends[last]] = path[last]
    return finer, ends


@subkernel
def _refined(x: Array2, pieces: int, lower: Array1, upper: Array1) -> Array2:
    """Return refined waypoints on natural cubic splines, (pieces + 1, n), clipped to limits (n,)."""
    finer = np.empty((pieces + 1, x.shape[1]))
    refine_waypoints(x, finer)
    for i in range(len(finer)):
        for u in range(x.shape[1]):
            finer[i, u] = min(max(finer[i, u], lower[u]), upper[u])
    return finer


@subkernel
def _length_ratio(problem: PathProblem, x: Array2) -> float:
    """Return the path length of all control points relative to straight lines."""
    chain = problem.chain
    which = problem.which
    start = problem.start
    units = problem.units
    m = len(chain.ends)
    last = len(x) - 1
    frames = (
        np.empty((len(chain.joints.kinds), 3)),
        np.empty((len(chain.joints.kinds), 3)),
        np.empty((m, 3, 3)),
    )
    points = np.empty((3, m, 3))
    positions = start.copy()
    path = 0.0
    for i in range(last + 1):
        _set_positions(start, chain.inputs, which, units, x[i], positions)
        at = 1 + i % 2 if i else 0
        placements(chain, positions, frames[0], frames[1], points[at], frames[2])
        if i:
            path += _sum_distances(points[at], points[3 - at if i > 1 else 0])
    direct = _sum_distances(points[1 + last % 2], points[0])
    return max(path / direct, 1.0) if direct > 1e-12 * path else 1.0


@subkernel
def _set_positions(
    start: Array1, columns: Ints1, which: Ints1, units: Array1, x: Array1, positions: Array1
) -> None:
    """Write the joint positions for a displacement."""
    for u in range(len(which)):
        j = columns[which[u]]
        positions[j] = start[j] + x[u] * units[u]


@subkernel
def _segment_energy(one: Array2, other: Array2, x: Array1, y: Array1, weight: float) -> float:
    """Return the energy of the motion between two neighbours."""
    points = 0.0
    joints = 0.0
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
        x = one[k, 0] - other[k, 0]
        y = one[k, 1] - other[k, 1]
        z = one[k, 2] - other[k, 2]
        total += np.sqrt(x * x + y * y + z * z)
    return total


# With additional rows, all waypoints move together by damped Gauss-Newton steps, whose normal equations only
# couple neighbours. Conjugate gradients solve them with products by J and J^T, which are passes along the
# arm. The preconditioner is a block Cholesky factor: each block is solved by least squares along the chain,
# in which a contact adds to the cost of the motion of a body. The blocks of the factor are approximated by
# multiples of M = J^T J + mu^2 I on the diagonal and of J_i^T J_k + mu^2 I beside it, which is exact if J is
# constant along the path and there are no contacts. Of two bodies in contact, each is treated as if the other
# were fixed.
#
# The path is divided into as many segments as there are lanes (`chain_lanes`), and waypoints are eliminated
# in all segments at once: chunk k holds waypoint k of each segment. The first waypoints of the segments
# follow, every second one of those that are left at a time.


@compiled
def step_waypoints(
    problem: PathProblem, damping: float, x: Array2, rows: PathRows, contacts: PathContacts, steps: Array2
) -> int:
    """Compute a damped Gauss-Newton step of the waypoints between two ends.

    Joints at a limit that the descent would push beyond it are held there; the caller cuts the step at the
    other limits, as each change of the held joints would need another factor of the whole path. Contacts
    count if the solids are too close before or after the step.

    Args:
        problem: the joints.
        damping: damping relative to the mean diagonal of J^T J.
        x: displacements of waypoints, (N + 1, n).
        rows: additional equations on the path.
        contacts: contacts to avoid.
        steps: filled with the step of each waypoint, (N + 1, n); zero at the ends.

    Returns:
        Number of iterations; -1 if the step is not finite.
    """
    chain, which, own_ends, units, start, lower, upper, weight = problem
    n = len(which)
    m = len(chain.ends)
    last = len(x) - 1
    axes = np.empty((len(chain.joints.kinds), 3))
    origins = np.empty((len(chain.joints.kinds), 3))
    points = np.empty((last + 1, m, 3))
    screws = np.empty((last + 1, n, 6))
    rotations = np.empty((m, 3, 3))
    positions = start.copy()
    slope = np.zeros((last + 1, n))
    force = np.empty((m, 3))
    typical = 0.0
    for i in range(last + 1):
        _set_positions(start, chain.inputs, which, units, x[i], positions)
        placements(chain, positions, axes, origins, points[i], rotations)
        find_screws(chain, which, units, axes, origins, own_ends, points[i], screws[i])
    for i in range(1, last):
        for k in range(m):
            for j in range(3):
                force[k, j] = 2.0 * points[i, k, j] - points[i - 1, k, j] - points[i + 1, k, j]
        pull_points(screws[i], own_ends, points[i], force, slope[i])
        for u in range(n):
            slope[i, u] += weight * (2.0 * x[i, u] - x[i - 1, u] - x[i + 1, u])
        typical += stiffness(PointObjective(screws[i], own_ends, points[i], np.ones(m), np.zeros(m))) / (
            last - 1
        )
    packed, ways = _pack_chains(screws, points)
    chains = own_ends, packed, ways
    chunks = len(packed)
    diagonals, before, after = _couple(last, damping, chunks)
    gains = np.empty((chunks, n, GAINS * LANES), np.float32)
    free = np.zeros((chunks, n, LANES))
    single_screws = packed.astype(np.float32)
    single_ways = ways.astype(np.float32)
    factor = _Factor(diagonals, before, after, gains, free, single_screws, single_ways)
    size = weight, damping * typical
    active = contacts.errors > 0.0
    wrenches = np.zeros((len(active), 2, 6))
    values = np.empty(len(active))
    twists = np.empty((n + 1, 6))
    for i in range(1, last):
        _find_wrenches(contacts, i, own_ends, points[i], wrenches)
    total = 0
    aim = 0.0
    moves = np.zeros((chunks, n + 3 * m, LANES))
    right = np.zeros((chunks, n, LANES))
    steps[:] = 0.0
    for _ in range(RELAXATION.set_changes):
        every = _join_rows(rows, contacts, wrenches, active, (screws, own_ends, points))
        downhill = -slope
        for row in range(len(every.errors)):
            for u in range(n):
                downhill[every.waypoints[row], u] += every.errors[row] * every.matrix[row, u]
        for i in range(1, last):
            chunk, lane = _place_of(i, chunks)
            for u in range(n):
                above = x[i, u] >= upper[u] and downhill[i, u] > 0.0
                held = above or (x[i, u] <= lower[u] and downhill[i, u] < 0.0)
                factor.free[chunk, u, lane] = 0.0 if held else 1.0
                right[chunk, u, lane] = 0.0 if held else downhill[i, u]
                if held:
                    moves[chunk, u, lane] = 0.0
        _factor_all(chains, size, factor, (contacts, wrenches, active))
        count, aim = _solve_by_conjugate_gradients(chains, every, size, factor, right, moves, aim)
        total += count
        changed = False
        for i in range(1, last):
            chunk, lane = _place_of(i, chunks)
            for u in range(n):
                steps[i, u] = moves[chunk, u, lane]
                if not np.isfinite(steps[i, u]):
                    return -1
            _move_contacts(contacts, wrenches, i, (screws[i], own_ends, points[i]), steps[i], twists, values)
            for row in range(contacts.begins[i], contacts.begins[i + 1]):
                counts = contacts.errors[row] > values[row]
                changed = changed or counts != active[row]
                active[row] = counts
        if not changed:
            break
    return total


Chain = tuple[Array2, Ints1, Array2]
"""Screws of a waypoint, number of joints that carry each point, and its points."""

Chains = tuple[Array3, Ints1, Array3]
"""The same of all waypoints."""

Chunks = tuple[Ints1, Array3, Array3]
"""`chain_lanes.Lanes` of all chunks."""

Loads = tuple[PathContacts, Array3, Flags1]
"""Contacts, their wrenches, and flags of the active ones."""

Size = tuple[float, float]
"""Weight of joint motion, and damping."""


class _Factor(NamedTuple):
    """The preconditioner. It need not be exact: what each iteration reads is in single precision.

    Couplings are multiples of J_i^T J_k + mu^2 I, with the other sign.

    Attributes:
        diagonals: multiple of M in the block of each waypoint, without the damping, (chunks, lanes).
        before: coupling with the first waypoint of the segment; of first waypoints, with the one before that
            remains, (chunks, lanes).
        after: coupling with the next waypoint, or with the next first one that remains, (chunks, lanes).
        gains: gains of the joints, (chunks, n, 7 lanes).
        free: 1 for joints that move, 0 for those that are held, (chunks, n, lanes).
        screws: screws of the joints, (chunks, n, 6 lanes).
        ways: the ways between points, (chunks, m, 3 lanes).
    """

    diagonals: Array2
    before: Singles2
    after: Singles2
    gains: Singles3
    free: Array3
    screws: Singles3
    ways: Singles3


@inlined
def _place_of(i: int, chunks: int) -> tuple[int, int]:
    """Return chunk and lane of a waypoint."""
    return i % chunks, LANE_OF[i // chunks]


@subkernel
def _pack_chains(screws: Array3, points: Array3) -> tuple[Array3, Array3]:
    """Return screws and the ways between points in lanes; zero for the ends of the path."""
    last = len(screws) - 1
    n = screws.shape[1]
    m = points.shape[1]
    chunks = (last + LANES - 1) // LANES
    packed = np.zeros((chunks, n, 6 * LANES))
    ways = np.zeros((chunks, m, 3 * LANES))
    for i in range(1, last):
        chunk, lane = _place_of(i, chunks)
        for u in range(n):
            for j in range(6):
                packed[chunk, u, j * LANES + lane] = screws[i, u, j]
        for k in range(1, m):
            for j in range(3):
                ways[chunk, k, j * LANES + lane] = points[i, k, j] - points[i, k - 1, j]
    return packed, ways


@subkernel
def _couple(last: int, damping: float, chunks: int) -> tuple[Array2, Singles2, Singles2]:
    """Eliminate waypoints as numbers; return diagonals and couplings of `_Factor`."""
    diagonals = np.full((chunks, LANES), 2.0 + damping)
    before = np.zeros((chunks, LANES))
    after = np.zeros((chunks, LANES))
    between = np.zeros(LANES + 1)  # couplings of first waypoints with the next one that remains
    for segment in range(LANES):
        lane = LANE_OF[segment]
        first = segment * chunks
        carried = 1.0 if 0 < first < last else 0.0
        for k in range(1, chunks):
            i = first + k
            if i >= last:
                break
            ahead = 1.0 if i + 1 < last else 0.0
            before[k, lane] = carried
            after[k, lane] = ahead
            share = 1.0 / diagonals[k, lane]
            if carried > 0.0:
                diagonals[0, lane] -= carried * carried * share
            if k + 1 < chunks:
                diagonals[k + 1, lane] -= ahead * ahead * share
            elif ahead > 0.0:
                diagonals[0, LANE_OF[segment + 1]] -= ahead * ahead * share
            carried = carried * ahead * share
        between[segment] = carried if first + chunks < last else 0.0
    step = 1
    while step < LANES:
        for segment in range(step, LANES, 2 * step):
            lane = LANE_OF[segment]
            left = between[segment - step]
            right = between[segment] if segment + step < LANES else 0.0
            share = 1.0 / diagonals[0, lane]
            before[0, lane] = left
            after[0, lane] = right
            diagonals[0, LANE_OF[segment - step]] -= left * left * share
            if segment + step < LANES:
                diagonals[0, LANE_OF[segment + step]] -= right * right * share
            between[segment - step] = left * right * share
        step = 2 * step
    return diagonals - damping, before.astype(np.float32), after.astype(np.float32)


@subkernel
def _join_rows(
    rows: PathRows, contacts: PathContacts, wrenches: Array3, active: Flags1, chains: Chains
) -> PathRows:
    """Return the equations of rows and of active contacts."""
    screws, ends, points = chains
    n = screws.shape[1]
    given = len(rows.errors)
    count = given + np.count_nonzero(active)
    matrix = np.zeros((count, n))
    errors = np.empty(count)
    waypoints = np.empty(count, dtype=np.int64)
    matrix[:given] = rows.matrix
    errors[:given] = rows.errors
    waypoints[:given] = rows.waypoints
    forces = np.zeros((n + 1, 6))
    at = given
    for i in range(1, len(screws) - 1):
        for row in range(contacts.begins[i], contacts.begins[i + 1]):
            if not active[row]:
                continue
            for side in range(2):
                forces[contacts.carried[row, side]] += wrenches[row, side]
            pull_bodies(screws[i], ends, points[i], forces, matrix[at])
            for side in range(2):
                forces[contacts.carried[row, side]] = 0.0
            errors[at] = contacts.errors[row]
            waypoints[at] = i
            at += 1
    return PathRows(matrix, errors, waypoints)


@subkernel
def _factor_all(chains: Chunks, size: Size, factor: _Factor, loads: Loads) -> None:
    """Factor the blocks of all waypoints."""
    ends, screws, ways = chains
    contacts, wrenches, active = loads
    weight, own = size
    chunks = len(screws)
    n = screws.shape[1]
    last = len(contacts.begins) - 2
    bodies = np.zeros((n, COST * LANES))
    loaded = np.zeros(n, dtype=np.bool_)
    for chunk in range(chunks):
        for segment in range(LANES):
            lane = LANE_OF[segment]
            i = segment * chunks + chunk
            if not 0 < i < last:
                continue
            for row in range(contacts.begins[i], contacts.begins[i + 1]):
                for side in range(2):
                    carried = min(contacts.carried[row, side], ends[len(ends) - 1])
                    if carried == 0 or not active[row]:
                        continue
                    _add_load(bodies[carried - 1], wrenches[row, side], lane)
                    loaded[carried - 1] = True
        stiff = factor.diagonals[chunk]
        damping = stiff * weight + own
        here = ends, screws[chunk], ways[chunk]
        factor_lanes(here, stiff, damping, factor.free[chunk], bodies, loaded, factor.gains[chunk])
        for u in range(n):
            if loaded[u]:
                bodies[u] = 0.0
                loaded[u] = False


@subkernel
def _add_load(costs: Array1, wrench: Array1, lane: int) -> None:
    """Add the square of the work of a wrench to the costs of a body in one lane, (21 lanes,)."""
    at = lane
    for a in range(3):
        for b in range(a, 3):
            costs[at] += wrench[a] * wrench[b]
            at += LANES
    for a in range(3):
        for b in range(3, 6):
            costs[at] += wrench[a] * wrench[b]
            at += LANES
    for a in range(3, 6):
        for b in range(a, 6):
            costs[at] += wrench[a] * wrench[b]
            at += LANES


@subkernel
def _find_wrenches(contacts: PathContacts, i: int, ends: Ints1, points: Array2, wrenches: Array3) -> None:
    """Fill in the forces and moments of a waypoint's contacts on both solids, (k, 2, 6)."""
    for row in range(contacts.begins[i], contacts.begins[i + 1]):
        for side in range(2):
            carried = contacts.carried[row, side]
            if carried == 0:
                continue
            k = min(np.searchsorted(ends, carried), len(ends) - 1)
            x = contacts.points[row, 0] - points[k, 0]
            y = contacts.points[row, 1] - points[k, 1]
            z = contacts.points[row, 2] - points[k, 2]
            sign = 1.0 - 2.0 * side
            f0 = sign * contacts.normals[row, 0]
            f1 = sign * contacts.normals[row, 1]
            f2 = sign * contacts.normals[row, 2]
            own = wrenches[row, side]
            own[0] = f0
            own[1] = f1
            own[2] = f2
            own[3] = y * f2 - z * f1
            own[4] = z * f0 - x * f2
            own[5] = x * f1 - y * f0


@subkernel
def _move_contacts(
    contacts: PathContacts,
    wrenches: Array3,
    i: int,
    here: Chain,
    step: Array1,
    twists: Array2,
    values: Array1,
) -> None:
    """Fill in by how much a step of a waypoint increases the distances of its contacts."""
    begin = contacts.begins[i]
    end = contacts.begins[i + 1]
    if begin == end:
        return
    move_bodies(here[0], here[1], here[2], step, twists)
    for row in range(begin, end):
        values[row] = 0.0
        for side in range(2):
            twist = twists[contacts.carried[row, side]]
            own = wrenches[row, side]
            for j in range(6):
                values[row] += own[j] * twist[j]


@subkernel
def _solve_by_conjugate_gradients(
    chains: Chunks, rows: PathRows, size: Size, factor: _Factor, right: Array3, moves: Array3, aim: float
) -> tuple[int, float]:
    """Improve the motions of joints and points, (chunks, n + 3 m, lanes), until H moves = right, nearly.

    Args:
        chains: the chains.
        rows: equations that are added to the energy.
        size: weight and damping.
        factor: the preconditioner.
        right: right-hand side, (chunks, n, lanes).
        moves: motions to begin with, of joints only; improved.
        aim: size of the residual at which to end; 0: the motions are zero, it is a share of what they gain.

    Returns:
        Number of iterations, and that size.
    """
    residual = right.copy()
    product = np.empty(moves.shape)
    forces = np.empty(moves.shape, np.float32)
    solved = np.empty(moves.shape, np.float32)
    if aim > 0.0:
        for chunk in range(len(moves)):
            move_lanes((chains[0], chains[1][chunk], chains[2][chunk]), moves[chunk])
        _multiply(chains, rows, size, factor.free, moves, product)
        _add(residual, -1.0, product)
    _precondition(chains[0], size[0], factor, residual, forces, solved)
    direction = solved.astype(np.float64)
    amount = _inner(right, residual, solved)
    first = aim == 0.0
    for number in range(RELAXATION.conjugate_steps):
        if not amount > aim:
            return number, aim
        _multiply(chains, rows, size, factor.free, direction, product)
        length = amount / _inner(right, direction, product)
        if first:
            aim += RELAXATION.conjugate_residual**2 * length * amount
        _add(moves, length, direction)
        _add(residual, -length, product)
        _precondition(chains[0], size[0], factor, residual, forces, solved)
        before = amount
        amount = _inner(right, residual, solved)
        direction *= amount / before
        _add(direction, 1.0, solved)
    return RELAXATION.conjugate_steps, aim


@subkernel
def _inner(like: Array3, one: Array3, other: Array3 | Singles3) -> float:
    """Return the inner product of as many of the first rows as another array has."""
    sums = np.zeros(LANES)
    for chunk in range(len(like)):
        for u in range(like.shape[1]):
            for i in range(LANES):
                sums[i] += one[chunk, u, i] * other[chunk, u, i]
    return sums.sum()


@subkernel
def _add(filled: Array3, factor: float, added: Array3 | Singles3) -> None:
    """Add a multiple of as many of the first rows as there are."""
    for chunk in range(len(filled)):
        for u in range(filled.shape[1]):
            for i in range(LANES):
                filled[chunk, u, i] += factor * added[chunk, u, i]


@subkernel
def _pass_on(
    filled: Array2 | Singles2, factors: Array1 | Singles1, weight: float, n: int, added: Array2 | Singles2
) -> None:
    """Add multiples of each lane, by the weight for the n joints."""
    for row in range(n):
        for i in range(LANES):
            filled[row, i] += weight * factors[i] * added[row, i]
    for row in range(n, len(filled)):
        for i in range(LANES):
            filled[row, i] += factors[i] * added[row, i]


@subkernel
def _pass_between(
    filled: Array2 | Singles2,
    factors: Array1 | Singles1,
    weight: float,
    n: int,
    added: Array2 | Singles2,
    step: int,
    offset: int,
    back: bool,
) -> None:
    """Add multiples of the lanes of segments to those of others, by the weight for the n joints.

    Args:
        filled: the lanes that are added to.
        factors: factors of the lanes, (lanes,).
        weight: additional factor for joints.
        n: number of joints.
        added: the lanes that are added.
        step: 0 for all segments, else odd multiples of it.
        offset: number of segments from each of these to the other.
        back: whether their lanes are those that are added to; the factors are theirs.
    """
    for segment in range(step, LANES, max(2 * step, 1)):
        if not 0 <= segment + offset < LANES:
            continue
        own = LANE_OF[segment]
        other = LANE_OF[segment + offset]
        factor = factors[own]
        if factor == 0.0:
            continue
        to = own if back else other
        lane = other if back else own
        for row in range(n):
            filled[row, to] += weight * factor * added[row, lane]
        for row in range(n, len(filled)):
            filled[row, to] += factor * added[row, lane]


@subkernel
def _multiply(
    chains: Chunks, rows: PathRows, size: Size, free: Array3, moves: Array3, product: Array3
) -> None:
    """Compute H moves in the first n rows of the product, for motions of joints and points."""
    ends, screws, ways = chains
    weight, own = size
    last = len(screws) - 1
    n = screws.shape[1]
    minus = np.full(LANES, -1.0)
    for chunk in range(last + 1):
        filled = product[chunk]
        for row in range(len(filled)):
            scale = 2.0 * weight + own if row < n else 2.0
            for i in range(LANES):
                filled[row, i] = scale * moves[chunk, row, i]
        if chunk > 0:
            _pass_on(filled, minus, weight, n, moves[chunk - 1])
        if chunk < last:
            _pass_on(filled, minus, weight, n, moves[chunk + 1])
    _pass_between(product[0], minus, weight, n, moves[last], 0, 1, False)
    _pass_between(product[last], minus, weight, n, moves[0], 0, 1, True)
    for chunk in range(last + 1):
        pull_lanes((ends, screws[chunk], ways[chunk]), product[chunk])
    own_moves = np.empty(n)
    efforts = np.zeros(n)
    for row in range(len(rows.errors)):
        waypoint = rows.waypoints[row]
        chunk, lane = _place_of(waypoint, last + 1)
        if row == 0 or rows.waypoints[row - 1] != waypoint:
            for u in range(n):
                own_moves[u] = moves[chunk, u, lane]
        moved = 0.0
        for u in range(n):
            moved += rows.matrix[row, u] * own_moves[u]
        for u in range(n):
            efforts[u] += moved * rows.matrix[row, u]
        if row == len(rows.errors) - 1 or rows.waypoints[row + 1] != waypoint:
            for u in range(n):
                product[chunk, u, lane] += efforts[u]
                efforts[u] = 0.0
    for chunk in range(last + 1):
        for u in range(n):
            for i in range(LANES):
                product[chunk, u, i] *= free[chunk, u, i]


@subkernel
def _precondition(
    ends: Ints1, joint_weight: float, factor: _Factor, right: Array3, forces: Singles3, solved: Singles3
) -> None:
    """Apply the preconditioner: eliminate one waypoint after another, then go back; `forces` is scratch."""
    screws = factor.screws
    ways = factor.ways
    chunks = len(screws)
    n = screws.shape[1]
    weight = np.float32(joint_weight)
    heads = forces[0]
    spare = np.empty((forces.shape[1], LANES), np.float32)
    for chunk in range(chunks):
        for u in range(n):
            for i in range(LANES):
                forces[chunk, u, i] = right[chunk, u, i]
        forces[chunk, n:] = 0.0
    for chunk in range(1, chunks):
        here = ends, screws[chunk], ways[chunk]
        solve_lanes(here, factor.gains[chunk], forces[chunk], LANES, solved[chunk])
        _pass_on(heads, factor.before[chunk], weight, n, solved[chunk])
        if chunk + 1 < chunks:
            _pass_on(forces[chunk + 1], factor.after[chunk], weight, n, solved[chunk])
        else:
            _pass_between(heads, factor.after[chunk], weight, n, solved[chunk], 0, 1, False)
    here = ends, screws[0], ways[0]
    solved[0, :, 0] = 0.0
    step = 1
    while step < LANES:
        solve_lanes(here, factor.gains[0], heads, LANES // step, spare)
        for row in range(len(spare)):
            for i in range(LANES // (2 * step), LANES // step):
                solved[0, row, i] = spare[row, i]
        _pass_between(heads, factor.before[0], weight, n, solved[0], step, -step, False)
        _pass_between(heads, factor.after[0], weight, n, solved[0], step, step, False)
        step = 2 * step
    step = LANES // 4
    while step > 0:
        heads[:] = 0.0
        _pass_between(heads, factor.before[0], weight, n, solved[0], step, -step, True)
        _pass_between(heads, factor.after[0], weight, n, solved[0], step, step, True)
        solve_lanes(here, factor.gains[0], heads, LANES // step, spare)
        for row in range(len(spare)):
            for i in range(LANES // (2 * step), LANES // step):
                solved[0, row, i] += spare[row, i]
        step = step // 2
    for chunk in range(chunks - 1, 0, -1):
        forces[chunk] = 0.0
        _pass_on(forces[chunk], factor.before[chunk], weight, n, solved[0])
        if chunk + 1 < chunks:
            _pass_on(forces[chunk], factor.after[chunk], weight, n, solved[chunk + 1])
        else:
            _pass_between(forces[chunk], factor.after[chunk], weight, n, solved[0], 0, 1, True)
        here = ends, screws[chunk], ways[chunk]
        solve_lanes(here, factor.gains[chunk], forces[chunk], LANES, spare)
        solved[chunk] += spare
