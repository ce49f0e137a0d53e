"""Processes and nodes of tests, on a graph of ROS 2 that no other process of tests shares."""

from __future__ import annotations

import ctypes
import os
import signal
import subprocess
import sys
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Any

import numpy as np

import pinposture as pp

EXAMPLES = Path(__file__).parents[2] / "examples" / "ros"


def own_domain() -> int:
    """A domain for this process of tests: others on this machine, also of other runs, have another."""
    worker = os.environ.get("PYTEST_XDIST_WORKER", "gw0").removeprefix("gw")
    return 1 + 8 * (os.getppid() % 12) + int(worker) % 8


def environment(logs: Path) -> dict[str, str]:
    """What keeps a graph to this machine, and its logs to a folder."""
    return {
        "ROS_AUTOMATIC_DISCOVERY_RANGE": "LOCALHOST",
        "ROS_LOCALHOST_ONLY": "1",
        "ROS_DOMAIN_ID": str(own_domain()),
        "ROS_LOG_DIR": str(logs),
    }


def set_to(node: Any, name: str, value: Any) -> Any:
    """Set a parameter of a node of this process, and return the result."""
    from rclpy.parameter import Parameter

    (result,) = node.set_parameters([Parameter(name, value=value)])
    return result


END_WITH_PARENT = 1  # PR_SET_PDEATHSIG


def end_with_the_tests() -> None:
    """For a child: it ends with this process of tests, however that ends, and heeds Ctrl-C."""
    ctypes.CDLL(None).prctl(END_WITH_PARENT, signal.SIGKILL)
    signal.signal(signal.SIGINT, signal.SIG_DFL)


@contextmanager
def started(logs: Path, *arguments: Any, module: bool = True) -> Iterator[subprocess.Popen[str]]:
    """Start the command, or another program; it is killed at the end, with all that it started."""
    line = [sys.executable, "-m", "pinposture", *arguments] if module else arguments
    child = subprocess.Popen(
        [*map(str, line)],
        env=os.environ | environment(logs),
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        start_new_session=True,
        preexec_fn=end_with_the_tests,
    )
    try:
        yield child
    finally:
        with suppress(ProcessLookupError):
            os.killpg(child.pid, signal.SIGKILL)
        child.communicate()


class Watch:
    """A node that hears what robot and driver say."""

    def __init__(self, graph: Any, arm: pp.Arm, name: str) -> None:
        from diagnostic_msgs.msg import DiagnosticArray
        from sensor_msgs.msg import JointState

        self.arm = arm
        self.graph = graph
        self.node = graph.node(name)
        self.states: list[Any] = []
        self.status: Any = None
        self.node.create_subscription(JointState, "/joint_states", self.states.append, 10)
        self.node.create_subscription(DiagnosticArray, "/diagnostics", self._hear, 10)

    def _hear(self, message: Any) -> None:
        self.status = message.status[0]

    @property
    def positions(self) -> np.ndarray:
        state = self.states[-1]
        return self.arm.drives.joint_positions(dict(zip(state.name, state.position, strict=True)))

    @property
    def points(self) -> np.ndarray:
        return self.arm.at(self.arm.configuration(self.positions)).points

    def value(self, key: str) -> str:
        return next((each.value for each in self.status.values if each.key == key), "")

    def aim(self, bend: float) -> pp.Target:
        """Have the driver take a posture; return its target."""
        from sensor_msgs.msg import JointState

        publisher = self.node.create_publisher(JointState, "/pinposture/posture", 1)
        assert self.graph.run(lambda: publisher.get_subscription_count() > 0, 30.0)
        names = list(self.arm.drives.names)
        publisher.publish(JointState(name=names, position=[bend] * len(names)))
        self.graph.run_for(0.2)
        self.node.destroy_publisher(publisher)
        return pp.Target.from_configuration(self.arm, np.full(self.arm.nq, bend))
