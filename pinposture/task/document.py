"""TOML and JSON files as plain data whose lines are known, so that errors can name them."""

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
from typing import Any, TypeVar

from pydantic import TypeAdapter, ValidationError

from pinposture.errors import FileError, InvalidValue, PostureError
from pinposture.storage import read_text
from pinposture.task.toml import Place, lines_of_toml

if sys.version_info >= (3, 11):
    import tomllib
else:
    import tomli as tomllib

# Values and keys as they appear in messages: on one line, and cut short.

MAX_SHOWN_CHARACTERS = 100


def shown(value: object) -> str:
    """Return a value in the notation of Python, cut short."""
    return _cut(repr(value))


def _shown_key(key: str) -> str:
    """Return a key as it is, or in quotes if it is blank or not printable."""
    return _cut(key if key.isprintable() and key.strip() == key != "" else repr(key))


def _cut(text: str) -> str:
    return text if len(text) <= MAX_SHOWN_CHARACTERS else text[: MAX_SHOWN_CHARACTERS - 4] + " ..."


def place_in_words(place: Place) -> str:
    """Name a place of a file, as in "keyframe 2, curve.radius"; list items count from 1."""
    words = ""
    for key in place:
        if isinstance(key, int):
            words = f"{words.removesuffix('s')} {key + 1}"
        else:
            between = "." if words and not words[-1].isdigit() else ", " if words else ""
            words += between + _shown_key(key)
    return _cut(words) or "the file"


# Quantities in a file: numbers in SI units, or text with a unit.

_LENGTHS = {"m": 1.0, "cm": 1e-2, "mm": 1e-3}
_ANGLES = {"rad": 1.0, "deg": math.pi / 180.0, "turns": 2.0 * math.pi}


def _per(units: Mapping[str, float], below: str) -> dict[str, float]:
    return {f"{unit}/{below}": factor for unit, factor in units.items()}


UNITS: Mapping[str, Mapping[str, float]] = MappingProxyType(
    {
        "length": _LENGTHS,
        "angle": _ANGLES,
        "time": {"s": 1.0, "ms": 1e-3, "min": 60.0},
        "speed": _per(_LENGTHS, "s"),
        "rate of turning": {**_per(_ANGLES, "s"), "rpm": math.pi / 30.0},
        "acceleration": _per(_LENGTHS, "s^2"),
        "rate of change of turning": _per(_ANGLES, "s^2"),
    }
)
"""Units by the kind of quantity, with the value of each in SI units."""

_QUANTITY = re.compile(r"\s*([-+]?(?:\d+\.?\d*|\.\d+)(?:[eE][-+]?\d+)?)\s*(\S.*?)?\s*")


def read_quantity(value: object, *kinds: str) -> float:
    """Read a quantity in SI units.

    Args:
        value: a number in SI units, or text as "25 mm".
        kinds: the kinds of quantity that are accepted, keys of `UNITS`.

    Raises:
        ValueError: anything else; says what is allowed.
    """
    known = ", ".join(unit for kind in kinds for unit in UNITS[kind])
    allowed = f"a number in SI units, or text with one of the units {known}"
    if isinstance(value, int | float) and not isinstance(value, bool):
        return _finite(float(value), value, allowed)
    found = _QUANTITY.fullmatch(value) if isinstance(value, str) else None
    if found is None:
        raise ValueError(f"is {shown(value)}; allowed: {allowed}")
    unit = (found[2] or "").replace("**", "^").replace("²", "^2").replace(" ", "").replace("/s/s", "/s^2")
    for kind in kinds:
        if unit in UNITS[kind]:
            return _finite(float(found[1]) * UNITS[kind][unit], value, allowed)
    what = f"and {shown(unit)} is no unit that is known" if unit else "without a unit"
    for kind, units in UNITS.items():
        if unit in units:
            what = f"of the kind {kind}"
    raise ValueError(f"is {shown(value)}, {what}; allowed: {allowed}")


def _finite(number: float, value: object, allowed: str) -> float:
    if not math.isfinite(number):
        raise ValueError(f"is {shown(value)}, which is not finite; allowed: {allowed}")
    return number


# Text parsed into plain data.

MAX_NESTING = 20
"""Largest depth of tables and lists within each other; three times what a task has."""

MAX_INTEGER_BITS = 64
"""Largest size of a whole number, as in TOML."""

_TOML_ERROR = re.compile(r"(.*) \(at (?:(line \d+, column \d+)|end of document)\)", re.DOTALL)


def check_format(path: Path) -> None:
    """Raise FileError unless the name ends in .toml or .json."""
    suffix = path.suffix.lower()
    if suffix not in (".toml", ".json"):
        raise FileError(path, f"the name ends in {suffix!r}; allowed: .toml, .json")


def _parsed(path: Path, text: str) -> dict[str, Any]:
    try:
        is_toml = path.suffix.lower() == ".toml"
        values = tomllib.loads(text) if is_toml else json.loads(text, object_pairs_hook=_unique_keys)
    except json.JSONDecodeError as error:
        raise FileError(path, f"line {error.lineno}, column {error.colno}: {error.msg}") from error
    except RecursionError:
        raise FileError(
            path, f"tables and lists are nested too deep; allowed: {MAX_NESTING} levels"
        ) from None
    except ValueError as error:
        message = " ".join(str(error).split())
        found = _TOML_ERROR.fullmatch(message)
        # The line comes first, as in all other messages.
        raise FileError(path, f"{found[2] or 'end of the file'}: {found[1]}" if found else message) from error
    if not isinstance(values, dict):
        raise FileError(path, "holds no table; allowed: keys and values, as in version = 1")
    _check_size(path, (), values)
    return values


def _unique_keys(pairs: list[tuple[str, Any]]) -> dict[str, Any]:
    """Return a JSON table; refuse a key that appears twice, of which JSON would take the last."""
    table = dict(pairs)
    if len(table) < len(pairs):
        keys = [key for key, _ in pairs]
        twice = next(key for key in keys if keys.count(key) > 1)
        raise ValueError(f"the key {_shown_key(twice)!r} appears twice in a table")
    return table


def _check_size(path: Path, place: Place, value: Any) -> None:
    """Refuse deep nesting and huge whole numbers, which would cost too much later."""
    if len(place) > MAX_NESTING:
        reason = f"is nested too deep; allowed: {MAX_NESTING} levels of tables and lists"
        raise FileError(path, f"{place_in_words(place)}: {reason}")
    if isinstance(value, int) and value.bit_length() > MAX_INTEGER_BITS:
        reason = f"is a whole number of more than {MAX_INTEGER_BITS} bits"
        raise FileError(path, f"{place_in_words(place)}: {reason}")
    if isinstance(value, Mapping | list):
        items = value.items() if isinstance(value, Mapping) else enumerate(value)
        for key, each in items:
            _check_size(path, (*place, key), each)


# A file that was read, and where in it a mistake is.

Spec = TypeVar("Spec")
Made = TypeVar("Made")


class Misplaced(ValueError):
    """A mistake in a part of a value.

    Attributes:
        within: the keys that lead from the value to the part.
    """

    def __init__(self, reason: str, *within: str | int) -> None:
        super().__init__(reason)
        self.within = within


class Document:
    """A file that was read; mistakes in it are reported as a FileError with the line, key and value.

    Attributes:
        path: the file.
        values: what it holds.
        toml: the text if the file is TOML; None if it is JSON.
        described: parts of the task that were made of it, and what it says of each: plain data in SI units;
            paths in it are absolute, and a `Path` each.
    """

    def __init__(self, path: Path, values: dict[str, Any], toml: str | None = None) -> None:
        self.path, self.values, self.toml = path, values, toml
        self.described: dict[Hashable, object] = {}

    @classmethod
    def load(cls, path: Path) -> Document:
        """Read a file.

        Raises:
            FileError: it is missing, unreadable, of another format, or as for `parse`.
        """
        check_format(path)
        return cls.parse(path, read_text(path))

    @classmethod
    def parse(cls, path: Path, text: str) -> Document:
        """Return the document that the file would be if this were its text.

        Raises:
            FileError: the text is malformed, or holds no table; names the line.
        """
        return cls(path, _parsed(path, text), text if path.suffix.lower() == ".toml" else None)

    def at(self, where: Place) -> Any:
        """Return the value at a place; None if there is none."""
        value: Any = self.values
        for key in where:
            there = key in value if isinstance(value, Mapping) else isinstance(key, int) and key < len(value)
            if not there:
                return None
            value = value[key]
        return value

    def read(self, kind: type[Spec] | Any, where: Place, context: Mapping[str, Any] | None = None) -> Spec:
        """Return the value at a place, checked and in SI units; an empty table stands for a missing one.

        Args:
            kind: the specification that it has to match.
            where: the place.
            context: what the validators of the specification need besides.
        """
        value = self.at(where)
        try:
            spec: Spec = TypeAdapter(kind).validate_python({} if value is None else value, context=context)
        except ValidationError as error:
            first = error.errors(include_url=False)[0]
            inside, cause = first["loc"], first.get("ctx", {}).get("error")
            if first["type"] == "missing":
                reason, inside = f"the key {inside[-1]!r} is missing", inside[:-1]
            elif cause is None:
                reason = f"is {shown(first['input'])}; allowed: {first['msg']}"
            else:
                reason, inside = str(cause), (*inside, *getattr(cause, "within", ()))
            raise self.fault((*where, *inside), reason) from None
        return spec

    @contextmanager
    def blaming(self, where: Place, key: str | None = None) -> Iterator[None]:
        """Report an error of the library at the key of a table that it names, or else at this key."""
        table = self.at(where)
        named = where if key is None else (*where, key)
        try:
            yield
        except PostureError as error:
            if isinstance(error, InvalidValue) and isinstance(table, Mapping) and error.name in table:
                reason = f"is {shown(table[error.name])}; allowed: {error.allowed}"
                raise self.fault((*where, error.name), reason) from error
            raise self.fault(named, str(error)) from error

    def named(self, where: Place, name: str) -> Path:
        """Return the path that the file names, relative to its own folder."""
        try:
            return self.path.parent / Path(name).expanduser()
        except RuntimeError as error:  # the home of an unknown user
            raise self.fault(where, f"is {shown(name)}, which cannot be found ({error})") from None

    def file(self, where: Place, read: Callable[[Path], Made]) -> Made:
        """Read the file that is named at a place."""
        path = self.named(where, self.at(where))
        with self.blaming(where):
            return read(path)

    def line(self, where: Place) -> int | None:
        """Return the line of a place, or of what contains it; None if no line is known, as in JSON."""
        for end in range(len(where), 0, -1):
            if where[:end] in self._lines:
                return self._lines[where[:end]]
        return None

    def fault(self, where: Place, reason: str) -> FileError:
        """Return an error that says what is wrong at a place."""
        line, text = self.line(where), " ".join(reason.split())
        before = "" if line is None else f"line {line}: "
        return FileError(self.path, f"{before}{place_in_words(where)}: {text}")

    @cached_property
    def _lines(self) -> dict[Place, int]:
        return {} if self.toml is None else lines_of_toml(self.toml.replace("\r\n", "\n"))
