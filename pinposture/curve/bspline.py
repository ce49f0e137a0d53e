"""The one representation of every curve, and the map between its parameter and its arc length."""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.polynomial import legendre
from numpy.typing import ArrayLike, NDArray
from scipy.interpolate import BSpline

from pinposture import kernels
from pinposture._validation import LARGEST_COORDINATE, SMALLEST, as_count, as_points
from pinposture.errors import CurveError

# The one representation of every curve: knots, coefficients, degree, and what makes them sound.

Array = NDArray[np.float64]

MAX_DEGREE = 5
_NARROW = 1e-14  # of the whole: knots closer than this are lost in rounding


class Parts(NamedTuple):
    """What a B-spline is made of, unchecked.

    Attributes:
        knots: shape (n + degree + 1,).
        coefficients: shape (n, 3) [m].
        degree: 1 to 5.
    """

    knots: Array
    coefficients: Array
    degree: int


@dataclass(frozen=True, eq=False)
class Spline:
    """A B-spline as kernels want it. The arrays are writeable for their sake; nobody writes.

    Attributes:
        knots: shape (n + degree + 1,), not decreasing.
        table: coefficients of the spline (n, 3) [m], of its first derivative, and so on (see
            `kernels.spline_coefficients`), shape (degree + 1, n, 3).
        degree: 1 to 5.
        breaks: ends of the knot spans that the curve runs through, increasing.
    """

    knots: Array
    table: Array
    degree: int
    breaks: Array

    def values(self, u: Array, order: int = 0) -> Array:
        """Places, or derivatives of an order by the parameter, shape (n, 3), at the parameters u (n,)."""
        return kernels.spline_values(self.knots, self.table, self.degree, order, u)

    def with_coefficients(self, coefficients: Array) -> Spline:
        """Another spline on the same knots."""
        table = kernels.spline_coefficients(self.knots, coefficients, self.degree)
        return Spline(self.knots, table, self.degree, self.breaks)


def make_spline(knots: ArrayLike, coefficients: ArrayLike, degree: object) -> Spline:
    """Make a B-spline of knots, coefficients and degree that may come from anywhere.

    Args:
        knots: not decreasing, shape (n + degree + 1,).
        coefficients: shape (n, 3) or (n, 2) [m].
        degree: 1 to 5.

    Raises:
        InvalidValue: the degree.
        CurveError: the knots or coefficients, or a gap in the curve.
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
    breaks = _checked_breaks(t, k)
    return Spline(t, kernels.spline_coefficients(t, c, k), k, breaks)


def _checked_breaks(t: Array, k: int) -> Array:
    """Ends of the knot spans, if the knots are sound."""
    wrong = ~(np.abs(t) <= LARGEST_COORDINATE)
    if wrong.any():
        i = int(np.flatnonzero(wrong)[0])
        raise CurveError(f"knot {i}", f"{t[i]}; allowed: finite numbers up to {LARGEST_COORDINATE:g} in size")
    begin, end = t[k], t[-k - 1]
    if end - begin <= SMALLEST:
        raise CurveError("knots", f"the curve runs from knot {begin} to {end}; allowed: an increase")
    gaps = t[1:] - t[:-1]
    wrong = (gaps != 0) & (gaps < _NARROW * (end - begin))
    if wrong.any():
        i = int(np.flatnonzero(wrong)[0])
        raise CurveError(
            f"knots {i} and {i + 1}",
            f"{t[i]}, {t[i + 1]}; allowed: equal, or an increase by more than {_NARROW:g} of the whole",
        )
    wrong = (t[k:] == t[:-k]) & (t[k:] > begin) & (t[k:] < end)
    if wrong.any():
        value = t[k:][wrong][0]
        raise CurveError(
            f"knot {value}",
            f"given {np.sum(t == value)} times, which breaks the curve; allowed: at most {k} times",
        )
    inner = t[k : len(t) - k]
    return np.append(begin, inner[1:][gaps[k : len(gaps) - k] > 0])


def refuse_standstill(spline: Spline, taylors: Array) -> None:
    """Refuse a curve that stands still somewhere, where it has no tangent.

    Args:
        spline: the curve.
        taylors: its velocity, of `kernels.expand_spans`.

    Raises:
        CurveError: naming the place.
    """
    u = kernels.find_stationary_point(taylors, spline.breaks)
    if not np.isnan(u):
        x, y, z = spline.values(np.array([u]))[0]
        raise CurveError(
            f"curve at ({x:.6g}, {y:.6g}, {z:.6g})",
            "its speed vanishes there, a cusp or a turn on the spot without a tangent; "
            "allowed: control points that lead through it in one direction",
        )


def trim(whole: Spline, begin: float, end: float) -> Parts:
    """Give the part of a spline between two of its parameters.

    The ends are not clamped: a knot is put in at each and those beyond stay. Clamping would divide
    coefficients by powers of the short first span, and lose the third derivative in rounding.
    """
    spline = BSpline(whole.knots, whole.table[0], whole.degree)
    k, near = spline.k, 1e-12 * (end - begin)
    ends = []
    for u in (begin, end):
        knot = float(spline.t[np.abs(spline.t - u).argmin()])
        if abs(knot - u) > near:
            spline, knot = spline.insert_knot(u), u
        ends.append(knot)
    first = int(np.searchsorted(spline.t, ends[0], side="right")) - 1
    last = int(np.searchsorted(spline.t, ends[1], side="left"))
    return Parts(spline.t[first - k : last + k + 1], spline.c[first - k : last], k)


# The map between a curve's parameter and its arc length.

Values = NDArray[np.float64]

N = 12  # Gauss nodes to a piece
TAIL = 1e-12  # of the whole length: largest last terms of a piece's series


def _rule() -> Values:
    """What `kernels.measure_length` integrates by, (N, 1 + N + N + 1)."""
    nodes, weights = legendre.leggauss(N)
    # Values at the nodes -> Legendre coefficients of their interpolant (the discrete transform is exact).
    modes = legendre.legvander(nodes, N - 1) * weights[:, None] * (np.arange(N) + 0.5)
    # Those of the speed -> Legendre coefficients of its integral from -1 -> power coefficients.
    integral = np.stack([legendre.legint(mode, lbnd=-1) for mode in np.eye(N)])
    powers = np.zeros((N + 1, N + 1))
    for degree in range(N + 1):
        powers[degree, N - degree :] = legendre.leg2poly(np.eye(N + 1)[degree, : degree + 1])[::-1]
    return np.column_stack([nodes, modes, integral @ powers])


_RULE = _rule()


@dataclass(frozen=True, eq=False)
class ArcLength:
    """Arc length s as a function of the parameter u: a polynomial on each of many short pieces.

    The speed is sampled at Gauss nodes on pieces of the knot spans; pieces are halved until the Legendre
    series of the speed has died out. Its integral is the arc length; Newton's method on the polynomial
    inverts it.

    Attributes:
        edges: parameters where the pieces meet, shape (k + 1,).
        lengths: arc length at the edges, shape (k + 1,) [m].
        series: power coefficients, highest first, of each piece's length in x from -1 to 1, shape (k, N + 1)
            [m].
        total: the whole length [m].
    """

    edges: Values
    lengths: Values
    series: Values
    total: float

    @classmethod
    def of(cls, spline: Spline) -> ArcLength:
        """Measure a spline.

        Raises:
            CurveError: it stands still somewhere.
        """
        parts = (spline.knots, spline.table, spline.degree, spline.breaks)
        taylors = kernels.expand_spans(*parts)
        refuse_standstill(spline, taylors)
        edges, lengths, series = kernels.measure_length(
            *parts, taylors, _RULE, TAIL, rounding(spline.table[0])
        )
        return cls(edges, lengths, series, float(lengths[-1]))

    def parameter(self, s: Values) -> Values:
        """Parameters (n,) at the arc lengths s (n,) [m], within [0, total]."""
        return kernels.parameters_at(self.edges, self.lengths, self.series, s)


def rounding(coefficients: Values) -> float:
    """Error in the length of a span that rounding of the coefficients may cause [m]."""
    return float(64 * np.finfo(float).eps * np.abs(coefficients).max())
