"""Drive an arm in closed loop: joint states in, joint positions out, 100 times a second.

python examples/ros/tracker_node.py arm.urdf curve.json

A node of your own in sixty lines, to start from. `pinposture drive` does more: it checks time stamps, takes
point clouds, reports diagnostics, and brakes before it ends.

The commands go to a JointGroupPositionController of ros2_control that has the joints in the order of
`arm.drives.names`, which are those of `arm.joint_names` unless joints are coupled.
Publish a std_msgs/String with the name of a curve file on /curve to give the arm another shape.
"""

import sys

import rclpy
from rclpy.node import Node
from sensor_msgs.msg import JointState
from std_msgs.msg import Float64MultiArray, String

import pinposture as pp

DT = 0.01  # duration of a cycle [s]
MAX_AGE = 3  # cycles after which a measurement no longer counts: the tracker then brakes


class TrackerNode(Node):
    """Steps a `Tracker` at a fixed rate."""

    def __init__(self, arm: pp.Arm, curve: pp.Curve) -> None:
        super().__init__("pinposture_tracker")
        self.arm = arm
        self.measured = None
        self.age = 0
        limits = pp.Limits(step=None, dt=DT, acceleration=10.0)  # speeds are those of the URDF
        self.tracker = pp.Tracker(arm, limits=limits, deadline=DT / 2)
        self.tracker.update(pp.resolve_targets(arm, curve, placement="align"))
        self.commands = self.create_publisher(Float64MultiArray, "/position_controller/commands", 1)
        self.create_subscription(JointState, "/joint_states", self.on_joint_states, 1)
        self.create_subscription(String, "/curve", self.on_curve, 1)
        self.create_timer(DT, self.on_cycle)

    def on_joint_states(self, message: JointState) -> None:
        """Keep the measured positions; joints come by name, in any order, perhaps with others."""
        positions = dict(zip(message.name, message.position, strict=True))
        if all(name in positions for name in self.arm.drives.names):
            self.measured = positions  # with their full turns
            self.age = 0

    def on_curve(self, message: String) -> None:
        """Give the arm another shape; keep the present one if it cannot take it."""
        try:
            self.tracker.update(pp.resolve_targets(self.arm, pp.Curve.load(message.data), placement="align"))
        except pp.PostureError as error:
            self.get_logger().error(str(error))

    def on_cycle(self) -> None:
        """Take a step, and command the positions that it leads to."""
        self.age += 1
        self.tracker.step(self.measured if self.age <= MAX_AGE else None)
        if self.tracker.report.reason:  # it holds, or is stalled
            self.get_logger().warning(self.tracker.report.reason, throttle_duration_sec=1.0)
        if self.measured is not None:
            self.commands.publish(Float64MultiArray(data=self.tracker.positions.tolist()))


def main(urdf: str, curve: str) -> None:
    """Run the node until Ctrl-C."""
    rclpy.init()
    rclpy.spin(TrackerNode(pp.Arm.load(urdf), pp.Curve.load(curve)))


if __name__ == "__main__":
    main(*sys.argv[1:])
