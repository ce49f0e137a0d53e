"""What is said about a run, and what is kept of it."""

from __future__ import annotations

import io
from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from matplotlib.figure import Figure

    from pinposture.motion import Trajectory

RUN, PLOT, ANIMATION = "run.npz", "run.png", "run.html"
FILES = {"run": RUN, "plot": PLOT, "animation": ANIMATION}


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
        "incomplete": target.incomplete,
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
    }
    if summary["switches"]:
        first_switch = summary["switches"][0]
        words["switches"] = (
            f"{len(summary['switches'])}; the first in step {first_switch['step'] + 1} to "
            f"{first_switch['method']}: {first_switch['reason']}"
        )
    if summary["incomplete"]:
        words["incomplete"] = str(summary["incomplete"])
    return words
