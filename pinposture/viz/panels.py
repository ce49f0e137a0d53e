"""Figures of runs and motions, and their panels: errors, control points, clearance, over steps or time."""

from __future__ import annotations

import textwrap
from collections.abc import Callable, Mapping, Sequence
from itertools import pairwise
from typing import Any, NamedTuple

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.transforms import ScaledTranslation
from numpy.typing import NDArray

from pinposture.errors import InvalidValue
from pinposture.motion import JointTrajectory, Run, Trajectory
from pinposture.motion.run import closest, limit_shares
from pinposture.motion.words import in_words, title
from pinposture.units import BELOW_ROUNDING, ROUNDING, length_text
from pinposture.viz import palette
from pinposture.viz.drawing import require_type
from pinposture.viz.palette import THEME
from pinposture.viz.postures import (
    PosturePanel,
    draw_intermediate_postures,
    draw_runs,
    evenly_spaced_rows,
    plot_postures,
)

Array = NDArray[np.float64]


def run_axis(run: Run) -> Array:
    """Return where the configurations of a run are on a horizontal axis, (steps + 1,).

    These are times [s] if the run has a cycle time, else numbers of steps.
    """
    return np.arange(run.steps + 1, dtype=np.float64) * (run.limits.dt or 1.0)


def format_run_axes(ax: Axes, run: Run, label: str) -> None:
    """Format axes over the time of a run, or over its steps if it has no cycle time; see `run_axis`."""
    if run.limits.dt is None:
        palette.format_step_axes(ax, label)
    else:
        palette.format_time_axes(ax, label)


def marker(count: int) -> str:
    """Return the marker of a line with `count` points: without one, a single point would be invisible."""
    return "o" if count == 1 else ""


def _note(ax: Axes, text: str) -> None:
    ax.set_title(text, fontsize=8, loc="right", color=THEME.ink)


def has_singular_values(run: Run) -> bool:
    """Return whether the controller inverted a posture control matrix."""
    return bool(np.any(run.reported("sigma_max", 0.0) > 0.0))


def chooses_points(run: Run) -> bool:
    """Return whether the active control points changed, or their conditioning was recorded."""
    counts = run.active.sum(axis=1)
    return not run.steps or has_singular_values(run) or bool(np.any(counts != counts[0]))


def plot_posture_error(run: Run, ax: Axes, color: str | None = None, label: str | None = None) -> None:
    """Plot the posture error [m] over time or steps, annotated with its first and last values.

    Args:
        run: the run.
        ax: axes to draw into. Existing lines remain and count for the scale.
        color: colour of the line; None: that of the controller.
        label: label of the line in a legend. For a labelled line, only the last value is annotated.
    """
    _plot_errors([(run, label, color)], ax, "posture error", lambda run: run.posture_error)


def plot_mean_error(run: Run, ax: Axes) -> None:
    """Plot the mean error of the control points [m], annotated as by `plot_posture_error`."""
    _plot_errors([(run, None, None)], ax, "mean point error", lambda run: run.mean_error)


def _plot_errors(
    runs: Sequence[tuple[Run, str | None, str | None]],
    ax: Axes,
    name: str,
    errors: Callable[[Run], Array],
) -> None:
    """Plot an error of runs, each with its label and colour, then annotate their first and last values."""
    colors = [palette.controller_color(run.controller) if color is None else color for run, _, color in runs]
    for (run, label, _), color in zip(runs, colors, strict=True):
        style: dict[str, Any] = {"lw": 1.8, "marker": marker(run.steps + 1), "clip_on": bool(run.steps)}
        ax.plot(run_axis(run), errors(run), color=color, label=label, **style)
    format_run_axes(ax, runs[0][0], name)
    palette.scale_values(ax, ROUNDING * runs[0][0].arm.length)
    palette.label_lengths([ax], name)
    for (run, label, _), color in zip(runs, colors, strict=True):
        if label is None:
            _mark_error(ax, run, errors(run), 0, color)
        if run.steps:
            _mark_error(ax, run, errors(run), run.steps, color)


def _mark_error(ax: Axes, run: Run, errors: Array, row: int, color: str) -> None:
    """Annotate the first or the last error [m] of a run."""
    x = float(run_axis(run)[row])
    floor = ROUNDING * run.arm.length
    palette.mark_value(ax, x, float(errors[row]), color, "end" if row else "start", floor)


def plot_point_errors(run: Run, ax: Axes) -> None:
    """Plot the error [m] of every control point with a target over time or steps.

    Lines are coloured by the position of the control point along the arm, with a colour bar.

    Args:
        run: the run.
        ax: axes to draw into.
    """
    m = run.arm.n_modules
    targeted = np.flatnonzero(run.target.has_target)
    colors, norm = palette.colors_along(m)
    style: dict[str, Any] = {"lw": 1.0, "marker": marker(run.steps + 1), "ms": 3}
    for k in targeted:
        ax.plot(run_axis(run), run.point_errors[:, k], color=colors(norm(k + 1)), **style)
    format_run_axes(ax, run, "point errors")
    palette.scale_values(ax, ROUNDING * run.arm.length)
    palette.label_lengths([ax], "point errors")
    palette.add_colorbar([ax], m, "control point", pad=0.02, aspect=16)
    if len(targeted) < m:
        _note(ax, f"{m - len(targeted)} of {m} control points have no target")


def plot_active_points(run: Run, ax: Axes) -> None:
    """Plot the number of active control points in each step, and their conditioning.

    A second axis shows the smallest singular value of the posture control matrix [m/rad], if there is one.

    Args:
        run: the run.
        ax: axes to draw into.
    """
    plot_point_count(run, ax)
    ax.yaxis.label.set_color(palette.controller_color(run.controller))
    if not run.steps:
        _note(ax, "no step was taken")
    if has_singular_values(run):
        _plot_on_second_axis(run, ax, run.reported("sigma_min", 0.0), r"$\sigma_{\min}$ [m/rad]")


def plot_points_and_index(run: Run, ax: Axes, color: str | None = None) -> None:
    """Plot the number of active control points in each step and, if recorded, the manipulability index."""
    color = palette.controller_color(run.controller) if color is None else color
    plot_point_count(run, ax, color)
    ax.yaxis.label.set_color(color)
    if has_singular_values(run) or not run.steps:
        _plot_on_second_axis(run, ax, run.reported("manipulability", 0.0), "manipulability index")


def plot_point_count(run: Run, ax: Axes, color: str | None = None, shift: float = 0.0) -> None:
    """Plot the number of active control points in each step; those with another shift lie beside it."""
    color = palette.controller_color(run.controller) if color is None else color
    style: dict[str, Any] = {"lw": 1.6, "drawstyle": "steps-mid", "marker": marker(run.steps)}
    style["transform"] = ax.transData + ScaledTranslation(0.0, 1.6 / 72.0 * shift, ax.figure.dpi_scale_trans)
    ax.plot(run_axis(run)[1:], run.active.sum(axis=1), color=color, **style)
    format_run_axes(ax, run, "active control points")
    palette.scale_counts(ax, run.arm.n_modules)


def _plot_on_second_axis(run: Run, ax: Axes, values: Array, label: str) -> None:
    """Plot a value per step as a dashed line with its own axis on the right."""
    other = ax.twinx()
    style: dict[str, Any] = {"lw": 1.0, "ls": (0, (4, 1.5)), "marker": marker(run.steps), "ms": 3}
    other.plot(run_axis(run)[1:], values, color=THEME.ink, **style)
    palette.scale_values(other)
    other.set_ylabel(label, fontsize=9, color=THEME.ink)
    other.tick_params(labelsize=8)
    other.spines[["top", "left", "bottom"]].set_visible(False)


def mark_projection(run: Run, ax: Axes) -> None:
    """Mark the steps that a switching controller left to Projection, by red dots on the axis."""
    x = run_axis(run)[1:][run.reported("method", "") == "projection"]
    _mark_on_axis(ax, x, "projection", marker="o", ms=3.2, mew=0.0)


def _mark_on_axis(ax: Axes, x: Array | NDArray[np.intp], label: str, **style: Any) -> None:
    style |= {"ls": "none", "color": THEME.mark, "label": label, "clip_on": False, "zorder": 6}
    ax.plot(x, np.zeros(len(x)), transform=ax.get_xaxis_transform(), **style)


class PanelLayout(NamedTuple):
    """Texts, legends and lines of panels."""

    longest_reason: int = 44
    """Length of a constraint in a legend, at most [characters]."""

    legend_length: int = 48
    """Length of all labels from which a legend has one column [characters]."""

    legend_width: int = 84
    """Width of the legend above the postures [characters]."""

    handle_width: int = 8
    """Width of its symbols [characters]."""

    letter_width: float = 4.6
    """Mean letter width of the names above the axes [pt]."""

    name_distance: float = 18.0
    """Distance between waypoints that get names of their own [pt]."""

    fewest_waypoints: int = 3
    """Number of waypoints below which intermediate postures are shown."""

    most_detours: int = 2
    """Largest number of detours in a title."""

    dashes: tuple[int, tuple[int, int]] = (0, (4, 2))
    """Dashes of lines of limits and plans."""


PANEL = PanelLayout()


def has_clearance(run: Run) -> bool:
    """Return whether a clearance was recorded."""
    return run.scene is not None and bool(np.isfinite(run.clearance).any())


def plot_clearance(
    run: Run,
    ax: Axes,
    color: str | None = None,
    label: str | None = None,
) -> None:
    """Plot the smallest distance [m] to an obstacle, or between parts of the arm, over time or steps.

    Its minimum is annotated, and the legend names the pair that comes closest; a dashed line shows the margin
    of the scene.

    Args:
        run: a run in a scene.
        ax: axes to draw into. Existing lines remain and count for the scale.
        color: colour of the line; None: that of the controller.
        label: label of the line in a legend; None: the pair that comes closest to each other.
    """
    x = run_axis(run)
    if label is None:
        least_clearance = closest(run)
        pair = None if least_clearance is None else least_clearance["pair"]
        label = None if pair is None else f"closest: {' to '.join(pair)}"
    color = palette.controller_color(run.controller) if color is None else color
    values = np.where(np.isfinite(run.clearance), run.clearance, np.nan)
    ax.plot(x, values, color=color, lw=1.6, label=label, marker=marker(run.steps + 1))
    if run.scene is not None:
        margin = f"margin to keep, {length_text(run.scene.margin)}"
        if margin not in [line.get_label() for line in ax.get_lines()]:
            ends = [0.0, x[-1] or 1.0]
            ax.plot(ends, [run.scene.margin] * 2, color=THEME.ink, lw=1.0, ls=PANEL.dashes, label=margin)
    format_run_axes(ax, run, "clearance")
    palette.scale_values(ax)
    drawn = np.concatenate([np.asarray(line.get_ydata(), dtype=np.float64) for line in ax.get_lines()])
    low = float(np.nanmin(drawn))
    high = float(np.nanmax(drawn))
    if low <= 0.0:
        ax.set_yscale("linear")
        ax.set_ylim(low - 0.1 * (high - low), high + 0.15 * (high - low) + 1e-12)
    palette.label_lengths([ax], "clearance")
    if np.isfinite(values).any():
        least = int(np.nanargmin(values))
        palette.mark_value(ax, float(x[least]), float(values[least]), color, "least")
    add_legend(ax)


def mark_rising_steps(run: Run, ax: Axes) -> None:
    """Shade the steps of a run in which the controller allows the posture error to rise."""
    x = run_axis(run)
    steps = np.flatnonzero(run.error_increasing)
    if len(steps):
        blocks = np.split(steps, np.flatnonzero(np.diff(steps) > 1) + 1)
        ends = [(float(x[block[0]]), float(x[block[-1] + 1])) for block in blocks]
        spans = [(begin, end - begin) for begin, end in ends]
        label = f"{len(steps)} step{'s' * (len(steps) > 1)} in which the error may rise"
        style: dict[str, Any] = {"color": THEME.escape, "lw": 0.0, "zorder": 0.5, "label": label}
        ax.broken_barh(spans, (0.0, 1.0), transform=ax.get_xaxis_transform(), **style)


def mark_violations(run: Run, ax: Axes) -> None:
    """Mark steps that violate constraints on the axis; the legend quotes the first violation."""
    x = run_axis(run)
    steps: NDArray[np.intp] = np.flatnonzero(run.violated_constraints != "")
    if len(steps):
        first = str(run.violated_constraints[steps[0]])
        words = textwrap.shorten(first, PANEL.longest_reason, placeholder=" ...")
        label = f"violated in {len(steps)} step{'s' * (len(steps) > 1)}: {words}"
        _mark_on_axis(ax, x[steps + 1], label, marker="|", ms=7.0, mew=1.2)


def add_legend(ax: Axes) -> None:
    """Add a legend above the axes if anything has a label: in one column if the labels are long."""
    handles, labels = ax.get_legend_handles_labels()
    if handles:
        columns = 3 if sum(map(len, labels)) < PANEL.legend_length else 1
        style: dict[str, Any] = {"fontsize": 8, "borderaxespad": 0.2, "labelspacing": 0.3, "ncols": columns}
        where: dict[str, Any] = {"loc": "lower right", "bbox_to_anchor": (1.0, 1.0), "frameon": False}
        legend = ax.legend(handles, labels, **where, **style)
        for text in legend.get_texts():
            text.set_parse_math(False)


def plot_error(motion: Trajectory, ax: Axes) -> None:
    """Plot the mean and largest error of the control points of a motion over time, with violated constraints.

    Errors below rounding are not shown.
    """
    run = motion.run
    color = palette.controller_color(run.controller)
    floor = ROUNDING * motion.arm.length
    largest = run.point_errors.max(axis=1)
    style: dict[str, Any] = {"color": color, "marker": marker(run.steps + 1)}
    values, most = (np.where(errors > floor, errors, 0.0) for errors in (motion.mean_error, largest))
    ax.plot(motion.time, values, lw=1.8, label="mean" if most.any() else None, **style)
    if most.any():
        ax.plot(motion.time, most, lw=0.8, label="largest", **style)
    palette.format_time_axes(ax, "point errors")
    palette.scale_values(ax)
    palette.label_lengths([ax], "point errors")
    if not most.any():
        ax.set_yticks([0.0])
        where: dict[str, Any] = {"transform": ax.transAxes, "ha": "center", "va": "center"}
        text = f"{BELOW_ROUNDING} throughout"
        ax.text(0.5, 0.5, text, fontsize=9, color=color, backgroundcolor="white", **where)
    else:
        low, high = ax.get_ylim()  # leave room below the names for the first value
        ax.set_ylim(low, high * (high / low) ** 0.12 if low > 0.0 else 1.1 * high)
        if values[0]:
            _mark_error(ax, run, values, 0, color)
        if values[-1] and run.steps:
            _mark_error(ax, run, values, run.steps, color)
    mark_rising_steps(run, ax)
    mark_violations(run, ax)
    if motion.start_index:
        style = {"color": THEME.faint, "alpha": 0.5, "lw": 0.0, "zorder": 0.4}
        ax.axvspan(0.0, motion.time[motion.start_index], label="moving to the first posture", **style)
    add_legend(ax)


def plot_joint_rates(motion: Trajectory, ax: Axes) -> None:
    """Plot the largest joint speed and acceleration relative to their limits, if there are limits."""
    speeds, accelerations = limit_shares(motion.run)
    largest = 1.0
    if accelerations is not None:
        ax.plot(motion.time, accelerations, color=THEME.spare[0], lw=1.0, label="acceleration")
        largest = max(largest, float(accelerations.max()))
    if speeds is not None:
        style: dict[str, Any] = {"lw": 1.6, "label": "speed", "marker": marker(motion.steps)}
        ax.plot(motion.time[1:] - motion.dt / 2.0, speeds, color=THEME.spare[2], **style)
        largest = max(largest, float(speeds.max(initial=0.0)))
    ends = [0.0, float(motion.time[-1]) or 1.0]
    ax.plot(ends, [1.0, 1.0], color=THEME.ink, lw=1.0, ls=PANEL.dashes, label="limit")
    palette.format_time_axes(ax, "largest of all joints\n[share of limit]")
    ax.set_ylim(-0.03 * largest, 1.12 * largest)
    add_legend(ax)


def plot_plan_time(motion: Trajectory, ax: Axes) -> None:
    """Plot plan time over real time, as executed and as planned."""
    begin = float(motion.time[motion.start_index])
    plan = [0.0, begin, begin + motion.planned]
    ax.plot(plan, [0.0, 0.0, motion.planned], color=THEME.ink, lw=1.0, ls=PANEL.dashes, label="as planned")
    label = f"as executed, {motion.time_scale:.3g} times as long"
    ax.plot(motion.time, motion.plan_time, color=THEME.spare[1], lw=1.6, label=label)
    palette.format_time_axes(ax, "plan time [s]")
    ax.set_xlim(0.0, float(motion.time[-1]) or 1.0)
    add_legend(ax)


def mark_waypoints(
    waypoints: Sequence[palette.WaypointMark], panels: Sequence[Axes], times: Sequence[float]
) -> None:
    """Mark the times of waypoints [s] by lines through stacked panels, with names above the first panel."""
    if not waypoints:
        return
    for ax in panels:
        for waypoint, time in zip(waypoints, times, strict=True):
            where: dict[str, Any] = {"transform": ax.get_xaxis_transform(), "zorder": 1.5, "clip_on": False}
            ax.vlines(time, 0.0, 1.0, color=waypoint.color, lw=1.0, **where)
    first = panels[0]
    low, high = first.get_xlim()
    scale = 72.0 * first.bbox.width / first.figure.dpi / (high - low)  # [pt/s]
    legend = first.get_legend()
    above = 3.0 if legend is None else 72.0 * legend.get_window_extent().height / first.figure.dpi
    names = _merge_close_names(waypoints, [scale * time for time in times])
    slanted = any(
        (at - before) < PANEL.letter_width * (len(name) + len(other)) / 2.0 + PANEL.letter_width
        for (before, other), (at, name) in pairwise(names)
    )
    for at, name in names:
        style: dict[str, Any] = {"fontsize": 8, "color": THEME.ink, "parse_math": False, "va": "bottom"}
        style |= {"rotation": 30, "ha": "left", "rotation_mode": "anchor"} if slanted else {"ha": "center"}
        where = {"xycoords": ("data", "axes fraction"), "textcoords": "offset points"}
        first.annotate(name, (at / scale, 1.0), xytext=(0, above), annotation_clip=False, **where, **style)


def _merge_close_names(
    waypoints: Sequence[palette.WaypointMark], positions: Sequence[float]
) -> list[tuple[float, str]]:
    """Return positions [pt] and names to write; names that are too close are joined as far as they fit."""
    names: list[tuple[float, str]] = []
    for waypoint, at in zip(waypoints, positions, strict=True):
        if not names or at - names[-1][0] >= PANEL.name_distance:
            names.append((at, waypoint.name))
        elif len(names[-1][1]) + len(waypoint.name) < palette.WAYPOINT_MARKS.longest_name:
            names[-1] = names[-1][0], f"{names[-1][1]}, {waypoint.name}"
    return names


def plot_motion(motion: Trajectory) -> Figure:
    """Plot a motion in time in one figure; see `pinposture.viz.plot`."""
    run = motion.run
    time = motion.time
    draws: list[Callable[[Trajectory, Axes], None]] = [plot_error]
    if any(share is not None for share in limit_shares(run)):
        draws.append(plot_joint_rates)
    if motion.slowdown:
        draws.append(plot_plan_time)
    if has_clearance(run):
        draws.append(lambda motion, ax: plot_clearance(motion.run, ax))
    figure, postures, rows = palette.new_figure(motion.arm, len(draws))
    plot_waypoints(motion, postures)
    for draw, panel in zip(draws, rows, strict=True):
        draw(motion, panel)
    waypoints = palette.shown_waypoints(motion)
    mark_waypoints(waypoints, rows, [float(time[waypoint.row]) for waypoint in waypoints])
    palette.share_axis(rows)
    deviations = [f"not as planned: {text}" for text in motion.deviations[: PANEL.most_detours]]
    if len(motion.deviations) > PANEL.most_detours:
        deviations.append(f"and {len(motion.deviations) - PANEL.most_detours} more")
    palette.add_title(figure, [title(motion.summary(), palette.controller_name(run)), *deviations])
    palette.add_footnote(
        figure, palette.controller_text(run), palette.limits_text(run), palette.placement_text(motion)
    )
    figure.draw_without_rendering()  # the layout of a tall legend needs two passes
    return figure


def plot_waypoints(motion: Trajectory, ax: Axes) -> None:
    """Draw the postures at the waypoints of a motion, from pale to dark, and their targets.

    Raises:
        InvalidValue: plain axes for an arm that moves in space.
    """
    run = motion.run
    panel = PosturePanel(motion.arm, ax)
    color = palette.controller_color(run.controller)
    groups = palette.group_alike(motion, palette.shown_waypoints(motion))
    rows = [group[0].row for group in groups]
    targets = [motion.targets[row][motion.target_mask[row]] for row in rows or [motion.steps]]
    rings: dict[str, Any] = {"ls": "none", "marker": "o", "ms": 4.6, "mfc": "white", "mew": 0.8}
    panel.line(np.vstack(targets), label="target points", zorder=3, mec=THEME.target, **rings)
    if motion.start_index or not groups:
        panel.posture(run.q[0], THEME.start, "initial posture", width=1.2)
    for group in groups:
        label = "; ".join(f"{waypoint.name}, {motion.time[waypoint.row]:.3g} s" for waypoint in group)
        panel.posture(run.q[group[0].row], group[0].color, label, 2.2)
    if not groups:
        panel.posture(run.q[-1], color, "final posture", 2.2)
    if run.scene is not None or len(groups) < PANEL.fewest_waypoints:
        draw_intermediate_postures(panel, run, color, evenly_spaced_rows(run))
    panel.finish(run.final_scene)
    handles, labels = ax.get_legend_handles_labels()
    for columns in (3, 2, 1):
        rows_each = -(-len(labels) // columns)
        widths = [max(map(len, labels[k : k + rows_each])) for k in range(0, len(labels), rows_each)]
        if sum(widths) + PANEL.handle_width * columns <= PANEL.legend_width:
            break
    where: dict[str, Any] = {"loc": "lower left", "bbox_to_anchor": (0.0, 1.0), "ncols": columns}
    legend = ax.legend(handles, labels, fontsize=9, frameon=False, **where)
    for text in legend.get_texts():
        text.set_parse_math(False)


def plot_joints(trajectory: JointTrajectory) -> Figure:
    """Plot joint positions, velocities and accelerations over time; see `plot`."""
    count = len(trajectory.joint_names)
    figure = Figure(figsize=(palette.FIGURE.width, palette.FIGURE.height), layout="constrained")
    panels: Sequence[Axes] = figure.subplots(3, 1, sharex=True)
    colors, norm = palette.colors_along(count)
    unit = " or ".join(filter(None, dict.fromkeys(trajectory.units)))
    drawn = {
        "position": (trajectory.positions, ""),
        "velocity": (trajectory.velocities, "/s"),
        "acceleration": (trajectory.accelerations, "/s²"),
    }
    for ax, (name, (table, per)) in zip(panels, drawn.items(), strict=True):
        for number, values in enumerate(table.T):
            style: dict[str, Any] = {"lw": 1.0, "marker": marker(len(values)), "ms": 3}
            ax.plot(trajectory.time, values, color=colors(norm(number + 1)), **style)
        palette.format_time_axes(ax, f"{name} [{unit}{per}]" if unit else name)
    palette.share_axis(panels)
    palette.add_colorbar(panels, count, "joint, in the order of the trajectory", pad=0.01, aspect=40)
    words = [f"{topic}: {said}" for topic, said in in_words(trajectory.summary()).items()]
    palette.add_title(figure, ["; ".join(filter(None, (trajectory.name, *words)))])
    return figure


def plot(run: Run | Trajectory | JointTrajectory) -> Figure:
    """Plot a run in one figure: postures, mean and single point errors, active points, clearance.

    Active points are omitted if the controller does not choose any, clearance if there was no scene. For a
    switching controller, red dots on the axis mark the steps by Projection. Shading behind the mean
    error marks steps in which it may rise; red bars below it mark violated constraints.

    For a motion in time, the figure shows the postures at its waypoints and, over time, point errors,
    joint speeds and accelerations relative to their limits, delays, and clearance. For a joint trajectory, it
    shows positions, velocities and accelerations, with a line per joint.

    Args:
        run: the run, motion, or joint trajectory.

    Returns:
        A figure, 1200 pixels wide; `figure.savefig(path)` writes it. It is not shown or registered with
        pyplot.

    Raises:
        InvalidValue: none of these types.
    """
    if isinstance(run, Trajectory):
        return plot_motion(run)
    if isinstance(run, JointTrajectory):
        return plot_joints(run)
    require_type("run", run, Run, Trajectory, JointTrajectory)
    draws = [plot_mean_error, plot_point_errors]
    if chooses_points(run):
        draws.append(plot_active_points)
    if has_clearance(run):
        draws.append(plot_clearance)
    figure, postures, rows = palette.new_figure(run.arm, len(draws))
    plot_postures(run, postures)
    for draw, panel in zip(draws, rows, strict=True):
        draw(run, panel)
    mark_rising_steps(run, rows[0])
    mark_violations(run, rows[0])
    add_legend(rows[0])
    palette.share_axis(rows)
    if run.switches:
        mark_projection(run, rows[-1])
        rows[-1].set_xlabel(f"{rows[-1].get_xlabel()} (red: steps by Projection)")
    palette.add_title(figure, [title(run.summary(), palette.controller_name(run))])
    palette.add_footnote(
        figure, palette.controller_text(run), palette.limits_text(run), palette.placement_text(run)
    )
    return figure


def plot_comparison(runs: Mapping[str, Run]) -> Figure:
    """Plot several runs to one target in one figure: postures, mean errors, active points, clearance.

    Args:
        runs: the runs by their labels in the figure.

    Returns:
        A figure, 1200 pixels wide, as from `plot`.

    Raises:
        InvalidValue: no runs by label, or runs with different arms or targets.
    """
    if not (isinstance(runs, Mapping) and runs):
        raise InvalidValue("runs", runs, "at least one run by its label, as in {label: run, ...}")
    for label, run in runs.items():
        require_type(f"runs[{label!r}]", run, Run)
    first_label, first = next(iter(runs.items()))
    for label, run in runs.items():
        same = run.target.points.shape == first.target.points.shape
        if not (same and np.allclose(run.target.points, first.target.points, rtol=0.0, atol=1e-9)):
            raise InvalidValue("runs", label, f"runs towards the same target as {first_label!r}")
        if (run.limits.dt is None) != (first.limits.dt is None):
            raise InvalidValue("runs", label, f"runs with a cycle time, or without one as {first_label!r}")
    colors = palette.distinct_colors(run.controller for run in runs.values())
    drawn = [(run, label, color) for (label, run), color in zip(runs.items(), colors, strict=True)]
    near = any(has_clearance(run) for run in runs.values())
    figure, postures, rows = palette.new_figure(first.arm, 2 + near)
    draw_runs(drawn, postures)
    _plot_errors(drawn, rows[0], "mean point error", lambda run: run.mean_error)
    for number, (run, _, color) in enumerate(drawn):
        plot_point_count(run, rows[1], color, (len(drawn) - 1) / 2.0 - number)
        if near:
            plot_clearance(run, rows[2], color)
    palette.scale_counts(rows[1], max(run.arm.n_modules for run in runs.values()))
    palette.share_axis(rows)
    palette.add_title(figure, [title(run.summary(), label) for label, run in runs.items()])
    return figure
