"""Curve files: JSON and CSV to the description of a curve, and back to JSON."""

from __future__ import annotations

import inspect
import json
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

from pinposture._validation import as_points, check_distinct
from pinposture.errors import CurveError, FileError, UnknownName
from pinposture.storage import read_text, write_text

_TABLES = (".csv", ".txt")


def read_description(path: Path) -> dict[str, Any]:
    """Read a curve file into what `Curve.from_dict` takes.

    Raises:
        FileError: missing, unreadable, of another format, or a malformed line.
        CurveError: a line of a table that makes no curve, named by its number.
    """
    suffix = path.suffix.lower()
    if suffix not in (".json", *_TABLES):
        raise FileError(path, f"the name ends in {suffix!r}; allowed: .json, .csv, .txt")
    text = read_text(path)
    if suffix in _TABLES:
        return {"type": "points", "points": _table(path, text)}
    try:
        content = json.loads(text)
    except json.JSONDecodeError as error:
        raise FileError(path, f"line {error.lineno}, column {error.colno}: {error.msg}") from error
    except ValueError as error:  # a number of thousands of digits
        raise FileError(path, str(error)) from error
    except RecursionError as error:
        raise FileError(path, "lists within lists without end") from error
    if isinstance(content, list):
        return {"type": "points", "points": content}
    if not isinstance(content, dict):
        raise FileError(path, f"holds {content!r}; allowed: an object with a 'type', or a list of points")
    return content


def _table(path: Path, text: str) -> list[list[float]]:
    """Rows of a table of coordinates, with or without a line of headings."""
    lines: list[int] = []
    rows: list[list[float]] = []
    headings: list[str] | None = None
    for number, raw in enumerate(text.splitlines(), start=1):
        content = raw.partition("#")[0].strip()
        if not content:
            continue
        fields = _fields(content)
        values = [_number(field) for field in fields]
        if not rows and headings is None and all(fields) and not any(value is not None for value in values):
            headings = [field.strip("\"'").lower() for field in fields]
            if headings not in (["x", "y"], ["x", "y", "z"]):
                raise FileError(path, f"line {number}: columns {', '.join(fields)}; allowed: x, y or x, y, z")
            continue
        row = []
        for column, value in enumerate(values, start=1):
            if value is None:
                what = f"{fields[column - 1]!r} is not a number"
                raise FileError(path, f"line {number}, column {column}: {what}")
            row.append(value)
        width = len(headings or (rows[0] if rows else row))
        if len(row) != width or width not in (2, 3):
            wanted = f"{width}, as before" if width in (2, 3) else "2 (then z = 0) or 3"
            raise FileError(path, f"line {number}: {len(row)} columns; allowed: {wanted}")
        lines.append(number)
        rows.append(row)
    if not rows:
        raise FileError(path, "holds no points")

    def name(i: int) -> str:
        return f"line {lines[i]}"

    check_distinct(as_points(rows, name=name), name)
    return rows


def _fields(content: str) -> list[str]:
    for separator in (";", ","):
        if separator in content:
            return [field.strip() for field in content.split(separator)]
    return content.split()


def _number(field: str) -> float | None:
    try:
        return float(field)
    except ValueError:
        return None


def write_json(path: Path, content: Mapping[str, Any]) -> None:
    """Write a JSON file atomically.

    Raises:
        FileError: the name does not end in .json, or the file cannot be written.
    """
    if path.suffix.lower() != ".json":
        raise FileError(path, f"the name ends in {path.suffix!r}; allowed: .json")
    write_text(path, json.dumps(content, allow_nan=False) + "\n")


def read_call(
    description: object, constructors: Mapping[str, Callable[..., object]]
) -> tuple[str, dict[str, Any]]:
    """Check a description: a constructor's name under "type" and its arguments under their names.

    Args:
        description: for example {"type": "line", "a": [0, 0, 0], "b": [1, 0, 0]}.
        constructors: by type.

    Returns:
        The type, and the arguments by their names.

    Raises:
        CurveError: not a mapping, or a required key is missing.
        UnknownName: a type or a key that does not exist.
    """
    if not isinstance(description, Mapping):
        raise CurveError("description", f"{type(description).__name__}; allowed: an object with a 'type'")
    if "type" not in description:
        raise CurveError("description", f"needs the key 'type'; allowed: {', '.join(constructors)}")
    kind = description["type"]
    if not isinstance(kind, str) or kind not in constructors:
        raise UnknownName("type of curve", kind, constructors)
    keys = {
        name: parameter.default is inspect.Parameter.empty
        for name, parameter in inspect.signature(constructors[kind]).parameters.items()
    }
    for key in description:
        if key != "type" and key not in keys:
            raise UnknownName(f"key of a {kind!r} curve", key, keys)
    for key, needed in keys.items():
        if needed and key not in description:
            raise CurveError(f"{kind!r} curve", f"needs the key {key!r}")
    return kind, {key: description[key] for key in keys if key in description}
