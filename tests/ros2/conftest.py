"""A graph of ROS 2 on this machine alone, for one process of tests."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator
from contextlib import ExitStack
from pathlib import Path
from typing import Any

import pytest
from ros2.processes import environment, own_domain

import pinposture as pp

PATIENCE = 120.0
"""How long something that has to happen is waited for [s]: on a busy machine arms often have to hold."""


class Graph:
    """Nodes in a domain, which work while a test waits for something."""

    def __init__(self, open_node: Callable[..., Any], domain: int) -> None:
        from rclpy.executors import SingleThreadedExecutor

        self.domain = domain
        self._open = open_node
        self._executor = SingleThreadedExecutor
        self._stack = ExitStack()
        self._running: list[Any] = []

    def node(self, name: str, *ros_args: str) -> Any:
        node = self._stack.enter_context(self._open(name, ros_args, self.domain))
        executor = self._executor(context=node.context)
        executor.add_node(node)
        self._stack.callback(executor.shutdown)
        self._running.append(executor)
        return node

    def run(self, until: Callable[[], Any], patience: float = PATIENCE) -> bool:
        """Let all nodes work until something is so; return whether it is in time."""
        end = time.monotonic() + patience
        while not until() and time.monotonic() < end:
            for executor in self._running:
                executor.spin_once(timeout_sec=0.001)
        return bool(until())

    def run_for(self, duration: float) -> None:
        end = time.monotonic() + duration
        self.run(lambda: time.monotonic() >= end, 2.0 * duration + 1.0)

    def close(self) -> None:
        self._running.clear()
        self._stack.close()


@pytest.fixture(scope="module")
def graph(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Graph]:
    pytest.importorskip("rclpy", reason="ROS 2 is not installed: pip install 'pinposture[ros2]'")
    from pinposture.ros2 import open_node

    with pytest.MonkeyPatch.context() as patch:
        for name, value in environment(tmp_path_factory.mktemp("ros")).items():
            patch.setenv(name, value)
        made = Graph(open_node, own_domain())
        try:
            yield made
        finally:
            made.close()


@pytest.fixture(scope="module")
def arm_file(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("arm") / "arm.urdf"
    path.write_text(pp.Arm.from_template("RyRz", modules=4).urdf)
    return path
