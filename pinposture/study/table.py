"""What many runs say together: shares, medians, and what the worst tenth does."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from typing import NamedTuple

import numpy as np

from pinposture.study.families import UNIFORM
from pinposture.study.record import Record, is_lawful

GROUPS = ("smooth", "harsh", "straight and noise", "folds")


class Spread(NamedTuple):
    """A quantity over many runs.

    Attributes:
        median: its median.
        high: its 90th percentile.
    """

    median: float
    high: float


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
        steps: number of steps.
        rising: share of steps on which the posture error rises, escapes included.
        escaping: share of steps on which it does and that were flagged as an escape.
        peak: largest posture error on the way, relative to that of the start.
        path: length of the paths of the control points, relative to the direct distances.
        seconds: time of a step [s].
        violation: farthest outside the position limits that any joint was in any run, in `Arm.joint_units`.
        stride: largest |dq| of any joint in any run, relative to the step limit.
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
    name = family_of if families else group_of
    present = distinct(map(name, records))
    groups = present if families else [group for group in GROUPS if group in present]
    rows = []
    for arm in distinct(record.arm for record in records):
        for group in groups:
            those = [record for record in records if (record.arm, name(record)) == (arm, group)]
            for controller in distinct(record.controller for record in those):
                runs = [record for record in those if record.controller == controller]
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
    if not values:
        return None
    return Spread(float(np.median(values)), float(np.percentile(values, 90)))


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
