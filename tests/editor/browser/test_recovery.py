"""A server that is killed loses nothing."""

from __future__ import annotations

import os
import signal
from pathlib import Path
from typing import Any

import numpy as np
import pytest

pytest.importorskip("viser", reason="viser is not installed")

from editor.browser.desk import curves, free_port, served, wait_until
from editor.browser.window import Window

import pinposture as pp
from pinposture.editor.edits import Shape, keyframes_of
from pinposture.editor.files import autosave_path
from pinposture.editor.ui.page import viewpoint

pytestmark = pytest.mark.browser


def moved(task: pp.Task) -> np.ndarray:
    """The second control point of the first keyframe."""
    return Shape.of(task.arm, keyframes_of(task)[0]).points[1]


def test_a_page_says_that_its_server_was_killed_and_what_is_left_is_taken_up_again(
    browser: Any, file: Path, pictures: Path | None
) -> None:
    content = file.read_text()
    task = pp.Task.load(file)
    port = free_port()
    with served(file, port) as (server, url):
        old = Window(browser, url, viewpoint(task), None)
        old.key("n")
        wait_until(lambda: old.field("Control point").input_value() == "2", "a key selects a point")
        old.key("Shift+ArrowUp")
        old.says("moved point 2")
        wait_until(lambda: autosave_path(file).exists(), "it is kept")
        note = old.page.locator("#gone")
        assert not note.is_visible()
        assert old.page.title() == "pinposture"
        os.kill(server.pid, signal.SIGKILL)
        server.wait()
        note.wait_for(state="visible")
        assert note.inner_text().startswith('"pinposture edit" has stopped')
        seen = "getComputedStyle(document.querySelector('#root')).filter"
        assert "grayscale" in old.page.evaluate(seen)
    assert file.read_text() == content  # not saved, and whole
    left = pp.Task.load(autosave_path(file))
    assert np.allclose(moved(left) - moved(task), [0.0, 0.0, 0.01 * task.arm.length], atol=1e-9)

    with served(file, port) as (server, url):
        wait_until(lambda: "has a new address" in note.inner_text(), "the old page says where to go")
        old.close()
        window = Window(browser, url, viewpoint(task), pictures)
        window.says("recovered unsaved changes (from walk.autosave.toml)")
        window.tab("File")
        window.picture("09-recovered")
        window.press("Save")
        window.says("saved as walk.toml")
        wait_until(lambda: not autosave_path(file).exists(), "nothing is left beside it")
        window.close()
    assert server.returncode == 0
    assert curves(pp.Task.load(file)) == curves(left)
