"""Holds against closed forms: a ball on a link, a ball between two jaws, and a can in a ring of links."""

from __future__ import annotations

import math

import numpy as np
import pytest

import pinposture as pp
from pinposture.errors import InvalidValue, UnknownName, WeightUnknown

RADIUS = 0.01


def test_a_ball_on_a_level_link_is_held_up_to_the_torque_of_the_joint():
    arm = pp.Arm.from_modules([pp.ModuleTemplate("Bar", [pp.JointSpec("y")], [0.3])]).with_effort(2.0)
    lever = 0.7 * arm.length
    ball = pp.Sphere((lever, 0.0, RADIUS + 0.03), 0.03)
    scene = pp.Scene({"ball": ball}, arm_radius=RADIUS, self_collision=False)
    hold = pp.assess_hold(arm, arm.straight(), scene, "ball", friction=0.5)
    expected = (2.0 - abs(arm.at(arm.straight()).gravity_torques[0])) / (9.81 * lever)
    assert hold.mass == pytest.approx(expected, rel=1e-6)
    assert not hold.closed
    np.testing.assert_allclose(hold.normals, [[0, 0, 1]], atol=1e-9)
    np.testing.assert_allclose(hold.points, [[lever, 0, RADIUS]], atol=1e-9)


def level(count: int) -> pp.Arm:
    """Links that turn in the level plane."""
    return pp.Arm.from_modules([pp.ModuleTemplate("Level", [pp.JointSpec("z")], [0.2])] * count)


@pytest.mark.parametrize("friction", [0.2, 0.8])
def test_two_jaws_hold_twice_the_friction_of_their_squeeze(friction):
    effort = 0.5
    arm = level(3).with_effort(effort)
    q = np.array([0.0, 0.5 * math.pi, 0.5 * math.pi])
    # Link 1 lies at y = 0, link 3 at y = 0.2; the ball fills the space between them, 0.15 from the elbow.
    ball = pp.Sphere((0.05, 0.1, 0.0), 0.1 - RADIUS)
    scene = pp.Scene({"ball": ball}, arm_radius=RADIUS, self_collision=False)
    hold = pp.assess_hold(arm, q, scene, "ball", friction=friction)
    squeeze = effort / 0.15
    assert hold.mass == pytest.approx(2.0 * friction * squeeze / 9.81, rel=1e-6)
    assert not hold.closed  # it can turn about the line through both points
    assert len(hold.points) == 2


def ring(friction: float, effort: float | None = None) -> pp.Hold:
    """A chain of level links that touch an upright can on four sides."""
    arm = level(4) if effort is None else level(4).with_effort(effort)
    q = np.array([0.0, 0.5 * math.pi, 0.5 * math.pi, 0.5 * math.pi])
    ball = pp.Sphere((0.1, 0.1, 0.0), 0.1 - RADIUS)
    return pp.assess_hold(arm, q, pp.Scene({"ball": ball}, arm_radius=RADIUS), "ball", friction=friction)


def test_four_sides_hold_a_ball_against_everything_if_there_is_friction():
    assert ring(0.5).closed
    assert ring(0.5).mass == math.inf
    assert not ring(0.0).closed
    assert ring(0.0).mass == 0.0
    assert 0.0 < ring(0.5, 0.3).mass < ring(0.5, 0.6).mass < math.inf
    assert ring(0.5, 0.6).mass == pytest.approx(2.0 * ring(0.5, 0.3).mass, rel=1e-6)  # level: no own weight


def test_what_is_not_touched_is_not_held():
    arm = level(3)
    scene = pp.Scene({"ball": pp.Sphere((0, 2, 0), 0.1), "floor": pp.HalfSpace((0, 0, -1), (0, 0, 1))})
    hold = pp.assess_hold(arm, arm.straight(), scene, "ball")
    assert (hold.mass, hold.closed, hold.bodies) == (0.0, False, ())
    with pytest.raises(UnknownName):
        pp.assess_hold(arm, arm.straight(), scene, "can")
    with pytest.raises(InvalidValue, match="floor"):
        pp.assess_hold(arm, arm.straight(), scene, "floor")


def hinged(count: int) -> pp.Arm:
    """Level bars that turn up and down."""
    bar = pp.ModuleTemplate("Bar", [pp.JointSpec("y")], [0.3])
    return pp.Arm.from_modules([bar] * count).with_effort(2.0)


def beside(x: float, side: float, **options) -> pp.Scene:
    """A ball under the arm, or above it, which it touches."""
    ball = pp.Sphere((x, 0.0, side * (RADIUS + 0.03)), 0.03)
    return pp.Scene({"ball": ball}, arm_radius=RADIUS, self_collision=False, **options)


def test_a_support_relieves_a_joint_of_all_its_torque():
    arm = hinged(1)
    support = pp.assess_support(arm, arm.straight(), beside(0.2, -1.0, touchable=["ball"]), friction=0.0)
    needed = abs(arm.at(arm.straight()).gravity_torques[0])
    assert support.alone == pytest.approx(needed / 2.0, rel=1e-9)
    assert support.share == pytest.approx(0.0, abs=1e-9)
    assert support.torques == pytest.approx([0.0], abs=1e-9)
    np.testing.assert_allclose(support.normals, [[0, 0, -1]], atol=1e-9)
    assert [other for _, other in support.pairs] == ["ball"]


@pytest.mark.parametrize("x", [0.2, 0.4, 0.55])
def test_the_best_force_of_a_support_is_that_of_an_enumeration(x):
    arm = hinged(2)
    support = pp.assess_support(arm, arm.straight(), beside(x, -1.0, touchable=["ball"]), friction=0.0)
    needed = np.array(arm.at(arm.straight()).gravity_torques)
    levers = np.array([x, max(x - 0.3, 0.0)])  # from each joint to the force; beyond the joint it has none
    forces = np.linspace(0.0, 20.0, 200_001)
    left = np.abs(np.abs(needed) - forces[:, None] * levers).max(axis=1) / 2.0
    assert support.share == pytest.approx(left.min(), abs=1e-4)
    assert support.share < support.alone
    assert np.abs(support.torques).max() / 2.0 == pytest.approx(support.share, abs=1e-9)


def test_what_is_above_not_touchable_or_away_supports_nothing():
    arm = hinged(2)
    for scene in (
        beside(0.4, 1.0, touchable=["ball"]),
        beside(0.4, -1.0),
        beside(0.4, -1.2, touchable=["ball"]),
    ):
        support = pp.assess_support(arm, arm.straight(), scene, friction=0.0)
        assert support.share == pytest.approx(support.alone, rel=1e-9)
        np.testing.assert_allclose(support.torques, arm.at(arm.straight()).gravity_torques, atol=1e-9)
    with pytest.raises(WeightUnknown):
        pp.assess_support(level(2), level(2).straight(), beside(0.4, -1.0, touchable=["ball"]))
