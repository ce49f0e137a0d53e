"""Control points of the curve in the page, dragged by the mouse; the selected one along axes, too."""

from __future__ import annotations

from functools import partial
from typing import Any

import numpy as np
import viser
from numpy.typing import NDArray

from pinposture.arm import Arm
from pinposture.editor.live import Live
from pinposture.editor.page.part import Post, color
from pinposture.editor.session import Session
from pinposture.editor.shape import Shape
from pinposture.viz import palette
from pinposture.viz.drawing import link_radius

Array = NDArray[np.float64]

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
