"""The place on a B-spline that is nearest to a point."""

from __future__ import annotations

import numpy as np

from pinposture.kernels.arclength import CLOSE, NEWTON, length_at
from pinposture.kernels.arrays import Array1, Array2, Array3
from pinposture.kernels.compiled import compiled, subkernel
from pinposture.kernels.spline import span_at, value


@subkernel
def distance_at(t: Array1, table: Array3, degree: int, u: float, p: Array1, work: Array2) -> float:
    """Distance from the point p (3,) to the place at u."""
    x, y, z = value(t, table, degree, 0, span_at(t, degree, u), u, work)
    return float(np.sqrt((x - p[0]) ** 2 + (y - p[1]) ** 2 + (z - p[2]) ** 2))


@subkernel
def slopes(t: Array1, table: Array3, degree: int, u: float, p: Array1, work: Array2) -> tuple[float, float]:
    """Half the first and second derivatives by u of the squared distance from p (3,)."""
    span = span_at(t, degree, u)
    x, y, z = value(t, table, degree, 0, span, u, work)
    x, y, z = x - p[0], y - p[1], z - p[2]
    a, b, c = value(t, table, degree, 1, span, u, work)
    second = a * a + b * b + c * c
    if degree > 1:
        d, e, f = value(t, table, degree, 2, span, u, work)
        second += x * d + y * e + z * f
    return x * a + y * b + z * c, second


@subkernel
def nearest_within(
    t: Array1, table: Array3, degree: int, low: float, high: float, p: Array1, work: Array2
) -> tuple[float, float]:
    """Parameter of the place nearest to p (3,) within a short piece, and the distance."""
    best, distance = low, distance_at(t, table, degree, low, p, work)
    at_high = distance_at(t, table, degree, high, p, work)
    if at_high < distance:
        best, distance = high, at_high
    inner = np.nextafter(high, low)  # a corner there belongs to the next piece
    if slopes(t, table, degree, low, p, work)[0] < 0.0 and slopes(t, table, degree, inner, p, work)[0] > 0.0:
        u, width, left, right = 0.5 * (low + high), inner - low, low, inner
        for _ in range(NEWTON):
            gap, slope = slopes(t, table, degree, u, p, work)
            if gap <= 0.0:
                left = u
            if gap >= 0.0:
                right = u
            trial = u - gap / slope
            if not (slope > 0.0 and left <= trial <= right):
                trial = 0.5 * (left + right)
            step = abs(trial - u)
            u = trial
            if step <= CLOSE * width:
                break
        inside = distance_at(t, table, degree, u, p, work)
        if inside <= distance:
            best, distance = u, inside
    return best, distance


@compiled
def nearest_places(
    t: Array1,
    table: Array3,
    degree: int,
    edges: Array1,
    lengths: Array1,
    series: Array2,
    pieces: int,
    points: Array2,
) -> Array2:
    """Find the nearest places to points; of several equally near, one of them.

    The curve is cut into pieces. If the middle of a piece is at a distance d, and its ends at most r away
    from there along the curve, no part of it is nearer than d - r; so each piece that could hold the nearest
    place is known, and searched.

    Args:
        t: knots.
        table: of `spline.spline_coefficients`.
        degree: of the spline.
        edges: of `arclength.measure_length`.
        lengths: likewise.
        series: likewise.
        pieces: how many at least.
        points: shape (n, 3).

    Returns:
        Arc length and distance of each, (n, 2).
    """
    parts = max(2, -(-pieces // len(series)))
    count = parts * len(series)
    work = np.empty((6, 3))
    ends, reach, middles = np.empty(count + 1), np.empty(count), np.empty((count, 3))
    for i in range(len(series)):
        for j in range(parts):
            ends[i * parts + j] = edges[i] + (edges[i + 1] - edges[i]) * (j / parts)
    ends[count] = edges[-1]
    s_low = 0.0
    for i in range(count):
        middle = 0.5 * (ends[i] + ends[i + 1])
        s_middle = length_at(edges, lengths, series, middle)
        s_high = length_at(edges, lengths, series, ends[i + 1])
        reach[i] = max(s_middle - s_low, s_high - s_middle)
        x, y, z = value(t, table, degree, 0, span_at(t, degree, middle), middle, work)
        middles[i, 0], middles[i, 1], middles[i, 2] = x, y, z
        s_low = s_high
    found, away = np.empty((len(points), 2)), np.empty(count)
    for k in range(len(points)):
        p = points[k]
        bound = np.inf
        for i in range(count):
            x, y, z = middles[i, 0] - p[0], middles[i, 1] - p[1], middles[i, 2] - p[2]
            away[i] = np.sqrt(x * x + y * y + z * z)
            bound = min(bound, away[i])
        best, distance = 0.0, np.inf
        for i in range(count):
            if away[i] - reach[i] <= bound * (1.0 + 1e-12):
                u, d = nearest_within(t, table, degree, ends[i], ends[i + 1], p, work)
                if d < distance:
                    best, distance = u, d
                    bound = min(bound, d)
        found[k, 0], found[k, 1] = length_at(edges, lengths, series, best), distance
    return found
