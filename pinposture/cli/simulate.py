"""`pinposture simulate`: simulate a motion with dynamics."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, NamedTuple

import typer

from pinposture.cli.inputs import (
    ARM,
    MOTION,
    OUTPUT,
    ArmOptions,
    JsonOption,
    SceneOption,
    read_declared,
    read_option,
    read_pairs,
    refuse_given,
)
from pinposture.cli.output import (
    FILES,
    File,
    check_directory,
    count_progress,
    end_with,
    examples,
    find_kept,
    load_kept,
    print_note,
    print_result,
    print_warning,
    words_of,
    write_files,
)
from pinposture.errors import InvalidValue

if TYPE_CHECKING:
    from pinposture.arm import Arm
    from pinposture.collision import Scene
    from pinposture.motion import JointTrajectory, Run, Trajectory
    from pinposture.sim import ContactModel, Servos, Simulation


@examples(
    "pinposture simulate out --dt 0.02 -o sim",
    "pinposture simulate out --dt 0.02 --closed --frequency 5 -o sim",
    "pinposture simulate joints.csv --urdf arm.urdf --no-gravity --json",
    "pinposture simulate out --dt 0.02 --contact --free can=0.3",
)
def run(
    *,
    path: Annotated[
        Path,
        typer.Argument(
            metavar="RUN",
            help=f"A saved run or motion, the directory of its {FILES.motion} or {FILES.run}, or a joint "
            "trajectory (.csv, .json, .npz).",
        ),
    ],
    urdf: Annotated[str | None, ARM("The arm, for a joint trajectory only.", "URDF")] = None,
    arm_options: ArmOptions,
    simulation_options: SimulationOptions,
    scene: SceneOption = None,
    output: Annotated[
        Path | None,
        OUTPUT(
            f"Save {FILES.simulation} and {FILES.simulated} here; otherwise nothing is saved.",
            "DIR",
            "--output -o",
        ),
    ] = None,
    as_json: JsonOption = False,
) -> None:
    """Simulate a motion with servos at the joints, and report the errors of the arm. Needs MuJoCo.

    In open loop, the motion is sent to the servos. In closed loop, the streaming controller measures the arm
    in each cycle and drives it to the target of a run, or along the postures of a motion in time. Errors of
    joints and posture are relative to the set points of the servos; in closed loop, the errors relative to
    the target are also reported.

    The clearance from the scene is reported; with --contact, the arm and the obstacles collide, and the first
    touch is. The effort limits of the description apply; those of templates are placeholders. The exit code
    is 0 if the arm arrived, stayed near its path and was clear of the scene, or touched only what the scene
    says that it may (touchable); 1 if not, 2 if it could not start or be saved.
    """
    from pinposture.arm.mjcf import load_mujoco
    from pinposture.collision import Scene
    from pinposture.sim import simulate

    load_mujoco()  # fails early if it is not installed
    settings = simulation_options.read()
    surroundings = None if scene is None else Scene.load(scene)
    arm, motion = _read(path, urdf, arm_options)
    check_directory(output)
    with count_progress("cycle") as progress:
        if simulation_options.closed:
            simulation = _simulate_closed(arm, motion, settings, surroundings, progress)
        else:
            simulation = simulate(
                arm,
                motion,
                servos=settings.servos,
                gravity=settings.gravity,
                dt=settings.cycle,
                hold=settings.hold,
                progress=progress,
                scene=surroundings,
                tolerance=settings.tolerance,
                compensate=settings.compensate,
                contact=settings.contact,
            )
    files, failure = write_files([] if output is None else simulation_files(simulation, output))
    summary = simulation.summary()
    if summary["saturated_joints"]:
        print_warning(_saturated(summary))
    data = {"run": str(path), **summary, "files": files}
    print_result(as_json, data, words_of(summary), files.values(), failure)
    end_with(simulation.faults)


class Settings(NamedTuple):
    """How a motion is simulated; see `simulate` of `pinposture.sim`."""

    servos: Servos
    gravity: bool
    cycle: float | None
    hold: float
    tolerance: float | None
    compensate: bool
    contact: ContactModel | None


@dataclass(frozen=True)
class SimulationOptions:
    """How a motion is simulated."""

    closed: Annotated[
        bool,
        MOTION(
            "Drive the arm by the streaming controller with feedback, rather than send it the motion.",
            flags="--closed",
        ),
    ] = False
    compensate: Annotated[
        bool,
        MOTION(
            "Send the commands for which the loaded arm makes the motion; the arm needs a stiffness.",
            flags="--compensate",
        ),
    ] = False
    no_gravity: Annotated[bool, MOTION("Simulate without gravity.", flags="--no-gravity")] = False
    frequency: Annotated[str | None, MOTION("{sim.Servos.frequency}", "HZ")] = None
    no_torque_limits: Annotated[
        bool, MOTION("Ignore the effort limits of the description.", flags="--no-torque-limits")
    ] = False
    dt: Annotated[
        str | None, MOTION("Duration of a cycle in seconds; required if the run has none.", "TIME")
    ] = None
    hold: Annotated[str, MOTION("Seconds to continue after the motion, 3600 at most.", "TIME")] = "2"
    tolerance: Annotated[
        str | None,
        MOTION(
            "Final mean point error that counts as arrived, in metres; default: 1 % of the length.", "LENGTH"
        ),
    ] = None
    contact: Annotated[
        bool, MOTION("Let the arm, the obstacles of the scene and free ones collide.", flags="--contact")
    ] = False
    friction: Annotated[
        str | None, MOTION("{sim.ContactModel.friction}; with --contact, 1 by default.", "NUMBER")
    ] = None
    free: Annotated[
        list[str] | None,
        MOTION(
            "Mass of an obstacle that is free to move, in kg or with a unit, with --contact: can=0.3. May be "
            "repeated.",
            "NAME=MASS",
        ),
    ] = None

    def read(self) -> Settings:
        """Return the settings; raise a `PostureError` for a value that is refused."""
        from pinposture.schema import Duration, Length, quantity
        from pinposture.sim import Servos

        hold = read_option("--hold", self.hold, Annotated[float, quantity("time", least=0.0, most=3600.0)])
        cycle = read_option("--dt", self.dt, Duration)
        near = read_option("--tolerance", self.tolerance, Length)
        options = {"frequency": self.frequency, "torque_limits": not self.no_torque_limits}
        servos = read_declared(Servos, options)
        contact = self._read_contact()
        return Settings(servos, not self.no_gravity, cycle, hold, near, self.compensate, contact)

    def _read_contact(self) -> ContactModel | None:
        from pinposture.schema import quantity
        from pinposture.sim import ContactModel

        if not self.contact:
            refuse_given({"--friction": self.friction, "--free": self.free}, "nothing without --contact")
            return None
        allowed = "NAME=MASS, such as can=0.3, each name once"
        masses = {
            name: read_option("--free", mass, Annotated[float, quantity("mass", above=0.0)])
            for name, mass in read_pairs("--free", self.free, allowed).items()
        }
        model: ContactModel = read_declared(ContactModel, {"friction": self.friction, "masses": masses})
        return model


def simulation_files(simulation: Simulation, directory: Path) -> list[File]:
    """Return the files of a simulation in a directory."""
    from pinposture.motion import save
    from pinposture.storage import write_figure
    from pinposture.viz.simulation import plot_simulation

    return [
        ("plot", directory / FILES.simulated, lambda path: write_figure(path, plot_simulation(simulation))),
        # The last: if it exists, both do.
        ("simulation", directory / FILES.simulation, partial(save, simulation)),
    ]


def _read(
    path: Path, urdf: str | None, arm_options: ArmOptions
) -> tuple[Arm, Run | Trajectory | JointTrajectory]:
    """Read the arm and its motion."""
    from pinposture.motion import JointTrajectory, load
    from pinposture.motion.files import kind_of

    file, which = find_kept(path)
    if which:
        print_note(which)
    if kind_of(file) is not JointTrajectory:
        kept = load_kept(file)
        refuse_given({"--urdf": urdf}, "nothing; a saved run contains its arm")
        arm_options.refuse("nothing; a saved run contains its arm")
        return kept.arm, kept
    motion = load(file, JointTrajectory)
    if urdf is None:
        raise InvalidValue("--urdf", None, f"the description of the arm, which {file} does not contain")
    arm = arm_options.read(urdf)
    return arm, motion.matched(arm)


def _simulate_closed(
    arm: Arm,
    motion: Run | Trajectory | JointTrajectory,
    settings: Settings,
    scene: Scene | None,
    progress: Callable[[int, int], object],
) -> Simulation:
    """Simulate a motion as in `simulate`, but driven by the streaming controller."""
    from pinposture.control import Limits
    from pinposture.motion import Run, Tracker, Trajectory
    from pinposture.sim import set_points, simulate_closed

    asked = set_points(arm, motion, settings.cycle)
    kept = motion.run if isinstance(motion, Trajectory) else motion
    # A run has one target; a motion in time has one for each moment.
    targets = motion.target if isinstance(motion, Run) else asked.targets(arm)
    limits = Limits(dt=asked.dt)
    if isinstance(kept, Run):
        limits = replace(kept.limits, dt=asked.dt)
        scene = kept.scene if scene is None else scene
    if isinstance(motion, Trajectory):  # it keeps its limits: following it does not require early braking
        limits = replace(limits, acceleration=None, jerk=None)
    return simulate_closed(
        arm,
        Tracker(arm, limits=limits, scene=scene, compensate=settings.compensate),
        targets,
        q0=arm.configuration(asked.positions[0]),
        duration=asked.dt * (len(asked.positions) - 1) + settings.hold,
        dt=asked.dt,
        servos=settings.servos,
        gravity=settings.gravity,
        progress=progress,
        scene=scene,
        tolerance=settings.tolerance,
        contact=settings.contact,
    )


def _saturated(summary: dict[str, Any]) -> str:
    joints = summary["saturated_joints"]
    share = 100.0 * summary["saturated_share"]
    count = "1 servo was at its limit" if len(joints) == 1 else f"{len(joints)} servos were at their limit"
    listed = f"{', '.join(joints[:6])}{', ...' if len(joints) > 6 else ''}"
    return f"{count}, up to {share:.3g} % of the time: {listed}"
