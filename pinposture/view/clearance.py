"""How near a run came to something, and what it had to allow itself: in panels against steps or time."""

from __future__ import annotations

import textwrap
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from numpy.typing import NDArray

from pinposture.motion import Trajectory
from pinposture.view import palette
from pinposture.view.axes import dress, mark_least, scale_values

Array = NDArray[np.float64]

LONGEST = 44
"""Characters of what gave way that a legend has room for."""


def has_clearance(run: Trajectory) -> bool:
    """Whether there was anything that the arm could have touched."""
    return run.scene is not None and bool(np.isfinite(run.clearance).any())


def plot_clearance(
    run: Trajectory,
    ax: Axes,
    color: str | None = None,
    label: str | None = None,
    time: Array | None = None,
) -> None:
    """Draw the smallest distance [m] to an obstacle, or between parts of the arm, against steps or time.

    Its least value is written beside it; a dashed line is the margin that the scene asks to keep.

    Args:
        run: a run in a scene.
        ax: where to draw. Lines that are there already stay, and are taken into account by the scale.
        color: colour of the line; that of the controller if None.
        label: name of the line in a legend.
        time: when each configuration was reached, (steps + 1,) [s]; None to draw against steps.
    """
    places = np.arange(run.steps + 1) if time is None else time
    color = palette.controller_color(run.controller) if color is None else color
    values = np.where(np.isfinite(run.clearance), run.clearance, np.nan)
    marker = "" if run.steps else "o"
    ax.plot(places, values, color=color, lw=1.6, label=label, marker=marker)
    if run.scene is not None:
        margin = f"margin to keep, {run.scene.margin:.3g} m"
        known = [str(line.get_label()) for line in ax.get_lines()]
        if margin not in known:
            ends = [0.0, places[-1] or 1.0]
            ax.plot(ends, [run.scene.margin] * 2, color=palette.INK, lw=1.0, ls=(0, (4, 2)), label=margin)
    dress(ax, "clearance [m]", time)
    scale_values(ax)
    drawn = np.concatenate([np.asarray(line.get_ydata(), dtype=np.float64) for line in ax.get_lines()])
    low, high = float(np.nanmin(drawn)), float(np.nanmax(drawn))
    if low <= 0.0:
        ax.set_yscale("linear")
        ax.set_ylim(low - 0.1 * (high - low), high + 0.15 * (high - low) + 1e-12)
    if np.isfinite(values).any():
        least = int(np.nanargmin(values))
        mark_least(ax, float(places[least]), float(values[least]), color, "m")
    explain(ax)


def mark_escapes(run: Trajectory, ax: Axes, time: Array | None = None) -> None:
    """Shade the steps of a run that were meant as an escape, in which the posture error may rise."""
    places = np.arange(run.steps + 1) if time is None else time
    steps = np.flatnonzero(run.escape)
    if len(steps):
        blocks = np.split(steps, np.flatnonzero(np.diff(steps) > 1) + 1)
        ends = [(float(places[block[0]]), float(places[block[-1] + 1])) for block in blocks]
        spans = [(begin, end - begin) for begin, end in ends]
        label = f"{len(steps)} escape step{'s' * (len(steps) > 1)}, the error may rise"
        style: dict[str, Any] = {"color": palette.ESCAPE, "lw": 0.0, "zorder": 0.5, "label": label}
        ax.broken_barh(spans, (0.0, 1.0), transform=ax.get_xaxis_transform(), **style)


def mark_relaxed(run: Trajectory, ax: Axes, time: Array | None = None) -> None:
    """Mark on the axis below the steps in which constraints gave way; the legend quotes the first of them."""
    places = np.arange(run.steps + 1) if time is None else time
    steps: NDArray[np.intp] = np.flatnonzero(run.relaxed != "")
    if len(steps):
        words = textwrap.shorten(str(run.relaxed[steps[0]]), LONGEST, placeholder=" ...")
        label = f"gave way in {len(steps)} step{'s' * (len(steps) > 1)}: {words}"
        style: dict[str, Any] = {"ls": "none", "marker": "|", "ms": 7.0, "mew": 1.2, "color": palette.MARK}
        where: dict[str, Any] = {"transform": ax.get_xaxis_transform(), "clip_on": False, "zorder": 6}
        ax.plot(places[steps + 1], np.zeros(len(steps)), label=label, **style, **where)


def explain(ax: Axes, columns: int = 1, inside: bool = False) -> None:
    """Write a legend above the axes, on the right, if anything in them has a name.

    Args:
        ax: the axes.
        columns: of the legend.
        inside: whether to write it into the axes, where there is most room, because others write above them.
    """
    handles, labels = ax.get_legend_handles_labels()
    if handles:
        style: dict[str, Any] = {"fontsize": 8, "borderaxespad": 0.2, "labelspacing": 0.3, "ncols": columns}
        where: dict[str, Any] = {"loc": "lower right", "bbox_to_anchor": (1.0, 1.0), "frameon": False}
        if inside:
            where = {"loc": "best", "facecolor": "white", "edgecolor": "none", "framealpha": 0.8}
        legend = ax.legend(handles, labels, **where, **style)
        for text in legend.get_texts():
            text.set_parse_math(False)
