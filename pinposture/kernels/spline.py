"""B-splines in space: values, arc length and nearest points."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from pinposture.kernels.arrays import Array1, Array2, Array3, LengthArrays, SplineArrays, Three
from pinposture.kernels.compiled import compiled, subkernel


class SplineSettings(NamedTuple):
    """Settings of arc lengths, their inverse, and the search for points where a curve stands still."""

    halvings: int = 48
    """Largest number of halvings of a span, enough for a speed that nearly vanishes."""

    pieces_per_span: int = 64
    """Largest number of pieces per span that are halved at a time; more are a sign of rounding errors."""

    newton_steps: int = 60
    """Largest number of Newton steps."""

    newton_tolerance: float = 1e-10
    """Step at which Newton's method ends, relative to the bracket."""

    speed_samples: int = 9
    """Number of samples of the speed in a knot span."""

    stationary_speed: float = 1e-6
    """Speed that counts as zero, relative to the largest in its span."""


SPLINE = SplineSettings()


@compiled
def spline_coefficients(t: Array1, c: Array2, degree: int) -> Array3:
    """Compute the coefficients of the derivatives of a B-spline, which are B-splines on the same knots.

    Args:
        t: knots, (n + degree + 1,).
        c: coefficients, (n, 3).
        degree: 1 to 5.

    Returns:
        Coefficients of the derivative of order p in the first n - p rows of [p], (degree + 1, n, 3).
    """
    n = len(c)
    table = np.zeros((degree + 1, n, 3))
    for i in range(n):
        table[0, i, 0] = c[i, 0]
        table[0, i, 1] = c[i, 1]
        table[0, i, 2] = c[i, 2]
    for p in range(1, degree + 1):
        for i in range(n - p):
            width = t[i + degree + 1] - t[i + p]
            if width > 0.0:  # else it affects no span
                for axis in range(3):
                    rise = table[p - 1, i + 1, axis] - table[p - 1, i, axis]
                    table[p, i, axis] = (degree + 1 - p) / width * rise
    return table


@subkernel
def interval_at(table: Array1, x: float, first: int, last: int) -> int:
    """Return the interval between `first` and `last` of an increasing table that contains x.

    Outside, it is the first or the last one; at an entry, the following one.
    """
    while last - first > 1:
        middle = (first + last) // 2
        if table[middle] <= x:
            first = middle
        else:
            last = middle
    return first


@subkernel
def span_at(spline: SplineArrays, u: float) -> int:
    """Return the knot span that contains u; the following one at a knot, the last one at the end."""
    t = spline.knots
    degree = spline.degree
    span = interval_at(t, u, degree, len(t) - degree - 1)
    while t[span + 1] <= t[span] and span > degree:
        span -= 1
    return span


@subkernel
def value(spline: SplineArrays, order: int, span: int, u: float, work: Array2) -> Three:
    """Return x, y and z of a derivative of the spline at u in a span, by de Boor's recursion.

    `order` is 0 to the degree; `work` (6, 3) is scratch.
    """
    t = spline.knots
    degree = spline.degree
    d = degree - order
    first = span - degree
    c = spline.table[order]
    for i in range(d + 1):
        work[i, 0] = c[first + i, 0]
        work[i, 1] = c[first + i, 1]
        work[i, 2] = c[first + i, 2]
    for r in range(1, d + 1):
        for i in range(d, r - 1, -1):
            left = t[span - d + i]
            a = (u - left) / (t[span + i - r + 1] - left)
            b = 1.0 - a
            work[i, 0] = b * work[i - 1, 0] + a * work[i, 0]
            work[i, 1] = b * work[i - 1, 1] + a * work[i, 1]
            work[i, 2] = b * work[i - 1, 2] + a * work[i, 2]
    return work[d, 0], work[d, 1], work[d, 2]


@compiled
def spline_values(spline: SplineArrays, order: int, u: Array1) -> Array2:
    """Return a derivative of the spline, (n, 3), at parameters u (n,); zero for orders above the degree."""
    out = np.zeros((len(u), 3))
    if order <= spline.degree:
        work = np.empty((6, 3))
        for i in range(len(u)):
            out[i, 0], out[i, 1], out[i, 2] = value(spline, order, span_at(spline, u[i]), u[i], work)
    return out


@subkernel
def expand(spline: SplineArrays, low: float, high: float, work: Array2, taylor: Array2) -> None:
    """Expand the velocity about the midpoint of the piece from low to high of one knot span.

    Fills `taylor` (degree, 3) with the coefficients of 1, x, x^2 ... on x from -1 to 1; `work` (6, 3) is
    scratch.
    """
    half = 0.5 * (high - low)
    middle = low + half
    span = span_at(spline, middle)
    scale = 1.0
    for p in range(spline.degree):
        x, y, z = value(spline, p + 1, span, middle, work)
        taylor[p, 0] = scale * x
        taylor[p, 1] = scale * y
        taylor[p, 2] = scale * z
        scale *= half / (p + 1)


@subkernel
def speed(taylor: Array2, degree: int, x: float) -> float:
    """Return the speed at x, given an expanded velocity."""
    a = taylor[degree - 1, 0]
    b = taylor[degree - 1, 1]
    c = taylor[degree - 1, 2]
    for p in range(degree - 2, -1, -1):
        a = a * x + taylor[p, 0]
        b = b * x + taylor[p, 1]
        c = c * x + taylor[p, 2]
    return float(np.sqrt(a * a + b * b + c * c))


@compiled
def expand_spans(spline: SplineArrays) -> Array3:
    """Expand the velocity about the midpoint of each knot span, see `expand`, (k, degree, 3)."""
    breaks = spline.breaks
    work = np.empty((6, 3))
    taylors = np.empty((len(breaks) - 1, spline.degree, 3))
    for i in range(len(taylors)):
        expand(spline, breaks[i], breaks[i + 1], work, taylors[i])
    return taylors


@subkernel
def expand_speed(taylor: Array2, degree: int, rule: Array2, speeds: Array1, piece: Array1) -> None:
    """Expand the speed on a piece in Legendre polynomials.

    `taylor` is the velocity there, `rule` as in `measure_length`, `speeds` (N,) is scratch. `piece` (3 + N,)
    holds its start and end; from [2] on it is filled with the size of the last two coefficients, and with all
    coefficients, times half the width.
    """
    nodes = len(rule)
    half = 0.5 * (piece[1] - piece[0])
    for g in range(nodes):
        speeds[g] = speed(taylor, degree, rule[g, 0])
        piece[3 + g] = 0.0
    for g in range(1, nodes):
        change = speeds[g] - speeds[0]  # differences, so that a constant speed is exact
        for j in range(nodes):
            piece[3 + j] += change * rule[g, 1 + j]
    piece[3] += speeds[0]
    for j in range(nodes):
        piece[3 + j] *= half
    piece[2] = abs(piece[1 + nodes]) + abs(piece[2 + nodes])


@compiled
def measure_length(
    spline: SplineArrays, taylors: Array3, rule: Array2, tail: float, rounding: float
) -> LengthArrays:
    """Integrate the speed, approximated by a polynomial on each of many short pieces of the knot spans.

    Pieces are halved until the Legendre series of the speed, sampled at Gauss nodes, has converged.

    Args:
        spline: the spline.
        taylors: from `expand_spans`.
        rule: Gauss nodes; the matrix from values there to Legendre coefficients; the matrix from those to
            power coefficients of the integral from -1, highest first; (N, 1 + N + N + 1).
        tail: tolerance for the last terms of a piece's series, relative to the total length.
        rounding: rounding error of the length of a span, at which halving ends.
    """
    nodes = len(rule)
    spans = len(taylors)
    breaks = spline.breaks
    degree = spline.degree
    work = np.empty((6, 3))
    finer = np.empty((degree, 3))
    speeds = np.empty(nodes)
    # Start and end of each piece, size of its last Legendre coefficients (-1: unknown), and all coefficients.
    pieces = np.empty((spans, 3 + nodes))
    for i in range(spans):
        pieces[i, 0] = breaks[i]
        pieces[i, 1] = breaks[i + 1]
        pieces[i, 2] = -1.0
    largest = 0.0
    unresolved = spans
    for depth in range(SPLINE.halvings):
        total = 0.0
        unresolved = 0
        for i in range(len(pieces)):
            piece = pieces[i]
            if piece[2] < 0.0:
                taylor = taylors[i] if depth == 0 else finer
                if depth > 0:
                    expand(spline, piece[0], piece[1], work, finer)
                expand_speed(taylor, degree, rule, speeds, piece)
            total += 2.0 * piece[3]
            if depth > 0:
                unresolved += int(piece[2] > largest)
        if depth == 0:
            largest = max(tail * total, rounding)
            for i in range(spans):
                unresolved += int(pieces[i, 2] > largest)
        too_many = unresolved > SPLINE.pieces_per_span * len(breaks)
        if unresolved == 0 or too_many or depth == SPLINE.halvings - 1:
            break
        halves = np.empty((len(pieces) + unresolved, 3 + nodes))
        k = 0
        for i in range(len(pieces)):
            piece = pieces[i]
            if piece[2] > largest:
                middle = piece[0] + 0.5 * (piece[1] - piece[0])
                halves[k, 0] = piece[0]
                halves[k, 1] = middle
                halves[k, 2] = -1.0
                k += 1
                halves[k, 0] = middle
                halves[k, 1] = piece[1]
                halves[k, 2] = -1.0
            else:
                for j in range(3 + nodes):
                    halves[k, j] = piece[j]
            k += 1
        pieces = halves
    edges = np.empty(len(pieces) + 1)
    lengths = np.empty(len(pieces) + 1)
    series = np.zeros((len(pieces), nodes + 1))
    edges[0] = breaks[0]
    lengths[0] = 0.0
    for i in range(len(pieces)):
        piece = pieces[i]
        edges[i + 1] = piece[1]
        lengths[i + 1] = lengths[i] + 2.0 * piece[3]
        for g in range(nodes):
            for j in range(nodes + 1):
                series[i, j] += piece[3 + g] * rule[g, 1 + nodes + j]
    return LengthArrays(edges, lengths, series)


@subkernel
def length_at(length: LengthArrays, u: float) -> float:
    """Return the arc length from the start to the parameter u."""
    edges = length.edges
    lengths = length.lengths
    i = interval_at(edges, u, 0, len(edges) - 1)
    x = (2.0 * u - edges[i] - edges[i + 1]) / (edges[i + 1] - edges[i])
    row = length.series[i]
    s = row[0]
    for j in range(1, len(row)):
        s = s * x + row[j]
    return float(min(max(lengths[i] + s, 0.0), lengths[-1]))


@subkernel
def newton_step(x: float, gap: float, slope: float, low: float, high: float) -> Three:
    """Take a Newton step from x to a root of a rising function, or bisect if it leads out of the bracket.

    Returns:
        The next x, and the ends of the bracket, from `low` to `high`, updated by the value `gap` at x.
    """
    if gap <= 0.0:
        low = x
    if gap >= 0.0:
        high = x
    trial = x - gap / slope
    return trial if slope > 0.0 and low <= trial <= high else 0.5 * (low + high), low, high


@subkernel
def parameter_at(length: LengthArrays, s: float) -> float:
    """Return the parameter at the arc length s, by Newton's method within a bracket."""
    edges = length.edges
    lengths = length.lengths
    i = interval_at(lengths, s, 0, len(lengths) - 1)
    row = length.series[i]
    local = s - lengths[i]
    low = -1.0
    high = 1.0
    x = min(max(2.0 * local / (lengths[i + 1] - lengths[i]) - 1.0, -1.0), 1.0)
    for _ in range(SPLINE.newton_steps):
        gap = row[0]
        slope = 0.0
        for j in range(1, len(row)):
            slope = slope * x + gap
            gap = gap * x + row[j]
        before = x
        x, low, high = newton_step(x, gap - local, slope, low, high)
        if abs(x - before) <= 2.0 * SPLINE.newton_tolerance:
            break
    u = 0.5 * ((1.0 - x) * edges[i] + (1.0 + x) * edges[i + 1])
    return float(min(max(u, edges[i]), edges[i + 1]))


@compiled
def parameters_at(length: LengthArrays, s: Array1) -> Array1:
    """Return the parameters (n,) at arc lengths s (n,)."""
    out = np.empty(len(s))
    for i in range(len(s)):
        out[i] = parameter_at(length, s[i])
    return out


@subkernel
def distance_at(spline: SplineArrays, u: float, p: Array1, work: Array2) -> float:
    """Return the distance from the point p (3,) to the curve at u."""
    x, y, z = value(spline, 0, span_at(spline, u), u, work)
    return float(np.sqrt((x - p[0]) ** 2 + (y - p[1]) ** 2 + (z - p[2]) ** 2))


@subkernel
def slopes(spline: SplineArrays, u: float, p: Array1, work: Array2) -> tuple[float, float]:
    """Return half the first and second derivatives of the squared distance from p (3,) by u."""
    span = span_at(spline, u)
    x, y, z = value(spline, 0, span, u, work)
    x = x - p[0]
    y = y - p[1]
    z = z - p[2]
    a, b, c = value(spline, 1, span, u, work)
    second = a * a + b * b + c * c
    if spline.degree > 1:
        d, e, f = value(spline, 2, span, u, work)
        second += x * d + y * e + z * f
    return x * a + y * b + z * c, second


@subkernel
def nearest_within(
    spline: SplineArrays, low: float, high: float, p: Array1, work: Array2
) -> tuple[float, float]:
    """Return the parameter of the point nearest to p (3,) within a short piece, and the distance."""
    best = low
    distance = distance_at(spline, low, p, work)
    at_high = distance_at(spline, high, p, work)
    if at_high < distance:
        best = high
        distance = at_high
    inner = np.nextafter(high, low)  # a corner there belongs to the next piece
    if slopes(spline, low, p, work)[0] < 0.0 and slopes(spline, inner, p, work)[0] > 0.0:
        u = 0.5 * (low + high)
        width = inner - low
        left = low
        right = inner
        for _ in range(SPLINE.newton_steps):
            gap, slope = slopes(spline, u, p, work)
            before = u
            u, left, right = newton_step(u, gap, slope, left, right)
            if abs(u - before) <= SPLINE.newton_tolerance * width:
                break
        inside = distance_at(spline, u, p, work)
        if inside <= distance:
            best = u
            distance = inside
    return best, distance


@compiled
def nearest_parameters(spline: SplineArrays, length: LengthArrays, pieces: int, points: Array2) -> Array2:
    """Find the points of the curve nearest to given points; one of them if several are equally near.

    The curve is cut into pieces. If the midpoint of a piece is at a distance d, and its ends at most r away
    from it along the curve, no part of it is nearer than d - r; all pieces that may contain the nearest point
    are searched.

    Args:
        spline: the spline.
        length: its arc length.
        pieces: minimum number of pieces.
        points: the points, (n, 3).

    Returns:
        Arc length and distance of each, (n, 2).
    """
    edges = length.edges
    parts = max(2, -(-pieces // len(length.series)))
    count = parts * len(length.series)
    work = np.empty((6, 3))
    ends = np.empty(count + 1)
    reach = np.empty(count)
    middles = np.empty((count, 3))
    for i in range(len(length.series)):
        for j in range(parts):
            ends[i * parts + j] = edges[i] + (edges[i + 1] - edges[i]) * (j / parts)
    ends[count] = edges[-1]
    s_low = 0.0
    for i in range(count):
        middle = 0.5 * (ends[i] + ends[i + 1])
        s_middle = length_at(length, middle)
        s_high = length_at(length, ends[i + 1])
        reach[i] = max(s_middle - s_low, s_high - s_middle)
        middles[i, 0], middles[i, 1], middles[i, 2] = value(spline, 0, span_at(spline, middle), middle, work)
        s_low = s_high
    found = np.empty((len(points), 2))
    away = np.empty(count)
    for k in range(len(points)):
        p = points[k]
        bound = np.inf
        for i in range(count):
            x = middles[i, 0] - p[0]
            y = middles[i, 1] - p[1]
            z = middles[i, 2] - p[2]
            away[i] = np.sqrt(x * x + y * y + z * z)
            bound = min(bound, away[i])
        best = 0.0
        distance = np.inf
        for i in range(count):
            if away[i] - reach[i] <= bound * (1.0 + 1e-12):
                u, d = nearest_within(spline, ends[i], ends[i + 1], p, work)
                if d < distance:
                    best = u
                    distance = d
                    bound = min(bound, d)
        found[k, 0] = length_at(length, best)
        found[k, 1] = distance
    return found


@subkernel
def half_square_slope(taylor: Array2, degree: int, x: float) -> tuple[float, float]:
    """Return the first and second derivatives by x of half the squared speed, given an expanded velocity."""
    value = 0.0
    slope = 0.0
    for axis in range(3):
        v = taylor[degree - 1, axis]
        dv = 0.0
        ddv = 0.0
        for p in range(degree - 2, -1, -1):
            ddv = ddv * x + 2.0 * dv
            dv = dv * x + v
            v = v * x + taylor[p, axis]
        value += v * dv
        slope += dv * dv + v * ddv
    return value, slope


@subkernel
def slowest_point(taylor: Array2, degree: int, low: float, high: float) -> float:
    """Return the x of the smallest speed between two bounds; NaN unless its slope changes sign between."""
    falls = half_square_slope(taylor, degree, low)[0]
    rises = half_square_slope(taylor, degree, high)[0]
    if not (falls < 0.0 and rises > 0.0):
        return np.nan
    x = 0.5 * (low + high)
    width = high - low
    for _ in range(SPLINE.newton_steps):
        gap, slope = half_square_slope(taylor, degree, x)
        before = x
        x, low, high = newton_step(x, gap, slope, low, high)
        if abs(x - before) <= SPLINE.newton_tolerance * width:
            break
    return x


@compiled
def find_stationary_point(taylors: Array3, breaks: Array1) -> float:
    """Find a parameter at which the speed vanishes.

    Args:
        taylors: from `expand_spans`, (k, degree, 3).
        breaks: ends of the knot spans, increasing, (k + 1,).

    Returns:
        The parameter; NaN if there is none.
    """
    spans = len(taylors)
    degree = taylors.shape[1]
    last = SPLINE.speed_samples - 1
    v = np.empty((spans, SPLINE.speed_samples))
    fastest = np.zeros(spans)
    overall = 0.0
    for i in range(spans):
        for j in range(SPLINE.speed_samples):
            v[i, j] = speed(taylors[i], degree, 2.0 * j / last - 1.0)
            fastest[i] = max(fastest[i], v[i, j])
        overall = max(overall, fastest[i])
    for i in range(spans):
        if fastest[i] <= 1e-9 * overall:
            return float(breaks[i])
    # The smallest speed is near a sample that is slower than its neighbours. Near a cusp that sample is much
    # slower than the fastest; on a circle all are equal up to rounding, and no search is needed.
    for i in range(spans):
        for j in range(SPLINE.speed_samples):
            before = max(j - 1, 0)
            after = min(j + 1, last)
            if v[i, j] <= min(v[i, before], v[i, after]) and v[i, j] < 0.9 * fastest[i]:
                x = slowest_point(taylors[i], degree, 2.0 * before / last - 1.0, 2.0 * after / last - 1.0)
                if speed(taylors[i], degree, x) <= SPLINE.stationary_speed * fastest[i]:  # False if NaN
                    return float(0.5 * ((1.0 - x) * breaks[i] + (1.0 + x) * breaks[i + 1]))
    for i in range(spans):
        if v[i, 0] <= SPLINE.stationary_speed * fastest[i]:
            return float(breaks[i])
    for i in range(spans):
        if v[i, last] <= SPLINE.stationary_speed * fastest[i]:
            return float(np.nextafter(breaks[i + 1], breaks[i]))
    return np.nan
