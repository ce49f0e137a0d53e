"""How fast a way can be gone along within limits of speed and acceleration, at each of its waypoints."""

from __future__ import annotations

import numpy as np

from pinposture.kernels.arrays import Array1, Array2
from pinposture.kernels.compiled import compiled, subkernel

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
    """The pace of `find_pace`, from how steep and how bent the way is."""
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
def find_pace(
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

    See `control.constrained.pace`, where it is derived.

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
def next_pace(
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
        slope: of `find_pace`.
        bend: of `find_pace`.
        cap: of `find_pace`.
        top: of `find_pace`.
        brake: as for `find_pace`.
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
