"""The tracker with drives that lag, stick, stop and sag, against a robot that shares no code with it."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator
from itertools import count, groupby, repeat
from typing import NamedTuple

import numpy as np
import pinocchio as pin
import pytest
from arms import template_arm

import pinposture as pp
from pinposture.motion import Tracker
from pinposture.motion.drive_response import DriveResponse
from pinposture.placement import Target
from pinposture.sim import DriveModel, Drives, Sensing, Sensors

DT = 0.01
LIMITS = pp.Limits(step=None, dt=DT, velocity=1.0, acceleration=4.0)
QUICK = DriveModel(lag=0.05, friction=0.0)
IDEAL = DriveModel(lag=0.001, friction=0.0, delay=0.0)


@pytest.fixture(scope="session")
def arm() -> pp.Arm:
    return template_arm("RyRz", 4)


class Log(NamedTuple):
    """Of each cycle: the statuses and reasons; commands, true and measured positions, (N, nv)."""

    statuses: list[str]
    reasons: list[str]
    sent: np.ndarray
    true: np.ndarray
    measured: np.ndarray


class Robot:
    """An arm with drives and encoders, and the tracker that moves it."""

    def __init__(self, arm: pp.Arm, model: DriveModel, sensing: Sensing | None = None, **options) -> None:
        self.arm = arm
        self.speeds = options.get("interface") == "velocity"
        self.tracker = Tracker(arm, limits=options.pop("limits", LIMITS), **options)
        self.drives = Drives(model, np.zeros(arm.nv), DT)
        self.sensors = Sensors(Sensing(noise=3e-4) if sensing is None else sensing)
        self.frozen = np.zeros(arm.nv, dtype=bool)
        self.seen = np.zeros(arm.nv)
        self.scenes: Iterator[pp.Scene | None] = repeat(None)

    def go(self, seconds: float) -> Log:
        rows = []
        for _ in range(round(seconds / DT)):
            self.seen = np.where(self.frozen, self.seen, self.sensors.measure(self.drives.positions))
            dq = self.tracker.step(self.seen, scene=next(self.scenes))
            report = self.tracker.report
            rows.append(
                (report.status, report.reason, self.tracker.positions, self.drives.positions, self.seen)
            )
            self.drives.advance(self.drives.positions + dq if self.speeds else self.tracker.positions)
        statuses, reasons, *arrays = zip(*rows, strict=True)
        return Log(list(statuses), list(reasons), *map(np.array, arrays))

    def off(self) -> float:
        """Mean distance of the true control points from their targets, in arm lengths."""
        points = self.arm.at(self.drives.positions).points
        return float(np.linalg.norm(points - self.tracker.target.points, axis=1).mean()) / self.arm.length


def aimed(arm: pp.Arm, model: DriveModel, sensing: Sensing | None = None, **options) -> Robot:
    robot = Robot(arm, model, sensing, **options)
    robot.tracker.update(Target.from_configuration(arm, np.full(arm.nv, 0.3)))
    return robot


@pytest.mark.long
@pytest.mark.parametrize("noise", [0.0, 1e-5, 3e-4, 1e-3])
@pytest.mark.parametrize("interface", ["position", "velocity"])
def test_with_noisy_encoders_the_arm_arrives_once_and_stays(
    arm: pp.Arm, noise: float, interface: str
) -> None:
    robot = aimed(arm, IDEAL, Sensing(noise=noise), interface=interface)
    statuses = robot.go(8.0).statuses
    first = statuses.index("converged")
    assert first < 500 and set(statuses[first:]) == {"converged"}
    assert robot.off() <= 1e-6 + 2.0 * noise


@pytest.mark.long
@pytest.mark.parametrize("model", [DriveModel(), DriveModel(friction=0.2), DriveModel(stiction=0.02)])
def test_friction_is_compensated_or_named_and_the_command_comes_to_rest(
    arm: pp.Arm, model: DriveModel
) -> None:
    robot = aimed(arm, model)
    log = robot.go(30.0)
    assert "holding" not in log.statuses
    assert robot.off() < 0.02
    last = robot.go(5.0)
    assert set(last.statuses) <= {"stalled", "converged", "moving"}
    assert np.ptp(last.sent, axis=0).max() < 0.06
    if robot.off() > 1e-3:
        assert robot.tracker.report.status != "converged"


@pytest.mark.long
def test_without_feedback_a_joint_that_stays_short_is_named(arm: pp.Arm) -> None:
    robot = aimed(arm, DriveModel(), feedback_time_constant=np.inf)
    log = robot.go(8.0)
    assert "converged" not in log.statuses and log.statuses[-1] == "stalled"
    assert "0.11 rad from its target" in log.reasons[-1]
    assert robot.off() > 0.05


@pytest.mark.long
def test_a_joint_whose_compensation_meets_a_limit_is_named(arm: pp.Arm) -> None:
    goal = np.full(arm.nv, 0.2)
    goal[0] = arm.limits.upper[0] - 0.01
    robot = Robot(arm, QUICK)
    robot.drives.sag[0] = -0.1
    robot.tracker.update(Target.from_configuration(arm, goal))
    log = robot.go(12.0)
    assert log.statuses[-1] == "stalled" and "converged" not in log.statuses
    assert f"joint {arm.joint_names[0]!r} stands 0.09" in log.reasons[-1]
    assert "limit of the joint, 3.14" in log.reasons[-1]
    other = aimed(arm, QUICK, max_tracking_error=0.05)
    other.drives.sag[2] = 0.08
    log = other.go(12.0)
    assert log.statuses[-1] == "stalled"
    assert f"joint {arm.joint_names[2]!r} stands 0.03" in log.reasons[-1]
    assert "max_tracking_error" in log.reasons[-1]


@pytest.mark.long
@pytest.mark.parametrize("model", [QUICK, IDEAL, DriveModel()])
@pytest.mark.parametrize("joints", [slice(None), slice(3, 4)])
def test_a_stopped_drive_is_held_where_it_stands_and_goes_on_without_a_jump(
    arm: pp.Arm, model: DriveModel, joints: slice
) -> None:
    robot = Robot(arm, model)
    robot.tracker.update(Target.from_configuration(arm, np.full(arm.nv, 1.0)))
    before = robot.go(0.6)
    robot.drives.running[joints] = False
    stopped = robot.go(4.0)
    robot.drives.running[:] = True
    after = robot.go(12.0)
    sent = np.concatenate([before.sent, stopped.sent, after.sent])
    assert np.abs(np.diff(sent, axis=0)).max() <= 1.0 * DT + 1e-9
    assert np.abs(np.diff(sent, 2, axis=0)).max() <= 4.0 * DT**2 + 1e-9
    assert set(stopped.statuses[150:]) == {"holding"}
    assert "does not follow its command" in stopped.reasons[-1]
    lead = np.abs(stopped.sent[-1] - stopped.true[-1])[joints]
    assert lead.max() <= model.friction + max(model.lag * 1.0, 0.03)  # it starts at its speed at most
    assert np.abs(np.diff(after.true, axis=0)).max() / DT <= 2.0
    assert after.statuses[-1] != "holding"
    assert robot.off() < 0.02


@pytest.mark.long
def test_a_frozen_encoder_does_not_drive_the_arm_on(arm: pp.Arm) -> None:
    robot = Robot(arm, QUICK)
    robot.tracker.update(Target.from_configuration(arm, np.full(arm.nv, 1.0)))
    robot.go(0.6)
    robot.frozen[:] = True
    begin = robot.drives.positions.copy()
    log = robot.go(20.0)
    assert set(log.statuses[150:]) == {"holding"}
    assert np.abs(robot.drives.positions - begin).max() < 0.06
    assert np.abs(log.true - begin).max() < 0.5


@pytest.mark.long
def test_drives_that_never_run_are_tried_from_time_to_time(arm: pp.Arm) -> None:
    robot = aimed(arm, QUICK)
    robot.drives.running[:] = False
    statuses = Counter(robot.go(6.0).statuses)
    assert statuses["holding"] > 300
    robot.drives.running[:] = True
    assert robot.go(12.0).statuses[-1] == "converged"


@pytest.mark.long
def test_readings_that_are_repeated_and_late_are_enough(arm: pp.Arm) -> None:
    robot = aimed(arm, DriveModel(lag=0.1, friction=0.0, delay=0.14), Sensing(noise=3e-4, period=5))
    log = robot.go(15.0)
    assert "holding" not in log.statuses and log.statuses[-1] == "converged"
    assert robot.off() < 1e-3


@pytest.mark.long
@pytest.mark.parametrize("friction", [0.11, 0.2])
def test_a_moving_target_is_followed_in_spite_of_friction_without_holding(
    arm: pp.Arm, friction: float
) -> None:
    robot = Robot(arm, DriveModel(friction=friction))
    statuses = []
    for cycle in range(2000):
        wanted = 0.5 * np.sin(0.62 * DT * cycle)  # at most 0.31 rad/s
        robot.tracker.update(Target.from_configuration(arm, np.full(arm.nv, wanted)))
        statuses += robot.go(DT).statuses
    assert statuses.count("holding") == 0


def test_an_arm_that_sags_at_first_and_never_rests_is_compensated(arm: pp.Arm) -> None:
    tracker = Tracker(arm, limits=LIMITS)
    measured = np.zeros(arm.nv)
    for cycle in range(300):
        wanted = 0.5 * np.sin(DT * cycle) * np.ones(arm.nv)
        tracker.update(Target.from_configuration(arm, wanted))
        tracker.step(measured)
        measured = tracker.positions - 0.05  # the first motion is against the command
    assert np.abs(measured - wanted).max() < 0.01


def tip_of(arm: pp.Arm, q: np.ndarray) -> pin.SE3:
    """The placement of the last control point, from Pinocchio alone."""
    data = arm.model.createData()
    pin.framesForwardKinematics(arm.model, data, q)
    return data.oMf[arm.model.getFrameId(arm.control_points[-1])].copy()


@pytest.mark.long
@pytest.mark.parametrize(
    ("priority", "noise", "scene", "cycles", "most"),
    [
        (False, 0.0, None, 1100, 2e-5),
        (False, 3e-4, pp.Scene(), 700, 1e-3),
        pytest.param(True, 3e-4, pp.Scene(), 950, 1e-3, marks=pytest.mark.soak),  # without noise: below
    ],
)
def test_the_measured_tip_takes_its_task_in_spite_of_sag_that_changes(
    arm: pp.Arm, priority: bool, noise: float, scene: pp.Scene | None, cycles: int, most: float
) -> None:
    rng = np.random.default_rng(0)
    goal = rng.uniform(-0.4, 0.4, arm.nv)
    wanted = tip_of(arm, goal)
    controller = pp.Geodesic(tasks=(pp.EndEffector(pose=wanted, priority=priority),))
    tracker = Tracker(arm, controller, LIMITS, scene)
    tracker.update(Target.from_configuration(arm, goal))
    q = np.zeros(arm.nv)
    off = []
    for sag in (0.03 * rng.normal(size=arm.nv), 0.03 * rng.normal(size=arm.nv)):
        statuses = []
        for _ in range(cycles):
            tracker.step(q + noise * rng.normal(size=arm.nv))
            statuses.append(tracker.report.status)
            q = q + 0.2 * (tracker.command + sag - q)
        assert set(statuses[-100:]) == {"converged"}
        error = pin.log6(wanted.actInv(tip_of(arm, q))).vector
        off.append(max(np.linalg.norm(error[:3]) / arm.length, np.linalg.norm(error[3:])))
    assert max(off) < most


@pytest.mark.soak
def test_a_sagging_arm_with_a_task_comes_to_rest_and_does_not_stay_stalled() -> None:
    arm = template_arm("RyRz", 6)
    rng = np.random.default_rng(2)
    goal = rng.uniform(-0.4, 0.4, arm.nv)
    wanted = tip_of(arm, goal)
    controller = pp.Geodesic(tasks=(pp.EndEffector(pose=wanted, priority=True),))
    tracker = Tracker(arm, controller, LIMITS, pp.Scene())
    tracker.update(Target.from_configuration(arm, goal))
    sag = 0.03 * rng.normal(size=arm.nv)
    q = np.zeros(arm.nv)
    statuses = []
    for _ in range(1700):
        tracker.step(q)
        statuses.append(tracker.report.status)
        q = q + 0.2 * (tracker.command + sag - q)
    # Before the sag is known, the command is at its goal but for rounding: no step reduces that further.
    stalls = [len(list(each)) for status, each in groupby(statuses) if status == "stalled"]
    assert max(stalls, default=0) <= 20
    assert set(statuses[-100:]) == {"converged"}
    error = pin.log6(wanted.actInv(tip_of(arm, q))).vector
    assert np.abs(error).max() < 2e-6  # the estimated noise of the average is 8e-7 rad


def test_an_arm_that_only_falls_does_not_follow(arm: pp.Arm) -> None:
    response = DriveResponse(arm, 0.225, positions_sent=True)
    for cycle in range(300):
        sent = np.full(arm.nv, 1e-3 * cycle)
        response.update(-0.05 * (DT * cycle) ** 2 * np.ones(arm.nv), sent, sent, DT)
    assert not response.followed


@pytest.mark.long
def test_a_measured_arm_that_sags_into_an_obstacle_is_reported() -> None:
    arm = template_arm("RyRz", 10)
    beam = pp.Box((0.35, 0.0, -0.06), (0.05, 0.4, 0.06))
    scene = pp.Scene({"beam": beam}, margin=0.01, self_collision=False)
    limits = pp.Limits(step=None, dt=DT, velocity=1.0, acceleration=5.0)
    tracker = Tracker(arm, limits=limits, scene=scene)
    goal = arm.straight()
    goal[3] = 0.2
    tracker.update(Target.from_configuration(arm, goal))
    model = pp.CollisionModel(arm, scene)
    q = arm.straight()
    lost = 0
    for cycle in range(200):
        tracker.step(q)
        distance = model.minimum(q).distance
        named = [text for text in tracker.report.violated_constraints if text.startswith("margin")]
        if distance < 0.0099:
            lost += 1
            assert any("beam" in text for text in named)
        elif distance > 0.0101:
            assert not named
        sag = np.zeros(arm.nv)
        sag[0] = 0.1 * min(cycle / 50, 1) + (0.1 if cycle > 100 else 0.0)
        q = tracker.command + sag
    assert lost > 10


BALL = np.array([0.3, 0.0, -0.1])
BALL_RADIUS = 0.07
LINK_RADIUS = 0.008
MARGIN = 0.01


def distance_to_ball(arm: pp.Arm, q: np.ndarray) -> float:
    """Distance of the round links from the ball, by the closest points of the segments between joints."""
    data = arm.model.createData()
    pin.forwardKinematics(arm.model, data, q)
    ends = [data.oMi[joint].translation for joint in range(1, arm.model.njoints)]
    ends = np.array([*ends, arm.at(q).points[-1]])
    along = np.diff(ends, axis=0)
    lengths = np.maximum((along**2).sum(axis=1), 1e-12)
    shares = np.clip(((BALL - ends[:-1]) * along).sum(axis=1) / lengths, 0.0, 1.0)
    apart = np.linalg.norm(ends[:-1] + shares[:, None] * along - BALL, axis=1)
    return float(apart.min()) - BALL_RADIUS - LINK_RADIUS


@pytest.mark.long
@pytest.mark.parametrize(
    ("aims", "lag", "noise", "jerk", "time_constant"),
    [
        (False, 0.05, 0.0, None, 0.25),
        pytest.param(True, 0.05, 0.0, None, np.inf, marks=pytest.mark.soak),
        pytest.param(False, 0.05, 3e-4, None, 0.25, marks=pytest.mark.soak),
        pytest.param(False, 0.3, 0.0, None, 1.2, marks=pytest.mark.soak),
        pytest.param(False, 0.05, 0.0, 100.0, 0.25, marks=pytest.mark.soak),
        pytest.param(True, 0.05, 3e-4, None, np.inf, marks=pytest.mark.soak),
        pytest.param(True, 0.05, 0.0, 100.0, np.inf, marks=pytest.mark.soak),
    ],
)
def test_the_command_moves_a_sagging_arm_back_to_its_margin_and_rests(
    aims: bool, lag: float, noise: float, jerk: float | None, time_constant: float
) -> None:
    arm = template_arm("RyRz", 6)
    ball = pp.Sphere(BALL, BALL_RADIUS)
    scene = pp.Scene({"ball": ball}, margin=MARGIN, self_collision=False, arm_radius=LINK_RADIUS)
    limits = pp.Limits(step=None, dt=DT, velocity=1.0, acceleration=5.0, jerk=jerk)
    model = DriveModel(lag=lag, friction=0.0)
    options = {"limits": limits, "scene": scene, "feedback_time_constant": time_constant}
    robot = Robot(arm, model, Sensing(noise=noise), **options)
    if aims:
        robot.tracker.update(Target.from_configuration(arm, arm.straight()))
    robot.drives.sag[0] = 0.15
    logs = [robot.go(3.0 if time_constant < 0.5 else 12.0), robot.go(1.0)]
    sent = np.vstack([log.sent for log in logs])
    assert distance_to_ball(arm, arm.configuration(logs[0].true[20])) < 0.9 * MARGIN
    assert min(distance_to_ball(arm, arm.configuration(q)) for q in logs[1].true[::5]) > 0.99 * MARGIN
    assert min(distance_to_ball(arm, arm.configuration(q)) for q in sent[::5]) > 0.99 * MARGIN
    assert np.ptp(logs[1].sent, axis=0).max() < 0.02
    speeds = np.diff(sent, axis=0) / DT
    assert np.abs(speeds).max() <= 1.0 + 1e-9 and np.abs(np.diff(speeds, axis=0)).max() / DT <= 5.0 + 1e-6
    assert "evading" in logs[0].statuses or aims
    assert "converged" not in logs[1].statuses


@pytest.mark.soak
def test_an_arm_that_cannot_leave_an_obstacle_stands_and_says_so() -> None:
    arm = template_arm("RyRz", 6)
    slab = pp.Box((0.3, 0.0, -0.06), (0.3, 2.0, 0.08))
    low = pp.Box((0.3, 0.0, 0.06), (0.3, 2.0, 0.08))
    scene = pp.Scene({"slab": slab, "low": low}, margin=0.01, self_collision=False, arm_radius=0.008)
    robot = Robot(arm, QUICK, Sensing(noise=0.0), limits=LIMITS, scene=scene, feedback_time_constant=np.inf)
    robot.tracker.update(Target.from_configuration(arm, arm.straight()))
    robot.drives.sag[0] = 0.15
    robot.go(4.0)
    last = robot.go(1.0)
    assert set(last.statuses) <= {"stalled", "holding"}
    assert np.ptp(last.sent, axis=0).max() < 1e-3
    assert any("overlap" in text for text in robot.tracker.report.violated_constraints)


@pytest.mark.soak
@pytest.mark.parametrize(
    ("modules", "place", "noise", "lag", "time_constant", "jitter"),
    [
        (10, 0.5, 0.0, 0.05, 0.25, 0.0),
        (6, 0.27, 3e-4, 0.05, 0.25, 0.0),
        (6, 0.27, 0.0, 0.2, 0.8, 0.0),
        (10, 0.5, 0.0, 0.05, 0.25, 1e-5),
    ],
)
def test_an_arm_that_sags_in_a_narrow_gap_comes_to_rest_and_tries_again_without_the_sag(
    modules: int, place: float, noise: float, lag: float, time_constant: float, jitter: float
) -> None:
    arm = template_arm("RyRz", modules)
    height = LINK_RADIUS + BALL_RADIUS + MARGIN + 0.002
    low = pp.Sphere((place, 0.0, -height), BALL_RADIUS)
    high = pp.Sphere((place + 0.02, 0.0, height), BALL_RADIUS)
    scene = pp.Scene({"low": low, "high": high}, margin=MARGIN, self_collision=False, arm_radius=LINK_RADIUS)
    limits = pp.Limits(step=None, dt=DT, velocity=1.0, acceleration=5.0)
    robot = Robot(
        arm,
        DriveModel(lag=lag, friction=0.0),
        Sensing(noise=noise),
        limits=limits,
        scene=scene,
        feedback_time_constant=time_constant,
        max_tracking_error=1.0,
    )
    robot.tracker.update(Target.from_configuration(arm, arm.straight()))
    for share in np.linspace(0.01, 1.0, 100):
        robot.drives.sag[0] = 0.03 * share
        robot.go(DT)
    if jitter:
        rng = np.random.default_rng(0)
        robot.scenes = (scene.moved({"low": rng.normal(0.0, jitter, 3)}) for _ in count())
    robot.go(11.0 if time_constant < 0.5 else 17.0)
    last = robot.go(2.0)
    assert np.abs(np.diff(last.sent, axis=0)).sum() < 1e-4
    assert set(last.statuses) == {"stalled"}
    assert all("low" in reason or "high" in reason for reason in last.reasons)
    model = pp.CollisionModel(arm, scene)
    assert model.minimum(arm.configuration(last.true[-1])).distance > MARGIN - 3e-4
    robot.drives.sag[0] = 0.0
    assert "moving" in robot.go(1.0).statuses


# Drives that are known.


@pytest.mark.long
def test_known_drives_are_led_so_that_the_arm_is_where_the_motion_is() -> None:
    arm = template_arm("RyRz", 1)
    errors = {}
    wrong = DriveModel(lag=0.26, friction=0.09)
    for name, told in {"unknown": None, "known": DriveModel(), "wrong": wrong}.items():
        robot = Robot(arm, DriveModel(), drives=told)
        off = []
        for cycle in range(600):
            phase = 2.0 * np.pi * 0.3 * DT * (cycle + 1)
            goal = np.full(arm.nv, 0.4 * np.sin(phase))
            velocity = np.full(arm.nv, 0.4 * 2.0 * np.pi * 0.3 * np.cos(phase))
            target = Target.from_configuration(arm, arm.configuration(goal))
            robot.tracker.update(target, velocity=velocity)
            robot.go(DT)
            off.append(np.abs(robot.drives.positions - goal).max())
        errors[name] = np.mean(off[300:])
    assert errors["known"] < 0.01 < 0.1 < errors["unknown"]
    assert errors["wrong"] < 0.04


@pytest.mark.long
def test_an_arm_with_known_drives_comes_to_rest_at_its_target() -> None:
    arm = template_arm("RyRz", 1)
    log = aimed(arm, DriveModel(), drives=DriveModel()).go(8.0)
    assert log.statuses[-1] == "converged"
    assert np.abs(log.true[-1] - 0.3).max() < 2e-3
    wrong = aimed(arm, DriveModel(), drives=DriveModel(lag=0.26, friction=0.09)).go(8.0)
    assert wrong.statuses[-1] in ("converged", "stalled")  # as without the model
    assert np.abs(wrong.true[-1] - 0.3).max() < 5e-3


@pytest.mark.long
def test_a_stopped_joint_of_known_drives_is_noticed_sooner_and_disturbances_are_not(arm: pp.Arm) -> None:
    model = DriveModel(lag=0.2, friction=0.03, stiction=0.01, delay=0.02, error=0.008)
    noticed = {}
    for told in (None, model):
        robot = aimed(arm, model, drives=told)
        rng = np.random.default_rng(3)
        statuses = []
        for cycle in range(600):  # a slow disturbance of 8 mrad, and a joint that stops while it moves
            change = 0.008 * np.sqrt(0.01) * rng.standard_normal(arm.nv)
            robot.drives.sag = (1.0 - 0.005) * robot.drives.sag + change
            if cycle == 500:
                robot.tracker.update(Target.from_configuration(arm, np.full(arm.nv, -0.3)))
            robot.drives.running[3] = cycle < 520
            statuses += robot.go(DT).statuses
        assert "holding" not in statuses[:520]
        noticed[told] = statuses.index("holding") - 520
        assert "joint 'm02_j2_z'" in robot.tracker.report.reason
    assert noticed[model] < 0.6 * noticed[None]


def test_a_model_tells_how_far_drives_may_be_off() -> None:
    model = DriveModel(lag=0.2, friction=0.03, stiction=0.01, delay=0.02, error=0.005)
    assert model.starting_lead == pytest.approx(0.04)
    assert model.tracking_error == pytest.approx(0.06)


def test_the_lead_ends_at_position_limits_and_is_for_positions_alone() -> None:
    arm = template_arm("RyRz", 1)
    tracker = Tracker(arm, limits=LIMITS, drives=DriveModel(friction=0.5))
    most = arm.limits.upper - 0.01
    tracker.update(Target.from_configuration(arm, arm.configuration(arm.limits.upper)))
    for _ in range(20):
        tracker.step(arm.configuration(most))
        assert np.all(tracker.positions <= arm.limits.upper + 1e-12)
        np.testing.assert_allclose(arm.positions(tracker.command), tracker.positions)
    with pytest.raises(pp.PostureError, match=r"drives is .*None for drives that are sent velocities"):
        Tracker(arm, limits=LIMITS, drives=DriveModel(), interface="velocity")
    with pytest.raises(pp.PostureError, match="a DriveModel, or None"):
        Tracker(arm, limits=LIMITS, drives="slow")


def test_a_joint_that_sticks_or_falls_is_named_with_its_position_until_it_follows_again(arm: pp.Arm) -> None:
    robot = Robot(arm, IDEAL)
    joint = arm.nv // 2
    robot.tracker.update(Target.from_configuration(arm, np.full(arm.nv, 1.0)))
    robot.go(0.4)
    assert robot.tracker.report.failures == ()
    robot.drives.running[joint] = False
    robot.go(0.8)
    (failure,) = robot.tracker.report.failures
    assert (failure.joint, failure.kind) == (arm.joint_names[joint], "stuck")
    assert failure.position == pytest.approx(robot.drives.positions[joint], abs=2e-3)
    assert 0.1 < failure.duration < 0.8
    locked = arm.with_locked({failure.joint: failure.position})
    assert locked.limits.upper[joint] == failure.position
    robot.drives.running[joint] = True
    robot.go(0.5)
    assert robot.tracker.report.failures == ()
    robot.drives.sag[joint] = -0.6  # it falls by as much
    robot.go(0.1)
    (failure,) = robot.tracker.report.failures
    assert (failure.joint, failure.kind) == (arm.joint_names[joint], "astray")
    assert str(failure).startswith(f"{failure.joint} is astray at ")
