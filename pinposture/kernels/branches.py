"""The best branch of a tree of sections, without looking at the branches one by one."""

from __future__ import annotations

import numpy as np

from pinposture.kernels.arrays import Array1, Array2, Flags2, Ints1
from pinposture.kernels.compiled import compiled


@compiled
def best_branch(
    root: int,
    leaf: int,
    strides: Ints1,
    stable: Flags2,
    logs: Array2,
    bonus: Array1,
    mean: bool,
    path: Ints1,
) -> tuple[int, float]:
    """The branch with the largest score: a bonus for the edges left, and their indices.

    Of all ways to a node on which as many edges are left, only that with the largest product of indices can
    be part of it. Of equally good ones the first is taken, by its end, its edges and its strides.

    Args:
        root: the node at which all branches begin.
        leaf: the last node.
        strides: how many modules an edge may have, (S,); increasing.
        stable: which edges are left, by stride and by the node they lead to, (S, N).
        logs: logarithms of their indices, (S, N).
        bonus: added to the logarithm of the score for each number of edges left, (C,); minus infinity for
            a number that does not count.
        mean: True for the geometric mean of the indices, False for their product.
        path: filled with the nodes that the edges left lead to, from the last to the first, (N,).

    Returns:
        Number of edges left, and the logarithm of the score; minus infinity if there is no branch.
    """
    counts = len(bonus)
    product = np.full((leaf + 1, counts), -np.inf)  # its logarithm, by node and edges left
    before = np.zeros((leaf + 1, counts), np.int16)  # the stride of the last edge
    product[root, 0] = 0.0
    for node in range(root + strides[0], leaf + 1):
        most = min(counts, (node - root) // strides[0] + 1)
        for j in range(len(strides)):
            start = node - strides[j]
            if start < root:
                break
            gained = 1 if stable[j, node] else 0
            log = logs[j, node] if gained else 0.0
            for left in range(gained, most):
                reached = product[start, left - gained] + log
                if reached > product[node, left]:
                    product[node, left] = reached
                    before[node, left] = j
    node, left, best = root, 0, -np.inf
    for end in range(max(root, leaf - strides[0] + 1), leaf + 1):
        for edges in range(counts):
            score = bonus[edges] + (product[end, edges] / max(edges, 1) if mean else product[end, edges])
            if score > best:
                node, left, best = end, edges, score
    count = 0
    while node != root:
        j = before[node, left]
        if stable[j, node]:
            path[count] = node
            count += 1
            left -= 1
        node -= strides[j]
    return count, best
