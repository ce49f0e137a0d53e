"""Least squares within a box: against every choice of sides on small chains, and optimality on large ones."""

from __future__ import annotations

from itertools import product

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from kernels.chains import Problem, problem
from sampling import examples, seeds

from pinposture import kernels

SEEDS = st.integers(0, 2**32 - 1)


def within(p: Problem, lower: np.ndarray, upper: np.ndarray, guess: np.ndarray | None = None) -> np.ndarray:
    """The minimum within a box."""
    n = len(p.centre)
    x = np.empty(n)
    sides = np.zeros(n, dtype=np.int8) if guess is None else guess
    kernels.minimise_in_box(p.springs, p.errors, p.damping, p.centre, lower, upper, sides, x)
    return x


def best_of_all(p: Problem, lower: np.ndarray, upper: np.ndarray) -> np.ndarray:
    """The minimum by trying every choice of joints at either side."""
    hessian, gradient = p.dense()
    n = len(gradient)
    best = np.inf
    found = np.zeros(0)
    for choice in product((-1, 0, 1), repeat=n):
        sides = np.array(choice)
        x = np.where(sides < 0, lower, upper)
        free = sides == 0
        if np.any(np.isinf(x[~free])):
            continue
        x[free] = np.linalg.solve(
            hessian[np.ix_(free, free)], -gradient[free] - hessian[np.ix_(free, ~free)] @ x[~free]
        )
        value = 0.5 * x @ hessian @ x + gradient @ x
        if np.all(x >= lower - 1e-12) and np.all(x <= upper + 1e-12) and value < best:
            best = value
            found = x
    return found


@given(seed=SEEDS, power=st.integers(-4, 0))
@examples(30)
def test_the_minimum_is_the_best_of_all_choices_of_sides(seed: int, power: int) -> None:
    rng = np.random.default_rng(seed)
    p = problem(rng, 2, 10.0**power)
    n = len(p.centre)
    lower = -rng.uniform(0.0, 0.2, n)
    upper = rng.uniform(0.0, 0.2, n)
    lower[rng.random(n) < 0.2] = -np.inf
    upper[rng.random(n) < 0.2] = np.inf
    fixed = rng.random(n) < 0.15
    upper[fixed] = lower[fixed] = np.where(np.isinf(lower[fixed]), 0.01, lower[fixed])
    guess = rng.integers(-1, 2, n).astype(np.int8)
    guess[((guess < 0) & np.isinf(lower)) | ((guess > 0) & np.isinf(upper))] = 0
    expected = best_of_all(p, lower, upper)
    for found in (within(p, lower, upper), within(p, lower, upper, guess)):
        assert np.all((found >= lower) & (found <= upper))
        np.testing.assert_allclose(found, expected, atol=1e-8)


@pytest.mark.parametrize("damping", [1e-2, 1e-5, 1e-8])
@pytest.mark.parametrize("share", [0.1, 0.5, 2.0])
@pytest.mark.parametrize("seed", range(3))
def test_long_chains_at_their_bounds_meet_the_optimality_conditions(
    seed: int, share: float, damping: float
) -> None:
    """60 modules, some 120 joints, many of them at a bound: slopes point outwards there, and vanish
    elsewhere."""
    rng = np.random.default_rng(seed)
    p = problem(rng, 60, damping)
    hessian, gradient = p.dense()
    free = np.linalg.solve(hessian, -gradient)
    bound = np.full(len(free), share * np.median(np.abs(free)))
    x = within(p, -bound, bound)
    slope = hessian @ x + gradient
    terms = np.abs(hessian) @ np.abs(x) + np.abs(gradient)
    slope /= terms
    assert np.all(np.abs(x) <= bound)
    at_upper = x == bound
    at_lower = x == -bound
    assert at_upper.any() and at_lower.any()
    assert np.all(slope[at_upper] <= 1e-9) and np.all(slope[at_lower] >= -1e-9)
    assert np.abs(slope[~(at_upper | at_lower)]).max(initial=0.0) < 1e-9


@pytest.mark.parametrize("seed", seeds(20))
def test_boxes_that_end_where_the_minimum_is_or_have_no_room(seed: int) -> None:
    """Wanted values exactly at their bounds, and bounds one rounding apart: no circles, no numbers lost."""
    rng = np.random.default_rng(seed)
    p = problem(rng, 12, 10.0 ** rng.uniform(-6, -1))
    n = len(p.centre)
    moved = np.empty_like(p.springs.points)
    kernels.move_points(p.springs.screws, p.springs.ends, p.springs.points, p.centre, moved)
    p = p._replace(errors=moved)  # so that the centre is the minimum
    lower = p.centre - rng.uniform(0.0, 0.2, n)
    upper = p.centre + rng.uniform(0.0, 0.2, n)
    at = rng.integers(-1, 2, n)
    lower[at < 0] = p.centre[at < 0]
    upper[at > 0] = p.centre[at > 0]
    nudge = np.where(rng.random(n) < 0.5, 1e-16, 0.0)
    found = within(p, lower + nudge, upper - nudge)
    np.testing.assert_allclose(found, p.centre, atol=1e-10)
    thin = rng.random(n) < 0.3
    upper[thin] = np.nextafter(lower[thin], np.inf)
    found = within(p, lower, upper)
    assert np.all((found >= lower) & (found <= upper))
    hessian, _ = p.dense()
    slope = hessian @ found - (hessian @ p.centre)
    free = (found > lower + 1e-9) & (found < upper - 1e-9)
    assert np.abs(slope[free]).max(initial=0.0) < 1e-9 * np.abs(hessian).max()


@pytest.mark.parametrize("seed", seeds(30))
def test_circles_end_with_the_minimum(seed: int) -> None:
    """Narrow boxes around anywhere: most joints at a bound, which corrections alone do not sort out."""
    rng = np.random.default_rng(seed)
    p = problem(rng, 20, 10.0 ** rng.uniform(-9, -3))
    middle = rng.normal(size=len(p.centre)) * 0.02
    half = 10.0 ** rng.uniform(-5, -1.5, len(middle))
    lower = middle - half
    upper = middle + half
    x = within(p, lower, upper)
    hessian, gradient = p.dense()
    slope = hessian @ x + gradient
    scale = np.diag(hessian) * (upper - lower)  # what moving through the box would do to it
    assert np.all(slope[x <= lower] >= -1e-6 * scale[x <= lower])
    assert np.all(slope[x >= upper] <= 1e-6 * scale[x >= upper])
    inside = (x > lower) & (x < upper)
    assert np.all(np.abs(slope[inside]) <= 1e-6 * scale[inside])
