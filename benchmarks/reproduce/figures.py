"""The figures of chapter 6 of the thesis, in its layout.

All runs of a figure have one start and one target, and are given by controller name. The width is that in
print [mm]; None is for the screen.
"""

from __future__ import annotations

import textwrap
from collections.abc import Mapping, Sequence
from itertools import count
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.gridspec import SubplotSpec
from matplotlib.layout_engine import ConstrainedLayoutEngine
from matplotlib.text import Annotation, Text
from matplotlib.ticker import MaxNLocator, NullFormatter

from pinposture.errors import InvalidValue
from pinposture.motion import Run
from pinposture.motion.words import headline
from pinposture.units import ROUNDING, length_text
from pinposture.viz import palette
from pinposture.viz.palette import THEME
from pinposture.viz.panels import (
    format_run_axes,
    mark_projection,
    plot_point_count,
    plot_point_errors,
    plot_points_and_index,
    plot_posture_error,
    run_axis,
)
from pinposture.viz.postures import PosturePanel, draw_intermediate_postures, draw_runs

THESIS_FIGURE_WIDTH = 12.0
"""Width of a figure [inch]; 1200 pixels at the default resolution."""

STACKED_BELOW = 120.0
"""Print width below which panels are stacked [mm]; a journal column has 80 to 90."""

PRINT_TYPE = 7.0
"""Largest type in print [pt]."""

HEAD_TYPE = 9.0
"""Type above a panel on the screen [pt]."""

LETTER_WIDTH = 0.63
"""Mean width of a letter, in its size, and a little more."""

BESIDE_PANEL = 0.5
"""Width that a column needs beside its panels [inch]."""

PRINT_TICKS = 4
"""Number of steps named below a panel in a row in print, at most."""

LINE_HEIGHT = 0.23
"""Height of a line of text in a figure on the screen [inch]."""

TITLE_DISTANCE = 2.0
"""Smallest distance of the text of a value from the title of its panel [pt]."""

SHORT_LABELS = {
    "control point, from base to tip": "control point",
    "active control points": "points",
    "manipulability index": "index",
}
"""Labels of axes where panels are stacked, and lower."""

SHOWN_POSTURES = 14
"""Number of intermediate postures shown; the first ones are closer together than the last."""


def draw_final_postures(runs: Mapping[str, Run], title: str, width: float | None = None) -> Figure:
    """Draw initial posture, target curve and final postures, as Figures 6.3, 6.5 and 6.7.

    A second panel shows only target and final postures, which may be much smaller than the initial one.

    Raises:
        InvalidValue: no run.
    """
    first = _first(runs)
    kind = "3d" if first.arm.dimension == 3 else None
    figure, stacked = _figure(6.0, title, width, 3)
    grid = figure.add_gridspec(2, 1) if stacked else figure.add_gridspec(1, 2, width_ratios=(1.15, 1.0))
    colors = palette.distinct_colors(run.controller for run in runs.values())
    named = [
        (run, f"{name}, final posture", color)
        for (name, run), color in zip(runs.items(), colors, strict=True)
    ]
    whole = figure.add_subplot(grid[0], projection=kind)
    draw_runs(named, whole)
    closer = PosturePanel(first.arm, figure.add_subplot(grid[1], projection=kind))
    closer.target(first.target)
    for i, (run, label, color) in enumerate(named):
        closer.posture(run.q[-1], color, label, width=2.2 + 1.2 * (len(named) - 1 - i))
    closer.finish()
    closer.ax.set_title("final postures alone", fontsize=9, color=THEME.ink)
    if stacked:  # above both panels
        handles, labels = whole.get_legend_handles_labels()
        if (legend := whole.get_legend()) is not None:
            legend.remove()
        columns = 1 if max(map(len, labels)) > _half_line_length(width) // 2 else 2
        style = {"fontsize": PRINT_TYPE, "frameon": False, "ncols": columns}
        figure.legend(handles, labels, loc="outside upper left", **style)
    if closer.spatial:
        layout: Any = figure.get_layout_engine()
        layout.set(rect=(0.0, 0.05, 1.0, 0.95))  # which does not see all labels of spatial axes
        _keep_labels_inside(closer.ax, 8.0 if width is None else 2.0)
        if width is not None:
            _keep_labels_inside(whole, 2.0)
    return _finished(figure, width)


def draw_errors(runs: Mapping[str, Run], title: str, width: float | None = None) -> Figure:
    """Draw control point errors, posture error and number of control points, as Figures 6.4, 6.6 and 6.8.

    Each run has its own row; rows share their scales.

    Raises:
        InvalidValue: no run.
    """
    first = _first(runs)
    figure, stacked = _figure(0.6 + 3.3 * len(runs), title, width, 3)
    grid = figure.add_gridspec(3 * len(runs), 1) if stacked else figure.add_gridspec(len(runs), 3)
    letters = count()
    columns: tuple[list[Axes], ...] = ([], [], [])
    colors = palette.distinct_colors(run.controller for run in runs.values())
    for row, ((name, run), color) in enumerate(zip(runs.items(), colors, strict=True)):
        panels = [figure.add_subplot(grid[3 * row + column]) for column in range(3)]
        plot_point_errors(run, panels[0])
        plot_posture_error(run, panels[1], color)
        plot_point_count(run, panels[2], color)
        heads = ("control point errors", "posture error", "control points used")
        for panel, head, column in zip(panels, heads, columns, strict=True):
            _head(panel, f"{name}: {head}", next(letters))
            column.append(panel)
    for column, name in zip(columns[:2], ("point errors", "posture error"), strict=True):
        _share_values(column, ROUNDING * first.arm.length)
        palette.label_lengths(column, name)
    for column in columns:
        _share_steps(column)
    return _finished(figure, width, [columns[1]])


def draw_planar(
    runs: Mapping[str, Run],
    title: str,
    compared: Mapping[str, Run] | None = None,
    width: float | None = None,
) -> Figure:
    """Draw all panels for runs of a planar arm, as Figures 6.9 to 6.12.

    The top row shows the initial posture and the target. Each run has a row with the control points used in
    each step, the posture error above the number of control points and the manipulability index, and the
    final and intermediate postures. Red dots on the step axis mark steps that switching left to Projection.
    Of the compared runs only the posture error is drawn.

    Raises:
        InvalidValue: no run, or the arm is not planar.
    """
    first = _first(runs)
    if first.arm.dimension != 2:
        raise InvalidValue("runs (arm)", first.arm, "a planar arm")
    compared = compared or {}
    length = _half_line_length(width)
    told = _endings(runs, compared, length)
    columns = 1 if max(map(len, (*runs, *compared))) > length // 3 else 2
    key = (6 + len(runs) + len(compared)) / columns  # rows of the legend
    top_height = max(3.1, LINE_HEIGHT * (5 + key + len(told)))
    figure, stacked = _figure(0.3 + top_height + 3.9 * len(runs), title, width, 5)
    rows = figure.add_gridspec(1 + len(runs), 1, height_ratios=(top_height, *(3.9 for _ in runs)))
    letters = count()
    top = rows[0].subgridspec(2, 1) if stacked else rows[0].subgridspec(1, 2, width_ratios=(1.0, 0.8))
    ax = figure.add_subplot(top[0])
    panel = PosturePanel(first.arm, ax)
    panel.target(first.target)
    panel.posture(first.q[0], THEME.start, "initial posture", width=1.6)
    panel.finish()
    _head(ax, "initial posture and target curve", next(letters))
    handles, labels = ax.get_legend_handles_labels()
    words = figure.add_subplot(top[1])
    finals = []
    shared: list[Axes] = []
    errors: list[Axes] = []
    every = [*compared.values(), *runs.values()]
    distinct = palette.distinct_colors(run.controller for run in every)
    beside = [(name, run, color) for (name, run), color in zip(compared.items(), distinct, strict=False)]
    colors = dict(zip(runs, distinct[len(compared) :], strict=True))
    for row, (name, run) in enumerate(runs.items(), start=1):
        if stacked:
            cells = rows[row].subgridspec(3, 1, height_ratios=(1.0, 2.2, 1.0))
        else:
            cells = rows[row].subgridspec(1, 3, width_ratios=(1.0, 1.0, 1.05))
        ax = figure.add_subplot(cells[0])
        plot_used_points(run, ax, colors[name])
        _head(ax, f"{name}: control points used", next(letters))
        panels = _draw_progress(figure, cells[1], run, name, next(letters), beside, colors[name])
        shared += [ax, *panels]
        errors.append(panels[0])
        finals.append((figure.add_subplot(cells[2]), name, run, next(letters)))
    _share_steps(shared)
    named = dict(zip(labels, handles, strict=True))
    for error in errors:
        for handle, label in zip(*error.get_legend_handles_labels(), strict=True):
            named.setdefault(f"{label}: posture error", handle)
    for ax, name, run, letter in finals:
        _draw_way(run, ax, colors[name])
        _head(ax, f"{name}: final posture", letter)
        for handle, label in zip(*ax.get_legend_handles_labels(), strict=True):
            if label != "final posture":  # it is in the title and has a different colour for each run
                named.setdefault(label, handle)
    _write_key(words, named, told, columns)
    return _finished(figure, width, [[error] for error in errors])


def _keep_labels_inside(ax: Any, distance: float) -> None:
    """Place the labels of spatial axes beside the numbers, that of z at a distance [pt].

    Farther away from a small or slender box, they are cut.
    """
    ax.xaxis.labelpad = 0.0
    ax.yaxis.labelpad = 0.0
    ax.zaxis.labelpad = distance


def _write_key(ax: Axes, named: Mapping[str, Any], told: Sequence[str], columns: int) -> None:
    """Write the legend of handles by their labels, and lines below it, for which there is room."""
    ax.axis("off")
    style: dict[str, Any] = {"fontsize": 9, "color": THEME.ink, "va": "bottom", "linespacing": 1.4}
    ax.text(0.02, 0.0, "\n".join(told), transform=ax.transAxes, in_layout=False, **style)
    style = {"loc": "upper left", "fontsize": 9, "frameon": False, "ncols": columns}
    ax.legend(list(named.values()), list(named), **style).set_in_layout(False)


def _half_line_length(width: float | None) -> int:
    """Return how many letters fit beside the first panel, or below it where panels are stacked."""
    if width is None:
        return _line_length(THESIS_FIGURE_WIDTH / 2.0, HEAD_TYPE)
    return _line_length(width / 25.4 / (1 if width < STACKED_BELOW else 2), PRINT_TYPE)


def _endings(runs: Mapping[str, Run], compared: Mapping[str, Run], length: int) -> list[str]:
    """Return lines of a length [letters] on how runs ended, and which posture error they left."""
    lines = []
    for name, run in runs.items():
        ending, _, extent = headline(run.summary(), name)
        lines += [f"{ending}; {extent};", f"posture error {_change(run)}"]
    lines += [f"{name} alone: posture error {_change(run)}" for name, run in compared.items()]
    return [each for line in lines for each in textwrap.wrap(line, length)]


def plot_used_points(run: Run, ax: Axes, color: str | None = None) -> None:
    """Draw a dot for each active control point in each step."""
    color = palette.controller_color(run.controller) if color is None else color
    steps, points = np.nonzero(run.active)
    style: dict[str, Any] = {"ls": "none", "marker": "o", "mew": 0.0}
    style["ms"] = float(np.clip(260.0 / max(run.steps, 1), 1.2, 4.0))
    x = run_axis(run)
    ax.plot(x[steps + 1], points + 1, color=color, **style)
    format_run_axes(ax, run, "control point, from base to tip")
    ax.set_xlim(0.0, (x[-1] + x[min(1, run.steps)]) or 1.0)
    ax.set_ylim(0.0, run.arm.n_modules + 1.0)
    ax.yaxis.set_major_locator(MaxNLocator(nbins=5, integer=True, min_n_ticks=1))


def _share_values(panels: list[Axes], floor: float) -> None:
    """Give panels a common vertical scale, logarithmic if any of theirs is; smaller values do not count."""
    drawn = [np.asarray(line.get_ydata(), dtype=float) for panel in panels for line in panel.get_lines()]
    positive = np.concatenate([values[values > floor] for values in drawn])
    if not len(positive):
        return
    top = float(positive.max())
    least = max(float(positive.min()), top * 10.0**-palette.FIGURE.most_decades)
    logarithmic = any(panel.get_yscale() == "log" for panel in panels)
    limits = [panel.get_ylim() for panel in panels if not logarithmic or panel.get_yscale() == "log"]
    low = min(each[0] for each in limits)
    high = max(each[1] for each in limits)
    for panel in panels:
        if logarithmic:
            panel.set_yscale("log", nonpositive="clip")
            panel.yaxis.set_minor_formatter(NullFormatter())
            panel.set_ylim(min(low, least / 1.8), max(high, top * (top / least) ** palette.FIGURE.headroom))
        else:
            panel.set_ylim(low, high)


def _share_steps(panels: Sequence[Axes]) -> None:
    """Give panels a common horizontal scale, that of the longest run."""
    longest = max(panel.get_xlim()[1] for panel in panels)
    for panel in panels:
        panel.set_xlim(right=longest)


def _draw_progress(
    figure: Figure,
    place: SubplotSpec,
    run: Run,
    name: str,
    letter: int,
    compared: Sequence[tuple[str, Run, str]],
    color: str,
) -> tuple[Axes, Axes]:
    """Draw posture error above number of points and index; return the axes of both."""
    cells = place.subgridspec(2, 1, height_ratios=(1.35, 1.0))
    error = figure.add_subplot(cells[0])
    points = figure.add_subplot(cells[1])
    for label, other, its_color in compared:
        plot_posture_error(other, error, its_color, label=f"{label} alone")
    plot_posture_error(run, error, color, label=name if compared else None)
    plot_points_and_index(run, points, color)
    low, high = error.get_ylim()
    logarithmic = error.get_yscale() == "log"  # room for text above and below
    error.set_ylim(low * (0.1 if logarithmic else 1.0), high * (4.0 if logarithmic else 1.1))
    _share_steps([error, points])
    if not compared:  # otherwise the other runs may be much longer
        error.set_xlabel("")
        error.tick_params(labelbottom=False)
    if (run.reported("method", "") == "projection").any():
        mark_projection(run, points)
        points.set_xlabel(f"{points.get_xlabel()} (red: steps by Projection)", fontsize=9)
    _head(error, f"{name}: posture error, points, index", letter)
    return error, points


def _draw_way(run: Run, ax: Axes, color: str) -> None:
    """Draw the final posture and the target, with some intermediate postures."""
    panel = PosturePanel(run.arm, ax)
    steps = np.unique(np.geomspace(1, max(run.steps, 1), SHOWN_POSTURES).round().astype(np.intp))
    draw_intermediate_postures(panel, run, color, steps[steps < run.steps])
    panel.target(run.target)
    panel.posture(run.q[-1], color, "final posture", width=2.0)
    panel.finish()


def _figure(height: float, title: str, width: float | None, columns: int) -> tuple[Figure, bool]:
    """Create an empty figure of a height [inch] on the screen, where alone the title is shown.

    Also return whether its columns, the number of panels side by side, are stacked instead.
    """
    layout = ConstrainedLayoutEngine(w_pad=0.08, h_pad=0.08, wspace=0.03, hspace=0.03)
    if width is not None:
        inches, stacked = width / 25.4, width < STACKED_BELOW
        height *= 1.2 * inches / THESIS_FIGURE_WIDTH * (columns if stacked else 1)
        return Figure(figsize=(inches, height), layout=layout), stacked
    figure = Figure(figsize=(THESIS_FIGURE_WIDTH, height), layout=layout)
    text = "\n".join(textwrap.fill(line, 150) for line in title.splitlines())
    figure.suptitle(text, fontsize=10, x=0.012, ha="left", color=THEME.ink, parse_math=False)
    return figure, False


def _finished(figure: Figure, width: float | None, errors: Sequence[Sequence[Axes]] = ()) -> Figure:
    """Return the figure with titles that fit; for print, with the font size that journals require.

    Args:
        figure: the figure.
        width: its width in print [mm]; None: for the screen.
        errors: panels of errors, in groups that share a scale; their values stay below the titles.
    """
    stacked = width is not None and width < STACKED_BELOW
    size = HEAD_TYPE if width is None else PRINT_TYPE
    length = _line_length(figure.get_figwidth() / (1 if stacked else 3), size)
    for ax in figure.axes:
        title = textwrap.fill(ax.get_title(loc="left"), length, break_long_words=False)
        ax.set_title(title, loc="left", fontsize=size, color=THEME.ink)
        if stacked:
            ax.set_ylabel(SHORT_LABELS.get(ax.get_ylabel(), ax.get_ylabel()))
        elif width is not None:
            ax.locator_params(axis="x", nbins=PRINT_TICKS)
        if width is not None:
            ax.tick_params(labelsize=PRINT_TYPE - 1.0)
            for text in ax.findobj(Text):
                text.set_fontsize(min(text.get_fontsize(), PRINT_TYPE))
    if errors:
        figure.draw_without_rendering()  # lays the panels out
    for panels in errors:
        high = max(_top_below_title(ax) for ax in panels)
        for ax in panels:
            ax.set_ylim(top=high)
    return figure


def _line_length(width: float, size: float) -> int:
    """Return how many letters of a size [pt] fit into a column of a width [inch]."""
    return int(72.0 * (width - BESIDE_PANEL) / (LETTER_WIDTH * size))


def _top_below_title(ax: Axes) -> float:
    """Return the end of a vertical axis with which all texts of values stay below the title."""
    scale = ax.yaxis.get_transform()
    low, high = scale.transform(ax.get_ylim())
    box = ax.get_window_extent()
    distance = TITLE_DISTANCE / 72.0 * ax.figure.dpi
    end = high
    for text in ax.texts:
        if not isinstance(text, Annotation):
            continue
        place = scale.transform(text.xy[1]) if text.xycoords is ax.transData else low
        above = (text.get_window_extent().y1 + distance - ax.transData.transform(text.xy)[1]) / box.height
        if place > low and above < 1.0:
            end = max(end, low + (place - low) / (1.0 - above))
    return float(scale.inverted().transform(end))


def _change(run: Run) -> str:
    return " -> ".join(length_text(run.posture_error[row], run.arm.length) for row in (0, -1))


def _head(ax: Axes, text: str, letter: int) -> None:
    ax.set_title(f"({chr(ord('a') + letter)}) {text}", loc="left")


def _first(runs: Mapping[str, Run]) -> Run:
    if not runs:
        raise InvalidValue("runs", dict(runs), "at least one run")
    return next(iter(runs.values()))
