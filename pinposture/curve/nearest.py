"""The place on a curve that is nearest to a point, over all of the curve."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.interpolate import BSpline
from scipy.spatial.distance import cdist

from pinposture.curve.arclength import ArcLength
from pinposture.curve.bspline import derivative
from pinposture.curve.newton import crossings

Values = NDArray[np.float64]

_PIECES = 256  # at least so many pieces to a curve
_ENTRIES = 2_000_000  # of a distance table held at a time


class Nearest(NamedTuple):
    """Where a curve comes nearest to each of some points; single numbers for a single point.

    Attributes:
        parameter: arc length from the start of the curve, shape (n,) [m].
        distance: from the point to there, shape (n,) [m].
    """

    parameter: Values
    distance: Values


def nearest(spline: BSpline, arc: ArcLength, points: Values) -> Nearest:
    """Find the nearest places to `points` (n, 3); of several equally near, one of them.

    The curve is cut into pieces. If the middle of a piece is at a distance d, and its ends at most r away
    from there along the curve, no part of it is nearer than d - r; so each piece that could hold the nearest
    place is known, and searched.
    """
    per_edge = max(2, -(-_PIECES // (len(arc.edges) - 1)))
    share = np.arange(per_edge) / per_edge
    ends = (arc.edges[:-1, None] + np.diff(arc.edges)[:, None] * share).ravel()
    low, high = ends, np.append(ends[1:], arc.edges[-1])
    middle = 0.5 * (low + high)
    s_low, s_middle, s_high = (arc.length_at(u) for u in (low, middle, high))
    reach = np.maximum(s_middle - s_low, s_high - s_middle)
    places = spline(middle)
    parameter, distance = np.empty(len(points)), np.empty(len(points))
    rows = max(1, _ENTRIES // len(low))
    for begin in range(0, len(points), rows):
        chunk = slice(begin, begin + rows)
        table = cdist(points[chunk], places)
        nearest_middle = table.min(axis=1) * (1 + 1e-12)
        row, piece = np.nonzero(table - reach <= nearest_middle[:, None])
        u = _search(spline, points[chunk][row], low[piece], high[piece])
        gap = np.linalg.norm(spline(u) - points[chunk][row], axis=1)
        order = np.lexsort((gap, row))
        best = order[np.unique(row[order], return_index=True)[1]]  # every row has at least its nearest middle
        parameter[chunk], distance[chunk] = arc.length_at(u[best]), gap[best]
    return Nearest(parameter, distance)


def _search(spline: BSpline, points: Values, low: Values, high: Values) -> Values:
    """Parameters (n,) of the nearest places to `points` (n, 3), each within its piece [low, high]."""

    def slopes(u: Values) -> tuple[Values, Values]:
        """Half the first and second derivatives of the squared distance."""
        offset, d1, d2 = spline(u) - points, derivative(spline, u, 1), derivative(spline, u, 2)
        value = np.einsum("ni,ni->n", offset, d1)
        return value, np.einsum("ni,ni->n", d1, d1) + np.einsum("ni,ni->n", offset, d2)

    inner_high = np.nextafter(high, low)  # a corner there belongs to the next piece
    at_low, at_high = slopes(low)[0], slopes(inner_high)[0]
    bracketed = (at_low < 0) & (at_high > 0)
    guess = np.where(bracketed, 0.5 * (low + high), low)
    inside = crossings(slopes, low, np.where(bracketed, inner_high, low), guess)
    places = np.stack([inside, low, high])
    gaps = np.linalg.norm(spline(places) - points, axis=2)
    return np.asarray(np.take_along_axis(places, gaps.argmin(axis=0)[None], axis=0)[0])
