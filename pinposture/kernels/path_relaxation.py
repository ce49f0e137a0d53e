"""Relaxation of joint-space paths to the shortest motion of the control points."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from pinposture.kernels.arrays import (
    Array1,
    Array2,
    Array3,
    Flags1,
    Flags2,
    Ints1,
    PathContacts,
    PathProblem,
    PathRows,
    PointObjective,
)
from pinposture.kernels.chain_solver import (
    factor,
    find_screws,
    minimise_in_box,
    minimise_points,
    move_bodies,
    move_points,
    pull_bodies,
    pull_points,
    solve_factored,
    stiffness,
)
from pinposture.kernels.compiled import compiled, subkernel
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

    set_changes: int = 3
    """Number of corrections of the active set in a step of all waypoints."""

    conjugate_steps: int = 60
    """Largest number of conjugate gradient iterations for a step of all waypoints."""

    conjugate_residual: float = 1e-2
    """Residual at which these end, relative to the right-hand side."""


RELAXATION = RelaxationSettings()


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
    """Relax the waypoints between two ends.

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
                    sides = np.zeros(n, dtype=np.int8)
                    minimise_in_box(objective, errors, np.full(n, damping), centre, low, high, sides, dx)
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
# arm. The preconditioner is a block Cholesky factor, which solves for one waypoint after another and back:
# each solve is least squares along the chain, in which a contact adds to the cost of the motion of a body.
# The diagonal blocks of the factor are approximated by multiples of M = J^T J + mu^2 I, which is exact if J
# is constant along the path and there are no contacts. Of two bodies in contact, each is treated as if the
# other were fixed.


@compiled
def step_waypoints(
    problem: PathProblem, damping: float, x: Array2, rows: PathRows, contacts: PathContacts, steps: Array2
) -> int:
    """Compute a damped Gauss-Newton step of the waypoints between two ends.

    Joints at a limit that the descent would push beyond it are held there. Contacts count if the solids are
    too close before or after the step.

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
    downhill = np.empty((last + 1, n))
    force = np.empty((m, 3))
    no_chords = np.zeros(m)
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
        typical += stiffness(PointObjective(screws[i], own_ends, points[i], np.ones(m), no_chords)) / (
            last - 1
        )
    # Blocks of the factor: stiff[i] M + damping, by d_1 = 2 + damping, d_{i+1} = 2 + damping - 1 / d_i.
    own = damping * typical
    stiff = np.zeros(last + 1)
    pivot = 2.0 + damping
    for i in range(1, last):
        stiff[i] = pivot - damping
        pivot = 2.0 + damping - 1.0 / pivot
    active = contacts.errors > 0.0
    held = np.zeros((last + 1, n), dtype=np.bool_)
    wrenches = np.zeros((len(active), 2, 6))
    values = np.empty(len(active))
    parts = (rows, contacts, wrenches, active)
    scratch = np.empty((n + 1, 6))
    for i in range(1, last):
        _find_wrenches(contacts, i, own_ends, points[i], wrenches)
    gains = np.empty((last + 1, n, 11))
    bodies = np.empty((n, 6, 6))
    total = 0
    steps[:] = 0.0
    for _ in range(RELAXATION.set_changes):
        downhill[:] = -slope
        for row in range(len(rows.errors)):
            for u in range(n):
                downhill[rows.waypoints[row], u] += rows.errors[row] * rows.matrix[row, u]
        for i in range(1, last):
            here = screws[i], own_ends, points[i]
            _pull_contacts(parts, i, contacts.errors, here, scratch, downhill[i])
            for u in range(n):
                above = x[i, u] >= upper[u] and downhill[i, u] > 0.0
                held[i, u] = above or (x[i, u] <= lower[u] and downhill[i, u] < 0.0)
                if held[i, u]:
                    downhill[i, u] = 0.0
                    steps[i, u] = 0.0
            _collect_contacts(parts, i, own_ends, bodies)
            objective = PointObjective(screws[i], own_ends, points[i], np.full(m, stiff[i]), no_chords)
            factor(objective, np.full(n, stiff[i] * weight + own), held[i], bodies, gains[i])
        system = (screws, own_ends, points), parts, held, own, weight
        total += _solve_by_conjugate_gradients(system, (stiff, gains), downhill, steps)
        changed = False
        for i in range(1, last):
            here = screws[i], own_ends, points[i]
            _move_contacts(parts, i, here, steps[i], scratch, values)
            for row in range(contacts.begins[i], contacts.begins[i + 1]):
                counts = contacts.errors[row] > values[row]
                changed = changed or counts != active[row]
                active[row] = counts
            for u in range(n):
                if not np.isfinite(steps[i, u]):
                    return -1
        if not changed:
            break
    return total


Chain = tuple[Array2, Ints1, Array2]
"""Screws of a waypoint, number of joints that carry each point, and its points."""

Chains = tuple[Array3, Ints1, Array3]
"""The same of all waypoints."""

Parts = tuple[PathRows, PathContacts, Array3, Flags1]
"""Rows, contacts, their wrenches, and flags of the active contacts."""

System = tuple[Chains, Parts, Flags2, float, float]
"""The normal equations: chains, rows and contacts, joints held at each waypoint, damping, and weight."""

Blocks = tuple[Array1, Array3]
"""The preconditioner: multiple of M in the block of each waypoint, and gains of these."""


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
def _move_contacts(parts: Parts, i: int, here: Chain, step: Array1, twists: Array2, values: Array1) -> None:
    """Fill in by how much a step of a waypoint increases the distances of its contacts."""
    _, contacts, wrenches, _ = parts
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
def _pull_contacts(
    parts: Parts, i: int, factors: Array1, here: Chain, forces: Array2, filled: Array1
) -> None:
    """Add the joint efforts of a waypoint's active contacts, as forces times factors."""
    _, contacts, wrenches, active = parts
    any_active = False
    forces[:] = 0.0
    for row in range(contacts.begins[i], contacts.begins[i + 1]):
        if active[row]:
            any_active = True
            for side in range(2):
                force = forces[contacts.carried[row, side]]
                own = wrenches[row, side]
                for j in range(6):
                    force[j] += factors[row] * own[j]
    if any_active:
        pull_bodies(here[0], here[1], here[2], forces, filled)


@subkernel
def _collect_contacts(parts: Parts, i: int, ends: Ints1, bodies: Array3) -> None:
    """Fill in the cost of body motions due to the contacts of a waypoint, (n, 6, 6)."""
    _, contacts, wrenches, active = parts
    last = ends[len(ends) - 1]
    bodies[:] = 0.0
    for row in range(contacts.begins[i], contacts.begins[i + 1]):
        for side in range(2):
            carried = min(contacts.carried[row, side], last)
            own = wrenches[row, side]
            if carried == 0 or not active[row]:
                continue
            cost = bodies[carried - 1]
            for a in range(6):
                for b in range(6):
                    cost[a, b] += own[a] * own[b]


@subkernel
def _solve_by_conjugate_gradients(system: System, blocks: Blocks, right: Array2, steps: Array2) -> int:
    """Improve the steps of waypoints, (N + 1, n), until they approximately solve H steps = right."""
    last = len(right) - 1
    n = right.shape[1]
    residual = np.zeros((last + 1, n))
    product = np.zeros((last + 1, n))
    solved = np.zeros((last + 1, n))
    motions = np.zeros((last + 1, len(system[0][1]), 3))
    factors = np.empty(len(system[1][3]))
    _precondition(system, blocks, right, solved)
    aim = RELAXATION.conjugate_residual**2 * _inner(right, solved)
    _multiply(system, steps, motions, factors, product)
    for i in range(1, last):
        for u in range(n):
            residual[i, u] = right[i, u] - product[i, u]
    _precondition(system, blocks, residual, solved)
    direction = solved.copy()
    size = _inner(residual, solved)
    for number in range(RELAXATION.conjugate_steps):
        if not size > aim:
            return number
        _multiply(system, direction, motions, factors, product)
        length = size / _inner(direction, product)
        for i in range(1, last):
            for u in range(n):
                steps[i, u] += length * direction[i, u]
                residual[i, u] -= length * product[i, u]
        _precondition(system, blocks, residual, solved)
        before = size
        size = _inner(residual, solved)
        for i in range(1, last):
            for u in range(n):
                direction[i, u] = solved[i, u] + size / before * direction[i, u]
    return RELAXATION.conjugate_steps


@subkernel
def _inner(one: Array2, other: Array2) -> float:
    total = 0.0
    for i in range(1, len(one) - 1):
        for u in range(one.shape[1]):
            total += one[i, u] * other[i, u]
    return total


@subkernel
def _multiply(system: System, steps: Array2, motions: Array3, factors: Array1, product: Array2) -> None:
    """Compute H steps, (N + 1, n); `motions` (N + 1, m, 3), zero at the ends, and `factors` are scratch."""
    (screws, ends, points), parts, held, own, weight = system
    rows, contacts, _, _ = parts
    last = len(steps) - 1
    n = steps.shape[1]
    force = np.empty((len(ends), 3))
    scratch = np.empty((n + 1, 6))
    for i in range(1, last):
        move_points(screws[i], ends, points[i], steps[i], motions[i])
    for i in range(1, last):
        for k in range(len(ends)):
            for j in range(3):
                force[k, j] = 2.0 * motions[i, k, j] - motions[i - 1, k, j] - motions[i + 1, k, j]
        product[i] = 0.0
        pull_points(screws[i], ends, points[i], force, product[i])
        for u in range(n):
            beside = steps[i - 1, u] + steps[i + 1, u]
            product[i, u] += (2.0 * weight + own) * steps[i, u] - weight * beside
    for row in range(len(rows.errors)):
        i = rows.waypoints[row]
        moved = 0.0
        for u in range(n):
            moved += rows.matrix[row, u] * steps[i, u]
        for u in range(n):
            product[i, u] += moved * rows.matrix[row, u]
    for i in range(1, last):
        here = screws[i], ends, points[i]
        if parts[3][contacts.begins[i] : contacts.begins[i + 1]].any():
            _move_contacts(parts, i, here, steps[i], scratch, factors)
            _pull_contacts(parts, i, factors, here, scratch, product[i])
        for u in range(n):
            if held[i, u]:
                product[i, u] = 0.0


@subkernel
def _precondition(system: System, blocks: Blocks, right: Array2, solved: Array2) -> None:
    """Apply the preconditioner: solve with the factor for the waypoints in order, then in reverse."""
    (screws, ends, points), _, held, own, weight = system
    stiff, gains = blocks
    last = len(right) - 1
    n = right.shape[1]
    m = len(ends)
    moved = np.zeros((m, 3))
    errors = np.empty((m, 3))
    chords = np.zeros(m)
    centre = np.empty(n)
    change = np.empty(n)
    for turn in range(2):
        moved[:] = 0.0
        for place in range(1, last):
            i = place if turn == 0 else last - place
            beside = i - 1 if turn == 0 else i + 1
            damping = np.full(n, stiff[i] * weight + own)
            objective = PointObjective(screws[i], ends, points[i], np.full(m, stiff[i]), chords)
            for u in range(n):
                coupled = weight * solved[beside, u] if place > 1 else 0.0
                centre[u] = (coupled + (right[i, u] if turn == 0 else 0.0)) / damping[u]
                change[u] = 0.0
            for k in range(m):
                for j in range(3):
                    errors[k, j] = moved[k, j] / stiff[i]
            if turn == 0 or place > 1:
                solve_factored((objective, errors, damping, centre), held[i], gains[i], change)
            for u in range(n):
                solved[i, u] = change[u] if turn == 0 else solved[i, u] + change[u]
            move_points(screws[i], ends, points[i], solved[i], moved)
