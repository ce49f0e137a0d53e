"""Whether the arm can take the shape of a keyframe, and how it moves there, beside the editor's loop."""

from __future__ import annotations

import logging
import time
import warnings
import weakref
from collections.abc import Callable
from dataclasses import replace
from threading import Event, Lock
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from pinposture.arm import Arm, ArmState
from pinposture.collision import CollisionModel, Scene
from pinposture.collision.model import effective_scene
from pinposture.collision.scene import obstacles_around
from pinposture.control import Controller, Geodesic, Limits
from pinposture.editor.edits import differ_in_weight_alone
from pinposture.errors import (
    CurveBendsTooMuch,
    CurveEndsEarly,
    CurveLeavesTooSharply,
    PostureError,
    PostureWarning,
    TargetError,
    TaskError,
    enumerated,
)
from pinposture.motion import Tracker
from pinposture.motion.deadline import NOT_DONE
from pinposture.motion.latest import Latest
from pinposture.placement import Target
from pinposture.task import Keyframe
from pinposture.task.keyframe import resolve_keyframe
from pinposture.task.reference import tip_off
from pinposture.units import CONVERGED, length_text

Array = NDArray[np.float64]
logger = logging.getLogger(__name__)


class LiveSettings(NamedTuple):
    """How the live arm moves, and when it rests."""

    step_time: float = 0.02
    """Duration of a step: the arm moves in real time, within its limits [s]."""

    deadline: float = 0.02
    """Time after which the arm keeps clear while the controller goes on computing [s]."""

    drag_horizon: float = 0.1
    """Time for which a dragged obstacle is extrapolated after its last move [s]."""

    rest_interval: float = 0.25
    """Time between steps while the arm is at rest and nothing is asked [s]."""

    stop_time: float = 0.5
    """Time for which the arm stands still before it is said to have stopped [s]."""

    near_limit: float = 1e-3
    """Distance to a position limit at which a joint is at it, in `Arm.joint_units`."""

    full_speed: float = 0.999
    """Share of its speed limit at which a joint is at it."""

    unreported_rest: float = 1.5
    """Rest of a curve beyond the arm that is not reported, in longest modules: some is needed to bend."""


LIVE_ARM = LiveSettings()


class Verdict(NamedTuple):
    """What an arm can make of the shape of a keyframe."""

    target: Target | None  # the target that it takes; None if it cannot
    reason: str = ""  # why it cannot; empty if it can
    notes: tuple[str, ...] = ()  # collisions, joints at limits, curve longer than the arm
    collision: bool = False  # whether it touches something, comes nearer than the margin, or is inside itself
    distance_from_curve: float | None = None  # as in `Target.distance_from_curve` [m]
    tip_error: float | None = None  # of the task of the tip [m], rotations by their lever; None without one

    @property
    def mark(self) -> str:
        """The verdict in a word: "refused", "collides" or "fine"."""
        return "refused" if self.target is None else "collides" if self.collision else "fine"


def judge(
    arm: Arm, keyframe: Keyframe, scene: Scene | None, near: Target | None = None, search: bool = True
) -> Verdict:
    """Find out whether an arm can take the shape of a keyframe.

    Args:
        arm: the arm.
        keyframe: the keyframe.
        scene: the obstacles to avoid; None: the arm alone.
        near: the target on a slightly different curve, used as initial guess; None if unknown.
        search: whether to search farther where nothing is found near that, which can take seconds.
    """
    try:
        try:
            target = resolve_keyframe(arm, keyframe, near)
        except TargetError:
            if near is None or not search:
                raise
            target = resolve_keyframe(arm, keyframe)
    except (PostureError, ArithmeticError, np.linalg.LinAlgError) as error:
        return Verdict(None, _explain(error))
    return review(arm, keyframe, target, scene)


def review(arm: Arm, keyframe: Keyframe, target: Target, scene: Scene | None) -> Verdict:
    """Return the verdict on a target that the arm can take; arguments as for `judge`."""
    notes = [*_uncovered_rest(arm, target), *_joints_at_limits(arm, target), *_too_heavy(arm, target)]
    contacts = _contacts(arm, target, scene)
    tip = None if target.q is None else tip_off(keyframe.tip, target, arm.at(target.q))
    return Verdict(target, "", (*contacts, *notes), bool(contacts), target.distance_from_curve(arm), tip)


def _explain(error: Exception) -> str:
    """Put an error in terms of the curve that was drawn."""
    if isinstance(error, TaskError):
        return " ".join(error.reason.split())  # without the keyframe's number, which counts it alone
    if isinstance(error, CurveLeavesTooSharply):
        return "bends too much at the base: the curve leaves in a direction that the first module cannot take"
    if isinstance(error, CurveEndsEarly | CurveBendsTooMuch):
        where = f"at module {error.module}, {length_text(error.parameter)} along the curve"
        if isinstance(error, CurveEndsEarly):
            return f"too short: the curve ends before the arm does, {where}; draw it longer"
        return f"bends too much, {where}: {error.reason}"
    return " ".join(str(error).split())


def _uncovered_rest(arm: Arm, target: Target) -> list[str]:
    if target.curve is None or target.parameters is None:
        return []
    rest = target.curve.length - float(target.parameters[target.has_target].max(initial=0.0))
    if rest <= LIVE_ARM.unreported_rest * float(arm.chain.module_lengths.max()):
        return []
    return [f"the curve is longer than the arm by {length_text(rest)} (its grey part)"]


def _joints_at_limits(arm: Arm, target: Target) -> list[str]:
    if target.q is None:
        return []
    positions = arm.positions(target.q)
    room = np.minimum(positions - arm.limits.lower, arm.limits.upper - positions) / arm.joint_units
    near = room[arm.columns] < LIVE_ARM.near_limit
    names = [name for name, at in zip(arm.chain.input_names, near, strict=True) if at]
    if not names:
        return []
    return [f"at the limit of {enumerated(names, 3)}"]


def _too_heavy(arm: Arm, target: Target) -> list[str]:
    """Say that a joint has not the torque to hold the arm there, if that is known."""
    load = target.load(arm)
    return [str(load)] if load is not None and load.exceeded else []


def _contacts(arm: Arm, target: Target, scene: Scene | None) -> list[str]:
    """Say where the arm would touch an obstacle or itself, or come nearer than the margin."""
    if target.q is None:
        return []
    scene = effective_scene(arm, scene)
    around = obstacles_around(scene, arm.chain.base)
    if around:
        return [f"in collision: {around[0]} stands where the base of the arm is"]
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", PostureWarning)
        closest = CollisionModel(arm, scene).minimum(target.q)
    if closest.pair is None or closest.distance >= scene.margin - CONVERGED * arm.length:
        return []
    body, other = closest.pair
    if closest.distance >= 0.0:
        return [f"nearer than the margin: {body} is {length_text(closest.distance)} from {other}"]
    itself = "" if other in scene.obstacles else " with itself"
    return [f"in collision{itself}: {body} is {length_text(-closest.distance)} inside {other}"]


class VerdictCache:
    """Verdicts of keyframes, for all threads; one is kept for as long as its keyframe exists."""

    def __init__(self) -> None:
        self._lock = Lock()
        self._known: dict[int, tuple[weakref.ref[Keyframe], Arm, Verdict]] = {}

    def judge(
        self,
        arm: Arm,
        keyframe: Keyframe,
        scene: Scene | None,
        near: Target | None = None,
        passing: bool = False,
    ) -> Verdict:
        """Return the verdict on a keyframe as `judge` does; a known one is only reviewed in the scene.

        During a drag there is no long search, and nothing is kept.
        """
        with self._lock:
            reference, judged_arm, verdict = self._known.get(id(keyframe), (None, None, None))
        if verdict is not None and reference is not None and reference() is keyframe and judged_arm is arm:
            return verdict if verdict.target is None else review(arm, keyframe, verdict.target, scene)
        verdict = judge(arm, keyframe, scene, near, not passing)
        if not passing:
            key = id(keyframe)
            known = self._known
            # Called when the keyframe is freed, perhaps while this thread has the lock: pop needs none.
            entry = weakref.ref(keyframe, lambda _: known.pop(key, None)), arm, verdict
            with self._lock:
                known[key] = entry
        return verdict


class Problem(NamedTuple):
    """What is asked of the arm."""

    number: int  # rises with every problem
    arm: Arm
    keyframe: Keyframe  # the keyframe whose shape to take
    controller: Controller  # what moves the arm there
    limits: Limits  # of the motion; the control cycle is the solver's own
    scene: Scene | None  # the obstacles to avoid; None if there are none
    at_once: bool  # whether to jump there, whatever the limits
    asked: float  # when it was asked, by `time.monotonic` [s]
    shaping: bool = False  # whether the shape was made from the one before, so that the target is near
    passing: bool = False  # whether it is from a drag that continues, not worth a long search
    dragging_obstacle: bool = False  # whether it drags an obstacle, of which the scene has the velocity


class Live(NamedTuple):
    """The arm at this moment.

    Attributes:
        number: of the problem that was last judged.
        arm: the arm.
        verdict: what the arm can make of it.
        state: the state of the arm.
        target: where it is going; None if there was nothing yet that it could take.
        errors: distance of each control point from its target, zero where it has none, (m,) [m].
        tip_error: by how much the task of the tip is missed [m]; None without one.
        active: which control points are in the active control set, (m,).
        at_limit: which joints of the chain are at a limit of position or speed, (n,).
        status: as in `Report`.
        reason: why it does not move on, in words.
        lag: from asking to the first step towards it [s]; None before that step.
        steps: number of steps so far.
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
    """Return the distance of each control point from its target, zero where it has none, (m,) [m]."""
    if target is None:
        return np.zeros(len(state.points))
    return target.distances(state.points)


def at_limit(state: ArmState, dq: Array, bound: Array) -> NDArray[np.bool_]:
    """Return which joints of the chain are at a limit.

    Args:
        state: the state of the arm.
        dq: its last step, (nv,) [rad or m].
        bound: the longest step allowed, (nv,) [rad or m].

    Returns:
        For each joint from base to tip, (n,).
    """
    arm = state.arm
    room = np.minimum(state.positions - arm.limits.lower, arm.limits.upper - state.positions)
    fast = np.abs(dq) >= LIVE_ARM.full_speed * bound
    at = (room < LIVE_ARM.near_limit * arm.joint_units) | fast
    return np.asarray(at[arm.columns])


class Solver:
    """Judges the latest problem, and moves the arm to its target until there is another one.

    Args:
        first: the first problem.
        start: the configuration of the arm, (nq,).
        notify: called after each step, in the thread that moves the arm.
        verdicts: the verdicts that are known.
    """

    def __init__(
        self,
        first: Problem,
        start: Array,
        notify: Callable[[], object] = lambda: None,
        verdicts: VerdictCache | None = None,
    ) -> None:
        self._notify = notify
        self._verdicts = VerdictCache() if verdicts is None else verdicts
        self._lock = Lock()
        self._problem = first
        self._tracked = first
        self._tracker = _tracker(first, start)
        self._verdict = Verdict(None)
        self._lag: float | None = None
        self._last_target: tuple[Arm, Target] | None = None
        self._steps = 0
        self._moved = time.monotonic()  # when it moved, arrived, or was asked last [s]
        self._dq = np.zeros(first.arm.nv)
        self._fault = ""
        self._live = self._look(first.arm.at(start))
        self._problems: Latest[Problem, None] = Latest(
            self._pursue, "pinposture-solver", same=lambda before, now: before.number == now.number
        )

    @property
    def live(self) -> Live:
        """The arm after the last step."""
        with self._lock:
            return self._live

    def start(self) -> None:
        """Begin with the first problem."""
        self._problems.ask(self._problem)

    def ask(self, problem: Problem) -> None:
        """Turn to another problem."""
        self._problems.ask(problem)

    def close(self) -> None:
        """End after the current step."""
        self._problems.close()

    def _pursue(self, problem: Problem, outdated: Event) -> None:
        """Turn to a problem, and move the arm until there is another one."""
        begun = time.monotonic()
        self._take(problem)
        self._publish()  # the verdict need not wait for a step that has to be planned
        while True:
            self._step()
            still = self._tracker.report.status in ("converged", "stalled") or self._tracker.target is None
            if still and not self._problem.dragging_obstacle:
                outdated.wait(LIVE_ARM.rest_interval)
            else:  # the arm moves in real time, however often another problem comes
                time.sleep(max(LIVE_ARM.step_time - (time.monotonic() - begun), 0.0))
            if outdated.is_set():
                return
            begun = time.monotonic()

    def _take(self, problem: Problem) -> None:
        """Turn to another problem; if something is wrong with it the verdict says so, and the arm stays."""
        self._problem = problem
        self._lag = None
        self._moved = time.monotonic()
        before = self._tracked
        try:
            self._verdict = self._judge(problem)
            dragging = problem.dragging_obstacle and isinstance(problem.controller, Geodesic)
            same = ("arm", "controller", "limits")
            if not differ_in_weight_alone(problem.arm, before.arm):
                self._change_arm(problem)
            elif dragging and all(getattr(problem, part) == getattr(before, part) for part in same):
                self._tracked = problem  # each step is given the scene of its moment
            elif any(getattr(problem, part) != getattr(before, part) for part in (*same, "scene")):
                target = self._tracker.target
                tracker = _tracker(problem, self._tracker.command, self._dq)
                if target is not None:
                    tracker.update(target)
                self._tracker = tracker
                self._tracked = problem
            if self._verdict.target is not None:
                self._tracker.update(self._verdict.target)
        except PostureError as error:
            self._verdict = Verdict(None, str(error))
        except Exception as error:  # a bug must not end the thread, which others wait for
            logger.exception("a problem could not be judged")
            self._verdict = Verdict(None, f"an internal error ({error})")

    def _change_arm(self, problem: Problem) -> None:
        """Turn to another arm, which begins straight.

        Raises:
            PostureError: it cannot be moved by this controller, in this scene. It then stays straight.
        """
        self._dq = np.zeros(problem.arm.nv)
        start = problem.arm.straight()
        bare = problem._replace(controller=Geodesic(), scene=None)
        self._tracker = _tracker(bare, start)
        self._tracked = bare
        self._tracker = _tracker(problem, start)
        self._tracked = problem

    def _judge(self, problem: Problem) -> Verdict:
        arm = problem.arm
        last = self._last_target
        near = last[1] if last is not None and last[0] is arm and problem.shaping else None
        verdict = self._verdicts.judge(arm, problem.keyframe, problem.scene, near, problem.passing)
        if verdict.target is not None:
            self._last_target = arm, verdict.target
        return verdict

    def _step(self) -> None:
        tracker = self._tracker
        problem = self._problem
        arm = tracker.arm
        target = tracker.target
        try:
            if problem.at_once and target is not None and target.q is not None:
                tracker.restart(target.q)
            self._dq = tracker.step(tracker.command, scene=self._dragged_scene())
            self._fault = ""
        except Exception as error:  # a controller may raise anything
            reason = str(error) or type(error).__name__
            if reason != self._fault:
                logger.warning("the arm is brought to rest: %s", error)
            self._dq = tracker.limits.hold(arm.at(tracker.command), self._dq).dq
            self._fault = reason
            tracker.restart(arm.integrate(tracker.command, self._dq), self._dq)
        self._steps += 1
        if self._lag is None:
            self._lag = time.monotonic() - problem.asked
        self._publish()

    def _dragged_scene(self) -> Scene | None:
        """The scene as it is now, if an obstacle is being dragged."""
        problem = self._problem
        scene = self._problem.scene
        if scene is None or not (problem.dragging_obstacle and problem is self._tracked):
            return None
        age = time.monotonic() - problem.asked
        if age < LIVE_ARM.drag_horizon:
            return scene.after(max(age, 0.0))
        return scene.moved({}, velocities=dict.fromkeys(scene.velocities, (0.0, 0.0, 0.0)))

    def _publish(self) -> None:
        live = self._look(self._tracker.arm.at(self._tracker.command))
        with self._lock:
            self._live = live
        self._notify()

    def _look(self, state: ArmState) -> Live:
        tracker = self._tracker
        problem = self._problem
        report = tracker.report
        target = tracker.target
        active = np.zeros(tracker.arm.n_modules, dtype=np.bool_)
        if report.step is not None:
            active[list(report.step.active)] = True
        status, reason = ("holding", self._fault) if self._fault else (report.status, report.reason)
        if status in ("moving", "converged"):
            self._moved = time.monotonic()
        elif not self._fault and reason != NOT_DONE and time.monotonic() - self._moved < LIVE_ARM.stop_time:
            # it may only be reversing
            status = "moving"
            reason = ""
        return Live(
            number=problem.number,
            arm=tracker.arm,
            verdict=self._verdict,
            state=state,
            target=target,
            errors=errors_of(state, target),
            tip_error=None if target is None else tip_off(problem.keyframe.tip, target, state),
            active=active,
            at_limit=at_limit(state, self._dq, tracker.limits.bound(state)),
            status=status,
            reason=reason,
            lag=self._lag,
            steps=self._steps,
        )


def _tracker(problem: Problem, q: Array, dq: Array | None = None) -> Tracker:
    """Return a tracker that moves the arm from q, at rest or after a step dq, (nv,) [rad or m]."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", PostureWarning)  # the status reports it
        tracker = Tracker(
            problem.arm,
            problem.controller,
            limits_per_step(problem.limits),
            problem.scene,
            feedback_time_constant=float("inf"),
            deadline=LIVE_ARM.deadline,
            planning="thread",  # several trackers a second are made while an obstacle is dragged
        )
    tracker.restart(q, dq)  # keeps the speed: a dragged obstacle causes several new trackers a second
    return tracker


def limits_per_step(limits: Limits) -> Limits:
    """Return the same limits for cycles of `LIVE_ARM.step_time`; a limit of the step is scaled to that."""
    if limits.step is None or limits.dt is None:
        return replace(limits, dt=LIVE_ARM.step_time)
    return replace(limits, dt=LIVE_ARM.step_time, step=limits.step * (LIVE_ARM.step_time / limits.dt))
