"""A whole task file: which tables it may have, and the parts of a task that they describe."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from pinposture.arm import Arm
from pinposture.task.checks import FORMATS, around_base, where_base_is
from pinposture.task.keyframe import usual_placement
from pinposture.task.leader import Leader
from pinposture.task.reading.arms import read_arm
from pinposture.task.reading.document import Document, Table
from pinposture.task.reading.motions import check_path, check_points, read_keyframes, read_leader
from pinposture.task.reading.robots import read_controller, read_limits, read_start, read_surroundings
from pinposture.task.reading.showing import shown
from pinposture.task.schedule import CONTINUITIES

VERSION = 1
KINDS = ("keyframes", "follow_leader")

_COMMON = ("version", "kind", "name", "arm", "limits", "controller", "scene", "start", "output", "editor")
_OWN = {"keyframes": ("keyframes", "continuity"), "follow_leader": ("leader",)}


def read_task(document: Document, arm: Arm | None = None) -> dict[str, Any]:
    """The parts of a task, by the names that `Task` has for them.

    Args:
        document: the file.
        arm: the arm, if what the file says of it is not to be read.

    Raises:
        FileError: what the file says cannot be; names the line, the key, the value and what is allowed.
    """
    root = document.root
    if "version" in root and (root.value("version") is True or root.value("version") != VERSION):
        raise root.fault("version", f"is {shown(root.value('version'))}; allowed: {VERSION}")
    kind = root.text("kind", "keyframes", KINDS)
    for other in KINDS:
        for key in _OWN[other]:
            if key in root and kind != other:
                raise root.fault(key, f"goes with kind = {other!r}; the kind is {kind!r}")
    root.only(*_COMMON, *_OWN[kind])
    arm = read_arm(root.table("arm")) if arm is None else arm
    scene = read_surroundings(root.table("scene"), document.path.parent)
    usual, motion = usual_placement(scene), None
    if kind == "follow_leader":
        motion = read_leader(root.table("leader"), usual)
    parts = {
        "arm": arm,
        "motion": read_keyframes(root.tables("keyframes"), usual, arm) if motion is None else motion,
        "limits": read_limits(root.table("limits"), arm),
        "controller": read_controller(root.table("controller")),
        "scene": scene,
        "start": read_start(root.table("start"), arm),
        "continuity": root.text("continuity", "velocity", CONTINUITIES),
        "formats": _formats(root.table("output")),
        "name": root.text("name", document.path.stem),
        "scans": _scans(root.table("editor")),
        "described": document.described,
    }
    _check(root, parts)
    return parts


def _check(root: Table, parts: dict[str, Any]) -> None:
    """Refuse what can be seen to be wrong without a search."""
    arm, motion, scene = parts["arm"], parts["motion"], parts["scene"]
    if isinstance(motion, Leader):
        check_path(root.table("leader"), motion, arm)
    else:
        if len(motion) < 2:
            found = "none" if not motion else "only one"
            reason = f"there is {found}; allowed: two or more, each begun by [[keyframes]]"
            raise root.fault("keyframes", reason)
        for keyframe, table in zip(motion, root.tables("keyframes"), strict=True):
            check_points(table, keyframe, arm)
    for name in around_base(scene, arm):
        raise root.table("scene").table("obstacles").fault(name, where_base_is(arm))


def _formats(table: Table) -> tuple[str, ...]:
    table.only("formats")
    listed = table.value("formats", list(FORMATS))
    if not isinstance(listed, list) or not all(each in FORMATS for each in listed):
        raise table.fault("formats", f"is {shown(listed)}; allowed: a list of {', '.join(FORMATS)}")
    return tuple(each for each in FORMATS if each in listed)


def _scans(table: Table) -> tuple[Path, ...]:
    """Files that the editor shows; whether they are there is its business."""
    table.only("scans")
    listed = table.value("scans", [])
    if not isinstance(listed, list):
        raise table.fault("scans", f"is {shown(listed)}; allowed: a list of files")
    for number, name in enumerate(listed):
        if not isinstance(name, str) or not name.strip() or "\0" in name:
            raise table.fault("scans", f"is {shown(name)}; allowed: the name of a file", number)
    return tuple(table.place("scans", name) for name in listed)
