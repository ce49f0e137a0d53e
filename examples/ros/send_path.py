"""Send a curve to `pinposture drive`, as nav_msgs/Path: the arm takes its shape.

python examples/ros/send_path.py bow.json --frame base
"""

import argparse

import numpy as np
import rclpy
from geometry_msgs.msg import PoseStamped
from nav_msgs.msg import Path

import pinposture as pp

TOPIC = "/pinposture/path"
POINTS = 100


def as_message(curve: pp.Curve, frame: str) -> Path:
    """Return points of a curve at equal distances, in a frame of the world or of the base."""
    message = Path()
    message.header.frame_id = frame
    for x, y, z in curve.at(np.linspace(0.0, curve.length, POINTS)):
        pose = PoseStamped()
        pose.pose.position.x, pose.pose.position.y, pose.pose.position.z = float(x), float(y), float(z)
        message.poses.append(pose)
    return message


def main() -> None:
    """Send the curve once a driver listens."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("file", help="a curve file")
    parser.add_argument("--frame", default="world", help="frame of its points")
    given = parser.parse_args()
    rclpy.init()
    node = rclpy.create_node("send_path")
    publisher = node.create_publisher(Path, TOPIC, 1)
    while publisher.get_subscription_count() == 0:
        rclpy.spin_once(node, timeout_sec=0.1)
    publisher.publish(as_message(pp.Curve.load(given.file), given.frame))
    publisher.wait_for_all_acked()


if __name__ == "__main__":
    main()
