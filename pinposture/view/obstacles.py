"""Which obstacles are in a picture, and how much of them."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from pinposture.scene import HalfSpace, Scene
from pinposture.view import palette
from pinposture.view.commands import Command, draw
from pinposture.view.convex import box_corners, cut, hull_faces, within
from pinposture.view.mesh import Mesh
from pinposture.view.scene import ROOT
from pinposture.view.solids import faceted, surface

Array = NDArray[np.float64]

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


class Shown(NamedTuple):
    """An obstacle, and the part of it that belongs into the picture.

    Attributes:
        name: its name in the scene.
        surface: the whole of it, world frame [m]; of a half-space a patch that fits the picture.
        near: corners of its part in the picture, (k, 3) [m], world frame; none if it is far away.
        cut: whether that is less than all of it.
    """

    name: str
    surface: Mesh
    near: Array
    cut: bool


def shown_obstacles(scene: Scene | None, points: Array) -> list[Shown]:
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
    listed: dict[str, Shown] = {}
    for name, obstacle in scene.obstacles.items():
        if not isinstance(obstacle, HalfSpace):
            whole = surface(obstacle)
            part = _near(whole.vertices, low, high, size)
            listed[name] = Shown(name, whole, part, part is not whole.vertices)
    planes = {name: each for name, each in scene.obstacles.items() if isinstance(each, HalfSpace)}
    if planes:
        seen = np.vstack([points, near_corners(list(listed.values()))])
        listed.update(_patches(planes, seen, size, region))
    return [listed[name] for name in scene.obstacles if name in listed]


def _near(corners: Array, low: Array, high: Array, size: float) -> Array:
    """Corners of what is shown of a solid: all of it, if it is near, or as little as tells where it is."""
    region = low - ROOM * size, high + ROOM * size
    part = within(corners, *region)
    if part is corners or not len(part):
        return part
    least = np.minimum(low, part.max(axis=0)) - INTO * size
    most = np.maximum(high, part.min(axis=0)) + INTO * size
    return within(part, np.maximum(least, region[0]), np.minimum(most, region[1]))


def near_corners(shown: Sequence[Shown]) -> Array:
    """Corners of boxes around the parts of obstacles in the picture, (n, 3) [m], world frame."""
    parts = [each.near for each in shown if len(each.near)]
    return np.vstack([np.zeros((0, 3)), *(box_corners(part.min(axis=0), part.max(axis=0)) for part in parts)])


def obstacle_commands(shown: Sequence[Shown]) -> list[Command]:
    """Draw obstacles in the browser; the walls of a pipe, for instance, hide what is in it but a little."""
    opacity = palette.SHEER if len(shown) > MANY else palette.SEE_THROUGH
    return [
        draw(f"{ROOT}/obstacles/obstacle_{k + 1:03d}", each.surface, palette.OBSTACLE, opacity)
        for k, each in enumerate(shown)
    ]


def _patches(
    planes: dict[str, HalfSpace], seen: Array, size: float, region: tuple[Array, Array]
) -> dict[str, Shown]:
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
        plate = cut(room, normals[name], offsets[name])
        plate = cut(plate, -normals[name], THICKNESS * size - offsets[name]) if len(plate) else plate
        if len(plate):
            shown[name] = Shown(name, faceted(plate, hull_faces(plate)), plate, True)
    return shown
