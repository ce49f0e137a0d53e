"""Targets along curves that change a little from one to the next: each begins where the one before ended."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from pinposture import kernels
from pinposture.arm import Arm
from pinposture.target.fit import Problem
from pinposture.target.modules import layout
from pinposture.target.resolve import STIFFNESS
from pinposture.task.bending import BentCurve
from pinposture.task.resolving import SAMPLES

Array = NDArray[np.float64]

ROUNDS, CONVERGED, ROUNDING = 12, 1e-7, 1e-24
"""The most steps of a fit, the step after which the next would not matter [rad], and squares that are 0."""

LEAST, EASIER, HARDER = 1e-11, 0.1, 10.0
"""Smallest damping of a fit, relative to the mean diagonal of its matrix, and how it changes."""

VISCOSITY = 3e-3
"""What motion costs on the way from one keyframe to the next, relative to what it does for the distances:
root of the ratio of the two, for a way of `USUAL` rows. It slows joints down that turn far for next to
nothing, as those do that roll a nearly straight arm; others lag behind by next to nothing."""

USUAL = 400
"""Rows from one keyframe to the next."""

STRIDE = 0.2
"""The largest step of a fit [rad, or arm lengths]: it is to stay with the optimum that it followed."""


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

    def fit(
        self,
        curve: BentCurve,
        guess: Array,
        before: Array | None = None,
        weight: float = 0.0,
        reach: float = np.inf,
    ) -> Array:
        """The unknowns at the optimum near a guess: Levenberg and Marquardt's method within the limits.

        Args:
            curve: the curve.
            guess: where to begin, (n + m,).
            before: unknowns to stay near, (n + m,).
            weight: what squared distances from those cost.
            reach: how far from them joints may be at most [rad, or arm lengths].
        """
        anchor, far = guess if before is None else before, np.full(len(guess), np.inf)
        far[: len(self.problem.columns)] = reach
        lower = np.maximum(self.problem.lower, anchor - far)
        upper = np.minimum(self.problem.upper, anchor + far)
        x = np.clip(guess, lower, upper)
        damping, largest = LEAST, STRIDE
        residual, jacobian = self.problem.evaluate(curve, x)
        cost = float(residual @ residual + weight * ((x - anchor) @ (x - anchor)))
        for _ in range(ROUNDS):
            gradient = jacobian.T @ residual + weight * (x - anchor)
            hessian = jacobian.T @ jacobian
            hessian[np.diag_indices(len(x))] += weight + damping * self._stiffness(hessian)
            free = ~(((x <= lower) & (gradient > 0.0)) | ((x >= upper) & (gradient < 0.0)))
            which = np.flatnonzero(free)
            step = np.zeros(len(x))
            step[which] = np.linalg.solve(hessian[np.ix_(which, which)], -gradient[which])
            step *= min(1.0, STRIDE / max(float(np.abs(step).max()), 1e-300))
            tried = np.clip(x + step, lower, upper)
            there = self.problem.evaluate(curve, tried)
            found = float(there[0] @ there[0] + weight * ((tried - anchor) @ (tried - anchor)))
            if found <= cost:
                largest = float(np.abs(tried - x).max())
                x, cost, (residual, jacobian) = tried, found, there
                damping = max(damping * EASIER, LEAST)
            else:
                damping *= HARDER
                largest = STRIDE if damping < 1.0 else 0.0
            if largest <= CONVERGED or cost <= ROUNDING:
                break
        return np.asarray(x)

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
        weight = VISCOSITY**2 * len(rows) / USUAL * self._stiffness(jacobian.T @ jacobian)
        for i in range(1, len(rows)):
            ahead = found[i - 1] + (found[i - 1] - found[i - 2] if i > 1 else 0.0)
            found[i] = self.fit(curve_at(rows[i]), ahead, found[i - 1], weight, way / len(rows))
        return found

    def _stiffness(self, hessian: Array) -> float:
        """Mean diagonal that belongs to the joints."""
        return max(float(np.diag(hessian)[: len(self.problem.columns)].mean()), 1e-300)
