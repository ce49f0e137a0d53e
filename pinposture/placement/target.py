"""The target posture: target positions of the control points."""

from __future__ import annotations

from dataclasses import dataclass, replace
from math import isfinite

import numpy as np
from numpy.typing import ArrayLike, NDArray

from pinposture._validation import finite_vector, float_array
from pinposture.arm import Arm
from pinposture.curve import Curve
from pinposture.errors import InvalidValue
from pinposture.placement.curve_placement import Moved, distance_from_curve

Array = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class Target:
    """Target positions of the control points, and their origin.

    Attributes:
        points: target positions, (m, 3) [m], world frame.
        weights: 1 for a control point that has a target, 0 for one that is free, (m,). `fit_points` and
            `LevenbergMarquardt` weight errors by them; other controllers only test whether they are above 0.
        q: a configuration that takes the target posture, (nq,), or None if none is known.
        curve: the curve as placed in the world, or None.
        parameters: arc length along the curve at each point, (m,) [m], or None.
        residual: distance of each point from the curve, or of the posture at `q` from measured points, (m,)
            [m], or None.
        method: the placement method: "sequential", "smooth" or "closest"; or empty.
        moved: how the curve was moved from where it was drawn; None without a curve, or if unknown.
        incomplete: why some control points could not be placed on the curve; empty if all are. Those
            have weight 0, and their `points` continue straight on from the last that was placed.
        velocity: how fast the joints move that configuration, if the target moves, (nv,) [rad/s or m/s]; None
            if unknown.
        placed_by: for each control point what put it on the curve, (m,): the kinematics of its module,
            "Torus", "Circle", "RollPitch", "NumericModule" or your own class; or "least squares" over the
            whole arm. Empty without a curve.
        fallback: why least squares placed the whole arm although `method="auto"` places modules one by one
            where it can; empty if they did not, or were asked for.
        approximate: by how much the posture at `q` misses given points (`fit_points`), which may be a local
            minimum; empty if it takes them, or none is known.
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

    def __post_init__(self) -> None:
        for name in ("points", "weights", "q", "parameters", "residual", "velocity"):
            value = getattr(self, name)
            if value is not None:
                array = np.array(value, dtype=np.float64)
                array.flags.writeable = False
                object.__setattr__(self, name, array)

    @property
    def has_target(self) -> NDArray[np.bool_]:
        """Which control points have a target, (m,)."""
        return np.asarray(self.weights > 0.0)

    def distance_from_curve(self, arm: Arm) -> float | None:
        """Return the distance of the point of the links farthest from the curve at `q` [m].

        Args:
            arm: the arm that the target is for.

        Returns:
            The distance, in the plane of a planar arm; None without a curve or configuration.
        """
        if self.q is None or self.curve is None:
            return None
        return distance_from_curve(arm, self.q, self.curve)

    def check(self, arm: Arm) -> None:
        """Raise InvalidValue unless the target fits an arm, is finite, and has a point to control."""
        m = arm.n_modules
        if self.points.shape != (m, 3):
            raise InvalidValue("target.points (shape)", self.points.shape, f"({m}, 3) for this arm")
        if self.weights.shape != (m,):
            raise InvalidValue("target.weights (shape)", self.weights.shape, f"({m},) for this arm")
        if not np.any(self.has_target):
            raise InvalidValue("target.weights", 0.0, "at least one control point with a weight > 0")
        for name, values in (("points", self.points), ("weights", self.weights)):
            flat = values.ravel()
            if not isfinite(flat @ flat) and not np.all(np.isfinite(values)):
                where = tuple(int(i) for i in np.argwhere(~np.isfinite(values))[0])
                allowed = "finite numbers, also for points of weight 0"
                raise InvalidValue(f"target.{name}{list(where)}", float(values[where]), allowed)
        if self.q is not None:
            arm.checked(self.q, "target.q")
        if self.velocity is not None:
            finite_vector("target.velocity", self.velocity, arm.nv)

    def region(self, first: int, last: int) -> Target:
        """Return the same target for control points `first` to `last` only; the others are free.

        Weights within the region stay as they are. So does `q`, which still takes the whole posture.

        Args:
            first: first control point of the region, 0-based.
            last: last control point of the region, included.

        Raises:
            InvalidValue: not a region of the arm, or none of its points has a target.
        """
        m = len(self.weights)
        for name, value, lowest in (("first", first, 0), ("last", last, first)):
            whole = isinstance(value, int | np.integer) and not isinstance(value, bool)
            if not (whole and lowest <= value < m):
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
        """Make a target of given positions, for instance measured ones.

        Args:
            arm: the arm.
            points: one position per control point, (m, 3) [m], world frame.
            weights: 1 to control a point, 0 to leave it free, (m,); all 1 if None.

        Raises:
            InvalidValue: wrong shape, not finite, negative weights, or no point with a weight.
        """
        m = arm.n_modules
        positions = _finite_array("points", points, (m, 3))
        checked = np.ones(m) if weights is None else _finite_array("weights", weights, (m,))
        if np.any(checked < 0.0) or not np.any(checked > 0.0):
            raise InvalidValue("weights", checked.tolist(), "numbers >= 0, at least one of them > 0")
        return cls(positions, checked)

    @classmethod
    def from_configuration(cls, arm: Arm, q: ArrayLike) -> Target:
        """Make a target of the posture at a configuration q, (nq,).

        Raises:
            InvalidValue: as `Arm.checked_start`.
        """
        state = arm.at(arm.checked_start(q)).compiled
        return cls(state.points, np.ones(arm.n_modules), q=state.q)


def _finite_array(name: str, values: ArrayLike, shape: tuple[int, ...]) -> Array:
    array = float_array(name, values, shape)
    if not np.all(np.isfinite(array)):
        where = tuple(int(i) for i in np.argwhere(~np.isfinite(array))[0])
        raise InvalidValue(f"{name}{list(where)}", float(array[where]), "finite numbers")
    return array
