"""A browser without a picture: it speaks the protocol of the page, and keeps what it is sent."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Any

import msgspec
import viser
import zstandard
from viser._messages import GuiUpdateMessage, Message, ViewerCameraMessage
from websockets.exceptions import ConnectionClosed
from websockets.sync.client import connect

SOON = 60.0
"""How long something that has to happen is waited for [s]."""


class Client:
    """A browser without a picture.

    Args:
        url: the address of the page.
        named: what else `websockets.sync.client.connect` takes, such as `origin`.
    """

    def __init__(self, url: str, **named: Any) -> None:
        self._socket = connect(
            url.replace("http", "ws", 1),
            subprotocols=[f"viser-v{viser.__version__}"],  # type: ignore[list-item]
            compression=None,
            max_size=None,
            **named,
        )
        self.messages: list[dict[str, Any]] = []
        self._thread = threading.Thread(target=self._listen, daemon=True)
        self._thread.start()
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

    def set(self, label: str, value: object) -> None:
        """Set a control, by what stands before it; True presses a button."""

        def made() -> list[str]:
            sent = [each for each in self.messages if each.get("props", {}).get("label") == label]
            return [each["uuid"] for each in sent]

        until(lambda: bool(made()), f"there is a control {label!r}")
        self._tell(GuiUpdateMessage(made()[-1], {"value": value}))

    def shown(self, *keys: str) -> list[str]:
        """Texts that were sent, of any control and at any time, by the names of their properties."""
        told = [each.get(part) for each in tuple(self.messages) for part in ("props", "updates")]
        return [each[key] for each in told if isinstance(each, dict) for key in keys if each.get(key)]

    def close(self) -> None:
        """Leave."""
        self._socket.close()
        self._thread.join()

    def _tell(self, message: Message) -> None:
        self._socket.send(msgspec.msgpack.encode(message.as_serializable_dict()))

    def _listen(self) -> None:
        unpack = zstandard.ZstdDecompressor()
        try:
            for raw in self._socket:
                assert isinstance(raw, bytes)
                size = int.from_bytes(raw[8:16], "little")
                self.messages += msgspec.msgpack.decode(unpack.decompress(raw[16 : 16 + size]))["messages"]
        except ConnectionClosed:
            return


@contextmanager
def visiting(url: str, **named: Any) -> Iterator[Client]:
    """A client that leaves at the end."""
    client = Client(url, **named)
    try:
        yield client
    finally:
        client.close()


def until(met: Callable[[], object], what: str = "so in time") -> None:
    """Wait until something is so; fail if it takes too long."""
    end = time.monotonic() + SOON
    while not met():
        assert time.monotonic() < end, f"not: {what}"
        time.sleep(0.01)
