"""The baselines: each step against an independent formula."""

from __future__ import annotations

from functools import cache

import numpy as np
import pinocchio as pin
import pytest
from arms import template_arm
from control.baseline_arms import PLACEMENT, SLIDING, state_of, target_of
from hypothesis import given
from hypothesis import strategies as st
from sampling import examples
from scipy.linalg import null_space
from scipy.optimize import lsq_linear

import pinposture as pp
from benchmarks.baselines import (
    AugmentedJacobian,
    DampedLeastSquares,
    ExtendedJacobian,
    LevenbergMarquardt,
    PseudoInverse,
    TaskConstraints,
    objective_gradient,
)
from pinposture.control import controller_named
from pinposture.errors import InvalidValue, UnknownName

FREE = pp.Limits(step=None)
ARMS = {
    "spatial": lambda: template_arm("RyRz", 7),
    "planar": lambda: pp.Arm.from_template("Rz", 8, base_placement=PLACEMENT),
    "sliding": lambda: pp.Arm.from_modules([SLIDING] * 4),
}


@pytest.fixture(scope="session")
def spatial() -> pp.Arm:
    return template_arm("RyRz", 7)


def unlimited(arm: pp.Arm) -> pp.Arm:
    """The arm without position limits, so that nothing is clipped."""
    model = pin.Model(arm.model)
    model.lowerPositionLimit = np.full(arm.nq, -np.inf)
    model.upperPositionLimit = np.full(arm.nq, np.inf)
    return pp.Arm.from_model(model, arm.control_points)


@cache
def open_arm(kind: str) -> pp.Arm:
    return unlimited(ARMS[kind]())


def stacked(state: pp.ArmState, target: pp.Target, points: list[int]) -> tuple[np.ndarray, np.ndarray]:
    """Jacobian and errors of some points in world axes and joint units, by nothing but loops."""
    rows = [state.jacobians[k] * state.arm.joint_units for k in points]
    return np.vstack(rows), np.concatenate([target.points[k] - state.points[k] for k in points])


def in_units(state: pp.ArmState, step: pp.Step) -> np.ndarray:
    return step.dq / state.arm.joint_units


@pytest.mark.parametrize("kind", ARMS)
@given(seed=st.integers(0, 10**6), objective=st.sampled_from([None, "manipulability", "joint_limits"]))
@examples(15)
def test_pseudo_inverse_is_the_formula(kind: str, seed: int, objective: str | None) -> None:
    arm = open_arm(kind)
    state = state_of(arm, seed)
    target = target_of(arm, seed)
    step = PseudoInverse(objective, gain=0.6, null_gain=0.3).step(state, target, FREE)
    jacobian, errors = stacked(state, target, [arm.n_modules - 1])
    inverse = np.linalg.pinv(jacobian, rcond=1e-10)
    kappa = np.zeros(arm.nv)
    if objective is not None:
        kappa = 0.3 * objective_gradient(objective, state, arm.n_modules - 1)
    expected = inverse @ (0.6 * errors) + (np.eye(arm.nv) - inverse @ jacobian) @ kappa
    np.testing.assert_allclose(in_units(state, step), expected, atol=1e-9)
    np.testing.assert_allclose(jacobian @ in_units(state, step), 0.6 * errors, atol=1e-9)
    assert step.active == (arm.n_modules - 1,)
    assert step.info["rows"] == arm.dimension


def test_the_null_space_improves_the_objective_while_the_end_effector_stands() -> None:
    arm = pp.Arm.from_modules([pp.template("RyRz").with_limits(-1.2, 1.2)] * 6)
    for objective, function in (("manipulability", measure), ("joint_limits", minus_barrier)):
        q = state_of(arm, 4, 1.1).q
        target = pp.Target.from_points(arm, arm.at(q).points)  # the end-effector is there already
        method = PseudoInverse(objective, null_gain=0.2)
        before = function(arm.at(q))
        for _ in range(60):
            step = method.step(arm.at(q), target, pp.Limits(step=0.01))
            assert function(arm.at(arm.integrate(q, step.dq))) > function(arm.at(q)) - 1e-9
            q = arm.integrate(q, step.dq)
        assert function(arm.at(q)) > before + 0.05 * abs(before)
        assert np.linalg.norm(arm.at(q).points[-1] - target.points[-1]) < 2e-3 * arm.length


def measure(state: pp.ArmState) -> float:
    return float(np.prod(np.linalg.svd(state.jacobians[-1], compute_uv=False)))


def minus_barrier(state: pp.ArmState) -> float:
    return -0.5 * float(np.sum((state.q + 1.2) ** -2.0 + (state.q - 1.2) ** -2.0))


def test_the_end_effector_is_the_last_point_that_has_a_target(spatial: pp.Arm) -> None:
    weights = np.array([0, 1, 0, 1, 1, 0, 0.0])
    state = state_of(spatial, 2)
    target = target_of(spatial, 2, weights)
    for method in (PseudoInverse(), ExtendedJacobian()):
        step = method.step(state, target, FREE)
        assert step.active == (4,)
        jacobian, errors = stacked(state, target, [4])
        if not step.clipped.any():
            np.testing.assert_allclose(jacobian @ step.dq, errors, atol=1e-9)
        assert not step.dq[10:].any()
    assert TaskConstraints().step(state, target, FREE).active == (1, 3, 4)
    for name in ("augmented", "dls", "lm"):
        assert controller_named(name).step(state, target, FREE).active == (1, 3, 4)


@pytest.mark.parametrize("kind", ARMS)
@given(seed=st.integers(0, 10**6), few=st.booleans())
@examples(15)
def test_augmented_is_the_pseudo_inverse_of_everything(kind: str, seed: int, few: bool) -> None:
    arm = open_arm(kind)
    weights = np.arange(arm.n_modules) % 3 == 1 if few else np.ones(arm.n_modules)
    state = state_of(arm, seed)
    target = target_of(arm, seed, weights)
    points = [int(k) for k in np.flatnonzero(weights)]
    jacobian, errors = stacked(state, target, points)
    step = AugmentedJacobian("manipulability", gain=0.8, null_gain=0.2).step(state, target, FREE)
    kappa = 0.2 * objective_gradient("manipulability", state, points[-1])
    inverse = np.linalg.pinv(jacobian, rcond=1e-12)
    expected = inverse @ (0.8 * errors) + kappa - inverse @ (jacobian @ kappa)
    sigma = np.linalg.svd(jacobian, compute_uv=False)
    regular = sigma[sigma > 1e-10 * sigma[0]]
    np.testing.assert_allclose(in_units(state, step), expected, atol=1e-10 / regular[-1] ** 2)
    rows = min(arm.dimension * len(points), arm.nv)
    assert step.info["rows"] == arm.dimension * len(points)
    assert step.info["sigma_max"] == pytest.approx(sigma[0], rel=1e-9)
    assert step.info["sigma_min"] == pytest.approx(sigma[:rows].min(), rel=1e-6, abs=1e-14)


@pytest.mark.parametrize("kind", ARMS)
@given(seed=st.integers(0, 10**6), constraints=st.sampled_from([None, 0, 1, 2]))
@examples(15)
def test_constraints_come_second(kind: str, seed: int, constraints: int | None) -> None:
    arm = open_arm(kind)
    state = state_of(arm, seed)
    target = target_of(arm, seed)
    step = TaskConstraints(constraints, gain=0.7).step(state, target, FREE)
    *others, end = step.active
    assert end == arm.n_modules - 1
    room = (arm.nv - arm.dimension) // arm.dimension
    assert len(others) == min(arm.n_modules - 1, room, constraints if constraints is not None else room)
    jacobian, errors = stacked(state, target, [end])
    dq = in_units(state, step)
    np.testing.assert_allclose(jacobian @ dq, 0.7 * errors, atol=1e-8 * max(1.0, np.abs(dq).max()))
    if not others:
        np.testing.assert_allclose(dq, in_units(state, PseudoInverse(gain=0.7).step(state, target, FREE)))
        return
    # (2.11): the rest is the least-squares solution within the null space, taken from scipy.
    first = np.linalg.pinv(jacobian, rcond=1e-10) @ (0.7 * errors)
    wanted, theirs = stacked(state, target, others)
    null = null_space(jacobian, rcond=1e-10)
    missing = 0.7 * theirs - wanted @ first
    best = np.linalg.lstsq(wanted @ null, missing, rcond=1e-12)[0]
    left_over = np.linalg.norm(wanted @ dq - 0.7 * theirs)
    assert left_over <= np.linalg.norm(wanted @ null @ best - missing) + 1e-8 * max(1.0, np.abs(dq).max())
    printed = wanted @ null @ null.T  # J_c (I - J^+J)
    sigma = np.linalg.svd(printed, compute_uv=False)
    if sigma[sigma > 1e-12].min() > 1e-4 * sigma[0]:
        kappa = np.linalg.pinv(printed, rcond=1e-10) @ missing
        np.testing.assert_allclose(dq, first + null @ null.T @ kappa, atol=1e-6)


def test_constraints_are_spread_over_the_arm() -> None:
    arm = pp.Arm.from_template("RyRz", 20)
    active = TaskConstraints().step(state_of(arm, 0), target_of(arm, 0)).active
    assert len(active) == 1 + (40 - 3) // 3
    assert active[0] <= 2
    assert np.diff(active).max() <= 2
    assert TaskConstraints(3).step(state_of(arm, 0), target_of(arm, 0)).active == (4, 9, 14, 19)


@given(
    seed=st.integers(0, 10**6),
    kind=st.sampled_from(sorted(ARMS)),
    amplitude=st.sampled_from([0.0, 1e-6, 0.8]),
    damping=st.floats(1e-3, 0.5),
)
@examples(30)
def test_damped_least_squares_minimises_what_it_says(
    seed: int, kind: str, amplitude: float, damping: float
) -> None:
    arm = open_arm(kind)
    state = state_of(arm, seed, amplitude)
    target = target_of(arm, seed)
    step = DampedLeastSquares(damping, gain=0.9).step(state, target, FREE)
    jacobian, errors = stacked(state, target, list(range(arm.n_modules)))
    matrix = np.vstack([jacobian, damping * arm.length * np.eye(arm.nv)])
    wanted = np.concatenate([0.9 * errors, np.zeros(arm.nv)])
    expected = np.linalg.lstsq(matrix, wanted, rcond=None)[0]
    np.testing.assert_allclose(in_units(state, step), expected, atol=1e-8)
    assert np.linalg.norm(in_units(state, step)) <= np.linalg.norm(0.9 * errors) / (2 * damping * arm.length)


@given(
    seed=st.integers(0, 10**6),
    kind=st.sampled_from(sorted(ARMS)),
    amplitude=st.sampled_from([0.0, 1e-6, 0.8]),
    bias=st.sampled_from([1e-6, 1e-3, 1.0]),
)
@examples(30)
def test_levenberg_marquardt_weighs_and_damps_as_it_says(
    seed: int, kind: str, amplitude: float, bias: float
) -> None:
    arm = open_arm(kind)
    weights = np.random.default_rng(seed).choice([0.0, 0.3, 1.0, 5.0], arm.n_modules)
    weights[-1] = 2.0
    state = state_of(arm, seed, amplitude)
    target = target_of(arm, seed, weights)
    step = LevenbergMarquardt(bias).step(state, target, FREE)
    jacobian, errors = stacked(state, target, list(range(arm.n_modules)))
    jacobian = jacobian / arm.length
    errors = errors / arm.length
    each = np.sqrt(np.repeat(weights, 3))
    damping = 0.5 * float(np.sum(each**2 * errors**2)) + bias
    matrix = np.vstack([each[:, None] * jacobian, np.sqrt(damping) * np.eye(arm.nv)])
    solved = lsq_linear(matrix, np.concatenate([each * errors, np.zeros(arm.nv)]), tol=1e-14)
    np.testing.assert_allclose(in_units(state, step), solved.x, atol=1e-8)
    assert step.active == tuple(np.flatnonzero(weights))


def test_levenberg_marquardt_reaches_near_targets_to_machine_precision(spatial: pp.Arm) -> None:
    state = state_of(spatial, 1)
    goal = pp.Target.from_configuration(spatial, spatial.integrate(state.q, np.full(14, 0.02)))
    run = pp.track(spatial, goal, state.q, "lm", max_steps=30, tolerance=1e-12 * spatial.length)
    assert run.converged


def test_the_straight_arm_is_left_by_those_that_can(spatial: pp.Arm) -> None:
    state = spatial.at(spatial.straight())
    target = target_of(spatial, 3)
    jacobian, errors = stacked(state, target, [6])
    step = PseudoInverse().step(state, target, FREE)
    np.testing.assert_allclose(jacobian @ step.dq, errors * [0, 1, 1], atol=1e-12)
    assert "singular" in ExtendedJacobian().step(state, target).reason
    for name in ("augmented", "dls", "lm"):
        assert controller_named(name).step(state, target).dq.any()


@pytest.mark.parametrize(
    ("make", "kind", "message"),
    [
        (lambda: PseudoInverse("speed"), UnknownName, "manipulability, joint_limits"),
        (lambda: PseudoInverse(gain=0.0), InvalidValue, "gain"),
        (lambda: PseudoInverse(null_gain=-1.0), InvalidValue, "null_gain"),
        (lambda: AugmentedJacobian("joint_limit"), UnknownName, "did you mean 'joint_limits'"),
        (lambda: AugmentedJacobian(null_gain=float("nan")), InvalidValue, "null_gain"),
        (lambda: TaskConstraints(-1), InvalidValue, "constraints"),
        (lambda: TaskConstraints(True), InvalidValue, "constraints"),
        (lambda: TaskConstraints(gain=float("inf")), InvalidValue, "gain"),
        (lambda: ExtendedJacobian(None), UnknownName, "objective"),
        (lambda: ExtendedJacobian("speed"), UnknownName, "objective"),
        (lambda: ExtendedJacobian(restore=-0.1), InvalidValue, "restore"),
        (lambda: DampedLeastSquares(0.0), InvalidValue, "damping"),
        (lambda: DampedLeastSquares(gain=-1.0), InvalidValue, "gain"),
        (lambda: LevenbergMarquardt(0.0), InvalidValue, "bias"),
    ],
)
def test_bad_parameters_of_baselines_are_named(make: object, kind: type, message: str) -> None:
    with pytest.raises(kind, match=message):
        make()
