"""Specification of an arm as plain data: modules of a template, or a URDF."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any, TypeAlias

import numpy as np
import pinocchio as pin
from numpy.typing import NDArray
from pydantic import (
    BaseModel,
    ConfigDict,
    Field,
    PositiveFloat,
    PositiveInt,
    ValidationError,
    field_validator,
    model_validator,
)

from pinposture._validation import require_whole
from pinposture.arm.configurations import MOST_MOVING
from pinposture.arm.macros import read_arguments
from pinposture.arm.template import JointSpec, ModuleTemplate, template
from pinposture.arm.urdf_reader import is_urdf_text
from pinposture.errors import InvalidValue

Vector: TypeAlias = tuple[float, float, float]

ANGLE_ROUNDING = 1e-15
"""Largest error of each entry of a rotation matrix rebuilt from three rounded angles."""


class Specification(BaseModel):
    """Immutable plain data in SI units, compared by value.

    Raises:
        InvalidValue: a value is missing, unknown or of the wrong type; names the first such value.
    """

    model_config = ConfigDict(frozen=True, extra="forbid", allow_inf_nan=False)

    def __init__(self, **values: Any) -> None:
        try:
            super().__init__(**values)
        except ValidationError as error:
            first = error.errors()[0]
            name = ".".join(map(str, first["loc"])) or type(self).__name__
            raise InvalidValue(name, first["input"], first["msg"]) from None

    def __repr_args__(self) -> Iterator[tuple[str | None, Any]]:
        for name, value in super().__repr_args__():
            if value is not None and value is not False and value not in ({}, ()):
                yield name, f"{value[:60]}..." if isinstance(value, str) and len(value) > 60 else value


class PlacementSpec(Specification):
    """A placement in the world.

    Attributes:
        position: x, y, z [m].
        rotation: roll, pitch and yaw [rad].
    """

    position: Vector = (0.0, 0.0, 0.0)
    rotation: Vector = (0.0, 0.0, 0.0)

    def build(self) -> pin.SE3:
        """Return the placement."""
        return pin.SE3(pin.rpy.rpyToMatrix(*self.rotation), np.array(self.position))

    @classmethod
    def of(cls, placement: pin.SE3) -> PlacementSpec:
        """Describe a placement; its rotation is accurate to 1e-15."""
        return cls(position=placement.translation.tolist(), rotation=roll_pitch_yaw(placement.rotation))


def roll_pitch_yaw(rotation: NDArray[np.float64]) -> Vector:
    """Return the angles of a rotation matrix (3, 3) [rad], with as few digits as needed to reproduce it."""
    angles = np.asarray(pin.rpy.matrixToRpy(rotation))
    for digits in range(3, 17):
        rounded = np.round(angles, digits) + 0.0  # no negative zero
        if np.abs(pin.rpy.rpyToMatrix(*rounded) - rotation).max() <= ANGLE_ROUNDING:
            angles = rounded
            break
    roll, pitch, yaw = map(float, angles)
    return roll, pitch, yaw


class FeedSpec(Specification):
    """A slide at the base that feeds the whole arm along its axis.

    Attributes:
        stroke: largest position [m].
        length: length of the link after the slide [m]; that of a module if None.
        speed: largest speed [m/s].
    """

    stroke: PositiveFloat
    length: float | None = None
    speed: PositiveFloat = 0.1


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


class ArmSpec(Specification):
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
        base: first link of the arm; the root if None.
        tip: last link of the arm, as in `Arm.load`.
        split: how the chain is split into modules, as `modules` in `Arm.load`.
        locked: locked joints and their positions [rad or m].
        package_dirs: folders in which viewers look for meshes, and xacro for packages.
        couplings: joints that follow others, as in `Arm.load`.
        xacro_args: values of xacro arguments, as text.
        hard_limits: whether soft limits are ignored, as in `Arm.load`.
        placement: placement of the base in the world; the origin if None.
        characteristic_length: sliding distance equivalent to one radian [m]; the mean module length if None.
    """

    template: str | None = None
    modules: PositiveInt | None = None
    link_lengths: tuple[float, ...] | None = None
    joint_limits: tuple[float, float] | None = None
    feed: FeedSpec | None = None
    urdf: Path | str | None = None
    base: str | None = None
    tip: str | None = None
    split: int | tuple[int, ...] | tuple[str, ...] | None = None
    locked: dict[str, float] = Field(default_factory=dict)
    package_dirs: tuple[Path, ...] = ()
    couplings: dict[str, str | tuple[str, float] | tuple[str, float, float]] = Field(default_factory=dict)
    xacro_args: dict[str, str] = Field(default_factory=dict)
    hard_limits: bool = False
    placement: PlacementSpec | None = None
    characteristic_length: PositiveFloat | None = None

    @field_validator("urdf")
    @classmethod
    def _path_or_text(cls, source: Path | str | None) -> Path | str | None:
        return Path(source) if isinstance(source, str) and not is_urdf_text(source) else source

    @field_validator("xacro_args", mode="before")
    @classmethod
    def _as_text(cls, given: object) -> dict[str, str]:
        return read_arguments(given)

    @model_validator(mode="after")
    def _one_source(self) -> ArmSpec:
        kind, other = (OF_A_URDF, OF_A_TEMPLATE) if self.urdf is not None else (OF_A_TEMPLATE, OF_A_URDF)
        for key in other:
            if getattr(self, key) not in (None, {}, (), False):
                raise ValueError(f"{key!r} does not go with {kind[0]!r}")
        return self

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
        if self.feed is None:
            return modules
        length = module.length if self.feed.length is None else self.feed.length
        with _named("feed"):
            slide = JointSpec("x", "prismatic", 0.0, self.feed.stroke, velocity=self.feed.speed)
            return [ModuleTemplate("Feed", (slide,), (length,), module.radius), *modules]


@contextmanager
def _named(key: str) -> Iterator[None]:
    """Make `InvalidValue` errors name this key of the specification."""
    try:
        yield
    except InvalidValue as error:
        raise InvalidValue(key, error.value, error.allowed) from None
