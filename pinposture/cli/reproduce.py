"""`pinposture reproduce`: the experiments of the thesis once more."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from pinposture.cli.inputs import MOTION, OUTPUT, JobsOption, JsonOption
from pinposture.cli.output import count_progress, examples, print_json, print_note, print_table

if TYPE_CHECKING:
    from pinposture.study.reproduce import Reproduction


@examples(
    "pinposture reproduce",
    "pinposture reproduce 6.3 6.4",
    "pinposture reproduce claims --seeds 10",
    "pinposture reproduce all -o out/thesis",
)
def run(
    *,
    figures: Annotated[
        list[str] | None,
        typer.Argument(metavar="[FIGURE]...", help="6.3 to 6.12, claims, or all; else they are listed."),
    ] = None,
    seeds: Annotated[
        int, typer.Option(metavar="N", help="Number of seeds to judge claims over.", rich_help_panel=MOTION)
    ] = 100,
    steps: Annotated[
        int, typer.Option(metavar="N", help="Steps after which a run ends.", rich_help_panel=MOTION)
    ] = 200,
    jobs: JobsOption = -1,
    output: Annotated[
        Path,
        typer.Option("--output", "-o", metavar="DIR", help="Where to leave files.", rich_help_panel=OUTPUT),
    ] = Path("out/reproduce"),
    as_json: JsonOption = False,
) -> None:
    """Reproduce the experiments of chapter 6 of the thesis, and judge its claims.

    Each figure is drawn as the thesis lays it out, from runs whose numbers go to results.json. The claims are
    measured over many seeds; results.json has every number and a verdict on each, claims.md the same to read.
    All of it takes some minutes.
    """
    if not figures:
        _list(as_json)
        return
    from pinposture.study.reproduce import reproduce

    with count_progress("run") as progress:
        done = reproduce(figures, output, seeds, steps, jobs, progress)
    if as_json:
        print_json(done.results)
    else:
        _print(done)
    for file in done.files:
        print_note(f"wrote {file}")


def _list(as_json: bool) -> None:
    """Say what there is to reproduce."""
    from pinposture.study.claims import CLAIMS, FIGURES

    rows: list[tuple[str, str, str]] = [
        (number, each.title, f"Section {each.section}") for number, each in FIGURES.items()
    ]
    if as_json:
        shown = [{"figure": number, "title": title, "section": section} for number, title, section in rows]
        print_json({"figures": shown, "claims": len(CLAIMS)})
        return
    rows.append(("claims", f"verdicts on {len(CLAIMS)} claims", "all chapters"))
    rows.append(("all", "everything", ""))
    print_table(("figure", "shows", "thesis"), rows)


def _print(done: Reproduction) -> None:
    """The tables at the end."""
    from pinposture.study.reproduce.reproduction import span

    runs = [
        (
            figure.about.number,
            name,
            f"{run.posture_error[0]:.3g} -> {run.posture_error[-1]:.3g}",
            run.steps,
            run.status,
            figure.about.title,
        )
        for figure in done.figures
        for name, run in figure.runs.items()
    ]
    if runs:
        print_table(("figure", "controller", "posture error [m]", "steps", "ending", "shows"), runs)
    claims = [
        (each.verdict, span(each.finding.shares), each.claim.text, each.claim.where) for each in done.judged
    ]
    if claims:
        print_table(("verdict", "true in", "claim", "where"), claims)
