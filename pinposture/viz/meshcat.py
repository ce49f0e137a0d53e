"""An arm, its motion, targets and surroundings in meshcat: live, or recorded in an HTML page."""

from __future__ import annotations

import base64
import html
import io
import json
import subprocess
import webbrowser
from collections.abc import Iterator, Sequence
from contextlib import contextmanager, redirect_stdout
from dataclasses import dataclass
from importlib import resources
from pathlib import Path
from string import Template
from typing import Any, NamedTuple

import numpy as np
import umsgpack
import zmq
from meshcat import Visualizer
from meshcat.animation import Animation, AnimationClip
from meshcat.commands import SetAnimation
from meshcat.geometry import Geometry, Mesh, MeshPhongMaterial, TriangularMeshGeometry
from meshcat.geometry import Sphere as BallGeometry
from meshcat.path import Path as TreePath
from meshcat.servers.zmqserver import VIEWER_ROOT
from meshcat.visualizer import ViewerWindow
from numpy.typing import ArrayLike, NDArray
from scipy.spatial.transform import Rotation

from pinposture.arm import Arm, ControlPoints
from pinposture.arm.kinematics import without_repeats
from pinposture.arm.manipulability import chosen_points
from pinposture.collision import Scene
from pinposture.collision.bodies import scene_at
from pinposture.errors import InvalidValue, ViewerError
from pinposture.motion import Run, Trajectory
from pinposture.motion.words import headline
from pinposture.placement import Target
from pinposture.storage import with_suffix, write_text
from pinposture.units import length_text
from pinposture.viz import drawing, palette
from pinposture.viz.body import TriangleMesh, ball, bodies, body_poses, merge, tube
from pinposture.viz.drawing import DRAWING, ROOT, SIZES, Timeline, Track, playback, require_fitting
from pinposture.viz.palette import THEME
from pinposture.viz.panels import has_clearance
from pinposture.viz.postures import (
    INDEX_LABELS,
    EllipsoidMotion,
    axis_ends,
    ellipsoid_motion,
    ellipsoid_path,
    ellipsoid_tracks,
    round_down,
    scale_in_words,
)

Array = NDArray[np.float64]

FRAME = '<iframe {} style="width: 100%; height: 480px; border: 0"></iframe>'
"""How a notebook embeds a page."""

TIMEOUT = 10_000  # timeout for the answers of a server [ms]


class Connection(ViewerWindow):  # type: ignore[misc]
    """meshcat's connection to its server, with a timeout.

    Args:
        address: address of a running server, such as "tcp://127.0.0.1:6000"; None starts a server, which
            accepts commands from this machine only, but also serves its page to others (see SECURITY.md).

    Raises:
        ViewerError: the server cannot be started or does not answer.
    """

    def __init__(self, address: str | None = None) -> None:
        self.server_proc: subprocess.Popen[bytes] | None = None
        self.zmq_socket: zmq.Socket[bytes] | None = None
        self._name = "meshcat server" if address is None else f"meshcat server at {address!r}"
        printed = io.StringIO()
        try:
            with self._reported(), redirect_stdout(printed):
                super().__init__(address, address is None, [])
        except ViewerError:
            raise
        except (RuntimeError, OSError, ValueError) as error:
            last = printed.getvalue().strip().splitlines()[-1:]
            raise ViewerError(self._name, f"cannot be started ({'; '.join([str(error), *last])})") from error

    def connect_zmq(self) -> None:
        """Connect or reconnect."""
        self._disconnect()
        socket = self.zmq_socket = self.context.socket(zmq.REQ)
        for option, value in ((zmq.RCVTIMEO, TIMEOUT), (zmq.SNDTIMEO, TIMEOUT), (zmq.LINGER, 0)):
            socket.setsockopt(option, value)
        socket.connect(self.zmq_url)

    def send(self, command: Any) -> None:
        """Send a meshcat command to all current and later browsers.

        Raises:
            ViewerError: the server does not answer, or the connection was closed.
        """
        if self.zmq_socket is None:
            raise ViewerError(self._name, "the viewer was closed")
        with self._reported():
            super().send(command)

    def close(self) -> None:
        """Disconnect, and stop the server if this connection started it."""
        self._disconnect()
        if self.server_proc is not None:
            self.server_proc.kill()
            self.server_proc.communicate()
            self.server_proc = None

    def _disconnect(self) -> None:
        if self.zmq_socket is not None:
            self.zmq_socket.close()
            self.zmq_socket = None

    @contextmanager
    def _reported(self) -> Iterator[None]:
        try:
            yield
        except zmq.ZMQError as error:
            self.close()
            reason = f"{error}; an address is, for instance, tcp://127.0.0.1:6000"
            if isinstance(error, zmq.Again):
                reason = f"no answer within {TIMEOUT / 1000:g} s"
            raise ViewerError(self._name, reason) from None


class CommandRecorder:
    """Records the commands of a `meshcat.Visualizer` instead of sending them.

    Attributes:
        packed: the commands in the format that a browser receives.
    """

    def __init__(self) -> None:
        self.packed: list[bytes] = []

    def send(self, command: Any) -> None:
        """Record a command."""
        self.packed.append(umsgpack.packb(command.lower()))


class PlayAnimation(SetAnimation):  # type: ignore[misc]
    """Play an animation in a loop, replacing the previous one.

    A server stores commands by path and sends them to later browsers, parents first. The objects of an
    animation must exist before it, so its path comes after theirs.
    """

    def lower(self) -> dict[str, Any]:
        """Return the command in the viewer's format."""
        return {**super().lower(), "path": f"{ROOT}/animation"}


def play_animation(viewer: Visualizer, moving: Sequence[Track], fps: float) -> None:
    """Play tracks in a loop, replacing the previous ones; without tracks, stop."""
    whole = Animation()
    for track in moving:
        clip = whole.clips.setdefault(TreePath().append(track.path), AnimationClip(fps=fps, name="run"))
        clip.tracks[track.name] = track
    viewer.window.send(PlayAnimation(whole, repetitions=float("inf")))


def add(
    viewer: Visualizer, path: str, shape: TriangleMesh | Geometry, color: str, opacity: float = 1.0
) -> None:
    """Add a shape [m] with a colour "#RRGGBB"."""
    geometry = TriangularMeshGeometry(*shape) if isinstance(shape, TriangleMesh) else shape
    # Translucent objects must not hide objects drawn later.
    style = {"opacity": opacity, "shininess": 40, "depthWrite": opacity >= 1.0}
    material = MeshPhongMaterial(int(color.lstrip("#"), 16), **style)
    mesh = Mesh(geometry, material)
    # Replace meshcat's random identifiers, so that the same scene always gives the same page.
    mesh.uuid, geometry.uuid, material.uuid = (f"{path}/{part}" for part in ("mesh", "geometry", "material"))
    viewer[path].set_object(mesh)


def add_arm(viewer: Visualizer, arm: Arm, q: Array) -> None:
    """Draw the arm at a configuration, (nq,): a mesh per body, and control points fixed to the bodies."""
    radius = drawing.link_radius(arm)
    surfaces = drawing.arm_surfaces(arm)
    add(viewer, f"{ROOT}/arm/base", surfaces.base, THEME.base)
    for u, body in enumerate(bodies(arm)):
        shade = THEME.modules[body.module % len(THEME.modules)]
        add(viewer, f"{drawing.body_path(u)}/link", surfaces.bodies[u], shade)
        if body.point is not None:
            add(viewer, drawing.point_path(u), BallGeometry(SIZES.point * radius), THEME.idle)
            viewer[drawing.point_path(u)].set_transform(_transform(body.point, SIZES.idle))
    pose_arm(viewer, arm, q)


def pose_arm(viewer: Visualizer, arm: Arm, q: Array) -> None:
    """Move the drawn arm to a configuration, (nq,)."""
    for u, pose in enumerate(body_poses(arm, q)):
        viewer[drawing.body_path(u)].set_transform(pose)


def add_target(viewer: Visualizer, arm: Arm, target: Target) -> None:
    """Draw the line of the target, if known, and the target points."""
    radius = 0.3 * drawing.link_radius(arm)
    colors = {"covered": THEME.target, "rest": THEME.rest}
    for part, lines in drawing.outline(arm, target)._asdict().items():
        paths = [path for path in map(without_repeats, lines) if len(path) > 1]
        if paths:
            add(viewer, f"{ROOT}/target/{part}", merge([tube(path, radius) for path in paths]), colors[part])
    dots = [ball(point, 2.8 * radius, 1) for point in target.points[target.has_target]]
    if dots:
        add(viewer, f"{ROOT}/target/points", merge(dots), THEME.target)


def add_moving_targets(
    viewer: Visualizer, motion: Trajectory, waypoints: Sequence[palette.WaypointMark]
) -> None:
    """Draw the targets at the start of a motion, and thin lines through the targets at waypoints."""
    arm = motion.arm
    radius = drawing.link_radius(motion.arm)
    for number, waypoint in enumerate(waypoints, start=1):
        points = motion.targets[waypoint.row][motion.target_mask[waypoint.row]]
        line = without_repeats(np.vstack([arm.chain.base, points]), 1e-9 * arm.length)
        if len(line) > 1:
            path = f"{ROOT}/target/place_{number:03d}"
            add(viewer, path, tube(line, SIZES.line * radius), waypoint.color)
    around = 2.0 * np.pi * np.arange(SIZES.hoop_sides + 1) / SIZES.hoop_sides
    circle = np.stack([np.cos(around), np.sin(around), np.zeros(SIZES.hoop_sides + 1)], axis=1)
    hoop = tube(SIZES.hoop * SIZES.point * radius * circle, SIZES.wire * SIZES.point * radius)
    turns = drawing.hoop_turns(arm, motion.targets[:1], motion.target_mask[:1])
    for k in drawing.targeted_points(motion):
        size = 1.0 if motion.target_mask[0, k] else SIZES.nothing
        turn = Rotation.from_quat(turns[0, k]).as_matrix()
        add(viewer, drawing.hoop_path(k), hoop, THEME.target)
        viewer[drawing.hoop_path(k)].set_transform(_transform(motion.targets[0, k], size * turn))


def add_obstacles(viewer: Visualizer, shown: Sequence[drawing.ShownObstacle]) -> None:
    """Draw translucent obstacles."""
    opacity = THEME.sheer if len(shown) > DRAWING.many_obstacles else THEME.see_through
    for number, obstacle in enumerate(shown):
        add(viewer, drawing.obstacle_path(number), obstacle.surface, THEME.obstacle, opacity)


def add_ellipsoids(viewer: Visualizer, shown: EllipsoidMotion) -> None:
    """Draw the ellipsoids of the first configuration, replacing previous ones."""
    unit = ball(np.zeros(3), 1.0, 3)
    for p, point in enumerate(shown.points):
        path = ellipsoid_path(point)
        axes = (shown.frames[0, p] * shown.radii[0, p, :, None]).T
        add(viewer, path, unit, palette.index_color(shown.indices[0, p]), THEME.ellipsoids)
        viewer[path].set_transform(_transform(shown.centers[0, p], axes))


def _transform(position: Array, linear: Array | float = 1.0) -> Array:
    """Return the homogeneous transform, (4, 4), with a position, (3,) [m], and a matrix, (3, 3), or scale."""
    matrix = np.eye(4)
    matrix[:3, :3] = linear if np.ndim(linear) else linear * np.eye(3)
    matrix[:3, 3] = position
    return matrix


class AnimationSettings(NamedTuple):
    """The view of an animation, and the largest numbers of its configurations."""

    field_of_view: float = 35.0
    """Vertical field of view [deg]; narrower than usual, to reduce the distortion of near objects."""

    aspect: float = 4.0 / 3.0
    """Aspect ratio of the narrowest window that shows everything."""

    margin: float = 1.15
    """Factor of the camera distance."""

    most_sent: int = 2000
    """Most configurations that are sent to the browser."""

    most_of_a_run: int = 240
    most_of_a_motion: int = 1200
    """Most configurations in a page of a run, and in one of a motion."""


ANIMATION = AnimationSettings()


def set_camera(viewer: Visualizer, arm: Arm, points: Array) -> None:
    """Set up light, floor and camera such that points, (n, 3) [m], world frame, are in view.

    The camera orbits the origin of the scene, so the world is shifted by the centre of the points.
    """
    framing = drawing.frame_points(points)
    floor = points[:, 2].min() - framing.center[2] - 3.0 * drawing.link_radius(arm)
    viewer[ROOT].set_transform(_transform(-framing.center))
    grid = _transform(np.array([0.0, 0.0, floor]), 0.4 * round_down(framing.radius))
    viewer["/Grid"].set_transform(grid)
    distance = ANIMATION.margin * framing.distance(
        points, np.radians(ANIMATION.field_of_view), ANIMATION.aspect
    )
    x, y, z = distance * framing.axes[2]
    camera = "/Cameras/default/rotated/<object>"
    properties: list[tuple[str, str, Any]] = [
        ("/Background", "top_color", [1.0, 1.0, 1.0]),
        ("/Background", "bottom_color", [0.90, 0.92, 0.94]),
        ("/Grid", "color", [1.0, 1.0, 1.0, 0.18]),
        ("/Axes", "visible", False),
        ("/Lights/AmbientLight/<object>", "intensity", 0.42),
        ("/Lights/FillLight/<object>", "intensity", 0.25),
        # By default, these two lights fade out after 10 m.
        ("/Lights/PointLightNegativeX/<object>", "distance", 0.0),
        ("/Lights/PointLightPositiveX/<object>", "distance", 0.0),
        (camera, "fov", ANIMATION.field_of_view),
        (camera, "near", 0.01 * distance),
        (camera, "far", 100.0 * distance),
        # In the camera frame, y points up.
        (camera, "position", [x, z, -y]),
    ]
    for path, name, value in properties:
        viewer[path].set_property(name, value)


class DrawnScene(NamedTuple):
    """The result of `draw_scene`.

    Attributes:
        tracks: the animation; empty if there is nothing to play.
        obstacles: whether there are obstacles.
        waypoints: the drawn waypoints of a motion, grouped if they look alike.
    """

    tracks: list[Track]
    obstacles: bool
    waypoints: list[list[palette.WaypointMark]]


def draw_scene(
    viewer: Visualizer,
    arm: Arm,
    shown: Timeline | None,
    target: Target | None,
    scene: Scene | None,
    points: tuple[int, ...],
) -> DrawnScene:
    """Draw an arm and its surroundings.

    Args:
        viewer: where to draw.
        arm: the arm.
        shown: the timeline to play; None: the arm at its neutral configuration.
        target: a fixed target, or None.
        scene: obstacles, or None.
        points: control points with an ellipsoid, 0-based.
    """
    rows = arm.neutral()[None] if shown is None else shown.run.q[shown.rows]
    run, motion = (None, None) if shown is None else (shown.run, shown.motion)
    ellipsoids = ellipsoid_motion(arm, points, rows)
    seen = np.vstack([drawing.scene_points(arm, run, target), axis_ends(ellipsoids)])
    waypoints: list[list[palette.WaypointMark]] = []
    if motion is not None:
        seen = np.vstack([seen, motion.targets[motion.target_mask]])
        waypoints = palette.group_alike(motion, palette.shown_waypoints(motion))
    first = None if scene is None else scene_at(arm, rows[0], scene)
    obstacles = drawing.shown_obstacles(first, seen)
    set_camera(viewer, arm, np.vstack([seen, drawing.shown_corners(obstacles)]))
    add_arm(viewer, arm, rows[0])
    if target is not None:
        add_target(viewer, arm, target)
    if motion is not None:
        add_moving_targets(viewer, motion, [group[0] for group in waypoints])
    add_obstacles(viewer, obstacles)
    add_ellipsoids(viewer, ellipsoids)
    moving: list[Track] = []
    if shown is not None:
        moving = [*drawing.arm_tracks(arm, shown), *ellipsoid_tracks(ellipsoids, shown)]
        moving += drawing.obstacle_tracks(arm, shown, scene, obstacles)
        moving += [] if motion is None else drawing.moving_target_tracks(motion, shown)
    return DrawnScene(moving, bool(obstacles), waypoints)


class Viewer:
    """An arm in the browser, shown by a meshcat server; see `pinposture.viz.view`.

    As a context manager, it closes itself.

    Attributes:
        arm: the arm.
        run: the run or motion in time that `play` plays, or None.
        target: the shown target, or None.
        scene: the obstacles, or None.
        ellipsoids: indices of the control points with an ellipsoid, 0-based.
        meshcat: the `meshcat.Visualizer`, to draw more; objects below "/pinposture" are in the world frame.
    """

    def __init__(
        self,
        arm: Arm,
        run: Run | Trajectory | None,
        target: Target | None,
        fps: float,
        url: str | None,
        ellipsoids: ControlPoints = (),
        scene: Scene | None = None,
    ) -> None:
        drawing.require_fitting(arm, run, target)
        self.arm = arm
        self.run = run
        self.target = target
        self.scene = scene
        self.ellipsoids = chosen_points(arm.control_points, ellipsoids)
        self._playback = None if run is None else drawing.playback(run, fps, ANIMATION.most_sent)
        self._playing = False
        self.meshcat = Visualizer(window=Connection(url))
        try:
            self.meshcat[ROOT].delete()
            self._tracks = draw_scene(
                self.meshcat, arm, self._playback, target, scene, self.ellipsoids
            ).tracks
            if run is not None:
                self.play()
        except BaseException:
            self.close()
            raise

    @property
    def url(self) -> str:
        """The address to open in one or more browsers."""
        return str(self.meshcat.url())

    def open(self) -> None:
        """Open a browser on this computer."""
        webbrowser.open(self.url, new=2)

    def show(self, q: ArrayLike) -> None:
        """Show the arm at a configuration and stop playing the run.

        Takes about a millisecond per joint and ellipsoid. Browsers keep up with about 20 calls per second.

        Args:
            q: configuration, (nq,) [rad or m].

        Raises:
            InvalidValue: q has the wrong size or is not finite.
            ViewerError: the viewer was closed, or its server does not answer.
        """
        q = self.arm.checked(q)
        if self._playing and self._playback is not None:
            play_animation(self.meshcat, [], self._playback.fps)
            self._playing = False
        pose_arm(self.meshcat, self.arm, q)
        add_ellipsoids(self.meshcat, ellipsoid_motion(self.arm, self.ellipsoids, q[None]))

    def play(self) -> None:
        """Play the run in a loop, from its start.

        Raises:
            InvalidValue: there is no run.
            ViewerError: the viewer was closed, or its server does not answer.
        """
        if self._playback is None:
            raise InvalidValue("run", None, "a run to play, as in view(arm, run)")
        play_animation(self.meshcat, self._tracks, self._playback.fps)
        self._playing = True

    def close(self) -> None:
        """Close the viewer, and stop the server if the viewer started it."""
        self.meshcat.close()

    def __enter__(self) -> Viewer:
        return self

    def __exit__(self, *exception: object) -> None:
        self.close()

    def _repr_html_(self) -> str:
        return FRAME.format(f'src="{html.escape(self.url)}"')

    def __repr__(self) -> str:
        return f"Viewer({self.url})"


# Captions and legend.


def captions(shown: Timeline) -> list[str]:
    """Return the caption of each shown configuration."""
    listed = []
    run = shown.run
    for row in shown.rows:
        text = _step_text(shown, row) if shown.motion is None else _motion_text(shown.motion, row)
        listed.append(text + (f", clearance {length_text(run.clearance[row])}" if has_clearance(run) else ""))
    return listed


def _step_text(shown: Timeline, row: int) -> str:
    """Describe a configuration of a run."""
    run = shown.run
    when = f"step {row} of {run.steps}"
    if run.limits.dt is not None:
        when = f"{run.limits.dt * row:.2f} of {run.limits.dt * run.steps:.2f} s"
    text = f"{when}, {_errors_text(run, row)}"
    if run.steps:
        count = int(run.active[min(row, run.steps - 1)].sum())
        text += f", {count} of {run.arm.n_modules} control points active"
        if run.switches:
            methods = run.reported("method", "")
            text += f" by {str(methods[min(row, run.steps - 1)]).capitalize()}"
    return text


def _motion_text(motion: Trajectory, row: int) -> str:
    """Describe a configuration of a motion."""
    text = f"{motion.time[row]:.2f} of {motion.time[-1]:.2f} s"
    if motion.slowdown:
        text += f" ({motion.plan_time[row]:.2f} of {motion.planned:.2f} s of the plan)"
    count = sum(waypoint.row is not None and waypoint.row <= row for waypoint in motion.waypoints)
    if row < motion.start_index:
        text += ", moving to the first posture"
    elif count:
        text += f", reached {motion.waypoints[count - 1].name} ({count} of {len(motion.waypoints)})"
    return f"{text}, {_errors_text(motion.run, row)}"


def _errors_text(run: Run, row: int) -> str:
    """Describe the errors of the control points in a configuration of a run."""
    mean = length_text(run.mean_error[row], run.arm.length)
    largest = length_text(run.point_errors[row].max(), run.arm.length)
    return f"mean point error {mean} (largest {largest})"


def legend_html(shown: Timeline, drawn: DrawnScene, target: bool, scale: str) -> str:
    """Return the legend, and the playback speed of a motion, as HTML.

    Args:
        shown: the timeline.
        drawn: the drawn scene.
        target: whether a fixed target is drawn.
        scale: the scale of ellipsoids in words; empty without ellipsoids.
    """
    entries = [("target", THEME.target)] if target else []
    if shown.motion is not None:
        entries = [("current target", THEME.target)]
    if shown.run.steps:
        entries += [("active control point", THEME.active), ("idle", THEME.idle)]
    else:
        entries.append(("control point", THEME.idle))
    if drawn.obstacles:
        entries.append(("obstacle", THEME.obstacle))
    lines = [_color_key(entries)]
    if shown.motion is not None:
        speed = "in real time" if shown.speedup == 1.0 else f"{shown.speedup:.0f} times as fast as recorded"
        named = [
            (", ".join(waypoint.name for waypoint in group), group[0].color) for group in drawn.waypoints
        ]
        lines.append(f"shown {speed}; targets at {_color_key(named)}" if named else f"shown {speed}")
    moved = palette.placement_text(shown.run if shown.motion is None else shown.motion)
    if moved:
        lines.append(html.escape(moved))
    if scale:
        listed = [(f"index {meaning}", color) for color, meaning in INDEX_LABELS.items()]
        lines.append(f"ellipsoids, {scale}: {_color_key(listed)}")
    return "<br>".join(lines)


def _color_key(entries: Sequence[tuple[str, str]]) -> str:
    dots = [
        f'<span class="dot" style="background: {color}"></span>{html.escape(name)}' for name, color in entries
    ]
    return "".join(dots)


@dataclass(frozen=True)
class AnimationPage:
    """An animation as a self-contained HTML page, including the script of the viewer.

    A notebook displays it as the value of a cell.

    Attributes:
        html: the page, 2 MB.
    """

    html: str

    def save(self, path: str | Path) -> Path:
        """Write the page to one file, atomically.

        Args:
            path: the file; ".html" is appended to a name without suffix.

        Returns:
            The path written.

        Raises:
            FileError: the name has another suffix, or the file cannot be written.
        """
        path = with_suffix(Path(path), ".html", ".htm")
        write_text(path, self.html)
        return path

    def _repr_html_(self) -> str:
        return FRAME.format(f'srcdoc="{html.escape(self.html)}"')

    def __repr__(self) -> str:
        return f"AnimationPage({len(self.html)} characters)"


def animate(
    arm: Arm,
    run: Run | Trajectory,
    target: Target | None = None,
    fps: float = 20.0,
    max_frames: int | None = None,
    ellipsoids: ControlPoints = (),
) -> AnimationPage:
    """Create an animation of a run or motion that plays in any browser, offline, and in notebooks.

    The run plays in a loop; the mouse rotates, pans and zooms. Active control points are coloured and large.
    Obstacles are translucent; a half-space is drawn as a plate. A motion in time plays as in `view`. Its
    caption names the waypoints that it has reached.

    Args:
        arm: the arm.
        run: the run or motion in time to show.
        target: a fixed target to show; None: that of a run.
        fps: configurations shown per second; fewer if a short run would last less than 2 s.
        max_frames: maximum number of configurations shown. None: 240 for a run, 1200 for a motion.
        ellipsoids: control points whose manipulability ellipsoids are shown, as in `view`; the page explains
            their colours and scale.

    Raises:
        InvalidValue: a run of another arm, or an invalid `fps`, `max_frames` or choice of control points.
        UnknownName: an unknown control point.
    """
    drawing.require_type("run", run, Run, Trajectory)
    target = run.target if target is None and isinstance(run, Run) else target
    require_fitting(arm, run, target)
    points = chosen_points(arm.control_points, ellipsoids)
    if max_frames is None:
        max_frames = ANIMATION.most_of_a_motion if isinstance(run, Trajectory) else ANIMATION.most_of_a_run
    return AnimationPage(_page_html(arm, playback(run, fps, max_frames), target, points))


def save_html(
    arm: Arm,
    run: Run | Trajectory,
    path: str | Path,
    target: Target | None = None,
    fps: float = 20.0,
    max_frames: int | None = None,
    ellipsoids: ControlPoints = (),
) -> Path:
    """Write an animation of a run or motion to one HTML file, atomically; see `animate`.

    Args:
        arm: as in `animate`.
        run: as in `animate`.
        path: the file; ".html" is appended to a name without suffix.
        target: as in `animate`.
        fps: as in `animate`.
        max_frames: as in `animate`.
        ellipsoids: as in `animate`.

    Returns:
        The path written.

    Raises:
        FileError: the name has another suffix, or the file cannot be written.
        InvalidValue: as in `animate`.
        UnknownName: as in `animate`.
    """
    path = with_suffix(Path(path), ".html", ".htm")
    return animate(arm, run, target, fps, max_frames, ellipsoids).save(path)


def _page_html(arm: Arm, shown: Timeline, target: Target | None, points: tuple[int, ...]) -> str:
    run = shown.run
    motion = shown.motion
    recording = CommandRecorder()
    viewer = Visualizer(window=recording)
    drawn = draw_scene(viewer, arm, shown, target, run.scene, points)
    play_animation(viewer, drawn.tracks, shown.fps)
    packed = [base64.b64encode(command).decode("ascii") for command in recording.packed]
    described = {"times": (shown.times / shown.fps).round(6).tolist(), "texts": captions(shown)}
    template = resources.files("pinposture.viz").joinpath("page.html").read_text(encoding="utf-8")
    ending, reason, extent = headline(
        (run if motion is None else motion).summary(), palette.controller_name(run)
    )
    return Template(template).substitute(
        title=html.escape(ending),
        reason=html.escape(f"{reason}; {extent}"),
        legend=legend_html(shown, drawn, target is not None, scale_in_words(arm, points) if points else ""),
        ink=THEME.ink,
        end=shown.end / shown.fps,
        aspect=ANIMATION.aspect,
        viewer=_viewer_script(),
        run=json.dumps(described).replace("<", r"\u003c"),  # names must not end the script
        commands=json.dumps(packed),
    )


def _viewer_script() -> str:
    """Return the script of the meshcat viewer from the meshcat package."""
    return Path(VIEWER_ROOT, "main.min.js").read_text(encoding="utf-8")
