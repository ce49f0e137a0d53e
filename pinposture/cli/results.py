"""What is said about a run, and what is kept of it."""

from __future__ import annotations

import io
import textwrap
from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from matplotlib.figure import Figure

    from pinposture.motion import Trajectory

RUN, PLOT, ANIMATION = "run.npz", "run.png", "run.html"
FILES = {"run": RUN, "plot": PLOT, "animation": ANIMATION}

WORDY = 200
"""Characters after which it is enough of what gave way in a step."""


def keep(motion: Trajectory, directory: Path) -> None:
    """Write a run, its plot and its animation into a directory.

    Raises:
        FileError: one of them cannot be written.
    """
    write_plot(motion, directory / PLOT)
    write_animation(motion, directory / ANIMATION)
    motion.save(directory / RUN)  # last: where it is, its pictures are


def write_plot(motion: Trajectory, path: Path) -> None:
    """Write the plot of a run as PNG, whatever the name of the file."""
    from pinposture.view import plot

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


def write_animation(motion: Trajectory, path: Path) -> Path:
    """Write the animation of a run as one HTML file; returns the path, which ends in .html."""
    from pinposture.view import save_html

    return save_html(motion.arm, motion, path)


def summarize(motion: Trajectory) -> dict[str, Any]:
    """A run in numbers that JSON can hold; lengths in metres."""
    import numpy as np

    from pinposture.study import outcome

    result, target = outcome(motion, "", "", 0), motion.target
    off = None if target.residual is None else float(target.residual[target.placed].max())
    return {
        "status": motion.status,
        "converged": motion.converged,
        "reason": motion.reason,
        "steps": result.steps,
        "start_error": result.start_error,
        "final_error": result.final_error,
        "lowest_error": result.lowest_error,
        "mean_error": result.mean_share * motion.arm.length,
        "arm_length": motion.arm.length,
        "control_points": motion.arm.n_modules,
        "placed_points": int(target.placed.sum()),
        "placed_by": target.method,
        "largest_residual": off,
        "first_active_points": result.first_points,
        "last_active_points": result.last_points,
        "switches": [switch._asdict() for switch in motion.switches],
        "path_excess": motion.sweep,
        "escape_share": float(motion.escape.mean()) if motion.steps else 0.0,
        "relaxed": [
            {"step": int(k), "what": str(motion.relaxed[k]).splitlines()}
            for k in np.flatnonzero(motion.relaxed != "")
        ],
        "clearance": _closest(motion),
        "incomplete": target.incomplete,
    }


def _closest(motion: Trajectory) -> dict[str, Any] | None:
    """The smallest distance of a run, where the arm stood still between two steps; None without a scene."""
    if motion.scene is None:
        return None
    after = int(motion.clearance.argmin())
    closest = motion.scene.around(motion.arm).minimum(motion.q[after])
    return {
        "smallest": closest.distance,
        "final": float(motion.clearance[-1]),
        "pair": None if closest.pair is None else list(closest.pair),
        "after_steps": after,
        "margin": motion.scene.margin,
    }


def in_words(summary: Mapping[str, Any]) -> dict[str, str | tuple[str, str]]:
    """A summary as a person reads it; the status with the colour in which to print it."""
    first, last, mean = (summary[key] for key in ("start_error", "final_error", "mean_error"))
    off, length = summary["largest_residual"], summary["arm_length"]
    words: dict[str, str | tuple[str, str]] = {
        "status": (summary["status"], "green" if summary["converged"] else "yellow"),
        "reason": str(summary["reason"]),
        "steps": str(summary["steps"]),
        "placed by": f"{summary['placed_by']} placement, at most {off:.2g} m off the curve, "
        f"{off / length:.2g} of the arm length",
        "posture error": f"{first:.4g} m at the start, {last:.4g} m at the end",
        "mean error": f"{mean:.4g} m for each point, {mean / length:.2g} of the arm length",
        "active points": f"{summary['first_active_points']} at the first step, "
        f"{summary['last_active_points']} at the last, of {summary['control_points']}",
        "paths": f"of control points {summary['path_excess']:.3g} times as long as straight ones",
    }
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
        words["clearance"] = _apart(summary["clearance"])
    if summary["relaxed"]:
        first_relaxed = summary["relaxed"][0]
        what = textwrap.shorten("; ".join(first_relaxed["what"]), WORDY, placeholder=" ...")
        words["gave way"] = (
            f"something in {len(summary['relaxed'])} steps; first in step {first_relaxed['step'] + 1}: {what}"
        )
    if summary.get("tip") is not None:
        distance, turn = summary["tip"]["distance"], summary["tip"]["turn"]
        words["tip"] = f"{distance:.4g} m off" + ("" if turn is None else f", turned by {turn:.4g} rad")
    if summary["incomplete"]:
        words["incomplete"] = str(summary["incomplete"])
    return words


def _apart(clearance: Mapping[str, Any]) -> str:
    """A smallest distance as a person reads it."""
    if clearance["pair"] is None:
        return "nothing to keep clear of"
    after = f"after {clearance['after_steps']} steps" if clearance["after_steps"] else "at the start"
    return (
        f"{clearance['smallest']:.4g} m where it is smallest, {' to '.join(clearance['pair'])}, {after}; "
        f"{clearance['final']:.4g} m at the end; the margin is {clearance['margin']:.4g} m"
    )
