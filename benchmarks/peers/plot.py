"""Step time against DOF, every method named at the end of its line."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import matplotlib as mpl
import numpy as np

from benchmarks.peers import METHODS, REFERENCE
from benchmarks.peers.report import step_time

mpl.use("Agg")
import matplotlib.pyplot as plt  # after the backend is chosen

OURS, REFERENCE_COLOUR, PEER = "#5b8db8", "#c8541e", "#777777"

ROOM = 0.045
"""Distance between two names, as a share of the height of the plot."""


def save(found: dict[str, Any], path: Path) -> None:
    """Draw the median time of a step of each method against DOF, on logarithmic axes."""
    figure, axes = plt.subplots(figsize=(9.0, 6.0), layout="constrained")
    ends = []
    for name, entry in METHODS.items():
        points = [(each["dof"], step_time(each)) for each in found["results"] if each["method"] == name]
        known = [(size, time) for size, time in points if time]
        if not known:
            continue
        ours = entry.environment == "ours" and entry.home == "ours"
        colour = REFERENCE_COLOUR if name == REFERENCE else OURS if ours else PEER
        width = 2.4 if name == REFERENCE else 1.2
        line = "-" if ours else "--"
        axes.plot(*zip(*known, strict=True), line, color=colour, linewidth=width, marker="o", markersize=3.5)
        ends.append((*known[-1], entry.label, colour))
    axes.set(xscale="log", yscale="log", xlabel="DOF, two a module", ylabel="median time of one step [us]")
    axes.set_title("One control step, one thread (solid: pinposture; dashed: others)", fontsize=11, pad=16)
    axes.grid(True, which="major", color="#e4e4e4")
    sizes = sorted({each["dof"] for each in found["results"]})
    axes.set_xticks(sizes, [str(size) for size in sizes])
    axes.minorticks_off()
    axes.spines[["top", "right"]].set_visible(False)
    axes.set_ylim(top=4.0 * axes.get_ylim()[1])  # room for names that are moved up
    _label(axes, ends)
    figure.savefig(path, dpi=150)
    plt.close(figure)


def _label(axes: Any, ends: list[tuple[int, float, str, str]]) -> None:
    """Names beside the last points of the lines, moved apart where lines end together."""
    low, high = np.log10(axes.get_ylim())
    for size in {end[0] for end in ends}:
        column = sorted((end for end in ends if end[0] == size), key=lambda end: end[1])
        at = [(np.log10(end[1]) - low) / (high - low) for end in column]
        for _ in range(200):
            for i in range(len(at) - 1):
                lack = ROOM - (at[i + 1] - at[i])
                if lack > 0:
                    at[i], at[i + 1] = at[i] - lack / 2, at[i + 1] + lack / 2
        for (_, time, label, colour), height in zip(column, at, strict=True):
            place = (size * 1.1, 10 ** (low + height * (high - low)))
            pointer = {"arrowstyle": "-", "color": "#cccccc", "linewidth": 0.6}
            axes.annotate(
                label, (size, time), place, color=colour, fontsize=8.5, va="center", arrowprops=pointer
            )
    left, right = axes.get_xlim()
    axes.set_xlim(left, right * 1.25)
