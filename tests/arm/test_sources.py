"""Descriptions other than URDF: each makes the arm that Pinocchio, or the URDF by hand, has."""

from __future__ import annotations

import sys
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pinocchio as pin
import pytest
from test_example_robots import ROBOTS

import pinposture as pp
from pinposture.arm import sources
from pinposture.arm.model_builder import model_to_urdf
from pinposture.errors import FileError, PostureWarning, URDFError

MJCF = """<mujoco model="two"><compiler angle="radian"/><worldbody>
<body name="b1" pos="0 0 0.1"><joint name="j1" axis="0 1 0" range="-1 1" limited="true"/>
<joint name="j2" axis="0.6 0 0.8" pos="0.01 0 0"/><geom type="capsule" fromto="0 0 0 .1 0 0" size=".01"/>
<body name="b2" pos=".1 0 .02" quat="0.7 0.1 0.5 -0.2">
<joint name="j3" type="slide" range="0 .1" limited="true"/>
<geom type="capsule" fromto="0 0 0 .1 0 0" size=".01"/><site name="end" pos=".1 .03 0"/></body></body>
</worldbody></mujoco>"""

MACRO = """<robot xmlns:xacro="http://www.ros.org/wiki/xacro"><xacro:macro name="segment" params="i">
<link name="l${i}"/><joint name="j${i}" type="revolute"><parent link="l${i-1}"/><child link="l${i}"/>
<origin xyz="0.1 0 0"/><axis xyz="0 ${i%2} ${1-i%2}"/>
<limit lower="-1" upper="1" effort="1" velocity="1"/></joint></xacro:macro></robot>"""

CALLS = """<robot name="snake" xmlns:xacro="http://www.ros.org/wiki/xacro"><xacro:arg name="n" default="5"/>
{include}<link name="l0"/><xacro:segment i="1"/><xacro:segment i="2"/><xacro:segment i="3"/>
<xacro:segment i="4"/><xacro:if value="${{$(arg n) > 4}}"><xacro:segment i="5"/></xacro:if></robot>"""


@pytest.fixture
def xacro(tmp_path: Path) -> Path:
    """A xacro file that includes another, and has an argument."""
    (tmp_path / "parts").mkdir()
    (tmp_path / "parts" / "segment.xacro").write_text(MACRO)
    file = tmp_path / "snake.urdf.xacro"
    file.write_text(CALLS.format(include='<xacro:include filename="parts/segment.xacro"/>'))
    return file


@pytest.fixture
def mjcf(tmp_path: Path) -> Path:
    file = tmp_path / "two.xml"
    file.write_text(MJCF)
    return file


def frames_apart(model: pin.Model, text: str, q: np.ndarray) -> float:
    """Largest difference of the placements of all bodies and sites, in the model and in its URDF."""
    other = pin.buildModelFromXML(text)
    assert other.nq == model.nq
    data = model.createData()
    written = other.createData()
    pin.framesForwardKinematics(model, data, q)
    pin.framesForwardKinematics(other, written, q)
    kinds = (pin.FrameType.BODY, pin.FrameType.OP_FRAME)
    apart = []
    for index, frame in enumerate(model.frames):
        if frame.type in kinds:
            there = written.oMf[other.getFrameId(frame.name, pin.FrameType.BODY)]
            apart.append(np.abs(data.oMf[index].homogeneous - there.homogeneous).max())
    return max(apart)


@pytest.mark.parametrize(
    "name",
    [
        "panda_description/urdf/panda.urdf",
        "ur_description/urdf/ur5_robot.urdf",
        "talos_data/robots/talos_reduced.urdf",
    ],
)
def test_a_model_is_written_as_it_is(name: str) -> None:
    model = pin.buildModelFromUrdf(str(ROBOTS / name))
    text = model_to_urdf(model)
    rng = np.random.default_rng(0)
    for _ in range(5):
        assert frames_apart(model, text, rng.uniform(-2.0, 2.0, model.nq)) < 1e-12
    other = pin.buildModelFromXML(text)
    for attribute in ("lowerPositionLimit", "upperPositionLimit", "velocityLimit", "effortLimit"):
        np.testing.assert_array_equal(getattr(other, attribute), getattr(model, attribute))
    for one, same in zip(list(model.inertias)[1:], list(other.inertias)[1:], strict=True):
        np.testing.assert_allclose(same.matrix(), one.matrix(), atol=1e-12)


def test_a_model_makes_the_arm_that_its_urdf_makes() -> None:
    file = ROBOTS / "ur_description/urdf/ur5_robot.urdf"
    arm = pp.Arm.load(file)
    same = pp.Arm.load(pin.buildModelFromUrdf(str(file)))
    q = np.random.default_rng(1).uniform(-1.0, 1.0, arm.nq)
    np.testing.assert_allclose(same.at(q).points, arm.at(q).points, atol=1e-12)
    assert (same.chain.joints, same.segmentation.sizes) == (arm.chain.joints, arm.segmentation.sizes)
    np.testing.assert_array_equal(same.limits.upper, arm.limits.upper)


def test_xacro_is_expanded(xacro: Path) -> None:
    arm = pp.Arm.load(xacro)
    assert arm.chain.joints == ("j1", "j2", "j3", "j4", "j5")
    macros = MACRO[MACRO.index("<xacro:macro") : MACRO.index("</robot>")]
    by_text = pp.Arm.load(CALLS.format(include=macros))
    q = np.linspace(-0.5, 0.7, 5)
    np.testing.assert_array_equal(by_text.at(q).points, arm.at(q).points)
    assert pp.Arm.from_spec(arm.spec).chain.joints == arm.chain.joints  # which names the file


@pytest.fixture
def described(monkeypatch: pytest.MonkeyPatch, tmp_path: Path):
    """Puts a description into robot_descriptions."""

    def put(**paths: object) -> None:
        found = SimpleNamespace(
            PACKAGE_PATH=str(tmp_path / "package"), REPOSITORY_PATH=str(tmp_path), **paths
        )
        monkeypatch.setitem(sys.modules, "robot_descriptions.snake_description", found)

    return put


def test_an_arm_is_loaded_by_its_name(described, xacro: Path, mjcf: Path, tmp_path: Path) -> None:
    file = tmp_path / "arm.urdf"
    file.write_text(pp.Arm.from_template("RyRz", 3).urdf)
    described(URDF_PATH=str(file))
    arm = pp.Arm.load("snake_description", split=3)
    assert arm.segmentation.sizes == (3, 3)
    assert str(tmp_path / "package") in arm.package_dirs
    again = pp.Arm.from_spec(arm.spec)  # without the package
    assert (again.chain.joints, again.package_dirs) == (arm.chain.joints, arm.package_dirs)
    described(XACRO_PATH=str(xacro), XACRO_ARGS={"n": "4"})
    assert pp.Arm.load("snake_description").nv == 4
    described(MJCF_PATH=str(mjcf))
    assert pp.Arm.load("snake_description").nv == 3


def test_what_cannot_be_found_or_converted_is_named(
    monkeypatch: pytest.MonkeyPatch, xacro: Path, tmp_path: Path
) -> None:
    def refused(source: object, error: type[Exception], *words: str) -> None:
        with pytest.raises(error) as caught:
            pp.Arm.load(source)
        assert all(word in str(caught.value) for word in words)

    refused("no_such_description", FileError, "no such file", "robot_descriptions")
    refused("no/such.xacro", FileError, "such.xacro")
    broken = tmp_path / "broken.xacro"
    broken.write_text(CALLS.format(include='<xacro:include filename="lost.xacro"/>'))
    refused(broken, FileError, "cannot be expanded", "lost.xacro")
    model = pin.Model()
    model.addJoint(0, pin.JointModelSpherical(), pin.SE3.Identity(), "ball")
    refused(model, URDFError, "joint 'ball'", "Spherical")
    monkeypatch.setitem(sys.modules, "xacro", None)
    refused(xacro, FileError, "pinposture[descriptions]")

    def offline(name: str) -> object:
        if name == "robot_descriptions":
            return None
        raise RuntimeError("no network\nat all")

    monkeypatch.setattr(sources, "import_module", offline)
    refused("panda_description", FileError, "cannot fetch it (RuntimeError: no network at all)")


def test_faults_name_the_source_that_was_given(tmp_path: Path) -> None:
    model = pin.Model()
    model.addJoint(0, pin.JointModelRZ(), pin.SE3.Identity(), "spin")  # the arm has no length
    point = tmp_path / "point.xml"
    point.write_text(
        '<mujoco><worldbody><body name="b"><joint name="j"/><geom size="1"/></body></worldbody></mujoco>'
    )
    urdf = model_to_urdf(model)
    macros = "<robot xmlns:xacro='http://www.ros.org/wiki/xacro'"
    text = urdf.replace("<robot", macros)
    (tmp_path / "point.xacro").write_text(text)
    for source, name in (
        (model, "pin.Model"),
        (point, str(point)),
        (text, "xacro text"),
        (tmp_path / "point.xacro", str(tmp_path / "point.xacro")),
        (urdf, "URDF text"),
    ):
        with pytest.raises(URDFError, match="zero length") as caught:
            pp.Arm.load(source)
        assert caught.value.source == name


def hand(*fingers: int) -> str:
    """An arm of three joints with a palm and fingers of so many joints each."""
    parts = ['<robot name="reach"><link name="base"/>']

    def add(name: str, parent: str) -> str:
        parts.append(
            f'<link name="{name}"/><joint name="to_{name}" type="revolute"><parent link="{parent}"/>'
            f'<child link="{name}"/><origin xyz="0.2 0 0"/>'
            f'<axis xyz="0 {len(parts) % 2} {1 - len(parts) % 2}"/>'
            '<limit lower="-1" upper="1" effort="1" velocity="1"/></joint>'
        )
        return name

    palm = add("palm", add("lower", add("upper", "base")))
    for number, joints in enumerate(fingers):
        link = palm
        for joint in range(joints):
            link = add(f"finger{number}_{joint}", link)
    return "".join(parts) + "</robot>"


def test_the_wrist_is_offered_before_the_tips_of_fingers() -> None:
    with pytest.raises(URDFError, match="or tip='palm', which carries them all"):
        pp.Arm.load(hand(2, 2))
    with pytest.warns() as given:
        arm = pp.Arm.load(hand(3, 2, 2))
    assert all(each.category is PostureWarning for each in given)
    told = [str(each.message) for each in given]
    assert any("ends in a finger, at link 'finger0_2'; tip='palm' ends it before" in each for each in told)
    assert any("4 joints off the chain" in each for each in told)
    assert arm.nv == 6
    with pytest.raises(URDFError) as caught:  # a trunk with arms is no wrist
        pp.Arm.load(hand(6, 6))
    assert "palm" not in str(caught.value)
