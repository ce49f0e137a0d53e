"""How people see a run: figures, viewers in the browser, animations in a file."""

import logging

import numpy as np

from pinposture.arm import Arm, ControlPoints
from pinposture.collision import Scene
from pinposture.errors import InvalidValue, UnknownName
from pinposture.motion import Motion, Tracker, Trajectory
from pinposture.placement import Target
from pinposture.viz.arm_figure import plot_arm
from pinposture.viz.drawing import visual_model
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
    run: Trajectory | Motion | Tracker | None = None,
    target: Target | None = None,
    viewer: str = "meshcat",
    open_browser: bool = False,
    fps: float = 20.0,
    url: str | None = None,
    ellipsoids: ControlPoints = (),
    scene: Scene | None = None,
) -> Viewer:
    """Show an arm live in the browser: at a configuration, in a control loop, or playing a run or a motion.

    The arm is drawn with the visual meshes of its description where they can be read, elsewhere as bars, in
    alternating shades for its modules. Active control points are coloured and large. One `PostureWarning`
    names the meshes that are not drawn.

    A motion in time plays in real time, unless it takes longer than a minute: then 2, 5, 10, ... times as
    fast. Hoops show where its control points should be, and thin lines its targets at named places.

    Args:
        arm: the arm.
        run: a run, or a motion in time, to play over and over; or a tracker, to `show` the arm in each cycle
            of its loop; None to show the arm at rest.
        target: a fixed target to show; if None that of the run, if there is one.
        viewer: the program that draws it: "meshcat", or "foxglove", which also plots joint positions and the
            status of a tracker, and needs the extra of that name; see `FoxgloveViewer`.
        open_browser: whether to open a browser on this computer. Without, open the viewer's `url`.
        fps: steps of the run shown per second; fewer if it is so short that it would last under 2 s. Of a
            motion in time, configurations shown per second.
        url: address for commands of a running server, as in "tcp://127.0.0.1:6000"; None to start one. It
            takes commands from this machine only, but shows its page to others, too. For Foxglove, the
            address to listen at, "ws://127.0.0.1:8765" if None; port 0 is a free one.
        ellipsoids: control points to show the manipulability ellipsoids of (Section 3.3), by their indices,
            0-based or from the tip as -1, or by their names. In a singular posture they are red and flat, far
            from one green, in between yellow.
        scene: obstacles; if None those of the run, if there is one. They are translucent; a half-space is
            drawn as a plate.

    Returns:
        The viewer: `show(q)` shows a configuration, `play()` plays the run again, `close()` ends it, and
        `meshcat` is the `meshcat.Visualizer` to draw more with. It lives until it is closed or Python ends.

    Raises:
        UnknownName: an unknown viewer or control point.
        InvalidValue: a run or target of another arm, `fps`, or no choice of control points.
        ViewerError: the server cannot be started or reached.
    """
    if viewer not in VIEWERS:
        raise UnknownName("viewer", viewer, VIEWERS)
    if isinstance(run, Trajectory | Motion):
        scene = scene or (run.run.scene if isinstance(run, Motion) else run.scene)
    if target is None and isinstance(run, Trajectory):
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
