"""Set a parameter of a node, as `ros2 param set` does where ROS 2 is not installed.

python examples/ros/set_parameter.py /robot stuck m03_j1_y
"""

import argparse
import json

import rclpy
from rclpy.parameter import Parameter
from rclpy.parameter_client import AsyncParameterClient


def main() -> None:
    """Set it once the node answers, and exit with the reason if it refuses."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("node", help="its name, such as /pinposture")
    parser.add_argument("name", help="of the parameter")
    parser.add_argument("value", help="true, false, a number, or a text")
    given = parser.parse_args()
    try:
        value = json.loads(given.value)
    except ValueError:  # a text
        value = given.value
    rclpy.init()
    node = rclpy.create_node("set_parameter")
    client = AsyncParameterClient(node, given.node)
    while not client.wait_for_services(timeout_sec=1.0):
        print(f"waiting for {given.node}")
    answer = client.set_parameters([Parameter(given.name, value=value)])
    rclpy.spin_until_future_complete(node, answer)
    (result,) = answer.result().results
    if not result.successful:
        raise SystemExit(result.reason)


if __name__ == "__main__":
    main()
