"""A window of the editor in a browser: where things are in it, and hands that drag, press and type."""

from __future__ import annotations

import io
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
from editor.browser.desk import PATIENCE, wait_until
from PIL import Image

from pinposture.editor.ui.files import TOUR_SEEN_KEY
from pinposture.editor.ui.page import Viewpoint

SIZE = {"width": 1280, "height": 720}
COARSE = 0.4
"""How finely is drawn what nobody keeps, relative to pixels: drawing without a screen takes long."""

UNDRAWN = """
for (const name of ["drawArrays", "drawArraysInstanced", "drawElements", "drawElementsInstanced"])
    WebGL2RenderingContext.prototype[name] = () => {};
"""
"""Keeps the picture empty: without a GPU, drawing it takes most of the time.

Shaders are compiled all the same, and the page finds what the mouse is over.
"""

CANVAS = "canvas[data-engine]"

CLOSE = 'document.querySelectorAll(".mantine-Notification-closeButton").forEach((each) => each.click())'
"""Closes what viser says of machines that draw without a GPU."""

LARGEST = 250_000
"""More than a picture may have [bytes]."""

WATCH = """
const look = (event) => {
    if (!["Shift", "Control", "Alt", "Meta"].includes(event.key))
        setTimeout(() => { window.taken = event.defaultPrevented; });
};
window.addEventListener("keydown", look, true);
"""
"""Keeps whether the page took the last key, so that the browser did nothing of its own with it.

A modifier held with the key sends an event of its own, which the page never takes.
"""


class Window:
    """A page of the editor, as large as a small screen.

    Args:
        browser: the browser.
        url: where the editor is.
        view: its initial camera.
        pictures: where to keep pictures; None if nobody wants any.
        toured: whether this is not the first visit.
        drawn: whether somebody looks at the picture of the arm; it is drawn if pictures are kept, too.
    """

    def __init__(
        self,
        browser: Any,
        url: str,
        view: Viewpoint,
        pictures: Path | None,
        toured: bool = True,
        drawn: bool = False,
    ) -> None:
        self._drawn = drawn or pictures is not None
        self._view = view
        self._pictures = pictures
        self._context = browser.new_context(viewport=SIZE)
        self._context.set_default_timeout(1000.0 * PATIENCE)
        if toured:
            self._context.add_init_script(f"window.localStorage.setItem('viser-user:{TOUR_SEEN_KEY}', 'yes')")
        self._context.add_init_script(WATCH)
        if not self._drawn:
            self._context.add_init_script(UNDRAWN)
        self.page = self._context.new_page()
        self._mouse = (0.0, 0.0)
        self._held = False
        self.complaints: list[str] = []
        self.page.on("pageerror", lambda error: self.complaints.append(str(error)))
        self.page.goto(f"{url}/?fixedDpr={COARSE}" if pictures is None else url)
        self.page.wait_for_selector(CANVAS)
        self.page.wait_for_selector("#status")

    def at(self, point: Any) -> tuple[float, float]:
        """Where a place of the world is in the window [pixels], while nobody has moved the camera."""
        view = self._view
        box = self.page.locator(CANVAS).bounding_box()
        ahead = view.look_at - view.position
        ahead /= np.linalg.norm(ahead)
        right = np.cross(ahead, [0.0, 0.0, 1.0])
        right /= np.linalg.norm(right)
        away = np.asarray(point) - view.position
        scale = 0.5 * box["height"] / np.tan(view.opening / 2.0) / (away @ ahead)
        x = box["x"] + box["width"] / 2.0 + scale * (away @ right)
        y = box["y"] + box["height"] / 2.0 - scale * (away @ np.cross(right, ahead))
        return float(x), float(y)

    def hover(self, point: Any) -> tuple[float, float]:
        """Point at a place of the world, until the page shows that something there can be taken hold of."""
        x, y = self.at(point)
        near = iter(range(10_000))

        def found() -> bool:
            self.page.mouse.move(x + next(near) % 2, y)
            shape = self.page.evaluate(f"document.querySelector('{CANVAS}').style.cursor")
            return shape not in ("", "auto", "default")

        wait_until(found, "there is something to be taken hold of")
        return x, y

    def grab(self, point: Any) -> tuple[float, float]:
        """Press the mouse button on what is at a place of the world."""
        x, y = self.hover(point)
        self.page.mouse.down()
        self._held = True
        return x, y

    def drag(self, point: Any, to: Any, look: Callable[[], object] = lambda: None, steps: int = 8) -> None:
        """Drag what is at a place of the world in a straight line, without letting go.

        Args:
            point: the place.
            to: the place where it then is, as it is seen in the window.
            look: called after each step.
            steps: how many moves of the mouse it takes.
        """
        x, y = self.grab(point)
        dx, dy = np.subtract(self.at(to), (x, y))
        for k in range(1, steps + 1):
            self._move(x + dx * k / steps, y + dy * k / steps)
            look()

    def drag_on(self, dx: float, dy: float, look: Callable[[], object] = lambda: None) -> None:
        """Drag what is held a little further [share of the window's width and height]."""
        x, y = self._mouse
        self._move(x + dx * SIZE["width"], y + dy * SIZE["height"])
        look()

    def drop(self) -> None:
        """Let go."""
        self.page.mouse.up()
        self._held = False

    def aside(self) -> None:
        """Click beside everything: what was typed into has the keyboard no more."""
        self.page.mouse.click(20.0, 20.0)

    def key(self, name: str) -> bool:
        """Press a key; tells whether the page took it, so that the browser did not."""
        self.page.evaluate("window.taken = undefined")
        self.page.keyboard.press(name)
        self.page.wait_for_function("window.taken !== undefined")
        return bool(self.page.evaluate("window.taken"))

    def tab(self, name: str) -> None:
        """Turn to a tab."""
        self.page.get_by_role("tab", name=name, exact=True).click()

    def press(self, name: str) -> None:
        """Press the button of a name that is in sight."""
        self.page.get_by_role("button", name=name, exact=True).click()

    def field(self, label: str, number: int = 0) -> Any:
        """A field in sight, by what stands before it; the first, or another of several."""
        row = self.page.locator("label:visible").get_by_text(label, exact=True)
        return row.locator("xpath=ancestor::div[.//input][1]//input").nth(number)

    def middle(self, selector: str) -> tuple[float, float]:
        """The middle of something in the page [pixels], once it is there; it may be drawn anew."""
        box = wait_until(lambda: self.page.locator(selector).bounding_box(), f"there is {selector}")
        return box["x"] + 0.5 * box["width"], box["y"] + 0.5 * box["height"]

    @property
    def notice(self) -> str:
        """What was last said; empty if nothing was."""
        found = self.page.locator("#notice")
        return str(found.inner_text()) if found.count() else ""

    @property
    def status(self) -> str:
        """How the arm is doing."""
        return str(self.page.locator("#status").inner_text())

    def says(self, words: str) -> str:
        """Wait until something is said; gives all of it."""
        return str(wait_until(lambda: words in (said := self.notice) and said, f"it says: {words}"))

    def shade(self, color: str) -> int:
        """How many pixels of a picture that is drawn have about a colour, such as "#D55E00"."""
        assert self._drawn
        box = self.page.locator(CANVAS).bounding_box()
        seen = np.asarray(Image.open(io.BytesIO(self.page.screenshot(clip=box))).convert("RGB"), dtype=int)
        wanted = np.array([int(color[k : k + 2], 16) for k in (1, 3, 5)])
        return int(np.count_nonzero(np.abs(seen - wanted).max(axis=2) < 40))

    def picture(self, name: str) -> None:
        """Keep a picture, if pictures are wanted."""
        if self._pictures is None:
            return
        self._pictures.mkdir(parents=True, exist_ok=True)
        self.page.evaluate(CLOSE)
        if not self._held:
            self.page.mouse.move(20.0, 20.0)  # no hint is in the way
        self.page.wait_for_timeout(1500)
        kept = self._pictures / f"{name}.png"
        seen = Image.open(io.BytesIO(self.page.screenshot())).convert("RGB")
        # Together these keep the colours of small things, and of large ones.
        reduced = seen.quantize(256, Image.Quantize.MAXCOVERAGE, kmeans=2, dither=Image.Dither.NONE)
        reduced.save(kept, optimize=True)
        assert kept.stat().st_size < LARGEST

    def _move(self, x: float, y: float) -> None:
        self._mouse = x, y
        self.page.mouse.move(x, y)

    def close(self) -> None:
        """Leave."""
        self._context.close()
