"""Where the arm started, where it should be, where it ended, and what was in its way."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from numpy.typing import NDArray

from pinposture.motion import Trajectory
from pinposture.view import palette
from pinposture.view.body import backbone
from pinposture.view.drawn_obstacles import draw_obstacles, surround
from pinposture.view.postures import PosturePanel

Array = NDArray[np.float64]

BETWEEN = 8
"""How many of the postures on the way are drawn where there is something to get around."""

PALE: dict[str, Any] = {"lw": 0.7, "alpha": 0.35, "zorder": 1}
"""How a posture on the way is drawn."""


def plot_postures(run: Trajectory, ax: Axes) -> None:
    """Draw the postures at the start and the end of a run, and the target.

    Args:
        run: the run.
        ax: axes with projection "3d"; for a planar arm also plain ones.

    Raises:
        InvalidValue: plain axes for an arm that moves in space.
    """
    draw_runs([(run, "final posture", palette.controller_color(run.controller))], ax)


def draw_runs(runs: Sequence[tuple[Trajectory, str, str]], ax: Axes) -> None:
    """Draw several runs of one arm towards one target; each distinct start is drawn once.

    Args:
        runs: run, label and colour of each.
        ax: as for `plot_postures`.
    """
    first = runs[0][0]
    panel = PosturePanel(first.arm, ax)
    panel.target(first.target)
    starts: list[Array] = []
    for run, _, _ in runs:
        if not any(np.array_equal(run.q[0], start) for start in starts):
            panel.posture(run.q[0], palette.START, "initial posture" if not starts else "_", width=1.2)
            starts.append(run.q[0])
    for i, (run, label, color) in enumerate(runs):
        panel.posture(run.q[-1], color, label, width=2.2 + 1.2 * (len(runs) - 1 - i))
    if len(runs) == 1 and first.scene is not None:
        draw_way(panel, first, runs[0][2], evenly(first, BETWEEN))
    shown = surround(panel, *(run.scene for run, _, _ in runs))
    panel.finish()
    draw_obstacles(panel, shown)
    ax.legend(loc="lower left", bbox_to_anchor=(0.0, 1.0), fontsize=9, frameon=False, ncols=3)


def evenly(run: Trajectory, count: int) -> NDArray[np.intp]:
    """Rows of `run.q` between which the control points move about equally far, without the first and last."""
    moved = np.linalg.norm(np.diff(run.points, axis=0), axis=2).mean(axis=1)
    way = np.concatenate([[0.0], np.cumsum(moved)])
    rows = np.searchsorted(way, np.linspace(0.0, way[-1], count + 2)[1:-1])
    return np.unique(rows[(rows > 0) & (rows < run.steps)])


def draw_way(panel: PosturePanel, run: Trajectory, color: str, rows: NDArray[np.intp]) -> None:
    """Draw some of the postures between the first and the last of a run.

    Args:
        panel: where to draw.
        run: the run.
        color: colour of the lines.
        rows: which rows of `run.q`, (n,).
    """
    for k, row in enumerate(rows):
        label = "_" if k else "postures on the way"
        panel.line(backbone(run.arm, run.q[row]), color=color, label=label, **PALE)
