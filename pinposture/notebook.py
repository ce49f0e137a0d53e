"""How arms, curves, targets, runs and others show themselves in a notebook: a table, and a picture of some.

Importing the package under IPython registers what is here with its display. Other packages do not know of it.
"""

from __future__ import annotations

import base64
import io
from collections.abc import Callable, Iterable
from html import escape
from typing import TYPE_CHECKING, Any

import numpy as np

from pinposture.units import length_text

if TYPE_CHECKING:
    from matplotlib.figure import Figure

    from pinposture.arm import Arm
    from pinposture.collision import Scene
    from pinposture.control import Limits
    from pinposture.control.reach import ReachedPosture
    from pinposture.curve import Curve
    from pinposture.motion import Batch, JointTrajectory, Run, Tracker, Trajectory
    from pinposture.placement import Target
    from pinposture.task import Task


def register(shell: Any) -> None:
    """Have an IPython shell show what is made here; classes are found by name when the first is shown."""
    formatter = shell.display_formatter.formatters["text/html"]
    for module, name, show in SHOWN:
        formatter.for_type_by_name(module, name, show)


def show_arm(arm: Arm) -> str:
    """Return an arm as HTML: what it is, and a picture of it, stretched out."""
    from pinposture.viz import plot_arm

    lower = arm.limits.lower[arm.columns]
    upper = arm.limits.upper[arm.columns]
    turning = ~arm.slides[arm.columns]
    rows = [
        ("base, tip", f"{arm.base}, {arm.tip}"),
        ("modules", f"{arm.n_modules}, {arm.segmentation.reason}"),
        ("degrees of freedom", f"{len(arm.columns)}, {'planar' if arm.dimension == 2 else 'spatial'}"),
        ("length", length_text(arm.length)),
    ]
    for kind, of_kind, unit in (("angle", turning, "rad"), ("slide", ~turning, "m")):
        if np.any(of_kind):
            low = lower[of_kind]
            high = upper[of_kind]
            rows.append((f"{kind} limits", f"{_span(low)} to {_span(high)} {unit}"))
    if arm.couplings:
        rows.append(("coupled joints", str(len(arm.couplings))))
    rows += _first(("warning", text) for text in arm.warnings)
    return _page(arm.name, rows, plot_arm(arm, arm.straight()))


def show_target(target: Target) -> str:
    """Return a target as HTML: where it comes from, and how well it can be taken."""
    count = int(np.count_nonzero(target.has_target))
    rows = [("control points", f"{count} of {len(target.points)} have a target")]
    if target.method:
        rows.append(("placed", target.method))
    if target.curve is not None:
        rows.append(("curve", f"{length_text(target.curve.length)} long"))
    if target.residual is not None and count:
        rows.append(("off by", f"{length_text(float(target.residual[target.has_target].max()))} at most"))
    rows.append(("configuration", "known" if target.q is not None else "not known"))
    if target.moved:
        rows.append(("curve moved", str(target.moved)))
    rows += [(name, text) for name in ("incomplete", "approximate") if (text := getattr(target, name))]
    return _page("Target", rows, None)


def show_run(run: Run) -> str:
    """Return a run as HTML: how it ended, and the figure of `plot`."""
    from pinposture.motion.words import in_words
    from pinposture.viz import plot
    from pinposture.viz.palette import controller_name

    rows = in_words(run.summary()).items()
    return _page(f"Run of {run.arm.name} by {controller_name(run)}", rows, plot(run))


def show_motion(motion: Trajectory) -> str:
    """Return a motion in time as HTML: how it ended, and the figure of `plot`."""
    from pinposture.motion.words import in_words
    from pinposture.viz import plot

    rows = in_words(motion.summary()).items()
    return _page(f"Motion of {motion.arm.name}", rows, plot(motion))


def show_joints(trajectory: JointTrajectory) -> str:
    """Return a joint trajectory as HTML: its size, its largest rates, and the figure of `plot`."""
    from pinposture.motion.words import in_words
    from pinposture.viz import plot

    rows = in_words(trajectory.summary()).items()
    return _page(trajectory.name or "Joint trajectory", rows, plot(trajectory))


def show_figure(figure: Figure) -> str:
    """Return a figure as HTML; pyplot, which would show it, does not know the figures of the library."""
    return _picture(figure)


def show_curve(curve: Curve) -> str:
    """Return a curve as HTML: its size, and where it begins and ends."""
    from pinposture.viz.drawing import DRAWING

    along = curve.at(np.linspace(0.0, curve.length, DRAWING.curve_samples))
    rows = [
        ("length", length_text(curve.length)),
        ("from, to", f"{_point(along[0])}, {_point(along[-1])}"),
        ("smallest, largest coordinates", f"{_point(along.min(axis=0))}, {_point(along.max(axis=0))}"),
    ]
    return _page(type(curve).__name__, rows, None)


def show_scene(scene: Scene) -> str:
    """Return a scene as HTML: its margin and its obstacles."""
    rows = [
        ("margin", length_text(scene.margin)),
        ("self-collision", "avoided" if scene.self_collision else "not checked"),
        *([("touchable", ", ".join(scene.touchable))] if scene.touchable else []),
        *((f"{name} carried by", carried.frame) for name, carried in scene.carried.items()),
        *_first((name, repr(obstacle)) for name, obstacle in scene.obstacles.items()),
    ]
    return _page("Scene", rows, None)


def show_limits(limits: Limits) -> str:
    """Return the limits of a step as HTML; each is given for all joints, or for each joint."""
    units = {
        "step": "rad or m",
        "dt": "s",
        "velocity": "rad/s or m/s",
        "acceleration": "rad/s² or m/s²",
        "jerk": "rad/s³ or m/s³",
        "position_margin": "rad or m",
    }
    values = ((name, getattr(limits, name), unit) for name, unit in units.items())
    rows = [
        (name.replace("_", " "), f"{_span(np.asarray(value))} {unit}")
        for name, value, unit in values
        if value is not None
    ]
    return _page("Limits", rows, None)


def show_task(task: Task) -> str:
    """Return a task as HTML: what moves, how, and where."""
    rows = [
        ("arm", str(task.arm)),
        ("controller", task.controller.name),
        ("scene", "none" if task.scene is None else str(task.scene)),
        ("motion", str(task)),
    ]
    return _page(task.name, rows, None)


def show_batch(batch: Batch) -> str:
    """Return a batch as HTML: its summary in words."""
    return _page(f"{len(batch)} runs", batch.in_words().items(), None)


def show_tracker(tracker: Tracker) -> str:
    """Return a tracker as HTML: its last report."""
    report = tracker.report
    rows = [
        ("arm", tracker.arm.name),
        ("status", ": ".join(filter(None, (report.status, report.reason)))),
    ]
    if report.mean_error is not None:
        rows.append(("mean point error", length_text(report.mean_error, tracker.arm.length)))
    rows += _first(("violated constraint", text) for text in report.violated_constraints)
    return _page("Tracker", rows, None)


def show_reached(posture: ReachedPosture) -> str:
    """Return a posture of `reach` as HTML: how good it is, and whether there is a clear path to it."""
    path = "not asked for" if posture.path is None else posture.path.blocked_by or "clear"
    rows = [
        ("tip error", length_text(posture.error)),
        ("clearance", length_text(posture.clearance) if np.isfinite(posture.clearance) else "no obstacles"),
        ("from limits", f"{posture.limit_distance:.3g} of half the range"),
        ("manipulability", f"{posture.manipulability:.3g}"),
        ("score", f"{posture.score:.3g}"),
        ("path", path),
    ]
    return _page("Posture", rows, None)


SHOWN: tuple[tuple[str, str, Callable[[Any], str]], ...] = (
    ("pinposture.arm.arm", "Arm", show_arm),
    ("pinposture.placement.target", "Target", show_target),
    ("pinposture.motion.run", "Run", show_run),
    ("pinposture.motion.trajectory", "Trajectory", show_motion),
    ("pinposture.motion.joint_trajectory", "JointTrajectory", show_joints),
    ("pinposture.motion.batch", "Batch", show_batch),
    ("pinposture.motion.tracker", "Tracker", show_tracker),
    ("pinposture.curve.curve", "Curve", show_curve),
    ("pinposture.collision.scene", "Scene", show_scene),
    ("pinposture.control.limits", "Limits", show_limits),
    ("pinposture.control.reach", "ReachedPosture", show_reached),
    ("pinposture.task.task", "Task", show_task),
    ("matplotlib.figure", "Figure", show_figure),
)
"""Classes that are shown, by module and name, and what shows them."""


def _point(position: np.ndarray) -> str:
    """Return a position in the world frame [m]."""
    return f"({', '.join(f'{value:.4g}' for value in position.round(6) + 0.0)}) m"


def _span(values: np.ndarray) -> str:
    """Return the number that all values are, or the smallest and the largest."""
    low = float(values.min())
    high = float(values.max())
    return f"{low:.4g}" if low == high else f"{low:.4g} ... {high:.4g}"


def _first(rows: Iterable[tuple[str, str]], most: int = 12) -> list[tuple[str, str]]:
    """Return the first rows, and the number of the others."""
    listed = list(rows)
    more = [("", f"and {len(listed) - most} more")] if len(listed) > most else []
    return listed[:most] + more


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
    figure.savefig(image, format="png", dpi=80)  # as wide as a cell
    data = base64.b64encode(image.getvalue()).decode()
    return f'<img alt="" style="max-width:100%" src="data:image/png;base64,{data}">'
