"""Joint motions as arrays of NumPy in one `.npz`, exact to the last bit."""

from __future__ import annotations

import io
import json
from pathlib import Path
from typing import Any

import numpy as np

from pinposture.errors import FileError
from pinposture.motion.joint_trajectory import JointTrajectory
from pinposture.storage import write_bytes

FORMAT, VERSION = "pinposture-joint-trajectory", 1

_NUMBERS = ("time", "positions", "velocities", "accelerations")
_TEXTS = ("joint_names", "units")


def write(trajectory: JointTrajectory, path: Path) -> None:
    """Write the arrays under the names that they have in `JointTrajectory`.

    Raises:
        FileError: the file cannot be written.
    """
    about = {"format": FORMAT, "version": VERSION, "name": trajectory.name}
    stored: dict[str, Any] = {name: getattr(trajectory, name) for name in _NUMBERS}
    stored |= {name: np.array(getattr(trajectory, name)) for name in _TEXTS}
    content = io.BytesIO()
    np.savez_compressed(content, about=np.array(json.dumps(about)), **stored)
    write_bytes(path, content.getvalue())


def read(path: Path) -> JointTrajectory:
    """Read what `write` wrote.

    Raises:
        FileError: there is no such file, it holds something else, or it is damaged.
    """
    if not path.is_file():
        raise FileError(path, "no such file")
    try:
        with np.load(path, allow_pickle=False) as stored:
            about = json.loads(str(stored["about"]))
            if (about["format"], about["version"]) != (FORMAT, VERSION):
                found = f"format {about['format']!r} version {about['version']}"
                raise FileError(path, f"{found}; allowed: {FORMAT!r} version {VERSION}")
            fields: dict[str, Any] = {name: stored[name] for name in _NUMBERS}
            fields |= {name: tuple(stored[name].tolist()) for name in _TEXTS}
        return JointTrajectory(**fields, name=about["name"])
    except FileError:
        raise
    except Exception as error:  # a damaged file can trip zlib or numpy's reader, anything
        detail = "" if isinstance(error, ValueError) and "pickle" in str(error) else f": {error}"
        raise FileError(path, f"is not a saved joint trajectory ({type(error).__name__}{detail})") from error


def archive_format(path: Path) -> str:
    """What a `.npz` of this library says that it holds; empty if it is none, or unreadable."""
    try:
        with np.load(path, allow_pickle=False) as stored:
            return str(json.loads(str(stored["about"]))["format"])
    except Exception:  # as above; whoever reads it next says what is wrong
        return ""
