"""A scanned workspace: a cloud of points or a surface, to be shown and to tell distances from."""

from __future__ import annotations

import warnings
from dataclasses import dataclass, field
from functools import cached_property
from numbers import Real
from os import PathLike
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from pinposture.errors import FileError, InvalidValue, PostureWarning
from pinposture.scene.checks import LARGEST, SMALLEST, is_count
from pinposture.scene.scan_arrays import checked_colors, checked_faces, checked_points
from pinposture.scene.scan_files import read_scan
from pinposture.scene.scan_thinning import between_cubes, representatives
from pinposture.scene.scan_tree import ScanTree

if TYPE_CHECKING:
    from pinposture.arm import Arm
    from pinposture.scene.scan_clearance import ScanClearance

Array = NDArray[np.float64]

WIDE = 30.0
"""A scan that is wider than this is warned of [m]: its unit is probably another."""


@dataclass(frozen=True, eq=False)
class Scan:
    """A surface or a cloud of points that a scanner saw, world frame.

    A scan is shown, and the distance of an arm from it is told (`around`). It is no obstacle: controllers do
    not keep clear of it. What they are to keep clear of belongs into a `Scene`.

    Points that are not finite, which scanners write where they saw nothing, are left out and counted, and so
    are the triangles that have them for corners.

        scan = pp.scene.Scan.load("workshop.ply")
        gap = scan.around(arm).minimum(q)

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
        if farthest > LARGEST:
            allowed = f"at most {LARGEST:g} m; scale 0.001 makes metres of millimetres"
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

        Clouds of points: .ply, .pcd (ascii, binary), .xyz, .txt and .csv (columns named x, y and z, else the
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
        if not isinstance(scale, Real) or isinstance(scale, bool) or not SMALLEST <= scale <= LARGEST:
            raise InvalidValue("scale", scale, f"a factor of {SMALLEST:g} to {LARGEST:g}")
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

    def around(self, arm: Arm, arm_radius: float | None = None) -> ScanClearance:
        """What tells the distance of an arm from this scan; takes a moment to prepare, so keep it.

        Args:
            arm: the arm.
            arm_radius: radius of capsules that stand in for whatever its description says [m], as in `Scene`;
                if None, that.

        Raises:
            InvalidValue: not an arm, or one of too many degrees of freedom; not a radius.
        """
        from pinposture.scene.scan_clearance import ScanClearance  # which knows what a scan is

        return ScanClearance(self, arm, arm_radius)

    @cached_property
    def tree(self) -> ScanTree:
        """The points or triangles by where they are; made when first asked for."""
        return ScanTree(self.points[:, None] if self.faces is None else self.points[self.faces])

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
