"""The block tridiagonal system of a path against a dense one."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import assume, given
from hypothesis import strategies as st
from sampling import examples

from pinposture import kernels


def solve_tridiagonal(diagonal: np.ndarray, above: np.ndarray, right: np.ndarray) -> np.ndarray | None:
    x = np.empty_like(right)
    return x if kernels.solve_tridiagonal(diagonal.copy(), above.copy(), right, x) else None


def dense(diagonal: np.ndarray, above: np.ndarray) -> np.ndarray:
    count, n = diagonal.shape[:2]
    whole = np.zeros((count * n, count * n))
    for i in range(count):
        here = slice(i * n, (i + 1) * n)
        whole[here, here] = diagonal[i]
        if i < count - 1:
            after = slice((i + 1) * n, (i + 2) * n)
            whole[here, after], whole[after, here] = above[i], above[i].T
    return whole


def drawn(seed: int, count: int, n: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Blocks of L L^T with a random lower block bidiagonal L, which is positive definite."""
    rng = np.random.default_rng(seed)
    own = np.tril(rng.normal(size=(count, n, n))) + 2.0 * np.eye(n)
    side = rng.normal(size=(count - 1, n, n))  # of row i + 1, left of its diagonal
    diagonal = own @ own.transpose(0, 2, 1)
    diagonal[1:] += side @ side.transpose(0, 2, 1)
    return diagonal, own[:-1] @ side.transpose(0, 2, 1), rng.normal(size=(count, n))


@given(seed=st.integers(0, 2**32 - 1), count=st.integers(1, 12), n=st.integers(1, 8))
@examples(40)
def test_it_solves_what_a_dense_solver_solves(seed: int, count: int, n: int) -> None:
    diagonal, above, right = drawn(seed, count, n)
    whole = dense(diagonal, above)
    assume(np.linalg.cond(whole) < 1e12)  # beyond, rounding decides whether it is definite
    found = solve_tridiagonal(diagonal, above, right)
    assert found is not None
    expected = np.linalg.solve(whole, right.ravel())
    tolerance = 1e-13 * np.linalg.cond(whole) * np.abs(expected).max()
    np.testing.assert_allclose(found.ravel(), expected, rtol=0.0, atol=tolerance)


@pytest.mark.parametrize("block", [0, 1, 4])
def test_an_indefinite_matrix_gives_none(block: int) -> None:
    diagonal, above, right = drawn(7, 5, 3)
    diagonal[block] -= 1.001 * np.eye(3) * np.linalg.eigvalsh(diagonal[block])[0]
    diagonal[block] -= 0.01 * np.eye(3)
    assert np.linalg.eigvalsh(dense(diagonal, above))[0] < 0.0
    assert solve_tridiagonal(diagonal, above, right) is None


def test_it_says_none_exactly_where_the_smallest_eigenvalue_is_negative() -> None:
    diagonal, above, right = drawn(3, 6, 4)
    smallest = np.linalg.eigvalsh(dense(diagonal, above))[0]
    for share, definite in ((0.99, True), (1.01, False)):
        shifted = diagonal - share * smallest * np.eye(4)
        assert (solve_tridiagonal(shifted, above, right) is not None) == definite


@given(seed=st.integers(0, 2**32 - 1), pieces=st.integers(2, 6), n=st.integers(1, 5))
@examples(30)
def test_rows_of_a_path_are_added_as_in_dense_normal_equations(seed: int, pieces: int, n: int) -> None:
    rng = np.random.default_rng(seed)
    count, k = pieces - 1, 12
    rows, errors, active = rng.normal(size=(k, n)), rng.normal(size=k), rng.random(k) < 0.7
    where = rng.integers(0, pieces, k)
    shares = np.where(rng.random(k) < 0.3, 0.0, rng.random(k))
    diagonal, above, gradient = np.zeros((count, n, n)), np.zeros((count - 1, n, n)), np.zeros((count, n))
    kernels.add_path_rows(rows, errors, where, shares, active, diagonal, above, gradient)
    whole = np.zeros((k, (pieces + 1) * n))
    for row in range(k):
        i = where[row]
        whole[row, i * n : (i + 1) * n] = (1.0 - shares[row]) * rows[row]
        whole[row, (i + 1) * n : (i + 2) * n] = shares[row] * rows[row]
    inner = whole[active][:, n:-n]
    np.testing.assert_allclose(dense(diagonal, above), inner.T @ inner, atol=1e-12)
    np.testing.assert_allclose(gradient.ravel(), -inner.T @ errors[active], atol=1e-12)
