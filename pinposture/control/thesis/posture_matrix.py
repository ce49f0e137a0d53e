"""The posture control matrix, its pseudo-inverse step, and the null-space gradient (4.5 to 4.7)."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import cached_property
from typing import TypeAlias

import numpy as np
from numpy.typing import ArrayLike, NDArray

from pinposture import kernels
from pinposture._validation import finite_vector, require_positive
from pinposture.arm import Arm, ArmState
from pinposture.control.controller import Info, call_own
from pinposture.errors import InvalidValue
from pinposture.kernels.arrays import COUPLING, Factors, Rows, Screws
from pinposture.placement import Target

Array = NDArray[np.float64]


class PostureMatrix:
    """A posture control matrix J = L Q, (4.6) and (5.9), in factored form.

    Its rows are motions of control points along directions, its columns joints in comparable units. Products
    and solutions are passes along the arm, linear in its length; see `kernels.posture_matrix`.
    """

    def __init__(self, screws: Screws, rows: Rows) -> None:
        p = len(rows.stations)
        self._screws = screws
        self._rows = rows
        self._factors = Factors(np.empty((p, 3, 3)), np.empty((p, 6, 3)))
        kernels.eliminated(screws, rows, self._factors)

    @cached_property
    def size(self) -> int:
        """Number of rows r."""
        return int(self._rows.ranks.sum())

    def step(self, arm: Arm, values: Array, secondary: Array) -> Array:
        """Return J^+ dr + (I - J^+ J) g (4.7): exact velocities dr, and g in their null space.

        Args:
            arm: the arm.
            values: velocities dr along the directions of the rows, (p, 3) [m].
            secondary: joint displacement g, (nv,), in `Arm.joint_units`.

        Returns:
            Joint displacement (nv,) [rad or m]; zero for joints off the chain.
        """
        columns = arm.columns
        asked = np.zeros(arm.nv)
        x = secondary[columns]
        kernels.least_change(self._screws, self._rows, self._factors, values, x)
        asked[columns] = x * arm.kinematics.task_constants.units
        return asked

    @cached_property
    def smallest(self) -> float:
        """Smallest singular value [m/rad]."""
        return float(self._own.min()) if self._rows.coupling == COUPLING.local else self._extreme(True)

    @cached_property
    def largest(self) -> float:
        """Largest singular value [m/rad]."""
        return float(self._own.max()) if self._rows.coupling == COUPLING.local else self._extreme(False)

    @property
    def info(self) -> dict[str, Info | Callable[[], Info]]:
        """What steps with it report: its size, and functions that compute its extreme singular values."""
        return {"sigma_min": lambda: self.smallest, "sigma_max": lambda: self.largest, "rows": self.size}

    @property
    def _own(self) -> Array:
        """Singular values of the diagonal blocks of L, which are all of L for local rows.

        A block with fewer rows is padded with its first entry, which is between its singular values.
        """
        used = self._rows.ranks > 0
        there = np.arange(3) < self._rows.ranks[used, None]
        triangles = self._factors.triangles[used]
        blocks = np.where(there[:, :, None] & there[:, None, :], triangles, 0.0)
        blocks[:, range(3), range(3)] += np.where(there, 0.0, blocks[:, :1, 0])
        return np.asarray(np.linalg.svd(blocks, compute_uv=False))

    def _extreme(self, smallest: bool) -> float:
        found = kernels.extreme_value(self._screws.points, self._rows, self._factors, smallest, 1e-12)
        return float(found)


Gain: TypeAlias = "float | Sequence[float]"
"""Gain K of (4.7): share of its error that a control point should cover in one step; one number or (m,)."""


def checked_gain(gain: Gain) -> float | tuple[float, ...]:
    """Return a gain with a tuple for a sequence; raise InvalidValue unless all numbers are positive."""
    if not isinstance(gain, (Sequence, np.ndarray)):
        require_positive("gain", gain)
        return gain
    for point, each in enumerate(gain):
        require_positive(f"gain[{point}]", each)
    return tuple(map(float, gain))


def gained(gain: Gain, errors: Array) -> Array:
    """Multiply the errors of all control points, (m, 3), by their gains.

    Raises:
        InvalidValue: another number of gains.
    """
    if not isinstance(gain, Sequence):
        return gain * errors
    if len(gain) != len(errors):
        raise InvalidValue("gain (numbers)", len(gain), f"one, or {len(errors)}: one for each control point")
    return np.array(gain)[:, None] * errors


NullObjective: TypeAlias = Callable[[ArmState, Target], ArrayLike]
"""Returns the joint displacement to follow in the null space, (nv,), in `Arm.joint_units`: for instance down
the gradient of an objective."""


def null_motion(
    objective: NullObjective | None, state: ArmState, target: Target, screws: Screws, errors: Array
) -> Array:
    """Return the displacement to follow in the null space, (nv,) in `Arm.joint_units`; default `descent`.

    Raises:
        InvalidValue: the objective returns another shape, or something that is not finite.
    """
    if objective is None:
        return descent(state.arm, screws, errors, np.sqrt(np.einsum("ij,ij->i", errors, errors)))
    name = getattr(objective, "__qualname__", type(objective).__qualname__)
    found = call_own(name, "", objective, state, target)
    return finite_vector(f"null_objective {name}(state, target)", found, state.arm.nv)


def aligned_errors(state: ArmState, target: Target) -> Array:
    """Return the errors c_k - p_k in the axes of the arm's motion, zero for points without a target.

    Args:
        state: the state of the arm.
        target: the target posture.

    Returns:
        Array (m, 3) [m]; the last column is zero for a planar arm.
    """
    errors = target.errors(state.points)
    if state.arm.dimension == 3:
        return errors
    aligned = np.zeros(errors.shape)
    aligned[:, :2] = errors @ state.arm.plane.T
    return aligned


def descent(arm: Arm, screws: Screws, errors: Array, distances: Array) -> Array:
    """Return the joint displacement down the gradient of the posture error: (4.7) with sign and scale fixed.

    The sum is over all control points; the projection would cancel the contribution of active ones. The step
    length minimises the linearised squared error along the gradient.

    Args:
        arm: the arm.
        screws: the screws of its joints.
        errors: c_k - p_k, (m, 3) [m], from `aligned_errors`.
        distances: their norms, (m,) [m].

    Returns:
        Joint displacement (nv,) in `Arm.joint_units`; zero where the gradient vanishes.
    """
    known = arm.kinematics.task_constants
    gradient = np.empty(len(arm.columns))
    motion = np.empty(errors.shape)
    every = Rows(known.every, known.dimensions, known.frames, COUPLING.full)
    kernels.joints_along(screws, every, errors, gradient)
    kernels.motions_along(screws, every, gradient, motion)
    motion = motion[:, : arm.dimension]
    travelled = float(np.vdot(motion, motion))
    found = np.zeros(arm.nv)
    if travelled > (1e-15 * arm.length) ** 2 * float(distances @ distances):
        found[arm.columns] = gradient * (float(gradient @ gradient) / travelled)
    return found
