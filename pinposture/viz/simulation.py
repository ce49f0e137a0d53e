"""A simulated motion in one figure: how far joints and posture are off, and what the servos gave."""

from __future__ import annotations

import textwrap
from collections.abc import Sequence
from typing import Protocol

import numpy as np
from matplotlib.axes import Axes
from matplotlib.cm import ScalarMappable
from matplotlib.colors import LinearSegmentedColormap, Normalize
from matplotlib.figure import Figure
from matplotlib.ticker import MaxNLocator
from numpy.typing import NDArray

from pinposture.arm import Arm
from pinposture.viz import palette
from pinposture.viz.axes import mark_end, scale_values

Array = NDArray[np.float64]

WIDTH, HEIGHT = 12.0, 7.2
"""Size of the figure [inch]; 1200 pixels wide at the default resolution."""

DECADES = 4.0
"""Powers of ten below the largest joint error that are shown."""


class SimulatedMotion(Protocol):
    """What is drawn of a simulation; `pinposture.sim.Simulation` has it all."""

    @property
    def arm(self) -> Arm:
        """The arm."""

    @property
    def loop(self) -> str:
        """Whether the loop was "open" or "closed"."""

    @property
    def status(self) -> str:
        """How it ended, in a word."""

    @property
    def reason(self) -> str:
        """How it ended, in words."""

    @property
    def servos(self) -> object:
        """The servos; shown as they describe themselves."""

    @property
    def gravity(self) -> Array:
        """Acceleration of free fall, (3,) [m/s^2]."""

    @property
    def time(self) -> Array:
        """When each row is, (N,) [s]."""

    @property
    def joint_error(self) -> Array:
        """How far each joint is from its set-point, (N, nv) [rad or m]."""

    @property
    def posture_error(self) -> Array:
        """Sum of the distances of the control points from where set-points have them, (N,) [m]."""

    @property
    def target_errors(self) -> Array | None:
        """Distance of each control point from its target, (N, m) [m]; None without targets."""

    @property
    def torques(self) -> Array:
        """What the servos gave, (N, nv) [N m or N]."""

    @property
    def torque_limits(self) -> Array:
        """The most that they could give, (nv,); infinite without a limit."""


def plot_simulation(simulation: SimulatedMotion) -> Figure:
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
    panels[-1].set_xlabel("time [s]", fontsize=9)
    moving = _moving(simulation)
    colors, norm = _along(len(moving))
    bar = figure.colorbar(ScalarMappable(norm, colors), ax=[panels[0], panels[2]], pad=0.01, aspect=40)
    bar.set_label("joint, from base to tip", fontsize=9)
    bar.set_ticks(MaxNLocator(nbins=8, integer=True, min_n_ticks=1) if len(moving) > 1 else [1])
    bar.ax.tick_params(labelsize=8)
    bar.outline.set_visible(False)
    weight = (
        f"gravity {np.linalg.norm(simulation.gravity):.4g} m/s²" if simulation.gravity.any() else "no gravity"
    )
    title = f"{simulation.loop} loop, {weight}: {simulation.status}, {simulation.reason}"
    figure.suptitle(
        textwrap.fill(title, 145), fontsize=10, x=0.012, ha="left", color=palette.INK, parse_math=False
    )
    parameters = textwrap.fill(textwrap.shorten(str(simulation.servos), 500), 190)
    figure.supxlabel(parameters, fontsize=8, x=0.012, ha="left", color=palette.QUIET, parse_math=False)
    return figure


def plot_joint_error(simulation: SimulatedMotion, ax: Axes) -> None:
    """Draw how far each joint is from its set-point.

    Args:
        simulation: the simulated motion.
        ax: where to draw.
    """
    _plot_joints(simulation, simulation.joint_error, ax)
    _dress(simulation, ax, f"joint error [{_unit(simulation, 'rad', 'm')}]")
    scale_values(ax)
    low, high = ax.get_ylim()
    if ax.get_yscale() == "log":  # where an error changes sign it falls deep, which means nothing
        ax.set_ylim(max(low, high * 10.0**-DECADES), high)


def plot_posture_errors(simulation: SimulatedMotion, ax: Axes) -> None:
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
    _dress(simulation, ax, "posture error [m]")
    scale_values(ax)
    for values, color in lines.values():
        mark_end(ax, simulation.time[-1], float(values[-1]), color, "m")
    if len(lines) > 1:
        ax.legend(fontsize=8, frameon=False, loc="upper right")


def plot_torques(simulation: SimulatedMotion, ax: Axes) -> None:
    """Draw what each servo gave, relative to its limit where there are limits.

    Args:
        simulation: the simulated motion.
        ax: where to draw.
    """
    limited = np.isfinite(simulation.torque_limits)
    if np.any(limited[_moving(simulation)]):
        _plot_joints(simulation, 100.0 * simulation.torques / simulation.torque_limits, ax)
        _dress(simulation, ax, "torque [% of limit]")
        largest = float(np.abs(100.0 * simulation.torques / simulation.torque_limits).max())
        for side in (-100.0, 100.0) if largest > 50.0 else ():
            ax.axhline(side, color=palette.REST, lw=1.0, zorder=0)
        if not np.all(limited):
            ax.set_title("joints without a limit at 0", fontsize=8, loc="right", color=palette.INK)
    else:
        _plot_joints(simulation, simulation.torques, ax)
        _dress(simulation, ax, f"torque [{_unit(simulation, 'N m', 'N')}]")


def _plot_joints(simulation: SimulatedMotion, values: Array, ax: Axes) -> None:
    moving = _moving(simulation)
    colors, norm = _along(len(moving))
    marker = "o" if len(simulation.time) == 1 else ""
    for number, column in enumerate(moving, start=1):
        ax.plot(simulation.time, values[:, column], color=colors(norm(number)), lw=1.0, marker=marker, ms=3)


def _moving(simulation: SimulatedMotion) -> NDArray[np.intp]:
    """The degrees of freedom of the chain, from base to tip."""
    return simulation.arm.columns


def _along(count: int) -> tuple[LinearSegmentedColormap, Normalize]:
    colors = LinearSegmentedColormap.from_list("along the arm", palette.ALONG)
    return colors, Normalize(1, max(count, 2))


def _unit(simulation: SimulatedMotion, turning: str, sliding: str) -> str:
    slides = simulation.arm.slides[_moving(simulation)]
    return " or ".join(
        unit for unit, there in ((turning, not slides.all()), (sliding, slides.any())) if there
    )


def _dress(simulation: SimulatedMotion, ax: Axes, label: str) -> None:
    ax.set_xlim(0.0, max(float(simulation.time[-1]), 1e-3))
    ax.set_ylabel(label, fontsize=9)
    ax.tick_params(labelsize=8)
    ax.spines[["top", "right"]].set_visible(False)
    ax.grid(color=palette.FAINT, lw=0.6)
    ax.set_axisbelow(True)
