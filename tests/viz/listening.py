"""What a browser would be told, by a meshcat server or by a page."""

from __future__ import annotations

import base64
import re

import umsgpack
import zmq
from meshcat import Visualizer

from pinposture.viz.meshcat import CommandRecorder


def held(address: str) -> list[dict]:
    """What the server would tell a browser that comes now, in its order."""
    with zmq.Context.instance().socket(zmq.REQ) as line:
        line.setsockopt(zmq.LINGER, 0)
        line.setsockopt(zmq.RCVTIMEO, 10_000)
        line.connect(address)
        line.send(b"get_scene")
        page = line.recv().decode()
    packed = re.findall(r'fetch\("data:application/octet-binary;base64,([^"]*)"\)', page)
    return [umsgpack.unpackb(base64.b64decode(data)) for data in packed]


def told(draw, *args) -> list[dict]:
    """The commands of a function that draws into a viewer."""
    recording = CommandRecorder()
    draw(Visualizer(window=recording), *args)
    return [umsgpack.unpackb(command) for command in recording.packed]
