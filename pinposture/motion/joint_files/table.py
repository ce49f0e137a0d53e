"""Joint motions as a table in CSV: a line of headings with units, then a line for each row.

The headings are `time [s]`, and for each joint its name followed by `position [rad]`, `velocity [rad/s]` and
`acceleration [rad/s^2]`, with m in place of rad for a joint that slides. Where it is not known which it does,
they have no unit.
"""

from __future__ import annotations

import csv
import io
import re
from collections.abc import Iterator, Sequence
from math import isfinite, nan
from pathlib import Path

import numpy as np

from pinposture.errors import FileError
from pinposture.motion.joint_files.completing import completed
from pinposture.motion.joint_positions import SLIDE, TURN
from pinposture.motion.joint_trajectory import JointTrajectory
from pinposture.storage import read_text, write_text

TIME = "time [s]"
PER_SECOND = {"position": "", "velocity": "/s", "acceleration": "/s^2"}
"""What is told of a joint, and what its unit has behind rad or m."""

_HEADING = re.compile(rf"(.+) ({'|'.join(PER_SECOND)})(?: \[([^\[\]]*)\])?")

Places = dict[tuple[str, str], int]
"""The column of each kind of number of each joint."""


def write(trajectory: JointTrajectory, path: Path) -> None:
    """Write a table; numbers have as many digits as it takes to read the same numbers back.

    Raises:
        FileError: the file cannot be written.
    """
    headings = [TIME]
    for joint, unit in zip(trajectory.joint_names, trajectory.units, strict=True):
        for kind, per_second in PER_SECOND.items():
            headings.append(f"{joint} {kind} [{unit}{per_second}]" if unit else f"{joint} {kind}")
    # The numbers of a joint stand together.
    told = np.stack([trajectory.positions, trajectory.velocities, trajectory.accelerations], axis=2)
    content = io.StringIO(newline="")
    writer = csv.writer(content, lineterminator="\n")
    writer.writerow(headings)
    writer.writerows(np.column_stack([trajectory.time, told.reshape(len(told), -1)]).tolist())
    write_text(path, content.getvalue())


def read(path: Path) -> JointTrajectory:
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
    told = [table[:, [places.get((joint, kind), -1) for joint in units]] for kind in PER_SECOND]
    return completed(path, tuple(units), table[:, 0], told, tuple(units.values()))


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
            {base: f"{base}{PER_SECOND[kind]}" for base in (TURN, SLIDE)} if unit is not None else {"": None}
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
