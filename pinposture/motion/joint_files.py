"""Text files of joint trajectories: CSV tables, and ROS 2 messages in JSON or YAML."""

from __future__ import annotations

import csv
import io
import json
import re
from collections.abc import Iterator, Sequence
from contextlib import suppress
from dataclasses import replace
from itertools import pairwise
from math import floor, inf, isfinite, nan
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pinposture.errors import FileError, InvalidValue, did_you_mean
from pinposture.motion.joint_trajectory import METRE, RADIAN, JointTrajectory, check_names
from pinposture.storage import parse_json, read_text, require_suffix, write_text

SUFFIXES = (".npz", ".csv", ".json", ".yaml", ".yml")
"""Suffixes of files that can be written and read."""


def check_format(path: Path) -> str:
    """Return the suffix of a file in lower case; raise FileError if it is not one of `SUFFIXES`."""
    return require_suffix(path, *SUFFIXES)


Array = NDArray[np.float64]


def with_computed_rates(
    path: Path,
    joints: Sequence[str],
    time: Array,
    values: Sequence[Array],
    units: Sequence[str] = (),
) -> JointTrajectory:
    """Return a trajectory read from a file, with missing rates computed from positions.

    Args:
        path: the file.
        joints: names of the joints, n.
        time: time of each row, (N,) [s].
        values: positions, velocities and accelerations, each (N, n); missing rates are NaN.
        units: see `JointTrajectory`.

    Raises:
        FileError: the data are not a valid trajectory.
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


# The ROS 2 message trajectory_msgs/msg/JointTrajectory in JSON.
#
# Fields and types are those of the message definition, of `std_msgs/msg/Header` and of
# `builtin_interfaces/msg/Duration`: int32 seconds, uint32 nanoseconds, float64 numbers. The stamp is zero, so
# that a controller starts on receipt. Missing fields have the default of their type, as on the ROS command
# line: zero or empty.

NANOSECONDS = 10**9
"""Nanoseconds per second."""

MAX_SECONDS = 2**31 - 1
"""Largest int32 [s]."""

MESSAGE = ("header", "joint_names", "points")
POINT_ARRAYS = ("positions", "velocities", "accelerations", "effort")
POINT = (*POINT_ARRAYS, "time_from_start")
DURATION = ("sec", "nanosec")


def to_message(trajectory: JointTrajectory) -> dict[str, Any]:
    """Return the message as plain data.

    Raises:
        InvalidValue: rows less than a nanosecond apart, or times out of the range of int32 seconds.
    """
    times = [_nanoseconds(float(moment)) for moment in trajectory.time]
    for k, (before, after) in enumerate(pairwise(times), start=1):
        if before == after:
            allowed = f"at least a nanosecond after time[{k - 1}] in a ROS 2 message"
            raise InvalidValue(f"time[{k}]", float(trajectory.time[k]), allowed)
    if times[-1] // NANOSECONDS > MAX_SECONDS:
        allowed = f"at most {MAX_SECONDS} s in a ROS 2 message"
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
    """Write the message in JSON, which is also YAML.

    Raises:
        FileError: the file cannot be written.
        InvalidValue: as `to_message`.
    """
    write_text(path, json.dumps(to_message(trajectory), allow_nan=False) + "\n")


def read_ros_message(path: Path) -> JointTrajectory:
    """Read a message, or a goal of the action FollowJointTrajectory with one as its `trajectory`.

    Missing rates are computed from positions; efforts are dropped.

    Raises:
        FileError: the file is missing or contains something else; names the point, 0-based.
    """
    text = read_text(path)
    content = parse_json(path, text) if path.suffix.lower() == ".json" else _parse_yaml(path, text)
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


def _parse_yaml(path: Path, text: str) -> Any:
    """Return the content of a YAML text with one document, as `ros2 topic echo --once` prints it.

    Raises:
        FileError: it is malformed; names the line. It is not JSON as well, and PyYAML is not installed.
    """
    with suppress(ValueError, RecursionError):
        return json.loads(text)
    try:
        import yaml
    except ImportError:
        raise FileError(
            path, "is YAML and not JSON, which needs another package; pip install pyyaml"
        ) from None
    try:
        documents = [each for each in yaml.safe_load_all(text) if each is not None]
    except yaml.YAMLError as error:
        mark = getattr(error, "problem_mark", None)
        line = "" if mark is None else f"line {mark.line + 1}: "
        raise FileError(path, f"{line}{getattr(error, 'problem', None) or 'is not YAML'}") from error
    except (ValueError, RecursionError) as error:
        raise FileError(path, f"cannot be read as YAML ({error})") from error
    if len(documents) != 1:
        raise FileError(path, f"has {len(documents)} documents; allowed: one message")
    return documents[0]


def _check_fields(path: Path, what: str, value: Any, fields: tuple[str, ...]) -> None:
    """Raise FileError unless a value is an object with some of these fields; others may be misspelt."""
    if not isinstance(value, dict):
        raise FileError(path, f"{what} is {_short(value)}; allowed: an object with {', '.join(fields)}")
    for name in value:
        if name not in fields:
            hint = did_you_mean(name, fields)
            raise FileError(path, f"{what} has a field {name!r}{hint}; allowed: {', '.join(fields)}")


def _time(path: Path, number: int, value: Any, before: int) -> int:
    """Return the time of a point [ns], which must be after the previous one."""
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
    """Return the numbers of a point, one for each joint; NaN if optional ones are missing."""
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
    text = json.dumps(value, default=str)
    return text if len(text) < 60 else text[:57] + "..."


def _nanoseconds(time: float) -> int:
    """Return a time rounded to whole nanoseconds; seconds are split off, as their product would round."""
    whole = floor(time)
    return whole * NANOSECONDS + round((time - whole) * NANOSECONDS)


# CSV tables: a line of headings with units, then a line for each row.
#
# The headings are `time [s]`, and for each joint its name followed by `position [rad]`, `velocity [rad/s]`
# and `acceleration [rad/s^2]`, with m instead of rad for a prismatic joint, and no unit if it is unknown.

TIME = "time [s]"
PER_SECOND = {"position": "", "velocity": "/s", "acceleration": "/s^2"}
"""Kinds of columns of a joint, and what follows rad or m in their units."""

_HEADING = re.compile(rf"(.+) ({'|'.join(PER_SECOND)})(?: \[([^\[\]]*)\])?")

Places = dict[tuple[str, str], int]
"""Column of each joint and kind."""


def write_table(trajectory: JointTrajectory, path: Path) -> None:
    """Write a table; numbers have enough digits to be read back exactly.

    Raises:
        FileError: the file cannot be written.
    """
    headings = [TIME]
    for joint, unit in zip(trajectory.joint_names, trajectory.units, strict=True):
        for kind, per_second in PER_SECOND.items():
            headings.append(f"{joint} {kind} [{unit}{per_second}]" if unit else f"{joint} {kind}")
    # The columns of a joint are adjacent.
    values = np.stack([trajectory.positions, trajectory.velocities, trajectory.accelerations], axis=2)
    content = io.StringIO(newline="")
    writer = csv.writer(content, lineterminator="\n")
    writer.writerow(headings)
    writer.writerows(np.column_stack([trajectory.time, values.reshape(len(values), -1)]).tolist())
    write_text(path, content.getvalue())


def read_table(path: Path) -> JointTrajectory:
    """Read a table with the time first and other columns in any order, with or without rates.

    Empty lines, and lines that begin with #, are ignored.

    Raises:
        FileError: the file is missing or not such a table; names the line, and the column if there is one.
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
        raise FileError(path, "contains headings but no rows")
    # A last column of NaN stands for missing rates.
    table = np.array([[*row, nan] for row in rows])
    values = [table[:, [places.get((joint, kind), -1) for joint in units]] for kind in PER_SECOND]
    return with_computed_rates(path, tuple(units), table[:, 0], values, tuple(units.values()))


def _lines(path: Path) -> Iterator[tuple[int, list[str]]]:
    """Yield the number and the fields of each line that is not ignored."""
    reader = csv.reader(io.StringIO(read_text(path), newline=""), skipinitialspace=True)
    try:
        for fields in reader:
            stripped = [field.strip() for field in fields]
            if any(stripped) and not stripped[0].startswith("#"):
                yield reader.line_num, stripped
    except csv.Error as error:
        raise FileError(path, f"line {reader.line_num}: {error}") from error


def _headings(path: Path, number: int, headings: Sequence[str]) -> tuple[Places, dict[str, str]]:
    """Return the columns, and the unit of each joint's position in the order of their first columns."""
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
        bases = (RADIAN, METRE) if unit is not None else ()
        known: dict[str, str | None] = {base: f"{base}{PER_SECOND[kind]}" for base in bases} or {"": None}
        base = next((base for base, text in known.items() if text == unit), None)
        if base is None:
            raise FileError(path, f"{where}: unit {unit!r}; allowed: {', '.join(map(str, known.values()))}")
        if units.setdefault(joint, base) != base:
            other = units[joint] or "no unit"
            raise FileError(path, f"{where}: other columns of this joint are in {other!r}")
        if (joint, kind) in places:
            raise FileError(path, f"{where} is also column {places[joint, kind] + 1}; allowed: once")
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
