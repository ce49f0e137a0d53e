"""What cannot be is refused with a message, and changes nothing."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

pytest.importorskip("viser", reason="viser is not installed")

from editor.browser.desk import arrived, wait_until
from editor.browser.window import Window

import pinposture as pp
from pinposture.editor import Editor
from pinposture.viz.palette import THEME

pytestmark = pytest.mark.browser

Edit = Callable[..., Editor]
Look = Callable[..., Window]

STIFF = """
version = 1
kind = "keyframes"
name = "stiff"

[arm]
template = "RyRz"
modules = 20
joint_limits = ["-40 deg", "40 deg"]

[[keyframes]]
curve = { type = "line", a = [0, 0, 0], b = [1, 0, 0] }

[[keyframes]]
time = "3 s"
curve = { type = "spline", control_points = [[0, 0, 0], [0.4, 0, 0], [0.8, 0.05, 0.15], [1.2, 0.1, 0]] }
trim = true
"""


@pytest.fixture
def stiff(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A task of an arm whose joints bend by 40 degrees only."""
    monkeypatch.chdir(tmp_path)
    file = tmp_path / "stiff.toml"
    file.write_text(STIFF)
    return file


def test_a_curve_that_the_arm_cannot_take(edit: Edit, look: Look, stiff: Path) -> None:
    editor = edit(pp.Task.load(stiff), stiff)
    window = look(editor, drawn=True)
    session = editor.session
    arrived(editor)
    task = session.task
    points = session.shape.points.copy()

    # Back beyond the base: the curve would turn round at once.
    window.drag(points[1], [-0.25, 0.0, 0.1])
    wait_until(lambda: "The arm cannot take this shape" in window.status, "it is said meanwhile")
    assert "bends too much" in window.status
    wait_until(lambda: window.shade(THEME.mark) > 20, "the curve is red")
    assert session.task is task
    assert np.all(np.isfinite(editor.live.state.q))
    window.picture("07-refused")
    window.drop()
    said = window.says("refused, the arm cannot take that shape")
    assert said.startswith("moved point 2: ")
    assert "bends too much" in said
    arrived(editor)
    assert session.task is task
    assert np.array_equal(session.shape.points, points)
    assert session.history.undoable == ""
    wait_until(lambda: window.shade(THEME.mark) < 20, "nothing is red any more")


def test_a_point_upon_another_and_one_too_few(edit: Edit, look: Look, stiff: Path) -> None:
    editor = edit(pp.Task.load(stiff), stiff)
    window = look(editor)
    session = editor.session
    arrived(editor)
    task = session.task
    points = session.shape.points.copy()

    # Typed, key by key: point 4 to where point 3 is.
    for _ in range(3):
        window.key("n")
    wait_until(lambda: window.field("Control point").input_value() == "4 (end)", "the last point is selected")
    numbers = [window.field("x, y, z [mm]", k) for k in range(3)]
    for number, value in zip(numbers, points[2], strict=True):
        number.fill(f"{1e3 * value:g}")
    window.says("is too close to point 3")
    window.picture("08-on-another")
    arrived(editor)
    assert session.task is task
    assert np.array_equal(session.shape.points, points)
    wait_until(
        lambda: [float(each.input_value()) for each in numbers] == (1e3 * points[3]).tolist(),
        "it stands there",
    )

    # Four points are the fewest that a cubic curve can do with.
    window.press("Delete")
    window.says("point 4: cannot be deleted: a curve of degree 3 needs 4 control points")
    assert session.task is task

    # The one at the base is passed over: it stays where it is.
    window.aside()
    window.key("n")
    wait_until(lambda: session.handle == 1, "the second is selected after the last")


def test_a_file_that_cannot_be_read(edit: Edit, look: Look, stiff: Path) -> None:
    editor = edit(pp.Task.load(stiff), stiff)
    window = look(editor)
    session = editor.session
    task = session.task
    broken = stiff.with_name("broken.toml")
    broken.write_text(STIFF.replace("modules = 20", "modules = 0"))
    window.tab("File")
    name = window.field("Task file")
    name.fill("broken.toml")
    window.press("Open this file")
    said = window.says("cannot open it")
    assert "broken.toml: line 8" in said
    assert "modules" in said
    name.fill("nowhere.toml")
    window.press("Open this file")
    window.says("nowhere.toml")
    name.fill("broken.toml")
    window.press("Save under this name")
    window.says("already exists")
    assert session.task is task
    assert session.path == stiff
    assert "modules = 0" in broken.read_text()
