"""Where the search for a configuration ends, against bounded least squares from many starts."""

from __future__ import annotations

from functools import cache
from typing import Any

import numpy as np
import pytest
from scipy.optimize import least_squares, nnls

import pinposture as pp
from pinposture.arm import smooth_configuration
from pinposture.collision import CollisionModel
from pinposture.control.planner.avoidance import Avoidance
from pinposture.control.planner.damped_least_squares import (
    PlanningProblem,
    StepConstraints,
    minimize,
    solve_posture,
)
from pinposture.control.planner.objective import ChainSolver, Objective
from pinposture.control.planner.plan import find_goal, find_path
from pinposture.control.tasks import EndEffector
from pinposture.errors import PostureWarning
from pinposture.quadratic_program import ConstraintRows

GOOD = 1e-9


@cache
def arm_named(name: str) -> pp.Arm:
    if name == "planar":
        return pp.Arm.from_modules([pp.template("Rz").with_limits(-1.2, 1.2)] * 4)
    return pp.Arm.from_modules([pp.template("RyRz").with_limits(-1.0, 0.8)] * 3)


def edges_of(arm: pp.Arm) -> np.ndarray:
    return np.array([arm.limits.lower, arm.limits.upper])


def best_of_many(objective: Objective, starts: int) -> float:
    """The lowest cost that scipy finds from random starts."""
    arm = objective.arm
    lower, upper = edges_of(arm)
    rng = np.random.default_rng(1)
    found = (
        least_squares(
            lambda q: objective.rows(arm.at(q)).errors,
            rng.uniform(lower, upper),
            lambda q: -objective.rows(arm.at(q)).matrix,
            (lower, upper),
            xtol=1e-12,
            ftol=1e-12,
            gtol=1e-12,
        ).cost
        for _ in range(starts)
    )
    return float(min(found))


def unreachable(arm: pp.Arm, seed: int) -> pp.Target:
    """Points near a objective, too far from each other for the arm, or too near."""
    rng = np.random.default_rng(seed)
    points = arm.at(rng.uniform(*edges_of(arm))).points * rng.uniform(0.7, 1.4)
    shift = rng.normal(size=(arm.n_modules, arm.dimension)) * 0.15 * arm.length / arm.n_modules
    return pp.Target.from_points(arm, points + shift @ arm.plane)


def among(objective: Objective, ball: pp.Sphere) -> PlanningProblem:
    """The search for a goal beside a ball, from the straight arm."""
    arm = objective.arm
    scene = pp.Scene({"ball": ball}, self_collision=False, margin=0.01)
    avoidance = Avoidance(CollisionModel(arm, scene), objective, pp.Limits().for_arm(arm))
    return PlanningProblem(objective, arm.chain_at(arm.straight()), edges_of(arm), avoidance)


@pytest.mark.parametrize("seed", range(3))
def test_a_ball_beside_the_best_posture_leaves_the_goal_where_it_is(seed: int) -> None:
    arm = arm_named("spatial")
    objective = Objective(arm, unreachable(arm, seed))
    alone = PlanningProblem(objective, arm.chain_at(arm.straight()), edges_of(arm))
    best = find_goal(alone, GOOD).state
    tip = best.points[-1]
    onward = (tip - best.points[-2]) / np.linalg.norm(tip - best.points[-2])
    beside = among(objective, pp.Sphere(tuple(tip + 0.12 * onward), 0.05))
    assert beside.avoidance.allows(best)
    np.testing.assert_allclose(find_goal(beside, GOOD).state.q, best.q, atol=1e-3)


@pytest.mark.long
@pytest.mark.parametrize("seed", range(3))
def test_a_ball_on_the_best_posture_moves_the_goal_about_as_little_as_six_searches_do(seed: int) -> None:
    arm = arm_named("spatial")
    objective = Objective(arm, unreachable(arm, seed))
    alone = PlanningProblem(objective, arm.chain_at(arm.straight()), edges_of(arm))
    tip = find_goal(alone, GOOD).state.points[-1]
    problem = among(objective, pp.Sphere(tuple(tip), 0.04))
    found = find_goal(problem, GOOD)
    assert found.intrusion == 0.0 and problem.avoidance.allows(found.state)
    rng = np.random.default_rng(seed)
    others = [minimize(problem, arm.chain_at(rng.uniform(*edges_of(arm))), GOOD) for _ in range(6)]
    assert found.cost <= 1.2 * min(other.cost for other in others if other.intrusion == 0.0)


@pytest.mark.long
@pytest.mark.parametrize("name", ["planar", "spatial"])
def test_points_out_of_reach_are_met_as_well_as_scipy_can(name: str) -> None:
    arm = arm_named(name)
    worse = []
    for seed in range(5):
        objective = Objective(arm, unreachable(arm, seed))
        start = np.random.default_rng(seed).uniform(*edges_of(arm))
        found = find_goal(PlanningProblem(objective, arm.at(start), edges_of(arm)), GOOD)
        assert arm.within_limits(found.state.q)
        assert found.cost == pytest.approx(objective.cost(found.state), rel=1e-12)
        worse.append(found.cost / best_of_many(objective, 4))
    assert max(worse) <= 1.001, worse


@pytest.mark.parametrize("name", ["planar", "spatial"])
def test_reachable_points_are_reached(name: str) -> None:
    arm = arm_named(name)
    for seed in range(6):
        rng = np.random.default_rng(seed)
        start, goal = rng.uniform(*edges_of(arm), (2, arm.nv))
        objective = Objective(arm, pp.Target.from_points(arm, arm.at(goal).points))
        found = find_goal(PlanningProblem(objective, arm.at(start), edges_of(arm)), GOOD * arm.length)
        assert found.mean_error <= GOOD * arm.length
        assert arm.within_limits(found.state.q)


@pytest.mark.parametrize("modules", [20, 60])
@pytest.mark.parametrize("spread", [0.2, 1.0])
def test_points_of_an_arm_give_the_configuration_that_it_has(modules: int, spread: float) -> None:
    arm = pp.Arm.from_template("RyRz", modules)
    for seed in range(4):
        rng = np.random.default_rng(seed)
        start = smooth_configuration(arm, rng, 0.6)
        goal = np.clip(start + spread * rng.normal(size=arm.nv), *edges_of(arm))
        objective = Objective(arm, pp.Target.from_points(arm, arm.at(goal).points))
        path = find_path(PlanningProblem(objective, arm.chain_at(start), edges_of(arm)))
        assert np.abs(arm.at(path.configuration(path.end)).points - objective.target.points).max() < 1e-10
        np.testing.assert_allclose(path.configuration(path.end), goal, atol=1e-9)


def test_a_known_configuration_is_taken_as_it_is() -> None:
    arm = arm_named("spatial")
    goal = np.random.default_rng(0).uniform(*edges_of(arm))
    objective = Objective(arm, pp.Target.from_configuration(arm, goal))
    found = find_goal(PlanningProblem(objective, arm.at(arm.straight()), edges_of(arm)), GOOD)
    np.testing.assert_allclose(found.state.q, goal, atol=1e-15)


def test_a_known_configuration_outside_the_limits_gives_the_nearest_inside() -> None:
    arm = arm_named("planar")
    goal = np.array([0.3, 1.6, -0.4, -1.5])
    with pytest.warns(PostureWarning, match="2 joints outside the limits"):
        objective = Objective(arm, pp.Target.from_configuration(arm, goal))
    found = find_goal(PlanningProblem(objective, arm.at(arm.straight()), edges_of(arm)), GOOD)
    assert arm.within_limits(found.state.q)
    assert found.cost <= 1.001 * best_of_many(objective, 4)


def test_the_cost_never_rises_while_it_settles() -> None:
    """Shorter searches are beginnings of longer ones: their costs fall."""
    arm = arm_named("spatial")
    for seed in range(4):
        rng = np.random.default_rng(seed)
        objective = Objective(arm, unreachable(arm, seed))
        start = arm.at(rng.uniform(*edges_of(arm)))
        problem = PlanningProblem(objective, start, edges_of(arm))
        found = minimize(problem, start, GOOD)
        assert found.cost < objective.cost(start)
        again = minimize(problem, found.state, GOOD)
        assert again.cost <= found.cost
        assert again.cost >= 0.999 * found.cost  # it had settled


@pytest.mark.long
@pytest.mark.parametrize("name", ["planar", "spatial"])
def test_a_strict_task_is_met_as_well_as_if_it_were_alone(name: str) -> None:
    """The tip has a target in reach or out of it, and the points ask for something else."""
    arm = arm_named(name)
    for seed in range(3):
        rng = np.random.default_rng(seed)
        start, other = rng.uniform(*edges_of(arm), (2, arm.nv))
        aside = arm.plane.T @ rng.normal(size=arm.dimension)
        place = arm.at(other).points[-1] + (
            0.3 * arm.length * aside / np.linalg.norm(aside) if seed % 2 else 0.0
        )
        target = pp.Target.from_points(arm, arm.at(rng.uniform(*edges_of(arm))).points)
        tip = np.eye(arm.n_modules)[-1]
        alone = Objective(arm, pp.Target.from_points(arm, np.tile(place, (arm.n_modules, 1)), tip))
        least = np.sqrt(2.0 * best_of_many(alone, 4))
        both = Objective(arm, target, (EndEffector(position=place, priority=True),))
        found = find_goal(PlanningProblem(both, arm.at(start), edges_of(arm)), GOOD)
        missed = float(np.linalg.norm(found.state.points[-1] - place))
        assert missed <= 1.02 * least + 1e-3 * arm.length, (seed, missed, least)


@pytest.mark.parametrize("modules, count, along_chain", [(40, 6, True), (10, 8, False), (40, 300, False)])
def test_steps_among_few_and_many_constraints_are_optimal(
    modules: int, count: int, along_chain: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The slope of the cost is what the bounds and constraints push: non-negative multipliers exist."""
    rng = np.random.default_rng(modules + count)
    arm = pp.Arm.from_template("RyRz", modules)
    calls = []
    original = ChainSolver.constrained_step

    def counted(*given: Any) -> Any:
        calls.append(given)
        return original(*given)

    monkeypatch.setattr(ChainSolver, "constrained_step", counted)
    for _ in range(3):
        state, goal = (arm.chain_at(pp.arm.smooth_configuration(arm, rng, 0.6)) for _ in range(2))
        target = pp.Target.from_configuration(arm, goal.q)
        objective = Objective(arm, target, (), 1.0, 0.2)
        links = rng.integers(modules // 2, modules, count)
        ways = rng.normal(size=(count, 3))
        rows = np.einsum("ri,rij->rj", ways, state.jacobians[links])
        least = -rng.uniform(0.0, 0.004, count) * arm.length
        edge = np.full(arm.nv, 0.1)
        bounds = StepConstraints(state, -edge, edge, ConstraintRows(rows, least))
        solver, (errors, squares) = ChainSolver(objective, state), objective.point_errors(state)
        damping = 1e-3 * squares
        found = solve_posture(solver, errors, damping, np.zeros(arm.nv), bounds)
        x, (matrix, wanted) = found.x, solver.rows(errors)
        assert np.all(np.abs(x) <= edge + 1e-12) and np.all(rows @ x >= least - 1e-8) and not found.softened
        slope = matrix.T @ (matrix @ x - wanted) + damping * x
        binding = rows[rows @ x <= least + 1e-8]
        sides = np.diag(-np.sign(x))[np.abs(x) >= edge - 1e-12]
        assert len(binding)
        _, left = nnls(np.vstack([binding, sides]).T, slope)
        assert left <= 1e-6 * np.linalg.norm(matrix.T @ wanted)
    assert bool(calls) == along_chain
