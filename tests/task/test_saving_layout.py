"""Plain data as TOML and JSON: what is written reads back, and looks as a person would write it."""

from __future__ import annotations

import json
import math
import sys
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

from pinposture.task.document import lines_of_toml
from pinposture.task.text import json_text, scalar, toml_text

if sys.version_info >= (3, 11):
    import tomllib
else:
    import tomli as tomllib

TEXT = st.text(st.characters(exclude_categories=["Cs"]), max_size=8) | st.sampled_from(
    [
        '"',
        "\\",
        "a\nb",
        "\r\n",
        "\t",
        "\x7f",
        "\x00",
        "\x1b",
        '"""',
        "'",
        "#",
        "größe",
        "腕",
        "𝔸",
        "\u2028",
        "=",
    ]
)
NUMBER = st.integers(-(2**63), 2**63 - 1) | st.floats(allow_nan=False, allow_infinity=False)
SCALAR = st.booleans() | NUMBER | TEXT
POINTS = st.lists(st.lists(st.floats(-1, 1), min_size=3, max_size=3), max_size=12)
VALUE = st.recursive(
    SCALAR | POINTS | st.lists(st.floats(-9, 9), max_size=40),
    lambda inner: st.lists(inner, max_size=4) | st.dictionaries(TEXT, inner, max_size=4),
    max_leaves=12,
)
CONTENT = st.dictionaries(TEXT, VALUE | st.dictionaries(TEXT, VALUE, max_size=4), max_size=6)


def same(one: Any, other: Any) -> bool:
    """Equal, with every float to the last bit; a whole number may have become an integer."""
    if isinstance(one, dict):
        return list(one) == list(other) and all(same(one[key], other[key]) for key in one)
    if isinstance(one, list):
        return len(one) == len(other) and all(map(same, one, other))
    if isinstance(one, float):
        return float(other).hex() == one.hex()
    return type(one) is type(other) and one == other


def sorted_tables(value: dict[str, Any]) -> dict[str, Any]:
    """The order in which TOML has room for things does not matter."""
    return {
        key: sorted_tables(value[key]) if isinstance(value[key], dict) else value[key]
        for key in sorted(value)
    }


@given(CONTENT)
def test_toml_reads_back(content: dict[str, Any]) -> None:
    text = toml_text(content)
    found = tomllib.loads(text)
    assert same(sorted_tables(content), sorted_tables(found))
    text.encode()


@given(CONTENT)
def test_json_reads_back_in_order(content: dict[str, Any]) -> None:
    assert same(content, json.loads(json_text(content)))


@given(CONTENT)
def test_every_key_is_found_on_its_line(content: dict[str, Any]) -> None:
    text = toml_text(content)
    lines, found = text.split("\n"), lines_of_toml(text)
    assert all((key,) in found for key in content)
    for place, line in found.items():
        if isinstance(place[-1], str):
            written = scalar(place[-1])
            assert place[-1] in lines[line - 1] or written in lines[line - 1]


@pytest.mark.parametrize(
    ("number", "text"),
    [
        (0.1, "0.1"),
        (1.0, "1"),
        (-0.0, "-0.0"),
        (0.0, "0"),
        (-3.0, "-3"),
        (1e15, "1000000000000000.0"),
        (123456789012345.0, "123456789012345"),
        (1e22, "1e+22"),
        (2.5e-5, "2.5e-05"),
        (math.pi / 2, "1.5707963267948966"),
        (5e-324, "5e-324"),
        (True, "true"),
        (12, "12"),
    ],
)
def test_numbers_are_short_and_exact(number: float, text: str) -> None:
    assert scalar(number) == text
    for read in (json.loads(text), tomllib.loads(f"x = {text}")["x"]):
        assert read == number
        assert math.copysign(1.0, read) == math.copysign(1.0, number)


@pytest.mark.parametrize("value", [math.inf, math.nan, None, 1j, {1}])
def test_what_has_no_notation_is_refused(value: Any) -> None:
    for write in (toml_text, json_text):
        with pytest.raises(ValueError, match="has no notation"):
            write({"a": [value]})


CONTENT_SHOWN = {
    "version": 1,
    "name": 'say "bow"',
    "arm": {"template": "RyRz", "modules": 6, "placement": {"position": [0.0, 0.0, 0.5]}},
    "scene": {
        "margin": 0.005,
        "obstacles": {
            "ball": {"type": "sphere", "center": [0.5, 0.25, 0.0], "radius": 0.1},
            "the floor": {"type": "half_space", "point": [0.0, 0.0, -0.4], "normal": [0.0, 0.0, 1.0]},
        },
    },
    "keyframes": [
        {"curve": {"type": "line", "a": [0.0, 0.0, 0.0], "b": [0.3, 0.0, 0.0]}},
        {
            "time": 1.0,
            "curve": {
                "type": "bspline",
                "degree": 1,
                "knots": [0.0, 0.0, *[k / 16 for k in range(1, 16)], 1.0, 1.0],
                "coefficients": [[0.0625 * k, 0.1, 0.0] for k in range(4)],
            },
            "trim": True,
        },
    ],
}

SHOWN = """\
version = 1
name = "say \\"bow\\""

[arm]
template = "RyRz"
modules = 6
placement = { position = [0, 0, 0.5] }

[scene]
margin = 0.005

[scene.obstacles.ball]
type = "sphere"
center = [0.5, 0.25, 0]
radius = 0.1

[scene.obstacles."the floor"]
type = "half_space"
point = [0, 0, -0.4]
normal = [0, 0, 1]

[[keyframes]]
curve = { type = "line", a = [0, 0, 0], b = [0.3, 0, 0] }

[[keyframes]]
time = 1
curve = { type = "bspline", degree = 1, knots = [
    0, 0, 0.0625, 0.125, 0.1875, 0.25, 0.3125, 0.375, 0.4375, 0.5, 0.5625, 0.625, 0.6875, 0.75, 0.8125, 0.875,
    0.9375, 1, 1,
], coefficients = [
    [0, 0.1, 0],
    [0.0625, 0.1, 0],
    [0.125, 0.1, 0],
    [0.1875, 0.1, 0],
] }
trim = true
"""


def test_toml_looks_as_a_person_would_write_it() -> None:
    assert toml_text(CONTENT_SHOWN) == SHOWN


def test_json_breaks_only_lines_that_are_too_long() -> None:
    text = json_text(CONTENT_SHOWN)
    assert '    {"curve": {"type": "line", "a": [0, 0, 0], "b": [0.3, 0, 0]}},\n' in text
    assert '      "ball": {"type": "sphere", "center": [0.5, 0.25, 0], "radius": 0.1},\n' in text
    assert '\n  "version": 1,\n' in text
    assert max(map(len, text.split("\n"))) <= 110
