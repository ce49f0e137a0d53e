"""The Selection method: move the control points that can move well together (Chapter 4)."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from pinposture import kernels
from pinposture._validation import require_known, require_positive, require_share
from pinposture.arm import Arm, ArmState
from pinposture.control.controller import Memory, Step, checked_limits, step_within
from pinposture.control.limits import Limits
from pinposture.control.thesis.posture_matrix import (
    Gain,
    NullObjective,
    PostureMatrix,
    aligned_errors,
    checked_gain,
    gained,
    null_motion,
)
from pinposture.control.thesis.sections import SectionScore, best_branch, checked_section_sizes, section_edges
from pinposture.errors import InvalidValue
from pinposture.kernels.arrays import COUPLING, Rows, Screws
from pinposture.placement import Target

# Candidate control sets, and the active one among them (Sections 4.3 and 4.4).
#
# A set of control points is a candidate if each of its points meets the absolute manipulability condition and
# each pair of neighbours in it the relative one. The sets are hence the paths of a directed graph, and the
# one with the largest sum of errors is a longest path, found in O(m^2) without enumerating up to 2^m sets.

Array = NDArray[np.float64]
Whole = NDArray[np.int64]


def candidate_sets(indices: Array, absolute: float, relative: float) -> Iterator[tuple[int, ...]]:
    """Enumerate all candidate control sets (Figure 4.5).

    Args:
        indices: manipulability indices (m + 1, m + 1) from `ArmState.manipulability`.
        absolute: threshold that the index of each point relative to the base must exceed.
        relative: threshold that the index of each point relative to the previous one must exceed.

    Yields:
        Increasing tuples of control point indices, 0-based; up to 2^m - 1 of them.
    """
    clears, follows = _conditions(indices, absolute, relative)

    def continued(path: tuple[int, ...]) -> Iterator[tuple[int, ...]]:
        yield path
        for i in np.flatnonzero(follows[path[-1]]):
            yield from continued((*path, int(i)))

    for first in np.flatnonzero(clears):
        yield from continued((int(first),))


def active_set(
    indices: Array, errors: Array, absolute: float, relative: float, eligible: NDArray[np.bool_] | None = None
) -> tuple[int, ...]:
    """Return the candidate control set with the largest sum of errors (4.5), without enumerating them.

    Args:
        indices: manipulability indices (m + 1, m + 1).
        errors: distance of each control point from its target, (m,) [m].
        absolute: threshold of the absolute condition.
        relative: threshold of the relative condition.
        eligible: which points may be used, (m,); all of them if None.

    Returns:
        Increasing indices of control points, 0-based; empty if there is no candidate set.
    """
    clears, follows = _conditions(indices, absolute, relative)
    if eligible is not None:
        clears = clears & eligible
    follows = follows & clears[:, None] & clears[None, :]
    score = np.where(clears, errors, -np.inf)
    before = np.full(len(errors), -1)
    for i in np.flatnonzero(clears):
        reaching = np.where(follows[:i, i], score[:i], 0.0)
        best = int(reaching.argmax()) if i else 0
        if i and reaching[best] > 0.0:
            score[i] += reaching[best]
            before[i] = best
    if not np.any(clears):
        return ()
    path = [int(np.argmax(score))]
    while before[path[-1]] >= 0:
        path.append(int(before[path[-1]]))
    return tuple(reversed(path))


def base_indices(arm: Arm, screws: Screws, threshold: float) -> Array:
    """Return the indices of all points relative to the base, (m,), accurate where near the threshold."""
    indices = np.empty(arm.n_modules)
    kernels.base_indices(screws, arm.kinematics.task_constants.plane, threshold, indices)
    return indices


def best_set(arm: Arm, screws: Screws, usable: NDArray[np.bool_], errors: Array, relative: float) -> Whole:
    """Return the set of `active_set`, computing only the few indices that it needs.

    Args:
        arm: the arm.
        screws: the screws of its joints.
        usable: which control points meet the absolute condition and may be used, (m,).
        errors: distance of each control point from its target, (m,) [m].
        relative: threshold of the relative condition.

    Returns:
        Increasing indices of control points, 0-based; empty if there is no candidate set.
    """
    path = np.empty(arm.n_modules, dtype=np.int64)
    count = kernels.best_path(screws, arm.kinematics.task_constants.plane, usable, errors, relative, path)
    return path[:count]


def _conditions(
    indices: Array, absolute: float, relative: float
) -> tuple[NDArray[np.bool_], NDArray[np.bool_]]:
    """Return which points meet the absolute condition (m,), and which may follow which (m, m)."""
    if indices.ndim != 2 or indices.shape[0] != indices.shape[1] or indices.shape[0] < 2:
        raise InvalidValue("indices (shape)", indices.shape, "(m + 1, m + 1) with m >= 1")
    clears = indices[0, 1:] > absolute
    return clears, np.triu(indices[1:, 1:] > relative, 1) & clears[:, None] & clears[None, :]


@dataclass(frozen=True)
class Selection:
    """Selection method with its parameters; the defaults come from `benchmarks/studies/parameters.py`.

    Each step selects the control set with the largest score, stacks the Jacobians of its points into the
    posture control matrix (4.6), and moves them straight towards their targets. The other points descend the
    posture error in the null space (4.7).

    Attributes:
        absolute: threshold of the manipulability index of each active point relative to the base.
        relative: threshold of the index of each active point relative to the previous one. In a tree of
            sections, it applies to the index of the section that ends at the point, relative to its best.
        conditioning: smallest singular value allowed for the posture control matrix, relative to the length
            [1/rad] of at most 50 modules, as it does not grow with the number of modules. Points that would
            violate it are dropped, starting from the base.
        gain: share of its error that an active point covers in one step (K); one number or (m,).
        null_gain: weight of the null-space term (alpha, positive for descent); see `posture_matrix`.
        null_objective: replacement of the null-space descent of (4.7); see `NullObjective`.
        score: which control sets are considered, and which of them is selected:

            * "error": of the candidate sets of Section 4.3, the one with the largest posture error (4.5).
            * "thesis": of the branches of the tree of sections of Section 4.6.1, over the region from the
              first to the last point with a target, the one with the largest (4.8). It selects few points:
              one more raises the score only if the index of its section exceeds (eta + 1) / (eta + 2).
            * "geometric": the same tree; (4.8) with the geometric mean of the indices for their product.
            * "auto": "geometric" for planar arms of one-joint modules if all points of the region have
              targets, otherwise "error". The planar arm of the thesis ends equally close with both, but the
              posture error rises on 5 % of the steps to random postures with "geometric", and on 25 % with
              "error", which alternates between points.
        section_sizes: numbers of modules that a section of the tree may have; ignored with "error". Modules
            of two joints need (1,).
    """

    absolute: float = 0.001
    relative: float = 0.001
    conditioning: float = 1e-4
    gain: Gain = 1.0
    null_gain: float = 0.5
    null_objective: NullObjective | None = None
    score: Literal["auto", "error", "geometric", "thesis"] = "auto"
    section_sizes: tuple[int, ...] = (2, 3)
    name: str = "selection"

    def __post_init__(self) -> None:
        for field in ("absolute", "relative"):
            require_share(field, getattr(self, field))
        object.__setattr__(self, "gain", checked_gain(self.gain))
        require_positive("conditioning", self.conditioning)
        require_positive("null_gain", self.null_gain, zero=True)
        require_known("score", self.score, ("auto", "error", "geometric", "thesis"))
        object.__setattr__(self, "section_sizes", checked_section_sizes(self.section_sizes))

    @classmethod
    def as_printed(cls, planar: bool = False) -> Selection:
        """Return the method as printed in Chapter 4, with the sign of the errors corrected.

        The set has the largest posture error (4.5), or for planar arms of one-joint modules the largest
        (4.8). No point is dropped for conditioning. The null-space term (4.7), summed over active points, is
        zero.
        """
        no_point = 1e-12
        return cls(score="thesis" if planar else "error", conditioning=no_point, null_gain=0.0)

    def step(
        self, state: ArmState, target: Target, limits: Limits | None = None, memory: Memory | None = None
    ) -> Step:
        """Compute one step; see `Controller.step`. Without a candidate set the arm stops, with a reason."""
        limits = checked_limits(state, target, limits, memory)
        previous = memory.dq if memory is not None else None
        arm = state.arm
        screws = state.screws
        placed = target.has_target
        errors = aligned_errors(state, target)
        distances = np.sqrt(np.einsum("ij,ij->i", errors, errors))
        base = base_indices(arm, screws, self.absolute)
        chosen = self._chosen(arm, screws, placed, distances, base)
        kept = self._conditioned(arm, screws, chosen)
        active = chosen[kept]
        dropped = np.zeros(arm.n_modules, dtype=np.bool_)
        dropped[chosen[~kept]] = True
        if not len(active):
            reason = self._explain_failure(base, chosen, placed)
            return step_within(limits.hold(state, previous), reason=reason, info={"dropped": dropped})
        matrix = PostureMatrix(screws, _full_rows(arm, active))
        secondary = self.null_gain * null_motion(self.null_objective, state, target, screws, errors)
        asked = matrix.step(arm, gained(self.gain, errors)[active], secondary)
        limited = limits.apply(state, asked, previous)
        weakest = kernels.weakest_index(screws, arm.kinematics.task_constants.plane, active, base)
        info = {"manipulability": weakest, **matrix.info, "dropped": dropped}
        return step_within(limited, active.tolist(), info=info)

    def _chosen(
        self, arm: Arm, screws: Screws, placed: NDArray[np.bool_], distances: Array, base: Array
    ) -> NDArray[np.int64]:
        """Return the control set with the largest score; empty if there is none."""
        usable = (base > self.absolute) & placed
        region = np.flatnonzero(placed)
        score = self._section_score(arm, region)
        if score is None or not len(region):
            return best_set(arm, screws, usable, distances, self.relative)
        edges = section_edges(arm, screws, usable, self.relative, self.section_sizes)
        points = best_branch(edges, int(region[0]), int(region[-1]), score).points
        return np.array(points, dtype=np.int64)

    def _section_score(self, arm: Arm, region: NDArray[np.intp]) -> SectionScore | None:
        """Return the score of branches of the tree of sections; None if it is not used."""
        if self.score == "auto":
            planar = arm.dimension == 2 and len(arm.columns) == arm.n_modules
            unbroken = planar and len(region) and region[-1] - region[0] == len(region) - 1
            return "geometric" if unbroken else None
        return None if self.score == "error" else self.score

    def _conditioned(self, arm: Arm, screws: Screws, chosen: NDArray[np.int64]) -> NDArray[np.bool_]:
        """Return which of the points keep the posture control matrix well conditioned."""
        kept = np.empty(len(chosen), dtype=bool)
        counted = arm.length * min(1.0, 50 / arm.n_modules)
        least = self.conditioning * counted
        kernels.well_conditioned(screws, _full_rows(arm, chosen), least, kept)
        return kept

    def _explain_failure(self, base: Array, chosen: NDArray[np.int64], placed: NDArray[np.bool_]) -> str:
        if len(chosen):
            kept = f"conditioning = {self.conditioning:g} of the arm length"
            return f"no control point keeps the smallest singular value of its own Jacobian above {kept}"
        best = float(np.max(base, where=placed, initial=0.0))
        if best > self.absolute:
            modules = " or ".join(map(str, self.section_sizes))
            return (
                f"no section of {modules} modules to a control point with a target is stable: none has more "
                f"than relative = {self.relative:g} of its best index; the posture is singular or nearly so, "
                f"or the region is too short"
            )
        return (
            f"no control point with a target clears the absolute manipulability condition: the largest "
            f"index is {best:.2g}, the threshold {self.absolute:g}; the posture is singular or nearly so"
        )


def _full_rows(arm: Arm, points: NDArray[np.int64]) -> Rows:
    """Return the rows of control points in all directions."""
    known = arm.kinematics.task_constants
    count = len(points)
    return Rows(points, known.dimensions[:count], known.frames[:count], COUPLING.full)
