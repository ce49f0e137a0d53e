"""How far the whole arm is from a curve, and what is said of arms that do not follow one."""

from __future__ import annotations

import warnings
from itertools import pairwise

import numpy as np
import pinocchio as pin
import pytest
from arm.describing import HERE, LINK, X, Y, Z, arm_text, limit, pairs
from sampling import seeds

import pinposture as pp
from pinposture.errors import (
    CurveBendsTooMuch,
    CurveEndsEarly,
    CurveLeavesTooSharply,
    CurveOutOfReach,
    PostureWarning,
)
from pinposture.study import awkward_arms

WIDE = limit(-1e6, 1e6)


def load(text, **more):
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", PostureWarning)
        return pp.Arm.load(text, **more)


def brute_force(arm, q, curve, normal=(0, 0, 0)):
    """The farthest of dense samples of the links, by Pinocchio, from dense samples of the curve [m]."""
    data = arm.model.createData()
    pin.framesForwardKinematics(arm.model, data, q)
    places = [arm.chain.base, *(data.oMi[k].translation.copy() for k in range(1, arm.model.njoints))]
    places.append(data.oMf[arm.model.getFrameId("tip")].translation.copy())
    places = np.array(places) - np.outer((np.array(places) - arm.chain.base) @ normal, normal)
    dense = curve.at(np.linspace(0.0, curve.length, 4001))
    links = np.concatenate([a + np.linspace(0, 1, 60)[:, None] * (b - a) for a, b in pairwise(places)])
    return max(np.linalg.norm(dense - place, axis=1).min() for place in links)


@pytest.mark.parametrize("seed", seeds(4))
def test_the_distance_is_that_of_dense_samples_of_links_and_curve(seed):
    arm, rng = load(arm_text(pairs(3))), np.random.default_rng(seed)
    curve = pp.Curve.spline(rng.uniform(-0.3, 0.3, (6, 3)))
    q = arm.random(rng)
    away = pp.Target(arm.at(q).points, np.ones(3), q, curve).distance_from_curve(arm)
    assert away == pytest.approx(brute_force(arm, q, curve), rel=2e-3)


def test_a_link_across_a_circle_is_as_far_from_it_as_its_chord():
    radius, relative_position_weight = 1.0, 0.8
    arm = load(arm_text([("revolute", Z, HERE)], tip=f"{relative_position_weight} 0 0"))
    half = np.arcsin(relative_position_weight / 2 / radius)
    turn = np.linspace(np.pi / 2 + half, np.pi / 2 - half, 200)
    circle = pp.Curve.points(radius * np.column_stack([np.cos(turn), np.sin(turn), 0 * turn]))
    laid = circle.moved(np.eye(3), -circle.start)
    target = pp.Target(arm.at(arm.neutral()).points, np.ones(1), arm.neutral(), laid)
    assert target.distance_from_curve(arm) == pytest.approx(radius * (1 - np.cos(half)), rel=1e-5)


def test_without_a_curve_or_a_configuration_there_is_no_distance():
    arm = load(arm_text(pairs(2)))
    assert pp.Target.from_configuration(arm, arm.neutral()).distance_from_curve(arm) is None
    assert pp.Target.from_points(arm, arm.chain.points).distance_from_curve(arm) is None


@pytest.mark.parametrize("name", ["unrepeating21", "long_module7", "long_modules36", "bucket4"])
def test_an_arm_with_rows_of_parallel_axes_follows_a_curve_in_their_plane_with_all_its_links(name):
    arm = load(awkward_arms()[name])
    bend = [(0, 0, 0), (0.3, 0, 0), (0.6, 0, 0.1), (0.9, 0, 0.3), (1.0, 0, 0.7)]
    target = pp.resolve_targets(arm, pp.Curve.spline(arm.length * np.array(bend)))
    assert brute_force(arm, target.q, target.curve) < 0.021 * arm.length


def test_rows_of_parallel_axes_that_turn_each_other_come_near_a_helix_and_say_how_near():
    arm = load(awkward_arms()["long_modules36"])
    helix = pp.Curve.helix(radius=0.06 * arm.length, pitch=0.15 * arm.length, turns=4)
    target = pp.resolve_targets(arm, helix)
    away = brute_force(arm, target.q, target.curve)
    assert target.distance_from_curve(arm) == pytest.approx(away, rel=5e-3)
    assert away < 0.05 * arm.length


@pytest.mark.parametrize("name", ["unrepeating21", "long_module7"])
def test_such_an_arm_is_not_said_to_follow_a_helix(name):
    arm = load(awkward_arms()[name])
    helix = pp.Curve.helix(radius=0.06 * arm.length, pitch=0.15 * arm.length, turns=4)
    with pytest.raises(CurveBendsTooMuch):
        pp.resolve_targets(arm, helix)


def test_control_points_on_the_curve_do_not_hide_links_beside_it():
    arm = load(awkward_arms()["long_module7"], modules=7)  # one control point, at the tip
    helix = pp.Curve.helix(radius=0.06 * arm.length, pitch=0.15 * arm.length, turns=4)
    with pytest.warns(PostureWarning, match="does not follow the curve: its links are up to"):
        target = pp.resolve_targets(arm, helix)
    assert target.residual.max() < 1e-6
    assert target.distance_from_curve(arm) > 0.1 * arm.length
    run = pp.track(arm, target, arm.straight(), max_steps=200)
    assert run.converged
    assert run.distance_from_curve == pytest.approx(brute_force(arm, run.q[-1], target.curve), rel=5e-3)


def test_an_arm_that_follows_is_not_warned_of():
    arm = pp.Arm.from_template("RyRz", 8)
    with warnings.catch_warnings():
        warnings.simplefilter("error", PostureWarning)
        pp.resolve_targets(arm, pp.Curve.helix(radius=0.2, pitch=0.3, turns=0.4), placement="align")


@pytest.mark.parametrize("curve", ["line", "bend"])
@pytest.mark.parametrize("beside", [0.05, -0.3])
def test_a_tip_beside_the_plane_of_the_arm_is_measured_in_the_plane(curve, beside):
    text = arm_text([("revolute", Z, LINK)] * 8, tip=f"0.1 0 {beside}")
    arm, level = load(text), load(arm_text([("revolute", Z, LINK)] * 8))
    asked = {
        "line": pp.Curve.line((0, 0, 0), (1, 0, 0)),
        "bend": pp.Curve.spline([(0, 0, 0), (0.3, 0, 0), (0.6, 0.1, 0), (0.9, 0.3, 0)]),
    }[curve]
    target = pp.resolve_targets(arm, asked, placement="align")
    assert target.residual.max() < 1e-6
    assert target.points[-1][2] == pytest.approx(beside, abs=1e-9)
    places = level.at(target.q).points
    np.testing.assert_allclose(target.points[:, :2], places[:, :2], atol=1e-9)
    away = brute_force(arm, target.q, target.curve, normal=(0, 0, 1))
    assert target.distance_from_curve(arm) == pytest.approx(away, rel=0.01, abs=2e-4)
    assert pp.track(arm, target, arm.random(np.random.default_rng(0))).converged


def test_a_slide_that_ends_before_the_curve_is_named():
    joints = [("prismatic", X, HERE, limit(0, 0.2)), *pairs(3)]
    arm = load(arm_text(joints))
    far = pp.Curve.line((1.5, 0, 0), (2.5, 0, 0))
    with pytest.raises(CurveOutOfReach, match="prismatic joints are at their limits") as caught:
        pp.resolve_targets(arm, far, placement="as_is")
    assert "gentler" not in str(caught.value)


def test_hinges_that_cannot_bend_as_far_as_the_curve_are_named_beside_a_slide_at_its_limit():
    stiff = [("revolute", axis, LINK, limit(-0.3, 0.3)) for axis in (Y, Z) * 3]
    arm = load(arm_text([("prismatic", X, HERE, limit(0, 0.4)), *stiff]))
    bend = pp.Curve.helix(radius=0.3, pitch=0.1, turns=0.99)
    with pytest.raises(CurveBendsTooMuch, match=r"joints are at their limits: .*'j2'; .*gentler"):
        pp.resolve_targets(arm, bend, placement="align")


@pytest.mark.parametrize("method", ["auto", "sequential", "closest"])
@pytest.mark.parametrize("least", [0.0, 0.03])
def test_a_slide_retracts_if_the_curve_is_too_short_for_the_extended_arm(method, least):
    arm = load(arm_text([("prismatic", X, HERE, limit(least, 0.2)), *pairs(3)]))
    q = np.array([least, *[0.1, -0.2] * 3])
    nodes = np.vstack([arm.chain.base, arm.at(q).points])
    nodes = np.vstack([nodes, 1.1 * nodes[-1] - 0.1 * nodes[-2]])  # 2 cm longer than the arm
    straight = pp.Curve.line(arm.chain.base, arm.chain.base + [1.001 * (arm.length + least), 0, 0])
    for curve in (straight, pp.Curve.spline(nodes, through=True)):
        target = pp.resolve_targets(arm, curve, placement="as_is", method=method)
        assert least <= target.q[0] < 0.1
        assert curve.nearest(arm.at(target.q).points)[1].max() < 1e-5
    short = pp.Curve.line(arm.chain.base, arm.chain.base + [0.98 * (arm.length + least), 0, 0])
    with pytest.raises(CurveEndsEarly):
        pp.resolve_targets(arm, short, placement="as_is", method=method)


def test_a_curve_beside_the_base_is_said_to_be():
    arm = load(arm_text([("revolute", "0 1 0.2", LINK), ("revolute", "0 0.2 1", LINK)] * 3))
    far = pp.Curve.line((0.1, 2, 0), (1, 2, 0))
    with pytest.raises(CurveLeavesTooSharply, match="passes 2 m from the base"):
        pp.resolve_targets(arm, far, placement="as_is")


def driving(bound=WIDE):
    """A mobile base of two slides that carries three modules of two hinges."""
    return load(arm_text([("prismatic", X, HERE, bound), ("prismatic", Y, HERE, bound), *pairs(3)]))


def test_a_base_that_drives_stays_where_a_curve_is_laid_at_it():
    arm = driving()
    target = pp.resolve_targets(
        arm, pp.Curve.spline([(0, 0, 0), (0.3, 0, 0), (0.5, 0.1, 0.1), (0.9, 0.3, 0.1)])
    )
    np.testing.assert_allclose(arm.positions(target.q)[:2], 0.0, atol=1e-12)
    assert target.residual.max() < 1e-6
    assert target.distance_from_curve(arm) < 0.05 * arm.length


def test_a_base_that_drives_goes_to_a_curve_that_is_used_as_it_is():
    arm = driving()
    curve = pp.Curve.spline([(0, 0, 0), (0.3, 0, 0), (0.5, 0.1, 0.1), (0.9, 0.3, 0.1)])
    at_base = pp.resolve_targets(arm, curve, placement="translate")
    shift = np.array([250.0, -31.0, 0.0])
    start = arm.chain.base + shift - curve.start
    there = pp.resolve_targets(arm, curve.moved(np.eye(3), start), placement="as_is")
    np.testing.assert_allclose(arm.positions(there.q)[:2], shift[:2], atol=1e-9)
    np.testing.assert_allclose(there.points - shift, at_base.points, atol=1e-6)
    assert there.distance_from_curve(arm) == pytest.approx(at_base.distance_from_curve(arm), abs=1e-6)


def test_points_that_a_base_has_to_drive_to_are_fitted():
    arm = driving()
    q = arm.configuration([40.0, -7.0, *np.linspace(-0.4, 0.5, 6)])
    found = pp.fit_points(arm, arm.at(q).points)
    assert found.residual.max() < 1e-6
