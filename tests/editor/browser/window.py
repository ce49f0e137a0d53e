"""A window of the editor in a browser: where things are in it, and hands that drag them."""

from __future__ import annotations

import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

from pinposture.arm import Arm
from pinposture.editor.page.stage import outlook
from pinposture.editor.page.tour import SEEN

SIZE = {"width": 1280, "height": 720}
PATIENCE = 60.0


def wait_until(true: Callable[[], Any], what: str, patience: float = PATIENCE) -> Any:
    """Wait until something is so; fail if it takes too long."""
    end = time.monotonic() + patience
    while time.monotonic() < end:
        value = true()
        if value:
            return value
        time.sleep(0.05)
    raise AssertionError(f"after {patience:g} s not: {what}")


class Window:
    """A page of the editor, as large as a small screen."""

    def __init__(self, browser: Any, url: str, arm: Arm, pictures: Path | None, toured: bool = True) -> None:
        self._arm, self._pictures = arm, pictures
        self._context = browser.new_context(viewport=SIZE)
        if toured:
            self._context.add_init_script(f"window.localStorage.setItem('viser-user:{SEEN}', 'yes')")
        self.page = self._context.new_page()
        self.complaints: list[str] = []
        self.page.on("pageerror", lambda error: self.complaints.append(str(error)))
        self.page.goto(url)
        self.page.wait_for_selector("canvas[data-engine]")
        self.page.wait_for_selector("#status")
        time.sleep(2.0)  # the first pictures

    def at(self, point: Any) -> tuple[float, float]:
        """Where a place of the world is in the window [pixels], while nobody has moved the camera."""
        view, box = outlook(self._arm), self.page.locator("canvas[data-engine]").bounding_box()
        ahead = view.look_at - view.position
        ahead /= np.linalg.norm(ahead)
        right = np.cross(ahead, [0.0, 0.0, 1.0])
        right /= np.linalg.norm(right)
        away = np.asarray(point) - view.position
        scale = 0.5 * box["height"] / np.tan(view.opening / 2.0) / (away @ ahead)
        x = box["x"] + box["width"] / 2.0 + scale * (away @ right)
        y = box["y"] + box["height"] / 2.0 - scale * (away @ np.cross(right, ahead))
        return float(x), float(y)

    def grab(self, point: Any) -> tuple[float, float]:
        """Press the mouse button on a place of the world."""
        x, y = self.at(point)
        self.page.mouse.move(x, y)
        time.sleep(0.3)
        self.page.mouse.down()
        return x, y

    def drag(self, x: float, y: float, dx: float, dy: float, steps: int = 12) -> None:
        """Move the mouse, the button held."""
        for k in range(1, steps + 1):
            self.page.mouse.move(x + dx * k / steps, y + dy * k / steps)
            time.sleep(0.06)

    def drop(self) -> None:
        """Let go."""
        self.page.mouse.up()

    def tab(self, name: str) -> None:
        """Turn to a tab."""
        self.page.get_by_role("tab", name=name, exact=True).click()

    def press(self, name: str) -> None:
        """Press a button."""
        self.page.get_by_role("button", name=name).first.click()

    def fill(self, label: str, text: str) -> None:
        """Type into a field."""
        field = self.page.get_by_label(label).first
        field.fill(text)
        field.press("Enter")

    @property
    def notice(self) -> str:
        """What was last said; empty if nothing was."""
        found = self.page.locator("#notice")
        return found.inner_text() if found.count() else ""

    @property
    def status(self) -> str:
        """How the arm is doing."""
        return str(self.page.locator("#status").inner_text())

    def picture(self, name: str) -> None:
        """Keep a picture, if pictures are wanted."""
        if self._pictures is not None:
            self._pictures.mkdir(parents=True, exist_ok=True)
            for close in self.page.locator(".mantine-Notification-closeButton").all():
                close.click()
            time.sleep(1.0)
            self.page.screenshot(path=self._pictures / f"{name}.png")

    def close(self) -> None:
        """Leave."""
        self._context.close()
