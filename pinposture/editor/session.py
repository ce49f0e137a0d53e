"""What is being edited: the task, what is selected and proposed, and what can be undone."""

from __future__ import annotations

import time
from collections.abc import Callable
from pathlib import Path
from typing import NamedTuple

import numpy as np

from pinposture.arm import Arm
from pinposture.editor.autosave import version_of
from pinposture.editor.clearances import NearestObstacle
from pinposture.editor.edits import Edit, keyframes_of, reshaped, with_keyframe
from pinposture.editor.playback import Playback
from pinposture.editor.shape import Shape
from pinposture.editor.solver import Live, Problem
from pinposture.errors import FileError, InvalidValue, PostureError
from pinposture.task import Keyframe, Task

# What was done to a task, to undo and to do again.

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


# What is being edited: the task, what is selected of it, what is proposed, and what there is to say.

DIGITS = 6
"""To how many digits joint positions are kept that a shape is taken near [rad or m]."""


class Notice(NamedTuple):
    """Something to say.

    Attributes:
        text: what.
        kind: "info", "warning" or "error".
        number: rises with each.
    """

    text: str
    kind: str
    number: int


class Proposal(NamedTuple):
    """A change of the shape that counts once the arm is seen to be able to take it.

    Attributes:
        task: what it would make of the task.
        what: what was done, in words.
        final: whether it is to count, or the hand is still at it.
        number: of the problem that it is to the solver.
        note: what else to say when it counts.
    """

    task: Task
    what: str
    final: bool
    number: int
    note: str = ""


class Session:
    """What is being edited. It belongs to the editor's loop, and nobody else touches it.

    Attributes:
        history: the states of the task.
        path: the task file; None if it was never saved.
        selected: the keyframe that is edited, 0-based.
        handle: the control point of its curve that is selected, 0-based; None if there is none.
        obstacle: the obstacle that is selected, by name; None if there is none.
        proposal: a change that does not count yet; None if there is none.
        nearest: where the arm is nearest to what is around it; None if there is nothing.
        marks: whether each keyframe can be taken, "fine", "collides" or "refused"; empty while unknown.
        notice: the last thing that was said.
        at_once: whether the arm takes shapes at once, whatever its limits.
        number: rises with everything that the solver should know.
        saved: the task as it is in the file; None if it is in none.
        playback: what is shown of the motion of the task.
        folder: where files are opened and saved, and nowhere else; see `within`.

    Args:
        task: the task.
        path: its file, if it has one.
        selected: the keyframe to begin with; the last if None.
        folder: where files are opened and saved; that of the task file if None, or where we are without one.

    Raises:
        FileError: no such folder, or a task file that is not in it.
        TaskError: a task that has no keyframes.
        InvalidValue: one to begin with that there is not.
    """

    def __init__(
        self,
        task: Task,
        path: Path | None = None,
        selected: int | None = None,
        folder: Path | None = None,
    ) -> None:
        count = len(keyframes_of(task))
        self.selected = count - 1 if selected is None else selected
        if not 0 <= self.selected < count:
            raise InvalidValue("selected", selected, f"a keyframe of the task, 0 to {count - 1}")
        self.history = History(task, self.selected)
        self.path = None if path is None else path.absolute()
        self.folder = _folder_of(self.path) if folder is None else _checked(folder, self.path)
        self.handle: int | None = None
        self.obstacle: str | None = None
        self.proposal: Proposal | None = None
        self.nearest: NearestObstacle | None = None
        self.marks: tuple[str, ...] = ()
        self.notice = Notice("", "info", 0)
        self.at_once = False
        self.number = 1
        self.asked = time.monotonic()
        self.saved: Task | None = task if path is not None and version_of(path) else None
        self.playback = Playback()
        self._shapes: tuple[Keyframe, Shape] | None = None

    @property
    def task(self) -> Task:
        """The task as it counts."""
        return self.history.now.task

    @property
    def shown(self) -> Task:
        """The task as it is to be seen, with what is proposed."""
        return self.task if self.proposal is None else self.proposal.task

    @property
    def arm(self) -> Arm:
        """The arm."""
        return self.task.arm

    @property
    def keyframe(self) -> Keyframe:
        """The keyframe that is edited, as it is to be seen."""
        return keyframes_of(self.shown)[self.selected]

    @property
    def shape(self) -> Shape:
        """Its shape, as it is to be seen."""
        keyframe = self.keyframe
        if self._shapes is None or self._shapes[0] is not keyframe:
            self._shapes = keyframe, Shape.of(self.arm, keyframe)
        return self._shapes[1]

    @property
    def changed(self) -> bool:
        """Whether there is something that is in no file yet."""
        return self.saved is not self.task

    @property
    def problem(self) -> Problem:
        """What is asked of the arm."""
        task = self.shown
        return Problem(
            self.number,
            task.arm,
            self.keyframe,
            task.controller,
            task.limits,
            task.scene,
            self.at_once,
            self.asked,
            shaping=self.proposal is not None,
            passing=self.proposal is not None and not self.proposal.final,
        )

    def say(self, text: str, kind: str = "info") -> None:
        """Say something."""
        self.notice = Notice(" ".join(text.split()), kind, self.notice.number + 1)

    def touch(self) -> None:
        """Something changed that the solver should know, and whoever looks on."""
        self.number += 1
        self.asked = time.monotonic()

    def edit(self, edit: Edit, what: str, select: int | None = None) -> bool:
        """Do something to the task, at once; say why not if it cannot be.

        Args:
            edit: what to do.
            what: the same in words, for `undo`.
            select: the keyframe to go on with.

        Returns:
            Whether it was done.
        """
        try:
            task = edit(self.task)
        except PostureError as error:
            self.say(str(error), "error")
            return False
        self._add(task, what, self.selected if select is None else select)
        return True

    def reshape(self, change: Callable[[Arm, Shape], Shape], what: str, final: bool = True) -> None:
        """Propose another shape of the keyframe; it counts once the arm is seen to be able to take it.

        While the hand is at it each proposal is made to the shape from before, not to the proposal before.

        Args:
            change: what to do to the shape.
            what: the same in words.
            final: whether it is to count.
        """
        self.proposal = None
        try:
            shape = self.shape
        except PostureError as error:
            self.say(str(error), "error")
            return
        self.propose(reshaped(self.selected, change, shape), what, final, _anew(shape))

    def propose(self, edit: Edit, what: str, final: bool = True, note: str = "") -> None:
        """Propose another keyframe in place of the selected one, as `reshape` does another shape of it.

        Args:
            edit: what to do.
            what: the same in words.
            final: whether it is to count.
            note: what else to say when it counts.
        """
        self.proposal = None
        try:
            task = edit(self.task)
        except PostureError as error:
            self.say(str(error), "error" if final else "warning")
            self.touch()  # what was proposed before is gone
            return
        self.touch()
        self.proposal = Proposal(task, what, final, self.number, note)

    def settle(self, live: Live) -> None:
        """Decide on what was proposed, if the solver has looked at it."""
        proposal = self.proposal
        if proposal is None or not proposal.final or live.number < proposal.number:
            return
        self.proposal = None
        target = live.verdict.target
        if target is None:
            self._settle_on(self.selected)
            reason = f"not done, the arm cannot take that shape: {live.verdict.reason}"
            self.say(f"{proposal.what}: {reason}", "error")
            self.touch()
            return
        task = proposal.task
        if target.q is not None:  # what is seen now is what is opened again, and played
            joints = tuple(np.round(self.arm.positions(target.q), DIGITS).tolist())
            task = with_keyframe(self.selected, joints=joints)(task)
        self._add(task, proposal.what, self.selected)
        if proposal.note:
            self.say(f"{proposal.what}; {proposal.note}")

    def take_hold(self, handle: int | None) -> None:
        """Select a control point, 0-based, in place of an obstacle; one that there is not changes nothing."""
        if handle is None:
            self.handle = None
        elif 0 <= handle < len(self.shape.points):
            self.handle, self.obstacle = handle, None

    def select(self, keyframe: int) -> None:
        """Go on with another keyframe, 0-based; one that there is not changes nothing."""
        if keyframe != self.selected and 0 <= keyframe < len(keyframes_of(self.task)):
            self.selected, self.handle, self.proposal = keyframe, None, None
            self.touch()

    def undo(self) -> None:
        """Take the last change back."""
        undone = self.history.undo()
        self._go(undone, None if undone is None else undone.before, "undone", "nothing to undo")

    def redo(self) -> None:
        """Do again what was undone last."""
        done = self.history.redo()
        self._go(done, None if done is None else done.after, "done again", "nothing to do again")

    def replace(self, task: Task, path: Path | None, saved: bool) -> None:
        """Go on with another task; what was done so far can be undone no more."""
        selected = len(keyframes_of(task)) - 1
        self.history = History(task, selected)
        self.path, self.saved = path, task if saved else None
        self.selected, self.handle, self.obstacle, self.proposal = selected, None, None, None
        self.touch()

    def take_up(self, task: Task, selected: int) -> None:
        """Go on with a state of the task that was left from before; `undo` takes it back."""
        self._add(task, "recovered changes", selected)

    def _add(self, task: Task, what: str, selected: int) -> None:
        self.history.add(task, what, self.selected, selected)
        self.proposal = None  # it was made to the task from before
        self._settle_on(selected)
        self.say(what)
        self.touch()

    def _go(self, done: Done | None, selected: int | None, text: str, otherwise: str) -> None:
        self.proposal = None
        if done is None or selected is None:
            self.say(otherwise, "warning")
        else:
            self._settle_on(selected)
            self.say(f"{text}: {done.what}")
        self.touch()

    def _settle_on(self, selected: int) -> None:
        """Select what is there to be selected."""
        if selected != self.selected:
            self.handle = None
        self.selected = min(selected, len(keyframes_of(self.task)) - 1)
        if self.handle is not None and self.handle >= len(self.shape.points):
            self.handle = None
        if self.obstacle is not None and (
            self.task.scene is None or self.obstacle not in self.task.scene.obstacles
        ):
            self.obstacle = None


def _anew(shape: Shape) -> str:
    """Say of a shape that was made of another kind of curve what that did to it."""
    if shape.off == 0.0:
        return ""
    count, off = len(shape.points), 1000.0 * shape.off
    return f"the curve is one of {count} control points now, within {off:.2g} mm of what it was"


def _folder_of(path: Path | None) -> Path:
    return Path.cwd() if path is None else path.parent


def _checked(folder: Path, path: Path | None) -> Path:
    """A folder, from the root; raises FileError if there is none, or a task file is not in it."""
    if not folder.is_dir():
        raise FileError(folder, "no such folder")
    if path is not None and not path.parent.resolve().is_relative_to(folder.resolve()):
        raise FileError(path, f"is not in the folder to edit in, {folder}")
    return folder.absolute()
