"""Closed-form kinematics of a module with two crossed hinges (Section 6.1.1).

The module turns by q0 about its y axis, goes l1 along x, turns by q1 about its z axis and goes l2 along
x: the RyRz module of the thesis. Its end lies on a torus around the y axis with radii l1 and l2. RzRy,
and any other pair of perpendicular hinges across the arm, is the same module seen in another frame.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from math import atan2, cos, hypot, pi, sin

import numpy as np
from numpy.polynomial import polynomial
from numpy.typing import NDArray

Array = NDArray[np.float64]

# From the coefficients of a quartic in powers of t to its Bernstein coefficients on [0, 1].
_TO_BERNSTEIN = np.array(
    [
        [1.0, 0.0, 0.0, 0.0, 0.0],
        [1.0, 1 / 4, 0.0, 0.0, 0.0],
        [1.0, 1 / 2, 1 / 6, 0.0, 0.0],
        [1.0, 3 / 4, 1 / 2, 1 / 4, 0.0],
        [1.0, 1.0, 1.0, 1.0, 1.0],
    ]
)


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
        c0, s0 = cos(q[0]), sin(q[0])
        c1, s1 = cos(self.sense * q[1]), sin(self.sense * q[1])
        radius = self.l1 + self.l2 * c1
        position = np.array([c0 * radius, self.l2 * s1, -s0 * radius])
        turn = np.array([[c0 * c1, -c0 * s1, s0], [s1, c1, 0.0], [-s0 * c1, s0 * s1, c0]])
        return position, turn

    def inverse(self, p: Array) -> list[Array]:
        """IK, (6.2) for the whole torus: every pair of angles that puts the end at p.

        Args:
            p: a point of the torus, (3,) [m], base frame.

        Returns:
            Hinge angles (2,) [rad], the branch that faces p first. Empty if p is not on the torus.
        """
        radius = hypot(p[0], p[2])
        q0 = atan2(-p[2], p[0]) if radius > 1e-12 * self.reach else 0.0
        facing = np.array([q0, self.sense * atan2(p[1], radius - self.l1)])
        averted = np.array([q0 - pi if q0 > 0 else q0 + pi, self.sense * atan2(p[1], -radius - self.l1)])
        return [q for q in (facing, averted) if np.abs(self.forward(q)[0] - p).max() < 1e-7 * self.reach]

    def faces(self, p: Array) -> bool:
        """True on the outer part of the torus, where the second hinge bends by less than a right angle."""
        return bool(p @ p > (self.l1**2 + self.l2**2) * (1.0 - 1e-12))

    def crossings(self, points: Array) -> Iterator[tuple[int, float]]:
        """TP, (6.13)-(6.15) put right: where a polyline crosses the torus.

        Args:
            points: vertices (n + 1, 3) [m], base frame.

        Yields:
            Segment index i and t in (0, 1] of each crossing points[i] + t (points[i + 1] - points[i]),
            in order along the polyline. The base itself, where the torus touches itself if l1 = l2, is
            not a crossing.
        """
        a, d = points[:-1], np.diff(points, axis=0)
        quartics = self._quartics(a, d)
        bernstein = quartics @ _TO_BERNSTEIN.T
        # A quartic whose Bernstein coefficients have one sign has no root in [0, 1].
        slack = 1e-12 * np.abs(quartics).max(axis=1, initial=0.0)
        candidates = np.flatnonzero((bernstein.min(axis=1) <= slack) & (bernstein.max(axis=1) >= -slack))
        for i in candidates:
            if not np.any(quartics[i]):
                continue
            roots = polynomial.polyroots(np.trim_zeros(quartics[i], "b"))
            for t in sorted(float(root.real) for root in roots if abs(root.imag) < 1e-7):
                end = a[i] + min(t, 1.0) * d[i]
                if 1e-9 < t <= 1.0 + 1e-9 and end @ end > (1e-6 * self.reach) ** 2:
                    yield int(i), min(t, 1.0)

    def _quartics(self, a: Array, d: Array) -> Array:
        """Coefficients (n, 5), constant first, of the implicit torus along each segment a + t d."""
        aa, ad, dd = (np.einsum("ij,ij->i", u, v) for u, v in ((a, a), (a, d), (d, d)))
        off = aa - (self.l1**2 + self.l2**2)
        hinge = 4.0 * self.l1**2
        return np.column_stack(
            [
                off**2 - hinge * (self.l2**2 - a[:, 1] ** 2),
                4.0 * ad * off + 2.0 * hinge * a[:, 1] * d[:, 1],
                2.0 * off * dd + 4.0 * ad**2 + hinge * d[:, 1] ** 2,
                4.0 * ad * dd,
                dd**2,
            ]
        )
