"""Declarations: quantities with units, kinds of values, and the classes that a user describes with them.

A class that is read from files is declared once, as a dataclass whose annotations say what each value may
be. Python calls and files go through the same annotations. They differ in `ValidationInfo.context`: None in
a call, an `InputFile` in a file. A validator raises a `Refusal`; a call turns it into a `PostureError` that
names the argument, a reader of files adds line and key.
"""

from __future__ import annotations

import dataclasses
import functools
import inspect
import math
import re
from collections.abc import Callable, Collection, Hashable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from copy import copy
from functools import cache, partial
from pathlib import Path
from types import MappingProxyType
from typing import (
    Annotated,
    Any,
    NamedTuple,
    Protocol,
    TypeVar,
    cast,
    get_args,
    get_type_hints,
)

import numpy as np
import pydantic
from pydantic import (
    BeforeValidator,
    ConfigDict,
    GetCoreSchemaHandler,
    PlainValidator,
    TypeAdapter,
    ValidationError,
    ValidationInfo,
    model_validator,
)
from pydantic_core import ArgsKwargs, CoreSchema, to_jsonable_python
from typing_extensions import ParamSpec, Self, dataclass_transform

from pinposture._validation import (
    LARGEST_NUMBER,
    SMALLEST_NUMBER,
    as_number,
    is_number,
    is_usable,
    require_positive,
    require_whole,
)
from pinposture.errors import InvalidValue, PostureError, UnknownName, did_you_mean

# Values and keys in messages: on one line, truncated.


KeyPath = tuple[str | int, ...]
"""The path to a value in a file: keys, and indices of list items from 0."""


def shown(value: object) -> str:
    """Return the representation of a value, truncated."""
    try:
        return _cut(repr(value))
    except ValueError:
        return "a number of thousands of digits"


def shown_key(key: str) -> str:
    """Return a key as it is, or in quotes if it is blank or not printable."""
    return _cut(key if key.isprintable() and key.strip() == key != "" else repr(key))


def _cut(text: str) -> str:
    return text if len(text) <= 100 else text[:96] + " ..."


def key_path_in_words(key_path: KeyPath) -> str:
    """Describe a key path in a file, as in "keyframe 2, curve.radius"; list items count from 1."""
    words = ""
    for key in key_path:
        if isinstance(key, int):
            words = f"{words.removesuffix('s')} {key + 1}"
        else:
            between = "." if words and not words[-1].isdigit() else ", " if words else ""
            words += between + shown_key(key)
    return _cut(words) or "the file"


# Mistakes.


class Refusal(ValueError):
    """A mistake in a value or a part of it.

    Attributes:
        within: the keys from the value to the part.
        error: what a Python call raises; None for an error made of name, value and reason.
    """

    def __init__(self, reason: str, *within: str | int, error: PostureError | None = None) -> None:
        super().__init__(reason)
        self.within: KeyPath = within
        self.error = error


class Refusals(ValueError):
    """Several mistakes in a value.

    Attributes:
        all: the mistakes.
    """

    def __init__(self, mistakes: Sequence[Refusal]) -> None:
        super().__init__(*mistakes)
        self.all = tuple(mistakes)


class NotAllowed(Refusal):
    """A value that is not among the allowed ones.

    Attributes:
        hint: what more is said of the value.
        value: the value.
        allowed: what is allowed.
    """

    def __init__(self, value: object, allowed: str, *within: str | int, hint: str = "") -> None:
        super().__init__(f"is {shown(value)}{hint}; allowed: {allowed}", *within)
        self.hint = hint
        self.value = value
        self.allowed = allowed


@contextmanager
def refusing(table: object = None, key: str | int | None = None) -> Iterator[None]:
    """Turn errors of the library into refusals, at the key of a table that they name, or at `key`."""
    try:
        yield
    except PostureError as error:
        refusal = _refusal(error, table)
        if key is not None and not refusal.within:
            refusal.within = (key,)
        raise refusal from error


Read = TypeVar("Read")


def read_within(key: str | int, read: Callable[..., Read], *arguments: Any) -> Read:
    """Return what `read` returns; report its mistakes at this key."""
    try:
        return read(*arguments)
    except ValueError as error:
        mistakes = [_refusal(reason, None) for reason in getattr(error, "all", (error,))]
        raise _joined([((key, *mistake.within), mistake) for mistake in mistakes]) from None


def mistakes_of(error: ValidationError) -> list[tuple[KeyPath, Refusal]]:
    """Return key path and reason of each mistake that validators found."""
    return [each for found in error.errors(include_url=False) for each in _mistakes(found)]


def _mistakes(found: Mapping[str, Any]) -> list[tuple[KeyPath, Refusal]]:
    inside: KeyPath = found["loc"]
    cause = found.get("ctx", {}).get("error")
    if found["type"] == "missing":
        return [(inside[:-1], Refusal(f"the key {inside[-1]!r} is missing"))]
    if cause is None:
        allowed = "the path of a file" if found["type"] == "path_type" else found["msg"]
        return [(inside, NotAllowed(found["input"], allowed))]
    listed = [_refusal(reason, found["input"]) for reason in getattr(cause, "all", (cause,))]
    return [((*inside, *reason.within), reason) for reason in listed]


def _refusal(cause: Exception, table: object) -> Refusal:
    """Return a mistake as a refusal; that of a check of several values is at the one that it names."""
    if isinstance(cause, Refusal):
        return cause
    if isinstance(cause, InvalidValue) and isinstance(table, Mapping) and cause.name in table:
        return NotAllowed(table[cause.name], cause.allowed, cause.name)
    if isinstance(cause, InvalidValue) and cause.value is table and table is not None:
        return NotAllowed(table, cause.allowed)
    return Refusal(str(cause), error=cause if isinstance(cause, PostureError) else None)


def error_of(key_path: KeyPath, refusal: Refusal) -> PostureError:
    """Return the error of a mistake at a key path, for a reader that has no file to name."""
    name = key_path_in_words(key_path) if key_path else "description"
    if isinstance(refusal.error, UnknownName) and len(key_path) == 1:
        return refusal.error
    if isinstance(refusal, NotAllowed) and not isinstance(refusal.error, UnknownName):
        invalid = InvalidValue(name, refusal.value, refusal.allowed)
        invalid.args = (f"{name} {refusal}",) if refusal.hint else invalid.args
        return invalid
    failure = copy(refusal.error or InvalidValue(name, None, str(refusal)))
    failure.args = (f"{name}: {refusal}" if key_path else str(refusal),)
    return failure


def _joined(mistakes: Sequence[tuple[KeyPath, Refusal]]) -> Refusal | Refusals:
    """Return mistakes in a value, each with the keys to its part, as one exception."""
    for key_path, reason in mistakes:
        reason.within = key_path
    reasons = [reason for _, reason in mistakes]
    return reasons[0] if len(reasons) == 1 else Refusals(reasons)


# Quantities: numbers in SI units, or text with a unit.

_LENGTHS = {"m": 1.0, "cm": 1e-2, "mm": 1e-3}
_MASSES = {"kg": 1.0, "g": 1e-3, "t": 1e3}
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
        "jerk": _per(_LENGTHS, "s^3"),
        "jerk of turning": _per(_ANGLES, "s^3"),
        "mass": _MASSES,
        "mass per length": _per(_MASSES, "m"),
        "moment of inertia": {"kgm^2": 1.0},
        "torque": {"Nm": 1.0, "Ncm": 1e-2, "mNm": 1e-3, "kNm": 1e3},
        "force": {"N": 1.0, "mN": 1e-3, "kN": 1e3},
        "stiffness of turning": {"Nm/rad": 1.0, "Nm/deg": 180.0 / math.pi, "kNm/rad": 1e3},
        "stiffness": {"N/m": 1.0, "N/mm": 1e3, "kN/m": 1e3},
    }
)
"""Units by kind of quantity, with their values in SI units."""


def read_quantity(value: object, *kinds: str) -> float:
    """Read a quantity in SI units.

    Args:
        value: a number in SI units, or text such as "25 mm".
        kinds: the accepted kinds of quantity, keys of `UNITS`.

    Raises:
        NotAllowed: anything else.
    """
    if is_usable(value):
        return float(cast(float, value))
    known = ", ".join(unit for kind in kinds for unit in UNITS[kind])
    allowed = f"a number in SI units, or text with one of the units {known}"
    if is_number(value):
        raise NotAllowed(value, allowed, hint=_beyond(value))
    number_and_unit = r"\s*([-+]?(?:\d+\.?\d*|\.\d+)(?:[eE][-+]?\d+)?)\s*(\S.*?)?\s*"
    match = re.fullmatch(number_and_unit, value) if isinstance(value, str) else None
    if match is None:
        raise NotAllowed(value, allowed)
    unit = (match[2] or "").replace("**", "^").replace("²", "^2").replace(" ", "").replace("/s/s", "/s^2")
    for kind in kinds:
        if unit in UNITS[kind]:
            number = float(match[1]) * UNITS[kind][unit]
            if not is_usable(number):
                raise NotAllowed(value, allowed, hint=_beyond(number))
            return number
    what = f"and {shown(unit)} is not a known unit" if unit else "without a unit"
    for kind, units in UNITS.items():
        if unit in units:
            what = f"of the kind {kind}"
    raise NotAllowed(value, allowed, hint=f", {what}")


def _beyond(number: Any) -> str:
    return ", which is too large" if -math.inf < number < math.inf else ", which is not finite"


# Kinds of values.


class InputFile(Protocol):
    """The file from which values are read.

    Attributes:
        arm: the arm of the task, if it is known.
        described: what `described` of a task is made of: the description of each part that has one.
    """

    arm: Any
    described: dict[Hashable, object]

    def resolve(self, name: str) -> Path:
        """Return a path named in the file, relative to its folder; raise ValueError if there is none."""


class OutputFile(Protocol):
    """The file to which values are written.

    Attributes:
        arm: the arm of the task.
        scene: its scene.
        embeds: whether points that were loaded from files are written, rather than the names of these files.
    """

    arm: Any
    scene: Any
    embeds: bool

    def find(self, part: Hashable, kind: Any) -> Any:
        """Return the known description of a part, read as `kind`, if it still holds; otherwise None."""


class WrittenBy(NamedTuple):
    """Annotation of values that a function writes to files."""

    write: Callable[[Any, OutputFile], object]


def in_file(info: ValidationInfo) -> InputFile | None:
    """Return the file from which a value is read; None in a Python call."""
    return cast("InputFile | None", info.context)


def read_by(read: Callable[[Any, ValidationInfo], object]) -> PlainValidator:
    """Read values by a function alone."""
    return PlainValidator(read)


AS_GIVEN = read_by(lambda value, _: value)
"""Annotation of values that a class checks together."""


def check(test: Callable[[Any], bool], allowed: str) -> PlainValidator:
    """Refuse values for which a test does not hold."""

    def read(value: object, _: ValidationInfo) -> object:
        if not test(value):
            raise NotAllowed(value, allowed)
        return value

    return read_by(read)


@dataclasses.dataclass(frozen=True)
class CheckedBy:
    """Annotation of values that a check of arguments reads.

    Attributes:
        test: given the name and the value, it returns what is read or raises a `PostureError`.
        kind: the kind of quantity that text is, alone or listed; empty: text is not read.
    """

    test: Callable[[str, Any], object]
    kind: str = ""

    def __get_pydantic_core_schema__(self, source: Any, handler: GetCoreSchemaHandler) -> CoreSchema:
        reader = read_by(lambda value, info: self.read(str(info.field_name), value))
        return reader.__get_pydantic_core_schema__(source, handler)

    def read(self, name: str, value: object) -> object:
        """Read a value; raise a `Refusal` or an error of the check that is about several parts."""
        plain = read_units(value, self.kind) if self.kind else value
        try:
            return self.test(name, plain)
        except InvalidValue as error:
            part = re.fullmatch(r"\[(\d+)\]", error.name.removeprefix(name))
            if part is not None:
                raise NotAllowed(error.value, error.allowed, int(part[1])) from None
            if error.value is not plain:
                raise
            raise NotAllowed(value, error.allowed) from None


def checked_number(allowed: str, test: Callable[[float], bool], kind: str = "") -> CheckedBy:
    """Read a number for which a test holds; `kind`: as of `CheckedBy`."""
    return CheckedBy(partial(as_number, allowed=allowed, test=test), kind)


def one_of(what: str, *words: str) -> PlainValidator:
    """Refuse anything but some words; in Python with `UnknownName`, which calls it `what`."""
    return read_by(lambda value, _: read_word(value, words, what))


def read_word(value: object, words: Collection[str], what: str = "") -> str:
    """Return one of some words."""
    if not isinstance(value, str) or value not in words:
        refusal = NotAllowed(value, ", ".join(map(repr, words)), hint=did_you_mean(value, words))
        refusal.error = UnknownName(what, value, words)
        raise refusal
    return value


def quantity(
    *kinds: str,
    above: float | None = None,
    least: float | None = None,
    most: float = math.inf,
) -> PlainValidator:
    """Read a quantity of one of some kinds, within bounds."""
    return read_by(lambda value, _: read_bounded(value, kinds, above, least, most))


def read_bounded(
    value: object,
    kinds: Sequence[str],
    above: float | None = None,
    least: float | None = None,
    most: float = math.inf,
) -> float:
    """Read a quantity: more than `above`, at least `least`, at most `most`."""
    number = read_quantity(value, *kinds)
    if above is not None and number <= above:
        raise NotAllowed(value, f"more than {above:g}")
    if least is not None and number < least:
        raise NotAllowed(value, f"a finite number >= {least:g}")
    if number > most:
        unit = next(iter(UNITS[kinds[0]]))
        raise NotAllowed(value, f"{most:g} {unit} at most")
    if 0.0 < abs(number) < SMALLEST_NUMBER and above is not None:
        raise NotAllowed(value, f"{SMALLEST_NUMBER:g} to {LARGEST_NUMBER:g}")
    return number


def quantities(kind: str, count: int) -> PlainValidator:
    """Read a list of quantities of one kind."""
    return read_by(lambda value, _: read_quantities(value, [kind] * count))


UNLIMITED_WORD = "none"
"""The word for no limit, beside an infinite number."""


def read_quantities(value: object, kinds: Sequence[str], unlimited: bool = False) -> tuple[float, ...]:
    """Read a list of quantities, one of each kind; `unlimited`: `UNLIMITED_WORD` stands for infinity."""
    values = value.tolist() if isinstance(value, np.ndarray) else value
    if not isinstance(values, list | tuple) or len(values) != len(kinds):
        raise NotAllowed(value, f"a list of {len(kinds)}")
    return tuple(
        math.inf
        if unlimited and entry in (UNLIMITED_WORD, math.inf)
        else read_within(index, read_quantity, entry, kind)
        for index, (entry, kind) in enumerate(zip(values, kinds, strict=True))
    )


def read_units(value: object, kind: str) -> object:
    """Return a value with text, alone or listed, as quantities; any other value as it is."""
    if isinstance(value, str):
        return read_quantity(value, kind)
    if isinstance(value, list | tuple) and any(isinstance(entry, str) for entry in value):
        return list(read_quantities(value, [kind] * len(value)))
    return value


def in_si(table: Mapping[str, Any], reader: Any) -> dict[str, Any]:
    """Read the text in a table as the quantities that a class or function declares; keep other values."""
    kinds = {key: check.kind for key, check in _annotations(reader, CheckedBy).items() if check.kind}
    return {
        key: read_within(key, read_units, value, kinds[key]) if key in kinds else value
        for key, value in table.items()
    }


def is_text(value: object) -> bool:
    """Whether a value is text."""
    return isinstance(value, str)


def is_table(value: object) -> bool:
    """Whether a value is a table."""
    return isinstance(value, Mapping)


def is_list_of(test: Callable[[object], bool]) -> Callable[[object], bool]:
    """Return the test whether a value is a list or tuple of what passes a test."""
    return lambda value: isinstance(value, list | tuple) and all(map(test, value))


def is_file_name(value: object) -> bool:
    """Whether a value is text that can be the name of a file."""
    return isinstance(value, str) and bool(value.strip()) and "\0" not in value


def _read_table(value: object, in_call: bool = False) -> Mapping[str, Any]:
    if not isinstance(value, Mapping):
        raise NotAllowed(value, "a mapping" if in_call else "a table")
    return value


def read_keys(value: object, keys: Collection[str]) -> Mapping[str, Any]:
    """Return a table that has no other keys than these."""
    table = _read_table(value)
    unknown = [unknown_key(key, keys) for key in table if key not in keys]
    if unknown:
        raise Refusals(unknown)
    return table


def _read_flag(value: object, _: ValidationInfo) -> bool:
    if not isinstance(value, bool | np.bool_):
        raise NotAllowed(value, "true or false")
    return bool(value)


Text = Annotated[str, check(is_text, "text")]
Flag = Annotated[bool, read_by(_read_flag)]
Number = Annotated[float, check(is_usable, "a number")]
PositiveNumber = Annotated[float, CheckedBy(require_positive)]
Count = Annotated[int, CheckedBy(partial(require_whole, least=1))]
WholeNumber = Annotated[int, CheckedBy(partial(require_whole, least=0))]
Length = Annotated[float, quantity("length", above=0.0)]
AnyLength = Annotated[float, quantity("length")]
Angle = Annotated[float, quantity("angle")]
Time = Annotated[float, quantity("time", least=0.0)]
Duration = Annotated[float, quantity("time", above=0.0)]
Speed = Annotated[float, quantity("speed", above=0.0)]
Position = Annotated[tuple[float, ...], quantities("length", 3)]
Rotation = Annotated[tuple[float, ...], quantities("angle", 3)]
JointDistance = Annotated[float, quantity("angle", "length", least=0.0)]
"""A distance of joint positions [rad or m]."""
Table = BeforeValidator(lambda value, info: _read_table(value, in_call=in_file(info) is None))

# Declared classes.

Class = TypeVar("Class")
Annotation = TypeVar("Annotation")


@dataclass_transform(frozen_default=True, field_specifiers=(dataclasses.field,))
def declared(*, eq: bool = True) -> Callable[[type[Class]], type[Class]]:
    """Make a frozen dataclass whose values are read as its annotations say.

    A call raises a `PostureError` for the first value that is refused.
    """

    def declare(cls: type[Class]) -> type[Class]:
        config = ConfigDict(arbitrary_types_allowed=True, extra="forbid")
        made: Any = pydantic.dataclasses.dataclass(frozen=True, eq=eq, config=config)(cls)
        read = made.__init__
        names = [field.name for field in dataclasses.fields(made) if field.init]

        @functools.wraps(read)
        def __init__(self: object, *arguments: Any, **named: Any) -> None:
            # By name: pydantic has another order than Python where a base that is no dataclass names fields.
            options = dict(zip(names, arguments, strict=False))
            try:
                read(self, *arguments[len(names) :], **options, **named)
            except ValidationError as error:
                failure = _error_of_call(made, names, error)
                subject = made.subject({**options, **named})
                if subject:
                    failure.args = (f"{subject}: {failure}",)
                raise failure from None

        made.__init__ = __init__
        return cast("type[Class]", made)

    return declare


def _error_of_call(kind: type, names: Sequence[str], error: ValidationError) -> Exception:
    mistake = error.errors(include_url=False)[0]
    if mistake["type"] == "multiple_argument_values":
        return TypeError(f"{kind.__name__} has {len(names)} arguments: {', '.join(names)}")
    if mistake["type"] in ("missing", "unexpected_keyword_argument"):
        what = mistake["type"].partition("_")[0]
        return TypeError(f"{kind.__name__}: {what} argument {mistake['loc'][-1]!r}")
    cause = mistake.get("ctx", {}).get("error")
    if isinstance(cause, PostureError):
        return cause
    key_path, refusal = _mistakes(mistake)[0]
    if refusal.error is not None:
        return refusal.error
    first, *rest = key_path or (kind.__name__,)
    name = names[first] if isinstance(first, int) else first
    name += "".join(f"[{key}]" if isinstance(key, int) else f".{key}" for key in rest)
    if isinstance(refusal, NotAllowed):
        return InvalidValue(name, refusal.value, refusal.allowed)
    return InvalidValue(name, mistake["input"], str(refusal))


@declared()
class Declared:
    """Base of declared classes: read from tables of files, and written to them."""

    @classmethod
    def subject(cls, values: Mapping[str, Any]) -> str:
        """Return what errors of a call begin with, given its arguments."""
        return ""

    @classmethod
    def check_keys(cls, values: Mapping[str, Any]) -> Collection[str]:
        """Refuse keys that exclude each other; return the allowed ones."""
        return _fields(cast(Any, cls))

    @classmethod
    def from_table(cls, values: Mapping[str, Any], source: InputFile) -> Mapping[str, Any]:
        """Return the values of fields, given a table whose keys are known."""
        return values

    def remember(self, values: Mapping[str, Any], source: InputFile) -> None:
        """Note how a file describes this, where that cannot be told from its values."""

    def to_table(self, file: OutputFile) -> dict[str, Any]:
        """Return the table: the values of fields as written, without defaults."""
        return self.written(file)

    def written(self, file: OutputFile) -> dict[str, Any]:
        """Return the values of fields that differ from their defaults, as a file contains them."""
        table = {}
        kind = cast(Any, type(self))
        writers = _annotations(kind, WrittenBy)
        for key, default in _fields(kind).items():
            value = getattr(self, key)
            if isinstance(value, np.ndarray) or value != default:
                table[key] = writers[key].write(value, file) if key in writers else write_parts(value, file)
        return table

    @model_validator(mode="wrap")
    @classmethod
    def _read(cls, values: Any, make: Callable[[Any], Self], info: ValidationInfo) -> Self:
        if isinstance(values, cls | ArgsKwargs):
            return make(values)
        source = in_file(info)
        if source is None:
            raise NotAllowed(values, f"{cls.__name__}(...)")
        table = read_keys(values, cls.check_keys(_read_table(values)))
        made = make(cls.from_table(table, source))
        made.remember(values, source)
        return made


@cache
def _fields(cls: Any) -> Mapping[str, object]:
    """Return the defaults of the fields of a declared class."""
    listed = dataclasses.fields(cast(Any, cls))
    return {
        field.name: field.default_factory() if callable(field.default_factory) else field.default
        for field in listed
        if field.init
    }


_hints = cache(partial(get_type_hints, include_extras=True))


@cache
def _annotations(described: Any, kind: type[Annotation]) -> Mapping[str, Annotation]:
    """Return the annotations of a kind in a class or function, by field or argument."""
    return {
        key: mark
        for key, hint in _hints(described).items()
        for part in (hint, *get_args(hint))  # also of what may be None
        for mark in getattr(part, "__metadata__", ())
        if isinstance(mark, kind)
    }


def write_parts(value: object, file: OutputFile) -> object:
    """Return what a file contains for a value: tables for declared classes, alone, listed or by name."""
    if isinstance(value, Declared):
        return value.to_table(file)
    if isinstance(value, Mapping):
        return {key: write_parts(entry, file) for key, entry in value.items()}
    if isinstance(value, np.ndarray):
        return value.tolist()
    if isinstance(value, tuple) and any(isinstance(item, Declared) for item in value):
        return [write_parts(entry, file) for entry in value]
    return value


def unknown_key(key: str, allowed: Collection[str]) -> Refusal:
    """Return the mistake of a key that does not exist."""
    return Refusal(f"there is no such key{did_you_mean(key, allowed)}; allowed: {', '.join(allowed)}", key)


@cache
def _adapter(kind: Any) -> TypeAdapter[Any]:
    return TypeAdapter(kind)


def read_as(kind: Any, value: object, source: InputFile | None) -> Any:
    """Read a value as a declared class or an annotated type.

    Raises:
        pydantic.ValidationError: with all mistakes; see `mistakes_of`.
    """
    return _adapter(kind).validate_python(value, context=source)


def read_again(kind: Any, value: object, source: InputFile) -> Any:
    """Read, within a reader, a value as what the reader has found it to be."""
    try:
        return read_as(kind, value, source)
    except ValidationError as error:
        raise _joined(mistakes_of(error)) from None


# Parts that are described alone: in plain data, in a folder.


class InFolder:
    """The folder to which paths are relative in a description that belongs to no task.

    Attributes:
        folder: the folder.
        described: as in `InputFile`.
        embeds: as in `OutputFile`.
    """

    scene: Any = None

    def __init__(self, folder: Path, embeds: bool = False, arm: Any = None) -> None:
        self.folder = folder
        self.embeds = embeds
        self.arm = arm
        self.described: dict[Hashable, object] = {}

    def resolve(self, name: str) -> Path:
        """Return a path named in the description; raise ValueError if there is none."""
        try:
            return self.folder / Path(name).expanduser()
        except RuntimeError as error:  # the home of an unknown user
            raise ValueError(f"is {shown(name)}, which cannot be found ({error})") from None

    def find(self, part: Hashable, kind: Any) -> Any:
        """Return None: no descriptions are known."""


def read_plain(
    kind: Any, value: object, name: str = "", folder: str | Path | None = None, arm: Any = None
) -> Any:
    """Read a value as a declared class or an annotated type.

    Args:
        kind: what it is read as.
        value: plain data, or what a Python call accepts.
        name: what errors call it.
        folder: the folder to which paths in plain data are relative; None: not plain data.
        arm: the arm to which plain data belongs, if it is known.

    Raises:
        PostureError: the first mistake; names its key path.
    """
    try:
        return read_as(kind, value, None if folder is None else InFolder(Path(folder), arm=arm))
    except ValidationError as error:
        key_path, refusal = mistakes_of(error)[0]
        raise error_of((name, *key_path) if name else key_path, refusal) from refusal.__cause__


def read_call(kind: Any, values: Mapping[str, Any], arm: Any = None) -> Any:
    """Return what a declared class makes of the arguments of a call.

    Args:
        kind: the class.
        values: by name of the argument.
        arm: the arm of a file that gives the values; None: no file gives them.

    Raises:
        PostureError: the first mistake; names the argument.
    """
    return read_plain(kind, ArgsKwargs((), dict(values)), folder=None if arm is None else ".", arm=arm)


def read_field(kind: type, name: str, value: object) -> Any:
    """Return a value as a declared class reads it for one of its fields, in a call.

    Raises:
        PostureError: the first mistake; names the field.
    """
    return read_plain(_hints(kind)[name], value, name)


def describe_field(kind: type, name: str) -> str:
    """Return what the docstring of a declared class says of a field, and its default."""
    listed = (inspect.getdoc(kind) or "").partition("Attributes:\n")[2].split("\n\n")[0]
    match = re.search(rf"^    {name}: (.*?)(?=^    \w+: |\Z)", listed, re.DOTALL | re.MULTILINE)
    words = "" if match is None else " ".join(match[1].split())
    default = _fields(kind)[name]
    if default is None:
        words = words.replace("None: ", "Default: ")
        words = re.sub(
            r"[;.] ([^;.])([^;.]*?),? if None\.", lambda at: f". Default: {at[1].lower()}{at[2]}.", words
        )
    elif default not in (dataclasses.MISSING, False, (), {}):
        words = f"{words.replace('None: ', 'none: ')} Default: {default}."
    return words[:1].upper() + words[1:]


def with_value(
    part: Declared, key_path: Sequence[str], value: object, name: str = "", arm: Any = None
) -> Any:
    """Return a part with another value of one of its fields, or of a field of its parts.

    Args:
        part: the part.
        key_path: the field, and those within it.
        value: plain data, as a file contains it.
        name: what errors call the part.
        arm: the arm to which it belongs, if it is known.

    Raises:
        PostureError: there is no such field, or the value is refused.
    """
    key, *rest = key_path
    kind = cast(Any, type(part))
    called = f"{name}.{key}"
    if key not in _fields(kind):
        raise UnknownName(f"key of {name}", key, _fields(kind))
    now = getattr(part, key)
    if rest and isinstance(now, Declared):
        return dataclasses.replace(part, **{key: with_value(now, rest, value, called, arm)})
    for inner in reversed(rest):
        value = {inner: value}
    return dataclasses.replace(part, **{key: read_plain(_hints(kind)[key], value, called, ".", arm)})


def as_plain(part: Declared, embed: bool = True) -> Any:
    """Return a part as JSON-compatible data, without defaults; `embed`: as `OutputFile.embeds`."""
    return to_jsonable_python(part.to_table(InFolder(Path(), embed)))


# Calls: functions whose arguments are declared.

Parameters = ParamSpec("Parameters")
Returned = TypeVar("Returned")


def checked(function: Callable[Parameters, Returned]) -> Callable[Parameters, Returned]:
    """Make a function that reads its arguments as their annotations say, if these are `Annotated`.

    A call raises a `PostureError` for the first argument that is refused.
    """
    signature = inspect.signature(function)

    @functools.wraps(function)
    def call(*arguments: Parameters.args, **named: Parameters.kwargs) -> Returned:
        call = signature.bind(*arguments, **named)
        for name, hint in _hints(function).items():
            if name in call.arguments and hasattr(hint, "__metadata__"):  # others have their default
                call.arguments[name] = read_plain(hint, call.arguments[name], name)
        return function(*call.args, **call.kwargs)

    return call


def call_described(
    table: Mapping[str, Any], functions: Mapping[str, Callable[..., Returned]], what: str
) -> Returned:
    """Return what a function returns, given its name as `type` and its arguments by name.

    Args:
        table: for example {"type": "line", "a": [0, 0, 0], "b": [1, 0, 0]}.
        functions: by name.
        what: what they make.

    Raises:
        ValueError: with all mistakes in the keys, or what the function refuses.
    """
    function = functions[read_type(table, functions, what)]
    arguments = inspect.signature(function).parameters
    options = {key: value for key, value in table.items() if key != "type"}
    read_keys(options, arguments)
    for key, argument in arguments.items():
        if argument.default is argument.empty and key not in options:
            raise Refusal(f"the key {key!r} is missing")
    with refusing(options):
        return function(**in_si(options, function))


def read_type(table: Mapping[str, Any], known: Collection[str], what: str) -> str:
    """Return the `type` that a table names, one of those known; `what`: what has such types."""
    if "type" not in table:
        raise Refusal(f"the key 'type' is missing; allowed: {', '.join(known)}")
    return read_within("type", read_word, table["type"], known, f"type of {what}")
