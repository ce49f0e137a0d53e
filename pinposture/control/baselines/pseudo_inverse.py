"""The pseudo-inverse of the end-effector Jacobian, with an objective function in its null space."""

from __future__ import annotations

from dataclasses import dataclass

from pinposture.arm import ArmState
from pinposture.control.baselines.baseline import NullSpaceMethod
from pinposture.control.baselines.tasks import BaselineTask, end_effector_task
from pinposture.placement import Target


@dataclass(frozen=True)
class PseudoInverse(NullSpaceMethod):
    """Moves the end-effector alone: dq = J^+ dp + (I - J^+J) k grad h, (2.6) and (2.7).

    The end-effector is the last control point that has a target; where the others go is nobody's concern.
    Nothing is damped: near a singular posture the step grows as 1 / sigma_min, and at one the directions
    that are lost are left out. Its parameters are those of `NullSpaceMethod`.
    """

    name: str = "pinv"

    def _task(self, state: ArmState, target: Target) -> BaselineTask:
        return end_effector_task(state, target)
