"""One convex quadratic program; the only place that knows which solver does the work."""

from __future__ import annotations

from typing import NamedTuple

import daqp
import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

TOLERANCE = 1e-9
"""By how much the solver may miss a constraint; its rows are scaled to length 1."""

SOLVED, SOLVED_SOFTLY = 1, 2
HARD, EQUAL, SOFT = 0, 5, 8
STIFF = 1e-7
"""How little rows yield that may: the inverse of what their violation costs."""

SHORT = 1e-12
"""Length of a row that counts as none."""

NONE = 1e30
"""What the solver takes for no bound."""


class Rows(NamedTuple):
    """Linear constraints least <= matrix @ x.

    Attributes:
        matrix: one row for each, (r, n).
        least: smallest value of each, (r,).
    """

    matrix: Array
    least: Array

    def normal(self) -> Rows:
        """The same constraints with rows of length 1."""
        lengths = np.maximum(np.linalg.norm(self.matrix, axis=1), SHORT)
        return Rows(self.matrix / lengths[:, None], self.least / lengths)

    def lowest(self, lower: Array, upper: Array) -> Array:
        """The smallest value of each row within a box, (r,)."""
        return np.asarray(np.minimum(self.matrix * lower, self.matrix * upper).sum(axis=1))


class Solution(NamedTuple):
    """What the solver found.

    Attributes:
        x: the minimiser, within its box, (n,); None if the solver failed.
        binding: which of the rows hold with equality, (r,).
        softened: whether rows had to be violated, because they contradict each other or the box.
    """

    x: Array | None
    binding: NDArray[np.bool_]
    softened: bool


def solve(
    hessian: Array,
    gradient: Array,
    lower: Array,
    upper: Array,
    rows: Rows | None = None,
    equal: tuple[Array, Array] | None = None,
) -> Solution:
    """Minimise x^T H x / 2 + g^T x within a box, subject to rows.

    If the rows cannot all hold, they are violated as little as possible; the box always holds, and so do the
    equations, which the caller has to know to be possible within the box.

    Args:
        hessian: H, symmetric positive definite, (n, n).
        gradient: g, (n,).
        lower: smallest x, (n,).
        upper: largest x, (n,).
        rows: inequalities; none if None.
        equal: matrix (e, n) and right-hand side (e,) of equations; none if None.
    """
    n = len(gradient)
    all_rows = Rows(np.zeros((0, n)), np.zeros(0)) if rows is None else rows.normal()
    binding = np.zeros(len(all_rows.least), dtype=np.bool_)
    # Most rows cannot bind within the box; the solver would pay for each.
    possible = np.flatnonzero(all_rows.lowest(lower, upper) < all_rows.least)
    matrix, least = all_rows.matrix[possible], all_rows.least[possible]
    equations = (np.zeros((0, n)), np.zeros(0)) if equal is None else equal

    def ask(hessian: Array, gradient: Array, least: Array, soft: bool) -> Array | None:
        size = max(float(np.trace(hessian)) / n, 1e-300)
        kinds = np.repeat([HARD, SOFT if soft else HARD, EQUAL], [n, len(least), len(equations[1])])
        x, _, flag, _ = daqp.solve(
            np.ascontiguousarray(hessian / size),
            gradient / size,
            np.ascontiguousarray(np.vstack([matrix, equations[0]])),
            np.concatenate([upper, np.full(len(least), NONE), equations[1]]),
            np.concatenate([lower, least, equations[1]]),
            kinds.astype(np.int32),
            primal_tol=TOLERANCE,
            eq_reduction=-1,
            rho_soft=STIFF,
        )
        return x if flag in (SOLVED, SOLVED_SOFTLY) and np.all(np.isfinite(x)) else None

    x, softened = ask(hessian, gradient, least, soft=False), False
    if x is None and len(least):
        softened, nearest = True, ask(np.eye(n), np.zeros(n), least, soft=True)
        if nearest is not None:  # what can be had of the rows, and then the best with that
            least = np.minimum(least, matrix @ nearest - TOLERANCE)
            x = ask(hessian, gradient, least, soft=False)
            x = nearest if x is None else x
    if x is None:
        return Solution(None, binding, softened)
    x = np.minimum(np.maximum(x, lower), upper)
    binding[possible] = matrix @ x <= least + 10.0 * TOLERANCE
    return Solution(x, binding, softened)
