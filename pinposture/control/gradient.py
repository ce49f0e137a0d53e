"""The null-space term of (4.7), with its sign, sum and scale put right."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from pinposture import kernels
from pinposture.arm import Arm, ArmState
from pinposture.arm.screws import constants_of
from pinposture.kernels.arrays import FULL, Rows, Screws
from pinposture.target import Target

Array = NDArray[np.float64]


def aligned_errors(state: ArmState, target: Target, placed: NDArray[np.bool_]) -> Array:
    """Errors c_k - p_k along the directions in which the arm can move, zero for points without a target.

    Args:
        state: where the arm is.
        target: where its control points should be.
        placed: which control points have a target, (m,).

    Returns:
        Array (m, 3) [m]; the last column is zero for a planar arm.
    """
    errors = (target.points - state.placed.points) * placed[:, None]
    if state.arm.dimension == 3:
        return np.asarray(errors)
    aligned = np.zeros(errors.shape)
    aligned[:, :2] = errors @ state.arm.plane.T
    return aligned


def descent(arm: Arm, screws: Screws, errors: Array, distances: Array) -> Array:
    """Joint displacement down the gradient of the posture error.

    The sum must run over all control points: over the active ones alone the projection would cancel it.
    Its length is the one at which the linearised squared error along it is least, so that it needs no
    scale of its own and vanishes with the error.

    Args:
        arm: the arm.
        screws: how its joints move it.
        errors: c_k - p_k, (m, 3) [m], from `aligned_errors`.
        distances: their norms, (m,) [m].

    Returns:
        Joint displacement (nv,) in `Arm.joint_units`; zero where the gradient vanishes.
    """
    known, gradient, motion = constants_of(arm), np.empty(len(arm.columns)), np.empty(errors.shape)
    every = Rows(known.every, known.dimensions, known.frames, FULL)
    kernels.joints_along(screws, every, errors, gradient)
    kernels.motions_along(screws, every, gradient, motion)
    motion = motion[:, : arm.dimension]
    travelled, found = float(np.vdot(motion, motion)), np.zeros(arm.nv)
    if travelled > (1e-15 * arm.length) ** 2 * float(distances @ distances):
        found[arm.columns] = gradient * (float(gradient @ gradient) / travelled)
    return found
