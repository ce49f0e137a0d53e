"""Torques of a posture, against inverse dynamics of other models, closed forms and potential energies."""

from __future__ import annotations

import itertools
import pickle
import re
import warnings

import numpy as np
import pinocchio as pin
import pytest
from arms import MADE_AGAIN, template_arm

import pinposture as pp
from pinposture.arm import ArmSpec, continuum_section
from pinposture.arm.weight import Cable, Load, Weight
from pinposture.errors import InvalidValue, PostureWarning, UnknownName, URDFError, WeightUnknown

G = 9.81
TILT = pin.SE3(pin.rpy.rpyToMatrix(0.4, -1.1, 2.0), np.array([0.3, -0.2, 1.5]))


def link(name: str, mass: float | None = None, x: float = 0.0, shape: str = "", moment: float = 1e-4) -> str:
    inertial = ""
    if mass is not None:
        moments = f'ixx="{moment}" iyy="{moment}" izz="{moment}" ixy="0" ixz="0" iyz="0"'
        inertial = f'<inertial><origin xyz="{x} 0 0"/><mass value="{mass}"/><inertia {moments}/></inertial>'
    return f'<link name="{name}">{inertial}{shape}</link>'


def joint(name: str, parent: str, child: str, kind: str = "revolute", x: float = 0.0, **given: str) -> str:
    limits = f'<limit lower="-3" upper="3" velocity="1" effort="{given.get("effort", "7")}"/>'
    inside = "" if kind == "fixed" else limits + given.get("more", "")
    return (
        f'<joint name="{name}" type="{kind}"><parent link="{parent}"/><child link="{child}"/>'
        f'<origin xyz="{x} 0 0"/><axis xyz="{given.get("axis", "0 1 0")}"/>{inside}</joint>'
    )


def robot(*parts: str) -> str:
    return f'<robot name="made">{"".join(parts)}</robot>'


def snake(modules: int, mass: float = 0.3, length: float = 0.065, effort: str = "7") -> str:
    """A chain of equal modules with their masses in the middle, and pitch joints."""
    parts = [link("l0")]
    for k in range(modules):
        parts.append(link(f"l{k + 1}", mass, length / 2.0))
        parts.append(joint(f"j{k + 1}", f"l{k}", f"l{k + 1}", x=length if k else 0.0, effort=effort))
    parts += [link("tip"), joint("end", f"l{modules}", "tip", "fixed", length)]
    return robot(*parts)


def box(name: str = "collision", size: str = "0.1 0.02 0.03", x: float = 0.05) -> str:
    return f'<{name}><origin xyz="{x} 0 0"/><geometry><box size="{size}"/></geometry></{name}>'


def coupled_arm() -> pp.Arm:
    follower = pp.JointSpec("z", follows=0, ratio=-0.5)
    joints = [
        pp.JointSpec("z"),
        follower,
        pp.JointSpec("y"),
        pp.JointSpec((1.0, 1.0, 0.0), type="continuous"),
    ]
    joints.append(pp.JointSpec("x", type="prismatic", lower=0.0, upper=0.05))
    module = pp.ModuleTemplate("Mixed", joints, [0.03, 0.02, 0.05, 0.0, 0.04])
    return pp.Arm.from_modules([module] * 3, base_placement=TILT)


ARMS = {
    "two hinges": lambda: template_arm("RyRz", 6),
    "planar": lambda: pp.Arm.from_template("Rz", 12, base_placement=TILT),
    "coupled, endless and sliding joints, tilted": coupled_arm,
    "a section of one drive": lambda: pp.Arm.from_modules([continuum_section(4, 0.2)] * 2, TILT),
    "carrying": lambda: coupled_arm().with_payload(0.7, (0.05, 0.02, -0.1)).with_cable(0.3, start=0),
}
each_arm = pytest.mark.parametrize("make", ARMS.values(), ids=ARMS)


def potential(arm: pp.Arm, positions: np.ndarray) -> float:
    model = arm.model
    data = model.createData()
    pin.forwardKinematics(model, data, arm.configuration(positions))
    bodies = zip(list(data.oMi)[1:], list(model.inertias)[1:], strict=True)
    return sum(-body.mass * float(model.gravity.linear @ placed.act(body.lever)) for placed, body in bodies)


@each_arm
def test_they_are_the_slopes_of_the_potential_energy(make) -> None:
    arm = make()
    positions = arm.positions(arm.random(3))
    steps = 1e-5 * np.eye(arm.nv)
    slopes = [(potential(arm, positions + d) - potential(arm, positions - d)) / 2e-5 for d in steps]
    found = arm.at(arm.configuration(positions)).gravity_torques
    np.testing.assert_allclose(found, slopes, atol=1e-8)
    assert np.abs(found).max() > 1e-3


@each_arm
def test_the_pass_along_the_chain_agrees_with_pinocchio(make) -> None:
    arm = make()
    for seed in range(5):
        q = arm.random(seed)
        exact = pin.rnea(arm.model, arm.model.createData(), q, np.zeros(arm.nv), np.zeros(arm.nv))
        np.testing.assert_allclose(arm.at(q).gravity_torques, exact, rtol=0, atol=1e-12)
        np.testing.assert_allclose(arm.chain_at(q).gravity_torques, exact, rtol=0, atol=1e-10)


@pytest.mark.parametrize("up", [(0, 0, 1), (0, 0, -1), (1, 0, 0), (0.6, 0, 0.8)], ids=str)
def test_they_are_those_of_a_model_that_pinocchio_reads_itself(up) -> None:
    """A mounting is a direction of gravity in the frame of the base."""
    text = template_arm("RyRz", 5).urdf
    model = pin.buildModelFromXML(text)
    turn = pin.Quaternion.FromTwoVectors(
        np.array(up, dtype=float), np.array([0.0, 0.0, 1.0])
    ).toRotationMatrix()
    placement = pin.SE3(turn, np.array([1.0, 2.0, 3.0]))
    arm = pp.Arm.load(text, base_placement=placement)
    model.gravity.linear = -G * np.array(up, dtype=float)
    q = arm.random(0)
    still = np.zeros(arm.nv)
    exact = pin.rnea(model, model.createData(), q, still, still)
    np.testing.assert_allclose(arm.at(q).gravity_torques, exact, atol=1e-12)
    turned = pp.Arm.load(text).with_gravity(model.gravity.linear)
    np.testing.assert_allclose(turned.at(q).gravity_torques, exact, atol=1e-12)
    with pytest.raises(ValueError, match="read-only"):
        arm.at(q).gravity_torques[0] = 0.0


def test_a_level_arm_needs_the_sum_of_its_weights_times_their_levers() -> None:
    arm = pp.Arm.load(snake(8))
    levers = 0.065 * (np.arange(8)[None] - np.arange(8)[:, None] + 0.5)
    expected = -np.sum(np.where(levers > 0.0, 0.3 * G * levers, 0.0), axis=1)  # a turn about y lowers it
    np.testing.assert_allclose(arm.at(np.zeros(8)).gravity_torques, expected, rtol=1e-12)


def test_a_snake_of_modules_holds_eight_of_them_straight_out_and_not_nine() -> None:
    held = pp.Arm.load(snake(8)).at(np.zeros(8)).most_loaded()
    assert held is not None and not held.exceeded
    load = pp.Arm.load(snake(9)).at(np.zeros(9)).most_loaded()
    assert load is not None and load.exceeded
    assert str(load) == "joint 'j1' needs 7.747 of 7 N m"
    assert load.needed == pytest.approx(0.3 * G * 0.065 * 81 / 2)
    margin = pp.Arm.load(snake(9)).at(np.zeros(9)).torque_margin
    np.testing.assert_allclose(margin, 7.0 - 0.3 * G * 0.065 * np.arange(9, 0, -1) ** 2 / 2)


def test_an_arm_too_long_for_pinocchio_needs_the_sum_of_its_weights_times_their_levers() -> None:
    arm = pp.Arm.load(snake(300, 0.1, 0.01))
    down = np.arange(300, 0, -1)
    expected = -0.1 * G * 0.01 * down**2 / 2
    np.testing.assert_allclose(arm.at(np.zeros(300)).gravity_torques, expected, rtol=1e-12)
    bent = arm.random(0) * 0.1
    step = 1e-5
    for u in (0, 150, 299):
        heights = []
        for sign in (1.0, -1.0):
            moved = bent + sign * step * np.eye(300)[u]
            placed = arm.chain_at(moved)
            ends = np.vstack([placed.origins[1:], placed.points[-1]])
            heights.append(0.1 * G * float(((placed.origins + ends) / 2.0)[:, 2].sum()))
        slope = (heights[0] - heights[1]) / (2.0 * step)
        assert arm.at(bent).gravity_torques[u] == pytest.approx(slope, abs=1e-6)


def test_far_from_the_origin_nothing_is_lost() -> None:
    far = pin.SE3(np.eye(3), np.array([1e3, -2e3, 5e2]))
    near = template_arm("RyRz", 30)
    away = pp.Arm.from_template("RyRz", 30, base_placement=far)
    q = near.random(2)
    np.testing.assert_allclose(away.chain_at(q).gravity_torques, near.at(q).gravity_torques, atol=1e-10)


# Payloads and cables.


def test_a_payload_adds_its_weight_by_virtual_work() -> None:
    arm = template_arm("RyRz", 6)
    q = arm.random(4)
    for frame, point in (("module_03", 2), ("m03_l2", None), (None, 5)):
        loaded = arm.with_payload(0.8, (0.01, 0.02, 0.03), frame)
        state = arm.at(q)
        name = "tip" if frame is None else frame
        jacobian = state.jacobian(name)
        data = arm.model.createData()
        pin.framesForwardKinematics(arm.model, data, q)
        turn = data.oMf[arm.model.getFrameId(name)].rotation
        lever = turn @ np.array([0.01, 0.02, 0.03])
        lift = jacobian[:3] + np.cross(jacobian[3:].T, lever).T
        expected = state.gravity_torques + 0.8 * G * lift[2]
        np.testing.assert_allclose(loaded.at(q).gravity_torques, expected, atol=1e-12)
        np.testing.assert_allclose(loaded.chain_at(q).gravity_torques, expected, atol=1e-12)
        if point is not None:
            np.testing.assert_allclose(jacobian[:3], state.jacobians[point], atol=1e-12)


def test_payloads_add_up_and_the_arm_without_them_stays_as_it_was() -> None:
    arm = template_arm("RyRz", 4)
    q = arm.random(1)
    before = arm.at(q).gravity_torques.copy()
    one = arm.with_payload(0.5, (0.1, 0, 0)).at(q).gravity_torques - before
    twice = arm.with_payload(0.5, (0.1, 0, 0)).with_payload(0.5, (0.1, 0, 0)).at(q).gravity_torques - before
    np.testing.assert_allclose(twice, 2.0 * one, atol=1e-13)
    np.testing.assert_array_equal(arm.at(q).gravity_torques, before)


def test_a_cable_is_a_rod_on_each_link() -> None:
    arm = coupled_arm()
    q = arm.random(2)
    neutral = arm.model.createData()
    pin.framesForwardKinematics(arm.model, neutral, arm.neutral())
    chain = arm.chain
    expected = arm
    ends = {part.stop - 1: k for k, part in enumerate(chain.module_slices)}
    for u in range(len(chain.joints)):
        line = [
            chain.origins[u],
            *([chain.points[ends[u]]] if u in ends else []),
            *chain.origins[u + 1 : u + 2],
        ]
        for a, b in itertools.pairwise(line):
            mass = 0.4 * float(np.linalg.norm(b - a))
            here = neutral.oMi[arm.model.getJointId(chain.joints[u])].actInv((a + b) / 2.0)
            expected = expected.with_payload(mass, here, chain.joints[u])
    np.testing.assert_allclose(
        arm.with_cable(0.4).at(q).gravity_torques, expected.at(q).gravity_torques, atol=1e-12
    )


def test_a_cable_begins_and_ends_at_control_points() -> None:
    arm = pp.Arm.load(snake(8), split=2)
    level = np.zeros(8)

    def added(start, end) -> np.ndarray:
        return arm.with_cable(0.5, start, end).at(level).gravity_torques - arm.at(level).gravity_torques

    whole = added(None, -1)
    length = 8 * 0.065
    assert whole[0] == pytest.approx(-0.5 * G * length**2 / 2)
    np.testing.assert_allclose(added(None, "module_02") + added("module_02", -1), whole, atol=1e-13)
    assert added(None, 0)[0] == pytest.approx(-0.5 * G * (length / 4) ** 2 / 2)
    assert added(2, 3)[6] == pytest.approx(-0.5 * G * (length / 4) ** 2 / 2)
    assert added(None, 1)[7] == 0.0


@pytest.mark.parametrize(
    ("call", "error", "words"),
    [
        (lambda arm: arm.with_payload(-1.0), InvalidValue, "mass is -1.0"),
        (lambda arm: arm.with_payload(float("nan")), InvalidValue, "mass"),
        (lambda arm: arm.with_payload(1.0, (0, 0)), InvalidValue, "com"),
        (lambda arm: arm.with_payload(1.0, frame="hand"), UnknownName, "no frame is called 'hand'"),
        (lambda arm: arm.with_payload(1.0, frame="base"), InvalidValue, "that a joint of the arm moves"),
        (lambda arm: arm.with_payload(1.0, inertia=(1, 1, 3, 0, 0, 0)), InvalidValue, "inertia"),
        (lambda arm: arm.with_payload(0.0, inertia=(1, 1, 1, 0, 0, 0)), InvalidValue, "inertia"),
        (lambda arm: arm.with_cable(-0.1), InvalidValue, "mass_per_length"),
        (lambda arm: arm.with_cable(0.1, 2, 1), InvalidValue, "an end farther along the arm"),
        (lambda arm: arm.with_cable(0.1, end="elbow"), UnknownName, "control point"),
        (lambda arm: arm.with_cable(0.1, end=9), InvalidValue, "9"),
        (lambda arm: arm.with_effort(0.0), InvalidValue, "effort"),
        (lambda arm: arm.with_effort([1.0, 2.0]), InvalidValue, "effort"),
        (lambda arm: arm.with_effort({"elbow": 1.0}), UnknownName, "elbow"),
        (lambda arm: arm.with_gravity((0, 1)), InvalidValue, "gravity"),
        (lambda arm: arm.with_weight(3), InvalidValue, "a Weight"),
    ],
)
def test_what_cannot_be_carried_is_refused_by_name(call, error, words: str) -> None:
    with pytest.raises(error, match=re.escape(words)):
        call(template_arm("RyRz", 4))


# Torque limits.


def test_a_drive_of_coupled_joints_gets_its_torque_by_virtual_work() -> None:
    """The leader of the arm is the first coupled joint; the description drives the second."""
    follows = '<mimic joint="b" multiplier="-0.5" offset="0.1"/>'
    parts = [link("l0"), link("l1", 1.0, 0.1), link("l2", 2.0, 0.1), link("tip")]
    hinges = [
        joint("a", "l0", "l1", more=follows, effort="1000"),
        joint("b", "l1", "l2", x=0.2, effort="9"),
        joint("e", "l2", "tip", "fixed", 0.2),
    ]
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", PostureWarning)
        arm = pp.Arm.load(robot(*parts, *hinges))
    assert arm.joint_names == ("a",)
    assert arm.effort.tolist() == [9.0 * 2.0]  # the drive turns twice as far
    positions = np.array([0.3])
    free = pin.buildModelFromXML(robot(*parts, *(each.replace(follows, "") for each in hinges)))
    q = np.array([0.3, (0.3 - 0.1) / -0.5])
    torques = pin.computeGeneralizedGravity(free, free.createData(), q)
    at_drive = float(torques @ [-0.5, 1.0])
    state = arm.at(arm.configuration(positions))
    assert state.gravity_torques[0] == pytest.approx(at_drive / -0.5)
    loaded = state.most_loaded()
    assert (loaded.joint, loaded.limit) == ("b", 9.0)
    assert loaded.needed == pytest.approx(abs(at_drive))
    assert arm.with_effort(4.0).effort.tolist() == [8.0]
    assert arm.with_effort({"b": 4.0}).effort.tolist() == [8.0]
    assert arm.with_effort({"a": 4.0}).effort.tolist() == [4.0]


def test_limits_come_from_the_description_or_are_given() -> None:
    arm = pp.Arm.load(snake(3, effort="0"))
    assert np.all(np.isinf(arm.effort))
    with pytest.raises(WeightUnknown, match="the torque limits of joints 'j1', 'j2', 'j3' are not known"):
        _ = arm.at(np.zeros(3)).torque_margin
    assert arm.at(np.zeros(3)).most_loaded() is None
    assert arm.with_effort(2.0).effort.tolist() == [2.0] * 3
    assert arm.with_effort([1.0, 2.0, 3.0]).effort.tolist() == [1.0, 2.0, 3.0]
    assert arm.with_effort(2.0).with_effort(None).effort.tolist() == [np.inf] * 3
    some = arm.with_effort({"j2": "50 N cm"})
    assert some.effort.tolist() == [np.inf, 0.5, np.inf]
    with pytest.warns(PostureWarning, match="the torque limits of joints 'j1', 'j3' are not known"):
        margin = some.at(np.zeros(3)).torque_margin
    assert np.isinf(margin[[0, 2]]).all()
    again = some.at(np.zeros(3)).torque_margin  # said once: a second warning would fail the test
    np.testing.assert_array_equal(again, margin)
    assert np.all(np.isinf(template_arm("RyRz", 3).effort))


def test_a_slide_needs_a_force() -> None:
    parts = [link("l0"), link("l1", 2.0), link("l2", 1.0, 0.1), link("tip")]
    lift = joint("lift", "l0", "l1", "prismatic", axis="0 0 1", effort="20")
    arm = pp.Arm.load(robot(*parts, lift, joint("b", "l1", "l2"), joint("e", "l2", "tip", "fixed", 0.2)))
    state = arm.at(np.zeros(2))
    np.testing.assert_allclose(state.gravity_torques, [3.0 * G, -G * 0.1])
    assert str(state.most_loaded()) == "joint 'lift' needs 29.43 of 20 N"


# What is not known, and what is impossible.


def two_links(first: str, second: str, more: str = "") -> str:
    hinges = joint("a", "l0", "l1"), joint("b", "l1", "l2", x=0.1), joint("e", "l2", "tip", "fixed", 0.1)
    return robot(link("l0"), first, second, link("tip"), *hinges, more)


@pytest.mark.parametrize(
    ("text", "names"),
    [
        (two_links(link("l1"), link("l2")), ["l1", "l2"]),
        (two_links(link("l1", 1.0), link("l2")), ["l2"]),
        (two_links(link("l1", 1.0), link("l2", 0.0)), ["l2"]),
        (two_links(link("l1", shape=box()), link("l2", 1.0)), ["l1"]),
    ],
    ids=["no masses", "one without", "a mass of zero", "a shape"],
)
def test_a_link_without_mass_is_never_weightless(text: str, names: list[str]) -> None:
    arm = pp.Arm.load(text)
    with pytest.raises(WeightUnknown, match=r"not known; give masses with pp\.weigh") as caught:
        _ = arm.at(np.zeros(2)).gravity_torques
    assert list(caught.value.names) == names
    assert all(repr(name) in str(caught.value) for name in names)
    with pytest.raises(WeightUnknown):
        _ = arm.chain_at(np.zeros(2)).torque_margin
    assert arm.at(np.zeros(2)).most_loaded() is None
    assert isinstance(pickle.loads(pickle.dumps(caught.value)), WeightUnknown)


def test_a_part_without_mass_counts_with_the_link_that_carries_it_and_is_named() -> None:
    cover = link("cover", shape=box("visual")) + joint("c", "l1", "cover", "fixed")
    text = two_links(link("l1", 1.0, 0.05), link("l2", 1.0, 0.05), cover)
    arm = pp.Arm.load(text)
    with pytest.warns(pp.PostureWarning, match=r"'cover' have shapes and no mass; .* pp\.weigh"):
        torques = arm.at(np.zeros(2)).gravity_torques
    np.testing.assert_allclose(torques, [-0.2 * G, -0.05 * G])
    assert arm.links_without_mass == arm.parts_without_mass == ("cover",)
    bare = pp.Arm.load(two_links(link("l1", shape=box()), link("l2", 1.0), cover))
    with pytest.warns(pp.PostureWarning, match="cover"):
        pp.weigh(bare, masses={"l1": 1.0}).require_masses()
    weighed = pp.weigh(arm, masses={"cover": 0.5})
    assert not weighed.links_without_mass
    assert weighed.at(np.zeros(2)).gravity_torques[0] != pytest.approx(torques[0])


def test_frames_need_no_mass() -> None:
    """A frame that is fixed to a link, what stays with the base, and a cross between axes that meet."""
    frames = link("camera") + joint("c", "l1", "camera", "fixed", 0.05)
    stand = link("stand", shape=box()) + joint("s", "l0", "stand", "fixed")
    arm = pp.Arm.load(two_links(link("l1", 1.0, 0.05), link("l2", 1.0, 0.05), frames + stand))
    np.testing.assert_allclose(arm.at(np.zeros(2)).gravity_torques, [-0.2 * G, -0.05 * G])
    hinges = (
        joint("a", "l0", "cross"),
        joint("b", "cross", "l2", axis="0 0 1"),
        joint("e", "l2", "tip", "fixed", 0.1),
    )
    cross = pp.Arm.load(robot(link("l0"), link("cross"), link("l2", 1.0, 0.05), link("tip"), *hinges))
    np.testing.assert_allclose(cross.at(np.zeros(2)).gravity_torques, [-0.05 * G, 0.0], atol=1e-12)


def test_a_model_without_masses_is_refused_by_its_joints() -> None:
    model = pin.Model()
    for k in range(2):
        along = pin.SE3(np.eye(3), np.array([0.1 * k, 0.0, 0.0]))
        model.addJoint(k, pin.JointModelRY(), along, f"j{k}")
    tip = pin.SE3(np.eye(3), np.array([0.1, 0.0, 0.0]))
    model.addFrame(pin.Frame("elbow", 1, tip, pin.FrameType.OP_FRAME))
    model.addFrame(pin.Frame("tip", 2, tip, pin.FrameType.OP_FRAME))
    arm = pp.Arm.from_model(model, ["elbow", "tip"])
    with pytest.raises(WeightUnknown, match="'j0', 'j1'"):
        _ = arm.at(np.zeros(2)).gravity_torques
    weighed = pp.weigh(arm, masses={"j0": 1.0, "j1": 2.0})  # along the lines between them
    np.testing.assert_allclose(weighed.at(np.zeros(2)).gravity_torques, [-0.35 * G, -0.1 * G])
    model.appendBodyToJoint(1, pin.Inertia(1.0, np.zeros(3), np.eye(3)), pin.SE3.Identity())
    model.appendBodyToJoint(2, pin.Inertia(1.0, np.array([0.1, 0, 0]), np.eye(3)), pin.SE3.Identity())
    model.gravity.linear = np.array([0.0, 0.0, -1.62])
    on_the_moon = pp.Arm.from_model(model, ["elbow", "tip"])
    np.testing.assert_allclose(on_the_moon.at(np.zeros(2)).gravity_torques, [-0.2 * 1.62, -0.1 * 1.62])
    loaded = pp.Arm.load(model)
    torques = loaded.at(loaded.neutral()).gravity_torques
    np.testing.assert_allclose(torques, [-0.2 * 1.62, -0.1 * 1.62])
    model.inertias[2].mass = -1.0
    with pytest.raises(InvalidValue, match="inertia of joint 'j1'"):
        _ = pp.Arm.from_model(model, ["elbow", "tip"]).at(np.zeros(2)).gravity_torques


def test_impossible_numbers_are_named() -> None:
    for bad in ('value="-2.0"', 'value="nan"', 'value="heavy"'):
        text = two_links(link("l1", 1.0), link("l2", 2.0)).replace('value="2.0"', bad)
        with pytest.raises(URDFError, match="link 'l2': <mass> value is"):
            _ = pp.Arm.load(text).at(np.zeros(2)).gravity_torques
    arm = pp.Arm.load(
        two_links(link("l1", 1.0, 50.0), link("l2", 2.0)).replace('izz="0.0001"', 'izz="0.1"', 1)
    )
    with pytest.warns(PostureWarning) as told:
        _ = arm.at(np.zeros(2)).gravity_torques
    words = [str(each.message) for each in told]
    assert len(words) == 2
    assert words[0].startswith("no solid has the moments of inertia of 'l1'")
    assert words[1].startswith("the centre of mass of 'l1' is 50 m from its frame, 250 times the length")
    _ = arm.at(np.ones(2)).gravity_torques  # said once
    _ = arm.with_payload(0.1).with_effort(2.0).at(np.ones(2)).gravity_torques  # nor of one derived from it


# Saving.


def carrying() -> pp.Arm:
    arm = pp.Arm.load(snake(4), split=1)
    loaded = arm.with_payload(0.2, (0.01, 0.02, 0.03), "l2", (1e-3, 1e-3, 1e-3, 1e-4, 0, 0)).with_payload(
        "300 g"
    )
    return loaded.with_cable(0.1, 0, 2).with_effort({"j1": 9.0, "j3": 3.0}).with_gravity((0, G, 0))


@pytest.mark.parametrize("again", MADE_AGAIN.values(), ids=MADE_AGAIN)
def test_what_an_arm_carries_stays_with_it(again) -> None:
    arm = carrying()
    other = again(arm)
    assert other.weight == arm.weight
    assert other.spec is not None
    assert other.spec.weight == arm.weight
    q = arm.random(1)
    np.testing.assert_array_equal(other.at(q).gravity_torques, arm.at(q).gravity_torques)
    np.testing.assert_array_equal(other.effort, arm.effort)
    np.testing.assert_allclose(
        other.with_weight(Weight()).at(q).gravity_torques, pp.Arm.load(snake(4)).at(q).gravity_torques
    )


def test_a_task_file_keeps_what_its_arm_carries(tmp_path) -> None:
    arm = carrying()
    line = pp.Curve.line((0, 0, 0), (0.26, 0, 0))
    keyframes = [pp.Keyframe(line), pp.Keyframe(line, time=1.0)]
    saved = tmp_path / "task.toml"
    pp.Task(arm, keyframes, pp.Limits(step=None, dt=0.02)).save(saved)
    assert pp.Task.load(saved).arm.weight == arm.weight
    text = saved.read_text()
    assert 'frame = "l2"' in text
    changed = pp.Task.load(saved, {"arm.weight.effort": "5 N m"})
    assert changed.arm.effort.tolist() == [5.0] * 4


def test_a_weight_is_declared() -> None:
    weight = Weight(payloads=(Load(0.5, (0.1, 0, 0), "tip"),), cables=(Cable(0.2),), effort=7.0)
    spec = ArmSpec(template="RyRz", modules=3, weight=weight)
    arm = pp.Arm.from_spec(spec)
    assert arm.weight == weight
    assert arm.at(arm.random(0)).gravity_torques.shape == (6,)


# How far an arm can be held out.


def test_a_long_snake_is_held_out_as_far_as_its_last_eight_modules() -> None:
    held = pp.Arm.load(snake(20)).held_out()
    assert held.length == pytest.approx(8 * 0.065)
    assert str(held.load) == "joint 'j12' needs 7.747 of 7 N m"
    assert held.payload == 0.0
    short = pp.Arm.load(snake(6)).held_out()
    assert short.length == pytest.approx(6 * 0.065)
    assert short.load.joint == "j1"
    assert short.payload == pytest.approx((7.0 - 0.3 * G * 0.065 * 36 / 2) / (G * 6 * 0.065))


@pytest.mark.long
@pytest.mark.parametrize("seed", range(3))
def test_no_direction_of_gravity_is_worse_than_the_worst(seed: int) -> None:
    rng = np.random.default_rng(seed)
    arm = coupled_arm().with_payload(0.3, (0.0, 0.05, 0.02)).with_effort(50.0)
    held = arm.held_out()
    state = arm.at(arm.straight())
    shares = []
    loaded = []
    for direction in rng.normal(size=(100, 3)):
        gravity = G * direction / np.linalg.norm(direction)
        other = arm.with_gravity(gravity)
        shares.append(other.at(state.q).most_loaded().share)
        loaded.append(other.with_payload(held.payload).at(state.q).most_loaded().share)
    assert held.load.share * 0.9 < max(shares) <= held.load.share * (1.0 + 1e-9)
    assert 0.9 < max(loaded) <= 1.0 + 1e-9


def test_how_far_it_is_held_is_not_said_where_a_limit_is_unknown() -> None:
    arm = template_arm("RyRz", 3)
    assert arm.held_out() is None
    assert arm.with_effort({"m01_j1_y": 3.0}).held_out() is None
    assert arm.with_effort(3.0).held_out() is not None
    assert arm.with_effort(3.0).with_gravity((0, 0, 0)).held_out().payload == np.inf
