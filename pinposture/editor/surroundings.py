"""The surroundings of the arm: scans and meshes from files, clearance, and dragged obstacles."""

from __future__ import annotations

import logging
import os
import tempfile
from collections.abc import Callable
from functools import partial
from pathlib import Path
from queue import SimpleQueue
from threading import Lock, Thread
from typing import TypeAlias

from pinposture.collision import Mesh
from pinposture.collision.files import MESH_FORMATS
from pinposture.collision.scan import Scan
from pinposture.collision.shapes import MAX_PLAUSIBLE_WIDTH
from pinposture.editor.clearances import ClearanceQuery, Clearances, Marks, MarksQuery
from pinposture.editor.edits import Edit, keyframes_of, with_obstacle
from pinposture.editor.obstacles import free_name, insert_obstacle, obstacles_of
from pinposture.editor.session import Session
from pinposture.editor.solver import Live, VerdictCache
from pinposture.errors import FileError, InvalidValue, PostureError
from pinposture.storage import write_bytes
from pinposture.task import Task

logger = logging.getLogger(__name__)

Post: TypeAlias = Callable[..., None]

MAX_SHOWN = 200_000  # points or triangles of a scan


class ScanShelf:
    """The scans of a task, as far as they have been read.

    Files are read and written in a thread, which posts requests to the editor's loop.
    """

    def __init__(self, post: Post) -> None:
        self._post = post
        self._lock = Lock()
        self._jobs: SimpleQueue[Callable[[], object] | None] = SimpleQueue()
        self._thread: Thread | None = None
        self._known: dict[Path, Scan | None] = {}  # None: being read, or unreadable
        self._thinned: dict[Path, Scan] = {}

    def of(self, task: Task) -> dict[Path, Scan]:
        """Return the scans of a task that have been read, and start to read the others."""
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
        """Return a scan as it is shown: thinned, if it is large."""
        with self._lock:
            return self._thinned[path]

    def add_scan(self, path: Path) -> None:
        """Read a scan, and add it to the task if it can be read."""
        self._do(partial(self._add, path))

    def add_obstacle(self, path: Path, scale: float) -> None:
        """Read a mesh or a cloud of points, and add it to the obstacles if it can be read."""

        def job() -> None:
            try:
                self._load_obstacle(path, scale)
            except PostureError as error:
                self._refuse(error)

        self._do(job)

    def remove_outliers(self, name: str, distance: float, session: Session) -> None:
        """Read a cloud of points again without its outliers, and put it in the place of an obstacle.

        Args:
            name: the name of the obstacle.
            distance: as for `Scan.without_outliers` [m]; 0 keeps all points.
            session: the session.
        """
        cloud = obstacles_of(session.task).get(name)
        if not isinstance(cloud, Scan) or distance == (cloud.outlier_distance or 0.0):
            return
        session.say(f"reading {cloud.name} again ...")

        def job() -> None:
            try:
                found = _without_outliers(cloud, distance or None)
            except PostureError as error:
                self._refuse(error)
                return
            what = f"{name}: {found.outliers} outliers removed" if distance else f"{name}: all points kept"
            self._post(partial(_replace_points, name, cloud, found, what))

        self._do(job)

    def upload(self, name: str, content: bytes, folder: Path | None, scale: float, avoided: bool) -> None:
        """Add a file that was uploaded, and keep it.

        Args:
            name: its name.
            content: its content.
            folder: where files are kept: the folder of the task file; None if there is none yet.
            scale: factor of the coordinates of an obstacle.
            avoided: whether it is an obstacle; a scan that is only shown otherwise.
        """
        plain = Path(name.replace("\\", "/")).name

        def job() -> None:
            with tempfile.TemporaryDirectory() as draft:
                path = Path(draft) / plain
                try:
                    path.write_bytes(content)
                    if folder is None:
                        raise FileError(plain, "needs a task file to be stored next to; save the task first")
                    if avoided:
                        read_obstacle(path, scale)
                    else:
                        Scan.load(path)
                    kept = _free_path(folder, plain, content)
                    if not kept.exists():
                        write_bytes(kept, content)
                    if avoided:
                        self._load_obstacle(kept, scale)
                except (PostureError, OSError) as error:
                    self._refuse(error, plain)
                    return
            if not avoided:
                self._add(kept)

        self._do(job)

    def close(self) -> None:
        """End the thread after the jobs that wait."""
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
            except Exception as error:  # a broken file may raise anything
                logger.exception("a file could not be taken in")
                self._refuse(error)

    def _load_obstacle(self, path: Path, scale: float) -> None:
        obstacle = read_obstacle(path, scale)
        stem = "".join(each for each in path.stem if each.isprintable()).strip() or obstacle.type

        def request(session: Session) -> None:
            taken = obstacles_of(session.task)
            insert_obstacle(stem if stem not in taken else free_name(stem, taken), obstacle, session)

        self._post(request)

    def _add(self, path: Path) -> None:
        def request(session: Session) -> None:
            if path in session.task.scans:
                session.say(f"{path.name} has already been added", "warning")
            else:
                session.edit(with_scans((*session.task.scans, path)), f"added the scan {path.name}")

        if self._read(path, new=True) is not None:
            self._post(request)

    def _read(self, path: Path, new: bool = False) -> Scan | None:
        try:
            scan = Scan.load(path)
            size = max(len(scan.points), 0 if scan.faces is None else len(scan.faces))
            thinned = scan.thinned(MAX_SHOWN) if size > MAX_SHOWN else scan
        except PostureError as error:
            self._refuse(error)
            return None
        with self._lock:
            self._known[path] = scan
            self._thinned[path] = thinned
        width = float((scan.points.max(axis=0) - scan.points.min(axis=0)).max())
        if new and width > MAX_PLAUSIBLE_WIDTH:
            text = f"{path.name} is {width:.3g} m wide: is it in millimetres? Scans must be in metres"
            self._post(lambda session: session.say(text, "warning"))
        return scan

    def _refuse(self, error: Exception, name: str | None = None) -> None:
        reason = str(error)
        if name is not None and isinstance(error, FileError):
            reason = f"{name}: {error.reason}"
        self._post(lambda session: session.say(reason, "error"))


def read_obstacle(path: Path, scale: float) -> Mesh | Scan:
    """Read a mesh, or a cloud of points; see `Mesh.load` and `Scan.load`.

    Raises:
        FileError: missing, of another format, or malformed.
        InvalidValue: not a factor.
    """
    suffix = path.suffix.lower()
    if suffix == ".ply" or suffix not in MESH_FORMATS:
        scan = Scan.load(path, scale)
        if scan.faces is None or suffix not in MESH_FORMATS:
            return scan
    return Mesh.load(path, scale)


def _without_outliers(cloud: Scan, distance: float | None) -> Scan:
    """Return a cloud of points without its outliers, read again if it is from a file.

    Args:
        cloud: the cloud.
        distance: as for `Scan.without_outliers` [m]; None keeps all points.

    Raises:
        FileError: the file cannot be read.
        InvalidValue: an invalid distance, or a cloud without a file, whose outliers are gone already.
    """
    if cloud.path is not None:
        return Scan.load(
            cloud.path,
            cloud.scale,
            center=cloud.center,
            rotation=cloud.rotation,
            point_radius=cloud.point_radius,
            outlier_distance=distance,
        )
    if distance is None:
        raise InvalidValue("outlier_distance", 0.0, "more than 0 m: the points are in no file; undo restores")
    return cloud.without_outliers(distance)


def _replace_points(name: str, before: Scan, found: Scan, what: str, session: Session) -> None:
    """Put a cloud of points in the place of an obstacle, unless that has become another one meanwhile."""
    now = obstacles_of(session.task).get(name)
    if not isinstance(now, Scan) or now.points is not before.points:
        session.say(f"{name}: not changed, the obstacle was changed meanwhile", "warning")
    elif len(found.points) == len(now.points):
        session.say(f"{name}: no outliers, all {len(now.points)} points stay")
    else:
        session.edit(with_obstacle(name, found.placed(now.center, now.rotation)), what)


def with_scans(scans: tuple[Path, ...]) -> Edit:
    """Replace the scans of a task."""
    return lambda task: task.edited(scans=scans)


def remove_scan(path: Path, session: Session) -> None:
    """Remove a scan from the task; its file stays."""
    left = tuple(each for each in session.task.scans if each != path)
    if len(left) < len(session.task.scans):
        session.edit(with_scans(left), f"removed the scan {path.name}")


def _free_path(folder: Path, name: str, content: bytes) -> Path:
    """Return where to keep a file: under its name, or with a number if another file has that."""

    def is_same(path: Path) -> bool:
        return not path.is_symlink() and path.is_file() and path.read_bytes() == content

    path = folder / name
    number = 1
    while os.path.lexists(path) and not is_same(path):
        number += 1
        path = folder / f"{Path(name).stem}_{number}{Path(name).suffix}"
    return path.absolute()


class Surroundings:
    """The surroundings of the arm.

    Attributes:
        scans: the scans of the task, as far as they have been read.
    """

    def __init__(self, post: Post, verdicts: VerdictCache | None = None) -> None:
        self.scans = ScanShelf(post)
        self._clearances = Clearances()
        self._marks = Marks(VerdictCache() if verdicts is None else verdicts)

    def watch(self, session: Session, live: Live) -> None:
        """Update clearance and marks; called by the loop, each time before the solver is asked."""
        if live.arm is session.arm:
            scans = {path.name: scan for path, scan in self.scans.of(session.task).items()}
            q = session.playback.seen(live).state.q
            self._clearances.ask(ClearanceQuery(live.arm, q, session.shown.effective_scene, scans))
        session.nearest = self._clearances.latest
        task = session.task
        self._marks.ask(MarksQuery(task.arm, keyframes_of(task), task.effective_scene))
        session.marks = self._marks.latest or ()

    def close(self) -> None:
        """End all threads."""
        self._clearances.close()
        self._marks.close()
        self.scans.close()
