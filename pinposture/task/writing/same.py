"""Whether what was read back from a file is what was written."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from typing import TYPE_CHECKING, Any

import numpy as np
import pinocchio as pin
from numpy.typing import NDArray

from pinposture.arm import Arm
from pinposture.task.keyframe import Keyframe
from pinposture.task.leader import Leader

if TYPE_CHECKING:
    from pinposture.task.task import Task

Array = NDArray[np.float64]

CLOSE = 1e-12
"""How far what angles say in a file may be apart: rotations do not survive them to the last bit."""


def same_arm(one: Arm, other: Arm) -> bool:
    """Whether two arms have the same joints, limits, inertias and control points, and stand in one place."""
    a, b = one.model, other.model
    names = [(arm.model.name, arm.nq, arm.joint_names, arm.control_points) for arm in (one, other)]
    if names[0] != names[1]:
        return False
    limits = zip((*one.limits, a.effortLimit), (*other.limits, b.effortLimit), strict=True)
    if not all(map(np.array_equal, *zip(*limits, strict=True))):
        return False
    numbers = zip(_numbers(one), _numbers(other), strict=True)
    return all(_close(x, y) for x, y in numbers)


def _numbers(arm: Arm) -> tuple[Array, ...]:
    model = arm.model
    frames = [model.frames[model.getFrameId(name)] for name in arm.control_points]
    placements = [
        *list(model.jointPlacements)[1:],
        *(frame.placement for frame in frames),
        arm.base_placement,
    ]
    return (
        np.array([placement.homogeneous for placement in placements]),
        np.array([frame.parentJoint for frame in frames]),
        np.array([inertia.toDynamicParameters() for inertia in model.inertias]),
        arm.chain.axes,
        np.array([arm.sliding_unit]),
    )


def differences(task: Task, parts: Mapping[str, Any]) -> list[str]:
    """Names of the attributes in which a task differs from what was read, arm and descriptions aside."""
    tests = {
        "motion": _same_motion(task.motion, parts["motion"]),
        "start": _same_start(task.start, parts["start"]),
    }
    plain = ("limits", "controller", "scene", "continuity", "formats", "name", "scans")
    tests |= {key: getattr(task, key) == parts[key] for key in plain}
    return [key for key, same in tests.items() if not same]


def _same_motion(one: tuple[Keyframe, ...] | Leader, other: tuple[Keyframe, ...] | Leader) -> bool:
    if isinstance(one, Leader) or isinstance(other, Leader):
        return one == other
    return len(one) == len(other) and all(map(_same_keyframe, one, other))


def _same_keyframe(one: Keyframe, other: Keyframe) -> bool:
    mine, its = one.tip, other.tip
    if mine is None or its is None or mine.pose is None or its.pose is None:
        return one == other
    still = pin.SE3.Identity()
    given = replace(mine, pose=still) == replace(its, pose=still)
    return given and _close(mine.pose, its.pose) and replace(one, tip=None) == replace(other, tip=None)


def _same_start(one: Array | None, other: Array | None) -> bool:
    if one is None or other is None:
        return one is other
    return _close(one, other)


def _close(one: Array, other: Array) -> bool:
    return one.shape == other.shape and bool(np.allclose(one, other, rtol=CLOSE, atol=CLOSE))
