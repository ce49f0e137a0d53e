"""What can be seen to be wrong with a task before anything is searched for."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING

from pinposture.arm import Arm
from pinposture.arm.ellipsoid import chosen_points
from pinposture.control import EndEffector
from pinposture.control.limits import cycle_of
from pinposture.curve import Curve
from pinposture.errors import InvalidValue, TaskError, UnknownName
from pinposture.scene import Scene
from pinposture.scene.inside import obstacles_around
from pinposture.scene.obstacles import KINDS
from pinposture.task.keyframe import Keyframe, naming, title
from pinposture.task.leader import Leader, check_leader
from pinposture.task.schedule import CONTINUITIES

if TYPE_CHECKING:
    from pinposture.task.task import Task

FORMATS = ("npz", "csv", "json", "png", "html")
"""What may be kept of the result of a task."""

LONGEST_CYCLE = 60.0
"""The longest control cycle [s]."""

DESCRIBED = (Arm, Curve, EndEffector, Scene, *KINDS.values())
"""The parts of a task that a file may describe in several ways."""


def check_task(task: Task) -> None:
    """Refuse a task that no file could hold.

    Raises:
        InvalidValue: an attribute of the wrong kind, or one that does not fit the arm.
        UnknownName: a `continuity`, a format or a control point that does not exist.
        TaskError: a keyframe or an obstacle that does not go with the arm; names it.
    """
    if not isinstance(task.arm, Arm):
        raise InvalidValue("arm", task.arm, "an Arm")
    cycle = cycle_of(task.limits)
    if cycle > LONGEST_CYCLE:
        raise InvalidValue("dt", cycle, f"{LONGEST_CYCLE:g} s at most")
    task.limits.for_arm(task.arm)
    if task.continuity not in CONTINUITIES:
        raise UnknownName("continuity", task.continuity, CONTINUITIES)
    for each in task.formats:
        if each not in FORMATS:
            raise UnknownName("format", each, FORMATS)
    if not isinstance(task.name, str):
        raise InvalidValue("name", task.name, "text")
    described = task.described
    if not isinstance(described, Mapping) or not all(isinstance(each, DESCRIBED) for each in described):
        allowed = "a mapping from an arm, curves, tips, a scene or obstacles to what a file says of them"
        raise InvalidValue("described", described, allowed)
    if isinstance(task.motion, Leader):
        check_leader(task.motion, task.arm)
        if task.continuity != CONTINUITIES[0]:
            raise InvalidValue("continuity", task.continuity, f"{CONTINUITIES[0]!r}, of a leader")
    else:
        _check_keyframes(task.motion, task.arm)
    if task.scene is not None and not isinstance(task.scene, Scene):
        raise InvalidValue("scene", task.scene, "a Scene, or None")
    for name in around_base(task.scene, task.arm):
        raise TaskError(f"obstacle {name!r}", where_base_is(task.arm))


def around_base(scene: Scene | None, arm: Arm) -> tuple[str, ...]:
    """Names of the obstacles that the base of the arm is in."""
    return () if scene is None else obstacles_around(scene, arm.chain.base)


def where_base_is(arm: Arm) -> str:
    """What to say of such an obstacle."""
    at = ", ".join(f"{value:.4g}" for value in arm.chain.base)
    return f"it stands where the base of the arm is, at ({at}) m; move it, or leave it out"


def _check_keyframes(keyframes: tuple[Keyframe, ...], arm: Arm) -> None:
    if len(keyframes) < 2 or not all(isinstance(each, Keyframe) for each in keyframes):
        raise InvalidValue("keyframes", keyframes, "two or more of Keyframe(...)")
    for index, keyframe in enumerate(keyframes):
        if keyframe.region is not None and keyframe.region[1] >= arm.n_modules:
            reason = f"its region is {keyframe.region}; the arm has control points 0 to {arm.n_modules - 1}"
            raise TaskError(title(keyframes, index), reason)
        if keyframe.tip is not None:
            with naming(title(keyframes, index)):
                _check_point(arm, keyframe.tip.point)


def _check_point(arm: Arm, point: int | str) -> None:
    try:
        chosen_points(arm.control_points, point)
    except InvalidValue as error:  # there it is called "points"
        raise InvalidValue("point", error.value, error.allowed) from None
