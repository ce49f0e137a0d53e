"""A scanned workspace: a point cloud or a surface."""

from __future__ import annotations

import warnings
from dataclasses import dataclass, field
from functools import cached_property
from numbers import Real
from os import PathLike
from pathlib import Path
from typing import Any, NamedTuple

import coal
import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.spatial import cKDTree

from pinposture._validation import LARGEST_LENGTH, SMALLEST_LENGTH, is_count
from pinposture.collision.scan_files import read_scan
from pinposture.errors import FileError, InvalidValue, PostureWarning

# Checks of the arrays that a scan is made of.

Array = NDArray[np.float64]

MOST = 5_000_000
"""The most points, and the most triangles, of a scan."""


def checked_points(values: ArrayLike) -> Array:
    """A fresh array of points, (n, 3), finite or not.

    Raises:
        InvalidValue: not numbers, another shape, or too many.
    """
    try:
        points = np.array(values, dtype=np.float64)
    except (TypeError, ValueError):
        raise InvalidValue("points", values, "points, (n, 3) [m]") from None
    if points.ndim != 2 or points.shape[1] != 3:
        raise InvalidValue("points (shape)", points.shape, "(n, 3)")
    if len(points) > MOST:
        raise InvalidValue("points (number)", len(points), f"at most {MOST}")
    return points


def checked_faces(values: ArrayLike, count: int) -> NDArray[np.int32]:
    """A fresh array of triangles, (k, 3), whose corners are among so many points.

    Raises:
        InvalidValue: not whole numbers, another shape, too many, or corners that there are not.
    """
    try:
        faces = np.array(values)
    except (TypeError, ValueError):
        faces = np.zeros(0)
    if faces.ndim != 2 or faces.shape[1] != 3 or faces.dtype.kind not in "iu":
        raise InvalidValue("faces", values, "triangles, (k, 3), as whole numbers of points; None for a cloud")
    if len(faces) > MOST:
        raise InvalidValue("faces (number)", len(faces), f"at most {MOST}")
    if faces.size and (faces.min() < 0 or faces.max() >= count):
        wrong = int(faces.min() if faces.min() < 0 else faces.max())
        raise InvalidValue("faces", wrong, f"numbers of points, 0 to {count - 1}")
    return faces.astype(np.int32)


def checked_colors(values: ArrayLike, count: int) -> NDArray[np.uint8]:
    """A fresh array of colours of so many points, (n, 3), 0 to 255.

    Args:
        values: whole numbers from 0 to 255, or others from 0 to 1.
        count: how many points there are.

    Raises:
        InvalidValue: not numbers, another shape, or out of these ranges.
    """
    try:
        colors = np.array(values)
    except (TypeError, ValueError):
        colors = np.zeros(0)
    if colors.shape != (count, 3) or colors.dtype.kind not in "iuf":
        raise InvalidValue("colors", values, f"red, green and blue of each point, {(count, 3)}")
    most = 1.0 if colors.dtype.kind == "f" else 255
    if colors.size and not (colors.min() >= 0 and colors.max() <= most):
        raise InvalidValue("colors", values, "whole numbers from 0 to 255, or others from 0 to 1")
    return np.round(colors * (255.0 if most == 1.0 else 1.0)).astype(np.uint8)


# A few of many points that lie as the many do: one in each of many cubes.

_ENOUGH = 0.8
"""Share of the points that may be left below which smaller cubes are tried."""
_TRIES = 12
_CELLS = 2**20
"""The most cubes along an axis, so that three numbers of cubes fit into one."""


def representatives(points: Array, count: int) -> tuple[NDArray[np.intp], NDArray[np.intp]]:
    """Choose at most so many points that there is one in each cube that has any.

    Args:
        points: the points, more than `count` of them, (n, 3) [m].
        count: how many, at least 1.

    Returns:
        Indices of those that are kept, (c,), and for each of the points which of these is in its cube, (n,).
    """
    low, width = points.min(axis=0), float(np.ptp(points, axis=0).max())
    best = np.zeros(1, dtype=np.intp), np.zeros(len(points), dtype=np.intp)
    if width == 0.0 or count == 1:
        return best
    # On a surface the number of cubes goes with the square of their number along an edge.
    least, most, cells = 0.5, float(_CELLS), min(np.sqrt(count), _CELLS)
    for _ in range(_TRIES):
        found = _in_cubes(points, low, width, cells)
        if len(found[0]) > count:
            most = cells
        else:
            least = cells
            if len(found[0]) > len(best[0]):
                best = found
            if len(best[0]) >= _ENOUGH * count:
                break
        guess = cells * np.sqrt(0.9 * count / len(found[0]))
        cells = guess if least < guess < most else (least + most) / 2.0
    return best


def between_cubes(faces: NDArray[np.integer], cubes: NDArray[np.intp]) -> NDArray[np.intp]:
    """Triangles from cube to cube; those within one or two, and those that are there already, are left out.

    Args:
        faces: triangles as indices of points, (t, 3).
        cubes: which cube each point is in, (n,), as from `representatives`.
    """
    moved = cubes[faces]
    moved = moved[(moved != np.roll(moved, 1, axis=1)).all(axis=1)]
    _, first = np.unique(np.sort(moved, axis=1), axis=0, return_index=True)
    return np.asarray(moved[np.sort(first)])


def _in_cubes(
    points: Array, low: Array, width: float, cells: float
) -> tuple[NDArray[np.intp], NDArray[np.intp]]:
    """The first point in each cube of an edge `width / cells`, and for each point which of these it is."""
    at = np.minimum((points - low) * (cells / width), _CELLS).astype(np.int64)
    keys = (at[:, 0] << 42) | (at[:, 1] << 21) | at[:, 2]
    _, first, inverse = np.unique(keys, return_index=True, return_inverse=True)
    return first, inverse.reshape(-1)


# A scanned workspace: a cloud of points or a surface, to be shown and to tell distances from.

WIDE = 30.0
"""A scan that is wider than this is warned of [m]: its unit is probably another."""


class ScanGeometry(NamedTuple):
    """A scan prepared for distances.

    Attributes:
        points: the points, (n, 3) [m].
        tree: the same.
        surface: the triangles in a tree of boxes; None for a cloud of points.
    """

    points: Array
    tree: cKDTree
    surface: coal.BVHModelOBBRSS | None


@dataclass(frozen=True, eq=False)
class Scan:
    """A surface or a cloud of points that a scanner saw, world frame.

    A scan is shown, and `ScanClearance` tells the distance of an arm from it. It is no obstacle:
    controllers do not keep clear of it. What they are to keep clear of belongs into a `Scene`.

    Points that are not finite, which scanners write where they saw nothing, are left out and counted, and so
    are the triangles that have them for corners.

        scan = pp.collision.Scan.load("workshop.ply")
        gap = pp.collision.ScanClearance(arm, scan).minimum(q)

    Attributes:
        points: the points, or the corners of the triangles, (n, 3) [m]; read-only.
        faces: triangles as indices of points, (k, 3); read-only. None for a cloud of points.
        colors: red, green and blue of the points, (n, 3) uint8; read-only. None if there are none. Given as
            whole numbers from 0 to 255, or as others from 0 to 1.
        name: what to call it.
        path: the file that it was loaded from, if any.
        dropped: how many points were left out.
    """

    points: Array = field(repr=False)
    faces: NDArray[np.int32] | None = field(default=None, repr=False)
    colors: NDArray[np.uint8] | None = field(default=None, repr=False)
    name: str = "scan"
    path: Path | None = None
    dropped: int = field(init=False, default=0)

    def __post_init__(self) -> None:
        points = checked_points(self.points)
        colors = None if self.colors is None else checked_colors(self.colors, len(points))
        faces = None if self.faces is None else checked_faces(self.faces, len(points))
        if not isinstance(self.name, str) or not self.name.strip() or not self.name.isprintable():
            raise InvalidValue("name", self.name, "printable text that is not blank")
        finite = np.asarray(np.isfinite(points).all(axis=1))
        dropped = int(len(points) - finite.sum())
        if dropped:
            points = points[finite]
            colors = None if colors is None else colors[finite]
            if faces is not None:
                faces = (np.cumsum(finite) - 1)[faces[finite[faces].all(axis=1)]].astype(np.int32)
        if not len(points):
            given = "none" if not dropped else f"{dropped} points, none of them finite"
            raise InvalidValue("points", given, "at least one finite point")
        if faces is not None and not len(faces):
            raise InvalidValue("faces", "no triangle with finite corners", "at least one; None for a cloud")
        farthest = float(np.abs(points).max())
        if farthest > LARGEST_LENGTH:
            allowed = f"at most {LARGEST_LENGTH:g} m; scale 0.001 makes metres of millimetres"
            raise InvalidValue("points (largest coordinate)", farthest, allowed)
        width = float(np.ptp(points, axis=0).max())
        if width > WIDE:
            text = (
                f"{self.name} is {width:.4g} m wide; if its unit is the millimetre, load it with scale=0.001"
            )
            warnings.warn(text, PostureWarning, stacklevel=3)
        for key, value in (("points", points), ("faces", faces), ("colors", colors)):
            if value is not None:
                value.flags.writeable = False
            object.__setattr__(self, key, value)
        object.__setattr__(self, "dropped", dropped)

    @classmethod
    def load(cls, path: str | Path, scale: float = 1.0) -> Scan:
        """Read a scan from a file.

        Clouds of points: .ply, .xyz, .txt and .csv (columns named x, y and z, else the
        first three), .npy, .npz (`points`, with `faces` and `colors` if it likes). Surfaces: .ply, .stl,
        .obj, .off, .glb. Axes are left as they are in the file; in .glb files y commonly points up.

        Args:
            path: the file.
            scale: factor of its coordinates, such as 0.001 for a file in millimetres.

        Raises:
            FileError: missing, of another format, malformed, without any finite point, too large, or with
                coordinates beyond reason.
            InvalidValue: not a factor.
        """
        if not isinstance(path, (str, PathLike)):
            raise InvalidValue("path", path, "the name of a file")
        if (
            not isinstance(scale, Real)
            or isinstance(scale, bool)
            or not SMALLEST_LENGTH <= scale <= LARGEST_LENGTH
        ):
            raise InvalidValue("scale", scale, f"a factor of {SMALLEST_LENGTH:g} to {LARGEST_LENGTH:g}")
        path = Path(path)
        read = read_scan(path)
        with np.errstate(over="ignore"):
            points = read.points * float(scale)
        try:
            return cls(points, read.faces, read.colors, path.name, path)
        except InvalidValue as error:
            raise FileError(path, str(error)) from error

    def thinned(self, count: int) -> Scan:
        """The same scan with fewer points, for display.

        Space is cut into cubes, and of each cube that has points one of them is kept; triangles go from cube
        to cube, and those within one or two are left out. It is not for distances: what is left out is gone.

        Args:
            count: the most points that may be left.

        Returns:
            This scan if it has no more; else another, whose `dropped` is 0.

        Raises:
            InvalidValue: not a whole number of at least 1, or too few for a surface to have triangles left.
        """
        if not is_count(count):
            raise InvalidValue("count", count, "a whole number of at least 1")
        if len(self.points) <= count:
            return self
        kept, cubes = representatives(self.points, int(count))
        faces: NDArray[np.int32] | None = None
        if self.faces is not None:
            faces = between_cubes(self.faces, cubes).astype(np.int32)
            if not len(faces):
                raise InvalidValue(
                    "count", count, "more points; with so few no triangle of the surface is left"
                )
        colors = None if self.colors is None else self.colors[kept]
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", PostureWarning)  # of its width was warned before
            return Scan(self.points[kept], faces, colors, self.name, self.path)

    @cached_property
    def geometry(self) -> ScanGeometry:
        """The scan prepared for distances; made when first asked for."""
        surface = None
        if self.faces is not None:
            surface = coal.BVHModelOBBRSS()
            surface.beginModel(len(self.faces), len(self.points))
            surface.addVertices(self.points)
            surface.addTriangles(self.faces.astype(np.int64))
            surface.endModel()
        return ScanGeometry(self.points, cKDTree(self.points), surface)

    def __repr__(self) -> str:
        surface = "" if self.faces is None else f", {len(self.faces)} triangles"
        dropped = f", {self.dropped} dropped" if self.dropped else ""
        return f"Scan({self.name!r}, {len(self.points)} points{surface}{dropped})"

    def __reduce__(self) -> tuple[Any, ...]:
        parts = self.points, self.faces, self.colors, self.name, self.path, self.dropped
        return _restored, parts


def _restored(points: Array, faces: Any, colors: Any, name: str, path: Path | None, dropped: int) -> Scan:
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", PostureWarning)
        scan = Scan(points, faces, colors, name, path)
    object.__setattr__(scan, "dropped", dropped)
    return scan
