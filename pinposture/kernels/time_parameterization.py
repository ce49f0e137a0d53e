"""How fast a path can be followed within limits of speed and acceleration, and braking in discrete time."""

from __future__ import annotations

import numpy as np

from pinposture.kernels.arrays import Array1, Array2, Array3, Flags1, Ints1
from pinposture.kernels.compiled import compiled, subkernel
from pinposture.kernels.spline import CLOSE, NEWTON, speed

# How fast a way can be gone along within limits of speed and acceleration, at each of its waypoints.

PASSED = 10  # waypoints that a step passes, at most, where limits hold it back


@subkernel
def _gain(slope: Array1, bend: Array1, brake: Array1, planned: float, curved: float, pace: float) -> float:
    """The most that the pace may change from one step to the next at a waypoint."""
    most = np.inf
    for joint in range(len(slope)):
        left = planned * brake[joint]
        left = max(left - bend[joint] * pace**2, (1.0 - curved) * left)
        most = min(most, left / slope[joint])
    return most


@subkernel
def _around(values: Array2, reach: int, least: float, wide: Array2) -> None:
    """The largest of each absolute value and its neighbours along the way, or the least that counts."""
    for i in range(len(values)):
        first, last = max(i - reach, 0), min(i + reach + 1, len(values))
        for joint in range(values.shape[1]):
            most = least
            for near in range(first, last):
                most = max(most, abs(values[near, joint]))
            wide[i, joint] = most


@subkernel
def _differences(values: Array2, slopes: Array2) -> None:
    """How rows change from one to the next: in the middle of both neighbours, at the ends to the one."""
    last = len(values) - 1
    for i in range(len(values)):
        low, high = max(i - 1, 0), min(i + 1, last)
        for joint in range(values.shape[1]):
            slopes[i, joint] = (values[high, joint] - values[low, joint]) / (high - low)


@subkernel
def _fastest(
    slope: Array2,
    bend: Array2,
    bound: Array1,
    brake: Array1,
    begin: float,
    most: float,
    speed: float,
    planned: float,
    curved: float,
    cap: Array1,
    top: Array1,
) -> None:
    """The pace of `find_speed_profile`, from how steep and how bent the way is."""
    count, joints = slope.shape
    stops = False
    for joint in range(joints):
        stops = stops or np.isfinite(brake[joint])
    for i in range(count):
        top[i] = min(most, float(count))
        for joint in range(joints):
            top[i] = min(top[i], speed * bound[joint] / slope[i, joint])
            top[i] = min(top[i], np.sqrt(curved * planned * brake[joint] / bend[i, joint]))
        cap[i] = top[i]
    if stops:
        top[count - 1] = 0.0
        top[0] = min(top[0], max(begin, _gain(slope[0], bend[0], brake, planned, curved, 0.0)))
    for i in range(count - 2, -1, -1):
        here = _gain(slope[i], bend[i], brake, planned, curved, top[i])
        gain = min(here, _gain(slope[i + 1], bend[i + 1], brake, planned, curved, top[i + 1]))
        top[i] = min(top[i], np.sqrt(top[i + 1] ** 2 + 2.0 * gain))
    for i in range(1, count):
        here = _gain(slope[i], bend[i], brake, planned, curved, top[i])
        gain = min(here, _gain(slope[i - 1], bend[i - 1], brake, planned, curved, top[i - 1]))
        top[i] = min(top[i], np.sqrt(top[i - 1] ** 2 + 2.0 * gain))


@compiled
def find_speed_profile(
    offsets: Array2,
    bound: Array1,
    brake: Array1,
    begin: float,
    most: float,
    speed: float,
    planned: float,
    curved: float,
    small: float,
    slope: Array2,
    bend: Array2,
    cap: Array1,
    top: Array1,
) -> None:
    """The fastest pace at each waypoint that still meets all slower places ahead, and the end.

    See `control.planner.path`, where it is derived.

    Args:
        offsets: displacement of each waypoint from the first, (N + 1, nv), N > 0.
        bound: largest step of each joint, (nv,); may be infinite.
        brake: the most that a step may differ from the one before, (nv,), > 0; may be infinite.
        begin: waypoints that the step before the first one went.
        most: the most waypoints to go in one step; may be infinite.
        speed: share of the bounds that is planned with.
        planned: share of the brakes that is planned with.
        curved: share of that, at most, for curves.
        small: slope of a way that is none, relative to the largest.
        slope: filled with how fast each joint moves there at most, (N + 1, nv).
        bend: filled with how fast that changes at most, (N + 1, nv).
        cap: filled with the pace that speeds and curves there allow, (N + 1,) [waypoints per step].
        top: filled with the pace in waypoints per step, (N + 1,).
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
        _around(slopes, reach, tiny, slope)
        _around(bends, reach, tiny, bend)
        _fastest(slope, bend, bound, brake, begin, most, speed, planned, curved, cap, top)
        # A step that passes many waypoints has to bear what is at all of them.
        passed = min(int(np.ceil(top.max())), PASSED) if np.isfinite(most) else 1
        if passed <= reach:
            break
        reach = passed


@subkernel
def _fastest_at(
    place: float,
    pace: float,
    slope: Array2,
    bend: Array2,
    cap: Array1,
    top: Array1,
    brake: Array1,
    planned: float,
    curved: float,
) -> float:
    """The fastest pace between two waypoints: what is left of both, gained or lost on the way."""
    at = min(int(place), len(top) - 2)
    share = min(place - at, 1.0)
    gain = _gain(slope[at], bend[at], brake, planned, curved, pace)
    gain = min(gain, _gain(slope[at + 1], bend[at + 1], brake, planned, curved, pace))
    most = min(cap[at], cap[at + 1])
    if not np.isfinite(gain):
        return most
    most = min(most, np.sqrt(top[at] ** 2 + 2.0 * gain * share))
    return min(most, np.sqrt(top[at + 1] ** 2 + 2.0 * gain * (1.0 - share)))


@compiled
def next_path_speed(
    place: float,
    pace: float,
    slope: Array2,
    bend: Array2,
    cap: Array1,
    top: Array1,
    brake: Array1,
    planned: float,
    curved: float,
) -> float:
    """Waypoints to go in a step.

    Args:
        place: where it begins, in waypoints from the start.
        pace: waypoints that the step before went.
        slope: of `find_speed_profile`.
        bend: of `find_speed_profile`.
        cap: of `find_speed_profile`.
        top: of `find_speed_profile`.
        brake: as for `find_speed_profile`.
        planned: see there.
        curved: see there.
    """
    last = len(top) - 1
    gain = np.inf  # at the slowest of the waypoints that the step may pass
    for near in range(min(int(np.rint(place)), last), min(int(np.rint(place + pace)), last) + 1):
        gain = min(gain, _gain(slope[near], bend[near], brake, planned, curved, pace))
    given = slope, bend, cap, top, brake, planned, curved
    fastest = _fastest_at(place, pace, *given)
    if place + fastest < last:
        fastest = min(fastest, max(_fastest_at(place + fastest, pace, *given), min(gain, fastest)))
    elif np.isfinite(gain):  # from the pace at which it gets there it has to stop at once
        fastest = min(fastest, max(gain, 0.5 * (last - place + gain)))
    left = last - place
    if not np.isfinite(gain):
        return min(fastest, left)
    least = min(gain, cap[last] if left < 1.0 else fastest)  # the pace falls to nothing at the end
    return min(max(min(pace + gain, fastest), pace - gain, least), left)


# How far joints may go in one step: braking in discrete time, as `control.limits` derives it.

MOST = 1e60
"""Number of braking steps that counts as any number: a joint without position limits has that many."""

SHORT, OUTSIDE = 1, 2
"""What `step_box` returns, added up: limits that cannot be kept; a joint of the chain outside its limits."""


@subkernel
def _farthest(room: float, brake: float) -> float:
    """The largest step towards a place at which a joint can still stop; g in `control.limits`."""
    distance = abs(room)
    steps = min(max(np.ceil(np.sqrt(0.25 + distance * (2.0 / brake)) - 0.5), 1.0), MOST)
    return float(np.copysign(distance / steps + 0.5 * brake * (steps - 1.0), room))


@compiled
def stoppable_steps(rooms: Array2, brake: Array1, filled: Array2) -> None:
    """`_farthest` for each room, (r, nv), with brakes (nv,); fills (r, nv)."""
    for i in range(len(rooms)):
        for u in range(len(brake)):
            filled[i, u] = _farthest(rooms[i, u], brake[u])


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
    """The steps that each joint may take; see `Limits.box`.

    Args:
        positions: joint positions, (nv,).
        edges: positions to stay between, (2, nv).
        bound: largest |dq|, (nv,).
        brake: largest change of dq from one step to the next, (nv,); empty: any.
        previous: the step before, (nv,); empty where it does not matter.
        rounding: what a limit may be exceeded by.
        columns: which of the joints are on the chain, (n,).
        leaning: how far each of them may be outside its limits, (n,).
        limits: filled with smallest and largest step, (2, nv).

    Returns:
        Sum of `SHORT` and `OUTSIDE`, where they are so.
    """
    found = 0
    for u in range(len(positions)):
        low, high = edges[0, u] - positions[u], edges[1, u] - positions[u]
        slowest = 0.0
        smallest, largest = low, high
        if len(brake):
            low, high = _farthest(low, brake[u]), _farthest(high, brake[u])
            before = previous[u]
            slowest = before - min(max(before, -brake[u]), brake[u])
            smallest = min(max(low, before - brake[u]), before + brake[u])
            largest = min(max(high, before - brake[u]), before + brake[u])
        limits[0, u] = min(max(smallest, -bound[u]), bound[u])
        limits[1, u] = min(max(largest, -bound[u]), bound[u])
        above = min(high, bound[u]) - max(slowest, 0.0)
        below = min(slowest, 0.0) - max(low, -bound[u])
        if min(above, below) < -rounding:
            found = SHORT
    for i in range(len(columns)):
        u = columns[i]
        if positions[u] < edges[0, u] - leaning[i] or positions[u] > edges[1, u] + leaning[i]:
            return found + OUTSIDE
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
    """Shorten a step until it meets the step limit, then cut it; see `Limits.apply`.

    Args:
        dq: the step asked for, (nv,).
        positions: as above.
        edges: as above.
        bound: as above.
        brake: as above.
        previous: as above.
        cut: filled with what is left of it, (nv,).
        clipped: filled with which joints were cut short, (nv,).

    Returns:
        By which factor the whole step was shortened.
    """
    most = 1.0
    for u in range(len(dq)):
        most = max(most, abs(dq[u]) / bound[u])
    scale = 1.0 / most
    for u in range(len(dq)):
        low, high = edges[0, u] - positions[u], edges[1, u] - positions[u]
        if len(brake):
            low, high = _farthest(low, brake[u]), _farthest(high, brake[u])
        scaled = dq[u] * scale
        cut[u] = min(max(min(max(scaled, low), high), -bound[u]), bound[u])
        clipped[u] = cut[u] != scaled
        if len(brake):
            near, far = previous[u] - brake[u], previous[u] + brake[u]
            low = min(max(min(max(low, near), far), -bound[u]), bound[u])
            high = min(max(min(max(high, near), far), -bound[u]), bound[u])
            goal = abs(_farthest(dq[u], brake[u]))
            cut[u] = min(max(min(max(scaled, -goal), goal), low), high)
    return scale


# Where the speed of a B-spline vanishes.

SAMPLES = 9  # places in a span where the speed is looked at
STILL = 1e-6  # of the largest speed in its span: a speed that vanishes


@subkernel
def half_square_slope(taylor: Array2, degree: int, x: float) -> tuple[float, float]:
    """First derivative by x of half the squared speed of an expanded velocity, and the second one."""
    value, slope = 0.0, 0.0
    for axis in range(3):
        v, dv, ddv = taylor[degree - 1, axis], 0.0, 0.0
        for p in range(degree - 2, -1, -1):
            ddv = ddv * x + 2.0 * dv
            dv = dv * x + v
            v = v * x + taylor[p, axis]
        value += v * dv
        slope += dv * dv + v * ddv
    return value, slope


@subkernel
def slowest(taylor: Array2, degree: int, low: float, high: float) -> float:
    """The x between two others where an expanded velocity is least, if its slope says so there; else NaN."""
    falls, rises = half_square_slope(taylor, degree, low)[0], half_square_slope(taylor, degree, high)[0]
    if not (falls < 0.0 and rises > 0.0):
        return np.nan
    x, width = 0.5 * (low + high), high - low
    for _ in range(NEWTON):
        value, slope = half_square_slope(taylor, degree, x)
        low, high = x if value <= 0.0 else low, x if value >= 0.0 else high
        trial = x - value / slope
        if not (slope > 0.0 and low <= trial <= high):
            trial = 0.5 * (low + high)
        step = abs(trial - x)
        x = trial
        if step <= CLOSE * width:
            break
    return x


@compiled
def find_stationary_point(taylors: Array3, breaks: Array1) -> float:
    """Find a parameter at which the curve stands still.

    Args:
        taylors: of `arclength.expand_spans`, (k, degree, 3).
        breaks: ends of the knot spans, increasing, (k + 1,).

    Returns:
        The parameter; NaN if it moves on everywhere.
    """
    spans, degree, last = len(taylors), taylors.shape[1], SAMPLES - 1
    v, fastest, overall = np.empty((spans, SAMPLES)), np.zeros(spans), 0.0
    for i in range(spans):
        for j in range(SAMPLES):
            v[i, j] = speed(taylors[i], degree, 2.0 * j / last - 1.0)
            fastest[i] = max(fastest[i], v[i, j])
        overall = max(overall, fastest[i])
    for i in range(spans):
        if fastest[i] <= 1e-9 * overall:
            return float(breaks[i])
    # The least speed lies beside a sample that is slower than its neighbours. Next to a cusp one is far
    # slower than the fastest; on a circle they are equal but for rounding, and not worth a search.
    for i in range(spans):
        for j in range(SAMPLES):
            before, after = max(j - 1, 0), min(j + 1, last)
            if v[i, j] <= min(v[i, before], v[i, after]) and v[i, j] < 0.9 * fastest[i]:
                x = slowest(taylors[i], degree, 2.0 * before / last - 1.0, 2.0 * after / last - 1.0)
                if speed(taylors[i], degree, x) <= STILL * fastest[i]:  # not so if NaN
                    return float(0.5 * ((1.0 - x) * breaks[i] + (1.0 + x) * breaks[i + 1]))
    for i in range(spans):
        if v[i, 0] <= STILL * fastest[i]:
            return float(breaks[i])
    for i in range(spans):
        if v[i, last] <= STILL * fastest[i]:
            return float(np.nextafter(breaks[i + 1], breaks[i]))
    return np.nan
