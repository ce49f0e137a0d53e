"""The examples, run as their users run them, with a simulated robot."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from ros2.processes import EXAMPLES, Watch, environment, started

import pinposture as pp
from pinposture.motion import write_goal

pytest.importorskip("rclpy")
pytest.importorskip("mujoco")
pytestmark = pytest.mark.process


def test_a_planned_motion_is_sent_and_its_end_is_checked(graph: Any, arm_file: Path, tmp_path: Path) -> None:
    arm = pp.Arm.load(arm_file)
    bends = np.linspace(0.0, 0.4, 41)
    motion = pp.JointTrajectory.from_configurations(arm, bends[:, None] * np.ones(arm.nv), 0.05)
    goal = write_goal(motion, tmp_path / "goal.json")
    command = [sys.executable, EXAMPLES / "send_motion.py", goal]
    watch = Watch(graph, arm, "watch")
    with started(tmp_path, "robot", arm_file, "--frequency", 20):
        assert graph.run(lambda: watch.states)
        sent = subprocess.run(
            command, env=os.environ | environment(tmp_path), capture_output=True, check=False
        )
        assert sent.returncode == 0, sent.stderr
        watch.states.clear()
        assert graph.run(lambda: watch.states)
        np.testing.assert_allclose(watch.positions, 0.4, atol=0.02)
        # It is not sent to an arm that is elsewhere.
        again = subprocess.run(
            command, env=os.environ | environment(tmp_path), capture_output=True, check=False
        )
        assert again.returncode == 1
        assert b"the arm is not at the start of the motion: a joint is 0.4" in again.stderr


def test_the_tracker_node_drives_the_arm_to_one_curve_and_to_another(
    graph: Any, arm_file: Path, tmp_path: Path
) -> None:
    from std_msgs.msg import String

    arm = pp.Arm.load(arm_file)
    curves = {"bow": pp.Curve.helix(0.2, 0.0, 0.25), "line": pp.Curve.line((0, 0, 0), (1, 0, 0))}
    for name, curve in curves.items():
        curve.save(tmp_path / f"{name}.json")
    watch = Watch(graph, arm, "watch_2")
    publisher = watch.node.create_publisher(String, "/curve", 1)
    program = [sys.executable, EXAMPLES / "tracker_node.py", arm_file, tmp_path / "bow.json"]
    with (
        started(tmp_path, "robot", arm_file, "--frequency", 20),
        started(tmp_path, *program, module=False) as node,
    ):
        for name, curve in curves.items():
            target = pp.resolve_targets(arm, curve, placement="align")
            if name != "bow":
                publisher.publish(String(data=str(tmp_path / f"{name}.json")))

            def there(target: pp.Target = target) -> bool:
                return bool(
                    watch.states and np.linalg.norm(watch.points - target.points, axis=1).max() < 2e-3
                )

            assert graph.run(there), node.poll()
        publisher.publish(String(data=str(tmp_path / "missing.json")))
        graph.run_for(1.0)
        assert node.poll() is None  # it goes on


def test_a_parameter_of_a_node_that_is_not_there_is_not_waited_for_forever(
    graph: Any, tmp_path: Path
) -> None:
    graph.node("bystander")
    command = [sys.executable, EXAMPLES / "set_parameter.py", "/nobody", "hold", "true", "--timeout", "2"]
    ended = subprocess.run(
        command, env=os.environ | environment(tmp_path), capture_output=True, check=False, timeout=60
    )
    assert ended.returncode == 1
    assert b"no node /nobody has answered for 2 s; nodes that are there: /bystander" in ended.stderr
