"""The loop: step towards the target until there, stuck, or out of steps."""

from __future__ import annotations

import logging
import warnings
from collections.abc import Callable

import numpy as np
from numpy.typing import ArrayLike, NDArray

from pinposture.arm import Arm, ArmState
from pinposture.control import ConstrainedQP, Controller, Limits, Step, controller_named
from pinposture.control.checks import require_positive, require_whole
from pinposture.control.controller import Memory
from pinposture.errors import InvalidValue, PostureWarning
from pinposture.motion.record import Recorder
from pinposture.motion.trajectory import Trajectory
from pinposture.scene import Scene
from pinposture.target import Target

Array = NDArray[np.float64]
Callback = Callable[[int, ArmState, Step], object]

logger = logging.getLogger(__name__)

PATIENCE = 6.0
"""Joint travel without a new lowest posture error after which a run is stalled [rad]: 60 usual steps."""

PROGRESS = 1e-3
"""Relative fall of the posture error that counts as progress within it."""

ROUNDING = 1e-9
"""Share by which a sum of steps may be off."""

MENTIONED = 6
"""How many limits and distances that hold an arm are listed."""


def track(
    arm: Arm,
    target: Target,
    q0: ArrayLike,
    controller: str | Controller = "qp",
    limits: Limits | None = None,
    scene: Scene | None = None,
    max_steps: int = 300,
    tolerance: float | None = None,
    callback: Callback | None = None,
) -> Trajectory:
    """Drive the arm from a configuration to a target posture.

    Args:
        arm: the arm.
        target: where its control points should be.
        q0: configuration to start from, (nq,).
        controller: a controller, or the name of one with its default parameters; see `CONTROLLERS`.
        limits: what a step may not exceed; `Limits()` if None.
        scene: what to keep clear of, for a controller that can, as "qp"; with others the distances are only
            recorded. If None, that of the controller.
        max_steps: number of steps after which to stop.
        tolerance: mean distance of the control points from their targets at which the run has converged
            [m]; 1e-6 of the arm length if None. With limits of acceleration the arm may still be moving then:
            go on stepping until dq is 0 before a drive is cut.
        callback: called after each step with its number (from 1), the state reached and the step. The
            run stops if it returns True.

    Returns:
        The motion and everything recorded on the way. `status` is "converged", "stalled" (no step
        reduces the errors any more, or no progress in 6 rad of allowed joint travel, 60 steps of 0.1 rad,
        without those of an escape or on the way to a goal), "no_control_points" (the controller found none
        that it may move), "max_steps" or "stopped" (by the callback); `reason` says it in words.

    Raises:
        InvalidValue: q0, the target, max_steps or the tolerance do not fit.
        UnknownName: no controller has that name.
    """
    controller, scene = in_scene(controller_named(controller), scene)
    limits = Limits() if limits is None else limits
    if not isinstance(limits, Limits):
        raise InvalidValue("limits", limits, "Limits(...), or None")
    if not isinstance(target, Target):
        raise InvalidValue("target", target, "a Target, as `resolve_targets` returns it")
    target.check(arm)
    require_whole("max_steps", max_steps, 1)
    tolerance = 1e-6 * arm.length if tolerance is None else tolerance
    require_positive("tolerance", tolerance)

    state = arm.at(arm.checked(q0, "q0"))
    recorder = Recorder(target, state, scene)
    memory: Memory | None = None
    status, reason, last = "", "", None
    while not status:
        status, reason = _verdict(recorder, tolerance, max_steps)
        if status:
            break
        step = controller.step(state, target, limits, memory)
        memory, last = step.memory, step
        if step.diagnostics.reason:
            # A controller that has points to control but no step to take is stuck.
            status = "stalled" if step.active else "no_control_points"
            reason = step.diagnostics.reason
            break
        state = arm.at(arm.integrate(state.q, step.dq))
        recorder.add(state, step, limits.travel(state))
        if callback is not None and callback(recorder.steps, state, step) is True:
            status, reason = "stopped", f"stopped by the callback after {recorder.steps} steps"
    if status in ("stalled", "max_steps") and last is not None:
        reason += _what_holds(arm, last)
    if status in ("stalled", "max_steps") and target.q is None and not isinstance(controller, ConstrainedQP):
        reason += "; the target knows no configuration, with which Switching finds the way: see fit_points"
    logger.info("%s: %s after %d steps: %s", controller.name, status, recorder.steps, reason)
    return recorder.trajectory(arm, controller, limits, status, reason)


def in_scene(controller: Controller, scene: Scene | None) -> tuple[Controller, Scene | None]:
    """The controller told of the scene, and the scene; a warning if it cannot keep clear of it."""
    if not (scene is None or isinstance(scene, Scene)):
        raise InvalidValue("scene", scene, "a Scene(...), or None")
    if isinstance(controller, ConstrainedQP):
        return (controller, controller.scene) if scene is None else (controller.with_scene(scene), scene)
    if scene is not None:
        text = f'{controller.name} does not keep clear of anything, distances are only recorded; "qp" does'
        warnings.warn(text, PostureWarning, stacklevel=3)
    return controller, scene


def _what_holds(arm: Arm, step: Step) -> str:
    """What held the last step back, in words: limits that bind, and distances at their bound."""
    held = [f"{arm.joint_names[j]} at its limit" for j in np.flatnonzero(step.diagnostics.clipped)]
    held += step.diagnostics.near
    if not held:
        return ""
    more = f" and {len(held) - MENTIONED} more" if len(held) > MENTIONED else ""
    return f"; held by {', '.join(held[:MENTIONED])}{more}"


def _verdict(recorder: Recorder, tolerance: float, max_steps: int) -> tuple[str, str]:
    """Whether the run is over, and why; empty while it goes on."""
    mean = recorder.mean_error
    if mean <= tolerance:
        return "converged", f"mean point error {mean:.3g} m is within the tolerance of {tolerance:.3g} m"
    if recorder.steps >= max_steps:
        return "max_steps", f"mean point error {mean:.3g} m, above the tolerance of {tolerance:.3g} m"
    idle = recorder.travel_without_progress(PROGRESS)
    if idle >= PATIENCE * (1.0 - ROUNDING):
        return (
            "stalled",
            f"mean point error {mean:.3g} m, no progress in the last {idle:.3g} rad of joint travel",
        )
    return "", ""
