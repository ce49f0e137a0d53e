"""Joint trajectories: joint positions, velocities and accelerations over time."""

from __future__ import annotations

from collections.abc import Mapping, Sequence, Sized
from dataclasses import dataclass, replace
from functools import cached_property
from itertools import pairwise
from numbers import Real
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from pinposture._validation import (
    finite_array,
    make_read_only,
    require_instance,
    require_positive,
    set_fields,
)
from pinposture.arm import Arm
from pinposture.arm.couplings import Drive, joint_axes
from pinposture.errors import InvalidValue, enumerated
from pinposture.kernels.arrays import FULL_TURN
from pinposture.units import CONVERGED, ROUNDING

# Checks of joint trajectories.

Array = NDArray[np.float64]


def check_names(names: Sequence[str]) -> tuple[str, ...]:
    """Return names of joints; raise InvalidValue unless there are some, distinct and printable."""
    if isinstance(names, str) or not isinstance(names, Sequence) or not names:
        raise InvalidValue("joint_names", names, "a list of at least one name")
    for k, name in enumerate(names):
        if not (isinstance(name, str) and name and name.isprintable() and name == name.strip()):
            allowed = "a name: printable characters, no space before or after them"
            raise InvalidValue(f"joint_names[{k}]", name, allowed)
        if name in names[:k]:
            allowed = f"a unique name; joint {names.index(name)} has the same"
            raise InvalidValue(f"joint_names[{k}]", name, allowed)
    return tuple(names)


def _themselves(arm: Arm) -> list[Drive]:
    """Return the degrees of freedom of an arm as joints that follow themselves."""
    units = zip(arm.joint_names, joint_units(arm), strict=True)
    return [Drive(name, name, 1.0, 0.0, unit == RADIAN) for name, unit in units]


def _followers(arm: Arm) -> list[Drive]:
    """Return the coupled joints of an arm."""
    turns = joint_axes(arm.model, [arm.model.getJointId(coupling.joint) for coupling in arm.couplings])[1]
    return [Drive(*coupling, bool(turn)) for coupling, turn in zip(arm.couplings, turns, strict=True)]


def check_same_joints(names: Sequence[str], expected: Sequence[str]) -> None:
    """Raise InvalidValue unless these are the joints of an arm, in any order; names those that differ."""
    wrong = {
        "missing": [name for name in expected if name not in names],
        "unknown": [name for name in names if name not in expected],
    }
    if any(wrong.values()):
        listed = {word: enumerated(map(repr, joints)) for word, joints in wrong.items()}
        values = "; ".join(f"{word}: {joints}" for word, joints in listed.items() if joints)
        allowed = f"the {len(expected)} joints of the arm in any order ({values})"
        raise InvalidValue("joint_names", names, allowed)


def count_rows(name: str, values: ArrayLike) -> int:
    """Return the number of rows or entries; raise InvalidValue if there are none."""
    alone = isinstance(values, np.ndarray) and values.ndim == 0
    rows = len(values) if isinstance(values, Sized) and not alone else 0
    if rows == 0:
        raise InvalidValue(name, values, "a list with at least one entry")
    return rows


def check_times(time: Array) -> None:
    """Raise InvalidValue unless times increase strictly from 0 or later."""
    if time[0] < 0.0:
        raise InvalidValue("time[0]", float(time[0]), "0 or later [s]")
    late = np.flatnonzero(np.diff(time) <= 0.0)
    if len(late):
        k = int(late[0]) + 1
        raise InvalidValue(f"time[{k}]", float(time[k]), f"more than time[{k - 1}], {float(time[k - 1])} s")


def row_times(time: ArrayLike, rows: int) -> ArrayLike:
    """Return the times of rows [s]: as given, or multiples of a single number, which must be positive."""
    if not isinstance(time, Real):
        return time
    require_positive("time", time if isinstance(time, bool) else float(time))
    return float(time) * np.arange(rows)


def step_duration(dt: float | None, known: float | None) -> float:
    """Return the duration of the steps of a run [s]: a given one, or the `known` one of its limits.

    Raises:
        InvalidValue: there is none, it is not positive, or the two differ.
    """
    step = known if dt is None else dt
    if step is None:
        raise InvalidValue("dt", None, "the duration of a step [s]; the limits of this run have none")
    require_positive("dt", step)
    if known is not None and abs(step - known) > ROUNDING * known:
        raise InvalidValue("dt", dt, f"{known} s, from the limits of this run, or None")
    return step


# Configurations as joint positions.


RADIAN = "rad"
METRE = "m"
"""Units of the position of a revolute and of a prismatic joint."""


def joint_units(arm: Arm) -> tuple[str, ...]:
    """Return the unit of each joint position of an arm, (nv,), on or off the chain.

    Raises:
        InvalidValue: a joint off the chain has several degrees of freedom.
    """
    require_instance("arm", arm, Arm, "an Arm")
    for joint, name in list(zip(arm.model.joints, arm.model.names, strict=True))[1:]:
        if joint.nv > 1:
            raise InvalidValue(f"joint {str(name)!r}", joint.shortname(), "joints with one degree of freedom")
    return tuple(METRE if slides else RADIAN for slides in arm.in_metres)


def unwrap_positions(arm: Arm, q: ArrayLike) -> Array:
    """Return the joint positions of successive configurations, with continuous joints unwrapped.

    A continuous joint starts within +-pi and turns the shorter way between rows: after two turns it is at
    4 pi.

    Args:
        arm: the arm.
        q: configurations, (N, nq).

    Returns:
        Joint positions, (N, nv) [rad or m].

    Raises:
        InvalidValue: another shape, or a row that is not a configuration; names the row.
    """
    require_instance("arm", arm, Arm, "an Arm")
    rows = finite_array("q", q, (None, arm.nq))
    for k, row in enumerate(rows):
        arm.checked(row, f"q[{k}]")
    positions = arm.difference(arm.origin, rows)
    for joint in list(arm.model.joints)[1:]:
        if joint.nv == 1 and joint.nq > 1:
            positions[:, joint.idx_v] = np.unwrap(positions[:, joint.idx_v])
    return positions


# Velocities and accelerations by finite differences.


class Peaks(NamedTuple):
    """Peak velocity and acceleration of each joint, as `Limits` bounds them.

    Attributes:
        speeds: largest mean speed between two rows, (n,) [rad/s or m/s].
        accelerations: largest change of that between intervals per time, including from and to rest, (n,)
            [rad/s^2 or m/s^2].
    """

    speeds: Array
    accelerations: Array

    def __repr__(self) -> str:
        speed, change = (float(values.max(initial=0.0)) for values in self)
        return f"Peaks(speeds up to {speed:.4g}, accelerations up to {change:.4g}, {len(self.speeds)} joints)"


def compute_rates(time: Array, positions: Array) -> tuple[Array, Array]:
    """Return velocities and accelerations, (N, n): differences that are exact for constant acceleration.

    With slopes s and intervals h before and after a row,

        v = (h_before s_after + h_after s_before) / (h_before + h_after),
        a = 2 (s_after - s_before) / (h_before + h_after).

    A velocity is a mean of the adjacent slopes, and for equal intervals an acceleration is their difference
    over the interval, so limits on steps also hold for rows. The first and the last row are at rest without
    acceleration, because a robot may hold the last row.

    Args:
        time: time of each row, (N,) [s], strictly increasing.
        positions: joint positions, (N, n) [rad or m].
    """
    velocities = np.zeros_like(positions)
    accelerations = np.zeros_like(positions)
    if len(time) > 2:
        intervals = np.diff(time)[:, None]
        with np.errstate(over="ignore", invalid="ignore"):  # `JointTrajectory` checks for finite values
            slopes = np.diff(positions, axis=0) / intervals
            before = intervals[:-1]
            after = intervals[1:]
            velocities[1:-1] = (before * slopes[1:] + after * slopes[:-1]) / (before + after)
            accelerations[1:-1] = 2.0 * (slopes[1:] - slopes[:-1]) / (before + after)
    return velocities, accelerations


def find_peaks(time: Array, positions: Array) -> Peaks:
    """Return the largest speeds and accelerations from row to row, from and to rest.

    Args:
        time: time of each row, (N,) [s], strictly increasing.
        positions: joint positions, (N, n) [rad or m].
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
    """Return positions on cubic Hermite polynomials between rows.

    Args:
        time: time of each row, (N,) [s], strictly increasing.
        positions: (N, n) [rad or m].
        velocities: (N, n) [rad/s or m/s].
        times: any times, (...) [s]; clipped to those of the first and the last row.

    Returns:
        Positions, (..., n) [rad or m]; exact at the times of rows.
    """
    clipped = np.clip(times, time[0], time[-1])
    last = len(time) - 1
    before = np.clip(np.searchsorted(time, clipped, side="right") - 1, 0, max(last - 1, 0))
    after = np.minimum(before + 1, last)
    span = time[after] - time[before]
    share = np.divide(clipped - time[before], span, out=np.zeros_like(span), where=span > 0.0)[..., None]
    start = positions[before]
    way = positions[after] - positions[before]
    # The chord, and the deviation of the slopes at both ends from its slope.
    first = span[..., None] * velocities[before] - way
    second = span[..., None] * velocities[after] - way
    bend = share * (1.0 - share) * ((1.0 - share) * first - share * second)
    positions_there: Array = np.where(share < 1.0, start + share * way + bend, positions[after])
    return positions_there


# The joint trajectory.


@dataclass(frozen=True, eq=False)
class JointTrajectory:
    """Positions, velocities and accelerations of n joints at N times.

    Angles of continuous joints are unwrapped: after two turns they are at 4 pi.

    Attributes:
        joint_names: names of the joints in the URDF, n distinct names.
        time: time of each row, (N,) [s], >= 0, strictly increasing.
        positions: joint positions, (N, n) [rad or m].
        velocities: joint velocities, (N, n) [rad/s or m/s].
        accelerations: joint accelerations, (N, n) [rad/s^2 or m/s^2].
        units: "rad" for each revolute joint, "m" for each prismatic one, "" if unknown; empty: all unknown.
        name: name of the robot; may be empty.
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
        rows = count_rows("time", self.time)
        set_fields(self, joint_names=names, units=units, time=finite_array("time", self.time, (rows,)))
        check_times(self.time)
        for field in ("positions", "velocities", "accelerations"):
            set_fields(self, **{field: finite_array(field, getattr(self, field), (rows, len(names)))})
        make_read_only(*vars(self).values())

    @classmethod
    def from_positions(
        cls,
        joint_names: Sequence[str],
        positions: ArrayLike,
        time: ArrayLike,
        units: Sequence[str] = (),
        name: str = "",
    ) -> JointTrajectory:
        """Return the trajectory through joint positions; `compute_rates` gives velocities and accelerations.

        The first and the last row are at rest.

        Args:
            joint_names: names of the joints, n.
            positions: joint positions, (N, n) [rad or m].
            time: time of each row, (N,) [s], or the interval between rows [s].
            units: see the class.
            name: name of the robot.

        Raises:
            InvalidValue: names, positions or times that do not fit.
        """
        names = check_names(joint_names)
        rows = count_rows("positions", positions)
        table = finite_array("positions", positions, (rows, len(names)))
        require_instance("units", units, Sequence, "a unit for each joint, or none")
        rest = np.zeros_like(table)
        still = cls(names, np.asarray(row_times(time, rows)), table, rest, rest, tuple(units), name)
        velocities, accelerations = compute_rates(still.time, still.positions)
        return replace(still, velocities=velocities, accelerations=accelerations)

    @classmethod
    def from_configurations(cls, arm: Arm, q: ArrayLike, time: ArrayLike) -> JointTrajectory:
        """Return the trajectory of an arm through configurations, with the joints that are `driven`.

        Continuous joints start within +-pi (see `starting_at`) and turn the shorter way between rows. The
        first and the last row are at rest, as ros2_control may require. In between, rates keep the limits
        that the steps keep; see `compute_rates`.

        Args:
            arm: the arm.
            q: configurations, (N, nq).
            time: time of each, (N,) [s], or the interval between them [s].

        Raises:
            InvalidValue: configurations or times that do not fit.
        """
        units = joint_units(arm)
        rows = unwrap_positions(arm, q)
        return cls.from_positions(arm.joint_names, rows, time, units, str(arm.model.name)).driven(arm)

    @classmethod
    def joined(cls, motions: Sequence[JointTrajectory]) -> JointTrajectory:
        """Return motions one after the other, each beginning at rest where the one before ends at rest.

        In between the arm rests for as long as the last step took, so that the change of speed at the end of
        a motion and that at the start of the next one do not add up.

        Args:
            motions: one or more motions of the same joints.

        Raises:
            InvalidValue: no motions, or motions of other joints, or that begin elsewhere.
        """
        require_instance("motions", motions, Sequence, "a list of joint trajectories")
        if not motions:
            raise InvalidValue("motions", motions, "at least one joint trajectory")
        for k, part in enumerate(motions):
            require_instance(f"motions[{k}]", part, JointTrajectory, "a JointTrajectory")
            if part.joint_names != motions[0].joint_names:
                raise InvalidValue(f"motions[{k}] (joints)", part.joint_names, f"{motions[0].joint_names}")
        times = [motions[0].time]
        for k, (before, after) in enumerate(pairwise(motions), start=1):
            jump = float(np.abs(after.positions[0] - before.positions[-1]).max())
            if jump > CONVERGED:
                allowed = f"at most {CONVERGED:g} from the end of the one before"
                raise InvalidValue(f"motions[{k}] (start)", jump, allowed)
            rest = float(np.diff(before.time[-2:]).sum())
            times.append(times[-1][-1] + rest + after.time - after.time[0])
        return replace(
            motions[0],
            time=np.concatenate(times),
            positions=np.vstack([part.positions for part in motions]),
            velocities=np.vstack([part.velocities for part in motions]),
            accelerations=np.vstack([part.accelerations for part in motions]),
        )

    @property
    def duration(self) -> float:
        """Time from the first row to the last [s]."""
        return float(self.time[-1] - self.time[0])

    @cached_property
    def peaks(self) -> Peaks:
        """The largest speed and acceleration of each joint from row to row, as `Limits` bounds them."""
        return find_peaks(self.time, self.positions)

    def summary(self) -> dict[str, Any]:
        """Return size, duration and largest rates as JSON-compatible data, rates by unit."""
        largest: dict[str, tuple[float, float]] = {}
        for unit, speed, acceleration in zip(self.units, *self.peaks, strict=True):
            most = largest.get(unit, (0.0, 0.0))
            largest[unit] = max(most[0], float(speed)), max(most[1], float(acceleration))
        return {
            "kind": "joint trajectory",
            "robot": self.name,
            "joints": list(self.joint_names),
            "units": list(self.units),
            "points": len(self.time),
            "duration": self.duration,
            "largest_speed": {f"{unit}/s": speed for unit, (speed, _) in largest.items()},
            "largest_acceleration": {f"{unit}/s^2": most for unit, (_, most) in largest.items()},
        }

    def with_coupled(self, arm: Arm) -> JointTrajectory:
        """Return the trajectory of the joints that drives move, with the coupled ones of the chain appended.

        Raises:
            InvalidValue: as `matched`.
        """
        led = self.matched(arm)
        driven = led.driven(arm)
        every = [*_themselves(arm), *_followers(arm)]
        coupled = [drive for drive in every if drive.joint not in driven.joint_names]
        if not coupled:
            return driven
        added = led._followed(coupled)
        return replace(
            driven,
            joint_names=driven.joint_names + added.joint_names,
            positions=np.hstack([driven.positions, added.positions]),
            velocities=np.hstack([driven.velocities, added.velocities]),
            accelerations=np.hstack([driven.accelerations, added.accelerations]),
            units=driven.units + added.units,
        )

    def driven(self, arm: Arm) -> JointTrajectory:
        """Return the trajectory of the joints that drives move (`Arm.drives`), in this order.

        Raises:
            InvalidValue: as `matched`.
        """
        return self.matched(arm)._followed(arm.drives)

    def matched(self, arm: Arm) -> JointTrajectory:
        """Return the trajectory of the degrees of freedom of an arm, `Arm.joint_names`, with their units.

        Each is given itself, or by the joint that its drive moves (`Arm.drives`). Other coupled joints may be
        included, and are dropped.

        Raises:
            InvalidValue: a joint of the arm is missing, there are others, a unit is wrong, or a coupled joint
                violates its coupling.
        """
        require_instance("arm", arm, Arm, "an Arm")
        themselves = _themselves(arm)
        pairs = zip(themselves, arm.drives, strict=True)
        given = [joint if joint.joint in self.joint_names else drive for joint, drive in pairs]
        names = [drive.joint for drive in given]
        followers = {
            drive.joint: drive for drive in (*_followers(arm), *arm.drives) if drive.joint not in names
        }
        check_same_joints([name for name in self.joint_names if name not in followers], names)
        for each in given:
            unit = self.units[self.joint_names.index(each.joint)]
            if unit not in ("", RADIAN if each.turns else METRE):
                raise InvalidValue(
                    f"unit of joint {each.joint!r}", unit, repr(RADIAN if each.turns else METRE)
                )
        matched = self._followed(
            [
                Drive(joint.joint, each.joint, 1.0 / each.ratio, -each.offset / each.ratio, joint.turns)
                for joint, each in zip(themselves, given, strict=True)
            ]
        )
        for number, name in enumerate(self.joint_names):
            if name in followers:
                led = matched._followed([followers[name]]).positions[:, 0]
                apart = float(np.abs(self.positions[:, number] - led).max())
                if apart > CONVERGED:
                    allowed = f"to follow joint {followers[name].leader!r} to {CONVERGED:g}"
                    raise InvalidValue(f"joint {name!r}", f"up to {apart:.3g} off", allowed)
        return matched

    def _followed(self, joints: Sequence[Drive]) -> JointTrajectory:
        """Return the trajectory of joints that follow those of this one."""
        leaders = [self.joint_names.index(joint.leader) for joint in joints]
        ratios = np.array([joint.ratio for joint in joints])
        offsets = np.array([joint.offset for joint in joints])
        return replace(
            self,
            joint_names=tuple(joint.joint for joint in joints),
            positions=np.take(self.positions, leaders, axis=1) * ratios + offsets,
            velocities=np.take(self.velocities, leaders, axis=1) * ratios,
            accelerations=np.take(self.accelerations, leaders, axis=1) * ratios,
            units=tuple(RADIAN if joint.turns else METRE for joint in joints),
        )

    def starting_at(self, arm: Arm, positions: ArrayLike | Mapping[str, float]) -> JointTrajectory:
        """Return the same motion with continuous joints at the full turns at which a robot starts.

        Other joints stay: their positions already tell their turns.

        Args:
            arm: the arm; joints are matched by name.
            positions: positions of the robot at the start, as its drives count them [rad or m]: in the order
                of `Arm.drives`, (nv,), or by name.

        Raises:
            InvalidValue: a continuous joint is farther than half a radian from the first row, apart from full
                turns; or the joints are not those of the arm.
        """
        matched = self.matched(arm)
        checked = arm.drives.joint_positions(positions)
        if checked.ndim != 1:
            raise InvalidValue("positions (shape)", checked.shape, f"({arm.nv},), or positions by name")
        first = matched.positions[0]
        turns = np.where(arm.kinematics.endless, np.rint((checked - first) / FULL_TURN), 0.0)
        off = np.where(arm.kinematics.endless, np.abs(checked - first - FULL_TURN * turns), 0.0)
        joint = int(off.argmax())
        most = 0.5  # [rad]; controllers do not accept a start that is farther away
        if off[joint] > most:
            allowed = f"{first[joint]:.4g} rad to within {most:g} rad, plus full turns: move there first"
            raise InvalidValue(f"positions[{joint}]", float(checked[joint]), allowed)
        return replace(matched, positions=matched.positions + FULL_TURN * turns).driven(arm)

    def configurations(self, arm: Arm) -> Array:
        """Return the configurations of an arm, (N, nq); joints are matched by name, in any order.

        Raises:
            InvalidValue: as `matched`.
        """
        return np.array([arm.configuration(row) for row in self.matched(arm).positions])

    def at(self, times: ArrayLike) -> Array:
        """Return joint positions at any times: cubic Hermite polynomials between rows, constant outside.

        Args:
            times: one time, or (k,) [s].

        Returns:
            Positions, (n,) or (k, n) [rad or m]; exact at the times of rows.

        Raises:
            InvalidValue: times that are not finite numbers.
        """
        asked = finite_array("times", times)
        if asked.ndim > 1:
            raise InvalidValue("times (shape)", asked.shape, "one number, or (k,)")
        return interpolate_cubic(self.time, self.positions, self.velocities, asked)

    def compensated(self, arm: Arm) -> JointTrajectory:
        """Return the commands for which the loaded arm makes this motion: `Arm.compensate` of each row.

        They are those of the joints that drives move, as `driven`.

        Velocities and accelerations change by those of the difference, from and to rest.

        Args:
            arm: the arm, with masses and `Arm.stiffness`; its joints are matched by name.

        Raises:
            NoEquilibrium: a posture that is not stable; names the joint that gives way.
            WeightUnknown: masses or a stiffness that are not known.
            InvalidValue: joints of another arm, or a joint whose command would be outside its limits.
        """
        moved = self.driven(arm)
        positions = arm.drives.joint_positions(moved.positions)
        rows = np.array([arm.configuration(row) for row in positions])
        change = arm.drives.velocities(arm.difference(rows, arm.compensate(rows)))
        velocities, accelerations = compute_rates(moved.time, change)
        return replace(
            moved,
            positions=moved.positions + change,
            velocities=moved.velocities + velocities,
            accelerations=moved.accelerations + accelerations,
        )

    def sampled(self, dt: float) -> JointTrajectory:
        """Return the trajectory resampled at equidistant times, for a player with another cycle time.

        It starts at the first row and ends at the first multiple of `dt` at which the motion is over.

        Args:
            dt: interval between rows [s].

        Raises:
            InvalidValue: not a positive number.
        """
        require_positive("dt", dt)
        most = 10_000_000  # rows; these are 5 GB at 20 joints
        if self.duration / dt > most:
            allowed = f"at least {self.duration / most:.3g} s, for at most {most} rows"
            raise InvalidValue("dt", dt, allowed)
        count = int(np.ceil(self.duration / dt * (1.0 - ROUNDING))) + 1
        time = self.time[0] + dt * np.arange(count)
        return self.from_positions(self.joint_names, self.at(time), time, self.units, self.name)

    def __repr__(self) -> str:
        size = f"{len(self.joint_names)} joints, {len(self.time)} rows, {self.duration:.4g} s"
        return f"JointTrajectory({self.name!r}, {size})" if self.name else f"JointTrajectory({size})"
