"""`pinposture track`: drive an arm to the shape of a curve."""

from __future__ import annotations

import textwrap
from collections.abc import Mapping
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

from pinposture.cli.inputs import (
    MOTION,
    OUTPUT,
    TIP,
    ArmOptions,
    ControllerOptions,
    CurveOption,
    DegreesOption,
    JsonOption,
    LimitOptions,
    PlacementOptions,
    SceneOptions,
    ToleranceOption,
    UrdfArgument,
    ViewOption,
    read_numbers,
    read_start,
)
from pinposture.cli.output import (
    check_directory,
    closest_in_words,
    end_with,
    examples,
    print_note,
    print_result,
    run_files,
    shares_in_words,
    step_progress,
    verdict_in_colour,
    write_files,
)
from pinposture.cli.view import show
from pinposture.errors import InvalidValue
from pinposture.units import error_text, length_text

if TYPE_CHECKING:
    from pinposture.arm import ArmState
    from pinposture.control import EndEffector
    from pinposture.motion import Run


@examples(
    "pinposture track arm.urdf --curve helix -o out",
    "pinposture track arm.urdf --curve helix --seed 3 --steps 500 -o out",
    "pinposture track arm.urdf --curve line --no-self-collision --json",
    "pinposture track arm.urdf --curve line --method smooth --modules 4",
    "pinposture track arm.urdf --curve helix --region 10-20",
    "pinposture track arm.urdf --curve helix --dt 0.05 --acceleration 10",
    "pinposture track arm.urdf --curve line --modules 4 --self-collision",
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
    placement_options: PlacementOptions,
    controller_options: ControllerOptions,
    start: Annotated[
        str,
        MOTION(
            "straight, smooth or random, a .npy, .csv or .json file of joint positions, or 0.1,0.2,...",
            "START",
        ),
    ] = "smooth",
    degrees: DegreesOption = False,
    seed: Annotated[int, MOTION("Seed of a smooth or random start.")] = 0,
    steps: Annotated[
        int | None,
        MOTION(
            "Number of steps after which it stops. Default: 300; with --dt, if that is more, ten times those "
            "of the straight path in joint space.",
            "N",
        ),
    ] = None,
    tolerance: ToleranceOption = None,
    limit_options: LimitOptions,
    scene_options: SceneOptions,
    tip_options: TipOptions,
    output: Annotated[
        Path | None,
        OUTPUT("Save run.npz, run.png and run.html here; else nothing is saved.", "DIR", flags="--output -o"),
    ] = None,
    as_json: JsonOption = False,
    view: ViewOption = False,
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

    controller_options.check(**vars(tip_options))
    limits = limit_options.read()
    arm = arm_options.read(urdf)
    surroundings = scene_options.read(arm)
    begin = read_start(arm, start, seed, degrees, surroundings)
    task = tip_options.read(arm.at(begin.q))
    chosen = controller_options.build(task)
    target = placement_options.place(arm, curve, surroundings)
    check_directory(output)  # before the run, which would be lost otherwise
    most = usual_max_steps(arm, begin.q, target, limits) if steps is None else steps
    move = partial(track, arm, target, begin.q, chosen, limits, surroundings, tolerance=tolerance)
    with step_progress(target, most) as callback:
        motion = move(max_steps=most, callback=callback)
    motion = name_enough_steps(motion, chosen, lambda steps: move(max_steps=steps))
    files, failure = write_files([] if output is None else run_files(motion, output))
    summary = {**summarize(motion), "tip": None if task is None else tip_off(task, motion)}
    asked: dict[str, object] = {"urdf": urdf, "curve": curve, "start": start, "seed": seed}
    asked |= {"controller": controller_options.controller, "scene": scene_options.file}
    taken = {"start_taken": begin.words, "start_positions": arm.positions(begin.q).tolist()}
    told = {**asked, **taken, **summary, "files": files}
    print_result(as_json, told, in_words(told), files.values(), failure)
    if view:
        show(motion, True, print_note)
    end_with(motion.faults)


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

        places = {
            "--tip-position": self.tip_position,
            "--tip-pose": self.tip_pose,
            "--hold-tip": self.hold_tip,
        }
        given = {option: text for option, text in places.items() if text is not None}
        if len(given) > 1:
            first, second, *_ = given
            raise InvalidValue(second, given[second], f"without {first}")
        options: dict[str, Any] = {"weight": 1.0 if self.tip_weight is None else self.tip_weight}
        options["priority"] = self.tip_priority
        task = None
        if self.tip_position is not None:
            task = EndEffector(_finite("--tip-position", self.tip_position, "X,Y,Z"), **options)
        if self.tip_pose is not None:
            pose = _placement(_finite("--tip-pose", self.tip_pose, "X,Y,Z,ROLL,PITCH,YAW"))
            task = EndEffector(pose=pose, **options)
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
                raise InvalidValue(option, value, f"together with one of {', '.join(places)}")
        return None


def _finite(option: str, text: str, names: str) -> list[float]:
    import numpy as np

    values = read_numbers(option, text)
    if len(values) != names.count(",") + 1 or not np.all(np.isfinite(values)):
        raise InvalidValue(option, text, f"finite numbers, {names}")
    return values


def _placement(values: list[float]) -> Any:
    import numpy as np
    import pinocchio as pin

    return pin.SE3(pin.rpy.rpyToMatrix(*values[3:]), np.array(values[:3]))


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


WORDY = 200
"""Maximum number of printed characters of a violated constraint."""


def summarize(motion: Run) -> dict[str, Any]:
    """Summarize a run as JSON-compatible data; lengths in metres.

    The start, final and lowest errors are sums over the control points.
    """
    import numpy as np

    from pinposture.motion.run import closest, ending, largest_shares

    target = motion.target
    errors = motion.posture_error
    points = motion.active.sum(axis=1)
    timed: dict[str, float | None] = {}
    if motion.limits.dt is not None:
        timed = {f"largest_{kind}": share for kind, share in largest_shares(motion).items()}
        timed["duration"] = motion.steps * motion.limits.dt
    placed = target.has_target
    off = None if target.residual is None else float(target.residual[placed].max())
    covered = None if target.parameters is None else float(target.parameters[placed].max())
    return {
        **ending(motion),
        "steps": motion.steps,
        "start_error": float(errors[0]),
        "final_error": float(errors[-1]),
        "lowest_error": float(errors.min()),
        "mean_start_error": float(motion.mean_error[0]),
        "mean_error": float(motion.mean_error[-1]),
        "largest_error": float(motion.point_errors[-1].max()),
        **timed,
        "arm_length": motion.arm.length,
        "control_points": motion.arm.n_modules,
        "placed_points": int(placed.sum()),
        "placed_by": target.method,
        "largest_residual": off,
        "curve_length": None if target.curve is None else target.curve.length,
        "covered_to": covered,
        "distance_from_curve": motion.distance_from_curve,
        "first_active_points": int(points[0]) if len(points) else 0,
        "last_active_points": int(points[-1]) if len(points) else 0,
        "switches": [switch._asdict() for switch in motion.switches],
        "path_length_ratio": motion.path_length_ratio,
        "escape_share": float(motion.error_increasing.mean()) if motion.steps else 0.0,
        "violated_constraints": [
            {"step": int(k), "what": str(motion.violated_constraints[k]).splitlines()}
            for k in np.flatnonzero(motion.violated_constraints != "")
        ],
        "violated_steps": {name: steps.tolist() for name, steps in motion.violated_steps.items()},
        "clearance": closest(motion),
        "start_clearance": None if motion.scene is None else float(motion.clearance[0]),
        "incomplete": target.incomplete,
        "moved": None if target.moved is None else target.moved._asdict(),
    }


def _whole_arm(summary: Mapping[str, Any]) -> dict[str, str]:
    """Return the final distance of the whole arm from the curve, if there is one."""
    away = summary["distance_from_curve"]
    if away is None:
        return {}
    error = error_text(away, summary["arm_length"])
    return {"whole arm": f"largest distance of a link from the curve {error}"}


def in_words(summary: Mapping[str, Any]) -> dict[str, Any]:
    """Return a summary in words; the verdict comes with the colour to print it in."""
    from pinposture.placement.target import Moved

    off = summary["largest_residual"]
    length = summary["arm_length"]
    mean = summary["mean_error"]
    verdict, colour = verdict_in_colour(summary)
    words: dict[str, Any] = {
        "verdict": (verdict.replace("raise max_steps", "raise --steps"), colour),
        "start": f"{summary['start_taken']}; the motion begins there",
        "steps": str(summary["steps"]) + (f", {summary['duration']:.4g} s" if "duration" in summary else ""),
        "placed by": f"{summary['placed_by']} placement; largest distance of a control point from the curve "
        f"{error_text(off, length)}",
        **_whole_arm(summary),
        "point errors": f"mean {length_text(summary['mean_start_error'], length)} at the start, "
        f"{error_text(mean, length)} at the end; largest {length_text(summary['largest_error'], length)}",
        **shares_in_words(summary),
        "active points": f"{summary['first_active_points']} at the first step, "
        f"{summary['last_active_points']} at the last, of {summary['control_points']}",
        "paths": f"of control points {summary['path_length_ratio']:.3g} times as long as straight ones",
    }
    curve = []
    if summary["curve_length"] is not None and summary["covered_to"] is not None:
        whole = length_text(summary["curve_length"])
        covered = length_text(summary["covered_to"])
        curve.append(f"{whole} long, covered by the arm up to {covered}")
    if summary["moved"] is not None and Moved(**summary["moved"]):
        how = "; --placement as_is keeps it in place"
        curve.append(f"{Moved(**summary['moved'])} to the base of the arm{how}")
    if curve:
        words["curve"] = "; ".join(curve)
    if summary["escape_share"]:
        words["rising"] = f"{100 * summary['escape_share']:.3g} % of the steps may raise the posture error"
    if summary["switches"]:
        first_switch = summary["switches"][0]
        words["switches"] = (
            f"{len(summary['switches'])}; the first in step {first_switch['step'] + 1} to "
            f"{first_switch['method']}: {first_switch['reason']}"
        )
    if summary["clearance"] is not None:
        words["clearance"] = closest_in_words(summary["clearance"])
        if summary["start_clearance"] < 0.0:
            words["start"] += "; in collision, choose another one by --start or --seed"
    if summary["violated_constraints"]:
        first_relaxed = summary["violated_constraints"][0]
        what = textwrap.shorten("; ".join(first_relaxed["what"]), WORDY, placeholder=" ...")
        counts = [f"{name} in {len(steps)}" for name, steps in summary["violated_steps"].items()]
        words["violated"] = f"{', '.join(counts)} steps; first in step {first_relaxed['step'] + 1}: {what}"
    if summary.get("tip") is not None:
        turn = summary["tip"]["turn"]
        turned = "" if turn is None else f", turned by {turn:.4g} rad"
        words["tip"] = f"{length_text(summary['tip']['distance'], length)} off{turned}"
    if summary["incomplete"]:
        words["incomplete"] = str(summary["incomplete"])
    return words
