"""Candidate control sets by exhaustion, the choice among them, and the manipulability index.

w is (m + 1, m + 1): w[s, i] is the index of control point i relative to control point s, where 0 is the base.
Sets are ascending tuples of control points 1..m. Both conditions are strict: an index equal to its threshold
fails.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from itertools import combinations, pairwise

import numpy as np
from numpy.typing import ArrayLike, NDArray

Array = NDArray[np.float64]
ControlSet = tuple[int, ...]


def index(J: ArrayLike) -> float:
    """w = (product of sigma) / sigma_max^d of a (d, n) Jacobian, (4.3) and (4.4); 0 if n < d or J = 0."""
    J = np.asarray(J, dtype=float)
    d, n = J.shape
    sigma = np.linalg.svd(J, compute_uv=False)
    return float(np.prod(sigma / sigma[0])) if n >= d and sigma[0] > 0 else 0.0


def index_matrix(section: Callable[[int, int], Array], m: int) -> Array:
    """w from section(s, i), the Jacobian of point i relative to point s < i; 0 where s >= i."""
    w = np.zeros((m + 1, m + 1))
    for s, i in combinations(range(m + 1), 2):
        w[s, i] = index(section(s, i))
    return w


def candidate_sets(w: Array, absolute: float, relative: float) -> list[ControlSet]:
    """All candidate control sets, sorted, by Figure 4.5: from the tip back, on the sets known so far."""
    m = len(w) - 1
    starting_at: dict[int, list[ControlSet]] = {}
    for k in range(m, 0, -1):
        starting_at[k] = [(k,)] if w[0, k] > absolute else []
        if starting_at[k]:
            for i in range(k + 1, m + 1):
                if w[k, i] > relative:
                    starting_at[k] += [(k, *rest) for rest in starting_at[i]]
    return sorted(s for sets in starting_at.values() for s in sets)


def candidate_sets_by_subsets(w: Array, absolute: float, relative: float) -> list[ControlSet]:
    """The same by testing every subset of 1..m against both conditions, sorted."""
    members = range(1, len(w))
    return sorted(
        subset
        for size in range(1, len(w))
        for subset in combinations(members, size)
        if all(w[0, i] > absolute for i in subset) and all(w[s, i] > relative for s, i in pairwise(subset))
    )


def best_by_score(sets: Sequence[ControlSet], errors: ArrayLike) -> ControlSet:
    """The set with the largest sum (4.5) of errors[k - 1] over its points k. Ties: the first; no sets: ()."""
    errors = np.asarray(errors)
    return max(sets, key=lambda chosen: sum(errors[k - 1] for k in chosen), default=())
