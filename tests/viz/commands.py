"""The commands that a browser receives from a meshcat server or a page."""

from __future__ import annotations

import base64
import re

import umsgpack
import zmq
from meshcat import Visualizer

from pinposture.viz.meshcat import CommandRecorder


def server_commands(address: str) -> list[dict]:
    """Return the commands that a server sends to a new browser, in order."""
    with zmq.Context.instance().socket(zmq.REQ) as line:
        line.setsockopt(zmq.LINGER, 0)
        line.setsockopt(zmq.RCVTIMEO, 10_000)
        line.connect(address)
        line.send(b"get_scene")
        page = line.recv().decode()
    packed = re.findall(r'fetch\("data:application/octet-binary;base64,([^"]*)"\)', page)
    return [umsgpack.unpackb(base64.b64decode(data)) for data in packed]


def recorded_commands(draw, *args) -> list[dict]:
    """Return the commands of a function that draws into a viewer."""
    recording = CommandRecorder()
    draw(Visualizer(window=recording), *args)
    return [umsgpack.unpackb(command) for command in recording.packed]
