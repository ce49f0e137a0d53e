"""Closed-form kinematics of a module with two crossed hinges (Section 6.1.1).

The module turns by q0 about its y axis, goes l1 along x, turns by q1 about its z axis and goes l2 along
x: the RyRz module of the thesis. Its end lies on a torus around the y axis with radii l1 and l2. RzRy,
and any other pair of perpendicular hinges across the arm, is the same module seen in another frame.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from pinposture import kernels

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Torus:
    """FK, IK and TP of a RyRz module, in the frame at its base (x along the module, y the first hinge).

    Attributes:
        l1: distance between the hinges [m].
        l2: distance from the second hinge to the end [m].
        sense: +1 if the second hinge turns about +z, -1 if about -z.
    """

    l1: float
    l2: float
    sense: float = 1.0
    dof: int = 2

    @property
    def reach(self) -> float:
        """Largest distance of the end from the base [m]."""
        return self.l1 + self.l2

    def forward(self, q: Array) -> tuple[Array, Array]:
        """FK, (6.1) with the sign of (6.1b) put right.

        Args:
            q: hinge angles (2,) [rad].

        Returns:
            Position of the end (3,) [m] and its orientation (3, 3), both in the base frame.
        """
        end = kernels.torus_forward(self.l1, self.l2, self.sense, float(q[0]), float(q[1]))
        return np.array(end[:3]), np.array(end[3:]).reshape(3, 3)

    def inverse(self, p: Array) -> list[Array]:
        """IK, (6.2) for the whole torus: every pair of angles that puts the end at p.

        Args:
            p: a point of the torus, (3,) [m], base frame.

        Returns:
            Hinge angles (2,) [rad], the branch that faces p first. Empty if p is not on the torus.
        """
        out = np.empty((2, 2))
        x, y, z = map(float, p)
        return list(out[: kernels.torus_inverse(self.l1, self.l2, self.sense, x, y, z, out)])

    def faces(self, p: Array) -> bool:
        """True on the outer part of the torus, where the second hinge bends by less than a right angle."""
        x, y, z = map(float, p)
        return bool(kernels.torus_faces(self.l1, self.l2, x, y, z))

    def crossings(self, points: Array) -> Iterator[tuple[int, float]]:
        """TP, (6.13)-(6.15) put right: where a polyline crosses the torus.

        Args:
            points: vertices (n + 1, 3) [m], base frame.

        Yields:
            Segment index i and t in (0, 1] of each crossing points[i] + t (points[i + 1] - points[i]),
            in order along the polyline. The base itself, where the torus touches itself if l1 = l2, is
            not a crossing.
        """
        out = np.empty(4)
        for i, (a, b) in enumerate(pairwise(np.asarray(points, dtype=float).tolist())):
            for t in out[: kernels.torus_crossings(self.l1, self.l2, tuple(a), tuple(b), out)]:
                yield i, float(t)
