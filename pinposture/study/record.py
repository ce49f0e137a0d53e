"""What is kept of one run of a study, and the making of such runs."""

from __future__ import annotations

from collections.abc import Sequence
from time import perf_counter
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from pinposture.control import Controller, Limits
from pinposture.errors import PostureError
from pinposture.motion import Trajectory, track
from pinposture.placement import Target
from pinposture.study.families import Subject
from pinposture.study.reproduce.measures import displacements
from pinposture.study.turns import largest_turn

Array = NDArray[np.float64]

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
        rising: share of steps on which the posture error rises by more than `RISE`, escapes included.
        escaping: share of steps on which it does and that were flagged as an escape.
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
        reason=_one_line(run.reason),
        steps=steps,
        error=float(errors[-1]) / int(run.target.placed.sum()) / run.arm.length,
        rising=float(rises.mean()) if steps else 0.0,
        escaping=float((rises & run.escape).mean()) if steps else 0.0,
        peak=float(errors.max() / errors[0]) if errors[0] > 0.0 else 1.0,
        path=run.sweep,
        turn=None if run.target.q is None else largest_turn(run.arm, run.q[0], run.target.q),
        seconds=seconds / max(steps, 1),
        violation=_violation(run),
        stride=0.0 if bound is None else float(np.max(np.abs(dq) / bound, initial=0.0)),
    )


def _one_line(text: str) -> str:
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
        target: where its control points should be.
        controllers: the controllers.

    Returns:
        One record for each controller, in their order.
    """
    arm = subject.arm
    records = []
    for controller in controllers:
        began = perf_counter()
        try:
            run = track(
                arm,
                target,
                start,
                controller,
                limits=Limits(step=STEP),
                max_steps=MAX_STEPS,
                tolerance=TOLERANCE * arm.length,
            )
        except PostureError as error:
            records.append(_refused(subject, case, start, target, controller.name, str(error)))
        else:
            records.append(record_run(run, case, controller.name, perf_counter() - began))
    return records


def _refused(
    subject: Subject, case: Case, start: Array, target: Target, controller: str, reason: str
) -> Record:
    """The record of an arm that stays where it is."""
    arm = subject.arm
    errors = np.linalg.norm(arm.at(start).points - target.points, axis=1)[target.placed]
    return Record(
        *case,
        controller=controller,
        status="refused",
        reason=_one_line(reason),
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
