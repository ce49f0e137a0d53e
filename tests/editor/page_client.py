"""A browser without a picture: it speaks the protocol of the page, and keeps what it is sent."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Any

from viser._messages import GuiUpdateMessage

from benchmarks.page_client import PageClient

SOON = 60.0
"""How long something that has to happen is waited for [s]."""


class Client(PageClient):
    """A browser without a picture that keeps what it is sent; as `PageClient`."""

    def __init__(self, url: str, **named: Any) -> None:
        self.messages: list[dict[str, Any]] = []
        super().__init__(url, **named)

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

    def _take(self, messages: list[dict[str, Any]]) -> None:
        self.messages += messages


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
