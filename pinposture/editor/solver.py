"""The one place where the arm is moved: a thread that is always at the latest shape."""

from __future__ import annotations

import logging
import time
import warnings
from collections.abc import Callable
from dataclasses import replace
from threading import Event, Lock, Thread
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from pinposture.arm import Arm, ArmState
from pinposture.collision import Scene
from pinposture.control import Controller, Geodesic, Limits
from pinposture.editor.verdict import NEAR_LIMIT, Verdict, judge, review
from pinposture.errors import PostureError, PostureWarning
from pinposture.motion import Tracker
from pinposture.motion.tracker import Report
from pinposture.placement import Target
from pinposture.task import Keyframe
from pinposture.task.reference import tip_off

# The arm as it is at the moment, and what it makes of what was last asked of it.

Array = NDArray[np.float64]

BINDS = 0.999
"""Share of its speed limit at which a joint is at it."""


class Problem(NamedTuple):
    """What is asked of the arm.

    Attributes:
        number: rises with everything that is asked.
        arm: the arm.
        keyframe: whose shape to take.
        controller: what moves the arm there.
        limits: within what; the cycle is the solver's own.
        scene: what to keep clear of; None if there is nothing.
        at_once: whether to be there at once, whatever the limits.
        asked: when it was asked, by `time.monotonic` [s].
        shaping: whether the shape was made by hand of the one before, so that what the arm does is near.
        passing: whether the hand is still at it, so that it is not worth a long search.
    """

    number: int
    arm: Arm
    keyframe: Keyframe
    controller: Controller
    limits: Limits
    scene: Scene | None
    at_once: bool
    asked: float
    shaping: bool = False
    passing: bool = False


class Live(NamedTuple):
    """The arm as it is at the moment.

    Attributes:
        number: of the problem that was last looked at.
        arm: the arm.
        verdict: what the arm can make of it.
        state: where the arm is.
        target: what it is on its way to; None if there was nothing yet that it could take.
        errors: distance of each control point from its target, zero where it has none, (m,) [m].
        tip_error: by how much the task of the tip is missed [m]; None without one.
        active: which control points are in the active control set, (m,).
        at_limit: which joints of the chain are at a limit of position or speed, (n,).
        status: as in `Report`.
        reason: why it does not move on, in words.
        lag: from asking to the first step towards it [s]; None if that is to come.
        steps: how many there were in all.
    """

    number: int
    arm: Arm
    verdict: Verdict
    state: ArmState
    target: Target | None
    errors: Array
    tip_error: float | None
    active: NDArray[np.bool_]
    at_limit: NDArray[np.bool_]
    status: str
    reason: str
    lag: float | None
    steps: int

    @property
    def mean_error(self) -> float:
        """Mean distance of the control points from their targets [m]; 0 without a target."""
        if self.target is None:
            return 0.0
        return float(self.errors[self.target.has_target].mean())


def errors_of(state: ArmState, target: Target | None) -> Array:
    """Distance of each control point from its target, zero where it has none, (m,) [m]."""
    if target is None:
        return np.zeros(len(state.points))
    return np.asarray(np.linalg.norm(target.points - state.points, axis=1) * target.has_target)


def active_of(report: Report, count: int) -> NDArray[np.bool_]:
    """Which of the control points are in the active control set, (m,)."""
    active = np.zeros(count, dtype=np.bool_)
    if report.step is not None:
        active[list(report.step.active)] = True
    return active


def at_limit(state: ArmState, dq: Array, bound: Array) -> NDArray[np.bool_]:
    """Which joints of the chain are at a limit.

    Args:
        state: where the arm is.
        dq: its last step, (nv,) [rad or m].
        bound: the longest that steps may be, (nv,) [rad or m].

    Returns:
        For each joint from base to tip, (n,).
    """
    arm = state.arm
    room = np.minimum(state.positions - arm.limits.lower, arm.limits.upper - state.positions)
    fast = np.abs(dq) >= BINDS * bound
    at = (room < NEAR_LIMIT * arm.joint_units) | fast
    return np.asarray(at[arm.columns])


# The one place where the arm is moved: a loop in a thread of its own that is always at the latest shape.

logger = logging.getLogger(__name__)

CYCLE = 0.02
"""How long a step takes [s]: the arm moves in real time, within its limits."""

PATIENCE = 0.25
"""How long a step waits for its controller before the arm holds, and the controller goes on alone [s]."""

IDLE = 0.25
"""How often it looks around while the arm is at rest and nothing is asked [s]."""

RESTING = ("converged", "stalled")
MOVING = ("controller", "limits", "scene")
"""What of a problem has to do with how the arm moves, and not with where to."""

MOST_KNOWN = 100
"""Shapes that are remembered, so that going back to one takes no time."""


class Judged(NamedTuple):
    """A shape that was judged.

    Attributes:
        arm: the arm.
        keyframe: which has the shape.
        verdict: what the arm can make of it.
    """

    arm: Arm
    keyframe: Keyframe
    verdict: Verdict


class Solver:
    """Takes the latest problem, whatever came before it, judges it, and moves the arm to what it can take.

    What is asked while it is at work on something is not queued: only the last counts.

    Args:
        first: the first problem.
        start: where the arm is, (nq,).
        tell: called after each step, in the solver's thread.
    """

    def __init__(self, first: Problem, start: Array, tell: Callable[[], object] = lambda: None) -> None:
        self._tell = tell
        self._lock, self._news, self._over = Lock(), Event(), Event()
        self._asked, self._problem, self._made_for = first, first, first
        self._tracker, self._verdict = _tracker(first, start), Verdict(None)
        self._lag: float | None = None
        self._taken: tuple[Arm, Target] | None = None  # the last shape that could be
        self._known: dict[int, Judged] = {}  # those that were not only passed, by their keyframes
        self._steps = 0
        self._dq, self._fault = np.zeros(first.arm.nv), ""
        self._live = self._look(first.arm.at(start))
        self._thread = Thread(target=self._run, name="pinposture-solver", daemon=True)

    @property
    def live(self) -> Live:
        """The arm as it was after the last step."""
        with self._lock:
            return self._live

    def start(self) -> None:
        """Begin."""
        self._thread.start()

    def ask(self, problem: Problem) -> None:
        """Ask for something else from now on."""
        with self._lock:
            self._asked = problem
        self._news.set()

    def close(self) -> None:
        """End, after the step that it is at."""
        self._over.set()
        self._news.set()
        if self._thread.is_alive():
            self._thread.join(timeout=5.0)

    def _run(self) -> None:
        self._take(self._problem, new=True)
        while not self._over.is_set():
            begun = time.monotonic()
            with self._lock:
                asked = self._asked
            if asked.number != self._problem.number:
                self._take(asked)
                self._publish()  # whoever proposed it need not wait for a step that has to be planned
            self._step()
            resting = self._tracker.report.status in RESTING or self._tracker.target is None
            left = IDLE if resting else CYCLE - (time.monotonic() - begun)
            if resting:
                self._news.wait(left)
            elif left > 0.0:
                self._over.wait(left)
            self._news.clear()

    def _take(self, problem: Problem, new: bool = False) -> None:
        """Turn to another problem. Whatever is wrong with it is said in the verdict, and the arm stays."""
        self._problem, self._lag = problem, None
        before = self._made_for
        try:
            self._verdict = self._judged(problem)
            if problem.arm is not before.arm:
                self._begin(problem)
            elif new or any(getattr(problem, part) != getattr(before, part) for part in MOVING):
                target, tracker = self._tracker.target, _tracker(problem, self._tracker.command, self._dq)
                if target is not None:
                    tracker.update(target)
                self._tracker, self._made_for = tracker, problem
            if self._verdict.target is not None:
                self._tracker.update(self._verdict.target)
        except PostureError as error:
            self._verdict = Verdict(None, str(error))
        except Exception as error:  # a fault of ours, which must not end the thread: it would be waited for
            logger.exception("a problem could not be looked at")
            self._verdict = Verdict(None, f"that could not be worked out ({error})")

    def _begin(self, problem: Problem) -> None:
        """Turn to another arm; it lies straight.

        Raises:
            PostureError: it cannot be moved by this controller, in this scene. It then just lies there.
        """
        self._dq = np.zeros(problem.arm.nv)
        self._known.clear()  # of the arm from before
        start, bare = problem.arm.straight(), problem._replace(controller=Geodesic(), scene=None)
        self._tracker, self._made_for = _tracker(bare, start), bare
        self._tracker, self._made_for = _tracker(problem, start), problem

    def _judged(self, problem: Problem) -> Verdict:
        """What the arm can make of a problem; known already of a shape that was judged before."""
        arm, keyframe = problem.arm, problem.keyframe
        known, before = self._known.get(id(keyframe)), self._taken
        if known is not None and known.arm is arm:
            target, verdict = known.verdict.target, known.verdict
            if target is not None:
                verdict = review(arm, keyframe, target, problem.scene)
        else:
            near = before[1] if before is not None and before[0] is arm and problem.shaping else None
            verdict = judge(arm, keyframe, problem.scene, near, not problem.passing)
            if not problem.passing:
                self._known[id(keyframe)] = Judged(arm, keyframe, verdict)
                if len(self._known) > MOST_KNOWN:
                    del self._known[next(iter(self._known))]
        if verdict.target is not None:
            self._taken = arm, verdict.target
        return verdict

    def _step(self) -> None:
        """One step, and what can be seen after it."""
        tracker, problem = self._tracker, self._problem
        arm, target = tracker.arm, tracker.target
        try:
            if problem.at_once and target is not None and target.q is not None:
                tracker.restart(target.q)
            self._dq, self._fault = tracker.step(tracker.command), ""
        except Exception as error:  # of a controller, of whatever kind
            reason = str(error) or type(error).__name__
            if reason != self._fault:
                logger.warning("the arm is brought to rest: %s", error)
            self._dq, self._fault = tracker.limits.hold(arm.at(tracker.command), self._dq).dq, reason
            tracker.restart(arm.integrate(tracker.command, self._dq), self._dq)
        self._steps += 1
        if self._lag is None:
            self._lag = time.monotonic() - problem.asked
        self._publish()

    def _publish(self) -> None:
        """Leave what there is to see, to be looked up."""
        live = self._look(self._tracker.arm.at(self._tracker.command))
        with self._lock:
            self._live = live
        self._tell()

    def _look(self, state: ArmState) -> Live:
        tracker, problem = self._tracker, self._problem
        report, target = tracker.report, tracker.target
        tip = None if target is None else tip_off(problem.keyframe.tip, target, state)
        return Live(
            number=problem.number,
            arm=tracker.arm,
            verdict=self._verdict,
            state=state,
            target=target,
            errors=errors_of(state, target),
            tip_error=tip,
            active=active_of(report, tracker.arm.n_modules),
            at_limit=at_limit(state, self._dq, tracker.limits.bound(state)),
            status="holding" if self._fault else report.status,
            reason=self._fault or report.reason,
            lag=self._lag,
            steps=self._steps,
        )


def _tracker(problem: Problem, q: Array, dq: Array | None = None) -> Tracker:
    """What moves the arm; from q, at rest or after a step dq, (nv,) [rad or m]."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", PostureWarning)  # the status says it
        tracker = Tracker(
            problem.arm,
            problem.controller,
            in_cycles(problem.limits),
            problem.scene,
            feedback_time_constant=float("inf"),
            deadline=PATIENCE,
        )
    tracker.restart(q, dq)  # the speed goes on: dragging an obstacle makes a tracker several times a second
    return tracker


def in_cycles(limits: Limits) -> Limits:
    """The same limits for cycles of `CYCLE`: what a step may be is a share of what it was."""
    if limits.step is None or limits.dt is None:
        return replace(limits, dt=CYCLE)
    return replace(limits, dt=CYCLE, step=limits.step * (CYCLE / limits.dt))
