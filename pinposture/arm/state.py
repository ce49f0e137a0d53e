"""What is known of an arm at one configuration: placements, Jacobians, manipulability."""

from __future__ import annotations

from functools import cached_property
from typing import TYPE_CHECKING, NamedTuple

import numpy as np
import pinocchio as pin
from numpy.typing import NDArray

from pinposture.arm.ellipsoid import (
    ControlPoints,
    Ellipsoid,
    chosen_points,
    section_bases,
    section_ellipsoid,
)
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
        axes: how each degree of freedom turns what it carries, (3, nv) [rad/rad], world axes: the unit axis
            of a joint that turns, zero for one that slides.
    """

    def __init__(
        self, arm: Arm, q: Array, points: Array, rotations: Array, jacobians: Array, axes: Array
    ) -> None:
        for array in (q, points, rotations, jacobians, axes):
            array.flags.writeable = False
        self.arm, self.q = arm, q
        self.points, self.rotations, self.jacobians, self.axes = points, rotations, jacobians, axes

    @cached_property
    def angular_jacobians(self) -> Array:
        """Angular Jacobians of the control points, (m, 3, nv) [rad/rad], world axes.

        A column is the rotation vector, per unit of joint motion, by which the joint turns the control point;
        zero where it does not turn it.
        """
        jacobians: Array = self.axes * self.arm.frames.support
        jacobians.flags.writeable = False
        return jacobians

    @cached_property
    def task_jacobians(self) -> Array:
        """Position Jacobians in comparable units, along the directions in which the arm can move at all.

        Returns:
            Array (m, d, nv) [m per unit of joint motion, see `Arm.joint_units`]: d = 3 in world axes, or
            d = 2 along the plane of a planar arm.
        """
        if self.arm.dimension == 3 and np.all(self.arm.chain.revolute):
            return self.jacobians
        jacobians: Array = (self.arm.plane @ self.jacobians) * self.arm.joint_units
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

    def ellipsoids(
        self, points: ControlPoints | None = None, relative_to: str = "base"
    ) -> tuple[Ellipsoid, ...]:
        """Manipulability ellipsoids, with the measures of closeness to a singularity (Section 3.3).

        Args:
            points: control points, by their indices, 0-based or from the tip as -1, or by their names; all of
                them if None.
            relative_to: "base" to let all joints move; "previous" for those alone that come after the chosen
                control point before, as in the relative manipulability condition of a control set.

        Returns:
            One ellipsoid for each, in the order of `points`. Radii and measures are in comparable units, as
            `task_jacobians` is.

        Raises:
            InvalidValue: an index that no control point has, or a control point chosen twice.
            UnknownName: a name that no control point has, or another `relative_to`.
        """
        arm = self.arm
        chosen = chosen_points(arm.control_points, range(arm.n_modules) if points is None else points)
        listed = []
        for point, base in zip(chosen, section_bases(chosen, relative_to), strict=True):
            own = self.task_jacobians[point][:, arm.columns[arm.module_starts[base] :]]
            listed.append(section_ellipsoid(own, arm.plane, point, base, self.points[point]))
        return tuple(listed)

    def __repr__(self) -> str:
        return f"ArmState(q={np.array2string(self.q, precision=3, threshold=8)}, m={len(self.points)})"


class ControlFrames(NamedTuple):
    """The control points as frames of the model.

    Attributes:
        parents: index of the joint that carries each, (m,).
        offsets: position in the frame of that joint, (m, 3) [m].
        turns: orientation in the frame of that joint, (m, 3, 3).
        support: 1 where a degree of freedom moves a control point, else 0, (m, 1, nv).
    """

    parents: tuple[int, ...]
    offsets: Array
    turns: Array
    support: Array


def sweep(arm: Arm, data: pin.Data, q: Array) -> ArmState:
    """Read placements and Jacobians of all control points out of one pass over the joints.

    Args:
        arm: the arm.
        data: scratch data of its model.
        q: configuration, (nq,).
    """
    frames = arm.frames
    spatial = pin.computeJointJacobians(arm.model, data, q)
    bodies = [data.oMi[joint] for joint in frames.parents]
    turns = np.array([body.rotation for body in bodies])
    points = np.array([body.translation for body in bodies])
    points += np.einsum("kij,kj->ki", turns, frames.offsets)
    # d p_k / d q_u = v_u + w_u x p_k for every joint u that moves k: columns of data.J are (v_u, w_u).
    x, y, z = points.T[:, :, None]
    v, w = spatial[:3], spatial[3:]
    jacobians = np.empty((len(points), 3, arm.nv))
    jacobians[:, 0] = v[0] + w[1] * z - w[2] * y
    jacobians[:, 1] = v[1] + w[2] * x - w[0] * z
    jacobians[:, 2] = v[2] + w[0] * y - w[1] * x
    jacobians *= frames.support
    axes = np.array(w).reshape(3, arm.nv)  # a copy, in case it is Pinocchio's scratch
    return ArmState(arm, q, points, turns @ frames.turns, jacobians, axes)
