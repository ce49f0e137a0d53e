"""The controllers of this library, as their users call them: `arm.at(q)`, then `controller.step`.

The speed limit is what bounds a step: Limits(step=None, velocity=..., dt=0.05). A target knows its
configuration (`Target.from_configuration`), as one that was resolved does; "geodesic-points" is the default
controller with points alone (`Target.from_points`), which is all that peers are told. The memory goes from
step to step. The output is checked within the step.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

import pinposture as pp
from benchmarks.baselines import register_baselines
from benchmarks.peers.method import Method
from benchmarks.peers.problem import DT, LINK, Problem
from pinposture.control import controller_named

register_baselines()

Array = NDArray[np.float64]


class Peer(Method):
    """A controller by its name."""

    packages = ("pinposture", "pin", "numpy", "scipy", "numba", "daqp")

    def __init__(self, problem: Problem, option: str) -> None:
        self.arm = pp.Arm.from_template("RyRz", modules=problem.modules, link_lengths=(LINK, LINK))
        self.controller = controller_named(option.removesuffix("-points"))
        self.points_only = option.endswith("-points")
        self.limits = pp.Limits(step=None, velocity=problem.speed, dt=DT)
        self.begin()

    def begin(self) -> None:
        """The arm is at rest."""
        self.memory = None

    def aim(self, points: Array, q: Array) -> None:
        """Make the target."""
        if self.points_only:
            self.target = pp.Target.from_points(self.arm, points)
        else:
            self.target = pp.Target.from_configuration(self.arm, q)

    def step(self, q: Array) -> Array:
        """One cycle: the state of the arm, and a step."""
        step = self.controller.step(self.arm.at(q), self.target, self.limits, self.memory)
        self.memory = step.memory
        return step.dq

    def integrate(self, q: Array, dq: Array) -> Array:
        """As users do."""
        return self.arm.integrate(q, dq)
