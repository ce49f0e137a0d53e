"""The default controller: plans the most direct path and follows it within limits and around obstacles."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from copy import copy
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Any, ClassVar, NamedTuple, cast

import numpy as np
from numpy.typing import NDArray

from pinposture._validation import finite_array, require_instance
from pinposture.arm import Arm, ArmState, ChainState
from pinposture.arm.weight import scaled
from pinposture.collision import CollisionModel, Scene
from pinposture.collision.model import MOTION_TOLERANCE
from pinposture.control.constraint import Constraint
from pinposture.control.controller import Memory, Step, checked_limits
from pinposture.control.limits import JointBounds, Limits, StepBounds
from pinposture.control.planner.avoidance import Avoidance, ClearStep
from pinposture.control.planner.damped_least_squares import PlanningProblem, StepConstraints, solve_posture
from pinposture.control.planner.follow import (
    FOLLOWING,
    CandidateStep,
    GeodesicMemory,
    Goal,
    PathProgress,
    check_step,
    fast_step,
    propose,
    pursue,
    step_to_goal,
    stop_on_path,
)
from pinposture.control.planner.goal import PlanNeeded, known_goal
from pinposture.control.planner.objective import ChainSolver, Objective, check_objective
from pinposture.control.planner.path import JointPath, TimedPath
from pinposture.control.planner.plan import (
    find_path,
    is_small_change,
    repair,
    replan,
    short_path,
    shortcut,
)
from pinposture.control.tasks import ControlTask
from pinposture.control.torque_limits import StepTorques
from pinposture.errors import InvalidValue
from pinposture.placement import Target
from pinposture.quadratic_program import ConstraintRows, Solution, solve

Array = NDArray[np.float64]


class GeodesicSettings(NamedTuple):
    """When a step looks for another path, and how steps within torque limits are found."""

    most_idle_travel: float = 1.0
    """Joint travel without progress after which the path is replanned [rad]."""

    path_attempts: int = 3
    """Largest number of paths that are planned without progress between them."""

    torque_iterations: int = 2
    """How often a step within torque limits is computed, with velocities first as before it, then as in
    it."""

    led_margin: float = 0.5
    """Share of the margin to obstacles that an arm keeps which is led. What leads it keeps all of the margin,
    and the arm is never quite there: with all of it, arms stood beside walls along which they were led."""

    least_clearance_gain: float = 1e-4
    """Gain in clearance of a step out of an obstacle below which a path is planned, in arm lengths."""


GEODESIC = GeodesicSettings()


@dataclass(frozen=True)
class Geodesic:
    """Moves the arm along the most direct path to its target posture.

    It has three stages, which can also be called separately:

    1. `plan` finds the goal configuration (that of the target, or the one closest to its points) and the path
       along which the control points travel least.
    2. `retime` finds the time parameterization of the path within the limits.
    3. `follow` takes one step. Admissible steps keep the position, velocity and acceleration limits and lose
       at most a share of the distance to any obstacle; the one closest to the step along the path is taken,
       measured by the motion of control points and chords. At the end of the path, damped least squares
       within the same limits reduce the remaining errors.

    The path is replanned if the target changes, if the arm is away from its expected position, if it makes no
    progress, or if an obstacle has left the goal that the path could not end at. An arm outside its position
    limits or inside an obstacle first returns, by the smallest sufficient step.

    If the constraints are infeasible, they are relaxed in this order, and `Step.violated_constraints`
    names them: tasks and posture, by their weights, tasks with priority last; then the margin to obstacles,
    which the next steps restore as far as possible; then acceleration limits, if braking would cause a
    collision, and position limits, as in `Limits.step_bounds`. Velocity limits always hold, and so do torque
    limits of motions, if the arm starts within them; torques at rest count as constraints.

    Attributes:
        joint_weight: weight of joint motion relative to control point motion: the distance, in module
            lengths, that all control points may move to save one radian of a joint. Smaller values, down to
            about 0.05, give straighter point paths and more joint motion; below that only the number of steps
            grows. Large values lead to joint interpolation.
        relative_position_weight: weight of the squared error of a chord, relative to that of a point.
        tasks: further tasks.
        constraints: constraints that plans and steps keep beside limits and obstacles; see `Constraint`.
        scene: the obstacles; None: none. `track(..., scene=)` sets it.
        offset: displacement of the measured arm from the state in which steps begin, (nv,) [rad or m]. Steps
            keep that arm clear, too, as far as its offset stays. None: none. A `Tracker` sets it.
    """

    joint_weight: float = 0.2
    relative_position_weight: float = 1.0
    tasks: tuple[ControlTask, ...] = ()
    constraints: tuple[Constraint, ...] = ()
    scene: Scene | None = None
    name: str = "geodesic"
    offset: Array | None = field(default=None, compare=False, repr=False)

    plans: ClassVar[bool] = True
    """Whether a step plans when it needs a path; if not, it raises `PlanNeeded`."""

    def __post_init__(self) -> None:
        tasks = tuple(self.tasks) if isinstance(self.tasks, Iterable) else (self.tasks,)
        check_objective(self.joint_weight, self.relative_position_weight, tasks, self.constraints)
        object.__setattr__(self, "tasks", tasks)
        object.__setattr__(self, "constraints", tuple(self.constraints))
        if not (self.scene is None or isinstance(self.scene, Scene)):
            raise InvalidValue("scene", self.scene, "a Scene(...), or None")
        if self.offset is not None:
            offset = finite_array("offset", self.offset, (None,))
            if not isinstance(self.offset, np.ndarray):
                object.__setattr__(self, "offset", offset)

    def with_scene(self, scene: Scene | None) -> Geodesic:
        """Return this controller in another scene."""
        require_instance("scene", scene, Scene | None, "a Scene(...), or None")
        return self._with(scene=scene)

    def with_offset(self, offset: Array | None) -> Geodesic:
        """Return this controller for another offset of the measured arm, an array (nv,) or None."""
        return self._with(offset=offset)

    def _with(self, **changes: Any) -> Geodesic:
        """Return this controller with other values; nothing is checked, as all of it was when it was made."""
        other = copy(self)
        vars(other).update(changes)
        return other

    def objective(self, arm: Arm, target: Target, known: Objective | None = None) -> Objective:
        """Return the objective of an arm: the target posture, the tasks and the constraints.

        Args:
            arm: the arm.
            target: the target posture.
            known: the objective of the step before, which is returned if it is the same; None: none.
        """
        if (
            known is not None
            and known.arm is arm
            and known.target is target
            and known.tasks == self.tasks
            and known.constraints is self.constraints
            and known.relative_position_weight == self.relative_position_weight
            and known.joint_weight == self.joint_weight
        ):
            return known
        return Objective(
            arm,
            target,
            self.tasks,
            self.relative_position_weight,
            self.joint_weight,
            self.constraints,
        )

    def step(
        self, state: ArmState, target: Target, limits: Limits | None = None, memory: Memory | None = None
    ) -> Step:
        """Compute one step; see `Controller.step`. The first step to a target plans and takes longer."""
        limits = checked_limits(state, target, limits, memory)
        now = _Situation(self, state.chain_state, target, limits, memory)
        for mode in MODES:
            step = mode.take(now)
            if step is not None:
                return step
        raise AssertionError("the last mode always makes a step")

    def start(self, path: TimedPath, state: ArmState, memory: Memory | None = None) -> GeodesicMemory:
        """Return the memory with which the next steps follow a given path.

        If the path has a schedule (`retime(..., max_rate=)`), the steps stay on it until its end while the
        target moves along it. An arm that is away from its expected position or makes no progress leaves it
        for a path planned to the target; `memory.progress.timed.scheduled` is then False.

        Args:
            path: the path; its objective should be `objective(arm, target)` of this controller.
            state: the state of the arm, at the start of the path.
            memory: `memory` of the previous step; None: the arm is at rest.

        Raises:
            InvalidValue: the target of the path does not fit the arm.
        """
        path.path.objective.target.check(state.arm)
        progress = PathProgress(path, path.path.objective, expected=state.raw_positions)
        motion = Memory(np.zeros(state.arm.nv)) if memory is None else memory
        return GeodesicMemory(motion.dq, motion.stopping, progress)

    def _update(self, now: _Situation) -> PathProgress:
        """Return the progress, on a new path for the first step, a new target or lack of progress."""
        progress = now.before
        effort = progress is not None and progress.timed.effort
        if progress is not None and not progress.matches(now.state):
            progress = None
        scheduled = progress is not None and progress.on_schedule
        if progress is not None and scheduled and progress.idle_travel < GEODESIC.most_idle_travel:
            return _within(self._renewed(progress), now)
        alike = progress is not None and _are_alike(progress.objective.target, now.target)
        if progress is not None and alike and not progress.arrived and progress.objective.tasks != self.tasks:
            alike = not any(task.priority for task in self.tasks)  # the path bends to where those are
        if progress is not None and not scheduled and alike:
            updated = self._go_on(now, progress)
        else:
            updated = self._plan(now, None if scheduled else progress, effort)
        moving = self.scene is not None and self.scene.moving
        if not moving or updated.arrived or updated.objective.tasks:
            return updated
        avoidance = Avoidance.of(self.scene, updated.objective, now.bounds)
        if avoidance is None:
            return updated
        path = shortcut(updated.path, updated.s, now.state, now.bounds, avoidance, prompt=not self.plans)
        if path is None:
            return updated
        return PathProgress.begin(path, now.limits, now.previous, effort)

    def _renewed(self, progress: PathProgress) -> PathProgress:
        """Return the progress with the tasks, weights and constraints of this controller."""
        known = progress.objective
        objective = self.objective(known.arm, known.target, known)
        return progress if objective is known else progress._replace(objective=objective, ahead=None)

    def _go_on(self, now: _Situation, progress: PathProgress) -> PathProgress:
        """Return the progress to the same target, on another path if the arm makes none on this one."""
        progress = self._renewed(progress)  # which needs no new path
        cut = False
        changes = self.scene is not None and bool(self.scene.moving)
        if self.scene is not None and not self.scene.has_maps_of(progress.path.scene):
            changes = True
            was_blocked = bool(progress.path.blocked_by)
            progress = progress.among(self.scene)
            cut = not (was_blocked or progress.arrived or self._is_clear_of_maps(now, progress))
        if changes and self._has_free_goal(now, progress):
            path = self._find_path(self._problem(progress.objective, now.state, now.bounds))
            return PathProgress.begin(path, now.limits, now.previous, progress.timed.effort)
        if not cut and (progress.idle_travel < GEODESIC.most_idle_travel or progress.arrived):
            return _within(progress, now)
        attempt = progress.path.attempt + 1
        if self.scene is not None and self.scene.moving:  # the path may be clear later
            attempt = 0
        if attempt >= GEODESIC.path_attempts or progress.s >= progress.path.end:
            return progress._replace(arrived=True)
        problem = self._problem(progress.objective, now.state, now.bounds)
        rest = None if progress.path.blocked_by else _rest(progress, now.state)
        path = self._find_path(problem, attempt, rest)
        return PathProgress.begin(path, now.limits, now.previous, progress.timed.effort)

    def _has_free_goal(self, now: _Situation, progress: PathProgress) -> bool:
        """Whether the path leads elsewhere than to the target posture, which the arm can take by now."""
        path = progress.path
        if path.blocked_by or path.objective.tasks:
            return False
        arm = now.state.arm
        end = arm.integrate(path.start, path.offsets[-1])
        goal = known_goal(path.objective, now.bounds.position_limits, end)
        avoidance = now.avoidance(progress)
        if goal is None or avoidance is None:
            return False
        away = path.objective.largest_motion(arm.difference(end, goal.q))
        return away > FOLLOWING.most_deviation and avoidance.allows(goal)

    def _is_clear_of_maps(self, now: _Situation, progress: PathProgress) -> bool:
        """Whether the path ahead keeps the margin to maps, as far as the arm does now."""
        avoidance = now.avoidance(progress)
        if avoidance is None:
            return True
        tolerated = MOTION_TOLERANCE * now.state.arm.length
        least = min(avoidance.margin, avoidance.clearance.minimum_at(now.state).distance) - tolerated
        return avoidance.clearance.clear_of_maps(now.state.q, _rest(progress, now.state), least)

    def _find_path(self, problem: PlanningProblem, attempt: int = 0, rest: Array | None = None) -> JointPath:
        """Return a path to the target; what is `rest` of the last one is repaired if that is possible."""
        if self.plans:
            path = None if rest is None else repair(problem, rest, attempt)
            return find_path(problem, attempt) if path is None else path
        path = None if attempt or problem.objective.tasks else short_path(problem)
        if path is None:
            raise PlanNeeded(attempt, rest)
        return path

    def _problem(self, objective: Objective, state: ChainState, bounds: JointBounds) -> PlanningProblem:
        return PlanningProblem(
            objective, state, bounds.position_limits, Avoidance.of(self.scene, objective, bounds)
        )

    def _plan(self, now: _Situation, progress: PathProgress | None, effort: bool) -> PathProgress:
        """Return the progress to another target, on the current path if it can be bent.

        `effort` is as for `retime`.
        """
        objective = now.objective
        problem = self._problem(objective, now.state, now.bounds)
        fast = problem.avoidance is None and not objective.tasks  # wherever the target has gone
        if progress is None or not (fast or is_small_change(progress.objective, objective)):
            return PathProgress.begin(self._find_path(problem), now.limits, now.previous, effort)
        idle = progress.idle_travel >= GEODESIC.most_idle_travel
        s = np.inf if progress.arrived or progress.path.attempt or idle else progress.s
        former = progress.path
        if former.objective is not progress.objective:
            former = former.revised(objective=progress.objective)
        path, bend = replan(former, s, progress.bend, problem, prompt=not self.plans)
        if bend is None:
            return PathProgress.begin(path, now.limits, now.previous, effort)
        return progress.deformed(path, bend, now.limits)

    def keep_clear(
        self, state: ArmState, target: Target, limits: Limits | None = None, memory: Memory | None = None
    ) -> Memory:
        """Take the smallest step that keeps the arm clear, regardless of the target, while a path is planned.

        Without moving obstacles and an `offset`, the arm brakes to a stop, unless a moved one is too close;
        and so does an arm that is led (`Target.led`).

        Args:
            state: the state of the arm.
            target: the target posture.
            limits: the limits of the step; `Limits()` if None.
            memory: `memory` of the previous step; None: the arm is at rest.

        Returns:
            The memory after the step, which is its `dq`; progress on a path is kept.

        Raises:
            InvalidValue: an argument of the wrong type.
        """
        limits = checked_limits(state, target, limits, memory)
        memory = Memory(np.zeros(state.arm.nv)) if memory is None else memory
        if self.scene is None or target.led or not (self.scene.moving or self.offset is not None):
            return memory.braked(limits, state)
        objective = self.objective(state.arm, target)
        state = state.chain_state
        model = CollisionModel(state.arm, self.scene)
        bounds = limits.for_arm(state.arm)
        avoidance = Avoidance(model, objective, bounds, memory.dq, self.offset, memory.stopping)
        if not (avoidance.moving or avoidance.offset is not None or avoidance.lost(state)):
            return memory.braked(limits, state)
        step_bounds = bounds.step_bounds(state, memory.dq)
        cleared = _smallest_step(avoidance, StepConstraints.of(objective, state, step_bounds, avoidance))
        return replace(memory, dq=cleared.dq, stopping=cleared.stopping)


class _Situation:
    """What a step begins with, and what its modes derive from that when they need it.

    Attributes:
        controller: the controller.
        state: the state of the arm.
        target: the target posture.
        limits: the limits of the step.
        memory: the memory of the previous step; None at the first.
        before: progress on the path of the previous step, with the target of this one if that moves along
            the path; None: it was not on one.
        previous: the previous step, (nv,) [rad or m]; None at the first.
        bounds: the limits of the joints.
        limited_only: whether there is nothing to keep but limits, and nothing to do but the target posture.
        direct: whether each joint may go to its goal on its own: the same, and there is no schedule.
        goal: the goal for the memory, from `pursue`.
    """

    def __init__(
        self, controller: Geodesic, state: ChainState, target: Target, limits: Limits, memory: Memory | None
    ) -> None:
        self.controller = controller
        self.state = state
        self.target = target
        self.limits = limits
        self.memory = memory
        before = memory.progress if isinstance(memory, GeodesicMemory) else None
        if before is not None and before.objective.target is not target and before.on_schedule:
            before = before.towards(target)
        self.bounds = limits.for_arm(state.arm)
        if before is not None and self.bounds.effort is not None:
            before = before.among(controller.scene)
        self.before = before
        self.previous = None if memory is None else memory.dq
        self.limited_only = controller.scene is None and not (controller.tasks or controller.constraints)
        self.direct = self.limited_only and (before is None or not before.on_schedule)
        self.goal: Goal | None = None
        self._avoidance: tuple[PathProgress, Avoidance | None] | None = None

    @cached_property
    def step_bounds(self) -> StepBounds:
        """The steps that the limits allow."""
        return self.bounds.step_bounds(self.state, self.previous)

    @cached_property
    def objective(self) -> Objective:
        """The objective of the controller for the target."""
        known = None if self.before is None else self.before.objective
        return self.controller.objective(self.state.arm, self.target, known)

    def avoidance(self, progress: PathProgress) -> Avoidance | None:
        """Return what steps on a path avoid; None if the limits of the joints are all that they keep."""
        if self._avoidance is None or self._avoidance[0] is not progress:
            scene = self.controller.scene
            avoidance = None
            if not (self.limited_only and not progress.arrived and progress.timed.is_held):
                objective = progress.objective
                avoidance = Avoidance.of(
                    scene, objective, self.bounds, self.previous, self.controller.offset, self.braking
                )
            self._avoidance = progress, avoidance
        return self._avoidance[1]

    def held(self, step: Step | None) -> Step | None:
        """Return a step within torque limits, from which the arm can stop within them; None if it is not.

        With it come the steps that stop the arm.
        """
        if step is None or self.bounds.effort is None:
            return step
        stopping = self.limits_alone.clear_stop(self.state, step.dq)
        if stopping is None:
            return None
        return step._replace(memory=replace(step.memory, stopping=stopping))

    @cached_property
    def limits_alone(self) -> Avoidance:
        """What steps avoid without a scene: where the motors cannot hold or move the arm."""
        return cast(
            Avoidance, Avoidance.of(None, self.objective, self.bounds, self.previous, None, self.braking)
        )

    @cached_property
    def torques(self) -> StepTorques | None:
        """The torques of the step; None if they are not limited, or without a cycle time."""
        if self.bounds.effort is None or self.bounds.dt is None:
            return None
        return StepTorques(self.state.arm, self.bounds, self.state.raw_positions, self.previous)

    def moves(self, step: Step) -> bool:
        """Whether the motors have the torques of a step."""
        return self.torques is None or self.torques.keep_limits(step.dq)

    @cached_property
    def braking(self) -> Array | None:
        """The steps that are known to stop the arm within its limits, (k, nv); None: none."""
        if self.memory is None:
            return None
        torques = None if self.bounds.effort is None else self.torques
        if torques is None:
            before = self.before
            if before is None or before.timed.bounds is not self.bounds:
                return None
            return self.memory.stopping if before.is_expected(self.state) else None
        if self.memory.stopping is not None:
            return self.memory.stopping
        return None if self.before is None else self.before.known_stop(self.state, torques)

    @cached_property
    def stopping(self) -> Step | None:
        """The step that brakes on the former path; None if the arm cannot, or has to evade obstacles."""
        before = self.before
        if before is None or not before.can_stop(self.state):
            return None
        avoidance = self.avoidance(before)
        if avoidance is not None and not avoidance.still:
            return None
        step = stop_on_path(before, self.state, self.bounds, self.step_bounds, avoidance)
        return step if self.moves(step) else None

    def remember_goal(self, step: Step) -> Step:
        """Return a step whose memory has the goal, too, so that the next step knows how it moves."""
        known = cast(GeodesicMemory, step.memory)
        return step if self.goal is None else step._replace(memory=replace(known, goal=self.goal))


def _continue_path(now: _Situation) -> Step | None:
    before = now.before
    if (
        before is None
        or before.timed.bounds is not now.bounds
        or before.idle_travel >= GEODESIC.most_idle_travel
    ):
        return None
    controller = now.controller
    scene = controller.scene
    objective = before.objective
    same_goal = objective.target is now.target and objective.arm is now.state.arm
    if not same_goal or objective.constraints is not controller.constraints:
        return None
    if controller.tasks or (scene is not None and scene.moving):
        return None
    avoidance = now.avoidance(before)
    if avoidance is not None and not avoidance.still:
        return None
    goal = None
    if now.direct and now.bounds.brake is not None:
        goal = cast(GeodesicMemory, now.memory).goal
        if goal is None or goal.target is not now.target:
            return None  # it may move; see `pursue`
        if np.any(goal.motion):
            goal = goal._replace(motion=np.zeros(now.state.arm.nv))
    return fast_step(before, now.state, now.bounds, now.previous, goal, avoidance)


def _go_to_goal(now: _Situation) -> Step | None:
    if not now.direct or now.bounds.brake is not None:
        return None
    step = now.held(step_to_goal(now.objective, now.state, now.bounds))
    if step is None or now.torques is None:
        return step
    stops = step.memory.stopping is not None and not len(step.memory.stopping)
    return step if stops else None


def _pursue_goal(now: _Situation) -> Step | None:
    if now.target.led and not now.controller.tasks:
        return _keep_to_way(now)
    if not now.direct or now.bounds.brake is None:
        return None
    step, now.goal = pursue(now.objective, now.state, now.bounds, now.memory)
    return now.held(step)


def _keep_to_way(now: _Situation) -> Step | None:
    """Take the step towards a target that leads the arm, as far as that is clear; never another way.

    Clear is the measured arm, if it is known: where drives sag, the command is beyond what leads the arm.
    """
    controller = now.controller
    step, now.goal = pursue(now.objective, now.state, now.bounds, now.memory)
    avoidance = Avoidance.of(controller.scene, now.objective, now.bounds, now.previous, None, now.braking)
    if step is None or avoidance is None:
        return step
    avoidance = avoidance.within(GEODESIC.led_margin)
    state = now.state if controller.offset is None else now.state.moved(controller.offset)
    cleared = avoidance.clear_step(state, step.dq)
    memory = GeodesicMemory(cleared.dq, cleared.stopping, None, now.goal)
    if cleared.share == 1.0:
        return step._replace(memory=memory)
    near = avoidance.describe_obstruction(state, None, True)
    before, after = (_posture_error(at, now.target) for at in (now.state, now.state.moved(cleared.dq)))
    return step._replace(
        dq=cleared.dq,
        reason="" if np.any(cleared.dq) else f"the way on is not clear: {'; '.join(near)}",
        error_increasing=after > before,
        violated_constraints=step.violated_constraints + cleared.violated_constraints,
        near=near,
        memory=memory,
    )


def _return_into_limits(now: _Situation) -> Step | None:
    """Take a step back into the position limits, where a path can begin."""
    step_bounds = now.step_bounds
    state = now.state
    if not step_bounds.outside or (now.before is not None and _is_almost_inside(state, now.bounds)):
        return None
    controller = now.controller
    dq = np.zeros(state.arm.nv)
    violated = step_bounds.violated_constraints
    columns = state.arm.columns
    dq[columns] = np.clip(dq, step_bounds.lower, step_bounds.upper)[columns]
    objective = now.objective
    avoidance = Avoidance.of(
        controller.scene, objective, now.bounds, now.previous, controller.offset, now.braking
    )
    share = 1.0
    stopping = None
    if avoidance is not None:
        if avoidance.moving or avoidance.offset is not None:
            evading = _smallest_motion(
                avoidance, StepConstraints.of(objective, state, step_bounds, avoidance)
            )
            moving = objective.chain.columns
            dq[moving] = evading[moving]
        dq, share, stopping, relaxed = avoidance.clear_step(state, dq)
        if share < 1.0:
            kept = "the margin to an obstacle" if now.torques is None else "torque limits or the margin"
            violated += (f"position limit: a faster return would violate {kept}",)
        violated += relaxed
    reason = "" if np.any(dq) else "joints are outside their limits, and an obstacle blocks their return"
    step = _step_before_planning(state, now.target, dq, violated, reason, stopping)
    return now.remember_goal(step)


def _back_out(now: _Situation) -> Step | None:
    """Take the smallest step that leads the arm out of an obstacle, from inside which no path is clear.

    None if the arm is not in collision, or if no such step gains clearance.
    """
    scene = now.controller.scene
    if now.before is not None or scene is None:
        return None
    state = now.state
    model = CollisionModel(state.arm, scene)
    avoidance = Avoidance(model, now.objective, now.bounds, now.previous, stopping=now.braking)
    if avoidance.near(state).minimum >= 0.0:
        return None
    cleared = _smallest_step(avoidance, StepConstraints.of(now.objective, state, now.step_bounds, avoidance))
    after = state.moved(cleared.dq)
    gained = avoidance.clearance.minimum(after.q).distance - avoidance.near(state).minimum
    if gained < GEODESIC.least_clearance_gain * state.arm.length:
        return None
    violated = now.step_bounds.violated_constraints + cleared.violated_constraints
    violated += avoidance.describe_violations(state)
    return _step_before_planning(state, now.target, cleared.dq, violated, "", cleared.stopping)


def _stop_on_path(now: _Situation) -> Step | None:
    """Brake on the path of a target that has jumped, where torques keep their limits; then plan."""
    before = now.before
    if before is None or before.timed.torques is None or before.timed.scheduled:
        return None
    if before.objective.target is now.target or is_small_change(before.objective, now.objective):
        return None
    step = now.stopping
    return None if step is None else now.remember_goal(step)


def _follow_path(now: _Situation) -> Step:
    """Take a step along a path, planning it first if needed."""
    controller = now.controller
    state = now.state
    before = now.before
    progress = controller._update(now)
    avoidance = now.avoidance(progress)
    if progress is not before and (avoidance is None or avoidance.still):
        step = fast_step(progress, state, now.bounds, now.previous, avoidance=avoidance)
        if step is not None:
            return now.remember_goal(step)
    candidate = propose(progress, state, now.bounds, now.step_bounds, avoidance)
    if now.torques is not None:
        avoidance = now.limits_alone if avoidance is None else avoidance
        if not now.torques.keep_limits(candidate.dq):
            constraints = StepConstraints.of(progress.objective, state, now.step_bounds, avoidance)
            dq, solution = _within_torques(progress.objective, constraints, now.torques, candidate.dq)
            candidate = candidate if solution is None else CandidateStep(dq, candidate.progress, solution)
    step = check_step(candidate, state, now.bounds, now.step_bounds, avoidance, progress)
    at_rest = now.previous is None or not np.any(now.previous)
    if avoidance is not None and at_rest and not (step.reason or np.any(step.dq)):
        step = _explain_collision(step, avoidance, state)
    return now.remember_goal(step)


def _within_torques(
    objective: Objective, constraints: StepConstraints, torques: StepTorques, dq: Array
) -> tuple[Array, Solution | None]:
    """Return the step within torque limits that is closest to one that exceeds them.

    Of those that torques allow, and as far as possible obstacles and constraints, measured by the kinetic
    energy of the difference, so that a joint whose torque is within its limit is not thrown to relieve
    another. If none is found, the step stays as it is.

    Returns:
        The step, (nv,) [rad or m], and the solution of its quadratic program; None if it stays.
    """
    chain = objective.chain
    hessian = scaled(torques.inertia[np.ix_(chain.columns, chain.columns)], chain.units)
    gradient = -hessian @ objective.normalize(dq)
    closest = dq
    solution = None
    for _ in range(GEODESIC.torque_iterations):
        matrix, least = torques.rows(closest)
        limits = ConstraintRows(objective.restrict(matrix), least)
        solution = solve(
            hessian, gradient, constraints.lower, constraints.upper, constraints.rows, hard=limits
        )
        if solution.x is None:
            return dq, None
        closest = objective.displacement(solution.x)
    return closest, solution


class Mode(NamedTuple):
    """A way to make a step.

    Attributes:
        name: what it does.
        when: when it applies, in words.
        take: returns the step, or None if the mode does not apply or cannot make one.
    """

    name: str
    when: str
    take: Callable[[_Situation], Step | None]


MODES = (
    Mode(
        "continue on the path", "the last step was on it, nothing has changed, all is clear", _continue_path
    ),
    Mode("go to the goal", "no acceleration limits, and the goal is one short step away", _go_to_goal),
    Mode(
        "pursue the goal",
        "acceleration limits, and a goal nearby that moves steadily; or it leads the arm",
        _pursue_goal,
    ),
    Mode("return into limits", "a joint is outside its position limits", _return_into_limits),
    Mode("back out", "the arm is in collision before there is a path", _back_out),
    Mode(
        "stop on the path", "torque limits, and the target has jumped; the arm plans at rest", _stop_on_path
    ),
    Mode("follow a path", "in all other cases; plans, bends or retimes the path first", _follow_path),
)
"""The modes of a step, in order: the first that returns a step makes it. See docs/design/modes.md."""


class PromptGeodesic(Geodesic):
    """Variant whose steps never plan but raise `PlanNeeded`; `plan_from` plans in another process."""

    plans: ClassVar[bool] = False


def plan_from(
    controller: Geodesic,
    arm: Arm,
    q: Array,
    target: Target,
    limits: Limits,
    previous: Array,
    needed: PlanNeeded,
) -> PathProgress:
    """Plan for a step that raised `PlanNeeded`, in another process.

    Args:
        controller: the controller.
        arm: the arm.
        q: configuration at which the path begins, (nq,).
        target: the target posture.
        limits: the limits of each step.
        previous: the step that leads to q, (nv,) [rad or m].
        needed: what the step raised, before `previous`.

    Returns:
        The progress at the start of the path, without objective and scene; see `adopt_plan`.
    """
    state = arm.chain_at(q)
    problem = controller._problem(controller.objective(arm, target), state, limits.for_arm(arm))
    rest = needed.rest
    if rest is not None:
        rest = np.vstack([np.zeros(arm.nv), rest[1:] - previous])
    path = controller._find_path(problem, needed.attempt, rest)
    progress = PathProgress.begin(path, limits, previous)
    bare: dict[str, Any] = {"objective": None, "scene": None}  # large to send, and the caller has them
    timed = replace(progress.timed, path=progress.path.revised(**bare))
    nothing = cast(Objective, None)
    return progress._replace(timed=timed, objective=nothing, expected=state.raw_positions)


def adopt_plan(
    controller: Geodesic,
    progress: PathProgress,
    arm: Arm,
    target: Target,
    limits: Limits,
    late: Memory | None,
) -> PathProgress:
    """Return the progress that `plan_from` returned, with objective and scene restored.

    Args:
        controller: as for `plan_from`.
        progress: the result of `plan_from`.
        arm: as for `plan_from`.
        target: as for `plan_from`.
        limits: as for `plan_from`.
        late: memory of an arm that arrived late at the start of the path and has braked; None: it is on time.
    """
    objective = controller.objective(arm, target)
    path = progress.path.revised(objective=objective, scene=controller.scene)
    if late is None:
        timed = replace(progress.timed, path=path, limits=limits, bounds=limits.for_arm(arm))
        return progress._replace(timed=timed, objective=objective)
    return PathProgress.begin(path, limits, late.dq)._replace(expected=progress.expected)


def _smallest_step(avoidance: Avoidance, constraints: StepConstraints) -> ClearStep:
    """Return the smallest step within bounds that keeps or makes the arm clear."""
    return avoidance.clear_step(constraints.state, _smallest_motion(avoidance, constraints))


def _smallest_motion(avoidance: Avoidance, constraints: StepConstraints) -> Array:
    """Return the smallest displacement within constraints by which the arm evades obstacles, (nv,)."""
    solver = ChainSolver(avoidance.objective, constraints.state, weight=0.0)
    rest = np.zeros(len(constraints.lower))
    nearest = solve_posture(solver, solver.covered(rest), 1.0, rest, constraints).x
    x = np.clip(rest, constraints.lower, constraints.upper) if nearest is None else nearest
    dq = avoidance.objective.displacement(x)
    torques = avoidance.torques_at(constraints.state)
    if torques is None or torques.keep_limits(dq):
        return dq
    return _within_torques(avoidance.objective, constraints, torques, dq)[0]


def _is_almost_inside(state: ChainState, bounds: JointBounds) -> bool:
    """Whether joints are outside their limits at most as far as noise and disturbances take an arm."""
    positions = state.raw_positions
    most = FOLLOWING.most_deviation * state.arm.joint_units
    lower, upper = bounds.position_limits
    return bool(np.all((positions >= lower - most) & (positions <= upper + most)))


def _rest(progress: PathProgress, state: ChainState) -> Array:
    """Return displacements from a state near a path to waypoints ahead, (N + 1, nv); the first is zero."""
    path = progress.path
    ahead = path.offsets[int(progress.s) + 1 :] - path.offset_of(state, progress.s)
    return np.vstack([np.zeros((1, ahead.shape[1])), ahead])


def _within(progress: PathProgress, now: _Situation) -> PathProgress:
    """Return the progress, retimed if the limits have changed."""
    timed = progress.timed
    return progress if timed.bounds is now.bounds else progress.retimed(timed.path, now.limits)


def _step_before_planning(
    state: ChainState,
    target: Target,
    dq: Array,
    violated_constraints: tuple[str, ...],
    reason: str,
    stopping: Array | None,
) -> Step:
    """Return a step to where a path can begin, with a memory of the step alone."""
    arm = state.arm
    active = tuple(int(k) for k in np.flatnonzero(target.has_target))
    after = state.moved(dq)
    return Step(
        dq,
        active,
        np.zeros(arm.nv, dtype=np.bool_),
        reason,
        error_increasing=_posture_error(after, target) > _posture_error(state, target),
        violated_constraints=violated_constraints,
        following_path=True,
        memory=GeodesicMemory(dq, stopping),
    )


def _explain_collision(step: Step, avoidance: Avoidance, state: ChainState) -> Step:
    """Return a step that does not move; if the arm is in collision, it says that no step leads out."""
    if avoidance.near(state).minimum >= 0.0:
        return step
    reason = f"the arm is in collision, and no step leads out: {avoidance.describe_closest(state)}"
    return step._replace(reason=reason)


def _are_alike(one: Target, other: Target) -> bool:
    """Whether two targets are equivalent."""
    if one is other:
        return True
    known = one.q is other.q if one.q is None or other.q is None else np.array_equal(one.q, other.q)
    return known and np.array_equal(one.points, other.points) and np.array_equal(one.weights, other.weights)


def _posture_error(state: ChainState, target: Target) -> float:
    return float(target.distances(state.points).sum())
