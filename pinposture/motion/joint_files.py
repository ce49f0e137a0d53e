"""Tables of joint trajectories in CSV, and rates that files leave out."""

from __future__ import annotations

import csv
import io
import re
from collections.abc import Iterator, Sequence
from dataclasses import replace
from math import isfinite, nan
from pathlib import Path

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
