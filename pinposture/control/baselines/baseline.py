"""What all baselines that invert a Jacobian do first, and those with a null-space term alike."""

from __future__ import annotations

from abc import ABC, abstractmethod
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from pinposture._validation import require_positive
from pinposture.arm import ArmState
from pinposture.control.baselines.objectives import Objective, objective_gradient, require_objective
from pinposture.control.baselines.tasks import BaselineTask, finished, held, regular_part
from pinposture.control.controller import Memory, Step
from pinposture.control.limits import Limits
from pinposture.control.thesis.posture_matrix import decompose, pseudo_inverse_step
from pinposture.placement import Target

Array = NDArray[np.float64]


class Baseline(ABC):
    """A method that remembers nothing but its step, and stands still if no control point has a target."""

    def step(
        self, state: ArmState, target: Target, limits: Limits | None = None, memory: Memory | None = None
    ) -> Step:
        """Compute one step; see `Controller.step`."""
        limits = Limits() if limits is None else limits
        previous = memory.dq if memory is not None else None
        if not np.any(target.placed):
            return held(state, "no control point has a target", limits, previous)
        return self._step(state, target, limits, previous)

    @abstractmethod
    def _step(self, state: ArmState, target: Target, limits: Limits, previous: Array | None) -> Step:
        """Compute one step; some control point has a target."""


@dataclass(frozen=True)
class NullSpaceMethod(Baseline):
    """The step J^+ K dp + (I - J^+J) k grad h of a task, (2.6), (2.7) and (2.16).

    Attributes:
        objective: what the null space is used for, see `objectives.OBJECTIVES`; None: nothing, the shortest
            step.
        gain: share of its error that each point of the task is asked to cover in one step.
        null_gain: the factor k of (2.7), positive for better. Joints take null_gain times the slope of h.
    """

    objective: Objective | None = None
    gain: float = 1.0
    null_gain: float = 0.1

    def __post_init__(self) -> None:
        require_objective(self.objective)
        require_positive("gain", self.gain)
        require_positive("null_gain", self.null_gain, zero=True)

    @abstractmethod
    def _task(self, state: ArmState, target: Target) -> BaselineTask:
        """What is to be moved."""

    def _step(self, state: ArmState, target: Target, limits: Limits, previous: Array | None) -> Step:
        task = self._task(state, target)
        matrix = decompose(task.jacobian)
        kappa = np.zeros(state.arm.nv)
        if self.objective is not None:
            kappa = self.null_gain * objective_gradient(self.objective, state, task.end_effector)
        asked = pseudo_inverse_step(regular_part(matrix), self.gain * task.errors, kappa)
        return finished(state, task.points, len(task.errors), matrix.sigma, asked, limits, previous)
