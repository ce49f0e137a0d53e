"""The page: the measured arm, the commanded one as a ghost, what is seen around it, and margins."""

from __future__ import annotations

import contextlib
import io
import json
import logging
import time
from collections.abc import Iterable
from functools import partial
from html import escape
from importlib.resources import files
from threading import Event, Thread
from typing import Any, NamedTuple

import numpy as np
import viser
from numpy.typing import NDArray

from pinposture.arm import Arm
from pinposture.collision import CollisionModel, Scene
from pinposture.collision.model import describe_distance
from pinposture.collision.scan import Cells
from pinposture.control.reach import room_to_limits
from pinposture.editor.ui.arm import ArmDrawing
from pinposture.editor.ui.page import (
    IN_SIGHT,
    PAGE,
    STATUS_COLORS,
    Viewpoint,
    camera_direction,
    framing,
    set_stage,
)
from pinposture.editor.ui.parts import Drag, add_lines, color, framed_html, on_click, put, put_at
from pinposture.editor.ui.server import Channel, serve
from pinposture.errors import NoEquilibrium
from pinposture.operate.control import CONTROL
from pinposture.operate.operation import Operation, Shown
from pinposture.operate.record import Replay
from pinposture.operate.simulated import SimulatedArm
from pinposture.operate.ways import WAYS, CurveAlong
from pinposture.task.carrier_feed import CarrierClearance, CarrierFeed
from pinposture.units import length_text
from pinposture.viz.drawing import link_radius, shown_obstacles
from pinposture.viz.palette import THEME

Array = NDArray[np.float64]
logger = logging.getLogger(__name__)


class PageSettings(NamedTuple):
    """How the page looks, and how often it changes."""

    period: float = 0.05
    """Time between two updates of the page [s]. Browsers without a GPU draw less often than that."""

    facts_period: float = 0.2
    """Time for which numbers stay, so that they can be read [s]."""

    ghost: float = 0.35
    """Opacity of the commanded arm."""

    ample: float = 0.05
    """Clearance at which its bar is full, in arm lengths."""

    low: float = 0.15
    """Share of a bar below which it is amber."""

    old: float = 0.5
    """Age from which on the last cycle is called old [s]."""

    pixel: int = 4
    """Width of a pixel of the camera, in those of the page."""

    covered: float = 0.25
    """Share of the picture, from below, that the controls cover."""

    handle: float = 1.6
    """Radius of control points, relative to that of the bars of the arm: they are to be taken hold of."""


LIVE_PAGE = PageSettings()


class Margin(NamedTuple):
    """What is left before something stops the arm.

    Attributes:
        name: of what.
        share: how much of it is left, in [0, 1].
        text: in words.
    """

    name: str
    share: float
    text: str


def margins_of(arm: Arm, q: Array, scene: Scene, beside: CarrierClearance | None = None) -> list[Margin]:
    """Return the margins of an arm at a configuration (nq,) in a scene: joint limits, clearance, torques.

    The clearance of the robot that carries it is told as well, if it is given as `beside`.
    """
    margins = []
    turning = arm.columns[~arm.slides[arm.columns]]
    if len(turning):
        room = np.clip(room_to_limits(arm, q)[turning], 0.0, 1.0)
        joint = int(room.argmin())
        text = f"{arm.joint_names[turning[joint]]} has {100.0 * room[joint]:.0f} % of its half range left"
        margins.append(Margin("joint limits", float(room[joint]), text))
    nearest = {"clearance": CollisionModel(arm, scene).minimum(q)}
    if beside is not None:
        nearest["robot"] = beside.closest(q)
    for name, closest in nearest.items():
        if closest.pair is not None:
            share = (closest.distance - scene.margin) / (LIVE_PAGE.ample * arm.length)
            text = f"{describe_distance(closest.pair, closest.distance)}, margin {length_text(scene.margin)}"
            margins.append(Margin(name, min(max(share, 0.0), 1.0), text))
    load = arm.at(q).most_loaded()
    if load is not None:
        margins.append(Margin("torque", max(0.0, 1.0 - load.share), str(load)))
    return margins


def bars_html(margins: Iterable[Margin]) -> str:
    """Return margins as bars, as HTML."""
    rows = []
    for margin in margins:
        kind = "error" if margin.share <= 0.0 else "warning" if margin.share < LIVE_PAGE.low else "good"
        bar = (
            f"width:{100.0 * margin.share:.0f}%;height:8px;border-radius:3px;background:{STATUS_COLORS[kind]}"
        )
        rows.append(
            f"<b>{margin.name}</b>: {escape(margin.text)}"
            f'<div style="background:{THEME.faint};border-radius:3px;margin:2px 0 7px 0">'
            f'<div style="{bar}"></div></div>'
        )
    style = "font-size:12px;line-height:1.4;padding:2px 10px"
    return f'<div id="margins" style="{style}">{"".join(rows)}</div>'


def status_html(operation: Operation | Replay, shown: Shown, age: float) -> str:
    """Return what an operation does and why, given the age of its last cycle [s], as HTML."""
    kind = {"holds": "info", "runs": "good"}.get(shown.mode, "warning")
    head = f"The arm {shown.mode}"
    reason = shown.reason
    if age > LIVE_PAGE.old:
        kind = "error"
        head = f"The last cycle was {age:.1f} s ago"
        reason = "what you see is old"
    elif reason and shown.mode == "runs":
        kind = "warning"
    text = f'<div id="always" style="min-height:78px">{IN_SIGHT}'
    about = "" if not operation.kind else f"<span>{escape(operation.kind)}</span>"
    below = f'<div style="margin-top:4px;color:{THEME.quiet}">{about}</div>'
    return text + framed_html("status", STATUS_COLORS[kind], escape(head), escape(reason), below) + "</div>"


def viewpoint(arm: Arm, direction: Array, feed: CarrierFeed | None = None) -> Viewpoint:
    """Return a camera that has an arm in sight, neutral, straight, and straight at both ends of its feed.

    Args:
        arm: the arm.
        direction: from the arm to the camera, (3,).
        feed: the robot that carries the arm, which is in sight as well; None: none does.
    """
    postures = [arm.neutral(), arm.straight()]
    column = int(arm.chain.columns[0])
    if arm.slides[column]:
        for limit in (arm.limits.lower[column], arm.limits.upper[column]):
            positions = arm.positions(arm.straight())
            if np.isfinite(limit):
                positions[column] = limit
            postures.append(arm.configuration(positions))
    points = np.vstack([arm.chain.base, *(arm.at(q).points for q in postures)])
    if feed is not None:
        robot = feed.carrier
        points = np.vstack([points, robot.chain.base, *(robot.at(q).points for q in feed.configurations)])
    return framing(points, 0.1 * arm.length, direction, PAGE.least_aspect, LIVE_PAGE.covered)


class CurveHandles:
    """The control points of the curve along the arm, which are dragged; where the arm goes is a ghost."""

    def __init__(self, server: viser.ViserServer, operation: Operation | Replay) -> None:
        self._server = server
        self._operation = operation
        self._led: Array | None = None
        self._curve: CurveAlong | None = None
        self._balls: list[Any] = []
        self._drags: list[Drag] = []
        self._lines = add_lines(server, "/curve", WAYS.handles - 1, 0.25 * link_radius(operation.arm))

    def show(self, shown: Shown) -> None:
        """Bring them up to date: they follow the arm, unless one of them is dragged or its way is shown."""
        led = shown.led
        if led is None or led is self._led or any(drag.held for drag in self._drags):
            return
        self._led = led
        self._curve = CurveAlong.of(self._operation.arm, led)
        self._place(self._curve)

    def _place(self, curve: CurveAlong) -> None:
        """Put them where the control points are."""
        if not self._balls:
            self._make()
        for ball, point in zip(self._balls, curve.points[1:], strict=True):
            put_at(ball, point)
        self._draw(curve)

    def _make(self) -> None:
        radius = LIVE_PAGE.handle * link_radius(self._operation.arm)
        for number in range(1, WAYS.handles):
            name = f"/handles/{number}"
            ball = self._server.scene.add_icosphere(name, radius, color(THEME.active), cast_shadow=False)
            self._balls.append(ball)
            self._drags.append(Drag(self._do, ball, partial(self._ask, number), moves=True))

    def _ask(self, number: int, drag: Drag) -> Any:
        return partial(self._move, number, drag.position)

    def _do(self, request: Any, _: str) -> None:
        request()

    def _move(self, number: int, position: Array) -> None:
        """Move a control point to a position, (3,) [m], and have the way planned."""
        if self._curve is None:
            return
        points = self._curve.points.copy()
        points[number] = position
        self._curve = self._curve._replace(points=points)
        self._draw(self._curve)
        self._operation.reshape(self._curve)

    def _draw(self, curve: CurveAlong) -> None:
        self._lines.points = np.stack([curve.points[:-1], curve.points[1:]], axis=1).astype(np.float32)
        self._lines.colors = np.full((WAYS.handles - 1, 2, 3), color(THEME.active), dtype=np.uint8)


class SceneDrawing:
    """What the arm keeps clear of: known obstacles, and the cells of a map as points, with their age."""

    def __init__(self, server: viser.ViserServer, arm: Arm) -> None:
        self._server = server
        self._arm = arm
        self._known: tuple[object, ...] = ()
        self._cells: Cells | None = None
        self._changed = 0.0
        self._drawn: list[Any] = []
        self._points: Any = None
        self.about = ""

    def show(self, scene: Scene, now: float) -> None:
        """Bring it up to date at a time [s]."""
        maps = [obstacle for obstacle in scene.obstacles.values() if isinstance(obstacle, Cells)]
        known = {
            name: obstacle for name, obstacle in scene.obstacles.items() if not isinstance(obstacle, Cells)
        }
        if tuple(known.values()) != self._known:
            self._known = tuple(known.values())
            self._draw(scene.with_obstacles(known))
        if not maps:
            return
        if maps[0] is not self._cells:
            self._cells = maps[0]
            self._changed = now
            self._draw_cells(maps[0])
        self.about = f"map: {len(maps[0].points)} cells on surfaces, {now - self._changed:.1f} s old"

    def _draw(self, scene: Scene) -> None:
        for handle in self._drawn:
            handle.remove()
        reach = self._arm.chain.base + 1.2 * self._arm.length * np.vstack([np.eye(3), -np.eye(3)])
        self._drawn = [
            self._server.scene.add_mesh_simple(
                f"/obstacles/{number}",
                obstacle.surface.vertices,
                obstacle.surface.faces,
                color=color(THEME.obstacle),
                opacity=THEME.see_through,
                side="double",
                cast_shadow=False,
                receive_shadow=False,
            )
            for number, obstacle in enumerate(shown_obstacles(scene, reach))
        ]

    def _draw_cells(self, cells: Cells) -> None:
        if self._points is not None:
            self._points.remove()
        size = 2.0 / np.sqrt(3.0) * cells.point_radius  # edge of a cell
        self._points = self._server.scene.add_point_cloud(
            "/map",
            cells.points.astype(np.float32),
            color(THEME.obstacle),
            point_size=float(size),
            point_shape="square",
            precision="float32",
        )


class TipLine:
    """A line of the tip."""

    def __init__(self, server: viser.ViserServer, name: str, shade: str, thickness: float) -> None:
        self._lines = add_lines(server, name, 1, thickness)
        self._shade = shade
        self._drawn = np.zeros((0, 3))

    def show(self, line: Array) -> None:
        """Draw it through points, (n, 3) [m]; nothing if there are fewer than two."""
        if line is self._drawn:
            return
        self._drawn = line
        put(self._lines, visible=len(line) > 1)
        if len(line) > 1:
            pieces = np.stack([line[:-1], line[1:]], axis=1).astype(np.float32)
            self._lines.points = pieces
            self._lines.colors = np.full(pieces.shape, color(self._shade), dtype=np.uint8)


class LivePage:
    """What browsers show of an operation, all of them the same; one of them has control.

    Attributes:
        url: where a browser on this machine finds it; anyone who has it can ask for control.
        view: the camera of a browser that nobody has turned.

    Args:
        operation: the operation, or a recording of one.
        host: the address to listen at.
        port: the port; another if it is taken.
        simulated: the arm if it is simulated: its camera is shown, and its joints can be made to fail; else
            None.
        feed: the robot that carries the arm, which is shown where the feed is; None: none does.

    Raises:
        ViewerError: it cannot be served.
    """

    def __init__(
        self,
        operation: Operation | Replay,
        host: str = "127.0.0.1",
        port: int = 8080,
        simulated: SimulatedArm | None = None,
        feed: CarrierFeed | None = None,
    ) -> None:
        self._operation = operation
        self._arm = arm = operation.arm
        control = operation.control

        def answer(name: str, message: str | bytes) -> str:
            reply = control.take(name, message, time.monotonic())
            shown = operation.shown
            why = f": {shown.reason}" if shown.reason else ""
            plan = {"way": shown.planned.number, "plan": shown.planned.text}
            return json.dumps(reply | plan | {"state": f"The arm {shown.mode}{why}"})

        head = files("pinposture.operate").joinpath("controls.html").read_text(encoding="utf-8")
        # Where the page tells what is held, and where the controls are alone, behind the secret.
        path = "/control"
        alone = "/controls"
        words = {
            "PERIOD": f"{1e3 * CONTROL.period:.0f}",
            "PATH": path,
            "ALONE": alone,
            "DOCK": str(PAGE.controls_width),
        }
        for word, value in words.items():
            head = head.replace(f"__{word}__", value)
        self._server, self.url = serve(
            host, port, "operate", Channel(path, head, alone, answer, control.leave)
        )
        server = self._server
        server.gui.configure_theme(
            show_logo=False, show_share_button=False, brand_color=color(THEME.start), dark_mode=False
        )
        server.gui.set_panel_label("pinposture")
        server.gui.main_panel.dock_right()
        server.gui.main_panel.set_width(PAGE.controls_width)
        self.view = viewpoint(arm, camera_direction(arm), feed)
        set_stage(server, arm, self.view)
        self._status = server.gui.add_html("")
        self._bars = server.gui.add_html("")
        self._about = server.gui.add_html("")
        self._simulated = simulated
        self._picture: Array | None = None
        self._image: Any = None
        if simulated is not None:
            self._add_failures(simulated)
        self._beside = None if feed is None else CarrierClearance(feed, arm)
        self._robot = None if feed is None else ArmDrawing(server, feed.carrier, "/robot", tint=THEME.base)
        self._measured = ArmDrawing(server, arm)
        self._ghost = ArmDrawing(server, arm, "/commanded", LIVE_PAGE.ghost, THEME.start)
        self._ghost.set_visible(False)
        self._sagged = ArmDrawing(server, arm, "/sagged", LIVE_PAGE.ghost, THEME.final)
        self._sagged.set_visible(False)
        self._goal = ArmDrawing(server, arm, "/goal", LIVE_PAGE.ghost, THEME.target)
        self._goal.set_visible(False)
        self._handles = CurveHandles(server, operation)
        self._scene = SceneDrawing(server, arm)
        self._line = TipLine(server, "/way", THEME.target, 0.3 * link_radius(arm))
        self._planned = TipLine(server, "/planned", THEME.final, 0.3 * link_radius(arm))
        self._facts_at = -np.inf
        self._closed = Event()
        self._thread = Thread(target=self._run, name="pinposture-page", daemon=True)

    def start(self) -> None:
        """Start to show the operation."""
        self._thread.start()

    def close(self) -> None:
        """End the thread and the server."""
        self._closed.set()
        if self._thread.is_alive():
            self._thread.join(timeout=5.0)
        with contextlib.redirect_stdout(io.StringIO()):
            self._server.stop()

    def show(self, now: float) -> None:
        """Bring it up to date at a time [s]; only changes are sent."""
        shown = self._operation.shown
        with self._server.atomic():
            if shown.measured is not None:
                self._measured.move(shown.measured)
                self._move_robot(shown.measured)
            if shown.commanded is not None:
                self._ghost.set_visible(True)
                self._ghost.move(shown.commanded)
            goal = shown.planned.goal
            self._goal.set_visible(goal is not None)
            if goal is not None:
                self._goal.move(goal)
            self._scene.show(shown.scene, now)
            self._line.show(shown.line)
            self._planned.show(shown.planned.line)
            self._handles.show(shown)
            if now - self._facts_at >= LIVE_PAGE.facts_period:
                self._facts_at = now
                self._show_facts(shown, now)
        self._server.flush()

    def _move_robot(self, measured: Array) -> None:
        """Show the robot where it carries the arm, of a measured configuration (nq,)."""
        if self._beside is not None and self._robot is not None:
            feed = self._beside.feed
            self._robot.move(feed.at(np.clip(self._arm.positions(measured)[0], 0.0, feed.stroke)))

    def _add_failures(self, simulated: SimulatedArm) -> None:
        """Add what lets joints of a simulated arm fail."""
        names = self._arm.drives.names

        def fail(kind: str) -> None:
            simulated.fail(joint.value, kind=kind)

        with self._server.gui.add_folder("Let a joint fail", expand_by_default=False):
            joint = self._server.gui.add_dropdown("joint", names, initial_value=names[len(names) // 2])
            for words, kind in (("It sticks", "stuck"), ("It goes limp", "limp"), ("It gets weak", "weak")):
                on_click(self._server.gui.add_button(words), partial(fail, kind))
            on_click(self._server.gui.add_button("All joints work"), simulated.fail)

    def _show_picture(self) -> None:
        """Show the last picture of the camera: near is dark, and what is beyond its reach light."""
        picture = None if self._simulated is None else self._simulated.picture
        if picture is None or picture is self._picture:
            return
        self._picture = picture
        seen = np.isfinite(picture)
        far = float(picture[seen].max(initial=0.0)) or 1.0
        shades = np.where(seen, 190.0 * np.where(seen, picture, 0.0) / far, 228.0).astype(np.uint8)
        image = np.repeat(shades[..., None], 3, axis=2).repeat(LIVE_PAGE.pixel, 0).repeat(LIVE_PAGE.pixel, 1)
        if self._image is None:
            self._image = self._server.gui.add_image(image, label="tip camera: near is dark", format="png")
        else:
            self._image.image = image

    def _show_sag(self, shown: Shown) -> None:
        """Show how the loaded arm hangs where it is commanded to be, if its stiffness is known."""
        if shown.commanded is None or not self._arm.sag_known:
            return
        try:
            self._sagged.move(self._arm.sag(shown.commanded))
        except NoEquilibrium:
            self._sagged.set_visible(False)
        else:
            self._sagged.set_visible(True)

    def _show_facts(self, shown: Shown, now: float) -> None:
        """Write the status, and the margins of the measured arm."""
        put(self._status, content=status_html(self._operation, shown, now - shown.time))
        if self._beside is not None:
            self._beside.scene = shown.scene
        if shown.measured is not None:
            margins = margins_of(self._arm, shown.measured, shown.scene, self._beside)
            put(self._bars, content=bars_html(margins))
        style = "font-size:12px;padding:2px 10px"
        self._show_picture()
        self._show_sag(shown)
        words = [f"way: {shown.planned.text}"]
        if shown.stuck:
            words.append(shown.stuck)
        if self._scene.about:
            words.append(self._scene.about)
        if (
            shown.report is not None
            and shown.report.tracking_error is not None
            and shown.commanded is not None
        ):
            words.append(f"drives are {shown.report.tracking_error:.2g} rad or m off")
        put(self._about, content=f'<div style="{style}">{"<br>".join(map(escape, words))}</div>')

    def _run(self) -> None:
        fault = ""
        while not self._closed.wait(LIVE_PAGE.period):
            try:
                self.show(time.monotonic())
            except Exception as error:  # a fault of the picture costs this picture, not the others
                if repr(error) != fault:
                    fault = repr(error)
                    logger.exception("the page could not be brought up to date")
