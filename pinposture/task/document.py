"""TOML and JSON files as tables that know their lines, so that errors can name them."""

from __future__ import annotations

import json
import math
import re
import sys
from collections.abc import Callable, Hashable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from difflib import get_close_matches
from functools import cached_property
from pathlib import Path
from types import MappingProxyType
from typing import Any, NamedTuple, TypeVar

from pinposture.errors import FileError, InvalidValue, PostureError
from pinposture.storage import read_text, settled
from pinposture.task.toml import Place, lines_of_toml

if sys.version_info >= (3, 11):
    import tomllib
else:
    import tomli as tomllib

# What a file says, shown in a message: on one line, and not all of it.

LONGEST = 100
"""Characters of a value that are shown."""


def shown(value: object) -> str:
    """A value in the notation of Python, cut short."""
    return cut(repr(value))


def shown_key(key: str) -> str:
    """A key as it is, or in quotes if it could be taken for something else."""
    return cut(key if key.isprintable() and key.strip() == key != "" else repr(key))


def cut(text: str) -> str:
    """The beginning of a text, and all of it if it is short."""
    return text if len(text) <= LONGEST else text[: LONGEST - 4] + " ..."


# A TOML or JSON file as plain data, refused if that is not fit to be read on.

DEEPEST = 20
"""Tables and lists within each other; three times what a task has."""

WIDEST = 64
"""Bits of a whole number, as in TOML."""

_TOML_ERROR = re.compile(r"(.*) \(at (?:(line \d+, column \d+)|end of document)\)", re.DOTALL)


class Content(NamedTuple):
    """What a file holds.

    Attributes:
        values: keys and values.
        toml: the text if it is TOML; None if it is JSON.
    """

    values: dict[str, Any]
    toml: str | None


def read_content(path: Path) -> Content:
    """Read a file.

    Raises:
        FileError: it is missing, unreadable, of another format, malformed, or holds no table; names the line.
    """
    check_format(path)
    return content_of(path, read_text(path))


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


# Quantities in a file: numbers in SI units, or text with a unit.

_LENGTHS = {"m": 1.0, "cm": 1e-2, "mm": 1e-3}
_ANGLES = {"rad": 1.0, "deg": math.pi / 180.0, "turns": 2.0 * math.pi}
_TIMES = {"s": 1.0, "ms": 1e-3, "min": 60.0}


def _per(units: Mapping[str, float], below: str) -> dict[str, float]:
    return {f"{unit}/{below}": factor for unit, factor in units.items()}


UNITS: Mapping[str, Mapping[str, float]] = MappingProxyType(
    {
        "length": _LENGTHS,
        "angle": _ANGLES,
        "time": _TIMES,
        "speed": _per(_LENGTHS, "s"),
        "rate of turning": {**_per(_ANGLES, "s"), "rpm": math.pi / 30.0},
        "acceleration": _per(_LENGTHS, "s^2"),
        "rate of change of turning": _per(_ANGLES, "s^2"),
    }
)
"""Units by what they measure, with what one of each is in SI units."""

_TEXT = re.compile(r"\s*([-+]?(?:\d+\.?\d*|\.\d+)(?:[eE][-+]?\d+)?)\s*(\S.*?)?\s*")


def read_quantity(value: object, *kinds: str) -> float:
    """A quantity in SI units.

    Args:
        value: a number, which is in SI units, or text as "25 mm".
        kinds: what it may measure, keys of `UNITS`.

    Raises:
        ValueError: anything else; says what is allowed.
    """
    allowed = "a number in SI units, or text with one of the units " + ", ".join(
        unit for kind in kinds for unit in UNITS[kind]
    )
    if isinstance(value, int | float) and not isinstance(value, bool):
        return _finite(float(value), value, allowed)
    found = _TEXT.fullmatch(value) if isinstance(value, str) else None
    if found is None:
        raise ValueError(f"is {shown(value)}; allowed: {allowed}")
    unit = (found[2] or "").replace("**", "^").replace("²", "^2").replace(" ", "").replace("/s/s", "/s^2")
    for kind in kinds:
        if unit in UNITS[kind]:
            return _finite(float(found[1]) * UNITS[kind][unit], value, allowed)
    for kind, known in UNITS.items():
        if unit in known:
            raise ValueError(f"is {shown(value)}, of the kind {kind}; allowed: {allowed}")
    what = f"and {shown(unit)} is no unit that is known" if unit else "without a unit"
    raise ValueError(f"is {shown(value)}, {what}; allowed: {allowed}")


def _finite(number: float, value: object, allowed: str) -> float:
    if not math.isfinite(number):
        raise ValueError(f"is {shown(value)}, which is not finite; allowed: {allowed}")
    return number


# A TOML or JSON file as tables that know where they stand in it, so that errors can say so.

Made = TypeVar("Made")
Part = TypeVar("Part", bound=Hashable)

_REQUIRED: Any = object()
_NO_WORDS: Mapping[str, float] = MappingProxyType({})


class Table:
    """A table of a file, read key by key.

    Every method that reads raises a FileError that names the file, the key, its line where that is known, the
    value, and what was allowed.
    """

    def __init__(self, values: Mapping[str, Any], where: Place, document: Document) -> None:
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

    def fault(self, key: str | None, reason: str, *within: str | int) -> FileError:
        """An error that says what is wrong with a key, or with something within it, or with the table."""
        where = self._where if key is None else (*self._where, key, *within)
        return self._document.fault(where, reason)

    @contextmanager
    def blaming(self, key: str | None = None) -> Iterator[None]:
        """Say of an error of the library that it is this key's fault, or that of the key it names."""
        try:
            yield
        except InvalidValue as error:
            if error.name not in self._values:
                raise self.fault(key, str(error)) from error
            reason = f"is {shown(self._values[error.name])}; allowed: {error.allowed}"
            raise self.fault(error.name, reason) from error
        except PostureError as error:
            raise self.fault(key, str(error)) from error

    def value(self, key: str, default: Any = _REQUIRED) -> Any:
        """Whatever is there."""
        if key not in self._values and default is _REQUIRED:
            raise self.fault(None, f"the key {key!r} is missing")
        return self._values.get(key, default)

    def text(self, key: str, default: Any = _REQUIRED, allowed: Sequence[str] = ()) -> Any:
        """Text, one of some words if those are given."""
        value = self.value(key, default)
        if key in self._values and (not isinstance(value, str) or (allowed and value not in allowed)):
            close = get_close_matches(value, allowed, n=1) if isinstance(value, str) else []
            hint = f" (did you mean {close[0]!r}?)" if close else ""
            words = ", ".join(map(repr, allowed)) or "text"
            raise self.fault(key, f"is {shown(value)}{hint}; allowed: {words}")
        return value

    def flag(self, key: str, default: bool) -> bool:
        """True or false."""
        value = self.value(key, default)
        if not isinstance(value, bool):
            raise self.fault(key, f"is {shown(value)}; allowed: true, false")
        return value

    def whole(self, key: str, least: int, most: int) -> int:
        """A whole number."""
        value = self.value(key)
        if isinstance(value, bool) or not isinstance(value, int) or not least <= value <= most:
            raise self.fault(key, f"is {shown(value)}; allowed: a whole number, {least} to {most}")
        return value

    def number(self, key: str, default: Any = _REQUIRED) -> Any:
        """A finite number that has no unit."""
        value = self.value(key, default)
        if key in self._values:
            number = isinstance(value, int | float) and not isinstance(value, bool)
            if not number or not math.isfinite(value):
                raise self.fault(key, f"is {shown(value)}; allowed: a number")
        return value

    def quantity(self, key: str, *kinds: str, default: Any = _REQUIRED) -> Any:
        """A quantity in SI units; see `read_quantity`."""
        if key not in self._values:
            return self.value(key, default)
        return self._quantity(self._values[key], kinds, key)

    def above_zero(self, key: str, kind: str, default: Any = _REQUIRED) -> Any:
        """A quantity in SI units that is more than 0."""
        value = self.quantity(key, kind, default=default)
        if key in self._values and value <= 0.0:
            raise self.fault(key, f"is {shown(self._values[key])}; allowed: more than 0")
        return value

    def quantities(
        self,
        key: str,
        kinds: Sequence[str],
        default: Any = _REQUIRED,
        words: Mapping[str, float] = _NO_WORDS,
    ) -> Any:
        """A list of quantities, one of each of these kinds, or words that stand for one."""
        value = self.value(key, default)
        if key not in self._values:
            return value
        if not isinstance(value, list) or len(value) != len(kinds):
            wanted = f"a list of {len(kinds)}"
            raise self.fault(key, f"is {shown(value)}; allowed: {wanted}")
        listed = enumerate(zip(value, kinds, strict=True))
        return [
            words[each]
            if isinstance(each, str) and each in words
            else self._quantity(each, (kind,), key, number)
            for number, (each, kind) in listed
        ]

    def _quantity(self, value: object, kinds: Sequence[str], key: str, *within: int) -> float:
        try:
            return read_quantity(value, *kinds)
        except ValueError as error:
            raise self.fault(key, str(error), *within) from None

    def table(self, key: str) -> Table:
        """A table within this one; empty if there is none."""
        value = self._values.get(key, {})
        if not isinstance(value, Mapping):
            raise self.fault(key, f"is {shown(value)}; allowed: a table")
        return Table(value, (*self._where, key), self._document)

    def tables(self, key: str) -> list[Table]:
        """Tables of the same name, in order."""
        value = self._values.get(key, [])
        if not isinstance(value, list) or not all(isinstance(each, Mapping) for each in value):
            raise self.fault(key, f"is {shown(value)}; allowed: a list of tables, each begun by [[{key}]]")
        return [Table(each, (*self._where, key, i), self._document) for i, each in enumerate(value)]

    def part(self, *keys: str) -> Table:
        """The same table with some of its keys only."""
        return Table({k: v for k, v in self._values.items() if k in keys}, self._where, self._document)

    def in_si(self, kinds: Mapping[str, str]) -> dict[str, Any]:
        """What the table holds, as it is but for text in these keys, alone or listed: that is quantities."""
        plain = self.plain()
        for key, kind in kinds.items():
            value = plain.get(key)
            if isinstance(value, str):
                plain[key] = self.quantity(key, kind)
            elif isinstance(value, list) and any(isinstance(each, str) for each in value):
                plain[key] = self.quantities(key, [kind] * len(value))
        return plain

    def says(self, part: Part, plain: object) -> Part:
        """Remember how the file describes a part of the task; returns the part itself.

        Args:
            part: what was made of it.
            plain: the description, as plain data in SI units; paths in it are absolute, and a `Path` each.
        """
        self._document.described[part] = plain
        return part

    def plain(self) -> dict[str, Any]:
        """What the table holds, as it is."""
        return dict(self._values)

    def file(self, key: str, read: Callable[[Path], Made]) -> Made:
        """What a file holds that is named here; its path begins where the file lies that names it."""
        path = self.path(key, self.text(key))
        with self.blaming(key):
            return read(path)

    def path(self, key: str, name: str) -> Path:
        """A path that is named in the file; it begins where the file lies."""
        try:
            return self._document.path.parent / Path(name).expanduser()
        except RuntimeError as error:  # the home of somebody unknown
            raise self.fault(key, f"is {shown(name)}, which cannot be found ({error})") from None

    def place(self, key: str, name: str) -> Path:
        """The same, absolute."""
        return settled(self.path(key, name))


class Document:
    """A file that was read.

    Attributes:
        path: the file.
        root: what it holds.
        described: parts of the task that were made of it, and what it says of each; see `Table.says`.
    """

    def __init__(self, path: Path, content: Content | None = None) -> None:
        """Read a file.

        Args:
            path: the file.
            content: what it is to hold, if it is not to be read.
        """
        self.path = path
        self._content = read_content(path) if content is None else content
        self.root = Table(self._content.values, (), self)
        self.described: dict[Hashable, object] = {}

    @property
    def toml(self) -> str | None:
        """The text if the file is TOML; None if it is JSON."""
        return self._content.toml

    def line(self, where: Place) -> int | None:
        """The line of a place, or of what it is within; None if no line is known, as in JSON."""
        for end in range(len(where), 0, -1):
            if where[:end] in self._lines:
                return self._lines[where[:end]]
        return None

    def fault(self, where: Place, reason: str) -> FileError:
        """An error that says what is wrong at a place."""
        line, text = self.line(where), " ".join(reason.split())
        before = "" if line is None else f"line {line}: "
        return FileError(self.path, f"{before}{place_in_words(where)}: {text}")

    @cached_property
    def _lines(self) -> dict[Place, int]:
        return {} if self._content.toml is None else lines_of_toml(self._content.toml.replace("\r\n", "\n"))
