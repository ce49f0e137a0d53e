"""Tasks in phases in the editor: the keyframes of one are edited, the others are shown and kept."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator
from dataclasses import replace
from pathlib import Path
from queue import SimpleQueue
from types import SimpleNamespace

import numpy as np
import pytest
from editor.edited_tasks import task as edited_task

import pinposture as pp
from pinposture.editor import edits
from pinposture.editor.edits import passes_of
from pinposture.editor.files import Files
from pinposture.editor.phases import EditedPhase, editable
from pinposture.editor.session import Session
from pinposture.editor.ui.keyframes import about
from pinposture.editor.ui.phases import PhasePlanner, rename_phase
from pinposture.editor.ui.player import _schedule
from pinposture.errors import InvalidValue, PostureError, TaskError

FILE = Path(__file__).parents[2] / "examples" / "tasks" / "inspection.toml"
SHORT = """
version = 1
kind = "phases"   # kept

[arm]
template = "RyRz"
modules = 6
feed = { stroke = "40 cm" }

[[phases]]        # along a path
name = "in"

[phases.leader]
path = { type = "line", a = [0, 0, 0], b = [0.2, 0, 0] }
speed = 0.1

[[phases]]
name = "turn"     # edited

[[phases.keyframes]]
name = "left"
duration = "2 s"
joints = [0.2, 0, 0.1, 0, 0.1, 0, 0.1, 0, 0.1, 0, 0.1, 0, 0.1]

[[phases]]
withdraw = { speed = "5 cm/s" }
"""


@pytest.fixture
def file(tmp_path: Path) -> Path:
    path = tmp_path / "task.toml"
    path.write_text(SHORT)
    return path


def test_the_first_keyframe_is_where_the_phase_before_ends(file: Path) -> None:
    task = pp.Task.load(file)
    view = editable(task)
    assert isinstance(view, EditedPhase)
    first, left = edits.keyframes_of(view)
    ended = task.reference()
    inside = next(waypoint.row for waypoint in ended.waypoints if waypoint.name == "in: inside")
    assert first.joints == pytest.approx(task.arm.positions(ended.configuration(inside)))
    assert left.name == "left"
    assert edits.times_of(view) == [0.0, 2.0]
    assert "Keyframe 1 is where the phase before ends" in about(left, view)
    assert editable(view.edited(motion=view.motion)).motion == view.motion


def test_a_session_opens_edits_and_saves_without_loss(file: Path) -> None:
    session = Session(pp.Task.load(file), file)
    files = Files(lambda request: None, file)
    try:
        files.save(session)
        assert file.read_text() == SHORT
        session.select(1)
        session.edit(edits.retimed(1, 3.5), "the time")
        files.save(session)
        session.edit(edits.retimed(0, 1.0), "the time")  # of the end of the phase before
    finally:
        files.close()
    assert session.notice.kind == "error"
    assert file.read_text() == SHORT.replace('"2 s"', "3.5")
    again = pp.Task.load(file)
    assert again.motion[1].motion[0].duration == 3.5
    assert again.motion[0] == pp.Task.load(file).motion[0]


def test_what_does_not_belong_to_the_phase_cannot_be_changed(file: Path) -> None:
    view = editable(pp.Task.load(file))
    first, left = edits.keyframes_of(view)
    for motion in ((left, replace(left, duration=1.0)), (replace(first, hold=1.0), left), (left, first)):
        with pytest.raises(TaskError, match="keyframe 1"):
            view.edited(motion=motion)
    with pytest.raises(InvalidValue, match="repeat"):
        view.edited(repeat=2)


def test_more_keyframes_and_obstacles_are_saved(file: Path) -> None:
    view = editable(pp.Task.load(file))
    first, left = edits.keyframes_of(view)
    right = replace(left, name="right", joints=tuple(-np.array(left.joints)))
    scene = pp.Scene({"ball": pp.Sphere((0.0, 1.0, 0.0), 0.1)})
    assert isinstance(view, EditedPhase)
    low = np.r_[0.2, np.array(right.joints)[1:]]
    view.edited(motion=(first, left, replace(right, joints=tuple(low))), scene=scene).save(file)
    again = pp.Task.load(file)
    assert [each.name for each in again.motion[1].motion] == ["left", "right"]
    assert again.scene == scene
    assert [each.name for each in again.motion] == ["in", "turn", ""]
    assert all(word in file.read_text() for word in ("# kept", "# along a path", "# edited"))


def test_every_phase_is_shown_by_the_postures_in_which_it_begins_and_ends(file: Path) -> None:
    task = pp.Task.load(file)
    whole = task.reference()
    ends = {waypoint.name: whole.configuration(waypoint.row) for waypoint in whole.waypoints}
    here = editable(task, 0)
    assert isinstance(here, EditedPhase)
    begin, end = edits.keyframes_of(here)
    assert begin.joints == pytest.approx(task.arm.positions(whole.configuration(0)))
    assert end.joints == pytest.approx(task.arm.positions(ends["in: inside"]))
    assert np.allclose(here.path.at([0.0, 0.2]), [[0.35, 0.0, 0.0], [0.55, 0.0, 0.0]])  # from the tip on
    out = editable(task, 2)
    assert isinstance(out, EditedPhase)
    assert edits.keyframes_of(out)[1].joints == pytest.approx(begin.joints, abs=1e-9)
    assert out.ends == pytest.approx(whole.duration)
    with pytest.raises(TaskError, match="phase 1 'in': has no keyframes"):
        here.edited(motion=(*here.motion, replace(end, duration=1.0)))


def test_choosing_a_phase_is_no_change_and_changes_of_any_phase_are_saved(file: Path) -> None:
    posted: list[object] = []
    session = Session(pp.Task.load(file), file)
    planner = PhasePlanner(lambda request, key="": posted.append(request))

    def planned(before: pp.Task) -> None:
        while not posted:
            time.sleep(0.01)
        posted.pop()(session)  # type: ignore[operator]
        assert session.task is not before, session.notice.text

    before = session.task
    planner.choose(0, session)
    planned(before)
    assert not session.changed
    assert session.whole is before.whole
    before = session.task
    planner.change({"speed": 0.2}, "speed 200 mm/s", session)
    planned(before)
    assert session.changed
    assert edits.times_of(session.task)[1] == pytest.approx(edits.times_of(before)[1] / 2, rel=0.1)
    session.task.save(file)
    assert file.read_text() == SHORT.replace("speed = 0.1", "speed = 0.2")
    rename_phase("inwards", session)
    assert [each.name for each in session.whole.motion] == ["inwards", "turn", ""]
    for _ in range(3):
        session.undo()
    assert not session.changed
    assert edits.keyframes_of(session.task)[1].name == "left"


@pytest.fixture
def arranged(file: Path) -> Iterator[tuple[Session, Callable[[str], None]]]:
    """A session, and what a button for phases does in it."""
    posted: SimpleQueue[Callable[[Session], object]] = SimpleQueue()
    session = Session(pp.Task.load(file), file)
    planner = PhasePlanner(lambda request, key="": posted.put(request))

    def press(action: str) -> None:
        planner.arrange(action, session)
        posted.get(timeout=60.0)(session)

    yield session, press


def phase_names(session: Session) -> list[str]:
    return [each.name for each in session.whole.motion]


@pytest.mark.soak
def test_a_phase_is_added_moved_deleted_and_all_that_undone(
    arranged: tuple[Session, Callable[[str], None]], file: Path
) -> None:
    session, press = arranged
    first = session.whole
    press("Add")
    assert phase_names(session) == ["in", "turn", "", ""]
    assert isinstance(session.task, EditedPhase)
    assert session.task.index == 2
    assert session.whole.motion[2].motion == first.motion[1].motion
    rename_phase("again", session)
    press("Earlier")
    assert phase_names(session) == ["in", "again", "turn", ""]
    session.task.save(file)
    again = pp.Task.load(file)
    assert list(again.motion) == list(session.whole.motion)
    assert all(word in file.read_text() for word in ("# kept", "# along a path"))
    press("Later")
    press("Delete")
    assert phase_names(session) == ["in", "turn", ""]
    assert session.task.index == 1
    for _ in range(5):
        session.undo()
    assert session.whole is first
    assert not session.changed or session.whole == first


def test_the_only_phase_stays_where_it_is_and_a_way_out_needs_a_way_in(file: Path) -> None:
    task = pp.Task.load(file)
    inwards, _, out = task.motion
    planner = PhasePlanner(lambda request, key="": None)
    session = Session(task.edited(motion=(inwards,)))
    before = session.task
    for action, words in (("Delete", "only"), ("Earlier", "first"), ("Later", "last")):
        with pytest.raises(TaskError, match=f"phase 1 'in': is the {words} one"):
            planner.arrange(action, session)
    assert session.task is before
    session = Session(task.edited(motion=(inwards, out)))
    before = session.task
    with pytest.raises(PostureError, match="phase 1"):
        planner.arrange("Delete", session)
    assert session.task is before


def test_a_task_of_keyframes_has_no_phases_to_arrange() -> None:
    session = Session(edited_task())
    before = session.task
    PhasePlanner(lambda request, key="": None).arrange("Add", session)
    assert session.task is before


def test_a_phase_that_cannot_be_planned_changes_nothing(file: Path) -> None:
    posted: list[object] = []
    session = Session(pp.Task.load(file), file)
    session.take_up(editable(session.whole, 0), 0)
    planner = PhasePlanner(lambda request, key="": posted.append(request))
    before = session.task
    planner.change({"depth": 5.0}, "depth 5000 mm", session)
    while not posted:
        time.sleep(0.01)
    posted.pop()(session)  # type: ignore[operator]
    assert session.task is before
    assert session.notice.kind == "error"
    assert "depth" in session.notice.text


@pytest.mark.long
def test_all_phases_are_performed_and_stand_on_the_timeline(file: Path) -> None:
    session = Session(pp.Task.load(file), file)
    motion = session.whole.perform()
    assert motion.converged
    playback = session.playback
    playback.motion = motion
    duration, drawn = _schedule(session.task, playback)
    assert duration == motion.time[-1]
    assert [each.at.keyframe for each in drawn] == [0, 1]
    places = {place.name: place.reached for place in motion.waypoints}
    assert drawn[0].at.time == pytest.approx(places["in: inside"], abs=0.05)
    assert drawn[1].at.time == pytest.approx(places["turn: left"])


@pytest.mark.long
def test_keyframes_of_phases_that_are_not_reached_stay_on_the_timeline(file: Path) -> None:
    task = pp.Task.load(file)
    whole = task.perform(progress=lambda *_: True)
    assert whole.run.status == "stopped"
    for index in range(3):
        phase = editable(task, index)
        duration, drawn = _schedule(phase, SimpleNamespace(motion=whole, lasting=float(whole.time[-1])))
        assert [each.reached for each in drawn] == [index == 0, False]
        times = [each.at.time for each in drawn]
        assert 0.0 <= times[0] < times[1] <= duration
        assert times[1] - times[0] == pytest.approx(passes_of(phase)[1].time, abs=0.1)


def test_a_task_without_keyframes_in_any_phase_is_shown_from_its_first_phase(file: Path) -> None:
    task = pp.Task.load(file)
    view = editable(task.edited(motion=(task.motion[0], task.motion[2])))
    assert isinstance(view, EditedPhase)
    assert view.index == 0


@pytest.mark.long
def test_the_example_is_saved_to_the_last_byte(tmp_path: Path) -> None:
    kept = editable(pp.Task.load(FILE)).save(tmp_path / "inspection.toml")
    assert kept.read_text() == FILE.read_text()
