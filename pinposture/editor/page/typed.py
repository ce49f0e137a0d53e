"""Fields that are typed into: each key changes them, and a value counts when the typing is over."""

from __future__ import annotations

import time
from collections.abc import Callable
from typing import Any

from pinposture.editor.page.part import on_change, put

PAUSE = 0.8
"""How long after the last key a value counts [s]."""


class Typed:
    """A field that is typed into.

    The browser tells of each key. "12" on the way to "125" is not meant, and may be impossible; so nothing is
    done until the hand rests, and nobody writes into the field before.

    Attributes:
        control: the field.

    Args:
        control: the field.
        act: told the value, and whether the typing is over; may only post.
        preview: whether it is told while typing goes on, too.
    """

    def __init__(self, control: Any, act: Callable[[Any, bool], None], preview: bool = False) -> None:
        self.control, self._act, self._preview = control, act, preview
        self._typed: Any = None
        self._value: Any = control.value
        self._since: float | None = None
        on_change(control, self._changed)

    def _changed(self, value: Any) -> None:
        self._typed, self._since = value, time.monotonic()
        if self._preview:
            self._act(value, False)

    def show(self, value: Any, **others: Any) -> None:
        """Write what counts into it, or pass on what was typed; called by the loop.

        Args:
            value: what counts.
            others: further attributes of the field.
        """
        self._value = value
        if self._since is None:
            put(self.control, value=value)
        elif time.monotonic() - self._since >= PAUSE:
            self.finish()
        put(self.control, **others)

    def finish(self) -> None:
        """Pass on what was typed, if it does not count yet: something else is done now."""
        since, self._since = self._since, None
        if since is not None and (self._preview or self._typed != self._value):
            self._act(self._typed, True)

    def forget(self) -> None:
        """Drop what was typed and does not count yet."""
        self._since = None
