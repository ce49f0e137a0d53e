"""What is said about a run or a motion, and the files that are kept of it."""

from __future__ import annotations

import io
import textwrap
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from pinposture.cli.output import closest_in_words, print_warning
from pinposture.errors import FileError

if TYPE_CHECKING:
    from matplotlib.figure import Figure

    from pinposture.motion import Motion, Trajectory


# What is said about a motion in time.

FULL = 1.0 - 1e-6
"""Share of a limit from which on it is reached."""


def summarize_motion(motion: Motion) -> dict[str, Any]:
    """A motion in numbers that JSON can hold; lengths in metres, times in seconds.

    Errors are those along the plan, from setting out to the end. A posture error is the sum of the distances
    of the control points from their targets, a mean error their mean.
    """
    from pinposture.motion.trajectory import closest, limit_shares

    run, begun = motion.run, motion.start_index
    errors, means = run.posture_error[begun:], motion.mean_error[begun:]
    speeds, accelerations = limit_shares(motion.run)
    worst = begun + int(errors.argmax())
    return {
        "verdict": motion.verdict,
        "status": run.status,
        "converged": run.converged,
        "reason": run.reason,
        "faults": list(motion.faults),
        "steps": run.steps,
        "dt": motion.dt,
        "time": float(motion.time[-1]),
        "start_index": float(motion.time[begun]),
        "planned": motion.planned,
        "duration": motion.duration,
        "time_scale": motion.time_scale,
        "done": float(motion.plan_time[-1]),
        "largest_speed": None if speeds is None else float(speeds.max(initial=0.0)),
        "largest_acceleration": None if accelerations is None else float(accelerations.max(initial=0.0)),
        "keyframes": [
            {
                **{name: value for name, value in place._asdict().items() if name not in ("row", "moved")},
                "moved": None if place.moved is None else place.moved._asdict(),
            }
            for place in motion.waypoints
        ],
        "worst_posture_error": float(errors.max()),
        "worst_at": float(motion.time[worst]),
        "mean_posture_error": float(errors.mean()),
        "worst_mean_error": float(means.max()),
        "mean_error": float(means.mean()),
        "final_error": float(errors[-1]),
        "arm_length": motion.arm.length,
        "control_points": motion.arm.n_modules,
        "clearance": closest(run),
        "deviations": list(motion.deviations),
    }


def motion_in_words(summary: Mapping[str, Any]) -> dict[str, str | tuple[str, str]]:
    """A summary as a person reads it; the verdict with the colour in which to print it."""
    words: dict[str, str | tuple[str, str]] = {
        "verdict": verdict_in_colour(summary),
        "duration": _duration(summary),
    }
    for name, kind in (("speed", "largest_speed"), ("acceleration", "largest_acceleration")):
        if summary[kind] is not None:
            reached = ", which is reached" if FULL <= summary[kind] <= 2.0 - FULL else ""
            words[name] = f"at most {100.0 * summary[kind]:.4g} % of the limit{reached}"
    if summary["keyframes"]:
        words["keyframes"] = _keyframes(summary["keyframes"])
    words["posture error"] = (
        f"at most {summary['worst_posture_error']:.4g} m along the way, at {summary['worst_at']:.4g} s; "
        f"{summary['mean_posture_error']:.4g} m on average, {summary['final_error']:.4g} m at the end"
    )
    words["mean error"] = (
        f"at most {summary['worst_mean_error']:.4g} m for each point, "
        f"{summary['worst_mean_error'] / summary['arm_length']:.2g} of the arm length; "
        f"{summary['mean_error']:.4g} m on average"
    )
    if summary["clearance"] is not None:
        words["clearance"] = closest_in_words(summary["clearance"], summary["dt"])
    if summary["deviations"]:
        words["not as planned"] = "\n".join(summary["deviations"])
    return words


def verdict_in_colour(summary: Mapping[str, Any]) -> tuple[str, str]:
    """What to think of a motion, with the colour in which to print it."""
    return str(summary["verdict"]), "yellow" if summary["faults"] else "green"


def _duration(summary: Mapping[str, Any]) -> str:
    """How long it took, and how long it should have taken."""
    planned, text = summary["planned"], f"{summary['duration']:.4g} s"
    if summary["done"] < planned:
        text += f", for {summary['done']:.4g} of the {planned:.4g} s of the plan"
    elif summary["time_scale"] > 1.0 + 1e-9:
        text += f", {summary['time_scale']:.4g} times as long as the {planned:.4g} s planned"
    else:
        text += ", as planned"
    if summary["start_index"]:
        text += f"; before that {summary['start_index']:.4g} s to come to the first posture"
    return text


def _keyframes(places: list[dict[str, Any]]) -> str:
    """Named places, one a line, in columns."""
    from pinposture.placement.curve_placement import Moved

    width = max(len(place["name"]) for place in places)
    lines = []
    for place in places:
        line = f"{place['name']:{width}}  planned {place['planned']:8.4g} s, "
        if place["reached"] is None:
            line += "not reached"
        else:
            line += f"passed {place['reached']:8.4g} s, mean error {place['mean_error']:.2g} m"
        if place["off_curve"] is not None:
            line += f", at most {place['off_curve']:.2g} m off its curve"
        if place["tip_off"] is not None:
            line += f", tip {place['tip_off']:.2g} m off"
        if place["moved"] is not None and Moved(**place["moved"]):
            line += f", curve {Moved(**place['moved'])}"
        lines.append(line)
    return "\n".join(lines)


# What is said about a run or a motion in time, and what is kept of it.

__all__ = [
    "ANIMATION",
    "BATCH",
    "FILES",
    "FORMATS",
    "MOTION",
    "PLOT",
    "RUN",
    "find_kept",
    "in_words",
    "keep",
    "keep_motion",
    "load_kept",
    "motion_in_words",
    "summarize",
    "summarize_motion",
    "write_animation",
    "write_picture",
    "write_plot",
]

RUN, PLOT, ANIMATION = "run.npz", "run.png", "run.html"
FILES = {"run": RUN, "plot": PLOT, "animation": ANIMATION}

BATCH = "batch.npz"
"""File of a directory that holds all runs of a batch."""

MOTION = "motion.npz"
FORMATS = ("npz", "csv", "json", "png", "html")
"""What a motion can be kept as: all of it, its joints as a table and for ROS, its plot, its animation."""

FOR_ROBOTS = ("csv", "json")
"""Those of them that are handed to a robot."""

WORDY = 200
"""Characters after which it is enough of what gave way in a step."""


def keep(motion: Trajectory, directory: Path) -> None:
    """Write a run, its plot and its animation into a directory.

    Raises:
        FileError: one of them cannot be written.
    """
    from pinposture.motion import save

    write_plot(motion, directory / PLOT)
    write_animation(motion, directory / ANIMATION)
    save(motion, directory / RUN)  # last: where it is, its pictures are


def keep_motion(motion: Motion, directory: Path, formats: Sequence[str] = FORMATS) -> dict[str, str]:
    """Write a motion in time into a directory, in some of `FORMATS`.

    What is for robots is left out if the motion has faults; it is said on stderr.

    Returns:
        The path of the file of each format, in the order in which they were written.

    Raises:
        FileError: one of them cannot be written.
    """
    from pinposture.motion import save

    held_back = [kind for kind in formats if motion.faults and kind in FOR_ROBOTS]
    if held_back:
        named = " and ".join(f"motion.{kind}" for kind in held_back)
        advice = f"pinposture export {directory} --force writes one all the same"
        print_warning(f"no {named} for a robot: {'; '.join(motion.faults)}; {advice}")
        formats = [kind for kind in formats if kind not in held_back]
    stem = directory / MOTION
    files = {kind: stem.with_suffix(f".{kind}") for kind in reversed(FORMATS) if kind in formats}
    for kind, path in files.items():  # that with everything last: where it is, the others are
        if kind == "html":
            write_animation(motion, path)
        elif kind == "png":
            write_plot(motion, path)
        elif kind == "npz":
            save(motion, path)
        else:
            save(motion.joint_trajectory(), path)
    return {kind: str(path) for kind, path in files.items()}


def find_kept(path: Path) -> tuple[Path, str]:
    """The file of a run or a motion: a file itself, or in a directory the newer one.

    Returns:
        The file, and if there were two which one was taken, in words.

    Raises:
        FileError: a directory that holds neither.
    """
    if not path.is_dir():
        return path, ""
    found = [path / name for name in (MOTION, RUN) if _is_kept(path / name)]
    if not found:
        for name in (RUN, BATCH):
            if (path / name).exists():
                return path / name, ""  # whoever reads it says what is wrong with it
        raise FileError(path / RUN, f"no such file, and no {MOTION} that holds a motion")
    newest, *others = sorted(found, key=lambda file: file.stat().st_mtime_ns, reverse=True)
    return newest, f"{newest.name}, which is newer than {others[0].name}" if others else ""


def _is_kept(path: Path) -> bool:
    """Whether a file holds a run, or a motion; joints that were exported under that name are neither."""
    from pinposture.motion import Motion, Trajectory
    from pinposture.motion.files import kind_of

    return kind_of(path) in (Trajectory, Motion)


def load_kept(path: Path) -> Trajectory | Motion:
    """Read a run or a motion.

    Raises:
        FileError: the file is missing, or holds neither.
    """
    from pinposture.motion import Motion, Trajectory, load
    from pinposture.motion.files import kind_of

    return load(path, Motion) if kind_of(path) is Motion else load(path, Trajectory)


def write_plot(motion: Trajectory | Motion, path: Path) -> None:
    """Write the plot of a run or a motion as PNG, whatever the name of the file."""
    from pinposture.viz import plot

    write_picture(plot(motion), path)


def write_picture(figure: Figure, path: Path) -> None:
    """Write a figure as PNG, whatever the name of the file.

    Raises:
        FileError: it cannot be written.
    """
    from pinposture.storage import write_bytes

    picture = io.BytesIO()
    figure.savefig(picture, format="png")
    write_bytes(path, picture.getvalue())


def write_animation(motion: Trajectory | Motion, path: Path, ellipsoids: Sequence[int] = ()) -> Path:
    """Write the animation of a run or a motion as one HTML file.

    Args:
        motion: the run, or the motion.
        path: the file.
        ellipsoids: indices of the control points to show the manipulability ellipsoids of, 0-based.

    Returns:
        The path written, which ends in .html.
    """
    from pinposture.viz import save_html

    return save_html(motion.arm, motion, path, ellipsoids=ellipsoids)


def summarize(motion: Trajectory) -> dict[str, Any]:
    """A run in numbers that JSON can hold; lengths in metres."""
    import numpy as np

    from pinposture.motion.trajectory import closest

    target, errors, points = motion.target, motion.posture_error, motion.active.sum(axis=1)
    off = None if target.residual is None else float(target.residual[target.has_target].max())
    return {
        "verdict": motion.verdict,
        "status": motion.status,
        "converged": motion.converged,
        "reason": motion.reason,
        "faults": list(motion.faults),
        "steps": motion.steps,
        "start_error": float(errors[0]),
        "final_error": float(errors[-1]),
        "lowest_error": float(errors.min()),
        "mean_error": float(errors[-1]) / int(target.has_target.sum()),
        "arm_length": motion.arm.length,
        "control_points": motion.arm.n_modules,
        "placed_points": int(target.has_target.sum()),
        "placed_by": target.method,
        "largest_residual": off,
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
        "clearance": closest(motion),
        "incomplete": target.incomplete,
        "moved": None if target.moved is None else target.moved._asdict(),
    }


def _whole_arm(summary: Mapping[str, Any]) -> dict[str, str]:
    """How far the whole arm is from the curve in the end, where there is one."""
    away = summary["distance_from_curve"]
    if away is None:
        return {}
    share = away / summary["arm_length"]
    return {"whole arm": f"its links at most {away:.2g} m from the curve, {share:.2g} of the arm length"}


def in_words(summary: Mapping[str, Any]) -> dict[str, str | tuple[str, str]]:
    """A summary as a person reads it; the verdict with the colour in which to print it."""
    first, last, mean = (summary[key] for key in ("start_error", "final_error", "mean_error"))
    from pinposture.placement.curve_placement import Moved

    off, length = summary["largest_residual"], summary["arm_length"]
    words: dict[str, str | tuple[str, str]] = {
        "verdict": verdict_in_colour(summary),
        "steps": str(summary["steps"]),
        "placed by": f"{summary['placed_by']} placement, control points at most {off:.2g} m off the curve, "
        f"{off / length:.2g} of the arm length",
        **_whole_arm(summary),
        "posture error": f"{first:.4g} m at the start, {last:.4g} m at the end",
        "mean error": f"{mean:.4g} m for each point, {mean / length:.2g} of the arm length",
        "active points": f"{summary['first_active_points']} at the first step, "
        f"{summary['last_active_points']} at the last, of {summary['control_points']}",
        "paths": f"of control points {summary['path_length_ratio']:.3g} times as long as straight ones",
    }
    if summary["moved"] is not None and Moved(**summary["moved"]):
        how = "; --placement as_is leaves it where it is drawn"
        words["curve"] = f"{Moved(**summary['moved'])} to the base of the arm{how}"
    if summary["escape_share"]:
        words["escapes"] = (
            f"{100 * summary['escape_share']:.3g} % of the steps; the posture error may rise there"
        )
    if summary["switches"]:
        first_switch = summary["switches"][0]
        words["switches"] = (
            f"{len(summary['switches'])}; the first in step {first_switch['step'] + 1} to "
            f"{first_switch['method']}: {first_switch['reason']}"
        )
    if summary["clearance"] is not None:
        words["clearance"] = closest_in_words(summary["clearance"])
    if summary["violated_constraints"]:
        first_relaxed = summary["violated_constraints"][0]
        what = textwrap.shorten("; ".join(first_relaxed["what"]), WORDY, placeholder=" ...")
        count, first = len(summary["violated_constraints"]), first_relaxed["step"] + 1
        words["gave way"] = f"something in {count} steps; first in step {first}: {what}"
    if summary.get("tip") is not None:
        distance, turn = summary["tip"]["distance"], summary["tip"]["turn"]
        words["tip"] = f"{distance:.4g} m off" + ("" if turn is None else f", turned by {turn:.4g} rad")
    if summary["incomplete"]:
        words["incomplete"] = str(summary["incomplete"])
    return words
