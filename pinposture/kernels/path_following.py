"""Following paths: how fast limits of speed and acceleration allow it, braking, and steps along them."""

from __future__ import annotations

import numpy as np

from pinposture.kernels.arrays import Array1, Array2, ChainArrays, Flags1, Ints1
from pinposture.kernels.compiled import compiled, subkernel
from pinposture.kernels.kinematics import placements

STEP_ROUNDING = 1e-12  # rounding error of a step, in units of each joint
MAX_PASSED = 10  # largest number of waypoints that one step passes if its length is limited

MAX_BRAKING_STEPS = 1e60
"""Number of braking steps that stands for infinitely many: a joint without position limits."""

UNMET_LIMITS, OUTSIDE_LIMITS = 1, 2
"""Flags that `step_box` returns: limits that cannot be met, and a joint of the chain outside its limits."""


@subkernel
def _max_gain(
    slope: Array1, bend: Array1, brake: Array1, brake_share: float, curve_share: float, rate: float
) -> float:
    """Return the largest change of path speed from one step to the next at a waypoint."""
    most = np.inf
    for joint in range(len(slope)):
        left = brake_share * brake[joint]
        left = max(left - bend[joint] * rate**2, (1.0 - curve_share) * left)
        most = min(most, left / slope[joint])
    return most


@subkernel
def _spread_maximum(values: Array2, reach: int, least: float, wide: Array2) -> None:
    """Fill `wide` with the largest of each absolute value and its neighbours along the path, or `least`."""
    for i in range(len(values)):
        first, last = max(i - reach, 0), min(i + reach + 1, len(values))
        for joint in range(values.shape[1]):
            most = least
            for near in range(first, last):
                most = max(most, abs(values[near, joint]))
            wide[i, joint] = most


@subkernel
def _differences(values: Array2, slopes: Array2) -> None:
    """Fill `slopes` with central differences of rows, at the ends one-sided."""
    last = len(values) - 1
    for i in range(len(values)):
        low, high = max(i - 1, 0), min(i + 1, last)
        for joint in range(values.shape[1]):
            slopes[i, joint] = (values[high, joint] - values[low, joint]) / (high - low)


@subkernel
def _speed_profile(
    slope: Array2,
    bend: Array2,
    bound: Array1,
    brake: Array1,
    start_speed: float,
    most: float,
    speed: float,
    brake_share: float,
    curve_share: float,
    cap: Array1,
    top: Array1,
) -> None:
    """Fill `cap` and `top` of `find_speed_profile` from slopes and bends."""
    count, joints = slope.shape
    stops = False
    for joint in range(joints):
        stops = stops or np.isfinite(brake[joint])
    for i in range(count):
        top[i] = min(most, float(count))
        for joint in range(joints):
            top[i] = min(top[i], speed * bound[joint] / slope[i, joint])
            top[i] = min(top[i], np.sqrt(curve_share * brake_share * brake[joint] / bend[i, joint]))
        cap[i] = top[i]
    if stops:
        top[count - 1] = 0.0
        top[0] = min(
            top[0], max(start_speed, _max_gain(slope[0], bend[0], brake, brake_share, curve_share, 0.0))
        )
    for i in range(count - 2, -1, -1):
        here = _max_gain(slope[i], bend[i], brake, brake_share, curve_share, top[i])
        gain = min(here, _max_gain(slope[i + 1], bend[i + 1], brake, brake_share, curve_share, top[i + 1]))
        top[i] = min(top[i], np.sqrt(top[i + 1] ** 2 + 2.0 * gain))
    for i in range(1, count):
        here = _max_gain(slope[i], bend[i], brake, brake_share, curve_share, top[i])
        gain = min(here, _max_gain(slope[i - 1], bend[i - 1], brake, brake_share, curve_share, top[i - 1]))
        top[i] = min(top[i], np.sqrt(top[i - 1] ** 2 + 2.0 * gain))


@compiled
def find_speed_profile(
    offsets: Array2,
    bound: Array1,
    brake: Array1,
    start_speed: float,
    most: float,
    speed: float,
    brake_share: float,
    curve_share: float,
    small: float,
    slope: Array2,
    bend: Array2,
    cap: Array1,
    top: Array1,
) -> None:
    """Compute the largest path speed at each waypoint that allows for all slower places ahead, and the end.

    It is derived in `control.planner.path`.

    Args:
        offsets: displacement of each waypoint from the first, (N + 1, nv), N > 0.
        bound: largest step of each joint, (nv,); may be infinite.
        brake: largest change of a step from the one before, (nv,), > 0; may be infinite.
        start_speed: waypoints of the step before the first one.
        most: largest number of waypoints of one step; may be infinite.
        speed: share of the bounds that is planned with.
        brake_share: share of the brakes that is planned with.
        curve_share: largest share of that for curves.
        small: slope that counts as zero, relative to the largest.
        slope: filled with the largest motion of each joint there per waypoint, (N + 1, nv).
        bend: filled with its largest change, (N + 1, nv).
        cap: filled with the speed that bounds and curves there allow, (N + 1,) [waypoints per step].
        top: filled with the speed, (N + 1,) [waypoints per step].
    """
    slopes, bends = np.empty(offsets.shape), np.empty(offsets.shape)
    _differences(offsets, slopes)
    _differences(slopes, bends)
    tiny = 1e-100
    for i in range(len(slopes)):
        for joint in range(offsets.shape[1]):
            tiny = max(tiny, small * abs(slopes[i, joint]))
    reach = 1
    while True:
        _spread_maximum(slopes, reach, tiny, slope)
        _spread_maximum(bends, reach, tiny, bend)
        _speed_profile(
            slope, bend, bound, brake, start_speed, most, speed, brake_share, curve_share, cap, top
        )
        # A step that passes several waypoints must meet the limits at all of them.
        passed = min(int(np.ceil(top.max())), MAX_PASSED) if np.isfinite(most) else 1
        if passed <= reach:
            break
        reach = passed


@subkernel
def _fastest_between(
    place: float,
    rate: float,
    slope: Array2,
    bend: Array2,
    cap: Array1,
    top: Array1,
    brake: Array1,
    brake_share: float,
    curve_share: float,
) -> float:
    """Return the largest speed between two waypoints, given the speeds at both and the largest changes."""
    at = min(int(place), len(top) - 2)
    share = min(place - at, 1.0)
    gain = _max_gain(slope[at], bend[at], brake, brake_share, curve_share, rate)
    gain = min(gain, _max_gain(slope[at + 1], bend[at + 1], brake, brake_share, curve_share, rate))
    most = min(cap[at], cap[at + 1])
    if not np.isfinite(gain):
        return most
    most = min(most, np.sqrt(top[at] ** 2 + 2.0 * gain * share))
    return min(most, np.sqrt(top[at + 1] ** 2 + 2.0 * gain * (1.0 - share)))


@compiled
def next_path_speed(
    place: float,
    rate: float,
    slope: Array2,
    bend: Array2,
    cap: Array1,
    top: Array1,
    brake: Array1,
    brake_share: float,
    curve_share: float,
) -> float:
    """Return the number of waypoints to go in a step.

    The step begins at a place, in waypoints from the start of the path; the step before went `rate`
    waypoints. Other arguments are as for `find_speed_profile`.
    """
    last = len(top) - 1
    gain = np.inf  # the smallest at the waypoints that the step may pass
    for near in range(min(int(np.rint(place)), last), min(int(np.rint(place + rate)), last) + 1):
        gain = min(gain, _max_gain(slope[near], bend[near], brake, brake_share, curve_share, rate))
    given = slope, bend, cap, top, brake, brake_share, curve_share
    fastest = _fastest_between(place, rate, *given)
    if place + fastest < last:
        fastest = min(fastest, max(_fastest_between(place + fastest, rate, *given), min(gain, fastest)))
    elif np.isfinite(gain):  # the last step must brake from this speed to zero
        fastest = min(fastest, max(gain, 0.5 * (last - place + gain)))
    left = last - place
    if not np.isfinite(gain):
        return min(fastest, left)
    least = min(gain, cap[last] if left < 1.0 else fastest)  # the speed falls to zero at the end
    return min(max(min(rate + gain, fastest), rate - gain, least), left)


@subkernel
def _stoppable_step(room: float, brake: float) -> float:
    """Return the largest step from which a joint can still stop within its room; g in `control.limits`."""
    distance = abs(room)
    steps = min(max(np.ceil(np.sqrt(0.25 + distance * (2.0 / brake)) - 0.5), 1.0), MAX_BRAKING_STEPS)
    return float(np.copysign(distance / steps + 0.5 * brake * (steps - 1.0), room))


@compiled
def stoppable_steps(rooms: Array2, brake: Array1, filled: Array2) -> None:
    """Compute `_stoppable_step` for each room, (r, nv), with brakes (nv,); fills (r, nv)."""
    for i in range(len(rooms)):
        for u in range(len(brake)):
            filled[i, u] = _stoppable_step(rooms[i, u], brake[u])


@compiled
def step_box(
    positions: Array1,
    edges: Array2,
    bound: Array1,
    brake: Array1,
    previous: Array1,
    rounding: float,
    columns: Ints1,
    leaning: Array1,
    limits: Array2,
) -> int:
    """Compute the smallest and largest step of each joint; see `Limits.box`.

    Args:
        positions: joint positions, (nv,).
        edges: position limits, (2, nv).
        bound: largest |dq|, (nv,).
        brake: largest change of dq from one step to the next, (nv,); empty for no limit.
        previous: the step before, (nv,); empty without `brake`.
        rounding: tolerance of a limit.
        columns: which of the joints are on the chain, (n,).
        leaning: tolerated excess of each of them over its limits, (n,).
        limits: filled with smallest and largest step, (2, nv).

    Returns:
        Sum of the flags `UNMET_LIMITS` and `OUTSIDE_LIMITS` that apply.
    """
    found = 0
    for u in range(len(positions)):
        low, high = edges[0, u] - positions[u], edges[1, u] - positions[u]
        slowest_point = 0.0
        smallest, largest = low, high
        if len(brake):
            low, high = _stoppable_step(low, brake[u]), _stoppable_step(high, brake[u])
            before = previous[u]
            slowest_point = before - min(max(before, -brake[u]), brake[u])
            smallest = min(max(low, before - brake[u]), before + brake[u])
            largest = min(max(high, before - brake[u]), before + brake[u])
        limits[0, u] = min(max(smallest, -bound[u]), bound[u])
        limits[1, u] = min(max(largest, -bound[u]), bound[u])
        above = min(high, bound[u]) - max(slowest_point, 0.0)
        below = min(slowest_point, 0.0) - max(low, -bound[u])
        if min(above, below) < -rounding:
            found = UNMET_LIMITS
    for i in range(len(columns)):
        u = columns[i]
        if positions[u] < edges[0, u] - leaning[i] or positions[u] > edges[1, u] + leaning[i]:
            return found + OUTSIDE_LIMITS
    return found


@compiled
def shorten_step(
    dq: Array1,
    positions: Array1,
    edges: Array2,
    bound: Array1,
    brake: Array1,
    previous: Array1,
    cut: Array1,
    clipped: Flags1,
) -> float:
    """Scale a step to the step limit, then clip it; see `Limits.apply`.

    `dq` (nv,) is the requested step. Filled are `cut` (nv,) with the clipped step and `clipped` (nv,) with
    which joints were clipped. Other arguments are as for `step_box`.

    Returns:
        Factor by which the whole step was scaled.
    """
    most = 1.0
    for u in range(len(dq)):
        most = max(most, abs(dq[u]) / bound[u])
    scale = 1.0 / most
    for u in range(len(dq)):
        low, high = edges[0, u] - positions[u], edges[1, u] - positions[u]
        if len(brake):
            low, high = _stoppable_step(low, brake[u]), _stoppable_step(high, brake[u])
        scaled = dq[u] * scale
        cut[u] = min(max(min(max(scaled, low), high), -bound[u]), bound[u])
        clipped[u] = cut[u] != scaled
        if len(brake):
            near, far = previous[u] - brake[u], previous[u] + brake[u]
            low = min(max(min(max(low, near), far), -bound[u]), bound[u])
            high = min(max(min(max(high, near), far), -bound[u]), bound[u])
            goal = abs(_stoppable_step(dq[u], brake[u]))
            cut[u] = min(max(min(max(scaled, -goal), goal), low), high)
    return scale


# Steps along a path.


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
