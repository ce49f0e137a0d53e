"""The film of an operator's run: the page of `pinposture operate` in a real browser, by its own controls.

`python docs/pictures.py operating` makes it. The simulated arm and its page are those of the command; only
time goes on cycle by cycle, each of them after the page has told what is held, as a browser without a GPU
takes most of a second to draw a picture.
"""

from __future__ import annotations

import io
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pinocchio as pin
from matplotlib import font_manager
from numpy.typing import NDArray
from PIL import Image, ImageDraw, ImageFont

import pinposture as pp
from pinposture.editor.ui.page import PAGE, framing
from pinposture.operate import Control, LivePage, Operation, SimulatedArm
from pinposture.operate.ways import CurveAlong
from pinposture.ros2.driver import usual_limits
from pinposture.sim import DepthCamera
from pinposture.viz.palette import THEME

Array = NDArray[np.float64]

HERE = Path(__file__).parent
SIZE = {"width": 1100, "height": 640}
CANVAS = "canvas[data-engine]"
CAPTION = 46
"""Height of the strip below a picture that says what happens [pixels]."""

DT = 0.02
"""Time of a cycle [s]."""

CYCLES = 10
"""Cycles from one picture to the next."""

PATIENCE = 90.0
"""Time for which something that has to happen is waited for [s]."""

FROM = np.array([0.35, -0.85, 0.4])
"""Direction from what is seen to the eye, which sees the space behind the wall, and the arm before it."""

SEEN = np.array([(0.1, 0.0, 0.0), (1.95, 0.15, 0.1), (1.4, -0.1, -0.1), (1.4, 0.15, 0.5)])
"""What the picture shows, (n, 3) [m]."""

COVERED = 0.27
"""Share of the picture, from below, that the controls cover."""

FAILING = "m18_j1_y"
BACK = -0.25
"""Where the base of the arm is along x [m]."""

SPEED = 0.08
"""Full speed of the tip [m/s]."""

KEYS = {"W": "w", "L": "ArrowLeft", "R": "ArrowRight", "U": "ArrowUp", "D": "ArrowDown"}
TO_THE_HOLE = (("W", 12), ("WLU", 6), ("WL", 2), ("WRD", 10), ("WR", 3), ("W", 7))
INTO_THE_HOLE = 26
"""What an operator holds who has practised, for how many pictures."""

LOOK = np.array([-0.12, 0.1, 0.3])
"""How far the end of the curve is dragged [m]."""

OUTSIDE = 1.2
"""Where the tip is out of the hole again, along x [m]."""

PLANNING = 3.0
"""Time for which plans of a drag are waited for [s]."""

MOST = 110
"""Number of pictures within which something must have happened."""

POINTER = np.array([(0, 0), (0, 17), (4, 13), (7, 19), (10, 18), (7, 12), (12, 12)])
"""The corners of the pointer of the mouse [pixels], which a browser without a screen does not draw."""


class PagedControl(Control):
    """What a page holds, at the time of the simulation.

    Attributes:
        now: that time [s].
        count: number of messages.
    """

    def __init__(self) -> None:
        super().__init__()
        self.now = 0.0
        self.count = 0

    def take(self, page: str, message: str | bytes, now: float) -> dict[str, Any]:
        """Take a message of a page, whatever time it is there."""
        reply = super().take(page, message, self.now)
        self.count += 1
        return reply


def fed_arm() -> pp.Arm:
    """The arm of `pinposture generate RyRz --modules 20 --feed 1.2`, farther from the wall."""
    slide = pp.JointSpec("x", type="prismatic", lower=0.0, upper=1.2, velocity=0.1)
    feed = pp.ModuleTemplate("Feed", joints=(slide,), link_lengths=(0.05,))
    back = pin.SE3(np.eye(3), np.array([BACK, 0.0, 0.0]))
    return pp.Arm.from_modules([feed, *[pp.template("RyRz")] * 20], base_placement=back)


class Film:
    """A simulated arm, its page in a browser, and the pictures that were taken of it.

    Attributes:
        frames: the pictures.
        caption: what to write below the next ones.

    Args:
        browser: the browser, of Playwright.
    """

    def __init__(self, browser: Any) -> None:
        self.frames: list[Image.Image] = []
        self.caption = ""
        self.arm = fed_arm()
        limits = usual_limits(self.arm, DT)
        self._control = PagedControl()
        self.operation = Operation(self.arm, limits, self._control, SPEED, clock=lambda: self._control.now)
        scene = pp.Scene.load(HERE.parent / "examples" / "hole.toml")
        self._simulated = SimulatedArm(self.arm, self.operation, limits, scene, camera=DepthCamera())
        self._simulated.cycle()
        self._live = LivePage(self.operation, simulated=self._simulated)
        self._view = framing(
            SEEN, 0.05, FROM, (SIZE["width"] - PAGE.controls_width) / SIZE["height"], COVERED
        )
        self.page = browser.new_page(viewport=SIZE)
        self.page.set_default_timeout(1e3 * PATIENCE)
        eye = ",".join(f"{x:.5f}" for x in self._view.position)
        middle = ",".join(f"{x:.5f}" for x in self._view.look_at)
        self.page.goto(f"{self._live.url}/?initialCameraPosition={eye}&initialCameraLookAt={middle}")
        self.page.wait_for_selector(CANVAS)
        self._live.show(self._control.now)
        self.page.wait_for_selector("#margins")
        self.page.wait_for_timeout(3000)  # light and floor
        close = ".mantine-Notification-closeButton"  # what viser says of machines without a GPU
        self.page.evaluate(f"document.querySelectorAll('{close}').forEach((button) => button.click())")
        self._mouse: Array | None = None
        self._held: set[str] = set()
        self._font = ImageFont.truetype(font_manager.findfont("DejaVu Sans"), 19)

    @property
    def tip(self) -> Array:
        """Where the tip is led to, and where it points to, (2, 3) [m]."""
        shown = self.operation.shown
        points = self.arm.at(shown.measured if shown.led is None else shown.led).points
        ahead = points[-1] - points[-2]
        return np.array([points[-1], ahead / np.linalg.norm(ahead)])

    def close(self) -> None:
        """End all of it."""
        self.page.close()
        self._live.close()
        self.operation.close()
        self._simulated.close()

    def run(self, cycles: int = CYCLES) -> None:
        """Let time go on."""
        for _ in range(cycles):
            if self._control.order(self._control.now) is not None:
                self._hear(1)
            self._control.now += DT
            if not self._simulated.cycle():
                raise RuntimeError(f"the simulation ended: {self._simulated.plant.failure}")

    def run_until(self, reached: Callable[[], bool], cycles: int = CYCLES) -> None:
        """Let time go on until something is so."""
        for _ in range(MOST):
            if reached():
                return
            self.run(cycles)
            self.shoot()
            if self._held and self.operation.shown.mode == "holds":  # it asks to release, and hold again
                keys = tuple(self._held)
                self.hold()
                self.hold(*keys)
        raise RuntimeError(
            f"after {MOST * cycles * DT:g} s not reached: {self.caption}; {self.operation.shown}"
        )

    def shoot(self, times: int = 1) -> None:
        """Take a picture, which is shown so many times."""
        self._live.show(self._control.now)
        self.page.evaluate(
            "new Promise((done) => setTimeout("
            "() => requestAnimationFrame(() => requestAnimationFrame(done)), 120))"
        )
        seen = Image.open(io.BytesIO(self.page.screenshot())).convert("RGB")
        frame = Image.new("RGB", (seen.width, seen.height + CAPTION), THEME.ink)
        frame.paste(seen, (0, 0))
        pen = ImageDraw.Draw(frame)
        pen.text((16, seen.height + 11), self.caption, font=self._font, fill="white")
        if self._mouse is not None:
            corners = [tuple(corner) for corner in (POINTER + self._mouse).tolist()]
            pen.polygon(corners, fill="black", outline="white")
        self.frames += [frame] * times

    def hold(self, *keys: str) -> None:
        """Hold these keys, and no others; again if what was held does not count, as an operator would."""
        for _ in range(5):
            for key in self._held - set(keys):
                self.page.keyboard.up(key)
            for key in set(keys) - self._held:
                self.page.keyboard.down(key)
            self._held = set(keys)
            self._hear(2)  # the first one may be older
            if not keys or self._control.order(self._control.now) is not None:
                return
            self.hold()
        raise RuntimeError(f"{keys} cannot be held: {self._control.reason}")

    def click(self, what: Any) -> None:
        """Click on something in the page."""
        box = what.bounding_box()
        self.click_at(np.array([box["x"] + 0.5 * box["width"], box["y"] + 0.5 * box["height"]]))

    def click_at(self, at: Array) -> None:
        """Click on a pixel, (2,)."""
        self.point(at)
        self.shoot(3)
        self.page.mouse.down()
        self.page.mouse.up()

    def point(self, at: Array) -> None:
        """Point at a pixel, (2,)."""
        self._mouse = at
        self.page.mouse.move(*at)

    def set_speed(self, share: float) -> None:
        """Press on the slider of the speed."""
        box = self.page.locator("#override").bounding_box()
        along = 8.0 + share * (box["width"] - 16.0)
        self.click_at(np.array([box["x"] + along, box["y"] + 0.5 * box["height"]]))
        self.shoot(4)

    def leave(self) -> None:
        """Take the mouse away from the page."""
        self.page.mouse.move(500.0, 5.0)
        self._mouse = None

    def drag(self, start: Array, end: Array, steps: int = 8) -> None:
        """Drag what is at a point to another, (3,) [m], and take a picture of each step."""
        first, last = self._pixel(start), self._pixel(end)
        self.point(first)
        self.page.wait_for_timeout(500)
        self.shoot(4)
        self.page.mouse.down()
        for share in np.linspace(0.0, 1.0, steps + 1)[1:]:
            self.point(first + share * (last - first))
            self.page.wait_for_timeout(100)
            self.shoot(2)
        self.page.mouse.up()
        self._mouse = None

    def _hear(self, messages: int) -> None:
        """Wait for so many messages of the page."""
        before = self._control.count
        end = time.monotonic() + PATIENCE
        while self._control.count < before + messages:
            time.sleep(0.001)
            if time.monotonic() > end:
                raise RuntimeError("the page is silent")

    def curve_point(self, number: int) -> Array:
        """Where a control point of the curve along the arm is, (3,) [m]."""
        return np.array(CurveAlong.of(self.arm, self.operation.shown.led).points[number])

    def _pixel(self, point: Array) -> Array:
        """Where a point, (3,) [m], is in the page, (2,) [pixels]."""
        box = self.page.locator(CANVAS).bounding_box()
        ahead = self._view.look_at - self._view.position
        ahead /= np.linalg.norm(ahead)
        right = np.cross(ahead, [0.0, 0.0, 1.0])
        right /= np.linalg.norm(right)
        away = point - self._view.position
        scale = 0.5 * box["height"] / np.tan(self._view.opening / 2.0) / (away @ ahead)
        seen = scale * np.array([away @ right, -(away @ np.cross(right, ahead))])
        return seen + (box["x"] + 0.5 * box["width"], box["y"] + 0.5 * box["height"])


def lead(film: Film, keys: str, pictures: int) -> None:
    """Hold keys for so many pictures."""
    film.hold(*(KEYS[letter] for letter in keys))
    for _ in range(pictures):
        film.run()
        film.shoot()


def go_in(film: Film) -> None:
    """Take control, and steer the tip through the hole, of which the arm learns by its camera."""
    film.caption = "An arm of 41 joints on a feed, simulated. It knows nothing of what is around."
    film.shoot(15)
    film.caption = "Take control. Nothing moves unless something is held."
    film.click(film.page.locator("#ask"))
    film.page.wait_for_selector("#controls.yours")
    film.shoot(8)
    film.set_speed(0.98)
    film.leave()
    film.caption = "W and arrow keys lead the tip, the body follows. Its camera maps a wall with a hole."
    for keys, pictures in TO_THE_HOLE:
        lead(film, keys, pictures)
    film.caption = "Through the hole, with a margin of 1 cm to all that was seen."
    lead(film, "W", INTO_THE_HOLE)
    film.hold()
    film.caption = "Let go, and the arm brakes and holds."
    film.run_until(lambda: film.operation.shown.mode == "holds")
    film.shoot(8)


def reshape(film: Film) -> None:
    """Drag the end of the curve along the arm, and run the way to that shape, with a stop on the way."""
    film.caption = "Drag the curve along the arm: a ghost shows where the arm would go. Nothing moves yet."
    end = film.curve_point(-1)
    film.drag(end, end + LOOK)
    film.run_until(lambda: film.operation.shown.planned.goal is not None)
    time.sleep(PLANNING)
    film.run()
    film.shoot(10)
    film.caption = "Slowly, by the slider; and hold R: the arm runs the way that is planned."
    film.set_speed(0.25)
    film.leave()
    film.hold("r")
    film.run_until(lambda: film.operation.ways.way.at > 0.3 * film.operation.ways.way.end)
    film.hold()
    film.caption = "Hold: R is let go."
    film.run_until(lambda: film.operation.shown.mode == "holds")
    film.shoot(8)


def fail(film: Film) -> None:
    """Let a joint fail on the way, and come out without it."""
    film.caption = f"R again. Meanwhile joint {FAILING} sticks, by a click in the page."
    film.click(film.page.get_by_text("Let a joint fail"))
    field = film.page.get_by_role("combobox", name="joint")
    film.click(field)
    field.fill(FAILING)
    film.shoot(4)
    film.click(film.page.get_by_role("option", name=FAILING))
    film.click(film.page.locator("#status"))  # keys are no longer typed into the field
    film.hold("r")
    film.run()
    film.shoot()
    film.click(film.page.get_by_role("button", name="It sticks"))
    film.leave()
    film.run_until(lambda: bool(film.operation.shown.stuck))
    film.caption = "The arm holds by itself, and says which joint sticks. A way out without it is looked for."
    film.hold()
    film.run_until(lambda: film.operation.arm is not film.arm)
    film.shoot(12)
    film.caption = "The way out is found. Hold R, and the arm comes out with the joint stuck."
    film.set_speed(1.0)
    film.leave()
    film.hold("r")
    film.run_until(lambda: film.tip[0, 0] < OUTSIDE, 3 * CYCLES)
    film.caption = "Out again."
    film.shoot(25)
    film.hold()


def operating(browser: Any) -> list[Image.Image]:
    """Take the film in a browser, of Playwright."""
    film = Film(browser)
    try:
        for act in (go_in, reshape, fail):
            act(film)
    finally:
        film.close()
    return film.frames
