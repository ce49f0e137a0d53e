"""No text makes the reader hang, crash, fetch a file, or pass on what Pinocchio refuses."""

from __future__ import annotations

import random
import time

import pytest
from arm.describing import LIMIT, links, one_joint, pinocchio_loads, robot
from sampling import seeds

from pinposture.arm.template import modules_to_urdf, template
from pinposture.arm.urdf_reader import Description, read_description
from pinposture.errors import PostureError, URDFError

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
