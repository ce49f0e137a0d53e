"""Editing of a task in phases: one phase at a time is shown and edited, and all others are kept."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path
from typing import Any, cast

import numpy as np
from numpy.typing import NDArray

from pinposture.arm import Arm
from pinposture.curve import Curve
from pinposture.errors import InvalidValue, TaskError
from pinposture.task import Carrying, Keyframe, Leader, Phase, Release, Task, TipGoal, Withdrawal, Wrapping
from pinposture.task.phases import is_phased, keyed, phase_title, plan_phases


@dataclass(frozen=True, eq=False, repr=False)
class EditedPhase(Task):
    """One phase of a task as keyframes; `save` writes all phases.

    In a phase that is not the first, the first keyframe is the posture in which the phase before ends. A
    phase without keyframes of its own has two: the postures in which it begins and ends. These postures are
    not part of the file, and cannot be changed.

    Attributes:
        phases: all phases of the file.
        index: the phase that is edited, 0-based.
        begin: the posture in which it begins; None for keyframes of the first phase.
        end: the posture in which it ends; None if it has keyframes of its own.
        begins: planned time of its beginning in the whole motion [s].
        ends: planned time of its end, when it was planned [s].
        path: the path of a leader as placed, world frame; None for other phases.
        first: the configuration in which the first phase starts, as `Task.start`.

    Raises:
        PostureError: as `Task`, or a change that phases cannot hold: of those postures, or more laps.
    """

    phases: tuple[Phase, ...] = ()
    index: int = 0
    begin: Keyframe | None = None
    end: Keyframe | None = None
    begins: float = 0.0
    ends: float = 0.0
    path: Curve | None = None
    first: NDArray[np.float64] | None = None

    def __post_init__(self) -> None:
        super().__post_init__()
        motion = cast("tuple[Keyframe, ...]", self.motion)
        if self.begin is not None and motion[0] != self.begin:
            reason = "is where the phase begins, and cannot be changed, moved or removed"
            raise TaskError("keyframe 1", reason)
        if self.end is not None and tuple(motion[1:]) != (self.end,):
            reason = "has no keyframes, only the postures in which it begins and ends; its values are below "
            raise TaskError(phase_title(self.phases, self.index), f"{reason}the list of phases")
        if self.repeat != 1:
            raise InvalidValue("repeat", self.repeat, "1, of a phase")
        _ = self.whole  # refuses what a task in phases cannot hold

    @cached_property
    def whole(self) -> Task:
        """The task of all phases, with this phase as it is now."""
        phases = self.phases
        if self.end is None:
            motion = cast("tuple[Keyframe, ...]", self.motion)
            own = [keyframe for keyframe in motion if isinstance(keyframe, Keyframe)]
            phase = replace(phases[self.index], motion=tuple(own if self.begin is None else own[1:]))
            phases = (*phases[: self.index], phase, *phases[self.index + 1 :])
        values = {key: getattr(self, key) for key in Task.__dataclass_fields__ if key not in KEPT}
        return Task(**{**values, "motion": phases, "start": self.first})

    def save(self, path: str | Path) -> Path:
        """Write all phases; see `Task.save`."""
        return self.whole.save(path)


KEPT = ("motion", "_document")
"""Attributes of a task that are not taken over as they are."""


def whole_of(task: Task) -> Task:
    """Return what is performed, exported and written of a task that is edited: all its phases."""
    return task.whole if isinstance(task, EditedPhase) else task


def phase_label(phases: tuple[Phase, ...], index: int) -> str:
    """Return the number of a phase, its name, and what it does."""
    phase = phases[index]
    name = f" {phase.name}" if phase.name else ""
    return f"{index + 1}{name}  ·  {_kind(phase)}"


def _kind(phase: Phase) -> str:
    """Say in a word what a phase does."""
    count = len(keyed(phase))
    words: dict[type, str] = {
        Leader: "along a path",
        TipGoal: "tip to a goal",
        Withdrawal: "way out",
        Wrapping: "around an object",
        Carrying: "carries it",
        Release: "lets go of it",
    }
    return words.get(type(phase.motion), f"{count} keyframe{'s' * (count > 1)}")


def editable(task: Task, index: int | None = None) -> Task:
    """Return a task that the editor can edit: itself, or one phase of it.

    Args:
        task: any task.
        index: the phase, 0-based; None: the first that has keyframes, or the first of all.

    Raises:
        PostureError: the arm cannot perform the phases before it, or this phase if it has no keyframes.
    """
    if not is_phased(task.motion):
        return task
    phases = task.motion
    if index is None:
        index = next((number for number, phase in enumerate(phases) if keyed(phase)), 0)
    phase = phases[index]
    keyframes_of_phase = keyed(phase)
    # Keyframes of the phase are edited, whether or not the arm can take them.
    planned = plan_phases(
        task.arm,
        phases[: index + (not keyframes_of_phase)],
        task.limits,
        task.effective_scene,
        task.start,
        task.continuity,
    )
    begin: Keyframe | None = None
    end: Keyframe | None = None
    ends = planned[-1].ends if planned else 0.0
    begins = ends
    if not keyframes_of_phase:
        here = planned[-1]
        begins = here.begins
        begin = _posture(task.arm, here.begin, f"begin of {phase.name or _kind(phase)}")
        end = _posture(task.arm, here.end, f"end of {phase.name or _kind(phase)}")
        end = replace(end, duration=ends - begins)
    elif index > 0:
        before = phases[index - 1].name or f"phase {index}"
        begin = _posture(task.arm, planned[-1].end, f"end of {before}")
    values = {key: getattr(task, key) for key in Task.__dataclass_fields__ if key not in KEPT}
    values["motion"] = tuple(
        keyframe for keyframe in (begin, *keyframes_of_phase, end) if keyframe is not None
    )
    values["start"] = task.start if begin is None else None
    view = EditedPhase(
        **values,
        phases=phases,
        index=index,
        begin=begin,
        end=end,
        begins=begins,
        ends=ends,
        path=None if keyframes_of_phase else planned[-1].path,
        first=task.start,
    )
    vars(view)["whole"] = task  # the same one, so that choosing a phase is no change
    return view


def _posture(arm: Arm, q: NDArray[np.float64], name: str) -> Keyframe:
    """Return a configuration (nq,) as a taught keyframe."""
    joints = np.clip(arm.positions(q), arm.limits.lower, arm.limits.upper)
    return Keyframe(joints=tuple(joints), name=name)


def with_phase(task: EditedPhase, **values: Any) -> tuple[Phase, ...]:
    """Return all phases, with other values of the one that is shown."""
    phases = cast("tuple[Phase, ...]", task.whole.motion)
    return (*phases[: task.index], replace(phases[task.index], **values), *phases[task.index + 1 :])
