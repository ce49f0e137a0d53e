"""Obstacles: their types, their descriptions, and the solids that distances are computed from."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import MISSING, fields, replace
from typing import Any, NamedTuple, TypeAlias

import coal
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
    Piece,
    Sphere,
)
from pinposture.errors import InvalidValue
from pinposture.kernels.arrays import BOX, CYLINDER, INSIDE, PIECE, PLANE, SEGMENT

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
    if isinstance(obstacle, (Mesh, Scan)):
        center = np.array(obstacle.center)
        turn = np.array(obstacle.rotation)
        return obstacle.placed(motion.act(center), motion.rotation @ turn)
    changes: dict[str, Any] = {}
    for name in PLACES:
        if hasattr(obstacle, name):
            changes[name] = motion.act(np.array(getattr(obstacle, name)))
    for name in DIRECTIONS:
        if hasattr(obstacle, name):
            changes[name] = motion.rotation @ np.array(getattr(obstacle, name))
    return replace(obstacle, **changes)


def geometry_of(obstacle: Obstacle) -> Sphere | Capsule | Cylinder | Box | HalfSpace | Mesh | Scan:
    """Return what distances and pictures are made from: the mesh of a `MeshShape`, others themselves."""
    return obstacle.mesh if isinstance(obstacle, MeshShape) else obstacle


class Solid(NamedTuple):
    """A solid or a piece of a surface in some frame, with its bounding volumes.

    Attributes:
        shape: the coal shape, or a piece of a surface.
        rotation: from the axes of the shape to the frame, (3, 3).
        position: origin of the shape in the frame, (3,) [m].
        start: one axis end of a capsule that contains the solid, (3,) [m].
        end: the other axis end, (3,) [m]; the same for a sphere.
        radius: radius of that capsule [m]; infinite for a half-space. For a piece, the radius of its points.
        center: centre of a box with the axes of `rotation` that contains the solid, (3,) [m].
        half: half the edge lengths of that box, (3,) [m].
        kind: the primitive used for distances from capsules, as in `kernels.arrays.Pairs`.
        exact: whether the solid is that primitive; otherwise the primitive contains it.
    """

    shape: coal.CollisionGeometry | Piece
    rotation: Array
    position: Array
    start: Array
    end: Array
    radius: float
    center: Array
    half: Array
    kind: int
    exact: bool

    @property
    def round(self) -> bool:
        """Whether the solid is identical to its bounding capsule."""
        return self.exact and self.kind == SEGMENT

    @property
    def geometry(self) -> coal.CollisionGeometry:
        """The coal shape."""
        return self.shape[0].geometry(self.shape[1]) if isinstance(self.shape, tuple) else self.shape


def solids(obstacle: Obstacle) -> list[Solid]:
    """Return the solids, or the pieces of the surface, of an obstacle."""
    geometry = geometry_of(obstacle)
    if not isinstance(geometry, (Mesh, Scan)) or (isinstance(geometry, Mesh) and geometry.convex):
        return [solid(geometry)]
    listed = [_piece(geometry, node, PIECE) for node in geometry.tree.pieces]
    if isinstance(geometry, Mesh) and geometry.closed:
        listed.append(_piece(geometry, 1, INSIDE))
    return listed


def _piece(obstacle: Mesh | Scan, node: int, kind: int) -> Solid:
    turn = np.array(obstacle.rotation)
    position = np.array(obstacle.center)
    low, high = obstacle.tree.boxes[node]
    radius = obstacle.point_radius if isinstance(obstacle, Scan) else 0.0
    middle = position + turn @ (0.5 * (low + high))
    half = 0.5 * (high - low) + radius
    return Solid((obstacle.tree, node), turn, position, middle, middle, radius, middle, half, kind, True)


def solid(shape: Sphere | Capsule | Cylinder | Box | HalfSpace | Mesh) -> Solid:
    """Return a convex shape, or the hull of a mesh, with its bounding volumes."""
    if isinstance(shape, Sphere):
        center = np.array(shape.center)
        half = np.full(3, shape.radius)
        geometry = coal.Sphere(shape.radius)
        return Solid(geometry, np.eye(3), center, center, center, shape.radius, center, half, SEGMENT, True)
    if isinstance(shape, (Capsule, Cylinder)):
        start = np.array(shape.start)
        end = np.array(shape.end)
        radius = shape.radius
        length = float(np.linalg.norm(end - start))
        center = (start + end) / 2.0
        turn = _z_along(end - start)
        caps = radius if isinstance(shape, Capsule) else 0.0
        half = np.array([radius, radius, length / 2.0 + caps])
        if isinstance(shape, Capsule):
            geometry = coal.Capsule(radius, length)
            return Solid(geometry, turn, center, start, end, radius, center, half, SEGMENT, True)
        geometry = coal.Cylinder(radius, length)
        return Solid(geometry, turn, center, start, end, radius, center, half, CYLINDER, True)
    if isinstance(shape, HalfSpace):
        normal = np.array(shape.normal)
        place = np.array(shape.point)
        geometry = coal.Halfspace(np.array([0.0, 0.0, 1.0]), 0.0)  # the points with z <= 0
        whole = np.full(3, np.inf)
        return Solid(geometry, _z_along(normal), place, place, place, np.inf, place, whole, PLANE, True)
    turn = np.array(shape.rotation)
    center = np.array(shape.center)
    if isinstance(shape, Box):
        half = np.array(shape.size) / 2.0
        corners = np.array(np.meshgrid(*np.stack([-half, half], axis=1))).reshape(3, 8).T
        geometry = coal.Box(*shape.size)
        middle = center
    else:
        corners = shape.vertices
        low = corners.min(axis=0)
        high = corners.max(axis=0)
        half = (high - low) / 2.0
        middle = center + turn @ ((high + low) / 2.0)
        geometry = _convex(shape)
    start, end, radius = _capsule_around(corners @ turn.T + center)
    return Solid(geometry, turn, center, start, end, radius, middle, half, BOX, isinstance(shape, Box))


def _z_along(axis: Array) -> Array:
    """Return a rotation (3, 3) that takes z to the direction of a vector (3,)."""
    z = axis / np.linalg.norm(axis)
    x = np.cross(np.eye(3)[np.argmin(np.abs(z))], z)
    x /= np.linalg.norm(x)
    return np.stack([x, np.cross(z, x), z], axis=1)


def _convex(mesh: Mesh) -> coal.Convex:
    points = coal.StdVec_Vec3s()
    faces = coal.StdVec_Triangle()
    for vertex in mesh.vertices:
        points.append(vertex)
    for face in mesh.faces:
        faces.append(coal.Triangle(*map(int, face)))
    return coal.Convex(points, faces)


def _capsule_around(points: Array) -> tuple[Array, Array, float]:
    """Return axis ends and radius of a capsule around points, along their direction of largest spread."""
    middle = (points.min(axis=0) + points.max(axis=0)) / 2.0
    offsets = points - middle
    axis = np.linalg.svd(offsets, full_matrices=False)[2][0]
    along = offsets @ axis
    across = np.linalg.norm(offsets - np.outer(along, axis), axis=1)
    radius = float(across.max()) * (1.0 + 1e-9)
    # Points may lie beyond the axis ends, inside the caps.
    reach = np.sqrt(radius**2 - across**2)
    first = float(np.min(along + reach))
    last = float(np.max(along - reach))
    if first > last:  # a single sphere contains all points
        first = last = (first + last) / 2.0
    return middle + first * axis, middle + last * axis, radius
