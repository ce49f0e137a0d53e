"""Levenberg-Marquardt on Pinocchio and NumPy, as a careful user writes it in an afternoon.

All Jacobians at once from `data.J` by one cross product, placements through views that are made once,
normal equations solved by Cholesky (LAPACK's posv), damping of Sugihara: half the sum of the squared errors
plus 1e-6 squared arm lengths. The whole step is scaled to the speed limit and cut at the position limits:
no constraints in the solve.
"""

from __future__ import annotations

import numpy as np
import pinocchio as pin
from numpy.typing import NDArray
from scipy.linalg.lapack import dposv

from benchmarks.peers.method import Method, require_limits
from benchmarks.peers.problem import POSITION, Problem

Array = NDArray[np.float64]


class Kinematics:
    """Points and position Jacobians of the module ends, from Pinocchio."""

    def __init__(self, problem: Problem) -> None:
        self.model = pin.buildModelFromXML(problem.urdf)
        self.data = self.model.createData()
        frames = [self.model.getFrameId(name) for name in problem.point_names]
        self.views = [self.data.oMf[frame].translation for frame in frames]
        ends = 2 * np.arange(1, problem.modules + 1)
        self.support = (np.arange(self.model.nv) < ends[:, None])[:, None, :].astype(float)
        self.jacobian = np.zeros((problem.modules, 3, self.model.nv))

    def at(self, q: Array) -> tuple[Array, Array]:
        """Points (m, 3) and stacked Jacobian (3 m, nv); the latter is overwritten by the next call."""
        pin.computeJointJacobians(self.model, self.data, q)
        pin.updateFramePlacements(self.model, self.data)
        points = np.concatenate(self.views).reshape(-1, 3)
        columns = self.data.J
        linear, angular, at = columns[:3], columns[3:], points[:, :, None]
        filled = self.jacobian
        for i, j, k in ((0, 1, 2), (1, 2, 0), (2, 0, 1)):
            np.add(linear[i], angular[j] * at[:, k] - angular[k] * at[:, j], out=filled[:, i])
        filled *= self.support
        return points, filled.reshape(-1, filled.shape[2])


class Peer(Method):
    """One damped least-squares step."""

    packages = ("pin", "numpy", "scipy")

    def __init__(self, problem: Problem, option: str) -> None:
        self.problem = problem
        self.kinematics = Kinematics(problem)
        self.bias = 1e-6 * problem.length**2

    def aim(self, points: Array, q: Array) -> None:
        """Keep the points."""
        self.points = points

    def step(self, q: Array) -> Array:
        """Kinematics, normal equations, Cholesky, limits, check."""
        at, jacobian = self.kinematics.at(q)
        errors = (self.points - at).ravel()
        gram = jacobian.T @ jacobian
        gram.flat[:: len(gram) + 1] += 0.5 * (errors @ errors) + self.bias
        _, dq, _ = dposv(gram, jacobian.T @ errors, overwrite_a=True, overwrite_b=True)
        dq *= min(1.0, self.problem.bound / np.abs(dq).max())
        return require_limits(self.problem, q, np.minimum(np.maximum(q + dq, -POSITION), POSITION) - q)
