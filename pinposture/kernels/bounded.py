"""Least squares along a chain within a box: the motions that limits leave, still by sweeps.

First the joints at a bound are guessed and corrected: those that would leave the box are held at its side,
those that are held and pushed inwards are let go, all at once, until nothing changes (a primal-dual active
set method, which is Newton's on the optimality conditions). Mostly two to five rounds are enough. Where they
go round in circles, an interior point method (Mehrotra's predictor and corrector) comes close in some ten
iterations, however many joints are at their bounds, and the guess that it leads to is corrected as before.
"""

from __future__ import annotations

import numpy as np

from pinposture.kernels.arrays import Array1, Array2, Bytes1, Springs
from pinposture.kernels.compiled import compiled, subkernel
from pinposture.kernels.least_squares import answered, factored, slope_of

ROUNDS, ITERATIONS = 6, 40
"""The most corrections of a guess, and the most iterations of the interior point method."""

GAP = 1e-11
"""Complementarity gap at which the interior point method ends, relative to the one at its beginning."""

TINY = 1e-12
"""Motion that is only rounding, in units of a joint."""

BACK = 0.995
"""Share of the way to the boundary that one iteration goes."""


@compiled
def minimise_in_box(
    springs: Springs,
    errors: Array2,
    damping: Array1,
    centre: Array1,
    lower: Array1,
    upper: Array1,
    sides: Bytes1,
    x: Array1,
) -> int:
    """Minimise the sum of `kernels.least_squares` within a box.

    Args:
        springs: points and chords.
        errors: e, (m, 3).
        damping: D, (n,), positive.
        centre: z, (n,).
        lower: smallest x, (n,).
        upper: largest x, (n,).
        sides: a guess of which joints are at their lower (-1) or upper (1) bound; filled with those that
            are, (n,).
        x: filled with the minimum, (n,).

    Returns:
        How many systems were solved.
    """
    n, m = len(springs.screws), len(springs.ends)
    gains, slope, missed = np.empty((n, 11)), np.empty(n), np.empty((m, 6))
    held, close = np.empty(n, dtype=np.bool_), np.empty(n)
    solved = 0
    for attempt in range(2):
        for _ in range(ROUNDS):
            any_held = False
            for u in range(n):
                held[u] = sides[u] != 0 or _thin(lower[u], upper[u])
                any_held = any_held or held[u]
                if held[u]:
                    x[u] = upper[u] if sides[u] > 0 else lower[u]
            factored(springs, damping, held, gains)
            answered(springs, errors, damping, centre, held, gains, x)
            solved += 1
            if any_held:
                slope_of(springs, errors, damping, centre, x, slope, missed)
            settled = True
            for u in range(n):
                if _thin(lower[u], upper[u]):
                    continue
                side, inverse = 0, gains[u, 10]
                if held[u]:  # where it would go, let alone, counts if it is more than rounding
                    if -slope[u] * inverse * sides[u] >= -TINY:
                        side = sides[u]
                elif x[u] < lower[u] - TINY:
                    side = -1
                elif x[u] > upper[u] + TINY:
                    side = 1
                settled = settled and side == sides[u]
                sides[u] = side
            if settled:
                _cut(x, lower, upper)
                return solved
        if attempt == 0:
            solved += _inner(springs, errors, damping, centre, lower, upper, sides, x, gains)
            for u in range(n):
                close[u] = x[u]
    # Round in circles again: as close as the one or the other came.
    _cut(x, lower, upper)
    _cut(close, lower, upper)
    last = slope_of(springs, errors, damping, centre, x, slope, missed)
    inner = slope_of(springs, errors, damping, centre, close, slope, missed)
    if not last <= inner:
        for u in range(n):
            x[u] = close[u]
    return solved


@subkernel
def _thin(lower: float, upper: float) -> bool:
    """Whether there is no room between two bounds."""
    return upper - lower <= TINY


@subkernel
def _cut(x: Array1, lower: Array1, upper: Array1) -> None:
    """Bring x into the box; no motion, where it is no number."""
    for u in range(len(x)):
        if np.isnan(x[u]):
            x[u] = 0.0
        x[u] = min(max(x[u], lower[u]), upper[u])


@subkernel
def _inner(
    springs: Springs,
    errors: Array2,
    damping: Array1,
    centre: Array1,
    lower: Array1,
    upper: Array1,
    sides: Bytes1,
    x: Array1,
    gains: Array2,
) -> int:
    """An interior point method: fills x with a point near the minimum, and `sides` with a guess."""
    n, m = len(springs.screws), len(springs.ends)
    slope, missed, held = np.empty(n), np.empty((m, 6)), np.zeros(n, dtype=np.bool_)
    low, high = np.zeros(n), np.zeros(n)  # multipliers of the sides
    stiff, pulled, there = np.empty(n), np.empty(n), np.empty(n)
    moves, downs, ups = np.zeros(n), np.zeros(n), np.zeros(n)
    bounds = 0
    for u in range(n):
        held[u] = _thin(lower[u], upper[u])
        below, above = np.isfinite(lower[u]), np.isfinite(upper[u])
        if held[u]:
            x[u] = lower[u]
        elif below and above:
            x[u] = 0.5 * (lower[u] + upper[u])
        elif below:
            x[u] = max(lower[u] + 1.0, centre[u])
        elif above:
            x[u] = min(upper[u] - 1.0, centre[u])
        else:
            x[u] = centre[u]
        bounds += 0 if held[u] else int(below) + int(above)
    slope_of(springs, errors, damping, centre, x, slope, missed)
    start = 0.0
    for u in range(n):
        if not held[u]:
            room = min(x[u] - lower[u], upper[u] - x[u])
            start += abs(slope[u]) * min(room, 1.0)
    start = max(0.1 * start / n, 1e-300)
    for u in range(n):
        if not held[u]:
            low[u] = start / (x[u] - lower[u])
            high[u] = start / (upper[u] - x[u])
    iterations, left = 0, 1.0  # share of the mismatch of multipliers and slope
    while iterations < ITERATIONS:
        gap = 0.0
        for u in range(n):
            if not held[u]:
                gap += _product(low[u], x[u] - lower[u]) + _product(high[u], upper[u] - x[u])
        gap /= max(bounds, 1)
        if gap <= GAP * start and left <= GAP:
            break
        iterations += 1
        aim, gap_there = 0.0, 0.0
        for corrector in range(2):
            for u in range(n):
                if held[u]:
                    there[u] = x[u]
                    continue
                a, c = x[u] - lower[u], upper[u] - x[u]
                p, r = low[u] / a, high[u] / c
                push = aim / a - aim / c
                if corrector:  # what the predictor left out: products of changes
                    move = moves[u]
                    push += (low[u] + p * move) * move / a + (high[u] - r * move) * move / c
                stiff[u] = damping[u] + p + r
                pulled[u] = (damping[u] * centre[u] + (p + r) * x[u] + push) / stiff[u]
            if not corrector:
                factored(springs, stiff, held, gains)
            answered(springs, errors, stiff, pulled, held, gains, there)
            # How far there is room to go, for x and for the multipliers.
            reach = 1.0
            for u in range(n):
                if held[u]:
                    continue
                a, c, move = x[u] - lower[u], upper[u] - x[u], there[u] - x[u]
                p, r = low[u] / a, high[u] / c
                first = moves[u] if corrector else 0.0
                down = (aim + (low[u] + p * first) * first) / a - low[u] - p * move
                up = (aim - (high[u] - r * first) * first) / c - high[u] + r * move
                if -move * reach > a:
                    reach = -a / move
                if move * reach > c:
                    reach = c / move
                if -down * reach > low[u]:
                    reach = -low[u] / down
                if -up * reach > high[u]:
                    reach = -high[u] / up
                moves[u], downs[u], ups[u] = move if not corrector else first, down, up
            if corrector:
                break
            gap_there = 0.0
            for u in range(n):
                if not held[u]:
                    move = reach * moves[u]
                    gap_there += _product(low[u] + reach * downs[u], x[u] + move - lower[u])
                    gap_there += _product(high[u] + reach * ups[u], upper[u] - x[u] - move)
            gap_there /= max(bounds, 1)
            aim = gap * (gap_there / gap) ** 3
        left *= 1.0 - BACK * reach
        for u in range(n):
            if not held[u]:
                x[u] += BACK * reach * (there[u] - x[u])
                low[u] += BACK * reach * downs[u]
                high[u] += BACK * reach * ups[u]
    for u in range(n):
        sides[u] = 0
        if not held[u] and gains[u, 10] * low[u] > 0.5 * (x[u] - lower[u]):
            sides[u] = -1
        elif not held[u] and gains[u, 10] * high[u] > 0.5 * (upper[u] - x[u]):
            sides[u] = 1
    return iterations


@subkernel
def _product(multiplier: float, room: float) -> float:
    """Complementarity of one side; none where there is no bound."""
    return multiplier * room if np.isfinite(room) else 0.0
