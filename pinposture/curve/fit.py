"""Curves from measured points."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.interpolate import BSpline
from scipy.linalg import solveh_banded
from scipy.optimize import brentq
from scipy.sparse import csr_array, diags_array, eye_array

from pinposture.curve.bspline import Parts
from pinposture.curve.build import chord_parameters, clamped_uniform_knots, interpolating
from pinposture.curve.checks import as_number, as_points, check_distinct

_CUBIC = 3
_PENALISED = 3  # order of the derivative that smoothing keeps small; the second would flatten the ends


def points(xyz: ArrayLike, smoothing: float) -> Parts:
    """See `Curve.points`."""
    data = as_points(xyz)
    allowed = "an RMS distance of 0 m (through the points) up to 1e9 m"
    distance = as_number("smoothing", smoothing, allowed, lambda x: 0 <= x <= 1e9)
    check_distinct(data)
    n = len(data)
    if distance > 0 and n > _CUBIC:
        spans = 4
        while spans < n:
            fit = _Fit(data, spans)
            if fit.rms(fit.least) <= distance:
                return fit.smoothest(distance)
            spans *= 2
    # Through the points: they are too few to smooth, or none but this comes as close as was asked for.
    return interpolating(data, min(_CUBIC, n - 1))


class _Fit:
    """Cubic splines of evenly spaced knots near the points, with a penalty on the third derivative."""

    def __init__(self, data: NDArray[np.float64], spans: int) -> None:
        n_coefficients = spans + _CUBIC
        self.data = data
        self.knots = clamped_uniform_knots(n_coefficients, _CUBIC)
        self.basis = csr_array(BSpline.design_matrix(chord_parameters(data), self.knots, _CUBIC))
        scale = spans / len(data)  # so that both matrices have entries of the order of one
        normal = (self.basis.T @ self.basis) * scale
        difference = self._difference(spans)
        self.normal, self.penalty = _upper_bands(normal), _upper_bands(difference.T @ difference)
        self.right = (self.basis.T @ data) * scale
        # Logarithms of the penalty's weight: enough to make a solution unique, and all but a parabola.
        self.least, self.most = math.log(1e-8), math.log(1e-3 * spans ** (2 * _PENALISED))

    def _difference(self, spans: int) -> csr_array:
        """Coefficients -> coefficients of the third derivative, in units of one span."""
        knots, result = self.knots, csr_array(eye_array(len(self.knots) - _CUBIC - 1))
        for degree in range(_CUBIC, _CUBIC - _PENALISED, -1):
            widths = (knots[degree + 1 : -1] - knots[1 : -degree - 1]) / degree * spans
            result = diags_array(1 / widths) @ (result[1:] - result[:-1])
            knots = knots[1:-1]
        return result

    def coefficients(self, weight: float) -> NDArray[np.float64]:
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
        return Parts(self.knots, self.coefficients(weight), _CUBIC)


def _upper_bands(matrix: csr_array) -> NDArray[np.float64]:
    """Diagonals of a symmetric matrix, from the one furthest above the main, as LAPACK wants them."""
    bands = range(max(_CUBIC, _PENALISED), -1, -1)
    return np.stack([np.append(np.zeros(i), matrix.diagonal(i)) for i in bands])
