"""Single panels of a motion against time; each draws into axes that it is given."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import pairwise
from typing import Any

import numpy as np
from matplotlib.axes import Axes

from pinposture.motion import Motion
from pinposture.motion.rates import limit_shares
from pinposture.view import palette
from pinposture.view.axes import dress_time, mark_end, mark_start, scale_values
from pinposture.view.clearance import explain, mark_escapes, mark_relaxed
from pinposture.view.places import LONGEST, Place

LETTER = 4.6
"""Width of a letter of the names above the axes, on average [pt]."""

LEAST = 18.0
"""How far apart names have to be [pt]."""

ROUNDING = 1e-9
"""Posture error below which there is none to speak of, in lengths of the arm."""

DASHES = (0, (4, 2))


def plot_error(motion: Motion, ax: Axes) -> None:
    """Draw the posture error [m] along the way against time, and what was out of the ordinary in it.

    What is below `ROUNDING` is not shown.

    Args:
        motion: the motion.
        ax: where to draw.
    """
    run, color = motion.run, palette.controller_color(motion.run.controller)
    floor = ROUNDING * motion.arm.length
    values = np.where(run.posture_error > floor, run.posture_error, 0.0)
    marker = "" if run.steps else "o"
    ax.plot(motion.time, values, color=color, lw=1.8, marker=marker)
    dress_time(ax, "posture error [m]")
    scale_values(ax)
    if not values.any():
        ax.set_yticks([0.0])
        note = f"below {floor:.2g} m throughout"
        where: dict[str, Any] = {"transform": ax.transAxes, "ha": "center", "va": "center"}
        ax.text(0.5, 0.5, note, fontsize=9, color=color, backgroundcolor="white", **where)
    else:
        low, high = ax.get_ylim()  # names stand above, and the value at the start has to be below them
        ax.set_ylim(low, high * (high / low) ** 0.12 if low > 0.0 else 1.1 * high)
        if values[0]:
            mark_start(ax, float(values[0]), color, "m")
        if values[-1] and run.steps:
            mark_end(ax, float(motion.time[-1]), float(values[-1]), color, "m")
    mark_escapes(run, ax, motion.time)
    mark_relaxed(run, ax, motion.time)
    if motion.set_out:
        style: dict[str, Any] = {"color": palette.FAINT, "alpha": 0.5, "lw": 0.0, "zorder": 0.4}
        ax.axvspan(0.0, motion.time[motion.set_out], label="coming to the first posture", **style)
    explain(ax, inside=True)


def plot_joint_rates(motion: Motion, ax: Axes) -> None:
    """Draw the largest joint speed and acceleration relative to their limits against time.

    A dashed line is at 1, where a joint is at its limit. What has no limit is left out.

    Args:
        motion: the motion.
        ax: where to draw.
    """
    speeds, accelerations = limit_shares(motion.run)
    marker = "o" if motion.steps == 1 else ""
    most = 1.0
    if accelerations is not None:
        style: dict[str, Any] = {"color": palette.SPARE[0], "lw": 1.0, "label": "acceleration"}
        ax.plot(motion.time, accelerations, **style)
        most = max(most, float(accelerations.max()))
    if speeds is not None:
        style = {"color": palette.SPARE[2], "lw": 1.6, "label": "speed", "marker": marker}
        ax.plot(motion.time[1:] - motion.dt / 2.0, speeds, **style)
        most = max(most, float(speeds.max(initial=0.0)))
    ends = [0.0, float(motion.time[-1]) or 1.0]
    ax.plot(ends, [1.0, 1.0], color=palette.INK, lw=1.0, ls=DASHES, label="limit")
    dress_time(ax, "largest of all joints\n[share of limit]")
    ax.set_ylim(-0.03 * most, 1.12 * most)
    explain(ax, columns=3)


def plot_clock(motion: Motion, ax: Axes) -> None:
    """Draw the time of the plan against the real one, and what it would be if nothing had slowed the motion.

    Args:
        motion: the motion.
        ax: where to draw.
    """
    begun = float(motion.time[motion.set_out])
    plan = [0.0, begun, begun + motion.planned]
    ax.plot(plan, [0.0, 0.0, motion.planned], color=palette.INK, lw=1.0, ls=DASHES, label="as planned")
    label = f"as it was, {motion.slowing:.3g} times as long"
    ax.plot(motion.time, motion.clock, color=palette.SPARE[1], lw=1.6, label=label)
    dress_time(ax, "time of the plan [s]")
    ax.set_xlim(0.0, float(motion.time[-1]) or 1.0)
    explain(ax, columns=2)


def mark_places(places: Sequence[Place], panels: Sequence[Axes], time: Sequence[float]) -> None:
    """Mark moments by lines through panels above each other, their names above the first.

    Args:
        places: the named places of a motion.
        panels: axes against time, from above, dressed.
        time: when each is reached, [s].
    """
    if not places:
        return
    for ax in panels:
        for place, moment in zip(places, time, strict=True):
            where: dict[str, Any] = {"transform": ax.get_xaxis_transform(), "zorder": 1.5, "clip_on": False}
            ax.vlines(moment, 0.0, 1.0, color=place.color, lw=1.0, **where)
    first = panels[0]
    low, high = first.get_xlim()
    width = 72.0 * first.bbox.width / first.figure.dpi / (high - low)  # [pt] to a second
    names = _joined(places, [width * moment for moment in time])
    slanted = any(
        (at - before) < LETTER * (len(name) + len(other)) / 2.0 + LETTER
        for (before, other), (at, name) in pairwise(names)
    )
    for at, name in names:
        style: dict[str, Any] = {"fontsize": 8, "color": palette.INK, "parse_math": False, "va": "bottom"}
        style |= {"rotation": 30, "ha": "left", "rotation_mode": "anchor"} if slanted else {"ha": "center"}
        where = {"xycoords": ("data", "axes fraction"), "textcoords": "offset points"}
        first.annotate(name, (at / width, 1.0), xytext=(0, 3), annotation_clip=False, **where, **style)


def _joined(places: Sequence[Place], moments: Sequence[float]) -> list[tuple[float, str]]:
    """Where to write which names [pt]: those too close together as one, or if that is long the first."""
    names: list[tuple[float, str]] = []
    for place, at in zip(places, moments, strict=True):
        if not names or at - names[-1][0] >= LEAST:
            names.append((at, place.name))
        elif len(names[-1][1]) + len(place.name) < LONGEST:
            names[-1] = names[-1][0], f"{names[-1][1]}, {place.name}"
    return names
