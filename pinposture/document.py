"""Files in TOML and JSON that users write: their text, and the line of each value."""

from __future__ import annotations

import math
import re
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np
from pydantic import ValidationError

from pinposture._validation import require_instance
from pinposture.errors import FileError, PostureError, numbered
from pinposture.schema import (
    InFolder,
    KeyPath,
    Refusal,
    key_path_in_words,
    mistakes_of,
    read_as,
    refusing,
    shown_key,
)
from pinposture.storage import parse_json, parse_toml, read_text, relative, require_suffix
from pinposture.toml import Usual, lines_of_toml

# Text parsed into plain data.

SUFFIXES = (".toml", ".json")
"""Suffixes of task files and other documents."""

MAX_NESTING = 20
"""Largest depth of nested tables and lists; three times that of a task file."""


def _parsed(path: Path, text: str) -> dict[str, Any]:
    try:
        is_toml = path.suffix.lower() == ".toml"
        values = parse_toml(text) if is_toml else parse_json(path, text, object_pairs_hook=_unique_keys)
    except RecursionError:
        raise FileError(
            path, f"tables and lists are nested too deep; allowed: {MAX_NESTING} levels"
        ) from None
    except ValueError as error:
        message = " ".join(str(error).split())
        match = re.fullmatch(r"(.*) \(at (?:(line \d+, column \d+)|end of document)\)", message)
        # The line comes first, as in all other messages.
        raise FileError(path, f"{match[2] or 'end of the file'}: {match[1]}" if match else message) from error
    if not isinstance(values, dict):
        raise FileError(path, "contains no table; allowed: keys and values, as in version = 1")
    _check_size(path, (), values)
    return values


def _unique_keys(pairs: list[tuple[str, Any]]) -> dict[str, Any]:
    """Return a JSON table; refuse duplicate keys, of which JSON would use the last."""
    table = dict(pairs)
    if len(table) < len(pairs):
        keys = [key for key, _ in pairs]
        twice = next(key for key in keys if keys.count(key) > 1)
        raise ValueError(f"the key {shown_key(twice)!r} appears twice in a table")
    return table


def _check_size(path: Path, key_path: KeyPath, value: Any) -> None:
    """Refuse deep nesting and huge integers, which would be too expensive later."""
    if len(key_path) > MAX_NESTING:
        reason = f"is nested too deep; allowed: {MAX_NESTING} levels of tables and lists"
        raise FileError(path, f"{key_path_in_words(key_path)}: {reason}")
    most = 64  # as in TOML
    if isinstance(value, int) and value.bit_length() > most:
        reason = f"is a whole number of more than {most} bits"
        raise FileError(path, f"{key_path_in_words(key_path)}: {reason}")
    if isinstance(value, Mapping | list):
        items = value.items() if isinstance(value, Mapping) else enumerate(value)
        for key, item in items:
            _check_size(path, (*key_path, key), item)


class Document(InFolder):
    """A file; mistakes in it are reported as a FileError with the line, key and value.

    Attributes:
        path: the file.
        values: its contents.
        toml: the text if the file is TOML; None if it is JSON.
        changed: the key paths of values that are not those of the file.
        arm: the arm of a task, once it has been read.
        described: the description of each part of a task: plain data in SI units, with an absolute `Path`
            for each path.
    """

    def __init__(self, path: Path, values: dict[str, Any], toml: str | None = None) -> None:
        super().__init__(path.parent)
        self.path = path
        self.values = values
        self.toml = toml
        self.changed: set[KeyPath] = set()

    @classmethod
    def load(cls, path: Path) -> Document:
        """Read a file.

        Raises:
            FileError: it is missing, unreadable, of another format, or as for `parse`.
        """
        require_suffix(path, *SUFFIXES)
        return cls.parse(path, read_text(path))

    @classmethod
    def parse(cls, path: Path, text: str) -> Document:
        """Return the document of a file with this text.

        Raises:
            FileError: the text is malformed, or contains no table; names the line.
        """
        return cls(path, _parsed(path, text), text if path.suffix.lower() == ".toml" else None)

    def change(self, key: str, value: object) -> None:
        """Put another value in the place of one in the file, or where there was none.

        Args:
            key: its key path, as in "limits.velocity" or "keyframes.2.time"; list items count from 1.
            value: plain data.

        Raises:
            InvalidValue: a key that is not text.
            FileError: there is no such key path.
        """
        require_instance("key to change", key, str, 'text such as "limits.velocity"')
        key_path: KeyPath = tuple(int(part) - 1 if part.isdecimal() else part for part in key.split("."))
        inside: Any = self.values
        for depth, step in enumerate(key_path):
            listed = isinstance(inside, list) and isinstance(step, int) and 0 <= step < len(inside)
            if not listed and not (isinstance(inside, dict) and isinstance(step, str) and step):
                where = key_path_in_words(key_path[:depth])
                raise FileError(self.path, f"there is no {key!r} to change: nothing of that name in {where}")
            if depth == len(key_path) - 1:
                inside[step] = value
            elif not listed:
                inside = inside.setdefault(step, {})
            else:
                inside = inside[step]
        self.changed.add(key_path)

    def at(self, key_path: KeyPath) -> Any:
        """Return the value at a key path; None if there is none."""
        value: Any = self.values
        for key in key_path:
            there = key in value if isinstance(value, Mapping) else isinstance(key, int) and key < len(value)
            if not there:
                return None
            value = value[key]
        return value

    def read(self, kind: Any, key_path: KeyPath) -> Any:
        """Return the value at a key path as a declared class or an annotated type; a missing table is empty.

        Raises:
            FileError: all mistakes in it.
        """
        value = self.at(key_path)
        try:
            return read_as(kind, {} if value is None else value, self)
        except ValidationError as error:
            mistakes = mistakes_of(error)
            failure = self.together(
                [self.fault((*key_path, *inside), str(mistake)) for inside, mistake in mistakes]
            )
            raise failure from mistakes[0][1].__cause__

    def read_all(self, kinds: Mapping[str, Any]) -> dict[str, Any]:
        """Return the values of some keys, by key, as `read` does.

        Raises:
            FileError: all mistakes in all of them.
        """
        values: dict[str, Any] = {}
        errors: list[PostureError] = []
        for key, kind in kinds.items():
            try:
                values[key] = self.read(kind, (key,))
            except FileError as error:
                errors.append(error)
        if errors:
            raise self.together(errors)
        return values

    def together(self, errors: Sequence[PostureError]) -> FileError:
        """Return one error with all reasons of several."""
        listed = [reason for error in errors for reason in (error.reasons or (error,))]
        error = FileError(self.path, numbered([getattr(reason, "reason", str(reason)) for reason in listed]))
        error.reasons = tuple(listed) if len(listed) > 1 else ()
        return error

    @contextmanager
    def blaming(self, key_path: KeyPath) -> Iterator[None]:
        """Report an error of the library at the key of the table that it names, or at the table."""
        try:
            with refusing(self.at(key_path)):
                yield
        except Refusal as refusal:
            raise self.fault((*key_path, *refusal.within), str(refusal)) from refusal.__cause__

    def line(self, key_path: KeyPath) -> int | None:
        """Return the line of a key path, or of its parent; None if unknown, as in JSON, or changed."""
        for end in range(len(key_path), 0, -1):
            if key_path[:end] in self.changed:
                return None
            if key_path[:end] in self._lines:
                return self._lines[key_path[:end]]
        return None

    def fault(self, key_path: KeyPath, reason: str) -> FileError:
        """Return an error about a key path."""
        line = self.line(key_path)
        text = " ".join(reason.split())
        before = "" if line is None else f"line {line}: "
        return FileError(self.path, f"{before}{key_path_in_words(key_path)}: {text}")

    @cached_property
    def _lines(self) -> dict[KeyPath, int]:
        return {} if self.toml is None else lines_of_toml(self.toml.replace("\r\n", "\n"))


def plain_data(value: Any, folder: Path) -> Any:
    """Return plain data: relative paths, Python numbers, and integers without a decimal point."""
    if isinstance(value, Usual | bool | int | str):
        return value
    if isinstance(value, Path):
        return relative(value, folder)
    if isinstance(value, Mapping):
        return {key: plain_data(entry, folder) for key, entry in value.items()}
    if isinstance(value, list | tuple | np.ndarray):
        return [plain_data(entry, folder) for entry in value]
    number = float(value)
    whole = number.is_integer() and abs(number) < 1e15 and (number != 0.0 or math.copysign(1.0, number) > 0.0)
    return int(number) if whole else number
