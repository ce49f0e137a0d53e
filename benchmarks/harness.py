"""One harness for all studies: cases, methods and measures give rows, and rows give summaries."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple, TypeVar

import numpy as np
from joblib import delayed
from numpy.typing import NDArray

from pinposture._validation import require_whole
from pinposture.arm import Arm
from pinposture.collision import Scene
from pinposture.errors import InvalidValue
from pinposture.motion.processes import Progress, in_order
from pinposture.placement import Target

Array = NDArray[np.float64]
Item = TypeVar("Item")
Key = TypeVar("Key")


class Row(dict[str, Any]):
    """What is known of a run, or of a group of runs: values by name, which are attributes as well.

    A name that dictionaries have themselves, such as clear, is no attribute: `row["clear"]`.
    """

    def __getattr__(self, name: str) -> Any:
        try:
            return self[name]
        except KeyError:
            raise AttributeError(name) from None

    def but(self, **changes: Any) -> Row:
        """Return the row with some values changed or added."""
        return Row({**self, **changes})


class Problem(NamedTuple):
    """What a controller has to solve: an arm, a configuration to start from, (nq,), a target, obstacles."""

    arm: Arm
    start: Array
    target: Target
    scene: Scene | None = None


class Case(NamedTuple):
    """A case of a study.

    Attributes:
        labels: what tells it from others, the first columns of its rows.
        draw: makes the problem; a function without arguments that can be pickled.
    """

    labels: Mapping[str, Any]
    draw: Callable[[], Any]


@dataclass(frozen=True)
class Study:
    """Every method on every case.

    Attributes:
        cases: the cases.
        methods: the methods, such as controllers; each gets the same problems.
        measures: a function that can be pickled, of the problem of a case and a method. It returns the
            columns of their row, or None for a case that does not count.
    """

    cases: Iterable[Case]
    methods: Sequence[Any]
    measures: Callable[[Any, Any], Mapping[str, Any] | None]

    def rows(self, jobs: int = 1, progress: Progress | None = None) -> list[Row]:
        """Run the study, and return its rows in the order of cases, then methods.

        Args:
            jobs: number of processes, which makes no difference to the rows, except for times. The backends
                of joblib apply: `joblib.parallel_config` runs a study on a cluster.
            progress: called with the numbers of finished and of all cases.
        """
        tasks = [delayed(_rows_of)(case, self.methods, self.measures) for case in self.cases]
        rows: list[Row] = []
        for done, found in enumerate(in_order(tasks, jobs), start=1):
            rows += found
            if progress is not None:
                progress(done, len(tasks))
        return rows


def _rows_of(case: Case, methods: Sequence[Any], measures: Callable[[Any, Any], Any]) -> list[Row]:
    problem = case.draw()
    measured = (measures(problem, method) for method in methods)
    return [Row({**case.labels, **columns}) for columns in measured if columns is not None]


def check_study(first_seed: int = 0, **asked: int | Sequence[Any]) -> None:
    """Raise InvalidValue for a number below 1, an empty list, or a seed below 0; names the argument."""
    require_whole("first_seed", first_seed, 0)
    for name, value in asked.items():
        if not isinstance(value, Sequence):
            require_whole(name, value, 1)
        elif len(value) == 0:
            raise InvalidValue(name, list(value), "at least one")


# Summaries: rows in groups, and functions that make one value of the rows of a group.

Reducer = Callable[[Sequence[Row]], Any]


def summarise(rows: Iterable[Row], by: Sequence[str], **columns: Reducer) -> list[Row]:
    """Return one row for each combination of the columns `by`, in order of first appearance."""
    groups = grouped(rows, lambda row: tuple(row[name] for name in by))
    return [
        Row({**dict(zip(by, key, strict=True)), **{name: made(own) for name, made in columns.items()}})
        for key, own in groups.items()
    ]


def grouped(items: Iterable[Item], key: Callable[[Item], Key]) -> dict[Key, list[Item]]:
    """Group items by a key, in order of first appearance."""
    groups: dict[Key, list[Item]] = {}
    for item in items:
        groups.setdefault(key(item), []).append(item)
    return groups


def distinct(names: Iterable[Key]) -> list[Key]:
    """Return the names without duplicates, in order of first appearance."""
    return list(dict.fromkeys(names))


def count(true: Callable[[Row], object]) -> Reducer:
    """Count the rows of which something is true."""
    return lambda rows: sum(bool(true(row)) for row in rows)


def share(true: Callable[[Row], object]) -> Reducer:
    """Return the share of the rows of which something is true."""
    return lambda rows: float(np.mean([bool(true(row)) for row in rows]))


def largest(name: str) -> Reducer:
    """Return the largest value of a column."""
    return lambda rows: max(row[name] for row in rows)


def median(name: str, among: Callable[[Row], object] = bool) -> Reducer:
    """Return the median of a column over some of the rows; None if there are none."""

    def reduced(rows: Sequence[Row]) -> float | None:
        values = [row[name] for row in rows if among(row)]
        return float(np.median(values)) if values else None

    return reduced


def spread(name: str, among: Callable[[Row], object] = bool) -> Reducer:
    """Return median and, as `high`, 90th percentile of a column over some rows; None if there are none."""

    def reduced(rows: Sequence[Row]) -> Row | None:
        values = [row[name] for row in rows if among(row)]
        if not values:
            return None
        return Row(median=float(np.median(values)), high=float(np.percentile(values, 90)))

    return reduced
