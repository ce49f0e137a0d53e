"""The editor as somebody uses it: a mouse, a keyboard, two windows, and a server that is killed."""

from __future__ import annotations

import os
import re
import shutil
import signal
import subprocess
import sys
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest

pytest.importorskip("viser", reason="viser is not installed")

from window import Window, wait_until

import pinposture as pp
from pinposture.editor import Editor
from pinposture.editor.autosave import autosave_path
from pinposture.editor.edits import keyframes_of
from pinposture.editor.first_task import first_task

EXAMPLE = Path(__file__).parents[3] / "examples" / "tasks" / "keyframes.toml"


@pytest.fixture
def file(tmp_path: Path) -> Path:
    """A task file to be edited."""
    return Path(shutil.copy(EXAMPLE, tmp_path / "walk.toml"))


@pytest.fixture
def editor(file: Path) -> Iterator[Editor]:
    """An editor of it, at its second keyframe."""
    started = Editor(pp.Task.load(file), file, port=8400)
    started.post(lambda session: session.select(1))
    started.start()
    yield started
    started.close()


@pytest.fixture
def window(browser: Any, editor: Editor, pictures: Path | None) -> Iterator[Window]:
    opened = Window(browser, editor.url, editor.session.arm, pictures)
    yield opened
    opened.close()
    assert opened.complaints == []


def arrived(editor: Editor) -> None:
    """Wait until the arm has taken the shape that is asked of it."""
    session = editor.session
    wait_until(
        lambda: (
            session.proposal is None
            and editor.live.number == session.number
            and editor.live.status == "arrived"
        ),
        "the arm takes the shape",
    )


def test_a_day_at_work(
    browser: Any, editor: Editor, window: Window, file: Path, pictures: Path | None
) -> None:
    session = editor.session
    arrived(editor)
    window.picture("01-loaded")
    before, points = editor.live.state.q.copy(), session.shape.points.copy()

    # A control point is dragged with the mouse: the arm follows while the hand is at it.
    editor.post(lambda session: session.edit(lambda task: task, "nothing"))
    x, y = window.grab(points[2])
    errors, moved = [], []
    for k in range(12):
        window.drag(x + 6 * k, y - 8 * k, 6, -8, steps=1)
        errors.append(editor.live.mean_error)
        moved.append(np.abs(editor.live.state.q - before).max())
    window.picture("02-dragging")
    assert max(moved) > 0.01  # before the hand lets go
    window.drop()
    arrived(editor)
    assert np.abs(editor.live.state.q - before).max() > 0.05
    assert max(errors) > 1e-4 and editor.live.mean_error < 1e-6
    assert np.linalg.norm(session.shape.points[2] - points[2]) > 0.02
    assert np.allclose(session.shape.points[[0, 1, 3]], points[[0, 1, 3]])
    assert session.history.undoable == "moved point 3"
    window.picture("03-dragged")

    # A keyframe is added, and taken back.
    count = len(keyframes_of(session.task))
    window.tab("Keyframes")
    window.picture("04-keyframes")
    window.press("Add")
    wait_until(lambda: len(keyframes_of(session.task)) == count + 1, "a keyframe is added")
    window.picture("05-added")
    window.page.locator("canvas[data-engine]").click(position={"x": 40, "y": 300})
    window.page.keyboard.press("Control+z")
    wait_until(lambda: len(keyframes_of(session.task)) == count, "it is taken back")
    wait_until(lambda: window.notice.startswith("undone"), "the page says so")

    # A second window sees the same, and what it does is seen in the first.
    other = Window(browser, editor.url, session.arm, None)
    assert other.status == window.status
    other.tab("Shape")
    other.page.keyboard.press("n")
    wait_until(lambda: session.handle is not None, "a key selects a control point")
    wait_until(
        lambda: window.page.get_by_text("moved point 3").count() or session.handle is not None, "both see it"
    )
    other.close()

    # It is saved, and opened again.
    window.tab("File")
    assert session.changed and not autosave_is_stale(file, session)
    window.press("Save")
    wait_until(lambda: not session.changed, "it is saved")
    wait_until(lambda: not autosave_path(file).exists(), "what was kept beside it is gone")
    saved = pp.Task.load(file)
    assert np.array_equal(keyframes_of(saved)[1].curve.control_points, session.shape.points)
    window.picture("06-saved")
    window.press("Open this file")
    wait_until(lambda: session.notice.text.startswith("opened"), "it is opened again")
    arrived(editor)
    session_curves = [each.curve for each in keyframes_of(session.task)]
    assert session_curves == [each.curve for each in keyframes_of(saved)]


def autosave_is_stale(file: Path, session: Any) -> bool:
    """Whether what is kept beside a file is another task than the one being edited."""
    kept = wait_until(
        lambda: autosave_path(file).exists() and pp.Task.load(autosave_path(file)), "changes are kept"
    )
    return [k.curve for k in keyframes_of(kept)] != [k.curve for k in keyframes_of(session.task)]


def test_what_cannot_be_is_said_and_changes_nothing(editor: Editor, window: Window, tmp_path: Path) -> None:
    session = editor.session
    arrived(editor)
    task, points = session.task, session.shape.points.copy()

    # A curve that the arm cannot take: right behind its base. While the hand is at it, and when it lets go.
    x, y = window.grab(points[1])
    bx, by = window.at(points[0] + [-0.25, 0.0, 0.1])
    window.drag(x, y, bx - x, by - y)
    wait_until(lambda: "cannot take" in window.status, "the page says while dragging that it cannot be")
    assert "bends too much" in window.status
    window.picture("07-refused")
    q = editor.live.state.q
    window.drop()
    wait_until(lambda: "not done" in window.notice, "the page says that nothing was done")
    arrived(editor)
    assert session.task is task and np.array_equal(session.shape.points, points)
    assert np.all(np.isfinite(q))

    # A point onto another, in numbers.
    window.tab("Shape")
    editor.post(lambda session: setattr(session, "handle", 3) or session.say("selected"))
    wait_until(lambda: "selected" in window.notice, "a point is selected")
    places = window.page.locator("input[type=text]")
    del places
    editor_place = tuple(float(value) for value in points[2])
    fields = vector_fields(window)
    for field, value in zip(fields, editor_place, strict=True):
        field.fill(f"{value:.4f}")
        field.press("Enter")
        time.sleep(0.3)
    wait_until(lambda: "would lie on point" in window.notice, "the page says that a point lies on another")
    window.picture("08-on-another")

    # The last points that a curve needs.
    editor.post(lambda session: session.undo())
    editor.post(lambda session: session.undo())
    wait_until(lambda: session.task is task and session.proposal is None, "all is as it was")
    while len(session.shape.points) > 4:
        count = len(session.shape.points)
        editor.post(lambda session: setattr(session, "handle", len(session.shape.points) - 2))
        window.press("Delete")
        wait_until(
            lambda n=count: len(session.shape.points) == n - 1 or "not done" in window.notice, "a point goes"
        )
        if "not done" in window.notice:
            break
    if len(session.shape.points) == 4:
        kept = session.task
        editor.post(lambda session: setattr(session, "handle", 2))
        window.press("Delete")
        wait_until(lambda: "cannot be deleted" in window.notice, "the last points stay")
        assert session.task is kept

    # A file that cannot be read.
    (tmp_path / "broken.toml").write_text("version = 1\nkeyframes = 3\n")
    kept = session.task
    window.tab("File")
    window.fill("Task file", str(tmp_path / "broken.toml"))
    window.press("Open this file")
    wait_until(lambda: "not opened" in window.notice, "the page says that it cannot be read")
    assert "broken.toml" in window.notice and session.task is kept
    window.picture("09-unreadable")


def vector_fields(window: Window) -> list[Any]:
    """The three numbers of the selected control point."""
    row = window.page.get_by_text(re.compile(r"x, y, z")).first.locator("xpath=ancestor::div[.//input][1]")
    return list(row.locator("input").all())


def test_the_tour_is_offered_once(browser: Any, editor: Editor, pictures: Path | None) -> None:
    window = Window(browser, editor.url, editor.session.arm, pictures, toured=False)
    window.page.get_by_text("1 of 5").wait_for()
    window.picture("00-tour")
    for _ in range(4):
        window.page.get_by_role("button", name="Next").click()
        time.sleep(0.3)
    window.page.get_by_role("button", name="Done").click()
    time.sleep(0.5)
    window.page.reload()
    window.page.wait_for_selector("#status")
    time.sleep(3.0)
    assert window.page.get_by_text("1 of 5").count() == 0
    window.close()


def test_what_a_killed_server_leaves_is_taken_up_again(
    browser: Any, tmp_path: Path, pictures: Path | None
) -> None:
    file = Path(shutil.copy(EXAMPLE, tmp_path / "walk.toml"))
    content = file.read_text()
    server, url = serve(file)
    try:
        window = Window(browser, url, pp.Task.load(file).arm, None)
        window.tab("Shape")
        window.page.keyboard.press("n")
        window.page.keyboard.press("n")
        window.page.keyboard.press("Shift+ArrowUp")
        wait_until(lambda: "moved point" in window.notice, "a key moves a point")
        wait_until(autosave_path(file).exists, "it is kept")
        time.sleep(0.5)
    finally:
        os.kill(server.pid, signal.SIGKILL)
        server.wait()
    window.close()
    assert file.read_text() == content  # not saved, and whole
    left = pp.Task.load(autosave_path(file))

    server, url = serve(file)
    try:
        window = Window(browser, url, left.arm, pictures)
        wait_until(lambda: "recovered" in window.notice, "the page says what it took up")
        window.picture("10-recovered")
        window.tab("File")
        window.press("Save")
        wait_until(lambda: "saved" in window.notice, "it is saved")
    finally:
        server.send_signal(signal.SIGINT)
        server.wait(timeout=20)
    window.close()
    saved = pp.Task.load(file)
    assert [k.curve for k in keyframes_of(saved)] == [k.curve for k in keyframes_of(left)]
    assert not autosave_path(file).exists()


def serve(file: Path) -> tuple[subprocess.Popen[str], str]:
    """Start the editor as from the shell; gives the process and where it is."""
    command = [sys.executable, "-m", "pinposture", "edit", str(file), "--no-browser", "--port", "8410"]
    process = subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.DEVNULL, text=True)
    assert process.stdout is not None
    url = process.stdout.readline().strip()
    assert url.startswith("http://")
    return process, url


def test_any_arm_can_be_edited(browser: Any, pictures: Path | None) -> None:
    task = first_task(pp.Arm.from_template("RzRz", modules=12))
    editor = Editor(task, port=8420)
    editor.start()
    try:
        window = Window(browser, editor.url, task.arm, pictures)
        arrived(editor)
        window.picture("11-planar")
        window.close()
    finally:
        editor.close()
