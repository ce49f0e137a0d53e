"""Candidate control sets, and the active one among them (Sections 4.3 and 4.4).

A set of control points is a candidate if each of its points clears the absolute manipulability
condition and each pair of neighbours in it the relative one. Both concern single points and pairs of
neighbours only, so the sets are the paths of a directed graph, and the set with the largest sum of
errors is a longest path: found in O(m^2), without looking at the up to 2^m sets.
"""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
from numpy.typing import NDArray

from pinposture import kernels
from pinposture.arm import Arm
from pinposture.arm.screws import constants_of
from pinposture.errors import InvalidValue
from pinposture.kernels.arrays import Screws

Array = NDArray[np.float64]
Whole = NDArray[np.int64]


def candidate_sets(indices: Array, absolute: float, relative: float) -> Iterator[tuple[int, ...]]:
    """Enumerate all candidate control sets, one at a time (Figure 4.5).

    Args:
        indices: manipulability indices (m + 1, m + 1) as `ArmState.manipulability` gives them.
        absolute: threshold that the index of each point relative to the base must exceed.
        relative: threshold that the index of each point relative to the one before it must exceed.

    Yields:
        Increasing tuples of control point indices, 0-based. There can be 2^m - 1 of them: take what you
        need from the iterator.
    """
    clears, follows = _conditions(indices, absolute, relative)

    def continued(path: tuple[int, ...]) -> Iterator[tuple[int, ...]]:
        yield path
        for i in np.flatnonzero(follows[path[-1]]):
            yield from continued((*path, int(i)))

    for first in np.flatnonzero(clears):
        yield from continued((int(first),))


def active_set(
    indices: Array, errors: Array, absolute: float, relative: float, eligible: NDArray[np.bool_] | None = None
) -> tuple[int, ...]:
    """The candidate control set with the largest sum of errors (4.5), without enumerating any.

    Args:
        indices: manipulability indices (m + 1, m + 1).
        errors: distance of each control point from its target, (m,) [m].
        absolute: threshold of the absolute condition.
        relative: threshold of the relative condition.
        eligible: which points may be used at all, (m,); all of them if None.

    Returns:
        Increasing indices of control points, 0-based; empty if there is no candidate set.
    """
    clears, follows = _conditions(indices, absolute, relative)
    if eligible is not None:
        clears = clears & eligible
    follows = follows & clears[:, None] & clears[None, :]
    score = np.where(clears, errors, -np.inf)
    before = np.full(len(errors), -1)
    for i in np.flatnonzero(clears):
        reaching = np.where(follows[:i, i], score[:i], 0.0)
        best = int(reaching.argmax()) if i else 0
        if i and reaching[best] > 0.0:
            score[i] += reaching[best]
            before[i] = best
    if not np.any(clears):
        return ()
    path = [int(np.argmax(score))]
    while before[path[-1]] >= 0:
        path.append(int(before[path[-1]]))
    return tuple(reversed(path))


def base_indices(arm: Arm, screws: Screws, threshold: float) -> Array:
    """Indices of all control points relative to the base, (m,), to be compared with a threshold."""
    indices = np.empty(arm.n_modules)
    kernels.base_indices(*screws, constants_of(arm).plane, threshold, indices)
    return indices


def best_set(arm: Arm, screws: Screws, usable: NDArray[np.bool_], errors: Array, relative: float) -> Whole:
    """The same set as `active_set`, without the indices of all sections: few of them are looked at.

    Args:
        arm: the arm.
        screws: how its joints move it.
        usable: which control points clear the absolute condition and may be used, (m,).
        errors: distance of each control point from its target, (m,) [m].
        relative: threshold of the relative condition.

    Returns:
        Increasing indices of control points, 0-based; empty if there is no candidate set.
    """
    path = np.empty(arm.n_modules, dtype=np.int64)
    count = kernels.best_path(*screws, constants_of(arm).plane, usable, errors, relative, path)
    return path[:count]


def _conditions(
    indices: Array, absolute: float, relative: float
) -> tuple[NDArray[np.bool_], NDArray[np.bool_]]:
    """Which points clear the absolute condition (m,), and which may follow which (m, m)."""
    if indices.ndim != 2 or indices.shape[0] != indices.shape[1] or indices.shape[0] < 2:
        raise InvalidValue("indices (shape)", indices.shape, "(m + 1, m + 1) with m >= 1")
    clears = indices[0, 1:] > absolute
    return clears, np.triu(indices[1:, 1:] > relative, 1) & clears[:, None] & clears[None, :]
