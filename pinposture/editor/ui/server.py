"""The server of the page, which only admits calls with the secret address, from the page itself.

Any web page that is open in a browser can call servers on that machine. So each call, of the page as of its
websocket, must name this machine (`Host`: another name can be made to lead here), come from this page
(`Origin`), and have the secret of the address in its path. The page of viser connects to the path that it
was loaded from, so the secret needs no cookie, which other servers of the same machine would be sent.
"""

from __future__ import annotations

import contextlib
import hmac
import io
import ipaddress
import itertools
import logging
import secrets
import socket
from collections.abc import Callable, Iterator
from dataclasses import replace
from http import HTTPStatus
from threading import Lock
from typing import Any, NamedTuple
from urllib.parse import urlsplit

import viser
import websockets.asyncio.server
from viser._messages import ShareUrlDisconnect, ShareUrlRequest
from websockets import Headers, Request, Response
from websockets.asyncio.server import ServerConnection
from websockets.exceptions import ConnectionClosed
from websockets.frames import CloseCode

from pinposture.errors import PostureError, ViewerError

ALIVE_PATH = "/alive"
"""What the page asks for, behind the secret, to learn whether the server is still there."""

WATCH = """<style>
#gone { display: none; position: fixed; top: 0; left: 0; right: 0; z-index: 10000; padding: 14px 20px;
  background: #b00020; color: white; font: 16px/1.4 sans-serif; text-align: center }
body.gone #gone { display: block }
body.gone #root { filter: grayscale(1) opacity(0.45); pointer-events: none }
</style><script>
window.addEventListener('DOMContentLoaded', () => {
  document.title = 'pinposture';
  const note = document.body.appendChild(document.createElement('div'));
  note.id = 'gone';
  const base = location.pathname.replace(/\\/$/, '');
  const tell = (text) => {
    note.textContent = text;
    document.body.classList.toggle('gone', text !== '');
  };
  const stopped = '"pinposture VERB" has stopped: what you see is old. Run it again and open the address '
    + 'that it prints.';
  const moved = '"pinposture VERB" was started again and has a new address. Open the one that it printed; '
    + 'this page is not connected to it.';
  const ask = () => fetch(base + 'ALIVE', { cache: 'no-store', signal: AbortSignal.timeout(900) })
    .then((answer) => tell(answer.ok ? '' : moved), () => tell(stopped));
  setInterval(ask, 1000);
});
</script>""".replace("ALIVE", ALIVE_PATH)
"""Added to the page: it greys out, and says why, within two seconds after the server has gone."""

_patching = Lock()


ALONE = """<!doctype html><html class="alone"><head><meta charset="utf-8">
<meta name="viewport" content="width=device-width"><title>pinposture</title>HEAD</head><body></body></html>"""
"""A page that has nothing but a channel, so that no picture keeps it waiting."""


class Channel(NamedTuple):
    """A connection of the page beside that of viser, for what viser has no messages for.

    Attributes:
        path: where it is, behind the secret.
        head: what is added to the head of the page, which opens it: our own HTML, without anything of a user.
        alone: where a page is, behind the secret, that has nothing else.
        answer: called with a name of the connection and a message; returns the reply.
        leave: called with that name when the connection has ended.
    """

    path: str
    head: str
    alone: str
    answer: Callable[[str, str | bytes], str]
    leave: Callable[[str], None]

    async def serve(self, connection: ServerConnection, name: str) -> None:
        """Answer the messages of a connection until it ends; one that is refused ends it."""
        try:
            async for message in connection:
                await connection.send(self.answer(name, message))
        except PostureError as error:
            reason = str(error)[:60]  # there is room for 123 bytes
            await connection.close(CloseCode.POLICY_VIOLATION, reason)
        except ConnectionClosed:
            pass
        finally:
            self.leave(name)


class Entrance:
    """Decides which calls are admitted.

    Args:
        host: the address that is listened at.

    Attributes:
        secret: the beginning of the path of each call; different for each server.
    """

    def __init__(self, host: str) -> None:
        self.secret = secrets.token_urlsafe(32)
        self._host = host.lower()
        self._local = is_loopback(host)

    def refusal(self, path: str, headers: Headers) -> str:
        """Return why a call is refused; empty if it is admitted."""
        hosts = headers.get_all("Host")
        origins = headers.get_all("Origin")
        if len(hosts) != 1 or not self._is_this_machine(hosts[0]):
            return "the call is not addressed to this machine"
        if len(origins) > 1 or (origins and not _same_host(origins[0], hosts[0])):
            return "the call comes from another web page"
        secret = path.partition("?")[0].removeprefix("/").partition("/")[0]
        if not hmac.compare_digest(secret.encode(), self.secret.encode()):
            return "the address is not the whole one that was printed at the start"
        return ""

    def _is_this_machine(self, host: str) -> bool:
        """Return whether a host is surely this machine: no name that others can define. A port is ignored."""
        try:
            name = urlsplit(f"//{host}").hostname or ""
        except ValueError:
            return False
        if name in ("localhost", self._host):
            return True
        try:
            address = ipaddress.ip_address(name)
        except ValueError:
            return not self._local and name == socket.gethostname().lower()
        return address.is_loopback or not self._local


def is_loopback(host: str) -> bool:
    """Return whether only programs on this machine reach an address."""
    try:
        return host.lower() == "localhost" or ipaddress.ip_address(host).is_loopback
    except ValueError:
        return False


def serve(
    host: str, port: int, verb: str = "edit", channel: Channel | None = None
) -> tuple[viser.ViserServer, str]:
    """Serve a page, without what viser would print.

    Args:
        host: the address to listen at.
        port: the port; the next one that is free if it is taken.
        verb: the verb of the command that serves it.
        channel: a further connection of the page; None: there is none.

    Returns:
        The server, and the address for browsers on this machine.

    Raises:
        ViewerError: it cannot be served, or this version of viser would admit every call.
    """
    _check_address(host, port)
    logging.getLogger("websockets.server").setLevel(logging.WARNING)
    entrance = Entrance(host)
    try:
        with (
            _guarded_servers(entrance, WATCH.replace("VERB", verb), channel) as guarded,
            contextlib.redirect_stdout(io.StringIO()),
        ):
            server = viser.ViserServer(host=host, port=port, verbose=False)
    except OSError as error:
        raise ViewerError(
            "viser", f"cannot serve at {host}, port {port}: {error.strerror or error}"
        ) from error
    if not guarded:
        with contextlib.redirect_stdout(io.StringIO()):
            server.stop()
        raise ViewerError(
            "viser",
            f"{viser.__version__} cannot be restricted to the secret address; pip install 'viser==1.1.1'",
        )
    for message in (ShareUrlRequest, ShareUrlDisconnect):  # would publish it by a server of viser's makers
        server._websock_server.unregister_handler(message)
    local = "127.0.0.1" if host in ("0.0.0.0", "::", "") else f"[{host}]" if ":" in host else host
    return server, f"http://{local}:{server.get_port()}/{entrance.secret}"


@contextlib.contextmanager
def _guarded_servers(
    entrance: Entrance, head: str = "", channel: Channel | None = None
) -> Iterator[list[Entrance]]:
    """Guard the servers that viser starts meanwhile by an entrance; yields a list with one item for each.

    Viser has no option for that. It starts its server by `websockets.asyncio.server.serve`, with a
    `process_request` that sees each call before it is answered; ours comes before that. A channel is served
    beside the handler of viser.
    """
    guarded: list[Entrance] = []
    plain = websockets.asyncio.server.serve
    added = head if channel is None else head + channel.head
    numbers = itertools.count(1)

    def guarding(handler: Any, *arguments: Any, process_request: Any = None, **named: Any) -> Any:
        if getattr(process_request, "__module__", "") != "viser.infra._infra":  # from another thread
            return plain(handler, *arguments, process_request=process_request, **named)
        guarded.append(entrance)

        async def handle(connection: ServerConnection) -> None:
            request = connection.request
            if channel is None or request is None or _path_of(request, entrance) != channel.path:
                await handler(connection)
            else:
                await channel.serve(connection, f"page {next(numbers)}")

        def process(connection: ServerConnection, request: Request) -> Response | None:
            reason = entrance.refusal(request.path, request.headers)
            if reason:
                return connection.respond(HTTPStatus.FORBIDDEN, f"Refused: {reason}.\n")
            path = _path_of(request, entrance)
            if path == ALIVE_PATH:
                response: Response | None = connection.respond(HTTPStatus.OK, "")
            elif channel is not None and path == channel.alone:
                response = connection.respond(HTTPStatus.OK, ALONE.replace("HEAD", channel.head))
                del response.headers["Content-Type"]  # a second value would be added to it
                response.headers["Content-Type"] = "text/html; charset=utf-8"
            else:
                response = process_request(connection, _plain_page(replace(request, path=path)))
            if response is not None:
                response.headers.update(
                    {
                        "Referrer-Policy": "no-referrer",  # a link must not reveal the address
                        "X-Frame-Options": "DENY",  # nor may another page show it, and have it clicked on
                        "X-Content-Type-Options": "nosniff",
                        "Cache-Control": "no-store",
                    }
                )
                _add_to_head(response, added)
            return response

        return plain(handle, *arguments, process_request=process, **named)

    with _patching:
        websockets.asyncio.server.serve = guarding  # type: ignore[assignment, misc]
        try:
            yield guarded
        finally:
            websockets.asyncio.server.serve = plain  # type: ignore[misc]


def _path_of(request: Request, entrance: Entrance) -> str:
    """Return the path of an admitted request behind the secret."""
    return request.path.removeprefix(f"/{entrance.secret}") or "/"


def _plain_page(request: Request) -> Request:
    """Return a request for the page as one for its plain text, so that `_add_to_head` can add to it."""
    if request.path.partition("?")[0] not in ("/", "/index.html"):
        return request
    headers = Headers(request.headers)
    headers.pop("Accept-Encoding", None)
    return replace(request, headers=headers)


def _add_to_head(response: Response, added: str) -> None:
    """Add HTML to the head of a page."""
    end = b"</head>"
    if response.headers.get("Content-Encoding") == "identity" and end in response.body:
        response.body = response.body.replace(end, added.encode() + end, 1)
        del response.headers["Content-Length"]  # a second value would be added to it
        response.headers["Content-Length"] = str(len(response.body))


def _same_host(origin: str, host: str) -> bool:
    """Return whether a page came from a host, port included."""
    scheme, _, address = origin.partition("://")
    return scheme in ("http", "https") and address.lower() == host.lower()


def _check_address(host: str, port: int) -> None:
    """Raise ViewerError for an address that cannot be used, of which the server's thread would die."""
    if not 1 <= port <= 65535:
        raise ViewerError("viser", f"port is {port}; allowed: a whole number from 1 to 65535")
    try:
        family, kind, protocol, _, address = socket.getaddrinfo(host, 0, type=socket.SOCK_STREAM)[0]
        with socket.socket(family, kind, protocol) as probe:
            probe.bind(address)
    except (OSError, UnicodeError) as error:
        allowed = "allowed: an address of this machine, such as 127.0.0.1; 0.0.0.0 for all that it has"
        raise ViewerError("viser", f"cannot serve at {host!r} ({error}); {allowed}") from error
