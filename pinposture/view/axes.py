"""How axes against steps or time look: scales, ticks, labels."""

from __future__ import annotations

import numpy as np
from matplotlib.axes import Axes
from matplotlib.ticker import MaxNLocator, NullFormatter
from numpy.typing import NDArray

from pinposture.view import palette

DECADES = 1.5
"""Range of values, in powers of ten, from which on a logarithmic axis shows more than a linear one."""

DEEPEST = 12.0
"""Powers of ten below the largest value that a logarithmic axis shows at most; below that is rounding."""


def dress_steps(ax: Axes, label: str) -> None:
    """Give axes against steps, from 0 to the last step drawn, their ticks, grid and labels."""
    steps = _dress(ax, "step", label)
    ax.set_xlim(0.0 if steps else -1.0, max(steps, 1.0))
    ax.xaxis.set_major_locator(MaxNLocator(nbins=8, integer=True, min_n_ticks=1))


def dress(ax: Axes, label: str, time: NDArray[np.float64] | None) -> None:
    """Dress axes against steps, or against time if there is one."""
    if time is None:
        dress_steps(ax, label)
    else:
        dress_time(ax, label)


def dress_time(ax: Axes, label: str) -> None:
    """Give axes against time, from 0 to the last moment drawn, their ticks, grid and labels."""
    end = _dress(ax, "time [s]", label)
    ax.set_xlim(0.0 if end else -1.0, end or 1.0)
    ax.xaxis.set_major_locator(MaxNLocator(nbins=8, min_n_ticks=1))


def _dress(ax: Axes, across: str, label: str) -> float:
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
