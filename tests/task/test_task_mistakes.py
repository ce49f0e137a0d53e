"""Every mistake in a task file is told in one line: the file, the line, the key, what is there and what is
allowed."""

from __future__ import annotations

import copy
import json
import re
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import HealthCheck, given
from hypothesis import strategies as st
from mistakes import IN_A_LEADER, IN_A_TASK, LEADER_SEARCHED, SEARCHED
from sampling import examples
from task_texts import LEADER, VALID, Mistake, mistakes

import pinposture as pp
from pinposture.errors import FileError, PostureError
from pinposture.task.follow_leader import Leader

if sys.version_info >= (3, 11):
    import tomllib
else:
    import tomli as tomllib

SEEN = {**mistakes(VALID, IN_A_TASK), **mistakes(LEADER, IN_A_LEADER)}
FOUND = {**mistakes(VALID, SEARCHED), **mistakes(LEADER, LEADER_SEARCHED)}


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with files to name in a task."""
    path = tmp_path_factory.mktemp("tasks")
    (path / "arm.urdf").write_text(pp.Arm.from_template("RyRz", modules=6).urdf)
    (path / "broken.urdf").write_text("<robot name='r'>\n<link>\n")
    (path / "broken.csv").write_text("0, 0, 0\n1, two, 3\n")
    (path / "curve.xyz").write_text("")
    (path / "broken.toml").write_text("margin =\n")
    rock = '[obstacles.rock]\ntype = "sphere"\ncenter = [0, 0, 0.01]\nradius = 0.1\n'
    (path / "scene.toml").write_text(rock)
    return path


def check(error: FileError, file: Path, mistake: Mistake) -> None:
    message = str(error)
    if mistake.line is None:
        assert message.startswith(f"{file}: ")
        assert not re.match(r"line \d", error.reason)
    else:
        assert message.startswith(f"{file}: line {mistake.line}: ")
    assert "\n" not in message
    assert message.count(str(file)) == 1  # however deep the mistake is
    assert len(message) < 600 + len(str(file))
    for words in mistake.says:
        assert words in message


@pytest.mark.parametrize("name", SEEN)
def test_a_mistake_is_named_with_its_line(folder: Path, name: str) -> None:
    file = folder / "task.toml"
    file.write_text(SEEN[name].text)
    with pytest.raises(FileError) as caught:
        pp.Task.load(file)
    check(caught.value, file, SEEN[name])


@pytest.mark.parametrize("name", FOUND)
def test_what_the_arm_cannot_do_is_named_with_its_line(folder: Path, name: str) -> None:
    file = folder / "task.toml"
    file.write_text(FOUND[name].text)
    task = pp.Task.load(file)
    with pytest.raises(FileError) as caught:
        task.surroundings(task.reference())
    check(caught.value, file, FOUND[name])


@pytest.mark.parametrize("name", [name for name in SEEN if not re.search(r"\b(nan|inf)\b", name)])
def test_in_json_a_mistake_is_named_by_its_key(folder: Path, name: str) -> None:
    file = folder / "task.json"
    file.write_text(json.dumps(tomllib.loads(SEEN[name].text)))
    with pytest.raises(FileError) as caught:
        pp.Task.load(file)
    check(caught.value, file, SEEN[name]._replace(line=None))


@pytest.mark.parametrize(
    ("name", "content", "says"),
    [
        ("none.toml", None, "no such file"),
        ("a\0b.toml", None, "null"),
        ("task.yaml", "", "the name ends in '.yaml'; allowed: .toml, .json"),
        ("task", "", "the name ends in ''; allowed: .toml, .json"),
        ("folder.toml", "folder", "cannot be read (Is a directory)"),
        ("empty.toml", "", "arm: needs one of the keys 'urdf', 'template'"),
        ("comment.toml", "# nothing\n", "arm: needs one of the keys"),
        ("empty.json", "", "line 1, column 1: "),
        ("list.json", "[1, 2]", "contains no table; allowed: keys and values"),
        ("text.json", '"arm"', "contains no table"),
        ("broken.toml", "version = 1\n[arm\n", "line 2, column 5: "),
        ("open.toml", 'version = "', "end of the file: "),
        ("twice.toml", "version = 1\nversion = 1\n", "line 2, column 12: "),
        ("broken.json", '{"version": 1,\n "arm": }', "line 2, column 9: Expecting value"),
        ("twice.json", '{"arm": {"urdf": 1, "urdf": 2}}', "the key 'urdf' appears twice"),
        ("utf16.toml", VALID.encode("utf-16"), "is not UTF-8 text (byte 0)"),
        ("latin.toml", 'name = "café"'.encode("latin-1"), "is not UTF-8 text (byte 11)"),
        ("deep.toml", f"name = {'[' * 99}{']' * 99}", "nested too deep; allowed: 20 levels"),
        ("deeper.toml", f"name = {'[' * 9999}{']' * 9999}", "nested too deep"),
        ("deeper.json", f'{{"name": {"[" * 99999}', "nested too deep"),
        ("far.toml", f"[{'a.' * 3000}a]", "nested too deep"),
        ("huge.toml", f"version = {'9' * 99999}", ""),
        ("wide.toml", f"version = 0x{'f' * 99999}", "version: is a whole number of more than 64 bits"),
        ("wide.json", f'{{"arm": {{"modules": {"9" * 99}}}}}', "arm.modules: is a whole number"),
        ("number.json", f'{{"version": {"9" * 99999}}}', ""),
        ("odd.toml", '"a\\nb" = 1', r"line 1: 'a\nb': there is no such key"),
        ("blank.toml", '"" = 1', "line 1: '': there is no such key"),
        ("long.toml", f"{'x' * 9999} = 1", "xxx ...: there is no such key"),
        ("surrogate.json", '{"\\ud800": 1}', r"'\ud800': there is no such key"),
        ("date.toml", "kind = 2020-01-01", "line 1: kind: is datetime.date(2020, 1, 1); allowed: 'key"),
    ],
)
def test_a_file_that_is_none_is_refused_in_one_line(
    tmp_path: Path, name: str, content: str | bytes | None, says: str
) -> None:
    file = tmp_path / name
    if content == "folder":
        file.mkdir()
    elif content is not None:
        file.write_bytes(content.encode() if isinstance(content, str) else content)
    with pytest.raises(FileError) as caught:
        pp.Task.load(file)
    assert str(caught.value).startswith(f"{file}: {says if says.startswith('line') else ''}")
    assert says in str(caught.value)
    assert "\n" not in caught.value.reason
    assert len(caught.value.reason) < 300
    str(caught.value).encode()  # can be printed


SMALL: dict[str, Any] = tomllib.loads(VALID)
SMALL["keyframes"][1].update({"region": [1, 5], "tip": {"position": [0.1, 0.1, 0.1], "weight": 2}})
SMALL["arm"]["placement"] = {"position": [0, 0, 0.1], "rotation": ["0 deg", 0, 0]}
LED: dict[str, Any] = tomllib.loads(LEADER)
WRONG = st.one_of(
    st.none(),
    st.booleans(),
    st.integers(-3, 3),
    st.sampled_from([10**18, -(2**63), 2**63 - 1, 1e308, -1e308, 1e-300, float("inf"), float("nan")]),
    st.floats(-10, 10),
    st.sampled_from(
        ["", "1 m", "-5 deg", "10 ms", "helix", "arm.urdf", "none.csv", "geodesic", "~", "\0", "true"]
    ),
    st.text(max_size=5),
    st.just([]),
    st.just({}),
    st.lists(st.one_of(st.integers(-2, 2), st.text(max_size=2), st.none()), max_size=3),
    st.lists(st.lists(st.floats(-1, 1), min_size=3, max_size=3), max_size=6),
    st.dictionaries(st.sampled_from(["type", "a", "file", "obstacles"]), st.integers(0, 2), max_size=2),
)


def places(value: Any, place: tuple[Any, ...] = ()) -> list[tuple[Any, ...]]:
    """Ways to everything within a value but the value itself."""
    items = value.items() if isinstance(value, dict) else enumerate(value) if isinstance(value, list) else ()
    return [way for key, each in items for way in [(*place, key), *places(each, (*place, key))]]


def mutated(draw: Any, task: dict[str, Any]) -> dict[str, Any]:
    """A task file in which up to three things were dropped, replaced, copied or renamed."""
    task = copy.deepcopy(task)
    for _ in range(draw(st.integers(1, 3))):
        ways = places(task)
        if not ways:
            break
        *way, last = draw(st.sampled_from(ways))
        inside: Any = task
        for key in way:
            inside = inside[key]
        what = draw(st.sampled_from(["drop", "replace", "replace", "replace", "rename", "double"]))
        if what == "drop":
            del inside[last]
        elif what == "replace":
            inside[last] = draw(WRONG)
        elif what == "double" and isinstance(inside, list):
            inside.append(copy.deepcopy(inside[last]))
        elif isinstance(inside, dict):
            inside[draw(st.sampled_from(["type", "name", "time", "tip", "", "x"]))] = inside.pop(last)
    return task


@pytest.mark.filterwarnings("ignore::pinposture.errors.PostureWarning")  # of a long cycle
@examples(150, suppress_health_check=[HealthCheck.function_scoped_fixture, HealthCheck.too_slow])
@given(data=st.data())
def test_whatever_is_changed_there_is_a_task_or_one_line(folder: Path, data: st.DataObject) -> None:
    base = data.draw(st.sampled_from([SMALL, LED]))
    content = mutated(data.draw, base)
    file = folder / "mutated.json"
    file.write_text(json.dumps(content))
    try:
        task = pp.Task.load(file)
        long = not isinstance(task.motion, Leader) and any(
            (each.time or each.duration or 0.0) + each.hold > 100.0 * task.limits.dt for each in task.motion
        )
        if long or task.arm.n_modules > 8:  # would work, and take its time
            return
        reference = task.reference()
        task.surroundings(reference)
    except PostureError as error:
        assert isinstance(error, FileError)
        assert str(error).startswith(f"{file}: ")
        assert str(error).count(str(file)) == 1
        assert "\n" not in str(error)
        assert len(error.reason) < 800
        str(error).encode()
    else:
        assert np.all(np.isfinite(reference.offsets))


def test_all_mistakes_are_named_at_once_each_with_its_line(tmp_path: Path) -> None:
    """Unknown keys of one table and of others, then values, then what does not fit the arm."""
    text = (Path(__file__).parents[2] / "examples" / "tasks" / "keyframes.toml").read_text()
    file = tmp_path / "task.toml"

    def reasons(*changes: tuple[str, str]) -> list[str]:
        changed = text
        for old, new in changes:
            changed = changed.replace(old, new, 1)
        file.write_text(changed)
        with pytest.raises(FileError) as caught:
            pp.Task.load(file).reference()
        found = re.split(r" ?\(\d\) ", str(caught.value))
        assert found[0] == f"{file}: {len(found) - 1} reasons:"
        return found[1:]

    assert reasons(("cycle =", "cycel ="), ("velocity =", "velocty =")) == [
        "line 11: limits.cycel: there is no such key (did you mean 'cycle'?); allowed: "
        "cycle, step, velocity, acceleration, jerk, effort, position_margin",
        "line 12: limits.velocty: there is no such key (did you mean 'velocity'?); allowed: "
        "cycle, step, velocity, acceleration, jerk, effort, position_margin",
    ]
    found = reasons(('"20 ms"', '"20 mm"'), ('"1 s"', '"1 m"'), ('"0.5 s"', "true"))
    assert [each.split(":")[0] for each in found] == ["line 21", "line 34", "line 11"]
    found = reasons(('"10 cm"', '"-1 cm"'), ('"17 cm"', '"-1 cm"'), ('"90 deg/s"', "-1"))
    assert [each.split(":")[0] for each in found] == ["line 28", "line 41", "line 12"]
    found = reasons(("b = [1, 0, 0]", "b = [0.1, 0, 0]"), ('"17 cm"', '"1 cm"'))
    assert [each.split(":")[0] for each in found] == ["line 15", "line 38"]
