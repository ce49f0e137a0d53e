"""The tracker with a robot that is told, and tells, the positions of the joints that its drives move."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
import pytest
from arm.driven_arms import DRIVES, Robot, driven_arm

import pinposture as pp
from pinposture.errors import InvalidValue, PostureWarning
from pinposture.motion import Tracker
from pinposture.placement import Target

DT = 0.02
LIMITS = pp.Limits(step=None, dt=DT, velocity=1.0, acceleration=5.0)
SPEEDS = np.array([0.5, 0.25, 1.0, 2.0, 1.0])
"""Largest speeds of the drives where every degree of freedom moves at 1: 1 / 2, 1 / 4, 1, 1 / 0.5, 1."""

START = {"c": 0.1, "d": -0.02, "turn": 2.9 + 4.0 * np.pi, "motor": 0.2, "h": 0.0}
GOAL = {"c": -0.2, "d": 0.05, "turn": -2.9, "motor": -0.3, "h": 0.4}


@pytest.fixture(scope="module")
def arm() -> pp.Arm:
    with pytest.warns(PostureWarning, match="locked"):
        return driven_arm()


def aim(arm: pp.Arm, driven: dict[str, float]) -> Target:
    positions = arm.drives.joint_positions(Robot(driven).states())
    return Target.from_configuration(arm, arm.configuration(positions))


@pytest.mark.parametrize("interface", ["position", "velocity"])
def test_a_robot_that_speaks_by_name_comes_to_the_target(arm: pp.Arm, interface: str) -> None:
    robot = Robot(START)
    tracker = Tracker(arm, limits=LIMITS, interface=interface)
    tracker.update(aim(arm, GOAL))
    sent = [list(START.values())]
    for _ in range(200):
        dq = tracker.step(robot.states())
        if interface == "velocity":
            speeds = arm.drives.velocities(dq) / DT
            moved = {
                name: robot.driven[name] + DT * speed for name, speed in zip(DRIVES, speeds, strict=True)
            }
        else:
            moved = arm.drives.named(tracker.positions)
        robot.driven = moved
        sent.append(list(moved.values()))
    assert tracker.report.status == "converged", tracker.report
    np.testing.assert_allclose(robot.tip(), Robot(GOAL).tip(), atol=1e-6)
    expected = GOAL | {"turn": 6.0 * np.pi - 2.9}  # the shorter way, from the turns that were measured
    np.testing.assert_allclose(sent[-1], list(expected.values()), atol=1e-5)
    speeds = np.abs(np.diff(sent, axis=0)).max(axis=0) / DT
    assert np.all(speeds <= SPEEDS * (1.0 + 1e-9)), speeds
    np.testing.assert_allclose(tracker.positions, sent[-1], atol=1e-9)


def test_what_is_sent_is_what_an_exported_motion_says(arm: pp.Arm) -> None:
    tracker = Tracker(arm, limits=LIMITS)
    tracker.update(aim(arm, GOAL))
    q = arm.configuration(arm.drives.joint_positions(START | {"turn": 2.9}))
    path = [q]
    sent = []
    for _ in range(100):
        tracker.step(path[-1])
        path.append(tracker.command)
        sent.append(tracker.positions)
    exported = pp.JointTrajectory.from_configurations(arm, path[1:], DT)
    assert exported.joint_names == arm.drives.names
    np.testing.assert_allclose(sent, exported.positions, atol=1e-9)
    turned = exported.starting_at(arm, START)
    assert turned.positions[0, 2] == pytest.approx(exported.positions[0, 2] + 4.0 * np.pi)
    np.testing.assert_array_equal(turned.positions, exported.starting_at(arm, list(START.values())).positions)


def test_a_measurement_that_lacks_a_joint_is_none_and_names_it(arm: pp.Arm) -> None:
    tracker = Tracker(arm, limits=LIMITS)
    tracker.update(aim(arm, GOAL))
    robot = Robot(START)
    with pytest.raises(InvalidValue, match="missing: 'motor'"):
        tracker.restart({name: value for name, value in START.items() if name != "motor"})
    for _ in range(5):
        tracker.step(robot.states())
        robot.driven = arm.drives.named(tracker.positions)
    before = tracker.positions
    for change, words in (
        ({"motor": float("nan")}, "position of joint 'motor' is nan"),
        ({"motor": "far"}, "position of joint 'motor' is 'far'"),
        (None, "missing: 'motor'"),
    ):
        states = {name: value for name, value in robot.states().items() if name not in ("f", "motor")}
        for _ in range(50):
            tracker.step(states | (change or {}))
        assert tracker.report.status == "holding" and words in tracker.report.reason
    assert np.abs(tracker.positions - before).max() < 0.2  # it brakes
    robot.driven = arm.drives.named(tracker.positions)
    tracker.step(robot.states())
    assert tracker.report.status == "moving"


def test_a_drive_that_stops_or_jumps_is_named_with_its_own_position(arm: pp.Arm) -> None:
    tracker = Tracker(arm, limits=LIMITS, resync_time=0.3)
    tracker.update(aim(arm, GOAL))
    robot = Robot(START)
    for _ in range(60):
        tracker.step(robot.states())
        robot.driven = arm.drives.named(tracker.positions) | {"motor": 0.2}
    reason = tracker.report.reason
    assert tracker.report.status == "holding"
    assert "joint 'motor' does not follow its command: it stands at 0.2 rad" in reason, reason
    tracker.restart(robot.states())
    robot.driven = robot.driven | {"c": robot.driven["c"] + 0.5}  # its leader in the arm moves by 1 rad
    tracker.step(robot.states())
    assert "joint 'c' is 0.5 rad from its expected position" in tracker.report.reason


def late(rng: np.random.Generator) -> Iterator[float]:
    while True:
        yield DT * float(rng.choice([1.0, 1.0, 1.0, 0.3, 2.5]))


@pytest.mark.parametrize("seed", range(4))
def test_jumps_late_cycles_and_displaced_drives_leave_no_jump_in_what_is_sent(arm: pp.Arm, seed: int) -> None:
    """The drives keep limits that are those of the degrees of freedom times their ratios."""
    rng = np.random.default_rng(seed)
    robot = Robot(START)
    tracker = Tracker(arm, limits=LIMITS, resync_time=0.2)
    times = late(rng)
    tracker.step(robot.states())
    before = tracker.positions
    resynced = 0
    for cycle in range(400):
        if cycle % 80 == 0:
            draw = dict(
                zip(DRIVES, rng.uniform(-0.25, 0.25, 5) + [0, 0, 9.0 * rng.normal(), 0, 0], strict=True)
            )
            tracker.update(aim(arm, draw))
        if cycle == 200:  # somebody turns it by hand, by whole turns
            robot.driven = robot.driven | {"turn": robot.driven["turn"] - 2.0 * np.pi, "h": -0.5}
            stopped = dict(robot.driven)
        held = 200 <= cycle < 240
        tracker.step(robot.states() if rng.random() > 0.1 else None, next(times))
        sent = tracker.positions
        if held and np.abs(sent - before).max() > 0.1:  # it accepts where the arm is
            np.testing.assert_allclose(sent, list(stopped.values()), atol=0.1)
            resynced += 1
        else:
            assert np.all(np.abs(sent - before) <= SPEEDS * DT * (1.0 + 1e-9))
        before = sent
        robot.driven = stopped if held else arm.drives.named(sent)
    assert resynced == 1
    assert tracker.report.status in ("converged", "moving")
