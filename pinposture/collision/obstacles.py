"""Obstacles: their types, their descriptions, and the solids that distances are computed from."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import MISSING, fields
from typing import Any, TypeAlias

import numpy as np
import pinocchio as pin
from numpy.typing import NDArray

from pinposture._validation import known_keys, require_instance, require_known
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
from pinposture.errors import InvalidValue

Array = NDArray[np.float64]

Obstacle: TypeAlias = "Sphere | Capsule | Cylinder | Box | HalfSpace | Mesh | Scan | MeshShape"

OBSTACLE_TYPES: dict[str, type[Obstacle]] = {
    kind.type: kind for kind in (Sphere, Capsule, Cylinder, Box, HalfSpace, Mesh, Scan)
}
"""Obstacle classes by their type names in scene files; a new subclass of `MeshShape` is added here."""

PLACES = ("center", "start", "end", "point")
"""Names of the fields of obstacles that move with them: positions."""

DIRECTIONS = ("rotation", "normal")
"""Names of the fields of obstacles that turn with them."""


def obstacle_from_dict(described: Mapping[str, Any], folder: str = ".") -> Obstacle:
    """Create an obstacle from its description by `to_dict`.

    Args:
        described: "type", and the attributes of that type by name. A mesh has "vertices" or "path", a file
            name, with an optional "scale"; a scan has "points" or "path".
        folder: folder to which paths are relative.

    Raises:
        InvalidValue: a missing, unknown or invalid attribute.
        UnknownName: an unknown type.
        FileError: the file of a mesh or scan is missing or invalid.
    """
    require_instance("obstacle", described, Mapping, "a table with a 'type'")
    values = dict(described)
    name = values.pop("type", None)
    if name is None:
        raise InvalidValue("type", None, ", ".join(OBSTACLE_TYPES))
    require_known("type of obstacle", name, OBSTACLE_TYPES)
    kind = OBSTACLE_TYPES[name]
    if issubclass(kind, Mesh | Scan):
        return kind.from_dict(values, folder)
    known_keys(f"a {name}", values, kind.keys())
    for key in (each.name for each in fields(kind) if each.default is MISSING):
        if key not in values:
            raise InvalidValue(key, None, f"a value; a {name} has {', '.join(kind.keys())}")
    return kind(**values)


def describe_types() -> list[str]:
    """Return the types of obstacles, each with the names that its description may have."""
    return [f"{name} ({', '.join(kind.keys())})" for name, kind in OBSTACLE_TYPES.items()]


def displaced(obstacle: Obstacle, motion: pin.SE3) -> Obstacle:
    """Return an obstacle after a rigid motion."""
    changes: dict[str, Any] = {}
    for name in PLACES:
        if hasattr(obstacle, name):
            changes[name] = motion.act(np.array(getattr(obstacle, name)))
    for name in DIRECTIONS:
        if hasattr(obstacle, name):
            changes[name] = motion.rotation @ np.array(getattr(obstacle, name))
    return obstacle.changed(**changes)
