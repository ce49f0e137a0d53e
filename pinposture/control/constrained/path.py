"""A way through joint space, and how far along it a step may go."""

from __future__ import annotations

from functools import cached_property
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from pinposture import kernels
from pinposture.arm import Arm, ArmState

Array = NDArray[np.float64]
Whole = NDArray[np.int64]


FARTHEST = 10.0
"""Largest joint motion of a step where limits allow any, in `Arm.joint_units`."""


class Stride(NamedTuple):
    """A step along a path.

    Attributes:
        place: where it leads, as a number of waypoints from the start, in [0, N]; no farther than before if
            the limits do not admit more.
        left: largest joint motion left from where it begins to the end of the path, in `Arm.joint_units`.
        inside: whether it is within its limits.
        dq: the step, (nv,) [rad or m].
    """

    place: float
    left: float
    inside: bool
    dq: Array


class JointPath:
    """Waypoints joined by straight lines through joint space.

    Attributes:
        arm: the arm.
        start: configuration at which it begins, (nq,).
        positions: joint positions there, (nv,) [rad or m].
        offsets: displacement of each waypoint from the start, (N + 1, nv) [rad or m]; the first is zero.
    """

    def __init__(self, arm: Arm, start: Array, offsets: Array) -> None:
        self.arm, self.start, self.offsets = arm, start, np.ascontiguousarray(offsets)
        self.positions = arm.positions(start)

    @cached_property
    def slopes(self) -> Array:
        """How the displacement changes at each waypoint from one to the next, (N + 1, nv) [rad or m]."""
        return np.asarray(np.gradient(self.offsets, axis=0))

    @property
    def end(self) -> float:
        """The last place, which is the number of straight pieces N."""
        return float(len(self.offsets) - 1)

    def _at(self, values: Array, place: float) -> Array:
        i = min(int(place), len(values) - 2)
        share = place - i
        return np.asarray((1.0 - share) * values[i] + share * values[i + 1])

    def offset(self, place: float) -> Array:
        """Displacement from the start at a place, (nv,) [rad or m]."""
        return self._at(self.offsets, place)

    def smooth(self, place: float) -> Array:
        """The same on a curve through the waypoints, (nv,): cubic between two of them, without corners."""
        i = min(int(place), len(self.offsets) - 2)
        t = place - i
        before, after = (1.0 + 2.0 * t) * (1.0 - t) ** 2, t * t * (3.0 - 2.0 * t)
        here = before * self.offsets[i] + after * self.offsets[i + 1]
        return np.asarray(here + t * (1.0 - t) * ((1.0 - t) * self.slopes[i] - t * self.slopes[i + 1]))

    def configuration(self, place: float) -> Array:
        """Configuration at a place, (nq,)."""
        return self.arm.integrate(self.start, self.offset(place))

    def offset_of(self, state: ArmState, place: float) -> Array:
        """Displacement (nv,) from the start to a state near a place, the way round that it took."""
        here = self.offset(place)
        way = self.arm.integrate(self.start, here)
        return np.asarray(here + self.arm.difference(way, state.q))

    def bent(self, place: float, change: Array, edges: Array) -> JointPath:
        """The path with another end, bent more and more from a place on.

        Args:
            place: where bending begins, as a number of waypoints from the start.
            change: displacement of the end, (nv,) [rad or m].
            edges: joint positions to stay between, (2, nv) [rad or m].
        """
        shares = np.arange(len(self.offsets)) - place
        shares = np.maximum(shares / max(shares[-1], 1e-9), 0.0)
        offsets = self.offsets + shares[:, None] * change
        lowest, highest = edges - self.positions
        lowest, highest = np.minimum(lowest, 0.0), np.maximum(highest, 0.0)
        return JointPath(self.arm, self.start, np.minimum(np.maximum(offsets, lowest), highest))

    def stride(self, state: ArmState, place: float, columns: Whole, units: Array, sides: Array) -> Stride:
        """The step to the farthest place, going on from a place without a gap, that limits admit.

        Such steps come to the end, however long the way and however different the joints. Measure what is
        left of the way piece by piece, each in steps of its slowest joint: L = sum over pieces of
        max_j |dq_j| / b_j, with b_j the largest step of joint j, at most `FARTHEST`. A step that does not end
        at the end is as long as b_j for some joint j. That joint goes no farther in it than the pieces of the
        way that the step passes add up to, so L falls by 1 at least, and ceil(L) steps are enough.

        Args:
            state: where the arm is.
            place: where it is on the path, or was last.
            columns: the degrees of freedom that move on the path, (n,).
            units: the motion of each of them that counts as one, (n,) [rad or m].
            sides: smallest and largest step, (2, nv) [rad or m].
        """
        dq = np.zeros(self.arm.nv)
        positions, endless = state.placed.positions, self.arm.kinematics.endless
        given = self.offsets, self.positions, positions, endless, columns, units, place, sides, FARTHEST
        place, left, inside = kernels.step_along(*given, dq)
        return Stride(place, left, inside, dq)
