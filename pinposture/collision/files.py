"""Files of meshes and scans: finding and reading them."""

from __future__ import annotations

import io
from collections.abc import Callable, Iterable, Mapping, Sequence
from importlib.util import find_spec
from os import PathLike
from pathlib import Path
from types import MappingProxyType
from typing import Any, NamedTuple
from urllib.parse import unquote

import numpy as np
from numpy.typing import NDArray

from pinposture._validation import LARGEST_LENGTH, SMALLEST_LENGTH, is_number, require_instance
from pinposture.arm.packages import find_packages, is_file, model_folders, package_folders
from pinposture.errors import FileError, InvalidValue
from pinposture.schema import shown
from pinposture.storage import read_text, require_suffix

MESH_FORMATS = (".stl", ".obj", ".dae", ".ply")  # suffixes of readable mesh files


class Triangles(NamedTuple):
    """A triangulated surface.

    Attributes:
        vertices: its vertices, (n, 3) [m].
        faces: triangles as vertex indices, (t, 3).
    """

    vertices: NDArray[np.float64]
    faces: NDArray[np.intp]


def find_mesh(filename: str, package_dirs: Sequence[str] = ()) -> Path:
    """Find the mesh file that a robot description refers to.

    Args:
        filename: "package://name/rest", "model://name/rest", "file:///...", or a path; relative paths start
            at `package_dirs`. In the first three, "%20" stands for a blank, and so on.
        package_dirs: folders to search; each may contain packages, be a package, or be inside or beside one.
            Packages are also searched in the folders of the environment variables AMENT_PREFIX_PATH and
            ROS_PACKAGE_PATH, models in those of Gazebo. The name of a package is that in its package.xml or
            that of its folder.

    Raises:
        FileError: there is no such file, or the scheme is another.
    """
    folders = [Path(folder) for folder in package_dirs]
    candidates: Iterable[Path]
    scheme, separator, address = filename.partition("://")
    if not separator or "/" in scheme:
        # Joining an absolute path to a folder drops the folder.
        candidates = [folder / filename for folder in folders] or [Path(filename)]
    elif scheme.lower() in ("package", "model"):
        name, _, rest = address.partition("/")
        folders = package_folders(folders) if scheme.lower() == "package" else model_folders(folders)
        packages = find_packages(unquote(name), folders)
        candidates = (package / spelling for package in packages for spelling in _spelt(rest))
    elif scheme.lower() == "file":
        host, _, rest = address.partition("/")
        local = host in ("", "localhost")
        candidates = [
            folder / spelling
            for folder in ([Path("/")] if local else folders)
            for spelling in _spelt(rest if local else address)
        ]
    else:
        allowed = "package://, model://, file:///, or a path"
        raise FileError(filename, f"its scheme is {scheme!r}; allowed: {allowed}; download it first")
    for candidate in candidates:
        if is_file(candidate):
            return candidate
    searched = ", ".join(map(str, folders)) or "no folder, because package_dirs (--package-dir) is empty"
    raise FileError(filename, f"not found (searched: {searched})")


def _spelt(rest: str) -> list[str]:
    """Return the path that the rest of an address means, then the path as it is written."""
    without_query = rest.partition("#")[0].partition("?")[0]
    return list(dict.fromkeys((unquote(without_query).lstrip("/"), rest.lstrip("/"))))


def read_mesh(path: Path) -> Triangles:
    """Read a mesh file in one of the `MESH_FORMATS`; COLLADA in its declared unit, others in metres.

    Raises:
        FileError: missing, in another format, or without valid triangles.
    """
    require_suffix(path, *MESH_FORMATS)
    if not is_file(path):
        raise FileError(path, "no such file")
    if path.suffix.lower() == ".dae" and find_spec("collada") is None:
        raise FileError(path, "is COLLADA, which requires the package pycollada; install it")
    try:
        import trimesh  # slow to import, and most arms need no files

        scene = trimesh.load_scene(path, process=False)
        if path.suffix.lower() == ".dae" and scene.units is not None:
            scene = scene.convert_units("meters")
        surface = scene.to_mesh()
        mesh = Triangles(np.array(surface.vertices, dtype=np.float64), np.array(surface.faces, dtype=np.intp))
    except Exception as error:  # readers raise anything on a broken file
        raise FileError(path, f"cannot be read: {str(error) or type(error).__name__}") from error
    if not mesh.faces.size:
        raise FileError(path, "contains no triangles")
    if mesh.faces.min() < 0 or mesh.faces.max() >= len(mesh.vertices):
        raise FileError(path, "has triangles with vertices that do not exist")
    return mesh


def scale_factor(path: Any, scale: Any) -> float:
    """Check the arguments of a loader, a file name and a scale; return the scale.

    Raises:
        InvalidValue: an invalid argument.
    """
    require_instance("path", path, str | PathLike, "the name of a file")
    if not is_number(scale) or not SMALLEST_LENGTH <= scale <= LARGEST_LENGTH:
        raise InvalidValue("scale", scale, f"a factor of {SMALLEST_LENGTH:g} to {LARGEST_LENGTH:g}")
    return float(scale)


def merge_corners(mesh: Triangles) -> Triangles:
    """Return a surface in which each vertex in use occurs once; some formats repeat vertices."""
    used = mesh.faces.reshape(-1)
    points = mesh.vertices[used]
    order = np.lexsort(points.T)
    ordered = points[order]
    new = np.ones(len(order), dtype=np.bool_)
    new[1:] = (ordered[1:] != ordered[:-1]).any(axis=1)
    faces = np.empty(len(order), dtype=np.intp)
    faces[order] = np.cumsum(new) - 1
    return Triangles(ordered[new], faces.reshape(-1, 3))


Array = NDArray[np.float64]

_COMMENTS = ("#", "//")
_LINES = "lines of three numbers or more, x y z first or where the line before them names x, y and z"


class ReadScan(NamedTuple):
    """The contents of a scan file, unchecked.

    Attributes:
        points: (n, 3), in the unit of the file, finite or not.
        faces: triangles as point indices, (k, 3); None for a point cloud.
        colors: colours of the points, (n, 3), integers 0 to 255 or floats 0 to 1; None without colours.
    """

    points: Array
    faces: NDArray[Any] | None = None
    colors: NDArray[Any] | None = None


def read_scan(path: Path) -> ReadScan:
    """Read a scan file in one of the formats of `SCAN_READERS`.

    Raises:
        FileError: missing, in another format, or malformed; says what is wrong and what is allowed.
    """
    convert = "; convert it, as by: pcl_pcd2ply in.pcd out.ply" if path.suffix.lower() == ".pcd" else ""
    reader = SCAN_READERS[require_suffix(path, *SCAN_READERS, hint=convert)]
    try:
        if not path.is_file():
            raise FileError(path, "is a directory" if path.is_dir() else "no such file")
        return reader(path)
    except MemoryError as error:
        raise FileError(path, "does not fit into memory") from error
    except OSError as error:
        if isinstance(error, FileError):
            raise
        raise FileError(path, f"cannot be read ({error.strerror or error})") from error
    except ValueError as error:  # a name with a null byte
        raise FileError(path, f"cannot be read ({error})") from error


def _read_text(path: Path) -> ReadScan:
    """Read lines of numbers separated by spaces, commas or semicolons; the first may name the columns."""
    text = read_text(path)
    start = _first_line(text)
    if start is None:
        raise FileError(path, f"contains no points; allowed: {_LINES}")
    number, first, comment = start
    separator = next((separator for separator in (";", ",") if separator in first), None)
    skipped = number - 1
    columns = (0, 1, 2)
    count = len(first.split(separator))
    names = _names(comment, separator)
    if not _are_numbers(first.split(separator)[:3]):
        names = _names(first, separator)
        skipped = number
        if not set(names) >= {"x", "y", "z"}:
            raise FileError(path, f"line {number} is {shown(first)}; allowed: {_LINES}")
    # A comment counts as column names only if it names all columns.
    if set(names) >= {"x", "y", "z"} and (skipped == number or len(names) == count):
        columns = (names.index("x"), names.index("y"), names.index("z"))
    try:
        points = np.loadtxt(
            io.StringIO(text),
            delimiter=separator,
            usecols=columns,
            comments=_COMMENTS,
            skiprows=skipped,
            ndmin=2,
        )
    except (ValueError, IndexError) as error:
        raise FileError(path, _fault(text, skipped, separator, columns) or str(error)) from None
    return ReadScan(points)


def _first_line(text: str) -> tuple[int, str, str] | None:
    """Return number and text of the first non-comment line, and the last comment before it."""
    comment = ""
    for number, line in enumerate(io.StringIO(text), start=1):
        content = _without_comment(line)
        if content:
            return number, content, comment
        comment = line.strip().lstrip("#/").strip() or comment
    return None


def _names(line: str, separator: str | None) -> list[str]:
    """Return column names without units."""
    words = line.split(separator if separator is not None and separator in line else None)
    return [word.strip(' \t"').lower().partition("[")[0].partition("(")[0].strip() for word in words]


def _without_comment(line: str) -> str:
    for comment in _COMMENTS:
        line = line.partition(comment)[0]
    return line.strip()


def _fault(text: str, skipped: int, separator: str | None, columns: tuple[int, ...]) -> str:
    """Describe the first faulty line; empty if there is none."""
    for number, line in enumerate(io.StringIO(text), start=1):
        content = _without_comment(line)
        if content and number > skipped:
            words = content.split(separator)
            if len(words) <= max(columns) or not _are_numbers([words[column] for column in columns]):
                return f"line {number} is {shown(content)}; allowed: {_LINES}"
    return ""


def _are_numbers(words: list[str]) -> bool:
    try:
        return len([float(word) for word in words]) > 0
    except ValueError:
        return False


def _read_npy(path: Path) -> ReadScan:
    try:
        values = np.load(path, allow_pickle=False)
    except Exception as error:  # numpy raises anything on a broken header
        raise FileError(path, f"is not a readable array ({error}); allowed: .npy of numbers") from error
    return ReadScan(_rows(path, "the array", values))


def _read_npz(path: Path) -> ReadScan:
    try:
        with np.load(path, allow_pickle=False) as archive:
            arrays = {name: archive[name] for name in archive.files}
    except Exception as error:  # as above
        reason = f"is not a readable archive of arrays ({error}); allowed: .npz of numbers"
        raise FileError(path, reason) from error
    if "points" not in arrays:
        if len(arrays) != 1:
            listed = ", ".join(arrays) or "nothing"
            allowed = "an array points, optionally with faces and colors"
            raise FileError(path, f"contains {listed}; allowed: {allowed}")
        return ReadScan(_rows(path, *next(iter(arrays.items()))))
    points = _rows(path, "points", arrays["points"])
    return ReadScan(points, arrays.get("faces"), arrays.get("colors"))


def _rows(path: Path, name: str, values: NDArray[Any]) -> Array:
    """Return points from an array with x, y, z first in its last axis; depth images have three axes."""
    if values.ndim not in (2, 3) or values.shape[-1] < 3 or values.dtype.kind not in "iuf":
        content = f"{name} is {values.dtype} {values.shape}"
        raise FileError(path, f"{content}; allowed: numbers, (n, 3) or (rows, columns, 3)")
    return np.asarray(values[..., :3].reshape(-1, 3), dtype=np.float64)


def _read_model(path: Path) -> ReadScan:
    """Read the points, triangles and colours of all parts of a file with trimesh."""
    if path.suffix.lower() == ".ply":
        _check_ply(path)
    try:
        import trimesh  # slow to import, and most arms need no files

        parts = trimesh.load_scene(path, process=False).dump()  # each part in the frame of the file
        meshes = [part for part in parts if isinstance(part, trimesh.Trimesh)]
        surfaces = [_surface(part) for part in meshes if len(part.faces)]
        clouds = [_cloud(part) for part in parts if isinstance(part, trimesh.PointCloud)]
        clouds += [_cloud(part) for part in meshes if not len(part.faces)]
    except Exception as error:  # readers raise anything on a broken file
        raise FileError(path, f"cannot be read: {str(error) or type(error).__name__}") from error
    clouds = [part for part in clouds if len(part.points)]
    if surfaces and clouds:
        raise FileError(path, "contains both triangles and loose points; allowed: one of them")
    if not surfaces and not clouds:
        raise FileError(path, "contains neither triangles nor points, or is cut off")
    for points, faces, _ in surfaces:
        if faces is not None and not 0 <= faces.min() <= faces.max() < len(points):
            raise FileError(path, "has triangles with vertices that do not exist")
    return _merge_corners(_join(surfaces)) if surfaces else _join(clouds)


def _surface(part: Any) -> ReadScan:
    faces = np.array(part.faces, dtype=np.int64)
    return ReadScan(np.array(part.vertices, dtype=np.float64), faces, _colors(part))


def _cloud(part: Any) -> ReadScan:
    points = np.array(part.vertices, dtype=np.float64).reshape(-1, 3)
    # A mesh without triangles has no attribute colors.
    return ReadScan(points, None, _rgb(np.array(getattr(part, "colors", ())), len(points)))


def _rgb(colors: NDArray[Any], count: int) -> NDArray[np.uint8] | None:
    """Return red, green and blue of `count` points; None if the array has another shape."""
    return colors[:, :3].astype(np.uint8) if colors.shape == (count, 4) else None


def _colors(part: Any) -> NDArray[np.uint8] | None:
    """Return the vertex colours of a surface, if need be from triangle colours or a texture."""
    visual = part.visual
    try:
        if visual.kind == "texture":
            visual = visual.to_color()
        colors = np.array(visual.vertex_colors) if visual.kind in ("vertex", "face") else np.zeros(0)
    except Exception:  # a missing texture: the surface is usable without it
        return None
    return _rgb(colors, len(part.vertices))


def _join(parts: list[ReadScan]) -> ReadScan:
    """Join all parts; parts without colours become grey if others have colours."""
    points = np.concatenate([part.points for part in parts])
    starts = np.cumsum([0, *(len(part.points) for part in parts)])
    faces = [part.faces + start for part, start in zip(parts, starts, strict=False) if part.faces is not None]
    colors = None
    grey = 180
    if any(part.colors is not None for part in parts):
        colors = np.concatenate(
            [
                np.full(part.points.shape, grey, dtype=np.uint8) if part.colors is None else part.colors
                for part in parts
            ]
        )
    return ReadScan(points, np.concatenate(faces) if faces else None, colors)


def _merge_corners(part: ReadScan) -> ReadScan:
    """Merge equal vertices of a surface without colours: STL files repeat them for each triangle."""
    if part.faces is None or part.colors is not None or len(part.points) < 3 * len(part.faces):
        return part
    return ReadScan(*merge_corners(Triangles(part.points, part.faces)))


def _check_ply(path: Path) -> None:
    """Reject an ASCII file with a wrong number of lines, in which trimesh would read faces as points."""
    with path.open("rb") as file:
        most = 100_000  # bytes of a header
        header: list[list[bytes]] = []
        while file.tell() < most and header[-1:] != [[b"end_header"]]:
            line = file.readline(most)
            if not line or (not header and line.strip() != b"ply"):
                break
            header.append(line.split())
        if header[-1:] != [[b"end_header"]]:
            raise FileError(path, "is not a PLY file: it has no header from 'ply' to 'end_header'")
        if [b"format", b"ascii", b"1.0"] not in header:
            return  # trimesh checks the size of binary files
        counts = [line[2] for line in header if line[:1] == [b"element"] and len(line) == 3]
        if not all(count.isdigit() for count in counts):
            raise FileError(path, "has an element with an invalid count")
        expected = sum(map(int, counts))
        lines = sum(1 for line in file if line.strip())
    if lines != expected:
        raise FileError(path, f"declares {expected} lines of data, but has {lines}")


SCAN_READERS: Mapping[str, Callable[[Path], ReadScan]] = MappingProxyType(
    {
        ".ply": _read_model,
        ".xyz": _read_text,
        ".csv": _read_text,
        ".txt": _read_text,
        ".npy": _read_npy,
        ".npz": _read_npz,
        ".stl": _read_model,
        ".obj": _read_model,
        ".off": _read_model,
        ".glb": _read_model,
    }
)
"""Readers by file name suffix."""
