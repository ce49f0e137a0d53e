"""No text makes the reader hang, crash, fetch a file, or pass on what Pinocchio refuses."""

from __future__ import annotations

import random
import time

import pytest
from arm.describing import LIMIT, fixed, limit, links, moving, one_joint, pinocchio_loads, robot
from sampling import seeds

import pinposture as pp
from pinposture.arm.description import Description, read_description
from pinposture.arm.template import modules_to_urdf, template
from pinposture.errors import FileError, InvalidValue, PostureError, URDFError

BOMB = "<!DOCTYPE robot [<!ENTITY a 'aaaaaaaaaa'>" + "".join(
    f"<!ENTITY {name} '{f'&{before};' * 10}'>" for before, name in zip("abcdefghi", "bcdefghij", strict=True)
)


@pytest.mark.parametrize(
    "head",
    [
        BOMB + "]>",
        "<?xml version='1.0'?>\n<!-- c --><?p i?>\n" + BOMB + "]>",
        "<!--> <a -->" + BOMB + "]>",
        "<!DOCTYPE robot SYSTEM 'http://example.invalid/robot.dtd'>",
        "<!DOCTYPE robot [<!ENTITY j SYSTEM 'file:///etc/passwd'>]>",
        "<!DOCTYPE robot>",
    ],
)
def test_a_document_type_is_refused_before_anything_is_expanded(head):
    start = time.perf_counter()
    with pytest.raises(URDFError) as caught:
        read_description(head + f"<robot name='&j;'>{links('a')}&j;</robot>")
    assert caught.value.element == "<!DOCTYPE>"
    assert time.perf_counter() - start < 0.5


def test_the_word_doctype_in_a_comment_is_only_a_word():
    assert read_description("<!-- <!DOCTYPE x> -->" + robot("<!-- <!DOCTYPE y> -->" + links("a"))).root == "a"


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


@pytest.mark.parametrize("seed", seeds(5))
def test_whatever_is_done_to_a_text_it_loads_in_pinocchio_or_is_refused_by_us(seed, capfd):
    """Nothing that we accept is refused by Pinocchio, and nothing raises what is not ours."""
    rng = random.Random(seed)
    accepted = 0
    whole = modules_to_urdf([template("RyRz"), template("Rz")], "arm")
    for _ in range(300):
        text = whole
        for _ in range(rng.randint(1, 3)):
            at = rng.randrange(len(text))
            length = rng.choice([0, 1, 1, 5, 40])
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


def long_chain(joints: int, turning: int) -> str:
    """A chain of joints, 1 cm apart, of which the first ones turn and the others are fixed."""
    body = links([f"l{k}" for k in range(joints + 1)])
    for k in range(joints):
        ends = f"j{k}", f"l{k}", f"l{k + 1}"
        axis = "0 1 0" if k % 2 else "0 0 1"
        turns = moving(*ends, axis=axis, xyz="0.01 0 0", limits=limit(-1, 1))
        body += turns if k < turning else fixed(*ends, xyz="0.01 0 0")
    return robot(body)


@pytest.mark.long
@pytest.mark.parametrize(
    ("joints", "turning", "message"),
    [(6_000, 6_000, "6000 moving joints; allowed: 5000 at most"), (11_000, 1, "11001 links; allowed: 10001")],
)
def test_chains_too_long_for_pinocchio_are_refused(joints: int, turning: int, message: str) -> None:
    with pytest.raises(URDFError, match=message):
        pp.Arm.load(long_chain(joints, turning))


@pytest.mark.process
@pytest.mark.parametrize(("joints", "turning"), [(10, 10), (300, 300), (4_000, 4_000), (6_000, 2)])
def test_long_chains_are_loaded_although_pinocchio_follows_them_by_recursion(
    joints: int, turning: int
) -> None:
    arm = pp.Arm.load(long_chain(joints, turning), split=min(turning, 2))
    assert arm.nv == turning
    assert arm.length == pytest.approx(0.01 * (joints - 1))


def test_more_modules_than_pinocchio_can_hold_are_refused() -> None:
    for count in (5_001, 10**9, 10**400):
        with pytest.raises(InvalidValue, match="allowed: a whole number of 1 to 5000"):
            pp.Arm.from_template("RyRz", modules=count)
    with pytest.raises(InvalidValue, match="joints of all modules is 6000; allowed: at most 5000"):
        pp.Arm.from_template("RyRz", modules=3_000)


def many_tips(count: int) -> str:
    names = [f"l{k}" for k in range(count)]
    joints = (moving(f"j_{name}", "hand", name, xyz="0.1 0 0") for name in names)
    return robot(links(["hand", *names]) + "".join(joints))


@pytest.mark.parametrize(
    "text",
    [
        robot(links(["l" * 100_000])),
        robot(links(["a", "b"]) + fixed("j" * 100_000, "a", "nowhere")),
        f"<{'r' * 100_000}/>",
        many_tips(2_000),
    ],
    ids=["name of a link", "name of a joint", "name of the root", "many tips"],
)
def test_messages_stay_readable_whatever_the_names(text: str) -> None:
    with pytest.raises(URDFError) as caught:
        pp.Arm.load(text)
    assert 40 < len(str(caught.value)) < 4_100


def chained_properties(count: int) -> str:
    each = "<xacro:property name='p{}' value='${{p{}}}'/>"
    return "".join(each.format(k, k + 1) for k in range(count)) + "<link name='${p0}'/>"


CIRCLE = "<xacro:property name='a' value='${b}'/><xacro:property name='b' value='${a}'/><link name='${a}'/>"


@pytest.mark.parametrize(
    "content",
    [
        "<xacro:if value='1'>" * 5_000 + "</xacro:if>" * 5_000,
        "<xacro:macro name='m'><xacro:m/></xacro:macro><xacro:m/>",
        CIRCLE,
        f"<link name='${{{'(' * 5_000}1{')' * 5_000}}}'/>",
        chained_properties(5_000),
    ],
    ids=["nested", "a macro of itself", "a circle", "parentheses", "a chain of properties"],
)
def test_macros_that_lead_too_deep_are_refused(content: str) -> None:
    head = "<robot name='r' xmlns:xacro='http://www.ros.org/wiki/xacro'>"
    with pytest.raises((URDFError, FileError)):
        pp.Arm.load(f"{head}{content}</robot>")


def test_macros_that_multiply_are_refused(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("pinposture.arm.macros.MOST_ELEMENTS", 300)  # for the sake of time
    macros = "<xacro:macro name='m0'><link name='a'/></xacro:macro>"
    for k in range(8):
        macros += f"<xacro:macro name='m{k + 1}'>{f'<xacro:m{k}/>' * 10}</xacro:macro>"
    head = "<robot name='r' xmlns:xacro='http://www.ros.org/wiki/xacro'>"
    with pytest.raises(URDFError, match="expands to more than 300 elements"):
        pp.Arm.load(f"{head}{macros}<xacro:m8/></robot>")
