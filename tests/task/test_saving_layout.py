"""Comments and layout of a task file survive saving; what is new looks as a person would write it."""

from __future__ import annotations

import random
import sys
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st
from sampling import examples
from task.same_tasks import assert_same
from task_texts import VALID

import pinposture as pp
from pinposture.toml import TomlLayout, Usual, lines_of_toml, toml_text

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
TABLE = st.dictionaries(TEXT, VALUE, max_size=4)
CONTENT = st.dictionaries(TEXT, VALUE | TABLE | st.lists(TABLE, max_size=3), max_size=6)


def same(one: Any, other: Any) -> bool:
    """Equal whatever the order of keys, with every float to the last bit."""
    if isinstance(one, dict):
        return one.keys() == other.keys() and all(same(one[key], other[key]) for key in one)
    if isinstance(one, list):
        return len(one) == len(other) and all(map(same, one, other))
    if isinstance(one, float):
        return float(other).hex() == one.hex()
    return type(one) is type(other) and one == other


@st.composite
def changes(draw: Any) -> tuple[dict[str, Any], dict[str, Any]]:
    """Content, and other content that has much in common with it."""

    def mixed(one: Any, other: Any) -> Any:
        if isinstance(one, dict) and isinstance(other, dict):
            both: dict[str, Any] = {}
            for key in [*one, *(key for key in other if key not in one)]:
                kind = draw(st.integers(0, 3))
                if key in one and kind < 2:
                    both[key] = one[key]
                elif key in other:
                    both[key] = mixed(one[key], other[key]) if key in one else other[key]
                elif kind == 2:
                    both[key] = mixed(one[key], draw(VALUE))
            return both
        if isinstance(one, list) and isinstance(other, list) and one + other:
            shuffled = draw(st.permutations(one + other))
            return shuffled[: draw(st.integers(0, len(shuffled)))]
        return other

    before = draw(CONTENT)
    return before, mixed(before, draw(CONTENT))


@given(CONTENT)
def test_toml_reads_back(content: dict[str, Any]) -> None:
    text = toml_text(content)
    assert same(content, tomllib.loads(text))
    text.encode()


@pytest.mark.long
@given(changes())
@examples(200)
def test_a_file_that_is_changed_says_what_is_new_and_loses_no_comment_of_what_stays(
    pair: tuple[dict[str, Any], dict[str, Any]],
) -> None:
    before, after = pair
    draw = random.Random(0)
    lines = []
    for line in toml_text(before).split("\n"):
        if line.startswith("[") and draw.random() < 0.5:  # a header, or an item of a list
            lines.append("# a comment")
        lines.append(line)
    text = "\n".join(lines)
    assert same(tomllib.loads(text), before)
    assert toml_text(before, TomlLayout(text, lambda: before)) == text
    assert same(tomllib.loads(toml_text(after, TomlLayout(text, lambda: before))), after)


@given(CONTENT)
def test_every_key_is_found_on_its_line(content: dict[str, Any]) -> None:
    text = toml_text(content)
    lines = text.split("\n")
    found = lines_of_toml(text)
    assert all((key,) in found for key in content)
    for place, line in found.items():
        if isinstance(place[-1], str) and place[-1].isalnum() and place[-1].isascii():
            assert place[-1] in lines[line - 1]


@pytest.mark.parametrize("value", [None, 1j, {1}])
def test_what_has_no_notation_is_refused(value: Any) -> None:
    with pytest.raises(ValueError, match="Unable to convert"):
        toml_text({"a": [value]})


SHOWN = """\
version = 1
name = 'say "bow"'

[arm]
template = "RyRz"
placement = {position = [0, 0, 0.5]}

[scene]
margin = 0.005

[scene.obstacles.ball]
center = [0.5, 0.25, 0]

[scene.obstacles."the floor"]
normal = [0, 0, 1]

[[keyframes]]
curve = {type = "line", a = [0, 0, 0], b = [0.3, 0, 0]}

[[keyframes]]
time = 1
curve = {type = "bspline", degree = 1, knots = [
    0, 0, 0.0625, 0.125, 0.1875, 0.25, 0.3125, 0.375, 0.4375, 0.5, 0.5625, 0.625, 0.6875, 0.75, 0.8125, 0.875,
    0.9375, 1, 1,
], coefficients = [
    [0.0, 0.1, 0],
    [0.0625, 0.1, 0],
    [0.125, 0.1, 0],
    [0.1875, 0.1, 0],
]}
trim = true
"""


def test_toml_looks_as_a_person_would_write_it() -> None:
    shown = SHOWN.replace("'say \"bow\"'", '"say \\"bow\\""')
    assert toml_text(tomllib.loads(shown)) == shown


COMMENTED = """\
# Coils an arm of six modules.

version = 1          # of the format
kind = "keyframes"

# -- the robot --

[arm]   # as built in May
template = "RyRz"
modules = 6
link_lengths = ["25 mm",   # up
                0.025]     # sideways

[limits]
cycle = "20 ms"
velocity = "90 deg/s"   # half of what the motors can do
# acceleration = 10

[scene]
obstacles.ball = { type = "sphere", center = [0, 0, "-50 cm"], radius = "10 cm" }  # hangs below

# It begins straight,
[[keyframes]]
name = "straight"
curve = {type="line", a=[0,0,0], b=["30 cm",0,0]}
trim = false         # said, though it is so anyway
# and coils up.
[[keyframes]]
name = "bowed"
time = "1 s"
curve = { type = "helix", radius = "10 cm", pitch = 0, turns = 0.6 }
trim = true

# Kept for the record.
[output]
formats = [ "csv", "npz" ]   # no pictures
"""


@pytest.fixture
def commented(tmp_path: Path) -> pp.Task:
    path = tmp_path / "task.toml"
    path.write_text(COMMENTED)
    return pp.Task.load(path)


def changed(task: pp.Task, path: Path, *lines: tuple[str, str]) -> None:
    """The file of a task that was edited is the commented one, but for these lines."""
    expected = COMMENTED
    for old, new in lines:
        assert expected.count(old) == 1, old
        expected = expected.replace(old, new)
    assert task.save(path).read_text() == expected
    assert_same(pp.Task.load(path), task)


def test_a_task_that_is_saved_as_it_is_keeps_every_character(commented: pp.Task, tmp_path: Path) -> None:
    changed(commented, tmp_path / "task.toml")
    changed(commented, tmp_path / "other" / "task.toml")
    changed(commented.edited(name="bow").edited(name="task"), tmp_path / "task.toml")


def test_an_edit_changes_its_own_line(commented: pp.Task, tmp_path: Path) -> None:
    path = tmp_path / "task.toml"
    faster = replace(commented.limits, velocity=2.0, acceleration=10.0)
    new = "velocity = 2   # half of what the motors can do\nacceleration = 10\n"
    changed(
        commented.edited(limits=faster),
        path,
        ('velocity = "90 deg/s"   # half of what the motors can do\n', new),
    )
    first, second = commented.motion
    changed(
        commented.edited(motion=(first, replace(second, time=2.5, hold=1.0))),
        path,
        ('time = "1 s"\n', "time = 2.5\n"),
        ("trim = true\n", "trim = true\nhold = 1\n"),
    )
    line = pp.Curve.line((0, 0, 0), (0.3, 0.1, 0))
    changed(
        commented.edited(motion=(replace(first, curve=line), second)),
        path,
        ('b=["30 cm",0,0]', 'b=["30 cm",0.1,0]'),
    )
    ball = commented.scene.obstacles["ball"]
    lower = replace(commented.scene, obstacles={"ball": replace(ball, center=(0.0, 0.0, -0.6))})
    changed(commented.edited(scene=lower), path, ('"-50 cm"', "-0.6"))
    changed(commented.edited(formats=("npz",)), path, ('[ "csv", "npz" ]   #', '["npz"]   #'))
    changed(
        commented.edited(name="coil"), path, ('kind = "keyframes"\n', 'kind = "keyframes"\nname = "coil"\n')
    )


def test_comments_go_where_their_keyframe_goes(commented: pp.Task, tmp_path: Path) -> None:
    path = tmp_path / "task.toml"
    first, second = commented.motion
    begin = COMMENTED.index("# It begins")
    end = COMMENTED.index("# Kept")
    middle = COMMENTED.index("# and coils up.")
    one = COMMENTED[begin:middle]
    two = COMMENTED[middle:end]
    last = replace(second, time=None, duration=1.0)
    changed(
        commented.edited(motion=(last, first)),
        path,
        (one + two, two.replace('time = "1 s"\n', "").replace("true\n", "true\nduration = 1\n") + one + "\n"),
    )
    between = pp.Keyframe(first.curve, time=0.5, placement="as_is")
    new = '[[keyframes]]\ntime = 0.5\ncurve = {type = "line", a = [0, 0, 0], b = [0.3, 0, 0]}\n'
    changed(commented.edited(motion=(first, between, second)), path, (one + two, f"{one}\n{new}\n{two}"))
    changed(
        commented.edited(motion=(first, replace(between, time=1.0))),
        path,
        (one + two, f"{one}\n{new.replace('0.5', '1')}\n"),
    )
    renamed = replace(second, name="coiled", hold=1.0)
    changed(
        commented.edited(motion=(first, renamed)),
        path,
        ('name = "bowed"', 'name = "coiled"'),
        ("trim = true\n", "trim = true\nhold = 1\n"),
    )


def test_new_parts_stand_where_they_belong(commented: pp.Task, tmp_path: Path) -> None:
    path = tmp_path / "task.toml"
    anchor = "# acceleration = 10\n\n"
    start = '[start]\nposture = "straight"\n\n'
    task = commented.edited(start=commented.arm.straight())
    changed(task, path, (anchor, anchor + start))
    changed(pp.Task.load(path).edited(start=None), path)  # and go without a trace
    wall = replace(commented.scene, obstacles={**commented.scene.obstacles, "far": pp.Sphere((9, 0, 0), 1)})
    changed(
        commented.edited(scene=wall),
        path,
        (
            "# hangs below\n",
            '# hangs below\nobstacles.far = {type = "sphere", center = [9, 0, 0], radius = 1}\n',
        ),
    )


def test_a_placement_that_is_said_follows_its_keyframe_and_not_what_is_usual(tmp_path: Path) -> None:
    path = tmp_path / "task.toml"
    path.write_text(VALID)
    task = pp.Task.load(path)  # where there are obstacles, curves stay where they are drawn
    first, second = task.motion
    for scene in (task.scene, None):
        for placement in ("align", "as_is"):
            edited = task.edited(scene=scene, motion=(first, replace(second, placement=placement)))
            assert_same(pp.Task.load(edited.save(path)), edited)
            assert path.read_text().startswith("# An arm of six modules")


def test_line_ends_and_json(commented: pp.Task, tmp_path: Path) -> None:
    windows = tmp_path / "windows.toml"
    windows.write_bytes(COMMENTED.replace("\n", "\r\n").encode())
    task = pp.Task.load(windows)
    task.edited(continuity="acceleration").save(windows)
    lines = windows.read_bytes().split(b"\r\n")
    assert b'continuity = "acceleration"' in lines
    assert len(lines) == COMMENTED.count("\n") + 2
    assert not any(b"\n" in line for line in lines)
    path = commented.save(tmp_path / "task.json")
    assert_same(pp.Task.load(path), commented)


@pytest.mark.parametrize("above", ["# A coil.\n", "# A coil.\n\n", "", "\n# A\n\n# coil.\n"])
def test_what_stands_above_all_else_stays_there(above: str) -> None:
    text = f"{above}[arm]  # long\nmodules = 6\n"
    says = {"arm": {"modules": 6}}
    assert toml_text(says, TomlLayout(text, lambda: says)) == text
    expected = f"{above}name = 3\n\n[arm]  # long\nmodules = 6\n"
    assert toml_text({"name": 3, **says}, TomlLayout(text, lambda: says)) == expected


def test_what_need_not_be_said_is_said_only_where_it_stands_and_differs() -> None:
    text = "b = 1 # here\n"
    assert toml_text({"a": Usual(3), "b": Usual(1)}, TomlLayout(text, lambda: {"b": Usual(1)})) == text
    assert toml_text({"b": 1}, TomlLayout("", lambda: {"b": Usual(1)})) == "b = 1\n"
    assert toml_text({"b": Usual(2)}, TomlLayout(text, lambda: {"b": Usual(1)})) == ""
