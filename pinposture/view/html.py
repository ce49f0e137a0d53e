"""A run or a motion as one HTML file: an animation that opens in any browser, without server or network."""

from __future__ import annotations

import base64
import html
import importlib.util
import json
from importlib import resources
from pathlib import Path
from string import Template

from pinposture.arm import Arm, ControlPoints
from pinposture.arm.ellipsoid import chosen_points
from pinposture.errors import FileError
from pinposture.motion import Motion, Trajectory
from pinposture.storage import with_suffix, write_text
from pinposture.target import Target
from pinposture.view import palette
from pinposture.view.animation import Film, film
from pinposture.view.captions import legend, texts
from pinposture.view.commands import animate, pack
from pinposture.view.ellipsoids import scale_in_words
from pinposture.view.scene import ASPECT, require_fitting
from pinposture.view.staging import staged
from pinposture.view.words import controller_name, ending, ending_in_time

MOST, MOST_IN_TIME = 240, 1200
"""Configurations of a run and of a motion that a file holds at most."""


def save_html(
    arm: Arm,
    run: Trajectory | Motion,
    path: str | Path,
    target: Target | None = None,
    fps: float = 20.0,
    max_frames: int | None = None,
    ellipsoids: ControlPoints = (),
) -> Path:
    """Write a run or a motion as an animation to one HTML file, all or nothing.

    The file holds all that it needs, the viewer's script included: it opens from disk, offline. The run
    plays over and over; the mouse turns, shifts and zooms. Active control points are coloured and large.
    Obstacles are translucent; of a half-space there is a patch.

    A motion in time plays as by `view`. Below it is written when it came to which of its named places.

    Args:
        arm: the arm.
        run: the run, or the motion in time, to show.
        path: the file; ".html" is added to a name without ending.
        target: a target to show, which stays where it is; that of a run if None.
        fps: configurations shown per second; fewer if the run is so short that it would last under 2 s.
        max_frames: number of configurations shown at most; of longer runs some are skipped. None: 240 of a
            run, 1200 of a motion.
        ellipsoids: control points to show the manipulability ellipsoids of, as for `view`; the page says what
            their colours mean, and at what scale they are drawn.

    Returns:
        The path written.

    Raises:
        FileError: the name has another ending, or the file cannot be written.
        InvalidValue: a run of another arm, `fps` or `max_frames`, or no choice of control points.
        UnknownName: a name that no control point has.
    """
    path = with_suffix(Path(path), ".html", ".htm")
    target = run.target if target is None and isinstance(run, Trajectory) else target
    require_fitting(arm, run, target)
    points = chosen_points(arm.control_points, ellipsoids)
    if max_frames is None:
        max_frames = MOST_IN_TIME if isinstance(run, Motion) else MOST
    write_text(path, _page(arm, film(run, fps, max_frames), target, points))
    return path


def _page(arm: Arm, shown: Film, target: Target | None, points: tuple[int, ...]) -> str:
    run, motion = shown.run, shown.motion
    setting = staged(arm, shown, target, run.scene, points)
    commands = [*setting.drawn, animate(setting.tracks, shown.fps)]
    packed = [base64.b64encode(pack(command)).decode("ascii") for command in commands]
    described = {"times": (shown.times / shown.fps).round(6).tolist(), "texts": texts(shown)}
    template = resources.files("pinposture.view").joinpath("page.html").read_text(encoding="utf-8")
    ended = ending(run) if motion is None else ending_in_time(motion)
    return Template(template).substitute(
        title=html.escape(f"{controller_name(run)} {ended}"),
        reason=html.escape(run.reason),
        legend=legend(shown, setting, target is not None, scale_in_words(arm, points) if points else ""),
        ink=palette.INK,
        end=shown.end / shown.fps,
        aspect=ASPECT,
        viewer=_viewer_script(),
        run=json.dumps(described).replace("<", r"\u003c"),  # a name in it must not end the script
        commands=json.dumps(packed),
    )


def _viewer_script() -> str:
    """The script of the meshcat viewer, as the package ships it for its own pages."""
    spec = importlib.util.find_spec("meshcat")  # found without being imported, which would take a while
    for folder in (spec.submodule_search_locations or []) if spec is not None else []:
        script = Path(folder) / "viewer" / "dist" / "main.min.js"
        if script.is_file():
            return script.read_text(encoding="utf-8")
    raise FileError("meshcat/viewer/dist/main.min.js", "no such file in the installed meshcat package")
