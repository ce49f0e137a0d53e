"""Paths of files that a task names: absolute in memory, relative to the task file where that is possible."""

from __future__ import annotations

import os
from pathlib import Path


def settled(path: str | Path) -> Path:
    """An absolute path without links and dots on the way to the file; if that is a link, it stays one."""
    given = Path(path)
    try:
        return Path(os.path.realpath(given.parent)) / given.name
    except (OSError, ValueError):  # no way that could be followed
        return given.absolute()


def relative(path: Path, folder: Path) -> str:
    """How a file in a folder names another one: with slashes, on every system.

    Args:
        path: the file that is named.
        folder: where the file lies that names it.
    """
    there = settled(path)
    try:
        words = Path(os.path.relpath(there, os.path.realpath(folder))).as_posix()
    except ValueError:  # on another drive
        return there.as_posix()
    return there.as_posix() if words.startswith("~") else words  # it would be read as somebody's home
