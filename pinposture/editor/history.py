"""What was done to a task, to undo and to do again."""

from __future__ import annotations

from typing import NamedTuple

from pinposture.task import Task

MOST = 500
"""How many steps back can be gone."""


class Done(NamedTuple):
    """A state of the task.

    Attributes:
        task: the task.
        what: what was done to get there, in words.
        before: which keyframe was selected when that was done, 0-based.
        after: which one was selected by it.
    """

    task: Task
    what: str
    before: int
    after: int


class History:
    """The states of a task, and where among them we are.

    Args:
        task: the first state.
        selected: the keyframe that is selected in it.
    """

    def __init__(self, task: Task, selected: int = 0) -> None:
        self._states = [Done(task, "", selected, selected)]
        self._at = 0

    @property
    def now(self) -> Done:
        """The state that counts."""
        return self._states[self._at]

    @property
    def undoable(self) -> str:
        """What `undo` would take back, in words; empty if there is nothing."""
        return self.now.what

    @property
    def redoable(self) -> str:
        """What `redo` would do again, in words; empty if there is nothing."""
        ahead = self._states[self._at + 1 : self._at + 2]
        return ahead[0].what if ahead else ""

    def add(self, task: Task, what: str, before: int, after: int) -> None:
        """Go on to another state; what was undone is forgotten.

        Args:
            task: the state.
            what: what was done to get there, in words.
            before: the keyframe that was selected when it was done, 0-based.
            after: the one to go on with.
        """
        del self._states[self._at + 1 :]
        self._states.append(Done(task, what, before, after))
        if len(self._states) > MOST:
            del self._states[0]
            self._states[0] = self._states[0]._replace(what="")
        self._at = len(self._states) - 1

    def undo(self) -> Done | None:
        """Go back by one state; None if there is none before, else what was undone."""
        if self._at == 0:
            return None
        self._at -= 1
        return self._states[self._at + 1]

    def redo(self) -> Done | None:
        """Go on to the state that was undone; None if there is none, else what was done again."""
        if self._at + 1 >= len(self._states):
            return None
        self._at += 1
        return self.now
