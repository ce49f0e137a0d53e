"""The extended Jacobian: an end-effector task and the conditions of an extremum, as one square matrix."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from pinposture._validation import require_positive
from pinposture.arm import ArmState
from pinposture.control.baselines.baseline import Baseline
from pinposture.control.baselines.derivatives import PositionDerivatives
from pinposture.control.baselines.objectives import (
    Objective,
    objective_gradient,
    objective_hessian,
    require_objective,
)
from pinposture.control.baselines.tasks import RANK, BaselineTask, end_effector_task, finished, held
from pinposture.control.controller import Step
from pinposture.control.limits import Limits
from pinposture.control.thesis.posture_matrix import decompose, pseudo_inverse_step
from pinposture.errors import UnknownName
from pinposture.placement import Target

Array = NDArray[np.float64]


@dataclass(frozen=True)
class ExtendedJacobian(Baseline):
    """Moves the end-effector and stays where an objective function is extremal, (2.12)-(2.14).

    At an extremum under the task, f_c = N^T grad h = 0 for a basis N of the null space of J (2.12). Both
    together make a square system, J_e dq = [dp; 0] with J_c = d f_c / dq, solved by its inverse.

    For J_c to exist, N must be a differentiable function of q. Singular vectors are not: they turn
    arbitrarily within the null space. From J N = 0 follows dN = -J^+ dJ N + N A with any skew matrix A: a
    choice of basis, which adds A^T f_c to the derivative. Take A = 0, the basis that does not turn within
    the null space. Then, with the multipliers l = J^{+T} grad h and the second derivatives D_a of the task
    coordinates,

        J_c = N^T (hess h - sum_a l_a D_a),

    the reduced Hessian of Newton's method for extrema under constraints. J_c changes with N by a rotation of
    its rows only, so that the step is the same for every orthonormal basis, also that of the singular
    vectors of the moment; and at f_c = 0 the choice of A does not matter. Both objective functions are
    differentiated in closed form, at O(n^2 d) for the derivatives and O(n^3) for the inverse.

    As the method goes, f_c is held at the value that it has, zero or not: started off an extremum, it never
    gets to one, unless `restore` asks for it. J_e is singular where J is, and also where an extremum meets
    another or is flat (algorithmic singularities); near that, steps are huge. At one the step is held.

    The singular values of its diagnostics are those of J_e, see `system`.

    Attributes:
        objective: what is extremal, see `objectives.OBJECTIVES`.
        gain: share of its error that the end-effector is asked to cover in one step.
        restore: share of f_c that is taken back in one step. 0 is (2.14) as printed.
    """

    objective: Objective = "manipulability"
    gain: float = 1.0
    restore: float = 0.0
    name: str = "extended"

    def __post_init__(self) -> None:
        if self.objective is None:
            raise UnknownName("objective", None, ("manipulability", "joint_limits"))
        require_objective(self.objective)
        require_positive("gain", self.gain)
        require_positive("restore", self.restore, zero=True)

    def _step(self, state: ArmState, target: Target, limits: Limits, previous: Array | None) -> Step:
        task = end_effector_task(state, target)
        columns, extended, constraint = self.system(state, task)
        if len(extended) < len(columns):
            return held(
                state,
                "the Jacobian of the end-effector is singular: there is no extended Jacobian",
                limits,
                previous,
            )
        matrix = decompose(extended)
        if matrix.sigma[-1] <= RANK * matrix.sigma[0]:
            return held(
                state,
                f"the extended Jacobian is singular: {self.objective} has no single extremum",
                limits,
                previous,
            )
        velocity = np.concatenate([self.gain * task.errors, -self.restore * constraint])
        asked = np.zeros(state.arm.nv)
        asked[columns] = pseudo_inverse_step(matrix, velocity, np.zeros(len(columns)))
        return finished(state, task.points, len(extended), matrix.sigma, asked, limits, previous)

    def system(self, state: ArmState, task: BaselineTask) -> tuple[NDArray[np.intp], Array, Array]:
        """The extended Jacobian J_e and the constraint f_c.

        Returns:
            Tangent space indices of the n joints that move the end-effector; J_e (n, n) [m per unit], the
            last n - d rows of which are those of f_c; and f_c (n - d,) [m], times the arm length to be of one
            kind with J. Where J is singular, J_e is empty.
        """
        derivatives = PositionDerivatives(state, task.end_effector)
        columns, length = derivatives.columns, state.arm.length
        jacobian = task.jacobian[:, columns]
        left, sigma, right = np.linalg.svd(jacobian)
        rank = int(np.count_nonzero(sigma > RANK * sigma[0]))
        if rank < len(jacobian):
            return columns, np.zeros((0, len(columns))), np.zeros(0)
        null = right[rank:]  # N^T, (n - d, n)
        gradient = objective_gradient(self.objective, state, task.end_effector)[columns]
        hessian = objective_hessian(self.objective, state, task.end_effector)[np.ix_(columns, columns)]
        multipliers = left @ ((right[:rank] @ gradient) / sigma)
        reduced = null @ (hessian - derivatives.second() @ multipliers)
        return columns, np.vstack([jacobian, length * reduced]), length * (null @ gradient)
