"""The configuration that takes given control points exactly, module by module, where there is one."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
from numpy.typing import NDArray

from pinposture.arm import Arm
from pinposture.errors import UnsupportedModule
from pinposture.target.modules import Unit, arm_units
from pinposture.target.placement import ROUNDING

Array = NDArray[np.float64]

MOST_TRIED = 20
"""How many solutions are looked at, per module on average, before the search is given up."""


def exact_positions(arm: Arm, points: Array) -> Array | None:
    """Joint positions that put every control point where it should be, by the closed forms of the modules.

    The point at the end of a module leaves a few solutions for its joints (`ModuleKinematics.inverse`). A
    wrong one shows at the next module, whose point it puts out of reach: the search then goes back and takes
    another.

    Args:
        arm: the arm.
        points: a position for every control point, (m, 3) [m], world frame.

    Returns:
        Joint positions (nv,) [rad] within the limits of the arm; None if there are none, as for points that
        were measured, or if modules have no closed form or several solvers each.
    """
    try:
        units = arm_units(arm.chain)
    except UnsupportedModule:
        return None
    if len(units) != arm.n_modules:
        return None
    starts = np.vstack([arm.chain.base, points[:-1]])
    found: list[Array] = []
    turns = [np.eye(3)]
    waiting = [_solutions(arm, units[0], turns[0], points[0] - starts[0])]
    for _ in range(MOST_TRIED * len(units)):
        q = next(waiting[-1], None)
        if q is None:  # none is left here: another one for the module before
            waiting.pop()
            turns.pop()
            if not found:
                return None
            found.pop()
            continue
        unit = units[len(found)]
        found.append(q)
        if len(found) == len(units):
            positions = np.zeros(arm.nv)
            positions[arm.columns] = np.concatenate(found)
            return positions
        frame = turns[-1] @ unit.frame
        turns.append(frame @ unit.kinematics.forward(q)[1] @ unit.frame.T)
        number = len(found)
        waiting.append(_solutions(arm, units[number], turns[-1], points[number] - starts[number]))
    return None


def _solutions(arm: Arm, unit: Unit, turn: Array, way: Array) -> Iterator[Array]:
    """Joint positions of one unit that cover a way in the world, within its limits."""
    columns = arm.columns[unit.joints]
    lower, upper = arm.limits.lower[columns], arm.limits.upper[columns]
    for q in unit.kinematics.inverse(way @ (turn @ unit.frame)):
        if np.all((q >= lower - ROUNDING) & (q <= upper + ROUNDING)):
            yield np.clip(q, lower, upper)
