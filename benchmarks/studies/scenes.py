"""Runs among obstacles: is the margin kept, and the target reached, or the obstacle named?"""

from __future__ import annotations

import re
from collections.abc import Sequence
from functools import partial
from time import perf_counter
from typing import Annotated

import numpy as np

from benchmarks.cases.situations import SITUATIONS, Situation, draw_situation, situation_arm, situation_named
from benchmarks.harness import (
    Case,
    Problem,
    Row,
    Study,
    check_study,
    count,
    distinct,
    largest,
    spread,
    summarise,
)
from benchmarks.report import Report, SeedOption, StudyOptions, split_names, spread_cell, table
from benchmarks.studies.runs import arrived, drive, final_error, one_line
from pinposture.arm import Arm
from pinposture.cli.inputs import MOST_RUNS, MOTION
from pinposture.cli.output import examples
from pinposture.collision import CollisionModel, Scene
from pinposture.control import Controller, Geodesic
from pinposture.motion import Run
from pinposture.placement import Target

SAMPLES_OF_A_STEP = 10
"""Number of places on each step at which the distance is evaluated, including its end."""

DISTANCE_ROUNDING = 1e-9
"""Violation of the margin that counts as rounding error [m]."""


def study_scenes(scenes: Sequence[str] = tuple(SITUATIONS), seeds: int = 10, first_seed: int = 0) -> Study:
    """Run the spatial arm of 20 modules among obstacles, with the controller that can avoid them.

    |dq| <= 0.1 rad per step, at most 400 steps, until the mean point error is within 1e-6 of the arm length.

    Args:
        scenes: names of situations, see `SITUATIONS`.
        seeds: number of runs for each.
        first_seed: seed of the first.

    Raises:
        InvalidValue: no scene, or invalid numbers.
        UnknownName: there is no such scene.
    """
    check_study(first_seed, seeds=seeds, scenes=scenes)
    arm = situation_arm()
    cases = [
        Case({"scene": situation_named(name).name, "seed": seed}, partial(_draw, arm, name, seed))
        for name in scenes
        for seed in range(first_seed, first_seed + seeds)
    ]
    return Study(cases, [Geodesic()], _measure)


Drawn = tuple[Situation, Problem, int]
"""A situation, a problem, and the number of draws that were not as clear as required."""


def _draw(arm: Arm, name: str, seed: int) -> Drawn:
    situation = situation_named(name)
    draw = draw_situation(arm, situation, seed)
    target = Target.from_configuration(arm, draw.goal)
    return situation, Problem(arm, draw.start, target, situation.scene), draw.refused


def _measure(drawn: Drawn, controller: Controller) -> Row:
    situation, problem, refused = drawn
    began = perf_counter()
    run = drive(problem, controller)
    return measure_scene_run(run, situation, refused, perf_counter() - began)


def measure_scene_run(run: Run, situation: Situation, refused: int = 0, seconds: float = 0.0) -> Row:
    """Measure a run, given the number of rejected draws and the wall time [s].

    Distances are computed again, independently of the run.

    Returns:
        refused: number of starts and targets rejected as not clear enough.
        reachable: whether the target configuration keeps the margin.
        status: how the run ended, as `Run.status`.
        reason: explanation of the status on one line.
        blamed: obstacles, or bodies of the arm, named in the reason, separated by commas.
        steps: number of steps.
        error: mean point error at the end, relative to the arm length.
        margin: the distance to keep [m].
        start: smallest distance at the start [m]; like the following, negative in penetration.
        closest: smallest distance at the start and at `SAMPLES_OF_A_STEP` places of every step [m].
        end: smallest distance at the end [m].
        loss: largest amount by which the distance within a step fell below the smaller of the margin and the
            distance before the step [m]; 0 if it never did.
        path: path length of all control points relative to straight lines from start to end.
        escaping: share of steps in which the controller lets the posture error rise.
        seconds: wall time of the run [s].
    """
    around, margin = CollisionModel(run.arm, situation.scene), situation.scene.margin
    at = np.array([around.minimum(q).distance for q in run.q])
    ways = zip(run.q[:-1], run.displacements, strict=True)
    shares = np.arange(1, SAMPLES_OF_A_STEP + 1)[:, None] / SAMPLES_OF_A_STEP
    between = np.array([around.minimum_along(run.arm.checked(q), shares * dq).distance for q, dq in ways])
    lost = np.minimum(at[:-1], margin) - between
    return Row(
        refused=refused,
        reachable=situation.goal_clear,
        status=run.status,
        reason=one_line(run.reason),
        blamed=", ".join(blamed(run.reason, situation.scene, around.bodies)),
        steps=run.steps,
        error=final_error(run),
        margin=margin,
        start=float(at[0]),
        closest=float(min(at[0], between.min(initial=np.inf))),
        end=float(at[-1]),
        loss=float(lost.max(initial=0.0)),
        path=run.path_length_ratio,
        escaping=float(run.error_increasing.mean()) if run.steps else 0.0,
        seconds=seconds,
    )


def blamed(reason: str, scene: Scene, bodies: Sequence[str]) -> list[str]:
    """Return the obstacles, and with self-collision the bodies, named in a text."""
    names = [*scene.obstacles, *(bodies if scene.self_collision else ())]
    return [name for name in distinct(names) if re.search(rf"(?<!\w){re.escape(name)}(?!\w)", reason)]


def kept(row: Row) -> bool:
    """Return whether the margin was kept; after a start in collision, once the arm was out.

    Such an arm must come out, and must not go deeper before that.
    """
    return bool(row.loss <= DISTANCE_ROUNDING and row.end >= row.margin - DISTANCE_ROUNDING)


def explained(row: Row) -> bool:
    """Return whether the target was reached, or the reason names the obstacle."""
    return arrived(row) or bool(row.blamed)


def as_it_should(row: Row) -> bool:
    """Return whether the margin was kept, and the target reached if possible, otherwise with a reason."""
    return kept(row) and explained(row) and arrived(row) == row.reachable


def by_scene(rows: Sequence[Row]) -> list[Row]:
    """Summarise runs by situation.

    Returns:
        For each: the number of runs, of rejected draws (refused), of reachable and of reached targets, of
        runs that kept the margin, and of those that are unexplained; the smallest distance of any run minus
        the margin (room) and the largest loss [m]; and the spreads of steps, path, escaping and seconds.
    """
    return summarise(
        rows,
        ["scene"],
        runs=len,
        refused=lambda own: sum(row.refused for row in own),
        reachable=count(lambda row: row.reachable),
        reached=count(arrived),
        kept=count(kept),
        unexplained=count(lambda row: not explained(row)),
        room=lambda own: min(row.closest - row.margin for row in own),
        loss=largest("loss"),
        **{name: spread(name) for name in ("steps", "path", "escaping", "seconds")},
    )


_COLUMNS = {
    "scene": lambda row: row.scene,
    "runs": lambda row: row.runs,
    "reached": lambda row: f"{row.reached} of {row.reachable}",
    "margin kept": lambda row: f"{row.kept} of {row.runs}",
    "room [mm]": lambda row: f"{1e3 * row.room:.2f}",
    "steps": spread_cell("steps", ".0f"),
    "path": spread_cell("path", ".2f"),
    "escaping": spread_cell("escaping", ".0%"),
    "time [s]": spread_cell("seconds", ".1f"),
}


@examples(
    "make study STUDY=scenes -- --scenes post,wall,inside",
    "make study STUDY=scenes -- --seeds 2 --json",
    "make study STUDY=scenes -- --jobs -1 -o out/scenes",
)
def run(
    *,
    scenes: Annotated[
        str | None,
        MOTION("Some of: post, slot, narrow, wall, pipe, inside, coil, out; else all.", "NAME,..."),
    ] = None,
    seeds: Annotated[int, MOTION("Number of runs in each scene.", "N", max=MOST_RUNS)] = 10,
    seed0: SeedOption = 0,
    options: StudyOptions,
) -> None:
    """Drive 20 RyRz modules, 1 m, among obstacles, and report clearance and success.

    The arm goes round a post; threads a slot of 20 cm in a wall, and a narrow one of 12 cm; unfolds close to
    a wall; reaches through a pipe and hooks back beside it; is sent into a ball, before which it must stop;
    turns a coil into its mirror image without touching itself; and leaves a ball in which it starts. Each
    seed slightly varies start and target; draws without the required clearance are rejected. At most 0.1 rad
    per step and joint, and 400 steps.

    Room is the smallest distance, checked at ten points of every step, minus the margin, in the worst run;
    negative if the arm starts in collision. Such a run keeps its margin if the arm never goes deeper, gets
    out, and keeps the margin from then on. The last four columns are median (90th percentile) of the number
    of steps, the path length of the control points relative to straight lines, the share of steps in which
    the error may rise, and the run time. Runs with faults are listed individually. The study takes about ten
    minutes on two processes.
    """
    names = split_names("--scenes", scenes, SITUATIONS)
    rows = options.run(study_scenes(names, seeds, seed0), "run")
    summary = by_scene(rows)
    refused = [f"{row.scene} {row.refused}" for row in summary if row.refused]
    options.write(
        Report(
            rows,
            {"study": "scenes", "scenes": names, "seeds": seeds, "seed0": seed0, "rows": summary},
            [table(_COLUMNS, summary)],
            notes=[f"starts and targets drawn and rejected: {', '.join(refused)}"] if refused else [],
            warnings=[
                f"{row.scene}, seed {row.seed}: {_fault(row)}" for row in rows if not as_it_should(row)
            ],
        )
    )


def _fault(row: Row) -> str:
    """Describe the faults of a run."""
    faults = []
    if row.loss > 0.0 and not kept(row):
        faults.append(f"came {1e3 * row.loss:.3g} mm closer than it may")
    elif not kept(row):
        faults.append(f"ended {1e3 * row.end:.3g} mm apart, within the margin")
    if arrived(row) != row.reachable:
        faults.append(f"{'did not reach' if row.reachable else 'reached'} its target ({row.status})")
    if not explained(row):
        faults.append(f"names nothing that was in the way ({row.reason})")
    return "; ".join(faults)
