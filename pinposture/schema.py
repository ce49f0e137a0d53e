"""Declarations: quantities with units, kinds of values, and the classes that a user describes with them.

A class that is read from files is declared once, as a dataclass whose annotations say what each value may
be. Python calls and files go through the same annotations. They differ in `ValidationInfo.context`: None in
a call, an `InputFile` in a file. A validator raises a `Refusal`; a call turns it into a `PostureError` that
names the argument, a reader of files adds line and key.
"""

from __future__ import annotations

import dataclasses
import functools
import math
import re
from collections.abc import Callable, Collection, Hashable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from functools import cache
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
    PlainValidator,
    TypeAdapter,
    ValidationError,
    ValidationInfo,
    model_validator,
)
from pydantic_core import ArgsKwargs, to_jsonable_python
from typing_extensions import Self, dataclass_transform

from pinposture._validation import LARGEST_NUMBER, SMALLEST_NUMBER, is_number, is_usable, is_whole
from pinposture.errors import InvalidValue, PostureError, UnknownName, did_you_mean

# Values and keys in messages: on one line, truncated.

MAX_SHOWN_CHARACTERS = 100

Place = tuple[str | int, ...]
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
    return text if len(text) <= MAX_SHOWN_CHARACTERS else text[: MAX_SHOWN_CHARACTERS - 4] + " ..."


def place_in_words(place: Place) -> str:
    """Describe a place in a file, as in "keyframe 2, curve.radius"; list items count from 1."""
    words = ""
    for key in place:
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
        self.within: Place = within
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
        value: the value.
        allowed: what is allowed.
    """

    def __init__(self, value: object, allowed: str, *within: str | int, hint: str = "") -> None:
        super().__init__(f"is {shown(value)}{hint}; allowed: {allowed}", *within)
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
        mistakes = [_refusal(each, None) for each in getattr(error, "all", (error,))]
        raise _at(key, [(each.within, each) for each in mistakes]) from None


def mistakes_of(error: ValidationError) -> list[tuple[Place, Refusal]]:
    """Return place and reason of each mistake that validators found."""
    return [each for found in error.errors(include_url=False) for each in _mistakes(found)]


def _mistakes(found: Mapping[str, Any]) -> list[tuple[Place, Refusal]]:
    inside: Place = found["loc"]
    cause = found.get("ctx", {}).get("error")
    if found["type"] == "missing":
        return [(inside[:-1], Refusal(f"the key {inside[-1]!r} is missing"))]
    if cause is None:
        return [(inside, NotAllowed(found["input"], found["msg"]))]
    listed = [_refusal(each, found["input"]) for each in getattr(cause, "all", (cause,))]
    return [((*inside, *each.within), each) for each in listed]


def _refusal(cause: Exception, table: object) -> Refusal:
    """Return a mistake as a refusal; that of a check of several values is at the one that it names."""
    if isinstance(cause, Refusal):
        return cause
    if isinstance(cause, InvalidValue) and isinstance(table, Mapping) and cause.name in table:
        return NotAllowed(table[cause.name], cause.allowed, cause.name)
    return Refusal(str(cause), error=cause if isinstance(cause, PostureError) else None)


def _at(key: str | int, mistakes: Sequence[tuple[Place, Refusal]]) -> Refusal | Refusals:
    """Return mistakes in the value of a key as mistakes in its table."""
    for place, each in mistakes:
        each.within = (key, *place)
    found = [each for _, each in mistakes]
    return found[0] if len(found) == 1 else Refusals(found)


# Quantities: numbers in SI units, or text with a unit.

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
        "jerk": _per(_LENGTHS, "s^3"),
        "jerk of turning": _per(_ANGLES, "s^3"),
    }
)
"""Units by kind of quantity, with their values in SI units."""

_QUANTITY = re.compile(r"\s*([-+]?(?:\d+\.?\d*|\.\d+)(?:[eE][-+]?\d+)?)\s*(\S.*?)?\s*")


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
    found = _QUANTITY.fullmatch(value) if isinstance(value, str) else None
    if found is None:
        raise NotAllowed(value, allowed)
    unit = (found[2] or "").replace("**", "^").replace("²", "^2").replace(" ", "").replace("/s/s", "/s^2")
    for kind in kinds:
        if unit in UNITS[kind]:
            number = float(found[1]) * UNITS[kind][unit]
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
    """

    arm: Any
    scene: Any

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


def check(test: Callable[[Any], bool], allowed: str) -> PlainValidator:
    """Refuse values for which a test does not hold."""

    def read(value: object, _: ValidationInfo) -> object:
        if not test(value):
            raise NotAllowed(value, allowed)
        return value

    return read_by(read)


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
"""The word for no limit."""


def read_quantities(value: object, kinds: Sequence[str], unlimited: bool = False) -> tuple[float, ...]:
    """Read a list of quantities, one of each kind; `unlimited`: `UNLIMITED_WORD` stands for infinity."""
    given = value.tolist() if isinstance(value, np.ndarray) else value
    if not isinstance(given, list | tuple) or len(given) != len(kinds):
        raise NotAllowed(value, f"a list of {len(kinds)}")
    return tuple(
        math.inf if unlimited and each == UNLIMITED_WORD else read_within(index, read_quantity, each, kind)
        for index, (each, kind) in enumerate(zip(given, kinds, strict=True))
    )


def in_si(table: Mapping[str, Any], kinds: Mapping[str, str]) -> dict[str, Any]:
    """Read the text in these keys as quantities, alone or listed; keep all other values."""
    plain = dict(table)
    for key, kind in kinds.items():
        value = plain.get(key)
        if isinstance(value, str):
            plain[key] = read_within(key, read_quantity, value, kind)
        elif isinstance(value, list) and any(isinstance(each, str) for each in value):
            plain[key] = list(read_within(key, read_quantities, value, [kind] * len(value)))
    return plain


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


def _read_table(value: object) -> Mapping[str, Any]:
    if not isinstance(value, Mapping):
        raise NotAllowed(value, "a table")
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


def _read_positive_number(value: Any, _: ValidationInfo) -> float:
    if not is_usable(value):
        raise NotAllowed(value, "a number")
    if value < SMALLEST_NUMBER:
        raise NotAllowed(value, "a finite number > 0")
    return float(value)


def _read_count(value: Any, _: ValidationInfo) -> int:
    if not (is_whole(value) and value > 0):
        raise NotAllowed(value, "a whole number, 1 or more")
    return int(value)


Text = Annotated[str, check(is_text, "text")]
Flag = Annotated[bool, read_by(_read_flag)]
Number = Annotated[float, check(is_usable, "a number")]
PositiveNumber = Annotated[float, read_by(_read_positive_number)]
Count = Annotated[int, read_by(_read_count)]
Length = Annotated[float, quantity("length", above=0.0)]
AnyLength = Annotated[float, quantity("length")]
Angle = Annotated[float, quantity("angle")]
Time = Annotated[float, quantity("time", least=0.0)]
Duration = Annotated[float, quantity("time", above=0.0)]
Speed = Annotated[float, quantity("speed", above=0.0)]
Position = Annotated[tuple[float, ...], quantities("length", 3)]
Rotation = Annotated[tuple[float, ...], quantities("angle", 3)]
Table = BeforeValidator(_read_table)

# Declared classes.

Class = TypeVar("Class")


@dataclass_transform(frozen_default=True, field_specifiers=(dataclasses.field,))
def declared(*, eq: bool = True) -> Callable[[type[Class]], type[Class]]:
    """Make a frozen dataclass whose values are read as its annotations say.

    A call raises a `PostureError` for the first value that is refused.
    """

    def declare(cls: type[Class]) -> type[Class]:
        config = ConfigDict(arbitrary_types_allowed=True, extra="forbid")
        made: Any = pydantic.dataclasses.dataclass(frozen=True, eq=eq, config=config)(cls)
        read = made.__init__
        names = [each.name for each in dataclasses.fields(made) if each.init]

        @functools.wraps(read)
        def __init__(self: object, *arguments: Any, **named: Any) -> None:
            try:
                read(self, *arguments, **named)
            except ValidationError as error:
                failure = _error_of_call(made, names, error)
                subject = made.subject({**dict(zip(names, arguments, strict=False)), **named})
                if subject:
                    failure.args = (f"{subject}: {failure}",)
                raise failure from None

        made.__init__ = __init__
        return cast("type[Class]", made)

    return declare


def _error_of_call(kind: type, names: Sequence[str], error: ValidationError) -> Exception:
    found = error.errors(include_url=False)[0]
    if found["type"] in ("missing", "unexpected_keyword_argument", "unexpected_positional_argument"):
        what = found["type"].partition("_")[0]
        return TypeError(f"{kind.__name__}: {what} argument {found['loc'][-1]!r}")
    cause = found.get("ctx", {}).get("error")
    if isinstance(cause, PostureError):
        return cause
    place, refusal = _mistakes(found)[0]
    if refusal.error is not None:
        return refusal.error
    first, *rest = place or (kind.__name__,)
    name = names[first] if isinstance(first, int) else first
    name += "".join(f"[{each}]" if isinstance(each, int) else f".{each}" for each in rest)
    if isinstance(refusal, NotAllowed):
        return InvalidValue(name, refusal.value, refusal.allowed)
    return InvalidValue(name, found["input"], str(refusal))


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
        writers = _writers(kind)
        for key, default in _fields(kind).items():
            value = getattr(self, key)
            if isinstance(value, np.ndarray) or value != default:
                table[key] = writers[key](value, file) if key in writers else write_parts(value, file)
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
        each.name: each.default_factory() if callable(each.default_factory) else each.default
        for each in listed
        if each.init
    }


@cache
def _writers(cls: Any) -> Mapping[str, Callable[[Any, OutputFile], object]]:
    """Return the functions that write fields, of those whose annotations have one."""
    hints = get_type_hints(cls, include_extras=True)
    return {
        key: each.write
        for key, hint in hints.items()
        for part in (hint, *get_args(hint))  # also of what may be None
        for each in getattr(part, "__metadata__", ())
        if isinstance(each, WrittenBy)
    }


def write_parts(value: object, file: OutputFile) -> object:
    """Return what a file contains for a value: tables for declared classes, alone or listed."""
    if isinstance(value, Declared):
        return value.to_table(file)
    if isinstance(value, tuple) and any(isinstance(each, Declared) for each in value):
        return [write_parts(each, file) for each in value]
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


def read_part(key: str, kind: Any, value: object, source: InputFile) -> Any:
    """Read the value of a key of a table; report mistakes at this key."""
    try:
        return read_as(kind, value, source)
    except ValidationError as error:
        raise _at(key, mistakes_of(error)) from None


def as_plain(part: Declared) -> Any:
    """Return a part of which files keep no descriptions as JSON-compatible data, without defaults."""
    return to_jsonable_python(part.to_table(cast(OutputFile, None)))
