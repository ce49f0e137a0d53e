"""Sag of elastic joints, against closed forms, minima of the potential energy, and finite differences."""

from __future__ import annotations

import pickle
import re

import numpy as np
import pinocchio as pin
import pytest
from arms import MADE_AGAIN, template_arm
from scipy.optimize import brentq, minimize

import pinposture as pp
from pinposture.arm import ArmSpec, Weight, continuum_section
from pinposture.errors import InvalidValue, NoEquilibrium, UnknownName, WeightUnknown
from pinposture.motion import Actuators, Tendon

G = 9.81
WALL = pin.SE3(pin.rpy.rpyToMatrix(0.0, 0.0, 0.7), np.array([0.2, 0.1, 1.0]))
UPRIGHT = pin.SE3(pin.rpy.rpyToMatrix(0.0, -np.pi / 2.0, 0.0), np.zeros(3))
HANGING = pin.SE3(pin.rpy.rpyToMatrix(0.0, np.pi / 2.0, 0.0), np.zeros(3))


def pendulum(kind: str = "revolute", axis: str = "0 1 0", limit: float = 3.0) -> str:
    """A mass of 2 kg, 0.3 m from its joint, on an arm of 0.4 m."""
    inertia = '<inertia ixx="1e-4" iyy="1e-4" izz="1e-4" ixy="0" ixz="0" iyz="0"/>'
    moved = f'<link name="bar"><inertial><origin xyz="0.3 0 0"/><mass value="2"/>{inertia}</inertial></link>'
    limits = "" if kind == "continuous" else f'lower="{-limit}" upper="{limit}"'
    hinge = (
        f'<joint name="hinge" type="{kind}"><parent link="base"/><child link="bar"/>'
        f'<axis xyz="{axis}"/><limit {limits} velocity="1" effort="7"/></joint>'
    )
    end = '<joint name="end" type="fixed"><parent link="bar"/><child link="tip"/>'
    end += '<origin xyz="0.4 0 0"/></joint>'
    return f'<robot name="one"><link name="base"/>{moved}<link name="tip"/>{hinge}{end}</robot>'


def mixed_arm() -> pp.Arm:
    """Coupled, endless and sliding joints."""
    joints = [pp.JointSpec("z"), pp.JointSpec("z", follows=0, ratio=-0.5), pp.JointSpec("y")]
    joints.append(pp.JointSpec((1.0, 1.0, 0.0), type="continuous"))
    joints.append(pp.JointSpec("x", type="prismatic", lower=-0.05, upper=0.05))
    module = pp.ModuleTemplate("Mixed", joints, [0.03, 0.02, 0.05, 0.0, 0.04])
    arm = pp.Arm.from_modules([module] * 3, base_placement=WALL).with_payload(0.7, (0.05, 0.02, -0.1))
    return arm.with_stiffness(np.where(arm.slides, 900.0, 60.0))


def tendon_arm() -> pp.Arm:
    arm = pp.Arm.from_template("RyRz", 4).with_payload(0.2)
    offsets = {"a": (0.02, 0.0), "b": (-0.01, 0.017), "c": (-0.01, -0.017)}
    tendons = {
        f"{name}{k}": Tendon(offset, end=k) for k in range(arm.n_modules) for name, offset in offsets.items()
    }
    return arm.with_stiffness(Actuators.from_tendons(arm, tendons).stiffness(4e4))


ARMS = {
    "on a wall": lambda: pp.Arm.from_template("RyRz", 8, base_placement=WALL).with_stiffness(60.0),
    "upright": lambda: pp.Arm.from_template("RyRz", 6, base_placement=UPRIGHT).with_stiffness(9.0),
    "hanging": lambda: pp.Arm.from_template("RyRz", 6, base_placement=HANGING).with_stiffness(2.0),
    "coupled, endless and sliding joints": mixed_arm,
    "sections of one drive": lambda: pp.Arm.from_modules(
        [continuum_section(4, 0.2)] * 2, WALL
    ).with_stiffness(70.0),
    "tendons": tendon_arm,
}
each_arm = pytest.mark.parametrize("make", ARMS.values(), ids=ARMS)


def potential(arm: pp.Arm, q: np.ndarray) -> float:
    """Potential energy of weight, from the placements of Pinocchio [J]."""
    data = arm.model.createData()
    pin.forwardKinematics(arm.model, data, q)
    bodies = zip(list(data.oMi)[1:], list(arm.model.inertias)[1:], strict=True)
    return sum(body.mass * G * float(placed.act(body.lever)[2]) for placed, body in bodies)


def bent(arm: pp.Arm, seed: int) -> np.ndarray:
    return arm.configuration(np.random.default_rng(seed).uniform(-0.15, 0.15, arm.nv) * arm.joint_units)


# Where it comes to rest.


@pytest.mark.parametrize("stiffness", [4.0, 30.0, 400.0])
@pytest.mark.parametrize("commanded", [-2.5, -0.4, 0.0, 0.9])
def test_a_pendulum_sags_until_its_spring_balances_its_weight(stiffness: float, commanded: float) -> None:
    arm = pp.Arm.load(pendulum()).with_stiffness(stiffness)
    torque = 2.0 * 0.3 * G
    [q] = arm.sag([commanded])
    assert stiffness * (q - commanded) == pytest.approx(torque * np.cos(q), abs=1e-9)
    if stiffness > torque:  # there is only one
        exact = brentq(lambda x: stiffness * (x - commanded) - torque * np.cos(x), -9.0, 9.0, xtol=1e-14)
        assert q == pytest.approx(exact, abs=1e-12)
    assert arm.compensate([q]) == pytest.approx([commanded], abs=1e-9)


def test_a_slide_sags_by_its_weight_over_its_stiffness() -> None:
    arm = pp.Arm.load(pendulum("prismatic", "0 0 1"), split=1).with_stiffness("5 N/mm")
    np.testing.assert_allclose(arm.sag([0.2]), 0.2 - 2.0 * G / 5e3, atol=1e-14)
    np.testing.assert_allclose(arm.compensate([0.2]), 0.2 + 2.0 * G / 5e3, atol=1e-14)


@each_arm
def test_it_is_the_least_energy_of_springs_and_weight(make) -> None:
    arm = make()
    stiffness = arm.stiffness
    for seed in range(3):
        command = bent(arm, seed)

        def energy(moved: np.ndarray, command=command) -> float:
            at = arm.integrate(command, moved * arm.joint_units)
            weight = potential(arm, at)
            scaled = moved * arm.joint_units
            return float(weight + scaled @ stiffness @ scaled / 2.0)

        found = minimize(energy, np.zeros(arm.nv), method="BFGS", options={"gtol": 1e-9})
        sagged = arm.sag(command)
        moved = arm.difference(command, sagged) / arm.joint_units
        assert energy(moved) <= found.fun + 1e-12
        np.testing.assert_allclose(moved, found.x, atol=2e-5)
        assert np.abs(moved).max() > 1e-4


@each_arm
def test_torques_of_springs_are_those_that_hold_the_loaded_arm(make) -> None:
    arm = make()
    command = bent(arm, 5)
    sagged = arm.sag(command)
    torques = arm.stiffness @ arm.difference(sagged, command)
    np.testing.assert_allclose(torques, arm.at(sagged).gravity_torques, atol=1e-9)
    np.testing.assert_allclose(arm.at(sagged).deflection, arm.difference(command, sagged), atol=1e-10)
    again = arm.compensate(sagged)
    np.testing.assert_allclose(arm.difference(command, again), 0.0, atol=1e-9)
    rows = np.array([command, bent(arm, 6)])
    np.testing.assert_array_equal(arm.sag(rows)[0], sagged)
    held = arm.compensate(rows)
    np.testing.assert_allclose(
        [arm.difference(*pair) for pair in zip(rows, arm.sag(held), strict=True)], 0.0, atol=1e-9
    )
    assert arm.sag(np.empty((0, arm.nq))).shape == (0, arm.nq)


def test_springs_give_way_more_the_longer_the_arm() -> None:
    """A chain of equal bars with equal springs, level and stiff: sums of levers."""
    on_its_side = pin.SE3(pin.rpy.rpyToMatrix(np.pi / 2.0, 0.0, 0.0), np.zeros(3))
    arm = pp.Arm.from_template("Rz", 120, base_placement=on_its_side).with_stiffness(1e8)
    torques = np.abs(arm.at(arm.straight()).gravity_torques)
    levers = arm.length / 120 * np.arange(120, 0, -1)
    drop = arm.at(arm.straight()).points[-1] - arm.at(arm.sag(arm.straight())).points[-1]
    assert drop[2] == pytest.approx(float(torques @ levers) / 1e8, rel=1e-6)


@pytest.mark.parametrize("make", [*ARMS.values(), lambda: pp.Arm.from_template("RyRz", 150)])
def test_the_gradient_is_that_of_the_torques(make) -> None:
    arm = make()
    q = arm.random(2)
    state = arm.at(q)
    gradient = state.gravity_gradient
    for u in range(0, arm.nv, max(1, arm.nv // 12)):
        step = 1e-6 * np.eye(arm.nv)[u]
        change = state.moved(step).gravity_torques - state.moved(-step).gravity_torques
        np.testing.assert_allclose(gradient[:, u], change / 2e-6, atol=1e-7 * (1.0 + np.abs(gradient).max()))
    np.testing.assert_allclose(gradient, gradient.T, atol=1e-12)


def test_the_gradient_is_that_of_pinocchio() -> None:
    arm = template_arm("RyRz", 6)
    far = pp.Arm.from_template("RyRz", 6, base_placement=pin.SE3(np.eye(3), np.array([1e4, -2e4, 5e3])))
    q = arm.random(3)
    exact = pin.computeGeneralizedGravityDerivatives(arm.model, arm.model.createData(), q)
    np.testing.assert_allclose(arm.at(q).gravity_gradient, exact, atol=1e-14)
    np.testing.assert_allclose(far.at(q).gravity_gradient, exact, atol=1e-12)


@pytest.mark.parametrize("stiffness", [1e-9, 1e-3, 0.1])
def test_a_limp_arm_hangs(stiffness: float) -> None:
    arm = pp.Arm.load(pendulum()).with_stiffness(stiffness)
    torque = 2.0 * 0.3 * G
    [q] = arm.sag([0.1])
    exact = brentq(lambda x: stiffness * (x - 0.1) - torque * np.cos(x), 0.1, np.pi / 2.0 + 0.3, xtol=1e-14)
    assert q == pytest.approx(exact, abs=1e-10)
    limp = template_arm("RyRz", 6).with_stiffness(stiffness)
    tip = limp.at(limp.sag(limp.straight())).points[-1]
    assert tip[2] < limp.chain.base[2] - 0.3 * limp.length


# No rest.


@pytest.mark.parametrize("ratio", [0.3, 0.9, 0.99])
def test_an_upright_pendulum_buckles_where_its_weight_exceeds_its_spring(ratio: float) -> None:
    torque = 2.0 * 0.3 * G
    arm = pp.Arm.load(pendulum(), base_placement=UPRIGHT).with_stiffness(ratio * torque)
    with pytest.raises(NoEquilibrium, match="joint 'hinge' gives way beyond") as caught:
        arm.sag([0.0])
    assert caught.value.share == pytest.approx(ratio, abs=0.02)
    assert isinstance(pickle.loads(pickle.dumps(caught.value)), NoEquilibrium)
    with pytest.raises(
        NoEquilibrium, match="q: the arm has no stable rest, joint 'hinge' gives way; allowed"
    ):
        arm.compensate([0.0])
    assert arm.with_stiffness(1.01 * torque).sag([0.0]) == pytest.approx([0.0])
    assert arm.with_stiffness(1.01 * torque).compensate([0.0]) == pytest.approx([0.0])


def test_a_posture_to_which_the_arm_does_not_go_is_refused() -> None:
    """Pushed over from upright, a weak spring rests on either side; the command decides on which."""
    torque = 2.0 * 0.3 * G
    arm = pp.Arm.load(pendulum("continuous"), base_placement=UPRIGHT).with_stiffness(torque / 3.0)
    [fallen] = arm.positions(arm.sag(arm.configuration([0.73])))
    assert fallen > 1.5
    other_side = arm.configuration([-2.0])  # it rests there too, for a command of 0.73
    with pytest.raises(NoEquilibrium, match="q: the arm has no stable rest, joint 'hinge' gives way"):
        arm.compensate(other_side)


def test_a_slender_column_buckles_at_the_load_of_its_gradient() -> None:
    arm = pp.Arm.from_template("RyRz", 10, base_placement=UPRIGHT)
    straight = arm.straight()
    critical = float(-np.linalg.eigvalsh(arm.at(straight).gravity_gradient)[0])
    assert arm.with_stiffness(1.02 * critical).sag(straight) == pytest.approx(straight)
    with pytest.raises(NoEquilibrium) as caught:
        arm.with_stiffness(0.5 * critical).sag(straight)
    assert caught.value.share == pytest.approx(0.5, abs=0.02)
    assert caught.value.joint.startswith("m01")


# What is known of springs.


def test_an_unknown_stiffness_is_not_rigid() -> None:
    arm = pp.Arm.load(pendulum())
    for call in (lambda: arm.sag([0.0]), lambda: arm.compensate([0.0]), lambda: arm.stiffness):
        with pytest.raises(WeightUnknown, match=r"the stiffness of joint 'hinge' is not known; give it with"):
            call()
    some = template_arm("RyRz", 2).with_stiffness({"m01_j1_y": "3 N m/deg"})
    with pytest.raises(WeightUnknown, match="the stiffnesses of joints 'm01_j2_z', 'm02_j1_y', 'm02_j2_z'"):
        some.sag(np.zeros(4))
    assert not some.sag_known
    weightless = pp.Arm.load(pendulum().replace("inertial", "ignored")).with_stiffness(3.0)
    with pytest.raises(WeightUnknown, match="mass"):
        weightless.sag([0.0])
    assert not weightless.sag_known
    assert some.with_stiffness(5.0).sag_known
    with pytest.raises(ValueError, match="read-only"):
        some.with_stiffness(5.0).stiffness[0, 0] = 1.0


def test_the_stiffness_of_a_drive_counts_at_its_leader_by_virtual_work() -> None:
    """The leader of the arm is the first coupled joint; the description drives the second, twice as far."""
    link = '<link name="{}"><inertial><mass value="1"/><origin xyz="0.1 0 0"/><inertia {}/></inertial></link>'
    moments = 'ixx="1e-4" iyy="1e-4" izz="1e-4" ixy="0" ixz="0" iyz="0"'
    parts = [link.format(name, moments) for name in ("l0", "l1", "l2")]
    follows = '<mimic joint="b" multiplier="-0.5" offset="0"/>'
    for name, parent, child, more in (("a", "l0", "l1", follows), ("b", "l1", "l2", "")):
        parts.append(
            f'<joint name="{name}" type="revolute"><parent link="{parent}"/><child link="{child}"/>'
            f'<origin xyz="0.2 0 0"/><axis xyz="0 1 0"/>'
            f'<limit lower="-3" upper="3" velocity="1" effort="1"/>{more}</joint>'
        )
    parts.append('<link name="tip"/><joint name="e" type="fixed"><parent link="l2"/><child link="tip"/>')
    parts.append('<origin xyz="0.2 0 0"/></joint>')
    arm = pp.Arm.load(f'<robot name="made">{"".join(parts)}</robot>', split=2)
    assert arm.joint_names == ("a",)
    assert arm.with_stiffness(10.0).stiffness.tolist() == [[40.0]]
    assert arm.with_stiffness({"b": 10.0}).stiffness.tolist() == [[40.0]]
    assert arm.with_stiffness({"a": 10.0}).stiffness.tolist() == [[10.0]]


def test_tendons_give_the_stiffness_of_joints() -> None:
    arm = pp.Arm.from_template("RyRz", 2)
    tendons = {"up": Tendon((0.0, 0.02)), "down": Tendon((0.0, -0.02)), "side": Tendon((0.01, 0.0))}
    actuators = Actuators.from_tendons(arm, tendons)
    rng = np.random.default_rng(0)
    with pytest.raises(InvalidValue, match=r"rank of the matrix is 2.*is not determined"):
        actuators.stiffness(1e4)
    full = {f"{name}{k}": Tendon(each.offset, end=k) for k in range(2) for name, each in tendons.items()}
    actuators = Actuators.from_tendons(arm, full)
    each = rng.uniform(1e3, 1e4, len(full))
    stiffness = actuators.stiffness(each)
    bend = rng.normal(size=arm.nv)
    stretch = actuators.matrix @ bend
    assert bend @ stiffness @ bend == pytest.approx(float(each @ stretch**2))
    np.testing.assert_allclose(arm.with_stiffness(stiffness).stiffness, stiffness)
    for bad in (0.0, -1.0, np.nan, [1.0, 2.0]):
        with pytest.raises(InvalidValue, match="stiffness"):
            actuators.stiffness(bad)


@pytest.mark.parametrize(
    ("given", "error", "words"),
    [
        (0.0, InvalidValue, "stiffness is 0.0; allowed: more than 0"),
        (-3.0, InvalidValue, "stiffness"),
        (np.nan, InvalidValue, "stiffness"),
        (True, InvalidValue, "stiffness"),
        ("3 N m", InvalidValue, "one of the units Nm/rad"),
        ([1.0, 2.0], InvalidValue, "stiffness"),
        ({"elbow": 1.0}, UnknownName, "elbow"),
        (np.zeros((8, 8)), InvalidValue, "a positive definite matrix"),
        (np.ones((8, 8)), InvalidValue, "a positive definite matrix"),
        (np.diag([1.0] * 7 + [-1.0]), InvalidValue, "a positive definite matrix"),
        (np.eye(8) + np.eye(8, k=1), InvalidValue, "a symmetric matrix"),
        (np.eye(3), InvalidValue, "stiffness (shape) is (3, 3); allowed: (8, 8), of the arm"),
        (np.full((8, 8), np.inf), InvalidValue, "finite"),
        (np.ones((8, 7)), InvalidValue, "a symmetric and positive definite matrix"),
    ],
)
def test_what_is_no_stiffness_is_refused(given, error, words: str) -> None:
    with pytest.raises(error, match=re.escape(words)):
        template_arm("RyRz", 4).with_stiffness(given)


def test_one_number_does_not_hold_for_joints_that_turn_and_slide() -> None:
    arm = mixed_arm()
    with pytest.raises(InvalidValue, match=r"some joints turn \[N m/rad\] and others slide \[N/m\]"):
        arm.with_stiffness(60.0)


def test_a_command_beyond_its_limits_is_refused_by_name() -> None:
    arm = pp.Arm.load(pendulum(limit=0.5)).with_stiffness(10.0)
    torque = 2.0 * 0.3 * G
    beyond = torque * np.cos(-0.4) / 10.0 - 0.1
    with pytest.raises(InvalidValue, match=r"command of joint 'hinge' for q is -0.94") as caught:
        arm.compensate([-0.4])
    assert f"it would go {beyond:.3g} rad beyond" in str(caught.value)
    with pytest.raises(InvalidValue, match=re.escape("for q[1] is")):
        arm.compensate([[0.3], [-0.4]])
    assert pp.Arm.load(pendulum(limit=1.0)).with_stiffness(10.0).compensate([-0.4])[0] == pytest.approx(
        -0.4 - torque * np.cos(-0.4) / 10.0
    )


def test_a_command_that_is_barely_beyond_a_limit_stays_at_it() -> None:
    """An arm with a joint at its limit is not refused for a motion that no drive resolves."""
    arm = pp.Arm.load(pendulum(limit=0.5)).with_stiffness(1e7)
    assert arm.compensate([-0.5])[0] == -0.5
    assert arm.compensate([0.5])[0] == pytest.approx(0.5 - 2.0 * 0.3 * G * np.cos(0.5) / 1e7, abs=1e-12)
    with pytest.raises(InvalidValue, match="beyond"):
        arm.with_stiffness(1e6).compensate([-0.5])


@pytest.mark.parametrize("call", ["sag", "compensate"])
@pytest.mark.parametrize("q", [[0.0], [np.nan] * 8, "x", None, np.zeros((2, 7)), np.zeros((1, 2, 8))])
def test_what_is_no_configuration_is_refused(call: str, q) -> None:
    with pytest.raises(InvalidValue):
        getattr(template_arm("RyRz", 4).with_stiffness(20.0), call)(q)


# Saving.


@pytest.mark.parametrize("again", MADE_AGAIN.values(), ids=MADE_AGAIN)
@pytest.mark.parametrize("kind", ["a number", "by name", "a matrix"])
def test_stiffness_stays_with_the_arm(again, kind: str) -> None:
    arm = template_arm("RyRz", 2)
    if kind == "a number":
        arm = arm.with_stiffness(30.0)
    elif kind == "by name":
        arm = arm.with_stiffness(dict.fromkeys(arm.joint_names, 40.0))
    else:
        arm = arm.with_stiffness(3.0 * np.eye(4) + 0.5)
    other = again(arm)
    assert other.weight.stiffness == arm.weight.stiffness
    np.testing.assert_array_equal(other.stiffness, arm.stiffness)
    np.testing.assert_array_equal(other.sag(np.zeros(4)), arm.sag(np.zeros(4)))


@pytest.mark.parametrize("stiffness", [30.0, {"m01_j1_y": 40.0}, (((3.0, 0.5), (0.5, 2.0)))])
def test_a_task_file_keeps_stiffness(tmp_path, stiffness) -> None:
    spec = ArmSpec(template="RyRz", modules=1, weight=Weight(stiffness=stiffness))
    arm = pp.Arm.from_spec(spec)
    saved = tmp_path / "task.toml"
    line = pp.Curve.line((0, 0, 0), (arm.length, 0, 0))
    keyframes = [pp.Keyframe(line), pp.Keyframe(line, time=1.0)]
    pp.Task(arm, keyframes, pp.Limits(step=None, dt=0.02)).save(saved)
    assert pp.Task.load(saved).arm.weight.stiffness == stiffness
    changed = pp.Task.load(saved, {"arm.weight.stiffness": "5 N m/rad"})
    assert changed.arm.stiffness.tolist() == [[5.0, 0.0], [0.0, 5.0]]


def test_joints_off_the_chain_sag_and_count_too() -> None:
    model = pin.Model()
    body = pin.Inertia(1.0, np.array([0.1, 0.0, 0.0]), 1e-3 * np.eye(3))
    along = pin.SE3(np.eye(3), np.array([0.2, 0.0, 0.0]))
    first = model.addJoint(0, pin.JointModelRY(), pin.SE3.Identity(), "a")
    for name in ("b", "gripper"):
        number = model.addJoint(first, pin.JointModelRY(), along, name)
        model.appendBodyToJoint(number, body, pin.SE3.Identity())
    model.appendBodyToJoint(first, body, pin.SE3.Identity())
    model.addFrame(pin.Frame("tip", model.getJointId("b"), along, pin.FrameType.OP_FRAME))
    arm = pp.Arm.from_model(model, ["tip"]).with_stiffness(30.0)
    q = arm.sag(np.zeros(3))
    np.testing.assert_allclose(30.0 * q, -arm.at(q).gravity_torques, atol=1e-9)
    assert q[1] == pytest.approx(q[2])
    np.testing.assert_allclose(arm.compensate(q), 0.0, atol=1e-9)


def test_without_gravity_nothing_sags() -> None:
    arm = template_arm("RyRz", 3).with_gravity((0.0, 0.0, 0.0)).with_stiffness(5.0)
    q = arm.random(1)
    np.testing.assert_allclose(arm.sag(q), q)
    np.testing.assert_allclose(arm.compensate(q), q)
