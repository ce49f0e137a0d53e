"""The contents of pictures of an arm: view, target, surfaces of the arm, obstacles, and playback."""

from __future__ import annotations

import itertools
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, NamedTuple

import coal
import numpy as np
import pinocchio as pin
import umsgpack
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from pinposture._validation import require_whole
from pinposture.arm import Arm
from pinposture.arm.kinematics import neutral_placements
from pinposture.collision import HalfSpace, Scene
from pinposture.curve import Curve
from pinposture.errors import InvalidValue
from pinposture.motion import JointTrajectory, Run, Trajectory
from pinposture.motion.held import obstacle_motions
from pinposture.placement import Target
from pinposture.units import CONVERGED
from pinposture.viz import palette
from pinposture.viz.body import (
    DrawnBody,
    TriangleMesh,
    backbone,
    ball,
    bodies,
    body_meshes,
    body_poses,
    box_corners,
    clip_to_box,
    cut_by_plane,
    disc,
    hull_surface,
    merge,
    surface,
    tube,
)
from pinposture.viz.palette import THEME

Array = NDArray[np.float64]


class DrawingSettings(NamedTuple):
    """From where a picture is seen, and what of its contents it shows."""

    azimuths: Array = np.radians([-70.0, -110.0, -45.0, -135.0])
    """Azimuths of candidate views, x to the right and z up [rad]; none is along an axis, where scales would
    coincide."""

    elevations: Array = np.radians([22.0, 38.0, 60.0])
    """Their elevations [rad]."""

    area_gain: float = 1.3
    """Gain in visible area for which a view is preferred to an earlier one in the list."""

    curve_samples: int = 400
    """Number of samples of a curve."""

    shown_beyond: float = 0.6
    """Length of a curve shown beyond the last target point, in arm lengths."""

    view_margin: float = 0.5
    """How much the picture may grow to show obstacles, relative to its other contents."""

    shown_part: float = 0.25
    """Size of the shown part of an obstacle larger than the picture, relative to the other contents."""

    plate_thickness: float = 0.02
    """Thickness of the plate that represents a half-space, relative to the other contents."""

    plate_width: float = 0.3
    """Smallest width of that plate, relative to the other contents."""

    many_obstacles: int = 24
    """Number of obstacles above which they are drawn more transparently."""


DRAWING = DrawingSettings()


class Framing(NamedTuple):
    """A view of a set of points.

    Attributes:
        center: centre of the bounding box of the points, (3,) [m], world frame.
        radius: distance of the farthest point from the centre, above 0 [m].
        azimuth: direction of the eye about the vertical axis, from x towards y [rad].
        elevation: elevation of the eye [rad].
    """

    center: Array
    radius: float
    azimuth: float
    elevation: float

    @property
    def axes(self) -> Array:
        """Unit vectors to the right, upwards, and towards the eye, (3, 3), world frame."""
        return view_axes(self.azimuth, self.elevation)

    def distance(self, points: Array, opening: float, aspect: float) -> float:
        """Return the distance of the eye from the centre at which all points are visible [m].

        Args:
            points: the points, (n, 3) [m], world frame.
            opening: vertical field of view [rad].
            aspect: width of the picture relative to its height.
        """
        right, up, near = self.axes @ (points - self.center).T
        slope = np.tan(opening / 2.0)
        needed = np.maximum(np.abs(up), np.abs(right) / aspect) / slope + near
        return max(float(needed.max()), 2.0 * self.radius)


def frame_points(points: Array) -> Framing:
    """Choose the view in which points, (n, 3) [m], world frame, n >= 1, cover the largest area."""
    center = (points.max(axis=0) + points.min(axis=0)) / 2.0
    offsets = points - center
    radius = max(float(np.linalg.norm(offsets, axis=1).max()), 1e-9)
    # Small isotropic spread: a line has no area in any view, but its length should be visible.
    scatter = offsets.T @ offsets / (len(points) * radius**2) + 1e-4 * np.eye(3)
    chosen = (0.0, 0.0)
    largest = 0.0
    for elevation in DRAWING.elevations:
        for azimuth in DRAWING.azimuths:
            screen = view_axes(float(azimuth), float(elevation))[:2]
            area = float(np.sqrt(np.linalg.det(screen @ scatter @ screen.T)))
            if area > DRAWING.area_gain * largest:
                chosen = (float(azimuth), float(elevation))
                largest = area
    return Framing(center, radius, *chosen)


def view_axes(azimuth: float, elevation: float) -> Array:
    """Return unit vectors to the right, upwards, and towards an eye [rad], (3, 3), world frame."""
    eye = np.array(
        [np.cos(elevation) * np.cos(azimuth), np.cos(elevation) * np.sin(azimuth), np.sin(elevation)]
    )
    right = np.array([-np.sin(azimuth), np.cos(azimuth), 0.0])
    return np.array([right, np.cross(eye, right), eye])


class Outline(NamedTuple):
    """A target as pieces of a line: the curve or, without one, the target posture.

    Attributes:
        covered: the pieces between base and consecutive target points, each (n, 3) [m], world frame.
        rest: the remaining pieces, each (k, 3) [m], world frame.
    """

    covered: tuple[Array, ...]
    rest: tuple[Array, ...]


def outline(arm: Arm, target: Target) -> Outline:
    """Return the line of a target; empty if only points are known."""
    # Runs of consecutive points with a target; the base counts as point 0.
    targeted = np.flatnonzero(np.append(True, target.has_target))
    runs = np.split(targeted, np.flatnonzero(np.diff(targeted) > 1) + 1)
    if target.curve is None:
        if target.q is None:
            return Outline((), ())
        line = backbone(arm, target.q)
        ends = [0]
        count = 1
        for body in bodies(arm):
            if body.point is not None:
                ends.append(count + int(np.linalg.norm(body.nodes - body.point, axis=1).argmin()))
            count += len(body.nodes)
        spans = [(ends[run[0]], ends[run[-1]]) for run in runs]
        return _cut(spans, ends[-1], 0.0, lambda a, b: line[int(a) : int(b) + 1])
    curve = target.curve
    length = target.curve.length
    if target.parameters is None:
        return Outline((curve.at(np.linspace(0.0, length, DRAWING.curve_samples)),), ())
    parameters = np.clip(np.append(0.0, target.parameters), 0.0, length)
    last = float(np.max(parameters[1:][target.has_target], initial=0.0))
    end = min(length, last + DRAWING.shown_beyond * arm.length)
    curve_spans = [(float(parameters[run].min()), float(parameters[run].max())) for run in runs]
    # Shorter pieces are invisible and may have no direction.
    count = DRAWING.curve_samples
    return _cut(curve_spans, end, 1e-6 * length, lambda a, b: curve.at(np.linspace(a, b, count)))


def _cut(
    spans: Sequence[tuple[float, float]], end: float, least: float, piece: Callable[[float, float], Array]
) -> Outline:
    """Cut a line from 0 to `end` into the spans and the pieces between them, if longer than `least`."""
    covered: list[tuple[float, float]] = []
    for low, high in sorted(spans):
        if covered and low <= covered[-1][1]:
            covered[-1] = (covered[-1][0], max(covered[-1][1], high))
        else:
            covered.append((low, high))
    edges = [0.0, *(edge for span in covered for edge in span), end]
    between = zip(edges[::2], edges[1::2], strict=True)
    return Outline(*(tuple(piece(a, b) for a, b in parts if b - a > least) for parts in (covered, between)))


def link_radius(arm: Arm) -> float:
    """Return the radius of the bars that represent the links [m]."""
    module = arm.length / arm.n_modules
    return min(0.25 * module, float(np.clip(0.16 * module, 0.004 * arm.length, 0.015 * arm.length)))


SHOWN_BY: dict[type | tuple[type, ...], str] = {
    Arm: "pp.plot_arm(arm) and pp.view(arm) show an arm",
    Target: "pp.view(arm, target=target) shows a target",
    Curve: "pp.resolve_targets(arm, curve) makes a target of a curve",
    (Run, Trajectory): "pp.plot(run) and pp.view(run.arm, run) show a run",
    JointTrajectory: "pp.plot(trajectory) shows it; `show` of pp.view(arm) plays its configurations(arm)",
    np.ndarray: "pp.plot_arm(arm, q) shows a configuration",
    (np.ndarray, list): "pp.plot(pp.JointTrajectory.from_configurations(arm, q, dt)) shows a log",
    (list, tuple, dict): "pp.plot_comparison({name: run, ...}) shows several runs",
    (str, Path): "pp.load(path), pp.Arm.load(path) and pp.Scene.load(path) read files",
}
"""What shows an object of a type, or reads it."""


def require_type(name: str, value: object, *allowed: type) -> None:
    """Raise InvalidValue unless a value is of an allowed type, and name the function that shows it."""
    if not isinstance(value, allowed):
        kinds = ["None" if kind is type(None) else f"a {kind.__name__}" for kind in allowed]
        instead = [f"; {words}" for shown, words in SHOWN_BY.items() if isinstance(value, shown)]
        raise InvalidValue(name, value, " or ".join(kinds).replace("a Arm", "an Arm") + "".join(instead))


def require_fitting(arm: Arm, run: Run | Trajectory | None, target: Target | None) -> None:
    """Raise InvalidValue unless these are an arm, a run or motion and a target that fit each other."""
    require_type("arm", arm, Arm)
    require_type("run", run, Run, Trajectory, type(None))
    require_type("target", target, Target, type(None))
    if run is not None and run.q.shape[1] != arm.nq:
        raise InvalidValue("run.q (shape)", run.q.shape, f"(steps + 1, {arm.nq}) for this arm")
    if run is not None and run.arm is not arm:
        recorded = run.arm.at(run.q[0]).points
        shown = arm.at(run.q[0]).points
        if recorded.shape != shown.shape or np.abs(recorded - shown).max() > CONVERGED * arm.length:
            raise InvalidValue("run.arm", run.arm, f"the arm that is given, {arm!r}")
    if target is not None and target.points.shape != (arm.n_modules, 3):
        raise InvalidValue("target.points (shape)", target.points.shape, f"({arm.n_modules}, 3) for this arm")


class Surfaces(NamedTuple):
    """The surfaces of the base, world frame, and of each body from base to tip, body frame [m]."""

    base: TriangleMesh
    bodies: tuple[TriangleMesh, ...]


def arm_surfaces(arm: Arm) -> Surfaces:
    """Return the surfaces of an arm: the meshes of its description, or round bars where unreadable."""
    radius = link_radius(arm)
    meshes = body_meshes(arm)
    listed = bodies(arm)
    surfaces = []
    for u, body in enumerate(listed):
        # The ball of the next joint closes the bar, unless that joint is prismatic or missing.
        closed = u + 1 < len(listed) and bool(arm.chain.revolute[u + 1])
        surfaces.append(meshes.bodies[u] or _body_mesh(body, radius, closed))
    return Surfaces(meshes.base or _base_mesh(arm, radius), tuple(surfaces))


def visual_model(arm: Arm) -> pin.GeometryModel:
    """Return the drawn bodies of an arm as a geometry model for Pinocchio's visualizers.

    For example `pinocchio.visualize.MeshcatVisualizer(arm.model, visual_model=visual_model(arm))`. These
    visualizers need a `pin.Data`, which takes 40 MB for 100 joints and 280 MB for 200; `view` does not.

    Args:
        arm: the arm.

    Returns:
        One object for the base and one per joint of the chain, with the shapes and colours of `view`.
    """
    surfaces = arm_surfaces(arm)
    placements = neutral_placements(arm.model)
    model = pin.GeometryModel()
    drawn = [("base", 0, surfaces.base, THEME.base, pin.SE3.Identity())]
    for u, (body, mesh) in enumerate(zip(bodies(arm), surfaces.bodies, strict=True)):
        joint = arm.model.getJointId(body.joint)
        shade = THEME.modules[body.module % len(THEME.modules)]
        # Body frames are aligned with the world at the neutral configuration.
        placement = pin.SE3(placements[joint].rotation.T, np.zeros(3))
        drawn.append((f"body_{u + 1:03d}", joint, mesh, shade, placement))
    for name, joint, mesh, color, placement in drawn:
        geometry = coal.BVHModelOBBRSS()
        geometry.beginModel(len(mesh.faces), len(mesh.vertices))
        geometry.addVertices(mesh.vertices)
        geometry.addTriangles(mesh.faces)
        geometry.endModel()
        shape = pin.GeometryObject(name, joint, placement, geometry)
        shape.meshColor = np.array([*palette.rgb(color), 1.0])
        model.addGeometryObject(shape)
    return model


def scene_points(arm: Arm, run: Run | None, target: Target | None) -> Array:
    """Return the points that should be in view: motion and target, (n, 3) [m], world frame."""
    points = [arm.chain.base[None]]
    if run is not None:
        points.append(run.points.reshape(-1, 3))
    if target is not None:
        lines = outline(arm, target)
        points += [target.points[target.has_target], *lines.covered, *lines.rest]
    if run is None:
        points.append(backbone(arm, arm.neutral()))
        # Other configurations may be shown later: leave room around the base.
        points.append(arm.chain.base + 0.35 * arm.length * np.vstack([np.eye(3), -np.eye(3)]))
    return np.vstack(points)


def _body_mesh(body: DrawnBody, radius: float, closed: bool) -> TriangleMesh:
    parts = [ball(np.zeros(3), 1.25 * radius)]
    parts += [tube(body.nodes[i : i + 2], radius) for i in range(len(body.nodes) - 1)]
    parts += [ball(node, radius) for node in (body.nodes[1:-1] if closed else body.nodes[1:])]
    if np.any(body.slide):
        parts.append(tube(np.array([body.slide, np.zeros(3)]), 0.6 * radius))
    return merge(parts)


def _base_mesh(arm: Arm, radius: float) -> TriangleMesh:
    """Return a plate at the base link, with a bar to the first joint if it is elsewhere."""
    foot = np.asarray(arm.base_placement.translation)
    joint = arm.chain.base
    gap = float(np.linalg.norm(joint - foot))
    if gap > 1e-6 * arm.length and arm.urdf is not None:
        return merge(
            [disc(foot, (joint - foot) / gap, 3.0 * radius, radius), tube(np.array([foot, joint]), radius)]
        )
    reach = arm.chain.points[-1] - joint
    length = float(np.linalg.norm(reach))
    axis = reach / length if length > 1e-9 * arm.length else np.array([0.0, 0.0, 1.0])
    return disc(joint - axis * radius, axis, 3.0 * radius, radius)


class ShownObstacle(NamedTuple):
    """An obstacle and its visible part.

    Attributes:
        name: its name.
        surface: its whole surface, world frame [m]; for a half-space, a plate that fits the picture.
        near: corners of the part in the picture, (k, 3) [m], world frame; empty if it is far away.
        cut: whether only a part is in the picture.
        hollow: whether the part is just the points `near`, rather than their convex hull.
    """

    name: str
    surface: TriangleMesh
    near: Array
    cut: bool
    hollow: bool = False


def shown_obstacles(scene: Scene | None, points: Array) -> list[ShownObstacle]:
    """Select what a picture shows of a scene: near obstacles, parts of huge ones, no distant ones.

    Args:
        scene: the scene, or None.
        points: the other contents of the picture, (n, 3) [m], world frame.

    Returns:
        The obstacles in the order of the scene, without half-spaces that are too far away, and without those
        that the arm carries; `scene_at` places these.
    """
    if scene is None or not scene.standing:
        return []
    low = points.min(axis=0)
    high = points.max(axis=0)
    size = max(float(np.max(high - low)), 1e-9)
    region = low - DRAWING.view_margin * size, high + DRAWING.view_margin * size
    shown: dict[str, ShownObstacle] = {}
    planes: dict[str, tuple[Array, float]] = {}
    for name, obstacle in scene.standing.items():
        if isinstance(obstacle, HalfSpace):
            normal = np.array(obstacle.normal)
            planes[name] = normal, float(normal @ obstacle.point)
        else:
            whole = surface(obstacle)
            corners = whole.vertices
            if not obstacle.geometry.convex:
                inside = np.all((corners >= region[0]) & (corners <= region[1]), axis=1)
                shown[name] = ShownObstacle(name, whole, corners[inside], not inside.all(), hollow=True)
                continue
            part = clip_to_box(corners, *region)
            if part is not corners and len(part):
                least = np.minimum(low, part.max(axis=0)) - DRAWING.shown_part * size
                most = np.maximum(high, part.min(axis=0)) + DRAWING.shown_part * size
                part = clip_to_box(part, np.maximum(least, region[0]), np.minimum(most, region[1]))
            shown[name] = ShownObstacle(name, whole, part, part is not corners)
    if planes:
        seen = np.vstack([points, shown_corners(list(shown.values()))])
        for name, plate in _half_space_plates(planes, seen, size, region).items():
            shown[name] = ShownObstacle(name, hull_surface(plate), plate, True)
    return [shown[name] for name in scene.standing if name in shown]


def shown_corners(shown: Sequence[ShownObstacle]) -> Array:
    """Return the corners of the bounding boxes of the shown parts, (n, 3) [m], world frame."""
    parts = [obstacle.near for obstacle in shown if len(obstacle.near)]
    return np.vstack([np.zeros((0, 3)), *(box_corners(part.min(axis=0), part.max(axis=0)) for part in parts)])


def _half_space_plates(
    planes: dict[str, tuple[Array, float]], seen: Array, size: float, region: tuple[Array, Array]
) -> dict[str, Array]:
    """Return the corners of a plate below the surface of each half-space that reaches into a region."""
    middle = (seen.min(axis=0) + seen.max(axis=0)) / 2.0
    half = np.ptp(seen, axis=0) / 2.0
    half = np.maximum(half, DRAWING.plate_width * size / 2.0)
    low = middle - half
    high = middle + half
    feet = [low[None], high[None]]
    for normal, offset in planes.values():
        heights = box_corners(*region) @ normal - offset
        if heights.min() < 0.0 < heights.max():
            corners = box_corners(low, high)
            feet.append(np.clip(corners - np.outer(corners @ normal - offset, normal), *region))
    reach = np.vstack(feet)
    thickness = DRAWING.plate_thickness * size
    room = box_corners(reach.min(axis=0) - thickness, reach.max(axis=0) + thickness)
    plates = {}
    for name, (normal, offset) in planes.items():
        plate = cut_by_plane(room, normal, offset)
        if len(plate):
            plate = cut_by_plane(plate, -normal, thickness - offset)
        if len(plate):
            plates[name] = plate
    return plates


ROOT = "/pinposture"


class MarkSizes(NamedTuple):
    """Sizes of control points, of the hoops of their targets, and of lines."""

    point: float = 1.9
    """Radius of an active control point, relative to `link_radius`."""

    idle: float = 0.75
    """Radius of an inactive control point, relative to an active one."""

    nothing: float = 1e-3
    """Size of a hoop without a target."""

    hoop: float = 1.35
    """Radius of a hoop, relative to that of a control point."""

    wire: float = 0.14
    """Radius of its wire, relative to that of a control point."""

    hoop_sides: int = 32
    """Number of sides of the polygon that approximates a hoop."""

    line: float = 0.25
    """Radius of lines through targets, relative to `link_radius`."""


SIZES = MarkSizes()


def body_path(index: int) -> str:
    """Return the path of the body moved by joint `index` of the chain."""
    return f"{ROOT}/arm/body_{index + 1:03d}"


def point_path(index: int) -> str:
    """Return the path of the control point on the body moved by joint `index` of the chain."""
    return f"{body_path(index)}/point"


class Track(NamedTuple):
    """The values of one property of one object over time.

    `meshcat.animation.AnimationTrack` takes three times the space, because it packs each number of each frame
    separately, and cannot hold a value until the next.

    Attributes:
        path: the object in the viewer.
        name: the property, for example "position".
        kind: "vector3", "quaternion" (x, y, z, w) or "color" (red, green, blue in [0, 1]).
        times: increasing times, (n,) [frames].
        values: (n, 3) or (n, 4).
        smooth: whether values are interpolated; otherwise each is held until the next.
    """

    path: str
    name: str
    kind: str
    times: Array
    values: Array
    smooth: bool = True

    def lower(self) -> dict[str, Any]:
        """Return the track in meshcat's format, with numbers packed in single precision."""
        lowered: dict[str, Any] = {"name": f".{self.name}", "type": self.kind}
        for name, numbers in (("times", self.times), ("values", self.values)):
            lowered[name] = umsgpack.Ext(0x17, numbers.astype("<f4").tobytes())
        if not self.smooth:
            lowered["interpolation"] = 2300  # three.js's InterpolateDiscrete
        return lowered


def pose_tracks(path: str, times: Array, positions: Array, turns: Array) -> list[Track]:
    """Return the tracks of an object with positions (n, 3) [m] and quaternions (n, 4), (x, y, z, w)."""
    return [
        Track(path, "position", "vector3", times, positions),
        Track(path, "quaternion", "quaternion", times, turns),
    ]


class PlaybackTimes(NamedTuple):
    """Times of an animation [s]."""

    rest_before: float = 0.6
    """Time for which the first posture is held."""

    rest_after: float = 1.6
    """Time for which the last posture is held."""

    shortest: float = 2.0
    """Smallest duration of a run; short ones are shown more slowly."""

    longest: float = 60.0
    """Largest duration of a motion in time; longer ones are shown faster."""


PLAYBACK = PlaybackTimes()


@dataclass(frozen=True)
class Timeline:
    """The shown configurations of a run or motion, with their times.

    Attributes:
        run: the run, or that of the motion.
        motion: the motion; None for a run, whose steps have no time.
        rows: shown rows of `run.q`, increasing, first and last included, (f,).
        times: time of each of these rows, (f,) [frames].
        end: time at which the animation ends and restarts [frames].
        fps: frames per second.
        speedup: playback speed relative to the motion; 1 is real time.
    """

    run: Run
    motion: Trajectory | None
    rows: NDArray[np.intp]
    times: Array
    end: float
    fps: float
    speedup: float = 1.0

    @property
    def key_rows(self) -> NDArray[np.intp]:
        """Index into `rows` for each of `key_times`, (f + 2,)."""
        return np.concatenate([[0], np.arange(len(self.rows)), [len(self.rows) - 1]])

    @property
    def key_times(self) -> Array:
        """`times` with start and end added, to hold the first and last configurations, (f + 2,) [frames]."""
        return np.concatenate([[0.0], self.times, [self.end]])


def playback(shown: Run | Trajectory, fps: float, max_frames: int) -> Timeline:
    """Choose the configurations to show: all, or as many as allowed, evenly spaced.

    A motion is shown in real time, or 2, 5, 10, ... times as fast if that exceeds `PLAYBACK.longest`.

    Args:
        shown: a run, or a motion in time.
        fps: configurations of a motion per second of playback, fewer if it has fewer; steps of a run per
            second, fewer if it would take less than `PLAYBACK.shortest`.
        max_frames: maximum number of configurations, at least 2.

    Raises:
        InvalidValue: invalid `fps` or `max_frames`.
    """
    if not (np.isfinite(fps) and 0.0 < fps <= 120.0):
        raise InvalidValue("fps", fps, "a number above 0, at most 120 [1/s]")
    require_whole("max_frames", max_frames, 2)
    if isinstance(shown, Trajectory):
        return _motion_playback(shown, float(fps), max_frames)
    count = min(shown.steps + 1, max_frames)
    fps = min(fps, max(count - 1, 1) / PLAYBACK.shortest)
    rows = np.round(np.linspace(0, shown.steps, count)).astype(np.intp)
    times = PLAYBACK.rest_before * fps + np.arange(count, dtype=np.float64)
    return Timeline(shown, None, rows, times, float(times[-1] + PLAYBACK.rest_after * fps), float(fps))


def _motion_playback(motion: Trajectory, fps: float, max_frames: int) -> Timeline:
    """Choose the rows of a motion to show and their times, with 1 / `fps` as the unit of time."""
    factors = (digit * 10.0**power for power in itertools.count() for digit in (1.0, 2.0, 5.0))
    end = float(motion.time[-1])
    speedup = next(factor for factor in factors if end <= PLAYBACK.longest * factor * (1.0 + 1e-9))
    frames = int(np.ceil(motion.time[-1] / speedup * fps))
    count = min(frames, motion.steps, max_frames - 1) + 1
    rows = np.round(np.linspace(0, motion.steps, count)).astype(np.intp)
    times = (PLAYBACK.rest_before + motion.time[rows] / speedup) * fps
    last = float(times[-1] + PLAYBACK.rest_after * fps)
    return Timeline(motion.run, motion, rows, times, last, fps, speedup)


def arm_tracks(arm: Arm, shown: Timeline) -> list[Track]:
    """Return the tracks of the bodies of the arm and of its control points.

    A control point counts as active at a configuration if it is active in the following step; at the last
    configuration, in the preceding step.
    """
    run = shown.run
    poses = body_poses(arm, run.q[shown.rows])  # (f, n, 4, 4)
    held = shown.key_rows
    times = shown.key_times
    listed = []
    for u in range(poses.shape[1]):
        turns = Rotation.from_matrix(poses[:, u, :3, :3]).as_quat()
        listed += pose_tracks(body_path(u), times, poses[held, u, :3, 3], turns[held])
    if run.steps:
        active = run.active[np.minimum(shown.rows, run.steps - 1)][held]  # (f + 2, m)
        ends = [u for u, body in enumerate(bodies(arm)) if body.point is not None]
        for u, on in zip(ends, active.T, strict=True):
            listed.extend(_activity_tracks(point_path(u), times, on))
    return listed


def _activity_tracks(path: str, times: Array, on: NDArray[np.bool_]) -> list[Track]:
    """Return colour and size tracks of a control point, with a key for each change of its activity."""
    changed = np.concatenate([[True], on[1:] != on[:-1]])
    changed[-1] = True  # all tracks must end together, because each restarts when it ends
    colors = np.where(on[changed, None], palette.rgb(THEME.active), palette.rgb(THEME.idle))
    sizes = np.where(on[changed, None], 1.0, SIZES.idle) * np.ones(3)
    return [
        Track(f"{path}/<object>", "material.color", "color", times[changed], colors, smooth=False),
        Track(path, "scale", "vector3", times[changed], sizes, smooth=False),
    ]


def obstacle_tracks(
    arm: Arm, shown: Timeline, scene: Scene | None, obstacles: Sequence[ShownObstacle]
) -> list[Track]:
    """Return the tracks of the obstacles that the arm holds or carries; they are drawn where they are first.

    Args:
        arm: the arm.
        shown: the timeline.
        scene: the scene at the start, or None.
        obstacles: the obstacles that are drawn.
    """
    if scene is None or not (shown.run.held or scene.carried):
        return []
    moved = obstacle_motions(arm, shown.run.q, shown.run.held, scene, shown.rows.tolist())
    kept = shown.key_rows
    listed = []
    for number, obstacle in enumerate(obstacles):
        if obstacle.name in moved:
            motions = moved[obstacle.name]
            since = [motion * motions[0].inverse() for motion in motions]
            turns = same_signs(np.array([pin.SE3ToXYZQUAT(motion)[3:] for motion in since]))
            positions = np.array([motion.translation for motion in since])
            listed += pose_tracks(obstacle_path(number), shown.key_times, positions[kept], turns[kept])
    return listed


def obstacle_path(number: int) -> str:
    """Return the path of an obstacle by its number among those drawn, 0-based."""
    return f"{ROOT}/obstacles/obstacle_{number + 1:03d}"


def moving_target_tracks(motion: Trajectory, playback: Timeline) -> list[Track]:
    """Return the tracks of the target hoops, which move, appear and disappear."""
    held = playback.key_rows
    times = playback.key_times
    targets = motion.targets[playback.rows]
    mask = motion.target_mask[playback.rows]
    turns = hoop_turns(motion.arm, targets, mask)
    listed = []
    for k in targeted_points(motion):
        path = hoop_path(k)
        listed += pose_tracks(path, times, targets[held, k], turns[held, k])
        if not mask[:, k].all():
            sizes = np.where(mask[held, k, None], 1.0, SIZES.nothing) * np.ones(3)
            listed.append(Track(path, "scale", "vector3", times, sizes, smooth=False))
    return listed


def hoop_path(point: int) -> str:
    """Return the path of the hoop for a control point, 0-based."""
    return f"{ROOT}/target/hoop_{point + 1:03d}"


def hoop_turns(arm: Arm, targets: Array, mask: NDArray[np.bool_]) -> Array:
    """Return orientations of hoops normal to the line through the targets, (f, m, 4), (x, y, z, w).

    Each follows from the previous one by the smallest rotation, so that hoops do not spin.

    Args:
        arm: the arm.
        targets: targets of the control points, (f, m, 3) [m], world frame.
        mask: True for control points with a target, (f, m).
    """
    turns = np.empty((*mask.shape, 4))
    normals = np.broadcast_to([0.0, 0.0, 1.0], (mask.shape[1], 3))
    turn = Rotation.identity(mask.shape[1])
    for row in range(len(targets)):
        ahead = _tangents(arm, targets[row], mask[row], normals)
        turn = _shortest_rotations(normals, ahead) * turn
        normals = ahead
        turns[row] = turn.as_quat()
    return same_signs(turns)


def same_signs(turns: Array) -> Array:
    """Choose the signs of quaternions, (f, ..., 4), such that each is closest to the previous one."""
    flips = np.ones(turns.shape[:-1])
    flips[1:] = np.where(np.sum(turns[1:] * turns[:-1], axis=-1) < 0.0, -1.0, 1.0)
    return np.asarray(turns * np.cumprod(flips, axis=0)[..., None])


def _tangents(arm: Arm, points: Array, mask: NDArray[np.bool_], known: Array) -> Array:
    """Return tangents of the line from the base through targets, (m, 3); `known` ones without a target."""
    tangents: Array = known.copy()
    targeted = np.flatnonzero(mask)
    behind = _unit(np.diff(np.vstack([arm.chain.base, points[targeted]]), axis=0))
    across = behind + np.vstack([behind[1:], behind[-1:]])
    lengths = np.linalg.norm(across, axis=1)
    plain = lengths > 1e-6
    tangents[targeted[plain]] = across[plain] / lengths[plain, None]
    return tangents


def _unit(vectors: Array) -> Array:
    lengths = np.linalg.norm(vectors, axis=1, keepdims=True)
    return np.asarray(vectors / np.maximum(lengths, 1e-12))


def _shortest_rotations(before: Array, after: Array) -> Rotation:
    """Return the smallest rotations between pairs of unit vectors, (m, 3)."""
    axes = np.cross(before, after)
    sines = np.linalg.norm(axes, axis=1, keepdims=True)
    angles = np.arctan2(sines, np.einsum("mi,mi->m", before, after)[:, None])
    aside = np.cross(before, np.eye(3)[np.abs(before).argmin(axis=1)])  # for opposite vectors
    around = np.where(sines > 1e-9, axes / np.maximum(sines, 1e-9), _unit(aside))
    turns: Rotation = Rotation.from_rotvec(angles * around)
    return turns


def targeted_points(motion: Trajectory) -> NDArray[np.intp]:
    """Return the 0-based indices of control points that have a target at some time."""
    return np.asarray(np.flatnonzero(motion.target_mask.any(axis=0)))
