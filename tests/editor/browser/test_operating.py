"""An operator's hands in a real browser: what is held counts, and nothing else does."""

from __future__ import annotations

import json
import time
from pathlib import Path
from typing import Any

import pytest
from editor.browser.desk import free_port, wait_until
from editor.browser.window import CANVAS, CLOSE, SIZE

import pinposture as pp
from pinposture.operate import Control, LivePage, Operation, SimulatedArm
from pinposture.ros2.driver import usual_limits
from pinposture.sim import DepthCamera

HOLE = Path(__file__).parents[3] / "examples" / "hole.toml"


def held(control: Control) -> tuple[float, ...] | None:
    order = control.order(time.monotonic())
    return None if order is None else (*order.direction.tolist(), order.override)


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
        for _ in range(20):  # a browser that stalls loses what is held until it is let go
            press()
            end = time.monotonic() + 0.5
            while held(control) != way and time.monotonic() < end:
                time.sleep(0.005)
            if held(control) == way:
                break
            let_go()
            page.mouse.up()
        else:
            pytest.fail(f"not held: {way}")
        let_go()
        wait_until(lambda: control.reason == "nothing is held", "nothing is held")
        page.mouse.up()
    context.close()
    wait_until(lambda: control.reason == "no page has control", "the page is gone")
    live.close()
    assert complaints == []


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
