"""Tasks that are edited, and tasks that are made in Python: what is kept, and what is refused."""

from __future__ import annotations

import pickle
from collections.abc import Callable
from dataclasses import FrozenInstanceError, replace
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from arms import template_arm
from task.same_tasks import assert_same
from task_texts import VALID

import pinposture as pp
from pinposture.errors import (
    CurveEndsEarly,
    FileError,
    InvalidValue,
    PostureError,
    TaskError,
    UnknownName,
    no_warnings,
)
from pinposture.task.follow_leader import Leader

LIMITS = pp.Limits(step=None, dt=0.02)
with no_warnings():
    LONG = pp.Limits(dt=61.0)


def six_modules() -> pp.Arm:
    return template_arm("RyRz", 6)


@cache
def line() -> pp.Curve:
    return pp.Curve.line((0, 0, 0), (0.3, 0, 0))


def frames() -> tuple[pp.Keyframe, ...]:
    return pp.Keyframe(line()), pp.Keyframe(line(), time=1.0, name="b")


def leader(**changes: Any) -> Leader:
    return replace(Leader(line(), 0.1), **changes)


def test_an_edited_task_tells_of_no_lines(tmp_path: Path) -> None:
    path = tmp_path / "task.toml"
    path.write_text(VALID.replace("turns = 0.6", "turns = 0.3"))
    task = pp.Task.load(path)
    with pytest.raises(FileError, match=r"task\.toml: line \d+: keyframe 2 'bowed': module \d") as told:
        task.reference()
    for edited in (
        task.edited(motion=task.motion[::-1]),
        replace(task, limits=LIMITS),
        task.edited(name="another"),
    ):
        with pytest.raises((TaskError, CurveEndsEarly), match=r"^keyframe ") as caught:
            edited.reference()
        assert "line" not in str(caught.value)
    assert told.value.path == path
    again = pp.Task.load(task.edited(name="another").save(path))
    with pytest.raises(FileError, match=r"task\.toml: line 36: keyframe 2 'bowed'"):
        again.reference()


def test_an_edit_changes_nothing_else(tmp_path: Path) -> None:
    path = tmp_path / "task.toml"
    path.write_text(VALID + '[editor]\nscans = ["a.ply"]\n')
    task = pp.Task.load(path)
    edited = task.edited(continuity="acceleration")
    assert_same(edited.edited(continuity="velocity"), task)
    assert edited.arm is task.arm
    assert edited.described == task.described
    with pytest.raises(FrozenInstanceError):
        edited.name = "x"  # type: ignore[misc]
    copied = pickle.loads(pickle.dumps(edited))
    assert_same(copied, edited)
    assert copied.save(tmp_path / "a.toml").read_text() == edited.save(tmp_path / "b.toml").read_text()


def test_attributes_are_settled(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    given: Any = {"formats": ["csv", "npz", "csv"], "scans": ["b/../c.ply"], "controller": "lm"}
    task = pp.Task(six_modules(), list(frames()), LIMITS, start=[0.0] * 12, **given)  # type: ignore[arg-type]
    assert task.motion == tuple(replace(each, placement="align") for each in frames())
    assert task.formats == ("npz", "csv")
    assert task.scans == (tmp_path.resolve() / "c.ply",)
    assert task.controller.name == "lm"
    with pytest.raises(ValueError, match="read-only"):
        task.start[0] = 1.0


@pytest.mark.parametrize(
    ("changes", "kind", "message"),
    [
        ({"arm": "RyRz"}, InvalidValue, "arm is 'RyRz'; allowed: an Arm"),
        (
            lambda: {"motion": frames()[:1]},
            InvalidValue,
            r"keyframes is .*; allowed: two or more of Keyframe",
        ),
        ({"motion": ()}, InvalidValue, "keyframes is"),
        (lambda: {"motion": (*frames(), line())}, InvalidValue, "keyframes is"),
        (lambda: {"motion": line()}, InvalidValue, "keyframes is"),
        (
            lambda: {"motion": (frames()[0], replace(frames()[1], region=(1, 6)))},
            TaskError,
            r"^keyframe 2 'b': its region is \(1, 6\); the arm has control points 0 to 5",
        ),
        (
            lambda: {"motion": (frames()[0], replace(frames()[1], tip=pp.EndEffector((0, 0, 1), point=6)))},
            InvalidValue,
            "^keyframe 2 'b': point is 6; allowed:",
        ),
        (
            lambda: {
                "motion": (frames()[0], replace(frames()[1], tip=pp.EndEffector((0, 0, 1), point="tipp")))
            },
            UnknownName,
            "^keyframe 2 'b': .*'tipp'",
        ),
        (
            lambda: {"scene": pp.Scene({"rock": pp.Sphere((0, 0, 0.01), 0.1)})},
            TaskError,
            r"^obstacle 'rock': it stands where the base of the arm is, at \(0, 0, 0\) m; move it",
        ),
        ({"scene": {}}, InvalidValue, "scene is {}; allowed: a Scene, or None"),
        ({"limits": pp.Limits()}, InvalidValue, "limits is .*; allowed: Limits\\(dt="),
        ({"limits": None}, InvalidValue, "limits is not given"),
        ({"limits": LONG}, InvalidValue, "dt is 61.0; allowed: 60 s at most"),
        ({"limits": pp.Limits(np.ones(5), dt=1.0)}, InvalidValue, r"step \(shape\) is \(5,\)"),
        ({"controller": "best"}, UnknownName, "no controller is called 'best'"),
        ({"controller": 3}, InvalidValue, "controller is 3"),
        ({"start": np.zeros(5)}, InvalidValue, r"start \(shape\) is \(5,\)"),
        ({"start": np.full(12, np.nan)}, InvalidValue, r"start\[0\] is nan"),
        ({"continuity": "jerk"}, UnknownName, "no continuity is called 'jerk'"),
        ({"formats": ("pdf",)}, UnknownName, "no format is called 'pdf'"),
        ({"formats": "npz"}, InvalidValue, "formats is 'npz'"),
        ({"name": None}, InvalidValue, "name is not given; allowed: text"),
        ({"scans": "scan.ply"}, InvalidValue, "scans is 'scan.ply'; allowed: paths of files"),
        ({"scans": (3,)}, InvalidValue, "scans is"),
        ({"scans": ("",)}, InvalidValue, "scans is"),
        ({"scans": ("a\0.ply",)}, InvalidValue, "scans is"),
        ({"described": {"arm": {}}}, InvalidValue, "described is .*; allowed: a mapping from curves"),
        ({"described": []}, InvalidValue, "described is"),
        (
            lambda: {"motion": leader(), "continuity": "acceleration"},
            InvalidValue,
            "continuity is 'acceleration'",
        ),
        (lambda: {"motion": leader(path="line")}, InvalidValue, "path is 'line'; allowed: a Curve"),
        (lambda: {"motion": leader(speed=0.0)}, InvalidValue, "speed is 0.0"),
        (lambda: {"motion": leader(depth=-1.0)}, InvalidValue, "depth is -1.0"),
        (lambda: {"motion": leader(pipe=1e-6)}, InvalidValue, "pipe is 1e-06; allowed: 0.0003 m or more"),
        (lambda: {"motion": leader(method="best")}, UnknownName, "no method is called 'best'"),
        (lambda: {"motion": leader(placement="translate")}, UnknownName, "no placement is called"),
        (lambda: {"motion": leader(and_back=1)}, InvalidValue, "and_back is 1"),
        (
            lambda: {"motion": leader(path=pp.Curve.line((0, 0, 0), (400, 0, 0)))},
            InvalidValue,
            "length of the path .* is 400.0; allowed: 300 m, 1000 times the arm",
        ),
    ],
)
def test_a_task_in_python_is_checked_as_a_file_is(
    changes: dict[str, Any] | Callable[[], dict[str, Any]], kind: type[PostureError], message: str
) -> None:
    def given() -> dict[str, Any]:
        return changes() if callable(changes) else changes

    task = pp.Task(six_modules(), frames(), LIMITS)
    with pytest.raises(kind, match=message):
        task.edited(**given())
    with pytest.raises(kind, match=message):
        pp.Task(**{"arm": six_modules(), "motion": frames(), "limits": LIMITS, **given()})


@pytest.mark.parametrize(
    ("table", "line", "message"),
    [
        ('scans = "a.ply"', 2, "editor.scans: is 'a.ply'; allowed: a list of files"),
        ('scans = [\n"a.ply",\n3]', 4, "editor.scan 2: is 3; allowed: the name of a file"),
        ('scans = [" "]', 2, "editor.scan 1: is ' '"),
        ('scans = ["a\\u0000.ply"]', 2, "editor.scan 1: is 'a"),
        ('scan = ["a.ply"]', 2, "editor.scan: there is no such key (did you mean 'scans'?)"),
        ('scans = ["~nobody-here/a.ply"]', 2, "editor.scans: is '~nobody-here/a.ply', which cannot be found"),
    ],
)
def test_the_table_of_the_editor_is_checked(tmp_path: Path, table: str, line: int, message: str) -> None:
    path = tmp_path / "task.toml"
    path.write_text(f"{VALID}[editor]\n{table}\n")
    with pytest.raises(FileError) as caught:
        pp.Task.load(path)
    assert str(caught.value).startswith(f"{path}: line {VALID.count(chr(10)) + line}: {message}")


def test_scans_that_are_missing_are_no_mistake(tmp_path: Path) -> None:
    path = tmp_path / "task.toml"
    path.write_text(f'{VALID}[editor]\nscans = ["a.ply", "../b.ply", "/c/d.ply"]\n')
    folder = tmp_path.resolve()
    assert pp.Task.load(path).scans == (folder / "a.ply", folder.parent / "b.ply", Path("/c/d.ply"))
    path.write_text(f"{VALID}[editor]\n")
    assert pp.Task.load(path).scans == ()


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ('"90 deg/s"', '"nothing"', "limits.velocity: is 'nothing'; allowed: a number"),
        ('"90 deg/s"', '["none", 1]', "limits.velocity: is ['none', 1]; allowed: a list of 12"),
        ('"20 ms"', '"none"', "limits.cycle: is 'none'; allowed: a number"),
        ("acceleration = 10", 'position_margin = "none"', "limits.position_margin: is 'none'"),
        (
            "modules = 6",
            "modules = 6\ncharacteristic_length = 0",
            "arm.characteristic_length: is 0; allowed: more than 0",
        ),
        ("trim = true", "tip = { position = [0, 0, 0], length = 0 }", "keyframe 2, tip.length: is 0"),
    ],
)
def test_what_files_may_say_besides_is_checked(tmp_path: Path, old: str, new: str, message: str) -> None:
    path = tmp_path / "task.toml"
    path.write_text(VALID.replace(old, new))
    with pytest.raises(FileError) as caught:
        pp.Task.load(path)
    assert message in str(caught.value)


@pytest.mark.parametrize("name", ["n" * 300 + ".toml", "nu\0ll.toml", "circle.toml"])
def test_a_name_that_no_file_can_have_is_refused(tmp_path: Path, name: str) -> None:
    (tmp_path / "circle.toml").symlink_to(tmp_path / "circle.toml")
    with pytest.raises(FileError, match="cannot be written"):
        pp.Task(six_modules(), frames(), LIMITS).save(tmp_path / name)
