"""What the figures of several studies share."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from benchmarks.harness import Row, distinct
from benchmarks.studies.runs import MAX_STEPS, STEP, telling
from pinposture.errors import InvalidValue

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure


WIDTH = 12.0
"""Width of a figure [inch]; 1200 pixels at the default resolution."""
PATH = "path of the control points / direct distance"


def present(rows: Sequence[Row]) -> tuple[list[str], list[str]]:
    """Return the names of the arms and of the controllers."""
    if not rows:
        raise InvalidValue("rows", list(rows), "at least one run")
    return distinct(row.arm for row in rows), distinct(row.controller for row in rows)


def new_figure(height: float, runs: Sequence[Row] = ()) -> Figure:
    """Create a figure of a height [inch], with the number of runs as its title."""
    # Imported here because matplotlib is slow to import.
    from matplotlib.figure import Figure
    from matplotlib.layout_engine import ConstrainedLayoutEngine

    from pinposture.viz.palette import add_title

    figure = Figure(figsize=(WIDTH, height), layout=ConstrainedLayoutEngine(w_pad=0.1, h_pad=0.09))
    if runs:
        add_title(figure, [f"{len(runs)} runs, |dq| <= {STEP:g} rad per step, at most {MAX_STEPS} steps"])
    return figure


def side_by_side(controllers: Sequence[str]) -> list[tuple[str, str, float, float]]:
    """Return each controller with its colour, its horizontal offset and its width."""
    from pinposture.viz.palette import distinct_colors

    width = 0.8 / len(controllers)
    places = (np.arange(len(controllers)) - (len(controllers) - 1) / 2.0) * width
    return [
        (name, color, float(place), width)
        for name, color, place in zip(controllers, distinct_colors(controllers), places, strict=True)
    ]


def draw_paths(
    ax: Axes,
    rows: Sequence[Row],
    groups: Sequence[str],
    name: Callable[[Row], str],
    controllers: Sequence[str],
) -> None:
    """Draw boxes of the path length ratios of each controller, side by side in each group."""
    for controller, color, offset, width in side_by_side(controllers):
        drawn: dict[int, list[float]] = {}
        for row in rows:
            if row.controller == controller and telling(row):
                drawn.setdefault(groups.index(name(row)), []).append(row.path)
        style: dict[str, Any] = {"color": color, "linewidth": 1.2}
        if drawn:
            ax.boxplot(
                list(drawn.values()),
                positions=[place + offset for place in drawn],
                widths=0.75 * width,
                whis=(10, 90),
                showfliers=False,
                patch_artist=True,
                boxprops={"facecolor": "white", "edgecolor": color, "linewidth": 1.2},
                medianprops={"color": color, "linewidth": 2.2},
                whiskerprops=style,
                capprops=style,
                manage_ticks=False,
            )
        ax.plot([], [], color=color, lw=4, label=controller)
    ax.set_xticks(range(len(groups)), groups)
    ax.set_xlim(-0.5, len(groups) - 0.5)
    ax.set_yscale("log")
    _plain_numbers(ax)


def _plain_numbers(ax: Axes) -> None:
    """Set plain-number ticks on a short logarithmic axis that begins at 1."""
    from matplotlib.ticker import FixedLocator, FormatStrFormatter, NullFormatter, NullLocator

    top = max(1.5, 1.05 * ax.get_ylim()[1])
    ax.set_ylim(0.97, top)
    ax.yaxis.set_major_locator(FixedLocator([t for t in (1, 1.2, 1.5, 2, 3, 5, 10, 20, 50, 100) if t <= top]))
    ax.yaxis.set_major_formatter(FormatStrFormatter("%g"))
    ax.yaxis.set_minor_locator(NullLocator())
    ax.yaxis.set_minor_formatter(NullFormatter())


def dress(ax: Axes, title: str, label: str) -> None:
    """Add title, label of the vertical axis, grid and legend."""
    from pinposture.viz import palette
    from pinposture.viz.palette import THEME

    ax.set_title(title, fontsize=9, color=THEME.ink)
    ax.set_ylabel(label, fontsize=9)
    palette.add_grid(ax)
    ax.grid(visible=False, axis="x")
    ax.legend(fontsize=7, frameon=False, ncols=3, loc="upper left")
