"""Single panels of a run against steps; each draws into axes that it is given."""

from __future__ import annotations

from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.cm import ScalarMappable
from matplotlib.colors import LinearSegmentedColormap, Normalize
from matplotlib.ticker import MaxNLocator

from pinposture.motion import Trajectory
from pinposture.view import palette
from pinposture.view.axes import dress_steps, mark_end, mark_start, scale_counts, scale_values


def is_conditioned(run: Trajectory) -> bool:
    """Whether the controller inverted a posture control matrix, whose singular values were recorded."""
    return bool(np.any(run.sigma_max > 0.0))


def chooses_points(run: Trajectory) -> bool:
    """Whether there is something to tell of the control points that were active: a choice, or conditions."""
    counts = run.active.sum(axis=1)
    return not run.steps or is_conditioned(run) or bool(np.any(counts != counts[0]))


def plot_posture_error(run: Trajectory, ax: Axes, color: str | None = None, label: str | None = None) -> None:
    """Draw the posture error [m] against steps, its first and last value written beside it.

    Args:
        run: the run.
        ax: where to draw. Lines that are there already stay, and are taken into account by the scale.
        color: colour of the line; that of the controller if None.
        label: name of the line in a legend. A line with a name has only its last value written.
    """
    color = palette.controller_color(run.controller) if color is None else color
    marker = "" if run.steps else "o"
    steps = np.arange(run.steps + 1)
    ax.plot(
        steps, run.posture_error, color=color, lw=1.8, label=label, marker=marker, clip_on=bool(run.steps)
    )
    dress_steps(ax, "posture error [m]")
    scale_values(ax)
    if label is None:
        mark_start(ax, float(run.posture_error[0]), color, "m")
    if run.steps:
        mark_end(ax, run.steps, float(run.posture_error[-1]), color, "m")


def plot_point_errors(run: Trajectory, ax: Axes) -> None:
    """Draw the error [m] of every control point that has a target against steps.

    The colour tells how far along the arm a control point is; a bar beside the axes says how.

    Args:
        run: the run.
        ax: where to draw.
    """
    m = run.arm.n_modules
    colors = LinearSegmentedColormap.from_list("along the arm", palette.ALONG)
    norm = Normalize(1, max(m, 2))
    for k in np.flatnonzero(run.target.placed):
        marker = "" if run.steps else "o"
        steps = np.arange(run.steps + 1)
        ax.plot(steps, run.point_errors[:, k], color=colors(norm(k + 1)), lw=1.0, marker=marker, ms=3)
    dress_steps(ax, "point errors [m]")
    scale_values(ax)
    bar = ax.figure.colorbar(ScalarMappable(norm, colors), ax=ax, pad=0.02, aspect=16)
    bar.set_ticks(MaxNLocator(nbins=5, integer=True, min_n_ticks=1) if m > 1 else [1])
    bar.set_label("control point", fontsize=9)
    bar.ax.tick_params(labelsize=8)
    bar.outline.set_visible(False)
    free = m - int(np.count_nonzero(run.target.placed))
    if free:
        note = f"{free} of {m} control points have no target"
        ax.set_title(note, fontsize=8, loc="right", color=palette.INK)


def plot_active_points(run: Trajectory, ax: Axes) -> None:
    """Draw how many control points were active in each step, and how well conditioned they were.

    A second axis holds the smallest singular value of the posture control matrix [m/rad], if it has one.

    Args:
        run: the run.
        ax: where to draw.
    """
    color = palette.controller_color(run.controller)
    steps = np.arange(1, run.steps + 1)
    marker = "o" if run.steps == 1 else ""
    ax.plot(steps, run.active.sum(axis=1), color=color, lw=1.6, drawstyle="steps-mid", marker=marker)
    dress_steps(ax, "active control points")
    scale_counts(ax, run.arm.n_modules)
    ax.yaxis.label.set_color(color)
    if not run.steps:
        ax.set_title("no step was taken", fontsize=8, loc="right", color=palette.INK)
    if not is_conditioned(run):
        return
    other = ax.twinx()
    other.plot(steps, run.sigma_min, color=palette.INK, lw=1.0, ls=(0, (4, 1.5)), marker=marker, ms=3)
    scale_values(other)
    other.set_ylabel(r"$\sigma_{\min}$ [m/rad]", fontsize=9, color=palette.INK)
    other.tick_params(labelsize=8)
    other.spines[["top", "left", "bottom"]].set_visible(False)


def plot_point_count(run: Trajectory, ax: Axes, color: str | None = None) -> None:
    """Draw how many control points were active in each step.

    Args:
        run: the run.
        ax: where to draw.
        color: colour of the line; that of the controller if None.
    """
    color = palette.controller_color(run.controller) if color is None else color
    steps = np.arange(1, run.steps + 1)
    marker = "o" if run.steps == 1 else ""
    ax.plot(steps, run.active.sum(axis=1), color=color, lw=1.4, drawstyle="steps-mid", marker=marker)
    dress_steps(ax, "active control points")
    scale_counts(ax, run.arm.n_modules)


def plot_used_points(run: Trajectory, ax: Axes) -> None:
    """Draw a dot for each control point that was active in a step.

    Args:
        run: the run.
        ax: where to draw.
    """
    color = palette.controller_color(run.controller)
    steps, points = np.nonzero(run.active)
    size = float(np.clip(260.0 / max(run.steps, 1), 1.2, 4.0))
    ax.plot(steps + 1, points + 1, ls="none", marker="o", ms=size, mew=0.0, color=color)
    dress_steps(ax, "control point, from base to tip")
    ax.set_xlim(0.0, run.steps + 1.0)
    ax.set_ylim(0.0, run.arm.n_modules + 1.0)
    ax.yaxis.set_major_locator(MaxNLocator(nbins=5, integer=True, min_n_ticks=1))


def plot_points_and_index(run: Trajectory, ax: Axes) -> None:
    """Draw how many control points were active in each step, and the smallest index among their conditions.

    A second axis holds the manipulability index, unless the controller has no posture control matrix.

    Args:
        run: the run.
        ax: where to draw.
    """
    plot_point_count(run, ax)
    ax.yaxis.label.set_color(palette.controller_color(run.controller))
    if run.steps and not is_conditioned(run):
        return
    other = ax.twinx()
    marker = "o" if run.steps == 1 else ""
    style: dict[str, Any] = {"color": palette.INK, "lw": 1.0, "ls": (0, (4, 1.5)), "marker": marker, "ms": 3}
    other.plot(np.arange(1, run.steps + 1), run.index, **style)
    scale_values(other)
    other.set_ylabel("manipulability index", fontsize=9, color=palette.INK)
    other.tick_params(labelsize=8)
    other.spines[["top", "left", "bottom"]].set_visible(False)


def mark_method(run: Trajectory, ax: Axes, method: str = "projection") -> None:
    """Mark the steps that a controller of several methods left to one of them, by red dots on the step axis.

    Args:
        run: the run.
        ax: axes that hold something against steps already.
        method: which of its methods.
    """
    steps = np.flatnonzero(run.method == method) + 1
    where: dict[str, Any] = {"transform": ax.get_xaxis_transform(), "clip_on": False, "zorder": 6}
    ax.plot(
        steps,
        np.zeros(len(steps)),
        ls="none",
        marker="o",
        ms=3.2,
        mew=0.0,
        color=palette.MARK,
        label=method,
        **where,
    )
