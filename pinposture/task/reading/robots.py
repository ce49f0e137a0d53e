"""What a task file says of the robot: the arm, its limits, its controller, where it begins."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any, cast

import numpy as np
import pinocchio as pin
from numpy.typing import NDArray

from pinposture.arm import Arm, JointSpec, ModuleTemplate, template
from pinposture.control import CONTROLLERS, ConstrainedQP, Controller, Limits, controller_named
from pinposture.errors import InvalidValue, PostureError, UnknownName
from pinposture.scene import Scene
from pinposture.scene.obstacles import obstacle_from_dict
from pinposture.task.perform import CYCLE
from pinposture.task.reading.document import Table
from pinposture.task.reading.showing import shown

Array = NDArray[np.float64]

_DESCRIBED = ("urdf", "base", "tip", "split", "locked", "package_dirs")
_TEMPLATED = ("template", "modules", "link_lengths", "joint_limits", "feed")
_FEED = ("length", "stroke", "speed")
_SCENE = ("version", "obstacles", "self_collision", "margin", "arm_radius")
_QUANTITIES = dict.fromkeys(
    ("margin", "arm_radius", "radius", "center", "size", "start", "end", "point"), "length"
) | {"rotation": "angle"}

MOST_MODULES = 1000
"""The longest arm."""

LONGEST_CYCLE = 60.0
"""The longest control cycle [s]."""


def read_arm(table: Table) -> Arm:
    """The arm: from a URDF file, or of modules of a template, perhaps on a feed."""
    table.only(*_DESCRIBED, *_TEMPLATED, "placement")
    kind, other = (_DESCRIBED, _TEMPLATED) if "urdf" in table else (_TEMPLATED, _DESCRIBED)
    for key in other:
        if key in table:
            raise table.fault(key, f"does not go with {kind[0]!r}")
    placement = read_placement(table.table("placement")) if "placement" in table else None
    if "urdf" in table:
        return _described(table, placement)
    if "template" not in table:
        raise table.fault(None, "needs one of the keys 'urdf', 'template'")
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
    modules = [module] * table.whole("modules", 1, MOST_MODULES)
    if "feed" in table:
        modules.insert(0, _feed(table.table("feed"), module))
    with table.blaming():
        return Arm.from_modules(modules, base_placement=placement, name=module.name)


def _described(table: Table, placement: pin.SE3 | None) -> Arm:
    """The arm of a URDF file, with what `Arm.from_urdf` takes besides."""
    given: dict[str, Any] = {"base": table.text("base", None), "tip": table.text("tip", None)}
    folders = table.value("package_dirs", None)
    if folders is not None:
        if not isinstance(folders, list) or not all(isinstance(each, str) for each in folders):
            raise table.fault("package_dirs", f"is {shown(folders)}; allowed: a list of folders")
        folders = [table.path("package_dirs", each) for each in folders]
    held = table.table("locked")
    locked = {name: held.quantity(name, "angle", "length") for name in held.plain()}
    given |= {"modules": table.value("split", None), "locked": locked, "package_dirs": folders}
    path = table.path("urdf", table.text("urdf"))
    try:
        return Arm.from_urdf(path, **given, base_placement=placement)
    except PostureError as error:
        key, reason = _named_by(error, table), str(error)
        if key == "split" and isinstance(error, InvalidValue):
            reason = f"is {shown(error.value)}; allowed: {error.allowed}"
        raise table.fault(key, reason) from error


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
    table.only("position", "rotation")
    position = table.quantities("position", ["length"] * 3, default=[0.0, 0.0, 0.0])
    angles = table.quantities("rotation", ["angle"] * 3, default=[0.0, 0.0, 0.0])
    return pin.SE3(pin.rpy.rpyToMatrix(*angles), np.array(position))


def read_limits(table: Table, arm: Arm) -> Limits:
    """The limits of each control cycle."""
    table.only("cycle", "step", "velocity", "acceleration", "position_margin")
    cycle = table.above_zero("cycle", "time", default=CYCLE)
    if cycle > LONGEST_CYCLE:
        raise table.fault("cycle", f"is {shown(table.value('cycle'))}; allowed: {LONGEST_CYCLE:g} s at most")
    values: dict[str, Any] = {
        "dt": cycle,
        "step": _for_joints(table, "step", arm, "angle", "length"),
        "position_margin": _for_all(table, "position_margin", arm, "a number, for all") or 0.0,
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
    if isinstance(value, list):
        return np.array(table.quantities(key, [sliding if slides else turning for slides in arm.slides]))
    if not isinstance(value, dict):
        both = "a table with both, as in {turning = ..., sliding = ...}"
        return _for_all(table, key, arm, both, turning, sliding)
    given = table.table(key).only("turning", "sliding")
    limit = np.full(arm.nv, np.inf)
    for name, kind, joints in (("turning", turning, ~arm.slides), ("sliding", sliding, arm.slides)):
        if name in given:
            limit[joints] = given.above_zero(name, kind)
    if key == "velocity":  # what is not said is as the description has it
        limit = np.where(np.isinf(limit), arm.limits.velocity, limit)
    return limit


def _for_all(
    table: Table, key: str, arm: Arm, allowed: str, turning: str = "angle", sliding: str = "length"
) -> float | None:
    """One number for all joints; with a unit only if all of them turn or all of them slide."""
    value = table.value(key, None)
    if isinstance(value, str) and np.any(arm.slides) and not np.all(arm.slides):
        raise table.fault(key, f"is {shown(value)}, and the arm turns and slides; allowed: {allowed}")
    kind = sliding if np.all(arm.slides) else turning
    return cast("float | None", table.quantity(key, kind, default=None))


def read_controller(table: Table) -> Controller:
    """The controller, by name, with what only the qp knows."""
    table.only("name", "haste", "chord")
    name = table.text("name", "qp", tuple(CONTROLLERS))
    controller = controller_named(name)
    for key in ("haste", "chord"):
        if key in table:
            if not isinstance(controller, ConstrainedQP):
                raise table.fault(key, f"is for the controller 'qp'; it is {name!r}")
            number = table.number(key)
            with table.blaming(key):
                controller = replace(controller, **{key: number})
    return controller


def read_surroundings(table: Table, folder: Path) -> Scene | None:
    """The scene: a file of its own, or what would be in it."""
    if "file" in table:
        table.only("file")
        return table.file("file", Scene.load)
    if not table.plain():
        return None
    table.only("file", *_SCENE)
    obstacles, listed = {}, table.table("obstacles")
    for name in listed.plain():
        plain = listed.table(name).in_si(_QUANTITIES)
        with listed.table(name).blaming():
            obstacles[name] = obstacle_from_dict(plain, str(folder))
    plain = table.in_si(_QUANTITIES) | {"obstacles": {}}
    with table.blaming():
        return replace(Scene.from_dict(plain), obstacles=obstacles)


def read_start(table: Table, arm: Arm) -> Array | None:
    """The configuration to start from; None for where the motion begins."""
    table.only("posture", "joints")
    if "joints" in table:
        if "posture" in table:
            raise table.fault("posture", "does not go with 'joints'")
        places = table.quantities("joints", ["length" if slides else "angle" for slides in arm.slides])
        with table.blaming("joints"):
            return arm.configuration(places)
    posture = table.text("posture", None, ("straight", "neutral"))
    if posture is None:
        return None
    return arm.straight() if posture == "straight" else arm.neutral()
