"""Identification of drives, stiffness and payload from logs of a robot."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Literal, NamedTuple

import numpy as np
from numpy.typing import NDArray

from pinposture._validation import LARGEST_NUMBER, require_instance
from pinposture.arm import Arm
from pinposture.errors import InvalidValue, PostureError, enumerated
from pinposture.motion.drive_response import (
    DRIVE_FIT,
    DriveModel,
    Fit,
    Parameter,
    Series,
    explained_share,
    fit_drives,
    fit_gain,
)
from pinposture.motion.joint_trajectory import METRE, RADIAN
from pinposture.motion.log import Log
from pinposture.motion.touch import TOUCH, Touch, TouchDetector, largest_of_kind

Array = NDArray[np.float64]


class IdentificationSettings(NamedTuple):
    """Which rows of a log are used, and what they are enough for; see `benchmarks.studies.identification`."""

    fewest_rows: int = 50
    """Fewest measurements of a joint from which its drive is identified: five in each segment."""

    most_measurements: int = 6000
    """Most measurements of a joint that are compared with the model; of more, evenly spaced ones."""

    still: float = 0.5
    """Rows repeated for longer than this are of joints at rest, or frozen encoders, not slow ones [s]."""

    most_postures: int = 1000
    """Most postures in which the torques that hold the arm are computed; they are interpolated between
    these."""

    longest_gap: float = 1.0
    """Time without measurements after which the model starts anew from the next one [s]."""

    moved: float = 8.0
    """Range of positions that noise explains, in its standard deviations."""

    burst: float = 0.25
    """Interval between rows that came together, in periods."""

    wide: float = 0.5
    """Half of an interval above which a number is not identified, relative to the number."""

    wide_delay: float = 0.25
    """The same of a delay, relative to lag and delay together."""

    wide_friction: float = 0.05
    """The same of a friction, relative to the range of motion: a friction of zero can be identified,
    too."""

    least_explained: float = 0.5
    """Share of the variance that the model explains at least, where its parameters mean something."""

    light: float = 0.1
    """Half of the interval of a payload that counts as identified even if it is zero, in masses of the
    arm."""

    touch_margin: float = 2.0
    """Threshold of touch, in the largest torque that the model does not explain in logs without contact;
    tested on motions twice as fast, that are not in the log (tests/motion/test_touch.py)."""


IDENTIFICATION = IdentificationSettings()


class Estimate(NamedTuple):
    """A number and its interval, by leaving out segments of the log.

    Attributes:
        value: the number.
        lower: lower end of the interval that covers the truth in 95 of 100 cases.
        upper: its upper end.
    """

    value: float
    lower: float
    upper: float

    @property
    def half(self) -> float:
        """Half of the width of the interval."""
        return 0.5 * (self.upper - self.lower)

    def __str__(self) -> str:
        return f"{self.value:.3g} ({self.lower:.3g} to {self.upper:.3g})"


class Timing(NamedTuple):
    """When the rows of a table came.

    Attributes:
        rows: their number.
        period: median time between fresh rows [s].
        jitter: standard deviation of that time, interruptions not counted [s].
        stale: share of rows that repeat the one before; commands that are repeated hold.
        bursts: share of rows that came within a quarter of a period after the one before.
        missing: share of rows with missing numbers.
    """

    rows: int
    period: float
    jitter: float
    stale: float
    bursts: float
    missing: float


class DriveEstimate(NamedTuple):
    """What is identified of a drive; None where the log does not tell.

    Attributes:
        lag: time constant [s].
        delay: age of the commands that reach it [s].
        friction: Coulomb friction, as a distance of the command [rad or m].
        stiffness: of joint and drive, by the sag under the weight of the arm [N m/rad or N/m].
        gain: torque for each unit of error, by measured efforts [N m/rad or N/m].
        friction_torque: the friction as a torque, by the gain, or else the stiffness [N m or N].
        explained: share of the variance of positions in segments that were left out.
        rest: root mean square of what is not explained there [rad or m].
    """

    lag: Estimate | None = None
    delay: Estimate | None = None
    friction: Estimate | None = None
    stiffness: Estimate | None = None
    gain: Estimate | None = None
    friction_torque: Estimate | None = None
    explained: float | None = None
    rest: float | None = None

    @property
    def model(self) -> DriveModel | None:
        """The model for `Drives`; None without a lag. What else is not identified is zero."""
        if self.lag is None:
            return None
        friction = 0.0 if self.friction is None else self.friction.value
        delay = 0.0 if self.delay is None else self.delay.value
        error = 0.0 if self.rest is None else self.rest
        return DriveModel(lag=self.lag.value, friction=friction, delay=delay, error=error)

    def as_data(self) -> dict[str, Any]:
        """Return it as data for JSON."""
        estimates = self._asdict()
        return {
            name: value._asdict() if isinstance(value, Estimate) else value
            for name, value in estimates.items()
        }


class Prediction(NamedTuple):
    """A joint of a log, and where a model of its drive moves it.

    Attributes:
        time: times at which it was measured, (k,) [s], from the first command on.
        sent: the last commands before, (k,) [rad or m].
        measured: the fresh measurements, (k,) [rad or m].
        predicted: the positions of the model, (k,) [rad or m].
    """

    time: Array
    sent: Array
    measured: Array
    predicted: Array


def _predicted(series: Sequence[Series], parameters: Sequence[float]) -> Prediction:
    """Return what a model with some parameters predicts for a joint."""
    values = np.array(parameters)
    return Prediction(
        np.concatenate([part.times for part in series]),
        np.concatenate([part.positions + part.errors(0.0) for part in series]),
        np.concatenate([part.positions for part in series]),
        np.concatenate([part.predict(values) for part in series]),
    )


@dataclass(frozen=True, eq=False)
class Identification:
    """What logs tell of a robot.

    Attributes:
        arm: the arm.
        logs: the logs.
        measured: when measurements came.
        sent: when commands came.
        noise: standard deviation of the noise of measured positions, by joint [rad or m].
        drives: one set for all joints that turn; or that slide, if none turns.
        joints: each joint on its own.
        payload: what the arm carries at its tip beside what it is known to carry [kg].
        not_identified: why something is not identified, by its name: "delay", "m01_j1_y: lag".
    """

    arm: Arm
    logs: tuple[Log, ...]
    measured: Timing
    sent: Timing
    noise: Mapping[str, float]
    drives: DriveEstimate
    joints: Mapping[str, DriveEstimate]
    payload: Estimate | None
    not_identified: Mapping[str, str]

    @property
    def model(self) -> DriveModel:
        """The model of all drives, for `Drives` and `Tracker`.

        Raises:
            InvalidValue: it is not identified; says why.
        """
        model = self.drives.model
        if model is None:
            why = self.not_identified.get("lag", "the logs do not tell")
            raise InvalidValue("model", None, f"a lag that is identified; it is not: {why}")
        return model

    def touch(
        self, reaction: Literal["stop", "yield"] = "stop", time_constant: float = TOUCH.time_constant
    ) -> Touch:
        """Return how a `Tracker` notices that something touches this robot.

        The thresholds are twice the largest torque, and force, that masses and motion do not explain in the
        logs: friction, noise and wrong masses count.

        Args:
            reaction: as for `Touch`.
            time_constant: as for `Touch` [s].

        Raises:
            InvalidValue: logs without efforts, or in which weight is not known; says why.
            UnknownName: another reaction.
        """
        allowed = "logs with efforts, of a robot that touched nothing"
        if any(log.effort is None for log in self.logs):
            raise InvalidValue("log.effort", None, allowed)
        why = _unknown_loads(self.arm, self.logs)
        if why:
            raise InvalidValue("logs", len(self.logs), f"{allowed}; here {why}")
        felt = np.max([self._felt(log, time_constant) for log in self.logs], axis=0)
        if not np.any(felt):
            raise InvalidValue("log.effort", "the same in all rows", f"{allowed}, and that moves")
        most = IDENTIFICATION.touch_margin * largest_of_kind(self.arm, felt)
        threshold = {
            drive.joint: float(torque / abs(drive.ratio))
            for drive, torque in zip(self.arm.drives, most, strict=True)
            if np.isfinite(torque)
        }
        return Touch(threshold, reaction, time_constant)

    def _felt(self, log: Log, time_constant: float) -> Array:
        """Return the largest torques that masses and motion do not explain in a log, (nv,) [N m or N]."""
        gravity = np.unique(np.atleast_2d(np.asarray(log.gravity)), axis=0)
        if len(gravity) > 1:
            raise InvalidValue("log.gravity", f"{len(gravity)} directions", "one: the base must not turn")
        arm = self.arm.with_gravity(gravity[0])
        payload = self.payload.value if log.payload is None and self.payload is not None else log.payload
        if payload:
            arm = arm.with_payload(payload)
        columns = _columns_of(arm, log, {})
        positions = _positions_in(arm, log, columns)
        effort = np.asarray(log.effort)
        chosen = [columns[name] for name in arm.joint_names]
        torques = np.column_stack([column.ratio * effort[:, column.number] for column in chosen])
        usable = np.all(np.isfinite(positions) & np.isfinite(torques), axis=1)
        detector = TouchDetector(arm, Touch(LARGEST_NUMBER, time_constant=time_constant))
        felt = np.zeros(arm.nv)
        before = -np.inf
        for row in np.flatnonzero(_fresh_rows(log) & usable):
            passed = float(log.time[row]) - before
            if passed > IDENTIFICATION.longest_gap:
                detector.restart()
            if passed > 0.0:
                detector.update(positions[row], torques[row], passed)
            before = float(log.time[row])
            felt = np.maximum(felt, np.abs(detector.torques))
        return felt

    def predict(self, log: Log) -> Mapping[str, Prediction]:
        """Return where the one set of drives moves the joints of a log from their first measurements on.

        Loads count as far as the log tells gravity and the stiffness is identified. Joints that the set is
        not for, and those that did not move, are left out.

        Args:
            log: the log, of the same arm; also another than those that the set is from.

        Raises:
            InvalidValue: the model is not identified, or a log of another arm.
        """
        require_instance("log", log, Log, "a Log")
        model = self.model
        parameters = [model.lag, model.delay, model.friction]
        loaded = self.drives.stiffness is not None and not _unknown_loads(self.arm, (log,))
        if loaded and self.drives.stiffness is not None:
            payload = self.payload.value if log.payload is None and self.payload is not None else 0.0
            parameters += [1.0 / self.drives.stiffness.value, payload / self.drives.stiffness.value]
        table = _read_tables(self.arm, (log,), loaded)
        return {name: _predicted(table.series[name], parameters) for name in _shared_joints(self.arm, table)}

    def explained(self, log: Log) -> float:
        """Return the share of the variance of positions in a log that `predict` explains.

        Args:
            log: a log with joints that moved, best another than those that the set is from.

        Raises:
            InvalidValue: the model is not identified, a log of another arm, or one in which no joint moved.
        """
        predictions = self.predict(log).values()
        if not predictions:
            raise InvalidValue("log", log, "a log in which a joint of the arm moved")
        off = np.concatenate([prediction.measured - prediction.predicted for prediction in predictions])
        return explained_share([prediction.measured for prediction in predictions], off)

    def summary(self) -> dict[str, Any]:
        """Return it as JSON-compatible data."""
        return {
            "kind": "identification",
            "robot": self.arm.name,
            "logs": len(self.logs),
            "measurements": self.measured._asdict(),
            "commands": self.sent._asdict(),
            "noise": dict(self.noise),
            "drives": self.drives.as_data(),
            "joints": {name: joint.as_data() for name, joint in self.joints.items()},
            "payload": None if self.payload is None else self.payload._asdict(),
            "unit": self.unit,
            "units": dict(self._units),
            "not_identified": dict(self.not_identified),
        }

    def __repr__(self) -> str:
        drives = self.drives
        estimates = {**drives._asdict(), "payload": self.payload}
        known = {name: estimates[name.replace(" ", "_")] for name in self._units}
        parts = [f"{name} {value} {self._units[name]}" for name, value in known.items() if value is not None]
        if drives.explained is not None:
            parts.append(f"{drives.explained:.0%} of the variance explained")
        if self.not_identified:
            parts.append(f"not identified: {enumerated(self.not_identified)}")
        return f"Identification({'; '.join(parts)})"

    @property
    def unit(self) -> str:
        """Unit of the positions that the one set is for: "rad" or "m"."""
        return METRE if np.all(self.arm.in_metres) else RADIAN

    @property
    def _units(self) -> Mapping[str, str]:
        """The numbers of the one set, and the payload, with their units."""
        torque = "N m" if self.unit == RADIAN else "N"
        stiffness = f"{torque}/{self.unit}"
        return {
            "lag": "s",
            "delay": "s",
            "friction": self.unit,
            "stiffness": stiffness,
            "gain": stiffness,
            "friction torque": torque,
            "payload": "kg",
        }


class _Tables(NamedTuple):
    """Logs as series of joints.

    Attributes:
        series: of each joint, in the order of the arm; none where it was not measured.
        noise: of each joint [rad or m].
        measured: timing of measurements.
        sent: timing of commands.
        reasons: joints that are not identified, and why.
    """

    series: dict[str, list[Series]]
    noise: dict[str, float]
    measured: Timing
    sent: Timing
    reasons: dict[str, str]


def identify(arm: Arm, log: Log | Sequence[Log]) -> Identification:
    """Identify drives, stiffness and payload from logs of a robot.

    Fitted is the model of `DriveModel`: lag * dq/dt = e - friction * sign(e), where e is the command of
    `delay` ago minus the position. Where gravity is known and the arm has masses, e also includes the sag by
    its weight, from which follow stiffness and payload. Intervals, and the share of the variance that is
    explained, come from leaving out each of ten segments in turn: slow disturbances count, too.

    What the logs cannot tell is None, and `not_identified` says why.

    Args:
        arm: the arm.
        log: a log, or several of the same robot.

    Raises:
        InvalidValue: no log, or one of other joints.
    """
    require_instance("arm", arm, Arm, "an Arm")
    logs = (log,) if isinstance(log, Log) else log
    if isinstance(logs, str) or not isinstance(logs, Sequence) or not logs:
        raise InvalidValue("log", log, "a Log, or a list of them")
    for part in logs:
        require_instance("log", part, Log, "a Log, or a list of them")
    why = _unknown_loads(arm, logs)
    tables = _read_tables(arm, tuple(logs), loads=not why)
    known = logs[0].payload
    shared = _shared_joints(arm, tables)
    drives, payload, told = _fit_all(arm, tables, shared, why, known)
    drives, of_efforts = _with_efforts(drives, [part for name in shared for part in tables.series[name]])
    names = [name for name in arm.joint_names if name not in tables.reasons]
    loads = 0 if why else 1 if known is not None else 2
    fits = _fit_each(tables, names, drives, loads)
    reasons = {**told, **of_efforts, **tables.reasons}
    for name, (_, missing) in fits.items():
        reasons |= {f"{name}: {what}": text for what, text in missing.items()}
    joints = {name: estimate for name, (estimate, _) in fits.items()}
    return Identification(
        arm, tuple(logs), tables.measured, tables.sent, tables.noise, drives, joints, payload, reasons
    )


# Logs as series of joints.


class _Column(NamedTuple):
    """A column of a log: its number, and the joint of the arm at (value - offset) / ratio."""

    number: int
    ratio: float
    offset: float
    turns: bool

    def read(self, table: Array, degrees: bool) -> Array:
        """Return the positions of the joint of the arm, (N,) [rad or m]."""
        given = np.deg2rad(table[:, self.number]) if degrees and self.turns else table[:, self.number]
        return np.asarray((given - self.offset) / self.ratio)


def _columns_of(arm: Arm, log: Log, reasons: dict[str, str]) -> dict[str, _Column]:
    """Return the columns of the joints of an arm in a log, and add reasons for others."""
    names = log.joint_names or arm.drives.names
    if len(names) != log.positions.shape[1]:
        allowed = f"joint_names, or the {len(names)} joints of the arm in the order of its drives"
        raise InvalidValue("log", f"{log.positions.shape[1]} columns without names", allowed)
    given = {
        drive.leader: _Column(names.index(drive.joint), drive.ratio, drive.offset, drive.turns)
        for drive in arm.drives
        if drive.joint in names
    }
    for name, slides in zip(arm.joint_names, arm.in_metres, strict=True):
        if name in names and name not in given:
            given[name] = _Column(names.index(name), 1.0, 0.0, not slides)
    if not given:
        raise InvalidValue("log", names, f"joints of the arm, such as {', '.join(arm.joint_names[:3])}")
    known = {*arm.joint_names, *arm.drives.names, *(coupling.joint for coupling in arm.couplings)}
    for name in names:
        if name not in known:
            reasons[name] = "it is no joint of the arm"
    for name in arm.joint_names:
        if name not in given:
            reasons[name] = "it is not in the log"
    return {name: given[name] for name in arm.joint_names if name in given}


def _read_tables(arm: Arm, logs: tuple[Log, ...], loads: bool = False) -> _Tables:
    """Return logs as series of joints, with the torques that hold the arm if `loads`."""
    reasons: dict[str, str] = {}
    series: dict[str, list[Series]] = {name: [] for name in arm.joint_names}
    deviations: dict[str, list[float]] = {name: [] for name in arm.joint_names}
    spans = [float(np.nanmax(log.time) - np.nanmin(log.time)) for log in logs]
    begun = 0.0
    for log, span in zip(logs, spans, strict=True):
        columns = _columns_of(arm, log, reasons)
        _check_degrees(arm, log, columns)
        fresh = _fresh_rows(log)
        elapsed = (begun + log.time - np.nanmin(log.time)) / max(sum(spans), 1e-9)
        count = DRIVE_FIT.segments
        segments = np.clip(np.nan_to_num(elapsed * count), 0, count - 1).astype(np.int64)
        begun += span
        torques = _loads_of(arm, log, columns) if loads else None
        unknown = np.full(len(log.time), np.nan)
        for number, (name, column) in enumerate(columns.items()):
            positions = column.read(log.positions, log.degrees)
            deviations[name].append(_noise(log.time[fresh], positions[fresh]))
            commands = column.read(log.commands, log.degrees)
            effort = unknown if log.effort is None else column.ratio * log.effort[:, column.number]
            parts = _series_of(log, commands, np.array([positions, effort]), fresh, segments)
            if torques is not None:
                parts = [part._replace(torques=torques.at(part.times, number)) for part in parts]
            series[name] += parts
    for name, of_joint in series.items():
        count = sum(len(part.times) for part in of_joint)
        where = {int(segment) for part in of_joint for segment in np.unique(part.segments)}
        rows = IDENTIFICATION.fewest_rows
        tenths = DRIVE_FIT.fewest_segments
        if name not in reasons and (count < rows or len(where) < tenths):
            least = f"at least {rows} in {tenths} tenths of the log are needed"
            reasons[name] = (
                f"{count} measurements beside commands, in {len(where)} tenths of the log; {least}"
            )
        if name in reasons:
            of_joint.clear()
    noise = {name: float(np.median(noises)) for name, noises in deviations.items() if noises}
    measured = _timing_of([(log.time, log.positions) for log in logs])
    sent = _timing_of([(log.command_time, log.commands) for log in logs])
    return _Tables(series, noise, measured, sent, reasons)


def _check_degrees(arm: Arm, log: Log, columns: Mapping[str, _Column]) -> None:
    """Raise InvalidValue if positions may be in degrees."""
    farthest = np.clip(np.zeros(arm.nv), arm.limits.lower, arm.limits.upper)
    for number, name in enumerate(arm.joint_names):
        if name in columns:
            positions = columns[name].read(log.positions, log.degrees)
            known = positions[np.isfinite(positions)]
            if len(known):
                farthest[number] = known[np.abs(known).argmax()]
    arm.check_positions(farthest, "log.positions")


def _fresh_rows(log: Log) -> NDArray[np.bool_]:
    """Return which rows of measurements are fresh: they do not repeat the one before, or only at rest."""
    repeated = _repeated(log.positions)
    since = np.where(repeated, -np.inf, log.time)
    resting = log.time - np.maximum.accumulate(np.nan_to_num(since, nan=-np.inf)) > IDENTIFICATION.still
    return np.isfinite(log.time) & (~repeated | resting)


def _repeated(table: Array) -> NDArray[np.bool_]:
    """Return which rows repeat the one before, (N,)."""
    same = (table[1:] == table[:-1]) | (np.isnan(table[1:]) & np.isnan(table[:-1]))
    return np.concatenate([[False], np.all(same, axis=1)])


def _timing_of(tables: Sequence[tuple[Array, Array]]) -> Timing:
    rows = 0
    steps: list[Array] = []
    stale = 0
    missing = 0
    for time, table in tables:
        rows += len(time)
        repeated = _repeated(table)
        stale += int(repeated.sum())
        missing += int(np.sum(~(np.isfinite(time) & np.all(np.isfinite(table), axis=1))))
        times = time[np.isfinite(time) & ~repeated]
        steps.append(np.diff(times if len(times) > 1 else time[np.isfinite(time)]))
    between = np.concatenate(steps)
    period = float(np.median(between)) if len(between) else 0.0
    usual = between[between <= 10.0 * period]
    jitter = float(np.std(usual)) if len(usual) else 0.0
    bursts = float(np.mean(between < IDENTIFICATION.burst * period)) if len(between) else 0.0
    return Timing(rows, period, jitter, stale / rows, bursts, missing / rows)


def _noise(times: Array, positions: Array) -> float:
    """Return the standard deviation of noise, by third differences of rows with usual intervals."""
    known = np.isfinite(positions)
    steps = np.diff(times[known])
    if len(steps) < 4:
        return 0.0
    usual = steps < 2.0 * np.median(steps)
    third = np.diff(positions[known], n=3)[usual[:-2] & usual[1:-1] & usual[2:]]
    if not len(third):
        return 0.0
    # of normal noise, the median size; of white noise, the variance of the third difference
    noise = float(np.median(np.abs(third)) / 0.6745 / np.sqrt(20.0))
    moves = np.abs(np.diff(positions[known]))
    quantum = float(moves[moves > 0.0].min(initial=np.inf)) if np.any(moves > 0.0) else 0.0
    return noise or float(quantum / np.sqrt(12.0))  # most rows repeat a value of a coarse encoder


def _series_of(
    log: Log,
    commands: Array,
    measured: Array,
    fresh: NDArray[np.bool_],
    segments: NDArray[np.int64],
) -> list[Series]:
    """Return a joint of a log as its uninterrupted parts, with at most `most_measurements` rows.

    Args:
        log: the log.
        commands: the commands of the joint, (N,) [rad or m].
        measured: its positions and efforts, (2, M).
        fresh: which rows of measurements are fresh, (M,).
        segments: the segment of each row, (M,).
    """
    positions = measured[0]
    told = np.isfinite(commands) & np.isfinite(log.command_time)
    sent_at = log.command_time[told]
    sent = commands[told]
    if not len(sent):
        return []
    rows = np.flatnonzero(fresh & np.isfinite(positions) & (log.time >= sent_at[0]))
    rows = rows[:: 1 + len(rows) // IDENTIFICATION.most_measurements]
    parts = np.split(rows, np.flatnonzero(np.diff(log.time[rows]) > IDENTIFICATION.longest_gap) + 1)
    series = []
    for part in parts:
        if len(part) < 2:
            continue
        times = log.time[part]
        first = max(int(np.searchsorted(sent_at, times[0] - DRIVE_FIT.longest_delay, side="right")) - 1, 0)
        last = int(np.searchsorted(sent_at, times[-1] + DRIVE_FIT.longest_delay, side="right"))
        commanded = slice(first, last)
        weightless = np.zeros((2, len(part)))
        rest = (segments[part], weightless, measured[1, part])
        series.append(Series(sent_at[commanded], sent[commanded], times, positions[part], *rest))
    return series


# Loads.


def _unknown_loads(arm: Arm, logs: Sequence[Log]) -> str:
    """Return why torques by the weight of the arm are not known; empty if they are."""
    for number, log in enumerate(logs, start=1):
        which = f" of log {number}" if len(logs) > 1 else ""
        columns = [column.number for column in _columns_of(arm, log, {}).values()]
        whole = len(columns) == arm.nv and np.any(np.all(np.isfinite(log.positions[:, columns]), axis=1))
        reasons = {
            f"the arm touched something{which}, which may have held a part of its weight": log.in_contact,
            f"the attitude of the arm{which} is not known (gravity=...)": log.gravity is None,
            f"there is no gravity{which}": log.gravity is not None and not np.any(log.gravity),
            f"not all joints of the arm are measured{which}": not whole,
            "the logs have different payloads; identify each on its own": log.payload != logs[0].payload,
        }
        for reason, holds in reasons.items():
            if holds:
                return reason
    try:
        arm.require_masses(warns=False)
    except PostureError as error:
        return str(error)
    return ""


class _Loads(NamedTuple):
    """Torques that hold an arm, at some times of a log.

    Attributes:
        times: the times, (k,) [s].
        held: the torques, (k, nv) [N m or N].
        carried: those for each kilogram of payload, (k, nv) [N m or N, per kg].
    """

    times: Array
    held: Array
    carried: Array

    def at(self, times: Array, joint: int) -> Array:
        """Return both for a joint at times (m,), (2, m)."""
        return np.array(
            [np.interp(times, self.times, torques[:, joint]) for torques in (self.held, self.carried)]
        )


def _loads_of(arm: Arm, log: Log, columns: Mapping[str, _Column]) -> _Loads:
    """Return the torques that hold an arm in a log, at evenly spaced rows of it."""
    table = _positions_in(arm, log, columns)
    rows = np.flatnonzero(np.isfinite(log.time) & np.all(np.isfinite(table), axis=1))
    rows = rows[:: 1 + len(rows) // IDENTIFICATION.most_postures]
    bare = arm.with_payload(log.payload) if log.payload else arm
    gravity = np.broadcast_to(np.asarray(log.gravity), (len(log.time), 3))[rows]
    held = _torques_at(bare, table[rows], gravity)
    carried = _torques_at(bare.with_payload(1.0), table[rows], gravity) - held
    return _Loads(log.time[rows], held, carried)


def _positions_in(arm: Arm, log: Log, columns: Mapping[str, _Column]) -> Array:
    """Return the measured positions of all joints of an arm in a log, (N, nv) [rad or m]."""
    return np.column_stack([columns[name].read(log.positions, log.degrees) for name in arm.joint_names])


def _torques_at(arm: Arm, positions: Array, gravity: Array) -> Array:
    """Return the torques that hold an arm at positions (k, nv) in gravity (k, 3), (k, nv) [N m or N]."""
    torques = np.zeros_like(positions)
    q = np.array([arm.configuration(row) for row in positions])
    still = np.zeros_like(positions)
    for axis, unit in enumerate(np.eye(3)):
        if np.any(gravity[:, axis]):
            of_unit = arm.with_gravity(unit).inverse_dynamics(q, still, still)
            torques += gravity[:, axis, None] * of_unit
    return torques


# What fits tell.


def _shared_joints(arm: Arm, tables: _Tables) -> list[str]:
    """Return the joints that one set of parameters is for: those that turn, of those that moved; else all."""
    noise = tables.noise
    least = IDENTIFICATION.moved
    moved = {name for name, parts in tables.series.items() if _range(parts) > least * noise.get(name, 0.0)}
    for slides in (False, True):
        kind = zip(arm.joint_names, arm.in_metres, strict=True)
        names = [name for name, slide in kind if name in moved and slide == slides]
        if names:
            return names
    return []


def _range(series: Sequence[Series]) -> float:
    """Return the range of the measured positions of a joint [rad or m]."""
    if not series:
        return 0.0
    return float(np.ptp(np.concatenate([part.positions for part in series])))


def _judge(fit: Fit, span: float) -> tuple[DriveEstimate, dict[str, str]]:
    """Return what a fit tells of drives, and why it does not tell the rest.

    Args:
        fit: the fit of lag, delay and friction, and of others.
        span: range of the motion [rad or m].
    """
    reasons: dict[str, str] = {}
    lag = Estimate(*fit.parameter(Parameter.LAG))
    delay = Estimate(*fit.parameter(Parameter.DELAY))
    friction = Estimate(*fit.parameter(Parameter.FRICTION))
    known = {"lag": _clipped(lag), "delay": _clipped(delay), "friction": _clipped(friction)}
    if fit.explained < IDENTIFICATION.least_explained:
        why = f"the model explains {max(fit.explained, 0.0):.0%} of the variance in segments left out"
        reasons = dict.fromkeys(known, why)
    else:
        if lag.value > 0.99 * DRIVE_FIT.longest_lag or lag.half > IDENTIFICATION.wide * lag.value:
            reasons["lag"] = (
                f"its interval is {lag.lower:.2g} to {lag.upper:.2g} s: commands change too little"
            )
        interval = f"its interval is {delay.lower:.2g} to {delay.upper:.2g} s"
        if delay.value > 0.99 * DRIVE_FIT.longest_delay or delay.half > IDENTIFICATION.wide_delay * (
            lag.value + max(delay.value, 0.0)
        ):
            reasons["delay"] = f"apart from the lag {interval}: commands change too slowly"
        elif delay.upper < 0.0:
            reasons["delay"] = f"{interval}: the clocks of commands and measurements differ"
        if friction.half > max(IDENTIFICATION.wide * friction.value, IDENTIFICATION.wide_friction * span):
            reasons["friction"] = f"its interval is {friction.lower:.2g} to {friction.upper:.2g}"
    found = {name: None if name in reasons else value for name, value in known.items()}
    return DriveEstimate(**found, explained=fit.explained, rest=fit.rest), reasons


def _clipped(estimate: Estimate) -> Estimate:
    """Return an estimate of what cannot be negative."""
    return Estimate(*(max(value, 0.0) for value in estimate))


def _without_delay(
    series: Sequence[Series], fit: Fit, span: float, loads: int
) -> tuple[Fit, DriveEstimate, dict[str, str]]:
    """Return a fit, with the delay at zero if it cannot be told from the lag, and what it tells."""
    drives, reasons = _judge(fit, span)
    if fit.explained < IDENTIFICATION.least_explained or (
        "delay" not in reasons and fit.values[Parameter.DELAY] >= 0.0
    ):
        return fit, drives, reasons
    free = [k for k in range(Parameter.COMPLIANCE + loads) if k != Parameter.DELAY]
    again = fit_drives(series, loads, free)
    told, others = _judge(again, span)
    others |= {name: why for name, why in reasons.items() if name == "delay"}
    return again, told._replace(delay=drives.delay), others


def _fit_series(
    series: Sequence[Series], span: float, loads: int = 0
) -> tuple[Fit, DriveEstimate, dict[str, str]]:
    """Return the fit of joints that share a drive, what it tells, and why not the rest."""
    return _without_delay(series, fit_drives(series, loads), span, loads)


def _stiffness(fit: Fit) -> tuple[Estimate | None, str]:
    """Return the stiffness of a fit with a compliance, or why there is none."""
    compliance = Estimate(*fit.parameter(Parameter.COMPLIANCE))
    if compliance.lower <= 0.0 or compliance.half > IDENTIFICATION.wide * compliance.value:
        interval = f"{compliance.lower:.2g} to {compliance.upper:.2g}"
        return None, f"the sag by weight is not told: {interval} rad/(N m), or m/N"
    return Estimate(1.0 / compliance.value, 1.0 / compliance.upper, 1.0 / compliance.lower), ""


def _fit_all(
    arm: Arm, tables: _Tables, shared: Sequence[str], why: str, known: float | None
) -> tuple[DriveEstimate, Estimate | None, dict[str, str]]:
    """Return the one set for some joints, the payload, and why the rest is not identified.

    Args:
        arm: the arm.
        tables: the logs.
        shared: the joints.
        why: why torques by weight are not known; empty if they are.
        known: the payload, if it is known.
    """
    weighed = ("stiffness",) if known is not None else ("stiffness", "payload")
    if not shared:
        missing = dict.fromkeys(("lag", "delay", "friction", *weighed), "no joint moved")
        return DriveEstimate(), None, missing
    series = [part for name in shared for part in tables.series[name]]
    span = max(_range(tables.series[name]) for name in shared)
    if why:
        _, drives, reasons = _fit_series(series, span)
        return drives, None, {**reasons, **dict.fromkeys(weighed, why)}
    fit, drives, reasons = _fit_series(series, span, loads=len(weighed))
    stiffness, untold = _stiffness(fit)
    drives = drives._replace(stiffness=stiffness)
    if stiffness is None:
        unknown = ", with an unknown payload (payload=...)" if known is None else ""
        reasons |= {"payload": "the stiffness is not identified"} if known is None else {}
        return drives, None, {**reasons, "stiffness": untold + unknown}
    if known is not None:
        return drives, None, reasons
    payload, untold = _payload(fit, float(sum(inertia.mass for inertia in arm.model.inertias)))
    return drives, payload, {**reasons, "payload": untold} if untold else reasons


def _payload(fit: Fit, mass: float) -> tuple[Estimate | None, str]:
    """Return the payload of a fit with one, or why it is not told, given the mass of the arm [kg]."""
    payload = Estimate(*fit.payload())
    if payload.half > max(IDENTIFICATION.wide * abs(payload.value), IDENTIFICATION.light * mass):
        return None, f"its interval is {payload.lower:.2g} to {payload.upper:.2g} kg"
    return payload, ""


def _with_efforts(drive: DriveEstimate, series: Sequence[Series]) -> tuple[DriveEstimate, dict[str, str]]:
    """Add what efforts tell of drives: the gain, and the friction as a torque; and why they do not."""
    delay = 0.0 if drive.delay is None else drive.delay.value
    gain_fit, explained = fit_gain(series, delay)
    if gain_fit is None:
        reasons = {"gain": "the log has no efforts that change"}
    elif explained < IDENTIFICATION.least_explained or gain_fit[1] <= 0.0:
        reasons = {"gain": f"errors explain {max(explained, 0.0):.0%} of the variance of efforts"}
    else:
        reasons = {}
        drive = drive._replace(gain=Estimate(*gain_fit))
    per_angle = drive.gain or drive.stiffness
    if drive.friction is None or per_angle is None:
        missing = "the friction is not" if drive.friction is None else "neither gain nor stiffness are"
        return drive, {**reasons, "friction torque": f"{missing} identified"}
    torque = drive.friction.value * per_angle.value
    half = np.hypot(drive.friction.half * per_angle.value, drive.friction.value * per_angle.half)
    estimate = _clipped(Estimate(torque, torque - float(half), torque + float(half)))
    return drive._replace(friction_torque=estimate), reasons


def _fit_each(
    tables: _Tables, names: Sequence[str], shared: DriveEstimate, loads: int
) -> dict[str, tuple[DriveEstimate, dict[str, str]]]:
    """Return what is told of each joint, and why not the rest.

    Args:
        tables: the logs.
        names: joints that are measured.
        shared: the one set for all.
        loads: as for `fit_drives`. With an unknown payload, no stiffness of a joint is told.
    """
    band = 0.0 if shared.friction is None else 2.0 * shared.friction.value
    fits: dict[str, tuple[DriveEstimate, dict[str, str]]] = {}
    for name in names:
        series = tables.series[name]
        span = _range(series)
        noise = IDENTIFICATION.moved * tables.noise.get(name, 0.0)
        if span <= max(noise, band):
            explained = f"friction either way, {band:.2g}" if band > noise else f"noise, {noise:.2g}"
            text = f"it moved by {span:.2g}, not by more than {explained}"
            fits[name] = DriveEstimate(), {"drive": text}
            continue
        fit, drive, reasons = _fit_series(series, span, loads)
        if loads == 1:
            stiffness, reason = _stiffness(fit)
            drive = drive._replace(stiffness=stiffness)
            reasons |= {"stiffness": reason} if reason else {}
        drive, of_efforts = _with_efforts(drive, series)
        if any(np.any(np.isfinite(part.effort)) for part in series):
            reasons |= of_efforts
        fits[name] = drive, reasons
    return fits
