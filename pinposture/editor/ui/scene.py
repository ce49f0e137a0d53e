"""Obstacles and clearance in the page, and their tab."""

from __future__ import annotations

from functools import partial
from html import escape
from typing import Any, NamedTuple

import numpy as np
import pinocchio as pin
import viser
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from pinposture.arm import Arm
from pinposture.collision import Box, Capsule, Cylinder, HalfSpace, Mesh, Obstacle, Scene, Sphere
from pinposture.editor.clearances import NearestObstacle
from pinposture.editor.edits import with_scene
from pinposture.editor.obstacles import (
    NEW_OBSTACLE_KINDS,
    ArmScale,
    Pose,
    add_obstacle,
    at_pose,
    bounding_radius,
    change_obstacle,
    delete_obstacle,
    edit_obstacle,
    moved,
    obstacles_of,
    pose_of,
    rename_obstacle,
    resized,
    select_obstacle,
    size_handles,
)
from pinposture.editor.session import Session
from pinposture.editor.solver import Live
from pinposture.editor.surroundings import ScanShelf
from pinposture.editor.ui.parts import Post, Typed, color, on_change, on_choice, on_click, put
from pinposture.editor.ui.scans import ScanControls
from pinposture.viz import palette
from pinposture.viz.drawing import MANY, link_radius
from pinposture.viz.mesh import TriangleMesh as Surface
from pinposture.viz.mesh import surface

# The obstacles in the page, to be dragged: each by the mouse, the selected one by axes and handles too.

Array = NDArray[np.float64]

SIZE = 2.0
"""Radius of a handle, relative to that of the bars of the arm."""

AXES = 0.16
"""Least size of the axes by which the selected one is moved and turned, relative to the arm."""

OUT = 1.5
"""How far these axes bounding_radius, relative to the obstacle."""

PLATE = 1.6
"""Width of the plate that stands for a half-space, relative to the arm."""

THICKNESS = 0.01
"""Thickness of that plate, relative to the arm."""

SELECTED = palette.mixed(palette.OBSTACLE, palette.START, 0.55)
"""The obstacle that is selected."""


HANDLE = palette.SPARE[1]
"""What its size is changed by: other than the control points of the curve."""


class DrawnObstacle(NamedTuple):
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
        self._measures = ArmScale.of(arm)
        self._drawn: dict[str, DrawnObstacle] = {}
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
            self._drawn[name] = DrawnObstacle(handle, obstacle, look)
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
            scale = max(AXES * self._arm.length, OUT * min(bounding_radius(obstacle), 0.4 * self._arm.length))
            if abs(axes.scale - scale) > 1e-9:
                axes.scale = scale
            if axes.disable_rotations != isinstance(obstacle, Sphere):
                axes.disable_rotations = isinstance(obstacle, Sphere)
        if axes.visible != visible:
            axes.visible = visible

    def _put_balls(self, obstacle: Obstacle | None) -> None:
        listed = () if obstacle is None else size_handles(obstacle, self._measures)
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
        self._post(partial(change_obstacle, name, change, what, final), "" if final else "obstacle")


def _shifted(shift: Array, obstacle: Obstacle) -> Obstacle:
    return moved(obstacle, shift)


def _posed(pose: Pose, obstacle: Obstacle) -> Obstacle:
    return at_pose(obstacle, pose)


def _pulled(index: int, place: Array, measures: ArmScale, obstacle: Obstacle) -> Obstacle:
    return resized(obstacle, size_handles(obstacle, measures)[index].name, place, measures)


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


# Where the arm is nearest to what is around it, as a line in the page.

COLORS = {"inside": palette.MARK, "within the margin": palette.ACTIVE, "clear": palette.REGULAR}
"""Colours of the line, by how near it is."""

FAR = 0.5
"""How far something may be that a line leads to, relative to the arm."""


class ClearanceLine:
    """A line from the arm to what it is nearest to.

    Args:
        server: the page.
        arm: the arm.
    """

    def __init__(self, server: viser.ViserServer, arm: Arm) -> None:
        self._far, radius = FAR * arm.length, link_radius(arm)
        self._line = server.scene.add_line_segments(
            "/clearance/line",
            np.zeros((1, 2, 3)),
            color(palette.REGULAR),
            thickness=0.6 * radius,
            visible=False,
        )
        self._ends = [
            server.scene.add_icosphere(
                f"/clearance/end_{k + 1}",
                0.8 * radius,
                color(palette.REGULAR),
                subdivisions=1,
                cast_shadow=False,
                visible=False,
            )
            for k in range(2)
        ]
        self._shown: NearestObstacle | None = None

    def show(self, session: Session, live: Live) -> None:
        """Bring it up to date."""
        del live
        found = session.nearest
        if found is self._shown:
            return
        self._shown = found
        visible = found is not None and found.distance < self._far
        if found is not None and visible:
            places = np.array([found.on_arm, found.on_other])
            self._line.points = places[None].astype(np.float32)
            shade = color(COLORS[found.level])
            self._line.colors = np.array([[shade, shade]], dtype=np.uint8)
            for ball, place in zip(self._ends, places, strict=True):
                ball.position = place
                ball.color = shade
        for node in (self._line, *self._ends):
            if node.visible != visible:
                node.visible = visible


def clearance_text(found: NearestObstacle | None) -> str:
    """A clearance in words."""
    if found is None:
        return "nothing to be near to"
    size = f"{1000.0 * abs(found.distance):.3g} mm"
    if found.distance < 0.0:
        return f"{found.body} is {size} inside {found.other}"
    less = (
        f", less than the margin of {1000.0 * found.margin:.3g} mm" if found.distance < found.margin else ""
    )
    return f"{size} from {found.body} to {found.other}{less}"


# The tab for what is around the arm: obstacles in numbers, what to keep from them, how near they are.

LABELS = {
    "Sphere": "sphere",
    "Box": "box",
    "Cylinder": "cylinder",
    "Capsule": "capsule",
    "Half-space": "half_space",
}
"""What the buttons say, and what they make."""

DIGITS = 4
"""Digits behind the point of coordinates [m]; two of angles [deg]."""

assert set(LABELS.values()) == set(NEW_OBSTACLE_KINDS)

VECTORS = {
    "center": ("Centre [m]", "Of the obstacle, in the world"),
    "start": ("Start [m]", "Middle of one end, in the world"),
    "end": ("End [m]", "Middle of the other end"),
    "point": ("Point [m]", "Any point of its surface"),
    "normal": ("Normal", "Away from the solid, to the side that is free"),
    "size": ("Size [m]", "Edges along its own axes"),
    "rotation": ("Turned [deg]", "Roll, pitch, yaw"),
}
"""Values of three numbers, what they are called, and what there is to say of them."""


class SceneTab:
    """Controls for what is around the arm.

    Args:
        server: the page; the controls are made where it is at.
        scans: what reads scans.
        post: leaves a request for the loop.
    """

    def __init__(self, server: viser.ViserServer, scans: ScanShelf, post: Post) -> None:
        self._post, gui = post, server.gui
        self._points = np.zeros((0, 3))
        self._name = ""
        self._about = gui.add_html("")
        self._add = gui.add_button_group(
            "Add", tuple(LABELS), hint="Beside the arm; then drag it where you want it"
        )
        self._chosen = gui.add_dropdown("Obstacle", ("none",), hint="Or click on one in the picture")
        self._called = Typed(gui.add_text("Name", "", visible=False), self._renamed)
        self._vectors = {
            key: Typed(
                gui.add_vector3(
                    label, (0.0, 0.0, 0.0), step=1.0 if key == "rotation" else 0.005, hint=hint, visible=False
                ),
                partial(self._typed, key),
                preview=True,
            )
            for key, (label, hint) in VECTORS.items()
        }
        self._radius = Typed(
            gui.add_number("Radius [m]", 0.0, min=0.0, step=0.005, visible=False),
            partial(self._typed, "radius"),
            preview=True,
        )
        self._delete = gui.add_button("Delete", icon=viser.Icon.TRASH, visible=False)
        with gui.add_folder("Keep clear"):
            self._margin = Typed(
                gui.add_number(
                    "Margin [m]", 0.0, min=0.0, step=0.001, hint="Distance to keep from obstacles"
                ),
                self._margin_typed,
            )
            self._itself = gui.add_checkbox(
                "Self-collision", False, hint="Whether the arm is to keep clear of itself, too"
            )
            self._thick = Typed(
                gui.add_number(
                    "Arm radius [m]",
                    0.0,
                    min=0.0,
                    step=0.001,
                    hint="Taken for that of its links; 0: as described",
                ),
                self._thickness_typed,
            )
        with gui.add_folder("Meshes and scans", expand_by_default=False):
            self._scans = ScanControls(server, scans, post)
        on_choice(self._add, self._added)
        on_change(self._chosen, self._select)
        on_click(self._delete, lambda: post(delete_obstacle))
        on_change(self._itself, self._itself_too)

    def show(self, session: Session, live: Live) -> None:
        """Bring it up to date."""
        places = [live.state.points] if live.target is None else [live.state.points, live.target.points[::-1]]
        self._points = np.vstack(places)
        listed, scene = obstacles_of(session.shown), session.shown.scene or Scene()
        names = ("none", *listed)
        if tuple(self._chosen.options) != names:
            self._chosen.options = names
        name = session.obstacle if session.obstacle in listed else None
        put(self._chosen, value=name or "none")
        if (name or "") != self._name:
            for typed in (self._called, self._radius, *self._vectors.values()):
                typed.finish()  # it was meant for the one before
            self._name = name or ""
        self._show_values(listed.get(self._name))
        self._margin.show(round(scene.margin, 6))
        put(self._itself, value=scene.self_collision)
        self._thick.show(0.0 if scene.arm_radius is None else round(scene.arm_radius, 6))
        put(self._about, content=_about(session))
        self._scans.show(session)

    def _show_values(self, obstacle: Obstacle | None) -> None:
        """Show the values that the selected obstacle has."""
        self._called.show(self._name, visible=obstacle is not None)
        put(self._delete, visible=obstacle is not None)
        for key, typed in self._vectors.items():
            own = None if obstacle is None else getattr(obstacle, key, None)
            typed.show(_told(key, own) if own is not None else typed.control.value, visible=own is not None)
        radius = getattr(obstacle, "radius", None)
        self._radius.show(
            round(radius, DIGITS + 1) if radius is not None else 0.0, visible=radius is not None
        )

    def _added(self, label: str) -> None:
        self._post(partial(add_obstacle, LABELS[label], self._points))

    def _select(self, name: str) -> None:
        self._post(partial(select_obstacle, None if name == "none" else name))

    def _renamed(self, to: str, final: bool) -> None:
        if final:
            self._post(partial(rename_obstacle, self._name, to))

    def _typed(self, key: str, value: Any, final: bool) -> None:
        if key == "rotation":
            value = tuple(np.radians(value))
        elif key == "radius":
            value = float(value)
        self._post(partial(edit_obstacle, self._name, key, value, final), "" if final else "obstacle")

    def _margin_typed(self, value: float, final: bool) -> None:
        if final:
            edit = with_scene(margin=float(value))
            self._post(lambda session: session.edit(edit, f"margin {1000.0 * value:.4g} mm"))

    def _thickness_typed(self, value: float, final: bool) -> None:
        if final:
            edit = with_scene(arm_radius=float(value) if value > 0.0 else None)
            text = f"arm radius {1000.0 * value:.4g} mm" if value > 0.0 else "arm as thick as described"
            self._post(lambda session: session.edit(edit, text))

    def _itself_too(self, value: bool) -> None:
        text = "the arm keeps clear of itself" if value else "the arm may touch itself"
        self._post(lambda session: session.edit(with_scene(self_collision=value), text))


def _told(key: str, value: Any) -> tuple[float, ...]:
    """Three numbers as they are shown."""
    if key == "rotation":
        angles = np.degrees(pin.rpy.matrixToRpy(np.array(value)))
        return tuple(round(float(each), 2) + 0.0 for each in angles)
    return tuple(round(float(each), DIGITS) + 0.0 for each in value)


def _about(session: Session) -> str:
    found = session.nearest
    shade = palette.QUIET if found is None else COLORS[found.level]
    return (
        '<div style="font-size:13px;line-height:1.35;padding:2px 10px 4px 10px">'
        f'<div id="clearance" style="border-left:4px solid {shade};padding-left:8px">'
        f"<b>Clearance</b><br>{escape(clearance_text(found))}</div></div>"
    )
