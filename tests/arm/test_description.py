"""A description without faults is read as what it says, and what does not matter is left alone."""

from __future__ import annotations

import dataclasses
import math
import pickle
from xml.etree import ElementTree

import numpy as np
import pinocchio as pin
import pytest
from arm.describing import LIMIT, joint, limit, links, one_joint, pinocchio_loads, robot

import pinposture as pp
from pinposture.arm.description import read_description
from pinposture.arm.urdf import Follows
from pinposture.errors import FileError, PostureWarning, URDFError


def test_a_good_description_is_read_field_by_field():
    inside = '<axis xyz="0 3 4"/><limit effort="1" velocity="2" lower="-1" upper="3"/><mimic joint="k"/>'
    text = robot(
        links("abc") + joint("k", "a", "b", "continuous") + joint("j", "b", "c", "prismatic", inside)
    )
    read = read_description(text)
    assert (read.name, read.source, read.root, read.links) == ("r", "URDF text", "a", ("a", "b", "c"))
    assert read.text == text
    first, second = read.joints
    assert (first.name, first.type, first.parent, first.child) == ("k", "continuous", "a", "b")
    assert (first.axis, first.velocity, first.follows) == ((1.0, 0.0, 0.0), None, None)
    assert (first.lower, first.upper) == (-math.inf, math.inf)
    assert second.axis == pytest.approx((0.0, 0.6, 0.8), abs=1e-15)
    assert (second.lower, second.upper, second.velocity) == (-1.0, 3.0, 2.0)
    assert second.follows == Follows("k", multiplier=1.0, offset=0.0)
    assert pickle.loads(pickle.dumps(read)) == read
    with pytest.raises(dataclasses.FrozenInstanceError):
        read.root = "b"


@pytest.mark.parametrize(
    ("kind", "limit", "expected", "moves"),
    [
        ("revolute", LIMIT, (-1.0, 3.0), True),
        ("revolute", '<limit effort="1" velocity="1"/>', (-math.inf, math.inf), True),
        ("prismatic", '<limit effort="1" velocity="1"/>', (-math.inf, math.inf), True),
        ("revolute", '<limit effort="1" velocity="1" upper="2"/>', (0.0, 2.0), True),
        ("revolute", '<limit effort="1" velocity="1" lower="-2"/>', (-2.0, 0.0), True),
        ("revolute", '<limit effort="1" velocity="1" lower="1" upper="1"/>', (1.0, 1.0), False),
        ("continuous", LIMIT, (-math.inf, math.inf), True),
        ("fixed", LIMIT, (0.0, 0.0), False),
        ("floating", "", (-math.inf, math.inf), True),
    ],
)
def test_limits_mean_what_urdf_says(kind, limit, expected, moves):
    (read,) = read_description(one_joint(kind, limit)).joints
    assert (read.lower, read.upper) == expected
    assert read.moves is moves


@pytest.mark.parametrize(
    "number",
    [
        "nan",
        "inf",
        "-inf",
        "1e400",
        "0x10",
        "1_0",
        "1,5",
        "",
        " ",
        "1 ",
        "1\n",
        "--1",
        "1e",
        ".",
        "١",
        "1f",
        "1\u00a0",
        "a" * 99,
    ],
)
def test_what_is_not_a_finite_number_is_refused_wherever_pinocchio_refuses_it(number):
    limit = one_joint(inside=f"<limit effort='1' velocity='1' lower='{number}' upper='9'/>")
    vector = one_joint(inside=LIMIT + f"<origin xyz='0 0 {number}x'/>")
    for text in (limit, vector):
        assert not pinocchio_loads(text)
        with pytest.raises(URDFError, match="allowed: a finite number") as caught:
            read_description(text)
        assert len(str(caught.value)) < 200


@pytest.mark.parametrize("number", ["1", "+1", "-1.", ".5", "1e-400", "1E+0", " 1", "\t1", "-0"])
def test_what_pinocchio_takes_for_a_number_is_one(number):
    text = one_joint(inside=f"<limit effort='1' velocity='1' lower='{number}' upper='9'/>")
    model = pin.buildModelFromXML(text)
    assert read_description(text).joints[0].lower == model.lowerPositionLimit[0]


@pytest.mark.parametrize(
    "extra",
    [
        "<transmission name='t'><joint name='j'/><actuator name='m'/></transmission>",
        "<gazebo reference='a'><plugin><link/><ros:joint/></plugin></gazebo>",
        "<sensor name='s'/><link_group/><group><link name='a'/></group>",
        "<!-- <link name='a'/> --><![CDATA[<link name='a'/>]]>",
        "<material/><material name='m'/>",
    ],
)
def test_extensions_are_left_alone(extra):
    text = one_joint().replace("</robot>", extra + "</robot>")
    read = read_description(text)
    assert (read.links, len(read.joints)) == (("a", "b"), 1)
    assert pinocchio_loads(read.text)


@pytest.mark.parametrize(
    "root", ['<robot xmlns="http://drake.mit.edu" name="r">', '<robot name="r" xmlns:x="y">']
)
def test_namespaces_do_not_matter(root):
    assert read_description(one_joint().replace('<robot name="r">', root)).links == ("a", "b")


def test_parts_that_a_joint_type_does_not_use_are_not_checked():
    for kind in ("fixed", "floating"):
        assert read_description(one_joint(kind, "<axis xyz='0 0 0'/>")).joints[0].axis == (1.0, 0.0, 0.0)


@pytest.mark.parametrize(
    "lead", ["\ufeff", "\n\n  ", "\ufeff\n<?xml version='1.0' encoding='latin-1'?>\n", "<!--c-->"]
)
def test_what_precedes_the_root_does_not_matter_and_lines_still_count(tmp_path, lead):
    text = lead + one_joint()
    path = tmp_path / "robot.urdf"
    path.write_bytes(text.encode())
    for source in (text, path, str(path)):
        read = read_description(source)
        assert read.links == ("a", "b")
        assert pinocchio_loads(read.text)
    with pytest.raises(URDFError) as caught:
        read_description(text + "\n<")
    assert caught.value.element == f"line {text.count(chr(10)) + 2}"


def test_vectors_on_several_lines_reach_pinocchio_in_one_piece():
    text = one_joint(inside=LIMIT + "<origin\n xyz = '1\n\t2\r\n3' rpy='0\t0\n1'/><axis xyz=\"0\n0\n2\"/>")
    assert not pinocchio_loads(text)
    model = pin.buildModelFromXML(read_description(text).text)
    assert list(model.jointPlacements[1].translation) == [1.0, 2.0, 3.0]
    assert pin.rpy.matrixToRpy(model.jointPlacements[1].rotation) == pytest.approx([0.0, 0.0, 1.0], abs=1e-15)


@pytest.mark.parametrize(
    ("encoding", "declared"),
    [
        ("ISO-8859-1", "ISO-8859-1"),
        ("windows-1252", "windows-1252"),
        ("cp1251", "windows-1251"),
        ("utf-16", "utf-16"),
        ("utf-16-le", "UTF-16"),
        ("utf-16-be", "UTF-16"),
        ("utf-16", None),
        ("utf-8", "utf-16"),  # which it is not
        ("utf-8", "utf-8"),
        ("utf-8-sig", "utf-8"),
        ("utf-8-sig", "ISO-8859-1"),  # the mark decides
        ("utf-8", None),
    ],
)
def test_a_file_is_read_in_the_encoding_that_it_declares(tmp_path, encoding, declared):
    letter = "ж" if encoding == "cp1251" else "ü"
    body = robot(links([f"r{letter}ssel"]))
    declaration = (
        "" if declared is None else f'<?xml version="1.0" encoding="{declared}" standalone="yes"?>\n'
    )
    file = tmp_path / "arm.urdf"
    file.write_bytes((declaration + body).encode(encoding))
    description = read_description(file)
    assert description.links == (f"r{letter}ssel",)
    ElementTree.fromstring(description.text)  # declares nothing that text is not
    assert read_description(declaration + body).links == description.links


def test_text_that_is_not_in_its_encoding_is_named_with_it(tmp_path):
    file = tmp_path / "arm.urdf"
    body = robot(links("ü"))
    for encoding, content, words in (
        ("ascii", body.encode("utf-8"), ("is not ascii text (byte", "that it declares")),
        ("cp1252", body.encode("cp1252").replace(b"\xfc", b"\x81"), ("is not cp1252 text (byte",)),
        ("utf-8", body.encode("latin-1"), ("is not UTF-8 text (byte",)),
        ("klingon", body.encode(), ("'klingon', which is unknown", "UTF-8")),
        ("hex", body.encode(), ("'hex', which is unknown", "UTF-8")),
    ):
        file.write_bytes(f'<?xml version="1.0" encoding="{encoding}"?>'.encode() + content)
        with pytest.raises(FileError) as caught:
            read_description(file)
        assert all(word in str(caught.value) for word in (str(file), *words))


@pytest.mark.parametrize(
    ("once", "again", "words"),
    [
        ('<parent link="l0"/>', '<parent link="l2"/>', "joint 'j1' has 2 different <parent>"),
        ('<child link="l1"/>', '<child link="l0"/>', "joint 'j1' has 2 different <child>"),
        ('<origin xyz="0.1 0 0"/>', '<origin xyz="0.3 0 0"/>', "joint 'j1' has 2 different <origin>"),
        ('<axis xyz="0 0 1"/>', '<axis xyz="1 0 0"/>', "joint 'j1' has 2 different <axis>"),
        (limit(-1, 1), limit(-2, 1), "joint 'j1' has 2 different <limit>"),
        ('<dynamics damping="1"/>', '<dynamics damping="2"/>', "joint 'j1' has 2 different <dynamics>"),
        (
            "<inertial><mass value='1'/></inertial>",
            "<inertial><mass value='2'/></inertial>",
            "'l1' has 2 different <inertial>",
        ),
        ("<mass value='1'/>", "<mass value='2'/>", "link 'l1' has 2 different <mass> in <inertial>"),
        ("<box size='1 1 1'/>", "<sphere radius='1'/>", "link 'l1' has 2 different shapes in <geometry>"),
    ],
)
def test_the_first_of_doubled_elements_counts_and_others_are_told(once: str, again: str, words: str) -> None:
    text = robot(
        "<link name='l0'/><link name='l2'/><link name='l1'><inertial><mass value='1'/></inertial>"
        "<collision><geometry><box size='1 1 1'/></geometry></collision></link>"
        f'<joint name=\'j1\' type=\'revolute\'><parent link="l0"/><child link="l1"/><origin xyz="0.1 0 0"/>'
        f'<axis xyz="0 0 1"/>{limit(-1, 1)}<dynamics damping="1"/></joint>'
        "<joint name='j2' type='fixed'><parent link='l1'/><child link='l2'/><origin xyz='0.1 0 0'/></joint>"
    )
    assert once in text
    arm = pp.Arm.load(text)
    assert pp.Arm.load(text.replace(once, once + once)).warnings == arm.warnings  # the same twice
    with pytest.warns(PostureWarning, match=words):
        doubled = pp.Arm.load(text.replace(once, once + again))
    assert len(doubled.warnings) == len(arm.warnings) + 1
    np.testing.assert_array_equal(doubled.at([0.4]).points, arm.at([0.4]).points)
    assert doubled.limits.lower == arm.limits.lower
    read = [pin.buildModelFromXML(each) for each in (text, text.replace(once, once + again))]
    assert read[0] == read[1]  # as urdfdom has it
