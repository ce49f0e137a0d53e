"""The page: the measured arm, the commanded one as a ghost, what is seen around it, and margins."""

from __future__ import annotations

import contextlib
import io
import json
import logging
import time
from collections.abc import Iterable
from html import escape
from importlib.resources import files
from threading import Event, Thread
from typing import Any, NamedTuple

import numpy as np
import viser
from numpy.typing import NDArray

from pinposture.arm import Arm
from pinposture.collision import CollisionModel, Scene
from pinposture.collision.cells import Cells
from pinposture.collision.model import describe_distance
from pinposture.control.reach import room_to_limits
from pinposture.editor.ui.arm import ArmDrawing
from pinposture.editor.ui.page import IN_SIGHT, PAGE, STATUS_COLORS, camera_direction, framing, set_stage
from pinposture.editor.ui.parts import color, framed_html, put
from pinposture.editor.ui.server import Channel, serve
from pinposture.operate.control import CONTROL
from pinposture.operate.operation import Operation, Shown
from pinposture.units import length_text
from pinposture.viz.drawing import link_radius, shown_obstacles
from pinposture.viz.palette import THEME

Array = NDArray[np.float64]
logger = logging.getLogger(__name__)

CHANNEL_PATH = "/control"
ALONE_PATH = "/controls"
"""Where the page tells what is held, and where the controls are alone, behind the secret."""


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

    covered: float = 0.3
    """Share of the picture, from below, that the controls cover."""


LIVE_PAGE = PageSettings()

MODE_KINDS = {
    "holds": "info",
    "goes to the start": "warning",
    "runs": "good",
    "stands": "warning",
    "waits": "warning",
}
"""Colours of the status, by the mode of the operation."""


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


def margins_of(arm: Arm, q: Array, scene: Scene) -> list[Margin]:
    """Return the margins of an arm at a configuration (nq,) in a scene: joint limits, clearance, torques."""
    found = []
    turning = arm.columns[~arm.slides[arm.columns]]
    if len(turning):
        room = np.clip(room_to_limits(arm, q)[turning], 0.0, 1.0)
        joint = int(room.argmin())
        text = f"{arm.joint_names[turning[joint]]} has {100.0 * room[joint]:.0f} % of its half range left"
        found.append(Margin("joint limits", float(room[joint]), text))
    closest = CollisionModel(arm, scene).minimum(q)
    if closest.pair is not None:
        ample = LIVE_PAGE.ample * arm.length
        share = (closest.distance - scene.margin) / ample
        text = f"{describe_distance(closest.pair, closest.distance)}, margin {length_text(scene.margin)}"
        found.append(Margin("clearance", min(max(share, 0.0), 1.0), text))
    load = arm.at(q).most_loaded()
    if load is not None:
        found.append(Margin("torque", max(0.0, 1.0 - load.share), str(load)))
    return found


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


def status_html(operation: Operation, shown: Shown, age: float) -> str:
    """Return what an operation does and why, given the age of its last cycle [s], as HTML."""
    kind = MODE_KINDS[shown.mode]
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
        maps = [each for each in scene.obstacles.values() if isinstance(each, Cells)]
        known = {name: each for name, each in scene.obstacles.items() if not isinstance(each, Cells)}
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
                each.surface.vertices,
                each.surface.faces,
                color=color(THEME.obstacle),
                opacity=THEME.see_through,
                side="double",
                cast_shadow=False,
                receive_shadow=False,
            )
            for number, each in enumerate(shown_obstacles(scene, reach))
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


class LivePage:
    """What browsers show of an operation, all of them the same; one of them has control.

    Attributes:
        url: where a browser on this machine finds it; anyone who has it can ask for control.

    Args:
        operation: the operation.
        host: the address to listen at.
        port: the port; another if it is taken.

    Raises:
        ViewerError: it cannot be served.
    """

    def __init__(self, operation: Operation, host: str = "127.0.0.1", port: int = 8080) -> None:
        self._operation = operation
        self._arm = arm = operation.arm
        control = operation.control

        def answer(name: str, message: str | bytes) -> str:
            reply = control.take(name, message, time.monotonic())
            shown = operation.shown
            why = f": {shown.reason}" if shown.reason else ""
            return json.dumps(reply | {"state": f"The arm {shown.mode}{why}"})

        head = files("pinposture.operate").joinpath("controls.html").read_text(encoding="utf-8")
        words = {"PERIOD": f"{1e3 * CONTROL.period:.0f}", "PATH": CHANNEL_PATH, "ALONE": ALONE_PATH}
        for word, value in words.items():
            head = head.replace(f"__{word}__", value)
        self._server, self.url = serve(
            host, port, "operate", Channel(CHANNEL_PATH, head, ALONE_PATH, answer, control.leave)
        )
        server = self._server
        server.gui.configure_theme(
            show_logo=False, show_share_button=False, brand_color=color(THEME.start), dark_mode=False
        )
        server.gui.set_panel_label("pinposture")
        server.gui.main_panel.dock_right()
        server.gui.main_panel.set_width(PAGE.controls_width)
        points = np.vstack([arm.chain.base, arm.at(arm.straight()).points, arm.at(arm.neutral()).points])
        radius = 0.1 * arm.length
        view = framing(points, radius, camera_direction(arm), PAGE.least_aspect, LIVE_PAGE.covered)
        set_stage(server, arm, view)
        self._status = server.gui.add_html("")
        self._bars = server.gui.add_html("")
        self._about = server.gui.add_html("")
        self._measured = ArmDrawing(server, arm)
        self._ghost = ArmDrawing(server, arm, "/commanded", LIVE_PAGE.ghost, THEME.start)
        self._ghost.set_visible(False)
        self._scene = SceneDrawing(server, arm)
        self._line = server.scene.add_line_segments(
            "/way", np.zeros((1, 2, 3)), np.zeros((1, 2, 3), dtype=np.uint8), thickness=0.3 * link_radius(arm)
        )
        self._drawn_line = np.zeros((0, 3))
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
            if shown.commanded is not None:
                self._ghost.set_visible(True)
                self._ghost.move(shown.commanded)
            self._scene.show(shown.scene, now)
            self._show_line(shown.line)
            if now - self._facts_at >= LIVE_PAGE.facts_period:
                self._facts_at = now
                self._show_facts(shown, now)
        self._server.flush()

    def _show_line(self, line: Array) -> None:
        """Draw the way of the tip, (n, 3) [m]."""
        if line is self._drawn_line or len(line) < 2:
            return
        self._drawn_line = line
        pieces = np.stack([line[:-1], line[1:]], axis=1).astype(np.float32)
        self._line.points = pieces
        self._line.colors = np.full(pieces.shape, color(THEME.target), dtype=np.uint8)

    def _show_facts(self, shown: Shown, now: float) -> None:
        """Write the status, and the margins of the measured arm."""
        put(self._status, content=status_html(self._operation, shown, now - shown.time))
        if shown.measured is not None:
            put(self._bars, content=bars_html(margins_of(self._arm, shown.measured, shown.scene)))
        style = "font-size:12px;padding:2px 10px"
        words = [self._scene.about] if self._scene.about else []
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
