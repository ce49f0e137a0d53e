"""Indices of sections and the sets that are found without most of them."""

from __future__ import annotations

import sys
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from sampling import examples

import pinposture as pp
from pinposture import kernels
from pinposture.control import active_set
from pinposture.control.thesis.selection import base_indices, best_set

sys.path.insert(0, str(Path(__file__).resolve().parents[1] / "control"))
from chain_arms import ARMS, arm_called, state_of

kinds = st.sampled_from(sorted(ARMS))
amplitudes = st.sampled_from([0.0, 1e-3, 0.03, 0.3, 3.0])
NEARLY = 2e-8  # the closed form of an eigenvalue loses half the digits where two are nearly equal
shares = st.sampled_from([0.0, 0.001, 0.05, 0.3])


@given(kinds, st.integers(0, 10**6), amplitudes)
@examples(40)
def test_indices_are_those_of_the_singular_values(kind: str, seed: int, amplitude: float) -> None:
    arm = arm_called(kind)
    state = state_of(arm, seed, amplitude)
    indices = state.manipulability()
    assert not np.tril(indices).any()
    for s in range(arm.n_modules):
        for i in range(s + 1, arm.n_modules + 1):
            own = state.task_jacobians[i - 1][:, arm.columns[arm.module_starts[s] :]]
            sigma = np.linalg.svd(own, compute_uv=False)[: arm.dimension]
            expected = np.prod(sigma / sigma[0]) if sigma[0] > 0.0 and len(sigma) == arm.dimension else 0.0
            assert indices[s, i] ** 2 == pytest.approx(expected**2, abs=NEARLY)


@given(kinds, st.integers(0, 10**6), amplitudes, shares)
@examples(40)
def test_indices_to_the_base_are_the_same_and_decide_the_same(
    kind: str, seed: int, amplitude: float, threshold: float
) -> None:
    state = state_of(arm_called(kind), seed, amplitude)
    found = base_indices(state.arm, state.screws, threshold)
    expected = state.manipulability()[0, 1:]
    np.testing.assert_allclose(found**2, expected**2, rtol=0, atol=NEARLY)
    np.testing.assert_array_equal(found > threshold, expected > threshold)


@given(kinds, st.integers(0, 10**6), amplitudes, shares, shares, st.sampled_from(["any", "equal", "few"]))
@examples(40)
def test_the_search_finds_the_set_that_all_indices_give(
    kind: str, seed: int, amplitude: float, absolute: float, relative: float, errors: str
) -> None:
    arm = arm_called(kind)
    rng = np.random.default_rng(seed)
    state = state_of(arm, seed, amplitude)
    distances = {
        "any": rng.uniform(0.0, 1.0, arm.n_modules),
        "equal": np.ones(arm.n_modules),
        "few": np.floor(rng.uniform(0.0, 3.0, arm.n_modules)),
    }[errors]
    eligible = rng.random(arm.n_modules) < 0.8
    indices = state.manipulability()
    expected = active_set(indices, distances, absolute, relative, eligible)
    usable = (indices[0, 1:] > absolute) & eligible
    found = best_set(arm, state.screws, usable, distances, relative)
    assert tuple(found.tolist()) == expected


@pytest.mark.parametrize("amplitude", [0.003, 0.02, 0.1, 0.5])
def test_the_same_on_a_long_arm(amplitude: float) -> None:
    arm = pp.Arm.from_template("RyRz", 120)
    for seed in range(3):
        state = state_of(arm, seed, amplitude)
        distances = np.random.default_rng(seed).uniform(0, 1, 120)
        indices = state.manipulability()
        for relative in (0.001, 0.02):
            expected = active_set(indices, distances, 0.001, relative)
            usable = base_indices(arm, state.screws, 0.001) > 0.001
            found = best_set(arm, state.screws, usable, distances, relative)
            assert tuple(found.tolist()) == expected
            if expected:
                plane = arm.kinematics.task_constants.plane
                active = np.array(expected)
                base = base_indices(arm, state.screws, 0.001)
                weakest = kernels.weakest_index(state.screws, plane, active, base)
                nodes = np.append(0, active + 1)
                assert weakest == pytest.approx(
                    min(indices[0, nodes[1:]].min(), indices[nodes[:-1], nodes[1:]].min()), rel=1e-9
                )
