"""How soon a tracker notices that the arm touches something, and how often it only believes so.

    python -m benchmarks.studies.touch                  # 20 draws, some two minutes
    python -m benchmarks.studies.touch --draws 5

Each draw is an arm of 8 modules (0.8 m, 0.32 kg; gravity takes up to 1.23 N m) that bends from the straight
posture to a random one, with cycles of 10 ms, on servos of 3 to 10 Hz (MuJoCo). Once the way is free. Once a
post that the tracker does not know of, with a radius of 3 cm, stands where the arm is two thirds on its way:
the latency counts from the first touch on. Alarms before a touch, or without one, are false. Thresholds are
shares of the largest torque of gravity; the noise of torques is, too.

The simulated positions and torques, with noise, are given to the detector of the tracker. Then the posts are
met again, by trackers that do nothing, stop, or give way: the force is the largest until the end of the run.
"""

from __future__ import annotations

import argparse
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

import pinposture as pp
from pinposture.collision import CollisionModel
from pinposture.motion.touch import TouchDetector
from pinposture.sim import ContactModel, Sensing, Servos, Simulation, simulate_closed

Array = NDArray[np.float64]

DT = 0.01
SECONDS = 2.5
LIMITS = pp.Limits(dt=DT, velocity=1.0, acceleration=5.0)
RADIUS = 0.03
FREE = 0.01
"""Distance of a post from the arm at the start, at least [m]."""

THRESHOLDS = (0.05, 0.1, 0.2, 0.4)
TIME_CONSTANTS = (0.02, 0.04, 0.08)
REACTING_AT = 0.2
"""Threshold of the trackers that react."""


class Sensors(NamedTuple):
    """Noise of positions [rad] and of torques, in shares of the largest torque of gravity."""

    positions: float
    torques: float


SENSORS = {
    "ideal": Sensors(0.0, 0.0),
    "0.1 mrad, 1 %": Sensors(1e-4, 0.01),
    "0.3 mrad, 3 %": Sensors(3e-4, 0.03),
}


class Draw(NamedTuple):
    """A motion, a post in its way, and the frequency of the servos [Hz]."""

    goal: Array
    post: pp.Cylinder
    frequency: float


def draw(arm: pp.Arm, rng: np.random.Generator) -> Draw:
    """Return a random motion, with a post in its way and clear of its start."""
    while True:
        goal = np.repeat(rng.uniform(-0.25, 0.25, (2, 2)), 4, axis=0).ravel()
        way = arm.at(arm.configuration(0.67 * goal)).points
        middle = way[int(rng.integers(3, len(way)))]
        along = np.cross(way[-1], arm.at(arm.straight()).points[-1])
        along /= np.linalg.norm(along)
        post = pp.Cylinder(tuple(middle - 0.5 * along), tuple(middle + 0.5 * along), RADIUS)
        start = CollisionModel(arm, scene_of(post)).minimum(arm.straight()).distance
        if start > FREE:
            return Draw(goal, post, float(rng.uniform(3.0, 10.0)))


def scene_of(post: pp.Cylinder | None) -> pp.Scene:
    """Return the scene with a post, or without."""
    return pp.Scene({} if post is None else {"post": post}, self_collision=False)


def simulated(arm: pp.Arm, drawn: Draw, blocked: bool, touch: pp.Touch | None = None) -> Simulation:
    """Return the simulation of a motion, with a post in its way or without."""
    return simulate_closed(
        arm,
        pp.Tracker(arm, limits=LIMITS, touch=touch),
        pp.Target.from_configuration(arm, arm.configuration(drawn.goal)),
        q0=arm.straight(),
        duration=SECONDS,
        dt=DT,
        servos=Servos(drawn.frequency),
        sensing=Sensing(torque_noise=0.0),
        scene=scene_of(drawn.post if blocked else None),
        contact=ContactModel(),
    )


def gravity(arm: pp.Arm) -> float:
    """Return the largest torque of gravity of the straight arm [N m]."""
    return float(np.abs(arm.at(arm.straight()).gravity_torques).max())


def alarm(ended: Simulation, sensors: Sensors, touch: pp.Touch) -> float:
    """Return when a detector with noisy sensors notices something in a simulation [s]; infinite: never."""
    rng = np.random.default_rng(0)
    detector = TouchDetector(ended.arm, touch)
    noise = sensors.torques * gravity(ended.arm)
    for time, q, torques in zip(ended.time, ended.q, ended.torques, strict=True):
        measured = q + sensors.positions * rng.standard_normal(len(q))
        detector.update(measured, torques + noise * rng.standard_normal(len(q)), DT)
        if detector.reason:
            return float(time)
    return np.inf


def first_touch(ended: Simulation) -> float:
    """Return when the arm first touched something [s]; infinite: never."""
    touched = ended.contacts.of_arm if ended.contacts is not None else ()
    return touched[0].time if touched else np.inf


def largest_force(ended: Simulation) -> float:
    """Return the largest force on the arm [N]."""
    touched = ended.contacts.of_arm if ended.contacts is not None else ()
    return max((each.force for each in touched), default=0.0)


def print_detection(free: list[Simulation], blocked: list[Simulation]) -> None:
    """Print a table with a row for each kind of sensors, filter and threshold."""
    print("| noise | filter [ms] | threshold | noticed | latency [ms], median | most | false alarms |")
    print("|---" * 7 + "|")
    most = gravity(free[0].arm)
    for name, sensors in SENSORS.items():
        for delay in TIME_CONSTANTS:
            for share in THRESHOLDS:
                touch = pp.Touch(share * most, time_constant=delay)
                late = np.array([alarm(each, sensors, touch) - first_touch(each) for each in blocked])
                noticed = 1e3 * late[np.isfinite(late) & (late >= 0.0)]
                false = np.sum(late < 0.0) + sum(alarm(each, sensors, touch) < np.inf for each in free)
                latency = f"{np.median(noticed):.0f} | {noticed.max():.0f}" if len(noticed) else "- | -"
                told = f"{len(noticed)} of {len(blocked)} | {latency} | {false} of {2 * len(free)}"
                print(f"| {name} | {1e3 * delay:.0f} | {share:.0%} | {told} |", flush=True)


def main() -> None:
    """Print the tables."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--draws", type=int, default=20)
    parser.add_argument("--seed", type=int, default=0)
    given = parser.parse_args()
    arm = pp.Arm.from_template("RyRz", modules=8, link_lengths=(0.05, 0.05))
    rng = np.random.default_rng(given.seed)
    draws = [draw(arm, rng) for _ in range(given.draws)]
    blocked = [simulated(arm, each, blocked=True) for each in draws]
    print_detection([simulated(arm, each, blocked=False) for each in draws], blocked)
    print("\n| reaction | largest force [N], median | most | force at the end [N], median |")
    print("|---" * 4 + "|")
    runs = {"none": blocked}
    for reaction in ("stop", "yield"):
        touch = pp.Touch(REACTING_AT * gravity(arm), reaction)
        runs[reaction] = [simulated(arm, each, blocked=True, touch=touch) for each in draws]
    for reaction, ended in runs.items():
        forces = [largest_force(each) for each in ended]
        last = [np.linalg.norm(each.contacts.forces[-1], axis=1).sum() for each in ended if each.contacts]
        told = f"{np.median(forces):.0f} | {max(forces):.0f} | {np.median(last):.1f}"
        print(f"| {reaction} | {told} |")


if __name__ == "__main__":
    main()
