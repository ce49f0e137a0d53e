"""Joint motions as the message that controllers of ROS 2 take, trajectory_msgs/msg/JointTrajectory, in JSON.

Fields and their types are those of the message definitions, of `std_msgs/msg/Header` and of
`builtin_interfaces/msg/Duration`: seconds are int32, nanoseconds uint32, numbers float64. The stamp is zero,
so that a controller begins when the message comes. What is left out of a message has the default of its type,
as on the command line of ROS: zero, or no numbers.
"""

from __future__ import annotations

import json
from difflib import get_close_matches
from itertools import pairwise
from math import floor, inf, isfinite, nan
from pathlib import Path
from typing import Any

import numpy as np

from pinposture.errors import FileError, InvalidValue
from pinposture.motion.joint_checks import check_names
from pinposture.motion.joint_files.completing import completed
from pinposture.motion.joint_trajectory import JointTrajectory
from pinposture.storage import read_text, write_text

SECOND = 10**9
"""Nanoseconds."""

LONGEST = 2**31 - 1
"""The largest int32 [s]."""

MESSAGE = ("header", "joint_names", "points")
NUMBERS = ("positions", "velocities", "accelerations", "effort")
POINT = (*NUMBERS, "time_from_start")
DURATION = ("sec", "nanosec")


def message(trajectory: JointTrajectory) -> dict[str, Any]:
    """The message, as plain data.

    Raises:
        InvalidValue: rows less than a nanosecond apart, or more seconds than an int32 holds.
    """
    times = [_nanoseconds(float(moment)) for moment in trajectory.time]
    for k, (before, after) in enumerate(pairwise(times), start=1):
        if before == after:
            allowed = f"at least a nanosecond after time[{k - 1}] in a message of ROS 2"
            raise InvalidValue(f"time[{k}]", float(trajectory.time[k]), allowed)
    if times[-1] // SECOND > LONGEST:
        allowed = f"at most {LONGEST} s in a message of ROS 2"
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
                "time_from_start": {"sec": time // SECOND, "nanosec": time % SECOND},
            }
            for time, positions, velocities, accelerations in rows
        ],
    }


def write(trajectory: JointTrajectory, path: Path) -> None:
    """Write the message.

    Raises:
        FileError: the file cannot be written.
        InvalidValue: as `message`.
    """
    write_text(path, json.dumps(message(trajectory), allow_nan=False) + "\n")


def read(path: Path) -> JointTrajectory:
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
    tables: dict[str, list[list[float]]] = {name: [] for name in NUMBERS}
    for k, point in enumerate(points):
        _check_fields(path, f"points[{k}]", point, POINT)
        times.append(_time(path, k, point.get("time_from_start", {}), times[-1] if times else -1))
        for name in NUMBERS:
            tables[name].append(_numbers(path, k, name, point.get(name, []), len(joints)))
    told = [np.array(tables[name]) for name in NUMBERS[:3]]
    return completed(path, joints, np.array([time / SECOND for time in times]), told)


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
    for name, most in zip(DURATION, (LONGEST, SECOND - 1), strict=True):
        part = value.get(name, 0)
        if type(part) is not int or not 0 <= part <= most:
            raise FileError(path, f"{what}.{name} is {_short(part)}; allowed: whole numbers from 0 to {most}")
    time: int = value.get("sec", 0) * SECOND + value.get("nanosec", 0)
    if time <= before:
        allowed = f"more than {before / SECOND} s of points[{number - 1}]"
        raise FileError(path, f"{what} is {time / SECOND} s; allowed: {allowed}")
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
    return whole * SECOND + round((time - whole) * SECOND)
