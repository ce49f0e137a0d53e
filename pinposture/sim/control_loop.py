"""Run the plant in open loop with a given motion, or in closed loop with a feedback controller."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import NamedTuple, Protocol, TypeAlias

import numpy as np
from numpy.typing import ArrayLike, NDArray

from pinposture._validation import require_function, require_instance, require_positive
from pinposture.arm import Arm
from pinposture.collision import CollisionModel, Scene
from pinposture.errors import InvalidValue
from pinposture.motion import JointTrajectory, Run, Tracker, Trajectory
from pinposture.motion.held import HeldObject, joined
from pinposture.placement import Target
from pinposture.sim.contact import ContactModel
from pinposture.sim.model import Servos, build_plant_model
from pinposture.sim.plant import Plant, Sensing, Sensors
from pinposture.sim.simulation import END_TOLERANCE, Simulation, describe_saturation
from pinposture.units import CONVERGED, length_text

Array = NDArray[np.float64]

AnyMotion: TypeAlias = "Run | Trajectory | JointTrajectory | ArrayLike"
"""A run, a motion in time, a joint trajectory, or configurations (N, nq)."""

Progress = Callable[[int, int], object]
"""Called with the number of completed cycles and the total number of cycles."""


class SetPoints(NamedTuple):
    """Set points of the servos of an arm, sampled at a fixed period.

    Attributes:
        positions: joint positions, (N, nv) [rad or m]; those of continuous joints include full turns.
        dt: sampling period [s].
    """

    positions: Array
    dt: float

    def targets(self, arm: Arm) -> Callable[[float], Target]:
        """Return the posture of the motion as a function of time [s]; the last one after the end."""

        def at(time: float) -> Target:
            row = min(round(time / self.dt), len(self.positions) - 1)
            return Target.from_configuration(arm, arm.configuration(self.positions[row]))

        return at


def set_points(arm: Arm, motion: AnyMotion, dt: float | None = None) -> SetPoints:
    """Sample a motion for the servos of an arm.

    Args:
        arm: the arm to move.
        motion: the motion; joints of another arm are matched by name.
        dt: sampling period [s]. Required for configurations and for runs whose limits define none; other runs
            accept only their own. A joint trajectory is resampled with cubic polynomials, even if its rows
            are not equally spaced.

    Raises:
        InvalidValue: the motion does not fit the arm, or its sampling period is unknown.
    """
    timed = _timed(arm, motion, dt)
    return SetPoints(timed.positions, float(np.diff(timed.time).mean()))


def _timed(arm: Arm, motion: AnyMotion, dt: float | None) -> JointTrajectory:
    """Return a motion of an arm, sampled at a fixed period, as `set_points`."""
    if isinstance(motion, Trajectory | Run):
        run = motion.run if isinstance(motion, Trajectory) else motion
        timed = run.joint_trajectory(dt, force=True)
    elif isinstance(motion, JointTrajectory):
        timed = motion if dt is None else motion.sampled(dt)
    elif dt is None:
        raise InvalidValue("dt", None, "the time from one configuration to the next [s]")
    else:
        timed = JointTrajectory.from_configurations(arm, motion, dt)
    timed = timed.matched(arm)
    periods = np.diff(timed.time)
    if not len(periods):
        raise InvalidValue("motion (rows)", len(timed.time), "at least two")
    if np.ptp(periods) > CONVERGED * periods.max():
        timed = timed.sampled(float(np.median(periods)))
    return timed


class StreamingController(Protocol):
    """The interface of a controller in closed loop; `Tracker` implements it."""

    def update(self, target: Target) -> object:
        """Replace the target."""

    def step(self, q_measured: ArrayLike | None, dt: float | None = None) -> Array:
        """Return the joint step of a cycle, (nv,); `q_measured` is None without a measurement.

        Where `Sensing` measures torques, it also gets `torques`, those of the drives, (nv,) [N m or N].
        """

    @property
    def command(self) -> Array:
        """The configuration to send to the servos, (nq,)."""


def simulate(
    arm: Arm,
    motion: AnyMotion,
    servos: Servos | None = None,
    *,
    gravity: bool | ArrayLike = True,
    dt: float | None = None,
    hold: float = 0.5,
    progress: Progress | None = None,
    scene: Scene | None = None,
    tolerance: float | None = None,
    compensate: bool = False,
    contact: ContactModel | None = None,
) -> Simulation:
    """Send a motion to the servos of an arm (open loop).

    At time 0 the arm is at rest at the first configuration, and gravity starts to act. The set points
    interpolate the rows of the motion smoothly, half a cycle late; see `pinposture.sim.plant`.

    Args:
        arm: the arm, created from a URDF or from modules.
        motion: a run, a motion in time, a joint trajectory, or configurations (N, nq).
        servos: the servos; None: `Servos()`.
        gravity: whether there is gravity, or its acceleration, (3,) [m/s^2], world frame.
        dt: duration of a control cycle [s], if the motion has none.
        hold: minimum time for which the last set point is held [s].
        progress: called after each cycle.
        scene: obstacles for the clearance of the arm, and that it can touch; None: those of the run or
            motion.
        tolerance: mean distance of the control points from the last posture that counts as arrived [m];
            None: 1 % of the arm length. On the way five times as much is allowed, at least 5 % of the length.
        compensate: whether the servos are sent the commands for which the loaded arm makes the motion
            (`Arm.compensate`). The arm then starts as it is held, and the postures of the motion are its
            targets: it arrives at the last of them.
        contact: how the arm and obstacles touch; None: nothing does, and only clearances are recorded.

    Returns:
        The recorded motion. Its status is "converged" if the arm is within the tolerance at the end,
        otherwise "missed". The simulation ends early with "unstable" if a joint exceeds the speed
        `PLANT.runaway`.

    Raises:
        InvalidValue: the arm cannot be simulated, or the motion does not fit it; with contact, as
            `build_plant_model`.
        UnknownName: as `build_plant_model`.
        MujocoMissing: MuJoCo is not installed.
        URDFError: the description of the arm cannot be simulated.
        PostureError: with `compensate`, as `JointTrajectory.compensated`.
    """
    require_positive("hold", hold, zero=True)
    require_function("progress", progress)
    require_instance("compensate", compensate, bool, "True or False")
    require_instance("contact", contact, ContactModel | None, "a ContactModel, or None")
    if compensate and servos is not None and servos.gravity_compensation:
        raise InvalidValue("compensate", True, "False with servos that compensate gravity by torques")
    if compensate and gravity is not True:
        raise InvalidValue("gravity", gravity, "True with compensate; arm.with_gravity(...) sets another one")
    if tolerance is not None:
        require_positive("tolerance", tolerance)
    run = motion.run if isinstance(motion, Trajectory) else motion
    held: tuple[HeldObject, ...] = ()
    if isinstance(run, Run):
        scene = run.scene if scene is None else scene
        held = joined(run.held)
    timed = _timed(arm, motion, dt)
    period = float(np.diff(timed.time).mean())
    last = 1 + int(np.ceil(hold / period - 1e-9))
    asked = np.pad(timed.positions, ((0, last), (0, 0)), mode="edge")
    sent = asked
    targets: list[Target | None] = [None] * len(asked)
    if compensate:
        commands = timed.compensated(arm).matched(arm).positions
        sent = np.pad(commands, ((0, last), (0, 0)), mode="edge")
        # As the set points, which are halfway between two rows at the end of a cycle.
        between = np.concatenate([asked[:1], (asked[1:] + asked[:-1]) / 2.0])
        targets = [Target.from_configuration(arm, arm.configuration(row)) for row in between]
    rows = arm.drives.positions(sent)
    model = build_plant_model(arm, servos, gravity, scene=scene, contact=contact)
    plant = Plant(model, arm.drives.positions(asked[0]), period, rows[0])
    recording = Recording(plant, targets[0])
    for number, (row, target) in enumerate(zip(rows[1:], targets[1:], strict=True), start=1):
        if not recording.advance(row, target):
            break
        if progress is not None:
            progress(number, len(rows) - 1)
    return replace(recording.simulation("open", scene, tolerance), held=held)


def simulate_closed(
    arm: Arm,
    tracker: StreamingController,
    targets: Target | Callable[[float], Target],
    q0: ArrayLike,
    duration: float,
    dt: float,
    servos: Servos | None = None,
    *,
    gravity: bool | ArrayLike = True,
    sensing: Sensing | None = None,
    progress: Progress | None = None,
    scene: Scene | None = None,
    tolerance: float | None = None,
    contact: ContactModel | None = None,
) -> Simulation:
    """Drive an arm with a controller that uses position feedback (closed loop).

    In each cycle the controller receives the current target and the measured configuration. The set points
    interpolate its commands smoothly, half a cycle late; see `pinposture.sim.plant`. With a `Tracker` that
    compensates sag, the arm is held at its start as such drives hold it; otherwise gravity starts to act.

    Args:
        arm: the arm, created from a URDF or from modules.
        tracker: the controller.
        targets: one target, or a function of time [s] that returns it.
        q0: initial configuration, at rest, (nq,).
        duration: simulated time [s].
        dt: duration of a control cycle [s].
        servos: the servos; None: `Servos()`.
        gravity: whether there is gravity, or its acceleration, (3,) [m/s^2], world frame.
        sensing: the joint sensors; None: ideal ones, of positions alone.
        progress: called after each cycle.
        scene: obstacles for the clearance of the arm, and that it can touch; None: no obstacles.
        tolerance: mean distance of the control points from the last target that counts as arrived [m]; None:
            1 % of the length.
        contact: as in `simulate`.

    Returns:
        The recorded motion, with a status as in `simulate`.

    Raises:
        InvalidValue: the arm cannot be simulated, or a start, duration or command is invalid; with contact,
            as `build_plant_model`.
        UnknownName: as `build_plant_model`.
        MujocoMissing: MuJoCo is not installed.
        URDFError: the description of the arm cannot be simulated.
    """
    require_positive("duration", duration)
    require_function("progress", progress)
    require_positive("dt", dt)
    require_instance("contact", contact, ContactModel | None, "a ContactModel, or None")
    if tolerance is not None:
        require_positive("tolerance", tolerance)
    start = arm.checked_start(q0, "q0")
    if not (isinstance(targets, Target) or callable(targets)):
        raise InvalidValue("targets", targets, "a Target, or a function of time [s] that returns one")
    for method in ("update", "step"):
        if isinstance(tracker, type) or not callable(getattr(tracker, method, None)):
            raise InvalidValue("tracker", tracker, "a Tracker, or an object with `update`, `step`, `command`")

    def at(time: float) -> Target:
        target = targets if isinstance(targets, Target) else targets(time)
        require_instance(f"targets({time:.6g})", target, Target, "a Target")
        target.check_arm(arm)
        return target

    drives = arm.drives
    begin = arm.positions(start)
    command = start
    if isinstance(tracker, Tracker) and tracker.compensates:  # the arm is at rest on its springs
        command = arm.compensate(start)
    positions = drives.positions(begin + arm.difference(start, command))
    model = build_plant_model(arm, servos, gravity, scene=scene, contact=contact)
    plant = Plant(model, drives.positions(begin), dt, positions)
    recording = Recording(plant, at(0.0))
    sensors = Sensors(Sensing() if sensing is None else sensing)
    cycles = max(1, int(np.ceil(duration / dt - 1e-9)))
    arrived = 0
    done = 0
    for done in range(1, cycles + 1):
        measured = sensors.measure(recording.plant.positions, recording.plant.torques)
        felt = {} if sensors.torques is None else {"torques": sensors.torques}
        arrived += measured is not None
        tracker.update(at((done - 1) * dt))
        if arrived:  # until the first measurement arrives, the servos hold the start
            q = None if measured is None else arm.configuration(drives.joint_positions(measured))
            tracker.step(q, dt, **felt)
            following = arm.checked(tracker.command, f"{type(tracker).__name__}.command")
            positions = positions + drives.velocities(arm.difference(command, following))
            command = following
        if not recording.advance(positions, at(done * dt)):
            break
        if progress is not None:
            progress(done, cycles)
    return recording.simulation("closed", scene, tolerance, arrived / done)


class Recording:
    """Advances a plant and records its state and the target after each cycle."""

    def __init__(self, plant: Plant, target: Target | None = None) -> None:
        self.plant = plant
        self._rows: list[tuple[Array, Array, Array]] = []
        self._targets: list[Target] = []
        self._record(target)

    def _record(self, target: Target | None) -> None:
        self._rows.append((self.plant.set_points, self.plant.positions, self.plant.torques))
        if target is not None:
            self._targets.append(target)

    def advance(self, command: Array, target: Target | None = None) -> bool:
        """Simulate and record a cycle; if the arm runs away, record nothing and return False.

        Args:
            command: positions sent to the servos, (nv,) [rad or m].
            target: target of the control points at the end of the cycle.
        """
        if not self.plant.advance(command):
            return False
        self._record(target)
        return True

    def simulation(
        self, loop: str, scene: Scene | None, tolerance: float | None, measured: float = 1.0
    ) -> Simulation:
        """Return the recorded motion; for the arguments see `simulate` and `Simulation`."""
        plant = self.plant
        model = self.plant.model
        arm = self.plant.model.arm
        set_points, positions, torques = (np.array(column) for column in zip(*self._rows, strict=True))
        commanded = np.array([arm.configuration(row) for row in arm.drives.joint_positions(set_points)])
        q = np.array([arm.configuration(row) for row in arm.drives.joint_positions(positions)])
        commanded_points = np.array([arm.at(row).points for row in commanded])
        points = np.array([arm.at(row).points for row in q])
        contacts = None if plant.contacts is None else plant.contacts.history()
        clearance = np.full(len(q), np.inf)
        if scene is not None:
            moved = [scene if contacts is None else contacts.scene_in(row, scene) for row in range(len(q))]
            minima = (CollisionModel(arm, at).minimum(row) for at, row in zip(moved, q, strict=True))
            clearance = np.array([closest.distance for closest in minima])
        goal = self._targets[-1] if self._targets else Target(commanded_points[-1], np.ones(arm.n_modules))
        error = goal.mean_distance(points[-1])
        tolerance = END_TOLERANCE * arm.length if tolerance is None else tolerance
        status = "unstable"
        reason = plant.failure
        if not plant.failure:
            status = "converged" if error <= tolerance else "missed"
            reason = _final_error(error, tolerance, plant.dt * (len(q) - 1), plant.saturated)
        targets = weights = None
        if self._targets:
            weights = np.array([target.weights for target in self._targets], dtype=np.float64)
            # Target points with weight 0 may be NaN.
            targets = np.where(weights[..., None] > 0.0, [target.points for target in self._targets], 0.0)
        return Simulation(
            arm=arm,
            loop=loop,
            servos=model.servos,
            gravity=model.gravity,
            dt=plant.dt,
            timestep=plant.dt / plant.substeps,
            status=status,
            reason=reason,
            commanded=commanded,
            q=q,
            commanded_points=commanded_points,
            points=points,
            torques=torques,
            torque_limits=model.torque_limits[model.columns],
            saturated=plant.saturated,
            clearance=clearance,
            targets=targets,
            weights=weights,
            measured=measured,
            warnings=model.warnings,
            scene=scene,
            tolerance=tolerance,
            contacts=contacts,
        )


def _final_error(error: float, tolerance: float, time: float, saturated: Array) -> str:
    """Describe the error at the end, and whether servos were saturated."""
    off = f"mean point error {length_text(error)} after {time:.6g} s"
    allowed = length_text(tolerance, smallest=0.0)
    if error <= tolerance:
        return f"{off}, within the tolerance of {allowed}"
    return f"{off}, above the tolerance of {allowed}{describe_saturation(saturated)}"
