"""The driver on a graph of ROS 2, with a robot that does what it is told, unless it is told wrong things."""

from __future__ import annotations

import json
import re
import time
from collections.abc import Callable, Iterator
from dataclasses import replace
from typing import Any

import numpy as np
import pinocchio as pin
import pytest
from ros2.processes import set_to

import pinposture as pp
from pinposture.collision.mapping import SEEN
from pinposture.motion.feedback import JointFailure
from pinposture.operate import Control, Operation
from pinposture.ros2 import Driver, DriverSettings
from pinposture.ros2.clouds import write_points

pytestmark = pytest.mark.long

DT = 0.02
ACCELERATION = 8.0
VELOCITY = 2.0


class Robot:
    """Publishes joint states, in a way that a test may change, and follows commands exactly."""

    def __init__(self, graph: Any, arm: pp.Arm) -> None:
        from diagnostic_msgs.msg import DiagnosticArray
        from rclpy.qos import QoSProfile, ReliabilityPolicy
        from sensor_msgs.msg import JointState
        from trajectory_msgs.msg import JointTrajectory

        self.arm = arm
        self.graph = graph
        self.node = graph.node("robot")
        self.positions = dict.fromkeys(arm.drives.names, 0.0)
        self.commands: list[np.ndarray] = []
        self.diagnostics: list[Any] = []
        self.alter: Callable[[Any], list[Any]] = lambda message: [message]
        best_effort = QoSProfile(depth=1, reliability=ReliabilityPolicy.BEST_EFFORT)
        self.publisher = self.node.create_publisher(JointState, "/joint_states", best_effort)
        topic = "/joint_trajectory_controller/joint_trajectory"
        self.node.create_subscription(JointTrajectory, topic, self._trajectory, 10)
        self.node.create_subscription(
            DiagnosticArray, "/diagnostics", lambda each: self.diagnostics.append(each.status[0]), 10
        )
        self.node.create_timer(DT, self._tell)

    def _trajectory(self, message: Any) -> None:
        [point] = message.points
        assert (message.header.stamp.sec, message.header.stamp.nanosec) == (0, 0)  # it starts at once
        assert (point.time_from_start.sec, point.time_from_start.nanosec) == (0, 20_000_000)
        self.positions = dict(zip(message.joint_names, point.positions, strict=True))
        self.commands.append(np.array([self.positions[name] for name in self.arm.drives.names]))

    def _tell(self) -> None:
        for message in self.alter(self.joint_state()):
            self.publisher.publish(message)

    def joint_state(self) -> Any:
        from sensor_msgs.msg import JointState

        names = [*reversed(self.positions), "gripper"]
        message = JointState(name=names, position=[*reversed(self.positions.values()), 0.01])
        message.header.stamp = self.node.get_clock().now().to_msg()
        return message

    @property
    def points(self) -> np.ndarray:
        positions = self.arm.drives.joint_positions(self.positions)
        return self.arm.at(self.arm.configuration(positions)).points

    def at(self, target: pp.Target, within: float = 1e-3) -> bool:
        return bool(np.linalg.norm(self.points - target.points, axis=1).max() < within)


@pytest.fixture(scope="module")
def arm() -> pp.Arm:
    return pp.Arm.from_template("RyRz", modules=6)


@pytest.fixture(scope="module")
def pair(graph: Any, arm: pp.Arm) -> Iterator[tuple[Driver, Robot]]:
    limits = pp.Limits(dt=1.0, velocity=VELOCITY, acceleration=ACCELERATION)  # the rate tells the cycle
    driver = Driver(graph.node("driver"), arm, DriverSettings(rate=1.0 / DT), limits=limits)
    robot = Robot(graph, arm)
    yield driver, robot
    driver.close()
    robot.alter = lambda message: []


@pytest.fixture
def driver(pair: tuple[Driver, Robot]) -> Driver:
    return pair[0]


@pytest.fixture
def robot(pair: tuple[Driver, Robot]) -> Iterator[Robot]:
    robot = pair[1]
    robot.diagnostics.clear()
    yield robot
    robot.alter = lambda message: [message]


def posture(arm: pp.Arm, bend: float) -> pp.Target:
    return pp.Target.from_configuration(arm, np.full(arm.nq, bend))


def set_moving(graph: Any, driver: Driver, robot: Robot) -> pp.Target:
    """Have the arm move fast; return its target."""
    bend = -0.4 if robot.points[-1, 1] > 0.0 else 0.4
    target = posture(driver.arm, bend)
    driver.aim(target)

    def moves() -> bool:
        steps = np.abs(np.diff(robot.commands[-2:], axis=0))
        return len(robot.commands) > 1 and steps.max() > 0.5 * VELOCITY * DT

    assert graph.run(moves), (driver.status, driver.reason)
    return target


def test_the_arm_takes_the_shape_of_a_path_and_says_so(graph: Any, driver: Driver, robot: Robot) -> None:
    from geometry_msgs.msg import PoseStamped
    from nav_msgs.msg import Path

    curve = pp.Curve.helix(0.25, 0.0, 0.25)
    placed = pp.resolve_targets(driver.arm, curve, placement="align")
    through = np.vstack([np.zeros(3), placed.points, 2 * placed.points[-1] - placed.points[-2]])
    message = Path()
    message.header.frame_id = "world"
    for x, y, z in through:
        pose = PoseStamped()
        pose.pose.position.x, pose.pose.position.y, pose.pose.position.z = map(float, (x, y, z))
        message.poses.append(pose)
    publisher = robot.node.create_publisher(Path, f"{driver._node.get_name()}/path", 1)
    assert graph.run(lambda: publisher.get_subscription_count() > 0)
    publisher.publish(message)
    expected = pp.resolve_targets(driver.arm, pp.Curve.points(through), placement="as_is")
    assert graph.run(lambda: robot.at(expected, 1e-5)), driver.reason
    assert graph.run(lambda: driver.status == "converged")
    assert graph.run(lambda: robot.diagnostics and robot.diagnostics[-1].message == "converged")
    assert robot.diagnostics[-1].level == b"\x00"
    assert robot.diagnostics[-1].hardware_id == driver.arm.name
    robot.diagnostics.clear()
    message.header.frame_id = "tip"
    publisher.publish(message)
    assert graph.run(lambda: "frame_id is 'tip'" in driver._target_fault)
    assert graph.run(lambda: robot.diagnostics and robot.diagnostics[-1].level == b"\x01")
    robot.node.destroy_publisher(publisher)


def renamed(message: Any, before: str, after: str) -> Any:
    message.name = [after if each == before else each for each in message.name]
    return message


def shifted(message: Any, seconds: int) -> Any:
    message.header.stamp.sec += seconds
    return message


def with_nan(message: Any) -> Any:
    message.position[0] = np.nan
    return message


FAULTS = {
    "silence": (lambda message: [], "was measured .* ago; at most max_age, 0.1 s, is used"),
    "a wrong name": (lambda message: [renamed(message, "m03_j1_y", "m3_j1")], "'m03_j1_y' was measured"),
    "not a number": (
        lambda message: [with_nan(message)],
        "the position of joint 'm06_j2_z' is measured as nan",
    ),
    "stamps of the future": (lambda message: [shifted(message, 5)], "5 s in the future: do the clocks agree"),
}


@pytest.mark.parametrize("name", FAULTS)
def test_the_arm_brakes_and_holds_while_joint_states_are_wrong(
    graph: Any, driver: Driver, robot: Robot, name: str
) -> None:
    alter, reason = FAULTS[name]
    target = set_moving(graph, driver, robot)
    speed = np.abs(np.diff(robot.commands[-2:], axis=0)).max() / DT
    robot.alter = alter
    assert graph.run(lambda: re.search(reason, driver.reason)), driver.reason
    assert driver.status == "holding"
    begin = len(robot.commands)
    assert graph.run(lambda: driver.tracker.at_rest)
    braking = (len(robot.commands) - begin) * DT
    assert braking >= 0.5 * speed / ACCELERATION - DT  # it does not stop dead
    held = robot.commands[-1]
    graph.run_for(0.3)
    np.testing.assert_array_equal(robot.commands[-1], held)
    assert not robot.at(target)
    assert graph.run(lambda: robot.diagnostics and re.search(reason, robot.diagnostics[-1].message))
    assert robot.diagnostics[-1].level == b"\x02"
    robot.alter = lambda message: [message]
    assert graph.run(lambda: robot.at(target)), driver.reason
    steps = np.abs(np.diff(robot.commands, axis=0)) / DT
    assert steps.max() <= 2.0 * VELOCITY  # a lost message makes two steps look like one


def test_joints_may_come_in_two_messages(graph: Any, driver: Driver, robot: Robot) -> None:
    def halves(message: Any) -> list[Any]:
        first, second = robot.joint_state(), robot.joint_state()
        first.name, first.position = first.name[:5], first.position[:5]
        second.name, second.position = second.name[5:], second.position[5:]
        return [first, second]

    robot.alter = halves
    target = set_moving(graph, driver, robot)
    assert graph.run(lambda: robot.at(target)), driver.reason


def test_a_posture_is_a_target_and_one_of_other_joints_is_refused(
    graph: Any, driver: Driver, robot: Robot
) -> None:
    from sensor_msgs.msg import JointState

    publisher = robot.node.create_publisher(JointState, f"{driver._node.get_name()}/posture", 1)
    assert graph.run(lambda: publisher.get_subscription_count() > 0)
    names = list(driver.arm.drives.names)
    publisher.publish(JointState(name=names[::-1], position=[0.2] * len(names)))

    def reached() -> bool:
        return driver.status == "converged" and robot.at(posture(driver.arm, 0.2))

    assert graph.run(reached), driver.reason
    for wrong in (
        JointState(name=names[1:], position=[0.1] * (len(names) - 1)),
        JointState(name=names, position=[0.1]),
        JointState(name=names, position=[np.nan] * len(names)),
        JointState(name=names, position=[50.0] * len(names)),
    ):
        driver._target_fault = ""
        publisher.publish(wrong)
        assert graph.run(lambda: driver._target_fault.startswith("a target is refused"))
    graph.run_for(0.1)
    assert robot.at(posture(driver.arm, 0.2))
    robot.node.destroy_publisher(publisher)


def test_parameters_change_limits_and_hold_the_arm(graph: Any, driver: Driver, robot: Robot) -> None:
    node = driver._node
    target = set_moving(graph, driver, robot)
    assert set_to(node, "velocity", 0.2).successful
    graph.run_for(0.5)
    begin = len(robot.commands)
    graph.run_for(0.5)
    steps = np.abs(np.diff(robot.commands[begin:], axis=0)).max(axis=1) / DT
    assert 0.1 < np.median(steps) <= 0.2 + 1e-6
    refused = set_to(node, "velocity", -1.0)
    assert not refused.successful and "velocity" in refused.reason
    assert not set_to(node, "max_age", 0.0).successful
    assert not set_to(node, "rate", 50.0).successful  # fixed from the start
    assert set_to(node, "hold", True).successful
    assert graph.run(lambda: driver.tracker.at_rest)
    assert graph.run(lambda: driver.reason == "the parameter hold is true")
    assert not robot.at(target)
    assert set_to(node, "velocity", 0.0).successful and set_to(node, "hold", False).successful
    assert graph.run(lambda: robot.at(target)), driver.reason


def test_the_end_is_a_brake_and_a_hold(graph: Any, driver: Driver, robot: Robot) -> None:
    target = set_moving(graph, driver, robot)
    driver.stop()
    assert not driver.done()
    begin = len(robot.commands)
    assert graph.run(driver.done)
    assert len(robot.commands) - begin > 5
    assert driver.reason == "the driver ends"
    assert not robot.at(target)
    driver._stopping = False
    assert graph.run(lambda: robot.at(target))


def test_a_cloud_of_a_link_becomes_an_obstacle_and_one_of_an_unknown_frame_holds_the_arm(
    graph: Any, driver: Driver, robot: Robot
) -> None:
    from sensor_msgs.msg import PointCloud2

    arm = driver.arm
    publisher = robot.node.create_publisher(PointCloud2, "/points", 1)
    assert graph.run(lambda: publisher.get_subscription_count() > 0)
    target = set_moving(graph, driver, robot)
    box = np.array([0.12, 0.12, 0.12]) + np.random.default_rng(0).uniform(-0.02, 0.02, (500, 3))

    # While it moves: where the tip was when the cloud was taken.
    data = arm.model.createData()
    tip = arm.model.getFrameId(arm.tip)
    q = arm.configuration(arm.drives.joint_positions(robot.positions))
    stamp = robot.node.get_clock().now().to_msg()
    pin.framesForwardKinematics(arm.model, data, q)
    seen = (box - data.oMf[tip].translation) @ data.oMf[tip].rotation
    publisher.publish(write_points(seen, arm.tip, stamp))

    def seen_cells() -> np.ndarray:
        return driver.tracker.scene.obstacles[SEEN].points

    assert graph.run(lambda: len(seen_cells())), driver.reason
    apart = np.linalg.norm(box[:, None] - seen_cells()[None], axis=2)
    cell = 0.02 * arm.length
    assert apart.min(axis=1).max() < cell + 0.012  # 2 rad/s for 20 ms are 12 mm at the tip
    assert graph.run(lambda: robot.at(target)), driver.reason

    target = set_moving(graph, driver, robot)
    publisher.publish(write_points(box, "camera_link", robot.node.get_clock().now().to_msg()))
    words = "a cloud in frame 'camera_link' is refused: no frame of the arm is called 'camera_link'"
    assert graph.run(lambda: driver.reason.startswith(words)), driver.reason
    assert graph.run(lambda: driver.tracker.at_rest)
    assert not robot.at(target)
    graph.run_for(1.2)
    assert robot.diagnostics[-1].level == b"\x02"
    driver._cloud_faults.clear()

    for fault, points, shift in (
        ("none of them finite", np.full((3, 3), np.nan), 0),
        ("a time at which the arm is measured", box, -50),
    ):
        stamp = robot.node.get_clock().now().to_msg()
        stamp.sec += shift
        publisher.publish(write_points(points, "world", stamp))
        assert graph.run(lambda fault=fault: fault in driver.reason), driver.reason
    publisher.publish(write_points(np.zeros((0, 3)), "world", robot.node.get_clock().now().to_msg()))
    assert graph.run(lambda: robot.at(target)), driver.reason

    # No cloud comes any more: it holds, or is slow; with a cloud it goes on.
    given = driver.settings
    driver.settings = replace(given, max_cloud_age=0.5)
    assert graph.run(lambda: driver.reason.startswith("the map is stale: the last cloud is")), driver.reason
    assert driver.status == "holding"
    driver.settings = replace(given, max_cloud_age=0.5, stale="slow")
    assert graph.run(lambda: driver.status != "holding"), driver.reason
    most = driver.tracker.limits.for_arm(arm).bound
    np.testing.assert_allclose(most, 0.25 * VELOCITY * DT)
    here = arm.configuration(arm.drives.joint_positions(robot.positions))
    rows = here + np.linspace(0.0, 0.3, 101)[:, None]
    driver.perform(pp.JointTrajectory.from_configurations(arm, rows, 0.04))
    performed = driver._performance
    assert performed is not None
    assert graph.run(lambda: performed.time > 0.0), driver.reason  # it waits at the start
    begun = performed.time
    cycles = driver.times.cycles
    assert graph.run(lambda: performed.time > begun + 0.1), driver.reason
    assert performed.time - begun <= 0.25 * DT * (driver.times.cycles - cycles) * (1.0 + 1e-9)
    driver.settings = replace(given, max_cloud_age=60.0)
    assert graph.run(lambda: np.allclose(driver.tracker.limits.for_arm(arm).bound, VELOCITY * DT))
    driver.settings = given
    robot.node.destroy_publisher(publisher)


def test_an_operator_leads_the_arm_and_nothing_else_does(graph: Any, driver: Driver, robot: Robot) -> None:
    from sensor_msgs.msg import JointState

    arm = driver.arm
    driver.aim(posture(arm, 0.2))  # there it leads well
    assert graph.run(lambda: robot.at(posture(arm, 0.2))), driver.reason
    control = Control()
    limits = pp.Limits(step=None, dt=DT, velocity=VELOCITY, acceleration=ACCELERATION)
    operation = Operation(arm, limits, control)
    driver.follow(operation)

    def tell(**message: Any) -> None:
        control.take("page", json.dumps(message), time.monotonic())

    def hold(until: Callable[[], Any]) -> bool:
        """Hold "back" and "up" until something is so; anew if the machine was too slow for it to count."""

        def told() -> bool:
            if control.order(time.monotonic()) is None:
                tell(do="release")
            tell(do="hold", ahead=-0.5, left=0.0, up=1.0, override=1.0)
            return bool(until())

        return graph.run(told)

    def tip() -> np.ndarray:
        return robot.points[-1]

    tell(do="ask")
    tell(do="release")
    assert graph.run(lambda: driver.reason == "nothing is held" and driver.tracker.at_rest), driver.reason
    graph.run_for(0.1)  # until the last command has arrived
    start = tip()
    graph.run_for(0.2)
    np.testing.assert_array_equal(tip(), start)
    way = 0.05 * arm.length
    assert hold(lambda: np.linalg.norm(tip() - start) > way), (driver.reason, operation.shown)
    moved = (tip() - start) / np.linalg.norm(tip() - start)
    # Joints of the robot lag behind the command, each by its own weight: 0.94 was seen on a busy machine.
    assert moved @ np.array([-0.5, 0.0, 1.0]) / np.hypot(0.5, 1.0) > 0.9

    # A posture that is sent is refused; joints that are not measured hold it, whatever is held.
    publisher = robot.node.create_publisher(JointState, f"{driver._node.get_name()}/posture", 1)
    assert hold(lambda: publisher.get_subscription_count() > 0)
    publisher.publish(JointState(name=list(arm.drives.names), position=[0.0] * arm.nv))
    words = "none while an operator or another guide leads the arm"
    assert hold(lambda: words in driver._target_fault), driver._target_fault
    robot.node.destroy_publisher(publisher)
    robot.alter = lambda message: []
    assert hold(lambda: "at most max_age" in driver.reason and driver.tracker.at_rest), driver.reason
    assert operation.shown.mode == "holds" and operation.shown.reason == driver.reason
    robot.alter = lambda message: [message]
    before = tip()
    assert hold(lambda: np.linalg.norm(tip() - before) > 0.2 * way), (driver.reason, operation.shown)

    # The page falls silent.
    assert graph.run(lambda: driver.reason.startswith("nothing was heard of the page")), driver.reason
    assert graph.run(lambda: driver.tracker.at_rest)
    graph.run_for(0.1)
    before = tip()
    graph.run_for(0.2)
    np.testing.assert_array_equal(tip(), before)
    driver._guide = None
    driver.aim(posture(arm, 0.0))
    assert graph.run(lambda: robot.at(posture(arm, 0.0))), driver.reason


def test_a_joint_that_fell_before_it_stood_is_not_locked_but_has_fallen(
    graph: Any, driver: Driver, robot: Robot
) -> None:
    assert graph.run(lambda: driver.measured is not None and driver.tracker.at_rest)
    first, second, third = driver.arm.joint_names[:3]
    stands = JointFailure(first, "stuck", 0.3, 9.0)
    before = driver.tracker.report
    patient = driver.settings
    driver.settings = replace(patient, lock_after=1.0)

    def report(failure: JointFailure) -> None:
        driver.tracker.report = before._replace(failures=(failure,))
        driver._attend_failures(driver.measured)

    report(stands._replace(kind="astray"))
    assert driver._falling == ""
    report(stands)
    assert driver._falling == first and driver._to_lock is None
    report(stands._replace(joint=third, kind="limp"))  # one at a time
    assert driver._falling == first
    report(stands._replace(joint=second))
    assert driver._to_lock == (second,)
    for name in ("locked", "fallen"):
        assert set_to(driver._node, name, "").successful
    driver._to_lock = None
    report(stands._replace(joint=third, kind="weak", duration=0.1))
    assert driver._falling == ""
    report(stands._replace(joint=third, kind="weak"))
    assert driver._falling == third
    assert set_to(driver._node, "fallen", "").successful
    driver.settings = patient
    driver.tracker.report = before
    driver._watched.astray.clear()
    driver._stuck = set()
    graph.run_for(0.1)


def test_an_operator_leads_the_arm_out_with_the_joint_that_sticks(
    graph: Any, driver: Driver, robot: Robot
) -> None:
    arm = driver.arm
    driver.aim(posture(arm, 0.2))
    assert graph.run(lambda: robot.at(posture(arm, 0.2))), driver.reason
    control = Control()
    limits = pp.Limits(step=None, dt=DT, velocity=VELOCITY, acceleration=ACCELERATION)
    operation = Operation(arm, limits, control)
    operation.goes_on = True
    driver.follow(operation)
    control.take("page", json.dumps({"do": "ask"}), time.monotonic())

    def hold(until: Callable[[], Any], patience: float = 60.0, **shares: float) -> bool:
        """Hold something until something is so; anew if the machine was too slow for it to count."""
        order = {"do": "hold", "ahead": 0.0, "left": 0.0, "up": 0.0, "override": 1.0, **shares}

        def told() -> bool:
            now = time.monotonic()
            if control.order(now) is None:
                control.take("page", json.dumps({"do": "release"}), now)
            way = operation.shown.planned.number
            control.take("page", json.dumps({**order, "way": way}), now)
            return bool(until())

        return graph.run(told, patience)

    began = dict(robot.positions)
    start = robot.points[-1]
    moved = 0.1 * arm.length
    back = {"ahead": -0.5, "up": 1.0}
    assert hold(lambda: np.linalg.norm(robot.points[-1] - start) > moved, **back), driver.reason
    before = np.array(list(robot.positions.values()))
    assert hold(lambda: np.abs(np.array(list(robot.positions.values())) - before).max() > 0.05, **back)
    steps = np.abs(np.array(list(robot.positions.values())) - before)
    failing = list(robot.positions)[int(steps.argmax())]
    stuck_at = robot.positions[failing]

    def stick(message: Any) -> list[Any]:
        message.position[list(message.name).index(failing)] = stuck_at
        return [message]

    robot.alter = stick
    assert hold(lambda: operation.arm is not arm, **back), (driver.reason, operation.shown)
    assert operation.arm.limits.lower.tolist().count(stuck_at) == 1
    whole = driver.tracker
    assert graph.run(lambda: driver.tracker is not whole), driver.reason
    assert driver.tracker.arm is operation.arm and driver.locked == {failing: stuck_at}
    words = "unchanged while an operator or another guide leads the arm"
    assert words in set_to(driver._node, "locked", "").reason
    way = operation.ways.way
    assert way is not None
    assert hold(lambda: way.at == way.end and driver.tracker.at_rest, along=1.0), (
        driver.reason,
        operation.shown,
    )
    assert graph.run(lambda: driver.tracker.at_rest)
    graph.run_for(0.1)
    for name in set(robot.positions) - {failing}:
        assert robot.positions[name] == pytest.approx(began[name], abs=0.03), name
    assert robot.positions[failing] == pytest.approx(stuck_at, abs=1e-6)
    operation.close()
    robot.alter = lambda message: [message]


class Simulator:
    """Publishes a clock of its own, joint states with efforts, and follows commands exactly."""

    def __init__(self, graph: Any, arm: pp.Arm) -> None:
        from rosgraph_msgs.msg import Clock
        from sensor_msgs.msg import JointState
        from std_msgs.msg import Float64MultiArray

        self.arm = arm
        self.graph = graph
        self.positions = np.zeros(arm.nv)
        self.extra = np.zeros(arm.nv)  # torque of contact [N m]
        self.time = 100.0
        node = graph.node("simulator")
        self.clock = node.create_publisher(Clock, "/clock", 1)
        self.states = node.create_publisher(JointState, "/simulated/joint_states", 1)
        commands = "/simulated/position_controller/commands"
        node.create_subscription(Float64MultiArray, commands, self._move, 1)

    def _move(self, message: Any) -> None:
        self.positions = np.array(message.data)

    def run(self, until: Callable[[], Any], patience: float = 60.0) -> bool:
        """Let simulated time pass until something is so, or the patience [s] is at its end."""
        from builtin_interfaces.msg import Time
        from rosgraph_msgs.msg import Clock
        from sensor_msgs.msg import JointState

        end = self.time + patience
        while not until() and self.time < end:
            self.time += DT
            stamp = Time(sec=int(self.time), nanosec=int(1e9 * (self.time - int(self.time))))
            q = self.arm.configuration(self.positions)
            torques = self.arm.drives.torques(self.arm.at(q).gravity_torques) + self.extra
            message = JointState(name=list(self.arm.drives.names), position=self.positions.tolist())
            message.effort = torques.tolist()
            message.header.stamp = stamp
            self.states.publish(message)
            self.clock.publish(Clock(clock=stamp))
            self.graph.run_for(0.005)
        return bool(until())


def test_a_driver_follows_the_clock_of_a_simulation_also_back_and_feels_a_touch(
    graph: Any, arm: pp.Arm
) -> None:
    settings = DriverSettings(rate=1.0 / DT, command="positions", touch=pp.Touch(0.2))
    limits = pp.Limits(dt=1.0, velocity=VELOCITY, acceleration=ACCELERATION)
    given = ("--ros-args", "-r", "__ns:=/simulated", "-p", "use_sim_time:=true", "-p", "max_age:=0.2")
    driver = Driver(graph.node("clocked", *given), arm, settings, limits=limits)
    assert driver.settings.max_age == 0.2  # the parameter counts
    simulator = Simulator(graph, arm)

    def at(bend: float) -> bool:
        return bool(np.abs(simulator.positions - bend).max() < 1e-3)

    driver.aim(posture(arm, 0.3))
    assert simulator.run(lambda: at(0.3)), driver.reason
    cycles = driver.times.cycles
    graph.run_for(0.3)
    assert driver.times.cycles <= cycles + 1  # time stands still
    simulator.time = 20.0
    driver.aim(posture(arm, -0.3))
    assert simulator.run(lambda: at(-0.3)), driver.reason

    simulator.extra[2] = 1.0
    assert simulator.run(lambda: driver.reason.startswith("something touches the arm")), driver.reason
    assert arm.drives.names[2] in driver.reason
    simulator.extra[:] = 0.0
    driver.aim(posture(arm, 0.0))
    assert not simulator.run(lambda: at(0.0), 3.0)  # it goes on only when it is told to
    for hold in (True, False):
        assert set_to(driver._node, "hold", hold).successful
    assert simulator.run(lambda: at(0.0)), driver.reason
    driver.close()
