"""How arms, targets, runs and motions show themselves in a notebook: a table and a picture.

Importing the package under IPython registers what is here with its display. Other packages do not know of it.
"""

from __future__ import annotations

import base64
import io
from collections.abc import Callable, Iterable
from html import escape
from typing import TYPE_CHECKING, Any

import numpy as np

if TYPE_CHECKING:
    from matplotlib.figure import Figure

    from pinposture.arm import Arm
    from pinposture.motion import JointTrajectory, Motion, Trajectory
    from pinposture.placement import Target

DPI = 80
"""Resolution of pictures; 1200 pixels at 120, so that a picture is as wide as a cell."""

MAX_LISTED = 4
"""Largest number of warnings that are listed."""


def register(shell: Any) -> None:
    """Have an IPython shell show what is made here; classes are found by name when the first is shown."""
    formatter = shell.display_formatter.formatters["text/html"]
    for module, name, show in SHOWN:
        formatter.for_type_by_name(module, name, show)


def show_arm(arm: Arm) -> str:
    """Return an arm as HTML: what it is, and a picture of it, stretched out."""
    from pinposture.viz import plot_arm

    lower, upper = arm.limits.lower[arm.columns], arm.limits.upper[arm.columns]
    turning = ~arm.slides[arm.columns]
    rows = [
        ("base, tip", f"{arm.base}, {arm.tip}"),
        ("modules", f"{arm.n_modules}, {arm.segmentation.reason}"),
        ("degrees of freedom", f"{len(arm.columns)}, {'planar' if arm.dimension == 2 else 'spatial'}"),
        ("length", f"{arm.length:.4g} m"),
    ]
    for kind, of_kind, unit in (("turns", turning, "rad"), ("slides", ~turning, "m")):
        if np.any(of_kind):
            low, high = lower[of_kind], upper[of_kind]
            rows.append((f"limits of {kind}", f"{_span(low)} to {_span(high)} {unit}"))
    if arm.couplings:
        rows.append(("coupled joints", str(len(arm.couplings))))
    rows += _listed("warning", arm.warnings)
    return _page(arm.name, rows, plot_arm(arm, arm.straight()))


def show_target(target: Target) -> str:
    """Return a target as HTML: where it comes from, and how well it can be taken."""
    count = int(np.count_nonzero(target.has_target))
    rows = [("control points", f"{count} of {len(target.points)} have a target")]
    if target.method:
        rows.append(("placed", target.method))
    if target.curve is not None:
        rows.append(("curve", f"{target.curve.length:.4g} m long"))
    if target.residual is not None and count:
        rows.append(("off by", f"{1e3 * float(target.residual[target.has_target].max()):.3g} mm at most"))
    rows.append(("configuration", "known" if target.q is not None else "not known"))
    if target.moved:
        rows.append(("curve moved", str(target.moved)))
    rows += [(name, text) for name in ("incomplete", "approximate") if (text := getattr(target, name))]
    return _page("Target", rows, None)


def show_run(run: Trajectory) -> str:
    """Return a run as HTML: how it ended, and the figure of `plot`."""
    from pinposture.viz import plot
    from pinposture.viz.palette import controller_name

    rows = [
        ("status", f"{run.status}: {run.reason}"),
        ("steps", str(run.steps)),
        (
            "mean point error",
            f"{run.mean_error[0]:.4g} m at the start, {run.mean_error[-1]:.4g} m at the end",
        ),
        ("largest point error", f"{run.point_errors[-1].max():.4g} m at the end"),
    ]
    return _page(f"Run of {run.arm.name} by {controller_name(run)}", rows, plot(run))


def show_motion(motion: Motion) -> str:
    """Return a motion in time as HTML: how it ended, and the figure of `plot`."""
    from pinposture.viz import plot

    rows = [
        ("status", ": ".join(filter(None, (motion.run.status, motion.run.reason)))),
        ("duration", f"{motion.dt * motion.run.steps:.4g} s, {motion.run.steps} cycles of {motion.dt:.4g} s"),
        (
            "mean point error",
            f"{motion.mean_error.max():.4g} m at most, {motion.mean_error[-1]:.4g} m at the end",
        ),
        ("largest point error", f"{motion.run.point_errors.max():.4g} m"),
        *_listed("deviation", motion.deviations),
    ]
    return _page(f"Motion of {motion.arm.name}", rows, plot(motion))


def show_joints(trajectory: JointTrajectory) -> str:
    """Return a joint trajectory as HTML: the figure of `plot`."""
    from pinposture.viz import plot

    return _page(trajectory.name or "Joint trajectory", (), plot(trajectory))


SHOWN: tuple[tuple[str, str, Callable[[Any], str]], ...] = (
    ("pinposture.arm.arm", "Arm", show_arm),
    ("pinposture.placement.target", "Target", show_target),
    ("pinposture.motion.trajectory", "Trajectory", show_run),
    ("pinposture.motion.trajectory", "Motion", show_motion),
    ("pinposture.motion.joint_trajectory", "JointTrajectory", show_joints),
)
"""Classes that are shown, by module and name, and what shows them."""


def _span(values: np.ndarray) -> str:
    """Return the number that all values are, or the smallest and the largest."""
    low, high = float(values.min()), float(values.max())
    return f"{low:.4g}" if low == high else f"{low:.4g} ... {high:.4g}"


def _listed(what: str, texts: Iterable[str]) -> list[tuple[str, str]]:
    listed = list(texts)
    more = [("", f"and {len(listed) - MAX_LISTED} more")] if len(listed) > MAX_LISTED else []
    return [(what, text) for text in listed[:MAX_LISTED]] + more


def _page(title: str, rows: Iterable[tuple[str, str]], figure: Figure | None) -> str:
    """Return a table and a picture as HTML."""
    lines = "".join(
        f'<tr><th style="text-align:left">{escape(name)}</th>'
        f'<td style="text-align:left">{escape(text)}</td></tr>'
        for name, text in rows
    )
    return f"<div><b>{escape(title)}</b><table>{lines}</table>{_picture(figure)}</div>"


def _picture(figure: Figure | None) -> str:
    if figure is None:
        return ""
    image = io.BytesIO()
    figure.savefig(image, format="png", dpi=DPI)
    data = base64.b64encode(image.getvalue()).decode()
    return f'<img alt="" style="max-width:100%" src="data:image/png;base64,{data}">'
