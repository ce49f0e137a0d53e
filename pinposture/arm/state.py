"""What is known of an arm at one configuration: placements, Jacobians, manipulability."""

from __future__ import annotations

from functools import cached_property
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from pinposture.arm.kinematics import ForwardKinematics, Frames
from pinposture.arm.manipulability import (
    ControlPoints,
    Ellipsoid,
    all_pairs,
    chosen_points,
    section_bases,
    section_ellipsoid,
)

if TYPE_CHECKING:
    from pinposture.arm.arm import Arm

Array = NDArray[np.float64]


class ArmState:
    """The arm at one configuration; everything in it is read-only, and worked out when first asked for.

    Pinocchio supplies placements and Jacobians: `computeJointJacobians` and `updateFramePlacements`, once for
    a state. Arms of more than `arm.kinematics.MOST_IN_DATA` degrees of freedom, for which `pin.Data` would
    need too much memory, take them from the compiled pass along the chain.

    Attributes:
        arm: the arm that this is a state of.
    """

    def __init__(self, arm: Arm, q: Array) -> None:
        self.arm, self._q = arm, q

    @cached_property
    def compiled(self) -> ArmState:
        """The same state by the compiled pass along the chain, which solvers use inside.

        It equals this one to rounding; an iteration takes all its numbers from one of the two.
        """
        state = _CompiledState(self.arm, self._q)
        state.__dict__["forward"] = self.forward
        return state

    @cached_property
    def forward(self) -> ForwardKinematics:
        """The compiled pass along the chain, for kernels; not to be written to."""
        return self.arm.kinematics.forward(self.arm.difference(self.arm.origin, self._q))

    @cached_property
    def frames(self) -> Frames | None:
        """What Pinocchio says of the control points; None for an arm that is too long for `pin.Data`."""
        reader = self.arm.frames
        return None if reader is None else reader.read(self._q)

    @cached_property
    def q(self) -> Array:
        """Configuration, (nq,) [rad or m]."""
        return _read_only(self._q)

    @cached_property
    def points(self) -> Array:
        """Positions of the control points, (m, 3) [m], world frame."""
        return _read_only((self.frames or self.forward).points)

    @cached_property
    def links(self) -> Array:
        """The line of the arm from its base by way of joints and control points to the tip, (k, 3) [m].

        World frame. Links are straight from each of these places to the next; one that slides out reaches
        from where it slides. Of a base that slides without real limits the line begins behind those slides.
        """
        chain, ends = self.arm.chain, self.arm.chain.module_slices
        origins = [self.forward.origins[joints] for joints in ends]
        parts = [part for pair in zip(origins, self.forward.points[:, None], strict=True) for part in pair]
        roaming = int(self.arm.roaming.sum())
        return _read_only(np.vstack([chain.base, *parts])[roaming + bool(roaming) :])

    @cached_property
    def rotations(self) -> Array:
        """Orientations of the control points, (m, 3, 3), from control-point to world frame."""
        return _read_only((self.frames or self.forward).rotations)

    @cached_property
    def positions(self) -> Array:
        """Joint positions (nv,) [rad or m]; continuous joints within +-pi."""
        return _read_only(self.arm.difference(self.arm.origin, self._q))

    @cached_property
    def jacobians(self) -> Array:
        """Position Jacobians of the control points, (m, 3, nv) [m/rad], world axes.

        A column is v + w x p for a joint that carries the control point p, else zero: v is the velocity at
        the world origin and w the angular velocity that one unit of joint motion gives to a body.
        """
        if self.frames is None:
            return _read_only(self.arm.kinematics.jacobians(self.forward))
        (vx, vy, vz, wx, wy, wz), support = self.frames.motions.T, self.arm.support
        x, y, z = self.frames.points.T[:, :, None]
        jacobians = np.empty((self.arm.n_modules, 3, self.arm.nv))
        jacobians[:, 0] = (vx + wy * z - wz * y) * support
        jacobians[:, 1] = (vy + wz * x - wx * z) * support
        jacobians[:, 2] = (vz + wx * y - wy * x) * support
        return _read_only(jacobians)

    @cached_property
    def axes(self) -> Array:
        """How each degree of freedom turns what it carries, (3, nv) [rad/rad], world axes.

        The unit axis of a joint that turns, zero for one that slides or that is not on the chain.
        """
        if self.frames is not None:
            return _read_only(self.frames.motions[:, 3:].T * self.arm.moved)
        axes = np.zeros((3, self.arm.nv))
        turns = self.arm.chain.revolute
        axes[:, self.arm.columns[turns]] = self.forward.axes[turns].T
        return _read_only(axes)

    @cached_property
    def angular_jacobians(self) -> Array:
        """Angular Jacobians of the control points, (m, 3, nv) [rad/rad], world axes.

        A column is the rotation vector, per unit of joint motion, by which the joint turns the control point;
        zero where it does not turn it.
        """
        return _read_only(self.axes * self.arm.support[:, None, :])

    @cached_property
    def task_jacobians(self) -> Array:
        """Position Jacobians in comparable units, along the directions in which the arm can move at all.

        Returns:
            Array (m, d, nv) [m per unit of joint motion, see `Arm.joint_units`]: d = 3 in world axes, or
            d = 2 along the plane of a planar arm.
        """
        if self.arm.dimension == 3 and np.all(self.arm.chain.revolute):
            return self.jacobians
        return _read_only((self.arm.plane @ self.jacobians) * self.arm.joint_units)

    def manipulability(self) -> Array:
        """Manipulability indices of all sections, (4.3) and (4.4).

        Returns:
            Array (m + 1, m + 1): entry [s, i] is the index of control point i relative to control
            point s, in [0, 1]; 0 stands for the base; zero where s >= i. Computed once per state.
        """
        return self._manipulability

    @cached_property
    def _manipulability(self) -> Array:
        return _read_only(all_pairs(self))

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
        return f"ArmState(q={np.array2string(self.q, precision=3, threshold=8)}, m={self.arm.n_modules})"


class _CompiledState(ArmState):
    """A state that does not ask Pinocchio."""

    @property
    def compiled(self) -> ArmState:
        return self

    @property
    def frames(self) -> None:
        return None


def _read_only(array: Array) -> Array:
    """The same numbers, for users."""
    view: Array = array.view()
    view.flags.writeable = False
    return view
