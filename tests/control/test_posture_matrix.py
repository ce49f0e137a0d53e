"""Posture control matrices by passes along the chain, against dense ones and extended precision."""

from __future__ import annotations

from itertools import combinations

import numpy as np
import pytest
from chain_arms import ARMS, arm_called, branched, state_of
from hypothesis import given
from hypothesis import strategies as st
from sampling import examples

import pinposture as pp
from pinposture import kernels
from pinposture.control.thesis.posture_matrix import PostureMatrix, aligned_errors, descent
from pinposture.kernels.arrays import COUPLING, Rows
from pinposture.kernels.posture_matrix import _reflect

COUPLINGS = {"full": COUPLING.full, "relative": COUPLING.relative, "local": COUPLING.local}
kinds = st.sampled_from(sorted(ARMS))


def exact_step(matrix: np.ndarray, values: np.ndarray, secondary: np.ndarray) -> np.ndarray:
    """J^+ dr + (I - J^+ J) g by Gram-Schmidt, twice over, in extended precision."""
    J = matrix.astype(np.longdouble)
    g = secondary.astype(np.longdouble)
    rows = len(J)
    Q = np.zeros(J.shape, np.longdouble)
    R = np.zeros((rows, rows), np.longdouble)
    y = np.zeros(rows, np.longdouble)
    rest = values - J @ g
    for i in range(rows):
        row = J[i].copy()
        for _ in range(2):
            shares = Q[:i] @ row
            row -= shares @ Q[:i]
            R[i, :i] += shares
        R[i, i] = np.sqrt(row @ row)
        Q[i] = row / R[i, i]
        y[i] = (rest[i] - R[i, :i] @ y[:i]) / R[i, i]
    return g + y @ Q


def of_points(state: pp.ArmState, points: np.ndarray) -> tuple[PostureMatrix, np.ndarray]:
    """Posture control matrix of some control points, by passes and dense."""
    known = state.arm.kinematics.task_constants
    p = len(points)
    rows = Rows(points.astype(np.int64), known.dimensions[:p], known.frames[:p], COUPLING.full)
    return PostureMatrix(state.screws, rows), state.task_jacobians[points].reshape(-1, state.arm.nv)


@pytest.mark.parametrize(
    ("m", "amplitude", "every"), [(20, 0.3, 2), (20, 1e-3, 2), (60, 0.01, 2), (60, 1.0, 3)]
)
def test_the_step_is_as_accurate_as_the_matrix_allows(m: int, amplitude: float, every: int) -> None:
    arm = pp.Arm.from_template("RyRz", m)
    phase = np.random.default_rng(m).uniform(0, 6, (2, 1))
    smooth = amplitude * np.sin(np.pi * np.linspace(0, 3, m) + phase).T
    rng = np.random.default_rng(0)
    state = arm.at(arm.configuration(smooth.ravel()))
    points = np.arange(every - 1, m, every)
    matrix, dense = of_points(state, points)
    values = rng.normal(size=(len(points), 3))
    secondary = rng.normal(size=arm.nv)
    expected = exact_step(dense, values.ravel(), secondary)
    error = np.abs(matrix.step(arm, values, secondary) - expected).max() / np.abs(expected).max()
    sigma = np.linalg.svd(dense, compute_uv=False)
    assert error < 3e-15 * sigma[0] / sigma[-1] + 1e-14  # up to 1e7 of a condition number
    assert error < 1e-9
    assert matrix.smallest == pytest.approx(sigma[-1], rel=1e-8)
    assert matrix.largest == pytest.approx(sigma[0], rel=1e-12)


@given(kinds, st.integers(0, 10**6), st.sampled_from([0.5, 3.0]), st.sampled_from([0.05, 0.4]))
@examples(40)
def test_projection_moves_as_its_dense_matrix_says(
    kind: str, seed: int, amplitude: float, kappa: float
) -> None:
    arm = arm_called(kind)
    rng = np.random.default_rng(seed)
    state = state_of(arm, seed, amplitude)
    goal = state_of(arm, seed + 1, amplitude)
    weights = (rng.random(arm.n_modules) < 0.7).astype(float)
    weights[-1] = 1.0
    target = pp.Target.from_points(arm, goal.points, weights)
    secondary = rng.normal(size=arm.nv)
    errors = aligned_errors(state, target)
    for coupling in COUPLINGS:
        method = pp.Projection(threshold=kappa, coupling=coupling, gain=0.7)
        step = method.step_with(secondary, state, target, pp.Limits(step=1e9))
        given_errors = errors[:, : arm.dimension]
        matrix, velocity, active, smallest = method.posture_control_matrix(
            state, given_errors, target.has_target
        )
        assert step.active == active
        if not active or step.clipped.any():
            continue
        sigma = np.linalg.svd(matrix, compute_uv=False)
        pinv = np.linalg.pinv(matrix, rcond=1e-13)
        expected = secondary + pinv @ (0.7 * velocity - matrix @ secondary)
        scale = np.abs(expected).max() * sigma[0] / sigma[-1]
        np.testing.assert_allclose(step.dq, expected * arm.joint_units, rtol=0, atol=1e-13 * scale)
        assert step.info["rows"] == len(matrix)
        assert step.info["sigma_min"] == pytest.approx(sigma[-1], rel=1e-7)
        assert step.info["sigma_max"] == pytest.approx(sigma[0], rel=1e-9)
        assert step.info["manipulability"] == smallest


@given(kinds, st.integers(0, 10**6), st.sampled_from([0.0, 1e-7, 0.5, 3.0]), st.sampled_from([0.05, 0.4]))
@examples(40)
def test_spaces_of_modules_are_those_of_the_singular_values(
    kind: str, seed: int, amplitude: float, kappa: float
) -> None:
    """By their projectors: singular vectors of equal singular values are any of their plane."""
    arm = arm_called(kind)
    rng = np.random.default_rng(seed)
    state = state_of(arm, seed, amplitude)
    eligible = rng.random(arm.n_modules) < 0.7
    eligible[0] = True
    method = pp.Projection(threshold=kappa, coupling="local")
    matrix, velocity, active, smallest = method.posture_control_matrix(
        state, rng.normal(size=(arm.n_modules, arm.dimension)), eligible
    )
    ends = np.flatnonzero(eligible)
    row = 0
    ratios = [1.0]
    for start, end in zip([-1, *ends[:-1]], ends, strict=True):
        columns = arm.columns[arm.module_starts[start + 1] : arm.kinematics.ends[end]]
        own = state.task_jacobians[end][:, columns]
        left, sigma, _ = np.linalg.svd(own, full_matrices=False)
        least = kappa * np.sum(arm.chain.module_lengths[start + 1 : end + 1])
        if np.any(np.abs(sigma - least) < 1e-9):
            return  # rounding decides
        kept = int(np.count_nonzero(sigma > least))
        found = matrix[row : row + kept][:, columns]
        assert (end in active) == (kept > 0)
        np.testing.assert_allclose(np.linalg.norm(found, axis=1), sigma[:kept], atol=1e-13)
        reached = left[:, :kept].T @ own
        np.testing.assert_allclose(found.T @ found, reached.T @ reached, atol=1e-12)
        ratios.extend(sigma[:kept] / sigma[0])
        row += kept
    assert row == len(matrix) == len(velocity)
    assert smallest == pytest.approx(min(ratios) if active else 0.0, abs=1e-12)


@given(kinds, st.integers(0, 10**6), st.sampled_from([0.0, 1e-6, 0.5, 3.0]))
@examples(40)
def test_the_gradient_is_that_of_the_dense_jacobians(kind: str, seed: int, amplitude: float) -> None:
    arm = arm_called(kind)
    state = state_of(arm, seed, amplitude)
    goal = state_of(arm, seed + 1, 1.0)
    target = pp.Target.from_points(arm, goal.points, np.arange(arm.n_modules) % 3 > 0)
    errors = aligned_errors(state, target)
    found = descent(arm, state.screws, errors, np.linalg.norm(errors, axis=1))
    along = errors[:, : arm.dimension]
    gradient = np.einsum("kdu,kd->u", state.task_jacobians, along)
    travelled = np.sum((state.task_jacobians @ gradient) ** 2)
    np.testing.assert_allclose(found, gradient * (gradient @ gradient) / travelled, atol=1e-12)


def chosen_from(state: pp.ArmState, points: np.ndarray, least: float) -> np.ndarray:
    """Which of the control points `well_conditioned` chooses."""
    known = state.arm.kinematics.task_constants
    p = len(points)
    kept = np.empty(len(points), dtype=bool)
    rows = Rows(points, known.dimensions[:p], known.frames[:p], COUPLING.full)
    kernels.well_conditioned(state.screws, rows, least, kept)
    return kept


def smallest_of(state: pp.ArmState, points: np.ndarray) -> float:
    dense = state.task_jacobians[points].reshape(-1, state.arm.nv)
    return float(np.linalg.svd(dense, compute_uv=False)[-1]) if len(dense) <= state.arm.nv else 0.0


@given(kinds, st.integers(0, 10**6), st.sampled_from([1e-4, 0.01, 0.3, 2.0]), st.floats(-4.0, -1.0))
@examples(60)
def test_points_are_chosen_if_their_singular_values_admit_it(
    kind: str, seed: int, amplitude: float, exponent: float
) -> None:
    """Not below the bound, all if possible, and nearly as many as any choice of points has."""
    arm = arm_called(kind)
    rng = np.random.default_rng(seed)
    state = state_of(arm, seed, amplitude)
    least = 10.0**exponent
    points = np.sort(rng.choice(arm.n_modules, size=min(6, arm.n_modules), replace=False)).astype(np.int64)
    kept = chosen_from(state, points, least)
    rounding = 1e-7 * arm.length
    if kept.any():
        assert smallest_of(state, points[kept]) > least - rounding
    if smallest_of(state, points) > least + rounding:
        assert kept.all()
    sets = (np.array(each) for n in range(7) for each in combinations(points, n) if n)
    best = max((len(each) for each in sets if smallest_of(state, each) > least + rounding), default=0)
    assert kept.sum() >= best - 1


@pytest.mark.long
def test_few_points_are_dropped_on_long_arms() -> None:
    """One after the other, those most to blame: no more have to go than from base to tip, within a tenth."""
    for seed in range(3):
        arm = pp.Arm.from_template("RyRz", 120)
        wave = 0.1 * np.sin(np.linspace(0, 9, 120) + np.random.default_rng(seed).uniform(0, 6, (2, 1)))
        state = arm.at(arm.configuration(wave.T.ravel()))
        points = np.arange(1, 120, 2)
        least = 4.0 * smallest_of(state, points)
        kept = chosen_from(state, points, least)
        by_blame = points
        while smallest_of(state, by_blame) <= least:
            dense = state.task_jacobians[by_blame].reshape(-1, arm.nv)
            last = np.linalg.svd(dense, full_matrices=False)[0][:, -1]
            by_blame = np.delete(by_blame, np.argmax(np.linalg.norm(last.reshape(-1, 3), axis=1)))
        assert smallest_of(state, points[kept]) > least
        assert len(by_blame) < len(points)
        assert kept.sum() >= 0.9 * len(by_blame)


def test_joints_off_the_chain_stay_where_they_are() -> None:
    arm = branched()
    plain = pp.Arm.from_template("RyRz", 4)
    q = np.random.default_rng(0).uniform(-1, 1, 8)
    on_chain = arm.columns
    assert len(on_chain) == 8 == arm.nv - 1
    wide = np.full(9, 0.3)
    wide[on_chain] = q
    target = pp.Target.from_points(arm, plain.at(np.full(8, 0.4)).points)
    for name in ("selection", "projection"):
        method = pp.control.controller_named(name)
        one = method.step(arm.at(wide), target)
        other = method.step(plain.at(q), target)
        assert one.active == other.active
        np.testing.assert_allclose(one.dq[on_chain], other.dq, atol=1e-12)
        assert np.delete(one.dq, on_chain) == 0.0


reflect = _reflect.py_func


@pytest.mark.parametrize("size", [1.0, 1e-8, 1e-29, 1e-40, 1e-120, 1e-161, 0.0])
def test_the_reflection_that_zeroes_a_row_keeps_lengths_and_stays_finite(size: float) -> None:
    rng = np.random.default_rng(0)
    before = rng.normal(size=(6, 5))
    before[0] *= size
    after = before.copy()
    with np.errstate(all="ignore"):
        reflect(after, 0, 0, 5)
    assert np.all(np.isfinite(after))
    np.testing.assert_allclose(after @ after.T, before @ before.T, rtol=1e-12, atol=1e-12)
    np.testing.assert_allclose(after[0, 1:], 0.0, atol=1e-29)
