"""Modules that take given points one after the other, with a search back where a choice was wrong."""

from __future__ import annotations

import numpy as np

from pinposture.kernels.arrays import Array1, Array2, Ints2
from pinposture.kernels.compiled import compiled
from pinposture.kernels.units import base_frame, seen, solutions, turned, within


@compiled
def take_points(
    units: Ints2,
    shapes: Array2,
    lower: Array1,
    upper: Array1,
    base: Array1,
    points: Array2,
    tries: int,
    positions: Array1,
) -> bool:
    """Find joint positions that put the end of every module at its point.

    Args:
        units: of `walk.walk_along`, one for each module.
        shapes: likewise.
        lower: lower limits of the joints of the chain.
        upper: upper limits.
        base: where the first module begins, (3,).
        points: where the modules end, (m, 3).
        tries: how many solutions to look at before giving up.
        positions: filled with the positions of the joints of the chain.

    Returns:
        Whether there are such positions, as far as was looked.
    """
    m = len(units)
    turns, frames = np.zeros((m + 1, 3, 3)), np.empty((m, 3, 3))
    choices, number, taken = np.empty((m, 2, 2)), np.zeros(m, np.int64), np.zeros(m, np.int64)
    turns[0, 0, 0] = turns[0, 1, 1] = turns[0, 2, 2] = 1.0
    k, arrived = 0, True
    for _ in range(tries):
        dof, joint = units[k, 0], units[k, 1]
        if arrived:
            frame = frames[k]
            base_frame(turns[k], shapes[k], frame)
            start = points[k - 1] if k > 0 else base
            way = points[k] - start
            x, y, z = seen(frame, way[0], way[1], way[2])
            number[k], taken[k] = solutions(dof, shapes[k], x, y, z, choices[k]), 0
        while taken[k] < number[k] and not within(dof, choices[k, taken[k]], joint, lower, upper):
            taken[k] += 1
        if taken[k] == number[k]:  # none is left here: another one for the module before
            if k == 0:
                return False
            k -= 1
            arrived = False
            continue
        q = choices[k, taken[k]]
        taken[k] += 1
        for j in range(dof):
            positions[joint + j] = q[j]
        if k == m - 1:
            return True
        turned(dof, shapes[k], q, frames[k], turns[k + 1])
        k += 1
        arrived = True
    return False
