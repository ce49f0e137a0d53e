"""What other sensors than encoders are worth to a driver on ROS 2, on an arm that sags behind its encoders.

    python -m benchmarks.studies.sensed                  # 10 postures for each row, some five minutes
    python -m benchmarks.studies.sensed --postures 3

A simulated robot of 8 modules (16 joints, 0.4 m) on soft servos (4 Hz) and a driver, with 50 cycles per
second, are two nodes of this process. The encoders are on the motors and have 1 mrad of noise; "two thirds"
are without every third one. Inertial sensors with a compass (10 mrad) are on every second module, and the tip
is seen to 1 mm and 10 mrad; both tell 50 times per second. The arm has each random smooth posture for four
seconds.

Told are the distance of the tip from where the driver has it, in all cycles; that of the tip from its target
in cycles of the last second in which the driver says that the arm has arrived; and in how many postures it
does so at the end.
"""

from __future__ import annotations

import argparse
import os
import time
from contextlib import ExitStack
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

import pinposture as pp
from pinposture.arm import smooth_configuration
from pinposture.ros2 import Driver, DriverSettings, RobotSettings, ShapeSensing, SimulatedRobot, open_node
from pinposture.sim import LinkSensing, Sensing, Servos

Array = NDArray[np.float64]

RATE = 50.0
LIMITS = pp.Limits(step=None, dt=1.0 / RATE, velocity=1.0, acceleration=4.0)
BETWEEN_TARGETS = 4.0
"""Time for which the arm has each target [s]."""
RESTS = 3.0
"""Time after which it rests there [s]."""
DOMAIN = 96
"""Domain of the graph, which nothing else uses."""

IMUS = LinkSensing(imus=2)
TIP = LinkSensing(tip_pose=True)
BOTH = LinkSensing(imus=2, tip_pose=True)


class Row(NamedTuple):
    """What a robot has, and what a driver takes of it.

    Attributes:
        links: the sensors on its links.
        sensing: what the driver takes; None: all encoders alone.
        every_third: whether every third encoder is missing.
    """

    links: LinkSensing
    sensing: ShapeSensing | None
    every_third: bool


ROWS = {
    "encoders": Row(LinkSensing(), None, False),
    "encoders, links": Row(IMUS, ShapeSensing(imus=("imu",), encoders="motor"), False),
    "encoders, tip": Row(TIP, ShapeSensing(tip_pose="tip_pose", encoders="motor"), False),
    "encoders, links, tip": Row(
        BOTH, ShapeSensing(imus=("imu",), tip_pose="tip_pose", encoders="motor"), False
    ),
    "two thirds of the encoders, links": Row(IMUS, ShapeSensing(imus=("imu",), encoders="motor"), True),
    "two thirds of the encoders, links, tip": Row(
        BOTH, ShapeSensing(imus=("imu",), tip_pose="tip_pose", encoders="motor"), True
    ),
}


class Errors(NamedTuple):
    """How far off the tip was.

    Attributes:
        believed: its distances from where the driver has it [m].
        missed: its distances from its target at rest [m].
        arrived: number of postures in which the arm arrived.
    """

    believed: Array
    missed: Array
    arrived: int


def measure(row: Row, postures: int) -> Errors:
    """Drive a robot from posture to posture."""
    from rclpy.executors import SingleThreadedExecutor
    from rclpy.parameter import Parameter

    arm = pp.Arm.from_template("RyRz", modules=8)
    rng = np.random.default_rng(0)
    settings = RobotSettings(
        servos=Servos(frequency=4.0), sensing=Sensing(noise=1e-3), encoders="motor", links=row.links
    )
    believed: list[float] = []
    missed: list[float] = []
    arrived = 0
    with ExitStack() as stack:
        nodes = [stack.enter_context(open_node(name)) for name in ("robot", "pinposture")]
        executors = [SingleThreadedExecutor(context=node.context) for node in nodes]
        for node, executor in zip(nodes, executors, strict=True):
            executor.add_node(node)
            stack.callback(executor.shutdown)
        robot = SimulatedRobot(nodes[0], arm, None, settings)
        missing = ",".join(arm.drives.names[1::3]) if row.every_third else ""
        nodes[0].set_parameters([Parameter("missing", value=missing)])
        driver = Driver(nodes[1], arm, DriverSettings(rate=RATE, sensing=row.sensing), limits=LIMITS)
        stack.callback(driver.close)

        def tip(positions: Array) -> Array:
            q = arm.configuration(arm.drives.joint_positions(positions))
            return np.asarray(arm.chain_at(q).points[-1])

        while driver.status == "holding" and driver.reason != "no target":
            for executor in executors:
                executor.spin_once(timeout_sec=0.001)
        for _ in range(postures):
            target = pp.Target.from_configuration(arm, smooth_configuration(arm, rng, 0.5))
            driver.aim(target)
            begin = time.monotonic()
            seen = driver.times.cycles
            while time.monotonic() < begin + BETWEEN_TARGETS:
                for executor in executors:
                    executor.spin_once(timeout_sec=0.001)
                if driver.times.cycles == seen:
                    continue
                seen = driver.times.cycles
                true = tip(robot.plant.positions)
                q = driver.measured
                if q is not None:
                    believed.append(float(np.linalg.norm(arm.chain_at(q).points[-1] - true)))
                if time.monotonic() > begin + RESTS and driver.status == "converged":
                    missed.append(float(np.linalg.norm(target.points[-1] - true)))
            arrived += driver.status == "converged"
    return Errors(np.array(believed), np.array(missed), arrived)


def main() -> None:
    """Print a table."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--postures", type=int, default=10)
    given = parser.parse_args()
    os.environ |= {"ROS_AUTOMATIC_DISCOVERY_RANGE": "LOCALHOST", "ROS_DOMAIN_ID": str(DOMAIN)}
    print(
        "| sensors | tip, believed [mm]: median | 95 % | at rest, off its target: median | 95 % | arrived |"
    )
    print("|---" * 6 + "|")
    for name, row in ROWS.items():
        found = measure(row, given.postures)
        numbers = [
            1e3 * float(np.quantile(distances, share))
            for distances in (found.believed, found.missed)
            for share in (0.5, 0.95)
        ]
        words = " | ".join(f"{each:.1f}" for each in numbers)
        print(f"| {name} | {words} | {found.arrived} of {given.postures} |", flush=True)


if __name__ == "__main__":
    main()
