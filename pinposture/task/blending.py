"""Motions put together from parts, without a jump."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

WINDOW = 0.25
"""How much of the time from one keyframe to the next a change to other configurations takes."""


def rise(x: Array) -> Array:
    """From 0 at 0 to 1 at 1, and constant beyond; at both ends with zero velocity and acceleration."""
    t = np.clip(x, 0.0, 1.0)
    return np.asarray(t**3 * (10.0 - 15.0 * t + 6.0 * t**2))


def window(rows: int) -> int:
    """How many of the rows from one keyframe to the next a change takes."""
    return max(int(WINDOW * (rows - 1)), 1)


def ramp(rows: int, first: Array, last: Array) -> Array:
    """Offsets (rows, n) that lead smoothly from one to another, each (n,)."""
    share = rise(np.linspace(0.0, 1.0, rows))[:, None]
    return np.asarray((1.0 - share) * first + share * last)


def crossfade(before: Array, after: Array, start: int) -> Array:
    """Rows (r, n) that go over from some to others within the window that begins at a row."""
    share = rise((np.arange(len(before)) - start) / window(len(before)))[:, None]
    return np.asarray((1.0 - share) * before + share * after)
