"""Common parts of the studies: parallel execution, records of runs, summaries, and files."""

from __future__ import annotations

import csv
import io
from collections.abc import Callable, Iterable, Mapping, Sequence
from operator import attrgetter
from pathlib import Path
from time import perf_counter
from typing import TYPE_CHECKING, Any, NamedTuple, TypeVar, get_type_hints

import numpy as np
from joblib import delayed
from numpy.typing import NDArray

from benchmarks.cases.scenarios import largest_turn
from benchmarks.studies.arms import UNIFORM, Subject
from pinposture._validation import require_whole
from pinposture.control import Controller, Limits
from pinposture.errors import FileError, InvalidValue, PostureError
from pinposture.motion import Trajectory, track
from pinposture.motion.processes import Progress, collect_results
from pinposture.placement import Target
from pinposture.storage import read_text, write_figure, write_json, write_table

if TYPE_CHECKING:
    from matplotlib.figure import Figure

    from pinposture.arm import Arm
    from pinposture.collision import Scene


Array = NDArray[np.float64]
Result = TypeVar("Result")
Key = TypeVar("Key")


def check_study(first_seed: int = 0, **asked: int | Sequence[Any]) -> None:
    """Raise InvalidValue for a number below 1, an empty list, or a seed below 0; names the argument."""
    require_whole("first_seed", first_seed, 0)
    for name, value in asked.items():
        if not isinstance(value, Sequence):
            require_whole(name, value, 1)
        elif len(value) == 0:
            raise InvalidValue(name, list(value), "at least one")


def run_all(
    one: Callable[..., Result], cases: Iterable[tuple[Any, ...]], jobs: int, progress: Progress | None
) -> list[Result]:
    """Call a function that can be pickled with the arguments of each case; return the results in order.

    `jobs` is the number of processes; joblib's backends apply, so `joblib.parallel_config` runs a study on a
    cluster. `progress` is called with the numbers of finished and of all cases.
    """
    return collect_results([delayed(one)(*case) for case in cases], jobs, progress)


def grouped(runs: Iterable[Result], key: Callable[[Result], Key]) -> dict[Key, list[Result]]:
    """Group runs by a key, in order of first appearance."""
    groups: dict[Key, list[Result]] = {}
    for run in runs:
        groups.setdefault(key(run), []).append(run)
    return groups


STEP = 0.1
"""Largest |dq| of a step [rad or m]."""
MAX_STEPS = 400
TOLERANCE = 1e-6
"""Mean point error, relative to the arm length, at which a run has arrived."""
NEAR = 1e-3
"""Mean point error, relative to the arm length, that is often considered a success."""
RISE = 1e-9
"""Negligible rise of the posture error in one step, relative to the error at the start."""
WITHIN = 1e-9
"""Excess over a limit that counts as rounding error."""


class Record(NamedTuple):
    """Record of one run; by default of an arm that does not move.

    Attributes:
        arm: name of the arm.
        start: kind of start.
        target: kind of target.
        seed: seed of the case.
        controller: name of the controller.
        status: how the run ended, as `Trajectory.status`; "refused" if the controller rejected the case.
        reason: explanation of the status on one line.
        steps: number of steps.
        error: mean point error at the end, relative to the arm length.
        rising: share of steps on which the posture error rises by more than `RISE`.
        escaping: share of steps on which it rises with the controller's consent.
        peak: largest posture error relative to that at the start; 1 if that was zero.
        path: path length of all control points relative to straight lines from start to end.
        turn: largest change of heading between start and target [rad], see `largest_turn`; None if no
            configuration of the target is known.
        seconds: wall time per step [s]; 0 if there was none.
        violation: largest violation of position limits, in `Arm.joint_units`.
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
    rising: float = 0.0
    escaping: float = 0.0
    peak: float = 1.0
    path: float = 1.0
    turn: float | None = None
    seconds: float = 0.0
    violation: float = 0.0
    stride: float = 0.0

    @property
    def arrived(self) -> bool:
        """Whether the final error is within `TOLERANCE`."""
        return self.error <= TOLERANCE * (1.0 + RISE)

    @property
    def near(self) -> bool:
        """Whether the final error is within `NEAR`."""
        return self.error < NEAR

    @property
    def lawful(self) -> bool:
        """Whether all joints stayed within their position limits and all steps within the step limit."""
        return is_lawful(self.violation, self.stride)


def is_lawful(violation: float, stride: float) -> bool:
    """Return whether limits were kept, up to rounding error; see `Record`."""
    return violation <= WITHIN and stride <= 1.0 + WITHIN


class Case(NamedTuple):
    """Description of a case: the first fields of its `Record`."""

    arm: str
    start: str
    target: str
    seed: int


def record_run(run: Trajectory, case: Case, controller: str, seconds: float = 0.0) -> Record:
    """Create the record of a run of a case by a controller, given its wall time [s]."""
    errors, steps = run.posture_error, run.steps
    rises = np.diff(errors) > RISE * errors[0]
    bound = run.limits.step
    dq = run.displacements
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
    return float(run.mean_error[-1]) / run.arm.length


def one_line(text: str) -> str:
    """Replace line breaks and repeated blanks by single blanks."""
    return " ".join(text.split())


def _violation(run: Trajectory) -> float:
    """Return the largest violation of position limits of joints on the chain, in `Arm.joint_units`."""
    arm = run.arm
    own, positions = arm.columns, np.array([arm.positions(q) for q in run.q])
    outside = np.maximum(arm.limits.lower - positions, positions - arm.limits.upper) / arm.joint_units
    return float(max(outside[:, own].max(), 0.0))


def run_case(
    subject: Subject, case: Case, start: Array, target: Target, controllers: Sequence[Controller]
) -> list[Record]:
    """Run each of several controllers from a start, (nq,), to a target, and return their records in order.

    |dq| <= `STEP`, at most `MAX_STEPS` steps, until the mean point error is within `TOLERANCE`. If a
    controller rejects the arm or target, its run is recorded as refused.
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
    """Run a controller with the common settings of all studies: |dq| <= `STEP`, at most `MAX_STEPS` steps.

    It has converged when the mean point error is within the tolerance, relative to the arm length.
    """
    limits, near = Limits(step=STEP), tolerance * arm.length
    return track(arm, target, start, controller, limits, scene=scene, max_steps=MAX_STEPS, tolerance=near)


def _refused(arm: Arm, case: Case, start: Array, target: Target, controller: str, reason: str) -> Record:
    """Return the record of an arm that does not move."""
    errors = np.linalg.norm(arm.at(start).points - target.points, axis=1)[target.has_target]
    return Record(
        *case,
        controller=controller,
        status="refused",
        reason=one_line(reason),
        steps=0,
        error=float(errors.mean()) / arm.length,
        turn=None if target.q is None else largest_turn(arm, start, target.q),
    )


GROUPS = ("smooth", "harsh", "straight and noise", "folds")


class Spread(NamedTuple):
    """Median of a quantity over many runs and, as `high`, its 90th percentile."""

    median: float
    high: float

    @classmethod
    def of(cls, values: Sequence[float]) -> Spread:
        """Return the spread of at least one value."""
        return cls(float(np.median(values)), float(np.percentile(values, 90)))


class SummaryRow(NamedTuple):
    """Summary of one controller for a group of cases.

    Spreads only include runs that moved and came near (`Record.near`), and are None if there are none; their
    quantities are those of `Record`.

    Attributes:
        arm: name of the arm.
        group: name of the group.
        controller: name of the controller.
        runs: number of runs.
        arrived: share of runs that ended within 1e-6 of the arm length.
        near: share of runs that ended within 1e-3.
        refused: number of cases that the controller rejected.
        violation: largest violation of any run.
        stride: largest stride of any run.
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
        """Whether all runs stayed within their position and step limits."""
        return is_lawful(self.violation, self.stride)


def group_of(record: Record) -> str:
    """Return the group of a run: "folds" if the target is folded, else by its start."""
    if record.target == "folded":
        return "folds"
    if record.start == "smooth":
        return "smooth"
    return "harsh" if record.start in UNIFORM else "straight and noise"


def family_of(record: Record) -> str:
    """Return the family of a run, in words."""
    return f"{record.start} -> {record.target}"


def summarise(records: Sequence[Record], families: bool = False) -> list[SummaryRow]:
    """Summarise runs by arm, group and controller, or by family instead of `GROUPS`.

    Returns:
        One row for each controller in each group of each arm; arms, controllers and families in order of
        first appearance, groups in the order of `GROUPS`.
    """
    rows = []
    for arm, own in grouped(records, lambda record: record.arm).items():
        groups = grouped(own, family_of if families else group_of)
        for group in groups if families else (name for name in GROUPS if name in groups):
            for controller, runs in grouped(groups[group], lambda record: record.controller).items():
                rows.append(_row(arm, group, controller, runs))
    return rows


def distinct(names: Iterable[str]) -> list[str]:
    """Return the names without duplicates, in order of first appearance."""
    return list(dict.fromkeys(names))


def telling(records: Iterable[Record]) -> list[Record]:
    """Return the runs that moved and came near the target, whose motion is meaningful."""
    return [record for record in records if record.near and record.steps]


def spread(records: Iterable[Record], measure: Callable[[Record], float]) -> Spread | None:
    """Return the spread of a measure over the runs that moved and came near; None if none did."""
    values = [measure(record) for record in telling(records)]
    return Spread.of(values) if values else None


def _row(arm: str, group: str, controller: str, runs: list[Record]) -> SummaryRow:
    spreads = ("steps", "rising", "escaping", "peak", "path", "seconds")
    return SummaryRow(
        arm=arm,
        group=group,
        controller=controller,
        runs=len(runs),
        arrived=float(np.mean([run.arrived for run in runs])),
        near=float(np.mean([run.near for run in runs])),
        refused=sum(run.status == "refused" for run in runs),
        **{name: spread(runs, attrgetter(name)) for name in spreads},
        violation=max(run.violation for run in runs),
        stride=max(run.stride for run in runs),
    )


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
    """Write a CSV file with one row for each run and a header of field names, at full precision.

    The runs are named tuples with those fields. The path of the file is returned.

    Raises:
        FileError: the file cannot be written.
    """
    write_table(Path(path), [fields, *records])
    return Path(path)


def read_records(path: str | Path) -> list[Record]:
    """Read a file of `write_records`.

    Raises:
        FileError: the file is missing, has other columns or an invalid row; names the line.
    """
    path = Path(path)
    rows = csv.reader(io.StringIO(read_text(path)))
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
    """Write a study to a directory, created if necessary, and return the paths of its files.

    The runs are written to cases.csv under the names of their fields, the JSON-compatible summary to
    summary.json, and the figures, by file name, as PNG; each file is written atomically.

    Raises:
        FileError: a file cannot be written.
    """
    directory = Path(directory)
    files = [write_records(records, directory / CASES_FILE, fields)]
    for name, figure in figures.items():
        files.append(directory / name)
        write_figure(files[-1], figure)
    files.append(directory / SUMMARY)  # last, so that it marks a complete study
    write_json(files[-1], summary)
    return files
