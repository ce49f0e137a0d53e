"""What is around the arm: the pace of changes, clearance, scans and meshes from files."""

from __future__ import annotations

import logging
import os
import tempfile
import time
from collections.abc import Callable
from functools import partial
from pathlib import Path
from queue import SimpleQueue
from threading import Lock, Thread
from typing import TypeAlias

from pinposture.collision import Mesh, Scene
from pinposture.collision.scan import WIDE, Scan
from pinposture.editor.clearances import Asked, Clearances, Marked, Marks
from pinposture.editor.edits import Edit, keyframes_of
from pinposture.editor.obstacles import free_name, obstacles_of, take_in
from pinposture.editor.session import Session
from pinposture.editor.solver import Live
from pinposture.errors import FileError, PostureError
from pinposture.storage import write_bytes
from pinposture.task import Task

# Scans and meshes in files: read, and written beside the task, by a thread of its own.

logger = logging.getLogger(__name__)

Post: TypeAlias = Callable[..., None]

SHOWN = 200_000
"""Points and triangles of a scan that are shown, at most."""


class ScanShelf:
    """The scans of a task, as far as they have been read.

    Files are read and written in a thread of its own, which then leaves requests for the editor's loop.

    Args:
        post: leaves a request for the loop.
    """

    def __init__(self, post: Post) -> None:
        self._post, self._lock = post, Lock()
        self._jobs: SimpleQueue[Callable[[], object] | None] = SimpleQueue()
        self._thread: Thread | None = None
        self._known: dict[Path, Scan | None] = {}  # None: being read, or it cannot be
        self._thin: dict[Path, Scan] = {}

    def of(self, task: Task) -> dict[Path, Scan]:
        """The scans of a task that have been read; those that were not are, from now on."""
        found: dict[Path, Scan] = {}
        for path in task.scans:
            with self._lock:
                known = path in self._known
                scan = self._known.setdefault(path, None)
            if scan is not None:
                found[path] = scan
            elif not known:
                self._do(partial(self._read, path))
        return found

    def shown(self, path: Path) -> Scan:
        """A scan as it is shown: thinned, if it is large."""
        with self._lock:
            return self._thin[path]

    def add_scan(self, path: Path) -> None:
        """Read a scan, and add it to the task if it can be read."""
        self._do(lambda: self._add(path))

    def add_mesh(self, path: Path, scale: float) -> None:
        """Read a mesh, and add its convex hull to the obstacles if it can be read."""

        def job() -> None:
            try:
                mesh = Mesh.load(path, scale)
            except PostureError as error:
                self._refuse(error)
                return
            self._post(lambda session: _take_mesh(_plain(path.stem), mesh, session))

        self._do(job)

    def upload(self, name: str, content: bytes, folder: Path | None, scale: float, convex: bool) -> None:
        """Take in a file that somebody sent.

        Args:
            name: its name.
            content: what is in it.
            folder: where scans are kept: the folder of the task file; None if there is none yet.
            scale: factor of the coordinates of a mesh.
            convex: whether it is to be an obstacle, the convex hull of a mesh; a scan otherwise.
        """
        plain = Path(name.replace("\\", "/")).name

        def job() -> None:
            with tempfile.TemporaryDirectory() as draft:
                path = Path(draft) / plain
                try:
                    path.write_bytes(content)
                    if convex:
                        mesh = Mesh.load(path, scale)
                        self._post(lambda session: _take_mesh(_plain(path.stem), mesh, session))
                        return
                    if folder is None:
                        raise FileError(plain, "is to be kept beside the task file: save the task first")
                    Scan.load(path)
                    kept = _free_path(folder, plain, content)
                    if not kept.exists():
                        write_bytes(kept, content)
                except (PostureError, OSError) as error:
                    self._refuse(error, plain)
                    return
            self._add(kept)

        self._do(job)

    def close(self) -> None:
        """End, after what it is at."""
        self._jobs.put(None)
        if self._thread is not None:
            self._thread.join(timeout=5.0)

    def _do(self, job: Callable[[], object]) -> None:
        self._jobs.put(job)
        with self._lock:
            if self._thread is None:
                self._thread = Thread(target=self._run, name="pinposture-scans", daemon=True)
                self._thread.start()

    def _run(self) -> None:
        while (job := self._jobs.get()) is not None:
            try:
                job()
            except Exception as error:  # whatever a file does to its reader, the editor goes on
                logger.exception("a file could not be taken in")
                self._refuse(error)

    def _add(self, path: Path) -> None:
        if self._read(path, anew=True) is not None:
            self._post(lambda session: _take_scan(path, session))

    def _read(self, path: Path, anew: bool = False) -> Scan | None:
        try:
            scan = Scan.load(path)
            thin = scan.thinned(SHOWN) if max(len(scan.points), _faces(scan)) > SHOWN else scan
        except PostureError as error:
            self._refuse(error)
            return None
        with self._lock:
            self._known[path], self._thin[path] = scan, thin
        width = float((scan.points.max(axis=0) - scan.points.min(axis=0)).max())
        if anew and width > WIDE:
            text = f"{path.name} is {width:.3g} m wide: is it in millimetres? Scans are taken to be in metres"
            self._post(lambda session: session.say(text, "warning"))
        return scan

    def _refuse(self, error: Exception, name: str | None = None) -> None:
        reason = str(error)
        if name is not None and isinstance(error, FileError):
            reason = f"{name}: {error.reason}"
        self._post(lambda session: session.say(reason, "error"))


def with_scans(scans: tuple[Path, ...]) -> Edit:
    """The task with other scans beside it."""
    return lambda task: task.edited(scans=scans)


def remove_scan(path: Path, session: Session) -> None:
    """Show a scan no more; its file stays."""
    left = tuple(each for each in session.task.scans if each != path)
    if len(left) < len(session.task.scans):
        session.edit(with_scans(left), f"removed the scan {path.name}")


def _take_scan(path: Path, session: Session) -> None:
    if path in session.task.scans:
        session.say(f"{path.name} is there already", "warning")
        return
    session.edit(with_scans((*session.task.scans, path)), f"added the scan {path.name}")


def _take_mesh(stem: str, mesh: Mesh, session: Session) -> None:
    taken = obstacles_of(session.task)
    take_in(stem if stem not in taken else free_name(stem, taken), mesh, session)


def _free_path(folder: Path, name: str, content: bytes) -> Path:
    """Where to keep a file: under its name, or with a number if another file has that."""
    path, number = folder / name, 1
    while os.path.lexists(path) and (path.is_symlink() or not _holds(path, content)):
        number += 1
        path = folder / f"{Path(name).stem}_{number}{Path(name).suffix}"
    return path.absolute()


def _holds(path: Path, content: bytes) -> bool:
    return path.is_file() and path.read_bytes() == content


def _faces(scan: Scan) -> int:
    return 0 if scan.faces is None else len(scan.faces)


def _plain(name: str) -> str:
    """A file name as that of an obstacle."""
    kept = "".join(each for each in name if each.isprintable()).strip()
    return kept or "mesh"


# What is around the arm, as the editor looks after it: the pace of changes, clearance, scans.

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
