"""`pinposture study scenes`: an arm among obstacles, many times."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from pinposture.cli.inputs import MOTION, OUTPUT, JobsOption, JsonOption
from pinposture.cli.output import print_json, print_note, print_table, print_warning
from pinposture.cli.progress import count_progress
from pinposture.cli.studies import SeedOption, check_output, described, split_names

if TYPE_CHECKING:
    from pinposture.study.scene_record import SceneRun
    from pinposture.study.scenes import SceneRow
    from pinposture.study.table import Spread

EXAMPLES = (
    "pinposture study scenes --scenes post,wall,inside",
    "pinposture study scenes --seeds 2 --json",
    "pinposture study scenes --jobs -1 -o out/scenes",
)

_HEADINGS = ("scene", "runs", "reached", "margin kept", "room [mm]", "steps", "path", "escaping", "time [s]")


def run(
    *,
    scenes: Annotated[
        str | None,
        typer.Option(
            metavar="NAME,...",
            help="Some of: post,slot,narrow,wall,pipe,inside,coil,out; else all.",
            rich_help_panel=MOTION,
        ),
    ] = None,
    seeds: Annotated[
        int, typer.Option(metavar="N", help="Number of runs in each scene.", rich_help_panel=MOTION)
    ] = 10,
    seed0: SeedOption = 0,
    jobs: JobsOption = 1,
    output: Annotated[
        Path | None,
        typer.Option(
            "--output",
            "-o",
            metavar="DIR",
            help="Leave a row for each run (cases.csv) and the summary (summary.json) here.",
            rich_help_panel=OUTPUT,
        ),
    ] = None,
    as_json: JsonOption = False,
) -> None:
    """Drive 20 RyRz modules, 1 m, among obstacles, and say who keeps clear, who gets there, and how.

    The arm goes round a post, threads a slot of 20 cm in a wall, and a narrow one of 12 cm; unfolds close
    before a wall; reaches through a pipe to hook back beside it; is sent inside a ball, where it must stop
    short; turns a coil into its mirror image without touching itself; and comes out of a ball in which it
    starts. Each seed varies start and target a little; draws that are not as clear as they should be are
    refused. At most 0.1 rad per step and joint, and 400 steps.

    Room is the smallest distance, looked up at ten places of every step, minus the margin, in the worst run;
    negative where the arm starts in collision. Such a run keeps its margin if the arm never goes deeper,
    comes out, and keeps it from there on. The last four columns are median (90th percentile) of the number
    of steps, of the length of the paths of the control points relative to the straight ways, of the share
    of steps flagged as an escape, and of the time of a run. Runs that did not do as they should are named
    one by one. All of it takes some ten minutes on two processes.
    """
    from pinposture.study.record_files import keep_study
    from pinposture.study.scene_record import SceneRun
    from pinposture.study.scenes import by_scene, study_scenes
    from pinposture.study.situations import SITUATIONS

    check_output(output)
    names = list(SITUATIONS) if scenes is None else split_names("--scenes", scenes)
    with count_progress("run") as progress:
        runs = study_scenes(names, seeds, seed0, jobs, progress)
    rows = by_scene(runs)
    asked = {"study": "scenes", "scenes": names, "seeds": seeds, "seed0": seed0}
    found = {**asked, "rows": [described(row) for row in rows]}
    if as_json:
        print_json(found)
    else:
        print_table(_HEADINGS, [_line(row) for row in rows])
    refused = [f"{row.scene} {row.refused}" for row in rows if row.refused]
    if refused:
        print_note(f"starts and targets that were drawn and refused: {', '.join(refused)}")
    for each in runs:
        if not each.as_it_should:
            print_warning(f"{each.scene}, seed {each.seed}: {_fault(each)}")
    if output is not None:
        for file in keep_study(output, runs, found, {}, SceneRun._fields):
            print_note(f"wrote {file}")


def _line(row: SceneRow) -> tuple[str | float | None, ...]:
    return (
        row.scene,
        row.runs,
        f"{row.reached} of {row.reachable}",
        f"{row.kept} of {row.runs}",
        f"{1e3 * row.room:.2f}",
        _spread(row.steps, ".0f"),
        _spread(row.path, ".2f"),
        _spread(row.escaping, ".0%"),
        _spread(row.seconds, ".1f"),
    )


def _spread(spread: Spread, form: str) -> str:
    """Median (90th percentile)."""
    return f"{spread.median:{form}} ({spread.high:{form}})"


def _fault(run: SceneRun) -> str:
    """What a run did not do as it should, in words."""
    faults = []
    if run.loss > 0.0 and not run.kept:
        faults.append(f"came {1e3 * run.loss:.3g} mm closer than it may")
    elif not run.kept:
        faults.append(f"ended {1e3 * run.end:.3g} mm apart, within the margin")
    if run.reached != run.reachable:
        faults.append(f"{'did not reach' if run.reachable else 'reached'} its target ({run.status})")
    if not run.explained:
        faults.append(f"names nothing that was in the way ({run.reason})")
    return "; ".join(faults)
