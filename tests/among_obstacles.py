"""Random arms among random obstacles, and what the output of every motion has to keep."""

from __future__ import annotations

from functools import cache
from itertools import pairwise
from typing import NamedTuple

import numpy as np
import pinocchio as pin

import pinposture as pp
from pinposture.arm import smooth_configuration

ALLOWED = 1e-9

ENDLESS = pp.ModuleTemplate(
    "endless", (pp.JointSpec("z", type="continuous"), pp.JointSpec("y")), (0.05, 0.05)
)
ARMS = (
    lambda: pp.Arm.from_template("RyRz", 5),
    lambda: pp.Arm.from_template("Rz", 7),
    lambda: pp.Arm.from_modules([pp.template("RyRz").with_limits(-1.5, 1.2)] * 4),
    lambda: pp.Arm.from_modules([pp.template("Rz").with_limits(-1.2, 1.5)] * 5),
    lambda: pp.Arm.from_modules([ENDLESS] * 3),
)


@cache
def arm_number(number: int) -> pp.Arm:
    return ARMS[number]()


class PathProgress(NamedTuple):
    """An arm, what is in its way, its limits, and configurations that keep the margin."""

    arm: pp.Arm
    scene: pp.Scene
    limits: pp.Limits
    stops: list[np.ndarray]

    @property
    def goal(self) -> pp.Target:
        return pp.Target.from_configuration(self.arm, self.stops[-1])


def drawn_course(seed: int, stops: int = 2) -> PathProgress:
    rng = np.random.default_rng(seed)
    while True:
        arm = arm_number(int(rng.integers(len(ARMS))))
        scene = drawn_scene(arm, rng)
        limits = pp.Limits(
            step=float(rng.choice([0.05, 0.1, 0.2])),
            velocity=float(rng.choice([0.5, 1.0, 3.0])),
            dt=float(rng.choice([0.02, 0.05, 0.1])),
            acceleration=float(rng.choice([0.5, 2.0, 8.0])),
        )
        around = pp.CollisionModel(arm, scene)
        found = []
        for _ in range(10 * stops):
            q = drawn_configuration(arm, rng)
            if around.minimum(q).distance > 1.01 * scene.margin and len(found) < stops:
                found.append(q)
        if len(found) == stops:
            return PathProgress(arm, scene, limits, found)


def drawn_configuration(arm: pp.Arm, rng: np.random.Generator) -> np.ndarray:
    lower = np.maximum(arm.limits.lower, -np.pi)
    upper = np.minimum(arm.limits.upper, np.pi)
    share = rng.uniform(0.3, 0.9)
    if rng.random() < 0.7:
        positions = arm.positions(smooth_configuration(arm, rng, share))
    else:
        positions = share * rng.uniform(lower, upper)
    return arm.configuration(np.clip(positions, lower, upper))


def drawn_scene(arm: pp.Arm, rng: np.random.Generator) -> pp.Scene:
    """One to five balls, boxes and posts within reach."""
    obstacles: dict[str, pp.Obstacle] = {}
    plane = np.array(arm.plane)
    length = arm.length
    for k in range(int(rng.integers(1, 6))):
        away = rng.normal(size=len(plane)) @ plane
        center = np.array(arm.chain.base) + rng.uniform(0.3, 1.0) * length * away / np.linalg.norm(away)
        kind = rng.integers(3)
        if kind == 0:
            obstacles[f"ball {k}"] = pp.Sphere(center, length * rng.uniform(0.03, 0.15))
        elif kind == 1:
            obstacles[f"box {k}"] = pp.Box(center, tuple(length * rng.uniform(0.04, 0.25, 3)))
        else:
            along = np.cross(*plane) if len(plane) == 2 else rng.normal(size=3)
            along = length * along / np.linalg.norm(along)
            radius = length * rng.uniform(0.02, 0.08)
            obstacles[f"post {k}"] = pp.Cylinder(center - along, center + along, radius)
    margin = length * float(rng.choice([0.003, 0.01, 0.02]))
    return pp.Scene(obstacles, self_collision=bool(rng.random() < 0.3), margin=margin)


def accelerations(arm: pp.Arm, q: np.ndarray, limits: pp.Limits) -> np.ndarray:
    """How hard joints accelerate at each configuration, from and to rest, 1 being the limit, (steps + 1,)."""
    steps = [pin.difference(arm.model, a, b) for a, b in pairwise(q)]
    rest = np.zeros((1, arm.nv))
    changes = np.diff(np.concatenate([rest, np.reshape(steps, (-1, arm.nv)), rest]), axis=0)
    return np.asarray(np.abs(changes / (limits.acceleration * limits.dt**2)).max(axis=1))


def check_output(run: pp.Run) -> None:
    """No step exceeds the limit of acceleration unless it is named; no more does the stop at the end."""
    over = accelerations(run.arm, run.q, run.limits) > 1.0 + ALLOWED
    exceeding = over[:-1]
    exceeding[-1:] |= over[-1]
    assert np.all(run.violated_constraints[exceeding] != "")
    assert (run.excess is None) == (not exceeding.any())
    steps = np.abs([pin.difference(run.arm.model, a, b) for a, b in pairwise(run.q)])
    assert np.all(steps <= min(run.limits.step, run.limits.velocity * run.limits.dt) * (1.0 + ALLOWED))
