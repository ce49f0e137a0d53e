"""How often the arm moves in the page while a hand drags, and how long after the hand.

    python benchmarks/editor.py --modules 20 100

A client that speaks the protocol of the page, without drawing, drags a control point in circles and looks at
what it is sent: how many postures of the arm a second, while it tells of its moves twenty times a second, as
browsers do, and as often as it likes; and how long after a single move from rest the first posture towards it
comes. What a browser needs to draw is not in these figures. Besides, how long least squares take that lay the
arm on the curve, where Algorithm 1 would zigzag: from the straight arm, and from where it was.
"""

from __future__ import annotations

import argparse
import json
import statistics
import threading
import time
from typing import Any

import msgspec
import numpy as np
import viser
import zstandard
from viser._messages import Message, SceneNodeDragMessage, ViewerCameraMessage
from websockets.exceptions import ConnectionClosed
from websockets.sync.client import ClientConnection, connect

import pinposture as pp
from pinposture.editor import Editor
from pinposture.editor.first_task import first_task

PACES = {"as browsers": 0.05, "at will": 0.01}
"""How often the client tells of a drag [s]."""

RADIUS, ROUNDS = 0.08, 0.5
"""Of the circles, relative to the arm; and how many a second."""

REST = 0.3
"""Without a posture for so long, the arm is at rest [s]."""


class Client:
    """A browser without a picture."""

    def __init__(self, url: str) -> None:
        address = url.replace("http", "ws", 1)
        self._socket: ClientConnection = connect(
            address, subprotocols=[f"viser-v{viser.__version__}"], compression=None, max_size=None
        )
        self.postures: list[float] = []  # when each came
        threading.Thread(target=self._listen, daemon=True).start()
        # A browser counts from the first time that it says where it looks from.
        self._tell(
            ViewerCameraMessage(
                wxyz=(1.0, 0.0, 0.0, 0.0),
                position=(0.0, -2.0, 0.0),
                fov=0.7,
                near=0.01,
                far=100.0,
                image_height=720,
                image_width=1280,
                look_at=(0.0, 0.0, 0.0),
                up_direction=(0.0, 0.0, 1.0),
            )
        )

    def drag(self, name: str, phase: str, start: np.ndarray, end: np.ndarray) -> None:
        """Tell of a drag."""
        message = SceneNodeDragMessage(
            phase=phase,  # type: ignore[arg-type]
            name=name,
            instance_index=None,
            start_position=tuple(map(float, start)),  # type: ignore[arg-type]
            start_screen_pos=(0.5, 0.5),
            end_position=tuple(map(float, end)),  # type: ignore[arg-type]
            end_screen_pos=(0.5, 0.5),
            button="left",
            modifier=None,
        )
        self._tell(message)

    def _tell(self, message: Message) -> None:
        self._socket.send(msgspec.msgpack.encode(message.as_serializable_dict()))

    def close(self) -> None:
        """Leave."""
        self._socket.close()

    def _listen(self) -> None:
        unpack = zstandard.ZstdDecompressor()
        try:
            for raw in self._socket:
                assert isinstance(raw, bytes)
                size = int.from_bytes(raw[8:16], "little")
                messages = msgspec.msgpack.decode(unpack.decompress(raw[16 : 16 + size]))["messages"]
                if any(map(_moves_the_arm, messages)):
                    self.postures.append(time.perf_counter())
        except ConnectionClosed:
            return


def _moves_the_arm(message: dict[str, Any]) -> bool:
    arm = str(message.get("name", "")).startswith("/arm/")
    return arm and "batched_positions" in message.get("updates", ())


def rested(client: Client) -> None:
    """Wait until the arm is at rest."""
    while not client.postures or time.perf_counter() - client.postures[-1] < REST:
        time.sleep(0.05)


def resolving(arm: pp.Arm, moves: int) -> dict[str, float]:
    """How long it takes to lay the arm on a curve that leaves its base at an angle, as it is dragged."""
    points = arm.length * np.linspace([0.0, 0.0, 0.0], [1.1, 0.0, 0.3], 6)
    near, took = None, []
    for k in range(moves + 1):
        points[1] = arm.length * np.array([0.2, 0.04 + 0.002 * k, 0.1])
        begun = time.perf_counter()
        near = pp.resolve_targets(arm, pp.Curve.spline(points), placement="as_is", method="smooth", near=near)
        took.append(1e3 * (time.perf_counter() - begun))
    return {"least squares, anew [ms]": took[0], "least squares, near [ms]": statistics.median(took[1:])}


def measure(modules: int, seconds: float, moves: int) -> dict[str, float]:
    """Drag, and see what comes of it."""
    arm = pp.Arm.from_template("RyRz", modules=modules)
    resolved = resolving(arm, moves)
    editor = Editor(first_task(arm), port=8300)
    editor.start()
    client = Client(editor.url)
    try:
        time.sleep(2.0)
        name, home = "/handles/point_5", np.array(editor.session.shape.points[4])
        reach = RADIUS * arm.length
        across = np.array([0.0, 1.0, 0.0])

        rates: dict[str, float] = {}
        for pace, every in PACES.items():
            client.drag(name, "start", home, home)
            begun = due = time.perf_counter()
            while (passed := time.perf_counter() - begun) < seconds:
                angle = 2.0 * np.pi * ROUNDS * passed
                place = home + reach * np.array([0.0, np.sin(angle), 1.0 - np.cos(angle)])
                client.drag(name, "update", home, place)
                due += every
                time.sleep(max(0.0, due - time.perf_counter()))
            came = [t for t in client.postures if begun + 0.5 < t < begun + seconds]
            rates[f"postures a second, {pace}"] = len(came) / (seconds - 0.5)
            rates[f"longest gap [ms], {pace}"] = 1e3 * float(np.diff(came).max())
            client.drag(name, "end", home, home)
            rested(client)

        lags = []
        for k in range(moves):
            rested(client)
            before = len(client.postures)
            sent = time.perf_counter()
            place = home + reach * (1.0 if k % 2 else -1.0) * across
            client.drag(name, "start", home, place)
            client.drag(name, "end", home, place)
            while len(client.postures) == before and time.perf_counter() - sent < 5.0:
                time.sleep(0.0005)
            lags.append(client.postures[before] - sent)
        return {
            "modules": modules,
            "joints": arm.nv,
            **rates,
            "lag, median [ms]": 1e3 * statistics.median(lags),
            "lag, longest [ms]": 1e3 * max(lags),
            **resolved,
        }
    finally:
        client.close()
        editor.close()


def main() -> None:
    """Measure and print."""
    kind = argparse.RawDescriptionHelpFormatter
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=kind)
    parser.add_argument("--modules", type=int, nargs="+", default=[20, 100], help="arms to try")
    parser.add_argument("--seconds", type=float, default=6.0, help="how long to drag")
    parser.add_argument("--moves", type=int, default=15, help="single moves from rest")
    parser.add_argument("--json", action="store_true", help="print JSON")
    given = parser.parse_args()
    rows = [measure(modules, given.seconds, given.moves) for modules in given.modules]
    if given.json:
        print(json.dumps(rows, indent=2))
        return
    for key in rows[0]:
        print(f"{key:32s}" + "".join(f"{row[key]:12.4g}" for row in rows))


if __name__ == "__main__":
    main()
