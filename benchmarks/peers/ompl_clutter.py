"""Planning among obstacles: pinposture against RRT-Connect of OMPL, on problems of `cases.clutter`.

    python -m benchmarks.peers.ompl_clutter              # six kinds, 10 problems of each, 10 s for OMPL
    python -m benchmarks.peers.ompl_clutter --kinds hole,shelf --seeds 50 --json

Needs the package `ompl` beside pinposture: `pip install ompl`. Both use the same compiled distances, the same
limits and the same machine, one after the other and with one thread. OMPL's path is simplified by OMPL for up
to two seconds, which do not count; a state counts as valid if it keeps the distance that pinposture keeps.
"""

from __future__ import annotations

import argparse
import json
import sys
from time import perf_counter

import numpy as np
from ompl import base, geometric, util

from benchmarks.cases.clutter import KINDS_OF_CLUTTER, draw_problem
from benchmarks.cases.situations import situation_arm
from benchmarks.harness import Problem
from benchmarks.studies.clutter import RUN_LIMITS, dense_clearance
from pinposture.arm import Arm
from pinposture.collision import CollisionModel
from pinposture.control import plan
from pinposture.motion.run import path_length_ratio

SIMPLIFY, RANGE, RESOLUTION = 2.0, 1.0, 0.05
"""Time to simplify [s], longest edge of the trees, and distance between two states that are checked, as the
norm of the joint positions [rad]."""


def ratio_of(arm: Arm, q: np.ndarray) -> float:
    """Path length ratio of the control points, for configurations (N, nq)."""
    return path_length_ratio(np.array([arm.chain_at(each).points for each in q]))


def by_pinposture(problem: Problem) -> tuple[float, np.ndarray | None]:
    """Time to plan [s] and the path, (N, nq); None if it is not clear."""
    arm, start, target, scene = problem
    began = perf_counter()
    path = plan(arm.at(start), target, scene, RUN_LIMITS)
    return perf_counter() - began, None if path.blocked_by else path.configurations


def by_rrt_connect(problem: Problem, budget: float) -> tuple[float, np.ndarray | None]:
    """Time to plan [s] and the simplified path, (N, nq); None if there is none within the budget [s]."""
    arm, first, target, scene = problem
    model, n = CollisionModel(arm, scene), arm.nv
    space, bounds = base.RealVectorStateSpace(n), base.RealVectorBounds(n)
    for joint in range(n):
        bounds.setLow(joint, float(arm.limits.lower[joint]))
        bounds.setHigh(joint, float(arm.limits.upper[joint]))
    space.setBounds(bounds)
    setup, origin, offset = geometric.SimpleSetup(space), arm.neutral(), np.empty((1, n))

    def keeps_margin(state: base.State) -> bool:
        for joint in range(n):
            offset[0, joint] = state[joint]
        return bool(model.minimum_along(origin, offset).distance >= scene.margin)

    setup.setStateValidityChecker(keeps_margin)
    information = setup.getSpaceInformation()
    information.setStateValidityCheckingResolution(RESOLUTION / space.getMaximumExtent())
    start, goal = space.allocState(), space.allocState()
    for joint in range(n):
        start[joint], goal[joint] = float(first[joint]), float(target.q[joint])
    setup.setStartAndGoalStates(start, goal)
    planner = geometric.RRTConnect(information)
    planner.setRange(RANGE)
    setup.setPlanner(planner)
    began = perf_counter()
    setup.solve(budget)
    took = perf_counter() - began
    if not setup.haveExactSolutionPath():
        return took, None
    setup.simplifySolution(SIMPLIFY)
    path = setup.getSolutionPath()
    path.interpolate(200)
    return took, np.array([[state[joint] for joint in range(n)] for state in path.getStates()])


def main() -> int:
    """Print a line for each kind and planner."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--kinds", default=",".join(KINDS_OF_CLUTTER))
    parser.add_argument("--seeds", type=int, default=10)
    parser.add_argument("--budget", type=float, default=10.0, help="for OMPL [s]")
    parser.add_argument("--json", action="store_true")
    asked = parser.parse_args()
    util.setLogLevel(util.LOG_ERROR)
    arm, rows = situation_arm(), []
    for kind in asked.kinds.split(","):
        for name in ("pinposture", "RRT-Connect"):
            times, ratios, kept = [], [], 0
            for seed in range(asked.seeds):
                problem = draw_problem(arm, kind, seed)
                if name == "pinposture":
                    took, q = by_pinposture(problem)
                else:
                    took, q = by_rrt_connect(problem, asked.budget)
                times.append(took)
                if q is not None:
                    ratios.append(ratio_of(arm, q))
                    kept += dense_clearance(arm, problem.scene, q) >= problem.scene.margin - 1e-3
            rows.append(
                {
                    "kind": kind,
                    "planner": name,
                    "found": len(ratios),
                    "kept_margin": kept,
                    "problems": asked.seeds,
                    "time": [float(np.median(times)), float(np.percentile(times, 90))],
                    "path_length_ratio": float(np.median(ratios)) if ratios else None,
                }
            )
            if not asked.json:
                print(
                    "{kind:10} {planner:12} found {found}, margin kept by {kept_margin} of {problems}, "
                    "{time[0]:.2f} ({time[1]:.2f}) s, paths {path_length_ratio}".format(**rows[-1]),
                    flush=True,
                )
    if asked.json:
        json.dump(rows, sys.stdout, indent=1)
    return 0


if __name__ == "__main__":
    sys.exit(main())
