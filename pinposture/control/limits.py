"""What a step may not exceed."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import NamedTuple
from weakref import WeakKeyDictionary

import numpy as np
from numpy.typing import ArrayLike, NDArray

from pinposture import kernels
from pinposture.arm import Arm, ArmState
from pinposture.arm.checks import finite_vector
from pinposture.control.braking import full_braking
from pinposture.control.checks import require_positive
from pinposture.control.giving_way import relaxed_limits
from pinposture.control.joint_bounds import JointBounds, joint_bounds
from pinposture.errors import InvalidValue

Array = NDArray[np.float64]

ROUNDING = 1e-9
"""What a limit may be exceeded by without being named [rad or m]."""


class Box(NamedTuple):
    """The steps that the limits allow: all dq with lower <= dq <= upper. There always are some.

    Attributes:
        lower: smallest joint displacement, (nv,) [rad or m].
        upper: largest joint displacement, (nv,) [rad or m].
        relaxed: the limits that cannot be kept from here on, in words; see `Limits.box`.
        outside: whether a joint of the chain is outside its position limits, by more than rounding.
        sides: both of the former, (2, nv), for kernels.
    """

    lower: Array
    upper: Array
    relaxed: tuple[str, ...]
    outside: bool
    sides: Array


class LimitedStep(NamedTuple):
    """A step after the limits were applied.

    Attributes:
        dq: joint displacement, (nv,) [rad or m].
        scale: factor by which the whole step was shortened to meet the step limit, in (0, 1].
        clipped: which joints were cut short at a position limit, or on their way to it because they could not
            stop there otherwise, (nv,).
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
        acceleration: largest joint acceleration [rad/s^2 or m/s^2]; one number or (nv,). Needs `dt`. In one
            step dq changes by at most acceleration * dt^2, and joints brake early enough to stop at their
            position limits. None: no such limit.
    """

    step: float | Array | None = 0.1
    velocity: float | Array | None = None
    dt: float | None = None
    position_margin: float = 0.0
    acceleration: float | Array | None = None

    def __post_init__(self) -> None:
        for name in ("step", "velocity", "acceleration"):
            value = getattr(self, name)
            if value is not None:
                object.__setattr__(self, name, _positive(name, value))
        if self.dt is not None:
            require_positive("dt", self.dt)
            object.__setattr__(self, "dt", float(self.dt))
        for name in ("velocity", "acceleration"):
            if getattr(self, name) is not None and self.dt is None:
                raise InvalidValue("dt", None, f"a positive duration [s], needed to limit the {name}")
        require_positive("position_margin", self.position_margin, zero=True)
        object.__setattr__(self, "position_margin", float(self.position_margin))

    @cached_property
    def _key(self) -> tuple[object, ...]:
        values = (self.step, self.velocity, self.acceleration)
        numbers = [value.tobytes() if isinstance(value, np.ndarray) else value for value in values]
        return (*numbers, self.dt, self.position_margin)

    def __eq__(self, other: object) -> bool:
        return self._key == other._key if isinstance(other, Limits) else NotImplemented

    def __hash__(self) -> int:
        return hash(self._key)

    def bound(self, state: ArmState) -> Array:
        """Largest |dq| of each joint in one step, (nv,) [rad or m]; infinite where there is no limit."""
        bound: Array = self.for_arm(state.arm).bound.view()
        bound.flags.writeable = False
        return bound

    def travel(self, state: ArmState) -> float:
        """Joint travel that limits allow in a step, median over the joints, at most 0.1 [rad]."""
        return self.for_arm(state.arm).travel

    def box(self, state: ArmState, previous: Array | None = None) -> Box:
        """The steps that each joint may take so that it keeps its limits now and can keep them later.

        That is, it keeps its step, speed and acceleration limits and its position limits, and after the step
        it can still brake and stop before its position limit: how, and why there always is such a step, is
        derived in `control.braking`. Some states leave no such step. Then this gives way:

        * Never the step and speed limits: a drive has no more, and people rely on it.
        * The acceleration limit, if the joint was faster than its bound before. It then takes the bound.
        * The position limit, if the joint cannot stop before it. It then brakes as hard as it may: stopping
          harder on paper makes no real joint stop harder.
        * The position limit, if the joint is outside to begin with. It then comes back, as fast as it can
          come to rest at the limit, or faster. From rest it never goes farther out.

        Joints that move no control point have no position limits here: they are not ours to bring back.

        Args:
            state: where the step begins.
            previous: the step before, (nv,) [rad or m]; None: the arm was at rest.

        Raises:
            InvalidValue: limits that do not fit the arm, or a previous step that does not.
        """
        arm, bounds = state.arm, self.for_arm(state.arm)
        positions = state.placed.positions
        before = _NONE if bounds.brake is None else _previous(arm, previous)
        sides, columns = np.empty((2, arm.nv)), arm.kinematics.columns
        brake = _NONE if bounds.brake is None else bounds.brake
        given = bounds.edges, bounds.bound, brake, before
        found = kernels.step_box(positions, *given, ROUNDING, columns, bounds.leaning, sides)
        relaxed = relaxed_limits(arm, positions, *given, ROUNDING) if found % 2 else ()
        return Box(sides[0], sides[1], relaxed, found >= 2, sides)

    def apply(self, state: ArmState, dq: Array, previous: Array | None = None) -> LimitedStep:
        """Shorten a step until it meets the step limit, then cut it at the position limits.

        A joint that is outside its position limits to begin with is brought back, no faster than the
        step limit allows.

        With an acceleration limit, the step asked for counts as the way that each joint wants to go: it goes
        no faster than it can stop at the end of it, or it would swing about its goal. The step is then moved
        into the `box`.

        Args:
            state: where the step begins.
            dq: the step asked for, (nv,) [rad or m].
            previous: the step before, (nv,) [rad or m]; None: the arm was at rest.
        """
        arm, bounds = state.arm, self.for_arm(state.arm)
        before = _NONE if bounds.brake is None else _previous(arm, previous)
        brake = _NONE if bounds.brake is None else bounds.brake
        cut, clipped = np.empty(arm.nv), np.empty(arm.nv, dtype=np.bool_)
        given = state.placed.positions, bounds.edges, bounds.bound, brake, before
        scale = kernels.shorten_step(dq, *given, cut, clipped)
        return LimitedStep(cut, scale, clipped)

    def hold(self, state: ArmState, previous: Array | None = None) -> LimitedStep:
        """The step of a controller that has nowhere to go: joints stop as soon as their limits allow.

        Without an acceleration limit that is at once. Joints outside their position limits are not brought
        back: an arm that says why it stands still does so.

        Args:
            state: where the step begins.
            previous: the step before, (nv,) [rad or m]; None: the arm was at rest.
        """
        bounds = self.for_arm(state.arm)
        dq = np.zeros(state.arm.nv)
        if bounds.brake is not None:
            dq = full_braking(_previous(state.arm, previous), bounds.brake)
        return LimitedStep(np.clip(dq, -bounds.bound, bounds.bound), 1.0, np.zeros(len(dq), dtype=np.bool_))

    def for_arm(self, arm: Arm) -> JointBounds:
        """What these limits mean for the joints of an arm; remembered as long as it lives."""
        known = _KNOWN.setdefault(arm, {})
        bounds = known.get(self._key)
        if bounds is None:
            if len(known) >= _MOST:
                known.clear()
            values = (self.step, self.velocity, self.acceleration, self.dt, self.position_margin)
            bounds = known[self._key] = joint_bounds(arm, *values)
        return bounds


def cycle_of(limits: object) -> float:
    """The duration of a control cycle that limits are for [s].

    Raises:
        InvalidValue: no limits, or they know of no time.
    """
    if not isinstance(limits, Limits) or limits.dt is None:
        raise InvalidValue("limits", limits, "Limits(dt=...), with the duration of a control cycle")
    return limits.dt


_NONE = np.empty(0)
_KNOWN: WeakKeyDictionary[Arm, dict[tuple[object, ...], JointBounds]] = WeakKeyDictionary()
_MOST = 16  # limits of one arm that are remembered


def _previous(arm: Arm, previous: Array | None) -> Array:
    """The step before, (nv,); zero if there was none."""
    return np.zeros(arm.nv) if previous is None else finite_vector("previous", previous, arm.nv)


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
