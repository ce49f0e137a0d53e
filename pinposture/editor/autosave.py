"""What was changed is kept beside the task file at once, so that nothing is lost that was not saved."""

from __future__ import annotations

import logging
from itertools import count
from pathlib import Path
from threading import Condition, Thread
from typing import NamedTuple

from pinposture.editor.edits import keyframes_of
from pinposture.errors import FileError, PostureError
from pinposture.task import Task

logger = logging.getLogger(__name__)

PAUSE = 0.3
"""How long after one file the next may be written [s]."""

LONG = 10.0
"""How long is waited for files that are being written [s]."""


class Recovered(NamedTuple):
    """What an editor left that was ended before it saved.

    Attributes:
        task: the task; None if it cannot be read.
        complaint: why not.
        path: where it lies.
        older: whether the task file was written after it.
    """

    task: Task | None
    complaint: str
    path: Path
    older: bool = False


class Version(NamedTuple):
    """Which of the files it is that had a name one after the other.

    Attributes:
        number: of the file to the system.
        written: when it was written last [ns].
        size: of the file [bytes].
    """

    number: int
    written: int
    size: int


def version_of(path: Path) -> Version | None:
    """Which file has a name now; None if there is none."""
    try:
        found = path.stat()
    except (OSError, ValueError):
        return None
    return Version(found.st_ino, found.st_mtime_ns, found.st_size)


def autosave_path(path: Path) -> Path:
    """Where what is changed of a task file is kept: beside it."""
    suffix = path.suffix if path.suffix in (".toml", ".json") else ".toml"
    return path.with_name(f"{path.stem}.autosave{suffix}")


def recover(path: Path) -> Recovered | None:
    """What was left beside a task file; None if there is nothing."""
    kept = autosave_path(path)
    left, file = version_of(kept), version_of(path)
    if left is None:
        return None
    try:
        task = Task.load(kept)
        keyframes_of(task)
    except PostureError as error:
        return Recovered(None, str(error), kept)
    return Recovered(task, "", kept, file is not None and file.written > left.written)


def put_aside(kept: Path) -> Path:
    """Give what was left, and cannot be read, a name under which it stays; returns it.

    Raises:
        OSError: it cannot be renamed.
    """
    free = (kept.with_name(f"{kept.stem}.{k}{kept.suffix}") for k in count(1))
    return kept.rename(next(path for path in free if not path.exists()))


class Autosave:
    """Keeps the latest states of tasks, in a thread of its own; each file is written whole or not at all.

    Attributes:
        complaint: what is wrong with the last state that was to be kept, in words; empty if nothing is.
    """

    def __init__(self) -> None:
        self.complaint = ""
        self._news = Condition()
        self._wanted: dict[Path, Task | None] = {}  # what is to be kept where; None: nothing any more
        self._written: dict[Path, Version | None] = {}
        self._busy, self._hurry, self._over = False, False, False
        self._thread = Thread(target=self._run, name="pinposture-autosave", daemon=True)
        self._thread.start()

    def keep(self, task: Task, path: Path) -> None:
        """Keep a state of the task of a file; returns at once."""
        self._want(autosave_path(path), task)

    def forget(self, path: Path) -> None:
        """What was kept is in the file itself now; returns at once."""
        self._want(autosave_path(path), None)

    def finish(self) -> None:
        """Wait until all is written."""
        with self._news:
            self._hurry = True
            self._news.notify_all()
            self._news.wait_for(lambda: not self._wanted and not self._busy, LONG)
            self._hurry = False

    def close(self) -> None:
        """Finish what is to be written, and end."""
        with self._news:
            self._over = True
            self._news.notify_all()
        self._thread.join(timeout=LONG)

    def _want(self, kept: Path, task: Task | None) -> None:
        with self._news:
            self._wanted[kept] = task
            self._news.notify_all()

    def _run(self) -> None:
        while True:
            with self._news:
                self._news.wait_for(lambda: self._wanted or self._over)
                wanted, self._wanted = self._wanted, {}
                self._busy = True
            if not wanted:
                return
            for path, task in wanted.items():
                self._put(task, path)
            with self._news:
                self._busy = False
                self._news.notify_all()
                self._news.wait_for(lambda: self._over or self._hurry, PAUSE)

    def _put(self, task: Task | None, path: Path) -> None:
        """Write a state in its place, or take away what is there."""
        found = version_of(path)
        strange = path in self._written and found not in (None, self._written[path])
        complaint = f"somebody else writes {path.name}, too: is its task open twice?" if strange else ""
        try:
            if task is not None:
                for each in (path, path.with_suffix(".urdf")):
                    if each.is_symlink():  # which we never make; it would be written through
                        raise FileError(each, "is a link; remove it")
                task.save(path)
                self._written[path] = version_of(path)
            elif not strange:
                self._written.pop(path, None)
                # An arm that nothing else describes was kept beside it.
                for each in (path, path.with_suffix(".urdf")):
                    each.unlink(missing_ok=True)
        except Exception as error:  # whatever it is, the next state is tried again
            complaint = f"your changes cannot be kept: {error}"
            level = logging.WARNING if isinstance(error, PostureError | OSError) else logging.ERROR
            logger.log(level, "%s: %s", path, error, exc_info=level == logging.ERROR)
        self.complaint = complaint
