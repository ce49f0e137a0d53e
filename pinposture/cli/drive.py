"""`pinposture drive` and `pinposture robot`: nodes of ROS 2, a driver of an arm and a simulated robot."""

from __future__ import annotations

import gc
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from pinposture.cli.inputs import (
    CURVE_HELP,
    MOTION,
    SURROUNDINGS,
    TARGET,
    ArmOptions,
    LimitOptions,
    Panel,
    PlacementOptions,
    SceneOption,
    SceneOptions,
    StartOptions,
    UrdfArgument,
    read_declared,
    refuse_given,
)
from pinposture.cli.output import examples, find_kept, load_kept, print_note
from pinposture.cli.view import hold_interrupt

if TYPE_CHECKING:
    from pinposture.arm import Arm
    from pinposture.collision import Scene
    from pinposture.control import Limits
    from pinposture.motion import JointTrajectory
    from pinposture.ros2 import Driver

ROS = Panel("ROS 2")
SHAPE = Panel("The shape as sensed")
SENSORS = Panel("Its sensors")

RosArguments = Annotated[
    list[str] | None,
    typer.Argument(
        metavar="[-- ARGUMENTS]",
        help="Arguments of ROS 2, behind --: -- --ros-args -p hold:=true -r joint_states:=/arm/joint_states",
    ),
]

RateOption = Annotated[float, ROS("Cycles per second.", "HZ")]


FeedOption = Annotated[
    Path | None,
    ROS(
        "File of what moves in place of the first joint, a slide: [carrier], a robot that carries the arm, "
        "or [drum].",
        "FILE",
    ),
]


def read_feed(path: Path | None, arm: Arm) -> Any:
    """Return what feeds an arm, of a file; None without one."""
    from pinposture.task.carrier_feed import load_feed

    return None if path is None else load_feed(path, arm)


@dataclass(frozen=True)
class DriverOptions:
    """How the driver works, as of `DriverSettings`."""

    rate: RateOption = 100.0
    command: Annotated[
        str, ROS("What is sent: trajectory (joint_trajectory_controller) or positions.", "KIND")
    ] = "trajectory"
    max_age: Annotated[str | None, ROS("{ros2.driver.DriverSettings.max_age}", "TIME")] = None
    cloud_resolution: Annotated[
        str | None, SURROUNDINGS("{ros2.driver.DriverSettings.cloud_resolution}", "LENGTH")
    ] = None
    forget: Annotated[str | None, SURROUNDINGS("{ros2.driver.DriverSettings.forget}", "TIME")] = None
    max_cloud_age: Annotated[
        str | None, SURROUNDINGS("{ros2.driver.DriverSettings.max_cloud_age}", "TIME")
    ] = None
    stale: Annotated[str, SURROUNDINGS("{ros2.driver.DriverSettings.stale}", "WHAT")] = "hold"
    feed: FeedOption = None
    lock_after: Annotated[str | None, ROS("{ros2.driver.DriverSettings.lock_after}", "TIME")] = None
    touch: Annotated[
        str | None, SURROUNDINGS("Brake and hold if an effort differs by more from its model.", "TORQUE")
    ] = None
    imus: Annotated[str | None, SHAPE("{ros2.shape_readings.ShapeSensing.imus}", "TOPIC,...")] = None
    no_heading: Annotated[
        bool, SHAPE("Take only from inertial sensors which way is up.", flags="--no-heading")
    ] = False
    tip_pose: Annotated[str | None, SHAPE("{ros2.shape_readings.ShapeSensing.tip_pose}", "TOPIC")] = None
    encoders: Annotated[str | None, SHAPE("{ros2.shape_readings.ShapeSensing.encoders}", "SIDE")] = None
    encoder_noise: Annotated[
        str | None, SHAPE("{ros2.shape_readings.ShapeSensing.encoder_noise}", "ANGLE")
    ] = None
    imu_noise: Annotated[str | None, SHAPE("{ros2.shape_readings.ShapeSensing.imu_noise}", "ANGLE")] = None
    tip_noise: Annotated[str | None, SHAPE("{ros2.shape_readings.ShapeSensing.tip_noise}", "LENGTH")] = None
    give: Annotated[str | None, SHAPE("{ros2.shape_readings.ShapeSensing.give}", "ANGLE")] = None
    max_deviation: Annotated[
        str | None, SHAPE("{ros2.shape_readings.ShapeSensing.max_deviation}", "LENGTH")
    ] = None

    def read(self, arm: Arm) -> Any:
        """Return the settings for an arm; raise a `PostureError` for a value that is refused."""
        from pinposture.motion import Touch
        from pinposture.ros2 import DriverSettings, ShapeSensing

        options = vars(self)
        sensed = {name: options[name] for name in vars(ShapeSensing()) if options.get(name) is not None}
        if self.no_heading:
            sensed["heading"] = False
        driving = {name: value for name, value in options.items() if name in vars(DriverSettings())}
        settings = read_declared(DriverSettings, {**driving, "touch": None, "feed": None})
        touch = None if self.touch is None else read_declared(Touch, {"threshold": self.touch})
        sensing = read_declared(ShapeSensing, sensed) if sensed else None
        return replace(settings, touch=touch, sensing=sensing, feed=read_feed(self.feed, arm))


@dataclass(frozen=True, kw_only=True)
class AimOptions:
    """What the arm does first."""

    curve: Annotated[str | None, TARGET(CURVE_HELP, "CURVE")] = None
    motion: Annotated[
        Path | None,
        TARGET("A saved run or motion, its directory, or a joint trajectory, to perform once.", "RUN"),
    ] = None
    placement_options: PlacementOptions

    def aim(self, driver: Driver, scene: Scene) -> None:
        """Give a driver its first target or motion, if there is one.

        Raises:
            PostureError: it cannot be read, or does not fit the arm.
        """
        if self.motion is not None:
            driver.perform(_read_motion(driver.arm, self.motion))
        if self.curve is not None:
            driver.aim(self.placement_options.place(driver.arm, self.curve, scene))


@examples(
    "pinposture drive arm.urdf --curve helix",
    "pinposture drive arm.urdf --curve bow.json --command positions --velocity 0.5",
    "pinposture drive arm.urdf --motion out/task --scene scene.toml",
    "pinposture drive arm.urdf --feed feed.toml",
    "pinposture drive arm.urdf --imus imu --tip-pose tip_pose --encoders motor",
    "pinposture drive arm.urdf -- --ros-args -p hold:=true -r joint_states:=/arm/joint_states",
)
def run(
    *,
    urdf: UrdfArgument,
    ros_args: RosArguments = None,
    arm_options: ArmOptions,
    aim_options: AimOptions,
    limit_options: LimitOptions,
    scene_options: SceneOptions,
    driver_options: DriverOptions,
) -> None:
    """Drive an arm with ROS 2: joint states and targets in, commands for ros2_control out.

    The node moves the arm within its limits to the curve or along the motion, then to the targets that it
    is sent: ~/path (nav_msgs/Path) or ~/posture (sensor_msgs/JointState). Clouds on the topic points
    (sensor_msgs/PointCloud2), in the frame of a link or of the world, become obstacles. Inertial sensors and
    the pose of the tip tell the shape where encoders are missing, or the arm gives way behind them. Where
    something is missing, old or unknown, the arm brakes and holds, and /diagnostics gives the reason. Ctrl-C
    lets it brake and hold, and ends the node. Without limits, those of the description apply, else 1 rad/s
    and 2 rad/s2.

    It needs rclpy: pip install 'pinposture[ros2]', or a sourced ROS 2. docs/ros2.md describes all of it.
    """
    with hold_interrupt():
        from pinposture.ros2 import Driver, open_node

    if aim_options.motion is not None:
        refuse_given({"--curve": aim_options.curve}, "nothing with --motion")
    refuse_given({"--dt": limit_options.dt}, "nothing; --rate tells the cycle time")
    arm = arm_options.read(urdf)
    settings = driver_options.read(arm)
    scene = scene_options.read(arm)
    limits = read_limits(arm, limit_options, 1.0 / settings.rate)
    with open_node("pinposture", ros_args or ()) as node:
        with hold_interrupt():
            driver = Driver(node, arm, settings, limits=limits, scene=scene)
            aim_options.aim(driver, scene)
        name = node.get_fully_qualified_name()
        print_note(f"{name} drives {arm.name} at {driver.settings.rate:g} Hz; Ctrl-C ends it")
        spin_node(node, driver)
        driver.close()
        print_note(f"{name}: {driver.times.cycles} cycles, {driver.times.missed} missed; the arm holds")


def read_limits(arm: Arm, options: LimitOptions, dt: float) -> Limits:
    """Return the usual limits of an arm, with those that are given in place of them."""
    from pinposture.ros2.driver import usual_limits

    limits = usual_limits(arm, dt)
    names = [name for name, value in vars(options).items() if value is not None]
    if not names:
        return limits
    read = replace(options, dt=f"{dt!r} s").read(arm)
    fields = ["step" if name == "step_limit" else name for name in names]
    return replace(limits, **{name: getattr(read, name) for name in fields})


def _read_motion(arm: Arm, path: Path) -> JointTrajectory:
    """Return a saved motion as a joint trajectory of an arm."""
    from pinposture.motion import JointTrajectory, load
    from pinposture.motion.files import kind_of

    file, which = find_kept(path)
    if which:
        print_note(which)
    if kind_of(file) is JointTrajectory:
        return load(file, JointTrajectory).matched(arm)
    return load_kept(file).joint_trajectory().matched(arm)


def spin_node(node: Any, worker: Any) -> None:
    """Let a node work until it is done, without pauses of the garbage collector for what is there now."""
    from pinposture.ros2 import spin

    gc.collect()
    gc.freeze()
    spin(node, worker.stop, worker.done)


@dataclass(frozen=True)
class RobotOptions:
    """How a simulated robot works."""

    start: Annotated[str, MOTION("Where it starts, as in pinposture track.", "START")] = "straight"
    seed: Annotated[int, MOTION("Seed of a smooth or random start.")] = 0
    frequency: Annotated[str | None, MOTION("{sim.Servos.frequency}", "HZ")] = None
    rate: RateOption = 100.0
    clock: Annotated[
        bool, ROS("Publish the time of the simulation, for nodes with use_sim_time.", flags="--clock")
    ] = False


@dataclass(frozen=True)
class SensorOptions:
    """The sensors of a simulated robot."""

    noise: Annotated[str, SENSORS("{sim.Sensing.noise}", "ANGLE")] = "0.0001"
    resolution: Annotated[str | None, SENSORS("{sim.Sensing.resolution}", "ANGLE")] = None
    dropped: Annotated[float, SENSORS("{sim.Sensing.dropped}", "SHARE")] = 0.0
    latency: Annotated[int, SENSORS("{sim.Sensing.latency}", "CYCLES")] = 0
    torque_noise: Annotated[str | None, SENSORS("{sim.Sensing.torque_noise}", "TORQUE")] = None
    encoders: Annotated[str | None, SENSORS("{ros2.robot.RobotSettings.encoders}", "SIDE")] = None
    imus: Annotated[int, SENSORS("{sim.LinkSensing.imus} They publish imu.", "N")] = 0
    imu_noise: Annotated[str | None, SENSORS("{sim.LinkSensing.imu_noise}", "ANGLE")] = None
    tip_pose: Annotated[
        bool, SENSORS("The pose of the tip is measured, and published on tip_pose.", flags="--tip-pose")
    ] = False
    tip_noise: Annotated[str | None, SENSORS("{sim.LinkSensing.tip_noise}", "LENGTH")] = None
    camera: Annotated[
        bool, SENSORS("A depth camera at the tip, which publishes points.", flags="--camera")
    ] = False
    camera_rate: Annotated[float, SENSORS("Clouds per second.", "HZ")] = 5.0


@examples(
    "pinposture robot arm.urdf --frequency 4",
    "pinposture robot arm.urdf --scene scene.toml --camera --torque-noise 0.01",
    "pinposture robot arm.urdf --latency 3 --dropped 0.05",
    "pinposture robot arm.urdf --encoders motor --imus 2 --tip-pose",
    "pinposture robot arm.urdf -- --ros-args -p stuck:=m02_j1_y",
)
def run_robot(
    *,
    urdf: UrdfArgument,
    ros_args: RosArguments = None,
    arm_options: ArmOptions,
    robot_options: RobotOptions,
    sensor_options: SensorOptions,
    scene: SceneOption = None,
) -> None:
    """Simulate an arm as a robot with ros2_control, for trials of a driver. Needs MuJoCo and rclpy.

    The node publishes joint_states, and with --camera clouds on the topic points, in the frame of the tip
    link. It takes commands as joint_trajectory_controller and JointGroupPositionController do. Its servos are
    soft: at 4 Hz, the tip sags by 16 mm. Set parameters to let joints fail, or messages come late or not at
    all: stuck, limp and weak (names of joints, separated by commas), latency (in s), silent, and missing
    (names of joints and links without sensors).
    """
    with hold_interrupt():
        from pinposture.arm.mjcf import load_mujoco
        from pinposture.collision import Scene
        from pinposture.ros2 import RobotSettings, SimulatedRobot, open_node
        from pinposture.sim import DepthCamera, LinkSensing, Sensing, Servos

    load_mujoco()
    sensed = {name: value for name, value in vars(sensor_options).items() if name in vars(Sensing())}
    carried = ("imus", "imu_noise", "tip_pose", "tip_noise")
    settings = replace(
        read_declared(RobotSettings, {"encoders": sensor_options.encoders}),
        rate=robot_options.rate,
        servos=read_declared(Servos, {"frequency": robot_options.frequency}),
        sensing=read_declared(Sensing, sensed),
        links=read_declared(LinkSensing, {name: vars(sensor_options)[name] for name in carried}),
        camera=DepthCamera() if sensor_options.camera else None,
        camera_rate=sensor_options.camera_rate,
        clock=robot_options.clock,
    )
    arm = arm_options.read(urdf)
    surroundings = Scene() if scene is None else Scene.load(scene)
    q0 = StartOptions(robot_options.start, False, robot_options.seed).read(arm, surroundings).q
    with open_node("robot", ros_args or ()) as node:
        with hold_interrupt():
            robot = SimulatedRobot(node, arm, surroundings, settings, q0)
        name = node.get_fully_qualified_name()
        print_note(f"{name} simulates {arm.name} at {settings.rate:g} Hz; Ctrl-C ends it")
        spin_node(node, robot)
        print_note(f"{name}: {robot.plant.cycles} cycles{robot.plant.failure and '; ' + robot.plant.failure}")
