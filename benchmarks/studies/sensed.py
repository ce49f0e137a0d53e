"""What other sensors than encoders are worth to a driver on ROS 2, on an arm that sags behind its encoders.

    python -m benchmarks.studies.sensed                  # 10 postures for each row, some minutes
    python -m benchmarks.studies.sensed --postures 3 --latency 0.04

A simulated robot of 8 modules (16 joints, 0.4 m) on soft servos (4 Hz) and a driver, with 50 cycles per
second, are two nodes of this process. The encoders are on the motors and have 1 mrad of noise; "two thirds"
are without every third one. Inertial sensors with a compass (10 mrad) are on every second module, and the tip
is seen to 1 mm and 10 mrad; both tell 50 times per second. The arm has each random smooth posture for four
seconds of the simulation, which goes on when the driver has made its cycle, however busy the machine is.

Told are the distance of the tip from where the driver has it, in all cycles; that of the tip from its target
in cycles of the last second in which the driver says that the arm has arrived; and in how many postures it
does so at the end.
"""

from __future__ import annotations

import argparse
import os
import time
from contextlib import ExitStack
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

import pinposture as pp
from pinposture.arm import smooth_configuration
from pinposture.ros2 import Driver, DriverSettings, RobotSettings, ShapeSensing, SimulatedRobot, open_node
from pinposture.sim import LinkSensing, Sensing, Servos

Array = NDArray[np.float64]

ARM = pp.Arm.from_template("RyRz", modules=8)
RATE = 50.0
LIMITS = pp.Limits(step=None, dt=1.0 / RATE, velocity=1.0, acceleration=4.0)
BETWEEN_TARGETS = 4.0
"""Time for which the arm has each target [s]."""
RESTS = 3.0
"""Time after which it rests there [s]."""
PATIENCE = 10.0
"""Time for which the nodes are waited for [s]."""
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


class WatchedRobot(SimulatedRobot):
    """A simulated robot that counts the commands that it has taken."""

    commands = 0

    def _take_trajectory(self, message: Any) -> None:
        super()._take_trajectory(message)
        self.commands += 1


class Pair:
    """A simulated robot and its driver, which take turns.

    Attributes:
        robot: the robot.
        driver: the driver.

    Args:
        row: what the robot has, and the driver takes.
        latency: by how much messages of sensors come late [s].
        stack: closes what is opened here.
    """

    def __init__(self, row: Row, latency: float, stack: ExitStack) -> None:
        from rclpy.executors import SingleThreadedExecutor
        from rclpy.parameter import Parameter

        settings = RobotSettings(
            servos=Servos(frequency=4.0),
            sensing=Sensing(noise=1e-3),
            encoders="motor",
            links=row.links,
            clock=True,
        )
        node = stack.enter_context(open_node("robot"))
        self.robot = WatchedRobot(node, ARM, None, settings)
        for timer in node.timers:
            timer.cancel()
        missing = ",".join(ARM.drives.names[1::3]) if row.every_third else ""
        node.set_parameters([Parameter("missing", value=missing), Parameter("latency", value=latency)])
        other = stack.enter_context(open_node("pinposture", ["--ros-args", "-p", "use_sim_time:=true"]))
        self.driver = Driver(other, ARM, DriverSettings(rate=RATE, sensing=row.sensing), limits=LIMITS)
        stack.callback(self.driver.close)
        self._executors = []
        for each in (node, other):
            executor = SingleThreadedExecutor(context=each.context)
            executor.add_node(each)
            stack.callback(executor.shutdown)
            self._executors.append(executor)

    def cycle(self) -> None:
        """Simulate until the next cycle of the driver, let it make that, and let the robot take the command.

        Raises:
            RuntimeError: the nodes do not hear of each other.
        """
        robot = self.robot
        times = self.driver.times
        cycles = times.cycles
        sent = len(times.latencies)
        commands = robot.commands
        for _ in range(round(1.0 / (RATE * robot.plant.dt))):
            if not robot.cycle():
                raise RuntimeError(robot.plant.failure)
        begun = time.monotonic()
        while times.cycles == cycles or robot.commands - commands < len(times.latencies) - sent:
            for executor in self._executors:
                executor.spin_once(timeout_sec=0.001)
            if time.monotonic() > begun + PATIENCE:
                raise RuntimeError("the nodes do not hear of each other")

    @property
    def tip(self) -> Array:
        """Where the tip is, (3,) [m]."""
        q = ARM.configuration(ARM.drives.joint_positions(self.robot.plant.positions))
        return np.asarray(ARM.chain_at(q).points[-1])


def measure(row: Row, postures: int, latency: float = 0.0) -> Errors:
    """Drive a robot from posture to posture."""
    rng = np.random.default_rng(0)
    believed: list[float] = []
    missed: list[float] = []
    arrived = 0
    with ExitStack() as stack:
        pair = Pair(row, latency, stack)
        driver = pair.driver
        while driver.status == "holding" and driver.reason != "no target":
            pair.cycle()
        for _ in range(postures):
            target = pp.Target.from_configuration(ARM, smooth_configuration(ARM, rng, 0.5))
            driver.aim(target)
            for cycle in range(round(BETWEEN_TARGETS * RATE)):
                pair.cycle()
                tip = pair.tip
                if driver.measured is not None:
                    believed.append(float(np.linalg.norm(ARM.chain_at(driver.measured).points[-1] - tip)))
                if cycle > RESTS * RATE and driver.status == "converged":
                    missed.append(float(np.linalg.norm(target.points[-1] - tip)))
            arrived += driver.status == "converged"
    return Errors(np.array(believed), np.array(missed), arrived)


def main() -> None:
    """Print a table."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--postures", type=int, default=10)
    parser.add_argument("--latency", type=float, default=0.0, help="by how much sensors come late [s]")
    given = parser.parse_args()
    os.environ |= {"ROS_AUTOMATIC_DISCOVERY_RANGE": "LOCALHOST", "ROS_DOMAIN_ID": str(DOMAIN)}
    print(
        "| sensors | tip, believed [mm]: median | 95 % | at rest, off its target: median | 95 % | arrived |"
    )
    print("|---" * 6 + "|")
    for name, row in ROWS.items():
        found = measure(row, given.postures, given.latency)
        numbers = [
            1e3 * float(np.quantile(distances, share))
            for distances in (found.believed, found.missed)
            for share in (0.5, 0.95)
        ]
        words = " | ".join(f"{each:.1f}" for each in numbers)
        print(f"| {name} | {words} | {found.arrived} of {given.postures} |", flush=True)


if __name__ == "__main__":
    main()
