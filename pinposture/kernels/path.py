"""Following paths through joint space."""

from __future__ import annotations

import numpy as np

from pinposture.kernels.arrays import Array1, Array2, ChainArrays, Flags1, Ints1
from pinposture.kernels.compiled import compiled
from pinposture.kernels.kinematics import placements
from pinposture.kernels.time_parameterization import step_box

STEP_ROUNDING = 1e-12  # rounding error of a step, in units of each joint


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
