"""What the browser is told to draw: arm, target, camera, as commands of the meshcat viewer."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from pinposture.arm import Arm
from pinposture.errors import InvalidValue
from pinposture.motion import Motion, Trajectory
from pinposture.target import Target
from pinposture.view import palette
from pinposture.view.body import Body, backbone, bodies, body_poses
from pinposture.view.commands import Command, draw, set_property, transform
from pinposture.view.framing import frame_points
from pinposture.view.link_meshes import body_meshes
from pinposture.view.mesh import Mesh, ball, disc, merge, tube
from pinposture.view.outline import outline

Array = NDArray[np.float64]

ROOT = "/pinposture"

FIELD_OF_VIEW = 35.0
"""Vertical opening of the camera [deg]; narrower than usual, so that what is near does not bulge."""

ASPECT = 4.0 / 3.0
"""Narrowest window, width relative to height, for which the camera is placed."""

MARGIN = 1.15
"""How much farther off than needed the camera is."""

POINT_SIZE = 1.9
"""Radius of an active control point, relative to that of the bars of the arm."""

IDLE_SIZE = 0.75
"""Size of a control point that is not active, relative to one that is."""


def body_path(index: int) -> str:
    """Path in the scene of the body that joint `index` of the chain moves."""
    return f"{ROOT}/arm/body_{index + 1:03d}"


def point_path(index: int) -> str:
    """Path in the scene of the control point on the body that joint `index` of the chain moves."""
    return f"{body_path(index)}/point"


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
        bodies: one surface for each joint of the chain, from base to tip, body frame [m] (see `view.body`).
    """

    base: Mesh
    bodies: tuple[Mesh, ...]


def arm_surfaces(arm: Arm) -> Surfaces:
    """The surfaces of an arm: the meshes of its description where those can be read, else round bars."""
    radius, own, listed = link_radius(arm), body_meshes(arm), bodies(arm)
    surfaces = []
    for u, body in enumerate(listed):
        # The ball of the next joint closes a bar, unless it slides away or there is none.
        closed = u + 1 < len(listed) and bool(arm.chain.revolute[u + 1])
        surfaces.append(own.bodies[u] or _body_mesh(body, radius, closed))
    return Surfaces(own.base or _base_mesh(arm, radius), tuple(surfaces))


def arm_commands(arm: Arm, q: Array) -> list[Command]:
    """Draw the arm at a configuration (nq,): one mesh for each body, control points fixed to theirs."""
    radius, surfaces = link_radius(arm), arm_surfaces(arm)
    commands = [draw(f"{ROOT}/arm/base", surfaces.base, palette.BASE)]
    for u, body in enumerate(bodies(arm)):
        shade = palette.MODULES[body.module % len(palette.MODULES)]
        commands.append(draw(f"{body_path(u)}/link", surfaces.bodies[u], shade))
        if body.point is not None:
            commands.append(draw(point_path(u), ball(np.zeros(3), POINT_SIZE * radius), palette.IDLE))
            commands.append(transform(point_path(u), _placed(body.point, IDLE_SIZE)))
    return commands + pose_commands(arm, q)


def pose_commands(arm: Arm, q: Array) -> list[Command]:
    """Move the arm, drawn before, to a configuration (nq,)."""
    return [transform(body_path(u), pose) for u, pose in enumerate(body_poses(arm, q))]


def target_commands(arm: Arm, target: Target) -> list[Command]:
    """Draw the line that the target posture lies on, as far as it is known, and the target points."""
    radius = 0.3 * link_radius(arm)
    commands = []
    colors = {"covered": palette.TARGET, "rest": palette.REST}
    for part, lines in outline(arm, target)._asdict().items():
        paths = [path for path in map(_without_repeats, lines) if len(path) > 1]
        if paths:
            tubes = merge([tube(path, radius) for path in paths])
            commands.append(draw(f"{ROOT}/target/{part}", tubes, colors[part]))
    dots = [ball(point, 2.8 * radius, rings=6) for point in target.points[target.placed]]
    if dots:
        commands.append(draw(f"{ROOT}/target/points", merge(dots), palette.TARGET))
    return commands


def stage_points(arm: Arm, run: Trajectory | None, target: Target | None) -> Array:
    """What the camera should see: the whole motion and the target, (n, 3) [m], world frame."""
    points = [arm.chain.base[None]]
    if run is not None:
        points.append(run.points.reshape(-1, 3))
    if target is not None:
        lines = outline(arm, target)
        points += [target.points[target.placed], *lines.covered, *lines.rest]
    if run is None:
        points.append(backbone(arm, arm.neutral()))
        # The arm may be shown anywhere later on; leave room around its base.
        points.append(arm.chain.base + 0.35 * arm.length * np.vstack([np.eye(3), -np.eye(3)]))
    return np.vstack(points)


def stage_commands(arm: Arm, points: Array) -> list[Command]:
    """Set up light, floor and camera so that points (n, 3) [m] of the world are in view.

    The viewer turns about the origin of its scene, so the world is shifted until the middle of the points
    is there.
    """
    framing = frame_points(points)
    floor = np.diag([*(0.4 * _round_down(framing.radius) * np.ones(3)), 1.0])
    floor[2, 3] = points[:, 2].min() - framing.center[2] - 3.0 * link_radius(arm)
    distance = MARGIN * framing.distance(points, np.radians(FIELD_OF_VIEW), ASPECT)
    x, y, z = distance * framing.axes[2]
    camera = "/Cameras/default/rotated/<object>"
    properties: list[tuple[str, str, Any]] = [
        ("/Background", "top_color", [1.0, 1.0, 1.0]),
        ("/Background", "bottom_color", [0.90, 0.92, 0.94]),
        ("/Grid", "color", [1.0, 1.0, 1.0, 0.18]),
        ("/Axes", "visible", False),
        ("/Lights/AmbientLight/<object>", "intensity", 0.42),
        ("/Lights/FillLight/<object>", "intensity", 0.25),
        # These two would fade out after 10 m.
        ("/Lights/PointLightNegativeX/<object>", "distance", 0.0),
        ("/Lights/PointLightPositiveX/<object>", "distance", 0.0),
        (camera, "fov", FIELD_OF_VIEW),
        (camera, "near", 0.01 * distance),
        (camera, "far", 100.0 * distance),
        # The camera lives in axes of its own, in which y points up.
        (camera, "position", [x, z, -y]),
    ]
    placed = [transform(ROOT, _placed(-framing.center)), transform("/Grid", floor)]
    return placed + [set_property(path, name, value) for path, name, value in properties]


def _body_mesh(body: Body, radius: float, closed: bool) -> Mesh:
    parts = [ball(np.zeros(3), 1.25 * radius)]
    parts += [tube(body.nodes[i : i + 2], radius) for i in range(len(body.nodes) - 1)]
    parts += [ball(node, radius) for node in (body.nodes[1:-1] if closed else body.nodes[1:])]
    if np.any(body.slide):
        parts.append(tube(np.array([body.slide, np.zeros(3)]), 0.6 * radius))
    return merge(parts)


def _base_mesh(arm: Arm, radius: float) -> Mesh:
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


def _placed(position: Array, scale: float = 1.0) -> Array:
    matrix = np.diag([scale, scale, scale, 1.0])
    matrix[:3, 3] = position
    return matrix


def _round_down(length: float) -> float:
    """The next smaller of 1, 2, 5, 10, ... times a power of ten."""
    power = 10.0 ** np.floor(np.log10(length))
    return float(max(step for step in (1.0, 2.0, 5.0) if step * power <= length * (1.0 + 1e-9)) * power)


def _without_repeats(line: Array) -> Array:
    legs = np.linalg.norm(np.diff(line, axis=0), axis=1)
    return np.asarray(line[np.concatenate([[True], legs > 1e-9])])
