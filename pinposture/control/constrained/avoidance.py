"""Keeping clear of obstacles and of itself: in one step, and on the way."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from pinposture.arm import ArmState
from pinposture.control.constrained.posture import Linear, Posture
from pinposture.control.constrained.program import Rows, Solution
from pinposture.scene import Clearance, Nearness

Array = NDArray[np.float64]

SIGHT = 0.15
"""Pairs nearer than this beyond the margin are constrained, in arm lengths: more than a step goes."""

APPROACH = 0.5
"""Share of the room that is left, which a pair may lose in one step."""

SPARE = 0.002
"""What steps keep beyond the margin, in arm lengths: room for the curvature of the way within a step."""

BERTH = 0.01
"""What a way keeps beyond the margin where it can, in arm lengths."""

PUSH = 0.5
"""Share of the largest push that the limits allow, which is asked of a pair that is too close."""

MENTIONED = 3
"""How many pairs that are too close are listed."""

SAMPLES = 10
"""Places between two configurations at which the distance is looked up."""

HALVINGS = 6
"""How often a step that comes too close is halved, before the arm stands still."""


class Avoidance:
    """A scene around an arm, as rows of a program and as a judge of steps.

    Attributes:
        clearance: the distances.
        margin: the distance to keep [m].
    """

    def __init__(self, clearance: Clearance, posture: Posture) -> None:
        self.clearance, self.margin = clearance, clearance.scene.margin
        self._posture, self._length = posture, posture.arm.length
        self._seen: tuple[ArmState, Nearness] | None = None

    def near(self, state: ArmState) -> Nearness:
        """The pairs in sight; the last answer is kept, because a step asks more than once."""
        if self._seen is None or self._seen[0] is not state:
            self._seen = (state, self.clearance.nearest(state, self.margin + SIGHT * self._length))
        return self._seen[1]

    def rows(self, state: ArmState, lower: Array, upper: Array) -> Rows | None:
        """The velocity damper: no pair may lose more than a share of its room in one step.

        A pair that is too close has to gain room, as far as the bounds of the step allow.

        Args:
            state: where the arm is.
            lower: smallest step, (n,), in `Arm.joint_units`.
            upper: largest step, (n,).
        """
        near = self.near(state)
        if not len(near.distances):
            return None
        matrix = near.rows[:, self._posture.columns] * self._posture.units
        least = -APPROACH * (near.distances - self.margin - SPARE * self._length)
        most = np.maximum(matrix * lower, matrix * upper).sum(axis=1)
        return Rows(matrix, np.minimum(least, PUSH * most))

    def intrusion(self, state: ArmState) -> float:
        """By how much the nearest pair is closer than the margin [m]; 0 if all keep it."""
        return max(0.0, self.margin - self.near(state).minimum)

    def intrusions(self, state: ArmState) -> Linear:
        """How far pairs are closer than a way should come; the errors should vanish."""
        berth = self.margin + BERTH * self._length
        near = self.clearance.nearest(state, berth)
        return Linear(near.rows[:, self._posture.columns] * self._posture.units, berth - near.distances)

    def shortened(self, state: ArmState, dq: Array) -> float:
        """The share of a step on all of which the arm keeps its margin, 1, 1/2, 1/4, ... or 0.

        Where it is too close to begin with, it may not come closer.
        """
        allowed = min(self.margin, self.clearance.minimum(state.q).distance) - 1e-12 * self._length
        share = 1.0
        for _ in range(HALVINGS):
            if self.clearance.minimum_between(state.q, share * dq, SAMPLES).distance >= allowed:
                return share
            share /= 2.0
        return 0.0

    def too_close(self, state: ArmState) -> tuple[str, ...]:
        """The pairs that are closer than the margin, in words."""
        close = self.near(state).distances < self.margin - 1e-9 * self._length
        words = [f"margin of {1e3 * self.margin:.3g} mm: {pair}" for pair in self.named(state, close)]
        more = (f"and {len(words) - MENTIONED} more pairs",) if len(words) > MENTIONED else ()
        return (*words[:MENTIONED], *more)

    def holding(self, state: ArmState, solution: Solution | None, stuck: bool) -> tuple[str, ...]:
        """The pairs that hold a step back, in words: those whose rows bind, or all close ones if stuck."""
        near = self.near(state)
        which = near.distances <= self.margin + 1.5 * SPARE * self._length if stuck else None
        if solution is not None and len(solution.binding) == len(near.distances):
            which = solution.binding if which is None else which | solution.binding
        return () if which is None else self.named(state, which)

    def named(self, state: ArmState, which: NDArray[np.bool_]) -> tuple[str, ...]:
        """Some of the pairs in sight, in words."""
        near = self.near(state)
        chosen = np.flatnonzero(which)
        return tuple(f"{' to '.join(near.pairs[k])}: {1e3 * near.distances[k]:.3g} mm apart" for k in chosen)
