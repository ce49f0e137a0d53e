"""What is written down of a motion besides its steps: targets, times, places passed."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from pinposture.arm import ArmState
from pinposture.motion.drive import Drive
from pinposture.motion.motion import Motion, Passed
from pinposture.target import Target
from pinposture.task.reference import Mark, Reference

Array = NDArray[np.float64]

ROUNDING = 1e-9
"""How far short of a row, in rows, is still at it."""


class Log:
    """The places of a reference at which a motion was, row by row, with the targets there.

    Args:
        reference: the reference.
        first: the target of its first row.
    """

    def __init__(self, reference: Reference, first: Target) -> None:
        self._reference = reference
        self._places, self._targets = [0.0], [first]
        self._begun: int | None = None
        self._notes: list[str] = []

    def add(self, place: float, target: Target) -> None:
        """Write down where a step led."""
        self._places.append(place)
        self._targets.append(target)

    def fill(self, drive: Drive, place: float, target: Target) -> None:
        """Write down the steps that were taken towards a target since, while the plan stood still."""
        missing = drive.recorder.steps + 1 - len(self._places)
        self._places += [self._places[-1]] * missing
        self._targets += [target] * missing
        self._places[-1] = place

    def set_out(self) -> None:
        """The plan begins here."""
        self._begun = len(self._places) - 1

    def note(self, place: float, what: str) -> None:
        """Write down in words what was not as planned."""
        self._notes.append(f"at {place * self._reference.interval:.4g} s of the plan {what}")

    def motion(self, drive: Drive, status: str, reason: str) -> Motion:
        """Everything so far, as a result."""
        reference, places = self._reference, np.array(self._places)
        run = drive.recorder.trajectory(drive.arm, drive.controller, drive.limits, status, reason)
        asked = np.array([target.placed for target in self._targets])
        dt = reference.duration if drive.limits.dt is None else drive.limits.dt
        return Motion(
            run=run,
            targets=np.array([target.points for target in self._targets]),
            asked=asked,
            clock=np.minimum(places * reference.interval, reference.duration),
            set_out=len(places) - 1 if self._begun is None else self._begun,
            planned=reference.duration,
            passed=tuple(self._passed(mark, places, run.q, run.points, dt) for mark in reference.marks),
            detours=tuple(self._notes),
        )

    def _passed(self, mark: Mark, places: Array, q: Array, points: Array, dt: float) -> Passed:
        """How a named place was passed: at the row that came nearest to it in time."""
        planned, begun = mark.row * self._reference.interval, self._begun
        there = np.flatnonzero(places[begun:] >= mark.row - ROUNDING)
        if begun is None or not len(there):
            return Passed(mark.name, planned, None, None, None, off_curve(mark), moved=mark.target.moved)
        row = begun + int(there[0])
        if row > begun and mark.row - places[row - 1] < places[row] - mark.row:
            row -= 1
        placed = mark.target.placed
        off = np.linalg.norm((mark.target.points - points[row])[placed], axis=1)
        tip = None if mark.tip is None else tip_off(mark, self._reference.arm.at(q[row]))
        reached, error, moved = (row - begun) * dt, float(off.mean()), mark.target.moved
        return Passed(mark.name, planned, reached, row, error, off_curve(mark), tip, moved)


def off_curve(mark: Mark) -> float | None:
    """How far off its curve a named place is at most [m]; None if there is no curve."""
    residual = mark.target.residual
    return None if residual is None else float(residual[mark.target.placed].max())


def tip_off(mark: Mark, state: ArmState) -> float:
    """By how much the task of the tip of a named place is missed [m], turns by their lever."""
    assert mark.tip is not None
    return float(np.linalg.norm(mark.tip.rows(state, mark.target).error))
