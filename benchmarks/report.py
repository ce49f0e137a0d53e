"""What a study prints and saves: tables or JSON, a CSV file of its rows, its summary, and pictures."""

from __future__ import annotations

import json
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

from benchmarks.harness import Row, Study
from pinposture.cli.inputs import ARM, MOTION, OUTPUT, JobsOption, JsonOption
from pinposture.cli.output import (
    Cell,
    check_directory,
    count_progress,
    print_json,
    print_note,
    print_table,
    print_warning,
)
from pinposture.errors import InvalidValue
from pinposture.storage import write_figure, write_table, write_text

if TYPE_CHECKING:
    from matplotlib.figure import Figure


ArmsOption = Annotated[str | None, ARM("Built-in arms: ryrz20, planar45.", "NAME,...")]
ControllersOption = Annotated[str | None, MOTION("Controllers to compare.", "NAME,...")]
SeedOption = Annotated[int, MOTION("First seed.", "N", flags="--seed0")]

ROWS, SUMMARY = "cases.csv", "summary.json"

Columns = Mapping[str, Callable[[Row], Cell]]
"""The headings of a table, and functions of a row that return the cells below them."""

Table = tuple[Sequence[str], Sequence[Sequence[Cell]]]


@dataclass(frozen=True)
class Report:
    """What a study found.

    Attributes:
        rows: the rows.
        summary: the results, JSON-compatible.
        tables: the same in words.
        pictures: functions of the rows that draw a figure, by file name without suffix.
        notes: remarks.
        warnings: runs that did not do as they should.
    """

    rows: Sequence[Row]
    summary: Mapping[str, Any]
    tables: Sequence[Table]
    pictures: Mapping[str, Callable[[Sequence[Row]], Figure]] = field(default_factory=dict)
    notes: Sequence[str] = ()
    warnings: Sequence[str] = ()


@dataclass(frozen=True)
class StudyOptions:
    """How a study is run, and where its results go."""

    jobs: JobsOption = 1
    as_json: JsonOption = False
    output: Annotated[
        Path | None,
        OUTPUT(
            "Save a row for each run (cases.csv), the summary (summary.json) and any pictures here.",
            "DIR",
            flags="--output -o",
        ),
    ] = None

    def run(self, study: Study, noun: str = "case") -> list[Row]:
        """Check that the directory is writable, then run a study with a progress bar of its cases."""
        check_directory(self.output)
        with count_progress(noun) as progress:
            return study.rows(self.jobs, progress)

    def write(self, report: Report) -> None:
        """Print a report, as one JSON object or as tables, and save it even if printing fails."""
        try:
            if self.as_json:
                print_json(report.summary)
            else:
                for headings, lines in report.tables:
                    print_table(headings, lines)
            for note in report.notes:
                print_note(note)
            for warning in report.warnings:
                print_warning(warning)
        finally:
            if self.output is not None:
                for file in save_report(self.output, report):
                    print_note(f"wrote {file}")


def save_report(directory: Path, report: Report) -> list[Path]:
    """Write a report to a directory, created if necessary, and return the paths of its files.

    Each file is written atomically; the summary comes last, so that it marks a complete study.

    Raises:
        FileError: a file cannot be written.
    """
    files = [directory / ROWS]
    heads = list(report.rows[0]) if report.rows else []
    write_table(files[0], [heads, *(list(row.values()) for row in report.rows)])
    for name, draw in report.pictures.items():
        files.append(directory / f"{name}.png")
        write_figure(files[-1], draw(report.rows))
    files.append(directory / SUMMARY)
    write_json(files[-1], report.summary)
    return files


def write_json(path: Path, content: object) -> None:
    """Write JSON-compatible data as `write_text` does; numbers must be finite."""
    write_text(path, json.dumps(content, indent=1, allow_nan=False) + "\n")


def table(columns: Columns, rows: Iterable[Row]) -> Table:
    """Return the table of some rows."""
    return tuple(columns), [[cell(row) for cell in columns.values()] for row in rows]


def percent(name: str) -> Callable[[Row], Cell]:
    """Return a function of a row that formats a share, rounded down, so that 100 % means all."""
    return lambda row: f"{int(1000.0 * row[name] + 1e-9) / 10.0:g} %"


def short(value: float | None, form: str = ".2g") -> str | None:
    """Format a number, if there is one."""
    return None if value is None else f"{value:{form}}"


def spread_cell(name: str, form: str) -> Callable[[Row], Cell]:
    """Return a function of a row that formats median (90th percentile) of a quantity, if present."""

    def cell(row: Row) -> Cell:
        spread = row[name]
        return None if spread is None else f"{spread.median:{form}} ({spread.high:{form}})"

    return cell


def split_names(option: str, text: str | None, usual: Iterable[str]) -> list[str]:
    """Return names separated by commas, each once, or the default ones; raise InvalidValue otherwise."""
    if text is None:
        return list(usual)
    names = [name.strip() for name in text.split(",")]
    if not all(names) or len(set(names)) < len(names):
        raise InvalidValue(option, text, "names separated by commas, each once")
    return names
