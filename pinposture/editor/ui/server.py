"""The server of the page, and who is let in: whoever has the address that was printed, and no other web page.

A web page that somebody has open can call servers on that machine. So each call, of the page as of its
websocket, must name this machine (`Host`: another name can be made to lead here), come from this page
(`Origin`), and have the secret of the address in its path. The page of viser connects to the path that it
was loaded from, so the secret needs no cookie, which other servers of the same machine would be sent.
"""

from __future__ import annotations

import contextlib
import hmac
import io
import ipaddress
import logging
import secrets
import socket
from collections.abc import Iterator
from dataclasses import replace
from http import HTTPStatus
from threading import Lock
from typing import Any
from urllib.parse import urlsplit

import viser
import websockets.asyncio.server
from viser._messages import ShareUrlDisconnect, ShareUrlRequest
from websockets import Headers, Request, Response
from websockets.asyncio.server import ServerConnection

from pinposture.errors import ViewerError

HEADERS = {
    "Referrer-Policy": "no-referrer",  # a link must not tell the address
    "X-Frame-Options": "DENY",  # nor another page show this one, and have it clicked on
    "X-Content-Type-Options": "nosniff",
    "Cache-Control": "no-store",
}
"""What browsers are told besides the page."""

_patching = Lock()


class Entrance:
    """Who is let in.

    Args:
        host: the address that is listened at.

    Attributes:
        secret: what the path of each call begins with; another one each time.
    """

    def __init__(self, host: str) -> None:
        self.secret = secrets.token_urlsafe(32)
        self._host, self._own = host.lower(), is_loopback(host)

    def refusal(self, path: str, headers: Headers) -> str:
        """Why a call is not let in; empty if it is."""
        hosts, origins = headers.get_all("Host"), headers.get_all("Origin")
        if len(hosts) != 1 or not self._names(hosts[0]):
            return "the call is not addressed to this machine"
        if len(origins) > 1 or (origins and not _same(origins[0], hosts[0])):
            return "the call comes from another web page"
        given = path.partition("?")[0].removeprefix("/").partition("/")[0]
        if not hmac.compare_digest(given.encode(), self.secret.encode()):
            return "the address is not the whole one that was printed at the start"
        return ""

    def _names(self, host: str) -> bool:
        """Whether a host, with or without a port, is surely this machine: no name that others can define."""
        try:
            name = urlsplit(f"//{host}").hostname or ""
        except ValueError:
            return False
        if name in ("localhost", self._host):
            return True
        try:
            address = ipaddress.ip_address(name)
        except ValueError:
            return not self._own and name == socket.gethostname().lower()
        return address.is_loopback or not self._own


def is_loopback(host: str) -> bool:
    """Whether only programs on this machine reach an address."""
    try:
        return host.lower() == "localhost" or ipaddress.ip_address(host).is_loopback
    except ValueError:
        return False


def serve(host: str, port: int) -> tuple[viser.ViserServer, str]:
    """Serve a page, without what viser would print.

    Args:
        host: at which address to listen.
        port: at which port; the next one that is free if it is taken.

    Returns:
        The server, and the address for browsers on this machine.

    Raises:
        ViewerError: it cannot be served, or this viser does not ask who may come in.
    """
    _check_address(host, port)
    logging.getLogger("websockets.server").setLevel(logging.WARNING)
    entrance = Entrance(host)
    try:
        with _asked(entrance) as guarded, contextlib.redirect_stdout(io.StringIO()):
            server = viser.ViserServer(host=host, port=port, verbose=False)
    except OSError as error:
        raise ViewerError(
            "viser", f"cannot serve at {host}, port {port}: {error.strerror or error}"
        ) from error
    if not guarded:
        with contextlib.redirect_stdout(io.StringIO()):
            server.stop()
        raise ViewerError("viser", f"{viser.__version__} lets anybody in; pip install 'viser==1.1.1'")
    for wish in (ShareUrlRequest, ShareUrlDisconnect):  # to have it published by a server of viser's makers
        server._websock_server.unregister_handler(wish)
    return server, f"http://{_in_url(host)}:{server.get_port()}/{entrance.secret}"


@contextlib.contextmanager
def _asked(entrance: Entrance) -> Iterator[list[Entrance]]:
    """Let the servers that viser starts meanwhile ask who may come in; lists those that will.

    Viser has no way to be told so. It starts its server by `websockets.asyncio.server.serve`, with a
    `process_request` that sees each call before it is answered; ours comes before that.
    """
    guarded: list[Entrance] = []
    plain = websockets.asyncio.server.serve

    def guarding(*given: Any, process_request: Any = None, **named: Any) -> Any:
        if getattr(process_request, "__module__", "") != "viser.infra._infra":  # of somebody else's thread
            return plain(*given, process_request=process_request, **named)
        guarded.append(entrance)

        def asked(connection: ServerConnection, request: Request) -> Response | None:
            reason = entrance.refusal(request.path, request.headers)
            if reason:
                return connection.respond(HTTPStatus.FORBIDDEN, f"Refused: {reason}.\n")
            behind = request.path.removeprefix(f"/{entrance.secret}") or "/"
            response: Response | None = process_request(connection, replace(request, path=behind))
            if response is not None:
                response.headers.update(HEADERS)
            return response

        return plain(*given, process_request=asked, **named)

    with _patching:
        websockets.asyncio.server.serve = guarding  # type: ignore[assignment, misc]
        try:
            yield guarded
        finally:
            websockets.asyncio.server.serve = plain  # type: ignore[misc]


def _same(origin: str, host: str) -> bool:
    """Whether a page came from a host, port included."""
    scheme, _, place = origin.partition("://")
    return scheme in ("http", "https") and place.lower() == host.lower()


def _in_url(host: str) -> str:
    """An address as it stands in a URL; where all are listened at, the one that leads to this machine."""
    if host in ("0.0.0.0", "::", ""):
        return "127.0.0.1"
    return f"[{host}]" if ":" in host else host


def _check_address(host: str, port: int) -> None:
    """Raise ViewerError for an address that is not to be had; the server's thread would die of it."""
    if not 1 <= port <= 65535:
        raise ViewerError("viser", f"port is {port}; allowed: a whole number from 1 to 65535")
    try:
        family, kind, protocol, _, address = socket.getaddrinfo(host, 0, type=socket.SOCK_STREAM)[0]
        with socket.socket(family, kind, protocol) as probe:
            probe.bind(address)
    except (OSError, UnicodeError) as error:
        allowed = "allowed: an address of this machine, such as 127.0.0.1; 0.0.0.0 for all that it has"
        raise ViewerError("viser", f"cannot serve at {host!r} ({error}); {allowed}") from error
