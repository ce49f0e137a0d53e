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

    They are zero if the arm is straight there and cannot slide; otherwise the maximum is searched from
    there, and is a local one for arms that can stretch in several ways. A slide without real limits goes as
    far as the arm is long, or stays where it is if the base stands on it.
    """
    start_point, length, units = arm.chain.base, arm.length, arm.joint_units
    straight = np.linalg.norm(arm.chain.points[-1] - start_point) > (1.0 - 1e-9) * length
    if straight and np.all(arm.chain.revolute) and arm.within_limits(arm.neutral()):
        return np.zeros(arm.nv)

    def shortness(amounts: Array) -> tuple[float, Array]:
        state = arm.at(arm.configuration(amounts * units))
        reach = (state.points[-1] - start_point) / length
        distance = max(float(np.linalg.norm(reach)), 1e-12)
        return -distance, -(reach / distance) @ state.jacobians[-1] * units / length

    low, high = np.array(arm.usual_positions) / units
    # A hinge has no need to be told how far: it comes round.
    low[~arm.slides], high[~arm.slides] = (np.array(arm.limits[:2]) / units)[:, ~arm.slides]
    stays = np.clip(0.0, arm.limits.lower, arm.limits.upper) / units
    low, high = np.where(arm.roaming, stays, low), np.where(arm.roaming, stays, high)
    # Zero itself can be a stationary point, for instance of an arm that is folded there.
    start = np.clip(np.full(arm.nv, 1e-3), low, high)
    bounds = list(zip(low, high, strict=True))
    found = minimize(shortness, start, jac=True, bounds=bounds, method="L-BFGS-B").x
    return np.asarray(np.clip(found, low, high) * units)
