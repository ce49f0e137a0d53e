"""Placo, in C++: one position task a module end, as its examples do.

The floating base is masked; joint and velocity limits are on. Fixed regularisation fails from afar, so the
weight of the regularisation task is set before each step to the sum of the squared errors, as pink and mink
have it with lm_damping=1, plus 1e-6 squared arm lengths; half of it, as in `lm`, arrives more slowly on long
arms. The errors are those that the tasks hold, from the step before: asking for newer ones would cost another
update of every task, and changes the number of steps little. Measured positions go into `robot.state.q`, then
`update_kinematics`.
"""

from __future__ import annotations

import tempfile
from pathlib import Path

import numpy as np
import placo
from numpy.typing import NDArray

from benchmarks.peers.method import Method, require_limits
from benchmarks.peers.problem import DT, Problem

Array = NDArray[np.float64]

BASE = 7, 6
"""Coordinates of the floating base in q, and in v."""


class Peer(Method):
    """Tasks built once; targets set when they change."""

    packages = ("placo", "pin", "numpy")

    def __init__(self, problem: Problem, option: str) -> None:
        self.problem = problem
        with tempfile.TemporaryDirectory() as folder:
            path = Path(folder, "arm.urdf")
            path.write_text(problem.urdf)
            self.robot = placo.RobotWrapper(str(path), placo.Flags.ignore_collisions)
        self.solver = placo.KinematicsSolver(self.robot)
        self.solver.mask_fbase(True)
        self.solver.dt = DT
        self.solver.enable_joint_limits(True)
        self.solver.enable_velocity_limits(True)
        self.tasks = [self.solver.add_position_task(name, np.zeros(3)) for name in problem.point_names]
        for name, task in zip(problem.point_names, self.tasks, strict=True):
            task.configure(name, "soft", 1.0)
        self.bias = 1e-6 * problem.length**2
        self.damping = self.solver.add_regularization_task(self.bias)
        self.q = self.robot.state.q.copy()

    def aim(self, points: Array, q: Array) -> None:
        """Set the target of each task."""
        for task, point in zip(self.tasks, points, strict=True):
            task.target_world = point

    def step(self, q: Array) -> Array:
        """Kinematics, damping, solve, check."""
        self.q[BASE[0] :] = q
        self.robot.state.q = self.q
        self.robot.update_kinematics()
        squares = sum([task.error_norm() ** 2 for task in self.tasks])
        self.damping.configure("damping", "soft", squares + self.bias)
        return require_limits(self.problem, q, self.solver.solve(False)[BASE[1] :])
