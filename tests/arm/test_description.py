"""A description either loads as what it says or is refused for the true reason; it never hangs or crashes."""

from __future__ import annotations

import dataclasses
import math
import pickle
import random
import time

import pinocchio as pin
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from pinposture.arm.description import Description, read_description
from pinposture.arm.template import template
from pinposture.arm.urdf import modules_to_urdf
from pinposture.errors import FileError, InvalidValue, PostureError, UnknownName, URDFError

LIMIT = '<limit effort="1" velocity="2" lower="-1" upper="3"/>'


def robot(body):
    return f'<robot name="r">{body}</robot>'


def links(names):
    return "".join(f'<link name="{name}"/>' for name in names)


def joint(name, parent, child, kind="fixed", inside=""):
    return (
        f'<joint name="{name}" type="{kind}"><parent link="{parent}"/><child link="{child}"/>{inside}</joint>'
    )


def one_joint(kind="revolute", inside=LIMIT):
    return robot(links("ab") + joint("j", "a", "b", kind, inside))


def pinocchio_loads(text):
    try:
        pin.buildModelFromXML(text)
    except ValueError:
        return False
    return True


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
    assert (first.axis, first.velocity, first.mimic) == ((1.0, 0.0, 0.0), None, False)
    assert (first.lower, first.upper) == (-math.inf, math.inf)
    assert second.axis == pytest.approx((0.0, 0.6, 0.8), abs=1e-15)
    assert (second.lower, second.upper, second.velocity, second.mimic) == (-1.0, 3.0, 2.0, True)
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


FAULTS = {
    # a fault: text, element, words of the reason, and whether Pinocchio takes it without a word
    "not closed": ("<robot name='r'>\n\n<link name='a'>\n</robot>", "line 4", "mismatched tag", False),
    "two roots of XML": ("<robot name='r'><link name='a'/></robot>\n<x/>", "line 2", "junk", True),
    "wrong root": ("<model name='r'/>", "<model>", "allowed: <robot>", False),
    "no robot name": ("<robot><link name='a'/></robot>", "<robot>", "has no name", False),
    "blank robot name": ("<robot name=' '><link name='a'/></robot>", "<robot>", "has no name", True),
    "version": ("<robot name='r' version='2.0'><link name='a'/></robot>", "<robot>", "1.0, 1.1, 1.2", False),
    "no links": (robot(""), "<robot>", "has no links", False),
    "only macros": (
        "<robot name='r' xmlns:xacro='x'><xacro:include filename='a'/></robot>",
        "<robot>",
        "xacro macros",
        False,
    ),
    "link without name": (robot("<link name='a'/><link/>"), "link 2 of 2", "has no name", False),
    "link twice": (robot(links("aba")), "link 'a'", "2 times", False),
    "joint without name": (robot(links("ab") + joint("", "a", "b")), "joint 1 of 1", "has no name", True),
    "joint twice": (
        robot(links("abc") + joint("j", "a", "b") + joint("j", "b", "c")),
        "joint 'j'",
        "2 times",
        False,
    ),
    "material twice": (
        robot("<material name='m'><color rgba='1 0 0 1'/></material>" * 2 + links("a")),
        "material 'm'",
        "2 times",
        False,
    ),
    "no parent": (
        robot(links("ab") + "<joint name='j' type='fixed'><child link='b'/></joint>"),
        "joint 'j'",
        "no parent link",
        False,
    ),
    "no child": (
        robot(links("ab") + "<joint name='j' type='fixed'><parent link='a'/><child/></joint>"),
        "joint 'j'",
        "no child link",
        False,
    ),
    "missing parent": (
        robot(links("b") + joint("j", "a", "b")),
        "joint 'j'",
        "parent link 'a' does not",
        False,
    ),
    "missing child": (
        robot(links("a") + joint("j", "a", "b")),
        "joint 'j'",
        "child link 'b' does not",
        False,
    ),
    "own parent": (robot(links("a") + joint("j", "a", "a")), "joint 'j'", "parent and for its child", False),
    "two parents": (
        robot(links("abc") + joint("j", "a", "c") + joint("k", "b", "c")),
        "link 'c'",
        "joint 'j' and of joint 'k'",
        False,
    ),
    "two roots": (robot(links("abc") + joint("j", "a", "b")), "links 'a', 'c'", "the root", False),
    "circle": (
        robot(links("ab") + joint("j", "a", "b") + joint("k", "b", "a")),
        "joint 'k'",
        "circle",
        False,
    ),
    "circle beside a root": (
        robot(links("cab") + joint("j", "a", "b") + joint("k", "b", "a")),
        "joint 'k'",
        "'a', 'b', 'a'",
        True,
    ),
    "no type": (
        robot(links("ab") + joint("j", "a", "b").replace('type="fixed"', "")),
        "joint 'j'",
        "None",
        False,
    ),
    "unknown type": (one_joint("ball"), "joint 'j'", "revolute, continuous, prismatic, fixed", False),
    "type in capitals": (one_joint("Revolute"), "joint 'j'", "'Revolute'", False),
    "name of the world": (
        robot(links("ab") + joint("universe", "a", "b", "continuous")),
        "joint 'universe'",
        "rename",
        True,
    ),
    "revolute without limit": (one_joint("revolute", ""), "joint 'j'", "continuous", False),
    "prismatic without limit": (one_joint("prismatic", ""), "joint 'j'", "no <limit>", False),
    "limit without effort": (one_joint(inside="<limit velocity='1'/>"), "joint 'j'", "no effort", False),
    "limit without velocity": (one_joint(inside="<limit effort='1'/>"), "joint 'j'", "no velocity", False),
    "bad limit of a fixed joint": (one_joint("fixed", "<limit/>"), "joint 'j'", "no effort", False),
    "limits crossed": (
        one_joint(inside="<limit effort='1' velocity='1' lower='2' upper='1'/>"),
        "joint 'j'",
        "lower is 2.0 and upper 1.0",
        True,
    ),
    "lower above the upper that is not there": (
        one_joint(inside="<limit effort='1' velocity='1' lower='2'/>"),
        "joint 'j'",
        "0 if not given",
        True,
    ),
    "negative velocity": (
        one_joint(inside="<limit effort='1' velocity='-1'/>"),
        "joint 'j'",
        "velocity is -1.0",
        False,
    ),
    "negative effort": (
        one_joint("continuous", "<limit effort='-1' velocity='1'/>"),
        "joint 'j'",
        "effort is -1.0",
        False,
    ),
    "zero axis": (one_joint(inside="<axis xyz='0 0 0'/>" + LIMIT), "joint 'j'", "not zero", True),
    "axis that squares to zero": (
        one_joint(inside="<axis xyz='0 0 1e-300'/>" + LIMIT),
        "joint 'j'",
        "zero",
        True,
    ),
    "axis that squares to infinity": (
        one_joint(inside="<axis xyz='0 0 1e300'/>" + LIMIT),
        "joint 'j'",
        "sq",
        True,
    ),
    "axis of two": (one_joint(inside="<axis xyz='0 1'/>" + LIMIT), "joint 'j'", "three numbers", False),
    "origin of four": (one_joint(inside="<origin xyz='0 0 1 0'/>" + LIMIT), "joint 'j'", "three", False),
    "rpy of words": (one_joint(inside="<origin rpy='0 0 up'/>" + LIMIT), "joint 'j'", "'up'", False),
    "macro for a number": (one_joint(inside="<origin rpy='0 0 ${pi}'/>" + LIMIT), "joint 'j'", "pi}", False),
    "safety": (one_joint(inside=LIMIT + "<safety_controller/>"), "joint 'j'", "no k_velocity", False),
    "calibration": (one_joint(inside=LIMIT + "<calibration rising='x'/>"), "joint 'j'", "rising", False),
    "dynamics": (one_joint(inside=LIMIT + "<dynamics/>"), "joint 'j'", "neither damping nor", False),
    "mimic": (one_joint(inside=LIMIT + "<mimic/>"), "joint 'j'", "names no joint", False),
    "nested too deep": (robot(links("a") + "<g>" * 600 + "</g>" * 600), "<g>", "too deep", False),
    "half a character": (robot(links(["\ud800"])), "character 28", "surrogate", None),
    "text that is not XML": ("name: arm\nlinks: 3\n", "line 1", "allowed: '<'", False),
}


@pytest.mark.parametrize("fault", FAULTS)
def test_a_fault_is_named_with_its_element_and_reason(fault):
    text, element, words, silent = FAULTS[fault]
    with pytest.raises(URDFError) as caught:
        read_description(text)
    assert (caught.value.source, caught.value.element) == ("URDF text", element)
    assert words in caught.value.reason
    if silent is not None:
        assert pinocchio_loads(text) is silent


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


BOMB = "<!DOCTYPE robot [<!ENTITY a 'aaaaaaaaaa'>" + "".join(
    f"<!ENTITY {name} '{f'&{before};' * 10}'>" for before, name in zip("abcdefghi", "bcdefghij", strict=True)
)


@pytest.mark.parametrize(
    "head",
    [
        BOMB + "]>",
        "<?xml version='1.0'?>\n<!-- c --><?p i?>\n" + BOMB + "]>",
        "<!--> <a --> <?> <b?>" + BOMB + "]>",
        "<!DOCTYPE robot SYSTEM 'http://example.invalid/robot.dtd'>",
        "<!DOCTYPE robot [<!ENTITY j SYSTEM 'file:///etc/passwd'>]>",
        "<!DOCTYPE robot>",
    ],
)
def test_a_document_type_is_refused_before_anything_is_expanded(head):
    start = time.perf_counter()
    with pytest.raises(URDFError) as caught:
        read_description(head + f"<robot name='&j;'>{links('a')}&j;</robot>")
    assert caught.value.element in ("<!DOCTYPE>", "line 1")
    assert caught.value.element == "<!DOCTYPE>" or "<?>" in head
    assert time.perf_counter() - start < 0.5


def test_the_word_doctype_in_a_comment_is_only_a_word():
    assert read_description("<!-- <!DOCTYPE x> -->" + robot("<!-- <!DOCTYPE y> -->" + links("a"))).root == "a"


def test_a_file_that_cannot_be_read_is_named_with_the_reason(tmp_path):
    (tmp_path / "empty.urdf").write_text("\ufeff \n")
    (tmp_path / "binary.urdf").write_bytes(b"<robot name='\xff\xfe'/>")
    (tmp_path / "utf16.urdf").write_bytes(robot(links("a")).encode("utf-16"))
    for name, reason in {
        "missing.urdf": "no such file",
        "": "directory",
        "empty.urdf": "empty",
        "binary.urdf": "UTF-8",
        "utf16.urdf": "UTF-8",
        "x" * 5000: "cannot be read",
        "a\0b": "cannot be read",
    }.items():
        path = tmp_path / name
        with pytest.raises(FileError, match=reason) as caught:
            read_description(path)
        assert caught.value.path == path
    for source in ("", " ", "no-such-robot.urdf"):
        with pytest.raises(FileError):
            read_description(source)
    for source in (None, 3, b"<robot/>"):
        with pytest.raises(InvalidValue):
            read_description(source)


def test_a_fault_in_a_file_names_the_file(tmp_path):
    path = tmp_path / "robot.urdf"
    path.write_text(robot(""))
    with pytest.raises(URDFError) as caught:
        read_description(path)
    assert caught.value.source == str(path)


# Moving joints j1, j2, j3:  a -j1- b -f1- c -j2- d -f2- e -f3- f,  d -f4- g,  a -j3- h
TREE = robot(
    links("abcdefgh")
    + joint("j1", "a", "b", "revolute", LIMIT)
    + joint("f1", "b", "c")
    + joint("j2", "c", "d", "prismatic", LIMIT)
    + joint("f2", "d", "e")
    + joint("f3", "e", "f")
    + joint("f4", "d", "g")
    + joint("j3", "a", "h", "continuous")
)


def test_a_chain_lists_its_joints_from_base_to_tip():
    read = read_description(TREE)
    assert [joint.name for joint in read.chain("a", "f")] == ["j1", "f1", "j2", "f2", "f3"]
    assert [joint.name for joint in read.chain("c", "g")] == ["j2", "f4"]
    assert read.chain("h", "h") == ()


def test_a_chain_between_links_that_are_not_above_each_other_is_refused():
    read = read_description(TREE)
    for base, tip, above in (
        ("e", "g", "'d', 'c', 'b', 'a'"),
        ("g", "d", "'c', 'b', 'a'"),
        ("b", "a", "none"),
    ):
        with pytest.raises(URDFError) as caught:
            read.chain(base, tip)
        assert caught.value.element == f"link {tip!r}"
        assert repr(base) in caught.value.reason and above in caught.value.reason
    for base, tip in (("a", "z"), ("z", "a")):
        with pytest.raises(UnknownName, match="no link is called 'z'"):
            read.chain(base, tip)


def test_of_tips_that_the_same_joints_move_the_deepest_is_taken_then_the_first():
    assert read_description(TREE).longest_chain() == ("a", "f")
    assert read_description(TREE.replace(joint("f3", "e", "f"), joint("f3", "a", "f"))).longest_chain() == (
        "a",
        "e",
    )
    assert read_description(robot(links("a"))).longest_chain() == ("a", "a")


def test_when_different_joints_lead_to_several_tips_the_choice_is_left_to_the_user():
    last = joint("j4", "h", "i", "revolute", LIMIT)
    text = TREE.replace(links("h"), links("hi")).replace("</robot>", last + "</robot>")
    with pytest.raises(URDFError, match="pass tip= to choose") as caught:
        read_description(text).longest_chain()
    assert caught.value.element == "links 'f', 'g', 'i'"
    stuck = text.replace(last, last.replace('lower="-1"', 'lower="3"'))
    assert read_description(stuck).longest_chain() == ("a", "f")


@given(st.lists(st.tuples(st.integers(0, 7), st.integers(0, 7)), max_size=9), st.integers(1, 8))
@settings(max_examples=300)
def test_any_graph_is_a_tree_or_refused_for_what_it_is(edges, size):
    """Against a search by brute force: the root reaches every link by exactly one way."""
    edges = [(parent % size, child % size) for parent, child in edges]
    text = robot(links(range(size)) + "".join(joint(f"j{i}", *edge) for i, edge in enumerate(edges)))

    def ways(start, goal, left):
        reached = int(start == goal)
        return reached + sum(ways(c, goal, left - 1) for p, c in edges if p == start and left > 0)

    roots = [link for link in range(size) if all(child != link for _, child in edges)]
    tree = len(roots) == 1 and all(ways(roots[0], link, 9) == 1 for link in range(size))
    try:
        read = read_description(text)
    except URDFError as error:
        assert not tree
        doubled = any(sum(child == link for _, child in edges) > 1 for link in range(size))
        if "closes a circle" in error.reason:
            assert not doubled and len(roots) < 2
        elif "has" not in error.reason and "of joint" not in error.reason:
            assert len(roots) > 1 and not doubled
    else:
        assert tree and read.root == str(roots[0])
        assert pinocchio_loads(read.text)
        for tip in map(str, range(size)):
            path = read.chain(read.root, tip)
            assert [j.parent for j in path] + [tip] == [read.root] + [j.child for j in path]


def test_very_long_chains_and_circles_take_no_time():
    names = [f"l{i}" for i in range(5000)]
    joints = [joint(f"j{i}", names[i], names[i + 1], "continuous") for i in range(4999)]
    start = time.perf_counter()
    assert read_description(robot(links(names) + "".join(joints))).longest_chain() == ("l0", "l4999")
    with pytest.raises(URDFError, match=r"closes a circle.*\.\.\."):
        read_description(robot(links(names) + "".join(joints) + joint("back", names[-1], names[0])))
    assert time.perf_counter() - start < 2.0


def test_long_digit_strings_and_unclosed_quotes_take_no_time():
    start = time.perf_counter()
    for text in (
        one_joint(inside=LIMIT + f"<origin xyz='0 0 {'1' * 200_000}x'/>"),
        "<!--" * 100_000,
        "<?" * 100_000,
        robot(links("a")) + "xyz = '" * 100_000,
    ):
        with pytest.raises(URDFError):
            read_description(text)
    assert time.perf_counter() - start < 2.0


PIECES = [
    "<",
    ">",
    '"',
    "/>",
    "nan",
    "-",
    "0",
    " ",
    "&",
    "\t",
    "é",
    "fixed",
    "<link/>",
    "</joint>",
    'name=""',
    "l1",
    "m01",
]


@pytest.mark.parametrize("seed", range(5))
def test_whatever_is_done_to_a_text_it_loads_in_pinocchio_or_is_refused_by_us(seed, capfd):
    """Nothing that we accept is refused by Pinocchio, and nothing raises what is not ours."""
    rng, accepted = random.Random(seed), 0
    whole = modules_to_urdf([template("RyRz"), template("Rz")], "arm")
    for _ in range(300):
        text = whole
        for _ in range(rng.randint(1, 3)):
            at, length = rng.randrange(len(text)), rng.choice([0, 1, 1, 5, 40])
            text = text[:at] + rng.choice(["", *PIECES]) + text[at + length :]
        try:
            read = read_description(text) if text.startswith("<") else None
        except PostureError as error:
            assert str(error)
            continue
        if isinstance(read, Description):
            accepted += 1
            assert pinocchio_loads(read.text), text
    assert 10 < accepted < 290
    capfd.readouterr()
