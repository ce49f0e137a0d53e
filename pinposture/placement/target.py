"""The target posture: target positions of the control points, and the placement of a curve at an arm."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import Annotated, NamedTuple
from weakref import WeakSet

import numpy as np
import pinocchio as pin
from numpy.typing import ArrayLike, NDArray

from pinposture._validation import (
    LARGEST_NUMBER,
    as_floats,
    finite_array,
    finite_vector,
    is_whole,
    make_read_only,
    require_finite,
    require_instance,
)
from pinposture.arm import Arm, ArmState, ChainState, JointLoad
from pinposture.curve import Curve
from pinposture.errors import InvalidValue, TargetError, warn_caller
from pinposture.schema import quantities
from pinposture.units import ROUNDING, length_text

Array = NDArray[np.float64]


MAX_LENGTH_RATIO = 100
"""Length of a curve, and distance of a point from the base, that suggest another unit, in arm lengths."""


class TargetAdvice(NamedTuple):
    """What to do about a curve or a target."""

    resolve_again: str = "the target belongs to another arm: resolve it for this one"
    in_millimetres: str = "if it is in millimetres, load it with scale=0.001"
    gentler: str = "use a gentler curve, wider joint limits or shorter modules"
    at_the_base: str = 'use placement="translate" or "align"'


ADVISE = TargetAdvice()


@dataclass(frozen=True, eq=False)
class Target:
    """Target positions of the control points, and their origin.

    Its arrays are copies of those given, or these themselves where nobody can write to them.

    Attributes:
        points: target positions, (m, 3) [m], world frame.
        weights: 1 for a control point with a target, 0 for a free one, (m,). `fit_points` and
            `LevenbergMarquardt` weight errors by them; other controllers only test whether they are above 0.
        q: a configuration of the target posture, (nq,); None if unknown.
        curve: the curve as placed in the world, or None.
        parameters: arc length along the curve at each point, (m,) [m], or None.
        residual: distance of points from the curve, or of the posture `q` from measured points, (m,) [m], or
            None.
        method: the placement method: "sequential", "smooth" or "closest"; or empty.
        moved: how the curve was moved from its position as drawn; None without a curve, or if unknown.
        incomplete: why some control points could not be placed on the curve; empty if all are. Those
            have weight 0, and their `points` continue straight from the last placed one.
        velocity: joint velocities at `q` if the target moves, (nv,) [rad/s or m/s]; None if unknown.
        led: whether the target leads the arm along a way that it must not leave, as an operator's does.
            "geodesic" then takes each step towards it as far as that is clear, or brakes; it never goes
            round, nor gives way.
        placed_by: what placed each control point on the curve, (m,): the kinematics of its module,
            "Torus", "Circle", "RollPitch", "NumericModule" or a custom class; or "least squares" over the
            whole arm. Empty without a curve.
        fallback: why `method="auto"` placed the arm by least squares instead of module by module, or empty.
        approximate: by how much the posture at `q` misses given points (`fit_points`), which may be a local
            minimum; empty if it reaches them, or if `q` is unknown.
    """

    points: Array
    weights: Array
    q: Array | None = None
    curve: Curve | None = None
    parameters: Array | None = None
    residual: Array | None = None
    method: str = ""
    incomplete: str = ""
    moved: Moved | None = None
    approximate: str = ""
    velocity: Array | None = None
    placed_by: tuple[str, ...] = ()
    fallback: str = ""
    led: bool = False

    def __post_init__(self) -> None:
        for name in ("points", "weights", "q", "parameters", "residual", "velocity"):
            value = getattr(self, name)
            if value is None:
                continue
            if type(value) is np.ndarray and value.dtype == np.float64:
                source = value if value.base is None else value.base
                fixed = type(source) is np.ndarray and not (source.flags.writeable or value.flags.writeable)
                if fixed and value.flags.c_contiguous:  # as in each cycle of a motion
                    continue
            array = as_floats(f"target.{name}", value)
            array.flags.writeable = False
            object.__setattr__(self, name, array)

    def __repr__(self) -> str:
        placed = int(np.count_nonzero(self.weights > 0.0))
        count = (
            f"{placed} points" if placed == len(self.weights) else f"{placed} of {len(self.weights)} points"
        )
        known = "no configuration" if self.q is None else "a configuration"
        curve = "" if self.curve is None else f", on a curve of {length_text(self.curve.length)}"
        method = f", {self.method} placement" if self.method else ""
        return f"Target({count}, {known}{curve}{method})"

    @property
    def has_target(self) -> NDArray[np.bool_]:
        """True for control points with a target, (m,)."""
        return np.asarray(self.weights > 0.0)

    def errors(self, points: Array) -> Array:
        """Return the errors c_k - p_k of control points, zero for those without a target.

        Args:
            points: the control points, (m, 3) or (s, m, 3) [m], world frame.

        Returns:
            The vectors from the points to their targets, of the same shape [m], world axes.

        Raises:
            InvalidValue: the points are not finite numbers of this shape.
        """
        usual = isinstance(points, np.ndarray) and points.dtype == np.float64
        fits = usual and points.ndim in (2, 3) and points.shape[-2:] == self.points.shape
        if not (fits and (np.abs(points) <= LARGEST_NUMBER).all()):
            points = self._read_points(points)
        return np.asarray((self.points - points) * (self.weights > 0.0)[:, None])

    def _read_points(self, points: Array) -> Array:
        """Read control points, as for `errors`, which are not as they usually are."""
        checked = finite_array("points", points)
        if checked.ndim not in (2, 3) or checked.shape[-2:] != self.points.shape:
            allowed = f"(m, 3) or (s, m, 3), with m = {len(self.points)}"
            raise InvalidValue("points (shape)", checked.shape, allowed)
        return checked

    def distances(self, points: Array) -> Array:
        """Return the distances of control points, as for `errors`, from their targets, (m,) or (s, m) [m]."""
        return np.asarray(np.linalg.norm(self.errors(points), axis=-1))

    def mean_distance(self, points: Array) -> float:
        """Return the mean distance of the control points, (m, 3) [m], that have a target from it [m].

        It is 0 if none has one.
        """
        placed = self.has_target
        return float(self.distances(points)[placed].mean()) if np.any(placed) else 0.0

    def distance_from_curve(self, arm: Arm) -> float | None:
        """Return the largest distance of the links from the curve at `q` [m].

        Args:
            arm: the arm of the target.

        Returns:
            The distance, within the plane for a planar arm; None without a curve or configuration.
        """
        if self.q is None or self.curve is None:
            return None
        return distance_from_curve(arm, self.q, self.curve)

    def load(self, arm: Arm) -> JointLoad | None:
        """Return the joint that is loaded most, in relation to its torque limit, in the target posture.

        Args:
            arm: the arm that is to take the posture.

        Returns:
            None if masses, torque limits or the configuration (`q`) are not known.

        Raises:
            InvalidValue: an arm of another size.
        """
        require_instance("arm", arm, Arm, "an Arm")
        self.check_arm(arm)
        return None if self.q is None else arm.at(self.q).most_loaded()

    def check(self, arm: Arm) -> None:
        """Raise InvalidValue unless the target fits an arm, is finite, and has a point to control."""
        require_instance("arm", arm, Arm, "an Arm")
        check_numbers(self, arm)
        if not np.any(self.weights > 0.0):
            raise InvalidValue("target.weights", 0.0, "at least one control point with a weight > 0")

    def check_arm(self, arm: Arm) -> None:
        """Raise InvalidValue as `check`, or if the target was resolved on a curve for a different arm."""
        self.check(arm)
        if self.q is None or self.curve is None:
            return
        missed = self.mean_distance(arm.chain_at(self.q).points)
        allowed = 0.01 * arm.length  # farther, it belongs to another arm
        if missed > allowed:
            name = "mean distance of target.points from the posture of this arm at target.q [m]"
            raise InvalidValue(name, float(f"{missed:.3g}"), f"{allowed:.3g} at most; {ADVISE.resolve_again}")

    def region(self, first: int, last: int) -> Target:
        """Return the same target for control points `first` to `last` only; the others are free.

        Weights within the region are kept, and so is `q`, which still takes the whole posture.

        Args:
            first: first control point of the region, 0-based.
            last: last control point of the region, included.

        Raises:
            InvalidValue: not a region of the arm, or none of its points has a target.
        """
        m = len(self.weights)
        for name, value, lowest in (("first", first, 0), ("last", last, first)):
            if not (is_whole(value) and lowest <= value < m):
                raise InvalidValue(name, value, f"a whole number from {lowest} to {m - 1}")
        inside = np.zeros(m, dtype=np.bool_)
        inside[first : last + 1] = True
        if not np.any(self.has_target & inside):
            listed = ", ".join(map(str, np.flatnonzero(self.has_target)))
            allowed = f"a region with a control point that has a target: {listed}"
            raise InvalidValue("region", (int(first), int(last)), allowed)
        return replace(self, weights=np.where(inside, self.weights, 0.0))

    @classmethod
    def from_points(cls, arm: Arm, points: ArrayLike, weights: ArrayLike | None = None) -> Target:
        """Create a target from given positions, for instance measured ones.

        A `PostureWarning` reports points with a weight that are more than 100 arm lengths from the base of an
        arm that does not slide without limit.

        Args:
            arm: the arm.
            points: one position per control point, (m, 3) [m], world frame.
            weights: 1 to control a point, 0 to leave it free, (m,); all 1 if None.

        Raises:
            InvalidValue: wrong shape, not finite, a point farther than 1e6 arm lengths from the base,
                negative weights, or no point with a weight.
        """
        require_instance("arm", arm, Arm, "an Arm")
        m = arm.n_modules
        positions = finite_array("points", points, (m, 3))
        arm.require_near("points", positions)
        checked = np.ones(m) if weights is None else finite_array("weights", weights, (m,))
        if np.any(checked < 0.0) or not np.any(checked > 0.0):
            raise InvalidValue("weights", checked.tolist(), "numbers >= 0, at least one of them > 0")
        _warn_of_far_points(arm, np.where(checked[:, None] > 0.0, positions, arm.chain.base))
        return cls(positions, checked)

    @classmethod
    def from_configuration(cls, arm: Arm, q: ArrayLike) -> Target:
        """Create a target from the posture at a configuration q, (nq,).

        Raises:
            InvalidValue: as `Arm.checked_start`.
        """
        require_instance("arm", arm, Arm, "an Arm")
        return target_at(ChainState(arm, arm.checked_start(q)), np.ones(arm.n_modules))


def target_at(state: ArmState, weights: Array) -> Target:
    """Return the posture of an arm at a state as a target, with weights (m,), which needs no checks."""
    return known_target(state.arm, Target(state.points, weights, q=state.q))


def known_target(arm: Arm, target: Target) -> Target:
    """Return a target that is computed from a posture of an arm, so that no step checks its numbers."""
    arm.cache.setdefault(check_numbers, WeakSet()).add(target)
    return target


def check_numbers(target: Target, arm: Arm) -> None:
    """Raise InvalidValue unless a target fits an arm and is finite; once for each arm."""
    checked = arm.cache.setdefault(check_numbers, WeakSet())
    if target in checked:
        return
    m = arm.n_modules
    for name, values, shape in (("points", target.points, (m, 3)), ("q", target.q, (arm.nq,))):
        if values is not None and values.shape != shape:
            allowed = f"{shape} for this arm; {ADVISE.resolve_again}"
            raise InvalidValue(f"target.{name} (shape)", values.shape, allowed)
    if target.weights.shape != (m,):
        raise InvalidValue("target.weights (shape)", target.weights.shape, f"({m},) for this arm")
    require_finite("target.weights", target.weights)
    arm.require_near("target.points", target.points)
    if target.q is not None:
        arm.checked(target.q, "target.q")
    if target.velocity is not None:
        finite_vector("target.velocity", target.velocity, arm.nv)
    checked.add(target)


def _warn_of_far_points(arm: Arm, points: Array) -> None:
    distances = np.linalg.norm(points - arm.chain.base, axis=1)
    worst = int(np.argmax(distances))
    if distances[worst] <= MAX_LENGTH_RATIO * arm.length or np.any(arm.unlimited & arm.slides):
        return
    away = distances[worst]
    share = distances[worst] / arm.length
    text = f"points[{worst}] is {length_text(away)} from the base of the arm, {share:.3g} times its length"
    warn_caller(f"{text}; is it in millimetres, not metres?")


class FarthestPointSettings(NamedTuple):
    """How the point of a link that is farthest from a curve is searched."""

    resolution: float = 1e-3
    """Largest error of the distance if it has several peaks, in arm lengths."""

    samples: int = 4
    """Samples on either side of the farthest point in a round of refinement, and ratio of their spacing
    from round to round."""

    refinements: int = 5
    """Number of rounds of refinement."""


FARTHEST_POINT = FarthestPointSettings()


class Moved(NamedTuple):
    """How a curve was moved to the arm from its position as drawn.

    Attributes:
        translation: translation of its start, (3,) [m], world frame.
        rotation: rotation vector about its start, (3,) [rad], world frame.
    """

    translation: Annotated[tuple[float, float, float], quantities("length", 3)]
    rotation: Annotated[tuple[float, float, float], quantities("angle", 3)]

    @property
    def distance(self) -> float:
        """Distance by which its start was moved [m]."""
        return math.hypot(*self.translation)

    @property
    def angle(self) -> float:
        """Angle by which it was turned [rad]."""
        return math.hypot(*self.rotation)

    def __str__(self) -> str:
        parts = []
        if self.distance > ROUNDING:
            parts.append(f"moved by {length_text(self.distance)}")
        if self.angle > ROUNDING:
            parts.append(f"turned by {self.angle:.4g} rad")
        return " and ".join(parts) or "where it was drawn"

    def __bool__(self) -> bool:
        return max(self.distance, self.angle) > ROUNDING


class PlacedModules(NamedTuple):
    """Positions of the modules of an arm on a curve.

    Attributes:
        positions: joint positions, (nv,) [rad or m]; zero for modules that could not be placed.
        parameters: arc length of each control point, (m,) [m]; the curve's end if it could not be placed.
        failure: why a module and all later ones could not be placed; None if all are placed.
        placed_by: name of the kinematics that placed each module, or "least squares", (m,).
    """

    positions: Array
    parameters: Array
    failure: TargetError | None
    placed_by: tuple[str, ...] = ()


def place_curve(arm: Arm, curve: Curve, placement: str | None, roll: float) -> tuple[Curve, Moved]:
    """Move a curve to an arm as described in `resolve_targets`; return it and how it was moved.

    A plane curve for a planar arm is also rolled into the arm's plane, by the smaller angle.
    """
    if placement == "as_is":
        return curve, Moved((0.0, 0.0, 0.0), (0.0, 0.0, 0.0))
    turn = np.eye(3)
    if placement != "translate":
        axis = arm_axis(arm)
        turn = _least_rotation(curve.tangent(0.0), axis)
        if arm.dimension == 2 and curve.dimension == 2:
            turn = _roll_into_plane(arm, curve, turn, axis) @ turn
        if roll != 0.0:
            turn = _rotation(axis, roll) @ turn
    translation = tuple((arm.chain.base - curve.start).tolist())
    moved = Moved(translation, tuple(pin.log3(turn).tolist()))
    return curve.moved(turn, arm.chain.base - turn @ curve.start), moved


def fitting_slides(arm: Arm) -> NDArray[np.bool_]:
    """Return which degrees of freedom are slides that fit the length of the arm to a curve, (nv,)."""
    return np.asarray(arm.slides & ~arm.base_slides & (arm.limits.upper > arm.limits.lower))


def length_misfit(arm: Arm, curve: Curve) -> str:
    """Return how a curve is far too long for an arm; empty if it is not."""
    longest = MAX_LENGTH_RATIO * arm.length
    if curve.length <= longest:
        return ""
    allowed = f"{length_text(longest)} at most, {MAX_LENGTH_RATIO} times the arm"
    return f"is {length_text(curve.length)} long; allowed: {allowed}; {ADVISE.in_millimetres}"


def beginning(arm: Arm, curve: Curve) -> tuple[float, bool]:
    """Return the arc length of the point of a curve nearest to the base [m], and whether the base is on it.

    A base on `Arm.base_slides` that is not on the curve moves to the curve's start.
    """
    tolerance = ROUNDING * arm.length
    if math.dist(curve.start, arm.chain.base) <= tolerance:
        return 0.0, True
    nearest, distance = curve.nearest(arm.chain.base)
    if distance > tolerance and np.any(arm.base_slides):
        return 0.0, False
    return float(nearest), float(distance) <= tolerance


def distance_from_curve(arm: Arm, q: Array, curve: Curve) -> float:
    """Return the largest distance of a point of the arm from a curve [m].

    Links are straight between joint centres, control points and the tip (`ArmState.links`). A planar arm is
    projected onto the plane of its base. Distances are measured to the nearest point of the curve, so the
    part of a curve beyond the tip adds nothing.

    Args:
        arm: the arm.
        q: configuration, (nq,).
        curve: the curve, placed in the world.

    Returns:
        The distance; with several peaks that are almost as high, up to `FARTHEST_POINT.resolution` too small.
    """
    ends = arm.chain.flattened(arm.chain_at(q).links)
    starts = ends[:-1]
    links = np.diff(ends, axis=0)
    lengths = np.linalg.norm(links, axis=1)
    tolerance = FARTHEST_POINT.resolution * arm.length
    distances = curve.nearest(ends).distance
    best = int(np.argmax(distances))
    farthest = float(distances[best])
    last = len(links) - 1
    peak = (min(best, last), float(best > last), 0.5)  # link, position on it, and distance to the next sample
    # The distance changes by at most the way along a link, so most parts of links need no closer look.
    half = 0.5
    link = np.arange(len(links))
    share = np.full(len(links), half)
    while len(link):
        distances = curve.nearest(starts[link] + share[:, None] * links[link]).distance
        best = int(np.argmax(distances))
        if distances[best] > farthest:
            farthest = float(distances[best])
            peak = (int(link[best]), float(share[best]), half)
        higher = distances + half * lengths[link] > farthest + tolerance
        half *= 0.5
        link = np.repeat(link[higher], 2)
        share = (share[higher, None] + np.array([-half, half])).ravel()
    on, center, width = peak
    for _ in range(FARTHEST_POINT.refinements):
        steps = np.linspace(center - width, center + width, 2 * FARTHEST_POINT.samples + 1)
        near = np.clip(steps, 0.0, 1.0)
        distances = curve.nearest(starts[on] + near[:, None] * links[on]).distance
        best = int(np.argmax(distances))
        farthest = max(farthest, float(distances[best]))
        center = float(near[best])
        width /= FARTHEST_POINT.samples
    return farthest


def arm_axis(arm: Arm) -> Array:
    """Return the unit vector from the base to the tip of the straight arm, (3,), world frame."""
    if arm_axis not in arm.cache:
        reach = arm.chain.flattened(arm.chain_at(arm.straight()).points[-1]) - arm.chain.base
        direction = np.asarray(reach / max(float(np.linalg.norm(reach)), 1e-300))
        make_read_only(direction)
        arm.cache[arm_axis] = direction
    axis: Array = arm.cache[arm_axis]
    return axis


def _rotation(axis: Array, angle: float) -> Array:
    """Return the rotation (3, 3) about a unit axis (3,) by an angle [rad]."""
    return np.asarray(pin.AngleAxis(angle, axis).toRotationMatrix())


def _least_rotation(a: Array, b: Array) -> Array:
    """Return the rotation (3, 3) by the smallest angle that turns unit vector a into unit vector b."""
    normal = np.cross(a, b)
    sine = math.hypot(*normal)
    cosine = float(a @ b)
    if sine < 1e-12:  # parallel: no turn, or half a turn about any normal
        any_normal = np.cross(b, np.eye(3)[np.argmin(np.abs(b))])
        return _rotation(any_normal / np.linalg.norm(any_normal), 0.0 if cosine > 0 else math.pi)
    return _rotation(normal / sine, math.atan2(sine, cosine))


def _roll_into_plane(arm: Arm, curve: Curve, aligned: Array, axis: Array) -> Array:
    """Return the rotation (3, 3) about the arm's axis that moves a plane curve into a planar arm's plane."""
    points = (curve.resample(200) - curve.start) @ aligned.T
    off_axis = points - (points @ axis)[:, None] * axis
    widest = off_axis[np.argmax(np.einsum("ij,ij->i", off_axis, off_axis))]
    if math.hypot(*widest) < 1e-9 * curve.length:  # a straight line lies in every plane
        return np.eye(3)
    normal = np.cross(*arm.plane)
    angle = math.atan2(widest @ normal, widest @ np.cross(normal, axis))
    return _rotation(axis, math.pi * round(angle / math.pi) - angle)
