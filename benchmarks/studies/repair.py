"""Repair of planned paths that a new obstacle cuts: how soon a clear path is known again."""

from __future__ import annotations

from collections.abc import Sequence
from functools import partial
from time import perf_counter
from typing import Annotated

import numpy as np
from numpy.typing import NDArray

from benchmarks.cases.clutter import KINDS_WITH_A_WAY
from benchmarks.harness import Problem, Row, Study, count, spread, summarise
from benchmarks.report import Report, SeedOption, StudyOptions, split_names, spread_cell, table
from benchmarks.studies.clutter import RUN_LIMITS, cases_of_clutter, dense_clearance
from pinposture.cli.inputs import MOST_RUNS, MOTION
from pinposture.cli.output import examples
from pinposture.collision import CollisionModel, Scene, Sphere
from pinposture.control import Controller, Geodesic, JointPath, plan, retime
from pinposture.control.planner.avoidance import Avoidance
from pinposture.control.planner.damped_least_squares import PlanningProblem
from pinposture.control.planner.plan import repair
from pinposture.errors import no_warnings

Array = NDArray[np.float64]

BALL = 0.05
"""Radius of the ball [m]; the arm is 1 m long."""

SPARE = 0.003
"""Clearance of start and goal from the ball beyond the margin [m]."""

MAX_DRAWS = 200
"""Most draws of a ball."""


def study_repair(kinds: Sequence[str] = KINDS_WITH_A_WAY, seeds: int = 10, first_seed: int = 0) -> Study:
    """Cut paths through clutter, of the kinds and seeds of `study_clutter`, and repair them.

    Raises:
        InvalidValue: no kind, or invalid numbers.
        UnknownName: there is no such kind.
    """
    cases = cases_of_clutter(kinds, seeds, first_seed)
    return Study(cases, [Geodesic()], partial(repair_path, first_seed))


def repair_path(seed: int, problem: Problem, controller: Controller) -> Row:
    """Plan a path, put a ball on it, and repair the path.

    Returns:
        cut: whether a ball was found that leaves start and goal clear.
        repaired: whether the path was repaired.
        found_by: how, see `JointPath.found_by`.
        repair_time: wall time until the repaired path is known [s]; infinite if it is not.
        plan_time: wall time of a new plan [s].
        repaired_length: length of the repaired path relative to that before, in the metric of the planner.
        planned_length: the same of the new plan.
        room: smallest distance on the repaired path, and on the curve through its waypoints, every 0.01 rad,
            minus the margin [m].
    """
    arm, start, target, scene = problem
    state = arm.at(start)
    before = plan(state, target, scene, RUN_LIMITS)
    cut = None if before.blocked_by or scene is None else with_ball(before, scene, seed)
    nothing = {"found_by": "", "repaired_length": np.nan, "planned_length": np.nan, "room": np.nan}
    if cut is None:
        return Row(cut=False, repaired=False, repair_time=np.nan, plan_time=np.nan, **nothing)
    CollisionModel.prepare(arm, cut)
    bounds = RUN_LIMITS.for_arm(arm)
    began = perf_counter()
    avoidance = Avoidance.of(cut, before.objective, bounds)
    path = repair(
        PlanningProblem(before.objective, state.chain_state, bounds.position_limits, avoidance),
        before.offsets,
    )
    repaired_at = perf_counter()
    planned = plan(state, target, cut, RUN_LIMITS)
    plan_time = perf_counter() - repaired_at
    if path is None:
        return Row(cut=True, repaired=False, repair_time=np.inf, plan_time=plan_time, **nothing)
    ways = path.configurations, retime(path, RUN_LIMITS).configurations
    return Row(
        cut=True,
        repaired=True,
        found_by=path.found_by,
        repair_time=repaired_at - began,
        plan_time=plan_time,
        repaired_length=path.length / before.length,
        planned_length=np.nan if planned.blocked_by else planned.length / before.length,
        room=min(dense_clearance(arm, cut, way) for way in ways) - cut.margin,
    )


def with_ball(path: JointPath, scene: Scene, seed: int) -> Scene | None:
    """Return a scene with a ball about a control point on the way, away from both ends; None if none fits."""
    arm = path.arm
    rng = np.random.default_rng(seed)
    for _ in range(MAX_DRAWS):
        middle = arm.at(path.configuration(rng.uniform(0.3, 0.7) * path.end))
        center = middle.points[rng.integers(arm.n_modules // 3, arm.n_modules)]
        others = {**scene.obstacles, "ball": Sphere(tuple(center), BALL)}
        cut = Scene(others, self_collision=scene.self_collision, margin=scene.margin)
        with no_warnings():
            model = CollisionModel(arm, cut)
        ends = path.start, path.configuration(path.end)
        if min(model.minimum(q).distance for q in ends) > scene.margin + SPARE:
            return cut
    return None


def by_kind(rows: Sequence[Row]) -> list[Row]:
    """Summarise repairs by kind: how many paths were cut and repaired, times, lengths, and the least room."""
    return summarise(
        [row for row in rows if row.cut],
        ["kind"],
        cut=len,
        repaired=count(lambda row: row.repaired),
        repair_time=spread("repair_time"),
        plan_time=spread("plan_time"),
        repaired_length=spread("repaired_length"),
        planned_length=spread("planned_length"),
        room=lambda own: min((row.room for row in own if row.repaired), default=np.inf),
    )


_COLUMNS = {
    "kind": lambda row: row.kind,
    "repaired": lambda row: f"{row.repaired} of {row.cut}",
    "repair [s]": spread_cell("repair_time", ".3f"),
    "new plan [s]": spread_cell("plan_time", ".2f"),
    "length": spread_cell("repaired_length", ".2f"),
    "of a new plan": spread_cell("planned_length", ".2f"),
    "room [mm]": lambda row: f"{1e3 * row.room:.2f}",
}


@examples("make study STUDY=repair -- --kinds hole,shelf --seeds 3")
def run(
    *,
    kinds: Annotated[
        str | None,
        MOTION("Kinds of clutter, as for the study of clutter; else all.", "NAME,..."),
    ] = None,
    seeds: Annotated[int, MOTION("Number of problems of each kind.", "N", max=MOST_RUNS)] = 10,
    seed0: SeedOption = 0,
    options: StudyOptions,
) -> None:
    """Cut planned paths through clutter by a ball of 5 cm, and repair them.

    The ball is about a control point on the way, where it leaves start and goal clear. Times until a clear
    path is known again, by repair and by a new plan, and lengths relative to the path before are median
    (90th percentile). Room is the smallest distance on a repaired path and the curve through it, every 0.01
    rad, minus the margin.
    """
    names = split_names("--kinds", kinds, KINDS_WITH_A_WAY)
    rows = options.run(study_repair(names, seeds, seed0), "problem")
    summary = by_kind(rows)
    options.write(
        Report(
            rows,
            {"study": "repair", "kinds": names, "seeds": seeds, "seed0": seed0, "rows": summary},
            [table(_COLUMNS, summary)],
            {},
            warnings=[
                f"{row.kind}, seed {row.seed}: not repaired" for row in rows if row.cut and not row.repaired
            ],
        )
    )
