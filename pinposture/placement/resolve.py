"""Targets of all control points on a curve: Algorithm 1, or a least-squares fit (Section 4.2)."""

from __future__ import annotations

import logging
from dataclasses import replace
from typing import Literal, NamedTuple

import numpy as np
import pinocchio as pin
from numpy.typing import NDArray

from pinposture import kernels
from pinposture._validation import as_number, require_instance, require_known, require_whole
from pinposture.arm import Arm
from pinposture.arm.module_kinematics import ModuleKinematics, end_of, point_after, positions_for
from pinposture.curve import Curve
from pinposture.errors import (
    CurveBendsTooMuch,
    CurveEndsEarly,
    CurveError,
    CurveLeavesTooSharply,
    CurveOutOfReach,
    InvalidValue,
    TargetError,
    UnsupportedModule,
    warn_caller,
)
from pinposture.placement.least_squares import (
    base_positions,
    fit_curve,
    fit_near,
    slid_positions,
)
from pinposture.placement.module_kinematics import (
    Circle,
    GroupRun,
    JointGroup,
    NumericModule,
    Torus,
    group_runs,
    has_custom_kinematics,
    is_compiled,
    kinematics_names,
)
from pinposture.placement.target import (
    ADVISE,
    Moved,
    PlacedModules,
    Target,
    beginning,
    distance_from_curve,
    fitting_slides,
    length_misfit,
    place_curve,
)
from pinposture.units import CONVERGED, ROUNDING, length_text

Array = NDArray[np.float64]

logger = logging.getLogger(__name__)

PLACEMENTS = ("as_is", "translate", "align")
METHODS = ("auto", "sequential", "smooth", "closest")

STIFFNESS = {"smooth": 0.02, "closest": 1e-8}
"""Weight of one radian of bending against distance from the curve, in module lengths [1/rad].

It is not zero for "closest" because some joints move no control point.
"""


class TargetTolerances(NamedTuple):
    """How far points may be from where they should."""

    far: float = 0.1
    """Largest shift of a curve's start and link distance from the curve without a warning, in arm lengths."""

    off_curve: float = 0.1
    """Distance from the curve at which a control point counts as not placed, in lengths of its module, or of
    the neighbouring modules bound to one plane (`Chain.spans`)."""

    custom: float = 1e-7
    """Tolerance of custom kinematics, in reaches of the module or radians."""


PLACING = TargetTolerances()


def place_in_turn(arm: Arm, curve: Curve, samples: int, near: Target | None = None) -> PlacedModules:
    """Place modules from base to tip, each on the next point of the curve that it can reach (Algorithm 1).

    Args:
        arm: the arm.
        curve: the curve, placed in the world.
        samples: number of points at equal arc length by which closed forms approximate the curve.
        near: target with a configuration that redundant modules stay near; the straight arm if None.

    Returns:
        The placement, with a failure if a module could not be placed.

    Raises:
        UnsupportedModule: no joint of a module moves its end.
        InvalidValue: custom kinematics are inconsistent.
    """
    placed = _place_modules(arm, curve, samples, near)
    if isinstance(placed.failure, CurveEndsEarly) and placed.failure.module == arm.n_modules:
        # The curve may be as long as the arm, up to rounding: enlarge it about the base.
        enlarged = curve.moved((1.0 + ROUNDING) * np.eye(3), -ROUNDING * arm.chain.base)
        again = _place_modules(arm, enlarged, samples, near)
        placed = placed if again.failure is not None else again
    return placed._replace(parameters=np.minimum(placed.parameters, curve.length))


def _place_modules(arm: Arm, curve: Curve, samples: int, near: Target | None) -> PlacedModules:
    runs = group_runs(arm)
    walk = Walk(arm, curve, samples, near)
    failure = None
    for run in runs:
        failure = walk.place(run)
        if failure is not None:
            break
    return PlacedModules(walk.positions, walk.parameters, failure, kinematics_names(arm))


class Walk:
    """Algorithm 1: modules are placed from base to tip, run by run.

    Attributes:
        parameters: arc length of the end of each module, (m,) [m]; the length of the curve for modules not
            placed.
        positions: joint positions (nv,) [rad or m]; the preferred ones for modules not placed yet.
    """

    def __init__(self, arm: Arm, curve: Curve, samples: int, near: Target | None) -> None:
        self._arm = arm
        self._curve = curve
        self._samples = samples
        self._straight = arm.positions(arm.straight())
        preferred = self._straight if near is None or near.q is None else arm.positions(near.q)
        self._parameter, on_curve = beginning(arm, curve)
        self.parameters = np.full(arm.n_modules, curve.length)
        self.positions = np.array(preferred)
        self._from_base = on_curve
        if np.any(arm.base_slides):
            moved = base_positions(arm, curve, self._parameter)
            self.positions = np.where(arm.base_slides, moved, self.positions)
            self._from_base = True
        self._turn = np.eye(3)
        self._place = np.zeros(3)
        self._carried = 0

    def place(self, run: GroupRun) -> TargetError | None:
        """Place the next groups; return the error if that fails."""
        first = run.groups[0]
        self._carry(first.joints.start)
        base = first.base
        if self._carried:
            base = self._turn @ (base - self._arm.chain.origins[self._carried - 1]) + self._place
        failed: tuple[JointGroup, TargetError] | None
        if run.in_closed_form:
            failed = self._place_closed_forms(run, base)
        else:
            failed = self._place_one(first, pin.SE3(self._turn @ first.frame, base))
        if failed is None:
            self._from_base = True
            return None
        group, error = failed
        self.parameters[group.module :] = self._curve.length
        ahead = self._arm.columns[group.first :]
        self.positions[ahead] = self._straight[ahead]
        return error

    def _carry(self, stop: int) -> None:
        """Advance the frame along the joints before an index."""
        if stop > self._carried:
            joints = self._arm.kinematics.constants.joints
            kernels.move_frame(joints, self._carried, stop, self.positions, self._turn, self._place)
            self._carried = stop

    def _place_closed_forms(self, run: GroupRun, base: Array) -> tuple[JointGroup, TargetError] | None:
        """Place groups with closed forms, the first of which has its base at a point, (3,) [m]."""
        arm = self._arm
        columns = arm.columns
        lower = arm.limits.lower[columns]
        upper = arm.limits.upper[columns]
        placed = self.positions[columns]
        placed[run.inputs] = 0.0  # as closed forms take joints between them that do not move an end
        stopped, state = self._call_kernel(run, base, lower, upper, placed, self.parameters)
        self.positions[columns] = placed
        if stopped < 0:
            self._parameter = float(self.parameters[run.groups[-1].module])
            return None
        group = run.groups[stopped]
        exceeded = ""
        if state[8]:  # on the curve, but not within its joint limits: by how much are they exceeded?
            inputs = group.inputs
            wide_lower = lower.copy()
            wide_upper = upper.copy()
            wide_lower[inputs] = -np.inf
            wide_upper[inputs] = np.inf
            self._call_kernel(run, base, wide_lower, wide_upper, placed, np.empty(arm.n_modules))
            excess = np.maximum(lower - placed, placed - upper)[inputs]
            worst = group.first + int(np.argmax(excess))
            allowed = f"{lower[worst]:.4g} to {upper[worst]:.4g} rad"
            name = arm.chain.input_names[worst]
            exceeded = f": joint {name!r} would be at {placed[worst]:.4g} rad, allowed: {allowed}"
        return group, _failure(arm, self._curve, group, state, exceeded)

    def _call_kernel(
        self, run: GroupRun, base: Array, lower: Array, upper: Array, placed: Array, parameters: Array
    ) -> tuple[int, Array]:
        """Call `kernels.place_modules`; return its result and the final state, (9,)."""
        state = np.empty(9)
        state[0] = self._parameter
        state[1:4] = base
        state[4:7] = base if self._from_base else self._curve.at(self._parameter)
        spline, length = self._curve.measured
        stopped = kernels.place_modules(
            spline,
            length,
            self._samples,
            run.numbers,
            run.shapes_in(self._turn) if self._carried else run.shapes,
            lower,
            upper,
            state,
            placed,
            parameters,
        )
        return stopped, state

    def _place_one(self, group: JointGroup, base: pin.SE3) -> tuple[JointGroup, TargetError] | None:
        """Place a group without a closed form in the library."""
        kinematics = group.kinematics
        columns = self._arm.columns[group.inputs]
        placed: tuple[float, Array] | TargetError
        if isinstance(kinematics, NumericModule):
            placed = kinematics.place(base, self._curve, self._parameter, self.positions[columns])
            if not placed[0] >= 0.0:
                placed = self._no_place(group, base, placed[0] == -1.0)
        else:
            placed = self._by_your_own(group, kinematics, base)
        if isinstance(placed, TargetError):
            return group, placed
        self._parameter, self.positions[columns] = placed
        self.parameters[group.module] = self._parameter
        return None

    def _by_your_own(
        self, group: JointGroup, kinematics: ModuleKinematics, base: pin.SE3
    ) -> tuple[float, Array] | TargetError:
        arm = self._arm
        s = self._parameter
        name = type(kinematics).__name__
        columns = arm.columns[group.inputs]
        lower = arm.limits.lower[columns]
        upper = arm.limits.upper[columns]
        for _ in range(1000):  # more, and the next point of a module may never come
            following = point_after(kinematics, base, self._curve, s)
            if following is None:
                break
            s = following
            p = base.rotation.T @ (np.asarray(self._curve.at(s)) - base.translation)
            for q in positions_for(kinematics, p):
                away = float(np.linalg.norm(end_of(kinematics, q)[0] - p))
                if away > PLACING.custom * kinematics.reach:
                    allowed = f"positions whose forward is the point; it is {length_text(away)} off"
                    raise InvalidValue(f"{name}.inverse(p)", q.tolist(), allowed)
                if np.all((q >= lower - PLACING.custom) & (q <= upper + PLACING.custom)):
                    return s, np.clip(q, lower, upper)
        return self._no_place(group, base, False)

    def _no_place(self, group: JointGroup, base: pin.SE3, in_reach: bool) -> TargetError:
        """Explain why there is no point for a module; `in_reach` if the curve ends within its reach."""
        curve = self._curve
        at = self._parameter
        module = group.module + 1
        left = curve.length - at
        reach = group.kinematics.reach
        gap = float(np.linalg.norm(curve.at(at) - base.translation))
        to_end = float(np.linalg.norm(curve.at(curve.length) - base.translation))
        if in_reach or (left < reach and to_end < reach):
            advice = f"the module reaches {length_text(reach)}; lengthen the curve or use fewer modules"
            return CurveEndsEarly(module, at, f"the curve ends {length_text(left)} beyond its base; {advice}")
        if gap > reach:
            text = f"the curve passes {length_text(gap)} from the base; {ADVISE.at_the_base}"
            return CurveLeavesTooSharply(module, at, text)
        text = "no posture within its joint limits puts its end on the curve"
        kind = CurveLeavesTooSharply if group.module == 0 else CurveBendsTooMuch
        return kind(module, at, f"{text}; {ADVISE.gentler}")


def _failure(arm: Arm, curve: Curve, group: JointGroup, state: Array, exceeded: str) -> TargetError:
    """Explain why a group could not be placed, from the state after `kernels.place_modules`."""
    first = state[1:4]
    last = state[4:7]
    beyond = bool(state[7])
    crossings = int(state[8])
    module = group.module + 1
    at = float(state[0])
    slack = ROUNDING * arm.length
    reach = group.kinematics.reach
    off_axis = group.module == 0 and np.linalg.norm(np.cross(curve.tangent(at), group.frame[:, 0])) > 1e-6
    left = curve.length - at
    if (crossings and left < reach - slack) or not (
        crossings or beyond
    ):  # where it could only fold, it also ends
        away = "" if crossings else f", {length_text(float(np.linalg.norm(last)))} away from it"
        text = (
            f"the curve ends {length_text(left)} beyond its base{away}"
            if left > slack
            else "the curve ends there"
        )
        advice = f"the module is {length_text(reach)} long; lengthen the curve or use fewer modules"
        return CurveEndsEarly(module, at, f"{text}; {advice}")
    if crossings:
        kind = CurveLeavesTooSharply if off_axis else CurveBendsTooMuch
        return kind(
            module, at, f"its joint limits do not allow it to follow the curve{exceeded}; {ADVISE.gentler}"
        )
    gap = float(np.linalg.norm(first))
    if gap > reach:
        text = f"the curve passes {length_text(gap)} from the base; {ADVISE.at_the_base}"
        return CurveLeavesTooSharply(module, at, text)
    if group.kinematics.dof == 1 and abs(last[1]) > slack:
        text = f"the curve is {length_text(abs(last[1]))} off the plane in which the module moves"
        return CurveBendsTooMuch(module, at, f"{text}; use a planar curve in that plane, or two hinges")
    direction = last / np.linalg.norm(last)
    angle = float(np.degrees(np.arccos(np.clip(direction[0], -1.0, 1.0))))
    text = f"the curve leaves its reach {angle:.3g} degrees off its axis, beyond its joint limits"
    if off_axis:
        advice = 'placement="align" turns the curve to the arm'
        return CurveLeavesTooSharply(module, at, f"{text}; {advice}")
    return CurveBendsTooMuch(module, at, f"{text}; use a gentler curve or shorter modules")


def resolve_targets(
    arm: Arm,
    curve: Curve,
    samples: int = 2000,
    *,
    placement: Literal["as_is", "translate", "align"] | None = None,
    roll: float = 0.0,
    incomplete: Literal["raise", "partial"] = "raise",
    method: Literal["auto", "sequential", "smooth", "closest"] = "auto",
    near: Target | None = None,
) -> Target:
    """Find the point of a curve for each control point, and the configuration that puts it there.

    The "sequential" method places modules one by one as in Algorithm 1 (exact, from base to tip, each by its
    own kinematics: a closed form, a numeric search, or custom, see `register_module_kinematics`). The other
    methods place all modules at once by least squares within the joint limits: "closest" minimises the
    distance from the curve, "smooth" accepts some distance for less bending. `Target.placed_by` records the
    choice. Sequential placement multiplies the angle between a module and the curve by -l1 / l2 from module
    to module, and can zigzag along a curve that leaves the base at an angle; smooth placement does not.

    Least squares extend slides until the tip is at the end of the curve, or as near to it as the slides or,
    where the curve bends too much, the control points allow. Among such postures they choose one with the
    links near the curve. Sequential placement keeps slides near equal shares of their ranges, with which the
    straight arm is as long as the curve.

    Args:
        arm: the arm.
        curve: the shape to take.
        samples: number of points at equal arc length by which sequential placement approximates the curve.
        placement: "as_is" uses the curve in place; "translate" moves its start to the base of the arm;
            "align" also rotates its first tangent onto the arm's axis by the smallest angle, and a plane
            curve into the plane of a planar arm. None aligns, with a `PostureWarning` if that moves the start
            by more than a tenth of the arm length. A base on `Arm.base_slides` stays in place,
            unless a curve used "as_is" does not pass through it: then the base moves to the curve's start.
        roll: additional rotation of an aligned curve about the arm's axis [rad].
        incomplete: what to do if a module cannot be placed: "raise" an error, or return a "partial" target
            with the reason in `incomplete` and weight 0 for the points from there on.
        method: as above; "auto" is closest for an arm with slides, else sequential if that works and does not
            zigzag, else smooth, or closest if a module has no closed-form kinematics. The reason for least
            squares is then in `Target.fallback` and in the log.
        near: target on a slightly different curve, or of a configuration close to this one
            (`Target.from_configuration`). Least squares then only search near it, which is fast. If None,
            they start from the straight arm and take tenths of a second for 20 modules, seconds for 100.

    Returns:
        The target, with `q`, `parameters`, `residual`, `method` and `moved`. If the links are more than a
        tenth of the arm length from the curve (`Target.distance_from_curve`) and `near` is None, a
        `PostureWarning` gives the reason (`Arm.can_follow`). Joints that can turn without limit are within
        half a turn of `near`, or of the straight arm.

    Raises:
        CurveEndsEarly: the curve ends before the last module does, by more than 1e-9 of its length.
        CurveLeavesTooSharply: the first module cannot bend enough to follow the curve, or the curve passes
            the base at a distance.
        CurveOutOfReach: the curve is beyond the range of the prismatic joints.
        CurveBendsTooMuch: a later module cannot bend enough to follow the curve, the curve leaves the plane
            of a planar module, or a control point is farther from the curve than a tenth of the length of its
            module, or of neighbouring modules bound to one plane.
        CurveError: the curve is longer than 100 arm lengths, as in millimetres.
        UnsupportedModule: sequential placement of a module whose joints do not move its end.
        InvalidValue: not an arm or a curve, fewer than 2 samples, a roll that is not finite, or a `near` for
            another arm or without a configuration.
        UnknownName: no such `placement`, `incomplete` or `method`.
    """
    _check_shape(arm, curve, near)
    if placement is not None:
        require_known("placement", placement, PLACEMENTS)
    require_known("way to treat an incomplete target", incomplete, ("raise", "partial"))
    require_known("method", method, METHODS)
    require_whole("samples", samples, 2)
    as_number("roll", roll, "a finite angle [rad]", lambda x: True)
    placed, moved = place_curve(arm, curve, placement, roll)
    if placement is None and moved.distance > PLACING.far * arm.length:
        warn_caller(far_moved(arm, "the curve", moved))
    result, used, fallback = _place(arm, placed, method, samples, near)
    if result.failure is not None and incomplete == "raise":
        raise result.failure
    if fallback:
        logger.info("least squares place the whole arm on the curve: %s", fallback)
    target = replace(_target(arm, placed, result, used, near), moved=moved, fallback=fallback)
    if near is None and result.failure is None:
        _warn_if_far(arm, target)
    return target


def _check_shape(arm: Arm, curve: Curve, near: Target | None) -> None:
    require_instance("arm", arm, Arm, "an Arm")
    require_instance("curve", curve, Curve, "a Curve")
    if misfit := length_misfit(arm, curve):
        raise CurveError("curve", misfit)
    arm.require_near("coefficients of the curve", curve.coefficients)
    if near is not None:
        require_instance("near", near, Target, "a Target with a configuration q, or None")
        near.check(arm)
        if near.q is None:
            raise InvalidValue("near", near, "a target with a configuration q")


def far_moved(arm: Arm, what: str, moved: Moved) -> str:
    """Return the warning about a curve that was moved far without an explicit `placement`."""
    share = f"{moved.distance / arm.length:.2g} of the arm length"
    advice = 'placement="as_is" keeps it in place, "align" moves it without this warning'
    if moved.distance > 10.0 * arm.length:  # another unit of length
        advice = ADVISE.in_millimetres
    return f"{what} was {moved} to the base of the arm ({share}); {advice}"


def _place(
    arm: Arm, curve: Curve, method: str, samples: int, near: Target | None
) -> tuple[PlacedModules, str, str]:
    """Place the modules; "auto" does so one by one if that works, else all at once.

    Returns:
        The placement, its method, and why "auto" chose least squares; else empty.
    """
    if method != "auto":
        if method == "sequential":
            placed = _place_in_turn(arm, curve, samples, near)
        else:
            placed = _place_together(arm, curve, method, near)
        return placed, method, ""
    fitted: PlacedModules | None = None
    if np.any(fitting_slides(arm)) and not has_custom_kinematics(arm):
        fitted = _place_together(arm, curve, "closest", near)
        if fitted.failure is None:
            return fitted, "closest", "its slides fit its length to the curve"
    try:
        in_turn = _place_in_turn(arm, curve, samples, near)
        compiled = is_compiled(arm)
    except UnsupportedModule as error:
        return fitted or _place_together(arm, curve, "closest", near), "closest", str(error)
    ends_early = compiled and isinstance(in_turn.failure, CurveEndsEarly)
    reason = "" if in_turn.failure is None else str(in_turn.failure)
    if in_turn.failure is None:
        if _zigzags(arm, in_turn.positions):
            reason = "modules placed one by one would zigzag"
        elif not compiled:
            reason = _leaves_curve(arm, curve, in_turn)
    if ends_early or not reason:
        return in_turn, "sequential", ""
    method = "smooth" if compiled else "closest"
    together = fitted or _place_together(arm, curve, method, near)
    if together.failure is None or not compiled:
        return together, method, reason
    return in_turn, "sequential", ""


def _place_in_turn(arm: Arm, curve: Curve, samples: int, near: Target | None) -> PlacedModules:
    """Place the modules one by one; if `near` is None, near the straight arm, whose slides fit the curve."""
    if near is not None or not np.any(fitting_slides(arm)):
        return place_in_turn(arm, curve, samples, near)
    for length in (curve.length - beginning(arm, curve)[0], 0.0):
        slid = Target.from_configuration(arm, arm.configuration(slid_positions(arm, length)))
        placed = place_in_turn(arm, curve, samples, slid)
        if placed.failure is None:
            break
    return placed


def _leaves_curve(arm: Arm, curve: Curve, placed: PlacedModules) -> str:
    """Return a message if links are far from a curve although the control points are on it, else ""."""
    q = arm.configuration(placed.positions)
    if max(_link_lengths(arm, q)) / 2.0 <= PLACING.far * arm.length:
        return ""
    away = distance_from_curve(arm, q, curve)
    return (
        f"placed one by one, links would be {length_text(away)} off it"
        if away > PLACING.far * arm.length
        else ""
    )


def _zigzags(arm: Arm, positions: Array) -> bool:
    """Return whether most modules bend in the opposite direction to the previous one."""
    if {Torus.__name__, Circle.__name__}.issuperset(kinematics_names(arm)):
        starts = np.append(arm.module_starts, len(arm.columns))
        products, norms = kernels.neighbours(positions[arm.columns], starts)
    else:
        before, after = _bends(arm, positions)
        products = float(np.einsum("ij,ij->", after[:-1], before[1:]))
        norms = float(np.linalg.norm(after[:-1], axis=1) @ np.linalg.norm(before[1:], axis=1))
    return norms > 1e-6 * arm.n_modules and products < -0.5 * norms


def _bends(arm: Arm, positions: Array) -> tuple[Array, Array]:
    """Return the bend of each module as vectors in the frames before and after it, (m, 3) each."""
    chain = arm.chain
    before = np.empty((arm.n_modules, 3))
    after = np.empty((arm.n_modules, 3))
    spans = np.diff(np.vstack([chain.base, chain.points]), axis=0)
    axes = spans / np.maximum(np.linalg.norm(spans, axis=1), 1e-300)[:, None]
    for k, joints in enumerate(chain.module_slices):
        turn = np.eye(3)
        constants = arm.kinematics.constants.joints
        kernels.move_frame(constants, joints.start, joints.stop, positions, turn, np.zeros(3))
        before[k] = np.cross(axes[k], turn @ axes[k])
        after[k] = before[k] @ turn
    return before, after


def _place_together(
    arm: Arm, curve: Curve, method: str, near: Target | None, to_end: bool = True
) -> PlacedModules:
    """Fit the whole arm by least squares; fail if a control point ends up too far from the curve.

    Slides extend the arm to the end of the curve, or not that far if control points would leave the curve.
    """
    start, _ = beginning(arm, curve)
    lengths = np.maximum(arm.chain.module_lengths, arm.chain.module_lengths.mean())
    bending = STIFFNESS[method] * float(np.median(lengths))
    if near is None or near.q is None:
        positions, parameters = fit_curve(arm, curve, start, bending, to_end=to_end)
    else:
        positions, parameters = fit_near(arm, curve, start, bending, near.q, near.parameters, to_end)
    ends = np.minimum(parameters, curve.length)
    residual = _distances(arm, positions, curve, ends)
    failure: TargetError | None = None
    over = np.flatnonzero(parameters > curve.length + ROUNDING * arm.length)
    spans = np.maximum(arm.chain.spans, arm.chain.module_lengths.mean())
    off = np.flatnonzero(residual > PLACING.off_curve * spans)
    bases = np.concatenate([[start], ends[:-1]])
    if len(over) and (not len(off) or over[0] <= off[0]):
        k = int(over[0])
        advice = "lengthen the curve or use fewer modules"
        failure = CurveEndsEarly(k + 1, float(bases[k]), f"the curve ends before the module does; {advice}")
    elif len(off):
        k = int(off[0])
        text = f"its end stays at least {length_text(residual[k])} off the curve"
        kind, why = _obstruction(arm, curve, positions, k, start)
        failure = kind(k + 1, float(bases[k]), f"{text}; {why}")
    if failure is not None and to_end and np.any(fitting_slides(arm)):
        retracted = _place_together(arm, curve, method, near, to_end=False)
        if retracted.failure is None or isinstance(retracted.failure, CurveEndsEarly):
            return retracted
    return PlacedModules(positions, ends, failure)


def _target(arm: Arm, curve: Curve, result: PlacedModules, method: str, near: Target | None) -> Target:
    weights = np.ones(arm.n_modules)
    reason = ""
    if result.failure is not None:
        weights[result.failure.module - 1 :] = 0.0
        reason = str(result.failure)
    q = arm.nearest_turns(arm.configuration(result.positions), None if near is None else near.q)
    points = arm.chain_at(q).points
    residual = _distances(arm, result.positions, curve, result.parameters)
    placed_by = result.placed_by or ("least squares",) * arm.n_modules
    return Target(points, weights, q, curve, result.parameters, residual, method, reason, placed_by=placed_by)


def _warn_if_far(arm: Arm, target: Target) -> None:
    """Warn if the control points are on the curve but the links between them are far from it."""
    if target.curve is None or target.q is None or target.residual is None:
        return
    between = max(_link_lengths(arm, target.q)) / 2.0  # no link is farther from both neighbouring points
    if between + float(target.residual.max()) <= PLACING.far * arm.length:
        return
    away = target.distance_from_curve(arm)
    if away is None or away <= PLACING.far * arm.length:
        return
    fits = arm.can_follow(target.curve)
    reasons = [str(excess) for excess in fits.excesses[:2]]
    if np.any(arm.chain.plane_bound):
        reasons.append("joints with parallel axes move in a plane")
    if not reasons:
        reasons.append("it has too few control points, or too long links, for this curve")
    share = f"{length_text(away)} ({away / arm.length:.2g} of its length)"
    text = f"the arm does not follow the curve: its links are up to {share} away"
    warn_caller(f"{text} ({'; '.join(reasons)})")


def _link_lengths(arm: Arm, q: Array) -> list[float]:
    """Return the length along the links of each module at a configuration, (m,) [m]."""
    state = arm.chain_at(q)
    lengths = []
    start = arm.chain.base
    for k, joints in enumerate(arm.chain.module_slices):
        line = np.vstack([start, state.origins[joints], state.points[k]])
        lengths.append(float(np.linalg.norm(np.diff(line, axis=0), axis=1).sum()))
        start = state.points[k]
    return lengths


def _distances(arm: Arm, positions: Array, curve: Curve, parameters: Array) -> Array:
    """Return the distances of the control points from their points on the curve, (m,) [m]."""
    points = arm.chain.flattened(arm.chain_at(arm.configuration(positions)).points)
    gaps = points - curve.at(parameters)
    return np.asarray(np.sqrt(np.einsum("ij,ij->i", gaps, gaps)))


def _obstruction(
    arm: Arm, curve: Curve, positions: Array, module: int, start: float
) -> tuple[type[TargetError], str]:
    """Explain what keeps the end of a module off the curve at the fitted joint positions (nv,)."""
    columns = arm.columns[: arm.chain.input_ends[module]]
    room = np.minimum(positions - arm.limits.lower, arm.limits.upper - positions) / arm.joint_units
    names = dict(zip(arm.columns.tolist(), arm.chain.input_names, strict=True))
    stuck = [int(u) for u in columns if room[u] <= CONVERGED]
    slides = [u for u in stuck if arm.slides[u]]
    if slides and slides == stuck:
        listed = ", ".join(f"{names[u]!r} at {length_text(positions[u])}" for u in slides[:3])
        advice = "move the curve, or widen their limits"
        return CurveOutOfReach, f"prismatic joints are at their limits: {listed}; {advice}"
    gap = float(np.linalg.norm(curve.at(start) - arm.chain.base))
    if gap > ROUNDING * arm.length and not np.any(arm.base_slides):
        return (
            CurveLeavesTooSharply,
            f"the curve passes {length_text(gap)} from the base; {ADVISE.at_the_base}",
        )
    if arm.chain.plane_bound[module]:
        advice = "use a curve in one plane, or joints whose axes differ"
        return CurveBendsTooMuch, f"its joint axes are parallel, so it moves in a plane; {advice}"
    if stuck:
        listed = ", ".join(repr(names[u]) for u in stuck[:3]) + (", ..." if len(stuck) > 3 else "")
        return CurveBendsTooMuch, f"joints are at their limits: {listed}; {ADVISE.gentler}"
    return CurveBendsTooMuch, "use a gentler curve or shorter modules"
