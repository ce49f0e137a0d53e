"""Problems among obstacles: what is drawn, how runs are judged, and that the easy kinds are solved."""

from __future__ import annotations

import numpy as np
import pytest
from sampling import cases

from benchmarks.cases.clutter import CLUTTER_MARGIN, KINDS_OF_CLUTTER, draw_problem
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
    assert run.planned and run.reached, run
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
