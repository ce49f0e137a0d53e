"""Undo and redo, against a plain list of all states."""

from __future__ import annotations

import pytest
from edited_tasks import task
from hypothesis import given
from hypothesis import strategies as st
from test_edits import any_edit, done

from pinposture.editor import edits
from pinposture.editor.session import MAX_HISTORY, History
from pinposture.task import Task

steps = st.lists(st.sampled_from(["undo", "redo"]) | st.integers(0, 5), max_size=30)


@pytest.fixture(scope="session")
def tasks() -> list[Task]:
    return [task(name=str(k)) for k in range(6)]


@given(steps)
def test_it_is_a_list_of_states_and_a_place_in_it(tasks: list[Task], listed: list[str | int]) -> None:
    history = History(tasks[0], 3)
    states = [(tasks[0], "", 3, 3)]
    at = 0
    for number, step in enumerate(listed):
        if isinstance(step, int):
            states[at + 1 :] = [(tasks[step], f"what {number}", number, number + 1)]
            at += 1
            history.add(*states[at])
        elif step == "undo":
            undone = history.undo()
            assert undone == (states[at] if at > 0 else None)
            at = max(at - 1, 0)
        else:
            again = history.redo()
            assert again == (states[at + 1] if at + 1 < len(states) else None)
            at = min(at + 1, len(states) - 1)
        assert history.now.task is states[at][0]
        assert history.undoable == states[at][1]
        assert history.redoable == (states[at + 1][1] if at + 1 < len(states) else "")


@given(st.lists(any_edit, max_size=10), st.integers(0, 10))
def test_after_any_edits_undo_and_redo_come_back_to_the_same_tasks(
    listed: list[edits.Edit], back: int
) -> None:
    history = History(task())
    states = [history.now.task]
    for edit in listed:
        after = done(edit, states[-1])
        history.add(after, "something", 0, 0)
        states.append(after)
    back = min(back, len(states) - 1)
    for index in range(len(states) - 2, len(states) - 2 - back, -1):
        assert history.undo() is not None
        assert history.now.task is states[index]
        assert history.now.task.motion == states[index].motion
    for index in range(len(states) - back, len(states)):
        assert history.redo() is not None
        assert history.now.task is states[index]
    assert history.redo() is None


def test_it_forgets_what_is_long_ago(tasks: list[Task]) -> None:
    history = History(tasks[0])
    for number in range(MAX_HISTORY + 20):
        history.add(tasks[number % 6], f"what {number}", 0, 0)
    count = 0
    while history.undo() is not None:
        count += 1
    assert count == MAX_HISTORY - 1
    assert history.undoable == ""
    assert history.now.task is tasks[20 % 6]
