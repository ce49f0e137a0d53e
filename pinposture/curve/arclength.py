"""The map between a curve's parameter and its arc length."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.polynomial import legendre
from numpy.typing import NDArray

from pinposture import kernels
from pinposture.curve.bspline import Spline, refuse_standstill

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
