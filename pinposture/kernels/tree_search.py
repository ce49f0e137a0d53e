"""Bidirectional tree search among obstacles, with checked motions: RRT-Connect (Kuffner and LaValle 2000)."""

from __future__ import annotations

import numpy as np

from pinposture.kernels.arrays import (
    OUTCOME,
    STATE,
    Array1,
    Array2,
    Array3,
    Ints1,
    Joints,
    MotionSearch,
    Pairs,
    SearchTrees,
    TreeSettings,
)
from pinposture.kernels.compiled import compiled, subkernel
from pinposture.kernels.continuous_collision import smallest_distance_on_motions


@compiled
def grow_trees(
    joints: Joints,
    carriers: Ints1,
    local: Array3,
    pairs: Pairs,
    others: Array2,
    start: Array1,
    units: Array1,
    trees: SearchTrees,
    samples: Array2,
    settings: TreeSettings,
    refused: bool,
) -> tuple[int, int]:
    """Grow two trees in turns until they meet.

    One extends by a step towards a sample; if that is clear, the other goes as far as it can towards the new
    node. A distance is kept on all edges, as far as the pairs are exact. `OUTCOME.open` leaves an edge to
    the caller, who calls again with the samples that are left.

    Args:
        joints: the joints.
        carriers: as for `smallest_distance_on_motions`.
        local: as for `smallest_distance_on_motions`.
        pairs: the pairs.
        others: as for `smallest_distance_on_motions`.
        start: joint positions at offset zero, (nv,).
        units: joint motion that counts as one, (nv,).
        trees: both trees, updated; the largest number of nodes is the room for one tree, less one.
        samples: offsets towards which the trees grow, (s, nv).
        settings: the settings.
        refused: whether the caller takes the last edge back.

    Returns:
        The outcome, of `OUTCOME`, and the number of samples that are used.
    """
    nodes, parents, counts, state = trees
    size = len(start)
    ends = np.empty((2, size))
    still = np.zeros((2, 3))
    nothing = np.empty((0, 6))
    unknown = np.empty((2, 0))
    search = MotionSearch(settings.least, settings.least, settings.tolerance, settings.open_motion)
    used = 0
    clear = True
    if refused:
        counts[state[STATE.last]] -= 1
        clear = False
    while True:
        if not clear or state[STATE.met] >= 0:  # the next turn
            if clear:
                return OUTCOME.joined, used
            state[STATE.turn] = 1 - state[STATE.turn]
            state[STATE.at] = -1
            state[STATE.met] = -1
            used += 1
        if used >= len(samples) or counts[0] + counts[1] >= nodes.shape[1]:
            return OUTCOME.ended, used
        joining = state[STATE.at] >= 0
        tree = 1 - state[STATE.turn] if joining else state[STATE.turn]
        wanted = nodes[state[STATE.turn], state[STATE.at]] if joining else samples[used]
        reached, largest = _nearest(nodes[tree], counts[tree], wanted, units)
        whole = largest <= settings.step
        opened = 0
        if largest > 0.0:
            share = 1.0 if whole else settings.step / largest
            near = nodes[tree, reached]
            added = nodes[tree, counts[tree]]
            for u in range(size):
                added[u] = wanted[u] if whole else near[u] + share * (wanted[u] - near[u])
                ends[0, u] = start[u] + near[u]
                ends[1, u] = start[u] + added[u]
            distance, _, opened = smallest_distance_on_motions(
                joints,
                carriers,
                local,
                pairs,
                ends,
                others,
                still,
                search,
                unknown,
                nothing,
            )
            clear = distance >= settings.least
            if not clear:
                continue
            parents[tree, counts[tree]] = reached
            reached = counts[tree]
            counts[tree] += 1
            state[STATE.last] = tree
        if not joining:
            state[STATE.at] = reached
        elif whole:
            state[STATE.met] = reached
        if largest > 0.0 and (opened > 0 or settings.doubtful):
            return OUTCOME.open, used


@subkernel
def _nearest(nodes: Array2, count: int, wanted: Array1, units: Array1) -> tuple[int, float]:
    """Return the node nearest to an offset, and the largest difference of a joint, in units."""
    best = np.inf
    found = 0
    for k in range(count):
        squares = 0.0
        for u in range(len(wanted)):
            apart = (nodes[k, u] - wanted[u]) / units[u]
            squares += apart * apart
            if squares >= best:
                break
        if squares < best:
            best = squares
            found = k
    largest = 0.0
    for u in range(len(wanted)):
        largest = max(largest, abs(nodes[found, u] - wanted[u]) / units[u])
    return found, largest
