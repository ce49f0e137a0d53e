"""Whether an arm that follows a path fits through the gaps on its way."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from typing import NamedTuple, cast

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import linprog

from pinposture.collision import CollisionModel, Scene
from pinposture.collision.bodies import bodies_of
from pinposture.collision.model import Distances
from pinposture.errors import InvalidValue, TaskError, warn_caller
from pinposture.task.reference import Reference, Way, Waypoint
from pinposture.units import length_text

Array = NDArray[np.float64]


class PassageSettings(NamedTuple):
    """Which postures on the way are checked for clearance, and moved."""

    max_checked_rows: int = 500
    """Largest number of postures on the way whose clearance is computed."""

    max_tried_rows: int = 60
    """Largest number of postures, those that intrude most, for which a place with more room is sought."""

    margin_share: float = 0.999
    """Share of the margin that counts as kept."""


PASSAGE = PassageSettings()


class Gap(NamedTuple):
    """The room of a body between the obstacles around it.

    Attributes:
        body: name of the body.
        obstacles: names of the nearest obstacles.
        room: largest clearance that a small motion of the body can give it [m], at most the margin.
    """

    body: str
    obstacles: tuple[str, ...]
    room: float


def require_passage(reference: Reference, scene: Scene | None, max_lag: float) -> None:
    """Refuse a way on which no place near the path is clear; warn of one that intrudes into the margin.

    Only ways that the arm has to follow count (`Waypoint.way`).

    Args:
        reference: the planned motion.
        scene: the obstacles, of which those that move do not count; None without any.
        max_lag: largest accepted distance of the arm from the path, beyond that of the plan [m].

    Raises:
        TaskError: the gap between obstacles is too narrow for a body and the margin; names the amounts.
    """
    if scene is None:
        return
    still = {name: each for name, each in scene.obstacles.items() if name not in scene.moving}
    scene = scene.with_obstacles(still).without_self_collision()
    for waypoint, rows, distances in _ways(reference, scene):
        model = CollisionModel(reference.arm, scene)
        where = f"the way to {waypoint.name!r}"
        shift = 2.0 * cast(Way, waypoint.way).planned + max_lag
        intruding = np.flatnonzero(distances < _kept(reference, scene))
        intruding = intruding[np.argsort(distances[intruding], kind="stable")]
        for row in rows[intruding[: PASSAGE.max_tried_rows]].tolist():
            state = reference.arm.chain_at(reference.configuration(row))
            gap = _narrowest(model.nearest(state, scene.margin + 2.0 * shift), scene, shift)
            if gap is not None and gap.room < _kept(reference, scene):
                raise TaskError(where, _in_words(gap, reference, scene, shift, row))
        if len(intruding):
            warn_caller(
                f"{where}: {_closest(reference, scene, rows, distances)}; the arm has to leave its path"
            )


def require_wide_pipe(reference: Reference, scene: Scene, radius: float) -> None:
    """Refuse a pipe around the path whose walls the planned postures touch, or come too close to.

    Args:
        reference: the planned motion.
        scene: the pipe and its margin.
        radius: radius of the pipe [m].

    Raises:
        InvalidValue: the pipe is too narrow; names the amounts.
    """
    scene = replace(scene, self_collision=False)
    for waypoint, rows, distances in _ways(reference, scene):
        missing = scene.margin - float(distances.min())
        if distances.min() < _kept(reference, scene):
            needed = f"{radius + missing:.4g} m or more: {_closest(reference, scene, rows, distances)}"
            planned = length_text(cast(Way, waypoint.way).planned)
            off = f"the planned postures are up to {planned} off the path"
            raise InvalidValue("pipe", radius, f"{needed}; {off}; {length_text(missing)} are missing")


def _ways(reference: Reference, scene: Scene) -> Iterator[tuple[Waypoint, NDArray[np.int64], Array]]:
    """Yield the end of each way that the arm has to follow, rows on it, and the clearance at each [m]."""
    first = 0
    for waypoint in reference.waypoints:
        if waypoint.way is not None:
            model = CollisionModel(reference.arm, scene)  # made on first use, which takes long
            count = min(waypoint.row - first + 1, PASSAGE.max_checked_rows)
            rows = np.unique(np.linspace(first, waypoint.row, count).astype(np.int64))
            configurations = [reference.configuration(row) for row in rows.tolist()]
            yield waypoint, rows, np.array([model.minimum(q).distance for q in configurations])
        first = waypoint.row


def _kept(reference: Reference, scene: Scene) -> float:
    """Return the clearance from which on the margin counts as kept [m]."""
    return PASSAGE.margin_share * scene.margin - 1e-9 * reference.arm.length


def _closest(reference: Reference, scene: Scene, rows: NDArray[np.int64], distances: Array) -> str:
    """Say which two come closest, where, and what the margin is."""
    row = int(rows[np.argmin(distances)])
    closest = CollisionModel(reference.arm, scene).minimum(reference.configuration(row))
    pair = " and ".join(closest.pair or ())
    apart = f"{pair} come within {1e3 * closest.distance:.3g} mm at {reference.times[row]:.4g} s of the plan"
    return f"{apart}; the margin is {1e3 * scene.margin:.3g} mm"


def _narrowest(near: Distances, scene: Scene, shift: float) -> Gap | None:
    """Return the gap with the least room; None if no obstacle is near."""
    bodies: dict[str, list[int]] = {}
    for index, (body, other) in enumerate(near.pairs):
        if other in scene.obstacles:
            bodies.setdefault(body, []).append(index)
    gaps = [_gap(body, near, np.array(chosen), scene.margin, shift) for body, chosen in bodies.items()]
    return min(gaps, key=lambda gap: gap.room, default=None)


def _gap(body: str, near: Distances, chosen: NDArray[np.int64], margin: float, shift: float) -> Gap:
    """Return the room of a body: a linear program over small translations and rotations.

    Both move its nearest points by at most `shift` [m] along each axis.
    """
    normals = near.normals[chosen]
    points = near.points[chosen]
    distances = near.distances[chosen]
    arms = points - points.mean(axis=0)
    size = max(float(np.linalg.norm(arms, axis=1).max()), 1e-9)
    turning = np.cross(arms, normals) / size
    rows = np.hstack([-normals, -turning, np.ones((len(chosen), 1))])
    bounds = [(-shift, shift)] * 6 + [(None, margin)]
    found = linprog(np.append(np.zeros(6), -1.0), A_ub=rows, b_ub=distances, bounds=bounds)
    room = float(found.x[6]) if found.success else margin
    names = dict.fromkeys(near.pairs[index][1] for index in chosen[np.argsort(distances, kind="stable")])
    return Gap(body, tuple(names)[:2], room)


def _in_words(gap: Gap, reference: Reference, scene: Scene, shift: float, row: int) -> str:
    bodies = bodies_of(reference.arm, scene.arm_radius)
    radius = max(each.shape.solid().radius for each in bodies if each.name == gap.body)
    return (
        f"the gap at {' and '.join(gap.obstacles)} is too narrow for {gap.body} "
        f"at {reference.times[row]:.4g} s of the plan: "
        f"its radius is {1e3 * radius:.4g} mm and the margin {1e3 * scene.margin:.4g} mm, but "
        f"{1e3 * gap.room:.4g} mm are left within {1e3 * shift:.3g} mm of the path: "
        f"{1e3 * (scene.margin - gap.room):.4g} mm are missing"
    )
