"""Least squares of the whole arm on a curve from a guess that is near: quick, and true to it."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from pinposture.arm import Arm
from pinposture.curve import Curve
from pinposture.target.fit import Fit, Problem, Samples, driven_base
from pinposture.target.target import Target

Array = NDArray[np.float64]

ROUNDS, CONVERGED, ROUNDING = 12, 1e-7, 1e-24
"""The most steps of a fit, the step after which the next would not matter [rad], and squares that are 0."""

LEAST, EASIER, HARDER = 1e-11, 0.1, 10.0
"""Smallest damping of a fit, relative to the mean diagonal of its matrix, and how it changes."""

AHEAD, LOOKED_AT = 2.0, 64
"""How far ahead of one control point the next is looked for on a curve, in module lengths, and in how many
places."""

STRIDE = 0.2
"""The largest step of a fit [rad, or arm lengths]: it is to stay with the optimum that it followed."""


def fit_near(arm: Arm, curve: Curve, start: float, bending: float, near: Target) -> Fit:
    """Fit an arm to a curve as `fit_curve` does, from a target on a curve that differs a little.

    Args:
        arm: the arm.
        curve: the curve, placed.
        start: arc length at which the base of the arm belongs [m].
        bending: as for `fit_curve`.
        near: the target, with its configuration; where it has no arc lengths of its control points, they are
            looked for on the curve.
    """
    assert near.q is not None  # the caller has seen to it
    problem = Problem(arm, start, bending, driven_base(arm, curve, start))
    parameters = _along(arm, curve, start, near.q) if near.parameters is None else near.parameters
    guess = problem.joined(arm.positions(near.q), parameters)
    return Fit(*problem.split(refined(problem, curve, np.clip(guess, problem.lower, problem.upper))))


def _along(arm: Arm, curve: Curve, start: float, q: Array) -> Array:
    """Arc lengths of the places on a curve nearest to the control points at q, in order, (m,) [m].

    Each is looked for as far from the one before as a module reaches: a curve may come by a second time.
    """
    points, lengths = arm.chain.flattened(arm.at(q).points), arm.chain.module_lengths
    reach = AHEAD * np.maximum(lengths, lengths.mean())
    steps = np.arange(1, LOOKED_AT + 1) / LOOKED_AT
    found = np.empty(len(points))
    for k, point in enumerate(points):
        ahead = start + reach[k] * steps
        found[k] = start = ahead[np.argmin(np.linalg.norm(curve.at(ahead) - point, axis=1))]
    return found


def refined(
    problem: Problem,
    curve: Samples | Curve,
    guess: Array,
    before: Array | None = None,
    weight: float = 0.0,
    reach: float = np.inf,
) -> Array:
    """The unknowns at the optimum near a guess: Levenberg and Marquardt's method within the limits.

    Args:
        problem: what to minimise.
        curve: the curve.
        guess: where to begin, (n + m,).
        before: unknowns to stay near, (n + m,).
        weight: what squared distances from those cost.
        reach: how far from them joints may be at most [rad, or arm lengths].
    """
    anchor, far = guess if before is None else before, np.full(len(guess), np.inf)
    far[: len(problem.columns)] = reach
    lower = np.maximum(problem.lower, anchor - far)
    upper = np.minimum(problem.upper, anchor + far)
    x = np.clip(guess, lower, upper)
    damping, largest = LEAST, STRIDE
    residual, jacobian = problem.evaluate(curve, x)
    cost = float(residual @ residual + weight * ((x - anchor) @ (x - anchor)))
    for _ in range(ROUNDS):
        gradient = jacobian.T @ residual + weight * (x - anchor)
        hessian = jacobian.T @ jacobian
        hessian[np.diag_indices(len(x))] += weight + damping * stiffness(problem, hessian)
        free = ~(((x <= lower) & (gradient > 0.0)) | ((x >= upper) & (gradient < 0.0)))
        which = np.flatnonzero(free)
        step = np.zeros(len(x))
        step[which] = np.linalg.solve(hessian[np.ix_(which, which)], -gradient[which])
        step *= min(1.0, STRIDE / max(float(np.abs(step).max()), 1e-300))
        tried = np.clip(x + step, lower, upper)
        there = problem.evaluate(curve, tried)
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


def stiffness(problem: Problem, hessian: Array) -> float:
    """Mean diagonal of a matrix (n + m, n + m) of squares that belongs to the joints."""
    return max(float(np.diag(hessian)[: len(problem.columns)].mean()), 1e-300)
