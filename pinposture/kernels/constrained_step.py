"""Least squares along a chain with box and row constraints, in time linear in the number of joints."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from pinposture.kernels.arrays import Array1, Array2, Bytes1, Flags1, Ints1
from pinposture.kernels.chain_solver import (
    ChainProblem,
    evaluate_gradient,
    factor,
    minimise_in_box,
    solve_cholesky,
    solve_factored,
)
from pinposture.kernels.compiled import compiled, subkernel

# Each row has a Lagrange multiplier, a force that enforces it. For given multipliers, the objective is
# minimised within the box. The minimum is a concave, piecewise quadratic function of the multipliers (the
# dual function), maximal at the solution. Newton steps with a line search find it: the chain is solved once
# more for each relevant row, and a small dense system, the Schur complement, gives the step.


class RowSolverSettings(NamedTuple):
    """Settings of the search for the multipliers.

    Compliances are relative to that of joints that move one by one.
    """

    steps: int = 60
    """Largest number of Newton steps."""

    halvings: int = 4
    """Largest number of halvings of each."""

    share_of_gain: float = 1e-4
    """Smallest share of the expected gain at which a step is accepted."""

    softnesses: tuple[float, ...] = (1e-11, 1e-4, 1e-2, 1.0, 1e3)
    """Compliances of rows that regularise the Schur complement. Larger ones are tried if a step gains too
    little, because more rows are relevant than joints are free."""

    give: float = 1e-6
    """Compliance of rows that may be violated."""

    rounding: float = 1e-10
    """Violation of a row of length 1 that counts as rounding error, in units of a joint."""


ROW_SOLVER = RowSolverSettings()


@compiled
def minimise_with_rows(
    problem: ChainProblem,
    lower: Array1,
    upper: Array1,
    rows: Array2,
    least: Array1,
    violable: bool,
    active: Flags1,
    x: Array1,
) -> bool:
    """Minimise an objective along a chain within a box, subject to least <= rows x.

    For each set of multipliers `minimise_in_box` finds the minimum. Programs that have no chain, or
    equations, are for `quadratic_program.solve`.

    Args:
        problem: the objective.
        lower: smallest x, (n,).
        upper: largest x, (n,).
        rows: rows of length 1, (r, n).
        least: smallest value of each, (r,).
        violable: whether rows may be violated, with the smallest sum of squares.
        active: filled with True for rows with a positive multiplier, (r,).
        x: filled with the minimum, (n,).

    Returns:
        False if it was not found: the rows may contradict each other or the box.
    """
    n = len(x)
    count = len(rows)
    at_bound = np.zeros(n, dtype=np.int8)
    box = (lower, upper)
    centre = problem[3]
    for u in range(n):
        at_bound[u] = 1 if centre[u] > upper[u] else (-1 if centre[u] < lower[u] else 0)
    multipliers = np.zeros(count)
    change = np.empty(count)
    tried = np.empty(count)
    missing = np.empty(count)
    before = np.empty(count)
    which = np.empty(count, dtype=np.int64)
    yielding = np.empty((count, n))
    give = ROW_SOLVER.give * _find_alone(problem, box, rows) if violable else 0.0
    active[:] = False
    value = _minimise_given(problem, box, rows, least, give, multipliers, at_bound, x, missing)
    for _ in range(ROW_SOLVER.steps):
        counting = 0
        settled = True
        for row in range(count):
            if multipliers[row] > 0.0 or missing[row] > ROW_SOLVER.rounding:
                which[counting] = row
                counting += 1
                settled = settled and abs(missing[row]) <= ROW_SOLVER.rounding
        if settled:
            for row in range(count):
                active[row] = multipliers[row] > 0.0
            return True
        schur, alone = _find_schur(problem, box, rows, which[:counting], at_bound, yielding)
        for k in range(counting):
            schur[k, k] += give
        better = False
        before[:] = missing
        for softness in ROW_SOLVER.softnesses:
            soft = softness * alone
            expected = _step_multipliers(schur, soft, which[:counting], before, multipliers, change)
            share = 1.0
            for _ in range(ROW_SOLVER.halvings):
                for row in range(count):
                    tried[row] = max(multipliers[row] + share * change[row], 0.0)
                found = _minimise_given(problem, box, rows, least, give, tried, at_bound, x, missing)
                gain = found - value + 1e-14 * abs(value)
                better = expected >= 0.0 and gain >= ROW_SOLVER.share_of_gain * share * expected
                if better:
                    break
                share *= 0.5
            if better:
                break
        if not better:
            return False
        value = found
        multipliers[:] = tried
    return False


@subkernel
def _minimise_given(
    problem: ChainProblem,
    box: tuple[Array1, Array1],
    rows: Array2,
    least: Array1,
    give: float,
    multipliers: Array1,
    at_bound: Bytes1,
    x: Array1,
    missing: Array1,
) -> float:
    """Minimise for given multipliers; fill in the violation of each row and return the dual value."""
    objective, errors, damping, centre = problem
    pushed = centre.copy()
    n = len(centre)
    for row in range(len(rows)):
        if multipliers[row] > 0.0:
            for u in range(n):
                pushed[u] += multipliers[row] * rows[row, u] / damping[u]
    minimise_in_box(objective, errors, damping, pushed, box[0], box[1], at_bound, x)
    value = evaluate_gradient(problem, x, pushed, np.empty((len(errors), 6)))
    for row in range(len(rows)):
        missing[row] = least[row] - give * multipliers[row]
        for u in range(n):
            missing[row] -= rows[row, u] * x[u]
        value += multipliers[row] * (missing[row] + 0.5 * give * multipliers[row])
    return value


@subkernel
def _find_alone(problem: ChainProblem, box: tuple[Array1, Array1], rows: Array2) -> float:
    """Return the mean compliance of rows if joints move one by one."""
    objective, _, damping, _ = problem
    n = len(damping)
    total = 0.0
    gains = np.empty((n, 11))
    held = np.empty(n, dtype=np.bool_)
    for u in range(n):
        held[u] = not box[1][u] > box[0][u]
    factor(objective, damping, held, gains)
    for row in range(len(rows)):
        for u in range(n):
            total += gains[u, 10] * rows[row, u] ** 2
    return total / max(len(rows), 1)


@subkernel
def _find_schur(
    problem: ChainProblem,
    box: tuple[Array1, Array1],
    rows: Array2,
    which: Ints1,
    at_bound: Bytes1,
    yielding: Array2,
) -> tuple[Array2, Array1]:
    """Return the Schur complement of rows, (c, c), and their compliance if joints move one by one, (c,).

    `yielding`, (r, n), is scratch.
    """
    objective, errors, damping, _ = problem
    n = len(damping)
    count = len(which)
    gains = np.empty((n, 11))
    held = np.empty(n, dtype=np.bool_)
    force = np.empty(n)
    no_errors = np.zeros_like(errors)
    schur = np.zeros((count, count))
    alone = np.zeros(count)
    for u in range(n):
        held[u] = at_bound[u] != 0 or not box[1][u] > box[0][u]
    factor(objective, damping, held, gains)
    for k in range(count):
        for u in range(n):
            force[u] = 0.0 if held[u] else rows[which[k], u] / damping[u]
            yielding[k, u] = 0.0
            alone[k] += gains[u, 10] * rows[which[k], u] ** 2
        solve_factored((objective, no_errors, damping, force), held, gains, yielding[k])
        for i in range(k + 1):
            for u in range(n):
                schur[i, k] += rows[which[i], u] * yielding[k, u]
            schur[k, i] = schur[i, k]
    return schur, alone


@subkernel
def _step_multipliers(
    schur: Array2, soft: Array1, which: Ints1, missing: Array1, multipliers: Array1, change: Array1
) -> float:
    """Fill in the change of multipliers that removes all violations without making a multiplier negative.

    Returns:
        The expected gain; -1 if it cannot be computed.
    """
    count = len(which)
    factored = np.empty((count, count))
    right = np.empty(count)
    gain = 0.0
    released = np.zeros(count, dtype=np.bool_)  # rows whose multiplier becomes 0
    change[:] = 0.0
    for _ in range(count + 1):
        for i in range(count):
            right[i] = -multipliers[which[i]] if released[i] else missing[which[i]]
            for j in range(count):
                coupled = not (released[i] or released[j])
                factored[i, j] = schur[i, j] if coupled else 0.0
                if released[j] and not released[i]:
                    right[i] += schur[i, j] * multipliers[which[j]]
            factored[i, i] = 1.0 if released[i] else schur[i, i] + soft[i]
        if not solve_cholesky(factored, right):
            return -1.0
        again = False
        for i in range(count):
            if not released[i] and multipliers[which[i]] + right[i] < 0.0:
                released[i] = again = True
        if not again:
            break
    for i in range(count):
        change[which[i]] = right[i]
        gain += right[i] * missing[which[i]]
    return gain
