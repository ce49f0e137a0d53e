"""What pictures of an arm show: from where, which line of the target, which obstacles, what surfaces."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple, TypeVar

import coal
import numpy as np
import pinocchio as pin
from numpy.typing import NDArray

from pinposture.arm import Arm
from pinposture.collision import HalfSpace, Scene
from pinposture.errors import InvalidValue
from pinposture.motion import Motion, Trajectory
from pinposture.placement import Target
from pinposture.viz import palette
from pinposture.viz.body import DrawnBody, backbone, bodies, body_meshes, joint_placements
from pinposture.viz.mesh import (
    TriangleMesh,
    ball,
    box_corners,
    clip_to_box,
    cut_by_plane,
    disc,
    hull_surface,
    merge,
    surface,
    tube,
)

Array = NDArray[np.float64]

# Camera.

AZIMUTHS = np.radians([-70.0, -110.0, -45.0, -135.0])
ELEVATIONS = np.radians([22.0, 38.0, 60.0])
"""Views to choose from: x to the right, z up, and none along an axis, where scales would fall together."""

BETTER = 1.3
"""How much more area a view must show than one before it in the list to be preferred to it."""


class Framing(NamedTuple):
    """A look at a cloud of points.

    Attributes:
        center: centre of its bounding box, (3,) [m], world frame.
        radius: distance of the farthest point from there, above 0 [m].
        azimuth: where the eye stands around the vertical, from x towards y [rad].
        elevation: height of the eye above the horizon [rad].
    """

    center: Array
    radius: float
    azimuth: float
    elevation: float

    @property
    def axes(self) -> Array:
        """Unit vectors to the right, up, and towards the eye, (3, 3), world frame."""
        return view_axes(self.azimuth, self.elevation)

    def distance(self, points: Array, opening: float, aspect: float) -> float:
        """How far from the centre the eye must be to see all points.

        Args:
            points: (n, 3) [m], world frame.
            opening: vertical opening of the camera [rad].
            aspect: width of the picture relative to its height.

        Returns:
            Distance [m].
        """
        right, up, near = self.axes @ (points - self.center).T
        slope = np.tan(opening / 2.0)
        needed = np.maximum(np.abs(up), np.abs(right) / aspect) / slope + near
        return max(float(needed.max()), 2.0 * self.radius)


def frame_points(points: Array) -> Framing:
    """Look at points from where they spread over the largest area.

    Args:
        points: (n, 3) [m], world frame, n >= 1.
    """
    center = (points.max(axis=0) + points.min(axis=0)) / 2.0
    offsets = points - center
    radius = max(float(np.linalg.norm(offsets, axis=1).max()), 1e-9)
    # A little spread in every direction lets a line, which has no area from anywhere, show its length.
    scatter = offsets.T @ offsets / (len(points) * radius**2) + 1e-4 * np.eye(3)
    chosen, largest = (0.0, 0.0), 0.0
    for elevation in ELEVATIONS:
        for azimuth in AZIMUTHS:
            screen = view_axes(float(azimuth), float(elevation))[:2]
            area = float(np.sqrt(np.linalg.det(screen @ scatter @ screen.T)))
            if area > BETTER * largest:
                chosen, largest = (float(azimuth), float(elevation)), area
    return Framing(center, radius, *chosen)


def view_axes(azimuth: float, elevation: float) -> Array:
    """Unit vectors to the right, up, and towards an eye that stands there [rad], (3, 3), world frame."""
    eye = np.array(
        [np.cos(elevation) * np.cos(azimuth), np.cos(elevation) * np.sin(azimuth), np.sin(elevation)]
    )
    right = np.array([-np.sin(azimuth), np.cos(azimuth), 0.0])
    return np.array([right, np.cross(eye, right), eye])


# Target.

Number = TypeVar("Number", int, float)

SAMPLES = 400
BEYOND = 0.6
"""How much of a curve is shown beyond the last target point, relative to the length of the arm."""


class Outline(NamedTuple):
    """A target as lines, in pieces.

    Attributes:
        covered: what the arm should lie on: the curve between target points that follow each other, or
            without a curve the target posture if it is known, each (n, 3) [m], world frame; none if neither
            is. The base counts as such a point.
        rest: what there is of it before, between and after these, each (k, 3) [m], world frame.
    """

    covered: tuple[Array, ...]
    rest: tuple[Array, ...]


def outline(arm: Arm, target: Target) -> Outline:
    """The line that a target posture lies on, as far as it is known."""
    if target.curve is None:
        return Outline((), ()) if target.q is None else _posture(arm, target.q, target.has_target)
    curve, length = target.curve, target.curve.length
    if target.parameters is None:
        return Outline((curve.at(np.linspace(0.0, length, SAMPLES)),), ())
    places = np.clip(np.append(0.0, target.parameters), 0.0, length)
    end = float(np.max(places[1:][target.has_target], initial=0.0))
    spans = [(float(places[run].min()), float(places[run].max())) for run in _consecutive(target.has_target)]
    covered = _merged(spans)
    edges = [0.0, *(edge for span in covered for edge in span), min(length, end + BEYOND * arm.length)]
    # Less than this of a line cannot be seen, and may not have a direction.
    least = 1e-6 * length
    lines = [
        tuple(curve.at(np.linspace(a, b, SAMPLES)) for a, b in parts if b - a > least)
        for parts in (covered, zip(edges[::2], edges[1::2], strict=True))
    ]
    return Outline(*lines)


def _posture(arm: Arm, q: Array, placed: NDArray[np.bool_]) -> Outline:
    """The posture at a configuration, in pieces from control point to control point."""
    line, ends, count = backbone(arm, q), [0], 1
    for body in bodies(arm):
        if body.point is not None:
            ends.append(count + int(np.linalg.norm(body.nodes - body.point, axis=1).argmin()))
        count += len(body.nodes)
    spans = _merged([(ends[run[0]], ends[run[-1]]) for run in _consecutive(placed)])
    edges = [0, *(edge for span in spans for edge in span), ends[-1]]
    pieces = [
        tuple(line[a : b + 1] for a, b in parts if b > a)
        for parts in (spans, zip(edges[::2], edges[1::2], strict=True))
    ]
    return Outline(*pieces)


def _consecutive(placed: NDArray[np.bool_]) -> list[NDArray[np.intp]]:
    """Points that have a target and follow each other; 0 is the base, which is where it should be."""
    here = np.flatnonzero(np.append(True, placed))
    return np.split(here, np.flatnonzero(np.diff(here) > 1) + 1)


def _merged(spans: list[tuple[Number, Number]]) -> list[tuple[Number, Number]]:
    """Spans in increasing order, those that overlap made one."""
    merged: list[tuple[Number, Number]] = []
    for low, high in sorted(spans):
        if merged and low <= merged[-1][1]:
            merged[-1] = (merged[-1][0], max(merged[-1][1], high))
        else:
            merged.append((low, high))
    return merged


# Surfaces of the arm.


def link_radius(arm: Arm) -> float:
    """Radius of the bars that the arm is drawn with [m]: slender, whatever the modules."""
    module = arm.length / arm.n_modules
    return min(0.25 * module, float(np.clip(0.16 * module, 0.004 * arm.length, 0.015 * arm.length)))


def require_fitting(arm: Arm, run: Trajectory | Motion | None, target: Target | None) -> None:
    """Check that a run or a motion and a target belong to an arm.

    Raises:
        InvalidValue: it is neither a run nor a motion; they have other numbers of joints or control points.
    """
    if run is not None and not isinstance(run, (Trajectory, Motion)):
        raise InvalidValue("run", run, "a Trajectory, as from `track`, or a Motion, as from `move_through`")
    if run is not None and run.q.shape[1] != arm.nq:
        raise InvalidValue("run.q (shape)", run.q.shape, f"(steps + 1, {arm.nq}) for this arm")
    if target is not None and target.points.shape != (arm.n_modules, 3):
        raise InvalidValue("target.points (shape)", target.points.shape, f"({arm.n_modules}, 3) for this arm")


class Surfaces(NamedTuple):
    """What an arm looks like.

    Attributes:
        base: what never moves, world frame [m].
        bodies: one surface for each joint of the chain, from base to tip, body frame [m] (see `viz.body`).
    """

    base: TriangleMesh
    bodies: tuple[TriangleMesh, ...]


def arm_surfaces(arm: Arm) -> Surfaces:
    """The surfaces of an arm: the meshes of its description where those can be read, else round bars."""
    radius, own, listed = link_radius(arm), body_meshes(arm), bodies(arm)
    surfaces = []
    for u, body in enumerate(listed):
        # The ball of the next joint closes a bar, unless it slides away or there is none.
        closed = u + 1 < len(listed) and bool(arm.chain.revolute[u + 1])
        surfaces.append(own.bodies[u] or _body_mesh(body, radius, closed))
    return Surfaces(own.base or _base_mesh(arm, radius), tuple(surfaces))


def visual_model(arm: Arm) -> pin.GeometryModel:
    """The drawn bodies of an arm as geometry that Pinocchio's visualizers show.

    For instance `pinocchio.visualize.MeshcatVisualizer(arm.model, visual_model=visual_model(arm))`. These
    compute with a `pin.Data`, which takes 40 MB for 100 joints and seven times as much for twice as many;
    `view` does without.

    Args:
        arm: the arm.

    Returns:
        One object for the base and one for each joint of the chain, with the shapes and colours of `view`.
    """
    surfaces, places, model = arm_surfaces(arm), joint_placements(arm), pin.GeometryModel()
    drawn = [("base", 0, surfaces.base, palette.BASE, pin.SE3.Identity())]
    for u, (body, mesh) in enumerate(zip(bodies(arm), surfaces.bodies, strict=True)):
        joint, shade = arm.model.getJointId(body.joint), palette.MODULES[body.module % len(palette.MODULES)]
        # Surfaces have the axes of the world at the neutral configuration.
        placement = pin.SE3(places[joint].rotation.T, np.zeros(3))
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


def scene_points(arm: Arm, run: Trajectory | None, target: Target | None) -> Array:
    """What the camera should see: the whole motion and the target, (n, 3) [m], world frame."""
    points = [arm.chain.base[None]]
    if run is not None:
        points.append(run.points.reshape(-1, 3))
    if target is not None:
        lines = outline(arm, target)
        points += [target.points[target.has_target], *lines.covered, *lines.rest]
    if run is None:
        points.append(backbone(arm, arm.neutral()))
        # The arm may be shown anywhere later on; leave room around its base.
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
    """A plate where the base link stands, with a bar to the first joint if that is elsewhere."""
    foot, joint = np.asarray(arm.base_placement.translation), arm.chain.base
    gap = float(np.linalg.norm(joint - foot))
    if gap > 1e-6 * arm.length and arm.urdf is not None:
        return merge(
            [disc(foot, (joint - foot) / gap, 3.0 * radius, radius), tube(np.array([foot, joint]), radius)]
        )
    reach = arm.chain.points[-1] - joint
    length = float(np.linalg.norm(reach))
    axis = reach / length if length > 1e-9 * arm.length else np.array([0.0, 0.0, 1.0])
    return disc(joint - axis * radius, axis, 3.0 * radius, radius)


# Obstacles.

ROOM = 0.5
"""How far around what is shown a picture may grow to show obstacles, relative to the size of that."""

INTO = 0.25
"""How much is shown of an obstacle that is larger than that, relative to the same."""

THICKNESS = 0.02
"""Thickness of the patch that stands for a half-space, relative to the size of what is shown."""

MANY = 24
"""Number of obstacles beyond which each has to let through more."""

WIDTH = 0.3
"""Least width of such a patch, relative to that size."""


class ShownObstacle(NamedTuple):
    """An obstacle, and the part of it that belongs into the picture.

    Attributes:
        name: its name in the scene.
        surface: the whole of it, world frame [m]; of a half-space a patch that fits the picture.
        near: corners of its part in the picture, (k, 3) [m], world frame; none if it is far away.
        cut: whether that is less than all of it.
    """

    name: str
    surface: TriangleMesh
    near: Array
    cut: bool


def shown_obstacles(scene: Scene | None, points: Array) -> list[ShownObstacle]:
    """What a picture shows of a scene: of what is near all, of what is huge a part, of what is far nothing.

    Args:
        scene: the scene; None if there is none.
        points: what else the picture shows, (n, 3) [m], world frame.

    Returns:
        The obstacles in the order of the scene, without half-spaces that end too far away.
    """
    if scene is None or not scene.obstacles:
        return []
    low, high = points.min(axis=0), points.max(axis=0)
    size = max(float(np.max(high - low)), 1e-9)
    region = low - ROOM * size, high + ROOM * size
    listed: dict[str, ShownObstacle] = {}
    for name, obstacle in scene.obstacles.items():
        if not isinstance(obstacle, HalfSpace):
            whole = surface(obstacle)
            part = _part_in_view(whole.vertices, low, high, size)
            listed[name] = ShownObstacle(name, whole, part, part is not whole.vertices)
    planes = {name: each for name, each in scene.obstacles.items() if isinstance(each, HalfSpace)}
    if planes:
        seen = np.vstack([points, shown_corners(list(listed.values()))])
        listed.update(_half_space_patches(planes, seen, size, region))
    return [listed[name] for name in scene.obstacles if name in listed]


def _part_in_view(corners: Array, low: Array, high: Array, size: float) -> Array:
    """Corners of what is shown of a solid: all of it, if it is near, or as little as tells where it is."""
    region = low - ROOM * size, high + ROOM * size
    part = clip_to_box(corners, *region)
    if part is corners or not len(part):
        return part
    least = np.minimum(low, part.max(axis=0)) - INTO * size
    most = np.maximum(high, part.min(axis=0)) + INTO * size
    return clip_to_box(part, np.maximum(least, region[0]), np.minimum(most, region[1]))


def shown_corners(shown: Sequence[ShownObstacle]) -> Array:
    """Corners of boxes around the parts of obstacles in the picture, (n, 3) [m], world frame."""
    parts = [each.near for each in shown if len(each.near)]
    return np.vstack([np.zeros((0, 3)), *(box_corners(part.min(axis=0), part.max(axis=0)) for part in parts)])


def _half_space_patches(
    planes: dict[str, HalfSpace], seen: Array, size: float, region: tuple[Array, Array]
) -> dict[str, ShownObstacle]:
    """Of each half-space that reaches into a region a plate, as large as what is seen, under its surface."""
    middle, half = (seen.min(axis=0) + seen.max(axis=0)) / 2.0, np.ptp(seen, axis=0) / 2.0
    half = np.maximum(half, WIDTH * size / 2.0)
    low, high = middle - half, middle + half
    feet = [low[None], high[None]]
    normals = {name: np.array(plane.normal) for name, plane in planes.items()}
    offsets = {name: float(normals[name] @ plane.point) for name, plane in planes.items()}
    for name in planes:
        heights = box_corners(*region) @ normals[name] - offsets[name]
        if heights.min() < 0.0 < heights.max():
            corners = box_corners(low, high)
            dropped = corners - np.outer(corners @ normals[name] - offsets[name], normals[name])
            feet.append(np.clip(dropped, *region))
    reach = np.vstack(feet)
    room = box_corners(reach.min(axis=0) - THICKNESS * size, reach.max(axis=0) + THICKNESS * size)
    shown = {}
    for name in planes:
        plate = cut_by_plane(room, normals[name], offsets[name])
        plate = cut_by_plane(plate, -normals[name], THICKNESS * size - offsets[name]) if len(plate) else plate
        if len(plate):
            shown[name] = ShownObstacle(name, hull_surface(plate), plate, True)
    return shown
