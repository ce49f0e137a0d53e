"""`pinposture robot` and `pinposture drive` as two processes, watched from a third."""

from __future__ import annotations

import os
import re
import signal
import subprocess
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from ros2.processes import EXAMPLES, Watch, environment, started

import pinposture as pp

pytest.importorskip("rclpy")
pytest.importorskip("mujoco")
pytestmark = pytest.mark.process


def set_remotely(graph: Any, node: Any, name: str, value: Any) -> Any:
    """Set a parameter of a node, by an `AsyncParameterClient`, and return the result."""
    from rclpy.parameter import Parameter

    assert graph.run(node.services_are_ready)
    answer = node.set_parameters([Parameter(name, value=value)])
    assert graph.run(answer.done)
    return answer.result().results[0]


def test_two_processes_move_a_soft_arm_to_a_curve_and_end_well(
    graph: Any, arm_file: Path, tmp_path: Path
) -> None:
    from rclpy.parameter_client import AsyncParameterClient

    arm = pp.Arm.load(arm_file)
    curve = pp.Curve.helix(0.2, 0.0, 0.25)
    curve.save(tmp_path / "bow.json")
    target = pp.resolve_targets(arm, curve, placement="align")
    watch = Watch(graph, arm, "watch")
    options = ("--command", "positions", "--curve", tmp_path / "bow.json", "--velocity", 0.2)
    with (
        started(tmp_path, "robot", arm_file, "--frequency", 6, "--torque-noise", 0.001) as robot,
        started(tmp_path, "drive", arm_file, *options) as driver,
    ):
        assert graph.run(lambda: watch.states)
        straight = arm.at(arm.straight()).points

        def sags() -> bool:
            return bool(np.linalg.norm(watch.points - straight, axis=1).max() > 0.003)

        assert graph.run(sags)  # by 9.81 / (2 pi 6)^2, 7 mm

        def there() -> bool:
            return bool(np.linalg.norm(watch.points - target.points, axis=1).max() < 1e-3)

        assert graph.run(there), watch.status
        assert graph.run(lambda: watch.status.level == b"\x00" and watch.value("target") == "given")

        # In the middle of a motion that takes long: it brakes, holds, and leaves.
        driver_says = AsyncParameterClient(watch.node, "/pinposture")
        assert set_remotely(graph, driver_says, "velocity", 0.03).successful
        pp.Curve.line((0, 0, 0), (0.3, 0, 0)).save(tmp_path / "line.json")
        elsewhere = arm.at(arm.straight())
        begin = watch.points
        send = [sys.executable, EXAMPLES / "send_path.py", tmp_path / "line.json", "--frame", "base"]
        subprocess.run(send, env=os.environ | environment(tmp_path), check=True, timeout=60)
        assert graph.run(lambda: np.linalg.norm(watch.points - begin, axis=1).max() > 0.01)
        driver.send_signal(signal.SIGTERM)
        assert graph.run(lambda: driver.poll() is not None)
        assert driver.returncode == 0
        assert "the arm holds" in driver.stderr.read()
        graph.run_for(1.0)
        at_rest = watch.positions
        graph.run_for(0.5)
        np.testing.assert_allclose(watch.positions, at_rest, atol=2e-3)  # encoders are noisy
        assert np.linalg.norm(watch.points - elsewhere.points, axis=1).max() > 0.02
        robot.send_signal(signal.SIGINT)
        assert graph.run(lambda: robot.poll() is not None)
        assert robot.returncode == 0


def test_the_time_of_the_simulation_a_camera_and_a_way_out_without_a_joint_that_sticks(
    graph: Any, arm_file: Path, tmp_path: Path
) -> None:
    from rclpy.parameter_client import AsyncParameterClient

    arm = pp.Arm.load(arm_file)
    scene = tmp_path / "scene.json"
    # Within reach of the arm, 0.2 m long: the map ends where nothing can be near it.
    pp.Scene({"wall": pp.Box((0.26, 0.0, 0.0), (0.05, 0.6, 0.6))}).save(scene)
    watch = Watch(graph, arm, "watch_2")
    options = ("--rate", 50, "--lock-after", "0.5 s", "--", "--ros-args", "-p", "use_sim_time:=true")
    with (
        started(tmp_path, "robot", arm_file, "--frequency", 20, "--clock", "--camera", "--scene", scene),
        started(tmp_path, "drive", arm_file, *options) as driver,
    ):
        assert graph.run(lambda: watch.states and watch.status is not None)
        assert watch.states[-1].header.stamp.sec < 1000  # not the time of this computer
        assert graph.run(lambda: int(watch.value("cells seen by cameras")) > 50), watch.status
        assert "no target" in watch.status.message
        target = watch.aim(0.15)
        assert graph.run(lambda: np.abs(watch.positions - 0.15).max() < 0.01), watch.status
        assert np.linalg.norm(watch.points - target.points, axis=1).max() < 5e-3
        robot_says = AsyncParameterClient(watch.node, "/robot")
        driver_says = AsyncParameterClient(watch.node, "/pinposture")

        refused = set_remotely(graph, driver_says, "retreat", True)
        assert not refused.successful and "no joint is locked" in refused.reason
        unknown = set_remotely(graph, driver_says, "locked", "elbow")
        assert "no joint of the chain is called 'elbow'" in unknown.reason
        column = 3
        stuck = arm.drives.names[column]
        assert set_remotely(graph, robot_says, "stuck", stuck).successful
        target = watch.aim(-0.3)
        words = f"joint '{stuck}' does not follow its command"
        assert graph.run(lambda: words in watch.status.message), watch.status
        assert watch.status.level == b"\x01"

        # It is locked, and the arm goes on, as near to its target as was foretold.
        words = "the target is reached to"
        found = graph.run(lambda: watch.value("without them").startswith(words))
        assert found, watch.value("without them")
        locked, at = watch.value("locked joints").split(" at ")
        assert locked == stuck
        assert float(at) == pytest.approx(watch.positions[column], abs=5e-3)
        assert "a way out of" in watch.value("without them"), watch.status
        q = np.full(arm.nq, -0.3)
        q[column] = watch.positions[column]
        near = pp.Target.from_points(arm, target.points).mean_distance(arm.at(q).points)

        def error() -> float:
            return target.mean_distance(watch.points)

        foretold = 1e-3 * float(re.search(r"to ([.\d]+) mm", watch.value("without them"))[1])
        assert foretold < near  # others make up for the joint
        assert graph.run(lambda: error() < foretold + 1e-3), watch.status
        graph.run_for(0.5)
        assert error() > foretold - 1e-3

        # Out, by the way that it came; then with the joint again.
        assert set_remotely(graph, driver_says, "retreat", True).successful
        others = np.arange(arm.nv) != column
        assert graph.run(lambda: np.abs(watch.positions[others]).max() < 0.02), watch.status
        assert watch.positions[column] == pytest.approx(float(at), abs=5e-3)
        assert set_remotely(graph, driver_says, "retreat", False).successful
        mend = [sys.executable, EXAMPLES / "set_parameter.py", "/robot", "stuck", ""]
        subprocess.run(mend, env=os.environ | environment(tmp_path), check=True, timeout=60)
        assert set_remotely(graph, driver_says, "locked", "").successful
        assert graph.run(lambda: not watch.value("locked joints")), watch.status
        watch.aim(-0.3)
        assert graph.run(lambda: np.abs(watch.positions + 0.3).max() < 0.01), watch.status
        assert driver.poll() is None


def test_a_motion_is_performed_once_from_its_start(graph: Any, arm_file: Path, tmp_path: Path) -> None:
    from trajectory_msgs.msg import JointTrajectory

    arm = pp.Arm.load(arm_file)
    bends = 0.2 + 0.2 * np.sin(np.linspace(0.0, 2.0 * np.pi, 101)) ** 2
    motion = pp.JointTrajectory.from_configurations(arm, bends[:, None] * np.ones(arm.nv), 0.03)
    pp.save(motion, tmp_path / "motion.csv")
    watch = Watch(graph, arm, "watch_3")
    commands: list[Any] = []
    topic = "/joint_trajectory_controller/joint_trajectory"
    watch.node.create_subscription(JointTrajectory, topic, commands.append, 100)
    with (
        started(tmp_path, "robot", arm_file, "--frequency", 20),
        started(tmp_path, "drive", arm_file, "--motion", tmp_path / "motion.csv", "--acceleration", 10),
    ):
        assert graph.run(lambda: watch.states)
        assert graph.run(lambda: abs(watch.positions.mean() - 0.2) < 0.005), watch.status
        watch.states.clear()

        def means() -> Any:
            return np.array([sum(each.position) for each in watch.states]) / arm.nv

        def ups() -> int:
            return int(np.sum(np.diff((means() > 0.3).astype(int)) == 1))

        # Twice up and down, as the motion is, and back at its end, where it stays.
        assert graph.run(lambda: ups() == 2 and abs(means()[-1] - 0.2) < 0.01), watch.status
        graph.run_for(1.0)
        assert ups() == 2
        assert means().max() > 0.39
        assert abs(means()[-1] - 0.2) < 0.01
        # Servos overshoot where the machine is so busy that commands come late: what is sent tells. It leads
        # the motion by as much as the servos lag; on a busy machine by 0.015 rad.
        assert max(np.mean(each.points[0].positions) for each in commands) < 0.43
