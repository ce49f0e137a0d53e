"""How a tracker does with real drives: errors at rest and in motion, cycles held, and whether it says so.

    python -m benchmarks.studies.drives            # about a minute
    python -m benchmarks.studies.drives --modules 20 --seconds 30

Each row is an arm of the given modules with position drives of a model (`pinposture.sim.Drives`) and encoders
with noise (`pinposture.sim.Sensors`). At rest: the arm is sent to a posture with all joints at 0.3 rad. In
motion: all joints follow a sine of 0.5 rad with 0.1 Hz, given in each cycle with its velocity. The status at
rest is true if "converged" means an error below a hundredth of a module, and anything else a larger one.
"""

from __future__ import annotations

import argparse
from typing import NamedTuple

import numpy as np

import pinposture as pp
from pinposture.sim import DriveModel, Drives, Sensing, Sensors

DT = 0.01
LIMITS = pp.Limits(step=None, dt=DT, velocity=1.0, acceleration=4.0)
ENCODERS = Sensing(noise=3e-4)
TRUE_SHARE = 0.01
"""Largest error of a "converged" arm, in module lengths."""


class Robot(NamedTuple):
    """What a tracker is connected to, and its feedback."""

    model: DriveModel
    sensing: Sensing = ENCODERS
    feedback: float = 0.25
    late: float = 0.0  # share of cycles that come after twice their time


ROBOTS = {
    "perfect drives": Robot(DriveModel(lag=0.02, friction=0.0, delay=0.0), Sensing()),
    "noise of 0.3 mrad": Robot(DriveModel(lag=0.02, friction=0.0, delay=0.0)),
    "lag of 0.32 s": Robot(DriveModel(friction=0.0)),
    "lag, friction of 0.11 rad": Robot(DriveModel()),
    "the same, without feedback": Robot(DriveModel(), feedback=float("inf")),
    "lag, friction of 0.2 rad": Robot(DriveModel(friction=0.2)),
    "the same, stiction of 0.02 rad": Robot(DriveModel(friction=0.2, stiction=0.02)),
    "delay of 0.14 s, readings at 20 Hz": Robot(
        DriveModel(lag=0.1, friction=0.0, delay=0.14), Sensing(noise=3e-4, period=5), feedback=1.0
    ),
    "one cycle of five late": Robot(DriveModel(friction=0.0, lag=0.1), late=0.2),
}


class Result(NamedTuple):
    """The mean error of the control points [m], the last status, and the share of cycles held."""

    error: float
    status: str
    held: float


def run(arm: pp.Arm, robot: Robot, seconds: float, moving: bool) -> Result:
    """Run a loop, and return its result: at the end at rest, in the second half in motion."""
    rng = np.random.default_rng(0)
    tracker = pp.Tracker(arm, limits=LIMITS, feedback_time_constant=robot.feedback)
    drives = Drives(robot.model, np.zeros(arm.nv), DT)
    sensors = Sensors(robot.sensing)
    held = 0
    errors = []
    goal = np.full(arm.nv, 0.3)
    tracker.update(pp.Target.from_configuration(arm, arm.configuration(goal)))
    cycles = round(seconds / DT)
    for cycle in range(cycles):
        if moving:
            phase = 2.0 * np.pi * 0.1 * DT * (cycle + 1)
            goal = np.full(arm.nv, 0.5 * np.sin(phase))
            velocity = np.full(arm.nv, 0.5 * 2.0 * np.pi * 0.1 * np.cos(phase))
            tracker.update(pp.Target.from_configuration(arm, arm.configuration(goal)), velocity=velocity)
        late = rng.random() < robot.late
        tracker.step(sensors.measure(drives.positions), dt=2.0 * DT if late else DT)
        for _ in range(1 + late):
            drives.advance(tracker.positions)
        held += tracker.report.status == "holding"
        points = arm.at(arm.configuration(drives.positions)).points
        wanted = arm.at(arm.configuration(goal)).points
        errors.append(float(np.linalg.norm(points - wanted, axis=1).mean()))
    error = float(np.mean(errors[cycles // 2 :])) if moving else errors[-1]
    return Result(error, tracker.report.status, held / cycles)


def is_true(arm: pp.Arm, result: Result) -> bool:
    """Return whether the status at rest is what the arm does."""
    near = result.error <= TRUE_SHARE * float(arm.chain.module_lengths.mean())
    return (result.status == "converged") == near


def main() -> None:
    """Print a table with a row for each robot."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--modules", type=int, default=8)
    parser.add_argument("--seconds", type=float, default=20.0)
    given = parser.parse_args()
    arm = pp.Arm.from_template("RyRz", modules=given.modules)
    print("| drives | error at rest [mm] | status | true | error in motion [mm] | cycles held |")
    print("|---|---|---|---|---|---|")
    for name, robot in ROBOTS.items():
        rest = run(arm, robot, given.seconds, moving=False)
        motion = run(arm, robot, given.seconds, moving=True)
        told = "yes" if is_true(arm, rest) else "no"
        print(
            f"| {name} | {1e3 * rest.error:.2f} | {rest.status} | {told} | {1e3 * motion.error:.1f} "
            f"| {100.0 * max(rest.held, motion.held):.0f} % |"
        )


if __name__ == "__main__":
    main()
