"""Clouds of points in PCD files, the format of the Point Cloud Library: ascii and binary."""

from __future__ import annotations

import io
import re
import warnings
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pinposture.errors import FileError, PostureWarning

Array = NDArray[np.float64]

_KEYS = ("VERSION", "FIELDS", "SIZE", "TYPE", "COUNT", "WIDTH", "HEIGHT", "VIEWPOINT", "POINTS", "DATA")
_HERE = (0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0)
"""The viewpoint of a cloud in the frame of its sensor, or of none: place, and quaternion w x y z."""
_LONGEST = 100_000
"""Bytes within which the header has to be over."""


def read_pcd(path: Path) -> tuple[Array, None, NDArray[np.uint8] | None]:
    """Points and colours of a file, in the unit of the file; points may be not finite.

    Raises:
        FileError: malformed, shorter than it says, or compressed.
    """
    content = path.read_bytes()
    header, start = _header(path, content)
    names, dtype = _fields(path, header)
    count = _count(path, header)
    kind = " ".join(header["DATA"])
    if kind == "binary":
        if len(content) - start < count * dtype.itemsize:
            has = (len(content) - start) // max(dtype.itemsize, 1)
            raise FileError(path, f"says that it has {count} points, but has {has}")
        rows = np.frombuffer(content, dtype=dtype, count=count, offset=start)
    elif kind == "ascii":
        rows = _ascii_rows(path, content, start, dtype, count)
    elif kind == "binary_compressed":
        raise FileError(path, "is binary_compressed; allowed: ascii, binary (pcl_convert_pcd_ascii_binary)")
    else:
        raise FileError(path, f"DATA is {kind!r}; allowed: ascii, binary")
    if tuple(map(float, header.get("VIEWPOINT", _HERE))) != _HERE:
        text = f"{path}: the viewpoint in the file is not applied; points stay in the frame they are in"
        warnings.warn(text, PostureWarning, stacklevel=2)
    points = np.stack([rows[name][:, 0] for name in ("x", "y", "z")], axis=1).astype(np.float64)
    packed = next((name for name in ("rgb", "rgba") if name in names), None)
    return points, None, None if packed is None else _unpacked(rows[packed][:, 0])


def _header(path: Path, content: bytes) -> tuple[dict[str, list[str]], int]:
    """The words after each key, and where the data begin."""
    header: dict[str, list[str]] = {}
    at = 0
    while "DATA" not in header:
        end = content.find(b"\n", at, _LONGEST)
        line = content[at : end if end >= 0 else at].decode("latin-1").partition("#")[0].split()
        if end < 0 or (line and line[0] not in _KEYS):
            found = f"has a line that begins with {line[0]!r}" if line else "ends"
            raise FileError(path, f"is no PCD file: the header {found}; allowed: {', '.join(_KEYS)}")
        if line:
            header[line[0]] = line[1:]
        at = end + 1
    return header, at


def _fields(path: Path, header: dict[str, list[str]]) -> tuple[list[str], np.dtype[Any]]:
    """Names of the fields, and how a point is laid out."""
    names = header.get("FIELDS", [])
    sizes, types = header.get("SIZE", []), header.get("TYPE", [])
    counts = header.get("COUNT", ["1"] * len(names))
    if not len(names) == len(sizes) == len(types) == len(counts):
        raise FileError(path, "FIELDS, SIZE, TYPE and COUNT are of different lengths")
    if not {"x", "y", "z"} <= set(names):
        raise FileError(path, f"has the fields {', '.join(names) or 'none'}; allowed: x, y, z among them")
    layout = []
    for number, (name, size, kind, count) in enumerate(zip(names, sizes, types, counts, strict=True)):
        form = {"F": "f", "I": "i", "U": "u"}.get(kind, "") + size
        if form not in ("f4", "f8", "i1", "i2", "i4", "i8", "u1", "u2", "u4", "u8") or not count.isdecimal():
            allowed = "TYPE F of SIZE 4 or 8, I or U of SIZE 1, 2, 4 or 8, COUNT a whole number"
            raise FileError(path, f"field {name!r} is {kind} {size} {count}; allowed: {allowed}")
        if name in ("x", "y", "z") and count != "1":
            raise FileError(path, f"field {name!r} has COUNT {count}; allowed: 1")
        # What fills gaps is called "_", more than once.
        unique = name if names.index(name) == number and name != "_" else f"_{number}"
        layout.append((unique, f"<{form}", (int(count),)))
    return [each[0] for each in layout], np.dtype(layout)


def _count(path: Path, header: dict[str, list[str]]) -> int:
    told = header.get("POINTS")
    if told is None and "WIDTH" in header and "HEIGHT" in header:
        sides = [*header["WIDTH"], *header["HEIGHT"]]
        if len(sides) == 2 and all(map(str.isdecimal, sides)):
            return int(sides[0]) * int(sides[1])
    if told is None or len(told) != 1 or not re.fullmatch("[0-9]{1,12}", told[0]):
        raise FileError(path, f"POINTS is {' '.join(told or []) or 'missing'}; allowed: a whole number")
    return int(told[0])


def _ascii_rows(path: Path, content: bytes, start: int, dtype: np.dtype[Any], count: int) -> NDArray[Any]:
    """The rows of an ascii file; whole numbers of all sizes are exact."""
    flat = [(name, dtype[name].base, dtype[name].shape[0]) for name in dtype.names or ()]
    layout = np.dtype([(f"{name}:{k}", base) for name, base, size in flat for k in range(size)])
    text = content[start:].decode("latin-1")
    if not text.strip():
        raise FileError(path, f"says that it has {count} points, but has 0")
    try:
        rows = np.loadtxt(io.StringIO(text), dtype=layout, ndmin=1, comments=None)
    except ValueError as error:
        raise FileError(path, f"has data that are not as the header says: {error}") from None
    if len(rows) != count:
        raise FileError(path, f"says that it has {count} points, but has {len(rows)}")
    shaped = np.zeros(len(rows), dtype=dtype)
    for name, _, size in flat:
        for k in range(size):
            shaped[name][:, k] = rows[f"{name}:{k}"]
    return shaped


def _unpacked(packed: NDArray[Any]) -> NDArray[np.uint8] | None:
    """Red, green and blue from numbers 0xRRGGBB, floats with these bits, or floats of that value."""
    if packed.dtype.itemsize != 4:
        return None
    whole = packed.dtype.kind == "f" and bool(np.all(np.isfinite(packed) & (packed >= 0.0)))
    # As bits of a float, a colour is nowhere near a whole number but 0.
    if whole and packed.max(initial=0.0) >= 1.0 and packed.max() < 2**24 and np.all(packed % 1.0 == 0.0):
        packed = packed.astype("<u4")
    bits = np.ascontiguousarray(packed).view("<u4")
    return np.stack([(bits >> shift) & 255 for shift in (16, 8, 0)], axis=1).astype(np.uint8)
