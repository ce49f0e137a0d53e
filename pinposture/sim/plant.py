"""The plant: the simulated arm with servos and position sensors, advanced one control cycle at a time.

**Set points.** In each cycle a configuration is sent to the servos. The set points follow the quadratic
B-spline of these configurations: at the ends of a cycle they are halfway between two configurations, with the
velocity of the step in between; within a cycle their acceleration is constant, the second difference. So
velocity is continuous, and velocity and acceleration keep the limits of the steps, half a cycle late.

**Actuator saturation.** A stiff servo on a light link requests a large torque at the start of a physics step,
which its damping removes within microseconds. Clipping this torque would make the servo chatter. The limit
therefore applies to the torque at the velocity at the end of the step. The set of saturated servos is found
by iteration or, if that cycles, by a quadratic program.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Collection
from copy import copy
from typing import Annotated, NamedTuple, cast

import numpy as np
from numpy.typing import NDArray

from pinposture._validation import require_known, require_positive, require_share
from pinposture.arm.mjcf import load_mujoco, no_log_file
from pinposture.errors import warn_caller
from pinposture.schema import CheckedBy, Count, Declared, JointDistance, WholeNumber, declared, quantity
from pinposture.sim.contact import ContactRecorder
from pinposture.sim.model import (
    PlantModel,
    Servos,
    full_mass_matrix,
    torques_within_limits,
)

Array = NDArray[np.float64]

FAILURES = ("stuck", "limp", "weak")
"""How joints fail, as arguments of `Plant.fail`."""


class PlantSettings(NamedTuple):
    """How servos are solved, how drives fail, and when a simulation ends."""

    trials: int = 6
    """Largest number of iterations on the set of saturated servos before the quadratic program."""

    weak: float = 0.3
    """Share of the torque by which weight loads a joint at most that a weak drive gives."""

    runaway: float = 1e3
    """Joint speed at which a simulation ends as unstable [rad/s or m/s]."""


PLANT = PlantSettings()


class Plant:
    """A simulated arm with servos.

    Positions, set points and torques are those of the joints that drives move, in the order of `Arm.drives`.

    Attributes:
        model: the model of the arm.
        dt: duration of a control cycle [s].
        substeps: number of physics steps per cycle.
        cycles: number of cycles since the start.
        failure: why the simulation cannot continue; "" if it can.
        contacts: records what touches; None without contact.
    """

    def __init__(self, model: PlantModel, start: Array, dt: float, set_points: Array | None = None) -> None:
        """Place an arm at rest.

        Args:
            model: the model of the arm.
            start: positions of its driven joints, (nv,) [rad or m].
            dt: duration of a control cycle [s].
            set_points: those of its servos, (nv,) [rad or m]; where the arm is if None.
        """
        require_positive("dt", dt)
        self._mujoco = load_mujoco()
        self.model = model
        self.dt = dt
        self.cycles = 0
        self.failure = ""
        self.substeps = max(1, int(np.ceil(dt / model.servos.timestep - 1e-9)))
        self._model = copy(model.model)  # the time step and the servo gains are changed below
        self._model.opt.timestep = dt / self.substeps
        self._model.actuator_gainprm[:, 0] = 1.0
        self._advice = _too_coarse(model.servos, dt / self.substeps)
        if self._advice:
            warn_caller(self._advice)
        self._data = self._mujoco.MjData(self._model)
        self._driven = self._model.jnt_dofadr[self._model.actuator_trnid[:, 0]]
        self._coupled = len(model.coupling) > len(model.coupling.T)
        self._joints = len(model.rest)  # behind them are those of free obstacles
        self._at_limit = np.zeros(self._joints)  # 1 or -1 where a servo is saturated
        self._saturated = np.zeros(self._joints, dtype=np.intp)  # number of saturated physics steps
        self._sent = model.positions(start if set_points is None else set_points)
        self._set_points = self._sent.copy()
        self._speed = np.zeros(len(self._sent))  # of the set points
        self._data.qpos[: self._joints] = model.positions(start)
        self._mujoco.mj_forward(self._model, self._data)
        self.contacts: ContactRecorder | None = None
        if model.contact is not None:
            self.contacts = ContactRecorder(self._model, model.contact, model.touchable)
            self.contacts.end_cycle(self._data, dt)
        self._free_damping = np.array(self._model.dof_damping)
        self._limits = np.array(model.torque_limits)
        self._torques = np.clip(self._compensation, -self._limits, self._limits)

    @property
    def positions(self) -> Array:
        """Positions of the joints that drives move, (nv,) [rad or m]."""
        return np.array(self._data.qpos[self.model.columns])

    @property
    def set_points(self) -> Array:
        """Set points of the servos of the arm, (nv,) [rad or m]."""
        return np.array(self._set_points[self.model.columns])

    @property
    def torques(self) -> Array:
        """Torques of the servos of the arm, (nv,) [N m or N]."""
        return np.array(self._torques[self.model.columns])

    @property
    def saturated(self) -> Array:
        """Fraction of physics steps in which each servo of the arm was saturated, (nv,)."""
        return self._saturated[self.model.columns] / max(self.cycles * self.substeps, 1)

    @property
    def _compensation(self) -> Array:
        """Servo torques that compensate gravity, (n,) [N m or N]; zero where a joint follows another."""
        compensation = np.zeros(self._joints)
        compensated = self._data.qfrc_gravcomp[: self._joints]
        compensation[np.sort(self._driven)] = self.model.coupling.T @ compensated
        return compensation

    def fail(
        self,
        stuck: str | Collection[str] = (),
        limp: str | Collection[str] = (),
        weak: str | Collection[str] = (),
    ) -> None:
        """Let joints fail from now on; joints that failed before and are not named work again.

        Args:
            stuck: a joint or joints, by name, that do not move any more.
            limp: those whose drives have no torque any more.
            weak: those whose drives have no more than `PLANT.weak` of the torque by which weight
                loads them in the outstretched arm.

        Raises:
            UnknownName: a joint that no drive moves.
        """
        names = self.model.arm.drives.names
        columns = dict(zip(names, self.model.columns, strict=True))
        stuck, limp, weak = ((given,) if isinstance(given, str) else given for given in (stuck, limp, weak))
        for name in (*stuck, *limp, *weak):
            require_known("joint with a drive", name, names)
        self._limits = np.array(self.model.torque_limits)
        if weak:
            arm = self.model.arm
            loads = PLANT.weak * np.abs(arm.drives.torques(arm.outstretched_torques))
            for name in weak:
                at = columns[name]
                self._limits[at] = min(self._limits[at], loads[names.index(name)])
        self._limits[[columns[name] for name in limp]] = 0.0
        self._model.dof_damping[:] = self._free_damping
        self._model.dof_damping[[columns[name] for name in stuck]] = 1e9  # 100 N m move it by 1e-7 rad/s

    def advance(self, command: Array) -> bool:
        """Simulate one control cycle; return False if the arm runs away, see `failure`.

        Args:
            command: positions sent to the servos, (nv,) [rad or m].
        """
        sent = self.model.positions(command)
        begin = self._set_points
        first = self._speed
        last = (sent - self._sent) / self.dt
        follows = float(self.model.servos.speed_reference)
        with no_log_file(self._mujoco):
            for number in range(self.substeps):
                share = number / self.substeps
                midst = (number + 0.5) / self.substeps
                at = begin + self.dt * (share * first + share**2 / 2.0 * (last - first))
                before = np.array(self._data.qpos)
                self._step(at, follows * (first + midst * (last - first)))
                self._saturated += self._at_limit != 0.0
                # Not written as (a > b), which is False for NaN.
                if not np.abs(self._data.qvel).max() < PLANT.runaway:
                    self.failure = self._runaway((number + 1) * self._model.opt.timestep)
                    self._data.qpos[:] = before
                    break
                if self.contacts is not None:
                    self.contacts.observe(self._data, (self.cycles + share) * self.dt)
        self._set_points = (self._sent + sent) / 2.0
        self._speed = last
        self._sent = sent
        self.cycles += 1
        if self.contacts is not None and not self.failure:
            self.contacts.end_cycle(self._data, self.dt)
        return not self.failure

    def _step(self, set_point: Array, speed: Array) -> None:
        """Take a physics step in which no servo exceeds its limit."""
        data = self._data
        damping = self.model.gains.damping
        limits = self._limits
        state = [np.array(part) for part in (data.qpos, data.qvel, data.qacc_warmstart)]
        compensation = self._compensation  # it counts towards the limits
        own_positions = state[0][: self._joints]
        spring = self.model.gains.springs(set_point - own_positions) + damping * speed
        if not self._coupled:
            self._mujoco.mj_step1(self._model, data)  # what depends on the state alone, for all trials
        tried: set[tuple[float, ...]] = set()
        for trial in range(PLANT.trials):
            tried.add(tuple(self._at_limit.tolist()))
            free = self._at_limit == 0.0
            limiting = self._at_limit * np.where(free, 0.0, limits)  # no infinity times 0
            self._integrate(
                state if trial else None, np.where(free, spring, limiting - compensation), damping * free
            )
            requested = spring - damping * data.qvel[: self._joints] + compensation
            saturated = np.sign(requested) * (np.abs(requested) > limits)
            if np.array_equal(saturated, self._at_limit) or not np.all(np.isfinite(requested)):
                self._torques = np.where(free, requested, limiting)
                return
            if tuple(saturated.tolist()) in tried:  # the trials repeat themselves from here
                break
            self._at_limit = saturated
        self._integrate(state, 0.0 * compensation, 0.0 * damping)
        driven = self._driven
        within = np.zeros(len(spring))
        within[driven] = torques_within_limits(
            self._mobility()[np.ix_(driven, driven)],
            np.array(data.qvel)[driven],
            spring[driven],
            damping[driven],
            (-limits - compensation)[driven],
            (limits - compensation)[driven],
        )
        self._integrate(state, within, 0.0 * damping)
        self._torques = within + compensation
        self._at_limit = np.sign(self._torques) * (np.abs(self._torques) >= limits * (1.0 - 1e-9))

    def _integrate(self, state: list[Array] | None, torques: Array, damping: Array) -> None:
        """Take a physics step with these torques minus damping times the final velocity.

        Args:
            state: the state in which the step began, if it is taken anew.
            torques: torques of the servos [N m or N].
            damping: their damping.
        """
        data = self._data
        if state is not None:
            data.qpos[:], data.qvel[:], data.qacc_warmstart[:] = state
        if self._coupled:
            self._integrate_coupled(torques, damping)
            return
        data.ctrl[:] = torques[self._driven]
        self._model.actuator_biasprm[:, 2] = -damping[self._driven]
        self._mujoco.mj_step2(self._model, data)

    def _integrate_coupled(self, torques: Array, damping: Array) -> None:
        """Take a physics step of the independent joints; coupled joints follow.

        With positions q = rest + A u, the motion of u obeys A^T (M A u'' + bias) = A^T torques exactly.
        Damping is evaluated at the end of the step, as in `mj_step`. Joints stop instantly at their limits.
        """
        data = self._data
        coupling = self.model.coupling
        step = self._model.opt.timestep
        self._mujoco.mj_forward(self._model, data)
        passive = self._model.dof_damping
        matrix = full_mass_matrix(self._model, data)
        forces = torques + data.qfrc_passive + passive * data.qvel - data.qfrc_bias
        moving = coupling.T @ (matrix + step * np.diag(passive + damping)) @ coupling
        speeds = coupling @ np.linalg.solve(moving, coupling.T @ (matrix @ data.qvel + step * forces))
        reached = data.qpos + step * speeds
        lower, upper = self._model.jnt_range.T
        stopped = (self._model.jnt_limited != 0) & ((reached < lower) | (reached > upper))
        if np.any(stopped):
            # Only driven joints have limits in the model; the joints that follow them stop, too.
            keeps = ~np.any(coupling[stopped] != 0.0, axis=0)
            speeds = coupling[:, keeps] @ np.linalg.lstsq(coupling[:, keeps], speeds, rcond=None)[0]
            reached = data.qpos + step * speeds
        data.qpos[:] = reached
        data.qvel[:] = speeds
        data.time += step

    def _mobility(self) -> Array:
        """Return the final joint velocity of a physics step per unit of torque, (n, n)."""
        step = self._model.opt.timestep
        count = self._joints
        matrix = full_mass_matrix(self._model, self._data)[:count, :count]
        coupling = self.model.coupling
        moving = coupling.T @ (matrix + step * np.diag(self._model.dof_damping[:count])) @ coupling
        inverse = coupling @ np.linalg.inv(moving) @ coupling.T
        return np.asarray(step * (inverse + inverse.T) / 2.0)

    def _runaway(self, after: float) -> str:
        """Describe which joint is fastest, at a time after the start of the cycle [s]."""
        speeds = np.abs(np.array(self._data.qvel))
        worst = int(np.argmax(np.where(np.isfinite(speeds), speeds, np.inf)))
        name = self._model.joint(int(self._model.dof_jntid[worst])).name
        at = self.cycles * self.dt + after
        speed = f"{speeds[worst]:.3g}" if np.isfinite(speeds[worst]) else "no finite number"
        reason = f"its speed is {speed} [rad/s or m/s], above {PLANT.runaway:g}"
        advice = f"; {self._advice}" if self._advice else ""
        return f"joint {name!r} runs away at {at:.6g} s: {reason}{advice}"


def _too_coarse(servos: Servos, timestep: float) -> str:
    """Return why servos are unstable with a physics step; "" if they are stable.

    Damping is integrated implicitly, stiffness explicitly. A mode that is fast relative to the step h follows
    x' = (1 - h omega / (2 zeta)) x, which is stable for h < 4 zeta / omega.
    """
    frequency = cast(float, servos.frequency)  # that of a plant is known
    longest = 2.0 * servos.damping / (np.pi * frequency)
    if timestep <= longest:
        return ""
    return f"servos of {frequency:g} Hz need physics steps below {longest:.3g} s to be stable"


_TorqueNoise = Annotated[float, quantity("torque", "force", least=0.0)]


@declared()
class Sensing(Declared):
    """Sensors of joint positions, ideal by default, and of torques.

    Attributes:
        noise: standard deviation of a measured position [rad or m].
        resolution: quantisation step of a measured position [rad or m]; 0 for none.
        dropped: probability that no measurement arrives in a cycle.
        latency: age of a measurement [cycles].
        period: time between new readings [cycles]; in between, the last one is repeated.
        seed: random seed for noise and dropped measurements.
        torque_noise: standard deviation of a measured torque of a drive [N m or N]; None: torques are not
            measured.
    """

    noise: JointDistance = 0.0
    resolution: JointDistance = 0.0
    dropped: Annotated[float, CheckedBy(require_share)] = 0.0
    latency: WholeNumber = 0
    period: Count = 1
    seed: WholeNumber = 0
    torque_noise: _TorqueNoise | None = None


class Sensors:
    """The sensors of an arm during a simulation.

    Attributes:
        torques: the torques of its drives that came with the last measurement, (nv,) [N m or N]; None if none
            came, or they are not measured.
    """

    def __init__(self, sensing: Sensing) -> None:
        self.torques: Array | None = None
        self._sensing = sensing
        self._rng = np.random.default_rng(sensing.seed)
        self._kept: deque[tuple[Array, Array | None]] = deque(maxlen=sensing.latency + 1)
        self._cycles = 0

    def measure(self, positions: Array, torques: Array | None = None) -> Array | None:
        """Return the measurement that arrives in this cycle, (nv,) [rad or m], or None.

        Args:
            positions: true joint positions, (nv,) [rad or m].
            torques: true torques of the drives, (nv,) [N m or N]; None: they are not measured.
        """
        sensing = self._sensing
        repeats = self._cycles % sensing.period
        self._kept.append(self._kept[-1] if repeats else (self._read(positions), self._felt(torques)))
        self._cycles += 1
        if self._rng.random() < sensing.dropped:
            self.torques = None
            return None
        # During the initial latency this is the first measurement, taken with the arm at rest.
        measured, self.torques = self._kept[0]
        return measured

    def _felt(self, torques: Array | None) -> Array | None:
        noise = self._sensing.torque_noise
        if torques is None or noise is None:
            return None
        return np.asarray(torques + noise * self._rng.standard_normal(len(torques)))

    def _read(self, positions: Array) -> Array:
        sensing = self._sensing
        measured = positions + sensing.noise * self._rng.standard_normal(len(positions))
        if sensing.resolution > 0.0:
            measured = sensing.resolution * np.round(measured / sensing.resolution)
        return np.asarray(measured)
