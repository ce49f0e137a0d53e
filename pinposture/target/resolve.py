"""Targets of all control points on a curve (Section 4.2)."""

from __future__ import annotations

import math
import warnings
from dataclasses import replace
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from pinposture import kernels
from pinposture.arm import Arm
from pinposture.curve import Curve
from pinposture.errors import (
    CurveBendsTooMuch,
    CurveEndsEarly,
    InvalidValue,
    PostureWarning,
    TargetError,
    UnknownName,
    UnsupportedModule,
)
from pinposture.target.fit import fit_curve
from pinposture.target.placement import ROUNDING, Placement, beginning, laid
from pinposture.target.refine import fit_near
from pinposture.target.target import Moved, Target
from pinposture.target.walk import place_in_turn

Array = NDArray[np.float64]

PLACEMENTS = ("as_is", "translate", "align")
METHODS = ("auto", "sequential", "smooth", "closest")

STIFFNESS = {"smooth": 0.02, "closest": 1e-8}
"""What one radian of bending weighs against distance from the curve, in module lengths [1/rad].

The closest placement has a trace of it: joints that move no control point need to be told something."""

FAR = 0.1
"""How far the start of a curve may be moved without a word, if nobody asked for it, in arm lengths."""

OFF_CURVE = 0.1
"""How far off the curve a control point may be before it counts as having no place, in module lengths."""


def resolve_targets(
    arm: Arm,
    curve: Curve,
    samples: int = 2000,
    placement: Literal["as_is", "translate", "align"] | None = None,
    roll: float = 0.0,
    incomplete: Literal["raise", "partial"] = "raise",
    method: Literal["auto", "sequential", "smooth", "closest"] = "auto",
    near: Target | None = None,
) -> Target:
    """Find where on a curve each control point belongs, and the configuration that puts it there.

    Modules are placed "sequential"ly as in Algorithm 1 (exact, from base to tip, for modules with closed-form
    kinematics), or all at once by least squares within the joint limits, for any arm: "closest" to the
    curve, or "smooth", which gives up a little closeness for less bending. Sequential placement multiplies
    whatever angle a module makes with the curve by -l1 / l2 from module to module, and can zigzag along a
    curve that leaves the base at an angle; smooth placement does not.

    Args:
        arm: the arm.
        curve: the shape to take.
        samples: number of points at equal arc length that stand for the curve in sequential placement.
        placement: "as_is" uses the curve where it is; "translate" moves its start to the base of the
            arm; "align" also turns its first tangent to the arm's axis by the least rotation, and a plane
            curve into the plane of a planar arm. None aligns, and a `PostureWarning` tells if the start was
            moved by more than a tenth of the arm's length; `moved` of the target tells it in any case.
        roll: further turn of an aligned curve about the arm's axis [rad].
        incomplete: what to do when some module has no place: "raise" an error, or return a "partial"
            target that says why in `incomplete` and gives weight 0 to the points from there on.
        method: as above; "auto" is sequential where that works and does not zigzag, else smooth, or
            closest where a module has no closed-form kinematics.
        near: the target on a curve that differs a little, as while one is dragged. Least squares then begin
            there and look no farther, which is quick; None: they begin with the straight arm, and take tenths
            of a second for 20 modules and seconds for 100.

    Returns:
        The target, with `q`, `parameters`, `residual`, `method` and `moved` filled in.

    Raises:
        CurveEndsEarly: the curve is over before the last module is placed.
        CurveLeavesTooSharply: the first module cannot turn to where the curve goes.
        CurveBendsTooMuch: a later module cannot, or the curve leaves the plane of a planar module, or a
            control point stays farther off the curve than a tenth of its module's length.
        UnsupportedModule: sequential placement of a module for which no solver exists.
        InvalidValue: no arm or no curve, fewer than 2 samples, a roll that is not finite, a target of another
            arm or of no curve to be near to.
        UnknownName: a `placement`, `incomplete` or `method` that does not exist.
    """
    if not isinstance(arm, Arm):
        raise InvalidValue("arm", arm, "an Arm")
    if not isinstance(curve, Curve):
        raise InvalidValue("curve", curve, "a Curve")
    if placement is not None:
        _require("placement", placement, PLACEMENTS)
    _require("way to treat an incomplete target", incomplete, ("raise", "partial"))
    _require("method", method, METHODS)
    if isinstance(samples, bool) or not isinstance(samples, int) or samples < 2:
        raise InvalidValue("samples", samples, "a whole number of at least 2")
    if not math.isfinite(roll):
        raise InvalidValue("roll", roll, "a finite angle [rad]")
    if near is not None:
        near.check(arm)
        if near.q is None or near.parameters is None:
            raise InvalidValue("near", near, "a target with q and parameters, as from `resolve_targets`")
    placed, moved = laid(arm, curve, placement, roll)
    if placement is None and moved.distance > FAR * arm.length:
        warnings.warn(far_moved(arm, "the curve", moved), PostureWarning, stacklevel=2)
    if method == "sequential":
        result = place_in_turn(arm, placed, samples)
    elif method == "auto":
        result, method = _choose(arm, placed, samples, near)
    else:
        result = _place_together(arm, placed, method, near)
    if result.failure is not None and incomplete == "raise":
        raise result.failure
    return replace(_target(arm, placed, result, method), moved=moved)


def far_moved(arm: Arm, what: str, moved: Moved) -> str:
    """What to say of a curve that was moved far without having been asked for."""
    share = f"{moved.distance / arm.length:.2g} of the arm length"
    advice = 'placement="as_is" leaves it where it is, "align" says that it may be moved'
    return f"{what} was {moved} to the base of the arm, {share}; {advice}"


def _require(kind: str, name: str, allowed: tuple[str, ...]) -> None:
    if name not in allowed:
        raise UnknownName(kind, name, allowed)


def _choose(
    arm: Arm, curve: Curve, samples: int, near: Target | None
) -> tuple[Placement, Literal["sequential", "smooth", "closest"]]:
    try:
        in_turn = place_in_turn(arm, curve, samples)
    except UnsupportedModule:
        return _place_together(arm, curve, "closest", near), "closest"
    if isinstance(in_turn.failure, CurveEndsEarly):
        return in_turn, "sequential"
    if in_turn.failure is None and not _zigzags(arm, in_turn.positions):
        return in_turn, "sequential"
    together = _place_together(arm, curve, "smooth", near)
    if together.failure is None:
        return together, "smooth"
    return in_turn, "sequential"


def _zigzags(arm: Arm, positions: Array) -> bool:
    """True if most modules bend the other way than the one before."""
    starts = np.append(arm.module_starts, len(arm.columns))
    products, norms = kernels.neighbours(positions[arm.columns], starts)
    return norms > 1e-6 * arm.n_modules and products < -0.5 * norms


def _place_together(arm: Arm, curve: Curve, method: str, near: Target | None) -> Placement:
    """Least squares over the whole arm; a failure where a control point ends up too far off the curve."""
    start, _ = beginning(arm, curve)
    lengths = np.maximum(arm.chain.module_lengths, arm.chain.module_lengths.mean())
    bending = STIFFNESS[method] * float(np.median(lengths))
    given = arm, curve, start, bending
    fit = fit_curve(*given) if near is None else fit_near(*given, near)
    ends = np.minimum(fit.parameters, curve.length)
    residual = np.linalg.norm(arm.at(arm.configuration(fit.positions)).points - curve.at(ends), axis=1)
    failure: TargetError | None = None
    over = np.flatnonzero(fit.parameters > curve.length + ROUNDING * arm.length)
    off = np.flatnonzero(residual > OFF_CURVE * lengths)
    bases = np.concatenate([[start], ends[:-1]])
    if len(over) and (not len(off) or over[0] <= off[0]):
        k = int(over[0])
        advice = "lengthen the curve or use fewer modules"
        failure = CurveEndsEarly(k + 1, float(bases[k]), f"the curve ends before the module does; {advice}")
    elif len(off):
        k = int(off[0])
        text = f"the closest that its end can come to the curve is {residual[k]:.4g} m"
        advice = "use a gentler curve, wider joint limits or shorter modules"
        failure = CurveBendsTooMuch(k + 1, float(bases[k]), f"{text}; {advice}")
    return Placement(fit.positions, ends, failure)


def _target(arm: Arm, curve: Curve, result: Placement, method: str) -> Target:
    weights = np.ones(arm.n_modules)
    reason = ""
    if result.failure is not None:
        weights[result.failure.module - 1 :] = 0.0
        reason = str(result.failure)
    q = arm.configuration(result.positions)
    points = arm.at(q).points
    gaps = points - curve.at(result.parameters)
    residual = np.sqrt(np.einsum("ij,ij->i", gaps, gaps))
    return Target(points, weights, q, curve, result.parameters, residual, method, reason)
