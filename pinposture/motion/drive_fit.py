"""Fits of the drive model to logs: one joint or several, with intervals by leaving out segments."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import least_squares
from scipy.special import stdtrit

from pinposture import kernels
from pinposture._validation import SMALLEST_NUMBER

Array = NDArray[np.float64]


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


LAG = 0
DELAY = 1
FRICTION = 2
COMPLIANCE = 3
CARRIED = 4
"""Places of the parameters: the last is compliance times payload."""


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
        if len(parameters) > COMPLIANCE:
            shift = -parameters[COMPLIANCE] * self.torques[0]
        if len(parameters) > CARRIED:
            shift -= parameters[CARRIED] * self.torques[1]
        predicted = np.array(self.positions)
        drive = np.ascontiguousarray(parameters[: FRICTION + 1])
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

    def parameter(self, place: int) -> tuple[float, float, float]:
        """Return value, lower and upper end of a parameter."""
        widening = self.widening if place >= COMPLIANCE else 1.0
        return jackknife(float(self.values[place]), self.left_out[:, place], widening)

    def payload(self) -> tuple[float, float, float]:
        """Return value, lower and upper end of the payload [kg], of a fit with one."""
        value = float(self.values[CARRIED] / self.values[COMPLIANCE])
        return jackknife(value, self.left_out[:, CARRIED] / self.left_out[:, COMPLIANCE], self.widening)


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
        free: places of the parameters that are fitted; the others are zero. Empty: all.
    """
    problem = _Problem(series, loads, tuple(free) or tuple(range(COMPLIANCE + loads)))
    found = [problem.solve(problem.begin(start)) for start in DRIVE_FIT.first_guesses]
    best = min(found, key=lambda each: each[1])[0]
    segments = np.unique(np.concatenate([each.segments for each in series]))
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
    step = float(np.median(np.concatenate([np.diff(each.times) for each in series])))
    if step <= 0.0:
        return 1.0
    for each in series:
        times = np.arange(each.times[0], each.times[-1], step)
        off = np.interp(times, each.times, each.predict(parameters) - each.positions)
        spectrum = np.abs(np.fft.rfft(off, 2 * len(off))) ** 2
        correlated = np.fft.irfft(spectrum)[: len(off)]
        longer = max(len(total), len(correlated))
        total = np.pad(total, (0, longer - len(total))) + np.pad(correlated, (0, longer - len(correlated)))
        span += float(each.times[-1] - each.times[0])
        pieces += len(np.unique(each.segments))
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
        self._size = COMPLIANCE + loads
        self._segments = np.concatenate([each.segments for each in series])
        self._measured = np.concatenate([each.positions for each in series])
        span = max(float(np.ptp(each.sent)) for each in series)
        moved = max(float(np.ptp(each.positions)) for each in series)
        self._span = max(span, moved, 1e-9)
        largest = np.array([[np.abs(row).max() for row in each.torques] for each in series]).max(axis=0)
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
        begun[: FRICTION + 1] = (start[LAG], start[DELAY], start[FRICTION] * self._span)
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
            for place, step in enumerate(self._steps):
                moved = values.copy()
                moved[place] += step if values[place] + step < upper[place] else -step
                columns.append((residuals(moved) - at) / (moved[place] - values[place]))
            return np.column_stack(columns)

        inside = np.clip(begin[self._free], lower, upper)
        found = least_squares(
            residuals, inside, slopes, (lower, upper), x_scale=self._scales, xtol=1e-6, ftol=1e-7, max_nfev=60
        )
        return parameters(found.x), float(found.cost)

    def judge(self, segments: NDArray[np.int64], left_out: Array) -> tuple[float, float]:
        """Return the share of the variance that is explained where segments are left out, and the rest."""
        off = np.zeros(len(self._measured))
        for segment, parameters in zip(segments, left_out, strict=True):
            at = self._segments == segment
            off[at] = (self._predict(parameters) - self._measured)[at]
        positions = [each.positions for each in self._series]
        return explained_share(positions, off), float(np.sqrt(np.mean(off**2)))

    def _predict(self, parameters: Array) -> Array:
        return np.asarray(np.concatenate([each.predict(parameters) for each in self._series]))


def explained_share(positions: Sequence[Array], off: Array) -> float:
    """Return the share of the variance of positions that is explained, given the deviations of all."""
    variance = sum(float(np.sum((each - each.mean()) ** 2)) for each in positions)
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
    for each in series:
        known = np.isfinite(each.effort)
        if np.any(known):
            error = each.errors(delay)[known]
            errors.append(error - error.mean())
            efforts.append(each.effort[known] - each.effort[known].mean())
            segments.append(each.segments[known])
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
