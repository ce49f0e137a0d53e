"""All control points at once by plain pseudo-inverse: what Section 4.3 warns of."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from pinposture.arm import ArmState
from pinposture.control.baselines.objectives import Objective, require_objective
from pinposture.control.baselines.pseudo_inverse import null_space_step
from pinposture.control.baselines.tasks import NO_TARGET, all_points_task, held
from pinposture.control.checks import require_positive
from pinposture.control.controller import Memory, Step
from pinposture.control.limits import Limits
from pinposture.target import Target


@dataclass(frozen=True)
class AugmentedJacobian:
    """Stacks the Jacobians of all control points that have a target, (2.15), and inverts the lot, (2.16).

    There are usually more rows than joints: the step is then the least-squares one. Nothing is damped, so
    wherever rows of different points nearly agree, which they often do while each point on its own moves
    freely (an algorithmic singularity, Section 3.1.3), the step is huge.

    Attributes:
        objective: what is left of the null space is used for, see `objectives.OBJECTIVES`; None: nothing.
        gain: share of its error that each point is asked to cover in one step.
        null_gain: the factor k of (2.7), positive for better.
    """

    objective: Objective | None = None
    gain: float = 1.0
    null_gain: float = 0.1
    name: str = "augmented"

    def __post_init__(self) -> None:
        require_objective(self.objective)
        require_positive("gain", self.gain)
        require_positive("null_gain", self.null_gain, zero=True)

    def step(
        self, state: ArmState, target: Target, limits: Limits | None = None, memory: Memory | None = None
    ) -> Step:
        """Compute one step; see `Controller.step`."""
        if not np.any(target.placed):
            return held(state, NO_TARGET)
        task = all_points_task(state, target)
        return null_space_step(state, task, self.objective, self.gain, self.null_gain, limits)
