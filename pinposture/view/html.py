"""A run as one HTML file: an animation that opens in any browser, without a server and without a network."""

from __future__ import annotations

import base64
import html
import importlib.util
import json
from collections.abc import Mapping
from importlib import resources
from pathlib import Path
from string import Template

import numpy as np

from pinposture.arm import Arm, ControlPoints
from pinposture.arm.ellipsoid import chosen_points
from pinposture.errors import FileError
from pinposture.motion import Trajectory
from pinposture.storage import write_text
from pinposture.target import Target
from pinposture.view import palette
from pinposture.view.animation import Film, film, tracks
from pinposture.view.clearance import has_clearance
from pinposture.view.commands import animate, pack
from pinposture.view.ellipsoids import KEY, scale_in_words
from pinposture.view.moving_ellipsoids import ball_commands, ball_ends, ball_tracks, balls
from pinposture.view.obstacles import near_corners, obstacle_commands, shown_obstacles
from pinposture.view.scene import (
    ASPECT,
    arm_commands,
    require_fitting,
    stage_commands,
    stage_points,
    target_commands,
)
from pinposture.view.words import controller_name, ending


def save_html(
    arm: Arm,
    run: Trajectory,
    path: str | Path,
    target: Target | None = None,
    fps: float = 20.0,
    max_frames: int = 240,
    ellipsoids: ControlPoints = (),
) -> Path:
    """Write a run as an animation to one HTML file, all or nothing.

    The file holds all that it needs, the viewer's script included: it opens from disk, offline. The run
    plays over and over; the mouse turns, shifts and zooms. Active control points are coloured and large.
    Obstacles are translucent; of a half-space there is a patch.

    Args:
        arm: the arm.
        run: the run to show.
        path: the file; ".html" is added if it has no such ending.
        target: the target to show; that of the run if None.
        fps: configurations shown per second; fewer if the run is so short that it would last under 2 s.
        max_frames: number of configurations shown at most; of longer runs some are skipped.
        ellipsoids: control points to show the manipulability ellipsoids of, as for `view`; the page says what
            their colours mean, and at what scale they are drawn.

    Returns:
        The path written.

    Raises:
        FileError: the file cannot be written.
        InvalidValue: a run of another arm, `fps` or `max_frames`, or no choice of control points.
        UnknownName: a name that no control point has.
    """
    path = Path(path)
    path = path if path.suffix.lower() in (".html", ".htm") else path.with_name(f"{path.name}.html")
    target = run.target if target is None else target
    require_fitting(arm, run, target)
    points = chosen_points(arm.control_points, ellipsoids)
    write_text(path, _page(arm, film(run, fps, max_frames), target, points))
    return path


def _page(arm: Arm, shown: Film, target: Target, points: tuple[int, ...]) -> str:
    run = shown.run
    ellipsoids = balls(arm, points, run.q[shown.rows])
    stage = np.vstack([stage_points(arm, run, target), ball_ends(ellipsoids)])
    obstacles = shown_obstacles(run.scene, stage)
    commands = [
        *stage_commands(arm, np.vstack([stage, near_corners(obstacles)])),
        *arm_commands(arm, run.q[0]),
        *target_commands(arm, target),
        *obstacle_commands(obstacles),
        *ball_commands(ellipsoids),
        animate([*tracks(arm, shown), *ball_tracks(ellipsoids, shown)], shown.fps),
    ]
    packed = [base64.b64encode(pack(command)).decode("ascii") for command in commands]
    described = {"fps": shown.fps, "before": float(shown.times[0]), "texts": _texts(shown)}
    template = resources.files("pinposture.view").joinpath("page.html").read_text(encoding="utf-8")
    return Template(template).substitute(
        title=html.escape(f"{controller_name(run)} {ending(run)}"),
        reason=html.escape(run.reason),
        legend=_legend(run.steps > 0, bool(obstacles), scale_in_words(arm, points) if points else ""),
        ink=palette.INK,
        end=shown.end / shown.fps,
        aspect=ASPECT,
        viewer=_viewer_script(),
        run=json.dumps(described),
        commands=json.dumps(packed),
    )


def _texts(shown: Film) -> list[str]:
    """What is written under each configuration that is shown."""
    run = shown.run
    texts = []
    for row in shown.rows:
        text = f"step {row} of {run.steps}, posture error {run.posture_error[row]:.3g} m"
        if run.steps:
            count = int(run.active[min(row, run.steps - 1)].sum())
            text += f", {count} of {run.arm.n_modules} control points active"
            if run.switches:
                text += f" by {run.method[min(row, run.steps - 1)].capitalize()}"
        if has_clearance(run):
            text += f", clearance {run.clearance[row]:.3g} m"
        texts.append(text)
    return texts


def _legend(moves: bool, obstacles: bool, scale: str) -> str:
    entries = {"target": palette.TARGET, "control point": palette.IDLE}
    if moves:
        entries = {"target": palette.TARGET, "active control point": palette.ACTIVE, "idle": palette.IDLE}
    if obstacles:
        entries["obstacle"] = palette.OBSTACLE
    words = _dots(entries)
    if scale:
        words += f"<br>ellipsoids, {scale}: " + _dots(
            {f"index {meaning}": color for color, meaning in KEY.items()}
        )
    return words


def _dots(entries: Mapping[str, str]) -> str:
    dots = [f'<span class="dot" style="background: {color}"></span>{name}' for name, color in entries.items()]
    return "".join(dots)


def _viewer_script() -> str:
    """The script of the meshcat viewer, as the package ships it for its own pages."""
    spec = importlib.util.find_spec("meshcat")  # found without being imported, which would take a while
    for folder in (spec.submodule_search_locations or []) if spec is not None else []:
        script = Path(folder) / "viewer" / "dist" / "main.min.js"
        if script.is_file():
            return script.read_text(encoding="utf-8")
    raise FileError("meshcat/viewer/dist/main.min.js", "no such file in the installed meshcat package")
