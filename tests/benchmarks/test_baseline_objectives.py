"""Objective functions of the baselines: their derivatives, by finite differences on the manifold."""

from __future__ import annotations

from collections.abc import Callable
from functools import cache

import numpy as np
import pinocchio as pin
import pytest
from control.baseline_arms import PLACEMENT, SLIDING, state_of
from hypothesis import given
from hypothesis import strategies as st
from sampling import examples

import pinposture as pp
from benchmarks.baseline_objectives import (
    NEAREST,
    OBJECTIVES,
    PositionDerivatives,
    joint_axes,
    objective_gradient,
    objective_hessian,
    objective_value,
)

ARMS = {
    "spatial": lambda: pp.Arm.from_template("RyRz", 6, base_placement=PLACEMENT),
    "planar": lambda: pp.Arm.from_template("Rz", 7, base_placement=PLACEMENT),
    "sliding": lambda: pp.Arm.from_modules([SLIDING] * 4, base_placement=PLACEMENT),
}
H = 1e-5


@cache
def arm_called(name: str) -> pp.Arm:
    return ARMS[name]()


def differences(state: pp.ArmState, function: Callable[[pp.ArmState], object]) -> np.ndarray:
    """Central differences along each joint, (nv, ...), per unit of joint motion."""
    arm = state.arm
    rows = []
    for u in range(arm.nv):
        e = np.zeros(arm.nv)
        e[u] = H * arm.joint_units[u]
        ahead, behind = (np.asarray(function(arm.at(arm.integrate(state.q, s * e)))) for s in (1.0, -1.0))
        rows.append((ahead - behind) / (2.0 * H))
    return np.array(rows)


@pytest.mark.parametrize("kind", ARMS)
def test_axes_are_those_of_pinocchio(kind: str) -> None:
    arm = arm_called(kind)
    for seed in range(5):
        state = state_of(arm, seed, 3.0)
        spatial = pin.computeJointJacobians(arm.model, arm.model.createData(), state.q)
        np.testing.assert_allclose(joint_axes(state), spatial[3:, arm.columns].T, atol=1e-13)


@pytest.mark.parametrize("kind", ARMS)
@given(seed=st.integers(0, 10**6), share=st.sampled_from([0.5, 1.0]))
@examples(8)
def test_position_derivatives_of_second_and_third_order(kind: str, seed: int, share: float) -> None:
    arm = arm_called(kind)
    state = state_of(arm, seed, 1.0)
    point = int(share * (arm.n_modules - 1))
    found = PositionDerivatives(state, point)
    columns = found.columns
    second = differences(state, lambda s: s.task_jacobians[point])  # (nv, d, nv)
    np.testing.assert_allclose(found.second(), second[columns][:, :, columns].swapaxes(1, 2), atol=1e-9)
    assert not np.delete(second, columns, axis=0).any()
    weights = np.random.default_rng(seed).normal(size=(arm.dimension, len(columns)))

    def contracted(s: pp.ArmState) -> np.ndarray:
        return np.einsum("uvd,dv->u", PositionDerivatives(s, point).second(), weights)

    third = differences(state, contracted)[columns]
    np.testing.assert_allclose(found.third(weights), third, atol=1e-8)


@pytest.mark.parametrize("kind", ARMS)
@pytest.mark.parametrize("objective", OBJECTIVES)
@given(seed=st.integers(0, 10**6), share=st.sampled_from([0.5, 1.0]))
@examples(8)
def test_gradient_and_hessian_of_each_objective(kind: str, objective: str, seed: int, share: float) -> None:
    arm = arm_called(kind)
    state = state_of(arm, seed, 0.9)
    point = int(share * (arm.n_modules - 1))
    gradient = objective_gradient(objective, state, point)
    hessian = objective_hessian(objective, state, point)
    numeric = differences(state, lambda s: objective_value(objective, s, point))
    scale = max(1.0, np.abs(hessian).max())
    np.testing.assert_allclose(gradient, numeric, atol=1e-6 * scale)
    slopes = differences(state, lambda s: objective_gradient(objective, s, point))
    kink = np.zeros(arm.nv, dtype=bool)  # the barrier is continued with a jump in its second derivative
    if objective == "joint_limits":
        positions = arm.positions(state.q)
        room = np.minimum(positions - arm.limits.lower, arm.limits.upper - positions)
        kink = np.abs(room / arm.joint_units - NEAREST) < 2 * H
    np.testing.assert_allclose(hessian[~kink], slopes[~kink], atol=1e-6 * scale)


@pytest.mark.parametrize("kind", ARMS)
def test_the_measure_is_the_root_of_the_determinant(kind: str) -> None:
    arm = arm_called(kind)
    for seed in range(5):
        state = state_of(arm, seed, 1.0)
        jacobian = state.task_jacobians[-1] / arm.length
        measure = objective_value("manipulability", state, arm.n_modules - 1)
        assert measure == pytest.approx(np.sqrt(np.linalg.det(jacobian @ jacobian.T)), rel=1e-9)


def test_the_measure_has_no_gradient_where_the_jacobian_is_singular() -> None:
    arm = arm_called("spatial")
    state = arm.at(arm.straight())
    assert not objective_gradient("manipulability", state, 5).any()
    assert not objective_hessian("manipulability", state, 5).any()
    assert not objective_gradient(
        "manipulability", state_of(arm, 1, 1.0), 0
    ).any()  # two joints, three directions


def test_the_measure_does_not_depend_on_the_unit_of_length() -> None:
    small, large = (pp.Arm.from_template("RyRz", 4, (a, 2 * a)) for a in (0.01, 1.0))
    q = np.random.default_rng(0).uniform(-1, 1, 8)
    there, here = (objective_gradient("manipulability", arm.at(q), 3) for arm in (small, large))
    np.testing.assert_allclose(there, here, rtol=1e-9, atol=1e-14)


def test_joint_limits_are_kept_away_from_and_never_pull_outwards() -> None:
    arm = pp.Arm.from_modules([pp.template("Rz").with_limits(-0.8, 1.2)] * 5)
    positions = np.array([0.2, -0.7999, 1.1, 1.2, -0.9])  # middle, near, nearer than NEAREST, at, beyond
    gradient = objective_gradient("joint_limits", arm.at(positions), 4)
    assert gradient[0] == pytest.approx(0.0, abs=1e-12)
    assert np.all(np.sign(gradient[1:]) == [1, -1, -1, 1])
    assert np.abs(gradient).max() <= NEAREST**-3.0
    # Away from the limits the value is minus (2.8) as printed.
    inside = np.array([0.2, -0.5, 1.0, 0.0, 0.3])
    printed = 0.5 * np.sum((inside + 0.8) ** -2.0 + (inside - 1.2) ** -2.0)
    assert objective_value("joint_limits", arm.at(inside), 4) == pytest.approx(-printed, rel=1e-12)


def test_joints_without_limits_and_joints_off_the_chain_feel_nothing() -> None:
    arm = arm_called("sliding")
    endless = np.array([joint.nq == 2 for joint in list(arm.model.joints)[1:]])
    assert endless.sum() == 4
    gradient = objective_gradient("joint_limits", state_of(arm, 3, 1.0), 3)
    assert not gradient[endless].any()
    assert gradient[~endless].all()
    model = pin.Model(pp.Arm.from_template("Rz", 3).model)
    model.addJoint(1, pin.JointModelRZ(), pin.SE3.Identity(), "aside")
    model.lowerPositionLimit = np.full(4, -1.0)
    model.upperPositionLimit = np.full(4, 1.0)
    branched = pp.Arm.from_model(model, ["module_01", "module_02", "module_03"])
    state = branched.at(np.full(4, 0.5))
    for objective in OBJECTIVES:
        gradient = objective_gradient(objective, state, 2)
        assert gradient[3] == 0.0
        assert gradient[:3].any()
