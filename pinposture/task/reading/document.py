"""A TOML or JSON file as tables that know where they stand in it, so that errors can say so."""

from __future__ import annotations

import math
from collections.abc import Callable, Hashable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from difflib import get_close_matches
from functools import cached_property
from pathlib import Path
from types import MappingProxyType
from typing import Any, TypeVar

from pinposture.errors import FileError, InvalidValue, PostureError
from pinposture.task.paths import settled
from pinposture.task.reading.content import Content, place_in_words, read_content
from pinposture.task.reading.lines import Place, lines_of_toml
from pinposture.task.reading.quantities import read_quantity
from pinposture.task.reading.showing import shown

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
        return {} if self._content.toml is None else lines_of_toml(self._content.toml)
