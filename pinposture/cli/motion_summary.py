"""What is said about a motion in time."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

from pinposture.cli.closest import closest_in_words

if TYPE_CHECKING:
    from pinposture.motion import Motion

FULL = 1.0 - 1e-6
"""Share of a limit from which on it is reached."""


def summarize_motion(motion: Motion) -> dict[str, Any]:
    """A motion in numbers that JSON can hold; lengths in metres, times in seconds.

    Errors are those along the plan, from setting out to the end. A posture error is the sum of the distances
    of the control points from their targets, a mean error their mean.
    """
    from pinposture.motion.trajectory import closest, limit_shares

    run, begun = motion.run, motion.set_out
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
        "set_out": float(motion.time[begun]),
        "planned": motion.planned,
        "duration": motion.duration,
        "slowing": motion.slowing,
        "done": float(motion.clock[-1]),
        "largest_speed": None if speeds is None else float(speeds.max(initial=0.0)),
        "largest_acceleration": None if accelerations is None else float(accelerations.max(initial=0.0)),
        "keyframes": [
            {
                **{name: value for name, value in place._asdict().items() if name not in ("row", "moved")},
                "moved": None if place.moved is None else place.moved._asdict(),
            }
            for place in motion.passed
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
        "detours": list(motion.detours),
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
    if summary["detours"]:
        words["not as planned"] = "\n".join(summary["detours"])
    return words


def verdict_in_colour(summary: Mapping[str, Any]) -> tuple[str, str]:
    """What to think of a motion, with the colour in which to print it."""
    return str(summary["verdict"]), "yellow" if summary["faults"] else "green"


def _duration(summary: Mapping[str, Any]) -> str:
    """How long it took, and how long it should have taken."""
    planned, text = summary["planned"], f"{summary['duration']:.4g} s"
    if summary["done"] < planned:
        text += f", for {summary['done']:.4g} of the {planned:.4g} s of the plan"
    elif summary["slowing"] > 1.0 + 1e-9:
        text += f", {summary['slowing']:.4g} times as long as the {planned:.4g} s planned"
    else:
        text += ", as planned"
    if summary["set_out"]:
        text += f"; before that {summary['set_out']:.4g} s to come to the first posture"
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
