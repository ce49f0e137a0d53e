"""The default controller: plans the most direct path, and follows it within limits and around obstacles."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, replace
from math import isfinite, sqrt

import numpy as np
from numpy.typing import NDArray

from pinposture import kernels
from pinposture._validation import require_positive
from pinposture.arm import ArmState
from pinposture.collision import CollisionModel, Scene
from pinposture.control.controller import Diagnostics, Memory, Step
from pinposture.control.limits import JointBounds, Limits, StepBox
from pinposture.control.planner.avoidance import Avoidance, solve
from pinposture.control.planner.follow import RISES, CandidateStep, Scope, close_in, fast_step, follow
from pinposture.control.planner.objective import Posture
from pinposture.control.planner.path import JointPath, PathProgress
from pinposture.control.planner.plan import moved_little, plan, plan_on
from pinposture.control.tasks import ControlTask
from pinposture.errors import InvalidValue
from pinposture.placement import Target

Array = NDArray[np.float64]

WAIT, MAX_PLANS = 1.0, 3
"""Joint travel without getting on after which another way is looked for [rad], and how many are."""

GAIN = 1e-4
"""Least distance that a step out of an obstacle gains, in arm lengths; else a path is planned from there."""

MAX_JOINT_WEIGHT = 1e6
"""Haste beyond which numbers overflow; it is joint interpolation long before."""

_ANY_STEP = np.array([[-np.inf], [np.inf]])


@dataclass(frozen=True)
class Geodesic:
    """Takes the arm along the most direct way to its target, by a constrained least-squares step at a time.

    Before it moves, it settles where to go: the configuration that the target knows, or the one that comes
    closest to its points; and on what way: the one on which the control points travel least
    (`trajectory_optimization`). Each step then is the solution of a convex quadratic program: of all
    steps that the limits of speed, position and acceleration allow, and that lose no more than a share of
    the distance to any obstacle, the one that is nearest to the step along the way in what control points
    and chords feel. Where nothing hinders, that is the step along the way itself. At the end of the way, what
    errors are left are reduced by damped least squares within the same limits.

    The way is planned again when the target changes, and when the arm does not get on.

    What gives way where not all can hold, named in `Diagnostics.violated_constraints`: tasks and posture
    first, by their weights, strict tasks after the others; then the margin to obstacles, of which each step
    regains what it can; then limits of acceleration, where braking would touch something, and of position,
    as `Limits.box` says. Limits of speed never do.

    Attributes:
        joint_weight: weight of the motion of joints against that of control points: how far, in module
            lengths, all control points may move to save one radian of a joint. Smaller values let joints go
            longer ways so that points go straighter, down to about 0.05; below that only the number of steps
            grows. Large values lead to joint interpolation.
        relative_position_weight: weight of the squared error of a chord, where that of a point has weight 1.
        tasks: what else the arm is asked to do.
        scene: what to keep clear of; nothing if None. `track(..., scene=)` sets it.
    """

    joint_weight: float = 0.2
    relative_position_weight: float = 1.0
    tasks: tuple[ControlTask, ...] = ()
    scene: Scene | None = None
    name: str = "geodesic"

    def __post_init__(self) -> None:
        require_positive("joint_weight", self.joint_weight)
        if self.joint_weight > MAX_JOINT_WEIGHT:
            raise InvalidValue("joint_weight", self.joint_weight, f"at most {MAX_JOINT_WEIGHT:g}")
        require_positive("relative_position_weight", self.relative_position_weight, zero=True)
        tasks = tuple(self.tasks) if isinstance(self.tasks, Iterable) else (self.tasks,)
        for task in tasks:
            if isinstance(task, type) or not callable(getattr(task, "rows", None)):
                raise InvalidValue("tasks", task, "EndEffector(...), Tangents(...) or JointPosture(...)")
        object.__setattr__(self, "tasks", tasks)
        if not (self.scene is None or isinstance(self.scene, Scene)):
            raise InvalidValue("scene", self.scene, "a Scene(...), or None")

    def with_scene(self, scene: Scene | None) -> Geodesic:
        """The same controller in another scene."""
        return replace(self, scene=scene)

    def step(
        self, state: ArmState, target: Target, limits: Limits | None = None, memory: Memory | None = None
    ) -> Step:
        """Compute one step; see `Controller.step`. The first one for a target takes longer: it plans."""
        limits = Limits() if limits is None else limits
        _check_given(state, target, memory)
        state = state.compiled
        bounds = limits.for_arm(state.arm)
        before = memory.own if memory is not None and isinstance(memory.own, PathProgress) else None
        if before is not None and before.bounds is bounds and self._goes_on(before, state, target):
            step = fast_step(before, state, bounds)
            if step is not None:
                return step
        previous = memory.dq if memory is not None else None
        box = limits.box(state, previous)
        if box.outside:
            return self._return(state, target, box, bounds, previous)
        if before is None and self.scene is not None:
            step = self._back_out(state, target, box, bounds, previous)
            if step is not None:
                return step
        progress = self._progress(state, target, bounds, before)
        if before is None or progress.path.start is not before.path.start:
            progress = progress.under_way(previous)
        posture, avoidance = progress.posture, self._avoidance(progress.posture, bounds, previous)
        if avoidance is None and progress is not before:
            step = fast_step(progress, state, bounds)
            if step is not None:
                return step
        if progress.arrived:
            asked = close_in(progress, Scope.of(posture, state, box, avoidance))
        else:
            asked = follow(progress, state, box, limits, self._mu(state), avoidance)
        return _checked(asked, state, box, bounds, avoidance, progress)

    def along(
        self,
        state: ArmState,
        path: JointPath,
        target: Target,
        limits: Limits,
        most: float,
        memory: Memory | None = None,
    ) -> Memory:
        """What to remember for steps along a way that is given, with a target that moves along it.

        The steps that follow stay on that way, as fast as limits and time allow, whatever target they are
        given, until its end. An arm that is not where it should be, or does not get on, leaves it: it then
        plans a way of its own to the target (`PathProgress.given` tells).

        Args:
            state: where the arm is, at the beginning of the way.
            path: the way.
            target: the target posture where it begins.
            limits: what a step may not exceed.
            most: the most waypoints to go in one step, finite.
            memory: `memory` of the step before; None: the arm is at rest.
        """
        target.check(state.arm)
        bounds, posture = (
            limits.for_arm(state.arm),
            Posture(state.arm, target, self.tasks, self.relative_position_weight),
        )
        progress = PathProgress(posture, path, bounds, most=most, expected=state.forward.positions).within(
            bounds
        )
        memory = Memory(np.zeros(state.arm.nv)) if memory is None else memory
        return memory._replace(own=progress)

    def _goes_on(self, progress: PathProgress, state: ArmState, target: Target) -> bool:
        """Whether that is what the arm was doing, and nothing else is asked of it."""
        alone = not self.tasks and self.scene is None and progress.waited < WAIT
        return alone and progress.posture.target is target and progress.posture.arm is state.arm

    def _return(
        self, state: ArmState, target: Target, box: StepBox, bounds: JointBounds, previous: Array | None
    ) -> Step:
        """A step back into the position limits, by the joints that are outside; the way begins there."""
        arm = state.arm
        target.check(arm)
        dq, relaxed = np.zeros(arm.nv), box.violated_constraints
        dq[arm.columns] = np.clip(dq, box.lower, box.upper)[arm.columns]
        avoidance, share, stopping = self._avoidance(Posture(arm, target), bounds, previous), 1.0, None
        if avoidance is not None:
            dq, share, stopping, gave_way = avoidance.kept(state, dq)
            if share < 1.0:
                relaxed += ("position limits: coming back faster would come too close to something",)
            relaxed += gave_way
        reason = "" if np.any(dq) else "joints are outside their limits, and something is in their way back"
        return _step_before_planning(state, target, dq, share, relaxed, reason, stopping)

    def _back_out(
        self, state: ArmState, target: Target, box: StepBox, bounds: JointBounds, previous: Array | None
    ) -> Step | None:
        """The smallest step that takes the arm out of what it is inside of; the path begins there.

        No path is planned from inside an obstacle: none would be clear.

        Returns:
            None if the arm is inside of nothing, or if no such step gains anything.
        """
        target.check(state.arm)
        posture = Posture(state.arm, target)
        avoidance = self._avoidance(posture, bounds, previous)
        if avoidance is None or avoidance.near(state).minimum >= 0.0:
            return None
        scope, n = Scope.of(posture, state, box, avoidance), len(posture.columns)
        found = solve(np.eye(n), np.zeros(n), scope.lower, scope.upper, scope.rows).x
        if found is None:
            return None
        dq, share, stopping, gave_way = avoidance.kept(state, posture.displacement(found))
        after = state.arm.at(state.arm.integrate(state.q, dq)).compiled
        gained = avoidance.clearance.minimum(after.q).distance - avoidance.near(state).minimum
        if gained < GAIN * state.arm.length:
            return None
        relaxed = box.violated_constraints + gave_way + avoidance.too_close(state)
        return _step_before_planning(state, target, dq, share, relaxed, "", stopping)

    def _avoidance(
        self, posture: Posture, bounds: JointBounds, previous: Array | None = None
    ) -> Avoidance | None:
        if self.scene is None:
            return None
        return Avoidance(CollisionModel(posture.arm, self.scene), posture, bounds, previous)

    def _progress(
        self, state: ArmState, target: Target, bounds: JointBounds, progress: PathProgress | None
    ) -> PathProgress:
        """The progress so far; a new one at first, for a new target, and where the arm does not get on."""
        if progress is None or not progress.leads_on(state):
            progress = None
        elif progress.given and not progress.arrived:
            if progress.waited < WAIT:
                progress = progress._replace(posture=self._posture(state, target, progress))
                return progress if progress.bounds is bounds else progress.within(bounds)
            progress = None
        elif _alike(progress.posture.target, target):
            if progress.posture.tasks != self.tasks:  # as they do where they follow something: the way stays
                progress = progress._replace(posture=self._posture(state, target))
            if progress.waited < WAIT or progress.arrived:
                return progress if progress.bounds is bounds else progress.within(bounds)
            tries, posture = progress.tries + 1, progress.posture
            if tries >= MAX_PLANS or progress.place >= progress.path.end:
                return progress._replace(arrived=True)
            return plan(posture, state, bounds, self._avoidance(posture, bounds), self._mu(state), tries)
        target.check(state.arm)
        posture = self._posture(state, target, progress)
        avoidance, mu = self._avoidance(posture, bounds), self._mu(state)
        if progress is not None and posture.plain and (avoidance is None or moved_little(progress, posture)):
            return plan_on(progress, posture, state, bounds, mu, avoidance)
        return plan(posture, state, bounds, avoidance, mu)

    def _posture(self, state: ArmState, target: Target, progress: PathProgress | None = None) -> Posture:
        """What is asked of the arm; that of a progress is taken on where only the target is another."""
        if progress is not None:
            known = progress.posture
            if (
                known.tasks == self.tasks == ()
                and known.relative_position_weight == self.relative_position_weight
                and known.arm is state.arm
            ):
                return known.moved_to(target)
        return Posture(state.arm, target, self.tasks, self.relative_position_weight)

    def _mu(self, state: ArmState) -> float:
        """Weight of joint motion [m per `Arm.joint_units`]: `joint_weight` module lengths for each point."""
        return self.joint_weight * state.arm.length / sqrt(state.arm.n_modules)


def _step_before_planning(
    state: ArmState,
    target: Target,
    dq: Array,
    share: float,
    violated_constraints: tuple[str, ...],
    reason: str,
    stopping: Array | None,
) -> Step:
    """A step that leads to where a path can begin; nothing is remembered but the step."""
    arm, active = state.arm, Posture(state.arm, target).active
    after = arm.at(arm.integrate(state.q, dq)).compiled
    diagnostics = Diagnostics(
        manipulability=0.0,
        sigma_min=0.0,
        sigma_max=0.0,
        rows=len(active) * arm.dimension,
        dropped=(),
        scale=share,
        clipped=np.zeros(arm.nv, dtype=np.bool_),
        reason=reason,
        error_increasing=_posture_error(after, target) > _posture_error(state, target),
        violated_constraints=violated_constraints,
        following_path=True,
    )
    return Step(dq, active, diagnostics, Memory(dq, None, stopping))


def _checked(
    asked: CandidateStep,
    state: ArmState,
    box: StepBox,
    bounds: JointBounds,
    avoidance: Avoidance | None,
    begun: PathProgress,
) -> Step:
    """The step as it leaves: finite, within its limits and clear, whatever was computed before."""
    arm, progress = state.arm, asked.progress
    dq, relaxed, share = asked.dq, box.violated_constraints, 1.0
    stopping: Array | None = None
    near: tuple[str, ...] = ()
    if not isfinite(dq @ dq):
        dq = np.nan_to_num(dq, nan=0.0, posinf=0.0, neginf=0.0)
    if avoidance is not None:
        dq[arm.columns] = np.minimum(np.maximum(dq, box.lower), box.upper)[arm.columns]
        wanted = dq
        dq, share, stopping, gave_way = avoidance.kept(state, wanted)
        if share < 1.0 and not progress.arrived:
            done = float(np.clip((dq @ wanted) / max(float(wanted @ wanted), 1e-300), 0.0, 1.0))
            gone = begun.gone_to(begun.place + done * (progress.place - begun.place), bounds.travel, True)
            progress = progress._replace(
                place=gone.place, speed=gone.speed, passed=gone.passed, waited=gone.waited
            )
        relaxed += gave_way + avoidance.too_close(state)
        near = avoidance.holding(state, asked.solution, bool(asked.reason))
        near += (progress.hindrance,) if progress.hindrance else ()
    chain, placed, posture = arm.kinematics, state.forward, progress.posture.chain
    reached, at_limit = np.empty(arm.nv), np.empty(arm.nv, dtype=np.bool_)
    sides = box.sides if share == 1.0 else _ANY_STEP * np.ones((2, arm.nv))
    given = placed.positions, bounds.units, sides, bounds.edges, placed.points, posture.targets, posture.flags
    before, after = kernels.look_ahead(chain.constants, *given, dq, reached, at_limit)
    active = progress.posture.active
    diagnostics = Diagnostics(
        manipulability=0.0,
        sigma_min=0.0,
        sigma_max=0.0,
        rows=len(active) * arm.dimension,
        dropped=(),
        scale=share,
        clipped=at_limit,
        reason=asked.reason,
        error_increasing=after > before + RISES * arm.length,
        violated_constraints=relaxed,
        near=near,
        following_path=not progress.arrived and progress.waited == 0.0,
    )
    return Step(dq, active, diagnostics, Memory(dq, progress._replace(expected=reached), stopping))


def _check_given(state: ArmState, target: Target, memory: Memory | None) -> None:
    if not isinstance(state, ArmState):
        raise InvalidValue("state", state, "an ArmState, as `arm.at(q)` returns it")
    if not isinstance(target, Target):
        raise InvalidValue("target", target, "a Target, as `resolve_targets` returns it")
    if not (memory is None or isinstance(memory, Memory)):
        raise InvalidValue("memory", memory, "`step.memory` of the step before, or None")


def _alike(one: Target, other: Target) -> bool:
    """Whether two targets ask for the same."""
    if one is other:
        return True
    known = one.q is other.q if one.q is None or other.q is None else np.array_equal(one.q, other.q)
    return known and np.array_equal(one.points, other.points) and np.array_equal(one.weights, other.weights)


def _posture_error(state: ArmState, target: Target) -> float:
    return float((np.linalg.norm(target.points - state.points, axis=1) * target.has_target).sum())
