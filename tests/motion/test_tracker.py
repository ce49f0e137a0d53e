"""The streaming controller where all goes well: where it leads, what it reports, what it refuses."""

from __future__ import annotations

import gc
import sys

import numpy as np
import pytest
from arms import template_arm

import pinposture as pp
from pinposture.arm import smooth_configuration
from pinposture.control.planner import geodesic, plan
from pinposture.control.planner.damped_least_squares import PlanningProblem
from pinposture.control.planner.path import JointPath
from pinposture.control.planner.plan import find_path
from pinposture.errors import InvalidValue, PostureError, UnknownName
from pinposture.motion import Tracker
from pinposture.placement import Target

LIMITS = pp.Limits(step=None, velocity=2.0, dt=0.02, acceleration=10.0)


@pytest.fixture(scope="session")
def arm() -> pp.Arm:
    return template_arm("RyRz", 6)


def run(tracker: Tracker, q: np.ndarray, steps: int) -> tuple[np.ndarray, np.ndarray]:
    """Configurations and steps of an arm that does as it is told."""
    path = [q]
    moved = []
    for _ in range(steps):
        dq = tracker.step(path[-1])
        moved.append(dq)
        path.append(tracker.arm.integrate(path[-1], dq))
    return np.array(path), np.array(moved)


@pytest.mark.parametrize("controller", ["geodesic", "joint", "lm", "switching"])
@pytest.mark.parametrize("interface", ["position", "velocity"])
def test_the_arm_comes_to_its_target_and_rests(arm: pp.Arm, controller: str, interface: str) -> None:
    rng = np.random.default_rng(1)
    start, goal = (smooth_configuration(arm, rng, 0.6) for _ in range(2))
    tracker = Tracker(arm, controller, LIMITS, interface=interface)
    tracker.update(Target.from_configuration(arm, goal))
    path, moved = run(tracker, start, 400)
    assert np.linalg.norm(arm.at(path[-1]).points - arm.at(goal).points, axis=1).mean() < 1e-6 * arm.length
    assert tracker.report.status == "converged" and tracker.report.reason == ""
    assert tracker.report.mean_error < 1e-6 * arm.length and tracker.report.target_age == pytest.approx(8.0)
    np.testing.assert_allclose(tracker.command, path[-1], atol=1e-12)
    rest = np.zeros((1, arm.nv))
    assert np.abs(np.diff(np.concatenate([rest, moved, rest]), axis=0)).max() <= 10.0 * 0.02**2 + 1e-9
    assert np.abs(moved).max() <= 2.0 * 0.02 + 1e-9
    assert np.abs(moved[-1]).max() < 1e-12


def test_it_goes_the_way_that_a_run_goes(arm: pp.Arm) -> None:
    rng = np.random.default_rng(2)
    start, goal = (smooth_configuration(arm, rng, 0.8) for _ in range(2))
    target = Target.from_configuration(arm, goal)
    motion = pp.track(arm, target, start, limits=LIMITS)
    tracker = Tracker(arm, "geodesic", LIMITS)
    tracker.update(target)
    path, _ = run(tracker, start, motion.steps)
    np.testing.assert_allclose(path, motion.q, atol=1e-9)


def test_before_anything_is_known(arm: pp.Arm) -> None:
    tracker = Tracker(arm, "geodesic", LIMITS)
    assert tracker.report.status == "holding" and tracker.report.reason and tracker.target is None
    with pytest.raises(InvalidValue, match="command"):
        _ = tracker.command
    with pytest.raises(InvalidValue, match="positions"):
        _ = tracker.positions
    assert not np.any(tracker.step(None)) and tracker.report.reason == "no measurement"
    tracker.update(Target.from_configuration(arm, np.full(arm.nv, 0.1)))
    assert not np.any(tracker.step(None)) and tracker.report.mean_error is None
    with pytest.raises(InvalidValue, match="command"):
        _ = tracker.command
    assert np.any(tracker.step(arm.neutral())) and tracker.report.status == "moving"


def test_a_report_is_printed_in_one_line(arm: pp.Arm) -> None:
    tracker = Tracker(arm, "geodesic", LIMITS)
    tracker.step(None)
    assert repr(tracker.report) == "Report(holding: no measurement)"
    tracker.update(Target.from_configuration(arm, arm.neutral()))
    tracker.step(np.full(arm.nq, 0.1))
    assert repr(tracker.report).startswith("Report(moving, mean error ")
    assert repr(tracker) == f"Tracker({arm.name!r}, 'geodesic', {tracker.report})"


def test_without_a_target_it_stands(arm: pp.Arm) -> None:
    tracker = Tracker(arm, "geodesic", LIMITS)
    for _ in range(5):
        assert not np.any(tracker.step(arm.neutral()))
    report = tracker.report
    assert report.status == "holding" and "no target" in report.reason
    assert report.mean_error is None and report.target_age is None and report.tracking_error == 0.0


def test_a_target_that_does_not_fit_is_refused_and_the_one_before_stays(arm: pp.Arm) -> None:
    tracker = Tracker(arm, "geodesic", LIMITS)
    good = Target.from_configuration(arm, np.full(arm.nv, 0.2))
    tracker.update(good)
    tracker.step(arm.neutral())
    other = pp.Arm.from_template("RyRz", 3)
    spoilt = np.array(good.points)
    spoilt[1, 0] = np.nan
    for bad in (
        Target.from_configuration(other, other.neutral()),
        Target(spoilt, np.ones(6)),
        Target(good.points, np.zeros(6)),
        Target(good.points, np.ones(6), q=np.full(arm.nq, np.inf)),
        good.points,
        None,
    ):
        with pytest.raises(InvalidValue):
            tracker.update(bad)
        assert tracker.target is good
    assert np.any(tracker.step(tracker.command))
    assert tracker.report.target_age == pytest.approx(0.04)


def test_a_target_that_the_controller_cannot_work_with_brakes_the_arm_and_says_why(arm: pp.Arm) -> None:
    tracker = Tracker(arm, "joint", LIMITS)
    tracker.update(Target.from_configuration(arm, np.full(arm.nv, 0.8)))
    path, moved = run(tracker, arm.neutral(), 8)
    assert np.abs(moved[-1]).max() > 0.02
    tracker.update(Target.from_points(arm, 1.1 * arm.at(np.full(arm.nv, 0.5)).points))  # not to be had
    path, braking = run(tracker, path[-1], 12)
    assert tracker.report.status == "holding" and "target.q" in tracker.report.reason
    assert not np.any(braking[-1])
    assert np.abs(np.diff(np.concatenate([moved[-1:], braking]), axis=0)).max() <= 10.0 * 0.02**2 + 1e-12
    tracker.update(Target.from_configuration(arm, np.full(arm.nv, 0.5)))
    run(tracker, path[-1], 1)
    assert tracker.report.status == "moving"


def test_so_does_a_controller_that_works_in_a_thread_of_its_own(arm: pp.Arm) -> None:
    tracker = Tracker(arm, "joint", LIMITS, deadline=5.0)
    tracker.update(Target.from_points(arm, 1.1 * arm.at(np.full(arm.nv, 0.5)).points))  # not to be had
    run(tracker, arm.neutral(), 3)
    assert "target.q" in tracker.report.reason
    tracker.update(Target.from_configuration(arm, np.full(arm.nv, 0.5)))
    run(tracker, arm.neutral(), 1)
    assert tracker.report.status == "moving"


def test_faults_of_the_program_are_raised(arm: pp.Arm) -> None:
    tracker = Tracker(arm, "geodesic", LIMITS)
    q = arm.neutral()
    for bad in (np.zeros(arm.nq - 1), np.zeros((2, arm.nq)), "here"):
        with pytest.raises(InvalidValue, match="q_measured"):
            tracker.step(bad)
    for dt in (0.0, -0.01, np.nan, np.inf, "soon"):
        with pytest.raises(InvalidValue, match="dt"):
            tracker.step(q, dt)
    with pytest.raises(InvalidValue, match="points"):
        tracker.step(q, points=np.zeros((arm.n_modules + 1, 3)))
    with pytest.raises(InvalidValue, match="q_measured"):
        tracker.restart(np.full(arm.nq, np.nan))


def test_what_it_is_made_with_is_checked(arm: pp.Arm) -> None:
    for limits in (None, pp.Limits(), "fast"):
        with pytest.raises(InvalidValue, match="dt"):
            Tracker(arm, "geodesic", limits)
    for name in ("feedback_time_constant", "max_tracking_error", "resync_time", "timeout", "deadline"):
        for value in (0.0, -1.0, np.nan):
            with pytest.raises(InvalidValue, match=name):
                Tracker(arm, "geodesic", LIMITS, **{name: value})
    with pytest.raises(UnknownName, match="torque"):
        Tracker(arm, "geodesic", LIMITS, interface="torque")
    with pytest.raises(UnknownName):
        Tracker(arm, "best", LIMITS)
    with pytest.raises(PostureError):
        Tracker(arm, "geodesic", pp.Limits(step=np.ones(3), dt=0.01))


def singular_goals(arm: pp.Arm) -> dict[str, np.ndarray]:
    folded = arm.straight()
    straight = arm.straight()
    folded[4] = np.pi - 1e-3
    near = straight + 1e-7 * np.random.default_rng(3).normal(size=arm.nv)
    return {"straight": straight, "folded": folded, "nearly straight": near, "bent to limits": straight + 3.1}


@pytest.mark.long
@pytest.mark.parametrize("name", ["straight", "folded", "nearly straight", "bent to limits"])
@pytest.mark.parametrize("known", [True, False])
def test_singular_postures_are_taken_or_given_up_at_rest(arm: pp.Arm, name: str, known: bool) -> None:
    goal = singular_goals(arm)[name]
    target = Target.from_configuration(arm, goal)
    target = target if known else Target.from_points(arm, target.points)
    tracker = Tracker(arm, "geodesic", LIMITS)
    tracker.update(target)
    path, moved = run(tracker, smooth_configuration(arm, np.random.default_rng(4), 0.5), 500)
    assert np.all(np.isfinite(path)) and np.abs(path).max() <= np.pi + 1e-9
    assert not np.any(moved[-1]) and tracker.report.status in ("converged", "stalled")
    if known:
        assert tracker.report.status == "converged"
        np.testing.assert_allclose(arm.at(path[-1]).points, target.points, atol=1e-6)
    # And on from there: no posture is a trap.
    tracker.update(Target.from_configuration(arm, 0.3 * np.ones(arm.nv)))
    path, _ = run(tracker, path[-1], 500)
    assert tracker.report.status == "converged"


@pytest.mark.long
@pytest.mark.parametrize("factor", [1.05, 1.3, 5.0])
def test_what_is_out_of_reach_ends_stuck_and_at_rest(arm: pp.Arm, factor: float) -> None:
    points = factor * arm.at(smooth_configuration(arm, np.random.default_rng(6), 0.4)).points
    tracker = Tracker(arm, "geodesic", LIMITS)
    tracker.update(Target.from_points(arm, points))
    path, moved = run(tracker, 0.1 * np.ones(arm.nv), 500)
    assert tracker.report.status == "stalled" and tracker.report.reason
    assert not np.any(moved[-1])
    off = np.linalg.norm(arm.at(path[-1]).points - points, axis=1).mean()
    assert tracker.report.mean_error == pytest.approx(off, rel=1e-9) and off > 1e-3


@pytest.mark.long
def test_a_target_that_moves_slowly_is_kept(arm: pp.Arm) -> None:
    rng = np.random.default_rng(7)
    one, two = (smooth_configuration(arm, rng, 0.6) for _ in range(2))
    tracker = Tracker(arm, "geodesic", LIMITS)
    q = one
    off = []
    for k in range(400):
        wanted = np.cos(0.01 * k) * one + np.sin(0.01 * k) * two
        tracker.update(Target.from_configuration(arm, wanted))
        q = arm.integrate(q, tracker.step(q))
        off.append(np.linalg.norm(arm.at(q).points - arm.at(wanted).points, axis=1).mean())
    # At most what the target moves on in some cycles.
    assert max(off[50:]) < 0.1 * arm.length / arm.n_modules


def test_a_new_target_ahead_does_not_stop_the_arm() -> None:
    arm = pp.Arm.from_template("Rz", 1)
    tracker = Tracker(arm, "geodesic", LIMITS)
    q = arm.neutral()
    speeds = []
    for k in range(70):
        if k % 10 == 0:  # always a jump of its own, too far for the way to be bent
            tracker.update(Target.from_configuration(arm, np.array([2.6 + 0.05 * k / 10])))
        dq = tracker.step(q)
        speeds.append(dq[0] / 0.02)
        q = arm.integrate(q, dq)
    assert min(speeds[15:55]) > 1.6


def test_a_restart_on_the_move_goes_on_at_that_speed(arm):
    limits = pp.Limits(step=None, dt=0.02, acceleration=5.0)
    tracker = Tracker(arm, limits=limits, feedback_time_constant=float("inf"))
    rng = np.random.default_rng(0)
    target = pp.Target.from_configuration(arm, smooth_configuration(arm, rng, 0.5))
    tracker.restart(arm.neutral())
    tracker.update(target)
    for _ in range(8):
        dq = tracker.step(tracker.command)
    assert np.abs(dq).max() > 2.0 * limits.acceleration * limits.dt**2
    other = Tracker(arm, limits=limits, feedback_time_constant=float("inf"))
    other.restart(tracker.command, dq)
    other.update(target)
    most = limits.acceleration * limits.dt**2 * (1.0 + 1e-9)
    assert np.abs(other.step(other.command) - dq).max() <= most
    still = Tracker(arm, limits=limits, feedback_time_constant=float("inf"))
    still.restart(tracker.command)
    still.update(target)
    assert np.abs(still.step(still.command)).max() <= most  # from rest it cannot be that fast
    with pytest.raises(InvalidValue, match="dq"):
        other.restart(tracker.command, np.full(arm.nv, np.nan))


def endless_arm() -> pp.Arm:
    return pp.Arm.load(pp.Arm.from_template("RyRz", 2).urdf.replace('type="revolute"', 'type="continuous"'))


@pytest.mark.parametrize("interface", ["position", "velocity"])
@pytest.mark.parametrize("turns", [0, 1, -3])
def test_positions_go_on_across_half_a_turn_from_the_measured_turns(interface: str, turns: int) -> None:
    arm = endless_arm()
    tracker = Tracker(arm, limits=LIMITS, interface=interface)
    start = 3.0 + 2.0 * np.pi * turns
    tracker.update(Target.from_configuration(arm, arm.configuration(np.full(arm.nv, -2.8))))
    positions = np.full(arm.nv, start)
    sent = []
    for _ in range(200):
        dq = tracker.step(positions if turns else arm.configuration(positions))
        positions = positions + dq
        sent.append(tracker.positions)
        np.testing.assert_allclose(arm.configuration(sent[-1]), tracker.command, atol=1e-9)
    assert tracker.report.status == "converged"
    assert np.abs(np.diff(sent, axis=0)).max() <= 2.0 * 0.02 + 1e-9
    np.testing.assert_allclose(sent[-1], 2.0 * np.pi * (turns + 1) - 2.8, atol=1e-6)  # the shorter way


def test_a_drive_found_a_turn_away_is_commanded_from_there() -> None:
    arm = endless_arm()
    tracker = Tracker(arm, limits=LIMITS, resync_time=0.2)
    tracker.update(Target.from_configuration(arm, arm.neutral()))
    tracker.step(np.zeros(arm.nv))
    turned = np.array([2.0 * np.pi, 0.0, 0.0, 0.0])
    for _ in range(4):
        tracker.step(turned)
        assert tracker.report.status == "holding" and not np.any(tracker.positions)
    for _ in range(20):
        tracker.step(turned)
    np.testing.assert_allclose(tracker.positions, turned, atol=1e-9)
    tracker.restart(-turned)
    np.testing.assert_array_equal(tracker.positions, -turned)


def test_a_moving_drive_that_loses_a_turn_and_stands_is_commanded_from_there() -> None:
    arm = endless_arm()
    tracker = Tracker(arm, limits=LIMITS, resync_time=0.2)
    tracker.update(Target.from_configuration(arm, arm.configuration(np.full(arm.nv, 2.0))))
    positions = np.zeros(arm.nv)
    for _ in range(20):
        positions = positions + tracker.step(positions)
    lost = positions - [2.0 * np.pi, 0.0, 0.0, 0.0]
    for cycle in range(100):
        tracker.step(lost if cycle % 3 else None)  # and some measurements are missing
    assert tracker.report.status != "converged"
    assert np.abs(tracker.positions - lost).max() < 1.0
    for _ in range(200):
        tracker.step(lost)
        lost = tracker.positions
    assert tracker.report.status == "converged"
    np.testing.assert_allclose(lost, [2.0 - 2.0 * np.pi, 2.0, 2.0, 2.0], atol=1e-6)


@pytest.mark.soak
def test_noise_does_not_plan_again_for_an_arm_with_a_task(monkeypatch: pytest.MonkeyPatch) -> None:
    plans: list[object] = []

    def counted(problem: PlanningProblem, *arguments: object, **named: object) -> JointPath:
        plans.append(problem)
        return find_path(problem, *arguments, **named)

    for module in (geodesic, plan):
        monkeypatch.setattr(module, "find_path", counted)
    arm = pp.Arm.from_template("RyRz", 4)
    goal = np.full(arm.nv, 0.2)
    tip = pp.EndEffector(position=arm.at(goal).points[-1])
    tracker = Tracker(arm, pp.Geodesic(tasks=(tip,)), pp.Limits(step=None, dt=0.01, velocity=1.0))
    tracker.update(Target.from_configuration(arm, goal))
    rng = np.random.default_rng(0)
    q = arm.straight()
    for _ in range(300):
        tracker.step(q + 3e-4 * rng.normal(size=arm.nv))
        q = q + 0.2 * (tracker.command - q)
    assert len(plans) <= 2
    assert np.abs(q - goal).max() < 2e-3


@pytest.mark.soak
def test_memory_does_not_grow() -> None:
    arm = pp.Arm.from_template("RyRz", 3)
    rng = np.random.default_rng(8)
    tracker = Tracker(arm, "geodesic", LIMITS)
    q = arm.neutral()
    targets = [Target.from_configuration(arm, smooth_configuration(arm, rng, 0.5)) for _ in range(5)]

    def cycles(count: int, q: np.ndarray) -> np.ndarray:
        for k in range(count):
            if k % 40 == 0:
                tracker.update(targets[rng.integers(5)])
            dt = 0.02 * rng.uniform(0.9, 1.1)
            q = arm.integrate(q, tracker.step(q + 1e-5 * rng.normal(size=arm.nq), dt))
        return q

    def blocks() -> int:
        gc.collect()
        return sys.getallocatedblocks()

    q = cycles(600, q)
    before = blocks()
    cycles(2000, q)
    # Less than an array in each cycle. Limits and calls of the last cycles are remembered: up to 700 blocks.
    assert blocks() - before < 1500


def test_the_report_tells_the_time_of_a_cycle_and_whether_it_was_too_long(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    arm = pp.Arm.from_template("RyRz", modules=2)
    tracker = pp.Tracker(arm, limits=pp.Limits(step=None, velocity=1.0, dt=0.01))
    clock = iter([0.0, 0.004, 1.0, 1.011, 2.0, 2.01])
    monkeypatch.setattr("pinposture.motion.tracker.perf_counter", lambda: next(clock))
    seen = []
    for _ in range(3):
        tracker.step(arm.straight())
        seen.append((round(tracker.report.time, 9), tracker.report.overran))
    assert seen[:2] == [(0.004, False), (0.011, True)]
    assert tracker.overruns == 1 + seen[2][1]
