"""What stands in a task file for limits, the controller, what surrounds the arm, and where it begins."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pinposture.arm import Arm
from pinposture.control import CONTROLLERS, ConstrainedQP, Controller, Limits
from pinposture.errors import FileError
from pinposture.scene import Mesh, Scene
from pinposture.scene.obstacles import Obstacle
from pinposture.task.reading.robots import UNLIMITED, read_obstacle, read_surroundings
from pinposture.task.reading.showing import shown
from pinposture.task.writing.wording import Wording

Array = NDArray[np.float64]


def write_limits(limits: Limits, arm: Arm) -> dict[str, Any]:
    """A table for the limits of each control cycle."""
    described: dict[str, Any] = {"cycle": limits.dt}
    for key in ("step", "velocity", "acceleration"):
        value = getattr(limits, key)
        if value is not None:
            described[key] = _limit(key, value, arm)
    if limits.position_margin:
        described["position_margin"] = limits.position_margin
    return described


def _limit(key: str, value: float | Array, arm: Arm) -> Any:
    """One number for all joints, one for those that turn and one for those that slide, or one for each."""
    if not isinstance(value, np.ndarray):
        return _bounded(value)
    both, rest = {}, arm.limits.velocity if key == "velocity" else np.full(arm.nv, np.inf)
    for kind, joints in (("turning", ~arm.slides), ("sliding", arm.slides)):
        own = np.unique(value[joints])
        if len(own) == 1 and np.isfinite(own[0]):
            both[kind] = float(own[0])
            rest = np.where(joints, own[0], rest)
    return both if both and np.array_equal(rest, value) else [_bounded(each) for each in value.tolist()]


def _bounded(value: float) -> float | str:
    return value if np.isfinite(value) else UNLIMITED


def write_controller(controller: Controller, wording: Wording) -> dict[str, Any]:
    """A table for the controller; an empty one for that which is taken if there is none.

    Raises:
        FileError: one whose parameters no file can say.
    """
    usual = ConstrainedQP()
    if isinstance(controller, ConstrainedQP):
        if replace(usual, haste=controller.haste, chord=controller.chord) == controller:
            own = {key: getattr(controller, key) for key in ("haste", "chord")}
            own = {key: value for key, value in own.items() if value != getattr(usual, key)}
            return {"name": "qp", **own} if own else {}
    else:
        for name, make in CONTROLLERS.items():
            if make() == controller:
                return {"name": name}
    reason = (
        f"no file can say all of {shown(controller)}; allowed: a name with its usual parameters, and haste"
    )
    raise FileError(wording.file, f"controller: {reason} and chord for 'qp'")


def write_scene(scene: Scene, wording: Wording) -> Any:
    """A table for the scene: the file that it came from, or what is in it."""
    told = wording.told(scene, "scene", lambda table: read_surroundings(table.table("scene"), wording.folder))
    if told is not None:
        return told
    described: dict[str, Any] = {"margin": scene.margin}
    if scene.self_collision:
        described["self_collision"] = True
    if scene.arm_radius is not None:
        described["arm_radius"] = scene.arm_radius
    if scene.obstacles:
        described["obstacles"] = {name: _obstacle(each, wording) for name, each in scene.obstacles.items()}
    return described


def _obstacle(obstacle: Obstacle, wording: Wording) -> Any:
    told = wording.told(
        obstacle, "obstacle", lambda table: read_obstacle(table.table("obstacle"), wording.folder)
    )
    if told is not None:
        return told
    described = obstacle.to_dict()
    if described.get("rotation") == np.eye(3).tolist():
        del described["rotation"]
    if isinstance(obstacle, Mesh) and not any(obstacle.center):
        del described["center"]
    return described


def write_start(start: Array, arm: Arm) -> dict[str, Any]:
    """A table for the configuration to start from."""
    if np.array_equal(start, arm.straight()):
        return {"posture": "straight"}
    if np.array_equal(start, arm.neutral()):
        return {"posture": "neutral"}
    return {"joints": arm.positions(start)}
