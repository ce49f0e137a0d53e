"""Closed forms of the modules that are placed by their ends: a torus and a circle.

All are in the frame at the base of a module, x along it and y its first hinge. Signs and branches are
explained in `pinposture.target.torus`.
"""

from __future__ import annotations

import numpy as np

from pinposture.kernels.arrays import Array1, Array2, Four, Three
from pinposture.kernels.compiled import compiled, subkernel

FIRST, LAST = 1e-9, 1.0 + 1e-9
"""Where on a segment a crossing may be: ahead of its start, and rounding beyond its end."""

TOUCHING = 0.5e-14
"""How near zero counts as zero where a polynomial turns, over its second derivative: a pair of complex roots
within 1e-7 of the segment."""


@compiled
def torus_forward(l1: float, l2: float, sense: float, q0: float, q1: float) -> tuple[float, ...]:
    """Position x, y, z and orientation (row by row) of the end."""
    c0, s0 = np.cos(q0), np.sin(q0)
    c1, s1 = np.cos(sense * q1), np.sin(sense * q1)
    radius = l1 + l2 * c1
    return (c0 * radius, l2 * s1, -s0 * radius, c0 * c1, -c0 * s1, s0, s1, c1, 0.0, -s0 * c1, s0 * s1, c0)


@compiled
def circle_forward(link: float, q0: float) -> tuple[float, ...]:
    """Position x, y, z and orientation (row by row) of the end."""
    c, s = np.cos(q0), np.sin(q0)
    return (link * c, 0.0, -link * s, c, 0.0, s, 0.0, 1.0, 0.0, -s, 0.0, c)


@compiled
def torus_inverse(l1: float, l2: float, sense: float, x: float, y: float, z: float, out: Array2) -> int:
    """Angles that put the end at a point, the branch that faces it first.

    Args:
        l1: distance between the hinges.
        l2: distance from the second hinge to the end.
        sense: of the second hinge, +1 or -1.
        x: of the point.
        y: of the point.
        z: of the point.
        out: filled with the pairs of angles, (2, 2).

    Returns:
        How many pairs there are.
    """
    reach = l1 + l2
    radius = np.hypot(x, z)
    q0 = np.arctan2(-z, x) if radius > 1e-12 * reach else 0.0
    count = 0
    for branch in range(2):
        if branch == 0:
            a0, a1 = q0, sense * np.arctan2(y, radius - l1)
        else:
            a0, a1 = q0 - np.pi if q0 > 0.0 else q0 + np.pi, sense * np.arctan2(y, -radius - l1)
        end = torus_forward(l1, l2, sense, a0, a1)
        if max(abs(end[0] - x), abs(end[1] - y), abs(end[2] - z)) < 1e-7 * reach:
            out[count, 0], out[count, 1] = a0, a1
            count += 1
    return count


@compiled
def circle_inverse(link: float, x: float, y: float, z: float, out: Array2) -> int:
    """The angle that puts the end at a point, into out[0, 0]; returns how many there are, 0 or 1."""
    q0 = np.arctan2(-z, x)
    end = circle_forward(link, q0)
    out[0, 0] = q0
    return int(max(abs(end[0] - x), abs(end[1] - y), abs(end[2] - z)) < 1e-6 * link)


@compiled
def torus_faces(l1: float, l2: float, x: float, y: float, z: float) -> bool:
    """True on the outer part of the torus."""
    return x * x + y * y + z * z > (l1 * l1 + l2 * l2) * (1.0 - 1e-12)


@subkernel
def torus_clearance(l1: float, l2: float, x: float, y: float, z: float) -> float:
    """A distance from a point within which there is no point of the torus."""
    radius = np.hypot(x, z)
    return float(min(abs(np.hypot(radius - l1, y) - l2), abs(np.hypot(radius + l1, y) - l2)))


@subkernel
def quartic(c: Four, c4: float, t: float) -> float:
    """Value at t of the polynomial of coefficients c, constant first, and c4."""
    return (((c4 * t + c[3]) * t + c[2]) * t + c[1]) * t + c[0]


@subkernel
def bracketed(c: Four, c4: float, low: float, high: float) -> float:
    """The root of a quartic between two places where its sign differs, by Newton's method and bisection."""
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
        if not low <= trial <= high:  # NaN neither
            trial = 0.5 * (low + high)
        step = abs(trial - t)
        t = trial
        if step <= 1e-16:
            break
    return t


@subkernel
def roots_between(c: Four, c4: float, places: Array1, count: int, out: Array1) -> int:
    """Roots of a quartic that has one or none between neighbouring places.

    Args:
        c: the lower coefficients, constant first.
        c4: the highest one.
        places: increasing, (count,) or longer; one between the first and the last where the quartic is zero
            but for rounding is a root too.
        count: how many places there are.
        out: filled with the roots, increasing.

    Returns:
        How many roots there are.
    """
    found = 0
    before = quartic(c, c4, places[0])
    for i in range(1, count):
        t = places[i]
        after = quartic(c, c4, t)
        if (before > 0.0) != (after > 0.0):
            out[found] = bracketed(c, c4, places[i - 1], t)
            found += 1
        elif i < count - 1 and abs(after) <= TOUCHING * abs(2.0 * c[2] + (6.0 * c[3] + 12.0 * c4 * t) * t):
            out[found] = t
            found += 1
        before = after
    return found


@subkernel
def quartic_roots(c: Four, c4: float, out: Array1) -> int:
    """Roots from `FIRST` to `LAST`, increasing, into out (4,); returns how many there are.

    Between its extrema a polynomial has one root or none; they are roots of the derivative, and found in the
    same way.
    """
    places, extrema = np.empty(5), np.empty(4)
    places[0] = FIRST
    count = 1
    square = 9.0 * c[3] * c[3] - 24.0 * c4 * c[2]
    if square >= 0.0:  # the second derivative c2 + 3 c3 t + 6 c4 t^2 (halved) has roots
        half = -0.5 * (3.0 * c[3] + np.copysign(np.sqrt(square), c[3]))
        a, b = half / (6.0 * c4), c[2] / half
        for t in (a, b) if a < b else (b, a):
            if places[count - 1] < t < LAST:  # not so if NaN
                places[count] = t
                count += 1
    places[count] = LAST
    turning = roots_between((c[1], 2.0 * c[2], 3.0 * c[3], 4.0 * c4), 0.0, places, count + 1, extrema)
    for i in range(turning):
        places[1 + i] = extrema[i]
    places[1 + turning] = LAST
    return roots_between(c, c4, places, turning + 2, out)


@compiled
def torus_crossings(l1: float, l2: float, a: Three, b: Three, out: Array1) -> int:
    """Where on the segment from a to b the torus is crossed, (6.13)-(6.15) put right.

    Args:
        l1: distance between the hinges.
        l2: distance from the second hinge to the end.
        a: where the segment begins.
        b: where it ends.
        out: filled with t in (0, 1] of each crossing, increasing, (4,); none at the base itself.

    Returns:
        How many there are.
    """
    ax, ay, az = a
    dx, dy, dz = b[0] - ax, b[1] - ay, b[2] - az
    aa = ax * ax + ay * ay + az * az
    ad = ax * dx + ay * dy + az * dz
    dd = dx * dx + dy * dy + dz * dz
    off, hinge = aa - (l1 * l1 + l2 * l2), 4.0 * l1 * l1
    c = (
        off * off - hinge * (l2 * l2 - ay * ay),
        4.0 * ad * off + 2.0 * hinge * ay * dy,
        2.0 * off * dd + 4.0 * ad * ad + hinge * dy * dy,
        4.0 * ad * dd,
    )
    count, smallest = 0, (1e-6 * (l1 + l2)) ** 2
    for i in range(quartic_roots(c, dd * dd, out)):
        t = out[i]
        s = min(t, 1.0)
        x, y, z = ax + s * dx, ay + s * dy, az + s * dz
        if t > FIRST and x * x + y * y + z * z > smallest:
            out[count] = s
            count += 1
    return count


@compiled
def circle_crossings(link: float, a: Three, b: Three, out: Array1) -> int:
    """Where on the segment from a to b the sphere around the base is crossed; as `torus_crossings`."""
    ax, ay, az = a
    dx, dy, dz = b[0] - ax, b[1] - ay, b[2] - az
    ad = ax * dx + ay * dy + az * dz
    dd = dx * dx + dy * dy + dz * dz
    square = ad * ad - dd * (ax * ax + ay * ay + az * az - link * link)
    count = 0
    if square >= 0.0 and dd > 0.0:
        half = np.sqrt(square)
        for t in ((-ad - half) / dd, (-ad + half) / dd):
            if FIRST < t <= LAST:
                out[count] = min(t, 1.0)
                count += 1
    return count
