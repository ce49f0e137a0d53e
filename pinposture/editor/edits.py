"""Edits of a task: each returns a changed copy of the task, or raises."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import replace
from typing import Any, TypeAlias

from pinposture.collision import Scene
from pinposture.collision.obstacles import Obstacle
from pinposture.control import controller_named
from pinposture.control.limits import cycle_of
from pinposture.editor.shape import keyframes_of, list_keyframes
from pinposture.errors import InvalidValue, TaskError
from pinposture.task import Keyframe, Task
from pinposture.task.keyframe import MOST_CYCLES

Edit: TypeAlias = Callable[[Task], Task]

NEW_KEYFRAME_GAP = 1.0  # from the keyframe before to a new one [s]
MIN_GAP = 0.05  # between keyframes [s], if the control cycle allows it
TIME_DIGITS, TIME_TOLERANCE = 9, 1e-9  # digits of stored times; differences that count as none [s]


def times_of(task: Task) -> list[float]:
    """Return when each keyframe is to be taken, counted from the beginning [s]."""
    times: list[float] = []
    left = 0.0
    for keyframe in keyframes_of(task):
        times.append(left + (keyframe.duration or 0.0) if keyframe.time is None else keyframe.time)
        left = times[-1] + keyframe.hold
    return times


def with_keyframe(index: int, **changes: Any) -> Edit:
    """Change values of a keyframe: its name, hold, region and so on."""

    def edit(task: Task) -> Task:
        keyframes = list_keyframes(task, index)
        keyframes[index] = replace(keyframes[index], **changes)
        return task.edited(motion=tuple(keyframes))

    return edit


def retimed(index: int, time: float) -> Edit:
    """Move a keyframe to another time [s], after the one before it; the first stays at 0.

    The others keep their times unless the next one is reached; then all later ones are shifted.
    """

    def edit(task: Task) -> Task:
        keyframes, gaps = list_keyframes(task, index), _gaps(task)
        if index == 0:
            if time != 0.0:
                raise InvalidValue("time of keyframe 1", time, "0 s: the motion begins with it")
            return _with_gaps(task, keyframes, gaps)
        least_gap = _min_gap(task)
        least = times_of(task)[index] - gaps[index] + least_gap
        if not least - TIME_TOLERANCE <= time < math.inf:
            allowed = f"{least:.4g} s or later, after the one before"
            raise InvalidValue(f"time of keyframe {index + 1}", time, allowed)
        later = time - times_of(task)[index]
        gaps[index] += later
        if index + 1 < len(gaps) and gaps[index + 1] - later >= least_gap - TIME_TOLERANCE:
            gaps[index + 1] -= later
        return _with_gaps(task, keyframes, gaps)

    return edit


def held(index: int, hold: float) -> Edit:
    """Hold a keyframe for another time [s]; later ones are shifted."""

    def edit(task: Task) -> Task:
        keyframes, gaps = list_keyframes(task, index), _gaps(task)
        keyframes[index] = replace(keyframes[index], hold=hold)
        return _with_gaps(task, keyframes, gaps)

    return edit


def added(index: int, name: str = "") -> Edit:
    """Add a keyframe after another, with the same shape, but no hold and no task of the tip.

    Later keyframes are shifted.
    """

    def edit(task: Task) -> Task:
        keyframes, gaps = list_keyframes(task, index), _gaps(task)
        own = replace(keyframes[index], time=None, duration=NEW_KEYFRAME_GAP, hold=0.0, name=name, tip=None)
        if keyframes[index].duration is None:
            own = replace(own, time=0.0, duration=None)
        keyframes.insert(index + 1, own)
        gaps.insert(index + 1, max(NEW_KEYFRAME_GAP, _min_gap(task)))
        return _with_gaps(task, keyframes, gaps)

    return edit


def removed(index: int) -> Edit:
    """Remove a keyframe; the others keep their times, except that the first is at 0."""

    def edit(task: Task) -> Task:
        keyframes, gaps = list_keyframes(task, index), _gaps(task)
        if len(keyframes) <= 2:
            raise TaskError(f"keyframe {index + 1}", "cannot be deleted: a motion needs two keyframes")
        if 0 < index < len(gaps) - 1:
            gaps[index + 1] += gaps[index] + keyframes[index].hold
        del keyframes[index], gaps[index]
        return _with_gaps(task, keyframes, gaps)

    return edit


def reordered(index: int, to: int) -> Edit:
    """Move a keyframe to another place in the order; holds and the gaps between places stay."""

    def edit(task: Task) -> Task:
        keyframes = list_keyframes(task, index)
        if not 0 <= to < len(keyframes):
            raise TaskError(f"keyframe {index + 1}", "there is none before the first or after the last")
        keyframes.insert(to, keyframes.pop(index))
        return _with_gaps(task, keyframes, _gaps(task))

    return edit


def with_controller(name: str) -> Edit:
    """Use another controller, with its default parameters."""
    return lambda task: task.edited(controller=controller_named(name))


def with_limits(**changes: Any) -> Edit:
    """Change limits of the task."""
    return lambda task: task.edited(limits=replace(task.limits, **changes))


def with_obstacle(name: str, obstacle: Obstacle | None, instead: str | None = None) -> Edit:
    """Add or replace an obstacle, or remove it.

    Args:
        name: of the obstacle.
        obstacle: the obstacle; None to remove it.
        instead: the name that it had; the obstacle keeps its place in the order.
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
    """Change values of the scene: its margin, self-collision and so on."""
    return lambda task: task.edited(scene=replace(task.scene or Scene(), **changes))


def _gaps(task: Task) -> list[float]:
    """Return the time from leaving the keyframe before to reaching each; 0 for the first [s]."""
    times, gaps, left = times_of(task), [0.0], 0.0
    for index, keyframe in enumerate(keyframes_of(task)):
        if index > 0:
            gaps.append(times[index] - left)
        left = times[index] + keyframe.hold
    return gaps


def _with_gaps(task: Task, keyframes: list[Keyframe], gaps: list[float]) -> Task:
    """Return the task with these keyframes and gaps; those given by time or by duration still are.

    Raises:
        InvalidValue: the motion would last too long.
    """
    timed: list[Keyframe] = []
    left = 0.0
    for index, (keyframe, gap) in enumerate(zip(keyframes, gaps, strict=True)):
        time = left + gap if index > 0 else 0.0
        by_duration = keyframe.duration is not None
        new, given = (gap, keyframe.duration) if by_duration else (time, keyframe.time)
        if index == 0:
            by_duration, new, given = False, 0.0, keyframe.time or keyframe.duration or 0.0
        changes: dict[str, float | None] = {}
        if given is None or abs(given - new) > TIME_TOLERANCE:
            value = None if index == 0 else round(new, TIME_DIGITS)
            changes = {"time": None, "duration": value} if by_duration else {"time": value, "duration": None}
        timed.append(replace(keyframe, **changes) if changes else keyframe)  # type: ignore[arg-type]
        left = time + keyframe.hold
    longest = MOST_CYCLES * cycle_of(task.limits)
    if not left <= longest:
        raise InvalidValue("end of the motion", left, f"{longest:g} s at most, {MOST_CYCLES} control cycles")
    return task.edited(motion=tuple(timed))


def _min_gap(task: Task) -> float:
    return max(MIN_GAP, 2.0 * cycle_of(task.limits))
