"""Obstacles: their types, their descriptions, and the solids that distances are computed from."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Annotated, Any, TypeAlias, cast

import numpy as np
import pinocchio as pin
from numpy.typing import NDArray
from pydantic import ValidationInfo

from pinposture.collision.scan import Scan
from pinposture.collision.shapes import (
    Box,
    Capsule,
    Cylinder,
    HalfSpace,
    Mesh,
    MeshShape,
    Sphere,
)
from pinposture.schema import NotAllowed, in_file, read_again, read_by, read_plain, read_type

Array = NDArray[np.float64]

Obstacle: TypeAlias = "Sphere | Capsule | Cylinder | Box | HalfSpace | Mesh | Scan | MeshShape"

OBSTACLE_TYPES: dict[str, type[Obstacle]] = {
    kind.type: kind for kind in (Sphere, Capsule, Cylinder, Box, HalfSpace, Mesh, Scan)
}
"""Obstacle classes by their type names in scene files; a new subclass of `MeshShape` is added here."""

POSITIONS = ("center", "start", "end", "point")
"""Names of the fields of obstacles that move with them: positions."""

DIRECTIONS = ("rotation", "normal")
"""Names of the fields of obstacles that turn with them."""


def _read_obstacle(value: object, info: ValidationInfo) -> Obstacle:
    """Read an obstacle: a table with its type and the values of that type."""
    if isinstance(value, tuple(OBSTACLE_TYPES.values())):
        return cast(Obstacle, value)
    source = in_file(info)
    if source is None:
        raise NotAllowed(value, ", ".join(kind.__name__ for kind in OBSTACLE_TYPES.values()))
    if not isinstance(value, Mapping):
        raise NotAllowed(value, "a table with a 'type'")
    kind = OBSTACLE_TYPES[read_type(value, OBSTACLE_TYPES, "obstacle")]
    obstacle: Obstacle = read_again(kind, value, source)
    return obstacle


ObstacleField: TypeAlias = Annotated[Any, read_by(_read_obstacle)]
"""An obstacle, in a call and in a file."""


def obstacle_from_dict(described: Mapping[str, Any], folder: str = ".") -> Obstacle:
    """Create an obstacle from its description by `to_dict`.

    Args:
        described: "type", and the attributes of that type by name. A mesh has "vertices" or "path", a file
            name, with an optional "scale"; a scan has "points" or "path". Lengths and angles may be text with
            a unit, as in files.
        folder: folder to which paths are relative.

    Raises:
        InvalidValue: a missing, unknown or invalid attribute.
        UnknownName: an unknown type.
        FileError: the file of a mesh or scan is missing or invalid.
    """
    obstacle: Obstacle = read_plain(ObstacleField, described, folder=folder)
    return obstacle


def describe_types() -> list[str]:
    """Return the types of obstacles, each with the names that its description may have."""
    return [f"{name} ({', '.join(kind.check_keys()[1:])})" for name, kind in OBSTACLE_TYPES.items()]


def displaced(obstacle: Obstacle, motion: pin.SE3) -> Obstacle:
    """Return an obstacle after a rigid motion."""
    changes: dict[str, Any] = {}
    for name in POSITIONS:
        if hasattr(obstacle, name):
            changes[name] = motion.act(np.array(getattr(obstacle, name)))
    for name in DIRECTIONS:
        if hasattr(obstacle, name):
            changes[name] = motion.rotation @ np.array(getattr(obstacle, name))
    return obstacle.changed(**changes)
