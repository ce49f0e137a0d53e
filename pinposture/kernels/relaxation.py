"""The most direct way between two configurations, relaxed waypoint by waypoint.

The energy that `control.constrained.direct` explains couples each waypoint with its two neighbours only.
With those held, it is least where the control points come nearest to the middle between the neighbours', and
the joints to the middle of theirs, by weight: least squares along the chain. Solving that for one waypoint
after the other, each time going somewhat beyond (successive over-relaxation), the energy never rises, and
one pass over all waypoints costs one sweep along the arm for each.
"""

from __future__ import annotations

import numpy as np

from pinposture.kernels.arrays import Array1, Array2, Chain, Ints1, Springs
from pinposture.kernels.bounded import minimise_in_box
from pinposture.kernels.compiled import compiled, subkernel
from pinposture.kernels.kinematics import placements
from pinposture.kernels.springs import find_screws

MOST_OVER = 1.85
"""How far a waypoint is moved at most, where its own minimum is at 1."""

EASIER, HARDER, LEAST, TRIES = 0.1, 30.0, 3e-6, 6
"""How the damping of a waypoint changes after a move that lowered the energy or failed to; the least,
relative to the mean squared distance of the control points from the base; and after how many failures it
waits for the next pass."""


@compiled
def relax_waypoints(
    chain: Chain,
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
            springs = Springs(b, own_ends, points[i], weights, chords)
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
def measure_ways(
    chain: Chain,
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
