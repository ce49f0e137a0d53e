"""A motion in time in one figure: the postures on its way, and how it went."""

from __future__ import annotations

from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from pinposture.motion import Motion
from pinposture.motion.rates import limit_shares
from pinposture.view import palette
from pinposture.view.clearance import has_clearance, plot_clearance
from pinposture.view.drawn_obstacles import draw_obstacles, surround
from pinposture.view.layout import footnote, lay_out, share_axis, title
from pinposture.view.places import alike, shown_places
from pinposture.view.postures import PosturePanel
from pinposture.view.run_postures import BETWEEN, draw_way, evenly
from pinposture.view.time_panels import mark_places, plot_clock, plot_error, plot_joint_rates
from pinposture.view.words import controller_name, ending_in_time, is_slowed, moved_curves

FEW = 3
"""So many named places tell what the way was like; where there are fewer, postures in between are drawn."""

LETTERS, HANDLE = 84, 8
"""Letters that fit beside each other above the postures, and the room in letters that a handle takes."""

MOST_DETOURS = 2
"""Detours that a title has room for."""


def plot_motion(motion: Motion) -> Figure:
    """Tell a motion in time in one figure; see `pinposture.plot`.

    Args:
        motion: the motion.

    Returns:
        A figure, 1200 pixels wide.
    """
    run, time = motion.run, motion.time
    rated = any(share is not None for share in limit_shares(motion.run))
    near = has_clearance(run)
    figure, postures, panels = lay_out(motion.arm, 1 + rated + is_slowed(motion) + near)
    plot_places(motion, postures)
    left = iter(panels)
    error = next(left)
    plot_error(motion, error)
    if rated:
        plot_joint_rates(motion, next(left))
    if is_slowed(motion):
        plot_clock(motion, next(left))
    if near:
        plot_clearance(run, next(left), time=time)
    places = shown_places(motion)
    mark_places(places, panels, [float(time[place.row]) for place in places])
    share_axis(panels)
    detours = [f"Detour: {text}" for text in motion.detours[:MOST_DETOURS]]
    if len(motion.detours) > MOST_DETOURS:
        detours.append(f"and {len(motion.detours) - MOST_DETOURS} more")
    title(figure, [f"{controller_name(run)} {ending_in_time(motion)}: {run.reason}", *detours])
    footnote(figure, "; ".join(filter(None, [moved_curves(motion), run.controller])))
    figure.draw_without_rendering()  # the layout of a high legend settles in the second drawing only
    return figure


def plot_places(motion: Motion, ax: Axes) -> None:
    """Draw the postures that a motion took at its named places, from pale to dark, and the targets there.

    Args:
        motion: the motion.
        ax: axes with projection "3d"; for a planar arm also plain ones.

    Raises:
        InvalidValue: plain axes for an arm that moves in space.
    """
    run, panel = motion.run, PosturePanel(motion.arm, ax)
    groups = alike(motion, shown_places(motion))
    rows = [group[0].row for group in groups]
    targets = [motion.targets[row][motion.asked[row]] for row in rows or [motion.steps]]
    rings: dict[str, Any] = {"ls": "none", "marker": "o", "ms": 4.6, "mfc": "white", "mew": 0.8}
    panel.line(np.vstack(targets), label="target points", zorder=3, mec=palette.TARGET, **rings)
    if motion.set_out or not groups:
        panel.posture(run.q[0], palette.START, "initial posture", width=1.2)
    for group in groups:
        label = "; ".join(f"{place.name}, {motion.time[place.row]:.3g} s" for place in group)
        panel.posture(run.q[group[0].row], group[0].color, label, 2.2)
    if not groups:
        panel.posture(run.q[-1], palette.controller_color(run.controller), "final posture", 2.2)
    if run.scene is not None or len(groups) < FEW:
        draw_way(panel, run, palette.controller_color(run.controller), evenly(run, BETWEEN))
    shown = surround(panel, run.scene)
    panel.finish()
    draw_obstacles(panel, shown)
    _explain(ax)


def _explain(ax: Axes) -> None:
    """Write the legend above the axes, in as many columns as fit."""
    handles, labels = ax.get_legend_handles_labels()
    for columns in (3, 2, 1):
        rows = -(-len(labels) // columns)
        widest = [max(map(len, labels[k : k + rows])) for k in range(0, len(labels), rows)]
        if sum(widest) + HANDLE * columns <= LETTERS:
            break
    where: dict[str, Any] = {"loc": "lower left", "bbox_to_anchor": (0.0, 1.0), "ncols": columns}
    legend = ax.legend(handles, labels, fontsize=9, frameon=False, **where)
    for text in legend.get_texts():
        text.set_parse_math(False)
