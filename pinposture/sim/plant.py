"""The simulated arm, one control cycle after the other.

The servos are sent a configuration in each cycle, and their set-points go along the quadratic B-spline of
these: at the edges of cycles they are half-way between two of them, their speed is that of the step in
between, and in a cycle their acceleration is the second difference. So speeds have no jumps, and speeds and
accelerations keep the limits that the steps keep. The price is half a cycle of delay.

A servo may not give more than its limit, and a stiff one on a light link would be held to it at every change
of speed: its torque as it stands at the beginning of a physics step is large, though it is gone within
microseconds. So the limit is put on the torque that acts over the step, the one at the speed with which the
step ends. Which servos are at their limit is found by trying; where that goes round in circles, by a program.
"""

from __future__ import annotations

import warnings
from copy import copy
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from pinposture._validation import require_positive
from pinposture.errors import PostureWarning
from pinposture.sim.engine import load_mujoco, no_log_file
from pinposture.sim.physics import Physics, full_mass_matrix
from pinposture.sim.saturation import torques_within_limits
from pinposture.sim.servos import Servos

Array = NDArray[np.float64]

RUNAWAY = 1e3
"""Joint speed at which a simulation is given up [rad/s or m/s]: 160 turns a second."""

TRIALS = 6
"""How often the servos at their limit are guessed and corrected."""


class Cycle(NamedTuple):
    """What a control cycle ended with.

    Attributes:
        positions: joint positions of the arm, (nv,) [rad or m]; a continuous joint counts its turns.
        torques: what its servos gave in the last physics step, (nv,) [N m or N].
        saturated: number of physics steps in which each servo was at its limit, (nv,).
        failure: why the simulation cannot go on, in words; "" if it can.
    """

    positions: Array
    torques: Array
    saturated: NDArray[np.intp]
    failure: str


class Plant:
    """An arm with servos, sent a configuration in each cycle.

    Attributes:
        physics: the arm.
        dt: duration of a control cycle [s].
        substeps: physics steps in each.
        cycles: number of cycles since the start.
    """

    def __init__(self, physics: Physics, start: Array, dt: float) -> None:
        require_positive("dt", dt)
        self._mujoco = load_mujoco()
        self.physics, self.dt, self.cycles = physics, dt, 0
        self.substeps = max(1, int(np.ceil(dt / physics.servos.timestep - 1e-9)))
        self._model = copy(physics.model)  # its time step and servos are ours
        self._model.opt.timestep = dt / self.substeps
        self._model.actuator_gainprm[:, 0] = 1.0
        self._advice = _too_coarse(physics.servos, dt / self.substeps)
        if self._advice:
            warnings.warn(self._advice, PostureWarning, stacklevel=3)
        self._data = self._mujoco.MjData(self._model)
        self._driven = self._model.jnt_dofadr[self._model.actuator_trnid[:, 0]]
        self._at_limit = np.zeros(self._model.nv)  # 1 or -1 where a servo gives all that it has
        self._sent = physics.positions(start)
        self._at = self._sent.copy()  # where set-points are,
        self._speed = np.zeros(len(self._at))  # and how fast
        self._data.qpos[:] = self._at
        self._mujoco.mj_forward(self._model, self._data)
        most = physics.torque_limits
        self._torques = np.clip(self._data.qfrc_gravcomp, -most, most)

    @property
    def positions(self) -> Array:
        """Joint positions of the arm, (nv,) [rad or m]."""
        return np.array(self._data.qpos[self.physics.columns])

    @property
    def set_points(self) -> Array:
        """Where the servos of the arm are to hold it, (nv,) [rad or m]."""
        return np.array(self._at[self.physics.columns])

    @property
    def torques(self) -> Array:
        """What the servos of the arm give, (nv,) [N m or N]."""
        return np.array(self._torques[self.physics.columns])

    def advance(self, sent: Array) -> Cycle:
        """Simulate one cycle.

        Args:
            sent: where the servos are sent, (nv,) [rad or m].
        """
        now = self.physics.positions(sent)
        begun, first, last = self._at, self._speed, (now - self._sent) / self.dt
        follows = float(self.physics.servos.speed_reference)
        saturated = np.zeros(len(now), dtype=np.intp)
        failure = ""
        with no_log_file(self._mujoco):
            for number in range(self.substeps):
                share, midst = number / self.substeps, (number + 0.5) / self.substeps
                at = begun + self.dt * (share * first + share**2 / 2.0 * (last - first))
                before = np.array(self._data.qpos)
                self._step(at, follows * (first + midst * (last - first)))
                saturated += self._at_limit != 0.0
                # Not (a > b): a speed that is not a number is no speed to go on with.
                if not np.abs(self._data.qvel).max() < RUNAWAY:
                    failure = self._failure((number + 1) * self._model.opt.timestep)
                    self._data.qpos[:] = before
                    break
        self._at = (self._sent + now) / 2.0
        self._speed, self._sent = last, now
        self.cycles += 1
        return Cycle(self.positions, self.torques, saturated[self.physics.columns], failure)

    def _step(self, set_point: Array, speed: Array) -> None:
        """One physics step, with no servo above its limit."""
        data, damping, limits = self._data, self.physics.gains.damping, self.physics.torque_limits
        state = [np.array(part) for part in (data.qpos, data.qvel, data.qacc_warmstart)]
        borne = np.array(data.qfrc_gravcomp)  # what bears the weight is given by the servos, too
        spring = self.physics.gains.stiffness * (set_point - state[0]) + damping * speed
        for trial in range(TRIALS):
            free = self._at_limit == 0.0
            most = self._at_limit * np.where(free, 0.0, limits)  # no infinity times 0
            self._try(state if trial else None, np.where(free, spring, most - borne), damping * free)
            asked = spring - damping * data.qvel + borne
            wanted = np.sign(asked) * (np.abs(asked) > limits)
            if np.array_equal(wanted, self._at_limit) or not np.all(np.isfinite(asked)):
                self._torques = np.where(free, asked, most)
                return
            self._at_limit = wanted
        self._try(state, 0.0 * borne, 0.0 * damping)
        within = torques_within_limits(
            self._mobility(), np.array(data.qvel), spring, damping, -limits - borne, limits - borne
        )
        self._try(state, within, 0.0 * damping)
        self._torques = within + borne
        self._at_limit = np.sign(self._torques) * (np.abs(self._torques) >= limits * (1.0 - 1e-9))

    def _try(self, state: list[Array] | None, torques: Array, damping: Array) -> None:
        """Take a physics step with these torques, less damping times the speed at its end."""
        data = self._data
        if state is not None:
            data.qpos[:], data.qvel[:], data.qacc_warmstart[:] = state
        data.ctrl[:] = torques[self._driven]
        self._model.actuator_biasprm[:, 2] = -damping[self._driven]
        self._mujoco.mj_step(self._model, data)

    def _mobility(self) -> Array:
        """Speed that joints have at the end of a physics step for each unit of torque in it, (n, n)."""
        step = self._model.opt.timestep
        matrix = full_mass_matrix(self._model, self._data)
        inverse = np.linalg.inv(matrix + step * np.diag(self._model.dof_damping))
        return np.asarray(step * (inverse + inverse.T) / 2.0)

    def _failure(self, after: float) -> str:
        speeds = np.abs(np.array(self._data.qvel))
        worst = int(np.argmax(np.where(np.isfinite(speeds), speeds, np.inf)))
        number = int(self._model.joint(int(self._model.dof_jntid[worst])).name.removeprefix("joint_"))
        at = self.cycles * self.dt + after
        how_fast = f"{speeds[worst]:.3g}" if np.isfinite(speeds[worst]) else "no finite number"
        advice = f"; {self._advice}" if self._advice else ""
        return (
            f"joint {self.physics.joint_names[number]!r} runs away at {at:.6g} s: its speed is {how_fast} "
            f"[rad/s or m/s], above {RUNAWAY:g}{advice}"
        )


def _too_coarse(servos: Servos, timestep: float) -> str:
    """Why servos are not stable in steps of the physics, in words; empty if they are.

    Dampers act at the end of a physics step, springs at its beginning. Of a vibration that is too fast for
    the step only x' = (1 - h omega / (2 zeta)) x is left, which dies away for h < 4 zeta / omega.
    """
    longest = 2.0 * servos.damping / (np.pi * servos.frequency)
    if timestep <= longest:
        return ""
    return f"servos of {servos.frequency:g} Hz need physics steps below {longest:.3g} s to be stable"
