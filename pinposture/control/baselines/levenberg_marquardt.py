"""All control points at once, damped the more the farther they are from their targets."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from pinposture._validation import require_positive
from pinposture.arm import ArmState
from pinposture.control.baselines.baseline import Baseline
from pinposture.control.baselines.tasks import all_points_task, damped_step, finished
from pinposture.control.controller import Step
from pinposture.control.limits import Limits
from pinposture.control.thesis.posture_matrix import decompose
from pinposture.placement import Target

Array = NDArray[np.float64]


@dataclass(frozen=True)
class LevenbergMarquardt(Baseline):
    """Moves all control points that have a target, with the damping of Sugihara (2011).

    Each step solves (J^T W J + lambda I) dq = J^T W e, with W = diag(weights) / length^2 of the arm and
    lambda = e^T W e / 2 + bias: careful from afar, nearly Gauss-Newton close by, regular everywhere.

    The singular values of its diagnostics are those of diag(weights)^(1/2) J.

    Attributes:
        bias: damping that stays at the target, in squared arm lengths [1/rad^2].
    """

    bias: float = 1e-6
    name: str = "lm"

    def __post_init__(self) -> None:
        require_positive("bias", self.bias)

    def _step(self, state: ArmState, target: Target, limits: Limits, previous: Array | None) -> Step:
        task = all_points_task(state, target)
        weights = np.repeat(np.sqrt(target.weights[list(task.points)]), state.arm.dimension)
        matrix = decompose(weights[:, None] * task.jacobian)
        errors, length = weights * task.errors, state.arm.length
        damping = 0.5 * float(errors @ errors) + self.bias * length**2
        asked = damped_step(matrix, errors, damping)
        return finished(state, task.points, len(task.errors), matrix.sigma, asked, limits, previous)
