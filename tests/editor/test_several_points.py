"""Several control points: selected, moved together and to a grid, duplicated and deleted; without a page."""

from __future__ import annotations

import numpy as np
import pytest
from edited_tasks import L, bent_spline, straight_line, task

import pinposture as pp
from pinposture.editor.files import Files, first_task
from pinposture.editor.session import Session
from pinposture.errors import CurveError
from pinposture.task import Keyframe

pytest.importorskip("viser")

from pinposture.editor.ui import curve
from pinposture.editor.ui.page import shortcuts


@pytest.fixture
def session() -> Session:
    """At a keyframe of five control points."""
    bent = Keyframe(bent_spline(), time=1.0, placement="as_is", trim=True)
    return Session(task(Keyframe(straight_line()), bent), selected=1)


def test_points_are_selected_one_after_the_other(session: Session) -> None:
    session.take_hold(2)
    session.take_hold(4, more=True)
    assert (session.handles, session.handle) == ((2, 4), 4)
    session.take_hold(2, more=True)
    session.take_hold(0, more=True)  # at the base: it cannot be moved
    session.take_hold(9, more=True)
    assert session.handles == (4,)
    session.take_hold(4, more=True)
    assert (session.handles, session.handle) == ((), None)
    session.take_hold(0)
    session.take_hold(3, more=True)
    assert session.handles == (3,)
    session.obstacle = "box"
    session.take_all()
    assert (session.handles, session.obstacle) == ((1, 2, 3, 4), None)
    session.take_hold(1)
    assert session.handles == (1,)
    session.take_hold(None)
    assert session.handles == ()


def test_those_that_are_selected_move_together_and_another_one_alone(session: Session) -> None:
    points = session.shape.points.copy()
    session.take_hold(3)
    session.take_hold(2, more=True)
    curve.move_point(3, points[3] + [0, 0, 0.1 * L], True, session)
    assert session.proposal is not None
    assert session.proposal.what == "moved points 3, 4"
    by = (session.shape.points - points)[:, 2]
    assert np.allclose(by, [0, 0, 0.1 * L, 0.1 * L, 0])
    assert session.handles == (3, 2)
    curve.move_point(1, points[1] + [0, 0, 0.1 * L], True, session)
    assert session.proposal.what == "moved point 2"
    assert session.handles == (1,)


def test_an_arrow_key_that_leads_out_of_the_plane_of_the_arm_is_refused() -> None:
    session = Session(first_task(pp.Arm.from_template("Rz", 6)))
    session.take_hold(2)
    keys = {each.label: each.act for each in shortcuts(Files(lambda _: None), lambda _: None)}
    with pytest.raises(CurveError, match="point 3: cannot leave the plane of the arm along z"):
        keys["Move it up (+z)"](session)
    assert session.proposal is None
    keys["Move it ahead (+x)"](session)
    assert session.proposal is not None


def test_points_that_are_dragged_come_to_the_grid(session: Session) -> None:
    points = session.shape.points.copy()
    session.take_all()
    curve.set_grid(0.02, session)
    curve.move_point(2, [0.211, 0.049, -0.031], False, session)
    assert np.allclose(session.shape.points[2], [0.22, 0.04, -0.04])
    assert np.allclose(np.diff(session.shape.points[1:], axis=0), np.diff(points[1:], axis=0))
    curve.move_point(2, [0.211, 0.049, -0.031], False, session, snap=False)  # typed
    assert np.allclose(session.shape.points[2], [0.211, 0.049, -0.031])
    curve.set_grid(0.0, session)
    curve.move_point(2, [0.221, 0.049, -0.031], False, session)
    assert np.allclose(session.shape.points[2], [0.221, 0.049, -0.031])


def test_copies_are_selected_and_all_are_deleted_at_once(session: Session) -> None:
    points = session.shape.points.copy()
    for act in (curve.duplicate_points, curve.delete_points):
        with pytest.raises(CurveError, match="no control point is selected: click on one, or press N"):
            act(session)
    session.take_hold(3)
    session.take_hold(1, more=True)
    curve.duplicate_points(session)
    assert session.proposal is not None
    assert (session.proposal.what, session.handles) == ("duplicated points 2, 4", (2, 5))
    session.take_hold(1)
    session.proposal = None
    session.take_hold(2, more=True)
    curve.delete_points(session)  # too many
    assert (session.proposal, session.handles) == (None, (1, 2))
    assert session.notice.kind == "error"
    session.take_hold(3)
    curve.delete_points(session)
    assert (session.proposal.what, session.handles) == ("deleted point 4", (2,))
    assert np.allclose(session.shape.points[:3], points[:3])
    curve.insert_point(session)
    assert session.handles == (3,)


def test_selected_points_that_a_dropped_proposal_had_are_selected_no_more(session: Session) -> None:
    session.take_all()
    curve.duplicate_points(session)
    assert session.handles == (2, 4, 6, 8)
    curve.move_point(2, np.full(3, np.nan), True, session)
    assert (session.proposal, session.handles) == (None, (2, 4))
    session.take_all()
    curve.duplicate_points(session)
    session.undo()  # there is nothing
    assert (session.proposal, session.handles) == (None, (2, 4))


def test_another_task_begins_without_a_grid(session: Session) -> None:
    curve.set_grid(0.02, session)
    session.replace(task(), None, saved=False)
    assert session.grid == 0.0
