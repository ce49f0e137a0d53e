"""Tables of joint trajectories and of logs in CSV, and rates that files leave out."""

from __future__ import annotations

import csv
import io
import re
from collections.abc import Iterator, Sequence
from dataclasses import replace
from math import isfinite, nan
from pathlib import Path
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from pinposture.errors import FileError, InvalidValue
from pinposture.motion.joint_trajectory import METRE, RADIAN, JointTrajectory
from pinposture.storage import read_text, require_suffix, write_text

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


# A line of headings with units, then a line for each row.
#
# The headings are `time [s]`, and for each joint its name followed by `position [rad]`, `velocity [rad/s]`
# and `acceleration [rad/s^2]`, with m instead of rad for a prismatic joint, and no unit if it is unknown.

TIME = "time [s]"
PER_SECOND = {"position": "", "velocity": "/s", "acceleration": "/s^2"}
"""Kinds of columns of a joint, and what follows rad or m in their units."""


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
    columns, units = _headings(path, number, headings)
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
    values = [table[:, [columns.get((joint, kind), -1) for joint in units]] for kind in PER_SECOND]
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


def _headings(
    path: Path, number: int, headings: Sequence[str]
) -> tuple[dict[tuple[str, str], int], dict[str, str]]:
    """Return the column of each joint and kind, and each joint's unit of position, as they come first."""
    if headings[0] != TIME:
        raise FileError(path, f"line {number}, column 1: {headings[0]!r}; allowed: {TIME!r}")
    columns: dict[tuple[str, str], int] = {}
    units: dict[str, str] = {}
    for k, heading in enumerate(headings[1:], start=1):
        where = f"line {number}, column {k + 1}: {heading!r}"
        match = re.fullmatch(rf"(.+) ({'|'.join(PER_SECOND)})(?: \[([^\[\]]*)\])?", heading)
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
        if (joint, kind) in columns:
            raise FileError(path, f"{where} is also column {columns[joint, kind] + 1}; allowed: once")
        columns[joint, kind] = k
    for kind in PER_SECOND:
        missing = [joint for joint in units if (joint, kind) not in columns]
        if missing and (kind == "position" or len(missing) < len(units)):
            has = "position" if kind == "position" else f"{kind}, as others have"
            raise FileError(path, f"line {number}: joint {missing[0]!r} has no column for its {has}")
    if not units:
        raise FileError(path, f"line {number}: no joints; allowed: a column for the position of each")
    return columns, units


def _number(path: Path, number: int, headings: Sequence[str], column: int, field: str) -> float:
    try:
        value = float(field)
    except ValueError:
        value = nan
    if not isfinite(value):
        where = f"line {number}, column {column + 1} ({headings[column]})"
        raise FileError(path, f"{where}: {field!r}; allowed: finite numbers")
    return value


# Tables of logs: columns of any kinds in any order, the time of any clock, and numbers may be missing.


class Columns(NamedTuple):
    """What a table of a log has.

    Attributes:
        time: times of rows as `Log` takes them.
        names: joints, in the order of their first columns.
        tables: a column of numbers by kind and joint.
        degrees: whether positions and commands are in degrees.
        anonymous: whether the table names no joints; `names` are then numbers, or those that were given.
    """

    time: Array
    names: tuple[str, ...]
    tables: dict[tuple[str, str], Array]
    degrees: bool = False
    anonymous: bool = False

    def table(self, kind: str, names: Sequence[str]) -> Array | None:
        """Return the columns of joints of a kind, (N, n), NaN where one has none; None if all have none."""
        if not any((kind, name) in self.tables for name in names):
            return None
        absent = np.full(len(self.time), nan)
        return np.column_stack([self.tables.get((kind, name), absent) for name in names])


def read_columns(path: Path, kind: str, joint_names: Sequence[str] = ()) -> Columns:
    """Read a table of a log; see `Log.read`.

    Args:
        path: the file.
        kind: what columns are that say nothing else: "position" or "command".
        joint_names: names of the joints, if the table has no headings.

    Raises:
        FileError: the file is missing or not such a table; names the line, and the column if there is one.
    """
    lines = list(_lines(path))
    if not lines:
        raise FileError(path, "is empty; allowed: rows of numbers, with or without a line of headings")
    number, headings = lines[0]
    titled = any(_as_number(field) is None for field in headings)
    rows = lines[1:] if titled else lines
    if not rows:
        raise FileError(path, "contains headings but no rows")
    named = headings if titled else [f"column {k + 1}" for k in range(len(headings))]
    texts = {k for k, field in enumerate(rows[0][1][: len(named)]) if _as_number(field) is None}
    table = np.full((len(rows), len(named)), nan)
    for row, (line, fields) in enumerate(rows):
        if len(fields) != len(named):
            raise FileError(
                path, f"line {line}: {len(fields)} columns; allowed: {len(named)}, as in line {number}"
            )
        for k, field in enumerate(fields):
            value_read = nan if k in texts else _as_number(field)
            if value_read is None:
                where = f"line {line}, column {k + 1} ({named[k]})"
                raise FileError(path, f"{where}: {field!r}; allowed: numbers, or nothing")
            table[row, k] = value_read
    if titled:
        return _titled_columns(path, named, table, kind)
    return _untitled_columns(path, table, kind, joint_names)


def _as_number(field: str) -> float | None:
    """Return a number, NaN for a missing one; None for text."""
    if field.lower() in ("", "-", "nan", "null", "none"):
        return nan
    try:
        return float(field)
    except ValueError:
        return None


def _titled_columns(path: Path, headings: Sequence[str], table: Array, usual: str) -> Columns:
    clock_names = "time|timestamp|stamp|t|dt|sec|secs|nanosec|nsec|nsecs"
    clock_pattern = rf"(?:header[./_])?(?:stamp[./_])?({clock_names})(?: ?\[(\w+)\])?"
    column_pattern = r"(.+?)[ _.](position|command|effort|velocity|acceleration)(?: ?\[([^\[\]]*)\])?"
    times = {None: 1.0, "s": 1.0, "ms": 1e-3, "us": 1e-6, "ns": 1e-9}
    clocks: dict[str, Array] = {}
    tables: dict[tuple[str, str], Array] = {}
    angles: set[bool] = set()
    for k, heading in enumerate(headings):
        where = f"column {k + 1} ({heading})"
        clock = re.fullmatch(clock_pattern, heading, re.IGNORECASE)
        if clock is not None:
            if clock[2] not in times:
                raise FileError(path, f"{where}: unit {clock[2]!r}; allowed: s, ms, us, ns")
            clocks.setdefault(clock[1].lower(), times[clock[2]] * table[:, k])
            continue
        match = re.fullmatch(column_pattern, heading)
        joint, said, unit = match.groups() if match is not None else _plain(heading)
        if said in ("velocity", "acceleration"):
            continue
        kind = usual if said in (None, "position") else said
        units = (None, "", "N m", "Nm", "N") if kind == "effort" else (None, "", RADIAN, METRE, "deg")
        if unit not in units:
            raise FileError(path, f"{where}: unit {unit!r}; allowed: {', '.join(filter(None, units))}")
        if (kind, joint) in tables:
            raise FileError(path, f"{where}: another column is the {kind} of joint {joint!r}; allowed: once")
        if kind != "effort" and unit in (RADIAN, "deg"):
            angles.add(unit == "deg")
        tables[kind, joint] = table[:, k]
    if len(angles) == 2:
        raise FileError(path, "has angles in degrees and in radians; allowed: one of them")
    names = tuple(dict.fromkeys(joint for _, joint in tables))
    return Columns(_clock(path, clocks), names, tables, angles == {True})


def _plain(heading: str) -> tuple[str, None, str | None]:
    """Return the joint that a heading names alone, and its unit."""
    match = re.fullmatch(r"(.+?)(?: ?\[([^\[\]]*)\])?", heading)
    return (heading, None, None) if match is None else (match[1], None, match[2])


def _clock(path: Path, clocks: dict[str, Array]) -> Array:
    """Return times from the columns that tell them."""
    seconds = next((clocks[name] for name in ("sec", "secs") if name in clocks), None)
    rest = next((clocks[name] for name in ("nanosec", "nsec", "nsecs") if name in clocks), None)
    if seconds is not None:
        return seconds if rest is None else np.column_stack([seconds, rest])
    for name in ("time", "timestamp", "stamp", "t"):
        if name in clocks:
            return clocks[name]
    if "dt" in clocks:
        return np.concatenate([[0.0], np.cumsum(np.nan_to_num(clocks["dt"][1:]))])
    raise FileError(path, "has no column for the time; allowed: time, stamp or t; sec and nanosec; or dt")


def _untitled_columns(path: Path, table: Array, kind: str, joint_names: Sequence[str]) -> Columns:
    """Return the columns of a table without headings: the time is the one that increases, first or last."""
    last = table.shape[1] - 1
    increasing = [k for k in sorted({0, last}) if _increases(table[:, k])]
    if len(increasing) != 1 or last < 1:
        said = "both increase" if len(increasing) == 2 else "neither increases"
        raise FileError(
            path, f"has no headings, and of its first and last column, one of which is the time, {said}"
        )
    columns = np.delete(table, increasing[0], axis=1)
    count = columns.shape[1]
    names = tuple(joint_names) or tuple(str(k) for k in range(count))
    if len(names) != count:
        raise FileError(path, f"has {count} columns beside the time; allowed: {len(names)}, as joint_names")
    tables = {(kind, name): columns[:, k] for k, name in enumerate(names)}
    return Columns(table[:, increasing[0]], names, tables, anonymous=True)


def _increases(column: Array) -> bool:
    """Return whether a column never decreases, and increases in most rows."""
    steps = np.diff(column[np.isfinite(column)])
    return bool(len(steps) and np.all(steps >= 0.0) and np.mean(steps > 0.0) > 0.5)
