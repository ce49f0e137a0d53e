"""Task files: their text, the line of each value, the arm, and descriptions of parts that still hold."""

from __future__ import annotations

import json
import math
import re
from collections.abc import Callable, Hashable, Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from dataclasses import replace
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np
from pydantic import ValidationError

from pinposture._validation import require_instance
from pinposture.arm import Arm, ArmSpec
from pinposture.arm.loading import description_text
from pinposture.arm.specification import MOST_MODULES_IN_FILE
from pinposture.arm.urdf_reader import load_text
from pinposture.collision import Scene
from pinposture.control import EndEffector
from pinposture.curve import Curve
from pinposture.errors import FileError, InvalidValue, PostureError, UnknownName, numbered, warn_caller
from pinposture.schema import (
    Place,
    Refusal,
    mistakes_of,
    place_in_words,
    read_as,
    refusing,
    shown,
    shown_key,
)
from pinposture.storage import (
    check_writable,
    parse_json,
    parse_toml,
    read_text,
    relative,
    require_suffix,
    settled,
)
from pinposture.task.toml import TomlLayout, Usual, drop_defaults, lines_of_toml, toml_text

# Text parsed into plain data.

TASK_SUFFIXES = (".toml", ".json")

MAX_NESTING = 20
"""Largest depth of nested tables and lists; three times that of a task."""

MAX_INTEGER_BITS = 64
"""Largest size of a whole number, as in TOML."""

_TOML_ERROR = re.compile(r"(.*) \(at (?:(line \d+, column \d+)|end of document)\)", re.DOTALL)


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
        found = _TOML_ERROR.fullmatch(message)
        # The line comes first, as in all other messages.
        raise FileError(path, f"{found[2] or 'end of the file'}: {found[1]}" if found else message) from error
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


def _check_size(path: Path, place: Place, value: Any) -> None:
    """Refuse deep nesting and huge integers, which would be too expensive later."""
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


class Document:
    """A file; mistakes in it are reported as a FileError with the line, key and value.

    Attributes:
        path: the file.
        values: its contents.
        toml: the text if the file is TOML; None if it is JSON.
        changed: the places of values that are not those of the file.
        arm: the arm, once it has been read.
        described: the description of each part of the task: plain data in SI units, with an absolute `Path`
            for each path.
    """

    arm: Any = None

    def __init__(self, path: Path, values: dict[str, Any], toml: str | None = None) -> None:
        self.path = path
        self.values = values
        self.toml = toml
        self.described: dict[Hashable, object] = {}
        self.changed: set[Place] = set()

    @classmethod
    def load(cls, path: Path) -> Document:
        """Read a file.

        Raises:
            FileError: it is missing, unreadable, of another format, or as for `parse`.
        """
        require_suffix(path, *TASK_SUFFIXES)
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
            key: its place, as in "limits.velocity" or "keyframes.2.time"; list items count from 1.
            value: plain data.

        Raises:
            InvalidValue: a key that is not text.
            FileError: there is no such place.
        """
        require_instance("key to change", key, str, 'text such as "limits.velocity"')
        place: Place = tuple(int(each) - 1 if each.isdecimal() else each for each in key.split("."))
        inside: Any = self.values
        for depth, each in enumerate(place):
            listed = isinstance(inside, list) and isinstance(each, int) and 0 <= each < len(inside)
            if not listed and not (isinstance(inside, dict) and isinstance(each, str) and each):
                where = place_in_words(place[:depth])
                raise FileError(self.path, f"there is no {key!r} to change: nothing of that name in {where}")
            if depth == len(place) - 1:
                inside[each] = value
            elif not listed:
                inside = inside.setdefault(each, {})
            else:
                inside = inside[each]
        self.changed.add(place)

    def at(self, where: Place) -> Any:
        """Return the value at a place; None if there is none."""
        value: Any = self.values
        for key in where:
            there = key in value if isinstance(value, Mapping) else isinstance(key, int) and key < len(value)
            if not there:
                return None
            value = value[key]
        return value

    def read(self, kind: Any, where: Place) -> Any:
        """Return the value at a place as a declared class or an annotated type; a missing table is empty.

        Raises:
            FileError: all mistakes in it.
        """
        value = self.at(where)
        try:
            return read_as(kind, {} if value is None else value, self)
        except ValidationError as error:
            mistakes = mistakes_of(error)
            failure = self.together([self.fault((*where, *inside), str(each)) for inside, each in mistakes])
            raise failure from mistakes[0][1].__cause__

    def read_all(self, kinds: Mapping[str, Any]) -> dict[str, Any]:
        """Return the values of some keys, by key, as `read` does.

        Raises:
            FileError: all mistakes in all of them.
        """
        found: dict[str, Any] = {}
        errors: list[PostureError] = []
        for key, kind in kinds.items():
            try:
                found[key] = self.read(kind, (key,))
            except FileError as error:
                errors.append(error)
        if errors:
            raise self.together(errors)
        return found

    def together(self, errors: Sequence[PostureError]) -> FileError:
        """Return one error with all reasons of several."""
        listed = [each for error in errors for each in (error.reasons or (error,))]
        error = FileError(self.path, numbered([getattr(each, "reason", str(each)) for each in listed]))
        error.reasons = tuple(listed) if len(listed) > 1 else ()
        return error

    @contextmanager
    def blaming(self, where: Place) -> Iterator[None]:
        """Report an error of the library at the key of the table that it names, or at the table."""
        try:
            with refusing(self.at(where)):
                yield
        except Refusal as refusal:
            raise self.fault((*where, *refusal.within), str(refusal)) from refusal.__cause__

    def resolve(self, name: str) -> Path:
        """Return a path named in the file, relative to its folder; raise ValueError if there is none."""
        try:
            return self.path.parent / Path(name).expanduser()
        except RuntimeError as error:  # the home of an unknown user
            raise ValueError(f"is {shown(name)}, which cannot be found ({error})") from None

    def line(self, where: Place) -> int | None:
        """Return the line of a place, or of its parent; None if unknown, as in JSON, or changed."""
        for end in range(len(where), 0, -1):
            if where[:end] in self.changed:
                return None
            if where[:end] in self._lines:
                return self._lines[where[:end]]
        return None

    def fault(self, where: Place, reason: str) -> FileError:
        """Return an error about a place."""
        line = self.line(where)
        text = " ".join(reason.split())
        before = "" if line is None else f"line {line}: "
        return FileError(self.path, f"{before}{place_in_words(where)}: {text}")

    @cached_property
    def _lines(self) -> dict[Place, int]:
        return {} if self.toml is None else lines_of_toml(self.toml.replace("\r\n", "\n"))


# Descriptions of parts of a task, as far as they are still valid.


class Descriptions:
    """The file to be written, and the descriptions of parts of a task in it.

    Attributes:
        file: the file.
        folder: its folder, to which paths are relative.
        arm: the arm of the task.
        scene: its scene.
        just_read: whether the descriptions come from this file, and need no test.
    """

    def __init__(self, file: Path, task: Any, just_read: bool = False) -> None:
        self.file = file
        self.folder = file.parent
        self.arm = task.arm
        self.scene = task.scene
        self.just_read = just_read
        self._described: Mapping[Hashable, object] = task.described

    def find(self, part: Hashable, kind: Any) -> Any:
        """Return the known description of a part if it still describes that part; otherwise None.

        Args:
            part: the part.
            kind: what a description is read as.
        """
        if part not in self._described:
            return None
        plain = plain_data(self._described[part], self.folder)

        def gives_part() -> bool:
            document = Document(self.file, {"part": plain})
            document.arm = self.arm
            return bool(document.read(kind, ("part",)) == part)

        named = {Curve: "curve", EndEffector: "tip", Scene: "scene"}
        return plain if self.still_holds(named.get(type(part), "obstacle"), plain, gives_part) else None

    def still_holds(self, key: str, plain: object, test: Callable[[], bool]) -> bool:
        """Test a description; warn if it is no longer valid."""
        if self.just_read:
            return True
        reason = "which has changed since"
        try:
            if test():
                return True
        except PostureError as error:
            reason = f"but {getattr(error, 'reason', error)}"
        warn_caller(f"{self.file}: {key} was {shown(plain)}, {reason}; it is written out")
        return False


def plain_data(value: Any, folder: Path) -> Any:
    """Return plain data: relative paths, Python numbers, and integers without a decimal point."""
    if isinstance(value, Usual | bool | int | str):
        return value
    if isinstance(value, Path):
        return relative(value, folder)
    if isinstance(value, Mapping):
        return {key: plain_data(each, folder) for key, each in value.items()}
    if isinstance(value, list | tuple | np.ndarray):
        return [plain_data(each, folder) for each in value]
    number = float(value)
    whole = number.is_integer() and abs(number) < 1e15 and (number != 0.0 or math.copysign(1.0, number) > 0.0)
    return int(number) if whole else number


# The arm: its specification, with a URDF file next to the task if necessary.


def read_arm(document: Document) -> Arm:
    """Return the arm of a task file: a URDF file, or modules of a template, possibly on a feed."""
    spec = document.read(ArmSpec, ("arm",))
    try:
        return Arm.from_spec(spec)
    except PostureError as error:
        table = document.at(("arm",))
        key = _key_of(error, table)
        reason = str(error)
        if isinstance(error, InvalidValue) and key in table:
            value = error.value if key == "split" else table[key]
            reason = f"is {shown(value)}; allowed: {error.allowed}"
        raise document.fault(("arm", key) if key else ("arm",), reason) from error


def _key_of(error: PostureError, table: Mapping[str, Any]) -> str:
    """Return the key to which an error of `Arm.from_spec` refers; empty for the whole table."""
    if isinstance(error, InvalidValue):
        key = "split" if error.name.startswith("modules") and "urdf" in table else error.name
        if key in table:
            return key
    if isinstance(error, UnknownName):
        for key in ("base", "tip", "split", "locked", "couplings", "xacro_args"):
            value = table.get(key)
            if error.name == value or (isinstance(value, list | dict) and error.name in value):
                return key
    return "urdf" if "urdf" in table else ""


def write_arm(arm: Arm, descriptions: Descriptions) -> tuple[ArmSpec, Path | None]:
    """Describe an arm by its specification.

    Returns:
        The specification, and the URDF file to write next to the task, if any.

    Raises:
        FileError: the arm was made from a Pinocchio model, or its URDF file would overwrite another.
    """
    spec = arm.spec
    if spec is None or arm.urdf is None or arm.report is None:
        reason = "it was made from a Pinocchio model and has no URDF; load it with Arm.load"
        raise FileError(descriptions.file, f"arm: no file can describe it: {reason}")
    if spec.template is not None and spec.modules is not None and spec.modules > MOST_MODULES_IN_FILE:
        spec = ArmSpec(
            urdf=arm.urdf,
            split=arm.report.segmentation.sizes,
            placement=spec.placement,
            characteristic_length=spec.characteristic_length,
        )
    source = spec.urdf
    folders = spec.package_dirs
    arguments = spec.xacro_args
    if source is None:
        return spec, None
    if isinstance(source, Path):
        name = relative(source, descriptions.folder)

        def gives_arm() -> bool:
            return description_text(source, folders, arguments) == arm.urdf

        if descriptions.still_holds("arm", name, gives_arm):
            return spec, None
    file = settled(descriptions.file.with_suffix(".urdf"))
    searched = [Path(each) for each in arm.report.package_dirs if settled(each) != file.parent]
    spec = replace(spec, urdf=file, package_dirs=tuple(searched), xacro_args={})
    if not file.exists():
        return spec, file
    if load_text(file)[0] != arm.urdf:
        reason = "exists already, and differs from the arm of the task"
        raise FileError(file, f"{reason}; save the task under another name")
    return spec, None


# The text.


@contextmanager
def folder_of(path: Path) -> Iterator[None]:
    """Create the folder of a file; remove it again if writing fails.

    Raises:
        FileError: the file cannot be created: a name that is too long, a null byte, circular links, ...
    """
    new: list[Path] = []
    try:
        check_writable(path.parent)
        new = [each for each in (path.parent, *path.parents) if not each.exists()]
        path.parent.mkdir(parents=True, exist_ok=True)
        yield
    except BaseException as error:
        for each in new:
            with suppress(OSError):
                each.rmdir()
        if isinstance(error, PostureError) or not isinstance(error, OSError | RuntimeError | ValueError):
            raise
        reason = getattr(error, "strerror", None) or error
        raise FileError(path, f"cannot be written ({reason})") from error


def document_text(
    path: Path,
    contents: Mapping[str, Any],
    layout: TomlLayout | None,
    check: Callable[[str], None],
) -> str:
    """Return the text of a task file; with the layout if possible.

    Args:
        path: the file, .toml or .json.
        contents: its values, as plain data with `Usual` for defaults.
        layout: the TOML file whose comments and layout are preserved.
        check: raises FileError unless a text reads back as the task.

    Raises:
        FileError: no text reads back as the task.
    """
    if path.suffix.lower() == ".json":
        text = json.dumps(drop_defaults(contents), indent=2, ensure_ascii=False, allow_nan=False) + "\n"
    else:
        if layout is not None:
            text = toml_text(contents, layout)
            with suppress(FileError):
                check(text)
                return text
            warn_caller(f"{path}: its comments and layout could not be kept")
        text = toml_text(contents)
    check(text)
    return text
