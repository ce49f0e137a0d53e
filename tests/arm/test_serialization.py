"""Models as plain data: what is built from them equals, bit by bit, what was described."""

from __future__ import annotations

import copy
import json
import pickle

import numpy as np
import pinocchio as pin
import pytest
from arm.test_coupled_joints import coupled_arm
from sampling import seeds

import pinposture as pp
from pinposture.arm.serialization import ModelData
from pinposture.errors import InvalidValue, PostureError
from pinposture.schema import as_plain, read_plain

UNIT = np.array([0.36, 0.48, 0.8])
KINDS = {
    "turns about x": pin.JointModelRX(),
    "turns about an axis": pin.JointModelRevoluteUnaligned(UNIT),
    "slides along z": pin.JointModelPZ(),
    "slides along an axis": pin.JointModelPrismaticUnaligned(UNIT),
    "turns without end": pin.JointModelRUBY(),
    "helical": pin.JointModelHX(0.3),
    "helical about an axis": pin.JointModelHelicalUnaligned(UNIT, 0.3),
    "spherical": pin.JointModelSpherical(),
    "three angles": pin.JointModelSphericalZYX(),
    "free": pin.JointModelFreeFlyer(),
    "planar": pin.JointModelPlanar(),
    "translation": pin.JointModelTranslation(),
    "universal": pin.JointModelUniversal(np.array([1.0, 0.0, 0.0]), np.array([0.0, 0.6, 0.8])),
    "ellipsoid": pin.JointModelEllipsoid(0.1, 0.2, 0.3),
}


def read_back(model: pin.Model) -> pin.Model:
    described = json.loads(json.dumps(as_plain(ModelData.of(model))))
    return read_plain(ModelData, described, folder=".").build()


def poses(model: pin.Model, q: np.ndarray) -> np.ndarray:
    data = model.createData()
    pin.framesForwardKinematics(model, data, q)
    return np.array([np.array(place.homogeneous) for place in data.oMf])


@pytest.mark.parametrize("seed", seeds(20))
def test_random_models_of_all_kinds_of_joints_are_equal(seed):
    rng = np.random.default_rng(seed)
    pin.seed(seed)
    model = pin.Model()
    model.name, model.gravity = "all kinds", pin.Motion(rng.normal(size=6))
    for number, (name, kind) in enumerate(rng.permutation(list(KINDS.items())), 1):
        joint = model.addJoint(int(rng.integers(number)), kind, pin.SE3.Random(), name)
        model.addJointFrame(joint)
        model.appendBodyToJoint(joint, pin.Inertia.Random(), pin.SE3.Random())
        model.addBodyFrame(f"{name} body", joint, pin.SE3.Random(), model.nframes - 1)
    for vector in ("lowerPositionLimit", "upperPositionLimit", "velocityLimit", "armature", "damping"):
        setattr(model, vector, rng.normal(size=len(getattr(model, vector))))
    assert read_back(model) == model
    assert read_back(read_back(model)) == model


def test_composite_joints_move_alike():
    whole = pin.JointModelComposite()
    for part in (pin.JointModelRX(), pin.JointModelPrismaticUnaligned(UNIT)):
        whole.addJoint(pin.JointModel(part), pin.SE3.Random())
    model = pin.Model()
    model.addJointFrame(model.addJoint(0, pin.JointModel(whole), pin.SE3.Random(), "whole"))
    q = np.array([0.3, -0.4])
    np.testing.assert_array_equal(poses(read_back(model), q), poses(model, q))


@pytest.mark.parametrize("seed", seeds(60))
def test_endless_joints_about_any_axis_keep_it(seed):
    axis = np.random.default_rng(seed).normal(size=3)
    text = (
        '<robot name="r"><link name="a"/><link name="b"/><joint name="j" type="continuous"><parent link="a"/>'
        f'<child link="b"/><axis xyz="{axis[0]} {axis[1]} {axis[2]}"/></joint></robot>'
    )
    model = pin.buildModelFromXML(text)
    assert read_back(model) == model


def followers(seed: int) -> pin.Model:
    """A model with mimic joints about random axes, with random ratios, as Pinocchio makes them."""
    rng = np.random.default_rng(seed)
    model = pin.Model()
    joint = 0
    for number in range(8):
        kind = pin.JointModelRY()
        axis = rng.normal(size=3)
        if number % 3:
            kind = pin.JointModelRevoluteUnaligned(axis / np.linalg.norm(axis))
        joint = model.addJoint(joint, kind, pin.SE3.Random(), f"j{number}")
        model.addFrame(pin.Frame(f"end{number}", joint, pin.SE3.Random(), pin.FrameType.OP_FRAME))
    model.lowerPositionLimit = np.full(8, -1.0)
    model.upperPositionLimit = np.full(8, 1.0)
    for follower, leader in ((2, 1), (4, 1), (6, 5)):
        ratio = rng.uniform(-2.0, 2.0)
        offset = rng.uniform(-0.5, 0.5)
        model = pin.transformJointIntoMimic(model, leader, follower, ratio, offset)
    return model


@pytest.mark.parametrize("seed", seeds(60))
def test_mimic_joints_made_by_pinocchio_move_alike_and_stay_as_they_were_first_read(seed):
    model = followers(seed)
    first = read_back(model)
    q = np.random.default_rng(seed).uniform(-1.0, 1.0, model.nq)
    np.testing.assert_allclose(poses(first, q), poses(model, q), rtol=0.0, atol=1e-14)
    assert read_back(first) == first
    np.testing.assert_array_equal(poses(read_back(first), q), poses(first, q))


def same_to_the_last_bit(arm: pp.Arm, again: pp.Arm) -> None:
    assert again.model == arm.model
    assert again.couplings == arm.couplings
    assert again.joint_names == arm.joint_names and again.control_points == arm.control_points
    for edge in ("lower", "upper", "velocity"):
        np.testing.assert_array_equal(getattr(again.limits, edge), getattr(arm.limits, edge))
    assert again.length == arm.length and again.characteristic_length == arm.characteristic_length
    assert again.report == arm.report and again.spec == arm.spec and again.urdf == arm.urdf
    q = arm.random(0)
    for one, other in ((arm.at(q), again.at(q)), (arm.chain_at(q), again.chain_at(q))):
        for name in ("points", "rotations", "jacobians", "axes"):
            np.testing.assert_array_equal(getattr(other, name), getattr(one, name))


@pytest.mark.parametrize("seed", seeds(12))
def test_arms_with_coupled_joints_are_the_same_after_pickling_copying_and_from_dict(seed):
    arm = coupled_arm(seed)
    for again in (
        pickle.loads(pickle.dumps(arm)),
        copy.copy(arm),
        copy.deepcopy(arm),
        pp.Arm.from_dict(json.loads(json.dumps(arm.to_dict()))),
    ):
        same_to_the_last_bit(arm, again)


@pytest.mark.parametrize("seed", seeds(12))
def test_arms_from_models_with_mimic_joints_are_the_same_after_pickling(seed):
    arm = pp.Arm.from_model(followers(seed), ["end3", "end5", "end7"])
    assert [each.joint for each in arm.couplings] == ["j1", "j3", "j5"] and arm.nv == 5
    same_to_the_last_bit(arm, pickle.loads(pickle.dumps(arm)))


def damaged(described: dict, *path: object, to: object) -> dict:
    changed = copy.deepcopy(described)
    at = changed
    for key in path[:-1]:
        at = at[key]
    at[path[-1]] = to
    return changed


@pytest.mark.parametrize(
    ("path", "value", "message"),
    [
        (("model", "joints", 1, "parent"), 7, "parent of joint"),
        (("model", "joints", 1, "parent"), -1, "joint 2, parent"),
        (("model", "joints", 1, "type"), "Planner", "joint 2, type: is 'Planner' .*Planar"),
        (("model", "joints", 1, "follows"), ["nobody", 1.0, 0.0], "no leading joint"),
        (("model", "joints", 1, "follows"), ["s0_0_y", 0.0, 0.0], "ratio"),
        (("model", "joint_placements", 0, 3), np.inf, "joint_placements"),
        (("model", "joint_placements", 0, 0), 2.0, "rotations"),
        (("model", "frames", 0, 2), 99, "joint of frame"),
        (("model", "frames", 0, 3), 10**6, "frame before frame"),
        (("model", "frames", 0, 1), "HAND", "no type of frame"),
        (("model", "inertias"), [[0.0] * 10], "inertias"),
        (("model", "bodies"), 10**12, "bodies"),
        (("model", "vectors", "upperVelocityLimit"), [1.0], "upperVelocityLimit"),
        (("model", "vectors", "lowerPositionLimit", 0), "x", "lowerPositionLimit"),
        (("model", "joints"), None, "model.joints"),
        (("model",), "22 serialization::archive", "model is .* a table"),
        (("model", "joint"), [], "no such key"),
        (("model", "joints", 1, "axis"), [0.0, 0.0, 2.0], "joint 2, axis .* unit vector"),
        (("base_placement", 0, 0), 3.0, "base_placement"),
        (("control_points",), ["nowhere"], "nowhere"),
        (("report", "segmentation"), None, "report.segmentation"),
    ],
)
def test_damaged_data_are_refused_by_name(path, value, message):
    described = coupled_arm(1).to_dict()
    with pytest.raises(PostureError, match=message):
        pp.Arm.from_dict(damaged(described, *path, to=value))


def test_a_joint_that_follows_a_helical_one_is_refused():
    model = pin.Model()
    first = model.addJoint(0, pin.JointModelHX(0.1), pin.SE3.Identity(), "first")
    second = model.addJoint(first, pin.JointModelHX(0.1), pin.SE3.Identity(), "second")
    model = pin.transformJointIntoMimic(model, first, second, 2.0, 0.0)
    model.addFrame(pin.Frame("end", second, pin.SE3.Random(), pin.FrameType.OP_FRAME))
    with pytest.raises(InvalidValue, match="type of joint 'second'"):
        pp.Arm.from_model(model, ["end"])
