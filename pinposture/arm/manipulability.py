"""Manipulability indices of every section of the arm at once (Section 4.3)."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]


def section_grams(jacobians: Array, module_starts: NDArray[np.intp]) -> Array:
    """Gram matrices J J^T of every section that ends at a control point.

    The Jacobian of control point i relative to control point s is J_i without the columns of the
    modules up to s. Its Gram matrix is therefore a sum of outer products over the modules s+1..i:
    one reversed running sum gives all of them, with no subtraction and hence no cancellation.

    Args:
        jacobians: position Jacobians (m, d, n) [m/rad], columns in chain order, any frame.
        module_starts: index of the first column of each module, (m,).

    Returns:
        Array (m, m, d, d): entry [s, i - 1] belongs to the section (s, i]; zero where s >= i.
    """
    by_module = np.add.reduceat(np.einsum("kau,kbu->ukab", jacobians, jacobians), module_starts, axis=0)
    return np.ascontiguousarray(np.cumsum(by_module[::-1], axis=0)[::-1])


def index_of_gram(gram: Array) -> Array:
    """Manipulability index w = (product of sigma) / sigma_max^d of (4.3), (4.4).

    Args:
        gram: Gram matrices J J^T, (..., d, d) with d = 2 or 3; their eigenvalues are sigma^2.

    Returns:
        Array (...) of indices in [0, 1]; 0 where the Jacobian is zero. Resolved to about 1e-8,
        because the determinant of a Gram matrix is only known to machine precision.
    """
    dimension = gram.shape[-1]
    largest = _largest_eigenvalue(gram)
    scale = np.where(largest > 0.0, largest, 1.0)
    determinant = np.maximum(_determinant(gram / scale[..., None, None]), 0.0)
    index = np.where(largest > 0.0, np.sqrt(determinant), 0.0)
    return np.minimum(index, 1.0) if dimension > 1 else index


def all_pairs(jacobians: Array, module_starts: NDArray[np.intp]) -> Array:
    """Index w[s, i] of every control point i relative to every control point s < i (0 is the base).

    Args:
        jacobians: position Jacobians (m, d, n) [m/rad], columns in chain order, any frame.
        module_starts: index of the first column of each module, (m,).

    Returns:
        Array (m + 1, m + 1), zero on and below the diagonal.
    """
    m = jacobians.shape[0]
    indices = np.zeros((m + 1, m + 1))
    indices[:-1, 1:] = np.triu(index_of_gram(section_grams(jacobians, module_starts)))
    return indices


def _determinant(a: Array) -> Array:
    if a.shape[-1] == 2:
        return np.asarray(a[..., 0, 0] * a[..., 1, 1] - a[..., 0, 1] * a[..., 1, 0])
    minor_x = a[..., 1, 1] * a[..., 2, 2] - a[..., 1, 2] * a[..., 2, 1]
    minor_y = a[..., 1, 0] * a[..., 2, 2] - a[..., 1, 2] * a[..., 2, 0]
    minor_z = a[..., 1, 0] * a[..., 2, 1] - a[..., 1, 1] * a[..., 2, 0]
    return np.asarray(a[..., 0, 0] * minor_x - a[..., 0, 1] * minor_y + a[..., 0, 2] * minor_z)


def _largest_eigenvalue(a: Array) -> Array:
    """Closed form for symmetric 2x2 and 3x3 matrices; LAPACK on many tiny matrices is ten times slower."""
    dimension = a.shape[-1]
    mean = np.trace(a, axis1=-2, axis2=-1) / dimension
    deviation = a - mean[..., None, None] * np.eye(dimension)
    spread = np.sqrt(np.einsum("...ab,...ab->...", deviation, deviation) / (dimension * (dimension - 1)))
    if dimension == 2:
        return np.asarray(mean + spread)
    safe = np.where(spread > 0.0, spread, 1.0)
    cosine = np.clip(_determinant(deviation / safe[..., None, None]) / 2.0, -1.0, 1.0)
    return np.asarray(mean + 2.0 * spread * np.cos(np.arccos(cosine) / 3.0))
