"""The pseudo-inverse of the end-effector Jacobian, with an objective function in its null space."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from pinposture.arm import ArmState
from pinposture.control.baselines.objectives import Objective, objective_gradient, require_objective
from pinposture.control.baselines.tasks import (
    NO_TARGET,
    Task,
    end_effector_task,
    finished,
    held,
    regular_part,
)
from pinposture.control.checks import require_positive
from pinposture.control.controller import Memory, Step
from pinposture.control.limits import Limits
from pinposture.control.solve import decompose, pseudo_inverse_step
from pinposture.target import Target


@dataclass(frozen=True)
class PseudoInverse:
    """Moves the end-effector alone: dq = J^+ dp + (I - J^+J) k grad h, (2.6) and (2.7).

    The end-effector is the last control point that has a target; where the others go is nobody's concern.
    Nothing is damped: near a singular posture the step grows as 1 / sigma_min, and at one the directions
    that are lost are left out.

    Attributes:
        objective: what the null space is used for, see `objectives.OBJECTIVES`; None: nothing, the shortest
            step.
        gain: share of the error that the end-effector is asked to cover in one step.
        null_gain: the factor k of (2.7), positive for better. Joints take null_gain times the slope of h.
    """

    objective: Objective | None = None
    gain: float = 1.0
    null_gain: float = 0.1
    name: str = "pinv"

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
        task = end_effector_task(state, target)
        return null_space_step(state, task, self.objective, self.gain, self.null_gain, limits)


def null_space_step(
    state: ArmState,
    task: Task,
    objective: Objective | None,
    gain: float,
    null_gain: float,
    limits: Limits | None,
) -> Step:
    """The step J^+ K dp + (I - J^+J) k grad h of a task, within the limits."""
    matrix = decompose(task.jacobian)
    kappa = np.zeros(state.arm.nv)
    if objective is not None:
        kappa = null_gain * objective_gradient(objective, state, task.end_effector)
    asked = pseudo_inverse_step(regular_part(matrix), gain * task.errors, kappa)
    return finished(state, task.points, len(task.errors), matrix.sigma, asked, limits)
