"""What the tab for keyframes asks of a session, and how it says what there is; without a page."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
from edited_tasks import bent_spline, straight_line, task

import pinposture as pp
from pinposture.editor import edits
from pinposture.editor.session import Session
from pinposture.errors import InvalidValue
from pinposture.task import Keyframe

pytest.importorskip("viser")

from pinposture.editor.ui import keyframes as tab
from pinposture.editor.ui import parts
from pinposture.editor.ui.player import drag_keyframe


def names(session: Session) -> list[str]:
    return [keyframe.name for keyframe in edits.keyframes_of(session.task)]


def test_add_goes_on_with_the_new_one_and_delete_with_the_one_before() -> None:
    session = Session(task(), selected=1)
    tab.add(session)
    assert (session.selected, len(names(session))) == (2, 5)
    assert session.keyframe.curve is bent_spline()
    tab.rename(2, "twice", session)
    assert names(session) == ["straight", "", "twice", "coil", ""]
    tab.delete(session)
    assert (session.selected, names(session)) == (1, ["straight", "", "coil", ""])
    for _ in range(3):
        session.undo()
    assert session.task.motion == task().motion


def test_moving_goes_along_and_stops_at_the_ends() -> None:
    session = Session(task(), selected=2)
    tab.move(-1, session)
    tab.move(-1, session)
    assert (session.selected, names(session)[0]) == (0, "coil")
    before = session.task
    tab.move(-1, session)
    assert session.task is before
    assert session.selected == 0
    assert session.notice.kind == "error"


def test_a_keyframe_is_dragged_along_the_timeline_and_put_back() -> None:
    session = Session(task(), selected=0)
    drag_keyframe(2, 0.234, 0.05, session)  # at 3.5 s before
    assert (session.selected, edits.times_of(session.task)[2]) == (2, 3.75)
    assert session.notice.text == "keyframe 3 is now at 3.75 s"
    drag_keyframe(2, 2.0, 0.05, session)
    assert (session.selected, names(session)) == (3, ["straight", "", "", "coil"])
    assert session.notice.text == "keyframe 4 is now at 5.75 s"
    before = session.task
    drag_keyframe(0, 1.0, 0.05, session)
    assert session.task is before
    assert session.notice.kind == "error"
    session.undo()
    session.undo()
    assert (session.task.motion, session.selected) == (task().motion, 0)


def test_a_method_waits_for_the_arm() -> None:
    session = Session(task(), selected=1)
    tab.choose_method("closest", session)
    assert session.proposal is not None
    assert session.keyframe.method == "closest"
    assert session.task.motion[1].method == "auto"  # type: ignore[index]


def test_rows_say_number_name_and_time() -> None:
    frames = edits.keyframes_of(task())
    times = [0.0, 1.0, 3.125, 12.5]
    rows = [tab.row_label(frames, times, index) for index in range(4)]
    assert rows[0].split() == ["1", "straight", "·", "0", "s"]
    assert rows[1].split() == ["2", "·", "1", "s"]
    assert rows[2].split() == ["3", "coil", "·", "3.125", "s"]
    assert rows[3].split() == ["4", "·", "12.5", "s"]


def test_rows_say_which_keyframes_are_taught() -> None:
    frames = edits.keyframes_of(edits.taught(2, np.zeros(12))(task()))
    assert tab.row_label(frames, [0.0, 1.0, 3.125, 12.5], 2, "fine").endswith("3.125 s  ·  taught  ·  fine")


def test_what_else_is_asked_is_said() -> None:
    straight = straight_line()
    assert tab.about(Keyframe(straight)) == ""
    region = tab.about(Keyframe(straight, region=(0, 3)))
    assert "Only control points 1 to 4 have to take the shape." in region
    tip = pp.EndEffector(position=(0.1, 0.25, -1.0), priority=True)
    assert "The tip goes to (0.1, 0.25, -1) m, with priority." in tab.about(Keyframe(straight, tip=tip))
    named = tab.about(Keyframe(straight, tip=pp.EndEffector(position=(0, 0, 0), point="<b>", weight=2.0)))
    assert "&lt;b&gt;" in named
    assert "with weight 2." in named


class Field:
    """A field as the page has it, typed into by `type`."""

    def __init__(self, value: object) -> None:
        self.value = value
        self.disabled = False
        self.visible = True
        self.precision = 3

    def on_update(self, call: object) -> None:
        self.call = call

    def type(self, value: object) -> None:
        self.value = value
        event = type("Event", (), {"client_id": 1, "target": self})()
        with pytest.raises(StopIteration):
            self.call(event).send(None)  # type: ignore[operator]


def bound(control: Field, value: list[object], **named: object) -> tuple[parts.Bound, list[object]]:
    """A field that shows the last of some values, and what was entered."""
    told: list[object] = []

    def edit(entered: object) -> Callable[[object], None]:
        return lambda _: told.append(entered)

    def post(request: Callable[[object], None], key: str = "") -> None:
        request(None)

    return parts.Bound(post, control, lambda _: value[-1], edit, **named), told  # type: ignore[arg-type]


SESSION: Any = None


def test_what_is_typed_counts_when_the_hand_rests(monkeypatch: pytest.MonkeyPatch) -> None:
    now = [100.0]
    monkeypatch.setattr(parts.time, "monotonic", lambda: now[0])
    control = Field(3.0)
    field, told = bound(control, [3.0])
    for key in (1.0, 12.0, 12.5):
        control.type(key)
        now[0] += 0.5 * parts.TYPING_PAUSE
        field.show(SESSION)
        assert (control.value, told) == (key, [])  # nobody writes into it
    now[0] += parts.TYPING_PAUSE
    field.show(SESSION)
    assert told == [12.5]
    field.show(SESSION)  # it was refused
    assert (control.value, told) == (3.0, [12.5])


def test_what_is_typed_counts_before_something_else_is_done_or_is_dropped() -> None:
    control = Field("coil")
    value: list[object] = ["coil"]
    field, told = bound(control, value)
    field.show(SESSION)
    field.finish()
    assert told == []
    control.type("spring")
    field.finish()
    field.finish()
    assert told == ["spring"]
    control.type("ring")
    field.forget()
    value.append("spring")
    field.show(SESSION)
    assert (control.value, told) == ("spring", ["spring"])


def test_a_field_shows_a_value_in_its_unit_and_tells_what_is_meant() -> None:
    control = Field(0.0)
    control.precision = 1
    value: list[object] = [0.01234]
    field, told = bound(control, value, unit=1e-3)
    field.show(SESSION)
    assert control.value == 12.3
    control.type(50.0)
    field.finish()
    assert told == [pytest.approx(0.05)]
    value.append((0.001, -1e-9, 0.0))
    field.show(SESSION)
    assert control.value == (1.0, 0.0, 0.0)
    control.type((1.0, 2.0, 3.0))
    field.finish()
    assert told[-1] == pytest.approx((0.001, 0.002, 0.003))


@pytest.mark.parametrize("absent", [None, {"disabled": True}])
def test_a_field_without_a_value_is_hidden_or_off_and_forgets(absent: dict[str, bool] | None) -> None:
    control = Field(1.0)
    value: list[object] = [1.0]
    field, told = bound(control, value, absent=absent)
    control.type(2.0)
    value.append(None)
    field.show(SESSION)
    assert (control.visible, control.disabled) == ((True, True) if absent else (False, False))
    value.append(3.0)
    field.show(SESSION)
    assert (control.visible, control.disabled, control.value) == (True, False, 3.0)
    assert told == []


def test_a_value_is_written_only_when_it_has_changed() -> None:
    class Counted(Field):
        """Counts what is written into it."""

        written = 0

        def __setattr__(self, name: str, value: object) -> None:
            Counted.written += name == "value"
            super().__setattr__(name, value)

    value: list[object] = [1.0]
    field, told = bound(Counted(1.0), value)
    for each in (1.0, 1.0, 2.0, 2.0):
        value.append(each)
        field.show(SESSION)
    assert Counted.written == 2  # once when it was made
    assert told == []


def test_what_is_being_typed_may_be_seen_before_it_counts() -> None:
    seen: list[object] = []

    def preview(entered: object) -> Callable[[object], None] | None:
        return None if entered == 1.0 else lambda _: seen.append(entered)

    control = Field(0.0)
    field, told = bound(control, [0.0], preview=preview)
    for key in (1.0, 12.0):
        control.type(key)
    assert (seen, told) == ([12.0], [])
    field.finish()
    assert (seen, told) == ([12.0], [12.0])


def test_a_speed_is_refused_in_the_unit_of_its_field() -> None:
    session = Session(task(), selected=1)
    tab.set_speed(1, 50.0, session)
    assert session.keyframe.speed == 0.5
    for percent in (0.0, -5.0, 101.0):
        with pytest.raises(
            InvalidValue, match=rf"speed is '{percent:g} %'; allowed: more than 0 %, up to 100 %"
        ):
            tab.set_speed(1, percent, session)
    assert session.keyframe.speed == 0.5
