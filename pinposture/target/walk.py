"""Algorithm 1: modules placed on a curve one after the other, each where it first crosses the curve ahead."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from pinposture import kernels
from pinposture.arm import Arm
from pinposture.curve import Curve
from pinposture.errors import CurveBendsTooMuch, CurveEndsEarly, CurveLeavesTooSharply, TargetError
from pinposture.target.modules import Unit, arm_units, layout
from pinposture.target.placement import ROUNDING, Placement, beginning

Array = NDArray[np.float64]


def place_in_turn(arm: Arm, curve: Curve, samples: int) -> Placement:
    """Algorithm 1.

    Args:
        arm: the arm; each of its modules has a closed-form solver.
        curve: the curve, placed in the world.
        samples: number of points at equal arc length that stand for the curve.

    Returns:
        Where the modules belong; with a failure if one of them has no place.

    Raises:
        UnsupportedModule: a module without a solver.
    """
    numbers, shapes = layout(arm.chain)
    parameter, on_curve = beginning(arm, curve)
    base = np.array(arm.chain.base)
    state = np.empty(9)
    state[0], state[1:4], state[4:7] = parameter, base, base if on_curve else curve.at(parameter)
    lower, upper = arm.limits.lower[arm.columns], arm.limits.upper[arm.columns]
    found, parameters = np.zeros(len(lower)), np.full(arm.n_modules, curve.length)
    stopped = kernels.walk_along(
        *curve.measured, samples, numbers, shapes, lower, upper, state, found, parameters
    )
    positions = np.zeros(arm.nv)
    positions[arm.columns] = found
    failure: TargetError | None = None
    if stopped >= 0:
        failure = _failure(arm, curve, arm_units(arm.chain)[stopped], state)
        parameters[failure.module - 1 :] = curve.length
    return Placement(positions, parameters, failure)


def _failure(arm: Arm, curve: Curve, unit: Unit, state: Array) -> TargetError:
    """Why a unit has no place, from what `kernels.walk_along` left in the state."""
    first, last, beyond, found = state[1:4], state[4:7], bool(state[7]), int(state[8])
    module, at, slack = unit.module + 1, float(state[0]), ROUNDING * arm.length
    reach = unit.kinematics.reach
    off_axis = _leaves_off_axis(unit, curve, at)
    if found:
        advice = "use a gentler curve, wider joint limits or shorter modules"
        kind = CurveLeavesTooSharply if off_axis else CurveBendsTooMuch
        return kind(module, at, f"its joint limits do not let it turn to where the curve goes; {advice}")
    if not beyond:
        left, distance = curve.length - at, float(np.linalg.norm(last))
        advice = f"the module is {reach:.4g} m long; lengthen the curve or use fewer modules"
        text = f"the curve ends {left:.4g} m farther on, {distance:.4g} m from its base; {advice}"
        if left <= slack:
            text = f"the curve ends there; {advice}"
        return CurveEndsEarly(module, at, text)
    gap = float(np.linalg.norm(first))
    if gap > reach:
        advice = 'use placement="translate" or "align"'
        return CurveLeavesTooSharply(module, at, f"the curve passes {gap:.4g} m from the base; {advice}")
    if unit.kinematics.dof == 1 and abs(last[1]) > slack:
        text = f"the curve leaves the plane in which the module moves by {abs(last[1]):.4g} m"
        return CurveBendsTooMuch(module, at, f"{text}; use a planar curve in that plane, or two hinges")
    exit_at = last / np.linalg.norm(last)
    angle = float(np.degrees(np.arccos(np.clip(exit_at[0], -1.0, 1.0))))
    text = f"the curve leaves its reach {angle:.3g} degrees off its axis, where it cannot turn"
    if off_axis:
        advice = 'placement="align" turns the curve to the arm'
        return CurveLeavesTooSharply(module, at, f"{text}; {advice}")
    return CurveBendsTooMuch(module, at, f"{text}; use a gentler curve or shorter modules")


def _leaves_off_axis(unit: Unit, curve: Curve, at: float) -> bool:
    """True if this is the first module and the curve does not set out along it."""
    if unit.module > 0:
        return False
    return float(np.linalg.norm(np.cross(curve.tangent(at), unit.frame[:, 0]))) > 1e-6
