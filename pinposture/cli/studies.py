"""What the verbs that drive many arms have in common: options, names, refusals."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from pinposture.cli.inputs import ARM, MOTION, OUTPUT
from pinposture.cli.output import print_warning
from pinposture.errors import InvalidValue

if TYPE_CHECKING:
    from pinposture.study import Bin, Record, SceneRow, Subject, SummaryRow

ArmsOption = Annotated[
    str | None,
    typer.Option(metavar="NAME,...", help="Arms that are built in: ryrz20,planar45.", rich_help_panel=ARM),
]
ControllersOption = Annotated[
    str | None,
    typer.Option(metavar="NAME,...", help="Controllers to compare.", rich_help_panel=MOTION),
]
SeedOption = Annotated[int, typer.Option("--seed0", metavar="N", help="First seed.", rich_help_panel=MOTION)]
OutputOption = Annotated[
    Path | None,
    typer.Option(
        "--output",
        "-o",
        metavar="DIR",
        help="Leave a row for each run (cases.csv), the summary (summary.json) and a picture here.",
        rich_help_panel=OUTPUT,
    ),
]


def built_subjects(names: str | None) -> list[Subject]:
    """The arms of these names, or all that are built in.

    Raises:
        InvalidValue: nothing between two of the commas.
        UnknownName: there is no such arm.
    """
    from pinposture.study import built_subject
    from pinposture.study.families import BUILT

    listed = list(BUILT) if names is None else split_names("--arms", names)
    return [built_subject(name) for name in listed]


def split_names(option: str, text: str) -> list[str]:
    """Names separated by commas, each once; raises InvalidValue if there is nothing between two of them."""
    names = [name.strip() for name in text.split(",")]
    if not all(names) or len(set(names)) < len(names):
        raise InvalidValue(option, text, "names separated by commas, each once")
    return names


def check_output(directory: Path | None) -> None:
    """Refuse a directory in which no file can be made, before anybody waits for what goes there."""
    from pinposture.storage import check_writable

    if directory is not None:
        check_writable(directory)


def described(row: SummaryRow | Bin | SceneRow) -> dict[str, Any]:
    """A row of a table as data that JSON can hold."""
    return {
        name: value._asdict() if hasattr(value, "_asdict") else value for name, value in row._asdict().items()
    }


def report_refusals(records: list[Record]) -> None:
    """Say on stderr which controllers would not begin, how often, and why at first."""
    refused: dict[str, list[Record]] = {}
    for record in records:
        if record.status == "refused":
            refused.setdefault(record.controller, []).append(record)
    for controller, those in refused.items():
        print_warning(f"{controller} refused {len(those)} of its runs: {those[0].reason}")
