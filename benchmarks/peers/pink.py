"""Pink: one FrameTask a module end, as its examples do.

FrameTask(position_cost=1, orientation_cost=0, lm_damping=1); ConfigurationLimit and VelocityLimit of the
model (made once); solve_ik with DAQP. The data of Pinocchio is not copied. Measured positions go in by
`Configuration.update`, which runs the kinematics once.
"""

from __future__ import annotations

import numpy as np
import pink
import pinocchio as pin
from numpy.typing import NDArray
from pink.limits import ConfigurationLimit, VelocityLimit
from pink.tasks import FrameTask

from benchmarks.peers.method import Method, require_limits
from benchmarks.peers.problem import DT, Problem

Array = NDArray[np.float64]


class Peer(Method):
    """Tasks and limits built once; targets set when they change."""

    packages = ("pin-pink", "pin", "qpsolvers", "daqp", "numpy")

    def __init__(self, problem: Problem, option: str) -> None:
        self.problem = problem
        model = pin.buildModelFromXML(problem.urdf)
        data = model.createData()
        self.configuration = pink.Configuration(model, data, pin.neutral(model), copy_data=False)
        self.tasks = [
            FrameTask(name, position_cost=1.0, orientation_cost=0.0, lm_damping=1.0)
            for name in problem.point_names
        ]
        self.limits = [ConfigurationLimit(model), VelocityLimit(model)]

    def aim(self, points: Array, q: Array) -> None:
        """Set the target of each task."""
        for task, point in zip(self.tasks, points, strict=True):
            task.set_target(pin.SE3(np.eye(3), point))

    def step(self, q: Array) -> Array:
        """Update, solve, check."""
        self.configuration.update(q)
        velocity = pink.solve_ik(self.configuration, self.tasks, DT, solver="daqp", limits=self.limits)
        return require_limits(self.problem, q, velocity * DT)
