"""The motion that is asked for, in time: what a task comes down to before anything moves."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from pinposture.arm import Arm
from pinposture.control import EndEffector
from pinposture.errors import InvalidValue
from pinposture.target import Target

Array = NDArray[np.float64]


class Mark(NamedTuple):
    """A place of a reference with a name.

    Attributes:
        name: what it is called.
        row: the row of the reference that it is.
        target: what the arm should take there; at this row it stands for the target of the reference. Its
            residual is how far that is off the curve.
        tip: what the tip should do there; None if nothing.
    """

    name: str
    row: int
    target: Target
    tip: EndEffector | None = None


@dataclass(frozen=True, eq=False)
class Reference:
    """Target postures at equal distances in time, and a configuration that takes each.

    It begins and ends at rest. Rows are close enough to each other to be joined smoothly.

    Attributes:
        arm: the arm.
        interval: time from one row to the next, if nothing slows the motion [s].
        start: the configuration of the first row, (nq,).
        offsets: joint displacement of each row from the first, the way round that the arm is to go,
            (N + 1, nv) [rad or m]; the first is zero.
        weights: whether each control point has a target, as in `Target`, (N + 1, m).
        marks: rows with a name, in order; keyframes have one each.
    """

    arm: Arm
    interval: float
    start: Array
    offsets: Array
    weights: Array
    marks: tuple[Mark, ...] = ()

    def __post_init__(self) -> None:
        rows, arm = len(self.offsets), self.arm
        if self.offsets.shape != (rows, arm.nv) or rows < 2:
            raise InvalidValue("offsets (shape)", self.offsets.shape, f"(2 or more, {arm.nv})")
        if self.weights.shape != (rows, arm.n_modules):
            raise InvalidValue("weights (shape)", self.weights.shape, f"({rows}, {arm.n_modules})")
        if not np.all(np.isfinite(self.offsets)):
            raise InvalidValue("offsets", self.offsets, "finite numbers")

    @property
    def rows(self) -> int:
        """Number of rows, N + 1."""
        return len(self.offsets)

    @property
    def duration(self) -> float:
        """How long it takes if nothing slows it [s]."""
        return self.interval * (self.rows - 1)

    @cached_property
    def times(self) -> Array:
        """When each row is to be reached, if nothing slows the motion, (N + 1,) [s]."""
        return np.asarray(self.interval * np.arange(self.rows, dtype=np.float64))

    def configuration(self, row: int) -> Array:
        """The configuration of a row, (nq,)."""
        return self.arm.integrate(self.start, self.offsets[row])
