"""`pinposture study leader`: how far an arm is from the path of its tip."""

from __future__ import annotations

from typing import TYPE_CHECKING, Annotated

import typer

from pinposture.cli.inputs import ARM, MOTION, JobsOption, JsonOption, read_numbers
from pinposture.cli.output import print_json, print_note, print_table, print_warning
from pinposture.cli.progress import count_progress
from pinposture.cli.studies import OutputOption, check_output, split_names

if TYPE_CHECKING:
    from pinposture.study.leader import Following

EXAMPLES = (
    "pinposture study leader --arms ryrz --bendings 0.1,0.2,0.5",
    "pinposture study leader --json",
    "pinposture study leader --jobs -1 -o out/leader",
)

PICTURE = "leader.png"


def run(
    *,
    arms: Annotated[
        str | None,
        typer.Option(metavar="NAME,...", help="Arms: ryrz,universal,hinge.", rich_help_panel=ARM),
    ] = None,
    bendings: Annotated[
        str | None,
        typer.Option(
            metavar="RAD,...", help="Curvature times module length of the paths.", rich_help_panel=MOTION
        ),
    ] = None,
    jobs: JobsOption = 1,
    output: OutputOption = None,
    as_json: JsonOption = False,
) -> None:
    """Push arms on a feed along paths of constant curvature, and say how far off the path they are.

    The arms are 1 m long, of 20 modules: two crossed hinges half a module apart (ryrz), two in one place
    (universal), or one alone (hinge, which stays in its plane). The paths are arcs of up to three quarters
    of a turn, and helices whose torsion is half their curvature; they begin to bend at the entry. Modules
    are placed closest to the path, the whole arm by least squares, or in sequential order as in Algorithm 1.
    Numbers are percent of the arm length: the farthest that any part of the arm is from the path in any
    posture, and behind it the farthest control point. The sagitta is how far the middle of a straight module
    is from an arc if both its ends are on it.
    """
    from pinposture.study.leader import ARMS, BENDINGS, Following, study_leader
    from pinposture.study.leader_picture import draw_leader
    from pinposture.study.record_files import keep_study

    check_output(output)
    names = list(ARMS) if arms is None else split_names("--arms", arms)
    bent = list(BENDINGS) if bendings is None else read_numbers("--bendings", bendings)
    with count_progress("path") as progress:
        found = study_leader(names, bent, jobs=jobs, progress=progress)
    summary = {"study": "leader", "arms": names, "bendings": bent, "runs": [each._asdict() for each in found]}
    if as_json:
        print_json(summary)
    else:
        lines = dict.fromkeys((each.arm, each.shape, each.method) for each in found)
        rows = [
            (*line, *(_cell(each) for each in found if (each.arm, each.shape, each.method) == line))
            for line in lines
        ]
        sagitta = {each.bending: f"{each.sagitta:.3f}" for each in found}
        rows.append(("", "", "sagitta", *sagitta.values()))
        print_table(("arm", "path", "placed", *(f"{bending:g} rad" for bending in bent)), rows)
    for each in found:
        if each.refused:
            print_warning(f"{each.arm}, {each.shape}, {each.method}, {each.bending:g} rad: {each.refused}")
    if output is not None:
        for file in keep_study(output, found, summary, {PICTURE: draw_leader(found)}, Following._fields):
            print_note(f"wrote {file}")


def _cell(each: Following) -> str:
    return "-" if each.body is None else f"{each.body:.3f}, points {each.points:.3f}"
