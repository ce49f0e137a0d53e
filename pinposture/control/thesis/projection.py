"""The Projection method: move every control point along the directions in which it moves well (Chapter 5)."""

from __future__ import annotations

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
from pinposture.control.thesis.sections import best_chain, checked_section_sizes
from pinposture.kernels.arrays import COUPLING, Rows, Screws
from pinposture.placement import Target

Array = NDArray[np.float64]
Coupling = Literal["full", "local", "relative"]


@dataclass(frozen=True)
class Projection:
    """Projection method with its parameters; the defaults come from `benchmarks/studies/parameters.py`.

    The motion of each control point relative to the previous one is confined to its manipulability space: the
    left singular vectors of the module's own Jacobian whose singular values exceed a threshold (5.3)-(5.5).
    The posture control matrix stacks the remaining rows (5.9), (5.10).

    Attributes:
        threshold: smallest singular value that counts as motion (kappa), relative to the module length
            [1/rad]. Modules up to the next point with a target count as one.
        coupling: "relative": each point covers its error relative to the previous point, so that a module
            takes its direction on the target posture wherever its base is. "full": each point covers its
            whole error, with the columns of all joints that move it. Both account for the motion of the base
            of a module; "local", (5.9) as printed, has only the module's own columns and does not.
        gain: share of its projected error that a point covers in one step (K); one number or (m,).
        null_gain: weight of the null-space term of (4.7).
        null_objective: replacement of the null-space descent, as for `Selection`.
        section_sizes: numbers of modules that a section may have, as for `Selection`: (2, 3) for planar arms
            of one-joint modules (Section 4.6). The controller moves the ends of the chain of sections with
            the best geometric mean of indices, and the points between follow in the null space. None:
            every control point is moved.
    """

    threshold: float = 0.2
    coupling: Coupling = "relative"
    gain: Gain = 1.0
    null_gain: float = 0.5
    null_objective: NullObjective | None = None
    name: str = "projection"
    section_sizes: tuple[int, ...] | None = None

    def __post_init__(self) -> None:
        require_share("threshold", self.threshold)
        require_positive("threshold", self.threshold)
        object.__setattr__(self, "gain", checked_gain(self.gain))
        require_positive("null_gain", self.null_gain, zero=True)
        require_known("coupling", self.coupling, COUPLING._fields)
        if self.section_sizes is not None:
            object.__setattr__(self, "section_sizes", checked_section_sizes(self.section_sizes))

    @classmethod
    def as_printed(cls, planar: bool = False) -> Projection:
        """Return the method as printed in Chapter 5, with the sign of the errors corrected.

        The matrix is block diagonal (5.9), without a null-space term. Planar arms of one-joint modules have
        sections of two and three joints.
        """
        return cls(coupling="local", null_gain=0.0, section_sizes=(2, 3) if planar else None)

    def step(
        self, state: ArmState, target: Target, limits: Limits | None = None, memory: Memory | None = None
    ) -> Step:
        """Compute one step; see `Controller.step`."""
        limits = checked_limits(state, target, limits, memory)
        screws = state.screws
        errors = aligned_errors(state, target)
        secondary = self.null_gain * null_motion(self.null_objective, state, target, screws, errors)
        return self._step(secondary, screws, state, target, limits, memory)

    def step_with(
        self,
        secondary: Array,
        state: ArmState,
        target: Target,
        limits: Limits | None = None,
        memory: Memory | None = None,
    ) -> Step:
        """Compute one step with another null-space motion than the descent of (4.7).

        Args:
            secondary: joint displacement to follow in the null space, (nv,), in `Arm.joint_units`.
            state: the state of the arm.
            target: the target posture.
            limits: the limits of the step; `Limits()` if None.
            memory: `memory` of the previous step; None at the first.
        """
        limits = checked_limits(state, target, limits, memory)
        return self._step(secondary, state.screws, state, target, limits, memory)

    def _step(
        self,
        secondary: Array,
        screws: Screws,
        state: ArmState,
        target: Target,
        limits: Limits,
        memory: Memory | None,
    ) -> Step:
        previous = memory.dq if memory is not None else None
        placed = target.has_target
        arm = state.arm
        rows, smallest = self._rows(arm, screws, placed)
        if rows is None:
            reason = f"no module has a singular value above threshold = {self.threshold:g} of its length"
            return step_within(limits.hold(state, previous), reason=reason)
        matrix = PostureMatrix(screws, rows)
        errors = target.errors(state.points)
        asked = matrix.step(arm, self._along(rows, gained(self.gain, errors)), secondary)
        limited = limits.apply(state, asked, previous)
        active = rows.stations[rows.ranks > 0].tolist()
        return step_within(limited, active, info={"manipulability": smallest, **matrix.info})

    def posture_control_matrix(
        self, state: ArmState, errors: Array, eligible: NDArray[np.bool_]
    ) -> tuple[Array, Array, tuple[int, ...], float]:
        """Return the posture control matrix (5.9) and the desired velocities (5.10).

        The rotations E of (5.7) are not needed: singular values do not depend on the frame, and left singular
        vectors rotate with it.

        Args:
            state: the state of the arm.
            errors: c_k - p_k, (m, d) [m], task axes.
            eligible: which control points have a target, (m,).

        Returns:
            Matrix (r, nv) [m/rad], projected errors (r,) [m], control points used (0-based), and the
            smallest ratio of a kept singular value to the largest of its module.
        """
        arm = state.arm
        rows, smallest = self._rows(arm, state.screws, eligible)
        if rows is None:
            return np.zeros((0, arm.nv)), np.zeros(0), (), 0.0
        jacobians = state.task_jacobians[rows.stations]
        if self.coupling == "local":
            jacobians = jacobians * _differences(arm.support[rows.stations])[:, None, :]
        elif self.coupling == "relative":
            jacobians = _differences(jacobians)
        kept = np.arange(3) < rows.ranks[:, None]
        matrix = (rows.directions @ arm.plane.T) @ jacobians
        velocity = self._along(rows, errors @ arm.plane)
        active = tuple(rows.stations[rows.ranks > 0].tolist())
        return matrix[kept], velocity[kept], active, smallest

    def _rows(self, arm: Arm, screws: Screws, eligible: NDArray[np.bool_]) -> tuple[Rows | None, float]:
        """Return the directions in which each section moves its end well, if any, and their smallest ratio.

        The own columns of a section are the same in all couplings, and those of later ones are zero, so the
        matrix is block triangular with full row rank.
        """
        if self.section_sizes is not None:
            eligible = best_chain(arm, screws, eligible, self.section_sizes)
        stations = np.flatnonzero(eligible)  # where sections end; modules, if all points have a target
        lengths = _differences(np.cumsum(arm.chain.module_lengths)[stations])
        directions = np.empty((len(stations), 3, 3))
        ranks = np.zeros(len(stations), dtype=np.int64)
        plane = arm.kinematics.task_constants.plane
        found = kernels.module_spaces(screws, plane, stations, self.threshold * lengths, directions, ranks)
        smallest = float(found)
        if not np.any(ranks):
            return None, 0.0
        return Rows(stations, ranks, directions, getattr(COUPLING, self.coupling)), smallest

    def _along(self, rows: Rows, errors: Array) -> Array:
        """Return the errors, (m, 3) in world axes, along the directions of the rows, (p, 3) [m]."""
        wanted = errors[rows.stations]
        if self.coupling == "relative":
            wanted = _differences(wanted)
        return np.asarray((rows.directions @ wanted[:, :, None])[:, :, 0])


def _differences(rows: Array) -> Array:
    """Return the differences of consecutive entries along the first axis; the first entry is unchanged."""
    differences = np.array(rows)
    differences[1:] -= rows[:-1]
    return differences
