"""What a task file says of an arm's limits, its controller, what surrounds it, and where it begins."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from types import MappingProxyType
from typing import Any, cast

import numpy as np
from numpy.typing import NDArray

from pinposture.arm import Arm
from pinposture.control import CONTROLLERS, ConstrainedQP, Controller, Limits, controller_named
from pinposture.scene import Scene
from pinposture.scene.obstacles import Obstacle, obstacle_from_dict
from pinposture.task.checks import LONGEST_CYCLE
from pinposture.task.paths import settled
from pinposture.task.perform import CYCLE
from pinposture.task.reading.document import Table
from pinposture.task.reading.showing import shown

Array = NDArray[np.float64]

_SCENE = ("version", "obstacles", "self_collision", "margin", "arm_radius")
_QUANTITIES = dict.fromkeys(
    ("margin", "arm_radius", "radius", "center", "size", "start", "end", "point"), "length"
) | {"rotation": "angle"}

UNLIMITED = "none"
"""What stands in a file for a limit that does not exist."""

_NO_LIMIT = MappingProxyType({UNLIMITED: np.inf})


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
    if value == UNLIMITED:
        return np.inf
    if isinstance(value, list):
        kinds = [sliding if slides else turning for slides in arm.slides]
        return np.array(table.quantities(key, kinds, words=_NO_LIMIT))
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
        scene = table.file("file", Scene.load)
        return table.says(scene, {"file": table.place("file", table.text("file"))})
    if not table.plain():
        return None
    table.only("file", *_SCENE)
    listed = table.table("obstacles")
    obstacles = {name: read_obstacle(listed.table(name), folder) for name in listed.plain()}
    plain = table.in_si(_QUANTITIES) | {"obstacles": {}}
    with table.blaming():
        return replace(Scene.from_dict(plain), obstacles=obstacles)


def read_obstacle(table: Table, folder: Path) -> Obstacle:
    """An obstacle of the scene; the path of a mesh begins in the folder."""
    plain = table.in_si(_QUANTITIES)
    with table.blaming():
        obstacle = obstacle_from_dict(plain, str(folder))
    if "path" in plain:
        plain["path"] = settled(folder / plain["path"])
    return table.says(obstacle, plain)


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
