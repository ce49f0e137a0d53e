"""An obstacle with flat faces: the convex hull of points."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from numbers import Real
from os import PathLike
from pathlib import Path
from typing import Any, ClassVar

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.spatial import ConvexHull, QhullError

from pinposture.errors import InvalidValue
from pinposture.scene.checks import LARGEST, SMALLEST, Matrix, Vector, known_keys, point, rotation
from pinposture.scene.mesh_files import read_mesh

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Mesh:
    """The convex hull of points, or of the mesh in a file: hollows are filled.

    A hollow thing, such as a ring, is a scene of several convex meshes.

    Attributes:
        vertices: the corners of the hull, (n, 3) [m], in the frame of the mesh, sorted. Any points may be
            given; those inside the hull are dropped.
        center: where the origin of the mesh stands in the world, (3,) [m].
        rotation: from the axes of the mesh to the world's, (3, 3); given as such, or as roll, pitch, yaw
            [rad]; no turn if None.
    """

    type: ClassVar[str] = "mesh"
    vertices: tuple[Vector, ...] = field(repr=False)
    center: Vector = (0.0, 0.0, 0.0)
    rotation: Matrix = None  # type: ignore[assignment]  # never None once it is made

    def __post_init__(self) -> None:
        object.__setattr__(self, "vertices", _corners(self.vertices))
        object.__setattr__(self, "center", point("center", self.center))
        object.__setattr__(self, "rotation", rotation("rotation", self.rotation))

    @classmethod
    def load(
        cls, path: str | Path, scale: float = 1.0, center: ArrayLike = (0, 0, 0), rotation: Any = None
    ) -> Mesh:
        """The convex hull of the mesh in a file (.stl, .obj, .ply, .dae).

        Args:
            path: the file.
            scale: factor of its coordinates, such as 0.001 for a file in millimetres.
            center: where its origin stands in the world, (3,) [m].
            rotation: how it is turned there, as in `Mesh`.

        Raises:
            FileError: missing, of another format, or without triangles.
            InvalidValue: a value as described in `Mesh`, or a mesh without volume.
        """
        if not isinstance(path, (str, PathLike)):
            raise InvalidValue("path", path, "the name of a file")
        if not isinstance(scale, Real) or isinstance(scale, bool) or not SMALLEST <= scale <= LARGEST:
            raise InvalidValue("scale", scale, f"a factor of {SMALLEST:g} to {LARGEST:g}")
        vertices, _ = read_mesh(Path(path))
        return cls(vertices * float(scale), center, rotation)

    @classmethod
    def from_dict(cls, described: Mapping[str, Any], folder: str = ".") -> Mesh:
        """The mesh that `to_dict` described, or one in a file; see `obstacle_from_dict`."""
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

    def to_dict(self) -> dict[str, Any]:
        """The mesh as data that JSON can hold."""
        return {
            "type": self.type,
            "vertices": np.array(self.vertices).tolist(),
            "center": list(self.center),
            "rotation": np.array(self.rotation).tolist(),
        }

    def faces(self) -> NDArray[np.intp]:
        """Triangles of the hull as indices of its vertices, seen counterclockwise from outside, (t, 3)."""
        return _outward(ConvexHull(np.array(self.vertices)))


def _corners(vertices: Any) -> tuple[Vector, ...]:
    allowed = "points (n, 3) [m] that span a volume"
    try:
        points = np.array(vertices, dtype=np.float64)
    except (TypeError, ValueError):
        raise InvalidValue("vertices", vertices, allowed) from None
    if points.ndim != 2 or points.shape[1:] != (3,) or not np.all(np.isfinite(points)):
        raise InvalidValue("vertices", vertices, allowed)
    if points.size and np.abs(points).max() > LARGEST:
        raise InvalidValue("vertices (largest)", float(np.abs(points).max()), f"at most {LARGEST:g} m")
    points, count = np.unique(points, axis=0), 0
    # Corners that lie almost in a face may be dropped one by one; the hull is final when none is.
    while len(points) != count:
        count = len(points)
        try:
            hull = ConvexHull(points)
        except (QhullError, ValueError):
            raise InvalidValue("vertices", f"{count} points", f"{allowed}; these are flat") from None
        points = points[np.sort(hull.vertices)]
    if hull.volume < SMALLEST**3:
        raise InvalidValue("vertices (volume)", float(hull.volume), allowed)
    return tuple((float(x), float(y), float(z)) for x, y, z in points)


def _outward(hull: ConvexHull) -> NDArray[np.intp]:
    """The triangles of a hull, turned so that their normals point outwards."""
    faces = np.array(hull.simplices, dtype=np.intp)
    a, b, c = (hull.points[faces[:, k]] for k in range(3))
    inward = np.einsum("ti,ti->t", np.cross(b - a, c - a), hull.equations[:, :3]) < 0.0
    faces[inward] = faces[inward][:, ::-1]
    return faces
