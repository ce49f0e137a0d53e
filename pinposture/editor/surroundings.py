"""What is around the arm, as the editor looks after it: the pace of changes, clearance, scans."""

from __future__ import annotations

import time
from collections.abc import Callable
from typing import TypeAlias

from pinposture.collision import Scene
from pinposture.editor.clearances import Asked, Clearances, Marked, Marks
from pinposture.editor.edits import keyframes_of
from pinposture.editor.live import Live
from pinposture.editor.scan_shelf import ScanShelf
from pinposture.editor.session import Session

Post: TypeAlias = Callable[..., None]

PACE = 0.2
"""How long the solver is left with an obstacle where it was before it is told how far it was moved [s]."""


class Surroundings:
    """What is around the arm.

    Attributes:
        scans: the scans of the task, as far as they have been read.

    Args:
        post: leaves a request for the editor's loop.
    """

    def __init__(self, post: Post) -> None:
        self.scans = ScanShelf(post)
        self._clearances, self._marks = Clearances(), Marks()
        self._scene: Scene | None = None
        self._seen: float | None = None  # when the solver was first seen to be at what is asked

    def watch(self, session: Session, live: Live) -> None:
        """Look after what is around the arm; called by the loop, each time before the solver is asked.

        Args:
            session: what is edited.
            live: the arm.
        """
        proposal = session.proposal
        pending = proposal is not None and not proposal.final and proposal.number > session.number
        if live.number < session.number:
            self._seen = None
        elif self._seen is None:
            self._seen = time.monotonic()
        # The arm is given time to move in a scene before the next one comes.
        if self._seen is not None and pending and time.monotonic() - self._seen >= PACE:
            session.touch()
        elif self._seen is not None and not pending:
            self._scene = session.shown.scene
        if live.arm is session.arm:
            named = {path.name: scan for path, scan in self.scans.of(session.task).items()}
            q = session.playback.seen(live).state.q  # where it is to be seen
            self._clearances.ask(Asked(live.arm, q, self._scene, named))
        session.nearest = self._clearances.latest
        self._marks.ask(Marked(session.task.arm, keyframes_of(session.task), session.task.scene))
        session.marks = self._marks.latest or ()

    def close(self) -> None:
        """End."""
        self._clearances.close()
        self._marks.close()
        self.scans.close()
