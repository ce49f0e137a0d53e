"""Joint positions between the rows of a motion."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]


def cubic(time: Array, positions: Array, velocities: Array, moments: Array) -> Array:
    """The cubic polynomials between rows that have their positions and velocities (Hermite).

    Args:
        time: when each row is reached, (N,) [s], strictly increasing.
        positions: (N, n) [rad or m].
        velocities: (N, n) [rad/s or m/s].
        moments: any, (...) [s]; those before the first row and after the last stand for these.

    Returns:
        Positions, (..., n) [rad or m]; at the time of a row exactly its own.
    """
    clipped = np.clip(moments, time[0], time[-1])
    last = len(time) - 1
    before = np.clip(np.searchsorted(time, clipped, side="right") - 1, 0, max(last - 1, 0))
    after = np.minimum(before + 1, last)
    span = time[after] - time[before]
    share = np.divide(clipped - time[before], span, out=np.zeros_like(span), where=span > 0.0)[..., None]
    start, way = positions[before], positions[after] - positions[before]
    # The chord, and what bends it off: slopes at either end against its own.
    first = span[..., None] * velocities[before] - way
    second = span[..., None] * velocities[after] - way
    bend = share * (1.0 - share) * ((1.0 - share) * first - share * second)
    found: Array = np.where(share < 1.0, start + share * way + bend, positions[after])
    return found
