"""Points, directions and curvature of a curve by arc length, and the place on it nearest to a point."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Any, NamedTuple, TypeVar, overload

import numpy as np
from numpy.typing import ArrayLike, NDArray

from pinposture import kernels
from pinposture._validation import LARGEST_COORDINATE, as_count, as_points
from pinposture.curve.bspline import LENGTH_TOLERANCE, ArcLength, Spline, make_spline, rounding
from pinposture.errors import InvalidValue

Array = NDArray[np.float64]
Made = TypeVar("Made", bound="Geometry")
Lengths = Sequence[float] | NDArray[Any]

_MIN_PIECES = 256  # into which the search for the nearest place divides a curve
_END_TOLERANCE = 1e-9  # of the length: how far beyond the ends an arc length still counts as the end
_PLANE_TOLERANCE = 1e-9  # of the length: how far the coefficients of a plane curve may leave its plane
_MIN_CURVATURE = 1e-6  # over the length: curvature below which a curve counts as straight
_MAX_SAMPLES = 10_000_000


class Nearest(NamedTuple):
    """Where a curve comes nearest to each of some points; single numbers for a single point.

    Attributes:
        parameter: arc length from the start of the curve, shape (n,) [m].
        distance: from the point to there, shape (n,) [m].
    """

    parameter: Array
    distance: Array


@dataclass(frozen=True, eq=False, repr=False)
class Geometry:
    """A B-spline measured by its arc length s, which runs from 0 to `length`.

    Every query takes one arc length and returns one float or shape (3,), or takes shape (n,) and returns
    shape (n,) or (n, 3). Within 1e-9 of the length an arc length beyond the ends counts as the end; further
    out raises InvalidValue. At a corner (degree 1, or repeated knots) a query answers for the part that
    follows.

    Attributes:
        knots: shape (n + degree + 1,), not decreasing; the curve runs from knots[degree] to knots[n].
        coefficients: of the B-spline, shape (n, 3) [m], in the frame of the points it was made of.
        degree: 1 to 5.

    Raises:
        CurveError: knots or coefficients that make no curve, or one that stands still somewhere (a cusp).
        InvalidValue: the degree.
    """

    knots: Array
    coefficients: Array
    degree: int
    _spline: Spline = field(init=False)
    _arc: ArcLength = field(init=False)

    def __post_init__(self) -> None:
        spline = make_spline(self.knots, self.coefficients, self.degree)
        self._set(spline, ArcLength.of(spline))

    def _set(self, spline: Spline, arc: ArcLength) -> None:
        knots, coefficients = spline.knots.view(), spline.table[0].view()
        knots.flags.writeable = coefficients.flags.writeable = False
        self.__dict__.update(knots=knots, coefficients=coefficients, degree=spline.degree)
        self.__dict__.update(_spline=spline, _arc=arc)

    def _with_coefficients(self: Made, coefficients: Array, stretch: float) -> Made:
        """Return the curve after a motion that is rigid up to a relative stretch.

        The measured length is kept if the stretch and rounding change it less than its tolerance.
        """
        change = max(stretch * self.length, rounding(coefficients))
        if not (
            np.abs(coefficients).max() <= LARGEST_COORDINATE and change <= LENGTH_TOLERANCE * self.length
        ):
            return type(self)(self.knots, coefficients, self.degree)
        moved = object.__new__(type(self))
        moved._set(self._spline.with_coefficients(coefficients), self._arc)
        return moved

    def __reduce__(self) -> tuple[Any, ...]:
        # Built anew, because unpickled arrays would be writeable.
        return type(self), (self.knots, self.coefficients, self.degree)

    def __eq__(self, other: object) -> bool:
        """Tell whether degree, knots and coefficients are equal to the last bit."""
        if not isinstance(other, Geometry):
            return NotImplemented
        return (
            self.degree == other.degree
            and np.array_equal(self.knots, other.knots)
            and np.array_equal(self.coefficients, other.coefficients)
        )

    def __hash__(self) -> int:
        # Adding 0 turns -0 into 0, which compares equal to it.
        return hash((self.degree, (self.knots + 0.0).tobytes(), (self.coefficients + 0.0).tobytes()))

    def __repr__(self) -> str:
        places = np.stack([self.start, self.end])
        places[np.abs(places) < _END_TOLERANCE * self.length] = 0
        begin, end = (", ".join(f"{x:.4g}" for x in place) for place in places)
        spans = len(self._spline.breaks) - 1
        return (
            f"{type(self).__name__}(length {self.length:.6g} m, from ({begin}) to ({end}), "
            f"degree {self.degree}, {spans} span{'s' * (spans != 1)})"
        )

    @property
    def length(self) -> float:
        """Arc length from start to end [m]."""
        return self._arc.total

    @property
    def measured(self) -> tuple[Array, Array, int, Array, Array, Array]:
        """The arrays that kernels take: knots, table, degree; edges, lengths, series. Do not write to them.

        See `kernels.spline_coefficients` and `kernels.measure_length`.
        """
        spline, arc = self._spline, self._arc
        return spline.knots, spline.table, spline.degree, arc.edges, arc.lengths, arc.series

    @property
    def start(self) -> Array:
        """Where the curve begins, shape (3,) [m]."""
        return self.at(0.0)

    @property
    def end(self) -> Array:
        """Where the curve ends, shape (3,) [m]."""
        return self.at(self.length)

    @property
    def dimension(self) -> int:
        """2 if all coefficients lie in one plane, of any direction, within 1e-9 of the length, else 3."""
        offsets = self.coefficients - self.coefficients.mean(axis=0)
        # The covariance would square the rounding errors.
        normal = np.linalg.svd(offsets, full_matrices=len(offsets) < 3)[2][2]
        return 2 if float(np.abs(offsets @ normal).max()) <= _PLANE_TOLERANCE * self.length else 3

    def at(self, s: float | Lengths) -> Array:
        """Return places, shape (n, 3) or (3,) [m], at the arc lengths `s` [m]."""
        u, shape = self._parameter(s)
        return _shaped(self._spline.values(u), shape)

    def tangent(self, s: float | Lengths) -> Array:
        """Return unit tangents, shape (n, 3) or (3,), towards the end, at the arc lengths `s` [m]."""
        u, shape = self._parameter(s)
        velocity = self._spline.values(u, 1)
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
        curvature is below 1e-6 / length, because it has no meaning there.
        """
        u, shape = self._parameter(s)
        bending, v = self._bending(u)
        square = np.einsum("ni,ni->n", bending, bending)
        bent = np.sqrt(square) * self.length > _MIN_CURVATURE * v**3
        volume = np.einsum("ni,ni->n", bending, self._spline.values(u, 3))
        torsion = np.divide(volume, square, out=np.zeros_like(v), where=bent & (self.dimension == 3))
        return _scalar(torsion, shape)

    def resample(self, n: int) -> Array:
        """Return places, shape (n, 3) [m], at n >= 2 equal steps of arc length from the start to the end."""
        return self.at(np.linspace(0, self.length, as_count("n", n, 2, _MAX_SAMPLES)))

    def nearest(self, points: ArrayLike) -> Nearest:
        """Find where the curve comes nearest, over all of its length.

        Args:
            points: shape (n, 3), or (n, 2) with z = 0, or one point of shape (3,) or (2,) [m].

        Returns:
            Arc lengths and distances; of several places equally near, one of them.

        Raises:
            CurveError: points that are malformed or not finite.
        """
        try:
            one = np.ndim(points) == 1 and np.size(points) > 0
        except ValueError:  # rows of different lengths
            one = False
        given = as_points(np.asarray(points)[None] if one else points, least=0)
        found = kernels.nearest_places(*self.measured, _MIN_PIECES, given)
        parameter, distance = found[:, 0].copy(), found[:, 1].copy()
        return Nearest(parameter[0], distance[0]) if one else Nearest(parameter, distance)

    def _parameter(self, s: ArrayLike) -> tuple[Array, tuple[int, ...]]:
        """Return the parameters (n,) of the spline at arc lengths, and the shape of these."""
        slack = _END_TOLERANCE * self.length
        if type(s) is float and -slack <= s <= self.length + slack:
            return self._arc.parameter(np.array([min(max(s, 0.0), self.length)])), ()
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
        return self._arc.parameter(clipped.astype(float)), values.shape

    def _out_of_range(self, name: str, value: object) -> InvalidValue:
        allowed = f"arc lengths from 0 to {self.length:.10g} m, one or an array of shape (n,)"
        return InvalidValue(name, value, allowed)

    def _bending(self, u: Array) -> tuple[Array, Array]:
        """Return the first cross the second derivative (n, 3), and the speed (n,)."""
        velocity = self._spline.values(u, 1)
        return np.cross(velocity, self._spline.values(u, 2)), np.linalg.norm(velocity, axis=1)


def _shaped(places: Array, shape: tuple[int, ...]) -> Array:
    return places if shape else places[0]


def _scalar(values: Array, shape: tuple[int, ...]) -> float | Array:
    return values if shape else float(values[0])
