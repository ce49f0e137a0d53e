"""Nodes of ROS 2: a driver of an arm, and a simulated robot to try it on; needs rclpy, as of `[ros2]`."""

from pinposture.ros2.driver import Driver, DriverSettings
from pinposture.ros2.graph import RosMissing, open_node, spin
from pinposture.ros2.robot import RobotSettings, SimulatedRobot
from pinposture.ros2.shape_readings import ShapeSensing

__all__ = [
    "Driver",
    "DriverSettings",
    "RobotSettings",
    "RosMissing",
    "ShapeSensing",
    "SimulatedRobot",
    "open_node",
    "spin",
]
