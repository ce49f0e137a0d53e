"""Specification of an arm as plain data: modules of a template, or a URDF."""

from __future__ import annotations

from collections.abc import Collection, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import field, fields
from pathlib import Path
from typing import Annotated, Any, TypeAlias, cast

import numpy as np
import pinocchio as pin
from pydantic import BeforeValidator, ValidationInfo, model_validator

from pinposture._validation import is_usable, is_whole, require_whole
from pinposture.arm.configurations import MOST_MOVING
from pinposture.arm.macros import read_arguments
from pinposture.arm.template import JointSpec, ModuleTemplate, template
from pinposture.arm.urdf import is_urdf_text, roll_pitch_yaw
from pinposture.arm.weight import Weight
from pinposture.errors import InvalidValue
from pinposture.schema import (
    AnyLength,
    Declared,
    Flag,
    InputFile,
    Length,
    NotAllowed,
    Position,
    Refusal,
    Rotation,
    Speed,
    Table,
    Text,
    declared,
    in_file,
    is_list_of,
    is_table,
    is_text,
    quantities,
    quantity,
    read_by,
    read_quantities,
    read_quantity,
    read_within,
    refusing,
)
from pinposture.storage import settled


@declared()
class PoseSpec(Declared):
    """A placement in the world.

    Attributes:
        position: x, y, z [m].
        rotation: roll, pitch and yaw [rad].
    """

    position: Position = (0.0, 0.0, 0.0)
    rotation: Rotation = (0.0, 0.0, 0.0)

    def build(self) -> pin.SE3:
        """Return the placement."""
        return pin.SE3(pin.rpy.rpyToMatrix(*self.rotation), np.array(self.position))

    @classmethod
    def of(cls, placement: pin.SE3) -> PoseSpec:
        """Describe a placement; its rotation is accurate to 1e-15."""
        return cls(position=placement.translation.tolist(), rotation=roll_pitch_yaw(placement.rotation))


@declared()
class FeedSpec(Declared):
    """A slide at the base that feeds the whole arm along its axis.

    Attributes:
        stroke: largest position [m].
        length: length of the link after the slide [m]; that of a module if None.
        speed: largest speed [m/s].
    """

    stroke: Length
    length: AnyLength | None = None
    speed: Speed = 0.1

    def before(self, module: ModuleTemplate) -> ModuleTemplate:
        """Return the slide as a module, for an arm of modules of a kind."""
        length = module.length if self.length is None else self.length
        with _named("feed"):
            slide = JointSpec("x", "prismatic", 0.0, self.stroke, velocity=self.speed)
            return ModuleTemplate("Feed", (slide,), (length,), module.radius)


Split: TypeAlias = "int | tuple[int, ...] | tuple[str, ...]"
"""How to split a chain: joints per module, one number for all or one each, or links where modules end."""

OF_A_TEMPLATE = ("template", "modules", "link_lengths", "joint_limits", "feed")
OF_A_URDF = (
    "urdf",
    "base",
    "tip",
    "split",
    "locked",
    "package_dirs",
    "couplings",
    "xacro_args",
    "hard_limits",
)


MOST_MODULES_IN_FILE = 1000
"""Largest number of modules in a file."""


def _read_modules(value: Any, info: ValidationInfo) -> int:
    most = MOST_MOVING if in_file(info) is None else MOST_MODULES_IN_FILE
    if not is_whole(value) or not 1 <= value <= most:
        raise NotAllowed(value, f"a whole number, 1 to {most}")
    return int(value)


def _read_template(value: object, info: ValidationInfo) -> str:
    if not isinstance(value, str):
        raise NotAllowed(value, "text")
    if in_file(info) is not None:  # a call names it when the arm is made
        with refusing():
            template(value)
    return value


def _read_link_lengths(value: Any, info: ValidationInfo) -> tuple[float, ...]:
    name = info.data.get("template")
    count = np.size(value) if in_file(info) is None or name is None else len(template(name).joints)
    return read_quantities(value, ["length"] * count)


def _read_urdf(value: object, info: ValidationInfo) -> Path | str:
    source = in_file(info)
    if not isinstance(value, str if source is not None else str | Path):
        raise NotAllowed(value, "text")
    if source is not None:
        return settled(source.resolve(str(value)))
    return Path(value) if isinstance(value, str) and not is_urdf_text(value) else cast("Path | str", value)


def _read_split(value: Any, _: ValidationInfo) -> Any:
    plain = value.tolist() if isinstance(value, np.ndarray | np.integer) else value
    listed = list(plain) if isinstance(plain, list | tuple) else [plain]
    if not listed or not any(is_list_of(test)(listed) for test in (is_whole, is_text)):
        raise NotAllowed(value, "a whole number, whole numbers, or names of links")
    return plain if is_whole(plain) else tuple(listed)


def _read_coupling(value: object, _: ValidationInfo) -> Any:
    """Read the joint that another follows, and perhaps a ratio and an offset."""
    listed = value if isinstance(value, list | tuple) else [value]
    if not 1 <= len(listed) <= 3 or not isinstance(listed[0], str):
        raise NotAllowed(value, "the name of a joint; or that, a ratio, and perhaps an offset, in a list")
    name, *numbers = listed
    if numbers and not is_usable(numbers[0]):
        raise NotAllowed(numbers[0], "a number, the ratio")
    if len(numbers) < 2:
        return (name, *numbers) if numbers else name
    return name, numbers[0], read_within(2, read_quantity, numbers[1], "angle", "length")


def _read_folders(value: Any, info: ValidationInfo) -> tuple[Path, ...]:
    source = in_file(info)
    if source is None:
        listed = [value] if isinstance(value, str | Path) else value
        if not is_list_of(lambda item: isinstance(item, str | Path))(listed):
            raise NotAllowed(value, "paths of folders")
        return tuple(Path(folder).absolute() for folder in listed)
    if not is_list_of(is_text)(value):
        raise NotAllowed(value, "a list of folders")
    return tuple(settled(source.resolve(source_path)) for source_path in value)


def _read_xacro_args(value: object, info: ValidationInfo) -> dict[str, str]:
    if in_file(info) is not None and not is_table(value):
        raise NotAllowed(value, "a table")
    try:
        return read_arguments(value)
    except InvalidValue as error:
        _, _, argument = error.name.partition(".")
        raise NotAllowed(error.value, error.allowed, *filter(None, [argument])) from error


def _of_fields(kind: type) -> BeforeValidator:
    """Accept the fields of a class as a mapping in Python, too."""

    def read(value: Any, info: ValidationInfo) -> Any:
        return kind(**value) if in_file(info) is None and is_table(value) else value

    return BeforeValidator(read)


@declared()
class ArmSpec(Declared):
    """Specification of an arm: modules of a template, or a URDF. `Arm.from_spec` builds the arm.

        spec = ArmSpec(template="RyRz", modules=20)
        spec = ArmSpec(urdf=Path("snake.urdf"), tip="head", split=2)

    Attributes:
        template: name of a module template.
        modules: number of modules.
        link_lengths: length of the link after each joint of a module [m]; the template's own if None.
        joint_limits: smallest and largest position of each revolute joint [rad]; the template's own if None.
        feed: a slide before the first module; none if None.
        urdf: a URDF file, or its text.
        base: first link of the arm, which needs a tip; the root if None.
        tip: last link of the arm; the end of the longest moving chain if None.
        split: joints per module, one number for all or one for each, or names of the links at whose origins
            modules end; as few joints as can follow any curve if None.
        locked: joints to lock, and their positions [rad or m].
        package_dirs: folders in which viewers look for meshes, and xacro for packages (`$(find ...)`).
        couplings: joints that follow others, as <mimic> says it: the leader; or the leader, a ratio, and an
            offset [rad or m].
        xacro_args: values of the arguments of a xacro source.
        hard_limits: whether to ignore the soft position limits of <safety_controller>, which otherwise narrow
            those of <limit>.
        placement: placement of the base in the world; the origin if None.
        characteristic_length: sliding distance equivalent to one radian [m]; the mean module length if None.
        weight: what it carries, its torque limits and gravity, where the description does not say.
    """

    template: Annotated[str, read_by(_read_template)] | None = None
    modules: Annotated[int, read_by(_read_modules)] | None = None
    link_lengths: Annotated[tuple[float, ...], read_by(_read_link_lengths)] | None = None
    joint_limits: Annotated[tuple[float, ...], quantities("angle", 2)] | None = None
    feed: Annotated[FeedSpec | None, _of_fields(FeedSpec)] = None
    urdf: Annotated[Path | str, read_by(_read_urdf)] | None = None
    base: Text | None = None
    tip: Text | None = None
    split: Annotated[Split, read_by(_read_split)] | None = None
    locked: Annotated[dict[str, Annotated[float, quantity("angle", "length")]], Table] = field(
        default_factory=dict
    )
    package_dirs: Annotated[tuple[Path, ...], read_by(_read_folders)] = ()
    couplings: Annotated[
        dict[
            str,
            Annotated[str | tuple[str, float] | tuple[str, float, float], read_by(_read_coupling)],
        ],
        Table,
    ] = field(default_factory=dict)
    xacro_args: Annotated[dict[str, str], read_by(_read_xacro_args)] = field(default_factory=dict)
    hard_limits: Flag = False
    placement: Annotated[PoseSpec | None, _of_fields(PoseSpec)] = None
    characteristic_length: Length | None = None
    weight: Annotated[Weight | None, _of_fields(Weight)] = None

    def __repr__(self) -> str:
        shown = []
        for item in fields(self):
            value = getattr(self, item.name)
            if value is None or value is False or value in ({}, ()):
                continue
            text = f"{value[:60]}..." if isinstance(value, str) and len(value) > 60 else value
            shown.append(f"{item.name}={text!r}")
        return f"ArmSpec({', '.join(shown)})"

    @model_validator(mode="after")
    def _one_source(self) -> ArmSpec:
        if self.urdf is None and self.template is None:
            return self
        kind, other = (OF_A_URDF, OF_A_TEMPLATE) if self.urdf is not None else (OF_A_TEMPLATE, OF_A_URDF)
        for key in other:
            if getattr(self, key) not in (None, {}, (), False):
                raise Refusal(f"{key!r} does not go with {kind[0]!r}")
        return self

    @classmethod
    def check_keys(cls, values: Mapping[str, Any]) -> Collection[str]:
        """Refuse keys of an arm of another kind."""
        kind, other = (OF_A_URDF, OF_A_TEMPLATE) if "urdf" in values else (OF_A_TEMPLATE, OF_A_URDF)
        for key in other:
            if key in values:
                raise Refusal(f"does not go with {kind[0]!r}", key)
        return super().check_keys(values)

    @classmethod
    def from_table(cls, values: Mapping[str, Any], source: InputFile) -> Mapping[str, Any]:
        """Refuse an arm without URDF or template, and a template without a number of modules."""
        if "urdf" not in values and "template" not in values:
            raise Refusal("needs one of the keys 'urdf', 'template'")
        if "template" in values and "modules" not in values:
            raise Refusal("the key 'modules' is missing")
        return values

    def module_templates(self) -> list[ModuleTemplate]:
        """Return the modules of a template from base to tip, the feed first.

        Raises:
            UnknownName: there is no such template.
            InvalidValue: an invalid value; names its key.
        """
        if self.template is None or self.modules is None:
            raise InvalidValue("template", self.template, "the name of a template, and a number of modules")
        module = template(self.template)
        if self.link_lengths is not None:
            with _named("link_lengths"):
                module = module.with_lengths(self.link_lengths)
        if self.joint_limits is not None:
            with _named("joint_limits"):
                module = module.with_limits(*self.joint_limits)
        require_whole("modules", self.modules, 1, MOST_MOVING)
        modules = [module] * self.modules
        return modules if self.feed is None else [self.feed.before(module), *modules]


@contextmanager
def _named(key: str) -> Iterator[None]:
    """Make `InvalidValue` errors name this key of the specification."""
    try:
        yield
    except InvalidValue as error:
        raise InvalidValue(key, error.value, error.allowed) from None
