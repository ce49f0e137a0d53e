"""Visualization of runs: figures, viewers in the browser, and animations in HTML files."""

import logging

import numpy as np

from pinposture._validation import require_known
from pinposture.arm import Arm, ControlPoints
from pinposture.collision import Scene
from pinposture.errors import InvalidValue
from pinposture.motion import Run, Tracker, Trajectory
from pinposture.placement import Target
from pinposture.viz.arm_figure import plot_arm
from pinposture.viz.drawing import require_type, visual_model
from pinposture.viz.foxglove import FoxgloveViewer
from pinposture.viz.meshcat import AnimationPage, Viewer, animate, save_html
from pinposture.viz.panels import (
    plot,
    plot_active_points,
    plot_clearance,
    plot_comparison,
    plot_point_errors,
    plot_posture_error,
)
from pinposture.viz.postures import plot_postures

__all__ = [
    "AnimationPage",
    "FoxgloveViewer",
    "Viewer",
    "animate",
    "plot",
    "plot_active_points",
    "plot_arm",
    "plot_clearance",
    "plot_comparison",
    "plot_point_errors",
    "plot_posture_error",
    "plot_postures",
    "save_html",
    "view",
    "visual_model",
]

logger = logging.getLogger(__name__)

VIEWERS = ("meshcat", "foxglove")


def view(
    arm: Arm,
    run: Run | Trajectory | Tracker | None = None,
    target: Target | None = None,
    *,
    viewer: str = "meshcat",
    open_browser: bool = False,
    fps: float = 20.0,
    url: str | None = None,
    ellipsoids: ControlPoints = (),
    scene: Scene | None = None,
) -> Viewer:
    """Show an arm in the browser: at a configuration, in a control loop, or playing a run or motion.

    Links are drawn with the visual meshes of the description, or as bars where these are unreadable, in
    alternating shades for the modules. Active control points are coloured and large. One `PostureWarning`
    names the meshes that are not drawn.

    A motion in time plays in real time, or 2, 5, 10, ... times as fast if it takes longer than a minute.
    Hoops show the current targets of its control points, thin lines the targets at waypoints.

    Args:
        arm: the arm.
        run: a run or motion in time to play in a loop; or a tracker: call `show` in each cycle of its loop.
            None: show the arm at rest.
        target: a fixed target to show; None: that of the run, if any.
        viewer: the program that draws: "meshcat", or "foxglove", which also plots joint positions and the
            status of a tracker, and requires the extra of that name; see `FoxgloveViewer`.
        open_browser: whether to open a browser on this computer. Otherwise, open the viewer's `url`.
        fps: steps of the run shown per second; fewer if a short run would last less than 2 s. For a motion in
            time, configurations shown per second.
        url: command address of a running server, such as "tcp://127.0.0.1:6000"; None starts a server, which
            accepts commands from this machine only, but also shows its page to others. For Foxglove: the
            address to listen at, by default "ws://127.0.0.1:8765"; port 0 selects a free one.
        ellipsoids: control points whose manipulability ellipsoids (Section 3.3) are shown, by 0-based index,
            negative index from the tip, or name. They are red and flat in a singular posture, green far from
            one, and yellow in between.
        scene: obstacles; None: those of the run, if any. They are translucent; half-spaces become plates.

    Returns:
        The viewer: `show(q)` shows a configuration, `play()` plays the run again, `close()` ends it, and
        `meshcat` is the `meshcat.Visualizer` for additional objects. It lives until closed or Python exits.

    Raises:
        UnknownName: an unknown viewer or control point.
        InvalidValue: an argument of another type, a run or target of another arm, or an invalid `fps` or
            choice of control points.
        ViewerError: the server cannot be started or reached.
    """
    require_known("viewer", viewer, VIEWERS)
    require_type("scene", scene, Scene, type(None))
    if isinstance(run, Run | Trajectory):
        scene = scene or (run.run.scene if isinstance(run, Trajectory) else run.scene)
    if target is None and isinstance(run, Run):
        target = run.target
    if viewer == "foxglove":
        if np.size(ellipsoids):
            raise InvalidValue("ellipsoids", ellipsoids, "none in Foxglove; meshcat shows them")
        shown: Viewer = FoxgloveViewer(arm, run, target, fps, url, scene)
    elif isinstance(run, Tracker):
        shown = Viewer(arm, None, target or run.target, fps, url, ellipsoids, scene or run.scene)
    else:
        shown = Viewer(arm, run, target, fps, url, ellipsoids, scene)
    logger.info("%s viewer at %s", viewer, shown.url)
    if open_browser:
        shown.open()
    return shown
