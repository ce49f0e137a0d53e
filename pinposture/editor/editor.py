"""The editor: a loop that takes requests, asks the solver, and brings the page up to date."""

from __future__ import annotations

import logging
import time
from collections import deque
from collections.abc import Callable
from functools import partial
from pathlib import Path
from threading import Event, Lock, Thread
from typing import TypeAlias

from threadpoolctl import threadpool_limits

from pinposture.editor.files import Files, restore
from pinposture.editor.measured_arm import JointStates
from pinposture.editor.session import Session
from pinposture.editor.solver import Live, Solver, VerdictCache
from pinposture.editor.surroundings import Surroundings
from pinposture.editor.ui import Page
from pinposture.errors import PostureError
from pinposture.task import Task

logger = logging.getLogger(__name__)

Request: TypeAlias = Callable[[Session], None]

MAX_REQUESTS = 1000  # that wait; only a program sends more, and those are dropped


class Editor:
    """An editor of a task, shown in browsers.

        editor = Editor(pp.Task.load("walk.toml"), Path("walk.toml"))
        editor.start()
        webbrowser.open(editor.url)

    Callbacks of the page only post requests, which the loop does in turn. The loop never waits for the arm:
    the solver moves it, and the loop reads where it is. It has a thread of its own and is no `Latest`, as all
    else that runs beside the callbacks: no request may replace another, and it goes on when none comes.

    Args:
        task: the task to edit.
        path: its file, if it has one.
        host: the address to listen at.
        port: the port; another if it is taken.
        joint_states: the source of measured joint states, as for `JointStates`; None if there is none.
        folder: the only folder where the page opens and saves files; that of the task file if None, or the
            working directory without one.

    Raises:
        TaskError: a task without keyframes.
        ViewerError: the page cannot be served.
        FileError: the joint states cannot be read; no such folder, or a task file that is not in it.
    """

    def __init__(
        self,
        task: Task,
        path: Path | None = None,
        host: str = "127.0.0.1",
        port: int = 8080,
        joint_states: str | Path | None = None,
        folder: Path | None = None,
    ) -> None:
        # Matrices are small here, and threads that wait for each other take time from the rest.
        self._blas = threadpool_limits(1, user_api="blas")
        self.session = Session(task, path, folder=folder)
        restore(self.session)
        self._inbox: deque[tuple[str, Request]] = deque()
        self._flooded = False
        self._fault = ""
        self._lock = Lock()
        self._wake = Event()
        self._closed = Event()
        verdicts = VerdictCache()
        self._solver = Solver(self.session.problem, self.session.arm.straight(), self._wake.set, verdicts)
        self._asked_number = self.session.number
        self.files = Files(self.post, self.session.path)
        self.surroundings = Surroundings(self.post, verdicts)
        self._states: JointStates | None = None
        try:
            if joint_states is not None:
                self._states = JointStates(self.session.arm, joint_states)
            self.page = Page(self.session, self.post, self.files, self.surroundings, self._states, host, port)
        except BaseException:
            self._close_parts()
            self._blas.restore_original_limits()
            raise
        self._thread = Thread(target=self._run, name="pinposture-editor", daemon=True)

    @property
    def url(self) -> str:
        """Where a browser on this machine finds it; anyone who has it can edit."""
        return self.page.url

    @property
    def live(self) -> Live:
        """The arm at this moment."""
        return self._solver.live

    def start(self) -> None:
        """Start the threads."""
        self._solver.start()
        self._thread.start()

    def wait(self) -> None:
        """Wait until it is closed; Ctrl-C ends the waiting."""
        while not self._closed.wait(0.5):
            pass

    def close(self) -> None:
        """End all threads and the server."""
        self._closed.set()
        self._wake.set()
        if self._thread.is_alive():
            self._thread.join(timeout=5.0)
        self._solver.close()
        self._close_parts()
        self.page.close()
        self._blas.restore_original_limits()

    def _close_parts(self) -> None:
        self.session.playback.close()
        self.surroundings.close()
        if self._states is not None:
            self._states.close()
        self.files.close()

    def post(self, request: Request, key: str = "") -> None:
        """Post a request to the loop. May be called from any thread, and returns at once.

        Args:
            request: called with the session.
            key: of consecutive requests with the same key, only the last one is done.
        """
        with self._lock:
            if key and self._inbox and self._inbox[-1][0] == key:
                self._inbox[-1] = key, request
            elif len(self._inbox) < MAX_REQUESTS:
                self._inbox.append((key, request))
            else:
                self._flooded = True
        self._wake.set()

    def _run(self) -> None:
        while not self._closed.is_set():
            begun = time.monotonic()
            self._wake.clear()
            session = self.session
            live = self._solver.live
            for part in (
                partial(session.settle, live),
                self._take_requests,
                partial(self.surroundings.watch, session, live),
                self._ask,
                partial(self.files.watch, session),
                session.update_playback,
                partial(self.page.show, session, live),
            ):
                try:
                    part()
                except Exception as error:  # a bug costs this part of this turn, not the work
                    fault = f"{type(error).__name__}: {error}"
                    if fault != self._fault:  # it may come with every turn
                        logger.exception("a part of the editor failed")
                        self._fault = fault
            left = 1.0 / 60.0 - (time.monotonic() - begun)
            if left > 0.0:
                self._closed.wait(left)
            self._wake.wait(0.25)  # [s]

    def _take_requests(self) -> None:
        while (request := self._next_request()) is not None:
            try:
                request(self.session)
            except PostureError as error:
                self.session.say(str(error), "error")
            except Exception as error:  # a bug; editing goes on
                logger.exception("a request failed")
                self.session.say(f"an internal error; nothing was changed ({error})", "error")
        if self._flooded:
            self._flooded = False
            self.session.say("too many requests at once: some were dropped", "warning")

    def _next_request(self) -> Request | None:
        """Return the next request; None while a final proposal waits for its verdict."""
        if self.session.proposal is not None and self.session.proposal.final:
            return None
        with self._lock:
            return self._inbox.popleft()[1] if self._inbox else None

    def _ask(self) -> None:
        """Give the solver the problem, if it has changed."""
        if self.session.number != self._asked_number:
            self._asked_number = self.session.number
            self._solver.ask(self.session.problem)
