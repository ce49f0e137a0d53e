"""`pinposture track`: drive an arm to the shape of a curve."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from pinposture.cli.inputs import (
    MOTION,
    OUTPUT,
    AccelerationOption,
    BaseOption,
    ControllerOption,
    DegreesOption,
    DurationOption,
    HasteOption,
    JsonOption,
    LockedOption,
    ModulesOption,
    PackageDirOption,
    PositionMarginOption,
    StepLimitOption,
    TipOption,
    ToleranceOption,
    UrdfArgument,
    VelocityOption,
    build_controller,
    check_controller,
    read_arm,
    read_limits,
    read_start,
)
from pinposture.cli.output import end_with, examples, print_facts, print_json, print_note, step_progress
from pinposture.cli.results import FILES, in_words, keep, summarize
from pinposture.cli.targets import (
    CurveOption,
    HoldTipOption,
    MethodOption,
    PartialOption,
    PlacementOption,
    RegionOption,
    RollOption,
    SceneOption,
    SelfCollisionOption,
    StrictTipOption,
    TipPoseOption,
    TipPositionOption,
    TipWeightOption,
    read_scene,
    read_target,
    read_tip,
    tip_off,
)
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
    base: BaseOption = None,
    tip: TipOption = None,
    modules: ModulesOption = None,
    locked: LockedOption = None,
    package_dir: PackageDirOption = None,
    curve: CurveOption,
    placement: PlacementOption = None,
    roll: RollOption = 0.0,
    method: MethodOption = "auto",
    partial: PartialOption = False,
    region: RegionOption = None,
    controller: ControllerOption = "geodesic",
    joint_weight: HasteOption = None,
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
    step_limit: StepLimitOption = 0.1,
    velocity: VelocityOption = None,
    acceleration: AccelerationOption = None,
    dt: DurationOption = None,
    position_margin: PositionMarginOption = 0.0,
    scene: SceneOption = None,
    self_collision: SelfCollisionOption = False,
    tip_position: TipPositionOption = None,
    tip_pose: TipPoseOption = None,
    hold_tip: HoldTipOption = None,
    tip_weight: TipWeightOption = None,
    strict_tip: StrictTipOption = False,
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

    of_tip = {"--tip-position": tip_position, "--tip-pose": tip_pose, "--hold-tip": hold_tip}
    check_controller(
        controller,
        {"--joint-weight": joint_weight, **of_tip, "--tip-weight": tip_weight, "--strict-tip": strict_tip},
    )
    limits = read_limits(step_limit, velocity, acceleration, dt, position_margin)
    surroundings = read_scene(scene, self_collision)
    arm = read_arm(urdf, base, tip, modules, locked, package_dir)
    q0 = read_start(arm, start, seed, degrees)
    task = read_tip(arm.at(q0), tip_position, tip_pose, hold_tip, tip_weight, strict_tip)
    chosen = build_controller(controller, joint_weight, task)
    target = read_target(arm, curve, placement, roll, method, partial, region, surroundings)
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
    if as_json:
        asked = {"urdf": urdf, "curve": curve, "controller": controller, "start": start, "seed": seed}
        file = None if scene is None else str(scene)
        print_json({**asked, "scene": file, **summary, "files": files})
    else:
        print_facts(in_words(summary))
    for file in files.values():
        print_note(f"wrote {file}")
    if view:
        show(motion, True, print_note)
    end_with(motion.faults)
