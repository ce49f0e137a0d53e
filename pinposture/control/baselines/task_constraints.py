"""The end-effector first, other control points in what room it leaves."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from pinposture._validation import require_positive, require_whole
from pinposture.arm import ArmState
from pinposture.control.baselines.baseline import Baseline
from pinposture.control.baselines.tasks import (
    BaselineTask,
    end_effector_task,
    finished,
    regular_part,
    task_of,
)
from pinposture.control.controller import Step
from pinposture.control.limits import Limits
from pinposture.control.thesis.posture_matrix import Decomposition, decompose
from pinposture.placement import Target

Array = NDArray[np.float64]


@dataclass(frozen=True)
class TaskConstraints(Baseline):
    """Moves the end-effector, and other control points in its null space, (2.6) with (2.11).

        dq = J^+ dp + (I - J^+J) (J_c (I - J^+J))^+ (dp_c - J_c J^+ dp)

    The end-effector is the last control point that has a target. The others come strictly second: whatever
    is asked of them, the end-effector moves as if they were not there. (2.9) allows alpha <= n - m rows
    for them, where n joints move the end-effector and m is the rank of J: so many of them are taken, spread
    evenly along the arm. They may still ask for more than the null space can do; then the step is the
    least-squares one, and where it nearly can it is huge, for nothing is damped.

    The singular values of its diagnostics are those of J and of J_c (I - J^+J).

    Attributes:
        constraints: how many other control points to move at most; None: as many as (2.9) allows.
        gain: share of its error that each point is asked to cover in one step.
    """

    constraints: int | None = None
    gain: float = 1.0
    name: str = "task-constraints"

    def __post_init__(self) -> None:
        if self.constraints is not None:
            require_whole("constraints", self.constraints, 0)
        require_positive("gain", self.gain)

    def _step(self, state: ArmState, target: Target, limits: Limits, previous: Array | None) -> Step:
        primary = end_effector_task(state, target)
        left, every, right = np.linalg.svd(primary.jacobian)
        matrix = regular_part(Decomposition(left, every, right[: len(every)]))
        rank = len(matrix.sigma)
        null = right[rank:]  # basis of the null space, (nv - rank, nv)
        asked = matrix.right.T @ ((matrix.left.T @ (self.gain * primary.errors)) / matrix.sigma)
        secondary = self._constraints(state, target, primary, rank)
        if not secondary.points:
            return finished(state, primary.points, len(primary.errors), every, asked, limits, previous)
        # J_c (I - J^+J) has the singular values of J_c V with V the basis, and needs no projection after.
        projected = decompose(secondary.jacobian @ null.T)
        inverted = regular_part(projected)
        missing = self.gain * secondary.errors - secondary.jacobian @ asked
        asked = asked + null.T @ (inverted.right.T @ ((inverted.left.T @ missing) / inverted.sigma))
        rows = len(primary.errors) + len(secondary.errors)
        sigma = np.concatenate([every, projected.sigma])
        return finished(state, secondary.points + primary.points, rows, sigma, asked, limits, previous)

    def _constraints(self, state: ArmState, target: Target, primary: BaselineTask, rank: int) -> BaselineTask:
        """The other control points that (2.9) has room for."""
        others = np.flatnonzero(target.placed)[:-1]
        joints = int(state.arm.support[primary.end_effector].sum())
        room = (joints - rank) // state.arm.dimension
        count = min(len(others), room, len(others) if self.constraints is None else self.constraints)
        spread = np.linspace(0, len(others), count + 2)[1:-1].astype(np.intp)
        return task_of(state, target, others[spread])
