"""A session: what counts, what is proposed, and what is said."""

from __future__ import annotations

import re
import time
from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest
from edited_tasks import L, bent_spline, task

import pinposture as pp
from pinposture.arm import Arm
from pinposture.editor import edits
from pinposture.editor.edits import Shape, reshaped
from pinposture.editor.session import Session
from pinposture.editor.solver import Live, Solver, Verdict, judge
from pinposture.errors import InvalidValue
from pinposture.task import Keyframe


def opened(selected: int = 1) -> Session:
    return Session(task(), selected=selected)


def looked_at(session: Session) -> Live:
    """What a solver says that has judged what is asked, and has not moved."""
    problem = session.problem
    live = Solver(problem, problem.arm.straight()).live
    return live._replace(verdict=judge(problem.arm, problem.keyframe, problem.scene))


def moved(index: int, place: tuple[float, float, float]) -> Callable[[Arm, Shape], Shape]:
    return lambda arm, shape: shape.moved(arm, index, L * np.array(place))


OVER = moved(2, (0.7, 0.2, 0.1))


def test_a_shape_counts_once_the_arm_is_seen_to_take_it() -> None:
    session = opened()
    before = session.task
    session.reshape(OVER, "moved point 3")
    assert session.task is before
    assert np.allclose(session.shape.points[2], L * np.array((0.7, 0.2, 0.1)))
    session.settle(looked_at(session)._replace(number=session.number - 1))  # of what was before
    assert session.task is before
    session.settle(looked_at(session))
    assert session.proposal is None
    assert np.allclose(session.task.motion[1].curve.control_points[2], L * np.array((0.7, 0.2, 0.1)))  # type: ignore
    assert session.history.undoable == "moved point 3"
    assert before.motion[1].curve is bent_spline()  # type: ignore[index]


def test_a_shape_that_the_arm_cannot_take_changes_nothing() -> None:
    session = opened()
    before = session.task
    number = session.number
    half = L * np.array([(0, 0, 0), (0.1, 0, 0), (0.3, 0, 0), (0.5, 0, 0)])
    session.reshape(lambda arm, shape: Shape(half), "halved it")
    live = looked_at(session)
    assert live.verdict.target is None
    session.settle(live)
    assert session.task is before
    assert session.proposal is None
    assert session.notice.kind == "error"
    assert session.notice.text.startswith("halved it: refused, the arm cannot take that shape: too short")
    assert session.number > number + 1  # the solver is asked for what counts again
    assert session.keyframe is before.motion[1]  # type: ignore[index]
    session.undo()
    assert session.notice.text == "nothing to undo"
    assert session.task is before


def test_points_that_give_no_curve_are_refused_at_once() -> None:
    session = opened()
    session.reshape(moved(2, (0.4, 0.0, 0.0)), "moved point 3")  # onto point 2
    assert session.proposal is None
    assert "is too close to point 2" in session.notice.text
    assert session.history.undoable == ""


def test_a_drag_is_one_step_back() -> None:
    session = opened()
    before = session.task
    for k in range(20):
        session.reshape(moved(2, (0.7, 0.1 + 0.005 * k, 0.1)), "moved point 3", final=k == 19)
        session.settle(looked_at(session))
    assert session.proposal is None
    session.undo()
    assert session.task is before
    session.redo()
    assert np.allclose(session.shape.points[2], L * np.array((0.7, 0.195, 0.1)))


def test_each_move_of_a_drag_is_made_from_where_it_began() -> None:
    session = opened()
    at_first = session.shape.points
    session.reshape(moved(4, (0.2, 0.0, 0.0)), "moved point 5", final=False)  # pushed out until long enough
    session.reshape(moved(2, (0.7, 0.2, 0.1)), "moved point 3", final=False)
    assert np.array_equal(session.shape.points[4], at_first[4])


def test_what_is_proposed_ends_with_an_edit_and_with_another_keyframe() -> None:
    session = opened()
    session.reshape(OVER, "moved point 3", final=False)
    assert session.edit(edits.with_keyframe(0, name="begin"), "named it")
    assert session.proposal is None
    assert session.shown is session.task
    session.reshape(OVER, "moved point 3", final=False)
    session.select(2)
    assert session.proposal is None
    assert session.shown is session.task


def test_a_curve_of_another_kind_says_what_became_of_it() -> None:
    session = opened(selected=2)  # a helix
    session.reshape(moved(3, (0.3, 0.3, 0.3)), "moved point 4")
    live = looked_at(session)
    session.settle(live._replace(verdict=live.verdict._replace(target=looked_at(opened()).verdict.target)))
    said = r"moved point 4; the curve was replaced by (\d+) control points \(within [\d.]+ mm of it\)"
    found = re.fullmatch(said, session.notice.text)
    assert found, session.notice.text
    assert int(found[1]) == len(session.shape.points)
    assert session.history.undoable == "moved point 4"


def test_an_edit_that_is_refused_changes_nothing_and_says_why() -> None:
    session = opened()
    before = session.task
    number = session.number
    assert not session.edit(edits.retimed(1, -1.0), "no")
    assert session.task is before
    assert session.number == number
    assert "time of keyframe 2 is -1.0" in session.notice.text
    assert session.notice.kind == "error"


def test_undo_goes_where_it_was_done() -> None:
    session = opened(selected=3)
    session.edit(edits.held(3, 1.0), "held")
    session.select(0)
    session.edit(edits.added(0), "added", select=1)
    session.select(4)
    session.undo()
    assert session.selected == 0
    assert session.notice.text == "undone: added"
    session.undo()
    assert session.selected == 3
    session.redo()
    assert (session.selected, session.keyframe.hold) == (3, 1.0)
    session.redo()
    assert session.selected == 1
    assert session.notice.text == "redone: added"


def test_what_is_selected_is_always_there() -> None:
    session = opened(selected=3)
    session.edit(edits.added(3), "added", select=4)
    session.handle = 1
    session.undo()
    assert (session.selected, session.handle) == (3, None)
    session.select(17)
    assert session.selected == 3
    session.edit(edits.with_obstacle("ball", pp.Sphere((1, 1, 1), 0.1)), "put a ball")
    session.obstacle = "ball"
    session.undo()
    assert session.obstacle is None
    with pytest.raises(InvalidValue, match="selected"):
        Session(task(), selected=4)


def test_a_method_is_proposed_as_shapes_are() -> None:
    session = opened()
    session.propose(edits.with_keyframe(1, method="closest"), "by method 'closest'")
    assert session.task.motion[1].method == "auto"  # type: ignore[index]
    session.settle(looked_at(session))
    assert session.task.motion[1].method == "closest"  # type: ignore[index]


def test_the_file_is_behind_after_a_change_and_not_after_it_was_undone(tmp_path: object) -> None:
    session = Session(task(), path=tmp_path)  # type: ignore[arg-type]
    assert not session.changed
    session.edit(edits.held(1, 1.0), "held")
    assert session.changed
    session.undo()
    assert not session.changed


def test_the_next_task_is_begun_with_nothing_of_the_last() -> None:
    session = opened()
    session.reshape(OVER, "moved point 3")
    bent = Keyframe(bent_spline(), trim=True)
    session.replace(task(bent, replace(bent, time=1.0)), None, saved=False)
    assert (session.selected, session.handle, session.proposal) == (0, None, None)
    assert session.history.undoable == ""
    assert session.changed


@pytest.mark.parametrize("index", [-1, 99])
def test_a_control_point_that_there_is_not_cannot_be_selected(index: int) -> None:
    session = opened()
    session.obstacle = "post"
    session.take_hold(2)
    assert (session.handle, session.obstacle) == (2, None)
    session.take_hold(index)
    assert session.handle == 2
    session.take_hold(None)
    assert session.handle is None


def test_a_new_control_point_that_cannot_be_is_selected_no_more() -> None:
    session = opened()
    count = len(session.shape.points)
    session.take_hold(count - 1)
    session.reshape(lambda arm, shape: shape.inserted(arm, count - 1), "inserted a point")
    session.take_hold(count)
    assert session.handle == count
    session.settle(looked_at(session)._replace(verdict=Verdict(None, "no")))
    assert len(session.shape.points) == count
    assert session.handle is None


def test_a_keyframe_that_is_gone_is_not_changed() -> None:
    session = opened()
    shape = session.shape
    before = session.task
    for edit in (
        edits.with_keyframe(4, name="x"),
        reshaped(4, lambda arm, shape: shape, shape),
        edits.retimed(4, 9.0),
        edits.held(-1, 1.0),
        edits.added(4),
        edits.removed(4),
        edits.reordered(4, 0),
    ):
        assert not session.edit(edit, "changed it")
        assert "does not exist; allowed: 1 to 4" in session.notice.text
    assert session.task is before


def test_a_message_is_shown_as_long_as_what_it_speaks_of(monkeypatch: pytest.MonkeyPatch) -> None:
    session = opened()
    assert session.message is None
    now = time.monotonic()
    monkeypatch.setattr("time.monotonic", lambda: now)
    session.say("keyframe 2 is refused", "error")
    now += 1000.0
    assert session.message is not None  # nothing was edited since
    assert session.edit(edits.with_keyframe(1, hold=0.1), "held")
    now += 1.0
    assert session.message is None or session.message.text != "keyframe 2 is refused"
    session.say("of this keyframe")
    session.select(0)
    now += 1.0
    assert session.message is not None  # it can still be read
    now += 10.0
    assert session.message is None
