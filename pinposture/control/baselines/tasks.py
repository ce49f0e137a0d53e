"""What the baselines have in common: the task they solve, and how a step is finished."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from pinposture.arm import ArmState
from pinposture.control.controller import Diagnostics, Memory, Step, stack_rows, task_errors
from pinposture.control.limits import Limits
from pinposture.control.thesis.posture_matrix import Decomposition
from pinposture.placement import Target

Array = NDArray[np.float64]

RANK = 1e-12
"""Singular values up to this share of the largest one count as zero: they are rounding errors."""


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
    """The task of moving some control points (N,) to their targets."""
    jacobian = stack_rows(state.task_jacobians[points])
    return BaselineTask(tuple(int(k) for k in points), jacobian, task_errors(state, target)[points].ravel())


def end_effector_task(state: ArmState, target: Target) -> BaselineTask:
    """The task of the end-effector alone, which is the last control point that has a target."""
    return task_of(state, target, np.flatnonzero(target.placed)[-1:])


def all_points_task(state: ArmState, target: Target) -> BaselineTask:
    """The task of all control points that have a target, stacked (2.15)."""
    return task_of(state, target, np.flatnonzero(target.placed))


def regular_part(matrix: Decomposition) -> Decomposition:
    """The decomposition without its zero singular values: what a pseudo-inverse inverts."""
    rank = int(np.count_nonzero(matrix.sigma > RANK * matrix.sigma[0]))
    return Decomposition(matrix.left[:, :rank], matrix.sigma[:rank], matrix.right[:rank])


def damped_step(matrix: Decomposition, velocity: Array, damping: float) -> Array:
    """The dq that minimises |J dq - dr|^2 + damping |dq|^2, for damping > 0.

    Args:
        matrix: decomposition of J.
        velocity: desired velocities of the rows dr, (r,).
        damping: weight of the step, in the units of J squared.

    Returns:
        Joint displacement (nv,) in the units of the columns of J.
    """
    share = matrix.sigma / (matrix.sigma**2 + damping)
    return np.asarray(matrix.right.T @ (share * (matrix.left.T @ velocity)))


def finished(
    state: ArmState,
    points: tuple[int, ...],
    rows: int,
    sigma: Array,
    asked: Array,
    limits: Limits,
    previous: Array | None,
) -> Step:
    """Bring a step within the limits, and describe it.

    Args:
        state: where the step begins.
        points: the control points that it moves.
        rows: number of rows of the matrix that was inverted.
        sigma: its singular values in any order, at least one [m/rad].
        asked: joint displacement asked for, (nv,), in `Arm.joint_units`.
        limits: what the step may not exceed.
        previous: the step before, (nv,) [rad or m]; None: there was none.

    Returns:
        The step. Its manipulability index is the smallest of its points relative to the base.
    """
    arm = state.arm
    # Joints off the chain have zero columns, and singular vectors round zero.
    moved = asked * arm.joint_units * arm.moved
    limited = limits.apply(state, moved, previous)
    diagnostics = Diagnostics(
        manipulability=float(state.manipulability()[0, np.array(points) + 1].min()),
        sigma_min=float(sigma.min()),
        sigma_max=float(sigma.max()),
        rows=rows,
        dropped=(),
        scale=limited.scale,
        clipped=limited.clipped,
        reason="",
    )
    return Step(limited.dq, points, diagnostics, Memory(limited.dq))


def held(state: ArmState, reason: str, limits: Limits, previous: Array | None) -> Step:
    """A step that only brakes, if there is anything to brake, and why."""
    still = limits.hold(state, previous)
    none = Diagnostics(0.0, 0.0, 0.0, 0, (), still.scale, still.clipped, reason)
    return Step(still.dq, (), none, Memory(still.dq))
