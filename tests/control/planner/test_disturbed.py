"""An arm that is not where it should be, or cannot go where it should, finds another way or says why."""

from __future__ import annotations

import numpy as np
import pytest
from arms import template_arm

import pinposture as pp
from pinposture.control import Memory
from pinposture.errors import InvalidValue, PostureWarning


@pytest.fixture(scope="session")
def planar() -> pp.Arm:
    return template_arm("Rz", 10)


def goes_on(controllers, state, target, memory=None, limits=None):
    """The state after a step by each of the controllers, each given the memory of the one before."""
    for controller in controllers:
        step = controller.step(state, target, limits, memory)
        if step.reason:
            break
        memory = step.memory
        state = state.arm.at(state.arm.integrate(state.q, step.dq))
    return state, memory


def error(state, target):
    return float(np.linalg.norm(state.points - target.points, axis=1).mean()) / state.arm.length


@pytest.mark.parametrize("seed", range(4))
def test_an_arm_that_was_pushed_away_after_it_arrived_comes_back(planar: pp.Arm, seed: int) -> None:
    rng = np.random.default_rng(seed)
    goal = rng.uniform(-1, 1, 10)
    geodesic = pp.Geodesic()
    target = pp.Target.from_configuration(planar, goal)
    _, memory = goes_on([geodesic], planar.at(goal), target)
    pushed = planar.at(np.clip(goal + 2.0 * rng.uniform(-1, 1, 10), -3, 3))
    state, _ = goes_on([geodesic] * 150, pushed, target, memory)
    assert error(state, target) < 1e-6


def test_a_task_that_is_replaced_on_the_way_does_not_lose_the_way(planar: pp.Arm) -> None:
    start, goal = np.random.default_rng(1).uniform(-2, 2, (2, 10))
    target = pp.Target.from_configuration(planar, goal)
    tasks = [pp.JointPosture(q=goal, weight=weight) for weight in (1e-3, 2e-3)]
    first, later = (pp.Geodesic(tasks=(task,)) for task in tasks)
    state, _ = goes_on([first] * 3 + [later] * 200, planar.at(start), target)
    assert error(state, target) < 1e-6


@pytest.mark.parametrize("position", [6.0, 9.0])
def test_a_start_far_outside_the_limits_comes_back_and_then_arrives(planar: pp.Arm, position: float) -> None:
    target = pp.Target.from_configuration(planar, np.full(10, 0.1))
    start = np.zeros(10)
    start[3] = position
    with pytest.warns(PostureWarning, match="a joint outside the limits"):
        run = pp.track(planar, target, start, max_steps=600)
    assert run.converged
    outside = np.abs(run.q[:, 3]) > np.pi
    steps = np.diff(run.q[:, 3])
    np.testing.assert_allclose(steps[outside[1:]], -0.1, atol=1e-12)  # as fast as it may
    assert not np.any(np.diff(outside.astype(int)) > 0)  # and never out again
    assert all(text.startswith("position limit: joint") for text in run.violated_constraints[outside[:-1]])


def test_a_blocked_goal_is_a_stall_with_a_limit_of_acceleration_too() -> None:
    arm = pp.Arm.from_template("Rz", 4)
    start, goal = np.random.default_rng(0).uniform(-1, 1, (2, 4))
    scene = pp.Scene({"ball": pp.Sphere(arm.at(goal).points[-1], 0.04)}, self_collision=False, margin=0.002)
    limits = pp.Limits(dt=0.1, acceleration=2.0)
    run = pp.track(
        arm, pp.Target.from_configuration(arm, goal), start, "geodesic", limits, scene, max_steps=400
    )
    assert run.status == "stalled"
    assert "to ball" in run.reason
    assert run.clearance.min() >= scene.margin - 1e-9


def test_what_is_no_state_no_target_and_no_memory_is_refused_by_name(planar: pp.Arm) -> None:
    state = planar.at(planar.neutral())
    geodesic = pp.Geodesic()
    target = pp.Target.from_configuration(planar, planar.neutral())
    with pytest.raises(InvalidValue, match=r"state is .* an ArmState"):
        geodesic.step(planar.neutral(), target)
    with pytest.raises(InvalidValue, match=r"memory is .*step.memory"):
        geodesic.step(state, target, memory=geodesic.step(state, target))
    with pytest.raises(InvalidValue, match=r"target is .* a Target"):
        geodesic.step(state, target.points)
    with pytest.raises(InvalidValue, match=r"target.points\[0, 0\]"):
        geodesic.step(state, pp.Target(np.full((10, 3), np.nan), np.ones(10)))
    assert isinstance(geodesic.step(state, target).memory, Memory)
