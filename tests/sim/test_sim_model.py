"""The MuJoCo model is the arm: places, masses and forces are those of Pinocchio, which reads it alone."""

from __future__ import annotations

import sys
import warnings
from functools import cache
from pathlib import Path

import mujoco
import numpy as np
import pinocchio as pin
import pytest
from simple_arms import inertial, joint, link, mass_matrix, pendulum, quiet, robot

import pinposture as pp
from pinposture import sim
from pinposture.errors import InvalidValue, PostureWarning, URDFError

PLACED = pin.SE3(pin.rpy.rpyToMatrix(0.3, 1.2, -2.0), np.array([1.0, -2.0, 3.0]))
SLIDER = pp.ModuleTemplate(
    "slider",
    (
        pp.JointSpec("z", "continuous"),
        pp.JointSpec("x", "prismatic", lower=-0.1, upper=0.2),
        pp.JointSpec((1.0, 2.0, -0.5)),
    ),
    (0.03, 0.05, 0.02),
)
ARMS = {
    "RyRz": lambda: pp.Arm.from_template("RyRz", 20),
    "planar": lambda: pp.Arm.from_template("RzRzRz", 15),
    "mixed": lambda: pp.Arm.from_modules([SLIDER] * 4, base_placement=PLACED),
    "placed": lambda: pp.Arm.from_template("RzRy", 6, base_placement=PLACED),
}


@cache
def arm_named(name: str) -> pp.Arm:
    return ARMS[name]()


ROBOTS = next(
    folder
    for path in Path(pin.__file__).resolve().parents
    for folder in path.glob("cmeel.prefix/share/example-robot-data/robots")
)
FOREIGN = {
    "panda_description/urdf/panda.urdf": {},
    "ur_description/urdf/ur10_robot.urdf": {},
    "kinova_description/robots/kinova.urdf": {},
    "talos_data/robots/talos_left_arm.urdf": {},
    "xarm_description/urdf/xarm7.urdf": {},
    "b1_description/urdf/b1-z1.urdf": {},
    "pr2_description/urdf/pr2.urdf": {"tip": "r_gripper_tool_frame"},
    "baxter_description/urdf/baxter.urdf": {"tip": "left_gripper"},
}


def forces(plant: sim.PlantModel, positions: np.ndarray, speeds: np.ndarray) -> np.ndarray:
    """What it takes to hold the arm at these speeds, by MuJoCo, (nv,)."""
    data = mujoco.MjData(plant.model)
    data.qpos[:] = plant.positions(positions)
    data.qvel[plant.columns] = speeds
    mujoco.mj_forward(plant.model, data)
    return np.array(data.qfrc_bias[plant.columns])


@pytest.mark.parametrize("name", ARMS)
def test_masses_and_forces_are_those_of_pinocchio(name):
    arm = arm_named(name)
    rng = np.random.default_rng(1)
    plant = sim.build_plant_model(arm)
    data = arm.model.createData()
    for _ in range(3):
        q = arm.random(rng)
        speeds = rng.normal(size=arm.nv)
        positions = arm.positions(q)
        expected = mass_matrix(arm, q)
        found = sim.mass_matrix(plant, positions)[np.ix_(plant.columns, plant.columns)]
        np.testing.assert_allclose(found, expected, atol=1e-9 * np.abs(expected).max())
        still = np.zeros(arm.nv)
        weight = pin.rnea(arm.model, data, q, still, still)
        np.testing.assert_allclose(
            forces(plant, positions, still), weight, atol=1e-9 * np.abs(weight).max(initial=1e-3)
        )
        moving = pin.rnea(arm.model, data, q, speeds, still)
        np.testing.assert_allclose(forces(plant, positions, speeds), moving, atol=1e-9 * np.abs(moving).max())


def payload() -> pp.Arm:
    """Fixed links with masses and turned frames, friction, and a gripper that the arm does not move."""
    turned = {"center": (0.1, -0.2, 0.05), "rpy": (0.3, -0.8, 2.0)}
    resisted = '<dynamics damping="0.3" friction="0.2"/>'
    parts = (
        link("base", inertial()),
        link("a", inertial(**turned)),
        link("b", inertial(0.7, moments=(0.004, 0.005, 0.006), **turned)),
        link("load", inertial(0.4, moments=(0.001, 0.002, 0.0025), **turned)),
        link("finger", inertial(0.1)),
        link("tip"),
        joint("j1", "base", "a", axis=(1, 2, 3), more=resisted),
        joint("mount", "a", "load", "fixed", at=(0.1, 0.2, 0.3)).replace("<origin", '<origin rpy="1 2 3"'),
        joint("j2", "a", "b", "prismatic", axis=(0, -1, 1), at=(0.2, 0, 0)),
        joint("end", "b", "tip", "fixed", at=(0.2, 0, 0)),
        joint("grip", "b", "finger", "prismatic", axis=(0, 0, 1)),
    )
    return quiet(robot(*parts), tip="tip", locked={"grip": 0.3})


@pytest.mark.parametrize("name", [*ARMS, "payload"])
def test_mujoco_reading_the_file_by_itself_finds_the_same_masses(name):
    arm = payload() if name == "payload" else arm_named(name)
    plant = sim.build_plant_model(arm)
    own = mujoco.MjSpec.from_string(arm.urdf).compile()
    order = [own.joint(plant.model.joint(j).name).dofadr[0] for j in range(plant.model.njnt)]
    assert own.nv == plant.model.nv
    data = mujoco.MjData(own)
    positions = arm.positions(arm.random(np.random.default_rng(2)))
    data.qpos[order] = plant.positions(positions)
    mujoco.mj_forward(own, data)
    expected = np.zeros((own.nv, own.nv))
    for row, unit in zip(expected, np.eye(own.nv), strict=True):
        mujoco.mj_mulM(own, data, row, unit)
    np.testing.assert_allclose(sim.mass_matrix(plant, positions), expected[np.ix_(order, order)], atol=1e-9)
    np.testing.assert_array_equal(plant.model.dof_damping, own.dof_damping[order])
    np.testing.assert_array_equal(plant.model.dof_frictionloss, own.dof_frictionloss[order])


@pytest.mark.parametrize("name", [*ARMS, *FOREIGN])
def test_bodies_are_where_pinocchio_has_the_joints(name):
    arm = quiet(ROBOTS / name, **FOREIGN[name]) if name in FOREIGN else arm_named(name)
    plant = sim.build_plant_model(arm)
    rng = np.random.default_rng(5)
    data = mujoco.MjData(plant.model)
    expected = arm.model.createData()
    for _ in range(3):
        q = arm.random(rng)
        data.qpos[:] = plant.positions(arm.positions(q))
        mujoco.mj_kinematics(plant.model, data)
        pin.forwardKinematics(arm.model, expected, q)
        for moved, placement in zip(list(arm.model.names)[1:], list(expected.oMi)[1:], strict=True):
            body = plant.model.jnt_bodyid[plant.model.joint(moved).id]
            np.testing.assert_allclose(data.xpos[body], placement.translation, atol=1e-9)
            np.testing.assert_allclose(data.xmat[body].reshape(3, 3), placement.rotation, atol=1e-9)


@pytest.mark.parametrize("name", FOREIGN)
def test_robots_of_others_have_the_masses_that_pinocchio_finds(name):
    arm = quiet(ROBOTS / name, **FOREIGN[name])
    with warnings.catch_warnings():
        warnings.simplefilter("error", PostureWarning)
        plant = sim.build_plant_model(arm)
    q = arm.random(np.random.default_rng(3))
    expected = mass_matrix(arm, q)
    found = sim.mass_matrix(plant, arm.positions(q))[np.ix_(plant.columns, plant.columns)]
    np.testing.assert_allclose(found, expected, atol=1e-8 * np.abs(expected).max())


def test_an_arm_whose_description_is_another_one_is_refused():
    arm = arm_named("placed")
    other = pp.Arm.from_template("RzRy", 6, link_lengths=(0.025, 0.0251))
    mixed = pp.Arm(arm.model, arm.control_points, arm.base_placement, urdf=other.urdf)
    with pytest.raises(URDFError, match=r"control point 'module_06'.* differs by 0\.\d+ mm between MuJoCo"):
        sim.build_plant_model(mixed)


def test_an_arm_with_joints_that_its_description_lacks_is_refused():
    arm = arm_named("placed")
    other = arm_named("RyRz")
    mixed = pp.Arm(arm.model, arm.control_points, arm.base_placement, urdf=other.urdf)
    with pytest.raises(URDFError, match=r"joint 'm01_j1_z': is not a moving joint"):
        sim.build_plant_model(mixed)


def test_an_arm_without_a_description_is_refused():
    arm = arm_named("placed")
    bare = pp.Arm.from_model(arm.model, arm.control_points)
    with pytest.raises(InvalidValue, match=r"Arm\.from_model provides no description to simulate"):
        sim.build_plant_model(bare)


def test_without_mujoco_the_error_says_how_to_get_it(monkeypatch):
    monkeypatch.setitem(sys.modules, "mujoco", None)
    with pytest.raises(sim.MujocoMissing, match=r"pip install 'pinposture\[sim\]'"):
        sim.build_plant_model(pendulum())


def two_joints(first: str, second: str, **options) -> str:
    """Two joints with links in between that say what they weigh."""
    return robot(
        link("world"),
        link("a", first),
        link("b", second),
        link("tip"),
        joint("j1", "world", "a", **options),
        joint("j2", "a", "b", at=(0.2, 0, 0)),
        joint("end", "b", "tip", "fixed", at=(0.2, 0, 0)),
    )


def test_a_moving_link_without_mass_gets_a_little_and_a_warning():
    arm = quiet(two_joints("", inertial()))
    with pytest.warns(PostureWarning, match="moving link 'a': no mass; taken as a ball of 1 g"):
        plant = sim.build_plant_model(arm)
    added = sim.mass_matrix(plant, np.zeros(2)) - mass_matrix(arm, arm.neutral())
    np.testing.assert_allclose(added, [[0.4e-7, 0.0], [0.0, 0.0]], atol=1e-12)
    assert plant.warnings


def test_moments_of_no_solid_are_raised_with_a_warning():
    arm = quiet(two_joints(inertial(), inertial(moments=(0.001, 0.001, 0.01))))
    with pytest.warns(PostureWarning, match="moving link 'b': unphysical moments of inertia"):
        plant = sim.build_plant_model(arm)
    # Turned about y, one of the two that are too small: the least spread that makes zz possible raises it.
    raised = sim.mass_matrix(plant, np.zeros(2))[1, 1] - mass_matrix(arm, arm.neutral())[1, 1]
    assert raised == pytest.approx(0.004, rel=1e-6)


@pytest.mark.parametrize("number", ["nan", "heavy", "-1", "1 2", "inf", ""])
def test_a_mass_that_is_none_is_named(number):
    arm = quiet(two_joints(inertial(), inertial()))
    bad = pp.Arm(
        arm.model,
        arm.control_points,
        None,
        urdf=arm.urdf.replace('<mass value="1.2"', f'<mass value="{number}"', 1),
    )
    with pytest.raises(URDFError, match="link 'a': <mass> value is"):
        sim.build_plant_model(bad)


def test_joints_that_the_arm_does_not_move_are_held_where_it_has_them():
    parts = (
        link("base"),
        link("a", inertial()),
        link("b", inertial()),
        link("c", inertial()),
        link("finger", inertial(0.1)),
        link("thumb", inertial(0.1)),
        link("tip"),
        joint("j1", "base", "a"),
        joint("j2", "a", "b", axis=(1, 2, 3), at=(0.2, 0, 0)),
        joint("j3", "b", "c", at=(0.2, 0, 0)),
        joint("end", "c", "tip", "fixed", at=(0.2, 0, 0)),
        joint("grip", "c", "finger", "prismatic", axis=(0, 0, 1)),
        joint(
            "follow", "c", "thumb", "prismatic", more='<mimic joint="grip" multiplier="-1" offset="0.01"/>'
        ),
    )
    arm = quiet(robot(*parts), tip="tip", locked={"j2": -0.7, "grip": 0.3})
    plant = sim.build_plant_model(arm)
    assert arm.joint_names == ("j1", "j3")
    held = {name: plant.rest[plant.model.joint(name).dofadr[0]] for name in ("j2", "grip", "follow")}
    assert held == pytest.approx({"j2": -0.7, "grip": 0.3, "follow": -0.29}, abs=1e-12)
    ended = sim.simulate(arm, [arm.neutral()] * 2, dt=0.02, gravity=False, hold=0.2)
    assert ended.point_errors.max() < 1e-9


def test_a_base_that_floats_stands_still_and_a_link_may_be_called_world():
    arm = quiet(two_joints(inertial(), inertial()))
    floating = robot(
        link("floor"), *[arm.urdf[arm.urdf.index("<link") : arm.urdf.rindex("</robot>")]]
    ).replace("</robot>", joint("float", "floor", "world", "floating") + "</robot>")
    afloat = quiet(floating)
    assert "joint 'float'" in " ".join(afloat.warnings)
    for each in (arm, afloat):
        assert sim.build_plant_model(each).model.nv == 2


def test_stops_damping_friction_and_efforts_are_those_of_the_description():
    arm = pendulum(more='<dynamics damping="0.3" friction="0.2"/>')
    plant = sim.build_plant_model(arm)
    model = plant.model
    assert (model.dof_damping[0], model.dof_frictionloss[0]) == (0.3, 0.2)
    assert model.jnt_range[0].tolist() == [-3.0, 3.0]
    assert plant.torque_limits.tolist() == [50.0]
    assert sim.build_plant_model(pendulum(effort=0.0)).torque_limits.tolist() == [np.inf]
    assert sim.build_plant_model(arm, sim.Servos(torque_limits=2.0)).torque_limits.tolist() == [2.0]
    assert sim.build_plant_model(arm, sim.Servos(torque_limits=False)).torque_limits.tolist() == [np.inf]


@pytest.mark.parametrize("gravity", [[0.0, 0.0], "down", [0.0, np.nan, 0.0]])
def test_a_gravity_that_is_none_is_refused(gravity):
    with pytest.raises(InvalidValue, match="gravity"):
        sim.build_plant_model(pendulum(), gravity=gravity)


def test_what_an_arm_carries_is_simulated_and_equals_mujocos_own_model():
    """MuJoCo reads the file by itself, and gets the payloads as bodies of their own."""
    bare = arm_named("mixed")
    arm = bare.with_payload(0.7, (0.05, -0.02, 0.03), "m02_l3", (2e-3, 2e-3, 3e-3, 0, 0, 0))
    arm = arm.with_payload(0.4, frame="module_03").with_gravity((1.0, 2.0, -9.0)).with_effort(5.0)
    spec = mujoco.MjSpec.from_string(bare.urdf)
    spec.option.gravity = PLACED.rotation.T @ (1.0, 2.0, -9.0)
    spec.option.disableflags = mujoco.mjtDisableBit.mjDSBL_CONSTRAINT  # of contacts and joint limits
    body = spec.body("m02_l3").add_body(explicitinertial=True, mass=0.7, ipos=(0.05, -0.02, 0.03))
    body.fullinertia = [2e-3, 2e-3, 3e-3, 0, 0, 0]
    ball = spec.body("m03_l3").add_body(explicitinertial=True, mass=0.4, ipos=(0.02, 0.0, 0.0))
    ball.fullinertia = [1e-12, 1e-12, 1e-12, 0, 0, 0]
    own = spec.compile()
    data = mujoco.MjData(own)
    plant = sim.build_plant_model(arm)
    order = [own.joint(name).dofadr[0] for name in arm.joint_names]
    still = np.zeros(arm.nv)
    for seed in range(3):
        q = arm.random(seed)
        data.qpos[order] = arm.positions(q)
        mujoco.mj_inverse(own, data)
        held = arm.at(q).gravity_torques
        np.testing.assert_allclose(held, data.qfrc_inverse[order], atol=1e-9)
        np.testing.assert_allclose(held, forces(plant, arm.positions(q), still), atol=1e-9)
    assert plant.gravity.tolist() == [1.0, 2.0, -9.0]
    assert plant.torque_limits.tolist() == [5.0] * arm.nv


@pytest.mark.parametrize("name", FOREIGN)
def test_torques_of_foreign_robots_are_those_of_the_simulation(name):
    """Pinocchio has the joints of the chain alone; the simulation holds the others."""
    arm = quiet(ROBOTS / name, **FOREIGN[name])
    plant = sim.build_plant_model(arm)
    q = arm.random(1)
    if arm.links_without_mass:
        arm = pp.weigh(arm, masses=dict.fromkeys(arm.links_without_mass, 0.0))
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", PostureWarning)  # moments of inertia
        held = arm.at(q).gravity_torques
    np.testing.assert_allclose(held, forces(plant, arm.positions(q), np.zeros(arm.nv)), atol=1e-9)
