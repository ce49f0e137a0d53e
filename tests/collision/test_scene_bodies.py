"""The bodies of an arm: its collision geometry, or what stands in for it."""

from __future__ import annotations

import warnings
from pathlib import Path

import numpy as np
import pinocchio as pin
import pytest
import trimesh
from collision.arms_with_bodies import PLACED, described, geometry, modelled, planar, sliding, spatial

import pinposture as pp
from pinposture.collision import Box, Capsule, CollisionModel, Cylinder, Mesh, Scene, Sphere
from pinposture.collision.bodies import STAND_IN_RADIUS, bodies_of
from pinposture.errors import PostureWarning


def in_world(arm, body, q, point):
    data = arm.model.createData()
    pin.forwardKinematics(arm.model, data, q)
    return data.oMi[body.joint].act(np.array(point))


def test_a_template_arm_is_a_chain_of_capsules_with_a_flat_end():
    arm = spatial(5)
    bodies = bodies_of(arm)
    assert [type(body.shape) for body in bodies] == [Capsule] * 9 + [Cylinder]
    assert [body.name for body in bodies] == [f"m0{m}_l{j}" for m in range(1, 6) for j in (1, 2)]
    q = arm.random(np.random.default_rng(0))
    end = in_world(arm, bodies[0], q, bodies[0].shape.start)
    np.testing.assert_allclose(end, PLACED.translation, atol=1e-12)
    for body, following in zip(bodies, (*bodies[1:], None), strict=True):
        np.testing.assert_allclose(in_world(arm, body, q, body.shape.start), end, atol=1e-9)
        end = in_world(arm, body, q, body.shape.end)
        assert body.shape.radius == 0.01
        if following is None:
            np.testing.assert_allclose(end, arm.at(q).points[-1], atol=1e-9)


@pytest.mark.parametrize("radius", [None, 0.02])
def test_in_a_further_scene_an_arm_is_where_a_new_one_is(radius):
    arm = spatial(5)
    CollisionModel(arm, Scene({"wall": Box((0.5, 0, 0), (0.1, 1, 1))}))
    CollisionModel(arm, Scene({"wall": Box((0.5, 0, 0), (0.1, 1, 1))}, arm_radius=0.005))
    scene = Scene({"ball": Sphere((0.1, 0.3, 0.2), 0.05)}, arm_radius=radius)
    model = CollisionModel(arm, scene)
    alone = CollisionModel(spatial(5), scene)
    assert model.pairs == alone.pairs
    for seed in range(5):
        q = arm.random(np.random.default_rng(seed))
        assert model.minimum(q).distance == alone.minimum(q).distance
        assert model.minimum(q).pair == alone.minimum(q).pair


@pytest.mark.long
def test_the_chain_of_capsules_is_as_far_from_things_as_the_balls_and_tubes():
    arm = spatial(4)
    rng = np.random.default_rng(0)
    q = arm.random(rng)
    data = arm.model.createData()
    pin.framesForwardKinematics(arm.model, data, q)
    solids = []
    for frame, place in zip(arm.model.frames, data.oMf, strict=True):
        if frame.type == pin.FrameType.BODY and frame.name.startswith("m"):
            length = 0.04 if frame.name.endswith("l1") else 0.05
            solids.append(Sphere(place.translation, 0.01))
            solids.append(Cylinder(place.translation, place.act(np.array([length, 0, 0])), 0.01))
    assert len(solids) == 16
    for _ in range(50):
        probe = Sphere(arm.chain.base + rng.normal(size=3) * 0.2, 0.02)
        # The distance of the probe from each solid, by asking for one whose arm it is.
        apart = min(
            np.linalg.norm(np.array(probe.center) - solid_point(probe.center, each)) - 0.02 for each in solids
        )
        if apart > -0.01:
            found = (
                CollisionModel(arm, Scene({"o": probe}, self_collision=False, margin=0.0)).minimum(q).distance
            )
            assert found == pytest.approx(apart, abs=1e-7)


def solid_point(place, shape):
    from collision.solids_by_hand import project

    return project(np.array(place), shape)


def test_balls_that_move_away_do_not_round_a_tube():
    bodies = bodies_of(sliding(2))
    kinds = [type(body.shape) for body in bodies if body.name == "m01_l2"]
    assert kinds == [Cylinder]  # the joint at its end slides off with the ball
    assert {type(body.shape) for body in bodies if body.name == "m02_l3"} == {Sphere, Cylinder}
    assert [type(body.shape) for body in bodies if body.name == "m01_l1"] == [Capsule]


@pytest.mark.parametrize("make", [spatial, planar, modelled])
def test_stand_ins_run_from_joint_to_joint_and_to_the_tip(make):
    arm = make()
    bodies = bodies_of(arm, 0.02)
    assert all(isinstance(body.shape, Capsule) and body.shape.radius == 0.02 for body in bodies)
    assert [body.name for body in bodies] == list(arm.chain.joints)
    q = arm.random(np.random.default_rng(1))
    before = arm.chain.base
    for body in bodies:
        np.testing.assert_allclose(in_world(arm, body, q, body.shape.start), before, atol=1e-9)
        before = in_world(arm, body, q, body.shape.end)
    np.testing.assert_allclose(before, arm.at(q).points[-1], atol=1e-9)


def test_a_joint_that_slides_leaves_no_gap_behind():
    arm = sliding(2)
    q = arm.configuration(np.array([0.3, 0.2, 0.05, -0.4, 0.1, 0.05]))
    bodies = bodies_of(arm, 0.004)
    ends = [[in_world(arm, body, q, end) for end in (body.shape.start, body.shape.end)] for body in bodies]
    for k, joint in enumerate(arm.chain.joints[1:], 1):
        own = [ends[i][0] for i, body in enumerate(bodies) if body.name == joint]
        before = [ends[i] for i, body in enumerate(bodies) if body.name == arm.chain.joints[k - 1]]
        gap = min(
            np.linalg.norm(start - a - np.clip((start - a) @ (b - a) / ((b - a) @ (b - a)), 0, 1) * (b - a))
            for start in own
            for a, b in before
        )
        assert gap < 1e-9


def test_an_arm_without_geometry_has_stand_ins_of_usual_thickness():
    arm = modelled()
    radius = STAND_IN_RADIUS * arm.chain.module_lengths.mean()
    assert {body.shape.radius for body in bodies_of(arm)} == {radius}
    bare = pp.Arm.load(described([""] * 4), split=2)
    assert {type(body.shape) for body in bodies_of(bare)} == {Capsule}
    # Geometry of the base alone does not mean that all the rest is thin air.
    based = pp.Arm.load(described([""] * 4, base=geometry('<sphere radius="0.1"/>')), split=2)
    assert [body.joint for body in bodies_of(based)] == [0, 1, 2, 3, 4]


def test_every_kind_of_geometry_is_read_where_its_link_is():
    shapes = ['<box size="1 2 3"/>', '<sphere radius="0.1"/>', '<cylinder radius="0.1" length="0.4"/>']
    shapes.append('<capsule radius="0.1" length="0.4"/>')
    text = described([geometry(shape, "0.1 0.2 0.3", "0 1.5707963267948966 0") for shape in shapes])
    arm = pp.Arm.load(text, split=2, base_placement=PLACED)
    box, ball, tube, rounded = bodies_of(arm)
    turn = pin.rpy.rpyToMatrix(0, np.pi / 2, 0)
    assert box.shape == Box((0.1, 0.2, 0.3), (1, 2, 3), turn)
    assert ball.shape == Sphere((0.1, 0.2, 0.3), 0.1)
    for body, kind in ((tube, Cylinder), (rounded, Capsule)):
        assert isinstance(body.shape, kind)
        np.testing.assert_allclose(body.shape.start, (-0.1, 0.2, 0.3), atol=1e-12)
        np.testing.assert_allclose(body.shape.end, (0.3, 0.2, 0.3), atol=1e-12)
    assert [body.name for body in (box, ball, tube, rounded)] == ["l1", "l2", "l3", "l4"]
    assert [body.joint for body in bodies_of(arm)] == [1, 2, 3, 4]


def test_the_base_stands_where_the_base_placement_puts_it():
    ball = geometry('<sphere radius="0.1"/>', "0.1 0 0")
    arm = pp.Arm.load(described([ball, ball], base=ball), split=2, base_placement=PLACED)
    base = bodies_of(arm)[0]
    assert base.joint == 0
    np.testing.assert_allclose(base.shape.center, PLACED.act(np.array([0.1, 0, 0])), atol=1e-12)


def test_links_held_still_move_with_the_joint_before():
    ball = geometry('<sphere radius="0.02"/>', "0.1 0 0")
    arm = pp.Arm.load(described([ball] * 3), split=2, locked={"j3": 0.5})
    assert [body.joint for body in bodies_of(arm)] == [1, 2, 2]
    turn = pin.rpy.rpyToMatrix(0, 0.5, 0)
    np.testing.assert_allclose(bodies_of(arm)[2].shape.center, [0.2, 0, 0] + turn @ [0.1, 0, 0], atol=1e-12)


MESH = '<mesh filename="{}" scale="0.001 0.001 -0.002"/>'


def test_meshes_become_hulls_and_missing_ones_capsules(tmp_path):
    trimesh.creation.box((100, 40, 20)).export(tmp_path / "there.stl")
    (tmp_path / "broken.stl").write_text("solid nothing")
    links = [geometry(MESH.format(name), "0.1 0 0") for name in ("there.stl", "gone.stl", "broken.stl")]
    links.append(geometry('<cylinder radius="-1" length="1"/>'))
    (tmp_path / "arm.urdf").write_text(described(links))
    arm = pp.Arm.load(tmp_path / "arm.urdf", split=2)
    with pytest.warns(PostureWarning) as caught:
        bodies = bodies_of(arm)
    message = str(caught[0].message)
    assert len(caught) == 1
    for words in ("capsules stand in", "link 'l2': gone.stl: not found", "link 'l3'", "link 'l4': radius"):
        assert words in message
    assert [type(body.shape) for body in bodies] == [Mesh, Capsule, Capsule, Capsule]
    np.testing.assert_allclose(np.ptp(bodies[0].shape.vertices, axis=0), (0.1, 0.04, 0.04), rtol=1e-6)
    assert bodies[0].shape.center == (0.1, 0, 0)
    assert [body.name for body in bodies] == ["l1", "j2", "j3", "j4"]
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        assert all(isinstance(body.shape, Capsule) for body in bodies_of(arm, 0.01))


def test_meshes_of_links_in_millimetres_are_named(tmp_path):
    trimesh.creation.box((100, 40, 20)).export(tmp_path / "link.stl")
    links = [geometry(f'<mesh filename="link.stl"{scale}/>') for scale in (' scale="1e-3 1e-3 1e-3"', "")]
    (tmp_path / "arm.urdf").write_text(described(links))
    arm = pp.Arm.load(tmp_path / "arm.urdf", split=2)
    words = r"mesh of link 'l2' is 100 m wide, 250 times as long as the arm; .* <mesh scale"
    with pytest.warns(PostureWarning, match=words) as caught:
        bodies_of(arm)
    assert len(caught) == 1


@pytest.mark.parametrize(
    "shape", ["", "<cone/>", '<box size="1 2"/>', '<sphere radius="x"/>', "<sphere/>", "<mesh/>"]
)
def test_geometry_that_makes_no_solid_is_named(shape):
    arm = pp.Arm.load(described([geometry(shape), geometry('<sphere radius="0.1"/>')]), split=2)
    with pytest.warns(PostureWarning, match="link 'l1'"):
        bodies = bodies_of(arm)
    assert [type(body.shape) for body in bodies] == [Capsule, Sphere]


def test_a_robot_with_meshes_of_its_own():
    robots = next(
        folder
        for above in Path(pin.__file__).resolve().parents
        for folder in (
            above / "share/example-robot-data/robots",
            above / "cmeel.prefix/share/example-robot-data/robots",
        )
        if folder.is_dir()
    )
    arm = pp.Arm.load(
        robots / "ur_description/urdf/ur5_robot.urdf", package_dirs=[robots.parents[1]], base_placement=PLACED
    )
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        clearance = CollisionModel(
            arm, Scene({"o": Sphere(PLACED.act(np.array([0.4, 0.3, 0.3])), 0.1)}, True)
        )
    assert {type(body.shape) for body in bodies_of(arm)} >= {Mesh}
    assert clearance.minimum(arm.straight()).distance > 0.0
    q = arm.configuration(np.linspace(-1.0, 1.0, 6))
    h = 1e-6
    near = clearance.nearest(arm.at(q), np.inf)
    for u in range(arm.nv):
        step = h * np.eye(arm.nv)[u]
        slope = clearance.minimum(arm.integrate(q, step))[0] - clearance.minimum(arm.integrate(q, -step))[0]
        assert slope / (2 * h) == pytest.approx(near.jacobian[0, u], abs=1e-4)
