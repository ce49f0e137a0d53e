"""`pinposture operate`: move an arm by what is held in a page of the browser."""

from __future__ import annotations

import signal
import sys
import time
import webbrowser
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from threading import Event
from typing import TYPE_CHECKING, Annotated

import typer

from pinposture.cli.compile import compile_missing
from pinposture.cli.drive import FeedOption, RosArguments, read_feed, read_limits, spin_node
from pinposture.cli.edit import PageOptions
from pinposture.cli.inputs import (
    ArmOptions,
    LimitOptions,
    Panel,
    SceneOptions,
    StartOptions,
    UrdfArgument,
    read_declared,
    refuse_given,
)
from pinposture.cli.output import examples, print_note
from pinposture.cli.view import hold_interrupt
from pinposture.errors import FileError

if TYPE_CHECKING:
    from pinposture.arm import Arm
    from pinposture.collision import Scene
    from pinposture.control import Limits
    from pinposture.motion import Actuators
    from pinposture.operate import Operation, SimulatedArm
    from pinposture.operate.record import Replay
    from pinposture.task import CarrierFeed

SIMULATION = Panel("The simulated arm")
OPERATED = Panel("The operation")
RATE = 50.0
"""Cycles per second: the loop shares the process with the page."""


@dataclass(frozen=True)
class SimulatedArmOptions:
    """The simulated arm, if there is one."""

    start: Annotated[
        str | None, SIMULATION("Where it starts, as in pinposture track; default: at zero.", "START")
    ] = None
    frequency: Annotated[str | None, SIMULATION("{sim.Servos.frequency}", "HZ")] = None
    noise: Annotated[str | None, SIMULATION("{sim.Sensing.noise}", "ANGLE")] = None
    camera: Annotated[
        bool,
        SIMULATION(
            "A depth camera at the tip: the arm knows obstacles only as far as it sees them.",
            flags="--camera",
        ),
    ] = False


@dataclass(frozen=True, kw_only=True)
class OperationOptions:
    """How an arm is operated."""

    ros: Annotated[
        bool,
        OPERATED(
            "Drive a robot on ROS 2, as pinposture drive does, in place of a simulation.", flags="--ros"
        ),
    ] = False
    task: Annotated[
        str | None,
        OPERATED("A task file for the same arm: the postures of its keyframes are the steps.", "TASK"),
    ] = None
    record: Annotated[
        str | None,
        OPERATED("File to record the run to; default: operation-DATE-TIME.mcap in this folder.", "FILE"),
    ] = None
    replay: Annotated[
        str | None, OPERATED("Show a run that was recorded for this arm, and operate nothing.", "FILE")
    ] = None
    speed: Annotated[
        float | None,
        OPERATED("Full speed of the tip, in m/s; default: 5 % of the length of the arm per second.", "SPEED"),
    ] = None
    feed: FeedOption = None
    simulated_arm: SimulatedArmOptions


@examples(
    "pinposture operate arm.urdf --scene scene.toml",
    "pinposture operate arm.urdf --scene scene.toml --camera --frequency 10",
    "pinposture operate arm.urdf --task task.toml",
    "pinposture operate arm.urdf --feed feed.toml",
    "pinposture operate arm.urdf --replay operation-20260102-030405.mcap",
    "pinposture operate arm.urdf --ros --velocity 0.5",
    "pinposture operate arm.urdf --ros -- --ros-args -r joint_states:=/arm/joint_states",
)
def run(
    *,
    urdf: UrdfArgument,
    ros_args: RosArguments = None,
    arm_options: ArmOptions,
    operation_options: OperationOptions,
    limit_options: LimitOptions,
    scene_options: SceneOptions,
    page_options: PageOptions,
) -> None:
    """Operate an arm live: it moves while a key, a button or a stick is held in the browser, else it holds.

    The page shows the measured arm, the commanded one as a ghost, what cameras have seen, why the arm waits,
    and what is left of its limits. An arm on a feed is steered by its tip, and the body follows its path;
    the tip of another one is moved along straight lines. One page has control; others ask it for that.

    Without --ros the arm is simulated by MuJoCo in this process. With it, this is the driver of a robot on
    ROS 2, and ~/path and ~/posture are refused. Without limits, those of the description apply, else 1 rad/s
    and 2 rad/s2. It runs until Ctrl-C. docs/operate.md describes all of it.
    """
    with hold_interrupt():
        from pinposture.operate import Control, Operation
        from pinposture.operate.ways import read_steps
        from pinposture.task import CarrierFeed

    refuse_given({"--dt": limit_options.dt}, "nothing; the rate tells the cycle time")
    arm = arm_options.read(urdf)
    scene = scene_options.read(arm)
    if operation_options.replay is not None:
        replay(arm, operation_options.replay, scene, page_options)
        return
    limits = read_limits(arm, limit_options, 1.0 / RATE)
    feed = read_feed(operation_options.feed, arm)
    carrier = feed if isinstance(feed, CarrierFeed) else None
    limits = limits if carrier is None else carrier.limits(arm, limits)
    sys.setswitchinterval(0.001)  # the page keeps the loop waiting for so long, several times a cycle [s]
    operation = Operation(arm, limits, Control(), operation_options.speed)
    if operation_options.task is not None:
        operation.steps += read_steps(arm, operation_options.task)
    compile_missing()
    with recorded(operation, operation_options.record):
        if operation_options.ros:
            options = {f"--{name}": value for name, value in vars(operation_options.simulated_arm).items()}
            refuse_given(options, "nothing with --ros; pinposture robot simulates a robot on ROS 2")
            _drive(operation, limits, scene, ros_args, page_options, feed, carrier)
        else:
            refuse_given({"-- ARGUMENTS": ros_args}, "nothing without --ros")
            _simulate(operation, limits, scene, operation_options.simulated_arm, page_options, carrier)


@contextmanager
def recorded(operation: Operation, path: str | None) -> Iterator[None]:
    """Record an operation to a file meanwhile; without a name, only if what that needs is installed."""
    from pinposture.operate.record import Recorder

    name = time.strftime("operation-%Y%m%d-%H%M%S.mcap") if path is None else path
    try:
        recorder = Recorder(operation.arm, name)
    except FileError as error:
        if path is not None:
            raise
        print_note(f"the run is not recorded: {error}")
        yield
        return
    operation.watch = recorder.add
    try:
        yield
    finally:
        operation.watch = None
        recorder.close()
        print_note(f"recorded to {name}; see it by pinposture operate ... --replay {name}")


def replay(arm: Arm, path: str, scene: Scene, options: PageOptions) -> None:
    """Show a recording until Ctrl-C."""
    from pinposture.operate.record import Replay

    shown = Replay(arm, path, scene)
    with ending() as stop, _page(shown, options):
        shown.run(stop)


@contextmanager
def ending() -> Iterator[Event]:
    """Yield an event that is set by Ctrl-C, or when the process is to end."""
    stop = Event()
    before = {
        number: signal.signal(number, lambda *_: stop.set()) for number in (signal.SIGINT, signal.SIGTERM)
    }
    try:
        yield stop
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)


@contextmanager
def _page(
    operation: Operation | Replay,
    options: PageOptions,
    simulated: SimulatedArm | None = None,
    carrier: CarrierFeed | None = None,
) -> Iterator[None]:
    """Show a page while something else is done."""
    from pinposture.editor.ui.server import is_loopback
    from pinposture.operate import LivePage

    page = LivePage(operation, options.host, options.port, simulated, carrier)
    try:
        page.start()
        typer.echo(page.url)
        if not is_loopback(options.host):
            print_note(
                f"listening on {options.host} for other machines, unencrypted: anyone who has the address "
                "can ask for control of the arm"
            )
        print_note("press Ctrl-C to end")
        if not options.no_browser:
            webbrowser.open(page.url)
        yield
    finally:
        page.close()
        operation.close()


def _drive(
    operation: Operation,
    limits: Limits,
    scene: Scene,
    ros_args: list[str] | None,
    options: PageOptions,
    feed: CarrierFeed | Actuators | None,
    carrier: CarrierFeed | None,
) -> None:
    """Drive a robot on ROS 2, with what moves in place of its first joint, and shows if it is a robot."""
    with hold_interrupt():
        from pinposture.ros2 import Driver, DriverSettings, open_node

    with open_node("pinposture", ros_args or ()) as node:
        with hold_interrupt():
            settings = DriverSettings(rate=RATE, feed=feed)
            driver = Driver(node, operation.arm, settings, limits=limits, scene=scene)
            operation.goes_on = True
            driver.follow(operation)
        with _page(operation, options, carrier=carrier):
            spin_node(node, driver)
        driver.close()
        print_note(f"{driver.times.cycles} cycles, {driver.times.missed} missed; the arm holds")


def _simulate(
    operation: Operation,
    limits: Limits,
    scene: Scene,
    robot: SimulatedArmOptions,
    options: PageOptions,
    carrier: CarrierFeed | None,
) -> None:
    """Simulate the arm."""
    from pinposture.arm.mjcf import load_mujoco
    from pinposture.operate import SimulatedArm
    from pinposture.sim import DepthCamera, Sensing, Servos

    load_mujoco()
    arm = operation.arm
    sensing = {} if robot.noise is None else {"noise": robot.noise}
    q0 = None if robot.start is None else StartOptions(robot.start).read(arm, scene).q
    with hold_interrupt():
        simulated = SimulatedArm(
            arm,
            operation,
            limits,
            scene,
            servos=read_declared(Servos, {"frequency": robot.frequency}),
            sensing=read_declared(Sensing, sensing),
            camera=DepthCamera() if robot.camera else None,
            q0=q0,
            deadline=0.5 / RATE,
            feed=carrier,
        )
    try:
        with ending() as stop, _page(operation, options, simulated, carrier):
            simulated.run(stop)
    finally:
        simulated.close()
    print_note(f"{simulated.plant.cycles} cycles{simulated.plant.failure and '; ' + simulated.plant.failure}")
