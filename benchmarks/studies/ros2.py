"""How punctual a driver is on ROS 2: cycles missed, and time from the state of the joints to the command.

    python -m benchmarks.studies.ros2                         # ten minutes for each row
    python -m benchmarks.studies.ros2 --seconds 60 --modules 8

`pinposture robot` simulates an arm with soft servos and noisy encoders in a process of its own, in real time;
this process drives it from one random smooth posture to another, every four seconds. Both use rclpy and the
middleware of the environment, on this machine. Latency is from the stamp of the joint states that a command
follows from to its publication: the message, the wait for the next cycle of the driver, and its computation.
In the second row the robot has a depth camera, whose clouds become obstacles while the arm moves. Held: in
these cycles the arm held, as a measurement was missing or a path was still planned.
"""

from __future__ import annotations

import argparse
import gc
import os
import subprocess
import sys
import tempfile
import time
from pathlib import Path
from typing import NamedTuple

import numpy as np

import pinposture as pp
from pinposture.arm import smooth_configuration
from pinposture.collision.mapping import SEEN
from pinposture.ros2 import Driver, open_node

LIMITS = pp.Limits(step=None, dt=0.01, velocity=1.0, acceleration=4.0)
BETWEEN_TARGETS = 4.0
"""Time for which the arm has each target [s]."""
DOMAIN = 97
"""Domain of the graph, which nothing else uses."""
ROWS = {"joint states": (), "joint states and clouds": ("--camera", "--camera-rate", "5")}
"""Options of the robot, by the name of the row."""


class Punctuality(NamedTuple):
    """How punctual a driver was.

    Attributes:
        cycles: number of cycles.
        missed: number of cycles that did not take place.
        held: number of cycles in which the arm held.
        maps: number of times that the map of clouds was another one.
        latencies: times from the state of the joints to the command [s].
    """

    cycles: int
    missed: int
    held: int
    maps: int
    latencies: np.ndarray


def measure(arm_file: Path, options: tuple[str, ...], seconds: float) -> Punctuality:
    """Drive a simulated robot, with the options of its command, for a time [s]."""
    from rclpy.executors import SingleThreadedExecutor

    arm = pp.Arm.load(arm_file)
    rng = np.random.default_rng(0)
    scene = pp.Scene({"wall": pp.HalfSpace((1.5 * arm.length, 0.0, 0.0), (-1.0, 0.0, 0.0))})
    file = scene.save(arm_file.with_name("scene.json"))
    command = [sys.executable, "-m", "pinposture", "robot", arm_file, "--scene", file, *options]
    robot = subprocess.Popen(list(map(str, command)), stderr=subprocess.DEVNULL)
    held = 0
    maps = 0
    known = None
    try:
        with open_node("pinposture") as node:
            driver = Driver(node, arm, limits=LIMITS)
            executor = SingleThreadedExecutor(context=node.context)
            executor.add_node(node)
            while driver.status == "holding" and driver.reason != "no target":
                executor.spin_once(timeout_sec=0.1)
            gc.collect()
            gc.freeze()
            before = driver.times.cycles, driver.times.missed
            driver.times.latencies.clear()
            begin = time.monotonic()
            due = begin
            seen = driver.times.cycles
            while time.monotonic() - begin < seconds:
                if time.monotonic() >= due:
                    due += BETWEEN_TARGETS
                    driver.aim(pp.Target.from_configuration(arm, smooth_configuration(arm, rng, 0.5)))
                executor.spin_once(timeout_sec=0.1)
                if driver.times.cycles > seen:
                    seen = driver.times.cycles
                    held += driver.status == "holding"
                    now = driver.tracker.scene
                    cells = None if now is None else now.obstacles[SEEN]
                    maps += cells is not known
                    known = cells
            cycles = driver.times.cycles - before[0]
            missed = driver.times.missed - before[1]
            latencies = np.array(driver.times.latencies)
            executor.shutdown()
            driver.close()
    finally:
        robot.kill()
        robot.wait()
    return Punctuality(cycles, missed, held, maps - 1, latencies)


def main() -> None:
    """Print a table."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--modules", type=int, default=8)
    parser.add_argument("--seconds", type=float, default=600.0)
    given = parser.parse_args()
    os.environ |= {"ROS_AUTOMATIC_DISCOVERY_RANGE": "LOCALHOST", "ROS_DOMAIN_ID": str(DOMAIN)}
    print("| subscribed | cycles | missed | held | latency [ms], median | 99 % | most |")
    print("|---|---|---|---|---|---|---|")
    with tempfile.TemporaryDirectory() as folder:
        arm_file = Path(folder) / "arm.urdf"
        arm_file.write_text(pp.Arm.from_template("RyRz", modules=given.modules).urdf or "")
        for name, options in ROWS.items():
            found = measure(arm_file, options, given.seconds)
            shares = f"{found.missed} ({100.0 * found.missed / (found.cycles + found.missed):.2f} %)"
            quantiles = [1e3 * float(np.quantile(found.latencies, share)) for share in (0.5, 0.99, 1.0)]
            words = " | ".join(f"{each:.1f}" for each in quantiles)
            title = name if not found.maps else f"{name} ({found.maps} maps)"
            print(f"| {title} | {found.cycles} | {shares} | {found.held} | {words} |", flush=True)


if __name__ == "__main__":
    main()
