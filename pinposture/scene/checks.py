"""Checks of the numbers that describe obstacles, each naming the value and what was allowed."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping
from difflib import get_close_matches
from numbers import Integral, Real
from typing import Any, TypeAlias

import numpy as np
import pinocchio as pin

from pinposture.errors import InvalidValue

Vector: TypeAlias = tuple[float, float, float]
Matrix: TypeAlias = tuple[Vector, Vector, Vector]

LARGEST = 1e4
"""Largest coordinate or size [m]; squares and products of larger ones lose the digits that distances need."""
SMALLEST = 1e-9
"""Smallest size of something solid [m]."""


def length(name: str, value: Any, zero: bool = False) -> float:
    """A length [m]: a finite number above 0, or not below it, that is no truth value.

    Raises:
        InvalidValue: anything else.
    """
    least = 0.0 if zero else SMALLEST
    if isinstance(value, Real) and not isinstance(value, bool):
        number = float(value)
        if math.isfinite(number) and least <= number <= LARGEST:
            return number
    raise InvalidValue(name, value, f"a length of {least:g} to {LARGEST:g} m")


def is_count(value: object) -> bool:
    """Whether it is a whole number of at least 1; truth values are not."""
    return isinstance(value, Integral) and not isinstance(value, bool) and int(value) >= 1


def point(name: str, value: Any) -> Vector:
    """Three finite numbers, none larger than `LARGEST`.

    Raises:
        InvalidValue: anything else; names the coordinate.
    """
    numbers = _numbers(name, value, (3,), "three finite numbers")
    if np.abs(numbers).max() > LARGEST:
        worst = int(np.argmax(np.abs(numbers)))
        raise InvalidValue(f"{name}[{worst}]", float(numbers[worst]), f"at most {LARGEST:g} either way")
    x, y, z = (float(number) for number in numbers)
    return x, y, z


def direction(name: str, value: Any) -> Vector:
    """The unit vector along three finite numbers that are not all 0.

    Raises:
        InvalidValue: anything else.
    """
    x, y, z = point(name, value)
    size = math.hypot(x, y, z)
    if size < SMALLEST:
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
