"""Joint trajectories as text files: a table in CSV, and the ROS 2 message in JSON."""

from __future__ import annotations

import csv
import io
import json
import re
from collections.abc import Iterator, Sequence
from dataclasses import replace
from difflib import get_close_matches
from itertools import pairwise
from math import floor, inf, isfinite, nan
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pinposture.errors import FileError, InvalidValue
from pinposture.motion.joint_trajectory import METRE, RADIAN, JointTrajectory, check_names
from pinposture.storage import read_text, write_text

SUFFIXES = (".npz", ".csv", ".json")
"""Suffixes of files that can be written and read."""


def check_format(path: Path) -> str:
    """The suffix of a file, in small letters.

    Raises:
        FileError: it is of none of the formats.
    """
    suffix = path.suffix.lower()
    if suffix not in SUFFIXES:
        raise FileError(path, f"the name ends in {suffix!r}; allowed: {', '.join(SUFFIXES)}")
    return suffix


# Rates that a file does not have.

Array = NDArray[np.float64]


def with_computed_rates(
    path: Path,
    joints: Sequence[str],
    time: Array,
    values: Sequence[Array],
    units: Sequence[str] = (),
) -> JointTrajectory:
    """Return a trajectory read from a file, with rates computed from positions where the file has none.

    Args:
        path: the file.
        joints: names of the joints, n.
        time: when each row is reached, (N,) [s].
        values: positions, velocities and accelerations, each (N, n); the latter two NaN where there are none.
        units: see `JointTrajectory`.

    Raises:
        FileError: what the file says makes no motion.
    """
    positions, velocities, accelerations = values
    try:
        if not (np.isnan(velocities).any() or np.isnan(accelerations).any()):
            return JointTrajectory(tuple(joints), time, positions, velocities, accelerations, tuple(units))
        known = JointTrajectory.from_positions(joints, positions, time, units)
        return replace(
            known,
            velocities=np.where(np.isnan(velocities), known.velocities, velocities),
            accelerations=np.where(np.isnan(accelerations), known.accelerations, accelerations),
        )
    except InvalidValue as error:
        raise FileError(path, str(error)) from error


# Joint motions as the message that controllers of ROS 2 take, trajectory_msgs/msg/JointTrajectory, in JSON.
#
# Fields and their types are those of the message definitions, of `std_msgs/msg/Header` and of
# `builtin_interfaces/msg/Duration`: seconds are int32, nanoseconds uint32, numbers float64. The stamp is
# zero, so that a controller begins when the message comes. What is left out of a message has the default of
# its type, as on the command line of ROS: zero, or no numbers.

NANOSECONDS = 10**9
"""Nanoseconds."""

MAX_SECONDS = 2**31 - 1
"""The largest int32 [s]."""

MESSAGE = ("header", "joint_names", "points")
POINT_ARRAYS = ("positions", "velocities", "accelerations", "effort")
POINT = (*POINT_ARRAYS, "time_from_start")
DURATION = ("sec", "nanosec")


def to_message(trajectory: JointTrajectory) -> dict[str, Any]:
    """The message, as plain data.

    Raises:
        InvalidValue: rows less than a nanosecond apart, or more seconds than an int32 holds.
    """
    times = [_nanoseconds(float(moment)) for moment in trajectory.time]
    for k, (before, after) in enumerate(pairwise(times), start=1):
        if before == after:
            allowed = f"at least a nanosecond after time[{k - 1}] in a message of ROS 2"
            raise InvalidValue(f"time[{k}]", float(trajectory.time[k]), allowed)
    if times[-1] // NANOSECONDS > MAX_SECONDS:
        allowed = f"at most {MAX_SECONDS} s in a message of ROS 2"
        raise InvalidValue(f"time[{len(times) - 1}]", float(trajectory.time[-1]), allowed)
    rows = zip(
        times,
        trajectory.positions.tolist(),
        trajectory.velocities.tolist(),
        trajectory.accelerations.tolist(),
        strict=True,
    )
    return {
        "header": {"stamp": {"sec": 0, "nanosec": 0}, "frame_id": ""},
        "joint_names": list(trajectory.joint_names),
        "points": [
            {
                "positions": positions,
                "velocities": velocities,
                "accelerations": accelerations,
                "effort": [],
                "time_from_start": {"sec": time // NANOSECONDS, "nanosec": time % NANOSECONDS},
            }
            for time, positions, velocities, accelerations in rows
        ],
    }


def write_ros_message(trajectory: JointTrajectory, path: Path) -> None:
    """Write the message.

    Raises:
        FileError: the file cannot be written.
        InvalidValue: as `to_message`.
    """
    write_text(path, json.dumps(to_message(trajectory), allow_nan=False) + "\n")


def read_ros_message(path: Path) -> JointTrajectory:
    """Read a message, or a goal of the action FollowJointTrajectory, which holds one as its `trajectory`.

    Rates that points do not have are worked out from the positions; efforts are not kept.

    Raises:
        FileError: it is missing, or holds something else; names the point, counted from 0 as in ROS.
    """
    content = _parsed(path)
    if isinstance(content, dict) and "trajectory" in content:
        content = content["trajectory"]
    _check_fields(path, "the message", content, MESSAGE)
    joints = content.get("joint_names", [])
    if not isinstance(joints, list):
        raise FileError(path, f"joint_names is {joints!r}; allowed: a list of names")
    try:
        check_names(joints)
    except InvalidValue as error:
        raise FileError(path, str(error)) from error
    points = content.get("points", [])
    if not (isinstance(points, list) and points):
        raise FileError(path, f"points is {points!r}; allowed: a list of at least one point")
    times: list[int] = []
    tables: dict[str, list[list[float]]] = {name: [] for name in POINT_ARRAYS}
    for k, point in enumerate(points):
        _check_fields(path, f"points[{k}]", point, POINT)
        times.append(_time(path, k, point.get("time_from_start", {}), times[-1] if times else -1))
        for name in POINT_ARRAYS:
            tables[name].append(_numbers(path, k, name, point.get(name, []), len(joints)))
    values = [np.array(tables[name]) for name in POINT_ARRAYS[:3]]
    return with_computed_rates(path, joints, np.array([time / NANOSECONDS for time in times]), values)


def _parsed(path: Path) -> Any:
    try:
        return json.loads(read_text(path))
    except json.JSONDecodeError as error:
        raise FileError(path, f"line {error.lineno}, column {error.colno}: {error.msg}") from error
    except ValueError as error:  # a number of thousands of digits
        raise FileError(path, str(error)) from error
    except RecursionError as error:
        raise FileError(path, "lists within lists without end") from error


def _check_fields(path: Path, what: str, value: Any, fields: tuple[str, ...]) -> None:
    """Refuse what is no object with some of these fields: a misspelt one would be taken as left out."""
    if not isinstance(value, dict):
        raise FileError(path, f"{what} is {_short(value)}; allowed: an object with {', '.join(fields)}")
    for name in value:
        if name not in fields:
            close = get_close_matches(name, fields, n=1)
            hint = f" (did you mean {close[0]!r}?)" if close else ""
            raise FileError(path, f"{what} has a field {name!r}{hint}; allowed: {', '.join(fields)}")


def _time(path: Path, number: int, value: Any, before: int) -> int:
    """The time of a point [ns], after that of the one before it."""
    what = f"points[{number}].time_from_start"
    _check_fields(path, what, value, DURATION)
    for name, most in zip(DURATION, (MAX_SECONDS, NANOSECONDS - 1), strict=True):
        part = value.get(name, 0)
        if type(part) is not int or not 0 <= part <= most:
            raise FileError(path, f"{what}.{name} is {_short(part)}; allowed: whole numbers from 0 to {most}")
    time: int = value.get("sec", 0) * NANOSECONDS + value.get("nanosec", 0)
    if time <= before:
        allowed = f"more than {before / NANOSECONDS} s of points[{number - 1}]"
        raise FileError(path, f"{what} is {time / NANOSECONDS} s; allowed: {allowed}")
    return time


def _numbers(path: Path, number: int, name: str, value: Any, count: int) -> list[float]:
    """Numbers of a point, one for each joint; NaN for all if it has none and need not."""
    what = f"points[{number}].{name}"
    optional = name != "positions"
    if value == [] and optional:
        return [nan] * count
    if not (isinstance(value, list) and len(value) == count):
        found = f"of length {len(value)}" if isinstance(value, list) else _short(value)
        allowed = f"{count}, one for each joint" + (", or none" if optional else "")
        raise FileError(path, f"{what} is {found}; allowed: {allowed}")
    numbers = [_finite(part) for part in value]
    if not all(map(isfinite, numbers)):
        k = next(k for k, part in enumerate(numbers) if not isfinite(part))
        raise FileError(path, f"{what}[{k}] is {_short(value[k])}; allowed: finite numbers")
    return numbers


def _finite(value: Any) -> float:
    if type(value) not in (int, float):
        return nan
    try:
        return float(value)
    except OverflowError:
        return inf


def _short(value: Any) -> str:
    text = json.dumps(value)
    return text if len(text) < 60 else text[:57] + "..."


def _nanoseconds(time: float) -> int:
    """A time in whole nanoseconds, the nearest; seconds apart from the rest, which a product would round."""
    whole = floor(time)
    return whole * NANOSECONDS + round((time - whole) * NANOSECONDS)


# Joint motions as a table in CSV: a line of headings with units, then a line for each row.
#
# The headings are `time [s]`, and for each joint its name followed by `position [rad]`, `velocity [rad/s]`
# and `acceleration [rad/s^2]`, with m in place of rad for a joint that slides. Where it is not known which
# it does, they have no unit.

TIME = "time [s]"
PER_SECOND = {"position": "", "velocity": "/s", "acceleration": "/s^2"}
"""What a file holds of a joint, and what its unit has behind rad or m."""

_HEADING = re.compile(rf"(.+) ({'|'.join(PER_SECOND)})(?: \[([^\[\]]*)\])?")

Places = dict[tuple[str, str], int]
"""The column of each kind of number of each joint."""


def write_table(trajectory: JointTrajectory, path: Path) -> None:
    """Write a table; numbers have as many digits as it takes to read the same numbers back.

    Raises:
        FileError: the file cannot be written.
    """
    headings = [TIME]
    for joint, unit in zip(trajectory.joint_names, trajectory.units, strict=True):
        for kind, per_second in PER_SECOND.items():
            headings.append(f"{joint} {kind} [{unit}{per_second}]" if unit else f"{joint} {kind}")
    # The numbers of a joint stand together.
    values = np.stack([trajectory.positions, trajectory.velocities, trajectory.accelerations], axis=2)
    content = io.StringIO(newline="")
    writer = csv.writer(content, lineterminator="\n")
    writer.writerow(headings)
    writer.writerows(np.column_stack([trajectory.time, values.reshape(len(values), -1)]).tolist())
    write_text(path, content.getvalue())


def read_table(path: Path) -> JointTrajectory:
    """Read a table that has the time first and other columns in any order, rates or none.

    Empty lines, and lines that begin with #, do not count.

    Raises:
        FileError: it is missing, or is not such a table; names the line, and the column where there is one.
    """
    lines = _lines(path)
    number, headings = next(lines, (0, []))
    if not number:
        raise FileError(path, f"is empty; allowed: a line of headings, {TIME!r} first, then rows of numbers")
    places, units = _headings(path, number, headings)
    rows: list[list[float]] = []
    before = 0
    for number, fields in lines:
        if len(fields) != len(headings):
            allowed = f"{len(headings)}, as there are headings"
            raise FileError(path, f"line {number}: {len(fields)} columns; allowed: {allowed}")
        row = [_number(path, number, headings, k, field) for k, field in enumerate(fields)]
        if row[0] < 0.0 or (rows and row[0] <= rows[-1][0]):
            allowed = f"more than {rows[-1][0]} s of line {before}" if rows else "0 or later"
            raise FileError(path, f"line {number}: time is {row[0]} s; allowed: {allowed}")
        rows.append(row)
        before = number
    if not rows:
        raise FileError(path, "holds headings and no rows")
    # A column of NaN behind them stands for all that the file does not tell.
    table = np.array([[*row, nan] for row in rows])
    values = [table[:, [places.get((joint, kind), -1) for joint in units]] for kind in PER_SECOND]
    return with_computed_rates(path, tuple(units), table[:, 0], values, tuple(units.values()))


def _lines(path: Path) -> Iterator[tuple[int, list[str]]]:
    """Number and fields of each line that counts."""
    reader = csv.reader(io.StringIO(read_text(path), newline=""), skipinitialspace=True)
    try:
        for fields in reader:
            stripped = [field.strip() for field in fields]
            if any(stripped) and not stripped[0].startswith("#"):
                yield reader.line_num, stripped
    except csv.Error as error:
        raise FileError(path, f"line {reader.line_num}: {error}") from error


def _headings(path: Path, number: int, headings: Sequence[str]) -> tuple[Places, dict[str, str]]:
    """Where the columns are, and the unit of each joint's position, in the order of their first columns."""
    if headings[0] != TIME:
        raise FileError(path, f"line {number}, column 1: {headings[0]!r}; allowed: {TIME!r}")
    places: Places = {}
    units: dict[str, str] = {}
    for k, heading in enumerate(headings[1:], start=1):
        where = f"line {number}, column {k + 1}: {heading!r}"
        match = _HEADING.fullmatch(heading)
        if match is None:
            kinds = ", ".join(PER_SECOND)
            raise FileError(path, f"{where}; allowed: name of a joint, one of {kinds}, [unit]")
        joint, kind, unit = match.groups()
        known = (
            {base: f"{base}{PER_SECOND[kind]}" for base in (RADIAN, METRE)}
            if unit is not None
            else {"": None}
        )
        base = next((base for base, text in known.items() if text == unit), None)
        if base is None:
            raise FileError(path, f"{where}: unit {unit!r}; allowed: {', '.join(map(str, known.values()))}")
        if units.setdefault(joint, base) != base:
            raise FileError(
                path, f"{where}: other columns of this joint are in {units[joint] or 'no unit'!r}"
            )
        if (joint, kind) in places:
            raise FileError(path, f"{where} is column {places[joint, kind] + 1} as well; allowed: once")
        places[joint, kind] = k
    for kind in PER_SECOND:
        missing = [joint for joint in units if (joint, kind) not in places]
        if missing and (kind == "position" or len(missing) < len(units)):
            has = "position" if kind == "position" else f"{kind}, as others have"
            raise FileError(path, f"line {number}: joint {missing[0]!r} has no column for its {has}")
    if not units:
        raise FileError(path, f"line {number}: no joints; allowed: a column for the position of each")
    return places, units


def _number(path: Path, number: int, headings: Sequence[str], column: int, field: str) -> float:
    try:
        value = float(field)
    except ValueError:
        value = nan
    if not isfinite(value):
        where = f"line {number}, column {column + 1} ({headings[column]})"
        raise FileError(path, f"{where}: {field!r}; allowed: finite numbers")
    return value
