"""Which torques servos give over a physics step when none may give more than its limit.

With the speed v = v0 + W u that torques u lead to, and servos that want u = s - D v, the torques within their
limits are the minimum of u^T (1/D + W) u / 2 - (s / D - v0)^T u in a box: there always is exactly one.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from pinposture.control.planner.avoidance import solve

Array = NDArray[np.float64]

FAR = 1e30
"""A bound that is none."""


def torques_within_limits(
    mobility: Array, unmoved: Array, spring: Array, damping: Array, lower: Array, upper: Array
) -> Array:
    """The torques of the servos over a step, (n,) [N m or N].

    Args:
        mobility: W, the speed at the end of the step for each unit of torque, (n, n), symmetric.
        unmoved: v0, the speeds at the end of the step without any torque, (n,) [rad/s or m/s].
        spring: s, the torques that the servos want at rest, (n,) [N m or N].
        damping: D, what they want less at speed, (n,) [N m s/rad or N s/m], positive.
        lower: smallest torques, (n,); -inf without a limit.
        upper: largest torques, (n,); inf without a limit.
    """
    hessian = mobility + np.diag(1.0 / damping)
    scale = 1.0 / np.sqrt(np.diag(hessian))
    found = solve(
        hessian * np.outer(scale, scale),
        -(spring / damping - unmoved) * scale,
        np.maximum(lower / scale, -FAR),
        np.minimum(upper / scale, FAR),
    )
    torques = found.x if found.x is not None else np.zeros(len(spring))
    return np.clip(torques * scale, lower, upper)
