"""Compares measurements with commands, and shifts targets such that the measured arm reaches them."""

from __future__ import annotations

from math import exp
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from pinposture._validation import float_array
from pinposture.arm import Arm, ArmState
from pinposture.errors import InvalidValue
from pinposture.placement import Target

Array = NDArray[np.float64]

FEEDBACK_TOLERANCE = 1e-7
"""Change of the feedback that is too small to update a target, in `Arm.joint_units`, and in arm lengths."""

MAX_POINT_OFFSET = 0.25
"""Distance of a measured control point from forward kinematics that discards it, in arm lengths."""


class FeedbackState(NamedTuple):
    """Result of the feedback of one cycle.

    Attributes:
        state: state from which the next step starts: the command with a position interface, else the
            measurement; None before the first measurement.
        reason: why the arm must hold; empty if it need not.
        tracking_error: largest difference between measured and expected joint positions, in
            `Arm.joint_units`; None without a usable measurement.
    """

    state: ArmState | None
    reason: str
    tracking_error: float | None


class Feedback:
    """Compares measurements with commands, and compensates targets for the difference.

    Let c be the command and c + b the resulting configuration. The command t - b then reaches a target
    configuration t. The estimate of b is low-pass filtered with a time constant T. If the drives follow a
    command with a time constant T_s, the loop has the characteristic polynomial T T_s s^2 + T s + 1: it does
    not oscillate if T >= 4 T_s.

    Attributes:
        command: commanded configuration, (nq,); None before the first measurement.
        restarted: whether this cycle starts at rest from a new measured configuration.
        points: last measured control points, (m, 3) [m], world frame; None before the first measurement.

    Args:
        arm: the arm.
        time_constant: T [s]; 0 with a velocity interface: each step starts from the measurement.
        max_tracking_error: see `Tracker`.
        resync_time: see `Tracker`.
    """

    def __init__(self, arm: Arm, time_constant: float, max_tracking_error: float, resync_time: float) -> None:
        self.arm = arm
        self.command: Array | None = None
        self.restarted = False
        self.points: Array | None = None
        self._time_constant, self._max_difference = time_constant, max_tracking_error
        self._patience = resync_time
        self._offset, self._shift = np.zeros(arm.nv), np.zeros((arm.n_modules, 3))
        self._deviating: Array | None = None
        self._agreed_for, self._at_rest = 0.0, True
        self._last_compensated: tuple[Target, Target, Array, Array] | None = None

    def restart(self, q: Array, moving: bool = False) -> None:
        """Start from a configuration, (nq,), at rest or not, and forget all estimates."""
        self.command, self.restarted, self._deviating, self._at_rest = q, not moving, None, not moving
        self._offset, self._shift = np.zeros(self.arm.nv), np.zeros((self.arm.n_modules, 3))

    def apply_step(self, dq: Array) -> None:
        """Add the step of this cycle, (nv,) [rad or m], to the command."""
        self.restarted, self._at_rest = False, not np.any(dq)
        if self.command is not None:
            self.command = self.arm.integrate(self.command, dq)

    def update(self, q: ArrayLike | None, points: ArrayLike | None, dt: float) -> FeedbackState:
        """Process the measurements of a cycle; see `Tracker.step`.

        Raises:
            InvalidValue: arrays of a wrong shape.
        """
        arm, measured_points = self.arm, self._checked_points(points)
        measured, reason = self._checked_configuration(q)
        if measured is None:
            return FeedbackState(self._state(), reason, None)
        command = self.command
        if command is None:
            try:
                command = arm.checked_start(measured, "q_measured")
            except InvalidValue as error:
                return FeedbackState(None, str(error), None)
            self.restart(command)
        difference = arm.difference(command, measured)
        apart = np.abs(difference) / arm.joint_units
        joint = int(apart.argmax())
        largest = float(apart[joint])
        if largest > self._max_difference and not self._is_confirmed(measured, dt):
            unit = "m" if arm.slides[joint] else "rad"
            far, most = abs(difference[joint]), self._max_difference * arm.joint_units[joint]
            text = f"joint {arm.joint_names[joint]!r} is {far:.3g} {unit} from its expected position"
            return FeedbackState(self._state(), f"{text}; at most {most:.3g} is fed back", largest)
        if self.restarted:
            difference, largest = np.zeros(arm.nv), 0.0
        self._deviating = None
        self.points = self._filter(measured, difference, measured_points, dt)
        return FeedbackState(self._state(), "", largest)

    def compensate(self, target: Target) -> Target:
        """Return the target for the command such that the arm reaches a target."""
        tiny, offset, shift = FEEDBACK_TOLERANCE * self.arm.length, self._offset, self._shift
        if self._last_compensated is not None and self._last_compensated[0] is target:
            _, used, before, at = self._last_compensated
            turned = np.abs(offset - before) / self.arm.joint_units
            if turned.max() <= FEEDBACK_TOLERANCE and np.abs(shift - at).max() <= tiny:
                return used
        used = self._compensated(target, offset, shift)
        self._last_compensated = target, used, offset.copy(), shift.copy()
        return used

    def _compensated(self, target: Target, offset: Array, shift: Array) -> Target:
        arm, shifts = self.arm, bool(np.any(shift))
        if not (np.any(offset) or shifts) or self.command is None:
            return target
        q, q_compensated = target.q, None
        if q is not None:
            positions, limits = arm.positions(q), arm.limits
            inside = np.clip(positions - offset, limits.lower, limits.upper)
            inside = np.where((positions < limits.lower) | (positions > limits.upper), positions, inside)
            q_compensated = arm.integrate(q, inside - positions)
            change = arm.at(q_compensated).compiled.points - arm.at(q).compiled.points
        else:
            beyond = arm.integrate(self.command, offset)
            change = arm.at(self.command).compiled.points - arm.at(beyond).compiled.points
        q = None if shifts else q_compensated
        velocity = None if q is None else target.velocity
        return Target(target.points + change - shift, target.weights, q, velocity=velocity)

    def _state(self) -> ArmState | None:
        return None if self.command is None else self.arm.at(self.command)

    def _filter(self, measured: Array, difference: Array, measured_points: Array | None, dt: float) -> Array:
        """Low-pass filter the estimates; return the measured control points, (m, 3) [m]."""
        share = 1.0 if self._time_constant == 0.0 else 1.0 - exp(-dt / self._time_constant)
        if self._time_constant == 0.0:
            self.command = measured
        else:
            self._offset += share * (difference - self._offset)
        points = np.array(self.arm.at(measured).compiled.points)
        off = np.zeros_like(points)
        if measured_points is not None:
            off = measured_points - points
            with np.errstate(over="ignore"):
                apart = np.linalg.norm(off, axis=1)
            off[~(apart <= MAX_POINT_OFFSET * self.arm.length)] = 0.0  # missing, or a false detection
        if measured_points is not None or np.any(self._shift):
            self._shift += share * (off - self._shift)
        return np.asarray(points + off)

    def _is_confirmed(self, measured: Array, dt: float) -> bool:
        """Restart, and return True, once deviating measurements at rest have agreed long enough."""
        if self._deviating is None:
            self._agreed_for = 0.0
        else:
            apart = np.abs(self.arm.difference(self._deviating, measured)) / self.arm.joint_units
            self._agreed_for = self._agreed_for + dt if apart.max() <= self._max_difference else 0.0
        self._deviating = measured
        if self._agreed_for < self._patience or not self._at_rest:
            return False
        self.restart(measured)
        return True

    def _checked_configuration(self, q: ArrayLike | None) -> tuple[Array | None, str]:
        """Return a measured configuration; if it cannot be used, None and the reason."""
        if q is None:
            return None, "no measurement"
        measured, arm = self.arm.of_right_size(q, "q_measured"), self.arm
        if not np.all(np.isfinite(measured)):
            return None, f"q_measured[{int(np.argmin(np.isfinite(measured)))}] is not finite"
        try:
            return arm.checked(measured, "q_measured"), ""
        except InvalidValue as error:
            return None, str(error)

    def _checked_points(self, points: ArrayLike | None) -> Array | None:
        return None if points is None else float_array("points", points, (self.arm.n_modules, 3))
