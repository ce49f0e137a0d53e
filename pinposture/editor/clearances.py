"""What is worked out beside the loop: the clearance of the arm, and whether each keyframe can be taken."""

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
from pinposture.collision import CollisionModel, Scan, ScanClearance, Scene
from pinposture.editor.verdict import TOUCHING, Verdict, itself, judge, review
from pinposture.errors import PostureError
from pinposture.task import Keyframe

Array = NDArray[np.float64]
logger = logging.getLogger(__name__)

PERIOD = 0.1
"""How often it is worked out at most [s]."""


class NearestObstacle(NamedTuple):
    """Where an arm is nearest to something that is not part of it, or inside itself.

    Attributes:
        distance: between the surfaces, negative where they overlap [m]; from a scan, 0 where they overlap.
        body: name of the body of the arm.
        other: name of the obstacle, of the scan, or of another body that the first is inside of.
        on_arm: point of the body, nearest to the other or deepest in it, (3,) [m], world frame.
        on_other: point of the other's surface, (3,) [m], world frame.
        margin: the distance to keep [m]; 0 for scans, which are not avoided.
        scanned: whether the other is a scan.
    """

    distance: float
    body: str
    other: str
    on_arm: Array
    on_other: Array
    margin: float
    scanned: bool = False

    @property
    def level(self) -> str:
        """How that is: "inside", "within the margin" or "clear"."""
        if self.distance < 0.0 or (self.scanned and self.distance == 0.0):
            return "inside"
        return "within the margin" if self.distance < self.margin else "clear"


class Asked(NamedTuple):
    """What the clearance is asked of.

    Attributes:
        arm: the arm.
        q: its configuration, (nq,).
        scene: the obstacles; None if there are none.
        scans: the scans, by the names to call them.
    """

    arm: Arm
    q: Array
    scene: Scene | None
    scans: Mapping[str, Scan]

    def like(self, other: Asked) -> bool:
        """Whether it is the same."""
        same = self.arm is other.arm and self.scene is other.scene and self.scans == other.scans
        return same and np.array_equal(self.q, other.q)


def nearest(asked: Asked) -> NearestObstacle | None:
    """Where an arm is nearest to obstacles and scans, or deepest inside itself; None if there is nothing.

    Raises:
        PostureError: a distance that cannot be told.
    """
    state = asked.arm.at(asked.q)
    radius = None if asked.scene is None else asked.scene.arm_radius
    found = [_of_obstacles(state, asked.scene), _of_itself(state, asked.scene)]
    found += [_of_scan(state, name, scan, radius) for name, scan in asked.scans.items()]
    return min((each for each in found if each is not None), key=lambda each: each.distance, default=None)


Question = TypeVar("Question")
Answer = TypeVar("Answer")


class Latest(Generic[Question, Answer]):
    """Answers what was last asked, in a thread of its own, ten times a second at most; the rest is dropped.

    Args:
        answer: works out an answer.
        same: whether two questions are the same.
        name: of the thread.
    """

    def __init__(
        self,
        answer: Callable[[Question], Answer | None],
        same: Callable[[Question, Question], bool],
        name: str,
    ) -> None:
        self._answer, self._same, self._name = answer, same, name
        self._lock, self._news, self._over = Lock(), Event(), Event()
        self._asked: Question | None = None
        self._latest: Answer | None = None
        self._thread: Thread | None = None

    @property
    def latest(self) -> Answer | None:
        """The last answer; None if there is none."""
        with self._lock:
            return self._latest

    def ask(self, asked: Question) -> None:
        """Ask for something; returns at once, and does nothing if it is what was asked before."""
        with self._lock:
            before, self._asked = self._asked, asked
        if before is not None and self._same(before, asked):
            return
        self._news.set()
        if self._thread is None:
            self._thread = Thread(target=self._run, name=self._name, daemon=True)
            self._thread.start()

    def close(self) -> None:
        """End, after what it is at."""
        self._over.set()
        self._news.set()
        if self._thread is not None:
            self._thread.join(timeout=5.0)

    def _run(self) -> None:
        while True:
            self._news.wait()
            if self._over.is_set():
                return
            self._news.clear()
            begun = time.monotonic()
            with self._lock:
                asked = self._asked
            try:
                found = None if asked is None else self._answer(asked)
            except Exception as error:  # of whatever kind: the thread is needed for what is asked next
                known = isinstance(error, PostureError | ArithmeticError | np.linalg.LinAlgError)
                logger.warning("%s: %s", self._name, error, exc_info=not known)
                found = None
            with self._lock:
                self._latest = found
            self._over.wait(max(PERIOD - (time.monotonic() - begun), 0.0))


class Clearances(Latest[Asked, NearestObstacle]):
    """The clearance of the arm."""

    def __init__(self) -> None:
        super().__init__(nearest, Asked.like, "pinposture-clearance")


class Marked(NamedTuple):
    """Which keyframes are asked about.

    Attributes:
        arm: the arm.
        keyframes: the keyframes.
        scene: what to keep clear of; None if there is nothing.
    """

    arm: Arm
    keyframes: tuple[Keyframe, ...]
    scene: Scene | None

    def like(self, other: Marked) -> bool:
        """Whether it is the same."""
        same = self.arm is other.arm and self.scene is other.scene
        return same and [*map(id, self.keyframes)] == [*map(id, other.keyframes)]


class Marks(Latest[Marked, tuple[str, ...]]):
    """Whether each keyframe can be taken: "fine", "collides" or "refused"."""

    def __init__(self) -> None:
        super().__init__(self._marks, Marked.like, "pinposture-marks")
        self._known: dict[int, tuple[Arm, Keyframe, Verdict]] = {}

    def _marks(self, asked: Marked) -> tuple[str, ...]:
        kept, self._known = self._known, {}
        for keyframe in asked.keyframes:
            arm, _, verdict = kept.get(id(keyframe), (None, None, None))
            if arm is not asked.arm or verdict is None:
                verdict = judge(asked.arm, keyframe, asked.scene)
            elif verdict.target is not None:
                verdict = review(asked.arm, keyframe, verdict.target, asked.scene)
            self._known[id(keyframe)] = asked.arm, keyframe, verdict
        return tuple(self._known[id(keyframe)][2].mark for keyframe in asked.keyframes)


def _of_obstacles(state: ArmState, scene: Scene | None) -> NearestObstacle | None:
    if scene is None or not scene.obstacles:
        return None
    # Without the arm itself: links next but one to each other are always near, and would hide the rest.
    return _closest_pair(replace(scene, self_collision=False) if scene.self_collision else scene, state)


def _of_itself(state: ArmState, scene: Scene | None) -> NearestObstacle | None:
    """Where the arm is deepest inside itself; None if it is not."""
    found = _closest_pair(itself(scene), state)
    return None if found is None or found.distance >= -TOUCHING * state.arm.length else found


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


def _of_scan(state: ArmState, name: str, scan: Scan, radius: float | None) -> NearestObstacle | None:
    gap = ScanClearance(state.arm, scan, radius).minimum(state.q)
    if gap.body is None or gap.on_arm is None or gap.on_scan is None:
        return None
    return NearestObstacle(gap.distance, gap.body, name, gap.on_arm, gap.on_scan, 0.0, scanned=True)
