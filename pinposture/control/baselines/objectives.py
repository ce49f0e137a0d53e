"""Objective functions that a redundant arm can improve while its end-effector does its task (2.7)."""

from __future__ import annotations

from typing import Literal

import numpy as np
from numpy.typing import NDArray

from pinposture.arm import ArmState
from pinposture.control.baselines.measure import manipulability_measure, measure_gradient, measure_hessian
from pinposture.errors import UnknownName

Array = NDArray[np.float64]
Objective = Literal["manipulability", "joint_limits"]

OBJECTIVES: tuple[Objective, ...] = ("manipulability", "joint_limits")
"""Names of the objective functions. Both are written such that more is better.

"manipulability" is the manipulability measure (3.3) of the end-effector, relative to length^d of the arm.

"joint_limits" is minus (2.8): that expression grows without bound as a joint nears a limit, so it is to be
minimised, not maximised. Joint positions are counted in `Arm.joint_units`. A limit at infinity adds nothing,
and joints that move no control point are left out. At a limit (2.8) is not defined, and beyond one its
gradient points outwards; so from `NEAREST` on it goes on along its tangent, finite and pushing back from
either side.
"""

NEAREST = 0.1
"""Distance to a limit, in `Arm.joint_units`, within which (2.8) is continued along its tangent."""


def require_objective(objective: str | None) -> None:
    """Raise UnknownName unless it is the name of an objective function, or None."""
    if objective is not None and objective not in OBJECTIVES:
        raise UnknownName("objective", objective, OBJECTIVES)


def objective_value(objective: Objective, state: ArmState, end_effector: int) -> float:
    """Value h of an objective function; more is better.

    Args:
        objective: its name.
        state: where the arm is.
        end_effector: the control point that does the task, 0-based.
    """
    if objective == "manipulability":
        return manipulability_measure(state, end_effector)
    rooms = np.concatenate(_rooms(state))
    barrier = 0.5 * np.maximum(rooms, NEAREST) ** -2.0
    return -float(np.sum(barrier + np.maximum(NEAREST - rooms, 0.0) * NEAREST**-3.0))


def objective_gradient(objective: Objective, state: ArmState, end_effector: int) -> Array:
    """Gradient dh/dq of an objective function, (nv,), per unit of joint motion."""
    if objective == "manipulability":
        return measure_gradient(state, end_effector)
    below, above = _rooms(state)
    return np.asarray(np.maximum(below, NEAREST) ** -3.0 - np.maximum(above, NEAREST) ** -3.0)


def objective_hessian(objective: Objective, state: ArmState, end_effector: int) -> Array:
    """Second derivatives of an objective function, (nv, nv), per unit of joint motion squared."""
    if objective == "manipulability":
        return measure_hessian(state, end_effector)
    curvatures = [np.where(room > NEAREST, np.maximum(room, NEAREST) ** -4.0, 0.0) for room in _rooms(state)]
    return np.diag(-3.0 * (curvatures[0] + curvatures[1]))


def _rooms(state: ArmState) -> tuple[Array, Array]:
    """Distance of each joint from its lower and from its upper limit, (nv,) each, in `Arm.joint_units`."""
    arm = state.arm
    positions, columns = arm.positions(state.q), arm.columns
    below, above = np.full((2, arm.nv), np.inf)  # joints off the chain are not to be moved
    below[columns] = (positions - arm.limits.lower)[columns] / arm.joint_units[columns]
    above[columns] = (arm.limits.upper - positions)[columns] / arm.joint_units[columns]
    return below, above
