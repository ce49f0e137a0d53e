"""The curve in the page: its control points, those of the arm, curves of other keyframes, the Shape tab."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import partial
from typing import Any, NamedTuple

import numpy as np
import viser
from numpy.typing import NDArray

from pinposture.arm import Arm
from pinposture.curve import Curve
from pinposture.editor.edits import configuration_of, keyframes_of, required_length
from pinposture.editor.postures import arm_line, drag_tip, hold_tip
from pinposture.editor.session import Session
from pinposture.editor.solver import Live
from pinposture.editor.ui.parts import (
    MILLIMETRE,
    Bound,
    Drag,
    Post,
    Request,
    add_axes,
    add_lines,
    color,
    coordinate_digits,
    legend_html,
    on_change,
    on_choice,
    put,
    put_at,
    quaternions,
    round_number,
)
from pinposture.errors import CurveError
from pinposture.placement.target import place_curve
from pinposture.task import Keyframe
from pinposture.viz import palette
from pinposture.viz.body import ball as ball_mesh
from pinposture.viz.body import tube
from pinposture.viz.drawing import link_radius
from pinposture.viz.palette import THEME

Array = NDArray[np.float64]
Colors = NDArray[np.uint8]


class CurveLook(NamedTuple):
    """How curves, their control points and their targets are drawn."""

    pieces: int = 240
    """Number of straight pieces of the curve."""

    other_pieces: int = 64
    """Number of those of the curves of other keyframes."""

    ball_radius: float = 1.8
    """Radius of a control point of the curve, relative to that of the bars of the arm."""

    grid: float = 0.02
    """First step of the grid, relative to the arm."""

    axes_size: float = 0.14
    """Size of the axes at the selected control point, relative to the arm."""

    small_error: float = 1e-3
    """Error up to which a target is green, in module lengths."""

    large_error: float = 0.3
    """Error from which on it is red, in module lengths."""

    line_error: float = 1e-2
    """Error from which on a line leads to it, in module lengths."""

    ball_color: str = palette.mixed(THEME.spare[0], THEME.start, 0.6)
    """Colour of control points of the curve."""

    selected_color: str = palette.mixed(THEME.start, THEME.target, 0.45)
    """Colour of selected ones."""

    earliest: float = 0.25
    """Place of the first curve on the scale of times: earlier ones are too pale on white."""


CURVE = CurveLook()


def drawn_curve(arm: Arm, keyframe: Keyframe) -> Curve:
    """Return the curve of a keyframe in the world; of a taught configuration, the line along the arm."""
    if keyframe.curve is not None:
        return place_curve(arm, keyframe.curve, keyframe.placement, keyframe.roll)[0]
    return Curve.spline(arm_line(arm, configuration_of(arm, keyframe)), degree=1)


def needed_part(arm: Arm, keyframe: Keyframe) -> Array:
    """Return points along the part of a curve that the arm needs, (CURVE.other_pieces + 1, 3) [m]."""
    laid = drawn_curve(arm, keyframe)
    end = min(laid.length, required_length(arm))
    return np.asarray(laid.at(np.linspace(0.0, end, CURVE.other_pieces + 1)))


class CurveDrawing:
    """The curve of the keyframe that is edited: what the arm covers of it, and whether it can take it."""

    def __init__(self, server: viser.ViserServer, arm: Arm) -> None:
        self._shown: tuple[object, ...] = ()
        self._line = add_lines(server, "/curve/line", CURVE.pieces, 0.7 * link_radius(arm))

    def show(self, session: Session, live: Live) -> None:
        """Bring it up to date."""
        verdict = live.verdict if live.number == session.number else None
        shape = session.shape
        key = (shape, verdict is not None, None if verdict is None else verdict.target)
        if key == self._shown:
            return
        self._shown = key
        curve = shape.curve if len(shape.points) else drawn_curve(session.arm, session.keyframe)
        along = np.linspace(0.0, curve.length, CURVE.pieces + 1)
        points = np.asarray(curve.at(along))
        self._line.points = np.stack([points[:-1], points[1:]], axis=1).astype(np.float32)
        if verdict is not None:
            self._line.colors = _curve_colors(curve, along, live)


def _curve_colors(curve: Curve, along: Array, live: Live) -> Colors:
    """Return the colours of the ends of the pieces, (CURVE.pieces, 2, 3)."""
    target = live.verdict.target
    shades = np.empty((CURVE.pieces, 2, 3), dtype=np.uint8)
    if target is None:
        shades[:] = color(THEME.mark)
        return shades
    covered = curve.length if target.parameters is None else float(target.parameters[target.has_target].max())
    inside = 0.5 * (along[1:] + along[:-1]) <= covered
    shades[:] = np.where(inside[:, None], color(THEME.target), color(THEME.rest))[:, None]
    return shades


def move_point(
    index: int,
    position: Array,
    final: bool,
    session: Session,
    keyframe: int | None = None,
    snap: bool = True,
) -> None:
    """Propose to move a control point of the curve, and all that are selected with it.

    Args:
        index: of the point, 0-based.
        position: where to, (3,) [m], world frame.
        final: whether it is to be accepted; else the drag continues.
        session: the session.
        keyframe: the one that is dragged; nothing is done if another was selected meanwhile, perhaps in
            another window. None: the one that is selected.
        snap: whether the point snaps to the grid of the session, if there is one.
    """
    if keyframe is not None and keyframe != session.selected:
        if final:
            session.say(f"point {index + 1} was released: another keyframe was selected meanwhile", "warning")
        return
    if index not in session.handles:
        session.take_hold(index)
    point = np.asarray(position)
    together = session.handles
    if snap and session.grid > 0.0:
        point = session.grid * np.round(point / session.grid)
    what = f"moved {named(together or [index])}"
    session.reshape(lambda arm, shape: shape.moved(arm, index, point, together), what, final)


def named(indices: Sequence[int]) -> str:
    """Return what to call points, 0-based, in a message."""
    return f"point{'s' * (len(indices) > 1)} {', '.join(str(index + 1) for index in sorted(indices))}"


def insert_point(session: Session) -> None:
    """Propose the same curve with a further control point after the selected one, or before the last."""
    before_last = len(session.shape.points) - 2
    after = before_last if session.handle is None else min(session.handle, before_last)
    session.reshape(lambda arm, shape: shape.inserted(arm, after), f"inserted point {after + 2}")
    session.handle = after + 1 if session.proposal is not None else session.handle


def duplicate_points(session: Session) -> None:
    """Propose the curve with copies of the selected control points, which are then selected."""
    chosen = selected_points(session)
    session.reshape(lambda arm, shape: shape.duplicated(arm, *chosen), f"duplicated {named(chosen)}")
    if session.proposal is not None:
        session.handles = tuple(index + before for before, index in enumerate(chosen, start=1))


def delete_points(session: Session) -> None:
    """Propose the curve without the selected control points."""
    chosen = selected_points(session)
    session.reshape(lambda arm, shape: shape.removed(arm, *chosen), f"deleted {named(chosen)}")
    if session.proposal is not None:
        session.handle = max(chosen[0] - 1, 1)


def selected_points(session: Session) -> list[int]:
    """Return the selected control points, 0-based, in their order along the curve.

    Raises:
        TaskError: the keyframe has no control points.
        CurveError: none is selected.
    """
    session.check_points()
    if not session.handles:
        raise CurveError("no control point is selected", "click on one, or press N")
    return sorted(session.handles)


class Handles:
    """The control points of the curve that is edited, dragged by the mouse, all that are selected together.

    The last one that was selected can be dragged along axes, too. A drag moves a point at once in the page,
    and is posted; the loop then puts all where they may be.
    """

    def __init__(self, server: viser.ViserServer, arm: Arm, post: Post) -> None:
        self._server = server
        self._post = post
        self._radius = CURVE.ball_radius * link_radius(arm)
        self._balls: list[viser.IcosphereHandle] = []
        self._drags: dict[int, Drag] = {}
        self._colors: list[str] = []
        self._frame = server.scene.add_line_segments(
            "/handles/frame", np.zeros((1, 2, 3)), color(THEME.rest), thickness=0.25 * link_radius(arm)
        )
        self._axes = add_axes(server, "/handles/axes", CURVE.axes_size * arm.length)
        self._index = -1
        self._keyframe = -1
        self._axes_drag = self._drag(self._axes, lambda drag: self._move(self._index, drag))

    def show(self, session: Session, _: Live) -> None:
        """Bring them up to date."""
        points = session.shape.points
        self._keyframe = session.selected
        if len(points) != len(self._balls):
            self._make_balls(len(points))
        for index, (ball, point) in enumerate(zip(self._balls, points, strict=True)):
            if index == 0 or not self._drags[index].held:
                put_at(ball, point)
            shade = CURVE.selected_color if index in session.handles else CURVE.ball_color
            shade = THEME.base if index == 0 else shade
            if self._colors[index] != shade:
                self._colors[index] = shade
                ball.color = color(shade)
        ends = np.stack([points[:-1], points[1:]], axis=1).astype(np.float32)
        put(self._frame, visible=len(ends) > 0)
        same = self._frame.points.shape == ends.shape and np.allclose(self._frame.points, ends, atol=1e-7)
        if len(ends) > 0 and not same:
            self._frame.points = ends
        with_axes = session.handle is not None and session.handle > 0
        if session.handle is not None and with_axes:
            self._index = session.handle
            if not self._axes_drag.held:
                put_at(self._axes, points[self._index])
        put(self._axes, visible=with_axes)

    def _make_balls(self, count: int) -> None:
        for ball in self._balls:
            ball.remove()
        self._balls = []
        self._drags = {}
        self._colors = [""] * count
        for index in range(count):
            ball = self._server.scene.add_icosphere(
                f"/handles/point_{index + 1}",
                self._radius,
                color(CURVE.ball_color),
                subdivisions=2,
                cast_shadow=False,
            )
            if index > 0:
                self._drags[index] = self._drag(ball, partial(self._move, index))
            ball.on_click(partial(self._on_click, index, False))
            ball.on_click(modifier="shift")(partial(self._on_click, index, True))
            self._balls.append(ball)

    async def _on_click(self, index: int, more: bool, _: Any) -> None:
        self._post(lambda session: session.take_hold(index, more))

    def _drag(self, node: Any, ask: Callable[[Drag], Request]) -> Drag:
        return Drag(self._post, node, ask, lambda: self._keyframe, moves=True)

    def _move(self, index: int, drag: Drag) -> Request:
        return partial(move_point, index, drag.position, drag.ended, keyframe=drag.keyframe)


class TipHandle:
    """Axes at the tip of the arm, by which it is dragged while it is selected."""

    def __init__(self, server: viser.ViserServer, arm: Arm, post: Post) -> None:
        self._start = arm.straight()
        self._keyframe = -1
        self._axes = add_axes(server, "/handles/tip", CURVE.axes_size * arm.length, sliders=True)
        self._drag = Drag(post, self._axes, self._ask, lambda: self._keyframe)

    def show(self, session: Session, live: Live) -> None:
        """Bring them up to date."""
        self._start = live.state.q
        self._keyframe = session.selected
        if not self._drag.held:
            put_at(self._axes, live.state.points[-1])
        put(self._axes, visible=session.tip)

    def _ask(self, drag: Drag) -> Request:
        return partial(drag_tip, drag.position, self._start, drag.ended, keyframe=drag.keyframe)


class Points:
    """The posture control points of an arm: coloured by their errors, active ones ringed."""

    def __init__(self, server: viser.ViserServer, arm: Arm) -> None:
        self._steps = -1
        self._unit = float(arm.chain.module_lengths.mean())
        radius = link_radius(arm)
        m = arm.n_modules
        around = np.linspace(0.0, 2.0 * np.pi, 13)  # a ring about the x axis
        circle = 1.85 * radius * np.column_stack([np.zeros_like(around), np.cos(around), np.sin(around)])
        dot = ball_mesh(np.zeros(3), 1.55 * radius)
        ring = tube(circle, 0.3 * radius)
        poses = np.tile([1.0, 0.0, 0.0, 0.0], (m, 1)), np.zeros((m, 3))
        self._dots = server.scene.add_batched_meshes_simple("/points/dots", *dot, *poses, lod="off")
        self._rings = server.scene.add_batched_meshes_simple(
            "/points/rings", *ring, *poses, batched_colors=color(THEME.active), lod="off"
        )
        self._error_lines = add_lines(server, "/points/errors", m, 0.5 * radius)
        self._colors: Colors = np.zeros((m, 3), dtype=np.uint8)
        self._ringed: NDArray[np.bool_] = np.zeros(m, dtype=np.bool_)

    def show(self, _: Session, live: Live) -> None:
        """Bring them up to date."""
        if live.steps == self._steps:
            return
        self._steps = live.steps
        points = live.state.points
        self._dots.batched_positions = points.astype(np.float32)
        colors = error_colors(live.errors, self._unit)
        if not np.array_equal(colors, self._colors):
            self._colors = colors
            self._dots.batched_colors = colors
        self._rings.batched_positions = points.astype(np.float32)
        self._rings.batched_wxyzs = quaternions(live.state.rotations).astype(np.float32)
        if not np.array_equal(live.active, self._ringed):
            self._ringed = live.active.copy()
            self._rings.batched_scales = np.where(live.active, 1.0, 1e-6).astype(np.float32)
        # A line from each point to its target, if that is elsewhere.
        ends = points if live.target is None else live.target.points
        off = (live.errors > CURVE.line_error * self._unit)[:, None]
        self._error_lines.points = np.stack([points, np.where(off, ends, points)], axis=1).astype(np.float32)
        self._error_lines.colors = np.repeat(colors[:, None], 2, axis=1)


def error_colors(errors: Array, unit: float) -> Colors:
    """Return colours of errors (m,) [m] by their orders of magnitude, relative to a module length [m]."""
    sizes = np.clip(errors / unit, CURVE.small_error, CURVE.large_error)
    shares = 1.0 - np.log(sizes / CURVE.small_error) / np.log(CURVE.large_error / CURVE.small_error)
    # Squared, since `index_color` takes the square root of the index.
    colors = [color(palette.index_color(THEME.regular_index * s * s)) for s in shares]
    return np.array(colors, dtype=np.uint8)


class OtherCurves:
    """The curves of the keyframes that are not edited, faintly: pale to dark as time goes on."""

    def __init__(self, server: viser.ViserServer, arm: Arm, wanted: Callable[[], bool]) -> None:
        self._arm = arm
        self._wanted = wanted
        self._drawn: dict[int, tuple[Keyframe, Array]] = {}
        self._shown: tuple[Keyframe, ...] = ()
        self._selected = -1
        self._lines = add_lines(server, "/curve/others", 1, 0.45 * link_radius(arm), visible=False)

    def show(self, session: Session, _: Live) -> None:
        """Bring them up to date."""
        keyframes = keyframes_of(session.task)
        visible = self._wanted()
        if visible and (keyframes is not self._shown or session.selected != self._selected):
            self._shown = keyframes
            self._selected = session.selected
            self._draw(keyframes, session.selected)
        put(self._lines, visible=visible)

    def _draw(self, keyframes: tuple[Keyframe, ...], selected: int) -> None:
        before = self._drawn
        self._drawn = {}
        for keyframe in keyframes:  # kept with its line, so that its id stays its own
            self._drawn[id(keyframe)] = before.get(id(keyframe)) or (
                keyframe,
                needed_part(self._arm, keyframe),
            )
        others = [index for index in range(len(keyframes)) if index != selected]
        lines = np.stack([self._drawn[id(keyframes[index])][1] for index in others])
        shares = CURVE.earliest + (1.0 - CURVE.earliest) * np.array(others) / (len(keyframes) - 1)
        colors = np.array([color(palette.in_time(share)) for share in shares], np.uint8)
        ends = np.stack([lines[:, :-1], lines[:, 1:]], axis=2).reshape(-1, 2, 3)
        self._lines.points = ends.astype(np.float32)
        self._lines.colors = np.repeat(np.repeat(colors, CURVE.other_pieces, axis=0)[:, None], 2, axis=1)


TIP = -1
"""Index of the tip among what has coordinates in the Shape tab."""


class ShapeTab:
    """Controls for the control points of the curve that is edited."""

    def __init__(self, server: viser.ViserServer, arm: Arm, post: Post) -> None:
        gui = server.gui
        self._index = 0
        self._keyframe = 0
        self._start = arm.straight()
        self._tip_position = np.zeros(3)
        hint = "Or click on one in the picture; Shift and a click selects several"
        self._taught = gui.add_markdown(
            "A taught configuration has no control points. *Keyframes*, *To curve* draws a curve through it.",
            visible=False,
        )
        bind = partial(Bound, post)
        point = gui.add_dropdown("Control point", ("none",), hint=hint)
        self._point = bind(
            point,
            lambda session: point.options[0 if session.handle is None else session.handle + 1],
            lambda name: partial(
                Session.take_hold, handle=None if name == "none" else int(name.split()[0]) - 1
            ),
        )
        hint = "Shows axes at the tip, by which it is dragged; key T"
        tip = gui.add_checkbox("Drag the tip", False, hint=hint)
        self._tip = bind(
            tip,
            lambda session: session.tip,
            lambda held: hold_tip if held else partial(Session.take_hold, handle=None),
        )
        digits = coordinate_digits(arm.length)
        hint = "World frame; of the control point, or of the tip while it is selected"
        coordinates = gui.add_vector3("x, y, z [mm]", (0.0, 0.0, 0.0), step=10.0**-digits, hint=hint)
        coordinates.precision = digits
        self._coordinates = bind(
            coordinates,
            self._position_of,
            partial(self._move, True),
            preview=partial(self._move, False),
            unit=MILLIMETRE,
            absent={"disabled": True},
        )
        hint = "Insert after keeps the curve, Duplicate keeps the other points"
        edit = gui.add_button_group("Points", tuple(POINT_ACTIONS), hint=hint)
        snap = gui.add_checkbox(
            "Snap to a grid", False, hint="Snap dragged points to a grid in the world frame"
        )
        first = round_number(CURVE.grid * arm.length) / MILLIMETRE
        least = 10.0**-digits
        self._step = gui.add_number("Grid [mm]", first, min=0.1 * least, step=least)
        self._step.precision = digits + 1
        self._snap = bind(
            snap,
            lambda session: session.grid > 0.0,
            lambda snapped: partial(set_grid, MILLIMETRE * self._step.value if snapped else 0.0),
        )
        on_change(self._step, lambda step: post(partial(set_grid, MILLIMETRE * step if snap.value else 0.0)))
        on_choice(edit, lambda what: post(POINT_ACTIONS[what]))
        colors = (
            (THEME.modules[0], "the arm"),
            (THEME.rest, "the curve beyond the arm"),
            (THEME.target, "the curve, where the arm lies on it"),
            (THEME.mark, "a curve that the arm cannot take"),
            (CURVE.ball_color, "control points of the curve"),
            (THEME.regular, "points of the arm on their targets; red: far off"),
            (THEME.active, "rings: active points of the arm"),
            (palette.in_time(0.7), "curves of other keyframes, by their times"),
        )
        gui.add_html(legend_html(colors))

    def show(self, session: Session, live: Live) -> None:
        """Bring it up to date."""
        self._tip.show(session)
        last = len(session.shape.points) - 1
        put(self._taught, visible=last < 0)
        suffixes = {0: " (base)", last: " (end)"}
        names = ("none", *(f"{k + 1}{suffixes.get(k, '')}" for k in range(last + 1)))
        if self._point.control.options != names:
            self._point.control.options = names
        self._point.show(session)
        self._start = live.state.q
        self._tip_position = live.state.points[-1]
        index = TIP if session.tip else session.handle
        if index is not None and (index, session.selected) != (self._index, self._keyframe):
            self._coordinates.finish()  # it was meant for the one before
            self._index = index
            self._keyframe = session.selected
        self._coordinates.show(session, disabled=index == 0)
        self._snap.show(session)

    def _position_of(self, session: Session) -> Array | None:
        if session.tip:
            return self._tip_position
        return None if session.handle is None else np.asarray(session.shape.points[session.handle])

    def _move(self, final: bool, position: tuple[float, float, float]) -> Request | None:
        index = self._index
        keyframe = self._keyframe
        if index == TIP:
            # A tip that follows each key would swing about.
            tip = partial(drag_tip, np.array(position), self._start, final, keyframe=keyframe)
            return tip if final else None

        def request(session: Session) -> None:
            if session.selected == keyframe:
                chosen = session.handles  # perhaps others by now
                move_point(index, np.array(position), final, session, snap=False)
                session.handles = chosen

        return request


POINT_ACTIONS = {
    "Insert after": insert_point,
    "Duplicate": duplicate_points,
    "Delete": delete_points,
    "Select all": Session.take_all,
}
"""What the buttons do to control points, by their labels."""


def set_grid(step: float, session: Session) -> None:
    """Snap points that are dragged to a grid of a step [m]; 0 for none."""
    session.grid = step
