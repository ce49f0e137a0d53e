"""Send a planned motion to the joint_trajectory_controller of ros2_control, and wait until it is over.

pinposture export out/task --dt 0.02 --format follow-joint-trajectory -o goal.json
python examples/ros/send_motion.py goal.json

It publishes on the topic of the controller, and compares what is measured in the end. The action
FollowJointTrajectory also tells how a motion ends; it needs the messages of control_msgs, which a ROS 2
installation has: ros2 action send_goal --stdin ... < goal.json
"""

import sys

import numpy as np
import rclpy
from sensor_msgs.msg import JointState
from trajectory_msgs.msg import JointTrajectory, JointTrajectoryPoint

import pinposture as pp

TOPIC = "/joint_trajectory_controller/joint_trajectory"
PATIENCE = 2.0  # how long after its end the arm may reach the last point [s]
TOLERANCE = 0.02  # distance of each joint from the last point that counts as there [rad or m]


def as_message(motion: pp.JointTrajectory) -> JointTrajectory:
    """Return the message; its stamp is zero, so that the controller starts on receipt."""
    message = JointTrajectory(joint_names=list(motion.joint_names))
    for moment, positions in zip(motion.time[1:], motion.positions[1:], strict=True):
        point = JointTrajectoryPoint(positions=positions.tolist())
        point.time_from_start.sec = int(moment)
        point.time_from_start.nanosec = int(1e9 * (moment - int(moment)))
        message.points.append(point)
    return message


def main(file: str) -> str:
    """Send the motion. Returns what went wrong; nothing if the arm is at its end."""
    motion = pp.load(file, pp.JointTrajectory)
    rclpy.init()
    node = rclpy.create_node("send_motion")
    measured: dict[str, float] = {}

    def distance(row: int) -> float:
        """Return the largest distance of a joint from a row of the motion."""
        positions = [measured.get(name, np.inf) for name in motion.joint_names]
        return float(np.abs(positions - motion.positions[row]).max())

    def wait(until, patience: float) -> bool:
        end = node.get_clock().now().nanoseconds + 1e9 * patience
        while not until() and node.get_clock().now().nanoseconds < end:
            rclpy.spin_once(node, timeout_sec=0.1)
        return until()

    node.create_subscription(
        JointState,
        "/joint_states",
        lambda each: measured.update(zip(each.name, each.position, strict=True)),
        10,
    )
    publisher = node.create_publisher(JointTrajectory, TOPIC, 1)
    if not wait(lambda: publisher.get_subscription_count() > 0, 10.0):
        return f"nothing listens on {TOPIC}"
    if not wait(lambda: distance(0) <= TOLERANCE, 2.0):
        return f"the arm is not at the start of the motion: a joint is {distance(0):.3g} from it"
    publisher.publish(as_message(motion))
    wait(lambda: False, motion.time[-1] - PATIENCE)
    if wait(lambda: distance(-1) <= TOLERANCE, 2.0 * PATIENCE):
        return ""
    return f"the arm is not at the end of the motion: a joint is {distance(-1):.3g} from it"


if __name__ == "__main__":
    sys.exit(main(*sys.argv[1:]) or None)
