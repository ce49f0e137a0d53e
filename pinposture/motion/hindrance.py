"""Whether an arm that obstacles hinder still comes closer to where it should be."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from pinposture.arm import Arm

Array = NDArray[np.float64]

GAIN = 1e-3
"""Decrease of a distance that counts as coming closer, in arm lengths: half the clearance that steps keep
beyond the margin."""

PATIENCE = 2.0
AVERAGES = 4.0
"""Time after which an arm that comes no closer gives up [s], and time constants of the averaged measurements
to add: after four, less than 2 % of a change is still to come."""

OTHER_DISPLACEMENT = 5e-3
"""Change of the displacement of an arm at rest that makes another attempt worthwhile, in `Arm.joint_units`:
more than the noise and the backlash of most drives."""


class Hindrance:
    """Watches whether an arm comes closer to where it should be, as long as obstacles hinder it.

    With drives that lag or sag, an arm between obstacles can move to and fro for ever. Each distance has to
    fall below its least value before, so that the number of gains is finite.

    Attributes:
        lasting: whether the arm has come no closer for too long; until a restart, or until the arm is
            displaced in another way.
        patience: that time [s].

    Args:
        arm: the arm.
        time_constant: time constant with which measurements are averaged [s].
    """

    def __init__(self, arm: Arm, time_constant: float) -> None:
        self._arm = arm
        self._settling_time = AVERAGES * time_constant
        self.patience = PATIENCE + self._settling_time
        self.restart()

    def restart(self) -> None:
        """Begin anew, for another target or other obstacles."""
        self.lasting = False
        self._least: dict[str, float] = {}
        self._time = 0.0
        self._rested = 0.0
        self._displacement: Array | None = None

    def move(self, distances: dict[str, float] | None, dt: float) -> None:
        """Add a cycle in which the command moves.

        Args:
            distances: distances that the arm should reduce, by name [m]; None if nothing hinders it.
            dt: duration of the cycle [s].
        """
        self._rested = 0.0
        if distances is None:
            return
        gain = GAIN * self._arm.length
        closer = {name: at for name, at in distances.items() if at < self._least.get(name, np.inf) - gain}
        self._least.update(closer)
        self._time = 0.0 if closer else self._time + dt
        self.lasting = self.lasting or self._time > self.patience

    def rest(self, displacement: Array | None, dt: float) -> None:
        """Add a cycle in which the command rests; begin anew if the arm is displaced in another way.

        Args:
            displacement: average displacement of the arm from the command, (nv,) [rad or m]; None: zero.
            dt: duration of the cycle [s].
        """
        self._rested += dt
        if self._rested < self._settling_time:
            return
        found = np.zeros(self._arm.nv) if displacement is None else displacement
        if self._displacement is None:
            self._displacement = found
        if np.any(np.abs(found - self._displacement) > OTHER_DISPLACEMENT * self._arm.joint_units):
            self.restart()
