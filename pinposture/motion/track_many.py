"""Many runs of one arm, in parallel processes."""

from __future__ import annotations

import os
from collections.abc import Sequence
from dataclasses import dataclass
from functools import partial
from typing import TYPE_CHECKING, Any, Literal

import numpy as np
from numpy.typing import ArrayLike, NDArray

from pinposture._validation import (
    is_number,
    require_function,
    require_instance,
    require_known,
    require_positive,
    require_whole,
)
from pinposture.arm import Arm
from pinposture.collision import CollisionModel, Scene
from pinposture.control import Controller, Limits, controller_named
from pinposture.control.limits import require_limits
from pinposture.errors import (
    ControllerError,
    InvalidValue,
    PostureError,
    ProcessError,
    no_warnings,
    warn_caller,
)
from pinposture.motion.batch import FAILED, Batch
from pinposture.motion.loop import RunRecord, in_scene
from pinposture.motion.run import Run, run_arrays, smallest_distance
from pinposture.motion.track import name_enough_steps, track, usual_max_steps
from pinposture.placement import Target

if TYPE_CHECKING:
    from pinposture.motion.processes import Progress, Shared

Array = NDArray[np.float64]


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

    chosen, scene = in_scene(controller_named(controller), scene)
    limits = require_limits(limits)
    require_function("progress", progress)
    if max_steps is not None:
        require_whole("max_steps", max_steps, 1)
    tolerance = 1e-6 * arm.length if tolerance is None else tolerance
    require_positive("tolerance", tolerance)
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
        **{name: np.array([each[name] for each in ends]) for name in ends[0]},
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
