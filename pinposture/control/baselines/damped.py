"""All control points at once, with constant damping."""

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
class DampedLeastSquares(Baseline):
    """Moves all control points that have a target: dq minimises |J dq - K e|^2 + lambda^2 |dq|^2.

    No step is longer than |K e| / (2 lambda), singular or not; in exchange, directions with singular values
    below lambda hardly move, also where they could.

    Attributes:
        damping: lambda relative to the arm length [1/rad].
        gain: share of its error that each point is asked to cover in one step (K).
    """

    damping: float = 0.02
    gain: float = 1.0
    name: str = "dls"

    def __post_init__(self) -> None:
        require_positive("damping", self.damping)
        require_positive("gain", self.gain)

    def _step(self, state: ArmState, target: Target, limits: Limits, previous: Array | None) -> Step:
        task = all_points_task(state, target)
        matrix = decompose(task.jacobian)
        damping = (self.damping * state.arm.length) ** 2
        asked = damped_step(matrix, self.gain * task.errors, damping)
        return finished(state, task.points, len(task.errors), matrix.sigma, asked, limits, previous)
