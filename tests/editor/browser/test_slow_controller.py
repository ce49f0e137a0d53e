"""A controller that takes long holds up the arm, and nothing else: the ball stays under the mouse."""

from __future__ import annotations

import time
from collections.abc import Callable
from pathlib import Path
from threading import Event
from typing import Any

import numpy as np
import pytest

pytest.importorskip("viser", reason="viser is not installed")

from editor.browser.desk import PATIENCE, arrived, wait_until
from editor.browser.window import Window

import pinposture as pp
from pinposture.control import Geodesic
from pinposture.editor import Editor

pytestmark = pytest.mark.browser

Edit = Callable[..., Editor]
Look = Callable[..., Window]


class Slow:
    """A controller that sleeps for a second in each step, and that can be kept from ending one."""

    name = "geodesic"

    def __init__(self) -> None:
        self.own = Geodesic()
        self.begun = 0
        self.ended = 0
        self.free = Event()
        self.free.set()

    def step(self, *given: Any, **named: Any) -> Any:
        self.begun += 1
        time.sleep(1.0)
        self.free.wait(2.0 * PATIENCE)
        self.ended += 1
        return self.own.step(*given, **named)


def test_the_ball_follows_while_the_controller_is_busy(edit: Edit, look: Look, file: Path) -> None:
    task = pp.Task.load(file)
    slow = Slow()
    editor = edit(task.edited(controller=slow), file, selected=1)
    window = look(editor)
    session = editor.session
    points = session.shape.points.copy()

    # From here on no step comes to its end.
    slow.free.clear()
    wait_until(lambda: slow.begun > slow.ended, "the controller is at work")
    seen: list[np.ndarray] = []

    def follows() -> None:
        last = seen[-1] if seen else points[2]
        if seen:  # the first move only takes hold of it
            wait_until(lambda: np.linalg.norm(session.shape.points[2] - last) > 1e-3, "the ball follows")
        seen.append(session.shape.points[2].copy())

    ended = slow.ended
    try:
        window.drag(points[2], points[2] + [0.12, 0.0, 0.12], follows, steps=6)
        wait_until(lambda: session.problem.number == editor.live.number, "what is asked is looked at, too")
        window.drop()
        wait_until(lambda: session.history.undoable == "moved point 3", "it counts")
        assert slow.ended == ended  # nothing of it waited for the controller
    finally:
        slow.free.set()
    x, y = window.at(session.shape.points[2])
    assert np.allclose((x, y), window.at(points[2] + [0.12, 0.0, 0.12]), atol=3.0)
    editor.post(lambda session: session.edit(lambda task: task.edited(controller=Geodesic()), "geodesic"))
    wait_until(lambda: session.history.undoable == "geodesic", "another controller takes over")
    arrived(editor)
    assert editor.live.mean_error < 1e-6
