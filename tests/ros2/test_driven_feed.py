"""The driver of an arm that a robot carries, or a drum pays out, on a graph of ROS 2."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import pinposture as pp
from pinposture.errors import InvalidValue, PostureError
from pinposture.ros2 import Driver, DriverSettings
from pinposture.task.carrier_feed import load_feed

pytestmark = pytest.mark.long

DT = 0.02
READY = [0.3, -1.2, 1.9, 0.4, 0.7, 0.1]
CARRIER = f"""
[carrier]
robot = "robot.urdf"
start = {READY}
stroke = "15 cm"
direction = [1, 0, 0]
"""
DRUM = '[drum]\nradius = "8 cm"\n'


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    made = tmp_path_factory.mktemp("feed")
    axes = ("z", "y", "y", "x", "y", "x")
    joints = [pp.JointSpec(axis, lower=-3.0, upper=3.0, velocity=1.5) for axis in axes]
    robot = pp.Arm.from_modules([pp.ModuleTemplate("Robot", joints, [0.2, 0.3, 0.25, 0.05, 0.05, 0.04])])
    text = robot.urdf
    for k in range(1, 7):
        text = text.replace(f'"m01_j{k}_', f'"axis{k}_')
    (made / "robot.urdf").write_text(text)
    (made / "carrier.toml").write_text(CARRIER)
    (made / "drum.toml").write_text(DRUM)
    return made


@pytest.fixture(scope="module")
def arm() -> pp.Arm:
    slide = pp.JointSpec("x", type="prismatic", lower=0.0, upper=0.15, velocity=0.2)
    feed = pp.ModuleTemplate("Feed", joints=(slide,), link_lengths=(0.05,))
    return pp.Arm.from_modules([feed, *[pp.template("RyRz")] * 8])


class Joints:
    """Publishes the joints of a robot that follows commands exactly, and the diagnostics of its driver."""

    def __init__(self, graph: Any, name: str, positions: dict[str, float]) -> None:
        from diagnostic_msgs.msg import DiagnosticArray
        from rclpy.qos import QoSProfile, ReliabilityPolicy
        from sensor_msgs.msg import JointState
        from trajectory_msgs.msg import JointTrajectory

        remapped = ("--ros-args", "-r", f"/joint_states:=/{name}/joint_states")
        self.node = graph.node(f"{name}_robot", *remapped)
        self.positions = positions
        self.off = 0.0
        self.told: dict[str, str] = {}
        self.sent: list[dict[str, float]] = []
        best_effort = QoSProfile(depth=1, reliability=ReliabilityPolicy.BEST_EFFORT)
        self.publisher = self.node.create_publisher(JointState, "/joint_states", best_effort)
        topic = f"/{name}/joint_trajectory_controller/joint_trajectory"
        self.node.create_subscription(JointTrajectory, topic, self._take, 10)
        self.node.create_subscription(DiagnosticArray, "/diagnostics", self._hear, 10)
        self.node.create_timer(DT, self._tell)
        self.name = name

    def _take(self, message: Any) -> None:
        self.positions = dict(zip(message.joint_names, message.points[0].positions, strict=True))
        self.sent.append(self.positions)

    def _hear(self, message: Any) -> None:
        [status] = message.status
        if self.name in status.name:
            self.told = {item.key: item.value for item in status.values}

    def _tell(self) -> None:
        from sensor_msgs.msg import JointState

        names = list(self.positions)
        position = list(self.positions.values())
        position[0] += self.off
        message = JointState(name=names, position=position)
        message.header.stamp = self.node.get_clock().now().to_msg()
        self.publisher.publish(message)


def driven(
    graph: Any, name: str, arm: pp.Arm, feed: Any, positions: dict[str, float]
) -> tuple[Driver, Joints]:
    remapped = ("--ros-args", "-r", f"joint_states:=/{name}/joint_states")
    remapped += ("-r", f"joint_trajectory_controller/joint_trajectory:=/{name}/{TOPIC}")
    limits = pp.Limits(dt=1.0, velocity=[0.2] + [1.5] * (arm.nv - 1), acceleration=8.0)
    settings = DriverSettings(rate=1.0 / DT, feed=feed)
    driver = Driver(graph.node(f"{name}_driver", *remapped), arm, settings, limits=limits)
    return driver, Joints(graph, name, positions)


TOPIC = "joint_trajectory_controller/joint_trajectory"


@pytest.fixture(scope="module")
def carried(graph: Any, arm: pp.Arm, folder: Path) -> Iterator[tuple[Driver, Joints, pp.CarrierFeed]]:
    feed = load_feed(folder / "carrier.toml", arm)
    assert isinstance(feed, pp.CarrierFeed)
    start = dict(zip(feed.carrier.drives.names, READY, strict=True))
    start |= dict.fromkeys(arm.drives.names[1:], 0.0)
    driver, joints = driven(graph, "carried", arm, feed, start)
    yield driver, joints, feed
    driver.close()


def posture(arm: pp.Arm, feed: float, bend: float) -> pp.Target:
    q = np.zeros(arm.nv)
    q[0] = feed
    q[2::2] = bend
    return pp.Target.from_configuration(arm, q)


def test_a_drum_turns_in_place_of_the_slide(graph: Any, arm: pp.Arm, folder: Path) -> None:
    feed = load_feed(folder / "drum.toml", arm)
    start = dict.fromkeys(("drum", *arm.joint_names[1:]), 0.0)
    driver, joints = driven(graph, "drum", arm, feed, start)
    target = posture(arm, 0.1, 0.2)
    driver.aim(target)
    assert graph.run(lambda: driver.status == "converged"), (driver.status, driver.reason)
    assert joints.positions["drum"] == pytest.approx(0.1 / 0.08, abs=1e-4)
    assert arm.joint_names[0] not in joints.positions
    driver.close()


def test_the_joints_of_a_robot_move_in_place_of_the_slide(
    graph: Any, arm: pp.Arm, carried: tuple[Driver, Joints, pp.CarrierFeed]
) -> None:
    driver, joints, feed = carried
    assert feed.carrier.joint_names[0] == "axis1_z"
    np.testing.assert_allclose(feed.base_placement.homogeneous, arm.base_placement.homogeneous, atol=1e-12)
    target = posture(arm, 0.1, 0.2)
    driver.aim(target)
    assert graph.run(lambda: driver.status == "converged"), (driver.status, driver.reason)
    assert set(joints.positions) == {*feed.carrier.joint_names, *arm.joint_names[1:]}
    robot = np.array([joints.positions[name] for name in feed.carrier.joint_names])
    flange = feed.carrier.at(robot).points[-1]
    np.testing.assert_allclose(flange, [0.1, 0.0, 0.0], atol=1e-4)
    for sent in joints.sent:  # on its way in each cycle, and no faster than its joints
        q = np.array([sent[name] for name in feed.carrier.joint_names])
        np.testing.assert_allclose(feed.carrier.at(q).points[-1][1:], 0.0, atol=1e-5)
    ways = np.array([[sent[name] for name in feed.carrier.joint_names] for sent in joints.sent])
    assert np.abs(np.diff(ways, axis=0)).max() <= 1.5 * DT + 1e-6
    assert graph.run(lambda: "of the robot" in joints.told.get("robot and arm", "")), joints.told


def test_a_robot_off_its_way_holds_the_arm(
    graph: Any, arm: pp.Arm, carried: tuple[Driver, Joints, pp.CarrierFeed]
) -> None:
    driver, joints, _ = carried
    joints.off = 0.2
    assert graph.run(lambda: "axis1_z" in driver.reason and "on the way of the feed" in driver.reason)
    assert driver.status == "holding"
    joints.off = 0.0
    assert graph.run(lambda: driver.status in ("moving", "converged"))


def test_postures_that_touch_the_robot_are_refused(
    graph: Any, arm: pp.Arm, carried: tuple[Driver, Joints, pp.CarrierFeed]
) -> None:
    from sensor_msgs.msg import JointState

    driver, joints, _ = carried
    target = driver.tracker.target
    message = JointState(name=list(arm.drives.names), position=[0.05, *[0.75, 0.0] * 8])
    publisher = graph.node("operator").create_publisher(JointState, "/carried_driver/posture", 1)

    def refused() -> bool:
        publisher.publish(message)
        return "of the robot: overlapping" in joints.told.get("target", "")

    assert graph.run(refused), joints.told
    assert driver.tracker.target is target


def test_feeds_that_do_not_fit_are_refused(arm: pp.Arm, folder: Path, tmp_path: Path) -> None:
    both = tmp_path / "both.toml"
    both.write_text(CARRIER + DRUM)
    with pytest.raises(InvalidValue, match="a table"):
        load_feed(both, arm)
    with pytest.raises(InvalidValue, match="a slide, the feed"):
        load_feed(folder / "drum.toml", pp.Arm.from_template("RyRz", modules=3))
    longer = tmp_path / "longer.toml"
    longer.write_text(CARRIER.replace("15 cm", "3 m").replace("robot.urdf", str(folder / "robot.urdf")))
    with pytest.raises(PostureError, match="goes straight for"):
        load_feed(longer, arm)
