"""What the arm is asked to do, as one weighted sum of squares."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from pinposture.arm import Arm, ArmState
from pinposture.control.controller import task_errors
from pinposture.control.tasks import Task
from pinposture.target import Target

Array = NDArray[np.float64]


STRICT = 1e4
"""How much strict tasks weigh in the merit, which they dominate. Steps put them first exactly."""


class Linear(NamedTuple):
    """Rows that say what a step x should do: matrix @ x = errors, in metres.

    Attributes:
        matrix: (r, n) [m per `Arm.joint_units`], columns as `Posture.columns`.
        errors: (r,) [m].
    """

    matrix: Array
    errors: Array


@dataclass(frozen=True, eq=False)
class Posture:
    """A target posture with whatever else is asked of the arm.

    Rows ask of each control point with a target to cover its error, and of each pair of neighbours among them
    to cover the error of the chord between them: the difference of the two. Chords make the sum of squares
    feel directions as well as places, which conditions it better and leaves fewer local minima. Rows of
    further tasks follow.

    Attributes:
        arm: the arm.
        target: where its control points should be; squared errors are weighed by `Target.weights`.
        tasks: what else it should do.
        chord: weight of the squared error of a chord, where that of a point has weight 1.
    """

    arm: Arm
    target: Target
    tasks: Sequence[Task] = ()
    chord: float = 1.0

    @cached_property
    def columns(self) -> NDArray[np.intp]:
        """Degrees of freedom of the chain that have room to move, from base to tip, (n,)."""
        limits, columns = self.arm.limits, self.arm.columns
        return np.asarray(columns[limits.upper[columns] > limits.lower[columns]])

    @cached_property
    def units(self) -> Array:
        """The motion of each of them that counts as one, (n,) [rad or m]."""
        return np.asarray(self.arm.joint_units[self.columns])

    @cached_property
    def _placed(self) -> NDArray[np.intp]:
        return np.flatnonzero(self.target.placed)

    @cached_property
    def _roots(self) -> tuple[Array, Array]:
        """Square roots of the weights of points (p, 1) and of chords (p - 1, 1)."""
        weights = self.target.weights[self._placed]
        chords = self.chord * np.minimum(weights[1:], weights[:-1])
        return np.sqrt(weights)[:, None], np.sqrt(chords)[:, None]

    def rows(self, state: ArmState) -> Linear:
        """The rows that are weighed against each other, scaled so that their squares add up."""
        placed, (points, chords) = self._placed, self._roots
        errors = task_errors(state, self.target)[placed]
        jacobians = state.task_jacobians[placed][:, :, self.columns]
        n = len(self.columns)
        blocks = [(points[:, :, None] * jacobians).reshape(-1, n)]
        wanted = [(points * errors).ravel()]
        if self.chord > 0.0:
            blocks.append((chords[:, :, None] * (jacobians[1:] - jacobians[:-1])).reshape(-1, n))
            wanted.append((chords * (errors[1:] - errors[:-1])).ravel())
        weighed = self.task_rows(state, strict=False)
        if weighed is not None:
            blocks.append(weighed.matrix)
            wanted.append(weighed.errors)
        return Linear(np.concatenate(blocks), np.concatenate(wanted))

    def task_rows(self, state: ArmState, strict: bool) -> Linear | None:
        """Rows of the tasks that are strict, or of those that are not, with the roots of their weights.

        None if there are no such tasks.
        """
        matrices, errors = [], []
        for task in self.tasks:
            if task.strict == strict:
                rows, root = task.rows(state, self.target), float(np.sqrt(task.weight))
                matrices.append(root * rows.jacobian[:, self.columns] * self.units)
                errors.append(root * rows.error)
        return Linear(np.concatenate(matrices), np.concatenate(errors)) if matrices else None

    def merit(self, state: ArmState) -> float:
        """Half the sum of all squares [m^2], those of strict tasks `STRICT` times."""
        errors, strict = self.rows(state).errors, self.task_rows(state, strict=True)
        first = 0.0 if strict is None else STRICT * float(strict.errors @ strict.errors)
        return 0.5 * (float(errors @ errors) + first)

    def mean_error(self, state: ArmState) -> float:
        """Mean distance of the control points from their targets [m]."""
        return float(np.linalg.norm(task_errors(state, self.target), axis=1).sum()) / len(self._placed)

    def moved(self, state: ArmState, x: Array) -> ArmState:
        """The state after a step x, (n,)."""
        return self.arm.at(self.arm.integrate(state.q, self.displacement(x)))

    def displacement(self, x: Array) -> Array:
        """Joint displacement (nv,) [rad or m] of a step x, (n,); all other joints stand still."""
        dq = np.zeros(self.arm.nv)
        dq[self.columns] = x * self.units
        return dq

    def own(self, dq: Array) -> Array:
        """The step x (n,), in `Arm.joint_units`, that makes up a joint displacement (nv,) [rad or m]."""
        return np.asarray(dq[self.columns] / self.units)
