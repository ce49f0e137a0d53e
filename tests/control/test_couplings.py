"""The couplings of the Projection matrix: what each asks of a module, and that all have full row rank."""

from __future__ import annotations

import numpy as np
import pytest
from arms import template_arm
from hypothesis import given
from hypothesis import strategies as st
from sampling import examples

import pinposture as pp
from pinposture.control.controller import task_errors
from pinposture.curve import HELIX
from pinposture.kernels.arrays import COUPLING

FREE = pp.Limits(step=1e6)


@pytest.fixture(scope="session")
def spatial() -> pp.Arm:
    return template_arm("RyRz", 8)


@pytest.fixture(scope="session")
def long() -> pp.Arm:
    return template_arm("RyRz", 20)


@pytest.fixture(scope="session")
def planar() -> pp.Arm:
    return template_arm("Rz", 12)


def random_posture(arm: pp.Arm, seed: int, amplitude: float) -> np.ndarray:
    return arm.configuration(amplitude * np.random.default_rng(seed).uniform(-1, 1, arm.nv))


def goal(arm: pp.Arm, seed: int, free: list[int]) -> pp.Target:
    weights = np.ones(arm.n_modules)
    weights[free] = 0.0
    return pp.Target.from_points(arm, arm.at(random_posture(arm, seed + 10**6, 0.6)).points, weights)


@given(
    st.integers(0, 10**6),
    st.sampled_from([0.0, 1e-6, 0.8, 3.1]),
    st.sampled_from(["spatial", "planar"]),
    st.lists(st.integers(0, 7), max_size=5),
)
@examples(40)
def test_every_coupling_has_full_row_rank_also_with_free_points(
    spatial: pp.Arm, planar: pp.Arm, seed: int, amplitude: float, kind: str, free: list[int]
) -> None:
    arm = spatial if kind == "spatial" else planar
    state = arm.at(random_posture(arm, seed, amplitude))
    target = goal(arm, seed, free)
    for coupling in COUPLING._fields:
        method = pp.Projection(coupling=coupling)
        matrix, velocity, active, _ = method.posture_control_matrix(
            state, task_errors(state, target), target.has_target
        )
        assert len(matrix) == len(velocity)
        assert not set(active) & set(free)
        assert np.linalg.matrix_rank(matrix, tol=1e-9 * arm.length) == len(matrix)


@pytest.mark.parametrize("free", [[], [2, 3], [0, 5], [0, 1, 6]])
def test_relative_coupling_covers_the_errors_between_neighbours(spatial: pp.Arm, free: list[int]) -> None:
    """By finite differences: the motion between neighbours, in the directions that the module has."""
    state = spatial.at(random_posture(spatial, 5, 0.7))
    target = goal(spatial, 5, free)
    step = pp.Projection(coupling="relative", gain=0.4, null_gain=0.0).step(state, target, FREE)
    h = 1e-6
    ahead, behind = (spatial.at(state.q + sign * h * step.dq).points for sign in (1.0, -1.0))
    motion = (ahead - behind) / (2.0 * h)
    errors = target.points - state.points
    previous = -1
    for k in np.flatnonzero(target.has_target):
        section = state.jacobians[k][:, 2 * (previous + 1) : 2 * k + 2]
        directions, sigma, _ = np.linalg.svd(section)
        kept = directions[:, : np.count_nonzero(sigma > 0.4 * 0.05 * (k - previous))]
        assert 1 <= kept.shape[1] <= (2 if k - previous == 1 else 3)
        moved = motion[k] - (0.0 if previous < 0 else motion[previous])
        wanted = errors[k] - (0.0 if previous < 0 else errors[previous])
        np.testing.assert_allclose(kept.T @ moved, 0.4 * kept.T @ wanted, atol=1e-8)
        previous = k


@pytest.mark.long
def test_relative_coupling_unrolls_the_straight_arm_onto_the_helix_where_the_others_fail(
    long: pp.Arm,
) -> None:
    target = pp.resolve_targets(long, HELIX)
    ends = {}
    for coupling in COUPLING._fields:
        run = pp.track(long, target, long.straight(), pp.Projection(coupling=coupling), max_steps=400)
        ends[coupling] = run.point_errors[-1].mean() / long.length
    assert ends["relative"] < 1e-5
    assert min(ends["full"], ends["local"]) > 1e-3
