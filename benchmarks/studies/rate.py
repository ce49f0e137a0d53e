"""Time of `Tracker.step` in free space, by kinds of limits, without and with noise of encoders.

    OPENBLAS_NUM_THREADS=1 python -m benchmarks.studies.rate

Processor time of the thread, so that other programs on the machine count less. The target changes every 150
cycles; the cycles that plan are included.
"""

from __future__ import annotations

import argparse
import time

import numpy as np

import pinposture as pp

CASES = {
    "velocity": pp.Limits(step=None, dt=0.01, velocity=0.5),
    "acceleration": pp.Limits(step=None, dt=0.01, velocity=0.5, acceleration=5.0),
    "jerk": pp.Limits(step=None, dt=0.01, velocity=0.5, acceleration=5.0, jerk=100.0),
}


def measure(arm: pp.Arm, limits: pp.Limits, noise: float, cycles: int) -> np.ndarray:
    """Return the time of each cycle [us]."""
    rng = np.random.default_rng(0)
    tracker = pp.Tracker(arm, limits=limits)
    goal, q, taken = np.full(arm.nv, 0.3), arm.straight(), np.empty(cycles)
    for cycle in range(cycles):
        if cycle % 150 == 0:
            goal = -goal
            tracker.update(pp.Target.from_configuration(arm, goal))
        measured = q + noise * rng.normal(size=arm.nv)
        begun = time.thread_time()
        tracker.step(measured)
        taken[cycle] = time.thread_time() - begun
        q = tracker.command
    return 1e6 * taken[10:]


def main() -> None:
    """Print median and 99th percentile of each case."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--modules", type=int, default=20)
    parser.add_argument("--cycles", type=int, default=3000)
    given = parser.parse_args()
    arm = pp.Arm.from_template("RyRz", modules=given.modules)
    for name, limits in CASES.items():
        for noise in (0.0, 3e-4):
            middle, late = np.percentile(measure(arm, limits, noise, given.cycles), [50, 99])
            print(f"limits of {name:12} noise {noise:g} rad: {middle:.0f} us, 99 % {late:.0f} us")


if __name__ == "__main__":
    main()
