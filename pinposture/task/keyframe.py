"""Keyframes: postures to take at given times."""

from __future__ import annotations

import math
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from numbers import Real
from typing import Literal

import numpy as np

from pinposture.arm.checks import finite_vector
from pinposture.control.checks import is_whole
from pinposture.control.tasks import EndEffector
from pinposture.curve import Curve
from pinposture.errors import InvalidValue, PostureError, TaskError, UnknownName
from pinposture.scene import Scene
from pinposture.target.resolve import METHODS, PLACEMENTS


@dataclass(frozen=True)
class Keyframe:
    """A posture to take at a given time.

    Attributes:
        curve: the shape to take.
        time: when, counted from the beginning of the motion [s]; or None if a duration is given.
        duration: how long after the keyframe before, counted from the end of its hold [s]; or None. The first
            keyframe is at 0 and needs neither.
        hold: how long to stay there [s]. A keyframe with a hold is taken at rest, and so are the first and
            the last one; the others are passed through.
        name: what to call it; empty to call it by its number.
        placement: as for `resolve_targets`; None for what `usual_placement` says.
        roll: as for `resolve_targets` [rad].
        method: as for `resolve_targets`.
        tip: the task of one control point, usually the tip, while the arm takes the posture; None if there is
            none. The posture gives way to it if it is strict, and is weighed against it if not.
        region: first and last control point that have to take the posture, 0-based, the last included; None
            for all. The others are free: to serve the tip, and not to be counted.
        joints: joint positions to take the posture near, as of `Arm.positions`, (nv,) [rad or m]; None if any
            will do. Where least squares place the modules, several configurations may take a posture equally
            well: this tells which. What does not fit the arm is ignored with a warning.
        trim: True to take the first part of a curve that is longer than the arm covers, by more than a
            module; False to refuse it.

    Raises:
        InvalidValue: a value other than described.
        UnknownName: a `placement` or `method` that does not exist.
    """

    curve: Curve
    time: float | None = None
    duration: float | None = None
    hold: float = 0.0
    name: str = ""
    placement: Literal["as_is", "translate", "align"] | None = None
    roll: float = 0.0
    method: Literal["auto", "sequential", "smooth", "closest"] = "auto"
    tip: EndEffector | None = None
    region: tuple[int, int] | None = None
    trim: bool = False
    joints: tuple[float, ...] | None = None

    def __post_init__(self) -> None:
        if not isinstance(self.name, str):
            raise InvalidValue("name", self.name, "text, or empty for the number of the keyframe")
        with naming(f"keyframe {self.name!r}" if self.name else "keyframe"):
            self._check()

    def _check(self) -> None:
        if not isinstance(self.curve, Curve):
            raise InvalidValue("curve", self.curve, "a Curve")
        if self.time is not None and self.duration is not None:
            given = {"time": self.time, "duration": self.duration}
            raise InvalidValue("time and duration", given, "one of them, and None for the other")
        for name in ("time", "duration", "hold"):
            value = getattr(self, name)
            if value is not None or name == "hold":
                _require(name, value, "a finite number >= 0 [s]", 0.0)
        _require("roll", self.roll, "a finite angle [rad]", -math.inf)
        for kind, value, allowed in (
            ("placement", self.placement, PLACEMENTS),
            ("method", self.method, METHODS),
        ):
            if value not in allowed and not (kind == "placement" and value is None):
                raise UnknownName(kind, value, allowed)
        if self.tip is not None and not isinstance(self.tip, EndEffector):
            raise InvalidValue("tip", self.tip, "an EndEffector, or None")
        if self.region is not None:
            ends = tuple(self.region) if isinstance(self.region, tuple | list) else ()
            if len(ends) != 2 or not all(map(is_whole, ends)) or not 0 <= ends[0] <= ends[1]:
                raise InvalidValue(
                    "region", self.region, "two whole numbers (first, last), 0 <= first <= last"
                )
            object.__setattr__(self, "region", (int(ends[0]), int(ends[1])))
        if not isinstance(self.trim, bool):
            raise InvalidValue("trim", self.trim, "True or False")
        if self.joints is not None:
            joints = finite_vector("joints", self.joints, np.size(self.joints))
            object.__setattr__(self, "joints", tuple(joints.tolist()))


def usual_placement(scene: Scene | None) -> Literal["as_is", "align"]:
    """How curves are laid where nobody says: among obstacles they stay where they are drawn."""
    return "as_is" if scene is not None and scene.obstacles else "align"


def _require(name: str, value: object, allowed: str, least: float) -> None:
    number = isinstance(value, Real) and not isinstance(value, bool)
    if not (number and math.isfinite(value) and value >= least):  # type: ignore[arg-type, operator]
        raise InvalidValue(name, value, allowed)


@contextmanager
def naming(where: str) -> Iterator[None]:
    """Say of what goes wrong inside where it did: errors keep their kind and their data."""
    try:
        yield
    except TaskError:  # it says so itself
        raise
    except PostureError as error:
        error.args = (f"{where}: {error}",)
        raise


def title(keyframes: tuple[Keyframe, ...], index: int) -> str:
    """What to call a keyframe in a message: its number from 1, and its name if it has one."""
    name = keyframes[index].name
    return f"keyframe {index + 1} {name!r}" if name else f"keyframe {index + 1}"
