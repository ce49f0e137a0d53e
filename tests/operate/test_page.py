"""The page of an operation: who is let in, what ends control, and what is shown."""

from __future__ import annotations

import http.client
import json
from collections.abc import Iterator
from typing import Any

import numpy as np
import pytest

pytest.importorskip("viser", reason="viser is not installed")

from editor.browser.desk import free_port
from editor.page_client import until, visiting
from websockets.exceptions import ConnectionClosed, InvalidStatus
from websockets.sync.client import ClientConnection, connect

import pinposture as pp
from pinposture.collision.mapping import SEEN
from pinposture.operate import Control, LivePage, Operation, SimulatedArm
from pinposture.operate.page import bars_html, margins_of, status_html
from pinposture.ros2.driver import usual_limits
from pinposture.sim import DepthCamera

HELD = {"do": "hold", "ahead": -1.0, "left": 0.0, "up": 0.0, "override": 1.0}


def an_operation(arm: pp.Arm | None = None) -> Operation:
    arm = pp.Arm.from_template("RyRz", modules=4) if arm is None else arm
    return Operation(arm, usual_limits(arm, 0.02), Control())


@pytest.fixture(scope="module")
def page() -> Iterator[tuple[LivePage, Operation]]:
    operation = an_operation()
    made = LivePage(operation, port=free_port())
    made.start()
    yield made, operation
    made.close()


def joined(url: str, **named: Any) -> ClientConnection:
    return connect(f"{url.replace('http', 'ws', 1)}/control", **named)


def asked(socket: ClientConnection, message: object) -> dict[str, Any]:
    socket.send(json.dumps({"do": message} if isinstance(message, str) else message))
    return dict(json.loads(socket.recv(timeout=20)))


def test_what_a_page_holds_ends_with_it(page: tuple[LivePage, Operation]) -> None:
    control = page[1].control
    with joined(page[0].url) as first, joined(page[0].url) as second:
        assert asked(first, "ask")["control"] == "yours"
        asked(first, "release")
        assert asked(first, HELD)["held"]
        told = asked(second, "ask")
        assert (told["control"], told["held"]) == ("taken", False)
        assert told["state"].startswith("The arm holds")
        assert asked(first, HELD)["asked"]
        first.close()
        until(lambda: asked(second, "release")["control"] == "yours", "the page that asked has control")
    until(lambda: control.reason == "no page has control", "nobody has control")


def test_a_page_that_sends_something_else_is_thrown_out(page: tuple[LivePage, Operation]) -> None:
    with joined(page[0].url) as socket:
        asked(socket, "ask")
        asked(socket, "release")
        assert asked(socket, HELD)["held"]
        socket.send('{"do": "hold", "ahead": NaN}')
        with pytest.raises(ConnectionClosed) as closed:
            socket.recv(timeout=20)
        assert closed.value.rcvd is not None
        assert closed.value.rcvd.code == 1008
    until(lambda: page[1].control.reason == "no page has control", "nobody has control")


def test_only_pages_of_this_address_are_let_in(page: tuple[LivePage, Operation]) -> None:
    url = page[0].url
    for other, named in (
        (url[:-1] + ("x" if url[-1] != "x" else "y"), {}),
        (url, {"origin": "http://evil.example"}),
    ):
        with pytest.raises(InvalidStatus) as refused:
            joined(other, **named)
        assert refused.value.response.status_code == 403
    port = int(url.split(":")[2].split("/")[0])
    secret = url.rsplit("/", 1)[1]
    for path, status in ((f"/{secret}/controls", 200), ("/controls", 403)):
        caller = http.client.HTTPConnection("127.0.0.1", port, timeout=20)
        caller.request("GET", path)
        answer = caller.getresponse()
        text = answer.read().decode()
        assert (answer.status, 'id="root"' in text, "WebSocket" in text) == (status, False, status == 200)
        if status == 200:
            assert answer.headers["X-Frame-Options"] == "DENY"
            assert answer.headers.get_all("Content-Type") == ["text/html; charset=utf-8"]
            assert "__" not in text
        caller.close()


def test_the_page_says_what_the_arm_does_and_what_is_left(page: tuple[LivePage, Operation]) -> None:
    live, operation = page
    arm = operation.arm
    tracker = pp.Tracker(arm, limits=usual_limits(arm, 0.02))
    operation.lead(tracker, arm.neutral(), pp.Scene({"<b>": pp.Sphere((0.1, 0.1, 0.0), 0.03)}), 0.02)
    with visiting(live.url) as client:
        until(lambda: any("The arm holds" in text for text in client.shown("content")))
        until(lambda: any("joint limits" in text for text in client.shown("content")))
        assert not any("<b>:" in text for text in client.shown("content"))


def test_margins_are_those_of_the_nearest_limit_and_obstacle() -> None:
    arm = pp.Arm.from_template("RyRz", modules=4)
    q = arm.neutral()
    q[3] = 0.75 * arm.limits.upper[3]
    scene = pp.Scene({"ball": pp.Sphere((0.1, 0.5, 0.0), 0.03)}, margin=0.01, self_collision=False)
    limits, clearance = margins_of(arm, q, scene)[:2]
    assert limits.share == pytest.approx(0.25)
    assert arm.joint_names[3] in limits.text
    assert clearance.share == 1.0
    shown = bars_html([clearance._replace(text="<i>")])
    assert "&lt;i&gt;" in shown
    old = status_html(an_operation(arm), an_operation(arm).shown, 2.0)
    assert "The last cycle was 2.0 s ago" in old


@pytest.mark.long
def test_a_simulated_arm_moves_while_it_is_told_and_maps_what_it_sees() -> None:
    pytest.importorskip("mujoco", reason="MuJoCo is not installed")
    arm = pp.Arm.from_template("RyRz", modules=4)
    operation = an_operation(arm)
    now = [0.0]
    operation._clock = lambda: now[0]
    wall = pp.Scene({"wall": pp.Box((0.24, 0.0, 0.0), (0.02, 0.4, 0.4))}, margin=0.005)
    q0 = pp.arm.smooth_configuration(arm, np.random.default_rng(1), 0.3)
    limits = usual_limits(arm, 0.02)
    simulated = SimulatedArm(arm, operation, limits, wall, camera=DepthCamera(), q0=q0)
    control = operation.control
    tip = arm.at(q0).points[-1]
    for message in ('{"do": "ask"}', '{"do": "release"}'):
        control.take("page", message, 0.0)
    begun = simulated.plant.positions
    for _ in range(25):
        now[0] += 0.02
        assert simulated.cycle()
    held = simulated.plant.positions
    assert np.abs(held - begun).max() < 0.02  # it sags a little, and is commanded nothing
    assert operation.shown.commanded is None
    for _ in range(50):
        now[0] += 0.02
        control.take("page", json.dumps(HELD), now[0])
        assert simulated.cycle()
    q = arm.configuration(arm.drives.joint_positions(simulated.plant.positions))
    moved = arm.at(q).points[-1] - tip
    assert moved[0] == pytest.approx(-0.05 * arm.length, abs=0.02 * arm.length)
    until(lambda: len(simulated._map.cells.points) > 20, "the wall is seen")
    simulated.cycle()
    cells = simulated.scene.obstacles[SEEN].points
    simulated.close()
    assert simulated.picture is not None
    seen = simulated.picture[np.isfinite(simulated.picture)]
    assert len(seen) > 20 and seen.min() == pytest.approx(0.23 - moved[0] - tip[0], abs=0.1)
    assert np.all(np.abs(cells[:, 0] - 0.23) < 0.01)


def on_a_robot() -> tuple[pp.CarrierFeed, pp.Arm]:
    axes = ("z", "y", "y", "x", "y", "x")
    joints = [pp.JointSpec(axis, lower=-3.0, upper=3.0, velocity=1.5) for axis in axes]
    robot = pp.Arm.from_modules([pp.ModuleTemplate("Robot", joints, [0.3, 0.4, 0.4, 0.1, 0.1, 0.1])])
    feed = pp.CarrierFeed(robot, np.array([0.0, -1.0, 2.0, 0.0, -1.0, 0.0]), 0.3, (1.0, 0.0, 0.0))
    slide = pp.ModuleTemplate("Feed", joints=(feed.joint,), link_lengths=(0.05,))
    modules = [slide, *[pp.template("RyRz")] * 4]
    return feed, pp.Arm.from_modules(modules, base_placement=feed.base_placement)


@pytest.mark.long
def test_the_feed_stands_where_the_robot_that_carries_the_arm_would_come_too_close() -> None:
    pytest.importorskip("mujoco", reason="MuJoCo is not installed")
    feed, arm = on_a_robot()
    limits = feed.limits(arm, usual_limits(arm, 0.02))
    scene = pp.Scene({"ball": pp.Sphere((0.70, 0.0, 0.26), 0.05)}, margin=0.01)
    beside = pp.CollisionModel(feed.carrier, pp.Scene(scene.obstacles, self_collision=False))
    at = np.linspace(0.0, 0.3, 3001)
    distances = np.array([beside.minimum(q).distance for q in feed.at(at)])
    free = at[np.argmax(distances < 0.01)]
    reached = []
    for robot in (None, feed):
        now = [0.0]
        operation = Operation(arm, limits, Control(), 0.1, clock=lambda now=now: now[0])
        simulated = SimulatedArm(arm, operation, limits, scene, feed=robot)
        for message in ('{"do": "ask"}', '{"do": "release"}'):
            operation.control.take("page", message, 0.0)
        commanded = []
        for _ in range(240):
            now[0] += 0.02
            operation.control.take("page", json.dumps(HELD | {"ahead": 1.0}), now[0])
            assert simulated.cycle()
            if operation.shown.commanded is not None:
                commanded.append(operation.shown.commanded[0])
        simulated.close()
        reached.append(max(commanded))
    assert reached[0] == pytest.approx(0.3, abs=1e-3)
    assert free - 0.01 < reached[1] < free + 0.002  # drives lag, as beside obstacles of the arm
    assert np.interp(reached[1], at, distances) > 0.0095


def test_the_page_shows_the_robot_where_the_feed_is() -> None:
    feed, arm = on_a_robot()
    operation = an_operation(arm)
    live = LivePage(operation, port=free_port(), feed=feed)
    q = arm.straight()
    q[0] = 0.2
    operation.shown = operation.shown._replace(measured=q)
    live.start()
    with visiting(live.url) as client:
        until(lambda: any("of the robot" in text for text in client.shown("content")))
    np.testing.assert_allclose(live._robot.q, feed.at(0.2), atol=1e-12)
    live.close()
