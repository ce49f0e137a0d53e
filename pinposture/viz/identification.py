"""The figure of an identification: what the model explains, and the numbers of each joint."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from pinposture.errors import InvalidValue
from pinposture.motion.identification import DriveEstimate, Estimate, Identification, Prediction
from pinposture.viz import palette
from pinposture.viz.drawing import require_type
from pinposture.viz.palette import THEME
from pinposture.viz.panels import add_legend


def plot_identification(identification: Identification, log: int = 0) -> Figure:
    """Plot what the one set of drives predicts of a log, and lag, delay and friction of each joint.

    Above: the joint that moved most, with commands, measurements and prediction; below it, what is not
    explained of all joints, darkest at the base. Bars are intervals; the line and its shade are the one set.

    Args:
        identification: the result of `pp.identify`.
        log: which of its logs, 0-based.

    Returns:
        A figure, 1200 pixels wide; `figure.savefig(path)` writes it. It is not shown or registered with
        pyplot.

    Raises:
        InvalidValue: the model is not identified, or there is no such log.
    """
    require_type("identification", identification, Identification)
    logs = identification.logs
    if not isinstance(log, int) or isinstance(log, bool) or not 0 <= log < len(logs):
        raise InvalidValue("log", log, f"a whole number from 0 to {len(logs) - 1}")
    predictions = identification.predict(logs[log])
    figure = Figure(figsize=(palette.FIGURE.width, palette.FIGURE.height), layout="constrained")
    grid = figure.add_gridspec(3, 3, height_ratios=(1.3, 1.0, 1.0))
    panels = [figure.add_subplot(grid[row, :]) for row in range(2)]
    _plot_followed(predictions, panels[0], identification.unit)
    _plot_rest(identification, predictions, panels[1])
    palette.share_axis(panels)
    for column, (name, unit) in enumerate(
        {"lag": "s", "delay": "s", "friction": identification.unit}.items()
    ):
        _plot_numbers(identification, name, unit, figure.add_subplot(grid[2, column]))
    explained = identification.drives.explained
    share = (
        "" if explained is None else f": it explains {explained:.1%} of the variance of positions left out"
    )
    palette.add_title(figure, [f"One set for the drives of {identification.arm.name}{share}"])
    return figure


def _plot_followed(predictions: Mapping[str, Prediction], ax: Axes, unit: str) -> None:
    """Plot commands, measurements and prediction of the joint that moved most."""
    if not predictions:
        return
    name = max(predictions, key=lambda joint: float(np.ptp(predictions[joint].measured)))
    shown = predictions[name]
    time = shown.time - shown.time[0]
    ax.plot(time, shown.sent, color=THEME.rest, lw=1.2, label="command")
    ax.plot(time, shown.measured, color=THEME.start, lw=1.6, label="measured")
    ax.plot(time, shown.predicted, color=THEME.active, lw=1.2, label="predicted")
    palette.format_time_axes(ax, f"{name} [{unit}]")
    add_legend(ax)


def _plot_rest(identification: Identification, predictions: Mapping[str, Prediction], ax: Axes) -> None:
    """Plot what is measured minus what is predicted, of all joints."""
    names = list(identification.arm.joint_names)
    colors, norm = palette.colors_along(len(names))
    for name, shown in predictions.items():
        time = shown.time - shown.time[0]
        color = colors(norm(1 + names.index(name)))
        ax.plot(time, shown.measured - shown.predicted, color=color, lw=0.8)
    palette.format_time_axes(ax, f"not explained [{identification.unit}]")


def _plot_numbers(identification: Identification, name: str, unit: str, ax: Axes) -> None:
    """Plot a number of each joint, and that of the one set."""
    names = list(identification.arm.joint_names)
    known = [(1 + names.index(joint), _number(drive, name)) for joint, drive in identification.joints.items()]
    for joint, number in known:
        if number is not None:
            ends = [[number.value - number.lower], [number.upper - number.value]]
            ax.errorbar(joint, number.value, ends, color=THEME.start, marker="o", ms=3, lw=1.0, capsize=2)
    shared = _number(identification.drives, name)
    if shared is not None:
        ax.axhspan(shared.lower, shared.upper, color=THEME.active, alpha=THEME.sheer, lw=0.0)
        ax.axhline(shared.value, color=THEME.active, lw=1.2)
    ax.set_xlabel("joint, from base to tip", fontsize=9)
    ax.set_ylabel(f"{name} [{unit}]", fontsize=9)
    ax.set_xlim(0.0, len(names) + 1.0)
    ax.set_ylim(bottom=0.0)
    palette.add_grid(ax)


def _number(drive: DriveEstimate, name: str) -> Estimate | None:
    return {"lag": drive.lag, "delay": drive.delay, "friction": drive.friction}[name]
