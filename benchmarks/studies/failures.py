"""How soon a tracker notices a joint that fails, and what it takes the failure to be.

    python -m benchmarks.studies.failures               # 20 draws, ten minutes
    python -m benchmarks.studies.failures --draws 3

Each draw is an arm of 8 modules (0.8 m, 0.32 kg) that goes to another random posture every 1.5 s, with cycles
of 10 ms and up to 1 rad/s, on servos of 3 to 10 Hz (MuJoCo), with encoders of 0.1 mrad and torques of 1 % of
the largest torque of gravity. A random hinge fails after 1 to 3 s: it sticks, its drive is limp, or gives at
most 30 % of the torque by which weight loads it; in the last rows none does. It is watched for 5 s. What is
told before, or of other joints, is false. With torques, the tracker also watches for a touch, which stops it.
"""

from __future__ import annotations

import argparse
from collections import Counter
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

import pinposture as pp
from pinposture.sim import Sensing, Servos, build_plant_model
from pinposture.sim.plant import FAILURES, Plant, Sensors

Array = NDArray[np.float64]

DT = 0.01
CYCLES = 800
WATCHED = 500
"""Cycles of a trial, and those after the failure."""
BETWEEN_TARGETS = 150
"""Cycles between two targets."""
LIMITS = pp.Limits(dt=DT, velocity=1.0, acceleration=5.0)
NOISE = 1e-4
TORQUE_NOISE = 0.01
"""Noise of positions [rad], and of torques, in the largest torque of gravity."""


class Trial(NamedTuple):
    """A joint that fails, by its degree of freedom, the cycle in which it does, and the servos [Hz]."""

    joint: int
    begin: int
    frequency: float
    seed: int


class Told(NamedTuple):
    """What a tracker told first: what it was, whether it is false, and how long after the failure [s]."""

    kind: str
    false: bool
    after: float


def told_first(arm: pp.Arm, trial: Trial, failure: str, efforts: bool) -> Told | None:
    """Return what a tracker tells first in a trial; None: nothing."""
    rng = np.random.default_rng(trial.seed)
    plant = Plant(build_plant_model(arm, Servos(trial.frequency)), np.zeros(arm.nv), DT)
    noise = TORQUE_NOISE * float(arm.outstretched_torques.max())
    sensors = Sensors(Sensing(noise=NOISE, torque_noise=noise if efforts else None, seed=trial.seed))
    tracker = pp.Tracker(arm, limits=LIMITS, touch=pp.Touch() if efforts else None)
    name = arm.drives.names[trial.joint]
    for cycle in range(min(CYCLES, trial.begin + WATCHED)):
        if cycle == trial.begin and failure != "none":
            plant.fail(**{failure: [name]})
        if cycle % BETWEEN_TARGETS == 0:
            bends = np.repeat(rng.uniform(-0.25, 0.25, (2, 2)), arm.nv // 4, axis=0).ravel()
            tracker.update(pp.Target.from_configuration(arm, arm.configuration(bends)))
        measured = sensors.measure(plant.positions, plant.torques)
        tracker.step(measured, torques=sensors.torques)
        report = tracker.report
        touched = report.reason.startswith("something touches")
        if report.failures or touched:
            after = (cycle - trial.begin) * DT
            first = report.failures[0] if report.failures else None
            kind = "touch" if first is None else first.kind
            other = first is not None and first.joint != name
            return Told(kind, failure == "none" or after < 0.0 or other, after)
        if not plant.advance(tracker.positions):
            return None
    return None


def main() -> None:
    """Print a row for each failure, with and without torques."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--draws", type=int, default=20)
    parser.add_argument("--seed", type=int, default=0)
    given = parser.parse_args()
    arm = pp.Arm.from_template("RyRz", modules=8, link_lengths=(0.05, 0.05))
    rng = np.random.default_rng(given.seed)
    trials = [
        Trial(int(rng.integers(arm.nv)), int(rng.integers(100, 300)), float(rng.uniform(3.0, 10.0)), seed)
        for seed in range(given.draws)
    ]
    print("| measured | failure | noticed | time [s], median | most | told as | false |")
    print("|---" * 7 + "|")
    for efforts in (False, True):
        for failure in (*FAILURES, "none"):
            told = [told_first(arm, trial, failure, efforts) for trial in trials]
            right = [each for each in told if each is not None and not each.false]
            false = sum(each is not None and each.false for each in told)
            late = [each.after for each in right]
            times = f"{np.median(late):.2f} | {max(late):.2f}" if late else "- | -"
            kinds = (
                ", ".join(f"{kind} {n}" for kind, n in Counter(each.kind for each in right).items()) or "-"
            )
            what = "positions, torques" if efforts else "positions"
            row = f"| {what} | {failure} | {len(right)} of {len(trials)} | {times} | {kinds} | {false} |"
            print(row, flush=True)


if __name__ == "__main__":
    main()
