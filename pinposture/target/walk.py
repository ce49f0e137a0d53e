"""Algorithm 1: modules placed on a curve one after the other, each where it first crosses the curve ahead."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from pinposture.arm import Arm
from pinposture.curve import Curve
from pinposture.errors import CurveBendsTooMuch, CurveEndsEarly, CurveLeavesTooSharply, TargetError
from pinposture.target.modules import ModuleKinematics, Unit, arm_units
from pinposture.target.placement import ROUNDING, Placement, beginning

Array = NDArray[np.float64]


class _Crossing(NamedTuple):
    """A place for the end of a module: segment, t on it, position in the base frame, joint positions."""

    segment: int
    t: float
    position: Array
    q: Array


def place_in_turn(arm: Arm, curve: Curve, samples: int) -> Placement:
    """Algorithm 1.

    Args:
        arm: the arm; each of its modules has a closed-form solver.
        curve: the curve, placed in the world.
        samples: number of points at equal arc length that stand for the curve.

    Returns:
        Where the modules belong; with a failure if one of them has no place.

    Raises:
        UnsupportedModule: a module without a solver.
    """
    units = arm_units(arm.chain)
    walk = _Walk(arm, curve, samples)
    positions, parameters = np.zeros(arm.nv), np.full(arm.n_modules, curve.length)
    try:
        for unit in units:
            positions[arm.columns[unit.joints]] = walk.step(unit)
            parameters[unit.module] = walk.parameter
    except TargetError as failure:
        parameters[failure.module - 1 :] = curve.length
        return Placement(positions, parameters, failure)
    return Placement(positions, parameters, None)


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
        self.parameter, on_curve = beginning(arm, curve)
        self._start = self.point if on_curve else np.asarray(curve.at(self.parameter))

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
