"""Drive an arm to a target: steps until it converges, stalls, or runs out of steps."""

from __future__ import annotations

import logging
from collections.abc import Callable
from dataclasses import replace
from math import ceil
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from pinposture._validation import require_function, require_instance, require_positive, require_whole
from pinposture.arm import Arm
from pinposture.arm.arm import check_range
from pinposture.collision import CollisionModel, Scene
from pinposture.collision.model import describe_distance
from pinposture.control import Controller, Geodesic, Limits
from pinposture.control.controller import JointInterpolation
from pinposture.control.limits import require_limits
from pinposture.control.torque_limits import find_overload, require_held
from pinposture.motion.loop import Callback, RecordedLoop, describe_arrival, in_scene
from pinposture.motion.run import ENDINGS, RAISE_STEPS, Run
from pinposture.placement import Target
from pinposture.units import CONVERGED

Array = NDArray[np.float64]


class StepBudget(NamedTuple):
    """How many steps a run may take, if the caller does not say."""

    fewest: int = 300
    """Number of steps after which a run stops unless another one is given, if it has no time limits."""

    detour: float = 10.0
    """With time limits: number of steps after which it stops, relative to those of the straight joint path.
    It is that of motions through keyframes; a run that makes no progress stops long before."""

    most: int = 1_000_000
    """Largest number of these steps, as for motions through keyframes."""

    most_unseen_steps: int = 20_000
    """Most steps with which a run that is out of steps is made again to find how many it needs: seconds."""


STEP_BUDGET = StepBudget()


def cycles_between(arm: Arm, start: Array, target: Target, limits: Limits) -> float:
    """Estimate the number of steps of the straight path in joint space from a configuration to a target.

    Args:
        arm: the arm.
        start: the configuration, (nq,).
        target: the target; without a configuration, half a turn of each joint is assumed.
        limits: the limits of each step.
    """
    bounds = limits.for_arm(arm)
    distance = (
        np.where(arm.slides, arm.length, np.pi) if target.q is None else arm.difference(start, target.q)
    )
    distance = np.abs(distance)
    with np.errstate(over="ignore"):  # a tiny limit: infinitely many
        cycles = distance / bounds.bound
    if bounds.brake is not None:  # from rest to rest, at full speed in between if the way is long enough
        cruising = distance >= bounds.bound**2 / bounds.brake
        cycles = np.where(
            cruising, cycles + bounds.bound / bounds.brake, 2.0 * np.sqrt(distance / bounds.brake)
        )
    return float(cycles.max(initial=0.0))


def usual_max_steps(arm: Arm, start: Array, target: Target, limits: Limits) -> int:
    """Return the number of steps after which a run stops unless another one is given; as `cycles_between`."""
    return STEP_BUDGET.fewest if limits.dt is None else ample_steps(arm, start, target, limits)


def ample_steps(arm: Arm, start: Array, target: Target, limits: Limits) -> int:
    """Return a number of steps that is enough for most runs; as `cycles_between`."""
    needed = STEP_BUDGET.detour * cycles_between(arm, start, target, limits)
    return max(STEP_BUDGET.fewest, ceil(min(needed, STEP_BUDGET.most)))


def describe_blocked_goal(arm: Arm, target: Target, limits: Limits, scene: Scene | None) -> str:
    """Return a leading clause if the arm may not be at the configuration of a target, else ""."""
    if target.q is None:
        return ""
    overload = find_overload(arm, target.q, limits)
    if overload is not None:
        return f"in the target posture, {overload}; "
    if scene is None:
        return ""
    closest = CollisionModel(arm, scene).minimum(target.q)
    if closest.pair is None or closest.distance >= scene.margin:
        return ""
    apart = describe_distance(closest.pair, closest.distance)
    how = "is in collision" if closest.distance < 0.0 else "is within the margin"
    return f"the target posture {how}: {apart} (the margin is {1e3 * scene.margin:.3g} mm); "


logger = logging.getLogger(__name__)


def track(
    arm: Arm,
    target: Target,
    q0: ArrayLike,
    controller: str | Controller = "geodesic",
    limits: Limits | None = None,
    scene: Scene | None = None,
    *,
    max_steps: int | None = None,
    tolerance: float | None = None,
    callback: Callback | None = None,
    strict: bool = True,
) -> Run:
    """Drive the arm from a configuration to a target posture.

    Args:
        arm: the arm.
        target: the target posture.
        q0: the initial configuration, (nq,).
        controller: a controller, or the name of one with its default parameters; see `CONTROLLERS`.
        limits: the limits of each step; `Limits()` if None.
        scene: the obstacles, which "geodesic" avoids, as it keeps the arm clear of itself; with other
            controllers, distances are only recorded. None: the scene of the controller; if that has none, the
            arm is free to pass through itself, but `faults` says so.
        max_steps: number of steps after which to brake, if the arm is still on its way. Within limits of
            acceleration or torque, more steps bring it to rest, and count in `Run.steps`: where motors are
            weak, about as many as it took to speed up. None: 300, and with time limits (`dt`) ten times those
            of the straight path in joint space if that is more.
        tolerance: mean distance of the control points from their targets at which the run converges [m];
            1e-6 of the arm length if None.
        callback: called after each step with its number, 1-based, the state after it and the step, but not
            while the arm brakes to rest. The run stops if it returns True.
        strict: whether a start, or a configuration of the target, that the motors cannot hold within torque
            limits of `limits` is refused. If not, the run goes on, and `faults` says so.

    Returns:
        The run. `status` is "converged", "stalled" (no step reduces the errors further, or no progress in
        6 rad of allowed joint travel, 60 steps of 0.1 rad, not counting steps along a path or around a local
        minimum), "no_control_points" (the controller found none that it can move), "max_steps" or "stopped"
        (by the callback); `reason` explains it.

    Raises:
        InvalidValue: q0, the target, max_steps or the tolerance is invalid, the target belongs to another
            arm, or q0 or the configuration of the target is so far outside the limits that it may be in
            degrees, or cannot be held.
        WeightUnknown: torque limits, and masses, or all limits of the arm, are not known.
        UnknownName: there is no controller of that name.
    """
    controller, scene = in_scene(controller, scene)
    limits = require_limits(limits)
    require_instance("target", target, Target, "a Target, as `resolve_targets` returns it")
    target.check_arm(arm)
    if target.q is not None:
        check_range(arm, target.q, "target.q")
    require_function("callback", callback)
    if max_steps is not None:
        require_whole("max_steps", max_steps, 1)
    tolerance = CONVERGED * arm.length if tolerance is None else require_positive("tolerance", tolerance)

    start = arm.checked_start(q0, "q0")
    require_instance("strict", strict, bool, "True or False")
    if strict and limits.effort is not None:
        require_held(arm, start, limits, "q0")
        if target.q is not None:
            require_held(arm, target.q, limits, "target.q")
    if max_steps is None:
        max_steps = usual_max_steps(arm, start, target, limits)

    loop = RecordedLoop(arm, start, target, controller, limits, scene)
    status, reason = loop.run(target, tolerance, max_steps, callback)
    loop.brake_to_rest()
    if status == "converged":  # at rest it may be nearer
        reason = describe_arrival(arm, loop.record.mean_error, tolerance)
    if status in ("stalled", "max_steps"):
        reason = describe_blocked_goal(arm, target, limits, scene) + reason
        if target.q is None and not isinstance(controller, Geodesic):
            reason += "; the target has no configuration: fit_points finds one, and Switching can then use it"
    if status == "max_steps":
        reason += f"; {RAISE_STEPS} continue"
    logger.info("%s: %s after %d steps: %s", controller.name, status, loop.record.steps, reason)
    return loop.record.run(arm, controller, limits, status, reason)


def name_enough_steps(run: Run, controller: Controller, again: Callable[[int], Run]) -> Run:
    """Name a number of steps that is enough, in the reason of a run that is out of steps.

    The run is made again with more of them, for people who wait for one result. It is not worth while for a
    controller that may plan in each step.

    Args:
        run: the run; another one than that is returned as it is.
        controller: its controller.
        again: makes the run again with another `max_steps`.
    """
    if run.status != "max_steps" or not _goes_on_fast(controller, run.scene):
        return run
    most = min(ample_steps(run.arm, run.q[0], run.target, run.limits), STEP_BUDGET.most_unseen_steps)
    direct = cycles_between(run.arm, run.q[0], run.target, run.limits)
    if max(direct, run.steps + 1) > most:
        return run
    longer = again(most)
    if longer.converged:
        advice = f"{RAISE_STEPS} {longer.steps}"
    elif longer.status == "max_steps":
        advice = f"{RAISE_STEPS} more than {longer.steps}"
    else:
        advice = f"more steps do not help: after {longer.steps} it {ENDINGS[longer.status]}: {longer.reason}"
    return replace(run, reason=run.reason.removesuffix(f"{RAISE_STEPS} continue") + advice)


def _goes_on_fast(controller: Controller, scene: Scene | None) -> bool:
    """Whether a controller plans at most once; with tasks in a scene, each step may."""
    if isinstance(controller, Geodesic):
        return scene is None or not controller.tasks
    return isinstance(controller, JointInterpolation)
