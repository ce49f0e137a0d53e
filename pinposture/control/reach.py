"""Inverse kinematics: clear postures with the tip, or some control points, at a goal, and paths to them."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace
from functools import cached_property, lru_cache, partial
from math import inf
from time import perf_counter
from typing import Any, Literal, NamedTuple

import numpy as np
import pinocchio as pin
from numpy.typing import ArrayLike, NDArray

from pinposture._validation import (
    as_vector,
    require_instance,
    require_known,
    require_positive,
    require_whole,
)
from pinposture._validation import direction as unit_vector
from pinposture.arm import Arm, ArmState, ChainState, JointLoad, smooth_configuration
from pinposture.collision import CollisionModel, Scene
from pinposture.collision.scene import obstacles_around
from pinposture.control.limits import Limits
from pinposture.control.planner.damped_least_squares import POSTURE_SEARCH, damped_hessian
from pinposture.control.planner.path import JointPath
from pinposture.control.planner.plan import plan
from pinposture.control.tasks import ComparableTask, EndEffector, TaskRows, link_axes
from pinposture.control.torque_limits import TorqueLimits
from pinposture.descent import Rating, descend
from pinposture.errors import InvalidValue, OutOfReach, ReachError, gather, raise_together
from pinposture.placement import Target
from pinposture.quadratic_program import solve
from pinposture.units import CONVERGED, length_text

Array = NDArray[np.float64]


class PostureSearchSettings(NamedTuple):
    """How postures that reach a goal with the tip are searched, chosen and improved."""

    distinct: float = 0.05
    """Largest distance between corresponding points beyond which two postures are distinct, in arm
    lengths."""

    seeds_per_wave: int = 24
    chosen: int = 6
    max_waves: int = 40
    max_idle_waves: int = 3
    """Seed postures per wave, how many of them are pushed clear, the largest number of waves, and the
    number of consecutive waves without a new posture that end the search once one is known."""

    near_waves: int = 4
    """Largest number of waves after a descent from a given posture. The descent alone reached 160 of 160
    goals, positions in random postures of arms with joint limits of 0.1 to 0.6 rad."""

    spare: int = 3
    """Number of postures searched beyond `count`, to choose from."""

    seed_amplitudes: tuple[float, float] = 0.15, 1.3
    """Range of the amplitudes of smooth seed postures, in `Arm.joint_units`."""

    few_joints: int = 8
    """Largest number of joints for which seed postures are uniformly random."""

    max_joint_motion: float = 0.3
    """Largest joint motion of one iteration, in `Arm.joint_units`."""

    tip_iterations: int = 40
    clear_iterations: int = 80
    polish_iterations: int = 12
    """Iterations to bring the tip to its goal, to push the arm clear, and to improve a posture."""

    buffer: float = 1e-4
    """Clearance sought beyond the margin, in arm lengths, so that rounding does not violate the margin."""

    ample: float = 0.05
    """Clearance beyond which more does not raise the score, in arm lengths."""

    near_limit_share: float = 0.7
    """Distance from mid-range beyond which a joint is pulled back, in half ranges."""

    manipulability_gain: float = 2e-3
    """Joint motion of one iteration along the gradient of the logarithm of the manipulability measure."""


SEARCH = PostureSearchSettings()


@dataclass(frozen=True, eq=False)
class ReachedPosture:
    """A clear posture with the tip, or the control points of a target, at the goal.

    Attributes:
        q: the configuration, (nq,) [rad or m], at the end of the path if there is one.
        target: the posture as a target, for `plan` and `track`.
        path: the path to it from the start; None without a start. If no clear path was found, its
            `blocked_by` names the pair that comes too close.
        error: distance of the tip from its goal, or the largest of a control point [m].
        clearance: smallest distance from obstacles, and between parts of the arm if the scene includes
            self-collision [m]; infinite without a scene.
        limit_distance: smallest distance of a joint from its limit, in half ranges, in [0, 1]; 1 if no joint
            has limits.
        manipulability: index of the tip (see `Ellipsoid.index`), in [0, 1]; 0 in a singular posture.
        path_ratio: length of the path in joint space over that of the straight line; None without a path.
        load: the joint that is loaded most, in relation to its torque limit, when the arm is held there; None
            if masses or torque limits are not known.
        score: in [0, 1]: mean of clearance (1 from a twentieth of the arm length), limit distance,
            manipulability, and the inverse of the path ratio if there is a path. With the objective "torque",
            one minus the largest share of a torque limit. Postures with a clear path rank before those
            without.
    """

    q: Array
    target: Target
    path: JointPath | None
    error: float
    clearance: float
    limit_distance: float
    manipulability: float
    path_ratio: float | None
    score: float
    load: JointLoad | None = None

    def summary(self) -> dict[str, Any]:
        """Return the posture as JSON-compatible data [m, rad]."""
        path = self.path
        return {
            "kind": "posture",
            "q": self.q.tolist(),
            "error": self.error,
            "clearance": self.clearance,
            "limit_distance": self.limit_distance,
            "manipulability": self.manipulability,
            "path_ratio": self.path_ratio,
            "score": self.score,
            "holding_torque": None if self.load is None else self.load.as_data(),
            "path": None if path is None else path.configurations.tolist(),
            "blocked_by": None if path is None else path.blocked_by,
        }

    def __repr__(self) -> str:
        way = "" if self.path is None else f", path {self.path.blocked_by or 'clear'}"
        error = length_text(self.error)
        heavy = f", {self.load}" if self.load is not None and self.load.exceeded else ""
        clear = f", clearance {length_text(self.clearance)}" if np.isfinite(self.clearance) else ""
        return f"ReachedPosture(tip {error} off{clear}{heavy}, score {self.score:.3g}{way})"


def reach(
    arm: Arm,
    goal: Any,
    *,
    direction: ArrayLike | None = None,
    scene: Scene | None = None,
    start: ArrayLike | None = None,
    count: int = 1,
    seed: int = 0,
    budget: float = 5.0,
    tolerance: float | None = None,
    limits: Limits | None = None,
    objective: Literal["dexterity", "torque"] = "dexterity",
) -> tuple[ReachedPosture, ...]:
    """Find clear postures that bring the tip, or chosen control points, to a goal, and the paths to them.

    Damped least squares bring them to the goal from many postures, including the start, first without
    obstacles. The postures that intrude least are pushed clear, then improved in the null space: clearance,
    distance from joint limits, and manipulability or the torques that hold the arm. The search is not
    complete: it can miss postures.

    Args:
        arm: the arm.
        goal: the goal of the tip: a position (3,) [m], or a pose as a `pin.SE3` or a rigid transform (4, 4),
            world frame. Or a `Target`, whose control points with a weight are to be met, for instance a
            region of a curve, `target.region(0, 7)`.
        direction: direction of the last link at the goal, (3,), world frame, if the goal is a position.
        scene: the obstacles and their margin; None: no obstacles.
        start: the current configuration, (nq,), at which the paths begin. None: no paths.
        count: number of distinct postures wanted. Fewer are returned if no more are found.
        seed: seed of the random numbers.
        budget: total time [s]. If it ends the search, the result depends on the speed of the machine;
            otherwise it is reproducible for a given seed.
        tolerance: largest distance of the tip from its goal, or root of the summed squares of several points
            [m]; a rotation counts as the arc at a radius of `Arm.characteristic_length`. A millionth of the
            arm length if None.
        limits: the margin to position limits, and the torque limits that the postures and paths keep;
            `Limits()` if None.
        objective: "dexterity" prefers postures in which the tip can move in all directions; "torque" those
            in which the motors need the smallest shares of their torque limits: those of `limits`, or else of
            the arm.

    Returns:
        1 to `count` postures, the best first. In any two of them, some point of the arm differs by at least
        a twentieth of the arm length.

    Raises:
        InvalidValue: an argument of the wrong type, or one that does not fit the arm.
        OutOfReach: the goal is farther away than the arm reaches, or off the plane of a planar arm.
        ReachError: no clear posture was found; the message says how close the search came.
        UnknownName: no such objective.
        WeightUnknown: the objective "torque" without masses or torque limits.
    """
    began = perf_counter()
    require_instance("arm", arm, Arm, "an Arm")
    if not (scene is None or isinstance(scene, Scene)):
        raise InvalidValue("scene", scene, "a Scene(...), or None")
    if not (limits is None or isinstance(limits, Limits)):
        raise InvalidValue("limits", limits, "a Limits(...), or None")
    require_known("objective", objective, ("dexterity", "torque"))
    if objective == "torque":
        arm.require_masses()
        if limits is None or limits.effort is None:
            arm.require_effort()
    require_whole("count", count, 1)
    require_whole("seed", seed, 0)
    require_positive("budget", budget)
    allowed_error = CONVERGED * arm.length if tolerance is None else require_positive("tolerance", tolerance)
    sought = _Goal.of(arm, goal, direction)
    limits = Limits() if limits is None else limits
    first = None if start is None else arm.checked_start(start, "start")
    _check_in_reach(arm, sought, allowed_error, scene)
    until = began + (budget if first is None else 0.5 * budget)
    search = _Search(arm, sought, scene, limits, allowed_error, objective)
    postures = search.find(first, count + SEARCH.spare, np.random.default_rng(seed), until)
    if first is None:
        return tuple(postures[:count])
    reached: list[ReachedPosture] = []
    for posture in postures:
        clear = sum(not posture.path.blocked_by for posture in reached if posture.path)
        left = began + budget - perf_counter()
        if clear >= count or (reached and left <= 0.0):
            break
        share = max(left, 0.05 * budget) / max(count - clear, 1)
        reached.append(search.with_path(posture, first, share))
    reached.sort(key=lambda posture: (bool(posture.path and posture.path.blocked_by), -posture.score))
    return tuple(reached[:count])


def reach_from(
    arm: Arm,
    goal: ArrayLike,
    start: ArrayLike,
    scene: Scene | None = None,
    limits: Limits | None = None,
    direction: ArrayLike | None = None,
) -> ReachedPosture | None:
    """Find a clear posture with the tip at a goal by one descent, fast enough to drag the goal.

    Args:
        arm: the arm.
        goal: the goal of the tip, (3,) [m], world frame, or a pose, as for `reach`.
        start: the initial posture, (nq,).
        scene: the obstacles and their margin; None: no obstacles.
        limits: the margin to position limits; `Limits()` if None.
        direction: as for `reach`.

    Returns:
        The posture, without a path; None if the descent misses the goal or violates the margin.

    Raises:
        InvalidValue: an argument does not fit the arm.
        OutOfReach: the goal is out of reach.
        ReachError: the goal is inside an obstacle.
    """
    tip = _Goal.of_tip(tip_task(arm, goal, direction))
    tolerance = CONVERGED * arm.length
    _check_in_reach(arm, tip, tolerance, scene)
    search = _Search(arm, tip, scene, Limits() if limits is None else limits, tolerance)
    state = arm.chain_at(arm.checked_start(start, "start"))
    return search.descend(state)


def bring_to_goal(arm: Arm, task: EndEffector, state: ChainState) -> tuple[ChainState, float]:
    """Bring a control point to its goal by damped least squares from a posture, then from seed postures.

    Obstacles are ignored, as in the first part of `reach`.

    Args:
        arm: the arm.
        task: the goal of the control point.
        state: the posture to begin with, and to stay near.

    Returns:
        The state, and its distance from the goal [m], with rotations times their lever arm. If the descent
        from `state` misses the goal, the state is the nearest to it of those that reach the goal from a wave
        of seed postures; if none does, the one that comes closest to the goal.
    """
    search = _Search(arm, _Goal.of_tip(task), None, Limits(), CONVERGED * arm.length)
    waves = SEARCH.near_waves
    try:
        require_within_reach(arm, task)
    except OutOfReach:
        waves = 0
    return search.bring_near(state, waves, np.random.default_rng(0))


def tip_task(arm: Arm, goal: Any, direction: ArrayLike | None) -> EndEffector:
    """Return the task of bringing the tip to the goal."""
    if isinstance(goal, pin.SE3) or np.shape(goal) == (4, 4):
        if direction is not None:
            raise InvalidValue("direction", direction, "None where the goal is a pose")
        return EndEffector(pose=goal)
    position = as_vector("goal", goal)
    if direction is None:
        return EndEffector(position=position)
    link = link_axes(arm).links[-1]
    turn = pin.Quaternion.FromTwoVectors(link, np.array(unit_vector("direction", direction))).matrix()
    return EndEffector(pose=pin.SE3(turn, position), direction_only=True)


@dataclass(frozen=True, eq=False)
class _PointPositions(ComparableTask):
    """Bring the control points that a target weights to their positions.

    Attributes:
        goal: the target.
        weight: weight of the squared error of each row.
    """

    goal: Target
    weight: float = 1.0

    def rows(self, state: ArmState, target: Target) -> TaskRows:
        """Return the rows of one point after the other; see `ControlTask.rows`."""
        plane = state.arm.plane
        active = self.goal.has_target
        apart = self.goal.errors(state.points)[active] @ plane.T
        jacobian = plane @ state.jacobians[active]
        return TaskRows(jacobian.reshape(apart.size, -1), apart.ravel())


class _Goal(NamedTuple):
    """Where a search brings control points.

    Attributes:
        task: the task of bringing them there.
        points: their indices, (k,).
        positions: their positions there, (k, 3) [m].
        who: what they are called in messages.
    """

    task: EndEffector | _PointPositions
    points: NDArray[np.intp]
    positions: Array
    who: str

    @classmethod
    def of_tip(cls, task: EndEffector) -> _Goal:
        """Return the goal of the tip."""
        return cls(task, np.array([-1]), _position_of(task)[None], "the tip")

    @classmethod
    def of(cls, arm: Arm, goal: Any, direction: ArrayLike | None) -> _Goal:
        """Return the goal of the tip, or of the control points of a target, from arguments of `reach`."""
        if not isinstance(goal, Target):
            return cls.of_tip(tip_task(arm, goal, direction))
        if direction is not None:
            raise InvalidValue("direction", direction, "None where the goal is a Target")
        goal.check(arm)
        active = np.flatnonzero(goal.has_target)
        return cls(_PointPositions(goal), active, goal.points[active], "the control points")

    def distance(self, points: Array) -> float:
        """Return the largest distance of a control point, of all (m, 3), from where it should be [m]."""
        return float(np.linalg.norm(points[self.points] - self.positions, axis=1).max())


def _position_of(task: EndEffector) -> Array:
    return np.asarray(task.position if task.pose is None else task.pose[:3, 3])


def require_within_reach(arm: Arm, task: EndEffector, tolerance: float = 0.0) -> None:
    """Raise OutOfReach for a goal that is farther from the base than the arm is long, by a tolerance [m]."""
    position = _position_of(task)
    away = float(np.linalg.norm(position - arm.chain.base))
    most = arm.length + arm.travel
    if away > most + max(tolerance, CONVERGED * arm.length):
        advice = "is it in millimetres, not metres?" if away > 100.0 * most else "choose a nearer one"
        base = ", ".join(f"{coordinate:.4g}" for coordinate in arm.chain.base)
        where = f"it is {length_text(away)} from the base at ({base}) m"
        reason = f"{where}, and the arm reaches {length_text(most)}; {advice}"
        raise OutOfReach(position, reason)


def _check_in_reach(arm: Arm, goal: _Goal, tolerance: float, scene: Scene | None) -> None:
    """Refuse goals that no posture can reach."""
    checks = [partial(_check_outside, scene, position, goal.who) for position in goal.positions]
    if isinstance(goal.task, EndEffector):
        checks.insert(0, partial(require_within_reach, arm, goal.task, tolerance))
        checks.insert(1, partial(_check_plane, arm, goal.positions[0], tolerance))
        checks.append(partial(_check_orientation, arm, goal.task, tolerance))
    raise_together(gather(*checks))


def _check_plane(arm: Arm, position: Array, tolerance: float) -> None:
    offset = position - arm.chain.points[-1]
    across = float(np.linalg.norm(offset - arm.plane.T @ (arm.plane @ offset)))
    if across > tolerance:
        allowed = length_text(tolerance)
        reason = f"it is {length_text(across)} off the plane in which the arm moves; allowed: {allowed}"
        raise OutOfReach(position, reason)


def _check_outside(scene: Scene | None, position: Array, who: str) -> None:
    inside = () if scene is None else obstacles_around(scene, position)
    if inside:
        raise ReachError(position, f"it is inside {', '.join(inside)}", who)


def _check_orientation(arm: Arm, task: EndEffector, tolerance: float) -> None:
    """Refuse orientations that are impossible because the tip turns about one axis or not at all."""
    known = link_axes(arm)
    if task.pose is None or known.turns[-1] > 1:
        return
    goal = task.pose[:3, :3]
    now = arm.at(arm.neutral()).rotations[-1]
    axis = known.axes[-1]
    turns = bool(known.turns[-1])
    if task.direction_only:
        change = (goal - now) @ known.links[-1]
        off = abs(float(axis @ change)) if turns else float(np.linalg.norm(change))
    else:
        change = goal @ now.T - np.eye(3)
        off = float(np.linalg.norm(change @ axis if turns else change))
    if off * arm.characteristic_length > tolerance:
        how = "turns about one axis" if turns else "does not turn"
        reason = (
            f"the tip {how}, and cannot take this orientation: it is off by at least {off:.3g} (allowed: "
        )
        raise OutOfReach(_position_of(task), f"{reason}{tolerance / arm.characteristic_length:.2g})")


def _half_ranges(arm: Arm) -> tuple[Array, Array]:
    """Middle and half range of each joint, (nv,) [rad or m]; the latter is infinite without limits."""
    lower = np.where(arm.unlimited, 0.0, arm.limits.lower)
    upper = np.where(arm.unlimited, 0.0, arm.limits.upper)
    return 0.5 * (lower + upper), np.where(arm.unlimited, inf, 0.5 * (upper - lower))


def room_to_limits(arm: Arm, q: Array) -> Array:
    """Return the distance of each joint from its nearest limit, (nv,), in half ranges; 1 without limits."""
    middle, half = _half_ranges(arm)
    away = np.abs(arm.positions(q) - middle)
    return np.where(half > 0.0, 1.0 - away / np.where(half > 0.0, half, 1.0), 1.0)


def _limit_distance(arm: Arm, q: Array) -> float:
    """Return the smallest distance of a joint of the chain from its limit, in half ranges, in [0, 1]."""
    return float(np.clip(room_to_limits(arm, q)[arm.columns].min(initial=1.0), 0.0, 1.0))


# The search for postures.


class _Rows(NamedTuple):
    """Equations matrix @ x = errors that a step x should satisfy, the rows of the tip first.

    Attributes:
        matrix: (r, n) [m per `Arm.joint_units`].
        errors: (r,) [m].
        tip: number of rows of the tip.
    """

    matrix: Array
    errors: Array
    tip: int

    @property
    def cost(self) -> float:
        return float(self.errors @ self.errors)

    @property
    def tip_error(self) -> float:
        return float(np.linalg.norm(self.errors[: self.tip]))

    @property
    def intrusion(self) -> float:
        return float(np.linalg.norm(self.errors[self.tip :]))


class _TipFit:
    """The problem of bringing the tip to its goal and all distances to a clearance; see `descend`."""

    def __init__(self, search: _Search, clearance: float | None) -> None:
        self._search = search
        self._rows = lru_cache(maxsize=2)(partial(search.rows, clearance=clearance))

    def rate(self, state: ChainState) -> Rating:
        return Rating(0.0, 0.5 * self._rows(state).cost)

    def is_solved(self, state: ChainState, rating: Rating) -> bool:
        rows = self._rows(state)
        search = self._search
        near = rows.tip_error <= 0.1 * search.tolerance
        return near and rows.intrusion <= 0.5 * SEARCH.buffer * search.arm.length

    def step(self, state: ChainState, damping: float) -> ChainState | None:
        search = self._search
        rows = self._rows(state)
        lower, upper = search.room(state)
        lower = np.maximum(lower, -SEARCH.max_joint_motion)
        upper = np.minimum(upper, SEARCH.max_joint_motion)
        matrix = rows.matrix
        mean = float((matrix**2).sum()) / len(lower) + 1e-12 * search.arm.length**2
        # Full damping from a tenth of the arm length on; nearer, it falls with the squared errors.
        far = min(1.0, rows.cost / search.arm.length**2 * 1e2)
        weight = (1e-2 * damping * far + POSTURE_SEARCH.least_damping) * mean
        # There are fewer rows than joints. Within the box, their solution is that of the quadratic program.
        x = matrix.T @ np.linalg.solve(damped_hessian(matrix.T, weight), rows.errors)
        if np.any((x < lower) | (x > upper)):
            solution = solve(damped_hessian(matrix, weight), -(matrix.T @ rows.errors), lower, upper)
            if solution.x is None:
                return None
            x = solution.x
        return search.moved(state, x)


class _Search:
    """The search for postures with the tip at its goal."""

    def __init__(
        self,
        arm: Arm,
        goal: _Goal,
        scene: Scene | None,
        limits: Limits,
        tolerance: float,
        objective: str = "dexterity",
    ) -> None:
        self.arm = arm
        self.goal = goal
        self.task = goal.task
        self.scene = scene
        self.limits = limits
        self.tolerance = tolerance
        self.model = None if scene is None else CollisionModel(arm, scene)
        self.margin = 0.0 if scene is None else scene.margin
        bounds = limits.for_arm(arm)
        self.position_limits = bounds.position_limits
        self.torque_limits = None if bounds.effort is None else TorqueLimits(arm, bounds.effort)
        self.torques = self.torque_limits
        if objective != "torque":
            self.torques = None
        elif self.torques is None:
            self.torques = TorqueLimits(arm, arm.effort)
        columns = arm.columns
        self.columns = columns[self.position_limits[1, columns] > self.position_limits[0, columns]]
        self.units = arm.joint_units[self.columns]
        self.target = Target.from_configuration(arm, arm.straight())  # required, but unused by the task

    def find(
        self, start: Array | None, count: int, rng: np.random.Generator, until: float
    ) -> list[ReachedPosture]:
        """Return distinct clear postures, the best first; raise ReachError if there is none."""
        postures: list[ReachedPosture] = []
        shapes: list[Array] = []
        idle = 0
        nearest = inf
        intruding = 0
        for wave in range(SEARCH.max_waves):
            before = len(postures)
            settled: list[tuple[float, int, ChainState]] = []
            for number, q in enumerate(self._seeds(start, wave == 0, rng)):
                state = self._settle(self.arm.chain_at(q), None, SEARCH.tip_iterations)
                error = self.rows(state, None).tip_error
                nearest = min(nearest, error)
                close = self.model is not None and error <= SEARCH.ample * self.arm.length
                if error <= self.tolerance or close:
                    near = start is not None and wave == number == 0  # tried first, even if it intrudes
                    intrusion = 0.0 if near else self.rows(state, self.margin).intrusion
                    settled.append((intrusion, number, state))
                if perf_counter() >= until:
                    break
            for _, _, begin in sorted(settled, key=lambda candidate: candidate[:2])[: SEARCH.chosen]:
                state = self._push_clear(begin)
                posture = self._judge(state)
                if posture is None:
                    intruding += 1
                elif self._is_new(state.links, shapes):
                    better, improved = self._polish(posture, state)
                    if self._is_new(improved.links, shapes):
                        postures.append(better)
                        shapes.append(improved.links)
                if len(postures) >= count or perf_counter() >= until:
                    break
            idle = idle + 1 if len(postures) == before else 0
            if (
                len(postures) >= count
                or perf_counter() >= until
                or (postures and idle >= SEARCH.max_idle_waves)
            ):
                break
        if not postures:
            goal = self.goal
            raise ReachError(goal.positions[-1], self._explain_failure(nearest, intruding), goal.who)
        return sorted(postures, key=lambda posture: -posture.score)

    def bring_near(self, state: ChainState, waves: int, rng: np.random.Generator) -> tuple[ChainState, float]:
        """Return a state at the goal, the nearest found to a posture, or else the closest, and its error."""
        best = self._settle(state, None, SEARCH.tip_iterations)
        error = self.rows(best, None).tip_error
        for _ in range(waves):
            if error <= self.tolerance:
                break
            nearest = inf
            for q in self._seeds(None, False, rng):
                other = self._settle(self.arm.chain_at(q), None, SEARCH.tip_iterations)
                off = self.rows(other, None).tip_error
                away = float(np.linalg.norm(other.points - state.points, axis=1).mean())
                if off <= self.tolerance and away < nearest:
                    best = other
                    error = off
                    nearest = away
                elif off < error and error > self.tolerance:
                    best = other
                    error = off
        return best, error

    def with_path(self, posture: ReachedPosture, start: Array, budget: float) -> ReachedPosture:
        """Return the posture at the turns at which its path ends, with the path, its ratio and its score."""
        arm = self.arm
        path = plan(arm.at(start), posture.target, self.scene, self.limits, budget=budget, strict=False)
        q = arm.nearest_turns(posture.q, path.configurations[-1])
        limit_distance = _limit_distance(arm, q)
        units = arm.joint_units
        direct = float(np.linalg.norm(path.offsets[-1] / units))
        length = float(np.linalg.norm(np.diff(path.offsets / units, axis=0), axis=1).sum())
        ratio = max(length / direct, 1.0) if direct > 1e-9 else 1.0
        score = posture.score
        if self.torques is None:
            score += (limit_distance - posture.limit_distance) / 3.0
            score = (3.0 * score + 1.0 / ratio) / 4.0
        q.flags.writeable = False
        return replace(
            posture,
            q=q,
            target=replace(posture.target, q=q),
            path=path,
            limit_distance=limit_distance,
            path_ratio=ratio,
            score=score,
        )

    def descend(self, state: ChainState) -> ReachedPosture | None:
        """Return the clear posture found from another; None if there is none."""
        return self._judge(self._push_clear(state))

    def _push_clear(self, state: ChainState, iterations: int = SEARCH.clear_iterations) -> ChainState:
        return self._settle(state, self.margin + SEARCH.buffer * self.arm.length, iterations)

    def _explain_failure(self, nearest: float, intruding: int) -> str:
        if nearest > self.tolerance:
            away = f"{length_text(nearest)} from {'its' if len(self.goal.points) == 1 else 'their'} goal"
            return f"the closest posture found leaves {self.goal.who} {away}"
        torques = "" if self.torque_limits is None else ", need more torque than there is"
        tried = f"all {intruding} postures tried violate the margin{torques} or miss the goal"
        return f"no clear posture was found: {tried}; a larger budget tries more"

    def _seeds(self, start: Array | None, first: bool, rng: np.random.Generator) -> Iterator[Array]:
        """Yield the seed postures of a wave; the first wave begins with the start."""
        arm = self.arm
        few = len(self.columns) <= SEARCH.few_joints
        here = arm.positions(arm.neutral() if start is None else start)
        if first and start is not None:
            yield arm.configuration(np.where(arm.moved > 0.0, np.clip(here, *self.position_limits), here))
        for _ in range(SEARCH.seeds_per_wave):
            amplitude = rng.uniform(*SEARCH.seed_amplitudes)
            q = arm.random(rng) if few else smooth_configuration(arm, rng, amplitude)
            drawn = np.clip(arm.positions(q), *self.position_limits)
            yield arm.configuration(np.where(arm.moved > 0.0, drawn, here))

    def rows(self, state: ChainState, clearance: float | None) -> _Rows:
        """Return the rows of the tip and of the distances below a clearance [m], if one is given.

        Torques count as distances from their limits.
        """
        tip = self.task.rows(state, self.target)
        matrix = tip.jacobian
        errors = tip.error
        if clearance is not None and self.model is not None:
            near = self.model.nearest(state, clearance)
            matrix = np.concatenate([matrix, near.jacobian])
            errors = np.concatenate([errors, clearance - near.distances])
        if clearance is not None and self.torque_limits is not None:
            inequalities = self.torque_limits.inequalities(state)
            tight = inequalities.room < clearance
            matrix = np.concatenate([matrix, inequalities.matrix[tight]])
            errors = np.concatenate([errors, clearance - inequalities.room[tight]])
        return _Rows(matrix[:, self.columns] * self.units, errors, len(tip.error))

    def _settle(self, state: ChainState, clearance: float | None, iterations: int) -> ChainState:
        """Bring the tip to its goal and all distances to a clearance by damped least squares."""
        return descend(_TipFit(self, clearance), state, iterations, POSTURE_SEARCH)[0]

    def _limited(self, x: Array, lower: Array, upper: Array) -> Array:
        """Return a step scaled to `SEARCH.max_joint_motion` and clipped at the limits."""
        scale = min(1.0, SEARCH.max_joint_motion / max(float(np.abs(x).max(initial=0.0)), 1e-300))
        return np.asarray(np.clip(scale * x, lower, upper))

    def room(self, state: ChainState) -> tuple[Array, Array]:
        lower, upper = ((edge[self.columns] - state.positions[self.columns]) for edge in self.position_limits)
        return np.minimum(lower, 0.0) / self.units, np.maximum(upper, 0.0) / self.units

    def moved(self, state: ChainState, x: Array) -> ChainState:
        dq = np.zeros(self.arm.nv)
        dq[self.columns] = x * self.units
        return state.moved(dq)

    def _polish(self, posture: ReachedPosture, state: ChainState) -> tuple[ReachedPosture, ChainState]:
        """Improve clearance, distance from limits and the objective in the null space of the tip."""
        ample = self.margin + SEARCH.ample * self.arm.length
        moved = state
        for _ in range(SEARCH.polish_iterations):
            rows = self.rows(moved, ample)
            first = rows.matrix[: rows.tip]
            left = rows.errors[: rows.tip]
            inverse = np.linalg.pinv(first, rcond=1e-4)
            null = np.eye(len(self.columns)) - inverse @ first
            pull, errors = self._limit_rows(moved)
            relief, torques = self._torque_rows(moved)
            matrix = np.concatenate([rows.matrix[rows.tip :], pull, relief]) @ null
            errors = np.concatenate([rows.errors[rows.tip :], errors, torques])
            gram = matrix.T @ matrix + 1e-2 * self.arm.length**2 * np.eye(len(null))
            x = np.linalg.solve(gram, matrix.T @ errors)
            if self.torques is None:
                x = x + SEARCH.manipulability_gain * self._manipulability(moved)
            x = inverse @ left + null @ x
            if float(np.abs(x).max(initial=0.0)) < 1e-4:
                break
            moved = self.moved(moved, self._limited(x, *self.room(moved)))
        moved = self._push_clear(moved, SEARCH.clear_iterations // 2)
        better = self._judge(moved)
        return (posture, state) if better is None or better.score < posture.score else (better, moved)

    def _torque_rows(self, state: ChainState) -> tuple[Array, Array]:
        """Return the rows that reduce torques, (r, n), and their errors, (r,) [m]; none if not asked for."""
        if self.torques is None:
            return np.empty((0, len(self.columns))), np.empty(0)
        shares, gradient = self.torques.shares(state)
        size = self.arm.length
        return -size * gradient[:, self.columns] * self.units, size * shares

    def _limit_rows(self, state: ChainState) -> tuple[Array, Array]:
        """Return the rows that pull joints back from their limits, (n, n), and their errors, (n,) [m]."""
        middle, half = self._ranges
        share = (state.positions[self.columns] - middle) / half
        excess = np.sign(share) * np.maximum(np.abs(share) - SEARCH.near_limit_share, 0.0)
        root = 0.1 * self.arm.length
        change = np.where(excess == 0.0, 0.0, excess) * np.where(np.isfinite(half), half, 0.0) / self.units
        return root * np.diag((excess != 0.0).astype(np.float64)), -root * change

    @cached_property
    def _ranges(self) -> tuple[Array, Array]:
        """Middle and half range of each joint, (n,) [rad or m]; the latter is infinite without limits."""
        middle, half = _half_ranges(self.arm)
        return middle[self.columns], half[self.columns]

    def _manipulability(self, state: ChainState) -> Array:
        """Return the gradient of the logarithm of the manipulability measure of the tip, (n,).

        A joint changes the Jacobian column of another by a x J, where a is the axis of the joint nearer to
        the base and J the column of the other one.
        """
        plane = self.arm.plane
        columns = self.columns
        jacobian = state.jacobians[-1][:, columns].T
        axes = state.axes[:, columns].T
        inverse = np.linalg.pinv(plane @ (jacobian * self.units[:, None]).T, rcond=1e-6)  # (n, d)
        numbers = np.arange(len(columns))
        low, high = (pick(numbers[:, None], numbers) for pick in (np.minimum, np.maximum))
        changes = np.cross(axes[low], jacobian[high]) @ plane.T  # of column i by joint j, (n, n, d)
        return np.asarray(np.einsum("ijd,id,i->j", changes, inverse, self.units) * self.units)

    def _judge(self, state: ChainState) -> ReachedPosture | None:
        """Return the posture with its criteria and score; None if it is not clear or not at the goal."""
        arm = self.arm
        q = np.array(state.q)
        at = arm.at(q)
        error = float(np.linalg.norm(self.task.rows(at, self.target).error))
        clearance = inf if self.model is None else self.model.minimum(q).distance
        if error > self.tolerance or clearance < self.margin or not arm.within_limits(q):
            return None
        if self.torque_limits is not None and self.torque_limits.violation(state) > 0.0:
            return None
        limit_distance = _limit_distance(arm, q)
        index = at.ellipsoids(-1)[0].index
        score = (min(max(clearance, 0.0) / (SEARCH.ample * arm.length), 1.0) + limit_distance + index) / 3.0
        if self.torques is not None:
            score = max(0.0, 1.0 - self.torques.heaviest(state).share)
        distance = self.goal.distance(at.points)
        q.flags.writeable = False
        target = Target(at.points, np.ones(arm.n_modules), q=q)
        load = at.most_loaded()
        return ReachedPosture(q, target, None, distance, clearance, limit_distance, index, None, score, load)

    def _is_new(self, links: Array, shapes: list[Array]) -> bool:
        least = SEARCH.distinct * self.arm.length
        return all(float(np.linalg.norm(links - shape, axis=1).max()) >= least for shape in shapes)
