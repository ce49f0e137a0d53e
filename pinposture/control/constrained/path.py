"""A way through joint space, and how far along it a step may go."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from pinposture.arm import Arm

Array = NDArray[np.float64]


class Ahead(NamedTuple):
    """A place on a path that can be reached in one step.

    Attributes:
        place: where, as a number of waypoints from the start, in [0, N].
        dq: displacement to it, (nv,) [rad or m].
    """

    place: float
    dq: Array


class JointPath:
    """Waypoints joined by straight lines through joint space.

    Attributes:
        arm: the arm.
        start: configuration at which it begins, (nq,).
        offsets: displacement of each waypoint from the start, (N + 1, nv) [rad or m]; the first is zero.
        slopes: how the displacement changes there from one waypoint to the next, (N + 1, nv) [rad or m].
    """

    def __init__(self, arm: Arm, start: Array, offsets: Array) -> None:
        self.arm, self.start, self.offsets = arm, start, offsets
        self.slopes = np.gradient(offsets, axis=0)

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

    def offset_of(self, q: Array, place: float) -> Array:
        """Displacement (nv,) from the start to a configuration near a place, the way round that it took."""
        here = self.offset(place)
        return np.asarray(here + self.arm.difference(self.arm.integrate(self.start, here), q))

    def ahead(self, offset: Array, place: float, bound: Array) -> Ahead:
        """The farthest place, going on from a place without a gap, that one step can reach.

        Args:
            offset: where the arm is, as a displacement from the start, (nv,) [rad or m].
            place: where it is on the path, or was last.
            bound: largest displacement of each joint, (nv,) [rad or m].

        Returns:
            That place. It is `place` itself if the bound does not admit more, and then `dq` may exceed it.
        """
        last = len(self.offsets) - 1
        while place < last:
            i = min(int(place), last - 1)
            begin = self.offset(place) - offset
            reach = _largest_share(begin, self.offsets[i + 1] - offset, bound)
            place = i + 1.0 if reach >= 1.0 else place + reach * (i + 1.0 - place)
            if reach < 1.0:
                break
        return Ahead(place, self.offset(place) - offset)


def _largest_share(begin: Array, end: Array, bound: Array) -> float:
    """The largest share t in [0, 1] with |begin + t (end - begin)| <= bound, going up from t = 0."""
    if np.any(np.abs(begin) > bound):
        return 0.0
    way = end - begin
    room = np.where(way > 0.0, bound - begin, bound + begin)
    moving = way != 0.0
    return float(min(1.0, np.min(room[moving] / np.abs(way[moving]), initial=1.0)))
