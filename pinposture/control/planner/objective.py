"""What the arm is asked to do, as one weighted sum of squares along the chain."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from pinposture import kernels
from pinposture.arm import Arm, ArmState
from pinposture.control.controller import task_errors
from pinposture.control.tasks import ControlTask
from pinposture.kernels.arrays import PointObjective
from pinposture.placement import Target

# What the arm is asked to do, as one weighted sum of squares.

Array = NDArray[np.float64]


STRICT = 1e4
"""How much strict tasks weigh in the merit, which they dominate. Steps put them first exactly."""


class Linear(NamedTuple):
    """Rows that say what a step x should do: matrix @ x = errors, in metres.

    Attributes:
        matrix: (r, n) [m per `Arm.joint_units`], columns as `Posture.columns`.
        errors: (r,) [m].
    """

    matrix: Array
    errors: Array


class ChainObjective(NamedTuple):
    """Points and chords as kernels see them: arrays that are not to be written to.

    Attributes:
        which: the joints of `Posture.columns`, by their numbers along the chain, (n,).
        ends: how many of them carry each control point that has a target, (p,).
        units: the motion of each of them that counts as one, (n,) [rad or m].
        placed: the control points that have a target, (p,).
        flags: the same, (m,).
        targets: where all control points should be, (m, 3) [m].
        goals: where those should be that have a target, (p, 3) [m].
        weights: weights of their squared errors, (p,).
        chords: weights of the squared errors of the chords to the one before, (p,); 0 for the first.
        normal: normal of a planar arm, (3,); zero of a spatial one.
    """

    which: NDArray[np.int64]
    ends: NDArray[np.int64]
    units: Array
    has_target: NDArray[np.intp]
    flags: NDArray[np.bool_]
    targets: Array
    goals: Array
    weights: Array
    chords: Array
    normal: Array

    def points_of(self, state: ArmState) -> Array:
        """The control points that have a target, where they are, (p, 3) [m]."""
        points = state.forward.points
        return points if len(self.has_target) == len(points) else points[self.has_target]


@dataclass(frozen=True, eq=False)
class Posture:
    """A target posture with whatever else is asked of the arm.

    Rows ask of each control point with a target to cover its error, and of each pair of neighbours among them
    to cover the error of the chord between them: the difference of the two. Chords make the sum of squares
    feel directions as well as places, which conditions it better and leaves fewer local minima. Rows of
    further tasks follow.

    Attributes:
        arm: the arm.
        target: where its control points should be; squared errors are weighed by `Target.weights`.
        tasks: what else it should do.
        relative_position_weight: weight of the squared error of a chord, where that of a point has weight 1.
    """

    arm: Arm
    target: Target
    tasks: Sequence[ControlTask] = ()
    relative_position_weight: float = 1.0

    @cached_property
    def columns(self) -> NDArray[np.intp]:
        """Degrees of freedom of the chain that have room to move, from base to tip, (n,)."""
        limits, columns = self.arm.limits, self.arm.columns
        return np.array(columns[limits.upper[columns] > limits.lower[columns]], dtype=np.int64)

    @cached_property
    def units(self) -> Array:
        """The motion of each of them that counts as one, (n,) [rad or m]."""
        return np.asarray(self.arm.joint_units[self.columns])

    @cached_property
    def _placed(self) -> NDArray[np.intp]:
        return np.flatnonzero(self.target.has_target)

    @cached_property
    def _every(self) -> NDArray[np.bool_]:
        return np.ones(len(self._placed), dtype=np.bool_)

    @cached_property
    def _roots(self) -> tuple[Array, Array]:
        """Square roots of the weights of points (p, 1) and of chords (p - 1, 1)."""
        weights = self.target.weights[self._placed]
        chords = self.relative_position_weight * np.minimum(weights[1:], weights[:-1])
        return np.sqrt(weights)[:, None], np.sqrt(chords)[:, None]

    def rows(self, state: ArmState) -> Linear:
        """The rows that are weighed against each other, scaled so that their squares add up."""
        placed, (points, chords) = self._placed, self._roots
        errors = task_errors(state, self.target)[placed]
        jacobians = state.task_jacobians[placed][:, :, self.columns]
        n = len(self.columns)
        blocks = [(points[:, :, None] * jacobians).reshape(-1, n)]
        wanted = [(points * errors).ravel()]
        if self.relative_position_weight > 0.0:
            blocks.append((chords[:, :, None] * (jacobians[1:] - jacobians[:-1])).reshape(-1, n))
            wanted.append((chords * (errors[1:] - errors[:-1])).ravel())
        weighed = self.task_rows(state, strict=False)
        if weighed is not None:
            blocks.append(weighed.matrix)
            wanted.append(weighed.errors)
        return Linear(np.concatenate(blocks), np.concatenate(wanted))

    def task_rows(self, state: ArmState, strict: bool) -> Linear | None:
        """Rows of the tasks that are strict, or of those that are not, with the roots of their weights.

        None if there are no such tasks.
        """
        matrices, errors = [], []
        for task in self.tasks:
            if task.priority == strict:
                rows, root = task.rows(state, self.target), float(np.sqrt(task.weight))
                matrices.append(root * rows.jacobian[:, self.columns] * self.units)
                errors.append(root * rows.error)
        return Linear(np.concatenate(matrices), np.concatenate(errors)) if matrices else None

    def moved_to(self, target: Target) -> Posture:
        """The same asked of another target; where the same points have one, what is known of them stays."""
        other = Posture(self.arm, target, self.tasks, self.relative_position_weight)
        if np.array_equal(target.weights, self.target.weights):
            known = {"columns", "units", "_placed", "_every", "_roots", "plain", "active"} & vars(self).keys()
            vars(other).update({name: vars(self)[name] for name in known})
            if "chain" in vars(self):
                vars(other)["chain"] = self.chain._replace(
                    targets=np.array(target.points), goals=np.array(target.points[self._placed])
                )
        return other

    @cached_property
    def active(self) -> tuple[int, ...]:
        """The control points that have a target."""
        return tuple(int(k) for k in self._placed)

    @cached_property
    def plain(self) -> bool:
        """Whether nothing is asked but points and chords, which a sweep along the chain can do."""
        return not self.tasks

    @cached_property
    def chain(self) -> ChainObjective:
        """What points and chords look like to kernels."""
        placed, (points, chords) = self._placed, self._roots
        own = np.flatnonzero(np.isin(self.arm.columns, self.columns)).astype(np.int64)
        normal = np.zeros(3) if self.arm.dimension == 3 else np.cross(*self.arm.plane)
        return ChainObjective(
            which=own,
            ends=np.searchsorted(own, self.arm.kinematics.ends[placed]).astype(np.int64),
            units=np.array(self.units),
            has_target=placed,
            flags=np.array(self.target.has_target),
            targets=np.array(self.target.points),
            goals=np.array(self.target.points[placed]),
            weights=points.ravel() ** 2,
            chords=np.concatenate([[0.0], chords.ravel() ** 2]),
            normal=normal,
        )

    def misses(self, state: ArmState) -> tuple[Array, float]:
        """Errors of the control points that have a target, (p, 3) [m], and the sum of squares that they make.

        Those of a planar arm are errors in its plane.
        """
        chain, errors = self.chain, np.empty((len(self._placed), 3))
        given = chain.points_of(state), chain.goals, chain.weights, chain.chords, chain.normal
        return errors, kernels.measure_point_errors(*given, errors)

    def merit(self, state: ArmState) -> float:
        """Half the sum of all squares [m^2], those of strict tasks `STRICT` times."""
        total = self.misses(state)[1]
        for strict in (False, True):
            asked = self.task_rows(state, strict)
            if asked is not None:
                total += (STRICT if strict else 1.0) * float(asked.errors @ asked.errors)
        return 0.5 * total

    def mean_error(self, state: ArmState) -> float:
        """Mean distance of the control points from their targets [m]."""
        errors = self.misses(state)[0]
        return kernels.sum_point_errors(errors, np.zeros_like(errors), self._every) / len(errors)

    def distance_to(self, other: Posture) -> float:
        """Mean distance between the points of two targets [m]; infinite if not the same points have one."""
        if self.active != other.active:
            return float("inf")
        every = self._every
        return kernels.sum_point_errors(self.chain.goals, other.chain.goals, every) / len(every)

    def moved(self, state: ArmState, x: Array) -> ArmState:
        """The state after a step x, (n,)."""
        return self.arm.at(self.arm.integrate(state.q, self.displacement(x))).compiled

    def displacement(self, x: Array) -> Array:
        """Joint displacement (nv,) [rad or m] of a step x, (n,); all other joints stand still."""
        dq = np.zeros(self.arm.nv)
        dq[self.columns] = x * self.units
        return dq

    def own(self, dq: Array) -> Array:
        """The step x (n,), in `Arm.joint_units`, that makes up a joint displacement (nv,) [rad or m]."""
        return np.asarray(dq[self.columns] / self.units)


# The step that points and chords want, by sweeps along the chain: where nothing else has a say.


class ChainSolver:
    """Least squares over points and chords of a posture at one state, in time linear in the number of joints.

    With all rows A of the posture and its errors e, `control.planner.avoidance` would do the same; but it
    takes the cube of the number of joints, as it knows of no chain.
    """

    def __init__(self, posture: Posture, state: ArmState) -> None:
        chain, placed = posture.chain, state.forward
        screws, points = np.empty((len(chain.which), 6)), chain.points_of(state)
        given = chain.which, state.arm.kinematics.slides, chain.units, placed.axes, placed.origins
        kernels.find_screws(*given, chain.ends, points, screws)
        self._springs = PointObjective(screws, chain.ends, points, chain.weights, chain.chords)

    def stiffness(self) -> float:
        """Mean diagonal of A^T A [m^2]."""
        return kernels.stiffness(self._springs)

    def covered(self, x: Array) -> Array:
        """What a step x (n,) covers of each error, (p, 3) [m]."""
        screws, ends, points, *_ = self._springs
        covered = np.empty_like(points)
        kernels.move_points(screws, ends, points, x, covered)
        return covered

    def step(self, errors: Array, damping: float, centre: Array, lower: Array, upper: Array) -> Array:
        """The x within a box that minimises |A x - e|^2 + damping |x - centre|^2, (n,).

        Args:
            errors: what points should cover, (p, 3) [m]; chords cover the differences.
            damping: above 0 [m^2].
            centre: (n,), in `Arm.joint_units`.
            lower: smallest x, (n,).
            upper: largest x, (n,).
        """
        n = len(centre)
        x, sides = np.empty(n), (centre > upper).astype(np.int8) - (centre < lower).astype(np.int8)
        kernels.minimise_in_box(self._springs, errors, np.full(n, damping), centre, lower, upper, sides, x)
        return x
