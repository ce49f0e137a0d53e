"""What files of runs and of batches have in common: arrays, and a description in JSON, in one `.npz`."""

from __future__ import annotations

import io
import json
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any, NamedTuple, TypeVar
from zipfile import is_zipfile

import numpy as np

from pinposture.control import Limits
from pinposture.errors import FileError
from pinposture.storage import with_suffix, write_bytes

Made = TypeVar("Made")

_LIMITS_ARRAYS = ("step", "velocity", "acceleration")


class Kind(NamedTuple):
    """A kind of file.

    Attributes:
        format: its name in the file.
        version: the version that is written and read.
        noun: what it holds, in words.
        advice: what to say of a file of another kind, by the name of its format.
    """

    format: str
    version: int
    noun: str
    advice: Mapping[str, str]


def write_archive(
    path: Path, kind: Kind, limits: Limits, about: dict[str, Any], arrays: dict[str, Any]
) -> Path:
    """Write a file at once or not at all; `.npz` is added to a name without ending. Returns its path.

    Raises:
        FileError: the name has another ending, or the file cannot be written.
    """
    path = with_suffix(path, ".npz")
    told = {name: getattr(limits, name) for name in _LIMITS_ARRAYS}
    packed = {f"limits_{name}": value for name, value in told.items() if value is not None}
    described = {
        "format": kind.format,
        "version": kind.version,
        "dt": limits.dt,
        "position_margin": limits.position_margin,
        **about,
    }
    content = io.BytesIO()
    np.savez_compressed(content, about=np.array(json.dumps(described)), **arrays, **packed)
    write_bytes(path, content.getvalue())
    return path


def read_archive(
    path: Path, kind: Kind, made: Callable[[dict[str, Any], dict[str, Any], Limits], Made]
) -> Made:
    """Read a file.

    Args:
        path: the file.
        kind: what it should be.
        made: what makes something of its description, its arrays and the limits in it.

    Raises:
        FileError: there is no such file, it is of another kind, or damaged.
    """
    if not path.is_file():
        raise FileError(path, "no such file")
    try:
        with np.load(path, allow_pickle=False) as stored:
            arrays = {name: stored[name] for name in stored.files}
        about = json.loads(str(arrays["about"]))
        if about["format"] != kind.format or about["version"] != kind.version:
            found = f"format {about['format']!r} version {about['version']}"
            allowed = f"{found}; allowed: {kind.format!r} version {kind.version}"
            raise FileError(path, kind.advice.get(about["format"], allowed))
        limits = {
            name: value if value is None or value.ndim else float(value)
            for name, value in ((name, arrays.get(f"limits_{name}")) for name in _LIMITS_ARRAYS)
        }
        return made(about, arrays, Limits(**limits, dt=about["dt"], position_margin=about["position_margin"]))
    except FileError:
        raise
    except Exception as error:  # a damaged file can trip zlib, numpy's reader or Pinocchio's, anything
        detail = f"{type(error).__name__}: {error}"
        if isinstance(error, ValueError) and "pickle" in str(error):  # numpy's advice is not to be followed
            detail = "ValueError" if is_zipfile(path) else "it is no .npz archive"
        raise FileError(path, f"is not a saved {kind.noun} ({detail})") from error
