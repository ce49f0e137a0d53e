"""Joints that fall are told from those that were pushed, and what is left of a drive from where it rests."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
import pytest

import pinposture as pp
from pinposture.motion import JointFailure
from pinposture.task.falling import FailureWatch, take_fallen

NAME = "m01_j1_y"
ASTRAY = JointFailure(NAME, "astray", 0.5, 0.1)


@pytest.fixture(scope="module")
def arm() -> pp.Arm:
    return pp.Arm.from_template("RyRz", modules=3)


@pytest.fixture
def watch(arm: pp.Arm) -> FailureWatch:
    watch = FailureWatch(arm)
    watch.update([ASTRAY], arm.neutral(), at(arm, 0.5))
    return watch


def at(arm: pp.Arm, position: float) -> np.ndarray:
    """Return a configuration with the first joint somewhere, and the others at zero."""
    q = arm.neutral()
    q[0] = position
    return q


def ramp(end: float) -> Iterator[float]:
    yield from np.linspace(0.0, end, 20).tolist()


def test_a_joint_that_was_astray_has_fallen_until_it_follows_its_command(
    arm: pp.Arm, watch: FailureWatch
) -> None:
    for way in ramp(0.09):
        watch.update([], at(arm, 0.5 + way), at(arm, 0.5 + way))
    assert watch.astray == {NAME: ASTRAY}
    watch.update([], at(arm, 0.5 - 0.11), at(arm, 0.5 - 0.1))
    assert watch.astray == {}


def test_a_joint_that_stands_or_moves_as_it_likes_has_not_followed(arm: pp.Arm, watch: FailureWatch) -> None:
    for way in ramp(1.0):
        watch.update([], at(arm, 0.5 + way), at(arm, 0.5 + 0.4 * way))
        watch.update([], at(arm, 0.5), at(arm, 0.5 - way))
    assert watch.astray == {NAME: ASTRAY}
    # Where it fails again, what it did before does not count.
    watch.update([ASTRAY._replace(kind="stuck")], at(arm, 0.8), at(arm, 0.5))
    watch.update([], at(arm, 0.5), at(arm, 0.5))
    watch.update([], at(arm, 0.55), at(arm, 0.55))
    assert watch.astray == {NAME: ASTRAY}


def test_a_stuck_joint_was_not_astray_and_the_last_that_was_comes_last(
    arm: pp.Arm, watch: FailureWatch
) -> None:
    others = [ASTRAY._replace(joint="m02_j1_y"), ASTRAY._replace(joint="m03_j1_y", kind="stuck")]
    watch.update(others, arm.neutral(), arm.neutral())
    watch.update([ASTRAY], arm.neutral(), arm.neutral())
    assert list(watch.astray) == ["m02_j1_y", NAME]
    watch.forget("m02_j1_y")
    assert list(watch.astray) == [NAME]


def test_an_arm_has_come_to_rest_after_half_a_second_in_one_place(arm: pp.Arm) -> None:
    watch = FailureWatch(arm)
    assert not watch.stands(at(arm, 0.0), 1.0)
    assert not watch.stands(at(arm, 0.03), 1.4)
    assert not watch.stands(at(arm, 0.02), 1.6)
    assert watch.stands(at(arm, 0.03), 1.9)
    assert not watch.stands(at(arm, 0.03), 0.5)  # the clock jumped back
    assert watch.stands(at(arm, 0.03), 1.0)


@pytest.mark.parametrize("turns", [0, 1])
def test_a_tracker_goes_on_from_where_the_joint_fell_and_no_other_joint_moves(turns: int) -> None:
    """Others are commanded above where they sag to; continuous ones keep their full turns."""
    joints = (pp.JointSpec("y", lower=-2.0, upper=2.0), pp.JointSpec("z", type="continuous"))
    arm = pp.Arm.from_modules([pp.ModuleTemplate("m", joints, (0.05, 0.05))] * 3)
    names = arm.drives.names
    sent = np.array([0.1, 0.2 + 2.0 * np.pi * turns, 0.2, 0.1, -0.1, 0.3])
    tracker = pp.Tracker(arm, limits=pp.Limits(dt=0.02))
    tracker.step(dict(zip(names, sent.tolist(), strict=True)))
    fallen_to = 0.9
    measured = arm.positions(arm.configuration(sent)) + 0.01
    measured[2] = fallen_to
    fallen = take_fallen(tracker, names[2], arm.configuration(measured))
    expected = sent.copy()
    expected[2] = arm.positions(fallen.q)[2]
    tracker.step(dict(zip(names, expected.tolist(), strict=True)))
    np.testing.assert_allclose(tracker.positions, expected, atol=1e-9)
    state = arm.at(fallen.q)
    assert fallen.joint == names[2]
    assert fallen.kind == "weak"
    assert fallen.torque == pytest.approx(abs(state.gravity_torques[2]))
    assert expected[2] == pytest.approx(fallen_to)
