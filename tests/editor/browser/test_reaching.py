"""The tip of the arm is taken hold of by its key, and dragged along one of its axes."""

from __future__ import annotations

import time
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

pytest.importorskip("viser", reason="viser is not installed")

from editor.browser.desk import arrived, wait_until
from editor.browser.window import Window

import pinposture as pp
from pinposture.editor import Editor
from pinposture.editor.ui.curve import CURVE

pytestmark = pytest.mark.browser

Edit = Callable[..., Editor]
Look = Callable[..., Window]


def test_the_tip_is_dragged_up(edit: Edit, look: Look, file: Path) -> None:
    editor = edit(pp.Task.load(file), file, selected=1)
    window = look(editor)
    session = editor.session
    arrived(editor)
    before = session.task
    tip = editor.live.state.points[-1]
    window.aside()
    window.key("t")
    wait_until(lambda: session.tip, "the tip is held")
    box = window.page.get_by_label("Drag the tip")
    wait_until(box.is_checked, "the box shows it")
    grip = tip + [0.0, 0.0, 0.7 * CURVE.axes_size * session.arm.length]
    up = np.array([0.0, 0.0, 0.05 * session.arm.length])
    mouse = window.page.mouse

    def pulled() -> bool:  # once the axes are drawn
        mouse.move(*window.at(grip))
        time.sleep(0.2)  # a slow page notices what the mouse is over before the button goes down
        mouse.down()
        for k in range(1, 9):
            mouse.move(*window.at(grip + k / 8 * up))
        if _comes(lambda: session.proposal is not None):
            return True
        mouse.up()
        return False

    wait_until(pulled, "the tip is dragged")
    wait_until(lambda: editor.live.state.points[-1][2] > tip[2] + 0.5 * up[2], "the arm follows")
    assert session.task is before
    mouse.up()
    wait_until(lambda: session.history.undoable.startswith("reached for ("), "it counts")
    arrived(editor)
    assert np.abs(editor.live.state.points[-1] - tip - up).max() < 0.5 * up[2]
    window.aside()
    window.key("Control+z")
    window.says("undone: reached for (")
    assert session.task is before


def _comes(true: Callable[[], bool]) -> bool:
    """Whether something comes true within five seconds."""
    end = time.monotonic() + 5.0
    while not (found := true()) and time.monotonic() < end:
        time.sleep(0.02)
    return found
