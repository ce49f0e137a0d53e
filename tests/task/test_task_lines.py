"""On which lines of a TOML file things are."""

from __future__ import annotations

import json
import sys
from typing import Any

from hypothesis import given
from hypothesis import strategies as st
from sampling import examples

from pinposture.toml import lines_of_toml

if sys.version_info >= (3, 11):
    import tomllib
else:
    import tomli as tomllib

HARD = '''# [fake] key = 1
version = 1  # version = 2
"quoted key" . 'and, more' = 3
"a.b=c#" = "x = [1] # no comment"
arm.template = "RyRz"   # dotted: [arm] begins here
arm . modules = 6
text = """
[limits]
velocity = 3
\\""" still inside """
other = \'\'\'
[limits]\'\'\'
numbers = [
  1,  # one = 1
  [2, 3],
  [
    4, 5 ]

]
[limits] # velocity = 1
velocity = { turning = 1, sliding = { a = "}", b = 2 } }

[[keyframes]]
curve = "line"
[keyframes.tip]
position = [0, 0, 0]
  [[keyframes]]  # the second
\tcurve = { type = "spline", control_points = [[0, 0, 0],
    [1, 0, 0],
  [1, 1, 0]], degree = 1 }
[scene.obstacles."a.b"]
radius=1
[ scene . obstacles . x ]
radius = 1
[[keyframes]]
[[keyframes.parts]]
[[keyframes.parts]]
x = 1
[keyframes.tip]
priority = true
'''
LINES: dict[tuple[str | int, ...], int] = {
    ("version",): 2,
    ("quoted key", "and, more"): 3,
    ("a.b=c#",): 4,
    ("arm",): 5,
    ("arm", "template"): 5,
    ("arm", "modules"): 6,
    ("text",): 7,
    ("other",): 11,
    ("numbers",): 13,
    ("numbers", 0): 14,
    ("numbers", 1, 1): 15,
    ("numbers", 2): 16,
    ("numbers", 2, 0): 17,
    ("limits",): 20,
    ("limits", "velocity", "sliding", "b"): 21,
    ("keyframes",): 23,
    ("keyframes", 0): 23,
    ("keyframes", 0, "curve"): 24,
    ("keyframes", 0, "tip"): 25,
    ("keyframes", 0, "tip", "position", 2): 26,
    ("keyframes", 1): 27,
    ("keyframes", 1, "curve", "type"): 28,
    ("keyframes", 1, "curve", "control_points", 1): 29,
    ("keyframes", 1, "curve", "control_points", 2, 0): 30,
    ("keyframes", 1, "curve", "degree"): 30,
    ("scene", "obstacles"): 31,
    ("scene", "obstacles", "a.b", "radius"): 32,
    ("scene", "obstacles", "x"): 33,
    ("keyframes", 2): 35,
    ("keyframes", 2, "parts"): 36,
    ("keyframes", 2, "parts", 1): 37,
    ("keyframes", 2, "parts", 1, "x"): 38,
    ("keyframes", 2, "tip", "priority"): 40,
}


def ways(value: Any, place: tuple[Any, ...] = ()) -> list[tuple[Any, ...]]:
    items = value.items() if isinstance(value, dict) else enumerate(value) if isinstance(value, list) else ()
    return [way for key, each in items for way in [(*place, key), *ways(each, (*place, key))]]


def test_lines_counted_by_hand() -> None:
    found = lines_of_toml(HARD)
    assert {place: found.get(place) for place in LINES} == LINES
    assert set(found) == set(ways(tomllib.loads(HARD)))  # everything that the file holds, and nothing else


VALUES = st.recursive(
    st.one_of(
        st.integers(-9, 9), st.booleans(), st.text(max_size=6), st.sampled_from(["[a]", "x = 1", '"""'])
    ),
    lambda inner: st.lists(inner, max_size=3),
    max_leaves=5,
)


@examples(40)
@given(
    tables=st.lists(
        st.tuples(st.booleans(), st.lists(st.tuples(st.text(max_size=3), VALUES), max_size=3)), max_size=5
    ),
    blank=st.lists(st.sampled_from(["", "  # [x]", "\t# a = 1"]), max_size=3),
)
def test_lines_of_files_written_line_by_line(tables: list[Any], blank: list[str]) -> None:
    def quoted(text: str) -> str:
        return json.dumps(text, ensure_ascii=False).replace("\x7f", "\\u007f")

    lines = ["# x"]
    wanted = {}
    count = 0
    for number, (listed, entries) in enumerate(tables):
        place: tuple[str | int, ...] = ("list", count) if listed else (f"t{number}",)
        count += listed
        lines.append("[[list]]" if listed else f"[t{number}]")
        wanted[place] = len(lines)
        for key, value in dict(entries).items():
            lines += blank
            begun = json.dumps(value, ensure_ascii=False, indent=1).replace("\x7f", "\\u007f")
            lines.append(f"{quoted(key)} = {begun}")
            wanted[(*place, key)] = len("\n".join(lines).split("\n")) - begun.count("\n")
            lines = "\n".join(lines).split("\n")
    text = "\n".join(lines)
    found = lines_of_toml(text)
    assert {place: found[place] for place in wanted} == wanted
    assert set(found) == set(ways(tomllib.loads(text)))
