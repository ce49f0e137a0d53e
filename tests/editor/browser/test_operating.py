"""An operator's hands in a real browser: what is held counts, and nothing else does."""

from __future__ import annotations

import json
import time
from collections.abc import Callable, Iterator
from functools import partial
from pathlib import Path
from threading import Event, Thread
from typing import Any

import numpy as np
import pytest
from editor.browser.desk import free_port, wait_until
from editor.browser.window import CANVAS, CLOSE, SIZE, Window

import pinposture as pp
from pinposture.operate import Control, LivePage, Operation, SimulatedArm
from pinposture.operate.operation import Shown
from pinposture.operate.ways import CurveAlong
from pinposture.ros2.driver import usual_limits
from pinposture.sim import DepthCamera

HOLE = Path(__file__).parents[3] / "examples" / "hole.toml"


def held(control: Control) -> tuple[float, ...] | None:
    order = control.order(time.monotonic())
    return None if order is None else (*order.direction.tolist(), order.override)


def hold_until(
    control: Control, way: tuple[float, ...], hold: Callable[[], object], let_go: Callable[[], object]
) -> None:
    """Hold something until the control has it: a browser that stalls loses it until it is let go."""
    for _ in range(20):
        hold()
        end = time.monotonic() + 0.5
        while held(control) != way and time.monotonic() < end:
            time.sleep(0.005)
        if held(control) == way:
            return
        let_go()
        wait_until(lambda: control.reason == "nothing is held", "nothing is held")
    pytest.fail(f"not held: {way}")


def test_keys_and_buttons_count_while_they_are_held(browser: Any) -> None:
    arm = pp.Arm.from_template("RyRz", modules=2)
    control = Control()
    live = LivePage(Operation(arm, usual_limits(arm, 0.02), control), port=free_port())
    context = browser.new_context(viewport=SIZE)
    page = context.new_page()
    complaints: list[str] = []
    page.on("pageerror", lambda error: complaints.append(str(error)))
    page.goto(f"{live.url}/controls")
    page.click("text=Take control")
    page.wait_for_selector("text=You have control")
    for press, let_go, way in (
        (lambda: page.keyboard.down("w"), lambda: page.keyboard.up("w"), (1.0, 0.0, 0.0, 0.5)),
        (lambda: page.keyboard.down("ArrowUp"), lambda: page.keyboard.press("Escape"), (0.0, 0.0, 1.0, 0.5)),
        (page.mouse.down, page.mouse.up, (-1.0, 0.0, 0.0, 0.5)),
        (page.mouse.down, lambda: page.evaluate("dispatchEvent(new Event('blur'))"), (-1.0, 0.0, 0.0, 0.5)),
    ):
        page.hover("[data-way=back]")

        def release(let_go: Callable[[], object] = let_go) -> None:
            let_go()
            page.mouse.up()

        hold_until(control, way, press, release)
        let_go()
        wait_until(lambda: control.reason == "nothing is held", "nothing is held")
        page.mouse.up()
    context.close()
    wait_until(lambda: control.reason == "no page has control", "the page is gone")
    live.close()
    assert complaints == []


PADS = """
window.pads = [];
navigator.getGamepads = () => window.pads;
"""
"""Devices of a page."""

GAMEPAD = "Wireless Controller (STANDARD GAMEPAD Vendor: 054c Product: 09cc)"
CAP = "3Dconnexion SpaceMouse Compact (Vendor: 256f Product: c635)"


def pad(name: str, axes: list[float], trigger: float = 0.0) -> dict[str, Any]:
    buttons = [{"pressed": False, "value": 0.0}] * 7 + [{"pressed": False, "value": trigger}]
    return {"id": name, "connected": True, "axes": axes, "buttons": buttons if "PAD" in name else buttons[:2]}


def test_sticks_count_with_the_trigger_and_the_cap_of_a_3d_mouse_alone(browser: Any) -> None:
    arm = pp.Arm.from_template("RyRz", modules=2)
    control = Control()
    live = LivePage(Operation(arm, usual_limits(arm, 0.02), control), port=free_port())
    context = browser.new_context(viewport=SIZE)
    page = context.new_page()
    page.add_init_script(PADS)
    page.goto(f"{live.url}/controls")
    page.click("text=Take control")
    page.wait_for_selector("#controls.yours")
    still = [pad(GAMEPAD, [0.1, -0.1, 0.1, 0.05], 1.0), None, pad(CAP, [0.05, 0.1, -0.1, 0.0, 0.3, 0.0])]
    for there, way in (
        ([None, pad(GAMEPAD, [0.0, -0.5, -1.0, 0.25], 1.0)], (0.5, 1.0, -0.25, 0.5)),
        ([pad(CAP, [0.25, 0.5, -1.0, 0.0, 0.0, 0.0])], (-0.5, -0.25, 1.0, 0.5)),
        (
            [pad(GAMEPAD, [0.0, -0.5, 0.0, 0.0]), pad(CAP, [-0.5, 0.0, 0.0, 0.0, 0.0, 0.0])],
            (0.0, 0.5, 0.0, 0.5),
        ),
    ):
        hold_until(
            control,
            way,
            partial(page.evaluate, "there => { window.pads = there; }", there),
            partial(page.evaluate, "() => { window.pads = []; }"),
        )
        page.evaluate("there => { window.pads = there; }", still)
        wait_until(lambda: control.reason == "nothing is held", "nothing is held")
    assert "trigger" in page.inner_text("#pad") and "cap" in page.inner_text("#pad")
    page.evaluate("() => { document.hasFocus = () => false; }")
    page.evaluate("there => { window.pads = there; }", [pad(CAP, [1.0, 1.0, 1.0, 0.0, 0.0, 0.0])])
    page.wait_for_selector("text=Hold keys")
    assert held(control) is None
    context.close()
    live.close()


SENT = """
window.sent = [];
const send = WebSocket.prototype.send;
WebSocket.prototype.send = function (message) { window.sent.push(message); return send.call(this, message); };
"""
"""Keeps what a page sends."""


def test_a_key_that_is_pressed_as_soon_as_the_page_has_control_counts(browser: Any) -> None:
    arm = pp.Arm.from_template("RyRz", modules=2)
    control = Control()
    live = LivePage(Operation(arm, usual_limits(arm, 0.02), control), port=free_port())
    context = browser.new_context(viewport=SIZE)
    page = context.new_page()
    page.add_init_script(SENT)
    page.goto(f"{live.url}/controls")
    page.click("text=Take control")
    page.wait_for_selector("#controls.yours")
    page.keyboard.down("w")
    wait_until(lambda: '"hold"' in page.evaluate("sent.at(-1)"), "it is held")
    done = [json.loads(message)["do"] for message in page.evaluate("sent")]
    asked = done.index("ask")
    assert done[asked + 1] == "release"  # else it would not count until it is released
    assert "before the page had control" not in control.reason
    context.close()
    live.close()


class Watched(Control):
    """Control that keeps when messages of pages came.

    Attributes:
        heard: when the last one came [s].
    """

    def __init__(self) -> None:
        super().__init__()
        self.heard = 0.0

    def take(self, page: str, message: str | bytes, now: float) -> dict[str, Any]:
        self.heard = now
        return super().take(page, message, now)


class Station:
    """A simulated arm that moves in real time, and its page in a browser."""

    def __init__(self, browser: Any) -> None:
        self.arm = arm = pp.Arm.from_template("RyRz", modules=6)
        limits = usual_limits(arm, 0.02)
        self.control = Watched()
        self.operation = Operation(arm, limits, self.control)
        self.cycles: list[Shown] = []
        self.operation.watch = self.cycles.append
        self._simulated = SimulatedArm(arm, self.operation, limits, q0=0.3 * np.ones(arm.nq))
        self._live = LivePage(self.operation, port=free_port(), simulated=self._simulated)
        self._live.start()
        self._stop = Event()
        self._loop = Thread(target=self._simulated.run, args=(self._stop,))
        self._loop.start()
        self.window = Window(browser, self._live.url, self._live.view, None)

    def close(self) -> None:
        self.window.close()
        self._stop.set()
        self._loop.join()
        self._live.close()
        self._simulated.close()
        self.operation.close()

    @property
    def tip(self) -> np.ndarray:
        """Where the tip is led to, (3,) [m]."""
        return np.asarray(self.arm.at(self.cycles[-1].led).points[-1])

    def hold(self, key: str) -> None:
        """Hold a key, again and again until it counts: a browser that stalls loses what is held."""
        for _ in range(20):
            self.window.page.keyboard.down(key)
            end = time.monotonic() + 0.5
            while time.monotonic() < end:
                if self.control.order(time.monotonic()) is not None and self.cycles[-1].order is not None:
                    return
                time.sleep(0.005)
            self.window.page.keyboard.up(key)
        pytest.fail(f"{key} is not held: {self.control.reason}")

    def braked_after(self, end: Callable[[], object]) -> float:
        """End what is held in some way; return how long after that the arm is braked [s]."""
        before = len(self.cycles)
        begun = time.monotonic()
        end()

        def braked() -> list[float]:
            later = [shown for shown in self.cycles[before:] if shown.time > begun]
            return [shown.time for shown in later if shown.order is None]

        wait_until(lambda: len(braked()) > 0, "nothing is held")
        return braked()[0] - begun


@pytest.fixture
def station(browser: Any) -> Iterator[Station]:
    made = Station(browser)
    yield made
    made.close()


def test_a_curve_is_dragged_and_the_arm_runs_to_it_while_r_is_held(station: Station) -> None:
    page = station.window.page
    operation = station.operation
    page.evaluate("document.querySelector('#ask').click()")
    page.wait_for_selector("#controls.yours")
    wait_until(lambda: operation.shown.led is not None, "the arm is led")
    before = station.tip
    ball = CurveAlong.of(station.arm, operation.shown.led).points[-1]
    place = ball + [-0.03, 0.0, 0.06]
    station.window.drag(ball, place)
    station.window.drop()
    wait_until(lambda: operation.shown.planned.goal is not None, "a way is planned")
    time.sleep(2.0)  # for the plan of the end of the drag
    goal = station.arm.at(operation.shown.planned.goal).points[-1]
    assert np.linalg.norm(goal - before) > 0.03
    np.testing.assert_allclose(station.tip, before, atol=1e-9)  # nothing moves yet

    times = []
    for _ in range(3):
        station.hold("r")
        wait_until(lambda: station.cycles[-1].mode != "holds", "it runs")
        time.sleep(0.2)
        times.append(station.braked_after(lambda: page.keyboard.up("r")))
        wait_until(lambda: station.cycles[-1].mode == "holds", "it holds")
    assert min(times) <= 0.1  # a busy machine takes longer now and then

    end = time.monotonic() + 60.0
    while np.linalg.norm(station.tip - goal) > 1e-3 and time.monotonic() < end:
        station.hold("r")
        time.sleep(0.5)
        page.keyboard.up("r")
    np.testing.assert_allclose(station.tip, goal, atol=1e-3)

    station.hold("b")  # and back, until the page has lost the focus
    blurred = station.braked_after(lambda: page.evaluate("dispatchEvent(new Event('blur'))"))
    page.keyboard.up("b")
    station.hold("b")
    closed = station.braked_after(page.close)
    assert min(blurred, closed) <= 0.1
    assert max(blurred, closed) <= 0.5
    assert station.window.complaints == []


def test_the_page_shows_an_arm_that_is_steered_to_a_hole_it_sees(browser: Any, pictures: Path | None) -> None:
    if pictures is None:
        pytest.skip("a picture for the documentation: PICTURES says where to keep it")
    slide = pp.JointSpec("x", type="prismatic", lower=0.0, upper=1.2, velocity=0.1)
    feed = pp.ModuleTemplate("Feed", joints=(slide,), link_lengths=(0.05,))
    arm = pp.Arm.from_modules([feed, *[pp.template("RyRz")] * 20])
    limits = usual_limits(arm, 0.02)
    now = 0.0
    control = Control()
    operation = Operation(arm, limits, control, clock=lambda: now)
    simulated = SimulatedArm(arm, operation, limits, pp.Scene.load(HOLE), camera=DepthCamera())
    for message in ("ask", "release"):
        control.take("page", json.dumps({"do": message}), now)
    for ahead, left, up, cycles in ((1, 1, 0.67, 120), (1, -1, -0.67, 120), (1, 0, 0, 120)):
        held_way = {"do": "hold", "ahead": ahead, "left": left, "up": up, "override": 1}
        for _ in range(cycles):
            now += 0.02
            control.take("page", json.dumps(held_way), now)
            assert simulated.cycle()
            time.sleep(0.001)  # for the thread of the camera
    live = LivePage(operation, port=free_port(), simulated=simulated)
    page = browser.new_page(viewport=SIZE)
    page.goto(live.url)
    page.wait_for_selector(CANVAS)
    live.show(now)
    page.wait_for_selector("#margins")
    page.evaluate(CLOSE)
    control.leave("page")
    page.evaluate("document.querySelector('#ask').click()")
    page.wait_for_selector("#controls.yours")
    page.wait_for_timeout(4000)
    page.screenshot(path=pictures / "20-operate.png")
    page.close()
    live.close()
    simulated.close()
