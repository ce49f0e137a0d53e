"""Paths through free space: clearance and bends by dense sampling, and that an arm follows them."""

from __future__ import annotations

from functools import cache

import numpy as np
import pinocchio as pin
import pytest
from sampling import cases

import pinposture as pp

LINK = 0.05
MARGIN = 0.005
RADIUS = 0.006
BALL = 0.06


@cache
def fed(kind="RyRz"):
    slide = pp.JointSpec("x", "prismatic", 0.0, 1.2, velocity=0.1)
    feed = pp.ModuleTemplate("Feed", (slide,), (0.05,))
    return pp.Arm.from_modules([feed, *[pp.template(kind)] * 14])


def entry(arm):
    """Where the tip of the straight arm is, by Pinocchio."""
    data = arm.model.createData()
    pin.framesForwardKinematics(arm.model, data, pin.neutral(arm.model))
    return np.array(data.oMf[arm.model.getFrameId(arm.control_points[-1])].translation)


def cluttered(seed, begin, goal):
    """Balls between two places, and where they are."""
    centres = np.random.default_rng(seed).uniform((0.1, -0.35, -0.35), (0.7, 0.35, 0.35), (40, 3)) + begin
    far = np.minimum(*(np.linalg.norm(centres - end, axis=1) for end in (begin, goal)))
    centres = centres[far > BALL + 0.05]
    balls = {f"ball{k}": pp.Sphere(tuple(each), BALL) for k, each in enumerate(centres.tolist())}
    return pp.Scene(balls, margin=MARGIN, arm_radius=RADIUS), centres


def sampled_bends(curve, count=4000):
    """Curvature by finite differences of places along the curve [1/m]."""
    s = np.linspace(0.0, curve.length, count)
    tangents = np.diff(curve.at(s), axis=0)
    tangents /= np.linalg.norm(tangents, axis=1)[:, None]
    return np.linalg.norm(np.diff(tangents, axis=0), axis=1) / (s[1] - s[0])


@pytest.mark.long
@pytest.mark.parametrize("seed", cases(range(4), 2))
def test_a_path_is_clear_and_bends_no_more_than_the_modules_and_the_arm_follows_it(seed):
    arm = fed()
    begin = entry(arm)
    goal = begin + (0.55, 0.1 * (-1.0) ** seed, 0.03 * seed)
    scene, centres = cluttered(seed, begin, goal)
    curve = pp.find_path(scene, None, goal, arm, seed=seed, budget=20.0)
    np.testing.assert_allclose(curve.start, begin, atol=1e-9)
    np.testing.assert_allclose(curve.end, goal, atol=1e-9)
    np.testing.assert_allclose(curve.tangent(0.0), (1.0, 0.0, 0.0), atol=1e-9)
    places = curve.at(np.linspace(0.0, curve.length, 4000))
    assert np.linalg.norm(places[:, None] - centres, axis=2).min() >= BALL + RADIUS + MARGIN - 1e-5
    sharpest = pp.Arm.from_template("RyRz", 14).can_follow(curve).max_curvature
    assert sampled_bends(curve).max() <= sharpest * (1.0 + 1e-3)
    reference = pp.follow_leader(arm, curve, interval=0.1, speed=0.05, placement="as_is")
    data = arm.model.createData()
    tip = arm.model.getFrameId(arm.control_points[-1])
    for offset in reference.offsets:
        pin.framesForwardKinematics(arm.model, data, arm.integrate(reference.start, offset))
        joints = np.array([data.oMi[j].translation for j in range(2, arm.model.njoints)])
        joints = np.vstack([joints, data.oMf[tip].translation])
        shares = np.linspace(0.0, 1.0, 15)[:, None, None]
        links = ((1.0 - shares) * joints[:-1] + shares * joints[1:]).reshape(-1, 3)
        assert np.linalg.norm(links[:, None] - centres, axis=2).min() >= BALL + RADIUS
    assert np.linalg.norm(joints[-1] - goal) < 0.2 * LINK


def test_without_obstacles_the_path_is_the_straight_line():
    arm = fed()
    begin = entry(arm)
    curve = pp.find_path(pp.Scene({}), None, begin + (0.5, 0.0, 0.0), arm)
    assert curve.length == pytest.approx(0.5)
    assert sampled_bends(curve).max() < 1e-6


def test_it_goes_round_a_wall():
    arm = fed()
    begin = entry(arm)
    wall = pp.Scene({"wall": pp.Box(tuple(begin + (0.25, 0.0, 0.0)), (0.02, 0.2, 2.0))}, arm_radius=RADIUS)
    curve = pp.find_path(wall, None, begin + (0.5, 0.0, 0.0), arm, budget=20.0)
    places = curve.at(np.linspace(0.0, curve.length, 4000)) - begin
    beside = np.abs(places[:, 0] - 0.25) <= 0.01
    assert np.abs(places[beside, 1]).min() > 0.1 + RADIUS
    assert curve.length > 2.0 * np.hypot(0.25, 0.1)


def test_an_arm_without_a_feed_starts_at_its_base_in_its_own_direction():
    arm = pp.Arm.from_template(
        "RyRz", modules=14, base_placement=pin.SE3(pin.rpy.rpyToMatrix(0, 0, 1.0), np.ones(3))
    )
    goal = np.ones(3) + (0.3, 0.4, 0.1)
    curve = pp.find_path(pp.Scene({}), None, goal, arm)
    np.testing.assert_allclose(curve.start, np.ones(3), atol=1e-9)
    np.testing.assert_allclose(curve.tangent(0.0), (np.cos(1.0), np.sin(1.0), 0.0), atol=1e-9)
    assert arm.can_follow(curve)
    chosen = pp.find_path(pp.Scene({}), (1.1, 1.0, 1.0), goal, arm, direction=(0, 2, 0))
    np.testing.assert_allclose(chosen.start, (1.1, 1.0, 1.0), atol=1e-9)
    np.testing.assert_allclose(chosen.tangent(0.0), (0.0, 1.0, 0.0), atol=1e-9)


@pytest.mark.long
def test_the_path_of_a_planar_arm_stays_in_its_plane():
    arm = fed("Rz")
    begin = entry(arm)
    post = pp.Scene({"post": pp.Capsule(tuple(begin + (0.3, 0.01, -1)), tuple(begin + (0.3, 0.01, 1)), 0.05)})
    curve = pp.find_path(post, None, begin + (0.6, 0.05, 0.0), arm, budget=20.0)
    places = curve.at(np.linspace(0.0, curve.length, 2000)) - begin
    assert np.abs(places[:, 2]).max() < 1e-9
    assert np.linalg.norm(places[:, :2] - (0.3, 0.01), axis=1).min() > 0.055
    with pytest.raises(pp.PostureError, match="off the plane"):
        pp.find_path(post, None, begin + (0.6, 0.05, 0.1), arm)


@pytest.mark.long
def test_a_seed_gives_the_same_path_again():
    arm = fed()
    goal = entry(arm) + (0.5, 0.05, 0.0)
    scene, _ = cluttered(1, entry(arm), goal)
    first, again, other = (pp.find_path(scene, None, goal, arm, seed=k, budget=60.0) for k in (3, 3, 4))
    assert first == again
    assert first != other


@pytest.mark.long
def test_what_cannot_be_found_says_why():
    arm = fed()
    begin = entry(arm)
    goal = begin + (0.5, 0.0, 0.0)
    closed = pp.Scene({"wall": pp.Box(tuple(begin + (0.3, 0, 0)), (0.02, 9.0, 9.0))})
    with pytest.raises(pp.PostureError, match="no path was found: the tree did not reach the goal"):
        pp.find_path(closed, None, goal, arm, budget=0.5)
    with pytest.raises(pp.PostureError, match=r"the goal is 20 mm inside 'ball'"):
        pp.find_path(pp.Scene({"ball": pp.Sphere(tuple(goal), 0.02)}), None, goal, arm)
    beside = {"ball": pp.Sphere(tuple(begin + (0, 0, 0.03)), 0.02), "box": pp.Sphere(tuple(goal), 0.02)}
    with pytest.raises(pp.PostureError, match="the goal is 20 mm") as caught:
        pp.find_path(pp.Scene(beside, margin=0.004, arm_radius=0.02), None, goal, arm)
    assert "the start is 10 mm from 'ball'" in str(caught.value)  # both at once
    assert "20 mm for the radius of the arm, 4 mm for the margin" in str(caught.value)
    with pytest.raises(pp.PostureError, match=r"2 m from the start; the arm can follow 700 mm"):
        pp.find_path(pp.Scene({}), None, begin + (2.0, 0.0, 0.0), arm)
    with pytest.raises(pp.PostureError, match="away from the start"):
        pp.find_path(pp.Scene({}), None, begin, arm)


@pytest.mark.parametrize(
    ("changed", "named"),
    [
        ({"scene": None}, "scene"),
        ({"arm": "arm"}, "arm"),
        ({"start": (0, np.nan, 0)}, "start"),
        ({"goal": "there"}, "goal"),
        ({"direction": (0, 0, 0)}, "direction"),
        ({"seed": -1}, "seed"),
        ({"budget": 0.0}, "budget"),
        ({"budget": "long"}, "budget"),
    ],
)
def test_bad_input_is_named(changed, named):
    given = {"scene": pp.Scene({}), "start": None, "goal": (2.0, 0.0, 0.0), "arm": fed(), **changed}
    with pytest.raises(pp.PostureError, match=f"^{named}"):
        pp.find_path(**given)
