"""A TOML or JSON file as plain data, refused if that is not fit to be read on."""

from __future__ import annotations

import json
import re
import sys
from collections.abc import Mapping
from pathlib import Path
from typing import Any, NamedTuple

from pinposture.errors import FileError
from pinposture.storage import read_text
from pinposture.task.reading.lines import Place
from pinposture.task.reading.showing import cut, shown_key

if sys.version_info >= (3, 11):
    import tomllib
else:
    import tomli as tomllib

DEEPEST = 20
"""Tables and lists within each other; three times what a task has."""

WIDEST = 64
"""Bits of a whole number, as in TOML."""

_TOML_ERROR = re.compile(r"(.*) \(at (?:(line \d+, column \d+)|end of document)\)", re.DOTALL)


class Content(NamedTuple):
    """What a file holds.

    Attributes:
        values: keys and values.
        toml: the text if it is TOML, lines ending in a line feed; None if it is JSON.
    """

    values: dict[str, Any]
    toml: str | None


def read_content(path: Path) -> Content:
    """Read a file.

    Raises:
        FileError: it is missing, unreadable, of another format, malformed, or holds no table; names the line.
    """
    check_format(path)
    return content_of(path, read_text(path).replace("\r\n", "\n"))


def content_of(path: Path, text: str) -> Content:
    """What a file would hold, if this were its text.

    Raises:
        FileError: the text is malformed, or holds no table; names the line.
    """
    toml = path.suffix.lower() == ".toml"
    try:
        values = tomllib.loads(text) if toml else json.loads(text, object_pairs_hook=_once)
    except json.JSONDecodeError as error:
        raise FileError(path, f"line {error.lineno}, column {error.colno}: {error.msg}") from error
    except RecursionError:
        raise FileError(path, f"tables and lists are nested too deep; allowed: {DEEPEST} levels") from None
    except ValueError as error:
        raise FileError(path, _where_first(" ".join(str(error).split()))) from error
    if not isinstance(values, dict):
        raise FileError(path, "holds no table; allowed: keys and values, as in version = 1")
    _check(path, values)
    return Content(values, text if toml else None)


def check_format(path: Path) -> None:
    """Refuse a name that says nothing of the format.

    Raises:
        FileError: it ends neither in .toml nor in .json.
    """
    suffix = path.suffix.lower()
    if suffix not in (".toml", ".json"):
        raise FileError(path, f"the name ends in {suffix!r}; allowed: .toml, .json")


def _where_first(message: str) -> str:
    """What the TOML reader says, with the line in front as in all other messages."""
    found = _TOML_ERROR.fullmatch(message)
    if found is None:
        return message
    return f"{found[2] or 'end of the file'}: {found[1]}"


def _once(pairs: list[tuple[str, Any]]) -> dict[str, Any]:
    """A JSON table, none of whose keys may appear twice; JSON would take the last."""
    table = dict(pairs)
    if len(table) < len(pairs):
        keys = [key for key, _ in pairs]
        twice = next(key for key in keys if keys.count(key) > 1)
        raise ValueError(f"the key {shown_key(twice)!r} appears twice in a table")
    return table


def _check(path: Path, values: dict[str, Any]) -> None:
    """Refuse what would be too much further on: deep nesting, and whole numbers without end."""
    waiting: list[tuple[Place, Any]] = [((), values)]
    while waiting:
        place, value = waiting.pop()
        if isinstance(value, Mapping):
            waiting += [((*place, key), each) for key, each in value.items()]
        elif isinstance(value, list):
            waiting += [((*place, number), each) for number, each in enumerate(value)]
        elif isinstance(value, int) and value.bit_length() > WIDEST:
            raise FileError(path, f"{place_in_words(place)}: is a whole number of more than {WIDEST} bits")
        if len(place) > DEEPEST:
            reason = f"is nested too deep; allowed: {DEEPEST} levels of tables and lists"
            raise FileError(path, f"{place_in_words(place)}: {reason}")


def place_in_words(place: Place) -> str:
    """What to call a place of a file: "keyframe 2, curve.radius"; items are counted from 1."""
    words = ""
    for key in place:
        if isinstance(key, int):
            words = f"{words.removesuffix('s')} {key + 1}"
        else:
            between = "." if words and not words[-1].isdigit() else ", " if words else ""
            words += between + shown_key(key)
    return cut(words) or "the file"
