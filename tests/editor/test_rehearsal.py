"""Motions are worked out beside everything else: the latest task counts, and errors are told."""

from __future__ import annotations

import threading
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from played import bent_spline, done, half_line, moved, short

from pinposture.editor.playback import Rehearsal
from pinposture.motion import Trajectory
from pinposture.task import Keyframe, Task


class Gate:
    """Holds motions up, each until it is let go, and knows which of them came to their end."""

    def __init__(self, monkeypatch: pytest.MonkeyPatch) -> None:
        self.begun = threading.Semaphore(0)
        self.open = threading.Semaphore(0)
        self.finished: list[str] = []
        moved()  # computed before `perform` is replaced

        def perform(task: Task, reference: object, progress: Callable[[float, float], object]) -> Trajectory:
            del reference
            self.begun.release()
            assert self.open.acquire(timeout=30.0)
            progress(0.5, 1.0)
            self.finished.append(task.name)
            return moved()

        monkeypatch.setattr(Task, "perform", perform)


def test_the_motion_is_that_of_the_task() -> None:
    rehearsal = Rehearsal()
    task = short()
    rehearsal.ask(task)
    motion = done(rehearsal, task).motion
    assert motion is not None
    np.testing.assert_array_equal(motion.q, moved().q)
    assert not rehearsal.working
    rehearsal.close()


def test_asking_returns_while_the_motion_is_worked_out(monkeypatch: pytest.MonkeyPatch) -> None:
    gate = Gate(monkeypatch)
    rehearsal = Rehearsal()
    task = short()
    rehearsal.ask(task)
    assert gate.begun.acquire(timeout=30.0)
    assert rehearsal.working
    assert rehearsal.of(task) is None
    assert rehearsal.progress == pytest.approx(0.5)  # the postures are found
    gate.open.release()
    assert done(rehearsal, task).motion is moved()
    rehearsal.close()


def test_a_motion_that_is_known_is_not_worked_out_again(monkeypatch: pytest.MonkeyPatch) -> None:
    gate = Gate(monkeypatch)
    rehearsal = Rehearsal()
    task = short()
    gate.open.release(5)
    for _ in range(3):
        rehearsal.ask(task)
        done(rehearsal, task)
    assert gate.finished == ["short"]
    rehearsal.close()


def test_only_the_task_that_was_asked_for_last_counts(monkeypatch: pytest.MonkeyPatch) -> None:
    gate = Gate(monkeypatch)
    rehearsal = Rehearsal()
    first, second, third = (short(name=name) for name in ("first", "second", "third"))
    rehearsal.ask(first)
    assert gate.begun.acquire(timeout=30.0)
    rehearsal.ask(second)
    rehearsal.ask(third)
    gate.open.release(3)
    assert done(rehearsal, third).motion is not None
    assert gate.finished == ["third"]  # the first was given up at its next cycle, the second never began
    assert rehearsal.of(first) is None
    rehearsal.close()


def test_what_is_cancelled_leaves_nothing_and_can_be_asked_for_again(monkeypatch: pytest.MonkeyPatch) -> None:
    gate = Gate(monkeypatch)
    rehearsal = Rehearsal()
    task = short()
    rehearsal.ask(task)
    assert gate.begun.acquire(timeout=30.0)
    rehearsal.cancel()
    assert not rehearsal.working
    gate.open.release(2)
    rehearsal.ask(task)
    assert done(rehearsal, task).motion is moved()
    assert gate.finished == ["short"]
    rehearsal.close()


def test_no_thread_is_left_after_closing(monkeypatch: pytest.MonkeyPatch) -> None:
    gate = Gate(monkeypatch)
    rehearsal = Rehearsal()
    rehearsal.ask(short())
    assert gate.begun.acquire(timeout=30.0)
    gate.open.release()
    rehearsal.close()
    assert not [each for each in threading.enumerate() if each.name == "pinposture-rehearsal"]


@pytest.mark.parametrize("from_a_file", [False, True])
def test_a_task_that_cannot_be_tells_which_keyframe_and_why(from_a_file: bool, tmp_path: Path) -> None:
    task = short(motion=(Keyframe(bent_spline(), trim=True), Keyframe(half_line(), time=1.0)))
    if from_a_file:
        task = Task.load(task.save(tmp_path / "task.toml"))
    rehearsal = Rehearsal()
    rehearsal.ask(task)
    found = done(rehearsal, task)
    assert found.motion is None
    assert found.reason.startswith("keyframe 2")
    rehearsal.close()


def test_a_fault_is_told_and_not_waited_for_in_vain(monkeypatch: pytest.MonkeyPatch) -> None:
    def fail(*_: Any, **__: Any) -> Trajectory:
        raise RuntimeError("lost a screw")

    monkeypatch.setattr(Task, "perform", fail)
    rehearsal = Rehearsal()
    task = short()
    rehearsal.ask(task)
    found = done(rehearsal, task)
    assert found.motion is None
    assert "lost a screw" in found.reason
    rehearsal.close()
