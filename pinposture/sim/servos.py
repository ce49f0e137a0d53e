"""Joint servos: position control with velocity feedback, gains by inertia, and actuator saturation."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from pinposture._validation import require_positive
from pinposture.control.planner.avoidance import solve
from pinposture.errors import InvalidValue

Array = NDArray[np.float64]

UNBOUNDED = 1e30  # bound of the quadratic program that stands for none


class Gains(NamedTuple):
    """Gains of the servos.

    Attributes:
        stiffness: torque per unit of position error, (n,) [N m/rad or N/m].
        damping: torque per unit of velocity, (n,) [N m s/rad or N s/m].
    """

    stiffness: Array
    damping: Array


@dataclass(frozen=True)
class Servos:
    """Position servos: torque = stiffness (set point - position) - damping (velocity - its reference).

    Stiffnesses are proportional to the inertias that the joints carry, and so large that no vibration of the
    whole arm on its servos is slower than `frequency`. Servos tuned joint by joint to that frequency would
    leave a long arm compliant: joints are springs in series, and the slowest vibration of 40 joints has a
    quarter of that frequency, that of 200 joints a ninth.

    Attributes:
        frequency: natural frequency of the slowest vibration of the arm on its servos [Hz]. Under gravity the
            tip sags by about 9.81 / (2 pi frequency)^2 [m], whatever the arm: 2.5 mm at 10 Hz.
        damping: damping ratio of that vibration; 1 is critical. Faster ones are damped more.
        torque_limits: True for the effort limits of the description, False for none, or one limit for all
            joints [N m or N]. Arms from templates have a placeholder of 100.
        gravity_compensation: whether the torques that balance gravity are added, from the model of the arm.
        speed_reference: whether damping acts on the velocity relative to that of the set point, as in drives
            that receive positions and velocities; else it acts on the velocity itself, and the arm lags.
        armature: reflected rotor inertia, added to each joint [kg m^2 or kg].
        timestep: longest step of the physics [s].

    Raises:
        InvalidValue: a value that is not positive (armature: negative).
    """

    frequency: float = 10.0
    damping: float = 1.0
    torque_limits: bool | float = True
    gravity_compensation: bool = False
    speed_reference: bool = True
    armature: float = 0.0
    timestep: float = 1e-3

    def __post_init__(self) -> None:
        for name in ("frequency", "damping", "timestep"):
            require_positive(name, getattr(self, name))
        require_positive("armature", self.armature, zero=True)
        if not isinstance(self.torque_limits, bool):
            require_positive("torque_limits", self.torque_limits)
        for name in ("gravity_compensation", "speed_reference"):
            if not isinstance(getattr(self, name), bool):
                raise InvalidValue(name, getattr(self, name), "True or False")

    def limits(self, effort: Array) -> Array:
        """Return the largest torque of each servo, (n,) [N m or N]; infinite without a limit.

        Args:
            effort: effort limits of the description, (n,), likewise.
        """
        if self.torque_limits is True:
            return np.array(effort)
        limit = np.inf if self.torque_limits is False else float(self.torque_limits)
        return np.full(len(effort), limit)

    def gains(self, mass_matrices: Sequence[ArrayLike], least: ArrayLike = 0.0) -> Gains:
        """Return the gains for an arm.

        Args:
            mass_matrices: its mass matrix in several configurations, armature included, (n, n) each.
            least: smallest stiffness of each joint, (n,) [N m/rad or N/m].
        """
        matrices = np.array([np.asarray(matrix, dtype=np.float64) for matrix in mass_matrices])
        carried = np.diagonal(matrices, axis1=1, axis2=2).max(axis=0)
        scale = 1.0 / np.sqrt(carried)
        # The squared frequencies of M x'' = -c diag(carried) x are c over the eigenvalues of this.
        relative = matrices * scale[:, None] * scale[None, :]
        slowest = float(np.linalg.eigvalsh(relative)[:, -1].max())
        turning = 2.0 * np.pi * self.frequency
        stiffness = np.maximum(turning**2 * slowest * carried, least)
        return Gains(stiffness, 2.0 * self.damping / turning * stiffness)


def torques_within_limits(
    mobility: Array, unmoved: Array, spring: Array, damping: Array, lower: Array, upper: Array
) -> Array:
    """Return the saturated torques of the servos over a physics step, (n,) [N m or N].

    Torques u give the joint velocities v = v0 + W u at the end of the step. Servos ask for u = s - D v and
    saturate at their limits: u minimises u^T (1/D + W) u / 2 - (s / D - v0)^T u in the box of the limits. The
    problem is strictly convex, so the solution is unique.

    Args:
        mobility: W, velocity at the end of the step per unit of torque, (n, n), symmetric.
        unmoved: v0, velocities at the end of the step without torques, (n,) [rad/s or m/s].
        spring: s, torques that the servos ask for at velocity 0, (n,) [N m or N].
        damping: D, damping of the servos, (n,) [N m s/rad or N s/m], positive.
        lower: smallest torques, (n,); -inf without a limit.
        upper: largest torques, (n,); inf without a limit.
    """
    hessian = mobility + np.diag(1.0 / damping)
    scale = 1.0 / np.sqrt(np.diag(hessian))
    found = solve(
        hessian * np.outer(scale, scale),
        -(spring / damping - unmoved) * scale,
        np.maximum(lower / scale, -UNBOUNDED),
        np.minimum(upper / scale, UNBOUNDED),
    )
    torques = found.x if found.x is not None else np.zeros(len(spring))
    return np.clip(torques * scale, lower, upper)
