"""How fast a path can be gone along where acceleration is limited.

A place s on the path moves by v places per step. Joints then move by x' v per step, and change that by about
x'' v^2 + x' a from one step to the next, a being the change of v. With b the largest step and A the largest
change of it, of which a share is left to corrections, every joint asks for

    v <= b / |x'|,    v^2 <= A / |x''|,    |a| <= (A - |x''| v^2) / |x'|.

Whoever slows down in time for the end, and for every place that is slow, also has v^2 <= v_next^2 + 2 |a|
from one waypoint to the next.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from pinposture.control.constrained.path import JointPath

Array = NDArray[np.float64]

SPEED, PLANNED = 0.95, 0.7
"""Shares of the speed and acceleration limits that are planned with; the rest is for corrections."""

CURVED = 0.8
"""Share of that, at most, for curves; the rest is always left for slowing down."""

SMALL = 1e-12
"""Slope of a path that is none, relative to the largest."""


class Pace:
    """The pace along a path, at its waypoints.

    Args:
        path: the path.
        bound: largest |dq| of each joint, (nv,) [rad or m]; may be infinite.
        brake: the most that dq may differ from that of the step before, (nv,) [rad or m].
    """

    def __init__(self, path: JointPath, bound: Array, brake: Array) -> None:
        self._places = np.arange(len(path.offsets), dtype=np.float64)
        # Between two waypoints the curve is as steep and as bent as at either of them, at most.
        slope, bend = (_around(np.abs(each)) for each in (path.slopes, np.gradient(path.slopes, axis=0)))
        tiny = SMALL * max(float(slope.max()), 1e-100)
        self._slope, self._bend = np.maximum(slope, tiny), np.maximum(bend, tiny)
        self._planned = PLANNED * brake
        curved = np.sqrt((CURVED * self._planned / self._bend).min(axis=1))
        self.top = np.minimum((SPEED * bound / self._slope).min(axis=1), curved)
        self.top[-1] = 0.0
        for i in reversed(range(len(self.top) - 1)):
            gain = min(self._gain(i, self.top[i]), self._gain(i + 1, self.top[i + 1]))
            self.top[i] = min(self.top[i], np.sqrt(self.top[i + 1] ** 2 + 2.0 * gain))

    def _gain(self, waypoint: int, pace: float) -> float:
        """The most that the pace may change from one step to the next there."""
        left = self._planned - self._bend[waypoint] * pace**2
        least = (1.0 - CURVED) * self._planned
        return float((np.maximum(left, least) / self._slope[waypoint]).min())

    def next(self, place: float, pace: float) -> float:
        """Places to go in this step, after `pace` places in the step before."""
        gain = self._gain(round(place), pace)
        top = float(np.interp(place, self._places, self.top))
        left = float(self._places[-1]) - place
        return min(max(min(pace + gain, top), pace - gain, min(gain, left)), left)


def _around(values: Array) -> Array:
    """The largest of each value and its neighbours along the path, (N + 1, nv)."""
    padded = np.pad(values, ((1, 1), (0, 0)), mode="edge")
    return np.asarray(np.maximum(values, np.maximum(padded[:-2], padded[2:])))
