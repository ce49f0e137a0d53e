"""Algorithm 1: place the modules on the curve one after the other, from base to tip."""

from __future__ import annotations

from typing import Literal, NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from pinposture.arm import Arm
from pinposture.curve import Curve
from pinposture.errors import (
    CurveBendsTooMuch,
    CurveEndsEarly,
    CurveLeavesTooSharply,
    InvalidValue,
    TargetError,
    UnknownName,
)
from pinposture.target.modules import ModuleKinematics, Unit, arm_units
from pinposture.target.target import Target

Array = NDArray[np.float64]

PLACEMENTS = ("as_is", "translate", "align")
ROUNDING = 1e-9
"""Slack for positions, relative to the arm length, and for joint limits [rad]."""


def resolve_targets(
    arm: Arm,
    curve: Curve,
    samples: int = 2000,
    placement: Literal["as_is", "translate", "align"] = "align",
    roll: float = 0.0,
    incomplete: Literal["raise", "partial"] = "raise",
) -> Target:
    """Find where on a curve each control point belongs, and the configuration that puts it there.

    The curve is sampled, and each module is placed where its reachable set first crosses the samples
    ahead of its base: on the outer part of that set if the curve crosses it there before it leaves the
    module's reach, otherwise on the inner part (Algorithm 1; the thesis
    asks for a segment with a single positive root, which is too strong).

    Args:
        arm: the arm.
        curve: the shape to take.
        samples: number of points at equal arc length that stand for the curve.
        placement: "as_is" uses the curve where it is; "translate" moves its start to the base of the
            arm; "align" also turns its first tangent to the arm's axis, by the least rotation.
        roll: further turn of an aligned curve about the arm's axis [rad].
        incomplete: what to do when some module has no place: "raise" an error, or return a "partial"
            target that says why in `incomplete` and gives weight 0 to the points from there on.

    Returns:
        The target, with `q`, `parameters` and `residual` filled in.

    Raises:
        CurveEndsEarly: the curve is over before the last module is placed.
        CurveLeavesTooSharply: the first module cannot turn to where the curve goes.
        CurveBendsTooMuch: a later module cannot, or the curve leaves the plane of a planar module.
        UnsupportedModule: a module for which no solver exists.
        InvalidValue: fewer than 2 samples, a roll that is not finite.
        UnknownName: a `placement` or `incomplete` that does not exist.
    """
    if placement not in PLACEMENTS:
        raise UnknownName("placement", placement, PLACEMENTS)
    if incomplete not in ("raise", "partial"):
        raise UnknownName("way to treat an incomplete target", incomplete, ("raise", "partial"))
    if isinstance(samples, bool) or not isinstance(samples, int) or samples < 2:
        raise InvalidValue("samples", samples, "a whole number of at least 2")
    if not np.isfinite(roll):
        raise InvalidValue("roll", roll, "a finite angle [rad]")
    units = arm_units(arm.chain)
    placed = _place(arm, units[0], curve, placement, roll)
    walk = _Walk(arm, placed, samples)
    failure: TargetError | None = None
    positions = np.zeros(arm.nv)
    points, parameters = arm.chain.points.copy(), np.full(arm.n_modules, placed.length)
    weights = np.zeros(arm.n_modules)
    for unit in units:
        try:
            positions[arm.columns[unit.joints]] = walk.step(unit)
        except TargetError as error:
            if incomplete == "raise":
                raise
            failure = error
            break
        points[unit.module], parameters[unit.module] = walk.point, walk.parameter
        weights[unit.module] = 1.0
    if failure is not None:
        weights[failure.module - 1 :] = 0.0
        parameters[failure.module - 1 :] = placed.length
    q = arm.configuration(positions)
    free = weights == 0.0
    points[free] = arm.at(q).points[free]
    residual = np.linalg.norm(points - placed.at(parameters), axis=1)
    reason = "" if failure is None else str(failure)
    return Target(points, weights, q, placed, parameters, residual, reason)


def _place(arm: Arm, first: Unit, curve: Curve, placement: str, roll: float) -> Curve:
    if placement == "as_is":
        return curve
    turn = np.eye(3)
    if placement == "align":
        axis = first.frame[:, 0]
        tangent = np.asarray(curve.tangent(0.0))
        across = np.cross(tangent, axis)
        sine, cosine = float(np.linalg.norm(across)), float(tangent @ axis)
        if sine < 1e-12:  # parallel: nothing to do, or half a turn about any axis across
            about, angle = first.frame[:, 1], 0.0 if cosine > 0 else np.pi
        else:
            about, angle = across / sine, np.arctan2(sine, cosine)
        turn = (Rotation.from_rotvec(roll * axis) * Rotation.from_rotvec(angle * about)).as_matrix()
    return curve.moved(turn, arm.chain.base - turn @ curve.start)


class _Crossing(NamedTuple):
    """A place for the end of a module: segment, t on it, position in the base frame, joint positions."""

    segment: int
    t: float
    position: Array
    q: Array


class _Walk:
    """The state of Algorithm 1: where on the curve, and how turned, the next module begins."""

    def __init__(self, arm: Arm, curve: Curve, samples: int) -> None:
        self._lower, self._upper = arm.limits.lower[arm.columns], arm.limits.upper[arm.columns]
        self._slack = ROUNDING * arm.length
        self._curve = curve
        self._s = np.linspace(0.0, curve.length, samples)
        self._samples = np.asarray(curve.at(self._s))
        self._turn = np.eye(3)
        self.point = arm.chain.base
        nearest, distance = (float(x) for x in curve.nearest(self.point))
        on_curve = distance <= self._slack
        if on_curve and np.linalg.norm(self._samples[0] - self.point) <= self._slack:
            nearest = 0.0
        self.parameter = nearest
        self._start = self.point if on_curve else np.asarray(curve.at(nearest))

    def step(self, unit: Unit) -> Array:
        """Place one unit: lines 4 to 18 of the algorithm. Returns its joint positions."""
        frame = self._turn @ unit.frame
        ahead, arcs, beyond = self._ahead(unit)
        local = (ahead - self.point) @ frame
        crossing, found = self._first_crossing(unit, local)
        if crossing is None:
            raise self._failure(unit, local, found, beyond)
        _, end_turn = unit.kinematics.forward(crossing.q)
        self._turn = frame @ end_turn @ unit.frame.T
        self.point = self.point + frame @ crossing.position
        before, after = arcs[crossing.segment], arcs[crossing.segment + 1]
        self.parameter = float(before + (after - before) * crossing.t)
        self._start = self.point
        return crossing.q

    def _ahead(self, unit: Unit) -> tuple[Array, Array, bool]:
        """The samples ahead, up to the first one that is out of reach for good."""
        first = int(np.searchsorted(self._s, self.parameter, side="right"))
        ahead = np.vstack([self._start, self._samples[first:]])
        arcs = np.concatenate([[self.parameter], self._s[first:]])
        distance = np.linalg.norm(ahead - self.point, axis=1)
        out = np.flatnonzero(distance[1:] > unit.kinematics.reach * (1.0 + ROUNDING))
        end = int(out[0]) + 2 if len(out) else len(ahead)
        return ahead[:end], arcs[:end], len(out) > 0

    def _first_crossing(self, unit: Unit, local: Array) -> tuple[_Crossing | None, int]:
        """The crossing to use, and how many there were regardless of joint limits."""
        kinematics: ModuleKinematics = unit.kinematics
        inner: _Crossing | None = None
        found = 0
        for segment, t in kinematics.crossings(local):
            position = local[segment] + t * (local[segment + 1] - local[segment])
            solutions = kinematics.inverse(position)
            found += bool(solutions)
            for solution in solutions:
                low, high = self._lower[unit.joints] - ROUNDING, self._upper[unit.joints] + ROUNDING
                if np.all((solution >= low) & (solution <= high)):
                    q = np.clip(solution, self._lower[unit.joints], self._upper[unit.joints])
                    if kinematics.faces(position):
                        return _Crossing(segment, t, position, q), found
                    inner = inner or _Crossing(segment, t, position, q)
        return inner, found

    def _failure(self, unit: Unit, local: Array, found: int, beyond: bool) -> TargetError:
        module, at = unit.module + 1, self.parameter
        reach = unit.kinematics.reach
        if found:
            advice = "use a gentler curve, wider joint limits or shorter modules"
            kind = CurveLeavesTooSharply if self._leaves_off_axis(unit) else CurveBendsTooMuch
            return kind(module, at, f"its joint limits do not let it turn to where the curve goes; {advice}")
        if not beyond:
            left, distance = self._curve.length - at, float(np.linalg.norm(local[-1]))
            advice = f"the module is {reach:.4g} m long; lengthen the curve or use fewer modules"
            text = f"the curve ends {left:.4g} m farther on, {distance:.4g} m from its base; {advice}"
            if left <= self._slack:
                text = f"the curve ends there; {advice}"
            return CurveEndsEarly(module, at, text)
        gap = float(np.linalg.norm(local[0]))
        if gap > reach:
            advice = 'use placement="translate" or "align"'
            return CurveLeavesTooSharply(module, at, f"the curve passes {gap:.4g} m from the base; {advice}")
        if unit.kinematics.dof == 1 and abs(local[-1, 1]) > self._slack:
            text = f"the curve leaves the plane in which the module moves by {abs(local[-1, 1]):.4g} m"
            return CurveBendsTooMuch(module, at, f"{text}; use a planar curve in that plane, or two hinges")
        exit_at = local[-1] / np.linalg.norm(local[-1])
        angle = float(np.degrees(np.arccos(np.clip(exit_at[0], -1.0, 1.0))))
        text = f"the curve leaves its reach {angle:.3g} degrees off its axis, where it cannot turn"
        if self._leaves_off_axis(unit):
            advice = 'placement="align" turns the curve to the arm'
            return CurveLeavesTooSharply(module, at, f"{text}; {advice}")
        return CurveBendsTooMuch(module, at, f"{text}; use a gentler curve or shorter modules")

    def _leaves_off_axis(self, unit: Unit) -> bool:
        """True if this is the first module and the curve does not set out along it."""
        tangent = np.asarray(self._curve.tangent(self.parameter))
        return unit.module == 0 and float(np.linalg.norm(np.cross(tangent, unit.frame[:, 0]))) > 1e-6
