"""The arm in the browser by way of a meshcat server."""

from __future__ import annotations

import contextlib
import io
import subprocess
import webbrowser
from collections.abc import Iterable
from types import TracebackType
from typing import NamedTuple

import numpy as np
import zmq
from numpy.typing import ArrayLike, NDArray

from pinposture.arm import Arm, ControlPoints
from pinposture.arm.manipulability import chosen_points
from pinposture.collision import Scene
from pinposture.errors import InvalidValue, ViewerError
from pinposture.motion import Motion, Trajectory
from pinposture.placement import Target
from pinposture.viz.animation import Film, film, moving_target_commands, moving_target_tracks, tracks
from pinposture.viz.axes import Place, alike, shown_places
from pinposture.viz.drawing import (
    ROOT,
    Command,
    Track,
    animate,
    arm_commands,
    delete,
    near_corners,
    obstacle_commands,
    pack,
    pose_commands,
    require_fitting,
    shown_obstacles,
    stage_commands,
    stage_points,
    target_commands,
)
from pinposture.viz.ellipsoids import ball_commands, ball_ends, ball_tracks, balls

# The line to a meshcat server, which passes drawing commands on to browsers.

PATIENCE = 10_000
"""How long to wait for an answer [ms]."""


class Server:
    """A meshcat server: one that runs already, or one of our own that ends with us.

    Args:
        address: where a server listens for commands, as in "tcp://127.0.0.1:6000"; None to start one, which
            takes commands from this machine only; its page is served to others, too (see SECURITY.md).

    Attributes:
        address: where it listens for commands.
        url: what to open in a browser.

    Raises:
        ViewerError: it cannot be started or does not answer.
    """

    def __init__(self, address: str | None = None) -> None:
        self._process: subprocess.Popen[bytes] | None = None
        self._socket: zmq.Socket[bytes] | None = None
        if address is None:
            self._process, self.address, self.url = _start()
        else:
            self.address = address
            self._socket = self._connect()
            self.url = self._answer([b"url"])
            # The server does not take commands on a line on which it was asked for its address.
            self._socket.close()
        self._socket = self._connect()

    def send(self, commands: Iterable[Command]) -> None:
        """Have every browser, now and later, carry out commands.

        Raises:
            ViewerError: the server does not answer, or was closed.
        """
        for command in commands:
            kind, place = str(command["type"]), str(command["path"])
            answer = self._answer([kind.encode(), place.encode(), pack(command)])
            if answer != "ok":
                raise ViewerError(f"meshcat server at {self.address}", f"refused {kind!r}: {answer}")

    def close(self) -> None:
        """Hang up, and end the server if it is our own."""
        if self._socket is not None:
            self._socket.close()
            self._socket = None
        if self._process is not None:
            self._process.kill()
            self._process.communicate()
            self._process = None

    def _connect(self) -> zmq.Socket[bytes]:
        socket: zmq.Socket[bytes] = zmq.Context.instance().socket(zmq.REQ)
        socket.setsockopt(zmq.LINGER, 0)
        socket.setsockopt(zmq.RCVTIMEO, PATIENCE)
        socket.setsockopt(zmq.SNDTIMEO, PATIENCE)
        try:
            socket.connect(self.address)
        except zmq.ZMQError as error:
            socket.close()
            raise ViewerError(
                f"meshcat server at {self.address!r}", f"{error}; e.g. tcp://127.0.0.1:6000"
            ) from None
        return socket

    def _answer(self, message: list[bytes]) -> str:
        if self._socket is None:
            raise ViewerError(f"meshcat server at {self.address}", "the viewer was closed")
        try:
            self._socket.send_multipart(message)
            return self._socket.recv().decode()
        except zmq.ZMQError as error:
            self.close()
            late = isinstance(error, zmq.Again)
            reason = f"no answer within {PATIENCE / 1000:.0f} s" if late else str(error)
            raise ViewerError(f"meshcat server at {self.address}", reason) from None


def _start() -> tuple[subprocess.Popen[bytes], str, str]:
    # Imported late: meshcat brings IPython along, which takes longer to load than all the rest.
    from meshcat.servers.zmqserver import start_zmq_server_as_subprocess

    said = io.StringIO()
    try:
        with contextlib.redirect_stdout(said):  # where it says why it could not start
            process, address, url = start_zmq_server_as_subprocess()
    except (RuntimeError, OSError, ValueError) as error:
        last = said.getvalue().strip().splitlines()[-1:]
        raise ViewerError(
            "meshcat server", f"cannot be started ({'; '.join([str(error), *last])})"
        ) from error
    return process, address, url


# All that the browser is to draw and to move: an arm, its run or motion, targets, obstacles, ellipsoids.

Array = NDArray[np.float64]


class Staged(NamedTuple):
    """What the browser is told.

    Attributes:
        drawn: what to draw, the first configuration of the arm included.
        tracks: how that moves; nothing if there is nothing to play.
        obstacles: whether there are obstacles in the picture.
        places: the named places of a motion with lines of their own, those that look alike together.
    """

    drawn: list[Command]
    tracks: list[Track]
    obstacles: bool
    places: list[list[Place]]


def staged(
    arm: Arm, shown: Film | None, target: Target | None, scene: Scene | None, points: tuple[int, ...]
) -> Staged:
    """Set up a scene.

    Args:
        arm: the arm.
        shown: what to play; None to show the arm at its neutral configuration.
        target: a target that stays where it is; None if there is none.
        scene: what surrounds the arm; None if nothing.
        points: control points with an ellipsoid, 0-based.
    """
    rows = arm.neutral()[None] if shown is None else shown.run.q[shown.rows]
    run, motion = (None, None) if shown is None else (shown.run, shown.motion)
    ellipsoids = balls(arm, points, rows)
    stage = np.vstack([stage_points(arm, run, target), ball_ends(ellipsoids)])
    places: list[list[Place]] = []
    if motion is not None:
        stage = np.vstack([stage, motion.targets[motion.asked]])
        places = alike(motion, shown_places(motion))
    obstacles = shown_obstacles(scene, stage)
    drawn = [
        *stage_commands(arm, np.vstack([stage, near_corners(obstacles)])),
        *arm_commands(arm, rows[0]),
        *([] if target is None else target_commands(arm, target)),
        *([] if motion is None else moving_target_commands(motion, [group[0] for group in places])),
        *obstacle_commands(obstacles),
        *ball_commands(ellipsoids),
    ]
    moving: list[Track] = []
    if shown is not None:
        moving = [*tracks(arm, shown), *ball_tracks(ellipsoids, shown)]
        moving += [] if motion is None else moving_target_tracks(motion, shown)
    return Staged(drawn, moving, bool(obstacles), places)


# The arm in the browser, by way of a meshcat server.

MOST_FRAMES = 2000
"""Configurations of a run or a motion that are sent to the browser at most."""


class MeshcatViewer:
    """An arm in the browser; see `pinposture.viz.view`.

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
