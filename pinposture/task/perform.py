"""Performing a motion: the arm follows a reference, and the plan waits where necessary."""

from __future__ import annotations

import logging
from collections import deque
from collections.abc import Callable, Sequence
from dataclasses import replace
from math import ceil
from typing import Literal, NamedTuple, cast

import numpy as np
from numpy.typing import ArrayLike, NDArray

from pinposture._validation import make_read_only, require_function, require_instance, require_positive
from pinposture.arm import Arm
from pinposture.arm.configurations import SLACK
from pinposture.collision import Scene
from pinposture.control import Controller, Geodesic, Limits, Step
from pinposture.control.limits import CYCLES, JerkFilter, cycle_of
from pinposture.control.planner.follow import GeodesicMemory
from pinposture.control.planner.objective import Objective
from pinposture.control.planner.path import PATH, JointPath, SpeedProfile, TimedPath, retime
from pinposture.control.torque_limits import require_held
from pinposture.errors import InvalidValue
from pinposture.motion.arrival import STALL
from pinposture.motion.held import HeldObject
from pinposture.motion.loop import RecordedLoop, in_scene
from pinposture.motion.run import Run
from pinposture.motion.trajectory import Trajectory, WaypointResult
from pinposture.placement import Target
from pinposture.placement.target import known_target
from pinposture.task.keyframe import Keyframe, as_keyframes, placed
from pinposture.task.keyframes import keyframe_reference
from pinposture.task.reference import (
    Reference,
    Way,
    Waypoint,
    off_curve,
    require_held_postures,
    require_passage,
    tip_off,
)
from pinposture.units import CONVERGED, length_text

Array = NDArray[np.float64]

Progress = Callable[[float, float], object]

logger = logging.getLogger(__name__)


class PerformSettings(NamedTuple):
    """When the plan waits for the arm, slows down, or is given up."""

    max_mean_lag: float = 0.1
    """Mean distance of the control points from their targets, in module lengths, beyond which the plan
    waits for a controller that does not look ahead, and beyond which a named posture is missed."""

    row_tolerance: float = 1e-9
    """Distance before a row at which it counts as reached, in rows."""

    max_cycles: float = 1e6
    """Largest number of cycles of a motion."""

    step_budget_ratio: float = 10.0
    step_budget_extra: int = 3000
    """Number of steps after which a motion is given up: a multiple of the expected number, plus an
    extra."""

    waypoint_share: float = 0.6
    """Share of `max_mean_lag` by which a jerk limit may lead the arm past a waypoint."""

    max_slowdowns: int = 10
    slowdown_margin: float = 1.02
    """Number of attempts to pass all waypoints closely enough, and the factor by which each slows down more
    than the error requires."""

    held_rounding: float = 1e-12
    """Motion from one row to the next that counts as none [rad or m]."""


PERFORM = PerformSettings()


STOPPED = "stopped by the callback"


class ReferencePath:
    """A reference as a path that can be followed at any speed; s on it is a row, not only a whole one.

    Args:
        reference: the reference.
        limits: the limits of a step, with dt.

    Attributes:
        reference: the reference.
        end: the last s.
        times: planned time of each of its rows, (N + 1,) [s].
        path: its configurations as a path through joint space, within the position limits.
        timed: the path at the largest speed that limits and waypoints allow, up to that of the plan, and
            slower where a jerk limit would lead the arm past a waypoint.

    Raises:
        InvalidValue: limits so tight that it would take too many cycles.
    """

    def __init__(self, reference: Reference, limits: Limits) -> None:
        arm = reference.arm
        bounds = limits.for_arm(reference.arm)
        self.reference = reference
        self.times = reference.times
        self._rows = np.arange(reference.rows, dtype=np.float64)
        self._dt = cycle_of(limits)
        self._weights = reference.weights.astype(np.float64)
        make_read_only(self._weights)
        self._start = arm.positions(reference.start)
        self._lower, self._upper = bounds.position_limits - self._start
        offsets = np.minimum(np.maximum(reference.offsets, self._lower), self._upper)
        # Joints that do not move the arm stay where they are.
        offsets = np.ascontiguousarray(offsets * (arm.moved > 0.0))
        q = arm.integrate(reference.start, offsets[0])
        first = Target(arm.chain_at(q).points, reference.weights[0], q)
        self.path = JointPath(Objective(arm, first), reference.start, offsets).within(bounds.position_limits)
        self.end = self.path.end
        self._limits = limits
        durations = reference.interval if reference.durations is None else reference.durations
        self._rates = np.full(reference.rows - 1, self._dt / durations)
        self._retime()
        cycles = JerkFilter(arm, limits).cycles
        if any(waypoint.speed < 1.0 for waypoint in reference.waypoints):
            self._limit_speeds(0)
            self._limit_speeds(1 + cycles // 2)  # averaged steps lie on both sides of a waypoint
        self._slow_down_at_marks(cycles)

    def _retime(self) -> None:
        self.timed = retime(self.path, self._limits, self._rates)
        self._profile = cast(SpeedProfile, self.timed.profile)  # there is one for finite rates
        if self.steps > PERFORM.max_cycles:
            most = f"{PERFORM.max_cycles:g}"
            allowed = f"limits under which it takes at most {most} cycles, or a plan that asks for less"
            raise InvalidValue("cycles of the motion", round(self.steps), allowed)

    def _limit_speeds(self, beside: int) -> None:
        """Lower the rates to the speeds of the waypoints, for so many cycles also before and after."""
        before = self.path.slopes[:-1]
        after = self.path.slopes[1:]
        middle = 3.0 * np.diff(self.path.offsets, axis=0) - before - after
        slopes = np.abs([before, middle, after]).max(axis=0)  # the slope in between is in their hull
        bound = PATH.speed_share * self.timed.bounds.bound
        full = np.maximum((slopes / bound).max(axis=1), PERFORM.row_tolerance)  # cycles per row at full speed
        begin = 0
        s = self.timed.s
        for waypoint in self.reference.waypoints:
            if waypoint.speed < 1.0:
                cycles = np.searchsorted(s, (begin, waypoint.row)) + (-beside, beside)
                first, last = s[np.clip(cycles, 0, len(s) - 1)]
                piece = slice(min(int(first), begin), max(ceil(last), waypoint.row))
                self._rates[piece] = np.minimum(self._rates[piece], waypoint.speed / full[piece])
            begin = waypoint.row
        self._retime()

    def _slow_down_at_marks(self, cycles: int) -> None:
        """Lower the rates at waypoints that the arm would miss if its steps are averaged over so many cycles.

        The arm is then at the mean of as many configurations. Its distance from the path is
        proportional to the square of the rate.
        """
        offsets = self.path.offsets
        module = self.path.arm.length / self.path.arm.n_modules
        moving = np.flatnonzero(np.any(np.abs(np.diff(offsets, axis=0)) > PERFORM.held_rounding, axis=1))
        for _ in range(PERFORM.max_slowdowns if cycles > 1 else 0):
            s = np.pad(self.timed.s, (cycles - 1, cycles), mode="edge")
            slower = False
            passed = np.cumsum(np.append(0.0, s))
            means = (passed[cycles:] - passed[:-cycles]) / cycles
            for waypoint in self.reference.waypoints:
                left = moving[np.searchsorted(moving, waypoint.row) :]
                middle = 0.5 * (waypoint.row + left[0]) if len(left) else self.end  # of the time it is held
                after = int(np.searchsorted(means, middle))
                if not 0 < after < len(means):
                    continue
                share = (middle - means[after - 1]) / (means[after] - means[after - 1])
                averaged = s[after - 1 : after + cycles]
                averaged = (1.0 - share) * averaged[:-1] + share * averaged[1:]
                allowed = PERFORM.waypoint_share * PERFORM.max_mean_lag * module
                excess = self._distance(averaged, middle) / allowed
                if excess > 1.0:
                    ratio = PERFORM.slowdown_margin * np.sqrt(excess)
                    slower = True
                    first, last = middle + (averaged[[0, -1]] - middle) / ratio
                    piece = slice(int(first), ceil(last))
                    rate = (averaged[-1] - averaged[0]) / (cycles - 1) / ratio
                    self._rates[piece] = np.minimum(self._rates[piece], rate)
            if not slower:
                break
            self._retime()

    def _distance(self, averaged: Array, s: float) -> float:
        """Return the mean distance of the control points at a mean of configurations from those at s [m]."""
        arm = self.path.arm
        target = self.target(s)
        q = arm.integrate(self.path.start, self.path.smooth_offset(averaged).mean(axis=0))
        return target.mean_distance(arm.chain_at(q).points)

    @property
    def steps(self) -> float:
        """Smallest possible number of cycles."""
        return self._profile.steps

    def is_within_limits(self, row: int) -> bool:
        """Whether the path goes through a row of the reference, which the position limits may prevent."""
        offset = self.reference.offsets[row] * (self.reference.arm.moved > 0.0)
        return bool(np.abs(offset - self.path.offsets[row]).max() <= SLACK)

    def time(self, s: float | Array) -> Array:
        """Return the planned time at s, or at several [s]."""
        return np.asarray(np.interp(s, self._rows, self.times))

    def cycles(self, s: float, row: int) -> int:
        """Return the planned number of cycles from s to a row."""
        return ceil((float(self.times[row]) - float(self.time(s))) / self._dt - PERFORM.row_tolerance)

    def next(self, s: float, speed: float) -> float:
        """Return s after the next cycle; the previous one advanced by `speed`."""
        return min(s + self._profile.next(s, speed), self.end)

    def target(self, s: float) -> Target:
        """Return the target posture at s."""
        arm = self.reference.arm
        row = min(int(np.ceil(s)), len(self.times) - 1)
        offset = np.minimum(np.maximum(self.path.smooth_offset(s), self._lower), self._upper)
        points = arm.kinematics.points(self._start + offset[None])
        q = arm.integrate(self.reference.start, offset)
        points.flags.writeable = False
        q.flags.writeable = False
        return known_target(arm, Target(points[0], self._weights[row], q))

    def remaining(self, s: float, controller: Geodesic) -> TimedPath:
        """Return the rest of the path from s, which is a whole row."""
        row = int(s)
        path = self.path
        objective = controller.objective(path.arm, self.target(s))
        if row == 0:
            return retime(path.revised(objective=objective), self.timed.limits, self._rates)
        offsets = path.offsets[row:] - path.offsets[row]
        rest = JointPath(objective, path.configuration(row), offsets, controller.scene)
        return retime(rest, self.timed.limits, self._rates[row:])

    def next_waypoint(self, s: float) -> Waypoint:
        """Return the next waypoint; the last row if there is none."""
        last = self.reference.rows - 1
        ahead = [waypoint for waypoint in self.reference.waypoints if waypoint.row > s]
        return ahead[0] if ahead else Waypoint("the end", last, self.target(float(last)))


def perform(
    reference: Reference,
    controller: str | Controller = "geodesic",
    limits: Limits | None = None,
    scene: Scene | None = None,
    q0: ArrayLike | None = None,
    tolerance: float | None = None,
    progress: Progress | None = None,
    *,
    strict: bool = True,
) -> Trajectory:
    """Move an arm along a reference, within its limits.

    The arm first moves to the start of the reference, unless it is there. Then the plan advances in real
    time where the limits allow it, and more slowly elsewhere. "geodesic" looks ahead: it slows down early
    enough and follows the path of the reference; where an obstacle blocks it, it plans its own path to the
    next waypoint. Other controllers get a moving target, which waits for them when they fall behind.

    Args:
        reference: the planned motion.
        controller: as for `track`.
        limits: limits of a step, with `dt`, the duration of a control cycle; cycles of 20 ms and the velocity
            limits of the arm if None.
        scene: as for `track`.
        q0: initial configuration, (nq,); that of the reference if None.
        tolerance: as for `track`, for the first and the last posture.
        progress: called in each cycle with the time and the duration of the plan [s]; the motion stops if it
            returns True.
        strict: whether a start, or a named posture, that the motors cannot hold within torque limits of
            `limits` is refused. If not, the motion goes on, and its `faults` say so.

    Returns:
        The motion. `run.status` is "converged" if the arm took all named postures, "missed" if it passed one
        of them at a mean distance of more than a tenth of a module and half a cycle's motion, else as for
        `track`; `time_scale` is its duration relative to the plan.

    Raises:
        InvalidValue: limits without dt, or so tight that it would never end; an invalid q0 or tolerance; a
            posture that cannot be held.
        UnknownName: no controller of that name.
        WeightUnknown: torque limits, and masses, or all limits of the arm, are not known.
    """
    require_instance("reference", reference, Reference, "a Reference, as `keyframe_reference` returns it")
    require_function("progress", progress)
    arm = reference.arm
    controller, scene = in_scene(controller, scene)
    limits = Limits(step=None, dt=CYCLES.default) if limits is None else limits
    dt = cycle_of(limits)
    tolerance = CONVERGED * arm.length if tolerance is None else require_positive("tolerance", tolerance)
    start = arm.checked(reference.start, "reference.start") if q0 is None else arm.checked_start(q0, "q0")
    require_instance("strict", strict, bool, "True or False")
    if strict and limits.effort is not None:
        if q0 is not None:
            require_held(arm, start, limits, "q0")
        require_held_postures(reference, limits)
    require_passage(reference, scene, PERFORM.max_mean_lag * arm.length / arm.n_modules)
    guide = ReferencePath(reference, limits)
    loop = RecordedLoop(arm, start, guide.target(0.0), controller, limits, scene)
    performance = _Performance(guide, loop, tolerance, progress, scene)
    motion = performance.trajectory(*performance.run())
    status = motion.run.status
    reason = motion.run.reason
    logger.info("%s: %s after %.4g s: %s", controller.name, status, dt * motion.steps, reason)
    return motion


def move_through(
    arm: Arm,
    keyframes: Sequence[Keyframe],
    controller: str | Controller = "geodesic",
    limits: Limits | None = None,
    scene: Scene | None = None,
    *,
    q0: ArrayLike | None = None,
    continuity: Literal["velocity", "acceleration"] = "velocity",
    repeat: int = 1,
    strict: bool = True,
) -> Trajectory:
    """Move through keyframes at their times: `keyframe_reference` and `perform` in one call.

    Args:
        arm: the arm.
        keyframes: the keyframes, in order. By default, curves stay as drawn if the scene has obstacles.
        controller: as for `track`.
        limits: as for `perform`.
        scene: as for `track`.
        q0: initial configuration, (nq,); that of the first keyframe if None.
        continuity: as for `keyframe_reference`.
        repeat: likewise.
        strict: as for `perform`.

    Returns:
        The motion.

    Raises:
        PostureError: as those two.
    """
    limits = Limits(step=None, dt=CYCLES.default) if limits is None else limits
    require_instance("scene", scene, Scene | None, "a Scene(...), or None")
    keyframes = placed(as_keyframes(keyframes), scene)
    reference = keyframe_reference(arm, keyframes, cycle_of(limits), continuity, repeat=repeat, limits=limits)
    return perform(reference, controller, limits, scene, q0, strict=strict)


class _Performance:
    """A motion in progress: s on the reference and the target after each step."""

    def __init__(
        self,
        guide: ReferencePath,
        loop: RecordedLoop,
        tolerance: float,
        progress: Progress | None,
        scene: Scene | None,
    ) -> None:
        self._scene = scene if guide.reference.held else None
        self._stage = 0
        self.guide = guide
        self.loop = loop
        self.tolerance = tolerance
        self.progress = progress
        self._max_steps = PERFORM.step_budget_extra + int(PERFORM.step_budget_ratio * guide.steps)
        self._max_lag = PERFORM.max_mean_lag * loop.arm.length / loop.arm.n_modules
        self._latest: deque[float] = deque(maxlen=loop.filter.cycles)
        self._set_s(0.0)
        self._s_after = [0.0]
        self._targets = [guide.target(0.0)]
        self._start_index: int | None = None  # None until the first posture is reached
        self._notes: list[str] = []

    def _set_s(self, s: float) -> None:
        """Set s of an arm at rest."""
        self._s = s
        self._latest.extend([s] * self.loop.filter.cycles)

    def _advance(self, s: float) -> float:
        """Set s of the arm ahead; return that of the arm itself, which a jerk limit delays."""
        self._s = s
        self._latest.append(s)
        return s if len(self._latest) == 1 else sum(self._latest) / len(self._latest)

    def run(self) -> tuple[str, str]:
        """Move to the first posture, along the reference, and to rest; return status and reason."""
        status, reason = self._go_to(0.0)
        if status != "converged":
            return status, f"on the way to the first posture: {reason}"
        self._start_index = len(self._s_after) - 1
        controller = self.loop.controller
        ended = self._look_ahead() if isinstance(controller, Geodesic) else self._lead()
        return self._go_to(self.guide.end) if ended is None else ended

    def trajectory(self, status: str, reason: str) -> Trajectory:
        """Return everything so far as a result; "missed" if only the last of its postures was reached."""
        reference = self.guide.reference
        loop = self.loop
        s = np.array(self._s_after)
        run = loop.record.run(loop.arm, loop.controller, loop.limits, status, reason)
        run = replace(run, held=self._held(s))
        nexts = [*(waypoint.row for waypoint in reference.waypoints[1:]), np.inf]
        results = tuple(
            self._result(waypoint, until, s, run)
            for waypoint, until in zip(reference.waypoints, nexts, strict=False)
        )
        if status == "converged" and any(result.missed for result in results):
            reason = f"{self._describe_missed(results)}; at the end, {run.reason}"
            run = replace(run, status="missed", reason=reason)
        return Trajectory(
            run=run,
            targets=np.array([target.points for target in self._targets]),
            target_mask=np.array([target.weights for target in self._targets]) > 0.0,
            plan_time=self.guide.time(s),
            start_index=len(s) - 1 if self._start_index is None else self._start_index,
            planned=float(self.guide.times[-1]),
            waypoints=results,
            deviations=tuple(self._notes),
        )

    def _held(self, s: Array) -> tuple[HeldObject, ...]:
        """Return what the arm held, in rows of the motion, given s in each."""
        planned = self.guide.reference.held
        rows = [np.searchsorted(s, (part.begin, part.end)).tolist() for part in planned]
        return tuple(
            replace(part, begin=begin, end=end)
            for part, (begin, end) in zip(planned, rows, strict=True)
            if begin < end
        )

    def _result(self, waypoint: Waypoint, until: float, s: Array, run: Run) -> WaypointResult:
        """Return how a waypoint was passed, before the next one, which is at `until`.

        That is at the first step at which the arm is near it; at the step nearest in time if it never is.
        """
        reference = self.guide.reference
        begun = self._start_index
        moved = waypoint.target.moved
        planned = float(self.guide.times[waypoint.row])
        off = off_curve(waypoint)
        there = np.flatnonzero(s[begun:] >= waypoint.row - PERFORM.row_tolerance)
        if begun is None or not len(there):
            never = WaypointResult(waypoint.name, planned, None, None, None, off)
            return never._replace(moved=moved, speed=waypoint.speed)
        row = begun + int(there[0])
        if row > begun and waypoint.row - s[row - 1] < s[row] - waypoint.row:
            row -= 1
        end = max(row + 1, begun + int(np.searchsorted(s[begun:], until - PERFORM.row_tolerance)))
        chosen = waypoint.target.has_target
        first = max(row - 1, 0)
        points = run.points[first : end + 1]
        errors = waypoint.target.distances(points)[:, chosen].mean(axis=1)
        steps = np.linalg.norm(np.diff(points[:, chosen], axis=0), axis=2).mean(axis=1)
        allowed = self._max_lag + 0.5 * np.maximum(np.append(0.0, steps), np.append(steps, 0.0))
        near = (errors <= allowed)[row - first : end - first]
        row = row + int(np.argmax(near))
        missed = not np.any(near)
        reached = (row - begun) * cycle_of(run.limits)
        error = float(errors[row - first])
        tip = tip_off(waypoint.tip, waypoint.target, reference.arm.at(run.q[row]))
        if waypoint.way is not None:
            since = max([other.row for other in reference.waypoints if other.row < waypoint.row], default=0)
            first = begun + int(np.searchsorted(s[begun : row + 1], since))
            off = waypoint.way.distance(run.q[min(first, row) : row + 1])
            missed = missed or off > self._max_distance(waypoint.way)
        return WaypointResult(
            waypoint.name, planned, reached, row, error, off, tip, moved, waypoint.speed, missed
        )

    def _max_distance(self, way: Way) -> float:
        """Return the largest accepted distance of the arm from its path [m]."""
        return way.planned + self._max_lag

    def _describe_missed(self, results: tuple[WaypointResult, ...]) -> str:
        """Say which named postures the arm passed at a distance, and why if that is known."""
        for waypoint, result in zip(self.guide.reference.waypoints, results, strict=True):
            off = result.off_curve or 0.0
            if waypoint.way is not None and result.missed and off > self._max_distance(waypoint.way):
                most = length_text(self._max_distance(waypoint.way))
                allowed = f"planned: {length_text(waypoint.way.planned)}, allowed: {most}"
                left = f"the arm left its path by {length_text(off)}"
                return f"{left} on the way to {waypoint.name} ({allowed})"
        missed = [result for result in results if result.missed]
        worst = max(missed, key=lambda result: result.mean_error or 0.0)
        one = len(missed) == 1
        number = f"{len(missed)} of {len(results)} postures"
        text = f"{number} {'is' if one else 'are'} missed, {'' if one else 'most '}{worst.name}, by "
        text += f"{length_text(worst.mean_error or 0.0)} on average (allowed: {length_text(self._max_lag)})"
        row = self.guide.reference.waypoints[results.index(worst)].row
        if not self.guide.is_within_limits(row):
            text += "; it is outside the joint limits, or within their position margin"
        return text

    def _go_to(self, s: float, due: int = 0) -> tuple[str, str]:
        """Come to rest at s, by any path, not before step `due`; return status and reason."""
        target = self.guide.target(s)
        loop = self.loop
        record = loop.record
        begun = record.steps
        record.set_target(target)
        most = begun + PERFORM.step_budget_extra + int(PERFORM.step_budget_ratio * self._cycles_to(target))
        ended = loop.run(target, self.tolerance, most, lambda *_: self._report())
        loop.brake_to_rest()
        while ended[0] == "converged" and record.steps < due:
            loop.brake()
            if self._report():
                ended = "stopped", STOPPED
        if ended[0] == "converged":
            self._set_s(s)
            if self._scene is not None:
                self._enter_stage(s, self._scene)
        self._fill(self._s, target)
        self._max_steps += record.steps - begun
        return ended

    def _cycles_to(self, target: Target) -> float:
        """Estimate the number of cycles of a straight path to a target in joint space."""
        loop = self.loop
        bounds = loop.limits.for_arm(loop.arm)
        q = loop.state.q
        distance = np.abs(loop.arm.difference(q, q if target.q is None else target.q))
        braking = 0.0 if bounds.brake is None else 2.0 * np.sqrt(distance / bounds.brake)
        return float((distance / bounds.bound + braking).max())

    def _report(self) -> bool:
        """Report progress; return whether to stop."""
        if self.progress is None:
            return False
        guide = self.guide
        return self.progress(float(guide.time(self._s)), guide.reference.duration) is True

    def _record(self, s: float, target: Target) -> tuple[str, str] | None:
        """Record s after a step; return status and reason if the motion ends there."""
        self._s_after.append(s)
        self._targets.append(target)
        if self._scene is not None:
            self._enter_stage(s, self._scene)
        ended = None
        if self.progress is not None and self._report():
            ended = "stopped", STOPPED
        elif self.loop.record.steps > self._max_steps:
            seconds = float(self.guide.time(s))
            ended = "max_steps", f"still at {seconds:.4g} s of the plan after {self._max_steps} cycles"
        if ended is not None:
            self.loop.brake_to_rest()
            self._fill(s, target)
        return ended

    def _enter_stage(self, s: float, scene: Scene) -> None:
        """Go on in the scene of s, if what the arm holds changes there."""
        stages = self.guide.reference.stages
        stage = stages.number(s)
        if stage != self._stage:
            self._stage = stage
            self.loop.enter(stages.scene(stage, scene))

    def _fill(self, s: float, target: Target) -> None:
        """Record the steps towards a target during which the plan did not advance."""
        missing = self.loop.record.steps + 1 - len(self._s_after)
        self._s_after += [self._s_after[-1]] * missing
        self._targets += [target] * missing
        self._s_after[-1] = s

    def _note(self, s: float, text: str) -> None:
        """Record a deviation from the plan."""
        self._notes.append(f"at {float(self.guide.time(s)):.4g} s of the plan {text}")

    def _look_ahead(self) -> tuple[str, str] | None:
        """Follow the path with a controller that knows it; return None at its end, else status and reason."""
        loop = self.loop
        guide = self.guide
        while self._s < guide.end:
            begun = self._s
            progress = None
            controller = cast(Geodesic, loop.controller)
            remaining = guide.remaining(begun, controller)
            waypoint = guide.next_waypoint(begun)
            loop.memory = controller.start(remaining, loop.ahead.chain_state, loop.memory)
            while self._s < guide.end:
                foreseen = guide.next(self._s, 0.0 if progress is None else progress.speed)
                target = guide.target(foreseen)
                step = loop.compute(target)
                ahead = step.memory.progress if isinstance(step.memory, GeodesicMemory) else None
                if ahead is None or not ahead.timed.scheduled:
                    break
                if step.reason and not ahead.arrived:
                    break
                if begun + ahead.s >= waypoint.row:
                    if self._leaves_path(step, begun + ahead.s):
                        break
                    waypoint = guide.next_waypoint(begun + ahead.s)
                progress = ahead
                s = self._advance(begun + ahead.s)
                target = target if s == foreseen else guide.target(s)
                loop.take(step, target)
                ended = self._record(s, target)
                if ended is not None:
                    return ended
            else:
                return self._catch_up()
            loop.refuse(step)
            waypoint = guide.next_waypoint(self._s)
            left = self._s
            # A shorter path does not advance the plan faster.
            due = loop.record.steps + guide.cycles(self._s, waypoint.row)
            status, reason = self._go_to(float(waypoint.row), due)
            if status != "converged":
                self._note(left, f"the arm left the path, and did not reach {waypoint.name} by another")
                return status, f"on the way to {waypoint.name}: {reason}"
            self._note(left, f"the arm left the path, and reached {waypoint.name} by another")
        return None

    def _leaves_path(self, step: Step, s: float) -> bool:
        """Whether the arm is off the path after a step to s, so that it would miss a waypoint there."""
        target = self.guide.target(s)
        points = self.loop.ahead.moved(step.dq).chain_state.points
        apart = target.mean_distance(points)
        share = 1.0 - PERFORM.waypoint_share if self.loop.filter.active else 1.0
        return bool(apart > self._max_lag * share)

    def _catch_up(self) -> tuple[str, str] | None:
        """Let an arm that a jerk limit delays come to the end of the path; as `_look_ahead`."""
        ended = None
        while ended is None and self.loop.filter.moving:
            s = self._advance(self._s)
            target = self.guide.target(s)
            self.loop.record.set_target(target)
            self.loop.brake()
            ended = self._record(s, target)
        return ended

    def _lead(self) -> tuple[str, str] | None:
        """Move the target of a controller that does not look ahead; the plan waits if it falls behind."""
        loop = self.loop
        guide = self.guide
        speed = 0.0
        patient = True
        target = guide.target(self._s)
        while self._s < guide.end:
            s = self._s
            behind = loop.record.mean_error > self._max_lag
            if behind and patient and loop.record.travel_without_progress() >= STALL.travel:
                error = loop.record.mean_error
                self._note(s, f"the arm was {length_text(error)} behind on average, and did not catch up")
                patient = False
            if behind and patient:
                speed = 0.0
            else:
                patient = patient or not behind
                s = guide.next(s, speed)
                speed = s - self._s
                target = guide.target(s)
            s = self._advance(s)
            shown = target if s == self._s else guide.target(s)
            if not (behind and patient):
                loop.record.set_target(shown)
            step = loop.compute(target)
            if step.reason:
                loop.refuse(step)
                loop.brake()
            else:
                loop.take(step)
            ended = self._record(s, shown)
            if ended is not None:
                return ended
        return None
