"""What all parts of the page have in common."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, Protocol, TypeAlias

from viser import GuiEvent

from pinposture.editor.live import Live
from pinposture.editor.session import Session
from pinposture.viz import palette

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
