"""Send a motion to a trajectory controller of ros2_control, in a sourced ROS 2 environment.

pinposture export out/run --dt 0.02 --format follow-joint-trajectory -o goal.json
python examples/ros/send_motion.py goal.json /joint_trajectory_controller
"""

import json
import sys
from pathlib import Path

import rclpy
from control_msgs.action import FollowJointTrajectory
from rclpy.action import ActionClient
from rosidl_runtime_py import set_message_fields


def main(file: str, controller: str) -> str:
    """Send the goal and wait for its end. Returns what went wrong; nothing if the motion succeeded."""
    goal = FollowJointTrajectory.Goal()
    set_message_fields(goal, json.loads(Path(file).read_text()))
    rclpy.init()
    node = rclpy.create_node("send_motion")
    client = ActionClient(node, FollowJointTrajectory, f"{controller}/follow_joint_trajectory")
    client.wait_for_server()
    sent = client.send_goal_async(goal)
    rclpy.spin_until_future_complete(node, sent)
    if not sent.result().accepted:
        return "the controller refused the goal; its log says why"
    ended = sent.result().get_result_async()
    rclpy.spin_until_future_complete(node, ended)
    result = ended.result().result
    if result.error_code == FollowJointTrajectory.Result.SUCCESSFUL:
        return ""
    return f"error {result.error_code}: {result.error_string}"


if __name__ == "__main__":
    sys.exit(main(*sys.argv[1:]) or None)
