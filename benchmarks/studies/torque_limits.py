"""How far torques exceed their limits in steps that leave the timing of a path.

    python -m benchmarks.studies.torque_limits              # 300 runs, some five minutes
    python -m benchmarks.studies.torque_limits --runs 40

Each run is a `Tracker` in cycles of 10 ms with an arm of 3 to 10 modules on the floor, on a wall or under a
ceiling, with a payload of up to 0.1 kg. Its torque limit is 1.05 to 1.5 times what holds the arm at its start
and its targets. What disturbs the motion differs: the target jumps every 0.2 to 0.6 s, moves on in every
cycle, is missing for a while so that the arm brakes, or a ball moves through the arm. A torque is that of the
mean speed and the acceleration of two steps where they meet, by `pin.rnea`, which the library does not use.
"""

from __future__ import annotations

import argparse
from typing import NamedTuple

import numpy as np
import pinocchio as pin
from numpy.typing import NDArray

import pinposture as pp
from pinposture.arm import smooth_configuration

Array = NDArray[np.float64]

DT = 0.01
CYCLES = 300
KINDS = ("jumps", "moves on", "brakes", "evades")
ACCELERATIONS = (None, 10.0, 30.0)


class Excess(NamedTuple):
    """A run, judged.

    Attributes:
        kind: what disturbed it.
        acceleration: limit of acceleration [rad/s^2]; None: no limit.
        share: largest torque relative to its limit.
        cycles: number of cycles in which a torque exceeded its limit.
        named: number of cycles in which the report names the torque limit.
        error: mean distance from the last target at the end, relative to that at the start.
    """

    kind: str
    acceleration: float | None
    share: float
    cycles: int
    named: int
    error: float


def shares(arm: pp.Arm, effort: float, q: list[Array], steps: list[Array]) -> Array:
    """Return the largest torque where two steps meet, relative to the limit, at each configuration."""
    data = arm.model.createData()
    rows = zip(q, [np.zeros(arm.nv), *steps[:-1]], steps, strict=True)
    torques = [
        pin.rnea(arm.model, data, at, (before + after) / (2.0 * DT), (after - before) / DT**2)
        for at, before, after in rows
    ]
    return np.asarray(np.abs(torques).max(axis=1) / effort)


def run(seed: int) -> Excess:
    """Make one run."""
    rng = np.random.default_rng(seed)
    kind = KINDS[seed % len(KINDS)]
    turned = pin.rpy.rpyToMatrix(0.0, float(rng.choice([0.0, -np.pi / 2, np.pi])), 0.0)
    arm = pp.Arm.from_template("RyRz", int(rng.integers(3, 11)), base_placement=pin.SE3(turned, np.zeros(3)))
    arm = arm.with_payload(float(rng.uniform(0.0, 0.1)))
    start, *goals = (smooth_configuration(arm, rng, 0.7) for _ in range(8))
    goals = goals if kind == "jumps" else goals[:1]
    held = np.abs([arm.at(q).gravity_torques for q in (start, *goals)]).max()
    effort = float(held * rng.uniform(1.05, 1.5))
    acceleration = ACCELERATIONS[int(rng.integers(3))]
    limits = pp.Limits(step=None, velocity=2.0, acceleration=acceleration, dt=DT, effort=effort)
    scene = pp.Scene(self_collision=False)
    if kind == "evades":
        middle = arm.at(goals[0]).points[arm.n_modules // 2]
        far = middle + np.array([0.0, 0.3, 0.0])
        scene = pp.Scene({"ball": pp.Sphere(tuple(far), 0.02)}, self_collision=False)
        scene = scene.moved({"ball": pin.SE3.Identity()}, velocities={"ball": (0.0, -0.15, 0.0)})
    tracker = pp.Tracker(arm, limits=limits, scene=scene if kind == "evades" else None)
    q = start
    rows, steps = [], []
    named = 0
    jump = 0
    every = int(rng.integers(20, 60))
    away = int(rng.integers(15, 50))
    for cycle in range(CYCLES):
        if kind == "jumps" and cycle % every == 0 and jump < len(goals):
            tracker.update(pp.Target.from_configuration(arm, goals[jump]))
            jump += 1
        elif kind == "moves on":
            share = min(cycle / away / 3.0, 1.0)
            shifted = arm.integrate(start, share * arm.difference(start, goals[0]))
            tracker.update(pp.Target.from_configuration(arm, shifted))
        elif cycle == 0:
            tracker.update(pp.Target.from_configuration(arm, goals[-1]))
        missing = kind == "brakes" and away <= cycle < away + 40
        step = tracker.step(None if missing else q)
        rows.append(q)
        steps.append(step)
        named += any("torque limit: " in words for words in tracker.report.violated_constraints)
        q = arm.integrate(q, step)
    found = shares(arm, effort, rows, steps)
    target = tracker.target
    assert target is not None
    error = target.mean_distance(arm.at(q).points) / max(target.mean_distance(arm.at(start).points), 1e-9)
    cycles = int(np.sum(found > 1.0 + 1e-6))
    return Excess(kind, acceleration, float(found.max()), cycles, named, error)


def main() -> None:
    """Print a table with a row for each kind of disturbance."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--runs", type=int, default=300)
    given = parser.parse_args()
    found = [run(seed) for seed in range(given.runs)]
    print("| disturbed by | within limits | cycles beyond | 90th percentile | most | named | arrived |")
    print("|---" * 7 + "|")
    for kind in (*KINDS, "all"):
        chosen = [each for each in found if kind in ("all", each.kind)]
        largest = np.array([each.share for each in chosen])
        kept = f"{np.sum(largest <= 1.0 + 1e-6)} of {len(chosen)}"
        beyond = sum(each.cycles for each in chosen)
        named = sum(each.named for each in chosen)
        arrived = sum(each.error < 1e-3 for each in chosen)
        most = f"{np.quantile(largest, 0.9):.3f} | {largest.max():.3f}"
        print(f"| {kind} | {kept} | {beyond} | {most} | {named} | {arrived} |")


if __name__ == "__main__":
    main()
