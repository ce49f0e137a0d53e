"""The result of a simulation: what was asked of the arm, and what it did."""

from __future__ import annotations

from dataclasses import dataclass, field
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pinposture.arm import Arm
from pinposture.collision import Scene
from pinposture.motion.trajectory import closest, describe_result, find_faults
from pinposture.sim.servos import Servos

Array = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class Simulation:
    """A motion of a simulated arm. Rows are the ends of control cycles; the first one is the start.

    Attributes:
        arm: the arm.
        loop: "open" if its servos were sent a motion, "closed" if a controller was told where the arm was.
        servos: its servos.
        gravity: acceleration of free fall, (3,) [m/s^2], world frame.
        dt: duration of a control cycle [s].
        timestep: step of the physics [s].
        status: how it ended: "converged" if the arm is where it should be then, "missed" if not, "unstable"
            if it ran away; the rows end before that. See `pinposture.motion.trajectory`.
        reason: why, in words.
        commanded: configurations that the set-points of the servos make up, (N, nq).
        q: configurations of the arm, (N, nq).
        commanded_points: control points at the former, (N, m, 3) [m], world frame.
        points: control points of the arm, (N, m, 3) [m], world frame.
        torques: what the servos gave, (N, nv) [N m or N].
        torque_limits: the most that they could give, (nv,) [N m or N]; infinite without a limit.
        saturated: share of the physics steps in which each servo gave all that it had, (nv,).
        clearance: smallest distance of the arm to an obstacle, or between its parts, (N,) [m]; negative in
            penetration, infinite where there was no scene. Links collide with nothing here.
        targets: where the control points should be, (N, m, 3) [m]; None in open loop.
        weights: whether each control point has a target, 0 if not, (N, m); None in open loop.
        measured: share of the cycles in which a measurement arrived; 1 in open loop.
        warnings: what had to be settled in the description of the arm, in words.
        scene: what those distances are measured to; None if nothing.
    """

    arm: Arm
    loop: str
    servos: Servos
    gravity: Array
    dt: float
    timestep: float
    status: str
    reason: str
    commanded: Array = field(repr=False)
    q: Array = field(repr=False)
    commanded_points: Array = field(repr=False)
    points: Array = field(repr=False)
    torques: Array = field(repr=False)
    torque_limits: Array = field(repr=False)
    saturated: Array = field(repr=False)
    clearance: Array = field(repr=False)
    targets: Array | None = field(default=None, repr=False)
    weights: Array | None = field(default=None, repr=False)
    measured: float = 1.0
    warnings: tuple[str, ...] = ()
    scene: Scene | None = None

    def __post_init__(self) -> None:
        for value in vars(self).values():
            if isinstance(value, np.ndarray):
                value.flags.writeable = False

    @property
    def finished(self) -> bool:
        """True if the simulation came to its end, wherever the arm is then."""
        return self.status != "unstable"

    @property
    def converged(self) -> bool:
        """True if the arm is where it should be at the end."""
        return self.status == "converged"

    @cached_property
    def faults(self) -> tuple[str, ...]:
        """What went wrong, in words; empty if nothing did."""
        return find_faults(self)

    @property
    def excess(self) -> None:
        """None: what an arm does in a simulation has no limits but those of its drives."""

    @property
    def verdict(self) -> str:
        """What to think of it, in one line."""
        return describe_result(self)

    @cached_property
    def time(self) -> Array:
        """When each row is, (N,) [s]."""
        return np.asarray(self.dt * np.arange(len(self.q), dtype=np.float64))

    @cached_property
    def joint_error(self) -> Array:
        """How far each joint is from its set-point, (N, nv) [rad or m]."""
        rows = zip(self.q, self.commanded, strict=True)
        return np.asarray(np.abs(np.array([self.arm.difference(sent, taken) for taken, sent in rows])))

    @cached_property
    def point_errors(self) -> Array:
        """Distance of each control point from where the commanded configuration has it, (N, m) [m]."""
        return np.asarray(np.linalg.norm(self.points - self.commanded_points, axis=2))

    @cached_property
    def posture_error(self) -> Array:
        """Sum of those distances, (N,) [m]."""
        return np.asarray(self.point_errors.sum(axis=1))

    @cached_property
    def target_errors(self) -> Array | None:
        """Distance of each control point from its target, (N, m) [m]; 0 if it has none. None in open loop."""
        if self.targets is None or self.weights is None:
            return None
        return np.where(self.weights > 0.0, np.linalg.norm(self.points - self.targets, axis=2), 0.0)

    @cached_property
    def torque_share(self) -> Array:
        """The largest share of its torque limit that any servo gave, (N,); 0 where there are no limits."""
        return np.asarray((np.abs(self.torques) / self.torque_limits).max(axis=1))

    def summary(self) -> dict[str, Any]:
        """The simulation in numbers that JSON can hold [rad, m, s, N m]."""
        m = self.arm.n_modules
        mean = self.posture_error / m
        largest = np.unravel_index(int(self.point_errors.argmax()), self.point_errors.shape)
        told: dict[str, Any] = {
            "verdict": self.verdict,
            "status": self.status,
            "converged": self.converged,
            "reason": self.reason,
            "faults": list(self.faults),
            "loop": self.loop,
            "gravity": self.gravity.tolist(),
            "duration": float(self.time[-1]),
            "cycles": len(self.q) - 1,
            "dt": self.dt,
            "timestep": self.timestep,
            "arm_length": self.arm.length,
            "servos": vars(self.servos),
            "turning_joints": self._joint_summary(~self.arm.slides, "rad"),
            "sliding_joints": self._joint_summary(self.arm.slides, "m"),
            "mean_point_error": {
                "rms": _rms(mean),
                "largest": float(mean.max()),
                "end": float(mean[-1]),
            },
            "largest_point_error": {
                "value": float(self.point_errors[largest]),
                "point": self.arm.control_points[int(largest[1])],
                "time": float(self.time[largest[0]]),
            },
            "target_error": None,
            "largest_torque": self._torque_summary(),
            "saturated_share": float(self.saturated.max(initial=0.0)),
            "saturated_joints": [self.arm.joint_names[j] for j in np.flatnonzero(self.saturated > 0.0)],
            "measured_share": self.measured,
            "clearance": closest(self),
            "warnings": list(self.warnings),
        }
        if self.target_errors is not None and self.weights is not None:
            to_target = self.target_errors.sum(axis=1) / np.maximum((self.weights > 0.0).sum(axis=1), 1)
            told["target_error"] = {
                "rms": _rms(to_target),
                "largest": float(to_target.max()),
                "end": float(to_target[-1]),
            }
        return told

    def _joint_summary(self, which: NDArray[np.bool_], unit: str) -> dict[str, Any] | None:
        """Errors of some of the joints; None if there are none."""
        columns = np.flatnonzero(which)
        if not len(columns):
            return None
        errors = self.joint_error[:, columns]
        row, column = np.unravel_index(int(errors.argmax()), errors.shape)
        return {
            "unit": unit,
            "rms": _rms(errors),
            "largest": float(errors.max()),
            "joint": self.arm.joint_names[columns[int(column)]],
            "time": float(self.time[int(row)]),
            "end": float(errors[-1].max()),
        }

    def _torque_summary(self) -> dict[str, Any]:
        """The torque that is largest relative to its limit, or where there are none, largest of all."""
        shares = np.abs(self.torques) / self.torque_limits
        sizes = shares if np.any(shares) else np.abs(self.torques)
        row, column = np.unravel_index(int(sizes.argmax()), sizes.shape)
        limit = float(self.torque_limits[int(column)])
        return {
            "joint": self.arm.joint_names[int(column)],
            "value": float(self.torques[row, column]),
            "limit": limit if np.isfinite(limit) else None,
            "time": float(self.time[int(row)]),
        }


def _rms(values: Array) -> float:
    return float(np.sqrt(np.mean(np.square(values))))
