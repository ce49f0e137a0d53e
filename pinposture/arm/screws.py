"""How the joints of an arm move its control points, as kernels see it: one screw for each joint."""

from __future__ import annotations

from typing import TYPE_CHECKING, NamedTuple
from weakref import WeakKeyDictionary

import numpy as np
from numpy.typing import NDArray

from pinposture import kernels
from pinposture.kernels.arrays import Screws

if TYPE_CHECKING:
    from pinposture.arm.arm import Arm
    from pinposture.arm.state import ArmState

Array = NDArray[np.float64]
Whole = NDArray[np.int64]


class Constants(NamedTuple):
    """What does not change with the configuration; arrays for kernels, not to be written to.

    Attributes:
        joints: the joints by their numbers along the chain, (n,).
        units: the motion of each joint of the chain that counts as one, (n,) [rad or m].
        plane: directions in which the arm can move, (2, 3) or (3, 3), world axes.
        every: the control points by their numbers, (m,).
        dimensions: number of these directions, once for each control point, (m,).
        frames: these directions, and the normal of a planar arm, once for each control point, (m, 3, 3).
    """

    joints: Whole
    units: Array
    plane: Array
    every: Whole
    dimensions: Whole
    frames: Array


_KNOWN: WeakKeyDictionary[Arm, Constants] = WeakKeyDictionary()


def constants_of(arm: Arm) -> Constants:
    """What kernels want to know of an arm; remembered as long as it lives."""
    known = _KNOWN.get(arm)
    if known is None:
        m, plane = arm.n_modules, np.array(arm.plane)
        frame = plane if len(plane) == 3 else np.vstack([plane, np.cross(plane[0], plane[1])])
        known = _KNOWN[arm] = Constants(
            joints=np.arange(len(arm.columns), dtype=np.int64),
            units=np.array(arm.joint_units[arm.columns]),
            plane=plane,
            every=np.arange(m, dtype=np.int64),
            dimensions=np.full(m, len(plane), dtype=np.int64),
            frames=np.repeat(frame[None], m, axis=0),
        )
    return known


def screws_of(state: ArmState) -> Screws:
    """The screws of the joints of an arm where it is."""
    chain, placed, known = state.arm.kinematics, state.placed, constants_of(state.arm)
    found = Screws(np.empty((len(known.joints), 6)), chain.ends, placed.points)
    given = known.joints, chain.slides, known.units, placed.axes, placed.origins, chain.ends, placed.points
    kernels.find_screws(*given, found.screws)
    return found
