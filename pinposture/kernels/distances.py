"""Lower bounds of the distances of many lines from many boxes."""

from __future__ import annotations

import numpy as np

from pinposture.kernels.arrays import Array1, Array2, Array3, Array4, Ints1
from pinposture.kernels.compiled import compiled


@compiled
def above_boxes(
    ends: Array4,
    lines: Ints1,
    centers: Array2,
    axes: Array3,
    halves: Array2,
    quarters: Array1,
    lower: Array2,
) -> None:
    """Bound the distance of lines from boxes: that of both ends and the middle, less a quarter of the line.

    No place on a line is farther from the nearest of the three than that.

    Args:
        ends: ends of lines in several configurations, (s, k, 2, 3).
        lines: the line of each pair, (n,).
        centers: centre of the box of each pair, (n, 3).
        axes: its axes, as columns, (n, 3, 3).
        halves: half its edges, (n, 3).
        quarters: a quarter of the length of the line of each pair, (n,).
        lower: filled with the bounds, (s, n).
    """
    for s in range(len(ends)):
        for pair in range(len(lines)):
            line, least = ends[s, lines[pair]], np.inf
            for place in range(3):
                squares = 0.0
                for axis in range(3):
                    along = 0.0
                    for i in range(3):
                        at = line[0, i] if place == 0 else line[1, i]
                        if place == 2:
                            at = 0.5 * (line[0, i] + line[1, i])
                        along += (at - centers[pair, i]) * axes[pair, i, axis]
                    outside = abs(along) - halves[pair, axis]
                    if outside > 0.0:
                        squares += outside * outside
                least = min(least, squares)
            lower[s, pair] = np.sqrt(least) - quarters[pair]
