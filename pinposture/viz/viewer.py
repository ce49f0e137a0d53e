"""One call to see an arm, whatever draws it."""

from __future__ import annotations

import logging
from collections.abc import Callable
from typing import Protocol

from numpy.typing import ArrayLike

from pinposture.arm import Arm, ControlPoints
from pinposture.collision import Scene
from pinposture.errors import UnknownName
from pinposture.motion import Motion, Trajectory
from pinposture.placement import Target
from pinposture.viz.meshcat import MeshcatViewer

logger = logging.getLogger(__name__)


class Viewer(Protocol):
    """An arm on the screen."""

    @property
    def url(self) -> str:
        """What to open in a browser."""

    def open(self) -> None:
        """Open a browser on this computer."""

    def show(self, q: ArrayLike) -> None:
        """Show the arm at a configuration, (nq,) [rad or m]."""

    def play(self) -> None:
        """Play the run, or the motion, from its start, over and over."""

    def close(self) -> None:
        """End the viewer."""


VIEWERS: dict[
    str,
    Callable[
        [Arm, Trajectory | Motion | None, Target | None, float, str | None, ControlPoints, Scene | None],
        Viewer,
    ],
] = {"meshcat": MeshcatViewer}
"""What can draw an arm, by name."""


def view(
    arm: Arm,
    run: Trajectory | Motion | None = None,
    target: Target | None = None,
    viewer: str = "meshcat",
    open_browser: bool = False,
    fps: float = 20.0,
    url: str | None = None,
    ellipsoids: ControlPoints = (),
    scene: Scene | None = None,
) -> Viewer:
    """Show an arm in the browser: at its neutral configuration, or playing a run or a motion.

    The arm is drawn with the visual meshes of its description where there are any that can be read, elsewhere
    from its kinematics, in two shades that take turns from module to module. Control points that are active
    are coloured and large. One `PostureWarning` names the meshes that are not drawn.

    A motion in time plays in real time, unless it takes longer than a minute: then 2, 5, 10, ... times as
    fast. Hoops go where its control points should be, and thin lines are its targets at named places.

    Args:
        arm: the arm.
        run: a run, or a motion in time, to play over and over; None to show the arm at rest.
        target: a target to show, which stays where it is; if None that of the run, if there is one.
        viewer: what draws it: "meshcat".
        open_browser: whether to open a browser on this computer. Without, open the viewer's `url`.
        fps: steps of the run shown per second; fewer if it is so short that it would last under 2 s. Of a
            motion in time, configurations shown per second.
        url: where a server that runs already listens for commands, as in "tcp://127.0.0.1:6000"; None to
            start one. It takes commands from this machine only, and shows its page to others, too.
        ellipsoids: control points to show the manipulability ellipsoids of (Section 3.3), by their indices,
            0-based or from the tip as -1, or by their names. They follow the arm. In a singular posture they
            are red and flat, far from one green, in between yellow.
        scene: what surrounds the arm; that of the run, if there is one, if None. Obstacles are translucent;
            of a half-space there is a patch.

    Returns:
        The viewer: `show(q)` shows a configuration, `play()` plays the run again, `close()` ends it. It
        lives until it is closed or Python ends.

    Raises:
        UnknownName: no viewer has that name, or no control point.
        InvalidValue: a run or target of another arm, `fps`, or no choice of control points.
        ViewerError: the server cannot be started or reached.
    """
    if viewer not in VIEWERS:
        raise UnknownName("viewer", viewer, VIEWERS)
    own = run.run if isinstance(run, Motion) else run
    if target is None and own is run and own is not None:
        target = own.target
    if scene is None and own is not None:
        scene = own.scene
    shown = VIEWERS[viewer](arm, run, target, fps, url, ellipsoids, scene)
    logger.info("%s viewer at %s", viewer, shown.url)
    if open_browser:
        shown.open()
    return shown
