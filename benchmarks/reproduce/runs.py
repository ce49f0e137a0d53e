"""Runs of the scenarios, their measurements, and the selection of runs by reading."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import lru_cache, partial
from itertools import product
from types import MappingProxyType
from typing import NamedTuple

import numpy as np
import pinocchio as pin
from numpy.typing import NDArray

from benchmarks.cases.scenarios import ARMS, SCENARIOS, case
from benchmarks.harness import Case, Row, Study, grouped
from benchmarks.studies.runs import outcome
from pinposture import kernels
from pinposture._validation import require_known
from pinposture.arm import Arm, ArmState
from pinposture.control import Controller, Limits, Projection, Selection, Switching
from pinposture.control.thesis.sections import SectionEdges, best_branch
from pinposture.kernels.arrays import Screws
from pinposture.motion import Run, track
from pinposture.motion.loop import Callback

Array = NDArray[np.float64]

STEADY = 1e-9
"""Change of an error, relative to the arm length, that counts as zero."""


class Steps(NamedTuple):
    """Measurements at each step of a run; all arrays (steps,).

    Attributes:
        nearness: smallest singular value of the tip's Jacobian before the step, relative to the arm length
            [1/rad]; 0 at a singular posture.
        asked: largest |dq| requested before applying limits [rad].
        turn: difference between dq and the previous dq, relative to the larger of the two, in [0, 2]; 0 at
            the first step, and if neither moves.
        change: share of the control points in the union of this and the previous active set that are only in
            one of them; 0 at the first step.
    """

    nearness: Array
    asked: Array
    turn: Array
    change: Array


class Descent(NamedTuple):
    """Counts of rising errors. A step is "uphill" if it would raise an error however short it was made.

    Attributes:
        steps: number of steps.
        rose: steps on which the posture error rose.
        uphill: steps that were uphill for the posture error.
        clipped: steps on which a joint was clipped at its position limit.
        active: control points of the active sets, summed over the steps.
        active_rose: those of them whose own error rose.
        active_free: those of them in steps without clipped joints.
        active_uphill: those of `active_free` that were uphill for their own error.
        points_rose: control points, active or not, whose error rose, summed over the steps.
    """

    steps: int
    rose: int
    uphill: int
    clipped: int
    active: int
    active_rose: int
    active_free: int
    active_uphill: int
    points_rose: int


def separation(run: Run, twin: Run) -> float:
    """Return the largest distance of a control point between two runs at the same step, per arm length.

    A run that has ended stays at its last posture.
    """
    steps = np.arange(max(len(run.points), len(twin.points)))
    ours, theirs = (each.points[np.minimum(steps, each.steps)] for each in (run, twin))
    return float(np.linalg.norm(ours - theirs, axis=2).max()) / run.arm.length


def states_before_steps(run: Run) -> list[ArmState]:
    """Return the state of the arm before each step."""
    return [run.arm.at(q) for q in run.q[:-1]]


def per_step(run: Run, states: Sequence[ArmState]) -> Steps:
    """Measure each step of a run, given the states before them."""
    dq = run.displacements
    return Steps(
        nearness=np.array([nearness(state) for state in states]),
        asked=asked_steps(run, dq),
        turn=turns(dq),
        change=set_changes(run.active),
    )


def asked_steps(run: Run, dq: Array) -> Array:
    """Return the largest |dq| that each step requested before scaling to the step limit, (steps,) [rad or m].

    A step that was not scaled but clipped at position limits counts as clipped; `dq` are the displacements.
    """
    done = np.abs(dq).max(axis=1, initial=0.0)
    # The largest joint motion of a scaled step is the limit, even if that joint was then clipped.
    limit = 0.0 if run.limits.step is None else float(np.max(run.limits.step))
    scale = run.reported("scale", 1.0)
    scale = np.where(scale > 0.0, scale, 1.0)  # steps that the loop took itself were not scaled
    return np.asarray(np.where(scale < 1.0, np.maximum(done, limit), done) / scale)


def nearness(state: ArmState) -> float:
    """Return the smallest singular value of the tip's Jacobian, relative to the arm length [1/rad]."""
    jacobian = state.task_jacobians[-1]
    least = float(np.linalg.eigvalsh(jacobian @ jacobian.T)[0])
    return float(np.sqrt(max(least, 0.0))) / state.arm.length


def turns(dq: Array) -> Array:
    """Return the relative difference between successive steps, (steps,) in [0, 2]; see `Steps.turn`."""
    sizes = np.linalg.norm(dq, axis=1)
    larger = np.maximum(sizes[1:], sizes[:-1])
    apart = np.linalg.norm(np.diff(dq, axis=0), axis=1)
    turned = np.divide(apart, larger, out=np.zeros(len(larger)), where=larger > 0.0)
    return np.concatenate([np.zeros(len(dq) - len(turned)), turned])


def set_changes(active: NDArray[np.bool_]) -> Array:
    """Return the change between successive active sets, (steps,) in [0, 1]; see `Steps.change`."""
    either = (active[1:] | active[:-1]).sum(axis=1)
    differ = (active[1:] ^ active[:-1]).sum(axis=1)
    return np.concatenate([np.zeros(len(active) - len(either)), differ / np.maximum(either, 1)])


def descent(run: Run, states: Sequence[ArmState]) -> Descent:
    """Count the steps on which errors rose, and those on which even a short step would have raised them."""
    slack = STEADY * run.arm.length
    rises = np.greater(np.diff(run.point_errors, axis=0), slack / run.arm.n_modules)  # (steps, m)
    slopes, dq = np.zeros(rises.shape), run.displacements
    for i, state in enumerate(states):
        slopes[i] = error_slopes(state, run.target.points, run.target.has_target, dq[i])
    flat = STEADY * run.arm.length * np.abs(dq).max(axis=1, initial=0.0)
    clipped = np.any(run.clipped, axis=1)
    free = run.active & ~clipped[:, None]
    return Descent(
        steps=run.steps,
        rose=int(np.count_nonzero(np.diff(run.posture_error) > slack)),
        uphill=int(np.count_nonzero(slopes.sum(axis=1) > flat)),
        clipped=int(np.count_nonzero(clipped)),
        active=int(np.count_nonzero(run.active)),
        active_rose=int(np.count_nonzero(rises & run.active)),
        active_free=int(np.count_nonzero(free)),
        active_uphill=int(np.count_nonzero((slopes > flat[:, None]) & free)),
        points_rose=int(np.count_nonzero(rises)),
    )


def error_slopes(state: ArmState, goals: Array, placed: NDArray[np.bool_], dq: Array) -> Array:
    """Return the slope of the error of each control point along dq, (m,) [m per unit of the step].

    Only points that are `placed`, (m,), have goals, (m, 3) [m]; the others have a slope of 0.
    """
    towards = goals - state.points
    distances = np.linalg.norm(towards, axis=1)
    moving = state.jacobians @ dq  # (m, 3)
    along = np.einsum("ki,ki->k", towards, moving)
    away = distances > 1e-12 * state.arm.length
    return np.where(placed & away, -along / np.where(away, distances, 1.0), 0.0)


def deficient_steps(
    run: Run, states: Sequence[ArmState], dropped: Sequence[tuple[int, ...]]
) -> tuple[int, int]:
    """Count the steps whose control set has a posture control matrix of less than full row rank.

    The set is that of the conditions, with the points (0-based) that were then dropped in each step because
    the matrix was too close to singular. The second number is that of the steps with dropped points.
    """
    rows = run.reported("rows", 0)
    size = np.maximum(rows, run.arm.nv)
    full = run.reported("sigma_min", 0.0) > size * np.finfo(float).eps * run.reported("sigma_max", 0.0)
    deficient = (rows > 0) & ~full
    for i, points in enumerate(dropped):
        if points:
            chosen = sorted({*np.flatnonzero(run.active[i]).tolist(), *points})
            deficient[i] = not has_full_rank(stacked(states[i], chosen))
    return int(np.count_nonzero(deficient)), sum(map(bool, dropped))


def stacked(state: ArmState, points: list[int]) -> Array:
    """Return the stacked Jacobians of control points (0-based), without columns that move none of them."""
    matrix = state.task_jacobians[points].reshape(-1, state.arm.nv)
    return np.asarray(matrix[:, np.any(matrix != 0.0, axis=0)])


def has_full_rank(matrix: Array) -> bool:
    """Return whether the rows of a matrix are linearly independent, to numerical precision."""
    return len(matrix) == 0 or int(np.linalg.matrix_rank(matrix)) == len(matrix)


THESIS_STEPS = 200
"""Maximum number of steps of a run."""

STEP_LIMIT = 0.1
"""Largest |dq| of a joint in one step [rad], except in the variants without a limit."""

NUDGE = 1e-6
"""Largest difference between the start of a run and that of its twin [rad]."""

FREE = 1e3
"""Position limits of joints that count as unlimited [rad]."""


@dataclass(frozen=True)
class PrintedSelection(Selection):
    """Selection with (4.8) as printed: absolute indices of sections, not relative to their best.

    It is for planar arms with one-joint modules.
    """

    name: str = "selection, (4.8)"

    def _chosen(
        self, arm: Arm, screws: Screws, placed: NDArray[np.bool_], distances: Array, base: Array
    ) -> NDArray[np.int64]:
        region = np.flatnonzero(placed)
        indices = np.zeros((len(self.section_sizes), arm.n_modules + 1))
        section_sizes = np.array(self.section_sizes, dtype=np.int64)
        kernels.section_indices_by_size(screws, arm.kinematics.task_constants.plane, section_sizes, indices)
        usable = (base > self.absolute) & placed
        position_limits = SectionEdges.of(indices, usable, self.relative, self.section_sizes)
        points = best_branch(position_limits, int(region[0]), int(region[-1]), "thesis").points
        return np.array(points, dtype=np.int64)


class Variant(NamedTuple):
    """A controller and its conditions.

    Attributes:
        controller: the controller or its name.
        step: largest |dq| of a joint in one step [rad]; None for no limit.
        free: True if the joints of the arm have no position limits.
        blind: True if the controller does not know a configuration of the target posture.
    """

    controller: str | Controller
    step: float | None = STEP_LIMIT
    free: bool = False
    blind: bool = False


ANY_STEP = "any step"
"""Suffix of the names of variants without a step limit."""

SWITCHING_READINGS: Mapping[str, Switching] = MappingProxyType(
    {
        "Figure 4.8, 3 steps then 5": Switching(patience=0.3, stay=0.5),
        "Figure 4.8, 5 steps then 5": Switching(patience=0.5, stay=0.5),
        "Figure 4.8, 10 steps then 2": Switching(patience=1.0, stay=0.2),
        "Figure 4.8, 20 steps then 5": Switching(patience=2.0, stay=0.5),
        "Figure 4.8, back when possible": Switching(patience=1.0, hand_back="when_possible"),
    }
)
"""Further readings of Figure 4.8: number of steps without progress after which Selection loses control, and
for how many steps of 0.1 rad; the last hands back as soon as Selection can lower the error again.

The best reading has 10 steps and 5, chosen by the rule in `benchmarks/studies/parameters.py`."""

_LIMITED = MappingProxyType(
    {
        "selection": Variant("selection"),
        "projection": Variant("projection"),
        "projection, full": Variant(Projection(coupling="full", threshold=0.4)),
        "projection, local": Variant(Projection(coupling="local", threshold=0.4)),
        "projection, kappa 0.6": Variant(Projection(threshold=0.6)),
        "selection, (4.8)": Variant(PrintedSelection()),
        "selection, (4.8) relative": Variant(Selection(score="thesis")),
        "selection, free joints": Variant("selection", free=True),
        "projection, free joints": Variant("projection", free=True),
    }
)

VARIANTS: Mapping[str, Variant] = MappingProxyType(
    {
        **_LIMITED,
        **{f"{name}, {ANY_STEP}": each._replace(step=None) for name, each in _LIMITED.items()},
        "switching, Figure 4.8": Variant(Switching(patience=1.0, stay=0.5), blind=True),
        "switching": Variant("switching"),
        **{
            f"switching, {name}": Variant(controller, blind=True)
            for name, controller in SWITCHING_READINGS.items()
        },
    }
)
"""Variants of the controllers, by name.

"local" is the posture control matrix (5.9) as printed, "full" has the columns of all joints that move a
point; "(4.8)" is the score of a planar arm as printed, "(4.8) relative" the same for indices relative to the
best of their section. "Figure 4.8" is switching without waypoints. "free joints" have no position limits,
"any step" has no step limit; the thesis specifies neither."""


class RunSet(NamedTuple):
    """Runs that differ only in their seed.

    Attributes:
        scenario: name of the scenario, one of SCENARIOS.
        variant: name of the variant.
        twins: whether each run has a twin with a nudged start.
        given: the variant itself; None for the one in VARIANTS.
    """

    scenario: str
    variant: str
    twins: bool = False
    given: Variant | None = None


Pool = Mapping[tuple[str, str], Sequence[Row]]
"""Runs by scenario and variant, in the order of their seeds."""


@lru_cache(maxsize=8)
def thesis_arm(name: str, free: bool = False) -> Arm:
    """Return one of `ARMS` by name, cached, without position limits if `free`; raises UnknownName."""
    require_known("arm", name, ARMS)
    modules = [module.with_limits(-FREE, FREE) for module in ARMS[name]] if free else ARMS[name]
    return Arm.from_modules(modules, name=name)


def run_one(
    batch: RunSet,
    seed: int,
    max_steps: int = THESIS_STEPS,
    nudged: bool = False,
    callback: Callback | None = None,
) -> Run:
    """Compute the run of one seed, or its twin; `callback` is as in `track`.

    Raises:
        UnknownName: no such scenario, variant or controller.
    """
    require_known("scenario", batch.scenario, SCENARIOS)
    if batch.given is None:
        require_known("variant", batch.variant, VARIANTS)
    scenario, variant = SCENARIOS[batch.scenario], batch.given or VARIANTS[batch.variant]
    arm = thesis_arm(scenario.arm, variant.free)
    start, target = case(arm, scenario, seed)
    if variant.blind:
        target = replace(target, q=None)
    if nudged:
        aside = np.random.default_rng((seed, 1)).uniform(-NUDGE, NUDGE, arm.nv)
        start = np.array(pin.integrate(arm.model, start, aside))
    limits = Limits(step=variant.step)
    return track(arm, target, start, variant.controller, limits, max_steps=max_steps, callback=callback)


def measure(batch: RunSet, seed: int, max_steps: int = THESIS_STEPS) -> Row:
    """Run one seed, and its twin if it has one, and measure what claims are judged by."""
    run = run_one(batch, seed, max_steps)
    none = np.zeros_like(run.active)
    dropped = [tuple(np.flatnonzero(row).tolist()) for row in run.info.get("dropped", none)]
    twin = run_one(batch, seed, max_steps, nudged=True) if batch.twins else None
    return measured(run, batch, seed, dropped, twin)


def measured(
    run: Run,
    batch: RunSet,
    seed: int,
    dropped: Sequence[tuple[int, ...]],
    twin: Run | None = None,
) -> Row:
    """Measure a run; `dropped` are the control points dropped in each step.

    Returns:
        outcome: outcome of the run.
        mean_errors: mean point error before the first and after each step, (steps + 1,), per arm length.
        off_curve: largest distance of a control point target from the target curve, per arm length; None if
            the target is not a curve.
        points: number of active control points in each step, (steps,).
        modules: number of control points.
        descent: counts of rising errors.
        deficient: steps in which the posture control matrix was rank-deficient before points were dropped.
        dropping: steps in which points were dropped because that matrix was too close to singular.
        path_length_ratio: path length of the control points relative to straight lines.
        steps: measurements at each step.
        by_projection: share of the steps that a switching controller left to Projection; 0 for others.
        separation: largest distance from a twin whose start differs by 1e-6 rad, per arm length, or None.
        goal_nearness: nearness of the target posture to a singular one, as `Steps.nearness`; None if no
            configuration of the target is known.
    """
    states = states_before_steps(run)
    deficient, dropping = deficient_steps(run, states, dropped)
    goal = run.target.q
    placed = int(run.target.has_target.sum())
    residual = run.target.residual
    return Row(
        outcome=outcome(run, batch.variant),
        mean_errors=run.posture_error / (placed * run.arm.length),
        off_curve=None if residual is None else float(residual[run.target.has_target].max()) / run.arm.length,
        points=run.active.sum(axis=1),
        modules=run.arm.n_modules,
        descent=descent(run, states),
        deficient=deficient,
        dropping=dropping,
        path_length_ratio=run.path_length_ratio,
        steps=per_step(run, states),
        by_projection=float(np.mean(run.reported("method", "") == "projection")) if run.steps else 0.0,
        separation=None if twin is None else separation(run, twin),
        goal_nearness=None if goal is None else nearness(run.arm.at(goal)),
    )


def make_pool(
    batches: Iterable[RunSet],
    seeds: int,
    max_steps: int,
    jobs: int = 1,
    progress: Callable[[int], object] | None = None,
    first: int = 0,
) -> Pool:
    """Run every batch over consecutive seeds; the runs do not depend on `jobs`.

    `progress` is called with the number of newly finished runs.
    """
    cases = [
        Case({"scenario": batch.scenario, "variant": batch.variant}, partial(tuple, (batch, seed)))
        for batch, seed in product(batches, range(first, first + seeds))
    ]
    rows = Study(cases, [max_steps], _measure).rows(jobs, progress and (lambda *_: progress(1)))
    return grouped(rows, lambda row: (row.scenario, row.variant))


def _measure(case: tuple[RunSet, int], max_steps: int) -> Row:
    batch, seed = case
    return measure(batch, seed, max_steps)


ARM_NAMES = {"ryrz20": "spatial", "planar45": "planar"}

DEFAULT = "best reading"

_METHODS = {"selection": "selection", "projection": "projection", "switching": "switching, Figure 4.8"}

READINGS: Mapping[str, Mapping[str, str]] = {
    DEFAULT: _METHODS,
    "(5.9) with all columns": _METHODS | {"projection": "projection, full"},
    "(5.9) as printed": _METHODS | {"projection": "projection, local"},
    "kappa 0.6": _METHODS | {"projection": "projection, kappa 0.6"},
    "(4.8) as printed": _METHODS | {"selection": "selection, (4.8)"},
    "(4.8), relative indices": _METHODS | {"selection": "selection, (4.8) relative"},
    **{name: _METHODS | {"switching": f"switching, {name}"} for name in SWITCHING_READINGS},
    "ours, with waypoints": _METHODS | {"switching": "switching"},
    "joints without limits": _METHODS
    | {"selection": "selection, free joints", "projection": "projection, free joints"},
}
"""Readings of the thesis where it leaves a choice: the variant of each method, by reading.

The best reading has the defaults of Selection and Projection, and Switching as in Figure 4.8, without our
waypoints. The posture control matrix (5.9) and the score (4.8) of a planar arm differ from the printed ones.
The thesis does not specify joint limits; those of the arms here are +-pi."""


class Reading(NamedTuple):
    """The runs of one reading, or of one of the user's own controllers.

    Attributes:
        pool: runs by scenario and variant.
        variants: the variant of each method.
        own: name of a controller that replaces each method; empty for the methods themselves.
        counted: counts at random postures, see `evaluate.count_posture`.
    """

    pool: Pool
    variants: Mapping[str, str]
    own: str = ""
    counted: Sequence[Row] = ()

    def concerns(self, methods: Sequence[str]) -> bool:
        """Return whether this reading differs from the default for any of the methods, or is the default."""
        return any(self._differs(method) for method in methods) or self._is_default

    @property
    def _is_default(self) -> bool:
        return self.variants == READINGS[DEFAULT] and not self.own

    def _differs(self, method: str) -> bool:
        return self._is_default or self.variants[method] != READINGS[DEFAULT][method]

    def runs(self, scenario: str, method: str) -> Sequence[Row]:
        """Return the runs of a scenario by a method, by seed; empty if this reading has none."""
        return self.pool.get((scenario, self.variants[method]), ())

    def each(
        self, scenarios: Sequence[str], methods: Sequence[str], kind: str = ""
    ) -> dict[str, Sequence[Row]]:
        """Return the runs specific to this reading, by "arm, scenario, method" in words.

        One of the user's own controllers replaces all methods; `kind` is ANY_STEP for no step limit.
        """
        variants = {method: self.variants[method] for method in methods if self._differs(method)}
        if self.own:
            variants = {self.own: self.own}
        added = f", {kind}" if kind else ""
        found = {
            label(scenario, method + added): self.pool.get((scenario, variant + added), ())
            for scenario in scenarios
            for method, variant in variants.items()
        }
        return {name: runs for name, runs in found.items() if runs}

    def pairs(self, scenarios: Sequence[str], one: str, other: str) -> dict[str, list[tuple[Row, Row]]]:
        """Return the runs of two methods on the same seeds, by "arm, scenario" in words."""
        found = {label(s): list(zip(self.runs(s, one), self.runs(s, other), strict=False)) for s in scenarios}
        return {name: runs for name, runs in found.items() if runs}


def label(scenario: str, method: str = "") -> str:
    """Return arm, scenario and method in words."""
    about = SCENARIOS[scenario]
    return ", ".join(filter(None, (ARM_NAMES[about.arm], about.title, method)))


def median(values: Sequence[float] | np.ndarray) -> float:
    """Return the median; 0 if empty, because tables cannot hold NaN."""
    return float(np.median(values)) if len(values) else 0.0
