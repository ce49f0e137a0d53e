"""Arms, limits and targets for runs of the controller, and what every step of a run has to keep."""

from __future__ import annotations

from functools import cache
from itertools import pairwise
from typing import NamedTuple

import numpy as np
import pinocchio as pin

import pinposture as pp

SLIDE = pp.JointSpec("x", type="prismatic", lower=-0.04, upper=0.05)
SLIDING = pp.ModuleTemplate(
    "slides", (pp.JointSpec("y"), SLIDE, pp.JointSpec("z", type="continuous")), (0.03,) * 3
)
ARMS = {
    "planar": lambda: pp.Arm.from_template("Rz", 7),
    "short": lambda: pp.Arm.from_modules([pp.template("Rz").with_limits(-1.5, 1.5)] * 3),
    "spatial": lambda: pp.Arm.from_modules([pp.template("RyRz").with_limits(-0.8, 0.6)] * 4),
    "sliding": lambda: pp.Arm.from_modules([SLIDING] * 3),
}
KINDS = ("known", "points", "far", "region", "tip")
ALLOWED = 1e-9


@cache
def arm_called(name: str) -> pp.Arm:
    return ARMS[name]()


class Case(NamedTuple):
    """An arm with a start, a target and limits."""

    arm: pp.Arm
    start: np.ndarray
    target: pp.Target
    limits: pp.Limits

    def track(self, **options: object) -> pp.Run:
        return pp.track(self.arm, self.target, self.start, limits=self.limits, **options)


def within(arm: pp.Arm, limits: pp.Limits, rng: np.random.Generator, amplitude: float = 1.0) -> np.ndarray:
    """A configuration inside the limits; of an arm without, within half a turn."""
    position_limits = limits.for_arm(arm).position_limits
    wide = np.pi * arm.joint_units
    lower = np.maximum(position_limits[0], -wide)
    upper = np.minimum(position_limits[1], wide)
    return arm.configuration(amplitude * rng.uniform(lower, upper))


def drawn_limits(rng: np.random.Generator) -> pp.Limits:
    step = [None, 0.02, 0.1, 0.5][rng.integers(4)]
    dt = float(rng.choice([0.02, 0.05, 0.1]))
    velocity = float(rng.choice([0.5, 2.0])) if rng.random() < 0.5 else None
    acceleration = float(rng.choice([1.0, 5.0, 20.0])) if rng.random() < 0.6 else None
    margin = float(rng.choice([0.0, 0.01]))
    return pp.Limits(step, velocity, dt, margin, acceleration)


def target_of(arm: pp.Arm, goal: np.ndarray, kind: str, rng: np.random.Generator) -> pp.Target:
    known = pp.Target.from_configuration(arm, goal)
    m = arm.n_modules
    if kind == "known":
        return known
    points = known.points
    if kind == "far":
        points = 2.0 * points + 0.2 * arm.length * rng.normal(size=(m, arm.dimension)) @ arm.plane
    target = pp.Target.from_points(arm, points)
    if kind == "region":
        first = int(rng.integers(m))
        return target.region(first, int(rng.integers(first, m)))
    return target.region(m - 1, m - 1) if kind == "tip" else target


def drawn(seed: int, name: str, kind: str, limits: pp.Limits | None = None) -> Case:
    rng = np.random.default_rng(seed)
    arm = arm_called(name)
    limits = drawn_limits(rng) if limits is None else limits
    start, goal = (within(arm, limits, rng) for _ in range(2))
    return Case(arm, start, target_of(arm, goal, kind, rng), limits)


def steps_of(arm: pp.Arm, q: np.ndarray) -> np.ndarray:
    """Displacements between configurations, (N - 1, nv)."""
    moved = [pin.difference(arm.model, a, b) for a, b in pairwise(q)]
    return np.array(moved).reshape(-1, arm.nv)


def check_limits(arm: pp.Arm, limits: pp.Limits, q: np.ndarray, before: np.ndarray | None = None) -> None:
    """Every configuration within its limits, every step within those of speed and acceleration."""
    assert np.all(np.isfinite(q))
    positions = np.array([arm.positions(each) for each in q])
    moved = np.array(arm.moved > 0.0)
    lower = arm.limits.lower + limits.position_margin
    upper = arm.limits.upper - limits.position_margin
    assert np.all((positions >= lower - ALLOWED)[:, moved])
    assert np.all((positions <= upper + ALLOWED)[:, moved])
    steps = steps_of(arm, q)
    if limits.step is not None:
        assert np.all(np.abs(steps) <= limits.step + ALLOWED)
    if limits.dt is not None:
        speed = arm.limits.velocity if limits.velocity is None else limits.velocity
        assert np.all(np.abs(steps) <= speed * limits.dt + ALLOWED)
    if limits.acceleration is not None:
        first = np.zeros(arm.nv) if before is None else before
        change = np.diff(np.vstack([first, steps]), axis=0)
        assert np.all(np.abs(change) <= limits.acceleration * limits.dt**2 + ALLOWED)
