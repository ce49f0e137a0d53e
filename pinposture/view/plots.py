"""Figures: one run told in one picture, and several runs side by side."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
from matplotlib.figure import Figure

from pinposture.errors import InvalidValue
from pinposture.motion import Motion, Trajectory
from pinposture.view import palette
from pinposture.view.axes import dress_steps, scale_counts
from pinposture.view.clearance import explain, has_clearance, mark_escapes, mark_relaxed, plot_clearance
from pinposture.view.layout import footnote, lay_out, share_axis, title
from pinposture.view.motion import plot_motion
from pinposture.view.panels import (
    chooses_points,
    mark_method,
    plot_active_points,
    plot_point_errors,
    plot_posture_error,
)
from pinposture.view.run_postures import draw_runs, plot_postures
from pinposture.view.words import controller_name, ending, moved_curves


def plot(run: Trajectory | Motion) -> Figure:
    """Tell a run in one figure: postures, posture error, point errors, active points, clearance.

    Active points are left out where the controller does not choose any, clearance where there was no scene.
    Where a controller took turns, red dots on the axis mark the steps that it left to Projection. Behind the
    posture error, escape steps are shaded; red bars below it mark steps in which a constraint gave way.

    Of a motion in time it tells the postures at its named places, and over time the posture error, joint
    speeds and accelerations relative to their limits, what was slowed down, and clearance.

    Args:
        run: the run, or the motion.

    Returns:
        A figure, 1200 pixels wide; `figure.savefig(path)` writes it. It is not shown, and pyplot does not
        know of it.

    Raises:
        InvalidValue: it is neither a run nor a motion.
    """
    if isinstance(run, Motion):
        return plot_motion(run)
    if not isinstance(run, Trajectory):
        raise InvalidValue("run", run, "a Trajectory, as from `track`, or a Motion, as from `move_through`")
    draws = [plot_posture_error, plot_point_errors]
    if chooses_points(run):
        draws.append(plot_active_points)
    if has_clearance(run):
        draws.append(plot_clearance)
    figure, postures, panels = lay_out(run.arm, len(draws))
    plot_postures(run, postures)
    for draw, panel in zip(draws, panels, strict=True):
        draw(run, panel)
    mark_escapes(run, panels[0])
    mark_relaxed(run, panels[0])
    explain(panels[0])
    share_axis(panels)
    if run.switches:
        mark_method(run, panels[-1])
        panels[-1].set_xlabel("step (red: steps by Projection)")
    title(figure, [f"{controller_name(run)} {ending(run)}: {run.reason}"])
    footnote(figure, "; ".join(filter(None, [moved_curves(run), run.controller])))
    return figure


def plot_comparison(runs: Mapping[str, Trajectory]) -> Figure:
    """Show several runs towards one target in one figure: postures, posture errors, active points, clearance.

    Args:
        runs: the runs by the names that they are to have in the figure.

    Returns:
        A figure, 1200 pixels wide, as `plot` gives it.

    Raises:
        InvalidValue: no run at all, or runs of different arms or targets.
    """
    _require_same_target(runs)
    colors = palette.distinct_colors(run.controller for run in runs.values())
    near = any(has_clearance(run) for run in runs.values())
    figure, postures, panels = lay_out(next(iter(runs.values())).arm, 2 + near)
    errors, counts = panels[:2]
    draw_runs(
        [(run, label, color) for (label, run), color in zip(runs.items(), colors, strict=True)], postures
    )
    for (label, run), color in zip(runs.items(), colors, strict=True):
        plot_posture_error(run, errors, color, label)
        steps = np.arange(1, run.steps + 1)
        marker = "o" if run.steps == 1 else ""
        counts.plot(steps, run.active.sum(axis=1), color=color, lw=1.6, drawstyle="steps-mid", marker=marker)
    dress_steps(counts, "active control points")
    scale_counts(counts, max(run.arm.n_modules for run in runs.values()))
    if near:
        for run, color in zip(runs.values(), colors, strict=True):
            plot_clearance(run, panels[2], color)
    share_axis(panels)
    title(figure, [f"{label} {ending(run)}: {run.reason}" for label, run in runs.items()])
    return figure


def _require_same_target(runs: Mapping[str, Trajectory]) -> None:
    if not runs:
        raise InvalidValue("runs", dict(runs), "at least one run")
    first_label, first = next(iter(runs.items()))
    for label, run in runs.items():
        same = run.target.points.shape == first.target.points.shape
        if not (same and np.allclose(run.target.points, first.target.points, rtol=0.0, atol=1e-9)):
            raise InvalidValue("runs", label, f"runs towards the same target as {first_label!r}")
