"""What is always in sight: the toolbar, in windows large and small; and a page that rests."""

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


def test_the_toolbar_names_the_keyframe_and_turns_the_view(edit: Edit, look: Look, file: Path) -> None:
    editor = edit(pp.Task.load(file), file)
    window = look(editor)
    session = editor.session
    arrived(editor)
    assert window.page.locator("#keyframe").inner_text().startswith("Keyframe 1/5")
    (client,) = editor.page._server.get_clients().values()
    seen = np.array(client.camera.position)
    for tab in ("Keyframes", "File"):  # whichever tab is open
        window.tab(tab)
        assert window.page.get_by_role("button", name="Undo", exact=True).is_visible()
    for name in ("Redo", "All"):  # no hint covers its neighbours
        window.page.get_by_role("button", name=name, exact=True).hover()
        window.page.wait_for_timeout(1000)
        assert window.page.locator("[role=tooltip]:visible").count() == 0
    window.press("Top")
    wait_until(lambda: not np.allclose(client.camera.position, seen), "the camera moves")
    wait_until(lambda: client.camera.position[2] > session.arm.length, "it looks from above")
    above = np.array(client.camera.position)
    window.aside()
    window.key("f")
    wait_until(lambda: not np.allclose(client.camera.position, above), "it looks from the front again")
    window.aside()
    window.key("n")
    window.key("Shift+ArrowUp")
    wait_until(lambda: session.history.undoable == "moved point 2", "a point is moved")
    wait_until(lambda: "not saved" in window.page.locator("#keyframe").inner_text(), "the page says so")
    window.press("Undo")
    wait_until(lambda: not session.history.undoable, "it is undone")
    window.aside()
    window.key(" ")
    wait_until(lambda: session.playback.playing, "the motion is played")
    window.key(" ")
    wait_until(lambda: not session.playback.playing, "and stopped")


def test_nothing_is_covered_in_a_small_window(edit: Edit, look: Look, file: Path) -> None:
    editor = edit(pp.Task.load(file), file)
    window = look(editor)
    window.page.set_viewport_size({"width": 800, "height": 600})
    arrived(editor)

    def box(name: str) -> tuple[float, float, float, float]:
        found = window.page.get_by_role("button", name=name, exact=True).first.bounding_box()
        return found["x"], found["y"], found["x"] + found["width"], found["y"] + found["height"]

    def free() -> bool:
        play = box("Play")
        delete = box("Delete")
        return play[2] < delete[0] and delete[2] < 800.0 and max(play[3], delete[3]) < 600.0

    wait_until(free, "the panels stand beside each other")
    on_top = "([x, y]) => document.elementFromPoint(x, y)?.closest('button')?.innerText"

    def seen(name: str) -> bool:
        left, top, right, bottom = box(name)
        return bool(window.page.evaluate(on_top, [0.5 * (left + right), 0.5 * (top + bottom)]) == name)

    for name in ("Play", "Loop: off", "Undo", "Save", "Top", "Insert after", "Delete"):
        wait_until(lambda name=name: seen(name), f"{name} is not covered", 10.0)
    assert not window.page.locator("#legend").is_visible()
    (client,) = editor.page._server.get_clients().values()
    points = editor.live.state.points

    def is_in_sight() -> bool:
        """Whether the arm is in the picture and above the panel."""
        camera = client.camera
        top = window.page.get_by_role("tab", name="Motion").bounding_box()["y"]
        ahead = camera.look_at - camera.position
        right = np.cross(ahead, [0.0, 0.0, 1.0])
        axes = np.array([each / np.linalg.norm(each) for each in (right, np.cross(right, ahead), ahead)])
        x, y, z = axes @ (points - camera.position).T
        slope = np.tan(0.5 * camera.fov) * z
        low = 1.0 - 2.0 * top / 600.0  # of the picture above the panel, from -1 to 1
        return bool(np.all(np.abs(x) < camera.aspect * slope) and np.all((low * slope < y) & (y < slope)))

    wait_until(is_in_sight, "the arm is not covered")


def test_a_task_file_of_the_folder_is_chosen_and_opened(edit: Edit, look: Look, file: Path) -> None:
    other = pp.Task.load(file).edited(name="other")
    other.save(file.with_name("other.toml"))
    editor = edit(pp.Task.load(file), file)
    window = look(editor)
    window.tab("File")
    window.field("Choose").click()
    window.page.get_by_role("option", name="other.toml", exact=True).click()
    wait_until(lambda: window.field("Task file").input_value() == "other.toml", "its name is filled in")
    window.press("Open this file")
    window.says("opened other.toml")
    assert editor.session.task.name == "other"


def test_a_page_at_rest_receives_nothing(edit: Edit, look: Look, file: Path) -> None:
    editor = edit(pp.Task.load(file), file)
    window = look(editor)
    frames = []
    window.page.on("websocket", lambda socket: socket.on("framereceived", lambda _: frames.append(1)))
    window.page.reload()
    window.page.wait_for_selector("#status")
    arrived(editor)
    wait_until(lambda: frames, "the page is drawn")

    def rests() -> bool:
        before = len(frames)
        window.page.wait_for_timeout(4000)
        return len(frames) == before

    wait_until(rests, "nothing is sent for some seconds")
    window.aside()
    before = len(frames)
    window.key("n")
    wait_until(lambda: len(frames) > before or window.page.wait_for_timeout(100), "a change is sent")
