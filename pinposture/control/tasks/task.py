"""What every task is: rows that a step should satisfy, and how much they count."""

from __future__ import annotations

from dataclasses import dataclass, fields
from typing import NamedTuple, Protocol

import numpy as np
from numpy.typing import ArrayLike, NDArray

from pinposture.arm import Arm, ArmState
from pinposture.control.checks import require_positive
from pinposture.errors import InvalidValue
from pinposture.target import Target

Array = NDArray[np.float64]


class TaskRows(NamedTuple):
    """What a task asks of a step: jacobian @ dq = error.

    Attributes:
        jacobian: rows, (r, nv) [m/rad, or m/m where a joint slides]; zero for joints off the chain.
        error: what each row should cover, (r,) [m].
    """

    jacobian: Array
    error: Array


class Task(Protocol):
    """Something to be done besides taking the target posture."""

    @property
    def weight(self) -> float:
        """Weight of the squared error of each row, where that of a control point has weight 1."""

    @property
    def strict(self) -> bool:
        """Whether it comes before all else: the rest has the freedom that it leaves."""

    def rows(self, state: ArmState, target: Target) -> TaskRows:
        """What the task asks of a step.

        Args:
            state: where the arm is.
            target: the target posture that the arm is taking.

        Raises:
            InvalidValue: the task does not fit the arm.
            UnknownName: it names a control point or joint that the arm does not have.
        """


@dataclass(frozen=True, eq=False)
class Described:
    """A task described by its fields alone; two are equal if all their fields are."""

    def __eq__(self, other: object) -> bool:
        return self._key() == other._key() if type(other) is type(self) else NotImplemented

    def __hash__(self) -> int:
        return hash(self._key())

    def _key(self) -> tuple[object, ...]:
        values = (getattr(self, each.name) for each in fields(self))
        return tuple((v.shape, *v.ravel().tolist()) if isinstance(v, np.ndarray) else v for v in values)

    def _settle(self, name: str, value: object) -> None:
        """Set a field of the frozen task while it is made; arrays become read-only."""
        if isinstance(value, np.ndarray):
            value.flags.writeable = False
        object.__setattr__(self, name, value)

    def _settle_scales(self, weight: float, length: float | None) -> None:
        """Set the weight and the lever, or raise InvalidValue unless they are finite numbers above 0."""
        require_positive("weight", weight)
        self._settle("weight", float(weight))
        if length is not None:
            require_positive("length", length)
            self._settle("length", float(length))


def lever(arm: Arm, length: float | None) -> float:
    """How far a turn of one radian moves something [m/rad]: the length given, or `Arm.sliding_unit`."""
    return arm.sliding_unit if length is None else length


def finite_array(name: str, values: ArrayLike, shape: tuple[int | None, ...]) -> Array:
    """A fresh array of finite floats; None in the shape stands for any number above 0.

    Raises:
        InvalidValue: not numbers, another shape, or an entry that is not finite; names the entry.
    """
    words = f"finite numbers of shape {shape}".replace("None", "k")
    try:
        array = np.array(values, dtype=np.float64)
    except (TypeError, ValueError):
        array = np.zeros(0)
    if values is None or array.size == 0:
        raise InvalidValue(name, values, words)
    fits = array.ndim == len(shape)
    if not (fits and all(want in (None, have) for have, want in zip(array.shape, shape, strict=True))):
        raise InvalidValue(f"{name} (shape)", array.shape, words)
    for where in np.argwhere(~np.isfinite(array))[:1]:
        raise InvalidValue(f"{name}{where.tolist()}", float(array[tuple(where)]), words)
    return array
