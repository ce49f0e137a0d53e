"""Degrees do not pass as radians: what cannot be meant is refused, what is outside the limits is said."""

from __future__ import annotations

import warnings
from dataclasses import replace

import numpy as np
import pytest
from arms import template_arm

import pinposture as pp
from pinposture.errors import InvalidValue

BENT = np.array([10.0, -25.0, 30.0, 15.0, -40.0, 20.0, 35.0, -5.0])  # degrees


@pytest.fixture(scope="module")
def arm() -> pp.Arm:
    """8 joints, each within +-pi."""
    return template_arm("RyRz", 4)


@pytest.fixture(scope="module")
def endless() -> pp.Arm:
    """8 joints without limits, each one number."""
    text = template_arm("RyRz", 4).urdf.replace('lower="-3.141592653589793" upper="3.141592653589793"', "")
    with pytest.warns(pp.PostureWarning, match="treated as unlimited"):
        return pp.Arm.load(text, split=2)


def ways_in(arm: pp.Arm, q: object) -> list:
    """Everything that takes a start or a goal."""
    goal = pp.Target.from_configuration(arm, arm.neutral())
    limits = pp.Limits(dt=0.1)
    tracker = pp.Tracker(arm, limits=limits)
    reference = pp.keyframe_reference(
        arm, [pp.Keyframe(pp.Curve.line((0, 0, 0), (0.2, 0, 0)), time=k) for k in range(2)], 0.1
    )
    return [
        lambda: pp.track(arm, goal, q, max_steps=1),
        lambda: pp.track_many(arm, goal, [arm.neutral(), q], max_steps=1),
        lambda: pp.track_many(arm, goal, q, max_steps=1),
        lambda: pp.perform(reference, q0=q, limits=limits, progress=lambda *_: True),
        lambda: pp.Target.from_configuration(arm, q),
        lambda: pp.track(arm, replace(goal, q=q), arm.neutral(), max_steps=1),
        lambda: tracker.restart(q),
    ]


@pytest.mark.parametrize("number", range(7))
def test_degrees_are_asked_after_and_the_same_in_radians_passes(arm: pp.Arm, number: int) -> None:
    with pytest.raises(InvalidValue, match=r"is it in degrees\? np\.deg2rad") as caught:
        ways_in(arm, BENT)[number]()
    assert "is -40.0; allowed: -3.142 to 3.142 rad, the limits of joint 'm03_j1_y'" in str(caught.value)
    with warnings.catch_warnings():
        warnings.simplefilter("error", pp.PostureWarning)
        ways_in(arm, np.deg2rad(BENT))[number]()


def test_a_tracker_holds_where_its_first_measurement_is_in_degrees(arm: pp.Arm) -> None:
    tracker = pp.Tracker(arm, limits=pp.Limits(dt=0.1))
    tracker.update(pp.Target.from_configuration(arm, np.zeros(8)))
    assert not np.any(tracker.step(BENT))
    assert tracker.report.status == "holding"
    assert "q_measured[4] is -40.0" in tracker.report.reason
    assert "is it in degrees?" in tracker.report.reason
    assert np.any(tracker.step(np.deg2rad(BENT)))
    assert tracker.report.status == "moving"


def test_small_angles_in_degrees_are_told_by_their_number(arm: pp.Arm) -> None:
    # None is outside by a turn, but five of eight are.
    with pytest.raises(InvalidValue, match=r"and 4 more joints are outside theirs; is it in degrees\?"):
        pp.Target.from_configuration(arm, [4.0, -5.0, 6.0, 5.0, -4.0, 1.0, 2.0, 0.0])


@pytest.mark.parametrize(
    ("beyond", "outcome"), [(1e-6, None), (1e-3, "warns"), (6.2, "warns"), (6.4, "raises")]
)
def test_one_joint_outside_is_said_and_refused_beyond_a_turn(arm: pp.Arm, beyond: float, outcome) -> None:
    q = np.zeros(8)
    q[5] = np.pi + beyond
    if outcome == "raises":
        with pytest.raises(InvalidValue, match=r"q\[5\] is 9\.5"):
            pp.Target.from_configuration(arm, q)
        return
    with warnings.catch_warnings(record=True) as told:
        warnings.simplefilter("always")
        pp.Target.from_configuration(arm, q)
    assert [each.category for each in told] == ([pp.PostureWarning] if outcome else [])
    assert all("a joint outside the limits; joint 'm03_j2_z' is at" in str(each.message) for each in told)


def test_joints_without_limits_may_be_wound_but_it_is_asked(endless: pp.Arm) -> None:
    with pytest.warns(pp.PostureWarning, match=r"5 joints without limits are wound .* is it in degrees\?"):
        pp.Target.from_configuration(endless, [30.0, 45.0, -90.0, 60.0, -30.0, 0.0, 1.0, 2.0])
    with warnings.catch_warnings():
        warnings.simplefilter("error", pp.PostureWarning)
        pp.Target.from_configuration(endless, [20.0] * 8)  # three turns


def test_a_slide_that_is_outside_is_said_in_metres() -> None:
    slide = pp.ModuleTemplate("Px", (pp.JointSpec("x", "prismatic", 0.0, 0.5),), (0.1,), 0.01)
    arm = pp.Arm.from_modules([slide, pp.template("RyRz")])
    with pytest.warns(pp.PostureWarning, match=r"'m01_j1_x' is at 20, allowed 0 to 0\.5 m"):
        pp.Target.from_configuration(arm, [20.0, 0.0, 0.0])


def test_a_velocity_above_that_of_the_description_is_reported_once() -> None:
    arm = pp.Arm.from_template("RyRz", modules=6)
    fastest = float(arm.limits.velocity[0])
    message = r"velocity .* above .* joint .* and 11 others; is it in degrees"
    with pytest.warns(pp.PostureWarning, match=message):
        pp.Limits(velocity=20.0 * fastest, dt=0.01).for_arm(arm)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        for velocity in (20.0 * fastest, fastest, np.inf):
            pp.Limits(velocity=velocity, dt=0.01).for_arm(arm)
        pp.Limits(dt=0.01).for_arm(arm)
