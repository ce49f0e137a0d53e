"""Reaching places in clutter: how often `reach` finds a clear posture, how fast, and how clear it is.

    python -m benchmarks.studies.reach                     # 200 problems, postures
    python -m benchmarks.studies.reach --paths 40 --json   # and paths from the straight arm for 40 of them

Each problem has 30 balls and posts around an arm of 40 joints, 1 m long, and a place for its tip that some
clear posture is known to take. Those postures are drawn at random, and what is clear is judged, by code of
its own: joint placements by Pinocchio, points along the links, and distances from balls and posts.
"""

from __future__ import annotations

import argparse
import json
import sys
from itertools import pairwise
from time import perf_counter
from typing import NamedTuple

import numpy as np
import pinocchio as pin

from pinposture.arm import Arm
from pinposture.collision import Capsule, Scene, Sphere
from pinposture.control.reach import reach
from pinposture.errors import ReachError

OBSTACLES, BALL, POST, ARM_RADIUS, MARGIN = 30, 0.06, 0.025, 0.01, 0.005
"""Number of obstacles, their radii, that of the arm, and the distance to keep [m]."""

SPARE = 0.002
"""By how much more than the margin the known posture is clear [m]."""

BUDGET, ROUNDING = 5.0, 1e-9
"""Time for a problem [s], and by how much less than the margin a clearance may be [m]."""

LINK_SAMPLES = np.linspace(0.0, 1.0, 40)


class Problem(NamedTuple):
    """Lines of balls and posts (k, 2, 3) [m] and their radii (k,) [m], and a place for the tip (3,) [m]."""

    lines: np.ndarray
    radii: np.ndarray
    goal: np.ndarray


def link_points(arm: Arm, data: pin.Data, q: np.ndarray) -> np.ndarray:
    """Places along all links, and the tip last, (n, 3) [m]."""
    pin.framesForwardKinematics(arm.model, data, q)
    joints = [data.oMi[j].translation for j in range(1, arm.model.njoints)]
    stations = np.array([*joints, data.oMf[arm.model.getFrameId(arm.control_points[-1])].translation])
    shares = LINK_SAMPLES[:, None]
    return np.vstack([a + shares * (b - a) for a, b in pairwise(stations)])


def clearance(problem: Problem, points: np.ndarray) -> float:
    """Smallest distance of the arm with its axis through some points from balls and posts [m]."""
    begin, way = problem.lines[:, 0], problem.lines[:, 1] - problem.lines[:, 0]
    squares = np.maximum((way**2).sum(axis=1), 1e-12)
    gaps = points[:, None] - begin
    along = np.clip((gaps * way).sum(axis=2) / squares, 0.0, 1.0)
    distances = np.linalg.norm(gaps - along[:, :, None] * way, axis=2) - problem.radii
    return float(distances.min()) - ARM_RADIUS


def draw(arm: Arm, data: pin.Data, seed: int) -> Problem:
    """Draw balls and posts off the base, and the place of the tip of a clear posture among them."""
    rng = np.random.default_rng(seed)
    while True:
        places = rng.uniform(-0.9, 0.9, (OBSTACLES, 3))
        upright = np.arange(OBSTACLES) % 2 == 1
        away = np.where(upright, np.linalg.norm(places[:, :2], axis=1), np.linalg.norm(places, axis=1))
        if away.min() < 0.12:
            continue
        lines = np.stack([places, places], axis=1)
        lines[upright, 0, 2], lines[upright, 1, 2] = -1.0, 1.0
        problem = Problem(lines, np.where(upright, POST, BALL), np.zeros(3))
        along = np.linspace(0.0, 1.0, arm.nv // 2)
        for _ in range(300):
            q = np.zeros(arm.nv)
            for first in (0, 1):  # joints about y and about z
                waves = [
                    rng.normal() / k * np.sin(np.pi * k * along + rng.uniform(0.0, 2.0 * np.pi))
                    for k in (1, 2, 3, 4)
                ]
                q[first::2] = rng.uniform(0.1, 0.5) * np.sum(waves, axis=0)
            points = link_points(arm, data, q)
            if clearance(problem, points) >= MARGIN + SPARE:
                return problem._replace(goal=points[-1].copy())


def scene_of(problem: Problem) -> Scene:
    """The problem as the library takes it."""
    obstacles = {}
    for k, ((begin, end), radius) in enumerate(zip(problem.lines.tolist(), problem.radii, strict=True)):
        obstacles[f"obstacle_{k}"] = (
            Sphere(begin, float(radius)) if begin == end else Capsule(begin, end, float(radius))
        )
    return Scene(obstacles, self_collision=False, margin=MARGIN, arm_radius=ARM_RADIUS)


def main() -> int:
    """Print what was found; the exit code is 1 if a posture is not at its place or too near something."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--seeds", type=int, default=200)
    parser.add_argument("--paths", type=int, default=0, help="of how many problems the path is looked for")
    parser.add_argument("--json", action="store_true")
    asked = parser.parse_args()
    arm = Arm.from_template("RyRz", 20)
    data = arm.model.createData()
    reach(arm, (0.5, 0.2, 0.3), scene=scene_of(draw(arm, data, 10**6)))  # what is compiled is loaded
    times, smallest, farthest, missed = [], np.inf, 0.0, []
    path_times, clear_paths = [], 0
    for seed in range(asked.seeds):
        problem = draw(arm, data, seed)
        scene = scene_of(problem)
        began = perf_counter()
        try:
            (found,) = reach(arm, problem.goal, scene=scene, budget=BUDGET, seed=seed)
        except ReachError:
            missed.append(seed)
            times.append(perf_counter() - began)
            continue
        times.append(perf_counter() - began)
        points = link_points(arm, data, found.q)
        smallest = min(smallest, clearance(problem, points))
        farthest = max(farthest, float(np.linalg.norm(points[-1] - problem.goal)))
        start = arm.straight()
        if seed < asked.paths and clearance(problem, link_points(arm, data, start)) >= MARGIN:
            began = perf_counter()
            (found,) = reach(arm, problem.goal, scene=scene, start=start, budget=2 * BUDGET, seed=seed)
            path_times.append(perf_counter() - began)
            clear_paths += found.path is not None and not found.path.blocked_by
    told = {
        "problems": asked.seeds,
        "found": asked.seeds - len(missed),
        "missed_seeds": missed,
        "median_s": float(np.median(times)),
        "p99_s": float(np.percentile(times, 99)),
        "longest_s": float(np.max(times)),
        "smallest_clearance_m": smallest,
        "margin_m": MARGIN,
        "farthest_tip_m": farthest,
        "with_path": {
            "problems": len(path_times),
            "clear": clear_paths,
            "median_s": float(np.median(path_times)) if path_times else None,
            "longest_s": float(np.max(path_times)) if path_times else None,
        },
    }
    if asked.json:
        json.dump(told, sys.stdout, indent=1)
    else:
        for name, value in told.items():
            print(f"{name:22} {value}")
    return int(smallest < MARGIN - ROUNDING or farthest > 1e-6 * arm.length)


if __name__ == "__main__":
    sys.exit(main())
