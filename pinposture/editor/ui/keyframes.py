"""The tab for the keyframes: which there are, in what order and when, and what is asked of the selected."""

from __future__ import annotations

from functools import partial
from html import escape

import numpy as np
import viser

from pinposture.control import EndEffector
from pinposture.editor import edits
from pinposture.editor.session import Session
from pinposture.editor.shape import keyframes_of
from pinposture.editor.solver import Live
from pinposture.editor.ui.parts import Post, Typed, color, on_change, on_choice, on_click, put
from pinposture.placement.resolve import METHODS
from pinposture.task import Keyframe
from pinposture.viz import palette

ROWS = 8
"""How many keyframes are listed at once."""

ACTIONS = ("Add", "Delete", "Earlier", "Later")
"""What can be done to the selected keyframe as a whole."""

MARKS = {"collides": palette.ACTIVE, "refused": palette.MARK}
"""Colours of the rows of keyframes that are not fine."""

FINEST = 3
"""Digits of times [s] behind the point."""


class KeyframesTab:
    """Controls for the keyframes of the task.

    Args:
        server: the page; the controls are made where it is at.
        post: leaves a request for the loop.
    """

    def __init__(self, server: viser.ViserServer, post: Post) -> None:
        self._post, gui = post, server.gui
        self._first, self._shown = 0, (-1, -1)  # the first row; which keyframe of how many was selected
        self._above = gui.add_button("", icon=viser.Icon.CHEVRON_UP, color="gray", visible=False)
        self._rows = [gui.add_button("", color="gray", visible=False) for _ in range(ROWS)]
        self._below = gui.add_button("", icon=viser.Icon.CHEVRON_DOWN, color="gray", visible=False)
        hint = "Add one behind this one, with its shape; delete it; move it to an earlier or later place"
        self._actions = gui.add_button_group("Keyframe", ACTIONS, hint=hint)
        name = gui.add_text("Name", "", hint="Empty: it is called by its number")
        when = gui.add_number("Time [s]", 0.0, step=0.1, hint="When it is to be taken")
        hold = gui.add_number("Hold [s]", 0.0, step=0.1, hint="How long to stay; those behind move along")
        when.precision = hold.precision = FINEST
        self._name, self._time = Typed(name, self._renamed), Typed(when, self._retimed)
        self._hold = Typed(hold, self._held)
        self._fields = (self._name, self._time, self._hold)
        hint = "How modules find their places on the curve; auto: in turn, or all at once where that zigzags"
        self._method = gui.add_dropdown("Method", METHODS, hint=hint)
        self._about = gui.add_html("")
        self._others = gui.add_checkbox("Show the others", True, hint="The other keyframes' curves, faintly")
        for number, row in enumerate(self._rows):
            on_click(row, partial(self._clicked, number))
        on_click(self._above, partial(self._scrolled, -ROWS))
        on_click(self._below, partial(self._scrolled, ROWS))
        on_choice(self._actions, self._acted)
        on_change(self._method, self._by_method)
        self._index = 0

    @property
    def others(self) -> bool:
        """Whether the curves of the other keyframes are to be seen."""
        return bool(self._others.value)

    def show(self, session: Session, live: Live) -> None:
        """Bring it up to date."""
        del live
        keyframes, times = keyframes_of(session.task), edits.times_of(session.task)
        self._list(keyframes, times, session.selected, session.marks)
        if session.selected != self._index:
            self._index = session.selected
            for field in self._fields:
                field.forget()
        own = session.keyframe
        self._name.show(own.name)
        self._time.show(round(times[self._index], FINEST), disabled=self._index == 0 and times[0] == 0.0)
        self._hold.show(round(own.hold, FINEST))
        put(self._method, value=own.method)
        put(self._about, content=about(own), visible=bool(about(own)))

    def _list(
        self, keyframes: tuple[Keyframe, ...], times: list[float], selected: int, marks: tuple[str, ...]
    ) -> None:
        """Bring the rows up to date; the selected keyframe is moved into sight when it changes."""
        count = len(keyframes)
        if (selected, count) != self._shown:
            self._shown = selected, count
            self._first = min(max(self._first, selected - ROWS + 1), selected)
        self._first = max(min(self._first, count - ROWS), 0)
        for number, row in enumerate(self._rows):
            index = self._first + number
            if index < count:
                mark = marks[index] if len(marks) == count else ""
                here = palette.START if index == selected else MARKS.get(mark, palette.FAINT)
                put(row, label=row_label(keyframes, times, index, mark), color=color(here))
            put(row, visible=index < count)
        above, below = self._first, count - self._first - ROWS
        put(self._above, label=f"{above} earlier", visible=count > ROWS, disabled=above <= 0)
        put(self._below, label=f"{max(below, 0)} later", visible=count > ROWS, disabled=below <= 0)

    def _finish(self) -> None:
        """Have done what was just typed, before anything else is."""
        for field in self._fields:
            field.finish()

    def _clicked(self, number: int) -> None:
        self._finish()
        self._post(lambda session: session.select(self._first + number))

    def _scrolled(self, rows: int) -> None:
        def scroll(session: Session) -> None:
            last = max(len(keyframes_of(session.task)) - ROWS, 0)
            self._first = min(max(self._first + rows, 0), last)

        self._post(scroll)

    def _acted(self, action: str) -> None:
        self._finish()
        requests = (add, delete, partial(move, -1), partial(move, 1))
        self._post(dict(zip(ACTIONS, requests, strict=True))[action])

    def _renamed(self, name: str, over: bool) -> None:
        del over
        self._post(partial(rename, self._index, name))

    def _retimed(self, time: float, over: bool) -> None:
        del over
        edit, what = edits.retimed(self._index, float(time)), f"keyframe {self._index + 1} at {time:g} s"
        self._post(lambda session: session.edit(edit, what))

    def _held(self, hold: float, over: bool) -> None:
        del over
        edit, what = edits.held(self._index, float(hold)), f"keyframe {self._index + 1} held {hold:g} s"
        self._post(lambda session: session.edit(edit, what))

    def _by_method(self, method: str) -> None:
        self._post(partial(choose_method, method))


def add(session: Session) -> None:
    """Add a keyframe behind the selected one."""
    index = session.selected
    session.edit(edits.added(index), f"added keyframe {index + 2}", select=index + 1)


def delete(session: Session) -> None:
    """Delete the selected keyframe."""
    index = session.selected
    session.edit(edits.removed(index), f"deleted keyframe {index + 1}", select=max(index - 1, 0))


def move(places: int, session: Session) -> None:
    """Move the selected keyframe to an earlier or later place."""
    index, to = session.selected, session.selected + places
    session.edit(edits.reordered(index, to), f"moved keyframe {index + 1} to place {to + 1}", select=to)


def rename(index: int, name: str, session: Session) -> None:
    """Give a keyframe another name."""
    what = f"named keyframe {index + 1} {name!r}" if name else f"took the name of keyframe {index + 1}"
    session.edit(edits.with_keyframe(index, name=name), what)


def choose_method(method: str, session: Session) -> None:
    """Propose another method for the selected keyframe."""
    index = session.selected
    session.propose(edits.with_keyframe(index, method=method), f"keyframe {index + 1} by method {method!r}")


def row_label(keyframes: tuple[Keyframe, ...], times: list[float], index: int, mark: str = "") -> str:
    """A keyframe in a row: number, name, time, and whether it can be taken if that is known."""
    named = f"  {keyframes[index].name}" if keyframes[index].name else ""
    marked = f"  ·  {mark}" if mark else ""
    return f"{index + 1}{named}  ·  {round(times[index], FINEST):g} s{marked}"


def about(keyframe: Keyframe) -> str:
    """What else is asked of a keyframe, as HTML; empty if there is nothing."""
    lines = []
    if keyframe.region is not None:
        first, last = keyframe.region
        lines.append(f"Only control points {first + 1} to {last + 1} have to take the shape.")
    if keyframe.tip is not None:
        lines.append(_tip(keyframe.tip))
    if not lines:
        return ""
    text = "<br>".join(escape(line) for line in lines)
    return f'<div style="font-size:13px;line-height:1.35;padding:0 12px 6px 12px">{text}</div>'


def _tip(tip: EndEffector) -> str:
    place = np.asarray(tip.position if tip.pose is None else np.asarray(tip.pose)[:3, 3])
    at = ", ".join(f"{value:.4g}" for value in place)
    which = "The tip" if tip.point == -1 else f"Control point {_name(tip.point)}"
    turned = "" if tip.pose is None else ", pointing as given" if tip.direction_only else ", turned as given"
    firm = "strictly" if tip.priority else f"with weight {tip.weight:g}"
    return f"{which} is asked to be at ({at}) m{turned}, {firm}."


def _name(point: int | str) -> str:
    if isinstance(point, str):
        return repr(point)
    return str(point + 1) if point >= 0 else f"{-point} from the tip"
