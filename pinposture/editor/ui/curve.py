"""The curve in the page: its control points, the arm's control points, other curves, and its tab."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from typing import Any

import numpy as np
import viser
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from pinposture.arm import Arm
from pinposture.curve import Curve
from pinposture.editor.session import Session
from pinposture.editor.shape import Shape, keyframes_of, required_length
from pinposture.editor.solver import Live
from pinposture.editor.ui.parts import Post, Typed, color, on_change, on_choice, put
from pinposture.placement.curve_placement import lay
from pinposture.task import Keyframe
from pinposture.viz import palette
from pinposture.viz.drawing import link_radius
from pinposture.viz.mesh import ball as ball_mesh
from pinposture.viz.mesh import tube

# The target curve in the page: what the arm covers of it, what it does not, and what it cannot take.

Array = NDArray[np.float64]

PIECES = 240
"""Straight pieces that the curve is drawn with."""


class CurveDrawing:
    """The curve of the keyframe that is edited, as drawn by hand.

    Args:
        server: the page.
        arm: the arm.
    """

    def __init__(self, server: viser.ViserServer, arm: Arm) -> None:
        self._arm = arm
        self._shown: tuple[object, ...] = ()
        self._line = server.scene.add_line_segments(
            "/curve/line",
            np.zeros((PIECES, 2, 3)),
            np.zeros((PIECES, 2, 3), dtype=np.uint8),
            thickness=0.7 * link_radius(arm),
        )

    def show(self, session: Session, live: Live) -> None:
        """Bring it up to date."""
        verdict = live.verdict if live.number == session.number else None
        shape = session.shape
        key = (shape, verdict is not None, None if verdict is None else verdict.target)
        if key == self._shown:
            return
        self._shown = key
        curve = shape.curve
        along = np.linspace(0.0, curve.length, PIECES + 1)
        places = np.asarray(curve.at(along))
        self._line.points = np.stack([places[:-1], places[1:]], axis=1).astype(np.float32)
        if verdict is not None:
            self._line.colors = self._colored(curve, along, live)

    def _colored(self, curve: Curve, along: Array, live: Live) -> NDArray[np.uint8]:
        """Colours of the ends of the pieces, (PIECES, 2, 3)."""
        verdict = live.verdict
        shades = np.empty((PIECES, 2, 3), dtype=np.uint8)
        if verdict.target is None:
            shades[:] = color(palette.MARK)
            return shades
        parameters = verdict.target.parameters
        covered = curve.length if parameters is None else float(parameters[verdict.target.has_target].max())
        inside = 0.5 * (along[1:] + along[:-1]) <= covered
        shades[:] = np.where(inside[:, None], color(palette.TARGET), color(palette.REST))[:, None]
        return shades


# Control points of the curve in the page, dragged by the mouse; the selected one along axes, too.

SIZE = 2.6
"""Radius of a control point, relative to that of the bars of the arm."""

AXES = 0.14
"""Size of the axes along which the selected one can be moved, relative to the arm."""


def move_point(
    index: int, position: Array, final: bool, session: Session, keyframe: int | None = None
) -> None:
    """Propose a control point of the curve elsewhere.

    Args:
        index: of the point, 0-based.
        position: where, (3,) [m], world frame.
        final: whether it is to count, or the hand is still at it.
        session: the session.
        keyframe: the one that the hand is at; nothing is done if another was selected meanwhile, in another
            window perhaps. None: the one that is selected.
    """
    if keyframe is not None and keyframe != session.selected:
        if final:
            session.say(f"point {index + 1} was let go: another keyframe was selected meanwhile", "warning")
        return
    session.take_hold(index)

    def change(arm: Arm, shape: Shape) -> Shape:
        return shape.moved(arm, index, position)

    session.reshape(change, f"moved point {index + 1}", final)


class Handles:
    """The control points of the curve that is edited.

    A drag in the page moves them at once, and is passed on; the loop puts them where they may be.

    Args:
        server: the page.
        arm: the arm.
        post: leaves a request for the loop.
    """

    def __init__(self, server: viser.ViserServer, arm: Arm, post: Post) -> None:
        self._server, self._arm, self._post = server, arm, post
        self._radius = SIZE * link_radius(arm)
        self._balls: list[viser.IcosphereHandle] = []
        self._grabbed: dict[int, Array] = {}  # where a ball was taken hold of, from its middle
        self._colors: list[str] = []
        self._frame = server.scene.add_line_segments(
            "/handles/frame", np.zeros((1, 2, 3)), color(palette.REST), thickness=0.25 * link_radius(arm)
        )
        self._axes = server.scene.add_transform_controls(
            "/handles/axes",
            scale=AXES * arm.length,
            disable_rotations=True,
            disable_sliders=True,
            depth_test=False,
            visible=False,
        )
        self._led = False  # whether the axes are dragged
        self._axes.on_update(self._on_axes)
        self._index, self._keyframe = -1, -1
        self._held = -1  # the keyframe that a hand took hold of

    def show(self, session: Session, live: Live) -> None:
        """Bring them up to date."""
        del live
        points, self._keyframe = session.shape.points, session.selected
        if len(points) != len(self._balls):
            self._make(len(points))
        for index, (ball, point) in enumerate(zip(self._balls, points, strict=True)):
            if index not in self._grabbed and not np.allclose(ball.position, point, atol=1e-7):
                ball.position = point
            own = (
                palette.BASE if index == 0 else palette.START if index == session.handle else palette.SPARE[0]
            )
            if self._colors[index] != own:
                self._colors[index] = own
                ball.color = color(own)
        ends = np.stack([points[:-1], points[1:]], axis=1).astype(np.float32)
        if self._frame.points.shape != ends.shape or not np.allclose(self._frame.points, ends, atol=1e-7):
            self._frame.points = ends
        self._put_axes(session, points)

    def _put_axes(self, session: Session, points: Array) -> None:
        """Show the axes at the selected point."""
        visible = False
        if session.handle is not None and session.handle > 0:
            visible, self._index = True, session.handle
            if not self._led and not np.allclose(self._axes.position, points[self._index], atol=1e-7):
                self._axes.position = points[self._index]
        if self._axes.visible != visible:
            self._axes.visible = visible

    def _make(self, count: int) -> None:
        for ball in self._balls:
            ball.remove()
        self._balls, self._colors, self._grabbed = [], [""] * count, {}
        for index in range(count):
            ball = self._server.scene.add_icosphere(
                f"/handles/point_{index + 1}",
                self._radius,
                color(palette.SPARE[0]),
                subdivisions=2,
                cast_shadow=False,
            )
            if index > 0:
                ball.on_drag(partial(self._on_drag, index))
            ball.on_click(partial(self._on_click, index))
            self._balls.append(ball)

    async def _on_drag(self, index: int, event: Any) -> None:
        if index >= len(self._balls):
            return
        ball = self._balls[index]
        if event.phase == "start" or index not in self._grabbed:
            self._grabbed[index] = np.asarray(event.start_position) - ball.position
            self._held = self._keyframe
        place = np.asarray(event.end_position) - self._grabbed[index]
        final = event.phase == "end"
        try:
            ball.position = place
        except RuntimeError:  # the ball has been removed, and perhaps the arm with it
            self._grabbed.pop(index, None)
            return
        if final:
            del self._grabbed[index]
        self._post(partial(move_point, index, place, final, keyframe=self._held), "" if final else "move")

    async def _on_click(self, index: int, _: Any) -> None:
        self._post(partial(select_point, index))

    async def _on_axes(self, event: Any) -> None:
        if not self._led:
            self._held = self._keyframe
        self._led = event.phase != "end"
        final = not self._led
        place = np.array(self._axes.position)
        request = partial(move_point, self._index, place, final, keyframe=self._held)
        self._post(request, "" if final else "move")


def select_point(index: int | None, session: Session) -> None:
    """Select a control point of the curve; then no obstacle is."""
    session.take_hold(index)


# The posture control points in the page: coloured by their errors, active ones ringed.

SMALL, LARGE = 1e-3, 0.3
"""Errors, relative to a module length, below which a point is green, and above which it is red."""

IN_THE_WAY = 1e-2
"""Error, relative to a module length, from which on a line leads to the target."""


def error_colors(errors: Array, unit: float) -> NDArray[np.uint8]:
    """Colours of points by their errors: green, yellow, red, evenly by orders of magnitude.

    Args:
        errors: (m,) [m].
        unit: length of a module [m].
    """
    sizes = np.clip(errors / unit, SMALL, LARGE)
    shares = 1.0 - np.log(sizes / SMALL) / np.log(LARGE / SMALL)
    # `index_color` goes by the square root of the index
    return np.array(
        [color(palette.index_color(palette.REGULAR_INDEX * s * s)) for s in shares], dtype=np.uint8
    )


class Points:
    """The posture control points of an arm.

    Args:
        server: the page.
        arm: the arm.
    """

    def __init__(self, server: viser.ViserServer, arm: Arm) -> None:
        self._arm, self._steps = arm, -1
        self._unit = float(arm.chain.module_lengths.mean())
        radius, m = link_radius(arm), arm.n_modules
        dot, ring = ball_mesh(np.zeros(3), 1.55 * radius), _ring(1.85 * radius, 0.3 * radius)
        still = np.tile([1.0, 0.0, 0.0, 0.0], (m, 1)), np.zeros((m, 3))
        self._dots = server.scene.add_batched_meshes_simple("/points/dots", *dot, *still, lod="off")
        self._rings = server.scene.add_batched_meshes_simple(
            "/points/rings", *ring, *still, batched_colors=color(palette.ACTIVE), lod="off"
        )
        self._ways = server.scene.add_line_segments(
            "/points/ways", np.zeros((m, 2, 3)), np.zeros((m, 2, 3), dtype=np.uint8), thickness=0.5 * radius
        )
        self._colors: NDArray[np.uint8] = np.zeros((m, 3), dtype=np.uint8)
        self._ringed: NDArray[np.bool_] = np.zeros(m, dtype=np.bool_)

    def show(self, session: Session, live: Live) -> None:
        """Bring them up to date."""
        del session
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
        turns = Rotation.from_matrix(live.state.rotations).as_quat()[:, [3, 0, 1, 2]]
        self._rings.batched_wxyzs = turns.astype(np.float32)
        if not np.array_equal(live.active, self._ringed):
            self._ringed = live.active.copy()
            self._rings.batched_scales = np.where(live.active, 1.0, 1e-6).astype(np.float32)
        self._lead(live, colors)

    def _lead(self, live: Live, colors: NDArray[np.uint8]) -> None:
        """Draw a line from each point to where it should be, if that is elsewhere."""
        points = live.state.points
        ends = points if live.target is None else live.target.points
        off = (live.errors > IN_THE_WAY * self._unit)[:, None]
        self._ways.points = np.stack([points, np.where(off, ends, points)], axis=1).astype(np.float32)
        self._ways.colors = np.repeat(colors[:, None], 2, axis=1)


def _ring(radius: float, thickness: float) -> tuple[Array, NDArray[np.intp]]:
    """A ring about the x axis."""
    around = np.linspace(0.0, 2.0 * np.pi, 13)
    circle = radius * np.column_stack([np.zeros_like(around), np.cos(around), np.sin(around)])
    return tube(circle, thickness)


# The curves of the keyframes that are not edited, faintly in the page: pale to dark as time goes on.

OTHER_PIECES = 64
"""Straight pieces that a curve is drawn with."""

PALE = 0.1
"""Share of white in their colours."""


class OtherCurves:
    """The curves of the keyframes that are not edited.

    Args:
        server: the page.
        arm: the arm.
        wanted: whether they are to be seen.
    """

    def __init__(self, server: viser.ViserServer, arm: Arm, wanted: Callable[[], bool]) -> None:
        self._arm, self._wanted = arm, wanted
        self._drawn: dict[int, tuple[Keyframe, Array]] = {}
        self._shown: tuple[Keyframe, ...] = ()
        self._selected = -1
        self._lines = server.scene.add_line_segments(
            "/curve/others",
            np.zeros((1, 2, 3)),
            np.zeros((1, 2, 3), dtype=np.uint8),
            thickness=0.45 * link_radius(arm),
            visible=False,
        )

    def show(self, session: Session, live: Live) -> None:
        """Bring them up to date."""
        del live
        keyframes = keyframes_of(session.task)
        visible = self._wanted()
        if visible and (keyframes is not self._shown or session.selected != self._selected):
            self._shown, self._selected = keyframes, session.selected
            self._draw(keyframes, session.selected)
        if self._lines.visible != visible:
            self._lines.visible = visible

    def _draw(self, keyframes: tuple[Keyframe, ...], selected: int) -> None:
        before, self._drawn = self._drawn, {}
        for each in keyframes:  # kept with its line, so that its id stays its own
            self._drawn[id(each)] = before.get(id(each)) or (each, _line(self._arm, each))
        others = [index for index in range(len(keyframes)) if index != selected]
        lines = np.stack([self._drawn[id(keyframes[index])][1] for index in others])
        shades = [palette.mixed(palette.in_time(k / (len(keyframes) - 1)), "#FFFFFF", PALE) for k in others]
        colors = np.array([color(shade) for shade in shades], dtype=np.uint8)
        ends = np.stack([lines[:, :-1], lines[:, 1:]], axis=2).reshape(-1, 2, 3)
        self._lines.points = ends.astype(np.float32)
        self._lines.colors = np.repeat(np.repeat(colors, OTHER_PIECES, axis=0)[:, None], 2, axis=1)


def _line(arm: Arm, keyframe: Keyframe) -> Array:
    """Places along the curve of a keyframe, as far as the arm needs it, (PIECES + 1, 3) [m]."""
    laid = lay(arm, keyframe.curve, keyframe.placement, keyframe.roll)
    return np.asarray(laid.at(np.linspace(0.0, min(laid.length, required_length(arm)), OTHER_PIECES + 1)))


# The tab for the curve: its control points in numbers, more of them, fewer.

DIGITS = 4
"""Digits behind the point of coordinates [m]."""


class ShapeTab:
    """Controls for the curve of the keyframe that is edited.

    Args:
        server: the page; the controls are made where it is at.
        post: leaves a request for the loop.
    """

    def __init__(self, server: viser.ViserServer, post: Post) -> None:
        self._post, gui = post, server.gui
        self._index, self._keyframe = 0, 0
        self._point = gui.add_dropdown("Control point", ("none",), hint="Or click on one in the picture")
        place = gui.add_vector3("x, y, z [m]", (0.0, 0.0, 0.0), step=0.001, hint="In the world")
        self._place = Typed(place, self._typed, preview=True)
        self._edit = gui.add_button_group("Point", ("Insert after", "Delete"))
        on_change(self._point, self._selected)
        on_choice(self._edit, self._edited)

    def show(self, session: Session, live: Live) -> None:
        """Bring it up to date."""
        del live
        count = len(session.shape.points)
        names = ("none", *(f"{k + 1}" + _where(k, count) for k in range(count)))
        if self._point.options != names:
            self._point.options = names
        handle = session.handle
        put(self._point, value="none" if handle is None else names[handle + 1])
        if handle is not None and (handle, session.selected) != (self._index, self._keyframe):
            self._place.finish()  # it was meant for the one before
            self._index, self._keyframe = handle, session.selected
        place = session.shape.points[self._index] if handle is not None else self._place.control.value
        shown = tuple(round(float(x), DIGITS) for x in place)
        self._place.show(shown, disabled=handle is None or handle == 0)

    def _selected(self, name: str) -> None:
        self._post(partial(select_point, None if name == "none" else int(name.split(maxsplit=1)[0]) - 1))

    def _typed(self, place: tuple[float, float, float], final: bool) -> None:
        index, keyframe = self._index, self._keyframe

        def request(session: Session) -> None:
            if session.selected == keyframe:
                chosen = session.handle  # perhaps another by now
                move_point(index, np.array(place), final, session)
                session.handle = chosen

        self._post(request, "" if final else "move")

    def _edited(self, what: str) -> None:
        self._post(insert_point if what == "Insert after" else delete_point)


def insert_point(session: Session) -> None:
    """Propose one more control point behind the selected one, or behind the last but one."""
    after = session.handle if session.handle is not None else max(len(session.shape.points) - 2, 0)

    def change(arm: Arm, shape: Shape) -> Shape:
        return shape.inserted(arm, after)

    session.reshape(change, f"inserted point {after + 2}")
    session.handle = after + 1 if session.proposal is not None else session.handle


def delete_point(session: Session) -> None:
    """Propose the curve without the selected control point."""
    index = session.handle
    if index is None:
        session.say("no control point is selected: click on one first", "warning")
        return

    def change(arm: Arm, shape: Shape) -> Shape:
        return shape.removed(arm, index)

    session.reshape(change, f"deleted point {index + 1}")
    if session.proposal is not None:
        session.handle = max(index - 1, 1)


def _where(index: int, count: int) -> str:
    return " (base)" if index == 0 else " (end)" if index == count - 1 else ""
