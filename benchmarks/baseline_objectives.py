"""Null-space objectives (2.7), (2.8) and their derivatives."""

from __future__ import annotations

from typing import Literal

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from pinposture.arm import ArmState

# Second and third derivatives of the position of a control point, in closed form.
#
# Let w_u be the axis of joint u in the world (zero if it slides) and J_u the column of the position Jacobian.
# Joint u turns everything after it, including the columns of later joints; moving the point changes the
# columns of earlier joints. For joints in the order of the chain, a <= b <= c,
#
# d2 p / dq_a dq_b = w_a x J_b, d3 p / dq_a dq_b dq_c = w_a x (w_b x J_c).

Array = NDArray[np.float64]


def joint_axes(state: ArmState) -> Array:
    """Return the world axes of the joints of the chain from base to tip, (n, 3); zero for slides."""
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
        axes: their axes in the world, (n, 3); zero for slides.
        jacobian: position Jacobian, (3, n) [m per unit], world axes.
        plane: orthonormal task directions, (d, 3); see `Arm.plane`.
    """

    def __init__(self, state: ArmState, point: int) -> None:
        arm = state.arm
        n = int(arm.support[point].sum())
        self.columns = arm.columns[:n]
        self.axes = joint_axes(state)[:n]
        self.jacobian = state.jacobians[point][:, self.columns] * arm.joint_units[self.columns]
        self.plane = arm.plane

    def second(self) -> Array:
        """Return the second derivatives of the position along the task directions, (n, n, d) [m]."""
        crossed = np.cross(self.axes[:, None], self.jacobian.T[None])  # (n, n, 3): w_u x J_v
        return np.asarray(_symmetric(crossed) @ self.plane.T)

    def third(self, weights: Array) -> Array:
        """Return the third derivatives, summed over one of the joints with weights.

        The triple product a x (b x c) = b (a . c) - c (a . b) splits each term into factors of one joint
        each, so that the sum can be computed by running sums over the chain.

        With weights (d, n) along the task directions, this is the array (n, n) of the sums over t of
        weights[:, t] . d3 p / dq_u dq_v dq_t.
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
    """Return the product of matrix and vector for each joint, (n, 3)."""
    return np.asarray((matrices @ vectors[:, :, None])[:, :, 0])


def _symmetric(upper: Array) -> Array:
    """Complete a symmetric array (n, n, ...) of which only the part u <= v is valid."""
    n = len(upper)
    earlier = np.triu(np.ones((n, n), dtype=np.bool_)).reshape(n, n, *([1] * (upper.ndim - 2)))
    return np.asarray(np.where(earlier, upper, upper.swapaxes(0, 1)))


RANK = 1e-12
"""Singular values up to this fraction of the largest count as zero, because they are rounding errors."""


# The manipulability measure (3.3) of a control point, and its first two derivatives.


def manipulability_measure(state: ArmState, point: int) -> float:
    """Return the product w of the singular values of the position Jacobian (3.3), relative to length^d."""
    sigma = np.linalg.svd(state.task_jacobians[point], compute_uv=False)
    return float(np.prod(sigma / state.arm.length))


def measure_gradient(state: ArmState, point: int) -> Array:
    """Return the gradient of the manipulability measure.

    dw/dq_u = w tr(dJ/dq_u J^+); in w J^+ every singular value is replaced by the product of the others.

    Returns:
        Array (nv,), per unit joint motion. Zero if J is singular, where w is not differentiable, like |x| at
        0.
    """
    gradient = np.zeros(state.arm.nv)
    known = _decomposed(state, point)
    if known is not None:
        derivatives, inverse, measure = known
        gradient[derivatives.columns] = measure * np.einsum("uva,va->u", derivatives.second(), inverse)
    return gradient


def measure_hessian(state: ArmState, point: int) -> Array:
    """Return the second derivatives of the manipulability measure.

    With D_u = dJ/dq_u and G = J J^T, those of log w are

        tr(dD_u/dq_v J^+) - tr(D_u J^+ D_v J^+) + tr(D_u (I - J^+J) D_v^T G^-1).

    Returns:
        Array (nv, nv), per unit of joint motion squared; zero if J is singular.
    """
    hessian = np.zeros((state.arm.nv, state.arm.nv))
    known = _decomposed(state, point)
    if known is None:
        return hessian
    derivatives, inverse, measure = known  # inverse is J^+, (n, d)
    changes = derivatives.second().swapaxes(1, 2)  # D, (n, d, n)
    n = len(changes)
    products = changes @ inverse  # D_u J^+, (n, d, d)
    slope = np.trace(products, axis1=1, axis2=2)
    null = changes - products @ (derivatives.plane @ derivatives.jacobian)
    curved = inverse.T @ inverse @ changes  # G^-1 D_v
    logarithmic = (
        derivatives.third(inverse.T)
        - np.einsum("uab,vba->uv", products, products)
        + null.reshape(n, -1) @ curved.reshape(n, -1).T
    )
    hessian[np.ix_(derivatives.columns, derivatives.columns)] = measure * (
        logarithmic + np.outer(slope, slope)
    )
    return hessian


def _decomposed(state: ArmState, point: int) -> tuple[PositionDerivatives, Array, float] | None:
    """Return the derivatives, J^+ (n, d) and w relative to length^d; None if J is singular."""
    derivatives = PositionDerivatives(state, point)
    jacobian = derivatives.plane @ derivatives.jacobian
    left, sigma, right = np.linalg.svd(jacobian, full_matrices=False)
    if len(sigma) < len(jacobian) or sigma[-1] <= RANK * sigma[0]:
        return None
    return derivatives, (right.T / sigma) @ left.T, float(np.prod(sigma / state.arm.length))


# Objective functions that a redundant arm can improve while its end-effector performs its task (2.7).

Objective = Literal["manipulability", "joint_limits"]

OBJECTIVES: tuple[Objective, ...] = ("manipulability", "joint_limits")
"""Names of the objective functions, which are maximised.

"manipulability" is the manipulability measure (3.3) of the end-effector, relative to length^d of the arm.

"joint_limits" is minus (2.8): that expression grows without bound as a joint nears a limit, so it must be
minimised, not maximised. Joint positions are in `Arm.joint_units`. Infinite limits add nothing, and joints
that move no control point are ignored. At a limit (2.8) is undefined, and beyond it its gradient points
outwards; so within `NEAREST` of a limit it is continued along its tangent, which is finite and pushes back.
"""

NEAREST = 0.1
"""Distance to a limit, in `Arm.joint_units`, within which (2.8) is continued along its tangent."""


def objective_value(objective: Objective, state: ArmState, end_effector: int) -> float:
    """Return the value h of an objective function; higher is better. The end-effector is 0-based."""
    if objective == "manipulability":
        return manipulability_measure(state, end_effector)
    rooms = np.concatenate(_rooms(state))
    barrier = 0.5 * np.maximum(rooms, NEAREST) ** -2.0
    return -float(np.sum(barrier + np.maximum(NEAREST - rooms, 0.0) * NEAREST**-3.0))


def objective_gradient(objective: Objective, state: ArmState, end_effector: int) -> Array:
    """Return the gradient dh/dq of an objective function, (nv,), per unit of joint motion."""
    if objective == "manipulability":
        return measure_gradient(state, end_effector)
    below, above = _rooms(state)
    return np.asarray(np.maximum(below, NEAREST) ** -3.0 - np.maximum(above, NEAREST) ** -3.0)


def objective_hessian(objective: Objective, state: ArmState, end_effector: int) -> Array:
    """Return the second derivatives of an objective function, (nv, nv), per unit of joint motion squared."""
    if objective == "manipulability":
        return measure_hessian(state, end_effector)
    curvatures = [np.where(room > NEAREST, np.maximum(room, NEAREST) ** -4.0, 0.0) for room in _rooms(state)]
    return np.diag(-3.0 * (curvatures[0] + curvatures[1]))


def _rooms(state: ArmState) -> tuple[Array, Array]:
    """Return the distances of the joints from their lower and upper limits, (nv,), in `Arm.joint_units`."""
    arm = state.arm
    positions, columns = arm.positions(state.q), arm.columns
    below, above = np.full((2, arm.nv), np.inf)  # joints off the chain are ignored
    below[columns] = (positions - arm.limits.lower)[columns] / arm.joint_units[columns]
    above[columns] = (arm.limits.upper - positions)[columns] / arm.joint_units[columns]
    return below, above
