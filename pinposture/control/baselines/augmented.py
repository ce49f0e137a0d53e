"""All control points at once by plain pseudo-inverse: what Section 4.3 warns of."""

from __future__ import annotations

from dataclasses import dataclass

from pinposture.arm import ArmState
from pinposture.control.baselines.baseline import NullSpaceMethod
from pinposture.control.baselines.tasks import BaselineTask, all_points_task
from pinposture.placement import Target


@dataclass(frozen=True)
class AugmentedJacobian(NullSpaceMethod):
    """Stacks the Jacobians of all control points that have a target, (2.15), and inverts the lot, (2.16).

    There are usually more rows than joints: the step is then the least-squares one. Nothing is damped, so
    wherever rows of different points nearly agree, which they often do while each point on its own moves
    freely (an algorithmic singularity, Section 3.1.3), the step is huge. Its parameters are those of
    `NullSpaceMethod`.
    """

    name: str = "augmented"

    def _task(self, state: ArmState, target: Target) -> BaselineTask:
        return all_points_task(state, target)
