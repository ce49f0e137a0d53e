"""The clearance of the arm and the marks of keyframes, computed in background threads."""

from __future__ import annotations

import logging
import time
from collections.abc import Callable, Mapping
from dataclasses import replace
from threading import Event, Lock, Thread
from typing import Generic, NamedTuple, TypeVar

import numpy as np
from numpy.typing import NDArray

from pinposture.arm import Arm, ArmState
from pinposture.collision import CollisionModel, Scan, Scene
from pinposture.editor.solver import VerdictCache
from pinposture.errors import PostureError
from pinposture.motion.run import CONTACT_TOLERANCE
from pinposture.task import Keyframe

Array = NDArray[np.float64]
Query = TypeVar("Query")
Answer = TypeVar("Answer")
logger = logging.getLogger(__name__)

MIN_PERIOD = 0.1  # of computing an answer [s]
MOUNT_DISTANCE = 0.01  # from a scan of what the arm is mounted on [m]


class NearestObstacle(NamedTuple):
    """Where an arm is nearest to its surroundings, or inside itself."""

    distance: float  # between the surfaces [m]; negative where they overlap
    body: str  # name of the body of the arm
    other: str  # name of the obstacle, of the scan, or of another body that the first is inside of
    on_arm: Array  # point of the body, nearest to the other or deepest in it, (3,) [m], world frame
    on_other: Array  # point of the other's surface, (3,) [m], world frame
    margin: float  # the distance to keep [m]; 0 for scans that are only shown

    @property
    def level(self) -> str:
        """The distance in words: "inside", "within the margin" or "clear"."""
        if self.distance < 0.0:
            return "inside"
        return "within the margin" if self.distance < self.margin else "clear"


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
    found = []
    if scene.obstacles:
        # Without the arm itself: neighbours of neighbouring links are always near, and would hide the rest.
        found.append(_closest_pair(scene.without_self_collision(), state))
    inside = _closest_pair(scene.without_obstacles(), state)
    if inside is not None and inside.distance < -CONTACT_TOLERANCE * arm.length:
        found.append(inside)
    shown = Scene(self_collision=False, margin=MOUNT_DISTANCE, arm_radius=scene.arm_radius)
    for name, scan in query.scans.items():
        seen = _closest_pair(replace(shown, obstacles={name: scan}), state)
        if seen is not None:
            found.append(seen._replace(margin=0.0))
    return min((each for each in found if each is not None), key=lambda each: each.distance, default=None)


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


class Background(Generic[Query, Answer]):
    """Answers the latest query in a thread of its own, at most ten times a second; older ones are dropped."""

    def __init__(
        self, answer: Callable[[Query], Answer | None], same: Callable[[Query, Query], bool], name: str
    ) -> None:
        self._answer = answer
        self._same = same
        self._name = name
        self._lock = Lock()
        self._wake = Event()
        self._closed = Event()
        self._query: Query | None = None
        self._latest: Answer | None = None
        self._thread: Thread | None = None

    @property
    def latest(self) -> Answer | None:
        """The last answer; None if there is none."""
        with self._lock:
            return self._latest

    def ask(self, query: Query) -> None:
        """Ask a query, unless it is the same as the last one; returns at once."""
        with self._lock:
            before = self._query
            self._query = query
        if before is not None and self._same(before, query):
            return
        self._wake.set()
        if self._thread is None:
            self._thread = Thread(target=self._run, name=self._name, daemon=True)
            self._thread.start()

    def close(self) -> None:
        """End the thread after the current answer."""
        self._closed.set()
        self._wake.set()
        if self._thread is not None:
            self._thread.join(timeout=5.0)

    def _run(self) -> None:
        while True:
            self._wake.wait()
            if self._closed.is_set():
                return
            self._wake.clear()
            begun = time.monotonic()
            with self._lock:
                query = self._query
            try:
                answer = None if query is None else self._answer(query)
            except Exception as error:  # of any kind: later queries need the thread
                known = isinstance(error, PostureError | ArithmeticError | np.linalg.LinAlgError)
                logger.warning("%s: %s", self._name, error, exc_info=not known)
                answer = None
            with self._lock:
                self._latest = answer
            self._closed.wait(max(MIN_PERIOD - (time.monotonic() - begun), 0.0))


class Clearances(Background[ClearanceQuery, NearestObstacle]):
    """The clearance of the arm."""

    def __init__(self) -> None:
        super().__init__(nearest, ClearanceQuery.same_as, "pinposture-clearance")


class MarksQuery(NamedTuple):
    """Keyframes to mark."""

    arm: Arm
    keyframes: tuple[Keyframe, ...]
    scene: Scene  # the obstacles to avoid

    def same_as(self, other: MarksQuery) -> bool:
        """Whether another query has the same answer."""
        same = self.arm is other.arm and self.scene is other.scene
        return same and [*map(id, self.keyframes)] == [*map(id, other.keyframes)]


class Marks(Background[MarksQuery, tuple[str, ...]]):
    """Whether each keyframe can be taken: "fine", "collides" or "refused"."""

    def __init__(self, verdicts: VerdictCache) -> None:
        def answer(query: MarksQuery) -> tuple[str, ...]:
            return tuple(verdicts.judge(query.arm, each, query.scene).mark for each in query.keyframes)

        super().__init__(answer, MarksQuery.same_as, "pinposture-marks")
