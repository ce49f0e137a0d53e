"""Limits of jerk: they and all others hold on the output, and the arm still arrives."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from sampling import examples

import pinposture as pp
from pinposture.arm import smooth_configuration
from pinposture.collision import CollisionModel
from pinposture.control.limits import JerkFilter
from pinposture.errors import InvalidValue
from pinposture.motion.run import find_limit_violation
from pinposture.units import length_text

pytestmark = pytest.mark.filterwarnings("ignore:velocity .* is above")

DT = 0.01


@pytest.fixture(scope="module")
def arm() -> pp.Arm:
    return pp.Arm.from_template("RyRz", modules=6)


def limited(jerk: float, velocity: float = 1.0, acceleration: float = 5.0) -> pp.Limits:
    return pp.Limits(step=None, velocity=velocity, acceleration=acceleration, jerk=jerk, dt=DT)


def largest(steps: np.ndarray, limits: pp.Limits) -> np.ndarray:
    """Largest speed, acceleration and jerk of an arm that rests before and after steps, of their limits."""
    rates = np.pad(steps, ((3, 3), (0, 0))) / DT
    found = [np.abs(np.diff(rates, order, axis=0)).max() / DT**order for order in range(3)]
    return np.array(found) / [limits.velocity, limits.acceleration, limits.jerk]


@pytest.mark.long
@examples(20)
@given(
    seed=st.integers(0, 10_000),
    velocity=st.floats(0.2, 3.0),
    acceleration=st.floats(0.5, 20.0),
    jerk=st.floats(3.0, 2000.0),
    controller=st.sampled_from(["geodesic", "selection", "joint"]),
)
def test_all_limits_hold_and_the_arm_arrives(
    arm: pp.Arm, seed: int, velocity: float, acceleration: float, jerk: float, controller: str
) -> None:
    rng = np.random.default_rng(seed)
    limits = limited(jerk, velocity, acceleration)
    start, goal = (smooth_configuration(arm, rng, 0.6) for _ in range(2))
    run = pp.track(arm, pp.Target.from_configuration(arm, goal), start, controller, limits, max_steps=4000)
    assert np.all(largest(np.diff(run.q, axis=0), limits) <= 1.0 + 1e-9)
    assert np.all((run.q >= arm.limits.lower - 1e-9) & (run.q <= arm.limits.upper + 1e-9))
    assert run.excess is None
    if controller != "selection":  # which may stop on the way
        assert run.converged and run.posture_error[-1] <= arm.n_modules * 1.001e-6 * arm.length
        error = length_text(run.posture_error[-1] / arm.n_modules, arm.length)
        assert f"mean point error {error}, within" in run.reason


@pytest.mark.long
@examples(15)
@given(seed=st.integers(0, 10_000), jerk=st.sampled_from([5.0, 20.0, 60.0]))
def test_the_posture_error_rises_only_on_flagged_steps(arm: pp.Arm, seed: int, jerk: float) -> None:
    rng = np.random.default_rng(seed)
    start, goal = (smooth_configuration(arm, rng, 0.9) for _ in range(2))
    target = pp.Target.from_points(arm, arm.at(goal).points)
    run = pp.track(arm, target, start, limits=limited(jerk, 2.0, 10.0), max_steps=1500)
    errors = [float(np.linalg.norm(arm.at(q).points - target.points, axis=1).sum()) for q in run.q]
    rise = np.diff(errors)
    assert np.all(rise[~run.error_increasing] <= 1e-11 * arm.length)
    assert not run.steps or run.error_increasing.mean() < 1.0


def turned(distance: float, limits: pp.Limits) -> pp.Run:
    """The motion of one joint over a distance, from rest to rest."""
    arm = pp.Arm.from_template("RyRz", 1)
    target = pp.Target.from_configuration(arm, [distance, 0.0])
    return pp.track(arm, target, [0.0, 0.0], limits=limits, max_steps=2000)


@pytest.mark.parametrize("jerk", [20.0, 50.0, 200.0])
@pytest.mark.parametrize("distance", [1.5, 2.5])
def test_a_long_motion_of_one_joint_takes_little_longer_than_the_shortest(
    jerk: float, distance: float
) -> None:
    limits = limited(jerk)
    run = turned(distance, limits)
    # From rest to rest, at full jerk, acceleration and speed in turn.
    v = limits.velocity
    a = limits.acceleration
    shortest = distance / v + v / a + a / jerk
    assert run.converged and np.all(largest(np.diff(run.q, axis=0), limits) <= 1.0 + 1e-9)
    assert shortest - 3 * DT <= DT * run.steps <= shortest + a / jerk + 0.02 * distance / v + 3 * DT


def test_the_filter_is_a_moving_average_that_arrives(arm: pp.Arm) -> None:
    rng = np.random.default_rng(0)
    limits = limited(75.0)
    jerk_filter = JerkFilter(arm, limits)
    cycles = 14  # 2 * 5 / (75 * 0.01), rounded up
    assert jerk_filter.cycles == cycles
    given_steps = np.concatenate([rng.normal(size=(40, arm.nv)), np.zeros((cycles - 1, arm.nv))])
    kernel = np.full(cycles, 1.0 / cycles)
    expected = np.array([np.convolve(column, kernel)[: len(column)] for column in given_steps.T]).T
    taken = []
    before = np.zeros(arm.nv)
    for number, step in enumerate(given_steps):
        taken.append(jerk_filter.apply(step))
        before = before + step
        np.testing.assert_allclose(np.sum(taken, axis=0) + jerk_filter.ahead, before, atol=1e-12)
        assert jerk_filter.moving == (number < len(given_steps) - 1)
    np.testing.assert_allclose(taken, expected, atol=1e-12)
    jerk_filter.restart(given_steps[0])
    np.testing.assert_allclose(jerk_filter.apply(given_steps[0]), given_steps[0])


@pytest.mark.long
def test_a_path_that_bends_is_cut_by_no_more_than_derived(arm: pp.Arm) -> None:
    limits = limited(30.0)
    rng = np.random.default_rng(3)
    start, goal = (smooth_configuration(arm, rng, 0.8) for _ in range(2))
    target = pp.Target.from_configuration(arm, goal)
    along = pp.track(arm, target, start, limits=replace(limits, jerk=None), max_steps=2000).q
    run = pp.track(arm, target, start, limits=limits, max_steps=2000)
    apart = np.abs(run.q[:, None] - along[None]).max(axis=2).min(axis=1)
    between = 0.5 * np.abs(np.diff(along, axis=0)).max()  # the rows of a path are not all of it
    assert apart.max() <= 0.005 + between


@pytest.mark.parametrize("distance", [0.02, 0.1, 0.3])
@pytest.mark.parametrize("jerk", [2.0, 20.0, 50.0])
def test_a_short_motion_of_one_joint_takes_little_longer_than_the_shortest(
    jerk: float, distance: float
) -> None:
    run = turned(distance, limited(jerk))
    # From rest to rest, with the jerk alone: a quarter of the time each with +j, -j, -j and +j.
    shortest = (32.0 * distance / jerk) ** (1.0 / 3.0)
    assert run.converged
    assert shortest - 3 * DT <= DT * run.steps <= 1.45 * shortest + 3 * DT


@pytest.mark.long
@pytest.mark.parametrize("interface", ["position", "velocity"])
def test_the_tracker_keeps_them_whatever_happens(arm: pp.Arm, interface: str) -> None:
    rng = np.random.default_rng(1)
    limits = limited(60.0)
    tracker = pp.Tracker(arm, limits=limits, interface=interface)
    q = arm.neutral()
    steps = []
    statuses = set()
    for cycle in range(900):
        if cycle % 60 == 0 and cycle < 600:
            goal = smooth_configuration(arm, rng, rng.uniform(0.1, 0.9))
            tracker.update(pp.Target.from_configuration(arm, goal))
        measured = None if rng.random() < 0.05 and cycle < 600 else q + 1e-5 * rng.normal(size=arm.nv)
        dq = tracker.step(measured)
        steps.append(dq)
        statuses.add(tracker.report.status)
        q = q + dq if interface == "velocity" else q + 0.5 * (tracker.command - q)
    assert "stalled" not in statuses
    taken = np.array(steps)
    rates = np.pad(taken, ((3, 0), (0, 0))) / DT
    found = [np.abs(np.diff(rates, order, axis=0)).max() / DT**order for order in range(3)]
    assert np.all(np.array(found) <= np.array([1.0, 5.0, 60.0]) * (1.0 + 1e-9))
    assert np.abs(arm.at(q).points - arm.at(goal).points).max() <= 1e-3 * arm.length


@pytest.mark.long
def test_cycles_of_other_durations_keep_speed_and_arrive(arm: pp.Arm) -> None:
    rng = np.random.default_rng(4)
    limits = limited(60.0)
    q = arm.neutral()
    tracker = pp.Tracker(arm, limits=limits)
    goal = smooth_configuration(arm, rng, 0.6)
    tracker.update(pp.Target.from_configuration(arm, goal))
    for cycle in range(900):
        dt = DT * rng.uniform(0.3, 3.0) if cycle < 300 else DT
        dq = tracker.step(q, dt)
        assert np.abs(dq).max() <= limits.velocity * min(dt, DT) * (1.0 + 1e-9)
        q = tracker.command
    np.testing.assert_allclose(q, goal, atol=1e-5)


class Measured:
    """Speed, acceleration and jerk of steps by finite differences, relative to limits that may change.

    The acceleration is the change of the mean speed divided by the longer of two cycles; the jerk is the
    third derivative of the cubic through four positions.
    """

    def __init__(self, joints: int) -> None:
        self.times = [-3.0 * DT, -2.0 * DT, -DT, 0.0]
        self.positions = [np.zeros(joints)] * 4

    def exceeded(self, step: np.ndarray, duration: float, limits: pp.Limits) -> list[str]:
        self.times = [*self.times[1:], self.times[-1] + duration]
        self.positions = [*self.positions[1:], self.positions[-1] + step]
        durations = np.diff(self.times)
        steps = np.diff(self.positions, axis=0)
        speeds = steps / durations[:, None]
        acceleration = np.abs(speeds[2] - speeds[1]) / max(durations[1:])
        weights = [
            1.0 / np.prod([here - other for other in self.times if other != here]) for here in self.times
        ]
        jerk = 6.0 * np.abs(np.array(weights) @ (np.array(self.positions) - self.positions[-1]))
        shortest = durations.min()
        found = []
        if np.abs(speeds[2]).max() > limits.velocity * (1.0 + 1e-9) + 1e-15 / shortest:
            found.append("velocity")
        if acceleration.max() > limits.acceleration * (1.0 + 1e-5) + 1e-14 / shortest**2:
            found.append("acceleration")
        if limits.jerk is not None and jerk.max() > limits.jerk * (1.0 + 1e-5) + 1e-14 / shortest**3:
            found.append("jerk")
        return found


@pytest.mark.long
@examples(12)
@given(
    seed=st.integers(0, 10_000),
    jerk=st.sampled_from([None, 20.0, 100.0, 3000.0]),
    shortest=st.sampled_from([1e-4, 1e-2, 0.3, 0.9]),
    changes=st.booleans(),
    interface=st.sampled_from(["position", "velocity"]),
)
def test_limits_hold_in_cycles_of_all_durations_or_steps_beyond_them_are_named(
    arm: pp.Arm, seed: int, jerk: float | None, shortest: float, changes: bool, interface: str
) -> None:
    rng = np.random.default_rng(seed)
    q = arm.neutral()
    limits = pp.Limits(step=None, velocity=1.0, acceleration=5.0, jerk=jerk, dt=DT)
    tracker = pp.Tracker(arm, limits=limits, interface=interface)
    measured = Measured(arm.nv)
    named = 0
    for cycle in range(250):
        if cycle % 45 == 0:
            goal = smooth_configuration(arm, rng, rng.uniform(0.1, 0.9))
            tracker.update(pp.Target.from_configuration(arm, goal))
        if changes and cycle % 40 == 39:
            velocity = rng.uniform(0.5, 2.0)
            acceleration = rng.uniform(2.0, 10.0)
            wanted = rng.choice([None, 20.0, 100.0, 3000.0])
            limits = tracker.limits = replace(
                limits,
                velocity=velocity,
                acceleration=acceleration,
                jerk=wanted,
                dt=DT * rng.choice([1.0, 2.0]),
            )
        duration = limits.dt * (rng.uniform(shortest, 1.0) if rng.random() < 0.7 else 1.0)
        dq = tracker.step(q, duration)
        told = " ".join(tracker.report.violated_constraints)
        for kind in measured.exceeded(dq, duration, limits):
            assert kind in told and changes
            named += 1
        q = arm.integrate(q, dq)
    assert named < 200
    for _ in range(900):
        q = arm.integrate(q, tracker.step(q))
    np.testing.assert_allclose(q, goal, atol=1e-5)
    assert tracker.limits is limits and tracker.report.status == "converged"


@pytest.mark.long
@pytest.mark.parametrize("before", [None, 200.0])
@pytest.mark.parametrize("after", [None, 20.0, 50.0])
def test_a_limit_that_is_set_in_motion_is_kept_once_the_arm_has_stopped(
    arm: pp.Arm, before: float | None, after: float | None
) -> None:
    limits = pp.Limits(step=None, velocity=2.0, acceleration=4.0, jerk=before, dt=DT)
    tracker = pp.Tracker(arm, limits=limits)
    q = arm.neutral()
    steps = []
    goal = smooth_configuration(arm, np.random.default_rng(2), 0.9)
    tracker.update(pp.Target.from_configuration(arm, goal))
    reasons = []
    told = []
    for cycle in range(1500):
        if cycle == 20:
            tracker.limits = replace(limits, jerk=after)
        steps.append(tracker.step(q))
        q = arm.integrate(q, steps[-1])
        reasons.append(tracker.report.reason)
        told.append(bool(tracker.report.violated_constraints))
    np.testing.assert_allclose(q, goal, atol=1e-5)
    braking = [cycle for cycle, reason in enumerate(reasons) if "former" in reason]
    assert len(braking) < 60 and (not braking or braking[0] == 20)
    assert bool(braking) == (before != after)
    since = (braking[-1] if braking else 20) + 4
    assert not any(told[since:])
    if after is not None:
        assert np.abs(np.diff(steps[since:], 2, axis=0)).max() <= after * DT**3 * (1.0 + 1e-6)


def test_limits_are_checked_when_they_are_set(arm: pp.Arm) -> None:
    tracker = pp.Tracker(arm, limits=limited(60.0))
    known = tracker.limits
    wrong = [None, pp.Limits(), pp.Limits(velocity=np.ones(5), dt=DT), limited(1e-12), "fast"]
    for limits in wrong:
        with pytest.raises(InvalidValue):
            tracker.limits = limits
        assert tracker.limits is known


def test_a_tracker_that_starts_in_motion_goes_on_smoothly(arm: pp.Arm) -> None:
    tracker = pp.Tracker(arm, limits=limited(60.0))
    before = np.full(arm.nv, 0.008)
    tracker.restart(arm.neutral(), before)
    assert np.abs(tracker.step(arm.neutral()) - before).max() <= 60.0 * DT**3 + 1e-12  # it brakes


def test_motions_keep_them_and_stay_on_their_keyframes(arm: pp.Arm) -> None:
    rng = np.random.default_rng(5)
    limits = limited(100.0, 2.0, 10.0)
    postures = [smooth_configuration(arm, rng, 0.5) for _ in range(3)]
    keyframes = [pp.Keyframe(None, time, joints=q) for time, q in zip((0.0, 1.0, 2.0), postures, strict=True)]
    for controller in ("geodesic", "joint"):
        motion = pp.move_through(arm, keyframes, controller, limits)
        assert motion.converged and not motion.faults
        assert np.all(largest(np.diff(motion.q, axis=0), limits) <= 1.0 + 1e-9)
        assert len(motion.targets) == len(motion.q) and np.all(np.diff(motion.plan_time) >= -1e-12)
        worst = max(place.mean_error for place in motion.waypoints)
        assert worst <= 0.02 * arm.length
    np.testing.assert_allclose(motion.q[-1], postures[-1], atol=1e-5)


@pytest.mark.long
def test_clearance_that_a_cut_corner_costs_is_reported(arm: pp.Arm, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("pinposture.control.limits.MAX_CORNER_CUT", np.inf)
    rng = np.random.default_rng(13)
    limits = limited(15.0, 2.0)
    start, goal = (smooth_configuration(arm, rng, 0.8) for _ in range(2))
    middle = arm.at(0.5 * (start + goal)).points[4]
    scene = pp.Scene(
        {"ball": pp.Sphere(tuple(middle + [0.0, 0.0, 0.04]), 0.02)}, margin=0.01, arm_radius=0.005
    )
    tracker = pp.Tracker(arm, limits=limits, scene=scene)
    model = CollisionModel(arm, scene)
    tracker.update(pp.Target.from_configuration(arm, goal))
    q = start
    lowest = np.inf
    for _ in range(1500):
        q = arm.integrate(q, tracker.step(q))
        told = any(each.startswith("margin: ") for each in tracker.report.violated_constraints)
        assert told or model.minimum(q).distance >= 0.99 * scene.margin
        lowest = min(lowest, model.minimum(q).distance)
        if tracker.report.status == "converged":
            break
    assert tracker.report.status == "converged"
    assert lowest < 0.95 * scene.margin  # so that there was something to report


@pytest.mark.parametrize("shares", [(1.0,), (1.0, 0.4, 0.7)])
def test_a_report_flags_the_steps_that_were_sent_and_raise_the_error(
    arm: pp.Arm, shares: tuple[float, ...]
) -> None:
    rng = np.random.default_rng(3)
    unflagged = 0
    flagged = 0
    start, *goals = (smooth_configuration(arm, rng, 0.9) for _ in range(4))
    tracker = pp.Tracker(arm, limits=limited(20.0, 2.0, 10.0))
    q = start
    for cycle in range(240):
        if cycle % 45 == 0:
            target = pp.Target.from_points(arm, arm.at(goals[cycle // 45 % 3]).points)
            tracker.update(target)
        dq = tracker.step(q, dt=DT * shares[cycle % len(shares)])
        step = tracker.report.step
        before, after = (
            float(np.linalg.norm(arm.at(each).points - target.points, axis=1).sum())
            for each in (q, tracker.command)
        )
        q = tracker.command
        if step is None:
            continue
        assert np.array_equal(step.dq, dq)
        flagged += step.error_increasing
        unflagged += after - before > 1e-11 * arm.length and not step.error_increasing
    assert flagged and not unflagged


def test_what_is_asked_for_is_checked(arm: pp.Arm) -> None:
    with pytest.raises(InvalidValue, match="acceleration"):
        pp.Limits(velocity=1.0, jerk=10.0, dt=DT)
    with pytest.raises(InvalidValue, match="jerk"):
        pp.Limits(acceleration=1.0, jerk=-1.0, dt=DT)
    with pytest.raises(InvalidValue, match="jerk"):
        pp.track(arm, pp.Target.from_configuration(arm, arm.neutral()), arm.neutral(), limits=limited(1e-12))
    with pytest.raises(InvalidValue, match="jerk"):
        pp.Limits(acceleration=1.0, jerk=[1.0, 2.0], dt=DT).for_arm(arm)


def test_a_run_that_exceeds_the_limit_says_so(arm: pp.Arm, tmp_path: Path) -> None:
    goal = smooth_configuration(arm, np.random.default_rng(0), 0.6)
    target = pp.Target.from_configuration(arm, goal)
    run = pp.track(arm, target, arm.neutral(), limits=limited(20.0))
    pp.save(run, tmp_path / "run.npz")
    assert pp.load(tmp_path / "run.npz").limits == run.limits
    free = pp.track(arm, target, arm.neutral(), limits=limited(1e6))
    vars(free)["limits"] = limited(20.0)
    excess = find_limit_violation(free)
    assert excess is not None and "jerk limit: joint" in excess.text
    worst = largest(np.diff(free.q, axis=0), limited(20.0))[2]
    assert excess.ratio == pytest.approx(worst, rel=1e-6)
