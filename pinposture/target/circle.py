"""Closed-form kinematics of a module with one hinge, which moves in a plane (Section 4.6)."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from pinposture import kernels

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
        end = kernels.circle_forward(self.link, float(q[0]))
        return np.array(end[:3]), np.array(end[3:]).reshape(3, 3)

    def inverse(self, p: Array) -> list[Array]:
        """IK: the hinge angle (1,) [rad] that puts the end at p, (3,) [m]; empty if p is off the circle."""
        out = np.empty((2, 2))
        x, y, z = map(float, p)
        return list(out[: kernels.circle_inverse(self.link, x, y, z, out), :1])

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
        out = np.empty(4)
        for i, (a, b) in enumerate(pairwise(np.asarray(points, dtype=float).tolist())):
            for t in out[: kernels.circle_crossings(self.link, tuple(a), tuple(b), out)]:
                yield i, float(t)
