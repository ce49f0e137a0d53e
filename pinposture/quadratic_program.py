"""Strictly convex quadratic programs with linear constraints, by the active-set solver DAQP."""

from __future__ import annotations

from enum import IntEnum
from typing import NamedTuple

import daqp
import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]


class RowProgramSettings(NamedTuple):
    """How a small program with rows of constraints is solved."""

    tolerance: float = 1e-9
    """Largest violation of a constraint by the solver; rows are scaled to length 1."""

    softness: float = 1e-7
    """Softness of rows that may be violated: the inverse of the weight of their violation."""

    zero_length: float = 1e-12
    """Length below which a row counts as zero."""

    no_bound: float = 1e30
    """Value that the solver treats as infinite."""


ROW_PROGRAM = RowProgramSettings()


SOLVED = (1, 2)
"""What the solver returns with a solution: all rows are kept, or soft ones are violated."""


class RowKind(IntEnum):
    """Kinds of rows, as the solver numbers them."""

    HARD = 0
    EQUAL = 5
    SOFT = 8


class ConstraintRows(NamedTuple):
    """Linear constraints matrix @ x >= least, with a matrix (r, n) and lower bounds (r,)."""

    matrix: Array
    least: Array

    def joined(self, other: ConstraintRows) -> ConstraintRows:
        """Return both together."""
        return ConstraintRows(np.vstack([self.matrix, other.matrix]), np.append(self.least, other.least))

    def normal(self) -> ConstraintRows:
        """Return the same constraints with rows of length 1."""
        lengths = np.maximum(np.linalg.norm(self.matrix, axis=1), ROW_PROGRAM.zero_length)
        return ConstraintRows(self.matrix / lengths[:, None], self.least / lengths)

    def lowest(self, lower: Array, upper: Array) -> Array:
        """Return the smallest value of each row within a box, (r,)."""
        return np.asarray(np.minimum(self.matrix * lower, self.matrix * upper).sum(axis=1))


class Solution(NamedTuple):
    """Solution of a quadratic program.

    Attributes:
        x: the minimiser, within its box, (n,); None if the solver failed.
        binding: which of the rows are active, (r,).
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
    rows: ConstraintRows | None = None,
    equal: tuple[Array, Array] | None = None,
    hard: ConstraintRows | None = None,
) -> Solution:
    """Minimise x^T H x / 2 + g^T x within a box, subject to rows.

    It takes any Hessian, and equations. Steps of points along a chain, with rows or without, are for
    `kernels.minimise_with_rows`, whose time is linear in the number of joints.

    If the rows are infeasible, they are violated as little as possible. The box always holds, and so do the
    equations, which must be feasible within it.

    Args:
        hessian: H, symmetric positive definite, (n, n).
        gradient: g, (n,).
        lower: smallest x, (n,).
        upper: largest x, (n,).
        rows: inequalities; none if None.
        equal: matrix (e, n) and right-hand side (e,) of equations; none if None.
        hard: inequalities that are never violated; none if None.
    """
    n = len(gradient)
    all_rows = ConstraintRows(np.zeros((0, n)), np.zeros(0)) if rows is None else rows.normal()
    binding = np.zeros(len(all_rows.least), dtype=np.bool_)
    # Most rows cannot bind within the box; leaving them out saves time.
    possible = np.flatnonzero(all_rows.lowest(lower, upper) < all_rows.least)
    matrix = all_rows.matrix[possible]
    least = all_rows.least[possible]
    equations = (np.zeros((0, n)), np.zeros(0)) if equal is None else equal
    strict = ConstraintRows(np.zeros((0, n)), np.zeros(0)) if hard is None else hard.normal()

    def attempt(hessian: Array, gradient: Array, least: Array, soft: bool) -> Array | None:
        size = max(float(np.trace(hessian)) / n, 1e-300)
        counts = [n, len(strict.least), len(least), len(equations[1])]
        kinds = np.repeat(
            [RowKind.HARD, RowKind.HARD, RowKind.SOFT if soft else RowKind.HARD, RowKind.EQUAL], counts
        )
        x, _, flag, _ = daqp.solve(
            np.ascontiguousarray(hessian / size),
            gradient / size,
            np.ascontiguousarray(np.vstack([strict.matrix, matrix, equations[0]])),
            np.concatenate([upper, np.full(counts[1] + counts[2], ROW_PROGRAM.no_bound), equations[1]]),
            np.concatenate([lower, strict.least, least, equations[1]]),
            kinds.astype(np.int32),
            primal_tol=ROW_PROGRAM.tolerance,
            eq_reduction=-1,
            rho_soft=ROW_PROGRAM.softness,
        )
        return x if flag in SOLVED and np.all(np.isfinite(x)) else None

    x = attempt(hessian, gradient, least, soft=False)
    softened = False
    if x is None and len(least):
        softened = True
        nearest = attempt(np.eye(n), np.zeros(n), least, soft=True)
        if nearest is not None:  # relax the rows as far as needed, then minimise within them
            least = np.minimum(least, matrix @ nearest - ROW_PROGRAM.tolerance)
            x = attempt(hessian, gradient, least, soft=False)
            x = nearest if x is None else x
    if x is None:
        return Solution(None, binding, softened)
    x = np.minimum(np.maximum(x, lower), upper)
    binding[possible] = matrix @ x <= least + 10.0 * ROW_PROGRAM.tolerance
    return Solution(x, binding, softened)
