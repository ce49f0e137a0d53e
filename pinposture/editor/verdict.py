"""Whether an arm can take a shape, and if not, why; in the words of whoever drew it."""

from __future__ import annotations

import warnings
from typing import NamedTuple

import numpy as np

from pinposture.arm import Arm
from pinposture.collision import CollisionModel, Scene
from pinposture.collision.scene import obstacles_around
from pinposture.errors import (
    CurveBendsTooMuch,
    CurveEndsEarly,
    CurveLeavesTooSharply,
    PostureError,
    PostureWarning,
    TargetError,
    TaskError,
)
from pinposture.placement import Target
from pinposture.task import Keyframe
from pinposture.task.reference import tip_off
from pinposture.task.resolving import resolve_keyframe

NEAR_LIMIT = 1e-3
"""How near to a limit of its position a joint is at it, in `Arm.joint_units`."""

REST = 1.5
"""How much of a curve may be left over without being told, in longest modules: some is needed to bend."""

NAMED = 3
"""How many joints are named."""

TOUCHING = 1e-6
"""How deep links may be inside each other and still only touch, in arm lengths."""


class Verdict(NamedTuple):
    """What an arm can make of a shape.

    Attributes:
        target: what it takes; None if it cannot.
        reason: why it cannot, in words; empty if it can.
        notes: what is to be known of it though it can: in collision, at limits, longer than the arm.
        collision: whether it would touch something, come nearer than the margin, or be inside itself.
        distance_from_curve: of the farthest place on its links from the curve [m], as of
            `Target.distance_from_curve`; None if it cannot take the shape.
        tip_error: by how much it would miss the task of the tip [m], turns by their lever; None without one.
    """

    target: Target | None
    reason: str = ""
    notes: tuple[str, ...] = ()
    collision: bool = False
    distance_from_curve: float | None = None
    tip_error: float | None = None

    @property
    def mark(self) -> str:
        """The verdict in a word: "refused", "collides" or "fine"."""
        return "refused" if self.target is None else "collides" if self.collision else "fine"


def judge(
    arm: Arm, keyframe: Keyframe, scene: Scene | None, near: Target | None = None, search: bool = True
) -> Verdict:
    """See whether an arm can take the shape of a keyframe.

    Args:
        arm: the arm.
        keyframe: the keyframe.
        scene: what it should keep clear of; None if there is nothing.
        near: what it takes on a curve that differs a little, to begin with; None if that is not known.
        search: whether to look farther where nothing is found near that, which can take seconds.
    """
    try:
        target = _resolved(arm, keyframe, near, search)
    except (PostureError, ArithmeticError, np.linalg.LinAlgError) as error:
        return Verdict(None, _reason(error))
    return review(arm, keyframe, target, scene)


def _resolved(arm: Arm, keyframe: Keyframe, near: Target | None, search: bool) -> Target:
    try:
        return resolve_keyframe(arm, keyframe, near)
    except TargetError:
        if near is None or not search:
            raise
    return resolve_keyframe(arm, keyframe)


def review(arm: Arm, keyframe: Keyframe, target: Target, scene: Scene | None) -> Verdict:
    """What is to be known of a target that the arm can take; arguments as for `judge`."""
    notes = [*_rest(arm, target), *_at_limits(arm, target)]
    touching = _touching(arm, target, scene) or _inside_itself(arm, target, scene)
    tip = None if target.q is None else tip_off(keyframe.tip, target, arm.at(target.q))
    away = target.distance_from_curve(arm)
    return Verdict(target, "", (*touching, *notes), bool(touching), away, tip)


def _reason(error: Exception) -> str:
    """An error in the words of whoever drew the curve."""
    if isinstance(error, TaskError):
        return " ".join(error.reason.split())  # without the number: it is that of a keyframe by itself
    if not isinstance(error, TargetError):
        return " ".join(str(error).split())
    where = f"at module {error.module}, {error.parameter:.3g} m along the curve"
    if isinstance(error, CurveEndsEarly):
        return f"too short: the curve ends before the arm does, {where}; draw it longer"
    if isinstance(error, CurveLeavesTooSharply):
        return "bends too much at the base: the curve leaves in a direction that the first module cannot take"
    if isinstance(error, CurveBendsTooMuch):
        return f"bends too much, {where}: {error.reason}"
    return " ".join(str(error).split())


def _rest(arm: Arm, target: Target) -> list[str]:
    """Say how much of the curve the arm leaves uncovered, if that is worth telling."""
    if target.curve is None or target.parameters is None:
        return []
    rest = target.curve.length - float(target.parameters[target.has_target].max(initial=0.0))
    if rest <= REST * float(arm.chain.module_lengths.max()):
        return []
    return [f"too long by {rest:.3g} m: the arm leaves the grey part of the curve"]


def _at_limits(arm: Arm, target: Target) -> list[str]:
    """Name the joints that are at limits of their positions."""
    if target.q is None:
        return []
    positions = arm.positions(target.q)
    room = np.minimum(positions - arm.limits.lower, arm.limits.upper - positions) / arm.joint_units
    near = room[arm.columns] < NEAR_LIMIT
    names = [name for name, at in zip(arm.chain.joints, near, strict=True) if at]
    if not names:
        return []
    more = f" and {len(names) - NAMED} more" if len(names) > NAMED else ""
    return [f"at the limit of {', '.join(names[:NAMED])}{more}"]


def _touching(arm: Arm, target: Target, scene: Scene | None) -> list[str]:
    """Say what the arm would touch, or come too near to."""
    if scene is None or target.q is None:
        return []
    around = obstacles_around(scene, arm.chain.base)
    if around:
        return [f"in collision: {around[0]} stands where the base of the arm is"]
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", PostureWarning)
        closest = CollisionModel(arm, scene).minimum(target.q)
    if closest.pair is None or closest.distance >= scene.margin:
        return []
    body, other = closest.pair
    if closest.distance < 0.0:
        return [f"in collision: {body} is {-closest.distance:.3g} m inside {other}"]
    return [f"nearer than the margin: {body} is {closest.distance:.3g} m from {other}"]


def _inside_itself(arm: Arm, target: Target, scene: Scene | None) -> list[str]:
    """Say which links of the arm would be inside each other."""
    if target.q is None:
        return []
    closest = CollisionModel(arm, itself(scene)).minimum(target.q)
    if closest.pair is None or closest.distance >= -TOUCHING * arm.length:
        return []
    body, other = closest.pair
    return [f"in collision with itself: {body} is {-closest.distance:.3g} m inside {other}"]


def itself(scene: Scene | None) -> Scene:
    """The arm alone as a scene, as thick as it is in another."""
    return Scene({}, self_collision=True, arm_radius=None if scene is None else scene.arm_radius)
