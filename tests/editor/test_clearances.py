"""The clearance that the editor tells, against distances by hand; the pace of new scenes."""

from __future__ import annotations

import time
from functools import partial
from types import SimpleNamespace

import numpy as np
import pytest
from editor.edited_tasks import L, six_modules, task
from editor.page_client import until

import pinposture as pp
from pinposture.collision.scan import Scan
from pinposture.editor.obstacles import change_obstacle, moved
from pinposture.editor.session import NearestObstacle, Session
from pinposture.editor.solver import Solver
from pinposture.editor.surroundings import ClearanceQuery, Surroundings, nearest

THICK = 0.01


def beside(height: float, radius: float = 0.02) -> pp.Scene:
    """A ball above the middle of the straight arm, whose links are taken for bars of `THICK`."""
    middle = np.array([0.5 * L, 0.0, height])
    return pp.Scene({"ball": pp.Sphere(middle, radius)}, margin=0.03, arm_radius=THICK)


def asked(scene: pp.Scene, scans: dict[str, Scan] | None = None) -> ClearanceQuery:
    """For the clearance of the straight arm."""
    arm = six_modules()
    return ClearanceQuery(arm, arm.straight(), scene, scans or {})


@pytest.mark.parametrize("height, level", [(0.2, "clear"), (0.05, "within the margin"), (0.025, "inside")])
def test_distance_and_ends_of_the_line(height, level):
    found = nearest(asked(beside(height)))
    assert found.distance == pytest.approx(height - 0.02 - THICK, abs=1e-6)
    assert found.other == "ball"
    assert found.level == level
    np.testing.assert_allclose(found.on_arm, [0.5 * L, 0, THICK], atol=1e-6)
    np.testing.assert_allclose(found.on_other, [0.5 * L, 0, height - 0.02], atol=1e-6)


def test_links_near_each_other_do_not_hide_obstacles():
    scene = pp.Scene(beside(0.2).obstacles, self_collision=True, arm_radius=THICK)
    assert nearest(asked(scene)).other == "ball"


def test_without_anything_around_there_is_no_clearance():
    assert nearest(asked(pp.Scene())) is None
    assert nearest(asked(pp.Scene(self_collision=False))) is None


def test_an_arm_that_may_pass_through_itself_is_not_inside_itself():
    arm = six_modules()
    curled = arm.configuration(np.full(arm.nv, 1.2))
    inside = nearest(ClearanceQuery(arm, curled, pp.Scene(), {}))
    assert inside.level == "inside" and inside.distance < -0.001
    assert nearest(ClearanceQuery(arm, curled, pp.Scene(self_collision=False), {})) is None


def test_a_scan_that_is_nearer_counts_but_has_no_margin():
    cloud = Scan(np.array([[0.5 * L, 0.0, -0.04], [5.0, 5.0, 5.0]]))
    found = nearest(asked(beside(0.2), {"room.ply": cloud}))
    assert (found.other, found.margin, found.level) == ("room.ply", 0.0, "clear")
    assert found.distance == pytest.approx(0.04 - THICK, abs=1e-6)
    np.testing.assert_allclose(found.on_other, [0.5 * L, 0, -0.04], atol=1e-6)
    assert nearest(asked(beside(0.05), {"room.ply": cloud})).other == "ball"


def test_the_last_that_was_asked_counts_and_what_cannot_be_told_ends_nothing():
    session = Session(task(scene=beside(0.3)))
    live = Solver(session.problem, session.arm.straight()).live
    surroundings = Surroundings(lambda request, key="": None)

    def told(distance: float) -> bool:
        surroundings.watch(session, live)
        return session.nearest is not None and abs(session.nearest.distance - distance) < 1e-6

    try:
        lost = SimpleNamespace(q=np.full(session.arm.nq, np.nan))
        surroundings.watch(session, live._replace(state=lost))
        assert session.nearest is None
        for height in (0.5, 0.4, 0.2):
            session.edit(lambda now, height=height: now.edited(scene=beside(height)), "moved the ball")
            surroundings.watch(session, live)
        until(lambda: told(0.18 - THICK))
    finally:
        surroundings.close()


def test_a_dragged_obstacle_reaches_solver_and_clearance_before_the_drag_ends():
    session = Session(task(scene=beside(0.3)))
    solver = Solver(session.problem, session.arm.straight())
    surroundings = Surroundings(lambda request, key="": request(session))
    asked = [session.number]
    solver.start()

    def turn() -> None:  # what the loop does
        surroundings.watch(session, solver.live)
        if session.number != asked[-1]:
            asked.append(session.number)
            solver.ask(session.problem)
        time.sleep(0.005)

    def told() -> bool:
        turn()
        return solver.live.number == session.number and session.number == session.proposal.number

    try:
        for step in range(1, 41):
            shift = np.array([0.0, 0.0, -0.001 * step])
            change_obstacle("ball", partial(_shift, shift), "moved ball", False, session)
            turn()
        until(told)
        assert solver.live.number > 1
        assert session.task.scene.obstacles["ball"].center[2] == pytest.approx(0.3)
        assert session.problem.scene.obstacles["ball"].center[2] == pytest.approx(0.26)
    finally:
        surroundings.close()
        solver.close()


def test_nearest_tells_how_it_is():
    at = np.zeros(3)
    assert NearestObstacle(-1e-9, "a", "b", at, at, 0.0).level == "inside"
    assert NearestObstacle(0.0, "a", "b", at, at, 0.01).level == "within the margin"
    assert NearestObstacle(0.01, "a", "b", at, at, 0.01).level == "clear"


def _shift(shift, obstacle):
    return moved(obstacle, shift)
