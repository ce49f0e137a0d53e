"""The distance of an arm from a scan: coal for surfaces, a k-d tree for clouds of points."""

from __future__ import annotations

from typing import NamedTuple, TypeAlias
from weakref import WeakKeyDictionary

import coal
import numpy as np
from numpy.typing import ArrayLike, NDArray

from pinposture._validation import SMALLEST_LENGTH, length
from pinposture.arm import Arm
from pinposture.arm.configurations import ConfigurationSpace
from pinposture.collision.bodies import Body, bodies_of
from pinposture.collision.distances import Narrow, TreeKinematics
from pinposture.collision.model import MAX_MODELS, ExcludedPair
from pinposture.collision.obstacles import Solid, Sphere, solid
from pinposture.collision.scan import Scan, ScanGeometry
from pinposture.errors import InvalidValue

Array = NDArray[np.float64]

MOUNTED = 0.01
"""How near a scan has to be to where the arm is fixed to count as what it is mounted on [m]."""

_STILL = 1e-9
"""How far a point may move that does not move, relative to the arm."""
_MAX_BALLS = 16
"""How many balls cover a body, at most."""
_TOUCHING = 1e-12
"""Distance below which a body touches a scan [m]."""


class NearestPart(NamedTuple):
    """Where one of several bodies is nearest to a scan.

    Attributes:
        distance: between their surfaces [m]; 0 where they overlap.
        body: index of the body.
        on_body: point of its surface, (3,) [m], world frame; where points of a cloud are inside, one of them.
        on_scan: point of the scan, (3,) [m], world frame; where a surface overlaps the body, of a triangle
            that does.
    """

    distance: float
    body: int
    on_body: Array
    on_scan: Array


ForwardKinematics: TypeAlias = list[tuple[Solid, coal.Transform3s]]
"""Solids, and where the shape of each is in the world."""


def nearest_to_surface(scan: ScanGeometry, bodies: ForwardKinematics) -> NearestPart:
    """Where bodies are nearest to a surface; exact.

    Args:
        scan: a scan with triangles.
        bodies: the bodies, at least one.
    """
    request, result, here = coal.DistanceRequest(), coal.DistanceResult(), coal.Transform3s()
    request.gjk_tolerance = 1e-9
    request.enable_signed_distance = False
    centers = np.array([place.getTranslation() for _, place in bodies])
    best = NearestPart(np.inf, 0, np.zeros(3), np.zeros(3))
    # What one body has found bounds the search of those after it: the result is not cleared in between.
    for body in np.argsort(scan.tree.query(centers)[0]):
        shape, place = bodies[body]
        coal.distance(shape.geometry, place, scan.surface, here, request, result)
        if result.min_distance <= _TOUCHING:
            meeting = coal.CollisionResult()
            coal.collide(shape.geometry, place, scan.surface, here, coal.CollisionRequest(), meeting)
            found = meeting.getContacts()[0] if meeting.isCollision() else result
            points = np.array(found.getNearestPoint1()), np.array(found.getNearestPoint2())
            return NearestPart(0.0, int(body), *points)
        if result.min_distance < best.distance:
            points = np.array(result.getNearestPoint1()), np.array(result.getNearestPoint2())
            best = NearestPart(float(result.min_distance), int(body), *points)
    return best


def nearest_to_points(scan: ScanGeometry, bodies: ForwardKinematics) -> NearestPart:
    """Where bodies are nearest to a cloud of points; exact.

    Each body is covered by balls along its axis; the tree of the points tells which of the balls, and which
    points around them, can have the smallest distance.

    Args:
        scan: a scan without triangles.
        bodies: the bodies, at least one.
    """
    narrow = Narrow()
    centers, radii, owners, axes = [], [], [], []
    for body, (shape, place) in enumerate(bodies):
        turn = place.getRotation() @ shape.rotation.T
        shift = place.getTranslation() - turn @ shape.position
        start, end = turn @ shape.start + shift, turn @ shape.end + shift
        span = float(np.linalg.norm(end - start))
        count = int(np.clip(np.ceil(span / (2.0 * shape.radius)), 1, _MAX_BALLS))
        shares = (np.arange(count) + 0.5) / count
        centers.append(start + shares[:, None] * (end - start))
        radii.append(np.full(count, shape.radius + span / (2.0 * count)))
        owners.append(np.full(count, body))
        axes.append((start, end))
    center, radius, owner = np.concatenate(centers), np.concatenate(radii), np.concatenate(owners)
    apart, first = scan.tree.query(center)
    lower = apart - radius
    best = NearestPart(np.inf, 0, np.zeros(3), np.zeros(3))
    for ball in np.argsort(lower):
        if lower[ball] >= best.distance:
            break
        body = int(owner[ball])
        shape, place = bodies[body]
        # The nearest point to the centre of the ball bounds how far the others can be.
        given = shape, place, axes[body], narrow
        found = _nearest_point(scan.points[first[ball : ball + 1]], *given, best.distance)
        best = best if found is None else NearestPart(found[0], body, *found[1:])
        around = scan.tree.query_ball_point(center[ball], best.distance + radius[ball] + _TOUCHING)
        found = _nearest_point(scan.points[around], *given, best.distance)
        best = best if found is None else NearestPart(found[0], body, *found[1:])
        if best.distance <= 0.0:
            break
    return best


def _nearest_point(
    points: Array,
    shape: Solid,
    place: coal.Transform3s,
    axis: tuple[Array, Array],
    narrow: Narrow,
    below: float,
) -> tuple[float, Array, Array] | None:
    """The nearest of points to a body.

    Args:
        points: the points, (n, 3) [m], world frame.
        shape: the body.
        place: where its shape is in the world.
        axis: ends of the axis of the capsule around it, (3,) [m], world frame.
        narrow: for distances by coal.
        below: the distance that a point has to be nearer than [m].

    Returns:
        Distance [m], point of the body, and point of the scan, (3,) [m]; None if no point is near enough.
    """
    on_axis = _nearest_on_line(points, *axis)
    gaps = points - on_axis
    from_axis = np.linalg.norm(gaps, axis=1)
    lower = from_axis - shape.radius
    if not len(points):
        return None
    if shape.round:
        k = int(np.argmin(lower))
        if lower[k] >= below:
            return None
        if lower[k] <= 0.0:
            return 0.0, points[k], points[k]
        return float(lower[k]), on_axis[k] + gaps[k] * (shape.radius / from_axis[k]), points[k]
    # The box around the body lies along the axes of its shape.
    middle = shape.rotation.T @ (shape.center - shape.position)
    local = (points - place.getTranslation()) @ place.getRotation() - middle
    beyond = np.maximum(np.abs(local) - shape.half, 0.0)
    lower = np.maximum(lower, np.linalg.norm(beyond, axis=1))
    best: tuple[float, Array, Array] | None = None
    for k in np.argsort(lower):
        if lower[k] >= below:
            break
        there = coal.Transform3s(np.eye(3), points[k])
        contact = narrow.contact((shape.geometry, place, coal.Sphere(0.0), there))
        if not contact.distance > _TOUCHING:  # nor where coal cannot tell: it can, where they are apart
            return 0.0, points[k], points[k]
        if contact.distance < below:
            below = contact.distance
            best = below, contact.point, points[k]
    return best


def _nearest_on_line(points: Array, start: Array, end: Array) -> Array:
    """Return the places on a line of finite length that are nearest to points, (n, 3) [m]."""
    way = end - start
    shares = np.clip((points - start) @ way / max(float(way @ way), 1e-300), 0.0, 1.0)
    return np.asarray(start + shares[:, None] * way)


def _nearest(scan: ScanGeometry, solids: list[Solid], rotations: Array, positions: Array) -> NearestPart:
    """Where solids are nearest to a scan.

    Args:
        scan: the scan.
        solids: the solids, each in the frame of its joint.
        rotations: of these joints, (b, 3, 3).
        positions: of these joints, (b, 3) [m].
    """
    placed = [
        (each, coal.Transform3s(turn @ each.rotation, turn @ each.position + shift))
        for each, turn, shift in zip(solids, rotations, positions, strict=True)
    ]
    return nearest_to_points(scan, placed) if scan.surface is None else nearest_to_surface(scan, placed)


class ScanGap(NamedTuple):
    """Where an arm is nearest to a scan.

    Attributes:
        distance: from the surface of the arm to the nearest point of the scan [m]; 0 where they overlap.
            Infinite if the arm has no body to look at.
        body: name of the body that is nearest; None without a body.
        on_arm: the point of its surface, (3,) [m], world frame; None without a body. Where points of a cloud
            are inside of the body, one of them.
        on_scan: the point of the scan, (3,) [m], world frame; None without a body. Where a surface overlaps
            the body, a point of a triangle that does.
    """

    distance: float
    body: str | None
    on_arm: Array | None
    on_scan: Array | None


class ScanClearance:
    """The distance of an arm from a scan; may be shared between threads.

    An arm remembers it for each scan and radius.

    Distances are exact. Where points or triangles of the scan are in the arm, the distance is 0: how deep
    they are is not computed.

    Attributes:
        bodies: names of the bodies that are looked at, from base to tip.
        excluded_pairs: bodies that are not: those that no joint moves, and those that have a point that
            stands still within `MOUNTED` of the scan, which is what the arm is mounted on.
    """

    def __new__(cls, arm: Arm, scan: Scan, arm_radius: float | None = None) -> ScanClearance:
        """Find or make what tells the distance of an arm from a scan.

        Args:
            arm: the arm.
            scan: the scan.
            arm_radius: radius of capsules that stand in for whatever the arm's description says [m], as in
                `Scene`; if None, that.

        Raises:
            InvalidValue: not an arm, not a scan, or not a radius.
        """
        if not isinstance(arm, Arm):
            raise InvalidValue("arm", arm, "an Arm")
        if not isinstance(scan, Scan):
            raise InvalidValue("scan", scan, "a Scan")
        radius = None if arm_radius is None else length("arm_radius", arm_radius)
        scans: WeakKeyDictionary[Scan, dict[float | None, ScanClearance]]
        scans = arm.cache.setdefault(cls, WeakKeyDictionary())
        made = scans.setdefault(scan, {})
        if radius not in made:
            if len(made) >= MAX_MODELS:
                made.clear()
            made[radius] = super().__new__(cls)
            made[radius]._prepare(arm, scan, radius)
        return made[radius]

    def _prepare(self, arm: Arm, scan: Scan, radius: float | None) -> None:
        # Without the scan itself, which is forgotten with its last user.
        self._space = ConfigurationSpace(arm.model)
        self._kinematics = TreeKinematics(arm.model)
        listed = bodies_of(arm, radius)
        moved = [body for body in listed if body.joint]
        standing = self._standing(scan, arm, moved)
        reasons = {body.name: "no joint moves it" for body in listed if not body.joint}
        reasons |= {moved[k].name: "the arm is mounted on the scan" for k in standing}
        self.excluded_pairs = tuple(ExcludedPair(name, scan.name, why) for name, why in reasons.items())
        left = [body for k, body in enumerate(moved) if k not in standing]
        self.bodies = tuple(body.name for body in left)
        self._joints = [body.joint for body in left]
        self._solids = [solid(body.shape) for body in left]
        self._geometry = scan.geometry

    def minimum(self, q: ArrayLike) -> ScanGap:
        """How far the arm is from the scan at a configuration, and where.

        Args:
            q: configuration, (nq,) [rad or m].

        Raises:
            InvalidValue: q has the wrong size or is not finite.
        """
        placements = self._kinematics.place(self._space.checked(q))
        if not self._solids:
            return ScanGap(np.inf, None, None, None)
        rotations, positions = (each[0, self._joints] for each in placements)
        found = _nearest(self._geometry, self._solids, rotations, positions)
        return ScanGap(found.distance, self.bodies[found.body], found.on_body, found.on_scan)

    def _standing(self, scan: Scan, arm: Arm, bodies: list[Body]) -> set[int]:
        """Indices of the bodies by which the arm is mounted on the scan."""
        ends = np.array([[each.start, each.end] for each in (solid(body.shape) for body in bodies)])
        joints, rng, found = [body.joint for body in bodies], np.random.default_rng(0), []
        if not bodies:
            return set()
        for q in (arm.neutral(), arm.random(rng), arm.random(rng)):
            turns, shifts = (each[0, joints] for each in self._kinematics.place(q))
            found.append(ends @ turns.swapaxes(1, 2) + shifts[:, None])
        still = np.ptp(found, axis=0).max(axis=2) <= _STILL * arm.length  # (bodies, 2)
        mounted = set()
        for body, end in np.argwhere(still):
            shape = solid(bodies[body].shape)
            ball = solid(Sphere((0.0, 0.0, 0.0), shape.radius if shape.round else SMALLEST_LENGTH))
            place = _nearest(scan.geometry, [ball], np.eye(3)[None], found[0][body, end][None])
            if place.distance <= MOUNTED:
                mounted.add(int(body))
        return mounted
