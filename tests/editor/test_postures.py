"""Postures that become keyframes: of a dragged tip, clear of the scene, and taught configurations."""

from __future__ import annotations

from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest
from edited_tasks import L, task
from solid_distances import signed_distance

import pinposture as pp
from pinposture.collision import Obstacle
from pinposture.editor.edits import added, removed, reordered, times_of, with_keyframe
from pinposture.editor.postures import add_taught, drag_tip, draw_curve, hold_tip, teach
from pinposture.editor.session import Session
from pinposture.editor.solver import Live, Solver, judge
from pinposture.errors import TaskError
from pinposture.task import Keyframe, Task

pytest.importorskip("viser")

from pinposture.editor.ui.curve import delete_points, insert_point

MARGIN = 0.01 * L
PLACE = L * np.array([0.75, 0.2, 0.25])
BALL = pp.Sphere(tuple(L * np.array([0.45, 0.05, 0.0])), 0.06 * L)
GRID = np.stack(np.meshgrid(*[np.linspace(-0.05, 0.05, 6)] * 3), axis=-1).reshape(-1, 3)
SCAN = pp.Scan(L * (GRID + [0.45, 0.05, 0.0]))


def opened(*obstacles: Obstacle) -> Session:
    scene = (
        pp.Scene({f"o{k}": each for k, each in enumerate(obstacles)}, margin=MARGIN) if obstacles else None
    )
    return Session(task(scene=scene), selected=1)


def judged(session: Session) -> Live:
    problem = session.problem
    live = Solver(problem, problem.arm.straight()).live
    return live._replace(verdict=judge(problem.arm, problem.keyframe, problem.scene))


def sampled(session: Session, q: np.ndarray) -> np.ndarray:
    """Places along the middle lines of the modules."""
    arm = session.arm
    points = np.vstack([arm.chain.base, arm.at(q).points])
    shares = np.linspace(0.0, 1.0, 40)[:, None]
    return np.vstack([a + shares * (b - a) for a, b in pairwise(points)])


@pytest.mark.parametrize("obstacle", [None, BALL, SCAN])
def test_the_tip_comes_to_where_it_was_dragged_clear_of_the_scene(obstacle: Obstacle | None) -> None:
    session = opened() if obstacle is None else opened(obstacle)
    before = session.task
    start = session.arm.straight()
    for share in (0.5, 1.0):
        drag_tip(PLACE * share + (1 - share) * L * np.array([1.0, 0, 0]), start, False, session)
        assert session.task is before
    drag_tip(PLACE, start, True, session)
    live = judged(session)
    session.settle(live)
    target = live.verdict.target
    assert target is not None, live.verdict
    assert target.q is not None
    assert np.linalg.norm(session.arm.at(target.q).points[-1] - PLACE) < 1e-3 * L
    if obstacle is not None:
        assert signed_distance(obstacle, sampled(session, target.q)).min() >= MARGIN
    assert session.history.undoable.startswith("reached for (")
    session.undo()
    assert session.task is before
    assert session.history.undoable == ""


@pytest.mark.parametrize(
    ("place", "reason"), [((2.0, 0, 0), "reaches"), ((0.45, 0.05, 0.0), "it is inside o0")]
)
def test_a_place_that_cannot_be_reached_is_refused_with_the_reason(
    place: tuple[float, float, float], reason: str
) -> None:
    session = opened(BALL)
    before = session.task
    drag_tip(L * np.array(place), session.arm.straight(), True, session)
    assert session.proposal is None
    assert session.task is before
    assert session.notice.kind == "error"
    assert reason in session.notice.text


def test_the_tip_is_held_instead_of_a_point_or_an_obstacle() -> None:
    session = opened(BALL)
    session.take_hold(2)
    hold_tip(session)
    assert (session.handle, session.tip) == (None, True)
    session.take_hold(2)
    assert (session.handle, session.tip) == (2, False)


JOINTS = 0.4 * np.sin(np.arange(12.0))


def with_taught(arm: pp.Arm | None = None) -> Session:
    """A session at a taught keyframe between two curves."""
    frames = list(task().motion)[:3]
    taught = Keyframe(joints=JOINTS, time=1.0, name="taught")
    return Session(task(frames[0], taught, frames[2], arm=arm), selected=1)


def test_a_taught_keyframe_is_taken_and_has_no_points_to_change() -> None:
    session = with_taught()
    live = judged(session)
    before = session.task
    assert live.verdict.mark == "fine"
    assert session.arm.positions(live.verdict.target.q) == pytest.approx(JOINTS)  # type: ignore[union-attr]
    assert len(session.shape.points) == 0
    for act in (
        lambda: session.reshape(lambda arm, shape: shape.moved(arm, 1, (0, 0, 0)), "moved"),
        lambda: insert_point(session),
    ):
        session.say("")
        act()
        assert "keyframe 2: a taught configuration has no control points" in session.notice.text
        assert session.notice.kind == "error"
        assert (session.task, session.proposal, session.handles) == (before, None, ())
    for refused in (session.take_all, lambda: delete_points(session)):
        with pytest.raises(TaskError, match="keyframe 2: a taught configuration has no control points"):
            refused()


def test_a_curve_is_drawn_through_a_taught_posture() -> None:
    session = with_taught()
    draw_curve(session)
    session.settle(judged(session))
    assert session.history.undoable == "drew a curve through keyframe 2"
    keyframe = session.keyframe
    assert (keyframe.name, keyframe.time, len(session.shape.points) > 3) == ("taught", 1.0, True)
    points = session.arm.at(session.arm.configuration(JOINTS)).points
    assert np.abs(points - keyframe.curve.at(keyframe.curve.nearest(points)[0])).max() < 1e-8  # type: ignore
    target = judged(session).verdict.target
    assert target is not None
    assert np.linalg.norm(target.points - points, axis=1).max() < 0.02 * L
    draw_curve(session)
    assert session.notice.text == "keyframe 2 already has a curve"
    session.undo()
    assert session.keyframe.joints == pytest.approx(JOINTS)
    assert session.keyframe.curve is None


def test_the_tip_of_a_taught_keyframe_is_dragged_and_it_stays_taught() -> None:
    session = with_taught()
    drag_tip(PLACE, session.arm.straight(), True, session)
    session.settle(judged(session))
    assert session.keyframe.curve is None
    q = session.arm.configuration(session.keyframe.joints)
    assert np.linalg.norm(session.arm.at(q).points[-1] - PLACE) < 1e-4 * L


def test_a_posture_is_taught_to_a_keyframe_and_added_as_one() -> None:
    session = Session(task(), selected=1)
    before = session.task
    q = session.arm.configuration(JOINTS)
    add_taught(q, session)
    assert (session.selected, len(session.task.motion)) == (2, 5)
    assert session.keyframe.joints == pytest.approx(JOINTS, abs=1e-6)
    assert (session.keyframe.curve, session.keyframe.hold) == (None, 0.0)
    assert times_of(session.task) == [0.0, 1.0, 2.5, 4.5, 6.0]
    assert session.notice.text == "added keyframe 3, taught the present posture"
    session.undo()
    assert (session.selected, session.task) == (1, before)
    teach(q, session)
    assert (session.keyframe.curve, session.keyframe.hold) == (None, 0.5)
    session.undo()
    teach(session.arm.configuration(np.full(12, 9.0)), session)
    assert "joints is 9 rad for joint 1 'm01_j1_y', whose limits are" in session.notice.text
    assert session.task is before


def test_a_tip_task_does_not_change_what_was_taught() -> None:
    session = with_taught()
    session.edit(with_keyframe(1, tip=pp.EndEffector(tuple(PLACE), weight=10.0)), "with a tip")
    drag_tip(PLACE, session.arm.straight(), True, session)
    dragged = session.keyframe.joints
    session.settle(judged(session))
    assert session.task.motion[1].joints == dragged  # type: ignore[index]


@pytest.mark.long
def test_a_task_with_taught_keyframes_is_edited_played_and_saved_as_it_was(tmp_path: Path) -> None:
    file = with_taught().task.save(tmp_path / "task.toml")
    table = "\n# By hand.\n[[keyframes]]\nname = 'by  hand'\ntime = '4500 ms'   # late\n"
    table += (
        f"joints = [{', '.join(f'{np.degrees(x):.2f}' for x in JOINTS)}]".replace("[", "['")
        .replace(", ", " deg', '")
        .replace("]", " deg']\n")
    )
    file.write_text(file.read_text() + table)
    session = Session(Task.load(file), file, selected=1)
    session.edit(reordered(1, 2), "moved", select=2)
    session.edit(with_keyframe(2, name="late", hold=0.25, speed=0.5), "changed")
    session.edit(added(2), "duplicated", select=3)
    assert session.keyframe.joints == pytest.approx(JOINTS)
    session.edit(removed(3), "deleted", select=2)
    session.task.save(file)
    assert "# By hand.\n[[keyframes]]\nname = 'by  hand'\n" in file.read_text()
    assert file.read_text().endswith(table[table.index("joints") :])
    again = Task.load(file)
    assert again.motion == session.task.motion
    motion = again.perform(again.reference())
    assert motion.converged
    for passed, index in ((motion.waypoints[2], 2), (motion.waypoints[3], 3)):
        at = again.arm.positions(motion.q[passed.row])
        assert at == pytest.approx(again.motion[index].joints, abs=1e-6)  # type: ignore[index]
