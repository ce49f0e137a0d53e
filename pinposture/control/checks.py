"""Checks that the parameters of the controllers have in common."""

from __future__ import annotations

import math

from pinposture.errors import InvalidValue


def require_positive(name: str, value: float, zero: bool = False) -> None:
    """Raise InvalidValue unless the value is a finite number > 0 (or >= 0)."""
    if not (isinstance(value, int | float) and math.isfinite(value) and (value > 0 or (zero and value == 0))):
        raise InvalidValue(name, value, f"a finite number {'>=' if zero else '>'} 0")


def require_share(name: str, value: float) -> None:
    """Raise InvalidValue unless the value is a number in [0, 1)."""
    if not (isinstance(value, int | float) and 0.0 <= value < 1.0):
        raise InvalidValue(name, value, "a number in [0, 1)")
