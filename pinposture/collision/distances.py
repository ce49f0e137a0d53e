"""PairDistances between solids: bounds of all pairs at once, exact distances of those that may be nearest."""

from __future__ import annotations

import math
import threading
from collections.abc import Sequence
from typing import NamedTuple, TypeAlias

import coal
import numpy as np
from numpy.typing import NDArray

from pinposture import kernels
from pinposture.collision.obstacles import Solid

# PairDistances between straight lines of finite length, many at a time.

Array = NDArray[np.float64]

_PARALLEL = 1e-14
"""Square of the sine of the angle below which lines count as parallel; the distance does not notice."""
_TINY = 1e-300


class ClosestPoints(NamedTuple):
    """Where lines come nearest to each other.

    Attributes:
        first: the point of the first line, (..., 3) [m].
        second: the point of the second line, (..., 3) [m].
    """

    first: Array
    second: Array


def closest_points(a: Array, b: Array, c: Array, d: Array) -> ClosestPoints:
    """The nearest points of the lines from a to b and from c to d; a line may be a single point.

    Args:
        a: ends of the first lines, (..., 3) [m].
        b: their other ends, (..., 3) [m].
        c: ends of the second lines, (..., 3) [m].
        d: their other ends, (..., 3) [m].
    """
    u, v, r = b - a, d - c, a - c
    uu, vv, uv = _dot(u, u), _dot(v, v), _dot(u, v)
    ur, vr = _dot(u, r), _dot(v, r)
    across = uu * vv - uv * uv
    skew = across > _PARALLEL * uu * vv
    # On the line without ends, then the other within its ends, then the first again within its own: exact,
    # because the region of admissible pairs is a rectangle and the distance is convex on it.
    s = np.clip(np.where(skew, (uv * vr - vv * ur) / np.where(skew, across, 1.0), 0.0), 0.0, 1.0)
    t = np.clip((uv * s + vr) / np.maximum(vv, _TINY), 0.0, 1.0)
    s = np.clip((uv * t - ur) / np.maximum(uu, _TINY), 0.0, 1.0)
    return ClosestPoints(a + s[..., None] * u, c + t[..., None] * v)


def _dot(x: Array, y: Array) -> Array:
    return np.asarray(np.einsum("...i,...i->...", x, y))


# Lower bounds of the distances of all pairs at once, exact ones where both solids are round.
#
# Each body is inside of a capsule. Against another body, a sphere, a capsule or a cylinder the bound is the
# distance of the two capsules; against a box or a mesh that of the capsule's axis from a box; against a
# half-space that of the axis's lower end. Balls and capsules are their own capsules: their bounds are exact.

Indices = NDArray[np.intp]


_KINDS = ("capsule", "box", "plane")


class Contacts(NamedTuple):
    """How round pairs stand to each other.

    Attributes:
        normals: unit vectors from the second solid to the first, (k, 3); zero where the axes meet.
        points: of the first solid, nearest to the second or deepest in it, (k, 3) [m].
    """

    normals: Array
    points: Array


class Bounds:
    """Bounds for a list of pairs.

    Attributes:
        first: index of the body of each pair, (n,).
        second: index of the other body, or the number of bodies plus that of the obstacle, (n,).
        exact: True where the bound is the distance, (n,).
    """

    def __init__(
        self,
        bodies: Sequence[Solid],
        joints: Sequence[int],
        fixed: Sequence[Solid],
        pairs: Sequence[tuple[int, int]],
    ) -> None:
        """Sort the pairs by how they are bounded.

        Args:
            bodies: the bodies, each in the frame of its joint.
            joints: the joints that carry them.
            fixed: the obstacles, world frame.
            pairs: body and body, or body and number of bodies plus obstacle.
        """
        self._joints = np.array(joints, dtype=np.intp)
        count = len(bodies)

        def kind(pair: tuple[int, int]) -> int:
            return 0 if pair[1] < count else _KINDS.index(fixed[pair[1] - count].bound)

        ordered = sorted(pairs, key=kind)
        kinds = [kind(pair) for pair in ordered]
        self.first: Indices = np.array([pair[0] for pair in ordered], dtype=np.intp)
        self.second: Indices = np.array([pair[1] for pair in ordered], dtype=np.intp)
        self._lines = slice(0, kinds.count(0))
        self._boxes = slice(kinds.count(0), kinds.count(0) + kinds.count(1))
        self._planes = slice(kinds.count(0) + kinds.count(1), len(kinds))
        solids = [*bodies, *fixed]
        self._ends = np.array([[each.start, each.end] for each in bodies]).reshape(count, 2, 3)
        self._fixed = np.array([[each.start, each.end] for each in fixed]).reshape(len(fixed), 2, 3)
        radii = np.array([each.radius for each in solids])
        self._own_radii = radii[self.first]
        self._radii = self._own_radii + np.where(np.isfinite(radii[self.second]), radii[self.second], 0.0)
        round_ = np.array([each.round for each in solids], dtype=np.bool_)
        planar = np.arange(len(ordered)) >= self._planes.start
        self.exact = round_[self.first] & (round_[self.second] | planar)
        boxes = [fixed[k - count] for k in self.second[self._boxes]]
        self._axes = np.array([box.rotation for box in boxes]).reshape(-1, 3, 3)
        self._centers = np.array([box.center for box in boxes]).reshape(-1, 3)
        self._halves = np.array([box.half for box in boxes]).reshape(-1, 3)
        lengths = np.linalg.norm(self._ends[:, 1] - self._ends[:, 0], axis=1)
        self._quarters = lengths[self.first[self._boxes]] / 4.0
        planes = [fixed[k - count] for k in self.second[self._planes]]
        self._normals = np.array([plane.rotation[:, 2] for plane in planes]).reshape(-1, 3)
        feet = np.array([plane.center for plane in planes]).reshape(-1, 3)
        self._offsets = np.einsum("ni,ni->n", self._normals, feet)

    def ends(self, rotations: Array, positions: Array) -> Array:
        """Ends of the axes of all bodies, then of all obstacles, (..., count, 2, 3) [m], world frame.

        Args:
            rotations: of the joints, (..., njoints, 3, 3).
            positions: of the joints, (..., njoints, 3) [m].
        """
        turns, shifts = rotations[..., self._joints, :, :], positions[..., self._joints, None, :]
        moved = self._ends @ np.swapaxes(turns, -1, -2) + shifts
        still = np.broadcast_to(self._fixed, (*moved.shape[:-3], *self._fixed.shape))
        return np.concatenate([moved, still], axis=-3)

    def lower(self, ends: Array) -> Array:
        """Lower bounds of the distances of all pairs, (..., n) [m]; exact where `exact` says so."""
        lines, second = ends[..., self.first[self._lines], :, :], ends[..., self.second[self._lines], :, :]
        near = closest_points(lines[..., 0, :], lines[..., 1, :], second[..., 0, :], second[..., 1, :])
        parts = [np.linalg.norm(near.first - near.second, axis=-1)]
        if len(self._centers):
            parts.append(self._above_boxes(ends))
        if len(self._offsets):
            lines = ends[..., self.first[self._planes], :, :]
            heights = np.einsum("...nei,ni->...ne", lines, self._normals)
            parts.append(heights.min(axis=-1) - self._offsets)
        return np.asarray(np.concatenate(parts, axis=-1) - self._radii)

    def contacts(self, ends: Array, chosen: Indices) -> Contacts:
        """Normals and points of exact pairs.

        Args:
            ends: as `ends` gives them, of one configuration.
            chosen: indices of pairs, (k,).
        """
        first, second = ends[self.first[chosen]], ends[self.second[chosen]]
        near = closest_points(first[:, 0], first[:, 1], second[:, 0], second[:, 1])
        gaps = near.first - near.second
        sizes = np.linalg.norm(gaps, axis=1)
        # Where the axes meet there is no direction from one to the other: whoever asks has to find one.
        meet = sizes <= 1e-9 * self._radii[chosen]
        normals = np.where(meet[:, None], 0.0, gaps / np.where(meet, 1.0, sizes)[:, None])
        points = near.first
        for k in np.flatnonzero(chosen >= self._planes.start):
            plane = chosen[k] - self._planes.start
            heights = first[k] @ self._normals[plane]
            points[k], normals[k] = first[k, np.argmin(heights)], self._normals[plane]
        points = points - normals * self._own_radii[chosen, None]
        return Contacts(normals, points)

    def _above_boxes(self, ends: Array) -> Array:
        """Lower bound of the distance of lines from boxes, which changes along a line no faster than it."""
        first = self.first[self._boxes]
        lower = np.empty((*ends.shape[:-3], len(first)))
        flat, into = np.ascontiguousarray(ends.reshape(-1, *ends.shape[-3:])), lower.reshape(-1, len(first))
        kernels.above_boxes(flat, first, self._centers, self._axes, self._halves, self._quarters, into)
        return lower


# The distance of two solids by coal, with a normal that can always be used.

Posed: TypeAlias = tuple[coal.CollisionGeometry, coal.Transform3s, coal.CollisionGeometry, coal.Transform3s]
"""Two solids, each with its placement."""
_SOUND = 1e100
"""A distance this large is none [m]."""


class Contact(NamedTuple):
    """How two solids stand to each other.

    Attributes:
        distance: between their surfaces, negative where they overlap [m].
        normal: unit vector from the second solid to the first, (3,); zero where coal has none.
        point: of the first solid, nearest to the second or deepest in it, (3,) [m].
    """

    distance: float
    normal: Array
    point: Array


class Narrow(threading.local):
    """What coal writes into, one for each thread."""

    def __init__(self) -> None:
        self._result = coal.DistanceResult()
        # By default distances are wrong by up to a micrometre for a metre, which shows in a derivative. The
        # search in penetration must not be asked for more: it then fails, and calls the distance 1.8e308.
        self._requests = [coal.DistanceRequest(), coal.DistanceRequest()]
        self._requests[0].gjk_tolerance = 1e-9
        self._requests[1].epa_tolerance = 1e-4

    def distance(self, posed: Posed) -> float:
        """Distance of two solids, negative where they overlap [m]; not a number if coal cannot tell."""
        for request in self._requests:
            self._result.clear()
            distance = float(coal.distance(*posed, request, self._result))
            if abs(distance) < _SOUND:
                return distance
        return math.nan

    def contact(self, posed: Posed) -> Contact:
        """Distance, normal and point of two solids; the distance is not a number if coal cannot tell."""
        distance = self.distance(posed)
        if math.isnan(distance):
            return Contact(distance, np.zeros(3), np.array(posed[1].getTranslation()))
        away = -np.array(self._result.normal)  # coal's goes from the first to the second
        size = float(np.linalg.norm(away))
        normal = away / size if abs(size - 1.0) < 1e-3 else np.zeros(3)
        return Contact(distance, normal, np.array(self._result.getNearestPoint1()))


# The distances of pairs of solids: bounds of all, exact ones of as few as it takes.

NO_PAIR = -1


class PairDistances:
    """PairDistances of pairs of a body and another, or of a body and an obstacle.

    Attributes:
        first: index of the body of each pair, (n,).
        second: index of the other body, or the number of bodies plus that of the obstacle, (n,).
    """

    def __init__(
        self,
        bodies: Sequence[Solid],
        joints: Sequence[int],
        fixed: Sequence[Solid],
        pairs: Sequence[tuple[int, int]],
    ) -> None:
        """Prepare for pairs; the arguments are those of `Bounds`."""
        self._bounds, self._narrow = Bounds(bodies, joints, fixed, pairs), Narrow()
        self.first, self.second = self._bounds.first, self._bounds.second
        self._solids, self._joints = [*bodies, *fixed], list(joints)
        self._fixed = [coal.Transform3s(each.rotation, each.position) for each in fixed]
        self._exact = np.flatnonzero(self._bounds.exact)
        self._inexact = np.flatnonzero(~self._bounds.exact)

    def near(
        self, turns: Array, shifts: Array, within: float
    ) -> tuple[list[tuple[int, Contact]], tuple[float, int]]:
        """The pairs nearer than a distance, and the nearest of all.

        Args:
            turns: rotations of the joints, (njoints, 3, 3).
            shifts: positions of the joints, (njoints, 3) [m].
            within: how near [m].

        Returns:
            Index and contact of each pair that is near, nearest first; distance and index of the nearest
            pair, near or not: infinity and `NO_PAIR` if there are none.
        """
        ends = self._bounds.ends(turns, shifts)
        lower = self._bounds.lower(ends)
        best, pair = np.inf, NO_PAIR
        found = []
        if len(self._exact):
            pair = int(self._exact[np.argmin(lower[self._exact])])
            best = float(lower[pair])
            chosen = self._exact[lower[self._exact] < within]
            contacts = zip(*self._bounds.contacts(ends, chosen), strict=True)
            found = [
                (int(k), Contact(float(lower[k]), n, p)) for k, (n, p) in zip(chosen, contacts, strict=True)
            ]
        places: dict[tuple[int, int], coal.Transform3s] = {}
        for k in self._inexact[np.argsort(lower[self._inexact])]:
            if lower[k] >= max(within, best):
                break
            contact = self._narrow.contact(self._posed(int(k), turns[None], shifts[None], 0, places))
            if math.isnan(contact.distance):
                contact = contact._replace(distance=float(lower[k]))
            if contact.distance < best:
                best, pair = contact.distance, int(k)
            if contact.distance < within:
                found.append((int(k), contact))
        return sorted(found, key=lambda each: each[1].distance), (best, pair)

    def minimum(self, turns: Array, shifts: Array, below: float = np.inf) -> tuple[float, int]:
        """Distance and index of the nearest pair at any of several configurations.

        Args:
            turns: rotations of the joints, (s, njoints, 3, 3).
            shifts: positions of the joints, (s, njoints, 3) [m].
            below: distances that matter [m]: of larger ones some is found, or none, in less time.

        Returns:
            Infinity and `NO_PAIR` if there are none.
        """
        lower = self._bounds.lower(self._bounds.ends(turns, shifts))  # (s, n)
        best, pair = np.inf, NO_PAIR
        if len(self._exact):
            exact = lower[:, self._exact]
            at = int(np.argmin(exact))
            best, pair = float(exact.flat[at]), int(self._exact[at % exact.shape[1]])
        rest = lower[:, self._inexact].ravel()
        open_ = np.flatnonzero(rest < min(best, below))
        places: dict[tuple[int, int], coal.Transform3s] = {}
        for at in open_[np.argsort(rest[open_])]:
            if rest[at] >= best:
                break
            sample, k = divmod(int(at), len(self._inexact))
            candidate = int(self._inexact[k])
            distance = self._narrow.distance(self._posed(candidate, turns, shifts, sample, places))
            if math.isnan(distance):  # on the safe side
                distance = float(rest[at])
            if distance < best:
                best, pair = distance, candidate
        return best, pair

    def axes(self, pair: int, turns: Array, shifts: Array) -> tuple[Array, Array]:
        """Ends of the axes of the capsules around both solids of a pair, (2, 3) each [m], world frame."""
        ends = self._bounds.ends(turns, shifts)
        return ends[self.first[pair]], ends[self.second[pair]]

    def _posed(
        self,
        pair: int,
        turns: Array,
        shifts: Array,
        sample: int,
        places: dict[tuple[int, int], coal.Transform3s],
    ) -> Posed:
        """Both solids of a pair and where they are; `places` remembers those of bodies."""
        posed = []
        for index in (int(self.first[pair]), int(self.second[pair])):
            each = self._solids[index]
            if index >= len(self._joints):
                place = self._fixed[index - len(self._joints)]
            elif (sample, index) in places:
                place = places[sample, index]
            else:
                turn, shift = turns[sample, self._joints[index]], shifts[sample, self._joints[index]]
                place = coal.Transform3s(turn @ each.rotation, turn @ each.position + shift)
                places[sample, index] = place
            posed += [each.geometry, place]
        return posed[0], posed[1], posed[2], posed[3]
