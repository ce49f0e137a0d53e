"""What studies share: their cases on all processes, what is kept of a run, summaries, and files."""

from __future__ import annotations

import csv
import io
import json
from collections.abc import Callable, Iterable, Mapping, Sequence
from pathlib import Path
from time import perf_counter
from typing import TYPE_CHECKING, Any, NamedTuple, TypeVar, get_type_hints

import numpy as np
from joblib import delayed
from numpy.typing import NDArray

from pinposture._validation import require_whole
from pinposture.control import Controller, Limits
from pinposture.errors import FileError, InvalidValue, PostureError
from pinposture.motion import Trajectory, track
from pinposture.motion.processes import Progress, collect_results
from pinposture.placement import Target
from pinposture.storage import write_figure, write_text
from pinposture.study.arms import UNIFORM, Subject
from pinposture.study.reproduce.runs import displacements
from pinposture.study.scenarios import largest_turn

if TYPE_CHECKING:
    from matplotlib.figure import Figure

    from pinposture.arm import Arm
    from pinposture.collision import Scene


# How a study is run: one call for each case, on all processes.

Array = NDArray[np.float64]
Result = TypeVar("Result")
Key = TypeVar("Key")


def check_study(first_seed: int = 0, **asked: int | Sequence[Any]) -> None:
    """Raise InvalidValue, under its name, for a number below 1 or a list of nothing; or a seed below 0."""
    require_whole("first_seed", first_seed, 0)
    for name, value in asked.items():
        if not isinstance(value, Sequence):
            require_whole(name, value, 1)
        elif len(value) == 0:
            raise InvalidValue(name, list(value), "at least one")


def run_all(
    one: Callable[..., Result], cases: Iterable[tuple[Any, ...]], jobs: int, progress: Progress | None
) -> list[Result]:
    """Call a function with the arguments of each case.

    Args:
        one: the function, known by name to other processes.
        cases: its arguments.
        jobs: number of processes; joblib's backends apply, so that `joblib.parallel_config` around a study
            runs it on a cluster.
        progress: called with the number of cases finished so far, and that of all.

    Returns:
        The results in the order of the cases.
    """
    return collect_results([delayed(one)(*case) for case in cases], jobs, progress)


def grouped(runs: Iterable[Result], key: Callable[[Result], Key]) -> dict[Key, list[Result]]:
    """Runs by what a key makes of them, in the order in which that first appears."""
    groups: dict[Key, list[Result]] = {}
    for run in runs:
        groups.setdefault(key(run), []).append(run)
    return groups


# What is kept of one run of a study, and the making of such runs.

STEP = 0.1
"""Largest |dq| of a step [rad or m]."""
MAX_STEPS = 400
TOLERANCE = 1e-6
"""Mean point error, relative to the arm length, at which a run is there."""
NEAR = 1e-3
"""The same for a run that others would call successful."""
RISE = 1e-9
"""Rise of the posture error in one step, relative to that of the start, that counts as none."""
WITHIN = 1e-9
"""How far outside a limit counts as rounding."""


class Record(NamedTuple):
    """One run.

    Attributes:
        arm: name of the arm.
        start: kind of start.
        target: kind of target.
        seed: seed of the case.
        controller: name of the controller.
        status: how the run ended, as `Trajectory.status`; "refused" if the controller would not begin.
        reason: why, in words, on one line.
        steps: number of steps.
        error: mean point error at the end, relative to the arm length.
        rising: share of steps on which the posture error rises by more than `RISE`.
        escaping: share of steps on which it does and the controller lets it.
        peak: largest posture error on the way, relative to that of the start; 1 if that was zero.
        path: length of the paths of all control points relative to the direct distances from start to end.
        turn: largest change of heading between start and target [rad], see `largest_turn`; None where no
            configuration is known that takes the target.
        seconds: time of a step, with whatever else the machine did [s]; 0 if there was none.
        violation: farthest that a joint was outside its position limits on the way, in `Arm.joint_units`.
        stride: largest |dq| of any joint relative to the step limit; 0 if there was no limit.
    """

    arm: str
    start: str
    target: str
    seed: int
    controller: str
    status: str
    reason: str
    steps: int
    error: float
    rising: float
    escaping: float
    peak: float
    path: float
    turn: float | None
    seconds: float
    violation: float
    stride: float

    @property
    def arrived(self) -> bool:
        """Whether it is within `TOLERANCE`."""
        return self.error <= TOLERANCE * (1.0 + RISE)

    @property
    def near(self) -> bool:
        """Whether it is within `NEAR`."""
        return self.error < NEAR

    @property
    def lawful(self) -> bool:
        """Whether all joints kept within their position limits and all steps within the step limit."""
        return is_lawful(self.violation, self.stride)


def is_lawful(violation: float, stride: float) -> bool:
    """Whether that is within the limits, but for rounding; see `Record`."""
    return violation <= WITHIN and stride <= 1.0 + WITHIN


class Case(NamedTuple):
    """What a run was about: the first fields of its `Record`."""

    arm: str
    start: str
    target: str
    seed: int


def record_run(run: Trajectory, case: Case, controller: str, seconds: float = 0.0) -> Record:
    """Measure a run.

    Args:
        run: the run.
        case: what it was about.
        controller: name of the controller.
        seconds: time that the run took [s].
    """
    errors, steps = run.posture_error, run.steps
    rises = np.diff(errors) > RISE * errors[0]
    bound = run.limits.step
    dq = displacements(run)
    return Record(
        *case,
        controller=controller,
        status=run.status,
        reason=one_line(run.reason),
        steps=steps,
        error=final_error(run),
        rising=float(rises.mean()) if steps else 0.0,
        escaping=float((rises & run.error_increasing).mean()) if steps else 0.0,
        peak=float(errors.max() / errors[0]) if errors[0] > 0.0 else 1.0,
        path=run.path_length_ratio,
        turn=None if run.target.q is None else largest_turn(run.arm, run.q[0], run.target.q),
        seconds=seconds / max(steps, 1),
        violation=_violation(run),
        stride=0.0 if bound is None else float(np.max(np.abs(dq) / bound, initial=0.0)),
    )


def final_error(run: Trajectory) -> float:
    """Return the mean point error at the end of a run, relative to the arm length."""
    return float(run.posture_error[-1]) / int(run.target.has_target.sum()) / run.arm.length


def one_line(text: str) -> str:
    """Return a text without line breaks and repeated blanks."""
    return " ".join(text.split())


def _violation(run: Trajectory) -> float:
    """Farthest outside the position limits, of the joints that move the arm, in `Arm.joint_units`."""
    arm = run.arm
    own, positions = arm.columns, np.array([arm.positions(q) for q in run.q])
    outside = np.maximum(arm.limits.lower - positions, positions - arm.limits.upper) / arm.joint_units
    return float(max(outside[:, own].max(), 0.0))


def run_case(
    subject: Subject, case: Case, start: Array, target: Target, controllers: Sequence[Controller]
) -> list[Record]:
    """Drive an arm from one start to one target with each of several controllers.

    |dq| <= `STEP`, at most `MAX_STEPS` steps, until the mean point error is within `TOLERANCE`. A controller
    that does not take such an arm or target spoils its own run only, which is recorded as refused.

    Args:
        subject: the arm.
        case: what to call it.
        start: configuration, (nq,).
        target: the target posture.
        controllers: the controllers.

    Returns:
        One record for each controller, in their order.
    """
    arm, records = subject.arm, []
    for controller in controllers:
        began = perf_counter()
        try:
            run = drive(arm, target, start, controller)
        except PostureError as error:
            records.append(_refused(arm, case, start, target, controller.name, str(error)))
        else:
            records.append(record_run(run, case, controller.name, perf_counter() - began))
    return records


def drive(
    arm: Arm,
    target: Target,
    start: Array,
    controller: str | Controller = "geodesic",
    scene: Scene | None = None,
    tolerance: float = TOLERANCE,
) -> Trajectory:
    """Drive an arm as all studies do: |dq| <= `STEP`, at most `MAX_STEPS` steps.

    Args:
        arm: the arm.
        target: the target posture.
        start: configuration, (nq,).
        controller: a controller, or the name of one.
        scene: the obstacles.
        tolerance: mean point error at which a run has converged, relative to the arm length.
    """
    limits, near = Limits(step=STEP), tolerance * arm.length
    return track(arm, target, start, controller, limits, scene=scene, max_steps=MAX_STEPS, tolerance=near)


def _refused(arm: Arm, case: Case, start: Array, target: Target, controller: str, reason: str) -> Record:
    """The record of an arm that stays where it is."""
    errors = np.linalg.norm(arm.at(start).points - target.points, axis=1)[target.has_target]
    return Record(
        *case,
        controller=controller,
        status="refused",
        reason=one_line(reason),
        steps=0,
        error=float(errors.mean()) / arm.length,
        rising=0.0,
        escaping=0.0,
        peak=1.0,
        path=1.0,
        turn=None if target.q is None else largest_turn(arm, start, target.q),
        seconds=0.0,
        violation=0.0,
        stride=0.0,
    )


# What many runs say together: shares, medians, and what the worst tenth does.

GROUPS = ("smooth", "harsh", "straight and noise", "folds")


class Spread(NamedTuple):
    """A quantity over many runs.

    Attributes:
        median: its median.
        high: its 90th percentile.
    """

    median: float
    high: float

    @classmethod
    def of(cls, values: Sequence[float]) -> Spread:
        """Return the spread of at least one value."""
        return cls(float(np.median(values)), float(np.percentile(values, 90)))


class SummaryRow(NamedTuple):
    """What one controller made of a group of cases.

    What a motion was like is told of the runs that moved and came near (`Record.near`): one that never moved,
    or gave up, tells nothing of the way. It is None where there is no such run.

    Attributes:
        arm: name of the arm.
        group: name of the group.
        controller: name of the controller.
        runs: number of runs.
        arrived: share of them that ended within 1e-6 of the arm length.
        near: share of them that ended within 1e-3.
        refused: number of runs that the controller would not begin.
        steps: as in `Record`, and so the following; here the number of steps.
        rising: share of steps on which the posture error rises.
        escaping: share of those in which the controller lets it rise.
        peak: largest posture error.
        path: length of the paths.
        seconds: time of a step [s].
        violation: the farthest of any run.
        stride: the largest of any run.
    """

    arm: str
    group: str
    controller: str
    runs: int
    arrived: float
    near: float
    refused: int
    steps: Spread | None
    rising: Spread | None
    escaping: Spread | None
    peak: Spread | None
    path: Spread | None
    seconds: Spread | None
    violation: float
    stride: float

    @property
    def lawful(self) -> bool:
        """Whether no joint of any run left its position limits, and no step its own."""
        return is_lawful(self.violation, self.stride)


def group_of(record: Record) -> str:
    """The group of a run: "folds" if the target is one, else by its start."""
    if record.target == "folded":
        return "folds"
    if record.start == "smooth":
        return "smooth"
    return "harsh" if record.start in UNIFORM else "straight and noise"


def family_of(record: Record) -> str:
    """The family of a run, in words."""
    return f"{record.start} -> {record.target}"


def summarise(records: Sequence[Record], families: bool = False) -> list[SummaryRow]:
    """Summarise runs by arm, group and controller.

    Args:
        records: the runs.
        families: group them by their families; else by `GROUPS`.

    Returns:
        One row for each controller in each group of each arm; arms, controllers and families in the order in
        which they first appear, groups in that of `GROUPS`.
    """
    rows = []
    for arm, own in grouped(records, lambda record: record.arm).items():
        groups = grouped(own, family_of if families else group_of)
        for group in groups if families else (name for name in GROUPS if name in groups):
            for controller, runs in grouped(groups[group], lambda record: record.controller).items():
                rows.append(_row(arm, group, controller, runs))
    return rows


def distinct(names: Iterable[str]) -> list[str]:
    """Each name once, in the order in which they first appear."""
    return list(dict.fromkeys(names))


def telling(records: Iterable[Record]) -> list[Record]:
    """The runs that tell what the way to a target is like: they moved, and came near it."""
    return [record for record in records if record.near and record.steps]


def spread(records: Iterable[Record], measure: Callable[[Record], float]) -> Spread | None:
    """Median and 90th percentile of a measure over the runs that moved and came near; None if none did."""
    values = [measure(record) for record in telling(records)]
    return Spread.of(values) if values else None


def _row(arm: str, group: str, controller: str, runs: list[Record]) -> SummaryRow:
    return SummaryRow(
        arm=arm,
        group=group,
        controller=controller,
        runs=len(runs),
        arrived=float(np.mean([run.arrived for run in runs])),
        near=float(np.mean([run.near for run in runs])),
        refused=sum(run.status == "refused" for run in runs),
        steps=spread(runs, lambda run: run.steps),
        rising=spread(runs, lambda run: run.rising),
        escaping=spread(runs, lambda run: run.escaping),
        peak=spread(runs, lambda run: run.peak),
        path=spread(runs, lambda run: run.path),
        seconds=spread(runs, lambda run: run.seconds),
        violation=max(run.violation for run in runs),
        stride=max(run.stride for run in runs),
    )


# Records of runs as files: a CSV of one row for each run, a summary as JSON, a picture.

CASES_FILE, SUMMARY = "cases.csv", "summary.json"

_PARSERS: dict[object, Callable[[str], Any]] = {
    str: str,
    int: int,
    float: float,
    float | None: lambda text: float(text) if text else None,
}


def write_records(
    records: Iterable[tuple[Any, ...]], path: str | Path, fields: Sequence[str] = Record._fields
) -> Path:
    """Write one row for each run, under a row of field names; no digit is lost.

    Args:
        records: the runs, named tuples with those fields.
        path: the file.
        fields: names of the fields; those of `Record` unless told otherwise.

    Returns:
        The path written.

    Raises:
        FileError: the file cannot be written.
    """
    text = io.StringIO()
    writer = csv.writer(text, lineterminator="\n")
    writer.writerow(fields)
    # csv writes floats by repr, which reads back as the same number, and None as nothing.
    writer.writerows(records)
    write_text(Path(path), text.getvalue())
    return Path(path)


def read_records(path: str | Path) -> list[Record]:
    """Read what `write_records` wrote.

    Raises:
        FileError: the file is missing, has other columns, or a row that is no record; names the line.
    """
    path = Path(path)
    try:
        text = path.read_text(encoding="utf-8")
    except OSError as error:
        raise FileError(path, f"cannot be read ({error.strerror or error})") from error
    except UnicodeDecodeError as error:
        raise FileError(path, "is not a table of runs (not UTF-8 text)") from error
    rows = csv.reader(io.StringIO(text))
    if next(rows, None) != list(Record._fields):
        raise FileError(path, f"is not a table of runs; allowed: the columns {', '.join(Record._fields)}")
    kinds = get_type_hints(Record)
    parsers = [_PARSERS[kinds[name]] for name in Record._fields]
    records = []
    for row in rows:
        try:
            records.append(Record(*(parse(cell) for parse, cell in zip(parsers, row, strict=True))))
        except ValueError as error:
            raise FileError(path, f"line {rows.line_num}: is not a run ({error})") from error
    return records


def keep_study(
    directory: str | Path,
    records: Iterable[tuple[Any, ...]],
    summary: Mapping[str, Any],
    figures: Mapping[str, Figure],
    fields: Sequence[str] = Record._fields,
) -> list[Path]:
    """Leave a study in a directory, which is made if need be; each file appears whole or not at all.

    Args:
        directory: where to.
        records: its runs, for cases.csv.
        summary: what is said of them, as data that JSON can hold, for summary.json.
        figures: pictures by the names of their files, written as PNG.
        fields: names of the fields of a run; those of `Record` unless told otherwise.

    Returns:
        Paths of the files.

    Raises:
        FileError: a file cannot be written.
    """
    directory = Path(directory)
    files = [write_records(records, directory / CASES_FILE, fields)]
    for name, figure in figures.items():
        files.append(directory / name)
        write_figure(files[-1], figure)
    files.append(directory / SUMMARY)  # last: where it is, the rest is
    write_text(files[-1], json.dumps(summary, indent=1, allow_nan=False) + "\n")
    return files
