"""Where an arm is, as far as measurements can be believed, and what that changes about its target."""

from __future__ import annotations

from math import exp
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from pinposture.arm import Arm, ArmState
from pinposture.arm.checks import float_array
from pinposture.errors import InvalidValue
from pinposture.target import Target

Array = NDArray[np.float64]

SETTLED = 1e-7
"""Change of what is fed back that is none, in `Arm.joint_units`, and in arm lengths."""

FARTHEST = 0.25
"""How far a control point may be seen from where the joints have it to be believed, in arm lengths."""


class Seen(NamedTuple):
    """What one cycle knows of the arm.

    Attributes:
        state: where the next step begins: at the command of drives that take positions, else where the arm
            was measured; None if nothing was ever measured.
        reason: why the arm has to hold, in words; empty if it has not.
        disagreement: largest difference between measured and expected joint positions, in
            `Arm.joint_units`; None without a measurement that can be used.
    """

    state: ArmState | None
    reason: str
    disagreement: float | None


class Feedback:
    """Compares what is measured with what was commanded.

    Let c be the command, and c + b the configuration that it leads to: the drives lag and sag by -b. A target
    configuration t is then reached by the command t - b. The estimate of b follows the measurements with a
    time constant T. If the drives follow a command within a time T_s, the loop has the characteristic
    polynomial T T_s s^2 + T s + 1: it does not oscillate from T = 4 T_s on.

    Attributes:
        command: what the drives were told, or where they should be by now, (nq,); None at first.
        anew: whether the arm was taken to be somewhere else in this cycle, at rest.
        points: where the control points are, by the last measurement, (m, 3) [m]; None at first.

    Args:
        arm: the arm.
        period: the time constant T [s]; 0 for drives that take speeds: each step begins at the measurement.
        disagreement: see `Tracker`.
        patience: see there.
    """

    def __init__(self, arm: Arm, period: float, disagreement: float, patience: float) -> None:
        self.arm = arm
        self.command: Array | None = None
        self.anew = False
        self.points: Array | None = None
        self._period, self._allowed, self._patience = period, disagreement, patience
        self._offset, self._shift = np.zeros(arm.nv), np.zeros((arm.n_modules, 3))
        self._suspect: Array | None = None
        self._since, self._still = 0.0, True
        self._used: tuple[Target, Target, Array, Array] | None = None

    def begin(self, q: Array, moving: bool = False) -> None:
        """Take the arm to be at a configuration, (nq,), at rest or not."""
        self.command, self.anew, self._suspect, self._still = q, not moving, None, not moving
        self._offset, self._shift = np.zeros(self.arm.nv), np.zeros((self.arm.n_modules, 3))

    def moved(self, dq: Array) -> None:
        """Write down the step of this cycle, (nv,) [rad or m]."""
        self.anew, self._still = False, not np.any(dq)
        if self.command is not None:
            self.command = self.arm.integrate(self.command, dq)

    def take(self, q: ArrayLike | None, points: ArrayLike | None, dt: float) -> Seen:
        """Take in the measurements of a cycle; see `Tracker.step`.

        Raises:
            InvalidValue: arrays of a wrong shape.
        """
        arm, seen_points = self.arm, self._checked_points(points)
        measured, reason = self._checked(q)
        if measured is None:
            return Seen(self._state(), reason, None)
        if self.command is None:
            try:
                self.begin(arm.checked_start(measured, "q_measured"))
            except InvalidValue as error:
                return Seen(self._state(), str(error), None)
        assert self.command is not None
        behind = arm.difference(self.command, measured)
        apart = np.abs(behind) / arm.joint_units
        joint = int(apart.argmax())
        largest = float(apart[joint])
        if largest > self._allowed and not self._believed(measured, dt):
            unit = "m" if arm.slides[joint] else "rad"
            far, most = abs(behind[joint]), self._allowed * arm.joint_units[joint]
            text = f"joint {arm.joint_names[joint]!r} was measured {far:.3g} {unit} from where it should be"
            return Seen(self._state(), f"{text}; up to {most:.3g} is fed back", largest)
        if self.anew:
            behind, largest = np.zeros(arm.nv), 0.0
        self._suspect = None
        self.points = self._feed_back(measured, behind, seen_points, dt)
        return Seen(self._state(), "", largest)

    def shifted(self, target: Target) -> Target:
        """The target that a command has to aim at so that the arm comes to another."""
        tiny, offset, shift = SETTLED * self.arm.length, self._offset, self._shift
        if self._used is not None and self._used[0] is target:
            _, used, before, at = self._used
            turned = np.abs(offset - before) / self.arm.joint_units
            if turned.max() <= SETTLED and np.abs(shift - at).max() <= tiny:
                return used
        used = self._aimed(target, offset, shift)
        self._used = target, used, offset.copy(), shift.copy()
        return used

    def _aimed(self, target: Target, offset: Array, shift: Array) -> Target:
        arm, shifts = self.arm, bool(np.any(shift))
        if not (np.any(offset) or shifts) or self.command is None:
            return target
        q, q_aimed = target.q, None
        if q is not None:
            positions, limits = arm.positions(q), arm.limits
            inside = np.clip(positions - offset, limits.lower, limits.upper)
            inside = np.where((positions < limits.lower) | (positions > limits.upper), positions, inside)
            q_aimed = arm.integrate(q, inside - positions)
            change = arm.at(q_aimed).points - arm.at(q).points
        else:
            beyond = arm.integrate(self.command, offset)
            change = arm.at(self.command).points - arm.at(beyond).points
        return Target(target.points + change - shift, target.weights, None if shifts else q_aimed)

    def _state(self) -> ArmState | None:
        return None if self.command is None else self.arm.at(self.command)

    def _feed_back(self, measured: Array, behind: Array, seen: Array | None, dt: float) -> Array:
        """Let the estimates follow the measurements; returns where the control points are."""
        share = 1.0 if self._period == 0.0 else 1.0 - exp(-dt / self._period)
        if self._period == 0.0:
            self.command = measured
        else:
            self._offset += share * (behind - self._offset)
        points = np.array(self.arm.at(measured).points)
        off = np.zeros_like(points)
        if seen is not None:
            off = seen - points
            with np.errstate(over="ignore"):
                apart = np.linalg.norm(off, axis=1)
            off[~(apart <= FARTHEST * self.arm.length)] = 0.0  # not seen, or not it
        if seen is not None or np.any(self._shift):
            self._shift += share * (off - self._shift)
        return np.asarray(points + off)

    def _believed(self, measured: Array, dt: float) -> bool:
        """Whether a measurement far off has been repeated for long enough, by an arm that stands still."""
        if self._suspect is None:
            self._since = 0.0
        else:
            apart = np.abs(self.arm.difference(self._suspect, measured)) / self.arm.joint_units
            self._since = self._since + dt if apart.max() <= self._allowed else 0.0
        self._suspect = measured
        if self._since < self._patience or not self._still:
            return False
        self.begin(measured)
        return True

    def _checked(self, q: ArrayLike | None) -> tuple[Array | None, str]:
        """A measured configuration; None, and why, if it cannot be used."""
        if q is None:
            return None, "no measurement"
        measured, arm = float_array("q_measured", q, (self.arm.nq,)), self.arm
        if not np.all(np.isfinite(measured)):
            return None, f"q_measured[{int(np.argmin(np.isfinite(measured)))}] is not finite"
        try:
            return arm.checked(measured, "q_measured"), ""
        except InvalidValue as error:
            return None, str(error)

    def _checked_points(self, points: ArrayLike | None) -> Array | None:
        return None if points is None else float_array("points", points, (self.arm.n_modules, 3))
