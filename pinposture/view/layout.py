"""How figures are laid out: postures on the left, panels that share an axis on the right, words around."""

from __future__ import annotations

import textwrap
from collections.abc import Sequence

from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.layout_engine import ConstrainedLayoutEngine

from pinposture.arm import Arm
from pinposture.view import palette

WIDTH, HEIGHT = 12.0, 7.2
"""Size of a figure [inch]; 1200 pixels wide at the default resolution."""


def lay_out(arm: Arm, rows: int) -> tuple[Figure, Axes, list[Axes]]:
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
