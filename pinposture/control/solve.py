"""The step that a posture control matrix of full row rank allows (4.7)."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]


class Decomposition(NamedTuple):
    """Singular value decomposition of a posture control matrix J = left diag(sigma) right.

    Attributes:
        left: left singular vectors as columns, (r, r).
        sigma: singular values, descending, (r,) [m/rad].
        right: right singular vectors as rows, (r, nv).
    """

    left: Array
    sigma: Array
    right: Array


def decompose(matrix: Array) -> Decomposition:
    """Decompose a posture control matrix (r, nv) with r <= nv."""
    return Decomposition(*np.linalg.svd(matrix, full_matrices=False))


def pseudo_inverse_step(matrix: Decomposition, velocity: Array, gradient: Array) -> Array:
    """J^+ dr + (I - J^+ J) g: follow the velocities exactly, and g as far as they leave room (4.7).

    Args:
        matrix: decomposition of J; its smallest singular value is positive.
        velocity: desired velocities of the rows, (r,) [m].
        gradient: desired joint displacement, (nv,), in the units of the columns of J.

    Returns:
        Joint displacement (nv,) in the same units.
    """
    along = matrix.right @ gradient
    return np.asarray(gradient + matrix.right.T @ ((matrix.left.T @ velocity) / matrix.sigma - along))
