"""Editing of a task in phases: the keyframes of one phase are edited, and all else is kept."""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from pinposture.errors import InvalidValue, TaskError
from pinposture.task import Keyframe, Leader, Phase, Task, TipGoal
from pinposture.task.phases import is_phased, keyed, phase_title


@dataclass(frozen=True, eq=False, repr=False)
class PhaseKeyframes(Task):
    """The keyframes of one phase as a task; `save` writes all phases.

    In a phase that is not the first, the first keyframe is the posture in which the phase before ends. It is
    not part of the file, and cannot be changed.

    Attributes:
        phases: all phases of the file.
        index: the phase whose keyframes are edited, 0-based.
        begin: its first keyframe, unless it is the first phase.
        first: the configuration in which the first phase starts, as `Task.start`.

    Raises:
        PostureError: as `Task`, or a change that phases cannot hold: of the first keyframe, or more laps.
    """

    phases: tuple[Phase, ...] = ()
    index: int = 0
    begin: Keyframe | None = None
    first: NDArray[np.float64] | None = None

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.begin is not None and self.motion[0] != self.begin:
            reason = "is where the phase before ends, and cannot be changed, moved or removed"
            raise TaskError("keyframe 1", reason)
        if self.repeat != 1:
            raise InvalidValue("repeat", self.repeat, "1, of a phase")

    @property
    def whole(self) -> Task:
        """The task of all phases, with the keyframes as they are now."""
        own = [each for each in self.motion if isinstance(each, Keyframe)]
        phase = replace(self.phases[self.index], motion=tuple(own if self.begin is None else own[1:]))
        phases = (*self.phases[: self.index], phase, *self.phases[self.index + 1 :])
        values = {key: getattr(self, key) for key in Task.__dataclass_fields__ if key not in KEPT}
        return Task(**{**values, "motion": phases, "start": self.first})

    def save(self, path: str | Path) -> Path:
        """Write all phases; see `Task.save`."""
        return self.whole.save(path)

    @property
    def summary(self) -> str:
        """Which phase is edited, and what the others are."""
        others = [
            f"{phase_title(self.phases, number)} ({_kind(phase)})"
            for number, phase in enumerate(self.phases)
            if number != self.index
        ]
        kept = f"; kept as they are: {', '.join(others)}" if others else ""
        return f"keyframes of {phase_title(self.phases, self.index)}{kept}"


KEPT = ("motion", "_document")
"""Attributes of a task that are not taken over as they are."""


def _kind(phase: Phase) -> str:
    """Say in a word what a phase does."""
    if isinstance(phase.motion, Leader):
        return "along a path"
    if isinstance(phase.motion, TipGoal):
        return "tip to a goal"
    return f"{len(keyed(phase))} keyframes" if keyed(phase) else "way out"


def editable(task: Task) -> Task:
    """Return a task that the editor can edit: itself, or the keyframes of the first phase that has any.

    Raises:
        PostureError: no phase has keyframes, or the arm cannot perform the phases before.
    """
    if not is_phased(task.motion):
        return task
    phases = task.motion
    indices = [number for number, phase in enumerate(phases) if keyed(phase)]
    if not indices:
        raise TaskError("the task", "has no phase with keyframes; only keyframes can be edited")
    index = indices[0]
    frames = keyed(phases[index])
    begin: Keyframe | None = None
    if index > 0:
        before = task.edited(motion=phases[:index]).reference()
        joints = task.arm.positions(before.configuration(before.rows - 1))
        joints = np.clip(joints, task.arm.limits.lower, task.arm.limits.upper)
        name = phases[index - 1].name or f"phase {index}"
        begin = Keyframe(joints=tuple(joints), name=f"end of {name}")
        frames = (begin, *frames)
    values = {key: getattr(task, key) for key in Task.__dataclass_fields__ if key not in KEPT}
    values |= {"motion": frames, "start": task.start if index == 0 else None}
    return PhaseKeyframes(**values, phases=phases, index=index, begin=begin, first=task.start)
