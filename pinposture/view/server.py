"""The line to a meshcat server, which passes drawing commands on to browsers."""

from __future__ import annotations

import contextlib
import io
import subprocess
from collections.abc import Iterable

import zmq

from pinposture.errors import ViewerError
from pinposture.view.commands import Command, pack

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
