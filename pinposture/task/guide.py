"""Where a reference is at each place, and how fast limits allow it to be gone along."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from pinposture.control import Limits
from pinposture.control.constrained.pace import Pace
from pinposture.control.constrained.path import JointPath
from pinposture.target import Target
from pinposture.task.reference import Mark, Reference

Array = NDArray[np.float64]


class Guide:
    """A reference as a way that can be gone along at any pace. Places are rows of it, and between them.

    Args:
        reference: the reference.
        limits: what a step may not exceed, with dt.

    Attributes:
        reference: the reference.
        path: its configurations as a way through joint space, within the position limits.
        most: rows to go in one cycle, if nothing slows the motion.
        pace: how fast limits allow to go, and no faster than that.
    """

    def __init__(self, reference: Reference, limits: Limits) -> None:
        assert limits.dt is not None
        arm, bounds = reference.arm, limits.for_arm(reference.arm)
        self.reference = reference
        self.most = limits.dt / reference.interval
        self._lower, self._upper = bounds.edges - arm.positions(reference.start)
        offsets = np.minimum(np.maximum(reference.offsets, self._lower), self._upper)
        # What does not move the arm is not ours to move.
        self.path = JointPath(arm, reference.start, offsets * (arm.moved > 0.0))
        self.pace = Pace(self.path, bounds.bound, bounds.brake, self.most)

    @property
    def end(self) -> float:
        """The last place."""
        return self.path.end

    @property
    def steps(self) -> float:
        """How many cycles it takes at least."""
        middle = 0.5 * (self.pace.top[1:] + self.pace.top[:-1])
        return float((1.0 / np.maximum(middle, 1e-9)).sum())

    def next(self, place: float, speed: float) -> float:
        """The place after the next cycle, after one that went `speed` places."""
        return min(place + self.pace.next(place, speed), self.end)

    def target(self, place: float) -> Target:
        """The target posture at a place."""
        arm, row = self.reference.arm, min(int(np.ceil(place)), self.reference.rows - 1)
        offset = np.minimum(np.maximum(self.path.smooth(place), self._lower), self._upper)
        q = arm.integrate(self.reference.start, offset)
        return Target(arm.at(q).points, self.reference.weights[row], q)

    def way(self, place: float) -> JointPath:
        """What is left of the way from a place, which is a row."""
        row, path = int(place), self.path
        if row == 0:
            return path
        return JointPath(path.arm, path.configuration(row), path.offsets[row:] - path.offsets[row])

    def next_mark(self, place: float) -> Mark:
        """The next place with a name; the last row if there is none."""
        last = self.reference.rows - 1
        ahead = [mark for mark in self.reference.marks if mark.row > place]
        return ahead[0] if ahead else Mark("the end", last, self.target(float(last)))
