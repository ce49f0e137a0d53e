"""Poses of bodies and the line through the arm, against Pinocchio."""

from __future__ import annotations

from functools import cache

import numpy as np
import pinocchio as pin
import pytest
from hypothesis import given
from hypothesis import strategies as st
from pinocchio.visualize import MeshcatVisualizer
from viz.commands import recorded_commands

from pinposture import Arm, JointSpec, ModuleTemplate
from pinposture.arm import continuum_section
from pinposture.errors import InvalidValue
from pinposture.viz import palette, visual_model
from pinposture.viz.body import backbone, bodies, body_poses
from pinposture.viz.drawing import arm_surfaces
from pinposture.viz.palette import THEME

TILTED = pin.SE3(pin.rpy.rpyToMatrix(0.3, -0.8, 1.9), np.array([0.2, -0.1, 0.4]))
SLIDING = ModuleTemplate(
    "TiltSlideTurn",
    (
        JointSpec((1.0, 2.0, -0.5)),
        JointSpec("x", type="prismatic", lower=-0.02, upper=0.1),
        JointSpec("z", type="continuous", lower=-np.inf, upper=np.inf),
    ),
    (0.03, 0.0, 0.05),
)


def branching_model() -> pin.Model:
    """Three joints in a chain with turned frames, and one on a branch that the arm does not use."""
    rng = np.random.default_rng(3)
    model = pin.Model()
    parent = 0
    for name, kind in (("a", pin.JointModelRX()), ("b", pin.JointModelPY()), ("c", pin.JointModelRZ())):
        placement = pin.SE3(pin.rpy.rpyToMatrix(*rng.uniform(-2, 2, 3)), rng.uniform(-0.3, 0.3, 3))
        parent = model.addJoint(parent, kind, placement, name)
        if name == "b":
            model.addJoint(parent, pin.JointModelRX(), pin.SE3.Identity(), "branch")
    offset = pin.SE3(np.eye(3), np.array([0.1, 0.2, 0.0]))
    model.addFrame(pin.Frame("tip", parent, offset, pin.FrameType.OP_FRAME))
    model.upperPositionLimit[:] = 2.0
    model.lowerPositionLimit[:] = -2.0
    model.addFrame(pin.Frame("middle", 1, offset, pin.FrameType.OP_FRAME))
    return model


ARMS = {
    "RyRz": lambda: Arm.from_template("RyRz", modules=5, base_placement=TILTED),
    "planar": lambda: Arm.from_template("Rz", modules=4),
    "sliding": lambda: Arm.from_modules([SLIDING] * 3, base_placement=TILTED),
    "coupled": lambda: Arm.from_modules([continuum_section(3, stretch=0.05)] * 3, base_placement=TILTED),
    "model": lambda: Arm.from_model(branching_model(), ["middle", "tip"], base_placement=TILTED),
}


@cache
def arm_named(name: str) -> Arm:
    return ARMS[name]()


def pinocchio_poses(arm: Arm, q: np.ndarray) -> np.ndarray:
    data = arm.model.createData()
    pin.forwardKinematics(arm.model, data, q)
    return np.array([data.oMi[arm.model.getJointId(name)].homogeneous for name in arm.chain.joints])


@pytest.mark.parametrize("name", ARMS)
@given(seed=st.integers(0, 10**6))
def test_bodies_move_as_pinocchios_joints_do(name, seed):
    arm = arm_named(name)
    q = arm.random(np.random.default_rng(seed))
    expected = pinocchio_poses(arm, q)
    neutral = pinocchio_poses(arm, arm.neutral())
    poses = body_poses(arm, q)
    np.testing.assert_allclose(poses[:, :3, 3], expected[:, :3, 3], atol=1e-12)
    # A body's axes are those of the world at the neutral configuration, a joint frame's are the model's own.
    np.testing.assert_allclose(poses[:, :3, :3] @ neutral[:, :3, :3], expected[:, :3, :3], atol=1e-12)
    np.testing.assert_array_equal(poses[:, 3], np.tile([0, 0, 0, 1], (len(poses), 1)))


@pytest.mark.parametrize("name", ARMS)
def test_control_points_are_fixed_to_their_bodies(name):
    arm = arm_named(name)
    q = arm.random(np.random.default_rng(0))
    carried = [
        (pose @ np.append(body.point, 1.0))[:3]
        for body, pose in zip(bodies(arm), body_poses(arm, q), strict=True)
        if body.point is not None
    ]
    np.testing.assert_allclose(carried, arm.at(q).points, atol=1e-12)


@pytest.mark.parametrize("name", ARMS)
def test_backbone_runs_from_the_base_through_every_control_point_to_the_tip(name):
    arm = arm_named(name)
    q = arm.random(np.random.default_rng(1))
    line = backbone(arm, q)
    points = arm.at(q).points
    np.testing.assert_allclose(line[0], arm.chain.base, atol=1e-12)
    np.testing.assert_allclose(line[-1], points[-1], atol=1e-12)
    distances = np.linalg.norm(line[:, None] - points, axis=2)
    assert np.all(distances.min(axis=0) < 1e-12)
    assert np.all(np.diff(distances.argmin(axis=0)) > 0)


@pytest.mark.parametrize("name", ["RyRz", "planar"])
def test_backbone_keeps_the_length_of_an_arm_that_only_turns(name):
    arm = arm_named(name)
    line = backbone(arm, arm.random(np.random.default_rng(2)))
    assert np.linalg.norm(np.diff(line, axis=0), axis=1).sum() == pytest.approx(arm.length, abs=1e-12)


def test_several_configurations_at_once_are_as_one_by_one():
    arm = arm_named("sliding")
    rng = np.random.default_rng(4)
    rows = np.array([arm.random(rng) for _ in range(7)])
    together = body_poses(arm, rows)
    assert together.shape == (7, arm.nv, 4, 4)
    for pose, q in zip(together, rows, strict=True):
        np.testing.assert_array_equal(pose, body_poses(arm, q))


def test_modules_of_bodies_follow_the_joints_of_the_arm():
    arm = arm_named("sliding")
    assert [body.module for body in bodies(arm)] == [0, 0, 0, 1, 1, 1, 2, 2, 2]
    assert [body.joint for body in bodies(arm)] == [name for module in arm.module_joints for name in module]


def test_only_joints_that_slide_reach_back_along_their_axis():
    arm = arm_named("sliding")
    reach = [np.linalg.norm(body.slide) for body in bodies(arm)]
    np.testing.assert_allclose(reach, [0.0, 0.1, 0.0] * 3, atol=1e-12)


def test_a_slide_without_a_limit_has_no_rod():
    model = branching_model()
    model.upperPositionLimit[:] = np.finfo(float).max
    model.lowerPositionLimit[:] = -np.finfo(float).max
    arm = Arm.from_model(model, ["middle", "tip"])
    assert not arm.chain.revolute.all()
    np.testing.assert_array_equal([body.slide for body in bodies(arm)], np.zeros((3, 3)))


@pytest.mark.parametrize("q", [np.zeros(3), np.full(10, np.nan)])
def test_configurations_that_do_not_fit_are_refused(q):
    with pytest.raises(InvalidValue):
        body_poses(arm_named("RyRz"), q)


@pytest.mark.parametrize("name", ARMS)
def test_pinocchios_visualizer_shows_the_drawn_bodies_where_they_are(name):
    arm = arm_named(name)
    q = arm.random(np.random.default_rng(5))

    def show(viewer):
        shown = MeshcatVisualizer(arm.model, visual_model=visual_model(arm))
        shown.initViewer(viewer)
        shown.loadViewerModel("arm")
        shown.display(q)

    commands = recorded_commands(show)
    drawn = {c["path"].rpartition("/")[2]: c["object"] for c in commands if c["type"] == "set_object"}
    placed = {c["path"].rpartition("/")[2]: c["matrix"] for c in commands if c["type"] == "set_transform"}
    names = [f"body_{u + 1:03d}" for u in range(len(arm.chain.joints))]
    assert list(drawn) == ["base", *names]
    np.testing.assert_allclose(np.reshape(placed["base"], (4, 4)), np.eye(4), atol=1e-12)
    poses = np.array([np.reshape(placed[each], (4, 4)).T for each in names])
    np.testing.assert_allclose(poses, body_poses(arm, q), atol=1e-12)
    surfaces = arm_surfaces(arm)
    for each, mesh in zip(["base", *names], [surfaces.base, *surfaces.bodies], strict=True):
        packed = drawn[each]["geometries"][0]["data"]["attributes"]["position"]["array"].data
        np.testing.assert_allclose(np.frombuffer(packed, "<f4").reshape(-1, 3), mesh.vertices, atol=1e-6)
    color = drawn["base"]["materials"][0]["color"].to_bytes(3, "big")
    np.testing.assert_allclose(list(color), np.multiply(palette.rgb(THEME.base), 255.0), atol=1.01)
