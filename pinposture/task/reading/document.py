"""A TOML or JSON file as tables that know where they stand in it, so that errors can say so."""

from __future__ import annotations

import json
import re
import sys
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from difflib import get_close_matches
from pathlib import Path
from typing import Any, TypeVar

from pinposture.errors import FileError, InvalidValue, PostureError
from pinposture.task.reading.quantities import read_quantity

if sys.version_info >= (3, 11):
    import tomllib
else:
    import tomli as tomllib

Key = str | int
Made = TypeVar("Made")

_HEADER = re.compile(r"\s*(\[\[?)\s*([^\[\]]+?)\s*\]\]?\s*(?:#.*)?")
_ENTRY = re.compile(r"\s*([A-Za-z0-9_.\"'-]+(?:\s*\.\s*[A-Za-z0-9_\"'-]+)*)\s*=")

_REQUIRED: Any = object()


class Table:
    """A table of a file, read key by key.

    Every method that reads raises a FileError that names the file, the key, its line where that is known, the
    value, and what was allowed.
    """

    def __init__(self, values: Mapping[str, Any], where: tuple[Key, ...], document: Document) -> None:
        self._values, self._where, self._document = values, where, document

    def __contains__(self, key: str) -> bool:
        return key in self._values

    def only(self, *allowed: str) -> Table:
        """Refuse keys other than these; returns the table itself."""
        for key in self._values:
            if key not in allowed:
                close = get_close_matches(key, allowed, n=1)
                hint = f" (did you mean {close[0]!r}?)" if close else ""
                raise self.fault(key, f"there is no such key{hint}; allowed: {', '.join(allowed)}")
        return self

    def fault(self, key: str | None, reason: str) -> FileError:
        """An error that says what is wrong with a key, or with the table."""
        where = self._where if key is None else (*self._where, key)
        return FileError(self._document.path, f"{self._document.place(where)}: {reason}")

    @contextmanager
    def blaming(self, key: str | None = None) -> Iterator[None]:
        """Say of an error of the library that it is this key's fault."""
        try:
            yield
        except InvalidValue as error:
            named = error.name if key is None and error.name in self._values else key
            raise self.fault(named, str(error)) from error
        except PostureError as error:
            raise self.fault(key, str(error)) from error

    def value(self, key: str, default: Any = _REQUIRED) -> Any:
        """Whatever is there."""
        if key not in self._values and default is _REQUIRED:
            raise self.fault(None, f"the key {key!r} is missing")
        return self._values.get(key, default)

    def text(self, key: str, default: Any = _REQUIRED, allowed: tuple[str, ...] = ()) -> Any:
        """Text, one of some words if those are given."""
        value = self.value(key, default)
        if key in self._values and (not isinstance(value, str) or (allowed and value not in allowed)):
            words = ", ".join(map(repr, allowed)) or "text"
            raise self.fault(key, f"is {value!r}; allowed: {words}")
        return value

    def flag(self, key: str, default: bool) -> bool:
        """True or false."""
        value = self.value(key, default)
        if not isinstance(value, bool):
            raise self.fault(key, f"is {value!r}; allowed: true, false")
        return value

    def whole(self, key: str, default: Any = _REQUIRED) -> Any:
        """A whole number."""
        value = self.value(key, default)
        if key in self._values and (isinstance(value, bool) or not isinstance(value, int)):
            raise self.fault(key, f"is {value!r}; allowed: a whole number")
        return value

    def number(self, key: str, default: Any = _REQUIRED) -> Any:
        """A number that has no unit."""
        value = self.value(key, default)
        if key in self._values and (isinstance(value, bool) or not isinstance(value, int | float)):
            raise self.fault(key, f"is {value!r}; allowed: a number")
        return value

    def quantity(self, key: str, *kinds: str, default: Any = _REQUIRED) -> Any:
        """A quantity in SI units; see `read_quantity`."""
        if key not in self._values:
            return self.value(key, default)
        return self._quantity(key, self._values[key], kinds)

    def quantities(self, key: str, count: int | None, *kinds: str, default: Any = _REQUIRED) -> Any:
        """A list of quantities; `count` of them, or any number if None."""
        value = self.value(key, default)
        if key not in self._values:
            return value
        if not isinstance(value, list) or (count is not None and len(value) != count):
            wanted = "a list" if count is None else f"a list of {count}"
            raise self.fault(key, f"is {value!r}; allowed: {wanted}")
        return [self._quantity(key, each, kinds) for each in value]

    def _quantity(self, key: str, value: object, kinds: tuple[str, ...]) -> float:
        try:
            return read_quantity(value, *kinds)
        except ValueError as error:
            raise self.fault(key, str(error)) from None

    def table(self, key: str) -> Table:
        """A table within this one; empty if there is none."""
        value = self._values.get(key, {})
        if not isinstance(value, Mapping):
            raise self.fault(key, f"is {value!r}; allowed: a table, [{key}]")
        return Table(value, (*self._where, key), self._document)

    def tables(self, key: str) -> list[Table]:
        """Tables of the same name, in order."""
        value = self._values.get(key, [])
        if not isinstance(value, list) or not all(isinstance(each, Mapping) for each in value):
            raise self.fault(key, f"is {value!r}; allowed: tables, each begun by [[{key}]]")
        return [Table(each, (*self._where, key, i), self._document) for i, each in enumerate(value)]

    def part(self, *keys: str) -> Table:
        """The same table with some of its keys only."""
        return Table({k: v for k, v in self._values.items() if k in keys}, self._where, self._document)

    def plain(self) -> dict[str, Any]:
        """What the table holds, as it is."""
        return dict(self._values)

    def file(self, key: str, read: Callable[[Path], Made]) -> Made:
        """What a file holds that is named here; its path begins where the file lies that names it."""
        path = Path(self.text(key)).expanduser()
        with self.blaming(key):
            return read(path if path.is_absolute() else self._document.path.parent / path)


class Document:
    """A file that was read.

    Attributes:
        path: the file.
        root: what it holds.
    """

    def __init__(self, path: Path) -> None:
        self.path = path
        text = _read(path)
        toml = path.suffix.lower() == ".toml"
        try:
            content = tomllib.loads(text) if toml else json.loads(text)
        except json.JSONDecodeError as error:
            raise FileError(path, f"line {error.lineno}, column {error.colno}: {error.msg}") from error
        except (ValueError, RecursionError) as error:  # TOML errors say the line themselves
            raise FileError(path, " ".join(str(error).split())) from error
        if not isinstance(content, dict):
            raise FileError(path, "holds no table; allowed: keys and values, as in version = 1")
        self._lines = _lines(text) if toml else {}
        self.root = Table(content, (), self)

    def place(self, where: tuple[Key, ...]) -> str:
        """What to call a key, with its line where that is known."""
        words = ""
        for key in where:
            if isinstance(key, int):
                words = f"{words.removesuffix('s')} {key + 1}"
            else:
                words += f"{'.' if words and not words[-1].isdigit() else ', ' if words else ''}{key}"
        for end in range(len(where), 0, -1):
            if where[:end] in self._lines:
                return f"line {self._lines[where[:end]]}: {words}"
        return words or "the file"


def _read(path: Path) -> str:
    suffix = path.suffix.lower()
    if suffix not in (".toml", ".json"):
        raise FileError(path, f"the name ends in {suffix!r}; allowed: .toml, .json")
    try:
        return path.read_text(encoding="utf-8-sig")
    except FileNotFoundError:
        raise FileError(path, "no such file") from None
    except UnicodeDecodeError as error:
        raise FileError(path, f"is not UTF-8 text (byte {error.start})") from None
    except OSError as error:
        raise FileError(path, f"cannot be read ({error.strerror or error})") from error


def _lines(text: str) -> dict[tuple[Key, ...], int]:
    """The line of each table and key of a TOML file, as far as they begin one."""
    found: dict[tuple[Key, ...], int] = {}
    counts: dict[tuple[Key, ...], int] = {}
    inside: tuple[Key, ...] = ()
    for number, line in enumerate(text.splitlines(), start=1):
        header = _HEADER.fullmatch(line)
        if header is not None:
            names = _names(header[2])
            if header[1] == "[[":
                index = counts[names] = counts.get(names, -1) + 1
                inside = (*names, index)
            else:
                first = names[:1]
                inside = (*first, counts[first], *names[1:]) if first in counts else names
            found.setdefault(inside, number)
            continue
        entry = _ENTRY.match(line)
        if entry is not None:
            found.setdefault((*inside, *_names(entry[1])), number)
    return found


def _names(dotted: str) -> tuple[Key, ...]:
    return tuple(name.strip().strip("\"'") for name in dotted.split("."))
