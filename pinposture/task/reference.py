"""The motion that a task asks for, in time, and how well the arm can take its postures."""

from __future__ import annotations

import warnings
from dataclasses import dataclass
from functools import cached_property
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from pinposture.arm import Arm, ArmState
from pinposture.collision import CollisionModel, Scene
from pinposture.control import EndEffector
from pinposture.errors import InvalidValue, PostureWarning, TaskError
from pinposture.placement import Target
from pinposture.placement.curve_placement import Moved

Array = NDArray[np.float64]


class Mark(NamedTuple):
    """A named place of a reference.

    Attributes:
        name: its name.
        row: its row in the reference.
        target: the target of the arm there, which replaces that of the reference in this row. Its residual is
            its distance from the curve.
        tip: the task of the tip there; None if there is none.
    """

    name: str
    row: int
    target: Target
    tip: EndEffector | None = None


@dataclass(frozen=True, eq=False)
class Reference:
    """Target postures at equal distances in time, and a configuration that takes each.

    It begins and ends at rest. Rows are close enough to each other to be joined smoothly.

    Attributes:
        arm: the arm.
        interval: time from one row to the next, if nothing slows the motion [s].
        start: the configuration of the first row, (nq,).
        offsets: joint displacement of each row from the first, in the direction in which the arm turns,
            (N + 1, nv) [rad or m]; the first is zero.
        weights: whether each control point has a target, as in `Target`, (N + 1, m).
        marks: rows with a name, in order; keyframes have one each.
    """

    arm: Arm
    interval: float
    start: Array
    offsets: Array
    weights: Array
    marks: tuple[Mark, ...] = ()

    def __post_init__(self) -> None:
        rows, arm = len(self.offsets), self.arm
        if self.offsets.shape != (rows, arm.nv) or rows < 2:
            raise InvalidValue("offsets (shape)", self.offsets.shape, f"(2 or more, {arm.nv})")
        if self.weights.shape != (rows, arm.n_modules):
            raise InvalidValue("weights (shape)", self.weights.shape, f"({rows}, {arm.n_modules})")
        if not np.all(np.isfinite(self.offsets)):
            raise InvalidValue("offsets", self.offsets, "finite numbers")

    @property
    def rows(self) -> int:
        """Number of rows, N + 1."""
        return len(self.offsets)

    @property
    def duration(self) -> float:
        """Duration if nothing slows the motion [s]."""
        return self.interval * (self.rows - 1)

    @cached_property
    def times(self) -> Array:
        """Time of each row if nothing slows the motion, (N + 1,) [s]."""
        return np.asarray(self.interval * np.arange(self.rows, dtype=np.float64))

    def configuration(self, row: int) -> Array:
        """Return the configuration of a row, (nq,)."""
        return self.arm.integrate(self.start, self.offsets[row])


def off_curve(mark: Mark) -> float | None:
    """Return the largest distance of a named place from its curve [m]; None if there is no curve."""
    residual = mark.target.residual
    return None if residual is None else float(residual[mark.target.has_target].max())


def tip_off(tip: EndEffector | None, target: Target, state: ArmState) -> float | None:
    """Return the error of the task of the tip [m], turns by their lever; None without a task."""
    return None if tip is None else float(np.linalg.norm(tip.rows(state, target).error))


# How well the arm can take its postures, known before it moves.


class Outlook(NamedTuple):
    """How well the arm can take a posture.

    Attributes:
        name: name of the posture.
        planned: its planned time [s].
        off_curve: largest distance of a target from its curve [m]; None if there is no curve.
        tip_off: error of the task of the tip [m]; None if there is none.
        clearance: smallest distance to an obstacle [m], negative inside of it; None without a scene.
        moved: how its curve was moved from where it was drawn; None if there is no curve.
    """

    name: str
    planned: float
    off_curve: float | None
    tip_off: float | None
    clearance: float | None
    moved: Moved | None


def outlook(reference: Reference, scene: Scene | None) -> list[Outlook]:
    """Tell how well the arm can take the named postures of a reference, and the first.

    Args:
        reference: the reference.
        scene: what the arm has to keep clear of; clearances are those of these postures only.
    """
    arm, found = reference.arm, []
    clearance = None if scene is None else CollisionModel(arm, scene)
    for mark in _named(reference):
        q = reference.configuration(mark.row)
        room = None if clearance is None else clearance.minimum(q).distance
        tip = tip_off(mark.tip, mark.target, arm.at(q))
        planned, moved = mark.row * reference.interval, mark.target.moved
        found.append(Outlook(mark.name, planned, off_curve(mark), tip, room, moved))
    return found


def require_room(reference: Reference, scene: Scene | None) -> None:
    """Refuse a motion that begins inside of an obstacle; warn of named postures that are.

    Raises:
        TaskError: it does.
    """
    if scene is None:
        return
    clearance = CollisionModel(reference.arm, scene)
    keyed = bool(reference.marks) and reference.marks[0].row == 0
    for number, mark in enumerate(_named(reference), start=1):
        closest = clearance.minimum(reference.configuration(mark.row))
        if closest.distance >= 0.0:
            continue
        where = f"keyframe {number} {mark.name!r}" if keyed else mark.name
        pair, deep = " and ".join(closest.pair or ()), -1e3 * closest.distance
        depth = f"{pair} would be {deep:.3g} mm inside each other"
        if mark.row == 0:
            raise TaskError(where, f"{depth}; move one of them, or begin elsewhere")
        warnings.warn(f"{where}: {depth}", PostureWarning, stacklevel=4)


def _named(reference: Reference) -> list[Mark]:
    """Return the named places of a reference, and its beginning if that has no name."""
    marks = list(reference.marks)
    if not marks or marks[0].row > 0:
        marks.insert(0, Mark("the beginning", 0, Target.from_configuration(reference.arm, reference.start)))
    return marks
