"""What a task file says, table by table: which keys there are, and what each may hold, in SI units.

A mistake is a ValueError that says what is wrong with a value, after "is"; pydantic adds where it is.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from difflib import get_close_matches
from pathlib import Path
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
from pinposture.arm.specification import OF_A_TEMPLATE, OF_A_URDF
from pinposture.control import CONTROLLERS
from pinposture.curve.presets import CURVES
from pinposture.errors import UnknownName
from pinposture.placement.resolve import METHODS, PLACEMENTS
from pinposture.task.document import Misplaced, read_quantity, shown
from pinposture.task.follow_leader import PATH_METHODS, PATH_PLACEMENTS
from pinposture.task.keyframe import CONTINUITIES
from pinposture.task.perform import CYCLE

MOST_MODULES = 1000
"""The longest arm."""

LONGEST_CYCLE = 60.0
"""The longest control cycle [s]."""

RESULT_FORMATS = ("npz", "csv", "json", "png", "html")
"""What may be kept of the result of a task."""

UNLIMITED = "none"
"""What stands in a file for a limit that does not exist."""

VERSION = 1
MOTION_KINDS = ("keyframes", "follow_leader")

# Kinds of values.

Read = TypeVar("Read")


def _wrong(value: object, allowed: str, hint: str = "") -> ValueError:
    return ValueError(f"is {shown(value)}{hint}; allowed: {allowed}")


def _within(key: str | int, read: Callable[..., Read], *arguments: Any) -> Read:
    """What `read` returns; a mistake that it finds is in this key."""
    try:
        return read(*arguments)
    except ValueError as error:
        raise Misplaced(str(error), key, *getattr(error, "within", ())) from None


def _did_you_mean(value: object, known: Sequence[str]) -> str:
    close = get_close_matches(value, known, n=1) if isinstance(value, str) else []
    return f" (did you mean {close[0]!r}?)" if close else ""


def _text(value: object) -> object:
    if not isinstance(value, str):
        raise _wrong(value, "text")
    return value


def _one_of(*words: str) -> BeforeValidator:
    def read(value: object) -> object:
        if not isinstance(value, str) or value not in words:
            raise _wrong(value, ", ".join(map(repr, words)), _did_you_mean(value, words))
        return value

    return BeforeValidator(read)


def _listed(value: object) -> list[Any]:
    return value if isinstance(value, list) else []


def _flag(value: object) -> object:
    if not isinstance(value, bool):
        raise _wrong(value, "true, false")
    return value


def _number(value: object) -> object:
    if isinstance(value, bool) or not isinstance(value, int | float) or not math.isfinite(value):
        raise _wrong(value, "a number")
    return value


def _whole(value: object) -> object:
    if isinstance(value, bool) or not isinstance(value, int) or not 1 <= value <= MOST_MODULES:
        raise _wrong(value, f"a whole number, 1 to {MOST_MODULES}")
    return value


def _above_zero(value: object, kind: str) -> float:
    number = read_quantity(value, kind)
    if number <= 0.0:
        raise _wrong(value, "more than 0")
    return number


def _quantity(kind: str, above_zero: bool = False) -> BeforeValidator:
    read = _above_zero if above_zero else read_quantity
    return BeforeValidator(lambda value: read(value, kind))


def read_quantities(value: object, kinds: Sequence[str], unlimited: bool = False) -> list[float]:
    """A list of quantities in SI units, one of each of these kinds.

    Args:
        value: what stands in the file.
        kinds: what each may measure.
        unlimited: whether `UNLIMITED` stands for an infinite one.

    Raises:
        ValueError: anything else; says which one.
    """
    if not isinstance(value, list | tuple) or len(value) != len(kinds):
        raise _wrong(value, f"a list of {len(kinds)}")
    return [
        math.inf if unlimited and each == UNLIMITED else _within(index, read_quantity, each, kind)
        for index, (each, kind) in enumerate(zip(value, kinds, strict=True))
    ]


def _quantities(kind: str, count: int) -> BeforeValidator:
    return BeforeValidator(lambda value: read_quantities(value, [kind] * count))


def _in_si(kinds: Mapping[str, str]) -> Callable[[Mapping[str, Any]], dict[str, Any]]:
    """Turn text into quantities in these keys of a table, alone or listed; all else stays as it is."""

    def read(table: Mapping[str, Any]) -> dict[str, Any]:
        plain = dict(table)
        for key, kind in kinds.items():
            value = plain.get(key)
            if isinstance(value, str):
                plain[key] = _within(key, read_quantity, value, kind)
            elif isinstance(value, list) and any(isinstance(each, str) for each in value):
                plain[key] = _within(key, read_quantities, value, [kind] * len(value))
        return plain

    return read


Text = Annotated[str, BeforeValidator(_text)]
TextOrNone = Annotated[str | None, BeforeValidator(_text)]
Flag = Annotated[bool, BeforeValidator(_flag)]
Number = Annotated[float, BeforeValidator(_number)]
NumberOrNone = Annotated[float | None, BeforeValidator(_number)]
Length = Annotated[float, _quantity("length", above_zero=True)]
LengthOrNone = Annotated[float | None, _quantity("length", above_zero=True)]
Time = Annotated[float | None, _quantity("time")]
Position = Annotated[tuple[float, ...] | None, _quantities("length", 3)]
Rotation = Annotated[tuple[float, ...] | None, _quantities("angle", 3)]

_curve_in_si = _in_si(
    {**dict.fromkeys(("radius", "pitch", "smoothing", "a", "b", "center"), "length"), "phase": "angle"}
)
_obstacle_in_si = _in_si(
    dict.fromkeys(("radius", "center", "size", "start", "end", "point"), "length") | {"rotation": "angle"}
)


def _curve(value: object) -> object:
    if isinstance(value, str):
        if value not in CURVES and not Path(value).suffix:
            allowed = f"{', '.join(CURVES)}, a .json, .csv or .txt file, or a table with a type"
            raise _wrong(value, allowed, _did_you_mean(value, list(CURVES)))
        return value
    if not isinstance(value, Mapping):
        raise _wrong(value, "a name, a file, or a table with a type")
    return _curve_in_si(value)


def _obstacle(value: object) -> object:
    if not isinstance(value, Mapping):
        raise _wrong(value, "a table")
    return _obstacle_in_si(value)


CurveSpec = Annotated[str | dict[str, Any], BeforeValidator(_curve)]
"""A curve: the name of a preset, that of a file, or a description as `Curve.from_dict` takes it."""

ObstacleSpec = Annotated[dict[str, Any], BeforeValidator(_obstacle)]
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
        """Refuse what is no table, and keys that do not exist, are missing, or do not go together."""
        if not isinstance(values, Mapping):
            raise _wrong(values, "a table")
        cls.check_keys(values)
        for key in values:
            if key not in cls.model_fields:
                allowed = cls.keys(values)
                reason = f"there is no such key{_did_you_mean(key, allowed)}; allowed: {', '.join(allowed)}"
                raise Misplaced(reason, key)
        for key in cls.required(values):
            if key not in values:
                raise ValueError(f"the key {key!r} is missing")
        return values

    @classmethod
    def check_keys(cls, values: Mapping[str, Any]) -> None:
        """Refuse keys that do not go together."""

    @classmethod
    def keys(cls, values: Mapping[str, Any]) -> list[str]:
        """The keys that the table may have."""
        return list(cls.model_fields)

    @classmethod
    def required(cls, values: Mapping[str, Any]) -> list[str]:
        """The keys that the table must have."""
        return [key for key, field in cls.model_fields.items() if field.is_required()]

    def said(self) -> dict[str, Any]:
        """The values of the keys that the file has."""
        return self.model_dump(exclude_unset=True)


class PlacementTable(TableSpec):
    """Where the base of the arm stands, as `PlacementSpec`."""

    position: Position = (0.0, 0.0, 0.0)
    rotation: Rotation = (0.0, 0.0, 0.0)


class FeedTable(TableSpec):
    """A slide below the arm, as `FeedSpec`."""

    stroke: Length
    length: Annotated[float | None, _quantity("length")] = None
    speed: Annotated[float, _quantity("speed", above_zero=True)] = 0.1


class ArmTable(TableSpec):
    """What the arm is made from, as `ArmSpec`, with units, and with paths as they are written."""

    template: TextOrNone = None
    modules: Annotated[int | None, BeforeValidator(_whole)] = None
    link_lengths: Any = None
    joint_limits: Annotated[tuple[float, ...] | None, _quantities("angle", 2)] = None
    feed: FeedTable | None = None
    urdf: TextOrNone = None
    base: TextOrNone = None
    tip: TextOrNone = None
    split: Any = None
    locked: dict[str, float] = Field(default_factory=dict)
    package_dirs: list[str] = Field(default_factory=list)
    placement: PlacementTable | None = None
    characteristic_length: LengthOrNone = None

    @classmethod
    def check_keys(cls, values: Mapping[str, Any]) -> None:
        """Refuse keys of an arm of another kind."""
        kind, other = (OF_A_URDF, OF_A_TEMPLATE) if "urdf" in values else (OF_A_TEMPLATE, OF_A_URDF)
        for key in other:
            if key in values:
                raise Misplaced(f"does not go with {kind[0]!r}", key)

    @classmethod
    def required(cls, values: Mapping[str, Any]) -> list[str]:
        """A URDF, or a template and how many modules of it."""
        if "urdf" not in values and "template" not in values:
            raise ValueError("needs one of the keys 'urdf', 'template'")
        return ["modules"] if "template" in values else []

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
        joints = len(template(info.data["template"]).joints) if info.data.get("template") else 0
        return tuple(read_quantities(value, ["length"] * joints))

    @field_validator("split", mode="before")
    @classmethod
    def _listed(cls, value: object) -> object:
        listed = [value] if isinstance(value, str) else value
        numbers = listed if isinstance(listed, list) else [listed]
        same = len({type(each) for each in numbers}) == 1 and isinstance(numbers[0], int | str)
        if not same or isinstance(numbers[0], bool):
            raise _wrong(value, "a whole number, whole numbers, or names of links")
        return listed

    @field_validator("locked", mode="before")
    @classmethod
    def _positions(cls, value: object) -> object:
        if not isinstance(value, Mapping):
            raise _wrong(value, "a table")
        return {
            name: _within(name, read_quantity, position, "angle", "length")
            for name, position in value.items()
        }

    @field_validator("package_dirs", mode="before")
    @classmethod
    def _folders(cls, value: object) -> object:
        if not isinstance(value, list) or not all(isinstance(each, str) for each in value):
            raise _wrong(value, "a list of folders")
        return value


class LimitsSpec(TableSpec):
    """The limits of each control cycle; needs the arm to be read, by the context "arm"."""

    cycle: Annotated[float, _quantity("time", above_zero=True)] = CYCLE
    step: Any = None
    velocity: Any = None
    acceleration: Any = None
    position_margin: Any = 0.0

    @field_validator("cycle", mode="before")
    @classmethod
    def _short(cls, value: object) -> object:
        if read_quantity(value, "time") > LONGEST_CYCLE:
            raise _wrong(value, f"{LONGEST_CYCLE:g} s at most")
        return value

    @field_validator("step", "velocity", "acceleration")
    @classmethod
    def _for_joints(cls, value: object, info: ValidationInfo) -> Any:
        """A limit for all joints, for those that turn and those that slide, or one for each."""
        arm: Arm = (info.context or {})["arm"]
        turning, sliding = {
            "step": ("angle", "length"),
            "velocity": ("rate of turning", "speed"),
            "acceleration": ("rate of change of turning", "acceleration"),
        }[str(info.field_name)]
        if value == UNLIMITED:
            return math.inf
        if isinstance(value, list):
            kinds = [sliding if slides else turning for slides in arm.slides]
            return np.array(read_quantities(value, kinds, unlimited=True))
        if not isinstance(value, Mapping):
            both = "a table with both, as in {turning = ..., sliding = ...}"
            return _for_all(value, arm, both, turning, sliding)
        limit = np.full(arm.nv, np.inf)
        parts = {"turning": (turning, ~arm.slides), "sliding": (sliding, arm.slides)}
        for name, each in value.items():
            if name not in parts:
                hint = _did_you_mean(name, list(parts))
                raise Misplaced(f"there is no such key{hint}; allowed: turning, sliding", name)
            kind, joints = parts[name]
            limit[joints] = _within(name, _above_zero, each, kind)
        if info.field_name == "velocity":  # what is not said is as the description has it
            limit = np.where(np.isinf(limit), arm.limits.velocity, limit)
        return limit

    @field_validator("position_margin")
    @classmethod
    def _margin(cls, value: object, info: ValidationInfo) -> float:
        return _for_all(value, (info.context or {})["arm"], "a number, for all", "angle", "length")


def _for_all(value: object, arm: Arm, allowed: str, turning: str, sliding: str) -> float:
    """One number for all joints; with a unit only if all of them turn or all of them slide."""
    if isinstance(value, str) and np.any(arm.slides) and not np.all(arm.slides):
        raise ValueError(f"is {shown(value)}, and the arm turns and slides; allowed: {allowed}")
    return read_quantity(value, sliding if np.all(arm.slides) else turning)


class ControllerSpec(TableSpec):
    """The controller, by name, with what only geodesic knows."""

    name: Annotated[str, _one_of(*CONTROLLERS)] = "geodesic"
    joint_weight: NumberOrNone = None
    relative_position_weight: NumberOrNone = None


class StartSpec(TableSpec):
    """The configuration to start from; needs the arm to be read, by the context "arm"."""

    posture: Annotated[str | None, _one_of("straight", "neutral")] = None
    joints: Any = None

    @classmethod
    def check_keys(cls, values: Mapping[str, Any]) -> None:
        """Refuse to be told twice."""
        if "joints" in values and "posture" in values:
            raise Misplaced("does not go with 'joints'", "posture")

    @field_validator("joints")
    @classmethod
    def _positions(cls, value: object, info: ValidationInfo) -> list[float]:
        arm: Arm = (info.context or {})["arm"]
        return read_quantities(value, ["length" if slides else "angle" for slides in arm.slides])


class SceneSpec(TableSpec):
    """What to keep clear of: a file, or what would be in it."""

    file: TextOrNone = None
    version: Any = None
    obstacles: dict[str, ObstacleSpec] = Field(default_factory=dict)
    self_collision: Any = None
    margin: Annotated[float | None, _quantity("length")] = None
    arm_radius: Annotated[float | None, _quantity("length")] = None

    @classmethod
    def check_keys(cls, values: Mapping[str, Any]) -> None:
        """Refuse anything beside a file."""
        for key in values:
            if "file" in values and key != "file":
                raise Misplaced("there is no such key; allowed: file", key)

    @field_validator("obstacles", mode="before")
    @classmethod
    def _table(cls, value: object) -> object:
        if not isinstance(value, Mapping):
            raise _wrong(value, "a table")
        return value


class TipSpec(TableSpec):
    """What is asked of the tip, or of another control point; points are counted from 1."""

    position: Position
    rotation: Rotation = None
    point: int | str = -1
    weight: Number = 1.0
    priority: Flag = False
    direction_only: Flag = False
    length: LengthOrNone = None

    @field_validator("point", mode="before")
    @classmethod
    def _counted(cls, value: object) -> object:
        if isinstance(value, bool) or not isinstance(value, int | str) or value == 0:
            raise _wrong(
                value, "1 or more, counted from the base; -1 or less, counted from the tip; or a name"
            )
        return value


class KeyframeSpec(TableSpec):
    """A posture and its time; control points are counted from 1."""

    name: Text = ""
    curve: CurveSpec
    time: Time = None
    duration: Time = None
    hold: Annotated[float, _quantity("time")] = 0.0
    placement: Annotated[str | None, _one_of(*PLACEMENTS)] = None
    roll: Annotated[float, _quantity("angle")] = 0.0
    method: Annotated[str, _one_of(*METHODS)] = "auto"
    trim: Flag = False
    region: tuple[int, int] | None = None
    tip: TipSpec | None = None
    joints: Any = None

    @field_validator("region", mode="before")
    @classmethod
    def _counted(cls, value: object) -> object:
        whole = [isinstance(each, int) and not isinstance(each, bool) for each in _listed(value)]
        if whole != [True, True]:
            allowed = "two whole numbers: the first and the last control point, counted from 1 at the base"
            raise _wrong(value, allowed)
        first, last = _listed(value)
        if not 1 <= first <= last:
            raise _wrong(value, "1 or more, the last not before the first")
        return value

    @field_validator("joints")
    @classmethod
    def _positions(cls, value: object, info: ValidationInfo) -> list[float]:
        """Joint positions near which a posture is taken; those of another arm are read, and ignored later."""
        arm: Arm = (info.context or {})["arm"]
        own = ["length" if slides else "angle" for slides in arm.slides]
        count = len(_listed(value))
        return read_quantities(value, own if count in (0, len(own)) else ["angle"] * count)


class LeaderSpec(TableSpec):
    """The path that the leader takes."""

    path: CurveSpec
    speed: Annotated[float, _quantity("speed", above_zero=True)]
    depth: LengthOrNone = None
    placement: Annotated[str | None, _one_of(*PATH_PLACEMENTS)] = None
    method: Annotated[str, _one_of(*PATH_METHODS)] = "closest"
    and_back: Flag = False
    pipe: LengthOrNone = None


class OutputSpec(TableSpec):
    """What to keep of the result."""

    formats: tuple[str, ...] = RESULT_FORMATS

    @field_validator("formats", mode="before")
    @classmethod
    def _known(cls, value: object) -> object:
        if not isinstance(value, list) or not all(each in RESULT_FORMATS for each in value):
            raise _wrong(value, f"a list of {', '.join(RESULT_FORMATS)}")
        return tuple(each for each in RESULT_FORMATS if each in value)


class EditorSpec(TableSpec):
    """Files that the editor shows; whether they are there is its business."""

    scans: tuple[str, ...] = ()

    @field_validator("scans", mode="before")
    @classmethod
    def _names(cls, value: object) -> object:
        if not isinstance(value, list):
            raise _wrong(value, "a list of files")
        for number, name in enumerate(value):
            if not isinstance(name, str) or not name.strip() or "\0" in name:
                raise Misplaced(str(_wrong(name, "the name of a file")), number)
        return value


class TaskSpec(TableSpec):
    """A whole task file, but for the arm, which the rest is read for; it is the context "arm"."""

    version: Any = VERSION
    kind: Annotated[str, _one_of(*MOTION_KINDS)] = "keyframes"
    name: TextOrNone = None
    continuity: Annotated[str, _one_of(*CONTINUITIES)] = "velocity"
    arm: Any = None
    scene: SceneSpec = SceneSpec()
    keyframes: tuple[KeyframeSpec, ...] = ()
    leader: LeaderSpec | None = None
    limits: LimitsSpec = LimitsSpec()
    controller: ControllerSpec = ControllerSpec()
    start: StartSpec = StartSpec()
    output: OutputSpec = OutputSpec()
    editor: EditorSpec = EditorSpec()

    @classmethod
    def check_keys(cls, values: Mapping[str, Any]) -> None:
        """Refuse another version, and keys of another kind of motion."""
        version, kind = values.get("version", VERSION), values.get("kind", "keyframes")
        if version is True or version != VERSION:
            raise Misplaced(f"is {shown(version)}; allowed: {VERSION}", "version")
        if kind not in MOTION_KINDS:
            reason = _wrong(kind, ", ".join(map(repr, MOTION_KINDS)), _did_you_mean(kind, MOTION_KINDS))
            raise Misplaced(str(reason), "kind")
        for other, keys in _OWN.items():
            for key in keys:
                if key in values and other != kind:
                    raise Misplaced(f"goes with kind = {other!r}; the kind is {kind!r}", key)

    @classmethod
    def keys(cls, values: Mapping[str, Any]) -> list[str]:
        """Those of this kind of motion."""
        own = _OWN[values.get("kind", "keyframes")]
        others = {key for keys in _OWN.values() for key in keys} - set(own)
        return [key for key in cls.model_fields if key not in others]

    @field_validator("keyframes", mode="before")
    @classmethod
    def _tables(cls, value: object) -> object:
        if not isinstance(value, list) or not all(isinstance(each, Mapping) for each in value):
            raise _wrong(value, "a list of tables, each begun by [[keyframes]]")
        return value


_OWN = {"keyframes": ("keyframes", "continuity"), "follow_leader": ("leader",)}
