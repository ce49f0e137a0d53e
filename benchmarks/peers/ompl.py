"""RRT-Connect of OMPL, on the compiled distances of this library.

Each state is checked by `CollisionModel.minimum_along`, which ends early where the margin is kept, through
the validity checker that OMPL calls in Python: 4 us of the 25 to 50 us that a state takes go into reading it.
What is found is simplified by `simplifySolution`, for two seconds at most.
"""

from __future__ import annotations

from time import process_time

import numpy as np
from numpy.typing import NDArray
from ompl import base, geometric, util

from benchmarks.harness import Problem
from benchmarks.peers.planner import RESOLUTION, Found
from pinposture.collision import CollisionModel

Array = NDArray[np.float64]

SIMPLIFY, RANGE = 2.0, 1.0
"""Longest time to simplify [s], and longest edge of the trees, as the norm of the joint positions [rad]."""


util.RNG.setSeed(1)  # it can be set once only


class Planner:
    """RRT-Connect for a problem."""

    def __init__(self, problem: Problem) -> None:
        util.setLogLevel(util.LOG_ERROR)
        arm, first, target, scene = problem
        assert scene is not None
        assert target.q is not None
        joints = range(arm.nv)
        model = CollisionModel(arm, scene)
        space = base.RealVectorStateSpace(arm.nv)
        bounds = base.RealVectorBounds(arm.nv)
        for joint in joints:
            bounds.setLow(joint, float(arm.limits.lower[joint]))
            bounds.setHigh(joint, float(arm.limits.upper[joint]))
        space.setBounds(bounds)
        self.setup = geometric.SimpleSetup(space)
        origin = arm.neutral()
        offset = np.empty((1, arm.nv))

        def keeps_margin(state: base.State) -> bool:
            offset[0] = [state[joint] for joint in joints]
            return bool(model.minimum_along(origin, offset, scene.margin).distance >= scene.margin)

        self.setup.setStateValidityChecker(keeps_margin)
        information = self.setup.getSpaceInformation()
        information.setStateValidityCheckingResolution(RESOLUTION / space.getMaximumExtent())
        start, goal = space.allocState(), space.allocState()
        for joint in joints:
            start[joint] = float(first[joint])
            goal[joint] = float(target.q[joint])
        self.setup.setStartAndGoalStates(start, goal)
        planner = geometric.RRTConnect(information)
        planner.setRange(RANGE)
        self.setup.setPlanner(planner)
        self.joints = joints

    def solve(self, budget: float, seed: int) -> Found:
        """Search for a path for up to a time [s], and simplify it; the seed is that of the process."""
        began = process_time()
        self.setup.solve(budget)
        first_time = process_time() - began
        if not self.setup.haveExactSolutionPath():
            return Found.none(first_time)
        first_path = self._waypoints()
        began = process_time()
        self.setup.simplifySolution(SIMPLIFY)
        return Found(first_time, first_path, first_time + process_time() - began, self._waypoints())

    def _waypoints(self) -> Array:
        states = self.setup.getSolutionPath().getStates()
        return np.array([[state[joint] for joint in self.joints] for state in states])
