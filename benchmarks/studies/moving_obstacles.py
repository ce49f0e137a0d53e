"""A ball crosses the working space of an arm: is the margin kept, and how long does a cycle take?

    python -m benchmarks.studies.moving_obstacles          # 100 draws
    python -m benchmarks.studies.moving_obstacles --speed 0.4 --draws 20 --json
    python -m benchmarks.studies.moving_obstacles --swing 0.15 --noise 0.002   # moving goal, noise

The arm has 20 modules and is 1 m long. Start and goal are random smooth postures; the ball flies straight
through a control point of one of them, but not within 16 cm of the base, where no motion could keep clear.
Margins are judged at every cycle and halfway between, by distances of the ball from the segments between
joints, placed by Pinocchio.
"""

from __future__ import annotations

import argparse
import json
import sys
from time import perf_counter

import numpy as np
import pinocchio as pin
from rich.console import Console
from rich.progress import track as with_progress

import pinposture as pp
from benchmarks.cases.situations import situation_arm

MARGIN, THIN, BALL, DT = 0.005, 0.01, 0.06, 0.01
LIMITS = pp.Limits(step=None, velocity=1.0, acceleration=5.0, dt=DT)
CYCLES, CLEAR_OF_BASE, ARRIVED = 1500, 0.16, 0.02


class Judge:
    """Distance of a ball from the links of an arm."""

    def __init__(self, arm: pp.Arm) -> None:
        self._arm, self._data = arm, arm.model.createData()

    def gap(self, q: np.ndarray, center: np.ndarray) -> float:
        """Return the distance between the surfaces [m]."""
        model = self._arm.model
        pin.forwardKinematics(model, self._data, q)
        nodes = [self._data.oMi[joint].translation for joint in range(1, model.njoints)]
        nodes = np.vstack([nodes, self._arm.chain_at(q).points[-1]])
        ends = np.diff(nodes, axis=0)
        shares = ((center - nodes[:-1]) * ends).sum(axis=1) / np.maximum((ends**2).sum(axis=1), 1e-30)
        nearest = nodes[:-1] + np.clip(shares, 0.0, 1.0)[:, None] * ends
        return float(np.linalg.norm(nearest - center, axis=1).min()) - BALL - THIN


def draw(arm: pp.Arm, judge: Judge, seed: int, speed: float) -> tuple[np.ndarray, ...]:
    """Return start, goal, and where the ball begins and its velocity."""
    rng = np.random.default_rng(seed)
    while True:
        start, goal = (pp.arm.smooth_configuration(arm, rng, 0.8) for _ in range(2))
        aim = arm.chain_at(start if rng.random() < 0.5 else goal).points[rng.integers(8, arm.n_modules)]
        direction = rng.normal(size=3)
        velocity = speed * direction / np.linalg.norm(direction)
        origin = aim - velocity * rng.uniform(1.5, 4.0)
        places = origin + np.arange(CYCLES)[:, None] * DT * velocity
        if np.linalg.norm(places, axis=1).min() > CLEAR_OF_BASE and judge.gap(start, origin) > 0.02:
            return start, goal, origin, velocity


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
    asked = parser.parse_args()
    arm = situation_arm()
    judge, times, lowest, hardest, arrived = Judge(arm), [], [], 0.0, 0
    first = pp.Scene(
        {"ball": pp.Sphere((0, 0, 0), BALL)}, self_collision=False, margin=MARGIN, arm_radius=THIN
    )
    console = Console(stderr=True)
    for seed in with_progress(range(asked.draws), "draws", console=console, transient=True):
        q, goal, origin, velocity = draw(arm, judge, seed, asked.speed)
        tracker = pp.Tracker(arm, limits=LIMITS, scene=first)
        rng, least, before = np.random.default_rng(seed), np.inf, np.zeros(arm.nv)
        for cycle in range(CYCLES):
            center = origin + cycle * DT * velocity
            wanted = goal * (1.0 + asked.swing * np.sin(0.01 * cycle))
            measured = q + rng.normal(0.0, asked.noise, arm.nv)
            began = perf_counter()
            if cycle == 0 or asked.swing:
                tracker.update(pp.Target.from_configuration(arm, wanted))
            moment = first.moved({"ball": center}, velocities={"ball": velocity})
            dq = tracker.step(measured, scene=moment)
            times.append(perf_counter() - began)
            hardest, before = max(hardest, float(np.abs(dq - before).max()) / DT**2), dq
            for share in (0.5, 1.0):
                least = min(least, judge.gap(q + share * dq, center + share * DT * velocity))
            q = tracker.command
        lowest.append(least)
        arrived += bool(np.abs(q - wanted).max() < ARRIVED)
    result = {
        "draws": asked.draws,
        "margin_kept": int(np.sum(np.array(lowest) >= MARGIN - 2e-4)),
        "smallest_distance": float(min(lowest)),
        "arrived": arrived,
        "largest_acceleration": hardest / LIMITS.acceleration,
        "cycle_ms": {f"p{k}": float(1e3 * np.percentile(times, k)) for k in (50, 99, 99.9)},
    }
    if asked.json:
        json.dump(result, sys.stdout, indent=1)
    else:
        half, most, rare = result["cycle_ms"].values()
        print(
            f"margin kept in {result['margin_kept']} of {asked.draws}; "
            f"smallest distance {min(lowest):.4f} m; "
            f"{arrived} arrived; largest acceleration {result['largest_acceleration']:.3g} of the limit; "
            f"a cycle takes {half:.2f} ms (median), {most:.2f} ms (99 %), {rare:.0f} ms (99.9 %)"
        )
    return 0


if __name__ == "__main__":
    sys.exit(main())
