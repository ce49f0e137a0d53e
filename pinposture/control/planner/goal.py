"""The goal configuration: the posture that takes a target, or comes closest to it."""

from __future__ import annotations

from collections.abc import Iterator
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from pinposture import kernels
from pinposture.arm import ChainState
from pinposture.arm.arm import nearest_turns
from pinposture.control.planner.damped_least_squares import (
    DESCENT,
    FreeFit,
    LeastSquaresResult,
    PlanningProblem,
    minimize,
    minimize_from_free_fit,
)
from pinposture.control.planner.objective import OBJECTIVE, Objective
from pinposture.control.planner.path import PATH
from pinposture.placement.points import initial_guesses, points_determine_joints
from pinposture.units import CONVERGED

Array = NDArray[np.float64]


class PlanNeeded(Exception):
    """A step needs a path or a goal that takes too long to find in a control cycle.

    Attributes:
        attempt: number of paths to the same target that were abandoned before.
        rest: what is left of the last one, as for `repair`; None: nothing.
    """

    def __init__(self, attempt: int = 0, rest: Array | None = None) -> None:
        super().__init__(attempt)
        self.attempt = attempt
        self.rest = rest


class GoalSettings(NamedTuple):
    """How many starts a search for a goal compares, and which result it prefers.

    `docs/design/branch_search.md` says what half and twice of them change.
    """

    random_starts: int = 6
    """Number of random starts if no configuration is known."""

    random_spread: float = 0.5
    """Spread of these starts, in `Arm.joint_units`."""

    agreeing: int = 3
    """Number of consecutive searches that must agree to skip the rest."""

    much_better: float = 0.5
    """Share of the cost of an earlier goal below which a later one is preferred, if a task holds the
    arm."""


GOAL = GoalSettings()


def find_goal(
    problem: PlanningProblem,
    good: float,
    before: ChainState | None = None,
    enough: float = 0.0,
    prompt: bool = False,
) -> LeastSquaresResult:
    """Find the configuration with the smallest cost.

    If the target has a configuration, the search starts there. Otherwise it starts at the current state; then
    at the configuration that takes the points module by module (`placement.points`), or the last state of
    that search; then at the fit of the whole arm to the points, within the limits; then at random
    configurations from a fixed seed. Those are also tried if the configuration of the target collides or
    misses a task with priority. The current state comes second where the points leave modules only a few
    solutions: the search takes the nearest ones, as least squares do, in far less time. The search ends at
    the first result that is good enough, or when several consecutive ones agree, and returns the best. Among
    obstacles alone, each search begins with a fit that disregards them.

    Args:
        problem: what is planned.
        good: mean distance of the control points from their targets that is good enough [m].
        before: first start if the target has no configuration: the goal of a similar target.
        enough: mean distance that is good enough in view of the error for that target [m].
        prompt: whether to raise `PlanNeeded` if the first search is not enough.
    """
    objective, state, _, avoidance = problem
    known = objective.target.q is not None
    has_priority = any(task.priority for task in objective.tasks)
    # If a task with priority holds the arm, a distant goal may not be reachable: prefer one nearby.
    held = is_held(objective, state)
    better = GOAL.much_better if held else 1.0
    # An arm that violates the margin at the start may do so at the goal by as much.
    allowed = 0.0 if avoidance is None else avoidance.intrusion(state)
    starts = _starts(problem, held, before)
    fits: list[FreeFit] = []

    def search(start: ChainState) -> LeastSquaresResult:
        if avoidance is None or objective.tasks or avoidance.constrained:
            return minimize(problem, start, good, allowed)
        return minimize_from_free_fit(problem, start, good, allowed, fits)

    best = latest = search(next(starts))
    good_enough = max(good, enough)
    agreeing = 1
    while agreeing < GOAL.agreeing and not (
        latest.intrusion == 0.0
        and (_is_good_enough(objective, latest, good_enough) or (known and not has_priority))
    ):
        if prompt:
            raise PlanNeeded
        start = next(starts, None)  # lazily, as computing one can take long
        if start is None:
            break
        latest = search(start)
        alike = latest.intrusion == best.intrusion == 0.0 and not objective.tasks
        agreeing = agreeing + 1 if alike and abs(latest.cost - best.cost) <= CONVERGED * best.cost else 1
        if (latest.intrusion, latest.cost) < (best.intrusion, better * best.cost):
            best = latest
    return best


def _is_good_enough(objective: Objective, result: LeastSquaresResult, good: float) -> bool:
    """Whether a result takes the target posture and fulfils the tasks with priority."""
    errors = objective.errors_of_tasks(result.state, priority=True)
    fulfilled = errors is None or float(np.linalg.norm(errors)) <= good
    return fulfilled and result.mean_error <= good


def is_held(objective: Objective, state: ChainState) -> bool:
    """Whether tasks with priority hold the arm: their errors are within a module length."""
    errors = objective.errors_of_tasks(state, priority=True)
    typical = objective.arm.length / objective.arm.n_modules
    return errors is not None and float(np.linalg.norm(errors)) <= typical


def _starts(problem: PlanningProblem, held: bool, before: ChainState | None) -> Iterator[ChainState]:
    objective = problem.objective
    state = problem.start
    arm = objective.arm
    target = objective.target
    if before is not None and target.q is None:
        yield before
    known = target.q is not None
    guesses = iter(()) if known else initial_guesses(arm, target, arm.positions(state.q))
    if not (known or before or objective.tasks) and points_determine_joints(arm, target.has_target):
        yield _within_limits(problem, arm.configuration(next(guesses)))
    if held:
        yield state
    if target.q is not None:
        yield _within_limits(problem, target.q)
    if not held:
        yield state
    for positions in guesses:
        yield _within_limits(problem, arm.configuration(positions))
    rng = np.random.default_rng(0)
    for number in range(GOAL.random_starts):
        origin = arm.straight() if number % 2 else state.q
        change = objective.displacement(GOAL.random_spread * rng.normal(size=len(objective.chain.columns)))
        yield _within_limits(problem, arm.integrate(origin, change))


def _within_limits(problem: PlanningProblem, q: Array) -> ChainState:
    """Return the state at a configuration, clipped at the limits; joints that do not matter stay.

    Multi-turn joints take the turn nearest to the current state.
    """
    objective, state, position_limits, _ = problem
    arm = objective.arm
    change = np.array(arm.difference(state.q, arm.nearest_turns(q, state.q, position_limits)))
    here = arm.positions(state.q)
    if not objective.tasks:  # joints beyond the last control point with a target need not move
        last = int(np.flatnonzero(objective.target.has_target)[-1])
        change = change * arm.support[last]
    moved = np.zeros(arm.nv)
    columns = objective.chain.columns
    moved[columns] = np.clip(here + change, position_limits[0], position_limits[1])[columns] - here[columns]
    return state.moved(moved)


def known_goal(objective: Objective, position_limits: Array, before: Array) -> ChainState | None:
    """Return the state at the configuration of a target, if it is within limits and takes the posture.

    Multi-turn joints are within half a turn of a previous configuration.
    """
    arm = objective.arm
    goal = objective.goal
    if goal is None or len(objective.chain.active) < arm.n_modules:
        return None
    turned = nearest_turns(arm, goal.q, before, position_limits)
    if turned is not goal.q:
        goal = ChainState(arm, turned)
    inside = kernels.position_excess(goal.raw_positions, position_limits, arm.kinematics.columns) == 0.0
    return goal if inside and objective.has_exact_goal else None


def find_positions_near(objective: Objective, state: ChainState, position_limits: Array) -> Array | None:
    """Return joint positions that take the target posture, near those of a state.

    Args:
        objective: points and chords.
        state: the initial state.
        position_limits: smallest and largest joint positions, (2, nv) [rad or m].

    Returns:
        Joint positions, (nv,) [rad or m]: those of the configuration of the target if it has one, else those
        that a short search finds; None if it finds none.
    """
    arm = objective.arm
    goal = objective.goal
    if goal is not None:
        return goal.raw_positions if len(objective.chain.active) == arm.n_modules else None
    if objective.mean_error(state) > PATH.short_motion * arm.length:
        return None
    good = OBJECTIVE.goal_tolerance * arm.length
    problem = PlanningProblem(objective, state, position_limits)
    found = minimize(problem, state, good, steps=DESCENT.quick_steps)
    return found.state.raw_positions if found.mean_error <= good else None
