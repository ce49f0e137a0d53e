"""The map between a curve's parameter and its arc length."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.polynomial import legendre
from numpy.typing import NDArray

from pinposture.curve.newton import crossings

Values = NDArray[np.float64]

N = 12  # Gauss nodes to a piece
NODES, _WEIGHTS = legendre.leggauss(N)
# Values at the Gauss nodes -> Legendre coefficients of their interpolant (the discrete transform is exact).
_MODES = legendre.legvander(NODES, N - 1) * _WEIGHTS[:, None] * (np.arange(N) + 0.5)
# Legendre coefficients of the speed -> Legendre coefficients of its integral from -1 -> power coefficients.
_INTEGRAL = np.stack([legendre.legint(mode, lbnd=-1) for mode in np.eye(N)])
_POWERS = np.zeros((N + 1, N + 1))
for _degree in range(N + 1):
    _POWERS[_degree, N - _degree :] = legendre.leg2poly(np.eye(N + 1)[_degree, : _degree + 1])[::-1]
_TAIL = 1e-12  # of the whole length: largest last terms of a piece's series
_DEPTH = 48  # halvings of a span, enough for a speed that nearly vanishes
_MOST = 64  # pieces to a span that are halved at a time; more means that rounding is all there is to see


@dataclass(frozen=True, eq=False)
class ArcLength:
    """Arc length s as a function of the parameter u: a polynomial on each of many short pieces.

    The speed is sampled at Gauss nodes on pieces of the knot spans; pieces are halved until the Legendre
    series of the speed has died out. Its integral is the arc length; Newton's method on the polynomial
    inverts it.

    Attributes:
        edges: parameters where the pieces meet, shape (k + 1,).
        lengths: arc length at the edges, shape (k + 1,) [m].
        series: power coefficients, highest first, of each piece's length in x from -1 to 1, shape (N + 1, k)
            [m].
    """

    edges: Values
    lengths: Values
    series: Values

    @classmethod
    def of(cls, speed: Callable[[Values], Values], breaks: Values, rounding: float) -> ArcLength:
        """Integrate a speed.

        Args:
            speed: maps parameters (n,) to speeds (n,) [m per unit of parameter], all positive.
            breaks: increasing parameters between which the speed is smooth, shape (k + 1,).
            rounding: error in the length of a span that rounding may cause [m]; halving goes no further.
        """
        left, right, total = breaks[:-1], breaks[1:], 0.0
        pieces = []
        for depth in range(_DEPTH):
            half = 0.5 * (right - left)
            u = (left + half)[:, None] + half[:, None] * NODES
            v = speed(u.ravel()).reshape(u.shape)
            modes = (v - v[:, :1]) @ _MODES  # of the difference, so that a constant speed is exact
            modes[:, 0] += v[:, 0]
            modes *= half[:, None]
            total = total or 2 * float(modes[:, 0].sum())
            rough = np.abs(modes[:, -2:]).sum(axis=1) > max(_TAIL * total, rounding)
            if depth == _DEPTH - 1 or rough.sum() > _MOST * len(breaks):
                rough[:] = False
            pieces.append((left[~rough], right[~rough], modes[~rough]))
            if not rough.any():
                break
            middle = (left + half)[rough]
            left, right = np.concatenate([left[rough], middle]), np.concatenate([middle, right[rough]])
        starts = np.concatenate([piece[0] for piece in pieces])
        order = np.argsort(starts)
        modes = np.concatenate([piece[2] for piece in pieces])[order]
        return cls(
            edges=np.append(starts[order], breaks[-1]),
            lengths=np.append(0.0, np.cumsum(2 * modes[:, 0])),
            series=np.ascontiguousarray((modes @ _INTEGRAL @ _POWERS).T),
        )

    @property
    def total(self) -> float:
        """The whole length [m]."""
        return float(self.lengths[-1])

    def length_at(self, u: Values) -> Values:
        """Arc length (n,) [m] from the start to the parameters u (n,)."""
        i = self._piece(self.edges, u)
        low, high = self.edges[i], self.edges[i + 1]
        x = (2 * u - low - high) / (high - low)
        return np.clip(self.lengths[i] + _horner(self.series[:, i], x)[0], 0, self.total)

    def parameter(self, s: Values) -> Values:
        """Parameters (n,) at the arc lengths s (n,) [m], within [0, total]."""
        i = self._piece(self.lengths, s)
        series = self.series[:, i]
        local = s - self.lengths[i]

        def gap(x: Values) -> tuple[Values, Values]:
            value, slope = _horner(series, x)
            return value - local, slope

        one = np.ones_like(s)
        x = crossings(gap, -one, one, np.clip(2 * local / (self.lengths[i + 1] - self.lengths[i]) - 1, -1, 1))
        low, high = self.edges[i], self.edges[i + 1]
        return np.clip(0.5 * ((1 - x) * low + (1 + x) * high), low, high)

    @staticmethod
    def _piece(table: Values, value: Values) -> NDArray[np.intp]:
        return np.clip(np.searchsorted(table, value, side="right") - 1, 0, len(table) - 2)


def _horner(series: Values, x: Values) -> tuple[Values, Values]:
    """Value and slope of the polynomials series (N + 1, n) at x (n,)."""
    value, slope = series[0], np.zeros_like(x)
    for coefficient in series[1:]:
        slope = slope * x + value
        value = value * x + coefficient
    return value, slope
