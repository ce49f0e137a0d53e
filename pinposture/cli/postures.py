"""`pinposture study postures`: many starts, targets and controllers."""

from __future__ import annotations

from typing import TYPE_CHECKING, Annotated

import typer

from pinposture.cli.inputs import (
    ARM,
    MOTION,
    OUTPUT,
    BaseOption,
    JobsOption,
    JsonOption,
    LockedOption,
    ModulesOption,
    PackageDirOption,
    TipOption,
    read_arm,
    refuse_given,
)
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
from pinposture.errors import InvalidValue

if TYPE_CHECKING:
    from pinposture.study import Spread, SummaryRow

EXAMPLES = (
    "pinposture study postures --cases 38 --arms ryrz20",
    "pinposture study postures --controllers switching,lm --families --jobs 2",
    "pinposture study postures --urdf arm.urdf --cases 20 --json",
    "pinposture study postures --jobs -1 -o out/postures",
)

PICTURE = "postures.png"

_HEADINGS = ("controller", "< 1e-6", "< 1e-3", "steps", "rising", "escaping", "peak", "path", "limits held")


def run(
    *,
    arms: ArmsOption = None,
    urdf: Annotated[
        str | None,
        typer.Option(metavar="FILE", help="URDF file of another arm instead, or -.", rich_help_panel=ARM),
    ] = None,
    base: BaseOption = None,
    tip: TipOption = None,
    modules: ModulesOption = None,
    locked: LockedOption = None,
    package_dir: PackageDirOption = None,
    controllers: ControllersOption = None,
    cases: Annotated[
        int, typer.Option(metavar="N", help="Number of cases for each arm.", rich_help_panel=MOTION)
    ] = 1000,
    seed0: SeedOption = 0,
    jobs: JobsOption = 1,
    families: Annotated[
        bool, typer.Option("--families", help="A row for each family.", rich_help_panel=OUTPUT)
    ] = False,
    output: OutputOption = None,
    as_json: JsonOption = False,
) -> None:
    """Drive arms from every kind of start to every kind of target, and say who gets there, and how.

    The arms are 20 RyRz modules, 1 m, and 45 joints in a plane with a control point at every second. Starts
    are smooth, harsh (each joint for itself within 0.6 or 1.5 rad), straight, or 1e-3 off it; targets are the
    helix and the line of the thesis, the straight arm folded back on itself, and random postures. Arms that
    are loaded go to a gentle curve and to random postures. At most 0.1 rad per step and joint, and 400 steps.

    The first two columns are the share of runs whose mean point error ends below 1e-6 and 1e-3 of the arm
    length. The others tell of the runs that moved and came below 1e-3: median (90th percentile) of the number
    of steps, of the share of steps on which the posture error rises, of those of them that were flagged as an
    escape, of the highest posture error relative to the first one, and of the length of the paths of the
    control points relative to the straight ways. A thousand cases with six controllers take some five minutes
    on two processes for each arm.
    """
    from pinposture.study import keep_study, loaded_subject, study_postures, summarise
    from pinposture.study.pictures import draw_postures
    from pinposture.study.postures import CONTROLLERS

    check_output(output)
    if urdf is None:
        told: dict[str, object] = {"--base": base, "--tip": tip, "--modules": modules, "--locked": locked}
        refuse_given({**told, "--package-dir": package_dir}, "only together with --urdf")
        subjects = built_subjects(arms)
    elif arms is not None:
        raise InvalidValue("--arms", arms, "nothing where --urdf names the arm")
    else:
        subjects = [loaded_subject(read_arm(urdf, base, tip, modules, locked, package_dir))]
    names = CONTROLLERS if controllers is None else split_names("--controllers", controllers)
    with count_progress("case") as progress:
        records = study_postures(subjects, names, cases, seed0, jobs, progress)
    rows = summarise(records, families)
    asked = {"study": "postures", "cases": cases, "seed0": seed0, "controllers": list(names)}
    found = {**asked, "rows": [described(row) for row in rows]}
    if as_json:
        print_json(found)
    else:
        for subject in subjects:
            own = [row for row in rows if row.arm == subject.name]
            print_table((subject.name, "runs", *_HEADINGS), _table(own))
    report_refusals(records)
    if output is not None:
        for file in keep_study(output, records, found, {PICTURE: draw_postures(records)}):
            print_note(f"wrote {file}")


def _table(rows: list[SummaryRow]) -> list[tuple[str | float | None, ...]]:
    """Lines of a table; a group is named in its first line."""
    lines: list[tuple[str | float | None, ...]] = []
    before = ""
    for row in rows:
        lines.append(
            (
                row.group if row.group != before else "",
                row.runs,
                row.controller,
                _percent(row.arrived),
                _percent(row.near),
                _spread(row.steps, ".0f"),
                _spread(row.rising, ".1%"),
                _spread(row.escaping, ".1%"),
                _spread(row.peak, ".2f"),
                _spread(row.path, ".2f"),
                "yes" if row.lawful else "no",
            )
        )
        before = row.group
    return lines


def _percent(share: float) -> str:
    """A share in percent, rounded down, so that 100 % stands for all."""
    return f"{int(1000.0 * share + 1e-9) / 10.0:g} %"


def _spread(spread: Spread | None, form: str) -> str | None:
    """Median (90th percentile)."""
    return None if spread is None else f"{spread.median:{form}} ({spread.high:{form}})"
