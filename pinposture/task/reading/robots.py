"""What a task file says of the robot: the arm, its limits, its controller, where it begins."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pinocchio as pin
from numpy.typing import NDArray

from pinposture.arm import Arm, JointSpec, ModuleTemplate, template
from pinposture.control import CONTROLLERS, ConstrainedQP, Controller, Limits, controller_named
from pinposture.scene import Scene
from pinposture.task.perform import CYCLE
from pinposture.task.reading.document import Table

Array = NDArray[np.float64]

_DESCRIBED = ("urdf", "base", "tip", "split", "locked", "package_dirs")
_TEMPLATED = ("template", "modules", "link_lengths", "joint_limits", "feed")
_FEED = ("length", "stroke", "speed")


def read_arm(table: Table) -> Arm:
    """The arm: from a URDF file, or of modules of a template, perhaps on a feed."""
    table.only(*_DESCRIBED, *_TEMPLATED, "placement")
    kind, other = (_DESCRIBED, _TEMPLATED) if "urdf" in table else (_TEMPLATED, _DESCRIBED)
    for key in other:
        if key in table:
            raise table.fault(key, f"does not go with {kind[0]!r}")
    placement = read_placement(table.table("placement")) if "placement" in table else None
    if "urdf" in table:
        given = {key: table.value(key, None) for key in ("base", "tip", "locked", "package_dirs")}

        def load(path: Path) -> Arm:
            return Arm.from_urdf(path, **given, modules=table.value("split", None), base_placement=placement)

        return table.file("urdf", load)
    if "template" not in table:
        raise table.fault(None, "needs one of the keys 'urdf', 'template'")
    with table.blaming("template"):
        module = template(table.text("template"))
    if "link_lengths" in table:
        with table.blaming("link_lengths"):
            module = module.with_lengths(table.quantities("link_lengths", len(module.joints), "length"))
    if "joint_limits" in table:
        with table.blaming("joint_limits"):
            module = module.with_limits(*table.quantities("joint_limits", 2, "angle"))
    count = table.whole("modules")
    if not 1 <= count <= 1000:
        raise table.fault("modules", f"is {count}; allowed: 1 to 1000")
    modules = [module] * count
    if "feed" in table:
        modules.insert(0, _feed(table.table("feed"), module))
    with table.blaming():
        return Arm.from_modules(modules, base_placement=placement, name=module.name)


def _feed(table: Table, module: ModuleTemplate) -> ModuleTemplate:
    """A slide along the axis of the arm, with the link that it pushes."""
    table.only(*_FEED)
    stroke = table.quantity("stroke", "length")
    length = table.quantity("length", "length", default=module.length)
    with table.blaming():
        slide = JointSpec(
            "x", "prismatic", 0.0, stroke, velocity=table.quantity("speed", "speed", default=0.1)
        )
        return ModuleTemplate("Feed", (slide,), (length,), module.radius)


def read_placement(table: Table) -> pin.SE3:
    """A placement in the world: a position, and roll, pitch and yaw."""
    table.only("position", "rotation")
    position = table.quantities("position", 3, "length", default=[0.0, 0.0, 0.0])
    angles = table.quantities("rotation", 3, "angle", default=[0.0, 0.0, 0.0])
    return pin.SE3(pin.rpy.rpyToMatrix(*angles), np.array(position))


def read_limits(table: Table, arm: Arm) -> Limits:
    """The limits of each control cycle."""
    table.only("cycle", "step", "velocity", "acceleration", "position_margin")
    values: dict[str, Any] = {
        "dt": table.quantity("cycle", "time", default=CYCLE),
        "step": table.quantity("step", "angle", default=None),
        "position_margin": table.quantity("position_margin", "angle", default=0.0),
        "velocity": _for_joints(table, "velocity", arm, "rate of turning", "speed"),
        "acceleration": _for_joints(table, "acceleration", arm, "rate of change of turning", "acceleration"),
    }
    with table.blaming():
        limits = Limits(**values)
        limits.for_arm(arm)
    return limits


def _for_joints(table: Table, key: str, arm: Arm, turning: str, sliding: str) -> float | Array | None:
    """A limit for all joints, for those that turn and those that slide, or one for each."""
    value = table.value(key, None)
    if value is None:
        return None
    if isinstance(value, list):
        return np.array(table.quantities(key, arm.nv, turning, sliding))
    if not isinstance(value, dict):
        if isinstance(value, str) and np.any(arm.slides):
            reason = f"is {value!r}, and the arm turns and slides; allowed: a table with both"
            raise table.fault(key, f"{reason}, as in {{turning = ..., sliding = ...}}")
        return float(table.quantity(key, turning))
    both = table.table(key).only("turning", "sliding")
    limit = np.full(arm.nv, np.inf)
    for name, kind, joints in (("turning", turning, ~arm.slides), ("sliding", sliding, arm.slides)):
        if name in both:
            limit[joints] = both.quantity(name, kind)
    if key == "velocity":  # what is not said is as the description has it
        limit = np.where(np.isinf(limit), arm.limits.velocity, limit)
    return limit


def read_controller(table: Table) -> Controller:
    """The controller, by name, with what only the qp knows."""
    table.only("name", "haste", "chord")
    name = table.text("name", "qp", tuple(CONTROLLERS))
    controller = controller_named(name)
    for key in ("haste", "chord"):
        if key in table:
            if not isinstance(controller, ConstrainedQP):
                raise table.fault(key, f"is for the controller 'qp'; it is {name!r}")
            with table.blaming(key):
                controller = replace(controller, **{key: table.number(key)})
    return controller


def read_surroundings(table: Table, folder: Path) -> Scene | None:
    """The scene: a file of its own, or what would be in it."""
    if "file" in table:
        table.only("file")
        return table.file("file", Scene.load)
    if not table.plain():
        return None
    with table.blaming():
        return Scene.from_dict(table.plain(), str(folder))


def read_start(table: Table, arm: Arm) -> Array | None:
    """The configuration to start from; None for where the motion begins."""
    table.only("posture", "joints")
    if "joints" in table:
        angles = table.quantities("joints", arm.nv, "angle", "length")
        with table.blaming("joints"):
            return arm.configuration(angles)
    if table.text("posture", None, ("straight", "neutral")) is None:
        return None
    return arm.straight() if table.text("posture") == "straight" else arm.neutral()
