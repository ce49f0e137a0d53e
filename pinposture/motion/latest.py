"""Work beside a loop: of what is asked, only the latest request counts."""

from __future__ import annotations

import logging
import time
from collections.abc import Callable
from dataclasses import dataclass
from threading import Condition, Event, Thread
from typing import Generic, TypeVar

import numpy as np

from pinposture.errors import PostureError

Request = TypeVar("Request")
Answer = TypeVar("Answer")
logger = logging.getLogger(__name__)

EXPECTED_ERRORS = (PostureError, ArithmeticError, np.linalg.LinAlgError, OSError)
"""What a request may cause; anything else is a bug, and logged."""


class Outdated(Exception):
    """Raised by a worker that gives up a request; nothing is delivered."""


@dataclass(frozen=True, eq=False)
class Done(Generic[Request, Answer]):
    """What became of a request."""

    request: Request  # the request
    answer: Answer | None = None  # what the worker returned; None if it raised an error
    error: BaseException | None = None  # what it raised; None if it returned


class Latest(Generic[Request, Answer]):
    """Works on the latest request, in a thread that lasts as long as there is one.

    At most one request is worked on. One that comes meanwhile waits, and replaces another that waits. Each
    that is worked on is delivered, unless its worker gives it up. It may be called from any thread.

    Args:
        work: the worker, called with a request, and an event that is set once the request is outdated: there
            is a newer one, it was cancelled, or all is closed. It may look at that and raise `Outdated`.
        name: of the thread.
        deliver: called in the thread with what became of each request, before the next one is begun.
        merge: called with a request that waits and a newer one; returns what waits instead of both. None:
            the newer one.
        same: whether two requests have the same answer: one that is the same as the last is not asked again.
        period: least time between the beginnings of two requests [s].
    """

    def __init__(
        self,
        work: Callable[[Request, Event], Answer],
        name: str,
        *,
        deliver: Callable[[Done[Request, Answer]], object] | None = None,
        merge: Callable[[Request, Request], Request] | None = None,
        same: Callable[[Request, Request], bool] | None = None,
        period: float = 0.0,
    ) -> None:
        self._work = work
        self._name = name
        self._deliver = deliver
        self._merge = merge
        self._same = same
        self._period = period
        self._changed = Condition()
        self._thread: Thread | None = None
        # Requests are kept in tuples of one, since None may be a request.
        self._asked: tuple[Request, ...] = ()
        self._waiting: tuple[Request, ...] = ()
        self._begun: tuple[Request, ...] = ()
        self._outdated = Event()  # of the request that was begun last
        self._due = -np.inf  # before which the next request is not begun [s]
        self._hurried = 0  # how many callers of `finish` wait
        self._closed = False
        self._done: Done[Request, Answer] | None = None

    @property
    def working(self) -> bool:
        """Whether there is a request that is neither done nor outdated."""
        with self._changed:
            return bool(self._waiting or (self._begun and not self._outdated.is_set()))

    @property
    def done(self) -> Done[Request, Answer] | None:
        """What became of the last request that was delivered; None before."""
        with self._changed:
            return self._done

    def ask(self, request: Request) -> None:
        """Have a request worked on; returns at once. Nothing is done after closing."""
        with self._changed:
            if self._closed:
                return
            if self._same is not None and self._asked and self._same(self._asked[0], request):
                return
            self._asked = (request,)
            if self._waiting and self._merge is not None:
                request = self._merge(self._waiting[0], request)
            self._waiting = (request,)
            self._outdated.set()
            if self._thread is None:
                self._thread = Thread(target=self._run, name=self._name, daemon=True)
                self._thread.start()
            self._changed.notify_all()

    def cancel(self) -> None:
        """Drop the request that waits, and tell the worker that its own is outdated."""
        with self._changed:
            self._asked = ()
            self._waiting = ()
            self._outdated.set()
            self._changed.notify_all()

    def finish(self, patience: float = 5.0) -> bool:
        """Wait until all that was asked is delivered; what waits is begun without regard to the period.

        Args:
            patience: how long to wait at most [s].

        Returns:
            Whether all is delivered.
        """
        with self._changed:
            self._hurried += 1
            self._changed.notify_all()
            finished = self._changed.wait_for(lambda: not (self._waiting or self._begun), patience)
            self._hurried -= 1
        return finished

    def close(self, patience: float = 5.0) -> None:
        """Cancel, take no further requests, and wait for the end of the thread.

        Args:
            patience: how long to wait at most [s].
        """
        with self._changed:
            self._closed = True  # before cancelling: what is asked in between would be worked on
            thread = self._thread
        self.cancel()
        if thread is not None:
            thread.join(patience)

    def _run(self) -> None:
        while self._begin():
            request = self._begun[0]
            try:
                done = Done(request, self._work(request, self._outdated))
            except Outdated:
                done = None
            except BaseException as error:  # of any kind: others wait for an answer
                if not isinstance(error, EXPECTED_ERRORS):
                    logger.exception("%s failed", self._name)
                done = Done(request, error=error)
            if done is not None and self._deliver is not None:
                try:
                    self._deliver(done)
                except Exception:  # a bug; later requests need the thread
                    logger.exception("%s could not deliver", self._name)
            with self._changed:
                self._done = done or self._done
                self._begun = ()
                self._changed.notify_all()

    def _begin(self) -> bool:
        """Turn to the request that waits, when it is due; returns False, and ends the thread, without one."""
        with self._changed:
            while self._waiting and not self._hurried and time.monotonic() < self._due:
                self._changed.wait(self._due - time.monotonic())
            if not self._waiting:
                self._thread = None
                return False
            self._begun = self._waiting
            self._waiting = ()
            self._outdated = Event()
            self._due = time.monotonic() + self._period
            return True
