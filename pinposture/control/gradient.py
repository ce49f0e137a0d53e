"""The null-space term of (4.7), with its sign, sum and scale put right."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from pinposture.arm import ArmState

Array = NDArray[np.float64]


def descent(state: ArmState, errors: Array, distances: Array) -> Array:
    """Joint displacement down the gradient of the posture error.

    The sum must run over all control points: over the active ones alone the projection would cancel it.
    Its length is the one at which the linearised squared error along it is least, so that it needs no
    scale of its own and vanishes with the error.

    Args:
        state: where the arm is.
        errors: c_k - p_k, (m, d) [m].
        distances: their norms, (m,) [m].

    Returns:
        Joint displacement (nv,) in `Arm.joint_units`; zero where the gradient vanishes.
    """
    jacobians = state.task_jacobians
    gradient = np.einsum("kdu,kd->u", jacobians, errors)
    motion = jacobians @ gradient
    travelled = float(np.einsum("kd,kd->", motion, motion))
    if travelled <= (1e-15 * state.arm.length) ** 2 * float(distances @ distances):
        return np.zeros_like(gradient)
    return np.asarray(gradient * (float(gradient @ gradient) / travelled))
