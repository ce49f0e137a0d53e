"""MJCF: each file makes the arm that MuJoCo simulates."""

from __future__ import annotations

import itertools
import sys
from dataclasses import replace
from pathlib import Path

import mujoco
import numpy as np
import pinocchio as pin
import pytest
import trimesh

import pinposture as pp
from pinposture.arm import mjcf
from pinposture.collision.bodies import bodies_of
from pinposture.errors import FileError, PostureWarning, UnknownName, URDFError

GEOM = '<geom size="0.01"/>'
TIP = '<site name="tip" pos="0.1 0.02 0.01"/>'


def document(*bodies: str, before: str = "", after: str = "") -> str:
    return f'<mujoco model="arm">{before}<worldbody>{"".join(bodies)}</worldbody>{after}</mujoco>'


def body(name: str, *content: str, at: str = 'pos="0.1 0 0"', geom: str = GEOM) -> str:
    return f'<body name="{name}" {at}>{geom}{"".join(content)}</body>'


def joint(name: str, rest: str = 'axis="0 1 0" range="-50 60"') -> str:
    return f'<joint name="{name}" {rest}/>'


def two_joints(
    first: str = 'axis="0 1 0" range="-50 60"',
    second: str = 'axis="0 0 1" range="-50 60"',
    at: str = 'pos="0.1 0 0"',
    **parts: str,
) -> str:
    inner = body("b2", joint("j2", second), TIP, at=at)
    return document(body("b1", joint("j1", first), inner, at='pos="0 0 0.05"'), **parts)


def quiet(source: str | Path, **options) -> pp.Arm:
    with pp.errors.no_warnings():
        return pp.Arm.load(source, **options)


def put_into_mujoco(model: mujoco.MjModel, arm: pp.Arm, q: np.ndarray) -> mujoco.MjData:
    """The state of MuJoCo with the joints of the arm where the arm has them."""
    data = mujoco.MjData(model)
    positions = dict(zip(arm.joint_names, arm.positions(q), strict=True))
    for each in arm.couplings:
        positions[each.joint] = each.ratio * positions[each.leader] + each.offset
    for name, position in positions.items():
        data.joint(name).qpos[:] = position
    return data


def apart(model: mujoco.MjModel, arm: pp.Arm, tip: str = "tip") -> float:
    """Largest distance of the tip from where MuJoCo has it, and of the end of each module's axes."""
    rng = np.random.default_rng(0)
    worst = 0.0
    for _ in range(10):
        q = arm.random(rng)
        data = put_into_mujoco(model, arm, q)
        mujoco.mj_kinematics(model, data)
        state = arm.at(q)
        worst = max(worst, float(np.abs(state.points[-1] - data.site(tip).xpos).max()))
        turned = np.abs(state.rotations[-1] - data.site(tip).xmat.reshape(3, 3)).max()
        worst = max(worst, float(turned))
    return worst


def check(xml: str, **options) -> pp.Arm:
    """Compare an arm with MuJoCo: the tip, the names, the limits."""
    model = mujoco.MjModel.from_xml_string(xml)
    arm = quiet(xml, **options)
    assert apart(model, arm) < 1e-12
    check_limits(model, arm)
    return arm


def check_limits(model: mujoco.MjModel, arm: pp.Arm) -> None:
    for name, lower, upper in zip(arm.joint_names, arm.limits.lower, arm.limits.upper, strict=True):
        index = model.joint(name).id
        limited = bool(model.jnt_limited[index])
        assert (lower, upper) == (tuple(model.jnt_range[index]) if limited else (-np.inf, np.inf))


CHAIN = body("b3", joint("j3", 'axis="1 0 1" range="-20 30"'), TIP)

KINEMATICS = {
    "fixed body with a pose below the world": document(
        body("base", body("b1", joint("j1"), CHAIN), at='pos="1 2 3" euler="20 30 40"')
    ),
    "frame": document(
        body(
            "b1",
            joint("j1"),
            f'<frame pos="0 0 0.05" euler="0 30 10"><frame pos="1 0 0">{CHAIN}</frame></frame>',
        )
    ),
    "frame with joint and site": document(
        body(
            "b1",
            f'<frame pos="0.1 0 0" euler="10 20 30">{joint("j1")}{GEOM}</frame>',
            body("b3", joint("j3"), f'<frame pos="0 0.2 0" euler="0 0 90">{TIP}</frame>'),
        )
    ),
    "quaternion of another length": two_joints(at='pos="0.1 0 0" quat="2 1 0.5 -0.3"'),
    "axisangle of another length": two_joints(at='axisangle="0 1 1 35"'),
    "xyaxes": two_joints(at='pos="0.1 0 0" xyaxes="1 1 0 -1 1 1"'),
    "zaxis": two_joints(at='pos="0.1 0 0" zaxis="1 2 3"'),
    "euler in radians": two_joints(
        first='axis="0 1 0" range="-1 1"',
        second='axis="0 1 1" range="-1 0.5"',
        at='euler="0.5 0.6 0.7"',
        before='<compiler angle="radian"/>',
    ),
    "euler of another sequence": two_joints(at='euler="50 60 70"', before='<compiler eulerseq="ZYX"/>'),
    "position of a joint": two_joints(
        first='axis="0 1 0" pos="0.1 0.2 0.3"', second='axis="1 1 1" pos="0 0.5 0"'
    ),
    "reference in degrees": two_joints(
        first='axis="0 1 0" ref="30" pos="0.1 0.2 0.3" range="-50 60"', second='axis="0 1 1" ref="-20"'
    ),
    "reference of a slide": two_joints(
        first='axis="0 1 1" type="slide" ref="0.3" range="-0.1 0.5"',
        second='axis="0 1 1" range="40 90" ref="50"',
    ),
    "several joints of a body": document(
        body(
            "b1",
            joint("pan", 'axis="0 0 1" pos="0.1 0 0" range="-10 20"'),
            joint("lift", 'type="slide" axis="0 1 1" pos="3 2 1" ref="0.1" range="0 0.4"'),
            joint("tilt", 'axis="1 1 0" pos="0 0.2 0.1" ref="10"'),
            CHAIN,
            at='pos="0 0 0.5" euler="10 20 30"',
        )
    ),
    "defaults and classes": document(
        body(
            "b1", joint("j1", ""), f'<body name="b2" childclass="other">{GEOM}{joint("j2", "")}{TIP}</body>'
        ),
        before='<default><joint axis="0 1 0" range="-10 20"/><default class="other">'
        '<joint axis="0 1 1" pos="0.2 0 0" range="-30 20"/><site pos="0.3 0 0" euler="0 10 0"/></default>'
        "</default>",
    ),
    "no limits although there is a range": two_joints(first='axis="0 1 0" limited="false" range="-50 60"'),
    "no automatic limits": two_joints(
        first='axis="0 1 0" limited="true" range="-50 60"',
        second='axis="0 0 1" limited="false" range="-50 60"',
        before='<compiler autolimits="false"/>',
    ),
    "a joint without limits": two_joints(first='axis="0 1 0"'),
    "sites of the world and free bodies beside the arm": document(
        body("b1", joint("j1"), CHAIN),
        '<site name="mark" pos="1 1 1"/><geom type="plane" size="1 1 1"/>',
        '<body name="ball" pos="1 0 0"><freejoint/><geom size="0.1"/></body>',
        after='<keyframe><key name="home" qpos="0.1 0.1 1 0 0 1 0 0 0"/></keyframe>',
    ),
    "masses from shapes": two_joints(before='<compiler inertiafromgeom="true" balanceinertia="true"/>'),
    "names of bodies and joints in common": document(
        body("j1", joint("j1"), body("world_fixed", joint("b1", 'axis="0 0 1"'), TIP))
    ),
    "no names but of joints": document(
        f'<body>{GEOM}{joint("j1")}<body pos="0.3 0 0">{GEOM}{joint("body_1")}{TIP}</body></body>'
    ),
}


@pytest.mark.parametrize("name", KINEMATICS)
def test_an_arm_moves_as_in_mujoco(name: str) -> None:
    xml = KINEMATICS[name]
    arm = check(xml)
    model = mujoco.MjModel.from_xml_string(xml)
    moving = [model.joint(index).name for index in range(model.njnt) if model.jnt_type[index] >= 2]
    assert list(arm.joint_names) == moving


@pytest.mark.long
def test_random_trees_move_as_in_mujoco() -> None:
    rng = np.random.default_rng(1)

    def numbers(count: int) -> str:
        return " ".join(map(repr, rng.normal(size=count).tolist()))

    for _ in range(30):
        inner = f'<site name="tip" pos="{numbers(3)}" quat="{numbers(4)}"/>'
        count = itertools.count()
        for number in range(rng.integers(2, 5)):
            joints = ""
            for _ in range(rng.integers(0 if number else 1, 4)):
                kind = rng.choice(["hinge", "slide"])
                ref, lower, extent = rng.uniform(-1.0, 1.0, 3).tolist()
                edges = f'range="{lower} {lower + 0.1 + abs(extent)}"' if rng.random() < 0.7 else ""
                joints += (
                    f'<joint name="q{next(count)}" type="{kind}" axis="{numbers(3)}" pos="{numbers(3)}" '
                    f'ref="{ref}" {edges}/>'
                )
            at = f'pos="{numbers(3)}" quat="{numbers(4)}"'
            inner = body(f"b{number}", joints, inner, at=at)
        arm = check(document(inner, before='<compiler angle="radian"/>'))
        assert arm.nv >= 1


def test_files_that_a_file_names_are_read(tmp_path: Path) -> None:
    part = two_joints()
    (tmp_path / "parts").mkdir()
    (tmp_path / "parts" / "arm.xml").write_text(part)
    scene = tmp_path / "scene.xml"
    scene.write_text(
        '<mujoco model="scene"><include file="parts/arm.xml"/><worldbody><light pos="0 0 1"/>'
        '<geom type="plane" size="1 1 1"/></worldbody></mujoco>'
    )
    arm = quiet(scene)
    assert apart(mujoco.MjModel.from_xml_path(str(scene)), arm) < 1e-12
    attached = tmp_path / "attached.mjcf"
    attached.write_text(
        '<mujoco><asset><model name="part" file="parts/arm.xml"/></asset><worldbody>'
        '<body name="base" pos="0 1 0"><geom size="0.1"/><frame euler="0 0 30">'
        '<attach model="part" body="b1" prefix="left_"/></frame>'
        "</body></worldbody></mujoco>"
    )
    arm = quiet(attached)
    assert arm.joint_names == ("left_j1", "left_j2")
    assert apart(mujoco.MjModel.from_xml_path(str(attached)), arm, "left_tip") < 1e-12


def test_a_replicated_body_is_a_branch_each() -> None:
    inner = body("b2", joint("j2", 'axis="0 0 1"'), TIP)
    xml = document(
        body("b1", joint("j1"), f'<replicate count="3" euler="0 0 30" offset="0.1 0 0">{inner}</replicate>')
    )
    with pytest.raises(URDFError, match=r"chains with equally many moving joints \(2\); pass tip="):
        pp.Arm.load(xml)
    model = mujoco.MjModel.from_xml_string(xml)
    names = [model.site(index).name for index in range(model.nsite)]
    for name in names:
        assert apart(model, quiet(xml, tip=name), name) < 1e-12


def test_soft_bodies_beside_the_arm_are_left_alone() -> None:
    cloth = (
        '<flexcomp name="cloth" type="grid" count="3 3 1" spacing="0.1 0.1 0.1" dim="2" mass="1">'
        '<edge equality="true"/></flexcomp>'
    )
    arm = check(document(body("b1", joint("j1"), CHAIN), cloth), tip="tip")
    assert arm.nv == 2


def test_a_cable_of_ball_joints_is_refused() -> None:
    """MuJoCo 4 has no composites; before, a cable is one."""
    links = "".join(f'<body name="c{k}" pos="0.1 0 0">{GEOM}<joint type="ball"/>' for k in range(4))
    with pytest.raises(
        URDFError, match=r"joint 'c0_joint': is a ball joint, .* put three hinges in its place"
    ):
        pp.Arm.load(document(links + 4 * "</body>"), tip="c3")


# Couplings and what cannot be a chain.

POLYNOMIAL = '<joint name="gear" joint1="j2" joint2="j1" polycoef="{}"/>'


def equality(content: str) -> str:
    return f"<equality>{content}</equality>"


@pytest.mark.parametrize(
    ("first", "second"),
    [
        ('axis="0 1 0" range="-50 60"', 'axis="0 0 1" range="-50 60"'),
        ('axis="0 1 0" range="-50 60" ref="20"', 'axis="0 0 1" range="-60 50" ref="-30"'),
        ('type="slide" axis="1 0 0" range="0 0.3" ref="0.1"', 'axis="0 0 1" range="-60 50" ref="-30"'),
        ('axis="0 1 0"', 'axis="0 0 1"'),
    ],
)
def test_a_linear_equality_couples_two_joints(first: str, second: str) -> None:
    xml = two_joints(first, second, after=equality(POLYNOMIAL.format("0.05 -0.5 0 0 0")))
    model = mujoco.MjModel.from_xml_string(xml)
    arm = quiet(xml)
    assert arm.joint_names == ("j1",)
    assert arm.couplings[0][:3] == ("j2", "j1", -0.5)
    assert apart(model, arm) < 1e-12
    rng = np.random.default_rng(0)
    for _ in range(5):
        data = put_into_mujoco(model, arm, arm.random(rng))
        mujoco.mj_forward(model, data)
        rows = data.efc_type == mujoco.mjtConstraint.mjCNSTR_EQUALITY
        assert np.abs(data.efc_pos[rows]).max() < 1e-12
        ranges = data.efc_type == mujoco.mjtConstraint.mjCNSTR_LIMIT_JOINT
        assert np.all(data.efc_pos[ranges] > -1e-12)  # the followers keep their limits, too


def test_an_equality_of_one_joint_holds_it() -> None:
    only = '<joint joint1="j2" polycoef="0.2 0 0 0 0"/>'
    for content in (only, POLYNOMIAL.format("0.2 0 0 0 0")):
        xml = two_joints(second='axis="0 0 1" ref="10"', after=equality(content))
        with pytest.warns(PostureWarning, match="lock joint 'j2' on the chain"):
            arm = pp.Arm.load(xml)
        model = mujoco.MjModel.from_xml_string(xml)
        data = mujoco.MjData(model)
        data.joint("j1").qpos[:] = 0.3
        data.joint("j2").qpos[:] = 0.2 + np.radians(10.0)
        mujoco.mj_kinematics(model, data)
        assert arm.joint_names == ("j1",)
        np.testing.assert_allclose(arm.at([0.3]).points[-1], data.site("tip").xpos, atol=1e-12)


def test_what_a_file_switches_off_does_not_count() -> None:
    nonlinear = POLYNOMIAL.format("0 0.5 0.1 0 0")
    inactive = nonlinear.replace("<joint", '<joint active="false"')
    weld = '<weld body1="b2" active="false"/>'
    assert check(two_joints(after=equality(inactive + weld))).nv == 2
    for flag in ("equality", "constraint"):
        off = f'<option><flag {flag}="disable"/></option>'
        assert quiet(two_joints(before=off, after=equality(nonlinear))).nv == 2
    for flag in ("limit", "constraint"):
        arm = quiet(two_joints(before=f'<option><flag {flag}="disable"/></option>'))
        assert np.all(np.isinf(arm.limits.upper))


PULLED = '<fixed name="cord"><joint joint="j1" coef="1"/><joint joint="j2" coef="2"/></fixed>'
CORD = f"<tendon>{PULLED}</tendon>"
STRING = (
    '<tendon><spatial name="string" limited="true" range="0 1">'
    '<site site="start"/><site site="tip"/></spatial></tendon>'
)
PULL = '<actuator><position name="winch" tendon="cord" kp="1"/></actuator>'

REFUSED = {
    "weld to the world": (
        equality('<weld name="w" body1="b2"/>'),
        "j1",
        "<weld> 'w' between bodies 'b2' and 'world'",
    ),
    "weld of sites": (
        equality('<weld name="w" site1="tip" site2="start"/>'),
        "j1",
        "<weld> 'w' between bodies 'b2' and 'world'",
    ),
    "loop": (equality('<connect body1="b2" body2="b1" anchor="0 0 0"/>'), "j2", "<connect> number 1 between"),
    "polynomial": (
        equality(POLYNOMIAL.format("0 0.5 0.1 0 0")),
        "j2",
        "follows joint 'j1' by a polynomial, the <equality> 'gear'; allowed: a ratio and an offset",
    ),
    "two leaders": (
        equality(POLYNOMIAL.format("0 1 0 0 0") + '<joint joint1="j2" polycoef="0 0 0 0 0"/>'),
        "j2",
        "follows more than one joint",
    ),
    "two ends of a tendon": (
        CORD + equality('<tendon name="t" tendon1="cord"/>'),
        "j1",
        "coupled by the <equality> 't' of tendon 'cord'",
    ),
    "tendon that drives two joints": (
        CORD + PULL,
        "j1",
        "driven by tendon 'cord', which moves 'j1', 'j2'; lock",
    ),
    "limited tendon": (CORD.replace('"cord"', '"cord" range="0 1"'), "j1", "range (0 to 1) of tendon 'cord'"),
    "limited spatial tendon": (STRING, "j1", "range (0 to 1) of tendon 'string'"),
}


@pytest.mark.parametrize("name", REFUSED)
def test_what_ties_joints_is_refused_by_name(name: str) -> None:
    after, tied, words = REFUSED[name]
    xml = two_joints(after=after).replace("<worldbody>", '<worldbody><site name="start"/>')
    with pytest.raises(URDFError) as caught:
        pp.Arm.load(xml)
    assert caught.value.element == f"joint {tied!r}"
    assert words in str(caught.value)
    assert "lock it (locked={" in str(caught.value)
    free = body(
        "c1", joint("k1"), body("c2", joint("k2"), '<site name="other" pos="0.1 0 0"/>'), at='pos="3 0 0"'
    )
    beside = xml.replace("<worldbody>", f"<worldbody>{free}")
    assert quiet(beside, tip="other").joint_names == ("k1", "k2")


def test_a_locked_joint_may_be_tied() -> None:
    xml = two_joints(after=equality(POLYNOMIAL.format("0 0.5 0.1 0 0")))
    assert quiet(xml, locked={"j2": 0.1}).joint_names == ("j1",)


def test_joints_with_actuators_of_their_own_may_have_a_tendon() -> None:
    own = '<actuator><motor joint="j1"/><motor joint="j2"/><position tendon="cord" kp="1"/></actuator>'
    assert check(two_joints(after=CORD + own)).nv == 2
    assert check(two_joints(after=CORD)).nv == 2  # a spring
    coupled = equality(POLYNOMIAL.format("0 1 0 0 0"))
    assert quiet(two_joints(after=CORD + PULL + coupled)).nv == 1


def test_ball_joints_and_mocap_bodies_are_refused_and_a_base_slides_is_fixed() -> None:
    ball = document(body("b1", joint("j1"), body("b2", '<joint name="k" type="ball"/>', CHAIN)))
    with pytest.raises(URDFError, match=r"joint 'k': is a ball joint, .*; tip='b1' ends the arm before it"):
        pp.Arm.load(ball)
    assert quiet(ball, base="b2", tip="tip").joint_names == ("j3",)
    first = document(body("b1", '<joint name="k" type="ball"/>', CHAIN))
    with pytest.raises(URDFError, match="joint 'k': is a ball joint"):
        pp.Arm.load(first)
    mocap = document(f'<body name="hand" mocap="true" pos="1 2 3">{body("b1", joint("j1"), CHAIN)}</body>')
    with pytest.raises(URDFError, match=r"body 'hand' is a mocap body, .* start at it \(base='hand', tip="):
        pp.Arm.load(mocap)
    arm = quiet(mocap, base="hand", tip="tip")
    assert apart(mujoco.MjModel.from_xml_string(mocap), arm) < 1e-12
    floating = document(
        body("b1", '<freejoint name="root"/>', body("b2", joint("j2"), CHAIN), at='pos="1 2 3"')
    )
    with pytest.warns(
        PostureWarning, match=r"joint 'root' \(floating\) at the base of the arm is treated as fixed"
    ):
        arm = pp.Arm.load(floating)
    assert apart(mujoco.MjModel.from_xml_string(floating), arm) < 1e-12


def test_branches_need_a_tip() -> None:
    ends = {side: f'<site name="{side}" pos="0.1 0 0"/>' for side in "lr"}
    xml = document(*(body(f"{side}1", joint(f"{side}_j"), end) for side, end in ends.items()))
    with pytest.raises(URDFError, match=r"links 'l', 'r': are the ends of chains .* pass tip= to choose"):
        pp.Arm.load(xml)
    assert quiet(xml, tip="r").joint_names == ("r_j",)


def test_names_that_collide_are_made_distinct() -> None:
    xml = document(body("tip", joint("j1"), body("b2", joint("j2", 'axis="0 0 1"'), TIP)))
    arm = quiet(xml)
    assert arm.report.tip == "tip_site"
    assert apart(mujoco.MjModel.from_xml_string(xml), arm) < 1e-12
    with pytest.raises(UnknownName, match="did you mean"):
        pp.Arm.load(xml, tip="tip_sit")


# Drives, masses, shapes.


def test_effort_and_speed_follow_from_actuators() -> None:
    xml = two_joints(
        after="<actuator>"
        '<position joint="j1" kp="10" forcerange="-3 4" gear="2" ctrlrange="-1 1"/>'
        '<motor joint="j2" ctrlrange="-3 3" gear="-5"/>'
        "</actuator>"
    )
    arm = quiet(xml)
    model = mujoco.MjModel.from_xml_string(xml)
    data = mujoco.MjData(model)
    data.ctrl[:] = 1e6
    data.qvel[:] = 0.0
    mujoco.mj_forward(model, data)
    np.testing.assert_allclose(arm.model.effortLimit, np.abs(data.qfrc_actuator))
    assert np.all(arm.limits.velocity == np.inf) or np.all(arm.limits.velocity >= 1e8)
    servo = two_joints(
        first='axis="0 1 0" actuatorfrcrange="-7 7"',
        after='<actuator><velocity joint="j1" kv="3" ctrlrange="-2 2"/><velocity joint="j2" kv="1" gear="4" '
        'ctrlrange="-2 2"/></actuator>',
    )
    arm = quiet(servo)
    np.testing.assert_allclose(arm.model.velocityLimit, [2.0, 0.5])
    assert arm.model.effortLimit[0] == 7.0
    integrated = two_joints(
        after='<actuator><intvelocity joint="j1" kp="5" ctrlrange="-2 2" actrange="-1 1"/>'
        '<general joint="j2" dyntype="integrator" gainprm="3" ctrlrange="-2 2" actrange="-1 1"/></actuator>'
    )
    arm = quiet(integrated)
    assert arm.model.velocityLimit[0] == 2.0
    assert np.all(arm.model.effortLimit >= 1e8)  # its control is the rate of a force


def test_masses_are_those_of_mujoco() -> None:
    shapes = (
        '<geom type="capsule" fromto="0 0 0 0.1 0.02 0.03" size="0.02"/>'
        '<geom type="box" size="0.1 0.02 0.03"/>'
    )
    xml = document(
        body(
            "b1",
            joint("j1", 'axis="0 1 0" damping="0.3" frictionloss="0.2"'),
            body("b2", joint("j2", 'pos="0.1 0 0" axis="1 0 1"'), TIP, at='euler="10 20 30"', geom=shapes),
            geom=shapes,
        )
    )
    arm = quiet(xml)
    model = mujoco.MjModel.from_xml_string(xml)
    np.testing.assert_allclose(pin.computeTotalMass(arm.model), model.body_mass.sum(), rtol=1e-12)
    rng = np.random.default_rng(0)
    for _ in range(3):
        q = arm.random(rng)
        data = put_into_mujoco(model, arm, q)
        mujoco.mj_forward(model, data)
        full = np.array([[0.0, 0.0], [0.0, 0.0]])
        for row, unit in zip(full, np.eye(2), strict=True):
            mujoco.mj_mulM(model, data, row, unit)
        found = pin.crba(arm.model, arm.model.createData(), q)
        found = np.triu(found) + np.triu(found, 1).T
        np.testing.assert_allclose(found, full, rtol=1e-9, atol=1e-12)
        gravity = pin.computeGeneralizedGravity(arm.model, arm.model.createData(), q)
        np.testing.assert_allclose(gravity, data.qfrc_bias, rtol=1e-9, atol=1e-12)
    whole = pin.buildModelFromXML(arm.urdf)
    assert (whole.damping[0], whole.upperDryFrictionLimit[0]) == (0.3, 0.2)


SHAPES = {
    "sphere": '<geom size="0.05" pos="0.1 0 0.02"/>',
    "capsule": '<geom type="capsule" fromto="0 0.1 0 0.2 0 0.1" size="0.03"/>',
    "cylinder": '<geom type="cylinder" size="0.03 0.1" pos="0.1 0 0" euler="10 20 30"/>',
    "box": '<geom type="box" size="0.1 0.03 0.02" pos="0.1 0 0" euler="10 20 30"/>',
    "ellipsoid": '<geom type="ellipsoid" size="0.03 0.12 0.02" pos="0.1 0 0" euler="10 20 30"/>',
    "round ellipsoid": '<geom type="ellipsoid" size="0.05 0.05 0.02" pos="0.1 0 0" euler="10 20 30"/>',
}


def surface(model: mujoco.MjModel, data: mujoco.MjData, index: int, rng: np.random.Generator) -> np.ndarray:
    """Points on the surface of a shape of MuJoCo, found by its rays, (n, 3) [m]."""
    center = data.geom_xpos[index]
    points = []
    for _ in range(200):
        direction = rng.normal(size=3)
        direction /= np.linalg.norm(direction)
        hit = np.zeros(1, dtype=np.int32)
        start = center + direction  # outside, looking back
        distance = mujoco.mj_ray(model, data, start, -direction, None, True, -1, hit)
        if hit[0] == index:
            points.append(start - distance * direction)
    return np.array(points)


def distances(arm: pp.Arm, q: np.ndarray, link: str, points: np.ndarray) -> np.ndarray:
    """Distances of points from the bodies of a link; zero inside, (n,) [m]."""
    (joint_id,) = {each.joint for each in bodies_of(arm) if each.name == link}
    data = arm.model.createData()
    pin.forwardKinematics(arm.model, data, q)
    local = [data.oMi[joint_id].inverse().act(point) for point in points]
    shapes = [each.shape for each in bodies_of(arm) if each.name == link]
    return np.array([min(distance_to(shape, point) for shape in shapes) for point in local])


def distance_to(shape: object, point: np.ndarray) -> float:
    """Signed distance of a point from a solid, from textbook formulas [m]."""
    if isinstance(shape, pp.Sphere):
        return float(np.linalg.norm(point - shape.center) - shape.radius)
    if isinstance(shape, pp.Capsule):
        start = np.array(shape.start)
        end = np.array(shape.end)
        share = np.clip(
            (point - start) @ (end - start) / max((end - start) @ (end - start), 1e-300), 0.0, 1.0
        )
        return float(np.linalg.norm(point - start - share * (end - start)) - shape.radius)
    if isinstance(shape, pp.Cylinder):
        start = np.array(shape.start)
        end = np.array(shape.end)
        axis = (end - start) / np.linalg.norm(end - start)
        along = abs((point - (start + end) / 2.0) @ axis) - np.linalg.norm(end - start) / 2.0
        across = np.linalg.norm(np.cross(axis, point - start)) - shape.radius
        return float(max(along, across))
    if isinstance(shape, pp.Box):
        offset = np.abs(np.array(shape.rotation).T @ (point - np.array(shape.center)))
        return float((offset - np.array(shape.size) / 2.0).max())
    raise AssertionError(shape)


@pytest.mark.parametrize("kind", SHAPES)
def test_shapes_are_where_mujoco_has_them(kind: str) -> None:
    inner = body("b2", joint("j2", 'axis="0 0 1" pos="0.02 0 0" ref="10"'), TIP, geom=SHAPES[kind])
    xml = document(body("b1", joint("j1"), inner))
    model = mujoco.MjModel.from_xml_string(xml)
    arm = quiet(xml)
    q = arm.configuration([0.3, 0.7])
    data = put_into_mujoco(model, arm, q)
    mujoco.mj_kinematics(model, data)
    points = surface(model, data, 1, np.random.default_rng(0))
    assert len(points) > 150
    off = distances(arm, q, "b2", points)
    if kind.endswith("ellipsoid"):
        assert off.max() < 1e-9  # the capsule is around it, and touches it
        assert off.max() > -0.005
    else:
        assert np.abs(off).max() < 1e-9


MESH = """<mujoco><compiler meshdir="meshes"/><asset>{asset}</asset><worldbody>
<body name="b1"><joint name="j1" axis="0 1 0"/><geom size="0.01"/>
<body name="b2" pos="0.1 0 0"><joint name="j2" axis="0 0 1"/><site name="tip" pos="0.1 0 0"/>
<geom type="mesh" mesh="wedge" pos="0.02 0.03 0" euler="10 20 30"/></body></body>
</worldbody></mujoco>"""
VERTICES = np.array([[0.0, 0.0, 0.0], [3.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.5, 0.2, 0.7], [0.1, 0.1, 0.9]])


@pytest.fixture
def wedge(tmp_path: Path) -> Path:
    """A folder with a mesh of no symmetry."""
    (tmp_path / "meshes").mkdir()
    hull = trimesh.Trimesh(VERTICES).convex_hull
    for suffix in ("stl", "obj"):
        hull.export(tmp_path / "meshes" / f"wedge.{suffix}")
    return tmp_path


INLINE = " ".join(map(str, VERTICES.ravel()))
ASSETS = {
    "stl": ('<mesh name="wedge" file="wedge.stl" scale="0.1 0.2 -0.1"/>', True),
    "obj": ('<mesh file="wedge.obj" scale="0.1 0.1 0.1"/>', True),
    "moved": ('<mesh file="wedge.stl" scale="0.1 0.1 0.1" refpos="1 2 3"/>', False),
    "turned": ('<mesh file="wedge.stl" scale="0.1 0.1 0.1" refquat="1 1 0 0"/>', False),
    "inline": (f'<mesh name="wedge" vertex="{INLINE}" scale="0.1 0.1 0.1"/>', False),
}


@pytest.mark.parametrize("kind", ASSETS)
def test_meshes_are_where_mujoco_has_them(wedge: Path, kind: str) -> None:
    asset, read = ASSETS[kind]
    file = wedge / "arm.xml"
    file.write_text(MESH.format(asset=asset))
    model = mujoco.MjModel.from_xml_path(str(file))
    arm = quiet(file)
    read = read and bytes(model.paths).startswith(b"/")  # early versions of MuJoCo tell no folder
    assert ('filename="meshes/wedge' in (arm.urdf or "")) is read
    q = arm.configuration([0.3, 0.7])
    data = put_into_mujoco(model, arm, q)
    mujoco.mj_kinematics(model, data)
    vertices = data.geom_xpos[1] + model.mesh_vert @ data.geom_xmat[1].reshape(3, 3).T
    ((_, joint_id, shape),) = [each for each in bodies_of(arm) if each.name == "b2"]
    placements = arm.model.createData()
    pin.forwardKinematics(arm.model, placements, q)
    local = np.array([placements.oMi[joint_id].inverse().act(vertex) for vertex in vertices])
    if read:
        corners = np.array(shape.center) + shape.vertices @ np.array(shape.rotation).T
        gaps = np.linalg.norm(local[:, None] - corners[None], axis=2)
        assert len(corners) == len(VERTICES)
        assert gaps.min(axis=0).max() < 1e-6
        assert gaps.min(axis=1).max() < 1e-6
    else:  # the box around it
        assert isinstance(shape, pp.Box)
        off = np.array([distance_to(shape, point) for point in local])
        assert -1e-6 < off.max() < 1e-6


# Errors, and arms that are saved.


def test_without_mujoco_the_error_names_the_extra(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    file = tmp_path / "arm.xml"
    file.write_text(two_joints())
    monkeypatch.setitem(sys.modules, "mujoco", None)
    words = r"arm\.xml: MJCF needs MuJoCo .* pip install 'pinposture\[sim\]'"
    with pytest.raises(mjcf.MujocoMissing, match=words):
        pp.Arm.load(file)


@pytest.mark.parametrize(
    ("xml", "words"),
    [
        ('<mujoco><worldbody><body><joint type="none"/></body></worldbody></mujoco>', "keyword: 'none'"),
        ("<mujocoinclude/>", "Unrecognized XML model type: 'mujocoinclude'"),
        ('<mujoco><include file="lost.xml"/></mujoco>', "lost.xml"),
        ('<mujoco><asset><mesh file="lost.stl"/></asset></mujoco>', "lost.stl"),
        ("<mujoco><worldbody>", "rejected by MuJoCo"),
        (document(body("b", "<joint/>", geom="")), "mass and inertia of moving bodies"),
        (two_joints() + two_joints(), "has content after </mujoco>, which MuJoCo ignores: '<mujoco model="),
    ],
)
def test_what_mujoco_rejects_is_refused_with_its_reason(tmp_path: Path, xml: str, words: str) -> None:
    file = tmp_path / "arm.xml"
    file.write_text(xml)
    for source in (file, xml):
        with pytest.raises(FileError) as caught:
            pp.Arm.load(source)
        assert words in str(caught.value)
        assert "\n" not in str(caught.value)


def test_a_difference_from_mujoco_is_refused(monkeypatch: pytest.MonkeyPatch) -> None:
    real = mjcf.write_joint

    def moved(robot, joint):
        x, y, z = joint.origin
        return real(robot, replace(joint, origin=(x + 1e-6, y, z)) if joint.name == "j2" else joint)

    monkeypatch.setattr(mjcf, "write_joint", moved)
    with pytest.raises(URDFError, match=r"link '.*': would be 0.001 mm and .* from where MuJoCo places it"):
        pp.Arm.load(two_joints())

    def widened(robot, joint):
        return real(robot, replace(joint, lower=-1.0, upper=1.0))

    monkeypatch.setattr(mjcf, "write_joint", widened)
    with pytest.raises(URDFError, match=r"joint 'j1': would have limits -1.0 1.0, in MuJoCo -0.87"):
        pp.Arm.load(two_joints())


def test_the_root_decides_what_a_file_is(tmp_path: Path) -> None:
    header = "<?xml version='1.0'?><!-- a <robot> -- > <mujoco> -->\n"
    (tmp_path / "arm.robot").write_text("\ufeff" + header + two_joints())
    assert quiet(tmp_path / "arm.robot").joint_names == ("j1", "j2")
    urdf = pp.Arm.from_template("RyRz", 2).urdf
    assert urdf is not None
    extended = urdf.replace("<material", '<mujoco><compiler discardvisual="false"/></mujoco><material', 1)
    (tmp_path / "arm.xml").write_text(extended)
    assert quiet(tmp_path / "arm.xml").nv == 4
    assert not mjcf.is_mjcf("<!-- " * 5000 + "<robot>")
    assert quiet(f"<!-- was: <mujoco></mujoco> -- -->{two_joints()}<!-- end -->").nv == 2


def test_names_are_utf_8_as_mujoco_reads_them(tmp_path: Path) -> None:
    xml = two_joints().replace("b2", "größer")
    file = tmp_path / "arm.xml"
    file.write_bytes(xml.encode())
    assert "größer" in (quiet(file).urdf or "")
    for code in ("ISO-8859-1", "windows-1252"):
        file.write_bytes(f'<?xml version="1.0" encoding="{code}"?>{xml}'.encode(code))
        with pytest.raises(FileError, match="not UTF-8, the only encoding that MuJoCo reads"):
            pp.Arm.load(file)


def test_an_arm_from_mjcf_is_saved_with_its_description(tmp_path: Path) -> None:
    file = tmp_path / "arm.xml"
    chain = body("b3", joint("j3", 'axis="0 0 1" range="-50 60"'), body("b4", joint("j4"), TIP))
    inner = body("b2", joint("j2", 'axis="0 0 1" ref="5" range="-50 60"'), chain)
    file.write_text(document(body("b1", joint("j1"), inner)))
    arm = quiet(file)
    run = pp.track(arm, pp.Target.from_configuration(arm, np.full(4, 0.2)), np.zeros(4))
    saved = pp.save(run, tmp_path / "run.npz")
    assert pp.Arm.from_spec(arm.spec).joint_names == arm.joint_names  # which names the file
    file.unlink()
    again = pp.load(saved, pp.Run)
    np.testing.assert_array_equal(again.q, run.q)
    q = np.full(4, 0.3)
    np.testing.assert_array_equal(again.arm.at(q).points, arm.at(q).points)
    text = quiet(arm.urdf)
    np.testing.assert_array_equal(text.at(q).points, arm.at(q).points)
    tied = two_joints(after=equality('<weld body1="b1"/>'))
    kept = quiet(tied, base="b1", tip="tip")
    with pytest.raises(URDFError, match="the <weld> number 1"):  # the description keeps what ties its joints
        pp.Arm.load(kept.urdf)
