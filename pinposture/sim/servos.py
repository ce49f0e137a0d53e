"""Joint servos: springs and dampers towards a set-point, as stiff as the inertia that they carry asks for."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from pinposture._validation import require_positive
from pinposture.errors import InvalidValue

Array = NDArray[np.float64]


class Gains(NamedTuple):
    """Gains of the servos, one entry for each joint.

    Attributes:
        stiffness: torque for each unit of deviation, [N m/rad or N/m].
        damping: torque for each unit of speed, [N m s/rad or N s/m].
    """

    stiffness: Array
    damping: Array


@dataclass(frozen=True)
class Servos:
    """Servos of all joints of an arm: torque = stiffness (set-point - position) - damping (speed - its own).

    Stiffnesses have the proportions of the inertias that the joints carry, and are so large that no vibration
    of the whole arm on its servos is slower than `frequency`. Servos that hold each joint alone at that
    frequency would leave a long arm limp: joints in series add up, and the slowest vibration of 40 joints is
    four times as slow, that of 200 joints nine times.

    Attributes:
        frequency: natural frequency of the slowest vibration of the arm on its servos [Hz]. Under gravity the
            tip sags by about 9.81 / (2 pi frequency)^2 [m], whatever the arm: 2.5 mm at 10 Hz.
        damping: damping ratio of that vibration; 1 is critical. Faster ones are damped more.
        torque_limits: whether servos give no more than the effort in the description; or one limit for all
            joints [N m or N]. Our templates have a placeholder of 100.
        gravity_compensation: whether torques that bear the weight of the arm are added, from its own model.
        speed_reference: whether damping acts on the difference to the speed of the set-point, as in drives
            that are sent positions and speeds; else on the speed itself, and the arm lags behind.
        armature: inertia of the rotors as the joints feel it, added to each joint [kg m^2 or kg].
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

    def limits(self, effort: Sequence[float]) -> Array:
        """The largest torque of each joint [N m or N]; infinite without a limit.

        Args:
            effort: what the description says, likewise.
        """
        if self.torque_limits is True:
            return np.array(effort, dtype=np.float64)
        limit = np.inf if self.torque_limits is False else float(self.torque_limits)
        return np.full(len(effort), limit)

    def gains(self, mass_matrices: Sequence[ArrayLike], least: ArrayLike = 0.0) -> Gains:
        """Gains for an arm.

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
