"""The shape of a keyframe as a hand takes hold of it: control points of its curve, where the curve is."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import ArrayLike, NDArray

from pinposture._validation import finite_vector
from pinposture.arm import Arm
from pinposture.curve import Curve
from pinposture.curve.construction import deviation
from pinposture.errors import CurveError, InvalidValue
from pinposture.placement.curve_placement import beginning, lay
from pinposture.task import Keyframe

Array = NDArray[np.float64]

DEGREE = 3
MOST_POINTS = 32
"""Control points with which a curve is taken hold of at most."""

FINE = 0.02
"""How far the curve that these control may be from one of another kind, relative to a module length, if so
many are enough for that."""

APART = 0.2
"""How near to another a control point may come, relative to a module length: nearer, they are one to see."""

SPARE = 1.0
"""What a curve is longer than the arm when it is lengthened for it, in mean module lengths: where it bends,
modules cover more of it than they are long."""


TRIES = 20
"""How often the last point is moved on until the curve is long enough."""


@dataclass(frozen=True, eq=False)
class Shape:
    """Control points of a target curve, in the world.

    The first stands at the base of the arm and stays there. For a planar arm, the others stay in its plane.

    Attributes:
        points: (n, 3) [m], world frame.
        degree: of the B-spline that they control.
        off: how far that curve and the part of the keyframe's that the arm needs are apart at most [m]; 0 if
            the points are the keyframe's own.
    """

    points: Array
    degree: int = DEGREE
    off: float = 0.0

    @classmethod
    def of(cls, arm: Arm, keyframe: Keyframe) -> Shape:
        """The shape of a keyframe: its own control points, or few that control nearly the same curve."""
        laid = lay(arm, keyframe.curve, keyframe.placement, keyframe.roll)
        begin, on_it = beginning(arm, laid)
        begin = begin if on_it else 0.0
        own = laid.control_points if begin == 0.0 and laid.degree <= DEGREE else None
        if own is not None and DEGREE < len(own) <= MOST_POINTS:
            return cls(np.array(own), laid.degree)
        end = min(laid.length, begin + enough(arm))
        if begin > 0.0 or end < laid.length:
            laid = laid.trimmed(begin, end)
        tolerance = FINE * float(arm.chain.module_lengths.mean())
        try:
            few = laid.controlled_within(tolerance, most=MOST_POINTS)
        except InvalidValue:  # it winds too much for that
            few = laid.controlled(MOST_POINTS)
        return cls(np.array(few.coefficients), few.degree, deviation(laid, few))

    @property
    def curve(self) -> Curve:
        """The curve that the points control.

        Raises:
            CurveError: points that give none.
        """
        return Curve.spline(self.points, self.degree)

    def keyframe(self, before: Keyframe) -> Keyframe:
        """A keyframe with this shape, and all else as it was.

        The curve then stays where it was drawn, and as much of it is taken as the arm covers.

        Raises:
            CurveError: points that give no curve.
        """
        return replace(before, curve=self.curve, placement="as_is", roll=0.0, trim=True)

    def moved(self, arm: Arm, index: int, position: ArrayLike) -> Shape:
        """The shape with one point elsewhere.

        Where the curve then is shorter than the arm, its last point gives way straight ahead. For a planar
        arm the point goes to the nearest place in its plane.

        Args:
            arm: the arm that is to take the shape.
            index: of the point, 0-based.
            position: where to, (3,) [m], world frame.

        Raises:
            CurveError: the point would lie on another, or give no curve.
            InvalidValue: the first point, which stands at the base of the arm; not a position.
        """
        self._require(index)
        place = finite_vector("position", position, 3)
        if index == 0 and not math.dist(place, self.points[0]) <= 1e-9 * arm.length:
            raise InvalidValue("point 1", place.tolist(), "where it is: it stands at the base of the arm")
        points = self.points.copy()
        points[index] = place if index == 0 else _in_plane(arm, place)
        return replace(self, points=points)._apart(arm, index)._lengthened(arm)

    def inserted(self, arm: Arm, after: int) -> Shape:
        """The shape with one more point, half way from one to the next, or straight on after the last.

        Raises:
            CurveError: there is no room.
        """
        self._require(after)
        points = self.points
        if after == len(points) - 1:
            new = points[-1] + 0.5 * (points[-1] - points[-2])
        else:
            new = 0.5 * (points[after] + points[after + 1])
        more = replace(self, points=np.insert(points, after + 1, new, axis=0))
        return more._apart(arm, after + 1)._lengthened(arm)

    def removed(self, arm: Arm, index: int) -> Shape:
        """The shape without one of its points.

        Raises:
            CurveError: too few would be left.
            InvalidValue: the first point, which stands at the base of the arm.
        """
        self._require(index)
        if index == 0:
            raise InvalidValue("point 1", "deleted", "to stay: it stands at the base of the arm")
        least = self.degree + 1
        if len(self.points) <= least:
            reason = f"cannot be deleted: a curve of degree {self.degree} needs {least} control points"
            raise CurveError(f"point {index + 1}", reason)
        return replace(self, points=np.delete(self.points, index, axis=0))._lengthened(arm)

    def _require(self, index: int) -> None:
        if not 0 <= index < len(self.points):
            raise InvalidValue("point", index + 1, f"1 to {len(self.points)}")

    def _apart(self, arm: Arm, index: int) -> Shape:
        """The shape itself; refused where a point lies on another."""
        distances = np.linalg.norm(self.points - self.points[index], axis=1)
        distances[index] = np.inf
        other, least = int(np.argmin(distances)), APART * float(arm.chain.module_lengths.min())
        if distances[other] < least:
            reason = f"would lie on point {other + 1}; allowed: {least:.2g} m or more from it"
            raise CurveError(f"point {index + 1}", reason)
        return self

    def _lengthened(self, arm: Arm) -> Shape:
        """The shape with its last point moved straight on, if need be, until the curve is long enough."""
        wanted, points = enough(arm), self.points
        for _ in range(TRIES):
            missing = wanted - Curve.spline(points, self.degree).length
            if missing <= 0.0:
                return replace(self, points=points)
            ahead = points[-1] - points[-2]
            # A little more: the curve grows by less than its last point moves.
            step = (missing + 0.01 * arm.length) / max(float(np.linalg.norm(ahead)), 1e-12)
            points = points.copy()
            points[-1] = points[-1] + step * ahead
        reason = f"cannot be moved on until the curve is {wanted:.4g} m long, as the arm needs it"
        raise CurveError(f"point {len(points)}", reason)


def enough(arm: Arm) -> float:
    """How long a curve has to be for an arm, with something to spare [m]."""
    return float(arm.length + SPARE * arm.chain.module_lengths.mean())


def _in_plane(arm: Arm, place: Array) -> Array:
    """A place (3,) itself; for a planar arm the nearest in the plane through its base."""
    base, plane = arm.chain.base, arm.plane
    return place if arm.dimension == 3 else np.asarray(base + (place - base) @ plane.T @ plane)
