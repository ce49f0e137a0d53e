"""Saving and opening task files, for the loop: what takes time is done in threads."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from threading import Thread

from pinposture.editor.autosave import Autosave, autosave_path, recover
from pinposture.editor.edits import keyframes_of
from pinposture.editor.session import Session
from pinposture.errors import FileError, PostureError
from pinposture.task import Task

SUFFIXES = (".toml", ".json")


class Files:
    """The task file of a session, and what is kept beside it.

    Args:
        post: leaves a request for the loop.
    """

    def __init__(self, post: Callable[[Callable[[Session], None]], None]) -> None:
        self._post = post
        self._autosave = Autosave()
        self._kept: Task | None = None
        self._complained = ""

    def watch(self, session: Session) -> None:
        """Keep what was changed; called by the loop whenever it likes."""
        if self._kept is None:
            self._kept = session.task
        if session.path is not None and session.task is not self._kept:
            self._kept = session.task
            if session.changed:
                self._autosave.keep(session.task, session.path)
            else:
                self._autosave.forget(session.path)
        if self._autosave.complaint != self._complained:
            self._complained = self._autosave.complaint
            if self._complained:
                session.say(f"your changes cannot be kept: {self._complained}", "error")

    def save(self, session: Session, path: Path | None = None) -> None:
        """Save the task in its file, or in another one, which then is its file.

        Raises:
            FileError: it cannot be written; nothing changes.
        """
        path = session.path if path is None else path
        if path is None:
            raise FileError("the task", "has no file yet; give it a name, such as task.toml")
        path = path.expanduser().absolute()
        if path != session.path and path.exists():
            raise FileError(
                path, "exists already; allowed: a name that is free, or that of the file being edited"
            )
        session.task.save(path)
        before, session.path, session.saved = session.path, path, session.task
        self._autosave.forget(path)
        if before is not None and before != path:
            self._autosave.forget(before)
        session.say(f"saved as {path.name}")

    def open(self, session: Session, path: Path) -> None:
        """Open another task file; the loop goes on meanwhile."""
        path = path.expanduser().absolute()
        session.say(f"opening {path.name} ...")

        def work() -> None:
            try:
                opened = open_task(path)
            except PostureError as error:
                reason = str(error)
                self._post(lambda session: session.say(f"not opened: {reason}", "error"))
                return
            self._post(opened)

        Thread(target=work, name="pinposture-open", daemon=True).start()

    def close(self) -> None:
        """Finish writing."""
        self._autosave.close()


def open_task(path: Path) -> Callable[[Session], None]:
    """Read a task file, and what was left beside it; gives what puts it in place of the task of a session.

    Raises:
        FileError: it cannot be read.
        TaskError: it has no keyframes.
    """
    task = Task.load(path)
    keyframes_of(task)

    def put(session: Session) -> None:
        session.replace(task, path, saved=True)
        session.say(f"opened {path.name}")
        restore(session)

    return put


def restore(session: Session) -> None:
    """Take up what was changed and not saved when an editor of the same file ended; undo takes it back."""
    if session.path is None:
        return
    left = recover(session.path)
    if left is None:
        return
    if left.task is None:
        session.say(
            f"{left.path.name} holds changes that were not saved, and cannot be read: {left.complaint}",
            "error",
        )
        return
    count = len(keyframes_of(left.task))
    session.take_up(left.task, min(session.selected, count - 1))
    session.say(
        f"recovered what was not saved (from {left.path.name}); undo goes back to the file", "warning"
    )


__all__ = ["SUFFIXES", "Files", "autosave_path", "open_task", "restore"]
