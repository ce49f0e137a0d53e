"""The tour at the first visit, and what keys do; nothing while something is typed."""

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
from pinposture.editor.edits import keyframes_of

pytestmark = pytest.mark.browser

Edit = Callable[..., Editor]
Look = Callable[..., Window]


def test_the_tour_is_shown_at_the_first_visit_only(edit: Edit, look: Look, file: Path) -> None:
    window = look(edit(pp.Task.load(file), file, selected=1), toured=False)
    window.page.get_by_text("1 of 5").wait_for()
    window.picture("00-tour")
    for step in range(2, 6):
        window.press("Next")
        window.page.get_by_text(f"{step} of 5").wait_for()
    window.press("Done")
    window.page.get_by_text("5 of 5").wait_for(state="detached")
    wait_until(
        lambda: window.page.evaluate("Object.values(window.localStorage).includes('yes')"), "it is kept"
    )
    window.page.reload()
    window.page.wait_for_selector("#status")
    window.tab("File")
    assert window.page.get_by_text("of 5").count() == 0
    window.press("Show the tour")
    window.page.get_by_text("1 of 5").wait_for()
    window.press("Skip")
    window.page.get_by_text("1 of 5").wait_for(state="detached")


def test_each_key_does_what_is_said_of_it(edit: Edit, look: Look, file: Path) -> None:
    editor = edit(pp.Task.load(file), file, selected=1)
    window = look(editor)
    session = editor.session
    arrived(editor)
    shape = session.shape
    points = session.shape.points.copy()
    along = np.linspace(0.0, shape.curve.length, 101)

    def has(key: str, true: Callable[[], object], what: str) -> None:
        assert window.key(key), key
        wait_until(lambda: session.proposal is None and true(), what)

    has("n", lambda: session.handle == 1, "N selects the second point")
    has("n", lambda: session.handle == 2, "N goes on")
    has("b", lambda: session.handle == 1, "B goes back")
    has("i", lambda: len(session.shape.points) == len(points) + 1, "I inserts a point")
    assert np.allclose(session.shape.curve.at(along), shape.curve.at(along), atol=1e-11)  # the same curve
    assert session.handle == 2
    has("Delete", lambda: len(session.shape.points) == len(points), "Delete deletes it")
    assert np.allclose(session.shape.points, points)
    step = 0.01 * session.arm.length
    handle = session.handle
    assert handle is not None
    for key, way in (("Up", (0, 0, 1)), ("Right", (1, 0, 0)), ("Down", (0, 0, -1)), ("Left", (-1, 0, 0))):
        before = session.shape.points[handle].copy()
        goal = before + step * np.array(way)
        has(f"Shift+Arrow{key}", lambda goal=goal: np.allclose(session.shape.points[handle], goal), key)
    has("Control+z", lambda: bool(session.history.redoable), "Ctrl+Z takes it back")
    has("Control+Shift+z", lambda: not session.history.redoable, "Ctrl+Shift+Z does it again")
    has("Control+z", lambda: bool(session.history.redoable), "Ctrl+Z takes it back again")
    has("Control+y", lambda: not session.history.redoable, "Ctrl+Y does it again")
    assert session.changed
    has("Control+s", lambda: not session.changed, "Ctrl+S saves")  # and `key`: not the browser's page
    window.says("saved as walk.toml")
    has("Escape", lambda: session.handle is None, "Escape selects nothing")


def test_what_is_typed_is_no_command(edit: Edit, look: Look, file: Path) -> None:
    editor = edit(pp.Task.load(file), file, selected=1)
    window = look(editor)
    session = editor.session
    arrived(editor)
    window.key("n")
    wait_until(lambda: session.handle == 1, "a point is selected")
    count = len(session.shape.points)
    window.tab("Keyframes")
    name = window.field("Name")
    name.click()
    for key in ("End", "n", "i", "b", "i", "Delete", "Shift+ArrowLeft", "Escape"):
        window.key(key)
    wait_until(lambda: keyframes_of(session.task)[1].name == "reach overnibi", "the name is typed")
    assert session.handle == 1
    assert len(session.shape.points) == count
    assert session.history.undoable == "named keyframe 2 'reach overnibi'"

    window.tab("File")
    path = window.field("Task file")
    path.click()
    for key in ("End", "n", "i", "Delete"):
        window.key(key)
    assert path.input_value() == "walk.tomlni"

    assert not window.key("Control+s")  # the browser's own, while a field has the keyboard
    assert not window.key("Control+z")
    assert session.changed

    # A click into the picture, and keys are commands again.
    window.aside()
    window.key("n")
    wait_until(lambda: session.handle == 2, "the next point is selected")
    assert len(session.shape.points) == count
    assert session.path == file
