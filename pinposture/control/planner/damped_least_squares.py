"""Damped least squares within limits: steps that reduce all errors, and a search that iterates them."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from pinposture import kernels
from pinposture.arm import ChainState
from pinposture.control.limits import StepBounds
from pinposture.control.planner.avoidance import Avoidance
from pinposture.control.planner.objective import ChainSolver, LinearRows, Objective
from pinposture.control.planner.path import PATH
from pinposture.descent import Rating, descend
from pinposture.kernels.arrays import PostureProblem, SearchSettings
from pinposture.quadratic_program import ConstraintRows, Solution, solve

Array = NDArray[np.float64]


POSTURE_SEARCH = SearchSettings(
    good=0.0,
    largest_step=0.5,
    damping_share=0.5,
    least_damping=1e-10,
    least_stiffness=0.0,
    decrease=0.3,
    increase=4.0,
    least_factor=1e-6,
    most_factor=1e9,
    converged=1e-6,
    idle=3,
    steps=300,
)
"""How least squares search for postures that take points; `good` and `least_stiffness` depend on the arm.

Damping falls with the sum of squared errors (Sugihara 2011). `docs/design/branch_search.md` says what other
steps and kinds of damping do.
"""


class DescentSettings(NamedTuple):
    """What damped least squares need besides; `POSTURE_SEARCH` says how they are damped."""

    search_step: float = 0.2
    """Largest joint motion of one iteration of a search, in `Arm.joint_units`."""

    search_steps: int = 120
    """Largest number of iterations of a search."""

    quick_steps: int = 6
    """Largest number of steps of a search for a nearby posture."""

    same_fit: float = 0.01
    """Largest difference of a joint between fits that count as the same, in `Arm.joint_units`. Fits that end
    at the same minimum differ by 0.001."""

    independent: float = 1e-6
    """Smallest singular value of independent rows of tasks with priority, relative to the largest."""

    priority_damping: float = 1e-8
    """Damping of the step for tasks with priority alone, relative to the mean diagonal of A^T A."""

    few_rows: int = 2
    """Number of constraints up to which the time that is linear in the number of joints is the shorter
    one."""

    squared_joints_per_row: float = 1000.0
    """For long arms that number is the square of the number of joints over this."""

    retreat_tolerance: float = 1e-6
    """Gain of clearance in a step that a measured arm at rest need not make, in arm lengths."""

    curvature_corrections: int = 4
    """How often a step is corrected for the second-order errors of tasks with priority."""


DESCENT = DescentSettings()


class PlanningProblem(NamedTuple):
    """What is planned, none of which changes in the course of a plan.

    Attributes:
        objective: the objective.
        start: the state of the arm.
        position_limits: smallest and largest joint positions, (2, nv) [rad or m].
        avoidance: the obstacles to avoid; None: none.
    """

    objective: Objective
    start: ChainState
    position_limits: Array
    avoidance: Avoidance | None = None


class StepConstraints(NamedTuple):
    """Constraints on one step.

    Attributes:
        state: the state of the arm.
        lower: smallest step, (n,), in `Arm.joint_units`.
        upper: largest step, (n,).
        rows: further constraints; None: none.
        retreating: whether an approaching or moved obstacle, or a lost margin of the measured arm, forces the
            arm to move.
    """

    state: ChainState
    lower: Array
    upper: Array
    rows: ConstraintRows | None
    retreating: bool = False

    @classmethod
    def of(
        cls, objective: Objective, state: ChainState, step_bounds: StepBounds, avoidance: Avoidance | None
    ) -> StepConstraints:
        """Return the bounds that limits and obstacles impose."""
        lower, upper = (
            np.clip(objective.normalize(side), -PATH.most_step, PATH.most_step) for side in step_bounds.both
        )
        if avoidance is None:
            return cls(state, lower, upper, None)
        rows = avoidance.rows(state, lower, upper)
        may_retreat = avoidance.moving or avoidance.offset is not None or avoidance.lost(state)
        least = 0.0 if avoidance.moving else DESCENT.retreat_tolerance * state.arm.length
        retreating = may_retreat and rows is not None and bool(np.any(rows.least > least))
        return cls(state, lower, upper, rows, retreating)

    def equals(self, other: StepConstraints) -> bool:
        """Whether others are the same, at the same positions."""
        if (self.rows is None) != (other.rows is None):
            return False
        mine = [self.state.raw_positions, self.lower, self.upper, *(self.rows or ())]
        others = [other.state.raw_positions, other.lower, other.upper, *(other.rows or ())]
        return all(map(np.array_equal, mine, others))

    def admit(self, x: Array) -> bool:
        """Whether a step within the limits, (n,), satisfies the further constraints."""
        return self.rows is None or bool(np.all(self.rows.matrix @ x >= self.rows.least))


class LeastSquaresResult(NamedTuple):
    """Result of a search.

    Attributes:
        state: the final state of the arm.
        cost: half the remaining sum of squares [m^2].
        mean_error: mean distance of the control points from their targets [m].
        intrusion: by how much the arm is closer to an obstacle or itself than it may be, and violates a
            constraint [m]; 0 if clear.
    """

    state: ChainState
    cost: float
    mean_error: float
    intrusion: float


class FreeFit(NamedTuple):
    """A fit that disregards obstacles, and what a search among them found from there.

    Attributes:
        state: the state at the fit.
        result: the result of the search.
    """

    state: ChainState
    result: LeastSquaresResult


def reduce_errors(objective: Objective, constraints: StepConstraints, damping: float) -> Solution:
    """Solve for one step x towards all targets at once.

    The step minimises |A x - s e|^2 + lambda |x|^2 within its constraints, with all rows A and errors e of
    the objective. For a distant target, s scales all errors so that the largest of a point is one module
    length, within the range of the linearisation. The damping lambda grows with the errors.

    Args:
        objective: the objective.
        constraints: those of the step.
        damping: damping factor.
    """
    scale = _error_scale(objective, constraints.state)
    if not objective.tasks:
        solver = ChainSolver(objective, constraints.state)
        errors, squares = objective.point_errors(constraints.state)
        least = POSTURE_SEARCH.least_damping * max(solver.stiffness(), 1e-12 * objective.arm.length**2)
        weight = damping * POSTURE_SEARCH.damping_share * scale**2 * squares + least
        return solve_posture(solver, scale * errors, weight, np.zeros(len(constraints.lower)), constraints)
    rows = objective.rows(constraints.state)
    errors = scale * rows.errors
    least = POSTURE_SEARCH.least_damping * mean_diagonal(objective, rows.matrix)
    varied = damping * POSTURE_SEARCH.damping_share * float(errors @ errors)
    hessian = damped_hessian(rows.matrix, varied + least)
    tasks = objective.task_rows(constraints.state, priority=True)
    first = None
    if tasks is not None:
        first = solve_priority(
            objective, constraints, tasks, scale * tasks.errors, np.zeros(len(constraints.lower))
        )
    return solve_remaining(hessian, -(rows.matrix.T @ errors), constraints, first)


def solve_posture(
    solver: ChainSolver, errors: Array, damping: float, center: Array, constraints: StepConstraints
) -> Solution:
    """Minimise |A x - e|^2 + damping |x - c|^2 over points and chords, within the bounds of a step.

    With few constraints that could bind, the time is linear in the number of joints. With many, and where
    that fails, `solve` takes over. Infeasible constraints are violated as little as possible.

    Args:
        solver: points and chords, A, at a state.
        errors: errors e of the points, (p, 3) [m].
        damping: above 0 [m^2].
        center: c, (n,), in `Arm.joint_units`.
        constraints: those of the step.
    """
    lower = constraints.lower
    upper = constraints.upper
    problem = errors, damping, center, lower, upper
    if constraints.rows is None:
        return Solution(solver.step(*problem), np.zeros(0, dtype=np.bool_), False)
    normal = constraints.rows.normal()
    possible = np.flatnonzero(normal.lowest(lower, upper) < normal.least)
    step = None
    if len(possible) <= max(DESCENT.few_rows, len(lower) ** 2 / DESCENT.squared_joints_per_row):
        chosen = LinearRows(normal.matrix[possible], normal.least[possible])
        step = solver.constrained_step(*problem, chosen)
    if step is None:
        matrix, goals = solver.rows(errors)
        gradient = -(matrix.T @ goals + damping * center)
        return solve(damped_hessian(matrix, damping), gradient, lower, upper, constraints.rows)
    binding = np.zeros(len(normal.least), dtype=np.bool_)
    binding[possible] = step.binding
    return Solution(step.x, binding, step.softened)


class PriorityStep(NamedTuple):
    """Solution for the tasks with priority.

    Attributes:
        x: the step for these tasks alone, (n,).
        matrix: independent rows that span theirs, (e, n).
    """

    x: Array
    matrix: Array


def solve_priority(
    objective: Objective, constraints: StepConstraints, tasks: LinearRows, motion: Array, center: Array
) -> PriorityStep | None:
    """Solve for the tasks with priority alone; None if that fails.

    Where the arm is almost singular, damping keeps the step close to `center`, which is the solution if its
    rows have the wanted motion.

    Args:
        objective: the objective.
        constraints: those of the step.
        tasks: the rows of these tasks.
        motion: the motion that the rows should have, (r,) [m].
        center: the step to stay close to, (n,).
    """
    damping = DESCENT.priority_damping * mean_diagonal(objective, tasks.matrix)
    hessian = damped_hessian(tasks.matrix, damping)
    gradient = -(tasks.matrix.T @ motion + damping * center)
    alone = solve(hessian, gradient, constraints.lower, constraints.upper, constraints.rows)
    if alone.x is None:
        return None
    _, sigma, right = np.linalg.svd(tasks.matrix, full_matrices=False)
    return PriorityStep(alone.x, right[sigma > DESCENT.independent * max(float(sigma[0]), 1e-300)])


def solve_remaining(
    hessian: Array, gradient: Array, constraints: StepConstraints, first: PriorityStep | None
) -> Solution:
    """Minimise x^T H x / 2 + g^T x with equality constraints for the tasks with priority.

    Their rows must move as in the step for these tasks alone, which is hence feasible. If the solver fails
    because of rounding at the bounds, that step is returned.
    """
    if first is None:
        return solve(hessian, gradient, constraints.lower, constraints.upper, constraints.rows)
    equal = (first.matrix, first.matrix @ first.x)
    solution = solve(hessian, gradient, constraints.lower, constraints.upper, constraints.rows, equal)
    return solution if solution.x is not None else solution._replace(x=first.x)


def correct_curvature(
    objective: Objective, constraints: StepConstraints, x: Array, planned: Array | None = None
) -> Array:
    """Correct a step for second-order errors of tasks with priority, as far as its bounds allow.

    Args:
        objective: the objective.
        constraints: those of the step.
        x: the step, (n,).
        planned: the errors after it, (r,) [m]; None: those of the linearised tasks.
    """
    before = objective.task_rows(constraints.state, priority=True)
    if before is None:
        return x
    inverse = np.linalg.pinv(before.matrix, rcond=DESCENT.independent)
    planned = before.errors - before.matrix @ x if planned is None else planned
    left = np.inf
    best = x
    for _ in range(DESCENT.curvature_corrections):
        after = objective.errors_of_tasks(objective.state_after(constraints.state, x), priority=True)
        missed = planned if after is None else after - planned
        error = float(np.linalg.norm(missed))
        if error >= left:
            break
        left = error
        best = x
        x = np.clip(x + inverse @ missed, constraints.lower, constraints.upper)
    return best


def minimize(
    problem: PlanningProblem,
    state: ChainState,
    good: float,
    allowed: float = 0.0,
    steps: int = DESCENT.search_steps,
) -> LeastSquaresResult:
    """Search for a local minimum of the cost by steps from a state.

    In a scene, a state that violates the margin first becomes clear, and then stays so.

    Args:
        problem: objective, limits and obstacles.
        state: the initial state.
        good: mean distance of the control points from their targets at which the search ends [m], unless
            there are further tasks.
        allowed: violation of the margin that is accepted [m].
        steps: largest number of steps.
    """
    if problem.avoidance is None and not problem.objective.tasks:
        return _minimize_alone(problem.objective, state, problem.position_limits, good, steps)
    fit = _PostureFit(problem, good, allowed)
    state, rating = descend(fit, state, steps, POSTURE_SEARCH)
    return LeastSquaresResult(
        state, rating.cost, problem.objective.mean_error(state), rating.violation - allowed
    )


def minimize_from_free_fit(
    problem: PlanningProblem, state: ChainState, good: float, allowed: float, known: list[FreeFit]
) -> LeastSquaresResult:
    """Search for a local minimum of the cost as `minimize` does, from the fit that disregards obstacles.

    That one is compiled, and takes less time than a step among obstacles. If it is clear, it is the result.
    If another start has led to the same fit, its result is returned. Else one search among obstacles begins
    at the fit, another at the state, and the better result is returned.

    Args:
        problem: objective without tasks, limits and obstacles, without constraints.
        state: the initial state.
        good: as for `minimize`.
        allowed: as for `minimize`.
        known: the fits from other starts; this one is added.
    """
    free = minimize(problem._replace(avoidance=None), state, good)
    for before in known:
        change = state.arm.difference(before.state.q, free.state.q)
        if problem.objective.largest_motion(change) <= DESCENT.same_fit:
            return before.result
    violation = _PostureFit(problem, good, allowed).rate(free.state).violation
    result = free
    if violation > allowed:
        starts = free.state, state
        searches = [minimize(problem, start, good, allowed) for start in starts]
        result = min(searches, key=lambda search: (search.intrusion, search.cost))
    known.append(FreeFit(free.state, result))
    return result


class _PostureFit(NamedTuple):
    """The problem of `minimize`: an objective within limits, clear of obstacles."""

    problem: PlanningProblem
    good: float
    allowed: float

    def rate(self, state: ChainState) -> Rating:
        violation = self.allowed
        avoidance = self.problem.avoidance
        if avoidance is not None:
            violation = max(avoidance.intrusion(state), self.allowed) + avoidance.violation(state)
        return Rating(violation, self.problem.objective.cost(state))

    def is_solved(self, state: ChainState, rating: Rating) -> bool:
        objective = self.problem.objective
        clear = rating.violation == self.allowed
        return clear and not objective.tasks and objective.mean_error(state) <= self.good

    def step(self, state: ChainState, damping: float) -> ChainState | None:
        objective = self.problem.objective
        avoidance = self.problem.avoidance
        lower, upper = objective.normalize(self.problem.position_limits - state.positions)
        lower = np.clip(lower, -DESCENT.search_step, 0.0)
        upper = np.clip(upper, 0.0, DESCENT.search_step)
        rows = None if avoidance is None else avoidance.rows(state, lower, upper)
        constraints = StepConstraints(state, lower, upper, rows)
        x = reduce_errors(objective, constraints, damping).x
        return (
            None if x is None else objective.state_after(state, correct_curvature(objective, constraints, x))
        )


def _minimize_alone(
    objective: Objective, state: ChainState, position_limits: Array, good: float, steps: int
) -> LeastSquaresResult:
    """Run `minimize` for points and chords in free space, in one compiled call."""
    arm = objective.arm
    chain = objective.chain
    problem = PostureProblem(
        chain=arm.kinematics.constants,
        joints=chain.joints,
        units=chain.units,
        position_limits=np.ascontiguousarray(position_limits[:, chain.columns]),
        indices=chain.has_target,
        ends=chain.ends,
        targets=chain.goals,
        weights=chain.weights,
        chords=chain.chords,
        normal=chain.normal,
    )
    settings = POSTURE_SEARCH._replace(good=good, least_stiffness=1e-12 * arm.length**2, steps=steps)
    positions = state.raw_positions.copy()
    squares, mean = kernels.minimise_posture_errors(problem, settings, positions)
    return LeastSquaresResult(state.moved(positions - state.raw_positions), 0.5 * squares, mean, 0.0)


def damped_hessian(matrix: Array, damping: float) -> Array:
    """Return A^T A + damping I."""
    hessian: Array = matrix.T @ matrix
    hessian[np.diag_indices(len(hessian))] += damping
    return hessian


def _error_scale(objective: Objective, state: ChainState) -> float:
    """Return the factor in (0, 1] that brings the largest error of a control point to one module length."""
    errors = objective.target.distances(state.points)
    typical = objective.arm.length / objective.arm.n_modules
    return min(1.0, typical / max(float(errors.max()), 1e-300))


def mean_diagonal(objective: Objective, matrix: Array) -> float:
    """Return the mean diagonal of A^T A [m^2], above 0."""
    return float(max((matrix**2).sum() / matrix.shape[1], 1e-12 * objective.arm.length**2))
