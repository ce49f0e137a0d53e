"""The study of following the leader as a picture: deviation against curvature."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

from pinposture.errors import InvalidValue
from pinposture.study.leader import ARMS, SHAPES, Following

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

WIDTH, HEIGHT = 12.0, 4.6
"""Size of a figure [inch]."""

TICKS = (0.02, 0.05, 0.1, 0.2, 0.5, 1.0, 2.0)
"""Ticks of the axis of deviations [%]."""

MARKERS = {"closest": "o", "sequential": "^"}


def draw_leader(found: Sequence[Following]) -> Figure:
    """Draw what `study_leader` found.

    A panel for each shape of path: the largest distance of any part of the arm against curvature times module
    length, and the sagitta of a module whose ends are on the path.

    Args:
        found: the results; paths that were refused are left out.

    Raises:
        InvalidValue: no result.
    """
    # Here, because matplotlib takes longer to import than everything else together.
    from matplotlib.figure import Figure
    from matplotlib.layout_engine import ConstrainedLayoutEngine

    if not found:
        raise InvalidValue("found", list(found), "at least one result")
    figure = Figure(figsize=(WIDTH, HEIGHT), layout=ConstrainedLayoutEngine(w_pad=0.1, h_pad=0.09))
    shapes = [shape for shape in SHAPES if any(each.shape == shape for each in found)]
    panels = figure.subplots(1, len(shapes), sharey=True, squeeze=False)[0]
    for ax, shape in zip(panels, shapes, strict=True):
        _draw(ax, [each for each in found if each.shape == shape], shape)
    panels[0].set_ylabel("farthest part of the arm [% of its length]", fontsize=9)
    return figure


def _draw(ax: Axes, found: Sequence[Following], shape: str) -> None:
    from pinposture.viz import palette

    colors = dict(zip(ARMS, (palette.START, palette.FINAL, palette.CONTROLLERS["projection"]), strict=True))
    bound = sorted({(each.bending, each.sagitta) for each in found})
    ax.plot(*zip(*bound, strict=True), color=palette.REST, ls="--", lw=1.0, label="sagitta of a module")
    for arm, method in dict.fromkeys((each.arm, each.method) for each in found):
        own = [each for each in found if (each.arm, each.method) == (arm, method)]
        values = [(each.bending, each.body) for each in own if each.body is not None]
        if values:
            line = "-" if method == "closest" else ":"
            style: dict[str, Any] = {"color": colors[arm], "ls": line, "marker": MARKERS[method]}
            ax.plot(*zip(*values, strict=True), ms=4.0, lw=1.3, label=f"{arm}, {method}", **style)
    ax.set_xscale("log")
    ax.set_yscale("log")
    ticks = sorted({each.bending for each in found})
    ax.set_xticks(ticks, [f"{tick:g}" for tick in ticks])
    ax.set_yticks(TICKS, [f"{tick:g}" for tick in TICKS])
    ax.minorticks_off()
    ax.set_xlabel("curvature times module length [rad]", fontsize=9)
    ax.set_title(shape, fontsize=10, color=palette.INK)
    ax.tick_params(labelsize=8)
    ax.spines[["top", "right"]].set_visible(False)
    ax.grid(color=palette.FAINT, lw=0.6)
    ax.legend(fontsize=7, frameon=False, loc="upper left")
