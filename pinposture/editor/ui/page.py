"""The page: its parts, the status at its top, light and camera, and keys."""

from __future__ import annotations

import contextlib
import io
import time
from collections.abc import Callable
from functools import partial
from html import escape
from typing import Any, NamedTuple

import numpy as np
import viser
from numpy.typing import NDArray

from pinposture.arm import Arm
from pinposture.editor.edits import TIMES, differ_in_weight_alone, keyframes_of, lap_time
from pinposture.editor.files import Files
from pinposture.editor.measured_arm import JointStates
from pinposture.editor.obstacles import obstacles_of
from pinposture.editor.phases import EditedPhase
from pinposture.editor.playback import Playback
from pinposture.editor.postures import hold_tip
from pinposture.editor.session import Session
from pinposture.editor.solver import Live
from pinposture.editor.surroundings import Surroundings
from pinposture.editor.ui.arm import ArmDrawing, ArmTab, MeasuredArm
from pinposture.editor.ui.curve import (
    CURVE,
    CurveDrawing,
    Handles,
    OtherCurves,
    Points,
    ShapeTab,
    TipHandle,
    delete_points,
    duplicate_points,
    insert_point,
    move_point,
    needed_part,
    selected_points,
)
from pinposture.editor.ui.files import ExportButtons, FileTab, offer_tour
from pinposture.editor.ui.keyframes import KeyframesTab
from pinposture.editor.ui.parts import (
    Part,
    Post,
    color,
    framed_html,
    on_choice,
    put,
    round_number,
)
from pinposture.editor.ui.phases import PhaseDrawing
from pinposture.editor.ui.player import Player, covered_height, play_or_pause
from pinposture.editor.ui.scene import ClearanceLine, Obstacles, Scans, SceneTab, clearance_text
from pinposture.editor.ui.server import serve
from pinposture.errors import CurveError
from pinposture.motion.deadline import NOT_DONE
from pinposture.placement.target import arm_axis
from pinposture.task import Task
from pinposture.units import BELOW_ROUNDING, length_text
from pinposture.viz import palette
from pinposture.viz.drawing import link_radius
from pinposture.viz.palette import THEME

STATUS_COLORS = {
    "good": THEME.regular,
    "info": THEME.regular,
    "warning": THEME.active,
    "error": THEME.mark,
}


class StatusSettings(NamedTuple):
    """When the status is a warning, and its size."""

    curve_distance: float = 0.02
    """Distance of the whole arm from the curve from which on it warns, in arm lengths."""

    tip_error: float = 0.01
    """Distance of the tip from its task from which on it warns, in arm lengths."""

    mean_error: float = 0.01
    """Mean distance of control points from their targets from which on it warns, in arm lengths."""

    judging_time: float = 0.4
    """Age of a problem before it mentions it [s]."""

    least_height: int = 124
    """Smallest height [pixels]."""

    most_share: int = 45
    """Largest share of the height of the page [%]."""


STATUS = StatusSettings()


IN_SIGHT = """<style>
div:has(> #always) {position: sticky; top: 0; z-index: 5; background: white}
div:has(> div > div > div > #always) {overflow: visible !important}
</style>"""
"""Keeps the status in sight while the controls below it are scrolled."""


class Status:
    """A few lines, always in sight."""

    def __init__(self, server: viser.ViserServer) -> None:
        self._html = server.gui.add_html("")

    def show(self, session: Session, live: Live) -> None:
        """Bring it up to date."""
        kind, head, more = status_of(session, live)
        notice = session.message
        message = ""
        if notice is not None:
            ink = palette.mixed(STATUS_COLORS[notice.kind], THEME.ink, 0.45)  # not pale on white
            style = f"color:{ink};margin-top:4px"
            about = f'id="notice" data-kind="{notice.kind}" style="{style}"'
            message = f"<div {about}>{escape(notice.text)}</div>"
        content = framed_html("status", STATUS_COLORS[kind], escape(head), escape(more), message)
        # At least so high that what is below it seldom jumps; long reasons are shown whole.
        style = (
            f"min-height:min({STATUS.least_height}px, 15vh);max-height:{STATUS.most_share}vh;overflow-y:auto"
        )
        put(self._html, content=f'{IN_SIGHT}<div id="always" style="{style}">{content}</div>')


class Toolbar:
    """Which keyframe is edited, and the buttons that are always in sight."""

    def __init__(
        self, server: viser.ViserServer, files: Files, frame: Callable[[str], None], post: Post
    ) -> None:
        self._html = server.gui.add_html("")
        actions = {"Undo": Session.undo, "Redo": Session.redo, "Save": files.save}
        edit = server.gui.add_button_group("Edit", tuple(actions))
        on_choice(edit, lambda label: post(actions[label]))
        view = server.gui.add_button_group("View", tuple(DIRECTIONS))
        on_choice(view, frame)

    def show(self, session: Session, _: Live) -> None:
        """Bring it up to date."""
        keyframe = session.keyframe
        count = len(keyframes_of(session.shown))
        name = f": {escape(keyframe.name)}" if keyframe.name else ""
        unsaved = " (not saved)" if session.changed else ""
        words = f"Keyframe {session.selected + 1}/{count}{name}{unsaved}"
        if isinstance(session.task, EditedPhase):
            words = (
                f"Phase {session.task.index + 1}/{len(session.task.phases)}, {words[0].lower()}{words[1:]}"
            )
        style = "font-size:13px;padding:0 10px;white-space:nowrap;overflow:hidden;text-overflow:ellipsis"
        put(self._html, content=f'<div id="keyframe" style="{style}">{words}</div>')


def status_of(session: Session, live: Live) -> tuple[str, str, str]:
    """Return the status of the arm: "good", "warning" or "error", a heading, and more."""
    verdict = live.verdict
    nearest = session.nearest
    if live.number < session.number and time.monotonic() - session.asked > STATUS.judging_time:
        return "warning", "Checking whether the arm can take this shape ...", ""
    if verdict.reason:
        return "error", "The arm cannot take this shape", verdict.reason
    head = _heading(session, live)
    if nearest is not None and nearest.distance < 0.0:
        return "error", "The arm is in collision", f"{clearance_text(nearest)}; {head[0].lower()}{head[1:]}"
    if verdict.collision:
        return "warning", "At rest on this curve, the arm would collide", verdict.notes[0]
    if live.reason and live.reason != NOT_DONE and live.status != "converged":
        return "warning", head, live.reason
    notes = list(verdict.notes)
    controller = session.task.controller.name
    if obstacles_of(session.task) and controller != "geodesic":
        notes.append(f"{controller} ignores obstacles, geodesic avoids them")
    return "warning" if _is_off(session, live) else "good", head, "; ".join(notes)


def _is_off(session: Session, live: Live) -> bool:
    """Return whether the arm takes the shape badly, or is within the margin of something."""
    length = live.arm.length
    nearest = session.nearest
    if nearest is not None and nearest.distance < nearest.margin:
        return True
    if session.playback.q is not None or live.status == "moving":
        return False
    return (
        (live.verdict.distance_from_curve or 0.0) > STATUS.curve_distance * length
        or (live.tip_error or 0.0) > STATUS.tip_error * length
        or live.mean_error > STATUS.mean_error * length
    )


def _heading(session: Session, live: Live) -> str:
    """Return what the arm is doing, and how near it is to what it should do."""
    length = session.arm.length
    error = length_text(live.mean_error, length)
    to_go = "" if error == BELOW_ROUNDING else f", {error} to go"
    distance = live.verdict.distance_from_curve
    if session.playback.q is not None:
        playback = session.playback
        head = "Playing the motion" if playback.playing else f"Motion at {playback.time:.1f} s"
        head += _lap(session.task, playback)
        head += ", on its targets" if error == BELOW_ROUNDING else f", {error} off its targets"
    elif live.reason == NOT_DONE:
        head = f"Planning{to_go}"
    elif live.status == "moving":
        head = f"Moving{to_go}"
    elif live.status != "converged":
        head = f"Stopped{to_go}"
    elif distance is not None:
        head = f"On the curve{_within(distance, length)}"
    else:
        head = f"On target{_within(live.mean_error, length)}"
    if live.tip_error is not None:
        off = length_text(live.tip_error, length)
        head += ", tip on its goal" if off == BELOW_ROUNDING else f", tip {off} off"
    if session.nearest is not None:
        clearance = session.nearest.distance
        head += f", {length_text(abs(clearance))} {'inside' if clearance < 0.0 else 'clear'}"
    return head


def _within(error: float, arm_length: float) -> str:
    """Return how exact something is, as the end of a phrase; nothing if it is exact but for rounding."""
    text = length_text(error, arm_length)
    return "" if text == BELOW_ROUNDING else f" to within {text}"


def _lap(task: Task, playback: Playback) -> str:
    """Return which lap of a repeated tour is shown, as the end of a phrase."""
    sample = playback.sample
    motion = playback.motion
    if task.repeat == 1 or sample is None or motion is None:
        return ""
    lap = int(float(motion.plan_time[sample.row]) / lap_time(task) + TIMES.tolerance)
    return f", lap {min(lap + 1, task.repeat)} of {task.repeat}"


Array = NDArray[np.float64]


class PageLayout(NamedTuple):
    """Sizes of the page, and the view of its camera."""

    controls_width: int = 340
    """Width of the controls [pixels]."""

    nudge: float = 0.01
    """Motion by an arrow key, relative to the arm."""

    field_of_view: float = 40.0
    """Field of view of the camera, vertically [deg]."""

    least_level: float = 0.1
    """Horizontal part of the direction of an arm below which it counts as upright."""

    floor_cells: int = 10
    """Number of cells of the floor along the arm."""

    frame_margin: float = 0.15
    """Room beside what is framed, relative to the part of the picture that is not covered."""

    least_covered: float = 0.3
    """Smallest share of the picture that the plots cover: browsers tell its height in pixels of the screen,
    which may be several to one of the page."""

    most_covered: float = 0.6
    """Largest share of the picture that the plots cover."""

    covered_at_first: float = 0.39
    """Share of the picture that they cover before a browser tells its height."""

    least_aspect: float = 1.0
    """Aspect ratio of the narrowest picture in which the initial camera sees the whole arm."""


PAGE = PageLayout()

DIRECTIONS = {  # from what is framed to the camera; never straight down, where no side is up
    "All": np.array([0.25, -0.85, 0.46]),  # of an arm along the x axis
    "Front": np.array([1.0, 0.0, 0.0]),
    "Side": np.array([0.0, -1.0, 0.0]),
    "Top": np.array([0.0, -1e-3, 1.0]),
}


class Shortcut(NamedTuple):
    """A key, and what it does."""

    label: str  # what it does, in words
    key: str  # as the page names it
    modifier: str | None  # the key held with it, as the page names it
    act: Callable[[Session], object]  # called with the session


def shortcuts(files: Files, frame_all: Callable[[Session], object]) -> tuple[Shortcut, ...]:
    """Return all keys of the editor."""
    return (
        Shortcut("Undo", "Z", "cmd/ctrl", Session.undo),
        Shortcut("Redo", "Z", "cmd/ctrl+shift", Session.redo),
        Shortcut("Redo", "Y", "cmd/ctrl", Session.redo),
        Shortcut("Save", "S", "cmd/ctrl", files.save),
        Shortcut("Play or pause", "space", None, play_or_pause),
        Shortcut("Frame all", "F", None, frame_all),
        Shortcut("Insert a control point", "I", None, insert_point),
        Shortcut("Delete the control points", "delete", None, delete_points),
        Shortcut("Duplicate the control points", "D", None, duplicate_points),
        Shortcut("Select all control points", "A", "cmd/ctrl", Session.take_all),
        Shortcut("Next control point", "N", None, partial(_select_next, 1)),
        Shortcut("Previous control point", "B", None, partial(_select_next, -1)),
        Shortcut("Select the tip", "T", None, hold_tip),
        Shortcut("Select nothing", "escape", None, lambda session: session.take_hold(None)),
        Shortcut("Move it ahead (+x)", "arrowright", "shift", partial(_nudge, 0, 1.0)),
        Shortcut("Move it back (-x)", "arrowleft", "shift", partial(_nudge, 0, -1.0)),
        Shortcut("Move it up (+z)", "arrowup", "shift", partial(_nudge, 2, 1.0)),
        Shortcut("Move it down (-z)", "arrowdown", "shift", partial(_nudge, 2, -1.0)),
    )


def add_shortcuts(
    server: viser.ViserServer, files: Files, frame_all: Callable[[Session], object], post: Post
) -> None:
    """Add all keys to the page, whose command palette lists them."""
    for label, key, modifier, act in shortcuts(files, frame_all):
        command = server.gui.add_command(label, hotkey=key, modifier=modifier)  # type: ignore[arg-type]
        # A key that is held down repeats itself; the arm may need longer than that for a move.
        command.on_trigger(partial(_on_trigger, post, act, label if modifier == "shift" else ""))


async def _on_trigger(post: Post, act: Callable[[Session], object], key: str, _: Any) -> None:
    post(act, key)


def _select_next(by: int, session: Session) -> None:
    """Select the next or previous control point; the one at the base is skipped."""
    session.check_points()
    count = len(session.shape.points)
    at = session.handle if session.handle is not None else (0 if by > 0 else count)
    session.take_hold((at - 1 + by) % (count - 1) + 1)


def _nudge(axis: int, sign: float, session: Session) -> None:
    """Move the selected control points a little along an axis of the world, or by a step of the grid."""
    selected_points(session)
    arm = session.arm
    last = session.handles[-1]
    step = sign * (session.grid or PAGE.nudge * arm.length) * np.eye(3)[axis]
    if arm.dimension == 2 and np.linalg.norm(arm.plane @ step) < 1e-6 * arm.length:
        raise CurveError(f"point {last + 1}", f"cannot leave the plane of the arm along {'xyz'[axis]}")
    move_point(last, session.shape.points[last] + step, True, session)


class Viewpoint(NamedTuple):
    """The initial camera."""

    position: Array  # (3,) [m], world frame
    look_at: Array  # the point in the middle of the picture, (3,) [m], world frame
    opening: float  # angle from the bottom of the picture to its top [rad]


def camera_direction(arm: Arm) -> Array:
    """Return the direction, (3,), from an arm to a camera that sees its base at the left."""
    ahead = arm_axis(arm)
    level = float(np.hypot(*ahead[:2]))
    if level < PAGE.least_level:
        return DIRECTIONS["All"]
    cosine, sine = ahead[:2] / level
    turn = np.array([[cosine, -sine, 0.0], [sine, cosine, 0.0], [0.0, 0.0, 1.0]])
    return np.asarray(turn @ DIRECTIONS["All"])


def viewpoint(task: Task) -> Viewpoint:
    """Return a camera that has the straight arm and the curves of all keyframes in sight."""
    arm = task.arm
    points = [arm.chain.base[None], arm.at(arm.straight()).points]
    points += [needed_part(arm, keyframe) for keyframe in keyframes_of(task)]
    radius = CURVE.ball_radius * link_radius(arm)
    return framing(np.vstack(points), radius, camera_direction(arm), PAGE.least_aspect, PAGE.covered_at_first)


def framing(points: Array, radius: float, direction: Array, aspect: float, covered: float) -> Viewpoint:
    """Return a camera that has balls in sight, above the plots.

    Args:
        points: the centres of the balls, (n, 3) [m], world frame.
        radius: of the balls [m].
        direction: from the points to the camera, (3,).
        aspect: width of the picture relative to its height.
        covered: share of its height, from below, that the plots cover.
    """
    ahead = -direction / np.linalg.norm(direction)
    right = np.cross(ahead, [0.0, 0.0, 1.0])
    right /= np.linalg.norm(right)
    axes = np.array([right, np.cross(right, ahead), ahead])
    seen = points @ axes.T
    slope = float(np.tan(np.radians(PAGE.field_of_view) / 2.0))
    middle = 0.5 * (seen.min(axis=0) + seen.max(axis=0))
    inside = 1.0 - PAGE.frame_margin
    # Rays through the edges of the part to fill, at the left and right, and below and above [tangents].
    edges = slope * np.array([[-aspect, aspect], [2.0 * covered - 1.0, 1.0]])
    edges = edges.mean(axis=1, keepdims=True) + inside * (edges - edges.mean(axis=1, keepdims=True))
    # A ball is inside of an edge if its centre is a radius away from the plane of the rays through that edge.
    room = radius * np.hypot(1.0, edges)
    low = (seen[:, :2] - seen[:, 2:] * edges[:, 0]).min(axis=0) - room[:, 0]
    high = (seen[:, :2] - seen[:, 2:] * edges[:, 1]).max(axis=0) + room[:, 1]
    # All balls are within the rays from a camera at this depth, or farther back.
    depth = float(np.min((low - high) / (edges[:, 1] - edges[:, 0]), initial=middle[2] - 1e-3))
    across = 0.5 * (low + high + depth * edges.sum(axis=1))
    position = np.append(across, depth) @ axes
    return Viewpoint(position, position + (middle[2] - depth) * ahead, float(np.radians(PAGE.field_of_view)))


def set_stage(server: viser.ViserServer, arm: Arm, view: Viewpoint) -> None:
    """Set light and the initial camera for an arm, and a floor below it."""
    base = arm.chain.base
    length = arm.length
    tip = arm.at(arm.straight()).points[-1]
    server.scene.set_up_direction("+z")
    server.scene.world_axes.visible = False
    server.scene.configure_environment_map("city", environment_intensity=0.55)
    camera = server.initial_camera
    camera.position, camera.look_at, camera.fov = view
    camera.near = 0.01 * length
    camera.far = 100.0 * length
    cell = round_number(length / PAGE.floor_cells)
    floor = float(min(base[2], tip[2])) - 0.3 * length - 3.0 * link_radius(arm)
    server.scene.add_grid(
        "/floor",
        width=24.0 * cell,
        height=24.0 * cell,
        cell_size=cell,
        section_size=5.0 * cell,
        cell_color=color(THEME.faint),
        section_color=color(palette.mixed(THEME.faint, THEME.rest, 0.5)),
        position=(*np.round(view.look_at[:2] / cell) * cell, floor),
        fade_distance=40.0 * cell,
        shadow_opacity=0.12,
    )
    server.scene.add_frame(
        "/axes", axes_length=0.08 * length, axes_radius=0.15 * link_radius(arm), position=(*base[:2], floor)
    )


class Page:
    """What browsers show, all of them the same.

    Attributes:
        url: where a browser on this machine finds it; anyone who has it can edit.
        view: the initial camera.

    Raises:
        ViewerError: it cannot be served.
    """

    def __init__(
        self,
        session: Session,
        post: Post,
        files: Files,
        surroundings: Surroundings,
        states: JointStates | None,
        host: str,
        port: int,
    ) -> None:
        self._post = post
        self._files = files
        self._surroundings = surroundings
        self._states = states
        self._server, self.url = serve(host, port)
        self._server.gui.configure_theme(
            show_logo=False, show_share_button=False, brand_color=color(THEME.start), dark_mode=False
        )
        offer_tour(self._server)
        self._server.on_client_connect(self._watch_aspect)
        self._build(session.task)

    def _build(self, task: Task) -> None:
        """Make all parts for the arm of a task."""
        arm = task.arm
        self.view = viewpoint(task)
        server = self._server
        post = self._post
        scans = self._surroundings.scans
        server.gui.set_panel_label("pinposture")
        server.gui.main_panel.dock_right()
        server.gui.main_panel.set_width(PAGE.controls_width)
        set_stage(server, arm, self.view)
        self._arm = ArmDrawing(server, arm)
        self._parts: list[Part] = [
            CurveDrawing(server, arm),
            PhaseDrawing(server, arm),
            Handles(server, arm, post),
            TipHandle(server, arm, post),
            Points(server, arm),
            Obstacles(server, arm, post),
            Scans(server, arm, scans),
            ClearanceLine(server, arm),
            Status(server),
            Toolbar(server, self._files, lambda name: post(partial(self._frame, name)), post),
            Player(server, arm, post),
        ]
        tabs = server.gui.add_tab_group()
        with tabs.add_tab("Shape"):
            self._parts.append(ShapeTab(server, arm, post))
        with tabs.add_tab("Keyframes"):
            keyframes = KeyframesTab(server, arm, self._states, post)
            self._parts += [keyframes, OtherCurves(server, arm, lambda: keyframes.others)]
        with tabs.add_tab("Scene"):
            self._parts.append(SceneTab(server, arm, scans, post))
        with tabs.add_tab("Arm"):
            self._parts += [MeasuredArm(server, arm, self._states), ArmTab(server, self._arm, post)]
        with tabs.add_tab("File"):
            self._parts += [FileTab(server, self._files, post), ExportButtons(server, post)]
        add_shortcuts(server, self._files, partial(self._frame, "All"), post)

    async def _watch_aspect(self, client: viser.ClientHandle) -> None:
        """Frame the arm in a browser whenever its picture becomes narrow, as beside the controls."""
        narrow = False

        async def watch(camera: viser.CameraHandle) -> None:
            nonlocal narrow
            before = narrow
            narrow = camera.aspect < PAGE.least_aspect
            if narrow and not before:
                self._post(partial(self._frame, "All", only=client.client_id))

        client.camera.on_update(watch)

    def _frame(self, direction: str, session: Session, only: int | None = None) -> None:
        """Move the camera of one or all browsers so that the arm, its curves and balls are in sight."""
        arm = session.arm
        q = self._arm.q
        seen = [self._arm.foot, arm.chain.base[None], session.shape.points, arm.at(q).points]
        points = np.vstack([*seen, *(needed_part(arm, keyframe) for keyframe in keyframes_of(session.shown))])
        radius = CURVE.ball_radius * link_radius(arm)
        for number, client in self._server.get_clients().items():
            camera = client.camera
            if only not in (None, number):
                continue
            with client.atomic(), contextlib.suppress(AssertionError):  # it has not sent its camera yet
                covered = covered_height(camera.image_height) / camera.image_height
                covered = min(max(covered, PAGE.least_covered), PAGE.most_covered)
                away = camera_direction(arm) if direction == "All" else DIRECTIONS[direction]
                view = framing(points, radius, away, camera.aspect, covered)
                camera.position = view.position
                camera.look_at = view.look_at

    def show(self, session: Session, live: Live) -> None:
        """Bring everything up to date; only changes are sent."""
        if live.arm is not session.arm:
            return  # the solver has not turned to it yet
        with self._server.atomic():
            if not differ_in_weight_alone(live.arm, self._arm.arm):
                self._server.gui.reset()
                self._server.scene.reset()
                self._build(session.task)
            self._arm.arm = live.arm
            live = session.playback.seen(live)
            self._arm.move(live.state.q)
            for part in self._parts:
                part.show(session, live)
        self._server.flush()

    def close(self) -> None:
        """Stop the server."""
        with contextlib.redirect_stdout(io.StringIO()):
            self._server.stop()
