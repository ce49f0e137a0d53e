"""Many runs of one arm, on as many processes as there can be."""

from __future__ import annotations

import os
import warnings
from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Literal, NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from pinposture._validation import is_number, require_positive, require_whole
from pinposture.arm import Arm
from pinposture.collision import CollisionModel, Scene
from pinposture.control import Controller, Limits, controller_named
from pinposture.control.limits import require_limits
from pinposture.errors import InvalidValue, PostureError, PostureWarning
from pinposture.motion.batch import FAILED, Batch, concatenate_runs, run_arrays
from pinposture.motion.track import RunRecord, in_scene, track
from pinposture.motion.trajectory import Trajectory
from pinposture.placement import Target

if TYPE_CHECKING:
    from pinposture.motion.processes import Progress, Shared

Array = NDArray[np.float64]

KEEP = ("motions", "ends")


@dataclass(frozen=True)
class _Setting:
    """The arguments that all runs share."""

    arm: Arm
    controller: Controller
    limits: Limits
    scene: Scene | None
    max_steps: int
    tolerance: float
    keep: str
    process: int


class _Ends(NamedTuple):
    """The results of one run that a `Batch` has as columns."""

    status: str
    reason: str
    steps: int
    start_error: float
    final_error: float
    mean_error: float
    path_length_ratio: float
    clearance: float
    q_start: Array
    q_final: Array


def track_many(
    arm: Arm,
    targets: Target | Sequence[Target],
    starts: ArrayLike,
    controller: str | Controller = "geodesic",
    limits: Limits | None = None,
    scene: Scene | None = None,
    max_steps: int = 300,
    tolerance: float | None = None,
    jobs: int | None = None,
    keep: Literal["motions", "ends"] = "motions",
    progress: Progress | None = None,
) -> Batch:
    """Drive an arm from many configurations to a target posture, or to many.

    Each run is what `track` makes of it. There is one for each start and target at the same place; a single
    target serves all starts, a single start all targets.

    With `joblib.parallel_config(backend="dask")` or another backend around the call, runs are computed where
    that says. Nothing but the time depends on it, nor on the number of processes.

    Args:
        arm: the arm.
        targets: where its control points should be; one target, or one for each run.
        starts: configurations to start from, (count, nq); or one, (nq,).
        controller: a controller, or the name of one with its default parameters; see `CONTROLLERS`.
        limits: the limits of each step; `Limits()` if None.
        scene: what to keep clear of, as in `track`.
        max_steps: number of steps after which a run stops.
        tolerance: mean distance of the control points from their targets at which a run has converged
            [m]; 1e-6 of the arm length if None.
        jobs: number of processes, -1 for all there can be. If None, as `joblib.parallel_config` says; if it
            says nothing, all there can be, once there is more to do than it takes to start them.
        keep: "motions", or "ends" to save memory: 0.5 kB for each step of an arm of 40 degrees of freedom.
        progress: called with the number of runs finished so far, and that of all.

    Returns:
        How each run ended, and its motion, in the order of starts and targets. A run that an error of
        this package ends does not end the others: it is recorded as "failed", and a `PostureWarning` tells.

    Raises:
        InvalidValue: numbers of targets and starts that do not fit each other, one of them that does not fit
            the arm, or another argument that `track` would not take. Then nothing has run.
        UnknownName: no controller has that name.
    """
    # joblib takes longer to import than most of this package, and who tracks one run does not need it.
    from joblib import delayed

    from pinposture.motion.processes import Shared, adaptively_in_order, check_jobs

    chosen, scene = in_scene(controller_named(controller), scene)
    limits = require_limits(limits)
    require_whole("max_steps", max_steps, 1)
    tolerance = 1e-6 * arm.length if tolerance is None else tolerance
    require_positive("tolerance", tolerance)
    if jobs is not None:
        check_jobs(jobs)
    if keep not in KEEP:
        raise InvalidValue("keep", keep, " or ".join(map(repr, KEEP)))
    listed, configurations = _targets(arm, targets), _starts(arm, starts)
    count = _count_runs(len(listed), len(configurations))
    limits.bound(arm.at(configurations[0]))  # so that limits of another arm are refused now
    if scene is not None:
        CollisionModel(arm, scene)  # which warns of meshes that are missing
    setting = _Setting(arm, chosen, limits, scene, max_steps, tolerance, keep, os.getpid())
    shared = Shared(setting)
    tasks = [
        delayed(_run_quietly)(shared, listed[k % len(listed)], configurations[k % len(configurations)])
        for k in range(count)
    ]
    ends, motions = [], []
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", PostureWarning)  # they have been given
        for done, (end, motion) in enumerate(adaptively_in_order(tasks, jobs), 1):
            ends.append(end)
            motions.append(motion)
            if progress is not None:
                progress(done, count)
    columns = zip(_Ends._fields, zip(*ends, strict=True), strict=True)
    batch = Batch(
        arm=arm,
        targets=tuple(listed),
        controller=repr(chosen),
        limits=limits,
        scene=scene,
        max_steps=int(max_steps),
        tolerance=float(tolerance),
        motions=concatenate_runs(motions) if keep == "motions" else None,
        **{name: np.array(values) for name, values in columns},
    )
    failed = np.flatnonzero(batch.status == FAILED)
    if len(failed):
        text = f"{len(failed)} of {count} runs failed; run {failed[0]}: {batch.reason[failed[0]]}"
        warnings.warn(text, PostureWarning, stacklevel=2)
    return batch


def _targets(arm: Arm, targets: Target | Sequence[Target]) -> list[Target]:
    """The targets, checked; names the one that does not fit."""
    if isinstance(targets, Target):
        targets.check(arm)
        return [targets]
    try:
        listed = list(targets)
    except TypeError:
        raise InvalidValue("targets", targets, "a Target, or a sequence of them") from None
    for k, target in enumerate(listed):
        if not isinstance(target, Target):
            raise InvalidValue(f"targets[{k}]", target, "a Target, as `resolve_targets` returns it")
        try:
            target.check(arm)
        except InvalidValue as error:
            name = error.name.replace("target", f"targets[{k}]", 1)
            raise InvalidValue(name, error.value, error.allowed) from None
    return listed


def _starts(arm: Arm, starts: ArrayLike) -> list[Array]:
    """The starts, checked; names the one that does not fit."""
    try:
        listed: list[Any] = list(starts)  # type: ignore[arg-type]
    except TypeError:
        raise InvalidValue("starts", starts, f"({arm.nq},) numbers, or a sequence of such") from None
    if listed and all(is_number(value) for value in listed):
        return [arm.checked_start(listed, "starts")]
    return [arm.checked_start(start, f"starts[{k}]") for k, start in enumerate(listed)]


def _count_runs(targets: int, starts: int) -> int:
    """The number of runs that so many targets and starts make."""
    if min(targets, starts) == 0 or (targets != starts and min(targets, starts) > 1):
        allowed = "as many targets as starts, or one of either"
        raise InvalidValue("numbers of targets and starts", (targets, starts), allowed)
    return max(targets, starts)


def _run_quietly(
    shared: Shared[_Setting], target: Target, start: Array
) -> tuple[_Ends, dict[str, NDArray[Any]]]:
    """Compute one run; in a worker process without warnings, which the caller has given."""
    setting = shared.value
    if setting.process == os.getpid():
        return _run(setting, target, start)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", PostureWarning)
        return _run(setting, target, start)


def _run(setting: _Setting, target: Target, start: Array) -> tuple[_Ends, dict[str, NDArray[Any]]]:
    """Compute one run; return its results and, if motions are kept, its arrays."""
    try:
        run = track(
            setting.arm,
            target,
            start,
            setting.controller,
            setting.limits,
            setting.scene,
            setting.max_steps,
            setting.tolerance,
        )
    except PostureError as error:
        run = _failed_run(setting, target, start, f"{type(error).__name__}: {' '.join(str(error).split())}")
    ends = _Ends(
        status=run.status,
        reason=run.reason,
        steps=run.steps,
        start_error=float(run.posture_error[0]),
        final_error=float(run.posture_error[-1]),
        mean_error=float(run.mean_error[-1]),
        path_length_ratio=run.path_length_ratio,
        clearance=float(run.clearance.min()),
        q_start=run.q[0],
        q_final=run.q[-1],
    )
    return ends, run_arrays(run) if setting.keep == "motions" else {}


def _failed_run(setting: _Setting, target: Target, start: Array, reason: str) -> Trajectory:
    """Return a run without steps, which an error ended."""
    record = RunRecord(target, setting.arm.at(start), setting.scene)
    return record.trajectory(setting.arm, setting.controller, setting.limits, FAILED, reason)
