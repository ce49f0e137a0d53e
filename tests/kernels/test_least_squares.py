"""ChainSolver along a chain against dense linear algebra, with more digits where it takes them."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from kernels.chains import Problem, problem
from sampling import examples

import pinposture as pp
from pinposture import kernels
from pinposture.kernels.arrays import PointObjective

SEEDS = st.integers(0, 2**32 - 1)


def free(p: Problem) -> np.ndarray:
    """The minimum without bounds."""
    n = len(p.centre)
    x = np.empty(n)
    sides = np.zeros(n, dtype=np.int8)
    none = np.full(n, np.inf)
    assert kernels.minimise_in_box(p.springs, p.errors, p.damping, p.centre, -none, none, sides, x) == 1
    return x


def solved_precisely(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """Cholesky in extended precision."""
    a = a.astype(np.longdouble)
    b = b.astype(np.longdouble)
    n = len(b)
    for j in range(n):
        a[j, j] = np.sqrt(a[j, j])
        a[j + 1 :, j] /= a[j, j]
        a[j + 1 :, j + 1 :] -= np.outer(a[j + 1 :, j], a[j + 1 :, j])
    for j in range(n):
        b[j] = (b[j] - a[j, :j] @ b[:j]) / a[j, j]
    for j in reversed(range(n)):
        b[j] = (b[j] - a[j + 1 :, j] @ b[j + 1 :]) / a[j, j]
    return b.astype(np.float64)


@given(seed=SEEDS, modules=st.integers(1, 12), power=st.integers(-6, 1))
@examples(40)
def test_the_minimum_is_that_of_dense_least_squares(seed: int, modules: int, power: int) -> None:
    p = problem(np.random.default_rng(seed), modules, 10.0**power)
    hessian, gradient = p.dense()
    np.testing.assert_allclose(free(p), np.linalg.solve(hessian, -gradient), rtol=1e-7, atol=1e-9)


@given(seed=SEEDS, modules=st.integers(1, 12), power=st.integers(-6, 1))
@examples(40)
def test_points_alone_have_the_minimum_of_dense_least_squares(seed: int, modules: int, power: int) -> None:
    p = problem(np.random.default_rng(seed), modules, 1.0)
    screws, ends, points, weights, _ = p.springs
    rows = p.rows[: 3 * modules] / np.sqrt(np.repeat(weights, 3))[:, None]
    damping = 10.0**power
    n = len(p.centre)
    x = np.full(n, np.nan)
    kernels.minimise_points(screws, ends, points, p.errors, damping, p.centre, np.empty((n, 8)), x)
    hessian = rows.T @ rows + damping * np.eye(n)
    exact = np.linalg.solve(hessian, rows.T @ p.errors.ravel() + damping * p.centre)
    np.testing.assert_allclose(x, exact, rtol=1e-7, atol=1e-9)


@pytest.mark.parametrize("straight", [False, True])
@pytest.mark.parametrize("damping", [1e-2, 1e-6, 1e-10])
def test_long_chains_keep_their_digits(damping: float, straight: bool) -> None:
    """80 modules, some 160 joints: against extended precision, straight and hence singular ones as well."""
    p = problem(np.random.default_rng(5), 80, damping, straight)
    rows = p.rows.astype(np.longdouble)
    hessian = rows.T @ rows + np.diag(p.damping.astype(np.longdouble))
    exact = solved_precisely(hessian, rows.T @ p.right + p.damping * p.centre)
    found = free(p)
    size = np.abs(exact).max()
    # What the motions make of the points is known to rounding; the motions to what the damping leaves.
    np.testing.assert_allclose(p.rows @ found, p.rows @ exact, atol=1e-11 * np.abs(p.right).max())
    np.testing.assert_allclose(found, exact, atol=1e-9 * size)


@pytest.mark.long
def test_500_modules_meet_their_optimality_conditions() -> None:
    """At 1,000 joints: the slope of the sum at its minimum, by dense Jacobians, next to its terms."""
    arm = pp.Arm.from_template("RyRz", 500)
    rng = np.random.default_rng(0)
    state = arm.chain_at(0.2 * rng.normal(size=arm.nv))
    chain = arm.kinematics
    m = 500
    n = 1000
    errors = 0.02 * rng.normal(size=(m, 3))
    damping = np.full(n, 1e-6)
    screws = np.empty((n, 6))
    placed = state.placements
    lines = placed.axes, placed.origins
    kernels.find_screws(chain.constants, np.arange(n), np.ones(n), *lines, chain.ends, placed.points, screws)
    p = Problem(
        PointObjective(screws, chain.ends, placed.points, np.ones(m), np.zeros(m)),
        errors,
        damping,
        np.zeros(n),
        np.zeros(0),
        np.zeros(0),
    )
    x = free(p)
    rows = state.jacobians.reshape(-1, n)
    terms = np.abs(rows).T @ np.abs(rows @ x - errors.ravel())
    slope = rows.T @ (rows @ x - errors.ravel()) + damping * x
    assert np.abs(slope / terms).max() < 1e-10


@given(seed=SEEDS, modules=st.integers(1, 10))
@examples(30)
def test_motions_misses_and_stiffness_are_what_the_rows_say(seed: int, modules: int) -> None:
    rng = np.random.default_rng(seed)
    p = problem(rng, modules, 1.0)
    screws, ends, points, weights, chords = p.springs
    x = rng.normal(size=len(p.centre))
    moved = np.empty_like(points)
    kernels.move_points(screws, ends, points, x, moved)
    np.testing.assert_allclose(
        (np.sqrt(weights)[:, None] * moved).ravel(), p.rows[: 3 * modules] @ x, atol=1e-12
    )
    found = kernels.stiffness(p.springs)
    assert found == pytest.approx((p.rows**2).sum() / len(x), rel=1e-9)
    errors = np.empty_like(points)
    total = kernels.measure_point_errors(points, points + p.errors, weights, chords, np.zeros(3), errors)
    np.testing.assert_allclose(errors, p.errors, atol=1e-15)
    assert total == pytest.approx(p.right @ p.right)


def test_errors_across_a_planar_arm_do_not_count() -> None:
    rng = np.random.default_rng(1)
    points = rng.normal(size=(4, 3))
    targets = rng.normal(size=(4, 3))
    normal = np.array([0.6, 0.0, 0.8])
    errors = np.empty((4, 3))
    total = kernels.measure_point_errors(points, targets, np.ones(4), np.zeros(4), normal, errors)
    np.testing.assert_allclose(errors @ normal, 0.0, atol=1e-15)
    np.testing.assert_allclose(np.cross(errors, normal), np.cross(targets - points, normal), atol=1e-15)
    assert total == pytest.approx((errors**2).sum())
