"""What is known of an arm at one configuration: placements, Jacobians, manipulability."""

from __future__ import annotations

from functools import cached_property
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from pinposture.arm.manipulability import all_pairs

if TYPE_CHECKING:
    from pinposture.arm.arm import Arm

Array = NDArray[np.float64]


class ArmState:
    """The arm at one configuration; everything in it is read-only.

    Attributes:
        arm: the arm that this is a state of.
        q: configuration, (nq,) [rad or m].
        points: positions of the control points, (m, 3) [m], world frame.
        rotations: orientations of the control points, (m, 3, 3), from control-point to world frame.
        jacobians: position Jacobians of the control points, (m, 3, nv) [m/rad], world axes.
    """

    def __init__(self, arm: Arm, q: Array, points: Array, rotations: Array, jacobians: Array) -> None:
        for array in (q, points, rotations, jacobians):
            array.flags.writeable = False
        self.arm, self.q = arm, q
        self.points, self.rotations, self.jacobians = points, rotations, jacobians

    @cached_property
    def task_jacobians(self) -> Array:
        """Position Jacobians along the directions in which the arm can move at all.

        Returns:
            Array (m, d, nv) [m/rad]: d = 3 in world axes, or d = 2 along the plane of a planar arm.
        """
        if self.arm.dimension == 3:
            return self.jacobians
        jacobians: Array = self.arm.plane @ self.jacobians
        jacobians.flags.writeable = False
        return jacobians

    def manipulability(self) -> Array:
        """Manipulability indices of all sections, (4.3) and (4.4).

        Returns:
            Array (m + 1, m + 1): entry [s, i] is the index of control point i relative to control
            point s, in [0, 1]; 0 stands for the base; zero where s >= i. Computed once per state.
        """
        return self._manipulability

    @cached_property
    def _manipulability(self) -> Array:
        indices = all_pairs(self.task_jacobians[:, :, self.arm.columns], self.arm.module_starts)
        indices.flags.writeable = False
        return indices

    def __repr__(self) -> str:
        return f"ArmState(q={np.array2string(self.q, precision=3, threshold=8)}, m={len(self.points)})"
