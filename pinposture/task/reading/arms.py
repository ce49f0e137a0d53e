"""What a task file says of the arm: a URDF file, or modules of a template, and where it stands."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import pinocchio as pin

from pinposture.arm import Arm, JointSpec, ModuleTemplate, template
from pinposture.errors import InvalidValue, PostureError, UnknownName
from pinposture.task.reading.document import Table
from pinposture.task.reading.showing import shown

_DESCRIBED = ("urdf", "base", "tip", "split", "locked", "package_dirs")
_TEMPLATED = ("template", "modules", "link_lengths", "joint_limits", "feed")
_FEED = {"length": "length", "stroke": "length", "speed": "speed"}
_PLACEMENT = {"position": "length", "rotation": "angle"}
_QUANTITIES = {"link_lengths": "length", "joint_limits": "angle", "sliding_unit": "length"}

MOST_MODULES = 1000
"""The longest arm."""


def read_arm(table: Table, load: Callable[..., Arm] = Arm.from_urdf) -> Arm:
    """The arm: from a URDF file, or of modules of a template, perhaps on a feed.

    Args:
        table: what the file says of it.
        load: what makes an arm of a URDF file, called as `Arm.from_urdf`.
    """
    table.only(*_DESCRIBED, *_TEMPLATED, "placement", "sliding_unit")
    kind, other = (_DESCRIBED, _TEMPLATED) if "urdf" in table else (_TEMPLATED, _DESCRIBED)
    for key in other:
        if key in table:
            raise table.fault(key, f"does not go with {kind[0]!r}")
    placement = read_placement(table.table("placement")) if "placement" in table else None
    if "urdf" in table:
        arm = _described(table, placement, load)
    elif "template" in table:
        arm = _templated(table, placement)
    else:
        raise table.fault(None, "needs one of the keys 'urdf', 'template'")
    unit = table.above_zero("sliding_unit", "length", default=None)
    return table.says(arm if unit is None else arm.with_sliding_unit(unit), _in_si(table))


def _templated(table: Table, placement: pin.SE3 | None) -> Arm:
    """The arm of equal modules, called as `Arm.from_template` calls it."""
    name = table.text("template")
    with table.blaming("template"):
        module = template(name)
    if "link_lengths" in table:
        lengths = table.quantities("link_lengths", ["length"] * len(module.joints))
        with table.blaming("link_lengths"):
            module = module.with_lengths(lengths)
    if "joint_limits" in table:
        lower, upper = table.quantities("joint_limits", ["angle"] * 2)
        with table.blaming("joint_limits"):
            module = module.with_limits(lower, upper)
    count = table.whole("modules", 1, MOST_MODULES)
    modules = [module] * count
    if "feed" in table:
        modules.insert(0, _feed(table.table("feed"), module))
    with table.blaming():
        return Arm.from_modules(modules, base_placement=placement, name=f"{name}_{count}")


def _described(table: Table, placement: pin.SE3 | None, load: Callable[..., Arm]) -> Arm:
    """The arm of a URDF file, with what `Arm.from_urdf` takes besides."""
    given: dict[str, Any] = {"base": table.text("base", None), "tip": table.text("tip", None)}
    folders = table.value("package_dirs", None)
    if folders is not None:
        if not isinstance(folders, list) or not all(isinstance(each, str) for each in folders):
            raise table.fault("package_dirs", f"is {shown(folders)}; allowed: a list of folders")
        folders = [table.place("package_dirs", each) for each in folders]
    given |= {"modules": table.value("split", None), "locked": _locked(table), "package_dirs": folders}
    path = table.path("urdf", table.text("urdf"))
    try:
        return load(path, **given, base_placement=placement)
    except PostureError as error:
        key, reason = _named_by(error, table), str(error)
        if key == "split" and isinstance(error, InvalidValue):
            reason = f"is {shown(error.value)}; allowed: {error.allowed}"
        raise table.fault(key, reason) from error


def _locked(table: Table) -> dict[str, float]:
    held = table.table("locked")
    return {name: held.quantity(name, "angle", "length") for name in held.plain()}


def _named_by(error: PostureError, table: Table) -> str:
    """The key that an error of `Arm.from_urdf` is about."""
    if isinstance(error, InvalidValue) and error.name.startswith("modules"):
        return "split"
    if isinstance(error, UnknownName):
        for key in ("base", "tip", "split", "locked"):
            value = table.value(key, None)
            if error.name == value or (isinstance(value, list | dict) and error.name in value):
                return key
    return "urdf"


def _feed(table: Table, module: ModuleTemplate) -> ModuleTemplate:
    """A slide along the axis of the arm, with the link that it pushes."""
    table.only(*_FEED)
    stroke = table.above_zero("stroke", "length")
    length = table.quantity("length", "length", default=module.length)
    speed = table.above_zero("speed", "speed", default=0.1)
    with table.blaming():
        slide = JointSpec("x", "prismatic", 0.0, stroke, velocity=speed)
        return ModuleTemplate("Feed", (slide,), (length,), module.radius)


def read_placement(table: Table) -> pin.SE3:
    """A placement in the world: a position, and roll, pitch and yaw."""
    table.only(*_PLACEMENT)
    position = table.quantities("position", ["length"] * 3, default=[0.0, 0.0, 0.0])
    angles = table.quantities("rotation", ["angle"] * 3, default=[0.0, 0.0, 0.0])
    return pin.SE3(pin.rpy.rpyToMatrix(*angles), np.array(position))


def placement_in_si(table: Table) -> dict[str, Any]:
    """What a table with a placement holds, in SI units."""
    return table.in_si(_PLACEMENT)


def _in_si(table: Table) -> dict[str, Any]:
    """The description as it is, in SI units and with absolute paths."""
    plain = table.in_si(_QUANTITIES)
    if "placement" in table:
        plain["placement"] = placement_in_si(table.table("placement"))
    if "feed" in table:
        plain["feed"] = table.table("feed").in_si(_FEED)
    if "locked" in table:
        plain["locked"] = _locked(table)
    if "urdf" in table:
        plain["urdf"] = table.place("urdf", table.text("urdf"))
    if "package_dirs" in table:
        plain["package_dirs"] = [table.place("package_dirs", each) for each in table.value("package_dirs")]
    return plain
