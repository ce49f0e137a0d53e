"""A task as somebody edits it: a point is dragged, a keyframe added and taken back, all of it saved."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

pytest.importorskip("viser", reason="viser is not installed")

from editor.browser.desk import arrived, curves, wait_until
from editor.browser.window import Window

import pinposture as pp
from pinposture.editor import Editor
from pinposture.editor.edits import keyframes_of
from pinposture.editor.files import autosave_path, first_task

pytestmark = pytest.mark.browser

Edit = Callable[..., Editor]
Look = Callable[..., Window]


def test_the_arm_follows_while_a_point_is_dragged(edit: Edit, look: Look, file: Path) -> None:
    editor = edit(pp.Task.load(file), file, selected=1)
    window = look(editor)
    session = editor.session
    arrived(editor)
    window.picture("01-loaded")
    before = editor.live.state.q.copy()
    points = session.shape.points.copy()
    seen: list[tuple[bool, float, float]] = []

    def note() -> None:
        live = editor.live
        seen.append((session.changed, float(np.abs(live.state.q - before).max()), live.mean_error))

    window.drag(points[2], points[2] + [0.1, 0.0, 0.0], note)
    wait_until(lambda: note() or max(moved for _, moved, _ in seen) > 0.01, "the arm follows")
    assert not any(changed for changed, _, _ in seen)  # nothing counts before the hand lets go
    window.drag_on(0.03, 0.05, note)
    window.picture("02-dragging")
    window.drop()
    wait_until(lambda: session.history.undoable == "moved point 3", "it counts")
    arrived(editor)
    assert editor.live.mean_error < min(1e-6, max(error for _, _, error in seen))
    assert np.linalg.norm(session.shape.points[2] - points[2]) > 0.05
    assert np.array_equal(session.shape.points[:2], points[:2])
    wait_until(lambda: "On the curve to within " in window.status, "the page says so")
    window.picture("03-dragged")


def test_keyframes_files_and_two_windows(edit: Edit, look: Look, file: Path) -> None:
    editor = edit(pp.Task.load(file), file, selected=1)
    window = look(editor)
    session = editor.session
    arrived(editor)
    count = len(keyframes_of(session.task))
    task = session.task

    # A keyframe is added, and taken back by the keyboard.
    window.tab("Keyframes")
    window.press("Add")
    wait_until(lambda: len(keyframes_of(session.task)) == count + 1, "a keyframe is added")
    window.says("added keyframe 3")
    window.picture("04-keyframe-added")
    window.key("Control+z")
    wait_until(lambda: session.task is task, "it is taken back")
    window.says("undone: added keyframe 3")

    # A second window sees the same, and what is done there is seen in the first.
    other = look(editor)
    assert other.status.split(":")[0] == window.status.split(":")[0]
    other.tab("Keyframes")
    other.page.get_by_role("button", name="3 coil · 2 s").wait_for()
    name = other.field("Name")
    assert name.input_value() == "reach over"
    name.fill("reach under")
    window.says("named keyframe 2 'reach under'")
    window.page.get_by_role("button", name="2 reach under · 1 s").wait_for()
    other.close()

    # It is kept beside the file, then saved, and opened again.
    kept = autosave_path(file)
    wait_until(
        lambda: kept.exists() and keyframes_of(pp.Task.load(kept))[1].name == "reach under", "it is kept"
    )
    assert keyframes_of(pp.Task.load(file))[1].name == "reach over"
    window.tab("File")
    assert window.field("Task file").input_value() == "walk.toml"
    window.press("Save")
    window.says("saved as walk.toml")
    wait_until(lambda: not kept.exists(), "what was kept beside it is gone")
    assert not session.changed
    saved = pp.Task.load(file)
    assert keyframes_of(saved)[1].name == "reach under"
    assert curves(saved) == curves(session.task)
    window.picture("05-saved")
    before = session.task
    window.press("Open this file")
    window.says("opened walk.toml")
    assert session.task is not before
    assert curves(session.task) == curves(saved)
    assert session.history.undoable == ""


def test_any_arm_can_be_edited(edit: Edit, look: Look) -> None:
    task = first_task(pp.Arm.from_template("RzRz", modules=12))
    editor = edit(task)
    window = look(editor)
    session = editor.session
    arrived(editor)
    points = session.shape.points.copy()
    window.drag(points[3], points[3] + [0.3, 0.3, 0.2])
    window.drop()
    wait_until(lambda: session.history.undoable == "moved point 4", "a point is dragged")
    arrived(editor)
    assert np.abs(session.shape.points[:, 2]).max() < 1e-12  # a planar arm: it stays in the plane
    assert editor.live.mean_error < 1e-6
    window.picture("06-planar")
