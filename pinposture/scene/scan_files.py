"""The files that hold scans: which reader each has, and those of plain numbers."""

from __future__ import annotations

import io
from collections.abc import Callable, Mapping
from pathlib import Path
from types import MappingProxyType
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from pinposture.errors import FileError
from pinposture.storage import read_text

Array = NDArray[np.float64]

_ARRAYS = ("points", "faces", "colors")
_COMMENTS = ("#", "//")


class ReadScan(NamedTuple):
    """What a file says, as it says it.

    Attributes:
        points: (n, 3), in the unit of the file, finite or not.
        faces: triangles as indices of points, (k, 3); None for a cloud of points.
        colors: of the points, (n, 3), 0 to 255 if they are whole numbers, else 0 to 1; None without.
    """

    points: Array
    faces: NDArray[Any] | None = None
    colors: NDArray[Any] | None = None


def read_scan(path: Path) -> ReadScan:
    """Read a file of one of the FORMATS.

    Raises:
        FileError: missing, of another format, or malformed; says what is wrong and what is allowed.
    """
    reader = FORMATS.get(path.suffix.lower())
    if reader is None:
        raise FileError(path, f"the name ends in {path.suffix!r}; allowed: {', '.join(FORMATS)}")
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
    """Lines of numbers between spaces, commas or semicolons; the first may name the columns."""
    text = read_text(path)
    start = _start(text)
    if start is None:
        raise FileError(path, f"holds no points; allowed: {_LINES}")
    mark = next((mark for mark in (";", ",") if mark in start.first), None)
    skipped, columns = start.number - 1, (0, 1, 2)
    count = len(start.first.split(mark))
    names = _names(start.comment, mark)
    if not _are_numbers(start.first.split(mark)[:3]):
        names, skipped = _names(start.first, mark), start.number
        if not set(names) >= _XYZ:
            raise FileError(path, f"line {start.number} is {_short(start.first)}; allowed: {_LINES}")
    # A comment that names the columns names all of them.
    if set(names) >= _XYZ and (skipped == start.number or len(names) == count):
        columns = (names.index("x"), names.index("y"), names.index("z"))
    try:
        points = np.loadtxt(
            io.StringIO(text),
            delimiter=mark,
            usecols=columns,
            comments=_COMMENTS,
            skiprows=skipped,
            ndmin=2,
        )
    except (ValueError, IndexError) as error:
        raise FileError(path, _fault(text, skipped, mark, columns) or str(error)) from None
    return ReadScan(points)


_LINES = "lines of three numbers or more, x y z first or where the line before them names x, y and z"
_XYZ = {"x", "y", "z"}


class _Start(NamedTuple):
    """Where the lines of a text begin that say something.

    Attributes:
        number: of the first of them, from 1.
        first: what it says.
        comment: the last comment before it.
    """

    number: int
    first: str
    comment: str


def _start(text: str) -> _Start | None:
    comment = ""
    for number, line in enumerate(io.StringIO(text), start=1):
        said = _said(line)
        if said:
            return _Start(number, said, comment)
        comment = line.strip().lstrip("#/").strip() or comment
    return None


def _names(line: str, mark: str | None) -> list[str]:
    """Names of columns, without their units."""
    words = line.split(mark if mark is not None and mark in line else None)
    return [word.strip(' \t"').lower().partition("[")[0].partition("(")[0].strip() for word in words]


def _said(line: str) -> str:
    for comment in _COMMENTS:
        line = line.partition(comment)[0]
    return line.strip()


def _fault(text: str, skipped: int, mark: str | None, columns: tuple[int, ...]) -> str:
    """Which line is at fault, in words; nothing if none is."""
    for number, line in enumerate(io.StringIO(text), start=1):
        said = _said(line)
        if said and number > skipped:
            words = said.split(mark)
            if len(words) <= max(columns) or not _are_numbers([words[column] for column in columns]):
                return f"line {number} is {_short(said)}; allowed: {_LINES}"
    return ""


def _are_numbers(words: list[str]) -> bool:
    try:
        return len([float(word) for word in words]) > 0
    except ValueError:
        return False


def _read_npy(path: Path) -> ReadScan:
    try:
        values = np.load(path, allow_pickle=False)
    except Exception as error:  # a broken header makes numpy fail in any way
        raise FileError(path, f"is no array that can be read ({error}); allowed: .npy of numbers") from error
    return ReadScan(_rows(path, "the array", values))


def _read_npz(path: Path) -> ReadScan:
    try:
        with np.load(path, allow_pickle=False) as archive:
            arrays = {name: archive[name] for name in archive.files}
    except Exception as error:  # as above
        reason = f"is no archive of arrays that can be read ({error}); allowed: .npz of numbers"
        raise FileError(path, reason) from error
    if "points" not in arrays:
        if len(arrays) != 1:
            listed = ", ".join(arrays) or "nothing"
            raise FileError(
                path, f"holds {listed}; allowed: an array points, with faces and colors if need be"
            )
        return ReadScan(_rows(path, *next(iter(arrays.items()))))
    points = _rows(path, "points", arrays["points"])
    return ReadScan(points, *(arrays.get(name) for name in _ARRAYS[1:]))


def _rows(path: Path, name: str, values: NDArray[Any]) -> Array:
    """Points from an array whose last axis holds x, y, z and maybe more; depth images have two more axes."""
    if values.ndim not in (2, 3) or values.shape[-1] < 3 or values.dtype.kind not in "iuf":
        found = f"{name} is {values.dtype} {values.shape}"
        raise FileError(path, f"{found}; allowed: numbers, (n, 3) or (rows, columns, 3)")
    return np.asarray(values[..., :3].reshape(-1, 3), dtype=np.float64)


def _read_pcd(path: Path) -> ReadScan:
    from pinposture.scene.scan_pcd import read_pcd

    return ReadScan(*read_pcd(path))


def _read_model(path: Path) -> ReadScan:
    from pinposture.scene.scan_models import read_model

    return ReadScan(*read_model(path))


def _short(text: str) -> str:
    return repr(text if len(text) < 60 else text[:57] + "...")


FORMATS: Mapping[str, Callable[[Path], ReadScan]] = MappingProxyType(
    {
        ".ply": _read_model,
        ".pcd": _read_pcd,
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
"""Readers by the ending of the name."""
