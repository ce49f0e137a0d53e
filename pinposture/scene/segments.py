"""Distances between straight lines of finite length, many at a time."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

_PARALLEL = 1e-14
"""Square of the sine of the angle below which lines count as parallel; the distance does not notice."""
_TINY = 1e-300


class Closest(NamedTuple):
    """Where lines come nearest to each other.

    Attributes:
        first: the point of the first line, (..., 3) [m].
        second: the point of the second line, (..., 3) [m].
    """

    first: Array
    second: Array


def closest_points(a: Array, b: Array, c: Array, d: Array) -> Closest:
    """The nearest points of the lines from a to b and from c to d; a line may be a single point.

    Args:
        a: ends of the first lines, (..., 3) [m].
        b: their other ends, (..., 3) [m].
        c: ends of the second lines, (..., 3) [m].
        d: their other ends, (..., 3) [m].
    """
    u, v, r = b - a, d - c, a - c
    uu, vv, uv = _dot(u, u), _dot(v, v), _dot(u, v)
    ur, vr = _dot(u, r), _dot(v, r)
    across = uu * vv - uv * uv
    skew = across > _PARALLEL * uu * vv
    # On the line without ends, then the other within its ends, then the first again within its own: exact,
    # because the region of admissible pairs is a rectangle and the distance is convex on it.
    s = np.clip(np.where(skew, (uv * vr - vv * ur) / np.where(skew, across, 1.0), 0.0), 0.0, 1.0)
    t = np.clip((uv * s + vr) / np.maximum(vv, _TINY), 0.0, 1.0)
    s = np.clip((uv * t - ur) / np.maximum(uu, _TINY), 0.0, 1.0)
    return Closest(a + s[..., None] * u, c + t[..., None] * v)


def _dot(x: Array, y: Array) -> Array:
    return np.asarray(np.einsum("...i,...i->...", x, y))
