"""Path following: time-optimal speed within velocity and acceleration limits, braking, and steps."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from pinposture.kernels.arrays import (
    FULL_TURN,
    TORQUE_LANES,
    ArmArrays,
    Array1,
    Array2,
    Array3,
    Flags1,
    Ints1,
    LimitArrays,
    NextSteps,
    PathMotion,
    PathParts,
    PathTolerances,
    PointGoals,
    ProfileRows,
    StepArrays,
    TimedPathArrays,
    TorqueSamples,
)
from pinposture.kernels.compiled import compiled, inlined, subkernel
from pinposture.kernels.dynamics import get, path_torques, put, scale
from pinposture.kernels.kinematics import placements


class PathSpeedSettings(NamedTuple):
    """Settings of the speed along a path and of the return to it."""

    catch_up_share: float = 0.25
    """Share of the acceleration limit that is used to make up a lag. In ten runs each of 10 and 40 joints,
    pushed aside ten times, half of it changed the speed by 15 % less in all, but took up to 4 % more steps;
    twice of it changed the speed by 15 % more, and saved 0.4 % of the steps at most."""

    least_gain: float = 0.2
    """Share of the largest change of speed from rest that is allowed at any speed, so that an arm off the
    profile can change its speed where the curvature of the path uses up the limit. Half or twice of it
    changed none of these runs."""

    sampled_turn: float = 3.0
    """Joint motion between samples of torques, the sum over joints, in `Arm.joint_units`."""

    least_samples: int = 8
    """Least number of these samples on a path. All waypoints are samples, as the bends of a path may
    change there. Of 120 paths of 40 and 100 joints no step takes over 0.1 % more torque than with four
    times as many."""

    effort_share: float = 0.97
    """Share of what holding the arm leaves of the torque limits that a profile uses. With 0.98 some steps of
    `benchmarks.peers.durations` took 0.2 % more than the limit; motions were 0.3 % shorter in the
    median. With a share of the whole torque limit they were 1.2 % longer, and up to 3 %, where holding
    takes most of it."""

    least_extra: float = 0.002
    """Torque that motions may take in any case, relative to that which holds the arm."""

    never_binding: float = 0.5
    """Share of a torque limit that counts as none if no motion on a path within limits of velocity and
    acceleration takes more. What is left of it is far more than torques differ between samples."""

    iterations: int = 60
    """Largest number of iterations for the speed at a position."""

    rounding: float = 1e-12
    """Relative rounding error of accelerations there."""

    step_rounding: float = 1e-12
    """Rounding error of a step, in units of each joint."""

    most_braking_steps: float = 1e60
    """Number of braking steps that stands for infinitely many: a joint without position limits."""


PATH_SPEED = PathSpeedSettings()


# The curve through the waypoints of a path.


@subkernel
def spline_bends(x: Array2) -> Array2:
    """Return the second derivatives of natural cubic splines through waypoints x, (N + 1, n) each."""
    last = len(x) - 1
    n = x.shape[1]
    bends = np.zeros((last + 1, n))
    pivots = np.zeros(last + 1)
    for i in range(1, last):  # bends[i - 1] + 4 bends[i] + bends[i + 1] = 6 (x[i - 1] - 2 x[i] + x[i + 1])
        pivots[i] = 1.0 / (4.0 - pivots[i - 1])
        for u in range(n):
            curved = 6.0 * (x[i - 1, u] - 2.0 * x[i, u] + x[i + 1, u])
            bends[i, u] = (curved - bends[i - 1, u]) * pivots[i]
    for i in range(last - 1, 0, -1):
        for u in range(n):
            bends[i, u] -= pivots[i] * bends[i + 1, u]
    return bends


@compiled
def spline_slopes(x: Array2, slopes: Array2) -> None:
    """Fill in the slopes of natural cubic splines at their waypoints, for each joint.

    Args:
        x: waypoints, (N + 1, n), N > 0.
        slopes: change per waypoint, (N + 1, n).
    """
    last = len(x) - 1
    bends = spline_bends(x)
    for i in range(last):
        for u in range(x.shape[1]):
            slopes[i, u] = x[i + 1, u] - x[i, u] - (2.0 * bends[i, u] + bends[i + 1, u]) / 6.0
    slopes[last] = x[last] - x[last - 1] + bends[last - 1] / 6.0


# Time-optimal path speed. Between two waypoints the path is a cubic curve, divided into parts of length h, on
# which the path acceleration u is constant, so that x = speed^2 is linear: x' = x + 2 h u. The joint
# acceleration f = q'(s) u + q''(s) x(s) is quadratic there, and within a limit if its three Bernstein
# coefficients are: f at both ends, and 2 f(middle) - (f(start) + f(end)) / 2. All have the form a u + b x.
# So have torques, of which gravity takes c. They are not quadratic, but close to it in a part.


@inlined
def _part_length(parts: PathParts, part: int) -> float:
    """Return the length of a part [waypoints]."""
    piece = parts.piece[part]
    return 1.0 / (parts.first[piece + 1] - parts.first[piece])


@inlined
def _part_at(parts: PathParts, s: float) -> float:
    """Return a position on a path, in waypoints, in parts from the start."""
    piece = min(int(s), len(parts.first) - 2)
    count = parts.first[piece + 1] - parts.first[piece]
    return s * count - piece * count + parts.first[piece]  # where all are alike, no rounding is added


@inlined
def _s_at(parts: PathParts, at: float, part: int) -> float:
    """Return a position in or at the end of a part, in parts from the start of the path, in waypoints."""
    piece = parts.piece[part]
    count = parts.first[piece + 1] - parts.first[piece]
    return (at - parts.first[piece] + piece * count) / count


@subkernel
def _find_rows(
    offsets: Array2, slopes: Array2, parts: PathParts, a: Array3, b: Array3, steepest: Array2
) -> None:
    """Fill in a and b of the joints, (K, 3, nv or more), and the largest |q'| of each part, (K, nv)."""
    for i in range(len(offsets) - 1):
        count = parts.first[i + 1] - parts.first[i]
        h = 1.0 / count
        for part in range(count):
            at = parts.first[i] + part
            s = part * h
            for j in range(offsets.shape[1]):
                one = slopes[i, j]
                other = slopes[i + 1, j]
                whole = offsets[i + 1, j] - offsets[i, j]
                cubic = one + other - 2.0 * whole
                square = 3.0 * whole - 2.0 * one - other
                slope_start = one + s * (2.0 * square + s * 3.0 * cubic)
                bend_start = 2.0 * square + 6.0 * cubic * s
                jerk = 6.0 * cubic
                slope_middle = slope_start + 0.5 * h * (bend_start + 0.25 * h * jerk)
                slope_end = slope_start + h * (bend_start + 0.5 * h * jerk)
                bend_middle = bend_start + 0.5 * h * jerk
                bend_end = bend_start + h * jerk
                a[at, 0, j] = slope_start
                b[at, 0, j] = bend_start
                a[at, 2, j] = slope_end + 2.0 * h * bend_end
                b[at, 2, j] = bend_end
                a_middle = slope_middle + h * bend_middle
                a[at, 1, j] = 2.0 * a_middle - 0.5 * (a[at, 0, j] + a[at, 2, j])
                b[at, 1, j] = 2.0 * bend_middle - 0.5 * (bend_start + bend_end)
                between = abs(2.0 * slope_middle - 0.5 * (slope_start + slope_end))
                steepest[at, j] = max(abs(slope_start), abs(slope_end), between)


@subkernel
def _find_binding(
    offsets: Array2,
    slopes: Array2,
    samples: TorqueSamples,
    bound: Array1,
    brake: Array1,
    limit: Array1,
    binding: Ints1,
) -> int:
    """Find the joints whose torques may come near their limits within those of velocity and acceleration.

    Args:
        offsets: displacement of each waypoint from the first, (N + 1, nv).
        slopes: change of it per waypoint, (N + 1, nv).
        samples: torques at equidistant positions.
        bound: largest step of each joint, (nv,).
        brake: largest change of it between steps, (nv,).
        limit: the torque limits, (nv,).
        binding: filled with these joints, (nv,).

    Returns:
        Their number.
    """
    pieces = len(offsets) - 1
    last = len(samples.a) - 1
    joints = len(limit)
    largest = np.zeros(joints)
    slope = np.empty(joints)
    bend = np.empty(joints)
    share = np.empty(joints)
    per_bound = 1.0 / bound
    per_brake = 1.0 / brake
    for k in range(last + 1):
        i = min(k * pieces // last, pieces - 1)
        t = k * pieces / last - i
        for j in range(joints):
            whole = offsets[i + 1, j] - offsets[i, j]
            cubic = slopes[i, j] + slopes[i + 1, j] - 2.0 * whole
            square = whole - slopes[i, j] - cubic
            slope[j] = abs(slopes[i, j] + t * (2.0 * square + t * 3.0 * cubic))
            bend[j] = abs(2.0 * square + 6.0 * t * cubic) * per_brake[j]
            share[j] = slope[j] * per_bound[j]
            slope[j] *= per_brake[j]
        most = 1.0 / len(offsets)
        steepest = 0.0
        sharpest = 0.0
        for j in range(joints):
            most = max(most, share[j])
            steepest = max(steepest, slope[j])
            sharpest = max(sharpest, bend[j])
        x = 1.0 / most**2
        u = (1.0 + sharpest * x) / max(steepest, 1e-100)  # as the steepest joint allows, or more
        for j in range(joints):
            torque = abs(samples.a[k, j]) * u + abs(samples.b[k, j]) * x + abs(samples.c[k, j])
            largest[j] = max(largest[j], torque)
    count = 0
    for j in range(joints):
        if largest[j] > PATH_SPEED.never_binding * limit[j]:
            binding[count] = j
            count += 1
    return count


@inlined
def _between(samples: Array3, block: int, s: float, row: Array1, at: int) -> None:
    """Interpolate a block of (s, B, n) samples by a cubic polynomial at a position in [0, s - 1].

    `row` is filled from `at` on.
    """
    before = min(max(int(s) - 1, 0), len(samples) - 4)
    t = s - before
    w0 = (t - 1.0) * (t - 2.0) * (t - 3.0) * (-1.0 / 6.0)
    w1 = t * (t - 2.0) * (t - 3.0) * 0.5
    w2 = t * (t - 1.0) * (t - 3.0) * -0.5
    w3 = t * (t - 1.0) * (t - 2.0) * (1.0 / 6.0)
    one = samples[before, block]
    two = samples[before + 1, block]
    three = samples[before + 2, block]
    four = samples[before + 3, block]
    for w in range(3 * TORQUE_LANES):
        row[at + w] = w0 * one[w] + w1 * two[w] + w2 * three[w] + w3 * four[w]


@inlined
def _combine(row: Array1, h: float) -> None:
    """Fill in the rows of a block of torques in a part of length h.

    Args:
        row: `TORQUE_LANES` numbers each: the limits; a, b and c at the start, in the middle and at the end of
            the part. Then come three rows of a, of b and of c, which are filled in.
        h: the length.
    """
    for w in range(TORQUE_LANES):
        limit = row[w]
        a0, b0, c0 = get(row, 1, TORQUE_LANES, w)
        a1, b1, c1 = get(row, 4, TORQUE_LANES, w)
        a2, b2, c2 = get(row, 7, TORQUE_LANES, w)
        a1 += h * b1  # x has changed by 2 s u after a distance s
        a2 += 2.0 * h * b2
        c1 = 2.0 * c1 - 0.5 * (c0 + c2)
        # Motions may take their share of what holding the arm leaves, and always a little.
        held = max(abs(c0), abs(c1), abs(c2))
        allowed = min(PATH_SPEED.effort_share * limit + (1.0 - PATH_SPEED.effort_share) * held, limit)
        allowed = max(allowed, (1.0 + PATH_SPEED.least_extra) * held)
        factor = limit / allowed
        put(row, 10, TORQUE_LANES, w, scale((a0, 2.0 * a1 - 0.5 * (a0 + a2), a2), factor))
        put(row, 13, TORQUE_LANES, w, scale((b0, 2.0 * b1 - 0.5 * (b0 + b2), b2), factor))
        put(row, 16, TORQUE_LANES, w, scale((c0, c1, c2), factor))


@compiled
def fill_torque_rows(
    indices: Ints1,
    numbers: Array1,
    offsets: Array2,
    slopes: Array2,
    start: Array1,
    dt: float,
    joint_limits: Array2,
    parts: PathParts,
    room: Array1,
    limits: Array1,
    held: Array1,
) -> tuple[int, int]:
    """Fill in the rows of torques that may come near their limits, by cubic interpolation between samples.

    Args:
        indices: as for `path_torques`.
        numbers: likewise.
        offsets: displacement of each waypoint from the first, (N + 1, nv), N > 0.
        slopes: change of it per waypoint, (N + 1, nv).
        start: joint positions at the start, (nv,).
        dt: duration of a step.
        joint_limits: of each joint the unit of motion, the largest step, its largest change between steps,
            and the torque limit, (4, nv).
        parts: the parts of the path.
        room: for the rows of K parts, (9 K (2 nv + `TORQUE_LANES`),). Its beginning is filled with a, b and
            c, but for a and b of accelerations, which `find_speed_profile` fills in. Torques come after them.
        limits: filled with the limits of all rows, (2 nv,).
        held: filled with the largest torque of each joint that holds the arm, (nv,).

    Returns:
        Number of limits, and of rows for which a, b and c have room in each part.
    """
    joints = len(start)
    pieces = len(offsets) - 1
    units = joint_limits[0]
    bound = joint_limits[1]
    brake = joint_limits[2]
    limit = joint_limits[3]
    per_unit = 1.0 / units
    farthest = 0.0
    turns = 0.0
    for i in range(pieces):
        turn = 0.0
        for j in range(joints):
            moved = abs(offsets[i + 1, j] - offsets[i, j])
            farthest = max(farthest, moved)
            turn += moved * per_unit[j]
        turns = max(turns, turn)
    last = pieces * max(int(np.ceil(turns / PATH_SPEED.sampled_turn)), 1)
    last = max(last, PATH_SPEED.least_samples)
    shape = (last + 1, joints)
    samples = TorqueSamples(np.empty(shape), np.empty(shape), np.empty(shape))
    path_torques(indices, numbers, offsets, slopes, start, dt, samples)
    held[:] = 0.0
    hardest = np.zeros(joints)
    for k in range(last + 1):
        for j in range(joints):
            held[j] = max(held[j], abs(samples.c[k, j]))
            hardest[j] = max(hardest[j], abs(samples.a[k, j]))
    factor = farthest / max(hardest.max(), 1e-300)  # to the scale of accelerations
    binding = np.empty(joints, dtype=np.int64)
    count = _find_binding(offsets, slopes, samples, bound, brake, limit, binding)
    blocks = (count + TORQUE_LANES - 1) // TORQUE_LANES
    packed = np.zeros((last + 1, blocks, 3 * TORQUE_LANES))
    work = np.ones((blocks, 19 * TORQUE_LANES))
    width = joints + blocks * TORQUE_LANES
    every = room[: 9 * len(parts.piece) * width].reshape((3, len(parts.piece), 3, width))
    a = every[0]
    b = every[1]
    c = every[2]
    limits[:joints] = brake
    for i in range(count):
        j = binding[i]
        block = i // TORQUE_LANES
        w = i % TORQUE_LANES
        work[block, w] = limits[joints + i] = factor * limit[j]
        for k in range(last + 1):
            packed[k, block, w] = factor * samples.a[k, j]
            packed[k, block, TORQUE_LANES + w] = factor * samples.b[k, j]
            packed[k, block, 2 * TORQUE_LANES + w] = factor * samples.c[k, j]
    for block in range(blocks):
        _between(packed, block, 0.0, work[block], 7 * TORQUE_LANES)
    per_piece = last / pieces
    for k in range(len(parts.piece)):
        piece = parts.piece[k]
        h = 1.0 / (parts.first[piece + 1] - parts.first[piece])
        part = k - parts.first[piece]
        c[k, :, :joints] = 0.0
        for block in range(blocks):
            row = work[block]
            for w in range(3 * TORQUE_LANES):
                row[TORQUE_LANES + w] = row[7 * TORQUE_LANES + w]
            _between(packed, block, (piece + (part + 0.5) * h) * per_piece, row, 4 * TORQUE_LANES)
            _between(packed, block, (piece + (part + 1.0) * h) * per_piece, row, 7 * TORQUE_LANES)
            _combine(row, h)
            at = joints + block * TORQUE_LANES
            for i in range(3):
                for w in range(TORQUE_LANES):
                    a[k, i, at + w] = row[(10 + i) * TORQUE_LANES + w]
                for w in range(TORQUE_LANES):
                    b[k, i, at + w] = row[(13 + i) * TORQUE_LANES + w]
                for w in range(TORQUE_LANES):
                    c[k, i, at + w] = row[(16 + i) * TORQUE_LANES + w]
    return joints + count, width


@subkernel
def _acceleration_range(
    rows: ProfileRows, begin: int, stop: int, part: int, tiny: float, x: float
) -> tuple[float, float, float, float]:
    """Return the range of u in which |a u + b x + c| <= limit, and the derivatives of its ends by x.

    The quantities from `begin` to `stop` count.
    """
    low = -np.inf
    high = np.inf
    low_slope = 0.0
    high_slope = 0.0
    for row in range(3):
        for j in range(np.uintp(begin), np.uintp(stop)):
            a = rows.a[part, row, j]
            if abs(a) <= tiny or rows.limit[j] == np.inf:
                continue
            b = rows.b[part, row, j]
            inverse = 1.0 / a  # one division takes as long as all the rest
            middle = -(b * x + rows.c[part, row, j]) * inverse
            reach = rows.limit[j] * abs(inverse)
            if middle + reach < high:
                high = middle + reach
                high_slope = -b * inverse
            if middle - reach > low:
                low = middle - reach
                low_slope = -b * inverse
    return low, high, low_slope, high_slope


@inlined
def _are_kept(rows: ProfileRows, begin: int, part: int, u: float, x: float) -> bool:
    """Check whether the quantities from `begin` on are within their limits."""
    exceeded = 0
    for row in range(3):
        for j in range(np.uintp(begin), np.uintp(len(rows.limit))):
            value = rows.a[part, row, j] * u + rows.b[part, row, j] * x + rows.c[part, row, j]
            exceeded += abs(value) > (1.0 + PATH_SPEED.rounding) * rows.limit[j]
    return exceeded == 0


@subkernel
def _fastest_start(
    rows: ProfileRows,
    begin: int,
    stop: int,
    part: int,
    tiny: float,
    h: float,
    most: float,
    after: float,
) -> tuple[float, float]:
    """Return the largest x, up to `most`, from which a part of length h can be followed to an x of `after`.

    The quantities from `begin` to `stop` count. The second value is the largest u at that x.
    """
    x = most
    for row in range(3):
        for j in range(np.uintp(begin), np.uintp(stop)):
            if abs(rows.a[part, row, j]) <= tiny:
                b = rows.b[part, row, j]
                room = rows.limit[j] - np.copysign(1.0, b) * rows.c[part, row, j]
                if abs(b) * x > room:
                    x = max(room, 0.0) / abs(b)
    for _ in range(PATH_SPEED.iterations):  # Newton's method on a convex function
        low, high, low_slope, high_slope = _acceleration_range(rows, begin, stop, part, tiny, x)
        if (after - x) / (2.0 * h) < high:
            high = (after - x) / (2.0 * h)
            high_slope = -0.5 / h
        if -x / (2.0 * h) > low:
            low = -x / (2.0 * h)
            low_slope = -0.5 / h
        excess = low - high
        if excess <= PATH_SPEED.rounding * (abs(low) + abs(high) + x / h):  # both may be nearly zero
            return x, high
        fall = low_slope - high_slope
        if fall <= 0.0:
            break
        x -= excess / fall
        if x <= 0.0:
            break
    return 0.0, 0.0


@compiled
def find_speed_profile(
    offsets: Array2,
    slopes: Array2,
    bound: Array1,
    start_speed: float,
    most: Array1,
    small: float,
    parts: PathParts,
    rows: ProfileRows,
    top: Array1,
) -> None:
    """Compute the largest path speed from which all limits ahead can be kept, up to rest at the end.

    Args:
        offsets: displacement of each waypoint from the first, (N + 1, nv), N > 0.
        slopes: change of it per waypoint, (N + 1, nv).
        bound: largest step of each joint, (nv,); may be infinite.
        start_speed: number of waypoints in the step before the first one.
        most: largest number of waypoints of one step between two of them, (N,); may be infinite.
        small: slope that counts as zero, relative to the largest.
        parts: the parts of the path.
        rows: their limits. Filled are a and b of the joints, from the start, the middle and the end of each
            part; those of torques are given.
        top: filled with the speed where they begin, and at the end, (K + 1,) [waypoints per step].
    """
    count = len(rows.a)
    joints = offsets.shape[1]
    every = len(rows.limit)
    tiny = 1e-100
    steepest = np.empty((count, joints))
    _find_rows(offsets, slopes, parts, rows.a, rows.b, steepest)
    for i in range(count):
        for j in range(joints):
            tiny = max(tiny, small * steepest[i, j])
    top[:] = float(len(offsets)) ** 2
    for i in range(count):
        fastest = most[parts.piece[i]] ** 2
        top[i] = min(top[i], fastest)
        top[i + 1] = min(top[i + 1], fastest)
        for j in range(joints):
            if steepest[i, j] > tiny:
                fastest = (bound[j] / steepest[i, j]) ** 2
                top[i] = min(top[i], fastest)
                top[i + 1] = min(top[i + 1], fastest)
    begin = joints  # of the quantities that are limited
    for j in range(joints):
        if np.isfinite(rows.limit[j]):
            begin = 0
    stops = begin == 0
    for j in range(joints, every):
        stops = stops or np.isfinite(rows.limit[j])
    if stops:
        loss = -_acceleration_range(rows, begin, every, count - 1, tiny, 0.0)[0]
        if np.sqrt(top[count]) > 0.5 * loss:  # else it can stop at once
            top[count] = 0.0
        gain = _acceleration_range(rows, begin, every, 0, tiny, 0.0)[1]
        # Half a step, before the first half of the next.
        top[0] = min(top[0], (start_speed + 0.5 * gain) ** 2)
        # Torques count only where they exceed their limits without.
        for i in range(count - 1, -1, -1):
            h = _part_length(parts, i)
            x, u = _fastest_start(rows, begin, joints, i, tiny, h, top[i], top[i + 1])
            if every > joints and not _are_kept(rows, joints, i, u, x):
                x, u = _fastest_start(rows, begin, every, i, tiny, h, x, top[i + 1])
            top[i] = x
        for i in range(count):
            h = _part_length(parts, i)
            high = _acceleration_range(rows, begin, joints, i, tiny, top[i])[1]
            reached = min(top[i + 1], max(top[i] + 2.0 * h * high, 0.0))
            if every > joints and not _are_kept(rows, joints, i, (reached - top[i]) / (2.0 * h), top[i]):
                high = _acceleration_range(rows, joints, every, i, tiny, top[i])[1]
                reached = min(reached, max(top[i] + 2.0 * h * high, 0.0))
            top[i + 1] = reached
    for i in range(count + 1):
        top[i] = np.sqrt(top[i])


@subkernel
def _travel(parts: PathParts, s: float, top: Array1, onward: bool) -> float:
    """Return the distance along the profile from a position in the next step, or in the previous one."""
    last = len(top) - 1
    left = 1.0
    at = _part_at(parts, s)
    sign = 1.0 if onward else -1.0
    i = 0
    while left > 0.0:
        i = min(int(at), last - 1) if onward else max(int(np.ceil(at)) - 1, 0)
        piece = parts.piece[i]
        count = parts.first[piece + 1] - parts.first[piece]
        to = i + 1.0 if onward else float(i)
        share = at - i
        squares = (1.0 - share) * top[i] ** 2 + share * top[i + 1] ** 2
        change = top[i + 1] ** 2 - top[i] ** 2
        here = np.sqrt(squares)
        there = top[i + 1] if onward else top[i]
        passed = 2.0 * abs(to - at) / (count * max(here + there, 1e-100))
        if passed > left:
            gain = 0.5 * count * change  # acceleration
            at += sign * count * max(here * left + sign * 0.5 * gain * left**2, 0.0)
            break
        left -= passed
        at = to
        if at >= last or at <= 0.0:
            break
    return abs(_s_at(parts, at, i) - s)


@compiled
def next_path_speed(
    s: float,
    rate: float,
    small: float,
    most: float,
    parts: PathParts,
    rows: ProfileRows,
    top: Array1,
) -> float:
    """Return the number of waypoints to advance in a step from a position, in waypoints from the start.

    `rate` is that number in the previous step, and `most` the largest one. Other arguments are as for
    `find_speed_profile`.
    """
    count = len(rows.a)
    every = len(rows.limit)
    left = len(parts.first) - 1 - s
    wanted = min(_travel(parts, s, top, True), most)
    if s <= 0.0:
        return min(wanted, left)
    # Off the profile, steps change as much as the limits allow at that speed.
    before = _travel(parts, s, top, False)
    tiny = 1e-100
    first = min(int(_part_at(parts, s)), count - 1)
    last = min(int(_part_at(parts, s + wanted)), count - 1)
    for i in range(first, last + 1):
        for j in range(len(rows.limit)):
            tiny = max(tiny, small * abs(rows.a[i, 0, j]))
    gain = np.inf
    loss = np.inf
    for i in range(first, last + 1):
        low, high, _, _ = _acceleration_range(rows, 0, every, i, tiny, rate**2)
        slowest, fastest, _, _ = _acceleration_range(rows, 0, every, i, tiny, 0.0)
        gain = min(gain, max(high, PATH_SPEED.least_gain * fastest))
        loss = min(loss, max(-low, -PATH_SPEED.least_gain * slowest))
    fastest = min(wanted, rate + max(gain, wanted - before))
    return min(max(fastest, min(rate - max(loss, before - wanted), wanted + rate)), left)


@subkernel
def _stoppable_step(room: float, brake: float) -> float:
    """Return the largest step from which a joint can still stop within its room; g in `control.limits`."""
    distance = abs(room)
    steps = max(np.ceil(np.sqrt(0.25 + distance * (2.0 / brake)) - 0.5), 1.0)
    steps = min(steps, PATH_SPEED.most_braking_steps)
    return float(np.copysign(distance / steps + 0.5 * brake * (steps - 1.0), room))


@compiled
def stoppable_steps(rooms: Array2, brake: Array1, filled: Array2) -> None:
    """Compute `_stoppable_step` for each room, (r, nv), with brakes (nv,); fills (r, nv)."""
    for i in range(len(rooms)):
        for u in range(len(brake)):
            filled[i, u] = _stoppable_step(rooms[i, u], brake[u])


@compiled
def stopping_steps(rooms: Array2, dq: Array1, bound: Array1, brake: Array1, most: int) -> Array2:
    """Compute the steps that stop an arm after a step; see `control.limits`.

    Args:
        rooms: displacements to the lower and the upper position limits after that step, (2, nv).
        dq: that step, (nv,).
        bound: largest |dq|, (nv,).
        brake: largest change between steps, (nv,).
        most: largest number of steps in proportion.

    Returns:
        The steps, (k, nv).
    """
    nv = len(dq)
    low = rooms[0].copy()
    high = rooms[1].copy()
    moving = dq.copy()
    steps = np.empty((64, nv))
    count = 0
    while True:
        ratio = 0.0
        for u in range(nv):
            ratio = max(ratio, abs(moving[u]) / brake[u])
        if not ratio > 1.0:
            break
        # All joints slow down in proportion, until one has to brake harder than the others.
        last = min(np.ceil(ratio), float(most))
        gone = np.zeros(nv)
        number = 1.0
        held = False
        while number < last:
            if count == len(steps):
                longer = np.empty((2 * count, nv))
                longer[:count] = steps
                steps = longer
            share = 1.0 - number / ratio
            for u in range(nv):
                step = share * moving[u]
                least = max(min(_stoppable_step(low[u] - gone[u], brake[u]), 0.0), -bound[u])
                largest = min(max(_stoppable_step(high[u] - gone[u], brake[u]), 0.0), bound[u])
                held = held or step < least or step > largest
                steps[count, u] = min(max(step, least), largest)
            if held:
                break
            gone += steps[count]
            count += 1
            number += 1.0
        if not held:
            break
        before = moving if number == 1.0 else steps[count - 1]
        moving = np.minimum(np.maximum(steps[count], before - brake), before + brake)
        steps[count] = moving
        low -= gone + moving
        high -= gone + moving
        count += 1
    return steps[:count].copy()


@compiled
def step_box(
    positions: Array1,
    position_limits: Array2,
    bound: Array1,
    brake: Array1,
    previous: Array1,
    rounding: float,
    columns: Ints1,
    slack: Array1,
    limits: Array2,
) -> tuple[bool, bool]:
    """Compute the smallest and largest step of each joint; see `Limits.step_bounds`.

    Args:
        positions: joint positions, (nv,).
        position_limits: position limits, (2, nv).
        bound: largest |dq|, (nv,).
        brake: largest change of dq between steps, (nv,); empty for no limit.
        previous: the previous step, (nv,); empty without `brake`.
        rounding: tolerance of a limit.
        columns: which of the joints are on the chain, (n,).
        slack: tolerated excess of each of them over its limits, (n,).
        limits: filled with smallest and largest step, (2, nv).

    Returns:
        Whether limits cannot be met, and whether a joint of the chain is outside its limits.
    """
    unmet = False
    for u in range(len(positions)):
        low = position_limits[0, u] - positions[u]
        high = position_limits[1, u] - positions[u]
        slowest_point = 0.0
        smallest = low
        largest = high
        if len(brake):
            low = _stoppable_step(low, brake[u])
            high = _stoppable_step(high, brake[u])
            before = previous[u]
            slowest_point = before - min(max(before, -brake[u]), brake[u])
            smallest = min(max(low, before - brake[u]), before + brake[u])
            largest = min(max(high, before - brake[u]), before + brake[u])
        limits[0, u] = min(max(smallest, -bound[u]), bound[u])
        limits[1, u] = min(max(largest, -bound[u]), bound[u])
        above = min(high, bound[u]) - max(slowest_point, 0.0)
        below = min(slowest_point, 0.0) - max(low, -bound[u])
        if min(above, below) < -rounding:
            unmet = True
    for i in range(len(columns)):
        u = columns[i]
        if positions[u] < position_limits[0, u] - slack[i] or positions[u] > position_limits[1, u] + slack[i]:
            return unmet, True
    return unmet, False


@compiled
def shorten_step(
    dq: Array1,
    positions: Array1,
    position_limits: Array2,
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
        low = position_limits[0, u] - positions[u]
        high = position_limits[1, u] - positions[u]
        if len(brake):
            low = _stoppable_step(low, brake[u])
            high = _stoppable_step(high, brake[u])
        scaled = dq[u] * scale
        cut[u] = min(max(min(max(scaled, low), high), -bound[u]), bound[u])
        clipped[u] = cut[u] != scaled
        if len(brake):
            near = previous[u] - brake[u]
            far = previous[u] + brake[u]
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
            motion = abs(motion - FULL_TURN * np.round(motion / FULL_TURN))
        largest = max(largest, motion / units[i])
    return largest


@compiled
def position_excess(positions: Array1, position_limits: Array2, columns: Ints1) -> float:
    """Return the largest excess of joints over their position limits, (2, nv); 0 if there is none."""
    largest = 0.0
    for i in range(len(columns)):
        u = columns[i]
        largest = max(largest, position_limits[0, u] - positions[u], positions[u] - position_limits[1, u])
    return largest


@compiled
def path_offset(
    offsets: Array2, start: Array1, positions: Array1, endless: Flags1, s: float, filled: Array1
) -> None:
    """Compute the displacement of joints from the start of a path, with the full turns of a position nearby.

    Args:
        offsets: displacements of waypoints from the start, (N + 1, nv), joined by straight lines.
        start: joint positions at the start, (nv,).
        positions: current joint positions, (nv,).
        endless: which joints are periodic, (nv,).
        s: the position, in waypoints.
        filled: filled with the displacement, (nv,).
    """
    i = min(int(s), len(offsets) - 2)
    share = s - i
    for u in range(len(positions)):
        gone = positions[u] - start[u]
        if endless[u]:
            here = (1.0 - share) * offsets[i, u] + share * offsets[i + 1, u]
            gone += FULL_TURN * np.round((here - gone) / FULL_TURN)
        filled[u] = gone


@subkernel
def _smooth_offset(offsets: Array2, slopes: Array2, s: float, filled: Array1) -> None:
    """Compute `smooth_offsets` for one position; fills (nv,)."""
    i = min(int(s), len(offsets) - 2)
    t = s - i
    before = (1.0 + 2.0 * t) * (1.0 - t) ** 2
    after = t * t * (3.0 - 2.0 * t)
    for u in range(len(filled)):
        here = before * offsets[i, u] + after * offsets[i + 1, u]
        filled[u] = here + t * (1.0 - t) * ((1.0 - t) * slopes[i, u] - t * slopes[i + 1, u])


@compiled
def smooth_offsets(offsets: Array2, slopes: Array2, s: Array1, filled: Array2) -> None:
    """Compute displacements from the start on the cubic spline through waypoints.

    Args:
        offsets: displacement of each waypoint from the start, (N + 1, nv).
        slopes: change of it per waypoint, (N + 1, nv).
        s: the positions, in waypoints, (k,).
        filled: filled with the displacement at each, (k, nv).
    """
    for i in range(len(s)):
        _smooth_offset(offsets, slopes, s[i], filled[i])


@compiled
def find_stop(path: TimedPathArrays, s: float, speed: float, most: int) -> Array2:
    """Return the steps that stop an arm on a path, (k, nv), as fast as its limits allow.

    Args:
        path: the path.
        s: where the arm is, in waypoints.
        speed: number of waypoints in its last step.
        most: largest number of steps.
    """
    rest = np.zeros_like(path.top)
    ends = np.empty(most + 1)
    ends[0] = s
    count = 0
    while speed > 0.0 and count < most:
        speed = next_path_speed(ends[count], speed, path.small, path.most, path.parts, path.rows, rest)
        count += 1
        ends[count] = ends[count - 1] + max(speed, 0.0)
    steps = np.empty((count, path.offsets.shape[1]))
    before = np.empty(path.offsets.shape[1])
    _smooth_offset(path.offsets, path.slopes, s, before)
    for k in range(count):
        _smooth_offset(path.offsets, path.slopes, ends[k + 1], steps[k])
        for u in range(len(before)):
            reached = steps[k, u]
            steps[k, u] = reached - before[u]
            before[u] = reached
    return steps


@compiled
def step_along(
    offsets: Array2,
    start: Array1,
    positions: Array1,
    endless: Flags1,
    columns: Ints1,
    units: Array1,
    s: float,
    limits: Array2,
    max_motion: float,
    dq: Array1,
) -> tuple[float, float, bool]:
    """Compute the step to the farthest position on a path that can be reached without leaving the path.

    Args:
        offsets: displacements of waypoints from the start, (N + 1, nv), joined by straight lines.
        start: joint positions at the start, (nv,).
        positions: current joint positions, (nv,).
        endless: which joints are periodic, (nv,).
        columns: the joints that move on the path, (n,).
        units: unit of motion of each of them, (n,).
        s: current or last position on the path, in waypoints.
        limits: smallest and largest step, (2, nv).
        max_motion: largest motion of a joint without limits, in units.
        dq: zeros, filled with the step, (nv,).

    Returns:
        The position at its end, unchanged if the limits admit no step ahead; the largest remaining joint
        motion before the step, in units; and whether the step is within the limits.
    """
    n = len(columns)
    last = len(offsets) - 1
    offset = np.empty(len(positions))
    path_offset(offsets, start, positions, endless, s, offset)
    begin = np.empty(n)
    left = 0.0
    i = min(int(s), last - 1)
    share = s - i
    for k in range(n):
        u = columns[k]
        begin[k] = (1.0 - share) * offsets[i, u] + share * offsets[i + 1, u] - offset[u]
        left = max(left, abs(offsets[last, u] - offset[u]) / units[k])
    while s < last:
        i = min(int(s), last - 1)
        reach = 1.0
        for k in range(n):
            u = columns[k]
            bound = min(max(abs(limits[0, u]), abs(limits[1, u])), max_motion * units[k])
            motion = offsets[i + 1, u] - offset[u] - begin[k]
            if abs(begin[k]) > bound:
                reach = 0.0
            elif motion > 0.0:
                reach = min(reach, (bound - begin[k]) / motion)
            elif motion < 0.0:
                reach = min(reach, (bound + begin[k]) / -motion)
        s = i + 1.0 if reach >= 1.0 else s + reach * (i + 1.0 - s)
        for k in range(n):
            u = columns[k]
            begin[k] += min(reach, 1.0) * (offsets[i + 1, u] - offset[u] - begin[k])
        if reach < 1.0:
            break
    inside = True
    for k in range(n):
        u = columns[k]
        slack = PATH_SPEED.step_rounding * units[k]
        dq[u] = begin[k]
        fits = limits[0, u] - slack <= begin[k] <= limits[1, u] + slack
        inside = inside and fits and abs(begin[k]) <= max_motion * units[k]
    return s, left, inside


@compiled
def step_on_profile(
    path: TimedPathArrays,
    columns: Ints1,
    units: Array1,
    bound: Array1,
    brake: Array1,
    limits: Array2,
    tolerances: PathTolerances,
    s: float,
    speed: float,
    lag: Array1,
    dq: Array1,
) -> tuple[float, bool, bool]:
    """Compute the next step along a path with a speed profile, which also makes up a lag behind it.

    Args:
        path: the path.
        columns: the joints that move on the path, (n,).
        units: unit of motion of each of them, (n,).
        bound: largest step of each joint, (nv,).
        brake: largest change between steps, (nv,); empty for no limit.
        limits: smallest and largest step, (2, nv).
        tolerances: tolerances of the path.
        s: the position on the path, in waypoints.
        speed: number of waypoints in the previous step.
        lag: displacement of the position from the joints, (nv,).
        dq: filled with the step, (nv,).

    Returns:
        The position at its end; whether that is less far than the profile allows; and whether the step is
        within the limits.
    """
    end = len(path.offsets) - 1.0
    rate = next_path_speed(s, speed, path.small, path.most, path.parts, path.rows, path.top)
    wanted = min(rate, end - s)
    here = np.empty(len(dq))
    _smooth_offset(path.offsets, path.slopes, s, here)
    _smooth_offset(path.offsets, path.slopes, s + wanted, dq)
    # The share of the motion ahead that all joints can make while they catch up.
    share = 1.0
    for k in range(len(columns)):
        u = columns[k]
        onward = dq[u] - here[u]
        gap = bound[u] + lag[u] if onward < 0.0 else bound[u] - lag[u]
        share = min(share, 0.0 if abs(lag[u]) > bound[u] else gap / max(abs(onward), 1e-100))
    held_back = share < 1.0 or s >= end
    s += share * wanted
    if s > end - tolerances.arrived:
        s = end
    _smooth_offset(path.offsets, path.slopes, s, dq)
    for u in range(len(dq)):
        # The lag is made up no faster than the arm can stop, or it would oscillate about its path.
        caught = _stoppable_step(lag[u], PATH_SPEED.catch_up_share * brake[u]) if len(brake) else lag[u]
        dq[u] = dq[u] - here[u] + caught
    inside = True
    for k in range(len(columns)):
        u = columns[k]
        slack = PATH_SPEED.step_rounding * units[k]
        fits = limits[0, u] - slack <= dq[u] <= limits[1, u] + slack
        inside = inside and fits and abs(dq[u]) <= tolerances.max_motion * units[k]
    return s, held_back, inside


@compiled
def look_ahead(
    chain: ArmArrays,
    positions: Array1,
    units: Array1,
    limits: Array2,
    position_limits: Array2,
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
        units: unit of motion of each degree of freedom of the chain, (n,).
        limits: smallest and largest step, (2, nv).
        position_limits: position limits, (2, nv).
        points: current control points, (m, 3).
        targets: their targets, (m, 3).
        has_target: which of them have a target, (m,).
        dq: the step, (nv,); clipped.
        reached: filled with the joint positions after it, (nv,).
        at_limit: filled with which joints of the chain are at a position limit then, (nv,).

    Returns:
        Sum of the distances of the control points from their targets before the step and after it.
    """
    columns = chain.inputs
    n = len(chain.joints.kinds)
    m = len(chain.ends)
    for u in range(len(dq)):
        reached[u] = positions[u] + dq[u]
        at_limit[u] = False
    for k in range(len(columns)):
        u = columns[k]
        dq[u] = min(max(dq[u], limits[0, u]), limits[1, u])
        reached[u] = positions[u] + dq[u]
        slack = PATH_SPEED.step_rounding * units[k]
        at_limit[u] = (
            min(abs(position_limits[0, u] - reached[u]), abs(position_limits[1, u] - reached[u])) <= slack
        )
    joint_axes = np.empty((n, 3))
    joint_origins = np.empty((n, 3))
    trial = np.empty((m, 3))
    rotations = np.empty((m, 3, 3))
    placements(chain, reached, joint_axes, joint_origins, trial, rotations)
    return sum_point_errors(points, targets, has_target), sum_point_errors(trial, targets, has_target)


@compiled
def sum_point_errors(points: Array2, targets: Array2, has_target: Flags1) -> float:
    """Return the sum of the distances of points (m, 3) from their targets (m, 3), where they have one."""
    total = 0.0
    for k in range(len(points)):
        if has_target[k]:
            x = points[k, 0] - targets[k, 0]
            y = points[k, 1] - targets[k, 1]
            z = points[k, 2] - targets[k, 2]
            total += np.sqrt(x * x + y * y + z * z)
    return total


@compiled
def take_steps(
    chain: ArmArrays,
    endless: Flags1,
    limits: LimitArrays,
    positions: Array1,
    points: Array2,
    path: TimedPathArrays,
    motion: PathMotion,
    tolerances: PathTolerances,
    goals: PointGoals,
    found: NextSteps,
) -> int:
    """Run `step_box`, `step_along` or `step_on_profile`, and `look_ahead` for consecutive simple steps.

    All joints of the chain move on the path.

    Args:
        chain: the chain.
        endless: joints without position limits that turn on, (nv,).
        limits: the limits of each step.
        positions: joint positions, (nv,).
        points: the control points there, (m, 3).
        path: the path.
        motion: how the arm moves along it.
        tolerances: tolerances of the path.
        goals: where the points are to be.
        found: filled with at most s steps.

    Returns:
        Number of steps, at most s; the next step is not simple, or the path ends.
    """
    columns = chain.inputs
    last = len(path.offsets) - 1
    box = np.empty((2, len(positions)))
    lag = np.empty(len(positions))
    offset = np.empty(len(positions))
    if joint_distance(motion.expected, positions, endless, columns, limits.units) > tolerances.disturbed:
        return 0
    here = positions
    s = motion.s
    speed = motion.speed
    previous = motion.previous
    for i in range(len(found.s)):
        unmet, outside = step_box(
            here,
            limits.position_limits,
            limits.bound,
            motion.brake,
            previous,
            tolerances.rounding,
            columns,
            limits.slack,
            box,
        )
        if unmet or outside:
            return i
        if len(path.top) == 0:
            reached, left, inside = step_along(
                path.offsets,
                path.start,
                here,
                endless,
                columns,
                limits.units,
                s,
                box,
                tolerances.max_motion,
                found.dq[i],
            )
            ahead = True  # a step that is not counts as held back
        else:
            path_offset(path.offsets, path.start, here, endless, s, offset)
            left = 0.0
            for k in range(len(columns)):
                u = columns[k]
                left = max(left, abs(path.offsets[last, u] - offset[u]) / limits.units[k])
            _smooth_offset(path.offsets, path.slopes, s, lag)
            for u in range(len(lag)):
                lag[u] -= offset[u]
            reached, _, inside = step_on_profile(
                path,
                columns,
                limits.units,
                limits.bound,
                motion.brake,
                box,
                tolerances,
                s,
                speed,
                lag,
                found.dq[i],
            )
            ahead = reached > s
        if not inside or not ahead or (reached >= last and left <= tolerances.arrived):
            return i
        before, after = look_ahead(
            chain,
            here,
            limits.units,
            box,
            limits.position_limits,
            points,
            goals.targets,
            goals.flags,
            found.dq[i],
            found.reached[i],
            found.at_limit[i],
        )
        found.errors[i + 1] = after
        if not np.isfinite(after):
            return i
        if i == 0:
            found.errors[0] = before
        found.s[i] = reached
        speed = reached - s
        s = reached
        here = found.reached[i]
        previous = found.dq[i] if len(motion.brake) else motion.previous
    return len(found.s)


@compiled
def step_to(
    chain: ArmArrays,
    turns: Flags1,
    limits: LimitArrays,
    positions: Array1,
    points: Array2,
    goal: Array1,
    nearest_turn: Flags1,
    farthest: float,
    rounding: float,
    goals: PointGoals,
    found: StepArrays,
) -> tuple[bool, float, float]:
    """Step to a configuration that is within one step.

    Args:
        chain: the chain.
        turns: continuous joints, (nv,).
        limits: the limits of the step.
        positions: joint positions, (nv,).
        points: the control points there, (m, 3).
        goal: joint positions to reach, (nv,), up to whole turns of continuous and of multi-turn joints.
        nearest_turn: multi-turn joints, (nv,).
        farthest: largest motion of a joint, in units.
        rounding: excess over the limits that counts as rounding.
        goals: where the points are to be.
        found: filled with the step.

    Returns:
        Whether the limits allow the step and a joint moves; and the sums of distances before and after it.
    """
    none = np.empty(0)
    box = np.empty((2, len(positions)))
    columns = chain.inputs
    unmet, outside = step_box(
        positions, limits.position_limits, limits.bound, none, none, rounding, columns, limits.slack, box
    )
    if unmet or outside:
        return False, 0.0, 0.0
    found.dq[:] = 0.0
    moves = False
    for k in range(len(columns)):
        u = columns[k]
        ahead = goal[u] - positions[u]
        if turns[u] or nearest_turn[u]:
            ahead -= FULL_TURN * np.rint(ahead / FULL_TURN)
        if not (abs(ahead) <= farthest * limits.units[k] and box[0, u] <= ahead <= box[1, u]):
            return False, 0.0, 0.0
        found.dq[u] = ahead
        moves = moves or ahead != 0.0
    before, after = look_ahead(
        chain,
        positions,
        limits.units,
        box,
        limits.position_limits,
        points,
        goals.targets,
        goals.flags,
        found.dq,
        found.reached,
        found.at_limit,
    )
    return moves, before, after
