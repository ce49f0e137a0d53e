"""Values that are typed: each key changes them, and only when the typing is over it counts."""

from __future__ import annotations

import time
from collections.abc import Callable
from typing import Any

from pinposture.editor.page.part import on_change

QUIET = 0.7
"""How long nothing is typed until it counts [s]."""


class Typed:
    """A control that is typed into.

    Args:
        control: the control.
        act: told the value, and whether the typing is over; may only post.
        preview: whether it is told while typing goes on, too.
    """

    def __init__(self, control: Any, act: Callable[[Any, bool], None], preview: bool = False) -> None:
        self.control, self._act, self._preview = control, act, preview
        self._value: Any = None
        self._since: float | None = None
        on_change(control, self._changed)

    def _changed(self, value: Any) -> None:
        self._value, self._since = value, time.monotonic()
        if self._preview:
            self._act(value, False)

    def show(self, value: Any, **others: Any) -> None:
        """Bring the control up to date, unless somebody is typing; called by the loop."""
        since = self._since
        if since is not None:
            if time.monotonic() - since >= QUIET:
                self._since = None
                self._act(self._value, True)
            return
        for name, own in {"value": value, **others}.items():
            if getattr(self.control, name) != own:
                setattr(self.control, name, own)

    def drop(self) -> None:
        """Let what was typed count at once, as when something else is turned to."""
        if self._since is not None:
            self._since = None
            self._act(self._value, True)
