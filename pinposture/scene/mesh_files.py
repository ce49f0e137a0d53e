"""The files that hold meshes: where a description means them to be, and the triangles in them."""

from __future__ import annotations

import os
from collections.abc import Iterable, Iterator, Sequence
from importlib.util import find_spec
from pathlib import Path
from typing import NamedTuple
from urllib.parse import unquote, urlsplit

import numpy as np
from numpy.typing import NDArray

from pinposture.arm.urdf_source import parse_xml
from pinposture.errors import FileError, PostureError
from pinposture.storage import read_text

FORMATS = (".stl", ".obj", ".dae", ".ply")
"""Endings of the files that are read."""


class Triangles(NamedTuple):
    """The surface in a file.

    Attributes:
        vertices: its corners, (n, 3) [m].
        faces: triangles as indices of corners, (t, 3).
    """

    vertices: NDArray[np.float64]
    faces: NDArray[np.intp]


def find_mesh(filename: str, package_dirs: Sequence[str] = ()) -> Path:
    """The file that a description means.

    Args:
        filename: "package://name/rest", "file:///...", or a path; relative paths start at `package_dirs`.
        package_dirs: folders to look in, those that hold packages, are packages, or lie in packages. Packages
            are looked for in the folders of the environment variable ROS_PACKAGE_PATH as well. A package has
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
    """Read a file of one of the FORMATS; COLLADA in the unit that it states, others in metres.

    Raises:
        FileError: missing, of another format, or the file does not hold triangles as it should.
    """
    if path.suffix.lower() not in FORMATS:
        raise FileError(path, f"is of an unknown format; allowed: {', '.join(FORMATS)}")
    if not _is_file(path):
        raise FileError(path, "no such file")
    if path.suffix.lower() == ".dae" and find_spec("collada") is None:
        raise FileError(path, "is COLLADA, which only the package pycollada reads; install it")
    try:
        import trimesh  # here, because most arms need no files

        scene = trimesh.load_scene(path, process=False)
        if path.suffix.lower() == ".dae" and scene.units is not None:
            scene = scene.convert_units("meters")
        surface = scene.to_mesh()
        mesh = Triangles(np.array(surface.vertices, dtype=np.float64), np.array(surface.faces, dtype=np.intp))
    except Exception as error:  # a broken file makes a reader fail in any way
        raise FileError(path, f"cannot be read: {str(error) or type(error).__name__}") from error
    if not mesh.faces.size:
        raise FileError(path, "holds no triangles")
    if mesh.faces.min() < 0 or mesh.faces.max() >= len(mesh.vertices):
        raise FileError(path, "has triangles with corners that it does not hold")
    return mesh


def _packages(name: str, folders: Sequence[Path]) -> Iterator[Path]:
    """The folders that may be a package: those that are called so, then those whose package.xml says so."""
    yield from (folder / name for folder in folders)
    for folder in folders:
        yield from (at for at in (folder, *folder.parents) if at.name == name)
    for folder in folders:
        try:
            below = sorted(at for at in folder.iterdir() if at.is_dir())
        except (OSError, ValueError):
            below = []
        yield from (at for at in (folder, *folder.parents, *below) if _named_inside(at) == name)


def _named_inside(folder: Path) -> str:
    """The name that the package.xml in a folder gives; empty if there is none, or none that can be read."""
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
    except (OSError, ValueError):  # a name that is too long, or no name at all
        return False
