"""What can be said of a motion before anything moves: how well the arm can take its postures."""

from __future__ import annotations

import warnings
from typing import NamedTuple

from pinposture.errors import PostureWarning, TaskError
from pinposture.scene import Scene
from pinposture.target import Target
from pinposture.target.placement import Moved
from pinposture.task.log import off_curve, tip_off
from pinposture.task.reference import Mark, Reference


class Outlook(NamedTuple):
    """How well the arm can take a posture.

    Attributes:
        name: of the posture.
        planned: when it is to be there [s].
        off_curve: how far off its curve control points belong at most [m]; None if there is no curve.
        tip_off: by how much the task of the tip is missed [m]; None if there is none.
        clearance: smallest distance to something [m], negative inside of it; None without a scene.
        moved: how its curve was moved from where it was drawn; None if there is no curve.
    """

    name: str
    planned: float
    off_curve: float | None
    tip_off: float | None
    clearance: float | None
    moved: Moved | None


def outlook(reference: Reference, scene: Scene | None) -> list[Outlook]:
    """How well the arm can take the named postures of a reference, and the first.

    Args:
        reference: the reference.
        scene: what the arm has to keep clear of; it is looked at in these postures only.
    """
    arm, found = reference.arm, []
    clearance = None if scene is None else scene.around(arm)
    for mark in _named(reference):
        q = reference.configuration(mark.row)
        room = None if clearance is None else clearance.minimum(q).distance
        tip = None if mark.tip is None else tip_off(mark, arm.at(q))
        planned, moved = mark.row * reference.interval, mark.target.moved
        found.append(Outlook(mark.name, planned, off_curve(mark), tip, room, moved))
    return found


def require_room(reference: Reference, scene: Scene | None) -> None:
    """Refuse a motion that begins inside of something; warn of named postures that are.

    Raises:
        TaskError: it does.
    """
    if scene is None:
        return
    clearance = scene.around(reference.arm)
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
    """The named places of a reference, and its beginning if that has no name."""
    marks = list(reference.marks)
    if not marks or marks[0].row > 0:
        marks.insert(0, Mark("the beginning", 0, Target.from_configuration(reference.arm, reference.start)))
    return marks
