"""The Projection method: move every control point, each where it can move (Chapter 5)."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal, NamedTuple
from weakref import WeakKeyDictionary

import numpy as np
from numpy.typing import NDArray

from pinposture.arm import Arm, ArmState
from pinposture.control.checks import require_positive, require_share
from pinposture.control.controller import Diagnostics, Memory, Step, task_errors
from pinposture.control.gradient import descent
from pinposture.control.limits import Limits
from pinposture.control.solve import decompose, pseudo_inverse_step
from pinposture.errors import UnknownName
from pinposture.target import Target

Array = NDArray[np.float64]
Coupling = Literal["full", "local", "relative"]

COUPLINGS: tuple[Coupling, ...] = ("full", "local", "relative")


@dataclass(frozen=True)
class Projection:
    """Projection method with its parameters; the defaults come from `benchmarks/parameters.py`.

    The motion of each control point relative to the one before it is confined to its manipulability
    space: the left singular vectors of the module's own Jacobian whose singular values exceed a threshold
    (5.3)-(5.5). The posture control matrix stacks what is left (5.9), (5.10).

    Attributes:
        threshold: smallest singular value that counts as motion (kappa), relative to the length of the
            module [1/rad]. Where points have no target, the modules up to the next one that has count as one.
        coupling: "full" keeps the columns of all joints that move a point, so that the matrix is block
            lower triangular and knows that the base of a module moves; "local" keeps only the module's
            own columns, (5.9) as printed; "relative" asks of each point to cover the error that it has
            relative to the point before, so that a module turns into its direction on the target posture
            wherever its base is.
        gain: share of its projected error that a point is asked to cover in one step (K).
        null_gain: weight of the null-space term of (4.7).
    """

    threshold: float = 0.4
    coupling: Coupling = "full"
    gain: float = 1.0
    null_gain: float = 0.5
    name: str = "projection"

    def __post_init__(self) -> None:
        require_share("threshold", self.threshold)
        require_positive("threshold", self.threshold)
        require_positive("gain", self.gain)
        require_positive("null_gain", self.null_gain, zero=True)
        if self.coupling not in COUPLINGS:
            raise UnknownName("coupling", self.coupling, COUPLINGS)

    def step(
        self, state: ArmState, target: Target, limits: Limits | None = None, memory: Memory | None = None
    ) -> Step:
        """Compute one step; see `Controller.step`."""
        errors = task_errors(state, target)
        secondary = self.null_gain * descent(state, errors, np.linalg.norm(errors, axis=1))
        return self.step_with(secondary, state, target, limits, memory)

    def step_with(
        self,
        secondary: Array,
        state: ArmState,
        target: Target,
        limits: Limits | None = None,
        memory: Memory | None = None,
    ) -> Step:
        """Compute one step with something else to follow in the null space than the descent of (4.7).

        Args:
            secondary: joint displacement to follow as far as the control points leave room, (nv,), in
                `Arm.joint_units`.
            state: where the arm is.
            target: where its control points should be.
            limits: what the step may not exceed; `Limits()` if None.
            memory: what the previous step returned; None at the first.
        """
        limits = Limits() if limits is None else limits
        previous = memory.dq if memory is not None else None
        errors = task_errors(state, target)
        matrix, velocity, active, smallest = self.posture_control_matrix(state, errors, target.placed)
        if len(matrix) == 0:
            held = limits.hold(state, previous)
            reason = f"no module has a singular value above threshold = {self.threshold:g} of its length"
            none = Diagnostics(0, 0, 0, 0, (), held.scale, held.clipped, reason)
            return Step(held.dq, (), none, Memory(held.dq))
        decomposed = decompose(matrix)
        asked = pseudo_inverse_step(decomposed, self.gain * velocity, secondary)
        arm = state.arm  # joints off the chain have zero columns, and singular vectors round zero
        limited = limits.apply(state, asked * arm.joint_units * arm.moved, previous)
        diagnostics = Diagnostics(
            manipulability=smallest,
            sigma_min=float(decomposed.sigma[-1]),
            sigma_max=float(decomposed.sigma[0]),
            rows=len(matrix),
            dropped=(),
            scale=limited.scale,
            clipped=limited.clipped,
            reason="",
        )
        return Step(limited.dq, active, diagnostics, Memory(limited.dq))

    def posture_control_matrix(
        self, state: ArmState, errors: Array, eligible: NDArray[np.bool_]
    ) -> tuple[Array, Array, tuple[int, ...], float]:
        """Posture control matrix (5.9) and desired velocities (5.10).

        The rotations E of (5.7) need no explicit factor: singular values do not depend on the frame, and
        the left singular vectors of the Jacobian in task axes are those of the module frame, turned.

        Args:
            state: where the arm is.
            errors: c_k - p_k, (m, d) [m], task axes.
            eligible: which control points have a target, (m,).

        Returns:
            Matrix (r, nv) [m/rad], projected errors (r,) [m], control points used (0-based), and the
            smallest ratio of a kept singular value to the largest of its module.
        """
        sections = _sections(state.arm, eligible)
        jacobians, wanted = state.task_jacobians[sections.ends], errors[sections.ends]
        own = jacobians * sections.own[:, None, :]
        # Modules are far shorter than the arm: decompose their own columns only, padded to equal number.
        narrow = np.take_along_axis(own, sections.columns[:, None, :], axis=2)  # (p, d, c)
        left, sigma, _ = np.linalg.svd(narrow, full_matrices=False)  # (p, d, r), (p, r)
        kept = sigma > self.threshold * sections.lengths[:, None]
        across = left.swapaxes(1, 2)
        # The own columns of a section are the same in all couplings, and those of later ones are zero: the
        # matrix is block triangular, and of full row rank, in each of them.
        if self.coupling == "local":
            jacobians = own
        elif self.coupling == "relative":
            jacobians, wanted = _differences(jacobians), _differences(wanted)
        rows = across @ jacobians
        velocity = (across @ wanted[:, :, None])[:, :, 0]
        active = tuple(int(k) for k in sections.ends[kept.any(axis=1)])
        largest = np.broadcast_to(sigma[:, :1], sigma.shape)[kept]
        smallest = float((sigma[kept] / largest).min()) if active else 0.0
        return rows[kept], velocity[kept], active, smallest


class _Sections(NamedTuple):
    """The arm cut at the control points that have a target: modules, if all of them have one.

    Attributes:
        ends: control points that have a target, (p,), 0-based.
        own: 1 where a degree of freedom belongs to a section, else 0, (p, nv).
        columns: degrees of freedom of each section, (p, c); short sections are filled up with others.
        lengths: arc lengths, (p,) [m].
    """

    ends: NDArray[np.intp]
    own: Array
    columns: NDArray[np.intp]
    lengths: Array


_KNOWN: WeakKeyDictionary[Arm, dict[bytes, _Sections]] = WeakKeyDictionary()
_MOST = 16  # regions of one arm that are remembered


def _sections(arm: Arm, eligible: NDArray[np.bool_]) -> _Sections:
    """The sections of an arm; remembered as long as the arm lives, because every step asks for the same."""
    known = _KNOWN.setdefault(arm, {})
    key = eligible.tobytes()
    if key not in known:
        if len(known) >= _MOST:
            known.clear()
        known[key] = _cut(arm, np.flatnonzero(eligible))
    return known[key]


def _cut(arm: Arm, ends: NDArray[np.intp]) -> _Sections:
    own = _differences(arm.support[ends])
    columns = np.argsort(-own, axis=1, kind="stable")[:, : int(own.sum(axis=1).max(initial=0.0))]
    lengths = _differences(np.cumsum(arm.chain.module_lengths)[ends])
    return _Sections(ends, own, columns, lengths)


def _differences(rows: Array) -> Array:
    """Each entry along the first axis less the one before; the first as it is."""
    return np.concatenate([rows[:1], np.diff(rows, axis=0)])
