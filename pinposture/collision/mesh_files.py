"""Mesh files: where they are, and the triangles that they hold."""

from __future__ import annotations

import os
from collections.abc import Iterable, Iterator, Sequence
from importlib.util import find_spec
from os import PathLike
from pathlib import Path
from typing import Any, NamedTuple
from urllib.parse import unquote, urlsplit

import numpy as np
from numpy.typing import NDArray

from pinposture._validation import LARGEST_LENGTH, SMALLEST_LENGTH, is_number
from pinposture.arm.urdf_reader import parse_xml
from pinposture.errors import FileError, InvalidValue, PostureError
from pinposture.storage import read_text

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


def merge_corners(mesh: Triangles) -> Triangles:
    """Return a surface with each corner that triangles have once; some formats repeat them."""
    used = mesh.faces.reshape(-1)
    points = mesh.vertices[used]
    order = np.lexsort(points.T)
    ordered = points[order]
    new = np.ones(len(order), dtype=np.bool_)
    new[1:] = (ordered[1:] != ordered[:-1]).any(axis=1)
    faces = np.empty(len(order), dtype=np.intp)
    faces[order] = np.cumsum(new) - 1
    return Triangles(ordered[new], faces.reshape(-1, 3))
