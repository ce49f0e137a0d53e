"""The tip, dragged: where it comes to, what it keeps clear of, and what is refused."""

from __future__ import annotations

from itertools import pairwise

import numpy as np
import pytest
from edited_tasks import L, task
from solid_distances import signed_distance

import pinposture as pp
from pinposture.collision import Obstacle
from pinposture.editor.session import Session
from pinposture.editor.solver import Live, Solver, judge
from pinposture.editor.tip import drag_tip, hold_tip

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
    before, start = session.task, session.arm.straight()
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
