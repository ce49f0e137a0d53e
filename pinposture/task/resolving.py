"""Keyframes resolved for an arm: the configuration that takes each of them."""

from __future__ import annotations

import warnings
from collections.abc import Callable
from dataclasses import replace
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from pinposture import kernels
from pinposture.arm import Arm
from pinposture.arm.configurations import SLACK
from pinposture.control.planner.objective import Objective
from pinposture.control.planner.plan import find_goal
from pinposture.control.tasks import EndEffector
from pinposture.errors import PostureWarning, TargetError, TaskError
from pinposture.placement import Target, resolve_targets
from pinposture.placement.curve_placement import beginning
from pinposture.placement.least_squares import FitProblem, refined, stiffness
from pinposture.placement.module_kinematics import layout
from pinposture.placement.resolve import FAR, STIFFNESS, far_moved
from pinposture.task.interpolation import Beginning, BentCurve
from pinposture.task.keyframe import Keyframe, naming, title

# The configuration of a keyframe that also does what is asked of its tip.

Array = NDArray[np.float64]

GOOD = 1e-8
"""Mean distance of the control points from their targets at which all is settled, in arm lengths."""

MET = 1e-4
"""How far a strict task may be from being met, in arm lengths."""


def settled_tip(arm: Arm, target: Target, tip: EndEffector, where: str) -> Array:
    """The joint displacement (nv,) [rad or m] from a target's configuration to one that also serves the tip.

    Args:
        arm: the arm.
        target: the posture, with the configuration `q` that takes it.
        tip: what is asked of the tip.
        where: what to call the keyframe.

    Raises:
        TaskError: a strict task that the arm cannot do.
    """
    assert target.q is not None
    objective = Objective(arm, target, (tip,))
    edges = np.array([arm.limits.lower, arm.limits.upper])
    state = find_goal(objective, arm.at(target.q).compiled, edges, None, GOOD * arm.length).state
    left = objective.task_rows(state, priority=True)
    if left is not None and (missed := float(np.linalg.norm(left.errors))) > MET * arm.length:
        advice = (
            "move it nearer, let the posture count for a region only, or give a weight in place of strict"
        )
        raise TaskError(where, f"its strict tip task is missed by {missed:.4g} m at least; {advice}")
    return np.asarray(arm.difference(target.q, state.q))


# Keyframes resolved for an arm: the configuration that takes each, and one method for all of them.

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
        fixed: whether the motion has to take it at just these: they were asked for, or found by another
            method than the motion goes by.
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

    Quick, for one that is being changed. A motion takes the same posture at a keyframe that has `joints`; it
    resolves those without by one method, and comes to them by the way that is nearest.

    Args:
        arm: the arm.
        keyframe: the keyframe.
        near: as for `resolve_targets`; the joints of the keyframe if None.

    Raises:
        TargetError: as `resolve_targets`.
        TaskError: a curve that is too long, a strict task of the tip that is out of reach.
        InvalidValue: a region that the arm does not have.
    """
    where = title((keyframe,), 0)
    (keyframe,) = with_fitting_joints(arm, (keyframe,))
    target = _target(arm, keyframe, keyframe.method, near)
    assert target.q is not None and target.curve is not None
    begun = Beginning(target.curve, beginning(arm, target.curve)[0])
    _refuse_rest(arm, (keyframe,), 0, Resolved(begun, target, arm.positions(target.q), False))
    if keyframe.tip is not None:
        q = arm.integrate(target.q, tip_shift(arm, keyframe, target, target.q, where))
        return taken(arm, keyframe, target, q)
    return target if keyframe.region is None else target.region(*keyframe.region)


def tip_shift(arm: Arm, keyframe: Keyframe, target: Target, q: Array, where: str) -> Array:
    """The joint displacement (nv,) [rad or m] from a configuration (nq,) to one that serves the tip as well.

    Args:
        arm: the arm.
        keyframe: the keyframe; it asks something of the tip.
        target: its target, of the whole arm.
        q: the configuration that takes it.
        where: what to call it.

    Raises:
        TaskError: a strict task that the arm cannot do.
    """
    assert keyframe.tip is not None
    return settled_tip(arm, taken(arm, keyframe, target, q), keyframe.tip, where)


def with_fitting_joints(arm: Arm, keyframes: tuple[Keyframe, ...]) -> tuple[Keyframe, ...]:
    """The keyframes without `joints` that do not fit the arm; a `PostureWarning` names them."""
    fitting = []
    for index, keyframe in enumerate(keyframes):
        misfit = _misfit(arm, keyframe)
        if misfit:
            text = f"{title(keyframes, index)}: joints {misfit}; they are ignored"
            warnings.warn(text, PostureWarning, stacklevel=3)
        fitting.append(replace(keyframe, joints=None) if misfit else keyframe)
    return tuple(fitting)


def _misfit(arm: Arm, keyframe: Keyframe) -> str:
    """Why the joints of a keyframe do not fit the arm; empty if they do, or there are none."""
    if keyframe.joints is None:
        return ""
    if len(keyframe.joints) != arm.nv:
        return f"has {len(keyframe.joints)} values, and the arm {arm.nv} joints"
    positions = np.array(keyframe.joints)
    over = np.maximum(positions - arm.limits.upper, arm.limits.lower - positions)
    worst = int(np.argmax(over))
    if over[worst] <= SLACK:
        return ""
    low, high = arm.limits.lower[worst], arm.limits.upper[worst]
    return f"is {positions[worst]:.4g} for joint {worst + 1}, whose limits are {low:.4g} and {high:.4g}"


def taken(arm: Arm, keyframe: Keyframe, target: Target, q: Array) -> Target:
    """The target of a keyframe as the arm takes it at a configuration (nq,)."""
    curve, points = target.curve, arm.at(q).compiled.points
    assert curve is not None
    parameters, distances = map(np.asarray, curve.nearest(arm.chain.flattened(points)))
    weights, moved = np.ones(arm.n_modules), target.moved
    result = Target(points, weights, q, curve, parameters, distances, target.method, moved=moved)
    return result if keyframe.region is None else result.region(*keyframe.region)


def resolve_keyframes(arm: Arm, keyframes: tuple[Keyframe, ...]) -> Keyed:
    """Resolve all keyframes by one method, as far as they leave it open; those that have `joints` near these.

    That is sequential placement if it serves all without, else the least squares that serve those which it
    does not.

    Raises:
        TargetError: as `resolve_targets`, naming the keyframe.
        TaskError: a curve that is too long, likewise.
    """
    keyframes, targets = with_fitting_joints(arm, keyframes), []
    for index, keyframe in enumerate(keyframes):
        with naming(title(keyframes, index)):
            targets.append(_target(arm, keyframe, keyframe.method))
    free = [k for k, keyframe in enumerate(keyframes) if keyframe.joints is None]
    methods = {targets[k].method for k in free or range(len(targets))}
    method = "sequential"
    if methods != {"sequential"}:
        method = "smooth" if "smooth" in methods else "closest"
    resolved = []
    for keyframe, first in zip(keyframes, targets, strict=True):
        target = _by_method(arm, keyframe, first, method)
        assert target.q is not None and target.curve is not None
        begun = Beginning(target.curve, beginning(arm, target.curve)[0])
        fixed = target.method != method or keyframe.joints is not None
        resolved.append(Resolved(begun, target, arm.positions(target.q), fixed))
    for index, each in enumerate(resolved):
        _refuse_rest(arm, keyframes, index, each)
        moved = each.target.moved
        if keyframes[index].placement is None and moved is not None and moved.distance > FAR * arm.length:
            what = f"{title(keyframes, index)}: its curve"
            warnings.warn(far_moved(arm, what, moved), PostureWarning, stacklevel=3)
    longest = max(float(each.parameters[-1]) for each in resolved)
    return Keyed(tuple(resolved), method, MARGIN * max(longest, arm.length))


def _target(arm: Arm, keyframe: Keyframe, method: str, near: Target | None = None) -> Target:
    """The target of the whole arm, found near another, or near the joints of the keyframe, if it has some."""
    given: dict[str, Any] = {
        "placement": keyframe.placement or "align",
        "roll": keyframe.roll,
        "method": method,
    }
    if near is not None or keyframe.joints is None:
        return resolve_targets(arm, keyframe.curve, SAMPLES, near=near, **given)
    positions = np.clip(keyframe.joints, arm.limits.lower, arm.limits.upper)
    q = arm.configuration(positions)
    hint = Target(arm.at(q).compiled.points, np.ones(arm.n_modules), q=q)
    try:
        return resolve_targets(arm, keyframe.curve, SAMPLES, near=hint, **given)
    except TargetError:
        target = resolve_targets(arm, keyframe.curve, SAMPLES, **given)
    text = "joints: its curve has no posture near them; they are ignored"
    where = f"keyframe {keyframe.name!r}" if keyframe.name else "a keyframe"
    warnings.warn(f"{where}: {text}", PostureWarning, stacklevel=3)
    return target


def _by_method(arm: Arm, keyframe: Keyframe, target: Target, method: str) -> Target:
    """The target by the method of the motion, if the keyframe leaves that open and it has one."""
    if keyframe.method != "auto" or keyframe.joints is not None or target.method == method:
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


# Targets along curves that change a little from one to the next: each begins where the one before ended.

VISCOSITY = 3e-3
"""What motion costs on the way from one keyframe to the next, relative to what it does for the distances:
root of the ratio of the two, for a way of `USUAL` rows. It slows joints down that turn far for next to
nothing, as those do that roll a nearly straight arm; others lag behind by next to nothing."""

USUAL = 400
"""Rows from one keyframe to the next."""


class InTurn:
    """Sequential placement on curves that begin at the base of the arm, or beside it."""

    def __init__(self, arm: Arm) -> None:
        self._arm, (self._units, self._shapes) = arm, layout(arm.chain)
        self._limits = arm.limits.lower[arm.columns], arm.limits.upper[arm.columns]
        self._base = np.array(arm.chain.base)

    def positions(self, curve: BentCurve) -> Array | None:
        """Joint positions (nv,) that put the control points on a curve, None if there are none."""
        coefficients, end = curve.spline, curve.length
        knots = np.concatenate([[0.0, 0.0], np.repeat(curve.s, 2), [end, end]])
        ends = np.array([0.0, end])
        series = np.full((1, 2), 0.5 * end)  # the parameter is the arc length
        state = np.empty(9)
        state[0], state[1:4], state[4:7] = 0.0, self._base, curve.points[0]
        found, parameters = np.zeros(len(self._arm.columns)), np.empty(self._arm.n_modules)
        measured = knots, coefficients[None], 3, ends, ends, series
        given = SAMPLES, self._units, self._shapes, *self._limits
        if kernels.place_modules(*measured, *given, state, found, parameters) >= 0:
            return None
        positions = np.zeros(self._arm.nv)
        positions[self._arm.columns] = found
        return positions


class Follower:
    """Least squares of the whole arm, from a guess that is near.

    It is the problem of `least_squares` with its unknowns: joint positions, and arc lengths between control
    points, in units of the problem.
    """

    def __init__(self, arm: Arm, method: str) -> None:
        lengths = np.maximum(arm.chain.module_lengths, arm.chain.module_lengths.mean())
        self.problem = FitProblem(arm, 0.0, STIFFNESS[method] * float(np.median(lengths)))

    def miss(self, curve: BentCurve, unknowns: Array) -> float:
        """Root mean square distance from the curve, bending counted in, in arm lengths."""
        residual, _ = self.problem.evaluate(curve, unknowns)
        return float(np.sqrt(residual @ residual / self.problem.points))

    def march(self, curve_at: Callable[[int], BentCurve], rows: range, first: Array, way: float) -> Array:
        """Follow the curves of rows from unknowns that fit the first, (r, n + m).

        Args:
            curve_at: the curve of a row.
            rows: the rows.
            first: where to begin, (n + m,).
            way: how far joints move at most, if they move all the time [rad, or arm lengths].
        """
        found = np.empty((len(rows), len(first)))
        found[0] = first
        _, jacobian = self.problem.evaluate(curve_at(rows[0]), first)
        weight = VISCOSITY**2 * len(rows) / USUAL * stiffness(self.problem, jacobian.T @ jacobian)
        for i in range(1, len(rows)):
            ahead = found[i - 1] + (found[i - 1] - found[i - 2] if i > 1 else 0.0)
            curve = curve_at(rows[i])
            found[i] = refined(self.problem, curve, ahead, found[i - 1], weight, way / len(rows))
        return found
