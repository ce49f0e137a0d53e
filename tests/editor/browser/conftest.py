"""A real browser, editors to be opened in it. Skipped, with the reason, where there is none."""

from __future__ import annotations

import os
import shutil
import threading
from collections.abc import Callable, Iterator
from contextlib import ExitStack
from pathlib import Path
from typing import TYPE_CHECKING, Any
from urllib.parse import urlsplit

import pytest

if TYPE_CHECKING:
    from editor.browser.window import Window

    from pinposture.editor import Editor

EXAMPLE = Path(__file__).parents[3] / "examples" / "tasks" / "keyframes.toml"

FLAGS = (
    "--no-sandbox",
    "--use-gl=angle",
    "--use-angle=swiftshader",
    "--enable-unsafe-swiftshader",
    "--disable-gpu-compositing",  # what is drawn without a GPU is put together sooner without it, too
    "--disable-background-networking",
    "--disable-component-update",
    "--disable-sync",
    "--no-first-run",
)
NAMES = ("chromium", "chromium-browser", "google-chrome")


# Not for the session: while Playwright is at work, nothing else in the process can run an event loop.
@pytest.fixture(scope="module")
def browser() -> Iterator[Any]:
    """Chromium without a screen, driven by Playwright."""
    playwright = pytest.importorskip("playwright.sync_api", reason="playwright is not installed")
    found = [path for path in map(shutil.which, NAMES) if path]
    if not found:
        pytest.skip(f"no browser on this machine: looked for {', '.join(NAMES)}")
    with playwright.sync_playwright() as driver:
        started = driver.chromium.launch(executable_path=found[0], args=list(FLAGS))
        yield started
        started.close()


@pytest.fixture(scope="session")
def pictures() -> Path | None:
    """Where to keep pictures of what was seen: PICTURES, if that is set."""
    folder = os.environ.get("PICTURES")
    return Path(folder).absolute() if folder else None


@pytest.fixture
def file(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A task file to be edited, in the folder that we are in."""
    monkeypatch.chdir(tmp_path)
    return Path(shutil.copy(EXAMPLE, tmp_path / "walk.toml"))


@pytest.fixture
def edit(
    browser: Any, pictures: Path | None, monkeypatch: pytest.MonkeyPatch
) -> Iterator[Callable[..., Editor]]:
    """Opens editors, as `desk.opened` does; at the end nothing is left of them."""
    viser = pytest.importorskip("viser", reason="viser is not installed")
    if pictures is None:  # half the time that it takes to open a window without a GPU goes into its light
        monkeypatch.setattr(viser.SceneApi, "configure_environment_map", lambda *_, **__: None)
    from editor.browser.desk import is_free, opened, wait_until

    editors: list[Editor] = []
    with ExitStack() as stack:

        def start(*given: Any, **named: Any) -> Editor:
            editors.append(stack.enter_context(opened(*given, **named)))
            return editors[-1]

        yield start
    ports = [urlsplit(editor.url).port or 0 for editor in editors]
    wait_until(lambda: all(map(is_free, ports)), "nobody listens any more")
    wait_until(lambda: not _threads(), "no thread of an editor is left")


@pytest.fixture
def look(browser: Any, edit: object, pictures: Path | None) -> Iterator[Callable[..., Window]]:
    """Opens windows of an editor, closed at the end; the browser must have had nothing to complain of."""
    from editor.browser.window import Window

    windows: list[Window] = []

    def open_window(editor: Editor, **named: Any) -> Window:
        windows.append(Window(browser, editor.url, editor.page.view, pictures, **named))
        return windows[-1]

    yield open_window
    for window in windows:
        window.close()
    assert [window.complaints for window in windows if window.complaints] == []


def _threads() -> list[str]:
    return [each.name for each in threading.enumerate() if each.name.startswith("pinposture")]
