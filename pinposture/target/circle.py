"""Closed-form kinematics of a module with one hinge, which moves in a plane (Section 4.6)."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from math import atan2, cos, sin

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Circle:
    """FK, IK and TP of a 1-DOF module, in the frame at its base (x along the module, y the hinge).

    Attributes:
        link: distance from the hinge to the end [m].
    """

    link: float
    dof: int = 1

    @property
    def reach(self) -> float:
        """Distance of the end from the base [m]."""
        return self.link

    def forward(self, q: Array) -> tuple[Array, Array]:
        """FK: position (3,) [m] and orientation (3, 3) of the end at the hinge angle q, (1,) [rad]."""
        c, s = cos(q[0]), sin(q[0])
        return np.array([self.link * c, 0.0, -self.link * s]), np.array([[c, 0, s], [0, 1.0, 0], [-s, 0, c]])

    def inverse(self, p: Array) -> list[Array]:
        """IK: the hinge angle (1,) [rad] that puts the end at p, (3,) [m]; empty if p is off the circle."""
        q = np.array([atan2(-p[2], p[0])])
        return [q] if np.abs(self.forward(q)[0] - p).max() < 1e-6 * self.link else []

    def faces(self, p: Array) -> bool:
        """Always True: the circle has no inner part."""
        return True

    def crossings(self, points: Array) -> Iterator[tuple[int, float]]:
        """TP: where a polyline leaves or enters the circle.

        Args:
            points: vertices (n + 1, 3) [m], base frame.

        Yields:
            Segment index i and t in (0, 1] of each crossing of the sphere around the base, in order. The
            crossing is on the circle if the polyline lies in the plane of the module; `inverse` tells.
        """
        a, d = points[:-1], np.diff(points, axis=0)
        aa, ad, dd = (np.einsum("ij,ij->i", u, v) for u, v in ((a, a), (a, d), (d, d)))
        with np.errstate(divide="ignore", invalid="ignore"):
            half = np.sqrt(ad**2 - dd * (aa - self.link**2))
            roots = np.stack([(-ad - half) / dd, (-ad + half) / dd])
        for i in np.flatnonzero(np.any((roots > 0.0) & (roots <= 1.0 + 1e-9), axis=0)):
            for t in roots[:, i]:
                if 1e-9 < t <= 1.0 + 1e-9:
                    yield int(i), min(float(t), 1.0)
