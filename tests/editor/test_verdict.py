"""Verdicts on shapes of which it is known what the arm can make of them."""

from __future__ import annotations

from itertools import pairwise
from types import SimpleNamespace

import numpy as np
import pinocchio as pin
import pytest
from edited_tasks import L, bent_spline, six_modules, straight_line

import pinposture as pp
from pinposture.editor.solver import judge
from pinposture.task import Keyframe
from pinposture.viz import palette
from pinposture.viz.palette import THEME

MODULE = L / 6  # two links of 25 mm each


def stiff_arm(most: float) -> pp.Arm:
    """Six modules like those of `six_modules`, whose joints turn by so much either way [rad]."""
    joints = tuple(pp.JointSpec(axis, lower=-most, upper=most) for axis in "yz")
    return pp.Arm.from_modules([pp.ModuleTemplate("stiff", joints, (0.025, 0.025))] * 6)


def test_a_straight_line_is_taken_without_a_word() -> None:
    verdict = judge(six_modules(), Keyframe(straight_line()), pp.Scene(self_collision=True))
    assert verdict.target is not None
    assert (verdict.reason, verdict.notes, verdict.collision) == ("", (), False)
    assert np.allclose(verdict.target.points, [(k * MODULE, 0, 0) for k in range(1, 7)])


def test_it_has_the_distance_of_the_whole_arm_from_the_curve() -> None:
    arm = six_modules()
    verdict = judge(arm, Keyframe(bent_spline(), trim=True), None)
    assert verdict.target is not None and verdict.target.curve is not None and verdict.target.q is not None
    state = arm.at(verdict.target.q)
    corners = [arm.chain.base]
    for k, joints in enumerate(arm.chain.module_slices):
        corners += [*state.origins[joints], state.points[k]]
    shares = np.linspace(0.0, 1.0, 50)[:, None]
    places = np.concatenate([a + shares * (b - a) for a, b in pairwise(corners)])
    farthest = verdict.target.curve.nearest(places).distance.max()
    assert verdict.distance_from_curve == pytest.approx(farthest, rel=1e-3)


def test_too_short() -> None:
    verdict = judge(six_modules(), Keyframe(pp.Curve.line((0, 0, 0), (0.7 * L, 0, 0))), None)
    assert verdict.target is None
    # four modules of a sixth are placed; the fifth would end at 5/6, beyond 0.7
    assert "too short" in verdict.reason
    assert "at module 5, 200 mm along the curve" in verdict.reason


def test_bends_too_much() -> None:
    ring = pp.Curve.helix(0.2 * MODULE, 0.0, 12)
    verdict = judge(six_modules(), Keyframe(ring, method="closest"), None)
    assert verdict.target is None
    assert verdict.reason


def test_bends_too_much_for_limits_of_joints() -> None:
    stiff = stiff_arm(0.05)
    # a quarter of a circle takes 90 degrees of its axis; six joints have 17
    quarter = pp.Curve.helix(stiff.length / (0.5 * np.pi), 0.0, 0.27, axis=(0, 0, 1))
    verdict = judge(stiff, Keyframe(quarter), None)
    assert verdict.target is None
    assert "bends too much" in verdict.reason


def test_a_curve_that_leaves_the_base_the_other_way() -> None:
    stiff = stiff_arm(0.5)
    line = pp.Curve.line((0, 0, 0), (-2.0 * stiff.length, 0, 0))
    back = Keyframe(line, placement="as_is", method="sequential", trim=True)
    verdict = judge(stiff, back, None)
    assert verdict.target is None
    assert "bends too much" in verdict.reason
    assert "at the base" in verdict.reason or "at module 1" in verdict.reason


@pytest.mark.parametrize("trim", [False, True])
def test_too_long_is_said_and_taken(trim: bool) -> None:
    verdict = judge(six_modules(), Keyframe(pp.Curve.line((0, 0, 0), (1.5 * L, 0, 0)), trim=trim), None)
    assert verdict.target is not None
    assert len(verdict.notes) == 1
    assert verdict.notes[0].startswith("the curve is longer than the arm by 150 mm")
    whole = Keyframe(pp.Curve.line((0, 0, 0), (L + MODULE, 0, 0)), trim=trim)
    assert judge(six_modules(), whole, None).notes == ()


def test_a_tip_out_of_reach_is_refused_without_a_wrong_number() -> None:
    goal = pp.EndEffector((0, 0, 2 * L), priority=True)
    verdict = judge(six_modules(), Keyframe(straight_line(), name="third", tip=goal), None)
    assert verdict.target is None
    assert "is missed by 300 mm" in verdict.reason
    assert "keyframe" not in verdict.reason


def test_in_collision_by_how_much() -> None:
    # its middle is 1.5 radii beside the straight arm's axis
    ball = pp.Sphere((0.5 * L, 0.03, 0), 0.02)
    scene = pp.Scene({"ball": ball}, arm_radius=0.015)
    verdict = judge(six_modules(), Keyframe(straight_line()), scene)
    assert verdict.target is not None
    assert verdict.collision
    assert verdict.notes[0].startswith("in collision: ")
    assert verdict.notes[0].endswith("is 5 mm inside ball")


def test_nearer_than_the_margin() -> None:
    scene = pp.Scene({"ball": pp.Sphere((0.5 * L, 0.04, 0), 0.02)}, arm_radius=0.015, margin=0.01)
    verdict = judge(six_modules(), Keyframe(straight_line()), scene)
    assert verdict.collision
    assert verdict.notes[0].startswith("nearer than the margin: ")
    assert "is 5 mm from ball" in verdict.notes[0]
    far = pp.Scene({"ball": pp.Sphere((0.5 * L, 0.04, 0), 0.02)}, arm_radius=0.005, margin=0.01)
    assert not judge(six_modules(), Keyframe(straight_line()), far).collision


def test_an_obstacle_around_the_base() -> None:
    verdict = judge(six_modules(), Keyframe(straight_line()), pp.Scene({"rock": pp.Sphere((0, 0, 0), 0.01)}))
    assert verdict.collision
    assert verdict.notes == ("in collision: rock stands where the base of the arm is",)


def test_joints_at_limits_are_named() -> None:
    # straight, each of these is where it may turn no further
    arm = pp.Arm.from_modules(
        [pp.ModuleTemplate("s", (pp.JointSpec("z", lower=-0.3, upper=0.0),), (0.05,))] * 6
    )
    verdict = judge(arm, Keyframe(pp.Curve.line((0, 0, 0), (0.3, 0, 0))), None)
    assert verdict.target is not None
    assert len(verdict.notes) == 1
    first = list(arm.chain.joints)[:3]
    more = len(arm.chain.joints) - 3
    assert verdict.notes[0] == f"at the limit of {', '.join(first)} and {more} more"


def test_a_joint_without_the_torque_to_hold_the_shape_is_named() -> None:
    arm = six_modules()
    needed = float(np.abs(arm.at(arm.straight()).gravity_torques).max())
    verdict = judge(arm.with_effort(0.9 * needed), Keyframe(straight_line()), None)
    assert verdict.notes == (f"joint 'm01_j1_y' needs {needed:.4g} of {0.9 * needed:.4g} N m",)
    assert judge(arm.with_effort(1.1 * needed), Keyframe(straight_line()), None).notes == ()


def test_bodies_have_the_colours_of_their_torques_if_these_are_known() -> None:
    pytest.importorskip("viser")
    from pinposture.editor.ui.arm import COLORING, body_colors

    arm = six_modules()
    torques = np.abs(arm.at(arm.straight()).gravity_torques)
    shades = np.full((12, 3), 7, dtype=np.uint8)
    for weighed, known in ((arm.with_effort(0.9 * float(torques.max())), True), (arm, False)):
        live = SimpleNamespace(arm=weighed, state=weighed.at(weighed.straight()))
        found = body_colors(COLORING.torques, live, shades)  # type: ignore[arg-type]
        if not known:
            np.testing.assert_array_equal(found, shades)
            continue
        red, green = (
            np.round(255.0 * np.array(palette.rgb(each))) for each in (THEME.singular, THEME.regular)
        )
        np.testing.assert_array_equal(np.all(found == red, axis=1), torques > 0.9 * torques.max())
        np.testing.assert_array_equal(np.all(found == green, axis=1), torques <= 0.45 * torques.max())


def test_a_region_and_a_tip_are_part_of_it() -> None:
    region = judge(six_modules(), Keyframe(bent_spline(), trim=True, region=(1, 3)), None)
    assert region.target is not None
    assert region.target.has_target.tolist() == [False, True, True, True, False, False]
    away = pp.EndEffector(position=(0, 0, 3.0 * L), priority=True)
    verdict = judge(six_modules(), Keyframe(straight_line(), tip=away), None)
    assert verdict.target is None
    assert verdict.reason.startswith("its tip task with priority is missed by")
    none = judge(six_modules(), Keyframe(straight_line(), region=(2, 17)), None)
    assert none.target is None
    assert "last" in none.reason


def test_an_arm_on_a_feed_and_one_elsewhere() -> None:
    slide = pp.ModuleTemplate("Feed", (pp.JointSpec("x", "prismatic", 0.0, 0.5, velocity=0.1),), (0.05,))
    bending = pp.ModuleTemplate("s", (pp.JointSpec("y"), pp.JointSpec("z")), (0.025, 0.025))
    away = pin.SE3(pin.exp3(np.array([0.3, -0.5, 0.9])), np.array([0.7, -0.4, 1.1]))
    for arm in (
        pp.Arm.from_modules([slide] + [bending] * 5),
        pp.Arm.from_template("RyRz", modules=6, base_placement=away),
    ):
        line = pp.Curve.line((0, 0, 0), (2.0 * arm.length, 0, 0))
        verdict = judge(arm, Keyframe(line, trim=True), None)
        assert verdict.target is not None
        ahead = arm.at(arm.straight()).points[-1] - arm.chain.base
        assert np.allclose(np.cross(verdict.target.points - arm.chain.base, ahead), 0.0, atol=1e-6)


@pytest.mark.parametrize("method", ["sequential", "smooth", "closest"])
def test_each_method_takes_a_gentle_curve(method: str) -> None:
    verdict = judge(six_modules(), Keyframe(bent_spline(), trim=True, method=method), None)  # type: ignore[arg-type]
    assert verdict.target is not None
    assert verdict.target.method == method
    assert float(verdict.target.residual.max()) < 0.1 * MODULE  # type: ignore[union-attr]
