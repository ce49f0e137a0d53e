"""Targets that one short step reaches, with their configuration known and as bare points."""

from __future__ import annotations

import numpy as np
import pytest
from arms import template_arm
from collision.arms_with_bodies import sliding
from hypothesis import given
from hypothesis import strategies as st
from sampling import examples

import pinposture as pp
from pinposture.arm import smooth_configuration
from pinposture.control.planner.damped_least_squares import PlanningProblem, minimize
from pinposture.control.planner.objective import Objective

ARMS = {
    "spatial": lambda: template_arm("RyRz", 8),
    "planar": lambda: template_arm("Rz", 9),
    "sliding": sliding,
}


@pytest.mark.parametrize("name", ARMS)
@given(seed=st.integers(0, 2**32 - 1), known=st.booleans(), size=st.floats(1e-4, 0.09))
@examples(15)
def test_the_step_reaches_what_is_near_and_keeps_the_limits(
    name: str, seed: int, known: bool, size: float
) -> None:
    arm = ARMS[name]()
    rng = np.random.default_rng(seed)
    q = smooth_configuration(arm, rng, 0.6)
    q = np.clip(q, arm.limits.lower, arm.limits.upper)
    ahead = size * arm.joint_units * rng.uniform(-1.0, 1.0, arm.nv)
    goal = np.clip(q + ahead, arm.limits.lower, arm.limits.upper)
    target = pp.Target.from_configuration(arm, goal)
    if not known:
        target = pp.Target.from_points(arm, target.points)
    bound = rng.choice([0.05, 0.1, 0.3])
    step = pp.Geodesic().step(arm.at(q), target, pp.Limits(step=bound))
    assert np.abs(step.dq).max() <= bound + 1e-12
    off = np.linalg.norm(arm.at(arm.integrate(q, step.dq)).points - target.points, axis=1).mean()
    if known and size < bound:
        np.testing.assert_allclose(step.dq, goal - q, atol=1e-12)
    if size < 0.5 * bound and (known or name != "sliding"):  # slides may be traded for turns
        assert off <= 1e-7 * arm.length
    assert step.active == tuple(range(arm.n_modules))
    assert step.reason == ""


def test_a_target_a_whole_turn_away_is_reached_by_the_short_way() -> None:
    arm = template_arm("RyRz", 4)
    q = np.full(arm.nv, 0.2)
    turns = np.where(np.arange(arm.nv) % 3 == 0, 2.0 * np.pi, 0.0)
    wide = pp.Arm.from_modules([pp.template("RyRz").with_limits(-7.0, 7.0)] * 4)
    target = pp.Target.from_configuration(wide, q + 0.01 - turns)
    step = pp.Geodesic().step(wide.at(q), target)
    np.testing.assert_allclose(step.dq, 0.01, atol=1e-12)


def test_a_goal_beyond_a_position_limit_is_not_stepped_to() -> None:
    arm = pp.Arm.from_modules([pp.template("RyRz").with_limits(-0.5, 0.5)] * 4)
    q = np.full(arm.nv, 0.48)
    points = arm.at(arm.integrate(q, np.full(arm.nv, 0.05))).points
    for target in (
        pp.Target.from_points(arm, points),
        pp.Target(points, np.ones(4), q=q + 0.05),
    ):
        step = pp.Geodesic().step(arm.at(q), target)
        assert np.all(q + step.dq <= 0.5 + 1e-12)


@pytest.mark.parametrize("name", ARMS)
@pytest.mark.parametrize("seed", range(4))
def test_the_compiled_search_ends_in_a_minimum(name: str, seed: int) -> None:
    """At the end no direction lowers the sum of squares, by differences of Pinocchio's points."""
    arm = ARMS[name]()
    rng = np.random.default_rng(seed)
    q = smooth_configuration(arm, rng, 0.6)
    reachable = arm.at(smooth_configuration(arm, rng, 0.6)).points
    points = reachable + (0.05 * arm.length * rng.normal(size=reachable.shape) @ arm.plane.T) @ arm.plane
    weights = np.where(np.arange(arm.n_modules) == 1, 0.0, rng.uniform(0.5, 2.0, arm.n_modules))
    objective = Objective(arm, pp.Target.from_points(arm, points, weights))
    position_limits = np.array([arm.limits.lower, arm.limits.upper])
    start = arm.chain_at(q)
    found = minimize(PlanningProblem(objective, start, position_limits), start, 0.0)
    chosen = np.flatnonzero(weights)

    def squares(at: np.ndarray) -> float:
        error = (points - arm.at(at).points)[chosen]
        chords = np.diff(error, axis=0)
        smaller = np.minimum(weights[chosen][1:], weights[chosen][:-1])
        return 0.5 * float(weights[chosen] @ (error**2).sum(axis=1) + smaller @ (chords**2).sum(axis=1))

    assert found.cost == pytest.approx(squares(found.state.q), rel=1e-9, abs=1e-25)
    errors = np.linalg.norm((points - found.state.points)[chosen], axis=1)
    assert found.mean_error == pytest.approx(errors.mean(), rel=1e-9, abs=1e-14)
    assert found.cost < squares(q)
    inside = np.minimum(found.state.q - position_limits[0], position_limits[1] - found.state.q) > 1e-3
    h = 1e-5
    slopes = np.array(
        [
            (squares(found.state.q + h * d) - squares(found.state.q - h * d)) / (2.0 * h)
            for d in np.eye(arm.nv)[inside]
        ]
    )
    assert np.abs(slopes).max(initial=0.0) < 2e-3 * np.sqrt(found.cost) * arm.length + 1e-14


@pytest.mark.parametrize("seed", range(3))
def test_beside_obstacles_the_way_to_a_goal_nearby_is_straight(seed: int) -> None:
    """That is the way that was found clear. Each joint on its own would leave it."""
    arm = template_arm("RyRz", 4)
    start = arm.straight()
    goal = np.random.default_rng(seed).uniform(-0.09, 0.09, arm.nv)
    ball = pp.Sphere((0.5 * arm.length, 0.0, 0.6 * arm.length), 0.1 * arm.length)
    limits = pp.Limits(step=None, velocity=1.0, acceleration=5.0, dt=0.02)
    target = pp.Target.from_configuration(arm, goal)
    run = pp.track(arm, target, start, limits=limits, scene=pp.Scene({"ball": ball}))
    assert run.converged
    shares = (run.q - start) @ goal / (goal @ goal)
    np.testing.assert_allclose(run.q - start, np.outer(shares, goal), atol=1e-12)
    free = pp.track(arm, target, start, limits=limits)
    assert run.steps == free.steps  # the joint that has farthest to go sets the pace of all
