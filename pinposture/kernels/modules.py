"""Closed-form kinematics of modules, and their placement on a curve (Algorithm 1)."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from pinposture.kernels.arrays import (
    Array1,
    Array2,
    Four,
    Ints1,
    Ints2,
    LengthArrays,
    SplineArrays,
    Three,
)
from pinposture.kernels.compiled import compiled, subkernel
from pinposture.kernels.spline import parameter_at, span_at, value

# All closed forms are in the base frame of a module, with x along it and y along its first transverse hinge.
# Signs and branches are explained in `pinposture.placement.module_kinematics`.


class ClosedForms(NamedTuple):
    """The modules with closed forms, by what their ends can reach, or by their joints."""

    circle: int = 1
    """One hinge."""

    torus: int = 2
    """Two transverse hinges."""

    roll_pitch: int = 3
    """A roll and a transverse hinge."""


FORM = ClosedForms()


class CrossingTolerances(NamedTuple):
    """Tolerances of crossings of a segment, from 0 to 1, with what a module reaches."""

    first: float = 1e-9
    """Smallest crossing: the start of the segment is excluded."""

    last: float = 1.0 + 1e-9
    """Largest crossing."""

    touching: float = 0.5e-14
    """Value that counts as zero at an extremum of a polynomial, relative to its second derivative: a pair of
    complex roots within 1e-7 of the segment."""

    reach: float = 1e-9
    """Tolerance of positions, relative to the reach of a module, and of joint limits [rad]."""


CROSSING = CrossingTolerances()


@subkernel
def torus_forward(l1: float, l2: float, sense: float, q0: float, q1: float) -> tuple[float, ...]:
    """Return position x, y, z and orientation (row by row) of the end."""
    c0 = np.cos(q0)
    s0 = np.sin(q0)
    c1 = np.cos(sense * q1)
    s1 = np.sin(sense * q1)
    radius = l1 + l2 * c1
    return (c0 * radius, l2 * s1, -s0 * radius, c0 * c1, -c0 * s1, s0, s1, c1, 0.0, -s0 * c1, s0 * s1, c0)


@subkernel
def circle_forward(link: float, q0: float) -> tuple[float, ...]:
    """Return position x, y, z and orientation (row by row) of the end."""
    c = np.cos(q0)
    s = np.sin(q0)
    return (link * c, 0.0, -link * s, c, 0.0, s, 0.0, 1.0, 0.0, -s, 0.0, c)


@subkernel
def roll_pitch_forward(l1: float, l2: float, sense: float, q0: float, q1: float) -> tuple[float, ...]:
    """Return position x, y, z and orientation (row by row) of the end."""
    c0 = np.cos(sense * q0)
    s0 = np.sin(sense * q0)
    c1 = np.cos(q1)
    s1 = np.sin(q1)
    x = l1 + l2 * c1
    y = l2 * s0 * s1
    z = -l2 * c0 * s1
    return (x, y, z, c1, 0.0, s1, s0 * s1, c0, -s0 * c1, -c0 * s1, s0, c0 * c1)


@subkernel
def torus_inverse(l1: float, l2: float, sense: float, x: float, y: float, z: float, out: Array2) -> int:
    """Find the angles that put the end at a point, the branch that faces it first.

    Args:
        l1: distance between the hinges.
        l2: distance from the second hinge to the end.
        sense: sense of the second hinge, +1 or -1.
        x: x of the point.
        y: y of the point.
        z: z of the point.
        out: filled with the pairs of angles, (2, 2).

    Returns:
        Number of pairs.
    """
    reach = l1 + l2
    radius = np.hypot(x, z)
    q0 = np.arctan2(-z, x) if radius > 1e-12 * reach else 0.0
    count = 0
    for branch in range(2):
        if branch == 0:
            a0 = q0
            a1 = sense * np.arctan2(y, radius - l1)
        else:
            a0 = q0 - np.pi if q0 > 0.0 else q0 + np.pi
            a1 = sense * np.arctan2(y, -radius - l1)
        end = torus_forward(l1, l2, sense, a0, a1)
        if max(abs(end[0] - x), abs(end[1] - y), abs(end[2] - z)) < 1e-7 * reach:
            out[count, 0] = a0
            out[count, 1] = a1
            count += 1
    return count


@subkernel
def roll_pitch_inverse(l1: float, l2: float, sense: float, x: float, y: float, z: float, out: Array2) -> int:
    """Find the angles that put the end at a point, into out (2, 2), the pair with the smaller roll first.

    Returns the number of pairs. The roll is zero if it does not move the end.
    """
    rho = np.hypot(y, z)
    reach = l1 + l2
    if abs(np.hypot(x - l1, rho) - l2) > 1e-7 * reach:
        return 0
    bend = np.arctan2(rho, x - l1)
    roll = np.arctan2(y, -z) if rho > 1e-12 * reach else 0.0
    other = roll - np.pi if roll > 0.0 else roll + np.pi
    first = int(abs(other) < abs(roll))
    out[first, 0] = sense * roll
    out[first, 1] = bend
    out[1 - first, 0] = sense * other
    out[1 - first, 1] = -bend
    return 2


@subkernel
def circle_inverse(link: float, x: float, y: float, z: float, out: Array2) -> int:
    """Find the angle that puts the end at a point, into out[0, 0]; return the number of solutions."""
    q0 = np.arctan2(-z, x)
    end = circle_forward(link, q0)
    out[0, 0] = q0
    return int(max(abs(end[0] - x), abs(end[1] - y), abs(end[2] - z)) < 1e-6 * link)


@subkernel
def torus_distance(l1: float, l2: float, x: float, y: float, z: float) -> float:
    """Return a lower bound of the distance of a point from the torus."""
    radius = np.hypot(x, z)
    return float(min(abs(np.hypot(radius - l1, y) - l2), abs(np.hypot(radius + l1, y) - l2)))


@subkernel
def quartic(c: Four, c4: float, t: float) -> float:
    """Return the value at t of the polynomial with coefficients c, constant first, and c4."""
    return (((c4 * t + c[3]) * t + c[2]) * t + c[1]) * t + c[0]


@subkernel
def root_between(c: Four, c4: float, low: float, high: float) -> float:
    """Return the root of a quartic between two values of opposite sign, by Newton's method and bisection."""
    rising = quartic(c, c4, high) > 0.0
    t = 0.5 * (low + high)
    for _ in range(100):
        value = quartic(c, c4, t)
        slope = ((4.0 * c4 * t + 3.0 * c[3]) * t + 2.0 * c[2]) * t + c[1]
        if (value > 0.0) == rising:
            high = t
        else:
            low = t
        trial = t - value / slope
        if not low <= trial <= high:  # or NaN
            trial = 0.5 * (low + high)
        step = abs(trial - t)
        t = trial
        if step <= 1e-16:
            break
    return t


@subkernel
def roots_between(c: Four, c4: float, places: Array1, count: int, out: Array1) -> int:
    """Find the roots of a quartic that has at most one between neighbouring places.

    Coefficients are c, constant first, and c4; the `count` places increase. An inner place where the quartic
    is zero up to rounding error is a root, too. Fills out with the roots, increasing, and returns their
    number.
    """
    found = 0
    before = quartic(c, c4, places[0])
    for i in range(1, count):
        t = places[i]
        after = quartic(c, c4, t)
        if (before > 0.0) != (after > 0.0):
            out[found] = root_between(c, c4, places[i - 1], t)
            found += 1
        elif i < count - 1:
            bend = abs(2.0 * c[2] + (6.0 * c[3] + 12.0 * c4 * t) * t)
            if abs(after) <= CROSSING.touching * bend:
                out[found] = t
                found += 1
        before = after
    return found


@subkernel
def quartic_roots(c: Four, c4: float, out: Array1) -> int:
    """Find the roots from `CROSSING.first` to `CROSSING.last`, into out (4,); return their number.

    A polynomial has at most one root between its extrema, which are roots of its derivative, found likewise.
    """
    places = np.empty(5)
    extrema = np.empty(4)
    places[0] = CROSSING.first
    count = 1
    square = 9.0 * c[3] * c[3] - 24.0 * c4 * c[2]
    if square >= 0.0:  # half the second derivative, c2 + 3 c3 t + 6 c4 t^2, has roots
        half = -0.5 * (3.0 * c[3] + np.copysign(np.sqrt(square), c[3]))
        a = half / (6.0 * c4)
        b = c[2] / half
        for t in (a, b) if a < b else (b, a):
            if places[count - 1] < t < CROSSING.last:  # False if NaN
                places[count] = t
                count += 1
    places[count] = CROSSING.last
    turning = roots_between((c[1], 2.0 * c[2], 3.0 * c[3], 4.0 * c4), 0.0, places, count + 1, extrema)
    for i in range(turning):
        places[1 + i] = extrema[i]
    places[1 + turning] = CROSSING.last
    return roots_between(c, c4, places, turning + 2, out)


@subkernel
def torus_crossings(l1: float, l2: float, a: Three, b: Three, out: Array1) -> int:
    """Find where the segment from a to b crosses the torus, (6.13)-(6.15) corrected.

    Args:
        l1: distance between the hinges.
        l2: distance from the second hinge to the end.
        a: start of the segment.
        b: its end.
        out: filled with t in (0, 1] of each crossing, increasing, (4,); none at the base itself.

    Returns:
        Number of crossings.
    """
    if l1 == 0.0:  # a sphere, for which the quartic below has double roots
        return circle_crossings(l2, a, b, out)
    ax, ay, az = a
    dx = b[0] - ax
    dy = b[1] - ay
    dz = b[2] - az
    aa = ax * ax + ay * ay + az * az
    ad = ax * dx + ay * dy + az * dz
    dd = dx * dx + dy * dy + dz * dz
    off = aa - (l1 * l1 + l2 * l2)
    hinge = 4.0 * l1 * l1
    c = (
        off * off - hinge * (l2 * l2 - ay * ay),
        4.0 * ad * off + 2.0 * hinge * ay * dy,
        2.0 * off * dd + 4.0 * ad * ad + hinge * dy * dy,
        4.0 * ad * dd,
    )
    count = 0
    smallest = (1e-6 * (l1 + l2)) ** 2
    for i in range(quartic_roots(c, dd * dd, out)):
        t = out[i]
        s = min(t, 1.0)
        x = ax + s * dx
        y = ay + s * dy
        z = az + s * dz
        if t > CROSSING.first and x * x + y * y + z * z > smallest:
            out[count] = s
            count += 1
    return count


@subkernel
def circle_crossings(link: float, a: Three, b: Three, out: Array1) -> int:
    """Find where the segment from a to b crosses the sphere around the base, as `torus_crossings`."""
    ax, ay, az = a
    dx = b[0] - ax
    dy = b[1] - ay
    dz = b[2] - az
    ad = ax * dx + ay * dy + az * dz
    dd = dx * dx + dy * dy + dz * dz
    square = ad * ad - dd * (ax * ax + ay * ay + az * az - link * link)
    count = 0
    if square >= 0.0 and dd > 0.0:
        half = np.sqrt(square)
        for t in ((-ad - half) / dd, (-ad + half) / dd):
            if CROSSING.first < t <= CROSSING.last:
                out[count] = min(t, 1.0)
                count += 1
    return count


@subkernel
def roll_pitch_crossings(l1: float, l2: float, a: Three, b: Three, out: Array1) -> int:
    """Find where the segment from a to b crosses the sphere around the hinge, as `torus_crossings`."""
    count = 0
    smallest = (1e-6 * (l1 + l2)) ** 2
    for i in range(circle_crossings(l2, (a[0] - l1, a[1], a[2]), (b[0] - l1, b[1], b[2]), out)):
        s = out[i]
        x = a[0] + s * (b[0] - a[0])
        y = a[1] + s * (b[1] - a[1])
        z = a[2] + s * (b[2] - a[2])
        if x * x + y * y + z * z > smallest:
            out[count] = s
            count += 1
    return count


@compiled
def module_forward(form: int, shape: Array1, q: Array1) -> tuple[float, ...]:
    """Return position x, y, z and orientation (row by row) of the end at joint positions q."""
    if form == FORM.circle:
        return circle_forward(shape[0], q[0])
    if form == FORM.roll_pitch:
        return roll_pitch_forward(shape[0], shape[1], shape[2], q[0], q[1])
    return torus_forward(shape[0], shape[1], shape[2], q[0], q[1])


@compiled
def module_crossings(form: int, shape: Array1, a: Three, b: Three, out: Array1) -> int:
    """Find where the segment from a to b crosses the reachable set of a form, as `torus_crossings`."""
    if form == FORM.circle:
        return circle_crossings(shape[0], a, b, out)
    if form == FORM.roll_pitch:
        return roll_pitch_crossings(shape[0], shape[1], a, b, out)
    return torus_crossings(shape[0], shape[1], a, b, out)


@compiled
def module_faces(form: int, shape: Array1, x: float, y: float, z: float) -> bool:
    """Return whether the last hinge of a form bends by less than 90 degrees at a point."""
    if form == FORM.roll_pitch:
        return x >= shape[0] * (1.0 - 1e-12)
    outer = (shape[0] * shape[0] + shape[1] * shape[1]) * (1.0 - 1e-12)
    return form == FORM.circle or x * x + y * y + z * z > outer


@compiled
def module_inverse(form: int, shape: Array1, x: float, y: float, z: float, out: Array2) -> int:
    """Find joint positions that put a module's end at a point, into out (2, 2); return their number."""
    if form == FORM.circle:
        return circle_inverse(shape[0], x, y, z, out)
    if form == FORM.roll_pitch:
        return roll_pitch_inverse(shape[0], shape[1], shape[2], x, y, z, out)
    return torus_inverse(shape[0], shape[1], shape[2], x, y, z, out)


@subkernel
def clip_to_limits(dof: int, q: Array1, first: int, lower: Array1, upper: Array1) -> bool:
    """Return whether joint positions q are within the limits, up to rounding error; if so, clip them."""
    for j in range(dof):
        if not lower[first + j] - CROSSING.reach <= q[j] <= upper[first + j] + CROSSING.reach:
            return False
    for j in range(dof):
        q[j] = min(max(q[j], lower[first + j]), upper[first + j])
    return True


@subkernel
def end_frame(form: int, shape: Array1, q: Array1, frame: Array2, next_turn: Array2) -> None:
    """Fill next_turn (3, 3) with the rotation of the next module, given the base frame (3, 3) of this one."""
    e = module_forward(form, shape, q)
    for i in range(3):
        f0 = frame[i, 0]
        f1 = frame[i, 1]
        f2 = frame[i, 2]
        a = f0 * e[3] + f1 * e[6] + f2 * e[9]
        b = f0 * e[4] + f1 * e[7] + f2 * e[10]
        c = f0 * e[5] + f1 * e[8] + f2 * e[11]
        for j in range(3):
            next_turn[i, j] = a * shape[3 + 3 * j] + b * shape[4 + 3 * j] + c * shape[5 + 3 * j]


@subkernel
def base_frame(turn: Array2, shape: Array1, frame: Array2) -> None:
    """Fill frame (3, 3) with the axes of the base frame of a module in the world."""
    for i in range(3):
        for j in range(3):
            frame[i, j] = turn[i, 0] * shape[3 + j] + turn[i, 1] * shape[6 + j] + turn[i, 2] * shape[9 + j]


@subkernel
def in_frame(frame: Array2, x: float, y: float, z: float) -> Three:
    """Transform a world vector to a frame (3, 3)."""
    return (
        frame[0, 0] * x + frame[1, 0] * y + frame[2, 0] * z,
        frame[0, 1] * x + frame[1, 1] * y + frame[2, 1] * z,
        frame[0, 2] * x + frame[1, 2] * y + frame[2, 2] * z,
    )


@subkernel
def free_distance(form: int, shape: Array1, a: Three) -> float:
    """Return the radius of a ball around a point that is within reach and free of reachable points."""
    away = np.sqrt(a[0] * a[0] + a[1] * a[1] + a[2] * a[2])
    if form == FORM.circle:
        return float(abs(shape[0] - away))
    if form == FORM.roll_pitch:
        off = np.sqrt((a[0] - shape[0]) ** 2 + a[1] * a[1] + a[2] * a[2])
        return float(min(shape[0] + shape[1] - away, abs(off - shape[1])))
    return float(min(shape[0] + shape[1] - away, torus_distance(shape[0], shape[1], a[0], a[1], a[2])))


@subkernel
def search_segment(
    form: int,
    shape: Array1,
    joint: int,
    lower: Array1,
    upper: Array1,
    a: Three,
    b: Three,
    roots: Array1,
    qs: Array2,
    choice: Array1,
) -> tuple[int, int]:
    """Find where the end of a module can be on the segment from a to b in its base frame.

    Fills `choice` (6,) with the place on the segment from 0 to 1, the point (3,) and the joint positions (2,)
    of the first solution that faces the module, or else, if it was NaN, of the first one. `roots` (4,) and
    `qs` (2, 2) are scratch; other arguments are as in `place_modules`.

    Returns:
        Number of crossings regardless of joint limits, and whether the choice faces the module.
    """
    found = 0
    dof = min(form, 2)
    for i in range(module_crossings(form, shape, a, b, roots)):
        r = roots[i]
        x = a[0] + r * (b[0] - a[0])
        y = a[1] + r * (b[1] - a[1])
        z = a[2] + r * (b[2] - a[2])
        n = module_inverse(form, shape, x, y, z, qs)
        found += int(n > 0)
        facing = module_faces(form, shape, x, y, z)
        for j in range(n):
            if clip_to_limits(dof, qs[j], joint, lower, upper):
                if facing or np.isnan(choice[0]):
                    choice[0] = r
                    choice[1] = x
                    choice[2] = y
                    choice[3] = z
                    choice[4] = qs[j, 0]
                    choice[5] = qs[j, 1]
                if facing:
                    return found, 1
                break
    return found, 0


@compiled
def place_modules(
    spline: SplineArrays,
    length: LengthArrays,
    samples: int,
    units: Ints2,
    shapes: Array2,
    lower: Array1,
    upper: Array1,
    state: Array1,
    positions: Array1,
    parameters: Array1,
) -> int:
    """Place modules on a curve one by one, each where its reachable set first crosses the curve ahead.

    The curve is a polyline of samples at equal arc length. If a sample is at a distance d from the reachable
    set of the module's end, the samples less than d ahead along the curve are skipped.

    Args:
        spline: the curve.
        length: its arc length.
        samples: number of samples, at least 2.
        units: closed form (of `FORM`), first joint and module of each unit, (n, 3).
        shapes: l1, l2 and sense of each unit (the link of a circle as l1), and the axes of its base frame in
            the neutral posture, row by row, (n, 12).
        lower: lower limits of the joints of the chain.
        upper: upper limits.
        state: (9,); initially arc length of the base, its position (3,), and the curve point there (3,). On
            return, for a unit that cannot be placed: arc length of its base; in its base frame, the curve
            point there (3,) and the last one examined (3,); whether that is out of reach; and the number of
            crossings regardless of joint limits.
        positions: filled with the positions of the joints of the chain.
        parameters: filled with the arc length of each module's end, (m,).

    Returns:
        Index of the unit that cannot be placed; -1 if all are placed.
    """
    total = length.lengths[-1]
    step = total / (samples - 1)
    work = np.empty((6, 3))
    roots = np.empty(4)
    qs = np.empty((2, 2))
    choice = np.empty(6)
    turn = np.zeros((3, 3))
    frame = np.empty((3, 3))
    turn[0, 0] = turn[1, 1] = turn[2, 2] = 1.0
    parameter = state[0]
    px = state[1]
    py = state[2]
    pz = state[3]
    sx = state[4]
    sy = state[5]
    sz = state[6]
    for k in range(len(units)):
        form = units[k, 0]
        joint = units[k, 1]
        shape = shapes[k]
        dof = min(form, 2)
        reach = shape[0] + shape[1]
        base_frame(turn, shape, frame)
        a = in_frame(frame, sx - px, sy - py, sz - pz)
        s = parameter
        at = parameter
        state[0] = parameter
        state[1], state[2], state[3] = a
        # The first sample ahead.
        following = max(int(parameter / step) - 1, 0)
        while following < samples and (following * step if following < samples - 1 else total) <= parameter:
            following += 1
        found = 0
        beyond = False
        facing = 0
        choice[0] = np.nan
        while following < samples and not beyond and not facing:
            # Jump to the last sample that cannot be across the reachable set or out of reach, if any. The
            # margin of a thousandth of a step covers errors of the arc length.
            clear = free_distance(form, shape, a) - CROSSING.reach * reach
            ahead = int(min((s + clear) / step - 1e-3, samples - 1.0))
            jump = ahead >= following
            following = max(ahead, following)
            s_next = following * step if following < samples - 1 else total
            u = parameter_at(length, s_next)
            x, y, z = value(spline, 0, span_at(spline, u), u, work)
            b = in_frame(frame, x - px, y - py, z - pz)
            if not jump:
                beyond = np.sqrt(b[0] * b[0] + b[1] * b[1] + b[2] * b[2]) > reach * (1.0 + CROSSING.reach)
                before = choice[0]
                crossed, facing = search_segment(form, shape, joint, lower, upper, a, b, roots, qs, choice)
                found += crossed
                if facing or (np.isnan(before) and not np.isnan(choice[0])):
                    at = s + (s_next - s) * choice[0]
            a = b
            s = s_next
            following += 1
        if np.isnan(choice[0]):
            state[4], state[5], state[6] = a
            state[7] = beyond
            state[8] = found
            return k
        for j in range(dof):
            positions[joint + j] = choice[4 + j]
        end_frame(form, shape, choice[4:], frame, turn)
        px += frame[0, 0] * choice[1] + frame[0, 1] * choice[2] + frame[0, 2] * choice[3]
        py += frame[1, 0] * choice[1] + frame[1, 1] * choice[2] + frame[1, 2] * choice[3]
        pz += frame[2, 0] * choice[1] + frame[2, 1] * choice[2] + frame[2, 2] * choice[3]
        sx = px
        sy = py
        sz = pz
        parameter = at
        parameters[units[k, 2]] = parameter
    return -1


@compiled
def neighbours(q: Array1, starts: Ints1) -> tuple[float, float]:
    """Compare the joint positions of neighbouring modules with the same number of joints.

    Args:
        q: positions of the joints of the chain, (n,).
        starts: first joint of each module, and n, (m + 1,).

    Returns:
        Sums over the pairs of the dot products of their joint positions, and of the products of their norms.
    """
    products = 0.0
    norms = 0.0
    before = 0.0
    for k in range(len(starts) - 1):
        first = starts[k]
        size = starts[k + 1] - starts[k]
        square = 0.0
        for j in range(first, first + size):
            square += q[j] * q[j]
        if k > 0 and size == first - starts[k - 1]:
            for j in range(first, first + size):
                products += q[j] * q[j - size]
            norms += np.sqrt(square * before)
        before = square
    return products, norms
