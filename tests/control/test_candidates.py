"""The active set found along the graph against exhaustive enumeration."""

from __future__ import annotations

from itertools import islice

import numpy as np
import pytest
from analytic import enumeration
from hypothesis import given
from hypothesis import strategies as st

import pinposture as pp
from pinposture.control import active_set, candidate_sets
from pinposture.errors import InvalidValue


def as_sets(found: object) -> list[tuple[int, ...]]:
    """0-based tuples of the package as sorted 1-based tuples of the reference."""
    return sorted(tuple(k + 1 for k in path) for path in found)


@given(
    st.integers(1, 10),
    st.integers(0, 10**6),
    st.sampled_from([0.0, 0.005, 0.05, 0.2]),
    st.sampled_from([0.0, 0.005, 0.05, 0.2]),
)
def test_the_active_set_is_the_best_of_all_candidates_on_real_postures(
    m: int, seed: int, absolute: float, relative: float
) -> None:
    rng = np.random.default_rng(seed)
    arm = pp.Arm.from_template("RyRz", m)
    indices = arm.at(
        arm.configuration(rng.choice([0.05, 0.5, 2.0]) * rng.uniform(-1, 1, 2 * m))
    ).manipulability()
    errors = rng.uniform(0.0, 1.0, m)
    sets = enumeration.candidate_sets(indices, absolute, relative)
    assert as_sets(candidate_sets(indices, absolute, relative)) == sorted(map(tuple, sets))
    expected = enumeration.best_by_score(sets, errors)
    assert as_sets([active_set(indices, errors, absolute, relative)]) == [tuple(expected)]


@given(st.integers(1, 10), st.integers(0, 10**6), st.floats(0.0, 0.95))
def test_the_same_on_arbitrary_index_matrices(m: int, seed: int, threshold: float) -> None:
    rng = np.random.default_rng(seed)
    indices = np.zeros((m + 1, m + 1))
    indices[np.triu_indices(m + 1, 1)] = rng.uniform(0, 1, m * (m + 1) // 2)
    errors = rng.uniform(0.0, 1.0, m)
    expected = enumeration.best_by_score(
        enumeration.candidate_sets_by_subsets(indices, threshold, threshold), errors
    )
    assert as_sets([active_set(indices, errors, threshold, threshold)]) == [tuple(expected)]


def test_enumeration_is_lazy() -> None:
    indices = np.triu(np.ones((61, 61)), 1)  # 2^60 candidate sets
    first = list(islice(candidate_sets(indices, 0.5, 0.5), 1000))
    assert len(set(first)) == 1000
    assert active_set(indices, np.ones(60), 0.5, 0.5) == tuple(range(60))


def test_points_that_may_not_be_used_are_not() -> None:
    indices = np.triu(np.ones((6, 6)), 1)
    eligible = np.array([True, False, True, False, True])
    assert active_set(indices, np.ones(5), 0.5, 0.5, eligible) == (0, 2, 4)
    assert active_set(indices, np.ones(5), 1.0, 0.5) == ()


def test_a_matrix_of_the_wrong_shape_is_named() -> None:
    with pytest.raises(InvalidValue, match=r"\(m \+ 1, m \+ 1\)"):
        active_set(np.zeros((3, 4)), np.zeros(2), 0.1, 0.1)
