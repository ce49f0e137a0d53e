"""Scans: measured point clouds and surfaces as obstacles, and the cells of a map as one."""

from __future__ import annotations

import logging
import math
from collections.abc import Mapping
from dataclasses import field, fields, replace
from functools import cached_property, partial
from pathlib import Path
from types import MappingProxyType
from typing import Annotated, Any, ClassVar, NamedTuple

import numpy as np
import pinocchio as pin
from numpy.typing import ArrayLike, NDArray
from scipy.spatial import cKDTree

from pinposture import _validation
from pinposture._validation import (
    LARGEST_LENGTH,
    as_floats,
    length,
    make_read_only,
    point,
    require_name,
    require_whole,
    set_fields,
)
from pinposture.collision.files import read_scan, scale_factor
from pinposture.collision.shapes import UNTURNED, Point, Size, Surface, Turn, check_faces, warn_of_width
from pinposture.collision.solids import MAX_PIECES, Solid, Tree
from pinposture.errors import FileError, InvalidValue, no_warnings
from pinposture.schema import AS_GIVEN, CheckedBy, Number, OutputFile, declared

logger = logging.getLogger(__name__)

Array = NDArray[np.float64]

MAX_SCAN_SIZE = 5_000_000  # maximum number of points, and of triangles, of a scan


class ThinningSettings(NamedTuple):
    """How cubes are found that leave about as many points as asked for."""

    least_fill: float = 0.8
    """Share of the requested points below which smaller cubes are tried."""

    trials: int = 12
    """Largest number of sizes that are tried."""

    most_cubes: int = 2**20
    """Largest number of cubes along an axis, so that three indices fit into one integer."""


THINNING = ThinningSettings()


class OutlierSettings(NamedTuple):
    """Which points of a scan look like outliers."""

    neighbours: int = 8
    """Other points that a point must have around it: about its immediate neighbours on a surface, and more
    than there are flying pixels together."""

    suspect_ratio: float = 5.0
    """Distance to the eighth neighbour, over its median, above which a point looks like an outlier. Even
    samples of surfaces, 5,000 to 200,000 points, stay below 2.3, and those of a wire below 3.9. Of 200,000
    points that a scanner sees from within a room, 3 % are farther apart."""

    sample: int = 10_000
    """Number of points of which the median is taken."""


OUTLIERS = OutlierSettings()


def _points(name: str, values: ArrayLike) -> Array:
    """Return a new array of points, (n, 3), finite or not."""
    points = as_floats(name, values, "points, (n, 3) [m]")
    if points.ndim != 2 or points.shape[1] != 3:
        raise InvalidValue(f"{name} (shape)", points.shape, "(n, 3)")
    if len(points) > MAX_SCAN_SIZE:
        raise InvalidValue(f"{name} (number)", len(points), f"at most {MAX_SCAN_SIZE}")
    return points


def _colors(values: ArrayLike, count: int) -> NDArray[np.uint8]:
    """Return a new array of colours, (n, 3), 0 to 255, from integers 0 to 255 or floats 0 to 1."""
    try:
        colors = np.array(values)
    except (TypeError, ValueError):
        colors = np.zeros(0)
    if colors.shape != (count, 3) or colors.dtype.kind not in "iuf":
        raise InvalidValue("colors", values, f"red, green and blue of each point, {(count, 3)}")
    largest = 1.0 if colors.dtype.kind == "f" else 255
    if colors.size and not (colors.min() >= 0 and colors.max() <= largest):
        raise InvalidValue("colors", values, "whole numbers from 0 to 255, or others from 0 to 1")
    return np.round(colors * (255.0 if largest == 1.0 else 1.0)).astype(np.uint8)


def representatives(points: Array, count: int) -> tuple[NDArray[np.intp], NDArray[np.intp]]:
    """Choose one point per occupied cube of a grid, with the smallest cubes that `count` allows.

    Args:
        points: the points, more than `count`, (n, 3) [m].
        count: maximum number of points to choose, at least 1.

    Returns:
        Indices of the chosen points, (c,), and the cube of each point as an index of a chosen point, (n,).
    """
    low = points.min(axis=0)
    width = float(np.ptp(points, axis=0).max())
    best = np.zeros(1, dtype=np.intp), np.zeros(len(points), dtype=np.intp)
    if width == 0.0 or count == 1:
        return best
    # On a surface, the number of occupied cubes grows with the square of the number along an edge.
    least = 0.5
    most = float(THINNING.most_cubes)
    cells = min(np.sqrt(count), THINNING.most_cubes)
    for _ in range(THINNING.trials):
        occupied = _in_cubes(points, low, width, cells)
        if len(occupied[0]) > count:
            most = cells
        else:
            least = cells
            if len(occupied[0]) > len(best[0]):
                best = occupied
            if len(best[0]) >= THINNING.least_fill * count:
                break
        guess = cells * np.sqrt(0.9 * count / len(occupied[0]))
        cells = guess if least < guess < most else (least + most) / 2.0
    return best


def between_cubes(faces: NDArray[np.integer], cubes: NDArray[np.intp]) -> NDArray[np.intp]:
    """Return the distinct triangles whose corners are in three different cubes.

    Args:
        faces: triangles as point indices, (t, 3).
        cubes: index of the cube of each point, (n,), as from `representatives`.
    """
    moved = cubes[faces]
    moved = moved[(moved != np.roll(moved, 1, axis=1)).all(axis=1)]
    _, first = np.unique(np.sort(moved, axis=1), axis=0, return_index=True)
    return np.asarray(moved[np.sort(first)])


def _in_cubes(
    points: Array, low: Array, width: float, cells: float
) -> tuple[NDArray[np.intp], NDArray[np.intp]]:
    """Return the index of the first point in each cube of edge `width / cells`, and each point's cube."""
    at = np.minimum((points - low) * (cells / width), THINNING.most_cubes).astype(np.int64)
    keys = (at[:, 0] << 42) | (at[:, 1] << 21) | at[:, 2]
    _, first, inverse = np.unique(keys, return_index=True, return_inverse=True)
    return first, inverse.reshape(-1)


def find_outliers(points: Array, distance: float) -> NDArray[np.bool_]:
    """Find the points that have fewer than eight others within a distance.

    Args:
        points: the points, (n, 3) [m]; copies of a point count once.
        distance: the distance [m].

    Returns:
        Whether each point is an outlier, (n,).
    """
    distinct, inverse = np.unique(points, axis=0, return_inverse=True)
    reach = _reach(distinct, cKDTree(distinct), distance)
    return np.asarray((reach > distance)[inverse.reshape(-1)])


def suspect_distance(points: Array) -> float:
    """Return a distance within which almost all points have eight others, to two digits [m].

    It is 0 for fewer than nine points.
    """
    distinct = np.unique(points, axis=0)
    if len(distinct) <= OUTLIERS.neighbours:
        return 0.0
    chosen = distinct[:: max(1, len(distinct) // OUTLIERS.sample)]
    distance = OUTLIERS.suspect_ratio * float(np.median(_reach(chosen, cKDTree(distinct), np.inf)))
    return float(f"{distance:.2g}")


def _reach(points: Array, tree: cKDTree, most: float) -> Array:
    """Return the distance of points of a tree to the eighth neighbour, (n,) [m]; infinite beyond `most`."""
    bound = np.nextafter(most, np.inf)
    distances, _ = tree.query(points, k=[OUTLIERS.neighbours + 1], distance_upper_bound=bound)
    return np.asarray(distances[:, 0])


@declared(eq=False)
class Scan(Surface):
    """A scanned surface or point cloud as an obstacle, including its cavities.

    It has no inside: an arm keeps clear of the points, or of both sides of the triangles. A thin arm fits
    through the gaps between the points of a cloud, although the scanned object is solid there;
    `point_radius` closes these gaps.

    Non-finite points, which scanners write where they measured nothing, are dropped and counted; triangles
    with such corners are dropped.

        scan = pp.Scan.load("workshop.ply")
        scene = pp.Scene({"workshop": scan}, margin=0.01)

    Scans are equal if their points, triangles and poses are; colours, names and files do not count.

    Attributes:
        points: the points, or the corners of the triangles, (n, 3) [m]; read-only.
        faces: triangles as point indices, (k, 3); read-only. None for a point cloud.
        colors: red, green and blue of the points, (n, 3) uint8; read-only; None without colours. Given as
            integers from 0 to 255 or floats from 0 to 1.
        name: name of the scan.
        path: the file it was loaded from, if any.
        scale: scale factor applied to the coordinates in that file.
        center: position of the origin of the points in the world, (3,) [m].
        rotation: from the axes of the points to the world axes, (3, 3); given as a matrix or as roll, pitch,
            yaw [rad]; None: the identity.
        point_radius: radius of a point of a cloud [m].
        outlier_distance: distance by which outliers of the file were removed [m]; None: they were not.
        dropped: number of dropped points that were not finite.
        outliers: number of outliers that were removed.
    """

    type: ClassVar[str] = "scan"
    own: ClassVar[str] = "points"
    convex: ClassVar[bool] = False
    points: Annotated[Array, CheckedBy(_points)] = field(repr=False)
    faces: Annotated[NDArray[np.int32] | None, AS_GIVEN] = field(default=None, repr=False)
    colors: Annotated[NDArray[np.uint8] | None, AS_GIVEN] = field(default=None, repr=False)
    name: Annotated[str, CheckedBy(require_name)] = "scan"
    path: Path | None = None
    scale: Number = 1.0
    center: Point = (0.0, 0.0, 0.0)
    rotation: Turn = UNTURNED
    point_radius: Annotated[float, CheckedBy(partial(length, zero=True), "length")] = 0.0
    outlier_distance: Size | None = None
    dropped: int = field(init=False, default=0)
    outliers: int = field(init=False, default=0)

    def __post_init__(self) -> None:
        points = self.points
        colors = None if self.colors is None else _colors(self.colors, len(points))
        faces = None if self.faces is None else check_faces(self.faces, len(points))
        if faces is not None and len(faces) > MAX_SCAN_SIZE:
            raise InvalidValue("faces (number)", len(faces), f"at most {MAX_SCAN_SIZE}")
        if faces is not None and self.point_radius > 0.0:
            raise InvalidValue(
                "point_radius", self.point_radius, "0 for a surface; give the scene a larger margin"
            )
        if self.outlier_distance is not None and self.path is None:
            allowed = "None: use Scan(points).without_outliers(distance)"
            raise InvalidValue("outlier_distance", self.outlier_distance, allowed)
        finite = np.asarray(np.isfinite(points).all(axis=1))
        dropped = int(len(points) - finite.sum())
        if dropped:
            points = points[finite]
            colors = None if colors is None else colors[finite]
            if faces is not None:
                faces = (np.cumsum(finite) - 1)[faces[finite[faces].all(axis=1)]].astype(np.int32)
        if not len(points):
            text = "none" if not dropped else f"{dropped} points, none of them finite"
            raise InvalidValue("points", text, "at least one finite point")
        if faces is not None and not len(faces):
            raise InvalidValue("faces", "no triangle with finite corners", "at least one; None for a cloud")
        farthest = float(np.abs(points).max())
        if farthest > LARGEST_LENGTH:
            allowed = f"at most {LARGEST_LENGTH:g} m; scale 0.001 converts millimetres to metres"
            raise InvalidValue("points (largest coordinate)", farthest, allowed)
        warn_of_width(self.name, points)
        make_read_only(points, faces, colors)
        set_fields(self, points=points, faces=faces, colors=colors, dropped=dropped, outliers=0)

    @classmethod
    def load(
        cls,
        path: str | Path,
        scale: float = 1.0,
        center: ArrayLike = (0, 0, 0),
        rotation: Any = None,
        point_radius: float = 0.0,
        outlier_distance: float | None = None,
    ) -> Scan:
        """Read a scan from a file.

        Point clouds: .ply, .xyz, .txt and .csv (columns named x, y and z, else the first three), .npy, .npz
        (`points`, optionally with `faces` and `colors`). Surfaces: .ply, .stl, .obj, .off, .glb. Axes are
        those of the file; in .glb files y usually points up.

        Args:
            path: the file.
            scale: scale factor for its coordinates, such as 0.001 for a file in millimetres.
            center: as in `Scan`.
            rotation: as in `Scan`.
            point_radius: as in `Scan`.
            outlier_distance: removes outliers as `without_outliers` does; None: keeps them.

        Raises:
            FileError: missing, in another format, malformed, without finite points, or too large.
            InvalidValue: an invalid argument.
        """
        factor = scale_factor(path, scale)
        path = Path(path)
        pose = point("center", center), _validation.rotation("rotation", rotation)
        radius = length("point_radius", point_radius, zero=True)
        distance = None if outlier_distance is None else length("outlier_distance", outlier_distance)
        read = read_scan(path)
        with np.errstate(over="ignore"):
            points = read.points * factor
        try:
            scan = cls(points, read.faces, read.colors, path.name, path, factor, *pose, radius)
            return scan if distance is None else scan.without_outliers(distance)
        except InvalidValue as error:
            raise FileError(path, str(error)) from error

    @classmethod
    def check_keys(cls, values: Mapping[str, Any] = MappingProxyType({})) -> tuple[str, ...]:
        """Return the names that a description of it may have."""
        pose = ("center", "rotation")
        return "type", "path", "scale", *pose, "point_radius", "outlier_distance", "points", "faces"

    @property
    def content(self) -> tuple[Array, NDArray[np.int32] | None]:
        """The points, (n, 3) [m], in their own frame, and the triangles, (k, 3), or None."""
        return self.points, self.faces

    def _key(self) -> tuple[Any, ...]:
        return *super()._key(), self.point_radius

    def without_outliers(self, distance: float) -> Scan:
        """Return a point cloud without the points that have fewer than eight others within a distance.

        These are flying pixels and noise, but also what was measured so sparsely: choose a few times the
        distance between neighbouring points. `outliers` and the log have the number of points removed.

        Args:
            distance: the distance [m].

        Raises:
            InvalidValue: an invalid distance, a surface, or a distance at which no point is left.
        """
        distance = length("outlier_distance", distance)
        if self.faces is not None:
            raise InvalidValue("outlier_distance", distance, "None for a surface, whose points are connected")
        away = find_outliers(self.points, distance)
        count = int(away.sum())
        if count == len(away):
            allowed = "a larger distance: no point has eight others within this one"
            raise InvalidValue("outlier_distance", distance, allowed)
        logger.info("%s: removed %d of %d points as outliers", self.name, count, len(away))
        again = (
            self.path is not None and self.outlier_distance is None
        )  # else the file does not give these points
        with no_warnings():  # one about its width has been given
            scan = replace(
                self,
                points=self.points[~away],
                colors=None if self.colors is None else self.colors[~away],
                path=self.path if again else None,
                outlier_distance=distance if again else None,
            )
        set_fields(scan, dropped=self.dropped, outliers=self.outliers + count)
        return scan

    def thinned(self, count: int) -> Scan:
        """Return the scan with fewer points, for display.

        One point is kept per cube of a grid; triangles within one or two cubes are dropped.

        Args:
            count: maximum number of points to keep.

        Returns:
            This scan if it has at most `count` points; otherwise a new one, whose `dropped` is 0.

        Raises:
            InvalidValue: not a whole number of at least 1, or too small for a surface to keep any triangles.
        """
        require_whole("count", count, 1)
        if len(self.points) <= count:
            return self
        kept, cubes = representatives(self.points, int(count))
        faces: NDArray[np.int32] | None = None
        if self.faces is not None:
            faces = between_cubes(self.faces, cubes).astype(np.int32)
            if not len(faces):
                allowed = "more points; with so few, no triangle of the surface is left"
                raise InvalidValue("count", count, allowed)
        colors = None if self.colors is None else self.colors[kept]
        with no_warnings():  # one about its width has been given
            return replace(
                self, points=self.points[kept], faces=faces, colors=colors, path=None, outlier_distance=None
            )

    def __repr__(self) -> str:
        surface = "" if self.faces is None else f", {len(self.faces)} triangles"
        dropped = f", {self.dropped} dropped" if self.dropped else ""
        outliers = f", {self.outliers} outliers removed" if self.outliers else ""
        return f"Scan({self.name!r}, {len(self.points)} points{surface}{dropped}{outliers})"


NOWHERE = np.full((1, 3), LARGEST_LENGTH)
"""The only point of the tree of a map without cells, 17 km from the origin [m]."""


class Cells(Scan):
    """The cells of a map that an arm keeps clear of, at one moment: an obstacle, as `Map.cells` gives it.

    Each cell counts as the ball around it, and a body that is neither sphere nor capsule as the capsule
    around it. Only cells with a free face are listed. A file stores it as a scan. It may be empty; its
    distance is then over 10 km.

    Attributes:
        points: centres of the cells, (n, 3) [m]; read-only.
    """

    @classmethod
    def of(cls, centers: Array, resolution: float) -> Cells:
        """Return the cells with given centres, (n, 3) [m], and edge lengths [m]; nothing is checked."""
        cells = object.__new__(cls)
        for item in fields(Scan):
            value = None if item.name in ("faces", "colors", "path", "outlier_distance") else item.default
            set_fields(cells, **{item.name: value})
        make_read_only(centers)
        radius = 0.5 * math.sqrt(3.0) * resolution
        set_fields(cells, points=centers, name="map", point_radius=radius, rotation=UNTURNED)
        cells.prepare()
        return cells

    def prepare(self) -> None:
        """Make what distances need, so that a control loop need not."""
        _ = self._pieces
        _ = self._digest

    @cached_property
    def _pieces(self) -> list[Solid]:
        return [solid._replace(coarse=True) for solid in super().solids()]

    def solids(self) -> list[Solid]:
        """Return the pieces of its surface, of which there are always as many."""
        return self._pieces

    def placed(self, center: ArrayLike, turn: Any = None) -> Cells:
        """Return a copy with another placement; see `Surface.placed`."""
        other = super().placed(center, turn)
        other.__dict__.pop("_pieces", None)
        return other

    @cached_property
    def tree(self) -> Tree:
        """The tree of the centres, always with as many pieces; see `Scene.updated`."""
        points = self.points if len(self.points) else NOWHERE
        return Tree(np.resize(points, (max(len(points), MAX_PIECES), 3))[:, None])

    @cached_property
    def bounds(self) -> Array:
        """Minimum and maximum coordinates, (2, 3) [m]; zeros without cells."""
        return super().bounds if len(self.points) else np.zeros((2, 3))

    def pose(self, near: Array) -> pin.SE3:
        """Return its pose, that of the grid: a map that changes does not move."""
        return pin.SE3(np.array(self.rotation), np.array(self.center))

    def written(self, file: OutputFile) -> dict[str, Any]:
        """Return the values of fields that differ from their defaults."""
        table = super().written(file)
        return table if len(self.points) else table | {"points": NOWHERE.tolist()}

    def __repr__(self) -> str:
        return f"Cells({len(self.points)} cells)"
