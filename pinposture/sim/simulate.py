"""Simulate an arm: sent a motion, or driven by a controller that is told where the arm is."""

from __future__ import annotations

from collections.abc import Callable
from typing import Protocol

import numpy as np
from numpy.typing import ArrayLike, NDArray

from pinposture._validation import require_positive
from pinposture.arm import Arm
from pinposture.collision import Scene
from pinposture.errors import InvalidValue
from pinposture.motion import Motion, Trajectory
from pinposture.placement import Target
from pinposture.sim.physics import physics_of
from pinposture.sim.plant import Plant
from pinposture.sim.recording import Recording
from pinposture.sim.sensing import Sensing, Sensors
from pinposture.sim.servos import Servos
from pinposture.sim.set_points import AnyMotion, set_points
from pinposture.sim.simulation import Simulation

Array = NDArray[np.float64]
Progress = Callable[[int, int], object]
"""Called with the number of cycles that are done, and that of all."""


class StreamingController(Protocol):
    """What a closed loop needs of a controller; `Tracker` is one."""

    def update(self, target: Target) -> object:
        """Take another target."""

    def step(self, q_measured: ArrayLike | None, dt: float | None = None) -> Array:
        """Take the step of a cycle, (nv,); None is a measurement that did not arrive."""

    @property
    def command(self) -> Array:
        """The configuration (nq,) to send to the servos."""


def simulate(
    arm: Arm,
    motion: AnyMotion,
    servos: Servos | None = None,
    gravity: bool | ArrayLike = True,
    dt: float | None = None,
    hold: float = 0.5,
    progress: Progress | None = None,
    scene: Scene | None = None,
    tolerance: float | None = None,
) -> Simulation:
    """Send a motion to the servos of an arm and see what the arm makes of it (open loop).

    At time 0 the arm stands at the first configuration, at rest, and its weight comes on. Set-points go along
    the rows of the motion smoothly, half a cycle late; see `pinposture.sim.plant`.

    Args:
        arm: the arm, made from a URDF or from modules.
        motion: a run, a motion in time, a joint trajectory, or configurations (N, nq).
        servos: the servos; `Servos()` if None.
        gravity: whether there is gravity, or its acceleration (3,) [m/s^2] in the world.
        dt: duration of a cycle [s], where the motion does not say.
        hold: how long the last set-point is held at least [s].
        progress: called after each cycle.
        scene: what the distances of the arm are recorded from; that of a run or a motion if None.
        tolerance: mean distance of the control points from the last posture of the motion at which the arm is
            there at the end [m]; 1 % of the arm length if None.

    Returns:
        What the arm did. Its status is "converged" where the arm is there at the end, "missed" where it is
        not. It ends early, with status "unstable", where the arm runs away.

    Raises:
        InvalidValue: an arm or a motion that cannot be simulated, or not with the other.
        MujocoMissing: MuJoCo is not installed.
        URDFError: MuJoCo cannot use the description of the arm.
    """
    require_positive("hold", hold, zero=True)
    if tolerance is not None:
        require_positive("tolerance", tolerance)
    if scene is None and isinstance(motion, Trajectory | Motion):
        scene = (motion.run if isinstance(motion, Motion) else motion).scene
    asked = set_points(arm, motion, dt)
    still = np.repeat(asked.positions[-1:], 1 + int(np.ceil(hold / asked.dt - 1e-9)), axis=0)
    rows = np.concatenate([asked.positions, still])
    recording = Recording(Plant(physics_of(arm, servos, gravity), rows[0], asked.dt))
    for number, row in enumerate(rows[1:], start=1):
        if not recording.advance(row):
            break
        if progress is not None:
            progress(number, len(rows) - 1)
    return recording.simulation("open", scene, tolerance)


def simulate_closed(
    arm: Arm,
    tracker: StreamingController,
    targets: Target | Callable[[float], Target],
    q0: ArrayLike,
    duration: float,
    dt: float,
    servos: Servos | None = None,
    gravity: bool | ArrayLike = True,
    sensing: Sensing | None = None,
    progress: Progress | None = None,
    scene: Scene | None = None,
    tolerance: float | None = None,
) -> Simulation:
    """Let a controller drive an arm that it measures in each cycle (closed loop).

    In each cycle the controller is given the target of the moment and the measured configuration. Set-points
    go along what it commands smoothly, half a cycle late; see `pinposture.sim.plant`.

    Args:
        arm: the arm, made from a URDF or from modules.
        tracker: the controller.
        targets: one target, or the target at a time [s].
        q0: configuration at which the arm stands at first, at rest, (nq,).
        duration: how long to simulate [s].
        dt: duration of a cycle [s].
        servos: the servos; `Servos()` if None.
        gravity: whether there is gravity, or its acceleration (3,) [m/s^2] in the world.
        sensing: how joint positions are measured; perfectly if None.
        progress: called after each cycle.
        scene: what the distances of the arm are recorded from; nothing if None.
        tolerance: mean distance of the control points from the last target at which the arm is there at the
            end [m]; 1 % of the arm length if None.

    Returns:
        What the arm did; the status as for `simulate`.

    Raises:
        InvalidValue: an arm that cannot be simulated; a start, a duration or a command that is none.
        MujocoMissing: MuJoCo is not installed.
        URDFError: MuJoCo cannot use the description of the arm.
    """
    require_positive("duration", duration)
    require_positive("dt", dt)
    if tolerance is not None:
        require_positive("tolerance", tolerance)
    start = arm.checked_start(q0, "q0")
    at = (lambda _: targets) if isinstance(targets, Target) else targets
    if not callable(at):
        raise InvalidValue("targets", targets, "a Target, or a function of the time [s] that gives one")
    positions = arm.positions(start)
    recording = Recording(Plant(physics_of(arm, servos, gravity), positions, dt), at(0.0))
    sensors = Sensors(Sensing() if sensing is None else sensing)
    cycles, arrived, done = max(1, int(np.ceil(duration / dt - 1e-9))), 0, 0
    command = start
    for done in range(1, cycles + 1):
        told = sensors.measure(recording.plant.positions)
        arrived += told is not None
        tracker.update(at((done - 1) * dt))
        if arrived:  # before that nothing can be commanded, and the servos hold
            tracker.step(None if told is None else arm.configuration(told), dt)
            sent = arm.checked(tracker.command, "tracker.command")
            positions = positions + arm.difference(command, sent)
            command = sent
        if not recording.advance(positions, at(done * dt)):
            break
        if progress is not None:
            progress(done, cycles)
    return recording.simulation("closed", scene, tolerance, arrived / done)
