"""How drives respond to their commands: a model, which lead moves a joint, and which joints do not follow.

The model is fitted to logs, of one joint or several, with intervals by leaving out segments.
"""

from __future__ import annotations

from collections.abc import Sequence
from enum import IntEnum
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import least_squares
from scipy.special import stdtrit

from pinposture import kernels
from pinposture._validation import SMALLEST_NUMBER
from pinposture.arm import Arm
from pinposture.kernels.arrays import JointHistory
from pinposture.kernels.joint_response import JOINT_RESPONSE
from pinposture.schema import Declared, Duration, JointDistance, Time, declared

Array = NDArray[np.float64]


class DriveResponseSettings(NamedTuple):
    """When a drive counts as stopped, started, or too coarse."""

    follow_time: float = 0.2
    """Time for which a command moves on before a joint that stands counts as stopped [s]. Delays of drives
    and readings together are shorter: 0.14 s and 0.05 s in logs of robots. A joint that starts later than
    that costs a short hold."""

    lead_factor: float = 2.0
    lead_margin: float = 0.05
    """The command moves a joint for certain by twice the largest lead at which joints began to move before,
    as friction holds on either side, and this much more, in `Arm.joint_units`."""

    retry_time: float = 2.0
    """Time after which a stopped joint is tried again if no lead tells when it runs [s]."""

    overshoots: int = 3
    """How often a joint may come to rest beyond its target before its drive counts as too coarse."""

    noticed: float = 1.5
    """Motion by which the start of a stopped joint is noticed, relative to the smallest that counts as
    motion."""

    noise: float = 5e-4
    """Noise of measurements that is assumed at first, in `Arm.joint_units`; 3e-4 rad in logs of a robot."""

    errors: float = 4.0
    """Deviation from a model of drives that is usual, in its `DriveModel.error`: slow disturbances are no
    white noise, so that three standard deviations would not do. tests/motion/test_drive_response.py bounds
    it."""


DRIVE_RESPONSE = DriveResponseSettings()


@declared()
class DriveModel(Declared):
    """How the position drives of joints follow a command c: lag * dq/dt = e - friction * sign(e).

    Here e = c + sag - q, with the command of `delay` ago. A joint at rest stays there while |e| is at most
    friction + stiction; one that moves comes to rest where |e| falls to the friction.

    The defaults fit logs of a snake of 16 joints at rest and in motion: one set for all joints explains 87 to
    92 % of the variance of a log that was left out.

    Attributes:
        lag: time constant of the drives [s].
        friction: Coulomb friction, as an angle of the command [rad or m].
        stiction: static friction beyond that [rad or m].
        delay: age of the commands that reach the drives [s].
        error: root mean square of what this model does not explain of the positions [rad or m].
    """

    lag: Duration = 0.32
    friction: JointDistance = 0.11
    stiction: JointDistance = 0.0
    delay: Time = 0.008
    error: JointDistance = 0.065

    @property
    def starting_lead(self) -> float:
        """How far ahead a command must be to start a joint [rad or m]."""
        return self.friction + self.stiction

    @property
    def tracking_error(self) -> float:
        """How far a joint may be from where the model has it while nothing is wrong [rad or m]."""
        return self.starting_lead + DRIVE_RESPONSE.errors * self.error

    def lead(self, velocities: Array, slow: Array) -> Array:
        """Return how far ahead of their positions joints have to be commanded to move, (n,) [rad or m].

        Args:
            velocities: velocities of the joints, (n,) [rad/s or m/s].
            slow: velocities below which the lead against friction fades, (n,) [rad/s or m/s].
        """
        return np.asarray(self.lag * velocities + self.friction * np.clip(velocities / slow, -1.0, 1.0))


class DriveResponse:
    """Watches measured positions beside commanded ones, for all joints.

    A joint at rest is stopped by its drive, or its encoder is frozen, if the command moves on by more than
    any joint has needed to start, and nothing moves for `DRIVE_RESPONSE.follow_time`. The lead that friction
    needs is learned from each start; all joints count together, as the drives of an arm are mostly alike.

    Attributes:
        stopped: which joints do not follow, (nv,).
        held: positions at which they are held, (nv,) [rad or m].
        history: what is known of each joint.
        followed: whether a joint has ever been seen to follow its command, from rest or in motion.

    Args:
        arm: the arm.
        usual_lead: lead that may be needed to start a joint that has not moved yet, in `Arm.joint_units`.
        positions_sent: whether the drives are sent positions, so that a stopped one starts at a lead.
    """

    def __init__(self, arm: Arm, usual_lead: float, positions_sent: bool) -> None:
        self.arm = arm
        self._positions_sent = positions_sent
        self._units = np.array(arm.joint_units)  # writable, as kernels take arrays
        self._unknown = usual_lead
        self._blocked = np.zeros(arm.nv, dtype=np.bool_)
        self._leads = np.full(arm.nv, -1.0)
        self.followed = False
        self.restart(np.zeros(arm.nv))

    def restart(self, positions: Array) -> None:
        """Start from joint positions (nv,) at rest; leads that are known stay."""
        nv = self.arm.nv
        self._leads = self._leads.copy()
        self.history = JointHistory(
            anchors=positions.copy(),
            starts=positions.copy(),
            standing=np.full(nv, 1e9),
            waiting=np.zeros(nv),
            leads=self._leads,
            readings=np.array([positions, positions]),
            variances=(DRIVE_RESPONSE.noise * self.arm.joint_units) ** 2,
            errors=np.zeros(nv),
            commands=positions.copy(),
            overshoots=np.zeros(nv),
            steps=np.zeros(nv),
        )
        self._blocked[:] = False
        self.stopped = np.zeros(nv, dtype=np.bool_)
        self.held = self._found = self._direction = positions
        self._stopped_for = 0.0

    def forget_overshoots(self) -> None:
        """Start again to count overshoots, for a new target."""
        self.history.errors[:] = 0.0
        self.history.overshoots[:] = 0.0

    @property
    def band(self) -> float:
        """Motion of the command that moves a joint for certain, in `Arm.joint_units`."""
        largest = float((self._leads / self.arm.joint_units).max())
        if largest < 0.0:
            return self._unknown
        return DRIVE_RESPONSE.lead_factor * largest + DRIVE_RESPONSE.lead_margin

    @property
    def moved(self) -> bool:
        """Whether a joint has ever been seen to start, so that leads are known."""
        return bool(self._leads.max() >= 0.0)

    def update(self, measured: Array, sent: Array, expected: Array, dt: float) -> None:
        """Process the positions of a cycle; each (nv,) [rad or m].

        Args:
            measured: measured joint positions.
            sent: commanded joint positions.
            expected: joint positions at which the command aims.
            dt: duration of the cycle [s].
        """
        units = self._units
        sent_before = self.history.starts.copy()
        moved_before = self.history.anchors.copy()
        kernels.watch_joints(measured, sent, expected, units, dt, self.band, self.history, self._blocked)
        if not self.followed:
            travel = self.history.starts - sent_before
            motion = self.history.anchors - moved_before
            # A lag makes less than half of the travel; a joint that falls or is pushed differs by more.
            self.followed = self.moved or bool(np.any(np.abs(motion - travel) < 0.5 * np.abs(travel)))
        if self.stopped.any():
            self._watch_stopped(dt)
        elif self._blocked.any():
            stopped = self._blocked & (self.history.waiting > DRIVE_RESPONSE.follow_time)
            if stopped.any():
                self._hold(stopped, measured, sent)

    def retry(self) -> None:
        """Take all joints to follow until they stand again."""
        self.history.waiting[:] = 0.0
        self.stopped = np.zeros(self.arm.nv, dtype=np.bool_)
        self._stopped_for = 0.0

    def hold_standing(self, measured: Array, sent: Array) -> None:
        """Take all joints that stand at a lead to be stopped, as one of them is.

        Args:
            measured: measured joint positions, (nv,) [rad or m].
            sent: commanded joint positions, (nv,) [rad or m].
        """
        lead = sent - measured
        travel = np.where((sent - self.history.starts) * lead > 0.0, sent - self.history.starts, 0.0)
        ahead = np.abs(travel) > self._starting_lead()
        standing = ahead & (self.history.standing > DRIVE_RESPONSE.follow_time)
        if standing.any():
            self._hold(self.stopped | standing, measured, sent)

    def _hold(self, stopped: NDArray[np.bool_], measured: Array, sent: Array) -> None:
        """Take joints to be stopped: their commands wait where the joints start if they can."""
        self.stopped = stopped
        self._stopped_for = 0.0
        self._found = self.history.anchors.copy()
        self._direction = np.sign(sent - measured)
        self.held = measured + self._direction * self._starting_lead()

    def _starting_lead(self) -> Array:
        """Return the lead at which each joint would start noticeably, (nv,) [rad or m]."""
        units = self.arm.joint_units
        noise = np.sqrt(self.history.variances) / units
        response = JOINT_RESPONSE
        moved = np.clip(response.moved_deviations * noise, response.moved, response.most_moved)
        known = max(float((self._leads / units).max()), 0.0)
        return np.asarray((known + DRIVE_RESPONSE.noticed * moved) * units)

    def _watch_stopped(self, dt: float) -> None:
        """Release the joints that follow again."""
        self._stopped_for += dt
        least = 0.5 * JOINT_RESPONSE.moved * self.arm.joint_units
        moved = (self.history.anchors - self._found) * self._direction
        self.stopped = self.stopped & (moved < least)
        if not self.stopped.any() or (
            not (self._positions_sent and self.moved) and self._stopped_for > DRIVE_RESPONSE.retry_time
        ):
            self.retry()

    @property
    def compensable(self) -> NDArray[np.bool_]:
        """Joints whose commands may go farther against their errors, (nv,)."""
        history = self.history
        coarse = (history.overshoots >= DRIVE_RESPONSE.overshoots) & (np.abs(history.errors) <= history.steps)
        return ~(self._blocked | self.stopped | coarse)


class DriveFitSettings(NamedTuple):
    """How the parameters of drives and their intervals are found (`benchmarks.studies.identification`)."""

    segments: int = 10
    """Segments of which each is left out in turn."""

    fewest_segments: int = 5
    """Fewest segments with measurements of a joint, for an interval of its parameters."""

    uncorrelated: float = 0.1
    """Autocorrelation from which on deviations count as independent."""

    confidence: float = 0.95
    """How often intervals are to cover the truth; see `benchmarks.studies.identification`."""

    longest_lag: float = 10.0
    shortest_lag: float = 1e-4
    longest_delay: float = 0.5
    """Bounds of the fit [s]. It allows negative delays: at a bound of zero, intervals would be too
    narrow."""

    first_guesses: tuple[tuple[float, float, float], ...] = (
        (0.05, 0.02, 0.02),
        (0.3, 0.02, 0.1),
        (1.0, 0.02, 0.02),
        (0.1, 0.2, 0.05),
    )
    """Lag [s], delay [s], and friction in relation to the motion of the commands, from which fits begin. In
    200 draws of drives the first two found the best of ten starts in all but three cases."""

    step: float = 1e-4
    """Step of finite differences: of lag and delay [s], of others in relation to their range. Positions are
    continuous in all parameters, and exact, so that 1e-6 gives the same."""


DRIVE_FIT = DriveFitSettings()


class Parameter(IntEnum):
    """Indices of the parameters; the last is compliance times payload."""

    LAG = 0
    DELAY = 1
    FRICTION = 2
    COMPLIANCE = 3
    CARRIED = 4


class Series(NamedTuple):
    """One joint in an uninterrupted part of a log.

    Attributes:
        sent_at: when commands were sent, (k,) [s].
        sent: the commands, (k,) [rad or m].
        times: when positions were measured, (m,) [s].
        positions: the measured positions, (m,) [rad or m].
        segments: the segment of each, (m,).
        torques: torque that holds the arm at each time, and that for each kilogram of payload, (2, m) [N m or
            N]; zeros if unknown.
        effort: measured torque or force at each time, (m,) [N m or N]; NaN if unknown.
    """

    sent_at: Array
    sent: Array
    times: Array
    positions: Array
    segments: NDArray[np.int64]
    torques: Array
    effort: Array

    def errors(self, delay: float) -> Array:
        """Return how far commands that were sent a delay [s] ago are ahead of positions, (m,) [rad or m]."""
        arrived = np.searchsorted(self.sent_at + delay, self.times, side="right") - 1
        return np.asarray(self.sent[np.maximum(arrived, 0)] - self.positions)

    def predict(self, parameters: Array) -> Array:
        """Return where the drive moves the joint from its first position on, (m,) [rad or m]."""
        shift = np.zeros(len(self.times))
        if len(parameters) > Parameter.COMPLIANCE:
            shift = -parameters[Parameter.COMPLIANCE] * self.torques[0]
        if len(parameters) > Parameter.CARRIED:
            shift -= parameters[Parameter.CARRIED] * self.torques[1]
        predicted = np.array(self.positions)
        drive = np.ascontiguousarray(parameters[: Parameter.FRICTION + 1])
        kernels.follow_commands(self.sent_at, self.sent, self.times, shift, drive, predicted)
        return predicted


class Fit(NamedTuple):
    """Parameters that fit best.

    Attributes:
        values: the parameters, (p,).
        left_out: the parameters without each segment, (s, p).
        explained: share of the variance of positions that the model explains in segments that were left out.
        rest: root mean square of what it does not explain there [rad or m].
        widening: how much wider intervals of loads are than those of independent segments.
    """

    values: Array
    left_out: Array
    explained: float
    rest: float
    widening: float

    def parameter(self, index: int) -> tuple[float, float, float]:
        """Return value, lower and upper end of a parameter."""
        widening = self.widening if index >= Parameter.COMPLIANCE else 1.0
        return jackknife(float(self.values[index]), self.left_out[:, index], widening)

    def payload(self) -> tuple[float, float, float]:
        """Return value, lower and upper end of the payload [kg], of a fit with one."""
        value = float(self.values[Parameter.CARRIED] / self.values[Parameter.COMPLIANCE])
        return jackknife(
            value, self.left_out[:, Parameter.CARRIED] / self.left_out[:, Parameter.COMPLIANCE], self.widening
        )


def jackknife(value: float, left_out: Array, widening: float = 1.0) -> tuple[float, float, float]:
    """Return a value and its interval, given the values without each segment, (s,), widened by a factor."""
    count = len(left_out)
    deviation = np.sqrt((count - 1.0) / count * np.sum((left_out - left_out.mean()) ** 2))
    half = widening * float(stdtrit(count - 1, 0.5 + DRIVE_FIT.confidence / 2.0) * deviation)
    return value, value - half, value + half


def fit_drives(series: Sequence[Series], loads: int = 0, free: Sequence[int] = ()) -> Fit:
    """Fit the model of drives to joints that have the same.

    Args:
        series: the joints.
        loads: 0 without loads, 1 with the compliance, 2 also with a payload.
        free: indices of the parameters that are fitted; the others are zero. Empty: all.
    """
    problem = _Problem(series, loads, tuple(free) or tuple(range(Parameter.COMPLIANCE + loads)))
    fits = [problem.solve(problem.begin(start)) for start in DRIVE_FIT.first_guesses]
    best = min(fits, key=lambda fit: fit[1])[0]
    segments = np.unique(np.concatenate([part.segments for part in series]))
    left_out = np.array([problem.solve(best, int(segment))[0] for segment in segments])
    explained, rest = problem.judge(segments, left_out)
    return Fit(best, left_out, explained, rest, _widening(series, best) if loads else 1.0)


def _widening(series: Sequence[Series], parameters: Array) -> float:
    """Return how much wider an interval is as deviations of segments are not independent of each other.

    Slow disturbances go on from a segment to the next. Static errors tell loads, so that their means over
    segments count: with deviations of a correlation time t and segments of a length T, the variance of the
    mean of all is that of independent segments, times 1 / (1 - t / T (1 - exp(-T / t))). Without it, 78 of
    100 intervals of the stiffness cover the truth in logs of 30 s with disturbances correlated over 2 s.
    """
    total = np.zeros(0)
    span = 0.0
    pieces = 0
    step = float(np.median(np.concatenate([np.diff(part.times) for part in series])))
    if step <= 0.0:
        return 1.0
    for part in series:
        times = np.arange(part.times[0], part.times[-1], step)
        off = np.interp(times, part.times, part.predict(parameters) - part.positions)
        spectrum = np.abs(np.fft.rfft(off, 2 * len(off))) ** 2
        correlated = np.fft.irfft(spectrum)[: len(off)]
        longer = max(len(total), len(correlated))
        total = np.pad(total, (0, longer - len(total))) + np.pad(correlated, (0, longer - len(correlated)))
        span += float(part.times[-1] - part.times[0])
        pieces += len(np.unique(part.segments))
    if not len(total) or total[0] <= 0.0:
        return 1.0
    low = np.flatnonzero(total < DRIVE_FIT.uncorrelated * total[0])
    correlation = step * float(total[: low[0] if len(low) else None].sum() / total[0])
    ratio = correlation / (span / pieces)
    return float(1.0 / np.sqrt(1.0 - ratio * (1.0 - np.exp(-1.0 / ratio))))


class _Problem:
    """The least-squares problem of a fit."""

    def __init__(self, series: Sequence[Series], loads: int, free: tuple[int, ...]) -> None:
        self._series = series
        self._free = np.array(free)
        self._size = Parameter.COMPLIANCE + loads
        self._segments = np.concatenate([part.segments for part in series])
        self._measured = np.concatenate([part.positions for part in series])
        span = max(float(np.ptp(part.sent)) for part in series)
        moved = max(float(np.ptp(part.positions)) for part in series)
        self._span = max(span, moved, 1e-9)
        largest = np.array([[np.abs(row).max() for row in part.torques] for part in series]).max(axis=0)
        compliances = self._span / np.where(largest > SMALLEST_NUMBER, largest, 1.0)
        scales = np.array([0.1, 0.02, 0.05 * self._span, *(0.05 * compliances)])[: self._size]
        settings = DRIVE_FIT
        steps = (settings.step * np.array([1.0, 1.0, self._span, *compliances]))[: self._size]
        lower = np.array([settings.shortest_lag, -settings.longest_delay, 0.0, -np.inf, -np.inf])[
            : self._size
        ]
        upper = np.array([settings.longest_lag, settings.longest_delay, self._span, np.inf, np.inf])[
            : self._size
        ]
        self._scales = scales[self._free]
        self._steps = steps[self._free]
        self._bounds = lower[self._free], upper[self._free]

    def begin(self, start: Sequence[float]) -> Array:
        """Return parameters from which a fit begins."""
        begun = np.zeros(self._size)
        begun[: Parameter.FRICTION + 1] = (
            start[Parameter.LAG],
            start[Parameter.DELAY],
            start[Parameter.FRICTION] * self._span,
        )
        begun[np.setdiff1d(np.arange(self._size), self._free)] = 0.0
        return begun

    def solve(self, begin: Array, left_out: int = -1) -> tuple[Array, float]:
        """Return the best parameters near some, without a segment, and their cost."""
        kept = self._segments != left_out

        def parameters(values: Array) -> Array:
            full = np.array(begin)
            full[self._free] = values
            return full

        def residuals(values: Array) -> Array:
            return np.asarray((self._predict(parameters(values)) - self._measured)[kept])

        lower, upper = self._bounds

        def slopes(values: Array) -> Array:
            at = residuals(values)
            columns = []
            for number, step in enumerate(self._steps):
                moved = values.copy()
                moved[number] += step if values[number] + step < upper[number] else -step
                columns.append((residuals(moved) - at) / (moved[number] - values[number]))
            return np.column_stack(columns)

        inside = np.clip(begin[self._free], lower, upper)
        fit = least_squares(
            residuals, inside, slopes, (lower, upper), x_scale=self._scales, xtol=1e-6, ftol=1e-7, max_nfev=60
        )
        return parameters(fit.x), float(fit.cost)

    def judge(self, segments: NDArray[np.int64], left_out: Array) -> tuple[float, float]:
        """Return the share of the variance that is explained where segments are left out, and the rest."""
        off = np.zeros(len(self._measured))
        for segment, parameters in zip(segments, left_out, strict=True):
            at = self._segments == segment
            off[at] = (self._predict(parameters) - self._measured)[at]
        positions = [part.positions for part in self._series]
        return explained_share(positions, off), float(np.sqrt(np.mean(off**2)))

    def _predict(self, parameters: Array) -> Array:
        return np.asarray(np.concatenate([part.predict(parameters) for part in self._series]))


def explained_share(positions: Sequence[Array], off: Array) -> float:
    """Return the share of the variance of positions that is explained, given the deviations of all."""
    variance = sum(float(np.sum((part - part.mean()) ** 2)) for part in positions)
    return 1.0 - float(off @ off) / max(variance, 1e-30)


def fit_gain(series: Sequence[Series], delay: float) -> tuple[tuple[float, float, float] | None, float]:
    """Fit the torque of drives for each unit of their error: value, lower and upper end of its interval.

    A constant torque of each part of the log does not count.

    Args:
        series: the joints.
        delay: delay of the drives [s].

    Returns:
        The gain [N m/rad or N/m], None if efforts do not tell it; and the share of their variance that it
        explains.
    """
    errors: list[Array] = []
    efforts: list[Array] = []
    segments: list[NDArray[np.int64]] = []
    for part in series:
        known = np.isfinite(part.effort)
        if np.any(known):
            error = part.errors(delay)[known]
            errors.append(error - error.mean())
            efforts.append(part.effort[known] - part.effort[known].mean())
            segments.append(part.segments[known])
    if not errors:
        return None, 0.0
    x = np.concatenate(errors)
    y = np.concatenate(efforts)
    where = np.concatenate(segments)
    folds = [where != segment for segment in np.unique(where)]
    if len(folds) < DRIVE_FIT.fewest_segments or not (x @ x > 0.0 and y @ y > 0.0):
        return None, 0.0
    gain = float(x @ y / (x @ x))
    left_out = np.array([x[kept] @ y[kept] / max(x[kept] @ x[kept], 1e-300) for kept in folds])
    off = y - gain * x
    return jackknife(gain, left_out), 1.0 - float(off @ off / (y @ y))
