"""Compares measurements with commands, and shifts targets such that the measured arm reaches them."""

from __future__ import annotations

from collections.abc import Mapping, Sized
from math import exp, isfinite, isinf
from typing import NamedTuple, cast

import numpy as np
from numpy.typing import ArrayLike, NDArray

from pinposture._validation import finite_vector, float_array
from pinposture.arm import Arm, ArmState
from pinposture.errors import InvalidValue
from pinposture.kernels.arrays import FULL_TURN
from pinposture.motion.arrival import STALL
from pinposture.motion.drive_response import DRIVE_RESPONSE, DriveModel, DriveResponse
from pinposture.placement import Target

Array = NDArray[np.float64]


class FeedbackSettings(NamedTuple):
    """How measurements of the arm correct its command."""

    tolerance: float = 1e-7
    """Change of the feedback that is too small to update a target, in `Arm.joint_units`, and in arm
    lengths."""

    same_estimate: float = 1e-5
    """Change of the estimate that moves no arm which rests short of its target, in `Arm.joint_units`, unless
    noise makes more. With 0, one at its torque limits jittered by 6e-4 rad for ever; with 1e-4 as well none
    did."""

    max_point_offset: float = 0.25
    """Distance of a measured control point from forward kinematics that discards it, in arm lengths."""

    tracking_error: float = 0.3
    """Tracking error that is allowed of drives of which nothing is known, in `Arm.joint_units`."""

    longest_lag: float = 0.5
    """Longest time constant of drives that lag behind their commands [s]; 0.18 to 0.38 s in logs of
    robots."""

    usual_lead: float = 0.75
    """Lead that may be needed to start a joint that has not moved yet, in tracking errors that are allowed:
    0.225 rad by default. Friction in logs of a snake corresponds to 0.06 to 0.21 rad."""

    slowest_average: float = 4.0 * longest_lag
    """Longest time over which the displacement of the arm from its command is averaged [s]. An arm that
    evades obstacles by its average does not oscillate if the lag is at most a quarter of it (see
    `Feedback`)."""

    rest_averages: float = 3.0
    """Time for which a command rests before the measurements at rest count, in `averaging_time`. On the 24
    motions of `rest_power`, half and 4/3 of it made no difference (4.8 and 5.0 s); with half, one whose
    drives follow 50 ms late moved off again before it was seen to have arrived, after 5.0 s in place of 4.5
    (`tests/motion/test_tracker_at_rest.py`)."""

    rest_power: float = 6.0
    """Measurements at rest weigh as this power, less one, of the time since the command came to rest, so that
    the lag in motion is forgotten. 24 motions to a pose of the tip, with drives that are up to 80 ms late,
    lag by up to 0.12 s and sag by up to 0.03 rad, took 5.3, 5.0, 4.8 and 4.7 s in the mean with 3, 4, 6 and
    12, and 6.6 s with the usual average, with which two did not end within 12 s."""

    average_deviations: float = 3.0
    """Change of an average that noise explains, in its standard deviations."""

    limit_noise: float = 1e-3
    """Excess of a measured position over a limit that is attributed to noise, in `Arm.joint_units`: three
    standard deviations of the encoders of a robot, 3e-4 rad."""

    limit_tolerance: float = 1e-6
    """Distance from a limit that counts as being there, in `Arm.joint_units`, or relative."""

    limp_error: float = 0.1
    """Distance up to which a limp joint hangs where it is expected, in `Arm.joint_units`: end stops give way,
    and it swings a little on the way."""


FEEDBACK = FeedbackSettings()


class Measurement(NamedTuple):
    """A measured configuration.

    Attributes:
        q: the configuration, (nq,).
        positions: its joint positions with full turns, (nv,) [rad or m]; None if turns are unknown.
    """

    q: Array
    positions: Array | None


def read_measurement(arm: Arm, given: ArrayLike | Mapping[str, float]) -> Measurement:
    """Return a measurement from a configuration (nq,), or from positions that count full turns.

    Args:
        arm: the arm.
        given: a configuration; joint positions, (nv,) [rad or m]; or positions of driven joints by name.

    Raises:
        InvalidValue: none of them, a driven joint is missing, or not finite.
    """
    if isinstance(given, Mapping):
        given = arm.drives.joint_positions(given)
    if counts_turns(arm, given):
        positions = finite_vector("q_measured", given, arm.nv)
        return Measurement(arm.configuration(positions), positions)
    return Measurement(arm.checked(given, "q_measured"), None)


def without_noise_at_limits(arm: Arm, measured: Measurement) -> Measurement:
    """Return a measurement with joints at their limits that are beyond them by noise at most."""
    positions = arm.positions(measured.q) if measured.positions is None else measured.positions
    inside = np.minimum(np.maximum(positions, arm.limits.lower), arm.limits.upper)
    change = inside - positions
    change[np.abs(change) > FEEDBACK.limit_noise * arm.joint_units] = 0.0
    if not np.any(change):
        return measured
    counted = None if measured.positions is None else positions + change
    return Measurement(arm.integrate(measured.q, change), counted)


def read_start(arm: Arm, given: ArrayLike | Mapping[str, float]) -> Measurement:
    """Return a measurement from which an arm starts; as `read_measurement`, without noise at limits.

    A `PostureWarning` reports joints outside their limits by more than noise.

    Raises:
        InvalidValue: also if the positions may be in degrees.
    """
    measured = without_noise_at_limits(arm, read_measurement(arm, given))
    if measured.positions is None:
        arm.checked_start(measured.q, "q_measured")
    else:
        arm.check_positions(measured.positions, "q_measured")
    return measured


def counts_turns(arm: Arm, given: ArrayLike) -> bool:
    """Return whether a measurement has one number for each joint, and configurations have more."""
    return arm.nv != arm.nq and isinstance(given, Sized) and np.ndim(given) == 1 and len(given) == arm.nv


class JointFailure(NamedTuple):
    """A joint that does not do what it is commanded.

    Attributes:
        joint: its name in `Arm.joint_names`.
        kind: "stuck": it stands although its command has moved on. "astray": it is farther from its command
            than its drive could be, as one that is limp or weak and falls, or that something pushes. With
            torques that a tracker watches (`Touch`), "limp" and "weak" tell the first two from the last.
        position: where it is measured [rad or m].
        duration: for how long that has been so without interruption [s].
    """

    joint: str
    kind: str
    position: float
    duration: float

    def __str__(self) -> str:
        return f"{self.joint} is {self.kind} at {self.position:.4g} for {self.duration:.3g} s"


class FeedbackState(NamedTuple):
    """Result of the feedback of one cycle.

    Attributes:
        state: state from which the next step starts, that of the command; None before the first measurement.
        reason: why the arm must hold; empty if it need not.
        tracking_error: largest distance of a measured joint position from where drives with their lag, or one
            of up to `FEEDBACK.longest_lag`, would be, in `Arm.joint_units`; None without a usable
            measurement.
        held: where to hold: the command, with joints that do not follow it back at their measurements. None:
            the arm brakes and holds.
        failures: joints that do not do what they are commanded, from base to tip.
    """

    state: ArmState | None
    reason: str
    tracking_error: float | None
    held: Target | None = None
    failures: tuple[JointFailure, ...] = ()


class Feedback:
    """Compares measurements with commands, and compensates targets for the difference.

    Let c be the command and c + b the resulting configuration. The command t - b then reaches a target
    configuration t. The estimate of b is low-pass filtered with a time constant T. If the drives follow a
    command with a time constant T_s, the loop has the characteristic polynomial T T_s s^2 + T s + 1: it does
    not oscillate if T >= 4 T_s.

    The estimate stays as it is while the arm is at its target; for a joint whose command has moved on without
    moving it; and for a joint that has come to rest on either side of its target, because its drive cannot
    resolve the rest. Each time that happens, T is doubled for the joint. |b| is at most `max_tracking_error`.
    It stays as well, within noise, while the arm rests short of a target that it cannot take, which would
    otherwise move with the noise of the estimate for ever.

    The tasks of a controller are displaced as well, which cannot change in each cycle, as paths lead along
    them. With tasks, b is thus what is measured once the command rests, and targets and tasks are compensated
    for it together. Where targets were compensated in motion, and the tip was not, arms swung about both for
    as long again as the motion took.

    Drives with a velocity interface come to rest where the command has led them, unless they are disturbed.
    So no target is compensated, and the command returns to the measured arm with the time constant T. If
    drives follow velocities with T_s, this does not oscillate for T >= 4 T_s either. Steps from the
    measurement would have tasks with priority turn the lag into ever larger swings.

    A measurement is plausible if a drive could be there: between the command, the command filtered with the
    lag of the drives, and c + b, or within `max_tracking_error` of them.

    Attributes:
        state: the state of the arm at the command; None before the first measurement.
        positions: its joint positions, (nv,) [rad or m]: continuous joints count full turns from the measured
            ones on; None before the first measurement.
        measured: last usable measured joint positions, (nv,) [rad or m], turns as in `positions`.
        restarted: whether this cycle starts at rest from a new measured configuration.
        points: last measured control points, (m, 3) [m], world frame; None before the first measurement.
        deviation: their distances from those of the command, (m, 3) [m].
        displacement: displacement of the measured arm from the command, (nv,) [rad or m], averaged over T and
            constant within the noise of its average; None if it is zero within that.
        averaging_time: time constant of that average [s].
        noise: change of that average that noise explains, (nv,) [rad or m].
        response: how the drives respond.
        rest_offset: b for a controller with tasks, (nv,) [rad or m].
        settled: whether the arm is at its target, so that estimates stay as they are.
        falls_short: whether the command is not where it aims, on its way or because it cannot be there.
        lead: what drives are sent beyond the command, so that they follow it, (nv,) [rad or m].
        compensates: whether targets are compensated; else the command returns to the measured arm.
        limp: degrees of freedom that are not to follow, (nv,): near where they are expected, they are not fed
            back.

    Args:
        arm: the arm.
        time_constant: T [s]; infinite: no feedback.
        max_tracking_error: see `Tracker`.
        resync_time: see `Tracker`.
        drives: how the drives follow; None: unknown.
        velocities: whether they take velocities, not positions.
        with_tasks: whether the controller has tasks, which are compensated together with targets, at rest.
    """

    def __init__(
        self,
        arm: Arm,
        time_constant: float,
        max_tracking_error: float | None,
        resync_time: float,
        drives: DriveModel | None = None,
        velocities: bool = False,
        with_tasks: bool = False,
    ) -> None:
        self.arm = arm
        self.compensates = not velocities
        self._with_tasks = with_tasks
        self.state: ArmState | None = None
        self.positions: Array | None = None
        self.measured: Array | None = None
        self.restarted = False
        self.points: Array | None = None
        self.deviation = np.zeros((arm.n_modules, 3))
        self.settled = False
        self.falls_short = False
        self._time_constant = time_constant
        self._most_compensated = FEEDBACK.tracking_error if max_tracking_error is None else max_tracking_error
        if drives is None:
            self._lag = FEEDBACK.longest_lag
            allowed = self._most_compensated
            lead = FEEDBACK.usual_lead * (allowed if isfinite(allowed) else 1.0)
        else:
            unit = arm.characteristic_length if np.all(arm.in_metres) else 1.0
            self._lag = drives.lag + drives.delay
            allowed = max(drives.tracking_error / unit, DRIVE_RESPONSE.lead_margin)
            lead = DRIVE_RESPONSE.lead_factor * drives.starting_lead / unit + DRIVE_RESPONSE.lead_margin
        self._max_difference = allowed if max_tracking_error is None else max_tracking_error
        self.response = DriveResponse(arm, lead, self.compensates)
        self._patience = resync_time
        self._deviating: Array | None = None
        self._failing: dict[tuple[int, str], float] = {}
        self.limp = np.zeros(arm.nv, dtype=bool)
        self._agreed_for = 0.0
        self._at_rest = True
        self._last_compensated: tuple[Target, Target, Array, Array] | None = None
        self._aim: tuple[Target, Array] | None = None
        self.averaging_time = min(time_constant, FEEDBACK.slowest_average)
        self._forget(np.zeros(arm.nv))

    @property
    def command(self) -> Array:
        """The commanded configuration, (nq,), after the first measurement."""
        return cast(ArmState, self.state).q

    @property
    def offset(self) -> Array:
        """The estimate of b, (nv,) [rad or m]."""
        return self._offset

    def _forget(self, positions: Array) -> None:
        """Forget all estimates, with the command at joint positions (nv,)."""
        self._offset = np.zeros(self.arm.nv)
        self.rest_offset = self._offset
        self.lead = np.zeros(self.arm.nv)
        self._shift = np.zeros((self.arm.n_modules, 3))
        self._lagging = positions.copy()
        self._sent = positions.copy()
        self._held: Target | None = None
        self._deviating = None
        self._displacement = np.zeros(self.arm.nv)
        self._rest_displacement = np.zeros(self.arm.nv)
        self.displacement: Array | None = None
        self.noise = np.zeros(self.arm.nv)
        self._steady_at = np.zeros(self.arm.nv)
        self._steady_for = 0.0
        self._rest_time = 0.0

    def restart(self, measured: Measurement, moving: bool = False) -> None:
        """Start from a measurement, at rest or not, and forget all estimates."""
        self._move_to(measured)
        self.restarted = not moving
        self._at_rest = not moving
        if self.positions is not None:
            self._forget(self.positions)
            self.response.restart(self.positions)

    def aim(self) -> None:
        """Prepare for another target."""
        self.response.forget_overshoots()

    def apply_step(self, dq: Array) -> None:
        """Add the step of this cycle, (nv,) [rad or m], to the command."""
        self.restarted = False
        self._at_rest = not np.any(dq)
        if self.state is not None and self.positions is not None:
            self.state = self.state.moved(dq)
            self.positions = self.positions + dq
            self._sent = self._sent + dq

    def update(
        self, q: ArrayLike | Mapping[str, float] | None, points: ArrayLike | None, dt: float
    ) -> FeedbackState:
        """Process the measurements of a cycle; see `Tracker.step`.

        Raises:
            InvalidValue: arrays of a wrong shape.
        """
        arm = self.arm
        measured_points = self._checked_points(points)
        measured, reason = self._checked_configuration(q)
        if measured is None:
            return FeedbackState(self.state, reason, None)
        if self.state is None:
            try:
                self.restart(read_start(arm, cast(ArrayLike, q)))
            except InvalidValue as error:
                return FeedbackState(None, str(error), None)
        difference = self._difference(measured)
        positions = cast(Array, self.positions) + difference
        hangs = self.limp & (np.abs(difference) <= FEEDBACK.limp_error * arm.joint_units)
        difference[hangs] = 0.0
        followed = cast(Array, self.positions) + difference
        self._watch(followed, dt)
        excess = self._excess(followed, dt)
        if excess.max() > self._max_difference and self.compensates and not self.response.stopped.any():
            self.response.hold_standing(positions, cast(Array, self.positions))
            excess = self._without_stopped(excess)
        joint = int(excess.argmax())
        largest = float(excess[joint])
        if largest > self._max_difference and not self._is_confirmed(measured, dt):
            far = self._describe(joint, largest * arm.joint_units[joint])
            most = self._describe(joint, self._max_difference * arm.joint_units[joint])
            reason = f"joint {arm.drives.names[joint]!r} is {far} from its expected position"
            failures = self._failures("astray", excess > self._max_difference, positions, dt)
            reason = f"{reason}; at most {most} is fed back"
            return FeedbackState(self.state, reason, largest, failures=failures)
        if self.restarted:
            difference = np.zeros(arm.nv)
            positions = cast(Array, self.positions)
            largest = 0.0
        self._deviating = None
        self.measured = positions
        self.points = self._filter(measured, difference, measured_points, dt)
        if self.response.stopped.any():
            reason = self._describe_stopped(positions)
            failures = self._failures("stuck", self.response.stopped, positions, dt)
            return FeedbackState(self.state, reason, largest, self._hold(positions), failures)
        self._held = None
        self._failing = {}
        return FeedbackState(self.state, "", largest)

    def _watch(self, positions: Array, dt: float) -> None:
        """Watch the response of the drives to the command, or to the steps with a velocity interface."""
        sent = cast(Array, self.positions) + self.lead if self.compensates else self._sent
        stopped = self.response.stopped
        self.response.update(positions, sent, cast(Array, self.positions) + self._offset, dt)
        if not self.compensates:
            self._sent = np.where(self.response.history.standing <= dt, positions, self._sent)
        if not stopped.any() and self.response.stopped.any():
            self._held = None

    def _excess(self, positions: Array, dt: float) -> Array:
        """Return the distances of joint positions from where drives could be, (nv,), in `Arm.joint_units`."""
        command = cast(Array, self.positions)
        self._lagging += (dt / (dt + self._lag)) * (command - self._lagging)
        expected = command + self._offset
        known = np.array([command, self._lagging, expected])
        excess = np.maximum(known.min(axis=0) - positions, positions - known.max(axis=0))
        excess /= self.arm.joint_units
        return self._without_stopped(np.maximum(excess, 0.0))

    def _without_stopped(self, excess: Array) -> Array:
        """Set the excess of joints that stand to zero if some are stopped: their leads are known.

        That of one a turn away is not: the command goes back to the same posture, a turn from the joint.
        """
        if self.response.stopped.any():
            leads = self.response.history.readings[0] - cast(Array, self.positions)
            turned = self.arm.kinematics.endless & (np.abs(leads) > 0.5 * FULL_TURN)
            excess[(self.response.history.standing > DRIVE_RESPONSE.follow_time) & ~turned] = 0.0
        return excess

    def _hold(self, positions: Array) -> Target | None:
        """Return where to hold with joints that do not follow; None until the arm is at rest."""
        command = self.command
        sent = cast(Array, self.positions)
        if self._held is None and self._at_rest and self.compensates:
            self.response.hold_standing(positions, sent)
            stopped = self.response.stopped
            self._offset = np.where(stopped, 0.0, self._offset)
            self.rest_offset = np.where(stopped, 0.0, self.rest_offset)
            back = np.where(stopped, self.response.held - sent, 0.0)
            self._held = Target.from_configuration(self.arm, self.arm.integrate(command, back))
        return self._held

    def _failures(
        self, kind: str, failing: NDArray[np.bool_], positions: Array, dt: float
    ) -> tuple[JointFailure, ...]:
        """Return what is known of joints that fail in a cycle, given by degree of freedom, (nv,)."""
        before = self._failing
        self._failing = {
            (int(u), kind): before.get((int(u), kind), 0.0) + dt for u in np.flatnonzero(failing)
        }
        names = self.arm.joint_names
        return tuple(
            JointFailure(names[u], kind, float(positions[u]), lasted)
            for (u, _), lasted in self._failing.items()
        )

    def _describe(self, joint: int, displacement: float) -> str:
        """Return the displacement of a degree of freedom in words, as its drive counts it."""
        drive = self.arm.drives[joint]
        return f"{abs(drive.ratio * displacement):.3g} {'rad' if drive.turns else 'm'}"

    def _describe_stopped(self, positions: Array) -> str:
        """Say which joints do not follow their commands."""
        stopped = np.flatnonzero(self.response.stopped)
        joint = int(stopped[0])
        others = f", nor do {len(stopped) - 1} more" if len(stopped) > 1 else ""
        drive = self.arm.drives[joint]
        stands = f"{drive.ratio * positions[joint] + drive.offset:.4g} {'rad' if drive.turns else 'm'}"
        text = f"joint {drive.joint!r} does not follow its command{others}: it stands at {stands}"
        return f"{text}; its drive has stopped, or its encoder is frozen"

    def compensate(self, target: Target) -> Target:
        """Return the target for the command such that the arm reaches a target."""
        tiny = FEEDBACK.tolerance * self.arm.length
        offset = self.rest_offset if self._with_tasks else self._offset
        shift = self._shift
        if self._last_compensated is not None and self._last_compensated[0] is target:
            _, used, before, at = self._last_compensated
            turned = np.abs(offset - before) / self.arm.joint_units
            if turned.max() <= FEEDBACK.tolerance and np.abs(shift - at).max() <= tiny:
                return used
        used = self._compensated(target, offset, shift)
        self._last_compensated = target, used, offset.copy(), shift.copy()
        return used

    def _compensated(self, target: Target, offset: Array, shift: Array) -> Target:
        arm = self.arm
        shifts = bool(np.any(shift))
        if not (np.any(offset) or shifts) or self.state is None:
            return target
        q = target.q
        q_compensated = None
        if q is not None:
            positions = arm.positions(q)
            limits = arm.limits
            inside = np.clip(positions - offset, limits.lower, limits.upper)
            inside = np.where((positions < limits.lower) | (positions > limits.upper), positions, inside)
            q_compensated = arm.integrate(q, inside - positions)
            change = arm.chain_at(q_compensated).points - self._points_at(target, q)
        else:
            beyond = arm.integrate(self.command, offset)
            change = self.state.chain_state.points - arm.chain_at(beyond).points
        q = None if shifts else q_compensated
        velocity = None if q is None else target.velocity
        return Target(target.points + change - shift, target.weights, q, velocity=velocity, led=target.led)

    def _points_at(self, target: Target, q: Array) -> Array:
        """Return the control points at the configuration q of a target, (m, 3) [m]; once for each target."""
        if self._aim is None or self._aim[0] is not target:
            self._aim = target, self.arm.chain_at(q).points
        return self._aim[1]

    def describe_shortfall(self, target: Target, positions: Array) -> str:
        """Say which joint stands farthest from its target, and why.

        Args:
            target: the target of the arm.
            positions: measured joint positions, (nv,) [rad or m].
        """
        arm = self.arm
        command = cast(Array, self.positions)
        off = positions - command - self._offset
        if target.q is not None:
            off = arm.difference(target.q, arm.configuration(positions))
        joint = int(np.abs(off / arm.joint_units).argmax())
        drive = arm.drives[joint]
        history = self.response.history
        most = self._most_compensated * arm.joint_units[joint]
        edge = arm.limits.lower[joint] if off[joint] > 0.0 else arm.limits.upper[joint]
        if abs(command[joint] - edge) <= FEEDBACK.limit_tolerance * arm.joint_units[joint]:
            why = f"its command is at the limit of the joint, {drive.ratio * edge + drive.offset:.4g}"
        elif abs(self._offset[joint]) >= (1.0 - FEEDBACK.limit_tolerance) * most:
            why = f"the compensation is at its limit (max_tracking_error), {self._describe(joint, most)}"
        elif isinf(self._time_constant):
            why = "nothing compensates that (feedback_time_constant is inf)"
        elif not self.response.compensable[joint]:
            why = f"its drive moves in steps of {self._describe(joint, history.steps[joint])}"
        else:
            why = "its drive does not move it yet"
        return f"joint {drive.joint!r} stands {self._describe(joint, off[joint])} from its target: {why}"

    def _difference(self, measured: Measurement) -> Array:
        """Return measured minus commanded joint positions, (nv,); within half a turn if turns are unknown."""
        if self.state is None or self.positions is None:
            return np.zeros(self.arm.nv)
        if measured.positions is not None:
            return np.asarray(measured.positions - self.positions)
        return self.arm.difference(self.command, measured.q)

    def _move_to(self, measured: Measurement) -> None:
        """Set the command to a measurement, and within the limits of joints if only noise is not."""
        measured = without_noise_at_limits(self.arm, measured)
        if measured.positions is not None:
            self.positions = measured.positions
        elif self.positions is None:
            self.positions = self.arm.positions(measured.q)
        else:
            self.positions = self.positions + self._difference(measured)
        self.state = self.arm.at(measured.q)

    def _filter(
        self, measured: Measurement, difference: Array, measured_points: Array | None, dt: float
    ) -> Array:
        """Low-pass filter the estimates; return the measured control points, (m, 3) [m]."""
        share = 1.0 - exp(-dt / self._time_constant)
        expected = cast(ArmState, self.state).chain_state.points
        if not self.compensates:
            change = share * difference
            positions = None if measured.positions is None else cast(Array, self.positions) + change
            self._move_to(Measurement(self.arm.integrate(self.command, change), positions))
            difference = difference - change
        self._average(difference, dt)
        if self.compensates and not self.settled:
            self._estimate(difference, share)
        if self._with_tasks:
            self._update_rest_offset(difference, dt)
        points = np.array(self.arm.chain_at(measured.q).points)
        off = np.zeros_like(points)
        if measured_points is not None:
            off = measured_points - points
            with np.errstate(over="ignore"):
                apart = np.linalg.norm(off, axis=1)
            # Missing, or a false detection.
            off[~(apart <= FEEDBACK.max_point_offset * self.arm.length)] = 0.0
        if not self.settled and (measured_points is not None or np.any(self._shift)):
            self._shift += share * (off - self._shift)
        self.deviation = points + off - expected
        return np.asarray(points + off)

    def _estimate(self, difference: Array, share: float) -> None:
        """Filter the estimate of b, for joints whose commands may go farther."""
        response = self.response
        most = self._most_compensated * self.arm.joint_units
        shares = np.where(response.compensable, share * 0.5**response.history.overshoots, 0.0)
        if not (response.followed or self._at_rest):
            shares = 0.0 * shares  # nothing is known of the drives yet
        if self.falls_short and self.steady:
            off = np.clip(self._displacement, -most, most) - self._offset
            same = np.maximum(STALL.two_averages * self.noise, FEEDBACK.same_estimate * self.arm.joint_units)
            if np.all((np.abs(off) <= same) | (shares == 0.0)):
                return
        self._offset = np.clip(self._offset + shares * (difference - self._offset), -most, most)

    def _average(self, difference: Array, dt: float) -> None:
        """Average the displacement of the measured arm from the command."""
        share = 1.0 - exp(-dt / self.averaging_time)
        self._displacement += share * (difference - self._displacement)
        # The variance of noise after a low-pass filter is share / (2 - share) of that before.
        variances = share / (2.0 - share) * self.response.history.variances
        self.noise = FEEDBACK.average_deviations * np.sqrt(variances)
        before = 0.0 if self.displacement is None else self.displacement
        if np.any(np.abs(self._displacement - before) > self.noise):
            known = np.any(np.abs(self._displacement) > self.noise)
            self.displacement = self._displacement.copy() if known else None
        self._steady_for += dt
        off = (np.zeros(self.arm.nv) if self.displacement is None else self.displacement) - self._steady_at
        most = np.maximum(STALL.two_averages * self.noise, STALL.steady * self.arm.joint_units)
        if np.any(np.abs(off) > most):
            self._steady_at = self._steady_at + off
            self._steady_for = 0.0

    def _update_rest_offset(self, difference: Array, dt: float) -> None:
        """Compensate targets and tasks for the displacement of an arm whose command has rested long enough.

        Where it arrived, or falls short, it must be steady as well, or noise would move the arm for ever.
        """
        self._rest_time = self._rest_time + dt if self._at_rest else 0.0
        if not self._at_rest or isinf(self._time_constant):
            return
        # A weight in proportion to a power of the time since then forgets the lag in motion.
        share = max(1.0 - exp(-dt / self.averaging_time), FEEDBACK.rest_power * dt / self._rest_time)
        self._rest_displacement += min(share, 1.0) * (difference - self._rest_displacement)
        if self._rest_time < FEEDBACK.rest_averages * self.averaging_time:
            return
        least = FEEDBACK.tolerance * self.arm.joint_units
        if self.settled or self.falls_short:
            if not self.steady:
                return
            least = STALL.two_averages * self.noise
        most = self._most_compensated * self.arm.joint_units
        known = np.clip(self._rest_displacement, -most, most)
        offset = np.where(self.response.compensable, known, self.rest_offset)
        if np.any(np.abs(offset - self.rest_offset) > least):
            self.rest_offset = offset

    @property
    def steady(self) -> bool:
        """Whether the displacement has long changed within noise alone: in motion it changes with the lag."""
        return self._steady_for >= STALL.averages * self.averaging_time

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

    def _checked_configuration(
        self, q: ArrayLike | Mapping[str, float] | None
    ) -> tuple[Measurement | None, str]:
        """Return a measurement; if it cannot be used, None and the reason."""
        if q is None:
            return None, "no measurement"
        arm = self.arm
        if isinstance(q, Mapping):
            try:
                q = arm.drives.joint_positions(q)
            except InvalidValue as error:
                return None, str(error)
        if counts_turns(arm, q):
            checked = float_array("q_measured", q, (arm.nv,))
        else:
            checked = arm.of_right_size(q, "q_measured")
        if not np.all(np.isfinite(checked)):
            return None, f"q_measured[{int(np.argmin(np.isfinite(checked)))}] is not finite"
        try:
            return read_measurement(arm, checked), ""
        except InvalidValue as error:
            return None, str(error)

    def _checked_points(self, points: ArrayLike | None) -> Array | None:
        return None if points is None else float_array("points", points, (self.arm.n_modules, 3))
