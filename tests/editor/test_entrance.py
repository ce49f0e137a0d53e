"""Who is let into the page: whoever has its address, and no other web page that the browser has open."""

from __future__ import annotations

import asyncio
import http.client
import socket
from collections.abc import Iterator, Mapping
from types import SimpleNamespace
from typing import Any, NamedTuple

import pytest

pytest.importorskip("viser", reason="viser is not installed")

import websockets.asyncio.client
import websockets.asyncio.server
from editor.browser.desk import free_port, is_free
from editor.edited_tasks import task
from editor.page_client import until, visiting
from websockets import Headers
from websockets.exceptions import InvalidStatus

from pinposture.editor import Editor
from pinposture.editor.ui import server as served
from pinposture.editor.ui.server import Entrance, is_loopback, serve
from pinposture.errors import ViewerError


@pytest.fixture(scope="module")
def editor() -> Iterator[Editor]:
    made = Editor(task(), port=free_port())
    made.start()
    yield made
    made.close()


def address(editor: Editor) -> tuple[int, str]:
    """Port and secret of an editor."""
    place, secret = editor.url.removeprefix("http://127.0.0.1:").split("/")
    return int(place), secret


class Answer(NamedTuple):
    status: int
    text: str
    headers: Mapping[str, str]


def get(port: int, path: str, **headers: str) -> Answer:
    caller = http.client.HTTPConnection("127.0.0.1", port, timeout=20)
    caller.request("GET", path, headers={"Host": f"127.0.0.1:{port}"} | headers)
    answer = caller.getresponse()
    made = Answer(answer.status, answer.read().decode(), dict(answer.headers))
    caller.close()
    return made


def test_the_page_is_served_at_its_address_with_and_without_a_slash(editor: Editor) -> None:
    port, secret = address(editor)
    assert len(secret) >= 40
    for path in (f"/{secret}", f"/{secret}/", f"/{secret}/?fixedDpr=1"):
        answer = get(port, path)
        assert (answer.status, "<html" in answer.text) == (200, True)
        assert answer.headers["Referrer-Policy"] == "no-referrer"
        assert answer.headers["X-Frame-Options"] == "DENY"
    assert get(port, f"/{secret}/nothing.js").status == 404


def test_the_page_asks_whether_its_server_is_there(editor: Editor) -> None:
    port, secret = address(editor)
    page = get(port, f"/{secret}", **{"Accept-Encoding": "gzip"})
    assert page.text.count("/alive") == 1
    assert len(page.text.encode()) == int(page.headers["Content-Length"])
    assert get(port, f"/{secret}/alive").status == 200
    assert get(port, "/alive").status == 403
    assert get(port, f"/{'x' * len(secret)}/alive").status == 403


def test_nothing_is_served_elsewhere(editor: Editor) -> None:
    port, secret = address(editor)
    paths = ("", "index.html", "x", secret[:-1], f"{secret}x", f"/{secret}", f"x/{secret}", "%E4")
    for path in paths:
        answer = get(port, f"/{path}")
        assert answer.status == 403
        assert "the whole one that was printed" in answer.text
        assert secret not in answer.text
    rebound = get(port, f"/{secret}/", Host=f"evil.example:{port}")
    assert (rebound.status, "not addressed to this machine" in rebound.text) == (403, True)
    foreign = get(port, f"/{secret}/", Origin="http://evil.example")
    assert (foreign.status, "another web page" in foreign.text) == (403, True)


@pytest.mark.parametrize(
    "origin",
    [
        "http://evil.example",
        "null",
        "http://127.0.0.1",
        "http://127.0.0.1:1",
        "http://localhost:{port}",
        "file://",
    ],
)
def test_another_page_is_not_let_in_though_it_knows_the_address(editor: Editor, origin: str) -> None:
    port, _ = address(editor)
    with pytest.raises(InvalidStatus, match="403"), visiting(editor.url, origin=origin.format(port=port)):
        pass


def test_a_name_that_was_made_to_lead_here_is_not_let_in(editor: Editor) -> None:
    port, secret = address(editor)
    with socket.create_connection(("127.0.0.1", port)) as way, pytest.raises(InvalidStatus, match="403"):
        rebound = f"http://evil.example:{port}"
        with visiting(f"{rebound}/{secret}", origin=rebound, sock=way):
            pass


@pytest.mark.parametrize("path", ["", "/", "/wrong", "/{secret}x"])
def test_nobody_is_let_in_without_the_secret(editor: Editor, path: str) -> None:
    port, secret = address(editor)
    home = f"http://127.0.0.1:{port}"
    with pytest.raises(InvalidStatus, match="403"), visiting(home + path.format(secret=secret), origin=home):
        pass


@pytest.mark.parametrize("own", [True, False])
def test_the_page_and_programs_are_let_in(editor: Editor, own: bool) -> None:
    port, secret = address(editor)
    named = {"origin": f"http://127.0.0.1:{port}"} if own else {}
    with visiting(f"http://127.0.0.1:{port}/{secret}", **named) as client:
        until(lambda: "Save under this name" in client.shown("label"), "the page is sent")


def test_nobody_can_have_it_published_by_the_makers_of_viser(editor: Editor) -> None:
    handlers = editor.page._server._websock_server._incoming_handlers
    assert [each.__name__ for each in handlers if "Share" in each.__name__] == []


@pytest.mark.parametrize(
    ("listening", "host", "let_in"),
    [
        ("127.0.0.1", "127.0.0.1:8080", True),
        ("127.0.0.1", "localhost:8080", True),
        ("127.0.0.1", "LOCALHOST", True),
        ("127.0.0.1", "[::1]:9000", True),  # a port that is forwarded is another one
        ("127.0.0.1", "192.168.1.5:8080", False),
        ("127.0.0.1", "evil.example:8080", False),
        ("127.0.0.1", "127.0.0.1.evil.example:8080", False),
        ("127.0.0.1", "localhost.evil.example", False),
        ("127.0.0.1", "evil.example@127.0.0.1.x", False),
        ("127.0.0.1", "", False),
        ("127.0.0.1", "[::1", False),
        ("0.0.0.0", "192.168.1.5:8080", True),
        ("0.0.0.0", "[fe80::1]:8080", True),
        ("0.0.0.0", "127.0.0.1:8080", True),
        ("0.0.0.0", "evil.example:8080", False),
        ("arm.lab", "Arm.Lab:8080", True),
        ("arm.lab", "evil.example:8080", False),
    ],
)
def test_a_call_must_name_this_machine(listening: str, host: str, let_in: bool) -> None:
    entrance = Entrance(listening)
    refused = entrance.refusal(f"/{entrance.secret}", Headers(Host=host))
    assert refused == ("" if let_in else "the call is not addressed to this machine")


def test_a_call_names_one_host_and_one_origin() -> None:
    entrance = Entrance("127.0.0.1")
    path = f"/{entrance.secret}"
    assert entrance.refusal(path, Headers()) != ""
    assert entrance.refusal(path, Headers([("Host", "localhost"), ("Host", "localhost")])) != ""
    twice = [("Host", "localhost"), ("Origin", "http://localhost"), ("Origin", "http://localhost")]
    assert entrance.refusal(path, Headers(twice)) != ""
    assert entrance.refusal(path, Headers(twice[:2])) == ""
    assert entrance.refusal("/ä", Headers(twice[:2])) != ""


def test_each_start_has_another_secret() -> None:
    assert len({Entrance("127.0.0.1").secret for _ in range(100)}) == 100


@pytest.mark.parametrize(
    ("host", "own"),
    [("127.0.0.1", True), ("127.1.2.3", True), ("::1", True), ("Localhost", True), ("0.0.0.0", False)]
    + [("::", False), ("192.168.1.5", False), ("arm.lab", False)],
)
def test_which_addresses_only_this_machine_reaches(host: str, own: bool) -> None:
    assert is_loopback(host) is own


def test_a_viser_that_asks_nobody_is_not_served(monkeypatch: pytest.MonkeyPatch) -> None:
    """What `page/server.py` relies on: viser starts by this function, and asks `process_request` first."""
    from viser.infra import _infra

    plain = websockets.asyncio.server.serve
    other = SimpleNamespace(asyncio=SimpleNamespace(server=SimpleNamespace(serve=plain)))
    for name in ("datastructures", "exceptions"):
        setattr(other, name, getattr(websockets, name))
    monkeypatch.setattr(_infra, "websockets", other)
    port = free_port()
    with pytest.raises(ViewerError, match="cannot be restricted to the secret address"):
        serve("127.0.0.1", port)
    until(lambda: is_free(port), "nobody listens any more")
    assert websockets.asyncio.server.serve is plain


def test_servers_of_others_are_as_they_were() -> None:
    async def answer(connection: Any) -> None:
        await connection.send("hello")

    async def visit() -> str:
        with served._guarded_servers(Entrance("127.0.0.1")) as guarded:
            async with websockets.asyncio.server.serve(answer, "127.0.0.1", port):
                assert guarded == []
                async with websockets.asyncio.client.connect(f"ws://127.0.0.1:{port}") as caller:
                    return str(await caller.recv())

    port = free_port()
    assert asyncio.run(visit()) == "hello"
