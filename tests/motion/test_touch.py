"""A tracker that feels contact: torques against Pinocchio's, and what the arm then does."""

from __future__ import annotations

import numpy as np
import pinocchio as pin
import pytest
from arms import template_arm

import pinposture as pp
from pinposture.errors import InvalidValue, UnknownName, WeightUnknown
from pinposture.motion import Tracker
from pinposture.motion.touch import TouchDetector

DT = 0.01
LIMITS = pp.Limits(step=None, dt=DT, velocity=1.0, acceleration=6.0)
GOAL = np.tile([-0.2, 0.1], 5)


def heavy() -> pp.Arm:
    return template_arm("RyRz", 5).with_payload(0.1)


def needed(arm: pp.Arm, q: np.ndarray, v: np.ndarray, a: np.ndarray) -> np.ndarray:
    """The torques of a motion, by Pinocchio."""
    return np.asarray(pin.rnea(arm.model, arm.model.createData(), q, v, a))


def pushed(arm: pp.Arm, q: np.ndarray, force: np.ndarray) -> np.ndarray:
    """The torques of a force on the last control point, (nv,)."""
    return arm.at(q).jacobians[-1].T @ force


class Robot:
    """Drives that follow at once with the torques of rest; from some cycle on, the tip is pushed."""

    def __init__(self, arm: pp.Arm, touch: pp.Touch, force: np.ndarray, cycle: int = 30) -> None:
        self.arm = arm
        self.tracker = Tracker(arm, limits=LIMITS, touch=touch)
        self.tracker.update(pp.Target.from_configuration(arm, GOAL))
        self.force = force
        self.cycle = cycle
        self.positions = [np.zeros(arm.nv)]

    def run(self, cycles: int, named: bool = False) -> str:
        """Run the loop, and return the last status."""
        for _ in range(cycles):
            q = self.positions[-1]
            torques = needed(self.arm, q, np.zeros(self.arm.nv), np.zeros(self.arm.nv))
            if len(self.positions) > self.cycle:
                torques = torques - pushed(self.arm, q, self.force)
            efforts = dict(zip(self.arm.drives.names, torques, strict=True))
            self.tracker.step(q, torques=efforts if named else torques)
            self.positions.append(self.tracker.positions)
        return self.tracker.report.status


@pytest.mark.parametrize("force", [(0.0, 0.0, 0.0), (0.5, -1.0, 2.0)])
def test_torques_of_contact_are_those_of_the_force(force):
    arm = heavy()
    detector = TouchDetector(arm, pp.Touch(threshold=0.5))
    rng = np.random.default_rng(0)
    sizes = rng.uniform(0.1, 0.4, arm.nv)
    rates = rng.uniform(1.0, 4.0, arm.nv)
    for time in np.arange(0.0, 1.0, DT):
        q = sizes * np.sin(rates * time)
        v = sizes * rates * np.cos(rates * time)
        a = -sizes * rates**2 * np.sin(rates * time)
        detector.update(q, needed(arm, q, v, a) - pushed(arm, q, np.array(force)), DT)
    largest = np.abs(needed(arm, q, v, a)).max()
    # One cycle and the filter late: the lever changes meanwhile.
    late = pushed(arm, sizes * np.sin(rates * (time - DT - 0.04)), np.array(force))
    np.testing.assert_allclose(detector.torques, late, atol=1e-3 * largest + 0.01 * np.abs(late).max())
    assert bool(detector.reason) == any(force)


@pytest.mark.long
def test_the_arm_stops_and_goes_on_after_a_restart():
    arm = heavy()
    push = np.array([0.0, 0.0, 10.0])
    robot = Robot(arm, pp.Touch(threshold=0.2), push)
    assert robot.run(30) == "moving"
    assert robot.run(1, named=True) == "moving"
    assert robot.run(10, named=True) == "holding"
    reason = robot.tracker.report.reason
    assert "something touches the arm" in reason
    assert "N m" in reason
    robot.run(30)
    at = robot.positions[-1]
    robot.run(10)
    np.testing.assert_allclose(robot.positions[-1], at, atol=1e-12)
    moved = np.diff(robot.positions, axis=0)
    assert np.abs(np.diff(moved, axis=0)).max() <= 6.0 * DT**2 * (1.0 + 1e-9)
    robot.force = np.zeros(3)
    robot.tracker.restart(at)
    assert robot.run(150) == "converged"


@pytest.mark.long
def test_the_arm_gives_way_in_the_direction_of_the_push_until_it_is_weak():
    arm = heavy()
    robot = Robot(arm, pp.Touch(threshold=0.2, reaction="yield"), np.array([0.0, 0.0, 10.0]))
    robot.run(60)
    first = robot.positions[-1]
    robot.run(40)
    risen = arm.at(robot.positions[-1]).points[-1] - arm.at(first).points[-1]
    assert risen[2] > 0.01
    assert robot.tracker.report.status == "holding"
    robot.force = np.array([0.0, 0.0, 0.1])
    robot.run(60)
    at = robot.positions[-1]
    robot.run(5)
    np.testing.assert_allclose(robot.positions[-1], at, atol=1e-12)


@pytest.mark.long
def test_without_torques_nothing_is_felt():
    arm = heavy()
    tracker = Tracker(arm, limits=LIMITS, touch=pp.Touch(threshold=1e-3))
    tracker.update(pp.Target.from_configuration(arm, GOAL))
    at = np.zeros(arm.nv)
    for torques in (None, np.full(arm.nv, np.nan), {}) * 60:
        tracker.step(at, torques=torques)
        at = tracker.positions
    assert tracker.report.status == "converged"
    with pytest.raises(InvalidValue, match="torques"):
        tracker.step(at, torques=np.zeros(3))


def test_a_reading_that_is_repeated_is_none():
    arm = heavy()
    v = np.full(arm.nv, 0.5)
    felt = []
    for repeats in (1, 3):
        detector = TouchDetector(arm, pp.Touch(threshold=1e3))
        for cycle in range(90):
            q = v * DT * (cycle - cycle % repeats)
            detector.update(q, needed(arm, q, v, np.zeros(arm.nv)), DT)
        felt.append(np.abs(detector.torques).max())
    assert max(felt) < 1e-6


def test_each_drive_may_have_its_own_threshold_and_the_others_feel_nothing():
    arm = heavy()
    last = arm.drives.names[-1]
    detector = TouchDetector(arm, pp.Touch(threshold={last: 0.01}))
    for row in range(100):
        detector.update(np.zeros(arm.nv) + 1e-9 * row, np.full(arm.nv, -5.0), DT)
    assert repr(last) in detector.reason
    lonely = TouchDetector(arm, pp.Touch(threshold={last: 100.0}))
    for row in range(100):
        lonely.update(np.zeros(arm.nv) + 1e-9 * row, np.full(arm.nv, -5.0), DT)
    assert lonely.reason == ""


def test_without_a_threshold_it_is_a_fifth_of_the_largest_torque_of_weight():
    arm = heavy()
    turned = arm.with_gravity((0.0, 9.81, 0.0))
    largest = max(np.abs(each.at(arm.straight()).gravity_torques).max() for each in (arm, turned))
    np.testing.assert_allclose(TouchDetector(arm, pp.Touch())._thresholds, 0.2 * largest, rtol=1e-9)
    with pytest.raises(InvalidValue, match=r"touch\.threshold"):
        TouchDetector(arm.with_gravity((0.0, 0.0, 0.0)), pp.Touch())


def moving_log(arm: pp.Arm, speed: float, rng: np.random.Generator, push: float = 0.0) -> pp.Log:
    """A log with noise and friction in the joints, in which the tip is pushed upwards or not [N]."""
    sizes = rng.uniform(0.1, 0.4, arm.nv)
    rates = speed * rng.uniform(0.5, 1.5, arm.nv)
    times = np.arange(0.0, 8.0, DT)
    positions = sizes * np.sin(times[:, None] * rates)
    torques = []
    for q, time in zip(positions, times, strict=True):
        v = sizes * rates * np.cos(rates * time)
        rubbed = needed(arm, q, v, -(rates**2) * q) + 0.05 * np.sign(v)
        torques.append(rubbed - pushed(arm, q, np.array([0.0, 0.0, push])) + 0.01 * rng.normal(size=arm.nv))
    measured = positions + 1e-4 * rng.normal(size=positions.shape)
    about = {"gravity": (0.0, 0.0, -9.81), "payload": 0.0}
    return pp.Log(times, positions, times, measured, effort=np.array(torques), **about)


@pytest.mark.long
def test_a_log_tells_thresholds_above_friction_and_noise_that_a_push_exceeds():
    arm = heavy()
    rng = np.random.default_rng(2)
    free = moving_log(arm, 1.0, rng)
    touch = pp.identify(arm, free).touch("yield")
    assert touch.reaction == "yield"
    assert set(touch.threshold) == set(arm.drives.names)
    assert len(set(touch.threshold.values())) == 1
    assert 0.1 < touch.threshold["m01_j1_y"] < 0.25  # twice the friction, and noise

    def feels(log: pp.Log) -> str:
        detector = TouchDetector(arm, touch)
        for q, torques in zip(log.positions, log.effort, strict=True):
            detector.update(q, torques, DT)
        return detector.reason

    for _ in range(5):
        assert feels(moving_log(arm, 2.0, rng)) == ""
    assert "something touches the arm" in feels(moving_log(arm, 1.0, rng, push=2.0))


def test_a_log_without_efforts_or_weight_tells_no_thresholds():
    arm = heavy()
    log = moving_log(arm, 1.0, np.random.default_rng(2))
    known = {"gravity": (0.0, 0.0, -9.81), "payload": 0.0}
    silent = pp.Log(log.command_time, log.commands, log.time, log.positions, **known)
    with pytest.raises(InvalidValue, match=r"log\.effort"):
        pp.identify(arm, silent).touch()
    still = np.tile(log.positions[:1], (len(log.time), 1))
    rest = pp.Log(
        log.time, still, log.time, still, effort=np.ones_like(still), gravity=log.gravity, payload=0.0
    )
    with pytest.raises(InvalidValue, match="and that moves"):
        pp.identify(arm, rest).touch()
    lying = pp.Log(
        log.command_time, log.commands, log.time, log.positions, effort=log.effort, in_contact=True
    )
    with pytest.raises(InvalidValue, match="the arm touched something"):
        pp.identify(arm, lying).touch()


@pytest.mark.parametrize(
    ("options", "error"),
    [
        ({"threshold": 0.0}, InvalidValue),
        ({"threshold": np.nan}, InvalidValue),
        ({"threshold": {"m01_j1_y": -1.0}}, InvalidValue),
        ({"threshold": 1.0, "reaction": "run"}, UnknownName),
        ({"threshold": 1.0, "time_constant": 0.0}, InvalidValue),
        ({"threshold": {"nobody": 1.0}}, UnknownName),
    ],
)
def test_what_is_no_touch_is_refused(options, error):
    with pytest.raises(error):
        Tracker(heavy(), limits=LIMITS, touch=pp.Touch(**options))


def test_an_arm_of_unknown_weight_feels_nothing_and_says_so():
    shape = '<visual><geometry><box size="1 1 1"/></geometry></visual>'
    bare = f'<robot name="r"><link name="a"/><link name="b">{shape}</link>'
    bare += '<joint name="j" type="revolute"><parent link="a"/><child link="b"/><axis xyz="0 1 0"/>'
    bare += '<limit lower="-1" upper="1" velocity="1" effort="1"/></joint><link name="c"/>'
    bare += '<joint name="k" type="fixed"><parent link="b"/><child link="c"/><origin xyz="1 0 0"/></joint>'
    arm = pp.Arm.load(f"{bare}</robot>")
    with pytest.raises(WeightUnknown):
        Tracker(arm, limits=LIMITS, touch=pp.Touch(threshold=1.0))
    with pytest.raises(InvalidValue, match="touch"):
        Tracker(heavy(), limits=LIMITS, touch=0.5)


@pytest.mark.long
@pytest.mark.parametrize("kind", ["limp", "weak", "astray"])
def test_torques_tell_a_limp_joint_from_a_weak_one_and_from_one_that_is_pushed(kind):
    """The arm is moved by Pinocchio's forward dynamics, on drives like springs that bear its weight."""
    arm = pp.Arm.from_template("RyRz", modules=2, link_lengths=(0.2, 0.2)).with_payload(0.1)
    data = arm.model.createData()
    tracker = Tracker(arm, limits=LIMITS, touch=pp.Touch())
    tracker.update(pp.Target.from_configuration(arm, np.zeros(arm.nv)))
    q, v = np.zeros(arm.nv), np.zeros(arm.nv)
    weight = torques = needed(arm, q, v, v)
    inertia = np.diagonal(pin.crba(arm.model, data, q)).copy()
    share = {"limp": 0.0, "weak": 0.3}.get(kind, np.inf)
    step = 2e-4
    for cycle in range(200):
        tracker.step(q, torques=torques)
        if tracker.report.failures:
            break
        for _ in range(round(DT / step)):
            torques = needed(arm, q, 0.0 * v, 0.0 * v) + inertia * (
                100.0 * (tracker.positions - q) - 10.0 * v
            )
            felt = np.zeros(arm.nv)
            if cycle > 20 and kind == "astray":
                felt = arm.at(q).jacobians[0].T @ np.array([0.0, 0.0, -20.0])
            elif cycle > 20:
                torques[0] = np.clip(torques[0], -share * abs(weight[0]), share * abs(weight[0]))
            v = v + step * np.asarray(pin.aba(arm.model, data, q, v, torques + felt))
            q = q + step * v
    assert {each.kind for each in tracker.report.failures} == {kind}
    assert kind == "astray" or [each.joint for each in tracker.report.failures] == [arm.joint_names[0]]
