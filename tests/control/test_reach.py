"""Postures that bring the tip somewhere, judged by Pinocchio, by closed forms and by sampled links."""

from __future__ import annotations

import re
from itertools import pairwise

import numpy as np
import pinocchio as pin
import pytest
from arms import template_arm
from hypothesis import given
from hypothesis import strategies as st
from sampling import examples

import pinposture as pp
from pinposture.arm import smooth_configuration
from pinposture.control.reach import reach_from
from pinposture.errors import UnknownName, WeightUnknown

MARGIN = 0.01
RADIUS = 0.008


@pytest.fixture(scope="module")
def arm():
    return pp.Arm.from_template("RyRz", modules=12)


@pytest.fixture(scope="module")
def clutter(arm):
    """Balls and where they are, off the first part of the straight arm."""
    rng = np.random.default_rng(7)
    places = [place for place in rng.uniform(-0.6, 0.6, (40, 3)) if np.linalg.norm(place) > 0.2]
    balls = {f"ball{k}": pp.Sphere(place.tolist(), 0.05) for k, place in enumerate(places)}
    scene = pp.Scene(balls, self_collision=False, margin=MARGIN, arm_radius=RADIUS)
    return scene, np.array(places)


def placed(arm, q):
    """The frame of the tip by Pinocchio alone."""
    data = arm.model.createData()
    pin.framesForwardKinematics(arm.model, data, np.array(q))
    return data.oMf[arm.model.getFrameId(arm.control_points[-1])]


def sampled_clearance(arm, q, centres, radius):
    """Distance of densely sampled points of the links from balls [m], by Pinocchio's joint placements."""
    data = arm.model.createData()
    pin.framesForwardKinematics(arm.model, data, np.array(q))
    stations = [data.oMi[j].translation for j in range(1, arm.model.njoints)] + [placed(arm, q).translation]
    shares = np.linspace(0.0, 1.0, 60)[:, None]
    points = np.vstack([a + shares * (b - a) for a, b in pairwise(stations)])
    return float(np.linalg.norm(points[:, None] - centres, axis=2).min()) - radius - RADIUS


@pytest.mark.parametrize("seed", range(4))
def test_the_tip_is_there_and_the_arm_is_clear_and_within_limits(arm, clutter, seed):
    scene, centres = clutter
    goal = np.random.default_rng(seed).uniform(-0.3, 0.3, 3) + (0.1, 0.0, 0.0)
    if np.linalg.norm(centres - goal, axis=1).min() < 0.05 + RADIUS + 2 * MARGIN:
        goal = centres[seed] * (1.0 + 0.09 / np.linalg.norm(centres[seed]))
    found = pp.reach(arm, goal, scene=scene, count=3, seed=seed)
    assert found
    for each in found:
        assert np.linalg.norm(placed(arm, each.q).translation - goal) <= 1e-6 * arm.length
        measured = sampled_clearance(arm, each.q, centres, 0.05)
        assert measured >= MARGIN - 1e-6
        assert measured == pytest.approx(each.clearance, abs=1e-3)
        positions = arm.positions(each.q)
        assert np.all((arm.limits.lower <= positions) & (positions <= arm.limits.upper))
        shares = np.minimum(positions - arm.limits.lower, arm.limits.upper - positions)
        half = (arm.limits.upper - arm.limits.lower) / 2
        assert each.limit_distance == pytest.approx((shares / half).min())
        sigma = np.linalg.svd(arm.at(each.q).jacobians[-1], compute_uv=False)
        assert each.manipulability == pytest.approx(np.prod(sigma / sigma[0]))
        assert each.path is None
        np.testing.assert_array_equal(each.target.q, each.q)
    scores = [each.score for each in found]
    assert scores == sorted(scores, reverse=True)


def test_several_postures_differ(arm, clutter):
    found = pp.reach(arm, (0.3, 0.1, 0.2), scene=clutter[0], count=4)
    assert len(found) == 4
    for k, one in enumerate(found):
        for other in found[:k]:
            apart = np.linalg.norm(arm.at(one.q).links - arm.at(other.q).links, axis=1).max()
            assert apart >= 0.05 * arm.length


@pytest.mark.long
@given(st.floats(0.15, 0.95), st.floats(-3.0, 3.0))
@examples(20)
def test_two_hinges_have_exactly_the_two_postures_of_the_closed_form(share, angle):
    arm = pp.Arm.from_template("Rz", modules=2)
    a, b = arm.chain.module_lengths
    away = share * (a + b)
    goal = away * np.array([np.cos(angle), np.sin(angle), 0.0])
    elbow = np.arccos((away**2 - a**2 - b**2) / (2 * a * b))
    expected = []
    for bend in (elbow, -elbow):
        first = angle - np.arctan2(b * np.sin(bend), a + b * np.cos(bend))
        expected.append((np.arctan2(np.sin(first), np.cos(first)), bend))
    limit = arm.limits.upper
    expected = [q for q in expected if np.all(np.abs(q) <= limit)]
    found = pp.reach(arm, goal, count=5, budget=20.0)
    assert len(found) == len(expected)
    for q in expected:
        assert min(np.abs(each.q - q).max() for each in found) < 1e-4


@pytest.mark.parametrize("direction", [(1, 0, 0), (0, 0, -2), (0.3, -1, 0.2)])
def test_the_last_link_points_in_the_direction_asked_for(arm, clutter, direction):
    scene, centres = clutter
    (found,) = pp.reach(arm, (0.3, 0.1, 0.2), direction=direction, scene=scene)
    frame = placed(arm, found.q)
    wanted = np.array(direction) / np.linalg.norm(direction)
    assert np.linalg.norm(frame.translation - (0.3, 0.1, 0.2)) <= 1e-6 * arm.length
    np.testing.assert_allclose(frame.rotation[:, 0], wanted, atol=1e-4)
    assert sampled_clearance(arm, found.q, centres, 0.05) >= MARGIN - 1e-6


@pytest.mark.parametrize("as_matrix", [False, True])
def test_a_pose_is_taken_as_a_whole(arm, as_matrix):
    pose = pin.SE3(pin.rpy.rpyToMatrix(0.4, -0.7, 1.1), np.array([0.25, -0.1, 0.2]))
    (found,) = pp.reach(arm, pose.homogeneous if as_matrix else pose)
    frame = placed(arm, found.q)
    assert np.linalg.norm(frame.translation - pose.translation) <= 1e-6 * arm.length
    assert np.linalg.norm(pin.log3(pose.rotation.T @ frame.rotation)) < 1e-4
    assert found.clearance == np.inf


@pytest.mark.long
def test_the_path_leads_from_the_start_to_the_posture_clear_of_everything(arm, clutter):
    scene, centres = clutter
    start = arm.straight()
    clear = sampled_clearance(arm, start, centres, 0.05)
    if clear < MARGIN:
        (begin,) = pp.reach(arm, (0.3, -0.2, 0.1), scene=scene)
        start = begin.q
    for each in pp.reach(arm, (0.3, 0.1, 0.2), scene=scene, start=start, count=2, budget=30.0):
        assert each.path is not None
        assert each.path.blocked_by == ""
        np.testing.assert_allclose(each.path.configurations[0], start, atol=1e-12)
        np.testing.assert_allclose(
            placed(arm, each.path.configurations[-1]).translation, (0.3, 0.1, 0.2), atol=1e-5
        )
        for place in np.linspace(0.0, each.path.end, 200):
            assert sampled_clearance(arm, each.path.configuration(place), centres, 0.05) >= MARGIN - 2e-3
        steps = np.diff(each.path.offsets, axis=0)
        length = np.linalg.norm(steps, axis=1).sum() / np.linalg.norm(each.path.offsets[-1])
        assert each.path_ratio == pytest.approx(length)


def test_a_seed_gives_the_same_postures_again(arm, clutter):
    first, again, other = (
        pp.reach(arm, (0.3, 0.1, 0.2), scene=clutter[0], count=2, seed=seed, budget=60.0)
        for seed in (5, 5, 6)
    )
    for one, same in zip(first, again, strict=True):
        np.testing.assert_array_equal(one.q, same.q)
    assert not np.array_equal(first[0].q, other[0].q)


def test_what_is_too_far_or_off_the_plane_is_out_of_reach(arm):
    with pytest.raises(pp.PostureError, match="reaches 600 mm") as caught:
        pp.reach(arm, (0.7, 0.0, 0.0))
    assert type(caught.value).__name__ == "OutOfReach"
    with pytest.raises(pp.PostureError, match="20 mm off the plane"):
        pp.reach(pp.Arm.from_template("Rz", modules=5), (0.3, 0.1, 0.02))


def test_what_no_posture_reaches_is_told_with_how_near_it_came():
    """The tip of links of 0.2 m and 0.1 m stays 0.1 m away from the base."""
    arm = pp.Arm.from_modules([pp.template("Rz").with_lengths([length]) for length in (0.2, 0.1)])
    with pytest.raises(pp.PostureError, match="the closest posture found leaves the tip") as caught:
        pp.reach(arm, (0.05, 0, 0), budget=1.0)
    assert float(str(caught.value).split(" mm from its goal")[0].split()[-1]) == pytest.approx(50.0, rel=1e-2)


def test_a_planar_arm_points_only_within_its_plane():
    arm = pp.Arm.from_template("Rz", modules=8)
    (found,) = pp.reach(arm, (0.5, 0.3, 0.0), direction=(1, 2, 0))
    frame = placed(arm, found.q)
    np.testing.assert_allclose(frame.translation, (0.5, 0.3, 0.0), atol=1e-5)
    np.testing.assert_allclose(frame.rotation[:, 0], np.array([1, 2, 0]) / np.sqrt(5), atol=1e-4)
    tilted = pin.SE3(pin.rpy.rpyToMatrix(0.3, 0.0, 0.0), np.array([0.5, 0.3, 0.0]))
    for goal, direction in (((0.5, 0.3, 0.0), (1, 2, 0.1)), (tilted, None)):
        with pytest.raises(pp.PostureError, match="cannot take this orientation"):
            pp.reach(arm, goal, direction=direction)


def test_the_position_margin_of_the_limits_is_kept(arm):
    limits = pp.Limits(position_margin=2.9)
    (found,) = pp.reach(arm, (0.4, 0.1, 0.2), limits=limits)
    assert np.abs(arm.positions(found.q)).max() <= arm.limits.upper.max() - 2.9 + 1e-12


@pytest.mark.long
def test_slides_and_joints_without_limits_are_used():
    """A crane of two links on a rail, with joints that turn endlessly."""
    between = '<parent link="{}"/><child link="{}"/><origin xyz="{}"/><axis xyz="{}"/>{}'
    joint = f'<joint name="{{}}" type="{{}}">{between}</joint>'
    slide = '<limit lower="-0.5" upper="0.5" velocity="1" effort="1"/>'
    joints = (
        ("slide", "prismatic", "base", "cart", "0 0 0", "1 0 0", slide),
        ("turn", "continuous", "cart", "boom", "0 0 0", "0 0 1", ""),
        ("lift", "continuous", "boom", "jib", "0.2 0 0", "0 0 1", ""),
        ("end", "fixed", "jib", "tip", "0.1 0 0", "0 0 1", ""),
    )
    links = "".join(f'<link name="{name}"/>' for name in ("base", "cart", "boom", "jib", "tip"))
    text = f'<robot name="crane">{links}{"".join(joint.format(*each) for each in joints)}</robot>'
    arm = pp.Arm.load(text)
    goal = (0.6, 0.15, 0.0)
    found = pp.reach(arm, goal, count=3)
    assert len(found) == 3
    for each in found:
        np.testing.assert_allclose(placed(arm, each.q).translation, goal, atol=1e-5)
        at = arm.positions(each.q)[0]
        assert abs(at) <= 0.5
        assert each.limit_distance == pytest.approx(1.0 - abs(at) / 0.5)


def test_a_goal_inside_an_obstacle_or_behind_a_wall_has_no_clear_posture(arm):
    ball = pp.Scene({"ball": pp.Sphere((0.3, 0.0, 0.2), 0.05)})
    with pytest.raises(pp.PostureError, match="inside ball"):
        pp.reach(arm, (0.3, 0.0, 0.21), scene=ball)
    wall = pp.Scene({"wall": pp.Box((0.3, 0.0, 0.0), (0.02, 4.0, 4.0))})
    with pytest.raises(pp.PostureError, match="no clear posture"):
        pp.reach(arm, (0.4, 0.0, 0.0), scene=wall, budget=1.0)


@pytest.mark.long
def test_a_posture_that_no_path_leads_to_says_so():
    """A wall runs out from beside the base; the other way round, the first joint is at its limit."""
    arm = pp.Arm.from_template("Rz", modules=2)
    wall = pp.Scene({"wall": pp.Box((0.2, 0.0, 0.0), (0.36, 0.002, 1.0))}, margin=0.001, arm_radius=0.004)
    start = arm.configuration([1.2, 0.3])
    found = pp.reach(arm, (0.15, -0.15, 0.0), scene=wall, start=start, budget=3.0)
    assert found
    for each in found:
        assert each.path is not None
        assert "wall" in each.path.blocked_by


def gravity_shares(arm: pp.Arm, q: np.ndarray) -> np.ndarray:
    """Torques that hold the arm in relation to its limits, by Pinocchio alone."""
    torques = pin.computeGeneralizedGravity(arm.model, arm.model.createData(), q)
    return np.abs(torques) / arm.effort


@pytest.mark.long
def test_postures_can_be_chosen_for_low_torque_and_within_torque_limits():
    rng = np.random.default_rng(1)
    arm = template_arm("RyRz", 10).with_payload(0.05).with_effort(0.25)
    held = pp.Limits(effort=True)
    usual = []
    light = []
    for number in range(4):
        goal = arm.at(smooth_configuration(arm, rng, rng.uniform(0.3, 1.0))).points[-1]
        (first,) = pp.reach(arm, goal, seed=number)
        (second,) = pp.reach(arm, goal, seed=number, objective="torque")
        (third,) = pp.reach(arm, goal, seed=number, limits=held)
        usual.append(gravity_shares(arm, first.q).max())
        light.append(gravity_shares(arm, second.q).max())
        assert second.score == pytest.approx(max(0.0, 1.0 - light[-1]), abs=1e-9)
        assert gravity_shares(arm, third.q).max() <= 1.0 + 1e-9
        for found in (second, third):
            assert np.linalg.norm(arm.at(found.q).points[-1] - goal) <= 1e-6 * arm.length
            assert arm.within_limits(found.q)
    assert max(usual) > 1.0
    assert np.mean(light) < 0.8 * np.mean(usual)


@pytest.mark.long
@pytest.mark.parametrize(("first", "last", "relief"), [(9, 9, 0.6), (6, 9, 0.9), (0, 4, 0.9)])
def test_a_part_of_the_arm_meets_its_points_and_the_rest_is_easy_to_hold(first, last, relief):
    arm = template_arm("RyRz", 10).with_payload(0.05).with_effort(0.6)
    rng = np.random.default_rng(0)
    usual = []
    light = []
    for number in range(3):
        target = pp.Target.from_configuration(arm, smooth_configuration(arm, rng, 0.8)).region(first, last)
        for objective, shares in (("dexterity", usual), ("torque", light)):
            (found,) = pp.reach(arm, target, seed=number, objective=objective, scene=pp.Scene())
            data = arm.model.createData()
            pin.framesForwardKinematics(arm.model, data, found.q)
            for point in range(first, last + 1):
                there = data.oMf[arm.model.getFrameId(arm.control_points[point])].translation
                assert there == pytest.approx(target.points[point], abs=1e-6 * arm.length)
            assert arm.within_limits(found.q)
            shares.append(gravity_shares(arm, found.q).max())
    assert np.mean(light) < relief * np.mean(usual)


def test_a_whole_posture_is_met_where_nothing_is_free():
    arm = template_arm("Rz", 4)
    q = arm.configuration([0.3, -0.4, 0.5, 0.2])
    (found,) = pp.reach(arm, pp.Target.from_configuration(arm, q), start=arm.straight())
    assert arm.positions(found.q)[:3] == pytest.approx(arm.positions(q)[:3], abs=1e-5)
    assert found.path is not None
    assert arm.at(found.path.configurations[-1]).points == pytest.approx(arm.at(q).points, abs=1e-5)


def test_points_that_cannot_be_met_are_told_as_such(arm):
    straight = arm.at(arm.straight()).points
    apart = pp.Target.from_points(arm, straight + (0.0, 0.0, 0.3)).region(0, 1)
    with pytest.raises(
        pp.PostureError, match=r"the control points cannot reach .* leaves the control points"
    ):
        pp.reach(arm, apart, budget=0.5)
    with pytest.raises(pp.PostureError, match="direction"):
        pp.reach(arm, apart, direction=(1, 0, 0))
    ball = pp.Scene({"ball": pp.Sphere(straight[5].tolist(), 0.05)})
    with pytest.raises(pp.PostureError, match=r"the control points cannot reach .* inside ball"):
        pp.reach(arm, pp.Target.from_points(arm, straight).region(5, 5), scene=ball)


def test_an_unknown_objective_is_named(arm):
    with pytest.raises(UnknownName, match="no objective is called 'comfort'; there are: dexterity, torque"):
        pp.reach(arm, (0.3, 0.1, 0.1), objective="comfort")


def test_low_torque_needs_masses_and_torque_limits(arm):
    with pytest.raises(WeightUnknown, match="effort"):
        pp.reach(arm, (0.3, 0.1, 0.1), objective="torque")
    (found,) = pp.reach(arm, (0.3, 0.1, 0.1), objective="torque", limits=pp.Limits(effort=2.0))
    torques = pin.computeGeneralizedGravity(arm.model, arm.model.createData(), found.q)
    assert found.score == pytest.approx(1.0 - np.abs(torques).max() / 2.0, abs=1e-9)


@pytest.mark.parametrize(
    ("changed", "named"),
    [
        ({"count": 0}, "count"),
        ({"seed": -1}, "seed"),
        ({"budget": 0.0}, "budget"),
        ({"tolerance": np.nan}, "tolerance"),
        ({"direction": (0, 0, 0)}, "direction"),
        ({"start": np.zeros(3)}, "start"),
        ({"scene": "scene"}, "scene"),
        ({"limits": "limits"}, "limits"),
        ({"goal": (0.1, np.nan, 0.0)}, "goal"),
        ({"goal": "there"}, "goal"),
        ({"goal": np.eye(4) * 2}, "pose"),
        ({"goal": np.eye(4), "direction": (1, 0, 0)}, "direction"),
        ({"arm": "arm"}, "arm"),
    ],
)
def test_bad_input_is_named(arm, changed, named):
    given = {"arm": arm, "goal": (0.3, 0.1, 0.1), **changed}
    with pytest.raises(pp.PostureError, match=f"^{named}"):
        pp.reach(given.pop("arm"), given.pop("goal"), **given)


def test_all_reasons_why_a_goal_cannot_be_reached_are_named_at_once():
    """Farther than the arm, off its plane, inside a ball, and turned about an axis that it does not have."""
    arm = pp.Arm.from_template("Rz", modules=6)
    goal = pin.SE3(pin.rpy.rpyToMatrix(0.3, 0.0, 0.0), np.array([3.0, 0.0, 0.2]))
    scene = pp.Scene({"ball": pp.Sphere((3.0, 0.0, 0.0), 0.5)})
    with pytest.raises(pp.errors.OutOfReach) as caught:
        pp.reach(arm, goal, scene=scene)
    assert len(caught.value.reasons) == 4
    for words in (
        "4 reasons: (1)",
        "3.007 m from the base",
        "200 mm off the plane",
        "inside ball",
        "turns about one axis",
    ):
        assert words in str(caught.value)


@pytest.mark.long
@pytest.mark.parametrize("upper", [4.0, 9.0])
def test_the_posture_is_at_the_turns_at_which_its_path_ends(upper):
    text = pp.Arm.from_template("RyRz", 4).urdf
    arm = pp.Arm.load(re.sub(r'lower="[^"]*" upper="[^"]*"', f'lower="{-upper}" upper="{upper}"', text))
    assert np.all(arm.multi_turn)
    turned = 0
    for seed in range(4):
        rng = np.random.default_rng(seed)
        start = rng.uniform(-upper, upper, arm.nq)
        goal = arm.at(rng.uniform(-1.0, 1.0, arm.nq)).points[-1]
        for posture in pp.reach(arm, goal, start=start, count=2, seed=seed):
            end = start + posture.path.offsets[-1]
            np.testing.assert_allclose(posture.q, end, atol=1e-9)
            np.testing.assert_array_equal(posture.target.q, posture.q)
            assert posture.limit_distance == pytest.approx(1.0 - np.abs(end).max() / upper, abs=1e-9)
            turned += int(np.abs(end).max() > np.pi)
            reserve = min(max(posture.clearance, 0.0) / (0.05 * arm.length), 1.0)
            criteria = reserve, posture.limit_distance, posture.manipulability, 1.0 / posture.path_ratio
            assert posture.score == pytest.approx(np.mean(criteria))
    assert turned


@pytest.mark.parametrize("seed", [1, 21, 24])
def test_a_pose_that_takes_many_joints_to_their_limits_is_found_in_one_descent(seed):
    joints = tuple(pp.JointSpec(axis, lower=-0.5, upper=0.5) for axis in "yz")
    narrow = pp.Arm.from_modules([pp.ModuleTemplate("module", joints, (0.05, 0.05))] * 10)
    rng = np.random.default_rng(seed)
    known = np.clip(smooth_configuration(narrow, rng, 0.8), -0.5, 0.5)
    assert np.count_nonzero(np.abs(known) == 0.5) >= 4
    goal = placed(narrow, known)
    found = reach_from(narrow, goal, narrow.random(rng))
    assert found is not None
    assert np.linalg.norm(pin.log6(goal.actInv(placed(narrow, found.q))).vector) < 1e-5
    assert np.all(np.abs(found.q) <= 0.5)
