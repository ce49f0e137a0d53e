"""Obstacles, scans and the clearance in the page, and the Scene tab."""

from __future__ import annotations

from functools import partial
from html import escape
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import pinocchio as pin
import viser
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from pinposture.arm import Arm
from pinposture.collision import Box, Obstacle
from pinposture.collision.obstacles import OBSTACLE_TYPES
from pinposture.collision.scan import Scan
from pinposture.collision.shapes import number_fields
from pinposture.editor import obstacles
from pinposture.editor.edits import with_scene
from pinposture.editor.files import within
from pinposture.editor.session import NearestObstacle, Session
from pinposture.editor.solver import Live
from pinposture.editor.surroundings import ScanShelf, remove_scan
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
    framed_html,
    on_choice,
    on_click,
    put,
    put_at,
    quaternions,
)
from pinposture.units import length_text
from pinposture.viz import palette
from pinposture.viz.body import TriangleMesh as Surface
from pinposture.viz.body import surface
from pinposture.viz.drawing import DRAWING, link_radius
from pinposture.viz.palette import THEME


class Scans:
    """The scans of the task in the page."""

    def __init__(self, server: viser.ViserServer, arm: Arm, shelf: ScanShelf) -> None:
        self._server = server
        self._shelf = shelf
        self._size = OBSTACLES.scan_point * arm.length
        self._drawn: dict[Path, tuple[Scan, viser.MeshHandle | viser.PointCloudHandle | Any]] = {}
        self._made = 0

    def show(self, session: Session, _: Live) -> None:
        """Bring them up to date."""
        listed = self._shelf.of(session.task)
        for path in [path for path, (scan, _) in self._drawn.items() if listed.get(path) is not scan]:
            self._drawn.pop(path)[1].remove()
        for path, scan in listed.items():
            if path not in self._drawn:
                self._made += 1
                self._drawn[path] = scan, self._draw(self._shelf.shown(path))

    def _draw(self, scan: Scan) -> Any:
        name = f"/scans/{self._made}"
        scene = self._server.scene
        if scan.faces is None:
            colors: Any = color(OBSTACLES.scan_color) if scan.colors is None else scan.colors
            return scene.add_point_cloud(
                name,
                scan.points.astype(np.float32),
                colors,
                point_size=self._size,
                point_shape="circle",
                precision="float32",
            )
        if scan.colors is None:
            return scene.add_mesh_simple(
                name,
                scan.points,
                scan.faces,
                color=color(OBSTACLES.scan_color),
                opacity=OBSTACLES.scan_opacity,
                side="double",
                cast_shadow=False,
            )
        import trimesh  # here, because most tasks need no scans

        surface = trimesh.Trimesh(scan.points, scan.faces, vertex_colors=scan.colors, process=False)
        return scene.add_mesh_trimesh(name, surface, cast_shadow=False)


class ScanControls:
    """Controls that load scans and meshes."""

    def __init__(self, server: viser.ViserServer, shelf: ScanShelf, post: Post) -> None:
        self._shelf = shelf
        self._post = post
        gui = server.gui
        self._folder: Path | None = None
        gui.add_markdown(
            "A **scan** (a mesh or points) is shown with its clearance, but the arm does **not** avoid it. "
            "An **obstacle** it avoids, and it can move within its cavities."
        )
        self._kind = gui.add_dropdown("Load as", ("scan", "obstacle"), hint="Files: .ply .xyz .npy .stl .obj")
        hint = "Scale factor of an obstacle: 0.001 for a file in millimetres"
        self._scale = gui.add_number("scale", 1.0, min=0.0, step=0.001, hint=hint, visible=False)
        self._path = gui.add_text("File", "", hint="File name, relative to the folder of the task")
        load = gui.add_button("Load", icon=viser.Icon.FOLDER_OPEN)
        hint = "The file is stored next to the task file"
        upload = gui.add_upload_button("Upload", icon=viser.Icon.UPLOAD, hint=hint)
        self._listed = gui.add_dropdown("Scans", ("none",), visible=False)
        self._remove = gui.add_button_group("Scan", ("Remove",), visible=False)
        self._paths: dict[str, Path] = {}
        on_click(load, self._load)
        upload.on_upload(self._upload)
        on_choice(self._remove, self._remove_chosen)

    def show(self, session: Session) -> None:
        """Bring them up to date."""
        self._folder = None if session.path is None else session.path.absolute().parent
        names = [path.name for path in session.task.scans]
        self._paths = {
            path.name if names.count(path.name) == 1 else str(path): path for path in session.task.scans
        }
        options = tuple(self._paths) or ("none",)
        if tuple(self._listed.options) != options:
            self._listed.options = options
        put(self._listed, visible=bool(self._paths))
        put(self._remove, visible=bool(self._paths))
        put(self._scale, visible=self._kind.value == "obstacle")

    def _load(self) -> None:
        text = self._path.value.strip()
        if not text:
            self._post(lambda session: session.say("no file name: enter one", "warning"))
            return
        avoided = self._kind.value == "obstacle"
        scale = float(self._scale.value)

        def request(session: Session) -> None:
            path = within(session.folder, text, None if session.path is None else session.path.parent)
            if avoided:
                self._shelf.add_obstacle(path, scale)
            else:
                self._shelf.add_scan(path)

        self._post(request)

    async def _upload(self, event: Any) -> None:
        file = event.target.value
        avoided = self._kind.value == "obstacle"
        self._shelf.upload(file.name, file.content, self._folder, float(self._scale.value), avoided)

    def _remove_chosen(self, _: str) -> None:
        path = self._paths.get(self._listed.value)
        if path is not None:
            self._post(partial(remove_scan, path))


Array = NDArray[np.float64]


class ObstacleLook(NamedTuple):
    """How obstacles, scans and handles are drawn, with sizes relative to the arm, and their fields."""

    handle_radius: float = 2.0
    """Radius of a handle, relative to that of the bars of the arm."""

    least_axes: float = 0.16
    """Smallest size of the axes that move and turn the selected obstacle."""

    axes_reach: float = 1.5
    """Size of these axes, relative to the obstacle."""

    plate_width: float = 1.6
    """Width of the plate drawn for a half-space."""

    plate_thickness: float = 0.01
    """Thickness of that plate."""

    selected_color: str = palette.mixed(THEME.obstacle, THEME.start, 0.55)
    """Colour of the selected obstacle."""

    handle_color: str = THEME.spare[1]
    """Colour of handles; differs from that of the control points of the curve."""

    longest_line: float = 0.5
    """Length of the line that shows the clearance, at most."""

    scan_point: float = 0.003
    """Size of the points of scans."""

    scan_color: str = palette.mixed(THEME.obstacle, "#FFFFFF", 0.35)
    """Colour of a scan without colours of its own."""

    scan_opacity: float = 0.6
    """Opacity of the surface of a scan, which may stand in front of the arm."""

    direction_digits: int = 4
    angle_digits: int = 2
    """Digits behind the point in fields of directions, and of angles [deg]."""

    finer_digits: int = 3
    """How many more radii and margins have than coordinates: they are small."""


OBSTACLES = ObstacleLook()

CLEARANCE_COLORS = {"inside": THEME.mark, "within the margin": THEME.active, "clear": THEME.regular}

VECTOR_LABELS = {
    "center": ("Centre [mm]", "World frame"),
    "start": ("Start [mm]", "Centre of one end, world frame"),
    "end": ("End [mm]", "Centre of the other end"),
    "point": ("Point [mm]", "Any point on its surface"),
    "normal": ("Normal", "Points out of the solid"),
    "size": ("Size [mm]", "Edges along its own axes"),
    "rotation": ("Rotation [deg]", "Roll, pitch, yaw"),
}
"""Labels and hints of values of three numbers, by attribute."""


def number_labels() -> dict[str, str]:
    """Return the labels of the numbers that obstacles have, with their units, by attribute."""
    labels: dict[str, str] = {}
    for kind in obstacles.new_obstacle_kinds():
        for field in number_fields(OBSTACLE_TYPES[kind]):
            words = field.name.replace("_", " ").capitalize()
            labels.setdefault(field.name, f"{words} [{field.metadata.get('unit', 'mm')}]")
    return labels


class DrawnObstacle(NamedTuple):
    """An obstacle in the page."""

    handle: viser.MeshHandle  # what draws it, in its own frame
    obstacle: Obstacle  # as it is drawn
    look: Obstacle  # in its own frame
    carried: bool = False  # whether it is drawn where the arm has it in a motion


class Obstacles:
    """The obstacles of the scene, dragged by the mouse; the selected one by axes and handles, too.

    A half-space is moved by its handle only.
    """

    def __init__(self, server: viser.ViserServer, arm: Arm, post: Post) -> None:
        self._server = server
        self._arm = arm
        self._post = post
        self._scale = obstacles.ArmScale.of(arm)
        self._drawn: dict[str, DrawnObstacle] = {}
        self._made = 0
        self._name = ""  # of the obstacle with axes and handles
        self._axes = add_axes(server, "/obstacle_axes", OBSTACLES.least_axes * arm.length, rotations=True)
        self._axes_drag = Drag(post, self._axes, self._move_by_axes)
        self._balls: list[viser.IcosphereHandle] = []
        for index in range(3):
            ball = server.scene.add_icosphere(
                f"/obstacle_handles/{index}",
                OBSTACLES.handle_radius * link_radius(arm),
                color(OBSTACLES.handle_color),
                subdivisions=2,
                cast_shadow=False,
                visible=False,
            )
            Drag(post, ball, partial(self._resize, index))
            self._balls.append(ball)

    def show(self, session: Session, _: Live) -> None:
        """Bring them up to date."""
        listed = obstacles.obstacles_of(session.shown)
        for name in [name for name in self._drawn if name not in listed]:
            self._drawn.pop(name).handle.remove()
        opacity = THEME.sheer if len(listed) > DRAWING.many_obstacles else THEME.see_through
        carried = session.playback.carried
        for name, obstacle in listed.items():
            self._draw(name, obstacle, opacity, name == session.obstacle)
            self._carry(name, carried.get(name))
        # Either a control point of the curve is selected, or an obstacle.
        chosen = session.obstacle
        selected = None if session.handle is not None or chosen is None else listed.get(chosen)
        self._show_axes(chosen or "", selected)
        handles = () if selected is None else obstacles.size_handles(selected, self._scale)
        for index, ball in enumerate(self._balls):
            if index < len(handles):
                put_at(ball, handles[index].position, 1e-9)
            put(ball, visible=index < len(handles))

    def _draw(self, name: str, obstacle: Obstacle, opacity: float, selected: bool) -> None:
        drawn = self._drawn.get(name)
        if drawn is None or drawn.obstacle is not obstacle:
            look = obstacles.own_shape(obstacle, self._scale)
            pose = obstacle.pose(self._scale.middle)
            if drawn is not None and drawn.look.type != look.type:  # of another task
                drawn.handle.remove()
                drawn = None
            if drawn is None:
                handle = self._add(name, look, opacity)
            else:
                handle = drawn.handle
                if drawn.look != look:
                    shape = self._surface(look)
                    handle.vertices = shape.vertices.astype(np.float32)
                    handle.faces = shape.faces.astype(np.uint32)
            handle.position = pose.translation
            handle.wxyz = quaternions(pose.rotation)
            drawn = self._drawn[name] = DrawnObstacle(handle, obstacle, look)
        shade = color(OBSTACLES.selected_color if selected else THEME.obstacle)
        if tuple(drawn.handle.color) != shade:
            drawn.handle.color = shade
        put(drawn.handle, opacity=opacity)

    def _carry(self, name: str, pose: pin.SE3 | None) -> None:
        """Show an obstacle where the arm has it in the motion that is played; None: where it is."""
        drawn = self._drawn[name]
        if pose is None and not drawn.carried:
            return
        at = drawn.obstacle.pose(self._scale.middle) if pose is None else pose
        drawn.handle.position = at.translation
        drawn.handle.wxyz = quaternions(at.rotation)
        self._drawn[name] = drawn._replace(carried=pose is not None)

    def _add(self, name: str, obstacle: Obstacle, opacity: float) -> viser.MeshHandle:
        shape = self._surface(obstacle)
        self._made += 1
        handle = self._server.scene.add_mesh_simple(
            f"/obstacles/{self._made}",
            shape.vertices,
            shape.faces,
            color=color(THEME.obstacle),
            opacity=opacity,
            cast_shadow=False,
            receive_shadow=False,
            side="front" if obstacle.geometry.convex else "double",
        )
        handle.on_click(partial(self._on_click, name))
        if obstacle.bounded:  # a floor is large: the mouse turns the view there
            Drag(self._post, handle, partial(self._move, name))
        return handle

    def _surface(self, obstacle: Obstacle) -> Surface:
        """Return the surface of an obstacle in its own frame; of a half-space, a plate."""
        if obstacle.bounded:
            return surface(obstacle)
        width = OBSTACLES.plate_width * self._arm.length
        thick = OBSTACLES.plate_thickness * self._arm.length
        return surface(Box((0.0, 0.0, -0.5 * thick), (width, width, thick)))

    def _show_axes(self, name: str, obstacle: Obstacle | None) -> None:
        axes = self._axes
        if obstacle is not None and not self._axes_drag.held:
            self._name = name
            pose = obstacle.pose(self._scale.middle)
            put_at(axes, pose.translation, 1e-9)
            if not _same_rotation(obstacle, axes.wxyz, pose.rotation):
                axes.wxyz = quaternions(pose.rotation)
            length = self._arm.length
            radius = obstacles.bounding_radius(obstacle, self._scale)
            scale = max(OBSTACLES.least_axes * length, OBSTACLES.axes_reach * min(radius, 0.4 * length))
            if abs(axes.scale - scale) > 1e-9:
                axes.scale = scale
            put(axes, disable_rotations=obstacle.symmetry == "ball")
        put(axes, visible=obstacle is not None)

    async def _on_click(self, name: str, _: Any) -> None:
        self._post(partial(obstacles.select_obstacle, name))

    def _move(self, name: str, drag: Drag) -> Request:
        change = partial(obstacles.moved, shift=drag.position - drag.start)
        return partial(obstacles.change_obstacle, name, change, f"moved {name}", drag.ended)

    def _resize(self, index: int, drag: Drag) -> Request:
        position = drag.position
        scale = self._scale

        def change(obstacle: Obstacle) -> Obstacle:
            handle = obstacles.size_handles(obstacle, scale)[index]
            return obstacles.resized(obstacle, handle.name, position, scale)

        return partial(obstacles.change_obstacle, self._name, change, f"resized {self._name}", drag.ended)

    def _move_by_axes(self, drag: Drag) -> Request:
        pose = pin.SE3(_matrix(self._axes.wxyz), drag.position)
        change = partial(obstacles.at_pose, pose=pose, scale=self._scale)
        return partial(obstacles.change_obstacle, self._name, change, f"moved {self._name}", drag.ended)


def _same_rotation(obstacle: Obstacle, wxyz: Array, rotation: Array) -> bool:
    """Return whether axes are turned as an obstacle is, apart from turns about its axis of symmetry."""
    axes = _matrix(wxyz)
    if obstacle.symmetry == "axis":
        return bool(np.allclose(axes[:, 2], rotation[:, 2], atol=1e-5))
    return bool(np.allclose(axes, rotation, atol=1e-7))


def _matrix(wxyz: Array) -> Array:
    return np.asarray(Rotation.from_quat(wxyz, scalar_first=True).as_matrix())


class ClearanceLine:
    """A line from the arm to what it is nearest to."""

    def __init__(self, server: viser.ViserServer, arm: Arm) -> None:
        self._max_length = OBSTACLES.longest_line * arm.length
        radius = link_radius(arm)
        self._line = add_lines(server, "/clearance/line", 1, 0.6 * radius, visible=False)
        self._ends = [
            server.scene.add_icosphere(
                f"/clearance/end_{k + 1}",
                0.8 * radius,
                color(THEME.regular),
                subdivisions=1,
                cast_shadow=False,
                visible=False,
            )
            for k in range(2)
        ]
        self._shown: NearestObstacle | None = None

    def show(self, session: Session, _: Live) -> None:
        """Bring it up to date."""
        nearest = session.nearest
        if nearest is self._shown:
            return
        self._shown = nearest
        visible = nearest is not None and nearest.distance < self._max_length
        if nearest is not None and visible:
            points = np.array([nearest.on_arm, nearest.on_other])
            self._line.points = points[None].astype(np.float32)
            shade = color(CLEARANCE_COLORS[nearest.level])
            self._line.colors = np.array([[shade, shade]], dtype=np.uint8)
            for ball, end in zip(self._ends, points, strict=True):
                ball.position = end
                ball.color = shade
        for node in (self._line, *self._ends):
            put(node, visible=visible)


def clearance_text(nearest: NearestObstacle | None) -> str:
    """Return a clearance in words."""
    if nearest is None:
        return "there are no obstacles or scans"
    size = length_text(abs(nearest.distance))
    if nearest.distance < 0.0:
        return f"{nearest.body} is {size} inside {nearest.other}"
    less = (
        f", less than the margin of {length_text(nearest.margin)}"
        if nearest.distance < nearest.margin
        else ""
    )
    return f"{size} from {nearest.body} to {nearest.other}{less}"


class SceneTab:
    """Controls for the surroundings of the arm: obstacles in numbers, margins, scans, and the clearance."""

    def __init__(self, server: viser.ViserServer, arm: Arm, scans: ScanShelf, post: Post) -> None:
        gui = server.gui
        bind = partial(Bound, post)
        digits = coordinate_digits(arm.length)
        step = 10.0**-digits
        finer = digits + OBSTACLES.finer_digits
        self._points = np.zeros((0, 3))
        self._name = ""
        self._about = gui.add_html("")
        kinds = {kind.replace("_", "-").capitalize(): kind for kind in obstacles.new_obstacle_kinds()}
        add = gui.add_button_group("Add", tuple(kinds), hint="Next to the arm; drag it into place")
        chosen = gui.add_dropdown("Obstacle", ("none",), hint="Or click on one in the picture")
        self._chosen = bind(
            chosen,
            lambda session: _selected(session) or "none",
            lambda name: partial(obstacles.select_obstacle, None if name == "none" else name),
        )
        self._called = bind(
            gui.add_text("Name", "", visible=False),
            _selected,
            lambda to: partial(obstacles.rename_obstacle, self._name, to),
        )
        fields: dict[str, tuple[Any, float]] = {}  # by attribute, with their units
        for key, (label, hint) in VECTOR_LABELS.items():
            by = {"rotation": 1.0, "normal": 0.005}.get(key, step)
            field = gui.add_vector3(label, (0.0, 0.0, 0.0), step=by, hint=hint, visible=False)
            precisions = {"rotation": OBSTACLES.angle_digits, "normal": OBSTACLES.direction_digits}
            field.precision = precisions.get(key, digits)
            fields[key] = field, {"rotation": np.pi / 180.0, "normal": 1.0}.get(key, MILLIMETRE)
        for key, label in number_labels().items():
            number = gui.add_number(label, 0.0, min=0.0, step=step, visible=False)
            number.precision = finer
            fields[key] = number, MILLIMETRE if label.endswith("[mm]") else 1.0
        self._values = {
            key: bind(
                control,
                partial(_value_of, key),
                partial(self._set_value, key, True),
                preview=partial(self._set_value, key, False),
                unit=unit,
            )
            for key, (control, unit) in fields.items()
        }
        hint = "Points with fewer than eight others within this distance are left out; 0: none"
        outliers = gui.add_number("Outliers [mm]", 0.0, min=0.0, step=step, hint=hint, visible=False)
        self._outliers = bind(
            outliers,
            _outlier_distance,
            lambda distance: partial(scans.remove_outliers, self._name, distance),
            unit=MILLIMETRE,
        )
        self._delete = gui.add_button("Delete", icon=viser.Icon.TRASH, color="gray", visible=False)
        with gui.add_folder("Keep clear"):
            hint = "Distance to keep from obstacles"
            margin = gui.add_number("Margin [mm]", 0.0, min=0.0, step=step, hint=hint)
            self._margin = bind(
                margin,
                lambda session: session.shown.effective_scene.margin,
                lambda margin: partial(
                    Session.edit,
                    edit=with_scene(margin=float(margin)),
                    what=f"margin {1000.0 * margin:.4g} mm",
                ),
                unit=MILLIMETRE,
            )
            hint = "Avoid collisions of the arm with itself, too"
            avoided = gui.add_checkbox("Self-collision", True, hint=hint)
            self._self_collision = bind(
                avoided,
                lambda session: session.shown.effective_scene.self_collision,
                lambda value: partial(
                    Session.edit,
                    edit=with_scene(self_collision=value),
                    what=f"self-collision {'' if value else 'not '}avoided",
                ),
            )
            hint = "Radius of its links; 0: as in its description"
            thickness = gui.add_number("Arm radius [mm]", 0.0, min=0.0, step=step, hint=hint)
            self._arm_radius = bind(
                thickness,
                lambda session: session.shown.effective_scene.arm_radius or 0.0,
                _set_arm_radius,
                unit=MILLIMETRE,
            )
        for number in (outliers, margin, thickness):
            number.precision = finer
        with gui.add_folder("Meshes and scans", expand_by_default=False):
            self._scans = ScanControls(server, scans, post)
        on_choice(add, lambda label: post(partial(obstacles.add_obstacle, kinds[label], self._points)))
        on_click(self._delete, lambda: post(obstacles.delete_obstacle))

    def show(self, session: Session, live: Live) -> None:
        """Bring it up to date."""
        points = [live.state.points] if live.target is None else [live.state.points, live.target.points[::-1]]
        self._points = np.vstack(points)
        names = ("none", *obstacles.obstacles_of(session.shown))
        if tuple(self._chosen.control.options) != names:
            self._chosen.control.options = names
        self._chosen.show(session)
        fields_shown = (self._called, *self._values.values(), self._outliers)
        name = _selected(session) or ""
        if name != self._name:
            for field in fields_shown:
                field.finish()  # it was meant for the one before
            self._name = name
        for field in (*fields_shown, self._margin, self._self_collision, self._arm_radius):
            field.show(session)
        put(self._delete, visible=bool(name))
        nearest = session.nearest
        shade = THEME.quiet if nearest is None else CLEARANCE_COLORS[nearest.level]
        text = escape(clearance_text(nearest))
        put(self._about, content=framed_html("clearance", shade, "Clearance of the arm now", text))
        self._scans.show(session)

    def _set_value(self, key: str, final: bool, value: Any) -> Request:
        return partial(obstacles.edit_obstacle, self._name, key, value, final)


def _selected(session: Session) -> str | None:
    """Return the name of the selected obstacle, if it is there."""
    return session.obstacle if session.obstacle in obstacles.obstacles_of(session.shown) else None


def _value_of(key: str, session: Session) -> Any:
    """Return a value of the selected obstacle, a rotation as roll, pitch and yaw [rad]; None without it."""
    value = getattr(obstacles.obstacles_of(session.shown).get(_selected(session) or ""), key, None)
    return pin.rpy.matrixToRpy(np.array(value)) if key == "rotation" and value is not None else value


def _outlier_distance(session: Session) -> float | None:
    """Return the distance by which outliers of the selected cloud were found, 0 if they were not [m]."""
    cloud = obstacles.obstacles_of(session.shown).get(_selected(session) or "")
    return cloud.outlier_distance or 0.0 if isinstance(cloud, Scan) and cloud.faces is None else None


def _set_arm_radius(value: float) -> Request:
    edit = with_scene(arm_radius=float(value) if value > 0.0 else None)
    what = f"arm radius {1000.0 * value:.4g} mm" if value > 0.0 else "arm radius as in its description"
    return partial(Session.edit, edit=edit, what=what)
