"""What limits mean for the joints of one arm, whatever its configuration."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from pinposture.arm import Arm
from pinposture.errors import InvalidValue

Array = NDArray[np.float64]

USUAL_STEP = 0.1
"""Joint travel of a step where limits allow more, or where there are none [rad]."""


LEANING = 1e-6
"""How far outside its limits a joint may be without being brought back first, in `Arm.joint_units`."""


class JointBounds(NamedTuple):
    """Limits of one step, in joint displacements and positions.

    Attributes:
        bound: largest |dq|, (nv,) [rad or m]; infinite where there is no limit.
        travel: joint travel that this allows, median over the joints, at most `USUAL_STEP` [rad].
        edges: joint positions to stay between, margin included, (2, nv) [rad or m].
        brake: largest change of dq from one step to the next, (nv,) [rad or m]; None: any.
        units: the motion of each joint of the chain that counts as one, (n,) [rad or m].
        leaning: how far outside its limits each may be without being brought back first, (n,) [rad or m].

    The arrays are for kernels, not to be written to.
    """

    bound: Array
    travel: float
    edges: Array
    brake: Array | None
    units: Array
    leaning: Array


def joint_bounds(
    arm: Arm,
    step: float | Array | None,
    velocity: float | Array | None,
    acceleration: float | Array | None,
    dt: float | None,
    position_margin: float,
) -> JointBounds:
    """Bounds for the joints of an arm; the arguments are the attributes of `Limits`.

    Raises:
        InvalidValue: not one number for each degree of freedom, or a margin wider than half a joint's range.
    """
    bound, brake = np.full(arm.nv, np.inf), None
    if step is not None:
        bound = np.minimum(bound, _per_joint("step", step, arm))
    if dt is not None:
        speed = arm.limits.velocity if velocity is None else _per_joint("velocity", velocity, arm)
        bound = np.minimum(bound, speed * dt)
        if acceleration is not None:
            change = _per_joint("acceleration", acceleration, arm) * dt**2
            brake = np.clip(change, 1e-100, 1e200)  # so that nothing made of it overflows, or divides by zero
    edges = _edges(arm, position_margin)
    travel = min(USUAL_STEP, float(np.median((bound / arm.joint_units)[arm.columns])))
    units = arm.joint_units[arm.columns]
    return JointBounds(bound, travel, edges, brake, units, LEANING * units)


def _edges(arm: Arm, margin: float) -> Array:
    limits, moved = arm.limits, arm.moved > 0.0
    # What does not move the arm is not ours to bring back.
    lower = np.where(moved, limits.lower + margin, -np.inf)
    upper = np.where(moved, limits.upper - margin, np.inf)
    if np.any(lower > upper):
        joint = int(np.argmax(lower - upper))
        room = (limits.upper[joint] - limits.lower[joint]) / 2.0
        allowed = f"at most {room:.4g}, half the range of degree of freedom {joint}"
        raise InvalidValue("position_margin", margin, allowed)
    return np.array([lower, upper])


def _per_joint(name: str, value: float | Array, arm: Arm) -> Array:
    """A limit as one number for each degree of freedom, (nv,)."""
    if np.ndim(value) == 1 and len(np.asarray(value)) != arm.nv:
        raise InvalidValue(f"{name} (shape)", np.shape(value), f"one number or ({arm.nv},)")
    return np.broadcast_to(np.asarray(value, dtype=np.float64), arm.nv)
