"""Many runs of one arm, in parallel processes, and their results."""

from __future__ import annotations

import os
from collections import Counter
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import cached_property, partial
from operator import attrgetter
from typing import TYPE_CHECKING, Any, Literal

import numpy as np
from numpy.typing import ArrayLike, NDArray

from pinposture._validation import (
    is_number,
    is_whole,
    make_read_only,
    require_function,
    require_instance,
    require_known,
    require_positive,
    require_whole,
)
from pinposture.arm import Arm
from pinposture.collision import CollisionModel, Scene
from pinposture.control import Controller, Limits
from pinposture.control.limits import require_limits
from pinposture.errors import (
    ControllerError,
    InvalidValue,
    PostureError,
    ProcessError,
    no_warnings,
    warn_caller,
)
from pinposture.motion.loop import RunRecord, in_scene
from pinposture.motion.run import (
    CONFIGURATION_ARRAYS,
    RAISE_STEPS,
    STEP_ARRAYS,
    Arrays,
    Run,
    info_of,
    run_arrays,
    smallest_distance,
)
from pinposture.motion.track import name_enough_steps, track, usual_max_steps
from pinposture.placement import Target
from pinposture.units import CONVERGED, error_text, length_text

if TYPE_CHECKING:
    from pinposture.motion.processes import Progress, Shared

Array = NDArray[np.float64]

FAILED = "failed"
"""Status of a run that an error ended."""


@dataclass(frozen=True, eq=False)
class Batch:
    """Many runs of one arm, in the order of their starts and targets.

    `batch[i]` is run i as a `Run`, 0-based, if the motions were kept; `len(batch)` is the number of
    runs, count below.

    A run that an error ends, for instance because the controller does not support its target, has the status
    "failed", the error as its reason, and no steps.

    Attributes:
        arm: the arm that moved.
        targets: the target posture of each run, or a single one for all.
        controller: name and parameters of the controller.
        limits: the limits of each step.
        scene: the obstacles; None: none.
        max_steps: largest number of steps after which a run stopped.
        tolerance: mean point error at which a run converged [m].
        status: as `Run.status`, or "failed", (count,).
        reason: why each run ended, (count,).
        steps: number of steps, (count,).
        start_error: posture error at the start, (count,) [m].
        final_error: posture error at the end, (count,) [m].
        mean_error: mean distance of the control points from their targets at the end, (count,) [m].
        path_length_ratio: length of the paths of all control points relative to the direct distances,
            (count,).
        clearance: smallest distance to an obstacle, or between parts of the arm, (count,) [m]; negative
            in penetration. Without a scene, that between parts of the arm.
        closest: names of the two that are that close, joined by "and", (count,); "" if there are none.
        q_start: configurations at the start, (count, nq).
        q_final: configurations at the end, (count, nq).
        motions: the arrays of each run, as `run_arrays` returns them; None if only the ends were kept.
    """

    arm: Arm
    targets: tuple[Target, ...]
    controller: str
    limits: Limits
    scene: Scene | None
    max_steps: int
    tolerance: float
    status: NDArray[np.str_]
    reason: NDArray[np.str_]
    steps: NDArray[np.intp]
    start_error: Array
    final_error: Array
    mean_error: Array
    path_length_ratio: Array
    clearance: Array
    closest: NDArray[np.str_]
    q_start: Array
    q_final: Array
    motions: tuple[Arrays, ...] | None = None

    def __post_init__(self) -> None:
        make_read_only(*vars(self).values())
        for arrays in self.motions or ():
            make_read_only(*arrays.values())

    def __len__(self) -> int:
        return len(self.status)

    def __getitem__(self, number: int) -> Run:
        number = self._checked_number(number)
        if self.motions is None:
            allowed = '"motions" in track_many; the ends alone are in q_start and q_final'
            raise InvalidValue("keep", "ends", allowed)
        target = self.target(number)
        arrays = self.motions[number]
        points = np.array([self.arm.chain_at(q).points for q in arrays["q"]])
        return Run(
            arm=self.arm,
            target=target,
            controller=self.controller,
            limits=self.limits,
            status=str(self.status[number]),
            reason=str(self.reason[number]),
            scene=self.scene,
            points=points,
            point_errors=target.distances(points),
            info=info_of(arrays),
            held=(),
            **{name: arrays[name] for name in CONFIGURATION_ARRAYS + STEP_ARRAYS},
        )

    def __iter__(self) -> Iterator[Run]:
        return (self[number] for number in range(len(self)))

    def _checked_number(self, number: int) -> int:
        # IndexError, as for any sequence: it ends loops over one.
        if not is_whole(number):
            raise TypeError(f"a run is indexed by an integer, not by {number!r}")
        if not -len(self) <= number < len(self):
            raise IndexError(f"run {number} of {len(self)}")
        return int(number) % len(self)

    def target(self, number: int) -> Target:
        """Return the target posture of a run."""
        return self.targets[self._checked_number(number) if len(self.targets) > 1 else 0]

    @property
    def converged(self) -> NDArray[np.bool_]:
        """Which runs converged, (count,)."""
        return np.asarray(self.status == "converged")

    @cached_property
    def faults(self) -> tuple[str, ...]:
        """Messages on runs that did not converge, penetrations, and postures that no motor can hold."""
        away = np.flatnonzero(~self.converged)
        inside = np.flatnonzero(self.clearance < -CONVERGED * self.arm.length)
        found = []
        if len(away):
            found.append(f"{len(away)} of {len(self)} runs did not reach the target")
        if len(inside):
            deepest = int(self.clearance.argmin())
            most = (
                f"most {self.closest[deepest]}, by {-1e3 * self.clearance[deepest]:.3g} mm in run {deepest}"
            )
            found.append(f"bodies penetrate in {len(inside)} of {len(self)} runs, {most}")
        loads = [self.arm.at(q).most_loaded() for q in self.q_final] if self.arm.torques_known else []
        heavy = {run: load for run, load in enumerate(loads) if load is not None and load.exceeded}
        if heavy:
            run, load = max(heavy.items(), key=lambda item: item[1].share)
            most = f"most in run {run}: {load}"
            found.append(f"the final posture cannot be held in {len(heavy)} of {len(self)} runs, {most}")
        return tuple(found)

    @property
    def verdict(self) -> str:
        """The result in one line."""
        return "; ".join(self.faults) or f"reached the target in all {len(self)} runs"

    def summary(self) -> dict[str, Any]:
        """Return the batch as data for JSON, without the configurations; lengths in metres."""
        names = ("status", "reason", "steps", "start_error", "final_error", "mean_error", "path_length_ratio")
        columns: dict[str, list[Any]] = {name: getattr(self, name).tolist() for name in names}
        columns["clearance"] = [
            distance if np.isfinite(distance) else None for distance in self.clearance.tolist()
        ]
        columns["closest"] = [pair or None for pair in self.closest.tolist()]
        runs = [dict(zip(columns, row, strict=True)) for row in zip(*columns.values(), strict=True)]
        return {
            "verdict": self.verdict,
            "faults": list(self.faults),
            "count": len(self),
            "statuses": dict(Counter(self.status.tolist()).most_common()),
            "controller": self.controller,
            "arm_length": self.arm.length,
            "control_points": self.arm.n_modules,
            "max_steps": self.max_steps,
            "tolerance": self.tolerance,
            "moved": [None if target.moved is None else target.moved._asdict() for target in self.targets],
            "runs": runs,
        }

    def in_words(self) -> dict[str, str]:
        """Return a readable summary as names and texts."""
        ends = ", ".join(f"{n} {status}" for status, n in Counter(self.status.tolist()).most_common())
        median_error = float(np.median(self.mean_error))
        words = {
            "verdict": self.verdict,
            "runs": f"{len(self)}: {ends}",
            "steps": _spread(self.steps, ".0f"),
            "mean error": f"median {length_text(median_error, self.arm.length)}, "
            f"largest {error_text(float(self.mean_error.max()), self.arm.length)}",
            "paths": f"{_spread(self.path_length_ratio, '.3g')} times as long as straight ones",
        }
        moved = [target.moved for target in self.targets if target.moved]
        far = max(moved, key=attrgetter("distance"), default=None)
        if far is not None:
            words["curve"] = f"{far} to the base of the arm" + (" at most" if len(self.targets) > 1 else "")
        if self.scene is not None:
            least = int(self.clearance.argmin())
            between = f", between {self.closest[least]}" if self.closest[least] else ""
            words["clearance"] = (
                f"{length_text(self.clearance[least])} where it is smallest, in run {least}{between}; "
                f"the margin is {length_text(self.scene.margin)}"
            )
        if not self.converged.all():
            worst = int(np.where(self.converged, -1.0, self.mean_error).argmax())
            words["worst"] = f"run {worst}, {self.status[worst]}: {self.reason[worst]}"
        enough = [reason.rpartition(f"{RAISE_STEPS} ")[2] for reason in self.reason.tolist()]
        known = [int(steps) for steps in enough if steps.isdecimal()]
        if known:
            words["out of steps"] = f"{RAISE_STEPS} {max(known)}, which is enough for {len(known)} of them"
        failed = np.flatnonzero(self.status == FAILED)
        if len(failed):
            words["failed"] = f"{len(failed)}, run {failed[0]} first: {self.reason[failed[0]]}"
        return words

    def __str__(self) -> str:
        words = self.in_words()
        width = max(map(len, words))
        return "\n".join(f"{name:{width}}  {text}" for name, text in words.items())

    def __repr__(self) -> str:
        kept = "ends" if self.motions is None else "motions"
        return f"Batch({len(self)} runs, {self.converged.sum()} converged, {kept} kept)"


def _spread(values: NDArray[Any], form: str) -> str:
    """Return the median and the maximum in words."""
    return f"{np.median(values):{form}} (median), at most {values.max():{form}}"


@dataclass(frozen=True)
class _Setting:
    """Arguments common to all runs."""

    arm: Arm
    controller: Controller
    limits: Limits
    scene: Scene | None
    max_steps: int | None
    tolerance: float
    keep: str
    process: int


def track_many(
    arm: Arm,
    targets: Target | Sequence[Target],
    starts: ArrayLike,
    controller: str | Controller = "geodesic",
    limits: Limits | None = None,
    scene: Scene | None = None,
    *,
    max_steps: int | None = None,
    tolerance: float | None = None,
    jobs: int | None = None,
    keep: Literal["motions", "ends"] = "motions",
    progress: Progress | None = None,
) -> Batch:
    """Drive an arm from many configurations to one or many target postures, each as `track` does.

    Starts and targets are paired; a single start or target is used for all runs. Inside
    `joblib.parallel_config(backend="dask")`, or another backend, runs are computed there. The results do not
    depend on the backend or the number of processes.

    Args:
        arm: the arm.
        targets: one target posture, or one for each run.
        starts: initial configurations, (count, nq); or one, (nq,).
        controller: a controller, or the name of one with its default parameters; see `CONTROLLERS`.
        limits: the limits of each step; `Limits()` if None.
        scene: the obstacles, as in `track`.
        max_steps: number of steps after which a run stops; None: as in `track`.
        tolerance: mean distance of the control points from their targets at which a run converges [m]; 1e-6
            of the arm length if None.
        jobs: number of processes; -1: as many as possible. None: as in `joblib.parallel_config`; without one,
            as many as possible once the remaining work outweighs their start.
        keep: "motions", or "ends" to save 0.5 kB per step of an arm with 40 degrees of freedom.
        progress: called with the number of finished runs and the total number.

    Returns:
        The results in the order of starts and targets. A run that raises an error of this package is recorded
        as "failed", with a `PostureWarning`; the other runs continue. Runs whose process is killed are made
        again; if that happens again and again, they are recorded as "failed", too.

    Raises:
        InvalidValue: numbers of targets and starts that do not match, one of them that does not fit the arm,
            or another argument that `track` would refuse; raised before any run.
        UnknownName: no controller has that name, or there is no such thing to keep.
    """
    # joblib takes longer to import than most of this package.
    from joblib import delayed

    from pinposture.motion.processes import Shared, adaptively_in_order, check_jobs

    chosen, scene = in_scene(controller, scene)
    limits = require_limits(limits)
    require_function("progress", progress)
    if max_steps is not None:
        require_whole("max_steps", max_steps, 1)
    tolerance = CONVERGED * arm.length if tolerance is None else require_positive("tolerance", tolerance)
    if jobs is not None:
        check_jobs(jobs)
    require_known("thing to keep", keep, ("motions", "ends"))
    listed = _targets(arm, targets)
    configurations = _starts(arm, starts)
    count = _count_runs(len(listed), len(configurations))
    limits.for_arm(arm)  # refuse limits of another arm before any run
    if scene is not None:
        CollisionModel(arm, scene)  # warns about missing meshes
    most = max_steps
    if most is None:
        cases = ((configurations[k % len(configurations)], listed[k % len(listed)]) for k in range(count))
        most = max(usual_max_steps(arm, start, target, limits) for start, target in cases)
    setting = _Setting(arm, chosen, limits, scene, max_steps, tolerance, keep, os.getpid())
    shared = Shared(setting)
    tasks = [
        delayed(_run_quietly)(shared, listed[k % len(listed)], configurations[k % len(configurations)])
        for k in range(count)
    ]
    ends: list[dict[str, Any]] = []
    motions: list[dict[str, NDArray[Any]]] = []
    with no_warnings():  # given above
        results = adaptively_in_order(tasks, jobs)
        while len(ends) < count:
            try:
                end, motion = next(results)
            except ProcessError as error:  # the runs that are there are kept
                results = iter([_lost_run(setting, task, error) for task in tasks[len(ends) :]])
                continue
            ends.append(end)
            motions.append(motion)
            if progress is not None:
                progress(len(ends), count)
    batch = Batch(
        arm=arm,
        targets=tuple(listed),
        controller=repr(chosen),
        limits=limits,
        scene=scene,
        max_steps=int(most),
        tolerance=float(tolerance),
        motions=tuple(motions) if keep == "motions" else None,
        **{name: np.array([end[name] for end in ends]) for name in ends[0]},
    )
    failed = np.flatnonzero(batch.status == FAILED)
    if len(failed):
        warn_caller(f"{len(failed)} of {count} runs failed; run {failed[0]}: {batch.reason[failed[0]]}")
    return batch


def _targets(arm: Arm, targets: Target | Sequence[Target]) -> list[Target]:
    """Return the checked targets; errors name the one that does not fit."""
    if isinstance(targets, Target):
        targets.check_arm(arm)
        return [targets]
    try:
        listed = list(targets)
    except TypeError:
        raise InvalidValue("targets", targets, "a Target, or a sequence of Targets") from None
    for k, target in enumerate(listed):
        require_instance(f"targets[{k}]", target, Target, "a Target, as `resolve_targets` returns it")
        try:
            target.check_arm(arm)
        except InvalidValue as error:
            name = error.name.replace("target.", f"targets[{k}].")
            raise InvalidValue(name, error.value, error.allowed) from None
    return listed


def _starts(arm: Arm, starts: ArrayLike) -> list[Array]:
    """Return the checked starts; errors name the one that does not fit."""
    try:
        listed: list[Any] = list(starts)  # type: ignore[arg-type]
    except TypeError:
        allowed = f"a configuration of {arm.nq} numbers, or a sequence of them"
        raise InvalidValue("starts", starts, allowed) from None
    if listed and all(is_number(value) for value in listed):
        return [arm.checked_start(listed, "starts")]
    return [arm.checked_start(start, f"starts[{k}]") for k, start in enumerate(listed)]


def _count_runs(targets: int, starts: int) -> int:
    """Return the number of runs for numbers of targets and starts."""
    if min(targets, starts) == 0 or (targets != starts and min(targets, starts) > 1):
        allowed = "equal numbers, or one of either"
        raise InvalidValue("numbers of targets and starts", (targets, starts), allowed)
    return max(targets, starts)


def _run_quietly(
    shared: Shared[_Setting], target: Target, start: Array
) -> tuple[dict[str, Any], dict[str, NDArray[Any]]]:
    """Compute one run; in worker processes without warnings, which the caller has already given."""
    setting = shared.value
    if setting.process == os.getpid():
        return _run(setting, target, start)
    with no_warnings():
        return _run(setting, target, start)


def _run(setting: _Setting, target: Target, start: Array) -> tuple[dict[str, Any], dict[str, NDArray[Any]]]:
    """Compute one run; return its entries in the columns of `Batch` and, if motions are kept, its arrays."""
    try:
        move = partial(
            track,
            setting.arm,
            target,
            start,
            setting.controller,
            setting.limits,
            setting.scene,
            tolerance=setting.tolerance,
        )
        run = move(max_steps=setting.max_steps)
        run = name_enough_steps(run, setting.controller, lambda steps: move(max_steps=steps))
    except ControllerError:  # a mistake in the code of the user
        raise
    except PostureError as error:
        run = _failed_run(setting, target, start, error)
    return _recorded(setting, run)


def _lost_run(
    setting: _Setting, task: Any, error: PostureError
) -> tuple[dict[str, Any], dict[str, NDArray[Any]]]:
    """Record a run whose process was ended; `task` is its call, made by `joblib.delayed`."""
    _, (_, target, start), _ = task
    return _recorded(setting, _failed_run(setting, target, start, error))


def _recorded(setting: _Setting, run: Run) -> tuple[dict[str, Any], dict[str, NDArray[Any]]]:
    """Return the entries of a run in the columns of `Batch` and, if motions are kept, its arrays."""
    closest = smallest_distance(run)
    ends = {
        "status": run.status,
        "reason": run.reason,
        "steps": run.steps,
        "start_error": float(run.posture_error[0]),
        "final_error": float(run.posture_error[-1]),
        "mean_error": float(run.mean_error[-1]),
        "path_length_ratio": run.path_length_ratio,
        "clearance": closest.distance,
        "closest": " and ".join(closest.pair or ()),
        "q_start": run.q[0],
        "q_final": run.q[-1],
    }
    return ends, run_arrays(run) if setting.keep == "motions" else {}


def _failed_run(setting: _Setting, target: Target, start: Array, error: PostureError) -> Run:
    """Return a run without steps that an error ended."""
    reason = f"{type(error).__name__}: {' '.join(str(error).split())}"
    record = RunRecord(target, setting.arm.at(start), setting.scene)
    return record.run(setting.arm, setting.controller, setting.limits, FAILED, reason)
