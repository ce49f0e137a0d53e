"""Runs that cannot end at their target say what holds them, and do what they can."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pinocchio as pin
import pytest
from arms import template_arm
from planner_runs import arm_called, check_limits
from scipy.optimize import least_squares, minimize

import pinposture as pp
from pinposture.arm import smooth_configuration
from pinposture.collision import CollisionModel, Scene, Sphere
from pinposture.control.planner.follow import FOLLOWING, PathProgress
from pinposture.control.tasks import EndEffector


def span(m: int) -> np.ndarray:
    """What makes errors of points and of chords out of those of points, (2 m - 1, m)."""
    return np.vstack([np.eye(m), np.diff(np.eye(m), axis=0)])


def test_a_joint_at_its_limit_is_named_and_no_other() -> None:
    arm = pp.Arm.from_modules([pp.template("Rz").with_limits(-0.5, 0.5)] * 4)
    free = pp.Arm.from_template("Rz", 4)
    wanted = free.at(np.array([0.2, 1.2, -0.1, 0.1]))
    run = pp.track(arm, pp.Target.from_points(arm, wanted.points), arm.straight())
    assert run.status == "stalled"
    assert "m02_j1_z at its limit" in run.reason
    held = {name for name in arm.joint_names if f"{name} at its limit" in run.reason}
    at = {name for name, angle in zip(arm.joint_names, run.q[-1], strict=True) if abs(angle) > 0.5 - 1e-9}
    assert held == at
    assert len(held) < 4


def wave(phases: tuple[float, float], rates: tuple[float, float]) -> np.ndarray:
    """Joints of eight modules RyRz that bend in two waves, (16,) [rad]."""
    numbers = np.arange(8.0)
    joints = [0.4 * np.sin(rate * numbers + phase) for phase, rate in zip(phases, rates, strict=True)]
    return np.stack(joints, axis=1).ravel()


@pytest.mark.long
@pytest.mark.parametrize("scene", [None, Scene()])
@pytest.mark.parametrize(
    ("start", "goal"),
    [
        (wave((1.9, 1.1), (0.5, 0.6)), wave((4.0, 1.2), (0.8, 0.2))),
        (wave((2.7, 4.8), (0.4, 0.3)), wave((1.4, 0.3), (0.3, 0.5))),
        (wave((3.8, 5.4), (0.3, 0.2)), wave((1.0, 0.9), (0.5, 0.3))),
    ],
)
def test_a_tip_that_the_body_turns_the_longer_way_round_arrives_as_without_its_task(
    start: np.ndarray, goal: np.ndarray, scene: Scene | None
) -> None:
    arm = template_arm("RyRz", 8)
    target = pp.Target.from_configuration(arm, goal)
    tip = EndEffector.held(arm.at(goal), priority=True)
    limits = pp.Limits(velocity=1.0, acceleration=4.0, dt=0.01)
    with_tip, without = (
        pp.track(arm, target, start, pp.Geodesic(tasks=tasks), limits, scene=scene) for tasks in ((tip,), ())
    )
    assert with_tip.status == "converged"
    np.testing.assert_allclose(with_tip.q[-1], goal, atol=1e-5)
    assert with_tip.steps <= 1.1 * without.steps


def test_a_tip_that_is_held_stays_where_the_body_turns_round() -> None:
    arm = template_arm("RyRz", 8)
    start = wave((2.7, 4.8), (0.4, 0.3))
    tip = EndEffector.held(arm.at(start), priority=True)
    target = pp.Target.from_configuration(arm, wave((1.4, 0.3), (0.3, 0.5)))
    path = pp.plan(arm.at(start), target, tasks=(tip,))
    assert path.task_errors is not None


def test_joints_that_only_accelerate_are_not_said_to_be_at_their_limits() -> None:
    arm = pp.Arm.from_template("Rz", 4)
    limits = pp.Limits(step=None, dt=0.1, velocity=1.0, acceleration=0.5)
    run = pp.track(arm, pp.Target.from_configuration(arm, np.full(4, 0.8)), arm.straight(), limits=limits)
    assert np.abs(run.q).max() < 2.0  # far from pi
    assert not run.clipped.any()


def test_points_out_of_reach_end_at_the_best_posture_with_a_reason() -> None:
    for name in ("planar", "spatial"):
        arm = arm_called(name)
        points = 1.5 * arm.at(arm.configuration(np.full(arm.nv, 0.1))).points
        target = pp.Target.from_points(arm, points)
        run = pp.track(arm, target, arm.straight(), "geodesic", max_steps=1000)
        assert run.status == "stalled"
        assert "no step" in run.reason or "no progress" in run.reason
        check_limits(arm, pp.Limits(), run.q)
        # Chords count as well as points: at the end no joint can improve their sum of squares.
        both = span(arm.n_modules)
        best = least_squares(
            lambda q, arm=arm, both=both, points=points: (both @ (points - arm.at(q).points)).ravel(),
            run.q[-1],
            bounds=(arm.limits.lower, arm.limits.upper),
        )
        left = both @ (points - run.points[-1])
        assert 0.5 * float((left**2).sum()) <= 1.001 * best.cost


def test_an_obstacle_on_the_target_stops_it_short_and_is_named() -> None:
    arm = pp.Arm.from_template("Rz", 6)
    target = pp.Target.from_points(arm, arm.at(np.full(6, 0.15)).points)
    ball = Sphere(tuple(target.points[-1]), 0.05)
    scene = Scene({"ball": ball}, self_collision=False, margin=0.004, arm_radius=0.01)
    run = pp.track(arm, target, np.full(6, -0.3), scene=scene)
    assert run.status == "stalled"
    assert "ball" in run.reason
    assert run.clearance.min() >= 0.004 - 1e-9
    between = CollisionModel(arm, scene)
    for q, dq in zip(run.q[:-1], np.diff(run.q, axis=0), strict=True):
        shares = np.arange(1, 11)[:, None] / 10
        assert between.minimum_along(q, shares * dq).distance >= 0.004 - 1e-9


def test_a_target_posture_inside_an_obstacle_is_said_to_be() -> None:
    arm = pp.Arm.from_template("RyRz", 6)
    goal = np.full(arm.nv, 0.15)
    scene = Scene(
        {"post": Sphere(tuple(arm.at(goal).points[4]), 0.02)},
        self_collision=False,
        margin=0.01,
        arm_radius=0.005,
    )
    run = pp.track(arm, pp.Target.from_configuration(arm, goal), arm.straight(), scene=scene, max_steps=600)
    assert run.status == "stalled"
    assert run.reason.startswith("the target posture is in collision: ")
    for part in (" to post: overlapping by ", "the margin is 10 mm); no step "):
        assert part in run.reason


def test_an_obstacle_beside_the_target_does_not() -> None:
    arm = pp.Arm.from_template("Rz", 6)
    start = np.full(6, -0.3)
    goal = np.full(6, 0.15)
    ends = np.concatenate([arm.at(start).points, arm.at(goal).points])
    place = np.array([0.5 * arm.length, 0.75 * arm.length, 0.0])
    assert np.linalg.norm(ends - place, axis=1).min() > 0.05
    scene = Scene({"ball": Sphere(tuple(place), 0.02)}, self_collision=False, margin=0.004, arm_radius=0.01)
    assert pp.track(arm, pp.Target.from_configuration(arm, goal), start, scene=scene).converged


def test_a_strict_end_effector_gets_what_it_would_get_alone() -> None:
    """Out of reach: the tip ends as near as with nothing else to do, whatever the points ask for."""
    arm = arm_called("short")
    place = np.array([1.3 * arm.length, 0.4 * arm.length, 0.0])
    posture = pp.Target.from_points(arm, arm.at(np.array([-1.0, 0.8, 0.9])).points)
    tip = pp.Target.from_points(arm, np.tile(place, (3, 1)), np.array([0.0, 0.0, 1.0]))
    alone = pp.track(arm, tip, np.array([0.3, -0.2, 0.4]), max_steps=1000)
    both = pp.Geodesic(tasks=(EndEffector(position=place, priority=True),))
    run = pp.track(arm, posture, np.array([0.3, -0.2, 0.4]), both, max_steps=1000)
    check_limits(arm, pp.Limits(), run.q)
    errors = [np.linalg.norm(each.points[-1][-1] - place) for each in (alone, run)]
    nearest = np.linalg.norm(place) - arm.length
    assert errors[0] == pytest.approx(nearest, rel=1e-3)
    assert errors[1] <= 1.001 * nearest


@pytest.mark.long
def test_a_strict_end_effector_in_reach_is_met_while_the_points_do_what_is_left() -> None:
    arm = arm_called("planar")
    start = np.full(7, 0.2)
    held = EndEffector.held(arm.at(start), "position", priority=True)
    posture = pp.Target.from_points(arm, arm.at(np.full(7, -0.1)).points)
    run = pp.track(arm, posture, start, pp.Geodesic(tasks=(held,)), max_steps=300)
    tip = np.linalg.norm(run.points[:, -1] - run.points[0, -1], axis=1)
    assert tip[-1] < 1e-4 * arm.length
    assert tip.max() < 0.01 * arm.length
    both = span(7)

    def left(q: np.ndarray) -> float:
        return float(((both @ (posture.points - arm.at(q).points)) ** 2).sum())

    there = {"type": "eq", "fun": lambda q: (arm.at(q).points[-1] - run.points[0, -1])[:2]}
    best = minimize(left, start, constraints=[there], method="SLSQP", options={"maxiter": 500})
    assert best.success
    assert best.fun < 0.999 * left(start)
    assert left(run.q[-1]) <= 1.0001 * best.fun


@pytest.mark.long
@pytest.mark.parametrize("scene", [None, Scene()])
@pytest.mark.parametrize("seed", range(3))
def test_a_task_with_priority_is_reached_from_a_straight_arm(seed: int, scene: Scene | None) -> None:
    arm = pp.Arm.from_template("RyRz", 6)
    goal = np.random.default_rng(seed).uniform(-0.3, 0.3, arm.nv)
    data = arm.model.createData()
    pin.framesForwardKinematics(arm.model, data, goal)
    pose = data.oMf[arm.model.getFrameId(arm.control_points[-1])].copy()
    target = pp.Target.from_configuration(arm, goal)
    limits = pp.Limits(step=None, dt=0.01, velocity=1.0, acceleration=4.0)
    steps = []
    for priority in (False, True):
        controller = pp.Geodesic(tasks=(pp.EndEffector(pose=pose, priority=priority),))
        run = pp.track(arm, target, arm.straight(), controller, limits, scene)
        assert run.converged, run.reason
        pin.framesForwardKinematics(arm.model, data, run.q[-1])
        reached = data.oMf[arm.model.getFrameId(arm.control_points[-1])]
        assert np.linalg.norm(pin.log6(pose.actInv(reached)).vector) < 1e-4
        steps.append(run.steps)
    assert steps[1] <= 3 * steps[0]  # one that waits for what tasks keep it from takes five times as many


@pytest.mark.long
@pytest.mark.parametrize("scene", [None, Scene()])
@pytest.mark.parametrize("seed", [2, 3])
def test_a_path_bends_to_a_task_with_priority_that_moves(seed: int, scene: Scene | None) -> None:
    arm = pp.Arm.from_template("RyRz", 4)
    rng = np.random.default_rng(seed)
    goal = rng.uniform(-0.4, 0.4, arm.nv)
    target = pp.Target.from_configuration(arm, goal)
    limits = pp.Limits(step=None, dt=0.01, velocity=1.0, acceleration=10.0)
    data = arm.model.createData()
    frame = arm.model.getFrameId(arm.control_points[-1])

    def tip(q: np.ndarray) -> np.ndarray:
        pin.framesForwardKinematics(arm.model, data, q)
        return data.oMf[frame].translation.copy()

    away = 0.005 * arm.length * rng.normal(size=3)
    state = arm.at(0.5 * goal + 0.1)
    memory = None
    for number in range(200):  # an arm that stays on the path to where the task was takes up to 300
        place = tip(goal) + away * min(number // 10, 2)
        controller = pp.Geodesic(tasks=(EndEffector(position=place, priority=True),), scene=scene)
        step = controller.step(state, target, limits, memory)
        memory = step.memory
        state = state.moved(step.dq)
    assert np.linalg.norm(tip(state.q) - place) < 1e-6 * arm.length


def test_free_steps_do_not_make_up_for_steps_that_are_held_back() -> None:
    """An arm that swings to and fro takes such steps, too; only a share of the path is progress."""
    arm = arm_called("planar")
    path = pp.plan(arm.at(arm.straight()), pp.Target.from_configuration(arm, np.full(arm.nv, 0.2)))
    progress = PathProgress.begin(path, pp.Limits(step=0.05), None)
    share = FOLLOWING.progress_share * path.end
    progress = progress.moved_to(0.4 * share, travel=0.05, held_back=True)
    progress = progress.moved_to(0.8 * share, travel=0.05, held_back=False)
    assert progress.idle_travel == 0.05
    progress = progress.moved_to(0.8 * share, travel=0.05, held_back=True)
    assert progress.idle_travel == 0.1
    progress = progress.moved_to(1.1 * share, travel=0.05, held_back=False)
    assert progress.idle_travel == 0.0


@pytest.mark.long
def test_beside_obstacles_an_arm_off_its_path_does_not_stand_before_it_plans_anew() -> None:
    """It moves when the target jumps, so that it leaves its path where balls leave it half a millimetre."""
    arm = template_arm("RyRz", 8)
    rng = np.random.default_rng(3)
    goal = smooth_configuration(arm, rng, 0.6)
    points = arm.at(goal).points
    radius = 0.08 * arm.length
    balls = {}
    for name in "abcd":
        point = points[rng.integers(3, 8)]
        away = rng.normal(size=3)
        balls[name] = Sphere(point + (radius + 0.04 * arm.length) * away / np.linalg.norm(away), radius)
    scene = Scene(balls, margin=0.01 * arm.length, self_collision=False)
    room = CollisionModel(arm, scene).minimum(goal).distance - 0.0105 * arm.length
    balls = {name: Sphere(ball.center, ball.radius + room) for name, ball in balls.items()}
    limits = pp.Limits(step=None, velocity=1.0, acceleration=5.0, dt=0.02)
    tracker = pp.Tracker(arm, limits=limits, scene=replace(scene, obstacles=balls))
    tracker.update(pp.Target.from_configuration(arm, smooth_configuration(arm, rng, 0.6)))
    q = arm.straight()
    slow = 0
    for cycle in range(400):
        if cycle == 25:
            tracker.update(pp.Target.from_configuration(arm, goal))
        dq = tracker.step(q)
        q = tracker.command
        slow += cycle > 30 and bool(np.abs(dq).max() < 1e-3)
        if tracker.report.status == "converged":
            break
    assert tracker.report.status == "converged"
    assert slow < 0.3 / limits.dt
