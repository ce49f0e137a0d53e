"""The extended Jacobian: its constraint rows, and that it stays at an extremum."""

from __future__ import annotations

from dataclasses import replace
from functools import cache

import numpy as np
import pinocchio as pin
import pytest
from arms import template_arm
from control.baseline_arms import state_of
from hypothesis import given
from hypothesis import strategies as st
from sampling import examples
from scipy.optimize import minimize

import pinposture as pp
from benchmarks.baselines import ExtendedJacobian, PseudoInverse, end_effector_task, objective_gradient

FREE = pp.Limits(step=None)
SLIDE = pp.JointSpec("x", type="prismatic", lower=-0.09, upper=0.1)
SLIDING = pp.ModuleTemplate("slides", (pp.JointSpec("y"), SLIDE, pp.JointSpec("z")), (0.03,) * 3)
TILTED = pin.SE3(pin.rpy.rpyToMatrix(1.0, 0.4, 0.0), np.zeros(3))
ARMS = {
    "spatial": lambda: pp.Arm.from_template("RyRz", 4),
    "planar": lambda: pp.Arm.from_template("Rz", 6, base_placement=TILTED),
    "sliding": lambda: pp.Arm.from_modules([SLIDING] * 3),
}
H = 1e-5


@cache
def arm_called(name: str) -> pp.Arm:
    return ARMS[name]()


def planar() -> pp.Arm:
    return template_arm("Rz", 4)


def differences(state: pp.ArmState, function: object) -> np.ndarray:
    """Central differences along each joint as columns, (..., nv), per unit of joint motion."""
    arm = state.arm
    columns = []
    for u in range(arm.nv):
        e = np.zeros(arm.nv)
        e[u] = H * arm.joint_units[u]
        ahead, behind = (function(arm.at(arm.integrate(state.q, s * e))) for s in (1.0, -1.0))
        columns.append((ahead - behind) / (2.0 * H))
    return np.array(columns).T


def tip(state: pp.ArmState) -> np.ndarray:
    return state.arm.plane @ (state.jacobians[-1] * state.arm.joint_units)


def projected(state: pp.ArmState, objective: str) -> np.ndarray:
    """(I - J^+J) grad h: what (2.12) wants to be zero, in coordinates that need no basis."""
    jacobian = tip(state)
    gradient = objective_gradient(objective, state, state.arm.n_modules - 1)
    return gradient - np.linalg.pinv(jacobian) @ (jacobian @ gradient)


@pytest.mark.parametrize("kind", ARMS)
@pytest.mark.parametrize("objective", ["manipulability", "joint_limits"])
@given(seed=st.integers(0, 10**6))
@examples(8)
def test_constraint_rows_are_the_derivative_of_the_projected_gradient(
    kind: str, objective: str, seed: int
) -> None:
    arm = arm_called(kind)
    state = state_of(arm, seed)
    if np.linalg.svd(tip(state), compute_uv=False)[-1] < 0.05 * arm.length:
        return
    target = pp.Target.from_points(arm, state_of(arm, seed + 1).points)
    task = end_effector_task(state, target)
    columns, extended, constraint = ExtendedJacobian(objective).system(state, task)
    np.testing.assert_array_equal(columns, np.arange(arm.nv))
    assert extended.shape == (arm.nv, arm.nv)
    np.testing.assert_allclose(extended[: arm.dimension], tip(state), atol=1e-12)
    # N N^T f, with N N^T = I - J^+J, does not depend on the basis, and differentiates like N_0 (N_0^T f).
    null = np.eye(arm.nv) - np.linalg.pinv(tip(state)) @ tip(state)
    rows = extended[arm.dimension :] / arm.length
    derivative = null @ differences(state, lambda s: projected(s, objective))
    scale = max(1.0, np.abs(derivative).max())
    np.testing.assert_allclose(rows.T @ rows, derivative.T @ derivative, atol=1e-5 * scale**2)
    length = np.linalg.norm(projected(state, objective)) * arm.length
    assert np.linalg.norm(constraint) == pytest.approx(length, rel=1e-9, abs=1e-12)


@pytest.mark.parametrize("kind", ARMS)
@pytest.mark.parametrize("objective", ["manipulability", "joint_limits"])
def test_the_step_is_newtons_for_an_extremum_under_the_task(kind: str, objective: str) -> None:
    """With multipliers in place of a basis: d(grad h - J^T l) = 0 with l free to change, J dq = dp."""
    arm = arm_called(kind)
    checked = 0
    for seed in range(8):
        state = state_of(arm, seed)
        target = pp.Target.from_points(arm, state_of(arm, seed + 1).points)
        jacobian = tip(state)
        d = arm.dimension
        n = arm.nv
        gradient = objective_gradient(objective, state, arm.n_modules - 1)
        multipliers = np.linalg.pinv(jacobian).T @ gradient

        def slope(s: pp.ArmState, fixed: np.ndarray = multipliers) -> np.ndarray:
            return objective_gradient(objective, s, arm.n_modules - 1) - tip(s).T @ fixed

        bordered = np.block([[differences(state, slope), -jacobian.T], [jacobian, np.zeros((d, d))]])
        if np.linalg.cond(bordered) > 1e5:
            continue
        errors = arm.plane @ (target.points[-1] - state.points[-1])
        for restore in (0.0, 0.002):
            # N^T (K dq) = -restore N^T grad h, in steps so small that no limit is in the way.
            right = np.concatenate([-restore * projected(state, objective), 1e-3 * errors])
            expected = np.linalg.solve(bordered, right)[:n] * arm.joint_units
            step = ExtendedJacobian(objective, gain=1e-3, restore=restore).step(state, target, FREE)
            assert not step.reason
            if not step.clipped.any():
                np.testing.assert_allclose(step.dq, expected, atol=1e-4 * np.abs(expected).max())
                checked += 1
    assert checked >= 4


@pytest.fixture(scope="module")
def extremum() -> np.ndarray:
    """A configuration of the planar arm with the best manipulability for where its tip is."""
    q = np.array([0.3, 0.9, 0.5, 1.1])
    target = pp.Target.from_points(planar(), planar().at(q).points)
    climb = PseudoInverse("manipulability", null_gain=2.0)
    settle = ExtendedJacobian(restore=1.0)
    for method, steps in ((climb, 150), (settle, 8)):
        for _ in range(steps):
            q = planar().integrate(q, method.step(planar().at(q), target).dq)
    return q


def stray(q: np.ndarray) -> float:
    return float(np.linalg.norm(projected(planar().at(q), "manipulability")))


def drive(method: object, q: np.ndarray, targets: np.ndarray, limits: pp.Limits = FREE) -> np.ndarray:
    """Follow tip positions one after the other; the other control points have no target."""
    path = [q]
    for point in targets:
        points = np.zeros((4, 3))
        points[-1] = point
        target = pp.Target.from_points(planar(), points, [0, 0, 0, 1])
        path.append(planar().integrate(path[-1], method.step(planar().at(path[-1]), target, limits).dq))
    return np.array(path)


def loop(start: np.ndarray, radius: float, steps: int) -> np.ndarray:
    angle = np.linspace(0.0, 2 * np.pi, steps + 1)[1:, None]
    return start + radius * np.hstack([np.sin(angle), 1.0 - np.cos(angle), 0.0 * angle])


def test_restore_finds_the_extremum_that_a_constrained_optimiser_finds(extremum: np.ndarray) -> None:
    point = planar().at(extremum).points[-1]
    assert stray(extremum) < 1e-12
    assert stray(np.array([0.3, 0.9, 0.5, 1.1])) > 1e-3

    def loss(q: np.ndarray) -> float:
        jacobian = tip(planar().at(q))
        return -float(np.sqrt(np.linalg.det(jacobian @ jacobian.T))) / planar().length ** 2

    found = minimize(
        loss,
        extremum + [0.05, -0.08, 0.04, 0.02],
        method="SLSQP",
        constraints={"type": "eq", "fun": lambda q: (planar().at(q).points[-1] - point)[:2]},
        options={"ftol": 1e-14, "maxiter": 200},
    )
    np.testing.assert_allclose(found.x, extremum, atol=1e-4)
    assert found.fun == pytest.approx(loss(extremum), abs=1e-8)


@pytest.mark.long
def test_it_stays_at_the_extremum_while_the_end_effector_moves(extremum: np.ndarray) -> None:
    start = planar().at(extremum).points[-1]
    targets = loop(start, 0.06, 300)
    strays = {}
    for name, method in (("extended", ExtendedJacobian()), ("pinv", PseudoInverse())):
        path = drive(method, extremum, targets)
        strays[name] = max(stray(q) for q in path)
        reached = np.array([planar().at(q).points[-1] for q in path[1:]])
        assert np.abs(reached - targets).max() < 1e-4
    assert strays["extended"] < 1e-4
    assert strays["pinv"] > 20 * strays["extended"]
    # The drift is that of the step, and shrinks with it.
    finer = max(stray(q) for q in drive(ExtendedJacobian(), extremum, loop(start, 0.06, 600)))
    assert finer < 0.7 * strays["extended"]


@pytest.mark.long
def test_from_an_extremum_the_motion_repeats(extremum: np.ndarray) -> None:
    targets = loop(planar().at(extremum).points[-1], 0.06, 400)
    apart = {}
    for name, method in (("extended", ExtendedJacobian(restore=1.0)), ("pinv", PseudoInverse())):
        apart[name] = np.abs(drive(method, extremum, targets)[-1] - extremum).max()
    assert apart["extended"] < 1e-4
    assert apart["pinv"] > 1e-3


def test_off_an_extremum_it_stays_off(extremum: np.ndarray) -> None:
    q = extremum + [0.1, -0.3, 0.2, 0.1]
    start = planar().at(q).points[-1]
    path = drive(ExtendedJacobian(), q, loop(start, 0.03, 200))
    assert stray(path[-1]) == pytest.approx(stray(q), rel=1e-2)
    back = drive(ExtendedJacobian(restore=0.5), q, np.tile(start, (40, 1)))
    assert stray(back[-1]) < 1e-9


def test_as_many_joints_as_directions_leave_no_constraint() -> None:
    arm = pp.Arm.from_template("Rz", 2)
    state = arm.at(np.array([0.4, 0.8]))
    target = pp.Target.from_points(arm, arm.at(np.array([0.5, 0.7])).points)
    step = ExtendedJacobian().step(state, target, FREE)
    errors = (target.points - state.points)[-1, :2]
    np.testing.assert_allclose(step.dq, np.linalg.solve(state.jacobians[-1, :2], errors), atol=1e-12)


def test_where_there_is_no_inverse_it_stands_and_says_why() -> None:
    target = pp.Target.from_points(planar(), state_of(planar(), 1).points)
    straight = ExtendedJacobian().step(planar().at(planar().straight()), target)
    assert not straight.dq.any()
    assert "end-effector is singular" in straight.reason
    # Without limits, the distance from them is no objective: flat everywhere.
    endless = pp.Arm.from_modules([pp.ModuleTemplate("C", (pp.JointSpec("z", "continuous"),), (0.1,))] * 4)
    state = endless.at(endless.configuration(np.array([0.3, 0.9, 0.5, 1.1])))
    flat = ExtendedJacobian("joint_limits").step(state, target)
    assert not flat.dq.any()
    assert "no single extremum" in flat.reason
    assert replace(ExtendedJacobian(), objective="manipulability").step(state, target).dq.any()
