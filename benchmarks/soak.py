"""A control loop that runs for long, while everything goes wrong that does in a laboratory.

    python benchmarks/soak.py --steps 100000

Targets jump at random, among them straight and folded ones and ones out of reach, or arrive late; cycles are
late; measurements are missing, not finite, or wrong by radians; now and then somebody pushes the arm. Drives
lag behind and sag. Every output is checked: finite, within the limits of speed, acceleration and position.
"""

from __future__ import annotations

import argparse
import gc
import json
import resource
import sys
import time
from collections import Counter

import numpy as np

import pinposture as pp
from pinposture.arm import smooth_configuration
from pinposture.motion import Tracker

DT, LAG, SAG = 0.01, 0.05, 0.02
SPEED, ACCELERATION = 2.0, 10.0
OVERRUN = 5e-3  # time of a cycle that is counted, if there is no deadline [s]


def targets(arm: pp.Arm, rng: np.random.Generator, count: int) -> list[pp.Target]:
    """Postures to jump between: smooth, harsh, straight, folded, bare points, and out of reach."""
    made = []
    for k in range(count):
        q = smooth_configuration(arm, rng, rng.uniform(0.1, 1.0))
        if k % 6 == 1:
            q = arm.straight()
        elif k % 6 == 2:
            q = rng.uniform(-1.5, 1.5, arm.nv)
        elif k % 6 == 3:  # folded back upon itself
            q = arm.straight()
            q[arm.nv // 2] = np.pi - 1e-3
        points = arm.at(q).points
        if k % 6 == 4:
            made.append(pp.Target.from_points(arm, points))
        elif k % 6 == 5:
            made.append(pp.Target.from_points(arm, 1.3 * points))
        else:
            made.append(pp.Target.from_configuration(arm, q))
    return made


def main() -> None:  # noqa: PLR0915
    """Run the loop and print what was found."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--steps", type=int, default=100_000)
    parser.add_argument("--modules", type=int, default=20)
    parser.add_argument("--controller", default="geodesic")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--jerk", type=float, help="limit of jerk [rad/s^3]; else there is none")
    parser.add_argument("--free", action="store_true", help="no limit of acceleration")
    parser.add_argument("--deadline", type=float, default=float("inf"), help="of the tracker [s]")
    parser.add_argument("--pause", type=float, default=0.0, help="between cycles, for other threads [s]")
    parser.add_argument(
        "--switch", type=float, default=5e-3, help="interval at which threads of Python take turns [s]"
    )
    parser.add_argument("--json", action="store_true")
    given = parser.parse_args()
    sys.setswitchinterval(given.switch)
    rng = np.random.default_rng(given.seed)
    arm = pp.Arm.from_template("RyRz", modules=given.modules)
    acceleration = None if given.free else ACCELERATION
    limits = pp.Limits(step=None, velocity=SPEED, dt=DT, acceleration=acceleration, jerk=given.jerk)
    tracker = Tracker(arm, given.controller, limits, deadline=given.deadline)
    listed = targets(arm, rng, 240)
    gc.collect()
    gc.freeze()  # or a pause of some 90 ms would come when the collector goes through all there is
    q = smooth_configuration(arm, rng, 0.5)
    sag = SAG * rng.normal(size=arm.nv)
    taken, outcome = np.empty(given.steps), Counter[str]()
    before, fastest, hardest, beyond, memory = np.zeros(arm.nv), 0.0, 0.0, -np.inf, []
    changed, roughest = np.zeros(arm.nv), 0.0
    for step in range(given.steps):
        if rng.random() < 0.005:
            tracker.update(listed[rng.integers(len(listed))])
        measured: np.ndarray | None = q + 1e-4 * rng.normal(size=arm.nv)
        chance = rng.random()
        if chance < 0.01:
            measured = None
        elif chance < 0.02:
            measured = np.where(rng.random(arm.nv) < 0.1, np.nan, q)
        elif chance < 0.03:
            measured = q + rng.normal(size=arm.nv)
        elif chance < 0.0302:
            q = q + 0.5 * rng.normal(size=arm.nv)
        late = 3.0 * DT if rng.random() < 0.01 else DT
        begun = time.perf_counter()
        dq = tracker.step(measured, late)
        taken[step] = time.perf_counter() - begun
        if given.pause:
            time.sleep(given.pause)
        outcome[tracker.report.status] += 1
        if not np.all(np.isfinite(dq)):
            raise SystemExit(f"step {step}: not finite")
        fastest = max(fastest, float(np.abs(dq).max()) / DT)
        hardest = max(hardest, float(np.abs(dq - before).max()) / DT**2)
        roughest = max(roughest, float(np.abs(dq - before - changed).max()) / DT**3)
        command, changed = tracker.command, dq - before
        beyond = max(beyond, float((np.abs(command) - arm.limits.upper).max()))
        before = dq
        q = q + (command + sag - q) * (DT / LAG)
        if (step + 1) % max(given.steps // 10, 1) == 0:
            memory.append(resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024)
    overrun = min(given.deadline, OVERRUN)
    found = {
        "steps": given.steps,
        "controller": given.controller,
        "largest speed, of its limit": fastest / SPEED,
        "largest acceleration, of its limit": None if given.free else hardest / ACCELERATION,
        "largest jerk, of its limit": roughest / given.jerk if given.jerk else None,
        "farthest beyond a position limit [rad]": beyond,
        "microseconds p50": 1e6 * float(np.percentile(taken, 50)),
        "microseconds p99": 1e6 * float(np.percentile(taken, 99)),
        "microseconds p99.9": 1e6 * float(np.percentile(taken, 99.9)),
        "microseconds max": 1e6 * float(taken[10:].max()),
        f"overruns of {1e3 * overrun:g} ms": int(np.sum(taken > overrun)),
        "memory [MB], ten times on the way": [round(each) for each in memory],
        **{f"cycles {status}": count for status, count in sorted(outcome.items())},
    }
    print(json.dumps(found, indent=2) if given.json else "\n".join(f"{k:40} {v}" for k, v in found.items()))


if __name__ == "__main__":
    main()
