"""`pinposture study headings`: how far some part of the arm must turn, and who can."""

from __future__ import annotations

from typing import TYPE_CHECKING, Annotated

import typer

from pinposture.cli.inputs import MOTION, JobsOption, JsonOption
from pinposture.cli.output import print_json, print_note, print_table
from pinposture.cli.progress import count_progress
from pinposture.cli.studies import (
    ArmsOption,
    ControllersOption,
    OutputOption,
    SeedOption,
    built_subjects,
    check_output,
    described,
    report_refusals,
    split_names,
)

if TYPE_CHECKING:
    from pinposture.study import Bin

EXAMPLES = (
    "pinposture study headings --pairs 50 --arms planar45",
    "pinposture study headings --controllers switching,lm --target curve",
    "pinposture study headings --pairs 20 --json",
    "pinposture study headings --jobs -1 -o out/headings",
)

PICTURE = "headings.png"


def run(
    *,
    arms: ArmsOption = None,
    controllers: ControllersOption = None,
    target: Annotated[
        str,
        typer.Option(
            metavar="KIND",
            help="What is known of the target: its configuration, or the curve through its points.",
            rich_help_panel=MOTION,
        ),
    ] = "configuration",
    pairs: Annotated[
        int, typer.Option(metavar="N", help="Number of pairs for each arm.", rich_help_panel=MOTION)
    ] = 300,
    seed0: SeedOption = 0,
    jobs: JobsOption = 1,
    output: OutputOption = None,
    as_json: JsonOption = False,
) -> None:
    """Drive arms between random smooth postures, and count who gets there by how far the arm must turn.

    The change of heading of a link adds up from the base along the arm, full turns included; that of a module
    of a spatial arm likewise, from the rotations between the changes of neighbours. The bins are those of its
    largest value along the arm: past pi, what knows the control points alone turns the short way round, and
    kinks. Counted are the runs that end with a mean point error below 1e-3 of the arm length and never left
    the limits, of all; behind them is the median length of the paths of the control points relative to the
    straight ways, of those that moved and came near. At most 0.1 rad per step and joint, and 400 steps.
    """
    from pinposture.study import by_heading, keep_study, study_headings
    from pinposture.study.headings import BINS
    from pinposture.study.pictures import draw_headings
    from pinposture.study.postures import CONTROLLERS

    check_output(output)
    subjects = built_subjects(arms)
    names = CONTROLLERS if controllers is None else split_names("--controllers", controllers)
    with count_progress("pair") as progress:
        records = study_headings(subjects, names, pairs, seed0, target, jobs, progress)
    bins = by_heading(records)
    asked = {
        "study": "headings",
        "target": target,
        "pairs": pairs,
        "seed0": seed0,
        "controllers": list(names),
    }
    found = {**asked, "bins": [described(each) for each in bins]}
    if as_json:
        print_json(found)
    else:
        for subject in subjects:
            own = [each for each in bins if each.arm == subject.name]
            lines = [
                (name, *(_cell(each) for each in own if each.controller == name))
                for name in dict.fromkeys(each.controller for each in own)
            ]
            print_table((subject.name, *(f"{name} rad" for name in BINS)), lines)
    report_refusals(records)
    if output is not None:
        for file in keep_study(output, records, found, {PICTURE: draw_headings(records)}):
            print_note(f"wrote {file}")


def _cell(each: Bin) -> str:
    counted = f"{each.reached}/{each.runs}"
    return counted if each.path is None else f"{counted}, path {each.path.median:.2f}"
