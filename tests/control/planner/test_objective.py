"""Rows of the sum of squares against its derivative, on arms of every kind."""

from __future__ import annotations

import numpy as np
import pytest
from control.task_arms import ARMS, STATES, arm_called, derivative, state_of, target_of

import pinposture as pp
from pinposture.control.planner.objective import Objective
from pinposture.control.tasks import EndEffector, JointPosture


def apart(arm: pp.Arm, seed: int, weights: np.ndarray | None = None) -> pp.Target:
    """A target that no state of the tests takes, in the plane of a planar arm."""
    shift = np.random.default_rng(seed).normal(size=(arm.n_modules, arm.dimension)) * 0.05
    points = target_of(arm).points + shift @ arm.plane
    return pp.Target.from_points(arm, points, weights)


def weighed(arm: pp.Arm) -> np.ndarray:
    """Weights of all sizes, and a region where the arm has room for one."""
    weights = np.linspace(0.3, 2.0, arm.n_modules)
    if arm.n_modules > 2:
        weights[1] = 0.0
    return weights


def errors_by_hand(state: pp.ArmState, target: pp.Target, relative_position_weight: float) -> np.ndarray:
    """Weighted errors of points, then of chords between points that follow each other and have a target."""
    placed = [k for k in range(state.arm.n_modules) if target.weights[k] > 0.0]
    error = [state.arm.plane @ (target.points[k] - state.points[k]) for k in placed]
    rows = [np.sqrt(target.weights[k]) * e for k, e in zip(placed, error, strict=True)]
    for i in range(len(placed) - 1 if relative_position_weight else 0):
        weight = relative_position_weight * min(target.weights[placed[i]], target.weights[placed[i + 1]])
        rows.append(np.sqrt(weight) * (error[i + 1] - error[i]))
    return np.concatenate(rows)


@pytest.mark.parametrize("name, seed", STATES)
@pytest.mark.parametrize("relative_position_weight", [0.0, 0.7])
def test_errors_and_their_derivative(name: str, seed: int | None, relative_position_weight: float) -> None:
    state = state_of(name, seed)
    arm = arm_called(name)
    target = apart(arm, 3, weighed(arm))
    objective = Objective(arm, target, (), relative_position_weight)
    linear = objective.rows(state)
    np.testing.assert_allclose(
        linear.errors, errors_by_hand(state, target, relative_position_weight), atol=1e-14
    )
    slope = (
        derivative(state, lambda at: -objective.rows(at).errors)[:, objective.chain.columns]
        * objective.chain.units
    )
    np.testing.assert_allclose(linear.matrix, slope, atol=1e-8)
    assert objective.cost(state) == pytest.approx(0.5 * float(linear.errors @ linear.errors))
    gradient = (
        derivative(state, lambda at: np.array([objective.cost(at)]))[0, objective.chain.columns]
        * objective.chain.units
    )
    np.testing.assert_allclose(gradient, -linear.matrix.T @ linear.errors, atol=1e-8)


@pytest.mark.parametrize("name", ["spatial", "planar", "mixed", "scara"])
def test_rows_of_tasks_follow_with_their_weights(name: str) -> None:
    state = state_of(name, 1)
    arm = arm_called(name)
    tip = EndEffector(position=state.points[-1] + 0.01 * arm.plane[0], weight=9.0)
    rest = JointPosture(q=arm.neutral(), weight=0.04)
    objective = Objective(arm, apart(arm, 1), (tip, rest))
    target = apart(arm, 1)
    linear = objective.rows(state)
    alone = Objective(arm, target).rows(state)
    assert len(linear.errors) == len(alone.errors) + arm.dimension + arm.nv
    np.testing.assert_array_equal(linear.errors[: len(alone.errors)], alone.errors)
    np.testing.assert_allclose(
        linear.errors[len(alone.errors) :][: arm.dimension], 3.0 * 0.01 * np.eye(arm.dimension)[0], atol=1e-12
    )
    slope = (
        derivative(state, lambda at: -objective.rows(at).errors)[:, objective.chain.columns]
        * objective.chain.units
    )
    np.testing.assert_allclose(linear.matrix, slope, atol=1e-7)


def test_strict_tasks_are_listed_by_themselves() -> None:
    state = state_of("spatial", 1)
    arm = arm_called("spatial")
    first = EndEffector(position=np.ones(3), weight=1.0, priority=True)
    objective = Objective(arm, apart(arm, 1), (JointPosture(q=arm.neutral()), first))
    strict = objective.task_rows(state, priority=True)
    moves = state.jacobians[-1][:, objective.chain.columns] * objective.chain.units
    share = np.linalg.norm(strict.errors) / np.linalg.norm(np.ones(3) - state.points[-1])
    np.testing.assert_allclose(strict.errors, share * (np.ones(3) - state.points[-1]))
    np.testing.assert_allclose(strict.matrix, share * moves)
    rest = objective.task_rows(state, priority=False)
    assert len(rest.errors) == arm.nv
    assert Objective(arm, apart(arm, 1), (JointPosture(q=arm.neutral()),)).task_rows(state, True) is None


@pytest.mark.parametrize("name", ARMS)
def test_a_step_and_its_displacement_are_the_same_thing(name: str) -> None:
    arm = arm_called(name)
    state = state_of(name, 0)
    objective = Objective(arm, target_of(arm))
    x = np.random.default_rng(0).normal(size=len(objective.chain.columns))
    dq = objective.displacement(x)
    np.testing.assert_allclose(objective.normalize(dq), x, rtol=1e-14)
    np.testing.assert_array_equal(objective.state_after(state, x).q, arm.integrate(state.q, dq))


def test_joints_without_room_stay_out() -> None:
    limits = pp.template("RyRz").with_limits(-1.0, 1.0)
    still = pp.ModuleTemplate(
        "still", (pp.JointSpec("y", lower=0.2, upper=0.2 + 1e-15), pp.JointSpec("z")), (0.1, 0.1)
    )
    arm = pp.Arm.from_modules([limits, still, limits])
    objective = Objective(arm, pp.Target.from_points(arm, arm.at(arm.straight()).points))
    free = arm.limits.upper > arm.limits.lower
    np.testing.assert_array_equal(objective.chain.columns, np.flatnonzero(free))
