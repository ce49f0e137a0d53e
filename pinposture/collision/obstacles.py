"""Obstacles: solids that do not move, in metres and in the world frame; mesh files."""

from __future__ import annotations

import os
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, fields
from importlib.util import find_spec
from os import PathLike
from pathlib import Path
from types import MappingProxyType
from typing import Any, ClassVar, NamedTuple, TypeAlias
from urllib.parse import unquote, urlsplit

import coal
import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.spatial import ConvexHull, QhullError

from pinposture._validation import (
    LARGEST_LENGTH,
    SMALLEST_LENGTH,
    Matrix,
    Vector,
    direction,
    is_number,
    known_keys,
    length,
    point,
    rotation,
)
from pinposture.arm.urdf_reader import parse_xml
from pinposture.errors import FileError, InvalidValue, PostureError, UnknownName
from pinposture.storage import read_text

Array = NDArray[np.float64]

MESH_FORMATS = (".stl", ".obj", ".dae", ".ply")  # suffixes of the mesh files that can be read


class Triangles(NamedTuple):
    """A triangulated surface.

    Attributes:
        vertices: its corners, (n, 3) [m].
        faces: triangles as indices of corners, (t, 3).
    """

    vertices: NDArray[np.float64]
    faces: NDArray[np.intp]


def find_mesh(filename: str, package_dirs: Sequence[str] = ()) -> Path:
    """Find the mesh file that a robot description refers to.

    Args:
        filename: "package://name/rest", "file:///...", or a path; relative paths start at `package_dirs`.
        package_dirs: folders to search, which hold packages, are packages, or lie in packages. Packages
            are also searched in the folders of the environment variable ROS_PACKAGE_PATH. A package has
            the name of its folder, or that in its package.xml.

    Raises:
        FileError: there is no such file.
    """
    folders = [Path(folder) for folder in package_dirs]
    candidates: Iterable[Path]
    if filename.startswith("package://"):
        name, _, rest = filename.removeprefix("package://").partition("/")
        ros = os.environ.get("ROS_PACKAGE_PATH", "").split(os.pathsep)
        folders += [Path(folder) for folder in ros if folder]
        candidates = (package / rest for package in _packages(name, folders))
    elif filename.startswith("file://"):
        candidates = [Path(unquote(urlsplit(filename).path))]
    else:
        # An absolute path replaces the folder that it is joined to.
        candidates = [folder / filename for folder in folders] or [Path(filename)]
    for candidate in candidates:
        if _is_file(candidate):
            return candidate
    searched = ", ".join(map(str, folders)) or "no folder, for package_dirs (--package-dir) is empty"
    raise FileError(filename, f"is not there (looked in: {searched})")


def read_mesh(path: Path) -> Triangles:
    """Read a mesh file of one of the `MESH_FORMATS`; COLLADA in the unit that it states, others in metres.

    Raises:
        FileError: missing, of another format, or without valid triangles.
    """
    if path.suffix.lower() not in MESH_FORMATS:
        raise FileError(path, f"is of an unknown format; allowed: {', '.join(MESH_FORMATS)}")
    if not _is_file(path):
        raise FileError(path, "no such file")
    if path.suffix.lower() == ".dae" and find_spec("collada") is None:
        raise FileError(path, "is COLLADA, which only the package pycollada reads; install it")
    try:
        import trimesh  # slow, and most arms need no files

        scene = trimesh.load_scene(path, process=False)
        if path.suffix.lower() == ".dae" and scene.units is not None:
            scene = scene.convert_units("meters")
        surface = scene.to_mesh()
        mesh = Triangles(np.array(surface.vertices, dtype=np.float64), np.array(surface.faces, dtype=np.intp))
    except Exception as error:  # a broken file makes a reader raise anything
        raise FileError(path, f"cannot be read: {str(error) or type(error).__name__}") from error
    if not mesh.faces.size:
        raise FileError(path, "holds no triangles")
    if mesh.faces.min() < 0 or mesh.faces.max() >= len(mesh.vertices):
        raise FileError(path, "has triangles with corners that it does not hold")
    return mesh


def _packages(name: str, folders: Sequence[Path]) -> Iterator[Path]:
    """Yield the folders that may be a package: first by their own name, then by that in their package.xml."""
    yield from (folder / name for folder in folders)
    for folder in folders:
        yield from (at for at in (folder, *folder.parents) if at.name == name)
    for folder in folders:
        try:
            below = sorted(at for at in folder.iterdir() if at.is_dir())
        except (OSError, ValueError):
            below = []
        yield from (at for at in (folder, *folder.parents, *below) if _package_name(at) == name)


def _package_name(folder: Path) -> str:
    """Return the name in the package.xml of a folder; empty if there is none that can be read."""
    file = folder / "package.xml"
    if not _is_file(file):
        return ""
    try:
        name = parse_xml(read_text(file), str(file)).findtext("name")
    except PostureError:
        return ""
    return (name or "").strip()


def _is_file(path: Path) -> bool:
    try:
        return path.is_file()
    except (OSError, ValueError):  # a name that is too long or empty
        return False


def scale_factor(path: Any, scale: Any) -> float:
    """Check the arguments of a loader: the name of a file, and the factor of its coordinates.

    Raises:
        InvalidValue: anything else.
    """
    if not isinstance(path, (str, PathLike)):
        raise InvalidValue("path", path, "the name of a file")
    if not is_number(scale) or not SMALLEST_LENGTH <= scale <= LARGEST_LENGTH:
        raise InvalidValue("scale", scale, f"a factor of {SMALLEST_LENGTH:g} to {LARGEST_LENGTH:g}")
    return float(scale)


def _set(solid: object, **values: object) -> None:
    for name, value in values.items():
        object.__setattr__(solid, name, value)


def _check_apart(start: Vector, end: Vector, instead: str) -> None:
    if np.linalg.norm(np.subtract(end, start)) < SMALLEST_LENGTH:
        raise InvalidValue("end", end, f"another point than start; {instead}")


class _Described:
    """Conversion of an obstacle to plain data."""

    def to_dict(self) -> dict[str, Any]:
        """Return the obstacle as data that JSON can hold; see `obstacle_from_dict`."""
        described: dict[str, Any] = {"type": self.type}  # type: ignore[attr-defined]
        for each in fields(self):  # type: ignore[arg-type]
            value = getattr(self, each.name)
            described[each.name] = np.array(value).tolist() if isinstance(value, tuple) else value
        return described


@dataclass(frozen=True)
class Mesh(_Described):
    """The convex hull of points, or of the mesh in a file: hollows are filled.

    A hollow object, such as a ring, is a scene of several convex meshes.

    Attributes:
        vertices: the corners of the hull, (n, 3) [m], in the frame of the mesh, sorted. Any points may be
            given; those inside the hull are dropped.
        center: position of the origin of the mesh in the world, (3,) [m].
        rotation: from the axes of the mesh to the world's, (3, 3); given as such, or as roll, pitch, yaw
            [rad]; the identity if None.
    """

    type: ClassVar[str] = "mesh"
    vertices: tuple[Vector, ...] = field(repr=False)
    center: Vector = (0.0, 0.0, 0.0)
    rotation: Matrix = None  # type: ignore[assignment]  # never None once it is made

    def __post_init__(self) -> None:
        _set(self, vertices=_hull_vertices(self.vertices), center=point("center", self.center))
        _set(self, rotation=rotation("rotation", self.rotation))

    @classmethod
    def load(
        cls, path: str | Path, scale: float = 1.0, center: ArrayLike = (0, 0, 0), rotation: Any = None
    ) -> Mesh:
        """Read the convex hull of the mesh in a file (.stl, .obj, .ply, .dae).

        Args:
            path: the file.
            scale: factor of its coordinates, such as 0.001 for a file in millimetres.
            center: as in `Mesh`.
            rotation: as in `Mesh`.

        Raises:
            FileError: missing, of another format, or without triangles.
            InvalidValue: a value as described in `Mesh`, or a mesh without volume.
        """
        factor = scale_factor(path, scale)
        vertices, _ = read_mesh(Path(path))
        return cls(vertices * factor, center, rotation)  # type: ignore[arg-type]  # converted when made

    @classmethod
    def from_dict(cls, described: Mapping[str, Any], folder: str = ".") -> Mesh:
        """Make the mesh that `to_dict` described, or read one from a file; see `obstacle_from_dict`."""
        values = dict(described)
        known_keys("a mesh", values, ("vertices", "path", "scale", "center", "rotation"))
        if ("path" in values) == ("vertices" in values):
            given = "both" if "path" in values else None
            raise InvalidValue("path or vertices", given, "one of the two: a file, or points (n, 3) [m]")
        if "path" in values:
            path = values.pop("path")
            if not isinstance(path, str):
                raise InvalidValue("path", path, "the name of a file")
            return cls.load(Path(folder) / path, **values)
        if "scale" in values:
            raise InvalidValue("scale", values["scale"], "nothing: vertices are in metres")
        return cls(**values)

    def faces(self) -> NDArray[np.intp]:
        """Return the triangles of the hull as vertex indices, counterclockwise from outside, (t, 3)."""
        hull = ConvexHull(np.array(self.vertices))
        faces = np.array(hull.simplices, dtype=np.intp)
        a, b, c = (hull.points[faces[:, k]] for k in range(3))
        inward = np.einsum("ti,ti->t", np.cross(b - a, c - a), hull.equations[:, :3]) < 0.0
        faces[inward] = faces[inward][:, ::-1]
        return faces


def _hull_vertices(vertices: Any) -> tuple[Vector, ...]:
    allowed = "points (n, 3) [m] that span a volume"
    try:
        points = np.array(vertices, dtype=np.float64)
    except (TypeError, ValueError):
        raise InvalidValue("vertices", vertices, allowed) from None
    if points.ndim != 2 or points.shape[1:] != (3,) or not np.all(np.isfinite(points)):
        raise InvalidValue("vertices", vertices, allowed)
    if points.size and np.abs(points).max() > LARGEST_LENGTH:
        raise InvalidValue("vertices (largest)", float(np.abs(points).max()), f"at most {LARGEST_LENGTH:g} m")
    points, count = np.unique(points, axis=0), 0
    # Corners that are almost in a face may be dropped one by one: repeat until none is.
    while len(points) != count:
        count = len(points)
        try:
            hull = ConvexHull(points)
        except (QhullError, ValueError):
            raise InvalidValue("vertices", f"{count} points", f"{allowed}; these are flat") from None
        points = points[np.sort(hull.vertices)]
    if hull.volume < SMALLEST_LENGTH**3:
        raise InvalidValue("vertices (volume)", float(hull.volume), allowed)
    return tuple((float(x), float(y), float(z)) for x, y, z in points)


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
        size: lengths of its edges along its own axes, (3,) [m].
        rotation: from its axes to the world's, (3, 3); given as such, or as roll, pitch, yaw [rad]; the
            identity if None.
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
        normal: unit vector to the free side, (3,); normalised if it is not.
    """

    type: ClassVar[str] = "half_space"
    point: Vector
    normal: Vector

    def __post_init__(self) -> None:
        _set(self, point=point("point", self.point), normal=direction("normal", self.normal))


Obstacle: TypeAlias = "Sphere | Capsule | Cylinder | Box | HalfSpace | Mesh"

OBSTACLE_TYPES: Mapping[str, type[Obstacle]] = MappingProxyType(
    {kind.type: kind for kind in (Sphere, Capsule, Cylinder, Box, HalfSpace, Mesh)}
)
"""Classes of obstacles by their name in scene files."""


def obstacle_from_dict(described: Mapping[str, Any], folder: str = ".") -> Obstacle:
    """Make the obstacle that `to_dict` described.

    Args:
        described: "type", and the attributes of that type under their names. A mesh has "vertices" or
            "path", the name of a file, and with a path optionally "scale".
        folder: folder to which paths are relative.

    Raises:
        InvalidValue: an attribute that is missing, unknown or invalid.
        UnknownName: there is no such type.
        FileError: the file of a mesh is missing or holds none.
    """
    if not isinstance(described, Mapping):
        raise InvalidValue("obstacle", described, "a table with a 'type'")
    values = dict(described)
    name = values.pop("type", None)
    if name is None:
        raise InvalidValue("type", None, ", ".join(OBSTACLE_TYPES))
    if not isinstance(name, str) or name not in OBSTACLE_TYPES:
        raise UnknownName("type of obstacle", name, OBSTACLE_TYPES)
    kind = OBSTACLE_TYPES[name]
    if kind is Mesh:
        return Mesh.from_dict(values, folder)
    allowed = [each.name for each in fields(kind)]
    known_keys(f"a {name}", values, allowed)
    for key in allowed:
        if key not in values and key != "rotation":
            raise InvalidValue(key, None, f"a value; a {name} has {', '.join(allowed)}")
    return kind(**values)


class Solid(NamedTuple):
    """A solid in some frame, with its bounding volumes.

    Attributes:
        geometry: the shape for coal.
        rotation: from the axes of that shape to the frame, (3, 3).
        position: its origin in the frame, (3,) [m].
        start: one end of the axis of a capsule that contains the solid, (3,) [m].
        end: the other end, (3,) [m]; the same for a sphere.
        radius: radius of that capsule [m]; infinite for a half-space.
        round: True if the solid is that capsule.
        center: centre of a box with the axes of `rotation` that contains the solid, (3,) [m].
        half: half the edges of that box, (3,) [m].
        bound: the tightest bound: "capsule", "box", or "plane" with the normal z and a point `center`.
    """

    geometry: coal.CollisionGeometry
    rotation: Array
    position: Array
    start: Array
    end: Array
    radius: float
    round: bool
    center: Array
    half: Array
    bound: str


def solid(shape: Obstacle) -> Solid:
    """Return a shape with its bounding volumes."""
    if isinstance(shape, Sphere):
        center = np.array(shape.center)
        half = np.full(3, shape.radius)
        geometry = coal.Sphere(shape.radius)
        return Solid(geometry, np.eye(3), center, center, center, shape.radius, True, center, half, "capsule")
    if isinstance(shape, (Capsule, Cylinder)):
        start, end, radius = np.array(shape.start), np.array(shape.end), shape.radius
        length, center, turn = float(np.linalg.norm(end - start)), (start + end) / 2.0, _z_along(end - start)
        round_ = isinstance(shape, Capsule)
        geometry = (coal.Capsule if round_ else coal.Cylinder)(radius, length)
        half = np.array([radius, radius, length / 2.0 + round_ * radius])
        return Solid(geometry, turn, center, start, end, radius, round_, center, half, "capsule")
    if isinstance(shape, HalfSpace):
        normal, place = np.array(shape.normal), np.array(shape.point)
        geometry = coal.Halfspace(np.array([0.0, 0.0, 1.0]), 0.0)  # the points with z <= 0
        whole = np.full(3, np.inf)
        return Solid(geometry, _z_along(normal), place, place, place, np.inf, False, place, whole, "plane")
    turn, center = np.array(shape.rotation), np.array(shape.center)
    if isinstance(shape, Box):
        half = np.array(shape.size) / 2.0
        corners = np.array(np.meshgrid(*np.stack([-half, half], axis=1))).reshape(3, 8).T
        geometry, middle = coal.Box(*shape.size), center
    else:
        corners = np.array(shape.vertices)
        low, high = corners.min(axis=0), corners.max(axis=0)
        half, middle = (high - low) / 2.0, center + turn @ ((high + low) / 2.0)
        geometry = _convex(shape)
    start, end, radius = _capsule_around(corners @ turn.T + center)
    return Solid(geometry, turn, center, start, end, radius, False, middle, half, "box")


def _z_along(axis: Array) -> Array:
    """Return a rotation (3, 3) that turns z to a vector (3,)."""
    z = axis / np.linalg.norm(axis)
    x = np.cross(np.eye(3)[np.argmin(np.abs(z))], z)
    x /= np.linalg.norm(x)
    return np.stack([x, np.cross(z, x), z], axis=1)


def _convex(mesh: Mesh) -> coal.Convex:
    points, faces = coal.StdVec_Vec3s(), coal.StdVec_Triangle()
    for vertex in mesh.vertices:
        points.append(np.array(vertex))
    for face in mesh.faces():
        faces.append(coal.Triangle(*map(int, face)))
    return coal.Convex(points, faces)


def _capsule_around(points: Array) -> tuple[Array, Array, float]:
    """Return axis ends and radius of a capsule around points, along the direction of their largest spread."""
    middle = (points.min(axis=0) + points.max(axis=0)) / 2.0
    offsets = points - middle
    axis = np.linalg.svd(offsets, full_matrices=False)[2][0]
    along = offsets @ axis
    across = np.linalg.norm(offsets - np.outer(along, axis), axis=1)
    radius = float(across.max()) * (1.0 + 1e-9)
    # A point may lie beyond an end of the axis by the extent of the ball there at its distance from the axis.
    reach = np.sqrt(radius**2 - across**2)
    first, last = float(np.min(along + reach)), float(np.max(along - reach))
    if first > last:  # a single ball holds them all
        first = last = (first + last) / 2.0
    return middle + first * axis, middle + last * axis, radius
