"""Records of runs as files: a CSV of one row for each run, a summary as JSON, a picture."""

from __future__ import annotations

import csv
import io
import json
from collections.abc import Callable, Iterable, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any, get_type_hints

from pinposture.errors import FileError
from pinposture.storage import write_bytes, write_text
from pinposture.study.record import Record

if TYPE_CHECKING:
    from matplotlib.figure import Figure

CASES, SUMMARY = "cases.csv", "summary.json"

_PARSERS: dict[object, Callable[[str], Any]] = {
    str: str,
    int: int,
    float: float,
    float | None: lambda text: float(text) if text else None,
}


def write_records(
    records: Iterable[tuple[Any, ...]], path: str | Path, fields: Sequence[str] = Record._fields
) -> Path:
    """Write one row for each run, under a row of field names; no digit is lost.

    Args:
        records: the runs, named tuples with those fields.
        path: the file.
        fields: names of the fields; those of `Record` unless told otherwise.

    Returns:
        The path written.

    Raises:
        FileError: the file cannot be written.
    """
    text = io.StringIO()
    writer = csv.writer(text, lineterminator="\n")
    writer.writerow(fields)
    # csv writes floats by repr, which reads back as the same number, and None as nothing.
    writer.writerows(records)
    write_text(Path(path), text.getvalue())
    return Path(path)


def read_records(path: str | Path) -> list[Record]:
    """Read what `write_records` wrote.

    Raises:
        FileError: the file is missing, has other columns, or a row that is no record; names the line.
    """
    path = Path(path)
    try:
        text = path.read_text(encoding="utf-8")
    except OSError as error:
        raise FileError(path, f"cannot be read ({error.strerror or error})") from error
    except UnicodeDecodeError as error:
        raise FileError(path, "is not a table of runs (not UTF-8 text)") from error
    rows = csv.reader(io.StringIO(text))
    if next(rows, None) != list(Record._fields):
        raise FileError(path, f"is not a table of runs; allowed: the columns {', '.join(Record._fields)}")
    kinds = get_type_hints(Record)
    parsers = [_PARSERS[kinds[name]] for name in Record._fields]
    records = []
    for row in rows:
        try:
            records.append(Record(*(parse(cell) for parse, cell in zip(parsers, row, strict=True))))
        except ValueError as error:
            raise FileError(path, f"line {rows.line_num}: is not a run ({error})") from error
    return records


def keep_study(
    directory: str | Path,
    records: Iterable[tuple[Any, ...]],
    summary: Mapping[str, Any],
    figures: Mapping[str, Figure],
    fields: Sequence[str] = Record._fields,
) -> list[Path]:
    """Leave a study in a directory, which is made if need be; each file appears whole or not at all.

    Args:
        directory: where to.
        records: its runs, for cases.csv.
        summary: what is said of them, as data that JSON can hold, for summary.json.
        figures: pictures by the names of their files, written as PNG.
        fields: names of the fields of a run; those of `Record` unless told otherwise.

    Returns:
        Paths of the files.

    Raises:
        FileError: a file cannot be written.
    """
    directory = Path(directory)
    files = [write_records(records, directory / CASES, fields)]
    for name, figure in figures.items():
        picture = io.BytesIO()
        figure.savefig(picture, format="png")
        files.append(directory / name)
        write_bytes(files[-1], picture.getvalue())
    files.append(directory / SUMMARY)  # last: where it is, the rest is
    write_text(files[-1], json.dumps(summary, indent=1, allow_nan=False) + "\n")
    return files
