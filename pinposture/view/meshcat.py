"""The arm in the browser, by way of a meshcat server."""

from __future__ import annotations

import webbrowser
from types import TracebackType

from numpy.typing import ArrayLike

from pinposture.arm import Arm, ControlPoints
from pinposture.arm.ellipsoid import chosen_points
from pinposture.errors import InvalidValue
from pinposture.motion import Motion, Trajectory
from pinposture.scene import Scene
from pinposture.target import Target
from pinposture.view.animation import film
from pinposture.view.commands import animate, delete
from pinposture.view.moving_ellipsoids import ball_commands, balls
from pinposture.view.scene import ROOT, pose_commands, require_fitting
from pinposture.view.server import Server
from pinposture.view.staging import staged

MOST_FRAMES = 2000
"""Configurations of a run or a motion that are sent to the browser at most."""


class MeshcatViewer:
    """An arm in the browser; see `pinposture.view.view`.

    Also a context manager that closes itself. The scene is shifted so that what happens is in its middle,
    because that is what the viewer's camera turns about.

    Attributes:
        arm: the arm.
        run: the run, or the motion in time, that `play` plays, or None.
        target: the target shown, or None.
        scene: what surrounds the arm, or None.
        ellipsoids: indices of the control points with an ellipsoid, 0-based.
    """

    def __init__(
        self,
        arm: Arm,
        run: Trajectory | Motion | None,
        target: Target | None,
        fps: float,
        url: str | None,
        ellipsoids: ControlPoints = (),
        scene: Scene | None = None,
    ) -> None:
        require_fitting(arm, run, target)
        self.arm, self.run, self.target, self.scene = arm, run, target, scene
        self.ellipsoids = chosen_points(arm.control_points, ellipsoids)
        self._film = None if run is None else film(run, fps, MOST_FRAMES)
        setting = staged(arm, self._film, target, scene, self.ellipsoids)
        self._tracks = setting.tracks
        self._playing = False
        self._server = Server(url)
        try:
            self._server.send([delete(ROOT), *setting.drawn])
            if run is not None:
                self.play()
        except BaseException:
            self._server.close()
            raise

    @property
    def url(self) -> str:
        """What to open in a browser; any number of them may, at any time."""
        return self._server.url

    def open(self) -> None:
        """Open a browser on this computer."""
        webbrowser.open(self.url, new=2)

    def show(self, q: ArrayLike) -> None:
        """Show the arm at a configuration, in place of the run if that is being played.

        Takes about a millisecond per joint and ellipsoid; 20 times a second is as much as a browser follows.

        Args:
            q: configuration, (nq,) [rad or m].

        Raises:
            InvalidValue: q has the wrong size or is not finite.
            ViewerError: the viewer was closed, or its server does not answer.
        """
        q = self.arm.checked(q)
        commands = [*pose_commands(self.arm, q), *ball_commands(balls(self.arm, self.ellipsoids, q[None]))]
        if self._playing and self._film is not None:
            commands = [animate([], self._film.fps), *commands]
            self._playing = False
        self._server.send(commands)

    def play(self) -> None:
        """Play the run from its start, over and over; the browser does so on its own.

        Raises:
            InvalidValue: there is no run.
            ViewerError: the viewer was closed, or its server does not answer.
        """
        if self._film is None:
            raise InvalidValue("run", None, "a run to play, as in view(arm, run)")
        self._server.send([animate(self._tracks, self._film.fps)])
        self._playing = True

    def close(self) -> None:
        """End the viewer, and its server if that was started for it."""
        self._server.close()

    def __enter__(self) -> MeshcatViewer:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()

    def __repr__(self) -> str:
        return f"MeshcatViewer({self.url})"
