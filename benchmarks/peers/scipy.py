"""SciPy's `least_squares` on the posture errors, with bounds (method "trf") and exact Jacobians.

It finds the posture in one go, so there is no step to time: a run is one call, and nothing limits how far
joints go between its evaluations. Reported: the whole call, and the time per evaluation of points and
Jacobian. Lengths in units of the arm length, tolerances (ftol, xtol, gtol) 1e-10, at most 100 evaluations.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import least_squares

from benchmarks.peers.method import Method
from benchmarks.peers.numpy_lm import Kinematics
from benchmarks.peers.problem import POSITION, Problem

Array = NDArray[np.float64]

TOLERANCE = 1e-10
EVALUATIONS = 100


class Peer(Method):
    """The whole way in one call."""

    whole = True
    packages = ("scipy", "pin", "numpy")

    def __init__(self, problem: Problem, option: str) -> None:
        self.kinematics = Kinematics(problem)
        self.length = problem.length

    def aim(self, points: Array, q: Array) -> None:
        """Keep the points."""
        self.points = points

    def solve(self, q: Array) -> tuple[Array, int]:
        """One call of `least_squares`; it asks for errors and Jacobian of the same q in turn."""
        latest: dict[str, Array] = {}

        def errors(positions: Array) -> Array:
            at, jacobian = self.kinematics.at(positions)
            latest["q"], latest["jacobian"] = positions.copy(), jacobian.copy()
            return ((at - self.points) / self.length).ravel()

        def jacobian(positions: Array) -> Array:
            if not np.array_equal(latest["q"], positions):
                errors(positions)
            return latest["jacobian"] / self.length

        found = least_squares(
            errors, q, jacobian, bounds=(-POSITION, POSITION), method="trf", max_nfev=EVALUATIONS,
            ftol=TOLERANCE, xtol=TOLERANCE, gtol=TOLERANCE,
        )  # fmt: skip
        return found.x, int(found.nfev)
