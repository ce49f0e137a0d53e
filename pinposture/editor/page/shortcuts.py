"""What the keyboard does. The page's command palette lists it."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from typing import Any, NamedTuple

import numpy as np
import viser

from pinposture.editor.files import Files
from pinposture.editor.page.handles import move_point, select_point
from pinposture.editor.page.part import Post
from pinposture.editor.page.shape_tab import delete_point, insert_point
from pinposture.editor.session import Session

STEP = 0.01
"""How far an arrow key moves the selected control point, relative to the arm."""


class Shortcut(NamedTuple):
    """A key, and what it does.

    Attributes:
        label: what it does, in words.
        key: as the page names it.
        modifier: what is to be held with it, as the page names it.
        act: what it does.
    """

    label: str
    key: str
    modifier: str | None
    act: Callable[[Session], object]


def shortcuts(files: Files) -> tuple[Shortcut, ...]:
    """All keys of the editor."""
    return (
        Shortcut("Undo", "Z", "cmd/ctrl", Session.undo),
        Shortcut("Redo", "Z", "cmd/ctrl+shift", Session.redo),
        Shortcut("Redo", "Y", "cmd/ctrl", Session.redo),
        Shortcut("Save", "S", "cmd/ctrl", files.save),
        Shortcut("Insert a control point", "I", None, insert_point),
        Shortcut("Delete the control point", "delete", None, delete_point),
        Shortcut("Next control point", "N", None, partial(_next, 1)),
        Shortcut("Previous control point", "B", None, partial(_next, -1)),
        Shortcut("Select nothing", "escape", None, partial(select_point, None)),
        Shortcut("Move it ahead (+x)", "arrowright", "shift", partial(_nudge, 0, 1.0)),
        Shortcut("Move it back (-x)", "arrowleft", "shift", partial(_nudge, 0, -1.0)),
        Shortcut("Move it up (+z)", "arrowup", "shift", partial(_nudge, 2, 1.0)),
        Shortcut("Move it down (-z)", "arrowdown", "shift", partial(_nudge, 2, -1.0)),
    )


def add_shortcuts(server: viser.ViserServer, files: Files, post: Post) -> None:
    """Tell the page of all keys."""
    for label, key, modifier, act in shortcuts(files):
        command = server.gui.add_command(label, hotkey=key, modifier=modifier)  # type: ignore[arg-type]
        # A key that is held down repeats itself; the arm may need longer than that for a move.
        command.on_trigger(partial(_triggered, post, act, label if modifier == "shift" else ""))


async def _triggered(post: Post, act: Callable[[Session], object], same: str, _: Any) -> None:
    post(act, same)


def _next(by: int, session: Session) -> None:
    """Select the control point after the selected one, or before; the one at the base is passed over."""
    count = len(session.shape.points)
    at = session.handle if session.handle is not None else (0 if by > 0 else count)
    select_point((at - 1 + by) % (count - 1) + 1, session)


def _nudge(axis: int, way: float, session: Session) -> None:
    """Move the selected control point a little along an axis of the world."""
    if session.handle is None:
        session.say("no control point is selected: click on one, or press N", "warning")
        return
    place = np.array(session.shape.points[session.handle])
    place[axis] += way * STEP * session.arm.length
    move_point(session.handle, place, True, session)
