"""`pinposture track`: drive an arm to the shape of a curve."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Literal, cast

import typer

from pinposture.cli.inputs import (
    MOTION,
    OUTPUT,
    TARGET,
    BaseOption,
    JsonOption,
    ModulesOption,
    TipOption,
    UrdfArgument,
    read_arm,
    read_curve,
    read_start,
)
from pinposture.cli.output import print_facts, print_json, print_note, step_progress
from pinposture.cli.points import read_region
from pinposture.cli.results import FILES, in_words, keep, summarize
from pinposture.cli.view import show
from pinposture.errors import InvalidValue

EXAMPLES = (
    "pinposture track arm.urdf --curve helix -o out",
    "pinposture track arm.urdf --curve helix --seed 3 --steps 500 -o out",
    "pinposture track arm.urdf --curve line --controller projection --json",
    "pinposture track arm.urdf --curve line --method smooth --modules 4",
    "pinposture track arm.urdf --curve helix --region 10-20",
    "pinposture track arm.urdf --curve curve.csv --partial -o out --view",
)


def run(
    *,
    urdf: UrdfArgument,
    base: BaseOption = None,
    tip: TipOption = None,
    modules: ModulesOption = None,
    curve: Annotated[
        str,
        typer.Option(
            metavar="CURVE",
            help="A .json, .csv or .txt file, or a preset: line, helix.",
            rich_help_panel=TARGET,
        ),
    ],
    placement: Annotated[
        str,
        typer.Option(
            metavar="NAME",
            help="How the curve is laid: as_is, translate (to the base) or align (turned to the arm too).",
            rich_help_panel=TARGET,
        ),
    ] = "align",
    roll: Annotated[
        float,
        typer.Option(
            help="Turn of an aligned curve about the axis of the arm, in rad.", rich_help_panel=TARGET
        ),
    ] = 0.0,
    method: Annotated[
        str,
        typer.Option(
            metavar="NAME",
            help="How modules are placed: sequential (one by one, exactly), smooth (all at once, bending "
            "little), closest (all at once), or auto.",
            rich_help_panel=TARGET,
        ),
    ] = "auto",
    partial: Annotated[
        bool,
        typer.Option(
            "--partial", help="Leave points free that have no place on the curve.", rich_help_panel=TARGET
        ),
    ] = False,
    region: Annotated[
        str | None,
        typer.Option(
            metavar="FIRST-LAST",
            help="Control points that are to take the shape, as in 10-20; the others are free.",
            rich_help_panel=TARGET,
        ),
    ] = None,
    controller: Annotated[
        str,
        typer.Option(
            metavar="NAME",
            help="What moves the arm: selection, projection, or the two by turns, switching; or, to compare "
            "them with, joint, pinv, task-constraints, extended, augmented, dls or lm.",
            rich_help_panel=MOTION,
        ),
    ] = "switching",
    start: Annotated[
        str,
        typer.Option(
            metavar="START",
            help="straight, smooth or random, a .npy, .csv or .json file of joint positions, or 0.1,0.2,...",
            rich_help_panel=MOTION,
        ),
    ] = "smooth",
    seed: Annotated[
        int, typer.Option(help="What a smooth or random start is drawn from.", rich_help_panel=MOTION)
    ] = 0,
    steps: Annotated[
        int, typer.Option(help="Number of steps after which to stop.", rich_help_panel=MOTION)
    ] = 300,
    step_limit: Annotated[
        float,
        typer.Option(help="Largest motion of a joint in one step, in rad or metres.", rich_help_panel=MOTION),
    ] = 0.1,
    tolerance: Annotated[
        float | None,
        typer.Option(
            help="Mean point error at which the arm is there, in metres; else 1e-6 of its length.",
            rich_help_panel=MOTION,
        ),
    ] = None,
    output: Annotated[
        Path | None,
        typer.Option(
            "--output",
            "-o",
            metavar="DIR",
            help="Leave run.npz, run.png and run.html here; else nothing is kept.",
            rich_help_panel=OUTPUT,
        ),
    ] = None,
    as_json: JsonOption = False,
    view: Annotated[
        bool, typer.Option("--view", help="Show the motion in the browser at last.", rich_help_panel=OUTPUT)
    ] = False,
    require_convergence: Annotated[
        bool,
        typer.Option(
            "--require-convergence",
            help="Exit with code 1 if the arm does not get there.",
            rich_help_panel=OUTPUT,
        ),
    ] = False,
) -> None:
    """Drive an arm to the shape of a curve, and say how it went.

    Each control point gets its place on the curve, and the controller moves the arm there step by step; the
    summary tells which method placed them and how far off the curve the farthest of them belongs. With -o the
    run is kept in a directory: run.npz holds everything, run.png plots it, run.html plays it in any browser.
    The exit code is 0 whether or not the arm got there, 2 if it could not start.
    """
    from pinposture.control import Limits, controller_named
    from pinposture.motion import track
    from pinposture.storage import check_writable
    from pinposture.target import resolve_targets

    chosen, limits = controller_named(controller), Limits(step=step_limit)
    arm = read_arm(urdf, base, tip, modules)
    target = resolve_targets(
        arm,
        read_curve(curve),
        placement=cast(Literal["as_is", "translate", "align"], placement),  # checked there
        roll=roll,
        incomplete="partial" if partial else "raise",
        method=cast(Literal["auto", "sequential", "smooth", "closest"], method),
    )
    if not target.placed.any():
        raise InvalidValue("--curve", curve, f"one with a place for the first module: {target.incomplete}")
    q0 = read_start(arm, start, seed)
    if target.incomplete:
        print_note(f"only the first {target.placed.sum()} of {arm.n_modules} control points have a place")
    if region is not None:
        target = target.region(*read_region("--region", region, arm))
    if output is not None:
        check_writable(output)  # now, so that nobody waits for a run that cannot be kept
    with step_progress(target, steps) as callback:
        motion = track(arm, target, q0, chosen, limits, steps, tolerance, callback)
    if output is not None:
        keep(motion, output)
    files = {} if output is None else {kind: str(output / name) for kind, name in FILES.items()}
    summary = summarize(motion)
    if as_json:
        asked = {"urdf": urdf, "curve": curve, "controller": controller, "start": start, "seed": seed}
        print_json({**asked, **summary, "files": files})
    else:
        print_facts(in_words(summary))
    for file in files.values():
        print_note(f"wrote {file}")
    if view:
        show(motion, True, print_note)
    if require_convergence and not motion.converged:
        raise typer.Exit(1)
