"""Joint motions as files: arrays in `.npz`, a table in CSV, and the message of ROS 2 for them in JSON."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

from pinposture.errors import FileError
from pinposture.motion.joint_files import arrays, ros_message, table
from pinposture.motion.joint_trajectory import JointTrajectory

__all__ = ["FORMATS", "check_format", "load_joint_trajectory", "save_joint_trajectory"]

_WRITE: dict[str, Callable[[JointTrajectory, Path], None]] = {
    ".npz": arrays.write,
    ".csv": table.write,
    ".json": ros_message.write,
}
_READ = {".npz": arrays.read, ".csv": table.read, ".json": ros_message.read}

FORMATS = tuple(_WRITE)
"""Suffixes of files that can be written and read."""


def check_format(path: Path) -> str:
    """The suffix of a file, in small letters.

    Raises:
        FileError: it is of none of the formats.
    """
    suffix = path.suffix.lower()
    if suffix not in FORMATS:
        raise FileError(path, f"the name ends in {suffix!r}; allowed: {', '.join(FORMATS)}")
    return suffix


def save_joint_trajectory(trajectory: JointTrajectory, path: Path) -> Path:
    """Write a motion; see `JointTrajectory.save`."""
    _WRITE[check_format(path)](trajectory, path)
    return path


def load_joint_trajectory(path: Path) -> JointTrajectory:
    """Read a motion; see `JointTrajectory.load`."""
    return _READ[check_format(path)](path)
