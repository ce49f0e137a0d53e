"""The editing session: the task with its undo history, what is selected, and what is proposed."""

from __future__ import annotations

import os
import time
from collections.abc import Callable
from pathlib import Path
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from pinposture.arm import Arm
from pinposture.editor.edits import Edit, Shape, joints_at, keyframes_of, reshaped, with_keyframe
from pinposture.editor.phases import editable, whole_of
from pinposture.editor.playback import Playback
from pinposture.editor.solver import Live, Problem
from pinposture.errors import FileError, InvalidValue, PostureError, TaskError
from pinposture.task import Keyframe, Task
from pinposture.units import BELOW_ROUNDING, length_text

MAX_HISTORY = 500  # states that are kept for undo


class HistoryEntry(NamedTuple):
    """A state of the task."""

    task: Task
    what: str  # the edit that led to it, in words
    before: int  # the keyframe that was selected before the edit, 0-based
    after: int  # the keyframe that was selected by the edit


class History:
    """The states of a task, for undo and redo."""

    def __init__(self, task: Task, selected: int = 0) -> None:
        self._states = [HistoryEntry(task, "", selected, selected)]
        self._index = 0

    @property
    def now(self) -> HistoryEntry:
        """The current state."""
        return self._states[self._index]

    @property
    def undoable(self) -> str:
        """What `undo` would take back, in words; empty if there is nothing."""
        return self.now.what

    @property
    def redoable(self) -> str:
        """What `redo` would do again, in words; empty if there is nothing."""
        return self._states[self._index + 1].what if self._index + 1 < len(self._states) else ""

    def add(self, task: Task, what: str, before: int, after: int) -> None:
        """Add a state after the current one, and forget what was undone; arguments as in `HistoryEntry`."""
        del self._states[self._index + 1 :]
        self._states.append(HistoryEntry(task, what, before, after))
        if len(self._states) > MAX_HISTORY:
            del self._states[0]
            self._states[0] = self._states[0]._replace(what="")
        self._index = len(self._states) - 1

    def undo(self) -> HistoryEntry | None:
        """Go back by one state; returns what was undone, None if there was nothing."""
        if self._index == 0:
            return None
        self._index -= 1
        return self._states[self._index + 1]

    def redo(self) -> HistoryEntry | None:
        """Go forward by one state; returns what was done again, None if there was nothing."""
        if self._index + 1 >= len(self._states):
            return None
        self._index += 1
        return self.now


class Notice(NamedTuple):
    """A message, shown as long as what it speaks of is there."""

    text: str
    kind: str  # "info", "warning" or "error"
    number: int  # rises with each message
    about: tuple[Task, int] | None = None  # the task, and the keyframe that was edited, when it came up
    since: float = 0.0  # [s]


class NearestObstacle(NamedTuple):
    """Where an arm is nearest to its surroundings, or inside itself."""

    distance: float  # between the surfaces [m]; negative where they overlap
    body: str  # name of the body of the arm
    other: str  # name of the obstacle, of the scan, or of another body that the first is inside of
    on_arm: NDArray[
        np.float64
    ]  # point of the body, nearest to the other or deepest in it, (3,) [m], world frame
    on_other: NDArray[np.float64]  # point of the other's surface, (3,) [m], world frame
    margin: float  # the distance to keep [m]; 0 for scans that are only shown

    @property
    def level(self) -> str:
        """The distance in words: "inside", "within the margin" or "clear"."""
        if self.distance < 0.0:
            return "inside"
        return "within the margin" if self.distance < self.margin else "clear"


class Proposal(NamedTuple):
    """A change of the shape that is accepted once the solver has found that the arm can take it."""

    task: Task  # the task with the change
    what: str  # the change in words
    final: bool  # whether it is to be accepted; else the drag continues
    number: int  # of its problem to the solver
    note: str = ""  # a further message when it is accepted


class Session:
    """What is being edited. It belongs to the editor's loop; no other thread may use it.

    Attributes:
        history: the states of the task.
        path: the task file; None if it was never saved.
        selected: the keyframe that is edited, 0-based.
        handles: the selected control points of its curve, 0-based, in the order in which they were selected.
        grid: step of the grid to which dragged points snap [m]; 0 for no grid.
        obstacle: the name of the selected obstacle; None if there is none.
        tip: whether the tip of the arm is selected, to be dragged.
        proposal: a change that is not accepted yet; None if there is none.
        nearest: where the arm is nearest to its surroundings; None if there are none.
        marks: whether each keyframe can be taken, "fine", "collides" or "refused"; empty while unknown.
        notice: the last message.
        at_once: whether the arm takes shapes at once, whatever its limits.
        number: rises with everything that the solver should know.
        asked: when it rose last, by `time.monotonic` [s].
        saved: the task as it is in the file; None if it is in none.
        playback: the player of the motion of the task.
        folder: the only folder where files are opened and saved; see `within`.

    Args:
        task: the task.
        path: its file, if it has one.
        selected: the keyframe to begin with.
        folder: where files are opened and saved; that of the task file if None, or the working directory
            without one.

    Raises:
        FileError: no such folder, or a task file that is not in it.
        TaskError: a task without keyframes.
        InvalidValue: no such keyframe to begin with.
    """

    def __init__(
        self, task: Task, path: Path | None = None, selected: int = 0, folder: Path | None = None
    ) -> None:
        task = editable(task)
        count = len(keyframes_of(task))
        self.selected = selected
        if not 0 <= self.selected < count:
            raise InvalidValue("selected", selected, f"a keyframe of the task, 0 to {count - 1}")
        self.history = History(task, self.selected)
        self.path = None if path is None else path.absolute()
        self.folder = _working_folder(folder, self.path)
        self.handles: tuple[int, ...] = ()
        self.grid = 0.0
        self.obstacle: str | None = None
        self.tip = False
        self.proposal: Proposal | None = None
        self.nearest: NearestObstacle | None = None
        self.marks: tuple[str, ...] = ()
        self.notice = Notice("", "info", 0)
        self.at_once = False
        self.number = 1
        self.asked = time.monotonic()
        # Unlike `Path.exists`, this does not raise where access is denied.
        in_file = path is not None and os.path.exists(path)  # noqa: PTH110
        self.saved: Task | None = task if in_file else None
        self.playback = Playback()
        self._shape: tuple[Keyframe, Shape] | None = None

    @property
    def handle(self) -> int | None:
        """The control point that was selected last, 0-based, or None; setting it deselects all others."""
        return self.handles[-1] if self.handles else None

    @handle.setter
    def handle(self, handle: int | None) -> None:
        self.handles = () if handle is None else (handle,)

    @property
    def task(self) -> Task:
        """The task without the proposal."""
        return self.history.now.task

    @property
    def whole(self) -> Task:
        """What is performed, exported and written: the task, or all its phases if one of them is edited."""
        return whole_of(self.task)

    @property
    def shown(self) -> Task:
        """The task as it is shown, with the proposal."""
        return self.task if self.proposal is None else self.proposal.task

    @property
    def arm(self) -> Arm:
        """The arm."""
        return self.task.arm

    @property
    def keyframe(self) -> Keyframe:
        """The keyframe that is edited, as it is shown."""
        return keyframes_of(self.shown)[self.selected]

    @property
    def shape(self) -> Shape:
        """Its shape, as it is shown; without points for a taught configuration."""
        keyframe = self.keyframe
        if self._shape is None or self._shape[0] is not keyframe:
            self._shape = keyframe, Shape.of(self.arm, keyframe)
        return self._shape[1]

    @property
    def changed(self) -> bool:
        """Whether there are unsaved changes."""
        return self.saved is None or whole_of(self.saved) is not self.whole

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
            task.effective_scene,
            self.at_once,
            self.asked,
            shaping=self.proposal is not None,
            passing=self.proposal is not None and not self.proposal.final,
            dragging_obstacle=task.scene is not self.task.scene,
        )

    def say(self, text: str, kind: str = "info") -> None:
        """Show a message."""
        words = " ".join(text.split())
        self.notice = Notice(
            words, kind, self.notice.number + 1, (self.task, self.selected), time.monotonic()
        )

    @property
    def message(self) -> Notice | None:
        """The last message; None once something else was edited, and it was there for 4 s, to be read."""
        notice = self.notice
        if notice.about is None:
            return None
        task, keyframe = notice.about
        same = task is self.task and keyframe == self.selected
        return notice if same or time.monotonic() - notice.since <= 4.0 else None

    def touch(self) -> None:
        """Mark a change that the solver and the page should know of."""
        self.number += 1
        self.asked = time.monotonic()

    def edit(self, edit: Edit, what: str, select: int | None = None) -> bool:
        """Edit the task at once; show the reason if that is not possible.

        Args:
            edit: the edit.
            what: the edit in words, for `undo`.
            select: the keyframe to select.

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
        """Propose another shape of the keyframe, which is accepted once the arm can take it.

        During a drag each proposal changes the shape from before the drag, not the previous proposal.

        Args:
            change: makes the new shape.
            what: the change in words.
            final: whether it is to be accepted.
        """
        self.proposal = None
        try:
            self.check_points()
            shape = self.shape
        except PostureError as error:
            self.say(str(error), "error")
            return
        note = ""
        if shape.off != 0.0:
            within = length_text(shape.off, self.arm.length)
            count = len(shape.points)
            how = "exactly" if within == BELOW_ROUNDING else f"within {within} of it"
            note = f"the curve was replaced by {count} control points ({how})"
        self.propose(reshaped(self.selected, change, shape), what, final, note)

    def propose(self, edit: Edit, what: str, final: bool = True, note: str = "") -> None:
        """Propose an edit of the selected keyframe, which is accepted once the arm can take it.

        Args:
            edit: the edit.
            what: the edit in words.
            final: whether it is to be accepted.
            note: a further message when it is accepted.
        """
        self.proposal = None
        try:
            task = edit(self.task)
        except PostureError as error:
            self.say(str(error), "error" if final else "warning")
            self._set_selected(self.selected)  # the previous proposal is gone, perhaps with points
            self.touch()
            return
        self.touch()
        self.proposal = Proposal(task, what, final, self.number, note)

    def settle(self, live: Live) -> None:
        """Accept or reject the proposal if the solver has judged it."""
        proposal = self.proposal
        if proposal is None or not proposal.final or live.number < proposal.number:
            return
        self.proposal = None
        target = live.verdict.target
        if target is None:
            self._set_selected(self.selected)
            reason = f"refused, the arm cannot take that shape: {live.verdict.reason}"
            self.say(f"{proposal.what}: {reason}", "error")
            self.touch()
            return
        task = proposal.task
        curve = keyframes_of(task)[self.selected].curve
        if target.q is not None and curve is not None:  # the posture on the screen is played and opened again
            task = with_keyframe(self.selected, joints=joints_at(self.arm, target.q))(task)
        self._add(task, proposal.what, self.selected)
        if proposal.note:
            self.say(f"{proposal.what}; {proposal.note}")

    def check_points(self) -> None:
        """Raise TaskError if the keyframe has no control points."""
        if self.keyframe.curve is None:
            reason = "a taught configuration has no control points; 'To curve' draws a curve through it"
            raise TaskError(f"keyframe {self.selected + 1}", reason)

    def take_hold(self, handle: int | None, more: bool = False) -> None:
        """Select a control point, 0-based, instead of an obstacle or the tip; an unknown one is ignored.

        Args:
            handle: the point; None to select none.
            more: whether others stay selected; a point that is selected is then no more. The point at the
                base, which cannot be moved, is left out.
        """
        if handle is None:
            self.handle = None
            self.tip = False
        elif 0 <= handle < len(self.shape.points):
            others = tuple(number for number in self.handles if more and number not in (0, handle))
            kept = not more or (handle > 0 and handle not in self.handles)
            self.handles = (*others, handle) if kept else others
            self.obstacle = None
            self.tip = False

    def take_all(self) -> None:
        """Select all control points but the one at the base, the last one in the end.

        Raises:
            TaskError: the keyframe has no control points.
        """
        self.check_points()
        self.take_hold(len(self.shape.points) - 1)
        self.handles = tuple(range(1, len(self.shape.points)))

    def select(self, keyframe: int) -> None:
        """Select another keyframe, 0-based; an unknown one is ignored."""
        if keyframe != self.selected and 0 <= keyframe < len(keyframes_of(self.task)):
            self.selected = keyframe
            self.handle = None
            self.proposal = None
            self.touch()

    def undo(self) -> None:
        """Undo the last edit."""
        undone = self.history.undo()
        self._go(undone, None if undone is None else undone.before, "undone", "nothing to undo")

    def redo(self) -> None:
        """Redo the edit that was undone last."""
        done = self.history.redo()
        self._go(done, None if done is None else done.after, "redone", "nothing to redo")

    def replace(self, task: Task, path: Path | None, saved: bool) -> None:
        """Edit another task instead, with a new history.

        Raises:
            TaskError: a task without keyframes.
        """
        keyframes_of(task)
        self.history = History(task)
        self.path = path
        self.saved = task if saved else None
        self.selected = 0
        self.handle = None
        self.obstacle = None
        self.proposal = None
        self.tip = False
        self.grid = 0.0
        self.touch()

    def take_up(self, task: Task, selected: int, what: str = "recovered changes") -> None:
        """Continue with another state of the task, such as a recovered one; `undo` takes it back."""
        self._add(task, what, selected)

    def update_playback(self) -> None:
        """Bring the player up to date with the task, and show its message; called by the loop."""
        message = self.playback.follow(self.whole, self.proposal is not None)
        if message is not None:
            self.say(*message)

    def _add(self, task: Task, what: str, selected: int) -> None:
        self.history.add(task, what, self.selected, selected)
        self.proposal = None  # it was made from the task before
        self._set_selected(selected)
        self.say(what)
        self.touch()

    def _go(self, entry: HistoryEntry | None, selected: int | None, text: str, otherwise: str) -> None:
        self.proposal = None
        self._set_selected(self.selected if selected is None else selected)
        if entry is None:
            self.say(otherwise, "warning")
        else:
            self.say(f"{text}: {entry.what}")
        self.touch()

    def _set_selected(self, selected: int) -> None:
        """Select a keyframe, and drop selections that no longer exist."""
        if selected != self.selected:
            self.handle = None
        self.selected = min(selected, len(keyframes_of(self.task)) - 1)
        if self.handles:
            self.handles = tuple(number for number in self.handles if number < len(self.shape.points))
        scene = self.task.scene
        if self.obstacle is not None and (scene is None or self.obstacle not in scene.obstacles):
            self.obstacle = None


def _working_folder(folder: Path | None, path: Path | None) -> Path:
    """Return the absolute folder to edit in.

    Raises:
        FileError: there is no such folder, or the task file is not in it.
    """
    if folder is None:
        return Path.cwd() if path is None else path.parent
    if not folder.is_dir():
        raise FileError(folder, "no such folder")
    if path is not None and not path.parent.resolve().is_relative_to(folder.resolve()):
        raise FileError(path, f"is not in the folder to edit in, {folder}")
    return folder.absolute()
