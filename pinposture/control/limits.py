"""What a step may not exceed."""

from __future__ import annotations

from dataclasses import dataclass, fields
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from pinposture.arm import ArmState
from pinposture.control.checks import require_positive
from pinposture.errors import InvalidValue

Array = NDArray[np.float64]


USUAL_STEP = 0.1
"""Joint travel of a step where limits allow more, or where there are none [rad]."""


class LimitedStep(NamedTuple):
    """A step after the limits were applied.

    Attributes:
        dq: joint displacement, (nv,) [rad or m].
        scale: factor by which the whole step was shortened to meet the step limit, in (0, 1].
        clipped: which joints were cut short at a position limit, (nv,).
    """

    dq: Array
    scale: float
    clipped: NDArray[np.bool_]


@dataclass(frozen=True, eq=False)
class Limits:
    """Limits of one control step. Joint position limits of the arm always hold as well.

    Attributes:
        step: largest |dq| of each joint in one step [rad or m]; one number or (nv,). None: no such limit.
        velocity: largest joint speed [rad/s or m/s]; one number or (nv,). Needs `dt`. None: the arm's own.
        dt: duration of a step [s]. None: speeds are not limited.
        position_margin: distance to keep from each joint position limit [rad or m].
    """

    step: float | Array | None = 0.1
    velocity: float | Array | None = None
    dt: float | None = None
    position_margin: float = 0.0

    def __post_init__(self) -> None:
        for name in ("step", "velocity"):
            value = getattr(self, name)
            if value is not None:
                object.__setattr__(self, name, _positive(name, value))
        if self.dt is not None:
            require_positive("dt", self.dt)
            object.__setattr__(self, "dt", float(self.dt))
        if self.velocity is not None and self.dt is None:
            raise InvalidValue("dt", None, "a positive duration [s], needed to limit the velocity")
        require_positive("position_margin", self.position_margin, zero=True)
        object.__setattr__(self, "position_margin", float(self.position_margin))

    def __eq__(self, other: object) -> bool:
        if not isinstance(other, Limits):
            return NotImplemented
        return all(
            np.array_equal(getattr(self, each.name), getattr(other, each.name)) for each in fields(self)
        )

    def __hash__(self) -> int:
        return hash((str(self.step), str(self.velocity), self.dt, self.position_margin))

    def bound(self, state: ArmState) -> Array:
        """Largest |dq| of each joint in one step, (nv,) [rad or m]; infinite where there is no limit."""
        arm = state.arm
        bound = np.full(arm.nv, np.inf)
        for name, value, factor in (("step", self.step, 1.0), ("velocity", self.velocity, self.dt)):
            if value is not None and factor is not None:
                if np.ndim(value) == 1 and len(np.asarray(value)) != arm.nv:
                    raise InvalidValue(f"{name} (shape)", np.shape(value), f"one number or ({arm.nv},)")
                bound = np.minimum(bound, np.asarray(value) * factor)
        if self.dt is not None and self.velocity is None:
            bound = np.minimum(bound, arm.limits.velocity * self.dt)
        return bound

    def travel(self, state: ArmState) -> float:
        """Joint travel that limits allow in a step, median over the joints, at most `USUAL_STEP` [rad]."""
        arm = state.arm
        return min(USUAL_STEP, float(np.median((self.bound(state) / arm.joint_units)[arm.columns])))

    def apply(self, state: ArmState, dq: Array) -> LimitedStep:
        """Shorten a step until it meets the step limit, then cut it at the position limits.

        A joint that is outside its position limits to begin with is brought back, no faster than the
        step limit allows.

        Args:
            state: where the step begins.
            dq: the step asked for, (nv,) [rad or m].
        """
        bound = self.bound(state)
        largest = float(np.max(np.abs(dq) / bound, initial=0.0))
        scale = 1.0 / largest if largest > 1.0 else 1.0
        scaled = dq * scale
        positions = state.arm.positions(state.q)
        limits, moved = state.arm.limits, state.arm.frames.support[-1, 0] > 0.0
        # What does not move the arm is not ours to bring back.
        lower = np.where(moved, limits.lower + self.position_margin, -np.inf)
        upper = np.where(moved, limits.upper - self.position_margin, np.inf)
        if np.any(lower > upper):
            joint = int(np.argmax(lower - upper))
            room = (limits.upper[joint] - limits.lower[joint]) / 2.0
            allowed = f"at most {room:.4g}, half the range of degree of freedom {joint}"
            raise InvalidValue("position_margin", self.position_margin, allowed)
        clipped = np.clip(np.clip(scaled, lower - positions, upper - positions), -bound, bound)
        return LimitedStep(clipped, scale, clipped != scaled)


def _positive(name: str, value: ArrayLike) -> float | Array:
    allowed = "a positive number, or one for each degree of freedom"
    try:
        array = np.array(value, dtype=np.float64)
    except (TypeError, ValueError):
        raise InvalidValue(name, value, allowed) from None
    if isinstance(value, bool) or array.ndim > 1 or array.size == 0 or not np.all(array > 0.0):
        raise InvalidValue(name, value, allowed)
    if array.ndim == 0:
        return float(array)
    array.flags.writeable = False
    return array
