"""Construction of curves: splines, lines, helices, fits to measured points, approximations by few points."""

from __future__ import annotations

import math
from typing import Literal

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.interpolate import BSpline, make_interp_spline
from scipy.linalg import LinAlgError, solve, solveh_banded
from scipy.optimize import brentq
from scipy.sparse import csr_array, diags_array, eye_array

from pinposture import kernels
from pinposture._validation import (
    LARGEST_COORDINATE,
    as_count,
    as_flag,
    as_number,
    as_points,
    as_vector,
    check_distinct,
)
from pinposture.curve.geometry import MAX_DEGREE, Geometry, Parts
from pinposture.errors import CurveError, InvalidValue

Array = NDArray[np.float64]

MAX_CONTROL_POINTS = 1000
MIN_SAMPLES = 400
"""Least number of samples of a curve that is compared with another."""
SAMPLES_PER_POINT = 20
"""Least number of samples per control point of the other curve."""
SAMPLES_PER_SPAN = 2
"""Least number of samples per knot span of the curve, so that none of its windings is missed."""

_SPANS_PER_TURN = 256  # the torsion of a quintic with this many is right to 1.2e-7
_MAX_TURNS = 1000
_KNOT_TOLERANCE = 1e-12  # of the whole: how far knots may be from even ones
_FIT_DEGREE = 3
_PENALTY_ORDER = 3  # order of the derivative that smoothing keeps small; the second would flatten the ends


def chord_parameters(points: Array) -> Array:
    """Return chord-length parameters (n,) from 0 to 1 of points (n, 3)."""
    along = np.append(0.0, np.cumsum(np.linalg.norm(np.diff(points, axis=0), axis=1)))
    return np.asarray(along / along[-1])


def clamped_uniform_knots(n: int, degree: int) -> Array:
    """Return even knots (n + degree + 1,) from 0 to 1, repeated at the ends to meet the end points."""
    inner = np.linspace(0, 1, n - degree + 1)
    return np.concatenate([np.zeros(degree), inner, np.ones(degree)])


def interpolate(points: Array, degree: int) -> Parts:
    """Interpolate points (n, 3) at chord-length parameters; for even degrees the knots lie midway."""
    spline = make_interp_spline(chord_parameters(points), points, k=degree)
    return Parts(spline.t, spline.c, degree)


def spline(control_points: ArrayLike, degree: int, through: bool) -> Parts:
    """Make the B-spline of `Curve.spline`."""
    k = as_count("degree", degree, 1, MAX_DEGREE)
    points = as_points(control_points, least=2)
    if len(points) <= k:
        raise CurveError("points", f"{len(points)} given; a spline of degree {k} needs at least {k + 1}")
    check_distinct(points)
    if as_flag("through", through):
        return interpolate(points, k)
    return Parts(clamped_uniform_knots(len(points), k), points, k)


def line(a: ArrayLike, b: ArrayLike) -> Parts:
    """Make the B-spline of `Curve.line`."""
    ends = np.stack([as_vector("a", a), as_vector("b", b)])
    check_distinct(ends, ("a", "b").__getitem__)
    return Parts(clamped_uniform_knots(2, 1), ends, 1)


def helix(
    radius: float,
    pitch: float,
    turns: float,
    axis: ArrayLike,
    *,
    center: ArrayLike,
    phase: float,
    handedness: Literal["right", "left"],
) -> Parts:
    """Make the B-spline of `Curve.helix`."""
    r = as_number("radius", radius, "a length from 1e-6 to 1e9 m", lambda x: 1e-6 <= x <= 1e9)
    rise = as_number("pitch", pitch, "0 m (a circle) or a length up to 1e6 m", lambda x: 0 <= x <= 1e6)
    n_turns = as_number("turns", turns, f"above 0, up to {_MAX_TURNS}", lambda x: 0 < x <= _MAX_TURNS)
    begin = as_number("phase", phase, "a finite angle [rad]", lambda x: True)
    if handedness not in ("right", "left"):
        raise InvalidValue("handedness", handedness, "'right' or 'left'")
    along, zero, quarter = _frame(as_vector("axis", axis), axis)
    if handedness == "left":
        quarter = -quarter
    spans = math.ceil(_SPANS_PER_TURN * n_turns)
    step = 2 * math.pi * n_turns / spans
    # The quintic spline with knots and coefficients evenly spaced in the angle has the symmetry of the helix,
    # so its coefficients lie on a helix too, wider by a factor that follows from the values 1, 26, 66, 26, 1
    # (of 120) of the basis at the knots. The knots go on beyond the ends; clamping them would break the
    # symmetry.
    wider = r * 60 / (33 + 26 * math.cos(step) + math.cos(2 * step))
    knots = np.arange(-5, spans + 6) / spans
    fraction = np.arange(-2, spans + 3) / spans  # of the length, at each coefficient
    angle = (begin + 2 * math.pi * n_turns * fraction)[:, None]
    around = np.cos(angle) * zero + np.sin(angle) * quarter
    rising = (rise * n_turns * fraction)[:, None] * along
    return Parts(knots, as_vector("center", center) + wider * around + rising, 5)


def _frame(axis: Array, given: ArrayLike) -> tuple[Array, Array, Array]:
    """Return unit vectors along the axis, to phase 0, and to a quarter of a right-handed turn."""
    size = float(np.linalg.norm(axis))
    if size < 1e-9:
        raise InvalidValue("axis", given, "a direction, so not zero")
    along = axis / size
    up = np.array([0.0, 0.0, 1.0])
    if np.linalg.norm(np.cross(along, up)) < 1e-6:
        up = np.array([1.0, 0.0, 0.0])
    zero = up - (up @ along) * along
    zero /= np.linalg.norm(zero)
    return along, zero, np.cross(along, zero)


def points(xyz: ArrayLike, smoothing: float) -> Parts:
    """Make the B-spline of `Curve.points`."""
    data = as_points(xyz)
    allowed = "an RMS distance of 0 m (through the points) up to 1e9 m"
    distance = as_number("smoothing", smoothing, allowed, lambda x: 0 <= x <= 1e9)
    check_distinct(data)
    n = len(data)
    if distance > 0 and n > _FIT_DEGREE:
        spans = 4
        while spans < n:
            fit = _Fit(data, spans)
            if fit.rms(fit.least) <= distance:
                return fit.smoothest(distance)
            spans *= 2
    # The points are too few to smooth, or no smoother curve is close enough.
    return interpolate(data, min(_FIT_DEGREE, n - 1))


class _Fit:
    """Cubic splines of evenly spaced knots near the points, with a penalty on the third derivative."""

    def __init__(self, data: Array, spans: int) -> None:
        n_coefficients = spans + _FIT_DEGREE
        self.data = data
        self.knots = clamped_uniform_knots(n_coefficients, _FIT_DEGREE)
        self.basis = csr_array(BSpline.design_matrix(chord_parameters(data), self.knots, _FIT_DEGREE))
        scale = spans / len(data)  # so that both matrices have entries of the order of one
        normal = (self.basis.T @ self.basis) * scale
        difference = self._difference(spans)
        self.normal, self.penalty = _upper_bands(normal), _upper_bands(difference.T @ difference)
        self.right = (self.basis.T @ data) * scale
        # Logarithms of the penalty's weight: enough to make a solution unique, and all but a parabola.
        self.least, self.most = math.log(1e-8), math.log(1e-3 * spans ** (2 * _PENALTY_ORDER))

    def _difference(self, spans: int) -> csr_array:
        """Coefficients -> coefficients of the third derivative, in units of one span."""
        knots, result = self.knots, csr_array(eye_array(len(self.knots) - _FIT_DEGREE - 1))
        for degree in range(_FIT_DEGREE, _FIT_DEGREE - _PENALTY_ORDER, -1):
            widths = (knots[degree + 1 : -1] - knots[1 : -degree - 1]) / degree * spans
            result = diags_array(1 / widths) @ (result[1:] - result[:-1])
            knots = knots[1:-1]
        return result

    def coefficients(self, weight: float) -> Array:
        """Coefficients (n, 3) [m] for the logarithm of the penalty's weight."""
        return np.asarray(solveh_banded(self.normal + math.exp(weight) * self.penalty, self.right))

    def rms(self, weight: float) -> float:
        """RMS distance [m] from the points to the fit at their parameters."""
        rest = self.data - self.basis @ self.coefficients(weight)
        return math.sqrt(float((rest**2).sum(axis=1).mean()))

    def smoothest(self, distance: float) -> Parts:
        """The fit with the largest penalty that keeps within `distance` [m]."""
        weight = self.most
        if self.rms(weight) > distance:
            weight = brentq(lambda w: self.rms(w) - distance, self.least, self.most, xtol=1e-6)
        return Parts(self.knots, self.coefficients(weight), _FIT_DEGREE)


def _upper_bands(matrix: csr_array) -> Array:
    """Diagonals of a symmetric matrix, from the one furthest above the main, as LAPACK wants them."""
    bands = range(max(_FIT_DEGREE, _PENALTY_ORDER), -1, -1)
    return np.stack([np.append(np.zeros(i), matrix.diagonal(i)) for i in bands])


def control_points(curve: Geometry) -> Array | None:
    """Return `Curve.control_points`."""
    knots = curve.knots - curve.knots[0]
    even = clamped_uniform_knots(len(curve.coefficients), curve.degree)
    return curve.coefficients if np.abs(knots / knots[-1] - even).max() <= _KNOT_TOLERANCE else None


def controlled(curve: Geometry, count: int, degree: int) -> Parts:
    """Make the B-spline of `Curve.controlled`."""
    k = as_count("degree", degree, 1, MAX_DEGREE)
    n = as_count("count", count, k + 1, MAX_CONTROL_POINTS)
    if curve.degree == k and len(curve.coefficients) == n and control_points(curve) is not None:
        return Parts(curve.knots, curve.coefficients, k)
    s = np.linspace(0.0, curve.length, _samples(curve, n))
    places, knots = curve.at(s), clamped_uniform_knots(n, k)
    # The curve's own parameter suits splines with more knots of this kind, the fraction of the length suits
    # curves whose parameter is unrelated to even knots.
    _, _, _, edges, lengths, series = curve.measured
    own = kernels.parameters_at(edges, lengths, series, s)
    begin, end = curve.knots[curve.degree], curve.knots[-curve.degree - 1]
    fits = []
    for parameters in ((own - begin) / (end - begin), s / curve.length):
        basis = csr_array(BSpline.design_matrix(np.clip(parameters, 0.0, 1.0), knots, k))
        try:
            fits.append(_fit(basis, places))
        except LinAlgError:  # no sample is near some control point
            continue
    coefficients, _ = min(fits, key=lambda fit: fit[1])
    check_distinct(coefficients, "control point {} of the nearest".format)
    return Parts(knots, coefficients, k)


def controlled_within(curve: Geometry, tolerance: float, degree: int, most: int) -> Parts:
    """Make the B-spline of `Curve.controlled_within`."""
    k = as_count("degree", degree, 1, MAX_DEGREE)
    last = as_count("most", most, k + 1, MAX_CONTROL_POINTS)
    near = as_number(
        "tolerance", tolerance, f"a distance above 0, up to {LARGEST_COORDINATE:g} m", lambda x: x > 0.0
    )
    nearest = np.inf
    for n in range(k + 1, last + 1):
        try:
            parts = controlled(curve, n, k)
            found = Geometry(*parts)
        except CurveError:  # its velocity vanishes, as for a closed curve with few points
            continue
        # Few samples are enough to refuse it, which is the most frequent case.
        apart = float(found.nearest(curve.resample(MIN_SAMPLES)).distance.max())
        if apart <= near:
            apart = deviation(curve, found)
            if apart <= near:
                return parts
        nearest = min(nearest, apart)
    allowed = f"{nearest:.4g} m or more with {last} control points at most, of degree {k}"
    raise InvalidValue("tolerance", tolerance, allowed if nearest < np.inf else "more control points")


def deviation(curve: Geometry, other: Geometry) -> float:
    """Return the largest distance between two curves [m], from samples of either to the other."""
    here = curve.resample(_samples(curve, len(other.coefficients)))
    there = other.resample(_samples(other, len(other.coefficients)))
    return max(float(other.nearest(here).distance.max()), float(curve.nearest(there).distance.max()))


def _samples(curve: Geometry, count: int) -> int:
    """Return how many samples of a curve to compare with a curve of `count` control points."""
    spans = len(curve.coefficients) - curve.degree
    return max(MIN_SAMPLES, SAMPLES_PER_POINT * count, SAMPLES_PER_SPAN * spans) + 1


def _fit(basis: csr_array, places: Array) -> tuple[Array, float]:
    """Fit control points (n, 3) [m] to samples (m, 3) [m] by least squares; the end points are given.

    Args:
        basis: value of each basis function at each sample, (m, n).
        places: the samples.

    Returns:
        Control points, and the residual sum of squares [m^2].

    Raises:
        LinAlgError: the samples do not determine some control point.
    """
    coefficients = np.zeros((basis.shape[1], 3))
    coefficients[[0, -1]] = places[[0, -1]]
    rest, inner = places - basis @ coefficients, basis[:, 1:-1]
    if inner.shape[1]:
        normal = (inner.T @ inner).toarray()
        coefficients[1:-1] = solve(normal, inner.T @ rest, assume_a="pos")
    left = places - basis @ coefficients
    return coefficients, float(np.einsum("ij,ij->", left, left))
