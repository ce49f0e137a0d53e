"""A browser without a picture: it speaks the protocol of a page of viser."""

from __future__ import annotations

import threading
from typing import Any

import msgspec
import viser
import zstandard
from viser._messages import Message, ViewerCameraMessage
from websockets.exceptions import ConnectionClosed
from websockets.sync.client import connect


class PageClient:
    """A client of a page; a derived class takes what it is sent.

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

    def close(self) -> None:
        """Leave."""
        self._socket.close()
        self._thread.join()

    def _take(self, messages: list[dict[str, Any]]) -> None:
        """Take what the page has sent."""
        raise NotImplementedError

    def _tell(self, message: Message) -> None:
        self._socket.send(msgspec.msgpack.encode(message.as_serializable_dict()))

    def _listen(self) -> None:
        unpack = zstandard.ZstdDecompressor()
        try:
            for raw in self._socket:
                assert isinstance(raw, bytes)
                size = int.from_bytes(raw[8:16], "little")
                self._take(msgspec.msgpack.decode(unpack.decompress(raw[16 : 16 + size]))["messages"])
        except ConnectionClosed:
            return
