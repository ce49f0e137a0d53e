"""Which limits cannot be kept from where an arm is, in words."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from pinposture.arm import Arm
from pinposture.control.braking import farthest, full_braking

Array = NDArray[np.float64]


def relaxed_limits(
    arm: Arm, positions: Array, edges: Array, bound: Array, brake: Array, previous: Array, rounding: float
) -> tuple[str, ...]:
    """Name each limit that gives way in a step, by joint; see `Limits.box` for the order.

    Args:
        arm: the arm.
        positions: joint positions, (nv,) [rad or m].
        edges: joint positions to stay between, (2, nv) [rad or m].
        bound: largest |dq|, (nv,) [rad or m].
        brake: largest change of dq from one step to the next, (nv,) [rad or m]; empty: any.
        previous: the step before, (nv,) [rad or m]; empty where any change is allowed.
        rounding: what a limit may be exceeded by without being named [rad or m].
    """
    words, names = [], arm.joint_names
    sides, slowest = edges - positions, np.zeros(arm.nv)
    if len(brake):
        sides, slowest = farthest(sides, brake), full_braking(previous, brake)
    above = np.minimum(sides[1], bound) - np.maximum(slowest, 0.0)
    below = np.minimum(slowest, 0.0) - np.maximum(sides[0], -bound)
    taken = np.clip(slowest, -bound, bound)
    for joint in np.flatnonzero(np.minimum(above, below) < -rounding):
        name, unit = names[joint], "m" if arm.slides[joint] else "rad"
        at, (low, high) = positions[joint], edges[:, joint]
        step = taken[joint]
        if not low - rounding <= at <= high + rounding:
            allowed = f"{low:.4g} to {high:.4g} {unit}"
            words.append(f"position limits of joint {name!r}: it is at {at:.4g}, outside {allowed}")
        elif max(step - sides[1, joint], sides[0, joint] - step) > rounding:
            edge, most = (high, sides[1, joint]) if step > 0.0 else (low, -sides[0, joint])
            words.append(
                f"position limit {edge:.4g} {unit} of joint {name!r}: at {at:.4g} it is too fast to stop; "
                f"the slowest that it can go in this step is {abs(step):.4g}, at most {most:.4g} would do"
            )
        if abs(slowest[joint]) > bound[joint] + rounding:
            words.append(
                f"acceleration limit of joint {name!r}: braking leaves a step of {abs(slowest[joint]):.4g}, "
                f"and at most {bound[joint]:.4g} {unit} is allowed"
            )
    return tuple(words)
