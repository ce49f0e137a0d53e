"""The Selection method: move the control points that can be moved safely (Chapter 4)."""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from pinposture.arm import Arm, ArmState
from pinposture.control.candidates import active_set
from pinposture.control.checks import require_positive, require_share
from pinposture.control.controller import Diagnostics, Memory, Step, stack_rows, task_errors
from pinposture.control.gradient import descent
from pinposture.control.limits import Limits
from pinposture.control.section_index import section_indices
from pinposture.control.sections import SectionScore, SectionTree, checked_strides
from pinposture.control.solve import Decomposition, decompose, pseudo_inverse_step
from pinposture.errors import UnknownName
from pinposture.target import Target

Array = NDArray[np.float64]

SCORES = ("auto", "error", "geometric", "thesis")


@dataclass(frozen=True)
class Selection:
    """Selection method with its parameters; the defaults come from `benchmarks/parameters.py`.

    At each step it takes the control set with the largest score, stacks the Jacobians of its points into the
    posture control matrix (4.6), and moves them straight towards their targets; the other points follow the
    descent direction of the posture error as far as that leaves room (4.7).

    Attributes:
        absolute: the manipulability index of each active point relative to the base exceeds this.
        relative: the index of each active point relative to the one before it exceeds this. In a tree of
            sections, that of the section into each point does, relative to the best it can have.
        conditioning: smallest singular value that the posture control matrix must have, relative to the
            arm length [1/rad]. Points are dropped until it does: full rank is not yet good conditioning.
        gain: share of its error that an active point is asked to cover in one step (K).
        null_gain: weight of the null-space term (alpha, positive for descent); see `control.gradient`.
        score: which control sets there are, and which of them is taken:

            * "error": the candidate sets of Section 4.3; the one with the largest posture error (4.5).
            * "thesis": the branches of the tree of sections of Section 4.6.1, over the region from the first
              to the last point that has a target; the one with the largest (4.8). It takes few points: one
              more pays only if the index of its section exceeds (eta + 1) / (eta + 2).
            * "geometric": the same tree; (4.8) with the geometric mean of the indices for their product.
            * "auto": "geometric" for planar arms of one-joint modules, as long as no point within the region
              is free; otherwise "error". The planar arm of the thesis ends equally close with both, but more
              steadily with "geometric": on the way to random postures, the posture error rises on 5 % of the
              steps in place of 25 %. "error" takes turns among the points.
        strides: how many modules a section of the tree may have; of no use to "error". Modules of two joints
            call for (1,).
    """

    absolute: float = 0.001
    relative: float = 0.001
    conditioning: float = 1e-4
    gain: float = 1.0
    null_gain: float = 0.5
    score: Literal["auto", "error", "geometric", "thesis"] = "auto"
    strides: tuple[int, ...] = (2, 3)
    name: str = "selection"

    def __post_init__(self) -> None:
        for field in ("absolute", "relative"):
            require_share(field, getattr(self, field))
        require_positive("gain", self.gain)
        require_positive("conditioning", self.conditioning)
        require_positive("null_gain", self.null_gain, zero=True)
        if self.score not in SCORES:
            raise UnknownName("score", self.score, SCORES)
        object.__setattr__(self, "strides", checked_strides(self.strides))

    def step(
        self, state: ArmState, target: Target, limits: Limits | None = None, memory: Memory | None = None
    ) -> Step:
        """Compute one step; see `Controller.step`. Without a candidate set it stands still and says so."""
        limits = Limits() if limits is None else limits
        previous = memory.dq if memory is not None else None
        errors = task_errors(state, target)
        distances = np.linalg.norm(errors, axis=1)
        indices = state.manipulability()
        chosen = self._chosen(state, target, distances)
        active, matrix = self._conditioned(state, chosen)
        dropped = tuple(k for k in chosen if k not in active)
        if matrix is None:
            held, reason = limits.hold(state, previous), self._why_none(indices, chosen, target)
            none = Diagnostics(0.0, 0.0, 0.0, 0, dropped, held.scale, held.clipped, reason)
            return Step(held.dq, (), none, Memory(held.dq))
        gradient = self.null_gain * descent(state, errors, distances)
        asked = pseudo_inverse_step(matrix, self.gain * errors[list(active)].ravel(), gradient)
        arm = state.arm  # joints off the chain have zero columns, and singular vectors round zero
        limited = limits.apply(state, asked * arm.joint_units * arm.moved, previous)
        diagnostics = Diagnostics(
            manipulability=float(min(indices[s, i] for s, i in _neighbours(active))),
            sigma_min=float(matrix.sigma[-1]),
            sigma_max=float(matrix.sigma[0]),
            rows=len(matrix.sigma),
            dropped=dropped,
            scale=limited.scale,
            clipped=limited.clipped,
            reason="",
        )
        return Step(limited.dq, active, diagnostics, Memory(limited.dq))

    def _chosen(self, state: ArmState, target: Target, distances: Array) -> tuple[int, ...]:
        """The control set with the largest score; empty if there is none."""
        indices = state.manipulability()
        region = np.flatnonzero(target.placed)
        score = self._section_score(state.arm, region)
        if score is None or not len(region):
            return active_set(indices, distances, self.absolute, self.relative, target.placed)
        usable = (indices[0, 1:] > self.absolute) & target.placed
        ends = int(region[0]), int(region[-1])
        compared = section_indices(state, self.strides)
        return SectionTree(compared, usable, self.relative, *ends, self.strides).best(score).points

    def _section_score(self, arm: Arm, region: NDArray[np.intp]) -> SectionScore | None:
        """How branches of the tree of sections are scored; None if the sets are not taken from it."""
        if self.score == "auto":
            planar = arm.dimension == 2 and len(arm.columns) == arm.n_modules
            return "geometric" if planar and np.all(np.diff(region) == 1) else None
        return None if self.score == "error" else self.score

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
        if best > self.absolute:
            modules = " or ".join(map(str, self.strides))
            return (
                f"no section of {modules} modules to a control point with a target is stable: none has more "
                f"than relative = {self.relative:g} of its best index; the posture is singular or nearly so, "
                f"or the region is too short"
            )
        return (
            f"no control point with a target clears the absolute manipulability condition: the largest "
            f"index is {best:.2g}, the threshold {self.absolute:g}; the posture is singular or nearly so"
        )


def _neighbours(active: tuple[int, ...]) -> list[tuple[int, int]]:
    """Entries of the index matrix that concern an active set: to the base, and to the point before."""
    absolute = [(0, k + 1) for k in active]
    return absolute + [(s + 1, i + 1) for s, i in pairwise(active)]
