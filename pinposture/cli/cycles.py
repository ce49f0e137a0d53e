"""`pinposture study cycles`: closed cycles of postures, gone round again and again."""

from __future__ import annotations

from typing import TYPE_CHECKING, Annotated

import typer

from pinposture.cli.controllers import ControllerOption
from pinposture.cli.inputs import MOTION, JobsOption, JsonOption
from pinposture.cli.output import print_json, print_table
from pinposture.cli.progress import count_progress
from pinposture.cli.studies import ArmsOption, SeedOption, built_subjects

if TYPE_CHECKING:
    from pinposture.study.cycles import PostureCycle

EXAMPLES = (
    "pinposture study cycles --arms ryrz20 --cycles 3",
    "pinposture study cycles --rounds 10 --jobs 2",
    "pinposture study cycles --cycles 2 --json",
)


def run(
    *,
    arms: ArmsOption = None,
    controller: ControllerOption = "qp",
    cycles: Annotated[
        int,
        typer.Option(
            metavar="N", help="Number of cycles for each arm and knowledge.", rich_help_panel=MOTION
        ),
    ] = 10,
    rounds: Annotated[
        int, typer.Option(metavar="N", help="Rounds of each cycle.", rich_help_panel=MOTION)
    ] = 5,
    seed0: SeedOption = 0,
    jobs: JobsOption = 1,
    as_json: JsonOption = False,
) -> None:
    """Go round closed cycles of four random smooth postures, and say how far the joints drift.

    The first round begins in the last posture. After each round, drift is how far the joint that is farthest
    from where it began has moved [rad]; the table has that of the worst cycle. Postures are known by
    their configurations, or by their control points alone. At most 0.1 rad per step and joint, and 400 steps
    from one posture to the next, until the mean point error is below 1e-9 of the arm length.
    """
    from pinposture.study.cycles import study_cycles

    subjects = built_subjects(arms)
    with count_progress("cycle") as progress:
        found = study_cycles(
            subjects,
            controller=controller,
            cycles=cycles,
            rounds=rounds,
            first_seed=seed0,
            jobs=jobs,
            progress=progress,
        )
    if as_json:
        asked = {"study": "cycles", "controller": controller, "cycles": cycles, "rounds": rounds}
        print_json({**asked, "seed0": seed0, "runs": [each._asdict() for each in found]})
        return
    headings = [f"round {number + 1}" for number in range(rounds)]
    kinds = dict.fromkeys((each.arm, each.target) for each in found)
    lines = [_line([each for each in found if (each.arm, each.target) == kind]) for kind in kinds]
    print_table(("arm", "known", "cycles", "postures taken", *headings), lines)


def _line(cycles: list[PostureCycle]) -> tuple[str | float | None, ...]:
    """The worst drift after each round."""
    from pinposture.study.cycles import CLOSE

    taken = sum(each.error <= CLOSE for each in cycles)
    worst = [max(drifts) for drifts in zip(*(each.drift for each in cycles), strict=True)]
    first = cycles[0]
    counted = f"all in {taken} of {len(cycles)}"
    return first.arm, first.target, len(cycles), counted, *(f"{drift:.2g}" for drift in worst)
