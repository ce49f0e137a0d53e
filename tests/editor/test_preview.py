"""Motions are worked out beside everything else: the latest task counts, and errors are told."""

from __future__ import annotations

import threading
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from played import bent_spline, done, half_line, moved, short

from pinposture.editor.playback import Preview
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
    preview = Preview()
    task = short()
    preview.ask(task)
    motion = done(preview, task).motion
    assert motion is not None
    np.testing.assert_array_equal(motion.q, moved().q)
    assert not preview.working
    preview.close()


def test_asking_returns_while_the_motion_is_worked_out(monkeypatch: pytest.MonkeyPatch) -> None:
    gate = Gate(monkeypatch)
    preview = Preview()
    task = short()
    preview.ask(task)
    assert gate.begun.acquire(timeout=30.0)
    assert preview.working
    assert preview.of(task) is None
    assert preview.progress == pytest.approx(0.5)  # the postures are found
    gate.open.release()
    assert done(preview, task).motion is moved()
    preview.close()


def test_a_motion_that_is_known_is_not_worked_out_again(monkeypatch: pytest.MonkeyPatch) -> None:
    gate = Gate(monkeypatch)
    preview = Preview()
    task = short()
    gate.open.release(5)
    for _ in range(3):
        preview.ask(task)
        done(preview, task)
    assert gate.finished == ["short"]
    preview.close()


def test_only_the_task_that_was_asked_for_last_counts(monkeypatch: pytest.MonkeyPatch) -> None:
    gate = Gate(monkeypatch)
    preview = Preview()
    first, second, third = (short(name=name) for name in ("first", "second", "third"))
    preview.ask(first)
    assert gate.begun.acquire(timeout=30.0)
    preview.ask(second)
    preview.ask(third)
    gate.open.release(3)
    assert done(preview, third).motion is not None
    assert gate.finished == ["third"]  # the first was given up at its next cycle, the second never began
    assert preview.of(first) is None
    preview.close()


def test_what_is_cancelled_leaves_nothing_and_can_be_asked_for_again(monkeypatch: pytest.MonkeyPatch) -> None:
    gate = Gate(monkeypatch)
    preview = Preview()
    task = short()
    preview.ask(task)
    assert gate.begun.acquire(timeout=30.0)
    preview.cancel()
    assert not preview.working
    gate.open.release(2)
    preview.ask(task)
    assert done(preview, task).motion is moved()
    assert gate.finished == ["short"]
    preview.close()


def test_no_thread_is_left_after_closing(monkeypatch: pytest.MonkeyPatch) -> None:
    gate = Gate(monkeypatch)
    preview = Preview()
    preview.ask(short())
    assert gate.begun.acquire(timeout=30.0)
    gate.open.release()
    preview.close()
    assert not [each for each in threading.enumerate() if each.name == "pinposture-preview"]


@pytest.mark.parametrize("from_a_file", [False, True])
def test_a_task_that_cannot_be_tells_which_keyframe_and_why(from_a_file: bool, tmp_path: Path) -> None:
    task = short(motion=(Keyframe(bent_spline(), trim=True), Keyframe(half_line(), time=1.0)))
    if from_a_file:
        task = Task.load(task.save(tmp_path / "task.toml"))
    preview = Preview()
    preview.ask(task)
    found = done(preview, task)
    assert found.motion is None
    assert found.reason.startswith("keyframe 2")
    preview.close()


def test_a_fault_is_told_and_not_waited_for_in_vain(monkeypatch: pytest.MonkeyPatch) -> None:
    def fail(*_: Any, **__: Any) -> Trajectory:
        raise RuntimeError("lost a screw")

    monkeypatch.setattr(Task, "perform", fail)
    preview = Preview()
    task = short()
    preview.ask(task)
    found = done(preview, task)
    assert found.motion is None
    assert "lost a screw" in found.reason
    preview.close()
