"""The driver: a node that moves an arm to the targets it is given, from measured joints, in closed loop."""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from functools import cached_property
from math import inf
from queue import Empty, SimpleQueue
from threading import Event
from typing import Annotated, Any, Literal, NamedTuple, Protocol

import numpy as np
from numpy.typing import NDArray

from pinposture._validation import require_instance, require_known, require_positive
from pinposture.arm import Arm
from pinposture.collision import Map, Scene
from pinposture.collision.mapping import MAPPING, SEEN
from pinposture.collision.model import describe_distance, effective_scene
from pinposture.control import Geodesic, Limits
from pinposture.curve import Curve
from pinposture.errors import InvalidValue, PostureError
from pinposture.motion import Actuators, JointTrajectory, Report, Touch, Tracker
from pinposture.motion.latest import Done, Latest
from pinposture.motion.ros import NANOSECONDS, stamp_of
from pinposture.placement import Target, resolve_targets
from pinposture.ros2.clouds import CloudFrames, read_points
from pinposture.ros2.diagnostics import CycleTimes, Occurrences, diagnostics
from pinposture.ros2.failures import POLLING, Fallback, FallbackSearch, Locked, as_possible
from pinposture.ros2.graph import latest_only, sensor_data
from pinposture.ros2.joint_readings import JointMeasurement, JointReadings, RobotDrives
from pinposture.ros2.shape_readings import FAULTS, ShapeReadings, ShapeSensing
from pinposture.schema import AS_GIVEN, CheckedBy, Declared, Duration, Length, declared, one_of
from pinposture.sim import set_points
from pinposture.task.carrier_feed import CarriedDrives, CarrierClearance, CarrierFeed
from pinposture.task.falling import FALLING, FailureWatch, Fallen, require_falling, take_fallen
from pinposture.task.retreat import WayIn

Array = NDArray[np.float64]

COMMANDS = {
    "trajectory": "joint_trajectory_controller/joint_trajectory",
    "positions": "position_controller/commands",
}
"""Topics of the commands, by their kind."""


class DriverTimes(NamedTuple):
    """How fast the driver moves where nothing is given, and how often it looks."""

    velocity: float = 1.0
    """Limit of joints for which none is given, in `Arm.joint_units` per s: slow enough to watch."""

    acceleration: float = 2.0
    """The same, in `Arm.joint_units` per s^2."""

    stale_speed: float = 0.25
    """Share of the limits of velocity with which an arm moves on a stale map, if it does not hold."""

    short_cycle: float = 0.8
    """Share of the nominal cycle time below which a cycle moves less. Cycles of a node vary by a
    millisecond."""

    arrived: float = 0.01
    """Mean distance of the control points from the start of a motion at which it begins, in arm lengths, once
    the arm rests there: soft or sticking drives stop short of it."""

    diagnostics: float = 1.0
    """Time between messages of diagnostics, if nothing changes [s], as ROS tools expect."""

    fallback: float = 1.0
    """Time between two looks at what is possible without locked joints [s], as for targets that are
    streamed."""

    standstill: float = 2.0
    """Time without a cycle after which a driver that shall end does not wait for one any longer [s]. Cycles
    stop with the clock of a simulation."""


DRIVER = DriverTimes()

LED = "the operator leads the arm out"
"""What is possible without locked joints, where a guide has locked them."""


@declared()
class DriverSettings(Declared):
    """How a driver works.

    Attributes:
        rate: number of cycles per second [Hz].
        command: what is sent. "trajectory": a `trajectory_msgs/msg/JointTrajectory` with one point per cycle,
            as `joint_trajectory_controller` of ros2_control takes it. "positions": a
            `std_msgs/msg/Float64MultiArray`, as `JointGroupPositionController` and
            `forward_command_controller` take it, with the joints in the order of `Arm.drives`.
        max_age: age above which measured joint positions do not count, and the arm holds [s].
        cloud_resolution: edge length of the cells of the map of point clouds [m]; None: 2 % of the length of
            the arm.
        forget: time constant with which the map forgets what is not seen again [s]; None: it does not.
        touch: how to notice from measured efforts that something touches the arm; None: it is not noticed.
        sensing: what other sensors tell the shape; None: the encoders of all joints alone do.
        feed: what moves in place of the first joint of the arm, a slide: a robot that carries the arm, or a
            drum (`load_feed`). Its joints are measured and commanded, and the arm keeps clear of the robot.
            None: the slide moves.
        lock_after: time for which a joint has to stick before it is locked, and the arm goes on without it
            [s]; None: the arm holds until the joint moves. One that was astray before is not locked, but
            taken for limp or weak (`fallen`).
        max_cloud_age: age of the last cloud above which the map is stale [s], once there was one; None: it
            never is.
        stale: what the arm does on a stale map: "hold", or "slow": it moves with a quarter of its speed.

    Raises:
        InvalidValue: a number that is not positive.
        UnknownName: another kind of command, or another thing to do on a stale map.
    """

    rate: Annotated[float, CheckedBy(require_positive)] = 100.0
    command: Annotated[Literal["trajectory", "positions"], one_of("command", *COMMANDS)] = "trajectory"
    max_age: Duration = 0.1
    cloud_resolution: Length | None = None
    forget: Duration | None = None
    touch: Annotated[Touch | None, AS_GIVEN] = None
    sensing: Annotated[ShapeSensing | None, AS_GIVEN] = None
    feed: Annotated[CarrierFeed | Actuators | None, AS_GIVEN] = None
    lock_after: Duration | None = None
    max_cloud_age: Duration | None = None
    stale: Annotated[Literal["hold", "slow"], one_of("stale", "hold", "slow")] = "hold"


def usual_limits(arm: Arm, dt: float) -> Limits:
    """Return limits for an arm of which none are given, with a cycle time [s]: those of its description.

    Joints without a limit of velocity get `DRIVER.velocity`, and all get `DRIVER.acceleration`.
    """
    described = arm.limits.velocity
    velocity = np.where(np.isfinite(described), described, DRIVER.velocity * arm.joint_units)
    return Limits(step=None, dt=dt, velocity=velocity, acceleration=DRIVER.acceleration * arm.joint_units)


class Cloud(NamedTuple):
    """A cloud that the joints have been measured for.

    Attributes:
        points: the points, (n, 3) [m], in its frame.
        time: when it was taken [s].
    """

    points: Array
    time: float


class Guide(Protocol):
    """What leads an arm cycle by cycle, in place of targets that it is sent."""

    @property
    def arm(self) -> Arm:
        """The arm that it leads: that of the driver, or with joints locked that are stuck."""

    def lead(
        self,
        tracker: Tracker,
        measured: Array | None,
        scene: Scene,
        dt: float,
        held: str = "",
        speed: float = 1.0,
    ) -> str:
        """Set the target of a tracker for a cycle, as `pinposture.operate.Operation.lead`.

        Returns:
            Why the arm has to brake and hold; empty if it may move.
        """


class Performance:
    """A motion that the arm performs as fast as it follows: it waits at the start, and where the arm holds.

    Attributes:
        time: time in the motion [s].

    Args:
        arm: the arm.
        motion: the motion, sampled at the cycle time.
    """

    def __init__(self, arm: Arm, motion: JointTrajectory) -> None:
        points = set_points(arm, motion)
        self.time = 0.0
        self._arm = arm
        self._target_at = points.targets(arm)
        self._begun = False

    def advance(self, report: Report, dt: float) -> Target:
        """Return the posture for the end of a cycle, in which a time passes [s], after the last report."""
        near = report.mean_error is not None and report.mean_error <= DRIVER.arrived * self._arm.length
        if report.status in ("converged", "stalled") and near:
            self._begun = True
        if self._begun and (
            report.status in ("moving", "converged") or (near and report.status == "stalled")
        ):
            self.time += dt
        return self._target_at(self.time)


class Driver:
    """A node that moves an arm to its latest target, by a `Tracker`.

        with open_node("pinposture") as node:
            driver = Driver(node, arm)
            driver.aim(target)
            spin(node, driver.stop, driver.done)

    It subscribes to `joint_states` (JointState), what `ShapeSensing` names, `points` (PointCloud2), `~/path`
    (Path: a curve through its points, in place, in the frame of the world or of the base), and `~/posture`
    (JointState: positions to move to); it publishes commands on a topic of `COMMANDS`, and `/diagnostics`.
    Names of topics can be remapped, as in all of ROS.

    Parameters of the node are the settings and `velocity`, `acceleration`, `jerk` [rad, m, s], with 0 for
    what was given at the start, and `hold`: the arm brakes and holds while it is true, and starts from where
    it is measured when it is set to false. `locked` names joints that are left where they are, separated by
    commas; joints that stick are added after `lock_after`. The arm then goes on to its target as nearly as
    the others can, and diagnostics tell how near, and whether there is a way out. With `retreat` it comes out
    by that way, to where it was when the driver began. `fallen` names a joint that is limp or weak: the arm
    holds, and can only come out. `max_age`, `hold`, `locked`, `fallen`, `retreat` and the limits can be
    changed at any time.

    The arm brakes and holds within its limits while measurements are missing, old, from the future or not
    finite, and while a cloud cannot be used: its frame is unknown, no point is finite, or the joints were not
    measured at its time. Diagnostics give the reason.

    Clouds are kept in a `Map`, which leaves out the arm itself, and forgets what a sensor sees through. The
    sensor is at the origin of the link in whose frame the points are.

    Attributes:
        arm: the arm.
        settings: its settings, with parameters of the node in place of what was given.
        tracker: what computes the steps; another one when joints are locked.
        locked: positions of the joints that are locked, by name [rad or m].
        times: how punctual the cycles are.
        measured: the configuration in the last cycle, as measured or estimated, (nq,); None if not known.
        status: that of the last cycle, as in `Report`.
        reason: why it is so; empty if all is well.

    Args:
        node: the node, of rclpy.
        arm: the arm.
        settings: how the driver works; None: `DriverSettings()`.
        limits: the limits of the motion, of which the cycle time is that of the settings; None: those of
            the description, and `DRIVER.velocity` and `DRIVER.acceleration` where it has none.
        scene: obstacles that are known; None: the arm has only itself to keep clear of.

    Raises:
        PostureError: settings, parameters or limits that are refused; see also `Tracker`.
    """

    def __init__(
        self,
        node: Any,
        arm: Arm,
        settings: DriverSettings | None = None,
        *,
        limits: Limits | None = None,
        scene: Scene | None = None,
    ) -> None:
        require_instance("arm", arm, Arm, "an Arm")
        self.arm = arm
        self._node = node
        self._retreats = False
        self._falling = ""  # name of a joint that is limp or weak
        self._to_lock: tuple[str, ...] | None = None  # names, until the joints are measured
        self._given = self._declare_parameters(settings or DriverSettings(), limits)
        self._frames = CloudFrames(arm)
        self._map = self._new_map()
        self._mapped_until = 0  # the last time at which the joints were measured [ns]
        known = effective_scene(arm, scene)
        self._scene = replace(known, obstacles={**known.obstacles, SEEN: self._map.cells})
        self._period = 1.0 / self.settings.rate
        self._speed = 1.0  # share of the limits of velocity
        self.tracker = self._new_tracker(arm, self._scene)
        self.locked: dict[str, float] = {}
        self.times = CycleTimes(self._period)
        self.measured: Array | None = None
        self.status = "holding"
        self.reason = "no cycle yet"
        sensing = self.settings.sensing
        self._shape = None if sensing is None else ShapeReadings(arm, self.settings.max_age, sensing)
        self._joints = self._shape or JointReadings(arm, self.settings.max_age, self._drives)
        self._sent: Array | None = None  # positions that were sent last
        self._performance: Performance | None = None
        self._guide: Guide | None = None
        self._located = False  # it is not known yet where the arm is
        self._stopping = False
        self._last_cycle = time.monotonic()
        self._posted: SimpleQueue[Callable[[], None]] = SimpleQueue()
        self._cloud_faults: dict[str, str] = {}
        self._seen_at: float | None = None  # time of the last cloud in the map [s]
        self._waiting: dict[str, Any] = {}
        self._reading: Latest[dict[str, Cloud], dict[str, str]] = Latest(
            self._read_clouds, "pinposture-clouds", deliver=self._take_faults, merge=lambda a, b: a | b
        )
        self._placing: Latest[Curve, Target] = Latest(self._place, "pinposture-path", deliver=self._deliver)
        self._fallbacks = FallbackSearch()
        self._fallback = ""
        self._preparing = ""
        self._wanted: Mapping[str, float] = self.locked
        self._ahead: Latest[Locked, Fallback] = Latest(
            self._look_ahead, "pinposture-fallback", deliver=self._pass_fallback_on, period=DRIVER.fallback
        )
        self._way_in = WayIn(arm)
        self._stuck: set[str] = set()  # that cannot be locked
        self._watched = FailureWatch(arm)
        self._fallen: Fallen | None = None  # once it has come to rest
        self._target_fault = ""
        self._occurrences = Occurrences()  # of reasons why the arm does not move as it shall
        self._connect(node)

    @cached_property
    def _drives(self) -> RobotDrives | None:
        """What is measured and commanded in place of the joints of the arm; None: they are."""
        feed = self.settings.feed
        allowed = "a CarrierFeed, the Actuators of the arm, or None"
        require_instance("feed", feed, CarrierFeed | Actuators | None, allowed)
        if feed is not None and (self.settings.sensing is not None or self.settings.touch is not None):
            raise InvalidValue("feed", feed, "None with sensors of the shape or touch: efforts are not known")
        if isinstance(feed, Actuators) and feed.arm is not self.arm:
            raise InvalidValue("feed", feed.arm, "the actuators of the arm of the driver")
        return CarriedDrives(feed, self.arm) if isinstance(feed, CarrierFeed) else feed

    @cached_property
    def _beside(self) -> CarrierClearance | None:
        """What keeps the robot that carries the arm clear of it and of obstacles; None: none does."""
        feed = self.settings.feed
        if not isinstance(feed, CarrierFeed):
            return None
        return CarrierClearance(feed, self.arm, self._scene.margin, self._scene)

    def _new_tracker(self, arm: Arm, scene: Scene) -> Tracker:
        """Return a tracker of the arm, of which some joints may be locked; takes seconds."""
        return Tracker(
            arm,
            Geodesic(constraints=() if self._beside is None else (self._beside,)),
            limits=self._limits({}),
            scene=scene,
            deadline=0.5 * self._period,
            touch=self.settings.touch,
        )

    # Parameters.

    def _declare_parameters(self, settings: DriverSettings, limits: Limits | None) -> Limits:
        """Declare the parameters, and set the settings; return the limits that 0 stands for."""
        from rcl_interfaces.msg import ParameterDescriptor
        from rclpy.exceptions import ParameterException

        def declare(name: str, value: Any, words: str, read_only: bool = False) -> Any:
            described = ParameterDescriptor(description=words, read_only=read_only)
            try:
                return self._node.declare_parameter(name, value, described).value
            except ParameterException as error:  # another type, such as 50 for 50.0
                raise PostureError(str(error)) from error

        def declare_optional(name: str, value: float | None, words: str) -> float | None:
            number = declare(name, value or 0.0, words, True)
            return None if number == 0.0 else float(number)

        self.settings = DriverSettings(
            rate=declare("rate", settings.rate, "cycles per second", True),
            command=declare("command", settings.command, "trajectory or positions", True),
            max_age=declare("max_age", settings.max_age, "age above which joint states do not count [s]"),
            cloud_resolution=declare_optional(
                "cloud_resolution",
                settings.cloud_resolution,
                "edge length of the cells of the map [m]; 0: 2 % of the length of the arm",
            ),
            forget=declare_optional(
                "forget", settings.forget, "time constant of the map [s]; 0: it forgets nothing"
            ),
            touch=settings.touch,
            sensing=settings.sensing,
            feed=settings.feed,
            lock_after=declare_optional(
                "lock_after",
                settings.lock_after,
                "time after which a stuck joint is locked [s]; 0: never",
            ),
            max_cloud_age=declare_optional(
                "max_cloud_age", settings.max_cloud_age, "age of clouds that makes the map stale [s]; 0: none"
            ),
            stale=declare("stale", settings.stale, "hold or slow: what to do on a stale map", True),
        )
        self._bounds = {
            name: declare(name, 0.0, f"limit of all joints [{unit}]; 0: as given at the start")
            for name, unit in (("velocity", "1/s"), ("acceleration", "1/s^2"), ("jerk", "1/s^3"))
        }
        self._hold = declare("hold", False, "whether the arm brakes and holds")
        self._to_lock = self._lockable(declare("locked", "", "joints that are left where they are")) or None
        self._falling = self._require_falling(declare("fallen", "", "joint that is limp or weak"))
        declare("retreat", False, "whether the arm comes out without its locked joints, or with a fallen one")
        dt = 1.0 / self.settings.rate
        return usual_limits(self.arm, dt) if limits is None else replace(limits, dt=dt)

    def _limits(self, changes: dict[str, float]) -> Limits:
        """Return the limits with parameters, of which some are changed."""
        bounds = {name: value for name, value in (self._bounds | changes).items() if value != 0.0}
        limits = replace(self._given, **bounds)
        if self._drives is not None:
            limits = self._drives.limits(limits)
        if self._speed == 1.0:
            return limits
        return replace(limits, velocity=self._speed * limits.for_arm(self.arm).bound * self.settings.rate)

    def _change_parameters(self, parameters: list[Any]) -> Any:
        """Let changed parameters take effect; those that are refused leave all as they were."""
        from rcl_interfaces.msg import SetParametersResult

        changed = {parameter.name: parameter.value for parameter in parameters}
        bounds = {name: value for name, value in changed.items() if name in self._bounds}
        try:
            settings = replace(self.settings, max_age=changed.get("max_age", self.settings.max_age))
            for name in changed.keys() & {"locked", "fallen"}:
                if self._guide is not None:
                    allowed = "unchanged while an operator or another guide leads the arm"
                    raise InvalidValue(name, changed[name], allowed)
            to_lock = self._lockable(changed.get("locked", ""))
            falling = self._require_falling(changed.get("fallen", self._falling))
            if changed.get("retreat", False) and not self._retreats:
                self._require_way_in()
            if bounds:
                self.tracker.limits = self._limits(bounds)
        except PostureError as error:
            return SetParametersResult(successful=False, reason=str(error))
        if "locked" in changed:
            self._to_lock = to_lock
        if falling != self._falling:
            self._watched.forget(self._falling)
            self._falling = falling
            self._posted.put(self._change_fallen)
        if changed.get("retreat", self._retreats) != self._retreats:
            self._retreats = changed["retreat"]
            self._posted.put(self._change_retreat)
        self._bounds |= bounds
        self.settings = settings
        self._joints.max_age = settings.max_age
        hold = changed.get("hold", self._hold)
        if self._hold and not hold:
            self._posted.put(self._restart)
        self._hold = hold
        return SetParametersResult(successful=True)

    # What comes and goes.

    def _connect(self, node: Any) -> None:
        """Create publishers, subscriptions and timers."""
        from diagnostic_msgs.msg import DiagnosticArray
        from nav_msgs.msg import Path
        from sensor_msgs.msg import JointState, PointCloud2
        from std_msgs.msg import Float64MultiArray
        from trajectory_msgs.msg import JointTrajectory as JointTrajectoryMessage

        kind = JointTrajectoryMessage if self.settings.command == "trajectory" else Float64MultiArray
        reliable = latest_only(True)
        self._commands = node.create_publisher(kind, COMMANDS[self.settings.command], reliable)
        self._diagnostics = node.create_publisher(DiagnosticArray, "/diagnostics", 10)
        self._sensors = [
            node.create_subscription(
                JointState, "joint_states", self._take_by(self._joints.take), sensor_data()
            )
        ]
        if self._shape is not None:
            self._connect_sensing(node, self._shape)
        node.create_subscription(PointCloud2, "points", self._take_cloud, latest_only(False))
        node.create_subscription(Path, "~/path", self._take_path, reliable)
        node.create_subscription(JointState, "~/posture", self._take_posture, reliable)
        node.add_on_set_parameters_callback(self._change_parameters)
        node.create_timer(self._period, self._cycle)
        node.create_timer(DRIVER.diagnostics, self._diagnose)

    def _now(self) -> int:
        """Return the time of the node [ns], which may be that of a simulation."""
        now: int = self._node.get_clock().now().nanoseconds
        return now

    def _connect_sensing(self, node: Any, shape: ShapeReadings) -> None:
        """Create the subscriptions of the sensors of the shape."""
        from geometry_msgs.msg import PoseStamped
        from rclpy.exceptions import NameValidationException
        from sensor_msgs.msg import Imu

        sensing = shape.sensing
        imus = [(Imu, topic, shape.take_imu) for topic in sensing.imus]
        tip = [] if sensing.tip_pose is None else [(PoseStamped, sensing.tip_pose, shape.take_tip)]
        try:
            self._sensors += [
                node.create_subscription(kind, topic, self._take_by(take), sensor_data())
                for kind, topic, take in (*imus, *tip)
            ]
        except NameValidationException as error:
            raise PostureError(str(error).replace("\n", " ")) from error

    def _take_by(self, take: Callable[[Any, int], str]) -> Callable[[Any], None]:
        """Return what takes messages of a sensor."""

        def taken(message: Any) -> None:
            take(message, self._now())

        return taken

    def _take_waiting(self) -> None:
        """Take messages of sensors that wait: executors run timers first, and a late cycle needs the last."""
        for sensor in self._sensors:
            with sensor.handle:
                while taken := sensor.handle.take_message(sensor.msg_type, sensor.raw):
                    sensor.callback(taken[0])

    def _take_path(self, message: Any) -> None:
        """Have a curve through points placed, in another thread."""
        frame = message.header.frame_id
        try:
            self._frames.require(frame)
            placement = self._frames.fixed(frame)
            if placement is None:
                raise InvalidValue("frame_id", frame, "the frame of the world or of the base")
            poses = [pose.pose.position for pose in message.poses]
            points = np.array([(point.x, point.y, point.z) for point in poses]).reshape(-1, 3)
            curve = Curve.points(points).moved(placement.rotation, placement.translation)
        except PostureError as error:
            self._refuse_target(error)
            return
        self._placing.ask(curve)

    def _place(self, curve: Curve, outdated: Event) -> Target:
        return resolve_targets(self.arm, curve, placement="as_is")

    def _deliver(self, done: Done[Curve, Target]) -> None:
        """Pass a placed target on to the cycle."""
        answer = done.answer
        if answer is None:
            error = done.error
            self._posted.put(lambda: self._refuse_target(error))
        else:
            self._posted.put(lambda: self.aim(answer))

    def _take_posture(self, message: Any) -> None:
        try:
            positions = dict(zip(message.name, message.position, strict=True))
            q = self.arm.configuration(self.arm.drives.joint_positions(positions))
            self.aim(Target.from_configuration(self.arm, q))
        except (PostureError, ValueError) as error:
            self._refuse_target(error)

    def _refuse_target(self, error: BaseException | None) -> None:
        """Keep the target, and say why another one is refused."""
        self._target_fault = f"a target is refused: {error}"
        self._node.get_logger().error(self._target_fault)

    def aim(self, target: Target) -> None:
        """Set the target; that of a motion ends.

        Raises:
            InvalidValue: it does not fit the arm, has it too close to the robot that carries it, or the arm
                follows a guide or retreats; the former one stays.
        """
        self._require_free("target", target)
        if self._beside is not None and target.q is not None:
            target.check_arm(self.arm)
            self._beside.require_clear(target.q, "target")
        self.tracker.update(as_possible(self.tracker.arm, target) if self.locked else target)
        self._performance = None
        if self.locked:
            self._look_again(False)
        self._target_fault = ""

    def perform(self, motion: JointTrajectory) -> None:
        """Move to the start of a motion, rest there, and perform it; it waits while the arm holds.

        Raises:
            InvalidValue: it does not fit the arm, joints are locked, or the arm follows a guide.
        """
        self._require_free("motion", motion)
        if self.locked:
            raise InvalidValue("motion", motion, f"none while joints are locked: {', '.join(self.locked)}")
        self._performance = Performance(self.arm, motion.matched(self.arm).sampled(self._period))
        self._target_fault = ""

    def follow(self, guide: Guide) -> None:
        """Follow a guide from now on, which leads the arm in each cycle; targets that are sent are refused.

        Args:
            guide: the guide; called in the thread in which the node works. It says which joints are locked.

        Raises:
            InvalidValue: joints are locked already, or one has fallen.
        """
        if self.locked or self._to_lock or self._falling:
            raise InvalidValue("guide", guide, "none while joints are locked, or one has fallen")
        self._performance = None
        self._guide = guide

    def _require_free(self, name: str, value: object) -> None:
        if self._guide is not None:
            raise InvalidValue(name, value, "none while an operator or another guide leads the arm")
        if self._retreats:
            raise InvalidValue(name, value, "none while the parameter retreat is true")
        if self._falling:
            raise InvalidValue(name, value, f"none while {self._falling} has fallen: only retreat")

    # Joints that fail.

    def _lockable(self, text: str) -> tuple[str, ...]:
        """Return the names of joints, separated by commas, that are to be locked.

        Raises:
            PostureError: they cannot be.
        """
        names = tuple(name.strip() for name in text.split(",") if name.strip())
        if names:
            self.arm.with_locked(dict.fromkeys(names, 0.0))
        return names

    def _require_falling(self, name: str) -> str:
        """Return the name of a joint that may have fallen, or nothing.

        Raises:
            PostureError: it is none that can, or its weight is not known.
        """
        if name:
            require_known("joint that moves", name, self.arm.joint_names)
            require_falling(self.arm, [self.arm.joint_names.index(name)])
        return name

    def _attend_failures(self, q: Array) -> None:
        """Have joints locked that stick for long enough, but for those that fell: they are limp or weak."""
        failures = self.tracker.report.failures
        if failures or self._watched.astray:
            self._watched.update(failures, self.tracker.command, q)
        patience = self.settings.lock_after
        if patience is None or self._preparing or self._to_lock is not None:
            return
        known = {*self.locked, *self._stuck, self._falling}
        stuck = [
            failure.joint
            for failure in failures
            if failure.kind == "stuck" and failure.duration >= patience and failure.joint not in known
        ]
        fallen = [name for name in stuck if name in self._watched.astray]
        fallen += [
            failure.joint
            for failure in failures
            if failure.kind in ("limp", "weak")
            and failure.duration >= min(patience, FALLING.stands_after)
            and failure.joint not in known
        ]
        if fallen and not self._falling:
            self._set("fallen", fallen[0], fallen[:1])
        stuck = [name for name in stuck if name not in fallen]
        if stuck:
            self._set("locked", ", ".join([*self.locked, *stuck]), stuck)

    def _set(self, parameter: str, value: str, joints: Sequence[str]) -> None:
        """Set a parameter because joints fail; if it is refused, remember that nothing can be done."""
        from rclpy.parameter import Parameter

        (answer,) = self._node.set_parameters([Parameter(parameter, value=value)])
        if not answer.successful:
            self._stuck |= set(joints)
            self._node.get_logger().error(f"{', '.join(joints)} cannot be {parameter}: {answer.reason}")

    def _change_fallen(self) -> None:
        """Wait until a joint that has fallen comes to rest, or go on with it from where the arm is."""
        self._performance = None
        self._fallen = None
        self._fallback = "the arm has to come to rest first" if self._falling else ""
        if self._falling:
            return
        self._restart()
        if self.locked or self._retreats:
            self._look_again(self._retreats)

    def _look_out_fallen(self, q: Array, now: int) -> None:
        """Look for the way out of a joint that has fallen, once the arm has come to rest at q, (nq,)."""
        stands = self._watched.stands(q, now / NANOSECONDS)
        waits = self._falling and self._fallen is None and not self._preparing
        if not (waits and stands and self.tracker.at_rest):
            return
        if not self._located:  # nothing was sent yet
            self._restart()
        self._fallen = take_fallen(self.tracker, self._falling, q)
        self._fallback = "searched for"
        self._ahead.ask(self._situation(self.tracker.arm, self.locked, self._fallen.q, self._retreats))

    def _lock(self, q: Array) -> None:
        """Have the arm prepared without joints that are to be locked, at a configuration, (nq,)."""
        names = self._to_lock
        if names is None:
            return
        self._to_lock = None
        measured = dict(zip(self.arm.joint_names, self.arm.positions(q).tolist(), strict=True))
        positions = {name: self.locked.get(name, measured[name]) for name in names}
        if positions != self.locked:
            self._prepare(self.arm.with_locked(positions) if positions else self.arm, positions, q)

    def _prepare(self, arm: Arm, positions: dict[str, float], q: Array) -> None:
        """Have the arm prepared with joints locked at positions, by name, at a configuration, (nq,)."""
        self._wanted = positions
        self._preparing = f"the arm is prepared without {', '.join(positions) or 'locked joints'}"
        self._ahead.ask(self._situation(arm, positions, q, self._retreats))

    def _go_on_as(self, guide: Guide, q: Array) -> None:
        """Have the arm prepared as a guide leads it, if that locks other joints, from q, (nq,)."""
        arm = guide.arm
        if arm is self.tracker.arm or self._preparing:
            return
        stands = (arm.limits.lower == arm.limits.upper) & (self.arm.limits.lower < self.arm.limits.upper)
        names = np.array(arm.joint_names)[stands].tolist()
        self._prepare(arm, dict(zip(names, arm.limits.lower[stands].tolist(), strict=True)), q)

    def _situation(self, arm: Arm, positions: dict[str, float], q: Array, leave: bool) -> Locked:
        target = self.tracker.target
        limits = self._limits({})
        rows = self._way_in.rows
        return Locked(self.arm, arm, positions, q, target, self._scene, limits, rows, leave, self._fallen)

    def _look_ahead(self, locked: Locked, outdated: Event) -> Fallback:
        """Prepare a tracker, if other joints are locked, and find what is possible. Runs in a thread."""
        if locked.arm is not self.tracker.arm:
            tracker = self._new_tracker(locked.arm, locked.scene)
            while not (self.tracker.at_rest or outdated.wait(POLLING)):
                pass
            self._posted.put(lambda: self._take_over(locked, tracker))
        if not (locked.positions or locked.fallen) or self._guide is not None:
            return Fallback(None, None, LED if self._guide is not None else "no joint is locked")
        return self._fallbacks.find(locked, outdated)

    def _take_over(self, locked: Locked, tracker: Tracker) -> None:
        """Go on with another tracker from where the last one has sent the arm, at rest."""
        drives = self.arm.drives
        try:
            sent = drives.joint_positions(dict(zip(drives.names, self.tracker.positions, strict=True)))
        except InvalidValue:  # nothing was sent yet
            sent = self.arm.positions(locked.q)
        for name, position in locked.positions.items():
            sent[self.arm.joint_names.index(name)] = position
        tracker.limits = self._limits({})
        tracker.restart(dict(zip(drives.names, drives.positions(sent).tolist(), strict=True)))
        target = self.tracker.target
        if target is not None:
            tracker.update(as_possible(locked.arm, target))
        self.tracker = tracker
        self.locked = dict(locked.positions)
        self._stuck = set()
        self._performance = None
        if locked.positions is self._wanted:
            self._preparing = ""
        self._fallback = (LED if self._guide is not None else "searched for") if self.locked else ""

    def _pass_fallback_on(self, done: Done[Locked, Fallback]) -> None:
        """Pass a fallback on to the cycle; called in the thread."""
        self._posted.put(lambda: self._take_fallback(done))

    def _take_fallback(self, done: Done[Locked, Fallback]) -> None:
        """Tell a fallback, and begin the way out if it is wanted."""
        fallback = done.answer
        request = done.request
        if fallback is None:
            self._preparing = ""
        if request.fallen is not self._fallen or (self._falling and request.fallen is None):
            return
        idle = self._guide is not None or not (request.positions or request.leave or request.fallen)
        if idle and fallback is not None:
            return
        self._fallback = str(done.error if fallback is None else fallback)
        if request.leave and self._retreats and fallback is not None and fallback.way_out is not None:
            motion = fallback.way_out.sampled(self._period)
            self._performance = Performance(self.tracker.arm, motion)

    def _require_way_in(self) -> None:
        """Raise InvalidValue if the arm cannot be asked to retreat."""
        if self._guide is not None:
            raise InvalidValue("retreat", True, "false while an operator or another guide leads the arm")
        if not (self.locked or self._falling) or self._preparing:
            allowed = "false while no joint is locked or has fallen; send ~/posture instead"
            raise InvalidValue("retreat", True, allowed)

    def _change_retreat(self) -> None:
        """Have a way out searched for, or end it."""
        self._performance = None
        if self._retreats:
            self._look_again(True)

    def _look_again(self, leave: bool) -> None:
        """Have looked what is possible now, or for the way out."""
        if self._preparing:  # it is looked for then
            return
        if self._falling:  # it is looked for when the arm stands
            self._fallen = None
            self._fallback = "the arm has to come to rest first"
            return
        q = self._configuration(self._joints.measurement(self._now()))
        if q is None:
            self._fallback = "not searched for: the joints were not measured"
            return
        self._fallback = "searched for"
        self._ahead.ask(self._situation(self.tracker.arm, self.locked, q, leave))

    # Clouds.

    def _take_cloud(self, message: Any) -> None:
        self._waiting[message.header.frame_id] = message

    def _pass_clouds_on(self, now: int) -> None:
        """Have clouds read for whose time the joints are measured, or will not be any more."""
        ready: dict[str, Cloud] = {}
        for frame, message in list(self._waiting.items()):
            stamp = stamp_of(message)
            late = (now - stamp) / NANOSECONDS > self.settings.max_age
            if not (late or self._mapped_until >= stamp or frame not in self._frames.names):
                continue
            del self._waiting[frame]
            try:
                ready[frame] = Cloud(read_points(message), stamp / NANOSECONDS)
            except PostureError as error:
                self._cloud_faults[frame] = str(error)
        if ready:
            self._reading.ask(ready)

    def _read_clouds(self, clouds: dict[str, Cloud], outdated: Event) -> dict[str, str]:
        """Add clouds to the map; return why they are refused, or nothing, by frame. Runs in a thread."""
        faults = dict.fromkeys(clouds, "")
        for frame, cloud in clouds.items():
            try:
                self._frames.add(self._map, cloud.points, frame, cloud.time)
            except PostureError as error:
                faults[frame] = str(error)
        return faults

    def _take_faults(self, done: Done[dict[str, Cloud], dict[str, str]]) -> None:
        """Pass faults of clouds on to the cycle; called in the thread."""
        faults_by_topic = done.answer or dict.fromkeys(done.request, f"it failed: {done.error}")

        def take() -> None:
            faults = {**self._cloud_faults, **faults_by_topic}
            times = [cloud.time for frame, cloud in done.request.items() if not faults_by_topic[frame]]
            self._seen_at = max(times, default=self._seen_at)
            self._cloud_faults = {frame: fault for frame, fault in faults.items() if fault}

        self._posted.put(take)

    # Cycles.

    def _cycle(self) -> None:
        """Take a step, and send the positions that it leads to."""
        self._last_cycle = time.monotonic()
        self._take_waiting()
        now = self._now()
        passed = self.times.begin(now)
        if passed <= 0.0:  # the clock jumped back
            self._joints.forget()
            self._map = self._new_map()
            self._mapped_until = 0
            self._seen_at = None
            self.times.latencies.clear()
            passed = self._period
        if self._shape is not None:
            self._shape.estimate(now, passed, self._sent)
        measured = self._joints.measurement(now)
        q = self._configuration(measured)
        self.measured = q
        if q is not None:
            self._map_measurement(q, measured.stamp)
            self._way_in.add(q)
            self._lock(q)
            if self._guide is not None:
                self._go_on_as(self._guide, q)
            self._look_out_fallen(q, now)
        self._pass_clouds_on(now)
        self._run_posted()
        self._take_cells()
        stale = self._stale(now)
        self._slow_down(DRIVER.stale_speed if stale else 1.0)
        held = self._reason_to_hold(measured, stale)
        if self._guide is not None:
            held = self._guide.lead(self.tracker, q, self._scene, self._period, held, self._speed)
        self._step(None if held else measured, passed)
        report = self.tracker.report
        before = self.status
        self.status = report.status
        self.reason = held or report.reason
        self._located = self._located or report.tracking_error is not None
        if q is not None:
            self._attend_failures(q)
        if self._located:
            self._commands.publish(self._command())
            if measured.stamp:
                self.times.sent(measured.stamp, self._now())
        if self.status != before:
            self._diagnose()

    def _new_map(self) -> Map:
        resolution = self.settings.cloud_resolution or MAPPING.cell * self.arm.length
        return Map(resolution, self.arm, forget=self.settings.forget or inf)

    def _map_measurement(self, q: Array, stamp: int) -> None:
        """Tell the map where the arm is, for clouds of that time [ns]."""
        if stamp > self._mapped_until:
            self._map.measure(q, stamp / NANOSECONDS)
            self._mapped_until = stamp

    def _configuration(self, measured: JointMeasurement) -> Array | None:
        """Return the measured configuration, (nq,); None if it cannot be used."""
        if measured.positions is None:
            return None
        return self.arm.configuration(self.arm.drives.joint_positions(measured.positions))

    def _take_cells(self) -> None:
        """Take what cameras have seen into the scene."""
        cells = self._map.cells
        if cells is not self._scene.obstacles[SEEN]:
            self._scene = self._scene.updated({SEEN: cells})
            if self._beside is not None:
                self._beside.scene = self._scene

    def _run_posted(self) -> None:
        while True:
            try:
                self._posted.get_nowait()()
            except Empty:
                return
            except PostureError as error:  # a target that does not fit
                self._refuse_target(error)

    def _cloud_age(self, now: int) -> float | None:
        """Return the age of the last cloud in the map at a time [ns], in seconds; None: there was none."""
        return None if self._seen_at is None else now / NANOSECONDS - self._seen_at

    def _stale(self, now: int) -> str:
        """Return why the map is stale; empty if it is not."""
        age = self._cloud_age(now)
        most = self.settings.max_cloud_age
        if age is None or most is None or age <= most:
            return ""
        return f"the map is stale: the last cloud is {age:.3g} s old; at most {most:.3g} s are allowed"

    def _reason_to_hold(self, measured: JointMeasurement, stale: str) -> str:
        """Return why the arm is to brake and hold, whatever the tracker says; empty if it is not."""
        clouds = [
            f"a cloud in frame {frame!r} is refused: {why}" for frame, why in self._cloud_faults.items()
        ]
        waits = self._performance is None
        reasons = (
            "the driver ends" if self._stopping else "",
            measured.reason,
            *clouds,
            stale if self.settings.stale == "hold" else "",
            "the parameter hold is true" if self._hold else "",
            self._preparing,
            f"the arm is to retreat; way out: {self._fallback}" if waits and self._retreats else "",
            f"{self._falling} has fallen; way out: {self._fallback}" if waits and self._falling else "",
        )
        return next(filter(None, reasons), "")

    def _slow_down(self, share: float) -> None:
        """Move within a share of the limits of velocity."""
        if share != self._speed:
            self._speed = share
            self.tracker.limits = self._limits({})

    def _step(self, measured: JointMeasurement | None, passed: float) -> None:
        """Let the tracker take a step after a time [s]; without a measurement, it brakes and holds."""
        tracker = self.tracker
        if self._performance is not None:
            tracker.update(self._performance.advance(tracker.report, self._speed * self._period))
        tracker.step(
            None if measured is None else measured.positions,
            passed if passed < DRIVER.short_cycle * self._period else None,
            scene=self._scene,
            torques=None if measured is None else measured.torques,
        )

    def _command(self) -> Any:
        """Return the message that sends the positions of the tracker."""
        from builtin_interfaces.msg import Duration as DurationMessage
        from std_msgs.msg import Float64MultiArray
        from trajectory_msgs.msg import JointTrajectory as JointTrajectoryMessage
        from trajectory_msgs.msg import JointTrajectoryPoint

        self._sent = self.tracker.positions
        names = self.arm.drives.names
        positions = self._sent.tolist()
        if self._drives is not None:
            names = self._drives.names
            positions = self._drives.commands(self._sent).tolist()
        if self.settings.command == "positions":
            return Float64MultiArray(data=positions)
        period = round(NANOSECONDS / self.settings.rate)
        point = JointTrajectoryPoint(positions=positions)
        point.time_from_start = DurationMessage(sec=period // NANOSECONDS, nanosec=period % NANOSECONDS)
        return JointTrajectoryMessage(joint_names=list(names), points=[point])

    def _restart(self) -> None:
        """Start from the measured arm, if it is measured."""
        measured = self._joints.measurement(self._now())
        if measured.positions is not None:
            self.tracker.restart(measured.positions)

    # The end.

    def stop(self) -> None:
        """Let the arm brake and hold; `done` tells when it does."""
        self._stopping = True

    def done(self) -> bool:
        """Return whether the driver was stopped, and the arm holds or cycles have ceased."""
        ceased = time.monotonic() - self._last_cycle > DRIVER.standstill
        return self._stopping and (self.tracker.at_rest or ceased)

    def close(self) -> None:
        """End the threads."""
        self._reading.close()
        self._placing.close()
        self._ahead.close()

    # Diagnostics.

    def _describe_carrier(self) -> str:
        """Return how near something is to the robot that carries the arm."""
        if self._beside is None or self.measured is None:
            return ""
        closest = self._beside.closest(self.measured)
        return "" if closest.pair is None else describe_distance(closest.pair, closest.distance)

    def _diagnose(self) -> None:
        """Publish what the driver does, and why."""
        now = self._now()
        measured = self._joints.measurement(now)
        stale = self._stale(now)
        sensed = {} if self._shape is None else self._shape.told(now)
        level = 0 if self.status in ("moving", "converged") and not self._target_fault else 1
        if self.locked or self._falling or stale or any(sensed.get(key) for key in FAULTS):
            level = 1
        if measured.reason or self._cloud_faults:
            level = 2
        report = self.tracker.report
        values: dict[str, Any] = {
            "status": self.status,
            "reason": self.reason,
            "age of the joint states": measured.age,
            "refused joint states": self._joints.refused,
            "mean error": report.mean_error,
            "tracking error": report.tracking_error,
            "violated": "; ".join(report.violated_constraints),
            "robot and arm": self._describe_carrier(),
            "failing joints": "; ".join(map(str, report.failures)),
            "locked joints": "; ".join(f"{name} at {at:.4g}" for name, at in self.locked.items()),
            "fallen joint": self._falling if self._fallen is None else str(self._fallen),
            "without them": self._fallback,
            "target": self._target_fault or ("given" if self.tracker.target is not None else "none"),
            "cells seen by cameras": len(self._map.cells.points),
            "age of the last cloud": self._cloud_age(now),
            "stale": stale,
            "refused clouds": "; ".join(f"{frame}: {why}" for frame, why in self._cloud_faults.items()),
            "cycles": self.times.cycles,
            "missed cycles": self.times.missed,
            "overruns": self.tracker.overruns,
            **self.times.recent_latencies(),
            **sensed,
        }
        words = f"{self.status}: {self.reason}" if self.reason else self.status
        message = diagnostics(self._node.get_fully_qualified_name(), self.arm.name, level, words, values)
        message.header.stamp = self._node.get_clock().now().to_msg()
        self._diagnostics.publish(message)
        if self.reason and self._occurrences.begin(words, time.monotonic()):
            self._node.get_logger().warning(words)
