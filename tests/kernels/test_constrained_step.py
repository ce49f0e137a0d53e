"""Least squares along a chain with rows: against SciPy's solver, and by the optimality conditions."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import assume, given
from hypothesis import strategies as st
from kernels.chains import Problem, problem
from sampling import examples
from scipy.optimize import minimize

from pinposture import kernels

Found = tuple[bool, np.ndarray, np.ndarray]


def solve(
    p: Problem, lower: np.ndarray, upper: np.ndarray, rows: np.ndarray, least: np.ndarray, soft: bool = False
) -> Found:
    """Whether the minimum was found, x, and which rows bind."""
    x = np.empty(len(p.centre))
    active = np.empty(len(least), dtype=np.bool_)
    given = (p.springs, p.errors, p.damping, p.centre), lower, upper
    return kernels.minimise_with_rows(*given, rows, least, soft, active, x), x, active


def draw_rows(
    rng: np.random.Generator, n: int, count: int, lower: np.ndarray, upper: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Rows of length 1 that hold somewhere inside of a box."""
    rows = rng.normal(size=(count, n)) * (rng.random((count, n)) < 0.7)
    rows[:, 0] += 0.1
    rows /= np.linalg.norm(rows, axis=1, keepdims=True)
    inside = lower + rng.uniform(0.3, 0.7, n) * (upper - lower)
    return rows, rows @ inside - rng.uniform(0.0, 0.01, count)


@given(seed=st.integers(0, 2**32 - 1), power=st.integers(-2, 0), count=st.integers(0, 4))
@examples(30)
def test_no_other_solver_finds_a_smaller_value(seed: int, power: int, count: int) -> None:
    rng = np.random.default_rng(seed)
    p = problem(rng, 3, 10.0**power)
    n = len(p.centre)
    lower = -rng.uniform(0.01, 0.2, n)
    upper = rng.uniform(0.01, 0.2, n)
    rows, least = draw_rows(rng, n, count, lower, upper)
    found, x, _ = solve(p, lower, upper, rows, least)
    assert found
    hessian, gradient = p.dense()
    other = minimize(
        lambda x: 0.5 * x @ hessian @ x + gradient @ x,
        0.5 * (lower + upper),
        jac=lambda x: hessian @ x + gradient,
        bounds=np.column_stack([lower, upper]),
        constraints={"type": "ineq", "fun": lambda x: rows @ x - least, "jac": lambda x: rows},
        method="SLSQP",
        options={"ftol": 1e-14, "maxiter": 500},
    )
    assert np.all((x >= lower) & (x <= upper))
    assert np.all(rows @ x >= least - 1e-9)
    if np.all(rows @ other.x >= least - 1e-9):
        assert 0.5 * x @ hessian @ x + gradient @ x <= other.fun + 1e-9 * (1.0 + abs(other.fun))


@pytest.mark.parametrize("damping", [1e-2, 1e-6])
@pytest.mark.parametrize("seed", range(4))
def test_long_chains_meet_the_optimality_conditions(seed: int, damping: float) -> None:
    """60 modules: the slope is what sides and rows push, and they only push inwards."""
    rng = np.random.default_rng(seed)
    p = problem(rng, 60, damping)
    hessian, gradient = p.dense()
    n = len(gradient)
    bound = np.full(n, np.median(np.abs(np.linalg.solve(hessian, -gradient))))
    rows, least = draw_rows(rng, n, 30, -bound, bound)
    found, x, active = solve(p, -bound, bound, rows, least)
    assert found
    assert active.any()
    assert np.all(np.abs(x) <= bound)
    assert np.all(rows @ x >= least - 1e-9)
    slope = hessian @ x + gradient
    scale = (np.abs(hessian) @ np.abs(x) + np.abs(gradient)).max()
    free = np.abs(x) < bound
    multipliers = np.linalg.lstsq(rows[active][:, free].T, slope[free], rcond=None)[0]
    rest = slope - rows[active].T @ multipliers
    assert np.all(multipliers >= -1e-9 * scale)
    assert np.abs(rest[free]).max() <= 1e-9 * scale
    assert np.all(rest[~free] * np.sign(x[~free]) <= 1e-9 * scale)
    np.testing.assert_allclose(rows[active] @ x, least[active], atol=1e-9)


def test_rows_that_contradict_each_other_or_the_box_are_not_met() -> None:
    rng = np.random.default_rng(0)
    p = problem(rng, 4, 1e-3)
    n = len(p.centre)
    row = np.eye(n)[:1]
    box = np.full(n, 0.1)
    assert not solve(p, -box, box, np.vstack([row, -row]), np.array([0.05, 0.05]))[0]
    assert not solve(p, -box, box, row, np.array([0.2]))[0]


@given(seed=st.integers(0, 2**32 - 1), modules=st.integers(2, 20), pairs=st.integers(1, 5))
@examples(30)
def test_rows_that_may_be_violated_are_so_by_the_least_squares(seed: int, modules: int, pairs: int) -> None:
    """Rows and their opposites ask for too much; the slope of the objective is what violations push."""
    rng = np.random.default_rng(seed)
    p = problem(rng, modules, 1e-2)
    hessian, gradient = p.dense()
    n = len(gradient)
    bound = np.full(n, np.median(np.abs(np.linalg.solve(hessian, -gradient))))
    rows, least = draw_rows(rng, n, pairs, -bound, bound)
    rows = np.vstack([rows, -rows])
    least = np.concatenate([least, -least]) + 0.05 * bound[0]
    found, x, active = solve(p, -bound, bound, rows, least, soft=True)
    assume(found)
    assert np.all(np.abs(x) <= bound)
    missing = np.maximum(least - rows @ x, 0.0)
    assert np.all(active[missing > 1e-6 * bound[0]])
    push = missing @ rows
    slope = hessian @ x + gradient
    free = np.abs(x) < bound
    if not free.any():
        return
    forces = np.sum(push[free] * slope[free]) / np.sum(push[free] ** 2)
    scale = (np.abs(hessian) @ np.abs(x) + np.abs(gradient)).max()
    rest = slope - forces * push
    assert forces >= 0.0
    assert np.abs(rest[free]).max() <= 1e-4 * scale
    assert np.all(rest[~free] * np.sign(x[~free]) <= 1e-4 * scale)
    best = minimize(
        lambda x: 0.5 * np.sum(np.maximum(least - rows @ x, 0.0) ** 2),
        x,
        jac=lambda x: -np.maximum(least - rows @ x, 0.0) @ rows,
        bounds=np.column_stack([-bound, bound]),
        method="L-BFGS-B",
        options={"ftol": 1e-15, "gtol": 1e-12},
    )
    assert np.linalg.norm(missing) <= np.sqrt(2.0 * best.fun) + 0.01 * np.linalg.norm(least)


def test_a_step_that_brakes_before_rows_that_cannot_hold_is_found_without_dense_matrices() -> None:
    rng = np.random.default_rng(1)
    p = problem(rng, 100, 1e-2)
    n = len(p.centre)
    box = np.full(n, 1e-3)
    rows, _ = draw_rows(rng, n, 40, -box, box)
    found, x, active = solve(p, -box, box, rows, np.full(40, 0.05), soft=True)
    assert found
    assert active.all()
    push = np.maximum(0.05 - rows @ x, 0.0) @ rows
    at_bound = np.abs(x) == box
    assert at_bound.mean() > 0.9
    np.testing.assert_array_equal(x[at_bound], (box * np.sign(push))[at_bound])
    assert np.linalg.norm(push[~at_bound]) < 1e-3 * np.linalg.norm(push)
