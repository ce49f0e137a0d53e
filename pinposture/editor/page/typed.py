"""Fields that are typed into: a value counts when the hand rests, not with every key."""

from __future__ import annotations

import time
from collections.abc import Callable
from typing import Any

from viser import GuiEvent

from pinposture.editor.page.part import put

PAUSE = 0.8
"""How long after the last key a value counts [s]."""


class Typed:
    """A field that is typed into.

    The browser tells of each key. "12" on the way to "125" is not meant, and may be impossible; so nothing is
    done until the hand rests, and nobody writes into the field before.

    Args:
        control: the field.
        act: told the new value when it counts; may only post.
    """

    def __init__(self, control: Any, act: Callable[[Any], None]) -> None:
        self._control, self._act = control, act
        self._pressed: float | None = None
        self._value: Any = control.value

        async def pressed(event: GuiEvent[Any]) -> None:
            if event.client_id is not None:
                self._pressed = time.monotonic()

        control.on_update(pressed)

    def show(self, value: Any, disabled: bool = False) -> None:
        """Write what counts into it, or pass on what was typed.

        Args:
            value: what counts.
            disabled: whether it may not be typed into.
        """
        self._value = value
        pressed = self._pressed
        if pressed is None:
            put(self._control, value=value)
        elif time.monotonic() - pressed >= PAUSE:
            self.finish()
        put(self._control, disabled=disabled)

    def finish(self) -> None:
        """Pass on what was typed, if it does not count yet: something else is done now."""
        pressed, self._pressed = self._pressed, None
        if pressed is not None and self._control.value != self._value:
            self._act(self._control.value)

    def forget(self) -> None:
        """Drop what was typed and does not count yet."""
        self._pressed = None
