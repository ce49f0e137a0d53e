"""The editor: one loop that takes what hands do, asks the solver, and shows what comes of it."""

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
from pinposture.editor.solver import Live, Solver
from pinposture.editor.surroundings import Surroundings
from pinposture.editor.ui import Page
from pinposture.errors import PostureError
from pinposture.task import Task

logger = logging.getLogger(__name__)

Request: TypeAlias = Callable[[Session], None]

MOST = 1000
"""How many requests may wait; there are more only if a program sends them, and those are dropped."""

FRAME, IDLE = 1.0 / 60.0, 0.25
"""How soon after each other the page is brought up to date, and how often at least [s]."""


class Editor:
    """An editor of a task, shown to browsers; it works in threads of its own.

        editor = Editor(pp.Task.load("walk.toml"), Path("walk.toml"))
        editor.start()
        webbrowser.open(editor.url)

    Callbacks of the page only leave requests here. The loop takes them in turn, and never waits for the arm:
    what the arm makes of it is worked out by the solver, and looked up.

    Args:
        task: the task to edit.
        path: its file, if it has one.
        host: at which address to listen.
        port: at which port; another if it is taken.
        joint_states: what tells where the arm is measured to be, as for `JointStates`; None if nothing does.
        folder: where the page opens and saves files, and nowhere else; that of the task file if None, or
            where we are without one.

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
        # Matrices are small here, and threads that wait for each other take the time that other parts need.
        self._blas = threadpool_limits(1, user_api="blas")
        self.session = Session(task, path, folder=folder)
        restore(self.session)
        self._inbox: deque[tuple[str, Request]] = deque()
        self._flooded, self._fault = False, ""
        self._lock, self._news, self._over = Lock(), Event(), Event()
        self._solver = Solver(self.session.problem, self.session.arm.straight(), self._news.set)
        self._asked = self.session.number
        self.files = Files(self.post, self.session.path)
        self.surroundings = Surroundings(self.post)
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
        """Where a browser on this machine finds it; whoever has it can edit."""
        return self.page.url

    @property
    def live(self) -> Live:
        """The arm as it is at the moment."""
        return self._solver.live

    def start(self) -> None:
        """Begin to serve."""
        self._solver.start()
        self._thread.start()

    def wait(self) -> None:
        """Wait until it is closed; Ctrl-C ends the waiting."""
        while not self._over.wait(0.5):
            pass

    def close(self) -> None:
        """End."""
        self._over.set()
        self._news.set()
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
        """Leave a request for the loop. May be called from any thread, and returns at once.

        Args:
            request: what to do with the session.
            key: requests with the same key that follow each other count as one: the last.
        """
        with self._lock:
            if key and self._inbox and self._inbox[-1][0] == key:
                self._inbox[-1] = key, request
            elif len(self._inbox) < MOST:
                self._inbox.append((key, request))
            else:
                self._flooded = True
        self._news.set()

    def _run(self) -> None:
        while not self._over.is_set():
            begun = time.monotonic()
            self._news.clear()
            session, live = self.session, self._solver.live
            for part in (
                partial(session.settle, live),
                self._take_requests,
                partial(self.surroundings.watch, session, live),
                self._ask,
                partial(self.files.watch, session),
                partial(session.playback.follow, session),
                partial(self.page.show, session, live),
            ):
                self._safely(part)
            left = FRAME - (time.monotonic() - begun)
            if left > 0.0:
                self._over.wait(left)
            self._news.wait(IDLE)

    def _safely(self, part: Callable[[], object]) -> None:
        """Do a part of what the loop does; a fault of ours costs this part of this turn, and not the work."""
        try:
            part()
        except Exception as error:
            fault = f"{type(error).__name__}: {error}"
            if fault != self._fault:  # it may come with every turn
                logger.exception("a part of the editor failed")
                self._fault = fault

    def _take_requests(self) -> None:
        while (request := self._next()) is not None:
            self._do(request)
        if self._flooded:
            self._flooded = False
            self.session.say("too much at once: some of it was not done", "warning")

    def _ask(self) -> None:
        """Tell the solver what is asked of the arm, if that is something else now."""
        if self.session.number != self._asked:
            self._asked = self.session.number
            self._solver.ask(self.session.problem)

    def _next(self) -> Request | None:
        """The next request, if it may be done: what is proposed is decided on before anything else."""
        if self.session.proposal is not None and self.session.proposal.final:
            return None
        with self._lock:
            return self._inbox.popleft()[1] if self._inbox else None

    def _do(self, request: Request) -> None:
        try:
            request(self.session)
        except PostureError as error:
            self.session.say(str(error), "error")
        except Exception as error:  # a fault of ours; whoever edits goes on with what there was
            logger.exception("a request failed")
            self.session.say(f"that did not work, and nothing was changed ({error})", "error")
