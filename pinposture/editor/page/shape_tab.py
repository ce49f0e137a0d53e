"""The tab for the curve: its control points in numbers, more of them, fewer."""

from __future__ import annotations

from functools import partial

import numpy as np
import viser

from pinposture.arm import Arm
from pinposture.editor.live import Live
from pinposture.editor.page.handles import move_point, select_point
from pinposture.editor.page.part import Post, on_change, on_choice, put
from pinposture.editor.page.typed import Typed
from pinposture.editor.session import Session
from pinposture.editor.shape import Shape

DIGITS = 4
"""Digits behind the point of coordinates [m]."""


class ShapeTab:
    """Controls for the curve of the keyframe that is edited.

    Args:
        server: the page; the controls are made where it is at.
        post: leaves a request for the loop.
    """

    def __init__(self, server: viser.ViserServer, post: Post) -> None:
        self._post, gui = post, server.gui
        self._index, self._keyframe = 0, 0
        self._point = gui.add_dropdown("Control point", ("none",), hint="Or click on one in the picture")
        place = gui.add_vector3("x, y, z [m]", (0.0, 0.0, 0.0), step=0.001, hint="In the world")
        self._place = Typed(place, self._typed, preview=True)
        self._edit = gui.add_button_group("Point", ("Insert after", "Delete"))
        on_change(self._point, self._selected)
        on_choice(self._edit, self._edited)

    def show(self, session: Session, live: Live) -> None:
        """Bring it up to date."""
        del live
        count = len(session.shape.points)
        names = ("none", *(f"{k + 1}" + _where(k, count) for k in range(count)))
        if self._point.options != names:
            self._point.options = names
        handle = session.handle
        put(self._point, value="none" if handle is None else names[handle + 1])
        if handle is not None and (handle, session.selected) != (self._index, self._keyframe):
            self._place.finish()  # it was meant for the one before
            self._index, self._keyframe = handle, session.selected
        place = session.shape.points[self._index] if handle is not None else self._place.control.value
        shown = tuple(round(float(x), DIGITS) for x in place)
        self._place.show(shown, disabled=handle is None or handle == 0)

    def _selected(self, name: str) -> None:
        self._post(partial(select_point, None if name == "none" else int(name.split(maxsplit=1)[0]) - 1))

    def _typed(self, place: tuple[float, float, float], final: bool) -> None:
        index, keyframe = self._index, self._keyframe

        def request(session: Session) -> None:
            if session.selected == keyframe:
                chosen = session.handle  # perhaps another by now
                move_point(index, np.array(place), final, session)
                session.handle = chosen

        self._post(request, "" if final else "move")

    def _edited(self, what: str) -> None:
        self._post(insert_point if what == "Insert after" else delete_point)


def insert_point(session: Session) -> None:
    """Propose one more control point behind the selected one, or behind the last but one."""
    after = session.handle if session.handle is not None else max(len(session.shape.points) - 2, 0)

    def change(arm: Arm, shape: Shape) -> Shape:
        return shape.inserted(arm, after)

    session.reshape(change, f"inserted point {after + 2}")
    session.handle = after + 1 if session.proposal is not None else session.handle


def delete_point(session: Session) -> None:
    """Propose the curve without the selected control point."""
    index = session.handle
    if index is None:
        session.say("no control point is selected: click on one first", "warning")
        return

    def change(arm: Arm, shape: Shape) -> Shape:
        return shape.removed(arm, index)

    session.reshape(change, f"deleted point {index + 1}")
    if session.proposal is not None:
        session.handle = max(index - 1, 1)


def _where(index: int, count: int) -> str:
    return " (base)" if index == 0 else " (end)" if index == count - 1 else ""
