"""Scene files: TOML or JSON to plain data, and plain data to JSON."""

from __future__ import annotations

import json
import sys
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from pinposture.errors import FileError
from pinposture.storage import read_text, write_text

if sys.version_info >= (3, 11):
    import tomllib
else:
    import tomli as tomllib


def read_scene(path: Path) -> Any:
    """Read a file without looking at what it says.

    Raises:
        FileError: missing, unreadable, of another format, or malformed; names the line.
    """
    suffix = path.suffix.lower()
    if suffix not in (".toml", ".json"):
        raise FileError(path, f"the name ends in {suffix!r}; allowed: .toml, .json")
    text = read_text(path)
    try:
        return tomllib.loads(text) if suffix == ".toml" else json.loads(text)
    except json.JSONDecodeError as error:
        raise FileError(path, f"line {error.lineno}, column {error.colno}: {error.msg}") from error
    except (ValueError, RecursionError) as error:  # TOML errors say the line themselves
        raise FileError(path, str(error).replace("\n", " ")) from error


def write_scene(path: Path, content: Mapping[str, Any]) -> Path:
    """Write a JSON file whole or not at all. Returns its path.

    Raises:
        FileError: the name does not end in .json, or the file cannot be written.
    """
    if path.suffix.lower() != ".json":
        raise FileError(path, f"the name ends in {path.suffix!r}; allowed: .json")
    write_text(path, json.dumps(content, allow_nan=False, indent=1) + "\n")
    return path
