"""Planners among obstacles that are compared: what each returns, and that of this library."""

from __future__ import annotations

from time import process_time
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from benchmarks.harness import Problem
from benchmarks.studies.clutter import RUN_LIMITS
from pinposture.control import JointPath, plan

Array = NDArray[np.float64]

RESOLUTION = 0.05
"""Distance of the configurations that the peers check on a motion, as the norm of joint positions [rad]."""


class Found(NamedTuple):
    """What a planner found for a problem.

    Attributes:
        first_time: processor time until a first path is known, or until it gave up [s].
        first_path: waypoints of that path, (k, n) [rad]; None if there is none.
        time: processor time until the path is shortened or relaxed [s].
        path: waypoints of that, (k, n) [rad].
    """

    first_time: float
    first_path: Array | None
    time: float
    path: Array | None

    @classmethod
    def none(cls, time: float) -> Found:
        """Return that nothing was found in a time [s]."""
        return cls(time, None, time, None)


class Planner:
    """`plan` of this library, as its users call it."""

    def __init__(self, problem: Problem) -> None:
        self.problem = problem

    def solve(self, budget: float, seed: int) -> Found:
        """Plan. It has no use for a budget [s], as it ends by itself, nor for a seed."""
        arm, start, target, scene = self.problem
        clear: list[tuple[float, Array]] = []

        def note(_: str, elapsed: float, best: JointPath | None) -> None:
            if best is not None and not clear:
                clear.append((process_time() - began, best.configurations))

        began = process_time()
        path = plan(arm.at(start), target, scene, RUN_LIMITS, progress=note)
        took = process_time() - began
        if path.blocked_by:
            return Found.none(took)
        first_time, first_path = clear[0] if clear else (took, path.configurations)
        return Found(first_time, first_path, took, path.configurations)
