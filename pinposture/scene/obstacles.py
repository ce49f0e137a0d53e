"""What is in the way: solids that do not move, in metres and in the world frame.

The same solids, in the frame of a joint, are the bodies of an arm.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, fields
from types import MappingProxyType
from typing import Any, ClassVar, TypeAlias

import numpy as np

from pinposture.errors import InvalidValue, UnknownName
from pinposture.scene.checks import (
    SMALLEST,
    Matrix,
    Vector,
    direction,
    known_keys,
    length,
    point,
    rotation,
)
from pinposture.scene.mesh import Mesh


def _set(solid: object, **values: object) -> None:
    for name, value in values.items():
        object.__setattr__(solid, name, value)


def _check_apart(start: Vector, end: Vector, instead: str) -> None:
    if np.linalg.norm(np.subtract(end, start)) < SMALLEST:
        raise InvalidValue("end", end, f"another point than start; {instead}")


class _Described:
    """Conversion to plain data, the same for every kind of obstacle but meshes."""

    def to_dict(self) -> dict[str, Any]:
        """The obstacle as data that JSON can hold; see `obstacle_from_dict`."""
        described: dict[str, Any] = {"type": self.type}  # type: ignore[attr-defined]
        for each in fields(self):  # type: ignore[arg-type]
            value = getattr(self, each.name)
            described[each.name] = np.array(value).tolist() if isinstance(value, tuple) else value
        return described


@dataclass(frozen=True)
class Sphere(_Described):
    """A ball.

    Attributes:
        center: its centre, (3,) [m].
        radius: its radius [m].
    """

    type: ClassVar[str] = "sphere"
    center: Vector
    radius: float

    def __post_init__(self) -> None:
        _set(self, center=point("center", self.center), radius=length("radius", self.radius))


@dataclass(frozen=True)
class Capsule(_Described):
    """All points within a radius of a line: a cylinder with round ends.

    Attributes:
        start: one end of the line, (3,) [m].
        end: its other end, (3,) [m].
        radius: the radius [m].
    """

    type: ClassVar[str] = "capsule"
    start: Vector
    end: Vector
    radius: float

    def __post_init__(self) -> None:
        _set(self, start=point("start", self.start), end=point("end", self.end))
        _set(self, radius=length("radius", self.radius))
        _check_apart(self.start, self.end, "a capsule without length is a Sphere")


@dataclass(frozen=True)
class Cylinder(_Described):
    """A cylinder with flat ends.

    Attributes:
        start: centre of one end, (3,) [m].
        end: centre of the other, (3,) [m].
        radius: its radius [m].
    """

    type: ClassVar[str] = "cylinder"
    start: Vector
    end: Vector
    radius: float

    def __post_init__(self) -> None:
        _set(self, start=point("start", self.start), end=point("end", self.end))
        _set(self, radius=length("radius", self.radius))
        _check_apart(self.start, self.end, "a cylinder has a length")


@dataclass(frozen=True)
class Box(_Described):
    """A box.

    Attributes:
        center: its centre, (3,) [m].
        size: its edges along its own axes, whole lengths, (3,) [m].
        rotation: from its axes to the world's, (3, 3); given as such, or as roll, pitch, yaw [rad]; the
            axes of the world if None.
    """

    type: ClassVar[str] = "box"
    center: Vector
    size: Vector
    rotation: Matrix = None  # type: ignore[assignment]  # never None once it is made

    def __post_init__(self) -> None:
        _set(self, center=point("center", self.center), size=point("size", self.size))
        for axis, edge in enumerate(self.size):
            length(f"size[{axis}]", edge)
        _set(self, rotation=rotation("rotation", self.rotation))


@dataclass(frozen=True)
class HalfSpace(_Described):
    """Everything on one side of a plane: a floor, a wall, a ceiling.

    Attributes:
        point: a point of the plane, (3,) [m].
        normal: points away from the solid, to the side that is free, (3,); made a unit vector.
    """

    type: ClassVar[str] = "half_space"
    point: Vector
    normal: Vector

    def __post_init__(self) -> None:
        _set(self, point=point("point", self.point), normal=direction("normal", self.normal))


Obstacle: TypeAlias = "Sphere | Capsule | Cylinder | Box | HalfSpace | Mesh"

KINDS: Mapping[str, type[Obstacle]] = MappingProxyType(
    {kind.type: kind for kind in (Sphere, Capsule, Cylinder, Box, HalfSpace, Mesh)}
)
"""The kinds of obstacles by the name that a scene file gives them."""


def obstacle_from_dict(described: Mapping[str, Any], folder: str = ".") -> Obstacle:
    """The obstacle that `to_dict` described.

    Args:
        described: "type", and the attributes of that kind under their names. A mesh has "vertices" or
            "path", the name of a file, and with a path "scale" if it likes.
        folder: where a relative path begins.

    Raises:
        InvalidValue: an attribute that is missing, unknown or of a wrong value.
        UnknownName: there is no such type.
        FileError: the file of a mesh is missing or holds none.
    """
    if not isinstance(described, Mapping):
        raise InvalidValue("obstacle", described, "a table with a 'type'")
    values = dict(described)
    name = values.pop("type", None)
    if name is None:
        raise InvalidValue("type", None, ", ".join(KINDS))
    if not isinstance(name, str) or name not in KINDS:
        raise UnknownName("type of obstacle", name, KINDS)
    kind = KINDS[name]
    if kind is Mesh:
        return Mesh.from_dict(values, folder)
    allowed = [each.name for each in fields(kind)]
    known_keys(f"a {name}", values, allowed)
    for key in allowed:
        if key not in values and key != "rotation":
            raise InvalidValue(key, None, f"a value; a {name} has {', '.join(allowed)}")
    return kind(**values)
