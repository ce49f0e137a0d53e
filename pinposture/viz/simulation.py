"""A simulated motion in one figure: how far joints and posture are off, and what the servos gave."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from numpy.typing import NDArray

from pinposture.sim import Simulation
from pinposture.viz import palette
from pinposture.viz.axes import (
    HEIGHT,
    WIDTH,
    add_colorbar,
    colors_along,
    footnote,
    format_time_axes,
    mark_end,
    scale_values,
    share_axis,
    title,
)

Array = NDArray[np.float64]

DECADES = 4.0
"""Powers of ten below the largest joint error that are shown."""


def plot_simulation(simulation: Simulation) -> Figure:
    """Tell a simulated motion in one figure: joint errors, posture error and torques over time.

    Each joint has a line, darkest at the base. Torques are relative to their limits, which a grey line marks;
    where no joint has a limit they are in N m (N where joints slide).

    Args:
        simulation: the simulated motion.

    Returns:
        A figure, 1200 pixels wide; `figure.savefig(path)` writes it. It is not shown, and pyplot does not
        know of it.
    """
    figure = Figure(figsize=(WIDTH, HEIGHT), layout="constrained")
    panels: Sequence[Axes] = figure.subplots(3, 1, sharex=True)
    plot_joint_error(simulation, panels[0])
    plot_posture_errors(simulation, panels[1])
    plot_torques(simulation, panels[2])
    share_axis(panels)
    count = len(simulation.arm.columns)
    add_colorbar([panels[0], panels[2]], count, "joint, from base to tip", pad=0.01, aspect=40)
    strength = float(np.linalg.norm(simulation.gravity))
    weight = f"gravity {strength:.4g} m/s²" if strength else "no gravity"
    title(figure, [f"{simulation.loop} loop, {weight}: {simulation.status}, {simulation.reason}"])
    footnote(figure, str(simulation.servos))
    return figure


def plot_joint_error(simulation: Simulation, ax: Axes) -> None:
    """Draw how far each joint is from its set-point.

    Args:
        simulation: the simulated motion.
        ax: where to draw.
    """
    _plot_joints(simulation, simulation.joint_error, ax)
    format_time_axes(ax, f"joint error [{_unit(simulation, 'rad', 'm')}]")
    scale_values(ax)
    low, high = ax.get_ylim()
    if ax.get_yscale() == "log":  # where an error changes sign it falls deep, which means nothing
        ax.set_ylim(max(low, high * 10.0**-DECADES), high)


def plot_posture_errors(simulation: Simulation, ax: Axes) -> None:
    """Draw the posture error towards the set-points, and towards the targets where there are any.

    Args:
        simulation: the simulated motion.
        ax: where to draw.
    """
    lines = {"to the set-points": (simulation.posture_error, palette.FINAL)}
    if simulation.target_errors is not None:
        lines["to the targets"] = (simulation.target_errors.sum(axis=1), palette.TARGET)
    marker = "o" if len(simulation.time) == 1 else ""
    for label, (values, color) in lines.items():
        ax.plot(simulation.time, values, color=color, lw=1.8, label=label, marker=marker)
    format_time_axes(ax, "posture error [m]")
    scale_values(ax)
    for values, color in lines.values():
        mark_end(ax, simulation.time[-1], float(values[-1]), color, "m")
    if len(lines) > 1:
        ax.legend(fontsize=8, frameon=False, loc="upper right")


def plot_torques(simulation: Simulation, ax: Axes) -> None:
    """Draw what each servo gave, relative to its limit where there are limits.

    Args:
        simulation: the simulated motion.
        ax: where to draw.
    """
    limited = np.isfinite(simulation.torque_limits)
    if np.any(limited[simulation.arm.columns]):
        _plot_joints(simulation, 100.0 * simulation.torques / simulation.torque_limits, ax)
        format_time_axes(ax, "torque [% of limit]")
        largest = float(np.abs(100.0 * simulation.torques / simulation.torque_limits).max())
        for side in (-100.0, 100.0) if largest > 50.0 else ():
            ax.axhline(side, color=palette.REST, lw=1.0, zorder=0)
        if not np.all(limited):
            ax.set_title("joints without a limit at 0", fontsize=8, loc="right", color=palette.INK)
    else:
        _plot_joints(simulation, simulation.torques, ax)
        format_time_axes(ax, f"torque [{_unit(simulation, 'N m', 'N')}]")


def _plot_joints(simulation: Simulation, values: Array, ax: Axes) -> None:
    columns = simulation.arm.columns
    colors, norm = colors_along(len(columns))
    marker = "o" if len(simulation.time) == 1 else ""
    for number, column in enumerate(columns, start=1):
        ax.plot(simulation.time, values[:, column], color=colors(norm(number)), lw=1.0, marker=marker, ms=3)


def _unit(simulation: Simulation, turning: str, sliding: str) -> str:
    slides = simulation.arm.slides[simulation.arm.columns]
    return " or ".join(
        unit for unit, there in ((turning, not slides.all()), (sliding, slides.any())) if there
    )
