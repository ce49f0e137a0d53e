"""The manipulability measure (3.3) of a control point, and its first two derivatives."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from pinposture.arm import ArmState
from pinposture.control.baselines.derivatives import PositionDerivatives
from pinposture.control.baselines.tasks import RANK

Array = NDArray[np.float64]


def manipulability_measure(state: ArmState, point: int) -> float:
    """Product w of the singular values of the position Jacobian (3.3), relative to length^d of the arm.

    Args:
        state: where the arm is.
        point: control point, 0-based.
    """
    sigma = np.linalg.svd(state.task_jacobians[point], compute_uv=False)
    return float(np.prod(sigma / state.arm.length))


def measure_gradient(state: ArmState, point: int) -> Array:
    """Gradient of the manipulability measure.

    dw/dq_u = w tr(dJ/dq_u J^+); in w J^+ every singular value is replaced by the product of the others.

    Returns:
        Array (nv,), per unit of joint motion. Where J is singular w is zero and has no gradient, as |x| has
        none at 0: then zero.
    """
    gradient = np.zeros(state.arm.nv)
    known = _decomposed(state, point)
    if known is not None:
        derivatives, inverse, measure = known
        gradient[derivatives.columns] = measure * np.einsum("uva,va->u", derivatives.second(), inverse)
    return gradient


def measure_hessian(state: ArmState, point: int) -> Array:
    """Second derivatives of the manipulability measure.

    With D_u = dJ/dq_u and G = J J^T, those of log w are

        tr(dD_u/dq_v J^+) - tr(D_u J^+ D_v J^+) + tr(D_u (I - J^+J) D_v^T G^-1).

    Returns:
        Array (nv, nv), per unit of joint motion squared; zero where J is singular.
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
    """Derivatives, J^+ (n, d) and w relative to length^d; None where J is singular."""
    derivatives = PositionDerivatives(state, point)
    jacobian = derivatives.plane @ derivatives.jacobian
    left, sigma, right = np.linalg.svd(jacobian, full_matrices=False)
    if len(sigma) < len(jacobian) or sigma[-1] <= RANK * sigma[0]:
        return None
    return derivatives, (right.T / sigma) @ left.T, float(np.prod(sigma / state.arm.length))
