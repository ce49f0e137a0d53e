"""Quantities in a file: numbers in SI units, or text with a unit."""

from __future__ import annotations

import math
import re
from collections.abc import Mapping
from types import MappingProxyType

from pinposture.task.reading.showing import shown

_LENGTHS = {"m": 1.0, "cm": 1e-2, "mm": 1e-3}
_ANGLES = {"rad": 1.0, "deg": math.pi / 180.0, "turns": 2.0 * math.pi}
_TIMES = {"s": 1.0, "ms": 1e-3, "min": 60.0}


def _per(units: Mapping[str, float], below: str) -> dict[str, float]:
    return {f"{unit}/{below}": factor for unit, factor in units.items()}


UNITS: Mapping[str, Mapping[str, float]] = MappingProxyType(
    {
        "length": _LENGTHS,
        "angle": _ANGLES,
        "time": _TIMES,
        "speed": _per(_LENGTHS, "s"),
        "rate of turning": {**_per(_ANGLES, "s"), "rpm": math.pi / 30.0},
        "acceleration": _per(_LENGTHS, "s^2"),
        "rate of change of turning": _per(_ANGLES, "s^2"),
    }
)
"""Units by what they measure, with what one of each is in SI units."""

_TEXT = re.compile(r"\s*([-+]?(?:\d+\.?\d*|\.\d+)(?:[eE][-+]?\d+)?)\s*(\S.*?)?\s*")


def read_quantity(value: object, *kinds: str) -> float:
    """A quantity in SI units.

    Args:
        value: a number, which is in SI units, or text as "25 mm".
        kinds: what it may measure, keys of `UNITS`.

    Raises:
        ValueError: anything else; says what is allowed.
    """
    allowed = "a number in SI units, or text with one of the units " + ", ".join(
        unit for kind in kinds for unit in UNITS[kind]
    )
    if isinstance(value, int | float) and not isinstance(value, bool):
        return _finite(float(value), value, allowed)
    found = _TEXT.fullmatch(value) if isinstance(value, str) else None
    if found is None:
        raise ValueError(f"is {shown(value)}; allowed: {allowed}")
    unit = (found[2] or "").replace("**", "^").replace("²", "^2").replace(" ", "").replace("/s/s", "/s^2")
    for kind in kinds:
        if unit in UNITS[kind]:
            return _finite(float(found[1]) * UNITS[kind][unit], value, allowed)
    for kind, known in UNITS.items():
        if unit in known:
            raise ValueError(f"is {shown(value)}, of the kind {kind}; allowed: {allowed}")
    what = f"and {shown(unit)} is no unit that is known" if unit else "without a unit"
    raise ValueError(f"is {shown(value)}, {what}; allowed: {allowed}")


def _finite(number: float, value: object, allowed: str) -> float:
    if not math.isfinite(number):
        raise ValueError(f"is {shown(value)}, which is not finite; allowed: {allowed}")
    return number
