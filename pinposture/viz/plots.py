"""Figures: one run in one picture, several side by side, and a motion in time."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from pinposture.errors import InvalidValue
from pinposture.motion import Motion, Trajectory
from pinposture.motion.trajectory import limit_shares
from pinposture.viz import axes, palette, panels
from pinposture.viz.postures import (
    PosturePanel,
    draw_intermediate_postures,
    draw_runs,
    evenly_spaced_rows,
    plot_postures,
)

# A motion.

MIN_PLACES = 3  # a motion with fewer named places is shown with intermediate postures
LEGEND_WIDTH, HANDLE_WIDTH = 84, 8  # of the legend above the postures, and of a symbol in it [characters]
MAX_DETOURS = 2  # in a title


def plot_motion(motion: Motion) -> Figure:
    """Draw a motion in time in one figure; see `pinposture.viz.plot`."""
    run, time = motion.run, motion.time
    draws: list[Callable[[Motion, Axes], None]] = [panels.plot_error]
    if any(share is not None for share in limit_shares(run)):
        draws.append(panels.plot_joint_rates)
    if axes.is_slowed(motion):
        draws.append(panels.plot_plan_time)
    if panels.has_clearance(run):
        draws.append(lambda motion, ax: panels.plot_clearance(motion.run, ax, time=motion.time))
    figure, postures, rows = axes.new_figure(motion.arm, len(draws))
    plot_places(motion, postures)
    for draw, panel in zip(draws, rows, strict=True):
        draw(motion, panel)
    places = axes.shown_places(motion)
    panels.mark_places(places, rows, [float(time[place.row]) for place in places])
    axes.share_axis(rows)
    deviations = [f"Detour: {text}" for text in motion.deviations[:MAX_DETOURS]]
    if len(motion.deviations) > MAX_DETOURS:
        deviations.append(f"and {len(motion.deviations) - MAX_DETOURS} more")
    ending = f"{axes.controller_name(run)} {axes.motion_ending_text(motion)}: {run.reason}"
    axes.add_title(figure, [ending, *deviations])
    axes.add_footnote(figure, "; ".join(filter(None, [axes.placement_text(motion), run.controller])))
    figure.draw_without_rendering()  # the layout of a high legend needs two passes
    return figure


def plot_places(motion: Motion, ax: Axes) -> None:
    """Draw the postures at the named places of a motion, from pale to dark, and the targets there.

    Raises:
        InvalidValue: plain axes for an arm that moves in space.
    """
    run, panel = motion.run, PosturePanel(motion.arm, ax)
    color = palette.controller_color(run.controller)
    groups = axes.group_alike(motion, axes.shown_places(motion))
    rows = [group[0].row for group in groups]
    targets = [motion.targets[row][motion.target_mask[row]] for row in rows or [motion.steps]]
    rings: dict[str, Any] = {"ls": "none", "marker": "o", "ms": 4.6, "mfc": "white", "mew": 0.8}
    panel.line(np.vstack(targets), label="target points", zorder=3, mec=palette.TARGET, **rings)
    if motion.start_index or not groups:
        panel.posture(run.q[0], palette.START, "initial posture", width=1.2)
    for group in groups:
        label = "; ".join(f"{place.name}, {motion.time[place.row]:.3g} s" for place in group)
        panel.posture(run.q[group[0].row], group[0].color, label, 2.2)
    if not groups:
        panel.posture(run.q[-1], color, "final posture", 2.2)
    if run.scene is not None or len(groups) < MIN_PLACES:
        draw_intermediate_postures(panel, run, color, evenly_spaced_rows(run))
    panel.finish(run.scene)
    handles, labels = ax.get_legend_handles_labels()
    for columns in (3, 2, 1):
        rows_each = -(-len(labels) // columns)
        widths = [max(map(len, labels[k : k + rows_each])) for k in range(0, len(labels), rows_each)]
        if sum(widths) + HANDLE_WIDTH * columns <= LEGEND_WIDTH:
            break
    where: dict[str, Any] = {"loc": "lower left", "bbox_to_anchor": (0.0, 1.0), "ncols": columns}
    legend = ax.legend(handles, labels, fontsize=9, frameon=False, **where)
    for text in legend.get_texts():
        text.set_parse_math(False)


# Runs.


def plot(run: Trajectory | Motion) -> Figure:
    """Draw a run in one figure: postures, posture error, point errors, active points, clearance.

    Active points are left out if the controller does not choose any, clearance if there was no scene. For a
    switching controller, red dots on the axis mark the steps by Projection. Behind the posture error, escape
    steps are shaded; red bars below it mark steps in which a constraint was relaxed.

    A motion in time is drawn by the postures at its named places, and over time by the posture error, joint
    speeds and accelerations relative to their limits, delays, and clearance.

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
    draws = [panels.plot_posture_error, panels.plot_point_errors]
    if panels.chooses_points(run):
        draws.append(panels.plot_active_points)
    if panels.has_clearance(run):
        draws.append(panels.plot_clearance)
    figure, postures, rows = axes.new_figure(run.arm, len(draws))
    plot_postures(run, postures)
    for draw, panel in zip(draws, rows, strict=True):
        draw(run, panel)
    panels.mark_escapes(run, rows[0])
    panels.mark_relaxed(run, rows[0])
    panels.add_legend(rows[0])
    axes.share_axis(rows)
    if run.switches:
        panels.mark_method(run, rows[-1])
        rows[-1].set_xlabel("step (red: steps by Projection)")
    axes.add_title(figure, [f"{axes.controller_name(run)} {axes.ending_text(run)}: {run.reason}"])
    axes.add_footnote(figure, "; ".join(filter(None, [axes.placement_text(run), run.controller])))
    return figure


def plot_comparison(runs: Mapping[str, Trajectory]) -> Figure:
    """Draw several runs to one target in one figure: postures, posture errors, active points, clearance.

    Args:
        runs: the runs by their names in the figure.

    Returns:
        A figure, 1200 pixels wide, as from `plot`.

    Raises:
        InvalidValue: no run at all, or runs of different arms or targets.
    """
    if not runs:
        raise InvalidValue("runs", dict(runs), "at least one run")
    first_label, first = next(iter(runs.items()))
    for label, run in runs.items():
        same = run.target.points.shape == first.target.points.shape
        if not (same and np.allclose(run.target.points, first.target.points, rtol=0.0, atol=1e-9)):
            raise InvalidValue("runs", label, f"runs towards the same target as {first_label!r}")
    colors = palette.distinct_colors(run.controller for run in runs.values())
    drawn = [(run, label, color) for (label, run), color in zip(runs.items(), colors, strict=True)]
    near = any(panels.has_clearance(run) for run in runs.values())
    figure, postures, rows = axes.new_figure(first.arm, 2 + near)
    draw_runs(drawn, postures)
    for run, label, color in drawn:
        panels.plot_posture_error(run, rows[0], color, label)
        panels.plot_point_count(run, rows[1], color)
        if near:
            panels.plot_clearance(run, rows[2], color)
    axes.scale_counts(rows[1], max(run.arm.n_modules for run in runs.values()))
    axes.share_axis(rows)
    axes.add_title(figure, [f"{label} {axes.ending_text(run)}: {run.reason}" for label, run in runs.items()])
    return figure
