"""The configuration that takes given control points exactly, module by module, where there is one."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from pinposture import kernels
from pinposture.arm import Arm
from pinposture.errors import UnsupportedModule
from pinposture.target.modules import layout

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
        units, shapes = layout(arm.chain)
    except UnsupportedModule:
        return None
    if len(units) != arm.n_modules:
        return None
    found = np.zeros(len(arm.columns))
    lower, upper = arm.limits.lower[arm.columns], arm.limits.upper[arm.columns]
    ends, tries = np.array(points, dtype=np.float64), MOST_TRIED * len(units)
    if not kernels.take_points(units, shapes, lower, upper, np.array(arm.chain.base), ends, tries, found):
        return None
    positions = np.zeros(arm.nv)
    positions[arm.columns] = found
    return positions
