"""Second and third derivatives of the position of a control point, in closed form.

Let w_u be the axis of joint u in the world (zero if it slides) and J_u the column of the position Jacobian.
Joint u turns everything after it, and with it every column that belongs to a later joint; moving the point
changes the columns of the joints before. For joints in the order of the chain, a <= b <= c,

    d2 p / dq_a dq_b = w_a x J_b,        d3 p / dq_a dq_b dq_c = w_a x (w_b x J_c).
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from pinposture.arm import ArmState

Array = NDArray[np.float64]


def joint_axes(state: ArmState) -> Array:
    """Axes of the joints of the chain in the world, from base to tip, (n, 3); zero for joints that slide."""
    chain = state.arm.chain
    angles = state.arm.positions(state.q)[chain.columns] * chain.revolute
    turns = Rotation.from_rotvec(angles[:, None] * chain.axes).as_matrix()
    axes, turned = np.zeros_like(chain.axes), np.eye(3)
    for u, turn in enumerate(turns):
        axes[u] = turned @ chain.axes[u]
        turned = turned @ turn
    return np.asarray(axes * chain.revolute[:, None])


class PositionDerivatives:
    """Derivatives of the position of one control point by the joints that move it, in `Arm.joint_units`.

    Columns are in the order of the chain.

    Attributes:
        columns: tangent space indices of those joints, (n,).
        axes: their axes in the world, (n, 3); zero for joints that slide.
        jacobian: position Jacobian, (3, n) [m per unit], world axes.
        plane: directions of the task, (d, 3), orthonormal: see `Arm.plane`.
    """

    def __init__(self, state: ArmState, point: int) -> None:
        arm = state.arm
        n = int(arm.support[point].sum())
        self.columns = arm.columns[:n]
        self.axes = joint_axes(state)[:n]
        self.jacobian = state.jacobians[point][:, self.columns] * arm.joint_units[self.columns]
        self.plane = arm.plane

    def second(self) -> Array:
        """Second derivatives of the position along the task directions, (n, n, d) [m]."""
        crossed = np.cross(self.axes[:, None], self.jacobian.T[None])  # (n, n, 3): w_u x J_v
        return np.asarray(_symmetric(crossed) @ self.plane.T)

    def third(self, weights: Array) -> Array:
        """Third derivatives, summed over one of the joints with weights.

        The triple product a x (b x c) = b (a . c) - c (a . b) splits every term into factors of one joint
        each, so that running sums over the chain replace the sum.

        Args:
            weights: one vector for each joint, (d, n), along the task directions.

        Returns:
            Array (n, n): sum over t of weights[:, t] . d3 p / dq_u dq_v dq_t.
        """
        axes, columns = self.axes, self.jacobian.T
        lifted = weights.T @ self.plane  # (n, 3)
        outer = columns[:, :, None] * lifted[:, None, :]
        after = np.cumsum(outer[::-1], axis=0)[::-1]  # sum of J P^T over t >= v
        outer = axes[:, :, None] * lifted[:, None, :]
        before = np.cumsum(outer, axis=0) - outer  # sum of w P^T over t < v
        trace_after, trace_before = (np.trace(a, axis1=1, axis2=2)[:, None] for a in (after, before))
        late = _each(after, axes) - trace_after * axes - _each(before, columns) + trace_before * columns
        early = _each(before, axes) - trace_before * axes
        return _symmetric(axes @ late.T + early @ columns.T)


def _each(matrices: Array, vectors: Array) -> Array:
    """One matrix times one vector for each joint, (n, 3)."""
    return np.asarray((matrices @ vectors[:, :, None])[:, :, 0])


def _symmetric(upper: Array) -> Array:
    """The symmetric array (n, n, ...) of which only the part u <= v is right so far."""
    n = len(upper)
    earlier = np.triu(np.ones((n, n), dtype=np.bool_)).reshape(n, n, *([1] * (upper.ndim - 2)))
    return np.asarray(np.where(earlier, upper, upper.swapaxes(0, 1)))
