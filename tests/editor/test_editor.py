"""The editor's loop: whatever is asked of it, by whom and how fast, it goes on, and leaves nothing behind."""

from __future__ import annotations

import random
import threading
import time
from collections.abc import Callable, Iterator
from functools import partial
from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest
from editor.edited_tasks import L, six_modules, task
from editor.page_client import SOON, until, visiting
from threadpoolctl import threadpool_info, threadpool_limits

import pinposture as pp
from pinposture.control import Geodesic
from pinposture.editor import edits, obstacles, solver
from pinposture.editor.files import autosave_path, first_task
from pinposture.editor.session import Session
from pinposture.editor.solver import LIVE_ARM, Problem, Solver
from pinposture.errors import TaskError, ViewerError
from pinposture.task import Task

pytest.importorskip("viser", reason="viser is not installed")

from pinposture.editor import Editor
from pinposture.editor import editor as editor_module
from pinposture.editor.ui import curve, keyframes, player

PORT = 8265


def our_threads() -> set[str]:
    return {each.name for each in threading.enumerate() if each.name.startswith("pinposture")}


@pytest.fixture
def path(tmp_path: Path) -> Path:
    return first_task(six_modules(), "own").save(tmp_path / "own.toml")


@pytest.fixture
def editor(path: Path) -> Iterator[Editor]:
    made = Editor(Task.load(path), path, port=PORT)
    made.start()
    yield made
    made.close()
    until(lambda: our_threads() <= {"pinposture-controller"})  # which ends when it has planned


def idle(editor: Editor) -> bool:
    return not editor._inbox and editor.session.proposal is None


@pytest.mark.soak
def test_hands_that_do_anything_at_all_leave_a_sound_task(
    editor: Editor, path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    other = first_task(pp.Arm.from_template("Rz", 4), "other").save(path.with_name("other.toml"))
    broken: list[str] = []

    def look(session: Session) -> None:
        if not 0 <= session.selected < len(edits.keyframes_of(session.task)):
            broken.append(f"keyframe {session.selected}")
        if not all(0 <= each < len(session.shape.points) for each in session.handles):
            broken.append(f"points {session.handles}")
        if session.obstacle not in (None, *obstacles.obstacles_of(session.shown)):
            broken.append(f"obstacle {session.obstacle}")

    def hand(seed: int) -> None:
        chance = random.Random(seed)
        for _ in range(150):
            k = chance.randrange(9)
            name = chance.choice(["sphere_1", "box_1", "x"])
            place = L * np.array([chance.uniform(-0.2, 1.4), *(chance.uniform(-0.5, 0.5) for _ in range(2))])
            final = chance.random() < 0.3
            key = chance.choice(["center", "radius", "start", "size"])
            value = chance.choice([tuple(map(float, place)), 0.02, -1.0, np.nan])
            file = chance.choice([path, other])
            requests: list[Callable[[Session], object]] = [
                partial(curve.move_point, k, place, final),
                lambda session, k=k: session.take_hold(k),  # type: ignore[misc]
                curve.insert_point,
                curve.delete_points,
                curve.duplicate_points,
                lambda session, k=k: session.take_hold(k, more=True),  # type: ignore[misc]
                partial(curve.set_grid, chance.choice([0.0, 0.05])),
                Session.undo,
                Session.redo,
                lambda session, k=k: session.select(k),  # type: ignore[misc]
                keyframes.add,
                keyframes.delete,
                partial(keyframes.rename, k, "höhle"),
                lambda session, k=k: session.edit(edits.retimed(k, 0.5 * k), "retimed"),  # type: ignore[misc]
                lambda session, k=k: session.edit(edits.repeated(k % 4), "laps"),  # type: ignore[misc]
                partial(obstacles.add_obstacle, chance.choice(["sphere", "box"]), np.zeros((1, 3))),
                partial(obstacles.edit_obstacle, name, key, value, final),
                partial(obstacles.rename_obstacle, name, "x"),
                obstacles.delete_obstacle,
                player.play,
                player.stop,
                partial(player.seek, chance.choice([0.0, 1.0, -1.0, np.nan])),
                editor.files.save,
                lambda session, file=file: editor.files.open(session, file),  # type: ignore[misc]
            ]
            weights = [8] + [2] * (len(requests) - 2) + [0.3]
            editor.post(chance.choices(requests, weights)[0])
            editor.post(look)
            time.sleep(0.005)

    hands = [threading.Thread(target=hand, args=(seed,)) for seed in range(3)]
    for each in hands:
        each.start()
    for each in hands:
        each.join()
    until(lambda: idle(editor))
    editor.close()
    session = editor.session
    assert broken == []
    assert [record.message for record in caplog.records if record.levelname == "ERROR"] == []
    assert session.path is not None
    last = Task.load(autosave_path(session.path) if session.changed else session.path)
    assert last.motion == session.task.motion
    assert last.scene == session.task.scene


@pytest.mark.long
def test_laps_and_limits_are_typed_and_undone(editor: Editor) -> None:
    session = editor.session
    before = editor.session.task
    with visiting(editor.url) as client:
        client.set("Laps", 3)
        until(lambda: session.task.repeat == 3)
        client.set("Return [s]", 0.125)
        until(lambda: edits.keyframes_of(session.task)[0].duration == 0.125)
        for label, name in (("Speed [rad/s]", "velocity"), ("Accel. [rad/s²]", "acceleration")):
            client.set(label, 1.125)
            until(lambda name=name: getattr(session.task.limits, name) == 1.125)
        client.set("Jerk [rad/s³]", 50.25)
        until(lambda: session.task.limits.jerk == 50.25)
    for _ in range(5):
        editor.post(Session.undo)
    until(lambda: session.task is before)


def test_a_part_that_fails_does_not_end_the_loop(
    editor: Editor, monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    def fail(*given: object) -> None:
        raise RuntimeError("a wire came off")

    monkeypatch.setattr(editor.surroundings, "watch", fail)
    monkeypatch.setattr(editor.page, "show", fail)
    editor.post(fail)
    done = threading.Event()
    until(lambda: "a wire came off" in editor.session.notice.text)
    for _ in range(5):
        editor.post(lambda _: done.set())
        assert done.wait(SOON)
        done.clear()
    assert sum(record.message == "a part of the editor failed" for record in caplog.records) == 1


def test_more_requests_than_can_be_done_are_dropped_and_that_is_told(
    path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(editor_module, "MAX_REQUESTS", 10)
    editor = Editor(Task.load(path), path, port=PORT)
    done = []
    for k in range(50):
        editor.post(lambda _, k=k: done.append(k))  # type: ignore[misc]
    editor.post(lambda _: done.append(-1), "key")
    editor.start()
    until(lambda: "too many requests at once" in editor.session.notice.text)
    editor.close()
    assert done == list(range(10))


def test_what_was_left_of_another_arm_is_taken_up(path: Path) -> None:
    left = first_task(pp.Arm.from_template("Rz", 3), "left")
    left.save(autosave_path(path))
    editor = Editor(Task.load(path), path, port=PORT)
    editor.start()
    until(lambda: editor.live.steps > 0)
    assert editor.live.arm.nv == left.arm.nv
    editor.post(Session.undo)
    until(lambda: editor.live.arm.nv == six_modules().nv)
    editor.close()


def test_an_editor_that_cannot_be_made_leaves_nothing_behind(
    path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def refuse(*given: object) -> None:
        raise ViewerError("viser", "cannot serve")

    monkeypatch.setattr(editor_module, "Page", refuse)
    before = our_threads()
    with pytest.raises(ViewerError):
        Editor(Task.load(path), path, port=PORT)
    assert our_threads() == before


class Loose:
    """A controller that fails now and then."""

    name = "loose"

    def __init__(self) -> None:
        self.own = Geodesic()
        self.asked = 0

    def step(self, *given: object, **named: object) -> object:
        self.asked += 1
        if self.asked % 9 > 5:
            raise RuntimeError("a wire came off")
        return self.own.step(*given, **named)  # type: ignore[arg-type]


def problem(number: int, **values: object) -> Problem:
    session = Session(task(limits=pp.Limits(dt=0.02, velocity=2.0, acceleration=10.0)), selected=1)
    return session.problem._replace(number=number, **values)  # type: ignore[arg-type]


@pytest.mark.soak
def test_a_controller_that_fails_brings_the_arm_to_rest_within_its_limits() -> None:
    looked: list[np.ndarray] = []
    moving = Solver(
        problem(1, controller=Loose()), six_modules().straight(), lambda: looked.append(moving.live.state.q)
    )
    moving.start()
    until(lambda: len(looked) > 60)
    moving.close()
    speeds = np.array([six_modules().difference(a, b) for a, b in pairwise(looked)]) / LIVE_ARM.step_time
    changes = np.abs(np.diff(speeds, axis=0)) / LIVE_ARM.step_time
    assert np.abs(speeds).max() > 0.1
    assert changes.max() <= 10.0 * (1.0 + 1e-6)


def test_an_arm_that_cannot_be_moved_is_seen_and_the_reason_told(monkeypatch: pytest.MonkeyPatch) -> None:
    other = pp.Arm.from_template("Rz", 3)
    made = solver._tracker

    def refuse(asked: Problem, *given: object) -> object:
        if asked.scene is not None and asked.scene.obstacles:
            raise TaskError("the scene", "is too much")
        return made(asked, *given)  # type: ignore[arg-type]

    monkeypatch.setattr(solver, "_tracker", refuse)
    moving = Solver(problem(1), six_modules().straight())
    moving.start()
    session = Session(first_task(other).edited(scene=pp.Scene({"ball": pp.Sphere((9.0, 9.0, 9.0), 0.1)})))
    moving.ask(session.problem._replace(number=2))
    until(lambda: moving.live.number == 2)
    assert moving.live.arm is other
    assert "is too much" in moving.live.verdict.reason
    moving.ask(session.problem._replace(number=3, scene=None))
    until(lambda: moving.live.number == 3)
    assert moving.live.verdict.target is not None
    moving.close()


def test_a_drag_does_not_go_on_in_another_keyframe() -> None:
    session = Session(first_task(pp.Arm.from_template("RyRz", 6)))
    place = session.shape.points[2] + [0.0, 0.02, 0.0]
    curve.move_point(2, place, True, session, keyframe=1)  # a hand was at the second, the first is selected
    assert (session.proposal, session.handle) == (None, None)
    assert "another keyframe" in session.notice.text
    curve.move_point(2, place, True, session, keyframe=session.selected)
    assert session.proposal is not None


def test_linear_algebra_has_one_thread_while_an_editor_is_open() -> None:
    def counts() -> list[int]:
        return [each["num_threads"] for each in threadpool_info() if each["user_api"] == "blas"]

    with threadpool_limits(2, user_api="blas"):
        before = counts()
        opened = Editor(task(), port=PORT)
        try:
            assert counts() == [1] * len(before)
        finally:
            opened.close()
        assert counts() == before
