"""What torque limits cost in each cycle, relative to the same cycle without them.

    python -m benchmarks.studies.torque_cost               # 3 pairs of postures, 40 joints
    python -m benchmarks.studies.torque_cost --draws 6 --modules 10 --json

An arm moves between smooth random postures within limits of velocity and acceleration, with and without
limits of 1.3 times the torques that hold it at both ends: by steps of the default controller beside a ball,
by cycles of a `Tracker` beside the ball, and by cycles of one in free space. Each motion is made several
times, in turn with and without; of each cycle the shortest processor time counts. Paths between such postures
are planned as well, among twelve balls and in free space, and count as cycles do.
"""

from __future__ import annotations

import argparse
import json
import sys
from collections.abc import Callable
from dataclasses import replace
from time import process_time_ns
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from pinposture.arm import Arm, smooth_configuration
from pinposture.collision import CollisionModel, Scene, Sphere
from pinposture.control import Geodesic, Limits, plan
from pinposture.control.controller import Memory
from pinposture.motion import Tracker
from pinposture.placement import Target

Array = NDArray[np.float64]

AMPLITUDE = 0.5
"""Amplitude of the postures, in `Arm.joint_units`."""

SPARE = 1.3
"""Torque limit of all joints, relative to the largest torque that holds the arm at an end."""

CYCLES = 60
FIRST = 3
"""Number of cycles of a motion, and the first that counts: those before plan the path."""

REPEATS = 4
"""Number of times that each motion is made."""


class Motion(NamedTuple):
    """A motion of an arm, (nq,) to (nq,), beside a ball."""

    arm: Arm
    start: Array
    goal: Array
    scene: Scene
    limits: Limits


Run = Callable[[Motion], Array]
"""Makes a motion and returns the processor time of each cycle, or of each plan, (c,) [us]."""

PLANS = 15
"""Number of paths that are planned for each motion."""


def held(arm: Arm, *ends: Array) -> float:
    """Return the torque limit of all joints for a motion between configurations [N m]."""
    return SPARE * max(float(np.abs(arm.at(q).gravity_torques).max()) for q in ends)


def draw(modules: int, seed: int) -> tuple[Motion, Motion]:
    """Draw a motion, without and with torque limits."""
    arm = Arm.from_template("RyRz", modules)
    rng = np.random.default_rng(seed)
    start, goal = (smooth_configuration(arm, rng, AMPLITUDE) for _ in range(2))
    middle = arm.at(0.5 * (start + goal)).points[modules // 2]
    aside = 0.08 * arm.length * np.array([0.0, 1.0, 1.0])
    ball = Sphere(tuple((middle + aside).tolist()), 0.03 * arm.length)
    scene = Scene({"ball": ball}, self_collision=False)
    free = Limits(step=None, velocity=2.0, acceleration=10.0, dt=0.01)
    limited = replace(free, effort=held(arm, start, goal))
    return Motion(arm, start, goal, scene, free), Motion(arm, start, goal, scene, limited)


def step(motion: Motion) -> Array:
    """Make a motion by steps of the default controller beside the ball."""
    arm, q, goal, scene, limits = motion
    controller = Geodesic(scene=scene)
    target = Target.from_configuration(arm, goal)
    memory: Memory | None = None
    times = np.empty(CYCLES)
    for cycle in range(CYCLES):
        began = process_time_ns()
        found = controller.step(arm.at(q), target, limits, memory)
        times[cycle] = 1e-3 * (process_time_ns() - began)
        q = arm.integrate(q, found.dq)
        memory = found.memory
    return times


def _track(motion: Motion, scene: Scene | None) -> Array:
    arm, q, goal, _, limits = motion
    tracker = Tracker(arm, limits=limits, scene=scene)
    tracker.update(Target.from_configuration(arm, goal))
    times = np.empty(CYCLES)
    for cycle in range(CYCLES):
        began = process_time_ns()
        dq = tracker.step(q)
        times[cycle] = 1e-3 * (process_time_ns() - began)
        q = arm.integrate(q, dq)
    return times


def track_beside(motion: Motion) -> Array:
    """Make a motion by cycles of a tracker beside the ball."""
    return _track(motion, motion.scene)


def track_free(motion: Motion) -> Array:
    """Make a motion by cycles of a tracker in free space."""
    return _track(motion, None)


def _plan(motion: Motion, balls: int) -> Array:
    arm = motion.arm
    rng = np.random.default_rng(0)
    places = rng.normal(size=(balls, 3))
    places *= arm.length * rng.uniform(0.25, 0.8, (balls, 1)) / np.linalg.norm(places, axis=1, keepdims=True)
    radius = 0.05 * arm.length
    scene = Scene({f"ball {k}": Sphere(tuple(place.tolist()), radius) for k, place in enumerate(places)})
    model = CollisionModel(arm, scene)
    times: list[float] = []
    while len(times) < FIRST + PLANS:
        ends = [smooth_configuration(arm, rng, AMPLITUDE) for _ in range(2)]
        if min(model.minimum(q).distance for q in ends) < scene.margin:
            continue
        effort = None if motion.limits.effort is None else held(arm, *ends)
        limits = replace(motion.limits, effort=effort)
        limits.for_arm(arm)  # kept with the arm, as those that stay the same are
        target = Target.from_configuration(arm, ends[1])
        began = process_time_ns()
        plan(arm.at(ends[0]), target, scene if balls else None, limits)
        times.append(1e-3 * (process_time_ns() - began))
    return np.array(times)


def plan_among_balls(motion: Motion) -> Array:
    """Plan paths of its arm among twelve balls, within its kind of limits."""
    return _plan(motion, 12)


def plan_free(motion: Motion) -> Array:
    """Plan paths of its arm in free space, within its kind of limits."""
    return _plan(motion, 0)


WAYS: dict[str, Run] = {
    "step beside a ball": step,
    "tracker beside a ball": track_beside,
    "tracker in free space": track_free,
    "plan among balls": plan_among_balls,
    "plan in free space": plan_free,
}


def compare(run: Run, without: Motion, limited: Motion) -> tuple[Array, Array]:
    """Return the shortest time of each cycle without and with torque limits [us]."""
    rounds = [(run(without), run(limited)) for _ in range(REPEATS)]
    shortest = np.min(np.array(rounds), axis=0)[:, FIRST:]
    return shortest[0], shortest[1]


def main() -> int:
    """Print the medians and means of all cycles, and their ratios."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--draws", type=int, default=3)
    parser.add_argument("--modules", type=int, default=20)
    parser.add_argument("--json", action="store_true")
    asked = parser.parse_args()
    motions = [draw(asked.modules, seed) for seed in range(asked.draws)]
    told = {}
    for name, run in WAYS.items():
        found = [compare(run, *motion) for motion in motions]
        medians = np.array([[np.median(times) for times in pair] for pair in found])
        means = np.array([[times.mean() for times in pair] for pair in found])
        told[name] = {
            "median_us": float(np.median(medians[:, 0])),
            "median_with_torque_limits_us": float(np.median(medians[:, 1])),
            "ratio_of_medians": float(np.median(medians[:, 1] / medians[:, 0])),
            "ratio_of_means": float(np.median(means[:, 1] / means[:, 0])),
        }
    if asked.json:
        json.dump(told, sys.stdout, indent=1)
        return 0
    print(f"{'':24} {'without':>9} {'with [us]':>10} {'ratio':>6} {'of means':>9}")
    for name, each in told.items():
        before, after, ratio, mean = each.values()
        print(f"{name:24} {before:9.0f} {after:10.0f} {ratio:6.2f} {mean:9.2f}")
    return 0


if __name__ == "__main__":
    sys.exit(main())
