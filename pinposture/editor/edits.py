"""What can be done to a task: each makes another task of it, or raises, and changes nothing."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import replace
from typing import Any, TypeAlias

from pinposture.arm import Arm
from pinposture.collision import Scene
from pinposture.collision.obstacles import Obstacle
from pinposture.control import controller_named
from pinposture.control.limits import cycle_of
from pinposture.editor.shape import Shape
from pinposture.errors import InvalidValue, TaskError
from pinposture.task import Keyframe, Task
from pinposture.task.follow_leader import Leader
from pinposture.task.keyframe import MOST_CYCLES

Edit: TypeAlias = Callable[[Task], Task]

LATER = 1.0
"""How long after the one before a new keyframe is [s]."""

CLOSEST = 0.05
"""How soon after the one before a keyframe may be [s], if the control cycle allows it."""

DIGITS, ROUNDING = 9, 1e-9
"""To how many digits times are kept [s], and what is no difference between them [s]."""


def keyframes_of(task: Task) -> tuple[Keyframe, ...]:
    """The keyframes of a task.

    Raises:
        TaskError: it has none: it follows a leader.
    """
    if isinstance(task.motion, Leader):  # which is a tuple, too
        raise TaskError("the task", "it follows a leader; only tasks of keyframes can be edited")
    return task.motion


def times_of(task: Task) -> list[float]:
    """When each keyframe is to be taken, counted from the beginning [s]."""
    times: list[float] = []
    left = 0.0
    for keyframe in keyframes_of(task):
        times.append(left + (keyframe.duration or 0.0) if keyframe.time is None else keyframe.time)
        left = times[-1] + keyframe.hold
    return times


def with_keyframe(index: int, **changes: Any) -> Edit:
    """A keyframe with other values: its name, hold, region and so on."""

    def edit(task: Task) -> Task:
        keyframes = _listed(task, index)
        keyframes[index] = replace(keyframes[index], **changes)
        return _with(task, keyframes)

    return edit


def reshaped(index: int, change: Callable[[Arm, Shape], Shape], shape: Shape) -> Edit:
    """A keyframe with another shape, made of the one that it has."""

    def edit(task: Task) -> Task:
        keyframes = _listed(task, index)
        keyframes[index] = change(task.arm, shape).keyframe(keyframes[index])
        return _with(task, keyframes)

    return edit


def retimed(index: int, time: float) -> Edit:
    """A keyframe at another time [s], after the one before; the first is at 0.

    The others stay where they are, unless it comes to the next one: then all behind it move along.
    """

    def edit(task: Task) -> Task:
        keyframes, gaps = _listed(task, index), _gaps(task)
        if index == 0:
            if time != 0.0:
                raise InvalidValue("time of keyframe 1", time, "0 s: the motion begins with it")
            return _timed(task, keyframes, gaps)
        near = _nearest(task)
        least = times_of(task)[index] - gaps[index] + near
        if not least - ROUNDING <= time < math.inf:
            allowed = f"{least:.4g} s or later, after the one before"
            raise InvalidValue(f"time of keyframe {index + 1}", time, allowed)
        later = time - times_of(task)[index]
        gaps[index] += later
        if index + 1 < len(gaps) and gaps[index + 1] - later >= near - ROUNDING:
            gaps[index + 1] -= later
        return _timed(task, keyframes, gaps)

    return edit


def held(index: int, hold: float) -> Edit:
    """A keyframe that is held for another time [s]; those behind it move along."""

    def edit(task: Task) -> Task:
        keyframes, gaps = _listed(task, index), _gaps(task)
        keyframes[index] = replace(keyframes[index], hold=hold)
        return _timed(task, keyframes, gaps)

    return edit


def added(index: int, name: str = "") -> Edit:
    """A further keyframe behind another, with its shape; those behind it move along.

    It is not held, and asks nothing of the tip.
    """

    def edit(task: Task) -> Task:
        keyframes, gaps = _listed(task, index), _gaps(task)
        own = replace(keyframes[index], time=None, duration=LATER, hold=0.0, name=name, tip=None)
        if keyframes[index].duration is None:
            own = replace(own, time=0.0, duration=None)
        keyframes.insert(index + 1, own)
        gaps.insert(index + 1, max(LATER, _nearest(task)))
        return _timed(task, keyframes, gaps)

    return edit


def removed(index: int) -> Edit:
    """All keyframes but one; the others stay at their times, but for the first of them, which is at 0."""

    def edit(task: Task) -> Task:
        keyframes, gaps = _listed(task, index), _gaps(task)
        if len(keyframes) <= 2:
            raise TaskError(f"keyframe {index + 1}", "cannot be deleted: a motion needs two keyframes")
        if 0 < index < len(gaps) - 1:
            gaps[index + 1] += gaps[index] + keyframes[index].hold
        del keyframes[index], gaps[index]
        return _timed(task, keyframes, gaps)

    return edit


def reordered(index: int, to: int) -> Edit:
    """A keyframe at another place in the order, held as it was; the times in between stay as they are."""

    def edit(task: Task) -> Task:
        keyframes = _listed(task, index)
        if not 0 <= to < len(keyframes):
            raise TaskError(f"keyframe {index + 1}", "there is none before the first or after the last")
        keyframes.insert(to, keyframes.pop(index))
        return _timed(task, keyframes, _gaps(task))

    return edit


def with_controller(name: str) -> Edit:
    """The task by another controller, with its usual parameters."""
    return lambda task: task.edited(controller=controller_named(name))


def with_limits(**changes: Any) -> Edit:
    """The task within other limits."""
    return lambda task: task.edited(limits=replace(task.limits, **changes))


def with_obstacle(name: str, obstacle: Obstacle | None, instead: str | None = None) -> Edit:
    """The task with an obstacle of a name, in place of what had it; without it, if it is None.

    Args:
        name: of the obstacle.
        obstacle: the obstacle, or None.
        instead: a name that is given up; the obstacle keeps its place in the order.
    """

    def edit(task: Task) -> Task:
        scene = task.scene or Scene()
        listed = dict(scene.obstacles)
        if instead is not None and instead != name and name in listed:
            raise InvalidValue("name of an obstacle", name, "a name that no other obstacle has")
        if obstacle is None:
            listed.pop(name, None)
        elif instead is not None and instead in listed:
            renamed = {instead: (name, obstacle)}
            listed = dict(renamed.get(key, (key, each)) for key, each in listed.items())
        else:
            listed[name] = obstacle
        return task.edited(scene=replace(scene, obstacles=listed))

    return edit


def with_scene(**changes: Any) -> Edit:
    """The task in a scene of another margin, or with self-collision looked at, and so on."""
    return lambda task: task.edited(scene=replace(task.scene or Scene(), **changes))


def _listed(task: Task, index: int) -> list[Keyframe]:
    """The keyframes of a task, of which one is going to be changed.

    Raises:
        TaskError: it is not there, any more perhaps.
    """
    keyframes = list(keyframes_of(task))
    if not 0 <= index < len(keyframes):
        raise TaskError(f"keyframe {index + 1}", f"does not exist; allowed: 1 to {len(keyframes)}")
    return keyframes


def _gaps(task: Task) -> list[float]:
    """The time from leaving the keyframe before to being at each; 0 for the first [s]."""
    times, gaps, left = times_of(task), [0.0], 0.0
    for index, keyframe in enumerate(keyframes_of(task)):
        if index > 0:
            gaps.append(times[index] - left)
        left = times[index] + keyframe.hold
    return gaps


def _timed(task: Task, keyframes: list[Keyframe], gaps: list[float]) -> Task:
    """The task with keyframes so far apart; those that were given by a time, or by a duration, still are.

    Raises:
        InvalidValue: the motion would last too long.
    """
    placed: list[Keyframe] = []
    left = 0.0
    for index, (keyframe, gap) in enumerate(zip(keyframes, gaps, strict=True)):
        time = left + gap if index > 0 else 0.0
        lasting = keyframe.duration is not None
        own, given = (gap, keyframe.duration) if lasting else (time, keyframe.time)
        if index == 0:
            lasting, own, given = False, 0.0, keyframe.time or keyframe.duration or 0.0
        changes: dict[str, float | None] = {}
        if given is None or abs(given - own) > ROUNDING:
            value = None if index == 0 else round(own, DIGITS)
            changes = {"time": None, "duration": value} if lasting else {"time": value, "duration": None}
        placed.append(replace(keyframe, **changes) if changes else keyframe)  # type: ignore[arg-type]
        left = time + keyframe.hold
    longest = MOST_CYCLES * cycle_of(task.limits)
    if not left <= longest:
        raise InvalidValue("end of the motion", left, f"{longest:g} s at most, {MOST_CYCLES} control cycles")
    return _with(task, placed)


def _nearest(task: Task) -> float:
    """How soon after the one before a keyframe may be [s]."""
    return max(CLOSEST, 2.0 * cycle_of(task.limits))


def _with(task: Task, keyframes: list[Keyframe]) -> Task:
    return task.edited(motion=tuple(keyframes))
