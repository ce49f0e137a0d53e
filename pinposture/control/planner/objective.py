"""The objective of the planner: a weighted sum of squares over control points, chords and further tasks."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from functools import cached_property, partial
from math import sqrt
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from pinposture import kernels
from pinposture._validation import require_instance, require_positive
from pinposture.arm import Arm, ChainState
from pinposture.arm.arm import kept
from pinposture.control.constraint import Constraint
from pinposture.control.controller import task_errors
from pinposture.control.tasks import ControlTask, errors_of, rows_of
from pinposture.errors import InvalidValue
from pinposture.kernels.arrays import PointObjective
from pinposture.placement import Target

Array = NDArray[np.float64]


class ObjectiveSettings(NamedTuple):
    """Weights in the objective, and when it counts as reached."""

    priority_weight: float = 1e4
    """Weight of the squared errors of tasks with priority in the cost. Steps give them strict priority."""

    most_joint_weight: float = 1e6
    """Largest joint weight; numbers overflow beyond it, and paths are joint interpolation long before."""

    goal_tolerance: float = 1e-8
    """Mean distance of the control points from their targets at which a configuration takes the
    posture, in arm lengths; well below the default tolerance of runs, 1e-6."""

    most_pull: float = 1e-3
    """Largest share of the gradient of the squared violations that the objective may balance, if the
    rows are infeasible."""

    violated: float = 1e-7
    """Violation of a row of length 1 that exceeds rounding, in units of a joint."""


OBJECTIVE = ObjectiveSettings()


class LinearRows(NamedTuple):
    """Rows that a step x should satisfy: matrix @ x = errors.

    Attributes:
        matrix: (r, n) [m per `Arm.joint_units`], columns as in `Objective.columns`.
        errors: (r,) [m].
    """

    matrix: Array
    errors: Array


class ChainObjective(NamedTuple):
    """Points and chords of an objective as arrays for kernels. Do not write to them.

    Attributes:
        columns: degrees of freedom of the chain that have room to move, from base to tip, (n,).
        joints: index along the chain of each of them, (n,).
        units: unit of motion of each of them, (n,) [rad or m].
        ends: how many of them move each control point that has a target, (p,).
        active: the control points that have a target, p numbers.
        has_target: the same as an array, (p,).
        flags: the same as a mask, (m,).
        targets: target positions of all control points, (m, 3) [m].
        goals: target positions of those that have one, (p, 3) [m].
        weights: weights of their squared errors, (p,).
        chords: weights of the squared errors of the chords to the previous point, (p,); 0 for the first.
        roots: roots of the weights of points, (p, 1), and of chords, (p - 1, 1).
        normal: normal of the plane of a planar arm, (3,); zero for a spatial one.
    """

    columns: NDArray[np.int64]
    joints: NDArray[np.int64]
    units: Array
    ends: NDArray[np.int64]
    active: tuple[int, ...]
    has_target: NDArray[np.intp]
    flags: NDArray[np.bool_]
    targets: Array
    goals: Array
    weights: Array
    chords: Array
    roots: tuple[Array, Array]
    normal: Array

    def points_of(self, state: ChainState) -> Array:
        """Return the positions of the control points that have a target, (p, 3) [m]."""
        points = state.placements.points
        return points if len(self.active) == len(points) else points[self.has_target]


def _lay_out(arm: Arm, weights: Array, relative_position_weight: float) -> ChainObjective:
    """Return the points and chords of all objectives of an arm with the same weights, without targets.

    Raises:
        InvalidValue: no control point has a weight.
    """
    joints = np.flatnonzero(arm.limits.upper[arm.columns] > arm.limits.lower[arm.columns]).astype(np.int64)
    columns = arm.columns[joints].astype(np.int64)
    indices = np.flatnonzero(weights > 0.0)
    if not len(indices):
        raise InvalidValue("target.weights", 0.0, "at least one control point with a weight > 0")
    points = weights[indices]
    chords = relative_position_weight * np.minimum(points[1:], points[:-1])
    none = np.empty((0, 3))
    return ChainObjective(
        columns=columns,
        joints=joints,
        units=np.array(arm.joint_units[columns]),
        ends=np.searchsorted(joints, arm.kinematics.ends[indices]).astype(np.int64),
        active=tuple(indices.tolist()),
        has_target=indices,
        flags=weights > 0.0,
        targets=none,
        goals=none,
        weights=points,
        chords=np.concatenate([[0.0], chords]),
        roots=(np.sqrt(points)[:, None], np.sqrt(chords)[:, None]),
        normal=np.zeros(3) if arm.dimension == 3 else np.cross(*arm.plane),
    )


@dataclass(frozen=True, eq=False)
class Objective:
    """The goals of the arm: the target posture, and further tasks.

    Rows are the errors of the control points that have a target, and of the chords between consecutive ones
    (the differences of the point errors). Chords weigh directions as well as positions, which improves the
    conditioning and leaves fewer local minima.

    Attributes:
        arm: the arm.
        target: the target posture. `Target.weights` weigh the squared errors.
        tasks: further tasks. Without them, points and chords are solved by a pass along the chain.
        relative_position_weight: weight of the squared error of a chord, relative to that of a point.
        joint_weight: weight of joint motion against the motion of control points; see `Geodesic`.
        constraints: constraints to keep on the way to the goals.
    """

    arm: Arm
    target: Target
    tasks: Sequence[ControlTask] = ()
    relative_position_weight: float = 1.0
    joint_weight: float = 0.2
    constraints: Sequence[Constraint] = ()

    @cached_property
    def chain(self) -> ChainObjective:
        """Points and chords as arrays for kernels."""
        weights = self.target.weights
        weight = self.relative_position_weight
        make = partial(_lay_out, self.arm, weights, weight)
        chain = kept(self.arm, ChainObjective, (weight, weights.tobytes()), make)
        points = np.array(self.target.points)
        goals = points if len(chain.active) == len(points) else points[chain.has_target]
        return chain._replace(targets=points, goals=goals)

    @cached_property
    def mu(self) -> float:
        """Weight of joint motion [m per `Arm.joint_units`]: `joint_weight` module lengths per point."""
        return self.joint_weight * self.arm.length / sqrt(self.arm.n_modules)

    @cached_property
    def goal(self) -> ChainState | None:
        """The state at the configuration of the target; None if that is not known."""
        return None if self.target.q is None else ChainState(self.arm, self.target.q)

    @cached_property
    def has_exact_goal(self) -> bool:
        """Whether the configuration of the target takes its points: it may miss them, or not be known."""
        if self.goal is None:
            return False
        return self.mean_error(self.goal) <= OBJECTIVE.goal_tolerance * self.arm.length

    def rows(self, state: ChainState) -> LinearRows:
        """Return all rows without priority, times the roots of their weights."""
        points = self.posture_rows(state, task_errors(state, self.target)[self.chain.has_target])
        weighed = self.task_rows(state, priority=False)
        if weighed is None:
            return points
        return LinearRows(*(np.concatenate(both) for both in zip(points, weighed, strict=True)))

    def posture_rows(self, state: ChainState, errors: Array) -> LinearRows:
        """Return the rows of points and chords, for errors of the points, (p, dimension) [m]."""
        columns = self.chain.columns
        jacobians = state.task_jacobians[self.chain.has_target][:, :, columns]
        return LinearRows(self._weigh(jacobians).reshape(-1, len(columns)), self._weigh(errors).ravel())

    def _weigh(self, values: Array) -> Array:
        """Return values of points, (p, ...), and their differences for chords, times the roots of weights."""
        points, chords = (root.reshape(-1, *[1] * (values.ndim - 1)) for root in self.chain.roots)
        if self.relative_position_weight == 0.0:
            return np.asarray(points * values)
        return np.concatenate([points * values, chords * (values[1:] - values[:-1])])

    def task_rows(self, state: ChainState, priority: bool) -> LinearRows | None:
        """Return the rows of the tasks with or without priority, times the roots of weights; None if none."""
        matrices = []
        errors = []
        for task in self.tasks:
            if task.priority == priority:
                rows = rows_of(task, state, self.target)
                root = float(np.sqrt(task.weight))
                matrices.append(self.restrict(root * rows.jacobian))
                errors.append(root * rows.error)
        return LinearRows(np.concatenate(matrices), np.concatenate(errors)) if matrices else None

    def errors_of_tasks(self, state: ChainState, priority: bool) -> Array | None:
        """Return the errors of `task_rows` alone, (r,) [m]; None if there are no such tasks."""
        errors = [
            float(np.sqrt(task.weight)) * errors_of(task, state, self.target)
            for task in self.tasks
            if task.priority == priority
        ]
        return np.concatenate(errors) if errors else None

    def point_errors(self, state: ChainState) -> tuple[Array, float]:
        """Return the errors of the control points that have a target, (p, 3) [m], and their sum of squares.

        The errors of a planar arm are measured in its plane. The sum is weighted and includes chords.
        """
        chain = self.chain
        errors = np.empty((len(chain.active), 3))
        squares = kernels.measure_point_errors(
            chain.points_of(state), chain.goals, chain.weights, chain.chords, chain.normal, errors
        )
        return errors, squares

    def cost(self, state: ChainState) -> float:
        """Return half the sum of all squares [m^2], tasks with priority times `OBJECTIVE.priority_weight`."""
        total = self.point_errors(state)[1]
        for priority in (False, True):
            errors = self.errors_of_tasks(state, priority)
            if errors is not None:
                total += (OBJECTIVE.priority_weight if priority else 1.0) * float(errors @ errors)
        return 0.5 * total

    def mean_error(self, state: ChainState) -> float:
        """Return the mean distance of the control points from their targets [m]."""
        return float(np.linalg.norm(self.point_errors(state)[0], axis=1).mean())

    def distance_to(self, other: Objective) -> float:
        """Return the mean distance between two target postures [m]; infinite unless the same points count."""
        mine = self.chain
        if mine.active != other.chain.active:
            return float("inf")
        every = np.ones(len(mine.goals), dtype=np.bool_)
        return kernels.sum_point_errors(mine.goals, other.chain.goals, every) / len(every)

    def measure_pieces(self, positions: Array, offsets: Array) -> Array:
        """Return the lengths of straight motions in the metric of the planner, (N,) [m].

        The metric adds the motion of control points and that of joints times `mu`.

        Args:
            positions: joint positions at the start, (nv,) [rad or m].
            offsets: displacements from there that the motions connect, (N + 1, nv) [rad or m].
        """
        points = self.arm.kinematics.points(positions + offsets)
        joints = np.diff(offsets[:, self.chain.columns], axis=0) / self.chain.units
        squares = (np.diff(points, axis=0) ** 2).sum(axis=(1, 2))
        return np.asarray(np.sqrt(squares + self.mu**2 * (joints**2).sum(axis=1)))

    def state_after(self, state: ChainState, x: Array) -> ChainState:
        """Return the state after a step x, (n,)."""
        return state.moved(self.displacement(x))

    def displacement(self, x: Array) -> Array:
        """Return joint displacements (..., nv) [rad or m] of steps x, (..., n); other joints do not move."""
        dq = np.zeros((*x.shape[:-1], self.arm.nv))
        dq[..., self.chain.columns] = x * self.chain.units
        return dq

    def normalize(self, dq: Array) -> Array:
        """Return steps x (..., n), in `Arm.joint_units`, of joint displacements (..., nv) [rad or m]."""
        return np.asarray(dq[..., self.chain.columns] / self.chain.units)

    def largest_motion(self, dq: Array) -> float:
        """Return the largest joint motion of a displacement (nv,), in `Arm.joint_units`."""
        return float(np.abs(self.normalize(dq)).max(initial=0.0))

    def restrict(self, matrix: Array) -> Array:
        """Return rows for steps x, (r, n), from rows for joint displacements, (r, nv)."""
        return np.asarray(matrix[:, self.chain.columns] * self.chain.units)


def check_objective(
    joint_weight: float,
    relative_position_weight: float,
    tasks: Sequence[ControlTask],
    constraints: Sequence[Constraint],
) -> None:
    """Raise InvalidValue if a weight is out of range, or a task or constraint is invalid."""
    allowed = "a sequence of objects with a method `rows(state)`, see `pinposture.control.Constraint`"
    require_instance("constraints", constraints, Iterable, allowed)
    for constraint in constraints:
        if isinstance(constraint, type) or not callable(getattr(constraint, "rows", None)):
            raise InvalidValue("constraints", constraint, allowed)
    require_positive("joint_weight", joint_weight)
    if joint_weight > OBJECTIVE.most_joint_weight:
        raise InvalidValue("joint_weight", joint_weight, f"at most {OBJECTIVE.most_joint_weight:g}")
    require_positive("relative_position_weight", relative_position_weight, zero=True)
    require_instance("tasks", tasks, Iterable, "a sequence of EndEffector, Tangents or JointPosture")
    for task in tasks:
        if isinstance(task, type) or not callable(getattr(task, "rows", None)):
            raise InvalidValue("tasks", task, "EndEffector(...), Tangents(...) or JointPosture(...)")
        require_positive(f"{type(task).__name__}.weight", getattr(task, "weight", None))  # type: ignore[arg-type]
        priority = getattr(task, "priority", None)
        if not isinstance(priority, bool | np.bool_):
            raise InvalidValue(f"{type(task).__name__}.priority", priority, "True or False")


class ConstrainedStep(NamedTuple):
    """A step subject to rows.

    Attributes:
        x: the step, (n,), in `Arm.joint_units`.
        binding: which of the rows are active, (r,).
        softened: whether rows had to be violated.
    """

    x: Array
    binding: NDArray[np.bool_]
    softened: bool


class ChainSolver:
    """Least squares over points and chords at one state, in time linear in the number of joints.

    A dense solver with the rows of `Objective.rows` would give the same step in cubic time.

    Args:
        objective: points and chords.
        state: the state of the arm.
        weight: weight of all points and chords relative to joint motion; 0: only joint motion counts.
    """

    def __init__(self, objective: Objective, state: ChainState, weight: float = 1.0) -> None:
        self._objective = objective
        self._state = state
        self._weight = weight
        chain = objective.chain
        forward = state.placements
        points = chain.points_of(state)
        screws = np.empty((len(chain.joints), 6))
        kernels.find_screws(
            state.arm.kinematics.constants,
            chain.joints,
            chain.units,
            forward.axes,
            forward.origins,
            chain.ends,
            points,
            screws,
        )
        self._points = PointObjective(
            screws, chain.ends, points, weight * chain.weights, weight * chain.chords
        )

    def rows(self, errors: Array) -> LinearRows:
        """Return dense rows of points and chords, for errors of the points, (p, 3) [m]."""
        rows = self._objective.posture_rows(self._state, errors @ self._objective.arm.plane.T)
        return LinearRows(*(sqrt(self._weight) * part for part in rows))

    def stiffness(self) -> float:
        """Return the mean diagonal of A^T A [m^2]."""
        return kernels.stiffness(self._points)

    def covered(self, x: Array) -> Array:
        """Return the motion of each point in a step x (n,), (p, 3) [m]."""
        screws, ends, points, *_ = self._points
        covered = np.empty_like(points)
        kernels.move_points(screws, ends, points, x, covered)
        return covered

    def step(self, errors: Array, damping: float, center: Array, lower: Array, upper: Array) -> Array:
        """Return the x within a box that minimises |A x - e|^2 + damping |x - center|^2, (n,).

        Args:
            errors: wanted motion of the points, (p, 3) [m]; that of the chords is the difference.
            damping: above 0 [m^2].
            center: (n,), in `Arm.joint_units`.
            lower: smallest x, (n,).
            upper: largest x, (n,).
        """
        n = len(center)
        x = np.empty(n)
        at_bound = (center > upper).astype(np.int8) - (center < lower).astype(np.int8)
        kernels.minimise_in_box(self._points, errors, np.full(n, damping), center, lower, upper, at_bound, x)
        return x

    def constrained_step(
        self,
        errors: Array,
        damping: float,
        center: Array,
        lower: Array,
        upper: Array,
        rows: LinearRows,
    ) -> ConstrainedStep | None:
        """Return the x of `step` subject to rows.matrix @ x >= rows.errors; None if the search fails.

        Infeasible rows are violated by the smallest sum of squares. Rows have length 1; the other arguments
        are those of `step`.
        """
        n = len(center)
        matrix = rows.matrix
        least = rows.errors
        x = np.empty(n)
        binding = np.empty(len(least), dtype=np.bool_)
        problem = (self._points, errors, np.full(n, damping), center)

        def minimise(violable: bool) -> bool:
            return kernels.minimise_with_rows(problem, lower, upper, matrix, least, violable, binding, x)

        hopeless = np.any(np.maximum(matrix * lower, matrix * upper).sum(axis=1) < least)
        if not hopeless and minimise(violable=False):
            return ConstrainedStep(x, binding, False) if np.all(np.isfinite(x)) else None
        if not (minimise(violable=True) and np.all(np.isfinite(x))):
            return None
        # The objective adds to the violations; accept only if they are minimal within the box.
        missing = np.maximum(least - matrix @ x, 0.0)
        push = missing @ matrix
        free = np.where(push > 0.0, x < upper, x > lower)
        if np.linalg.norm(push[free]) > OBJECTIVE.most_pull * np.linalg.norm(push):
            return None
        return ConstrainedStep(x, binding, bool(np.any(missing > OBJECTIVE.violated)))
