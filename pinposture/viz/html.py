"""A run or a motion as one HTML file that opens in any browser, without server or network."""

from __future__ import annotations

import base64
import html
import json
from collections.abc import Sequence
from importlib import resources
from pathlib import Path
from string import Template

from meshcat import Visualizer
from meshcat.servers.zmqserver import VIEWER_ROOT

from pinposture.arm import Arm, ControlPoints
from pinposture.arm.manipulability import chosen_points
from pinposture.motion import Motion, Trajectory
from pinposture.placement import Target
from pinposture.storage import with_suffix, write_text
from pinposture.viz import palette
from pinposture.viz.animation import Timeline, playback
from pinposture.viz.axes import controller_name, ending_text, is_slowed, motion_ending_text, placement_text
from pinposture.viz.drawing import require_fitting
from pinposture.viz.ellipsoids import INDEX_LABELS, scale_in_words
from pinposture.viz.meshcat import ASPECT, CommandRecorder, DrawnScene, draw_scene, play_animation
from pinposture.viz.panels import has_clearance

# Captions and legend.


def captions(shown: Timeline) -> list[str]:
    """Return the text under each configuration that is shown."""
    listed, run = [], shown.run
    for row in shown.rows:
        text = _step_text(shown, row) if shown.motion is None else _motion_text(shown.motion, row)
        listed.append(text + (f", clearance {run.clearance[row]:.3g} m" if has_clearance(run) else ""))
    return listed


def _step_text(shown: Timeline, row: int) -> str:
    """Describe a configuration of a run."""
    run = shown.run
    text = f"step {row} of {run.steps}, posture error {run.posture_error[row]:.3g} m"
    if run.steps:
        count = int(run.active[min(row, run.steps - 1)].sum())
        text += f", {count} of {run.arm.n_modules} control points active"
        if run.switches:
            text += f" by {run.method[min(row, run.steps - 1)].capitalize()}"
    return text


def _motion_text(motion: Motion, row: int) -> str:
    """Describe a configuration of a motion."""
    text = f"{motion.time[row]:.2f} of {motion.time[-1]:.2f} s"
    if is_slowed(motion):
        text += f" ({motion.plan_time[row]:.2f} of {motion.planned:.2f} s of the plan)"
    count = sum(place.row is not None and place.row <= row for place in motion.waypoints)
    if row < motion.start_index:
        text += ", coming to the first posture"
    elif count:
        text += f", reached {motion.waypoints[count - 1].name} ({count} of {len(motion.waypoints)})"
    return f"{text}, posture error {motion.run.posture_error[row]:.3g} m"


def legend_html(shown: Timeline, drawn: DrawnScene, target: bool, scale: str) -> str:
    """Return the legend, and the speed at which a motion is shown, as HTML.

    Args:
        shown: what is shown.
        drawn: what is drawn of it.
        target: whether a fixed target is drawn.
        scale: the scale of ellipsoids, in words; empty if there are none.
    """
    entries = [("target", palette.TARGET)] if target else []
    if shown.motion is not None:
        entries = [("target of the moment", palette.TARGET)]
    if shown.run.steps:
        entries += [("active control point", palette.ACTIVE), ("idle", palette.IDLE)]
    else:
        entries.append(("control point", palette.IDLE))
    if drawn.obstacles:
        entries.append(("obstacle", palette.OBSTACLE))
    lines = [_color_key(entries)]
    if shown.motion is not None:
        speed = "in real time" if shown.speedup == 1.0 else f"{shown.speedup:.0f} times as fast as it was"
        named = [(", ".join(place.name for place in group), group[0].color) for group in drawn.places]
        lines.append(f"shown {speed}; targets at {_color_key(named)}" if named else f"shown {speed}")
    moved = placement_text(shown.run if shown.motion is None else shown.motion)
    if moved:
        lines.append(html.escape(moved))
    if scale:
        listed = [(f"index {meaning}", color) for color, meaning in INDEX_LABELS.items()]
        lines.append(f"ellipsoids, {scale}: {_color_key(listed)}")
    return "<br>".join(lines)


def _color_key(entries: Sequence[tuple[str, str]]) -> str:
    dots = [
        f'<span class="dot" style="background: {color}"></span>{html.escape(name)}' for name, color in entries
    ]
    return "".join(dots)


# The page.

MAX_RUN_FRAMES, MAX_MOTION_FRAMES = 240, 1200


def save_html(
    arm: Arm,
    run: Trajectory | Motion,
    path: str | Path,
    target: Target | None = None,
    fps: float = 20.0,
    max_frames: int | None = None,
    ellipsoids: ControlPoints = (),
) -> Path:
    """Write a run or a motion as an animation to one HTML file, atomically.

    The file contains everything, including the script of the viewer, so it opens from disk, offline. The run
    plays over and over; the mouse turns, shifts and zooms. Active control points are coloured and large.
    Obstacles are translucent; a half-space is drawn as a plate.

    A motion in time plays as by `view`. Its caption tells which of its named places it has reached.

    Args:
        arm: the arm.
        run: the run, or the motion in time, to show.
        path: the file; ".html" is added to a name without suffix.
        target: a fixed target to show; that of a run if None.
        fps: configurations shown per second; fewer if the run is so short that it would last under 2 s.
        max_frames: largest number of configurations shown; of longer runs some are skipped. None: 240 of a
            run, 1200 of a motion.
        ellipsoids: control points to show the manipulability ellipsoids of, as for `view`; the page explains
            their colours and their scale.

    Returns:
        The path written.

    Raises:
        FileError: the name has another suffix, or the file cannot be written.
        InvalidValue: a run of another arm, `fps` or `max_frames`, or no choice of control points.
        UnknownName: a name that no control point has.
    """
    path = with_suffix(Path(path), ".html", ".htm")
    target = run.target if target is None and isinstance(run, Trajectory) else target
    require_fitting(arm, run, target)
    points = chosen_points(arm.control_points, ellipsoids)
    if max_frames is None:
        max_frames = MAX_MOTION_FRAMES if isinstance(run, Motion) else MAX_RUN_FRAMES
    write_text(path, _page_html(arm, playback(run, fps, max_frames), target, points))
    return path


def _page_html(arm: Arm, shown: Timeline, target: Target | None, points: tuple[int, ...]) -> str:
    run, motion = shown.run, shown.motion
    recording = CommandRecorder()
    viewer = Visualizer(window=recording)
    drawn = draw_scene(viewer, arm, shown, target, run.scene, points)
    play_animation(viewer, drawn.tracks, shown.fps)
    packed = [base64.b64encode(command).decode("ascii") for command in recording.packed]
    described = {"times": (shown.times / shown.fps).round(6).tolist(), "texts": captions(shown)}
    template = resources.files("pinposture.viz").joinpath("page.html").read_text(encoding="utf-8")
    ended = ending_text(run) if motion is None else motion_ending_text(motion)
    return Template(template).substitute(
        title=html.escape(f"{controller_name(run)} {ended}"),
        reason=html.escape(run.reason),
        legend=legend_html(shown, drawn, target is not None, scale_in_words(arm, points) if points else ""),
        ink=palette.INK,
        end=shown.end / shown.fps,
        aspect=ASPECT,
        viewer=_viewer_script(),
        run=json.dumps(described).replace("<", r"\u003c"),  # a name in it must not end the script
        commands=json.dumps(packed),
    )


def _viewer_script() -> str:
    """Return the script of the meshcat viewer, as meshcat ships it for its own pages."""
    return Path(VIEWER_ROOT, "main.min.js").read_text(encoding="utf-8")
