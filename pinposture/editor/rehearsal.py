"""The motion of a task, worked out beside everything else: when somebody asks, and again when it changed."""

from __future__ import annotations

import logging
import time
from threading import Event, Lock, Thread
from typing import NamedTuple

import numpy as np

from pinposture.errors import PostureError
from pinposture.motion import Motion
from pinposture.task import Task

logger = logging.getLogger(__name__)

LOOKING = 0.5
"""How much of the work is to find the postures, as far as the progress tells; the rest is the motion."""

BREATH = 0.0005
"""How long it stands back after each cycle [s]: threads take turns, and the arm of the moment has to move."""


class Rehearsed(NamedTuple):
    """What came of a task.

    Attributes:
        task: the task.
        motion: its motion; None if there is none.
        reason: why there is none, in words; empty if there is one.
    """

    task: Task
    motion: Motion | None
    reason: str = ""


class _Cancelled(Exception):
    """Nobody wants to know any more."""


class Rehearsal:
    """Works out motions in threads of its own, and leaves the last one to be looked up.

    Only what was asked for last counts; what is under way for another task is given up at its next cycle.
    """

    def __init__(self) -> None:
        self._lock = Lock()
        self._asked: Task | None = None  # what is under way
        self._over = Event()
        self._share = 0.0
        self._last: Rehearsed | None = None
        self._thread: Thread | None = None

    @property
    def working(self) -> bool:
        """Whether something is under way."""
        with self._lock:
            return self._asked is not None

    @property
    def progress(self) -> float:
        """How far what is under way has come, in [0, 1]."""
        with self._lock:
            return self._share

    def of(self, task: Task) -> Rehearsed | None:
        """What came of a task; None if that is not known, or no longer."""
        with self._lock:
            return self._last if self._last is not None and self._last.task is task else None

    def ask(self, task: Task) -> None:
        """Have the motion of a task worked out, unless it is known, or under way."""
        with self._lock:
            if self._asked is task or (self._last is not None and self._last.task is task):
                return
            self._over.set()  # the one before
            self._over, self._asked, self._share = Event(), task, 0.0
            over, before = self._over, self._thread
            self._thread = Thread(
                target=self._run, args=(task, over, before), name="pinposture-rehearsal", daemon=True
            )
            self._thread.start()

    def cancel(self) -> None:
        """Give up what is under way."""
        with self._lock:
            self._over.set()
            self._asked, self._share = None, 0.0

    def close(self) -> None:
        """End."""
        self.cancel()
        if self._thread is not None:
            self._thread.join(timeout=5.0)

    def _run(self, task: Task, over: Event, before: Thread | None) -> None:
        if before is not None:
            before.join()  # two at a time would only be in each other's way
        try:
            done = self._rehearsed(task, over)
        except _Cancelled:
            return
        with self._lock:
            if over.is_set():
                return
            self._last, self._asked, self._share = done, None, 0.0

    def _rehearsed(self, task: Task, over: Event) -> Rehearsed:
        def tell(share: float) -> None:
            if over.is_set():
                raise _Cancelled
            with self._lock:
                if not over.is_set():
                    self._share = share
            time.sleep(BREATH)

        def found(done: int, count: int) -> None:
            tell(LOOKING * done / max(count, 1))

        def moved(seconds: float, lasting: float) -> None:
            tell(LOOKING + (1.0 - LOOKING) * min(seconds / lasting, 1.0))

        try:
            tell(0.0)
            reference = task.reference(found)
            return Rehearsed(task, task.perform(reference, moved))
        except (PostureError, ArithmeticError, np.linalg.LinAlgError) as error:
            return Rehearsed(task, None, " ".join(str(error).split()))
        except _Cancelled:
            raise
        except Exception as error:  # a fault of ours; whoever waits for it has to be told
            logger.exception("a motion could not be worked out")
            return Rehearsed(task, None, f"the motion could not be worked out ({error})")
