"""Joint limits of a step: position, speed, acceleration and jerk, and braking in discrete time."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property, partial
from typing import Annotated, Any, NamedTuple, cast

import numpy as np
from numpy.typing import NDArray
from pydantic import ValidationInfo, model_validator

from pinposture import kernels
from pinposture._validation import (
    LARGEST_NUMBER,
    as_floats,
    finite_vector,
    is_usable,
)
from pinposture.arm import Arm, ArmState
from pinposture.arm.arm import arm_of, kept
from pinposture.errors import InvalidValue, warn_caller
from pinposture.kernels.arrays import LimitArrays
from pinposture.schema import (
    UNLIMITED_WORD,
    Declared,
    Duration,
    InputFile,
    NotAllowed,
    OutputFile,
    declared,
    in_file,
    read_bounded,
    read_by,
    read_quantities,
    read_quantity,
    read_within,
    refusing,
    unknown_key,
)
from pinposture.units import CONVERGED, ROUNDING

Array = NDArray[np.float64]


class CycleSettings(NamedTuple):
    """Control cycles of tasks, and how many are looked at."""

    default: float = 0.02
    """Default duration of a cycle [s]."""

    longest: float = 60.0
    """Its longest duration [s]."""

    most_stopping: int = 5000
    """Largest number of braking steps that are computed."""

    most_averaged: int = 10_000
    """Largest number of cycles over which steps are averaged."""


CYCLES = CycleSettings()


@dataclass(frozen=True, eq=False)
class JointBounds:
    """Limits of one step, in joint displacements and positions.

    Attributes:
        bound: largest |dq|, (nv,) [rad or m]; infinite where there is no limit.
        travel: joint travel per step, median over the joints, at most 0.1 [rad].
        position_limits: position limits with the margin, (2, nv) [rad or m].
        brake: largest change of dq between steps of a controller, (nv,) [rad or m]; None: no limit. It is
            `acceleration`, or less with a jerk limit (`JerkFilter`).
        units: unit of motion of each joint of the chain, (n,) [rad or m].
        slack: excess over a position limit beyond which a joint is brought back, (n,) [rad or m].
        dt: duration of a step [s]; None: undefined.
        acceleration: largest change of dq between steps, (nv,) [rad or m]; None: no limit.
        jerk: largest change between steps of the change of dq, (nv,) [rad or m]; None: no limit.
        effort: largest torque or force, (nv,) [N m or N], infinite where it is not known; None: no limit.

    The arrays are passed to kernels. Do not write to them.
    """

    bound: Array
    travel: float
    position_limits: Array
    brake: Array | None
    units: Array
    slack: Array
    dt: float | None
    acceleration: Array | None
    jerk: Array | None
    effort: Array | None

    @cached_property
    def arrays(self) -> LimitArrays:
        """The limits of a step, for kernels."""
        return LimitArrays(self.units, self.slack, self.position_limits, self.bound)

    @cached_property
    def braking(self) -> Array:
        """`brake` for kernels, empty without a limit."""
        return np.empty(0) if self.brake is None else self.brake

    def before(self, previous: Array | None) -> Array:
        """Return the previous step for kernels, (nv,) [rad or m]; empty where it does not matter.

        Args:
            previous: as in `step_bounds`.
        """
        if self.brake is None:
            return np.empty(0)
        return np.zeros(len(self.bound)) if previous is None else np.array(previous, dtype=np.float64)

    def stopping_steps(self, positions: Array, dq: Array) -> Array:
        """Return the steps that stop an arm after a step, on a straight line in joint space if possible.

        A joint outside its position limits stops too, but is not brought back.

        Args:
            positions: joint positions after that step, (nv,) [rad or m].
            dq: that step, (nv,) [rad or m].

        Returns:
            Steps, (k, nv) [rad or m]; k = 0 if the arm can stop at once.
        """
        if self.brake is None:
            return np.empty((0, len(dq)))
        rooms = self.position_limits - positions
        moving = np.array(dq, dtype=np.float64)
        return kernels.stopping_steps(rooms, moving, self.bound, self.brake, CYCLES.most_stopping)

    def step_bounds(self, state: ArmState, previous: Array | None) -> StepBounds:
        """Return the steps that the limits allow; see `Limits.step_bounds`.

        Args:
            state: a state of the arm of these limits.
            previous: the previous step, (nv,) finite numbers [rad or m]; None: the arm was at rest.
        """
        arm = state.arm
        positions = state.raw_positions
        before = self.before(previous)
        both = np.empty((2, arm.nv))
        unmet, outside = kernels.step_box(
            positions,
            self.position_limits,
            self.bound,
            self.braking,
            before,
            ROUNDING,
            arm.kinematics.columns,
            self.slack,
            both,
        )
        relaxed: tuple[str, ...] = ()
        if unmet:
            relaxed = violated_limits(
                arm, positions, self.position_limits, self.bound, self.braking, before, ROUNDING
            )
        return StepBounds(both[0], both[1], relaxed, outside, both)


def _effort_of(arm: Arm, effort: bool | float | Array) -> Array:
    """Return torque limits of an arm, (nv,) [N m or N]; `effort` is as in `Limits`.

    Raises:
        InvalidValue: not one number for each degree of freedom, or an arm with a joint that no pass knows.
        WeightUnknown: masses, or all limits of the arm, are not known.
    """
    arm.require_masses()
    if not arm.dynamics.whole:
        allowed = "none: a joint off the chain of this arm neither turns about one axis nor slides along one"
        raise InvalidValue("limits.effort", effort, allowed)
    if effort is not True:
        return _per_joint("effort", effort, arm)
    arm.require_effort()
    return arm.effort


def _position_limits(arm: Arm, margin: float) -> Array:
    limits = arm.limits
    moved = arm.moved > 0.0
    # Joints that move no control point stay where they are.
    margins = np.where(limits.upper > limits.lower, margin, 0.0)  # locked joints have no room for any
    lower = np.where(moved, limits.lower + margins, -np.inf)
    upper = np.where(moved, limits.upper - margins, np.inf)
    if np.any(lower > upper):
        joint = int(np.argmax(lower - upper))
        room = (limits.upper[joint] - limits.lower[joint]) / 2.0
        allowed = f"at most {room:.4g}, half the range of degree of freedom {joint}"
        raise InvalidValue("position_margin", margin, allowed)
    return np.array([lower, upper])


def _per_joint(name: str, value: float | Array, arm: Arm) -> Array:
    """Return a limit as one number for each degree of freedom, (nv,)."""
    if np.ndim(value) == 1 and len(np.asarray(value)) != arm.nv:
        raise InvalidValue(f"{name} (shape)", np.shape(value), f"one number or ({arm.nv},)")
    return np.broadcast_to(np.asarray(value, dtype=np.float64), arm.nv)


# Braking in discrete time: the largest step from which a joint can still stop in time.
#
# Let A be the acceleration limit times the square of the duration of a step. A joint that moves by d in this
# step may move by d - A, d - 2A, ... in the next ones, and stops once less than A is left. For d > 0 it
# covers, this step included, at least
#
# S(d) = sum over j >= 0 of max(d - j A, 0) = max over n >= 1 of (n d - A n (n - 1) / 2).
#
# S increases with d, so the joint stops within a distance r >= 0 if and only if S(d) <= r, i.e. d is at most
#
# g(r) = min over n >= 1 of (r / n + A (n - 1) / 2), taken at n = max(1, ceil(sqrt(1/4 + 2 r / A) - 1/2)).
#
# In the other direction all signs change: g(-r) = -g(r). Let L and U be the displacements to the lower and
# the upper limit, b the largest |d| of a step, and p the previous step. The joint may take any d with
#
# g(L) <= d <= g(U), p - A <= d <= p + A, -b <= d <= b.
#
# A state is viable if L <= 0 <= U, |p| <= b, and full braking from p stops in time: S(p - A) <= U if p > A,
# and S(-p - A) <= -L if p < -A.
#
# * From a viable state there is such a d: full braking, d = p - A, or 0 if 0 <= p <= A. It is at most g(U)
#   because S(d) <= U, at least g(L) <= 0, and at most b; for p < 0 the same with the signs changed.
# * After any such d the next state is viable. Take d >= 0: S(d) <= U gives d <= U and, if d > A, S(d - A) =
#   S(d) - d <= U - d, the condition for the next state; L - d <= 0 and |d| <= b hold.
# * No larger box has this property: beyond g(U) the joint exceeds its limits however it brakes.
#
# Among obstacles, the path along which the arm stops matters as well. It is straight if all joints slow down
# in proportion: with r = max_j |d_j| / A_j, the step d is followed by (1 - 1/r) d, (1 - 2/r) d, ... and rest.
# Then no joint changes by more than its A, and none brakes harder than in full braking. A joint that would
# exceed g(L) or g(U) is held there, as far as its A allows.


def farthest(room: Array, brake: Array) -> Array:
    """Return the largest step towards a position from which a joint can still stop there, g(r) above.

    Repeated, these steps bring the joint to rest there in the shortest time.

    Args:
        room: signed displacement to that position, (..., nv) [rad or m]; may be infinite.
        brake: largest change between steps, A, (nv,) [rad or m]; finite, > 0.

    Returns:
        Steps in the direction of `room`, none longer than it, (..., nv) [rad or m].
    """
    rooms = np.array(room, dtype=np.float64).reshape(-1, len(brake))
    steps = np.empty_like(rooms)
    kernels.stoppable_steps(rooms, np.array(brake, dtype=np.float64), steps)
    return steps.reshape(np.shape(room))


def full_braking(previous: Array, brake: Array) -> Array:
    """Return the smallest step that can follow the previous one, (nv,) [rad or m]."""
    return previous - np.minimum(np.maximum(previous, -brake), brake)


def violated_limits(
    arm: Arm,
    positions: Array,
    position_limits: Array,
    bound: Array,
    brake: Array,
    previous: Array,
    rounding: float,
) -> tuple[str, ...]:
    """Name each limit that is relaxed in a step, by joint; see `Limits.step_bounds` for the order.

    Args:
        arm: the arm.
        positions: joint positions, (nv,) [rad or m].
        position_limits: joint positions to stay between, (2, nv) [rad or m].
        bound: largest |dq|, (nv,) [rad or m].
        brake: largest change of dq between steps, (nv,) [rad or m]; empty: no limit.
        previous: the previous step, (nv,) [rad or m]; empty without a limit on its change.
        rounding: excess over a limit that is ignored [rad or m].
    """
    words = []
    names = arm.joint_names
    steps = position_limits - positions
    slowest = np.zeros(arm.nv)
    if len(brake):
        steps = farthest(steps, brake)
        slowest = full_braking(previous, brake)
    above = np.minimum(steps[1], bound) - np.maximum(slowest, 0.0)
    below = np.minimum(slowest, 0.0) - np.maximum(steps[0], -bound)
    taken = np.clip(slowest, -bound, bound)
    for joint in np.flatnonzero(np.minimum(above, below) < -rounding):
        name = names[joint]
        unit = "m" if arm.slides[joint] else "rad"
        at = positions[joint]
        low, high = position_limits[:, joint]
        step = taken[joint]
        if not low - rounding <= at <= high + rounding:
            allowed = f"{low:.4g} to {high:.4g} {unit}"
            words.append(f"position limit: joint {name!r} is at {at:.4g}, outside {allowed}")
        elif max(step - steps[1, joint], steps[0, joint] - step) > rounding:
            edge, most = (high, steps[1, joint]) if step > 0.0 else (low, -steps[0, joint])
            words.append(
                f"position limit: joint {name!r} at {at:.4g} is too fast to stop before {edge:.4g} {unit}; "
                f"its smallest step is {abs(step):.4g}, and it can stop from at most {most:.4g}"
            )
        if abs(slowest[joint]) > bound[joint] + rounding:
            words.append(
                f"acceleration limit: braking leaves joint {name!r} a step of {abs(slowest[joint]):.4g}, "
                f"and at most {bound[joint]:.4g} {unit} is allowed"
            )
    return tuple(words)


class StepBounds(NamedTuple):
    """The steps that the limits allow: all dq with lower <= dq <= upper; never empty.

    Attributes:
        lower: smallest joint displacement, (nv,) [rad or m].
        upper: largest joint displacement, (nv,) [rad or m].
        violated_constraints: messages naming the limits that can no longer be kept; see `Limits.step_bounds`.
        outside: whether a joint of the chain is outside its position limits by more than its slack.
        both: lower and upper, (2, nv), for kernels.
    """

    lower: Array
    upper: Array
    violated_constraints: tuple[str, ...]
    outside: bool
    both: Array


class LimitedStep(NamedTuple):
    """A step after the limits were applied.

    Attributes:
        dq: joint displacement, (nv,) [rad or m].
        scale: factor by which the whole step was shortened to meet the step limit, in (0, 1].
        clipped: which joints were clipped at a position limit or slowed down to stop there, (nv,).
    """

    dq: Array
    scale: float
    clipped: NDArray[np.bool_]


_QUANTITIES = {
    "step": ("angle", "length"),
    "velocity": ("rate of turning", "speed"),
    "acceleration": ("rate of change of turning", "acceleration"),
    "jerk": ("jerk of turning", "jerk"),
    "effort": ("torque", "force"),
}
"""Kinds of quantity of each limit, for joints that turn and for joints that slide."""


def _read_limit(value: Any, info: ValidationInfo) -> float | Array:
    """Read a limit for all joints, for revolute and prismatic ones, or one for each joint."""
    source = in_file(info)
    name = str(info.field_name)
    limit = value if source is None else _limit_in_file(value, name, source.arm)
    allowed = "a positive number, or one for each degree of freedom"
    if name == "effort":
        allowed = f"True, {allowed}"
    with refusing():
        array = as_floats(name, limit, allowed)
    if isinstance(limit, bool) or array.ndim > 1 or array.size == 0 or not np.all(array > 0.0):
        raise NotAllowed(value, allowed)
    if array.ndim == 0:
        return float(array)
    array.flags.writeable = False
    return array


def _limit_in_file(value: object, name: str, arm: Arm) -> float | Array:
    turning, sliding = _QUANTITIES[name]
    if value in (UNLIMITED_WORD, np.inf):
        return np.inf
    if isinstance(value, list):
        kinds = [sliding if slides else turning for slides in arm.slides]
        return np.array(read_quantities(value, kinds, unlimited=True))
    if not isinstance(value, Mapping):
        both = "a table with both, as in {turning = ..., sliding = ...}"
        return _for_all(value, arm, both, turning, sliding)
    limit = np.full(arm.nv, np.inf)
    parts = {"turning": (turning, ~arm.slides), "sliding": (sliding, arm.slides)}
    for key, entry in value.items():
        if key not in parts:
            raise unknown_key(key, parts)
        kind, joints = parts[key]
        limit[joints] = read_within(key, read_bounded, entry, (kind,), 0.0)
    # Others keep the speed of the description.
    return np.where(np.isinf(limit), arm.limits.velocity, limit) if name == "velocity" else limit


def _read_margin(value: object, info: ValidationInfo) -> float:
    source = in_file(info)
    margin = value if source is None else _for_all(value, source.arm, "a number, for all", "angle", "length")
    if not is_usable(margin) or cast(float, margin) < 0.0:
        raise NotAllowed(value, "a finite number >= 0")
    return float(cast(float, margin))


def _for_all(value: object, arm: Arm, allowed: str, turning: str, sliding: str) -> float:
    """Read one number for all joints, with a unit only if all of them turn or all of them slide."""
    if isinstance(value, str) and np.any(arm.slides) and not np.all(arm.slides):
        raise NotAllowed(value, allowed, hint=", and the arm turns and slides")
    return read_quantity(value, sliding if np.all(arm.slides) else turning)


def _write_limit(name: str, value: float | Array, arm: Arm) -> Any:
    """Return one number for all joints, one for those that turn and those that slide, or one for each."""
    if not isinstance(value, np.ndarray):
        return value if np.isfinite(value) else UNLIMITED_WORD
    both = {}
    rest = arm.limits.velocity if name == "velocity" else np.full(arm.nv, np.inf)
    for kind, joints in (("turning", ~arm.slides), ("sliding", arm.slides)):
        levels = np.unique(value[joints])
        if len(levels) == 1 and np.isfinite(levels[0]):
            both[kind] = float(levels[0])
            rest = np.where(joints, levels[0], rest)
    if both and np.array_equal(rest, value):
        return both
    return [entry if np.isfinite(entry) else UNLIMITED_WORD for entry in value.tolist()]


def _read_effort(value: Any, info: ValidationInfo) -> bool | float | Array:
    """Read torque limits: those of the arm, or others."""
    if value is True:
        return True
    return _read_limit(value, info)


_Limit = Annotated[float | Array, read_by(_read_limit)]


@declared(eq=False)
class Limits(Declared):
    """Limits of one control step. The joint position limits of the arm always apply as well.

    `track`, motions and `Tracker` keep a limit of jerk (see `JerkFilter`); `Controller.step` and `retime` do
    not.

    Attributes:
        step: largest |dq| of each joint in one step [rad or m]; one number, or one for each joint. None: no
            limit.
        velocity: largest joint velocity [rad/s or m/s]; one number, or one for each joint. Needs `dt`. None:
            that of the arm; a larger one replaces it, with a warning.
        dt: duration of a step, the cycle time [s]; above 1 s with a warning. None: velocities are not
            limited.
        position_margin: distance to keep from each joint position limit [rad or m].
        acceleration: largest joint acceleration [rad/s^2 or m/s^2]; one number, or one for each joint. Needs
            `dt`. dq changes by at most acceleration * dt^2 between steps, and joints brake early enough to
            stop at their position limits. None: no limit.
        jerk: largest joint jerk [rad/s^3 or m/s^3]; one number, or one for each joint. Needs `acceleration`.
            None: no limit.
        effort: largest torque or force of each joint [N m or N]: True for those of the arm, `Arm.effort`; one
            number, or one for each degree of freedom. "geodesic" keeps to postures that the motors can hold,
            and with `dt` times its paths within their torques; see `docs/weight.md`. None: no limit.
    """

    step: _Limit | None = 0.1
    velocity: _Limit | None = None
    dt: Duration | None = None
    position_margin: Annotated[float, read_by(_read_margin)] = 0.0
    acceleration: _Limit | None = None
    jerk: _Limit | None = None
    effort: Annotated[bool | float | Array, read_by(_read_effort)] | None = None

    @model_validator(mode="after")
    def _check(self, info: ValidationInfo) -> Limits:
        if self.dt is not None and self.dt > SUSPECT_LIMITS.longest_cycle:
            warn_caller(f"dt is {self.dt:g} s, long for a control cycle; is it in milliseconds?")
        for name in ("velocity", "acceleration"):
            if getattr(self, name) is not None and self.dt is None:
                raise InvalidValue("dt", None, f"a positive duration [s], needed to limit the {name}")
        if self.jerk is not None and self.acceleration is None:
            raise InvalidValue("acceleration", None, "a limit of acceleration, needed to limit the jerk")
        source = in_file(info)
        if source is not None:
            self.for_arm(source.arm)
        return self

    @classmethod
    def check_keys(cls, values: Mapping[str, Any]) -> tuple[str, ...]:
        """Return the keys of the table, with the duration of a control cycle first."""
        return ("cycle", *_QUANTITIES, "position_margin")

    @classmethod
    def from_table(cls, values: Mapping[str, Any], source: InputFile) -> dict[str, Any]:
        """Return the values of fields; a file without `step` does not limit it."""
        cycle_time = values.get("cycle", CYCLES.default)
        cycle = read_within("cycle", read_bounded, cycle_time, ("time",), 0.0, None, CYCLES.longest)
        rest = {key: value for key, value in values.items() if key != "cycle"}
        return {"step": None, **rest, "dt": cycle} if "step" not in rest else {**rest, "dt": cycle}

    def to_table(self, file: OutputFile) -> dict[str, Any]:
        """Return the table: only limits that there are."""
        quantities = {key: getattr(self, key) for key in _QUANTITIES if getattr(self, key) is not None}
        limits = {key: _write_limit(key, value, file.arm) for key, value in quantities.items()}
        margin = {"position_margin": self.position_margin} if self.position_margin else {}
        return {"cycle": self.dt, **limits, **margin}

    @cached_property
    def _key(self) -> tuple[object, ...]:
        values = (self.step, self.velocity, self.acceleration, self.jerk, self.effort)
        numbers = [value.tobytes() if isinstance(value, np.ndarray) else value for value in values]
        return (*numbers, self.dt, self.position_margin)

    def __eq__(self, other: object) -> bool:
        return self._key == other._key if isinstance(other, Limits) else NotImplemented

    def __hash__(self) -> int:
        return hash(self._key)

    def bound(self, state: ArmState) -> Array:
        """Return the largest |dq| of each joint in one step, (nv,) [rad or m]; infinite without a limit."""
        bound: Array = self.for_arm(arm_of(state)).bound.view()
        bound.flags.writeable = False
        return bound

    def travel(self, state: ArmState) -> float:
        """Return the joint travel that a step may cover, median over joints, at most 0.1 [rad]."""
        return self.for_arm(arm_of(state)).travel

    def step_bounds(self, state: ArmState, previous: Array | None = None) -> StepBounds:
        """Return the steps after which each joint keeps its limits and can continue to keep them.

        After such a step a joint can still stop before its position limit; `control.limits` has the
        derivation. In some states no such step exists, and limits are relaxed:

        * The step and velocity limits are never relaxed: drives cannot exceed them, and safety depends on
          them.
        * The acceleration limit is, if the joint exceeded its bound before. It then moves at the bound.
        * The position limit is, if the joint cannot stop before it. It then brakes at the acceleration limit,
          because a real joint cannot brake harder.
        * The position limit is, if the joint starts outside it. It then returns, at least as fast as it can
          come to rest at the limit. From rest it never moves farther out.

        Joints that move no control point do not move, and have no position limits here.

        Args:
            state: the state of the arm.
            previous: the previous step, (nv,) [rad or m]; None: the arm was at rest.

        Raises:
            InvalidValue: the limits or the previous step do not fit the arm.
        """
        arm = arm_of(state)
        return self.for_arm(arm).step_bounds(state, _checked_step(previous, arm))

    def apply(self, state: ArmState, dq: Array, previous: Array | None = None) -> LimitedStep:
        """Scale a step to meet the step limit, then clip it at the position limits.

        A joint that starts outside its position limits is brought back, no faster than the step limit allows.

        With an acceleration limit, the requested step is the distance that each joint has to travel. A joint
        moves no faster than it can stop at the end of it, so that it does not oscillate about its goal. The
        step is then clipped to the `step_bounds`.

        Args:
            state: the state of the arm.
            dq: the requested step, (nv,) [rad or m].
            previous: the previous step, (nv,) [rad or m]; None: the arm was at rest.
        """
        arm = arm_of(state)
        bounds = self.for_arm(arm)
        dq = finite_vector("dq", dq, arm.nv, LARGEST_NUMBER)
        before = bounds.before(_checked_step(previous, arm))
        cut = np.empty(arm.nv)
        clipped = np.empty(arm.nv, dtype=np.bool_)
        scale = kernels.shorten_step(
            dq,
            state.raw_positions,
            bounds.position_limits,
            bounds.bound,
            bounds.braking,
            before,
            cut,
            clipped,
        )
        return LimitedStep(cut, scale, clipped)

    def hold(self, state: ArmState, previous: Array | None = None) -> LimitedStep:
        """Return the step that stops the arm as soon as the acceleration limit, if any, allows.

        Joints outside their position limits are not brought back.

        Args:
            state: the state of the arm.
            previous: the previous step, (nv,) [rad or m]; None: the arm was at rest.
        """
        bounds = self.for_arm(arm_of(state))
        dq = np.zeros(state.arm.nv)
        before = _checked_step(previous, state.arm)
        if bounds.brake is not None and before is not None:
            dq = full_braking(before, bounds.brake)
        return LimitedStep(np.clip(dq, -bounds.bound, bounds.bound), 1.0, np.zeros(len(dq), dtype=np.bool_))

    def for_arm(self, arm: Arm) -> JointBounds:
        """Return the bounds for the joints of an arm, cached with the arm."""
        if not isinstance(arm, Arm):
            raise InvalidValue("arm", arm, "an Arm")
        known: dict[object, JointBounds] = arm.cache.get(JointBounds, {})
        bounds = known.get(self._key)
        if bounds is not None:  # as in nearly every call, of which a step makes several
            return bounds
        return kept(arm, JointBounds, self._key, partial(self._bounds_of, arm))

    def _bounds_of(self, arm: Arm) -> JointBounds:
        """Return the bounds for the joints of an arm, made anew.

        Raises:
            InvalidValue: not one number for each degree of freedom, or a margin wider than half a joint's
                range.
        """
        bound = np.full(arm.nv, np.inf)
        brake: Array | None = None
        change: Array | None = None
        change_of_change: Array | None = None
        dt = self.dt
        if self.step is not None:
            bound = np.minimum(bound, _per_joint("step", self.step, arm))
        if dt is not None:
            speed = arm.limits.velocity
            if self.velocity is not None:
                speed = _per_joint("velocity", self.velocity, arm)
            bound = np.minimum(bound, speed * dt)
            if self.acceleration is not None:
                change = _per_joint("acceleration", self.acceleration, arm) * dt**2
                brake = change = np.clip(change, 1e-100, 1e200)  # neither overflow nor division by zero
                if self.jerk is not None:
                    change_of_change = np.maximum(_per_joint("jerk", self.jerk, arm) * dt**3, 1e-100)
                    brake = _smoothable(arm, change, change_of_change)
        position_limits = _position_limits(arm, self.position_margin)
        effort = None if self.effort is None else _effort_of(arm, self.effort)
        if self.velocity is not None:
            _warn_of_speed(arm, self.velocity)
        units = arm.joint_units[arm.columns]
        return JointBounds(
            bound=bound,
            # A step without limits counts as a usual one [rad].
            travel=min(0.1, float(np.median(bound[arm.columns] / units))),
            position_limits=position_limits,
            brake=brake,
            units=units,
            slack=CONVERGED * units,
            dt=dt,
            acceleration=change,
            jerk=change_of_change,
            effort=effort,
        )


# Jerk limits: a moving average over the steps.
#
# Let d_k be steps within the limits of speed, acceleration and position. The arm takes their mean over the
# last w cycles, e_k = (d_k + ... + d_(k-w+1)) / w. Its position, step and change of step are then means of
# the unfiltered ones, and each of these limits is an interval; the states from which a joint can still stop
# are a convex set as well, since S above is convex. So the filtered motion keeps the same limits. With
# a_k = d_k - d_(k-1), its change of step changes by (a_k - a_(k-w)) / w, which is at most 2 A / w. Hence
# w = ceil(2 A / J) for the joint with the largest ratio, the same for all joints: each configuration is then
# a mean of unfiltered ones, and a straight path in joint space stays straight. On a curved one the arm cuts
# the corner, by at most A (w^2 - 1) / 24 for a joint, about a^3 / (6 j^2). It arrives w - 1 steps later.
# So A is not the acceleration limit, but less if need be: the joint then cuts no corner by more than e if
# a <= (6 e j^2)^(1/3). This makes small motions faster as well: one over a distance D takes
# 2 sqrt(D / a) + 2 a / j, which is least for a = (D j^2 / 4)^(1/3).
# (Moving averages for smooth motions: Biagiotti and Melchiorri, Control Engineering Practice 20, 2012.)

MAX_CORNER_CUT = 0.005
"""Largest deviation of a joint from its path due to a jerk limit, in `Arm.joint_units`."""


def _smoothable(arm: Arm, change: Array, change_of_change: Array) -> Array:
    """Return the acceleration, as in `JointBounds.brake`, with which no corner is cut too much."""
    cut = MAX_CORNER_CUT * arm.joint_units
    brake = np.minimum(change, np.cbrt(6.0 * cut) * change_of_change ** (2.0 / 3.0))
    cycles = _filter_cycles(arm, brake, change_of_change)
    return brake if cycles <= 1.0 else np.minimum(brake, 24.0 * cut / (cycles**2 - 1.0))


def _filter_cycles(arm: Arm, brake: Array, change_of_change: Array) -> float:
    """Return the number of steps to average, which is whole."""
    finite = np.isfinite(change_of_change)
    ratios = np.divide(2.0 * brake, change_of_change, out=np.zeros(arm.nv), where=finite)
    return max(float(np.ceil(ratios[arm.columns].max() - 1e-9)), 1.0)


class JerkFilter:
    """Limits the jerk of an arm by a moving average of its steps.

    Args:
        arm: the arm.
        limits: the limits.

    Attributes:
        bounds: the limits of the joints.
        cycles: number of steps that are averaged; 1 without a jerk limit, which leaves steps unchanged.
        active: whether steps are changed: there is a limit of jerk that the others do not keep anyway.

    Raises:
        InvalidValue: a jerk limit that needs an average over more than `CYCLES.most_averaged` steps.
    """

    def __init__(self, arm: Arm, limits: Limits) -> None:
        bounds = self.bounds = limits.for_arm(arm)
        cycles = 1.0
        if bounds.brake is not None and bounds.jerk is not None:
            cycles = _filter_cycles(arm, bounds.brake, bounds.jerk)
        if not cycles <= CYCLES.most_averaged:
            allowed = f"more; it averages steps over {cycles:.4g} cycles, {CYCLES.most_averaged} at most"
            raise InvalidValue("jerk", limits.jerk, allowed)
        self.cycles = max(int(cycles), 1)
        self.active = self.cycles > 1
        self._steps = np.zeros((self.cycles, arm.nv))
        self._owed = np.arange(self.cycles)[:, None] / self.cycles

    @property
    def ahead(self) -> Array:
        """Motion still to come from the steps filtered so far, (nv,) [rad or m]."""
        return np.asarray((self._owed * self._steps).sum(axis=0))

    @property
    def delay(self) -> float:
        """Number of cycles by which the arm follows the steps late."""
        return 0.5 * (self.cycles - 1)

    @property
    def moving(self) -> bool:
        """Whether the arm still moves if all further steps are zero."""
        return bool(np.any(self._steps[1:]))

    def apply(self, dq: Array) -> Array:
        """Filter a step `dq`, (nv,), and return the step of the arm, (nv,)."""
        if self.cycles == 1:
            return dq
        self._steps[:-1] = self._steps[1:]
        self._steps[-1] = dq
        return np.asarray(self._steps.mean(axis=0))

    def restart(self, dq: Array | None = None) -> None:
        """Restart from rest, or from the speed of a step dq, (nv,)."""
        self._steps[:] = 0.0 if dq is None else dq


def require_limits(limits: Limits | None) -> Limits:
    """Return the limits, or `Limits()` for None; raise InvalidValue for anything else."""
    if not (limits is None or isinstance(limits, Limits)):
        raise InvalidValue("limits", limits, "Limits(...), or None")
    return Limits() if limits is None else limits


def cycle_of(limits: object) -> float:
    """Return the cycle time of limits [s].

    Raises:
        InvalidValue: no limits, or limits without `dt`.
    """
    if not isinstance(limits, Limits) or limits.dt is None:
        raise InvalidValue("limits", limits, "Limits(dt=...), with the duration of a control cycle")
    return limits.dt


class SuspectLimits(NamedTuple):
    """Which limits seem to be in another unit, or above those of the description."""

    speed_rounding: float = 1e-6
    """Relative excess over the velocity limit of the description that is not reported."""

    longest_cycle: float = 1.0
    """Cycle time above which it may be in milliseconds [s]."""

    in_degrees: float = 10.0
    """Ratio of a speed to that of the description above which it may be in degrees."""


SUSPECT_LIMITS = SuspectLimits()


def _warn_of_speed(arm: Arm, velocity: float | Array) -> None:
    """Warn about velocity limits above those of the arm, which they replace, once per arm and worst joint."""
    speed = np.broadcast_to(velocity, arm.nv)
    known = arm.limits.velocity
    faster = np.flatnonzero(np.isfinite(speed) & (speed > (1.0 + SUSPECT_LIMITS.speed_rounding) * known))
    if not len(faster):
        return
    worst = int(faster[np.argmax(speed[faster] / known[faster])])
    in_degrees = bool(speed[worst] > SUSPECT_LIMITS.in_degrees * known[worst])
    warned: set[tuple[int, bool]] = arm.cache.setdefault(_warn_of_speed, set())
    if (worst, in_degrees) in warned:
        return
    warned.add((worst, in_degrees))
    unit = "m/s" if arm.slides[worst] else "rad/s"
    more = len(faster) - 1
    text = (
        f"velocity {speed[worst]:.4g} {unit} is above the {known[worst]:.4g} {unit} that the description "
        f"of the arm allows joint {arm.joint_names[worst]!r}" + (f", and {more} others" if more else "")
    )
    if in_degrees:
        text += "; is it in degrees?"
    warn_caller(text)


def _checked_step(previous: Array | None, arm: Arm) -> Array | None:
    """Return a previous step that a caller gave, (nv,); None if there was none."""
    return None if previous is None else finite_vector("previous", previous, arm.nv)
