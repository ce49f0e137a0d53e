"""The Selection method: move the control points that can be moved safely (Chapter 4)."""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from pinposture.arm import ArmState
from pinposture.control.candidates import active_set
from pinposture.control.checks import require_positive, require_share
from pinposture.control.controller import Diagnostics, Memory, Step, stack_rows, task_errors
from pinposture.control.gradient import descent
from pinposture.control.limits import Limits
from pinposture.control.solve import Decomposition, decompose, pseudo_inverse_step
from pinposture.target import Target

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Selection:
    """Selection method with its parameters; the defaults come from `benchmarks/parameters.py`.

    At each step it takes the candidate control set with the largest posture error (4.5), stacks the
    Jacobians of its points into the posture control matrix (4.6), and moves them straight towards their
    targets; the other points follow the descent direction of the posture error as far as that leaves
    room (4.7).

    Attributes:
        absolute: the manipulability index of each active point relative to the base exceeds this.
        relative: the index of each active point relative to the one before it exceeds this.
        conditioning: smallest singular value that the posture control matrix must have, relative to the
            arm length [1/rad]. Points are dropped until it does: full rank is not yet good conditioning.
        gain: share of its error that an active point is asked to cover in one step (K).
        null_gain: weight of the null-space term (alpha, positive for descent); see `control.gradient`.
    """

    absolute: float = 0.001
    relative: float = 0.001
    conditioning: float = 1e-4
    gain: float = 1.0
    null_gain: float = 0.5
    name: str = "selection"

    def __post_init__(self) -> None:
        for field in ("absolute", "relative"):
            require_share(field, getattr(self, field))
        require_positive("gain", self.gain)
        require_positive("conditioning", self.conditioning)
        require_positive("null_gain", self.null_gain, zero=True)

    def step(
        self, state: ArmState, target: Target, limits: Limits | None = None, memory: Memory | None = None
    ) -> Step:
        """Compute one step; see `Controller.step`. Without a candidate set it stands still and says so."""
        limits = Limits() if limits is None else limits
        errors = task_errors(state, target)
        distances = np.linalg.norm(errors, axis=1)
        indices = state.manipulability()
        chosen = active_set(indices, distances, self.absolute, self.relative, target.placed)
        active, matrix = self._conditioned(state, chosen)
        dropped = tuple(k for k in chosen if k not in active)
        if matrix is None:
            held = np.zeros(state.arm.nv)
            none = Diagnostics(
                0.0, 0.0, 0.0, 0, dropped, 1.0, held > 0.0, self._why_none(indices, chosen, target)
            )
            return Step(held, (), none, Memory(held))
        gradient = self.null_gain * descent(state, errors, distances)
        asked = pseudo_inverse_step(matrix, self.gain * errors[list(active)].ravel(), gradient)
        limited = limits.apply(state, asked * state.arm.joint_units)
        diagnostics = Diagnostics(
            manipulability=float(min(indices[s, i] for s, i in _sections(active))),
            sigma_min=float(matrix.sigma[-1]),
            sigma_max=float(matrix.sigma[0]),
            rows=len(matrix.sigma),
            dropped=dropped,
            scale=limited.scale,
            clipped=limited.clipped,
            reason="",
        )
        return Step(limited.dq, active, diagnostics, Memory(limited.dq))

    def _conditioned(
        self, state: ArmState, chosen: tuple[int, ...]
    ) -> tuple[tuple[int, ...], Decomposition | None]:
        """Drop points until the posture control matrix is far enough from singular."""
        active = list(chosen)
        while active:
            matrix = decompose(stack_rows(state.task_jacobians[active]))
            if matrix.sigma[-1] > self.conditioning * state.arm.length:
                return tuple(active), matrix
            # The rows that make the matrix nearly singular are those of its last left singular vector.
            blame = np.linalg.norm(matrix.left[:, -1].reshape(len(active), -1), axis=1)
            del active[int(np.argmax(blame))]
        return (), None

    def _why_none(self, indices: Array, chosen: tuple[int, ...], target: Target) -> str:
        if chosen:
            kept = f"conditioning = {self.conditioning:g} of the arm length"
            return f"no control point keeps the smallest singular value of its own Jacobian above {kept}"
        best = float(np.max(indices[0, 1:], where=target.placed, initial=0.0))
        return (
            f"no control point with a target clears the absolute manipulability condition: the largest "
            f"index is {best:.2g}, the threshold {self.absolute:g}; the posture is singular or nearly so"
        )


def _sections(active: tuple[int, ...]) -> list[tuple[int, int]]:
    """Entries of the index matrix that an active set must clear: to the base, and to its neighbour."""
    absolute = [(0, k + 1) for k in active]
    return absolute + [(s + 1, i + 1) for s, i in pairwise(active)]
