"""Planning among obstacles: random problems of ten kinds, planned, run, and judged."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping, Sequence
from functools import partial
from itertools import pairwise
from math import ceil
from pathlib import Path
from time import process_time
from typing import TYPE_CHECKING, Annotated, Any

import numpy as np
from numpy.typing import NDArray

from benchmarks.cases.clutter import (
    FOR_ANY_ARM,
    KINDS_OF_CLUTTER,
    WITHOUT_A_WAY,
    draw_problem,
    with_joints,
)
from benchmarks.cases.situations import situation_arm
from benchmarks.harness import Case, Problem, Row, Study, check_study, count, spread, summarise
from benchmarks.report import Report, SeedOption, StudyOptions, split_names, spread_cell, table
from benchmarks.studies.runs import one_line
from pinposture._validation import require_known
from pinposture.arm import Arm
from pinposture.cli.inputs import MOST_RUNS, MOTION
from pinposture.cli.output import examples, print_note
from pinposture.collision import CollisionModel, Scene
from pinposture.control import Controller, Geodesic, JointPath, Limits, plan, retime
from pinposture.errors import InvalidValue
from pinposture.motion import Run, track
from pinposture.motion.run import path_length_ratio

if TYPE_CHECKING:
    from matplotlib.figure import Figure

Array = NDArray[np.float64]

DENSE_TURN = 0.01
"""Joint motion between samples at which the clearance of a path is checked [rad]."""

MAX_RUN_STEPS = 6000

LEAST_JOINTS, JOINTS, MOST_JOINTS = 6, 40, 1000
"""Least, usual and largest number of joints; the second is that of `situation_arm`."""

RUN_LIMITS = Limits(step=None, velocity=1.0, acceleration=5.0, dt=0.02)


def study_clutter(
    kinds: Sequence[str] = tuple(KINDS_OF_CLUTTER), seeds: int = 10, first_seed: int = 0, joints: int = JOINTS
) -> Study:
    """Solve problems of several kinds with an arm of 1 m.

    Args:
        kinds: some of `KINDS_OF_CLUTTER`.
        seeds: number of problems of each kind.
        first_seed: seed of the first.
        joints: number of joints of the arm, even; with more than 40, some postures are impossible, and their
            problems do not count; with fewer, only balls and posts can be drawn.

    Raises:
        InvalidValue: no kind, or invalid numbers.
        UnknownName: there is no such kind.
    """
    cases = cases_of_clutter(kinds, seeds, first_seed, joints)
    return Study(cases, [Geodesic()], _solve_drawn)


def cases_of_clutter(kinds: Sequence[str], seeds: int, first_seed: int, joints: int = JOINTS) -> list[Case]:
    """Return problems for an arm of 1 m; arguments and errors as for `study_clutter`."""
    check_study(first_seed, seeds=seeds, kinds=kinds)
    if joints % 2 or joints < LEAST_JOINTS:
        raise InvalidValue("joints", joints, f"an even number, {LEAST_JOINTS} or more")
    for kind in kinds:
        require_known("kind of clutter", kind, KINDS_OF_CLUTTER)
        if joints < JOINTS and kind not in FOR_ANY_ARM:
            raise InvalidValue("kinds", kind, f"with fewer than {JOINTS} joints: {', '.join(FOR_ANY_ARM)}")
    return [
        Case({"kind": kind, "seed": seed}, partial(_draw, kind, seed, joints))
        for kind in kinds
        for seed in range(first_seed, first_seed + seeds)
    ]


def _draw(kind: str, seed: int, joints: int) -> Problem | None:
    if joints < JOINTS:
        return draw_problem(Arm.from_template("RyRz", joints // 2, (1.0 / joints, 1.0 / joints)), kind, seed)
    return with_joints(draw_problem(situation_arm(), kind, seed), joints)


def _solve_drawn(problem: Problem | None, controller: Controller) -> Row | None:
    return None if problem is None else solve_problem(problem, controller)


def solve_problem(problem: Problem, controller: Controller) -> Row:
    """Plan and run a problem, and evaluate both.

    Returns:
        found_by: how the path was found, see `JointPath.found_by`.
        planned: whether the plan is reported as collision-free.
        blocked_by: what it comes too close to, if not.
        first_time: processor time until a first clear path is known, or until planning ends [s].
        plan_time: processor time for planning [s].
        path_length_ratio: path length of the control points on the plan relative to straight lines.
        duration: duration of the plan, from rest to rest [s].
        plan_clearance: smallest distance on the plan, every 0.01 rad [m].
        reached: whether `track` reached the goal within its velocity and acceleration limits.
        reason: why the run ended.
        run_clearance: smallest distance in the run, every 0.01 rad [m].
        margin: the distance to keep [m].
    """
    arm, start, target, scene = problem
    assert scene is not None
    state = arm.at(start)
    clear: list[float] = []

    def note(_: str, __: float, best: JointPath | None) -> None:
        if best is not None:
            clear.append(process_time() - began)

    began = process_time()
    path = plan(state, target, scene, RUN_LIMITS, progress=note)
    took = process_time() - began
    run = run_problem(problem, controller)
    points = np.array([arm.chain_at(q).points for q in path.configurations])
    return Row(
        found_by=path.found_by,
        planned=not path.blocked_by,
        blocked_by=path.blocked_by,
        first_time=min([*clear, took]),
        plan_time=took,
        path_length_ratio=path_length_ratio(points),
        duration=retime(path, RUN_LIMITS).duration,
        plan_clearance=dense_clearance(arm, scene, path.configurations),
        reached=run.converged and run.excess is None,
        reason=one_line(run.reason),
        run_clearance=dense_clearance(arm, scene, run.q),
        margin=scene.margin,
    )


def run_problem(problem: Problem, controller: str | Controller = "geodesic") -> Run:
    """Run a problem within velocity and acceleration limits."""
    arm, start, target, scene = problem
    return track(arm, target, start, controller, RUN_LIMITS, scene=scene, max_steps=MAX_RUN_STEPS)


def dense_clearance(arm: Arm, scene: Scene, q: Array) -> float:
    """Return the smallest distance on the straight motions between configurations, (N, nq) [m].

    Apart from the distance computation, this is independent of the checks during planning.
    """
    model, least = CollisionModel(arm, scene), np.inf
    for one, other in pairwise(q):
        change = np.asarray(arm.difference(one, other))
        count = max(ceil(float(np.abs(change).max()) / DENSE_TURN), 1)
        shares = np.arange(1, count + 1)[:, None] / count
        least = min(least, model.minimum_along(arm.checked(one), shares * change).distance)
    return float(least)


def by_kind(rows: Sequence[Row]) -> list[Row]:
    """Summarise problems by kind.

    Returns:
        For each: the number of problems, of those planned, and of those reached; the smallest distance in
        any run, minus the margin (clearance) [m]; the spreads of the times for a first path and for
        planning, of path length ratio and duration; and the number of plans found by each method.
    """
    return summarise(
        rows,
        ["kind"],
        problems=len,
        planned=count(lambda row: row.planned),
        reached=count(lambda row: row.reached),
        clearance=lambda rows: min(row.run_clearance - row.margin for row in rows),
        first_time=spread("first_time"),
        plan_time=spread("plan_time"),
        path_length_ratio=spread("path_length_ratio"),
        duration=spread("duration"),
        found_by=lambda rows: dict(Counter("no way" if row.blocked_by else row.found_by for row in rows)),
    )


_COLUMNS = {
    "kind": lambda row: row.kind,
    "planned": lambda row: f"{row.planned} of {row.problems}",
    "reached": lambda row: f"{row.reached} of {row.problems}",
    "room [mm]": lambda row: f"{1e3 * row.clearance:.2f}",
    "first [s]": spread_cell("first_time", ".3f"),
    "planning [s]": spread_cell("plan_time", ".2f"),
    "path": spread_cell("path_length_ratio", ".2f"),
    "lasts [s]": spread_cell("duration", ".1f"),
    "found by": lambda row: ", ".join(f"{name} {count}" for name, count in row.found_by.items()),
}


@examples(
    "make study STUDY=clutter -- --kinds hole,shelf --seeds 3",
    "make study STUDY=clutter -- --seeds 50 --jobs -1 -o out/clutter",
)
def run(
    *,
    kinds: Annotated[
        str | None,
        MOTION(
            "Some of: balls, posts, hole, two-walls, shelf, corner, pipe, machine, coil, closed; else all.",
            "NAME,...",
        ),
    ] = None,
    seeds: Annotated[int, MOTION("Number of problems of each kind.", "N", max=MOST_RUNS)] = 10,
    seed0: SeedOption = 0,
    joints: Annotated[
        int, MOTION("Number of joints, even, 6 or more.", "N", min=LEAST_JOINTS, max=MOST_JOINTS)
    ] = JOINTS,
    options: StudyOptions,
) -> None:
    """Plan and run motions of an arm of RyRz modules, 1 m, past obstacles.

    40 balls; 30 posts; a hole of 15 cm in a wall; two walls with offset holes; a shelf with 16 bays; a narrow
    corner; a pipe with two bends; a scanned machine with a hole in front; the arm itself, coiled; a closed
    wall about the base, with the goal on the other side, where no way exists. Start and goal are drawn until
    they are clear, by code that does not plan. A third of the starts are inside the hole, the pipe or the
    machine.

    Arms of fewer than 40 joints meet balls and posts only. Room is the smallest distance in runs, every
    0.01 rad, minus the margin. Median (90th percentile) are the processor times until a first clear path is
    known and for the plan, and the path length ratio and the duration of the plan.
    Problems that are unsolved, though a way exists, are listed, and those that are solved though none does.
    With -o, an animation of the first problem of each kind is also saved.
    """
    from pinposture.viz import save_html

    names = split_names("--kinds", kinds, KINDS_OF_CLUTTER)
    rows = options.run(study_clutter(names, seeds, seed0, joints), "problem")
    summary = by_kind(rows)
    arm, folder = situation_arm(), options.output
    shown = {} if folder is None else {each: run_problem(draw_problem(arm, each, seed0)) for each in names}
    options.write(
        Report(
            rows,
            {
                "study": "clutter",
                "kinds": names,
                "seeds": seeds,
                "seed0": seed0,
                "joints": joints,
                "rows": summary,
            },
            [table(_COLUMNS, summary)],
            {"clutter": lambda _: draw_clutter(shown)},
            warnings=[
                f"{row.kind}, seed {row.seed}: {row.blocked_by or row.reason}"
                for row in rows
                if row.reached == (row.kind in WITHOUT_A_WAY)
            ],
        )
    )
    for name, motion in shown.items():
        print_note(f"wrote {save_html(arm, motion, (folder or Path()) / f'{name}.html')}")


def draw_clutter(runs: Mapping[str, Run]) -> Figure:
    """Draw a run for each kind of clutter: start, goal and postures between them."""
    from matplotlib.figure import Figure

    from pinposture.viz.postures import plot_postures

    columns = min(3, len(runs))
    rows = -(-len(runs) // columns)
    height = 2.7 * rows + 0.7
    figure = Figure(figsize=(2.9 * columns, height))
    figure.subplots_adjust(0.0, 0.7 / height, 1.0, 0.97, 0.0, 0.05)
    entries: dict[str, Any] = {}
    for number, (kind, run) in enumerate(runs.items()):
        ax = figure.add_subplot(rows, columns, number + 1, projection="3d")
        plot_postures(run, ax)
        labelled = zip(*ax.get_legend_handles_labels(), strict=True)
        entries |= {label: each for each, label in labelled if not label.startswith("obstacle")}
        ax.get_legend().remove()
        ax.set_axis_off()
        ax.set_title(kind, y=0.95)
    figure.legend(entries.values(), entries.keys(), loc="lower center", ncols=3, frameon=False)
    return figure
