"""Distance of an arm from a scan: by coal from surfaces, by a k-d tree from point clouds."""

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
from pinposture.collision.model import MAX_MODELS, ExcludedPair, stationary_ends
from pinposture.collision.obstacles import Solid, Sphere, solid
from pinposture.collision.scan import Scan, ScanGeometry
from pinposture.errors import InvalidValue

Array = NDArray[np.float64]

PosedSolids: TypeAlias = list[tuple[Solid, coal.Transform3s]]
"""Solids, each with the placement of its shape in the world."""

Nearest: TypeAlias = tuple[float, int, Array, Array]
"""Distance [m], 0 if they overlap, index of the solid, and the nearest points of solid and scan, (3,) [m]."""

MOUNT_DISTANCE = 0.01
"""Distance from a stationary point of the arm at which it counts as mounted on a scan [m]."""

_MAX_BALLS = 16  # largest number of balls that cover a body
_TOUCHING = 1e-12  # distance below which a body touches a scan [m]


def _nearest_to_surface(scan: ScanGeometry, solids: PosedSolids) -> Nearest:
    """Return where solids, at least one, are nearest to a scan with triangles."""
    request, result, origin = coal.DistanceRequest(), coal.DistanceResult(), coal.Transform3s()
    request.gjk_tolerance = 1e-9
    request.enable_signed_distance = False
    centers = np.array([pose.getTranslation() for _, pose in solids])
    best: Nearest = np.inf, 0, np.zeros(3), np.zeros(3)
    # The result of one solid bounds the search of the next: it is not cleared in between.
    for index in map(int, np.argsort(scan.tree.query(centers)[0])):
        shape, pose = solids[index]
        coal.distance(shape.geometry, pose, scan.surface, origin, request, result)
        if result.min_distance <= _TOUCHING:
            collision = coal.CollisionResult()
            coal.collide(shape.geometry, pose, scan.surface, origin, coal.CollisionRequest(), collision)
            found = collision.getContacts()[0] if collision.isCollision() else result
            return 0.0, index, np.array(found.getNearestPoint1()), np.array(found.getNearestPoint2())
        if result.min_distance < best[0]:
            points = np.array(result.getNearestPoint1()), np.array(result.getNearestPoint2())
            best = float(result.min_distance), index, *points
    return best


def _nearest_to_points(scan: ScanGeometry, solids: PosedSolids) -> Nearest:
    """Return where solids, at least one, are nearest to a scan without triangles.

    Balls along its axis cover each solid; the k-d tree gives the points that may be nearest to each ball.
    """
    narrow = Narrow()
    centers, radii, owners, axes = [], [], [], []
    for index, (shape, pose) in enumerate(solids):
        turn = pose.getRotation() @ shape.rotation.T
        shift = pose.getTranslation() - turn @ shape.position
        start, end = turn @ shape.start + shift, turn @ shape.end + shift
        span = float(np.linalg.norm(end - start))
        count = int(np.clip(np.ceil(span / (2.0 * shape.radius)), 1, _MAX_BALLS))
        shares = (np.arange(count) + 0.5) / count
        centers.append(start + shares[:, None] * (end - start))
        radii.append(np.full(count, shape.radius + span / (2.0 * count)))
        owners.append(np.full(count, index))
        axes.append((start, end))
    center, radius, owner = np.concatenate(centers), np.concatenate(radii), np.concatenate(owners)
    distances, first = scan.tree.query(center)
    lower = distances - radius
    best: Nearest = np.inf, 0, np.zeros(3), np.zeros(3)
    for ball in np.argsort(lower):
        if lower[ball] >= best[0]:
            break
        index = int(owner[ball])
        shape, pose = solids[index]
        given = shape, pose, axes[index], narrow
        # The point nearest to the centre of the ball bounds the distance of the others.
        found = _nearest_point(scan.points[first[ball : ball + 1]], *given, best[0])
        best = best if found is None else (found[0], index, *found[1:])
        around = scan.tree.query_ball_point(center[ball], best[0] + radius[ball] + _TOUCHING)
        found = _nearest_point(scan.points[around], *given, best[0])
        best = best if found is None else (found[0], index, *found[1:])
        if best[0] <= 0.0:
            break
    return best


def _nearest_point(
    points: Array,
    shape: Solid,
    pose: coal.Transform3s,
    axis: tuple[Array, Array],
    narrow: Narrow,
    below: float,
) -> tuple[float, Array, Array] | None:
    """Return distance, point of the solid and point of the scan for the nearest of points (n, 3) to a solid.

    The axis is that of the capsule around the solid; all is in the world frame. None if no point is nearer
    than `below`.
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
    # The bounding box has the axes of the shape.
    middle = shape.rotation.T @ (shape.center - shape.position)
    local = (points - pose.getTranslation()) @ pose.getRotation() - middle
    beyond = np.maximum(np.abs(local) - shape.half, 0.0)
    lower = np.maximum(lower, np.linalg.norm(beyond, axis=1))
    best: tuple[float, Array, Array] | None = None
    for k in np.argsort(lower):
        if lower[k] >= below:
            break
        at_point = coal.Transform3s(np.eye(3), points[k])
        contact = narrow.contact((shape.geometry, pose, coal.Sphere(0.0), at_point))
        if not contact.distance > _TOUCHING:  # or NaN: coal only fails where they overlap
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


def _nearest(scan: ScanGeometry, solids: list[Solid], rotations: Array, positions: Array) -> Nearest:
    """Return where solids are nearest to a scan, given the placements (b, 3, 3), (b, 3) of their joints."""
    posed = [
        (each, coal.Transform3s(turn @ each.rotation, turn @ each.position + shift))
        for each, turn, shift in zip(solids, rotations, positions, strict=True)
    ]
    return _nearest_to_points(scan, posed) if scan.surface is None else _nearest_to_surface(scan, posed)


class ScanGap(NamedTuple):
    """The smallest distance of an arm from a scan.

    Attributes:
        distance: from the surface of the arm to the nearest point of the scan [m]; 0 where they overlap.
            Infinite if no body is checked.
        body: name of the nearest body; None without a body.
        on_arm: the nearest point of its surface, (3,) [m], world frame; None without a body. If points of a
            cloud are inside the body, one of them.
        on_scan: the nearest point of the scan, (3,) [m], world frame; None without a body. If a surface
            overlaps the body, a point of an overlapping triangle.
    """

    distance: float
    body: str | None
    on_arm: Array | None
    on_scan: Array | None


class ScanClearance:
    """The distance of an arm from a scan; may be shared between threads.

    An arm remembers it for each scan and radius. Distances are exact, and 0 if points or triangles of the
    scan are inside the arm: the depth is not computed.

    Attributes:
        bodies: names of the bodies that are checked, from base to tip.
        excluded_pairs: bodies that are not: those that no joint moves, and those with a stationary point
            within 1 cm of the scan, on which the arm is mounted.
    """

    def __new__(cls, arm: Arm, scan: Scan, arm_radius: float | None = None) -> ScanClearance:
        """Return the clearance of an arm and a scan, made on first use.

        Args:
            arm: the arm.
            scan: the scan.
            arm_radius: radius of stand-in capsules [m], as in `Scene`.

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
        # The scan itself is not referenced: the weak keys of the cache would keep it alive.
        self._space, self._kinematics = ConfigurationSpace(arm.model), TreeKinematics(arm.model)
        bodies = bodies_of(arm, radius)
        moved = [body for body in bodies if body.joint]
        mounted = self._mounted(scan.geometry, arm, moved)
        reasons = {body.name: "no joint moves it" for body in bodies if not body.joint}
        reasons |= {moved[k].name: "the arm is mounted on the scan" for k in mounted}
        self.excluded_pairs = tuple(ExcludedPair(name, scan.name, why) for name, why in reasons.items())
        checked = [body for k, body in enumerate(moved) if k not in mounted]
        self.bodies = tuple(body.name for body in checked)
        self._joints = [body.joint for body in checked]
        self._solids = [solid(body.shape) for body in checked]
        self._geometry = scan.geometry

    def minimum(self, q: ArrayLike) -> ScanGap:
        """Return the smallest distance at a configuration.

        Args:
            q: configuration, (nq,) [rad or m].

        Raises:
            InvalidValue: q has the wrong size or is not finite.
        """
        placements = self._kinematics.place(self._space.checked(q))
        if not self._solids:
            return ScanGap(np.inf, None, None, None)
        rotations, positions = (each[0, self._joints] for each in placements)
        distance, index, on_arm, on_scan = _nearest(self._geometry, self._solids, rotations, positions)
        return ScanGap(distance, self.bodies[index], on_arm, on_scan)

    def _mounted(self, scan: ScanGeometry, arm: Arm, bodies: list[Body]) -> set[int]:
        """Return the indices of the bodies by which the arm is mounted on the scan."""
        solids = [solid(body.shape) for body in bodies]
        mounted = set()
        for index, position in stationary_ends(arm, self._kinematics, bodies, solids) if bodies else ():
            radius = solids[index].radius if solids[index].round else SMALLEST_LENGTH
            ball = solid(Sphere((0.0, 0.0, 0.0), radius))
            if _nearest(scan, [ball], np.eye(3)[None], position[None])[0] <= MOUNT_DISTANCE:
                mounted.add(index)
        return mounted
