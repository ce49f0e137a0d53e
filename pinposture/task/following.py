"""Targets along curves that change a little from one to the next: each begins where the one before ended."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from pinposture import kernels
from pinposture.arm import Arm
from pinposture.target.fit import Problem
from pinposture.target.modules import layout
from pinposture.target.refine import refined, stiffness
from pinposture.target.resolve import STIFFNESS
from pinposture.task.bending import BentCurve
from pinposture.task.resolving import SAMPLES

Array = NDArray[np.float64]

VISCOSITY = 3e-3
"""What motion costs on the way from one keyframe to the next, relative to what it does for the distances:
root of the ratio of the two, for a way of `USUAL` rows. It slows joints down that turn far for next to
nothing, as those do that roll a nearly straight arm; others lag behind by next to nothing."""

USUAL = 400
"""Rows from one keyframe to the next."""


class InTurn:
    """Sequential placement on curves that begin at the base of the arm, or beside it."""

    def __init__(self, arm: Arm) -> None:
        self._arm, (self._units, self._shapes) = arm, layout(arm.chain)
        self._limits = arm.limits.lower[arm.columns], arm.limits.upper[arm.columns]
        self._base = np.array(arm.chain.base)

    def positions(self, curve: BentCurve) -> Array | None:
        """Joint positions (nv,) that put the control points on a curve, None if there are none."""
        coefficients, end = curve.spline, curve.length
        knots = np.concatenate([[0.0, 0.0], np.repeat(curve.s, 2), [end, end]])
        ends = np.array([0.0, end])
        series = np.full((1, 2), 0.5 * end)  # the parameter is the arc length
        state = np.empty(9)
        state[0], state[1:4], state[4:7] = 0.0, self._base, curve.points[0]
        found, parameters = np.zeros(len(self._arm.columns)), np.empty(self._arm.n_modules)
        measured = knots, coefficients[None], 3, ends, ends, series
        given = SAMPLES, self._units, self._shapes, *self._limits
        if kernels.walk_along(*measured, *given, state, found, parameters) >= 0:
            return None
        positions = np.zeros(self._arm.nv)
        positions[self._arm.columns] = found
        return positions


class Follower:
    """Least squares of the whole arm, from a guess that is near.

    It is the problem of `target.fit`, with its unknowns: joint positions, and arc lengths between control
    points, in units of the problem.
    """

    def __init__(self, arm: Arm, method: str) -> None:
        lengths = np.maximum(arm.chain.module_lengths, arm.chain.module_lengths.mean())
        self.problem = Problem(arm, 0.0, STIFFNESS[method] * float(np.median(lengths)))

    def miss(self, curve: BentCurve, unknowns: Array) -> float:
        """Root mean square distance from the curve, bending counted in, in arm lengths."""
        residual, _ = self.problem.evaluate(curve, unknowns)
        return float(np.sqrt(residual @ residual / self.problem.points))

    def march(self, curve_at: Callable[[int], BentCurve], rows: range, first: Array, way: float) -> Array:
        """Follow the curves of rows from unknowns that fit the first, (r, n + m).

        Args:
            curve_at: the curve of a row.
            rows: the rows.
            first: where to begin, (n + m,).
            way: how far joints move at most, if they move all the time [rad, or arm lengths].
        """
        found = np.empty((len(rows), len(first)))
        found[0] = first
        _, jacobian = self.problem.evaluate(curve_at(rows[0]), first)
        weight = VISCOSITY**2 * len(rows) / USUAL * stiffness(self.problem, jacobian.T @ jacobian)
        for i in range(1, len(rows)):
            ahead = found[i - 1] + (found[i - 1] - found[i - 2] if i > 1 else 0.0)
            curve = curve_at(rows[i])
            found[i] = refined(self.problem, curve, ahead, found[i - 1], weight, way / len(rows))
        return found
