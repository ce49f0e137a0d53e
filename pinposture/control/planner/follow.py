"""Third stage of the planner: one step along a timed path, within limits and clear of obstacles."""

from __future__ import annotations

from dataclasses import dataclass, replace
from math import inf, isfinite
from typing import NamedTuple, cast

import numpy as np
from numpy.typing import NDArray

from pinposture import kernels
from pinposture._validation import require_instance
from pinposture.arm import Arm, ArmState, ChainState
from pinposture.arm.arm import arm_of
from pinposture.collision import Scene
from pinposture.control.controller import Memory, Step, checked_limits
from pinposture.control.limits import (
    CYCLES,
    JointBounds,
    Limits,
    StepBounds,
    farthest,
)
from pinposture.control.planner.avoidance import Avoidance
from pinposture.control.planner.damped_least_squares import (
    DESCENT,
    POSTURE_SEARCH,
    StepConstraints,
    correct_curvature,
    damped_hessian,
    mean_diagonal,
    reduce_errors,
    solve_posture,
    solve_priority,
    solve_remaining,
)
from pinposture.control.planner.goal import find_positions_near
from pinposture.control.planner.objective import OBJECTIVE, ChainSolver, LinearRows, Objective
from pinposture.control.planner.path import PATH, JointPath, TimedPath, time_path
from pinposture.control.tasks import Displaced, errors_of
from pinposture.control.torque_limits import StepTorques
from pinposture.errors import InvalidValue
from pinposture.kernels.arrays import FULL_TURN, NextSteps, PathMotion, PathTolerances, PointGoals, StepArrays
from pinposture.placement import Target
from pinposture.quadratic_program import Solution
from pinposture.units import CONVERGED, ROUNDING, length_text

Array = NDArray[np.float64]


class FollowingSettings(NamedTuple):
    """How a path is followed, and when a step counts as progress on it."""

    most_deviation: float = 0.05
    """Joint motion between measured and expected configuration beyond which the path is replanned, in
    `Arm.joint_units`."""

    progress_share: float = 0.005
    """Share of a path that counts as progress for an arm that is held back."""

    error_rounding: float = 1e-12
    """Increase of the posture error that is attributed to rounding, in arm lengths."""

    steps_ahead: int = 8
    """Number of steps on a path that are computed in one call."""

    attempts: int = 8
    """How often the damping is increased for a step that fails to reduce the errors, before none is
    taken."""

    bound_slack: float = 1e-12
    """Rounding error of a step, in `Arm.joint_units`; steps are clipped at their limits anyway."""

    negligible_error: float = 1e-13
    """Error that is attributed to rounding and not reduced further, in arm lengths."""

    standing_share: float = 0.05
    """Step beside resting obstacles, relative to the one towards its place on the path, below which an arm
    off its path does not come back to it: steps become ever shorter. Of 53 motions off their paths two arrive
    sooner by it, one after 249 cycles, not 280; the others are the same."""

    most_lag: float = 0.5
    """Share of a step by which an arm may lag behind its position on the path and still count as making
    progress, however short the step that its slowest joint allows."""

    most_pursued_motion: float = 0.5
    """Joint motion to a moving target up to which the joints move there directly, in `Arm.joint_units`."""

    most_untimed_bend: float = 1e-3
    """Displacement of the end of a path beyond which the path is retimed, in `Arm.joint_units`."""

    task_deviation: float = 0.1
    """Largest deviation of the errors of tasks with priority from straight ones, relative to their
    change. Of 36 paths most deviate by up to 0.5 % of it, and some by 3 % where the arm is almost
    singular, where a correction takes long motions. A task that is held has no change, so it is held."""


FOLLOWING = FollowingSettings()


PATH_TOLERANCES = PathTolerances(
    disturbed=FOLLOWING.most_deviation,
    arrived=ROUNDING,
    rounding=ROUNDING,
    max_motion=PATH.most_step,
)
"""Tolerances of the steps that a kernel computes ahead."""


class StepsAhead(NamedTuple):
    """The next steps on a path, valid while the arm follows them exactly.

    Attributes:
        bounds: the limits that they keep.
        s: position on the path after each step, in waypoints, k numbers.
        errors: sum of the distances of the control points from their targets before the first step and after
            each, s + 1 numbers [m].
        dq: the steps, (s, nv) [rad or m].
        reached: joint positions after each step, (s, nv) [rad or m].
        at_limit: which joints are then at a position limit, (s, nv).
        stopping: steps that stop the arm after the last one within torque limits, (k, nv) [rad or m]; None if
            they are not known.
    """

    bounds: JointBounds
    s: list[float]
    errors: list[float]
    dq: Array
    reached: Array
    at_limit: NDArray[np.bool_]
    stopping: Array | None = None


class DeadEnd(NamedTuple):
    """A state at the end of a path from which no step reduces the errors.

    Attributes:
        objective: the objective.
        cost: half the sum of squares that remains [m^2].
        constraints: those of the step that was sought.
        solution: the last one that was tried; None if there is nothing to reduce.
        reason: why the arm does not move; empty if it has to.
    """

    objective: Objective
    cost: float
    constraints: StepConstraints
    solution: Solution | None
    reason: str


class PathProgress(NamedTuple):
    """A path, and the position of the arm on it.

    Attributes:
        timed: the path with its time parameterization.
        objective: what the steps pursue; that of the path, until the target moves along it.
        s: position of the arm on it, in waypoints.
        speed: motion along it in the last step, in waypoints.
        progress_s: position at which the arm last made progress.
        idle_travel: joint travel that the limits have allowed in steps held back since then [rad].
        arrived: whether the arm is at the end; the remaining errors are then reduced directly.
        damping: damping factor of these steps.
        expected: expected joint positions, (nv,) [rad or m]; None before the first step.
        bend: displacement of the end of the path since it was planned, (nv,) [rad or m]; None: none.
        timed_bend: displacement of the end when the path was timed; None: none.
        ahead: the next steps, if already computed.
        taken: number of those steps that have been taken.
        dead_end: where the last search for a step at the end of the path found none; None: it found one.
    """

    timed: TimedPath
    objective: Objective
    s: float = 0.0
    speed: float = 0.0
    progress_s: float = 0.0
    idle_travel: float = 0.0
    arrived: bool = False
    damping: float = 1.0
    expected: Array | None = None
    bend: Array | None = None
    timed_bend: Array | None = None
    ahead: StepsAhead | None = None
    taken: int = 0
    dead_end: DeadEnd | None = None

    @property
    def path(self) -> JointPath:
        """The path."""
        return self.timed.path

    def moved_to(
        self,
        s: float,
        travel: float,
        held_back: bool,
        expected: Array | None = None,
        ahead: StepsAhead | None = None,
        taken: int = 0,
    ) -> PathProgress:
        """Return the progress after a step.

        Args:
            s: the end of the step.
            travel: joint travel that the limits allow in it [rad].
            held_back: whether it is shorter than the limits or the profile allow. Any other step is no
                lack of progress, however short; but only a share of the path makes up for those held back.
            expected: expected joint positions after it, (nv,) [rad or m]; None if unknown.
            ahead: the next steps, if already computed.
            taken: number of those steps that have been taken.
        """
        idle = s < self.progress_s + FOLLOWING.progress_share * self.timed.path.end
        waited = travel if held_back else 0.0
        return PathProgress(  # faster than `_replace`, and called in nearly every cycle
            self.timed,
            self.objective,
            s,
            s - self.s,
            self.progress_s if idle else s,
            self.idle_travel + waited if idle else 0.0,
            self.arrived,
            self.damping,
            expected,
            self.bend,
            self.timed_bend,
            ahead,
            taken,
        )

    def matches(self, state: ChainState) -> bool:
        """Whether the arm is close enough to its expected position to stay on the path."""
        arm = self.objective.arm
        if arm is not state.arm or self.expected is None:
            return arm is state.arm
        chain = arm.kinematics
        units = self.timed.bounds.units
        away = kernels.joint_distance(self.expected, state.raw_positions, chain.endless, chain.columns, units)
        return away <= FOLLOWING.most_deviation

    def is_expected(self, state: ChainState) -> bool:
        """Whether the arm is at its expected position, up to rounding."""
        if self.expected is None:
            return False
        off = state.raw_positions - self.expected
        return bool(off.dot(off) <= FOLLOWING.bound_slack**2)

    def can_stop(self, state: ChainState) -> bool:
        """Whether an arm that moves on a path timed within torque limits can stop on it."""
        if self.timed.torques is None or self.arrived or not self.speed > 0.0 or self.path.blocked_by:
            return False
        return self.path.arm is state.arm and self.is_expected(state)

    def known_stop(self, state: ChainState, torques: StepTorques) -> Array | None:
        """Return steps that stop the arm within torque limits, (k, nv) [rad or m]; None if none are known.

        On its path, or after the steps that are computed already.

        Args:
            state: the state of the arm.
            torques: the torques of its next step.
        """
        if not self.can_stop(state):
            return None
        steps = stopping_on_path(self.timed, self.s, self.speed)
        if torques.judged(steps).share <= 1.0:
            return steps
        ahead = self.ahead
        if ahead is None or ahead.stopping is None:
            return None
        return np.concatenate([ahead.dq[self.taken : len(ahead.s)], ahead.stopping])

    def retimed(self, path: JointPath, limits: Limits, initial_speed: float = 0.0) -> PathProgress:
        """Return this progress on another path with as many waypoints, or within other limits."""
        timed = time_path(path, limits, self.timed.max_rate, initial_speed, self.timed.effort)
        return self._replace(timed=timed, ahead=None)

    def deformed(self, path: JointPath, bend: Array, limits: Limits) -> PathProgress:
        """Return this progress on a bent path, retimed if the bend, as in the attribute, changed enough."""
        since = bend if self.timed_bend is None else bend - self.timed_bend
        little = np.all(np.abs(since) <= FOLLOWING.most_untimed_bend * path.arm.joint_units)
        if little and self.timed.bounds is limits.for_arm(path.arm):
            timed = replace(self.timed, path=path)
            return self._replace(timed=timed, objective=path.objective, bend=bend, ahead=None)
        on_bent = self._replace(objective=path.objective, bend=bend, timed_bend=bend)
        return on_bent.retimed(path, limits)

    @property
    def on_schedule(self) -> bool:
        """Whether the target moves along the path, and the arm with it."""
        return self.timed.scheduled and not self.arrived

    def towards(self, target: Target) -> PathProgress:
        """Return this progress with another target."""
        return self._replace(objective=replace(self.objective, target=target), ahead=None)

    def among(self, scene: Scene | None) -> PathProgress:
        """Return this progress among other obstacles, beside which `GeodesicMemory.braked` stops."""
        if self.path.scene is scene:
            return self
        return self._replace(timed=replace(self.timed, path=self.path.revised(scene=scene)), ahead=None)

    @classmethod
    def begin(
        cls,
        path: JointPath,
        limits: Limits,
        previous: Array | None,
        effort: bool = False,
        max_rate: float | Array = inf,
    ) -> PathProgress:
        """Return the progress at the start of a path, which is timed from the speed of the arm on.

        Args:
            path: the path.
            limits: the limits of each step.
            previous: the previous step, (nv,) [rad or m]; None: the arm was at rest.
            effort: as for `retime`.
            max_rate: likewise.
        """
        speed = 0.0
        if previous is not None:
            ahead = path.offsets[1] - path.offsets[0]
            squares = float(ahead @ ahead)
            speed = max(float(ahead @ previous), 0.0) / squares if squares > 0.0 else 0.0
            speed = min(speed, path.end)
        timed = time_path(path, limits, max_rate, speed, effort)
        return cls(timed, path.objective, speed=0.0 if timed.profile is None else speed)


class Goal(NamedTuple):
    """A configuration that takes a target, and its motion since the previous target.

    Attributes:
        target: the target.
        positions: joint positions that take the target, (nv,) [rad or m].
        motion: their displacement from those of the previous target, (nv,) [rad or m].
    """

    target: Target
    positions: Array
    motion: Array


@dataclass(frozen=True, eq=False)
class GeodesicMemory(Memory):
    """The memory of `Geodesic`: the path, the position of the arm on it, and the motion of the target."""

    progress: PathProgress | None = None
    goal: Goal | None = None

    def braked(self, limits: Limits, state: ArmState) -> GeodesicMemory:
        """Return the memory after a braking step: on the path, if that keeps torques within their limits."""
        known = self.progress
        chain_state = state.chain_state
        bounds = limits.for_arm(state.arm)
        if self.stopping is not None or bounds.effort is None or bounds.dt is None:
            return super().braked(limits, state)
        torques = StepTorques(state.arm, bounds, chain_state.raw_positions, self.dq)
        steps = None if known is None else known.known_stop(chain_state, torques)
        if known is None or steps is None:
            return replace(self, stopping=torques.stop().steps).braked(limits, state)
        step = stop_on_path(known, chain_state, bounds, bounds.step_bounds(chain_state, self.dq), None)
        if len(steps) and np.array_equal(step.dq, steps[0]):
            return replace(cast(GeodesicMemory, step.memory), goal=self.goal)
        return replace(self, stopping=steps).braked(limits, state)


def follow(
    path: TimedPath, state: ArmState, limits: Limits | None = None, memory: Memory | None = None
) -> Step:
    """Take one step along a path: the third stage of `Geodesic`, which never plans.

    The step keeps the limits, avoids the obstacles of `path.path.scene`, and returns an arm that is off the
    path to it. At the end of the path, steps reduce the remaining errors.

    Args:
        path: the timed path, as `retime` returns it.
        state: the state of the arm.
        limits: the limits of the step; those of the path if None.
        memory: `memory` of the previous step. None: the arm is at rest at the start of the path.

    Raises:
        InvalidValue: an argument of the wrong type, or of another arm.
    """
    require_instance("path", path, TimedPath, "a TimedPath, as `retime` returns it")
    if arm_of(state) is not path.path.arm:
        raise InvalidValue("state", state.arm, "a state of the arm for which the path was planned")
    objective = path.path.objective
    limits = checked_limits(state, objective.target, path.limits if limits is None else limits, memory)
    state = state.chain_state
    known = memory.progress if isinstance(memory, GeodesicMemory) else None
    previous = None if memory is None else memory.dq
    on_it = known is not None and known.timed is path and known.objective is objective
    if known is not None and on_it:
        progress = known
    elif previous is None or path.profile is None:
        progress = PathProgress(path, objective)
    else:
        progress = PathProgress.begin(path.path, path.limits, previous, path.effort, path.max_rate)
    bounds = limits.for_arm(state.arm)
    avoidance = Avoidance.of(progress.path.scene, objective, bounds, previous)
    step = fast_step(progress, state, bounds, previous) if avoidance is None else None
    if step is not None:
        return step
    step_bounds = bounds.step_bounds(state, previous)
    candidate = propose(progress, state, bounds, step_bounds, avoidance)
    return check_step(candidate, state, bounds, step_bounds, avoidance, progress)


def fast_step(
    progress: PathProgress,
    state: ChainState,
    bounds: JointBounds,
    previous: Array | None,
    goal: Goal | None = None,
    avoidance: Avoidance | None = None,
) -> Step | None:
    """Take the next step on a path in the simple case; several are computed in one call.

    Most steps are of this kind. None in all other cases, which `propose` handles: limits that cannot be kept,
    an arm away from its expected position, the end of the path, a path that leaves the limits, or a step that
    is not clear.

    Args:
        progress: position of the arm on its path.
        state: the state of the arm.
        bounds: the limits of the joints.
        previous: the previous step, (nv,) [rad or m]; None: the arm was at rest.
        goal: the goal for the memory.
        avoidance: the obstacles to avoid, and constraints; None: none.
    """
    timed = progress.timed
    path = timed.path
    objective = progress.objective
    if progress.arrived or objective.tasks:
        return None
    if bounds.brake is not None and path.end == 1.0 and not (timed.scheduled or timed.torques is not None):
        return None  # each joint moves to the end on its own
    arm = state.arm
    ahead = progress.ahead
    i = progress.taken
    known = ahead is not None and ahead.bounds is bounds and i < len(ahead.s)
    if known and bounds.brake is not None:
        known = previous is not None and np.array_equal(previous, cast(StepsAhead, ahead).dq[i - 1])
    if ahead is None or not known or not progress.is_expected(state):
        if len(objective.chain.joints) < len(arm.kinematics.columns):
            return None
        ahead = _steps_ahead(progress, state, bounds, previous)
        i = 0
        if ahead.s and avoidance is None and bounds.effort is not None and bounds.dt is not None:
            ahead = _within_torques(progress, ahead, StepTorques(arm, bounds, state.raw_positions, previous))
        if not ahead.s:
            return None
    s = ahead.s[i]
    before = ahead.errors[i]
    after = ahead.errors[i + 1]
    dq = ahead.dq[i].copy()
    held_back = s <= progress.s
    moved = progress.moved_to(s, bounds.travel, held_back, ahead.reached[i], ahead, i + 1)
    stopping = None
    messages = _Messages()
    if avoidance is not None:
        stopping = _clear_stop(moved, state, dq, bounds, avoidance)
        if stopping is None:
            return None
        messages = _Messages.of(avoidance, state, path)
    return Step(
        dq,
        objective.chain.active,
        ahead.at_limit[i],
        error_increasing=_rises(objective, before, after),
        violated_constraints=messages.violated,
        near=messages.near,
        following_path=moved.idle_travel <= progress.idle_travel,
        memory=GeodesicMemory(dq, stopping, moved, goal),
    )


class _Messages(NamedTuple):
    """Messages on a step beside obstacles; see `Step`.

    Attributes:
        violated: the margins and constraints that are violated where it begins.
        near: what limits it, and what its path comes too close to.
    """

    violated: tuple[str, ...] = ()
    near: tuple[str, ...] = ()

    @classmethod
    def of(
        cls,
        avoidance: Avoidance,
        state: ChainState,
        path: JointPath,
        solution: Solution | None = None,
        stuck: bool = False,
    ) -> _Messages:
        """Describe a step on a path; `solution` and `stuck` as for `Avoidance.describe_obstruction`."""
        near: tuple[str, ...] = ()
        if stuck or solution is not None:
            near = avoidance.describe_obstruction(state, solution, stuck)
        blocked = (path.blocked_by,) if path.blocked_by else ()
        return cls(avoidance.describe_violations(state), near + blocked)


def _rises(objective: Objective, before: float, after: float) -> bool:
    """Whether the posture error rises in a step, from that before and after it [m], by more than rounding."""
    return after > before + FOLLOWING.error_rounding * objective.arm.length


def _clip_step(
    objective: Objective, state: ChainState, bounds: JointBounds, limits: Array, dq: Array
) -> tuple[Array, NDArray[np.bool_], bool]:
    """Clip a step to its limits, in place, and look at what is after it.

    Args:
        objective: the objective.
        state: the state before it.
        bounds: the limits of the joints.
        limits: smallest and largest step, (2, nv) [rad or m].
        dq: the step, (nv,) [rad or m].

    Returns:
        Joint positions after it, (nv,) [rad or m]; which joints are at a position limit then, (nv,); and
        whether the posture error rises.
    """
    arm = state.arm
    chain = objective.chain
    reached = np.empty(arm.nv)
    at_limit = np.empty(arm.nv, dtype=np.bool_)
    before, after = kernels.look_ahead(
        arm.kinematics.constants,
        state.raw_positions,
        bounds.units,
        limits,
        bounds.position_limits,
        state.placements.points,
        chain.targets,
        chain.flags,
        dq,
        reached,
        at_limit,
    )
    return reached, at_limit, _rises(objective, before, after)


def _steps_ahead(
    progress: PathProgress, state: ChainState, bounds: JointBounds, previous: Array | None
) -> StepsAhead:
    """Compute the next simple steps on a path.

    Only one if the arm is not at its expected position, or if the target moves along the path.
    """
    arm = state.arm
    timed = progress.timed
    goals = progress.objective.chain
    expected = progress.expected
    count = 1 if timed.scheduled else FOLLOWING.steps_ahead
    if expected is None:
        expected = state.raw_positions
    elif not (timed.scheduled or progress.is_expected(state)):
        count = 1
    ahead = NextSteps(
        s=np.empty(count),
        errors=np.empty(count + 1),
        dq=np.zeros((count, arm.nv)),
        reached=np.empty((count, arm.nv)),
        at_limit=np.empty((count, arm.nv), dtype=np.bool_),
    )
    before = bounds.before(previous)
    steps = kernels.take_steps(
        arm.kinematics.constants,
        arm.kinematics.endless,
        bounds.arrays,
        state.raw_positions,
        state.placements.points,
        timed.arrays,
        PathMotion(progress.s, progress.speed, expected, before, bounds.braking),
        PATH_TOLERANCES,
        PointGoals(goals.targets, goals.flags),
        ahead,
    )
    s = ahead.s[:steps].tolist()
    return StepsAhead(bounds, s, ahead.errors.tolist(), ahead.dq, ahead.reached, ahead.at_limit)


def _within_torques(progress: PathProgress, ahead: StepsAhead, torques: StepTorques) -> StepsAhead:
    """Return steps on a path with those that stop the arm after them; none if these exceed torque limits."""
    steps = ahead.dq[: len(ahead.s)]
    ends = [progress.s, *ahead.s]
    stopping = stopping_on_path(progress.timed, ends[-1], ends[-1] - ends[-2])
    kept = torques.judged(np.concatenate([steps, stopping])).share <= 1.0
    return ahead._replace(stopping=stopping) if kept else ahead._replace(s=[])


def step_to_goal(objective: Objective, state: ChainState, bounds: JointBounds) -> Step | None:
    """Take the step to a configuration that takes the target posture, if it is one short step away.

    This is the usual case for a target that moves a little in each cycle.

    Args:
        objective: the objective, without tasks.
        state: the state of the arm.
        bounds: the limits of the joints.

    Returns:
        The step; None if no such configuration is known within one step.
    """
    if bounds.brake is not None:
        return None
    goal = find_positions_near(objective, state, bounds.position_limits)
    if goal is None:
        return None
    arm = state.arm
    chain = objective.chain
    step = StepArrays(np.zeros(arm.nv), np.empty(arm.nv), np.empty(arm.nv, dtype=np.bool_))
    simple, before, after = kernels.step_to(
        arm.kinematics.constants,
        arm.kinematics.endless,
        bounds.arrays,
        state.raw_positions,
        state.placements.points,
        goal,
        arm.multi_turn,
        PATH.short_motion,
        ROUNDING,
        PointGoals(chain.targets, chain.flags),
        step,
    )
    if not (simple and after <= len(chain.active) * OBJECTIVE.goal_tolerance * arm.length):
        return None
    return Step(
        step.dq,
        chain.active,
        step.at_limit,
        error_increasing=_rises(objective, before, after),
        following_path=True,
        memory=GeodesicMemory(step.dq),
    )


def pursue(
    objective: Objective, state: ChainState, bounds: JointBounds, memory: Memory | None
) -> tuple[Step | None, Goal | None]:
    """Take the step with which each joint catches up with its moving goal soonest and then stays on it.

    Let r be the distance to the goal, and g(r) the largest step after which a joint can stop in time
    (`farthest`). For a goal that moves by v in each cycle, the step is v + g(r - v). The motion v is
    `Target.velocity`, or else that of the target in the last cycle, unless it is noise or infeasible. An arm
    that is far behind follows a path first, unless it is led (`Target.led`).

    Args:
        objective: the objective, without tasks.
        state: the state of the arm.
        bounds: the limits of the joints, with acceleration; for a target that leads the arm also without.
        memory: `memory` of the previous step.

    Returns:
        The step, None if the target does not lead the arm and is at rest or too far away; and the goal, None
        if unknown.
    """
    arm = state.arm
    target = objective.target
    before = memory.goal if isinstance(memory, GeodesicMemory) else None
    stands = before is not None and before.target is target
    if before is not None and stands and not target.led:
        return None, before._replace(motion=np.zeros(arm.nv))
    nearest = find_positions_near(objective, state, bounds.position_limits)
    none = np.zeros(arm.nv)
    if nearest is None or (bounds.brake is None and not target.led):
        return None, None
    if target.q is not None and not objective.has_exact_goal:
        return None, None
    motion = none if before is None else _turned(arm, nearest - before.positions)
    goal = Goal(target, nearest, motion)
    steady = False
    if stands:
        motion = none
    elif target.velocity is not None and bounds.dt is not None:
        motion = bounds.dt * target.velocity
        steady = True
    elif before is not None and bounds.brake is not None:
        steady = bool(np.all(np.abs(motion - before.motion) <= bounds.brake * (1.0 + ROUNDING)))
    if not (target.led or (steady and np.any(motion))):
        return None, goal
    columns = objective.chain.columns
    positions = state.raw_positions
    rest = _turned(arm, nearest - positions)
    near = np.abs(rest) <= FOLLOWING.most_pursued_motion * arm.joint_units
    moves = near & (np.abs(motion) <= bounds.bound)
    inside = kernels.position_excess(positions + rest, bounds.position_limits, arm.kinematics.columns) == 0.0
    step_bounds = bounds.step_bounds(state, None if memory is None else memory.dq)
    if not target.led and (step_bounds.outside or not (inside and np.all(moves[columns]))):
        return None, goal
    dq = np.zeros(arm.nv)
    proposal = rest if bounds.brake is None else motion + farthest(rest - motion, bounds.brake)
    dq[columns] = np.minimum(np.maximum(proposal, step_bounds.lower), step_bounds.upper)[columns]
    _, at_limit, rises = _clip_step(objective, state, bounds, step_bounds.both, dq)
    step = Step(
        dq,
        objective.chain.active,
        at_limit,
        error_increasing=rises,
        violated_constraints=step_bounds.violated_constraints,
        following_path=True,
        memory=GeodesicMemory(dq, None, None, goal),
    )
    return step, goal


def _turned(arm: Arm, change: Array) -> Array:
    """Return displacements (nv,) reduced by whole turns of joints that can make them."""
    turns = np.rint(change / FULL_TURN) * (arm.kinematics.endless | arm.multi_turn)
    return np.asarray(change - FULL_TURN * turns)


def stop_on_path(
    progress: PathProgress,
    state: ChainState,
    bounds: JointBounds,
    step_bounds: StepBounds,
    avoidance: Avoidance | None,
) -> Step:
    """Take a step that brakes on a path as much as its limits of torque and acceleration allow.

    Args:
        progress: position of an arm that can stop on its path, `PathProgress.can_stop`.
        state: the state of the arm.
        bounds: the limits of the joints.
        step_bounds: the steps that they allow.
        avoidance: the obstacles to avoid, and constraints; None: none.
    """
    timed = progress.timed
    path = timed.path
    arrays = timed.arrays
    none = np.zeros_like(arrays.top)  # a profile that asks for no speed
    speed = kernels.next_path_speed(
        progress.s, progress.speed, arrays.small, arrays.most, arrays.parts, arrays.rows, none
    )
    s = progress.s + max(speed, 0.0)
    dq = np.array(path.smooth_offset(s) - path.smooth_offset(progress.s))
    moved = progress.moved_to(s, bounds.travel, held_back=False)
    return check_step(CandidateStep(dq, moved), state, bounds, step_bounds, avoidance, progress)


def stopping_on_path(timed: TimedPath, s: float, speed: float) -> Array:
    """Return the steps that stop an arm on a path, as `stop_on_path` takes them, (k, nv) [rad or m].

    Args:
        timed: the path, with a profile.
        s: position of the arm on it, in waypoints.
        speed: motion along it in the last step, in waypoints.
    """
    return kernels.find_stop(timed.arrays, s, speed, CYCLES.most_stopping)


def _clear_stop(
    moved: PathProgress, state: ChainState, dq: Array, bounds: JointBounds, avoidance: Avoidance
) -> Array | None:
    """Return steps that stop the arm clear after a step on its path, (k, nv) [rad or m]; None if none do.

    On a straight line, or along the path, which is clear where a straight line leaves it.

    Args:
        moved: the progress after the step.
        state: the state before it.
        dq: the step, (nv,) [rad or m].
        bounds: the limits of the joints.
        avoidance: the obstacles to avoid.
    """
    stop = avoidance.clear_stop(state, dq)
    path = moved.timed.path
    brake = bounds.brake
    if stop is not None or brake is None or bounds.effort is not None or moved.timed.profile is None:
        return stop
    off = path.offset_of(state, moved.s) + dq - path.smooth_offset(moved.s)
    if np.any(np.abs(off) > ROUNDING * path.arm.joint_units):
        return None
    stopping = stopping_on_path(moved.timed, moved.s, moved.speed)
    changes = np.diff(np.vstack([dq, stopping, np.zeros(len(dq))]), axis=0)
    if np.any(np.abs(changes) > brake * (1.0 + ROUNDING)):
        return None
    return avoidance.clear_stop(state, dq, stopping)


class CandidateStep(NamedTuple):
    """A step before the final checks.

    Attributes:
        dq: the step, (nv,) [rad or m].
        progress: progress on the path after it.
        solution: solution of the quadratic program; None if none was solved.
        reason: why the arm does not move; empty if it does.
    """

    dq: Array
    progress: PathProgress
    solution: Solution | None = None
    reason: str = ""


def propose(
    progress: PathProgress,
    state: ChainState,
    bounds: JointBounds,
    step_bounds: StepBounds,
    avoidance: Avoidance | None,
) -> CandidateStep:
    """Return a step along a path, or at its end, before `check_step` checks it.

    Args:
        progress: position of the arm on its path.
        state: the state of the arm.
        bounds: the limits of the joints.
        step_bounds: the steps that they allow.
        avoidance: the obstacles to avoid; None: none.
    """
    if not progress.arrived:
        return step_along(progress, state, step_bounds, bounds, avoidance)
    constraints = StepConstraints.of(progress.objective, state, step_bounds, avoidance)
    candidate = reduce_remaining(progress, constraints)
    if bounds.effort is None or bounds.dt is None or constraints.retreating:
        return candidate
    torques = StepTorques(state.arm, bounds, state.raw_positions, None)
    return candidate._replace(dq=torques.approach(candidate.dq))


def step_along(
    progress: PathProgress,
    state: ChainState,
    step_bounds: StepBounds,
    bounds: JointBounds,
    avoidance: Avoidance | None = None,
) -> CandidateStep:
    """Return the step along the path if its bounds admit it, else the closest admissible one.

    That one minimises |A (x - x_path)|^2 + mu^2 |x - x_path|^2, with all rows A of the objective and the
    weight mu of joint motion. Tasks with priority come first; the path already accounts for the others.

    Args:
        progress: position of the arm on its path.
        state: the state of the arm.
        step_bounds: the steps that the limits allow.
        bounds: the limits of the joints.
        avoidance: the obstacles to avoid; None: none.
    """
    path = progress.timed.path
    objective = progress.objective
    here = progress.s
    tasks = None if path.task_errors is None else objective.task_rows(state, priority=True)
    proposal = _next_on_path(progress, state, step_bounds, bounds, tasks, avoidance is None)
    s, left, inside, held_back, dq, _ = proposal
    if s >= path.end and left <= ROUNDING:
        progress = progress._replace(arrived=True, s=path.end)
        return reduce_remaining(progress, StepConstraints.of(objective, state, step_bounds, avoidance))
    if inside and avoidance is None and not objective.tasks:
        # All weights give the same step here, and a step ahead is progress (see `JointPath.step_along`).
        return CandidateStep(dq, progress.moved_to(s, bounds.travel, held_back and s <= here))
    if progress.timed.profile is None and here < s:
        lag = np.abs(path.offset(here) - path.offset_of(state, here))
        late = lag > FOLLOWING.most_lag * progress.timed.bounds.bound
        held_back = bool(np.any(late[objective.chain.columns]))
    progress = progress.moved_to(s, bounds.travel, held_back)
    may_follow = inside and tasks is None
    may_stop = may_follow and avoidance is not None and avoidance.still
    if may_stop and avoidance is not None and _clear_stop(progress, state, dq, bounds, avoidance) is not None:
        return CandidateStep(dq, progress)  # without computing the rows of constraints
    constraints = StepConstraints.of(objective, state, step_bounds, avoidance)
    planned = objective.normalize(dq)
    if may_follow and constraints.admit(planned):
        return CandidateStep(dq, progress)
    if not objective.tasks:
        solver = ChainSolver(objective, state)
        solution = solve_posture(solver, solver.covered(planned), objective.mu**2, planned, constraints)
        x = np.clip(planned, constraints.lower, constraints.upper) if solution.x is None else solution.x
        stands = s <= here and float(x @ x) <= FOLLOWING.standing_share**2 * float(planned @ planned)
        if stands and avoidance is not None and avoidance.still:
            progress = progress._replace(idle_travel=np.inf)
        return CandidateStep(objective.displacement(x), progress, solution)
    step = _bend_to_tasks(progress, dq, constraints, tasks)
    if tasks is not None and proposal.rest is not None:
        farther = np.abs(objective.normalize(step.dq)) > np.abs(objective.normalize(dq)) + ROUNDING
        if np.any(farther):
            step = _bend_to_tasks(progress, _share(proposal.rest, dq), constraints, tasks)
    return step


def _bend_to_tasks(
    progress: PathProgress, dq: Array, constraints: StepConstraints, tasks: LinearRows | None
) -> CandidateStep:
    """Return the step closest to one along the path that tasks with priority admit.

    Args:
        progress: position of the arm on its path after the step.
        dq: the step along the path, (nv,) [rad or m].
        constraints: the bounds of the step.
        tasks: the rows of the tasks at the state; None: there are none.
    """
    objective = progress.objective
    state = constraints.state
    along = objective.normalize(dq)
    hessian = damped_hessian(objective.rows(state).matrix, objective.mu**2)
    first = None
    planned: Array | None = None
    if tasks is not None:
        planned = _planned_errors(progress, progress.s, len(tasks.errors))
        reached = objective.errors_of_tasks(objective.state_after(state, along), priority=True)
        motion = tasks.matrix @ along + cast(Array, reached) - planned  # none but `along` if that leads there
        first = solve_priority(objective, constraints, tasks, motion, along)
    solution = solve_remaining(hessian, -(hessian @ along), constraints, first)
    if solution.x is None:
        x = np.clip(along, constraints.lower, constraints.upper)
    else:
        x = correct_curvature(objective, constraints, solution.x, planned)
    return CandidateStep(objective.displacement(x), progress, solution)


def _share(rest: Array, dq: Array) -> Array:
    """Return the longest step along a motion in which no joint exceeds the step given for it.

    Joints that move each on its own leave what tasks with priority admit: bent back to that, their steps
    cannot be stopped at the end of the motion, and the arm swings about it.

    Args:
        rest: the motion, (nv,) [rad or m].
        dq: steps after which each joint can stop at its end, (nv,) [rad or m]; those that have to turn round
            do not count.
    """
    moves = rest != 0.0
    shares = dq[moves] / rest[moves]
    return rest * float(shares[shares >= 0.0].min(initial=1.0))


def _planned_errors(progress: PathProgress, s: float, count: int) -> Array:
    """Return the errors of the tasks with priority at a position on the path, (r,) [m]; 0 if it has none.

    They pass straight from those at its start to those at its end, or as the path has them if that is almost
    so: near a singular configuration even the rounding of the path would need large steps.
    """
    path = progress.timed.path
    before, after = cast(tuple[Array, Array], path.task_errors)  # there are tasks on the way
    if len(before) != count:
        return np.zeros(count)
    share = s / path.end
    straight = (1.0 - share) * before + share * after
    arm = path.arm
    state = arm.chain_at(arm.integrate(path.start, path.smooth_offset(s)))
    off = cast(Array, progress.objective.errors_of_tasks(state, priority=True)) - straight
    most = FOLLOWING.task_deviation * float(np.linalg.norm(after - before))
    return straight + off * min(1.0, most / max(float(np.linalg.norm(off)), 1e-300))


class _Proposal(NamedTuple):
    """A step along a path, before obstacles and tasks are considered.

    Attributes:
        s: its end, in waypoints.
        left: largest remaining joint motion before the step, in `Arm.joint_units`.
        inside: whether it is within its limits.
        held_back: whether it is shorter than the profile allows.
        dq: the step, (nv,) [rad or m].
        rest: the rest of the motion, (nv,) [rad or m], if each joint moves there on its own; else None.
    """

    s: float
    left: float
    inside: bool
    held_back: bool
    dq: Array
    rest: Array | None = None


def _next_on_path(
    progress: PathProgress,
    state: ChainState,
    step_bounds: StepBounds,
    bounds: JointBounds,
    tasks: LinearRows | None,
    free: bool,
) -> _Proposal:
    """Propose the next step along the path.

    Args:
        progress: position of the arm on its path.
        state: the state of the arm.
        step_bounds: the steps that the limits allow.
        bounds: the limits of the joints.
        tasks: the rows of the tasks with priority at the state; None: there are none.
        free: whether there is nothing to avoid.
    """
    timed = progress.timed
    path = progress.timed.path
    here = progress.s
    objective = progress.objective
    if timed.profile is None:
        step = path.step_along(state, here, step_bounds.both)
        left = step.left
        if here >= path.end and tasks is not None:
            rest = _admitted(progress, here, tasks, path.offsets[-1] - path.offset_of(state, here))
            left = objective.largest_motion(rest)
        return _Proposal(step.s, left, step.inside, True, step.dq)
    offset = path.offset_of(state, here)
    rest = path.offsets[-1] - offset
    if tasks is not None and (path.end == 1.0 or here >= path.end):
        rest = _admitted(progress, path.end, tasks, rest)
    left = objective.largest_motion(rest)
    alone = path.end == 1.0 and not (timed.scheduled or timed.torques is not None)
    if alone and bounds.brake is not None:
        # On so short a path each joint moves to the end on its own, as fast as it can stop there. Beside
        # obstacles that would leave the straight line, which is clear: an arm swung past its end for ever.
        dq = np.minimum(np.maximum(farthest(rest, bounds.brake), step_bounds.lower), step_bounds.upper)
        if tasks is None and not free:
            dq = np.minimum(np.maximum(_share(rest, dq), step_bounds.lower), step_bounds.upper)
        ahead = objective.largest_motion(rest - dq)
        if tasks is None:
            whole = objective.largest_motion(path.offsets[-1])
            s = max(here, 1.0 - ahead / max(whole, ROUNDING))
        else:  # they need motion off the path as well
            s = 1.0 - (1.0 - here) * min(ahead / max(left, ROUNDING), 1.0)
        return _Proposal(s, left, True, True, dq, rest)
    lag = path.smooth_offset(here) - offset
    if tasks is not None:
        lag = _admitted(progress, here, tasks, lag)
    braking = bounds.braking
    if bounds.effort is not None and bounds.dt is not None and np.any(np.abs(lag) > ROUNDING):
        torques = StepTorques(state.arm, bounds, state.raw_positions, None)
        slowing = np.maximum(torques.slowing(state.raw_positions, lag) * np.abs(lag), ROUNDING)
        braking = slowing if bounds.brake is None else np.minimum(slowing, braking)
    dq = np.empty(state.arm.nv)
    s, held_back, inside = kernels.step_on_profile(
        timed.arrays,
        objective.chain.columns,
        objective.chain.units,
        bounds.bound,
        braking,
        step_bounds.both,
        PATH_TOLERANCES,
        here,
        progress.speed,
        lag,
        dq,
    )
    return _Proposal(s, left, inside, held_back, dq)


def _admitted(progress: PathProgress, s: float, tasks: LinearRows, motion: Array) -> Array:
    """Return the part of a motion to a position on a path that tasks with priority admit, and what they need.

    A path never takes the tasks exactly. An arm that waited for the rest of the motion would wait for ever.

    Args:
        progress: position of the arm on the path.
        s: the position, in waypoints.
        tasks: the rows of the tasks at the state from which the motion starts.
        motion: the motion from there, (nv,) [rad or m].
    """
    objective = progress.objective
    matrix = tasks.matrix
    needed = tasks.errors - _planned_errors(progress, s, len(tasks.errors))
    missed = needed - matrix @ objective.normalize(motion)
    damping = DESCENT.priority_damping * mean_diagonal(objective, matrix)
    change = matrix.T @ np.linalg.solve(damped_hessian(matrix.T, damping), missed)
    return motion + objective.displacement(change)


def reduce_remaining(progress: PathProgress, constraints: StepConstraints) -> CandidateStep:
    """Return the step that reduces the remaining errors at the end of the path, damped until it does.

    Where none did in the last cycle, none is sought again as long as nothing changes: an arm at rest would
    spend most of each cycle on that.
    """
    objective = progress.objective
    damping = progress.damping
    solution = None
    state = constraints.state
    cost = objective.cost(state)
    if constraints.retreating:
        solution = reduce_errors(objective, constraints, damping)
        if solution.x is not None:
            return CandidateStep(objective.displacement(solution.x), progress, solution)
    known = progress.dead_end
    rest = np.clip(np.zeros(len(constraints.lower)), constraints.lower, constraints.upper)  # it may brake
    if (
        known is not None
        and known.objective is objective
        and known.cost == cost
        and known.constraints.equals(constraints)
    ):
        return CandidateStep(objective.displacement(rest), progress, known.solution, known.reason)
    for _ in range(
        FOLLOWING.attempts if cost > (FOLLOWING.negligible_error * objective.arm.length) ** 2 else 0
    ):
        solution = reduce_errors(objective, constraints, damping)
        x = None if solution.x is None else correct_curvature(objective, constraints, solution.x)
        if (
            x is not None
            and objective.cost(objective.state_after(state, x)) < (1.0 - POSTURE_SEARCH.converged) * cost
        ):
            less_damped = progress._replace(
                damping=max(damping * POSTURE_SEARCH.decrease, POSTURE_SEARCH.least_factor), dead_end=None
            )
            return CandidateStep(objective.displacement(x), less_damped, solution)
        damping *= POSTURE_SEARCH.increase
    reason = "" if np.any(rest) else _describe_end(objective, state)
    stuck = progress._replace(dead_end=DeadEnd(objective, cost, constraints, solution, reason))
    return CandidateStep(objective.displacement(rest), stuck, solution, reason)


def _describe_end(objective: Objective, state: ChainState) -> str:
    """Say that an arm gets no closer, name the tasks that are not met, and whether the posture is missed."""
    left = []
    for task in objective.tasks:
        error = float(np.linalg.norm(errors_of(task, state, objective.target)))
        kind = type(task.task if isinstance(task, Displaced) else task)
        left.append(f"{kind.__name__} by {length_text(error)}")
    words = f"; remaining errors of tasks: {', '.join(left)}" if left else ""
    target = objective.target
    missed = objective.mean_error(state) > CONVERGED * objective.arm.length
    if missed and (target.q is None or target.approximate):
        words += "; no posture that takes all points was found; the closest one may be a local minimum"
    return f"no step within the limits reduces the errors further{words}"


def check_step(
    candidate: CandidateStep,
    state: ChainState,
    bounds: JointBounds,
    step_bounds: StepBounds,
    avoidance: Avoidance | None,
    before: PathProgress,
) -> Step:
    """Make the step finite, within its limits and clear, and say what limits it."""
    arm = state.arm
    progress = candidate.progress
    dq = candidate.dq
    violated = step_bounds.violated_constraints
    share = 1.0
    stopping: Array | None = None
    messages = _Messages()
    reason = candidate.reason
    if not isfinite(dq @ dq):
        dq = np.nan_to_num(dq, nan=0.0, posinf=0.0, neginf=0.0)
    if avoidance is not None:
        dq[arm.columns] = np.minimum(np.maximum(dq, step_bounds.lower), step_bounds.upper)[arm.columns]
        proposed = dq
        dq, share, stopping, relaxed = avoidance.clear_step(state, proposed)
        if share < 1.0 and not progress.arrived:
            done = float(np.clip((dq @ proposed) / max(float(proposed @ proposed), 1e-300), 0.0, 1.0))
            s = before.s + done * (progress.s - before.s)
            moved = before.moved_to(s, bounds.travel, True)
            progress = progress._replace(
                s=moved.s,
                speed=moved.speed,
                progress_s=moved.progress_s,
                idle_travel=moved.idle_travel,
            )
        if progress.arrived and not (reason or np.any(dq)):
            if avoidance.offset is not None:
                reason = "no step within the limits leads the measured arm away from what it is too close to"
            elif avoidance.still:
                reason = _describe_end(progress.objective, state)
        violated += relaxed
        messages = _Messages.of(avoidance, state, progress.timed.path, candidate.solution, bool(reason))
    objective = progress.objective
    both = step_bounds.both if share == 1.0 else np.outer((-np.inf, np.inf), np.ones(arm.nv))
    reached, at_limit, rises = _clip_step(objective, state, bounds, both, dq)
    return Step(
        dq,
        objective.chain.active,
        at_limit,
        reason,
        error_increasing=rises,
        violated_constraints=violated + messages.violated,
        near=messages.near,
        following_path=not progress.arrived and progress.idle_travel <= before.idle_travel,
        memory=GeodesicMemory(dq, stopping, progress._replace(expected=reached, ahead=None)),
    )
