"""A simulated robot as a node: soft servos, encoders, other sensors, late messages, joints that fail."""

from __future__ import annotations

from collections import deque
from dataclasses import replace
from typing import Annotated, Any, Literal

import numpy as np
import pinocchio as pin
from numpy.typing import ArrayLike, NDArray

from pinposture._validation import require_instance, require_known, require_positive
from pinposture.arm import Arm
from pinposture.collision import Scene
from pinposture.errors import PostureError
from pinposture.motion.ros import NANOSECONDS, stamp_of, world_frame
from pinposture.motion.shape_estimator import SIDES
from pinposture.ros2.clouds import write_points
from pinposture.ros2.driver import COMMANDS
from pinposture.ros2.graph import latest_only, sensor_data
from pinposture.schema import AS_GIVEN, CheckedBy, Declared, Flag, declared, one_of
from pinposture.sim.camera import DepthCamera, TipCamera
from pinposture.sim.link_sensors import LinkSensing, LinkSensors
from pinposture.sim.model import Servos, build_plant_model
from pinposture.sim.plant import FAILURES, Plant, Sensing, Sensors

Array = NDArray[np.float64]


@declared()
class RobotSettings(Declared):
    """How a simulated robot works.

    Attributes:
        rate: number of control cycles, and of messages of JointState, per second [Hz].
        servos: its servos.
        sensing: its joint sensors; `latency` counts cycles, and stamps tell when a message was measured.
        encoders: where the joint sensors are: "joint", or "motor": they tell the set points of the servos,
            and not how far these give way.
        links: the sensors on links.
        camera: the depth camera at the tip; None: there is none.
        camera_rate: number of clouds per second [Hz].
        clock: whether the time of the simulation is published on `/clock`, for nodes with `use_sim_time`.

    Raises:
        InvalidValue: a rate that is not positive.
        UnknownName: another place of joint sensors.
    """

    rate: Annotated[float, CheckedBy(require_positive)] = 100.0
    servos: Annotated[Servos, AS_GIVEN] = Servos()
    sensing: Annotated[Sensing, AS_GIVEN] = Sensing()
    encoders: Annotated[Literal["joint", "motor"], one_of("side of encoders", *SIDES)] = "joint"
    links: Annotated[LinkSensing, AS_GIVEN] = LinkSensing()
    camera: Annotated[DepthCamera | None, AS_GIVEN] = None
    camera_rate: Annotated[float, CheckedBy(require_positive)] = 5.0
    clock: Flag = False


class CommandedMotion:
    """The set points of joints between the points of a trajectory, as joint_trajectory_controller has them.

    Between points they move at constant speed.

    Attributes:
        names: names of the joints, in the order of positions.

    Args:
        names: names of the joints.
        positions: where they are, (nv,) [rad or m].
    """

    def __init__(self, names: tuple[str, ...], positions: Array) -> None:
        self.names = names
        self._times = np.zeros(1)
        self._rows = positions[None]

    def at(self, time: float) -> Array:
        """Return the set points at a time [s], (nv,) [rad or m]."""
        return np.array([np.interp(time, self._times, column) for column in self._rows.T])

    def move_to(self, positions: ArrayLike, time: float) -> None:
        """Move to positions, (nv,) [rad or m], at once, at a time [s]."""
        self._times = np.array([time])
        self._rows = np.array(positions, dtype=np.float64)[None]

    def follow(self, message: Any, begin: float, now: float) -> str:
        """Follow a trajectory, from where the joints are to be now.

        Args:
            message: a `trajectory_msgs/msg/JointTrajectory`.
            begin: time from which its points count [s].
            now: the time [s].

        Returns:
            Why it is refused; empty if it is not.
        """
        names = list(message.joint_names)
        if sorted(names) != sorted(self.names):
            return f"joint_names are {names}; allowed: {list(self.names)}, in any order"
        points = message.points
        if not points or any(len(point.positions) != len(names) for point in points):
            return "allowed: at least one point, each with a position for each joint"
        order = [names.index(name) for name in self.names]
        rows = np.array([np.array(point.positions)[order] for point in points])
        delays = [point.time_from_start for point in points]
        times = begin + np.array([delay.sec + delay.nanosec / NANOSECONDS for delay in delays])
        if not np.all(np.isfinite(rows)) or np.any(np.diff([now, *times]) <= 0.0):
            return "allowed: finite positions, at increasing times from now on"
        self._rows = np.vstack([self.at(now), rows])
        self._times = np.array([now, *times])
        return ""


class SimulatedRobot:
    """A node that behaves as a robot with ros2_control, simulated by MuJoCo in real time.

        with open_node("robot") as node:
            robot = SimulatedRobot(node, arm, scene, RobotSettings(servos=Servos(frequency=4.0)))
            spin(node, robot.stop, robot.done)

    It publishes `joint_states` (JointState, with efforts if `Sensing` measures torques), with a camera
    `points` (PointCloud2, in the frame of the tip link), and with `LinkSensing` `imu` (Imu, in the frame of
    each link) and `tip_pose` (PoseStamped, in the frame of the world). It takes commands of both kinds, on
    the topics of `COMMANDS`.

    Parameters of the node, which can be changed at any time: `stuck`, `limp` and `weak`, names of joints that
    fail as `Plant.fail` says, separated by commas; `latency`, by which messages of joints and links come late
    [s]; `silent`, whether those of joints do not come at all; `missing`, names of joints, and of links with
    other sensors, that are left out of messages.

    Attributes:
        arm: the arm.
        plant: the simulation.
        refused: why the last command was refused; empty if it was not.

    Args:
        node: the node, of rclpy.
        arm: the arm, from a URDF or from modules.
        scene: what the camera sees; None: nothing.
        settings: how the robot works; None: `RobotSettings()`.
        q0: where it starts, (nq,), at rest; None: straight.

    Raises:
        MujocoMissing: MuJoCo is not installed.
        PostureError: the arm cannot be simulated, as `build_plant_model` says, or q0 or a parameter is
            invalid.
    """

    def __init__(
        self,
        node: Any,
        arm: Arm,
        scene: Scene | None = None,
        settings: RobotSettings | None = None,
        q0: ArrayLike | None = None,
    ) -> None:
        require_instance("arm", arm, Arm, "an Arm")
        self.arm = arm
        self.refused = ""
        self._settings = settings or RobotSettings()
        self._node = node
        dt = 1.0 / self._settings.rate
        start = arm.straight() if q0 is None else arm.checked_start(q0, "q0")
        positions = arm.drives.positions(arm.positions(start))
        self.plant = Plant(build_plant_model(arm, self._settings.servos), positions, dt)
        self._motion = CommandedMotion(arm.drives.names, positions)
        self._sensors = Sensors(replace(self._settings.sensing, latency=0))
        self._latency = self._settings.sensing.latency * dt
        self._silent = False
        self._missing: frozenset[str] = frozenset()
        self._late: deque[tuple[float, Any, Any]] = deque()
        self._links = LinkSensors(arm, self._settings.links, dt)
        self._read_links = 0
        self._camera = None
        if self._settings.camera is not None:
            self._camera = TipCamera(arm, scene or Scene(), self._settings.camera)
        self._clouds = 0
        self._stopped = False
        self._connect(node)
        self._begun = self._steady.now().nanoseconds
        self._epoch = NANOSECONDS if self._settings.clock else int(node.get_clock().now().nanoseconds)

    def _connect(self, node: Any) -> None:
        """Declare parameters; create publishers, subscriptions and the timer."""
        from geometry_msgs.msg import PoseStamped
        from rclpy.clock import Clock, ClockType
        from rosgraph_msgs.msg import Clock as ClockMessage
        from sensor_msgs.msg import Imu, JointState, PointCloud2
        from std_msgs.msg import Float64MultiArray
        from trajectory_msgs.msg import JointTrajectory

        names = dict.fromkeys((*FAILURES, "missing"), "")
        parameters = {**names, "latency": self._latency, "silent": False}
        for name, value in parameters.items():
            node.declare_parameter(name, value)
        node.add_on_set_parameters_callback(self._change_parameters)
        begun = self._change_parameters(node.get_parameters(list(parameters)))
        if not begun.successful:
            raise PostureError(begun.reason)
        reliable = latest_only(True)
        self._states = node.create_publisher(JointState, "joint_states", reliable)
        self._points = node.create_publisher(PointCloud2, "points", reliable)
        self._imus = node.create_publisher(Imu, "imu", sensor_data())
        self._tips = node.create_publisher(PoseStamped, "tip_pose", sensor_data())
        self._ticks = (
            node.create_publisher(ClockMessage, "/clock", reliable) if self._settings.clock else None
        )
        node.create_subscription(JointTrajectory, COMMANDS["trajectory"], self._take_trajectory, reliable)
        node.create_subscription(Float64MultiArray, COMMANDS["positions"], self._take_positions, reliable)
        steady = Clock(clock_type=ClockType.STEADY_TIME)
        node.create_timer(self.plant.dt, self._advance, clock=steady)
        self._steady = steady

    def _change_parameters(self, parameters: list[Any]) -> Any:
        from rcl_interfaces.msg import SetParametersResult

        changed = {parameter.name: parameter.value for parameter in parameters}
        given = {key: changed.get(key, self._node.get_parameter(key).value) for key in (*FAILURES, "missing")}
        names = {
            key: [name.strip() for name in text.split(",") if name.strip()] for key, text in given.items()
        }
        known = (*self.arm.drives.names, *self._links.links, self.arm.tip)
        try:
            for name in names["missing"]:
                require_known("joint or link with sensors", name, known)
            self.plant.fail(*(names[key] for key in FAILURES))
        except PostureError as error:
            return SetParametersResult(successful=False, reason=str(error))
        self._missing = frozenset(names["missing"])
        self._latency = changed.get("latency", self._latency)
        self._silent = changed.get("silent", self._silent)
        return SetParametersResult(successful=True)

    @property
    def time(self) -> float:
        """Time of the simulation [s]."""
        return self.plant.cycles * self.plant.dt

    def _take_trajectory(self, message: Any) -> None:
        stamp = stamp_of(message)
        begin = (stamp - self._epoch) / NANOSECONDS if stamp else self.time
        self.refused = self._motion.follow(message, begin, self.time)
        if self.refused:
            self._node.get_logger().error(f"a trajectory is refused: {self.refused}")

    def _take_positions(self, message: Any) -> None:
        positions = np.array(message.data, dtype=np.float64)
        self.refused = ""
        if positions.shape != (self.arm.nv,) or not np.all(np.isfinite(positions)):
            self.refused = f"positions are {positions.tolist()}; allowed: {self.arm.nv} finite numbers"
            self._node.get_logger().error(self.refused)
            return
        self._motion.move_to(positions, self.time)

    def _advance(self) -> None:
        """Simulate the cycles that are due, and publish what is measured."""
        passed = (self._steady.now().nanoseconds - self._begun) / NANOSECONDS
        due = int(passed * self._settings.rate) - self.plant.cycles
        if due > 5:  # it does not catch up with more than these at once; the time is lost
            lost = round((due - 1) * self.plant.dt * NANOSECONDS)
            self._begun += lost
            self._epoch += 0 if self._settings.clock else lost
            due = 1
        for _ in range(due):
            if not self.cycle():
                self._node.get_logger().error(self.plant.failure)
                self._stopped = True
                return

    def cycle(self) -> bool:
        """Simulate a cycle, and publish what is measured; return False if the arm runs away.

        The timer of the node does it in real time. Cancel that to set the pace yourself.
        """
        if not self.plant.advance(self._motion.at(self.time + self.plant.dt)):
            return False
        self._measure()
        self._measure_links()
        self._look()
        self._deliver()
        return True

    @property
    def _stamp(self) -> Any:
        """The time of the simulation as a `builtin_interfaces/msg/Time`."""
        from builtin_interfaces.msg import Time as TimeMessage

        seconds, nanoseconds = divmod(self._epoch + round(self.time * NANOSECONDS), NANOSECONDS)
        return TimeMessage(sec=seconds, nanosec=nanoseconds)

    def _measure(self) -> None:
        """Read the sensors of the joints, if they deliver in this cycle."""
        from rosgraph_msgs.msg import Clock as ClockMessage
        from sensor_msgs.msg import JointState

        if self._ticks is not None:
            self._ticks.publish(ClockMessage(clock=self._stamp))
        plant = self.plant
        positions = plant.positions if self._settings.encoders == "joint" else plant.set_points
        measured = self._sensors.measure(positions, plant.torques)
        if measured is None or self._silent:
            return
        names = self.arm.drives.names
        there = [k for k, name in enumerate(names) if name not in self._missing]
        message = JointState(name=[names[k] for k in there], position=measured[there].tolist())
        message.header.stamp = self._stamp
        if self._sensors.torques is not None:
            message.effort = self._sensors.torques[there].tolist()
        self._late.append((self.time + self._latency, self._states, message))

    def _measure_links(self) -> None:
        """Read the sensors on the links, if it is time."""
        from geometry_msgs.msg import PoseStamped
        from sensor_msgs.msg import Imu

        links = self._links
        if not (links.sensing.imus or links.sensing.tip_pose):
            return
        links.move(self._configuration)
        if self.time * links.sensing.rate < self._read_links:
            return
        self._read_links = int(self.time * links.sensing.rate) + 1
        due = self.time + self._latency
        variance = links.sensing.imu_noise**2
        for reading in links.read_inertial():
            message = Imu()
            message.header.frame_id = reading.link
            message.header.stamp = self._stamp
            _set(message.orientation, pin.Quaternion(reading.rotation).coeffs())
            _set(message.angular_velocity, reading.velocity)
            _set(message.linear_acceleration, reading.acceleration)
            message.orientation_covariance = (variance * np.eye(3)).ravel()
            if reading.link not in self._missing:
                self._late.append((due, self._imus, message))
        placement = links.read_tip()
        if placement is not None and self.arm.tip not in self._missing:
            pose = PoseStamped()
            pose.header.frame_id = world_frame(self.arm)
            pose.header.stamp = self._stamp
            _set(pose.pose.position, placement.translation)
            _set(pose.pose.orientation, pin.Quaternion(placement.rotation).coeffs())
            self._late.append((due, self._tips, pose))

    @property
    def _configuration(self) -> Array:
        """The configuration of the simulated arm, (nq,)."""
        return self.arm.configuration(self.arm.drives.joint_positions(self.plant.positions))

    def _deliver(self) -> None:
        """Publish the messages whose time has come."""
        while self._late and self._late[0][0] <= self.time:
            _, publisher, message = self._late.popleft()
            publisher.publish(message)

    def _look(self) -> None:
        """Publish a cloud, if it is time."""
        if self._camera is None or self.time * self._settings.camera_rate < self._clouds:
            return
        self._clouds = int(self.time * self._settings.camera_rate) + 1
        seen = self._camera.look(self._configuration)
        self._points.publish(write_points(seen, self.arm.tip, self._stamp))

    def stop(self) -> None:
        """End; the servos hold nothing any more, as nothing is simulated."""
        self._stopped = True

    def done(self) -> bool:
        """Return whether the robot was stopped, or the simulation failed."""
        return self._stopped


def _set(part: Any, values: Array) -> None:
    """Set the numbers x, y, z, and w if there is one, of a part of a message."""
    for name, value in zip("xyzw", values.tolist(), strict=False):
        setattr(part, name, value)
