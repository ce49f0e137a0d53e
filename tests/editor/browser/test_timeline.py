"""The timeline: keyframes are chosen and dragged at it, past others, too; in a small window."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

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


def keyframe(number: int) -> str:
    """Where a keyframe is at the timeline, from 1."""
    return f'#timeline [data-keyframe="{number - 1}"]'


def drag(window: Window, number: int, by: float) -> None:
    """Drag a keyframe along the timeline [s]."""
    begin, end = (window.middle(f'#timeline :text-is("{at} s")')[0] for at in (0, 1))
    x, y = window.middle(keyframe(number))
    window.page.mouse.move(x, y)
    window.page.mouse.down()
    for share in (0.3, 0.7, 1.0):
        window.page.mouse.move(x + share * by * (end - begin), y + 30.0 * share)  # the hand may leave it
    window.page.mouse.up()


def test_keyframes_are_chosen_and_dragged_at_the_timeline(edit: Edit, look: Look, file: Path) -> None:
    editor = edit(pp.Task.load(file), file)
    window = look(editor)
    session = editor.session
    arrived(editor)
    names = [each.name for each in keyframes_of(session.task)]
    window.page.set_viewport_size({"width": 800, "height": 600})
    on_top = "([x, y]) => document.elementFromPoint(x, y)?.innerText"

    def seen(number: int) -> bool:
        return bool(window.page.evaluate(on_top, [*window.middle(keyframe(number))]) == str(number))

    wait_until(lambda: all(map(seen, range(1, 6))), "none is covered")
    window.page.mouse.click(*window.middle(keyframe(3)))
    wait_until(lambda: session.selected == 2, "it is chosen")
    wait_until(lambda: "Keyframe 3/5" in window.page.locator("#keyframe").inner_text(), "the page says so")
    assert not session.history.undoable

    # Within its neighbours: only its time changes.
    x, _ = window.middle(keyframe(3))
    drag(window, 3, 0.5)
    window.says("keyframe 3 is now at 2.5 s")
    assert times_of(session.task) == pytest.approx([0.0, 1.0, 2.5, 3.0, 5.0])
    wait_until(lambda: window.middle(keyframe(3))[0] > x + 10.0, "it is drawn there")
    # Past the next one, which is held: the order changes.
    drag(window, 3, 1.5)
    window.says("keyframe 4 is now at 4 s")
    assert session.selected == 3
    order = [each.name for each in keyframes_of(session.task)]
    assert order == [names[k] for k in (0, 1, 3, 2, 4)]
    window.press("Undo")
    window.says("undone: moved keyframe 3 in time")
    window.press("Undo")
    wait_until(lambda: times_of(session.task) == [0.0, 1.0, 2.0, 3.0, 5.0], "it is all taken back")

    # Laps are drawn one after the other; in each of them a keyframe is chosen and dragged.
    window.tab("Keyframes")
    window.field("Laps").fill("2")
    window.says("2 laps")
    assert session.task.repeat == 2
    wait_until(lambda: window.page.locator("#timeline [data-keyframe]").count() == 10, "both are drawn")
    window.page.mouse.click(*window.middle(keyframe(9)))
    wait_until(lambda: session.selected == 3, "the fourth is chosen in the second lap")
    x, y = window.middle(keyframe(9))
    window.page.mouse.move(x, y)
    window.page.mouse.down()
    window.page.mouse.move(x + 10.0, y)
    window.page.mouse.up()
    window.says("keyframe 4 is now at")
    assert 3.0 < times_of(session.task)[3] < 4.5
    window.press("Undo")
    window.says("undone: moved keyframe 4 in time")
    window.press("Undo")
    wait_until(lambda: session.task.repeat == 1, "a single lap is left")

    # The first stays where it is.
    x, _ = window.middle(keyframe(1))
    drag(window, 1, 0.5)
    window.says("time of keyframe 1")
    wait_until(lambda: abs(window.middle(keyframe(1))[0] - x) < 1.0, "it is drawn where it is")
    assert times_of(session.task) == [0.0, 1.0, 2.0, 3.0, 5.0]


def test_a_keyframe_is_dragged_while_the_motion_is_played(edit: Edit, look: Look, file: Path) -> None:
    task = pp.Task.load(file)
    editor = edit(task.edited(motion=keyframes_of(task)[:2]), file)
    window = look(editor)
    session = editor.session
    arrived(editor)

    def rests() -> tuple[float, float] | None:
        before = window.middle("#timeline")
        window.page.wait_for_timeout(500)
        return before if window.middle("#timeline") == before else None

    place = wait_until(rests, "the panel is laid out")
    window.press("Loop: off")
    window.press("Play")
    wait_until(lambda: session.playback.shown and session.playback.time > 0.1, "it is played")
    assert window.middle("#timeline") == place  # nothing jumps
    window.middle("#playhead")
    drag(window, 2, 0.1)
    window.says("keyframe 2 is now at 1.1 s")
    wait_until(lambda: not session.playback.shown, "the motion is shown no more")
