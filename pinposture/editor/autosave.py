"""What was changed is kept beside the task file at once, so that nothing is lost that was not saved."""

from __future__ import annotations

import logging
from pathlib import Path
from threading import Condition, Thread
from typing import NamedTuple

from pinposture.errors import PostureError
from pinposture.task import Task

logger = logging.getLogger(__name__)

PAUSE = 0.3
"""How long after one file the next may be written [s]."""


class Recovered(NamedTuple):
    """What an editor left that was ended before it saved.

    Attributes:
        task: the task; None if it cannot be read.
        complaint: why not.
        path: where it lies.
    """

    task: Task | None
    complaint: str
    path: Path


def autosave_path(path: Path) -> Path:
    """Where what is changed of a task file is kept: beside it."""
    suffix = path.suffix if path.suffix in (".toml", ".json") else ".toml"
    return path.with_name(f"{path.stem}.autosave{suffix}")


def recover(path: Path) -> Recovered | None:
    """What was left beside a task file; None if there is nothing."""
    kept = autosave_path(path)
    if not kept.exists():
        return None
    try:
        return Recovered(Task.load(kept), "", kept)
    except PostureError as error:
        return Recovered(None, str(error), kept)


class Autosave:
    """Keeps the latest state of a task, in a thread of its own; each file is written whole or not at all.

    Attributes:
        complaint: why the last state could not be kept; empty if it was.
    """

    def __init__(self) -> None:
        self.complaint = ""
        self._news = Condition()
        self._wanted: tuple[Task, Path] | None = None
        self._gone: Path | None = None
        self._busy, self._over = False, False
        self._thread = Thread(target=self._run, name="pinposture-autosave", daemon=True)
        self._thread.start()

    def keep(self, task: Task, path: Path) -> None:
        """Keep a state of the task of a file; returns at once."""
        with self._news:
            self._wanted, self._gone = (task, autosave_path(path)), None
            self._news.notify_all()

    def forget(self, path: Path) -> None:
        """What was kept is in the file itself now; returns at once."""
        with self._news:
            self._wanted, self._gone = None, autosave_path(path)
            self._news.notify_all()

    def close(self) -> None:
        """Finish what is to be written, and end."""
        with self._news:
            self._over = True
            self._news.notify_all()
        self._thread.join(timeout=10.0)

    def _run(self) -> None:
        while True:
            with self._news:
                while self._wanted is None and self._gone is None and not self._over:
                    self._news.wait()
                wanted, gone, over = self._wanted, self._gone, self._over
                self._wanted = self._gone = None
            if gone is not None:
                _remove(gone)
            if wanted is not None:
                self._write(*wanted)
            if over and wanted is None and gone is None:
                return
            with self._news:
                if not self._over:
                    self._news.wait_for(lambda: self._over, PAUSE)

    def _write(self, task: Task, path: Path) -> None:
        try:
            task.save(path)
            self.complaint = ""
        except PostureError as error:
            self.complaint = str(error)
            logger.warning("what was changed could not be kept: %s", error)


def _remove(path: Path) -> None:
    try:
        path.unlink(missing_ok=True)
    except OSError as error:
        logger.warning("%s could not be removed: %s", path, error)
