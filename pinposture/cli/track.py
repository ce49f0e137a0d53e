"""`pinposture track`: drive an arm to the shape of a curve."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from pinposture.cli.inputs import (
    MOTION,
    OUTPUT,
    ArmOptions,
    ControllerOptions,
    DegreesOption,
    JsonOption,
    LimitOptions,
    ToleranceOption,
    UrdfArgument,
    ViewOption,
    read_start,
)
from pinposture.cli.output import end_with, examples, print_note, print_result, step_progress
from pinposture.cli.results import FILES, in_words, keep, summarize
from pinposture.cli.targets import CurveOption, PlacementOptions, SceneOptions, TipOptions, tip_off
from pinposture.cli.view import show


@examples(
    "pinposture track arm.urdf --curve helix -o out",
    "pinposture track arm.urdf --curve helix --seed 3 --steps 500 -o out",
    "pinposture track arm.urdf --curve line --controller switching --json",
    "pinposture track arm.urdf --curve line --method smooth --modules 4",
    "pinposture track arm.urdf --curve helix --region 10-20",
    "pinposture track arm.urdf --curve helix --dt 0.05 --acceleration 10",
    "pinposture track arm.urdf --curve line --modules 4 --self-collision",
    "pinposture track arm.urdf --curve line --seed 1 --scene scene.toml",
    "pinposture track arm.urdf --curve line --tip-position 0.8,0.2,0",
    "pinposture track arm.urdf --curve line --region 1-9 --hold-tip pose",
    "pinposture track arm.urdf --curve curve.csv --partial -o out --view",
)
def run(
    *,
    urdf: UrdfArgument,
    arm_options: ArmOptions,
    curve: CurveOption,
    placement_options: PlacementOptions,
    controller_options: ControllerOptions,
    start: Annotated[
        str,
        typer.Option(
            metavar="START",
            help="straight, smooth or random, a .npy, .csv or .json file of joint positions, or 0.1,0.2,...",
            rich_help_panel=MOTION,
        ),
    ] = "smooth",
    degrees: DegreesOption = False,
    seed: Annotated[
        int, typer.Option(help="What a smooth or random start is drawn from.", rich_help_panel=MOTION)
    ] = 0,
    steps: Annotated[
        int, typer.Option(help="Number of steps after which to stop.", rich_help_panel=MOTION)
    ] = 300,
    tolerance: ToleranceOption = None,
    limit_options: LimitOptions,
    scene_options: SceneOptions,
    tip_options: TipOptions,
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
    view: ViewOption = False,
) -> None:
    """Drive an arm to the shape of a curve, and say how it went.

    Each control point gets its place on the curve, and the controller moves the arm there step by step; the
    summary tells which method placed them and how far off the curve the farthest of them belongs.

    Limits hold for every controller. Only geodesic keeps clear of obstacles and of the arm itself, and can
    bring or hold the tip somewhere; with others distances are only recorded. A scene file has a line for each
    obstacle, in TOML: obstacles.post = {type = "cylinder", start = [0.3, 0.1, -1], end = [0.3, 0.1, 1],
    radius = 0.02}. There are also sphere (center, radius), capsule (as cylinder), box (center, size,
    rotation), half_space (point; normal, towards the free side), mesh (path, scale, center, rotation) and
    scan (as mesh; of points or a surface). A rotation is roll, pitch, yaw in rad, or a 3x3 matrix. It may set
    margin (the distance to keep, else 0.005), self_collision (true or false) and arm_radius (of capsules in
    place of the arm's own geometry) as well. Lengths in metres, in the world.

    With -o the run is kept in a directory: run.npz holds everything, run.png plots it, run.html plays it in
    any browser. The exit code is 0 if the arm got there within its limits and was clear of everything, 1 if
    not, 2 if it could not start.
    """
    from pinposture.motion import track
    from pinposture.storage import check_writable

    controller_options.check(**vars(tip_options))
    limits = limit_options.read()
    surroundings = scene_options.read()
    arm = arm_options.read(urdf)
    q0 = read_start(arm, start, seed, degrees)
    task = tip_options.read(arm.at(q0))
    chosen = controller_options.build(task)
    target = placement_options.place(arm, curve, surroundings)
    if output is not None:
        check_writable(output)  # now, so that nobody waits for a run that cannot be kept
    with step_progress(target, steps) as callback:
        motion = track(
            arm,
            target,
            q0,
            chosen,
            limits=limits,
            scene=surroundings,
            max_steps=steps,
            tolerance=tolerance,
            callback=callback,
        )
    if output is not None:
        keep(motion, output)
    files = {} if output is None else {kind: str(output / name) for kind, name in FILES.items()}
    summary = {**summarize(motion), "tip": None if task is None else tip_off(task, motion)}
    asked: dict[str, object] = {"urdf": urdf, "curve": curve, "start": start, "seed": seed}
    asked |= {"controller": controller_options.controller, "scene": scene_options.file}
    print_result(as_json, {**asked, **summary, "files": files}, in_words(summary), files.values())
    if view:
        show(motion, True, print_note)
    end_with(motion.faults)
