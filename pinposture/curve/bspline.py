"""The one representation of every curve: knots, coefficients, degree, and what makes them sound."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.interpolate import BSpline

from pinposture.curve.checks import LARGEST, SMALLEST, as_count, as_points
from pinposture.curve.newton import crossings
from pinposture.errors import CurveError

MAX_DEGREE = 5
_SAMPLES = 9  # places in a span where the speed is looked at
_NARROW = 1e-14  # of the whole: knots closer than this are lost in rounding
_STILL = 1e-6  # of the largest speed in its span: a speed that vanishes


def make_bspline(knots: ArrayLike, coefficients: ArrayLike, degree: object) -> BSpline:
    """Make a B-spline of knots, coefficients and degree that may come from anywhere.

    Args:
        knots: not decreasing, shape (n + degree + 1,).
        coefficients: shape (n, 3) or (n, 2) [m].
        degree: 1 to 5.

    Raises:
        InvalidValue: the degree.
        CurveError: the knots or coefficients, a gap in the curve, or a cusp.
    """
    k = as_count("degree", degree, 1, MAX_DEGREE)
    c = as_points(coefficients, k + 1, "coefficient {}".format)
    try:
        t = np.array(knots, dtype=float)
    except (TypeError, ValueError):
        raise CurveError("knots", "not a list of numbers") from None
    if t.shape != (len(c) + k + 1,):
        raise CurveError(
            "knots",
            f"shape {t.shape}; {len(c)} coefficients of degree {k} need a list of {len(c) + k + 1} numbers",
        )
    _check_knots(t, k)
    spline = BSpline(t, c, k)
    check_regular(spline)
    return spline


def _check_knots(t: NDArray[np.float64], k: int) -> None:
    wrong = np.flatnonzero(~(np.abs(t) <= LARGEST))
    if wrong.size:
        raise CurveError(
            f"knot {wrong[0]}", f"{t[wrong[0]]}; allowed: finite numbers up to {LARGEST:g} in size"
        )
    begin, end = t[k], t[-k - 1]
    if end - begin <= SMALLEST:
        raise CurveError("knots", f"the curve runs from knot {begin} to {end}; allowed: an increase")
    gaps = np.diff(t)
    wrong = np.flatnonzero((gaps < 0) | ((gaps > 0) & (gaps < _NARROW * (end - begin))))
    if wrong.size:
        i = int(wrong[0])
        raise CurveError(
            f"knots {i} and {i + 1}",
            f"{t[i]}, {t[i + 1]}; allowed: equal, or an increase by more than {_NARROW:g} of the whole",
        )
    values, times = np.unique(t, return_counts=True)
    wrong = np.flatnonzero((values > begin) & (values < end) & (times > k))
    if wrong.size:
        value, n = values[wrong[0]], times[wrong[0]]
        raise CurveError(
            f"knot {value}", f"given {n} times, which breaks the curve; allowed: at most {k} times"
        )


def breaks(spline: BSpline) -> NDArray[np.float64]:
    """Ends of the knot spans that the curve runs through, increasing."""
    return np.asarray(np.unique(spline.t[spline.k : len(spline.t) - spline.k]))


def derivative(spline: BSpline, u: NDArray[np.float64], order: int) -> NDArray[np.float64]:
    """Derivative of the spline, (n, 3), at the parameters u (n,)."""
    if order > spline.k:  # zero; older versions of scipy end the process instead
        return np.zeros((*np.shape(u), spline.c.shape[1]))
    return np.asarray(spline(u, order))


def speed(spline: BSpline, u: NDArray[np.float64]) -> NDArray[np.float64]:
    """Speed (n,) [m per unit of parameter] at the parameters u (n,)."""
    velocity = derivative(spline, u, 1)
    return np.asarray(np.sqrt(np.einsum("ni,ni->n", velocity, velocity)))


def check_regular(spline: BSpline) -> None:
    """Refuse a curve that stands still somewhere, where it has no tangent.

    Raises:
        CurveError: naming the place.
    """
    ends = breaks(spline)
    u = ends[:-1, None] + np.diff(ends)[:, None] * np.linspace(0, 1, _SAMPLES)
    u[:, -1] = np.nextafter(ends[1:], ends[:-1])  # the limit from inside the span
    v = speed(spline, u.ravel()).reshape(u.shape)
    fastest = v.max(axis=1)
    dull = np.flatnonzero(fastest <= 1e-9 * fastest.max())
    if dull.size:
        _refuse(spline, float(u[dull[0], 0]))
    # The least speed lies beside a sample that is slower than its neighbours. Next to a cusp one is far
    # slower than the fastest; on a circle they are equal but for rounding, and not worth a search.
    padded = np.pad(v, ((0, 0), (1, 1)), constant_values=np.inf)
    low_point = (v <= padded[:, :-2]) & (v <= padded[:, 2:]) & (v < 0.9 * fastest[:, None])
    span, sample = np.nonzero(low_point)
    low = u[span, np.maximum(sample - 1, 0)]
    high = u[span, np.minimum(sample + 1, _SAMPLES - 1)]

    def half_square_slope(x: NDArray[np.float64]) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        d1, d2, d3 = (derivative(spline, x, order) for order in (1, 2, 3))
        value = np.einsum("ni,ni->n", d1, d2)
        return value, np.einsum("ni,ni->n", d2, d2) + np.einsum("ni,ni->n", d1, d3)

    inside = (half_square_slope(low)[0] < 0) & (half_square_slope(high)[0] > 0)
    low, high = low[inside], high[inside]
    least = crossings(half_square_slope, low, high, 0.5 * (low + high))
    places = np.concatenate([least, u[:, 0], u[:, -1]])
    every = np.arange(len(u))
    stops = np.flatnonzero(
        speed(spline, places) <= _STILL * fastest[np.concatenate([span[inside], every, every])]
    )
    if stops.size:
        _refuse(spline, float(places[stops[0]]))


def _refuse(spline: BSpline, u: float) -> None:
    x, y, z = spline(u)
    raise CurveError(
        f"curve at ({x:.6g}, {y:.6g}, {z:.6g})",
        "its speed vanishes there, a cusp or a turn on the spot without a tangent; "
        "allowed: control points that lead through it in one direction",
    )


def trim(spline: BSpline, begin: float, end: float) -> BSpline:
    """Give the part of a spline between two of its parameters.

    The ends are not clamped: a knot is put in at each and those beyond stay. Clamping would divide
    coefficients by powers of the short first span, and lose the third derivative in rounding.
    """
    k, near = spline.k, 1e-12 * (end - begin)
    ends = []
    for u in (begin, end):
        knot = float(spline.t[np.abs(spline.t - u).argmin()])
        if abs(knot - u) > near:
            spline, knot = spline.insert_knot(u), u
        ends.append(knot)
    first = int(np.searchsorted(spline.t, ends[0], side="right")) - 1
    last = int(np.searchsorted(spline.t, ends[1], side="left"))
    return BSpline(spline.t[first - k : last + k + 1], spline.c[first - k : last], k)
