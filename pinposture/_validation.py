"""Checks of arguments: numbers, vectors, points, rotations."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Mapping, Sequence
from difflib import get_close_matches
from numbers import Integral, Real
from typing import Any, TypeAlias

import numpy as np
import pinocchio as pin
from numpy.typing import ArrayLike, NDArray

from pinposture.errors import CurveError, InvalidValue

# Checks that the parameters of controllers and loops have in common.


def is_number(value: object) -> bool:
    """Whether it is a real number, of Python or of numpy; truth values are not."""
    return isinstance(value, Real) and not isinstance(value, bool)


def require_positive(name: str, value: float, zero: bool = False) -> None:
    """Raise InvalidValue unless the value is a finite number > 0 (or >= 0)."""
    if not (is_number(value) and math.isfinite(value) and (value > 0 or (zero and value == 0))):
        raise InvalidValue(name, value, f"a finite number {'>=' if zero else '>'} 0")


def require_share(name: str, value: float) -> None:
    """Raise InvalidValue unless the value is a number in [0, 1)."""
    if not (is_number(value) and 0.0 <= value < 1.0):
        raise InvalidValue(name, value, "a number in [0, 1)")


def is_whole(value: object) -> bool:
    """Whether it is a whole number, of Python or of numpy; truth values are not."""
    return isinstance(value, Integral) and not isinstance(value, bool)


def require_whole(name: str, value: int, least: int) -> None:
    """Raise InvalidValue unless the value is a whole number of at least that much."""
    if not (is_whole(value) and value >= least):
        raise InvalidValue(name, value, f"a whole number of at least {least}")


# Checks of what a caller hands in, each naming the culprit and what was allowed.

LARGEST_COORDINATE = 1e9  # [m] so that no product of coordinates can overflow
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
    bad = ~(np.abs(points) <= LARGEST_COORDINATE)  # true for NaN too
    if bad.any():
        i, axis = np.argwhere(bad)[0]
        raise CurveError(
            name(int(i)),
            f"{'xyz'[axis]} is {points[i, axis]}; allowed: finite, at most {LARGEST_COORDINATE:g} m in size",
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
    allowed = f"3 finite numbers, or 2 (then z = 0), at most {LARGEST_COORDINATE:g} in size"
    try:
        raw = np.asarray(value)
    except ValueError:
        raise InvalidValue(name, value, allowed) from None
    if (
        raw.dtype.kind not in "iuf"
        or raw.shape not in ((2,), (3,))
        or not (np.abs(raw) <= LARGEST_COORDINATE).all()
    ):
        raise InvalidValue(name, value, allowed)
    vector = np.zeros(3)
    vector[: len(raw)] = raw
    return vector


def float_array(name: str, values: ArrayLike, shape: tuple[int, ...]) -> NDArray[np.float64]:
    """A fresh array of floats, finite or not.

    Raises:
        InvalidValue: not numbers, or another shape.
    """
    try:
        array = np.array(values, dtype=np.float64)
    except (TypeError, ValueError):
        raise InvalidValue(name, values, f"numbers of shape {shape}") from None
    if array.shape != shape:
        raise InvalidValue(f"{name} (shape)", array.shape, f"{shape} for this arm")
    return array


def finite_vector(name: str, values: ArrayLike, size: int) -> NDArray[np.float64]:
    """A fresh vector (size,) of finite floats.

    Raises:
        InvalidValue: not numbers, another shape, or an entry that is not finite; names the entry.
    """
    vector = float_array(name, values, (size,))
    finite = np.isfinite(vector)
    if not finite.all():
        bad = int(np.argmin(finite))
        raise InvalidValue(f"{name}[{bad}]", float(vector[bad]), "finite numbers")
    return vector


def rigid_placement(name: str, value: object) -> pin.SE3:
    """A fresh placement: that of a `pin.SE3` or of a homogeneous matrix (4, 4); the identity for None.

    Raises:
        InvalidValue: anything else, or a matrix that is not finite, or scales, shears or mirrors.
    """
    if value is None:
        return pin.SE3.Identity()
    try:
        matrix = np.array(value.homogeneous if isinstance(value, pin.SE3) else value, dtype=np.float64)
    except (TypeError, ValueError):
        matrix = np.zeros(0)
    if matrix.shape == (4, 4) and np.all(np.isfinite(matrix)):
        turn = matrix[:3, :3]
        rigid = np.allclose(turn @ turn.T, np.eye(3), atol=1e-6) and np.linalg.det(turn) > 0.0
        if rigid and np.allclose(matrix[3], (0.0, 0.0, 0.0, 1.0), atol=1e-12):
            return pin.SE3(turn, matrix[:3, 3])
    raise InvalidValue(name, value, "a pin.SE3, or a finite rigid transform (4, 4)")


# Checks of the numbers that describe obstacles, each naming the value and what was allowed.

Vector: TypeAlias = tuple[float, float, float]
Matrix: TypeAlias = tuple[Vector, Vector, Vector]

LARGEST_LENGTH = 1e4
"""Largest coordinate or size [m]; squares and products of larger ones lose the digits that distances need."""
SMALLEST_LENGTH = 1e-9
"""Smallest size of something solid [m]."""


def length(name: str, value: Any, zero: bool = False) -> float:
    """A length [m]: a finite number above 0, or not below it, that is no truth value.

    Raises:
        InvalidValue: anything else.
    """
    least = 0.0 if zero else SMALLEST_LENGTH
    if isinstance(value, Real) and not isinstance(value, bool):
        number = float(value)
        if math.isfinite(number) and least <= number <= LARGEST_LENGTH:
            return number
    raise InvalidValue(name, value, f"a length of {least:g} to {LARGEST_LENGTH:g} m")


def is_count(value: object) -> bool:
    """Whether it is a whole number of at least 1; truth values are not."""
    return isinstance(value, Integral) and not isinstance(value, bool) and int(value) >= 1


def point(name: str, value: Any) -> Vector:
    """Three finite numbers, none larger than `LARGEST_LENGTH`.

    Raises:
        InvalidValue: anything else; names the coordinate.
    """
    numbers = _numbers(name, value, (3,), "three finite numbers")
    if np.abs(numbers).max() > LARGEST_LENGTH:
        worst = int(np.argmax(np.abs(numbers)))
        raise InvalidValue(
            f"{name}[{worst}]", float(numbers[worst]), f"at most {LARGEST_LENGTH:g} either way"
        )
    x, y, z = (float(number) for number in numbers)
    return x, y, z


def direction(name: str, value: Any) -> Vector:
    """The unit vector along three finite numbers that are not all 0.

    Raises:
        InvalidValue: anything else.
    """
    x, y, z = point(name, value)
    size = math.hypot(x, y, z)
    if size < SMALLEST_LENGTH:
        raise InvalidValue(name, value, "three numbers, not all 0")
    # Left alone where it is a unit vector already, so that what is written to a file reads back the same.
    return (x, y, z) if abs(size - 1.0) < 1e-15 else (x / size, y / size, z / size)


def rotation(name: str, value: Any) -> Matrix:
    """A rotation: (3, 3), or roll, pitch and yaw [rad] as in URDF, or None for no turn.

    Raises:
        InvalidValue: anything else, or a matrix that scales, shears or mirrors.
    """
    allowed = "a rotation matrix (3, 3), or three angles: roll, pitch, yaw [rad]"
    if value is None:
        turn = np.eye(3)
    else:
        numbers = _numbers(name, value, None, allowed)
        if numbers.shape == (3,) and np.abs(numbers).max() > 2.0 * np.pi:
            raise InvalidValue(name, value, "angles within 2 pi either way, in rad, not in degrees")
        turn = pin.rpy.rpyToMatrix(*numbers) if numbers.shape == (3,) else numbers
        if turn.shape != (3, 3) or not np.allclose(turn @ turn.T, np.eye(3), atol=1e-6):
            raise InvalidValue(name, value, allowed)
        if np.linalg.det(turn) < 0.0:
            raise InvalidValue(name, value, "a rotation; this matrix mirrors")
    x, y, z = (tuple(float(number) for number in row) for row in turn)
    return x, y, z  # type: ignore[return-value]


def known_keys(what: str, given: Mapping[str, Any], allowed: Iterable[str]) -> None:
    """Refuse keys that nobody reads, with the nearest one that somebody does.

    Raises:
        InvalidValue: a key that is not among those allowed.
    """
    names = tuple(allowed)
    for key in given:
        if key not in names:
            close = get_close_matches(str(key), names, n=1)
            hint = f" (did you mean {close[0]!r}?)" if close else ""
            raise InvalidValue(f"key of {what}", key, ", ".join(names) + hint)


def _numbers(name: str, value: Any, shape: tuple[int, ...] | None, allowed: str) -> np.ndarray:
    try:
        array = np.array(value)
        sound = array.dtype.kind in "iuf"
        numbers = array.astype(np.float64) if sound else np.zeros(0)
    except (TypeError, ValueError, OverflowError):
        numbers = np.zeros(0)
    if not numbers.size or (shape is not None and numbers.shape != shape) or not np.all(np.isfinite(numbers)):
        raise InvalidValue(name, value, allowed)
    return numbers
