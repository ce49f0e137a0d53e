"""Curves that are controlled by a few points, as near as can be to curves that are not."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.interpolate import BSpline
from scipy.linalg import LinAlgError, solve
from scipy.sparse import csr_array

from pinposture import kernels
from pinposture.curve.bspline import MAX_DEGREE, Parts
from pinposture.curve.build import clamped_uniform_knots
from pinposture.curve.checks import LARGEST, as_count, as_number, check_distinct
from pinposture.curve.geometry import Geometry
from pinposture.errors import CurveError, InvalidValue

Array = NDArray[np.float64]

MOST = 1000
"""The most control points."""

SAMPLES, PER_POINT, PER_SPAN = 400, 20, 2
"""How many samples at least stand for a curve: in all, to a control point of the other, to a knot span of its
own. The latter, so that none of its windings is passed over."""

_EVEN = 1e-12  # of the whole: how far knots may be from even ones


def control_points(curve: Geometry) -> Array | None:
    """See `Curve.control_points`."""
    knots = curve.knots - curve.knots[0]
    even = clamped_uniform_knots(len(curve.coefficients), curve.degree)
    return curve.coefficients if np.abs(knots / knots[-1] - even).max() <= _EVEN else None


def controlled(curve: Geometry, count: int, degree: int) -> Parts:
    """The spline controlled by so many points that comes nearest to a curve; see `Curve.controlled`."""
    k = as_count("degree", degree, 1, MAX_DEGREE)
    n = as_count("count", count, k + 1, MOST)
    if curve.degree == k and len(curve.coefficients) == n and control_points(curve) is not None:
        return Parts(curve.knots, curve.coefficients, k)
    s = np.linspace(0.0, curve.length, _samples(curve, n))
    places, knots = curve.at(s), clamped_uniform_knots(n, k)
    # The curve's own parameter gives splines back that are of this kind but for more knots; shares of the
    # length serve curves whose parameter has nothing to do with even knots.
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
    """The one with the fewest points that keeps within a distance; see `Curve.controlled`."""
    k = as_count("degree", degree, 1, MAX_DEGREE)
    last = as_count("most", most, k + 1, MOST)
    near = as_number("tolerance", tolerance, f"a distance above 0, up to {LARGEST:g} m", lambda x: x > 0.0)
    nearest = np.inf
    for n in range(k + 1, last + 1):
        try:
            parts = controlled(curve, n, k)
            found = Geometry(*parts)
        except CurveError:  # it stands still somewhere, as that of a closed curve by few points
            continue
        # Few samples are enough to refuse it, and that is what happens most often.
        apart = float(found.nearest(curve.resample(SAMPLES)).distance.max())
        if apart <= near:
            apart = deviation(curve, found)
            if apart <= near:
                return parts
        nearest = min(nearest, apart)
    allowed = f"{nearest:.4g} m or more with {last} control points at most, of degree {k}"
    raise InvalidValue("tolerance", tolerance, allowed if nearest < np.inf else "more control points")


def deviation(curve: Geometry, other: Geometry) -> float:
    """How far apart two curves are at most, seen from either [m], at samples of equal arc length."""
    here = curve.resample(_samples(curve, len(other.coefficients)))
    there = other.resample(_samples(other, len(other.coefficients)))
    return max(float(other.nearest(here).distance.max()), float(curve.nearest(there).distance.max()))


def _samples(curve: Geometry, count: int) -> int:
    """How many samples stand for a curve where it is compared with one of so many control points."""
    spans = len(curve.coefficients) - curve.degree
    return max(SAMPLES, PER_POINT * count, PER_SPAN * spans) + 1


def _fit(basis: csr_array, places: Array) -> tuple[Array, float]:
    """Control points (n, 3) [m] of least squares, the first and the last one given, and what is left of them.

    Args:
        basis: what each control point adds to each sample, (m, n).
        places: the samples, (m, 3) [m].

    Returns:
        Control points, and the sum of squares that is left [m^2].

    Raises:
        LinAlgError: the samples leave some control point open.
    """
    coefficients = np.zeros((basis.shape[1], 3))
    coefficients[[0, -1]] = places[[0, -1]]
    rest, inner = places - basis @ coefficients, basis[:, 1:-1]
    if inner.shape[1]:
        normal = (inner.T @ inner).toarray()
        coefficients[1:-1] = solve(normal, inner.T @ rest, assume_a="pos")
    left = places - basis @ coefficients
    return coefficients, float(np.einsum("ij,ij->", left, left))
