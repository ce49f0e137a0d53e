"""Compares measurements with commands, and shifts targets such that the measured arm reaches them."""

from __future__ import annotations

from collections.abc import Sized
from math import exp
from typing import NamedTuple, cast

import numpy as np
from numpy.typing import ArrayLike, NDArray

from pinposture._validation import finite_vector, float_array
from pinposture.arm import Arm, ArmState
from pinposture.errors import InvalidValue
from pinposture.placement import Target

Array = NDArray[np.float64]

FEEDBACK_TOLERANCE = 1e-7
"""Change of the feedback that is too small to update a target, in `Arm.joint_units`, and in arm lengths."""

MAX_POINT_OFFSET = 0.25
"""Distance of a measured control point from forward kinematics that discards it, in arm lengths."""


class Measurement(NamedTuple):
    """A measured configuration.

    Attributes:
        q: the configuration, (nq,).
        positions: its joint positions with full turns, (nv,) [rad or m]; None if turns are unknown.
    """

    q: Array
    positions: Array | None


def read_measurement(arm: Arm, given: ArrayLike) -> Measurement:
    """Return a measurement from a configuration (nq,), or from joint positions (nv,) that count full turns.

    Raises:
        InvalidValue: neither of them, or not finite.
    """
    if counts_turns(arm, given):
        positions = finite_vector("q_measured", given, arm.nv)
        return Measurement(arm.configuration(positions), positions)
    return Measurement(arm.checked(given, "q_measured"), None)


def read_start(arm: Arm, given: ArrayLike) -> Measurement:
    """Return a measurement from which an arm starts; as `read_measurement`.

    A `PostureWarning` reports joints outside their limits.

    Raises:
        InvalidValue: also if the positions may be in degrees.
    """
    measured = read_measurement(arm, given)
    if measured.positions is None:
        arm.checked_start(measured.q, "q_measured")
    else:
        arm.check_positions(measured.positions, "q_measured")
    return measured


def counts_turns(arm: Arm, given: ArrayLike) -> bool:
    """Return whether a measurement has one number for each joint, and configurations have more."""
    return arm.nv != arm.nq and isinstance(given, Sized) and np.ndim(given) == 1 and len(given) == arm.nv


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
        positions: its joint positions, (nv,) [rad or m]: continuous joints count full turns from the measured
            ones on; None before the first measurement.
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
        self.positions: Array | None = None
        self.restarted = False
        self.points: Array | None = None
        self._time_constant, self._max_difference = time_constant, max_tracking_error
        self._patience = resync_time
        self._offset, self._shift = np.zeros(arm.nv), np.zeros((arm.n_modules, 3))
        self._deviating: Array | None = None
        self._agreed_for, self._at_rest = 0.0, True
        self._last_compensated: tuple[Target, Target, Array, Array] | None = None

    def restart(self, measured: Measurement, moving: bool = False) -> None:
        """Start from a measurement, at rest or not, and forget all estimates."""
        self._move_to(measured)
        self.restarted = self._at_rest = not moving
        self._deviating = None
        self._offset, self._shift = np.zeros(self.arm.nv), np.zeros((self.arm.n_modules, 3))

    def apply_step(self, dq: Array) -> None:
        """Add the step of this cycle, (nv,) [rad or m], to the command."""
        self.restarted, self._at_rest = False, not np.any(dq)
        if self.command is not None and self.positions is not None:
            self.command = self.arm.integrate(self.command, dq)
            self.positions = self.positions + dq

    def update(self, q: ArrayLike | None, points: ArrayLike | None, dt: float) -> FeedbackState:
        """Process the measurements of a cycle; see `Tracker.step`.

        Raises:
            InvalidValue: arrays of a wrong shape.
        """
        arm, measured_points = self.arm, self._checked_points(points)
        measured, reason = self._checked_configuration(q)
        if measured is None:
            return FeedbackState(self._state(), reason, None)
        if self.command is None:
            try:
                self.restart(read_start(arm, cast(ArrayLike, q)))
            except InvalidValue as error:
                return FeedbackState(None, str(error), None)
        difference = self._difference(measured)
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

    def _difference(self, measured: Measurement) -> Array:
        """Return measured minus commanded joint positions, (nv,); within half a turn if turns are unknown."""
        if self.command is None or self.positions is None:
            return np.zeros(self.arm.nv)
        if measured.positions is not None:
            return measured.positions - self.positions
        return self.arm.difference(self.command, measured.q)

    def _move_to(self, measured: Measurement) -> None:
        """Set the command to a measurement."""
        if measured.positions is not None:
            self.positions = measured.positions
        elif self.positions is None:
            self.positions = self.arm.positions(measured.q)
        else:
            self.positions = self.positions + self._difference(measured)
        self.command = measured.q

    def _filter(
        self, measured: Measurement, difference: Array, measured_points: Array | None, dt: float
    ) -> Array:
        """Low-pass filter the estimates; return the measured control points, (m, 3) [m]."""
        share = 1.0 if self._time_constant == 0.0 else 1.0 - exp(-dt / self._time_constant)
        if self._time_constant == 0.0:
            self._move_to(measured)
        else:
            self._offset += share * (difference - self._offset)
        points = np.array(self.arm.at(measured.q).compiled.points)
        off = np.zeros_like(points)
        if measured_points is not None:
            off = measured_points - points
            with np.errstate(over="ignore"):
                apart = np.linalg.norm(off, axis=1)
            off[~(apart <= MAX_POINT_OFFSET * self.arm.length)] = 0.0  # missing, or a false detection
        if measured_points is not None or np.any(self._shift):
            self._shift += share * (off - self._shift)
        return np.asarray(points + off)

    def _is_confirmed(self, measured: Measurement, dt: float) -> bool:
        """Restart, and return True, once deviating measurements at rest have agreed long enough."""
        difference = self._difference(measured)  # the command is at rest
        if self._deviating is None:
            self._agreed_for = 0.0
        else:
            apart = np.abs(difference - self._deviating) / self.arm.joint_units
            self._agreed_for = self._agreed_for + dt if apart.max() <= self._max_difference else 0.0
        self._deviating = difference
        if self._agreed_for < self._patience or not self._at_rest:
            return False
        self.restart(measured)
        return True

    def _checked_configuration(self, q: ArrayLike | None) -> tuple[Measurement | None, str]:
        """Return a measurement; if it cannot be used, None and the reason."""
        if q is None:
            return None, "no measurement"
        arm = self.arm
        if counts_turns(arm, q):
            given = float_array("q_measured", q, (arm.nv,))
        else:
            given = arm.of_right_size(q, "q_measured")
        if not np.all(np.isfinite(given)):
            return None, f"q_measured[{int(np.argmin(np.isfinite(given)))}] is not finite"
        try:
            return read_measurement(arm, given), ""
        except InvalidValue as error:
            return None, str(error)

    def _checked_points(self, points: ArrayLike | None) -> Array | None:
        return None if points is None else float_array("points", points, (self.arm.n_modules, 3))
