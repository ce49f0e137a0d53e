"""The simulated robot: it takes both kinds of commands, is late, silent, sees, and lets joints fail."""

from __future__ import annotations

from collections.abc import Iterator
from types import SimpleNamespace
from typing import Any

import numpy as np
import pinocchio as pin
import pytest
from ros2.processes import set_to

import pinposture as pp

pytest.importorskip("mujoco")
from pinposture.errors import PostureError, UnknownName
from pinposture.motion.ros import to_message
from pinposture.ros2.clouds import read_points
from pinposture.ros2.robot import CommandedMotion, RobotSettings, SimulatedRobot
from pinposture.sim import Sensing, Servos, build_plant_model
from pinposture.sim.camera import DepthCamera
from pinposture.sim.plant import Plant

NAMES = ("a", "b")


def trajectory(names: list[str], rows: list[list[float]], times: list[float]) -> Any:
    points = [
        SimpleNamespace(
            positions=row,
            time_from_start=SimpleNamespace(sec=int(time), nanosec=round(1e9 * (time - int(time)))),
        )
        for row, time in zip(rows, times, strict=True)
    ]
    return SimpleNamespace(joint_names=names, points=points)


def test_set_points_move_between_the_points_of_a_trajectory_from_where_they_are() -> None:
    motion = CommandedMotion(NAMES, np.array([1.0, -1.0]))
    np.testing.assert_array_equal(motion.at(5.0), [1.0, -1.0])
    message = trajectory(["b", "a"], [[0.0, 2.0], [4.0, 2.0]], [1.0, 3.0])
    assert motion.follow(message, begin=10.0, now=10.0) == ""
    np.testing.assert_allclose(motion.at(10.5), [1.5, -0.5])
    np.testing.assert_allclose(motion.at(12.0), [2.0, 2.0])
    assert motion.follow(trajectory(["a", "b"], [[0.0, 0.0]], [0.1]), begin=12.0, now=12.0) == ""
    np.testing.assert_allclose(motion.at(12.05), [1.0, 1.0])  # half way from where it was
    np.testing.assert_allclose(motion.at(99.0), [0.0, 0.0])
    motion.move_to([3.0, 4.0], 100.0)
    np.testing.assert_array_equal(motion.at(100.0), [3.0, 4.0])


@pytest.mark.parametrize(
    ("names", "rows", "times", "words"),
    [
        (["a"], [[0.0]], [1.0], "joint_names are"),
        (["a", "c"], [[0.0, 0.0]], [1.0], "joint_names are"),
        (["a", "b"], [], [], "at least one point"),
        (["a", "b"], [[0.0]], [1.0], "a position for each joint"),
        (["a", "b"], [[0.0, np.nan]], [1.0], "finite positions"),
        (["a", "b"], [[0.0, 0.0], [1.0, 1.0]], [1.0, 1.0], "increasing times"),
        (["a", "b"], [[0.0, 0.0]], [0.0], "increasing times from now on"),
    ],
)
def test_a_trajectory_that_the_joints_cannot_follow_is_refused(
    names: list[str], rows: list[list[float]], times: list[float], words: str
) -> None:
    motion = CommandedMotion(NAMES, np.array([1.0, -1.0]))
    assert words in motion.follow(trajectory(names, rows, times), begin=0.0, now=0.0)
    np.testing.assert_array_equal(motion.at(9.0), [1.0, -1.0])


@pytest.fixture(scope="module")
def arm() -> pp.Arm:
    return pp.Arm.from_template("RyRz", modules=3)


@pytest.mark.long
def test_a_stuck_joint_stands_and_a_limp_one_has_no_torque_until_they_work_again(arm: pp.Arm) -> None:
    model = build_plant_model(arm, Servos(frequency=8.0), gravity=False)
    plant = Plant(model, np.zeros(arm.nv), 0.01)
    stuck, limp = arm.drives.names[1], arm.drives.names[2]
    plant.fail(stuck=[stuck], limp=[limp])
    for _ in range(200):
        assert plant.advance(np.full(arm.nv, 0.3))
        assert plant.torques[2] == 0.0
    assert abs(plant.positions[1]) < 1e-6
    assert abs(plant.torques[1]) > 0.0  # its servo pulls in vain
    assert abs(plant.positions[2] - 0.3) > 0.03
    np.testing.assert_allclose(plant.positions[[0, 3, 4, 5]], 0.3, atol=0.01)
    plant.fail()
    for _ in range(200):
        assert plant.advance(np.full(arm.nv, 0.3))
    np.testing.assert_allclose(plant.positions, 0.3, atol=0.01)
    with pytest.raises(UnknownName, match="no joint with a drive is called 'elbow'"):
        plant.fail(limp=["elbow"])


@pytest.mark.long
def test_a_weak_drive_gives_a_share_of_what_weight_needs() -> None:
    arm = pp.Arm.from_template("RyRz", modules=3)
    plant = Plant(build_plant_model(arm, Servos(frequency=8.0)), np.zeros(arm.nv), 0.01)
    plant.fail(weak=arm.drives.names[:1])
    for _ in range(100):
        assert plant.advance(np.zeros(arm.nv))
    data = arm.model.createData()
    needed = pin.computeGeneralizedGravity(arm.model, data, np.zeros(arm.nv))  # stretched out, level
    assert abs(plant.torques[0]) == pytest.approx(0.3 * abs(needed[0]), rel=1e-6)
    assert plant.positions[0] > 0.3  # down, about +y


@pytest.mark.long
def test_a_limp_arm_falls_as_a_free_pendulum_does(arm: pp.Arm) -> None:
    """Without torques, energy is kept: what falls gains as much speed as Pinocchio's energies say."""
    model = build_plant_model(arm, Servos(frequency=8.0, timestep=1e-4))
    plant = Plant(model, np.zeros(arm.nv), 0.001)
    plant.fail(limp=arm.drives.names)
    rows = []
    for _ in range(60):
        assert plant.advance(np.zeros(arm.nv))
        rows.append(plant.positions)
    data = arm.model.createData()
    speeds = (rows[-1] - rows[-3]) / 0.002
    kinetic = pin.computeKineticEnergy(arm.model, data, rows[-2], speeds)
    fallen = pin.computePotentialEnergy(arm.model, data, np.zeros(arm.nv))
    fallen -= pin.computePotentialEnergy(arm.model, data, rows[-2])
    assert fallen > 1e-4
    assert kinetic == pytest.approx(fallen, rel=0.02)


@pytest.fixture
def robot(graph: Any, arm: pp.Arm) -> Iterator[tuple[SimulatedRobot, Any]]:
    scene = pp.Scene({"wall": pp.HalfSpace((0.5, 0.0, 0.0), (-1.0, 0.0, 0.0))})
    settings = RobotSettings(
        servos=Servos(frequency=20.0),
        sensing=Sensing(noise=1e-4, torque_noise=1e-3, latency=3),
        camera=DepthCamera(width=16, height=12),
    )
    node = graph.node("robot")
    yield SimulatedRobot(node, arm, scene, settings), node
    graph.close()


@pytest.mark.long
def test_the_robot_moves_as_it_is_told_and_tells_what_it_feels_and_sees(
    graph: Any, arm: pp.Arm, robot: tuple[SimulatedRobot, Any]
) -> None:
    from sensor_msgs.msg import JointState, PointCloud2
    from std_msgs.msg import Float64MultiArray
    from trajectory_msgs.msg import JointTrajectory, JointTrajectoryPoint

    simulated, node = robot
    user = graph.node("user")
    states: list[tuple[float, Any]] = []
    clouds: list[Any] = []

    def now() -> float:
        return user.get_clock().now().nanoseconds / 1e9

    def age(message: Any) -> float:
        return now() - message.header.stamp.sec - 1e-9 * message.header.stamp.nanosec

    user.create_subscription(JointState, "/joint_states", lambda each: states.append((age(each), each)), 10)
    user.create_subscription(PointCloud2, "/points", clouds.append, 1)
    positions = user.create_publisher(Float64MultiArray, "/position_controller/commands", 1)
    trajectories = user.create_publisher(JointTrajectory, "/joint_trajectory_controller/joint_trajectory", 1)
    assert graph.run(lambda: trajectories.get_subscription_count() and positions.get_subscription_count())
    assert graph.run(lambda: len(states) > 20 and clouds)
    assert np.median([late for late, _ in states[-10:]]) > 0.029  # three cycles
    _, state = states[-1]
    assert state.name == list(arm.drives.names)
    assert len(state.effort) == arm.nv

    # What it sees is a plane half a metre ahead, in the frame of the link that the message names.
    cloud = clouds[-1]
    assert cloud.header.frame_id == arm.tip
    data = arm.model.createData()
    q = arm.configuration(arm.drives.joint_positions(simulated.plant.positions))
    pin.framesForwardKinematics(arm.model, data, q)
    placement = data.oMf[arm.model.getFrameId(arm.tip)]
    seen = read_points(cloud) @ placement.rotation.T + placement.translation
    np.testing.assert_allclose(seen[:, 0], 0.5, atol=0.02)  # the arm still sags a little

    # A trajectory of several points, with joints in another order; then positions.
    names = list(arm.drives.names)[::-1]
    message = JointTrajectory(joint_names=names)
    for k in (1, 2, 3):
        point = JointTrajectoryPoint(positions=[0.1 * k] * arm.nv)
        point.time_from_start.nanosec = 200_000_000 * k
        message.points.append(point)
    trajectories.publish(message)
    assert graph.run(lambda: np.abs(simulated.plant.positions - 0.3).max() < 0.02)
    positions.publish(Float64MultiArray(data=[-0.1] * arm.nv))
    assert graph.run(lambda: np.abs(simulated.plant.positions + 0.1).max() < 0.02)
    positions.publish(Float64MultiArray(data=[0.0]))
    assert graph.run(lambda: "allowed: 6 finite numbers" in simulated.refused)
    trajectories.publish(JointTrajectory(joint_names=["x"]))
    assert graph.run(lambda: "joint_names are ['x']" in simulated.refused)

    # Joints that fail, messages that do not come.
    stuck = arm.drives.names[3]
    assert set_to(node, "stuck", f"{stuck}, {arm.drives.names[0]}").successful
    positions.publish(Float64MultiArray(data=[0.2] * arm.nv))
    assert graph.run(lambda: abs(simulated.plant.positions[1] - 0.2) < 0.05)
    assert simulated.plant.positions[3] == pytest.approx(-0.1, abs=0.02)
    refused = set_to(node, "limp", "elbow")
    assert not refused.successful and "no joint with a drive is called 'elbow'" in refused.reason
    assert set_to(node, "stuck", "").successful
    assert graph.run(lambda: abs(simulated.plant.positions[3] - 0.2) < 0.05)
    assert set_to(node, "silent", True).successful
    graph.run_for(0.3)
    count = len(states)
    graph.run_for(0.3)
    assert len(states) == count


@pytest.mark.long
def test_parameters_that_are_given_at_the_start_count(graph: Any, arm: pp.Arm) -> None:
    stuck = arm.drives.names[1]
    given = ("--ros-args", "-p", f"stuck:={stuck}", "-p", f"missing:={arm.drives.names[2]}")
    user = graph.node("listener")
    states: list[Any] = []
    from sensor_msgs.msg import JointState

    user.create_subscription(JointState, "/joint_states", states.append, 10)
    robot = SimulatedRobot(graph.node("lame", *given), arm, None, RobotSettings(servos=Servos(frequency=8.0)))
    robot._motion.move_to(np.full(arm.nv, 0.3), robot.time)
    assert graph.run(lambda: robot.time > 1.0)
    moved = np.abs(robot.plant.positions) > 0.01
    assert moved.tolist() == [name != stuck for name in arm.drives.names]
    assert graph.run(lambda: states)
    assert states[-1].name == [name for name in arm.drives.names if name != arm.drives.names[2]]
    with pytest.raises(PostureError, match="no joint with a drive is called 'elbow'"):
        SimulatedRobot(graph.node("wrong", "--ros-args", "-p", "limp:=elbow"), arm)
    with pytest.raises(PostureError, match="no joint or link with sensors is called 'elbow'"):
        SimulatedRobot(graph.node("other", "--ros-args", "-p", "missing:=elbow"), arm)
    graph.close()


def test_messages_of_motions_have_the_form_that_the_robot_reads() -> None:
    """`export` writes the same message as JSON."""
    arm = pp.Arm.from_template("RyRz", modules=1)
    motion = pp.JointTrajectory.from_configurations(arm, np.linspace(0, 0.3, 4)[:, None] * np.ones(2), 0.5)
    written = to_message(motion)
    read = trajectory(
        written["joint_names"],
        [each["positions"] for each in written["points"]],
        [
            each["time_from_start"]["sec"] + each["time_from_start"]["nanosec"] / 1e9
            for each in written["points"]
        ],
    )
    followed = CommandedMotion(arm.drives.names, np.zeros(2))
    read.points = read.points[1:]  # the first is where it stands
    assert followed.follow(read, begin=0.0, now=0.0) == ""
    np.testing.assert_allclose(followed.at(0.75), 0.15)
