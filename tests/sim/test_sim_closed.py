"""Closed loop: what the controller is told, what it commands, and what becomes of the sag."""

from __future__ import annotations

import numpy as np
import pytest
from arms import template_arm
from simple_arms import pendulum

import pinposture as pp
from pinposture import sim
from pinposture.errors import InvalidValue
from pinposture.motion import Tracker
from pinposture.sim.plant import Sensors

LIMITS = pp.Limits(dt=0.02, acceleration=10.0)


def six_modules() -> pp.Arm:
    return template_arm("RyRz", 6)


def goal() -> np.ndarray:
    return np.random.default_rng(1).uniform(-0.3, 0.3, 12)


def bent() -> pp.Target:
    return pp.Target.from_configuration(six_modules(), goal())


class Follower:
    """Sends the arm to the configuration of its target, and beyond by a share of what it stays behind."""

    def __init__(self, arm, share):
        self.arm = arm
        self.share = share
        self.told = []
        self.given = []
        self.command = None

    def update(self, target):
        self.given.append(target)

    def step(self, q_measured, dt=None):
        self.told.append(q_measured)
        if self.command is None:
            self.command = q_measured
        behind = np.zeros(self.arm.nv)
        if q_measured is not None:
            behind = self.share * self.arm.difference(q_measured, self.given[-1].q)
        self.command = self.arm.integrate(self.command, behind)
        return behind


def run(tracker, **options):
    arm = six_modules()
    options = {"duration": 1.5, "dt": 0.02, "q0": arm.neutral(), **options}
    return sim.simulate_closed(arm, tracker, options.pop("targets", bent()), **options)


def test_a_controller_that_integrates_removes_the_sag():
    arm = six_modules()
    sent = sim.simulate(arm, [goal()] * 2, dt=0.02, hold=1.0)
    assert sent.point_errors[-1].max() > 1e-4
    closed = run(Follower(arm, 0.1), duration=4.0)
    assert closed.target_errors[-1].max() < 1e-6
    assert closed.joint_error[-1].max() == pytest.approx(sent.joint_error[-1].max(), rel=0.01)
    assert (closed.loop, closed.finished, closed.measured) == ("closed", True, 1.0)


@pytest.mark.long
@pytest.mark.parametrize("gravity", [True, False])
def test_the_tracker_brings_the_arm_to_the_target(gravity):
    arm = six_modules()
    tracker = Tracker(arm, limits=LIMITS)
    closed = run(tracker, duration=4.0, gravity=gravity)
    assert closed.finished
    assert closed.target_errors[-1].mean() < 1e-6 * arm.length
    assert tracker.report.status == "converged"


@pytest.mark.long
def test_the_tracker_copes_with_sensors_as_they_are():
    arm = six_modules()
    tracker = Tracker(arm, limits=LIMITS)
    sensing = sim.Sensing(noise=2e-4, resolution=2.0 * np.pi / 4096, dropped=0.2, latency=1, seed=3)
    closed = run(tracker, duration=5.0, sensing=sensing)
    assert closed.finished
    assert closed.measured == pytest.approx(0.8, abs=0.06)
    assert closed.target_errors[-1].max() < 0.01 * arm.length


def test_it_is_told_of_the_moment_and_judged_by_the_end_of_the_cycle():
    arm = six_modules()

    def at(time):
        return pp.Target.from_configuration(arm, time * goal())

    follower = Follower(arm, 0.3)
    closed = run(follower, targets=at, duration=0.1, sensing=sim.Sensing(latency=2))
    np.testing.assert_allclose([each.q for each in follower.given], [k * 0.02 * goal() for k in range(5)])
    np.testing.assert_allclose(closed.targets, [at(k * 0.02).points for k in range(6)])
    # Two cycles old; until then the oldest there is.
    expected = closed.q[[0, 0, 0, 1, 2]]
    np.testing.assert_allclose(follower.told, expected, atol=1e-12)


def test_noise_comes_from_the_seed_and_has_the_size_that_is_told():
    told = []
    for seed in (0, 0, 1):
        follower = Follower(six_modules(), 0.0)
        run(follower, gravity=False, duration=2.0, sensing=sim.Sensing(noise=0.01, seed=seed))
        told.append(np.array(follower.told))
    np.testing.assert_array_equal(told[0], told[1])
    assert np.abs(told[0] - told[2]).max() > 0.01
    still = np.array(told[0]) - told[0].mean(axis=0)
    assert still.std() == pytest.approx(0.01, rel=0.1)


def test_measurements_are_multiples_of_the_resolution():
    follower = Follower(six_modules(), 0.1)
    run(follower, duration=0.4, sensing=sim.Sensing(resolution=0.01))
    counts = np.array(follower.told) / 0.01
    np.testing.assert_allclose(counts, np.round(counts), atol=1e-9)


def test_nothing_is_commanded_before_the_first_measurement_arrives():
    arm = six_modules()
    tracker = Tracker(arm, limits=LIMITS)
    seed = next(s for s in range(100) if np.all(_first_losses(s, 4)))
    closed = run(tracker, gravity=False, sensing=sim.Sensing(dropped=0.6, seed=seed))
    np.testing.assert_allclose(closed.commanded[:5], np.zeros((5, arm.nv)), atol=1e-12)
    assert np.abs(closed.commanded[-1]).max() > 0.1


def _first_losses(seed, count):
    sensors = Sensors(sim.Sensing(dropped=0.6, seed=seed))
    return [sensors.measure(np.zeros(12)) is None for _ in range(count)]


def test_points_without_a_target_have_no_error():
    arm = six_modules()
    target = pp.Target.from_points(arm, bent().points, [1, 0, 1, 0, 0, 1])
    closed = run(Tracker(arm, limits=LIMITS), targets=target, duration=0.2)
    assert np.all(closed.target_errors[:, [1, 3, 4]] == 0.0)
    assert np.all(closed.target_errors[:, [0, 2, 5]] > 0.0)
    counted = closed.target_errors[-1].sum() / 3
    assert closed.summary()["target_error"]["end"] == pytest.approx(counted)


@pytest.mark.parametrize(
    ("options", "name"),
    [
        ({"duration": 0.0}, "duration"),
        ({"dt": -0.02}, "dt"),
        ({"q0": [0.0]}, "q0"),
        ({"targets": "helix"}, "targets"),
    ],
)
def test_what_makes_no_loop_is_refused(options, name):
    with pytest.raises(InvalidValue, match=name):
        run(Follower(six_modules(), 0.1), **options)


@pytest.mark.parametrize("wrong", [None, 3, "helix", pp.Sphere((0, 0, 0), 0.1)])
def test_what_a_function_of_targets_returns_is_checked(wrong):
    with pytest.raises(InvalidValue, match=r"targets\(0\.02\).*a Target"):
        run(Follower(six_modules(), 0.1), targets=lambda time: bent() if time < 0.01 else wrong)


def test_what_a_function_of_targets_raises_is_raised():
    with pytest.raises(ZeroDivisionError):
        run(Follower(six_modules(), 0.1), targets=lambda time: 1.0 / time)


@pytest.mark.parametrize("tracker", [None, 3, Follower, object()])
def test_what_is_no_controller_in_a_loop_is_refused(tracker):
    with pytest.raises(InvalidValue, match=r"tracker .*`update`, `step`"):
        run(tracker)


def test_a_command_that_is_none_is_refused():
    follower = Follower(six_modules(), np.nan)
    with pytest.raises(InvalidValue, match=r"Follower\.command"):
        run(follower)


@pytest.mark.parametrize(
    "options",
    [
        {"noise": -1.0},
        {"resolution": np.inf},
        {"dropped": 1.0},
        {"latency": 0.5},
        {"latency": -1},
        {"seed": -1},
    ],
)
def test_sensors_that_cannot_be_are_refused(options):
    with pytest.raises(InvalidValue, match=next(iter(options))):
        sim.Sensing(**options)


@pytest.mark.filterwarnings("ignore::pinposture.errors.PostureWarning")
def test_a_closed_loop_that_runs_away_is_given_up():
    arm = pendulum()
    target = pp.Target.from_configuration(arm, [0.5])
    servos = sim.Servos(frequency=3000.0, torque_limits=False)
    ended = sim.simulate_closed(arm, Follower(arm, 0.5), target, [0.0], 1.0, 0.02, servos)
    assert ended.status == "unstable"
    assert np.all(np.isfinite(ended.target_errors))
