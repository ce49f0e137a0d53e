"""Comparison of methods: the measurable columns of Table 1.1."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import NamedTuple

import numpy as np
import pinocchio as pin
from joblib import delayed
from numpy.typing import NDArray

from benchmarks.baselines import named_controllers
from pinposture.arm import Arm, smooth_configuration
from pinposture.control import Controller, Limits
from pinposture.errors import InvalidValue
from pinposture.motion import track
from pinposture.motion.processes import in_order
from pinposture.placement import Target

Array = NDArray[np.float64]

REACHED = 1e-3
"""Mean point error, relative to the arm length, below which a run has reached its target."""

DISTANCES = (1e-1, 1e-2, 1e-3, 1e-4, 1e-5, 1e-6)
"""Distances from the straight arm at which steps are measured: largest joint motion [rad or sliding unit]."""


class MethodResult(NamedTuple):
    """Results of one method over all seeds. Distances are relative to the arm length.

    Attributes:
        controller: name of the method.
        runs: number of seeds.
        posture_error: final posture error, the sum over the control points; median over the seeds.
        end_effector_error: final distance of the last control point from its target; median.
        reached: share of runs that end with a mean point error below `REACHED`.
        returned: largest joint deviation after moving from A to B and back to the posture of A, in
            `Arm.joint_units`; median. 0 for a repeatable motion.
        peaks: largest joint motion requested in a step without limits, in `Arm.joint_units`, per mean point
            error of one arm length, at each of `DISTANCES` from the straight arm, (6,); largest over the
            seeds. Unbounded growth means instability near singular postures. 0 if the method never moves.
    """

    controller: str
    runs: int
    posture_error: float
    end_effector_error: float
    reached: float
    returned: float
    peaks: tuple[float, ...]


def compare_methods(
    arm: Arm,
    controllers: Sequence[str | Controller],
    seeds: Sequence[int],
    max_steps: int = 200,
    jobs: int = 1,
    progress: Callable[[MethodResult], object] | None = None,
) -> list[MethodResult]:
    """Run every method from smooth random starts to smooth random targets, and back.

    Starts and targets are configurations with a largest joint position between 0.2 and 1.0, so that every
    target is reachable. All control points have a target; end-effector methods only use the last one.

    Args:
        arm: the arm.
        controllers: controllers or their names.
        seeds: seeds of the cases.
        max_steps: maximum number of steps in each direction.
        jobs: number of processes; joblib's backends apply.
        progress: called with the result of each method as it arrives.

    Returns:
        One result for each controller, in order; independent of `jobs`.

    Raises:
        InvalidValue: no controller or no seed.
        UnknownName: no controller has that name.
    """
    listed = named_controllers(controllers)
    if len(seeds) == 0:
        raise InvalidValue("seeds", seeds, "at least one")
    tasks = (delayed(_one)(arm, controller, seed, max_steps) for controller in listed for seed in seeds)
    arriving = in_order(tasks, jobs)
    results = []
    for controller in listed:
        results.append(_summary(controller.name, [next(arriving) for _ in seeds]))
        if progress is not None:
            progress(results[-1])
    return results


def _summary(controller: str, cases: Sequence[tuple[Array, float, tuple[float, ...]]]) -> MethodResult:
    errors = np.array([errors for errors, _, _ in cases])  # (runs, m)
    return MethodResult(
        controller=controller,
        runs=len(cases),
        posture_error=float(np.median(errors.sum(axis=1))),
        end_effector_error=float(np.median(errors[:, -1])),
        reached=float(np.mean(errors.mean(axis=1) < REACHED)),
        returned=float(np.median([returned for _, returned, _ in cases])),
        peaks=tuple(float(peak) for peak in np.max([peaks for _, _, peaks in cases], axis=0)),
    )


def _one(
    arm: Arm, controller: Controller, seed: int, max_steps: int
) -> tuple[Array, float, tuple[float, ...]]:
    """Return the final point errors per arm length, (m,); `returned` and `peaks` as in `MethodResult`."""
    rng = np.random.default_rng(seed)
    start, goal = (smooth_configuration(arm, rng, rng.uniform(0.2, 1.0)) for _ in range(2))
    there, back = (Target.from_configuration(arm, q) for q in (goal, start))
    run = track(arm, there, start, controller, max_steps=max_steps)
    errors = run.point_errors[-1] / arm.length
    again = track(arm, back, run.q[-1], controller, max_steps=max_steps)
    apart = pin.difference(arm.model, start, again.q[-1]) / arm.joint_units
    return errors, float(np.abs(apart).max()), _peaks(arm, controller, goal, seed)


def _peaks(arm: Arm, controller: Controller, goal: Array, seed: int) -> tuple[float, ...]:
    """Return the largest requested motion per mean point error at each distance from the straight arm."""
    free = _without_limits(arm)  # otherwise the limits would cut the requested motion
    target = Target.from_configuration(free, goal)
    straight = arm.positions(arm.straight())
    shape = arm.positions(smooth_configuration(free, np.random.default_rng((seed, 1)), 1.0))
    peaks = []
    for distance in DISTANCES:
        state = free.at(free.configuration(straight + distance * shape))
        step = controller.step(state, target, Limits(step=None))
        error = float(np.linalg.norm(target.points - state.points, axis=1).mean()) / arm.length
        peaks.append(float(np.abs(step.dq / arm.joint_units).max()) / error)
    return tuple(peaks)


def _without_limits(arm: Arm) -> Arm:
    """Return the same arm without joint position limits."""
    model = pin.Model(arm.model)
    model.lowerPositionLimit = np.full(arm.nq, -np.inf)
    model.upperPositionLimit = np.full(arm.nq, np.inf)
    return Arm(model, arm.control_points, arm.base_placement, characteristic_length=arm.characteristic_length)
