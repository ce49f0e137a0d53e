"""Checks of numbers that come from outside."""

from __future__ import annotations

import numpy as np
import pinocchio as pin
from numpy.typing import ArrayLike, NDArray

from pinposture.errors import InvalidValue


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
