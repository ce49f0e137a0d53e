"""Obstacles that the arm carries: their distances, what holds them, plans around others, and scene files."""

from __future__ import annotations

import pickle
from dataclasses import replace

import numpy as np
import pinocchio as pin
import pytest
from arms import template_arm

import pinposture as pp
from pinposture.collision.bodies import scene_at
from pinposture.errors import InvalidValue, UnknownName
from pinposture.sim import ContactModel, simulate

RADIUS = 0.03
LEVER = np.array([0.02, 0.03, 0.05])
POST = pp.Sphere((0.35, 0.2, 0.0), 0.05)
FLOOR = pp.HalfSpace((0.0, 0.0, -0.4), (0.0, 0.0, 1.0))


def carrying(frame: str, **more) -> pp.Scene:
    """A ball beside a frame, which carries it, and two obstacles."""
    ball = pp.Sphere(tuple(LEVER), RADIUS)
    scene = {"ball": ball, "post": POST, "floor": FLOOR}
    return pp.Scene(scene, carried={"ball": pp.Carried(frame)}, **more)


def ball_of(arm: pp.Arm, q: np.ndarray, point: int) -> np.ndarray:
    """The middle of the ball that a control point carries, by its own way."""
    state = arm.at(q)
    return state.points[point] + state.rotations[point] @ LEVER


def test_distances_are_those_of_a_ball_that_moves_with_the_frame():
    arm = template_arm("RyRz", 6)
    model = pp.CollisionModel(arm, carrying(arm.control_points[3]))
    rng = np.random.default_rng(1)
    for _ in range(20):
        q = arm.random(rng)
        middle = ball_of(arm, q, 3)
        near = model.nearest(arm.at(q), np.inf)
        found = dict(zip(near.pairs, near.distances, strict=True))
        to_post = np.linalg.norm(middle - POST.center) - RADIUS - POST.radius
        assert found["ball", "post"] == pytest.approx(to_post, abs=1e-9)
        assert found["ball", "floor"] == pytest.approx(middle[2] + 0.4 - RADIUS, abs=1e-9)
        # Derivatives, by differences of that distance.
        row = near.pairs.index(("ball", "post"))
        for j in rng.choice(arm.nv, 3, replace=False):
            step = 1e-6 * np.eye(arm.nv)[j]
            ends = [
                np.linalg.norm(ball_of(arm, arm.integrate(q, s * step), 3) - POST.center) for s in (1.0, -1.0)
            ]
            assert near.jacobian[row, j] == pytest.approx((ends[0] - ends[1]) / 2e-6, abs=1e-6)


def test_what_lies_beyond_the_frame_holds_it_and_the_rest_of_the_arm_keeps_clear():
    arm = template_arm("RyRz", 6)
    model = pp.CollisionModel(arm, carrying(arm.control_points[3]))
    beside = {pair[1] for pair in model.pairs if pair[0] == "ball"} - {"post", "floor"}
    assert beside
    assert all(body < "m04" for body in beside)  # m04_l2 carries it
    assert not [pair for pair in model.pairs if pair[1] == "ball"]
    plugged = replace(
        carrying(arm.control_points[3]), carried={"ball": pp.Carried("module_04", beside=["floor"])}
    )
    assert ("ball", "floor") not in pp.CollisionModel(arm, plugged).pairs
    assert ("ball", "post") in pp.CollisionModel(arm, plugged).pairs


def test_where_the_frame_was_says_where_the_obstacle_is_in_it():
    arm = template_arm("RyRz", 6)
    q = arm.random(np.random.default_rng(4))
    state = arm.at(q)
    frame = pin.SE3(np.array(state.rotations[3]), np.array(state.points[3]))
    carried = pp.Carried("module_04", position=frame.translation, rotation=frame.rotation)
    world = pp.Scene(
        {"ball": pp.Sphere(tuple(ball_of(arm, q, 3)), RADIUS), "post": POST}, carried={"ball": carried}
    )
    there = arm.random(np.random.default_rng(5))
    for scene in (world, world.moved({"post": (0.0, 0.0, 0.1)}), world.moved({"ball": (1.0, 0.0, 0.0)})):
        near = pp.CollisionModel(arm, scene).nearest(arm.at(there), np.inf)
        apart = dict(zip(near.pairs, near.distances, strict=True))["ball", "post"]
        expected = (
            np.linalg.norm(ball_of(arm, there, 3) - scene.obstacles["post"].center) - RADIUS - POST.radius
        )
        assert apart == pytest.approx(expected, abs=1e-9)
    np.testing.assert_allclose(
        scene_at(arm, there, world).obstacles["ball"].center, ball_of(arm, there, 3), atol=1e-9
    )
    assert not scene_at(arm, there, world).carried


@pytest.mark.long
def test_plans_and_trackers_keep_the_ball_clear():
    arm = template_arm("RyRz", 8)
    # The tip swings past a post that only the ball would hit.
    ball = pp.Sphere((0.0, 0.0, -0.08), RADIUS)
    post = pp.Cylinder((0.39, 0.0, -0.5), (0.39, 0.0, -0.05), 0.02)
    scene = pp.Scene({"ball": ball, "post": post}, carried={"ball": pp.Carried("module_08")})
    ends = [arm.configuration([0.0, side] * 8) for side in (-0.09, 0.09)]
    target = pp.Target.from_configuration(arm, ends[1])

    def distance(q):
        state = arm.at(q)
        x, y, z = state.points[-1] + state.rotations[-1] @ np.array(ball.center)
        out = np.hypot(x - 0.39, y) - 0.02
        up = z + 0.05
        return np.hypot(max(out, 0.0), max(up, 0.0)) - RADIUS

    alone = pp.track(arm, target, ends[0], limits=pp.Limits(step=0.02), scene=pp.Scene({"post": post}))
    clear = pp.track(arm, target, ends[0], limits=pp.Limits(step=0.02), scene=scene)
    assert clear.status == "converged"
    assert min(map(distance, alone.q)) < 0.0
    assert min(map(distance, clear.q)) >= scene.margin - 1e-6
    tracker = pp.Tracker(
        arm, limits=pp.Limits(step=None, dt=0.02, velocity=1.0, acceleration=4.0), scene=scene
    )
    tracker.update(target)
    q = ends[0]
    nearest = []
    for _ in range(400):
        q = arm.integrate(q, tracker.step(q))
        nearest.append(distance(q))
    assert min(nearest) >= scene.margin - 1e-6
    np.testing.assert_allclose(arm.at(q).points, target.points, atol=5e-3)


def test_scenes_with_what_the_arm_carries_are_saved_copied_and_compared(tmp_path):
    scene = carrying("tip", touchable=["floor"])
    turned = replace(scene, carried={"ball": pp.Carried("tip", (0.1, 0.0, 0.0), (0.1, 0.2, 0.3), ["floor"])})
    for each in (scene, turned):
        assert pp.Scene.load(each.save(tmp_path / "scene.json")) == each
        assert pickle.loads(pickle.dumps(each)) == each
        assert pickle.loads(pickle.dumps(each.moved({"post": (0.0, 0.0, 0.1)}))).carried == each.carried
    assert scene != turned != replace(scene, carried={})
    assert "carried: ball" in repr(scene)
    assert scene.with_obstacles({"post": POST}).carried == {}
    assert turned.with_obstacles({"ball": POST}).carried["ball"].beside == ()
    file = tmp_path / "scene.toml"
    file.write_text(
        'carried = { ball = { frame = "tip", position = ["10 cm", 0, 0], beside = ["floor"] } }\n'
        "[obstacles]\n"
        'ball = { type = "sphere", center = [0, 0, 0.1], radius = 0.02 }\n'
        'floor = { type = "half_space", point = [0, 0, -0.4], normal = [0, 0, 1] }\n'
    )
    assert pp.Scene.load(file).carried["ball"] == pp.Carried("tip", (0.1, 0.0, 0.0), beside=["floor"])


@pytest.mark.parametrize(
    ("carried", "error", "named"),
    [
        ({"nothing": pp.Carried("tip")}, UnknownName, "nothing"),
        ({"ball": pp.Carried("tip", beside=["nothing"])}, UnknownName, "nothing"),
        ({"floor": pp.Carried("tip")}, InvalidValue, "floor"),
        ({"ball": "tip"}, InvalidValue, "ball"),
        ("ball", InvalidValue, "carried"),
    ],
)
def test_what_cannot_be_carried_is_refused_by_name(carried, error, named):
    with pytest.raises(error, match=named):
        pp.Scene({"ball": POST, "floor": FLOOR}, carried=carried)


def test_a_frame_that_the_arm_lacks_and_contact_are_refused():
    arm = template_arm("RyRz", 4)
    with pytest.raises(UnknownName, match="hand"):
        pp.CollisionModel(arm, carrying("hand"))
    q = np.stack([arm.straight(), arm.straight()])
    with pytest.raises(InvalidValue, match="carries nothing"):
        simulate(arm, q, dt=0.02, hold=0.0, scene=carrying("module_04"), contact=ContactModel())
