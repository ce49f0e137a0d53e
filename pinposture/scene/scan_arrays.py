"""Checks of the arrays that a scan is made of."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray

from pinposture.errors import InvalidValue

Array = NDArray[np.float64]

MOST = 5_000_000
"""The most points, and the most triangles, of a scan."""


def checked_points(values: ArrayLike) -> Array:
    """A fresh array of points, (n, 3), finite or not.

    Raises:
        InvalidValue: not numbers, another shape, or too many.
    """
    try:
        points = np.array(values, dtype=np.float64)
    except (TypeError, ValueError):
        raise InvalidValue("points", values, "points, (n, 3) [m]") from None
    if points.ndim != 2 or points.shape[1] != 3:
        raise InvalidValue("points (shape)", points.shape, "(n, 3)")
    if len(points) > MOST:
        raise InvalidValue("points (number)", len(points), f"at most {MOST}")
    return points


def checked_faces(values: ArrayLike, count: int) -> NDArray[np.int32]:
    """A fresh array of triangles, (k, 3), whose corners are among so many points.

    Raises:
        InvalidValue: not whole numbers, another shape, too many, or corners that there are not.
    """
    try:
        faces = np.array(values)
    except (TypeError, ValueError):
        faces = np.zeros(0)
    if faces.ndim != 2 or faces.shape[1] != 3 or faces.dtype.kind not in "iu":
        raise InvalidValue("faces", values, "triangles, (k, 3), as whole numbers of points; None for a cloud")
    if len(faces) > MOST:
        raise InvalidValue("faces (number)", len(faces), f"at most {MOST}")
    if faces.size and (faces.min() < 0 or faces.max() >= count):
        wrong = int(faces.min() if faces.min() < 0 else faces.max())
        raise InvalidValue("faces", wrong, f"numbers of points, 0 to {count - 1}")
    return faces.astype(np.int32)


def checked_colors(values: ArrayLike, count: int) -> NDArray[np.uint8]:
    """A fresh array of colours of so many points, (n, 3), 0 to 255.

    Args:
        values: whole numbers from 0 to 255, or others from 0 to 1.
        count: how many points there are.

    Raises:
        InvalidValue: not numbers, another shape, or out of these ranges.
    """
    try:
        colors = np.array(values)
    except (TypeError, ValueError):
        colors = np.zeros(0)
    if colors.shape != (count, 3) or colors.dtype.kind not in "iuf":
        raise InvalidValue("colors", values, f"red, green and blue of each point, {(count, 3)}")
    most = 1.0 if colors.dtype.kind == "f" else 255
    if colors.size and not (colors.min() >= 0 and colors.max() <= most):
        raise InvalidValue("colors", values, "whole numbers from 0 to 255, or others from 0 to 1")
    return np.round(colors * (255.0 if most == 1.0 else 1.0)).astype(np.uint8)
