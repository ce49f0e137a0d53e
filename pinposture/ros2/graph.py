"""The ROS 2 graph: rclpy, which is optional, nodes that end as they should, and qualities of service."""

from __future__ import annotations

import signal
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from importlib import import_module
from types import FrameType
from typing import Any

from pinposture.errors import PostureError, install

"""How to get rclpy."""


class RosMissing(PostureError, ImportError):
    """Something of ROS 2 is not installed or cannot be loaded.

    Attributes:
        reason: the message of the failed import or start.
    """

    def __init__(self, reason: str) -> None:
        self.reason = reason
        super().__init__(
            f"this needs rclpy of ROS 2 ({reason}): {install('ros2')}, or source the setup file of your ROS 2"
        )


@contextmanager
def open_node(name: str, ros_args: Sequence[str] = (), domain: int | None = None) -> Iterator[Any]:
    """Create a node of rclpy in a context of its own, and destroy both at the end.

    rclpy does not handle signals; see `spin`.

    Args:
        name: name of the node, unless `ros_args` give another.
        ros_args: arguments of ROS 2, such as `["--ros-args", "-p", "rate:=50.0"]`.
        domain: the domain of the graph; None: that of the environment variable ROS_DOMAIN_ID.

    Raises:
        RosMissing: rclpy, its middleware or a package of messages is missing, or does not start.
        PostureError: arguments that ROS 2 refuses.
    """
    try:
        import rclpy
        from rclpy.signals import SignalHandlerOptions

        kinds = ("diagnostic", "geometry", "nav", "rosgraph", "sensor", "std", "trajectory")
        for package in (f"{kind}_msgs" for kind in kinds):
            import_module(f"{package}.msg")
    except ImportError as error:
        raise RosMissing(str(error)) from error
    context = rclpy.Context()
    try:
        rclpy.init(
            args=list(ros_args),
            context=context,
            domain_id=domain,
            signal_handler_options=SignalHandlerOptions.NO,
        )
    except Exception as error:  # rclpy has several kinds, which differ between distributions
        if ros_args:
            raise PostureError(f"ROS 2 refuses {' '.join(ros_args)!r} ({error})") from error
        raise RosMissing(f"it does not start: {error}") from error
    node = None
    try:
        try:
            node = rclpy.create_node(name, context=context)
        except Exception as error:  # such as without a middleware
            raise RosMissing(f"no node can be created: {error}") from error
        yield node
    finally:
        if node is not None:
            node.destroy_node()
        rclpy.shutdown(context=context)


def spin(node: Any, stop: Callable[[], None], done: Callable[[], bool]) -> None:
    """Let a node work until it is done, or until Ctrl-C or SIGTERM and then until it is done.

    A second signal ends it at once. It must be called in the main thread.

    Args:
        node: the node.
        stop: called after the first signal; the node shall then come to an end.
        done: whether the node is done.
    """
    from rclpy.executors import SingleThreadedExecutor

    signals = 0

    def end(number: int, frame: FrameType | None) -> None:
        nonlocal signals
        signals += 1
        stop()

    before = {number: signal.signal(number, end) for number in (signal.SIGINT, signal.SIGTERM)}
    executor = SingleThreadedExecutor(context=node.context)
    executor.add_node(node)
    try:
        while not done() and signals < 2:
            executor.spin_once(timeout_sec=0.1)  # then it looks whether it shall end
    finally:
        executor.remove_node(node)
        executor.shutdown()
        for number, handler in before.items():
            signal.signal(number, handler)


def latest_only(reliable: bool) -> Any:
    """Return a quality of service that keeps the last message alone.

    Args:
        reliable: whether lost messages are sent again. A subscription that does not ask for it also gets
            messages of publishers that do not offer it, such as most sensors.
    """
    return _profile(1, reliable)


def sensor_data() -> Any:
    """Return the quality of service of measurements, of publishers that are reliable or not.

    It keeps some: the joints of an arm may come in several messages, and its inertial sensors share a topic.
    """
    return _profile(100, False)


def _profile(depth: int, reliable: bool) -> Any:
    from rclpy.qos import QoSProfile, ReliabilityPolicy

    reliability = ReliabilityPolicy.RELIABLE if reliable else ReliabilityPolicy.BEST_EFFORT
    return QoSProfile(depth=depth, reliability=reliability)
