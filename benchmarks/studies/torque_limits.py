"""How far torques exceed their limits in steps that leave the timing of a path.

    python -m benchmarks.studies.torque_limits              # 525 runs, some ten minutes
    python -m benchmarks.studies.torque_limits --runs 10    # of each kind

Each run is a `Tracker` in cycles of 10 ms with an arm of 3 to 10 modules on the floor, on a wall or under a
ceiling, with a payload of up to 0.1 kg. Its torque limit is 1.05 to 1.5 times what holds the arm at its start
and its targets. What disturbs the motion differs:

* jumps: the target jumps every 0.2 to 0.6 s.
* moves on: the target moves on in every cycle.
* brakes: measurements are missing for a while.
* evades: a ball moves through the goal of the arm.
* holds: a ball moves through the arm while it has no target; it gets one after 2 s.
* returns: joints start outside their position limits.
* smooth: as "jumps", with a limit of jerk.

A torque is that of the mean speed and the acceleration of two steps where they meet, by `pin.rnea`, which the
library does not use. A run ends after 3 s, or later, when the arm arrives at its last target; it has 15 s for
that. Whether the ball touches it is for the collision model to say.
"""

from __future__ import annotations

import argparse
from typing import NamedTuple

import numpy as np
import pinocchio as pin
from numpy.typing import NDArray

import pinposture as pp
from pinposture.arm import smooth_configuration
from pinposture.collision import CollisionModel

Array = NDArray[np.float64]

DT = 0.01
CYCLES = 300
MOST_CYCLES = 1500
"""Number of cycles of a run, and the most that an arm has to arrive."""

ARRIVED = 1e-3
"""Mean distance from the last target at which an arm has arrived, relative to that at the start."""

KINDS = ("jumps", "moves on", "brakes", "evades")
FURTHER = ("holds", "returns", "smooth")
BALLS = {"evades", "holds"}
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
        clearance: smallest distance from the ball [m]; infinite without one.
    """

    kind: str
    acceleration: float | None
    share: float
    cycles: int
    named: int
    error: float
    clearance: float = np.inf


def shares(arm: pp.Arm, effort: float, q: list[Array], steps: list[Array]) -> Array:
    """Return the largest torque where two steps meet, relative to the limit, at each configuration."""
    data = arm.model.createData()
    rows = zip(q, [np.zeros(arm.nv), *steps[:-1]], steps, strict=True)
    torques = [
        pin.rnea(arm.model, data, at, (before + after) / (2.0 * DT), (after - before) / DT**2)
        for at, before, after in rows
    ]
    return np.asarray(np.abs(torques).max(axis=1) / effort)


class Disturbance(NamedTuple):
    """What an arm is to do in a run, and what disturbs it; `every` and `away` are numbers of cycles."""

    arm: pp.Arm
    effort: float
    acceleration: float | None
    limits: pp.Limits
    start: Array
    goals: list[Array]
    scene: pp.Scene | None
    every: int
    away: int


def disturb(kind: str, seed: int) -> Disturbance:
    """Draw an arm and a disturbance."""
    rng = np.random.default_rng(seed)
    turned = pin.rpy.rpyToMatrix(0.0, float(rng.choice([0.0, -np.pi / 2, np.pi])), 0.0)
    arm = pp.Arm.from_template("RyRz", int(rng.integers(3, 11)), base_placement=pin.SE3(turned, np.zeros(3)))
    arm = arm.with_payload(float(rng.uniform(0.0, 0.1)))
    start, *goals = (smooth_configuration(arm, rng, 0.7) for _ in range(8))
    goals = goals if kind in ("jumps", "smooth") else goals[:1]
    margin = 0.0
    if kind == "returns":
        widest = max(np.abs(start).max(), np.abs(goals[0]).max())
        margin = float(arm.limits.upper[0] - widest)
        moved = np.random.default_rng([seed, 1])
        outside = moved.choice(arm.nv, 2, replace=False)
        start[outside] = moved.choice([-1.0, 1.0], 2) * (widest + moved.uniform(0.02, 0.4, 2))
    held = np.abs([arm.at(q).gravity_torques for q in (start, *goals)]).max()
    effort = float(held * rng.uniform(1.05, 1.5))
    acceleration = ACCELERATIONS[int(rng.integers(3))]
    jerk = None
    if kind == "smooth":
        acceleration = 20.0 if acceleration is None else acceleration
        jerk = 30.0 * acceleration
    limits = pp.Limits(
        step=None,
        velocity=2.0,
        acceleration=acceleration,
        jerk=jerk,
        dt=DT,
        position_margin=margin,
        effort=effort,
    )
    scene = None
    if kind in BALLS:
        middle = arm.at(start if kind == "holds" else goals[0]).points[arm.n_modules // 2]
        far = middle + np.array([0.0, 0.3, 0.0])
        scene = pp.Scene({"ball": pp.Sphere(tuple(far), 0.02)}, self_collision=False)
        scene = scene.moved({"ball": pin.SE3.Identity()}, velocities={"ball": (0.0, -0.15, 0.0)})
    every = int(rng.integers(20, 60))
    away = int(rng.integers(15, 50))
    return Disturbance(arm, effort, acceleration, limits, start, goals, scene, every, away)


def next_target(kind: str, given: Disturbance, cycle: int) -> Array | None:
    """Return the configuration of the target that is new in a cycle; None if there is none."""
    if kind in ("jumps", "smooth"):
        jump, since = divmod(cycle, given.every)
        return given.goals[jump] if since == 0 and jump < len(given.goals) else None
    if kind == "moves on":
        share = min(cycle / given.away / 3.0, 1.0)
        way = given.arm.difference(given.start, given.goals[0])
        return given.arm.integrate(given.start, share * way)
    return given.goals[-1] if cycle == (200 if kind == "holds" else 0) else None


def run(seed: int, kind: str | None = None) -> Excess:
    """Make one run, of one of `KINDS` in turn if none is given."""
    kind = KINDS[seed % len(KINDS)] if kind is None else kind
    given = disturb(kind, seed)
    arm = given.arm
    tracker = pp.Tracker(arm, limits=given.limits, scene=given.scene)
    q = given.start
    rows, steps = [], []
    named = 0
    clearance = np.inf
    error = np.inf
    for cycle in range(MOST_CYCLES):
        if cycle >= CYCLES and error < ARRIVED:
            break
        goal = next_target(kind, given, cycle)
        if goal is not None:
            tracker.update(pp.Target.from_configuration(arm, goal))
        missing = kind == "brakes" and given.away <= cycle < given.away + 40
        step = tracker.step(None if missing else q)
        rows.append(q)
        steps.append(step)
        named += any("torque limit: " in words for words in tracker.report.violated_constraints)
        q = arm.integrate(q, step)
        if given.scene is not None:
            ball = given.scene.after((cycle + 1) * DT)
            clearance = min(clearance, CollisionModel(arm, ball).minimum(q).distance)
        target = tracker.target
        if target is not None and cycle + 1 >= CYCLES:
            begun = target.mean_distance(arm.at(given.start).points)
            error = target.mean_distance(arm.at(q).points) / max(begun, 1e-9)
    found = shares(arm, given.effort, rows, steps)
    cycles = int(np.sum(found > 1.0 + 1e-6))
    return Excess(kind, given.acceleration, float(found.max()), cycles, named, error, clearance)


def main() -> None:
    """Print a table with a row for each kind of disturbance."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--runs", type=int, default=75, help="runs of each kind")
    given = parser.parse_args()
    found = [run(seed) for seed in range(len(KINDS) * given.runs)]
    found += [run(seed, kind) for kind in FURTHER for seed in range(given.runs)]
    columns = (
        "disturbed by",
        "within limits",
        "cycles beyond",
        "90th percentile",
        "most",
        "named",
        "arrived",
    )
    print(f"| {' | '.join(columns)} | touched |")
    print("|---" * 8 + "|")
    for kind in (*KINDS, *FURTHER, "all"):
        chosen = [each for each in found if kind in ("all", each.kind)]
        largest = np.array([each.share for each in chosen])
        kept = f"{np.sum(largest <= 1.0 + 1e-6)} of {len(chosen)}"
        beyond = sum(each.cycles for each in chosen)
        named = sum(each.named for each in chosen)
        arrived = sum(each.error < ARRIVED for each in chosen)
        touched = sum(each.clearance < 0.0 for each in chosen)
        most = f"{np.quantile(largest, 0.9):.3f} | {largest.max():.3f}"
        print(f"| {kind} | {kept} | {beyond} | {most} | {named} | {arrived} | {touched} |")


if __name__ == "__main__":
    main()
