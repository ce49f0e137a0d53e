"""Checks of what a caller hands in, each naming the culprit and what was allowed."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from numbers import Real

import numpy as np
from numpy.typing import ArrayLike, NDArray

from pinposture.errors import CurveError, InvalidValue

LARGEST = 1e9  # [m] so that no product of coordinates can overflow
SMALLEST = 1e-9  # [m] so that none can vanish
REPEATED = 1e-9  # points closer than this fraction of the extent are one point,
ROUNDED = 1e-10  # and so are points closer than this fraction of the coordinates


def as_points(
    value: ArrayLike, least: int = 2, name: Callable[[int], str] = "point {}".format
) -> NDArray[np.float64]:
    """Read points given by a caller.

    Args:
        value: shape (n, 2), then z = 0, or (n, 3) [m].
        least: how many points are needed.
        name: what to call the i-th point in a message.

    Returns:
        The points, shape (n, 3) [m], a copy.

    Raises:
        CurveError: too few points, not 2 or 3 finite coordinates each, or coordinates beyond 1e9 m.
    """
    try:
        raw = np.asarray(value)
    except ValueError:  # rows of different lengths
        raw = np.empty(0, dtype=object)
    if raw.dtype.kind not in "iuf" or (raw.ndim != 2 and raw.size):
        raise _malformed(value, name)
    if len(raw) < least:
        raise CurveError("points", f"{_count(len(raw))} given, at least {least} needed")
    if raw.shape[1] not in (2, 3):
        raise CurveError("points", f"{raw.shape[1]} coordinates each; allowed: 2 (then z = 0) or 3")
    points = np.zeros((len(raw), 3))
    points[:, : raw.shape[1]] = raw
    bad = ~(np.abs(points) <= LARGEST)  # true for NaN too
    if bad.any():
        i, axis = np.argwhere(bad)[0]
        raise CurveError(
            name(int(i)),
            f"{'xyz'[axis]} is {points[i, axis]}; allowed: finite, at most {LARGEST:g} m in size",
        )
    return points


def _count(n: int) -> str:
    return f"{n} point" + "s" * (n != 1)


def _malformed(value: object, name: Callable[[int], str]) -> CurveError:
    """Find the first row that keeps `value` from being a table of numbers."""
    allowed = "allowed: rows of 2 or of 3 numbers"
    if (
        getattr(value, "ndim", 1) == 0
        or not isinstance(value, (Sequence, np.ndarray))
        or isinstance(value, str)
    ):
        return CurveError("points", f"{_short(value)} is not a list of points; {allowed}")
    size = None
    for i, row in enumerate(value):
        if not isinstance(row, (Sequence, np.ndarray)) or isinstance(row, str):
            return CurveError(name(i), f"{_short(row)} is not a point; {allowed}")
        for entry in row:
            if not isinstance(entry, Real):
                return CurveError(name(i), f"{_short(entry)} is not a number; {allowed}")
        size = len(row) if size is None else size
        if len(row) != size:
            return CurveError(name(i), f"{len(row)} coordinates where {name(0)} has {size}; {allowed}")
    return CurveError("points", f"not a table of numbers; {allowed}")


def _short(value: object) -> str:
    text = repr(value)
    return text if len(text) < 60 else text[:57] + "..."


def check_distinct(points: NDArray[np.float64], name: Callable[[int], str] = "point {}".format) -> None:
    """Refuse a point that repeats the one before it, and points that all lie in one place.

    Args:
        points: shape (n, 3) [m].
        name: what to call the i-th point in a message.

    Raises:
        CurveError: naming both points.
    """
    extent = float(np.linalg.norm(np.ptp(points, axis=0)))
    tolerance = max(REPEATED * extent, ROUNDED * float(np.abs(points).max()), SMALLEST)
    gaps = np.linalg.norm(np.diff(points, axis=0), axis=1)
    repeated = np.flatnonzero(gaps <= tolerance)
    if repeated.size:
        i = int(repeated[0])
        where = ", ".join(f"{x:.6g}" for x in points[i])
        raise CurveError(
            f"{name(i)} and {name(i + 1)}",
            f"the same place ({where}); allowed: consecutive points more than {tolerance:.3g} m apart",
        )


def as_number(name: str, value: object, allowed: str, test: Callable[[float], bool]) -> float:
    """Read one finite number for which `test` holds, else raise InvalidValue with the words `allowed`."""
    if isinstance(value, Real) and not isinstance(value, bool):
        number = float(value)
        if math.isfinite(number) and test(number):
            return number
    raise InvalidValue(name, value, allowed)


def as_count(name: str, value: object, low: int, high: int) -> int:
    """Read an integer from `low` to `high`, else raise InvalidValue."""
    allowed = f"an integer from {low} to {high}"
    number = as_number(name, value, allowed, lambda x: low <= x <= high and x == int(x))
    return int(number)


def as_flag(name: str, value: object) -> bool:
    """Read True or False, else raise InvalidValue."""
    if not isinstance(value, (bool, np.bool_)):
        raise InvalidValue(name, value, "true or false")
    return bool(value)


def as_vector(name: str, value: ArrayLike) -> NDArray[np.float64]:
    """Read 3 finite numbers (or 2, then z = 0) into shape (3,), else raise InvalidValue."""
    allowed = f"3 finite numbers, or 2 (then z = 0), at most {LARGEST:g} in size"
    try:
        raw = np.asarray(value)
    except ValueError:
        raise InvalidValue(name, value, allowed) from None
    if raw.dtype.kind not in "iuf" or raw.shape not in ((2,), (3,)) or not (np.abs(raw) <= LARGEST).all():
        raise InvalidValue(name, value, allowed)
    vector = np.zeros(3)
    vector[: len(raw)] = raw
    return vector
