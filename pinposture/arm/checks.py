"""Checks of numbers that come from outside."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray

from pinposture.errors import InvalidValue


def finite_vector(name: str, values: ArrayLike, size: int) -> NDArray[np.float64]:
    """A fresh vector (size,) of finite floats.

    Raises:
        InvalidValue: not numbers, another shape, or an entry that is not finite; names the entry.
    """
    try:
        vector = np.array(values, dtype=np.float64)
    except (TypeError, ValueError):
        raise InvalidValue(name, values, f"{size} numbers") from None
    if vector.shape != (size,):
        raise InvalidValue(f"{name} (shape)", vector.shape, f"({size},) for this arm")
    bad = np.flatnonzero(~np.isfinite(vector))
    if len(bad):
        raise InvalidValue(f"{name}[{bad[0]}]", float(vector[bad[0]]), "finite numbers")
    return vector
