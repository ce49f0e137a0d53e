"""The figure of a simulated motion: joint errors, mean point errors and torques."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from numpy.typing import NDArray

from pinposture.motion.words import title
from pinposture.sim import Simulation
from pinposture.units import ROUNDING
from pinposture.viz import palette
from pinposture.viz.palette import THEME
from pinposture.viz.panels import add_legend, marker


def plot_simulation(simulation: Simulation) -> Figure:
    """Plot a simulated motion in one figure: joint errors, mean point errors and torques over time.

    Each joint has a line, darkest at the base. Torques are relative to their limits, which grey lines mark;
    if no joint has a limit, they are in N m (N for prismatic joints).

    Args:
        simulation: the simulated motion.

    Returns:
        A figure, 1200 pixels wide; `figure.savefig(path)` writes it. It is not shown or registered with
        pyplot.
    """
    figure = Figure(figsize=(palette.FIGURE.width, palette.FIGURE.height), layout="constrained")
    panels: Sequence[Axes] = figure.subplots(3, 1, sharex=True)
    _plot_joints(simulation, simulation.joint_error, panels[0])
    slides = simulation.arm.slides
    palette.format_time_axes(panels[0], f"joint error [{_unit(simulation, slides, 'rad', 'm')}]")
    panels[0].set_ylim(bottom=0.0)
    _plot_point_errors(simulation, panels[1])
    _plot_torques(simulation, panels[2])
    palette.share_axis(panels)
    count = len(simulation.arm.columns)
    palette.add_colorbar([panels[0], panels[2]], count, "joint, from base to tip", pad=0.01, aspect=40)
    palette.add_title(figure, [title(simulation.summary(), "The simulated arm")])
    servos = simulation.servos
    compensated = f"{'with' if servos.gravity_compensation else 'without'} gravity compensation"
    described = f"servos of {servos.frequency:g} Hz, damping ratio {servos.damping:g}, {compensated}"
    palette.add_footnote(figure, described)
    return figure


def _plot_point_errors(simulation: Simulation, ax: Axes) -> None:
    """Plot the mean point error relative to the set points and, if any, to the targets."""
    lines = {"to the set points": (simulation.point_errors.mean(axis=1), THEME.final)}
    if simulation.target_errors is not None and simulation.weights is not None:
        targeted = np.maximum((simulation.weights > 0.0).sum(axis=1), 1)
        lines["to the targets"] = (simulation.target_errors.sum(axis=1) / targeted, THEME.target)
    for label, (values, color) in lines.items():
        ax.plot(
            simulation.time, values, color=color, lw=1.8, label=label, marker=marker(len(simulation.time))
        )
    palette.format_time_axes(ax, "mean point error")
    floor = ROUNDING * simulation.arm.length
    palette.scale_values(ax, floor)
    palette.label_lengths([ax], "mean point error")
    for values, color in lines.values():
        palette.mark_value(ax, simulation.time[-1], float(values[-1]), color, "end", floor)
    add_legend(ax)


def _plot_torques(simulation: Simulation, ax: Axes) -> None:
    """Plot the torque of each servo, relative to its limit if there are limits."""
    limited = np.isfinite(simulation.torque_limits)
    if not np.any(limited[simulation.arm.columns]):
        _plot_joints(simulation, simulation.torques, ax)
        slides = np.array([not drive.turns for drive in simulation.arm.drives])
        palette.format_time_axes(ax, f"torque [{_unit(simulation, slides, 'N m', 'N')}]")
        return
    shares = 100.0 * simulation.torques / simulation.torque_limits
    _plot_joints(simulation, shares, ax)
    palette.format_time_axes(ax, "torque [% of limit]")
    if float(np.abs(shares).max()) > 50.0:
        for limit in (-100.0, 100.0):
            ax.axhline(limit, color=THEME.rest, lw=1.0, zorder=0)
    if not np.all(limited):
        ax.set_title("joints without a limit at 0", fontsize=8, loc="right", color=THEME.ink)


def _plot_joints(simulation: Simulation, values: NDArray[np.float64], ax: Axes) -> None:
    colors, norm = palette.colors_along(len(simulation.arm.columns))
    symbol = marker(len(simulation.time))
    for number, column in enumerate(simulation.arm.columns, start=1):
        ax.plot(simulation.time, values[:, column], color=colors(norm(number)), lw=1.0, marker=symbol, ms=3)


def _unit(simulation: Simulation, slides: NDArray[np.bool_], turning: str, sliding: str) -> str:
    shown = slides[simulation.arm.columns]
    units = ((turning, not shown.all()), (sliding, shown.any()))
    return " or ".join(unit for unit, used in units if used)
