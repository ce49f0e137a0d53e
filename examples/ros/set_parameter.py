"""Set a parameter of a node, as `ros2 param set` does where ROS 2 is not installed.

python examples/ros/set_parameter.py /robot stuck m03_j1_y
"""

import argparse
import json

import rclpy
from rclpy.parameter import Parameter
from rclpy.parameter_client import AsyncParameterClient


def main() -> None:
    """Set it once the node answers, and exit with the reason if it refuses, or if there is none."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("node", help="its name, such as /pinposture")
    parser.add_argument("name", help="of the parameter")
    parser.add_argument("value", help="true, false, a number, or a text")
    parser.add_argument("--timeout", type=float, default=10.0, help="how long to wait for the node [s]")
    given = parser.parse_args()
    try:
        value = json.loads(given.value)
    except ValueError:  # a text
        value = given.value
    rclpy.init()
    node = rclpy.create_node("set_parameter")
    client = AsyncParameterClient(node, given.node)
    if not client.wait_for_services(timeout_sec=given.timeout):
        others = [f"{space.rstrip('/')}/{name}" for name, space in node.get_node_names_and_namespaces()]
        known = ", ".join(sorted(set(others) - {"/set_parameter"})) or "none"
        raise SystemExit(
            f"no node {given.node} has answered for {given.timeout:g} s; nodes that are there: {known}. "
            "ROS_DOMAIN_ID and ROS_AUTOMATIC_DISCOVERY_RANGE have to be those of the node."
        )
    answer = client.set_parameters([Parameter(given.name, value=value)])
    rclpy.spin_until_future_complete(node, answer, timeout_sec=given.timeout)
    if not answer.done():
        raise SystemExit(f"{given.node} has not answered for {given.timeout:g} s")
    (result,) = answer.result().results
    if not result.successful:
        raise SystemExit(result.reason)


if __name__ == "__main__":
    main()
