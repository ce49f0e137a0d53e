"""Curves that wrap around an obstacle, for arms that grasp with their whole length."""

from __future__ import annotations

from math import isfinite
from typing import Any, NamedTuple

import coal
import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.spatial import ConvexHull

from pinposture import _validation
from pinposture._validation import as_number, as_vector, length
from pinposture.collision.obstacles import Obstacle
from pinposture.collision.shapes import Box, Capsule, Cylinder, Mesh, MeshShape, Sphere
from pinposture.collision.solids import Solid
from pinposture.curve import Curve
from pinposture.errors import CurveError, InvalidValue
from pinposture.kernels.arrays import SOLID
from pinposture.units import ROUNDING, length_text

Array = NDArray[np.float64]


class WrappingCurveSettings(NamedTuple):
    """How often a curve may turn around an object, and how finely it is drawn."""

    max_turns: float = 100.0
    least_turns: float = 1e-3
    """Largest and smallest number of turns: the length of fewer is lost in rounding."""

    pitch: float = 2.5
    """Advance of a turn, in gaps: with a gap of the radius of the arm, its turns are half a radius
    apart."""

    rim_points: int = 96
    """Corners of the polygon around a round rim that is seen from the side: it is 0.05 % of the radius
    larger."""

    samples_per_rounding: int = 64
    """Points of the curve in a full turn of its sharpest rounding; the curve keeps the gap to 0.2 % of
    it."""

    most_samples: int = 20_000
    gap_tolerance: float = 0.01
    """Share of the gap by which the approach may come nearer."""


WRAPPING = WrappingCurveSettings()


def as_turns(name: str, value: Any) -> float:
    """Read a number of turns, which may be negative, else raise InvalidValue."""
    allowed = f"a number of {WRAPPING.least_turns:g} to {WRAPPING.max_turns:g}, or the negative of one"
    return as_number(name, value, allowed, lambda x: WRAPPING.least_turns <= abs(x) <= WRAPPING.max_turns)


class WrappedBody(NamedTuple):
    """A convex obstacle, as it is wrapped.

    Attributes:
        solid: the obstacle, or its convex hull.
        points: points whose convex hull, seen along the axis, it has, (n, 3) [m], world frame.
        radius: all within this radius of that hull belongs to it, too [m].
        axis: the axis, (3,).
    """

    solid: Solid
    points: Array
    radius: float
    axis: Array

    def distances(self, points: Array) -> Array:
        """Return the distances of points, (k, 3) [m], from the body, (k,) [m]; negative inside."""
        ball = coal.Sphere(0.0)
        pose = coal.Transform3s(self.solid.rotation, self.solid.position)
        request = coal.DistanceRequest()
        result = coal.DistanceResult()
        distances = []
        for point in points:
            result.clear()
            at = coal.Transform3s(np.eye(3), point)
            distances.append(coal.distance(ball, at, self.solid.geometry, pose, request, result))
        return np.array(distances)


class Winding(NamedTuple):
    """The part of a curve around an obstacle that winds about it.

    Attributes:
        body: the obstacle.
        points: points of the curve, (n, 3) [m], world frame.
        heading: direction of the curve at the first of them, (3,).
    """

    body: WrappedBody
    points: Array
    heading: Array

    @property
    def spacing(self) -> float:
        """Distance between points [m]."""
        return float(np.linalg.norm(self.points[1] - self.points[0]))


class RoundedOutline:
    """The closed curve at a distance around the convex hull of points in a plane, counterclockwise.

    It consists of an arc about each corner of the hull, followed by a straight line to the next one.

    Attributes:
        perimeter: its length [m].

    Args:
        points: points in the plane, (n, 2) [m].
        distance: the distance, above 0 [m].
    """

    def __init__(self, points: Array, distance: float) -> None:
        corners = _corners(points)
        sides = np.roll(corners, -1, axis=0) - corners
        headings = np.arctan2(sides[:, 1], sides[:, 0])
        lengths = np.linalg.norm(sides, axis=1)
        turns = (headings - np.roll(headings, 1)) % (2.0 * np.pi)
        if len(corners) <= 2:
            turns[:] = 2.0 * np.pi / len(corners)
        self._corners = corners
        self._distance = distance
        self._normals = headings - turns - 0.5 * np.pi  # of the outline where each arc begins
        self._arcs = distance * turns
        self._begins = np.concatenate([[0.0], np.cumsum(self._arcs + lengths)])
        self.perimeter = float(self._begins[-1])

    def at(self, s: Array) -> tuple[Array, Array]:
        """Return points and unit tangents, each (k, 2), at arc lengths (k,) [m], which may exceed a turn."""
        s = s % self.perimeter
        corner = np.searchsorted(self._begins, s, side="right") - 1
        corner = np.minimum(corner, len(self._corners) - 1)
        ahead = s - self._begins[corner]
        on_arc = np.minimum(ahead, self._arcs[corner])
        normal = self._normals[corner] + on_arc / self._distance
        outward = np.column_stack([np.cos(normal), np.sin(normal)])
        forward = np.column_stack([-outward[:, 1], outward[:, 0]])
        straight = (ahead - on_arc)[:, None] * forward
        return self._corners[corner] + self._distance * outward + straight, forward

    def touched_from(self, source: Array) -> float:
        """Return the arc length at which a line from a point outside, (2,), runs into it; NaN from inside.

        From there on, the outline goes on in the direction of the line.
        """
        towards = self._corners - source
        apart = np.linalg.norm(towards, axis=1)
        if np.any(apart <= self._distance):
            return float("nan")
        middle = self._corners.mean(axis=0) - source
        facing = np.arctan2(middle[1], middle[0])
        angles = (np.arctan2(towards[:, 1], towards[:, 0]) - facing + np.pi) % (2.0 * np.pi) - np.pi
        angles -= np.arcsin(self._distance / apart)
        corner = int(angles.argmin())
        if angles[corner] <= -0.5 * np.pi:
            return float("nan")
        turned = (facing + angles[corner] - 0.5 * np.pi - self._normals[corner]) % (2.0 * np.pi)
        if self._distance * turned > self._arcs[corner] * (1.0 + 1e-9) + 1e-12:
            return float("nan")  # between a corner and the outline
        return float(self._begins[corner] + self._distance * turned)

    def nearest(self, point: Array) -> float:
        """Return the arc length of the point that is nearest to another, (2,) [m]."""
        s = np.linspace(0.0, self.perimeter, 721)
        return float(s[np.linalg.norm(self.at(s)[0] - point, axis=1).argmin()])


def _corners(points: Array) -> Array:
    """Return the corners of the convex hull of points, (n, 2), counterclockwise; two of a line, or one."""
    middle = points.mean(axis=0)
    size = float(np.abs(points - middle).max())
    if size == 0.0:
        return points[:1]
    _, _, axes = np.linalg.svd(points - middle, full_matrices=False)
    along = (points - middle) @ axes[0]
    across = (points - middle) @ np.array([-axes[0, 1], axes[0, 0]])
    if np.abs(across).max() <= 1e-9 * size:
        return points[[along.argmin(), along.argmax()]]
    return np.asarray(points[ConvexHull(points).vertices])


def curve_around(
    obstacle: Obstacle,
    start: ArrayLike,
    gap: float,
    turns: float = 1.0,
    axis: ArrayLike | None = None,
    pitch: float | None = None,
    direction: ArrayLike | None = None,
) -> Curve:
    """Create the curve on which an arm wraps around an obstacle, from the side on which the arm stands.

    The curve runs from `start` to the obstacle, and winds about the axis in a screw that stays at a distance
    from the obstacle, or from its convex hull. The middle of the screw is at the middle of the obstacle.

        can = pp.Cylinder((0.4, 0.1, -0.2), (0.4, 0.1, 0.2), 0.08)
        curve = pp.curve_around(can, start=(0, 0, 0), gap=0.03, turns=1.5)

    Args:
        obstacle: a sphere, capsule, cylinder, box or mesh.
        start: where the curve begins, usually the base of the arm, (3,) [m], world frame.
        gap: distance of the curve from the surface [m]; the radius of the arm, for it to touch.
        turns: number of turns about the axis, counterclockwise seen from its tip; negative: clockwise.
        axis: direction of the axis, (3,); None: that of a cylinder or capsule, else the direction in which
            the obstacle is longest.
        pitch: advance along the axis in a turn [m], negative against it; None: 2.5 gaps.
        direction: direction of the curve at the start, (3,); None: it starts straight towards the obstacle.

    Raises:
        InvalidValue: an obstacle of another kind, or an invalid number, which is named.
        CurveError: the way from the start to the obstacle, or the start, comes nearer than the gap.
    """
    gap = length("gap", gap, zero=True)
    begin = as_vector("start", start)
    first = _heading("direction", direction)
    if float(_body(obstacle, axis).distances(begin[None])[0]) < gap:
        raise CurveError("start", f"it is less than the gap of {length_text(gap)} away from the obstacle")
    winding = winding_around(obstacle, begin, gap, turns, axis, pitch, first)
    approach = _approach((begin, winding.points[0]), (first, winding.heading), winding.spacing)
    nearest = float(winding.body.distances(approach).min())
    if nearest < gap * (1.0 - WRAPPING.gap_tolerance) - 1e-9:
        near = f"the way to the obstacle comes {length_text(gap - nearest)} nearer to it than the gap"
        raise CurveError("start", f"{near}; give another direction, axis, or sign of turns")
    return Curve.points(np.vstack([approach, winding.points]))


def winding_around(
    obstacle: Obstacle,
    start: Array,
    gap: float,
    turns: float,
    axis: ArrayLike | None = None,
    pitch: float | None = None,
    heading: Array | None = None,
) -> Winding:
    """Return the part of a curve that winds around an obstacle, for the arguments of `curve_around`.

    Args:
        obstacle: the obstacle.
        start: where the curve comes from, (3,) [m].
        gap: distance from the surface [m].
        turns: number of turns.
        axis: direction of the axis.
        pitch: advance along the axis in a turn [m].
        heading: direction of the curve at the start, a unit vector, (3,).

    Raises:
        InvalidValue: as `curve_around`.
    """
    body = _body(obstacle, axis)
    turns = as_turns("turns", turns)
    reach = body.radius + gap
    if reach <= 0.0:
        raise InvalidValue("gap", gap, "more than 0 for an obstacle with edges")
    pitch = (
        WRAPPING.pitch * gap if pitch is None else as_number("pitch", pitch, "a finite number [m]", isfinite)
    )
    frame = _frame(body.axis)
    if turns < 0.0:
        frame = frame * np.array([[1.0], [-1.0], [1.0]])  # mirrored
    local = body.points @ frame.T
    outline = RoundedOutline(local[:, :2], reach)
    middle = 0.5 * (local[:, 2].min() + local[:, 2].max())
    rise = pitch * abs(turns)
    touch = _touching(outline, frame @ start, None if heading is None else frame @ heading)
    total = abs(turns) * outline.perimeter
    step = 2.0 * np.pi * reach / WRAPPING.samples_per_rounding
    count = int(np.ceil(total / step)) + 1
    if count > WRAPPING.most_samples:
        needed = gap + (count / WRAPPING.most_samples - 1.0) * reach
        raise InvalidValue(
            "gap", gap, f"about {length_text(needed)} or more, or fewer turns: it rounds the edges"
        )
    s = np.linspace(0.0, total, count)
    points, tangents = outline.at(touch + s)
    wound = np.column_stack([points, middle - 0.5 * rise + rise * s / total])
    onto = np.append(tangents[0], rise / total)
    return Winding(body, wound @ frame, onto @ frame / np.linalg.norm(onto))


def _body(obstacle: Obstacle, axis: ArrayLike | None) -> WrappedBody:
    """Return an obstacle as it is wrapped about an axis; None: its own."""
    kinds = (Sphere, Capsule, Cylinder, Box, Mesh, MeshShape)
    if not isinstance(obstacle, kinds):
        known = ", ".join(kind.__name__ for kind in kinds if kind is not MeshShape)
        raise InvalidValue("obstacle", obstacle, f"one of {known}")
    about = _heading("axis", axis)
    shape = obstacle.geometry
    if isinstance(shape, Sphere):
        up = np.array([0.0, 0.0, 1.0])
        return WrappedBody(
            shape.solid(), np.array([shape.center]), shape.radius, up if about is None else about
        )
    if isinstance(shape, Capsule | Cylinder):
        ends = np.array([shape.start, shape.end])
        direction = (ends[1] - ends[0]) / np.linalg.norm(ends[1] - ends[0])
        about = direction if about is None else about
        if shape.primitive != SOLID.cylinder or float(np.linalg.norm(np.cross(direction, about))) < ROUNDING:
            return WrappedBody(shape.solid(), ends, shape.radius, about)
        rim = _circle(shape.radius) @ _frame(direction)[:2]
        return WrappedBody(shape.solid(), np.vstack([end + rim for end in ends]), 0.0, about)
    if isinstance(shape, Box):
        solid = shape.solid()
        signs = np.array(np.meshgrid(*np.tile([-1.0, 1.0], (3, 1)))).reshape(3, 8).T
        longest = solid.rotation[:, int(solid.half.argmax())]
        points = (signs * solid.half) @ solid.rotation.T + solid.center
        return WrappedBody(solid, points, 0.0, longest if about is None else about)
    hull = Mesh(shape.vertices, shape.center, shape.rotation)
    points = hull.vertices @ np.array(hull.rotation).T + np.array(hull.center)
    longest = np.linalg.svd(points - points.mean(axis=0), full_matrices=False)[2][0]
    return WrappedBody(hull.solid(), points, 0.0, longest if about is None else about)


def _heading(name: str, value: ArrayLike | None) -> Array | None:
    """Return the unit vector along a direction, (3,); None if there is none."""
    return None if value is None else np.array(_validation.direction(name, value))


def _frame(axis: Array) -> Array:
    """Return a right-handed frame whose third axis is along a unit vector; its axes are the rows, (3, 3)."""
    side = np.cross(axis, np.eye(3)[int(np.abs(axis).argmin())])
    side /= np.linalg.norm(side)
    return np.array([side, np.cross(axis, side), axis])


def _circle(radius: float) -> Array:
    """Return the corners of a polygon around a circle about the origin, (k, 2) [m]."""
    count = WRAPPING.rim_points
    angles = 2.0 * np.pi * np.arange(count) / count
    return np.asarray(radius / np.cos(np.pi / count) * np.column_stack([np.cos(angles), np.sin(angles)]))


def _touching(outline: RoundedOutline, start: Array, heading: Array | None) -> float:
    """Return the arc length at which a curve from a start, (3,), in some direction, runs into an outline."""
    source = start[:2]
    point = outline.at(np.array([outline.nearest(source)]))[0][0]
    if heading is not None:
        source = source + heading[:2] * float(np.linalg.norm(point - source)) / 3.0
    touch = outline.touched_from(source)
    return touch if isfinite(touch) else outline.nearest(source)  # the start is beyond an end of the obstacle


def _approach(ends: tuple[Array, Array], headings: tuple[Array | None, Array], step: float) -> Array:
    """Return points on the way from a start to where the curve touches, without that one, (n, 3) [m].

    It is a cubic between the two directions; without the first one it is not bent at the start.
    """
    start, touch = ends
    first, last = headings
    lead = float(np.linalg.norm(touch - start)) / 3.0
    after = touch - lead * last
    before = 0.5 * (start + after) if first is None else start + lead * first
    count = min(max(int(np.ceil(3.0 * lead / step)), 8), WRAPPING.most_samples)
    t = (np.arange(count) / count)[:, None]
    inner = 3.0 * t * (1.0 - t) ** 2 * before + 3.0 * t**2 * (1.0 - t) * after
    return np.asarray((1.0 - t) ** 3 * start + inner + t**3 * touch)
