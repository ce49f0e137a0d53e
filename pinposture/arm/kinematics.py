"""The chain of an arm as plain arrays, and where they put it: Pinocchio's model without Pinocchio's loop.

`pin.Data` needs memory that grows with the cube of the number of joints, and reading placements out of it
one by one costs more than computing them. The model stays Pinocchio's; only the pass along the chain is ours,
and it gives the same numbers (`tests/arm/test_kinematics.py`).
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
import pinocchio as pin
from numpy.typing import NDArray

from pinposture import kernels
from pinposture.arm.skeleton import joint_axes
from pinposture.errors import InvalidValue
from pinposture.kernels.arrays import Chain

Array = NDArray[np.float64]
Whole = NDArray[np.int64]


class Placed(NamedTuple):
    """Where a chain is, world frame: arrays for kernels, not to be written to.

    Attributes:
        axes: unit joint axes, (n, 3).
        origins: origins of the joints, a point on each axis, (n, 3) [m].
        points: control points, (m, 3) [m].
        rotations: orientations of the control points, (m, 3, 3), from control-point to world frame.
        positions: the joint positions that put it there, (nv,) [rad or m].
    """

    axes: Array
    origins: Array
    points: Array
    rotations: Array
    positions: Array


class Kinematics:
    """The constants of a chain, in the order of its joints from base to tip.

    Attributes:
        slides: True for a joint that slides, (n,); others turn.
        columns: column of each joint in the tangent space, (n,).
        ends: number of joints that carry each control point, (m,).
        endless: which joint positions come round to where they were, (nv,).
        constants: what `kernels.placements` wants to know of the chain.
    """

    def __init__(self, model: pin.Model, names: Sequence[str], frames: Sequence[int]) -> None:
        """Read a chain out of a model.

        Args:
            model: the arm, base placement applied.
            names: the joints of the chain from base to tip, each the parent of the next.
            frames: the control points.

        Raises:
            InvalidValue: a joint that neither turns about one axis nor slides along one.
        """
        joints = [model.getJointId(name) for name in names]
        self.slides = np.array([_slides(model, joint) for joint in joints], dtype=np.bool_)
        self.endless = np.zeros(model.nv, dtype=np.bool_)
        for joint in joints:
            self.endless[model.joints[joint].idx_v] = model.joints[joint].nq == 2
        self.columns = np.array([model.joints[joint].idx_v for joint in joints], dtype=np.int64)
        placements = [model.jointPlacements[joint] for joint in joints]
        fixed = np.array([[*each.rotation.ravel(), *each.translation] for each in placements])
        axes = joint_axes(model, joints)
        number = {joint: u + 1 for u, joint in enumerate(joints)}
        points = [model.frames[frame] for frame in frames]
        self.ends = np.array([number[point.parentJoint] for point in points], dtype=np.int64)
        offsets = np.array([point.placement.translation for point in points])
        turns = np.array([point.placement.rotation for point in points])
        self.constants = Chain(self.slides, self.columns, fixed, axes, self.ends, offsets, turns)

    def placed(self, positions: Array) -> Placed:
        """Where everything is with the joints at positions (nv,) [rad or m]."""
        n, m = len(self.columns), len(self.ends)
        filled = np.empty((n, 3)), np.empty((n, 3)), np.empty((m, 3)), np.empty((m, 3, 3))
        kernels.placements(self.constants, positions, *filled)
        return Placed(*filled, positions)


def _slides(model: pin.Model, joint: int) -> bool:
    kind = model.joints[joint].shortname().removeprefix("JointModel")
    if kind[0] not in "PR":
        allowed = "a joint that turns about one axis, or slides along one"
        raise InvalidValue(f"joint {model.names[joint]!r}", kind, allowed)
    return bool(kind[0] == "P")
