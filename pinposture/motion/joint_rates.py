"""How fast joints move in a motion that is known at moments only."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]


class Rates(NamedTuple):
    """Velocity and acceleration of each joint at each row.

    Attributes:
        velocities: (N, n) [rad/s or m/s].
        accelerations: (N, n) [rad/s^2 or m/s^2].
    """

    velocities: Array
    accelerations: Array


class Peaks(NamedTuple):
    """The most that a motion asks of each joint, in the sense of `Limits`.

    Attributes:
        speeds: largest mean speed between two rows, (n,) [rad/s or m/s].
        accelerations: largest change of that from one interval to the next, from rest and to rest included,
            per time, (n,) [rad/s^2 or m/s^2].
    """

    speeds: Array
    accelerations: Array


def rates(time: Array, positions: Array) -> Rates:
    """Central and second differences: exact where a joint moves with constant acceleration.

    With slopes s before and after a row, and h the intervals,

        v = (h_before s_after + h_after s_before) / (h_before + h_after),
        a = 2 (s_after - s_before) / (h_before + h_after).

    A velocity is a mean of the slopes around it, and at equal distances an acceleration is their difference
    over the interval: what bounds the steps of a motion bounds its rows. The first and the last row are at
    rest, without acceleration: a robot that holds the last row must not go on pushing.

    Args:
        time: moments, (N,) [s], strictly increasing.
        positions: joint positions then, (N, n) [rad or m].
    """
    velocities, accelerations = np.zeros_like(positions), np.zeros_like(positions)
    if len(time) > 2:
        intervals = np.diff(time)[:, None]
        with np.errstate(over="ignore", invalid="ignore"):  # the trajectory refuses what is not finite
            slopes = np.diff(positions, axis=0) / intervals
            before, after = intervals[:-1], intervals[1:]
            velocities[1:-1] = (before * slopes[1:] + after * slopes[:-1]) / (before + after)
            accelerations[1:-1] = 2.0 * (slopes[1:] - slopes[:-1]) / (before + after)
    return Rates(velocities, accelerations)


def peaks(time: Array, positions: Array) -> Peaks:
    """The largest speeds and accelerations from row to row, from rest and to rest.

    Args:
        time: moments, (N,) [s], strictly increasing.
        positions: joint positions then, (N, n) [rad or m].
    """
    if len(time) == 1:
        return Peaks(np.zeros(positions.shape[1]), np.zeros(positions.shape[1]))
    intervals = np.diff(time)
    spans = np.pad(intervals, 1, mode="edge")
    with np.errstate(over="ignore"):  # infinite is what two rows far apart and at one moment ask for
        slopes = np.diff(positions, axis=0) / intervals[:, None]
        resting = np.pad(slopes, ((1, 1), (0, 0)))
        changes = 2.0 * np.diff(resting, axis=0) / (spans[:-1] + spans[1:])[:, None]
    return Peaks(np.abs(slopes).max(axis=0), np.abs(changes).max(axis=0))
