"""TOML and JSON files as plain data that knows its lines, so that errors can name them."""

from __future__ import annotations

import json
import math
import re
import sys
from collections.abc import Callable, Hashable, Iterator, Mapping
from contextlib import contextmanager
from functools import cached_property
from pathlib import Path
from types import MappingProxyType
from typing import Any, NamedTuple, TypeVar

from pydantic import TypeAdapter, ValidationError

from pinposture.errors import FileError, InvalidValue, PostureError
from pinposture.storage import read_text
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


# A file that was read, and where in it a mistake is.

Spec = TypeVar("Spec")
Made = TypeVar("Made")


class Misplaced(ValueError):
    """A mistake in a part of a value.

    Attributes:
        within: the way from the value to the part.
    """

    def __init__(self, reason: str, *within: str | int) -> None:
        super().__init__(reason)
        self.within = within


class Document:
    """A file that was read. What is wrong with it is told as a FileError that names the line, key and value.

    Attributes:
        path: the file.
        values: what it holds.
        described: parts of the task that were made of it, and what it says of each: plain data in SI units;
            paths in it are absolute, and a `Path` each.
    """

    def __init__(self, path: Path, content: Content | None = None) -> None:
        """Read a file.

        Args:
            path: the file.
            content: what it is to hold, if it is not to be read.
        """
        self.path = path
        self._content = read_content(path) if content is None else content
        self.values = self._content.values
        self.described: dict[Hashable, object] = {}

    @property
    def toml(self) -> str | None:
        """The text if the file is TOML; None if it is JSON."""
        return self._content.toml

    def at(self, where: Place) -> Any:
        """What the file holds at a place; None if there is nothing."""
        value: Any = self.values
        for key in where:
            there = key in value if isinstance(value, Mapping) else isinstance(key, int) and key < len(value)
            if not there:
                return None
            value = value[key]
        return value

    def read(self, kind: type[Spec] | Any, where: Place, context: Mapping[str, Any] | None = None) -> Spec:
        """What the file says at a place, an empty table if nothing, checked and in SI units.

        Args:
            kind: the specification that it has to be.
            where: the place.
            context: what the specification needs to know besides.
        """
        value = self.at(where)
        try:
            spec: Spec = TypeAdapter(kind).validate_python({} if value is None else value, context=context)
        except ValidationError as error:
            first = error.errors(include_url=False)[0]
            reason = f"is {shown(first['input'])}; allowed: {first['msg']}"
            cause = first.get("ctx", {}).get("error")
            inside: Place = tuple(key for key in first["loc"])
            if cause is not None:
                reason, inside = str(cause), (*inside, *getattr(cause, "within", ()))
            raise self.fault((*where, *inside), reason) from None
        return spec

    @contextmanager
    def blaming(self, where: Place, key: str | None = None) -> Iterator[None]:
        """Say of an error of the library that it is the fault of the key it names, or else of this one."""
        table = self.at(where)
        named = where if key is None else (*where, key)
        try:
            yield
        except InvalidValue as error:
            if not isinstance(table, Mapping) or error.name not in table:
                raise self.fault(named, str(error)) from error
            reason = f"is {shown(table[error.name])}; allowed: {error.allowed}"
            raise self.fault((*where, error.name), reason) from error
        except PostureError as error:
            raise self.fault(named, str(error)) from error

    def named(self, where: Place, name: str) -> Path:
        """A path that is named in the file; it begins where the file lies."""
        try:
            return self.path.parent / Path(name).expanduser()
        except RuntimeError as error:  # the home of somebody unknown
            raise self.fault(where, f"is {shown(name)}, which cannot be found ({error})") from None

    def file(self, where: Place, read: Callable[[Path], Made]) -> Made:
        """What a file holds that is named at a place."""
        path = self.named(where, self.at(where))
        try:
            return read(path)
        except PostureError as error:
            raise self.fault(where, str(error)) from error

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
