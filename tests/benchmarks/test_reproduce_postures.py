"""Claims on postures, against enumeration and matrices whose rank is known."""

from __future__ import annotations

import numpy as np
import pytest
from arms import template_arm
from hypothesis import given
from hypothesis import strategies as st
from sampling import examples

from benchmarks.reproduce import evaluate
from benchmarks.reproduce.runs import DEFAULT, READINGS, Reading, thesis_arm
from pinposture.control import candidate_sets


@pytest.fixture(scope="session")
def arm():
    return template_arm("RyRz", 6)


@given(values=st.lists(st.floats(0, 1), min_size=1, max_size=8), threshold=st.floats(0, 1))
@examples(40)
def test_carrying_over_means_no_failure_after_a_success(values, threshold):
    clears = [value > threshold for value in values]
    expected = not any(a and not b for i, a in enumerate(clears) for b in clears[i + 1 :])
    assert evaluate.carries_over(np.array(values), threshold) is expected


@given(seed=st.integers(0, 10_000))
@examples(30)
def test_random_sets_are_candidate_sets_that_cannot_go_on(arm, seed):
    rng = np.random.default_rng(seed)
    indices = arm.at(rng.uniform(-0.6, 0.6, arm.nv)).manipulability()
    allowed = set(candidate_sets(indices, 0.01, 0.01))
    drawn = tuple(k - 1 for k in evaluate.random_set(indices, 0.01, rng))
    if not allowed:
        assert drawn == ()
        return
    assert drawn in allowed
    assert not any(len(other) > len(drawn) and other[: len(drawn)] == drawn for other in allowed)


def test_full_rank_of_known_matrices():
    matrix = np.array([[1.0, 2, 3], [0, 1, 1], [1, 3, 4]])
    assert not evaluate.has_full_rank(matrix)
    assert evaluate.has_full_rank(matrix[:2])
    assert evaluate.has_full_rank(np.zeros((0, 0)))
    assert not evaluate.has_full_rank(np.ones((3, 2)))


def test_stacked_jacobians_have_the_columns_that_move_something(arm):
    state = arm.at(np.full(arm.nv, 0.2))
    matrix = evaluate.stacked(state, [1, 3])
    assert matrix.shape == (6, 8)
    np.testing.assert_array_equal(matrix[:3], state.jacobians[1][:, :8])
    np.testing.assert_array_equal(matrix[3:], state.jacobians[3][:, :8])


def test_counts_over_the_arms_of_the_thesis():
    counted = evaluate.count_postures(1)
    assert len(counted) == 2 * len(evaluate.KINDS) * evaluate.DRAWS * len(evaluate.THRESHOLDS)
    planar = [each for each in counted if each.arm == "planar45"]
    assert all(each.section_deficient for each in planar)  # proved in Appendix A
    assert all(each.full_rank for each in counted)
    reading = Reading({}, READINGS[DEFAULT], counted=counted)
    names = [name for name in evaluate.MEASURES if name not in evaluate.measures.MEASURES]
    findings = {name: evaluate.MEASURES[name](reading) for name in names}
    for finding in findings.values():
        assert finding.shares
        assert all(each.true <= each.cases for each in finding.shares.values())
    total = findings["absolute-carries-over"].shares.values()
    assert sum(each.true for each in total) == sum(each.carried for each in counted)
    for arm in ("planar", "spatial"):
        shares = findings[f"singular-section-{arm}"].shares
        assert all(name.startswith(arm) for name in shares)
        assert sum(each.cases for each in shares.values()) == len(counted) / 6


def test_a_posture_that_fails_the_absolute_condition_later_is_counted():
    # A bend near the base lets points beside it move every way; the long straight rest hardly moves along it.
    arm = thesis_arm("planar45")
    q = np.zeros(45)
    q[1] = 1.5
    found = evaluate.count_posture(arm, "planar45", "any", q, np.random.default_rng(0))
    indices = arm.at(q).manipulability()[0, 1:]
    for each in found:
        clears = indices > each.threshold
        assert each.carried == (not np.any(clears[:-1] & ~clears[1:]))
    assert not all(each.carried for each in found)
    assert [each.threshold for each in found] == pytest.approx(evaluate.THRESHOLDS)
