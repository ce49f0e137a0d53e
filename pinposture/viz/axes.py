"""Axes, layout and captions that all figures share."""

from __future__ import annotations

import textwrap
from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np
from matplotlib.axes import Axes
from matplotlib.cm import ScalarMappable
from matplotlib.colors import LinearSegmentedColormap, Normalize
from matplotlib.figure import Figure
from matplotlib.layout_engine import ConstrainedLayoutEngine
from matplotlib.ticker import MaxNLocator, NullFormatter
from numpy.typing import NDArray

from pinposture.arm import Arm
from pinposture.motion import Motion, Trajectory
from pinposture.motion.trajectory import ENDINGS
from pinposture.viz import palette

# Scales, ticks and labels of axes against steps or time.

DECADES = 1.5
"""Range of values, in powers of ten, from which on a logarithmic axis shows more than a linear one."""

DEEPEST = 12.0
"""Powers of ten below the largest value that a logarithmic axis shows at most; below that is rounding."""


def format_step_axes(ax: Axes, label: str) -> None:
    """Give axes against steps, from 0 to the last step drawn, their ticks, grid and labels."""
    steps = _format_axes(ax, "step", label)
    ax.set_xlim(0.0 if steps else -1.0, max(steps, 1.0))
    ax.xaxis.set_major_locator(MaxNLocator(nbins=8, integer=True, min_n_ticks=1))


def format_axes(ax: Axes, label: str, time: NDArray[np.float64] | None) -> None:
    """Dress axes against steps, or against time if there is one."""
    if time is None:
        format_step_axes(ax, label)
    else:
        format_time_axes(ax, label)


def format_time_axes(ax: Axes, label: str) -> None:
    """Give axes against time, from 0 to the last moment drawn, their ticks, grid and labels."""
    end = _format_axes(ax, "time [s]", label)
    ax.set_xlim(0.0 if end else -1.0, end or 1.0)
    ax.xaxis.set_major_locator(MaxNLocator(nbins=8, min_n_ticks=1))


def _format_axes(ax: Axes, across: str, label: str) -> float:
    """Labels, grid and edges of axes; returns the largest number drawn on the horizontal one."""
    ax.set_xlabel(across, fontsize=9)
    ax.set_ylabel(label, fontsize=9)
    ax.tick_params(labelsize=8)
    ax.spines[["top", "right"]].set_visible(False)
    ax.grid(color=palette.FAINT, lw=0.6)
    ax.set_axisbelow(True)
    return max((float(np.max(line.get_xdata(), initial=0.0)) for line in ax.get_lines()), default=0.0)


def scale_values(ax: Axes) -> None:
    """Fit the vertical axis to the lines drawn; make it logarithmic where that shows more.

    On a logarithmic axis a line falls out at the bottom where its value is exactly 0.
    """
    drawn = [np.asarray(line.get_ydata(), dtype=np.float64) for line in ax.get_lines()]
    values = np.concatenate([*drawn, np.zeros(0)])
    positive = values[values > 0.0]
    top = float(positive.max()) if len(positive) else 1.0
    if not len(positive) or np.log10(top / positive.min()) < DECADES:
        ax.set_yscale("linear")
        ax.set_ylim(-0.03 * top, 1.15 * top)
        return
    ax.set_yscale("log", nonpositive="clip")
    ax.yaxis.set_minor_formatter(NullFormatter())
    ax.set_ylim(max(float(positive.min()), top * 10.0**-DEEPEST) / 1.8, top * 1.8)


def scale_counts(ax: Axes, largest: int) -> None:
    """Fit the vertical axis to whole numbers from 0 to the largest there can be."""
    ax.set_ylim(-0.04 * largest, 1.06 * largest)
    ax.yaxis.set_major_locator(MaxNLocator(nbins=5, integer=True, min_n_ticks=1))


def mark_start(ax: Axes, value: float, color: str, unit: str) -> None:
    """Write the value at the start beside it."""
    _mark(ax, 0, value, color, unit, (7, 4), "left", "bottom")


def mark_end(ax: Axes, place: float, value: float, color: str, unit: str) -> None:
    """Write the value at the last step, or moment, in the margin on the right, above the axis if below it."""
    below = value <= ax.get_ylim()[0]
    _mark(ax, place, value, color, unit, (6, 4 if below else 0), "left", "bottom" if below else "center")


def mark_least(ax: Axes, place: float, value: float, color: str, unit: str) -> None:
    """Write a least value above its place, where the line leaves room on both sides."""
    _mark(ax, place, value, color, unit, (0, 8), "center", "bottom")


def _mark(
    ax: Axes, across: float, value: float, color: str, unit: str, offset: tuple[int, int], ha: str, va: str
) -> None:
    low, high = ax.get_ylim()
    place = (across, float(np.clip(value, low, high)))  # a zero has no place of its own on a logarithmic axis
    ax.plot(*place, marker="o", ms=4, color=color, clip_on=False, zorder=5)
    ax.set_ylim(low, high)
    ax.annotate(
        f"{value:.3g} {unit}",
        place,
        xytext=offset,
        textcoords="offset points",
        ha=ha,
        va=va,
        fontsize=8,
        color=color,
        bbox={"facecolor": "white", "edgecolor": "none", "alpha": 0.8, "pad": 1.0},
        annotation_clip=False,
    )


def colors_along(count: int) -> tuple[LinearSegmentedColormap, Normalize]:
    """Colours of things numbered from base to tip, 1 to `count`."""
    return LinearSegmentedColormap.from_list("along the arm", palette.ALONG), Normalize(1, max(count, 2))


def add_colorbar(panels: Sequence[Axes], count: int, label: str, **options: Any) -> None:
    """Tell beside panels what `colors_along` means in them."""
    colors, norm = colors_along(count)
    figure: Any = panels[0].figure
    bar = figure.colorbar(ScalarMappable(norm, colors), ax=panels, **options)
    bar.set_ticks(MaxNLocator(nbins=8, integer=True, min_n_ticks=1) if count > 1 else [1])
    bar.set_label(label, fontsize=9)
    bar.ax.tick_params(labelsize=8)
    bar.outline.set_visible(False)


# Layout of figures: postures on the left, panels that share an axis on the right.

WIDTH, HEIGHT = 12.0, 7.2
"""Size of a figure [inch]; 1200 pixels wide at the default resolution."""


def new_figure(arm: Arm, rows: int) -> tuple[Figure, Axes, list[Axes]]:
    """A figure with axes for postures of an arm, and so many panels beside them, one below the other."""
    size = WIDTH, HEIGHT + max(0, rows - 3)
    figure = Figure(figsize=size, layout=ConstrainedLayoutEngine(w_pad=0.1, h_pad=0.09, wspace=0.04))
    grid = figure.add_gridspec(rows, 2, width_ratios=(1.1, 1.0))
    postures = figure.add_subplot(grid[:, 0], projection="3d" if arm.dimension == 3 else None)
    return figure, postures, [figure.add_subplot(grid[row, 1]) for row in range(rows)]


def share_axis(panels: Sequence[Axes]) -> None:
    """Let only the last of panels above each other tell what their horizontal axis is."""
    for panel in panels[:-1]:
        panel.set_xlabel("")
        panel.tick_params(labelbottom=False)


def title(figure: Figure, sentences: Sequence[str]) -> None:
    """Write sentences above all, one a line unless they are long."""
    text = "\n".join(textwrap.fill(sentence, 145) for sentence in sentences)
    figure.suptitle(text, fontsize=10, x=0.012, ha="left", color=palette.INK, parse_math=False)


def footnote(figure: Figure, text: str) -> None:
    """Write below all what few will read."""
    text = textwrap.fill(textwrap.shorten(text, 500), 190)
    figure.supxlabel(text, fontsize=8, x=0.012, ha="left", color=palette.QUIET, parse_math=False)


# Words for titles.


def placement_text(run: Trajectory | Motion) -> str:
    """How curves were moved from where they were drawn, in words; empty if none was."""
    if isinstance(run, Motion):
        told = [f"{place.name} {place.moved}" for place in run.waypoints if place.moved]
        return f"curves: {', '.join(told)}" if told else ""
    return f"curve {run.target.moved} to the base of the arm" if run.target.moved else ""


SLOWED = 1.001
"""How many times as long as planned a motion takes that was slowed down."""


def controller_name(run: Trajectory) -> str:
    """Name of the controller of a run, without its parameters."""
    return run.controller.partition("(")[0].strip() or "The run"


def ending_text(run: Trajectory) -> str:
    """How and when a run ended, as what is said of its controller."""
    return f"{ENDINGS[run.status]} after {run.steps} step{'s' * (run.steps != 1)}"


def motion_ending_text(motion: Motion) -> str:
    """How and when a motion ended, as what is said of its controller."""
    return f"{ENDINGS[motion.run.status]} after {motion.time[-1]:.4g} s{slowdown_text(motion)}"


def slowdown_text(motion: Motion) -> str:
    """How much a motion was slowed down, after a comma; empty if it was not, or did not get to its end."""
    if motion.plan_time[-1] < motion.planned or not is_slowed(motion):
        return ""
    since = f"from {motion.time[motion.start_index]:.4g} s on " if motion.start_index else ""
    return f", {since}{motion.time_scale:.3g} times as long as planned"


def is_slowed(motion: Motion) -> bool:
    """Whether something slowed a motion down, by more than one sees."""
    return motion.time_scale > SLOWED


# Named places of a motion.

MOST = 8
"""How many places a picture shows at most; of more, some are left out."""

LONGEST_NAME = 22
"""Characters of a name that there is room for."""

SAME = 1e-4
"""How far apart the control points of two postures may be that look the same, in lengths of the arm."""


class Place(NamedTuple):
    """A named place that the motion came to.

    Attributes:
        name: what it is called, not too long.
        row: the row of the motion at which the arm was there.
        color: pale for an early one, dark for a late one.
    """

    name: str
    row: int
    color: str


def shown_places(motion: Motion) -> list[Place]:
    """The places that a motion came to, in order; of very many the first, the last and some in between."""
    reached = [(place.name, place.row) for place in motion.waypoints if place.row is not None]
    if len(reached) > MOST:
        reached = [reached[k] for k in np.round(np.linspace(0, len(reached) - 1, MOST)).astype(int)]
    shares = np.linspace(1.0, 0.0, len(reached))[::-1]  # the only one is the last one
    colors = [palette.in_time(float(share)) for share in shares]
    return [Place(_short(name), row, color) for (name, row), color in zip(reached, colors, strict=True)]


def group_alike(motion: Motion, places: Sequence[Place]) -> list[list[Place]]:
    """The places in order, those together where the arm looked the same."""
    points, apart = motion.run.points, SAME * motion.arm.length
    groups: list[list[Place]] = []
    for place in places:
        for group in groups:
            if np.linalg.norm(points[place.row] - points[group[0].row], axis=1).max() < apart:
                group.append(place)
                break
        else:
            groups.append([place])
    return groups


def _short(name: str) -> str:
    """A name without its middle if it is long: what tells it from others may be at either end."""
    name = " ".join(name.split())
    return (
        name if len(name) <= LONGEST_NAME else f"{name[: LONGEST_NAME - 11].rstrip()}...{name[-8:].lstrip()}"
    )
