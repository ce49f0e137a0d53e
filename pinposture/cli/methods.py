"""`pinposture study methods`: the methods side by side, as in Table 1.1 of the thesis, but measured."""

from __future__ import annotations

from typing import TYPE_CHECKING, Annotated, Any

import typer

from pinposture.cli.inputs import (
    ARM,
    MOTION,
    BaseOption,
    JobsOption,
    JsonOption,
    LockedOption,
    ModulesOption,
    PackageDirOption,
    TipOption,
    read_arm,
)
from pinposture.cli.output import print_json, print_note, print_table
from pinposture.errors import InvalidValue

if TYPE_CHECKING:
    from pinposture.study import MethodResult

EXAMPLES = (
    "pinposture study methods --seeds 5",
    "pinposture study methods arm.urdf --controllers switching,lm,dls --jobs 2",
    "pinposture study methods --seeds 5 --json",
)


def run(
    *,
    urdf: Annotated[
        str | None,
        typer.Argument(metavar="[URDF]", help="URDF file of an arm, or -; else 20 RyRz modules, 1 m."),
    ] = None,
    base: BaseOption = None,
    tip: TipOption = None,
    modules: ModulesOption = None,
    locked: LockedOption = None,
    package_dir: PackageDirOption = None,
    controllers: Annotated[
        str | None,
        typer.Option(metavar="NAME,...", help="Methods to compare; else all there are.", rich_help_panel=ARM),
    ] = None,
    seeds: Annotated[
        int, typer.Option(metavar="N", help="Number of cases for each method.", rich_help_panel=MOTION)
    ] = 20,
    steps: Annotated[int, typer.Option(metavar="N", help="Steps of each way.", rich_help_panel=MOTION)] = 200,
    jobs: JobsOption = 1,
    as_json: JsonOption = False,
) -> None:
    """Compare every method on the same arm: what it reaches, what it asks for, whether it comes back.

    From smooth random starts to smooth random targets and back, median over the cases. Errors are relative
    to the length of the arm; reached is the share of cases whose mean point error ends below 1e-3 of it.
    Returned is how far some joint is from its start once the arm is back. The peaks are the largest motion of
    a joint that a step without limits asks for, for an error of one arm length, at a distance of 0.1 to 1e-5
    rad from the straight arm: what grows without bound is not stable near singular postures.
    """
    from pinposture.control import CONTROLLERS
    from pinposture.study import compare_methods
    from pinposture.study.methods import DISTANCES
    from pinposture.thesis.arms import SPATIAL

    for option, value in (("--seeds", seeds), ("--steps", steps)):
        if value < 1:
            raise InvalidValue(option, value, "a whole number of at least 1")
    names = list(CONTROLLERS) if controllers is None else [name.strip() for name in controllers.split(",")]
    if urdf is None:
        from pinposture.arm import Arm

        arm = Arm.from_modules(SPATIAL, name="ryrz20")
    else:
        arm = read_arm(urdf, base, tip, modules, locked, package_dir)
    results = compare_methods(
        arm, names, range(seeds), steps, jobs, lambda result: print_note(f"{result.controller}: done")
    )
    if as_json:
        asked = {"arm": arm.model.name, "seeds": seeds, "steps": steps, "distances": list(DISTANCES)}
        print_json({**asked, "methods": [result._asdict() for result in results]})
        return
    peaks = [f"peak at {distance:g}" for distance in DISTANCES[::2]]
    headings = ("method", "posture error", "tip error", "reached", "returned [rad]", *peaks)
    print_table(headings, [_row(result) for result in results])


def _row(result: MethodResult) -> tuple[Any, ...]:
    return (
        result.controller,
        f"{result.posture_error:.2g}",
        f"{result.end_effector_error:.2g}",
        f"{100 * result.reached:.0f} %",
        f"{result.returned:.2g}",
        *(f"{peak:.2g}" for peak in result.peaks[::2]),
    )
