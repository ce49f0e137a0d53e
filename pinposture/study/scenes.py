"""Arms among obstacles, many times: do they keep clear, get there, and say why where they do not."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from time import perf_counter
from typing import NamedTuple

import numpy as np
from joblib import delayed

from pinposture._validation import require_whole
from pinposture.arm import Arm
from pinposture.control import Limits
from pinposture.errors import InvalidValue
from pinposture.motion import track
from pinposture.motion.processes import in_order
from pinposture.placement import Target
from pinposture.study.postures import Progress
from pinposture.study.record import MAX_STEPS, STEP, TOLERANCE
from pinposture.study.scene_record import SceneRun, record_scene_run
from pinposture.study.situations import (
    SITUATIONS,
    draw_situation,
    situation_arm,
    situation_named,
)
from pinposture.study.table import Spread, distinct

SEEDS = 10
"""Number of runs for each situation unless told otherwise."""


class SceneRow(NamedTuple):
    """What became of all runs of a situation.

    Attributes:
        scene: name of the situation.
        runs: number of runs.
        refused: how many starts and targets were drawn that were not as clear as they should be.
        reachable: how many targets could be reached.
        reached: how many were.
        kept: number of runs that kept the margin, see `SceneRun.kept`.
        unexplained: number of runs that did not get there, and named no obstacle.
        room: smallest distance of any run minus the margin [m].
        loss: largest `SceneRun.loss` of any run [m].
        steps: number of steps.
        path: length of the paths of the control points, relative to the direct distances.
        escaping: share of steps that were flagged as an escape.
        seconds: time of a run [s].
    """

    scene: str
    runs: int
    refused: int
    reachable: int
    reached: int
    kept: int
    unexplained: int
    room: float
    loss: float
    steps: Spread
    path: Spread
    escaping: Spread
    seconds: Spread


def study_scenes(
    scenes: Sequence[str] = tuple(SITUATIONS),
    seeds: int = SEEDS,
    first_seed: int = 0,
    jobs: int = 1,
    progress: Progress | None = None,
) -> list[SceneRun]:
    """Drive the spatial arm of 20 modules among obstacles, with the controller that can avoid them.

    |dq| <= 0.1 rad per step, at most 400 steps, until the mean point error is within 1e-6 of the arm length.

    Args:
        scenes: names of situations, see `SITUATIONS`.
        seeds: number of runs for each.
        first_seed: seed of the first.
        jobs: number of processes; joblib's backends apply.
        progress: called with the number of runs finished so far, and that of all.

    Returns:
        The runs in the order of situations, then seeds. But for `seconds` they depend on the arguments
        alone, not on `jobs`.

    Raises:
        InvalidValue: no scene, or numbers that make no sense.
        UnknownName: there is no such scene.
    """
    require_whole("seeds", seeds, 1)
    require_whole("first_seed", first_seed, 0)
    if len(scenes) == 0:
        raise InvalidValue("scenes", list(scenes), "at least one")
    arm, chosen = situation_arm(), [situation_named(name) for name in scenes]
    todo = [(each, seed) for each in chosen for seed in range(first_seed, first_seed + seeds)]
    tasks = (delayed(_one)(arm, each.name, seed) for each, seed in todo)
    runs: list[SceneRun] = []
    for run in in_order(tasks, jobs):
        runs.append(run)
        if progress is not None:
            progress(len(runs), len(todo))
    return runs


def _one(arm: Arm, name: str, seed: int) -> SceneRun:
    situation = situation_named(name)
    draw = draw_situation(arm, situation, seed)
    target = Target.from_configuration(arm, draw.goal)
    began = perf_counter()
    run = track(
        arm,
        target,
        draw.start,
        limits=Limits(step=STEP),
        scene=situation.scene,
        max_steps=MAX_STEPS,
        tolerance=TOLERANCE * arm.length,
    )
    return record_scene_run(run, situation, seed, draw.refused, perf_counter() - began)


def by_scene(runs: Sequence[SceneRun]) -> list[SceneRow]:
    """Summarise runs by situation, in the order in which these first appear."""
    rows = []
    for scene in distinct(run.scene for run in runs):
        own = [run for run in runs if run.scene == scene]
        rows.append(
            SceneRow(
                scene=scene,
                runs=len(own),
                refused=sum(run.refused for run in own),
                reachable=sum(run.reachable for run in own),
                reached=sum(run.reached for run in own),
                kept=sum(run.kept for run in own),
                unexplained=sum(not run.explained for run in own),
                room=min(run.closest - run.margin for run in own),
                loss=max(run.loss for run in own),
                steps=_spread(own, lambda run: run.steps),
                path=_spread(own, lambda run: run.path),
                escaping=_spread(own, lambda run: run.escaping),
                seconds=_spread(own, lambda run: run.seconds),
            )
        )
    return rows


def _spread(runs: Sequence[SceneRun], measure: Callable[[SceneRun], float]) -> Spread:
    values = [measure(run) for run in runs]
    return Spread(float(np.median(values)), float(np.percentile(values, 90)))
