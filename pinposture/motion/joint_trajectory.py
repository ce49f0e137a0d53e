"""A motion as joint positions over time, as robots and simulators take it."""

from __future__ import annotations

from collections.abc import Iterable, Sequence, Sized
from dataclasses import dataclass, replace
from functools import cached_property
from numbers import Real
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from pinposture._validation import require_positive
from pinposture.arm import Arm
from pinposture.arm.couplings import joint_axes
from pinposture.errors import InvalidValue

# Checks of joint trajectories.

Array = NDArray[np.float64]

MAX_NAMED = 6
"""Largest number of joints that are listed in a message."""

TIME_TOLERANCE = 1e-9
"""Relative difference of two durations that are the same."""


def check_names(names: Sequence[str]) -> tuple[str, ...]:
    """The names, or InvalidValue unless they are different ones that a file can hold, at least one."""
    if isinstance(names, str) or not names:
        raise InvalidValue("joint_names", names, "a list of at least one name")
    for k, name in enumerate(names):
        if not (isinstance(name, str) and name and name.isprintable() and name == name.strip()):
            allowed = "a name: printable characters, no space before or after them"
            raise InvalidValue(f"joint_names[{k}]", name, allowed)
        if name in names[:k]:
            raise InvalidValue(
                f"joint_names[{k}]", name, f"a name of its own; joint {names.index(name)} has it"
            )
    return tuple(names)


def check_same_joints(names: Sequence[str], expected: Sequence[str]) -> None:
    """Raise InvalidValue unless these are the joints of an arm, in any order; names those that do not fit."""
    wrong = {
        "missing": [name for name in expected if name not in names],
        "unknown": [name for name in names if name not in expected],
    }
    if any(wrong.values()):
        values = "; ".join(f"{word}: {_listed(joints)}" for word, joints in wrong.items() if joints)
        raise InvalidValue(
            "joint_names", names, f"the {len(expected)} joints of the arm in any order ({values})"
        )


def count_rows(name: str, values: ArrayLike) -> int:
    """How many rows or entries there are; raises InvalidValue if it is none, or no list at all."""
    alone = isinstance(values, np.ndarray) and values.ndim == 0
    rows = len(values) if isinstance(values, Sized) and not alone else 0
    if rows == 0:
        raise InvalidValue(name, values, "a list with at least one entry")
    return rows


def finite_array(name: str, values: ArrayLike, shape: tuple[int, ...] | None = None) -> Array:
    """A fresh read-only array of finite floats, of that shape if one is given.

    Raises:
        InvalidValue: not numbers, another shape, or an entry that is not finite; names the entry.
    """
    try:
        array = np.array(values, dtype=np.float64)
    except (TypeError, ValueError):
        raise InvalidValue(name, values, f"numbers{'' if shape is None else f', {shape}'}") from None
    if shape is not None and array.shape != shape:
        raise InvalidValue(f"{name} (shape)", array.shape, str(shape))
    bad = np.argwhere(~np.isfinite(array))
    if len(bad):
        entry = ", ".join(map(str, bad[0]))
        raise InvalidValue(
            f"{name}[{entry}]" if entry else name, float(array[tuple(bad[0])]), "finite numbers"
        )
    array.flags.writeable = False
    return array


def check_times(time: Array) -> None:
    """Raise InvalidValue unless times increase strictly from 0 or later."""
    if time[0] < 0.0:
        raise InvalidValue("time[0]", float(time[0]), "0 or later [s]")
    late = np.flatnonzero(np.diff(time) <= 0.0)
    if len(late):
        k = int(late[0]) + 1
        raise InvalidValue(f"time[{k}]", float(time[k]), f"more than time[{k - 1}], {float(time[k - 1])} s")


def row_times(time: ArrayLike, rows: int) -> ArrayLike:
    """When rows are reached: as given, or at equal distances from 0 if one number was given [s].

    Raises:
        InvalidValue: one number that is not positive.
    """
    if not isinstance(time, Real):
        return time
    require_positive("time", time if isinstance(time, bool) else float(time))
    return float(time) * np.arange(rows)


def step_duration(dt: float | None, known: float | None) -> float:
    """The duration of the steps of a run [s]: that of its limits, or the one given.

    Raises:
        InvalidValue: there is none, it is not positive, or the two are not the same.
    """
    step = known if dt is None else dt
    if step is None:
        raise InvalidValue("dt", None, "the duration of a step [s]; the limits of this run have none")
    require_positive("dt", step)
    if known is not None and abs(step - known) > TIME_TOLERANCE * known:
        raise InvalidValue("dt", dt, f"{known} s, which the limits of this run have, or nothing")
    return step


def _listed(names: Iterable[str]) -> str:
    listed = [repr(name) for name in names]
    more = f" and {len(listed) - MAX_NAMED} more" if len(listed) > MAX_NAMED else ""
    return ", ".join(listed[:MAX_NAMED]) + more


# Configurations as joint positions.

COUPLING_TOLERANCE = 1e-6
"""Distance of a joint from where the joint that it is coupled to puts it that is rounding [rad or m]."""

RADIAN, METRE = "rad", "m"
"""Units of the position of a joint that turns, and of one that slides."""


def joint_units(arm: Arm) -> tuple[str, ...]:
    """The unit of each joint position of an arm, (nv,), on the chain or off it.

    Raises:
        InvalidValue: a joint off the chain has several degrees of freedom, so that its name stands for more
            than one number.
    """
    for joint, name in list(zip(arm.model.joints, arm.model.names, strict=True))[1:]:
        if joint.nv > 1:
            raise InvalidValue(f"joint {str(name)!r}", joint.shortname(), "joints with one degree of freedom")
    return tuple(METRE if slides else RADIAN for slides in arm.in_metres)


def unwrap_positions(arm: Arm, q: ArrayLike) -> Array:
    """Return the joint positions of successive configurations, with continuous joints unwrapped.

    A continuous joint begins within +-pi, goes the shorter way from row to row and so has no jumps: after two
    turns it is at 4 pi.

    Args:
        arm: the arm.
        q: configurations, (N, nq).

    Returns:
        (N, nv) [rad or m]; for joints that are not continuous the very numbers of q.

    Raises:
        InvalidValue: another shape, or a row that is no configuration; names the row.
    """
    try:
        rows = np.asarray(q, dtype=np.float64)
    except (TypeError, ValueError):
        raise InvalidValue("q", q, f"configurations, (N, {arm.nq})") from None
    if rows.ndim != 2 or rows.shape[1] != arm.nq or len(rows) == 0:
        raise InvalidValue("q (shape)", rows.shape, f"(N, {arm.nq}) with at least one row")
    positions = np.array([arm.positions(arm.checked(row, f"q[{k}]")) for k, row in enumerate(rows)])
    for joint in list(arm.model.joints)[1:]:
        if joint.nv == 1 and joint.nq > 1:
            positions[:, joint.idx_v] = np.unwrap(positions[:, joint.idx_v])
    return positions


# Velocities and accelerations by finite differences.


class Rates(NamedTuple):
    """Velocity and acceleration of each joint at each row.

    Attributes:
        velocities: (N, n) [rad/s or m/s].
        accelerations: (N, n) [rad/s^2 or m/s^2].
    """

    velocities: Array
    accelerations: Array


class Peaks(NamedTuple):
    """The most that a motion asks of each joint, in the sense of `Limits`.

    Attributes:
        speeds: largest mean speed between two rows, (n,) [rad/s or m/s].
        accelerations: largest change of that from one interval to the next, from rest and to rest included,
            per time, (n,) [rad/s^2 or m/s^2].
    """

    speeds: Array
    accelerations: Array

    def __repr__(self) -> str:
        speed, change = (float(values.max(initial=0.0)) for values in self)
        return f"Peaks(speeds up to {speed:.4g}, accelerations up to {change:.4g}, {len(self.speeds)} joints)"


def compute_rates(time: Array, positions: Array) -> Rates:
    """Central and second differences: exact where a joint moves with constant acceleration.

    With slopes s before and after a row, and h the intervals,

        v = (h_before s_after + h_after s_before) / (h_before + h_after),
        a = 2 (s_after - s_before) / (h_before + h_after).

    A velocity is a mean of the slopes around it, and at equal distances an acceleration is their difference
    over the interval: what bounds the steps of a motion bounds its rows. The first and the last row are at
    rest, without acceleration: a robot that holds the last row must not go on pushing.

    Args:
        time: when each row is reached, (N,) [s], strictly increasing.
        positions: joint positions then, (N, n) [rad or m].
    """
    velocities, accelerations = np.zeros_like(positions), np.zeros_like(positions)
    if len(time) > 2:
        intervals = np.diff(time)[:, None]
        with np.errstate(over="ignore", invalid="ignore"):  # the trajectory refuses what is not finite
            slopes = np.diff(positions, axis=0) / intervals
            before, after = intervals[:-1], intervals[1:]
            velocities[1:-1] = (before * slopes[1:] + after * slopes[:-1]) / (before + after)
            accelerations[1:-1] = 2.0 * (slopes[1:] - slopes[:-1]) / (before + after)
    return Rates(velocities, accelerations)


def find_peaks(time: Array, positions: Array) -> Peaks:
    """The largest speeds and accelerations from row to row, from rest and to rest.

    Args:
        time: when each row is reached, (N,) [s], strictly increasing.
        positions: joint positions then, (N, n) [rad or m].
    """
    if len(time) == 1:
        return Peaks(np.zeros(positions.shape[1]), np.zeros(positions.shape[1]))
    intervals = np.diff(time)
    spans = np.pad(intervals, 1, mode="edge")
    with np.errstate(over="ignore"):  # infinite for rows far apart at nearly the same time
        slopes = np.diff(positions, axis=0) / intervals[:, None]
        resting = np.pad(slopes, ((1, 1), (0, 0)))
        changes = 2.0 * np.diff(resting, axis=0) / (spans[:-1] + spans[1:])[:, None]
    return Peaks(np.abs(slopes).max(axis=0), np.abs(changes).max(axis=0))


# Interpolation between rows.


def interpolate_cubic(time: Array, positions: Array, velocities: Array, times: Array) -> Array:
    """The cubic polynomials between rows that have their positions and velocities (Hermite).

    Args:
        time: when each row is reached, (N,) [s], strictly increasing.
        positions: (N, n) [rad or m].
        velocities: (N, n) [rad/s or m/s].
        times: any, (...) [s]; those before the first row and after the last stand for these.

    Returns:
        Positions, (..., n) [rad or m]; at the time of a row exactly its own.
    """
    clipped = np.clip(times, time[0], time[-1])
    last = len(time) - 1
    before = np.clip(np.searchsorted(time, clipped, side="right") - 1, 0, max(last - 1, 0))
    after = np.minimum(before + 1, last)
    span = time[after] - time[before]
    share = np.divide(clipped - time[before], span, out=np.zeros_like(span), where=span > 0.0)[..., None]
    start, way = positions[before], positions[after] - positions[before]
    # The chord, and what bends it off: slopes at either end against its own.
    first = span[..., None] * velocities[before] - way
    second = span[..., None] * velocities[after] - way
    bend = share * (1.0 - share) * ((1.0 - share) * first - share * second)
    found: Array = np.where(share < 1.0, start + share * way + bend, positions[after])
    return found


# The joint trajectory.


@dataclass(frozen=True, eq=False)
class JointTrajectory:
    """Where each joint of a robot is when, and how fast: N rows for n joints.

    Continuous joints have unwrapped angles: after two turns they are at 4 pi.

    Attributes:
        joint_names: the joints as the URDF names them, n different names.
        time: when each row is reached, counted from the start, (N,) [s], strictly increasing from 0 or later.
        positions: joint positions, (N, n) [rad or m].
        velocities: joint velocities, (N, n) [rad/s or m/s].
        accelerations: joint accelerations, (N, n) [rad/s^2 or m/s^2].
        units: "rad" for each joint that turns, "m" if it slides, "" where that is not known; may be left out.
        name: what the robot is called; may be empty.
    """

    joint_names: tuple[str, ...]
    time: Array
    positions: Array
    velocities: Array
    accelerations: Array
    units: tuple[str, ...] = ()
    name: str = ""

    def __post_init__(self) -> None:
        names = check_names(self.joint_names)
        units = tuple(self.units) or ("",) * len(names)
        if len(units) != len(names) or not set(units) <= {RADIAN, METRE, ""}:
            raise InvalidValue("units", units, f"{RADIAN!r}, {METRE!r} or '' for each of {len(names)} joints")
        object.__setattr__(self, "joint_names", names)
        object.__setattr__(self, "units", units)
        rows = count_rows("time", self.time)
        object.__setattr__(self, "time", finite_array("time", self.time, (rows,)))
        check_times(self.time)
        for field in ("positions", "velocities", "accelerations"):
            table = finite_array(field, getattr(self, field), (rows, len(names)))
            object.__setattr__(self, field, table)

    @classmethod
    def from_positions(
        cls,
        joint_names: Sequence[str],
        positions: ArrayLike,
        time: ArrayLike,
        units: Sequence[str] = (),
        name: str = "",
    ) -> JointTrajectory:
        """A motion of which only the joint positions are known.

        Velocities and accelerations are central and second differences, for unequal distances in time too;
        the first and the last row are at rest. See `compute_rates`.

        Args:
            joint_names: names of the joints, n.
            positions: joint positions, (N, n) [rad or m].
            time: when each row is reached, (N,) [s], or the time from one row to the next [s].
            units: see the class.
            name: what the robot is called.

        Raises:
            InvalidValue: names, positions or times that do not fit.
        """
        names = check_names(joint_names)
        rows = count_rows("positions", positions)
        table = finite_array("positions", positions, (rows, len(names)))
        rest = np.zeros_like(table)
        still = cls(names, np.asarray(row_times(time, rows)), table, rest, rest, tuple(units), name)
        found = compute_rates(still.time, still.positions)
        return replace(still, velocities=found.velocities, accelerations=found.accelerations)

    @classmethod
    def from_configurations(cls, arm: Arm, q: ArrayLike, time: ArrayLike) -> JointTrajectory:
        """The motion of an arm through configurations, with all joints of its model.

        From row to row continuous joints go the shorter way. The first and the last row are at rest, as the
        arm is before and after a motion: controllers of ros2_control may take no other. In between, central
        and second differences keep the limits that the steps keep.

        Args:
            arm: the arm.
            q: configurations, (N, nq).
            time: when each is reached, (N,) [s], or the time from one to the next [s].

        Raises:
            InvalidValue: configurations or times that do not fit.
        """
        units = joint_units(arm)
        return cls.from_positions(arm.joint_names, unwrap_positions(arm, q), time, units, str(arm.model.name))

    @property
    def duration(self) -> float:
        """Time from the first row to the last [s]."""
        return float(self.time[-1] - self.time[0])

    @cached_property
    def peaks(self) -> Peaks:
        """The largest speed and acceleration of each joint from row to row, as `Limits` bounds them."""
        return find_peaks(self.time, self.positions)

    def with_coupled(self, arm: Arm) -> JointTrajectory:
        """The same motion with the joints that follow others (`Arm.couplings`) as well, behind the others.

        Raises:
            InvalidValue: as `matched`.
        """
        led, couplings = self.matched(arm), arm.couplings
        leaders = [arm.joint_names.index(each.leader) for each in couplings]
        ratios = np.array([each.ratio for each in couplings])
        turns = joint_axes(arm.model, [arm.model.getJointId(each.joint) for each in couplings])[1]

        def joined(values: Array, offsets: Array) -> Array:
            return np.hstack([values, values[:, leaders] * ratios + offsets])

        none = np.zeros(len(couplings))
        return replace(
            led,
            joint_names=(*led.joint_names, *(each.joint for each in couplings)),
            positions=joined(led.positions, np.array([each.offset for each in couplings])),
            velocities=joined(led.velocities, none),
            accelerations=joined(led.accelerations, none),
            units=(*led.units, *(RADIAN if turn else METRE for turn in turns)),
        )

    def matched(self, arm: Arm) -> JointTrajectory:
        """The same motion with the joints in the arm's order, and their units.

        Joints that follow others may be among them.

        Raises:
            InvalidValue: a joint of the arm is missing, there are others, a unit is not the joint's, or a
                joint does not follow the one that it is coupled to.
        """
        followers = {each.joint: each for each in arm.couplings}
        check_same_joints([name for name in self.joint_names if name not in followers], arm.joint_names)
        for number, name in enumerate(self.joint_names):
            if name in followers:
                _, leader, ratio, offset = followers[name]
                led = ratio * self.positions[:, self.joint_names.index(leader)] + offset
                apart = float(np.abs(self.positions[:, number] - led).max())
                if apart > COUPLING_TOLERANCE:
                    allowed = f"to follow joint {leader!r} to {COUPLING_TOLERANCE:g}"
                    raise InvalidValue(f"joint {name!r}", f"up to {apart:.3g} off", allowed)
        order = [self.joint_names.index(name) for name in arm.joint_names]
        units = joint_units(arm)
        for number, unit in zip(order, units, strict=True):
            if self.units[number] not in ("", unit):
                joint = self.joint_names[number]
                raise InvalidValue(f"unit of joint {joint!r}", self.units[number], repr(unit))
        return replace(
            self,
            joint_names=arm.joint_names,
            positions=self.positions[:, order],
            velocities=self.velocities[:, order],
            accelerations=self.accelerations[:, order],
            units=units,
        )

    def configurations(self, arm: Arm) -> Array:
        """The configurations of an arm, (N, nq); joints are matched by name, in any order.

        Raises:
            InvalidValue: as `matched`.
        """
        return np.array([arm.configuration(row) for row in self.matched(arm).positions])

    def at(self, times: ArrayLike) -> Array:
        """Joint positions at any time: cubic polynomials between rows, standing still before and after them.

        Args:
            times: one moment, or (k,) [s].

        Returns:
            Positions, (n,) or (k, n) [rad or m]; at the time of a row exactly those of the row.

        Raises:
            InvalidValue: times that are not finite numbers.
        """
        asked = finite_array("times", times)
        if asked.ndim > 1:
            raise InvalidValue("times (shape)", asked.shape, "one number, or (k,)")
        return interpolate_cubic(self.time, self.positions, self.velocities, asked)

    def sampled(self, dt: float) -> JointTrajectory:
        """The same motion with rows at equal distances in time, for a player with a cycle of its own.

        It begins with the first row. The last one is the first multiple of `dt` at which the motion is over.

        Args:
            dt: time from one row to the next [s].

        Raises:
            InvalidValue: not a positive number.
        """
        require_positive("dt", dt)
        count = int(np.ceil(self.duration / dt * (1.0 - TIME_TOLERANCE))) + 1
        time = self.time[0] + dt * np.arange(count)
        return self.from_positions(self.joint_names, self.at(time), time, self.units, self.name)

    def __repr__(self) -> str:
        size = f"{len(self.joint_names)} joints, {len(self.time)} rows, {self.duration:.4g} s"
        return f"JointTrajectory({self.name!r}, {size})" if self.name else f"JointTrajectory({size})"
