"""The misprints of the thesis that docs/thesis.md corrects and that no other test is about."""

from __future__ import annotations

import numpy as np
import pytest
from analytic import enumeration, planar, ryrz, torus
from arms import template_arm
from hypothesis import given
from hypothesis import strategies as st
from sampling import examples, seeds

import pinposture as pp
from pinposture.arm import smooth_configuration
from pinposture.control import candidate_sets
from pinposture.control.controller import task_errors
from pinposture.curve import LINE

SEEDS = st.integers(0, 10**6)


@pytest.fixture(scope="session")
def arm() -> pp.Arm:
    return template_arm("RyRz", 10)


@given(SEEDS)
@examples(20)
def test_4_2_needs_the_derivative_of_the_orientations(arm: pp.Arm, seed: int) -> None:
    state = arm.at(arm.random(np.random.default_rng(seed)))
    q = state.q
    for k in range(1, arm.n_modules):
        local = ryrz.fk(q[2 * k : 2 * k + 2], 0.025, 0.025)
        derivatives = [ryrz.derivative(k, u, q, 0.025, 0.025) for u in range(2 * k)]
        put_right = np.array([dp + dE @ local for dp, dE in derivatives]).T
        np.testing.assert_allclose(state.jacobians[k][:, : 2 * k], put_right, atol=1e-12)
        printed = np.array([dp + state.points[k] - state.points[k - 1] for dp, _ in derivatives]).T
        assert np.abs(printed - put_right).max() > 0.1 * np.abs(local).max()


def test_the_signs_and_the_sum_of_4_7_as_printed_lead_nowhere(arm: pp.Arm) -> None:
    active = [2, 5, 8]
    for seed in seeds(200):
        rng = np.random.default_rng(seed)
        state, c = arm.at(rng.uniform(-1.2, 1.2, 20)), arm.at(rng.uniform(-1.2, 1.2, 20)).points
        J = np.vstack(state.jacobians[active])
        null = np.eye(20) - np.linalg.pinv(J) @ J
        terms = np.array([-state.jacobians[k].T @ (state.points[k] - c[k]) for k in range(10)])

        def errors(dq: np.ndarray, state: pp.ArmState = state, c: np.ndarray = c) -> np.ndarray:
            return np.linalg.norm(arm.at(state.q + 1e-7 * dq / np.linalg.norm(dq)).points - c, axis=1)

        along = np.linalg.pinv(J) @ (state.points - c)[active].ravel()
        assert errors(along)[active].sum() > errors(-along)[active].sum()
        assert np.abs(null @ terms[active].sum(axis=0)).max() < 1e-9
        across = -1.0 * null @ terms.sum(axis=0)  # alpha = -1
        assert np.sum(errors(across) ** 2) > np.sum(errors(-across) ** 2)


@given(SEEDS, st.integers(1, 4), st.integers(1, 3))
@examples(20)
def test_projected_jacobians_are_those_of_5_6_and_not_of_the_shapes_of_5_4(seed: int, n: int, r: int) -> None:
    J = np.random.default_rng(seed).normal(size=(3, n + 1))
    U, sigma, Vt = np.linalg.svd(J)
    r = min(r, len(sigma))
    np.testing.assert_allclose(U[:, :r].T @ J, np.diag(sigma[:r]) @ Vt[:r], atol=1e-12)
    if r < n + 1:
        with pytest.raises(ValueError, match="mismatch"):
            np.diag(sigma[:r]) @ Vt  # (5.4)


def test_5_9_as_printed_does_not_do_what_5_10_asks() -> None:
    arm, missed = pp.Arm.from_template("RyRz", 20), {"full": [], "local": []}
    for seed in range(40):
        rng = np.random.default_rng(seed)
        state = arm.at(smooth_configuration(arm, rng, 0.6))
        target = pp.Target.from_configuration(arm, smooth_configuration(arm, rng, 0.6))
        asked = {
            coupling: pp.Projection(coupling=coupling).posture_control_matrix(
                state, task_errors(state, target), target.has_target
            )
            for coupling in missed
        }
        motion, velocity, *_ = asked["full"]  # how the points do move in the directions kept
        for coupling, (matrix, *_) in asked.items():
            off = motion @ (np.linalg.pinv(matrix) @ velocity) - velocity
            missed[coupling].append(np.linalg.norm(off) / np.linalg.norm(velocity))
    assert max(missed["full"]) < 1e-9
    assert np.median(missed["local"]) > 5.0


@given(SEEDS)
@examples(15)
def test_6_4_and_6_7_hold_with_their_limits_put_right(seed: int) -> None:
    rng, (l1, l2), m = np.random.default_rng(seed), (0.03, 0.02), 5
    arm = pp.Arm.from_template("RyRz", m, (l1, l2))
    q, ex = rng.uniform(-3.0, 3.0, 2 * m), np.array([1.0, 0.0, 0.0])
    state, Iy, Iz = arm.at(q), np.diag([1.0, 0.0, 1.0]), np.diag([1.0, 1.0, 0.0])

    def sums(k: int, first: int, u: int | None = None) -> np.ndarray:
        """(6.4) without u, (6.7) with it."""
        Ry = [Iy @ ryrz.ry(a + np.pi / 2) if i == u else ryrz.ry(a) for i, a in enumerate(q)]
        Rz = [Iz @ ryrz.rz(a + np.pi / 2) if i == u else ryrz.rz(a) for i, a in enumerate(q)]
        total, product = np.zeros(3), np.eye(3)
        for i in range(k):
            own = l1 * np.eye(3) * (2 * i + 1 != u) + l2 * Rz[2 * i + 1]
            total += (i >= first) * (product @ Ry[2 * i] @ own @ ex)
            product = product @ Ry[2 * i] @ Rz[2 * i + 1]  # the factors j = 1 ... i + 1
        return total

    for k in range(1, m + 1):
        np.testing.assert_allclose(state.points[k - 1], sums(k, 0), atol=1e-13)
        columns = [sums(k, u // 2, u) for u in range(2 * k)]
        np.testing.assert_allclose(state.jacobians[k - 1][:, : 2 * k].T, columns, atol=1e-13)


@given(SEEDS, st.sampled_from([(0.025, 0.025), (0.03, 0.02), (1.0, 2.0)]))
@examples(25)
def test_6_13_and_6_15_put_right_are_the_torus_along_a_segment(
    seed: int, lengths: tuple[float, float]
) -> None:
    rng, (l1, l2) = np.random.default_rng(seed), lengths
    q = rng.uniform(-3.0, 3.0, 2)
    p, s = ryrz.fk(q, l1, l2), l1**2 + l2**2
    assert (p @ p - s) ** 2 == pytest.approx(4 * l1**2 * (l2**2 - p[1] ** 2), abs=1e-12 * s**2)
    reach = l1 + l2  # of the straight module: as printed it would be off the torus
    assert abs((reach**2 - reach) ** 2 - 4 * l1**2 * l2**2) > 0.1 * (l1 * l2) ** 2
    a, b = rng.uniform(-1.0, 1.0, (2, 3)) * (l1 + l2)
    d, nodes = b - a, np.linspace(0.0, 1.0, 5)
    right = [
        (d @ d) ** 2,
        4 * (a @ d) * (d @ d),
        2 * (a @ a - s) * (d @ d) + 4 * (a @ d) ** 2 + 4 * l1**2 * d[1] ** 2,
        4 * (a @ d) * (a @ a - s) + 8 * l1**2 * a[1] * d[1],
        (a @ a - s) ** 2 - 4 * l1**2 * (l2**2 - a[1] ** 2),
    ]
    np.testing.assert_allclose(
        np.polyval(right, nodes), torus.implicit(a + np.outer(nodes, d), l1, l2), atol=1e-11 * s**2
    )


def test_algorithm_1_needs_what_lies_ahead_and_not_a_single_positive_root() -> None:
    assert torus.implicit(np.zeros(3), 0.025, 0.025) == 0.0  # the base lies on the torus
    # On a segment that began before the module and is longer than it: a crossing at the base, one ahead.
    t = torus.intersections((-0.02, 0.0, 0.0), (0.06, 0.0, 0.0), 0.025, 0.025)
    np.testing.assert_allclose(0.08 * t - 0.02, [0.0, 0.05], atol=1e-8)
    arm = pp.Arm.from_template("RyRz", 20)
    for segments in (15, 20, 50):
        target = pp.resolve_targets(arm, LINE, samples=segments + 1, method="sequential")
        np.testing.assert_allclose(target.points[:, 0], 0.05 * np.arange(1, 21), atol=1e-9)


@given(SEEDS)
@examples(40)
def test_in_a_plane_the_rank_carries_over_to_later_points(seed: int) -> None:
    rng = np.random.default_rng(seed)
    q, links = rng.choice([0.0, np.pi, -np.pi, np.pi / 2, 0.7], 7), rng.choice([0.5, 1.0], 7)
    ranks = [planar.rank(planar.jacobian(k, q, links)) for k in range(1, 8)]
    assert ranks == sorted(ranks)


def test_candidate_sets_have_block_triangular_matrices_of_full_rank(arm: pp.Arm) -> None:
    rng, seen = np.random.default_rng(0), 0
    for _ in range(10):
        state = arm.at(rng.uniform(-1.2, 1.2, 20))
        sets = list(candidate_sets(state.manipulability(), 1e-3, 1e-3))
        for points in (sets[i] for i in rng.integers(0, len(sets), 10)):
            matrix = np.vstack(state.jacobians[list(points)])
            assert np.linalg.matrix_rank(matrix) == len(matrix)
            start = 0
            for row, k in enumerate(points):
                own = matrix[3 * row : 3 * row + 3, 2 * start : 2 * k + 2]
                assert not matrix[: 3 * row, 2 * start :].any()
                expected = ryrz.section_jacobian(k + 1, start, state.q, 0.025, 0.025)
                sigma = [np.linalg.svd(part, compute_uv=False) for part in (own, expected)]
                np.testing.assert_allclose(*sigma, atol=1e-12)
                start, seen = k + 1, seen + 1
    assert seen > 200


def test_two_joint_modules_in_space_never_give_neighbours() -> None:
    for seed in seeds(20):
        q = np.random.default_rng(seed).uniform(-1.0, 1.0, 6)
        w = enumeration.index_matrix(lambda s, i, q=q: ryrz.section_jacobian(i, s, q, 0.025, 0.025), 3)
        assert enumeration.candidate_sets(w, 1e-3, 1e-3) == [(2,), (3,)]
