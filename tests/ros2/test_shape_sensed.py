"""The driver on a soft simulated robot that lacks encoders: what other sensors of the shape are worth."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import numpy as np
import pinocchio as pin
import pytest
from ros2.processes import set_to

import pinposture as pp

pytest.importorskip("rclpy")
pytest.importorskip("mujoco")
from pinposture.errors import PostureError
from pinposture.ros2 import Driver, DriverSettings, RobotSettings, ShapeSensing, SimulatedRobot
from pinposture.sim import LinkSensing, Sensing, Servos

pytestmark = pytest.mark.long

SENSING = ShapeSensing(imus=("imu",), tip_pose="tip_pose", encoders="motor")
LIMITS = pp.Limits(step=None, dt=0.02, velocity=1.0, acceleration=4.0)


class Sensed:
    """A soft robot whose encoders are on its motors, and a driver."""

    def __init__(self, graph: Any, arm: pp.Arm, sensing: ShapeSensing | None, number: int) -> None:
        self.arm = arm
        self.graph = graph
        self.node = graph.node(f"robot_{number}")
        settings = RobotSettings(
            servos=Servos(frequency=4.0),
            sensing=Sensing(noise=1e-3),
            encoders="motor",
            links=LinkSensing(imus=2, tip_pose=True),
        )
        self.robot = SimulatedRobot(self.node, arm, None, settings)
        self.driver = Driver(
            graph.node(f"driver_{number}"), arm, DriverSettings(rate=50.0, sensing=sensing), limits=LIMITS
        )

    def lose(self, *names: str) -> None:
        answer = set_to(self.node, "missing", ",".join(names))
        assert answer.successful, answer.reason

    @property
    def told(self) -> dict[str, str]:
        shape = self.driver._shape
        assert shape is not None
        return shape.told(self.driver._now())

    def take(self, target: pp.Target) -> float:
        """Have the arm take a posture; return the true distance of its farthest point from it."""
        self.driver.aim(target)
        assert self.graph.run(lambda: self.driver.status == "converged"), self.driver.reason
        self.graph.run_for(0.5)
        return self.farthest(target)

    def farthest(self, target: pp.Target) -> float:
        return float(np.linalg.norm(self.points - target.points, axis=1).max())

    @property
    def points(self) -> np.ndarray:
        positions = self.arm.drives.joint_positions(self.robot.plant.positions)
        return self.arm.at(self.arm.configuration(positions)).points


@pytest.fixture
def quiet(graph: Any) -> Iterator[Any]:
    """The graph, whose nodes end with the test: robots share their topics."""
    yield graph
    graph.close()


def posture(arm: pp.Arm) -> pp.Target:
    return pp.Target.from_configuration(arm, np.full(arm.nq, 0.15))


def test_an_arm_without_a_third_of_its_encoders_comes_nearer_than_one_that_sags_behind_them(
    quiet: Any,
) -> None:
    arm = pp.Arm.from_template("RyRz", modules=6)
    target = posture(arm)
    alone = Sensed(quiet, arm, None, 1)
    sagging = alone.take(target)
    alone.driver.close()
    quiet.close()
    assert sagging > 5e-3

    sensed = Sensed(quiet, arm, SENSING, 2)
    lost = arm.drives.names[1::3]
    sensed.lose(*lost)
    assert sensed.take(target) < 0.3 * sagging
    assert sensed.told["missing sensors"] == ", ".join(f"encoder {name!r}" for name in lost)

    # A link whose sensor says something else does not move the arm, and is told.
    from geometry_msgs.msg import PoseStamped

    liar = sensed.node.create_publisher(PoseStamped, "tip_pose", 10)
    wrong = pin.SE3(pin.rpy.rpyToMatrix(0.0, 0.0, 1.0), np.array([0.0, 0.2, 0.0]))
    said = 0.0
    for _ in range(15):
        message = PoseStamped()
        message.header.frame_id = "world"
        message.header.stamp = sensed.node.get_clock().now().to_msg()
        x, y, z, w = pin.Quaternion(wrong.rotation).coeffs().tolist()
        message.pose.orientation.x, message.pose.orientation.y = x, y
        message.pose.orientation.z, message.pose.orientation.w = z, w
        message.pose.position.y = 0.2
        sensed.lose(*lost, arm.tip)
        liar.publish(message)
        quiet.run_for(0.04)
        said = max(said, float("pose of the tip" in sensed.told["outliers"]))
    assert said
    assert sensed.farthest(target) < 0.4 * sagging

    # Without any sensor on a link, what is known fades, and the arm holds; with them, it goes on.
    sensed.lose(*lost, *sensed.robot._links.links)
    assert quiet.run(lambda: "at most 15 mm is allowed" in sensed.driver.reason), sensed.told
    assert sensed.driver.status == "holding"
    sensed.lose(*lost)
    assert quiet.run(lambda: sensed.driver.status == "converged"), sensed.driver.reason
    assert sensed.farthest(target) < 0.4 * sagging
    sensed.driver.close()


def test_a_topic_that_is_no_name_is_refused(quiet: Any) -> None:
    arm = pp.Arm.from_template("RyRz", modules=2)
    with pytest.raises(PostureError, match="Invalid topic name"):
        Driver(quiet.node("driver_3"), arm, DriverSettings(sensing=ShapeSensing(imus=("a b",))))
