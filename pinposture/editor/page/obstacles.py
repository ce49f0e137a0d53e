"""The obstacles in the page, to be dragged: each by the mouse, the selected one by axes and handles too."""

from __future__ import annotations

from functools import partial
from typing import Any, NamedTuple

import numpy as np
import viser
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from pinposture.arm import Arm
from pinposture.collision import Box, Capsule, Cylinder, HalfSpace, Mesh, Obstacle, Sphere
from pinposture.editor.live import Live
from pinposture.editor.obstacle_edits import obstacles_of, rearrange, select_obstacle
from pinposture.editor.obstacle_handles import Measures, Pose, at_pose, grips, moved, pose_of, pulled, reach
from pinposture.editor.page.part import Post, color
from pinposture.editor.session import Session
from pinposture.viz import palette
from pinposture.viz.drawing import MANY, link_radius
from pinposture.viz.mesh import TriangleMesh as Surface
from pinposture.viz.mesh import surface

Array = NDArray[np.float64]

SIZE = 2.0
"""Radius of a handle, relative to that of the bars of the arm."""

AXES = 0.16
"""Least size of the axes by which the selected one is moved and turned, relative to the arm."""

OUT = 1.5
"""How far these axes reach, relative to the obstacle."""

PLATE = 1.6
"""Width of the plate that stands for a half-space, relative to the arm."""

THICKNESS = 0.01
"""Thickness of that plate, relative to the arm."""

SELECTED = palette.mixed(palette.OBSTACLE, palette.START, 0.55)
"""The obstacle that is selected."""


HANDLE = palette.SPARE[1]
"""What its size is changed by: other than the control points of the curve."""


class Drawn(NamedTuple):
    """An obstacle in the page.

    Attributes:
        handle: what draws it, in its own frame.
        obstacle: as it is drawn.
        look: what its surface depends on.
    """

    handle: viser.MeshHandle
    obstacle: Obstacle
    look: tuple[object, ...]


class Obstacles:
    """The obstacles of the scene. A half-space is moved by its handle only.

    Args:
        server: the page.
        arm: the arm.
        post: leaves a request for the loop.
    """

    def __init__(self, server: viser.ViserServer, arm: Arm, post: Post) -> None:
        self._server, self._arm, self._post = server, arm, post
        self._measures = Measures.of(arm)
        self._drawn: dict[str, Drawn] = {}
        self._made = 0
        self._name = ""  # of the one that axes and handles belong to
        self._led = False  # whether the axes are dragged
        self._taken: dict[str, Array] = {}  # where what is dragged was taken hold of
        self._axes = server.scene.add_transform_controls(
            "/obstacle_axes", scale=AXES * arm.length, disable_sliders=True, depth_test=False, visible=False
        )
        self._axes.on_update(self._on_axes)
        self._balls = [self._ball(k) for k in range(3)]

    def show(self, session: Session, live: Live) -> None:
        """Bring them up to date."""
        del live
        listed = obstacles_of(session.shown)
        for name in [name for name in self._drawn if name not in listed]:
            self._drawn.pop(name).handle.remove()
        opacity = palette.SHEER if len(listed) > MANY else palette.SEE_THROUGH
        for name, obstacle in listed.items():
            self._draw(name, obstacle, opacity, name == session.obstacle)
        # Hands are either at the curve or at an obstacle.
        chosen = (
            None if session.handle is not None or session.obstacle is None else listed.get(session.obstacle)
        )
        self._put_axes(session.obstacle or "", chosen)
        self._put_balls(chosen)

    def _draw(self, name: str, obstacle: Obstacle, opacity: float, selected: bool) -> None:
        drawn, shade = self._drawn.get(name), color(SELECTED if selected else palette.OBSTACLE)
        if drawn is None or drawn.obstacle is not obstacle:
            look, pose = _look(obstacle), pose_of(obstacle, self._measures)
            if drawn is not None and drawn.look[0] != look[0]:  # of another task
                drawn.handle.remove()
                drawn = None
            if drawn is None or drawn.look != look:
                shape = self._surface(obstacle)
                if drawn is None:
                    handle = self._add(name, shape, opacity, not isinstance(obstacle, HalfSpace))
                else:
                    handle = drawn.handle
                    handle.vertices = shape.vertices.astype(np.float32)
                    handle.faces = shape.faces.astype(np.uint32)
            else:
                handle = drawn.handle
            handle.position, handle.wxyz = pose.position, _quaternion(pose.rotation)
            self._drawn[name] = Drawn(handle, obstacle, look)
        handle = self._drawn[name].handle
        if tuple(handle.color) != shade:
            handle.color = shade
        if handle.opacity != opacity:
            handle.opacity = opacity

    def _add(self, name: str, shape: Surface, opacity: float, draggable: bool) -> viser.MeshHandle:
        self._made += 1
        handle = self._server.scene.add_mesh_simple(
            f"/obstacles/{self._made}",
            shape.vertices,
            shape.faces,
            color=color(palette.OBSTACLE),
            opacity=opacity,
            cast_shadow=False,
            receive_shadow=False,
        )
        handle.on_click(partial(self._on_click, name))
        if draggable:  # a floor is large: the mouse turns the view there
            handle.on_drag(partial(self._on_drag, name))
        return handle

    def _surface(self, obstacle: Obstacle) -> Surface:
        """The surface of an obstacle in its own frame."""
        if isinstance(obstacle, HalfSpace):
            width, thick = PLATE * self._arm.length, THICKNESS * self._arm.length
            return surface(Box((0.0, 0.0, -0.5 * thick), (width, width, thick)))
        middle = at_pose(obstacle, Pose(np.zeros(3), np.eye(3)))
        assert not isinstance(middle, HalfSpace)
        return surface(middle)

    def _ball(self, index: int) -> viser.IcosphereHandle:
        """A handle; it is shown where it is needed."""
        ball = self._server.scene.add_icosphere(
            f"/obstacle_handles/{index}",
            SIZE * link_radius(self._arm),
            color(HANDLE),
            subdivisions=2,
            cast_shadow=False,
            visible=False,
        )
        ball.on_drag(partial(self._on_pull, index))
        return ball

    def _put_axes(self, name: str, obstacle: Obstacle | None) -> None:
        visible, axes = obstacle is not None, self._axes
        if obstacle is not None and not self._led:
            self._name = name
            pose = pose_of(obstacle, self._measures)
            if not np.allclose(axes.position, pose.position, atol=1e-9):
                axes.position = pose.position
            if not _same_turn(obstacle, axes.wxyz, pose.rotation):
                axes.wxyz = _quaternion(pose.rotation)
            scale = max(AXES * self._arm.length, OUT * min(reach(obstacle), 0.4 * self._arm.length))
            if abs(axes.scale - scale) > 1e-9:
                axes.scale = scale
            if axes.disable_rotations != isinstance(obstacle, Sphere):
                axes.disable_rotations = isinstance(obstacle, Sphere)
        if axes.visible != visible:
            axes.visible = visible

    def _put_balls(self, obstacle: Obstacle | None) -> None:
        listed = () if obstacle is None else grips(obstacle, self._measures)
        for index, ball in enumerate(self._balls):
            visible = index < len(listed)
            if visible and not np.allclose(ball.position, listed[index].place, atol=1e-9):
                ball.position = listed[index].place
            if ball.visible != visible:
                ball.visible = visible

    async def _on_click(self, name: str, _: Any) -> None:
        self._post(partial(select_obstacle, name))

    async def _on_drag(self, name: str, event: Any) -> None:
        key, end = f"move {name}", np.asarray(event.end_position)
        if event.phase == "start" or key not in self._taken:
            self._taken[key] = np.asarray(event.start_position)
        shift = end - self._taken[key]
        self._request(key, name, partial(_shifted, shift), f"moved {name}", event.phase == "end")

    async def _on_pull(self, index: int, event: Any) -> None:
        key, ball = f"pull {index}", self._balls[index]
        if event.phase == "start" or key not in self._taken:
            self._taken[key] = np.asarray(event.start_position) - ball.position
        place = np.asarray(event.end_position) - self._taken[key]
        change = partial(_pulled, index, place, self._measures)
        self._request(key, self._name, change, f"resized {self._name}", event.phase == "end")

    async def _on_axes(self, event: Any) -> None:
        if event.client_id is None or (event.phase != "start" and not self._led):
            return
        turn = Rotation.from_quat(np.asarray(self._axes.wxyz)[[1, 2, 3, 0]]).as_matrix()
        pose, final = Pose(np.array(self._axes.position), turn), event.phase == "end"
        self._led = not final
        if event.phase != "start":
            self._request("axes", self._name, partial(_posed, pose), f"moved {self._name}", final)

    def _request(self, key: str, name: str, change: Any, what: str, final: bool) -> None:
        if final:
            self._taken.pop(key, None)
        self._post(partial(rearrange, name, change, what, final), "" if final else "obstacle")


def _shifted(shift: Array, obstacle: Obstacle) -> Obstacle:
    return moved(obstacle, shift)


def _posed(pose: Pose, obstacle: Obstacle) -> Obstacle:
    return at_pose(obstacle, pose)


def _pulled(index: int, place: Array, measures: Measures, obstacle: Obstacle) -> Obstacle:
    return pulled(obstacle, grips(obstacle, measures)[index].name, place, measures)


def _look(obstacle: Obstacle) -> tuple[object, ...]:
    """What the surface of an obstacle depends on in its own frame."""
    if isinstance(obstacle, Sphere):
        return obstacle.type, obstacle.radius
    if isinstance(obstacle, Box):
        return obstacle.type, obstacle.size
    if isinstance(obstacle, Mesh):
        return obstacle.type, obstacle.vertices
    if isinstance(obstacle, HalfSpace):
        return (obstacle.type,)
    length = float(np.linalg.norm(np.subtract(obstacle.end, obstacle.start)))
    return obstacle.type, obstacle.radius, round(length, 6)


def _same_turn(obstacle: Obstacle, wxyz: Array, turn: Array) -> bool:
    """Whether axes are turned as an obstacle is; how they are turned about its only axis says nothing."""
    own = Rotation.from_quat(np.asarray(wxyz)[[1, 2, 3, 0]]).as_matrix()
    if isinstance(obstacle, (Capsule, Cylinder, HalfSpace)):
        return bool(np.allclose(own[:, 2], turn[:, 2], atol=1e-5))
    return bool(np.allclose(own, turn, atol=1e-7))


def _quaternion(turn: Array) -> Array:
    """A turn as a quaternion w, x, y, z, (4,)."""
    return np.asarray(Rotation.from_matrix(turn).as_quat()[[3, 0, 1, 2]])
