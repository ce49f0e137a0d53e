"""How far joints may go in one step: braking in discrete time, as `control.braking` derives it."""

from __future__ import annotations

import numpy as np

from pinposture.kernels.arrays import Array1, Array2, Flags1, Ints1
from pinposture.kernels.compiled import compiled, subkernel

MOST = 1e60
"""Number of braking steps that counts as any number: a joint without position limits has that many."""

SHORT, OUTSIDE = 1, 2
"""What `step_box` returns, added up: limits that cannot be kept; a joint of the chain outside its limits."""


@subkernel
def _farthest(room: float, brake: float) -> float:
    """The largest step towards a place at which a joint can still stop; g in `control.braking`."""
    distance = abs(room)
    steps = min(max(np.ceil(np.sqrt(0.25 + distance * (2.0 / brake)) - 0.5), 1.0), MOST)
    return float(np.copysign(distance / steps + 0.5 * brake * (steps - 1.0), room))


@compiled
def stoppable_steps(rooms: Array2, brake: Array1, filled: Array2) -> None:
    """`_farthest` for each room, (r, nv), with brakes (nv,); fills (r, nv)."""
    for i in range(len(rooms)):
        for u in range(len(brake)):
            filled[i, u] = _farthest(rooms[i, u], brake[u])


@compiled
def step_box(
    positions: Array1,
    edges: Array2,
    bound: Array1,
    brake: Array1,
    previous: Array1,
    rounding: float,
    columns: Ints1,
    leaning: Array1,
    limits: Array2,
) -> int:
    """The steps that each joint may take; see `Limits.box`.

    Args:
        positions: joint positions, (nv,).
        edges: positions to stay between, (2, nv).
        bound: largest |dq|, (nv,).
        brake: largest change of dq from one step to the next, (nv,); empty: any.
        previous: the step before, (nv,); empty where it does not matter.
        rounding: what a limit may be exceeded by.
        columns: which of the joints are on the chain, (n,).
        leaning: how far each of them may be outside its limits, (n,).
        limits: filled with smallest and largest step, (2, nv).

    Returns:
        Sum of `SHORT` and `OUTSIDE`, where they are so.
    """
    found = 0
    for u in range(len(positions)):
        low, high = edges[0, u] - positions[u], edges[1, u] - positions[u]
        slowest = 0.0
        smallest, largest = low, high
        if len(brake):
            low, high = _farthest(low, brake[u]), _farthest(high, brake[u])
            before = previous[u]
            slowest = before - min(max(before, -brake[u]), brake[u])
            smallest = min(max(low, before - brake[u]), before + brake[u])
            largest = min(max(high, before - brake[u]), before + brake[u])
        limits[0, u] = min(max(smallest, -bound[u]), bound[u])
        limits[1, u] = min(max(largest, -bound[u]), bound[u])
        above = min(high, bound[u]) - max(slowest, 0.0)
        below = min(slowest, 0.0) - max(low, -bound[u])
        if min(above, below) < -rounding:
            found = SHORT
    for i in range(len(columns)):
        u = columns[i]
        if positions[u] < edges[0, u] - leaning[i] or positions[u] > edges[1, u] + leaning[i]:
            return found + OUTSIDE
    return found


@compiled
def shorten_step(
    dq: Array1,
    positions: Array1,
    edges: Array2,
    bound: Array1,
    brake: Array1,
    previous: Array1,
    cut: Array1,
    clipped: Flags1,
) -> float:
    """Shorten a step until it meets the step limit, then cut it; see `Limits.apply`.

    Args:
        dq: the step asked for, (nv,).
        positions: as above.
        edges: as above.
        bound: as above.
        brake: as above.
        previous: as above.
        cut: filled with what is left of it, (nv,).
        clipped: filled with which joints were cut short, (nv,).

    Returns:
        By which factor the whole step was shortened.
    """
    most = 1.0
    for u in range(len(dq)):
        most = max(most, abs(dq[u]) / bound[u])
    scale = 1.0 / most
    for u in range(len(dq)):
        low, high = edges[0, u] - positions[u], edges[1, u] - positions[u]
        if len(brake):
            low, high = _farthest(low, brake[u]), _farthest(high, brake[u])
        scaled = dq[u] * scale
        cut[u] = min(max(min(max(scaled, low), high), -bound[u]), bound[u])
        clipped[u] = cut[u] != scaled
        if len(brake):
            near, far = previous[u] - brake[u], previous[u] + brake[u]
            low = min(max(min(max(low, near), far), -bound[u]), bound[u])
            high = min(max(min(max(high, near), far), -bound[u]), bound[u])
            goal = abs(_farthest(dq[u], brake[u]))
            cut[u] = min(max(min(max(scaled, -goal), goal), low), high)
    return scale
