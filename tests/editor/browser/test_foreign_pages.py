"""In a real browser: the page connects with its address, another page does not, and no name is a script."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

pytest.importorskip("viser", reason="viser is not installed")

from editor.browser.window import Window
from editor.test_hostile_names import HOSTILE, MARKS, hostile_task

from pinposture.editor import Editor
from pinposture.task import Task

pytestmark = pytest.mark.browser

Edit = Callable[..., Editor]
Look = Callable[..., Window]

REACH = """
(address) => new Promise((done) => {
  const socket = new WebSocket(address, ["viser-v1.1.1"]);
  socket.onopen = () => done("let in");
  socket.onerror = () => done("refused");
})
"""


def test_no_name_runs_as_a_script(edit: Edit, look: Look, tmp_path: Path) -> None:
    path = tmp_path / f"y{HOSTILE}.toml".replace("/", "")
    hostile_task(tmp_path).save(path)
    editor = edit(Task.load(path), path)
    window = look(editor)
    for tab in ("Shape", "Keyframes", "Scene", "Arm", "File"):
        window.tab(tab)
    window.page.get_by_text(path.name, exact=False).first.wait_for()
    for name in (HOSTILE, *MARKS):
        editor.post(lambda session, name=name: session.say(name, "error"))  # type: ignore[misc]
        window.says(name[:20])
    assert window.page.locator("#hostile, hostile").count() == 0
    assert len(window.page.frames) == 1
    assert window.page.evaluate("window.ran") is None


def test_another_page_reaches_nothing_though_it_knew_the_address(
    browser: Any, edit: Edit, look: Look, file: Path
) -> None:
    editor = edit(Task.load(file), file)
    look(editor)
    socket = editor.url.replace("http", "ws", 1)
    context = browser.new_context()
    page = context.new_page()
    # A page of another origin, as from a server elsewhere; nothing is fetched.
    page.route(
        "http://evil.example/", lambda route: route.fulfill(body="<p>evil</p>", content_type="text/html")
    )
    page.goto("http://evil.example/")
    assert page.evaluate(REACH, socket) == "refused"
    assert page.evaluate(REACH, socket.rsplit("/", 1)[0]) == "refused"
    page.goto(editor.url)
    assert page.evaluate(REACH, socket) == "let in"  # from the page itself
    context.close()
