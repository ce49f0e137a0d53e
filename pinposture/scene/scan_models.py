"""Scans in the files of meshes, read by trimesh: surfaces, and clouds of points in those that hold them."""

from __future__ import annotations

from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from pinposture.errors import FileError

Array = NDArray[np.float64]

_GREY = 180
"""The colour of parts that have none in a file in which others have."""
_LONGEST = 100_000
"""Bytes within which the header of a PLY file has to be over."""


class Part(NamedTuple):
    """One of the things in a file, or all of them.

    Attributes:
        points: (n, 3), in the unit of the file, finite or not.
        faces: triangles as indices of points, (k, 3); None for a cloud.
        colors: of the points, (n, 3); None if there are none.
    """

    points: Array
    faces: NDArray[np.int64] | None
    colors: NDArray[np.uint8] | None


def read_model(path: Path) -> Part:
    """Points, triangles and colours of all that is in a file.

    Raises:
        FileError: malformed, with nothing in it, or with both triangles and loose points.
    """
    if path.suffix.lower() == ".ply":
        _check_ply(path)
    try:
        import trimesh  # here, because most arms need no files

        parts = trimesh.load_scene(path, process=False).dump()  # each where the file has it
        surfaces = [_surface(part) for part in parts if isinstance(part, trimesh.Trimesh) and len(part.faces)]
        clouds = [_cloud(part) for part in parts if isinstance(part, trimesh.PointCloud)]
        # Triangles may be none, and what is left are their corners.
        clouds += [
            _cloud(part) for part in parts if isinstance(part, trimesh.Trimesh) and not len(part.faces)
        ]
    except Exception as error:  # a broken file makes a reader fail in any way
        raise FileError(path, f"cannot be read: {str(error) or type(error).__name__}") from error
    clouds = [part for part in clouds if len(part.points)]
    if surfaces and clouds:
        raise FileError(path, "holds both triangles and loose points; allowed: one of them")
    if not surfaces and not clouds:
        raise FileError(path, "holds neither triangles nor points, or is cut off")
    for points, faces, _ in surfaces:
        if faces is not None and not 0 <= faces.min() <= faces.max() < len(points):
            raise FileError(path, "has triangles with corners that it does not hold")
    return _shared(_joined(surfaces)) if surfaces else _joined(clouds)


def _surface(part: Any) -> Part:
    faces = np.array(part.faces, dtype=np.int64)
    return Part(np.array(part.vertices, dtype=np.float64), faces, _colors(part))


def _cloud(part: Any) -> Part:
    points = np.array(part.vertices, dtype=np.float64).reshape(-1, 3)
    colors = np.array(getattr(part, "colors", ()))  # a surface without triangles has none
    return Part(points, None, colors[:, :3].astype(np.uint8) if colors.shape == (len(points), 4) else None)


def _colors(part: Any) -> NDArray[np.uint8] | None:
    """Colours of the corners of a surface, also where the file has them by triangle or as a picture."""
    visual = part.visual
    try:
        if visual.kind == "texture":
            visual = visual.to_color()
        colors = np.array(visual.vertex_colors) if visual.kind in ("vertex", "face") else np.zeros(0)
    except Exception:  # a picture that is not there: the surface is of use without it
        return None
    return colors[:, :3].astype(np.uint8) if colors.shape == (len(part.vertices), 4) else None


def _joined(parts: list[Part]) -> Part:
    """All parts as one; grey where only others have colours."""
    points = np.concatenate([part.points for part in parts])
    starts = np.cumsum([0, *(len(part.points) for part in parts)])
    faces = [part.faces + start for part, start in zip(parts, starts, strict=False) if part.faces is not None]
    colors = None
    if any(part.colors is not None for part in parts):
        grey = [np.full(part.points.shape, _GREY, dtype=np.uint8) for part in parts]
        colors = np.concatenate(
            [blank if part.colors is None else part.colors for part, blank in zip(parts, grey, strict=True)]
        )
    return Part(points, np.concatenate(faces) if faces else None, colors)


def _shared(part: Part) -> Part:
    """The same surface with each corner once, if it has no colours: STL files have one for each triangle."""
    if part.faces is None or part.colors is not None or len(part.points) < 3 * len(part.faces):
        return part
    order = np.lexsort(part.points.T)
    ordered = part.points[order]
    new = np.ones(len(order), dtype=np.bool_)
    new[1:] = (ordered[1:] != ordered[:-1]).any(axis=1)
    which = np.empty(len(order), dtype=np.int64)
    which[order] = np.cumsum(new) - 1
    return Part(ordered[new], which[part.faces], None)


def _check_ply(path: Path) -> None:
    """Refuse an ascii file with another number of lines than it says: trimesh would take faces for points."""
    with path.open("rb") as file:
        header: list[list[bytes]] = []
        while file.tell() < _LONGEST and header[-1:] != [[b"end_header"]]:
            line = file.readline(_LONGEST)
            if not line or (not header and line.strip() != b"ply"):
                break
            header.append(line.split())
        if header[-1:] != [[b"end_header"]]:
            raise FileError(path, "is no PLY file: it has no header from 'ply' to 'end_header'")
        if [b"format", b"ascii", b"1.0"] not in header:
            return  # of others trimesh knows how long they have to be
        told = [line[2] for line in header if line[:1] == [b"element"] and len(line) == 3]
        if not all(count.isdigit() for count in told):
            raise FileError(path, "has an element whose number is no number")
        expected, found = sum(map(int, told)), sum(1 for line in file if line.strip())
    if found != expected:
        raise FileError(path, f"says that it has {expected} lines of data, but has {found}")
