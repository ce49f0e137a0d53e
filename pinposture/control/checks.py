"""Checks that the parameters of controllers and loops have in common."""

from __future__ import annotations

import math
from numbers import Integral, Real

from pinposture.errors import InvalidValue


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
