"""How far control points travel, against how far they had to."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray


def sweep(points: NDArray[np.float64]) -> float:
    """Length of the paths of all control points relative to the direct distances from start to end.

    Args:
        points: control points of a motion, (steps + 1, m, 3) [m].

    Returns:
        1 for motion on straight lines, more for detours; 1 also if all ended where they began.
    """
    paths = float(np.linalg.norm(np.diff(points, axis=0), axis=2).sum())
    direct = float(np.linalg.norm(points[-1] - points[0], axis=1).sum())
    return max(paths / direct, 1.0) if direct > 1e-12 * paths else 1.0
