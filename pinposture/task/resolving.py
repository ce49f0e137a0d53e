"""Keyframes resolved for an arm: the configuration that takes each, and one method for all of them."""

from __future__ import annotations

import warnings
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from pinposture.arm import Arm
from pinposture.errors import PostureWarning, TargetError, TaskError
from pinposture.target import Target, resolve_targets
from pinposture.target.placement import beginning
from pinposture.target.resolve import FAR, far_moved
from pinposture.task.bending import Beginning
from pinposture.task.keyframe import Keyframe, naming, title
from pinposture.task.settled_tip import settled_tip

Array = NDArray[np.float64]

SAMPLES = 200_000
"""Points that stand for a curve in sequential placement. With fewer, the joints would show in their
accelerations how control points pass from one straight piece to the next."""

MARGIN = 1.2
"""How much more of a curve than keyframes need is known in between, where the arm may cover more."""


class Resolved(NamedTuple):
    """A keyframe resolved for an arm.

    Attributes:
        begun: its curve in the world, and where the base of the arm is on it.
        target: its target, of the whole arm.
        positions: joint positions that take it, (nv,) [rad or m].
        fixed: whether it was asked for by another method than the motion goes by.
    """

    begun: Beginning
    target: Target
    positions: Array
    fixed: bool

    @property
    def parameters(self) -> Array:
        """Arc length of each control point, counted from the base of the arm, (m,) [m]."""
        assert self.target.parameters is not None
        return np.asarray(self.target.parameters - self.begun.parameter)


class Keyed(NamedTuple):
    """All keyframes of a motion, resolved.

    Attributes:
        keyframes: in order.
        method: how targets are found between them: "sequential", "smooth" or "closest".
        length: how much of a curve matters [m].
    """

    keyframes: tuple[Resolved, ...]
    method: str
    length: float


def resolve_keyframe(arm: Arm, keyframe: Keyframe, near: Target | None = None) -> Target:
    """The target of a keyframe by itself: what the arm can have of its posture and of the task of its tip.

    Quick, for one that is being changed: in a motion all keyframes are resolved by one method, and with more
    samples of their curves.

    Args:
        arm: the arm.
        keyframe: the keyframe.
        near: as for `resolve_targets`.

    Raises:
        TargetError: as `resolve_targets`.
        TaskError: a curve that is too long, a strict task of the tip that is out of reach.
        InvalidValue: a region that the arm does not have.
    """
    where = title((keyframe,), 0)
    target = resolve_targets(
        arm,
        keyframe.curve,
        placement=keyframe.placement or "align",
        roll=keyframe.roll,
        method=keyframe.method,
        near=near,
    )
    assert target.q is not None and target.curve is not None
    begun = Beginning(target.curve, beginning(arm, target.curve)[0])
    _refuse_rest(arm, (keyframe,), 0, Resolved(begun, target, arm.positions(target.q), False))
    if keyframe.tip is not None:
        q = arm.integrate(target.q, settled_tip(arm, target, keyframe.tip, where))
        return taken(arm, keyframe, target, q)
    return target if keyframe.region is None else target.region(*keyframe.region)


def taken(arm: Arm, keyframe: Keyframe, target: Target, q: Array) -> Target:
    """The target of a keyframe as the arm takes it at a configuration (nq,)."""
    curve, points = target.curve, arm.at(q).points
    assert curve is not None
    parameters, distances = map(np.asarray, curve.nearest(arm.chain.flattened(points)))
    weights, moved = np.ones(arm.n_modules), target.moved
    result = Target(points, weights, q, curve, parameters, distances, target.method, moved=moved)
    return result if keyframe.region is None else result.region(*keyframe.region)


def resolve_keyframes(arm: Arm, keyframes: tuple[Keyframe, ...]) -> Keyed:
    """Resolve all keyframes by one method, as far as they leave it open.

    That is sequential placement if it serves all of them, else the least squares that serve those which it
    does not.

    Raises:
        TargetError: as `resolve_targets`, naming the keyframe.
        TaskError: a curve that is too long, likewise.
    """
    targets = []
    for index, keyframe in enumerate(keyframes):
        with naming(title(keyframes, index)):
            targets.append(_target(arm, keyframe, keyframe.method))
    methods = {target.method for target in targets}
    method = "sequential"
    if methods != {"sequential"}:
        method = "smooth" if "smooth" in methods else "closest"
    resolved = []
    for keyframe, first in zip(keyframes, targets, strict=True):
        target = _by_method(arm, keyframe, first, method)
        assert target.q is not None and target.curve is not None
        begun = Beginning(target.curve, beginning(arm, target.curve)[0])
        resolved.append(Resolved(begun, target, arm.positions(target.q), target.method != method))
    for index, each in enumerate(resolved):
        _refuse_rest(arm, keyframes, index, each)
        moved = each.target.moved
        if keyframes[index].placement is None and moved is not None and moved.distance > FAR * arm.length:
            what = f"{title(keyframes, index)}: its curve"
            warnings.warn(far_moved(arm, what, moved), PostureWarning, stacklevel=3)
    longest = max(float(each.parameters[-1]) for each in resolved)
    return Keyed(tuple(resolved), method, MARGIN * max(longest, arm.length))


def _target(arm: Arm, keyframe: Keyframe, method: str) -> Target:
    given = {"placement": keyframe.placement or "align", "roll": keyframe.roll, "method": method}
    return resolve_targets(arm, keyframe.curve, SAMPLES, **given)  # type: ignore[arg-type]


def _by_method(arm: Arm, keyframe: Keyframe, target: Target, method: str) -> Target:
    """The target by the method of the motion, if the keyframe leaves that open and it has one."""
    if keyframe.method != "auto" or target.method == method:
        return target
    try:
        return _target(arm, keyframe, method)
    except TargetError:
        return target


def _refuse_rest(arm: Arm, keyframes: tuple[Keyframe, ...], index: int, resolved: Resolved) -> None:
    """Refuse a curve that the arm leaves much of uncovered, unless it was said to be trimmed."""
    begun, covered = resolved.begun, float(resolved.parameters[-1])
    length = begun.curve.length - begun.parameter
    if keyframes[index].trim or length - covered <= float(arm.chain.module_lengths.max()):
        return
    advice = "shorten it, use a longer arm, or set trim to take its first part"
    reason = f"the curve is {length:.4g} m long, and the arm covers {covered:.4g} m of it; {advice}"
    raise TaskError(title(keyframes, index), reason)
