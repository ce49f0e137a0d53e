"""Balls cross the working space of an arm: is the margin kept, and how long does a cycle take?

    python -m benchmarks.studies.moving_obstacles          # 100 draws
    python -m benchmarks.studies.moving_obstacles --balls 3 --speed 0.4
    python -m benchmarks.studies.moving_obstacles --speed 0.4 --draws 20 --json
    python -m benchmarks.studies.moving_obstacles --swing 0.15 --noise 0.002   # moving goal, noise

The arm has 20 modules and is 1 m long. Start and goal are random smooth postures; each ball flies straight
through a control point of one of them, but not within 16 cm of the base, where no motion could keep clear.
Margins are judged at every cycle and halfway between, by distances of the balls from the segments between
joints, placed by Pinocchio. Draws that lose the margin or do not arrive are listed: the smallest distance,
when, how far along the arm, how many balls were within 5 cm of the arm then, and how the tracker ended. A
draw ends when the arm has arrived and the balls have left.
"""

from __future__ import annotations

import argparse
import json
import sys
from time import perf_counter
from typing import Any, NamedTuple

import numpy as np
import pinocchio as pin
from rich.console import Console
from rich.progress import track as with_progress

import pinposture as pp
from benchmarks.cases.situations import situation_arm

MARGIN, THIN, BALL, DT = 0.005, 0.01, 0.06, 0.01
LIMITS = pp.Limits(step=None, velocity=1.0, acceleration=5.0, dt=DT)
CYCLES, CLEAR_OF_BASE, ARRIVED = 1500, 0.16, 0.02
NEARBY, GONE = 0.05, 1.3
"""Distance from the arm at which a ball counts as near, and from the base at which it has left [m]."""


class Judge:
    """Distance of a ball from the links of an arm."""

    def __init__(self, arm: pp.Arm) -> None:
        self._arm, self._data = arm, arm.model.createData()

    def gap(self, q: np.ndarray, center: np.ndarray) -> float:
        """Return the distance between the surfaces [m]."""
        return self.nearest(q, center)[0]

    def nearest(self, q: np.ndarray, center: np.ndarray) -> tuple[float, float]:
        """Return the distance between the surfaces, and how far along the arm it is [m]."""
        model = self._arm.model
        pin.forwardKinematics(model, self._data, q)
        nodes = [self._data.oMi[joint].translation for joint in range(1, model.njoints)]
        nodes = np.vstack([nodes, self._arm.chain_at(q).points[-1]])
        ends = np.diff(nodes, axis=0)
        shares = ((center - nodes[:-1]) * ends).sum(axis=1) / np.maximum((ends**2).sum(axis=1), 1e-30)
        nearest = nodes[:-1] + np.clip(shares, 0.0, 1.0)[:, None] * ends
        apart = np.linalg.norm(nearest - center, axis=1)
        link = int(apart.argmin())
        lengths = np.linalg.norm(ends, axis=1)
        along = lengths[:link].sum() + np.clip(shares[link], 0.0, 1.0) * lengths[link]
        return float(apart[link]) - BALL - THIN, float(along)


class Draw(NamedTuple):
    """Start and goal, (nq,), and where the balls begin and their velocities, (b, 3)."""

    start: np.ndarray
    goal: np.ndarray
    origins: np.ndarray
    velocities: np.ndarray


def draw(arm: pp.Arm, judge: Judge, seed: int, speed: float, balls: int = 1) -> Draw:
    """Return a draw; its first ball is the same whatever their number."""
    rng = np.random.default_rng(seed)
    while True:
        start, goal = (pp.arm.smooth_configuration(arm, rng, 0.8) for _ in range(2))
        first = _ball(arm, judge, rng, start, goal, speed)
        if first is not None:
            break
    flights = [first]
    while len(flights) < balls:
        another = _ball(arm, judge, rng, start, goal, speed)
        if another is not None:
            flights.append(another)
    origins, velocities = zip(*flights, strict=True)
    return Draw(start, goal, np.array(origins), np.array(velocities))


def _ball(
    arm: pp.Arm,
    judge: Judge,
    rng: np.random.Generator,
    start: np.ndarray,
    goal: np.ndarray,
    speed: float,
) -> tuple[np.ndarray, np.ndarray] | None:
    """Return where a ball begins and its velocity; None if it comes too near to the base or the start."""
    aim = arm.chain_at(start if rng.random() < 0.5 else goal).points[rng.integers(8, arm.n_modules)]
    direction = rng.normal(size=3)
    velocity = speed * direction / np.linalg.norm(direction)
    origin = aim - velocity * rng.uniform(1.5, 4.0)
    centers = origin + np.arange(CYCLES)[:, None] * DT * velocity
    clear = np.linalg.norm(centers, axis=1).min() > CLEAR_OF_BASE and judge.gap(start, origin) > 0.02
    return (origin, velocity) if clear else None


class Outcome(NamedTuple):
    """How a draw went.

    Attributes:
        seed: the seed.
        lowest: smallest distance from a ball [m].
        time: when [s].
        along: how far along the arm [m].
        near: number of balls within `NEARBY` of the arm then.
        arrived: whether the arm is at its goal in the end.
        status: of the tracker, then.
        acceleration: largest acceleration, relative to the limit.
    """

    seed: int
    lowest: float
    time: float
    along: float
    near: int
    arrived: bool
    status: str
    acceleration: float

    @property
    def kept(self) -> bool:
        """Whether the margin was kept, up to its tolerance."""
        return self.lowest >= MARGIN - 2e-4


def fly(arm: pp.Arm, judge: Judge, seed: int, asked: argparse.Namespace, times: list[float]) -> Outcome:
    """Run a draw, and add the times of its cycles [s]."""
    q, goal, origins, velocities = draw(arm, judge, seed, asked.speed, asked.balls)
    names = [f"ball {k + 1}" for k in range(asked.balls)]
    first = pp.Scene(
        {name: pp.Sphere((0, 0, 0), BALL) for name in names},
        self_collision=False,
        margin=MARGIN,
        arm_radius=THIN,
    )
    known = dict(zip(names, velocities, strict=True))
    tracker = pp.Tracker(arm, limits=LIMITS, scene=first)
    rng = np.random.default_rng(seed)
    before = np.zeros(arm.nv)
    hardest = 0.0
    nearest = Outcome(seed, np.inf, 0.0, 0.0, 0, False, "", 0.0)
    target = goal
    for cycle in range(CYCLES):
        centers = origins + cycle * DT * velocities
        target = goal * (1.0 + asked.swing * np.sin(0.01 * cycle))
        measured = q + rng.normal(0.0, asked.noise, arm.nv)
        began = perf_counter()
        if cycle == 0 or asked.swing:
            tracker.update(pp.Target.from_configuration(arm, target))
        scene = first.moved(dict(zip(names, centers, strict=True)), velocities=known)
        dq = tracker.step(measured, scene=scene)
        times.append(perf_counter() - began)
        hardest = max(hardest, float(np.abs(dq - before).max()) / DT**2)
        before = dq
        for share in (0.5, 1.0):
            reached = q + share * dq
            found = [judge.nearest(reached, center) for center in centers + share * DT * velocities]
            lowest, along = min(found)
            if lowest < nearest.lowest:
                near = sum(gap < NEARBY for gap, _ in found)
                time = (cycle + share) * DT
                nearest = nearest._replace(lowest=lowest, time=time, along=along, near=near)
        q = tracker.command
        gone = (np.linalg.norm(centers, axis=1) > GONE) & ((centers * velocities).sum(axis=1) > 0.0)
        if not asked.swing and gone.all() and np.abs(q - target).max() < 0.1 * ARRIVED:
            break
    arrived = bool(np.abs(q - target).max() < ARRIVED)
    status = str(getattr(getattr(tracker, "report", None), "status", ""))
    return nearest._replace(arrived=arrived, status=status, acceleration=hardest / LIMITS.acceleration)


def main() -> int:
    """Run all draws; print how many kept the margin and arrived, and the time of a cycle."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--draws", type=int, default=100)
    parser.add_argument("--speed", type=float, default=0.2, help="of the ball [m/s]")
    parser.add_argument("--swing", type=float, default=0.0, help="of the goal, relative to its joint angles")
    parser.add_argument(
        "--noise", type=float, default=0.0, help="of measured joint angles, standard deviation [rad]"
    )
    parser.add_argument("--json", action="store_true")
    parser.add_argument("--balls", type=int, default=1, help="their number")
    parser.add_argument("--first", type=int, default=0, help="seed of the first draw")
    asked = parser.parse_args()
    arm = situation_arm()
    judge = Judge(arm)
    times: list[float] = []
    console = Console(stderr=True)
    seeds = range(asked.first, asked.first + asked.draws)
    outcomes = [
        fly(arm, judge, seed, asked, times)
        for seed in with_progress(seeds, "draws", console=console, transient=True)
    ]
    missed = [outcome for outcome in outcomes if not (outcome.kept and outcome.arrived)]
    lowest = min(outcome.lowest for outcome in outcomes)
    result: dict[str, Any] = {
        "draws": asked.draws,
        "margin_kept": sum(outcome.kept for outcome in outcomes),
        "smallest_distance": lowest,
        "arrived": sum(outcome.arrived for outcome in outcomes),
        "largest_acceleration": max(outcome.acceleration for outcome in outcomes),
        "cycle_ms": {f"p{k}": float(1e3 * np.percentile(times, k)) for k in (50, 99, 99.9)},
        "missed": [outcome._asdict() for outcome in missed],
    }
    if asked.json:
        json.dump(result, sys.stdout, indent=1)
    else:
        half, most, rare = result["cycle_ms"].values()
        print(
            f"margin kept in {result['margin_kept']} of {asked.draws}; "
            f"smallest distance {lowest:.4f} m; "
            f"{result['arrived']} arrived; "
            f"largest acceleration {result['largest_acceleration']:.3g} of the limit; "
            f"a cycle takes {half:.2f} ms (median), {most:.2f} ms (99 %), {rare:.0f} ms (99.9 %)"
        )
        for outcome in missed:
            print(
                f"draw {outcome.seed}: {1e3 * outcome.lowest:.1f} mm at {outcome.time:.2f} s, "
                f"{outcome.along:.2f} m along the arm, {outcome.near} near; "
                f"{'arrived' if outcome.arrived else 'did not arrive'}; {outcome.status}"
            )
    return 0


if __name__ == "__main__":
    sys.exit(main())
