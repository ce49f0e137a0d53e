"""The posture in which an arm reaches farthest."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import minimize

if TYPE_CHECKING:
    from pinposture.arm.arm import Arm

Array = NDArray[np.float64]


def farthest_stretch(arm: Arm) -> Array:
    """Joint positions (nv,) [rad or m] that maximise the distance from base to tip, within the limits.

    They are zero if the arm is straight there; otherwise the maximum is searched from there, and is a
    local one for arms that can stretch in several ways.
    """
    if np.linalg.norm(arm.chain.points[-1] - arm.chain.base) > (1.0 - 1e-9) * arm.length:
        return np.zeros(arm.nv)

    def shortness(positions: Array) -> tuple[float, Array]:
        state = arm.at(arm.configuration(positions))
        reach = state.points[-1] - arm.chain.base
        distance = max(float(np.linalg.norm(reach)), 1e-12 * arm.length)
        return -distance, -(reach / distance) @ state.jacobians[-1]

    bounds = list(zip(arm.limits.lower, arm.limits.upper, strict=True))
    # Zero itself can be a stationary point, for instance of an arm that is folded there.
    start = np.clip(np.full(arm.nv, 1e-3), arm.limits.lower, arm.limits.upper)
    return np.asarray(minimize(shortness, start, jac=True, bounds=bounds, method="L-BFGS-B").x)
