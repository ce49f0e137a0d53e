"""The motion of a task, played, stopped and taken away."""

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
from pinposture.editor.edits import keyframes_of, times_of

pytestmark = pytest.mark.browser

Edit = Callable[..., Editor]
Look = Callable[..., Window]


def short(file: Path) -> pp.Task:
    """The example, its first two keyframes only: that is worked out sooner."""
    task = pp.Task.load(file)
    return task.edited(motion=keyframes_of(task)[:2])


def test_a_motion_is_played_scrubbed_and_taken_away_and_an_edit_ends_it(
    edit: Edit, look: Look, file: Path, tmp_path: Path
) -> None:
    task = short(file)
    editor = edit(task, file)
    window = look(editor)
    session = editor.session
    arrived(editor)
    playback = session.playback
    window.press("Faster")
    wait_until(lambda: playback.speed == 2.0, "it is to be shown at twice the speed")
    window.press("Slower")
    window.press("Loop: off")
    window.press("Play")
    wait_until(lambda: playback.shown and playback.time > 0.1, "it is played")
    window.press("Pause")
    wait_until(lambda: not playback.playing, "it stands still")
    wait_until(lambda: "Motion at " in window.status, "the page says which moment of the motion this is")
    at = playback.time
    window.press("Play")
    wait_until(lambda: playback.playing and playback.time != at, "it goes on")

    # A press on the timeline shows that moment of it.
    x, y = window.middle("#timeline")
    window.page.mouse.click(x, y)
    wait_until(lambda: not playback.playing, "it stands still")
    wait_until(
        lambda: abs(playback.time - 0.5 * playback.lasting) < 0.1 * playback.lasting, "half of it over"
    )
    wait_until(lambda: abs(window.middle("#playhead")[0] - x) < 2.0, "the playhead is there, too")
    motion = playback.motion
    assert motion is not None
    row = round(playback.time / motion.dt)
    assert np.abs(playback.q - motion.q[row]).max() < 0.1  # as it is in the motion
    window.picture("10-motion")

    # It is taken away as a file.
    window.tab("File")
    with window.page.expect_download() as coming:
        window.press("CSV")
    got = tmp_path / coming.value.suggested_filename
    assert got.name == "walk.csv"
    coming.value.save_as(got)
    window.says("walk.csv: joint positions, speeds and accelerations")
    window.picture("11-exported")
    loaded = pp.load(got, pp.JointTrajectory)
    motion = wait_until(lambda: session.playback.preview.of(task), "it is kept").motion
    assert loaded.joint_names == motion.joint_trajectory().joint_names
    assert np.allclose(loaded.positions, motion.joint_trajectory().positions, atol=1e-9)
    assert loaded.time[-1] >= times_of(task)[-1]

    # Whoever edits sees the arm of the moment.
    window.aside()
    window.key("n")
    window.key("Shift+ArrowUp")
    wait_until(lambda: session.history.undoable == "moved point 2", "a point is moved")
    wait_until(lambda: not playback.shown, "the motion is shown no more")
    wait_until(lambda: "Playing" not in window.status, "the page says so")
