"""Whether an arm can come out of where it is if one of its joints sticks, or its drive is weak or limp."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from math import inf
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from pinposture._validation import (
    finite_array,
    require_function,
    require_instance,
    require_known,
    require_positive,
    require_whole,
)
from pinposture.arm import Arm, ChainState
from pinposture.collision import CollisionModel, Scene
from pinposture.collision.model import describe_distance
from pinposture.control import JointPath, Limits, plan
from pinposture.control.limits import JointBounds, require_limits
from pinposture.control.planner.avoidance import Avoidance
from pinposture.control.planner.damped_least_squares import PlanningProblem, minimize
from pinposture.control.planner.objective import Objective
from pinposture.control.planner.path_search import divide
from pinposture.errors import InvalidValue, no_warnings
from pinposture.placement import Target
from pinposture.task.falling import Fall, fall_of, require_falling
from pinposture.units import CONVERGED, ROUNDING

Array = NDArray[np.float64]


class RetreatSettings(NamedTuple):
    """How an arm is led back along the path by which it came."""

    spacing: float = 0.25
    """Largest motion of a control point from one posture of the way back to the next, in module lengths."""

    halvings: int = 3
    """How often a motion between them that is not clear is halved."""

    error: float = 1e-3
    """Mean distance of the control points from the way back at which a posture is close enough to it, in arm
    lengths."""

    near: float = 1.0
    """Largest distance of a control point from where it is outside, in module lengths, if an obstacle does
    not let the arm take the posture outside with the joint that is stuck."""

    hanging: float = 3e-4
    """Largest distance of a joint without torque from where it hangs, halfway between postures of a way, in
    `Arm.joint_units`. It moves a point at the end of an arm of 1 m by 0.3 mm."""

    hanging_halvings: int = 8
    """How often a motion with such a joint is halved; if that is not enough, it falls to another side."""

    recorded: float = 0.05
    """Motion of a joint from one recorded posture of the way in to the next, in `Arm.joint_units`.
    `can_retreat` checks the motion between them, and halves it where that is not clear."""

    max_recorded: int = 2000
    """Largest number of these postures; beyond it every second one is forgotten."""


RETREAT = RetreatSettings()

BACK = "the way back"
"""`JointPath.found_by` of a way along that by which the arm came."""


UNKNOWN_FALL = "falls, and weight does not tell where to (held by a brake, it would be stuck)"
"""Why no way is promised."""


class WayIn:
    """A record of the way by which an arm came to where it is, without detours from which it came back.

    Attributes:
        arm: the arm.
        rows: the recorded configurations, from where the record began, (n, nq).

    Args:
        arm: the arm.
    """

    def __init__(self, arm: Arm) -> None:
        self.arm = arm
        self.rows = np.zeros((0, arm.nq))

    def add(self, q: Array) -> None:
        """Add a configuration, (nq,), if the arm has moved since the last."""
        rows = self.rows
        if len(rows) and self._near(q, rows[-1:]).any():
            return
        near = np.flatnonzero(self._near(q, rows))
        if len(near):
            self.rows = rows[: int(near[0]) + 1]
            return
        self.rows = np.vstack([rows, q])
        if len(self.rows) > RETREAT.max_recorded:
            self.rows = self.rows[::2]

    def until(self, q: Array) -> Array:
        """Return the way in with a configuration, (nq,), at its end, (n, nq)."""
        ended = len(self.rows) and np.array_equal(self.rows[-1], q)
        return self.rows if ended else np.vstack([self.rows, q])

    def _near(self, q: Array, rows: Array) -> NDArray[np.bool_]:
        """Return which of configurations (n, nq) are near another one, (nq,)."""
        apart = np.abs(self.arm.difference(q, rows)) / self.arm.joint_units
        return np.asarray(apart.max(axis=1) < RETREAT.recorded)


class Retreat(NamedTuple):
    """The answer for one posture and one joint.

    Attributes:
        posture: the row of the posture.
        joint: name of the joint that fails there.
        position: where it stays, or comes to rest after a fall [rad or m].
        path: the way out, after a fall from where that ends; None if there is none, or none was found. With a
            joint that sticks, it is one for the arm in which this is locked (`Arm.with_locked`); with a weak
            one, for that with this torque limit (`Arm.with_effort`), or for the arm as it was if an end stop
            holds the joint.
        reason: what comes too close, and whether that excludes a way out; empty if there is one.
    """

    posture: int
    joint: str
    position: float
    path: JointPath | None
    reason: str

    def __repr__(self) -> str:
        way = self.reason if self.path is None else f"out by {self.path.found_by}"
        return f"Retreat(posture {self.posture}, {self.joint} at {self.position:.4g}: {way})"


@dataclass(frozen=True, eq=False)
class Retreats:
    """Whether an arm can come out of postures if one of its joints fails; true if it always can.

    Attributes:
        ways: the answers, posture by posture, and joint by joint from the base on.
    """

    ways: tuple[Retreat, ...]

    def __bool__(self) -> bool:
        return self.first is None

    @property
    def first(self) -> Retreat | None:
        """The first posture, and the joint, with which the arm cannot come out; None if it always can."""
        return next(iter(self.blocked), None)

    @property
    def blocked(self) -> tuple[Retreat, ...]:
        """The answers without a way out."""
        return tuple(way for way in self.ways if way.path is None)

    def __repr__(self) -> str:
        first = "" if self.first is None else f", first {self.first}"
        return f"Retreats({len(self.ways) - len(self.blocked)} of {len(self.ways)} ways out{first})"


def can_retreat(
    arm: Arm,
    q: ArrayLike,
    scene: Scene,
    failed: str | Sequence[str] | None = None,
    *,
    torque: float | Mapping[str, float] | None = None,
    postures: Sequence[int] | None = None,
    out: ArrayLike | None = None,
    limits: Limits | None = None,
    budget: float = inf,
    until_blocked: bool = False,
    progress: Callable[[int, int], object] | None = None,
) -> Retreats:
    """Tell whether an arm can come out of where it is if a joint fails there.

        retreats = pp.can_retreat(arm, run.q, scene)  # back to the start, with any one joint failed
        if not retreats:
            print(retreats.first)
        retreats = pp.can_retreat(arm, run.q, scene, torque=0.0)  # with any one drive without torque

    A joint that is stuck stays at its position, and the others move. Out is a posture outside, but for that
    joint: where only that joint tells inside from outside, the arm is out where it is. If something is in the
    way at that posture, one nearby will do, with no control point farther off than a module is long.

    The arm is led back along the path by which it came: each posture as it was then, or as near to it as the
    stuck joint and the obstacles allow. Where that ends, `plan` searches for another way. All ways are
    checked between postures as well.

    A way that is returned exists. Only an arm that overlaps an obstacle at the posture itself has none for
    certain. If none was found, one may exist all the same: `reason` says what was in the way.

    A joint whose drive is weak falls to where that can hold it, and the arm is led such that it can. One that
    is limp falls to where it hangs, and hangs on the way out, which has to be slow. Friction does not count.
    The arm must be clear as far as the joint swings without damping. No way is promised where weight does not
    tell where a joint hangs: hold it by a brake, and it is stuck.

    Args:
        arm: the arm.
        q: configurations in the order in which the arm goes in, (N, nq), such as `Run.q` or
            `JointPath.configurations`; or a single one, (nq,).
        scene: the obstacles, which rest, and their margin. Where the arm is closer to them at the posture, or
            outside while all joints work, the way out need not keep more than that.
        failed: the joint that fails, by its name in `Arm.joint_names`; or several, of which one fails. None:
            any one of the joints of the chain.
        torque: None: the joint sticks. Else its drive gives at most this torque or force [N m or N]: it is
            weak, or with 0, limp. One for all joints that may fail, or by their names; others then stick.
        postures: rows of q to come out of; None: all of them.
        out: where to come out: one configuration, (nq,), or several that will do, (n, nq). None: the first
            row of q.
        limits: the margin to position limits; `Limits()` if None.
        budget: time after which no other way is searched for a posture and joint [s]. The answer then depends
            on the speed of the machine; without a budget it is reproducible. A search can take
            tens of seconds.
        until_blocked: whether to end with the first posture from which the arm cannot come out.
        progress: called with the numbers of postures that are done, and of all.

    Returns:
        The answers; false if there is a posture and a joint without a way out.

    Raises:
        InvalidValue: an argument of the wrong type or shape, a single configuration without `out`, obstacles
            that move, a continuous joint, or with `torque`, one that others follow.
        UnknownName: a joint that is not on the chain.
        WeightUnknown: with `torque`, masses that are not known.
    """
    require_instance("arm", arm, Arm, "an Arm")
    require_instance("scene", scene, Scene, "a Scene(...)")
    if scene.velocities:
        raise InvalidValue("scene.velocities", sorted(scene.velocities), "obstacles that rest")
    require_function("progress", progress)
    if budget != inf:
        require_positive("budget", budget)
    require_instance("until_blocked", until_blocked, bool, "True or False")
    limits = require_limits(limits)
    rows = _configurations(arm, "q", q)
    if out is None and len(rows) == 1:
        raise InvalidValue("out", None, "a configuration outside, as q is a single one")
    outside = rows[:1] if out is None else _configurations(arm, "out", out)
    columns = _columns(arm, failed)
    torques = _torques(arm, columns, torque)
    ways = _Ways(arm, rows, scene, outside, limits, budget, torques)
    chosen = range(len(rows)) if postures is None else _rows(postures, len(rows))
    retreats: list[Retreat] = []
    for done, row in enumerate(chosen, start=1):
        retreats += [ways.find(row, column) for column in columns]
        if progress is not None:
            progress(done, len(chosen))
        if until_blocked and any(retreat.path is None for retreat in retreats):
            break
    return Retreats(tuple(retreats))


def _configurations(arm: Arm, name: str, given: ArrayLike) -> Array:
    """Return checked configurations, (N, nq)."""
    array = finite_array(name, given)
    rows = array[None] if array.ndim == 1 else array
    if rows.ndim != 2 or len(rows) == 0:
        raise InvalidValue(f"{name} (shape)", array.shape, f"({arm.nq},) or (N, {arm.nq})")
    return np.array([arm.checked(row, name) for row in rows])


def _columns(arm: Arm, failed: str | Sequence[str] | None) -> list[int]:
    """Return the degrees of freedom of joints that may fail, from base to tip."""
    moving = arm.columns[arm.limits.upper[arm.columns] > arm.limits.lower[arm.columns]]
    columns = {arm.joint_names[u]: int(u) for u in moving}
    if failed is None:
        return list(columns.values())
    names = [failed] if isinstance(failed, str) else failed
    require_instance("failed", names, Sequence, "the name of a joint, or several")
    if len(names) == 0:
        raise InvalidValue("failed", names, "at least one joint")
    for name in names:
        require_known("joint that moves", name, tuple(columns))
    return [column for name, column in columns.items() if name in names]


def _torques(
    arm: Arm, columns: Sequence[int], torque: float | Mapping[str, float] | None
) -> dict[int, float]:
    """Return the checked torques that drives still give, by degree of freedom; other joints stick."""
    if torque is None:
        return {}
    if isinstance(torque, Mapping):
        names = tuple(arm.joint_names[column] for column in columns)
        for name in torque:
            require_known("joint that may fail", name, names)
        torques = {
            columns[names.index(name)]: require_positive(f"torque[{name!r}]", left, zero=True)
            for name, left in torque.items()
        }
    else:
        torques = dict.fromkeys(columns, require_positive("torque", torque, zero=True))
    require_falling(arm, torques)
    return torques


def _rows(postures: Sequence[int], count: int) -> Sequence[int]:
    """Return checked rows."""
    require_instance("postures", postures, Sequence | np.ndarray, "rows of q")
    if len(postures) == 0:
        raise InvalidValue("postures", postures, "at least one row of q")
    return [require_whole("postures", row, 0, count - 1) for row in postures]


def _spaced(arm: Arm, rows: Array) -> NDArray[np.int64]:
    """Return the first row, and others between which control points move by `RETREAT.spacing` at most."""
    max_step = RETREAT.spacing * float(arm.chain.module_lengths.mean())
    points = np.array([arm.chain_at(q).points for q in rows])
    kept = [0]
    for row in range(1, len(rows) - 1):
        if np.linalg.norm(points[row + 1] - points[kept[-1]], axis=1).max() > max_step:
            kept.append(row)
    return np.array(kept)


def nearest_posture(
    state: ChainState, target: Target, scene: Scene, bounds: JointBounds, least: float | None = None
) -> ChainState:
    """Return the posture nearest to a target to which least squares lead from a state on.

    Args:
        state: the state.
        target: the target.
        scene: the obstacles.
        bounds: the limits of the joints.
        least: distance to keep from the obstacles [m]; None: the margin.
    """
    arm = state.arm
    objective = Objective(arm, target)
    problem = PlanningProblem(
        objective, state, bounds.position_limits, Avoidance.of(scene, objective, bounds)
    )
    allowed = 0.0 if least is None else max(0.0, scene.margin - least)
    return minimize(problem, state, RETREAT.error * arm.length, allowed).state


class _Ways:
    """Finds ways out.

    Args:
        arm: the arm, whose joints all work.
        rows: the way in, (N, nq).
        scene: the obstacles.
        outside: postures outside, (n, nq).
        limits: as for `can_retreat`.
        budget: likewise.
        torques: what drives still give, by degree of freedom [N m or N]; other joints stick.
    """

    def __init__(
        self,
        arm: Arm,
        rows: Array,
        scene: Scene,
        outside: Array,
        limits: Limits,
        budget: float,
        torques: Mapping[int, float],
    ) -> None:
        self._arm = arm
        self._rows = rows
        self._scene = scene
        self._outside = outside
        self._limits = limits
        self._budget = budget
        self._torques = torques
        self._model = CollisionModel(arm, scene)
        self._kept = _spaced(arm, rows)

    def find(self, row: int, column: int) -> Retreat:
        """Return the way out of a posture with a joint, given by its degree of freedom, that fails."""
        arm = self._arm
        q = self._rows[row]
        name = arm.joint_names[column]
        position = float(arm.positions(q)[column])
        begin = self._model.minimum(q)
        if begin.distance < 0.0:
            reason = f"at the posture, {describe_distance(begin.pair or (), begin.distance)}"
            return Retreat(row, name, position, None, reason)
        fall = Fall(position, position)
        torque = self._torques.get(column)
        if torque is not None:
            falls = fall_of(arm.chain_at(q), column, torque)
            if falls is None:
                return Retreat(row, name, position, None, f"{name} {UNKNOWN_FALL}")
            fall = falls
        drop = np.zeros((3, arm.nv))
        drop[1:, column] = np.array([fall.farthest, fall.rest]) - position
        kept = min(self._scene.margin, begin.distance)
        closest = self._model.minimum_on_motions(q, drop, np.inf, max(kept, 0.0))
        if np.any(drop) and closest.distance < max(kept, 0.0):
            reason = f"as {name} falls, {describe_distance(closest.pair or (), closest.distance)}"
            return Retreat(row, name, fall.rest, None, reason)
        fallen = arm.integrate(q, drop[-1])
        back = self._rows[self._kept[self._kept < row][::-1]]
        reasons = []
        for outside in self._outside:
            least = max(min(kept, self._model.minimum(outside).distance), 0.0) - ROUNDING * arm.length
            with no_warnings():  # the model of the arm whose joints all work has warned
                path = self._way(fallen, column, least).out(back, outside, self._budget)
            if isinstance(path, JointPath):
                return Retreat(row, name, fall.rest, path, "")
            reasons.append(path)
        return Retreat(row, name, fall.rest, None, "; or ".join(reasons))

    def _way(self, q: Array, column: int, least: float) -> _Way:
        """Return the way that begins at a configuration, (nq,), without a joint or with what is left of it.

        Args:
            q: the configuration, after its fall.
            column: the degree of freedom of the joint.
            least: distance to keep [m].
        """
        arm = self._arm
        name = arm.joint_names[column]
        torque = self._torques.get(column)
        if torque is None:
            locked = arm.with_locked({name: float(arm.positions(q)[column])})
            return _Way(locked, self._scene, self._limits, least, q)
        needed = abs(float(arm.chain_at(q).gravity_torques[column]))
        if torque == 0.0 or needed > (1.0 + CONVERGED) * torque:  # an end stop holds it
            return _HangingWay(arm, self._scene, self._limits, least, q, _Hanging(column, torque))
        known = self._limits.for_arm(arm).effort
        effort = np.full(arm.nv, np.inf) if known is None else np.array(known)
        effort[column] = min(effort[column], torque)
        described = np.array(arm.effort)
        described[column] = min(described[column], torque)
        efforts = zip(arm.joint_names, described.tolist(), strict=True)
        weak = arm.with_effort({each: most for each, most in efforts if most < np.inf})
        return _Way(weak, self._scene, replace(self._limits, effort=effort), least, q)


class _Way:
    """Leads an arm out of a posture.

    Args:
        arm: the arm, with a joint locked, or a lower torque limit.
        scene: the obstacles.
        limits: as for `can_retreat`.
        least: distance to keep [m].
        q: the posture, (nq,).
    """

    def __init__(self, arm: Arm, scene: Scene, limits: Limits, least: float, q: Array) -> None:
        self._arm = arm
        self._scene = scene
        self._limits = limits
        self._least = least
        self._bounds = limits.for_arm(arm)
        objective = Objective(arm, Target.from_configuration(arm, q))
        self._avoidance = Avoidance(CollisionModel(arm, scene), objective, self._bounds)
        self._start = q
        self._state = arm.chain_at(q)
        self._offsets = [np.zeros(arm.nv)]

    def out(self, back: Array, outside: Array, budget: float) -> JointPath | str:
        """Return the way out, or why there is none.

        Args:
            back: configurations to follow back, (n, nq).
            outside: the posture outside, (nq,).
            budget: time for a search beside the way back [s].
        """
        goal = self._without_joint(self._state, outside)
        blocked_by = self._blocked_by(goal)
        if blocked_by:
            nearby = self._nearby(goal, outside)
            if nearby is None:
                return f"outside, with the joint as it is, {blocked_by}, and no posture nearby would do"
            goal = nearby
        self._follow(back)
        end = self._end(goal, budget)
        if end.blocked_by:
            return f"{end.blocked_by}; there may be a way that was not found"
        return end

    def _nearby(self, goal: ChainState, outside: Array) -> ChainState | None:
        """Return a posture that the arm can take near one outside, (nq,); None if none is found."""
        target = Target.from_points(self._arm, self._arm.chain_at(outside).points)
        near = RETREAT.near * float(self._arm.chain.module_lengths.mean())
        for begin in (goal, self._state):
            fitted = self._fitted(begin, outside)
            off = np.linalg.norm(target.errors(fitted.points), axis=1).max()
            if off <= near and not self._blocked_by(fitted):
                return fitted
        return None

    def _blocked_by(self, state: ChainState) -> str:
        """Return why a posture cannot be taken: what comes too close, or a torque; empty if it can."""
        closest = self._avoidance.clearance.minimum(state.q)
        if closest.distance < self._least:
            return describe_distance(closest.pair or (), closest.distance)
        return "; ".join(self._avoidance.describe_broken(state))

    def _follow(self, back: Array) -> None:
        """Follow configurations, (n, nq), as far as the obstacles and the joint that fails let the arm."""
        before = self._start
        for q in back:
            if not self._follow_to(before, q, RETREAT.halvings):
                return
            before = q

    def _end(self, goal: ChainState, budget: float) -> JointPath:
        """Return the way on to a goal; `blocked_by` says what comes too close if none was found."""
        if self._move_to(goal):
            return self._path(goal, BACK)
        return self._search(goal, budget)

    def _search(self, goal: ChainState, budget: float) -> JointPath:
        """Return the way on to a goal that `plan` finds, as `_end`."""
        target = Target.from_configuration(self._arm, goal.q)
        path = plan(self._state, target, self._scene, self._limits, budget=budget, strict=False)
        before, _ = divide(np.array(self._offsets), self._arm.joint_units)
        offsets = np.concatenate([before, before[-1] + path.offsets[1:]])
        return replace(path, start=self._start, offsets=offsets, found_by=self._found_by(path))

    def _path(self, goal: ChainState, found_by: str) -> JointPath:
        """Return the way that was led, to a goal."""
        objective = Objective(self._arm, Target.from_configuration(self._arm, goal.q))
        offsets, _ = divide(np.array(self._offsets), self._arm.joint_units)
        return JointPath(objective, self._start, offsets, self._scene, found_by=found_by)

    def _found_by(self, path: JointPath) -> str:
        """Return how a way was found whose end another path is."""
        return f"{BACK}, {path.found_by}" if len(self._offsets) > 1 else path.found_by

    def _follow_to(self, before: Array, q: Array, halvings: int) -> bool:
        """Move to a configuration of the way back, (nq,), or near it; return whether the arm could.

        Args:
            before: the configuration of the way back that the arm was to take last, (nq,).
            q: the configuration; that of a joint that is not led does not count.
            halvings: how often the motion may be halved.
        """
        arm = self._arm
        if self._move_to(self._without_joint(self._state, q)) or self._move_to(self._fitted(self._state, q)):
            return True
        if halvings == 0:
            return False
        middle = arm.integrate(before, 0.5 * arm.difference(before, q))
        return self._follow_to(before, middle, halvings - 1) and self._follow_to(middle, q, halvings - 1)

    def _without_joint(self, state: ChainState, q: Array) -> ChainState:
        """Return the state at a configuration, (nq,), but for the joint that is not led."""
        limits = self._arm.limits
        change = self._arm.difference(state.q, q)
        return state.moved(np.where(limits.upper > limits.lower, change, 0.0))

    def _fitted(self, state: ChainState, q: Array) -> ChainState:
        """Return the posture of a configuration, (nq,), as nearly as the arm can take it from a state on."""
        target = Target.from_points(self._arm, self._arm.chain_at(q).points)
        return nearest_posture(state, target, self._scene, self._bounds_at(state), self._least)

    def _bounds_at(self, state: ChainState) -> JointBounds:
        """Return the limits of the joints that are led from a state on."""
        return self._bounds

    def _move_to(self, state: ChainState) -> bool:
        """Move straight to a state if that is clear; return whether it is."""
        change = np.asarray(self._arm.difference(self._state.q, state.q))
        motion = np.stack([np.zeros_like(change), change])
        if not self._avoidance.keeps(self._state.q, motion, self._least):
            return False
        self._offsets.append(self._offsets[-1] + change)
        self._state = state
        return True


class _Hanging(NamedTuple):
    """A joint, by its degree of freedom, and the largest torque or force of its drive [N m or N]."""

    column: int
    torque: float


class _HangingWay(_Way):
    """Leads an arm out with a joint that is not led: it is where its weight takes it.

    Args:
        arm: the arm.
        scene: the obstacles.
        limits: as for `can_retreat`.
        least: distance to keep [m].
        q: the posture, (nq,).
        hanging: the joint.
    """

    def __init__(
        self, arm: Arm, scene: Scene, limits: Limits, least: float, q: Array, hanging: _Hanging
    ) -> None:
        super().__init__(arm, scene, limits, least, q)
        self._column, self._torque = hanging

    def _without_joint(self, state: ChainState, q: Array) -> ChainState:
        limits = self._arm.limits
        change = np.where(limits.upper > limits.lower, self._arm.difference(state.q, q), 0.0)
        change[self._column] = 0.0
        moved = state.moved(change)
        return self._hung(moved) or moved

    def _fitted(self, state: ChainState, q: Array) -> ChainState:
        fitted = super()._fitted(state, q)
        return self._hung(fitted) or fitted

    def _bounds_at(self, state: ChainState) -> JointBounds:
        limits = self._bounds.position_limits.copy()
        limits[:, self._column] = state.positions[self._column]
        return replace(self._bounds, position_limits=limits)

    def _blocked_by(self, state: ChainState) -> str:
        if self._hung(state) is None:
            return f"{self._arm.joint_names[self._column]} {UNKNOWN_FALL}"
        return super()._blocked_by(state)

    def _search(self, goal: ChainState, budget: float) -> JointPath:
        arm = self._arm
        column = self._column
        name = arm.joint_names[column]
        at = float(self._state.positions[column])
        held = arm.difference(self._state.q, goal.q)
        held[column] = 0.0
        locked = arm.with_locked({name: at})
        state = locked.chain_at(self._state.q)
        target = Target.from_configuration(locked, state.moved(held).q)
        path = plan(state, target, self._scene, self._limits, budget=budget, strict=False)
        if path.blocked_by:
            return path
        found_by = self._found_by(path)
        for q in path.configurations[1:]:
            if not self._move_to(self._without_joint(self._state, q)):
                return replace(path, blocked_by=f"{name} would fall into something, or to another side")
        return self._path(goal, found_by)

    def _move_to(self, state: ChainState) -> bool:
        hung = self._hung(state)
        return hung is not None and self._hang_to(hung, RETREAT.hanging_halvings)

    def _hung(self, state: ChainState) -> ChainState | None:
        """Return a state with the joint where it comes to rest; None if weight does not tell where."""
        fall = fall_of(state, self._column, self._torque)
        if fall is None:
            return None
        change = np.zeros(self._arm.nv)
        change[self._column] = fall.rest - state.positions[self._column]
        return state.moved(change)

    def _hang_to(self, state: ChainState, halvings: int) -> bool:
        """Move to a state, with the joint at rest on the way; return whether the arm could."""
        half = 0.5 * np.asarray(self._arm.difference(self._state.q, state.q))
        middle = self._state.moved(half)
        hung = self._hung(middle)
        if hung is None:
            return False
        off = np.abs(self._arm.difference(middle.q, hung.q) / self._arm.joint_units).max()
        if off <= RETREAT.hanging:
            return super()._move_to(state)
        return halvings > 0 and self._hang_to(hung, halvings - 1) and self._hang_to(state, halvings - 1)
