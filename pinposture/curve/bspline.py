"""B-splines, which represent every curve, and the map between their parameter and their arc length."""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.polynomial import legendre
from numpy.typing import ArrayLike, NDArray
from scipy.interpolate import BSpline

from pinposture import kernels
from pinposture._validation import LARGEST_COORDINATE, SMALLEST_DISTANCE, as_count, as_points
from pinposture.errors import CurveError

Array = NDArray[np.float64]

MAX_DEGREE = 5
GAUSS_NODES = 12
"""Gauss nodes per piece of the arc length."""
LENGTH_TOLERANCE = 1e-12
"""Largest last terms of the series of a piece, relative to the whole length."""
_MIN_SPAN = 1e-14  # of the whole: knots closer than this are lost in rounding


class Parts(NamedTuple):
    """The knots, coefficients and degree of a B-spline, unchecked."""

    knots: Array  # shape (n + degree + 1,)
    coefficients: Array  # shape (n, 3) [m]
    degree: int  # 1 to 5


@dataclass(frozen=True, eq=False)
class Spline:
    """A B-spline in the arrays that kernels take; these are writeable for numba, but do not write to them."""

    knots: Array  # shape (n + degree + 1,), not decreasing
    # coefficients of the spline (n, 3) [m], of its first derivative, and so on (see
    # `kernels.spline_coefficients`), shape (degree + 1, n, 3)
    table: Array
    degree: int  # 1 to 5
    breaks: Array  # ends of the knot spans that the curve runs through, increasing

    def values(self, u: Array, order: int = 0) -> Array:
        """Evaluate the spline or a derivative by the parameter, shape (n, 3), at the parameters u (n,)."""
        return kernels.spline_values(self.knots, self.table, self.degree, order, u)

    def with_coefficients(self, coefficients: Array) -> Spline:
        """Return another spline on the same knots."""
        table = kernels.spline_coefficients(self.knots, coefficients, self.degree)
        return Spline(self.knots, table, self.degree, self.breaks)


def make_spline(knots: ArrayLike, coefficients: ArrayLike, degree: object) -> Spline:
    """Check knots, coefficients and degree, and make a B-spline of them.

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
    """Check the knots and return the ends of the knot spans."""
    wrong = ~(np.abs(t) <= LARGEST_COORDINATE)
    if wrong.any():
        i = int(np.flatnonzero(wrong)[0])
        raise CurveError(f"knot {i}", f"{t[i]}; allowed: finite numbers up to {LARGEST_COORDINATE:g} in size")
    begin, end = t[k], t[-k - 1]
    if end - begin <= SMALLEST_DISTANCE:
        raise CurveError("knots", f"the curve runs from knot {begin} to {end}; allowed: an increase")
    gaps = t[1:] - t[:-1]
    wrong = (gaps != 0) & (gaps < _MIN_SPAN * (end - begin))
    if wrong.any():
        i = int(np.flatnonzero(wrong)[0])
        raise CurveError(
            f"knots {i} and {i + 1}",
            f"{t[i]}, {t[i + 1]}; allowed: equal, or an increase by more than {_MIN_SPAN:g} of the whole",
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
    """Raise CurveError if the velocity, of `kernels.expand_spans`, vanishes somewhere; names the place."""
    u = kernels.find_stationary_point(taylors, spline.breaks)
    if not np.isnan(u):
        x, y, z = spline.values(np.array([u]))[0]
        raise CurveError(
            f"curve at ({x:.6g}, {y:.6g}, {z:.6g})",
            "its speed vanishes there, a cusp or a turn on the spot without a tangent; "
            "allowed: control points that lead through it in one direction",
        )


def trim(whole: Spline, begin: float, end: float) -> Parts:
    """Return the part of a spline between two of its parameters.

    A knot is inserted at each end and those beyond stay. Clamping the ends would divide coefficients by
    powers of the short first span, and lose the third derivative in rounding.
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


def _rule() -> Array:
    """Return the integration rule of `kernels.measure_length`, (N, 1 + N + N + 1) for N Gauss nodes."""
    n = GAUSS_NODES
    nodes, weights = legendre.leggauss(n)
    # Array at the nodes -> Legendre coefficients of their interpolant (the discrete transform is exact).
    modes = legendre.legvander(nodes, n - 1) * weights[:, None] * (np.arange(n) + 0.5)
    # Those of the speed -> Legendre coefficients of its integral from -1 -> power coefficients.
    integral = np.stack([legendre.legint(mode, lbnd=-1) for mode in np.eye(n)])
    powers = np.zeros((n + 1, n + 1))
    for degree in range(n + 1):
        powers[degree, n - degree :] = legendre.leg2poly(np.eye(n + 1)[degree, : degree + 1])[::-1]
    return np.column_stack([nodes, modes, integral @ powers])


_RULE = _rule()


@dataclass(frozen=True, eq=False)
class ArcLength:
    """Arc length s as a function of the parameter u: a polynomial on each of many short pieces.

    The speed is sampled at Gauss nodes on pieces of the knot spans; pieces are halved until the Legendre
    series of the speed has died out. Its integral is the arc length; Newton's method on the polynomial
    inverts it.
    """

    edges: Array  # parameters where the pieces meet, shape (k + 1,)
    lengths: Array  # arc length at the edges, shape (k + 1,) [m]
    # power coefficients, highest first, of each piece's length in x from -1 to 1, (k, GAUSS_NODES + 1) [m]
    series: Array
    total: float  # the whole length [m]

    @classmethod
    def of(cls, spline: Spline) -> ArcLength:
        """Measure a spline; raises CurveError if its velocity vanishes somewhere."""
        parts = (spline.knots, spline.table, spline.degree, spline.breaks)
        taylors = kernels.expand_spans(*parts)
        refuse_standstill(spline, taylors)
        error = rounding(spline.table[0])
        edges, lengths, series = kernels.measure_length(*parts, taylors, _RULE, LENGTH_TOLERANCE, error)
        return cls(edges, lengths, series, float(lengths[-1]))

    def parameter(self, s: Array) -> Array:
        """Return the parameters (n,) at arc lengths (n,) [m] within [0, total]."""
        return kernels.parameters_at(self.edges, self.lengths, self.series, s)


def rounding(coefficients: Array) -> float:
    """Return the error in the length of a span that rounding of the coefficients may cause [m]."""
    return float(64 * np.finfo(float).eps * np.abs(coefficients).max())
