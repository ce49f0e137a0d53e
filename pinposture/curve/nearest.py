"""The place on a curve that is nearest to a point, over all of the curve."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from pinposture import kernels
from pinposture.curve.arclength import ArcLength
from pinposture.curve.bspline import Spline

Values = NDArray[np.float64]

_PIECES = 256  # at least so many pieces to a curve


class Nearest(NamedTuple):
    """Where a curve comes nearest to each of some points; single numbers for a single point.

    Attributes:
        parameter: arc length from the start of the curve, shape (n,) [m].
        distance: from the point to there, shape (n,) [m].
    """

    parameter: Values
    distance: Values


def nearest(spline: Spline, arc: ArcLength, points: Values) -> Nearest:
    """Find the nearest places to `points` (n, 3); of several equally near, one of them."""
    found = kernels.nearest_places(
        spline.knots, spline.table, spline.degree, arc.edges, arc.lengths, arc.series, _PIECES, points
    )
    return Nearest(found[:, 0].copy(), found[:, 1].copy())
