"""Shapes of obstacles and of the bodies of an arm, in metres."""

from __future__ import annotations

import zlib
from collections.abc import Mapping
from dataclasses import MISSING, Field, field, fields, replace
from functools import cached_property, lru_cache
from pathlib import Path
from types import MappingProxyType
from typing import Annotated, Any, ClassVar, Literal, TypeAlias, TypeVar, cast, get_type_hints

import coal
import numpy as np
import pinocchio as pin
from numpy.typing import ArrayLike, NDArray
from scipy.spatial import ConvexHull, QhullError

from pinposture._validation import (
    LARGEST_LENGTH,
    SMALLEST_LENGTH,
    Matrix,
    Vector,
    as_floats,
    direction,
    length,
    make_read_only,
    point,
    require_instance,
    rotation,
    set_fields,
)
from pinposture.collision.files import Triangles, merge_corners, read_mesh, scale_factor
from pinposture.collision.solids import Solid, Tree, capsule_around, z_along
from pinposture.errors import InvalidValue, warn_caller
from pinposture.kernels.arrays import SOLID
from pinposture.schema import (
    AS_GIVEN,
    CheckedBy,
    Declared,
    InputFile,
    Number,
    OutputFile,
    as_plain,
    declared,
    in_si,
    refusing,
)
from pinposture.storage import settled

Array = NDArray[np.float64]

MAX_PLAUSIBLE_WIDTH = 30.0  # width of a surface above which its unit is probably not metres [m]


def is_closed(faces: NDArray[np.integer]) -> bool:
    """Return whether triangles, (t, 3) vertex indices, enclose a volume: no edge is free."""
    _, counts = np.unique(_edges(faces)[0], return_counts=True)
    return bool(np.all(counts % 2 == 0))


def is_oriented(faces: NDArray[np.integer]) -> bool:
    """Return whether closed triangles, (t, 3), are oriented alike: each edge runs once in each direction."""
    edges, forward = _edges(faces)
    return np.array_equal(np.sort(edges[forward]), np.sort(edges[~forward]))


def _edges(faces: NDArray[np.integer]) -> tuple[NDArray[np.int64], NDArray[np.bool_]]:
    """Return each edge of each triangle as one number, and whether it leads to the larger vertex index."""
    starts = faces.astype(np.int64).ravel()
    ends = faces[:, [1, 2, 0]].astype(np.int64).ravel()
    edges = np.minimum(starts, ends) << 32 | np.maximum(starts, ends)
    return edges[starts != ends], (starts < ends)[starts != ends]


Own = TypeVar("Own", bound="Surface")
Same = TypeVar("Same", bound="Described")
Symmetry: TypeAlias = Literal["none", "axis", "ball"]

UNTURNED: Matrix = ((1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, 1.0))


Size = Annotated[float, CheckedBy(length, "length")]
"""A length above 0 [m]."""

Point = Annotated[Vector, CheckedBy(point, "length")]
"""A point, (3,) [m]."""

Turn = Annotated[Matrix, CheckedBy(rotation, "angle")]
"""A rotation, (3, 3); read also from roll, pitch and yaw [rad], and None as the identity."""


@declared()
class Described(Declared):
    """Base class of shapes, which tables with a `type` describe.

    Attributes:
        type: type name in scene files.
        handles: names of what is dragged to change its size; see `editor.obstacles.size_handles`.
        symmetry: which turns of its pose do not change it: about the third axis, or all.
        bounded: whether it is of finite size.
        convex: whether it is convex; others are known by their surface.
    """

    type: ClassVar[str]
    handles: ClassVar[tuple[str, ...]] = ()
    symmetry: ClassVar[Symmetry] = "none"
    bounded: ClassVar[bool] = True
    convex: ClassVar[bool] = True

    @classmethod
    def check_keys(cls, values: Mapping[str, Any] = MappingProxyType({})) -> tuple[str, ...]:
        """Return the names that a description of it may have."""
        return ("type", *(item.name for item in fields(cls)))

    @classmethod
    def from_table(cls, values: Mapping[str, Any], source: InputFile) -> Any:
        """Return the values of fields."""
        return {key: value for key, value in in_si(values, cls).items() if key != "type"}

    def remember(self, values: Mapping[str, Any], source: InputFile) -> None:
        """Keep angles and names of files as they were given."""
        path = {"path": settled(source.resolve(values["path"]))} if "path" in values else {}
        source.described[self] = in_si(values, type(self)) | path

    def to_table(self, file: OutputFile) -> dict[str, Any]:
        """Return the table: as the file describes it already, or its type and its values."""
        known: dict[str, Any] | None = file.find(self, type(self))
        if known is not None:
            return known
        table = {"type": self.type, **self.written(file)}
        return {key: table[key] for key in self.check_keys() if key in table}

    def to_dict(self, embed: bool = True) -> dict[str, Any]:
        """Return the shape as JSON-compatible data; see `obstacle_from_dict`.

        Args:
            embed: whether to include the points of a mesh or scan from a file, rather than its path.
        """
        described: dict[str, Any] = as_plain(self, embed)
        return described

    @classmethod
    def of_size(cls, center: Vector, axis: Array, size: float) -> Any:
        """Return a new one for the editor: its fields are filled by their names, other numbers are the size.

        Args:
            center: its middle, (3,) [m].
            axis: unit vector along which it is laid, (3,).
            size: its radius, or half its width [m].
        """
        half = 2.0 * size * axis
        values = {
            "center": center,
            "start": center - half,
            "end": center + half,
            "size": np.full(3, 2.0 * size),
        }
        names = cls.check_keys()
        number = 0.5 * size if "start" in names else size
        values |= {item.name: number for item in number_fields(cls) if item.default is MISSING}
        return cls(**{name: value for name, value in values.items() if name in names})

    def changed(self: Same, **values: Any) -> Same:
        """Return a copy with other values of some attributes.

        Raises:
            InvalidValue: an invalid value.
        """
        return replace(self, **values)

    @property
    def geometry(self) -> Any:
        """What distances and pictures are made from: itself, or a mesh that represents it."""
        return self

    def solids(self) -> list[Solid]:
        """Return its solids, or the pieces of its surface."""
        return [self.geometry.solid()]

    def pose(self, near: Array) -> pin.SE3:
        """Return its pose, world frame: its middle, and the rotation from its axes.

        The third axis is that of shapes with only one. The middle of a half-space is its point nearest to
        `near`, (3,) [m].
        """
        shape: Any = self
        return pin.SE3(np.array(getattr(self, "rotation", UNTURNED)), np.array(shape.center))


@declared()
class Sphere(Described):
    """A ball.

    Attributes:
        center: its centre, (3,) [m].
        radius: its radius [m].
    """

    type: ClassVar[str] = "sphere"
    handles: ClassVar[tuple[str, ...]] = ("radius",)
    symmetry: ClassVar[Symmetry] = "ball"
    center: Point
    radius: Size

    def solid(self) -> Solid:
        """Return it as a solid."""
        center = np.array(self.center)
        half = np.full(3, self.radius)
        geometry = coal.Sphere(self.radius)
        return Solid(
            geometry, np.eye(3), center, center, center, self.radius, center, half, SOLID.segment, True
        )


@declared()
class Rounded(Described):
    """Base class of capsules and cylinders: a line from start to end, and a radius."""

    handles: ClassVar[tuple[str, ...]] = ("start", "end", "radius")
    symmetry: ClassVar[Symmetry] = "axis"
    primitive: ClassVar[int]
    advice: ClassVar[str]
    start: Point
    end: Point
    radius: Size

    def __post_init__(self) -> None:
        if np.linalg.norm(np.subtract(self.end, self.start)) < SMALLEST_LENGTH:
            raise InvalidValue("end", self.end, f"another point than start; {self.advice}")

    @property
    def cap(self) -> float:
        """How far it extends beyond start and end [m]."""
        return self.radius if self.primitive == SOLID.segment else 0.0

    def solid(self) -> Solid:
        """Return it as a solid."""
        start = np.array(self.start)
        end = np.array(self.end)
        long = float(np.linalg.norm(end - start))
        half = np.array([self.radius, self.radius, long / 2.0 + self.cap])
        center = (start + end) / 2.0
        geometry = (coal.Capsule if self.primitive == SOLID.segment else coal.Cylinder)(self.radius, long)
        turn = z_along(end - start)
        return Solid(geometry, turn, center, start, end, self.radius, center, half, self.primitive, True)

    def pose(self, near: Array) -> pin.SE3:
        """Return its pose; the third axis leads from start to end."""
        start = np.array(self.start)
        end = np.array(self.end)
        return pin.SE3(rotation_to(end - start), 0.5 * (start + end))


@declared()
class Capsule(Rounded):
    """All points within a radius of a line: a cylinder with round ends.

    Attributes:
        start: one end of the line, (3,) [m].
        end: its other end, (3,) [m].
        radius: the radius [m].
    """

    type: ClassVar[str] = "capsule"
    primitive: ClassVar[int] = SOLID.segment
    advice: ClassVar[str] = "a capsule without length is a Sphere"


@declared()
class Cylinder(Rounded):
    """A cylinder with flat ends.

    Attributes:
        start: centre of one end, (3,) [m].
        end: centre of the other, (3,) [m].
        radius: its radius [m].
    """

    type: ClassVar[str] = "cylinder"
    primitive: ClassVar[int] = SOLID.cylinder
    advice: ClassVar[str] = "a cylinder has a length"


def _edge_lengths(name: str, value: Any) -> Vector:
    size = point(name, value)
    for axis, edge in enumerate(size):
        length(f"{name}[{axis}]", edge)
    return size


@declared()
class Box(Described):
    """A box.

    Attributes:
        center: its centre, (3,) [m].
        size: edge lengths along its own axes, (3,) [m].
        rotation: from its axes to the world axes, (3, 3); given as a matrix or as roll, pitch, yaw [rad];
            None: the identity.
    """

    type: ClassVar[str] = "box"
    handles: ClassVar[tuple[str, ...]] = ("x", "y", "z")
    center: Point
    size: Annotated[Vector, CheckedBy(_edge_lengths, "length")]
    rotation: Turn = UNTURNED

    def solid(self) -> Solid:
        """Return it as a solid."""
        turn = np.array(self.rotation)
        center = np.array(self.center)
        half = np.array(self.size) / 2.0
        corners = np.array(np.meshgrid(*np.stack([-half, half], axis=1))).reshape(3, 8).T
        start, end, radius = capsule_around(corners @ turn.T + center)
        return Solid(coal.Box(*self.size), turn, center, start, end, radius, center, half, SOLID.box, True)


@declared()
class HalfSpace(Described):
    """Everything on one side of a plane: a floor, a wall, a ceiling.

    Attributes:
        point: a point of the plane, (3,) [m].
        normal: unit vector to the free side, (3,); normalised if necessary.
    """

    type: ClassVar[str] = "half_space"
    handles: ClassVar[tuple[str, ...]] = ("height",)
    symmetry: ClassVar[Symmetry] = "axis"
    bounded: ClassVar[bool] = False
    point: Point
    normal: Annotated[Vector, CheckedBy(direction)]

    def solid(self) -> Solid:
        """Return it as a solid."""
        point = np.array(self.point)
        turn = z_along(np.array(self.normal))
        geometry = coal.Halfspace(np.array([0.0, 0.0, 1.0]), 0.0)  # the points with z <= 0
        whole = np.full(3, np.inf)
        return Solid(geometry, turn, point, point, point, np.inf, point, whole, SOLID.plane, True)

    def pose(self, near: Array) -> pin.SE3:
        """Return the point of the plane that is nearest to another; the third axis is the normal."""
        normal = np.array(self.normal)
        return pin.SE3(rotation_to(normal), near - (normal @ (near - self.point)) * normal)


class Surface(Described):
    """Points, or triangles between them, with a placement; only these are compared.

    Attributes:
        center: position of the origin of their frame in the world, (3,) [m].
        rotation: from the axes of that frame to the world axes, (3, 3).
        path: the file they were loaded from, if any.
        scale: scale factor applied to the coordinates in that file.
        own: the key of its points in a description.
    """

    own: ClassVar[str]
    center: Vector
    rotation: Matrix
    path: Path | None
    scale: float

    @property
    def content(self) -> tuple[Array, NDArray[np.int32] | None]:
        """The points, (n, 3) [m], in their own frame, and the triangles, (k, 3), or None."""
        raise NotImplementedError

    @property
    def corners(self) -> Array:
        """The points, (n, 1, 3), or the triangle corners, (k, 3, 3) [m], in their own frame."""
        points, faces = self.content
        return points[:, None] if faces is None else np.asarray(points[faces])

    @cached_property
    def tree(self) -> Tree:
        """The tree of the points or triangles, built on first use."""
        return Tree(self.corners)

    def solids(self) -> list[Solid]:
        """Return the pieces of the surface."""
        return [self._piece(node, SOLID.piece) for node in self.tree.pieces]

    def _piece(self, node: int, kind: int) -> Solid:
        turn = np.array(self.rotation)
        position = np.array(self.center)
        low, high = self.tree.boxes[node]
        radius: float = getattr(self, "point_radius", 0.0)
        middle = position + turn @ (0.5 * (low + high))
        half = 0.5 * (high - low) + radius
        return Solid((self.tree, node), turn, position, middle, middle, radius, middle, half, kind, True)

    @cached_property
    def bounds(self) -> Array:
        """Minimum and maximum coordinates in their own frame, (2, 3) [m]."""
        points, _ = self.content
        return np.stack([points.min(axis=0), points.max(axis=0)])

    def changed(self: Own, **values: Any) -> Own:
        """Return a copy with other values of some attributes, and cached data if only it moves."""
        if values.keys() <= {"center", "rotation"}:
            pose = {"center": self.center, "rotation": self.rotation, **values}
            return self.placed(pose["center"], pose["rotation"])
        return replace(self, **values)

    def pose(self, near: Array) -> pin.SE3:
        """Return its pose; its middle is that of its bounds in its own frame."""
        turn = np.array(self.rotation)
        return pin.SE3(turn, self.center + turn @ self.bounds.mean(axis=0))

    @cached_property
    def _digest(self) -> int:
        points, faces = self.content
        return zlib.crc32(points.data) if faces is None else zlib.crc32(faces.data, zlib.crc32(points.data))

    @classmethod
    def from_table(cls, values: Mapping[str, Any], source: InputFile) -> Any:
        """Return the values of fields, with the points themselves; or one that is loaded from a file."""
        options = super().from_table(values, source)
        key = cls.own
        if ("path" in options) == (key in options):
            both = "both" if "path" in options else None
            raise InvalidValue(f"path or {key}", both, "one of the two: a file, or points (n, 3) [m]")
        if "path" not in options:
            if "scale" in options:
                raise InvalidValue("scale", options["scale"], f"nothing: {key} are in metres")
            return options
        path = options.pop("path")
        require_instance("path", path, str, "the name of a file")
        if "faces" in options:
            raise InvalidValue("faces", options["faces"], "nothing: they are read from the file")
        with refusing(values, "path"):
            return cast(Any, cls).load(source.resolve(path), **options)

    def written(self, file: OutputFile) -> dict[str, Any]:
        """Return the values of fields that differ from their defaults: a file, or points and triangles."""
        table = super().written(file)
        if self.path is None or file.embeds:
            left = {"path", "scale", "outlier_distance", "faces" if self.convex else ""}
        else:
            left = {self.own, "faces"}
            table["path"] = self.path.absolute()
        return {key: value for key, value in table.items() if key not in left}

    def placed(self: Own, center: ArrayLike, turn: Any = None) -> Own:
        """Return a copy with another placement; cached data is kept.

        Args:
            center: position of the origin, (3,) [m].
            turn: the rotation: a matrix (3, 3), or roll, pitch, yaw [rad]; None: the identity.

        Raises:
            InvalidValue: an invalid position or rotation.
        """
        other = object.__new__(type(self))
        other.__dict__.update(self.__dict__)  # includes cached properties
        set_fields(other, center=point("center", center), rotation=rotation("rotation", turn))
        return other

    def __eq__(self, other: object) -> bool:
        if self is other:
            return True
        if type(self) is not type(other) or not isinstance(other, Surface):
            return NotImplemented
        if self._key() != other._key():
            return False
        points, faces = self.content
        others, theirs = other.content
        if faces is None or theirs is None:
            return faces is theirs and np.array_equal(points, others)
        return np.array_equal(points, others) and np.array_equal(faces, theirs)

    def __hash__(self) -> int:
        return hash(self._key())

    def _key(self) -> tuple[Any, ...]:
        return self._digest, self.center, self.rotation

    def __getstate__(self) -> dict[str, Any]:
        return {item.name: self.__dict__[item.name] for item in fields(self)}

    def __setstate__(self, state: dict[str, Any]) -> None:
        make_read_only(*state.values())
        self.__dict__.update(state)


def check_faces(values: ArrayLike, count: int) -> NDArray[np.int32]:
    """Return a new array of triangles, (k, 3), as indices of `count` points.

    Raises:
        InvalidValue: not triangles, or an index out of range.
    """
    try:
        faces = np.array(values)
    except (TypeError, ValueError):
        faces = np.zeros(0)
    if faces.ndim != 2 or faces.shape[1] != 3 or faces.dtype.kind not in "iu" or not faces.size:
        raise InvalidValue("faces", values, "triangles, (k, 3), as integer point indices")
    if faces.min() < 0 or faces.max() >= count:
        wrong = int(faces.min() if faces.min() < 0 else faces.max())
        raise InvalidValue("faces", wrong, f"point indices, 0 to {count - 1}")
    return faces.astype(np.int32)


def _finite_points(name: str, values: ArrayLike) -> Array:
    allowed = "points (n, 3) [m] that span a volume"
    points = as_floats(name, values, allowed)
    if points.ndim != 2 or points.shape[1:] != (3,) or not np.all(np.isfinite(points)):
        raise InvalidValue(name, values, allowed)
    if points.size and np.abs(points).max() > LARGEST_LENGTH:
        raise InvalidValue(f"{name} (largest)", float(np.abs(points).max()), f"at most {LARGEST_LENGTH:g} m")
    return points


@declared(eq=False)
class Mesh(Surface):
    """A mesh, including its cavities, or the convex hull of points.

    A closed mesh is solid: its inside counts as occupied. Other meshes are surfaces without an inside.

    Attributes:
        vertices: the vertices, (n, 3) [m], in the frame of the mesh, distinct and sorted; read-only. Without
            `faces`, any points may be given; those inside their hull are dropped.
        center: position of the origin of the mesh in the world, (3,) [m].
        rotation: from the axes of the mesh to the world axes, (3, 3); given as a matrix or as roll, pitch,
            yaw [rad]; None: the identity.
        faces: triangles as vertex indices, (t, 3); read-only. By default those of the hull,
            counterclockwise from outside.
        path: the file it was loaded from, if any.
        scale: scale factor applied to the coordinates in that file.
        convex: whether the mesh is its convex hull.
    """

    type: ClassVar[str] = "mesh"
    own: ClassVar[str] = "vertices"
    vertices: Annotated[Array, CheckedBy(_finite_points)] = field(repr=False)
    center: Point = (0.0, 0.0, 0.0)
    rotation: Turn = UNTURNED
    faces: Annotated[NDArray[np.int32], AS_GIVEN] = field(
        default_factory=lambda: np.zeros((0, 3), dtype=np.int32), repr=False
    )
    path: Path | None = None
    scale: Number = 1.0
    convex: bool = field(init=False, default=True)  # type: ignore[misc]

    def __post_init__(self) -> None:
        vertices = self.vertices
        hull = np.size(self.faces) == 0
        if not hull:
            vertices, faces = merge_corners(
                Triangles(vertices, check_faces(self.faces, len(vertices)).astype(np.intp))
            )
            hull = _is_convex(vertices, faces)
        if hull:
            vertices = _hull_vertices(vertices)
            faces = _hull_faces(vertices)
        faces = faces.astype(np.int32)
        make_read_only(vertices, faces)
        set_fields(self, vertices=vertices, faces=faces, convex=hull)

    @classmethod
    def load(
        cls, path: str | Path, scale: float = 1.0, center: ArrayLike = (0, 0, 0), rotation: Any = None
    ) -> Mesh:
        """Read a mesh from a file (.stl, .obj, .ply, .dae).

        Args:
            path: the file.
            scale: scale factor for its coordinates, such as 0.001 for a file in millimetres.
            center: as in `Mesh`.
            rotation: as in `Mesh`.

        Raises:
            FileError: missing, in another format, or without triangles.
            InvalidValue: an invalid argument.
        """
        factor = scale_factor(path, scale)
        vertices, faces = read_mesh(Path(path))
        mesh = cls(vertices * factor, faces=faces.astype(np.int32), path=Path(path), scale=factor)
        warn_of_width(Path(path).name, mesh.vertices)
        return mesh.placed(center, rotation)

    @classmethod
    def check_keys(cls, values: Mapping[str, Any] = MappingProxyType({})) -> tuple[str, ...]:
        """Return the names that a description of it may have."""
        return "type", "path", "scale", "center", "rotation", "vertices", "faces"

    @property
    def content(self) -> tuple[Array, NDArray[np.int32]]:
        """The vertices, (n, 3) [m], in their own frame, and the triangles, (t, 3)."""
        return self.vertices, self.faces

    @cached_property
    def closed(self) -> bool:
        """Whether the mesh encloses a volume."""
        return is_closed(self.faces)

    def solids(self) -> list[Solid]:
        """Return the hull of a convex mesh; otherwise the pieces of the surface, and what it encloses."""
        if self.convex:
            return [self.solid()]
        return super().solids() + ([self._piece(1, SOLID.inside)] if self.closed else [])

    def solid(self) -> Solid:
        """Return the hull of the mesh as a solid."""
        turn = np.array(self.rotation)
        center = np.array(self.center)
        low, high = self.bounds
        half = (high - low) / 2.0
        middle = center + turn @ ((high + low) / 2.0)
        points = coal.StdVec_Vec3s()
        for vertex in self.vertices:
            points.append(vertex)
        faces = coal.StdVec_Triangle()
        for face in self.faces:
            faces.append(coal.Triangle(*map(int, face)))
        start, end, radius = capsule_around(self.vertices @ turn.T + center)
        geometry = coal.Convex(points, faces)
        return Solid(geometry, turn, center, start, end, radius, middle, half, SOLID.box, False)


class MeshShape(Described):
    """Base class of obstacles whose surface is a mesh that a few numbers describe.

    A subclass is declared with the fields `center`, numbers of its own, and `rotation`, and has a method
    `build`. Numbers are a `Size` [m], or of another kind whose unit the field names, as in
    `bend: Number = field(metadata={"unit": "deg"})`.

    Attributes:
        center: position of the origin of its frame in the world, (3,) [m].
        rotation: from the axes of that frame to the world axes, (3, 3).
    """

    center: Vector
    rotation: Matrix

    def __post_init__(self) -> None:
        declaring = next(kind for kind in type(self).__mro__ if "__dataclass_fields__" in vars(kind))
        if "__pydantic_validator__" not in vars(declaring):
            raise TypeError(
                f"{declaring.__name__} is a plain dataclass; needed: @declared() of pinposture.schema"
            )

    def build(self) -> Mesh:
        """Return its mesh in its own frame, without a placement; only a closed mesh has an inside."""
        raise InvalidValue(f"{type(self).__name__}.build", "not defined", "a method that returns a Mesh")

    @cached_property
    def geometry(self) -> Mesh:
        """Its mesh in the world frame; those of equal shapes share one tree."""
        shape: Any = self
        return _built(replace(shape, center=(0.0, 0.0, 0.0), rotation=UNTURNED)).placed(
            self.center, self.rotation
        )


@lru_cache(maxsize=256)
def _built(shape: MeshShape) -> Mesh:
    what = f"{type(shape).__name__}.build()"
    try:
        mesh = shape.build()
    except InvalidValue as error:  # such as a mesh that is none
        if error.name.startswith(what.removesuffix("()")):
            raise
        raise InvalidValue(f"{what}, {error.name}", error.value, error.allowed) from error
    require_instance(what, mesh, Mesh, "a Mesh")
    if any(mesh.center) or mesh.rotation != UNTURNED:
        allowed = "(0, 0, 0), without a rotation: the obstacle itself is placed"
        raise InvalidValue(f"{what}, center", mesh.center, allowed)
    if not mesh.convex:
        _ = mesh.tree  # built once: placed copies keep it
    return mesh


def rotation_to(axis: ArrayLike) -> Array:
    """Return the smallest rotation that turns the third axis to another, (3, 3)."""
    x, y, z = np.asarray(axis, dtype=np.float64) / np.linalg.norm(np.asarray(axis, dtype=np.float64))
    if z < -1.0 + 1e-12:
        return np.diag([1.0, -1.0, -1.0])
    share = 1.0 / (1.0 + z)
    return np.array(
        [[1.0 - share * x * x, -share * x * y, x], [-share * x * y, 1.0 - share * y * y, y], [-x, -y, z]]
    )


def number_fields(kind: Any) -> list[Field[Any]]:
    """Return the fields of a type of shape that are numbers."""
    hints = get_type_hints(kind)
    return [item for item in fields(kind) if hints[item.name] is float]


def warn_of_width(name: str, points: Array) -> None:
    """Warn of a surface that is so wide that it is probably in millimetres; points (n, 3) [m]."""
    width = float(np.ptp(points, axis=0).max())
    if width > MAX_PLAUSIBLE_WIDTH:
        warn_caller(f"{name} is {width:.4g} m wide; if it is in millimetres, load it with scale=0.001")


def _hull_vertices(points: Array) -> Array:
    """Return the sorted vertices of the convex hull of points."""
    allowed = "points (n, 3) [m] that span a volume"
    points = np.unique(points, axis=0)
    count = 0
    # Qhull may drop vertices that almost lie in a face: repeat until it keeps all.
    while len(points) != count:
        count = len(points)
        try:
            hull = ConvexHull(points)
        except (QhullError, ValueError):
            raise InvalidValue("vertices", f"{count} points", f"{allowed}; these are flat") from None
        points = points[np.sort(hull.vertices)]
    if hull.volume < SMALLEST_LENGTH**3:
        raise InvalidValue("vertices (volume)", float(hull.volume), allowed)
    return np.asarray(points)


def _hull_faces(corners: Array) -> NDArray[np.intp]:
    """Return the triangles of a hull from its vertices, counterclockwise from outside, (t, 3)."""
    hull = ConvexHull(corners)
    faces = np.array(hull.simplices, dtype=np.intp)
    a, b, c = (hull.points[faces[:, k]] for k in range(3))
    inward = np.einsum("ti,ti->t", np.cross(b - a, c - a), hull.equations[:, :3]) < 0.0
    faces[inward] = faces[inward][:, ::-1]
    return faces


def _is_convex(vertices: Array, faces: NDArray[np.intp]) -> bool:
    """Return whether a mesh is closed, oriented consistently, and fills its hull."""
    if not is_closed(faces) or not is_oriented(faces):
        return False
    try:
        whole = float(ConvexHull(vertices).volume)
    except (QhullError, ValueError):
        return False
    a, b, c = (vertices[faces[:, k]] - vertices[0] for k in range(3))
    volume = abs(float(np.einsum("ti,ti->", np.cross(a, b), c))) / 6.0
    return whole >= SMALLEST_LENGTH**3 and abs(volume - whole) <= 1e-7 * whole
