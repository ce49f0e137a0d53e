"""Curves as B-splines: points, tangents and curvature by arc length, and nearest points."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from functools import cache
from typing import Any, NamedTuple, TypeAlias, TypeVar, overload

import numpy as np
from numpy.polynomial import legendre
from numpy.typing import ArrayLike, NDArray
from scipy.interpolate import BSpline

from pinposture import kernels
from pinposture._validation import LARGEST_COORDINATE, SMALLEST_LENGTH, as_count, as_points
from pinposture.errors import CurveError, InvalidValue
from pinposture.kernels.arrays import LengthArrays, SplineArrays
from pinposture.units import ROUNDING

Array = NDArray[np.float64]

MAX_DEGREE = 5


class CurveTolerances(NamedTuple):
    """Which differences of curves are due to rounding."""

    length: float = 1e-12
    """Tolerance of the last terms of the series of a piece, relative to the total length."""

    span: float = 1e-14
    """Smallest distance of knots above rounding errors, relative to the whole range."""

    curvature: float = 1e-6
    """Curvature times length below which a curve counts as straight."""


TOLERANCES = CurveTolerances()


Parts: TypeAlias = tuple[Array, Array, int]
"""The knots, coefficients and degree of a B-spline, unchecked."""


def make_spline(knots: ArrayLike, coefficients: ArrayLike, degree: object) -> SplineArrays:
    """Create a B-spline from checked knots, coefficients and degree; do not write to its arrays.

    Args:
        knots: not decreasing, shape (n + degree + 1,).
        coefficients: shape (n, 3) or (n, 2) [m].
        degree: 1 to 5.

    Raises:
        InvalidValue: invalid degree.
        CurveError: invalid knots or coefficients, or a gap in the curve.
    """
    k = as_count("degree", degree, 1, MAX_DEGREE)
    c = as_points(coefficients, k + 1, "coefficient {}".format)
    try:
        t = np.array(knots, dtype=float)
    except (TypeError, ValueError, OverflowError):
        raise CurveError("knots", "not a list of numbers") from None
    if t.shape != (len(c) + k + 1,):
        raise CurveError(
            "knots",
            f"shape {t.shape}; {len(c)} coefficients of degree {k} need a list of {len(c) + k + 1} numbers",
        )
    breaks = _checked_breaks(t, k)
    return SplineArrays(t, kernels.spline_coefficients(t, c, k), k, breaks)


def _checked_breaks(t: Array, k: int) -> Array:
    """Check the knots and return the ends of the knot spans."""
    wrong = ~(np.abs(t) <= LARGEST_COORDINATE)
    if wrong.any():
        i = int(np.flatnonzero(wrong)[0])
        raise CurveError(f"knot {i}", f"{t[i]}; allowed: finite numbers up to {LARGEST_COORDINATE:g} in size")
    begin = t[k]
    end = t[-k - 1]
    if end - begin <= SMALLEST_LENGTH:
        raise CurveError("knots", f"the curve runs from knot {begin} to {end}; allowed: an increase")
    gaps = t[1:] - t[:-1]
    least = TOLERANCES.span
    wrong = (gaps != 0) & (gaps < least * (end - begin))
    if wrong.any():
        i = int(np.flatnonzero(wrong)[0])
        raise CurveError(
            f"knots {i} and {i + 1}",
            f"{t[i]}, {t[i + 1]}; allowed: equal, or an increase by more than {least:g} of the whole",
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


def refuse_standstill(spline: SplineArrays, taylors: Array) -> None:
    """Raise CurveError if the velocity, from `kernels.expand_spans`, vanishes somewhere; names the point."""
    u = kernels.find_stationary_point(taylors, spline.breaks)
    if not np.isnan(u):
        x, y, z = kernels.spline_values(spline, 0, np.array([u]))[0]
        raise CurveError(
            f"curve at ({x:.6g}, {y:.6g}, {z:.6g})",
            "its speed vanishes there (a cusp or a reversal), so it has no tangent; "
            "allowed: control points that pass through it in one direction",
        )


def trim(whole: SplineArrays, begin: float, end: float) -> Parts:
    """Return the part of a spline between two of its parameters.

    A knot is inserted at each end, and knots beyond it are kept. Clamping the ends would divide coefficients
    by powers of the short first span, and the third derivative would be lost to rounding errors.
    """
    spline = BSpline(whole.knots, whole.table[0], whole.degree)
    k = spline.k
    near = 1e-12 * (end - begin)
    ends = []
    for u in (begin, end):
        knot = float(spline.t[np.abs(spline.t - u).argmin()])
        if abs(knot - u) > near:
            spline = spline.insert_knot(u)
            knot = u
        ends.append(knot)
    first = int(np.searchsorted(spline.t, ends[0], side="right")) - 1
    last = int(np.searchsorted(spline.t, ends[1], side="left"))
    return spline.t[first - k : last + k + 1], spline.c[first - k : last], k


@cache
def _rule() -> Array:
    """Return the integration rule of `kernels.measure_length`, (N, 1 + N + N + 1) for N Gauss nodes."""
    n = 12
    nodes, weights = legendre.leggauss(n)
    # Values at the nodes -> Legendre coefficients of their interpolant (the discrete transform is exact).
    modes = legendre.legvander(nodes, n - 1) * weights[:, None] * (np.arange(n) + 0.5)
    # Legendre coefficients of the speed -> those of its integral from -1 -> power coefficients.
    integral = np.stack([legendre.legint(mode, lbnd=-1) for mode in np.eye(n)])
    powers = np.zeros((n + 1, n + 1))
    for degree in range(n + 1):
        powers[degree, n - degree :] = legendre.leg2poly(np.eye(n + 1)[degree, : degree + 1])[::-1]
    return np.column_stack([nodes, modes, integral @ powers])


def measure(spline: SplineArrays) -> LengthArrays:
    """Measure the arc length of a spline; raises CurveError if its velocity vanishes somewhere.

    The speed is sampled at Gauss nodes on pieces of the knot spans; pieces are halved until the Legendre
    series of the speed has converged. Its integral is the arc length, which is inverted by Newton's method.
    """
    taylors = kernels.expand_spans(spline)
    refuse_standstill(spline, taylors)
    return kernels.measure_length(spline, taylors, _rule(), TOLERANCES.length, rounding(spline.table[0]))


def rounding(coefficients: Array) -> float:
    """Return the possible error in the length of a span due to rounding of the coefficients [m]."""
    return float(64 * np.finfo(float).eps * np.abs(coefficients).max())


Made = TypeVar("Made", bound="Geometry")
Lengths = Sequence[float] | NDArray[Any]


class Nearest(NamedTuple):
    """The points of a curve nearest to given points; single numbers for a single point.

    Attributes:
        parameter: arc length from the start of the curve, shape (n,) [m].
        distance: distance from the given point, shape (n,) [m].
    """

    parameter: Array
    distance: Array


@dataclass(frozen=True, eq=False, repr=False)
class Geometry:
    """A B-spline parameterized by arc length s, which ranges from 0 to `length`.

    Queries take a single arc length and return a float or shape (3,), or take shape (n,) and return shape
    (n,) or (n, 3). Arc lengths up to 1e-9 of the length beyond the ends count as the end; others raise
    InvalidValue. At a corner (degree 1, or repeated knots) a query refers to the following part.

    Attributes:
        knots: shape (n + degree + 1,), not decreasing; the curve runs from knots[degree] to knots[n].
        coefficients: B-spline coefficients, shape (n, 3) [m], in the frame of the original points.
        degree: 1 to 5.

    Raises:
        CurveError: invalid knots or coefficients, or a curve whose speed vanishes somewhere (a cusp).
        InvalidValue: invalid degree.
    """

    knots: Array
    coefficients: Array
    degree: int
    _spline: SplineArrays = field(init=False)
    _arc: LengthArrays = field(init=False)

    def __post_init__(self) -> None:
        spline = make_spline(self.knots, self.coefficients, self.degree)
        self._set(spline, measure(spline))

    def _set(self, spline: SplineArrays, arc: LengthArrays) -> None:
        knots = spline.knots.view()
        coefficients = spline.table[0].view()
        knots.flags.writeable = coefficients.flags.writeable = False
        self.__dict__.update(knots=knots, coefficients=coefficients, degree=spline.degree)
        self.__dict__.update(_spline=spline, _arc=arc)

    def _with_coefficients(self: Made, coefficients: Array, stretch: float) -> Made:
        """Return the curve after a motion that is rigid up to a relative stretch.

        The measured length is kept if stretch and rounding change it by less than its tolerance.
        """
        change = max(stretch * self.length, rounding(coefficients))
        if not (
            np.abs(coefficients).max() <= LARGEST_COORDINATE and change <= TOLERANCES.length * self.length
        ):
            return type(self)(self.knots, coefficients, self.degree)
        moved = object.__new__(type(self))
        table = kernels.spline_coefficients(self._spline.knots, coefficients, self.degree)
        moved._set(self._spline._replace(table=table), self._arc)
        return moved

    def __reduce__(self) -> tuple[Any, ...]:
        # Rebuilt, because unpickled arrays would be writeable.
        return type(self), (self.knots, self.coefficients, self.degree)

    def __eq__(self, other: object) -> bool:
        """Return whether degree, knots and coefficients are identical."""
        if not isinstance(other, Geometry):
            return NotImplemented
        return (
            self.degree == other.degree
            and np.array_equal(self.knots, other.knots)
            and np.array_equal(self.coefficients, other.coefficients)
        )

    def __hash__(self) -> int:
        # Adding 0 turns -0 into 0, which compares equal.
        return hash((self.degree, (self.knots + 0.0).tobytes(), (self.coefficients + 0.0).tobytes()))

    def __repr__(self) -> str:
        ends = np.stack([self.start, self.end])
        ends[np.abs(ends) < ROUNDING * self.length] = 0
        begin, end = (", ".join(f"{x:.4g}" for x in point) for point in ends)
        spans = len(self._spline.breaks) - 1
        return (
            f"{type(self).__name__}(length {self.length:.6g} m, from ({begin}) to ({end}), "
            f"degree {self.degree}, {spans} span{'s' * (spans != 1)})"
        )

    @property
    def length(self) -> float:
        """Arc length from start to end [m]."""
        return float(self._arc.lengths[-1])

    @property
    def measured(self) -> tuple[SplineArrays, LengthArrays]:
        """The spline and its arc length as arguments for kernels; do not write to their arrays."""
        return self._spline, self._arc

    @property
    def start(self) -> Array:
        """Start point, shape (3,) [m]."""
        return self.at(0.0)

    @property
    def end(self) -> Array:
        """End point, shape (3,) [m]."""
        return self.at(self.length)

    @property
    def dimension(self) -> int:
        """2 if all coefficients lie in one plane, to within 1e-9 of the length, else 3."""
        offsets = self.coefficients - self.coefficients.mean(axis=0)
        # The covariance would square the rounding errors.
        normal = np.linalg.svd(offsets, full_matrices=len(offsets) < 3)[2][2]
        return 2 if float(np.abs(offsets @ normal).max()) <= ROUNDING * self.length else 3

    def at(self, s: float | Lengths) -> Array:
        """Return points, shape (n, 3) or (3,) [m], at the arc lengths `s` [m]."""
        u, shape = self._parameter(s)
        return _shaped(self._values(u), shape)

    def tangent(self, s: float | Lengths) -> Array:
        """Return unit tangents, shape (n, 3) or (3,), towards the end, at the arc lengths `s` [m]."""
        u, shape = self._parameter(s)
        velocity = self._values(u, 1)
        return _shaped(velocity / np.linalg.norm(velocity, axis=1)[:, None], shape)

    @overload
    def curvature(self, s: float) -> float: ...
    @overload
    def curvature(self, s: Lengths) -> Array: ...
    def curvature(self, s: float | Lengths) -> float | Array:
        """Return the curvature, shape (n,) or a float [1/m], 0 or more, at the arc lengths `s` [m]."""
        u, shape = self._parameter(s)
        bending, v = self._bending(u)
        return _scalar(np.linalg.norm(bending, axis=1) / v**3, shape)

    @overload
    def torsion(self, s: float) -> float: ...
    @overload
    def torsion(self, s: Lengths) -> Array: ...
    def torsion(self, s: float | Lengths) -> float | Array:
        """Return the torsion, shape (n,) or a float [1/m], at the arc lengths `s` [m].

        It is positive on a right-handed helix. It is 0 on plane curves (`dimension` 2), and where the
        curvature is below 1e-6 / length, because it is meaningless there.
        """
        u, shape = self._parameter(s)
        bending, v = self._bending(u)
        square = np.einsum("ni,ni->n", bending, bending)
        bent = np.sqrt(square) * self.length > TOLERANCES.curvature * v**3
        volume = np.einsum("ni,ni->n", bending, self._values(u, 3))
        torsion = np.divide(volume, square, out=np.zeros_like(v), where=bent & (self.dimension == 3))
        return _scalar(torsion, shape)

    def resample(self, n: int) -> Array:
        """Return n >= 2 points at equal steps of arc length from start to end, shape (n, 3) [m]."""
        return self.at(np.linspace(0, self.length, as_count("n", n, 2, 10_000_000)))

    def nearest(self, points: ArrayLike) -> Nearest:
        """Find the nearest points of the whole curve.

        Args:
            points: shape (n, 3), or (n, 2) with z = 0, or one point of shape (3,) or (2,) [m].

        Returns:
            Arc lengths and distances; if several points are equally near, one of them.

        Raises:
            CurveError: points are malformed or not finite.
        """
        try:
            one = np.ndim(points) == 1 and np.size(points) > 0
        except ValueError:  # rows of different lengths
            one = False
        checked = as_points(np.asarray(points)[None] if one else points, least=0)
        spline, length = self.measured
        pieces = 256  # at least, among which the nearest is sought
        nearest = kernels.nearest_parameters(spline, length, pieces, checked)
        parameter = nearest[:, 0].copy()
        distance = nearest[:, 1].copy()
        return Nearest(parameter[0], distance[0]) if one else Nearest(parameter, distance)

    def _values(self, u: Array, order: int = 0) -> Array:
        """Evaluate the spline or a derivative by its parameter, (n, 3), at the parameters u (n,)."""
        return kernels.spline_values(self._spline, order, u)

    def _parameter(self, s: ArrayLike) -> tuple[Array, tuple[int, ...]]:
        """Return the spline parameters (n,) at arc lengths, and the shape of the latter."""
        slack = ROUNDING * self.length
        if type(s) is float and -slack <= s <= self.length + slack:
            return kernels.parameters_at(self._arc, np.array([min(max(s, 0.0), self.length)])), ()
        try:
            values = np.asarray(s)
        except ValueError:
            raise self._out_of_range("s", s) from None
        if values.dtype.kind not in "iuf" or values.ndim > 1:
            raise self._out_of_range("s", s)
        inside = (values >= -slack) & (values <= self.length + slack)  # false for NaN
        if not inside.all():
            i = int(np.flatnonzero(~inside)[0])
            raise self._out_of_range("s" if values.ndim == 0 else f"s[{i}]", float(values.flat[i]))
        clipped = np.minimum(np.maximum(np.atleast_1d(values), 0.0), self.length)
        return kernels.parameters_at(self._arc, clipped.astype(float)), values.shape

    def _out_of_range(self, name: str, value: object) -> InvalidValue:
        allowed = f"arc lengths from 0 to {self.length:.10g} m, one or an array of shape (n,)"
        return InvalidValue(name, value, allowed)

    def _bending(self, u: Array) -> tuple[Array, Array]:
        """Return the cross product of first and second derivative (n, 3), and the speed (n,)."""
        velocity = self._values(u, 1)
        return np.cross(velocity, self._values(u, 2)), np.linalg.norm(velocity, axis=1)


def _shaped(points: Array, shape: tuple[int, ...]) -> Array:
    return points if shape else points[0]


def _scalar(values: Array, shape: tuple[int, ...]) -> float | Array:
    return values if shape else float(values[0])
