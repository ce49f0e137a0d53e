"""Keyframes resolved for an arm: a configuration for each of them, and for the curves between them."""

from __future__ import annotations

import warnings
from collections.abc import Callable
from contextlib import suppress
from dataclasses import replace
from typing import Any, NamedTuple, cast

import numpy as np
from numpy.typing import NDArray

from pinposture import kernels
from pinposture.arm import Arm
from pinposture.arm.configurations import SLACK
from pinposture.control.planner.objective import Objective
from pinposture.control.planner.plan import find_goal
from pinposture.curve import Curve
from pinposture.errors import PostureWarning, TargetError, TaskError
from pinposture.placement import Target, resolve_targets
from pinposture.placement.curve_placement import beginning
from pinposture.placement.least_squares import FitProblem, refined, stiffness
from pinposture.placement.module_kinematics import is_compiled, unit_arrays
from pinposture.placement.resolve import FAR, STIFFNESS, far_moved
from pinposture.task.interpolation import AnchoredCurve, BentCurve
from pinposture.task.keyframe import Keyframe, naming, title

Array = NDArray[np.float64]

# Keyframes resolved for an arm: the configuration that takes each, and one method for all of them.

SEQUENTIAL_SAMPLES = 200_000
"""Points that represent a curve in sequential placement. With fewer, joint accelerations would show the steps
of control points from one straight piece to the next."""

CURVE_LENGTH_MARGIN = 1.2
"""Length of the curves between keyframes, relative to those at keyframes: the arm may cover more of them."""

POSTURE_TOLERANCE = 1e-8
"""Mean distance of the control points from their targets at which a posture is found, in arm lengths."""

STRICT_TIP_TOLERANCE = 1e-4
"""Largest error of a strict task of the tip, in arm lengths."""


class Resolved(NamedTuple):
    """A keyframe resolved for an arm.

    Attributes:
        anchored: its curve in the world, and where the base of the arm is on it.
        target: its target, of the whole arm.
        positions: joint positions that take it, (nv,) [rad or m].
        fixed: whether the motion has to pass through these positions: they were given, or found by another
            method than that of the motion.
    """

    anchored: AnchoredCurve
    target: Target
    positions: Array
    fixed: bool

    @property
    def parameters(self) -> Array:
        """Arc length of each control point, counted from the base of the arm, (m,) [m]."""
        return np.asarray(self.target.parameters, dtype=np.float64) - self.anchored.parameter


class ResolvedMotion(NamedTuple):
    """All keyframes of a motion, resolved.

    Attributes:
        keyframes: in order.
        method: how targets are found between them: "sequential", "smooth" or "closest".
        length: length of each curve that matters [m].
    """

    keyframes: tuple[Resolved, ...]
    method: str
    length: float


def resolve_keyframe(arm: Arm, keyframe: Keyframe, near: Target | None = None) -> Target:
    """Find the target of a single keyframe: its posture and the task of its tip, as far as the arm can.

    This is quick, for a keyframe that is being edited. A motion takes the same posture at a keyframe that has
    `joints`; those without are resolved by one method for the whole motion, and reached by the nearest path.

    Args:
        arm: the arm.
        keyframe: the keyframe.
        near: as for `resolve_targets`; the joints of the keyframe if None.

    Raises:
        TargetError: as `resolve_targets`.
        TaskError: a curve that is too long, a strict task of the tip that is out of reach.
        InvalidValue: a region that the arm does not have.
    """
    (keyframe,) = with_fitting_joints(arm, (keyframe,))
    target = _target(arm, keyframe, keyframe.method, near)
    _check_covered(arm, (keyframe,), 0, _resolved(arm, target, False))
    if keyframe.tip is not None:
        q = cast(Array, target.q)
        shift = tip_shift(arm, keyframe, target, q, title((keyframe,), 0))
        return target_at(arm, keyframe, target, arm.integrate(q, shift))
    return target if keyframe.region is None else target.region(*keyframe.region)


def resolve_keyframes(arm: Arm, keyframes: tuple[Keyframe, ...]) -> ResolvedMotion:
    """Resolve all keyframes, those that have `joints` near these, and all that leave it open by one method.

    That is sequential placement if closed forms do it for all keyframes without joints, else the least
    squares method that works for those where they do not.

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
    if methods != {"sequential"} or not is_compiled(arm):
        method = "smooth" if "smooth" in methods else "closest"
    resolved = []
    for index, keyframe in enumerate(keyframes):
        target = targets[index]
        if keyframe.method == "auto" and keyframe.joints is None and target.method != method:
            with suppress(TargetError):  # it keeps its own method
                target = _target(arm, keyframe, method)
        resolved.append(_resolved(arm, target, target.method != method or keyframe.joints is not None))
        _check_covered(arm, keyframes, index, resolved[-1])
        if (
            keyframe.placement is None
            and target.moved is not None
            and target.moved.distance > FAR * arm.length
        ):
            what = f"{title(keyframes, index)}: its curve"
            warnings.warn(far_moved(arm, what, target.moved), PostureWarning, stacklevel=3)
    longest = max(float(each.parameters[-1]) for each in resolved)
    return ResolvedMotion(tuple(resolved), method, CURVE_LENGTH_MARGIN * max(longest, arm.length))


def _resolved(arm: Arm, target: Target, fixed: bool) -> Resolved:
    curve, q = cast(Curve, target.curve), cast(Array, target.q)
    return Resolved(AnchoredCurve(curve, beginning(arm, curve)[0]), target, arm.positions(q), fixed)


def _target(arm: Arm, keyframe: Keyframe, method: str, near: Target | None = None) -> Target:
    """Resolve the target of the whole arm, near another one or near the joints of the keyframe, if any."""
    options: dict[str, Any] = {
        "placement": keyframe.placement or "align",
        "roll": keyframe.roll,
        "method": method,
    }
    if near is not None or keyframe.joints is None:
        return resolve_targets(arm, keyframe.curve, SEQUENTIAL_SAMPLES, near=near, **options)
    q = arm.configuration(np.clip(keyframe.joints, arm.limits.lower, arm.limits.upper))
    hint = Target(arm.at(q).compiled.points, np.ones(arm.n_modules), q=q)
    try:
        return resolve_targets(arm, keyframe.curve, SEQUENTIAL_SAMPLES, near=hint, **options)
    except TargetError:
        target = resolve_targets(arm, keyframe.curve, SEQUENTIAL_SAMPLES, **options)
    where = f"keyframe {keyframe.name!r}" if keyframe.name else "a keyframe"
    text = "joints: its curve has no posture near them; they are ignored"
    warnings.warn(f"{where}: {text}", PostureWarning, stacklevel=3)
    return target


def _check_covered(arm: Arm, keyframes: tuple[Keyframe, ...], index: int, resolved: Resolved) -> None:
    """Refuse a curve that is longer than the arm covers, unless the keyframe says that it is trimmed."""
    anchored, covered = resolved.anchored, float(resolved.parameters[-1])
    length = anchored.curve.length - anchored.parameter
    if keyframes[index].trim or length - covered <= float(arm.chain.module_lengths.max()):
        return
    advice = "shorten it, use a longer arm, or set trim to take its first part"
    reason = f"the curve is {length:.4g} m long, and the arm covers {covered:.4g} m of it; {advice}"
    raise TaskError(title(keyframes, index), reason)


def tip_shift(arm: Arm, keyframe: Keyframe, target: Target, q: Array, where: str) -> Array:
    """Find the joint displacement (nv,) [rad or m] from a configuration to one that also serves the tip.

    Args:
        arm: the arm.
        keyframe: the keyframe.
        target: its target, of the whole arm.
        q: the configuration that takes it, (nq,).
        where: what to call the keyframe.

    Raises:
        TaskError: a strict task that is out of reach.
    """
    if keyframe.tip is None:
        return np.zeros(arm.nv)
    objective = Objective(arm, target_at(arm, keyframe, target, q), (keyframe.tip,))
    edges = np.array([arm.limits.lower, arm.limits.upper])
    state = find_goal(objective, arm.at(q).compiled, edges, None, POSTURE_TOLERANCE * arm.length).state
    strict = objective.task_rows(state, priority=True)
    missed = 0.0 if strict is None else float(np.linalg.norm(strict.errors))
    if missed > STRICT_TIP_TOLERANCE * arm.length:
        advice = (
            "move it nearer, let the posture count for a region only, or give a weight in place of strict"
        )
        raise TaskError(where, f"its strict tip task is missed by {missed:.4g} m at least; {advice}")
    return np.asarray(arm.difference(q, state.q))


def target_at(arm: Arm, keyframe: Keyframe, target: Target, q: Array) -> Target:
    """Return the target of a keyframe with the control points of a configuration (nq,)."""
    curve, points = cast(Curve, target.curve), arm.at(q).compiled.points
    parameters, distances = map(np.asarray, curve.nearest(arm.chain.flattened(points)))
    weights, moved = np.ones(arm.n_modules), target.moved
    result = Target(points, weights, q, curve, parameters, distances, target.method, moved=moved)
    return result if keyframe.region is None else result.region(*keyframe.region)


def with_fitting_joints(arm: Arm, keyframes: tuple[Keyframe, ...]) -> tuple[Keyframe, ...]:
    """Return the keyframes without `joints` that do not fit the arm; a `PostureWarning` names them."""
    fitting = []
    for index, keyframe in enumerate(keyframes):
        misfit = _misfit(arm, keyframe)
        if misfit:
            text = f"{title(keyframes, index)}: joints {misfit}; they are ignored"
            warnings.warn(text, PostureWarning, stacklevel=3)
        fitting.append(replace(keyframe, joints=None) if misfit else keyframe)
    return tuple(fitting)


def _misfit(arm: Arm, keyframe: Keyframe) -> str:
    """Say why the joints of a keyframe do not fit the arm; empty if they do, or there are none."""
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


# Joint positions for curves that change a little from one row to the next.

VISCOSITY = 3e-3
"""Cost of motion from one keyframe to the next, relative to that of distances: root of their ratio, for
`TYPICAL_ROWS` rows. It slows down joints that turn far for next to nothing, as those do that roll a nearly
straight arm; others lag behind by next to nothing."""

TYPICAL_ROWS = 400
"""Rows from one keyframe to the next for which `VISCOSITY` is given."""


class SequentialFollower:
    """Sequential placement on curves that begin at the base of the arm, or beside it."""

    def __init__(self, arm: Arm) -> None:
        self._arm, (self._units, self._shapes) = arm, unit_arrays(arm)
        self._limits = arm.limits.lower[arm.columns], arm.limits.upper[arm.columns]
        self._base = np.array(arm.chain.base)

    def positions(self, curve: BentCurve) -> Array | None:
        """Return joint positions (nv,) that put the control points on a curve, None if there are none."""
        coefficients, end = curve.spline, curve.length
        knots = np.concatenate([[0.0, 0.0], np.repeat(curve.s, 2), [end, end]])
        ends = np.array([0.0, end])
        series = np.full((1, 2), 0.5 * end)  # the parameter is the arc length
        state = np.empty(9)
        state[0], state[1:4], state[4:7] = 0.0, self._base, curve.points[0]
        found, parameters = np.zeros(len(self._arm.columns)), np.empty(self._arm.n_modules)
        measured = knots, coefficients[None], 3, ends, ends, series
        options = SEQUENTIAL_SAMPLES, self._units, self._shapes, *self._limits
        if kernels.place_modules(*measured, *options, state, found, parameters) >= 0:
            return None
        positions = np.zeros(self._arm.nv)
        positions[self._arm.columns] = found
        return positions


class LeastSquaresFollower:
    """Least squares of the whole arm, from a guess that is near.

    It solves the problem of `least_squares` with its unknowns: joint positions, and arc lengths between
    control points, in units of the problem.
    """

    def __init__(self, arm: Arm, method: str) -> None:
        lengths = np.maximum(arm.chain.module_lengths, arm.chain.module_lengths.mean())
        self.problem = FitProblem(arm, 0.0, STIFFNESS[method] * float(np.median(lengths)))

    def error(self, curve: BentCurve, unknowns: Array) -> float:
        """Return the root mean square distance from the curve, including bending, in arm lengths."""
        residual, _ = self.problem.evaluate(curve, unknowns)
        return float(np.sqrt(residual @ residual / self.problem.points))

    def follow(self, curve_at: Callable[[int], BentCurve], rows: range, first: Array, travel: float) -> Array:
        """Follow the curves of rows from unknowns that fit the first; returns unknowns (r, n + m).

        Args:
            curve_at: the curve of a row.
            rows: the rows.
            first: unknowns of the first row, (n + m,).
            travel: largest motion of the joints over all rows [rad, or arm lengths].
        """
        found = np.empty((len(rows), len(first)))
        found[0] = first
        _, jacobian = self.problem.evaluate(curve_at(rows[0]), first)
        weight = VISCOSITY**2 * len(rows) / TYPICAL_ROWS * stiffness(self.problem, jacobian.T @ jacobian)
        for i in range(1, len(rows)):
            guess = found[i - 1] + (found[i - 1] - found[i - 2] if i > 1 else 0.0)
            curve = curve_at(rows[i])
            found[i] = refined(self.problem, curve, guess, found[i - 1], weight, travel / len(rows))
        return found
