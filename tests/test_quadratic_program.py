"""The quadratic program against bounded least squares, and against the conditions that its solution obeys."""

from __future__ import annotations

import daqp
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from sampling import examples, seeds
from scipy.optimize import linprog, lsq_linear, minimize, nnls

from pinposture.quadratic_program import ConstraintRows, solve

SEEDS = st.integers(0, 2**32 - 1)
Problem = tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]


def least_squares(rng: np.random.Generator, n: int) -> tuple[np.ndarray, np.ndarray]:
    """Matrix and right-hand side of a sum of squares, damped so that its minimum is one point."""
    m = int(rng.integers(1, 2 * n + 2))
    matrix = rng.normal(size=(m, n)) * 10.0 ** rng.uniform(-1.0, 1.0)
    damping = 10.0 ** rng.uniform(-4.0, 0.0) * np.linalg.norm(matrix)
    return np.vstack([matrix, damping * np.eye(n)]), np.concatenate([rng.normal(size=m), np.zeros(n)])


def box(rng: np.random.Generator, n: int) -> tuple[np.ndarray, np.ndarray]:
    size = 10.0 ** rng.uniform(-2.0, 1.0)
    return -size * rng.uniform(0.05, 1.0, n), size * rng.uniform(0.05, 1.0, n)


def unexplained(
    problem: Problem, x: np.ndarray, rows: ConstraintRows | None, equations: np.ndarray | None
) -> float:
    """What is left of the gradient when bounds and rows that hold it push with forces of the right sign.

    A feasible x solves a convex program if and only if nothing is left. Relative to the gradient.
    """
    hessian, gradient, lower, upper = problem
    n = len(x)
    near = 1e-8 * max(1.0, float(np.abs(upper).max()))
    eye = np.eye(n)
    pushes = [eye[x <= lower + near], -eye[x >= upper - near]]
    if rows is not None:
        lengths = np.linalg.norm(rows.matrix, axis=1)
        pushes.append(rows.matrix[rows.matrix @ x <= rows.least + near * lengths])
    if equations is not None:
        pushes.extend([equations, -equations])
    left = (hessian @ x + gradient) / np.linalg.norm(gradient)
    return float(nnls(np.vstack([np.concatenate(pushes), np.zeros((1, n))]).T, left)[1])


@given(seed=SEEDS, n=st.integers(1, 30))
@examples(40)
def test_a_box_gives_what_bounded_least_squares_gives(seed: int, n: int) -> None:
    rng = np.random.default_rng(seed)
    matrix, right = least_squares(rng, n)
    lower, upper = box(rng, n)
    found = solve(matrix.T @ matrix, -matrix.T @ right, lower, upper)
    assert found.x is not None
    assert not found.softened
    assert np.all((found.x >= lower) & (found.x <= upper))
    expected = lsq_linear(matrix, right, (lower, upper), method="bvls", tol=1e-14).x
    np.testing.assert_allclose(found.x, expected, atol=1e-7 * np.abs(upper).max())


@given(seed=SEEDS, n=st.integers(2, 25), fixed=st.booleans(), joined=st.booleans())
@examples(40)
def test_rows_and_equations_obey_the_optimality_conditions(
    seed: int, n: int, fixed: bool, joined: bool
) -> None:
    rng = np.random.default_rng(seed)
    matrix, right = least_squares(rng, n)
    lower, upper = box(rng, n)
    if fixed:
        upper[rng.integers(n)] = lower[0] = upper[0] = 0.0
        lower = np.minimum(lower, upper)
    inside = rng.uniform(lower, upper)
    normals = rng.normal(size=(int(rng.integers(1, 10)), n)) * 10.0 ** rng.uniform(-3.0, 3.0)
    spare = np.linalg.norm(normals, axis=1) * np.abs(upper).max() * rng.choice([0.0, 0.05], len(normals))
    rows = ConstraintRows(normals, normals @ inside - spare)
    equations = np.linalg.qr(rng.normal(size=(n, 1)))[0].T if joined else None
    equal = None if equations is None else (equations, equations @ inside)
    problem = (matrix.T @ matrix, -matrix.T @ right, lower, upper)
    found = solve(*problem, rows, equal)
    assert found.x is not None
    size = max(1.0, float(np.abs(upper).max()))
    lengths = np.linalg.norm(normals, axis=1)
    assert np.all((found.x >= lower) & (found.x <= upper))
    assert np.all(normals @ found.x >= rows.least - 1e-8 * size * lengths)
    if equations is not None:
        np.testing.assert_allclose(equations @ found.x, equal[1], atol=1e-8 * size)
    assert unexplained(problem, found.x, rows, equations) < 1e-5
    gap = (normals @ found.x - rows.least) / lengths
    assert np.all(found.binding[gap < 1e-10])
    assert not np.any(found.binding[gap > 1e-7])


@given(seed=SEEDS, n=st.integers(2, 10))
@examples(40)
def test_rows_that_cannot_all_hold_give_way_and_the_box_does_not(seed: int, n: int) -> None:
    """One row that asks for too much is violated by exactly what no step in the box can do."""
    rng = np.random.default_rng(seed)
    matrix, right = least_squares(rng, n)
    lower, upper = box(rng, n)
    normal = rng.normal(size=n)
    most = float(np.maximum(normal * lower, normal * upper).sum())
    beyond = float(rng.uniform(0.1, 2.0)) * np.linalg.norm(normal)
    rows = ConstraintRows(normal[None], np.array([most + beyond]))
    found = solve(matrix.T @ matrix, -matrix.T @ right, lower, upper, rows)
    assert found.x is not None
    assert found.softened
    assert np.all((found.x >= lower) & (found.x <= upper))
    assert float(normal @ found.x) == pytest.approx(most, rel=1e-4, abs=1e-4 * beyond)


def contradicting(seed: int) -> tuple[Problem, ConstraintRows, float]:
    """A program whose rows contradict each other, and the smallest sum of squares by which they can."""
    rng = np.random.default_rng(seed)
    n = int(rng.integers(2, 10))
    r = int(rng.integers(2, 8))
    matrix = rng.normal(size=(2 * n, n)) * 10.0 ** rng.uniform(-1.0, 1.0, n)
    lower = np.full(n, -0.1)
    upper = np.full(n, 0.1)
    normals = rng.normal(size=(r, n))
    normals /= np.linalg.norm(normals, axis=1)[:, None]
    least = np.abs(normals).sum(axis=1) * 0.1 * rng.uniform(0.3, 1.5, r)
    problem = (matrix.T @ matrix, rng.normal(size=n), lower, upper)

    def missed(x: np.ndarray) -> tuple[float, np.ndarray]:
        short = np.maximum(least - normals @ x, 0.0)
        return float(short @ short) / 2.0, -normals.T @ short

    options = {"ftol": 1e-16, "gtol": 1e-13, "maxiter": 5000}
    best = minimize(missed, np.zeros(n), jac=True, bounds=[*zip(lower, upper, strict=True)], options=options)
    return problem, ConstraintRows(normals, least), float(np.sqrt(2.0 * best.fun))


def test_rows_that_contradict_each_other_are_violated_as_little_as_possible() -> None:
    for seed in seeds(40):
        problem, rows, least = contradicting(seed)
        found = solve(*problem, rows)
        assert found.x is not None
        if found.softened:
            missed = np.linalg.norm(np.maximum(rows.least - rows.matrix @ found.x, 0.0))
            assert missed <= 1.001 * least + 1e-7, seed


def test_rows_are_only_softened_where_linear_programming_finds_no_way_either() -> None:
    softened = []
    for seed in range(40):
        problem, rows, _ = contradicting(seed)
        found = solve(*problem, rows)
        bounds = [*zip(problem[2], problem[3], strict=True)]
        feasible = linprog(np.zeros(len(problem[1])), -rows.matrix, -rows.least, bounds=bounds).status == 0
        assert found.softened != feasible
        softened.append(found.softened)
    assert 5 < sum(softened) < 40


@pytest.mark.parametrize("least", [0.0, -1.0])
def test_a_row_of_zeros_that_holds_changes_nothing(least: float) -> None:
    rng = np.random.default_rng(0)
    matrix, right = least_squares(rng, 6)
    problem = (matrix.T @ matrix, -matrix.T @ right, np.full(6, -0.1), np.full(6, 0.1))
    found = solve(*problem, ConstraintRows(np.zeros((2, 6)), np.full(2, least)))
    assert found.x is not None
    assert not found.softened
    np.testing.assert_allclose(found.x, solve(*problem).x, atol=1e-12)


def test_a_row_of_zeros_that_cannot_hold_leaves_the_rest_as_it_is() -> None:
    rng = np.random.default_rng(1)
    matrix, right = least_squares(rng, 6)
    problem = (matrix.T @ matrix, -matrix.T @ right, np.full(6, -0.1), np.full(6, 0.1))
    found = solve(*problem, ConstraintRows(np.zeros((1, 6)), np.array([1e-3])))
    assert found.x is not None
    assert found.softened
    np.testing.assert_allclose(found.x, solve(*problem).x, atol=1e-6)


@pytest.mark.parametrize("step", [1e-2, 1.0, 1e3])
@pytest.mark.parametrize("scale", [1e-15, 1e-4, 1.0, 1e8])
def test_the_unit_of_the_objective_does_not_matter(scale: float, step: float) -> None:
    """Metres or millimetres: the minimum of s f is that of f."""
    for seed in range(5):
        rng = np.random.default_rng(seed)
        matrix = rng.normal(size=(30, 12))
        hessian = matrix.T @ matrix
        gradient = -matrix.T @ matrix @ rng.normal(size=12) * 3.0 * step
        bound = step * rng.uniform(0.1, 1.0, 12)
        rows = ConstraintRows(rng.normal(size=(3, 12)), np.zeros(3))
        found = solve(scale * hessian, scale * gradient, -bound, bound, rows)
        assert found.x is not None
        problem = (hessian, gradient / step, -bound / step, bound / step)
        assert unexplained(problem, found.x / step, rows, None) < 1e-5


def test_no_answer_rather_than_a_wrong_one(monkeypatch: pytest.MonkeyPatch) -> None:
    problem = (np.eye(3), np.ones(3), -np.ones(3), np.ones(3))
    for answer, flag in ((np.full(3, np.nan), 1), (np.zeros(3), -2), (np.array([0.0, np.inf, 0.0]), 1)):
        monkeypatch.setattr(daqp, "solve", lambda *_, a=answer, f=flag, **__: (a, 0.0, f, {}))
        assert solve(*problem, ConstraintRows(np.ones((1, 3)), np.zeros(1))).x is None
    monkeypatch.setattr(daqp, "solve", lambda *_, **__: (np.array([9.0, -9.0, 0.5]), 0.0, 1, {}))
    np.testing.assert_array_equal(solve(*problem).x, [1.0, -1.0, 0.5])
