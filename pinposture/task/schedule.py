"""When each keyframe is reached and left, in whole control cycles."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import pairwise
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.interpolate import CubicHermiteSpline, PchipInterpolator, make_interp_spline

from pinposture.errors import TaskError
from pinposture.task.keyframe import Keyframe, title

Array = NDArray[np.float64]

CONTINUITIES = ("velocity", "acceleration")
"""What may be continuous in time, besides the posture itself."""

MOST_CYCLES = 1_000_000
"""The longest motion, in control cycles."""


class Stretch(NamedTuple):
    """A part of a motion that begins and ends at rest.

    Attributes:
        first: the keyframe at its beginning, 0-based.
        last: the keyframe at its end.
        rows: the row at which each of its keyframes is; that of the first is where its hold ends.
    """

    first: int
    last: int
    rows: NDArray[np.int64]


class Schedule(NamedTuple):
    """When keyframes are reached and left.

    Attributes:
        reached: the row at which each is reached, (K,); that of the first is 0.
        left: the row at which each is left; later if it is held, (K,).
        rests: whether the arm is at rest there, (K,).
    """

    reached: NDArray[np.int64]
    left: NDArray[np.int64]
    rests: NDArray[np.bool_]

    @property
    def rows(self) -> int:
        """Number of rows, the first and the last included."""
        return int(self.left[-1]) + 1

    @property
    def shortest(self) -> int:
        """The least number of rows from one keyframe to the next."""
        return int((self.reached[1:] - self.left[:-1]).min())

    def finer(self, times: int) -> Schedule:
        """The same with so many rows for each."""
        return Schedule(times * self.reached, times * self.left, self.rests)

    def stretches(self) -> list[Stretch]:
        """The parts between rests, in order."""
        rests = np.flatnonzero(self.rests)
        return [
            Stretch(int(a), int(b), np.concatenate([self.left[a : a + 1], self.reached[a + 1 : b + 1]]))
            for a, b in pairwise(rests)
        ]


def schedule(keyframes: tuple[Keyframe, ...], interval: float) -> Schedule:
    """Set keyframes in time; all times are rounded to whole control cycles.

    Raises:
        TaskError: times that do not increase, naming the keyframe.
    """
    reached, left, end = [], [], 0.0
    for index, keyframe in enumerate(keyframes):
        where, time = title(keyframes, index), keyframe.time
        if index == 0:
            if (keyframe.time or keyframe.duration or 0.0) != 0.0:
                given = keyframe.time or keyframe.duration
                raise TaskError(
                    where, f"it is at {given:g} s; the first keyframe is at 0, leave its time out"
                )
            time = 0.0
        elif time is None:
            if keyframe.duration is None:
                raise TaskError(where, "it has neither a time nor a duration; give one of them [s]")
            time = end + keyframe.duration
        before = f"keyframe {index}"
        if index > 0 and time <= end:
            held = " left" if keyframes[index - 1].hold > 0.0 else ""
            reason = f"it is at {time:g} s, but {before} is{held} at {end:g} s; times have to increase"
            raise TaskError(where, reason)
        end = time + keyframe.hold
        if not end <= MOST_CYCLES * interval:
            longest = MOST_CYCLES * interval
            raise TaskError(
                where, f"it ends at {end:g} s; with cycles of {interval:g} s, {longest:g} s at most"
            )
        reached.append(round(time / interval))
        left.append(round(end / interval))
        if index > 0 and reached[-1] <= left[-2]:
            reason = f"it is in the same control cycle as {before}; they have to be {interval:g} s apart"
            raise TaskError(where, reason)
    rests = np.array([keyframe.hold > 0.0 for keyframe in keyframes])
    rests[0] = rests[-1] = True
    return Schedule(np.array(reached, dtype=np.int64), np.array(left, dtype=np.int64), rests)


def interpolate(stretch: Stretch, values: Array, continuity: str, rows: Sequence[int] | Array) -> Array:
    """Values in time along a stretch, which are at rest at its ends.

    With "velocity" they are cubic between keyframes, and monotone there (slopes of Fritsch and Butland); with
    "acceleration" quintic, with a continuous fourth derivative, and may overshoot.

    Args:
        stretch: the stretch.
        values: at its keyframes, (k, d).
        continuity: one of `CONTINUITIES`.
        rows: where they are asked for, (r,); need not be whole.

    Returns:
        Values (r, d).
    """
    # In units of the stretch, so that its fifth powers are harmless.
    begin, span = stretch.rows[0], stretch.rows[-1] - stretch.rows[0]
    knots = (stretch.rows - begin) / span
    x = np.clip((np.asarray(rows) - begin) / span, 0.0, 1.0)
    if continuity == "velocity":
        with np.errstate(over="ignore"):  # of inverse secants that vanish, to slopes of 0
            slopes = PchipInterpolator(knots, values)(knots, 1)
        slopes[0] = slopes[-1] = 0.0
        return np.asarray(CubicHermiteSpline(knots, values, slopes)(x))
    still = [(1, np.zeros(values.shape[1])), (2, np.zeros(values.shape[1]))]
    return np.asarray(make_interp_spline(knots, values, k=5, bc_type=(still, still))(x))
