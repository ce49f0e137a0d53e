"""Whether an arm holds what it wraps around, lifted in MuJoCo, and why it does not.

    python -m benchmarks.studies.wrap                  # 20 draws, some minutes
    python -m benchmarks.studies.wrap --draws 3

Each draw is a cylinder that stands on the floor, of random radius, mass, place and coefficient of friction,
and an arm of 20 modules (1 m, 0.3 kg, 5 N m for each joint) that is to wrap around it in one direction or the
other, by nine tenths of a turn, and to lift it by 0.2 m. It holds if the cylinder rises by at least nine
tenths of that, and tilts by less than 20 degrees. The mass that `assess_hold` promises is told beside it.
"""

from __future__ import annotations

import argparse
from collections import Counter
from typing import NamedTuple

import numpy as np
import pinocchio as pin

import pinposture as pp
from pinposture.errors import TaskError
from pinposture.sim import ContactModel, Simulation, simulate

HEIGHT = 0.24
LIFT = 0.2
TURNS = 0.9
LIMITS = pp.Limits(step=None, dt=0.02, velocity=1.0, acceleration=2.0)
LEAST_RISE = 0.9 * LIFT
MOST_TILT = 20.0
"""Least rise of a cylinder that is held [m], and its largest tilt [degrees]."""


class Draw(NamedTuple):
    """A cylinder, its mass [kg], the coefficient of friction, and the direction of the turns."""

    can: pp.Cylinder
    mass: float
    friction: float
    direction: float

    def scene(self) -> pp.Scene:
        """Return the scene, with a floor under the cylinder."""
        floor = pp.HalfSpace((0.0, 0.0, -HEIGHT / 2.0), (0.0, 0.0, 1.0))
        return pp.Scene({"can": self.can, "floor": floor}, touchable=["can"])


class Outcome(NamedTuple):
    """What came of a draw: the mass that is promised [kg], and why it was not held; empty if it was."""

    promised: float
    rise: float
    tilt: float
    reason: str


def draw(rng: np.random.Generator) -> Draw:
    """Return a random cylinder in front of the arm."""
    distance = rng.uniform(0.3, 0.55)
    angle = np.radians(rng.uniform(-25.0, 25.0))
    x = distance * np.cos(angle)
    y = distance * np.sin(angle)
    radius = rng.uniform(0.03, 0.08)
    half = HEIGHT / 2.0
    can = pp.Cylinder((x, y, -half), (x, y, half), radius)
    return Draw(can, rng.uniform(0.1, 1.2), rng.uniform(0.1, 0.9), rng.choice([-1.0, 1.0]))


def attempt(arm: pp.Arm, drawn: Draw) -> Outcome:
    """Wrap around a cylinder and lift it."""
    scene = drawn.scene()
    start = arm.straight()
    turns = TURNS * drawn.direction
    try:
        grip = pp.wrap(arm, "can", scene, start, LIMITS, turns=turns, friction=drawn.friction)
        lifted = pp.carry(grip, (0.0, 0.0, LIFT))
    except TaskError as error:
        return Outcome(0.0, 0.0, 0.0, f"not planned: {error}")
    motion = pp.JointTrajectory.joined([grip.phases["wind"], grip.phases["squeeze"], lifted.motion])
    contact = ContactModel(friction=drawn.friction, masses={"can": drawn.mass})
    ended = simulate(arm, motion, scene=scene, contact=contact, hold=0.5)
    return judged(ended, drawn, grip.hold.mass)


def judged(ended: Simulation, drawn: Draw, promised: float) -> Outcome:
    """Return what came of a simulation."""
    if ended.contacts is None or not ended.finished:
        return Outcome(promised, 0.0, 0.0, f"unstable: {ended.reason}")
    moved = pin.SE3(ended.contacts.displacements[-1, 0])
    middle = 0.5 * (np.array(drawn.can.start) + np.array(drawn.can.end))
    rise = float((moved.act(middle) - middle)[2])
    tilt = float(np.degrees(np.arccos(np.clip(moved.rotation[2, 2], -1.0, 1.0))))
    reason = ""
    if rise < LEAST_RISE:
        reason = "heavier than promised" if promised < drawn.mass else "slipped"
    elif tilt > MOST_TILT:
        reason = f"tilted: by {tilt:.0f} degrees"
    elif ended.contacts.faults:
        reason = "held, but touched: " + " touches ".join(ended.contacts.faults[0].pair)
    return Outcome(promised, rise, tilt, reason)


def main() -> None:
    """Print a row for each draw, and how many hold."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--draws", type=int, default=20)
    parser.add_argument("--seed", type=int, default=0)
    given = parser.parse_args()
    arm = pp.Arm.from_template("RyRz", modules=20).with_effort(5.0)
    rng = np.random.default_rng(given.seed)
    print("| radius [mm] | at [mm] | turns | friction | mass [kg] | promised [kg] | rise [mm] | tilt | |")
    print("|---" * 9 + "|")
    counts = Counter[str]()
    for _ in range(given.draws):
        drawn = draw(rng)
        ended = attempt(arm, drawn)
        x, y, _ = drawn.can.start
        place = (
            f"{1e3 * drawn.can.radius:.0f} | {1e3 * x:.0f}, {1e3 * y:.0f} | {TURNS * drawn.direction:+.1f}"
        )
        masses = f"{drawn.friction:.2f} | {drawn.mass:.2f} | {ended.promised:.2f}"
        told = f"{round(1e3 * ended.rise)} | {ended.tilt:.0f} | {ended.reason or 'held'}"
        print(f"| {place} | {masses} | {told} |", flush=True)
        counts[ended.reason.split(":")[0] or "held"] += 1
    print("\n" + ", ".join(f"{name}: {count} of {given.draws}" for name, count in counts.most_common()))


if __name__ == "__main__":
    main()
