"""The best branch of the tree of sections against all branches, and what Algorithm 2 leaves of them."""

from __future__ import annotations

from itertools import combinations, islice, pairwise

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from sampling import examples

import pinposture as pp
from pinposture.control import SectionTree, section_indices
from pinposture.errors import InvalidValue

SCORES = ("thesis", "geometric")
SIZES = [(2, 3), (2,), (3,), (1, 2), (2, 3, 5)]


def scored(tree: SectionTree, branch: tuple[int, ...], score: str) -> tuple[float, tuple[int, ...]]:
    """Algorithm 2 and (4.8) as they are written down: the score of a branch, and its points (0-based)."""
    points = []
    kept = []
    if branch[0] > 0 and tree.usable[branch[0] - 1]:
        points.append(branch[0] - 1)
    for start, end in pairwise(branch):
        if tree.indices[start, end] > tree.threshold and tree.usable[end - 1]:
            points.append(end - 1)
            kept.append(tree.indices[start, end])
    eta = len(kept)
    product = np.prod(kept) if score == "thesis" else np.prod(kept) ** (1.0 / max(eta, 1))
    return (eta + 1) * float(product) if points else 0.0, tuple(points)


def compare_with_all_branches(tree: SectionTree) -> None:
    for score in SCORES:
        found = tree.best(score)
        everything = [scored(tree, branch, score) for branch in tree.branches()]
        highest = max(value for value, _ in everything)
        assert np.exp(found.score) == pytest.approx(highest, rel=1e-9)
        assert found.points in [points for value, points in everything if value >= highest * (1.0 - 1e-9)]
        for branch, (value, points) in zip(tree.branches(), everything, strict=True):
            pruned = tree.pruned(branch, score)
            assert pruned.points == points
            assert np.exp(pruned.score) == pytest.approx(value, rel=1e-9)


regions = st.tuples(st.integers(0, 15), st.integers(0, 15)).map(sorted)


@given(
    st.integers(1, 16),
    st.integers(0, 10**6),
    st.sampled_from([0.05, 0.5, 2.5]),
    st.sampled_from([0.0, 0.001, 0.05, 0.3]),
    st.sampled_from([0.0, 0.01, 0.2]),
    st.sampled_from([0.6, 1.0]),
    regions,
)
@examples(40)
def test_the_best_branch_is_the_best_of_all_on_real_postures(
    m: int, seed: int, amplitude: float, threshold: float, absolute: float, placed: float, region: list[int]
) -> None:
    rng = np.random.default_rng(seed)
    links = rng.choice([0.1, 0.15, 0.3], m)
    arm = pp.Arm.from_modules([pp.template("Rz").with_lengths((link,)) for link in links])
    q = amplitude * rng.uniform(-1, 1, m) * (rng.random(m) < 0.7)  # some joints exactly straight
    state = arm.at(q)
    usable = (state.manipulability()[0, 1:] > absolute) & (rng.random(m) < placed)
    first, last = (min(k, m - 1) for k in region)
    compare_with_all_branches(SectionTree(section_indices(state, (2, 3)), usable, threshold, first, last))


@given(
    st.integers(1, 16),
    st.integers(0, 10**6),
    st.sampled_from([0.0, 0.3, 0.9]),
    st.sampled_from([0.3, 0.8, 1.0]),
    regions,
    st.sampled_from(SIZES),
)
@examples(40)
def test_the_same_on_arbitrary_indices(
    m: int, seed: int, threshold: float, share: float, region: list[int], sizes: tuple[int, ...]
) -> None:
    rng = np.random.default_rng(seed)
    first, last = (min(k, m - 1) for k in region)
    if sizes == (1, 2):
        last = min(last, first + 9)  # their branches are many
    indices = np.triu(rng.uniform(0, 1, (m + 1, m + 1)), 1)
    compare_with_all_branches(SectionTree(indices, rng.random(m) < share, threshold, first, last, sizes))


def ones(m: int, first: int, last: int, sizes: tuple[int, ...] = (2, 3)) -> SectionTree:
    return SectionTree(np.triu(np.ones((m + 1, m + 1)), 1), np.ones(m, dtype=bool), 0.5, first, last, sizes)


@pytest.mark.parametrize("sizes", SIZES)
@pytest.mark.parametrize(("first", "last"), [(0, 8), (2, 8), (3, 3), (0, 0), (4, 5), (0, 2)])
def test_branches_are_all_chains_that_cannot_be_longer(first: int, last: int, sizes: tuple[int, ...]) -> None:
    tree = ones(9, first, last, sizes)
    root = 0 if first == 0 else first + 1  # the base, where the region begins with the first point
    inside = range(root + 1, last + 2)
    expected = {
        (root, *rest)
        for size in range(len(inside) + 1)
        for rest in combinations(inside, size)
        if all(end - start in sizes for start, end in pairwise((root, *rest)))
        and max((root, *rest)) + min(sizes) > last + 1
    }
    found = list(tree.branches())
    assert len(found) == len(set(found))
    assert set(found) == expected


def test_the_region_of_figure_4_7_has_nine_branches() -> None:
    # From point i to point i + 9: lengths 8 and 9 as sums of twos and threes, in order: 4 and 5 ways.
    branches = list(ones(30, 10, 19).branches())
    assert len(branches) == 9
    assert all(branch[0] == 11 and branch[-1] in (19, 20) for branch in branches)
    assert branches[0] == (11, 13, 15, 17, 19)


def test_branches_are_lazy_and_the_best_of_a_long_arm_needs_none() -> None:
    tree = ones(300, 0, 299)  # some 10^36 branches
    assert len(set(islice(tree.branches(), 500))) == 500
    assert tree.best("thesis").points == tuple(range(1, 300, 2))
    low = SectionTree(1e-4 * tree.indices, tree.usable, 1e-5, 0, 299)  # products of 1e-400 underflow
    assert low.best("thesis").edges == 100
    assert low.best("thesis").score == pytest.approx(np.log(101) + 100 * np.log(1e-4))
    assert low.best("geometric").points == tuple(range(1, 300, 2))


def test_the_thesis_score_pays_for_an_edge_only_above_its_bar_and_the_geometric_one_below_it_too() -> None:
    for eta in range(1, 12):
        bar = (eta + 1) / (eta + 2)
        for index, pays in ((bar + 1e-6, True), (bar - 1e-6, False)):
            indices = np.triu(np.ones((2 * eta + 3,) * 2), 1)
            indices[2 * eta, 2 * eta + 2] = index  # the last of eta + 1 sections
            tree = SectionTree(indices, np.ones(2 * eta + 2, dtype=bool), 0.0, 0, 2 * eta + 1, (2,))
            branch = tuple(range(0, 2 * eta + 3, 2))
            with_it, without = (tree.pruned(b, "thesis").score for b in (branch, branch[:-1]))
            assert (with_it > without) == pays
            assert tree.pruned(branch, "geometric").score > tree.pruned(branch[:-1], "geometric").score


def test_the_thesis_score_prefers_few_points_where_sections_are_far_from_their_best() -> None:
    rng = np.random.default_rng(0)
    counts = []
    for _ in range(20):
        indices = np.triu(rng.uniform(0.1, 0.4, (31, 31)), 1)
        tree = SectionTree(indices, np.ones(30, dtype=bool), 0.05, 0, 29)
        counts.append([len(tree.best(score).points) for score in SCORES])
    few, many = np.mean(counts, axis=0)
    assert few < many - 2


def test_merged_sections_keep_the_rank_and_lose_no_singular_value() -> None:
    rng = np.random.default_rng(4)
    arm = pp.Arm.from_template("Rz", 16)
    merged = 0
    for _ in range(40):
        q = rng.uniform(-1.5, 1.5, 16) * (rng.random(16) < 0.5)
        state = arm.at(q)
        indices = section_indices(state, (2, 3))
        usable = state.manipulability()[0, 1:] > 0.01
        tree = SectionTree(indices, usable, 0.05, 3 * int(rng.integers(0, 3)), 15)
        for points in {tree.best(score).points for score in SCORES} - {()}:
            merged += any(after - before > 3 for before, after in pairwise(points))
            assert usable[list(points)].all()
            stacked = np.vstack([state.task_jacobians[k] for k in points])
            assert np.linalg.matrix_rank(stacked, tol=1e-6) == 2 * len(points)
            for before, after in pairwise(points):
                # The shortest stable section into a point, against the whole one from the point before.
                own = min(size for size in (2, 3) if indices[after + 1 - size, after + 1] > 0.05)
                edge = state.task_jacobians[after][:, after + 1 - own : after + 1]
                whole = state.task_jacobians[after][:, before + 1 : after + 1]
                least = (np.linalg.svd(part, compute_uv=False)[-1] for part in (edge, whole))
                assert next(least) <= next(least) + 1e-12
    assert merged > 5


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"first": 4, "last": 3}, "region"),
        ({"last": 9}, "<= 8"),
        ({"section_sizes": ()}, "section_sizes"),
        ({"section_sizes": (0, 2)}, "at least 1"),
        ({"section_sizes": 2}, "section_sizes"),
        ({"threshold": float("nan")}, "threshold"),
        ({"indices": np.zeros((9, 9))}, r"\(10, 10\)"),
    ],
)
def test_bad_values_are_named(change: dict, message: str) -> None:
    arguments = {
        "indices": np.zeros((10, 10)),
        "usable": np.ones(9, dtype=bool),
        "threshold": 0.1,
        "first": 0,
        "last": 8,
    }
    with pytest.raises(InvalidValue, match=message):
        SectionTree(**(arguments | change))
