"""Damped least squares within limits: the step that reduces all errors at once, and where such steps end."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from pinposture.arm import ArmState
from pinposture.control.constrained.avoidance import Avoidance
from pinposture.control.constrained.path import FARTHEST
from pinposture.control.constrained.posture import Linear, Posture
from pinposture.control.constrained.program import Rows, Solution, solve
from pinposture.control.constrained.sweeps import Sweeps
from pinposture.control.limits import Box

Array = NDArray[np.float64]

BIAS = 1e-10
"""Damping that stays at the target, relative to the mean diagonal of A^T A: the program needs some."""

SHARE = 0.5
"""Damping relative to the sum of squared errors, as Sugihara (2011) scales it."""

EASIER, HARDER, LEAST, MOST = 0.3, 4.0, 1e-6, 1e9
"""How the damping changes after a step that reduced the merit or failed to, and its range."""

STRIDE = 0.2
"""Largest joint motion of a step that is only thought, in `Arm.joint_units`."""

ROUNDS, SETTLED, PATIENCE = 120, 1e-6, 3
"""The most steps of a search, and the relative fall of the merit that is none, so many times in a row."""

INDEPENDENT = 1e-6
"""Singular value from which on a row of strict tasks counts, relative to the largest."""


CORRECTIONS = 4
"""How often a step is corrected for what its curvature does to strict tasks."""


class Scope(NamedTuple):
    """What one step may do.

    Attributes:
        state: where the arm is.
        lower: smallest step, (n,), in `Arm.joint_units`.
        upper: largest step, (n,).
        rows: what else has to hold; None if nothing.
    """

    state: ArmState
    lower: Array
    upper: Array
    rows: Rows | None

    @classmethod
    def of(cls, posture: Posture, state: ArmState, box: Box, avoidance: Avoidance | None) -> Scope:
        """What limits and obstacles leave of a step."""
        lower, upper = (np.clip(posture.own(side), -FARTHEST, FARTHEST) for side in box.sides)
        rows = None if avoidance is None else avoidance.rows(state, lower, upper)
        return cls(state, lower, upper, rows)


class Settled(NamedTuple):
    """Where a search ended.

    Attributes:
        state: the state of the arm there.
        merit: half the sum of squares that is left [m^2].
        mean_error: mean distance of the control points from their targets [m].
        intrusion: by how much the arm is closer to something than it may be [m]; 0 if it is clear.
    """

    state: ArmState
    merit: float
    mean_error: float
    intrusion: float


def reducing_step(posture: Posture, scope: Scope, damping: float) -> Solution:
    """One step x towards all targets at once.

    It minimises |A x - s e|^2 + lambda |x|^2 within its scope, with all rows A and errors e of the posture.
    Errors of a far target are scaled down together, by s, so that the largest of a point is one module
    length: the arm sets out in their direction instead of reaching for what no step covers. The damping
    lambda grows with the errors that are left.

    Args:
        posture: what is asked of the arm.
        scope: what the step may do.
        damping: factor of the damping.
    """
    scale = _capping(posture, scope.state)
    if posture.plain and scope.rows is None:
        return _by_sweeps(posture, scope, damping, scale)
    linear = posture.rows(scope.state)
    errors = scale * linear.errors
    least = BIAS * _typical(posture, linear.matrix)
    hessian = _damped(linear.matrix, damping * SHARE * float(errors @ errors) + least)
    strict = posture.task_rows(scope.state, strict=True)
    first = None if strict is None else first_things_first(posture, scope, strict, scale * strict.errors)
    return then_the_rest(hessian, -(linear.matrix.T @ errors), scope, first)


def _by_sweeps(posture: Posture, scope: Scope, damping: float, scale: float) -> Solution:
    sweeps, (errors, squares) = Sweeps(posture, scope.state), posture.misses(scope.state)
    least = BIAS * max(sweeps.stiffness(), 1e-12 * posture.arm.length**2)
    weight = damping * SHARE * scale**2 * squares + least
    x = sweeps.step(scale * errors, weight, np.zeros(len(scope.lower)), scope.lower, scope.upper)
    return Solution(x, np.zeros(0, dtype=np.bool_), False)


class First(NamedTuple):
    """What strict tasks can have in one step.

    Attributes:
        x: the step that serves them alone, (n,).
        matrix: what of a step they feel, (e, n), of full rank.
    """

    x: Array
    matrix: Array


def first_things_first(posture: Posture, scope: Scope, strict: Linear, wanted: Array) -> First | None:
    """Solve for the strict tasks alone; None if that fails.

    Args:
        posture: what is asked of the arm.
        scope: what the step may do.
        strict: their rows.
        wanted: what the step should do for them, (r,) [m].
    """
    hessian = _damped(strict.matrix, 1e-8 * _typical(posture, strict.matrix))
    alone = solve(hessian, -(strict.matrix.T @ wanted), scope.lower, scope.upper, scope.rows)
    if alone.x is None:
        return None
    _, sigma, right = np.linalg.svd(strict.matrix, full_matrices=False)
    return First(alone.x, right[sigma > INDEPENDENT * max(float(sigma[0]), 1e-300)])


def then_the_rest(hessian: Array, gradient: Array, scope: Scope, first: First | None) -> Solution:
    """Minimise x^T H x / 2 + g^T x with the freedom that strict tasks leave.

    What the step does for them is asked of the whole step, as equations. So there always is one; where
    rounding hides it, because joints are at their bounds, it is the one that serves them alone.
    """
    if first is None:
        return solve(hessian, gradient, scope.lower, scope.upper, scope.rows)
    equal = (first.matrix, first.matrix @ first.x)
    found = solve(hessian, gradient, scope.lower, scope.upper, scope.rows, equal)
    return found if found.x is not None else found._replace(x=first.x)


def corrected(posture: Posture, scope: Scope, x: Array) -> Array:
    """The step with what its curvature does to strict tasks made good, as far as its bounds allow."""
    before = posture.task_rows(scope.state, strict=True)
    if before is None:
        return x
    inverse = np.linalg.pinv(before.matrix, rcond=INDEPENDENT)
    planned = before.errors - before.matrix @ x
    left, best = np.inf, x
    for _ in range(CORRECTIONS):
        after = posture.task_rows(posture.moved(scope.state, x), strict=True)
        missed = planned if after is None else after.errors - planned
        found = float(np.linalg.norm(missed))
        if found >= left:
            break
        left, best = found, x
        x = np.clip(x + inverse @ missed, scope.lower, scope.upper)
    return best


def settle(
    posture: Posture,
    state: ArmState,
    edges: Array,
    avoidance: Avoidance | None,
    good: float,
    borne: float = 0.0,
) -> Settled:
    """Think on from a state, step by step, until the merit falls no more.

    In a scene, a state that is too close to something first has to come clear; from then on it stays so.

    Args:
        posture: what is asked of the arm.
        state: where to begin.
        edges: joint positions to stay between, (2, nv) [rad or m].
        avoidance: what to keep clear of; nothing if None.
        good: mean distance of the control points from their targets that is good enough [m], if there are
            no further tasks.
        borne: how close it may be to something, short of the margin [m].
    """
    columns = posture.columns
    merit, damping, idle = posture.merit(state), 1.0, 0
    close = borne if avoidance is None else max(avoidance.intrusion(state), borne)
    for _ in range(ROUNDS):
        if not posture.tasks and close == borne and posture.mean_error(state) <= good:
            break
        here = state.positions[columns]
        lower, upper = ((edge[columns] - here) / posture.units for edge in edges)
        lower, upper = np.clip(lower, -STRIDE, 0.0), np.clip(upper, 0.0, STRIDE)
        rows = None if avoidance is None else avoidance.rows(state, lower, upper)
        scope = Scope(state, lower, upper, rows)
        x = reducing_step(posture, scope, damping).x
        tried = None if x is None else posture.moved(state, corrected(posture, scope, x))
        found = np.inf if tried is None else posture.merit(tried)
        closer = 0.0 if avoidance is None or tried is None else max(avoidance.intrusion(tried), borne)
        if tried is not None and (closer < close or (closer == close and found < merit)):
            idle = idle + 1 if closer == close and found > (1.0 - SETTLED) * merit else 0
            state, merit, close, damping = tried, found, closer, max(damping * EASIER, LEAST)
        else:
            damping *= HARDER
            idle += damping > MOST
        if idle >= PATIENCE:
            break
    return Settled(state, merit, posture.mean_error(state), close - borne)


def _capping(posture: Posture, state: ArmState) -> float:
    """Factor in (0, 1] that brings the largest error of a control point down to one module length."""
    errors = np.linalg.norm((posture.target.points - state.points) * posture.target.placed[:, None], axis=1)
    typical = posture.arm.length / posture.arm.n_modules
    return min(1.0, typical / max(float(errors.max()), 1e-300))


def _typical(posture: Posture, matrix: Array) -> float:
    """Mean diagonal of A^T A [m^2], above 0."""
    return float(max((matrix**2).sum() / matrix.shape[1], 1e-12 * posture.arm.length**2))


def _damped(matrix: Array, damping: float) -> Array:
    """A^T A + damping I."""
    hessian: Array = matrix.T @ matrix
    hessian[np.diag_indices(len(hessian))] += damping
    return hessian
