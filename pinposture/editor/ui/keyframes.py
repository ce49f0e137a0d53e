"""The Keyframes tab: the list of keyframes, their order and times, and the values of the selected one."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from html import escape

import numpy as np
import viser
from numpy.typing import NDArray

from pinposture.arm import Arm
from pinposture.control import EndEffector
from pinposture.editor import edits
from pinposture.editor.edits import differ_in_weight_alone, keyframes_of
from pinposture.editor.measured_arm import JointStates
from pinposture.editor.phases import EditedPhase
from pinposture.editor.postures import add_taught, draw_curve, teach
from pinposture.editor.session import Session
from pinposture.editor.solver import Live
from pinposture.editor.ui.parts import Bound, Post, Request, color, on_choice, on_click, put
from pinposture.editor.ui.phases import PhaseControls, PhasePlanner
from pinposture.errors import InvalidValue
from pinposture.placement.resolve import METHODS
from pinposture.task import Keyframe, Task
from pinposture.viz.palette import THEME

Array = NDArray[np.float64]

LISTED_ROWS = 8
MARK_COLORS = {"collides": THEME.active, "refused": THEME.mark}
SECOND_DIGITS = 3  # of times and speeds, behind the point


class KeyframesTab:
    """Controls for the keyframes of the task."""

    def __init__(self, server: viser.ViserServer, arm: Arm, states: JointStates | None, post: Post) -> None:
        self._post = post
        gui = server.gui
        self._states = states if states is not None and differ_in_weight_alone(states.arm, arm) else None
        self._present = arm.straight()
        self._first = 0  # the first row
        self._shown = (-1, -1)  # which keyframe of how many was selected
        self._index = 0
        self._times = [0.0]
        self._phases = PhaseControls(server, arm, PhasePlanner(post), post)
        self._above = gui.add_button("", icon=viser.Icon.CHEVRON_UP, color="gray", visible=False)
        self._rows = [gui.add_button("", color="gray", visible=False) for _ in range(LISTED_ROWS)]
        self._below = gui.add_button("", icon=viser.Icon.CHEVRON_DOWN, color="gray", visible=False)
        hint = "Add a keyframe after this one, with its shape; delete it; move it earlier or later"
        actions = gui.add_button_group("Keyframe", tuple(ACTIONS), hint=hint)
        hint = "Uses the posture of the measured arm if there is one, else of the arm shown"
        taught = gui.add_button_group("Taught", tuple(TAUGHT_ACTIONS), hint=hint)
        name = gui.add_text("Name", "", hint="Empty: its number")
        when = gui.add_number("Time [s]", 0.0, step=0.1, hint="When the arm reaches it")
        hold = gui.add_number("Hold [s]", 0.0, step=0.1, hint="How long to stay; later keyframes shift")
        speed = gui.add_number("Speed [%]", 100.0, step=5.0, hint="Of the velocity limits, on the way to it")
        bind = partial(Bound, post)
        self._time = bind(when, lambda session: round(self._times[self._index], SECOND_DIGITS), self._retime)
        self._fields = (
            bind(
                name,
                lambda session: session.keyframe.name,
                lambda to: partial(rename, self._index, to),
            ),
            bind(hold, lambda session: round(session.keyframe.hold, SECOND_DIGITS), self._set_hold),
            bind(
                speed,
                lambda session: round(100.0 * session.keyframe.speed, SECOND_DIGITS),
                lambda percent: partial(set_speed, self._index, float(percent)),
            ),
        )
        hint = "Placement of the modules on the curve; auto: one by one, or all at once if that zigzags"
        method = gui.add_dropdown("Method", METHODS, hint=hint)
        self._method = bind(
            method, lambda session: session.keyframe.method, lambda method: partial(choose_method, method)
        )
        self._about = gui.add_html("")
        laps = gui.add_number("Laps", 1, min=1, step=1, hint="How often the whole motion is repeated")
        hint = "Time to return to the first keyframe for the next lap; 0: as the longest motion between two"
        back = gui.add_number("Return [s]", 0.0, min=0.0, step=0.1, hint=hint)
        for field in (when, hold, speed, back):
            field.precision = SECOND_DIGITS
        self._laps = bind(
            laps,
            lambda session: None if isinstance(session.task, EditedPhase) else session.task.repeat,
            _repeat,
        )
        self._back = bind(back, _return_time_of, _set_return)
        self._others = gui.add_checkbox("Other curves", True, hint="Show the curves of the other keyframes")
        for number, row in enumerate(self._rows):
            on_click(row, partial(self._select, number))
        on_click(self._above, partial(self._scroll, -LISTED_ROWS))
        on_click(self._below, partial(self._scroll, LISTED_ROWS))
        on_choice(actions, self._act)
        on_choice(taught, self._act_taught)

    @property
    def others(self) -> bool:
        """Whether the curves of the other keyframes are to be shown."""
        return bool(self._others.value)

    def show(self, session: Session, live: Live) -> None:
        """Bring it up to date."""
        measured = None if self._states is None else self._states.latest
        self._present = measured.q if measured is not None and measured.count > 0 else live.state.q
        keyframes = keyframes_of(session.task)
        self._times = edits.times_of(session.task)
        self._phases.show(session, live)
        self._list(keyframes, self._times, session.selected, session.marks)
        if session.selected != self._index:
            self._index = session.selected
            for field in (self._time, *self._fields):
                field.forget()
        self._time.show(session, disabled=self._index == 0 and self._times[0] == 0.0)
        for field in self._fields:
            field.show(session)
        self._method.show(session, disabled=session.keyframe.curve is None)
        text = about(session.keyframe, session.task)
        put(self._about, content=text, visible=bool(text))
        self._laps.show(session)
        self._back.show(session)

    def _list(
        self, keyframes: tuple[Keyframe, ...], times: list[float], selected: int, marks: tuple[str, ...]
    ) -> None:
        """Bring the rows up to date; the selected keyframe is scrolled into sight when it changes."""
        count = len(keyframes)
        if (selected, count) != self._shown:
            self._shown = selected, count
            self._first = min(max(self._first, selected - LISTED_ROWS + 1), selected)
        self._first = max(min(self._first, count - LISTED_ROWS), 0)
        for number, row in enumerate(self._rows):
            index = self._first + number
            if index < count:
                mark = marks[index] if len(marks) == count else ""
                shade = THEME.start if index == selected else MARK_COLORS.get(mark, THEME.faint)
                put(row, label=row_label(keyframes, times, index, mark), color=color(shade))
            put(row, visible=index < count)
        above = self._first
        below = count - self._first - LISTED_ROWS
        put(self._above, label=f"{above} earlier", visible=count > LISTED_ROWS, disabled=above <= 0)
        put(self._below, label=f"{max(below, 0)} later", visible=count > LISTED_ROWS, disabled=below <= 0)

    def _finish_typing(self) -> None:
        for field in (self._time, *self._fields):
            field.finish()

    def _select(self, number: int) -> None:
        self._finish_typing()
        self._post(lambda session: session.select(self._first + number))

    def _scroll(self, rows: int) -> None:
        def scroll(session: Session) -> None:
            last = max(len(keyframes_of(session.task)) - LISTED_ROWS, 0)
            self._first = min(max(self._first + rows, 0), last)

        self._post(scroll)

    def _act(self, action: str) -> None:
        self._finish_typing()
        self._post(ACTIONS[action])

    def _act_taught(self, action: str) -> None:
        self._finish_typing()
        self._post(lambda session: TAUGHT_ACTIONS[action](self._present, session))

    def _retime(self, time: float) -> Request:
        edit = edits.retimed(self._index, float(time))
        return partial(Session.edit, edit=edit, what=f"keyframe {self._index + 1} at {time:g} s")

    def _set_hold(self, hold: float) -> Request:
        edit = edits.held(self._index, float(hold))
        return partial(Session.edit, edit=edit, what=f"keyframe {self._index + 1} held {hold:g} s")


def _repeat(laps: float) -> Request:
    what = f"{laps:g} laps" if laps != 1 else "a single lap"
    return partial(Session.edit, edit=edits.repeated(round(laps)), what=what)


def _return_time_of(session: Session) -> float | None:
    return keyframes_of(session.task)[0].duration or 0.0 if session.task.repeat > 1 else None


def _set_return(time: float) -> Request:
    what = f"return to keyframe 1 in {time:g} s" if time else "return to keyframe 1 in the usual time"
    return partial(Session.edit, edit=edits.with_keyframe(0, duration=float(time) or None), what=what)


def add(session: Session) -> None:
    """Add a keyframe after the selected one."""
    index = session.selected
    session.edit(edits.added(index), f"added keyframe {index + 2}", select=index + 1)


def delete(session: Session) -> None:
    """Delete the selected keyframe."""
    index = session.selected
    session.edit(edits.removed(index), f"deleted keyframe {index + 1}", select=max(index - 1, 0))


def move(by: int, session: Session) -> None:
    """Move the selected keyframe to an earlier or later position."""
    index = session.selected
    to = session.selected + by
    session.edit(edits.reordered(index, to), f"moved keyframe {index + 1} to position {to + 1}", select=to)


ACTIONS = {"Add": add, "Delete": delete, "Earlier": partial(move, -1), "Later": partial(move, 1)}
"""What the buttons do to the selected keyframe, by their labels."""

TAUGHT_ACTIONS: dict[str, Callable[[Array, Session], None]] = {
    "Add taught": add_taught,
    "Teach": teach,
    "To curve": lambda _, session: draw_curve(session),
}
"""What the buttons do with the present posture and the selected keyframe, by their labels."""


def rename(index: int, name: str, session: Session) -> None:
    """Rename a keyframe."""
    what = f"named keyframe {index + 1} {name!r}" if name else f"removed the name of keyframe {index + 1}"
    session.edit(edits.with_keyframe(index, name=name), what)


def set_speed(index: int, percent: float, session: Session) -> None:
    """Set the share of the velocity limits for the motion to a keyframe [%]."""
    if not 0.0 < percent <= 100.0:
        raise InvalidValue("speed", f"{percent:g} %", "more than 0 %, up to 100 %")
    edit = edits.with_keyframe(index, speed=percent / 100.0)
    session.edit(edit, f"keyframe {index + 1} at {percent:g} % of the velocity limits")


def choose_method(method: str, session: Session) -> None:
    """Propose another placement method for the selected keyframe."""
    index = session.selected
    session.propose(edits.with_keyframe(index, method=method), f"keyframe {index + 1} by method {method!r}")


def row_label(keyframes: tuple[Keyframe, ...], times: list[float], index: int, mark: str = "") -> str:
    """Return the label of a keyframe: number, name, time, and whether it can be taken if that is known."""
    named = f"  {keyframes[index].name}" if keyframes[index].name else ""
    marked = "".join(f"  ·  {word}" for word in ("taught" * (keyframes[index].curve is None), mark) if word)
    return f"{index + 1}{named}  ·  {round(times[index], SECOND_DIGITS):g} s{marked}"


def about(keyframe: Keyframe, task: Task | None = None) -> str:
    """Return the region and the tip task of a keyframe, and what its phase fixes, as HTML; may be empty."""
    lines: list[str] = []
    if isinstance(task, EditedPhase) and task.end is not None:
        lines.append("This phase has no keyframes; these are the postures in which it begins and ends.")
    elif isinstance(task, EditedPhase) and task.begin is not None:
        lines.append("Keyframe 1 is where the phase before ends, and stays.")
    if keyframe.region is not None:
        first, last = keyframe.region
        lines.append(f"Only control points {first + 1} to {last + 1} have to take the shape.")
    if keyframe.tip is not None:
        lines.append(_describe_tip(keyframe.tip))
    if not lines:
        return ""
    text = "<br>".join(escape(line) for line in lines)
    return f'<div style="font-size:13px;line-height:1.35;padding:0 12px 6px 12px">{text}</div>'


def _describe_tip(tip: EndEffector) -> str:
    position = np.asarray(tip.position if tip.pose is None else np.asarray(tip.pose)[:3, 3])
    at = ", ".join(f"{value:.4g}" for value in position)
    point = repr(tip.point)
    if not isinstance(tip.point, str):
        point = str(tip.point + 1) if tip.point >= 0 else f"{-tip.point} from the tip"
    which = "The tip" if tip.point == -1 else f"Control point {point}"
    turned = "" if tip.pose is None else ", direction given" if tip.direction_only else ", orientation given"
    firm = "with priority" if tip.priority else f"with weight {tip.weight:g}"
    return f"{which} goes to ({at}) m{turned}, {firm}."
