"""What the page on motions in time shows of saving works as shown."""

from __future__ import annotations

import re
import textwrap
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from task_texts import VALID

import pinposture as pp

PAGE = (Path(__file__).parents[2] / "docs" / "tasks.md").read_text()


def snippet(begin: str) -> str:
    """An indented snippet of the page, by its first words."""
    block = re.search(rf"^( +){re.escape(begin)}.*\n(?:\1.*\n)*", PAGE, re.MULTILINE)
    assert block is not None
    return textwrap.dedent(block[0])


def run(code: str) -> dict[str, Any]:
    names: dict[str, Any] = {"pp": pp, "np": np, "replace": replace, "Path": Path}
    exec(compile(code, "snippet", "exec"), names)
    return names


@pytest.fixture(autouse=True)
def in_a_folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.chdir(tmp_path)
    return tmp_path


def test_a_task_is_edited_and_saved(in_a_folder: Path) -> None:
    (in_a_folder / "walk.toml").write_text(VALID)
    task = run(snippet('task = pp.Task.load("walk.toml")'))["task"]
    again = pp.Task.load("higher.toml")
    assert again.motion == task.motion
    assert again.continuity == "acceleration"
    few = task.motion[-1].curve.controlled(12)  # as the page goes on to say
    assert "curve.controlled(12)" in PAGE
    assert "curve.controlled_within(1e-3)" in PAGE
    assert len(few.control_points) == 12


def test_a_task_is_told_how_its_parts_are_described(in_a_folder: Path) -> None:
    (in_a_folder / "snake.urdf").write_text(pp.Arm.from_template("RyRz", 6).urdf)
    task = run(snippet('arm = pp.Arm.from_urdf("snake.urdf"'))["task"]
    text = (in_a_folder / "coil.toml").read_text()
    assert '[arm]\nurdf = "snake.urdf"\nsplit = 2\n' in text
    assert '{ type = "helix", radius = 0.05, pitch = 0.05, turns = 1.2 }' in text
    assert pp.Task.load("coil.toml").motion == task.motion
    marks = pp.Task.load("coil.toml").reference().marks
    assert [mark.name for mark in marks] == ["keyframe 1", "keyframe 2"]
