"""The runs from which every claim takes its numbers: each scenario by each controller, over many seeds."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import replace
from functools import lru_cache
from types import MappingProxyType
from typing import NamedTuple

import numpy as np
import pinocchio as pin
from joblib import delayed
from numpy.typing import NDArray

from pinposture.arm import Arm
from pinposture.control import Controller, Limits, Projection, Selection, controller_named
from pinposture.errors import UnknownName
from pinposture.motion import Trajectory, track
from pinposture.motion.processes import in_order
from pinposture.study.cases import Outcome, case, outcome
from pinposture.study.reproduce.measures import (
    Descent,
    Steps,
    deficient_steps,
    descent,
    per_step,
    separation,
    states_before_steps,
)
from pinposture.thesis.arms import ARMS
from pinposture.thesis.scenarios import SCENARIOS

Array = NDArray[np.float64]

MAX_STEPS = 200
"""Steps after which a run ends."""

STEP_LIMIT = 0.1
"""Largest |dq| of a joint in one step [rad], except in the variants without a limit."""

NUDGE = 1e-6
"""How far the joints of the start of a twin run are from those of the run, at most [rad]."""

FREE = 1e3
"""Where the joints that have no position limits end [rad]."""

BUNDLE = 5
"""Seeds that a process works off at a time."""


class Variant(NamedTuple):
    """A controller and the step limit that it works under.

    Attributes:
        controller: makes the controller.
        limits: limits of each step.
        free: whether the joints of the arm have no position limits.
        blind: whether the controller is not told a configuration that takes the target posture.
    """

    controller: Callable[[], Controller]
    limits: Limits
    free: bool = False
    blind: bool = False


def _variant(name: str, step: float | None = STEP_LIMIT, free: bool = False, blind: bool = False) -> Variant:
    return Variant(lambda: controller_named(name), Limits(step=step), free, blind)


VARIANTS: Mapping[str, Variant] = MappingProxyType(
    {
        "selection": _variant("selection"),
        "projection": _variant("projection"),
        "projection, local": Variant(lambda: Projection(coupling="local"), Limits(step=STEP_LIMIT)),
        "selection, (4.8)": Variant(lambda: Selection(score="thesis"), Limits(step=STEP_LIMIT)),
        "switching": _variant("switching"),
        "switching, no waypoints": _variant("switching", blind=True),
        "selection, free joints": _variant("selection", free=True),
        "projection, free joints": _variant("projection", free=True),
        "selection, any step": _variant("selection", None),
        "projection, any step": _variant("projection", None),
    }
)
"""What moves the arms, by name.

"local" is the posture control matrix (5.9) as printed, "(4.8)" the score of a planar arm as printed; "no
waypoints" leaves switching at the failover of Figure 4.8. "free joints" have no position limits, "any step"
has no step limit; the thesis speaks of neither."""


class RunSet(NamedTuple):
    """Runs that differ in nothing but their seed.

    Attributes:
        scenario: name of the scenario, one of SCENARIOS.
        variant: name of the variant, one of VARIANTS.
        twins: whether each run has a twin whose start is nudged.
    """

    scenario: str
    variant: str
    twins: bool = False


class MeasuredRun(NamedTuple):
    """What is kept of one run.

    Attributes:
        outcome: how it ended.
        mean_errors: mean point error before the first and after each step, (steps + 1,), per arm length.
        off_curve: largest distance of a control point target from the target curve, per arm length; None
            where the target is no curve.
        points: active control points in each step, (steps,).
        modules: number of control points that there are.
        descent: in how many steps errors fell.
        deficient: steps whose posture control matrix was not of full row rank.
        sweep: length of the paths of the control points per direct distance.
        steps: what it was like in each step.
        by_projection: share of the steps that a switching controller left to Projection; 0 for others.
        separation: how far a twin that started 1e-6 rad beside it came from it, per arm length; None where
            there is no twin.
    """

    outcome: Outcome
    mean_errors: Array
    off_curve: float | None
    points: NDArray[np.intp]
    modules: int
    descent: Descent
    deficient: int
    sweep: float
    steps: Steps
    by_projection: float
    separation: float | None


Pool = Mapping[tuple[str, str], Sequence[MeasuredRun]]
"""Runs by scenario and variant, in the order of their seeds."""


@lru_cache(maxsize=8)
def thesis_arm(name: str, free: bool = False) -> Arm:
    """The arm of that name, one of `pinposture.thesis.arms.ARMS`; made once.

    Args:
        name: its name.
        free: whether its joints may turn as far as they like.

    Raises:
        UnknownName: there is none.
    """
    if name not in ARMS:
        raise UnknownName("arm", name, ARMS)
    modules = [module.with_limits(-FREE, FREE) for module in ARMS[name]] if free else ARMS[name]
    return Arm.from_modules(modules, name=name)


def run_one(batch: RunSet, seed: int, max_steps: int = MAX_STEPS, nudged: bool = False) -> Trajectory:
    """The run of one seed, or its twin.

    Raises:
        UnknownName: no such scenario, variant or controller.
    """
    for kind, name, known in (
        ("scenario", batch.scenario, SCENARIOS),
        ("variant", batch.variant, VARIANTS),
    ):
        if name not in known:
            raise UnknownName(kind, name, known)
    scenario, variant = SCENARIOS[batch.scenario], VARIANTS[batch.variant]
    arm = thesis_arm(scenario.arm, variant.free)
    start, target = case(arm, scenario, seed)
    if variant.blind:
        target = replace(target, q=None)
    if nudged:
        aside = np.random.default_rng((seed, 1)).uniform(-NUDGE, NUDGE, arm.nv)
        start = np.array(pin.integrate(arm.model, start, aside))
    return track(arm, target, start, variant.controller(), variant.limits, max_steps=max_steps)


def measure(batch: RunSet, seed: int, max_steps: int = MAX_STEPS) -> MeasuredRun:
    """Run one seed, and its twin if it has one, and keep what claims are judged by."""
    run = run_one(batch, seed, max_steps)
    twin = run_one(batch, seed, max_steps, nudged=True) if batch.twins else None
    return measured(run, batch, seed, twin)


def measured(run: Trajectory, batch: RunSet, seed: int, twin: Trajectory | None = None) -> MeasuredRun:
    """What is kept of a run."""
    states = states_before_steps(run)
    placed = int(run.target.placed.sum())
    residual = run.target.residual
    return MeasuredRun(
        outcome=outcome(run, batch.scenario, batch.variant, seed),
        mean_errors=run.posture_error / (placed * run.arm.length),
        off_curve=None if residual is None else float(residual[run.target.placed].max()) / run.arm.length,
        points=run.active.sum(axis=1),
        modules=run.arm.n_modules,
        descent=descent(run, states),
        deficient=deficient_steps(run),
        sweep=run.sweep,
        steps=per_step(run, states),
        by_projection=float(np.mean(run.method == "projection")) if run.steps else 0.0,
        separation=None if twin is None else separation(run, twin),
    )


def make_pool(
    batches: Iterable[RunSet],
    seeds: int,
    max_steps: int = MAX_STEPS,
    jobs: int = 1,
    progress: Callable[[int], object] | None = None,
) -> Pool:
    """Run every batch over the seeds 0, 1, ...

    Args:
        batches: what to run.
        seeds: number of seeds.
        max_steps: steps after which a run ends.
        jobs: number of processes.
        progress: called with the number of runs that have just been finished.

    Returns:
        The runs; they depend on batches, seeds and steps alone, not on `jobs`.
    """
    listed = list(batches)
    bundles = [range(first, min(first + BUNDLE, seeds)) for first in range(0, seeds, BUNDLE)]
    todo = [(batch, bundle) for batch in listed for bundle in bundles]
    pool: dict[tuple[str, str], list[MeasuredRun]] = {(b.scenario, b.variant): [] for b in listed}
    tasks = (delayed(_work_off)(batch, bundle, max_steps) for batch, bundle in todo)
    results = in_order(tasks, jobs)
    for (batch, bundle), found in zip(todo, results, strict=True):
        pool[batch.scenario, batch.variant].extend(found)
        if progress is not None:
            progress(len(bundle))
    return pool


def _work_off(batch: RunSet, seeds: Sequence[int], max_steps: int) -> list[MeasuredRun]:
    return [measure(batch, seed, max_steps) for seed in seeds]
