"""What all parts of the page share, and fields that are typed into."""

from __future__ import annotations

import time
from collections.abc import Callable
from typing import Any, Protocol, TypeAlias

from viser import GuiEvent

from pinposture.editor.session import Session
from pinposture.editor.solver import Live
from pinposture.viz import palette

# What all parts of the page have in common.

Post: TypeAlias = Callable[..., None]
"""`Editor.post`: leaves a request for the loop."""

Color = tuple[int, int, int]


class Part(Protocol):
    """Part of the page. Made once; its callbacks only post requests."""

    def show(self, session: Session, live: Live) -> None:
        """Bring it up to date; called by the loop some thirty times a second."""


def color(name: str) -> Color:
    """A colour of the palette as the page takes it."""
    red, green, blue = (round(255.0 * part) for part in palette.rgb(name))
    return red, green, blue


def on_change(control: Any, act: Callable[[Any], None]) -> None:
    """Have something done when somebody changes a control, and not when we do.

    Args:
        control: a control with a value.
        act: told the new value; may only post.
    """

    # Asynchronous functions are called in order, others by a pool of threads.
    async def changed(event: GuiEvent[Any]) -> None:
        if event.client_id is not None:
            act(event.target.value)

    control.on_update(changed)


def on_click(button: Any, act: Callable[[], None]) -> None:
    """Have something done when somebody clicks; it may only post."""

    async def clicked(_: GuiEvent[Any]) -> None:
        act()

    button.on_click(clicked)


def on_choice(buttons: Any, act: Callable[[str], None]) -> None:
    """Have something done when somebody clicks on one of a group of buttons; told which, it may only post."""

    async def clicked(event: GuiEvent[Any]) -> None:
        act(event.target.value)

    buttons.on_click(clicked)


def put(control: Any, **values: Any) -> None:
    """Set attributes of a control, those that differ: each is sent to every browser."""
    for name, value in values.items():
        if getattr(control, name) != value:
            setattr(control, name, value)


# Fields that are typed into: each key changes them, and a value counts when the typing is over.

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
