"""How fast a path can be gone along where acceleration is limited.

A place s on the path moves by v places per step. Joints then move by x' v per step, and change that by about
x'' v^2 + x' a from one step to the next, a being the change of v. With b the largest step and A the largest
change of it, of which a share is left to corrections, every joint asks for

    v <= b / |x'|,    v^2 <= A / |x''|,    |a| <= (A - |x''| v^2) / |x'|.

Whoever slows down in time for the end, and for every place that is slow, also has v^2 <= v_next^2 + 2 |a|
from one waypoint to the next. Between two waypoints the curve is taken to be as steep and as bent as at
either of them, at most.
"""

from __future__ import annotations

from math import inf

import numpy as np
from numpy.typing import NDArray

from pinposture import kernels
from pinposture.control.constrained.path import JointPath

Array = NDArray[np.float64]

SPEED, PLANNED, TIMED = 0.95, 0.7, 0.9
"""Shares of the speed limit, and of the acceleration limit on ways of the controller's own and on those that
are given with their time, that are planned with; the rest is for corrections."""

CURVED = 0.8
"""Share of that, at most, for curves; the rest is always left for slowing down."""

SMALL = 1e-12
"""Slope of a path that is none, relative to the largest."""


class Pace:
    """The pace along a path, at its waypoints.

    Args:
        path: the path.
        bound: largest |dq| of each joint, (nv,) [rad or m]; may be infinite.
        brake: the most that dq may differ from that of the step before, (nv,) [rad or m]; None: any.
        most: the most waypoints to go in one step; infinite, or at least that many as time asks for.
        begin: waypoints that the step before went, if the arm is under way.

    Attributes:
        top: the fastest pace at each waypoint, (N + 1,) [waypoints per step].
    """

    def __init__(
        self, path: JointPath, bound: Array, brake: Array | None, most: float = inf, begin: float = 0.0
    ) -> None:
        shape = path.offsets.shape
        self._brake = np.full(shape[1], np.inf) if brake is None else np.array(brake)
        self._planned = PLANNED if most == inf else TIMED
        self._slope, self._bend = np.empty(shape), np.empty(shape)
        self._cap, self.top = np.empty(shape[0]), np.empty(shape[0])
        shares, into = (SPEED, self._planned, CURVED, SMALL), (self._slope, self._bend, self._cap, self.top)
        kernels.find_pace(path.offsets, np.array(bound), self._brake, begin, most, *shares, *into)

    def next(self, place: float, pace: float) -> float:
        """Places to go in this step, after `pace` places in the step before."""
        given = self._slope, self._bend, self._cap, self.top, self._brake
        return kernels.next_pace(place, pace, *given, self._planned, CURVED)
