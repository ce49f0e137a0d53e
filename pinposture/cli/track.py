"""`pinposture track`: drive an arm to the shape of a curve."""

from __future__ import annotations

from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

from pinposture.cli.inputs import (
    OUTPUT,
    TIP,
    ArmOptions,
    CurveOption,
    JsonOption,
    StartOptions,
    TrackOptions,
    UrdfArgument,
    ViewOption,
    as_data,
    read_option,
)
from pinposture.cli.output import (
    check_directory,
    end_with,
    examples,
    print_note,
    print_result,
    run_files,
    step_progress,
    words_of,
    write_files,
)
from pinposture.cli.view import show
from pinposture.errors import InvalidValue

if TYPE_CHECKING:
    from pinposture.arm import ArmState
    from pinposture.control import EndEffector
    from pinposture.motion import Run


@examples(
    "pinposture track arm.urdf --curve helix -o out",
    "pinposture track arm.urdf --curve helix --seed 3 --steps 500 -o out",
    "pinposture track arm.urdf --curve line --no-self-collision --json",
    "pinposture track arm.urdf --curve line --method smooth --split 4",
    "pinposture track arm.urdf --curve helix --region 10-20",
    "pinposture track arm.urdf --curve helix --dt 0.05 --acceleration 10",
    "pinposture track arm.urdf --curve line --split 4 --self-collision",
    "pinposture track arm.urdf --curve line --seed 1 --scene scene.toml",
    "pinposture track arm.urdf --curve line --tip-position 0.8,0.2,0",
    "pinposture track arm.urdf --curve line --start straight --hold-tip pose",
    "pinposture track arm.urdf --curve curve.csv --partial -o out --view",
)
def run(
    *,
    urdf: UrdfArgument,
    arm_options: ArmOptions,
    curve: CurveOption,
    start_options: StartOptions,
    track_options: TrackOptions,
    tip_options: TipOptions,
    output_options: TrackOutput,
) -> None:
    """Drive an arm to the shape of a curve, and report the result.

    Each control point is assigned a place on the curve, and the controller moves the arm there step by step;
    the summary names the placement method and the largest distance of a target from the curve.

    All controllers keep the limits. Only geodesic avoids obstacles and self-collision, and can bring or hold
    the tip somewhere; with others, distances are only recorded. A scene file has a line for each obstacle, in
    TOML: obstacles.post = {type = "cylinder", start = [0.3, 0.1, -1], end = [0.3, 0.1, 1], radius = 0.02}.
    The types are {types of obstacles}. A normal points to the free side; a rotation is roll, pitch, yaw in
    rad, or a 3x3 matrix. The file may also set margin (the
    clearance to keep; default 0.005), self_collision (true or false) and arm_radius (of capsules that replace
    the geometry of the arm). Lengths are in metres, in the world frame.

    With -o the run is saved in a directory: run.npz contains everything, run.png is a plot, run.html is an
    animation for any browser. The exit code is 0 if the arm converged within its limits without penetration,
    1 if not, 2 if it could not start or be saved.
    """
    from pinposture.motion import track
    from pinposture.motion.track import name_enough_steps, usual_max_steps
    from pinposture.schema import Length

    controller_options = track_options.controller_options
    controller_options.check(**vars(tip_options))
    change_options = track_options.change_options
    change_options.check("arm", "limits", "scene")
    arm = change_options.apply("arm", arm_options.read(urdf))
    limits = change_options.apply("limits", track_options.limit_options.read(arm), arm)
    surroundings = change_options.apply("scene", track_options.scene_options.read(arm))
    begin = start_options.read(arm, surroundings)
    task = tip_options.read(arm.at(begin.q))
    chosen = controller_options.build(task)
    target = track_options.placement_options.place(arm, curve, surroundings)
    output = output_options.output
    check_directory(output)  # before the run, which would be lost otherwise
    steps = track_options.steps
    most = usual_max_steps(arm, begin.q, target, limits) if steps is None else steps
    near = read_option("--tolerance", track_options.tolerance, Length)
    move = partial(track, arm, target, begin.q, chosen, limits, surroundings, tolerance=near)
    with step_progress(target, most) as callback:
        motion = move(max_steps=most, callback=callback)
    motion = name_enough_steps(motion, chosen, lambda steps: move(max_steps=steps))
    files, failure = write_files([] if output is None else run_files(motion, output))
    summary = {**motion.summary(), "tip": None if task is None else tip_off(task, motion)}
    asked: dict[str, object] = {"urdf": urdf, "curve": curve}
    asked |= {"start": start_options.start, "seed": start_options.seed}
    asked |= {"controller": controller_options.controller, "scene": track_options.scene_options.scene}
    taken = {"start_taken": begin.words, "start_positions": arm.positions(begin.q).tolist()}
    told = {**asked, **taken, **summary, "files": files}
    print_result(output_options.as_json, told, words_of(told), files.values(), failure)
    if output_options.view:
        show(motion, True, print_note)
    end_with(motion.faults)


@dataclass(frozen=True)
class TrackOutput:
    """What is done with the run."""

    output: Annotated[
        Path | None,
        OUTPUT("Save run.npz, run.png and run.html here; else nothing is saved.", "DIR", flags="--output -o"),
    ] = None
    as_json: JsonOption = False
    view: ViewOption = False


@dataclass(frozen=True)
class TipOptions:
    """The tip task, in addition to the shape."""

    tip_position: Annotated[
        str | None, TIP("Bring the tip here, in metres, as the arm takes its shape.", "X,Y,Z")
    ] = None
    tip_pose: Annotated[
        str | None,
        TIP(
            "Goal pose of the tip: its position, and its rotation in the world: roll about x, then pitch "
            "about y, then yaw about z, in rad.",
            "X,Y,Z,ROLL,PITCH,YAW",
        ),
    ] = None
    hold_tip: Annotated[str | None, TIP("Keep the position or pose of the tip at the start.", "WHAT")] = None
    tip_weight: Annotated[
        float | None, TIP("Weight of the tip task; a control point on the curve has weight 1. Default: 1.")
    ] = None
    tip_priority: Annotated[bool, TIP("Give the tip priority over the shape.", flags="--tip-priority")] = (
        False
    )

    def read(self, start: ArmState) -> EndEffector | None:
        """Return the tip task of these options, or None.

        Args:
            start: the start of the arm.

        Raises:
            InvalidValue: more than one tip goal, a weight or priority without a goal, or invalid numbers.
            UnknownName: `hold_tip` is neither position nor pose.
            OutOfReach: a goal farther from the base than the arm is long.
        """
        from pinposture.control import EndEffector
        from pinposture.control.reach import require_within_reach
        from pinposture.schema import read_plain

        goals = {
            "--tip-position": self.tip_position,
            "--tip-pose": self.tip_pose,
            "--hold-tip": self.hold_tip,
        }
        texts = {option: text for option, text in goals.items() if text is not None}
        if len(texts) > 1:
            first, second, *_ = texts
            raise InvalidValue(second, texts[second], f"without {first}")
        options: dict[str, Any] = {"weight": 1.0 if self.tip_weight is None else self.tip_weight}
        options["priority"] = self.tip_priority
        task: EndEffector | None = None
        if self.tip_position is not None:
            goal = {"position": as_data(self.tip_position), **options}
            task = read_plain(EndEffector, goal, folder=".", arm=start.arm)
        if self.tip_pose is not None:
            values = as_data(self.tip_pose)
            if not isinstance(values, list) or len(values) != 6:
                raise InvalidValue("--tip-pose", self.tip_pose, "X,Y,Z,ROLL,PITCH,YAW")
            goal = {"position": values[:3], "rotation": values[3:], **options}
            task = read_plain(EndEffector, goal, folder=".", arm=start.arm)
        if task is not None:
            require_within_reach(start.arm, task)
            return task
        if self.hold_tip is not None:
            return EndEffector.held(start, self.hold_tip, **options)
        for option, value in (
            ("--tip-weight", self.tip_weight),
            ("--tip-priority", self.tip_priority or None),
        ):
            if value is not None:
                raise InvalidValue(option, value, f"together with one of {', '.join(goals)}")
        return None


def tip_off(task: EndEffector, motion: Run) -> dict[str, float | None]:
    """Return the error of the tip task at the end of a run.

    Returns:
        "distance" [m], for a planar arm within its plane; and "turn" [rad], about axes about which the tip
        can rotate, or None without a goal pose.
    """
    import numpy as np

    arm = motion.arm
    off = task.rows(arm.at(motion.q[-1]), motion.target).error
    turn = (
        None if task.pose is None else float(np.linalg.norm(off[arm.dimension :])) / arm.characteristic_length
    )
    return {"distance": float(np.linalg.norm(off[: arm.dimension])), "turn": turn}
