"""What a tracker computes while its arm rests: no plans, and no search for a step that it made before."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable
from dataclasses import dataclass, field

import numpy as np
import pytest
from arms import template_arm

import pinposture as pp
from pinposture.control.planner import follow, geodesic, plan
from pinposture.control.tasks import ControlTask, Displaced, TaskRows, errors_of, rows_of
from pinposture.errors import UnknownName
from pinposture.motion import Tracker
from pinposture.placement import Target

LIMITS = pp.Limits(step=None, dt=0.01, velocity=1.0, acceleration=4.0)


@pytest.fixture(scope="module")
def arm() -> pp.Arm:
    return template_arm("RyRz", 4)


@pytest.fixture
def calls(monkeypatch: pytest.MonkeyPatch) -> Counter[str]:
    """How often the planner was asked for a goal or a path, and for a step at the end of a path."""
    made: Counter[str] = Counter()

    def counted(kind: str, function: Callable) -> Callable:
        def call(*arguments: object, **named: object) -> object:
            made[kind] += 1
            return function(*arguments, **named)

        return call

    for module, name in ((geodesic, "find_path"), (geodesic, "replan"), (plan, "find_path")):
        monkeypatch.setattr(module, name, counted("plans", getattr(module, name)))
    monkeypatch.setattr(follow, "reduce_errors", counted("steps", follow.reduce_errors))
    return made


def missed(arm: pp.Arm, by: float = 0.02) -> Target:
    """Points that the arm cannot take, by some distance [m]."""
    rng = np.random.default_rng(2)
    points = arm.at(rng.uniform(-0.4, 0.4, arm.nv)).points
    return Target.from_points(arm, points + by * rng.normal(size=points.shape))


def go(tracker: Tracker, q: np.ndarray, cycles: int, sag: np.ndarray | float, noise: float) -> np.ndarray:
    """Move an arm whose drives lag and sag, measured with noise, from q; return where it is then."""
    rng = np.random.default_rng(7)
    for _ in range(cycles):
        tracker.step(q + noise * rng.normal(size=len(q)))
        q = q + 0.2 * (tracker.command + sag - q)
    return q


TIP = pp.EndEffector(position=(0.2, 0.1, 0.1))


@pytest.mark.long
@pytest.mark.parametrize("noise", [0.0, 3e-4])
@pytest.mark.parametrize(("tasks", "by"), [((), 0.02), ((), 2e-4), ((TIP,), 0.02)])
def test_an_arm_that_cannot_take_its_target_comes_to_rest(
    arm: pp.Arm, calls: Counter[str], tasks: tuple[ControlTask, ...], by: float, noise: float
) -> None:
    tracker = Tracker(arm, pp.Geodesic(tasks=tasks), LIMITS)
    tracker.update(missed(arm, by))
    sag = 0.03 * np.random.default_rng(0).normal(size=arm.nv)
    q = go(tracker, np.zeros(arm.nv), 1000, sag, noise)
    calls.clear()
    sent = tracker.command
    q = go(tracker, q, 300, sag, noise)
    assert np.abs(tracker.command - sent).max() < 1e-5 and tracker.report.status == "stalled"
    assert calls["plans"] <= 10 and calls["steps"] <= 80
    error = tracker.report.mean_error
    sag[0] += 0.03  # by which the error would grow by 4 mm; it follows another sag all the same
    go(tracker, q, 500, sag, noise)
    assert tracker.report.mean_error == pytest.approx(error, abs=1e-3)


@pytest.mark.long
@pytest.mark.parametrize("noise", [0.0, 3e-4])
def test_an_arm_that_its_motors_cannot_hold_at_the_target_comes_to_rest(
    calls: Counter[str], noise: float
) -> None:
    arm = template_arm("RyRz", 6).with_effort(0.15)
    down = np.zeros(arm.nv)
    down[0] = 1.5
    limits = pp.Limits(step=None, dt=0.01, velocity=1.0, acceleration=4.0, effort=True)
    tracker = Tracker(arm, limits=limits)
    tracker.update(Target.from_configuration(arm, 0.1 * np.eye(arm.nv)[0]))
    sag = 0.03 * np.random.default_rng(7).normal(size=arm.nv)
    q = go(tracker, down, 1200, sag, noise)
    calls.clear()
    sent = tracker.command
    go(tracker, q, 300, sag, noise)
    assert np.abs(tracker.command - sent).max() < 1e-5 + 2.0 * noise
    assert tracker.report.status == "stalled"
    assert calls["plans"] <= 10


@pytest.mark.long
@pytest.mark.parametrize("noise", [0.0, 3e-5, 3e-4])
def test_velocities_lead_a_tip_to_its_pose_through_noise(arm: pp.Arm, noise: float) -> None:
    goal = np.random.default_rng(2).uniform(-0.4, 0.4, arm.nv)
    tip = pp.EndEffector.held(arm.at(goal), priority=True)
    tracker = Tracker(arm, pp.Geodesic(tasks=(tip,)), LIMITS, interface="velocity")
    tracker.update(Target.from_configuration(arm, goal))
    rng = np.random.default_rng(7)
    q = np.zeros(arm.nv)
    passed = []
    for _ in range(500):
        q = q + tracker.step(q + noise * rng.normal(size=arm.nv))
        passed.append(q)
    assert tracker.report.status == "converged"
    assert np.ptp(passed[400:], axis=0).max() <= noise
    np.testing.assert_allclose(q, goal, atol=noise + 1e-7)


@pytest.mark.long
@pytest.mark.parametrize("noise", [0.0, 3e-4])
@pytest.mark.parametrize("lag", [0.05, 0.1])
def test_drives_that_lag_behind_velocities_lead_a_tip_to_its_pose(
    arm: pp.Arm, lag: float, noise: float
) -> None:
    goal = np.random.default_rng(2).uniform(-0.4, 0.4, arm.nv)
    tip = pp.EndEffector.held(arm.at(goal), priority=True)
    slow = max(0.25, 4.0 * lag)
    controller = pp.Geodesic(tasks=(tip,))
    tracker = Tracker(arm, controller, LIMITS, interface="velocity", feedback_time_constant=slow)
    tracker.update(Target.from_configuration(arm, goal))
    rng = np.random.default_rng(7)
    q = np.zeros(arm.nv)
    moves = np.zeros(arm.nv)
    passed = []
    for _ in range(700):
        moves += 0.01 / lag * (tracker.step(q + noise * rng.normal(size=arm.nv)) - moves)
        q = q + moves
        passed.append(q)
    assert tracker.report.status == "converged"
    assert np.ptp(passed[600:], axis=0).max() <= 1e-4 + noise
    np.testing.assert_allclose(q, goal, atol=1e-3)


@pytest.mark.long
@pytest.mark.parametrize("noise", [0.0, 3e-4])
def test_an_arm_that_holds_its_tip_rests(arm: pp.Arm, calls: Counter[str], noise: float) -> None:
    goal = np.random.default_rng(2).uniform(-0.4, 0.4, arm.nv)
    held = pp.EndEffector.held(arm.at(goal), priority=True)
    tracker = Tracker(arm, pp.Geodesic(tasks=(held,)), LIMITS)
    tracker.update(Target.from_configuration(arm, goal + 1e-9))
    go(tracker, goal, 200, 0.0, noise)
    calls.clear()
    sent = tracker.command
    go(tracker, goal, 60, 0.0, noise)
    np.testing.assert_array_equal(tracker.command, sent)
    assert tracker.report.status == "converged"
    assert calls["plans"] == 0 and calls["steps"] <= 8


def arrival(tip: bool, delay: int, lag: float, sag: np.ndarray | float = 0.0) -> float:
    """Return when an arm arrives whose drives follow positions late, with its tip held to a pose or not [s].

    Args:
        tip: whether its tip has priority.
        delay: delay of the drives, in cycles.
        lag: time constant with which they follow then [s].
        sag: by how much they stay off, (nv,) [rad].
    """
    arm = template_arm("RyRz", 8)
    numbers = np.arange(8.0)
    start = 0.4 * np.stack([np.sin(0.5 * numbers), np.cos(0.3 * numbers)], axis=1).ravel()
    goal = 0.4 * np.stack([np.cos(0.7 * numbers), np.sin(0.4 * numbers + 1.0)], axis=1).ravel()
    tasks = (pp.EndEffector.held(arm.at(goal), priority=True),) if tip else ()
    tracker = Tracker(arm, pp.Geodesic(tasks=tasks), LIMITS)
    tracker.update(Target.from_configuration(arm, goal))
    q = start
    sent = [start] * (delay + 1)
    for cycle in range(1200):
        tracker.step(q)
        if tracker.report.status == "converged":
            np.testing.assert_allclose(q, goal, atol=1e-3)
            return 0.01 * cycle
        sent = [*sent[1:], tracker.command]
        q = q + 0.01 / (0.01 + lag) * (sent[0] + sag - q)
    return np.inf


@pytest.mark.long
@pytest.mark.parametrize(("delay", "lag"), [(0, 0.05), (3, 0.05), (8, 0.05), (8, 0.0)])
def test_a_tip_comes_to_its_pose_as_soon_as_drives_follow(delay: int, lag: float) -> None:
    at_once = arrival(True, 0, 0.0)
    assert arrival(True, delay, lag) <= at_once + 0.01 * delay + 4.0 * lag + 0.5


@pytest.mark.long
@pytest.mark.parametrize(("delay", "share"), [(3, 1.0), (0, 0.5)])
def test_a_tip_comes_to_its_pose_although_drives_lag_and_sag(delay: int, share: float) -> None:
    sag = share * 0.03 * np.random.default_rng(0).normal(size=16)
    assert arrival(True, delay, 0.05, sag) <= 6.5


@dataclass(eq=False)
class Pointer:
    """Moves the tip to a place that can be changed, as a task of a user."""

    place: np.ndarray = field(default_factory=lambda: np.array([0.3, 0.0, 0.0]))
    weight: float = 1.0
    priority: bool = False

    def rows(self, state: pp.ArmState, target: Target) -> TaskRows:
        return TaskRows(state.jacobians[-1], self.place - state.points[-1])


def test_an_arm_that_rests_goes_on_when_anything_changes(arm: pp.Arm) -> None:
    task = Pointer()
    ball = pp.Scene({"ball": pp.Sphere((0.0, 0.0, -9.0), 0.05)}, margin=0.01, arm_radius=0.01)
    controller = pp.Geodesic(tasks=(task,), scene=ball)
    target = Target.from_configuration(arm, np.full(arm.nv, 0.2))
    state = arm.at(np.full(arm.nv, 0.1))
    memory = None

    def moves(**changed: object) -> bool:
        nonlocal state, memory
        options = {"limits": LIMITS, "target": target, "controller": controller, **changed}
        step = options["controller"].step(state, options["target"], options["limits"], memory)
        state = state.moved(step.dq)
        memory = step.memory
        return bool(np.any(step.dq))

    def rest(**changed: object) -> None:
        assert moves(**changed)
        for _ in range(300):
            if not (moves(**changed) or moves(**changed)):
                break
        assert not moves(**changed)

    rest()
    task.place = task.place + 0.01
    rest()
    rest(target=Target.from_configuration(arm, np.full(arm.nv, 0.21)))
    rest()
    rest(limits=pp.Limits(step=None, dt=0.01, velocity=1.0, acceleration=4.0, position_margin=3.0))
    near = pp.Sphere(state.points[-1] + [0.0, 0.0, 0.065], 0.05)
    rest(controller=controller.with_scene(pp.Scene({"ball": near}, margin=0.01, arm_radius=0.01)))


@pytest.mark.parametrize("template", ["RyRz", "Rz"])
def test_errors_of_tasks_are_those_of_their_rows(template: str) -> None:
    arm = template_arm(template, 4)
    rng = np.random.default_rng(0)
    state, wanted = (arm.at(rng.uniform(-1.0, 1.0, arm.nv)).chain_state for _ in range(2))
    target = Target.from_configuration(arm, wanted.q)

    class Turned(pp.EndEffector):
        def rows(self, state: pp.ArmState, target: Target) -> TaskRows:
            return TaskRows(state.jacobians[-1], 2.0 * state.points[-1])

    tasks: list[ControlTask] = [
        pp.EndEffector.held(wanted, "position"),
        pp.EndEffector.held(wanted, length=0.3),
        pp.EndEffector.held(wanted, point=1, direction_only=True),
        pp.JointPosture(wanted.q),
        pp.Tangents(rng.normal(size=3), points=2),
        Pointer(),
        Turned.held(wanted),
    ]
    tasks += [Displaced(task, rng.normal(0.0, 0.1, arm.nv)) for task in tasks]
    for task in tasks:
        np.testing.assert_array_equal(errors_of(task, state, target), rows_of(task, state, target).error)


def test_a_single_joint_may_be_limp(arm: pp.Arm) -> None:
    tracker = Tracker(arm, limits=LIMITS)
    tracker.restart(np.zeros(arm.nv), limp=arm.joint_names[2])
    tracker.update(Target.from_configuration(arm, np.zeros(arm.nv)))
    tracker.step(0.09 * np.eye(arm.nv)[2])
    assert tracker.report.tracking_error == 0.0
    with pytest.raises(UnknownName, match="'m9'"):
        tracker.restart(np.zeros(arm.nv), limp="m9")
