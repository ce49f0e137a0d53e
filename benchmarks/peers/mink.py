"""Mink: one FrameTask a module end, as its examples do.

The URDF text is compiled by MuJoCo, with a site at each module end. FrameTask(position_cost=1,
orientation_cost=0, lm_damping=1); ConfigurationLimit and VelocityLimit (made once); solve_ik with DAQP.
"""

from __future__ import annotations

import mink
import mujoco
import numpy as np
from numpy.typing import NDArray

from benchmarks.peers.method import Method, require_limits
from benchmarks.peers.problem import DT, LINK, Problem

Array = NDArray[np.float64]


class Peer(Method):
    """Tasks and limits built once; targets set when they change."""

    packages = ("mink", "mujoco", "qpsolvers", "daqp", "numpy")

    def __init__(self, problem: Problem, option: str) -> None:
        self.problem = problem
        spec = mujoco.MjSpec.from_string(problem.urdf)
        for k, name in enumerate(problem.point_names):
            spec.body(f"link_{k:04d}_z").add_site(name=f"at_{name}", pos=[LINK, 0.0, 0.0])
        model = spec.compile()
        self.configuration = mink.Configuration(model)
        self.tasks = [
            mink.FrameTask(f"at_{name}", "site", position_cost=1.0, orientation_cost=0.0, lm_damping=1.0)
            for name in problem.point_names
        ]
        speeds = {model.joint(j).name: problem.speed for j in range(model.njnt)}
        self.limits = [mink.ConfigurationLimit(model), mink.VelocityLimit(model, speeds)]

    def aim(self, points: Array, q: Array) -> None:
        """Set the target of each task."""
        for task, point in zip(self.tasks, points, strict=True):
            task.set_target(mink.SE3.from_translation(point))

    def step(self, q: Array) -> Array:
        """Update, solve, check."""
        self.configuration.update(q)
        velocity = mink.solve_ik(self.configuration, self.tasks, DT, solver="daqp", limits=self.limits)
        return require_limits(self.problem, q, velocity * DT)
