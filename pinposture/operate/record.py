"""Runs of an operator on file, as MCAP: what was held, commanded and measured, the map, and why."""

from __future__ import annotations

import json
import math
import time
from base64 import b64decode, b64encode
from collections.abc import Iterator
from pathlib import Path
from queue import SimpleQueue
from threading import Event, Thread
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pinposture.arm import Arm
from pinposture.collision import Scene
from pinposture.collision.mapping import SEEN
from pinposture.collision.scan import Cells
from pinposture.errors import FileError, PostureError, install
from pinposture.motion.ros import NANOSECONDS, world_frame
from pinposture.operate.control import DIRECTIONS, Control
from pinposture.operate.operation import Shown
from pinposture.operate.ways import CurveAlong, Planned
from pinposture.storage import check_writable

Array = NDArray[np.float64]

CYCLES = "/operation"
MAP = "/map"
"""Topics of a recording, beside /joint_states and /joint_commands."""

FORMAT = 1
"""Version of the messages on /operation."""


class Recorder:
    """Writes each cycle of an operation to a file, in a thread of its own.

    Topics are /operation (JSON: what was held, the mode and why, configurations), /joint_states and
    /joint_commands, and /map (a point cloud, whenever the map has changed), for Foxglove as for `Recording`.

    Attributes:
        path: the file.

    Args:
        arm: the arm.
        path: a new file, with the suffix .mcap.

    Raises:
        FileError: the extra `foxglove` is missing, the file exists, or cannot be written.
    """

    def __init__(self, arm: Arm, path: str | Path) -> None:
        self.path = Path(path)
        try:
            from foxglove import Channel, Context, Schema, channels, messages, open_mcap
        except ImportError:
            raise FileError(self.path, f"recordings need another package; {install('foxglove')}") from None
        check_writable(self.path.parent)
        self._arm = arm
        self._messages: Any = messages
        self._context = context = Context()  # its channels close with it
        try:
            self.path.parent.mkdir(parents=True, exist_ok=True)
            self._file = open_mcap(self.path, context=context)
        except (OSError, RuntimeError) as error:
            raise FileError(self.path, f"cannot be written ({error}); allowed: a new file") from error
        self._cycles = Channel(CYCLES, message_encoding="json", context=context)
        # What a cloud consists of: that of Foxglove, as JSON, which needs no compiler of messages to be read.
        cloud = {
            "type": "object",
            "title": "foxglove.PointCloud",
            "properties": {
                "timestamp": {"type": "object"},
                "pose": {"type": "object"},
                "frame_id": {"type": "string"},
                "point_stride": {"type": "integer"},
                "fields": {"type": "array", "items": {"type": "object"}},
                "data": {"type": "string", "contentEncoding": "base64"},
            },
        }
        schema = Schema(name="foxglove.PointCloud", encoding="jsonschema", data=json.dumps(cloud).encode())
        self._map = Channel(MAP, schema=schema, message_encoding="json", context=context)
        joints = channels.JointStatesChannel
        self._joints = {
            topic: joints(topic, context=context) for topic in ("/joint_states", "/joint_commands")
        }
        self._cells: Cells | None = None
        self._begin = time.time_ns()
        self._first: float | None = None
        self._queue: SimpleQueue[Shown | None] = SimpleQueue()
        self._thread = Thread(target=self._write, name="pinposture-recorder", daemon=True)
        self._thread.start()

    def add(self, shown: Shown) -> None:
        """Record a cycle; returns at once."""
        self._queue.put(shown)

    def close(self) -> None:
        """Write what is still to be written, and close the file."""
        self._queue.put(None)
        self._thread.join()
        self._file.close()

    def _write(self) -> None:
        for shown in iter(self._queue.get, None):
            self._write_cycle(shown)

    def _write_cycle(self, shown: Shown) -> None:
        self._first = shown.time if self._first is None else self._first
        stamp = self._begin + round((shown.time - self._first) * NANOSECONDS)
        cells = shown.scene.obstacles.get(SEEN)
        if isinstance(cells, Cells) and cells is not self._cells:
            self._cells = cells
            self._map.log(self._cloud(cells, stamp), log_time=stamp)
        for topic, q in zip(self._joints, (shown.measured, shown.commanded), strict=True):
            if q is not None:
                self._joints[topic].log(self._states(q, stamp), log_time=stamp)
        self._cycles.log(_described(shown), log_time=stamp)

    def _states(self, q: Array, stamp: int) -> Any:
        m = self._messages
        named = dict(zip(self._arm.joint_names, self._arm.positions(q).tolist(), strict=True))
        joints = [m.JointState(name=name, position=position) for name, position in named.items()]
        return m.JointStates(timestamp=m.Timestamp(*divmod(stamp, NANOSECONDS)), joints=joints)

    def _cloud(self, cells: Cells, stamp: int) -> dict[str, Any]:
        """Return a map as a cloud of Foxglove."""
        seconds, nanoseconds = divmod(stamp, NANOSECONDS)
        float32 = 7  # type of single precision in a foxglove.PointCloud
        return {
            "timestamp": {"sec": seconds, "nsec": nanoseconds},
            "frame_id": world_frame(self._arm),
            "pose": {
                "position": dict.fromkeys("xyz", 0.0),
                "orientation": dict.fromkeys("xyz", 0.0) | {"w": 1.0},
            },
            "point_stride": 12,
            "fields": [{"name": name, "offset": 4 * k, "type": float32} for k, name in enumerate("xyz")],
            "data": b64encode(cells.points.astype("<f4").tobytes()).decode(),
        }


def _described(shown: Shown) -> dict[str, Any]:
    """Return a cycle as plain data."""
    order = shown.order
    held = None
    if order is not None:
        ways = dict(zip(DIRECTIONS, order.direction.tolist(), strict=True))
        held = ways | {"override": order.override, "along": order.along, "way": order.way}
    cells = shown.scene.obstacles.get(SEEN)
    return {
        "format": FORMAT,
        "mode": shown.mode,
        "reason": shown.reason,
        "order": held,
        "measured": None if shown.measured is None else shown.measured.tolist(),
        "commanded": None if shown.commanded is None else shown.commanded.tolist(),
        "planned": shown.planned.text,
        "goal": None if shown.planned.goal is None else shown.planned.goal.tolist(),
        "stuck": shown.stuck,
        "status": "" if shown.report is None else shown.report.status,
        "cell": cells.point_radius if isinstance(cells, Cells) else 0.0,
    }


def read_recording(arm: Arm, path: str | Path, scene: Scene) -> Iterator[Shown]:
    """Yield the cycles of a recording, with times from 0 on.

    Args:
        arm: the arm.
        path: the file.
        scene: the obstacles that are known; the map of the recording is added.

    Raises:
        FileError: the extra `foxglove` is missing, or it is no recording of this arm.
    """
    path = Path(path)
    try:
        from mcap.exceptions import McapError
        from mcap.reader import make_reader
    except ImportError:
        raise FileError(path, f"recordings need another package; {install('foxglove')}") from None
    begin: int | None = None
    radius = 0.0
    points = np.zeros((0, 3))
    here = scene
    try:
        with path.open("rb") as file:
            for _, channel, message in make_reader(file).iter_messages(topics=[CYCLES, MAP]):
                told = json.loads(message.data)
                if channel.topic == MAP:
                    points = np.frombuffer(b64decode(told["data"]), dtype="<f4").reshape(-1, 3).astype(float)
                    radius = 0.0
                    continue
                if told["format"] != FORMAT:
                    raise FileError(path, f"is of the format {told['format']}; allowed: {FORMAT}")
                if told["cell"] != radius:
                    radius = float(told["cell"])
                    ball = 0.5 * math.sqrt(3.0)  # radius of that around a cell, in edge lengths
                    cells = Cells.of(points, radius / ball)
                    here = scene.with_obstacles({**scene.obstacles, SEEN: cells})
                begin = message.log_time if begin is None else begin
                yield _shown(arm, told, here, (message.log_time - begin) / NANOSECONDS)
    except FileError:
        raise
    except OSError as error:
        raise FileError(path, f"cannot be read ({error.strerror or error})") from error
    except (McapError, KeyError, TypeError, ValueError, PostureError) as error:
        raise FileError(path, f"is no recording of this arm ({type(error).__name__}: {error})") from error
    if begin is None:
        raise FileError(
            path, f"has no messages on {CYCLES}; allowed: a file that `pinposture operate` recorded"
        )


def _shown(arm: Arm, told: dict[str, Any], scene: Scene, at: float) -> Shown:
    """Return a cycle of a recording at a time [s]."""
    q = {
        name: None if told[name] is None else arm.checked(np.array(told[name]), name)
        for name in ("measured", "commanded", "goal")
    }
    return Shown(
        measured=q["measured"],
        commanded=q["commanded"],
        scene=scene,
        mode=str(told["mode"]),
        reason=str(told["reason"]),
        report=None,
        line=np.zeros((0, 3)),
        order=None,
        led=None,
        planned=Planned(0, str(told["planned"]), q["goal"], np.zeros((0, 3))),
        stuck=str(told["stuck"]),
        time=at,
    )


class Replay:
    """Shows a recording as an operation was shown: in its own time, again and again.

    Attributes:
        arm: the arm.
        control: takes messages of pages, which move nothing.
        kind: what is shown, in words.
        shown: the cycle; may be read from any thread.

    Args:
        arm: the arm.
        path: the recording.
        scene: the obstacles that are known.

    Raises:
        FileError: as `read_recording`.
    """

    def __init__(self, arm: Arm, path: str | Path, scene: Scene) -> None:
        self.arm = arm
        self.control = Control()
        self.kind = f"a recording: {Path(path).name}"
        self._cycles = list(read_recording(arm, path, scene))
        self._times = np.array([cycle.time for cycle in self._cycles])
        self.shown = self._cycles[0]._replace(time=time.monotonic())

    def run(self, stop: Event) -> None:
        """Replay it until it is stopped."""
        begun = time.monotonic()
        while not stop.wait(0.02):
            passed = (time.monotonic() - begun) % (self._times[-1] + 2.0)  # the last one stays for 2 s
            cycle = self._cycles[int(np.searchsorted(self._times, passed, side="right")) - 1]
            self.shown = cycle._replace(time=time.monotonic())

    def reshape(self, curve: CurveAlong) -> None:
        """Do nothing: what was is not changed any more."""

    def close(self) -> None:
        """Do nothing; there is nothing to be ended."""
