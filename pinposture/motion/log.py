"""Logs of robots: what the drives were told, and what the joints did."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from numbers import Real
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from pinposture._validation import (
    LARGEST_COORDINATE,
    as_floats,
    finite_array,
    make_read_only,
    require_positive,
    set_fields,
)
from pinposture.errors import FileError, InvalidValue
from pinposture.motion.joint_files import read_columns
from pinposture.motion.joint_trajectory import check_names
from pinposture.motion.ros import is_bag, read_bag

Array = NDArray[np.float64]


Times = ArrayLike
"""Times of rows: seconds, also since an epoch, (N,); seconds and nanoseconds, (N, 2); or the interval [s]."""


class Clock(NamedTuple):
    """Times as whole seconds, and the rest, so that differences are exact since any epoch."""

    whole: Array
    rest: Array

    def since(self, origin: float) -> Array:
        """Return times relative to a whole second [s]."""
        return np.asarray((self.whole - origin) + self.rest)


@dataclass(frozen=True, eq=False)
class Log:
    """What the drives of a robot were told, and what its joints did: two tables on one clock.

    The tables may have different rates and begin at different times. A command holds until the next one.
    Rows of measurements that repeat the row before count as stale, and rows that are not finite as missing.

    Attributes:
        command_time: when commands were sent, (N,) [s]: seconds, also since an epoch; or seconds and
            nanoseconds, (N, 2); or the interval between rows. Afterwards seconds since the first command.
        commands: joint positions sent, (N, n) [rad or m].
        time: when positions were measured, on the same clock, (M,) [s]; likewise.
        positions: measured joint positions, (M, n) [rad or m].
        joint_names: names of the joints, n; empty: those of `Arm.drives`, in their order.
        effort: measured torques or forces of the drives, (M, n) [N m or N]; None: unknown.
        gravity: gravitational acceleration in the world frame of the arm, (3,) or (M, 3) [m/s^2], such as
            (0, 0, -9.81) for an arm that is mounted as its description says; None: unknown attitude.
        payload: what the arm carried at its tip beside what it is known to carry [kg]; None: unknown.
        in_contact: whether the arm touched something, such as the ground on which it lay.
        degrees: whether positions and commands of joints that turn are in degrees.

    Raises:
        InvalidValue: tables that do not fit, times that go back, or tables that do not overlap in time.
    """

    command_time: Array
    commands: Array
    time: Array
    positions: Array
    joint_names: tuple[str, ...] = ()
    effort: Array | None = None
    gravity: Array | None = None
    payload: float | None = None
    in_contact: bool = False
    degrees: bool = False

    def __post_init__(self) -> None:
        commands = _table("commands", self.commands)
        count = commands.shape[1]
        positions = _table("positions", self.positions, count)
        rows = len(positions)
        empty = isinstance(self.joint_names, list | tuple) and not self.joint_names
        names = () if empty else check_names(self.joint_names)
        if names and len(names) != count:
            raise InvalidValue("joint_names", names, f"{count} names, one for each column")
        effort = None if self.effort is None else _table("effort", self.effort, count, rows)
        for name in ("in_contact", "degrees"):
            if not isinstance(getattr(self, name), bool | np.bool_):
                raise InvalidValue(name, getattr(self, name), "True or False")
        if self.payload is not None:
            require_positive("payload", self.payload, zero=True)
        sent = _read_times("command_time", self.command_time, len(commands))
        measured = _read_times("time", self.time, rows)
        origin = float(np.nanmin(sent.whole))
        set_fields(
            self,
            command_time=_checked_times("command_time", sent.since(origin)),
            commands=commands,
            time=_checked_times("time", measured.since(origin)),
            positions=positions,
            joint_names=names,
            effort=effort,
            gravity=_gravity(self.gravity, rows),
        )
        self._check_overlap()
        make_read_only(*vars(self).values())

    def _check_overlap(self) -> None:
        first = float(np.nanmin(self.command_time))
        last = float(np.nanmax(self.time))
        begin = float(np.nanmin(self.time))
        end = float(np.nanmax(self.command_time))
        if last <= first or begin > end + 1.0:  # measurements may begin a second after the last command
            spans = f"{begin:.6g} to {last:.6g} s, and commands {first:.6g} to {end:.6g} s"
            raise InvalidValue("time", spans, "measurements and commands at the same time, on one clock")

    @classmethod
    def read(
        cls,
        path: str | Path,
        commands: str | Path | None = None,
        joint_names: Sequence[str] = (),
        **about: Any,
    ) -> Log:
        """Read a log from tables (CSV) or a ROS 2 bag.

        A table has a heading for each column: "NAME position", "NAME command" and "NAME effort", with or
        without a unit, [rad], [deg], [m] or [N m]; NAME alone is a position, in a table of commands a
        command. The time is in the column "time", "stamp" or "t", with or without a unit, [s], [ms], [us] or
        [ns]; in "sec" and "nanosec"; or as the interval since the row before in "dt". A table without
        headings has positions in the order of `joint_names`, or of the arm, and the time in its first or last
        column. Empty fields, "nan" and "-" are missing numbers.

        Of a bag (a folder or .mcap), positions and efforts are those of sensor_msgs/JointState on the topic
        "/joint_states", and commands those of the topic that `commands` names: sensor_msgs/JointState,
        trajectory_msgs/JointTrajectory, or std_msgs/Float64MultiArray in the order of `joint_names`. It needs
        the extra `ros`.

        Args:
            path: the table of measurements, or of both; or the bag.
            commands: the table of commands, None if the first has them; of a bag, their topic.
            joint_names: names of the columns of tables without headings.
            about: further attributes: gravity, payload, in_contact, degrees.

        Raises:
            FileError: a file that is missing or not such a table; names line and column.
            InvalidValue: tables that do not fit each other.
        """
        path = Path(path)
        if isinstance(joint_names, str):
            raise InvalidValue("joint_names", joint_names, "a list of names")
        if is_bag(path):
            measured, sent = read_bag(path, None if commands is None else str(commands), joint_names)
        else:
            measured = read_columns(path, "position", joint_names)
            sent = measured if commands is None else read_columns(Path(commands), "command", joint_names)
        names = [name for name in measured.names if name in sent.names]
        told = sent.table("command", names)
        table = measured.table("position", names)
        if told is None or table is None:
            kind = "commands" if told is None else "positions"
            raise FileError(path, f"has no {kind} of joints; see `Log.read` for what tables look like")
        degrees = {measured.degrees, sent.degrees}
        if degrees == {True, False}:
            raise FileError(path, "has positions in degrees and commands in radians, or the reverse")
        options = {"degrees": degrees == {True}, **about}
        named = () if measured.anonymous and not joint_names else tuple(names)
        return cls(sent.time, told, measured.time, table, named, measured.table("effort", names), **options)

    def __repr__(self) -> str:
        span = float(np.nanmax(self.time) - np.nanmin(self.time))
        rows = f"{len(self.commands)} commands, {len(self.positions)} measurements"
        return f"Log({self.positions.shape[1]} joints, {rows}, {span:.4g} s)"


def _table(name: str, values: ArrayLike, columns: int | None = None, rows: int | None = None) -> Array:
    """Return a table of numbers, of which some may be missing, as NaN."""
    words = f"numbers of shape ({rows or 'k'}, {columns or 'n'})"
    table = as_floats(name, values, words)
    fits = table.ndim == 2 and table.size > 0 and columns in (None, table.shape[1])
    if not fits or rows not in (None, len(table)):
        raise InvalidValue(f"{name} (shape)", table.shape, words)
    table[~np.isfinite(table)] = np.nan
    if np.all(np.isnan(table)):
        raise InvalidValue(name, "no finite number", "some finite numbers")
    beyond = np.argwhere(np.abs(np.nan_to_num(table)) > LARGEST_COORDINATE)
    if len(beyond):
        row, column = beyond[0]
        allowed = f"at most {LARGEST_COORDINATE:g} in size"
        raise InvalidValue(f"{name}[{row}, {column}]", float(table[row, column]), allowed)
    return table


def _read_times(name: str, clock: Times, rows: int) -> Clock:
    """Return the times of rows; NaN where they are missing."""
    if isinstance(clock, Real):
        require_positive(name, clock if isinstance(clock, bool) else float(clock))
        return Clock(np.zeros(rows), float(clock) * np.arange(rows))
    words = f"seconds ({rows},), seconds and nanoseconds ({rows}, 2), or the interval between rows"
    times = as_floats(name, clock, words)
    if times.shape not in ((rows,), (rows, 2)):
        raise InvalidValue(f"{name} (shape)", times.shape, words)
    seconds = times if times.ndim == 1 else times[:, 0]
    latest = 1e12  # times beyond it are mistakes: nanoseconds since 1970 are 1e18
    seconds[~(np.abs(seconds) < latest)] = np.nan
    if np.all(np.isnan(seconds)):
        raise InvalidValue(name, clock, f"finite times below {latest:g} s")
    whole = np.floor(seconds)
    rest = seconds - whole
    return Clock(whole, rest if times.ndim == 1 else rest + 1e-9 * times[:, 1])


def _checked_times(name: str, times: Array) -> Array:
    """Return times; raise InvalidValue where they go back."""
    known = np.flatnonzero(np.isfinite(times))
    back = np.flatnonzero(np.diff(times[known]) < 0.0)
    if len(back):
        row = int(known[back[0] + 1])
        before = int(known[back[0]])
        allowed = f"at least {times[before]:.9g} s, the time of row {before}; sort the rows"
        raise InvalidValue(f"{name}[{row}]", float(times[row]), allowed)
    return times


def _gravity(direction: ArrayLike | None, rows: int) -> Array | None:
    if direction is None:
        return None
    gravity = finite_array("gravity", direction)
    if gravity.shape not in ((3,), (rows, 3)):
        raise InvalidValue("gravity (shape)", gravity.shape, f"(3,) or ({rows}, 3), or None")
    return gravity
