"""One step along a path, or damped least squares where the path has ended."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from pinposture import kernels
from pinposture.arm import ArmState
from pinposture.control.controller import Diagnostics, Memory, Step
from pinposture.control.limits import ROUNDING, JointBounds, Limits, StepBox, farthest
from pinposture.control.planner.avoidance import Avoidance, ConstraintRows, Solution, solve
from pinposture.control.planner.objective import ChainSolver, Linear, Posture
from pinposture.control.planner.path import DISTURBED, FARTHEST, PathProgress
from pinposture.placement.points import TAKEN

# The usual step in one call: along the way, where nothing but the limits has a say.

ARRIVED = 1e-9
"""Joint motion left at which a way is behind the arm, in `Arm.joint_units`."""

RISES = 1e-12
"""By how much the posture error rises if it does, in arm lengths: less is rounding."""


def fast_step(progress: PathProgress, state: ArmState, bounds: JointBounds) -> Step | None:
    """The step that `Geodesic` takes where it is simply the next one on a way.

    It is looked for first, because most steps are such. What else they may be, the long way round finds out:
    limits that cannot be kept, an arm that is not where it should be, a way that is at its end or leads out
    of what limits allow.

    Args:
        progress: where the arm is on its way, with nothing to avoid.
        state: where the arm is.
        bounds: what the limits mean for its joints.

    Returns:
        The step; None if it is not that simple.
    """
    posture, path = progress.posture, progress.path
    if progress.arrived or progress.pace is not None or not posture.plain:
        return None
    arm, placed, chain, wanted = state.arm, state.forward, state.arm.kinematics, posture.chain
    expected = placed.positions if progress.expected is None else progress.expected
    if len(wanted.which) < len(chain.columns):
        return None
    dq, reached, at_limit = np.zeros(arm.nv), np.empty(arm.nv), np.empty(arm.nv, dtype=np.bool_)
    simple, place, before, after = kernels.advance(
        chain.constants,
        chain.endless,
        bounds.units,
        bounds.leaning,
        bounds.edges,
        bounds.bound,
        placed.positions,
        placed.points,
        path.offsets,
        path.positions,
        progress.place,
        expected,
        DISTURBED,
        ARRIVED,
        ROUNDING,
        FARTHEST,
        wanted.targets,
        wanted.flags,
        dq,
        reached,
        at_limit,
    )
    if not simple or not np.isfinite(after):
        return None
    progress = progress.gone_to(place, bounds.travel, place <= progress.place, reached)
    diagnostics = Diagnostics(
        0.0,
        0.0,
        0.0,
        len(posture.active) * arm.dimension,
        (),
        1.0,
        at_limit,
        "",
        error_increasing=after > before + RISES * arm.length,
        following_path=progress.waited == 0.0,
    )
    return Step(dq, posture.active, diagnostics, Memory(dq, progress))


# Damped least squares within limits: the step that reduces all errors at once, and where such steps end.

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
    rows: ConstraintRows | None

    @classmethod
    def of(cls, posture: Posture, state: ArmState, box: StepBox, avoidance: Avoidance | None) -> Scope:
        """What limits and obstacles leave of a step."""
        lower, upper = (np.clip(posture.own(side), -FARTHEST, FARTHEST) for side in box.sides)
        rows = None if avoidance is None else avoidance.rows(state, lower, upper)
        return cls(state, lower, upper, rows)


class LeastSquaresResult(NamedTuple):
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
    first = None if strict is None else solve_priority(posture, scope, strict, scale * strict.errors)
    return solve_remaining(hessian, -(linear.matrix.T @ errors), scope, first)


def _by_sweeps(posture: Posture, scope: Scope, damping: float, scale: float) -> Solution:
    sweeps, (errors, squares) = ChainSolver(posture, scope.state), posture.misses(scope.state)
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


def solve_priority(posture: Posture, scope: Scope, strict: Linear, wanted: Array) -> First | None:
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


def solve_remaining(hessian: Array, gradient: Array, scope: Scope, first: First | None) -> Solution:
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
) -> LeastSquaresResult:
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
    return LeastSquaresResult(state, merit, posture.mean_error(state), close - borne)


def _capping(posture: Posture, state: ArmState) -> float:
    """Factor in (0, 1] that brings the largest error of a control point down to one module length."""
    errors = np.linalg.norm(
        (posture.target.points - state.points) * posture.target.has_target[:, None], axis=1
    )
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


# One step along the way, or what is left of it within limits and around obstacles.

TRIES = 8
"""How often a step is damped harder when it fails to reduce the errors, before none is taken."""

STEP_ROUNDING = 1e-12
"""What is lost in the arithmetic of a step, in `Arm.joint_units`; it is cut at its limits anyway."""

EXACT = 1e-13
"""Error that no step can reduce, in arm lengths: it is rounding."""

BEHIND = 0.5
"""Share of a step that an arm may be behind its place on the way and still count as getting on: it then goes
on by as much as the limits of its slowest joint allow, however little that is of the whole way."""

CORRECTING = 0.25
"""Share of the acceleration limit with which an arm that is behind catches up."""


class CandidateStep(NamedTuple):
    """A step before the last checks.

    Attributes:
        dq: the step, (nv,) [rad or m].
        progress: where the arm will be on its progress.
        solution: what the program said; None if it need not be asked.
        reason: why the arm does not move; empty if it does.
    """

    dq: Array
    progress: PathProgress
    solution: Solution | None = None
    reason: str = ""


def follow(
    progress: PathProgress,
    state: ArmState,
    box: StepBox,
    limits: Limits,
    mu: float,
    avoidance: Avoidance | None = None,
) -> CandidateStep:
    """The step along the way, if its scope has it; else the one in it that is nearest in what points feel.

    Nearest means: it minimises |A (x - x_way)|^2 + mu^2 |x - x_way|^2, with all rows A of the posture and the
    weight mu of joint motion by which the way was found. Strict tasks come first; the way heeds the others.

    Args:
        progress: where the arm is on its way.
        state: where it is.
        box: the steps that the limits allow.
        limits: what they are.
        mu: weight of joint motion [m per `Arm.joint_units`].
        avoidance: what to keep clear of; nothing if None.
    """
    posture, path = progress.posture, progress.path
    bounds, here = limits.for_arm(state.arm), progress.place
    units = posture.chain.units
    if progress.pace is None:
        place, left, inside, dq = path.stride(state, here, posture.columns, units, box.sides)
        hindered = True  # unless it gets on
    elif path.end == 1.0 and not progress.given and bounds.brake is not None:
        # So short a way need not be straight: each joint comes to its end as fast as it can stop there.
        rest = path.offsets[-1] - path.offset_of(state, here)
        left = float(np.abs(rest[posture.columns] / units).max(initial=0.0))
        dq = np.minimum(np.maximum(farthest(rest, bounds.brake), box.lower), box.upper)
        ahead = float(np.abs((rest - dq)[posture.columns] / units).max(initial=0.0))
        whole = float(np.abs(path.offsets[-1][posture.columns] / units).max(initial=0.0))
        place, inside, hindered = max(here, 1.0 - ahead / max(whole, ARRIVED)), True, True
    else:
        columns, offset = posture.columns, path.offset_of(state, here)
        left = float(np.abs((path.offsets[-1] - offset)[columns] / units).max(initial=0.0))
        paced = min(progress.pace.next(here, progress.speed), path.end - here)
        onward, lag = path.smooth(here + paced) - path.smooth(here), path.smooth(here) - offset
        share = _share(onward[columns], lag[columns], bounds.bound[columns])
        place, hindered = here + share * paced, share < 1.0 or here >= path.end
        place = path.end if place > path.end - ARRIVED else place
        # What is behind is made good no faster than it can be stopped, or the arm would swing about its way.
        if bounds.brake is not None:
            lag = farthest(lag, CORRECTING * bounds.brake)
        dq = path.smooth(place) - path.smooth(here) + lag
        one = state.arm.joint_units
        within = (dq >= box.lower - STEP_ROUNDING * one) & (dq <= box.upper + STEP_ROUNDING * one)
        inside = bool(np.all((within & (np.abs(dq) <= FARTHEST * one))[posture.columns]))
    if place >= path.end and left <= ARRIVED:
        progress = progress._replace(arrived=True, place=path.end)
        return close_in(progress, Scope.of(posture, state, box, avoidance))
    if inside and avoidance is None and posture.plain:
        # Whatever is asked would lead to the same; and a step that leads on gets on (`JointPath.stride`).
        return CandidateStep(dq, progress.gone_to(place, bounds.travel, hindered and place <= here))
    hindered = _behind(progress, state) if progress.pace is None and here < place else hindered
    progress = progress.gone_to(place, bounds.travel, hindered)
    scope, wanted = Scope.of(posture, state, box, avoidance), posture.own(dq)
    if posture.plain and scope.rows is None:
        sweeps = ChainSolver(posture, state)
        x = sweeps.step(sweeps.covered(wanted), mu**2, wanted, scope.lower, scope.upper)
        return CandidateStep(posture.displacement(x), progress)
    strict = posture.task_rows(state, strict=True)
    if inside and strict is None and _clear(scope, wanted, dq, avoidance):
        return CandidateStep(dq, progress)
    matrix = posture.rows(state).matrix
    hessian = matrix.T @ matrix
    hessian[np.diag_indices(len(hessian))] += mu**2
    first = None
    if strict is not None:
        share = place / path.end
        before, after = progress.strict_errors
        intended = (1.0 - share) * before + share * after if len(before) == len(strict.errors) else 0.0
        first = solve_priority(posture, scope, strict, strict.errors - intended)
    found = solve_remaining(hessian, -(hessian @ wanted), scope, first)
    x = np.clip(wanted, scope.lower, scope.upper) if found.x is None else corrected(posture, scope, found.x)
    return CandidateStep(posture.displacement(x), progress, found)


def _behind(progress: PathProgress, state: ArmState) -> bool:
    """Whether a joint is farther behind the place of the arm on its way than `BEHIND` allows."""
    lag = progress.path.offset(progress.place) - progress.path.offset_of(state, progress.place)
    return bool(np.any((np.abs(lag) > BEHIND * progress.bounds.bound)[progress.posture.columns]))


def _share(onward: Array, lag: Array, bound: Array) -> float:
    """The share of the way onward that a joint may go if it makes good at once what it is behind, (n,)."""
    gap = np.where(onward < 0.0, bound + lag, bound - lag)
    share = np.where(np.abs(lag) > bound, 0.0, gap / np.maximum(np.abs(onward), 1e-100))
    return float(min(share.min(initial=1.0), 1.0))


def _clear(scope: Scope, x: Array, dq: Array, avoidance: Avoidance | None) -> bool:
    """Whether the step keeps clear: by the rows of the scope, which are cautious, or by looking."""
    if scope.rows is None or avoidance is None:
        return True
    return bool(np.all(scope.rows.matrix @ x >= scope.rows.least)) or avoidance.stops_clear(scope.state, dq)


def close_in(progress: PathProgress, scope: Scope) -> CandidateStep:
    """The step that reduces what errors are left, damped until it does.

    Args:
        progress: a progress whose way is behind the arm.
        scope: what the step may do.
    """
    posture, damping, found = progress.posture, progress.damping, None
    merit = posture.merit(scope.state)
    for _ in range(TRIES if merit > (EXACT * posture.arm.length) ** 2 else 0):
        found = reducing_step(posture, scope, damping)
        x = None if found.x is None else corrected(posture, scope, found.x)
        if x is not None and posture.merit(posture.moved(scope.state, x)) < (1.0 - SETTLED) * merit:
            easier = progress._replace(damping=max(damping * EASIER, LEAST))
            return CandidateStep(posture.displacement(x), easier, found)
        damping *= HARDER
    rest = np.clip(np.zeros(len(scope.lower)), scope.lower, scope.upper)  # which braking may still forbid
    reason = (
        ""
        if np.any(rest)
        else f"no step within the limits reduces the errors any more{_left(posture, scope)}"
    )
    return CandidateStep(posture.displacement(rest), progress, found, reason)


def _left(posture: Posture, scope: Scope) -> str:
    """What tasks are left with, and that bare points were not all found, in words."""
    left = [
        f"{type(task).__name__} by {np.linalg.norm(task.rows(scope.state, posture.target).error):.3g} m"
        for task in posture.tasks
    ]
    words = f"; tasks that are not met: {', '.join(left)}" if left else ""
    target, missed = posture.target, posture.mean_error(scope.state) > TAKEN * posture.arm.length
    if missed and (target.q is None or target.approximate):
        words += (
            "; no posture was found that takes all points, and the closest that was may be a local minimum"
        )
    return words
