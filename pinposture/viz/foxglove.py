"""An arm in Foxglove, live: frames, drawings, joint positions and the status of a control loop."""

from __future__ import annotations

import logging
import time
from collections import deque
from collections.abc import Callable
from contextlib import suppress
from copy import copy
from functools import partial
from threading import Event, Lock, Thread
from typing import Any
from urllib.parse import urlsplit

import numpy as np
import pinocchio as pin
from numpy.typing import ArrayLike, NDArray
from scipy.spatial.transform import Rotation

from pinposture.arm import Arm
from pinposture.arm.kinematics import neutral_placements
from pinposture.collision import CollisionModel, Scene
from pinposture.collision.bodies import scene_at
from pinposture.errors import InvalidValue, ViewerError, install
from pinposture.motion import Run, Tracker, Trajectory
from pinposture.motion.ros import world_frame
from pinposture.placement import Target
from pinposture.viz import drawing, palette
from pinposture.viz.body import TriangleMesh, ball, bodies, body_poses, merge
from pinposture.viz.meshcat import ANIMATION, Viewer
from pinposture.viz.palette import THEME

logger = logging.getLogger(__name__)

ADDRESS = "ws://127.0.0.1:8765"  # where Foxglove looks for a live connection
BACKLOG = 20  # length of the queue of states to send; when it is full, the oldest is dropped


class FoxgloveViewer(Viewer):
    """An arm in Foxglove; see `pinposture.viz.view`. It has the interface of `Viewer`, except `meshcat`.

    Topics are /tf (the links by name, in the frame "world", or "map" if a link is called "world"), /scene
    (drawings), /joint_states, /joint_commands and /status. Topics without subscribers or data are not sent.

    Attributes:
        tracker: the tracker whose state is shown, or None.
        context: the `foxglove.Context`, to log more.
    """

    def __init__(
        self,
        arm: Arm,
        run: Run | Trajectory | Tracker | None,
        target: Target | None,
        fps: float,
        url: str | None,
        scene: Scene | None,
    ) -> None:
        try:
            from foxglove import Channel, Context, channels, messages, start_server
            from foxglove.websocket import ServerListener
        except ImportError as error:
            advice = install("foxglove")
            raise ViewerError("foxglove", f"needs a further package: {advice} ({error})") from error
        self.tracker = run if isinstance(run, Tracker) else None
        self.run = None if isinstance(run, Tracker) else run
        drawing.require_fitting(arm, self.run, target)
        self.arm = arm
        self.target = target
        self.scene = scene
        self.ellipsoids = ()
        self._playback = None if self.run is None else drawing.playback(self.run, fps, ANIMATION.most_sent)
        self._messages: Any = messages
        self._world = world_frame(arm)
        self._draw_arm()
        kinds = {"/tf": channels.FrameTransformsChannel, "/scene": channels.SceneUpdateChannel}
        kinds |= dict.fromkeys(("/joint_states", "/joint_commands"), channels.JointStatesChannel)
        kinds |= {"/status": Channel}
        self.context = Context()
        self._channels: Any = {name: channel(name, context=self.context) for name, channel in kinds.items()}
        self._waiting: deque[Callable[[bool], None]] = deque(maxlen=BACKLOG)
        self._wake = Event()
        self._subscribed = Event()
        self._closed = Event()
        self._stop = Event()
        self._lock = Lock()
        self._drawn: tuple[Target | None, Scene | None] = None, None
        listener = type("Listener", (ServerListener,), {"on_subscribe": self._send_again})
        address = urlsplit(ADDRESS if url is None else url)
        try:
            if address.scheme != "ws":
                raise ValueError("no WebSocket")
            about: dict[str, Any] = {"host": address.hostname, "port": address.port, "context": self.context}
            self._server = start_server(name=arm.name, server_listener=listener(), **about)
        except (RuntimeError, ValueError) as error:
            reason = f"{error}; an address is, for instance, {ADDRESS}"
            raise ViewerError(f"foxglove at {address.geturl()!r}", reason) from None
        self._url = str(self._server.app_url())
        Thread(target=self._send, name="pinposture-foxglove", daemon=True).start()
        if self.run is not None:
            self.play()
        elif self.tracker is None:
            self.show(arm.neutral())

    @property
    def url(self) -> str:
        """The address that opens Foxglove in a browser."""
        return self._url

    def show(self, q: ArrayLike | None) -> None:
        """Show the arm at a configuration, and the state of the tracker; stop playing the run.

        This takes tens of microseconds and never raises: a background thread sends the state.

        Args:
            q: configuration, (nq,) [rad or m]; None or invalid values if a measurement is missing.
        """
        with self._lock:
            self._stop.set()
        target = self.target
        scene = self.scene
        command = None
        status = {}
        if self.tracker is not None:
            target = target or self.tracker.target
            scene = scene or self.tracker.scene
            known = self.tracker.report._asdict().items()
            status = {name: value for name, value in known if isinstance(value, str | float)}
            with suppress(InvalidValue):  # no command before the first measurement
                command = self.tracker.command
        self._put(q, target, scene, command, status)

    def play(self) -> None:
        """Play the run in a loop, from its start.

        Raises:
            InvalidValue: there is no run.
        """
        if self._playback is None:
            raise InvalidValue("run", None, "a run to play, as in view(arm, run)")
        self._stop.set()
        self._stop = Event()
        Thread(target=self._play, args=(self._playback, self._stop), daemon=True).start()

    def close(self) -> None:
        """Disconnect all clients and stop the server."""
        for event in (self._stop, self._closed, self._wake):
            event.set()
        self._server.stop()

    # The queue of states to send, and the threads that play and send.

    def _put(self, q: Any, *known: Any) -> None:
        self._waiting.append(partial(self._publish, time.time_ns(), copy(q), *known))
        self._wake.set()

    def _send_again(self, *about: object) -> None:
        """Send all drawings again, for a new subscriber."""
        self._subscribed.set()
        self._wake.set()

    def _play(self, shown: drawing.Timeline, stop: Event) -> None:
        run = shown.run
        motion = shown.motion
        means = (motion or run).mean_error
        pauses = np.diff(shown.key_times, append=shown.key_times[-1:]) / shown.fps
        while not stop.is_set():
            for row, pause in zip(shown.rows[shown.key_rows], pauses, strict=True):
                moving = None if motion is None else Target(motion.targets[row], motion.target_mask[row])
                status = {"status": run.status, "reason": run.reason, "mean_error": means[row]}
                scene = None if self.scene is None else run.scene_in(row, self.scene)
                with self._lock:  # not after a call of `show`
                    if not stop.is_set():
                        self._put(run.q[row], self.target or moving, scene, None, status)
                if stop.wait(pause):
                    break

    def _send(self) -> None:
        last = None
        failure = ""
        while self._wake.wait() and not self._closed.is_set():
            self._wake.clear()
            if self._subscribed.is_set() and last is not None and not self._waiting:
                self._waiting.append(last)
            while self._waiting:
                last = self._waiting.popleft()
                again = self._subscribed.is_set()
                self._subscribed.clear()
                try:
                    last(again)
                except Exception as error:  # must not stop the control loop
                    if failure != str(error):
                        logger.warning("foxglove: %s", error, exc_info=True)
                    failure = str(error)

    # Messages.

    def _publish(
        self,
        stamp: int,
        q: Any,
        target: Target | None,
        scene: Scene | None,
        command: NDArray[np.float64] | None,
        status: dict[str, Any],
        again: bool,
    ) -> None:
        """Log the state at a time [ns], with all drawings if `again`, else those that have changed."""
        placed = scene
        invalid = ""
        try:
            q = self.arm.checked(q)
        except InvalidValue as error:
            invalid = str(error)
        else:
            placed = None if scene is None else scene_at(self.arm, q, scene)
        if again or target is not self._drawn[0] or placed is not self._drawn[1]:
            self._log("/scene", stamp, self._draw, target, placed, again)
        if invalid:
            status = {"reason": invalid} | status
        else:
            self._log("/tf", stamp, self._place, q, stamp)
            self._log("/joint_states", stamp, self._joints, q, stamp)
            if scene is not None and self._channels["/status"].has_sinks():
                near = CollisionModel(self.arm, scene).minimum(q)
                status = status | {"clearance": near.distance, "nearest": " to ".join(near.pair or ())}
        if command is not None:
            self._log("/joint_commands", stamp, self._joints, command, stamp)
        told = {name: value for name, value in status.items() if isinstance(value, str) or np.isfinite(value)}
        self._log("/status", stamp, dict, told)

    def _log(self, topic: str, stamp: int, message: Callable[..., Any], *about: Any) -> None:
        if self._channels[topic].has_sinks():
            self._channels[topic].log(message(*about), log_time=stamp)

    def _place(self, q: ArrayLike, stamp: int) -> Any:
        m = self._messages
        poses = body_poses(self.arm, q)
        turns = Rotation.from_matrix(poses[:, :3, :3] @ self._turns).as_quat()
        rows = np.hstack([poses[:, :3, 3], turns]).tolist()
        time = m.Timestamp(*divmod(stamp, 10**9))
        transforms = [
            m.FrameTransform(
                timestamp=time,
                parent_frame_id=self._world,
                child_frame_id=link,
                translation=m.Vector3(x=row[0], y=row[1], z=row[2]),
                rotation=m.Quaternion(x=row[3], y=row[4], z=row[5], w=row[6]),
            )
            for link, row in zip(self._links, rows, strict=True)
        ]
        return m.FrameTransforms(transforms=transforms)

    def _joints(self, q: Any, stamp: int) -> Any:
        m = self._messages
        drives = self.arm.drives
        named = drives.named(drives.positions(self.arm.positions(q)))
        joints = [m.JointState(name=name, position=position) for name, position in named.items()]
        return m.JointStates(timestamp=m.Timestamp(*divmod(stamp, 10**9)), joints=joints)

    def _draw(self, target: Target | None, scene: Scene | None, again: bool) -> Any:
        entities = [*self._bodies] if again else []
        before, around = self._drawn
        self._drawn = target, scene
        if again or target is not before:
            entities.append(self._entity("target", self._world, **self._outline(target)))
        if again or scene is not around:
            shown = drawing.shown_obstacles(scene, drawing.scene_points(self.arm, None, target))
            solids = [
                self._surface(obstacle.surface, THEME.obstacle, THEME.see_through) for obstacle in shown
            ]
            entities.append(self._entity("obstacles", self._world, triangles=solids))
        return self._messages.SceneUpdate(entities=entities)

    def _draw_arm(self) -> None:
        model = self.arm.model
        listed = bodies(self.arm)
        surfaces = drawing.arm_surfaces(self.arm)
        joints = [model.getJointId(body.joint) for body in listed]
        placements = neutral_placements(model)
        # The frame of a joint is that of the link after it; a body frame has another orientation.
        frames = [frame for frame in model.frames if frame.type == pin.BODY and frame.placement.isIdentity()]
        names = {int(frame.parentJoint): frame.name for frame in reversed(frames)}
        self._links = [names.get(joint, model.names[joint]) for joint in joints]
        self._turns = np.array([placements[joint].rotation for joint in joints])
        self._bodies = [
            self._entity("base", self._world, triangles=[self._surface(surfaces.base, THEME.base)])
        ]
        for body, link, turn, mesh in zip(listed, self._links, self._turns, surfaces.bodies, strict=True):
            shade = THEME.modules[body.module % len(THEME.modules)]
            drawn = self._surface(TriangleMesh(mesh.vertices @ turn, mesh.faces), shade)
            self._bodies.append(self._entity(f"link {link}", link, triangles=[drawn]))

    def _outline(self, target: Target | None) -> dict[str, Any]:
        if target is None:
            return {}
        m = self._messages
        radius = drawing.link_radius(self.arm)
        style = {"type": m.LinePrimitiveLineType.LineStrip, "thickness": 0.6 * radius}
        lines = [
            m.LinePrimitive(points=self._points(line), color=self._color(color), **style)
            for color, pieces in zip(
                (THEME.target, THEME.rest), drawing.outline(self.arm, target), strict=True
            )
            for line in pieces
        ]
        balls = merge([ball(point, 0.84 * radius, 1) for point in target.points[target.has_target]])
        return {"lines": lines, "triangles": [self._surface(balls, THEME.target)]}

    def _entity(self, name: str, frame: str, **drawn: Any) -> Any:
        return self._messages.SceneEntity(id=name, frame_id=frame, frame_locked=True, **drawn)

    def _surface(self, mesh: TriangleMesh, color: str, opacity: float = 1.0) -> Any:
        corners = {"points": self._points(mesh.vertices), "indices": mesh.faces.ravel().tolist()}
        return self._messages.TriangleListPrimitive(color=self._color(color, opacity), **corners)

    def _color(self, color: str, opacity: float = 1.0) -> Any:
        red, green, blue = palette.rgb(color)
        return self._messages.Color(r=red, g=green, b=blue, a=opacity)

    def _points(self, rows: NDArray[np.float64]) -> list[Any]:
        return [self._messages.Point3(x=x, y=y, z=z) for x, y, z in rows.tolist()]
