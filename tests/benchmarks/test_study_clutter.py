"""Problems among obstacles: what is drawn, how runs are judged, and that the easy kinds are solved."""

from __future__ import annotations

import numpy as np
import pytest
from sampling import cases

from benchmarks.cases.clutter import (
    CLUTTER_MARGIN,
    KINDS_OF_CLUTTER,
    THICKNESS,
    WITHOUT_A_WAY,
    draw_problem,
    with_joints,
)
from benchmarks.cases.situations import situation_arm
from benchmarks.studies import repair
from benchmarks.studies.clutter import by_kind, dense_clearance, solve_problem, study_clutter
from pinposture.collision import CollisionModel, Scene, Sphere
from pinposture.control import Geodesic
from pinposture.errors import InvalidValue, UnknownName


@pytest.mark.parametrize("kind", cases(KINDS_OF_CLUTTER, 5))
def test_start_and_goal_are_clear_and_draws_are_repeated(kind: str) -> None:
    arm = situation_arm()
    problem, again = (draw_problem(arm, kind, 4) for _ in range(2))
    np.testing.assert_array_equal([problem.start, problem.target.q], [again.start, again.target.q])
    model = CollisionModel(arm, problem.scene)
    assert min(model.minimum(q).distance for q in (problem.start, problem.target.q)) > CLUTTER_MARGIN
    assert not np.array_equal(problem.start, draw_problem(arm, kind, 5).start)


def test_no_way_leads_past_a_closed_wall() -> None:
    """Where the tip could pass through the plane of the wall, it is too near to where the arm begins."""
    problem = draw_problem(situation_arm(), "closed", 0)
    scene = problem.scene
    assert scene is not None and scene.self_collision and scene.arm_radius == THICKNESS
    above, below = (problem.arm.at(q).points[-1, 2] for q in (problem.start, problem.target.q))
    assert below < 0.0 < above
    along = np.linspace(-problem.arm.length, problem.arm.length, 801)
    plane = np.stack([*np.meshgrid(along, along), np.zeros((801, 801))], axis=-1)
    free = np.ones(plane.shape[:2], dtype=np.bool_)
    for wall in scene.obstacles.values():
        outside = np.maximum(np.abs(plane - wall.center) - 0.5 * np.array(wall.size), 0.0)
        free &= np.linalg.norm(outside, axis=-1) >= THICKNESS + scene.margin
    from_base = np.linalg.norm(plane, axis=-1)
    assert free.any() and from_base[free].max() < 2.0 * THICKNESS + scene.margin
    # The last body is kept from the first one and from each wall.
    model = CollisionModel(problem.arm, scene)
    kept_apart = {frozenset(pair) for pair in model.pairs}
    others = [model.bodies[0], *scene.obstacles]
    assert {frozenset((model.bodies[-1], other)) for other in others} <= kept_apart


def test_problems_are_drawn_for_more_joints_in_the_same_postures() -> None:
    problem = draw_problem(situation_arm(), "closed", 0)
    finer = with_joints(problem, 80)
    assert finer is not None and finer.arm.nv == 80 and finer.scene is problem.scene
    for q, posture in ((problem.start, finer.start), (problem.target.q, finer.target.q)):
        points = finer.arm.at(posture).points
        rough = problem.arm.at(q).points
        apart = np.linalg.norm(points[:, None] - rough, axis=2).min(axis=0)
        assert apart.max() < 0.02
    assert with_joints(problem, problem.arm.nv) is problem
    with pytest.raises(InvalidValue, match="joints"):
        study_clutter(["closed"], 1, joints=41)


@pytest.mark.long
def test_small_arms_meet_what_any_arm_can_meet() -> None:
    (row,) = study_clutter(["balls"], 1, joints=6).rows()
    assert row.planned and row.reached and row.run_clearance > row.margin - 1e-4
    assert 0.5 < row.duration < 10.0
    with pytest.raises(InvalidValue, match="kinds"):
        study_clutter(["hole"], 1, joints=6)


def test_dense_clearance_sees_what_is_between_two_configurations() -> None:
    arm = situation_arm()
    one, other = arm.straight(), arm.straight()
    other[1] = 0.4
    halfway = arm.straight()
    halfway[1] = 0.2
    scene = Scene({"pole": Sphere(tuple(arm.at(halfway).points[-1]), 0.002)}, self_collision=False)
    model = CollisionModel(arm, scene)
    assert min(model.minimum(one).distance, model.minimum(other).distance) > 0.1
    assert dense_clearance(arm, scene, np.array([one, other])) < 0.0


@pytest.mark.long
@pytest.mark.parametrize("kind", cases(dict.fromkeys(["machine", *KINDS_OF_CLUTTER]), 1))
def test_problems_are_solved_with_the_margin_kept(kind: str) -> None:
    run = solve_problem(draw_problem(situation_arm(), kind, 1), Geodesic())
    assert run.planned == run.reached == (kind not in WITHOUT_A_WAY), run
    if kind in WITHOUT_A_WAY:
        assert "no clear path was found" in run.blocked_by
        assert run.run_clearance > run.margin - 1e-4
        return
    assert run.plan_clearance > run.margin - 1e-3
    assert run.run_clearance > run.margin - 1e-4
    assert run.path_length_ratio >= 1.0


def test_the_summary_counts() -> None:
    run = solve_problem(draw_problem(situation_arm(), "posts", 0), Geodesic()).but(kind="posts")
    runs = [run, run.but(reached=False, planned=False, plan_time=run.plan_time + 2.0, found_by="x")]
    (row,) = by_kind(runs)
    assert (row.problems, row.planned, row.reached) == (2, 1, 1)
    assert row.plan_time.median == pytest.approx(run.plan_time + 1.0)
    assert row.found_by == {run.found_by: 1, "x": 1}
    assert row.clearance == pytest.approx(run.run_clearance - run.margin)


@pytest.mark.long
def test_a_path_that_a_ball_cuts_is_repaired_clear() -> None:
    cut = repair.repair_path(1, draw_problem(situation_arm(), "posts", 1), Geodesic()).but(kind="posts")
    assert cut.cut and cut.repaired and cut.room > -1e-4
    assert cut.repaired_length >= cut.planned_length * 0.9
    (row,) = repair.by_kind([cut, cut.but(cut=False)])
    assert (row.cut, row.repaired) == (1, 1)


def test_bad_questions_are_refused() -> None:
    with pytest.raises(UnknownName, match="maze"):
        study_clutter(["maze"], 1)
    with pytest.raises(InvalidValue, match="kinds"):
        study_clutter([], 1)
    with pytest.raises(InvalidValue, match="seeds"):
        study_clutter(["posts"], 0)
