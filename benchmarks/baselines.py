"""Baseline controllers from the literature: (2.6) and (2.9) to (2.16), damped least squares."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from benchmarks.baseline_objectives import (
    OBJECTIVES,
    RANK,
    Objective,
    PositionDerivatives,
    objective_gradient,
    objective_hessian,
)
from pinposture._validation import require_known, require_positive, require_whole
from pinposture.arm import ArmState
from pinposture.control.controller import (
    Controller,
    Memory,
    Step,
    stack_rows,
    step_within,
    task_errors,
)
from pinposture.control.limits import Limits
from pinposture.control.registry import CONTROLLERS, controller_named
from pinposture.errors import InvalidValue
from pinposture.placement import Target

Array = NDArray[np.float64]


class BaselineTask(NamedTuple):
    """Control points to be moved, J dq = dp.

    Attributes:
        points: the control points, 0-based and increasing; the last of them is the end-effector.
        jacobian: their stacked position Jacobians, (r, nv) [m per unit of joint motion].
        errors: their stacked errors c - p, (r,) [m].
    """

    points: tuple[int, ...]
    jacobian: Array
    errors: Array

    @property
    def end_effector(self) -> int:
        """The last control point of the task."""
        return self.points[-1]


def task_of(state: ArmState, target: Target, points: NDArray[np.intp]) -> BaselineTask:
    """Return the task of moving some control points (N,) to their targets."""
    jacobian = stack_rows(state.task_jacobians[points])
    return BaselineTask(tuple(int(k) for k in points), jacobian, task_errors(state, target)[points].ravel())


def end_effector_task(state: ArmState, target: Target) -> BaselineTask:
    """Return the task of the end-effector alone, the last control point with a target."""
    return task_of(state, target, np.flatnonzero(target.has_target)[-1:])


def all_points_task(state: ArmState, target: Target) -> BaselineTask:
    """Return the stacked task of all control points with a target (2.15)."""
    return task_of(state, target, np.flatnonzero(target.has_target))


class Decomposition(NamedTuple):
    """Singular value decomposition of a Jacobian (r, nv), J = left diag(sigma) right.

    The k = min(r, nv) singular values are descending [m/rad]; left is (r, k), right (k, nv).
    """

    left: Array
    sigma: Array
    right: Array


def decompose(matrix: Array) -> Decomposition:
    """Decompose a Jacobian (r, nv)."""
    return Decomposition(*np.linalg.svd(matrix, full_matrices=False))


def pseudo_inverse_step(matrix: Decomposition, velocity: Array, gradient: Array) -> Array:
    """Return J^+ dr + (I - J^+ J) g: the velocities exactly, and g as far as they allow (2.6).

    Here dr are the desired velocities of the rows, (r,) [m], and g is the gradient, a desired joint
    displacement, (nv,), in the units of the columns of J, like the result. All singular values are positive.
    """
    along = matrix.right @ gradient
    return np.asarray(gradient + matrix.right.T @ ((matrix.left.T @ velocity) / matrix.sigma - along))


def regular_part(matrix: Decomposition) -> Decomposition:
    """Return the decomposition without its zero singular values, as inverted by a pseudo-inverse."""
    rank = int(np.count_nonzero(matrix.sigma > RANK * matrix.sigma[0]))
    return Decomposition(matrix.left[:, :rank], matrix.sigma[:rank], matrix.right[:rank])


def damped_step(matrix: Decomposition, velocity: Array, damping: float) -> Array:
    """Return the dq, (nv,), that minimises |J dq - dr|^2 + damping |dq|^2, for damping > 0.

    Here dr are the desired velocities of the rows, (r,), and the damping is in the units of J squared.
    """
    share = matrix.sigma / (matrix.sigma**2 + damping)
    return np.asarray(matrix.right.T @ (share * (matrix.left.T @ velocity)))


class UnlimitedStep(NamedTuple):
    """The step that a method asks for, before limits.

    Attributes:
        dq: joint displacement, (nv,), in `Arm.joint_units`.
        points: the control points that it moves, 0-based.
        rows: number of rows of the inverted matrix.
        sigma: its singular values in any order, at least one [m/rad].
    """

    dq: Array
    points: tuple[int, ...]
    rows: int
    sigma: Array


class Baseline(ABC):
    """A method without memory beyond its last step, which stands still if no control point has a target."""

    def step(
        self, state: ArmState, target: Target, limits: Limits | None = None, memory: Memory | None = None
    ) -> Step:
        """Compute one step; see `Controller.step`.

        Its manipulability index is the smallest of its points relative to the base.
        """
        limits = Limits() if limits is None else limits
        previous = memory.dq if memory is not None else None
        has_target = bool(np.any(target.has_target))
        asked = self._unlimited_step(state, target) if has_target else "no control point has a target"
        if isinstance(asked, str):
            return step_within(limits.hold(state, previous), reason=asked)
        # Joints off the chain have zero columns, but singular vectors only up to rounding error.
        moved = asked.dq * state.arm.joint_units * state.arm.moved
        limited = limits.apply(state, moved, previous)
        info = {
            "manipulability": float(state.manipulability()[0, np.array(asked.points) + 1].min()),
            "sigma_min": float(asked.sigma.min()),
            "sigma_max": float(asked.sigma.max()),
            "rows": asked.rows,
        }
        return step_within(limited, asked.points, info=info)

    @abstractmethod
    def _unlimited_step(self, state: ArmState, target: Target) -> UnlimitedStep | str:
        """Return the step to make, or why there is none; at least one control point has a target."""


@dataclass(frozen=True)
class NullSpaceMethod(Baseline):
    """The step J^+ K dp + (I - J^+J) k grad h of a task, (2.6), (2.7) and (2.16).

    Attributes:
        objective: null-space objective, see `objectives.OBJECTIVES`; None for the shortest step.
        gain: fraction of the error that each point of the task should cover in one step.
        null_gain: the factor k of (2.7), positive to improve h. Joints move by null_gain times its gradient.
    """

    objective: Objective | None = None
    gain: float = 1.0
    null_gain: float = 0.1

    def __post_init__(self) -> None:
        if self.objective is not None:
            require_known("objective", self.objective, OBJECTIVES)
        require_positive("gain", self.gain)
        require_positive("null_gain", self.null_gain, zero=True)

    @abstractmethod
    def _task(self, state: ArmState, target: Target) -> BaselineTask:
        """Return the control points to move."""

    def _unlimited_step(self, state: ArmState, target: Target) -> UnlimitedStep | str:
        task = self._task(state, target)
        matrix = decompose(task.jacobian)
        kappa = np.zeros(state.arm.nv)
        if self.objective is not None:
            kappa = self.null_gain * objective_gradient(self.objective, state, task.end_effector)
        asked = pseudo_inverse_step(regular_part(matrix), self.gain * task.errors, kappa)
        return UnlimitedStep(asked, task.points, len(task.errors), matrix.sigma)


@dataclass(frozen=True)
class PseudoInverse(NullSpaceMethod):
    """Moves the end-effector alone: dq = J^+ dp + (I - J^+J) k grad h, (2.6) and (2.7).

    The end-effector is the last control point with a target; the others are not controlled. Nothing is
    damped: near a singular posture the step grows as 1 / sigma_min, and at one the lost directions are
    ignored. Its parameters are those of `NullSpaceMethod`.
    """

    name: str = "pinv"

    def _task(self, state: ArmState, target: Target) -> BaselineTask:
        return end_effector_task(state, target)


@dataclass(frozen=True)
class AugmentedJacobian(NullSpaceMethod):
    """Stacks the Jacobians of all control points with a target, (2.15), and inverts the result, (2.16).

    There are usually more rows than joints: the step is then the least-squares one. Nothing is damped, so the
    step is huge wherever rows of different points are nearly dependent, which is common even if each point
    alone can move freely (an algorithmic singularity, Section 3.1.3). Parameters: see `NullSpaceMethod`.
    """

    name: str = "augmented"

    def _task(self, state: ArmState, target: Target) -> BaselineTask:
        return all_points_task(state, target)


@dataclass(frozen=True)
class DampedLeastSquares(Baseline):
    """Moves all control points with a target: dq minimises |J dq - K e|^2 + lambda^2 |dq|^2.

    No step is longer than |K e| / (2 lambda), singular or not; in exchange, directions with singular values
    below lambda hardly move, even if they could.

    Attributes:
        damping: lambda relative to the arm length [1/rad].
        gain: fraction of the error that each point should cover in one step (K).
    """

    damping: float = 0.02
    gain: float = 1.0
    name: str = "dls"

    def __post_init__(self) -> None:
        require_positive("damping", self.damping)
        require_positive("gain", self.gain)

    def _unlimited_step(self, state: ArmState, target: Target) -> UnlimitedStep | str:
        task = all_points_task(state, target)
        matrix = decompose(task.jacobian)
        damping = (self.damping * state.arm.length) ** 2
        asked = damped_step(matrix, self.gain * task.errors, damping)
        return UnlimitedStep(asked, task.points, len(task.errors), matrix.sigma)


@dataclass(frozen=True)
class LevenbergMarquardt(Baseline):
    """Moves all control points with a target, with the damping of Sugihara (2011).

    Each step solves (J^T W J + lambda I) dq = J^T W e, with W = diag(weights) / length^2 of the arm and
    lambda = e^T W e / 2 + bias: cautious far from the target, nearly Gauss-Newton near it, always regular.

    The singular values that it reports are those of diag(weights)^(1/2) J.

    Attributes:
        bias: damping that remains at the target, in squared arm lengths [1/rad^2].
    """

    bias: float = 1e-6
    name: str = "lm"

    def __post_init__(self) -> None:
        require_positive("bias", self.bias)

    def _unlimited_step(self, state: ArmState, target: Target) -> UnlimitedStep | str:
        task = all_points_task(state, target)
        weights = np.repeat(np.sqrt(target.weights[list(task.points)]), state.arm.dimension)
        matrix = decompose(weights[:, None] * task.jacobian)
        errors, length = weights * task.errors, state.arm.length
        damping = 0.5 * float(errors @ errors) + self.bias * length**2
        asked = damped_step(matrix, errors, damping)
        return UnlimitedStep(asked, task.points, len(task.errors), matrix.sigma)


@dataclass(frozen=True)
class TaskConstraints(Baseline):
    """Moves the end-effector, and other control points in its null space, (2.6) with (2.11).

        dq = J^+ dp + (I - J^+J) (J_c (I - J^+J))^+ (dp_c - J_c J^+ dp)

    The end-effector is the last control point with a target. The others have strictly lower priority: they do
    not affect the motion of the end-effector. (2.9) allows alpha <= n - m rows for them, where n joints move
    the end-effector and m is the rank of J; that many are used, spread evenly along the arm. They may still
    require more than the null space allows; then the step is the least-squares one, and it is huge where they
    nearly do, because nothing is damped.

    The singular values that it reports are those of J and of J_c (I - J^+J).

    Attributes:
        constraints: maximum number of other control points to move; None for as many as (2.9) allows.
        gain: fraction of the error that each point should cover in one step.
    """

    constraints: int | None = None
    gain: float = 1.0
    name: str = "task-constraints"

    def __post_init__(self) -> None:
        if self.constraints is not None:
            require_whole("constraints", self.constraints, 0)
        require_positive("gain", self.gain)

    def _unlimited_step(self, state: ArmState, target: Target) -> UnlimitedStep | str:
        primary = end_effector_task(state, target)
        left, every, right = np.linalg.svd(primary.jacobian)
        matrix = regular_part(Decomposition(left, every, right[: len(every)]))
        rank = len(matrix.sigma)
        null = right[rank:]  # basis of the null space, (nv - rank, nv)
        asked = matrix.right.T @ ((matrix.left.T @ (self.gain * primary.errors)) / matrix.sigma)
        secondary = self._constraints(state, target, primary, rank)
        if not secondary.points:
            return UnlimitedStep(asked, primary.points, len(primary.errors), every)
        # J_c (I - J^+J) has the singular values of J_c V with the basis V, without a final projection.
        projected = decompose(secondary.jacobian @ null.T)
        inverted = regular_part(projected)
        missing = self.gain * secondary.errors - secondary.jacobian @ asked
        asked = asked + null.T @ (inverted.right.T @ ((inverted.left.T @ missing) / inverted.sigma))
        rows = len(primary.errors) + len(secondary.errors)
        sigma = np.concatenate([every, projected.sigma])
        return UnlimitedStep(asked, secondary.points + primary.points, rows, sigma)

    def _constraints(self, state: ArmState, target: Target, primary: BaselineTask, rank: int) -> BaselineTask:
        """Return the task of the other control points that (2.9) allows."""
        others = np.flatnonzero(target.has_target)[:-1]
        joints = int(state.arm.support[primary.end_effector].sum())
        room = (joints - rank) // state.arm.dimension
        count = min(len(others), room, len(others) if self.constraints is None else self.constraints)
        spread = np.linspace(0, len(others), count + 2)[1:-1].astype(np.intp)
        return task_of(state, target, others[spread])


@dataclass(frozen=True)
class ExtendedJacobian(Baseline):
    """Moves the end-effector while keeping an objective function extremal, (2.12)-(2.14).

    At a constrained extremum, f_c = N^T grad h = 0 for a basis N of the null space of J (2.12). Together with
    the task this is a square system, J_e dq = [dp; 0] with J_c = d f_c / dq, solved by its inverse.

    For J_c to exist, N must be a differentiable function of q. Singular vectors are not: they turn
    arbitrarily within the null space. From J N = 0 follows dN = -J^+ dJ N + N A with any skew matrix A: a
    choice of basis, which adds A^T f_c to the derivative. Choose A = 0, the basis that does not turn within
    the null space. Then, with the multipliers l = J^{+T} grad h and the second derivatives D_a of the task
    coordinates,

        J_c = N^T (hess h - sum_a l_a D_a),

    the reduced Hessian of Newton's method for constrained extrema. A change of N only rotates the rows of
    J_c, so the step is the same for every orthonormal basis, including the current singular vectors; and at
    f_c = 0 the choice of A does not matter. Both objective functions are differentiated in closed form, at
    O(n^2 d) for the derivatives and O(n^3) for the inverse.

    The method keeps f_c at its current value, zero or not: started off an extremum, it never reaches one,
    unless `restore` is set. J_e is singular where J is, and also where extrema merge or are flat (algorithmic
    singularities). Near these, steps are huge; at one the arm is held.

    The singular values that it reports are those of J_e, see `system`.

    Attributes:
        objective: the function to keep extremal, see `objectives.OBJECTIVES`.
        gain: fraction of the error that the end-effector should cover in one step.
        restore: fraction of f_c that is corrected in one step. 0 is (2.14) as printed.
    """

    objective: Objective = "manipulability"
    gain: float = 1.0
    restore: float = 0.0
    name: str = "extended"

    def __post_init__(self) -> None:
        require_known("objective", self.objective, OBJECTIVES)
        require_positive("gain", self.gain)
        require_positive("restore", self.restore, zero=True)

    def _unlimited_step(self, state: ArmState, target: Target) -> UnlimitedStep | str:
        task = end_effector_task(state, target)
        columns, extended, constraint = self.system(state, task)
        if len(extended) < len(columns):
            return "the Jacobian of the end-effector is singular: there is no extended Jacobian"
        matrix = decompose(extended)
        if matrix.sigma[-1] <= RANK * matrix.sigma[0]:
            return f"the extended Jacobian is singular: {self.objective} has no single extremum"
        velocity = np.concatenate([self.gain * task.errors, -self.restore * constraint])
        asked = np.zeros(state.arm.nv)
        asked[columns] = pseudo_inverse_step(matrix, velocity, np.zeros(len(columns)))
        return UnlimitedStep(asked, task.points, len(extended), matrix.sigma)

    def system(self, state: ArmState, task: BaselineTask) -> tuple[NDArray[np.intp], Array, Array]:
        """Return the extended Jacobian J_e and the constraint f_c.

        Returns:
            Tangent space indices of the n joints that move the end-effector; J_e (n, n) [m per unit], whose
            last n - d rows are those of f_c; and f_c (n - d,) [m], multiplied by the arm length to match the
            units of J. If J is singular, J_e is empty.
        """
        derivatives = PositionDerivatives(state, task.end_effector)
        columns, length = derivatives.columns, state.arm.length
        jacobian = task.jacobian[:, columns]
        left, sigma, right = np.linalg.svd(jacobian)
        rank = int(np.count_nonzero(sigma > RANK * sigma[0]))
        if rank < len(jacobian):
            return columns, np.zeros((0, len(columns))), np.zeros(0)
        null = right[rank:]  # N^T, (n - d, n)
        gradient = objective_gradient(self.objective, state, task.end_effector)[columns]
        hessian = objective_hessian(self.objective, state, task.end_effector)[np.ix_(columns, columns)]
        multipliers = left @ ((right[:rank] @ gradient) / sigma)
        reduced = null @ (hessian - derivatives.second() @ multipliers)
        return columns, np.vstack([jacobian, length * reduced]), length * (null @ gradient)


BASELINES: dict[str, Callable[[], Controller]] = {
    "pinv": PseudoInverse,
    "task-constraints": TaskConstraints,
    "extended": ExtendedJacobian,
    "augmented": AugmentedJacobian,
    "dls": DampedLeastSquares,
    "lm": LevenbergMarquardt,
}
"""The baselines with their default parameters, by name."""


def register_baselines() -> None:
    """Make the baselines available by name to `track` and `controller_named`.

    Names that are already taken keep their controllers.
    """
    for name, make in BASELINES.items():
        CONTROLLERS.setdefault(name, make)


def named_controllers(controllers: Sequence[str | Controller]) -> list[Controller]:
    """Look up controllers by name, including baselines.

    Raises:
        InvalidValue: no controllers are given.
        UnknownName: no controller has that name.
    """
    if len(controllers) == 0:
        raise InvalidValue("controllers", list(controllers), "at least one")
    register_baselines()
    return [controller_named(controller) for controller in controllers]
