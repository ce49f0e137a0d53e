"""The surroundings of the arm: scans and meshes from files, clearance, and dragged obstacles."""

from __future__ import annotations

import logging
import operator
import os
import tempfile
from collections.abc import Callable, Mapping
from dataclasses import replace
from functools import partial
from pathlib import Path
from threading import Event, Lock
from typing import NamedTuple, TypeAlias

import numpy as np
from numpy.typing import NDArray

from pinposture.arm import Arm, ArmState
from pinposture.collision import CollisionModel, Mesh, Scene
from pinposture.collision.files import MESH_FORMATS
from pinposture.collision.scan import Scan
from pinposture.collision.shapes import MAX_PLAUSIBLE_WIDTH
from pinposture.editor.edits import Edit, keyframes_of, with_obstacle
from pinposture.editor.obstacles import free_name, insert_obstacle, obstacles_of
from pinposture.editor.session import NearestObstacle, Session
from pinposture.editor.solver import Live, VerdictCache
from pinposture.errors import FileError, InvalidValue, PostureError
from pinposture.motion.latest import EXPECTED_ERRORS, Latest
from pinposture.storage import write_bytes
from pinposture.task import Keyframe, Task
from pinposture.units import CONVERGED

Array = NDArray[np.float64]
logger = logging.getLogger(__name__)

Post: TypeAlias = Callable[..., None]

MAX_SHOWN = 200_000  # points or triangles of a scan
MIN_PERIOD = 0.1  # between two looks at clearance or marks [s]


class ScanShelf:
    """The scans of a task, as far as they have been read.

    Files are read and written beside the editor's loop, one after the other, and requests posted to it.
    """

    def __init__(self, post: Post) -> None:
        self._post = post
        self._lock = Lock()
        self._jobs: Latest[tuple[Callable[[], object], ...], None] = Latest(
            self._do_all, "pinposture-scans", merge=operator.add
        )
        self._known: dict[Path, Scan | None] = {}  # None: being read, or unreadable
        self._thinned: dict[Path, Scan] = {}

    def of(self, task: Task) -> dict[Path, Scan]:
        """Return the scans of a task that have been read, and start to read the others."""
        scans: dict[Path, Scan] = {}
        for path in task.scans:
            with self._lock:
                known = path in self._known
                scan = self._known.setdefault(path, None)
            if scan is not None:
                scans[path] = scan
            elif not known:
                self._do(partial(self._read, path))
        return scans

    def shown(self, path: Path) -> Scan:
        """Return a scan as it is shown: thinned, if it is large."""
        with self._lock:
            return self._thinned[path]

    def add_scan(self, path: Path) -> None:
        """Read a scan, and add it to the task if it can be read."""
        self._do(partial(self._add, path))

    def add_obstacle(self, path: Path, scale: float) -> None:
        """Read a mesh or a cloud of points, and add it to the obstacles if it can be read."""
        self._do(partial(self._load_obstacle, path, scale))

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
            scan = _without_outliers(cloud, distance or None)
            what = f"{name}: {scan.outliers} outliers removed" if distance else f"{name}: all points kept"
            self._post(partial(_replace_points, name, cloud, scan, what))

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
        """End after the jobs that wait."""
        self._jobs.finish()
        self._jobs.close()

    def _do(self, job: Callable[[], object]) -> None:
        self._jobs.ask((job,))

    def _do_all(self, jobs: tuple[Callable[[], object], ...], _: Event) -> None:
        for job in jobs:
            try:
                job()
            except Exception as error:  # a broken file may raise anything
                if not isinstance(error, EXPECTED_ERRORS):
                    logger.exception("a file could not be taken in")
                self._refuse(error)

    def _load_obstacle(self, path: Path, scale: float) -> None:
        obstacle = read_obstacle(path, scale)
        stem = (
            "".join(character for character in path.stem if character.isprintable()).strip() or obstacle.type
        )

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


def _replace_points(name: str, before: Scan, scan: Scan, what: str, session: Session) -> None:
    """Put a cloud of points in the place of an obstacle, unless that has become another one meanwhile."""
    now = obstacles_of(session.task).get(name)
    if not isinstance(now, Scan) or now.points is not before.points:
        session.say(f"{name}: not changed, the obstacle was changed meanwhile", "warning")
    elif len(scan.points) == len(now.points):
        session.say(f"{name}: no outliers, all {len(now.points)} points stay")
    else:
        session.edit(with_obstacle(name, scan.placed(now.center, now.rotation)), what)


def with_scans(scans: tuple[Path, ...]) -> Edit:
    """Replace the scans of a task."""
    return lambda task: task.edited(scans=scans)


def remove_scan(path: Path, session: Session) -> None:
    """Remove a scan from the task; its file stays."""
    left = tuple(scan for scan in session.task.scans if scan != path)
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


class ClearanceQuery(NamedTuple):
    """An arm and its surroundings."""

    arm: Arm
    q: Array  # its configuration, (nq,)
    scene: Scene  # the obstacles
    scans: Mapping[str, Scan]  # the scans, by name

    def same_as(self, other: ClearanceQuery) -> bool:
        """Whether another query has the same answer."""
        same = self.arm is other.arm and self.scene is other.scene and self.scans == other.scans
        return same and np.array_equal(self.q, other.q)


def nearest(query: ClearanceQuery) -> NearestObstacle | None:
    """Return where an arm is nearest to obstacles and scans, or deepest inside itself; None if nowhere.

    Raises:
        PostureError: a distance cannot be computed.
    """
    arm = query.arm
    scene = query.scene
    state = arm.at(query.q)
    pairs = []
    if scene.obstacles:
        # Without the arm itself: neighbours of neighbouring links are always near, and would hide the rest.
        pairs.append(_closest_pair(scene.without_self_collision(), state))
    inside = _closest_pair(scene.without_obstacles(), state)
    if inside is not None and inside.distance < -CONVERGED * arm.length:
        pairs.append(inside)
    # The margin is that from a scan of what the arm is mounted on [m].
    shown = Scene(self_collision=False, margin=0.01, arm_radius=scene.arm_radius)
    for name, scan in query.scans.items():
        seen = _closest_pair(replace(shown, obstacles={name: scan}), state)
        if seen is not None:
            pairs.append(seen._replace(margin=0.0))
    return min((pair for pair in pairs if pair is not None), key=lambda pair: pair.distance, default=None)


def _closest_pair(scene: Scene, state: ArmState) -> NearestObstacle | None:
    clearance = CollisionModel(state.arm, scene)
    least = clearance.minimum(state.q)
    if least.pair is None:
        return None
    near = clearance.nearest(state, max(least.distance, 0.0) + 1e-9 * state.arm.length)
    if not len(near.distances):
        return None
    on_other = near.points[0] - near.distances[0] * near.normals[0]
    body, other = near.pairs[0]
    return NearestObstacle(float(near.distances[0]), body, other, near.points[0], on_other, scene.margin)


class MarksQuery(NamedTuple):
    """Keyframes to mark."""

    arm: Arm
    keyframes: tuple[Keyframe, ...]
    scene: Scene  # the obstacles to avoid

    def same_as(self, other: MarksQuery) -> bool:
        """Whether another query has the same answer."""
        same = self.arm is other.arm and self.scene is other.scene
        return same and [*map(id, self.keyframes)] == [*map(id, other.keyframes)]


def marks_of(query: MarksQuery, verdicts: VerdictCache) -> tuple[str, ...]:
    """Return whether each keyframe can be taken: "fine", "collides" or "refused"."""
    return tuple(verdicts.judge(query.arm, keyframe, query.scene).mark for keyframe in query.keyframes)


class Surroundings:
    """The surroundings of the arm.

    Attributes:
        scans: the scans of the task, as far as they have been read.
    """

    def __init__(self, post: Post, verdicts: VerdictCache | None = None) -> None:
        self.scans = ScanShelf(post)
        known = VerdictCache() if verdicts is None else verdicts
        self._clearances: Latest[ClearanceQuery, NearestObstacle | None] = Latest(
            lambda query, _: nearest(query),
            "pinposture-clearance",
            same=ClearanceQuery.same_as,
            period=MIN_PERIOD,
        )
        self._marks: Latest[MarksQuery, tuple[str, ...]] = Latest(
            lambda query, _: marks_of(query, known),
            "pinposture-marks",
            same=MarksQuery.same_as,
            period=MIN_PERIOD,
        )

    def watch(self, session: Session, live: Live) -> None:
        """Update clearance and marks; called by the loop, each time before the solver is asked."""
        if live.arm is session.arm:
            scans = {path.name: scan for path, scan in self.scans.of(session.task).items()}
            q = session.playback.seen(live).state.q
            self._clearances.ask(ClearanceQuery(live.arm, q, session.shown.effective_scene, scans))
        cleared = self._clearances.done
        session.nearest = None if cleared is None else cleared.answer
        task = session.task
        self._marks.ask(MarksQuery(task.arm, keyframes_of(task), task.effective_scene))
        marked = self._marks.done
        session.marks = () if marked is None else marked.answer or ()

    def close(self) -> None:
        """End all threads."""
        self._clearances.close()
        self._marks.close()
        self.scans.close()
