"""The three stages, each by itself and in a row: plan, retime, follow."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from arms import template_arm
from sampling import seeds

import pinposture as pp
from pinposture.arm import smooth_configuration
from pinposture.collision import CollisionModel

FREE = pp.Limits(step=0.05)
TIMED = pp.Limits(step=None, velocity=1.0, dt=0.02, acceleration=4.0)


def arm() -> pp.Arm:
    return template_arm("RyRz", 8)


def start_and_goal(seed: int) -> tuple[np.ndarray, pp.Target]:
    rng = np.random.default_rng(seed)
    one, two = (smooth_configuration(arm(), rng, 1.0) for _ in range(2))
    return one, pp.Target.from_configuration(arm(), two)


def around_a_ball(seed: int) -> tuple[np.ndarray, pp.Target, pp.Scene]:
    """A start and a goal clear of a ball that the tip runs into on the most direct path."""
    for number in range(1000):
        q, target = start_and_goal(1000 * seed + number)
        direct = pp.plan(arm().at(q), target)
        middle = arm().at(direct.configuration(0.5 * direct.end)).points[-1]
        scene = pp.Scene({"ball": pp.Sphere(tuple(middle), 0.03)}, self_collision=False)
        distances = CollisionModel(arm(), scene)
        if min(distances.minimum(each).distance for each in (q, target.q)) > 0.02:
            return q, target, scene
    raise AssertionError("no such scene was drawn")


def followed(path: pp.TimedPath, q: np.ndarray, most: int = 2000) -> tuple[np.ndarray, list[pp.Step]]:
    """Configurations and steps until the path has ended."""
    configurations = [q]
    steps = []
    memory = None
    for _ in range(most):
        step = pp.follow(path, path.path.arm.at(q), memory=memory)
        memory = step.memory
        q = path.path.arm.integrate(q, step.dq)
        if memory.progress.arrived:
            return np.array(configurations), steps
        configurations.append(q)
        steps.append(step)
    raise AssertionError("the path does not end")


@pytest.mark.parametrize("limits", [FREE, TIMED], ids=["steps", "accelerations"])
@pytest.mark.parametrize("among", [False, True], ids=["free", "obstacle"])
@pytest.mark.parametrize("seed", seeds(3))
def test_the_stages_in_a_row_make_the_run_that_track_makes(seed: int, among: bool, limits: pp.Limits) -> None:
    q, target, scene = around_a_ball(seed) if among else (*start_and_goal(seed), None)
    path = pp.retime(pp.plan(arm().at(q), target, scene, limits), limits)
    alone, _ = followed(path, q)
    run = pp.track(arm(), target, q, limits=limits, scene=scene, max_steps=2000)
    count = min(len(alone), len(run.q))
    np.testing.assert_allclose(alone[:count], run.q[:count], atol=1e-12)
    assert run.converged and abs(len(alone) - len(run.q)) <= 2


@pytest.mark.parametrize("seed", seeds(5))
def test_a_plan_leads_from_here_to_the_target_within_limits(seed: int) -> None:
    q, target = start_and_goal(seed)
    path = pp.plan(arm().at(q), target)
    assert path.configurations.shape == (path.end + 1, arm().nq) and path.blocked_by == ""
    np.testing.assert_array_equal(path.configurations[0], q)
    np.testing.assert_allclose(arm().at(path.configurations[-1]).points, target.points, atol=1e-12)
    assert all(arm().within_limits(each) for each in path.configurations)
    # Control points travel hardly farther than straight lines, where joint interpolation sweeps wide.
    points = np.array([arm().at(each).points for each in path.configurations])
    travelled = np.linalg.norm(np.diff(points, axis=0), axis=2).sum()
    assert travelled <= 1.1 * np.linalg.norm(points[-1] - points[0], axis=1).sum()


@pytest.mark.parametrize("seed", seeds(3))
def test_a_plan_in_a_scene_is_clear_by_sampling(seed: int) -> None:
    q, target, scene = around_a_ball(seed)
    distances = CollisionModel(arm(), scene)
    path = pp.plan(arm().at(q), target, scene)
    nearest = [distances.minimum(path.configuration(place)).distance for place in np.arange(0, path.end, 0.1)]
    ends = [distances.minimum(each).distance for each in path.configurations[[0, -1]]]
    assert path.blocked_by == "" and min(nearest) >= min(*ends, scene.margin) - 1e-3
    direct = pp.plan(arm().at(q), target).configurations
    assert min(distances.minimum(each).distance for each in direct) < 0.0


@pytest.mark.parametrize("seed", seeds(5))
def test_a_timed_path_keeps_speed_and_acceleration_from_rest_to_rest(seed: int) -> None:
    q, target = start_and_goal(seed)
    path = pp.retime(pp.plan(arm().at(q), target), TIMED)
    speeds = np.diff(path.configurations, axis=0) / TIMED.dt
    assert path.duration == pytest.approx(len(speeds) * TIMED.dt)
    assert np.abs(speeds).max() <= 1.0 + 1e-9
    rest = np.zeros((1, arm().nv))
    changes = np.diff(np.concatenate([rest, speeds, rest]), axis=0) / TIMED.dt
    assert np.abs(changes).max() <= 4.0 * (1.0 + 1e-9)
    followed_q, steps = followed(path, q)
    assert len(steps) == pytest.approx(len(speeds), abs=3)
    taken = np.diff(followed_q, axis=0) / TIMED.dt
    changes = np.diff(np.concatenate([rest, taken, rest]), axis=0) / TIMED.dt
    assert np.abs(changes).max() <= 4.0 * (1.0 + 1e-9)


@pytest.mark.parametrize("seed", seeds(3))
def test_without_acceleration_limits_the_slowest_joint_sets_the_time(seed: int) -> None:
    q, target = start_and_goal(seed)
    plan = pp.plan(arm().at(q), target)
    path = pp.retime(plan, FREE)
    assert path.profile is None and path.s[0] == 0.0 and path.s[-1] == plan.end
    slowest = np.abs(np.diff(plan.offsets, axis=0)).max(axis=1).sum() / 0.05
    assert path.duration == np.ceil(slowest)
    _, steps = followed(path, q)
    assert len(steps) <= path.duration


def test_an_arm_that_was_pushed_comes_back_to_its_path() -> None:
    q, target = start_and_goal(1)
    path = pp.retime(pp.plan(arm().at(q), target), TIMED)
    memory = None
    for number in range(80):
        step = pp.follow(path, arm().at(q), memory=memory)
        memory = step.memory
        q = arm().integrate(q, step.dq)
        if number == 20:
            q = arm().integrate(q, np.full(arm().nv, 0.02))
    place = memory.progress.s
    off = np.abs(q - (path.path.start + path.path.smooth_offset(place))).max()
    assert 0.0 < place < path.path.end and off < 1e-9


def test_an_arm_stays_on_a_clear_path_though_a_straight_stop_would_leave_it() -> None:
    short = template_arm("RyRz", 4)
    q = short.neutral()
    turn = np.linspace(0.0, 0.5 * np.pi, 33)
    offsets = np.zeros((len(turn), short.nv))
    offsets[:, 0] = 0.6 * np.sin(turn)
    offsets[:, 1] = 0.6 * (1.0 - np.cos(turn))
    target = pp.Target.from_configuration(short, short.integrate(q, offsets[-1]))
    curve = pp.JointPath(pp.Geodesic().objective(short, target), q, offsets)
    straight_on = offsets[16] + 0.3 * (offsets[16] - offsets[15]) / np.linalg.norm(offsets[16] - offsets[15])
    beside = tuple(short.at(short.integrate(q, straight_on)).points[-1])
    margin = 0.001
    point = CollisionModel(short, pp.Scene({"ball": pp.Sphere(beside, 1e-6)}, self_collision=False))
    on_curve = short.integrate(q, curve.smooth_offset(np.linspace(0.0, 32.0, 1000)))
    radius = min(point.minimum(each).distance for each in on_curve) - margin - 0.0002
    scene = pp.Scene({"ball": pp.Sphere(beside, radius)}, self_collision=False, margin=margin)
    timed = pp.retime(replace(curve, scene=scene), TIMED)
    configurations, steps = followed(timed, q)
    assert len(steps) <= len(timed.s)
    assert all(not step.near and not step.violated_constraints for step in steps)
    assert np.abs(configurations - timed.configurations[: len(configurations)]).max() < 1e-9
    # Nor does it leave it where it stops.
    for number in (10, 25, 40):
        memory = steps[number].memory
        q = configurations[number + 1]
        for _ in range(100):
            memory = memory.braked(TIMED, short.at(q))
            q = short.integrate(q, memory.dq)
            assert CollisionModel(short, scene).minimum(q).distance >= margin
        assert not memory.dq.any()


def test_limits_that_become_smaller_on_the_way_hold_at_once() -> None:
    q, target = start_and_goal(1)
    path = pp.retime(pp.plan(arm().at(q), target), FREE)
    step = pp.follow(path, arm().at(q))
    assert np.abs(step.dq).max() > 0.04
    for most in (0.02, 0.005, 0.03):
        q = arm().integrate(q, step.dq)
        step = pp.follow(path, arm().at(q), pp.Limits(step=most), step.memory)
        assert 0.9 * most < np.abs(step.dq).max() <= most * (1.0 + 1e-9)


def test_another_path_begins_at_its_start() -> None:
    q, target = start_and_goal(2)
    first = pp.retime(pp.plan(arm().at(q), target), FREE)
    step = pp.follow(first, arm().at(q))
    q = arm().integrate(q, step.dq)
    second = pp.retime(pp.plan(arm().at(q), start_and_goal(3)[1]), FREE)
    again = pp.follow(second, arm().at(q), memory=step.memory)
    assert again.memory.progress.timed is second
    np.testing.assert_array_equal(again.dq, pp.follow(second, arm().at(q)).dq)


def test_what_does_not_fit_is_refused_by_name() -> None:
    q, target = start_and_goal(0)
    state = arm().at(q)
    path = pp.plan(state, target)
    refused = [
        (lambda: pp.plan(q, target), "state"),
        (lambda: pp.plan(state, target.points), "target"),
        (lambda: pp.plan(state, target, {}), "scene"),
        (lambda: pp.plan(state, target, joint_weight=-1.0), "joint_weight"),
        (lambda: pp.plan(state, target, tasks=(pp.EndEffector,)), "tasks"),
        (lambda: pp.plan(template_arm("RyRz", 5).at(np.zeros(10)), target), "target.points"),
        (lambda: pp.retime(path.offsets), "path"),
        (lambda: pp.retime(path, 0.1), "limits"),
        (lambda: pp.retime(path, max_rate=0.0), "max_rate"),
        (lambda: pp.retime(path, max_rate=np.ones(len(path.offsets))), "max_rate"),
        (lambda: pp.retime(path, max_rate=np.full(len(path.offsets) - 1, np.inf)), "max_rate"),
        (lambda: pp.follow(path, state), "path"),
        (lambda: pp.follow(pp.retime(path), q), "state"),
        (lambda: pp.follow(pp.retime(path), template_arm("RyRz", 5).at(np.zeros(10))), "state"),
        (lambda: pp.follow(pp.retime(path), state, memory=1), "memory"),
    ]
    for call, name in refused:
        with pytest.raises(pp.PostureError, match=name):
            call()
