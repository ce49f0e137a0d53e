"""Several control points in a window: selected, dragged together and to a grid, duplicated, deleted."""

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

pytestmark = pytest.mark.browser

Edit = Callable[..., Editor]
Look = Callable[..., Window]


def test_several_points_are_selected_and_edited_together(edit: Edit, look: Look, file: Path) -> None:
    editor = edit(pp.Task.load(file), file, selected=1)
    window = look(editor)
    session = editor.session
    arrived(editor)
    points = session.shape.points.copy()
    page = window.page

    # A click selects one; with Shift it selects one more.
    page.mouse.click(*window.hover(points[2]))
    wait_until(lambda: session.handles == (2,), "one is selected")
    page.keyboard.down("Shift")
    page.mouse.click(*window.hover(points[3]))
    page.keyboard.up("Shift")
    wait_until(lambda: session.handles == (2, 3), "two are")

    # Both are dragged by one of them.
    window.drag(points[2], points[2] + [0.05, 0.0, 0.05])
    window.drop()
    wait_until(lambda: session.history.undoable == "moved points 3, 4", "both are moved")
    by = session.shape.points - points
    assert np.linalg.norm(by[2]) > 0.02
    assert np.allclose(by[3], by[2])
    assert np.array_equal(by[[0, 1, 4]], np.zeros((3, 3)))
    arrived(editor)

    # Copies of them are made, and deleted at once.
    window.press("Duplicate")
    wait_until(lambda: session.history.undoable == "duplicated points 3, 4", "they are doubled")
    assert (len(session.shape.points), session.handles) == (7, (3, 5))
    window.picture("15-points")
    window.press("Delete")
    wait_until(lambda: session.history.undoable == "deleted points 4, 6", "the copies are deleted")
    assert np.allclose(session.shape.points, points + by)
    arrived(editor)
    window.aside()
    window.key("Control+a")
    wait_until(lambda: session.handles == (1, 2, 3, 4), "all are selected")
    window.key("Escape")
    wait_until(lambda: not session.handles, "none is")


def test_a_dragged_point_comes_to_the_grid(edit: Edit, look: Look, file: Path) -> None:
    editor = edit(pp.Task.load(file), file, selected=1)
    window = look(editor)
    session = editor.session
    arrived(editor)
    point = session.shape.points[2].copy()
    step = window.field("Grid [mm]")
    step.fill("50")
    window.field("Snap to a grid").click()
    wait_until(lambda: session.grid == 0.05, "there is a grid")
    window.drag(point, point + [0.04, 0.0, 0.08])
    window.drop()
    wait_until(lambda: session.history.undoable == "moved point 3", "it is moved")
    cells = session.shape.points[2] / 0.05
    assert np.allclose(cells, np.round(cells), atol=1e-9)
    arrived(editor)
    before = session.shape.points[2].copy()
    window.aside()
    window.key("Shift+ArrowUp")  # by a step of the grid
    wait_until(lambda: np.allclose(session.shape.points[2] - before, [0, 0, 0.05]), "it is one step higher")
    arrived(editor)
    window.field("Snap to a grid").click()
    wait_until(lambda: session.grid == 0.0, "there is none")
