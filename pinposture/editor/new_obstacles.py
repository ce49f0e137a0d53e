"""Where a new obstacle is put: near the arm, so that it is seen, and clear of it."""

from __future__ import annotations

from collections.abc import Callable, Iterator

import coal
import numpy as np
from numpy.typing import NDArray

from pinposture.arm import Arm
from pinposture.collision import Box, Capsule, Cylinder, HalfSpace, Obstacle, Scene, Sphere
from pinposture.collision.distances import Narrow
from pinposture.collision.obstacles import solid
from pinposture.editor.obstacle_handles import DIGITS, reach
from pinposture.errors import UnknownName

Array = NDArray[np.float64]

ROOM = 0.05
"""How far from the arm, and from other obstacles, it is at least, relative to the arm."""

BELOW = 0.1
"""How far below the arm a new floor is, relative to the arm."""

ALONG = (0.6, 0.4, 0.8, 1.0, 0.25)
"""Where along the arm it is tried, in turn."""

ASIDE = (0.2, 0.3, 0.45, 0.65, 0.9, 1.3)
"""How far from there, relative to the arm."""

SAMPLES = 200
"""Points of the arm that are looked at."""


def _sphere(center: Array, axis: Array, length: float) -> Obstacle:
    del axis
    return Sphere(_vector(center), round(0.06 * length, DIGITS))


def _box(center: Array, axis: Array, length: float) -> Obstacle:
    del axis
    edge = round(0.12 * length, DIGITS)
    return Box(_vector(center), (edge, edge, edge))


def _cylinder(center: Array, axis: Array, length: float) -> Obstacle:
    half = 0.12 * length * axis
    return Cylinder(_vector(center - half), _vector(center + half), round(0.03 * length, DIGITS))


def _capsule(center: Array, axis: Array, length: float) -> Obstacle:
    half = 0.1 * length * axis
    return Capsule(_vector(center - half), _vector(center + half), round(0.03 * length, DIGITS))


SOLIDS: dict[str, Callable[[Array, Array, float], Obstacle]] = {
    "sphere": _sphere,
    "box": _box,
    "cylinder": _cylinder,
    "capsule": _capsule,
}
"""Makes an obstacle of each kind about a centre, along an axis, for an arm of some length."""

KINDS = (*SOLIDS, "half_space")
"""Kinds of obstacles that can be made new."""


def new_obstacle(kind: str, arm: Arm, points: Array, scene: Scene | None) -> Obstacle:
    """An obstacle of a kind, as large as suits the arm, where neither the arm nor another obstacle is.

    Where there is no such place it is put as far from the arm as was tried.

    Args:
        kind: of `KINDS`.
        arm: the arm.
        points: where it is, from base to tip, and perhaps where it is to be, from tip to base, (n, 3) [m],
            world frame.
        scene: what is there already; None if there is nothing.

    Raises:
        UnknownName: there is no such kind.
    """
    if kind not in KINDS:
        raise UnknownName("kind of obstacle", kind, KINDS)
    path = _finer(np.vstack([arm.chain.base, points]))
    up = arm.plane[np.abs(arm.plane[:, 2]).argmax()] if arm.dimension == 2 else np.array([0.0, 0.0, 1.0])
    up = -up if up[2] < 0.0 else up
    if kind == "half_space":
        low = float((path @ up).min()) - BELOW * arm.length
        return HalfSpace(_vector(arm.chain.base + (low - arm.chain.base @ up) * up), _vector(up))
    axis = np.cross(*arm.plane) if arm.dimension == 2 else up
    tried: list[tuple[float, Obstacle]] = []
    for center in _places(arm, path, up):
        obstacle = SOLIDS[kind](center, axis, arm.length)
        room = float(np.linalg.norm(path - center, axis=1).min()) - reach(obstacle)
        if room >= ROOM * arm.length and _free(scene, center, reach(obstacle) + ROOM * arm.length):
            return obstacle
        tried.append((room, obstacle))
    return max(tried, key=lambda each: each[0])[1]


def _places(arm: Arm, path: Array, up: Array) -> Iterator[Array]:
    """Places beside the arm, near ones first."""
    ahead = path[-1] - path[0]
    if float(np.linalg.norm(ahead)) < 1e-3 * arm.length:  # it is closed to a ring
        ahead = arm.plane[0]
    if arm.dimension == 2:
        across = arm.plane.T @ np.array([[0.0, -1.0], [1.0, 0.0]]) @ (arm.plane @ ahead)
        sides = [across, -across]
    else:
        across = np.cross(up, ahead)
        across = across if np.linalg.norm(across) > 1e-3 * arm.length else np.array([0.0, 1.0, 0.0])
        sides = [-across, across, np.cross(ahead, across)]
    for aside in ASIDE:
        for along in ALONG:
            for side in sides:
                size = float(np.linalg.norm(side))
                if size > 0.0:
                    yield path[round(along * (SAMPLES - 1))] + aside * arm.length * side / size


def _finer(points: Array) -> Array:
    """Points evenly along the line through others, (SAMPLES, 3)."""
    along = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(points, axis=0), axis=1))])
    at = np.linspace(0.0, along[-1], SAMPLES)
    return np.stack([np.interp(at, along, points[:, k]) for k in range(3)], axis=1)


def _free(scene: Scene | None, center: Array, radius: float) -> bool:
    """Whether nothing of a scene is within a distance of a place."""
    if scene is None:
        return True
    ball, narrow = coal.Sphere(radius), Narrow()
    at = coal.Transform3s(np.eye(3), center)
    for obstacle in scene.obstacles.values():
        shape = solid(obstacle)
        posed = (ball, at, shape.geometry, coal.Transform3s(shape.rotation, shape.position))
        if not narrow.distance(posed) > 0.0:
            return False
    return True


def _vector(place: Array) -> tuple[float, float, float]:
    x, y, z = (round(float(each), DIGITS) for each in place)
    return x, y, z
