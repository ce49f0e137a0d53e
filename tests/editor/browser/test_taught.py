"""A task with a taught configuration among its curves: chosen, taught, drawn as a curve, played and saved."""

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

CLIPPED = """
() => {
    document.querySelectorAll("#legend span").forEach((each) => { each.innerText += " 0.123"; });
    return [...document.querySelectorAll("#status, #notice, #keyframe, #legend span")].filter((each) => {
        const own = each.getBoundingClientRect();
        for (let outer = each; outer; outer = outer.parentElement) {
            const box = outer.getBoundingClientRect(), free = getComputedStyle(outer).overflow == "visible";
            const clips = outer.id == "legend" || !free;
            if (clips && (own.right > box.right + 1 || own.bottom > box.bottom + 1)) return true;
        }
    }).map((each) => each.innerText);
}
"""
"""The captions that are cut off, with longer numbers in the legend."""

LONG = "a motion of 25.58 s, 1.01 times as long as planned: joint m12_j1_y is at its velocity limit for 0.3 s"


def test_a_taught_keyframe_is_shown_played_changed_and_saved(edit: Edit, look: Look, file: Path) -> None:
    task = pp.Task.load(file)
    joints = np.round(0.12 * np.sin(np.arange(task.arm.nv) / 3.0), 4)
    taught = pp.Keyframe(joints=joints, time=0.5, name="taught")
    task.edited(motion=(keyframes_of(task)[0], taught)).save(file)
    text = file.read_text()
    editor = edit(pp.Task.load(file), file)
    window = look(editor)
    session = editor.session
    arrived(editor)

    # It is chosen at the timeline, and the arm takes it. There is nothing to drag.
    window.page.mouse.click(*window.middle('#timeline [data-keyframe="1"]'))
    wait_until(lambda: session.selected == 1, "it is chosen")
    wait_until(lambda: editor.live.state.positions == pytest.approx(joints, abs=1e-6), "the arm takes it")
    window.page.get_by_text("A taught configuration has no control points.").wait_for()
    wait_until(lambda: "On target" in window.status, "the page says so")
    window.aside()
    window.key("n")
    window.says("keyframe 2: a taught configuration has no control points")

    # The motion ends in it, and no caption is cut off.
    window.press("Play")
    playback = session.playback
    wait_until(lambda: playback.shown and not playback.playing, "it has been played")
    assert session.arm.positions(playback.q) == pytest.approx(joints, abs=1e-4)
    wait_until(lambda: "acceleration" in window.page.locator("#legend").inner_text(), "it is plotted")
    editor.post(lambda session: session.say(LONG))
    window.says(LONG)
    assert window.page.evaluate(CLIPPED) == []
    window.press("Live")

    # Time, name and speed are edited as of any other; the posture of the arm is added behind it.
    window.tab("Keyframes")
    window.page.get_by_role("button", name="2 taught · 0.5 s · taught · fine", exact=True).wait_for()
    assert window.field("Method").is_disabled()
    window.field("Speed [%]").fill("50")
    window.says("keyframe 2 at 50 % of the velocity limits")
    window.press("Add taught")
    window.says("added keyframe 3, taught the present posture")
    assert keyframes_of(session.task)[2].joints == pytest.approx(joints, abs=1e-5)
    window.press("Undo")
    window.says("undone: added keyframe 3")
    window.press("Save")
    window.says("saved as walk.toml")
    assert file.read_text() == f"{text.rstrip()}\nspeed = 0.5\n"

    # It becomes a curve with balls to drag, and is taught again what it was.
    window.press("To curve")
    wait_until(lambda: session.history.undoable == "drew a curve through keyframe 2", "a curve is drawn")
    arrived(editor)
    assert len(session.shape.points) > 3
    assert editor.live.state.positions == pytest.approx(joints, abs=0.1)
    window.press("Teach")
    window.says("taught keyframe 2 the present posture")
    assert keyframes_of(session.task)[1].curve is None
