"""What stands in a task file for the arm: as it was described, a template, or a URDF file beside it."""

from __future__ import annotations

import re
from collections.abc import Iterator
from pathlib import Path
from typing import Any, NamedTuple

import pinocchio as pin

from pinposture.arm import Arm
from pinposture.arm.description import read_description
from pinposture.arm.loading import load_model
from pinposture.arm.report import LoadReport
from pinposture.arm.template import TEMPLATES
from pinposture.arm.urdf import modules_to_urdf
from pinposture.errors import FileError, PostureError
from pinposture.storage import read_text
from pinposture.task.paths import settled
from pinposture.task.reading.arms import MOST_MODULES, read_arm
from pinposture.task.writing.holding import links_of_modules, locked_joints
from pinposture.task.writing.placements import write_placement
from pinposture.task.writing.same import same_arm
from pinposture.task.writing.wording import Wording, plain_in

_TEMPLATED = re.compile(r"(.+)_(\d{1,4})")


class WrittenArm(NamedTuple):
    """What stands in a task file for an arm, and what has to stand beside it.

    Attributes:
        table: its table.
        file: the URDF file beside it, if there has to be a new one.
        text: what that file holds.
    """

    table: dict[str, Any]
    file: Path | None = None
    text: str = ""


def write_arm(arm: Arm, wording: Wording) -> WrittenArm:
    """Describe an arm.

    Raises:
        FileError: it has no description, none that a file could hold, or its URDF file would take the place
            of another.
    """
    told = wording.told(arm, "arm", lambda table: read_arm(table.table("arm"), _load), same_arm)
    if told is not None:
        return WrittenArm(told)
    more: dict[str, Any] = {}
    placement = write_placement(arm.base_placement)
    if placement:
        more["placement"] = placement
    if arm.sliding_unit != float(arm.chain.module_lengths.mean()):
        more["sliding_unit"] = arm.sliding_unit
    template = _template(arm)
    if template is not None and _gives(template | more, arm, wording):
        return WrittenArm(template | more)
    return _beside(arm, more, wording)


def _template(arm: Arm) -> dict[str, Any] | None:
    """The template that an arm is made of, if it is one of `Arm.from_template`, with the lengths of links."""
    named = _TEMPLATED.fullmatch(str(arm.model.name))
    if named is None or named[1] not in TEMPLATES or not 1 <= int(named[2]) <= MOST_MODULES:
        return None
    module, count = TEMPLATES[named[1]], int(named[2])
    joints = len(module.joints)
    if arm.model.njoints != joints * count + 1:
        return None
    ends = [arm.model.jointPlacements[joint].translation[0] for joint in range(2, arm.model.njoints)]
    ends.append(arm.model.frames[arm.model.getFrameId(arm.control_points[-1])].placement.translation[0])
    lengths = [float(length) for length in ends[:joints]]
    try:
        module = module.with_lengths(lengths)
    except PostureError:
        return None
    if modules_to_urdf([module] * count, str(arm.model.name)) != arm.urdf:
        return None
    own = {} if module == TEMPLATES[named[1]] else {"link_lengths": lengths}
    return {"template": named[1], "modules": count, **own}


def _beside(arm: Arm, more: dict[str, Any], wording: Wording) -> WrittenArm:
    """The arm as a URDF file beside the task."""
    if arm.urdf is None or arm.report is None:
        reason = "it was made of a Pinocchio model and has no URDF; load it by Arm.from_urdf"
        raise FileError(wording.file, f"arm: no file can describe it: {reason}")
    file = wording.file.with_suffix(".urdf")
    for described in _described(arm, arm.report, file):
        table = plain_in(described | more, wording.folder)
        if _gives(table, arm, wording, arm.urdf):
            there = file.exists()
            if there and read_text(file) != arm.urdf:
                reason = "is there already, and holds something else than the arm of the task"
                raise FileError(file, f"{reason}; allowed: a name for the task beside which there is room")
            return WrittenArm(table) if there else WrittenArm(table, file, arm.urdf)
    reason = "its URDF does not lead to the same control points again; say how by `described`"
    raise FileError(wording.file, f"arm: no file can describe it: {reason}")


def _described(arm: Arm, report: LoadReport, file: Path) -> Iterator[dict[str, Any]]:
    """Descriptions that may give the arm again: modules by their joints, or by the links where they end."""
    assert arm.urdf is not None
    description = read_description(arm.urdf)
    described: dict[str, Any] = {"urdf": file}
    if report.base != description.root:
        described["base"] = report.base
    described["tip"] = report.tip
    sizes = list(report.segmentation.sizes)
    split = sizes[0] if len(set(sizes)) == 1 else sizes
    locked = locked_joints(arm, description, report.base, report.tip)
    rest: dict[str, Any] = {"locked": locked} if locked else {}
    folders = [Path(each) for each in report.package_dirs if settled(each) != settled(file.parent)]
    if folders:
        rest["package_dirs"] = folders
    yield described | {"split": split} | rest
    links = links_of_modules(arm)
    if links is not None:
        yield described | {"split": links} | rest


def _gives(table: dict[str, Any], arm: Arm, wording: Wording, text: str | None = None) -> bool:
    """Whether a description gives an arm back."""

    def load(path: Path, **given: Any) -> Arm:
        return _load(path if text is None else text, **given)

    try:
        return same_arm(read_arm(wording.table("arm", table).table("arm"), load), arm)
    except PostureError:
        return False


def _load(source: str | Path, **given: Any) -> Arm:
    """As `Arm.from_urdf`, without the warnings: they were told when the arm was made."""
    locked, placement = given.pop("locked") or {}, given.pop("base_placement") or pin.SE3.Identity()
    loaded = load_model(source, **given, locked=locked, base_placement=placement)
    return Arm(loaded.model, loaded.control_points, placement, loaded.text, loaded.report)
