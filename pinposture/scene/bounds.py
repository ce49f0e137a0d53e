"""Lower bounds of the distances of all pairs at once, exact ones where both solids are round.

Each body is inside of a capsule. Against another body, a sphere, a capsule or a cylinder the bound is the
distance of the two capsules; against a box or a mesh that of the capsule's axis from a box; against a
half-space that of the axis's lower end. Balls and capsules are their own capsules: their bounds are exact.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from pinposture import kernels
from pinposture.scene.segments import closest_points
from pinposture.scene.solids import Solid

Array = NDArray[np.float64]
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
