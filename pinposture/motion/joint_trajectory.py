"""Timed joint motion as plain data: what is handed to a robot or a simulator, and what comes back."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import ArrayLike, NDArray

from pinposture.arm import Arm
from pinposture.control.checks import require_positive
from pinposture.errors import InvalidValue
from pinposture.motion.ending import require_sound
from pinposture.motion.joint_checks import (
    SAME,
    check_names,
    check_same_joints,
    check_times,
    finite_array,
    moments,
    row_count,
    step_duration,
)
from pinposture.motion.joint_interpolation import cubic
from pinposture.motion.joint_positions import SLIDE, TURN, joint_units, unwound
from pinposture.motion.joint_rates import Peaks, peaks, rates

if TYPE_CHECKING:
    from pinposture.motion.trajectory import Trajectory

Array = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class JointTrajectory:
    """Where each joint of a robot is when, and how fast: N rows for n joints.

    Continuous joints have angles, unwound: after two turns they are at 4 pi.

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
        if len(units) != len(names) or not set(units) <= {TURN, SLIDE, ""}:
            raise InvalidValue("units", units, f"{TURN!r}, {SLIDE!r} or '' for each of {len(names)} joints")
        object.__setattr__(self, "joint_names", names)
        object.__setattr__(self, "units", units)
        rows = row_count("time", self.time)
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
        the first and the last row are at rest. See `joint_rates.rates`.

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
        rows = row_count("positions", positions)
        table = finite_array("positions", positions, (rows, len(names)))
        rest = np.zeros_like(table)
        still = cls(names, np.asarray(moments(time, rows)), table, rest, rest, tuple(units), name)
        found = rates(still.time, still.positions)
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
        return cls.from_positions(arm.joint_names, unwound(arm, q), time, units, str(arm.model.name))

    @classmethod
    def from_run(cls, run: Trajectory, dt: float | None = None, force: bool = False) -> JointTrajectory:
        """The motion of a run, whose steps all take the same time.

        Args:
            run: the run.
            dt: duration of a step [s]; needed if the limits of the run have none, else theirs.
            force: True to have it in spite of the `faults` of the run.

        Raises:
            MotionError: the run has faults.
            InvalidValue: no duration, not a positive one, or another than that of the limits.
        """
        step = step_duration(dt, run.limits.dt)
        require_sound(run, force)
        return cls.from_configurations(run.arm, run.q, step)

    @property
    def duration(self) -> float:
        """Time from the first row to the last [s]."""
        return float(self.time[-1] - self.time[0])

    @cached_property
    def peaks(self) -> Peaks:
        """The largest speed and acceleration of each joint from row to row, as `Limits` bounds them."""
        return peaks(self.time, self.positions)

    def matched(self, arm: Arm) -> JointTrajectory:
        """The same motion with the joints in the arm's order, and their units.

        Raises:
            InvalidValue: a joint of the arm is missing, there are others, or a unit is not the joint's.
        """
        check_same_joints(self.joint_names, arm.joint_names)
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
        return cubic(self.time, self.positions, self.velocities, asked)

    def sampled(self, dt: float) -> JointTrajectory:
        """The same motion with rows at equal distances in time, for a player with a cycle of its own.

        It begins with the first row. The last one is the first multiple of `dt` at which the motion is over.

        Args:
            dt: time from one row to the next [s].

        Raises:
            InvalidValue: not a positive number.
        """
        require_positive("dt", dt)
        count = int(np.ceil(self.duration / dt * (1.0 - SAME))) + 1
        time = self.time[0] + dt * np.arange(count)
        return self.from_positions(self.joint_names, self.at(time), time, self.units, self.name)

    def save(self, path: str | Path) -> Path:
        """Write the motion to a file, all or nothing, in the format of its suffix; see docs/trajectories.md.

        Args:
            path: ".npz" keeps everything to the last bit, ".csv" all but the name of the robot; ".json" is a
                `trajectory_msgs/msg/JointTrajectory` of ROS 2, whose times are whole nanoseconds.

        Returns:
            The path written.

        Raises:
            FileError: another suffix, or the file cannot be written.
            InvalidValue: times that such a message cannot hold.
        """
        from pinposture.motion.joint_files import save_joint_trajectory

        return save_joint_trajectory(self, Path(path))

    @classmethod
    def load(cls, path: str | Path, arm: Arm | None = None) -> JointTrajectory:
        """Read a file of one of the formats of `save`, also if others wrote it.

        Velocities and accelerations that are not in a file are worked out from its positions.

        Args:
            path: the file.
            arm: if given, joints are put in its order, and have its units, which JSON does not tell.

        Raises:
            FileError: the file is missing, or does not hold such a motion; names line or point.
            InvalidValue: its joints are not those of the arm.
        """
        from pinposture.motion.joint_files import load_joint_trajectory

        loaded = load_joint_trajectory(Path(path))
        return loaded if arm is None else loaded.matched(arm)

    def __repr__(self) -> str:
        size = f"{len(self.joint_names)} joints, {len(self.time)} rows, {self.duration:.4g} s"
        return f"JointTrajectory({self.name!r}, {size})" if self.name else f"JointTrajectory({size})"
