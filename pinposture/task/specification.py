"""The tables of a task file: their keys and values, in SI units.

Validators raise a ValueError with what is wrong with a value; pydantic adds its place.
"""

from __future__ import annotations

import math
import re
from collections.abc import Callable, Collection, Mapping, Sequence
from pathlib import Path
from types import MappingProxyType
from typing import Annotated, Any, TypeVar

import numpy as np
from pydantic import (
    BaseModel,
    BeforeValidator,
    ConfigDict,
    Field,
    ValidationInfo,
    field_validator,
    model_validator,
)

from pinposture.arm import Arm, template
from pinposture.arm.macros import read_arguments
from pinposture.arm.specification import OF_A_TEMPLATE, OF_A_URDF
from pinposture.control import CONTROLLERS
from pinposture.curve import CURVES
from pinposture.errors import InvalidValue, UnknownName, did_you_mean
from pinposture.placement.resolve import METHODS, PLACEMENTS
from pinposture.task.follow_leader import PATH_METHODS, PATH_PLACEMENTS
from pinposture.task.keyframe import CONTINUITIES, OF_A_CURVE, joint_count_misfit
from pinposture.task.toml import Place

MOST_MODULES = 1000
"""Largest number of modules."""

DEFAULT_CYCLE = 0.02
"""Default duration of a control cycle [s]."""

LONGEST_CYCLE = 60.0
"""Longest control cycle [s]."""

RESULT_FORMATS = ("npz", "csv", "json", "png", "html")
"""Formats in which the result of a task can be saved."""

UNLIMITED_WORD = "none"
"""The word for no limit."""

VERSION = 1

# Values and keys in messages: on one line, truncated.

MAX_SHOWN_CHARACTERS = 100


def shown(value: object) -> str:
    """Return the representation of a value, truncated."""
    return _cut(repr(value))


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
    what = f"and {shown(unit)} is not a known unit" if unit else "without a unit"
    for kind, units in UNITS.items():
        if unit in units:
            what = f"of the kind {kind}"
    raise ValueError(f"is {shown(value)}, {what}; allowed: {allowed}")


def _finite(number: float, value: object, allowed: str) -> float:
    if not math.isfinite(number):
        raise ValueError(f"is {shown(value)}, which is not finite; allowed: {allowed}")
    return number


class Misplaced(ValueError):
    """A mistake in a part of a value.

    Attributes:
        within: the keys from the value to the part.
    """

    def __init__(self, reason: str, *within: str | int) -> None:
        super().__init__(reason)
        self.within = within


class Mistakes(ValueError):
    """Several mistakes in a value.

    Attributes:
        all: the mistakes.
    """

    def __init__(self, mistakes: Sequence[Misplaced]) -> None:
        super().__init__(*mistakes)
        self.all = tuple(mistakes)


# Kinds of values.

Read = TypeVar("Read")


def _wrong(value: object, allowed: str, hint: str = "") -> ValueError:
    return ValueError(f"is {shown(value)}{hint}; allowed: {allowed}")


def _within(key: str | int, read: Callable[..., Read], *arguments: Any) -> Read:
    """Return what `read` returns; report its mistakes at this key."""
    try:
        return read(*arguments)
    except ValueError as error:
        raise Misplaced(str(error), key, *getattr(error, "within", ())) from None


def _unknown_key(key: str, allowed: Collection[str]) -> Misplaced:
    hint = did_you_mean(key, allowed)
    return Misplaced(f"there is no such key{hint}; allowed: {', '.join(allowed)}", key)


def _is_text(value: object) -> bool:
    return isinstance(value, str)


def _is_table(value: object) -> bool:
    return isinstance(value, Mapping)


def _is_whole(value: object) -> bool:
    return isinstance(value, int) and not isinstance(value, bool)


def _is_finite(value: object) -> bool:
    return isinstance(value, int | float) and not isinstance(value, bool) and math.isfinite(value)


def _is_list_of(test: Callable[[object], bool]) -> Callable[[object], bool]:
    return lambda value: isinstance(value, list) and all(map(test, value))


def _check(test: Callable[[Any], bool], allowed: str) -> BeforeValidator:
    """Refuse values for which a test does not hold."""

    def check(value: object) -> object:
        if not test(value):
            raise _wrong(value, allowed)
        return value

    return BeforeValidator(check)


def _one_of(*words: str) -> BeforeValidator:
    return BeforeValidator(lambda value: _read_word(value, words))


def _read_word(value: object, words: Collection[str]) -> str:
    if not isinstance(value, str) or value not in words:
        raise _wrong(value, ", ".join(map(repr, words)), did_you_mean(value, words))
    return value


def _quantity(*kinds: str) -> BeforeValidator:
    return BeforeValidator(lambda value: read_quantity(value, *kinds))


def _positive(kind: str, most: float = math.inf) -> BeforeValidator:
    return BeforeValidator(lambda value: _read_positive(value, kind, most))


def _read_positive(value: object, kind: str, most: float = math.inf) -> float:
    number = read_quantity(value, kind)
    if number <= 0.0:
        raise _wrong(value, "more than 0")
    if number > most:
        raise _wrong(value, f"{most:g} s at most")
    return number


def _quantities(kind: str, count: int) -> BeforeValidator:
    return BeforeValidator(lambda value: _read_quantities(value, [kind] * count))


def _read_quantities(value: object, kinds: Sequence[str], unlimited: bool = False) -> list[float]:
    """Read a list of quantities, one of each kind; `unlimited`: `UNLIMITED_WORD` stands for infinity."""
    if not isinstance(value, list | tuple) or len(value) != len(kinds):
        raise _wrong(value, f"a list of {len(kinds)}")
    return [
        math.inf if unlimited and each == UNLIMITED_WORD else _within(index, read_quantity, each, kind)
        for index, (each, kind) in enumerate(zip(value, kinds, strict=True))
    ]


def _read_joints(value: Any, info: ValidationInfo) -> list[float]:
    arm = _arm(info)
    if isinstance(value, list) and len(value) != arm.nv:
        raise ValueError(joint_count_misfit(arm, len(value)))
    return _read_quantities(value, ["length" if slides else "angle" for slides in arm.slides])


def _read_joints_of_any_arm(value: Any, info: ValidationInfo) -> list[float]:
    """Read joint positions; with a curve they may be those of another arm, and are then ignored later."""
    if info.data.get("curve") is None:
        return _read_joints(value, info)
    fitting = not isinstance(value, list) or len(value) in (0, _arm(info).nv)
    return _read_joints(value, info) if fitting else _read_quantities(value, ["angle"] * len(value))


def _arm(info: ValidationInfo) -> Arm:
    arm: Arm = (info.context or {})["arm"]
    return arm


def _in_si(table: Mapping[str, Any], kinds: Mapping[str, str]) -> dict[str, Any]:
    """Read the text in these keys as quantities, alone or listed; keep all other values."""
    plain = dict(table)
    for key, kind in kinds.items():
        value = plain.get(key)
        if isinstance(value, str):
            plain[key] = _within(key, read_quantity, value, kind)
        elif isinstance(value, list) and any(isinstance(each, str) for each in value):
            plain[key] = _within(key, _read_quantities, value, [kind] * len(value))
    return plain


_CURVE_UNITS = dict.fromkeys(("radius", "pitch", "smoothing", "a", "b", "center"), "length") | {
    "phase": "angle"
}
_OBSTACLE_UNITS = dict.fromkeys(
    ("radius", "point_radius", "outlier_distance", "center", "size", "start", "end", "point"), "length"
) | {"rotation": "angle"}


def _curve(value: object) -> object:
    if isinstance(value, str):
        if value not in CURVES and not Path(value).suffix:
            allowed = f"{', '.join(CURVES)}, a .json, .csv or .txt file, or a table with a type"
            raise _wrong(value, allowed, did_you_mean(value, CURVES))
        return value
    if not isinstance(value, Mapping):
        raise _wrong(value, "a name, a file, or a table with a type")
    if "path" in value and not _is_file_name(value["path"]):
        raise _wrong(value["path"], "the name of a file as path")
    return _in_si(value, _CURVE_UNITS)


Text = Annotated[str, _check(_is_text, "text")]
TextOrNone = Annotated[str | None, _check(_is_text, "text")]
Flag = Annotated[bool, _check(lambda value: isinstance(value, bool), "true, false")]
Number = Annotated[float, _check(_is_finite, "a number")]
LengthOrNone = Annotated[float | None, _positive("length")]
AnyLength = Annotated[float | None, _quantity("length")]
Time = Annotated[float | None, _quantity("time")]
Speed = Annotated[float, _positive("speed")]
Position = Annotated[tuple[float, ...] | None, _quantities("length", 3)]
Rotation = Annotated[tuple[float, ...] | None, _quantities("angle", 3)]
Table = _check(_is_table, "a table")

CurveSpec = Annotated[str | dict[str, Any], BeforeValidator(_curve)]
"""A curve: the name of a preset, that of a file, or a description as `Curve.from_dict` takes it."""

ObstacleSpec = Annotated[dict[str, Any], BeforeValidator(lambda value: _in_si(value, _OBSTACLE_UNITS)), Table]
"""An obstacle, as `Scene.from_dict` takes it."""

# Tables.


class TableSpec(BaseModel):
    """A table of a task file."""

    model_config = ConfigDict(frozen=True, extra="forbid", arbitrary_types_allowed=True)

    @model_validator(mode="before")
    @classmethod
    def _checked(cls, values: object) -> object:
        return cls.check(values)

    @classmethod
    def check(cls, values: object) -> object:
        """Refuse anything but a table, unknown keys, and keys that exclude each other."""
        if not isinstance(values, Mapping):
            raise _wrong(values, "a table")
        allowed = cls.check_keys(values)
        unknown = [_unknown_key(key, allowed) for key in values if key not in cls.model_fields]
        if unknown:
            raise Mistakes(unknown)
        return values

    @classmethod
    def check_keys(cls, values: Mapping[str, Any]) -> Collection[str]:
        """Refuse keys that exclude each other; return the allowed ones."""
        return cls.model_fields

    @classmethod
    def without_defaults(cls, values: Mapping[str, Any]) -> dict[str, Any]:
        """Return the values that differ from the defaults, in the order of the table."""
        fields = cls.model_fields.items()
        return {key: values[key] for key, field in fields if key in values and values[key] != field.default}

    def given(self) -> dict[str, Any]:
        """Return the values of the keys in the file."""
        return self.model_dump(exclude_unset=True)


class PlacementTable(TableSpec):
    """The placement of the base of the arm, as `PlacementSpec`."""

    position: Position = None
    rotation: Rotation = None


class FeedTable(TableSpec):
    """A slide below the arm, as `FeedSpec`."""

    stroke: Annotated[float, _positive("length")]
    length: AnyLength = None
    speed: Speed = 0.1


def _modules_or_links(value: object) -> object:
    listed = value if isinstance(value, list) else [value]
    if not listed or not any(_is_list_of(test)(listed) for test in (_is_whole, _is_text)):
        raise _wrong(value, "a whole number, whole numbers, or names of links")
    return listed if isinstance(value, str) else value


def _coupling(value: object) -> object:
    """Read the joint that another follows, and perhaps a ratio and an offset."""
    listed = value if isinstance(value, list | tuple) else [value]
    if not 1 <= len(listed) <= 3 or not isinstance(listed[0], str):
        raise _wrong(value, "the name of a joint; or that, a ratio, and perhaps an offset, in a list")
    name, *numbers = listed
    if numbers and (isinstance(numbers[0], bool) or not isinstance(numbers[0], int | float)):
        raise _wrong(numbers[0], "a number, the ratio")
    if len(numbers) < 2:
        return (name, *numbers) if numbers else name
    return name, numbers[0], _within(2, read_quantity, numbers[1], "angle", "length")


def _xacro_args(value: object) -> object:
    """Read the values of xacro arguments as text."""
    if not _is_table(value):
        return value
    try:
        return read_arguments(value)
    except InvalidValue as error:
        raise _wrong(error.value, error.allowed) from None


class ArmTable(TableSpec):
    """The arm, as `ArmSpec`, with units, and with paths as written."""

    template: TextOrNone = None
    modules: Annotated[
        int | None,
        _check(
            lambda value: _is_whole(value) and 1 <= value <= MOST_MODULES,
            f"a whole number, 1 to {MOST_MODULES}",
        ),
    ] = None
    link_lengths: Any = None
    joint_limits: Annotated[tuple[float, ...] | None, _quantities("angle", 2)] = None
    feed: FeedTable | None = None
    urdf: TextOrNone = None
    base: TextOrNone = None
    tip: TextOrNone = None
    split: Annotated[Any, BeforeValidator(_modules_or_links)] = None
    locked: Annotated[dict[str, Annotated[float, _quantity("angle", "length")]], Table] = Field(
        default_factory=dict
    )
    couplings: Annotated[dict[str, Annotated[Any, BeforeValidator(_coupling)]], Table] = Field(
        default_factory=dict
    )
    package_dirs: Annotated[list[str], _check(_is_list_of(_is_text), "a list of folders")] = Field(
        default_factory=list
    )
    xacro_args: Annotated[dict[str, str], BeforeValidator(_xacro_args), Table] = Field(default_factory=dict)
    hard_limits: Annotated[bool, _check(lambda value: isinstance(value, bool), "true or false")] = False
    placement: PlacementTable | None = None
    characteristic_length: LengthOrNone = None

    @classmethod
    def check_keys(cls, values: Mapping[str, Any]) -> Collection[str]:
        """Refuse keys of an arm of another kind."""
        kind, other = (OF_A_URDF, OF_A_TEMPLATE) if "urdf" in values else (OF_A_TEMPLATE, OF_A_URDF)
        for key in other:
            if key in values:
                raise Misplaced(f"does not go with {kind[0]!r}", key)
        return cls.model_fields

    @classmethod
    def check(cls, values: Any) -> object:
        """Refuse an arm without URDF or template, and a template without a number of modules."""
        super().check(values)
        if "urdf" not in values and "template" not in values:
            raise ValueError("needs one of the keys 'urdf', 'template'")
        if "template" in values and "modules" not in values:
            raise ValueError("the key 'modules' is missing")
        return values

    @field_validator("template")
    @classmethod
    def _known(cls, name: str | None) -> str | None:
        try:
            return name if name is None else template(name).name
        except UnknownName as error:
            raise ValueError(str(error)) from None

    @field_validator("link_lengths")
    @classmethod
    def _for_each_joint(cls, value: object, info: ValidationInfo) -> tuple[float, ...]:
        if "template" not in info.data:  # it is refused
            return ()
        joints = len(template(info.data["template"]).joints) if info.data["template"] else 0
        return tuple(_read_quantities(value, ["length"] * joints))


class LimitsSpec(TableSpec):
    """The limits of each control cycle; the context "arm" is needed to read it."""

    cycle: Annotated[float, _positive("time", LONGEST_CYCLE)] = DEFAULT_CYCLE
    step: Any = None
    velocity: Any = None
    acceleration: Any = None
    jerk: Any = None
    position_margin: Any = 0.0

    @field_validator("step", "velocity", "acceleration", "jerk")
    @classmethod
    def _for_joints(cls, value: object, info: ValidationInfo) -> Any:
        """Read a limit for all joints, for revolute and prismatic ones, or one for each joint."""
        arm = _arm(info)
        turning, sliding = {
            "step": ("angle", "length"),
            "velocity": ("rate of turning", "speed"),
            "acceleration": ("rate of change of turning", "acceleration"),
            "jerk": ("jerk of turning", "jerk"),
        }[str(info.field_name)]
        if value == UNLIMITED_WORD:
            return math.inf
        if isinstance(value, list):
            kinds = [sliding if slides else turning for slides in arm.slides]
            return np.array(_read_quantities(value, kinds, unlimited=True))
        if not isinstance(value, Mapping):
            both = "a table with both, as in {turning = ..., sliding = ...}"
            return _for_all(value, arm, both, turning, sliding)
        limit = np.full(arm.nv, np.inf)
        parts = {"turning": (turning, ~arm.slides), "sliding": (sliding, arm.slides)}
        for name, each in value.items():
            if name not in parts:
                raise _unknown_key(name, parts)
            kind, joints = parts[name]
            limit[joints] = _within(name, _read_positive, each, kind)
        if info.field_name == "velocity":  # others keep the speed of the description
            limit = np.where(np.isinf(limit), arm.limits.velocity, limit)
        return limit

    @field_validator("position_margin")
    @classmethod
    def _margin(cls, value: object, info: ValidationInfo) -> float:
        return _for_all(value, _arm(info), "a number, for all", "angle", "length")


def _for_all(value: object, arm: Arm, allowed: str, turning: str, sliding: str) -> float:
    """Read one number for all joints, with a unit only if all of them turn or all of them slide."""
    if isinstance(value, str) and np.any(arm.slides) and not np.all(arm.slides):
        raise ValueError(f"is {shown(value)}, and the arm turns and slides; allowed: {allowed}")
    return read_quantity(value, sliding if np.all(arm.slides) else turning)


class ControllerSpec(TableSpec):
    """The controller, by name, with the parameters of "geodesic"."""

    name: Annotated[str, BeforeValidator(lambda value: _read_word(value, CONTROLLERS))] = "geodesic"
    joint_weight: Number | None = None
    relative_position_weight: Number | None = None


class StartSpec(TableSpec):
    """The configuration to start from; the context "arm" is needed to read it."""

    posture: Annotated[str | None, _one_of("straight", "neutral")] = None
    joints: Annotated[Any, BeforeValidator(_read_joints)] = None

    @classmethod
    def check_keys(cls, values: Mapping[str, Any]) -> Collection[str]:
        """Refuse two configurations."""
        if "joints" in values and "posture" in values:
            raise Misplaced("does not go with 'joints'", "posture")
        return cls.model_fields


class SceneSpec(TableSpec):
    """The obstacles: a scene file, or the content of one."""

    file: TextOrNone = None
    version: Any = None
    obstacles: Annotated[dict[str, ObstacleSpec], Table] = Field(default_factory=dict)
    self_collision: Any = None
    margin: AnyLength = None
    arm_radius: AnyLength = None

    @classmethod
    def check_keys(cls, values: Mapping[str, Any]) -> Collection[str]:
        """Refuse all other keys beside a file."""
        for key in values:
            if "file" in values and key != "file":
                raise Misplaced("there is no such key; allowed: file", key)
        return cls.model_fields


class TipSpec(TableSpec):
    """The task of the tip, or of another control point; points are counted from 1."""

    position: Position
    rotation: Rotation = None
    point: Annotated[
        int | str,
        _check(
            lambda value: isinstance(value, str) or (_is_whole(value) and value != 0),
            "1 or more, counted from the base; -1 or less, counted from the tip; or a name",
        ),
    ] = -1
    weight: Number = 1.0
    priority: Flag = False
    direction_only: Flag = False
    length: LengthOrNone = None


def _region(value: Any) -> object:
    if not _is_list_of(_is_whole)(value) or len(value) != 2:
        allowed = "two whole numbers: the first and the last control point, counted from 1 at the base"
        raise _wrong(value, allowed)
    if not 1 <= value[0] <= value[1]:
        raise _wrong(value, "1 or more, the last not before the first")
    return value


class KeyframeSpec(TableSpec):
    """A posture and its time; control points are counted from 1. The context "arm" is needed to read it."""

    name: Text = ""
    time: Time = None
    duration: Time = None
    hold: Annotated[float, _quantity("time")] = 0.0
    speed: Number = 1.0
    curve: CurveSpec | None = None
    placement: Annotated[str | None, _one_of(*PLACEMENTS)] = None
    trim: Flag = False
    roll: Annotated[float, _quantity("angle")] = 0.0
    method: Annotated[str, _one_of(*METHODS)] = "auto"
    region: Annotated[tuple[int, int] | None, BeforeValidator(_region)] = None
    joints: Annotated[Any, BeforeValidator(_read_joints_of_any_arm)] = None
    tip: TipSpec | None = None

    @classmethod
    def check_keys(cls, values: Mapping[str, Any]) -> Collection[str]:
        """Refuse a keyframe without a posture, and keys of a curve where there is none."""
        if "curve" not in values:
            if "joints" not in values:
                raise ValueError("needs one of the keys 'curve', 'joints'")
            for key in OF_A_CURVE:
                if key in values:
                    raise Misplaced("goes with 'curve', and there is none", key)
        return cls.model_fields


class LeaderSpec(TableSpec):
    """The path of the leader."""

    path: CurveSpec
    speed: Speed
    placement: Annotated[str | None, _one_of(*PATH_PLACEMENTS)] = None
    depth: LengthOrNone = None
    method: Annotated[str, _one_of(*PATH_METHODS)] = "closest"
    and_back: Flag = False
    pipe: LengthOrNone = None


class TipGoalSpec(TableSpec):
    """A goal of the tip, as `TipGoal`."""

    position: Position
    direction: Annotated[
        tuple[float, ...] | None,
        _check(lambda value: _is_list_of(_is_finite)(value) and len(value) == 3, "three numbers"),
    ] = None
    rotation: Rotation = None
    duration: Annotated[float | None, _positive("time")] = None
    hold: Annotated[float, _quantity("time")] = 0.0
    budget: Annotated[float, _positive("time")] = 5.0


class WithdrawalSpec(TableSpec):
    """The way out, as `Withdrawal`."""

    speed: Annotated[float | None, _positive("speed")] = None


PHASES = ("leader", "reach", "keyframes", "withdraw")
"""Keys of a phase, of which each has one."""


class PhaseSpec(TableSpec):
    """A part of the motion. The context "arm" is needed to read it."""

    name: Text = ""
    leader: LeaderSpec | None = None
    reach: TipGoalSpec | None = None
    keyframes: Annotated[
        tuple[KeyframeSpec, ...],
        _check(_is_list_of(_is_table), "a list of tables, each begun by [[phases.keyframes]]"),
    ] = ()
    withdraw: WithdrawalSpec | None = None

    @classmethod
    def check_keys(cls, values: Mapping[str, Any]) -> Collection[str]:
        """Refuse a phase without a motion, or with several."""
        given = [key for key in PHASES if key in values]
        if len(given) > 1:
            raise Misplaced(f"does not go with {given[0]!r}; a phase has one motion", given[1])
        if not given and all(key in cls.model_fields for key in values):
            raise ValueError(f"needs one of the keys {', '.join(map(repr, PHASES))}")
        return cls.model_fields


class OutputSpec(TableSpec):
    """How to save the result."""

    formats: Annotated[
        tuple[str, ...],
        _check(_is_list_of(lambda each: each in RESULT_FORMATS), f"a list of {', '.join(RESULT_FORMATS)}"),
    ] = RESULT_FORMATS


def _is_file_name(value: object) -> bool:
    return isinstance(value, str) and bool(value.strip()) and "\0" not in value


class EditorSpec(TableSpec):
    """Files that the editor shows; they need not exist."""

    scans: Annotated[
        tuple[Annotated[str, _check(_is_file_name, "the name of a file")], ...],
        _check(lambda value: isinstance(value, list), "a list of files"),
    ] = ()


class TaskSpec(TableSpec):
    """A whole task file, except for the arm, which is the context "arm" for reading the rest."""

    version: Any = VERSION
    kind: Annotated[str, _one_of("keyframes", "follow_leader", "phases")] = "keyframes"
    name: TextOrNone = None
    continuity: Annotated[str, _one_of(*CONTINUITIES)] = "velocity"
    repeat: Annotated[
        int, _check(lambda value: _is_whole(value) and value > 0, "a whole number, 1 or more")
    ] = 1
    arm: Any = None
    scene: SceneSpec = SceneSpec()
    keyframes: Annotated[
        tuple[KeyframeSpec, ...],
        _check(_is_list_of(_is_table), "a list of tables, each begun by [[keyframes]]"),
    ] = ()
    leader: LeaderSpec | None = None
    phases: Annotated[
        tuple[PhaseSpec, ...], _check(_is_list_of(_is_table), "a list of tables, each begun by [[phases]]")
    ] = ()
    limits: LimitsSpec = LimitsSpec()
    controller: ControllerSpec = ControllerSpec()
    start: StartSpec = StartSpec()
    output: OutputSpec = OutputSpec()
    editor: EditorSpec = EditorSpec()

    @classmethod
    def check_keys(cls, values: Mapping[str, Any]) -> Collection[str]:
        """Refuse another version, and keys of another kind of motion."""
        version = values.get("version", VERSION)
        kind = values.get("kind", "keyframes")
        if version is True or version != VERSION:
            raise Misplaced(f"is {shown(version)}; allowed: {VERSION}", "version")
        _within("kind", _read_word, kind, _KEYS_OF_KIND)
        own = _KEYS_OF_KIND[kind]
        others = {key: other for other, keys in _KEYS_OF_KIND.items() for key in keys if key not in own}
        for key, other in others.items():
            if key in values:
                raise Misplaced(f"goes with kind = {other!r}; the kind is {kind!r}", key)
        return [key for key in cls.model_fields if key not in others]


_KEYS_OF_KIND = {
    "keyframes": ("keyframes", "continuity", "repeat"),
    "follow_leader": ("leader",),
    "phases": ("phases", "continuity"),
}
