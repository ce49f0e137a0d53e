"""The loop: step towards the target until there, stuck, or out of steps."""

from __future__ import annotations

import logging
import warnings

from numpy.typing import ArrayLike

from pinposture.arm import Arm
from pinposture.control import ConstrainedQP, Controller, Limits, controller_named
from pinposture.control.checks import require_positive, require_whole
from pinposture.errors import InvalidValue, PostureWarning
from pinposture.motion.drive import Callback, Drive
from pinposture.motion.trajectory import Trajectory
from pinposture.scene import Scene
from pinposture.target import Target

logger = logging.getLogger(__name__)


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
        max_steps: number of steps after which to stop. With limits of acceleration an arm that is moving
            then, or wherever the run ends, is brought to rest in a few more.
        tolerance: mean distance of the control points from their targets at which the run has converged
            [m]; 1e-6 of the arm length if None.
        callback: called after each step with its number (from 1), the state reached and the step; not while
            the arm is brought to rest. The run stops if it returns True.

    Returns:
        The motion and everything recorded on the way. `status` is "converged", "stalled" (no step
        reduces the errors any more, or no progress in 6 rad of allowed joint travel, 60 steps of 0.1 rad,
        without those of an escape or on the way to a goal), "no_control_points" (the controller found none
        that it may move), "max_steps" or "stopped" (by the callback); `reason` says it in words.

    Raises:
        InvalidValue: q0, the target, max_steps or the tolerance do not fit; or q0 or the configuration of the
            target are so far outside of the limits that degrees may have been meant.
        UnknownName: no controller has that name.
    """
    controller, scene = in_scene(controller_named(controller), scene)
    limits = Limits() if limits is None else limits
    if not isinstance(limits, Limits):
        raise InvalidValue("limits", limits, "Limits(...), or None")
    if not isinstance(target, Target):
        raise InvalidValue("target", target, "a Target, as `resolve_targets` returns it")
    target.check(arm)
    if target.q is not None:
        arm.checked_start(target.q, "target.q")
    require_whole("max_steps", max_steps, 1)
    tolerance = 1e-6 * arm.length if tolerance is None else tolerance
    require_positive("tolerance", tolerance)

    drive = Drive(arm, arm.checked_start(q0, "q0"), target, controller, limits, scene)
    status, reason = drive.until_there(target, tolerance, max_steps, callback)
    drive.come_to_rest()
    if status in ("stalled", "max_steps") and target.q is None and not isinstance(controller, ConstrainedQP):
        reason += "; the target knows no configuration, with which Switching finds the way: see fit_points"
    recorder = drive.recorder
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
